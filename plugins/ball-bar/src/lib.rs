//! Double ball bar: artefact plugin `ball-bar`, and ingest plugin `ball-bar` for its tests of rotary axes.
//!
//! Equation: `|p - P - c| - (L + reading) = 0` with the tool ball at the tip p, the nominal centre P of a pivot ball in the table
//! frame, the pivot's offset c (unknown), and the length L from which readings are counted. One artefact stage takes all tests that
//! share pivot balls, so that a ball that was not moved between two tests has one offset (Jiang & Cripps 2015, section 3).

mod diagnosis;
mod ingest;
mod nominal;
mod observed;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    AboveZero, Artefact, ColumnHeader, Contact, Context, DataRow, Dataset, Error, InputFile, KinematicModel,
    KnownInput, LabelText, Layout, Observations, ObservationsInfo, Orientation, Parameter, ParameterRole, PathItem,
    Quantity, RankPoint, Result, SettingsError, Target, Unit, not_negative, plain_naming, pose_columns, positive,
};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use observed::{Ball, Bar, Observed, TOOL_BALL, features};

abbe_core::register!(
    Artefact,
    "ball-bar",
    "lengths of a double ball bar between the tool ball and pivot balls on the table",
    Settings,
    example,
    build,
    "../reference/artefact-ball-bar.md",
);

/// Settings of the ball bar.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the nominal pivot balls: feature, x_mm, y_mm, z_mm in the table frame. The column `ball` of the data names
    /// the ball of every row; with a single ball it may be missing.
    nominal: String,
    /// The bars by their labels in the column `bar` of the data, and the length of each from which its readings are counted; with
    /// a single bar the column may be missing.
    bars_mm: BTreeMap<String, f64>,
    /// Standard uncertainty of one reading.
    #[schemars(with = "AboveZero")]
    standard_uncertainty_um: f64,
    /// Whether a reading follows errors exactly, or to first order, as usual diagnoses of circles take it.
    #[serde(default)]
    evaluation: Evaluation,
    /// Whether the lengths are known, or estimated: `bar[100].length`.
    #[serde(default)]
    lengths: Lengths,
    /// Standard uncertainty of known lengths, shared by all readings with a bar.
    #[serde(default)]
    length_standard_uncertainty_um: f64,
    /// Standard uncertainty, in each direction, of the tool ball's place relative to the tip, shared by all readings: how well
    /// the ball is aligned with the spindle and how well its height is known.
    #[serde(default)]
    tool_ball_standard_uncertainty_um: f64,
}

/// How readings follow errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Evaluation {
    /// By the distance of the two balls.
    #[default]
    Exact,
    /// By the part of their offset along the nominal direction of the bar; with `evaluation: first-order` of the machine readings are
    /// linear in its errors.
    FirstOrder,
}

/// Whether the lengths are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Lengths {
    /// They are known: the lengths of the settings.
    #[default]
    Known,
    /// They are estimated: unknowns of the artefact.
    Estimated,
}

fn example() -> Value {
    json!({
        "nominal": "balls.csv",
        "bars_mm": { "100": 100.0, "150": 150.0 },
        "standard_uncertainty_um": 0.5,
        "tool_ball_standard_uncertainty_um": 0.2,
    })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    not_negative("length_standard_uncertainty_um", settings.length_standard_uncertainty_um)?;
    not_negative("tool_ball_standard_uncertainty_um", settings.tool_ball_standard_uncertainty_um)?;
    if settings.bars_mm.is_empty() {
        return Err(SettingsError::new("bars_mm", "a ball bar has a length").help("write `bars_mm: { 100: 100.0 }`"));
    }
    for (label, length) in &settings.bars_mm {
        positive(label, *length).map_err(|error| error.under([PathItem::Key("bars_mm".to_owned())]))?;
    }
    if settings.lengths == Lengths::Estimated && settings.length_standard_uncertainty_um > 0.0 {
        let message = "lengths that are estimated are not known to a standard uncertainty";
        return Err(SettingsError::new("length_standard_uncertainty_um", message)
            .help("leave out `length_standard_uncertainty_um`, or `lengths: estimated`"));
    }
    Ok(Box::new(BallBar { nominal: context.path(&settings.nominal), settings }))
}

