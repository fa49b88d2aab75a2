//! Proves that a parameter does what its name says (conventions, sections 2 and 3): poses of the model against the oracle,
//! which reads where an error acts and what it is a function of off the parameter's name.

use abbe_core::KinematicModel;

use crate::oracle::{Machine, MachineErrors, Random, place, turn};
use crate::subject;

/// Legendre polynomials of degrees 0 to 3, written out.
fn legendre(degree: usize, x: f64) -> f64 {
    [1.0, x, (3.0 * x * x - 1.0) / 2.0, (5.0 * x * x * x - 3.0 * x) / 2.0][degree]
}

/// One row of statuses by name.
struct Status<'a> {
    model: &'a dyn KinematicModel,
    row: &'a [f64],
}

impl Status<'_> {
    fn number(&self, name: &str) -> f64 {
        let found = self.model.info().status.iter().position(|status| status.name == name);
        self.row[found.unwrap_or_else(|| panic!("no status {name}"))]
    }

    fn label(&self, name: &str) -> &str {
        let status = self.model.info().status.iter().find(|status| status.name == name).expect("a status");
        &status.levels[self.number(name) as usize]
    }
}

/// The value of what the bracket of a parameter's name says, of an error that moves with `axis`.
fn function(bracket: &str, axis: Option<&str>, status: &Status) -> f64 {
    let days = [("1", [0.0, 1800.0]), ("2", [1800.0, 3600.0])];
    let scaled = |[from, to]: [f64; 2]| -1.0 + 2.0 * (status.number("time") - from) / (to - from);
    match (bracket, axis) {
        ("b", Some(axis)) => status.number(&format!("dir_{axis}")),
        (degree, Some(axis)) => status.number(axis).powi(degree.parse().expect("a degree")),
        (drift, None) => match drift.strip_prefix("day") {
            None => legendre(drift[1..].parse().expect("a degree"), scaled([0.0, 3600.0])),
            Some(drift) => {
                let (day, degree) = drift.split_once(".t").expect("a day and a degree");
                let (_, range) = days.into_iter().find(|(label, _)| *label == day).expect("a day");
                let today = f64::from(u8::from(status.label("day") == day));
                today * legendre(degree.parse().expect("a degree"), scaled(range))
            }
        },
    }
}

/// The errors of the oracle's machine at a status, read off the parameters' names.
fn errors_of(names: &[&str], status: &Status, values: &[f64]) -> MachineErrors {
    let mut errors = MachineErrors::none(names.len());
    let stylus = status.label("stylus");
    for (parameter, value) in status.model.info().parameters.iter().zip(values) {
        let component = |letter: &str, all: &str| all.find(letter).expect("a component");
        let (symbol, bracket) = match parameter.name.strip_prefix("stylus[") {
            Some(rest) => {
                let (number, letter) = rest.split_once("].").expect("a number");
                if number == stylus {
                    errors.tool[component(letter, "xyz")] += value;
                }
                continue;
            }
            None => parameter.name.split_once('[').unwrap_or((&parameter.name, "]")),
        };
        let bracket = bracket.trim_end_matches(']');
        if let Some(set_up) = symbol.strip_prefix('d') {
            let (letter, side) = set_up.split_at(1);
            let component = component(letter, "xyzabc");
            let factor = match bracket {
                // The offsets of the tip are those of stylus 1.
                "" => f64::from(u8::from(side == "w" || component > 2 || stylus == "1")),
                bracket => function(bracket, None, status),
            };
            let target = if side == "w" { &mut errors.workpiece } else { &mut errors.tool };
            target[component] += value * factor;
        } else {
            let component = component(&symbol[1..2], "XYZABC");
            let name = symbol[2..].trim_start_matches('0');
            let axis = names.iter().position(|other| *other == name).expect("an axis");
            match bracket {
                "" => errors.location[axis][component] += value,
                bracket => errors.motion[axis][component] += value * function(bracket, Some(name), status),
            }
        }
    }
    errors
}

#[test]
fn parameters_do_what_their_names_say() {
    let (mut farthest, mut most_turned) = (0.0_f64, 0.0_f64);
    for seed in 0..30 {
        let random = &mut Random::new(seed);
        let (machine, names, settings) = subject::random(random, "exact");
        let model = subject::model(&settings, &[]);
        let tips = [
            machine.tip,
            serde_json::from_value::<[f64; 3]>(settings["styli"]["2"]["tip_mm"].clone()).expect("a tip").into(),
            serde_json::from_value::<[f64; 3]>(settings["styli"]["5"]["tip_mm"].clone()).expect("a tip").into(),
        ];
        let statuses = subject::statuses(&*model, random, 5);
        let values = subject::parameter_values(&*model, random, 0.2, 5e-4);
        let found = subject::poses(&*model, &statuses, &values, &[]);
        for (pose, row) in statuses.chunks_exact(model.info().status.len()).enumerate() {
            let status = Status { model: &*model, row };
            let errors = errors_of(&names, &status, &values);
            let machine = Machine { tip: tips[status.number("stylus") as usize], ..machine.clone() };
            let commands = &row[..names.len()];
            let expected = machine.tool_in_table(commands, &errors);
            let position = nalgebra::Vector3::from(found.positions[pose]);
            farthest = farthest.max((position - place(&expected)).norm() / machine.size(commands));
            let [w, x, y, z] = found.orientations[pose];
            let quaternion = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z));
            most_turned = most_turned.max((quaternion.to_rotation_matrix().matrix() - turn(&expected)).norm());
        }
    }
    println!("largest deviation: position {farthest:.1e} of its size, rotation {most_turned:.1e}");
    assert!(farthest < 1e-12 && most_turned < 1e-12, "{farthest:e} {most_turned:e}");
}

#[test]
fn motion_errors_are_the_linear_combinations_that_the_model_tells() {
    let mut worst = 0.0_f64;
    for seed in 0..10 {
        let random = &mut Random::new(seed);
        let (_, names, settings) = subject::random(random, "exact");
        let model = subject::model(&settings, &[]);
        let row = subject::statuses(&*model, random, 1);
        let values = subject::parameter_values(&*model, random, 0.2, 5e-4);
        let errors = errors_of(&names, &Status { model: &*model, row: &row }, &values);
        let functions = &model.info().error_functions;
        assert_eq!(functions.len(), 6 * names.len());
        for function in functions {
            let error = model.motion_error(function, &values, &row).expect("within all ranges");
            let sum: f64 = error.derivatives.iter().map(|(parameter, factor)| values[*parameter] * factor).sum();
            assert!((sum - error.value).abs() <= 1e-15, "{sum} {}", error.value);
            let expected = errors.motion[function.axis][function.component];
            worst = worst.max((sum - expected).abs() / expected.abs().max(1e-6));
            assert!(function.symbol.ends_with(names[function.axis]), "{}", function.symbol);
        }
    }
    assert!(worst < 1e-12, "{worst:e}");
}
