//! Artefact plugin `facets`: plane or curved patches, known nominally by a point and a normal, touched with the machine's probe.
//!
//! Equation (Rahman & Mayer 2015): `n . (p - P) - d - r = 0`, with the tip p and the nominal point P in the table frame,
//! the outward unit normal n, the facet's own offset d along it and the effective stylus radius r.
//!
//! A facet may lie on a cylinder or a sphere of radius R (negative if it is hollow) instead: then a touch beside the nominal
//! point meets the surface lower, and the equation is that of the distance from the axis or the centre,
//! `sign(R) |p - C| - R - d - r = 0` with `C = P - R n` and, for a cylinder, without the part of p - C along the axis.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use abbe_core::{
    AboveZero, Artefact, ColumnHeader, Contact, Context, DataRow, Dataset, Equations, Error, Feature, InputFile,
    KinematicModel, Label, Layout, Observations, ObservationsInfo, Parameter, ParameterRole, PathItem, Poses, Quantity,
    Result, RowBatch, RowIndex, SettingsError, Target, Unit, not_negative, plain_naming, pose_columns, positive,
};
use abbe_probe::EffectiveRadius;
use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

abbe_core::register!(
    Artefact,
    "facets",
    "touches on plane facets that are known nominally: a machine table, a fixture, a part",
    Settings,
    example,
    build,
    "../reference/artefact-facets.md",
);

/// Settings of the facets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the nominal facets: feature, x_mm, y_mm, z_mm, nx, ny, nz in the table frame.
    nominal: String,
    /// Standard uncertainty of one touch along the normal.
    #[schemars(with = "AboveZero")]
    standard_uncertainty_um: f64,
    /// Standard uncertainty of the effective stylus radius, shared by all touches.
    #[serde(default)]
    stylus_radius_standard_uncertainty_um: f64,
    /// Facets on curved surfaces; all others are plane.
    #[serde(default)]
    curved: Vec<Curved>,
}

/// Facets on the same kind of curved surface.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Curved {
    /// Their labels; all facets of the nominal file unless some are named.
    #[serde(default)]
    features: Vec<Label>,
    /// Radius of the surface at the facet, negative if it is hollow.
    radius_mm: f64,
    /// Direction of the axis of a cylinder, table frame; without it the surface is a sphere.
    #[serde(default)]
    axis: Option<[f64; 3]>,
}

fn example() -> Value {
    json!({ "nominal": "facets.csv", "standard_uncertainty_um": 1.6 })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    not_negative("stylus_radius_standard_uncertainty_um", settings.stylus_radius_standard_uncertainty_um)?;
    for (index, curved) in settings.curved.iter().enumerate() {
        let at = |error: SettingsError| error.under([PathItem::Key("curved".to_owned()), PathItem::Index(index)]);
        if !(curved.radius_mm.is_finite() && curved.radius_mm != 0.0) {
            return Err(at(SettingsError::new("radius_mm", "a radius that is not zero was expected")));
        }
        if curved.axis.is_some_and(|axis| Vector3::from(axis).try_normalize(1e-9).is_none()) {
            return Err(at(SettingsError::new("axis", "a direction was expected: x, y, z, not all zero")));
        }
    }
    Ok(Box::new(Facets { nominal: context.path(&settings.nominal), settings }))
}

struct Facets {
    nominal: PathBuf,
    settings: Settings,
}

/// A nominal facet, table frame.
#[derive(Debug, Clone, PartialEq)]
struct Facet {
    label: String,
    point: Vector3<f64>,
    normal: Vector3<f64>,
    curved: Option<Surface>,
}

/// A curved surface at a facet.
#[derive(Debug, Clone, PartialEq)]
struct Surface {
    /// Radius, mm; negative if it is hollow.
    radius: f64,
    /// Unit direction of the axis; none for a sphere.
    axis: Option<Vector3<f64>>,
}

impl Facet {
    /// The distance of a tip from the nominal surface, positive outwards, its derivative to the tip (the outward normal), and the
    /// derivative of this normal to the tip.
    fn distance(&self, tip: Vector3<f64>) -> (f64, Vector3<f64>, Matrix3<f64>) {
        let from_point = tip - self.point;
        let Some(Surface { radius, axis }) = &self.curved else {
            return (self.normal.dot(&from_point), self.normal, Matrix3::zeros());
        };
        let from_centre = from_point + *radius * self.normal;
        let across = axis.map_or(from_centre, |axis| from_centre - from_centre.dot(&axis) * axis);
        let outward = radius.signum() * across.normalize();
        let along = axis.map_or(Matrix3::zeros(), |axis| axis * axis.transpose());
        let turning = (Matrix3::identity() - outward * outward.transpose() - along) * (radius.signum() / across.norm());
        (radius.signum() * across.norm() - radius, outward, turning)
    }
}

