//! Readings of an axis by target: the columns `position`, `direction`, `reading` and `run` of a data set.

use std::collections::BTreeMap;

use abbe_core::{DataRow, Dataset, Error, Quantity, Result};
use abbe_numerics::resolution;
use abbe_standards::positioning::Target;
use abbe_standards::positioning::plan::Axis;

use crate::both_directions::{mirrored, smaller_direction};
use crate::common::{copied_repeats, directions, faults, finite, no_data, run_name};
use crate::copied_run::copied_run;
use crate::displaced::{InOrder, OfRun, run_off};
use crate::row_directions::Rows;
use crate::sign_change::sign_change;

/// Positions that are no farther apart are one target: mm or degrees.
const SAME: f64 = 1e-3;

/// The readings of one axis.
pub struct Readings {
    /// What was read, by the name of its file.
    pub name: String,
    /// Linear or rotary.
    pub axis: Axis,
    /// Unit of the readings: `um` or `urad`.
    pub unit: &'static str,
    /// Targets in the order of their positions, mm or degrees; readings in µm or µrad.
    pub targets: Vec<Target>,
    /// All readings in the order of the rows.
    pub in_order: Vec<f64>,
    /// The readings of each run, where runs have labels.
    runs: Vec<(String, OfRun)>,
    /// Whether the rows of both directions run against them, and whether all run with them.
    is_turned: bool,
    runs_both_ways: bool,
    /// What the order of rows says of single runs, and of positions.
    of_order: Vec<String>,
    /// Whether each row is in the positive direction, and its target.
    ways: Vec<bool>,
    places: Vec<usize>,
}

/// Fewest readings of a run that is compared with the others.
const COMPARED: usize = 5;

/// How many times farther from the others than they are from each other a run has to be, and than it is with its signs turned.
const TURNED: f64 = 4.0;

/// Distances below this are rounding, µm or µrad.
const ROUNDING: f64 = 1e-3;

impl Readings {
    /// Reads a data set.
    pub fn of(data: &Dataset) -> Result<Self> {
        let quantity = |name: &str| data.column(name).map(|column| column.header.quantity);
        let (axis, scale) = match quantity("position") {
            Some(Quantity::Length) => (Axis::Linear, 1.0),
            Some(Quantity::Angle) => (Axis::Rotary, 180.0 / std::f64::consts::PI),
            Some(_) => return Err(wrong(data, "`position` is neither a length nor an angle")),
            None => return Err(data.required_numbers("position").err().unwrap_or_else(no_data)),
        };
        let (unit, factor) = match (axis, quantity("reading")) {
            (Axis::Linear, Some(Quantity::Length)) => ("um", 1e3),
            (Axis::Rotary, Some(Quantity::Angle)) => ("urad", 1e6),
            (_, None) => return Err(data.required_numbers("reading").err().unwrap_or_else(no_data)),
            _ => {
                return Err(wrong(
                    data,
                    "along a length lengths are read, around an axis angles: `reading` is neither",
                ));
            }
        };
        let along = if axis == Axis::Linear { Quantity::Length } else { Quantity::Angle };
        let [positions, readings] = [finite(data, "position", along)?, finite(data, "reading", along)?];
        let places = places(&positions.iter().map(|position| position * scale).collect::<Vec<_>>());
        let ways = directions(data)?;
        let runs = data.labels("run");
        let count = places.values().max().map_or(0, |last| last + 1);
        let mut targets = vec![Target::default(); count];
        let mut of_runs: Vec<(String, OfRun)> = Vec::new();
        let mut seen: BTreeMap<(&str, bool, usize), DataRow> = BTreeMap::new();
        for row in data.row_indices() {
            let place = places[&(positions[row] * scale).to_bits()];
            let up = ways[row.0];
            if let Some(runs) = runs
                && let Some(first) = seen.insert((runs[row].as_str(), up, place), row)
            {
                let line = data.origins[first].line;
                let message = format!("run {} has this target in this direction already, in line {line}", runs[row]);
                return Err(data.error_at(row, message).help("each run reads a target once in a direction"));
            }
            if let Some(run) = runs.map(|runs| &runs[row]) {
                let known = of_runs.iter().position(|(name, _)| name == run).unwrap_or_else(|| {
                    of_runs.push((run.to_string(), BTreeMap::new()));
                    of_runs.len() - 1
                });
                of_runs[known].1.insert((place, up), readings[row] * factor);
            }
            let target = &mut targets[place];
            target.position = positions[row] * scale;
            if up { &mut target.up } else { &mut target.down }.push(readings[row] * factor);
        }
        if targets.len() < 2 {
            return Err(wrong(data, "there are fewer than two targets"));
        }
        let in_order = readings.iter().map(|reading| reading * factor).collect();
        let of_one_run = |row: usize| runs.is_none_or(|runs| runs[DataRow(row)] == runs[DataRow(row - 1)]);
        let steps = (1..positions.len())
            .filter(|row| ways[*row] == ways[row - 1] && of_one_run(*row))
            .map(|row| (ways[row], (positions[row] - positions[row - 1]) * scale));
        let is_turned = run_against_directions(steps.clone());
        let runs_both_ways = run_against_directions(steps.map(|(way, step)| (way, -step)));
        let along: Vec<f64> = positions.iter().map(|position| position * scale).collect();
        let of_order = runs.map_or_else(Vec::new, |runs| {
            let labels: Vec<String> = data.row_indices().map(|row| runs[row].to_string()).collect();
            Rows { runs: &labels, ways: &ways, positions: &along }.faults()
        });
        let places = positions.iter().map(|position| places[&(position * scale).to_bits()]).collect();
        Ok(Self {
            name: run_name(data),
            axis,
            unit,
            targets,
            in_order,
            runs: of_runs,
            is_turned,
            runs_both_ways,
            of_order,
            ways,
            places,
        })
    }

