//! What the validators of this crate share.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::{PI, TAU};

use abbe_core::{
    DataRow, Dataset, Error, Figure, Findings, Fit, LabelText, Limit, PathItem, Quantity, Result, SettingsError,
    Validate,
};
use abbe_numerics::{Channel, Repeats, instrument_faults, repeats_are_copies};

use crate::reading_units::limits_in_another_unit;

/// Limits by key.
pub type Limits = BTreeMap<String, Limit>;

/// A figure that a limit is for: its key in settings, and its name.
pub type Key = (&'static str, &'static str);

/// The keys of figures.
pub fn names(keys: &[Key]) -> Vec<&'static str> {
    keys.iter().map(|(key, _)| *key).collect()
}

/// Refuses limits for anything but these keys, and those that are no numbers.
pub fn check_limits(limits: &Limits, keys: &[&str]) -> Result<(), SettingsError> {
    for (key, limit) in limits {
        let at = [PathItem::Key("limits".to_owned())];
        if !keys.contains(&key.as_str()) {
            let mut error = SettingsError::new(key, format!("there is no figure `{key}` to limit"));
            error.key = true;
            return Err(error.suggest(key, keys.iter().copied()).under(at));
        }
        if !limit.value.is_finite() {
            return Err(SettingsError::new(key, "a finite number was expected").under(at));
        }
    }
    Ok(())
}

/// A figure of a data set, which has no estimate.
pub fn figure(name: String, value: f64, unit: &str) -> Figure {
    Figure { of: None, ..Figure::new("", name, value, unit) }
}

/// The figures of one data set, with the limits that settings state for them.
pub struct Sheet<'a> {
    run: &'a str,
    limits: &'a Limits,
    met: BTreeSet<&'static str>,
    figures: Vec<Figure>,
    /// What keeps the test from deciding.
    lacking: Option<String>,
}

impl<'a> Sheet<'a> {
    /// For the data set of this name.
    pub fn new(run: &'a str, limits: &'a Limits) -> Self {
        Self { run, limits, met: BTreeSet::new(), figures: Vec::new(), lacking: None }
    }

    /// The same for a test that lacks something: it decides on no limit.
    pub fn lacking(mut self, lacking: Option<String>) -> Self {
        self.lacking = lacking;
        self
    }

    /// Adds a figure without a limit.
    pub fn tell(&mut self, name: &str, value: f64, unit: &str) -> &mut Figure {
        let place = self.figures.len();
        self.figures.push(figure(format!("{name}[{}]", self.run), value, unit));
        &mut self.figures[place]
    }

    /// Adds a figure in the unit of its key that is not negative, with its standard uncertainty and the limit of its key.
    pub fn limit(&mut self, name: &str, value: f64, uncertainty: Option<f64>, key: &'static str) {
        let limit = self.limits.get(key).copied();
        self.met.insert(key);
        self.tell(name, value, unit(key)).standard_uncertainty = uncertainty;
        if let Some(last) = self.figures.last_mut() {
            last.set_limit(limit);
            if limit.is_some() {
                last.inconclusive.clone_from(&self.lacking);
            }
        }
    }

    /// Adds a figure in the unit of its key that has a sign. A limit is one of its size, which is told then, too.
    pub fn limit_size(&mut self, name: &str, value: f64, uncertainty: Option<f64>, key: &'static str) {
        self.tell(name, value, unit(key)).standard_uncertainty = uncertainty;
        if self.limits.contains_key(key) {
            self.limit(&format!("|{name}|"), value.abs(), uncertainty, key);
        }
    }

    /// The figures. What a limit asks for and the data set does not give is there without a value, which fails.
    pub fn finish(mut self, keys: &[Key]) -> Vec<Figure> {
        for (key, name) in keys {
            if self.limits.contains_key(*key) && !self.met.contains(key) {
                self.limit(name, f64::NAN, None, key);
            }
        }
        self.figures
    }
}

/// The unit that a key names.
fn unit(key: &str) -> &str {
    key.rsplit_once('_').map_or("1", |(_, unit)| unit)
}

/// How a data set is called: the name of its file.
pub fn run_name(data: &Dataset) -> String {
    let stem = data.files.first().and_then(|file| file.file_stem());
    stem.map_or_else(|| "data".to_owned(), |stem| stem.to_string_lossy().into_owned())
}

/// The numbers of a column, all of which are finite.
pub fn finite<'a>(data: &'a Dataset, name: &str, quantity: Quantity) -> Result<&'a [f64]> {
    let numbers = abbe_table::numbers(data, name, quantity)?;
    match numbers.iter().position(|number| !number.is_finite()) {
        Some(row) => Err(data.error_at(DataRow(row), format!("`{name}` is no finite number here"))),
        None => Ok(numbers),
    }
}

