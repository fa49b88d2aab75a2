//! Ingest plugin `iso230-dat`: positioning tests as lines `KEY[i,j]=value`.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Context, Dataset, Error, Ingest, Label, Result, SettingsError};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use super::table::{Rows, number, stage_of};
use crate::assembly::{Filters, Paths};
use crate::log::shown;

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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const POSITIONS: Wanted = Wanted { units: None, deviations_in: None, swap: false };

    fn of(text: &str, wanted: Wanted) -> Result<Dataset, String> {
        read(Path::new("x.dat"), text, wanted).map(|(data, _)| data).map_err(|error| error.to_string())
    }

    /// Three targets, two runs, indices from 1; a key that nobody needs.
    const SAMPLE: &str = "# X axis, laser interferometer
MACHINE=\"mill 3\"
UNIT=mm
CYCLES=2
POSITIONS=3
TGT_DATA[1]=0.000
TGT_DATA[2]=101.337
TGT_DATA[3]=203.911
REF_DATA_FWD[1,1]=0.0004
REF_DATA_FWD[2,1]=101.3391
REF_DATA_FWD[3,1]=203.9142
REF_DATA_FWD[1,2]=0.0006
REF_DATA_FWD[2,2]=101.3389
REF_DATA_FWD[3,2]=203.9145
REF_DATA_BWD[1,1]=-0.0011
REF_DATA_BWD[2,1]=101.3370
REF_DATA_BWD[3,1]=203.9120
REF_DATA_BWD[1,2]=-.0009
REF_DATA_BWD[2,2]=101.3372
REF_DATA_BWD[3,2]=203.9121
";

    #[test]
    fn a_test_is_read_in_the_order_in_which_it_was_made() {
        let data = of(SAMPLE, POSITIONS).expect("data");
        assert_eq!(data.rows(), 12);
        let (runs, directions) = (data.labels("run").expect("runs"), data.labels("direction").expect("directions"));
        let (positions, readings) = (data.numbers("position").expect("mm"), data.numbers("reading").expect("mm"));
        let row = |row: usize| (runs[abbe_core::DataRow(row)].as_str(), directions[abbe_core::DataRow(row)].as_str());
        assert_eq!([row(0), row(3), row(6)], [("1", "1"), ("1", "-1"), ("2", "1")]);
        let at = |row: usize| (positions[abbe_core::DataRow(row)], readings[abbe_core::DataRow(row)]);
        assert_eq!(at(1).0, 101.337);
        assert!((at(1).1 - 0.0021).abs() < 1e-12, "{:?}", at(1));
        // The way back begins at the far end.
        assert_eq!(at(3).0, 203.911);
        assert!((at(3).1 - 0.001).abs() < 1e-12, "{:?}", at(3));
        // The same file, its directions the other way round.
        let swapped = of(SAMPLE, Wanted { swap: true, ..POSITIONS }).expect("data");
        assert_eq!(swapped.labels("direction").expect("directions")[abbe_core::DataRow(0)], "-1");
    }

    #[test]
    fn what_is_missing_or_contradicts_itself_is_told() {
        let cases = [
            ("UNIT=mm\n", "", "the unit of its targets"),
            ("UNIT=mm", "UNIT=cubit", "x.dat:3:6: UNIT is `cubit`, which is not known"),
            ("CYCLES=2", "CYCLES=3", "x.dat:4: CYCLES is 3, and there are readings of 2 runs"),
            ("POSITIONS=3", "POSITIONS=4", "there is no TGT_DATA[4]"),
            ("POSITIONS=3", "POSITIONS=2", "TGT_DATA[3] is beyond the 2 POSITIONS"),
            ("TGT_DATA[2]=101.337", "TGT_DATA[2]=1O1", "x.dat:7:13: `1O1` is no number"),
            ("TGT_DATA[2]=101.337", "TGT_DATA[1]=101.337", "stands in line 6 already"),
            ("REF_DATA_BWD[2,2]=101.3372\n", "", "there is no REF_DATA_BWD[2,2]"),
            ("REF_DATA_FWD[3,2]", "REF_DATA_FWD[4,2]", "belongs to no target"),
            ("REF_DATA_FWD[3,2]", "REF_DATA_FWD[3]", "has two indices"),
            ("REF_DATA_FWD[3,2]", "REF_DATA_FWD[3;2]", "indices from 0 or 1"),
            ("CYCLES=2", "CYCLES 2", "x.dat:4:1: `CYCLES 2`: a line KEY=value"),
        ];
        for (from, to, expected) in cases {
            let error = of(&SAMPLE.replacen(from, to, 1), POSITIONS).expect_err(expected);
            assert!(error.contains(expected), "{from} -> {to}: {error}");
        }
        let stated = Wanted { units: Some(Axis::Inches), ..POSITIONS };
        let error = of(SAMPLE, stated).expect_err("two units");
        assert!(error.contains("UNIT is `mm`, and the recipe says in"), "{error}");
        let empty = of("UNIT=mm\nTGT_DATA[0]=0\n", POSITIONS).expect_err("no readings");
        assert!(empty.contains("there is no reading"), "{empty}");
    }

    proptest! {
        /// Random tests in any unit and from both first indices, as positions and as deviations: the same readings.
        #[test]
        fn positions_and_deviations_give_the_same(
            targets in prop::collection::vec(-500.0..500.0f64, 2..6),
            runs in 1usize..4,
            base in 0usize..2,
            unit in prop::sample::select(vec![("mm", 1.0), ("in", 25.4), ("deg", 1f64.to_radians())]),
            seed in any::<u32>(),
        ) {
            let (name, scale) = unit;
            let deviation = |target: usize, run: usize, back: usize| -> f64 {
                (f64::from(seed % 1000) + 7.0 * target as f64 + 3.0 * run as f64 + 31.0 * back as f64).sin() * 1e-3
            };
            let head = format!("UNIT={name}\nCYCLES={runs}\nPOSITIONS={}\n", targets.len());
            let (mut positions, mut deviations) = (head.clone(), head);
            for (index, target) in targets.iter().enumerate() {
                let line = format!("TGT_DATA[{}]={target:.9}\n", index + base);
                positions.push_str(&line);
                deviations.push_str(&line);
                for run in 0..runs {
                    for (back, key) in READINGS.iter().enumerate() {
                        let value = deviation(index, run, back);
                        let place = format!("{key}[{},{}]", index + base, run + base);
                        positions.push_str(&format!("{place}={:.12}\n", target + value));
                        deviations.push_str(&format!("{place}={value:.15}\n"));
                    }
                }
            }
            let same = match name { "mm" => Deviation::Millimetres, "in" => Deviation::Inches, _ => Deviation::Degrees };
            let one = of(&positions, POSITIONS).expect("positions");
            let wanted = Wanted { deviations_in: Some(same), ..POSITIONS };
            let other = of(&deviations, wanted).expect("deviations");
            prop_assert_eq!(one.rows(), 2 * runs * targets.len());
            let (a, b) = (one.numbers("reading").expect("one"), other.numbers("reading").expect("other"));
            for row in one.row_indices() {
                // Targets have nine decimals here.
                prop_assert!((a[row] - b[row]).abs() < 1e-9 * scale + 1e-12);
            }
            let back = one.labels("direction").expect("directions");
            for row in one.row_indices() {
                let (run, place) = (row.0 / (2 * targets.len()), row.0 % (2 * targets.len()));
                let backward = place >= targets.len();
                let index = if backward { 2 * targets.len() - 1 - place } else { place };
                let expected = deviation(index, run, usize::from(backward)) * scale;
                prop_assert!((b[row] - expected).abs() < 1e-12);
                prop_assert_eq!(back[row].as_str(), if backward { "-1" } else { "1" });
            }
        }
    }
}
