//! Proves the model's derivatives of position and orientation to every parameter of every family and to every command,
//! at parameters that are not zero, against differences; exact and to first order.

use abbe_core::{AxisKind, KinematicModel, Poses, Variable};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde_json::json;

use crate::oracle::{Random, rotation_vector};
use crate::subject;

/// Central differences of all poses: position and rotation vector.
fn central(above: &Poses, below: &Poses, step: f64) -> Vec<[Vector3<f64>; 2]> {
    let turn = |[w, x, y, z]: [f64; 4]| {
        UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)).to_rotation_matrix().into_inner()
    };
    let position = |pose: usize| Vector3::from(above.positions[pose]) - Vector3::from(below.positions[pose]);
    let rotation =
        |pose: usize| rotation_vector(&(turn(above.orientations[pose]) * turn(below.orientations[pose]).transpose()));
    (0..above.positions.len()).map(|pose| [position(pose), rotation(pose)].map(|by| by / (2.0 * step))).collect()
}

fn differences(step: f64, mut at: impl FnMut(f64) -> Poses) -> Vec<[Vector3<f64>; 2]> {
    let mut central_at = |step: f64| central(&at(step), &at(-step), step);
    let (wide, narrow) = (central_at(step), central_at(0.5 * step));
    let extrapolated = |(wide, narrow): (&Vector3<f64>, &Vector3<f64>)| (narrow * 4.0 - wide) / 3.0;
    let both = wide.iter().zip(&narrow);
    both.map(|(wide, narrow)| [0, 1].map(|part| extrapolated((&wide[part], &narrow[part])))).collect()
}

/// A command moved in all poses.
fn commanded(model: &dyn KinematicModel, statuses: &[f64], axis: usize, by: f64) -> Vec<f64> {
    let mut moved = statuses.to_vec();
    moved.chunks_exact_mut(model.status().len()).for_each(|row| row[axis] += by);
    moved
}

/// Adds a spline for every axis and a Fourier series for every rotary one.
fn with_shapes(settings: &mut serde_json::Value, names: &[&str]) {
    let Some(errors) = settings["errors"].as_array_mut() else { return };
    for name in names {
        let symbols = [format!("EX{name}"), format!("EB{name}")];
        if name.starts_with(['A', 'B', 'C']) {
            errors.push(
                json!({ "spline": symbols, "knots_deg": [-100, -30, 40, 90], "zero": [format!("EX{name}[spl0]")] }),
            );
            errors.push(json!({ "fourier": symbols, "orders": [1, 3] }));
        } else {
            errors.push(json!({ "spline": symbols, "knots_mm": { "from": -300, "to": 300, "step": 200 } }));
        }
    }
}

/// The largest deviation of a derivative, relative to the largest one to the same variable, positions and rotations.
fn worst(seeds: std::ops::Range<u64>, evaluation: &str, mm: f64, rad: f64) -> [f64; 2] {
    let mut worst = [0.0_f64; 2];
    for seed in seeds {
        let random = &mut Random::new(seed);
        let (_, names, mut settings) = subject::random(random, evaluation);
        with_shapes(&mut settings, &names);
        let model = subject::model(&settings, &[]);
        let statuses = subject::statuses(&*model, random, if seed % 4 == 0 { 3 } else { 1 });
        let values = subject::parameter_values(&*model, random, mm, rad);
        let wanted: Vec<Variable> = (0..model.parameters().len())
            .map(Variable::Parameter)
            .chain((0..model.axes().len()).map(Variable::Command))
            .collect();
        let analytic = subject::poses(&*model, &statuses, &values, &wanted);
        let poses = analytic.positions.len();
        for (index, variable) in wanted.iter().enumerate() {
            let of = |pose: usize| {
                let at = pose * wanted.len() + index;
                [analytic.position_derivatives[at], analytic.rotation_derivatives[at]].map(Vector3::from)
            };
            let largest = (0..poses)
                .map(of)
                .fold([0.0_f64; 2], |largest, by| [largest[0].max(by[0].norm()), largest[1].max(by[1].norm())]);
            let found = match *variable {
                Variable::Parameter(parameter) => {
                    // A step with an effect of half a millimetre or a milliradian; both are within the model's curvature.
                    let step = (0.5 / largest[0].max(1e-6)).min(1e-3 / largest[1].max(1e-6));
                    differences(step, |by| {
                        let mut values = values.clone();
                        values[parameter] += by;
                        subject::poses(&*model, &statuses, &values, &[])
                    })
                }
                Variable::Command(axis) => {
                    let step = if model.axes()[axis].kind == AxisKind::Linear { 0.5 } else { 1e-3 };
                    differences(step, |by| {
                        subject::poses(&*model, &commanded(&*model, &statuses, axis, by), &values, &[])
                    })
                }
            };
            for (pose, found) in found.iter().enumerate() {
                for part in 0..2 {
                    let deviation = (found[part] - of(pose)[part]).norm();
                    // Nothing moves at all by what is small against a micrometre or a nanoradian a unit of effect.
                    let relative_to = largest[part].max(1e-3 * largest[1 - part]).max(1e-6);
                    worst[part] = worst[part].max(deviation / relative_to);
                }
            }
        }
    }
    worst
}

