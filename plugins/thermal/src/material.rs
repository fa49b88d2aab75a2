//! Whether the material of a reference suits the temperatures that it is used at (Muelaner et al. 2014, eq. 1).

use abbe_core::{Dataset, Error, Figure, Findings, Limit, Quantity, Result, SettingsError, positive};
use abbe_standards::material::{admissible, largest_expansion};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::settings::quantity;

/// A reference: a ball bar, a ball plate, a ring.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(non_snake_case, reason = "units are written as in column names")]
pub struct Reference {
    /// Its length.
    #[schemars(range(min = 1e-3, max = 1e6))]
    length_mm: f64,
    /// What its length has to be known to, from the smallest to the largest value.
    tolerance_um: f64,
    /// Its coefficient of expansion.
    expansion_um_per_m_K: f64,
    /// Column of its temperature, without the unit: its range over all runs counts.
    temperature: String,
}

impl Reference {
    /// Refuses numbers that are not above zero.
    pub fn check(&self) -> Result<(), SettingsError> {
        positive("length_mm", self.length_mm)?;
        positive("tolerance_um", self.tolerance_um)?;
        positive("expansion_um_per_m_K", self.expansion_um_per_m_K).map(drop)
    }

    /// Its expansion against the largest admissible one.
    pub fn judge(&self, name: &str, data: &[&Dataset], findings: &mut Findings) -> Result<()> {
        let column = &self.temperature;
        if !data.iter().any(|data| quantity(data, column) == Quantity::Temperature) {
            return Err(Error::usage(format!(
                "no run has a column of temperatures `{column}` for the reference `{name}`"
            )));
        }
        let all = data.iter().filter_map(|data| data.numbers(column)).flatten().copied();
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
        let half_range = (high - low) / 2.0;
        let largest = largest_expansion(1e-3 * self.tolerance_um, self.length_mm, half_range).unwrap_or(f64::INFINITY);
        let materials: Vec<&str> = admissible(largest).map(|material| material.name).collect();
        let figure = Figure::new("", format!("expansion[{name}]"), self.expansion_um_per_m_K, "um/(m K)");
        let limit = largest.is_finite().then(|| Limit::from(1e6 * largest));
        findings.figures.push(Figure { of: None, ..figure }.limited(limit));
        let suits =
            if materials.is_empty() { "none of aluminium, steel and invar".to_owned() } else { materials.join(", ") };
        findings.remarks.push(format!(
            "{name}: at {low:.1} to {high:.1} °C {:.2} µm/(m K) are admissible for {} µm on {} mm: {suits}",
            1e6 * largest,
            self.tolerance_um,
            self.length_mm
        ));
        Ok(())
    }
}
