//! Angles in degrees and minutes that are read as decimal degrees: 12.34 for 12 deg 34 min. None of their fractions is above 0.60.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{Column, DataRow, ObservationSet, Problem, Quantity, StatusRole};

use crate::channels::by_file;

/// Fewest hundredths of a degree that tell: that as many random ones of a hundred are all below 60 has a probability of 8e-6.
const SEVERAL: usize = 20;

/// Minutes of a degree.
const MINUTES: u32 = 60;

/// Fewest rows whose hundredths are further from those of the row before than [`JUMP`]: a sweep with a step of nearly whole degrees has
/// a fraction that creeps, and may end before it is above 0.60.
const JUMPS: usize = 8;
const JUMP: u32 = 5;

/// Sentences on positions of rotary axes in a file that are all possible as degrees and minutes, and by chance not.
pub(crate) fn minutes(problem: &Problem) -> Vec<String> {
    problem.sets.iter().flat_map(|set| of_set(problem, set)).collect()
}

fn of_set(problem: &Problem, set: &ObservationSet) -> Vec<String> {
    let (info, data) = (problem.model.info(), &set.info().layout.data);
    let is_command = |column: &&Column| {
        let is_axis = |role: &StatusRole| match role {
            StatusRole::Command(axis) => info.axes[*axis].name == column.header.name,
            _ => false,
        };
        let is_in_degrees = column.header.quantity == Quantity::Angle && column.header.header.ends_with("_deg");
        is_in_degrees && info.status.iter().any(|status| is_axis(&status.role))
    };
    let mut files: BTreeMap<usize, Vec<DataRow>> = by_file(set);
    files.values_mut().for_each(|rows| rows.sort_unstable());
    let mut told = Vec::new();
    for column in data.columns.iter().filter(is_command) {
        let Some(angles) = data.numbers(&column.header.name) else { continue };
        for (file, rows) in &files {
            let degrees: Vec<f64> = rows.iter().map(|row| angles[*row].to_degrees()).collect();
            if let Some(count) = are_minutes(&degrees) {
                let file = data.files.get(*file).map_or(String::new(), |file| format!(", `{}`", file.display()));
                told.push(format!(
                    "{}{file}: the positions of {} have {count} different hundredths of a degree, and none is above 0.60: are these degrees \
                     and minutes? They were read as decimal degrees",
                    set.name, column.header.name
                ));
            }
        }
    }
    told
}

/// How many different hundredths angles have if all are below 60, and chance or a plan does not make it so.
fn are_minutes(degrees: &[f64]) -> Option<usize> {
    let hundredths = |angle: &f64| {
        // Digits of files: what they are in radians is no matter.
        let fraction = (angle.abs() * 1e7).round() / 1e7;
        ((fraction - fraction.floor()) * 100.0 + 1e-4).floor() as u32
    };
    let all: Vec<u32> = degrees.iter().filter(|angle| angle.is_finite()).map(hundredths).collect();
    let jumps = all.windows(2).filter(|pair| {
        let apart = pair[0].abs_diff(pair[1]);
        apart.min(100 - apart) > JUMP
    });
    let different: BTreeSet<u32> = all.iter().copied().collect();
    let is_told = different.len() >= SEVERAL && all.iter().all(|own| *own < MINUTES) && jumps.count() >= JUMPS;
    is_told.then_some(different.len())
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    /// Positions as machines and people make them: sweeps of any step, recorded or planned, and random ones of few or many digits.
    fn positions(random: &mut Generator, habit: u64) -> Vec<f64> {
        let mut number = |from: f64, to: f64| from + (to - from) * 0.5 * (1.0 + random.uniform() / 3.0_f64.sqrt());
        let count = number(10.0, 600.0) as usize;
        let digits = [1.0, 2.0, 4.0, 10.0, 20.0, 100.0, 1000.0, 10_000.0][(habit / 4 % 8) as usize];
        let rounded = |angle: f64| (angle * digits).round() / digits;
        let (start, step) = (rounded(number(-180.0, 0.0)), number(0.01, 12.0));
        match habit % 4 {
            // A plan of equal steps.
            0 => (0..count).map(|row| start + rounded(step) * row as f64).collect(),
            // A recorded sweep at a feed.
            1 => (0..count).map(|row| rounded(start + step * row as f64 + number(-0.01, 0.01))).collect(),
            // Anywhere.
            2 => (0..count).map(|_| rounded(number(-120.0, 120.0))).collect(),
            // Indexations where the encoder reads a little beside.
            _ => (0..count).map(|row| start.round() + 15.0 * (row % 12) as f64 + number(-0.02, 0.02)).collect(),
        }
    }

    fn read_as_decimal(angle: f64) -> f64 {
        let minutes = angle.abs().fract() * 60.0;
        let seconds = (minutes.fract() * 60.0).floor();
        angle.signum() * (angle.abs().floor() + minutes.floor() / 100.0 + seconds / 10_000.0)
    }

    #[test]
    fn decimal_degrees_get_no_word() {
        for seed in 0..8000 {
            let found = are_minutes(&positions(&mut Generator::new(seed, 61), seed));
            assert_eq!(found, None, "{seed}");
        }
    }

    #[test]
    fn degrees_and_minutes_are_told() {
        let (mut told, mut all) = (0, 0);
        for seed in 0..2000 {
            let mut random = Generator::new(seed, 62);
            // Recorded sweeps, and random positions with digits.
            let angles = positions(&mut random, [1, 2][seed as usize % 2] + 4 * (5 + seed / 2 % 3));
            let minutes: Vec<f64> = angles.into_iter().map(read_as_decimal).collect();
            all += 1;
            told += usize::from(are_minutes(&minutes).is_some());
        }
        assert!(told * 10 > all * 9, "{told} of {all}");
    }
}