    /// Faults of the instrument, signs and units that are wrong in a part of the rows, and repeats that are copies where these were not
    /// told already.
    pub fn faults(&self, is_told: bool) -> Vec<String> {
        let found = faults(&[("reading", &self.in_order)], 0.0, (1.0, self.unit));
        let groups: Vec<Vec<f64>> =
            self.targets.iter().flat_map(|target| [target.up.clone(), target.down.clone()]).collect();
        let copied = copied_repeats("targets", &groups).or_else(|| self.copied_run());
        let copied = copied.filter(|_| !is_told && found.is_empty());
        let turned = self.is_turned.then(|| {
            "rows with `direction` 1 run to smaller positions, and those with -1 to larger ones: has `position` the wrong sign, or \
             `direction`?"
                .to_owned()
        });
        let smaller = smaller_direction(&[&self.in_order], &self.ways, &self.places, self.unit);
        let signs =
            self.turned_run().or_else(|| self.turned_from_a_row()).or_else(|| mirrored(&self.means(), self.unit));
        let displaced =
            if signs.is_some() { None } else { self.displaced_run() }.into_iter().chain(self.displaced_rows());
        let of_order = self.of_order.iter().cloned();
        found
            .into_iter()
            .chain(copied)
            .chain(turned)
            .chain(of_order)
            .chain(smaller)
            .chain(signs)
            .chain(displaced)
            .collect()
    }

    /// Mean readings up and down of the targets that have both.
    fn means(&self) -> Vec<[f64; 2]> {
        let mean = |readings: &Vec<f64>| readings.iter().sum::<f64>() / readings.len() as f64;
        let both = self.targets.iter().filter(|target| !target.up.is_empty() && !target.down.is_empty());
        both.map(|target| [mean(&target.up), mean(&target.down)]).collect()
    }

    /// A run that is like the others with all its signs turned, in words.
    fn turned_run(&self) -> Option<String> {
        // Root mean square of what readings, times a sign, are apart from the mean of other runs; none where they cannot be compared.
        let apart = |run: usize, without: usize, sign: f64| {
            let others = |key: &(usize, bool)| -> Vec<f64> {
                let others = self.runs.iter().enumerate().filter(|(other, _)| *other != run && *other != without);
                others.filter_map(|(_, (_, readings))| readings.get(key).copied()).collect()
            };
            let squares = self.runs[run].1.iter().filter_map(|(key, reading)| {
                let others = others(key);
                let mean = others.iter().sum::<f64>() / others.len() as f64;
                (!others.is_empty()).then(|| (sign * reading - mean).powi(2))
            });
            let squares: Vec<f64> = squares.collect();
            (squares.len() >= COMPARED).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
        };
        let all = 0..self.runs.len();
        let found = all.clone().filter(|_| self.runs.len() > 2).find_map(|run| {
            let (as_read, turned) = (apart(run, run, 1.0)?, apart(run, run, -1.0)?);
            let others = all.clone().filter(|other| *other != run).map(|other| apart(other, run, 1.0));
            let usual = others.collect::<Option<Vec<f64>>>()?.into_iter().fold(0.0, f64::max);
            (as_read > TURNED * turned.max(usual).max(ROUNDING)).then_some((run, as_read, turned))
        });
        found.map(|(run, as_read, turned)| {
            let unit = self.unit;
            format!(
                "run {} is {as_read:.2} {unit} from the others, and {turned:.2} {unit} with its signs turned: is the sign of this run wrong?",
                self.runs[run].0
            )
        })
    }

