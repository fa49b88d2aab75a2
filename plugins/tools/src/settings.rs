//! Settings of `tool-dimensions`: the master, repeatability, factors and limits.

use std::collections::BTreeMap;

use abbe_core::{AboveZero, Label, PathItem, SettingsError, positive};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// What a tool setter measures of a tool.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// From the gauge line to the tip.
    Length,
    /// Of the cutting circle.
    Radius,
}

impl Quantity {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Length, Self::Radius];

    /// As it stands in logs and results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Length => "length",
            Self::Radius => "radius",
        }
    }

    /// Its place in a pair.
    pub fn index(self) -> usize {
        self as usize
    }
}

/// Settings of the estimate.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// CSV file of the tools: tool, length_mm, radius_mm (presets), wear_limit_length_um, wear_limit_radius_um.
    pub table: String,
    /// The master tool. Every session measures it in every way in which it measures tools.
    pub master: Master,
    /// Standard uncertainty of one reading by method: those that the log may name.
    pub repeatability_um: BTreeMap<String, Repeatability>,
    /// Standard uncertainty with which presets are set.
    #[schemars(with = "AboveZero")]
    pub setting_standard_uncertainty_um: f64,
    /// A reading that is further from the median of its repeats than this many of its standard uncertainties is spoiled.
    #[serde(default = "six")]
    #[schemars(range(min = 1.0, max = 100.0))]
    pub spoiled_factor: f64,
    /// Factor k of expanded uncertainties, U = k u.
    #[serde(default = "two")]
    pub coverage_factor: f64,
    /// Methods whose values differ by more than this many standard uncertainties are inconsistent.
    #[serde(default = "four")]
    #[schemars(range(min = 1.0, max = 100.0))]
    pub consistency_factor: f64,
    /// Largest difference of a reading of the master from its value: bias of the setter and growth of the spindle.
    #[serde(default = "half_a_millimetre")]
    pub master_limit_um: f64,
    /// Largest change of the temperature of the spindle between the master and a tool of one session: beyond it the master does
    /// not remove the growth.
    #[serde(rename = "temperature_limit_K", default = "two")]
    pub temperature_limit: f64,
    /// Limits that are the same for all tools.
    pub limits: Limits,
}

/// The master tool.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Master {
    /// Its number in the log.
    pub tool: Label,
    /// Its calibrated length.
    #[schemars(range(min = 1e-3, max = 1e5))]
    pub length_mm: f64,
    /// Its calibrated radius.
    pub radius_mm: f64,
    /// Standard uncertainty of both, which do not depend on each other.
    #[schemars(with = "AboveZero")]
    pub standard_uncertainty_um: f64,
    /// Its identity, the same in all recipes that use it. Default: a hash of its values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
}

impl Master {
    /// Its calibrated value, mm.
    pub fn value(&self, quantity: Quantity) -> f64 {
        match quantity {
            Quantity::Length => self.length_mm,
            Quantity::Radius => self.radius_mm,
        }
    }
}

/// Standard uncertainty of one reading of a method.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Repeatability {
    /// Of a length, um.
    pub length: f64,
    /// Of a radius, um.
    pub radius: f64,
}

impl Repeatability {
    /// That of a quantity, mm.
    pub fn of(&self, quantity: Quantity) -> f64 {
        1e-3 * match quantity {
            Quantity::Length => self.length,
            Quantity::Radius => self.radius,
        }
    }
}

/// Limits that are the same for all tools.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// A tool whose length is short by more is broken.
    pub breakage_um: f64,
    /// An edge is chipped if the radius drops by more since the tool was last in order.
    pub chip_um: f64,
    /// A tool looks like another one that it matches better than this.
    pub match_um: f64,
    /// A tool that is off by more may be another one.
    pub wrong_um: f64,
}

fn two() -> f64 {
    2.0
}

fn four() -> f64 {
    4.0
}

