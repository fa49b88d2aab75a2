//! Artefact plugin `balls`: balls touched with the machine's probe, or their centres fitted already.
//!
//! Equations: one touch `|p - P - c| - R - r = 0`; a fitted centre `p - P - c = 0` (three equations); a calibrated
//! distance between two balls `|P2 + c2 - P1 - c1| - L = 0`. p is the tip and P the nominal centre in the table frame, c
//! the ball's own offset, R its radius, r the effective stylus radius.

mod centres;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    Artefact, ColumnHeader, Contact, Context, DataRow, Dataset, Equations, Error, Feature, InputFile, KinematicModel,
    KnownInput, Label, Layout, Observations, ObservationsInfo, Parameter, ParameterRole, PathItem, Quantity, Result,
    RowBatch, RowIndex, SettingsError, Target, Unit, not_negative, plain_naming, pose_columns, positive,
};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

abbe_core::register!(
    Artefact,
    "balls",
    "touches on balls or their fitted centres, with calibrated distances between balls",
    Settings,
    example,
    build,
    "../reference/artefact-balls.md",
);

/// Settings of the balls.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the nominal balls: feature, x_mm, y_mm, z_mm, diameter_mm in the table frame.
    nominal: String,
    /// Standard uncertainty of one touch, or of each coordinate of a centre.
    standard_uncertainty_um: f64,
    /// What a data row is.
    #[serde(default)]
    rows: Rows,
    /// Fit the centre of every ball first, from its touches with the same label in this column (the indexation), and
    /// use the centres as observations instead of the touches.
    #[serde(default)]
    centres_by: Option<String>,
    /// Whether the radius of every ball is known or estimated (`ball[1].radius`, its deviation from nominal).
    #[serde(default)]
    radius: Radius,
    /// Calibrated distances between centres.
    #[serde(default)]
    distances: Vec<Distance>,
    /// Standard uncertainty of the effective stylus radius, shared by all touches.
    #[serde(default)]
    stylus_radius_standard_uncertainty_um: f64,
}

/// What a data row is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Rows {
    /// One touch.
    #[default]
    Touches,
    /// The machine position with the tip at the centre of a ball.
    Centres,
}

/// Whether the radius is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Radius {
    /// It is known: that of the nominal file.
    #[default]
    Known,
    /// It is estimated.
    Estimated,
}

/// A calibrated distance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Distance {
    /// The two balls.
    between: [Label; 2],
    /// Distance of their centres.
    length_mm: f64,
    /// Its standard uncertainty.
    standard_uncertainty_um: f64,
}

fn example() -> Value {
    json!({
        "nominal": "balls.csv",
        "standard_uncertainty_um": 1.0,
        "distances": [{ "between": [1, 2], "length_mm": 304.6686, "standard_uncertainty_um": 0.5 }],
    })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    not_negative("stylus_radius_standard_uncertainty_um", settings.stylus_radius_standard_uncertainty_um)?;
    if settings.centres_by.is_some() && settings.rows == Rows::Centres {
        return Err(SettingsError::new("centres_by", "the rows are centres already"));
    }
    if settings.rows == Rows::Centres && settings.stylus_radius_standard_uncertainty_um > 0.0 {
        let message = "how the centres depend on the stylus radius is not known: their touches are";
        return Err(SettingsError::new("stylus_radius_standard_uncertainty_um", message)
            .help("fit them from touches with `centres_by`, or state what their rows share under `uncertainty`"));
    }
    if settings.centres_by.is_some() && settings.radius == Radius::Estimated {
        return Err(SettingsError::new("centres_by", "centres are fitted with known radii; they cannot tell radii")
            .help("leave out `centres_by`, or `radius: estimated`"));
    }
    for (index, distance) in settings.distances.iter().enumerate() {
        let at = |error: SettingsError| error.under([PathItem::Key("distances".to_owned()), PathItem::Index(index)]);
        positive("length_mm", distance.length_mm).map_err(at)?;
        positive("standard_uncertainty_um", distance.standard_uncertainty_um).map_err(at)?;
        if distance.between[0] == distance.between[1] {
            return Err(at(SettingsError::new("between", "two different balls were expected")));
        }
        let [one, other] = &distance.between;
        let same = |earlier: &Distance| earlier.between.contains(one) && earlier.between.contains(other);
        if settings.distances[..index].iter().any(same) {
            return Err(at(SettingsError::new("between", "the distance of these balls stands here a second time")));
        }
    }
    Ok(Box::new(Balls { nominal: context.path(&settings.nominal), settings }))
}

