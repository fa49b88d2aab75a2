//! What a calibration of tools contains: the table, what was measured when, and the values.

use abbe_core::{Calibration, Error, Result};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::settings::{Quantity, Settings};

/// The name of the estimator.
pub const ESTIMATOR: &str = "tool-dimensions";

/// A tool of the table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tool {
    /// Its name, a number for controls.
    pub tool: String,
    /// Length and radius as they were set, mm.
    #[serde(rename = "preset_mm")]
    pub preset: [f64; 2],
    /// How much each may wear, mm.
    #[serde(rename = "wear_limit_mm")]
    pub wear_limit: [f64; 2],
}

/// A tool in a session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Check {
    /// The session.
    pub session: String,
    /// The tool.
    pub tool: String,
    /// Time that it has cut so far, s.
    pub cutting_s: f64,
    /// Whether length and radius were measured.
    pub measured: [bool; 2],
    /// Quantities on which methods do not agree.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub inconsistent: Vec<Inconsistent>,
}

/// Methods that differ.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Inconsistent {
    /// What they measured.
    pub quantity: Quantity,
    /// Largest difference of two methods, um.
    pub difference_um: f64,
    /// What it may be.
    pub allowed_um: f64,
}

/// The resolved settings of an estimate: all that verdicts need besides values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The settings of the recipe.
    pub settings: Settings,
    /// The tool table.
    pub tools: Vec<Tool>,
    /// Tools in sessions, in the order of the log.
    pub checks: Vec<Check>,
}

impl Record {
    /// The tool of a check.
    pub fn tool(&self, check: usize) -> &Tool {
        // An estimate has only checks of tools of its table; `Store::of` refuses a file with others.
        let place = self.tools.iter().position(|tool| tool.tool == self.checks[check].tool);
        &self.tools[place.unwrap_or_default()]
    }

    /// The last check of a tool.
    pub fn last_check(&self, tool: &str) -> Option<usize> {
        self.checks.iter().rposition(|check| check.tool == tool)
    }

    /// The last session.
    pub fn last_session(&self) -> &str {
        self.checks.last().map_or("", |check| &check.session)
    }

    /// The name of a value: `length[3,11]` of tool 3 in session 11, `length[3]` in the last session of the tool.
    pub fn name(&self, check: usize, quantity: Quantity) -> String {
        let Check { session, tool, .. } = &self.checks[check];
        match self.last_check(tool) == Some(check) {
            true => format!("{}[{tool}]", quantity.name()),
            false => format!("{}[{tool},{session}]", quantity.name()),
        }
    }
}

/// The name of a wear rate.
pub fn wear_name(tool: &str, quantity: Quantity) -> String {
    format!("wear[{tool}].{}", quantity.name())
}

/// The name of the size on the line of wear before the first cut.
pub fn new_name(tool: &str, quantity: Quantity) -> String {
    format!("new[{tool}].{}", quantity.name())
}

/// A value of a tool in a session.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// Index of the check.
    pub check: usize,
    /// What it is.
    pub quantity: Quantity,
    /// mm.
    pub value: f64,
}

/// Record and values with their covariance, mm2.
pub struct Store {
    /// The record.
    pub record: Record,
    /// All values.
    pub values: Vec<Measured>,
    /// Their covariance. It has the uncertainty of the master in it.
    pub covariance: DMatrix<f64>,
}

impl Store {
    /// What a calibration says.
    ///
    /// Fails for one that another estimator made, and for a file that contradicts itself.
    pub fn of(calibration: &Calibration) -> Result<Self> {
        let name = &calibration.estimate;
        if calibration.model.plugin != ESTIMATOR {
            let message = format!("`{name}` has no dimensions of tools: it was not made by `{ESTIMATOR}`");
            return Err(Error::usage(message).setting("of"));
        }
        let broken = |what: String| Error::data(format!("the record of `{name}` is broken: {what}"));
        let settings: Value = calibration.model.settings.clone();
        let record: Record = serde_json::from_value(settings).map_err(|error| broken(error.to_string()))?;
        let mut values = Vec::new();
        for (check, Check { tool, measured, .. }) in record.checks.iter().enumerate() {
            if !record.tools.iter().any(|known| known.tool == *tool) {
                return Err(broken(format!("it has no tool {tool}")));
            }
            for quantity in Quantity::ALL.into_iter().filter(|quantity| measured[quantity.index()]) {
                let name = record.name(check, quantity);
                let value = calibration.get(&name).ok_or_else(|| broken(format!("`{name}` is missing")))?.value;
                values.push(Measured { check, quantity, value });
            }
        }
        let names: Vec<String> = values.iter().map(|value| record.name(value.check, value.quantity)).collect();
        let covariance = calibration.covariance.block(&names);
        Ok(Self { record, values, covariance })
    }

    /// Index of the value of a check.
    pub fn index(&self, check: usize, quantity: Quantity) -> Option<usize> {
        self.values.iter().position(|value| value.check == check && value.quantity == quantity)
    }

    /// How much a value is short of the preset of its tool, um.
    pub fn short_um(&self, index: usize) -> f64 {
        let Measured { check, quantity, value } = self.values[index];
        (self.record.tool(check).preset[quantity.index()] - value) * 1e3
    }

    /// Standard uncertainty of that: value, master and setting, um.
    pub fn short_uncertainty_um(&self, index: usize) -> f64 {
        (self.covariance[(index, index)] * 1e6 + self.record.settings.setting_standard_uncertainty_um.powi(2)).sqrt()
    }
}