fn six() -> f64 {
    6.0
}

fn half_a_millimetre() -> f64 {
    500.0
}

/// Settings that a stage can be built from.
pub fn example() -> Value {
    json!({
        "table": "tools.csv",
        "master": { "tool": 0, "length_mm": 200.0124, "radius_mm": 12.4996, "standard_uncertainty_um": 0.5 },
        "repeatability_um": { "contact": { "length": 0.7, "radius": 1.2 }, "laser": { "length": 1.0, "radius": 0.8 } },
        "setting_standard_uncertainty_um": 1.2,
        "limits": { "breakage_um": 500, "chip_um": 25, "match_um": 60, "wrong_um": 150 }
    })
}

impl Settings {
    /// Fails for numbers that are not positive and for names that results could not tell apart.
    pub fn check(&self) -> Result<(), SettingsError> {
        positive("setting_standard_uncertainty_um", self.setting_standard_uncertainty_um)?;
        if !(1.0..=10.0).contains(&self.coverage_factor) {
            let message = format!("{:e}: a number from 1 to 10 was expected", self.coverage_factor);
            return Err(SettingsError::new("coverage_factor", message));
        }
        for (name, factor) in [("spoiled_factor", self.spoiled_factor), ("consistency_factor", self.consistency_factor)]
        {
            if !(1.0..=100.0).contains(&factor) {
                return Err(SettingsError::new(name, format!("{factor:e}: a number from 1 to 100 was expected")));
            }
        }
        up_to("master_limit_um", self.master_limit_um, LARGEST_REPEATABILITY)?;
        up_to("temperature_limit_K", self.temperature_limit, 100.0)?;
        let key = |name: &str| PathItem::Key(name.to_owned());
        let Master { length_mm, radius_mm, standard_uncertainty_um, .. } = self.master;
        for (name, value) in
            [("length_mm", length_mm), ("radius_mm", radius_mm), ("standard_uncertainty_um", standard_uncertainty_um)]
        {
            positive(name, value).map_err(|error| error.under([key("master")]))?;
        }
        let Limits { breakage_um, chip_um, match_um, wrong_um } = self.limits;
        for (name, value) in
            [("breakage_um", breakage_um), ("chip_um", chip_um), ("match_um", match_um), ("wrong_um", wrong_um)]
        {
            up_to(name, value, LARGEST_LIMIT).map_err(|error| error.under([key("limits")]))?;
        }
        if match_um >= wrong_um {
            let message = format!("{match_um}: less than `wrong_um` ({wrong_um}) was expected");
            return Err(SettingsError::new("match_um", message).under([key("limits")]).help(
                "a tool that is off by more than `wrong_um` looks like another one that it matches better than `match_um`",
            ));
        }
        if self.repeatability_um.is_empty() {
            return Err(SettingsError::new("repeatability_um", "at least one method was expected"));
        }
        for (method, Repeatability { length, radius }) in &self.repeatability_um {
            for (name, value) in [("length", *length), ("radius", *radius)] {
                up_to(name, value, LARGEST_REPEATABILITY)
                    .map_err(|error| error.under([key("repeatability_um"), key(method)]))?;
            }
        }
        Ok(())
    }
}

/// Largest limit of a dimension that tells a tool from another, µm: more is a tool of its own.
const LARGEST_LIMIT: f64 = 1e4;

/// Largest repeatability of a tool setter, µm.
const LARGEST_REPEATABILITY: f64 = 1e3;

/// Smallest limit or repeatability that can be meant.
const SMALLEST: f64 = 1e-6;

/// A positive number up to `most`.
fn up_to(name: &str, value: f64, most: f64) -> Result<f64, SettingsError> {
    match (SMALLEST..=most).contains(&positive(name, value)?) {
        true => Ok(value),
        false => Err(SettingsError::new(name, format!("{value:e}: a number from {SMALLEST:e} to {most} was expected"))),
    }
}
