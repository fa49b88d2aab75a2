//! What a recipe is expected to find: a text beside it that people review, and the comparison with what it found.
//!
//! Uncertainty decides what is a change, not the last digit: a value has changed if it differs by more than a stated part of
//! its standard uncertainty. That is the uncertainty from what the rows state, where the estimate tells it; without noise the
//! one from residuals is rounding.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use abbe_core::{Calibration, Error, Estimated, Result, Status, Unit};
use abbe_engine::Outcome;
use abbe_report::number::{short, with_uncertainty};

/// The first line of the file, without the name of the recipe.
const HEAD: &str = "# What `abbe test` expects of ";

/// The number of the format.
const FORMAT: &str = "format 1";

/// One thing that is expected.
#[derive(Debug, Clone, PartialEq)]
enum Content {
    /// It has to be the same.
    Text(String),
    /// A value with its standard uncertainty, in the unit of people.
    Value { value: f64, uncertainty: f64, unit: String, status: String },
    /// A size, which may differ by a part of itself.
    Size { value: f64, unit: String },
    /// Columns of numbers in a file: the sum of sizes of each, and how it leans ([`columns`]).
    Columns(Vec<[f64; 2]>),
}

/// All that is expected of a run, in its order: (what, content).
#[derive(Debug, Clone, PartialEq)]
pub struct Expected(Vec<(String, Content)>);

/// Differences below this are rounding, in the unit of people: 0.1 nm, 0.1 nrad.
const ROUNDING: f64 = 1e-4;

/// Relative differences below this are rounding.
const RELATIVE: f64 = 1e-6;

/// Sizes of residuals below this are rounding, µm or µrad.
const NO_RESIDUAL: f64 = 1e-3;

/// What to do about a file that cannot be understood: nothing is written in the place of what may be somebody's text.
pub const NEW: &str = "move the file away, and `abbe test --accept` writes a new one";

impl Expected {
    /// What a run found.
    pub fn of(outcome: &Outcome) -> Self {
        let mut all = vec![("run".to_owned(), Content::Text(outcome.decision().to_string()))];
        for failure in &outcome.failures {
            all.push((format!("stage {}", failure.stage), Content::Text("failed".to_owned())));
        }
        for verdict in &outcome.verdicts {
            let stage = &verdict.stage;
            all.push((format!("verdict {stage}"), Content::Text(verdict.decision.to_string())));
            for figure in &verdict.figures {
                let Some(decision) = figure.decision else { continue };
                let of = figure.of.as_ref().map_or(String::new(), |of| format!("{of} "));
                all.push((format!("figure {stage} {of}{}", figure.name), Content::Text(decision.to_string())));
            }
        }
        for fit in &outcome.fits {
            of_fit(&fit.name, &fit.calibration, &mut all);
        }
        for (stage, files) in &outcome.exports {
            for file in files {
                let text = String::from_utf8_lossy(&file.content);
                let (shape, numbers) = taken_apart(&text);
                let name = format!("file {stage}/{}", file.name);
                all.push((name.clone(), Content::Text(format!("{} numbers, text {shape:016x}", numbers.len()))));
                all.push((format!("{name} numbers"), Content::Columns(columns(&text))));
            }
        }
        Self(distinct(all))
    }

    /// The text of the file.
    pub fn text(&self, recipe: &str) -> String {
        let mut text = format!("{HEAD}{recipe}. Look at differences, then `abbe test --accept`.\n{FORMAT}\n");
        for (name, content) in &self.0 {
            let _ = writeln!(text, "{name} = {}", content.text());
        }
        text
    }