struct Balls {
    nominal: PathBuf,
    settings: Settings,
}

/// A nominal ball, table frame.
#[derive(Debug, Clone, PartialEq)]
struct Ball {
    label: String,
    centre: Vector3<f64>,
    radius: f64,
}

impl Balls {
    fn read_nominal(&self) -> Result<Vec<Ball>> {
        let table = abbe_table::read(&self.nominal)?;
        abbe_table::unique_labels(&table, "feature")?;
        let labels = abbe_table::labels(&table, "feature")?;
        let points = abbe_table::points(&table, ["x", "y", "z"])?;
        let diameters = abbe_table::numbers(&table, "diameter", Quantity::Length)?;
        let rows = DataRow::enumerate(labels.iter().zip(points).zip(diameters));
        rows.map(|(row, ((label, point), diameter))| {
            if *diameter <= 0.0 {
                return Err(table.error_at(row, format!("ball {label} has the diameter {diameter} mm")));
            }
            Ok(Ball { label: label.clone(), centre: Vector3::from(point), radius: diameter / 2.0 })
        })
        .collect()
    }

    /// The ball of every data row: by the column `feature`, or the only ball there is.
    fn ball_of_rows(&self, data: &Dataset, nominal: &[Ball]) -> Result<Vec<Option<usize>>> {
        if data.column("feature").is_none() && nominal.len() == 1 {
            return Ok(vec![Some(0); data.rows()]);
        }
        let by_label: BTreeMap<&str, usize> =
            nominal.iter().enumerate().map(|(index, ball)| (ball.label.as_str(), index)).collect();
        Ok(abbe_table::labels(data, "feature")?.iter().map(|label| by_label.get(label.as_str()).copied()).collect())
    }
}

impl Balls {
    /// Data rows as they are, with the ball of each.
    fn rows(
        &self,
        data: &Arc<Dataset>,
        model: &dyn KinematicModel,
        touched: &[(DataRow, usize)],
        uncertainty: f64,
    ) -> Result<(Layout, Vec<usize>)> {
        let mut layout = Layout::new(data, model, &[&plain_naming])?;
        let uncertainties = match self.settings.rows {
            Rows::Touches => vec![uncertainty],
            Rows::Centres => vec![uncertainty; 3],
        };
        for (row, _) in touched {
            layout.push(model, *row, &uncertainties)?;
        }
        Ok((layout, touched.iter().map(|(_, ball)| *ball).collect()))
    }
}

