//! Corrected set-points: three machines with known errors, against the figures that an independent solver found for them
//! (`tests/truth/compensation-*.json`).

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

use abbe_compensation::{
    Compensator, Correct, Figures, Method, SetPoints, Settings, Travel, Trials, figures, remaining, reversed_moves,
};
use abbe_core::{Calibration, KinematicModel, machine_values};
use abbe_engine::model_of;
use serde_json::{Value, json};

use crate::controls::law;
use crate::support::{abbe, json_file, read, registry, root, temporary, write};

const MACHINES: [&str; 3] = ["table-table", "head-table", "three-axis"];
const PATHS: [&str; 4] = ["linear", "rotary", "cone", "s-path"];

fn folder(machine: &str) -> PathBuf {
    root().join("pipelines/data/compensation").join(machine)
}

/// The number in the brackets after a symbol, if it is one.
fn number(name: &str, prefix: &str) -> Option<u32> {
    name.split_once('[')?.1.strip_suffix(']')?.strip_prefix(prefix)?.parse().ok()
}

/// The lines under `errors` that declare parameters of these names.
fn declared(names: &[String], knots: &Value) -> Vec<Value> {
    let symbol = |name: &String| name.split('[').next().unwrap_or_default().to_owned();
    let locations: Vec<&String> = names.iter().filter(|name| name.len() == 4 && name.as_bytes()[2] == b'0').collect();
    let mut lines = vec![json!({ "location": locations })];
    let symbols: BTreeSet<String> = names.iter().filter(|name| name.contains('[')).map(symbol).collect();
    for symbol in symbols {
        let own: Vec<&String> = names.iter().filter(|name| name.starts_with(&format!("{symbol}["))).collect();
        let orders = |prefix: &str| own.iter().filter_map(|name| number(name, prefix)).collect::<BTreeSet<_>>();
        if own.iter().any(|name| name.contains("[pp")) {
            lines.push(json!({ "piecewise": [symbol], "degree": 2, "continuity": 1, "knots_mm": knots[&symbol] }));
        } else if !orders("").is_empty() {
            lines.push(json!({ "polynomial": [symbol], "degrees": orders("") }));
        }
        let waves: BTreeSet<u32> = orders("cos").union(&orders("sin")).copied().collect();
        if !waves.is_empty() {
            lines.push(json!({ "fourier": [symbol], "orders": waves }));
        }
        if own.iter().any(|name| name.ends_with("[b]")) {
            lines.push(json!({ "backlash": [symbol] }));
        }
    }
    lines
}

/// A calibration that states the truth of a machine; `status` is that of its values.
pub fn calibration(machine: &str) -> Value {
    let truth = json_file(&root().join(format!("tests/truth/compensation-{machine}.json")));
    let names: Vec<String> = truth["parameters"].as_object().expect("parameters").keys().cloned().collect();
    let text = read(&folder(machine).join("machine.yaml"));
    let mut settings: Value = serde_yaml::from_str(&text).expect("YAML");
    let settings = settings.as_object_mut().expect("settings");
    settings.retain(|key, _| !["name", "table_frame"].contains(&key.as_str()));
    // The first knot of Z stands at the end of its travel, or beyond it.
    settings["axes"]["Z"]["range_mm"][0] = json!(-200);
    settings.insert("errors".to_owned(), json!(declared(&names, &truth["knots_mm"])));
    let unit = |name: &str| {
        let of = if matches!(name.as_bytes()[1], b'A'..=b'C') { "rad" } else { "mm" };
        let of = if name.starts_with('d') { "mm" } else { of };
        let per = if name.len() > 2 && matches!(name.as_bytes()[2], b'A'..=b'C') { "rad" } else { "mm" };
        let degree = number(name, "").or_else(|| name.contains("[pp").then_some(2));
        match degree {
            Some(1) => format!("{of}/{per}"),
            Some(degree) => format!("{of}/{per}^{degree}"),
            None => of.to_owned(),
        }
    };
    let parameters: Vec<Value> = (truth["parameters"].as_object().expect("parameters").iter())
        .map(|(name, value)| {
            json!({ "name": name, "value": value, "unit": unit(name), "standard_uncertainty": 0, "status": "fixed" })
        })
        .collect();
    json!({
        "abbe_calibration": 1, "estimate": "truth", "parameters": parameters, "artefacts": [], "outliers": [],
        "model": { "plugin": "serial-chain", "settings": settings },
        "covariance": { "order": [], "rows": [] },
        "fit": {
            "observations": 0, "unknowns": 0, "rank": 0, "condition": 1.0, "degrees_of_freedom": 0, "sigma": 1.0,
            "iterations": 0, "termination": "converged", "residual_max_um": 0.0, "residual_mean_abs_um": 0.0,
            "residual_rms_um": 0.0, "null_space": [],
        },
    })
}

struct Known {
    model: Arc<dyn KinematicModel>,
    values: Vec<f64>,
}

