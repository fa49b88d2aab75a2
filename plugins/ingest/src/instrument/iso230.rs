//! Ingest plugin `iso230-dat`: positioning tests as lines `KEY[i,j]=value`.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Context, Dataset, Error, Ingest, Label, Result, SettingsError};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use super::table::{Rows, number, stage_of};
use crate::log::shown;
use abbe_assembly::{Filters, Paths};

abbe_core::register!(
    Ingest,
    "iso230-dat",
    "reads positioning tests with lines KEY[i,j]=value (TGT_DATA, REF_DATA_FWD, REF_DATA_BWD)",
    Settings,
    example,
    build,
    "../../reference/ingest-iso230-dat.md",
);

/// A positioning test.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The file or files, as of `ingest: csv`.
    path: Paths,
    /// What the numbers of REF_DATA_FWD and REF_DATA_BWD are: positions that were reached, or deviations (position reached minus
    /// target). The files do not say it.
    values: Meaning,
    /// The unit of targets, and of positions that were reached. A file whose UNIT is known needs none, and may not state another one.
    units: Option<Axis>,
    /// The unit of deviations; with `values: deviations` only, and then needed.
    deviations_in: Option<Deviation>,
    /// Takes FWD for the negative direction and BWD for the positive one. Published files are known that have them this way round.
    #[serde(default)]
    swap_directions: bool,
    /// As of `ingest: csv`.
    #[serde(default)]
    constants: BTreeMap<String, Label>,
    /// As of `ingest: csv`.
    #[serde(default)]
    ignore: Filters,
    /// As of `ingest: csv`.
    #[serde(default)]
    keep: Filters,
}

/// What the numbers of a reading are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
enum Meaning {
    /// The positions that were reached.
    Positions,
    /// The position reached minus the target.
    Deviations,
}

/// A unit of positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
enum Axis {
    /// Millimetres.
    #[serde(rename = "mm")]
    Millimetres,
    /// Inches.
    #[serde(rename = "in")]
    Inches,
    /// Degrees.
    #[serde(rename = "deg")]
    Degrees,
}

/// A unit of deviations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
enum Deviation {
    /// Micrometres.
    #[serde(rename = "um")]
    Micrometres,
    /// Millimetres.
    #[serde(rename = "mm")]
    Millimetres,
    /// Inches.
    #[serde(rename = "in")]
    Inches,
    /// Degrees.
    #[serde(rename = "deg")]
    Degrees,
    /// Seconds of arc.
    #[serde(rename = "arcsec")]
    ArcSeconds,
    /// Microradians.
    #[serde(rename = "urad")]
    Microradians,
}

impl Axis {
    /// What files write behind UNIT.
    fn of(written: &str) -> Option<Self> {
        match written.to_ascii_lowercase().as_str() {
            "mm" | "millimeter" | "millimetre" => Some(Self::Millimetres),
            "in" | "inch" | "inches" => Some(Self::Inches),
            "deg" | "degree" | "degrees" => Some(Self::Degrees),
            _ => None,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Millimetres => "mm",
            Self::Inches => "in",
            Self::Degrees => "deg",
        }
    }

    fn turns(self) -> bool {
        self == Self::Degrees
    }

    /// mm or rad in one of it.
    fn scale(self) -> f64 {
        match self {
            Self::Millimetres => 1.0,
            Self::Inches => 25.4,
            Self::Degrees => 1f64.to_radians(),
        }
    }
}

impl Deviation {
    fn turns(self) -> bool {
        matches!(self, Self::Degrees | Self::ArcSeconds | Self::Microradians)
    }

    /// mm or rad in one of it.
    fn scale(self) -> f64 {
        match self {
            Self::Micrometres => 1e-3,
            Self::Millimetres => 1.0,
            Self::Inches => 25.4,
            Self::Degrees => 1f64.to_radians(),
            Self::ArcSeconds => (1.0 / 3600.0_f64).to_radians(),
            Self::Microradians => 1e-6,
        }
    }
}

fn example() -> Value {
    json!({ "path": "x-axis.dat", "values": "positions", "units": "mm" })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    let Settings { path, values, units, deviations_in, swap_directions, constants, ignore, keep } = settings;
    match (values, deviations_in, units) {
        (Meaning::Deviations, None, _) => {
            let error = SettingsError::new("deviations_in", "the unit of deviations is missing");
            return Err(error.help("write `deviations_in: um`, or mm, in, deg, arcsec, urad; it is not guessed"));
        }
        (Meaning::Positions, Some(_), _) => {
            return Err(SettingsError::new("deviations_in", "`values: positions` have the unit of targets"));
        }
        (_, Some(deviation), Some(units)) if deviation.turns() != units.turns() => {
            return Err(SettingsError::new("deviations_in", "lengths and angles do not go together"));
        }
        _ => {}
    }
    let wanted = Wanted { units, deviations_in, swap: swap_directions };
    let read = move |path: &Path, text: &str| read(path, text, wanted);
    stage_of(path, constants, [ignore, keep], context, Box::new(read))
}