impl Artefact for Balls {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "nominal", path: self.nominal.clone() }]
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &plain_naming)?;
        let nominal = abbe_table::read_headers(&self.nominal)?;
        let columns = [
            ("feature", Quantity::Label),
            ("x", Quantity::Length),
            ("y", Quantity::Length),
            ("z", Quantity::Length),
            ("diameter", Quantity::Length),
        ];
        abbe_table::require(&nominal, Some(&self.nominal), &columns)
    }

    fn observe(&self, data: &Arc<Dataset>, model: &dyn KinematicModel) -> Result<Arc<dyn Observations>> {
        let nominal = self.read_nominal()?;
        let uncertainty = self.settings.standard_uncertainty_um * 1e-3;
        let of_rows = self.ball_of_rows(data, &nominal)?;
        let touched = abbe_table::touched(&of_rows, &self.nominal)?;
        let balls: Vec<Ball> = touched.features.iter().map(|&ball| nominal[ball].clone()).collect();
        let (mut layout, ball_of_row, centre_by_radius) = match &self.settings.centres_by {
            Some(by) => {
                let found = centres::of_touches(data, model, &touched.rows, &balls, by, uncertainty)?;
                (found.layout, found.ball_of_row, found.by_radius)
            }
            None => {
                let (layout, balls) = self.rows(data, model, &touched.rows, uncertainty)?;
                (layout, balls, Vec::new())
            }
        };

        let mut unknowns = Vec::new();
        let estimated = self.settings.radius == Radius::Estimated;
        for ball in &balls {
            for own in ["x", "y", "z", "radius"].iter().take(if estimated { 4 } else { 3 }) {
                let parameter = Parameter::new(format!("ball[{}].{own}", ball.label), Unit::MM);
                unknowns.push(parameter.with_role(ParameterRole::Feature));
            }
        }
        let of_radius = self.settings.stylus_radius_standard_uncertainty_um * 1e-3;
        let mut inputs = vec![KnownInput::stylus_radius(model, of_radius)];
        let mut distances = Vec::new();
        for distance in &self.settings.distances {
            let find = |label: &Label| {
                balls.iter().position(|ball| ball.label == label.0).ok_or_else(|| {
                    Error::data(format!("`distances` names ball {}, which was not touched", label.0))
                        .setting("distances")
                        .suggest(&label.0, balls.iter().map(|ball| ball.label.as_str()))
                })
            };
            let [from, to] = &distance.between;
            let (one, other) = (find(from)?, find(to)?);
            if balls[one].centre == balls[other].centre {
                let message = format!("balls {} and {} have the same nominal centre, and a distance", from.0, to.0);
                return Err(Error::data(message).setting("distances"));
            }
            distances.push((one, other));
            let (length, uncertainty) = (distance.length_mm, distance.standard_uncertainty_um * 1e-3);
            layout.push_constraint(&[uncertainty]);
            let name = format!("length[{}-{}]", from.0, to.0);
            let content = format!("distance of balls {} and {}: {length:e} mm, u = {uncertainty:e} mm", from.0, to.0);
            let parameter = Parameter::new(&name, Unit::MM);
            inputs.push(KnownInput::new(parameter, length, uncertainty).with_certificate(name, content));
        }
        let rows = if self.settings.centres_by.is_some() { Rows::Centres } else { self.settings.rows };
        let features = balls.iter().enumerate().map(|(index, ball)| {
            let first = first_own(index, estimated);
            Feature {
                label: ball.label.clone(),
                point: ball.centre.into(),
                shifts: vec![(first, [1.0, 0.0, 0.0]), (first + 1, [0.0, 1.0, 0.0]), (first + 2, [0.0, 0.0, 1.0])],
            }
        });
        let features = features.collect();
        let info =
            ObservationsInfo { inputs, features, ..ObservationsInfo::new(layout, unknowns, Contact::LinearAxes) };
        Ok(Arc::new(Touches { info, balls, ball_of_row, centre_by_radius, distances, rows, estimated }))
    }

    fn targets(&self, stylus_radius: f64) -> Result<Vec<Target>> {
        // Four touches on the equator and one on the pole, the usual pattern (Rahman 2016, section 2.3.3.6).
        let diagonal = std::f64::consts::FRAC_1_SQRT_2;
        let outward = [(1.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (0.0, 0.0, 1.0)]
            .map(|(x, y, z): (f64, f64, f64)| Vector3::new(diagonal * x, diagonal * y, z));
        let mut targets = Vec::new();
        for ball in self.read_nominal()? {
            let centre = Target { feature: ball.label.clone(), tip: ball.centre.into(), approach: None };
            match self.settings.rows {
                Rows::Centres => targets.push(centre),
                Rows::Touches => targets.extend(outward.iter().map(|normal| Target {
                    feature: ball.label.clone(),
                    tip: (ball.centre + (ball.radius + stylus_radius) * normal).into(),
                    approach: Some((-normal).into()),
                })),
            }
        }
        Ok(targets)
    }
}

