//! Proves that a linear fit of all location and set-up errors leaves the same residuals wherever the machine origin is:
//! the set is closed under moving it.

use abbe_core::{Poses, Variable};
use abbe_numerics::Accumulator;
use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::oracle::Random;
use crate::subject;

/// Residuals of the fit to `readings` of the positions at `statuses`.
fn residuals(settings: &Value, statuses: &[f64], readings: &[f64]) -> Vec<f64> {
    let model = subject::model(settings, &[]);
    let count = model.parameters().len();
    let wanted: Vec<Variable> = (0..count).map(Variable::Parameter).collect();
    let mut poses = Poses::default();
    model.evaluate(statuses, &vec![0.0; count], &wanted, false, &mut poses).expect("poses");
    let row = |equation: usize| -> Vec<f64> {
        let derivatives = &poses.position_derivatives[equation / 3 * count..(equation / 3 + 1) * count];
        derivatives.iter().map(|derivative| derivative[equation % 3]).collect()
    };
    let mut accumulator = Accumulator::new(count, readings.len());
    for (equation, reading) in readings.iter().enumerate() {
        accumulator.push(&row(equation), *reading, 1.0);
    }
    let spectrum = accumulator.finish().spectrum();
    let step = spectrum.step(spectrum.singular_values().rank(1e-9));
    let after = |equation: usize| row(equation).iter().zip(&step).map(|(by, step)| by * step).sum::<f64>();
    readings.iter().enumerate().map(|(equation, reading)| reading + after(equation)).collect()
}

fn settings(chain: &str, rotary: [&str; 2], points: [Vector3<f64>; 2], offset: Vector3<f64>) -> Value {
    let point = |index: usize| json!({ "point_mm": <[f64; 3]>::from(points[index]) });
    let axes: serde_json::Map<String, Value> = (0..2)
        .filter(|&index| chain.contains(rotary[index]))
        .map(|index| (rotary[index].into(), point(index)))
        .collect();
    json!({
        "chain": chain, "tool_length_mm": 200.0, "stylus_radius_mm": 0.0, "axes": axes,
        "probe_offset_mm": <[f64; 3]>::from(offset), "errors": [{ "location": ["E?0*"] }],
    })
}

#[test]
fn residuals_of_a_fit_do_not_depend_on_the_origin() {
    let mut farthest = 0.0_f64;
    // With and without a rotary axis on the tool side: without, the tip itself is relative to the origin.
    for (seed, (chain, rotary, tip_hangs_on_rotary)) in [
        ("w C B X b Z Y t", ["C", "B"], false),
        ("w X Y b Z C A t", ["C", "A"], true),
        ("w C X b Y Z B t", ["C", "B"], true),
        ("w X b Y Z t", ["A", "B"], false),
        ("w A X b B Y Z t", ["A", "B"], true),
    ]
    .into_iter()
    .enumerate()
    {
        let random = &mut Random::new(seed as u64);
        let points = [random.vector(200.0), random.vector(200.0)];
        let (offset, v) = (random.vector(50.0), random.vector(400.0));
        let here = settings(chain, rotary, points, offset);
        let moved_offset = if tip_hangs_on_rotary { offset } else { offset - v };
        let there = settings(chain, rotary, points.map(|point| point - v), moved_offset);
        let statuses = subject::statuses(&*subject::model(&here, &[]), random, 60);
        let readings: Vec<f64> = (0..180).map(|_| 0.01 * random.signed()).collect();
        let [here, there] = [here, there].map(|settings| residuals(&settings, &statuses, &readings));
        let size = here.iter().fold(0.0_f64, |size, residual| size.max(residual.abs()));
        assert!(size > 1e-3, "{chain}: noise cannot be fitted away");
        for (here, there) in here.iter().zip(&there) {
            farthest = farthest.max((here - there).abs() / size);
        }
    }
    println!("largest change of a residual: {farthest:.1e} of the largest");
    assert!(farthest < 1e-10, "{farthest:e}");
}
