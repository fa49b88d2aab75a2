//! What the order of rows says of signs: axes that move against their columns of direction, and circles that run against their angles.
//! Both fit as well as the truth: backlash, or a squareness, takes them up.

use std::f64::consts::{PI, TAU};

use abbe_core::{Axis, AxisKind, Contact, DataRow, ObservationSet, Problem, Quantity, StatusRole};

/// Fewest steps that tell, in each direction.
const STEPS: usize = 5;

/// The part of them that has to contradict.
const MOST: f64 = 0.9;

/// Steps below this are none, mm or rad.
const STILL: f64 = 1e-9;

/// Ways of a rotary axis from this on, rad, may have gone round the other side, or all the way within its travel.
const CLEAR: f64 = 0.95 * PI;

/// Of two columns that may be exchanged: fewest steps in each direction, and fewest against their own column; the part that these are at
/// least, the part of that in which they may go against the other column, and the part of all steps that have to agree with this one.
const FEWEST: usize = 3;
const OFTEN: f64 = 0.1;
const LESS: f64 = 0.3;
const AGREES: f64 = 0.95;

/// Sentences on signs and columns that the order of rows contradicts. Of touches the linear axes are left out: each has an approach of its
/// own, in whatever order they were made. Rotary axes come from where they were.
pub fn contradicted_by_order(problem: &Problem) -> Vec<String> {
    let mut sentences = Vec::new();
    for set in &problem.sets {
        let (is_touched, runs) = (set.info().contact == Contact::LinearAxes, runs(set));
        let directed = directed(problem, is_touched);
        let of_order = exchanged_directions(&directed, &runs, is_touched)
            .or_else(|| against_directions(&directed, &runs, is_touched))
            .or_else(|| against_in_a_file(set, &directed, &runs, is_touched));
        sentences.extend(of_order.map(|words| format!("{}: {words}", set.name)));
        if !is_touched {
            sentences.extend(against_angles(problem, set, &runs).map(|words| format!("{}: {words}", set.name)));
        }
    }
    sentences
}

/// A row and the status of its first pose.
type Passed<'a> = (DataRow, &'a [f64]);

/// The rows of a set, as they follow each other in a file, by label of the run where there is one.
fn runs(set: &ObservationSet) -> Vec<Vec<Passed<'_>>> {
    let layout = &set.info().layout;
    let passed = set.rows.iter().filter_map(|&row| {
        let row = &layout.rows[row];
        Some((row.data_row?, set.poses().row(row.first_pose)))
    });
    let mut passed: Vec<Passed<'_>> = passed.collect();
    passed.sort_by_key(|(row, _)| *row);
    let labels = layout.data.labels("run");
    let run = |row: DataRow| (layout.data.origins[row].file, labels.map(|labels| labels[row].as_str()));
    passed.chunk_by(|(one, _), (next, _)| run(*one) == run(*next)).map(<[_]>::to_vec).collect()
}

/// The way of an axis from one position to the next: the short one of a rotary axis.
fn way(axis: &Axis, from: &[f64], to: &[f64]) -> f64 {
    let way = to[axis.status] - from[axis.status];
    if axis.kind == AxisKind::Rotary { (way + PI).rem_euclid(TAU) - PI } else { way }
}

/// Axes whose direction of approach has a column in the status, with the index of this column.
fn directed(problem: &Problem, is_touched: bool) -> Vec<(&Axis, usize)> {
    let info = problem.model.info();
    let axes = info.axes.iter().enumerate().filter(|(_, axis)| !is_touched || axis.kind == AxisKind::Rotary);
    axes.filter_map(|(index, axis)| Some((axis, info.status_index(&StatusRole::Direction(index))?))).collect()
}

/// Steps of an axis and those that go against a column of directions, for negative and for positive ones.
#[derive(Debug, Clone, Copy, Default)]
struct Steps {
    all: [usize; 2],
    against: [usize; 2],
}

