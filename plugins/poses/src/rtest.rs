//! Artefact plugin `r-test`: a ball on the table that three displacement sensors follow, or a self-centring probe: R-tests.
//!
//! Equation: `p - P - c - reading = 0` with the tip p, the nominal centre P of the ball in the table frame and its offset c. The
//! readings are along the directions of the tool or of the table.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    AboveZero, Artefact, AxisKind, ColumnHeader, Contact, Context, DataRow, Dataset, Equations, Feature, InputFile,
    KinematicModel, LabelText, Layout, NominalReading, Observations, ObservationsInfo, Orientation, Parameter,
    ParameterRole, Quantity, RankPoint, Result, RowBatch, RowIndex, SettingsError, Target, Unit, plain_naming,
    pose_columns, positive,
};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::nominal_tools;

abbe_core::register!(
    Artefact,
    "r-test",
    "readings of three sensors at a ball, or of a self-centring probe: R-tests",
    Settings,
    example,
    build,
    "../reference/artefact-r-test.md",
);

/// Settings of R-tests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the nominal balls: feature, x_mm, y_mm, z_mm in the table frame. The column `ball` of the data names the ball of
    /// every row; with a single ball it may be missing.
    nominal: String,
    /// Standard uncertainty of each reading.
    #[schemars(with = "AboveZero")]
    standard_uncertainty_um: f64,
    /// The columns of the readings along x, y and z, without their unit: tip minus ball.
    #[serde(default = "readings")]
    readings: [String; 3],
    /// The directions of the readings.
    #[serde(default)]
    directions: Directions,
}

/// The directions of readings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Directions {
    /// Those of the tool: the sensors are in the spindle, the ball is on the table. Without rotary axes in the tool branch these are
    /// the directions of the machine.
    #[default]
    Tool,
    /// Those of the table: the sensors stand on the table, the ball is in the spindle.
    Table,
}

fn readings() -> [String; 3] {
    ["meas_x", "meas_y", "meas_z"].map(str::to_owned)
}

/// A row whose tip is further from the ball than its readings say, mm, is not of this test.
const NEAR: f64 = 10.0;

fn example() -> Value {
    json!({ "nominal": "balls.csv", "standard_uncertainty_um": 0.5 })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    Ok(Box::new(RTest { nominal: context.path(&settings.nominal), settings }))
}

struct RTest {
    nominal: PathBuf,
    settings: Settings,
}

/// A nominal ball, table frame.
struct Ball {
    label: String,
    centre: Vector3<f64>,
}

impl RTest {
    /// The nominal balls that some rows use, and the place of each row's ball among them.
    fn balls(&self, data: &Dataset) -> Result<(Vec<Ball>, Vec<usize>)> {
        let table = abbe_table::read(&self.nominal)?;
        abbe_table::unique_labels(&table, "feature")?;
        let labels = abbe_table::labels(&table, "feature")?;
        let centres = abbe_table::points(&table, ["x", "y", "z"])?;
        let places: Vec<usize> = if data.column("ball").is_none() && labels.len() == 1 {
            vec![0; data.rows()]
        } else {
            let place = |(row, label): (DataRow, &LabelText)| {
                labels.iter().position(|known| known == label).ok_or_else(|| {
                    let error = data.error_at(row, format!("ball {label} is not among the nominal balls"));
                    error.help(format!("there are: {}", labels.join(", ")))
                })
            };
            DataRow::enumerate(abbe_table::labels(data, "ball")?).map(place).collect::<Result<_>>()?
        };
        let mut used = places.clone();
        used.sort_unstable();
        used.dedup();
        let of_rows = places.iter().map(|place| used.partition_point(|other| other < place)).collect();
        let ball = |&place: &usize| Ball { label: labels[place].to_string(), centre: Vector3::from(centres[place]) };
        Ok((used.iter().map(ball).collect(), of_rows))
    }
}