    /// The same with the remarks of the text that it replaces, each before what it stood before; what is gone leaves its remarks to what
    /// comes next.
    pub fn text_with_remarks(&self, recipe: &str, before: &str) -> String {
        let mut remarks: Vec<&str> = Vec::new();
        let mut of_entries: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        let own: BTreeSet<&str> = self.0.iter().map(|(name, _)| name.as_str()).collect();
        for line in before.lines().filter(|line| !line.starts_with(HEAD)) {
            if line.starts_with('#') || line.is_empty() {
                remarks.push(line);
                continue;
            }
            let name = line.split_once(" = ").map_or(line, |(name, _)| name);
            if line == FORMAT || own.contains(name) {
                of_entries.insert(name, std::mem::take(&mut remarks));
            }
        }
        let mut text = String::new();
        for (index, line) in self.text(recipe).lines().enumerate() {
            let name = line.split_once(" = ").map_or(line, |(name, _)| name);
            let kept = if index == 0 { Vec::new() } else { of_entries.remove(name).unwrap_or_default() };
            kept.into_iter().chain([line]).for_each(|line| text.extend([line, "\n"]));
        }
        remarks.into_iter().for_each(|line| text.extend([line, "\n"]));
        text
    }

    /// Reads a file. Fails with the line that is wrong.
    pub fn read<'t>(text: &'t str) -> Result<Self> {
        let mut lines = text.lines().enumerate().filter(|(_, line)| !line.starts_with('#') && !line.is_empty());
        if lines.next().is_none_or(|(_, line)| line != FORMAT) {
            return Err(Error::data(format!("`{FORMAT}` was expected in the first line that is no remark")).help(NEW));
        }
        let mut seen: BTreeMap<&str, usize> = BTreeMap::new();
        let mut read = |(index, line): (usize, &'t str)| {
            let wrong = |message: String| Error::data(format!("line {}: {message}", index + 1)).help(NEW);
            let (name, content) =
                line.split_once(" = ").ok_or_else(|| wrong("`what = value` was expected".to_owned()))?;
            if let Some(first) = seen.insert(name, index + 1) {
                return Err(wrong(format!("`{name}` stands here a second time, after line {first}")));
            }
            Ok((name.to_owned(), Content::read(content)))
        };
        Ok(Self(lines.map(&mut read).collect::<Result<_>>()?))
    }

    /// What differs from what was expected, in sentences; `part` is the part of its standard uncertainty by which a value may
    /// differ.
    pub fn differences(&self, found: &Self, part: f64) -> Vec<String> {
        let by_name: BTreeMap<&str, &Content> =
            found.0.iter().map(|(name, content)| (name.as_str(), content)).collect();
        let was: BTreeMap<&str, &Content> = self.0.iter().map(|(name, content)| (name.as_str(), content)).collect();
        let changed = self.0.iter().filter_map(|(name, content)| match by_name.get(name.as_str()) {
            None => Some(format!("{name}: gone, was {}", content.text())),
            Some(found) => content.difference(found, part).map(|text| format!("{name}: {text}")),
        });
        let new = found.0.iter().filter(|(name, _)| !was.contains_key(name.as_str()));
        changed.chain(new.map(|(name, content)| format!("{name}: new, {}", content.text()))).collect()
    }
}

/// The same with a number behind what has the same name as something before.
fn distinct(all: Vec<(String, Content)>) -> Vec<(String, Content)> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    let number = |(name, content): (String, Content)| {
        let count = seen.entry(name.clone()).or_default();
        *count += 1;
        (if *count == 1 { name } else { format!("{name} #{count}") }, content)
    };
    all.into_iter().map(number).collect()
}

fn of_fit(name: &str, calibration: &Calibration, all: &mut Vec<(String, Content)>) {
    let fit = &calibration.fit;
    let counts = format!(
        "{} equations, {} unknowns, rank {}, {} degrees of freedom",
        fit.observations, fit.unknowns, fit.rank, fit.degrees_of_freedom
    );
    all.push((format!("estimate {name}"), Content::Text(counts)));
    for direction in &fit.null_space {
        let mut names: Vec<&str> = direction.combination.iter().map(|part| part.name.as_str()).collect();
        names.sort_unstable();
        all.push((format!("{name} lost {}", names.join(", ")), Content::Text("yes".to_owned())));
    }
    for outlier in &calibration.outliers {
        let file = outlier.file.rsplit(['/', '\\']).next().unwrap_or_default();
        let place = format!("{name} outlier {} {file} row {}", outlier.stage, outlier.row);
        all.push((place, Content::Text("yes".to_owned())));
    }
    if fit.observations > 0 {
        let sizes = [("µm", Some(fit.residual_rms_um)), ("µrad", fit.residual_rms_urad)];
        for (unit, value) in sizes {
            let Some(value) = value.filter(|value| *value > 0.0) else { continue };
            let value = if value < NO_RESIDUAL { 0.0 } else { value };
            all.push((format!("{name} residual RMS {unit}"), Content::Size { value, unit: unit.to_owned() }));
        }
    }
    for estimated in calibration.parameters.iter().filter(|estimated| estimated.status != Status::Fixed) {
        all.push((format!("{name} {}", estimated.name), of_value(calibration, estimated)));
    }
}

