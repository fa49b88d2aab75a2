//! Bridge CMMs calibrated by lengths (Soons 1993, section 5.2): brute force, checking gauge and fifty D-optimal lengths against the truth of
//! the data, which estimates never see; and another CMM whose lengths come from a forward model of this file.

use std::fmt::Write;
use std::sync::OnceLock;

use abbe_core::{Calibration, Figure, Fit, KinematicModel, Quantity, Status};
use abbe_engine::{Outcome, prepare};
use abbe_estimation::{at_contact, rank_point};
use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde_json::{Value, json};

use crate::support::{Variant, effect, fit, json_file, recipes, registry, root, temporary, values, write};

const RECIPES: [&str; 3] = ["cmm-brute-force", "cmm-checking-gauge", "cmm-fifty-lengths"];

fn truth(data: &str) -> Value {
    json_file(&root().join(format!("tests/truth/cmm-bridge-{data}.json")))
}

fn name(recipe: &str, data: &str) -> String {
    if data == "exact" { format!("{recipe}-exact") } else { recipe.to_owned() }
}

/// A recipe as it stands in the repository, run once for all tests.
fn outcome(recipe: &str, data: &str) -> &'static Outcome {
    static RUNS: [[OnceLock<Outcome>; 2]; 3] = [const { [const { OnceLock::new() }; 2] }; 3];
    let index = RECIPES.iter().position(|known| *known == recipe).expect("a recipe of this file");
    let once = &RUNS[index][usize::from(data == "exact")];
    once.get_or_init(|| Variant::of(&recipes()[&name(recipe, data)]).run())
}

fn figures<'a>(outcome: &'a Outcome, stage: &str) -> &'a [Figure] {
    &outcome.verdicts.iter().find(|verdict| verdict.stage == stage).expect("a verdict").figures
}

/// A figure of the lengths that took no part.
fn unseen(recipe: &str, data: &str, name: &str) -> f64 {
    let figures = figures(outcome(recipe, data), "unseen");
    figures.iter().find(|figure| figure.name == name).and_then(|figure| figure.value).expect("a figure")
}

/// The value that the truth gives an estimated parameter; artefacts carry the name of their stage.
fn of_truth(truth: &Value, name: &str) -> f64 {
    let own = name.strip_prefix("gauge.").unwrap_or(name);
    truth["parameters"][own].as_f64().unwrap_or_else(|| panic!("the truth has no {own}"))
}

/// The largest differences between motion errors of a calibration and those of other values over the travels: mm, rad.
fn largest_errors(fit: &Fit, true_values: &[f64]) -> (f64, f64) {
    let model = fit.problem.model.as_ref();
    let found = fit.problem.starting_from(&fit.calibration).machine_values;
    let (mut length, mut angle) = (0.0_f64, 0.0_f64);
    for function in &model.info().error_functions {
        let [from, to] = model.info().axes[function.axis].range.expect("a range");
        for step in 0..=100 {
            let mut status = vec![0.0; model.info().status.len()];
            status[model.info().axes[function.axis].status] = from + (to - from) * f64::from(step) / 100.0;
            let at = |values: &[f64]| model.motion_error(function, values, &status).expect("within the travel").value;
            let off = (at(&found) - at(true_values)).abs();
            match function.quantity {
                Quantity::Angle => angle = angle.max(off),
                _ => length = length.max(off),
            }
        }
    }
    (length, angle)
}

fn true_values(model: &dyn KinematicModel, truth: &Value) -> Vec<f64> {
    let known = |name: &str| truth["parameters"].get(name).and_then(Value::as_f64);
    model.info().parameters.iter().map(|parameter| known(&parameter.name).unwrap_or(0.0)).collect()
}