/// Whether each row is in the positive direction, by the column `direction` with 1 and -1.
pub fn directions(data: &Dataset) -> Result<Vec<bool>> {
    let labels = abbe_table::labels(data, "direction")?;
    let of = |(row, label): (usize, &LabelText)| match label.trim().parse::<f64>() {
        Ok(1.0) => Ok(true),
        Ok(-1.0) => Ok(false),
        _ => {
            let message = format!("`direction` is {label}; 1 or -1 was expected");
            Err(data.error_at(DataRow(row), message).help("1 in the positive direction, -1 in the negative one"))
        }
    };
    labels.iter().enumerate().map(of).collect()
}

/// How many steps of an angle, rad, from row to row of one direction go against it, and how many there are: in the positive direction,
/// and in the negative one.
pub fn against(angles: &[f64], ways: &[bool]) -> [(usize, usize); 2] {
    let turn = |pair: &[f64]| (pair[1] - pair[0] + PI).rem_euclid(TAU) - PI;
    [true, false].map(|way| {
        let steps = angles.windows(2).zip(ways.windows(2)).filter(|(_, ways)| **ways == [way, way]);
        let is_against = |(pair, _): &(&[f64], &[bool])| turn(pair) != 0.0 && (turn(pair) > 0.0) != way;
        (steps.clone().filter(is_against).count(), steps.count())
    })
}

/// Part of the steps of a direction that go against it where its sign is wrong.
pub const MOST_STEPS: f64 = 0.9;

/// The error for a validator without data sets, or with an empty one.
pub fn no_data() -> Error {
    Error::usage("there are no readings to judge").help("name ingest stages under `from`").setting("from")
}

/// Readings in turn that may be those of others by chance.
const IN_TURN: usize = 6;

/// Fewest different readings among these.
const DISTINCT: usize = 5;

/// Part of the readings that has to be copied to be told: a coarse instrument reads the same now and then.
const COPIED: f64 = 0.2;

/// Fewest rows of a run that is another one, and the part of them that are the same: of a machine that repeats within a twentieth of its
/// digits, nine of ten are.
const RUN: usize = 100;
const WHOLE: f64 = 0.99;

/// Part of other readings within one digit of what they would repeat from which on digits are what repeats, and fewest of these.
const WITHIN_DIGIT: f64 = 0.8;
const OTHERS: usize = 10;

/// Digits in the range of readings up to which these repeat where a machine scatters by less than a digit.
const COARSE: f64 = 30.0;

/// Whether readings repeat because their digits are coarser than the machine scatters: then others, too, are within a digit of the
/// readings that lie to them as the repeated ones do. Of a copy they are not. Where nearly all repeat, few digits in their range tell.
fn digits_explain(columns: &[&[f64]], copied: &BTreeSet<usize>, ways: &BTreeSet<Repeats>) -> bool {
    let digits: Vec<(f64, f64)> = columns.iter().map(|column| digit_and_range(column)).collect();
    let within = |row: usize, other: usize| {
        let mut all = columns.iter().zip(&digits);
        all.all(|(column, (digit, _))| (column[row] - column[other]).abs() <= 1.5 * digit)
    };
    let rows = columns.first().map_or(0, |column| column.len());
    let (mut near, mut others) = (0_usize, 0_usize);
    for way in ways {
        for row in (0..rows).filter(|row| !copied.contains(row)) {
            if let Some(other) = way.earlier(row) {
                others += 1;
                near += usize::from(within(row, other));
            }
        }
    }
    match others >= OTHERS {
        true => near as f64 >= WITHIN_DIGIT * others as f64,
        false => digits.iter().all(|(digit, range)| *range <= COARSE * digit),
    }
}

/// The smallest difference of two readings that differ, and their range.
fn digit_and_range(readings: &[f64]) -> (f64, f64) {
    let mut sorted: Vec<f64> = readings.to_vec();
    sorted.sort_by(f64::total_cmp);
    let range = sorted.last().zip(sorted.first()).map_or(0.0, |(last, first)| last - first);
    // Numbers of a file in other units are rounded.
    let apart = sorted.windows(2).map(|pair| pair[1] - pair[0]).filter(|apart| *apart > 1e-9 * range);
    (apart.fold(range, f64::min), range)
}

