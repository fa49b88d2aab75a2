//! Validator plugin `cmm-lengths`: length measurement errors in the manner of ISO 10360-2.

use std::cmp::Ordering::{Equal, Greater};
use std::f64::consts::PI;

use abbe_core::{
    Context, DataRow, Dataset, Decision, Error, EstimateSource, Figure, Findings, Limit, PathItem, Quantity, Result,
    Rule, SettingsError, Validate, not_negative, positive, rule_or_name, schema_of_rules,
};
use abbe_numerics::resolution;
use abbe_standards::lengths::{
    EDITION, Judged, LENGTHS, LINES, LINES_BESIDE, Measured, Permissible, Set, VALUES, judge, sets,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::common::{
    Acceptance, Judge, copied_repeats, doubted, figure, finite, lacks_most, run_name, undecided, unmeasured,
};

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
    #[schemars(range(min = 0, max = 1000))]
    stylus_beside_mm: f64,
    /// Maximum permissible error of a length.
    mpe: Mpe,
    /// The rule that decides on every length: its name, or a map with its settings. Default: simple acceptance.
    #[serde(default, deserialize_with = "rule_or_name")]
    #[schemars(schema_with = "schema_of_rules")]
    decision: Rule,
    /// Expanded uncertainty (k = 2) of a length error.
    #[serde(default)]
    expanded_uncertainty: Option<Expanded>,
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

/// `A + L / K` in um, with the length L in mm; k = 2.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Expanded {
    /// What does not depend on the length.
    #[serde(rename = "A_um")]
    #[schemars(range(min = 1e-6, max = 1e6))]
    constant_um: f64,
    /// Divides the length in mm. Default: no part grows with the length.
    #[serde(rename = "K", default)]
    #[schemars(range(min = 1e-3, max = 1e12))]
    divisor: Option<f64>,
}

impl Expanded {
    /// Standard uncertainty at a length, mm.
    fn standard(&self, length: f64) -> f64 {
        0.5e-3 * (self.constant_um + self.divisor.map_or(0.0, |divisor| length / divisor))
    }
}

fn example() -> Value {
    json!({ "mpe": { "A_um": 1.9, "K": 300 }, "repeatability_um": 4 })
}

fn build(settings: Lengths, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    let under = |error: SettingsError| error.under([PathItem::Key("mpe".to_owned())]);
    not_negative("stylus_beside_mm", settings.stylus_beside_mm)?;
    positive("A_um", settings.mpe.constant_um).map_err(under)?;
    settings.mpe.divisor.map(|divisor| positive("K", divisor)).transpose().map_err(under)?;
    settings.mpe.most_um.map(|most| positive("B_um", most)).transpose().map_err(under)?;
    if let Some(expanded) = &settings.expanded_uncertainty {
        let under = |error: SettingsError| error.under([PathItem::Key("expanded_uncertainty".to_owned())]);
        not_negative("A_um", expanded.constant_um).map_err(under)?;
        expanded.divisor.map(|divisor| positive("K", divisor)).transpose().map_err(under)?;
    }
    Ok(Box::new(Judge(settings)))
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
    let of = |row: usize| Measured { line: lines[row].to_string(), reference: reference[row], measured: values[row] };
    Ok((0..values.len()).map(of).collect())
}

/// Distance, part of a length, by which the ends of a line may be off it: they are approached, not measured.
const APPROACHED: f64 = 0.05;

/// A remark on ends of lines (columns X1, Y1, Z1, X2, Y2, Z2) whose distance is not the length: columns that were exchanged, or rows of
/// other lines.
fn misplaced(run: &str, data: &Dataset, all: &[Measured]) -> Option<String> {
    let ends: Option<Vec<&[f64]>> =
        ["X1", "Y1", "Z1", "X2", "Y2", "Z2"].into_iter().map(|name| data.numbers(name)).collect();
    let ends = ends?;
    let distance = |row: usize| (0..3).map(|axis| (ends[axis + 3][row] - ends[axis][row]).powi(2)).sum::<f64>().sqrt();
    let is_off = |(row, length): &(usize, &Measured)| {
        (distance(*row) - length.reference).abs() > APPROACHED * length.reference || distance(*row).is_nan()
    };
    let (row, length) = all.iter().enumerate().find(is_off)?;
    Some(format!(
        "{run}: the ends of the line in line {} are {:.3} mm apart, and its length is {} mm: are columns or rows exchanged?",
        data.origins[DataRow(row)].line,
        distance(row),
        length.reference
    ))
}