impl Steps {
    /// The steps of an axis beside a column of directions. Where readings follow each other, those alone before which the direction was
    /// the same: a run that turns round may begin with the place where the last one ended.
    fn count(axis: &Axis, column: usize, runs: &[Vec<Passed<'_>>], is_touched: bool) -> Self {
        let mut steps = Self::default();
        for pair in runs.iter().flat_map(|run| run.windows(2)) {
            let [(_, from), (_, to)] = pair else { continue };
            let (way, direction) = (way(axis, from, to), to[column]);
            let is_told = is_touched || from[column] == direction;
            // Half a turn and more may go either way.
            let is_clear = axis.kind != AxisKind::Rotary || (to[axis.status] - from[axis.status]).abs() < CLEAR;
            if way.abs() > STILL && is_clear && direction != 0.0 && is_told {
                let place = usize::from(direction > 0.0);
                steps.all[place] += 1;
                steps.against[place] += usize::from(way * direction < 0.0);
            }
        }
        steps
    }

    fn sum(self) -> (usize, usize) {
        (self.against.iter().sum(), self.all.iter().sum())
    }

    /// Part of the steps that go against the directions.
    fn part(self) -> f64 {
        let (against, all) = self.sum();
        against as f64 / all.max(1) as f64
    }

    /// Whether nearly all steps, forwards and backwards, go against the directions.
    fn contradict(self) -> bool {
        let contradicts = |(all, against): (&usize, &usize)| *all >= STEPS && *against as f64 > MOST * *all as f64;
        self.all.iter().zip(&self.against).all(contradicts)
    }
}

/// Axes that move against their columns of direction, forwards and backwards. Where every target is approached from one side the order of
/// targets says nothing.
fn against_directions(directed: &[(&Axis, usize)], runs: &[Vec<Passed<'_>>], is_touched: bool) -> Option<String> {
    let steps = directed.iter().map(|(axis, column)| (axis, Steps::count(axis, *column, runs, is_touched)));
    let named = steps.filter(|(_, steps)| steps.contradict()).map(|(axis, steps)| {
        let (against, all) = steps.sum();
        format!("`dir_{}` ({against} of {all} steps)", axis.name)
    });
    let names = named.collect::<Vec<_>>().join(", ");
    (!names.is_empty()).then(|| {
        format!("from row to row the axes move against {names}: are the signs turned? Backlash then gets a wrong value")
    })
}

/// The same of the rows of one of several files.
fn against_in_a_file(
    set: &ObservationSet,
    directed: &[(&Axis, usize)],
    runs: &[Vec<Passed<'_>>],
    is_touched: bool,
) -> Option<String> {
    let data = &set.info().layout.data;
    let file_of = |run: &Vec<Passed<'_>>| run.first().map(|(row, _)| data.origins[*row].file);
    runs.chunk_by(|one, next| file_of(one) == file_of(next)).find_map(|runs| {
        let words = against_directions(directed, runs, is_touched)?;
        let file = data.files.get(file_of(runs.first()?)?)?;
        Some(format!("in `{}` {words}", file.display()))
    })
}

/// Two axes each of which moves as the column of the other one says, forwards and backwards, and not as its own one does.
fn exchanged_directions(directed: &[(&Axis, usize)], runs: &[Vec<Passed<'_>>], is_touched: bool) -> Option<String> {
    let count = |axis: &Axis, column: usize| Steps::count(axis, column, runs, is_touched);
    for (place, (one, of_one)) in directed.iter().enumerate() {
        for (other, of_other) in &directed[place + 1..] {
            let own = [count(one, *of_one), count(other, *of_other)];
            let crossed = [count(one, *of_other), count(other, *of_one)];
            let is_exchanged = own.iter().zip(crossed).all(|(own, crossed)| {
                let tells = crossed.all.iter().all(|steps| *steps >= FEWEST) && crossed.sum().1 >= 2 * STEPS;
                let is_own = own.sum().0 < FEWEST || own.part() < OFTEN;
                tells && !is_own && crossed.part() < own.part() * LESS && crossed.part() < 1.0 - AGREES
            });
            if is_exchanged {
                let [(one_against, one_all), (other_against, other_all)] = own.map(Steps::sum);
                let (one, other) = (&one.name, &other.name);
                return Some(format!(
                    "from row to row {one} moves as `dir_{other}` says and {other} as `dir_{one}` does, and against their own columns in \
                     {one_against} of {one_all} and {other_against} of {other_all} steps: are the two columns exchanged? Backlash then gets \
                     a wrong value"
                ));
            }
        }
    }
    None
}

/// A circle whose positions run the other way round than its column `angle`, which turns from X to Y, Y to Z, or Z to X.
fn against_angles(problem: &Problem, set: &ObservationSet, runs: &[Vec<Passed<'_>>]) -> Option<String> {
    let info = problem.model.info();
    let data = &set.info().layout.data;
    let column = data.column("angle").filter(|column| column.header.quantity == Quantity::Angle)?;
    let angles = data.numbers(&column.header.name)?;
    let moves =
        |axis: &Axis| runs.iter().any(|run| run.windows(2).any(|pair| way(axis, pair[0].1, pair[1].1).abs() > STILL));
    let letter = |letter: &str| info.axes.iter().find(|axis| axis.name == letter).filter(|axis| moves(axis));
    let [one, other] = match [letter("X"), letter("Y"), letter("Z")] {
        [Some(x), Some(y), None] => [x, y],
        [None, Some(y), Some(z)] => [y, z],
        [Some(x), None, Some(z)] => [z, x],
        _ => return None,
    };
    let (mut turns, mut against) = (0, 0);
    for three in runs.iter().flat_map(|run| run.windows(3)) {
        let [(first, from), (_, at), (last, to)] = three else { continue };
        let turned = (angles[*last] - angles[*first] + PI).rem_euclid(TAU) - PI;
        let bend = way(one, from, at) * way(other, at, to) - way(other, from, at) * way(one, at, to);
        if turned.abs() > STILL && bend.abs() > STILL {
            turns += 1;
            against += usize::from(turned * bend < 0.0);
        }
    }
    (turns >= 2 * STEPS && against as f64 > MOST * turns as f64).then(|| {
        format!(
            "the positions of {} and {} run round against the column `angle` ({against} of {turns} rows): is the sign of an axis turned, \
             or are columns exchanged?",
            one.name, other.name
        )
    })
}

#[cfg(test)]
mod tests {
    use abbe_core::Branch;
    use abbe_numerics::Generator;

    use super::*;

    fn axis(name: &str, kind: AxisKind, status: usize) -> Axis {
        Axis {
            name: name.to_owned(),
            kind,
            branch: Branch::Tool,
            sense: 1.0,
            direction: [1.0, 0.0, 0.0],
            range: None,
            indexed: false,
            endless: false,
            status,
        }
    }

    /// Positions of two axes and the directions from which they came, in the order in which a good programme goes there.
    fn programme(random: &mut Generator, kind: usize) -> Vec<[f64; 4]> {
        let count = 6 + random.index(60);
        let size = 0.5 + random.uniform().abs();
        let fixed = [1.0, -1.0].map(|sign| if random.index(2) == 0 { sign } else { -sign });
        let (mut at, mut from) = ([0.0; 2], fixed);
        let mut rows = Vec::new();
        for row in 0..count {
            let part = row as f64 / count as f64;
            let to = match kind % 5 {
                // Anywhere; forwards and back; round; a serpentine; indexations of a few places.
                0 => [0, 1].map(|_| size * random.uniform()),
                1 => [size * (1.0 - (2.0 * part - 1.0).abs()), 0.3 * size * (1.0 - (2.0 * part - 1.0).abs())],
                2 => [size * (TAU * part).cos(), size * (TAU * part).sin()],
                3 => [size * (1.0 - (part * 8.0).rem_euclid(2.0) - 1.0).abs(), size * (part * 4.0).floor()],
                _ => [0, 1].map(|_| (random.index(5) as f64 - 2.0) * 0.5),
            };
            for axis in 0..2 {
                let way = to[axis] - at[axis];
                from[axis] = match kind / 5 {
                    // As it comes; from one side; now and then with an overshoot; one axis as it comes, the other from one side.
                    0 if way != 0.0 => way.signum(),
                    1 => fixed[axis],
                    2 if way != 0.0 => way.signum() * if random.index(8) == 0 { -1.0 } else { 1.0 },
                    3 if axis == 0 && way != 0.0 => way.signum(),
                    3 if axis == 1 => fixed[axis],
                    _ => from[axis],
                };
            }
            at = to;
            rows.push([at[0], at[1], from[0], from[1]]);
        }
        rows
    }

    fn told(rows: &[[f64; 4]], kind: AxisKind, is_touched: bool, columns: [usize; 2]) -> [Option<String>; 2] {
        let axes = [axis("one", kind, 0), axis("two", kind, 1)];
        let directed: Vec<(&Axis, usize)> = axes.iter().zip(columns).collect();
        let run: Vec<Passed<'_>> = rows.iter().enumerate().map(|(row, status)| (DataRow(row), &status[..])).collect();
        let exchanged = exchanged_directions(&directed, std::slice::from_ref(&run), is_touched);
        [exchanged, against_directions(&directed, std::slice::from_ref(&run), is_touched)]
    }

    #[test]
    fn good_programmes_get_no_word() {
        for seed in 0..20_000 {
            let mut random = Generator::new(seed, 7);
            let kind = random.index(20);
            let rows = programme(&mut random, kind);
            let axes = [AxisKind::Linear, AxisKind::Rotary][random.index(2)];
            let found = told(&rows, axes, random.index(2) == 0, [2, 3]);
            assert_eq!(found, [None, None], "{seed}, kind {kind}: {rows:?}");
        }
    }

    #[test]
    fn turned_and_exchanged_columns_are_told_where_axes_come_from_both_sides() {
        let mut counts = [0; 3];
        for seed in 0..2000 {
            let mut random = Generator::new(seed, 8);
            // Of positions anywhere, and round.
            let kind = [0, 2][random.index(2)];
            let rows = programme(&mut random, kind);
            if rows.len() < 40 {
                continue;
            }
            counts[0] += 1;
            let [exchanged, _] = told(&rows, AxisKind::Linear, false, [3, 2]);
            counts[1] += usize::from(exchanged.is_some());
            let turned: Vec<[f64; 4]> = rows.iter().map(|row| [row[0], row[1], -row[2], row[3]]).collect();
            let [_, against] = told(&turned, AxisKind::Linear, false, [2, 3]);
            counts[2] += usize::from(against.is_some_and(|words| words.contains("`dir_one`")));
        }
        assert!(counts[1] > counts[0] * 9 / 10 && counts[2] > counts[0] * 9 / 10, "{counts:?}");
    }
}
