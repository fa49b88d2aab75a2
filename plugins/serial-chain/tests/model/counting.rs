//! Proves how many location errors can be identified: beside the nine set-up parameters of tool and workpiece they add
//! 4 R + 2 P + 3 minus the rank of these nine (R rotary, P linear axes): 3, 5 and 8 for three, four and five axes.

use abbe_core::{Poses, Variable};
use abbe_numerics::Accumulator;
use serde_json::json;

use crate::oracle::Random;
use crate::subject;

const SET_UP: [&str; 9] = ["dxt", "dyt", "dzt", "dxw", "dyw", "dzw", "daw", "dbw", "dcw"];

/// Rank of the derivatives of tip positions to some parameters, and the smallest singular value that counts.
fn rank(poses: &Poses, width: usize, columns: &[usize]) -> (usize, f64) {
    let mut accumulator = Accumulator::new(columns.len(), 3 * poses.positions.len());
    for pose in 0..poses.positions.len() {
        for direction in 0..3 {
            let row: Vec<f64> =
                columns.iter().map(|column| poses.position_derivatives[pose * width + column][direction]).collect();
            accumulator.push(&row, 0.0, 1.0);
        }
    }
    let singular_values = accumulator.finish().singular_values();
    let rank = singular_values.rank(1e-9);
    let smallest = singular_values.values()[rank - 1] / singular_values.values()[0];
    (rank, smallest)
}

/// How many location errors are identifiable beside the set-up, the rank of the set-up, the smallest singular value.
fn count(axes: &[&str], bed: usize, random: &mut Random) -> (usize, usize, f64) {
    let rotary = axes.iter().filter(|axis| "ABC".contains(&axis[..1]));
    let points: serde_json::Map<_, _> = rotary
        .map(|axis| ((*axis).to_owned(), json!({ "point_mm": <[f64; 3]>::from(random.vector(200.0)) })))
        .collect();
    let settings = json!({
        "chain": format!("w {} b {} t", axes[..bed].join(" "), axes[bed..].join(" ")),
        "tool_length_mm": 150.0,
        "stylus_radius_mm": 0.0,
        "probe_offset_mm": <[f64; 3]>::from(random.vector(80.0)),
        "axes": points,
        "errors": [{ "location": ["E?0*"] }],
    });
    let model = subject::model(&settings, &[]);
    let names: Vec<&str> = model.info().parameters.iter().map(|parameter| parameter.name.as_str()).collect();
    let set_up: Vec<usize> = (0..names.len()).filter(|&index| SET_UP.contains(&names[index])).collect();
    let all: Vec<usize> =
        (0..names.len()).filter(|&index| names[index].starts_with('E') || set_up.contains(&index)).collect();
    assert_eq!((set_up.len(), all.len()), (9, 9 + 6 * axes.len()));
    let statuses = subject::statuses(&*model, random, 60);
    let wanted: Vec<Variable> = (0..names.len()).map(Variable::Parameter).collect();
    let mut poses = Poses::default();
    model.poses(&statuses, &vec![0.0; names.len()], &wanted, false, &mut poses).expect("poses");
    let (of_set_up, _) = rank(&poses, wanted.len(), &set_up);
    let (of_all, smallest) = rank(&poses, wanted.len(), &all);
    (of_all - of_set_up, of_set_up, smallest)
}

/// Checks arrangements of the axes on both sides of the bed; every `stride`-th of all orders.
fn check(axes: &[&'static str], stride: usize, expected: usize) -> (usize, f64) {
    let (mut checked, mut smallest) = (0, 1.0_f64);
    let orders: Vec<Vec<&str>> = permutations(axes);
    for (index, (order, bed)) in
        orders.iter().flat_map(|order| (0..=axes.len()).map(move |bed| (order, bed))).enumerate()
    {
        if index % stride != 0 {
            continue;
        }
        let rotary = axes.iter().filter(|axis| "ABC".contains(&axis[..1])).count();
        let (identifiable, of_set_up, least) = count(order, bed, &mut Random::new(index as u64));
        let chain = format!("w {} b {} t", order[..bed].join(" "), order[bed..].join(" "));
        assert_eq!(identifiable, 4 * rotary + 2 * (axes.len() - rotary) + 3 - of_set_up, "{chain}");
        assert_eq!(identifiable, expected, "{chain}, rank of the set-up {of_set_up}");
        (checked, smallest) = (checked + 1, smallest.min(least));
    }
    (checked, smallest)
}

fn permutations<'a>(items: &[&'a str]) -> Vec<Vec<&'a str>> {
    if items.is_empty() {
        return vec![Vec::new()];
    }
    let mut all = Vec::new();
    for (index, item) in items.iter().enumerate() {
        let mut others = items.to_vec();
        others.remove(index);
        all.extend(permutations(&others).into_iter().map(|mut rest| {
            rest.insert(0, item);
            rest
        }));
    }
    all
}

#[test]
fn three_linear_axes_have_three_errors() {
    let (checked, smallest) = check(&["X", "Y", "Z"], 1, 3);
    println!("{checked} arrangements, smallest singular value that counts {smallest:.1e}");
    assert_eq!(checked, 24);
}

#[test]
fn one_rotary_axis_adds_two() {
    for rotary in ["A", "B", "C"] {
        let (checked, smallest) = check(&["X", "Y", "Z", rotary], 5, 5);
        println!("{rotary}: {checked} arrangements, smallest singular value that counts {smallest:.1e}");
    }
}

#[test]
fn two_rotary_axes_that_are_not_parallel_make_eight() {
    for [first, second] in [["A", "C"], ["B", "C"], ["A", "B"]] {
        let (checked, smallest) = check(&["X", "Y", "Z", first, second], 31, 8);
        println!("{first} and {second}: {checked} arrangements, smallest singular value that counts {smallest:.1e}");
    }
}