struct BallBar {
    nominal: PathBuf,
    settings: Settings,
}

impl BallBar {
    fn read_nominal(&self) -> Result<Vec<Ball>> {
        let table = abbe_table::read(&self.nominal)?;
        abbe_table::unique_labels(&table, "feature")?;
        let labels = abbe_table::labels(&table, "feature")?;
        let centres = abbe_table::points(&table, ["x", "y", "z"])?;
        let balls = labels.iter().zip(centres);
        Ok(balls.map(|(label, centre)| Ball { label: label.to_string(), centre: Vector3::from(centre) }).collect())
    }
}

/// The place of every row's label among `known`: by a column, or the only one there is.
fn places(data: &Dataset, column: &str, known: &[&str], what: &str) -> Result<Vec<usize>> {
    if data.column(column).is_none() && known.len() == 1 {
        return Ok(vec![0; data.rows()]);
    }
    let labels = DataRow::enumerate(abbe_table::labels(data, column)?);
    let place = |(row, label): (DataRow, &LabelText)| {
        known.iter().position(|known| known == label).ok_or_else(|| {
            let error = data.error_at(row, format!("{column} {label} is not among {what}"));
            error.help(format!("there are: {}", known.join(", ")))
        })
    };
    labels.map(place).collect()
}

/// A place or a length of the artefact.
fn feature(name: String) -> Parameter {
    Parameter::new(name, Unit::MM).with_role(ParameterRole::Feature)
}

/// The known or unknown lengths of the bars that are used, in the order of their labels.
fn bars(settings: &Settings, used: &[&str], unknowns: &mut Vec<Parameter>, inputs: &mut Vec<KnownInput>) -> Vec<Bar> {
    let bar = |label: &&str| {
        let nominal = settings.bars_mm[*label];
        let parameter = feature(format!("bar[{label}].length"));
        match settings.lengths {
            Lengths::Estimated => {
                unknowns.push(parameter);
                Bar::Unknown { own: unknowns.len() - 1, nominal }
            }
            Lengths::Known => {
                let uncertainty = settings.length_standard_uncertainty_um * 1e-3;
                let content = format!("ball bar {label}: {nominal:e} mm, u = {uncertainty:e} mm");
                inputs.push(KnownInput::new(parameter, nominal, uncertainty).with_certificate("length", content));
                Bar::Known { input: inputs.len() - 1 }
            }
        }
    };
    used.iter().map(bar).collect()
}

/// The labels that some rows use, and for every row the place of its label among them.
fn used<'a>(labels: &[&'a str], of_rows: &[usize]) -> (Vec<&'a str>, Vec<usize>) {
    let mut places: Vec<usize> = of_rows.to_vec();
    places.sort_unstable();
    places.dedup();
    let rows = of_rows.iter().map(|place| places.partition_point(|other| other < place));
    (places.iter().map(|&place| labels[place]).collect(), rows.collect())
}