#[test]
fn exact_data_give_the_truth_back() {
    for (recipe, unknowns, condition) in [("cmm-brute-force", 73, 1.5e3), ("cmm-checking-gauge", 106, 4.1e3)] {
        let fit = fit(outcome(recipe, "exact"), "fit");
        let found = &fit.calibration.fit;
        assert_eq!((found.unknowns, found.rank), (unknowns, unknowns), "{recipe}");
        assert!((found.condition / condition - 1.0).abs() < 0.02, "{recipe}: condition {}", found.condition);
        let truth = truth("exact");
        let (length, angle) = largest_errors(fit, &true_values(fit.problem.model.as_ref(), &truth));
        assert!(length < 1e-8 && angle < 1e-10, "{recipe}: off by {length} mm, {angle} rad");
        for estimated in values(&fit.calibration).filter(|estimated| estimated.status == Status::Estimated) {
            // Location errors, centres and lengths; coefficients of functions are judged by the errors that they make.
            let (is_angle, _) = effect(&estimated.unit);
            if !estimated.unit.contains('/') {
                let off = (estimated.value - of_truth(&truth, &estimated.name)).abs();
                assert!(off < if is_angle { 1e-10 } else { 1e-8 }, "{recipe}: {} is off by {off}", estimated.name);
            }
        }
        assert!(unseen(recipe, "exact", "max") < 1.1e-6, "{recipe}: {}", unseen(recipe, "exact", "max"));
    }
}

#[test]
fn noisy_data_give_the_truth_back_within_the_stated_uncertainty() {
    let truth = truth("realistic");
    for recipe in ["cmm-brute-force", "cmm-checking-gauge"] {
        let calibration = &fit(outcome(recipe, "realistic"), "fit").calibration;
        let estimated = values(calibration).filter(|estimated| estimated.status == Status::Estimated);
        let errors: Vec<f64> = estimated
            .map(|estimated| {
                let error = (estimated.value - of_truth(&truth, &estimated.name)) / estimated.standard_uncertainty;
                assert!(error.abs() < 4.0, "{recipe}: {} is {error} standard uncertainties off", estimated.name);
                error
            })
            .collect();
        assert_eq!(errors.len(), calibration.fit.unknowns);
        let rms = (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt();
        assert!((0.6..1.4).contains(&rms), "{recipe}: RMS of the normalised errors {rms}");
    }
}

#[test]
fn lengths_that_took_no_part_rank_the_methods() {
    // Figures 5.28 to 5.31: brute force, then the gauge, then fifty lengths.
    let of = |recipe: &str| unseen(recipe, "realistic", "rms");
    let [brute, gauge, fifty] = RECIPES.map(of);
    assert!(brute < 0.65 && gauge < 0.75 && fifty < 1.2, "{brute}, {gauge}, {fifty} um");
    assert!(brute < gauge && gauge < fifty, "{brute}, {gauge}, {fifty} um");
    // What 32 terms cannot hold shows without noise.
    assert!((0.5..1.0).contains(&unseen("cmm-fifty-lengths", "exact", "rms")));
}

#[test]
fn known_lengths_are_judged_where_they_were_recorded() {
    let fit = fit(outcome("cmm-brute-force", "realistic"), "fit");
    let x = fit.problem.start();
    assert_eq!(rank_point(&fit.problem, &x).expect("contact").sets[0].poses(), fit.problem.sets[0].poses());
    // At contact rank and condition are the same: residuals hide no lost direction.
    let judged = fit.estimator.identify(&fit.problem).expect("rank");
    let met = fit.estimator.identify(&at_contact(&fit.problem, &x).expect("contact")).expect("rank");
    assert_ne!(at_contact(&fit.problem, &x).expect("contact").sets[0].poses(), fit.problem.sets[0].poses());
    assert_eq!(judged.rank, met.rank);
    assert!((judged.condition / met.condition - 1.0).abs() < 1e-3);
}

#[test]
fn unseen_observations_need_values_for_what_is_unknown_of_them() {
    let run = |change: &dyn Fn(&mut Variant)| {
        let mut recipe = Variant::of(&recipes()["cmm-checking-gauge"]);
        change(&mut recipe);
        let folder = temporary();
        let outcome = prepare(&recipe.write(folder.path()), &registry())
            .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()));
        outcome.map_or_else(|error| error.to_string(), |_| String::new())
    };
    let gauge = run(&|recipe| {
        recipe.stage("fit")["observations"] = json!(["laser"]);
        recipe.stage("fit")["parameters"] = json!(["EYY[1]"]);
        recipe.stage("residuals")["by"] = json!([]);
        recipe.stage("unseen")["observations"] = json!(["gauge"]);
    });
    assert!(gauge.contains("`gauge.ball[1].x` is unknown, and fit has not estimated it"), "{gauge}");
    let other = run(&|recipe| {
        recipe.0["stages"]["weak"] = json!({ "validate": "compare", "of": "fit", "observations": "other-laser" });
    });
    assert!(other.contains("`compare` judges what its estimates observe; it takes no other observations"), "{other}");
}