/// Touches on balls.
struct Touches {
    info: ObservationsInfo,
    balls: Vec<Ball>,
    ball_of_row: Vec<usize>,
    /// Of centres that were fitted: their derivative to the stylus radius.
    centre_by_radius: Vec<Vector3<f64>>,
    distances: Vec<(usize, usize)>,
    rows: Rows,
    estimated: bool,
}

/// Index of the first unknown of a ball, whose radius may be estimated, too.
fn first_own(ball: usize, estimated: bool) -> usize {
    ball * if estimated { 4 } else { 3 }
}

impl Touches {
    fn first_own(&self, ball: usize) -> usize {
        first_own(ball, self.estimated)
    }

    fn centre(&self, ball: usize, own: &[f64]) -> Vector3<f64> {
        let first = self.first_own(ball);
        self.balls[ball].centre + Vector3::new(own[first], own[first + 1], own[first + 2])
    }

    /// What another stylus radius than that of the fit changes in the centre of a row.
    fn by_stylus(&self, row: usize, inputs: &[f64]) -> Vector3<f64> {
        let by_radius = self.centre_by_radius.get(row).copied().unwrap_or_default();
        by_radius * (inputs[0] - self.info.inputs[0].value)
    }

    /// Derivatives to the offsets of a ball's centre.
    fn by_centre(&self, ball: usize, derivative: Vector3<f64>, out: &mut Equations) {
        for (axis, value) in derivative.iter().enumerate() {
            out.own(self.first_own(ball) + axis, *value);
        }
    }
}

impl Observations for Touches {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        let RowBatch { rows, own, inputs, .. } = batch;
        let mut positions = batch.positions.iter();
        for &RowIndex(row) in rows {
            let Some(&ball) = self.ball_of_row.get(row) else {
                let distance = row - self.ball_of_row.len();
                let (from, to) = self.distances[distance];
                let between = self.centre(to, own) - self.centre(from, own);
                out.equation(between.norm() - inputs[1 + distance]);
                self.by_centre(to, between.normalize(), out);
                self.by_centre(from, -between.normalize(), out);
                out.input(1 + distance, -1.0);
                continue;
            };
            let Some(position) = positions.next() else { break };
            let from_centre = Vector3::from(*position) - self.centre(ball, own);
            match self.rows {
                Rows::Touches => {
                    let radius = if self.estimated { own[self.first_own(ball) + 3] } else { 0.0 };
                    let normal = from_centre.normalize();
                    out.equation(from_centre.norm() - self.balls[ball].radius - radius - inputs[0]);
                    out.position(normal.into());
                    self.by_centre(ball, -normal, out);
                    if self.estimated {
                        out.own(self.first_own(ball) + 3, -1.0);
                    }
                    out.input(0, -1.0);
                }
                Rows::Centres => {
                    let off = from_centre + self.by_stylus(row, inputs);
                    for axis in 0..3 {
                        let mut unit = [0.0; 3];
                        unit[axis] = 1.0;
                        out.equation(off[axis]);
                        out.position(unit);
                        out.own(self.first_own(ball) + axis, -1.0);
                        if let Some(by_radius) = self.centre_by_radius.get(row) {
                            out.input(0, by_radius[axis]);
                        }
                    }
                }
            }
        }
        Ok(())
    }

    fn contact_tip(
        &self,
        RowIndex(row): RowIndex,
        tip: [f64; 3],
        own: &[f64],
        inputs: &[f64],
    ) -> Result<Option<[f64; 3]>> {
        let Some(&ball) = self.ball_of_row.get(row) else { return Ok(None) };
        let centre = self.centre(ball, own);
        if self.rows == Rows::Centres {
            return Ok(Some((centre - self.by_stylus(row, inputs)).into()));
        }
        let Some(outward) = (Vector3::from(tip) - centre).try_normalize(0.0) else { return Ok(None) };
        let more = if self.estimated { own[self.first_own(ball) + 3] } else { 0.0 };
        let distance = self.balls[ball].radius + more + inputs[0];
        Ok(Some((centre + distance * outward).into()))
    }
}