fn known(machine: &str) -> Known {
    let calibration = Calibration::from_json(&calibration(machine).to_string()).expect("a calibration");
    let model = model_of(&calibration, &registry()).expect("a model");
    let truth = json_file(&root().join(format!("tests/truth/compensation-{machine}.json")));
    for name in truth["parameters"].as_object().expect("parameters").keys() {
        assert!(model.info().parameter(name).is_some(), "{machine} lacks {name}");
    }
    let values = machine_values(model.as_ref(), &calibration);
    Known { model, values }
}

fn set_points(machine: &str, path: &str, model: &dyn KinematicModel) -> SetPoints {
    let file = folder(machine).join(format!("setpoints-{path}.csv"));
    SetPoints::read(&file, model).unwrap_or_else(|error| panic!("{error}"))
}

fn corrected(known: &Known, points: &SetPoints, settings: &Settings) -> (Vec<f64>, Figures) {
    let compensator = Compensator::new(known.model.as_ref(), &known.values, settings).expect("settings");
    let (statuses, corrections) = compensator.correct(points.statuses()).unwrap_or_else(|error| panic!("{error}"));
    (statuses, figures(&corrections))
}

/// The same number to the digits that are printed (six), or both zero to `zero`.
fn same(found: f64, expected: &Value, zero: f64, what: &str) {
    let expected = expected.as_f64().expect("a figure");
    let close = (found - expected).abs() <= 2e-5 * expected.abs() || (found.abs() < zero && expected.abs() < zero);
    assert!(close, "{what}: {found} instead of {expected}");
}

/// The figures before, after an exact and after a first-order correction are those that another program found, and an exact
/// correction takes at most four passes.
#[test]
fn figures_are_those_of_an_independent_solver() {
    let expected = json_file(&root().join("tests/truth/compensation-expected.json"));
    let mut compared = 0;
    for machine in MACHINES {
        let known = known(machine);
        for path in PATHS.iter().filter(|path| folder(machine).join(format!("setpoints-{path}.csv")).is_file()) {
            let points = set_points(machine, path, known.model.as_ref());
            for (key, of_path) in expected[machine][path].as_object().expect("figures") {
                let (correct, method) = match key.as_str() {
                    "before" | "exact_position_only" => (Correct::Position, Method::Exact),
                    "first_order_position_only" => (Correct::Position, Method::FirstOrder),
                    "exact_five_axes" => (Correct::FiveAxes, Method::Exact),
                    "first_order_five_axes" => (Correct::FiveAxes, Method::FirstOrder),
                    _ => continue,
                };
                let is_exact = method == Method::Exact;
                let settings = Settings { correct, method, ..Settings::default() };
                let (_, found) = corrected(&known, &points, &settings);
                let (tip, axis) = match key.as_str() {
                    "before" => (found.tip_before, found.axis_before),
                    _ => (found.tip_after, found.axis_after),
                };
                let what = format!("{machine} {path} {key}");
                let zero = if key == "before" { 0.0 } else { 1e-6 };
                if found.bounded == 0 {
                    for (name, value) in [
                        ("position_max_um", tip.max * 1e3),
                        ("position_rms_um", tip.rms * 1e3),
                        ("orientation_max_urad", axis.max * 1e6),
                        ("orientation_rms_urad", axis.rms * 1e6),
                    ] {
                        same(value, &of_path[name], zero, &format!("{what} {name}"));
                        compared += 1;
                    }
                }
                if is_exact {
                    assert!(found.tip_after.max < 1e-9, "{what}: {found:?}");
                    assert!(found.passes <= 4, "{what}: {} passes", found.passes);
                }
            }
        }
    }
    assert!(compared > 100, "{compared} figures were compared");
}

/// The file of another program, whose commands have nine decimals, and a path without columns of directions.
#[test]
fn files_are_those_of_an_independent_solver() {
    for machine in MACHINES {
        let known = known(machine);
        let model = known.model.as_ref();
        let points = set_points(machine, "cone", model);
        let correct = if machine == "three-axis" { Correct::Position } else { Correct::FiveAxes };
        let (statuses, found) = corrected(&known, &points, &Settings { correct, ..Settings::default() });
        let file = folder(machine).join("setpoints-cone.csv");
        let text = points.with_commands(model, &statuses).expect("a file");
        let theirs = read(&folder(machine).join("compensated-cone.csv"));
        assert_eq!(text.lines().count(), theirs.lines().count());
        let mut compared = 0;
        for (ours, theirs) in text.lines().zip(theirs.lines()).filter(|(line, _)| !line.starts_with('#')).skip(1) {
            for (ours, theirs) in ours.split(',').zip(theirs.split(',')) {
                let [one, other] = [ours, theirs].map(|cell| cell.parse::<f64>().expect("a number"));
                assert!((one - other).abs() < 1.5e-9, "{machine}: {ours} and {theirs}");
                compared += 1;
            }
        }
        assert!(compared > 5000);

        // What a machine reads from the file: within 1e-6 mm and 1e-6 rad.
        let folder_of_file = temporary();
        let written = folder_of_file.path().join("corrected.csv");
        write(&written, &text);
        let again = SetPoints::read(&written, model).expect("set-points");
        for (now, exact) in again.statuses().iter().zip(&statuses) {
            assert!((now - exact).abs() < 1e-9, "{now} and {exact}");
        }
        assert!(found.bounded == 0 && found.held == 0);

        // Directions are those of the path.
        let without: String = read(&file)
            .lines()
            .map(|line| {
                let cells: Vec<&str> = line.split(',').collect();
                cells[..cells.len() - model.info().axes.len()].join(",") + "\n"
            })
            .collect();
        write(&written, &without);
        let of_path = SetPoints::read(&written, model).expect("set-points");
        assert_eq!(of_path.statuses(), points.statuses(), "{machine}");
    }
}