#[test]
fn exact_models_have_the_derivatives_of_their_poses() {
    let found = worst(0..20, "exact", 0.2, 5e-4);
    println!("largest deviation: {:.1e} of positions, {:.1e} of rotations", found[0], found[1]);
    assert!(found.iter().all(|&deviation| deviation < 1e-7), "{found:?}");
}

#[test]
fn first_order_models_have_the_derivatives_of_their_poses() {
    let found = worst(20..24, "first-order", 5.0, 0.02);
    println!("largest deviation: {:.1e} of positions, {:.1e} of rotations", found[0], found[1]);
    assert!(found.iter().all(|&deviation| deviation < 1e-7), "{found:?}");
}

#[test]
fn first_order_models_miss_exact_ones_by_the_square() {
    let mut farthest = 0.0_f64;
    for seed in 0..10 {
        let random = &mut Random::new(seed);
        let (_, _, exact) = subject::random(random, "exact");
        let mut linear = exact.clone();
        linear["evaluation"] = "first-order".into();
        let (exact, linear) = (subject::model(&exact, &[]), subject::model(&linear, &[]));
        let statuses = subject::statuses(&*exact, random, 3);
        let values = subject::parameter_values(&*exact, random, 0.2, 5e-4);
        let costs: Vec<Vec<f64>> = (0..4)
            .map(|halvings| {
                let values: Vec<f64> = values.iter().map(|value| value * 0.5_f64.powi(halvings)).collect();
                let [exact, linear] = [&exact, &linear].map(|model| subject::poses(&**model, &statuses, &values, &[]));
                let positions = exact.positions.iter().zip(&linear.positions);
                positions.map(|(exact, linear)| (Vector3::from(*exact) - Vector3::from(*linear)).norm()).collect()
            })
            .collect();
        for pair in costs.windows(2) {
            for (wide, narrow) in pair[0].iter().zip(&pair[1]) {
                farthest = farthest.max((wide / narrow / 4.0 - 1.0).abs());
            }
        }
    }
    println!("largest deviation of the ratio from 4: {:.2} %", 100.0 * farthest);
    assert!(farthest < 0.1, "{farthest}");
}

#[test]
fn values_that_are_zero_by_definition_are_no_parameters() {
    let settings = |zero: &str, family: serde_json::Value| {
        let mut errors = json!([{ "spline": ["EXX", "EYX"], "knots_mm": [0, 50, 100, 200], "zero": [zero] }]);
        errors.as_array_mut().expect("a list").push(family);
        json!({ "chain": "w C b X t", "tool_length_mm": 100, "stylus_radius_mm": 0, "errors": errors })
    };
    let fourier = json!({ "fourier": ["EXC"], "orders": [2] });
    let model = subject::model(&settings("EYX[spl?]", fourier.clone()), &[]);
    let names: Vec<&str> = model.parameters().iter().map(|parameter| parameter.name.as_str()).collect();
    let motion: Vec<&&str> = names.iter().filter(|name| name.starts_with('E')).collect();
    assert_eq!(motion, ["EXX[spl0]", "EXX[spl1]", "EXX[spl2]", "EXX[spl3]", "EXC[cos2]", "EXC[sin2]"].each_ref());
    // What is no coefficient of the line is named, and so are families that an axis cannot have.
    let cases = [
        (
            settings("EXX[spl4]", fourier.clone()),
            "`EXX[spl4]` is no coefficient of this line (did you mean `EXX[spl0]`?)",
        ),
        (
            settings("EXX[spl0]", json!({ "fourier": ["EXX"], "orders": [2] })),
            "a Fourier series is one of the angle of a rotary axis",
        ),
        (
            settings("EXX[spl0]", json!({ "spline": ["EXC"], "knots_mm": [0, 50, 100] })),
            "the knots of a rotary axis are angles: `knots_deg`",
        ),
    ];
    for (settings, expected) in cases {
        let error = subject::refused(&settings);
        assert!(error.contains(expected), "{error}");
    }
}
