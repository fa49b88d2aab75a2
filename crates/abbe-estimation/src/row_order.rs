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

/// Sentences on signs that the order of rows contradicts. Touches are left out: each has an approach of its own, in whatever order they
/// were made.
pub fn contradicted_by_order(problem: &Problem) -> Vec<String> {
    let mut sentences = Vec::new();
    for set in problem.sets.iter().filter(|set| set.info().contact != Contact::LinearAxes) {
        let runs = runs(set);
        sentences.extend(against_directions(problem, &runs).map(|words| format!("{}: {words}", set.name)));
        sentences.extend(against_angles(problem, set, &runs).map(|words| format!("{}: {words}", set.name)));
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

/// Axes that move against their columns of direction, forwards and backwards. Where every target is approached from one side the order of
/// targets says nothing.
fn against_directions(problem: &Problem, runs: &[Vec<Passed<'_>>]) -> Option<String> {
    let info = problem.model.info();
    let mut names = Vec::new();
    for (index, axis) in info.axes.iter().enumerate() {
        let Some(column) = info.status_index(&StatusRole::Direction(index)) else { continue };
        // Steps and those that contradict, by direction.
        let (mut steps, mut against) = ([0; 2], [0; 2]);
        for pair in runs.iter().flat_map(|run| run.windows(2)) {
            let [(_, from), (_, to)] = pair else { continue };
            let (way, direction) = (way(axis, from, to), to[column]);
            if way.abs() > STILL && direction != 0.0 && from[column] == direction {
                let place = usize::from(direction > 0.0);
                steps[place] += 1;
                against[place] += usize::from(way * direction < 0.0);
            }
        }
        let contradicts =
            |(steps, against): (&usize, &usize)| *steps >= STEPS && *against as f64 > MOST * *steps as f64;
        if steps.iter().zip(&against).all(contradicts) {
            names.push(format!("`dir_{}` ({} of {} steps)", axis.name, against[0] + against[1], steps[0] + steps[1]));
        }
    }
    let names = names.join(", ");
    (!names.is_empty()).then(|| {
        format!("from row to row the axes move against {names}: are the signs turned? Backlash then gets a wrong value")
    })
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