/// Beside a pole rotary corrections are held at their bound; the tip is exact all the same, and the points are told.
#[test]
fn the_bound_holds_near_a_pole() {
    let known = known("head-table");
    let points = set_points("head-table", "rotary", known.model.as_ref());
    let bound = |mrad: f64| Settings {
        correct: Correct::FiveAxes,
        largest_rotary_correction_mrad: mrad,
        ..Settings::default()
    };
    let rotary = |statuses: &[f64]| {
        let axes = known.model.info().axes.iter().filter(|axis| axis.kind == abbe_core::AxisKind::Rotary);
        let places: Vec<usize> = axes.map(|axis| axis.status).collect();
        let width = known.model.info().status.len();
        let pairs = statuses.iter().zip(points.statuses()).enumerate();
        let of_axes = pairs.filter(|(index, _)| places.contains(&(index % width)));
        of_axes.map(|(_, (now, before))| (now - before).abs()).fold(0.0, f64::max)
    };
    // C is turned by 17 mrad where the tilt passes 0.24 degrees from the pole.
    let (statuses, found) = corrected(&known, &points, &bound(50.0));
    assert!((0.016..0.018).contains(&rotary(&statuses)), "{}", rotary(&statuses));
    assert!(found.bounded == 0 && found.axis_after.max < 1e-9, "{found:?}");
    let (statuses, found) = corrected(&known, &points, &bound(5.0));
    assert!(rotary(&statuses) <= 5.0e-3 * (1.0 + 1e-9));
    assert!(found.bounded > 0 && found.bounded < 20 && found.tip_after.max < 1e-9, "{found:?}");
    // Only what needs more than the bound keeps a part of its error.
    let settings = bound(5.0);
    let compensator = Compensator::new(known.model.as_ref(), &known.values, &settings).expect("settings");
    let (_, corrections) = compensator.correct(points.statuses()).expect("corrections");
    for correction in corrections {
        assert!(correction.is_bounded || correction.after.angle() < 1e-9, "{correction:?}");
    }
}

