//! Columns: where the readings of a spindle stand in a data set.

use abbe_core::{ColumnHeader, Error, Quantity, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::encoder::Encoder;
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