/// The largest decimal part of a millimetre, of which all of these are multiples: the step of their digits.
fn digit(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let is_of = |digit: &f64| values.clone().all(|value| (value / digit - (value / digit).round()).abs() < 1e-4);
    (0..9).map(|place| 0.1_f64.powi(place)).find(is_of).unwrap_or(1e-9)
}

/// Finest digit of a CMM, mm: below it values were computed, and have no scatter that repeats could show.
const NANOMETRE: f64 = 1e-6;

/// Whether most errors have digits that no CMM has.
fn is_computed(errors: &[f64]) -> bool {
    let has_finer = |error: &&f64| ((*error / NANOMETRE) - (*error / NANOMETRE).round()).abs() > 1e-3;
    2 * errors.iter().filter(has_finer).count() > errors.len()
}

/// Fewest values that are told to have the calibrated length, the factor by which the scatter may be smaller than that of the others, and
/// the probability below which so many do not have it by chance.
const FEWEST: usize = 8;
const SMALLER: f64 = 2.0;
const BY_CHANCE: f64 = 1e-6;

/// Part of the values that have it by chance where digits are too coarse to tell.
const COARSE: f64 = 0.25;

/// How many values have the calibrated length to the last digit, where no chance makes so many: the column of the lengths in the place of
/// what was measured. All of them are told elsewhere.
fn calibrated_as_measured(all: &[Measured]) -> Option<String> {
    let is_same = |value: &&Measured| (value.measured - value.reference).abs() < 1e-9;
    let (same, count) = (all.iter().filter(is_same).count(), all.len());
    if same < FEWEST || same == count {
        return None;
    }
    let squares: f64 = all.iter().map(|value| value.error().powi(2)).sum();
    let scatter = (squares / (count - same) as f64).sqrt() / SMALLER;
    let step = resolution(&all.iter().map(|value| value.measured).collect::<Vec<f64>>())?;
    let chance = (step / (2.0 * PI).sqrt() / scatter).min(1.0);
    // At least so many by chance, at most with this probability (Chernoff 1952).
    let part = same as f64 / count as f64;
    let exponent = part * (part / chance).ln() + (1.0 - part) * ((1.0 - part) / (1.0 - chance).max(1e-300)).ln();
    (part > chance && chance < COARSE && (-(count as f64) * exponent).exp() < BY_CHANCE).then(|| {
        format!(
            "{same} of {count} lengths were measured as calibrated, to the last digit: was one column copied into the other?"
        )
    })
}

/// Errors of the values of each length in steps of their digits: calibrated lengths have finer digits than a CMM.
fn in_digits(all: &[Measured], sets: &[Set]) -> Vec<Vec<f64>> {
    let digit = digit(all.iter().map(|value| value.measured));
    let of = |set: &Set| set.places.iter().map(|place| (all[*place].error() / digit).round()).collect();
    sets.iter().map(of).collect()
}

impl Lengths {
    fn permissible(&self) -> Permissible {
        Permissible {
            constant: 1e-3 * self.mpe.constant_um,
            slope: self.mpe.divisor.map_or(0.0, |divisor| 1e-3 / divisor),
            most: self.mpe.most_um.map(|most| 1e-3 * most),
        }
    }

    /// |E|/MPE of a value as a figure with its limit.
    fn share(&self, name: &str, value: &Measured, permissible: &Permissible) -> Figure {
        let share = value.share(permissible);
        // Rounding of decimal numbers is no reason to fail at the limit.
        let share = if value.is_inside(permissible) { share.min(1.0) } else { share };
        let u = self.expanded_uncertainty.as_ref().map(|own| own.standard(value.reference));
        let limit = Limit { value: 1.0, rule: self.decision };
        figure(name.to_owned(), share, "1").uncertain(u.map(|u| u / permissible.at(value.reference))).limited(limit)
    }