#[test]
fn the_fifty_lengths_are_those_that_the_plan_chooses() {
    let expected = json_file(&root().join("tests/truth/cmm-bridge-expected.json"));
    for data in ["exact", "realistic"] {
        let recipe = Variant::of(&recipes()[&name("cmm-fifty-lengths", data)]);
        let folder = temporary();
        let found = prepare(&recipe.write(folder.path()), &registry()).and_then(|prepared| prepared.plan());
        let plan = found.unwrap_or_else(|error| panic!("{error}")).plan;
        assert_eq!((plan.candidates, plan.chosen.len(), plan.figures.of_interest), (3978, 50, 32));
        // Lengths weigh 1 / um; the figure that is compared has derivatives in mm.
        let log_determinant = plan.figures.log_determinant + 2.0 * 32.0 * 1e-3_f64.ln();
        let known = expected["design_50"]["log_det_XtX"].as_f64().expect("a number");
        assert!(log_determinant > known - 0.05, "{data}: {log_determinant}");
        let mut chosen: Vec<String> = plan.chosen.iter().map(|chosen| chosen.label.clone()).collect();
        let kept = |stage: &str, file: &str| -> Vec<String> {
            let kept = recipe.0["stages"][stage]["keep"]["length"].as_array().expect("a list");
            kept.iter().map(|length| format!("{file}:{length}")).collect()
        };
        let mut own = [kept("beams", "lengths-estimation"), kept("more-beams", "lengths-validation")].concat();
        chosen.sort();
        own.sort();
        assert_eq!(chosen, own, "{data}");
    }
}

/// The recipe with the errors that one probe offset cannot tell from others.
fn with_confounded(parameters: Value) -> Variant {
    let mut recipe = Variant::of(&recipes()["cmm-brute-force-exact"]).only(&[]);
    let errors = recipe.stage("cmm")["errors"].as_array_mut().expect("errors");
    errors.push(json!({ "piecewise": ["ECX"], "degree": 2, "continuity": 1, "knots_mm": [137.5, 275, 412.5] }));
    errors.push(
        json!({ "piecewise": ["EAZ", "EBZ", "ECZ"], "degree": 2, "continuity": 1, "knots_mm": [112.5, 225, 337.5] }),
    );
    recipe.0["stages"]["fit"] =
        json!({ "estimate": "gauss-newton", "machine": "cmm", "observations": "laser", "parameters": parameters });
    recipe
}