impl Artefact for RTest {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "nominal", path: self.nominal.clone() }]
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &plain_naming)?;
        let readings = self.settings.readings.each_ref().map(|name| (name.as_str(), Quantity::Length));
        abbe_table::require(headers, file, &readings)?;
        let columns =
            [("feature", Quantity::Label), ("x", Quantity::Length), ("y", Quantity::Length), ("z", Quantity::Length)];
        abbe_table::require(&abbe_table::read_headers(&self.nominal)?, Some(&self.nominal), &columns)
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        let model = model.as_ref();
        let (balls, ball_of_row) = self.balls(data)?;
        let names = self.settings.readings.each_ref().map(String::as_str);
        let readings: Vec<Vector3<f64>> = abbe_table::points(data, names)?.into_iter().map(Vector3::from).collect();
        let mut layout = Layout::new(data, model, &[&plain_naming])?;
        for row in data.row_indices() {
            layout.push(model, row, &[self.settings.standard_uncertainty_um * 1e-3; 3])?;
        }
        for ((row, tool), (ball, reading)) in
            DataRow::enumerate(&nominal_tools(&layout, model)?).zip(ball_of_row.iter().zip(&readings))
        {
            let off = (tool.translation.vector - balls[*ball].centre).norm() - reading.norm();
            if off > NEAR {
                let message =
                    format!("the tip is {off:.1} mm further from ball {} than the readings", balls[*ball].label);
                return Err(data.error_at(row, message).help(
                    "are the axis positions those of the test, the nominal balls in the table frame, and the tool length that to the ball?",
                ));
            }
        }
        let own = |ball: &Ball, axis: &str| {
            Parameter::new(format!("ball[{}].{axis}", ball.label), Unit::MM).with_role(ParameterRole::Feature)
        };
        let unknowns = balls.iter().flat_map(|ball| ["x", "y", "z"].map(|axis| own(ball, axis))).collect();
        let of_tool = self.settings.directions == Directions::Tool;
        let info = ObservationsInfo {
            features: features(&balls),
            orientation: if of_tool { Orientation::Exact } else { Orientation::Unused },
            rank_point: RankPoint::NominalReading(nominal_readings(&layout, model, &readings)),
            ..ObservationsInfo::new(layout, unknowns, Contact::Readings(self.settings.readings.to_vec()))
        };
        Ok(Arc::new(Observed { info, balls, ball_of_row, readings, of_tool }))
    }

    /// The balls: the linear axes bring the tip to their centres, wherever rotary axes move them.
    fn targets(&self, _: f64) -> Result<Vec<Target>> {
        let table = abbe_table::read(&self.nominal)?;
        let labels = abbe_table::labels(&table, "feature")?;
        let centres = abbe_table::points(&table, ["x", "y", "z"])?;
        let ball = |(label, tip): (&LabelText, [f64; 3])| Target { feature: label.to_string(), tip, approach: None };
        Ok(labels.iter().zip(centres).map(ball).collect())
    }
}

/// The rows with readings of zero, to which the linear axes move: what they read comes from errors, and so do positions of a probe
/// that centres itself.
fn nominal_readings(
    layout: &Layout,
    model: &dyn KinematicModel,
    readings: &[Vector3<f64>],
) -> std::collections::BTreeMap<RowIndex, NominalReading> {
    let linear = model.info().axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Linear);
    let axes: Vec<usize> = linear.map(|(index, _)| index).collect();
    if axes.len() < 3 {
        return Default::default();
    }
    let nominal = |(row, reading): (RowIndex, &Vector3<f64>)| {
        (row, NominalReading { residuals: (-reading).as_slice().to_vec(), axes: axes.clone() })
    };
    layout.row_indices().zip(readings).map(nominal).collect()
}

/// The balls as features, each shifted by its three offsets.
fn features(balls: &[Ball]) -> Vec<Feature> {
    let unit = |axis: usize| std::array::from_fn(|index| if index == axis { 1.0 } else { 0.0 });
    let feature = |(index, ball): (usize, &Ball)| Feature {
        label: ball.label.clone(),
        point: ball.centre.into(),
        shifts: (0..3).map(|axis| (3 * index + axis, unit(axis))).collect(),
    };
    balls.iter().enumerate().map(feature).collect()
}

/// Readings of R-tests.
struct Observed {
    /// Own unknowns: three offsets for every ball.
    info: ObservationsInfo,
    balls: Vec<Ball>,
    ball_of_row: Vec<usize>,
    /// Tip minus ball, mm.
    readings: Vec<Vector3<f64>>,
    /// Whether readings are along the directions of the tool.
    of_tool: bool,
}

impl Observations for Observed {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        let own = batch.own;
        for (place, (&RowIndex(row), position)) in batch.rows.iter().zip(batch.positions).enumerate() {
            let directions = match batch.orientations.get(place) {
                Some(&[w, x, y, z]) if self.of_tool => {
                    UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)).to_rotation_matrix().into_inner()
                }
                _ => Matrix3::identity(),
            };
            let ball = self.ball_of_row[row];
            let centre = self.balls[ball].centre + Vector3::new(own[3 * ball], own[3 * ball + 1], own[3 * ball + 2]);
            let beside = Vector3::from(*position) - centre;
            for equation in 0..3 {
                let along = directions.column(equation).into_owned();
                out.equation(along.dot(&beside) - self.readings[row][equation]);
                out.position(along.into());
                (0..3).for_each(|axis| out.own(3 * ball + axis, -along[axis]));
                if self.of_tool {
                    // A rotation w turns the direction by w x along.
                    out.rotation(along.cross(&beside).into());
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