/// Sine of the largest deviation of a cylinder's axis from perpendicular to the normal of its facet.
const SKEW: f64 = 1e-3;

/// Part of the radius by which nominal points may miss a surface that they lie on: normals are rounded.
const ROUNDED: f64 = 5e-3;

/// Part of the radius within which two radii are the same one.
const SAME_RADIUS: f64 = 0.02;

/// The radius R of the one surface that all facets lie on, p = c + R n across its axis; none for fewer than three facets, for normals that
/// hardly differ, and if they do not lie on one surface.
fn common_radius(facets: &[&Facet]) -> Option<f64> {
    if facets.len() < 3 {
        return None;
    }
    let axis = facets[0].curved.as_ref()?.axis;
    let across = |vector: Vector3<f64>| axis.map_or(vector, |axis| vector - vector.dot(&axis) * axis);
    let mean = |of: fn(&Facet) -> Vector3<f64>| {
        facets.iter().map(|facet| of(facet)).sum::<Vector3<f64>>() / facets.len() as f64
    };
    let (point, normal) = (mean(|facet| facet.point), mean(|facet| facet.normal));
    let pairs = facets.iter().map(|facet| (across(facet.point - point), across(facet.normal - normal)));
    let pairs: Vec<(Vector3<f64>, Vector3<f64>)> = pairs.collect();
    let spread: f64 = pairs.iter().map(|(_, normal)| normal.norm_squared()).sum();
    if spread < 1e-2 * facets.len() as f64 {
        return None;
    }
    let radius = pairs.iter().map(|(point, normal)| point.dot(normal)).sum::<f64>() / spread;
    let largest = pairs.iter().map(|(point, normal)| (point - radius * normal).norm()).fold(0.0, f64::max);
    (radius != 0.0 && largest < ROUNDED * radius.abs()).then_some(radius)
}

impl Facets {
    /// The first line under `curved` that names a facet; none for a plane one.
    fn line_of(&self, label: &str) -> Option<usize> {
        let names =
            |curved: &Curved| curved.features.is_empty() || curved.features.iter().any(|feature| feature.0 == label);
        self.settings.curved.iter().position(names)
    }

    /// The curved surface of a facet; fails for a cylinder that does not have this normal.
    fn surface(&self, label: &str, normal: Vector3<f64>) -> Result<Option<Surface>, String> {
        let Some(curved) = self.line_of(label).map(|line| &self.settings.curved[line]) else { return Ok(None) };
        let axis = curved.axis.map(|axis| Vector3::from(axis).normalize());
        match axis.map(|axis| axis.dot(&normal).abs()) {
            Some(skew) if skew > SKEW => {
                Err(format!("the normal of facet {label} is not perpendicular to the axis of its cylinder"))
            }
            _ => Ok(Some(Surface { radius: curved.radius_mm, axis })),
        }
    }

    /// Refuses curved facets that the nominal file does not have.
    fn known(&self, nominal: &[Facet]) -> Result<()> {
        for (index, curved) in self.settings.curved.iter().enumerate() {
            for (place, Label(label)) in curved.features.iter().enumerate() {
                if !nominal.iter().any(|facet| facet.label == *label) {
                    let mut error = Error::usage(format!("the nominal file has no facet {label}"));
                    error.setting = vec![
                        PathItem::Key("curved".to_owned()),
                        PathItem::Index(index),
                        PathItem::Key("features".to_owned()),
                        PathItem::Index(place),
                    ];
                    return Err(error);
                }
            }
        }
        Ok(())
    }