#[test]
fn what_one_probe_offset_cannot_separate_is_named() {
    let check = |recipe: &Variant| {
        let folder = temporary();
        let checked = prepare(&recipe.write(folder.path()), &registry()).and_then(|prepared| prepared.check());
        checked.unwrap_or_else(|error| panic!("{error}")).remove(0).identifiability
    };
    // With other knots of the scales 4 of 20 terms seem to be determined.
    let all = check(&with_confounded(json!(["E*"])));
    assert_eq!((all.unknowns, all.rank), (93, 77));
    let expected = [
        ("ECX", [("EXX", 25.0), ("EYX", 40.0)]),
        ("EAZ", [("EYZ", 180.0), ("EZZ", -25.0)]),
        ("EBZ", [("EXZ", -180.0), ("EZZ", -40.0)]),
        ("ECZ", [("EXZ", 25.0), ("EYZ", 40.0)]),
    ];
    let kept = json!([
        "E?0?", "EXX*", "EYY*", "EZZ*", "EYX*", "EZX*", "EXY*", "EZY*", "EXZ*", "EYZ*", "EAX*", "EBX*", "E?Y[*"
    ]);
    let held = check(&with_confounded(kept));
    assert_eq!((held.unknowns, held.rank), (73, 73));
    for (found, is_held) in [(&all, false), (&held, true)] {
        assert_eq!(found.equivalent_motion_errors.len(), 4);
        for (same, (error, parts)) in found.equivalent_motion_errors.iter().zip(expected) {
            assert_eq!(same.error, error);
            for (part, (name, size)) in same.combination.iter().zip(parts) {
                assert_eq!((part.name.as_str(), part.unit.as_str()), (name, "mm/rad"));
                assert!((part.coefficient - size).abs() < 1e-9 * size.abs(), "{error}: {part:?}");
            }
            let not_estimated: &[&str] = if is_held { &[error] } else { &[] };
            assert_eq!(same.not_estimated, not_estimated, "{error}");
        }
    }
    let along: Vec<String> =
        all.equivalent_motion_errors.iter().map(|same| same.probe_offsets.iter().collect()).collect();
    assert_eq!(along, ["XY", "YZ", "XZ", "XY"]);
    let said = all.equivalent_motion_errors[0].describe();
    assert!(said.ends_with("; another probe offset, along X or Y of the tool, would tell them apart"), "{said}");
    // A direction that is lost is told what finds it, and a tip elsewhere on the same probe does.
    let yaw = all.null_space.iter().filter(|lost| lost.combination.iter().any(|part| part.name.starts_with("ECX[")));
    let advice: Vec<&String> = yaw.flat_map(|lost| &lost.separated_by).collect();
    assert!(advice.iter().any(|advice| advice.contains("another probe offset")), "{advice:?}");
    assert!(all.equivalent_motion_errors[0].describe().starts_with(
        "1 µrad of ECX moves the tip as 0.025 µm of EXX and 0.04 µm of EYX do at every recorded pose: only the functions"
    ));
    // It is told of the fit, too, and nothing is where these errors do not exist.
    let of_fit = &fit(outcome("cmm-brute-force", "exact"), "fit").calibration.fit;
    assert!(of_fit.equivalent_motion_errors.is_empty());
    let [scale, yaw] = [json!(["EXX*"]), json!(["EXX[1]", "EC0X", "ECX[2]"])]
        .map(|parameters| with_confounded(parameters).run().fits.remove(0).calibration.fit.equivalent_motion_errors);
    assert_eq!(scale.iter().map(|same| same.error.as_str()).collect::<Vec<_>>(), ["ECX"]);
    assert_eq!(scale[0].not_estimated, ["ECX", "EYX"]);
    assert_eq!(yaw[0].not_estimated, ["EYX"]);
}

/// Another CMM: the table moves along Y, bridge and quill along X and Z.
const CHAIN: &str = "w Y' b X Z t";
const TRAVELS: [(&str, [f64; 2]); 3] = [("X", [-200.0, 250.0]), ("Y", [0.0, 380.0]), ("Z", [-300.0, -20.0])];
const TIP: [f64; 3] = [-60.0, 35.0, -120.0];

/// Its true errors; straightness is a parabola without its line.
const TRUTH: [(&str, f64); 22] = [
    ("EC0X", 2.1e-5),
    ("EA0Z", -1.3e-5),
    ("EB0Z", 8.0e-6),
    ("EXX[1]", 2.3e-5),
    ("EXX[2]", -4.1e-8),
    ("EXX[pp1,2]", 9.0e-8),
    ("EYY[1]", -1.7e-5),
    ("EYY[2]", 3.2e-8),
    ("EZZ[1]", 1.2e-5),
    ("EAX[1]", 3.1e-8),
    ("EBX[1]", -2.2e-8),
    ("EBX[2]", 6.0e-11),
    ("EAY[1]", 1.9e-8),
    ("EAY[2]", -4.0e-11),
    ("EBY[1]", 4.4e-8),
    ("ECY[1]", -3.3e-8),
    ("EYX[2]", 2.7e-8),
    ("EZX[2]", -3.6e-8),
    ("EXY[2]", 1.8e-8),
    ("EZY[2]", 2.9e-8),
    ("EXZ[2]", -4.5e-8),
    ("EYZ[2]", 3.8e-8),
];
const KNOT: f64 = 40.0;

/// True coefficients of expansion of the scales of X and Y and of what is measured, 1/K.
const EXPANSION: [f64; 3] = [9.7e-6, 12.4e-6, 1.2e-6];