fn of_value(calibration: &Calibration, estimated: &Estimated) -> Content {
    let (unit, factor) = estimated.unit.parse::<Unit>().map_or((estimated.unit.clone(), 1.0), Unit::for_people);
    let budget = calibration.uncertainty.as_ref();
    let stated = budget.and_then(|budget| budget.parameters.iter().find(|entry| entry.name == estimated.name));
    let uncertainty = stated.map_or(estimated.standard_uncertainty, |entry| entry.stated_standard_uncertainty);
    let status = match estimated.status {
        Status::Estimated => "estimated",
        Status::Fixed => "fixed",
        Status::Considered => "considered",
        Status::Confounded => "confounded",
    };
    let (value, uncertainty) = (estimated.value * factor, uncertainty * factor);
    // What is written is what is compared.
    Content::read(&Content::Value { value, uncertainty, unit, status: status.to_owned() }.text())
}

/// Columns of a file that are told apart; further ones count as the last.
const COLUMNS: usize = 8;

/// Of the numbers at each place of their lines, and of differences of neighbours in short lines: the sum of their sizes, and how they lean: the part of it with signs, those further down
/// weighing more, so that turned signs are seen where positive and negative numbers are as many.
fn columns(text: &str) -> Vec<[f64; 2]> {
    let mut all: Vec<Vec<f64>> = Vec::new();
    for line in text.lines() {
        let mut numbers = taken_apart(line).1;
        if numbers.len() <= COLUMNS / 2 {
            // Corrected positions beside programmed ones: what matters is the difference.
            let differences: Vec<f64> = numbers.windows(2).map(|pair| pair[1] - pair[0]).collect();
            numbers.extend(differences);
        }
        for (place, number) in numbers.into_iter().enumerate() {
            let place = place.min(COLUMNS - 1);
            if all.len() <= place {
                all.push(Vec::new());
            }
            all[place].push(number);
        }
    }
    let told = |numbers: &Vec<f64>| {
        let weighed = |of: fn(f64) -> f64| -> f64 {
            numbers.iter().enumerate().map(|(row, number)| (row + 1) as f64 * of(*number)).sum()
        };
        let lean = weighed(|number| number) / weighed(f64::abs).max(f64::MIN_POSITIVE);
        [numbers.iter().map(|number| number.abs()).sum(), (lean * 100.0).round() / 100.0 + 0.0]
    };
    all.iter().map(told).collect()
}

/// Sums of a column below this are rounding.
const NOTHING: f64 = 1e-6;

/// How much the lean of a column may change.
const LEAN: f64 = 0.05;

impl Content {
    fn text(&self) -> String {
        match self {
            Self::Text(text) => text.replace('\n', " "),
            Self::Columns(columns) => {
                let told = columns.iter().map(|[size, lean]| {
                    format!("{} leaning {lean}", if *size == 0.0 { "0".to_owned() } else { short(*size) })
                });
                format!("columns {}", told.collect::<Vec<_>>().join(", "))
            }
            // Three digits of the uncertainty: a tenth of it is still seen.
            Self::Value { value, uncertainty, unit, status } => {
                let told = match *uncertainty > ROUNDING {
                    true => finer(*value, *uncertainty),
                    false => format!("{} ± 0", rounded(*value)),
                };
                format!("{told} {unit}, {status}")
            }
            Self::Size { value, unit } => {
                format!("about {} {unit}", if *value == 0.0 { "0".to_owned() } else { short(*value) })
            }
        }
    }

