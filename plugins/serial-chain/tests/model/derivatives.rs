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
    moved.chunks_exact_mut(model.info().status.len()).for_each(|row| row[axis] += by);
    moved
}

/// Adds errors of an axis that follow temperatures: everywhere, with slopes of lengths and angles, and at positions.
fn thermal(errors: &mut Vec<serde_json::Value>, name: &str, unit: &str, positions: &serde_json::Value) {
    let rows: Vec<f64> = (0..=40).map(f64::from).collect();
    let column = |of: &dyn Fn(f64) -> f64| rows.iter().map(|row| of(*row)).collect::<Vec<f64>>();
    let log = json!({ "time_s": column(&|row| 90.0 * row), "T1_degC": column(&|row| 20.0 + 4.0 * (0.3 * row).sin()),
        "T2_degC": column(&|row| 20.0 + 0.1 * row) });
    let symbols = [format!("EX{name}"), format!("EC{name}")];
    let of = |symbols: &[String], setting: &str, value: serde_json::Value| {
        json!({ "thermal": symbols, "inputs": ["T1", "T2"], "time_constants_s": [200, 1500], "at_once": ["T2"], (setting): value,
            "starts_warm": true, "log": log })
    };
    errors.push(of(&symbols, "slope", json!(true)));
    errors.push(of(&symbols, &format!("positions_{unit}"), positions.clone()));
    errors.push(of(&[format!("EB{name}"), format!("EB0{name}")], "slope", json!(false)));
}