fn other_errors(expansion: [f64; 2]) -> Value {
    json!([
        { "location": ["EC0X", "EA0Z", "EB0Z"] },
        { "piecewise": ["EXX"], "degree": 2, "continuity": 1, "knots_mm": [KNOT] },
        { "polynomial": ["EYY", "EBX", "EAY"], "degrees": [1, 2] },
        { "polynomial": ["EZZ", "EAX", "EBY", "ECY"], "degrees": [1] },
        { "polynomial": ["EYX", "EZX", "EXY", "EZY", "EXZ", "EYZ"], "degrees": [2], "without_line": true },
        { "expansion": ["EXX"], "temperature": "T_X", "coefficient_per_K": expansion[0] },
        { "expansion": ["EYY"], "temperature": "T_Y", "coefficient_per_K": expansion[1], "reference_degC": 20 },
    ])
}

/// A motion error of the other CMM: `kind` is its direction (`X`) or axis of rotation (`A`).
fn error(kind: &str, axis: usize, q: f64, temperatures: [f64; 2]) -> f64 {
    let (name, [from, to]) = TRAVELS[axis];
    let symbol = format!("E{kind}{name}");
    let of =
        |term: &str| TRUTH.iter().find(|(known, _)| *known == format!("{symbol}[{term}]")).map_or(0.0, |known| known.1);
    let is_straightness = "XYZ".contains(kind) && kind != name;
    // The least squares line of a parabola over its travel.
    let line = (from + to) * q - (from * from + to * to + 4.0 * from * to) / 6.0;
    let parabola = q * q - if is_straightness { line } else { 0.0 };
    let mut sum = of("1") * q + of("2") * parabola + of("pp1,2") * (q - KNOT).max(0.0).powi(2);
    if kind == name && axis < 2 {
        // The table goes backwards: its body is short where the scale is long.
        let sense = if name == "Y" { -1.0 } else { 1.0 };
        sum += sense * EXPANSION[axis] * (temperatures[axis] - 20.0) * q;
    }
    sum
}

/// The motion of an axis with its errors.
fn moved(axis: usize, q: f64, sense: f64, location: [f64; 3], temperatures: [f64; 2]) -> Isometry3<f64> {
    let turned = |[a, b, c]: [f64; 3]| {
        let about = |axis: Vector3<f64>, angle| Rotation3::new(axis * angle);
        UnitQuaternion::from_rotation_matrix(
            &(about(Vector3::z(), c) * about(Vector3::y(), b) * about(Vector3::x(), a)),
        )
    };
    let of = |kinds: [&str; 3]| kinds.map(|kind| error(kind, axis, q, temperatures));
    let mut along = Vector3::zeros();
    along[axis] = sense * q;
    let [x, y, z] = of(["X", "Y", "Z"]);
    Isometry3::from_parts(Translation3::identity(), turned(location))
        * Isometry3::from_parts(along.into(), UnitQuaternion::identity())
        * Isometry3::from_parts(Translation3::new(x, y, z), turned(of(["A", "B", "C"])))
}

/// The tip as the table of the other CMM sees it.
fn tip([x, y, z]: [f64; 3], temperatures: [f64; 2]) -> Vector3<f64> {
    let of = |name: &str| TRUTH.iter().find(|(known, _)| *known == name).map_or(0.0, |known| known.1);
    let tool = moved(0, x, 1.0, [0.0, 0.0, of("EC0X")], temperatures)
        * moved(2, z, 1.0, [of("EA0Z"), of("EB0Z"), 0.0], temperatures);
    let table = moved(1, y, -1.0, [0.0; 3], temperatures);
    (table.inverse() * tool * nalgebra::Point3::from(Vector3::from(TIP))).coords
}