    /// What a line says; a number that is none makes it a text, which equals no value.
    fn read(text: &str) -> Self {
        fn number(text: &str) -> Option<f64> {
            text.parse().ok().filter(|number: &f64| number.is_finite())
        }
        let whole = || Self::Text(text.to_owned());
        if let Some((value, unit)) = text.strip_prefix("about ").and_then(|rest| rest.split_once(' ')) {
            return number(value).map_or_else(whole, |value| Self::Size { value, unit: unit.to_owned() });
        }
        let columns = text.strip_prefix("columns ").map(|rest| {
            let column = |part: &str| {
                let (size, lean) = part.split_once(" leaning ")?;
                Some([number(size)?, number(lean)?])
            };
            rest.split(", ").filter(|part| !part.is_empty()).map(column).collect::<Option<Vec<_>>>()
        });
        if let Some(columns) = columns {
            return columns.map_or_else(whole, Self::Columns);
        }
        let parts = || {
            let (value, rest) = text.split_once(" ± ")?;
            let (uncertainty, rest) = rest.split_once(' ')?;
            let (unit, status) = rest.rsplit_once(", ")?;
            let (value, uncertainty) = (number(value)?, number(uncertainty)?);
            Some(Self::Value { value, uncertainty, unit: unit.to_owned(), status: status.to_owned() })
        };
        parts().unwrap_or_else(whole)
    }

    /// What has changed, if it is more than chance or rounding.
    fn difference(&self, found: &Self, part: f64) -> Option<String> {
        let told = || format!("{}, expected {}", found.text(), self.text());
        match (self, found) {
            (Self::Columns(columns), Self::Columns(others)) => {
                let differs = |([size, lean], [other, of_other]): (&[f64; 2], &[f64; 2])| {
                    (size - other).abs() > part * size.abs().max(other.abs()) + NOTHING
                        || (lean - of_other).abs() > LEAN && size.max(*other) > NOTHING
                };
                (columns.len() != others.len() || columns.iter().zip(others).any(differs)).then(told)
            }
            (Self::Size { value, unit }, Self::Size { value: other, unit: of_other }) => {
                let most = part * value.abs().max(other.abs()) + NO_RESIDUAL;
                (unit != of_other || (value - other).abs() > most).then(told)
            }
            (
                Self::Value { value, uncertainty, unit, status },
                Self::Value { value: other, uncertainty: of_other, unit: unit_of_other, status: status_of_other },
            ) => {
                let larger = uncertainty.max(*of_other);
                let apart = (value - other).abs();
                // Half a digit of the file on both sides.
                let most = part * larger + ROUNDING + RELATIVE * value.abs() + larger * 0.01;
                if unit != unit_of_other || status != status_of_other {
                    return Some(told());
                }
                if apart > most {
                    let times = apart / larger.max(f64::MIN_POSITIVE);
                    let by = if larger > 0.0 {
                        format!(", {} standard uncertainties apart", short(times))
                    } else {
                        String::new()
                    };
                    return Some(told() + &by);
                }
                ((uncertainty - of_other).abs() > part * larger + 10.0 * ROUNDING).then(told)
            }
            (one, other) => (one != other).then(told),
        }
    }
}

/// A value with its uncertainty to three digits of this.
fn finer(value: f64, uncertainty: f64) -> String {
    let decimals = (2 - uncertainty.log10().floor() as i32).clamp(0, 9) as usize;
    if uncertainty >= 1e6 || value.abs() >= 1e12 {
        return with_uncertainty(value, uncertainty);
    }
    format!("{} ± {uncertainty:.decimals$}", no_minus_zero(format!("{value:.decimals$}")))
}

/// A value without an uncertainty to six digits or the fourth decimal.
fn rounded(value: f64) -> String {
    let decimals = if value == 0.0 { 0 } else { (5 - value.abs().log10().floor() as i32).clamp(0, 4) as usize };
    no_minus_zero(format!("{value:.decimals$}"))
}

fn no_minus_zero(text: String) -> String {
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|digit| digit == '0' || digit == '.') => rest.to_owned(),
        _ => text,
    }
}