/// A sentence on readings that are all the same.
pub fn unmeasured(columns: &[&[f64]]) -> Option<String> {
    let rows = columns.first().map_or(0, |column| column.len());
    let is_one = |column: &&[f64]| column.iter().all(|reading| reading.to_bits() == column[0].to_bits());
    (rows > 2 && columns.iter().all(is_one))
        .then(|| format!("all {rows} readings are the same: was anything measured?"))
}

/// A remark on readings that are no measurement of their own: stretches of them as others were, forwards or backwards.
pub fn doubted(run: &str, columns: &[&[f64]]) -> Option<String> {
    let rows = columns.first().map_or(0, |column| column.len());
    let row = |row: usize| columns.iter().map(|column| column[row].to_bits()).collect::<Vec<u64>>();
    let readings: Vec<Vec<u64>> = (0..rows).map(row).collect();
    let mut first: BTreeMap<Vec<&Vec<u64>>, usize> = BTreeMap::new();
    let mut copied: BTreeSet<usize> = BTreeSet::new();
    let mut ways: BTreeSet<Repeats> = BTreeSet::new();
    for start in 0..(rows + 1).saturating_sub(IN_TURN) {
        let stretch: Vec<&Vec<u64>> = readings[start..start + IN_TURN].iter().collect();
        // Coarse digits repeat in a slow motion.
        if stretch.iter().collect::<BTreeSet<_>>().len() < DISTINCT {
            continue;
        }
        let reversed: Vec<&Vec<u64>> = stretch.iter().rev().copied().collect();
        let earlier = |of: &Vec<&Vec<u64>>| first.get(of).copied().filter(|place| place + IN_TURN <= start);
        let found = earlier(&stretch).map(|place| Repeats::Forwards(start - place));
        if let Some(way) =
            found.or_else(|| earlier(&reversed).map(|place| Repeats::Backwards(start + place + IN_TURN - 1)))
        {
            copied.extend(start..start + IN_TURN);
            ways.insert(way);
        }
        first.entry(stretch).or_insert(start);
    }
    // Digits that repeat by chance elsewhere explain no long run that is another one, row for row.
    let is_run = |way: &Repeats| {
        let same = (0..rows).filter_map(|row| Some(readings[row] == readings[way.earlier(row)?]));
        let (all, same) = same.fold((0, 0), |(all, same), is_same| (all + 1, same + usize::from(is_same)));
        all >= RUN && same as f64 >= WHOLE * all as f64
    };
    let is_copied = ways.iter().any(is_run) || !digits_explain(columns, &copied, &ways);
    (copied.len() >= 10 && copied.len() as f64 >= COPIED * rows as f64 && is_copied).then(|| {
        format!(
            "{run}: {} of {rows} readings are those of others to the last digit, in the same or in the opposite order: are they copies? \
             Then repeatability and reversal are not those of the machine",
            copied.len()
        )
    })
}

/// Faults of the instrument that its readings tell, each a sentence: columns that were read in the same rows, by name, in a unit of which
/// `people` has the factor to that of people. `uncertainty` is the standard uncertainty of a reading; zero if it is not stated.
pub fn faults(columns: &[(&str, &[f64])], uncertainty: f64, people: (f64, &str)) -> Vec<String> {
    let readings: Vec<&[f64]> = columns.iter().map(|(_, readings)| *readings).collect();
    if let Some(unmeasured) = unmeasured(&readings) {
        return vec![unmeasured];
    }
    let channels: Vec<Channel<'_>> = columns.iter().map(|(name, readings)| Channel { name, readings }).collect();
    let found = instrument_faults(&channels, (uncertainty > 0.0).then_some(uncertainty));
    found.iter().map(|fault| fault.describe(&channels, people)).collect()
}

/// A sentence on repeats, group by group, that are copies of one reading.
pub fn copied_repeats(what: &str, groups: &[Vec<f64>]) -> Option<String> {
    let count = groups.iter().filter(|group| group.len() > 1).count();
    repeats_are_copies(groups).then(|| {
        format!(
            "the repeats of nearly all {count} {what} are the same to the last digit, and these differ: are they copies of one reading? \
             Then repeatability is not that of the machine"
        )
    })
}

/// Points of one label that are no points of another by chance.
const POINTS: usize = 5;