/// What the recipe says of a file.
#[derive(Debug, Clone, Copy)]
struct Wanted {
    units: Option<Axis>,
    /// Without it the numbers are positions.
    deviations_in: Option<Deviation>,
    swap: bool,
}

/// A value with its line and the character at which it begins.
type Placed<T> = (T, usize, usize);

/// A file, before it is put in order.
#[derive(Default)]
struct File {
    unit: Option<Placed<String>>,
    cycles: Option<Placed<usize>>,
    positions: Option<Placed<usize>>,
    targets: BTreeMap<usize, Placed<f64>>,
    /// Forward and backward, by target and run.
    readings: [BTreeMap<(usize, usize), Placed<f64>>; 2],
}

/// The keys with indices, and how many.
const TARGETS: &str = "TGT_DATA";
const READINGS: [&str; 2] = ["REF_DATA_FWD", "REF_DATA_BWD"];

/// Most targets and runs: an index beyond is a mistake.
const MOST: usize = 100_000;

fn read(path: &Path, text: &str, wanted: Wanted) -> Result<(Dataset, Vec<String>)> {
    let mut file = File::default();
    let mut passed: Vec<&str> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        if let Some(key) = file.line(path, index + 1, line)? {
            passed.push(key);
        }
    }
    passed.sort_unstable();
    passed.dedup();
    let remarks = match passed.is_empty() {
        true => Vec::new(),
        false => vec![format!("passed over: {}", passed.join(", "))],
    };
    Ok((file.rows(path, wanted)?, remarks))
}

