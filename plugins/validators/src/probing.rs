//! Validator `probe`: form and size of a calibrated ring or sphere as the probe measures it, in the manner of ISO 230-10 and
//! ISO 10360-5, as recorded and with the effective stylus radius of the fit.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use abbe_core::{
    AxisKind, Contact, Context, Dataset, Error, Evaluation, Feature, Figure, Findings, Fit, Problem, Quantity, Result,
    RowIndex, SetIndex, SettingsError, StatusRole, Validate,
};
use abbe_standards::probing::{Edition, Gauge, Probed, ball, ring};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::{Limits, ONE, UM, check_limits, set_limits};

abbe_core::register!(
    Validate,
    "probe",
    "probing errors on a calibrated ring or sphere (ISO 230-10, ISO 10360-5), as recorded and corrected for lobing",
    Settings,
    example,
    build,
    "../reference/validate-probe.md",
);

/// Settings of the probing errors.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The standard whose symbols the figures have.
    #[serde(default)]
    edition: Symbols,
    /// Largest admissible values: `form_um`, `absolute_size_um`, `corrected_form_um`, `corrected_absolute_size_um`.
    #[serde(default)]
    limits: Limits,
}

/// The standard whose symbols the figures have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
enum Symbols {
    /// `P_FTU,2D`, `P_FTU,3D`, ...
    #[default]
    #[serde(rename = "iso-230-10")]
    Iso230Part10,
    /// `P_FTU`, `P_STU`.
    #[serde(rename = "iso-10360-5-2010")]
    Iso10360Part5Of2010,
    /// `P_Form.Sph.1x25`, `P_Size.Sph.1x25`.
    #[serde(rename = "iso-10360-5-2020")]
    Iso10360Part5Of2020,
}

impl Symbols {
    fn edition(self) -> Edition {
        match self {
            Self::Iso230Part10 => Edition::Iso230Part10,
            Self::Iso10360Part5Of2010 => Edition::Iso10360Part5Of2010,
            Self::Iso10360Part5Of2020 => Edition::Iso10360Part5Of2020,
        }
    }
}

/// The figures that may be limited.
const LIMITED: [&str; 4] = ["form_um", "absolute_size_um", "corrected_form_um", "corrected_absolute_size_um"];

/// Names of figures, as recorded and corrected.
const NAMES: [[&str; 2]; 2] = [["form", "absolute size"], ["corrected form", "corrected absolute size"]];