    /// The figure of the value that decides: of those with the worst decision the one that is nearest to its limit.
    fn worst<'a>(
        &self,
        name: &str,
        values: impl Iterator<Item = &'a Measured>,
        permissible: &Permissible,
    ) -> Option<Figure> {
        values.map(|value| self.share(name, value, permissible)).reduce(|most, next| {
            let order = next.decide().cmp(&most.decide()).then(next.value.partial_cmp(&most.value).unwrap_or(Equal));
            if order == Greater { next } else { most }
        })
    }

    fn judge(&self, data: &Dataset, repeats: &[Measured], findings: &mut Findings) -> Result<()> {
        let (run, all, permissible) = (run_name(data), measured(data)?, self.permissible());
        if all.is_empty() {
            return Err(Error::data("there is no length to judge").setting("from"));
        }
        let sets = sets(&all);
        if let Some(foreign) = repeats.iter().find(|value| !sets.iter().any(|set| set.holds(value))) {
            let Measured { line, reference, .. } = foreign;
            let message = format!("the repeats have line {line} at {reference} mm, which {run} has not");
            let help = "are the lengths of one of the two files in another unit, or is `reference_mm` exchanged with `measured_mm` there?";
            let error = Error::data(message).help(help);
            return Err(data.files.iter().fold(error, |error, file| error.in_file(file)));
        }
        let errors: Vec<f64> = all.iter().map(Measured::error).collect();
        let same = unmeasured(&[&errors]).map(|same| format!("{run}: {same}"));
        let doubted = same.or_else(|| doubted(&run, &[&errors]));
        let copied: Vec<String> = copied_repeats("lengths", &in_digits(&all, &sets))
            .filter(|_| doubted.is_none() && !is_computed(&errors))
            .into_iter()
            .collect();
        let copied: Vec<String> = copied.into_iter().chain(calibrated_as_measured(&all)).collect();
        findings.remarks.extend(doubted);
        findings.remarks.extend(copied.iter().map(|copied| format!("{run}: {copied}")));
        findings.remarks.extend(misplaced(&run, data, &all));
        let first = findings.figures.len();
        let symbol = format!("E_{}", self.stylus_beside_mm);
        let named = |name: &str| format!("{name}[{run}]");
        let errors = || all.iter().map(|value| 1e3 * value.error());
        let [most, least] = [errors().reduce(f64::max), errors().reduce(f64::min)].map(|end| end.unwrap_or(f64::NAN));
        let share = all.iter().map(|value| value.share(&permissible)).fold(0.0, f64::max);
        let outside = all.iter().filter(|value| !value.is_inside(&permissible)).count();
        findings.figures.extend([
            figure(named(&format!("{symbol} max")), most, "um"),
            figure(named(&format!("{symbol} min")), least, "um"),
            figure(named("values outside"), outside as f64, "1"),
            figure(named(&format!("largest |{symbol}|/MPE")), share, "1"),
        ]);
        let name = named(&format!("|{symbol}|/MPE that decides"));
        let accepted = |value: &Measured| self.share(&name, value, &permissible).decide() == Some(Decision::Pass);
        let judged = judge(&all, &sets, repeats, accepted);
        findings.figures.extend(self.decided(&name, &judged, [&all, repeats], &permissible, &sets));
        if let Judged::Outside(why) = &judged {
            findings.remarks.push(format!("{run}: {why}"));
        }
        for set in sets.iter().filter(|set| repeats.iter().any(|value| set.holds(value))) {
            if set.places.iter().all(|place| accepted(&all[*place])) {
                let Set { line, reference, .. } = set;
                findings
                    .remarks
                    .push(format!("{run}: line {line} at {reference} mm was repeated though all is inside"));
            }
        }
        self.repeatability(&run, &sets, findings);
        let why: Vec<String> = copied.into_iter().chain(self.plan(&run, &sets, findings)).collect();
        undecided(&mut findings.figures[first..], &why);
        Ok(())
    }

    /// The figure that decides on all lengths.
    fn decided(
        &self,
        name: &str,
        judged: &Judged,
        [all, repeats]: [&[Measured]; 2],
        permissible: &Permissible,
        sets: &[Set],
    ) -> Option<Figure> {
        let accepted = |value: &&Measured| self.share(name, value, permissible).decide() == Some(Decision::Pass);
        match judged {
            // With repeats a value that was outside alone in its set does not count, they do.
            Judged::Inside => self.worst(name, all.iter().filter(accepted).chain(repeats), permissible),
            Judged::Outside(_) => self.worst(name, all.iter().chain(repeats), permissible),
            Judged::Repeat(open) => {
                let words: Vec<String> =
                    open.iter().map(|set| format!("line {} at {} mm", sets[*set].line, sets[*set].reference)).collect();
                let mut figure = self.worst(name, all.iter(), permissible)?;
                figure.inconclusive = Some(format!("measure three times again: {}", words.join(", ")));
                Some(figure)
            }
        }
    }

    /// R_0; without a length that has three values its limit fails.
    fn repeatability(&self, run: &str, sets: &[Set], findings: &mut Findings) {
        let widest = sets.iter().filter_map(|set| set.range.map(|range| (range, set)));
        let widest = widest.reduce(|most, next| if next.0 > most.0 { next } else { most });
        if widest.is_some() || self.repeatability_um.is_some() {
            let range = widest.map_or(f64::NAN, |(range, _)| 1e3 * range);
            findings.figures.push(figure(format!("R_0 max[{run}]"), range, "um").limited(self.repeatability_um));
        }
        if let Some((_, Set { line, reference, .. })) = widest {
            findings.remarks.push(format!("{run}: R_0 is largest on line {line} at {reference} mm"));
        }
    }

    /// Tells what the programme lacks; gives it where that is most of it.
    fn plan(&self, run: &str, sets: &[Set], findings: &mut Findings) -> Option<String> {
        let other = sets.iter().filter(|set| set.places.len() != VALUES).count();
        if other > 0 {
            let text = format!("{run}: {other} lengths have not {VALUES} values: they have no R_0");
            findings.remarks.push(text);
        }
        let lines = if self.stylus_beside_mm == 0.0 { LINES } else { LINES_BESIDE };
        let (count, beside) = (sets.len(), self.stylus_beside_mm);
        if count == lines * LENGTHS {
            return None;
        }
        let text = format!("{count} lengths; the test of E_{beside} has {LENGTHS} on each of {lines} lines");
        findings.remarks.push(format!("{run}: {text}"));
        Some(text).filter(|_| lacks_most(count, lines * LENGTHS))
    }
}