/// Where the groups of an identifier in the form of a UUID end, in bytes from its beginning.
const GROUPS: [usize; 5] = [8, 13, 18, 23, 36];

/// Whether a text begins with a UUID.
fn begins_with_uuid(bytes: &[u8]) -> bool {
    let is_right = |(place, byte): (usize, &u8)| match GROUPS.contains(&place) {
        true => *byte == b'-',
        false => byte.is_ascii_hexdigit(),
    };
    bytes.get(..GROUPS[4]).is_some_and(|bytes| bytes.iter().enumerate().all(is_right))
}

/// A digest of a text without its numbers (FNV-1a, Fowler, Noll & Vo 1991), and the numbers with a point or an exponent. UUIDs are left out:
/// they follow from the last digits.
fn taken_apart(text: &str) -> (u64, Vec<f64>) {
    let (mut digest, mut numbers) = (0xcbf2_9ce4_8422_2325_u64, Vec::new());
    let mut mix = |byte: u8| digest = (digest ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    let bytes = text.as_bytes();
    let mut at = 0;
    while at < bytes.len() {
        let from = at;
        if begins_with_uuid(&bytes[at..]) {
            at += GROUPS[4];
            continue;
        }
        while at < bytes.len() && (bytes[at].is_ascii_digit() || bytes[at] == b'.') {
            at += 1;
        }
        if at == from || bytes[from] == b'.' && at == from + 1 {
            // A sign belongs to its number, and rounding turns it.
            if bytes[from] != b'-' {
                mix(bytes[from]);
            }
            at = from + 1;
            continue;
        }
        let has_exponent = at + 1 < bytes.len() && matches!(bytes[at], b'e' | b'E');
        if has_exponent {
            let sign = usize::from(matches!(bytes.get(at + 1), Some(b'-' | b'+')));
            let digits = bytes[at + 1 + sign..].iter().take_while(|digit| digit.is_ascii_digit()).count();
            at += if digits > 0 { 1 + sign + digits } else { 0 };
        }
        match text[from..at].parse::<f64>() {
            Ok(number) if number.is_finite() && text[from..at].contains(['.', 'e', 'E']) => {
                mix(b'#');
                let is_negative = from > 0 && bytes[from - 1] == b'-';
                numbers.push(if is_negative { -number } else { number });
            }
            // Whole numbers count things, and number lines: they have to be the same.
            _ => text.as_bytes()[from..at].iter().for_each(|byte| mix(*byte)),
        }
    }
    (digest, numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(value: f64, uncertainty: f64) -> Content {
        Content::Value { value, uncertainty, unit: "µm/m".to_owned(), status: "estimated".to_owned() }
    }

    fn of(contents: &[(&str, Content)]) -> Expected {
        Expected(contents.iter().map(|(name, content)| ((*name).to_owned(), content.clone())).collect())
    }

    #[test]
    fn what_is_written_is_read() {
        let told = of(&[
            ("run", Content::Text("pass".to_owned())),
            ("fit EXX[1]", value(-8.640, 1.230)),
            ("fit dxt", value(61.0, 0.0)),
            ("fit residual RMS µm", Content::Size { value: 1.38, unit: "µm".to_owned() }),
        ]);
        let text = told.text("a.yaml");
        insta::assert_snapshot!(text);
        assert_eq!(Expected::read(&text).unwrap(), told);
        assert_eq!(
            Expected::read("run = pass\n").unwrap_err().message,
            "`format 1` was expected in the first line that is no remark"
        );
        assert_eq!(Expected::read("format 1\nrun pass\n").unwrap_err().message, "line 2: `what = value` was expected");
    }

    #[test]
    fn remarks_stay() {
        let text = |content: &str| Content::Text(content.to_owned());
        let before = of(&[("run", text("pass")), ("old", text("yes")), ("fit", text("yes")), ("last", text("yes"))]);
        let head = before.text("a.yaml").lines().next().unwrap().to_owned();
        let written = format!(
            "{head}\n# By hand\n{FORMAT}\n# Why it passes\nrun = pass\n# Of the old\nold = yes\n\n# Of the fit = 1\nfit = yes\n\
             last = yes\n# The end\n"
        );
        assert_eq!(Expected::read(&written).unwrap(), before);
        let now = of(&[("run", text("fail")), ("new", text("yes")), ("fit", text("no")), ("last", text("yes"))]);
        let expected = format!(
            "{head}\n# By hand\n{FORMAT}\n# Why it passes\nrun = fail\nnew = yes\n# Of the old\n\n# Of the fit = 1\nfit = no\n\
             last = yes\n# The end\n"
        );
        let kept = now.text_with_remarks("a.yaml", &written);
        assert_eq!(kept, expected);
        assert_eq!(Expected::read(&kept).unwrap(), now);
        assert_eq!(now.text_with_remarks("a.yaml", &kept), kept);
        assert_eq!(now.text_with_remarks("a.yaml", &now.text("a.yaml")), now.text("a.yaml"));
    }

    #[test]
    fn uncertainty_decides_what_is_a_change() {
        let before = of(&[("a", value(100.0, 10.0))]);
        for (value_now, uncertainty, is_change) in
            [(100.9, 10.0, false), (101.3, 10.0, true), (98.7, 10.0, true), (100.0, 10.8, false), (100.0, 12.0, true)]
        {
            let told = before.differences(&of(&[("a", value(value_now, uncertainty))]), 0.1);
            assert_eq!(!told.is_empty(), is_change, "{value_now} {uncertainty}: {told:?}");
        }
        // Without an uncertainty rounding decides.
        let before = of(&[("a", value(100.0, 0.0))]);
        assert!(before.differences(&of(&[("a", value(100.00005, 0.0))]), 0.1).is_empty());
        assert_eq!(before.differences(&of(&[("a", value(100.001, 0.0))]), 0.1).len(), 1);
    }

    #[test]
    fn what_comes_and_goes_is_told() {
        let yes = || Content::Text("yes".to_owned());
        let told = of(&[("a", yes()), ("b", yes())])
            .differences(&of(&[("b", Content::Text("no".to_owned())), ("c", yes())]), 0.1);
        assert_eq!(told, ["a: gone, was yes", "b: no, expected yes", "c: new, yes"]);
    }

    #[test]
    fn files_are_taken_apart() {
        let (shape, numbers) = taken_apart("N10 G1 X-1.5 Y2e-3\n");
        assert_eq!(numbers, [-1.5, 2e-3]);
        assert_eq!(taken_apart("N10 G1 X1.51 Y2.1e-3\n").0, shape);
        assert_ne!(taken_apart("N11 G1 X1.51 Y2.1e-3\n").0, shape);
        assert_ne!(taken_apart("N10 G1 Z1.51 Y2.1e-3\n").0, shape);
        assert!(taken_apart("... . -\u{e9}").1.is_empty());
        let [one, other] = ["1a2b3c4d-7060-8e22-9abc-0123456789ab", "0a2b3c4d-1e25-8f22-9abc-0123456789ab"]
            .map(|id| taken_apart(&format!("<QPId>{id}</QPId> 1.5")));
        assert_eq!(one, other);
        assert_eq!(one.1, [1.5]);
    }

    #[test]
    fn turned_signs_in_files_are_a_change() {
        let table = |sign: f64, of: f64| {
            let row = |row: i32| format!("{:.1} {:.4}\n", 50.0 * f64::from(row), sign * of * f64::from(row - 5));
            (0..11).map(row).collect::<String>()
        };
        let told = |text: &str| of(&[("f", Content::Columns(columns(text)))]);
        let before = told(&table(1.0, 0.01));
        assert_eq!(Expected::read(&before.text("a.yaml")).unwrap().differences(&before, 0.1), [""; 0]);
        assert!(before.differences(&told(&table(1.0, 0.01002)), 0.1).is_empty());
        assert_eq!(before.differences(&told(&table(-1.0, 0.01)), 0.1).len(), 1);
        assert_eq!(before.differences(&told(&table(1.0, 0.02)), 0.1).len(), 1);
    }
}