#[test]
fn what_cannot_or_may_not_be_corrected_is_told_or_refused() {
    let known = known("table-table");
    let model = known.model.as_ref();
    let points = set_points("table-table", "linear", model);
    let refused = |settings: &Settings| {
        let compensator = Compensator::new(model, &known.values, settings)?;
        compensator.correct(points.statuses()).map(drop)
    };
    let error = refused(&Settings { largest_tip_correction_mm: 0.05, ..Settings::default() }).unwrap_err();
    assert!(error.message.contains("at most 0.05 mm are allowed") && error.pose.is_some(), "{error}");
    assert!(points.locate(error).to_string().contains("setpoints-linear.csv:"));
    let five = Settings { correct: Correct::FiveAxes, largest_axis_correction_mrad: 0.01, ..Settings::default() };
    assert!(refused(&five).unwrap_err().message.contains("at most 0.01 mrad are allowed"));
    for (axes, expected) in [(vec!["X", "Q"], "no axis Q"), (vec!["C"], "rotary axis"), (vec!["X", "X"], "twice")] {
        let correct = Correct::Axes(axes.into_iter().map(str::to_owned).collect());
        let error = refused(&Settings { correct, ..Settings::default() }).unwrap_err();
        assert!(error.message.contains(expected), "{error}");
    }

    // Two axes leave the third component; one sensitive direction leaves what is across.
    let along = |settings: &Settings| {
        let compensator = Compensator::new(model, &known.values, settings).expect("settings");
        compensator.correct(points.statuses()).expect("corrections").1
    };
    let two = Settings { correct: Correct::Axes(vec!["X".to_owned(), "Z".to_owned()]), ..Settings::default() };
    for point in along(&two) {
        let ([x, y, z], before) = (point.after.tip, point.before.tip);
        assert!(x.abs() < 2e-5 && z.abs() < 2e-5 && (y - before[1]).abs() < 2e-5, "{point:?}");
    }
    let across = Settings { sensitive_direction: Some([0.0, 3.0, 4.0]), ..Settings::default() };
    for point in along(&across) {
        let [x, y, z] = point.after.tip;
        assert!((0.6 * y + 0.8 * z).abs() < 1e-9 && (x - point.before.tip[0]).abs() < 1e-5, "{point:?}");
    }
    // An axis that moves the tip nowhere along it corrects nothing.
    for method in [Method::Exact, Method::FirstOrder] {
        let correct = Correct::Axes(vec!["X".to_owned()]);
        let nothing = Settings { correct, method, sensitive_direction: Some([0.0, 0.0, 1.0]), ..Settings::default() };
        let error = refused(&nothing).unwrap_err();
        let words = "X moves the tip nowhere along the sensitive direction [0, 0, 1]";
        assert!(error.message.contains(words) && error.pose.is_some(), "{error}");
    }

    // At the end of travel an axis is refused, or held, and what remains is told.
    let mut at_end = points.statuses()[..model.info().status.len()].to_vec();
    let x = model.info().axes.iter().find(|axis| axis.name == "X").expect("an axis");
    let towards = {
        let settings = Settings::default();
        let compensator = Compensator::new(model, &known.values, &settings).expect("settings");
        let end = x.range.expect("a range");
        at_end[x.status] = end[1] - 1.0;
        let (moved, _) = compensator.correct(&at_end).expect("corrections");
        end[usize::from(moved[x.status] > at_end[x.status])]
    };
    at_end[x.status] = towards;
    let refuse = Settings::default();
    let compensator = Compensator::new(model, &known.values, &refuse).expect("settings");
    let error = compensator.correct(&at_end).unwrap_err();
    assert!(error.message.contains("corrected, X stands at") && error.pose == Some(0), "{error}");
    let hold = Settings { travel: Travel::Hold, ..Settings::default() };
    let compensator = Compensator::new(model, &known.values, &hold).expect("settings");
    let (held, corrections) = compensator.correct(&at_end).expect("corrections");
    assert_eq!(held[x.status], towards);
    assert!(!corrections[0].held.is_empty() && corrections[0].after.distance() > 1e-3);
    assert!(corrections[0].after.distance() < corrections[0].before.distance());
}

/// Only ratios of weights matter, and small ones switch nothing off.
#[test]
fn weights_have_no_size() {
    let known = known("table-table");
    let model = known.model.as_ref();
    let points = set_points("table-table", "cone", model);
    let with = |weights: [f64; 3]| {
        let correct = Correct::Axes(vec!["X".to_owned(), "Z".to_owned()]);
        corrected(&known, &points, &Settings { correct, weights: Some(weights), ..Settings::default() })
    };
    let (plain, figures) = with([1.0; 3]);
    assert!(figures.tip_after.max < 0.9 * figures.tip_before.max, "{figures:?}");
    for size in [1e-9, 5e-4, 1e6] {
        let (scaled, _) = with([size; 3]);
        let apart = plain.iter().zip(&scaled).map(|(one, other)| (one - other).abs()).fold(0.0, f64::max);
        assert!(apart < 1e-9, "{size}: {apart}");
    }
    // What matters less is corrected as well where nothing stands against it.
    let settings = Settings { weights: Some([1.0, 1.0, 5e-4]), ..Settings::default() };
    let (_, figures) = corrected(&known, &points, &settings);
    assert!(figures.tip_after.max < 1e-9, "{figures:?}");
}

/// Where a linear axis cannot follow, rotary axes do not move the tip away.
#[test]
fn no_tip_gets_worse_where_linear_axes_cannot_follow() {
    let both =
        Settings { correct: Correct::FiveAxes, sensitive_direction: Some([0.0, 0.0, 1.0]), ..Settings::default() };
    assert!(both.check().is_err());
    for machine in ["head-table", "table-table"] {
        let known = known(machine);
        let points = set_points(machine, "rotary", known.model.as_ref());
        let axes = &known.model.info().axes;
        let linear: Vec<_> = axes.iter().filter(|axis| axis.kind == abbe_core::AxisKind::Linear).collect();
        let width = known.model.info().status.len();
        for axis in linear {
            for end in axis.range.expect("a range") {
                let mut statuses = points.statuses().to_vec();
                statuses.chunks_mut(width).for_each(|status| status[axis.status] = end);
                let settings = Settings { correct: Correct::FiveAxes, travel: Travel::Hold, ..Settings::default() };
                let compensator = Compensator::new(known.model.as_ref(), &known.values, &settings).expect("settings");
                let (_, corrections) = compensator.correct(&statuses).expect("corrections");
                for correction in &corrections {
                    let (before, after) = (correction.before.distance(), correction.after.distance());
                    assert!(after <= before + 1e-9, "{machine} {} {end}: {correction:?}", axis.name);
                }
            }
        }
    }
}

