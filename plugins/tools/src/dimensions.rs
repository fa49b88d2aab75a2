//! From readings to dimensions: spoiled readings, the master, the mean of methods.

use std::collections::BTreeMap;

use abbe_core::{Outlier, Result};

use crate::log::{At, Log, Reading, Repeats, Session, Visit};
use crate::record::{Check, Inconsistent};
use crate::settings::{Quantity, Settings};

/// What repeats tell.
#[derive(Debug, Clone, PartialEq)]
struct Repeated {
    /// Mean of the readings that are not spoiled, mm; none if no majority agrees.
    mean: Option<f64>,
    /// Variance of the mean, mm2.
    variance: f64,
}

/// The part of a method in a value.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// The method.
    pub method: String,
    /// Its weight.
    pub weight: f64,
    /// Variance of the readings of the tool, mm2.
    pub own: f64,
    /// Variance of the readings of the master, which all tools of the session share, mm2.
    pub of_master: f64,
}

/// A dimension of a tool in a session.
#[derive(Debug, Clone, PartialEq)]
pub struct Dimension {
    /// Index of the check.
    pub check: usize,
    /// Index of the session.
    pub session: usize,
    /// What it is.
    pub quantity: Quantity,
    /// mm.
    pub value: f64,
    /// The methods.
    pub parts: Vec<Part>,
}

/// The scatter of repeats about their means.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Scatter {
    /// Number of readings.
    pub readings: usize,
    /// Number of means.
    pub means: usize,
    /// Sum of squares in units of stated variances.
    pub weighted: f64,
    /// Sum of squares, mm2.
    pub squares: f64,
    /// Sum of sizes, mm.
    pub sizes: f64,
    /// The largest, mm.
    pub largest: f64,
}

/// All dimensions of a log.
#[derive(Debug, Default)]
pub struct Reduced {
    /// Tools in sessions.
    pub checks: Vec<Check>,
    /// Their dimensions.
    pub dimensions: Vec<Dimension>,
    /// Spoiled readings.
    pub spoiled: Vec<Outlier>,
    /// Scatter of the others.
    pub scatter: Scatter,
}

impl Reduced {
    /// Reduces a log. `stage` is the name of the estimate, for the list of spoiled readings.
    ///
    /// Fails if no majority of the readings of a master agrees.
    pub fn new(stage: &str, log: &Log<'_>, settings: &Settings) -> Result<Self> {
        let mut reduced = Self::default();
        for (index, session) in log.sessions.iter().enumerate() {
            let masters = reduced.masters(stage, log, session, settings)?;
            for visit in &session.visits {
                reduced.visit(stage, log, (index, &session.name), visit, &masters, settings);
            }
        }
        Ok(reduced)
    }

    fn masters(
        &mut self,
        stage: &str,
        log: &Log<'_>,
        session: &Session,
        settings: &Settings,
    ) -> Result<BTreeMap<(Quantity, String), (f64, f64)>> {
        let mut masters = BTreeMap::new();
        for (key, readings) in &session.master {
            let Repeated { mean, variance } = self.repeated(stage, log, key, readings, settings);
            let Some(mean) = mean else {
                let message = format!(
                    "no majority of the readings of the {} of the master by {} in session {} agrees",
                    key.0.name(),
                    key.1,
                    session.name
                );
                return Err(log.error(readings[0].at, message).help("clean the setter, and measure the master again"));
            };
            masters.insert(key.clone(), (mean - settings.master.value(key.0), variance));
        }
        Ok(masters)
    }

    fn visit(
        &mut self,
        stage: &str,
        log: &Log<'_>,
        (session, name): (usize, &str),
        visit: &Visit,
        masters: &BTreeMap<(Quantity, String), (f64, f64)>,
        settings: &Settings,
    ) {
        let mut check = Check {
            session: name.to_owned(),
            tool: visit.tool.clone(),
            cutting_s: visit.cutting,
            measured: [false; 2],
            inconsistent: Vec::new(),
        };
        for quantity in Quantity::ALL {
            let found = self.corrected(stage, log, quantity, &visit.repeats, masters, settings);
            let total: f64 = found.iter().map(|(_, part)| part.weight).sum();
            if found.is_empty() {
                continue;
            }
            check.measured[quantity.index()] = true;
            check.inconsistent.extend(inconsistent(quantity, &found, settings.consistency_factor));
            let value = found.iter().map(|(value, part)| value * part.weight / total).sum();
            let part = |(_, part): (f64, Part)| Part { weight: part.weight / total, ..part };
            let parts = found.into_iter().map(part).collect();
            self.dimensions.push(Dimension { check: self.checks.len(), session, quantity, value, parts });
        }
        self.checks.push(check);
    }