    /// Refuses a radius that is not the one on which the nominal points and normals of its facets lie. Facets of one line that are on
    /// several surfaces of the same kind do not tell.
    fn as_nominal(&self, nominal: &[Facet]) -> Result<()> {
        for (index, curved) in self.settings.curved.iter().enumerate() {
            let own: Vec<&Facet> = nominal.iter().filter(|facet| self.line_of(&facet.label) == Some(index)).collect();
            let Some(radius) =
                common_radius(&own).filter(|radius| (radius - curved.radius_mm).abs() > SAME_RADIUS * radius.abs())
            else {
                continue;
            };
            let message = format!(
                "the radius is {} mm, and the nominal points and normals of its facets lie on a surface of {radius:.3} mm",
                curved.radius_mm
            );
            let mut error = Error::usage(message).help("which one is right? A hollow surface has a negative radius");
            error.setting =
                vec![PathItem::Key("curved".to_owned()), PathItem::Index(index), PathItem::Key("radius_mm".to_owned())];
            return Err(error);
        }
        Ok(())
    }

    fn read_nominal(&self) -> Result<Vec<Facet>> {
        let table = abbe_table::read(&self.nominal)?;
        abbe_table::unique_labels(&table, "feature")?;
        let labels = abbe_table::labels(&table, "feature")?;
        let points = abbe_table::points(&table, ["x", "y", "z"])?;
        let normals = abbe_table::vectors(&table, ["nx", "ny", "nz"])?;
        let rows = DataRow::enumerate(labels.iter().zip(points).zip(normals));
        rows.map(|(row, ((label, point), normal))| {
            let (label, point, normal) = (label.to_string(), Vector3::from(point), Vector3::from(normal));
            // Files round their normals; one that is far from a unit vector is a mistake and not a rounding.
            if (normal.norm() - 1.0).abs() > 1e-2 {
                let message = format!("the normal of facet {label} has length {:.4}; 1 was expected", normal.norm());
                return Err(table.error_at(row, message).help("nx, ny, nz are the outward unit normal"));
            }
            let normal = normal.normalize();
            let curved = self.surface(&label, normal).map_err(|message| table.error_at(row, message))?;
            Ok(Facet { label, point, normal, curved })
        })
        .collect()
    }
}

impl Artefact for Facets {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "nominal", path: self.nominal.clone() }]
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &plain_naming)?;
        abbe_probe::check_columns(headers, file, model)?;
        abbe_table::require(headers, file, &[("feature", Quantity::Label)])?;
        let nominal = abbe_table::read_headers(&self.nominal)?;
        let columns = [
            ("feature", Quantity::Label),
            ("x", Quantity::Length),
            ("y", Quantity::Length),
            ("z", Quantity::Length),
            ("nx", Quantity::Ratio),
            ("ny", Quantity::Ratio),
            ("nz", Quantity::Ratio),
        ];
        abbe_table::require(&nominal, Some(&self.nominal), &columns)
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        self.observe_some(data, model)?.ok_or_else(|| abbe_table::untouched(&self.nominal))
    }

    fn observe_some(
        &self,
        data: &Arc<Dataset>,
        model: &Arc<dyn KinematicModel>,
    ) -> Result<Option<Arc<dyn Observations>>> {
        let nominal = self.read_nominal()?;
        self.known(&nominal)?;
        self.as_nominal(&nominal)?;
        let by_label: BTreeMap<&str, usize> =
            nominal.iter().enumerate().map(|(index, facet)| (facet.label.as_str(), index)).collect();
        let labels = abbe_table::labels(data, "feature")?.iter();
        let of_rows: Vec<Option<usize>> = labels.map(|label| by_label.get(label.as_str()).copied()).collect();
        let Some(touched) = abbe_table::touched_by_some(&of_rows) else { return Ok(None) };
        let mut layout = Layout::new(data, model.as_ref(), &[&plain_naming])?;
        let uncertainty = self.settings.standard_uncertainty_um * 1e-3;
        for (row, _) in &touched.rows {
            layout.push(model.as_ref(), *row, &[uncertainty])?;
        }
        let facet_of_row: Vec<usize> = touched.rows.iter().map(|(_, facet)| *facet).collect();
        let facets: Vec<Facet> = touched.features.iter().map(|&facet| nominal[facet].clone()).collect();
        let unknowns = facets.iter().map(|facet| {
            Parameter::new(format!("facet[{}].d", facet.label), Unit::MM).with_role(ParameterRole::Feature)
        });
        let features = facets.iter().enumerate().map(|(index, facet)| Feature {
            label: facet.label.clone(),
            point: facet.point.into(),
            shifts: vec![(index, facet.normal.into())],
        });
        let uncertainty = self.settings.stylus_radius_standard_uncertainty_um * 1e-3;
        let radius = EffectiveRadius::new(model.as_ref(), &layout, uncertainty)?;
        let info = ObservationsInfo {
            inputs: radius.inputs().to_vec(),
            orientation: radius.orientation(),
            features: features.collect(),
            ..ObservationsInfo::new(layout, unknowns.collect(), Contact::LinearAxes)
        };
        let (model, beside) = (model.clone(), OnceLock::new());
        Ok(Some(Arc::new(Touches { info, facets, facet_of_row, radius, model, beside })))
    }

    fn rows_are_independent(&self) -> bool {
        true
    }

    fn targets(&self, stylus_radius: f64) -> Result<Vec<Target>> {
        let targets = self.read_nominal()?.into_iter().map(|facet| Target {
            tip: (facet.point + stylus_radius * facet.normal).into(),
            approach: Some((-facet.normal).into()),
            feature: facet.label,
        });
        Ok(targets.collect())
    }
}