/// Slow moves of X beside fast ones of Y: where the correction of X changes by more than X moves, it reverses the moves in one of the
/// two directions, and so it does while X stands.
#[test]
fn reversed_moves_are_counted() {
    let known = known("table-table");
    let (model, info) = (known.model.as_ref(), known.model.info());
    let place = |name: &str| info.axes.iter().find(|axis| axis.name == name).expect("an axis").status;
    let settings = Settings { correct: Correct::FiveAxes, ..Settings::default() };
    let reversed = |step: f64, direction: f64| {
        let mut path = Vec::new();
        for point in 0..200_u32 {
            let mut status = vec![0.0; info.status.len()];
            for (column, value) in info.status.iter().zip(&mut status) {
                if matches!(column.role, abbe_core::StatusRole::Direction(_)) {
                    *value = direction;
                }
            }
            status[place("X")] = -100.0 + direction * step * f64::from(point);
            status[place("Y")] = -100.0 + f64::from(point);
            status[place("A")] = 0.4;
            path.extend(status);
        }
        let compensator = Compensator::new(model, &known.values, &settings).expect("settings");
        let (statuses, _) = compensator.correct(&path).expect("corrections");
        let moves = reversed_moves(model, &known.values, &path, &statuses).expect("moves");
        let of_x = moves.into_iter().find(|moves| info.axes[moves.axis].name == "X");
        of_x.map_or((0, 0, 0.0), |moves| (moves.count, moves.while_standing, moves.reversal))
    };
    // Moves that are longer than any change of a correction stay.
    assert_eq!([reversed(0.5, 1.0), reversed(0.5, -1.0)], [(0, 0, 0.0); 2]);
    let small = [reversed(1e-7, 1.0), reversed(1e-7, -1.0)];
    let standing = [reversed(0.0, 1.0), reversed(0.0, -1.0)];
    let sum = |of: &[(usize, usize, f64); 2]| (of[0].0 + of[1].0, of[0].1 + of[1].1);
    assert!((190..=199).contains(&sum(&small).0) && sum(&small).1 == 0, "{small:?}");
    assert!(sum(&standing).0 == 0 && (190..=199).contains(&sum(&standing).1), "{standing:?}");
    // Half the reversal is what is stated as backlash; positioning is not the only error that has one.
    let along_x = 2.0 * known.values[info.parameter("EXX[b]").expect("a backlash")].abs();
    let reversal = small[0].2.max(small[1].2);
    assert!(reversal > 0.99 * along_x && reversal < 3.0 * along_x, "{small:?} {along_x}");
}

/// One scale with an uncertainty moves the far end of X: its upper limit is that of the normal distribution, or of Student's with the
/// degrees of freedom of the calibration. With the programmed commands the error itself is there, too.
#[test]
fn the_limits_of_what_remains_are_those_of_the_distribution() {
    let uncertainty = 2e-6;
    for (degrees_of_freedom, quantile) in [(None, 1.960), (Some(5.0), 2.571)] {
        let mut stated = calibration("three-axis");
        stated["covariance"] = json!({ "order": ["EXX[1]"], "rows": [[uncertainty * uncertainty]] });
        for one in stated["parameters"].as_array_mut().expect("parameters") {
            if one["name"] == json!("EXX[1]") {
                one["status"] = json!("estimated");
                one["standard_uncertainty"] = json!(uncertainty);
            }
        }
        if let Some(degrees_of_freedom) = degrees_of_freedom {
            stated["uncertainty"] = json!({
                "coverage_probability": 0.95, "scale": 1.0, "correlations": [],
                "joint": { "quantities": 1, "ellipsoid_factor": quantile, "rectangle_factor": quantile },
                "parameters": [{
                    "name": "EXX[1]", "unit": "mm/mm", "standard_uncertainty": uncertainty,
                    "stated_standard_uncertainty": uncertainty, "degrees_of_freedom": degrees_of_freedom,
                    "coverage_factor": quantile, "expanded_uncertainty": quantile * uncertainty, "contributions": [],
                }],
            });
        }
        let machine = law::Machine::of(&stated);
        let info = machine.model.info();
        let x = info.axes.iter().find(|axis| axis.name == "X").expect("an axis");
        let mut far = vec![0.0; info.status.len()];
        far[x.status] = 200.0;
        let settings = Settings::default();
        let compensator = Compensator::new(machine.model.as_ref(), &machine.values, &settings).expect("settings");
        let (commands, _) = compensator.correct(&far).expect("a correction");
        let trials = Trials { number: 20_000, seed: 7, probability: 0.95 };
        let found =
            remaining(machine.model.as_ref(), &machine.calibration, &far, &[&far, &commands], &trials).expect("errors");
        let expected = quantile * uncertainty * 200.0;
        let [before, after] = [found[0].tip_max, found[1].tip_max];
        assert!((after.upper / expected - 1.0).abs() < 0.04, "{after:?} {expected}");
        assert!(after.estimate < 1e-9, "{after:?}");
        let is_normal = degrees_of_freedom.is_none();
        assert!(!is_normal || (after.standard_uncertainty / (uncertainty * 200.0) - 1.0).abs() < 0.03, "{after:?}");
        assert!(before.estimate > 1e-3 && before.upper > before.estimate, "{before:?}");
    }
    for (number, probability) in [(100, 0.95), (10_000, 1.0), (5, 0.5)] {
        assert!(Trials { number, seed: 0, probability }.check().is_err(), "{number} {probability}");
    }
}

