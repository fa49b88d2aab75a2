//! Runs: the readings of one turning spindle at one speed.

use std::borrow::Cow;
use std::f64::consts::TAU;
use std::ops::Range;

use abbe_core::{ColumnHeader, DataRow, Dataset, Error, Quantity, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::encoder::{self, Encoder};
use crate::sensors::check_sensor;
use crate::speed::Speeds;

/// Where readings stand in their columns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Columns {
    /// The column of the angle of the spindle, without its unit.
    #[serde(default = "angle")]
    pub angle: String,
    /// The column of the time, without its unit.
    #[serde(default = "time")]
    pub time: String,
    /// The column of labels that tells runs apart, where there is one: rows of one label are one run.
    #[serde(default = "run")]
    pub run: String,
}

fn angle() -> String {
    "S".to_owned()
}

fn time() -> String {
    "time".to_owned()
}

fn run() -> String {
    "file".to_owned()
}

impl Default for Columns {
    fn default() -> Self {
        Self { angle: angle(), time: time(), run: run() }
    }
}

/// What readings have to be like.
pub struct Expected<'a> {
    pub columns: &'a Columns,
    pub encoder: Encoder,
    /// The columns of the sensors.
    pub sensors: Vec<&'a str>,
    /// The axial one of them, if there is one.
    pub axial: Option<&'a str>,
    /// Smallest and largest range of the readings of a sensor, mm.
    pub plausible: [f64; 2],
    /// Speeds that a run may have.
    pub speeds: Speeds<'a>,
}

/// Fails if readings with these columns cannot be used.
pub fn check_columns(expected: &Expected<'_>, headers: &[Vec<ColumnHeader>]) -> Result<()> {
    let Columns { angle, time, run } = expected.columns;
    let each = |name: &str, quantity: Quantity, setting: &[&str]| {
        let mut headers = headers.iter().enumerate();
        headers.try_for_each(|(place, headers)| {
            check_column(place, headers, name, quantity).map_err(|error| error.setting_at(setting))
        })
    };
    each(angle, Quantity::Angle, &["columns", "angle"])?;
    each(time, Quantity::Time, &["columns", "time"])?;
    // Rows know their file without a column.
    if *run != self::run() {
        each(run, Quantity::Label, &["columns", "run"])?;
    }
    expected.sensors.iter().try_for_each(|sensor| match expected.axial == Some(*sensor) {
        true => each(sensor, Quantity::Length, &["axial"]),
        false => each(sensor, Quantity::Length, &["radial", sensor]),
    })
}

/// Fails if the data set at this place under `from` has no such column.
pub fn check_column(place: usize, headers: &[ColumnHeader], name: &str, quantity: Quantity) -> Result<()> {
    let usual = if quantity == Quantity::Length { "_um" } else { quantity.usual_suffix() };
    let message = match headers.iter().find(|header| header.name == name) {
        Some(header) if header.quantity == quantity => return Ok(()),
        Some(header) => format!("has a column `{}`, and `{name}{usual}` was expected", header.header),
        None => format!("has no column `{name}{usual}`"),
    };
    let message = format!("data set {} under `from` {message}", place + 1);
    let names = headers.iter().map(|header| header.name.as_str());
    Err(Error::usage(message).suggest(name, names).setting("from"))
}

/// The readings of a run, all of the same length.
pub struct Run<'a> {
    data: &'a Dataset,
    rows: Range<usize>,
    /// Its label, or that of its file.
    pub label: String,
    /// Angle of the spindle, rad, counted on.
    pub angles: Cow<'a, [f64]>,
    /// s
    pub times: &'a [f64],
    /// Readings of each sensor, mm.
    pub readings: Vec<&'a [f64]>,
    /// Turns, the step behind the last reading included.
    pub turns: f64,
    /// Mean speed, revolutions per minute, above zero.
    pub speed: f64,
}

impl<'a> Run<'a> {
    /// An error at one of its readings.
    pub fn error_at(&self, index: usize, message: String) -> Error {
        self.data.error_at(DataRow(self.rows.start + index), message)
    }

    /// An error about the run as a whole.
    pub fn error(&self, message: impl std::fmt::Display) -> Error {
        let file = self.data.origins.get(self.rows.start).and_then(|origin| self.data.files.get(origin.file));
        let error = Error::data(format!("run `{}`: {message}", self.label));
        match file {
            Some(file) => error.in_file(file),
            None => error,
        }
    }

    /// Whole turns: what remains belongs to the last one.
    pub fn whole_turns(&self) -> usize {
        (self.turns + 1e-6).floor() as usize
    }

    /// Whether its angle grows.
    pub fn is_forward(&self) -> bool {
        self.angles.first().zip(self.angles.last()).is_some_and(|(first, last)| last > first)
    }

    /// The turn of a reading, from 0.
    pub fn turn(&self, index: usize) -> usize {
        let turned = (self.angles[index] - self.angles[0]).abs() / TAU;
        ((turned + 1e-9).floor() as usize).min(self.whole_turns().saturating_sub(1))
    }

    fn new(data: &'a Dataset, rows: Range<usize>, label: String, expected: &Expected<'_>) -> Result<Self> {
        let part = |name: &str| -> Result<&'a [f64]> { Ok(&data.required_numbers(name)?[rows.clone()]) };
        let Columns { angle, time, .. } = expected.columns;
        let readings = expected.sensors.iter().map(|sensor| part(sensor)).collect::<Result<Vec<_>>>()?;
        let angles = expected.encoder.counted(part(angle)?);
        let mut run =
            Self { data, rows: rows.clone(), label, angles, times: part(time)?, readings, turns: 0.0, speed: 0.0 };
        encoder::check(&mut run, expected.encoder)?;
        expected.speeds.check(&run)?;
        for (name, readings) in expected.sensors.iter().zip(&run.readings) {
            check_sensor(&run, name, readings, expected.plausible)?;
        }
        Ok(run)
    }
}

/// The runs of data sets, in their order.
///
/// Fails for encoders that slip, turns that are missing, readings that are clipped, stuck or in a wrong unit.
pub fn runs<'a>(data: &[&'a Dataset], expected: &Expected<'_>) -> Result<Vec<Run<'a>>> {
    let mut runs: Vec<Run<'a>> = Vec::new();
    for data in data {
        for (label, rows) in labelled(data, &expected.columns.run)? {
            runs.push(Run::new(data, rows, label, expected)?);
        }
    }
    Ok(runs)
}

/// Labels and their rows.
fn labelled(data: &Dataset, column: &str) -> Result<Vec<(String, Range<usize>)>> {
    let Some(labels) = data.labels(column) else {
        let file = data.files.first().and_then(|file| file.file_stem());
        let label = file.map_or(String::new(), |stem| stem.to_string_lossy().into_owned());
        return Ok(vec![(label, 0..data.rows())]);
    };
    let mut found: Vec<(String, Range<usize>)> = Vec::new();
    for (row, label) in labels.iter().enumerate() {
        if let Some((last, rows)) = found.last_mut()
            && last == label
        {
            rows.end = row + 1;
            continue;
        }
        if found.iter().any(|(other, _)| other == label) {
            let message = format!("the run `{label}` goes on here, behind readings of another one");
            return Err(data.error_at(DataRow(row), message).help("readings of a run have to follow one another"));
        }
        found.push((label.clone(), row..row + 1));
    }
    Ok(found)
}
