//! Wear as a straight line in the time of cutting.

use std::collections::BTreeMap;

use abbe_core::Calibration;

use crate::judge::{Judged, Name};
use crate::record::{Store, new_name, wear_name};
use crate::settings::Quantity;

/// A line of least squares with equal weights.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// The tool.
    pub tool: String,
    /// What wears.
    pub quantity: Quantity,
    /// Change by the time of cutting, mm/s.
    pub wear: f64,
    /// Its standard uncertainty, mm/s, from the mean variance of the values.
    pub wear_uncertainty: f64,
    /// Size before the first cut, mm.
    pub new: f64,
    /// What a value adds to both, by the index of the value.
    pub weights: Vec<(usize, [f64; 2])>,
}

/// Lines through the values of sessions in which a tool was in order, to be measured again, or worn.
pub fn lines(store: &Store, judged: &[Judged]) -> Vec<Line> {
    let counts: BTreeMap<usize, bool> =
        judged.iter().map(|it| (it.check, matches!(it.name, Name::Ok | Name::Recheck | Name::Worn))).collect();
    let mut lines = Vec::new();
    for tool in &store.record.tools {
        for quantity in Quantity::ALL {
            let is_used = |index: &usize| {
                let value = &store.values[*index];
                value.quantity == quantity && counts[&value.check] && store.record.checks[value.check].tool == tool.tool
            };
            let used: Vec<usize> = (0..store.values.len()).filter(is_used).collect();
            lines.extend(line(store, &tool.tool, quantity, &used));
        }
    }
    lines
}

/// The line through some values; none if the tool has not cut between them.
fn line(store: &Store, tool: &str, quantity: Quantity, used: &[usize]) -> Option<Line> {
    let count = used.len() as f64;
    let time = |index: usize| store.record.checks[store.values[index].check].cutting_s;
    let mean_time = used.iter().map(|&index| time(index)).sum::<f64>() / count;
    let sum: f64 = used.iter().map(|&index| (time(index) - mean_time).powi(2)).sum();
    let first = used.first().map(|&index| store.values[index].value)?;
    if sum <= 0.0 {
        return None;
    }
    let slope = |index: usize| (time(index) - mean_time) / sum;
    let weights: Vec<(usize, [f64; 2])> =
        used.iter().map(|&index| (index, [slope(index), 1.0 / count - mean_time * slope(index)])).collect();
    // Differences from the first value keep rounding small.
    let along = |place: usize| {
        weights.iter().map(|(index, weights)| weights[place] * (store.values[*index].value - first)).sum::<f64>()
    };
    // The master moves all values alike and changes no slope.
    let master = (store.record.settings.master.standard_uncertainty_um * 1e-3).powi(2);
    let variance = used.iter().map(|&index| store.covariance[(index, index)] - master).sum::<f64>() / count;
    Some(Line {
        tool: tool.to_owned(),
        quantity,
        wear: along(0),
        wear_uncertainty: (variance / sum).sqrt(),
        new: first + along(1),
        weights,
    })
}

/// When a wear limit is reached.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reached {
    /// Time of cutting, s.
    pub time: f64,
    /// Its standard uncertainty, s.
    pub uncertainty: f64,
}

/// A line of a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Wear {
    /// The tool.
    pub tool: String,
    /// What wears.
    pub quantity: Quantity,
    /// Change by the time of cutting, mm/s.
    pub rate: f64,
    /// Its standard uncertainty.
    pub uncertainty: f64,
    /// When the limit is reached; none for a tool that does not wear.
    pub reached: Option<Reached>,
}

/// The lines of a calibration.
pub fn of(calibration: &Calibration, store: &Store) -> Vec<Wear> {
    let mut found = Vec::new();
    for tool in &store.record.tools {
        for quantity in Quantity::ALL {
            let names = [wear_name(&tool.tool, quantity), new_name(&tool.tool, quantity)];
            let (Some(wear), Some(new)) = (calibration.get(&names[0]), calibration.get(&names[1])) else { continue };
            let limit = tool.preset[quantity.index()] - tool.wear_limit[quantity.index()];
            let covariance = calibration.covariance.block(&names);
            let setting = (store.record.settings.setting_standard_uncertainty_um * 1e-3).powi(2);
            let reached = (wear.value < 0.0).then(|| {
                let time = (limit - new.value) / wear.value;
                // What the line and the preset are uncertain by, there, as a time.
                let of_wear = time * time * covariance[(0, 0)] + 2.0 * time * covariance[(0, 1)];
                Reached { time, uncertainty: (of_wear + covariance[(1, 1)] + setting).sqrt() / -wear.value }
            });
            found.push(Wear {
                tool: tool.tool.clone(),
                quantity,
                rate: wear.value,
                uncertainty: wear.standard_uncertainty,
                reached,
            });
        }
    }
    found
}