/// Weights that are far apart would move an axis by metres for what is left of another direction.
#[test]
fn weights_leave_no_tip_farther_off_than_is_corrected() {
    let place = temporary();
    let at = |name: &str| place.path().join(name);
    let recipe = root().join("pipelines/first-steps.yaml").display().to_string();
    let fitted = abbe(place.path(), &["run", &recipe, "--out", "out"]);
    assert_eq!(fitted.status, 0, "{}", fitted.stderr);
    write(&at("points.csv"), "X_mm,Y_mm,Z_mm,B_deg,C_deg,S_deg\n10,10,10,0,0,0\n20,10,10,0,0,0\n");
    for (weights, is_kept) in [("1,1,1", true), ("1,100,1", true), ("1,1000,1", false), ("1e-308,1e308,1", false)] {
        let out = format!("{weights}.csv");
        let calibration = "out/first-steps/fit.calibration.json";
        let found = abbe(
            place.path(),
            &["compensate", calibration, "points.csv", "--correct", "X,Z", "--weights", weights, "--out", &out],
        );
        assert_eq!((found.status == 0, at(&out).exists()), (is_kept, is_kept), "{weights}: {}", found.stderr);
        assert!(is_kept || found.stderr.contains("corrected, the tip is"), "{weights}: {}", found.stderr);
    }
}