fn example() -> Value {
    json!({ "limits": { "form_um": 10, "corrected_form_um": 3 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    check_limits(&settings.limits, &LIMITED)?;
    Ok(Box::new(Probing { settings }))
}

struct Probing {
    settings: Settings,
}

impl Validate for Probing {
    fn accepts_other_observations(&self) -> bool {
        true
    }

    fn finds_features(&self) -> bool {
        true
    }

    fn needs_rows(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        let edition = self.settings.edition.edition();
        let mut findings = Findings::default();
        for fit in fits {
            let mut touched = Vec::new();
            for set in fit.problem.set_indices() {
                touched.extend(Touched::all(fit, set)?);
            }
            if touched.is_empty() {
                return Err(Error::usage(format!("{} has no touches on rings or balls", fit.name))
                    .help("name the artefact stages with the gauges: `observations: [ring, sphere]`"));
            }
            let mut figures = Vec::new();
            let mut details = Vec::new();
            for (corrected, names) in [false, true].into_iter().zip(NAMES) {
                let mut worst = [f64::NAN; 2];
                for gauge in &touched {
                    let probed = gauge.probed(corrected)?;
                    details.extend(gauge.details(&fit.name, edition, corrected, &probed));
                    let errors = [probed.form, gauge.size_error(&probed).map_or(f64::NAN, f64::abs)];
                    worst.iter_mut().zip(errors).for_each(|(worst, error)| *worst = worst.max(error * 1e3));
                }
                let known = names.into_iter().zip(worst).filter(|(_, worst)| worst.is_finite());
                figures.extend(known.map(|(name, worst)| Figure::new(&fit.name, name, worst, UM)));
            }
            figures.push(Figure::new(&fit.name, "gauges", touched.len() as f64, ONE));
            set_limits(&self.settings.limits, &mut figures);
            findings.figures.extend(figures);
            findings.figures.extend(details);
            findings.tables.insert(format!("{}-directions.csv", fit.name), table(&touched)?);
        }
        findings.remarks.push(format!(
            "symbols of {} as far as they are known; least squares gauge, form = range of the radial distances",
            edition.name()
        ));
        Ok(findings)
    }
}

/// A gauge that was touched with one stylus at one indexation and one feed.
struct Touched {
    /// What tells it from others: `sphere 31, S 90 deg, 30 mm/min`.
    label: String,
    gauge: Gauge,
    /// Two directions across the axis of a ring; table frame.
    plane: [Vector3<f64>; 2],
    /// Distance of the nominal tip from the centre (the axis); none if the artefact does not say.
    reach: Option<f64>,
    touches: Vec<Touch>,
}

/// One touch, by the nominal machine.
struct Touch {
    /// Table frame, mm.
    tip: Vector3<f64>,
    tool: UnitQuaternion<f64>,
    /// Whether the material lies outside the tip: the inside of a ring.
    hollow: bool,
    stylus: usize,
    /// mm/s.
    feed: f64,
    lobing: Terms,
}

/// The effective stylus radius of a fit less the nominal one, as a function of direction and feed.
type Terms = std::sync::Arc<dyn Fn(usize, &Vector3<f64>, f64) -> f64 + Send + Sync>;

impl Touched {
    /// The gauges of a set of observations; none if its rows are not touches on rings or balls.
    fn all(fit: &Fit, set: SetIndex) -> Result<Vec<Self>> {
        let problem = fit.problem.as_ref();
        let stage = &problem.sets[set].name;
        let info = problem.sets[set].info();
        let is_gauge = |feature: &Feature| matches!(feature.shifts.len(), 2 | 3);
        if info.contact != Contact::LinearAxes || !info.features.iter().all(is_gauge) {
            return Ok(Vec::new());
        }
        let (nominal, lobing) = (nominal(problem), lobing(fit));
        let feeds = info.layout.data.column("feed").filter(|column| column.header.quantity == Quantity::Speed);
        let feeds = feeds.and_then(|_| info.layout.data.numbers("feed"));
        let labels = info.layout.data.labels("feature");
        let mut found: BTreeMap<String, Self> = BTreeMap::new();
        let mut order = Vec::new();
        for &row in &problem.sets[set].rows {
            let of_row = info.layout.rows[row];
            let (Some(data_row), 1, 1) = (of_row.data_row, of_row.poses, of_row.equations) else { continue };
            let mut work = Evaluation::default();
            nominal.evaluate(set, &[row], &[], &mut work)?;
            let tip = Vector3::from(work.poses.positions[0]);
            let feature = match labels {
                Some(labels) => info.features.iter().find(|feature| feature.label == labels[data_row]),
                None => info.features.first(),
            };
            let Some(feature) = feature else { continue };
            let gauge = if feature.shifts.len() == 2 { Gauge::Ring } else { Gauge::Sphere };
            let status = nominal.sets[set].poses().row(of_row.first_pose);
            let feed = feeds.map_or(f64::NAN, |feeds| feeds[data_row]);
            let label = format!("{stage} {}{}", feature.label, place(problem, status, feed));
            let gauges = found.entry(label.clone()).or_insert_with(|| {
                order.push(label.clone());
                let plane = [0, 1].map(|index| Vector3::from(feature.shifts[index].1));
                let point = Vector3::from(feature.point);
                Self { label, gauge, plane, reach: reach(&nominal, set, row, point, plane[0]), touches: Vec::new() }
            });
            let normal = Vector3::from(work.equations.by_position()[0]);
            let [w, x, y, z] = orientation(&nominal, set, row, &work)?;
            gauges.touches.push(Touch {
                tip,
                tool: UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)),
                hollow: normal.dot(&(tip - Vector3::from(feature.point))) < 0.0,
                stylus: stylus(problem, status),
                feed: if feed.is_nan() { 0.0 } else { feed },
                lobing: lobing.clone(),
            });
        }
        Ok(order.into_iter().filter_map(|label| found.remove(&label)).collect())
    }

    /// The gauge through the tips as recorded, or with the effective stylus radius taken off along the normals from its centre.
    fn probed(&self, corrected: bool) -> Result<Probed> {
        let tips: Vec<Vector3<f64>> = self.touches.iter().map(|touch| touch.tip).collect();
        let recorded = self.through(&tips)?;
        if !corrected {
            return Ok(recorded);
        }
        let tips: Vec<Vector3<f64>> = self
            .touches
            .iter()
            .map(|touch| {
                let normal = self.normal(touch, &recorded);
                touch.tip - touch.radius_by(&normal) * normal
            })
            .collect();
        self.through(&tips)
    }

    fn through(&self, tips: &[Vector3<f64>]) -> Result<Probed> {
        let probed = match self.gauge {
            Gauge::Ring => ring(&tips.iter().map(|tip| self.plane.map(|across| across.dot(tip))).collect::<Vec<_>>()),
            Gauge::Sphere => ball(&tips.iter().map(|tip| (*tip).into()).collect::<Vec<_>>()),
        };
        probed.map_err(|error| Error::data(format!("{}: {error}", self.label)))
    }

    /// The outward normal at a touch, table frame.
    fn normal(&self, touch: &Touch, probed: &Probed) -> Vector3<f64> {
        let [x, y, z] = probed.centre;
        let outwards = match self.gauge {
            Gauge::Ring => {
                let [along_x, along_y] = self.plane.map(|across| across.dot(&touch.tip));
                (along_x - x) * self.plane[0] + (along_y - y) * self.plane[1]
            }
            Gauge::Sphere => touch.tip - Vector3::new(x, y, z),
        };
        if touch.hollow { -outwards.normalize() } else { outwards.normalize() }
    }

    /// Fitted less certified diameter, mm; none if the artefact does not say its size.
    fn size_error(&self, probed: &Probed) -> Option<f64> {
        Some(2.0 * (probed.radius - self.reach?))
    }

    fn details(&self, of: &str, edition: Edition, corrected: bool, probed: &Probed) -> Vec<Figure> {
        let what = if corrected { format!("{}, corrected", self.label) } else { self.label.clone() };
        let new = |name: &str, value, unit| Figure::new(of, format!("{name}[{what}]"), value, unit).detail();
        let mut figures = vec![
            new(edition.form(self.gauge), probed.form * 1e3, UM),
            new("standard deviation", probed.standard_deviation * 1e3, UM),
        ];
        let size = self.size_error(probed);
        figures.extend(size.map(|size| new(edition.size(self.gauge), size * 1e3, UM)));
        figures.push(new("points", probed.residuals.len() as f64, ONE));
        figures
    }
}

impl Touch {
    /// Effective less nominal stylus radius at a normal in the table frame, mm.
    fn radius_by(&self, normal: &Vector3<f64>) -> f64 {
        (self.lobing)(self.stylus, &self.tool.inverse_transform_vector(normal), self.feed)
    }
}

/// The problem of a machine without errors, with the artefacts where they are nominally.
fn nominal(problem: &Problem) -> Problem {
    let mut nominal = problem.clone();
    nominal.machine_values = problem.model.info().without_errors();
    for set in &mut nominal.sets {
        set.own = set.info().start.clone();
    }
    nominal
}

/// The effective stylus radius of a fit.
fn lobing(fit: &Fit) -> Terms {
    let model = fit.problem.model.clone();
    let values = fit.problem.starting_from(&fit.calibration).machine_values;
    std::sync::Arc::new(move |stylus, direction, feed| {
        abbe_probe::deviation(model.as_ref(), &values, stylus, direction, feed)
    })
}

/// Rotary positions, stylus and feed of a touch, in words.
fn place(problem: &Problem, status: &[f64], feed: f64) -> String {
    let mut words = String::new();
    let info = problem.model.info();
    for axis in info.axes.iter().filter(|axis| axis.kind == AxisKind::Rotary) {
        // Rounded so that positions that a control writes with a last digit of difference are one.
        let degrees = (status[axis.status].to_degrees() * 1e4).round() / 1e4 + 0.0;
        let _ = write!(words, ", {} {degrees} deg", axis.name);
    }
    if let Some(column) = info.status_index(&StatusRole::Stylus) {
        let label = info.status[column].levels.get(stylus(problem, status));
        let _ = write!(words, ", stylus {}", label.map_or("1", String::as_str));
    }
    if feed.is_finite() {
        let _ = write!(words, ", {} mm/min", (feed * 60.0 * 1e3).round() / 1e3);
    }
    words
}

/// The index of the stylus of a touch.
fn stylus(problem: &Problem, status: &[f64]) -> usize {
    problem.model.info().status_index(&StatusRole::Stylus).map_or(0, |column| status[column] as usize)
}

/// Distance of the nominal tip from the centre of a feature, or from the axis of a ring.
fn reach(problem: &Problem, set: SetIndex, row: RowIndex, centre: Vector3<f64>, across: Vector3<f64>) -> Option<f64> {
    let observed = &problem.sets[set];
    let inputs = observed.inputs_with(&problem.machine_values);
    let contact = observed.observations.contact_tip(row, (centre + across).into(), &observed.own, &inputs);
    Some((Vector3::from(contact.ok().flatten()?) - centre).norm())
}

/// The orientation of the tool in a row.
fn orientation(problem: &Problem, set: SetIndex, row: RowIndex, work: &Evaluation) -> Result<[f64; 4]> {
    if let Some(orientation) = work.poses.orientations.first() {
        return Ok(*orientation);
    }
    let (mut poses, observed) = (abbe_core::Poses::default(), &problem.sets[set]);
    let status = observed.poses().row(observed.info().layout.rows[row].first_pose);
    problem.model.poses(status, &problem.machine_values, &[], true, &mut poses)?;
    Ok(poses.orientations[0])
}

/// Every touch: its direction seen from the probe, its radial distance as recorded, what the fit says of it, and what is left.
fn table(touched: &[Touched]) -> Result<String> {
    let mut text = String::from(
        "gauge,azimuth_deg,elevation_deg,radial_distance_um,effective_radius_deviation_um,corrected_radial_distance_um\n",
    );
    for gauge in touched {
        let (recorded, corrected) = (gauge.probed(false)?, gauge.probed(true)?);
        let rows = gauge.touches.iter().zip(recorded.residuals.iter().zip(&corrected.residuals));
        for (touch, (before, after)) in rows {
            let normal = gauge.normal(touch, &recorded);
            let seen = touch.tool.inverse_transform_vector(&normal);
            let (azimuth, elevation) = (seen.y.atan2(seen.x).to_degrees(), seen.z.clamp(-1.0, 1.0).asin().to_degrees());
            let _ = writeln!(
                text,
                "\"{}\",{:.3},{:.3},{:.4},{:.4},{:.4}",
                gauge.label,
                azimuth + 0.0,
                elevation + 0.0,
                before * 1e3,
                touch.radius_by(&normal) * 1e3,
                after * 1e3
            );
        }
    }
    Ok(text)
}