impl Acceptance for Lengths {
    fn findings(&self, data: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        let (test, repeats) = match data {
            [test] => (test, Vec::new()),
            [test, repeats] => {
                let all = measured(repeats)?;
                findings.remarks.extend(misplaced(&run_name(repeats), repeats, &all));
                (test, all)
            }
            _ => return Err(Error::usage("a test and its repeats were expected: two data sets").setting("from")),
        };
        self.judge(test, &repeats, &mut findings)?;
        findings.remarks.push(format!(
            "{EDITION} (its text was not at hand). A choice of this project: up to five sets may have one value outside, each is \
             measured three times again"
        ));
        Ok(findings)
    }
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    /// Lengths of five lines, each three times, with scatter and digits, mm.
    fn lengths(random: &mut Generator, [scatter, digit, of_reference]: [f64; 3]) -> Vec<Measured> {
        let slope = 1e-3 * scatter * random.uniform();
        let of = |place: usize| {
            let nominal = 100.0 + 80.0 * (place / 3 % 5) as f64 + 0.003 * random.uniform();
            let reference = (nominal / of_reference).round() * of_reference;
            let measured = reference + slope * reference + scatter * random.normal();
            Measured { line: (place / 15).to_string(), reference, measured: (measured / digit).round() * digit }
        };
        (0..105).map(of).collect()
    }

    #[test]
    fn lengths_that_were_measured_get_no_word() {
        for seed in 0..3_000 {
            let mut random = Generator::new(seed, 1);
            let scatter = 1e-3 * [0.05, 0.2, 0.5, 1.0, 3.0][random.index(5)];
            let digit = 1e-3 * [0.01, 0.1, 0.5, 1.0][random.index(4)];
            let of_reference = 1e-3 * [0.01, 0.1, 1.0][random.index(3)];
            let all = lengths(&mut random, [scatter, digit, of_reference]);
            assert_eq!(calibrated_as_measured(&all), None, "{seed}: {scatter} {digit}");
        }
    }

    #[test]
    fn lengths_that_are_the_calibrated_ones_are_told() {
        for seed in 0..500 {
            let mut random = Generator::new(seed, 2);
            let mut all = lengths(&mut random, [1e-3, 1e-5, 1e-4]);
            let count = 10 + random.index(90);
            all[..count].iter_mut().for_each(|value| value.measured = value.reference);
            let said = calibrated_as_measured(&all).unwrap_or_else(|| panic!("{seed}: {count}"));
            assert!(said.contains("of 105 lengths"), "{said}");
        }
    }
}
