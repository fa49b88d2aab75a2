//! What the order of rows says of `direction` and `position`, run by run: a run whose directions are turned, and positions without minus.

use std::collections::BTreeMap;

/// Fewest steps of a run in each direction that tell: by chance, five targets stand in their order once in 120 times.
const STEPS: usize = 4;

/// Probability below which rows in random order do not all go to smaller positions and then to larger ones.
const BY_CHANCE: f64 = 1e-5;

/// Positions that are no farther apart are one target: mm or degrees.
const SAME: f64 = 1e-3;

/// Rows of a test.
pub struct Rows<'a> {
    /// Label of the run of each row.
    pub runs: &'a [String],
    /// Whether each row is in the positive direction.
    pub ways: &'a [bool],
    /// Positions, mm or degrees.
    pub positions: &'a [f64],
}

impl Rows<'_> {
    /// Rows of one run and one direction that follow each other.
    fn passes(&self) -> Vec<(&str, bool, &[f64])> {
        let rows: Vec<usize> = (0..self.positions.len()).collect();
        let is_one =
            |one: &usize, next: &usize| self.runs[*one] == self.runs[*next] && self.ways[*one] == self.ways[*next];
        let pass = |rows: &[usize]| {
            let (first, last) = (*rows.first()?, *rows.last()?);
            Some((self.runs[first].as_str(), self.ways[first], &self.positions[first..=last]))
        };
        rows.chunk_by(is_one).filter_map(pass).collect()
    }

    /// Runs whose rows all go against `direction` where those of the other runs all go with it.
    ///
    /// Rows in random order go one way in both directions of two runs less than once in a thousand million times.
    fn turned_runs(&self) -> Vec<&str> {
        // Steps of each run against and with their direction, for each direction.
        let mut steps: BTreeMap<&str, [[usize; 2]; 2]> = BTreeMap::new();
        for (run, way, positions) in self.passes() {
            let counts = &mut steps.entry(run).or_default()[usize::from(way)];
            for pair in positions.windows(2).filter(|pair| (pair[1] - pair[0]).abs() > SAME) {
                counts[usize::from(way == (pair[1] > pair[0]))] += 1;
            }
        }
        let all = |counts: &[[usize; 2]; 2], with: usize| {
            counts.iter().all(|counts| counts[with] >= STEPS && counts[1 - with] == 0)
        };
        if !steps.values().all(|counts| all(counts, 0) || all(counts, 1)) {
            return Vec::new();
        }
        let against: Vec<&str> = steps.iter().filter(|(_, counts)| all(counts, 0)).map(|(run, _)| *run).collect();
        // Where all go against it, the sign of the whole file is told.
        if against.len() < steps.len() { against } else { Vec::new() }
    }

    /// Whether the rows of every pass go to smaller positions down to about zero and then to larger ones, in both directions: positions
    /// of both sides of zero without their minus.
    fn is_without_minus(&self) -> bool {
        let mut log_chance = 0.0;
        let mut directions = [false; 2];
        for (_, way, positions) in self.passes() {
            let Some(turn) = falls_then_rises(positions) else { return false };
            let least = positions.iter().fold(f64::INFINITY, |least, own| least.min(*own));
            let widest = positions.windows(2).fold(0.0_f64, |widest, pair| widest.max((pair[1] - pair[0]).abs()));
            let is_inside = turn > 0 && turn + 1 < positions.len();
            if !is_inside || least < 0.0 || least > widest {
                return false;
            }
            directions[usize::from(way)] = true;
            // Of all orders of n targets 2^(n - 1) fall and then rise.
            log_chance += (2..=positions.len()).map(|count| (2.0 / count as f64).ln()).sum::<f64>();
        }
        directions == [true; 2] && log_chance < BY_CHANCE.ln()
    }

    /// Sentences on both.
    pub fn faults(&self) -> Vec<String> {
        let turned = self.turned_runs();
        let told = (!turned.is_empty()).then(|| {
            let (which, theirs) = match &turned[..] {
                [run] => (format!("run {run}"), "its"),
                _ => (format!("runs {}", turned.join(", ")), "their"),
            };
            format!(
                "{which}: rows with `direction` 1 run to smaller positions, and those with -1 to larger ones, and those of the other runs do \
                 not: has `direction` the wrong sign in {theirs} rows?"
            )
        });
        let without = self.is_without_minus().then(|| {
            "in each direction of each run `position` falls to about zero and rises again: is the minus of positions missing?".to_owned()
        });
        told.into_iter().chain(without).collect()
    }
}