/// Sentences on points, by label, that those of an earlier label have to the last digit.
pub fn copied_points(what: &str, all: &[(&str, Vec<[f64; 3]>)]) -> Vec<String> {
    let copied = |(place, (label, points)): (usize, &(&str, Vec<[f64; 3]>))| {
        let same = |others: &Vec<[f64; 3]>| points.iter().filter(|point| others.contains(point)).count();
        let earlier = all[..place].iter().map(|(other, others)| (other, same(others)));
        let (other, count) = earlier.max_by_key(|(_, count)| *count).filter(|(_, count)| *count >= POINTS)?;
        Some(format!(
            "{count} points of {what} {label} are those of {what} {other} to the last digit: are they copies, or was it measured twice \
             with the same one?"
        ))
    };
    all.iter().enumerate().filter_map(copied).collect()
}

/// Whether a test has less than half of what its plan asks for: it decides on no limit that it would keep.
pub fn lacks_most(found: usize, planned: usize) -> bool {
    2 * found < planned
}

/// Takes the decision from figures that have a limit: readings that nobody should believe keep no limit. What exceeds it fails all the same.
pub fn undecided(figures: &mut [Figure], why: &[String]) {
    let Some(why) = why.first() else { return };
    for figure in figures.iter_mut().filter(|figure| figure.inconclusive.is_none() && figure.passes()) {
        if figure.limit.is_some() {
            figure.inconclusive = Some(why.clone());
        }
    }
}

/// A remark on readings that range over less than the standard uncertainty that is stated for one: both in one unit, `unit`.
pub fn too_quiet(run: &str, readings: &[f64], standard_uncertainty: f64, unit: &str) -> Option<String> {
    quieter_than(run, readings, (standard_uncertainty, "is the standard uncertainty of one"), unit)
}

/// A remark on readings that range over less than something that is stated of them, with the words that say what: both in one unit.
pub fn quieter_than(run: &str, readings: &[f64], (stated, what): (f64, &str), unit: &str) -> Option<String> {
    let (low, high) =
        readings.iter().fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(*value), high.max(*value)));
    (readings.len() > 2 && high - low < stated).then(|| {
        format!(
            "{run}: all readings are within {:.3} {unit}, and {stated} {unit} {what}: is the unit of the column right?",
            high - low
        )
    })
}

/// An acceptance test of readings, which needs no estimate.
pub trait Acceptance: Send + Sync {
    /// The findings on data sets; there is at least one.
    fn findings(&self, data: &[&Dataset]) -> Result<Findings>;
}

/// The validator of an acceptance test.
pub struct Judge<T>(pub T);

impl<T: Acceptance> Validate for Judge<T> {
    fn accepts_data(&self) -> bool {
        true
    }

    fn accepts_readings(&self) -> bool {
        true
    }

    fn validate(&self, _: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        if data.is_empty() {
            return Err(no_data());
        }
        let mut findings = self.0.findings(data)?;
        // Whoever reads that limits are not kept reads this first.
        findings.remarks.splice(0..0, limits_in_another_unit(&findings.figures));
        Ok(findings)
    }
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    /// Runs to and fro over eleven positions, in the order in which they were measured: a curve, lost motion, scatter, digits; µm.
    fn runs(random: &mut Generator, runs: usize, (scatter, digit): (f64, f64)) -> Vec<f64> {
        let mut number = |size: f64| size * random.uniform() / 3.0_f64.sqrt();
        let curve: Vec<f64> = (0..11).map(|place| number(4.0) + 0.8 * f64::from(place)).collect();
        let lost = number(2.0);
        let mut all = Vec::new();
        for _ in 0..runs {
            all.extend(curve.iter().map(|value| value + number(2.0 * scatter)));
            all.extend(curve.iter().rev().map(|value| value + lost + number(2.0 * scatter)));
        }
        all.into_iter().map(|value: f64| (value / digit).round() * digit).collect()
    }

    #[test]
    fn coarse_digits_are_no_copies() {
        for seed in 0..600 {
            let scatter = [0.05, 0.1, 0.2, 0.3, 0.5][seed as usize % 5];
            let digit = [1.0, 0.5, 2.0][seed as usize / 5 % 3];
            let readings = runs(&mut Generator::new(seed, 71), 5, (scatter, digit));
            assert_eq!(doubted("X", &[&readings]), None, "{seed}: {scatter} {digit}");
        }
    }

    #[test]
    fn a_run_that_is_another_one_is_told() {
        let mut told = 0;
        for seed in 0..300 {
            let mut random = Generator::new(seed, 72);
            let mut readings = runs(&mut random, 5, (0.5, 0.1));
            let (from, to) = [(0, 44), (22, 88), (44, 66)][seed as usize % 3];
            readings.copy_within(from..from + 22, to);
            told += usize::from(doubted("X", &[&readings]).is_some());
        }
        assert!(told >= 297, "{told} of 300");
    }
}
