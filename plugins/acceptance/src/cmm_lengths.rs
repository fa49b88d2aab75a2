//! Validator plugin `cmm-lengths`: length measurement errors in the manner of ISO 10360-2.

use abbe_core::{
    Context, DataRow, Dataset, Error, EstimateSource, Findings, Fit, Limit, Quantity, Result, SettingsError, Validate,
    not_negative, positive,
};
use abbe_standards::lengths::{EDITION, Judged, LENGTHS, LINES, Measured, Permissible, VALUES, judge, sets};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::common::{figure, finite, no_data, run_name};

abbe_core::register!(
    Validate,
    "cmm-lengths",
    "length measurement errors of a CMM in the manner of ISO 10360-2: E0, E150, R0 with A + L/K",
    Lengths,
    example,
    build,
    "../reference/validate-cmm-lengths.md",
    EstimateSource::Readings,
);

/// Settings of a length test. The second data set under `from`, where there is one, has the repeats of values that are outside.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Lengths {
    /// Distance of the stylus tip from the ram: E0, E150.
    #[serde(default)]
    stylus_beside_mm: f64,
    /// Maximum permissible error of a length.
    mpe: Mpe,
    /// Largest admissible range of three values of a length.
    #[serde(default)]
    repeatability_um: Option<Limit>,
}

/// `min(A + L / K, B)` in um, with the length L in mm.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Mpe {
    /// What does not depend on the length.
    #[serde(rename = "A_um")]
    constant_um: f64,
    /// Divides the length in mm. Default: no part grows with the length.
    #[serde(rename = "K", default)]
    divisor: Option<f64>,
    /// The largest value.
    #[serde(rename = "B_um", default)]
    most_um: Option<f64>,
}

fn example() -> Value {
    json!({ "mpe": { "A_um": 1.9, "K": 300 }, "repeatability_um": 4 })
}

fn build(settings: Lengths, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    let under = |error: SettingsError| error.under([abbe_core::PathItem::Key("mpe".to_owned())]);
    not_negative("stylus_beside_mm", settings.stylus_beside_mm)?;
    positive("A_um", settings.mpe.constant_um).map_err(under)?;
    settings.mpe.divisor.map(|divisor| positive("K", divisor)).transpose().map_err(under)?;
    settings.mpe.most_um.map(|most| positive("B_um", most)).transpose().map_err(under)?;
    Ok(Box::new(settings))
}

/// Lengths of a data set, mm. A length below zero or far from its reference is a slip, no error of a machine.
fn measured(data: &Dataset) -> Result<Vec<Measured>> {
    let lines = abbe_table::labels(data, "group")?;
    let reference = finite(data, "reference", Quantity::Length)?;
    let values = finite(data, "measured", Quantity::Length)?;
    if let Some(row) = (0..values.len()).find(|row| reference[*row] <= 0.0) {
        return Err(data.error_at(DataRow(row), "a calibrated length above zero was expected"));
    }
    if let Some(row) = (0..values.len()).find(|row| (values[*row] - reference[*row]).abs() > 0.1 * reference[*row]) {
        let message = format!("{} mm was measured for a length of {} mm", values[row], reference[row]);
        return Err(data.error_at(DataRow(row), message).help("is the unit of both the same?"));
    }
    let of = |row: usize| Measured { line: lines[row].clone(), reference: reference[row], measured: values[row] };
    Ok((0..values.len()).map(of).collect())
}

impl Lengths {
    fn permissible(&self) -> Permissible {
        Permissible {
            constant: 1e-3 * self.mpe.constant_um,
            slope: self.mpe.divisor.map_or(0.0, |divisor| 1e-3 / divisor),
            most: self.mpe.most_um.map(|most| 1e-3 * most),
        }
    }