/// The place of the least position where all before fall and all after rise.
fn falls_then_rises(positions: &[f64]) -> Option<usize> {
    let turn = (0..positions.len()).min_by(|one, other| positions[*one].total_cmp(&positions[*other]))?;
    let falls = positions[..=turn].windows(2).all(|pair| pair[1] < pair[0]);
    let rises = positions[turn..].windows(2).all(|pair| pair[1] > pair[0]);
    (falls && rises).then_some(turn)
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    /// Runs of an axis: label, direction and position of each row, from the least target up and back, or in an order of some habit.
    fn test(random: &mut Generator, habit: usize) -> Vec<(String, bool, f64)> {
        let (targets, runs) = (2 + random.index(20), 1 + random.index(10));
        let start = 300.0 * random.uniform();
        let positions: Vec<f64> =
            (0..targets).map(|target| start + 30.0 * target as f64 + 5.0 * random.uniform()).collect();
        let mut rows = Vec::new();
        for run in 0..runs {
            let mut ways = vec![true, false];
            if habit == 1 {
                // Runs that begin at the far end.
                ways.reverse();
            }
            for way in ways {
                let mut order = positions.clone();
                match habit {
                    // Sorted by position in both directions.
                    2 => {}
                    // Targets in random order, of each pass or of all.
                    3 => (1..targets).rev().for_each(|last| order.swap(last, random.index(last + 1))),
                    _ if !way => order.reverse(),
                    _ => {}
                }
                // One direction alone.
                if habit == 4 && !way {
                    continue;
                }
                rows.extend(order.into_iter().map(|position| (format!("{}", run + 1), way, position)));
            }
        }
        // All first readings of targets one after the other, as a table of targets has them.
        if habit == 5 {
            rows.sort_by(|one, other| one.2.total_cmp(&other.2));
        }
        rows
    }

    fn told(rows: &[(String, bool, f64)]) -> Vec<String> {
        let runs: Vec<String> = rows.iter().map(|row| row.0.clone()).collect();
        let ways: Vec<bool> = rows.iter().map(|row| row.1).collect();
        let positions: Vec<f64> = rows.iter().map(|row| row.2).collect();
        Rows { runs: &runs, ways: &ways, positions: &positions }.faults()
    }

    #[test]
    fn good_rows_in_any_order_get_no_word() {
        for seed in 0..3000 {
            let mut random = Generator::new(seed, 1);
            let habit = random.index(6);
            let rows = test(&mut random, habit);
            assert!(told(&rows).is_empty(), "{seed}, habit {habit}: {:?}", told(&rows));
        }
    }

    #[test]
    fn runs_with_turned_directions_are_named() {
        let mut counts = [0; 2];
        for seed in 0..600 {
            let mut random = Generator::new(seed, 2);
            let habit = random.index(2);
            let mut rows = test(&mut random, habit);
            let runs: usize = rows.last().and_then(|row| row.0.parse().ok()).unwrap_or_default();
            if runs < 2 || rows.len() / runs < 2 * (STEPS + 1) {
                continue;
            }
            let run = format!("{}", 1 + random.index(runs));
            rows.iter_mut().filter(|row| row.0 == run).for_each(|row| row.1 = !row.1);
            counts[0] += 1;
            counts[1] += usize::from(told(&rows).iter().any(|words| words.starts_with(&format!("run {run}: "))));
        }
        assert!(counts[0] > 200 && counts[0] == counts[1], "{counts:?}");
    }

    #[test]
    fn positions_without_minus_are_told() {
        let mut counts = [0; 2];
        for seed in 0..600 {
            let mut random = Generator::new(seed, 3);
            let mut rows = test(&mut random, 0);
            let (first, last) = (rows[0].2, rows.iter().fold(0.0_f64, |most, row| most.max(row.2)));
            let targets = rows.iter().filter(|row| row.0 == "1" && row.1).count();
            // On both sides of zero, and enough rows.
            if first > -35.0 || last < 35.0 || targets < 8 || rows.len() < 50 {
                continue;
            }
            rows.iter_mut().for_each(|row| row.2 = row.2.abs());
            counts[0] += 1;
            counts[1] += usize::from(told(&rows).iter().any(|words| words.contains("minus")));
        }
        assert!(counts[0] > 100 && counts[0] == counts[1], "{counts:?}");
    }
}
