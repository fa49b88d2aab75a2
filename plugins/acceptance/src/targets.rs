//! Readings of an axis by target: the columns `position`, `direction`, `reading` and `run` of a data set.

use std::collections::BTreeMap;

use abbe_core::{DataRow, Dataset, Error, Quantity, Result};
use abbe_standards::positioning::Target;
use abbe_standards::positioning::plan::Axis;

use crate::common::{copied_repeats, directions, faults, finite, no_data, run_name};

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
}

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
            let target = &mut targets[place];
            target.position = positions[row] * scale;
            if up { &mut target.up } else { &mut target.down }.push(readings[row] * factor);
        }
        if targets.len() < 2 {
            return Err(wrong(data, "there are fewer than two targets"));
        }
        let in_order = readings.iter().map(|reading| reading * factor).collect();
        Ok(Self { name: run_name(data), axis, unit, targets, in_order })
    }

    /// Faults of the instrument, and repeats that are copies where these were not told already.
    pub fn faults(&self, is_told: bool) -> Vec<String> {
        let found = faults(&[("reading", &self.in_order)], 0.0, (1.0, self.unit));
        let groups: Vec<Vec<f64>> =
            self.targets.iter().flat_map(|target| [target.up.clone(), target.down.clone()]).collect();
        let copied = copied_repeats("targets", &groups).filter(|_| !is_told && found.is_empty());
        found.into_iter().chain(copied).collect()
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