    /// The values of a quantity by every method that has one, corrected by the master, with weights 1/u2.
    fn corrected(
        &mut self,
        stage: &str,
        log: &Log<'_>,
        quantity: Quantity,
        repeats: &Repeats,
        masters: &BTreeMap<(Quantity, String), (f64, f64)>,
        settings: &Settings,
    ) -> Vec<(f64, Part)> {
        let mut found = Vec::new();
        for (key, readings) in repeats.iter().filter(|(key, _)| key.0 == quantity) {
            let Repeated { mean, variance: own } = self.repeated(stage, log, key, readings, settings);
            // The log has the master for all that it has of tools.
            let (Some(mean), Some(&(bias, of_master))) = (mean, masters.get(key)) else { continue };
            let weight = 1.0 / (own + of_master);
            found.push((mean - bias, Part { method: key.1.clone(), weight, own, of_master }));
        }
        found
    }

    /// Mean of the readings near their median. More than half of them have to be near.
    fn repeated(
        &mut self,
        stage: &str,
        log: &Log<'_>,
        (quantity, method): &(Quantity, String),
        readings: &[Reading],
        settings: &Settings,
    ) -> Repeated {
        let s = settings.repeatability_um.get(method).map_or(0.0, |known| known.of(*quantity));
        let middle = median(readings);
        let is_near = |reading: &&Reading| (reading.value - middle).abs() <= settings.spoiled_factor * s;
        let near: Vec<f64> = readings.iter().filter(is_near).map(|reading| reading.value).collect();
        let agree = 2 * near.len() > readings.len();
        let spoiled = readings.iter().filter(|reading| !agree || !is_near(reading));
        self.spoiled.extend(spoiled.map(|reading| outlier(stage, log, reading.at, reading.value - middle)));
        if !agree {
            return Repeated { mean: None, variance: 0.0 };
        }
        // From the median, so that exact readings give exactly their value.
        let mean = middle + near.iter().map(|value| value - middle).sum::<f64>() / near.len() as f64;
        self.scatter.means += 1;
        for residual in near.iter().map(|value| value - mean) {
            self.scatter.readings += 1;
            self.scatter.weighted += (residual / s).powi(2);
            self.scatter.squares += residual * residual;
            self.scatter.sizes += residual.abs();
            self.scatter.largest = self.scatter.largest.max(residual.abs());
        }
        Repeated { mean: Some(mean), variance: s * s / near.len() as f64 }
    }
}

fn median(readings: &[Reading]) -> f64 {
    let mut values: Vec<f64> = readings.iter().map(|reading| reading.value).collect();
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    if values.len() % 2 == 1 { values[half] } else { (values[half - 1] + values[half]) / 2.0 }
}

fn outlier(stage: &str, log: &Log<'_>, at: At, residual: f64) -> Outlier {
    let (file, line, row) = log.place(at);
    Outlier { stage: stage.to_owned(), file, line, row, residual_um: residual * 1e3, weight: 0.0 }
}

/// The largest difference of two methods relative to what it may be, if it is more.
fn inconsistent(quantity: Quantity, found: &[(f64, Part)], factor: f64) -> Option<Inconsistent> {
    let mut worst: Option<Inconsistent> = None;
    for (index, (one, first)) in found.iter().enumerate() {
        for (other, second) in &found[index + 1..] {
            let difference_um = (one - other).abs() * 1e3;
            let allowed_um = factor * (1.0 / first.weight + 1.0 / second.weight).sqrt() * 1e3;
            let ratio = |it: &Inconsistent| it.difference_um / it.allowed_um;
            let here = Inconsistent { quantity, difference_um, allowed_um };
            if difference_um > allowed_um && worst.as_ref().is_none_or(|worst| ratio(&here) > ratio(worst)) {
                worst = Some(here);
            }
        }
    }
    worst
}

#[cfg(test)]
mod tests {
    use super::*;
    use abbe_core::DataRow;

    fn readings(values: &[f64]) -> Vec<Reading> {
        values.iter().map(|&value| Reading { at: At { data: 0, row: DataRow(0) }, value }).collect()
    }

    #[test]
    fn the_median_of_even_and_odd_numbers_of_readings() {
        assert_eq!(median(&readings(&[3.0, 1.0, 2.0])), 2.0);
        assert_eq!(median(&readings(&[4.0, 1.0, 3.0, 2.0])), 2.5);
        assert_eq!(median(&readings(&[7.0])), 7.0);
    }

    #[test]
    fn methods_differ_only_beyond_their_uncertainty() {
        let part = |weight: f64| Part { method: String::new(), weight, own: 0.0, of_master: 0.0 };
        // u = 3 um and 4 um, so that 4 u of the difference is 20 um.
        let pair = |difference: f64| vec![(10.0, part(1.0 / 9e-6)), (10.0 + difference, part(1.0 / 16e-6))];
        assert_eq!(inconsistent(Quantity::Length, &pair(0.019_99), 4.0), None);
        let found = inconsistent(Quantity::Length, &pair(-0.020_01), 4.0).expect("they differ");
        assert!((found.allowed_um - 20.0).abs() < 1e-9 && (found.difference_um - 20.01).abs() < 1e-9, "{found:?}");
        assert_eq!(inconsistent(Quantity::Length, &pair(0.1)[..1], 4.0), None);
    }
}