    /// The step of the digits of readings; zero if they have none.
    fn digit(&self) -> f64 {
        resolution(&self.in_order).unwrap_or(0.0)
    }

    /// A run that is there once more under another number, in words.
    fn copied_run(&self) -> Option<String> {
        let runs: Vec<&OfRun> = self.runs.iter().map(|(_, readings)| readings).collect();
        let [one, other] = copied_run(&runs, self.digit())?.map(|run| &self.runs[run].0);
        Some(format!(
            "all readings of run {other} are those of run {one} to the last digit, and no two other runs are near that: is it a copy? Then \
             repeatability is not that of the machine"
        ))
    }

    /// A run that is off as a whole, in words.
    fn displaced_run(&self) -> Option<String> {
        let runs: Vec<&OfRun> = self.runs.iter().map(|(_, readings)| readings).collect();
        let (off, unit) = (run_off(&runs, self.digit())?, self.unit);
        let way = match off.way {
            None => "",
            Some(true) => " in the rows with `direction` 1",
            Some(false) => " in the rows with `direction` -1",
        };
        Some(format!(
            "run {} is {:.2} {unit} off at all targets{way}, and the others are within {:.2} {unit} of each other: was the zero of \
             the instrument lost before or after it?",
            self.runs[off.run].0, off.by, off.usual
        ))
    }

    /// Readings that stand a row beside their positions, in words, where rows run forwards and backwards.
    fn displaced_rows(&self) -> Option<String> {
        if !self.runs_both_ways {
            return None;
        }
        let in_order = InOrder { readings: &self.in_order, places: &self.places, ways: &self.ways };
        let (by, as_they_are, with) = in_order.rows_off(self.digit())?;
        let (unit, which) = (self.unit, if by > 0 { "before" } else { "behind" });
        Some(format!(
            "what looks like lost motion differs by {as_they_are:.2} {unit} along the travel, and by {with:.2} {unit} if each reading belongs \
             to the row {which} it: do readings stand a row beside their positions?"
        ))
    }

    /// Readings that repeat those before them with the sign turned, from one row on, in words.
    fn turned_from_a_row(&self) -> Option<String> {
        let groups: Vec<usize> =
            self.places.iter().zip(&self.ways).map(|(place, up)| 2 * place + usize::from(*up)).collect();
        let found = sign_change(&self.in_order, &groups, ROUNDING)?;
        let (unit, row) = (self.unit, found.row + 1);
        Some(format!(
            "readings repeat within {:.2} {unit}, and within {:.2} {unit} with the signs of row {row} and those after it turned (or of \
             those before it): is the sign of a part of the rows wrong?",
            found.as_read, found.turned
        ))
    }

    /// Distance of the first and the last target, mm or degrees.
    pub fn travel(&self) -> f64 {
        self.targets[self.targets.len() - 1].position - self.targets[0].position
    }

    /// The smallest number of runs at a target in a direction that was measured.
    pub fn runs(&self) -> usize {
        let counts = |count: fn(&Target) -> usize| self.targets.iter().map(count).collect::<Vec<_>>();
        let (up, down) = (counts(|target| target.up.len()), counts(|target| target.down.len()));
        let least = |counts: Vec<usize>| counts.iter().any(|count| *count > 0).then(|| counts.into_iter().min());
        [least(up), least(down)].into_iter().flatten().flatten().min().unwrap_or(0)
    }
}

/// Whether rows of the positive direction run to smaller positions, and rows of the negative direction to larger ones, all of them:
/// steps from a row to the next with their directions.
///
/// Rows that are sorted by their positions run one way in both directions, and tell nothing.
fn run_against_directions(steps: impl Iterator<Item = (bool, f64)>) -> bool {
    let mut against = [false; 2];
    for (way, step) in steps.filter(|(_, step)| step.abs() > SAME) {
        if way == (step > 0.0) {
            return false;
        }
        against[usize::from(way)] = true;
    }
    against == [true; 2]
}

/// The place of every position among the targets.
fn places(positions: &[f64]) -> BTreeMap<u64, usize> {
    let mut sorted = positions.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (mut place, mut last) = (0, sorted.first().copied().unwrap_or_default());
    let mut places = BTreeMap::new();
    for position in sorted {
        place += usize::from(position - last > SAME);
        last = position;
        places.insert(position.to_bits(), place);
    }
    places
}

fn wrong(data: &Dataset, message: &str) -> Error {
    let error = Error::data(message);
    data.files.first().map_or(error.clone(), |file| error.in_file(file))
}