/// Adds families that have a shape: for every axis all those that it can have.
fn with_shapes(settings: &mut serde_json::Value, names: &[&str]) {
    let axes = settings["axes"].clone();
    // The direction of the machine in which an axis moves most.
    let along = |name: &str| {
        let part = |place: usize| axes[name]["direction"][place].as_f64().unwrap_or_default().abs();
        let most = (0..3).max_by(|one, other| part(*one).total_cmp(&part(*other)));
        ['X', 'Y', 'Z'][most.unwrap_or_default()]
    };
    let Some(errors) = settings["errors"].as_array_mut() else { return };
    let rotary = |name: &str| name.starts_with(['A', 'B', 'C']);
    for name in names {
        let symbols = [format!("EX{name}"), format!("EB{name}")];
        let range = if rotary(name) { json!([-120, 120]) } else { json!([-420, 420]) };
        let knots = if rotary(name) { json!([-100, -30, 40, 90]) } else { json!([-260, -10, 190, 330]) };
        let unit = if rotary(name) { "deg" } else { "mm" };
        let (in_range, in_knots, wave) =
            (format!("range_{unit}"), format!("knots_{unit}"), format!("wavelength_{unit}"));
        let without = if rotary(name) { "without_once_per_turn" } else { "without_line" };
        let straight = [format!("EY{name}"), format!("EZ{name}")];
        errors.push(json!({ "spline": symbols, (&in_knots): knots, "zero": [format!("EX{name}[spl0]")] }));
        errors.push(json!({ "b-spline": symbols, "degree": 3, (&in_knots): knots, (&in_range): range }));
        errors.push(json!({ "legendre": symbols, "degrees": [1, 4], (&in_range): range }));
        errors.push(json!({ "chebyshev": straight, "degrees": [2, 5], (&in_range): range, (without): true }));
        errors.push(json!({
            "periodic": symbols, (&wave): 47.5, "functions": 3, "estimate_wavelength": true,
        }));
        let load = json!({
            "load": symbols, "reference_N": 4900, "guideway_distance_mm": 375, "degree": 3, "continuity": 2, (&in_knots): knots,
        });
        errors.push(load);
        errors.push(json!({ "load": [format!("EA0{name}")], "reference_N": 4900 }));
        let alike: Vec<&&str> = names.iter().filter(|other| rotary(other) == rotary(name)).collect();
        errors.push(json!({ "product": straight, "of": [alike[0], alike[alike.len() - 1], name] }));
        if !rotary(name) {
            errors.push(json!({ "lag": [format!("E{}{name}", along(name))] }));
            errors.push(json!({ "cyclic": symbols, "pitch_mm": 31.0, "orders": [1, 3] }));
        }
        if rotary(name) {
            errors.push(json!({ "fourier": symbols, "orders": [1, 3] }));
            errors.push(json!({ "gravity": symbols, "angles": [name] }));
        }
        thermal(errors, name, unit, &if rotary(name) { json!([-125, -20, 60, 125]) } else { json!([-410, -75, 410]) });
    }
    // The polynomials of the machine have the names of the ordinary ones here: these are in the way.
    errors.retain(|line| line.get("polynomial").is_none() && line.get("backlash").is_none());
    let patterns: Vec<String> = names.iter().map(|name| format!("E?{name}")).collect();
    let of = |wanted: bool| -> Vec<&String> {
        names.iter().zip(&patterns).filter(|(name, _)| rotary(name) == wanted).map(|(_, pattern)| pattern).collect()
    };
    errors.push(json!({ "backlash": patterns, "degrees": [1, 3] }));
    for (rotary, unit, knots) in [(true, "deg", [-50, 20]), (false, "mm", [-150, 120])] {
        if !of(rotary).is_empty() {
            let knots_setting = format!("knots_{unit}");
            errors.push(json!({ "piecewise": of(rotary), "degree": 3, "continuity": 2, (knots_setting): knots }));
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
        let wanted: Vec<Variable> = (0..model.info().parameters.len())
            .map(Variable::Parameter)
            .chain((0..model.info().axes.len()).map(Variable::Command))
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
                    // A wavelength bends what it shapes long before that.
                    let shape = model.info().nominal[parameter];
                    let step = if shape == 0.0 { step } else { step.min(1e-5 * shape) };
                    differences(step, |by| {
                        let mut values = values.clone();
                        values[parameter] += by;
                        subject::poses(&*model, &statuses, &values, &[])
                    })
                }
                Variable::Command(axis) => {
                    // Small, because second derivatives jump at knots.
                    let step = if model.info().axes[axis].kind == AxisKind::Linear { 1e-4 } else { 1e-6 };
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
                    // A difference over a knot of a periodic error is off by the jump of the second derivative there.
                    let is_wave = |index: usize| model.info().parameters[index].name.ends_with(".wavelength");
                    let shape = matches!(*variable, Variable::Parameter(index) if is_wave(index));
                    let relative_to = if shape { 1e4 * relative_to } else { relative_to };
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
    let names: Vec<&str> = model.info().parameters.iter().map(|parameter| parameter.name.as_str()).collect();
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

#[test]
fn motion_errors_have_the_derivatives_that_they_tell() {
    let mut worst = 0.0_f64;
    for seed in 0..6 {
        let random = &mut Random::new(seed);
        let (_, names, mut settings) = subject::random(random, "exact");
        with_shapes(&mut settings, &names);
        let model = subject::model(&settings, &[]);
        let row = subject::statuses(&*model, random, 1);
        let values = subject::parameter_values(&*model, random, 0.2, 5e-4);
        for function in &model.info().error_functions {
            let at = |values: &[f64]| model.motion_error(function, values, &row).expect("within all ranges");
            for (parameter, derivative) in at(&values).derivatives {
                let step = if values[parameter] == 0.0 { 1e-3 } else { 1e-6 * values[parameter].abs() };
                let [above, below] = [step, -step].map(|by| {
                    let mut values = values.clone();
                    values[parameter] += by;
                    at(&values).value
                });
                let difference = (above - below) / (2.0 * step);
                worst =
                    worst.max((difference - derivative).abs() / derivative.abs().max(1e-3 / values[parameter].abs()));
            }
        }
    }
    assert!(worst < 1e-6, "{worst:e}");
}

#[test]
fn what_a_family_cannot_be_is_refused() {
    let refused = |line: serde_json::Value| {
        subject::refused(&json!({
            "chain": "w C b Y X t", "tool_length_mm": 100, "stylus_radius_mm": 0, "axes": { "X": { "range_mm": [0, 200] } },
            "errors": [line],
        }))
    };
    let cases = [
        (
            json!({ "legendre": ["EXY"], "degrees": [1] }),
            "errors[0]: a Legendre polynomial needs the travel: `range_mm` here or of the axis",
        ),
        (
            json!({ "polynomial": ["EXC"], "degrees": [2], "range_deg": [0, 9], "without_line": true }),
            "errors[0].without_line: this is for errors of a linear axis",
        ),
        (
            json!({ "piecewise": ["EYX"], "degree": 2, "continuity": 1, "knots_mm": [50, 250] }),
            "errors[0].knots_mm[1]: the knot 250 is not between 0 and 200, the ends of the range",
        ),
        (
            json!({ "legendre": ["EXC"], "degrees": [1], "range_mm": [0, 1] }),
            "errors[0].range_mm: the range of a rotary axis is made of angles: `range_deg`",
        ),
        (json!({ "product": ["EAY"], "of": ["X", "Z"] }), "errors[0].of[1]: the chain has no axis Z"),
        (
            json!({ "product": ["EAY"], "of": ["X", "C"] }),
            "errors[0].of[1]: a product is one of linear axes, or one of rotary axes",
        ),
        (
            json!({ "load": ["EA0X"], "reference_N": 9, "degree": 1 }),
            "errors[0].degree: a location error does not change with the command",
        ),
        (json!({ "load": ["EAX"], "reference_N": 9 }), "errors[0]: a motion error under load needs a `degree`"),
    ];
    for (line, expected) in cases {
        let error = refused(line);
        assert!(error.contains(expected), "{error}\n{expected}");
    }
}

#[test]
fn commands_outside_the_range_are_refused_where_they_matter() {
    let model = subject::model(
        &json!({
            "chain": "w b Y X t", "tool_length_mm": 100, "stylus_radius_mm": 0,
            "errors": [{ "legendre": ["EXX"], "degrees": [1, 2], "range_mm": [0, 200] }],
        }),
        &[],
    );
    let index =
        model.info().parameters.iter().position(|parameter| parameter.name == "EXX[leg1]").expect("a parameter");
    let x = model.info().axes.iter().find(|axis| axis.name == "X").expect("an axis").status;
    let at = |place: f64, wanted: &[Variable]| {
        let mut row = vec![0.0; model.info().status.len()];
        row[x] = place;
        model.poses(&row, &model.info().nominal, wanted, false, &mut Poses::default())
    };
    // An error that is neither there nor wanted is no matter; a command at the very end is none either.
    assert!(at(300.0, &[]).is_ok() && at(201.0, &[Variable::Parameter(index)]).is_ok());
    let error = at(300.0, &[Variable::Parameter(index)]).expect_err("beyond the range").to_string();
    assert!(error.contains("EXX is needed with X at 300 mm, beyond its range of 0 to 200 mm"), "{error}");
}