/// The command line: figures, files that replace nothing, and errors that say where.
#[test]
fn the_command_corrects_files() {
    let place = temporary();
    let at = |name: &str| place.path().join(name);
    write(&at("truth.calibration.json"), &calibration("table-table").to_string());
    let cone = folder("table-table").join("setpoints-cone.csv").display().to_string();
    let run = |more: &[&str]| {
        let arguments = [&["compensate", "truth.calibration.json", &cone][..], more].concat();
        abbe(place.path(), &arguments)
    };
    let printed = run(&["--correct", "five-axes", "--out", "corrected.csv", "--report", "report.csv"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    for expected in ["720 set-points", "tip, largest µm            69.85", "Written: corrected.csv"] {
        assert!(printed.stdout.contains(expected), "{expected}: {}", printed.stdout);
    }
    let ours = read(&at("corrected.csv"));
    let (mark, commands) = ours.split_once('\n').expect("lines");
    assert_eq!(mark, "# abbe compensated: calibration truth");
    assert_eq!(commands, read(&folder("table-table").join("compensated-cone.csv")).replace("\r\n", "\n"));
    // What is corrected is not corrected again.
    let again = abbe(place.path(), &["compensate", "truth.calibration.json", "corrected.csv", "--out", "again.csv"]);
    assert_eq!(again.status, 1, "{}", again.stderr);
    assert!(
        again.stderr.contains("these set-points are compensated already") && again.stderr.contains("corrected.csv:1:1"),
        "{}",
        again.stderr
    );
    assert!(!at("again.csv").exists());
    assert_eq!(read(&at("report.csv")).lines().count(), 721);
    let printed = run(&["--json"]);
    let figures: Value = serde_json::from_str(&printed.stdout).expect("JSON");
    assert_eq!(figures["points"], 720);
    assert!((figures["tip_max_um"]["before"].as_f64().expect("a number") - 69.85).abs() < 0.01, "{figures}");
    assert!(figures["largest_corrections"]["X_mm"].as_f64().expect("a number") > 0.03, "{figures}");

    let refused = |more: &[&str], status: i32, words: &str| {
        let printed = run(more);
        assert_eq!(printed.status, status, "{more:?}: {}{}", printed.stdout, printed.stderr);
        let said = printed.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(said.contains(words), "{more:?}: {said}");
    };
    refused(&["--out", "corrected.csv"], 1, "is there already");
    refused(&["--out", "same.csv", "--report", "same.csv"], 2, "the same file");
    refused(&["--max-age-days", "nan"], 2, "a number of days");
    refused(&["--correct", "all"], 2, "`position`, `five-axes`");
    refused(&["--sensitive-direction", "0,0"], 2, "three numbers");
    refused(&["--weights", "1,1,0", "--correct", "X,Z"], 2, "three positive numbers");
    // A heavier component is left with less.
    let left = |weights: &str| -> f64 {
        let printed = run(&["--json", "--correct", "X,Z", "--weights", weights]);
        let figures: Value = serde_json::from_str(&printed.stdout).expect("JSON");
        figures["tip_rms_um"]["after"].as_f64().expect("a number")
    };
    assert!(left("1,1,1") < left("1,100,1"), "{} {}", left("1,1,1"), left("1,100,1"));
    for number in ["0", "-1", "nan", "inf", "1e308"] {
        refused(&["--largest-tip-correction-mm", number], 2, "a number of mm above 0, at most 1000000, was expected");
        refused(
            &["--largest-axis-correction-mrad", number],
            2,
            "a number of mrad above 0, at most 10000, was expected",
        );
    }
    refused(&["--out", "nowhere/new.csv"], 1, "its folder does not exist");
    refused(&["--max-age-days", "30"], 1, "how old the calibration is");
    assert_eq!(read(&at("corrected.csv")), ours);

    // Values that the measurements do not tell, and machines that are others.
    let change = |change: fn(&mut Value), words: &str| {
        let mut changed = calibration("table-table");
        change(&mut changed);
        write(&at("changed.json"), &changed.to_string());
        let printed = abbe(place.path(), &["compensate", "changed.json", &cone, "--out", "no.csv"]);
        let said = printed.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(printed.status != 0 && said.contains(words), "{words}: {}", printed.stderr);
        assert!(!at("no.csv").exists());
    };
    change(
        |it| {
            for one in it["parameters"].as_array_mut().expect("parameters") {
                if one["name"] == json!("EX0C") {
                    one["status"] = json!("confounded");
                }
            }
        },
        "do not determine `EX0C`",
    );
    change(
        |it| it["fit"]["implausible"] = json!([{ "name": "EX0C", "size": 30.0, "plausible": 10.0 }]),
        "no machine has errors like `EX0C`",
    );
    change(|it| it["fit"]["termination"] = json!("iteration-limit"), "did not converge");
    change(
        |it| {
            it["model"]["settings"]["errors"]
                .as_array_mut()
                .expect("lines")
                .push(json!({ "load": ["EAX"], "reference_N": 1000, "degree": 1 }))
        },
        "there is no column `load_N`",
    );
    let printed = {
        write(&at("path.csv"), "X_mm,Y_mm,Z_mm,A_deg,C_deg,B_deg\n0,0,0,0,0,0\n");
        abbe(place.path(), &["compensate", "truth.calibration.json", "path.csv"])
    };
    assert!(printed.stderr.contains("`B_deg` commands an axis"), "{}", printed.stderr);
    write(&at("path.csv"), "X_mm,Y_mm,Z_mm,A_deg\n0,0,0,0\n");
    let printed = abbe(place.path(), &["compensate", "truth.calibration.json", "path.csv"]);
    assert!(printed.status == 2 && printed.stderr.contains("C_deg"), "{}", printed.stderr);
}

/// Measured positions corrected, against poses of the model; a column that is there, and a machine that is another.
#[test]
fn measured_positions_are_corrected() {
    let place = temporary();
    let at = |name: &str| place.path().join(name);
    let mut stated = calibration("table-table");
    let uncertainty: f64 = 1e-6;
    stated["covariance"] = json!({ "order": ["EXX[1]"], "rows": [[uncertainty * uncertainty]] });
    write(&at("truth.calibration.json"), &stated.to_string());
    let machine = law::Machine::of(&stated);
    let text = "# touches\r\nname,X_mm,Y_mm,Z_mm,A_deg,C_deg,dir_X,dir_Y,dir_Z,dir_A,dir_C\r\n\
                one,100,50,-60,0,0,1,1,-1,1,1\r\ntwo,-100,20,-80,10,30,-1,1,1,-1,1\r\n";
    write(&at("points.csv"), text);
    let run =
        |more: &[&str]| abbe(place.path(), &[&["correct", "truth.calibration.json", "points.csv"][..], more].concat());
    let printed = run(&["--out", "corrected.csv", "--without", "EXX[1]", "--without", "EXX[2]", "--json"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let figures: Value = serde_json::from_str(&printed.stdout).expect("JSON");
    let points = SetPoints::read(&at("points.csv"), machine.model.as_ref()).expect("points");
    let (goal, tips) = (machine.tips(points.statuses(), false), machine.tips(points.statuses(), true));
    let written = read(&at("corrected.csv"));
    assert!(written.starts_with("# touches\r\nname,X_mm") && written.lines().count() == 4, "{written}");
    let mut largest = 0_f64;
    for (line, (tip, goal)) in written.lines().skip(2).zip(tips.iter().zip(&goal)) {
        let cells: Vec<f64> = line.split(',').skip(11).map(|cell| cell.parse().expect("a number")).collect();
        assert_eq!(cells.len(), 12);
        for axis in 0..3 {
            assert!((cells[axis] - tip[axis]).abs() < 1e-9, "{line}");
            assert!((cells[3 + axis] - (tip[axis] - goal[axis]) * 1e3).abs() < 2e-6, "{line}");
        }
        // The scale of X moves the tip by X times its uncertainty, wherever that points in the table frame.
        assert!((cells[6] + cells[7] + cells[8] - (100.0 * uncertainty * 1e3).powi(2)).abs() < 1e-6, "{line}");
        largest = largest.max((0..3).map(|axis| (tip[axis] - goal[axis]).powi(2)).sum::<f64>().sqrt() * 1e3);
    }
    let figure = |name: &str| figures[name].as_f64().expect("a figure");
    assert!((figure("correction_max_um") - largest).abs() < 1e-6, "{figures}");
    assert!((figure("largest_standard_uncertainty_um") - 0.1).abs() < 1e-4, "{figures}");
    // Without the scale of X the farther point is off by what it makes there.
    let scale = |name: &str| machine.model.info().parameter(name).map_or(0.0, |index| machine.values[index]);
    let expected = [100.0, -100.0].map(|x: f64| (scale("EXX[1]") * x + scale("EXX[2]") * x * x).abs() * 1e3);
    assert!((figure("without_max_um") - expected[0].max(expected[1])).abs() < 0.01, "{figures} {expected:?}");

    let refused = |arguments: &[&str], words: &str| {
        let printed = run(arguments);
        let said = printed.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(printed.status != 0 && said.contains(words), "{words}: {said}");
    };
    refused(&["--out", "corrected.csv"], "is there already");
    refused(&["--without", "EYZ[9]"], "matches no parameter");
    let other = folder("head-table").join("machine.yaml").display().to_string();
    refused(&["--machine", &other], "calibration of another machine: its axes are");
    let own = read(&folder("table-table").join("machine.yaml"));
    write(&at("own.yaml"), &own);
    assert_eq!(run(&["--machine", "own.yaml"]).status, 0, "{}", run(&["--machine", "own.yaml"]).stderr);
    std::fs::rename(at("corrected.csv"), at("points.csv")).expect("a file");
    refused(&["--out", "again.csv"], "there is a column `corrected_x_mm` already");
    assert!(!at("again.csv").exists());
}

/// A recipe that writes tables, and asks what they leave: without angular errors screw tables correct what lies along their axes.
#[test]
fn a_recipe_tells_what_its_tables_leave() {
    let place = temporary();
    write(&place.path().join("truth.calibration.json"), &calibration("three-axis").to_string());
    let recipe = |validate: &str| {
        let text = format!(
            "abbe: 1\nname: Tables\nstages:\n  truth: {{ estimate: calibration, path: truth.calibration.json }}\n  \
             other: {{ estimate: calibration, path: truth.calibration.json }}\n  \
             screw: {{ export: linuxcnc, of: truth, step_mm: 10 }}\n  \
             errors: {{ export: volumetric, of: truth, grid: {{ points: 2 }} }}\n  \
             after: {{ of: truth, {validate} }}\n"
        );
        write(&place.path().join("tables.yaml"), &text);
        abbe(place.path(), &["run", "tables.yaml"])
    };
    let judged = "validate: compensated, grid: { points: 5, both_directions: true }, exports: screw";
    let printed = recipe(&format!("{judged}, limits: {{ tip_max_um: 70 }}"));
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    let verdicts = json_file(&place.path().join("out/tables/verdicts.json"));
    let figure = |name: &str| {
        let figures = verdicts[0]["figures"].as_array().expect("figures");
        let found = figures.iter().find(|figure| figure["name"] == json!(name));
        found.and_then(|figure| figure["value"].as_f64()).unwrap_or_else(|| panic!("no {name} in {verdicts}"))
    };
    let [before, exact, screw] = ["tip max[before]", "tip max[exact]", "tip max[screw]"].map(figure);
    assert!(exact < 1e-6 && screw > 1.0 && screw < before, "{before} {exact} {screw}");
    let table = read(&place.path().join("out/tables/after/compensated.csv"));
    assert!(table.starts_with("Y_mm,X_mm,Z_mm,before_um,exact_um,screw_um,standard_uncertainty_um\n"), "{table}");
    assert_eq!(table.lines().count(), 1 + 2 * 125);

    // What the control leaves decides, not what could be corrected.
    let printed = recipe(&format!("{judged}, limits: {{ tip_max_um: 0.5 }}"));
    assert_eq!(printed.status, 3, "{}", printed.stderr);
    for (validate, words) in [
        ("validate: compensated, grid: { points: 2 }, exports: errors", "the files of `errors` correct nothing"),
        ("validate: compensated, grid: { points: 2 }, exports: nothing", "`nothing`"),
        ("validate: uncertainty, volumetric: { grid: { points: 2 } }, exports: screw", "judges no exported files"),
        ("validate: compensated, exports: screw", "either `grid` or `path` was expected"),
        ("validate: compensated, grid: { points: 2 }, trials: 10", "at least 200 do"),
        ("validate: compensated, grid: { points: 2 }, limits: { tip_um: 1 }", "there is no figure `tip_um` to limit"),
    ] {
        let printed = recipe(validate);
        let said = printed.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(printed.status != 0 && said.contains(words), "{validate}: {said}");
    }
}