/// Lengths all over its workspace at changing temperatures, and a fit of these parameters.
fn other_cmm(expansion: [f64; 2], parameters: Value, further: Option<Value>) -> Outcome {
    let folder = temporary();
    let mut state = 12345_u64;
    let mut random = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut rows = "X1_mm,Y1_mm,Z1_mm,X2_mm,Y2_mm,Z2_mm,T_X_degC,T_Y_degC,T_degC,reference_mm\n".to_owned();
    while rows.lines().count() <= 400 {
        let [one, other] =
            [(); 2].map(|()| TRAVELS.map(|(_, [from, to])| ((from + (to - from) * random()) * 1e3).round() / 1e3));
        let [one, other] = [one, other].map(|point: [f64; 3]| {
            let inside = |index: usize| point[index].clamp(TRAVELS[index].1[0], TRAVELS[index].1[1]);
            [inside(0), inside(1), inside(2)]
        });
        let [of_x, of_y, of_length] = [(); 3].map(|()| 17.0 + (random() * 800.0).round() / 100.0);
        let length = (tip(other, [of_x, of_y]) - tip(one, [of_x, of_y])).norm();
        if length > 80.0 {
            let reference = length / (1.0 + EXPANSION[2] * (of_length - 20.0));
            let cells = [one.as_slice(), &other, &[of_x, of_y, of_length, reference]].concat();
            let cells: Vec<String> = cells.iter().map(|cell| format!("{cell:.12}")).collect();
            writeln!(rows, "{}", cells.join(",")).expect("text");
        }
    }
    write(&folder.path().join("lengths.csv"), &rows);
    let mut errors = other_errors(expansion);
    errors.as_array_mut().expect("a list").extend(further);
    let axes: serde_json::Map<String, Value> =
        TRAVELS.iter().map(|(name, range)| ((*name).to_owned(), json!({ "range_mm": range }))).collect();
    let stages = json!({
        "runs": { "ingest": "csv", "path": "lengths.csv" },
        "laser": { "artefact": "length", "from": "runs", "standard_uncertainty_um": 0.5,
                   "expansion": { "coefficient_per_K": EXPANSION[2] } },
        "cmm": { "model": "serial-chain", "chain": CHAIN, "tool_length_mm": -TIP[2], "stylus_radius_mm": 0,
                 "probe_offset_mm": [TIP[0], TIP[1], 0], "axes": axes, "errors": errors },
        "fit": { "estimate": "gauss-newton", "machine": "cmm", "observations": "laser", "parameters": parameters },
    });
    let recipe = Variant(json!({ "abbe": 1, "name": "Moving table", "stages": stages }));
    let outcome = prepare(&recipe.write(folder.path()), &registry())
        .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()));
    outcome.unwrap_or_else(|error| panic!("{error}"))
}

fn is_true(calibration: &Calibration) {
    for (name, value) in TRUTH {
        let found = calibration.get(name).unwrap_or_else(|| panic!("no {name}"));
        let (is_angle, factor) = effect(&found.unit);
        let off = (found.value - value).abs() * factor;
        assert!(off < if is_angle { 1e-10 } else { 1e-8 }, "{name} is off by {off}");
    }
}

#[test]
fn another_cmm_comes_back_with_the_expansion_of_its_scales() {
    // Held at its nominal value, and estimated from a wrong one.
    let held = other_cmm([EXPANSION[0], EXPANSION[1]], json!(["E?0?", "E??[?]", "E??[pp*"]), None);
    let calibration = &fit(&held, "fit").calibration;
    is_true(calibration);
    assert_eq!(calibration.fit.unknowns, TRUTH.len());
    let known = calibration.get("EXX[expansion]").expect("a parameter");
    assert_eq!((known.value, known.status, known.unit.as_str()), (EXPANSION[0], Status::Fixed, "1/K"));

    let found = other_cmm([11.5e-6, 0.0], json!(["E*"]), None);
    let calibration = &fit(&found, "fit").calibration;
    is_true(calibration);
    assert_eq!((calibration.fit.unknowns, calibration.fit.rank), (24, 24));
    for (name, value) in [("EXX[expansion]", EXPANSION[0]), ("EYY[expansion]", EXPANSION[1])] {
        let found = calibration.get(name).expect("a parameter");
        assert!((found.value - value).abs() < 1e-11, "{name}: {}", found.value);
    }
}

#[test]
fn another_offset_makes_other_errors_alike() {
    let yaw = json!({ "legendre": ["ECX"], "degrees": [1, 2] });
    let outcome = other_cmm([EXPANSION[0], EXPANSION[1]], json!(["E?0?", "E??[?]", "E??[pp*"]), Some(yaw));
    let same = &fit(&outcome, "fit").calibration.fit.equivalent_motion_errors;
    let [same] = same.as_slice() else { panic!("{same:?}") };
    assert_eq!((same.error.as_str(), same.not_estimated.as_slice()), ("ECX", ["ECX".to_owned()].as_slice()));
    for (part, (name, size)) in same.combination.iter().zip([("EXX", -TIP[1]), ("EYX", TIP[0])]) {
        assert_eq!(part.name, name);
        assert!((part.coefficient - size).abs() < 1e-9 * size.abs(), "{part:?}");
    }
}