impl File {
    /// A line; gives the key if nothing is taken from it.
    fn line<'a>(&mut self, path: &Path, line: usize, written: &'a str) -> Result<Option<&'a str>> {
        let wrong = |column: usize, message: String| Error::data(message).at(path, line, Some(column));
        let content = written.trim();
        if content.is_empty() || content.starts_with('#') {
            return Ok(None);
        }
        let begin = written.chars().take_while(|it| it.is_whitespace()).count() + 1;
        let Some((left, value)) = content.split_once('=') else {
            let message = format!("`{}`: a line KEY=value or KEY[i,j]=value was expected", shown(content));
            return Err(wrong(begin, message));
        };
        let column = begin + left.chars().count() + 1;
        let value = value.split(" #").next().unwrap_or_default().trim().trim_matches(['"', '\'']).trim();
        let (key, indices) = match left.split_once('[') {
            None => (left.trim(), None),
            Some((key, rest)) => {
                let indices =
                    rest.trim_end().strip_suffix(']').map(|inner| inner.split(',').map(|it| it.trim().parse()));
                let indices: Option<Vec<usize>> = indices.and_then(|indices| indices.collect::<Result<_, _>>().ok());
                let indices = indices.filter(|indices| indices.iter().all(|index| *index <= MOST));
                let message = format!("`[{}`: indices from 0 or 1 were expected, as in [3] or [3,2]", shown(rest));
                (key.trim(), Some(indices.ok_or_else(|| wrong(begin + key.chars().count(), message))?))
            }
        };
        let twice = |first: usize| wrong(begin, format!("{} stands in line {first} already", shown(left)));
        let figure = || number(value).ok_or_else(|| wrong(column, format!("`{}` is no number", shown(value))));
        let direction = READINGS.iter().position(|known| *known == key);
        match (key, indices.as_deref(), direction) {
            (TARGETS, Some([target]), _) => {
                if let Some((_, first, _)) = self.targets.insert(*target, (figure()?, line, column)) {
                    return Err(twice(first));
                }
            }
            (_, Some([target, run]), Some(direction)) => {
                let placed = (figure()?, line, column);
                if let Some((_, first, _)) = self.readings[direction].insert((*target, *run), placed) {
                    return Err(twice(first));
                }
            }
            (TARGETS, ..) => return Err(wrong(begin, format!("{TARGETS} has one index, as in {TARGETS}[3]"))),
            (_, _, Some(_)) => return Err(wrong(begin, format!("{key} has two indices, as in {key}[3,2]"))),
            ("UNIT", None, _) => {
                if let Some((_, first, _)) = self.unit.replace((value.to_owned(), line, column)) {
                    return Err(twice(first));
                }
            }
            ("CYCLES" | "POSITIONS", None, _) => {
                let count = value.parse().ok().filter(|count| (1..=MOST).contains(count));
                let count =
                    count.ok_or_else(|| wrong(column, format!("`{}`: a number from 1 was expected", shown(value))))?;
                let home = if key == "CYCLES" { &mut self.cycles } else { &mut self.positions };
                if let Some((_, first, _)) = home.replace((count, line, column)) {
                    return Err(twice(first));
                }
            }
            _ => return Ok(Some(key)),
        }
        Ok(None)
    }

    /// The unit of targets.
    fn unit(&self, path: &Path, wanted: Wanted) -> Result<Axis> {
        let Some((written, line, column)) = &self.unit else {
            let error = Error::data("the file does not say the unit of its targets (UNIT=)").in_file(path);
            return wanted.units.ok_or_else(|| error.help("write `units: mm`, `in` or `deg`; it is not guessed"));
        };
        match (Axis::of(written), wanted.units) {
            (Some(own), Some(stated)) if own != stated => {
                let message = format!("UNIT is `{}`, and the recipe says {}", shown(written), stated.name());
                Err(Error::data(message).at(path, *line, Some(*column)).help("which one is right?"))
            }
            (Some(own), _) => Ok(own),
            (None, Some(stated)) => Ok(stated),
            (None, None) => {
                let message = format!("UNIT is `{}`, which is not known", shown(written));
                let error = Error::data(message).at(path, *line, Some(*column));
                Err(error.help("write `units: mm`, `in` or `deg`; it is not guessed"))
            }
        }
    }

    fn rows(self, path: &Path, wanted: Wanted) -> Result<Dataset> {
        let unit = self.unit(path, wanted)?;
        if wanted.deviations_in.is_some_and(|deviation| deviation.turns() != unit.turns()) {
            let message = format!("targets are in {}: lengths and angles do not go together", unit.name());
            return Err(Error::data(message).in_file(path).help("write another `deviations_in`"));
        }
        let at = |line: usize, message: String| Error::data(message).at(path, line, None);
        let missing = |what: &str| Error::data(format!("there is no {what} in the file")).in_file(path);
        let first = *self.targets.keys().next().ok_or_else(|| missing(TARGETS))?;
        let count = self.positions.as_ref().map_or(self.targets.len(), |(count, ..)| *count);
        if first > 1 {
            return Err(missing(&format!("{TARGETS}[0] or {TARGETS}[1]")));
        }
        if let Some(gap) = (first..first + count).find(|index| !self.targets.contains_key(index)) {
            return Err(missing(&format!("{TARGETS}[{gap}]")).help("is the file cut?"));
        }
        if let Some((index, (_, line, _))) = self.targets.range(first + count..).next() {
            return Err(at(*line, format!("{TARGETS}[{index}] is beyond the {count} POSITIONS")));
        }
        let runs = self.runs(path, first, count)?;
        let (position, reading) = match unit.turns() {
            true => ("position_rad", "reading_rad"),
            false => ("position_mm", "reading_mm"),
        };
        let mut rows = Rows::new(path, &["run", "direction", position, reading]);
        for (number, run) in runs.iter().enumerate() {
            for (place, readings) in self.readings.iter().enumerate() {
                let sign = if (place == 0) != wanted.swap { "1" } else { "-1" };
                // Backward runs come from the far end.
                let mut targets: Vec<_> = self.targets.iter().collect();
                if place == 1 {
                    targets.reverse();
                }
                for (index, (target, ..)) in targets {
                    let Some((value, line, _)) = readings.get(&(*index, *run)) else { continue };
                    let position = target * unit.scale();
                    let deviation = match wanted.deviations_in {
                        Some(deviation) => value * deviation.scale(),
                        None => (value - target) * unit.scale(),
                    };
                    rows.push(*line, &[&(number + 1).to_string(), sign], &[position, deviation]);
                }
            }
        }
        rows.finish("reading (REF_DATA_FWD, REF_DATA_BWD)")
    }

    /// The numbers of the runs. Every direction that is there has all targets in all of them.
    fn runs(&self, path: &Path, first: usize, count: usize) -> Result<Vec<usize>> {
        let at = |line: usize, message: String| Error::data(message).at(path, line, None);
        let all = self.readings.iter().flatten();
        let mut runs: Vec<usize> = all.clone().map(|((_, run), _)| *run).collect();
        runs.sort_unstable();
        runs.dedup();
        for ((target, run), (_, line, _)) in all {
            if !(first..first + count).contains(target) {
                let message =
                    format!("[{target},{run}] belongs to no target; {first} to {} were expected", first + count - 1);
                let help = "the first index is that of the target, the second that of the run";
                return Err(at(*line, message).help(help));
            }
        }
        if let Some((cycles, line, _)) = self.cycles.as_ref().filter(|(cycles, ..)| *cycles != runs.len()) {
            let message = format!("CYCLES is {cycles}, and there are readings of {} runs", runs.len());
            return Err(at(*line, message).help("the second index is that of the run; is the file cut?"));
        }
        for (name, readings) in READINGS.iter().zip(&self.readings).filter(|(_, readings)| !readings.is_empty()) {
            let pairs = runs.iter().flat_map(|run| (first..first + count).map(move |target| (target, *run)));
            if let Some((target, run)) = pairs.into_iter().find(|pair| !readings.contains_key(pair)) {
                let error = Error::data(format!("there is no {name}[{target},{run}] in the file")).in_file(path);
                return Err(error.help("a test has every target in every run; is the file cut?"));
            }
        }
        Ok(runs)
    }
}