/// How far beside its nominal point, mm, a facet may be touched and is still taken to be touched there. Commands that aim at the
/// point miss it by the errors of the machine, of the set-up and of earlier corrections; these are less. What is further beside it was
/// meant.
const AIMED_AT: f64 = 1.0;

/// Touches on facets.
struct Touches {
    info: ObservationsInfo,
    facets: Vec<Facet>,
    facet_of_row: Vec<usize>,
    radius: EffectiveRadius,
    model: Arc<dyn KinematicModel>,
    /// See [`Touches::beside`].
    beside: OnceLock<Vec<Vector3<f64>>>,
}

impl Touches {
    /// Where each touch lies beside the nominal point, in the plane of its facet or along the axis of its cylinder, by the nominal
    /// machine, mm. Zero for touches that were aimed at the point. Computed when it is asked for: an estimate passes its rows many times
    /// and needs it once.
    fn beside(&self) -> &[Vector3<f64>] {
        self.beside.get_or_init(|| beside(&self.facets, &self.facet_of_row, &self.info.layout, self.model.as_ref()))
    }
}

/// See [`Touches::beside`].
fn beside(facets: &[Facet], of_rows: &[usize], layout: &Layout, model: &dyn KinematicModel) -> Vec<Vector3<f64>> {
    let statuses: Vec<f64> = layout.poses.indices().flat_map(|pose| layout.poses.row(pose)).copied().collect();
    let mut poses = Poses::default();
    // A pose that the nominal machine does not have is refused where it is evaluated, with its row.
    if model.poses(&statuses, &model.info().nominal, &[], false, &mut poses).is_err() {
        return vec![Vector3::zeros(); of_rows.len()];
    }
    let beside = |(&facet, tip): (&usize, &[f64; 3])| {
        let Facet { point, normal, curved, .. } = &facets[facet];
        let from_point = Vector3::from(*tip) - point;
        let in_plane = from_point - from_point.dot(normal) * normal;
        let beside = match curved {
            None => in_plane,
            // The equation of a cylinder does not ask for the place along its axis. Round it, and on a sphere, the nominal point counts.
            Some(Surface { axis, .. }) => axis.map_or(Vector3::zeros(), |axis| axis.dot(&in_plane) * axis),
        };
        // A place that is not known is not beside the point.
        if beside.norm() > AIMED_AT { beside } else { Vector3::zeros() }
    };
    of_rows.iter().zip(&poses.positions).map(beside).collect()
}

impl Observations for Touches {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        for (pose, (&row, position)) in batch.rows.iter().zip(batch.positions).enumerate() {
            let index = self.facet_of_row[row];
            let (distance, outward, turning) = self.facets[index].distance(Vector3::from(*position));
            let radius = self.radius.at(row, pose, &batch, &outward);
            radius.write(distance - batch.own[index] - radius.value, &(outward - turning * radius.by_normal), out);
            out.own(index, -1.0);
        }
        Ok(())
    }

    fn contact_tip(&self, row: RowIndex, _: [f64; 3], own: &[f64], inputs: &[f64]) -> Result<Option<[f64; 3]>> {
        if !self.radius.is_constant(inputs) {
            return Ok(None);
        }
        let (facet, beside) = (self.facet_of_row[row], self.beside()[row]);
        let Facet { point, normal, .. } = &self.facets[facet];
        Ok(Some((point + beside + (own[facet] + inputs[0]) * normal).into()))
    }
}