impl Artefact for BallBar {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "nominal", path: self.nominal.clone() }]
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &plain_naming)?;
        abbe_table::require(headers, file, &[("reading", Quantity::Length)])?;
        if self.settings.bars_mm.len() > 1 {
            abbe_table::require(headers, file, &[("bar", Quantity::Label)])?;
        }
        let columns =
            [("feature", Quantity::Label), ("x", Quantity::Length), ("y", Quantity::Length), ("z", Quantity::Length)];
        abbe_table::require(&abbe_table::read_headers(&self.nominal)?, Some(&self.nominal), &columns)
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        let model = model.as_ref();
        let nominal = self.read_nominal()?;
        let labels: Vec<&str> = nominal.iter().map(|ball| ball.label.as_str()).collect();
        let ball_of_rows = places(data, "ball", &labels, "the nominal balls")?;
        let (balls, ball_of_row) = used(&labels, &ball_of_rows);
        let balls: Vec<Ball> = nominal.iter().filter(|ball| balls.contains(&ball.label.as_str())).cloned().collect();
        let labels: Vec<&str> = self.settings.bars_mm.keys().map(String::as_str).collect();
        let bar_of_rows = places(data, "bar", &labels, "`bars_mm`")?;
        let (used_bars, bar_of_row) = used(&labels, &bar_of_rows);
        let readings = abbe_table::numbers(data, "reading", Quantity::Length)?.to_vec();

        let mut layout = Layout::new(data, model, &[&plain_naming])?;
        for (row, bar) in DataRow::enumerate(&bar_of_row) {
            let length = self.settings.bars_mm[used_bars[*bar]] + readings[row];
            if length <= 0.0 {
                let message = format!("the measured length is {length} mm; a positive one was expected");
                return Err(data.error_at(row, message).help("readings are the length minus that of the bar"));
            }
            layout.push(model, row, &[self.settings.standard_uncertainty_um * 1e-3])?;
        }
        let own = |ball: &Ball, axis: &str| feature(format!("ball[{}].{axis}", ball.label));
        let mut unknowns: Vec<Parameter> =
            balls.iter().flat_map(|ball| ["x", "y", "z"].map(|axis| own(ball, axis))).collect();
        let mut inputs = Vec::new();
        let aligned = self.settings.tool_ball_standard_uncertainty_um * 1e-3;
        if aligned > 0.0 {
            let parameter = |name: &str| Parameter::new(name, Unit::MM);
            inputs.extend(TOOL_BALL.map(|name| KnownInput::new(parameter(name), 0.0, aligned).shared()));
        }
        let bars = bars(&self.settings, &used_bars, &mut unknowns, &mut inputs);
        let tool_ball = aligned > 0.0;
        let mut info = ObservationsInfo {
            inputs,
            features: features(&balls),
            orientation: if tool_ball { Orientation::Exact } else { Orientation::Unused },
            ..ObservationsInfo::new(layout, unknowns, Contact::Reading("reading".to_owned()))
        };
        for bar in &bars {
            if let Bar::Unknown { own, nominal } = bar {
                info.start[*own] = *nominal;
            }
        }
        let mut observed =
            Observed { directions: None, info, balls, ball_of_row, bars, bar_of_row, readings, tool_ball };
        let rows = nominal::rows(&observed, model)?;
        observed.info.rank_point = RankPoint::NominalReading(nominal::readings(&observed, model, &rows));
        if self.settings.evaluation == Evaluation::FirstOrder {
            observed.directions = Some(rows.iter().map(|row| row.direction).collect());
        }
        Ok(Arc::new(observed))
    }

    /// The tool ball around each pivot ball, at the length of the bar, in the 25 directions of ISO 10360-5. With several bars the data
    /// rows are the programme.
    fn targets(&self, _: f64) -> Result<Vec<Target>> {
        let Some(length) = self.settings.bars_mm.values().next().filter(|_| self.settings.bars_mm.len() == 1) else {
            return Ok(Vec::new());
        };
        let directions = abbe_standards::probing::hemisphere_of_25().map(Vector3::from);
        let around = |ball: &Ball| {
            directions.map(|outwards| Target {
                feature: ball.label.clone(),
                tip: (ball.centre + outwards * *length).into(),
                approach: Some((-outwards).into()),
            })
        };
        Ok(self.read_nominal()?.iter().flat_map(around).collect())
    }
}

/// The error for a bar whose balls would coincide.
fn at_the_pivot(data: &Dataset, row: DataRow, label: &str) -> Error {
    let error = data.error_at(row, format!("the tool ball stands in the centre of ball {label}: no bar fits between"));
    error.help("are the axis positions those of the test, and the nominal balls in the table frame?")
}

#[cfg(test)]
mod tests;