    fn judge(&self, data: &Dataset, repeats: &[Measured], findings: &mut Findings) -> Result<()> {
        let (run, all, permissible) = (run_name(data), measured(data)?, self.permissible());
        if all.is_empty() {
            return Err(Error::data("there is no length to judge").setting("from"));
        }
        let sets = sets(&all);
        let symbol = format!("E_{}", self.stylus_beside_mm);
        let errors = || all.iter().map(|value| 1e3 * value.error());
        let named = |name: &str| format!("{name}[{run}]");
        let most = errors().fold(f64::NEG_INFINITY, f64::max);
        findings.figures.push(figure(named(&format!("{symbol} max")), most, "um"));
        let least = errors().fold(f64::INFINITY, f64::min);
        findings.figures.push(figure(named(&format!("{symbol} min")), least, "um"));
        let share = |all: &[Measured]| all.iter().map(|value| value.share(&permissible)).fold(0.0, f64::max);
        let judged = judge(&all, &sets, repeats, &permissible);
        let outside = |value: &Measured| !value.is_inside(&permissible);
        let count = all.iter().filter(|value| outside(value)).count();
        findings.figures.push(figure(named("values outside"), count as f64, "1"));
        findings.figures.push(figure(named(&format!("largest |{symbol}|/MPE")), share(&all), "1"));
        // With repeats a value that was outside alone in its set does not count, they do.
        let inside: Vec<Measured> = all.iter().filter(|value| !outside(value)).chain(repeats).cloned().collect();
        let name = named(&format!("largest |{symbol}|/MPE that counts"));
        // Rounding of decimal numbers is no reason to fail at the limit.
        let mut counted = match &judged {
            Judged::Inside => figure(name, share(&inside).min(1.0), "1"),
            _ => figure(name, share(&all), "1"),
        };
        counted.set_limit(Some(Limit::from(1.0)));
        match &judged {
            Judged::Inside => {}
            Judged::Repeat(open) => {
                let words: Vec<String> =
                    open.iter().map(|set| format!("line {} at {} mm", sets[*set].line, sets[*set].reference)).collect();
                counted.inconclusive = Some(format!("measure three times again: {}", words.join(", ")));
            }
            Judged::Outside(why) => {
                // Too many sets, or repeats outside: the share of the original values is above 1.
                findings.remarks.push(format!("{run}: {why}"));
            }
        }
        findings.figures.push(counted);
        let widest = sets.iter().filter_map(|set| set.range.map(|range| (range, set)));
        let widest = widest.reduce(|most, next| if next.0 > most.0 { next } else { most });
        if let Some((range, set)) = widest {
            let range = figure(named("R_0 max"), 1e3 * range, "um").limited(self.repeatability_um);
            findings.figures.push(range);
            findings.remarks.push(format!("{run}: R_0 is largest on line {} at {} mm", set.line, set.reference));
        } else if self.repeatability_um.is_some() {
            findings.figures.push(figure(named("R_0 max"), f64::NAN, "um").limited(self.repeatability_um));
        }
        self.plan(&run, &sets, findings);
        Ok(())
    }

    /// What the programme lacks.
    fn plan(&self, run: &str, sets: &[abbe_standards::lengths::Set], findings: &mut Findings) {
        let other = sets.iter().filter(|set| set.places.len() != VALUES).count();
        if other > 0 {
            let text = format!("{run}: {other} lengths have not {VALUES} values: they have no R_0");
            findings.remarks.push(text);
        }
        if self.stylus_beside_mm == 0.0 && sets.len() != LINES * LENGTHS {
            let count = sets.len();
            findings
                .remarks
                .push(format!("{run}: {count} lengths; the test of E_0 has {LENGTHS} on each of {LINES} lines"));
        }
    }
}

impl Validate for Lengths {
    fn accepts_data(&self) -> bool {
        true
    }

    fn accepts_readings(&self) -> bool {
        true
    }

    fn validate(&self, _: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        let (test, repeats) = match data {
            [] => return Err(no_data()),
            [test] => (test, Vec::new()),
            [test, repeats] => (test, measured(repeats)?),
            _ => return Err(Error::usage("a test and its repeats were expected: two data sets").setting("from")),
        };
        let mut findings = Findings::default();
        self.judge(test, &repeats, &mut findings)?;
        findings.remarks.push(format!(
            "{EDITION}: that up to five sets may have one value outside, each measured three times again, is a choice of this \
             project, as its text was not at hand"
        ));
        Ok(findings)
    }
}
