//! Direct measurements and the hole plate of a five-axis mill against the values that their data were simulated with; another machine that
//! measures itself by a small model of its own.

use std::fmt::Write as _;
use std::path::Path;

use abbe_core::{Calibration, KinematicModel, Status, in_parallel};
use abbe_engine::{Outcome, prepare};
use abbe_estimation::Judgement;
use serde_json::{Value, json};

use crate::support::{Variant, fit, json_file, read, recipes, registry, root, temporary, write};

fn truth(name: &str) -> Value {
    json_file(&root().join(format!("tests/truth/mill-5axis-{name}.json")))
}

fn run(recipe: &str) -> Outcome {
    Variant::of(&recipes()[recipe]).run()
}

/// What the truth says of a parameter; what it does not list is zero.
fn true_value(truth: &Value, name: &str) -> f64 {
    truth["parameters"][name].as_f64().unwrap_or(0.0)
}

/// Knots of the mill stand every 50 mm.
fn polynomial(truth: &Value, symbol: &str, q: f64) -> f64 {
    let parameters = truth["parameters"].as_object().expect("parameters");
    let terms = parameters.iter().filter_map(|(name, value)| {
        let bracket = name.strip_prefix(symbol)?.strip_prefix('[')?.strip_suffix(']')?;
        let function = match bracket.strip_prefix("pp").and_then(|knot| knot.strip_suffix(",2")) {
            Some(knot) => (q - 50.0 * knot.parse::<f64>().ok()?).max(0.0).powi(2),
            None => q.powi(bracket.parse().ok()?),
        };
        Some(value.as_f64()? * function)
    });
    terms.sum()
}

/// The periodic error as the README of the data writes it.
fn periodic(truth: &Value, q: f64) -> f64 {
    let value = |name: &str| truth["parameters"][format!("EXX[per0.635{name}")].as_f64().expect("a value");
    let w = (q / value("].wavelength")).rem_euclid(1.0);
    let function = |k: f64| {
        let bend = 1.0 - k / 4.0;
        (w - k / 4.0).max(0.0).powi(2) - (bend * bend - bend) * w - bend * w * w
    };
    (1..=3).map(|k| value(&format!(":{k}]")) * function(f64::from(k))).sum()
}

/// Largest difference of all error curves from the true ones over the travels, um or urad.
fn off_curves(
    model: &dyn KinematicModel,
    calibration: &Calibration,
    truth: &Value,
    known: impl Fn(&str) -> bool,
) -> f64 {
    let values: Vec<f64> = calibration.parameters.iter().map(|parameter| parameter.value).collect();
    let mut largest: f64 = 0.0;
    let mut compared = 0;
    for function in model.info().error_functions.iter().filter(|function| known(&function.symbol)) {
        let axis = &model.info().axes[function.axis];
        let [from, to] = axis.range.expect("a range");
        let is_angle = function.component > 2;
        for step in 0..=300 {
            let q = from + (to - from) * f64::from(step) / 300.0;
            let mut status = vec![0.0; model.info().status.len()];
            status[axis.status] = q;
            let found = model.motion_error(function, &values, &status).expect("within the range").value;
            let mut expected = polynomial(truth, &function.symbol, q);
            if function.symbol == "EXX" {
                expected += periodic(truth, q);
            }
            largest = largest.max((found - expected).abs() * if is_angle { 1e6 } else { 1e3 });
        }
        compared += 1;
    }
    assert!(compared > 5, "{compared} curves");
    largest
}

#[test]
fn exact_direct_measurements_give_every_curve_back() {
    let (outcome, truth) = (run("mill-direct-exact"), truth("exact"));
    let curves = |name: &str, known: &dyn Fn(&str) -> bool| {
        let fit = fit(&outcome, name);
        off_curves(fit.problem.model.as_ref(), &fit.calibration, &truth, known)
    };
    assert!(curves("fit-angles", &|symbol| symbol.contains(['A', 'B', 'C']) && symbol != "EBY") < 1e-6);
    assert!(curves("fit-lengths", &|_| true) < 1e-6);
    assert!(curves("fit", &|_| true) < 1e-6);
    for name in ["fit-angles", "fit-lengths", "fit"] {
        let calibration = &fit(&outcome, name).calibration;
        for name in truth["estimated"].as_array().expect("names").iter().filter_map(Value::as_str) {
            let found = calibration.get(name).unwrap_or_else(|| panic!("no {name}"));
            if found.status != Status::Estimated {
                continue;
            }
            let (over, under) = found.unit.split_once('/').unwrap_or((&found.unit, ""));
            let power = under
                .split_once('^')
                .map_or(i32::from(!under.is_empty()), |(_, power)| power.parse().expect("a power"));
            let scale = 400_f64.powi(power) * if over == "rad" { 1e6 } else { 1e3 };
            let off = (found.value - true_value(&truth, name)).abs() * scale;
            assert!(off < 1e-6, "{name} is off by {off:e}");
        }
    }
    let report = &fit(&outcome, "fit").calibration.fit;
    assert_eq!((report.observations, report.unknowns, report.rank), (19_668, 550, 550));
    // Of nuisances the straightedges' slopes, the blocks' angles and the drifts are told.
    let calibration = &fit(&outcome, "fit").calibration;
    let nuisance = &truth["nuisance"];
    let value = |name: String| calibration.get(&name).unwrap_or_else(|| panic!("no {name}")).value;
    for (name, slope) in nuisance["slope"].as_object().expect("slopes") {
        let own = if name == "EZY" { name.clone() } else { format!("direct-{name}") };
        assert!((value(format!("lengths.{own}.slope")) - slope.as_f64().expect("a slope")).abs() < 1e-12, "{name}");
    }
    for (name, angle) in nuisance["block_angle"].as_object().expect("angles") {
        assert!(
            (value(format!("squares.direct-{name}.angle")) - angle.as_f64().expect("an angle")).abs() < 1e-12,
            "{name}"
        );
    }
    let drifts = nuisance["drift_per_s"]["EYY"].as_array().expect("drifts");
    for (run, drift) in drifts.iter().enumerate() {
        assert!(
            (value(format!("lengths.direct-EYY[{}].drift", run + 1)) - drift.as_f64().expect("a drift")).abs() < 1e-12
        );
    }
}

#[test]
fn realistic_direct_measurements_hold_the_truth_within_their_uncertainty() {
    let (outcome, truth) = (run("mill-direct"), truth("realistic"));
    for name in ["fit-angles", "fit-lengths", "fit"] {
        let calibration = &fit(&outcome, name).calibration;
        let mut count = 0;
        for found in calibration.parameters.iter().filter(|found| found.status == Status::Estimated) {
            let off = (found.value - true_value(&truth, &found.name)).abs() / found.standard_uncertainty;
            assert!(off < 4.0, "{name}: {} is off by {off} standard uncertainties", found.name);
            count += 1;
        }
        assert!(count > 100, "{count}");
        assert!((calibration.fit.sigma - 1.0).abs() < 0.05, "{name}: {}", calibration.fit.sigma);
    }
    let wavelength = fit(&outcome, "fit").calibration.get("EXX[per0.635].wavelength").expect("a wavelength").value;
    assert!((wavelength - 0.635_025).abs() < 1e-5, "{wavelength}");
}

/// Gives every reading under a value the standard uncertainty 1 um or 1 urad.
fn equally_weighted(value: &mut Value) {
    match value {
        Value::Object(map) => map.iter_mut().for_each(|(key, value)| match key.starts_with("standard_uncertainty_") {
            true => *value = json!(1.0),
            false => equally_weighted(value),
        }),
        Value::Array(list) => list.iter_mut().for_each(equally_weighted),
        _ => {}
    }
}

/// The README of the data counts 546 unknowns, 254 of them the machine's, and gives the condition 2.7e4: rows of equal weight, in um and
/// urad, and a load that bends the guideway of X at nine knots. (The recipe offers all thirteen.)
#[test]
fn rank_and_condition_are_those_of_the_data() {
    let mut variant = Variant::of(&recipes()["mill-direct-exact"]).only(&["fit"]);
    equally_weighted(&mut variant.0);
    let errors = variant.stage("mill")["errors"].as_array_mut().expect("errors");
    let load = errors.iter_mut().find(|line| line["load"] == json!(["EAX"])).expect("a load");
    load["knots_mm"] = json!({ "from": 150, "to": 550, "step": 50 });
    let outcome = variant.run();
    let fit = fit(&outcome, "fit");
    let report = &fit.calibration.fit;
    assert_eq!((report.observations, report.unknowns, report.rank), (19_668, 546, 546));
    assert_eq!(fit.calibration.parameters.iter().filter(|known| known.status == Status::Estimated).count(), 254);
    assert!((report.condition / 2.7e4 - 1.0).abs() < 0.02, "{}", report.condition);
}

/// Steps of 10 mm show the pitch as a wave of 40 mm; from the nominal pitch the right one is found, and the user is told.
#[test]
fn stepwise_selection_keeps_the_knots_that_the_machine_has() {
    let selected = |recipe: &str, truth: &Value| {
        let mut variant = Variant::of(&recipes()[recipe]).only(&["fit"]);
        variant.stage("fit")["select"] = json!({ "candidates": ["E*[pp*", "E*[load:pp*"], "direction": "both" });
        let outcome = variant.run();
        let calibration = &fit(&outcome, "fit").calibration;
        let selection = calibration.fit.selection.clone().expect("a selection");
        let bends = |name: &String| true_value(truth, name) != 0.0;
        let (right, left_out): (Vec<_>, Vec<_>) = (
            selection.kept.iter().filter(|name| bends(name)).collect(),
            selection.left_out.iter().filter(|name| bends(name)).collect(),
        );
        (right.len(), left_out.len(), selection.kept.len() - right.len(), selection.left_out.len() - left_out.len())
    };
    // 48 of 211 knots bend a curve.
    let (right, missed, surplus, dropped) = selected("mill-direct-exact", &truth("exact"));
    assert_eq!((right, missed), (48, 0));
    assert!(surplus <= 12 && dropped + surplus == 163, "{surplus} kept too many");
    // With noise the weakest of them pass for one beside them.
    let (right, missed, surplus, dropped) = selected("mill-direct", &truth("realistic"));
    assert!(right >= 36 && missed <= 12, "{right} of 48");
    assert!(surplus <= missed && dropped >= 151, "{surplus} kept too many");
}

#[test]
fn a_wavelength_is_found_however_far_the_nominal_one_is_off() {
    // Half a per cent: over the travel that is several waves, each with a minimum of its own.
    for nominal in [0.612, 0.6318, 0.6365, 0.655] {
        let mut variant = Variant::of(&recipes()["mill-direct"]).only(&["fit-angles", "fit-lengths"]);
        let text = serde_json::to_string(&variant.0).expect("JSON");
        let text = text.replace("\"wavelength_mm\":0.635", &format!("\"wavelength_mm\":{nominal}"));
        variant.0 = serde_json::from_str(&text.replace("per0.635", &format!("per{nominal}"))).expect("JSON");
        let outcome = variant.run();
        let name = format!("EXX[per{nominal}].wavelength");
        let found = fit(&outcome, "fit-lengths").calibration.get(&name).expect("a wavelength").clone();
        assert!((found.value - 0.635_025).abs() < 5.0 * found.standard_uncertainty, "{nominal}: {found:?}");
    }
}

#[test]
fn ten_millimetre_steps_find_the_pitch_and_not_its_alias() {
    for name in ["exact", "realistic"] {
        let recipe = if name == "exact" { "mill-direct-exact" } else { "mill-direct" };
        let mut variant = Variant::of(&recipes()[recipe]).only(&["fit-lengths"]);
        let file = variant.0["stages"]["length-files"]["path"][0].clone();
        assert!(file.as_str().is_some_and(|file| file.ends_with("direct-EXX.csv")), "{file}");
        variant.stage("length-files")["path"] = file;
        let all = variant.stage("lengths")["measurements"]["direct-EXX"].clone();
        variant.stage("lengths")["measurements"] = json!({ "direct-EXX": all });
        let stage = variant.stage("fit-lengths").as_object_mut().expect("settings");
        stage.remove("known");
        stage.insert("observations".to_owned(), json!(["lengths"]));
        stage.insert("parameters".to_owned(), json!(["EXX[*]", "EXX[per0.635].wavelength", "lengths.*"]));
        let folder = temporary();
        let prepared = prepare(&variant.write(folder.path()), &registry()).unwrap_or_else(|error| panic!("{error}"));
        let planned = prepared.check().unwrap_or_else(|error| panic!("{error}"));
        let remarks = planned[0].identifiability.remarks.join(" ");
        assert!(remarks.contains("EXX has a period of 0.635 mm") && remarks.contains("a wave of 39.6"), "{remarks}");
        let outcome = prepared.run(&abbe_core::Monitor::default()).unwrap_or_else(|error| panic!("{error}"));
        let found =
            fit(&outcome, "fit-lengths").calibration.get("EXX[per0.635].wavelength").expect("a wavelength").value;
        assert!((found - 0.635_025).abs() < 1e-5, "{name}: {found}");
    }
    let fine = prepare(&recipes()["mill-direct"], &registry()).and_then(|prepared| prepared.check());
    let planned = fine.unwrap_or_else(|error| panic!("{error}"));
    assert!(planned.iter().all(|planned| planned.identifiability.remarks.is_empty()), "0.01 mm steps are fine enough");
}

#[test]
fn the_hole_plate_agrees_with_the_model_until_a_squareness_changes() {
    for (recipe, after, worn) in [("mill-hole-plate-exact", 1e-5, 1e-3), ("mill-hole-plate", 1.0, 1.0)] {
        let outcome = run(recipe);
        let report = |name: &str| &fit(&outcome, name).calibration.fit;
        let before = report("before").residual_max_um;
        assert!((90.0..120.0).contains(&before), "{recipe}: {before}");
        for name in ["after", "loaded", "refit"] {
            let (max, rms) = (report(name).residual_max_um, report(name).residual_rms_um);
            assert!(rms < after && (after == 1.0 || max < after), "{recipe} {name}: rms {rms}, max {max}");
        }
        let (with, without) = (report("after").residual_rms_um, report("apart").residual_rms_um);
        assert!(without > with && (without * without - with * with).sqrt() > 0.05, "{recipe}: {with} {without}");
        assert!(report("worn").residual_rms_um > 1.5 * with, "{recipe}: {}", report("worn").residual_rms_um);
        let verdict = outcome.verdicts.iter().find(|verdict| verdict.stage == "wear").expect("a verdict");
        let named =
            |of: &str| verdict.remarks.iter().find(|remark| remark.starts_with(&format!("{of}: "))).expect("a remark");
        assert!(named("worn").contains("EA0Z, the squareness of Z, changed by"), "{}", named("worn"));
        assert!(named("refit").contains("no single error") || recipe == "mill-hole-plate", "{}", named("refit"));
        let value = |name: &str| fit(&outcome, name).calibration.get("EA0Z").expect("a squareness").value;
        let change = (value("refit") - value("worn")) * 1e6;
        assert!((change - 30.0).abs() < worn, "{recipe}: {change}");
    }
}

/// What the calibrated machine predicts without its cross-coupling is off by what EAY changes along X. (The recipes estimate
/// everything anew without it, where the other terms take up most.)
#[test]
fn the_hole_plate_shows_the_cross_coupling() {
    for (recipe, largest, rms) in [("mill-hole-plate-exact", 1.0, 0.4), ("mill-hole-plate", 2.5, 0.8)] {
        let mut variant = Variant::of(&recipes()[recipe]).only(&["fit-angles", "fit", "after", "apart"]);
        let mut apart = variant.stage("mill").clone();
        apart["errors"].as_array_mut().expect("errors").retain(|line| line.get("product").is_none());
        variant.0["stages"]["mill-apart"] = apart;
        let variant = variant.set("apart", "machine", json!("mill-apart")).set("apart", "known", json!("fit"));
        let outcome = variant.run();
        let report = |name: &str| &fit(&outcome, name).calibration.fit;
        let (with, without) = (report("after"), report("apart"));
        assert!(without.residual_max_um > largest && without.residual_rms_um > rms, "{recipe}: {without:?}");
        assert!(without.residual_rms_um > 1.2 * with.residual_rms_um, "{recipe}: {with:?} {without:?}");
    }
}

#[test]
fn forgotten_zeros_of_instruments_are_told() {
    let remarks = |parameters: Value| {
        let folder = temporary();
        let recipe = Variant::of(&recipes()["mill-direct-exact"]).only(&["fit"]).set("fit", "parameters", parameters);
        let checked = prepare(&recipe.write(folder.path()), &registry()).and_then(|prepared| prepared.check());
        checked.unwrap_or_else(|error| panic!("{error}")).remove(0).identifiability.remarks
    };
    let all = json!(["@angles", "@lengths", "lengths.*", "squares.*", "angles.*", "loads.*", "table.*"]);
    assert_eq!(remarks(all), Vec::<String>::new());
    let told = remarks(json!(["@angles", "@lengths", "lengths.*", "squares.*", "angles.*", "loads.*"])).join(" ");
    assert!(told.starts_with("table.direct-EA0B-load[1.208].datum") && told.contains(" count as zero"), "{told}");
}

type Frame = [[f64; 4]; 4];

fn times(a: &Frame, b: &Frame) -> Frame {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

fn shift(x: f64, y: f64, z: f64) -> Frame {
    [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]]
}

fn turn(axis: usize, angle: f64) -> Frame {
    let mut frame = shift(0.0, 0.0, 0.0);
    let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
    (frame[i][i], frame[i][j], frame[j][i], frame[j][j]) = (angle.cos(), -angle.sin(), angle.sin(), angle.cos());
    frame
}

/// Translation, then turns about z, y, x.
fn error([x, y, z, a, b, c]: [f64; 6]) -> Frame {
    [turn(2, c), turn(1, b), turn(0, a)].iter().fold(shift(x, y, z), |frame, turn| times(&frame, turn))
}

/// A machine `w V' b Z X t`, V along y, with the errors below.
struct Other;

impl Other {
    const TRUTH: [(&'static str, f64); 9] = [
        ("EXX[1]", 4e-5),
        ("EXX[2]", -3e-8),
        ("EZX[2]", 1.5e-7),
        ("EBX[1]", 2e-7),
        ("EYV[1]", -7e-5),
        ("EYV[b]", 0.0012),
        ("EAV[1]", 1.5e-7),
        ("EBX[2]", 4e-10),
        ("EC0X", 6e-5),
    ];

    fn value(name: &str) -> f64 {
        Self::TRUTH.iter().find(|(other, _)| *other == name).expect("an error").1
    }

    /// Tip in the table frame.
    fn tip(x: f64, v: f64, z: f64, direction: f64, point: [f64; 3], wrong: bool) -> [f64; 3] {
        let on = if wrong { 1.0 } else { 0.0 };
        let of = |name: &str| on * Self::value(name);
        // X travels from -100 to 300 mm: x^2 without its least squares line there.
        let across = (x - 100.0).powi(2) - 200.0_f64.powi(2) / 3.0;
        let table = times(
            &shift(0.0, -v, 0.0),
            &error([0.0, of("EYV[1]") * v + of("EYV[b]") * direction, 0.0, of("EAV[1]") * v, 0.0, 0.0]),
        );
        let along = of("EXX[1]") * x + of("EXX[2]") * x * x;
        let pitch = of("EBX[1]") * x + of("EBX[2]") * x * x;
        let carriage = [
            error([0.0, 0.0, 0.0, 0.0, 0.0, of("EC0X")]),
            shift(x, 0.0, 0.0),
            error([along, 0.0, of("EZX[2]") * across, 0.0, pitch, 0.0]),
            shift(point[0], point[1], point[2]),
        ];
        let tool = carriage.iter().fold(shift(0.0, 0.0, z), |frame, next| times(&frame, next));
        let between: [f64; 3] = std::array::from_fn(|i| tool[i][3] - table[i][3]);
        std::array::from_fn(|i| (0..3).map(|k| table[k][i] * between[k]).sum())
    }
}

const TOOL: [f64; 3] = [0.0, 0.0, -120.0];
const OPTICS: [f64; 3] = [25.0, -15.0, -90.0];

/// Files of that machine, two runs up and down each.
fn measure(folder: &Path) {
    let grid = |from: f64, step: f64| (0..17).map(move |index| from + step * f64::from(index));
    let there_and_back = |from: f64, step: f64| {
        let there = grid(from, step).map(|q| (q, 1.0));
        there.chain(grid(from, step).rev().map(|q| (q, -1.0)))
    };
    let lengths = [
        ("along-x", 0, OPTICS, -100.0, 25.0, 1.0, 0, 0.0),
        ("across-x", 0, TOOL, -100.0, 25.0, 1.0, 2, 3e-5),
        ("along-v", 1, OPTICS, 0.0, 20.0, -1.0, 1, 0.0),
    ];
    for (name, moves, point, from, step, sign, read, slope) in lengths {
        let mut text = "run,direction,position_mm,time_s,reading_um\n".to_owned();
        for run in [1.0, 2.0] {
            let mut time = 0.0;
            for (q, direction) in there_and_back(from, step) {
                let at = |wrong| match moves {
                    0 => Other::tip(q, 70.0, -40.0, 0.0, point, wrong),
                    _ => Other::tip(110.0, q, -40.0, direction, point, wrong),
                };
                let moved = at(true)[read] - at(false)[read];
                let reading = sign * moved - sign * slope * q + 0.003 * run - 2e-6 * run * time;
                writeln!(text, "{run},{direction},{q},{time},{:.10}", reading * 1e3).expect("text");
                time += 7.0;
            }
        }
        write(&folder.join(format!("{name}.csv")), &text);
    }
    for (name, moves) in [("pitch-x", 0), ("pitch-v", 1)] {
        let mut text = "run,position_mm,time_s,reading_urad\n".to_owned();
        for run in [1.0, 2.0] {
            for (index, (q, _)) in there_and_back(if moves == 0 { -100.0 } else { 0.0 }, 20.0).enumerate() {
                // Table side minus tool side on V, tool side minus table side on X.
                let pitch = match moves {
                    0 => Other::value("EBX[1]") * q + Other::value("EBX[2]") * q * q,
                    _ => Other::value("EAV[1]") * q,
                };
                let time = 5.0 * index as f64;
                writeln!(text, "{run},{q},{time},{:.10}", (pitch + 1e-5 * run - 1e-9 * time) * 1e6).expect("text");
            }
        }
        write(&folder.join(format!("{name}.csv")), &text);
    }
    let mut text = "run,leg,position_mm,reading_um\n".to_owned();
    let angle = 4e-5;
    for q in grid(0.0, 12.0) {
        let moved = |read: usize, at: &dyn Fn(bool) -> [f64; 3]| at(true)[read] - at(false)[read];
        let x = moved(1, &|wrong| Other::tip(q, 70.0, -40.0, 0.0, TOOL, wrong)) - angle * q;
        let v = -(moved(0, &|wrong| Other::tip(110.0, q, -40.0, 0.0, TOOL, wrong)) + angle * q);
        writeln!(text, "1,X,{q},{:.10}\n1,V,{q},{:.10}", x * 1e3 + 2.0, v * 1e3 - 1.0).expect("text");
    }
    write(&folder.join("square.csv"), &text);
}

fn other_machine(folder: &Path) -> Variant {
    measure(folder);
    let path = |name: &str| folder.join(name).to_str().expect("UTF-8").to_owned();
    let (on_x, on_v) = (json!({ "V": 70, "Z": -40 }), json!({ "X": 110, "Z": -40 }));
    Variant(json!({
        "abbe": 1,
        "name": "Another machine",
        "stages": {
            "length-files": { "ingest": "csv", "path": [path("along-x.csv"), path("across-x.csv"), path("along-v.csv")] },
            "angle-files": { "ingest": "csv", "path": [path("pitch-x.csv"), path("pitch-v.csv")] },
            "square-files": { "ingest": "csv", "path": path("square.csv") },
            "lengths": { "artefact": "direct", "from": "length-files", "standard_uncertainty_um": 0.5, "measurements": {
                "along-x": { "kind": "displacement", "moves": "X", "at_mm": on_x, "stylus": 2 },
                "across-x": { "kind": "straightness", "moves": "X", "direction": [0, 0, 2], "at_mm": on_x },
                "along-v": { "kind": "displacement", "moves": "V", "direction": "Y", "at_mm": on_v, "stylus": 2 },
            } },
            "angles": { "artefact": "direct", "from": "angle-files", "standard_uncertainty_urad": 1, "measurements": {
                "pitch-x": { "kind": "angle", "moves": "X", "direction": "Y", "at_mm": on_x },
                "pitch-v": { "kind": "angle", "moves": "V", "direction": "X", "at_mm": on_v },
            } },
            "squares": { "artefact": "direct", "from": "square-files", "standard_uncertainty_um": 0.5, "measurements": {
                "square": { "kind": "square", "legs": ["X", "V"], "at_mm": { "X": 110, "V": 70, "Z": -40 } },
            } },
            "machine": {
                "model": "serial-chain", "chain": "w V' b Z X t", "tool_length_mm": 120, "stylus_radius_mm": 0,
                "axes": { "X": { "range_mm": [-100, 300] }, "V": { "range_mm": [0, 320] }, "Z": { "range_mm": [-200, 0] } },
                "styli": { "2": { "tip_mm": OPTICS } },
                "errors": [
                    { "polynomial": ["EXX", "EBX"], "degrees": [1, 2] },
                    { "polynomial": ["EYV", "EAV"], "degrees": [1] },
                    { "polynomial": ["EZX"], "degrees": [2], "without_line": true },
                    { "backlash": ["EYV"] },
                    { "location": ["EC0X"] },
                ],
            },
            "fit": {
                "estimate": "gauss-newton", "machine": "machine", "observations": ["lengths", "angles", "squares"],
                "parameters": ["E*", "lengths.*", "angles.*", "squares.*"],
            },
        },
    }))
}

#[test]
fn another_machine_gives_its_errors_back() {
    let folder = temporary();
    let outcome = other_machine(folder.path()).run();
    let calibration = &fit(&outcome, "fit").calibration;
    for (name, truth) in Other::TRUTH {
        let found = calibration.get(name).unwrap_or_else(|| panic!("no {name}")).value;
        assert!((found - truth).abs() < 1e-6 * truth.abs() + 1e-15, "{name}: {found} {truth}");
    }
    let slope = calibration.get("lengths.across-x.slope").expect("a slope").value;
    let angle = calibration.get("squares.square.angle").expect("an angle").value;
    assert!((slope - 3e-5).abs() < 1e-10 && (angle - 4e-5).abs() < 1e-10, "{slope} {angle}");
}

/// Derivatives of all equations to all unknowns against differences, away from the solution.
#[test]
fn derivatives_are_those_of_differences() {
    let folder = temporary();
    let outcome = other_machine(folder.path()).run();
    let fit = fit(&outcome, "fit");
    let problem = &fit.problem;
    // Errors a hundred times as large show what is of second order.
    let mut x = problem.values_of(&fit.calibration);
    x.iter_mut().for_each(|value| *value *= 100.0);
    let count = problem.unknowns.len();
    let mut jacobian = Vec::new();
    problem.linearise(&x, |block| jacobian.extend_from_slice(block.jacobian)).expect("derivatives");
    let compact = problem.linearise_compact(&x, |block| {
        let sizes = |at: usize| block.lines().map(move |(_, _, line)| line[at].abs());
        assert!(block.unknowns.len() < count, "rows of other runs have no zeros");
        (0..block.unknowns.len()).for_each(|at| assert!(sizes(at).any(|size| size > 0.0), "a column of zeros"));
    });
    compact.expect("derivatives");
    for unknown in 0..count {
        let column = || jacobian.iter().skip(unknown).step_by(count);
        let size = column().fold(0.0_f64, |size, value| size.max(value.abs()));
        let step = 1e-3 / size;
        let moved = |sign: f64| {
            let mut x = x.clone();
            x[unknown] += sign * step;
            problem.residuals(&x).expect("residuals")
        };
        let (above, below) = (moved(1.0), moved(-1.0));
        for ((above, below), derivative) in above.iter().zip(&below).zip(column()) {
            let difference = (above - below) / (2.0 * step);
            let off = (difference - derivative).abs();
            assert!(off < 1e-7 * size, "{}: {difference} {derivative}", problem.unknowns[unknown].name);
        }
    }
}

#[test]
fn what_cannot_be_read_is_refused() {
    let folder = temporary();
    let right = other_machine(folder.path());
    let refused = |stage: &str, measurement: &str, change: Value| {
        let mut variant = right.clone();
        let settings = &mut variant.stage(stage)["measurements"][measurement];
        for (key, value) in change.as_object().expect("settings") {
            settings[key] = value.clone();
        }
        let at = temporary();
        let prepared = prepare(&variant.write(at.path()), &registry());
        prepared
            .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()).map(drop))
            .expect_err("it is wrong")
            .to_string()
    };
    let cases = [
        ("lengths", "along-x", json!({ "moves": "W" }), "the machine has no axis W"),
        ("lengths", "along-x", json!({ "at_mm": { "V": 70 } }), "it is not said where Z stands"),
        ("lengths", "along-x", json!({ "at_mm": { "V": 70, "Z": -40, "X": 0 } }), "this axis moves"),
        ("lengths", "along-x", json!({ "at_mm": { "V": 70, "Q": -40 } }), "the machine has no axis Q"),
        ("lengths", "along-x", json!({ "direction": "Y" }), "X does not move along this direction"),
        ("lengths", "along-x", json!({ "stylus": 9 }), "the machine has no stylus 9"),
        ("lengths", "across-x", json!({ "direction": "X" }), "X moves along this direction"),
        ("lengths", "across-x", json!({ "direction": [0, 0, 0] }), "along this direction nothing can be read"),
        ("lengths", "along-x", json!({ "slope": "a" }), "only a straightness"),
        (
            "lengths",
            "along-x",
            json!({ "kind": "angle", "direction": "Y", "standard_uncertainty_urad": 1 }),
            "reads an angle",
        ),
        ("angles", "pitch-x", json!({ "kind": "straightness", "standard_uncertainty_um": 1 }), "reads a length"),
        ("angles", "pitch-x", json!({ "standard_uncertainty_um": 1 }), "what is read is an angle"),
        (
            "lengths",
            "nothing",
            json!({ "kind": "displacement", "moves": "X", "at_mm": { "V": 70, "Z": -40 } }),
            "no row of the data has the file `nothing`",
        ),
        ("squares", "square", json!({ "legs": ["X", "X"] }), "two different axes"),
        ("squares", "square", json!({ "moves": "X" }), "along a square two axes move"),
    ];
    for (stage, measurement, change, expected) in cases {
        let message = refused(stage, measurement, change);
        assert!(message.contains(expected), "{message}");
    }
    let broken = |file: &str, change: &dyn Fn(String) -> String, expected: &str| {
        let folder = temporary();
        let variant = other_machine(folder.path());
        let path = folder.path().join(file);
        write(&path, &change(read(&path)));
        let prepared = prepare(&variant.write(folder.path()), &registry());
        let error = prepared
            .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()).map(drop))
            .expect_err("it is wrong")
            .to_string();
        assert!(error.contains(expected), "{error}");
    };
    broken("square.csv", &|text| text.replace("position_mm", "place_mm"), "there is no column `position_mm`");
    broken("square.csv", &|text| text.replace("1,V,", "1,Q,"), "leg `Q`: X or V was expected");
    broken("square.csv", &|text| text.replacen("1,X,", "2,X,", 1), "tells nothing beside its own offset");
    broken("square.csv", &|text| text.replace("reading_um", "reading_urad"), "reads a length");
    broken("pitch-x.csv", &|text| text.replace(",time_s", ",time"), "time");
    let mut renamed = right.clone();
    let measurements = renamed.stage("lengths")["measurements"].as_object_mut().expect("measurements");
    let one = measurements.remove("along-x").expect("a measurement");
    measurements.insert("along-y".to_owned(), one);
    let at = temporary();
    let error = prepare(&renamed.write(at.path()), &registry())
        .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()).map(drop));
    let error = error.expect_err("it is wrong").to_string();
    assert!(
        error.contains("file `along-x` is not among the `measurements`") && error.contains("did you mean"),
        "{error}"
    );
}

/// The plates: file, stylus, measured directions of the table frame.
const PLATES: [(&str, &str, [usize; 2]); 3] =
    [("plate-xy", "1", [0, 1]), ("plate-xz", "6", [0, 2]), ("plate-yz", "7", [1, 2])];

/// Largest error at the holes in the measured directions once each plate lies where it fits best, mm. Plates have the same number of
/// holes.
fn left_of_plates(tips: &[[f64; 3]], goals: &[[f64; 3]]) -> f64 {
    let of_each = tips.len() / PLATES.len();
    let mut largest = 0_f64;
    for ((tips, goals), (_, _, [a, b])) in tips.chunks(of_each).zip(goals.chunks(of_each)).zip(PLATES) {
        let errors = tips.iter().zip(goals).flat_map(|(tip, goal)| [tip[a] - goal[a], tip[b] - goal[b]]);
        let errors = nalgebra::DVector::from_iterator(2 * of_each, errors);
        let place = nalgebra::DMatrix::from_fn(2 * of_each, 3, |row, column| match (row % 2, column) {
            (0, 0) | (1, 1) => 1.0,
            (0, 2) => -goals[row / 2][b],
            (1, 2) => goals[row / 2][a],
            _ => 0.0,
        });
        let moved = place.clone().svd(true, true).solve(&errors, 1e-12).expect("a placement");
        largest = largest.max((errors - place * moved).amax());
    }
    largest
}

/// Set-points at the holes of the plates, with the stylus that was there, in the statuses of a model.
fn holes(model: &dyn KinematicModel) -> Vec<f64> {
    use abbe_core::StatusRole;
    let info = model.info();
    let mut statuses = Vec::new();
    for (plate, stylus, _) in PLATES {
        let text = read(&root().join(format!("pipelines/data/mill-5axis/realistic/{plate}.csv")));
        let mut lines = text.lines().filter(|line| !line.starts_with('#'));
        let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
        for line in lines {
            let cells: Vec<&str> = line.split(',').collect();
            let of = |name: &str| -> f64 {
                let place = header.iter().position(|header| *header == name).expect("a column");
                cells[place].parse().expect("a number")
            };
            statuses.extend(info.status.iter().map(|column| match &column.role {
                StatusRole::Command(axis) if ["X", "Y", "Z"].contains(&info.axes[*axis].name.as_str()) => {
                    of(&format!("{}_mm", info.axes[*axis].name))
                }
                StatusRole::Stylus => column.levels.iter().position(|level| level == stylus).expect("a stylus") as f64,
                _ => 0.0,
            }));
        }
    }
    statuses
}

/// With the true values the tip is right at every hole; with those that realistic measurements gave it is within what they state.
#[test]
fn the_plates_are_right_after_a_correction() {
    use abbe_compensation::{Compensator, Settings, Trials, figures, remaining};
    let truth = truth("realistic");
    let outcome = Variant::of(&recipes()["mill-hole-plate"]).only(&["fit-angles", "fit"]).run();
    let fit = fit(&outcome, "fit");
    let (model, calibration) = (fit.problem.model.as_ref(), &fit.calibration);
    let true_values: Vec<f64> = (model.info().parameters.iter().zip(&model.info().nominal))
        .map(|(parameter, nominal)| truth["parameters"][&parameter.name].as_f64().unwrap_or(*nominal))
        .collect();
    let programmed = holes(model);
    let settings = Settings::default();
    let corrected = |values: &[f64]| {
        Compensator::new(model, values, &settings).and_then(|it| it.correct(&programmed)).expect("corrections")
    };
    let tips = |values: &[f64], statuses: &[f64]| {
        let mut poses = abbe_core::Poses::default();
        model.poses(statuses, values, &[], false, &mut poses).expect("poses");
        poses.positions
    };
    let goal = tips(&model.info().nominal, &programmed);
    let (commands, corrections) = corrected(&true_values);
    let found = figures(&corrections);
    let (before, after) = (found.tip_before.max * 1e3, found.tip_after.max * 1e3);
    let [on_plates, after_on_plates] =
        [&programmed, &commands].map(|statuses| left_of_plates(&tips(&true_values, statuses), &goal) * 1e3);
    println!("true values: {before} um before, {after} um after; on plates {on_plates} and {after_on_plates} um");
    assert!((105.0..108.0).contains(&on_plates) && after_on_plates < 0.01, "{on_plates} {after_on_plates}");
    assert!(before > on_plates && after < 1e-6, "{before} {after}");

    let estimate = abbe_core::machine_values(model, calibration);
    let (commands, _) = corrected(&estimate);
    let left = tips(&true_values, &commands);
    let known = abbe_volumetric::predict(model, calibration, &commands).expect("uncertainties");
    let (mut worst, mut largest) = (0_f64, 0_f64);
    for ((goal, left), known) in goal.iter().zip(&left).zip(&known) {
        for axis in 0..3 {
            let off = left[axis] - goal[axis];
            worst = worst.max(off.abs() / known.covariance[axis][axis].sqrt());
        }
        largest = largest.max(goal.iter().zip(left).map(|(goal, left)| (goal - left).powi(2)).sum::<f64>().sqrt());
    }
    let trials = Trials { number: 400, seed: 1, probability: 0.99 };
    let expected = remaining(model, calibration, &programmed, &[&commands], &trials).expect("errors")[0];
    println!("realistic: {} um left, {worst} u, upper limit {} um", largest * 1e3, expected.tip_max.upper * 1e3);
    assert!(worst < 4.0, "{worst} standard uncertainties");
    assert!(expected.tip_max.estimate < 1e-9 && largest < expected.tip_max.upper, "{largest} {expected:?}");
    assert!(expected.tip_max.upper < 0.005, "{expected:?}");
}

/// The joint fit of all measurements goes over parts of the rows. What it finds has the same bytes on one thread as on all, as for two
/// estimates side by side; and it is the minimum: the gradient of its rows is nothing there.
#[test]
fn the_joint_fit_has_the_same_bytes_on_any_number_of_threads() {
    let fits = run("mill-direct").fits;
    let fit = fits.iter().find(|fit| fit.name == "fit").expect("the joint fit");
    let found = || {
        let calibration = fit.estimator.estimate(&fit.problem).expect("an estimate");
        (calibration.to_json().expect("JSON"), calibration.fit.gradient_cosine)
    };
    let (alone, cosine) = found();
    assert!(cosine.is_some_and(|cosine| cosine < 1e-9), "{cosine:?}");
    for (text, _) in in_parallel(&[(), ()], Some(2), |()| found()) {
        assert!(text == alone, "other bytes on one thread");
    }
}

/// A machine that is judged again where a wavelength and its amplitudes are other ones: as if nothing had been known of it.
#[test]
fn a_machine_is_judged_again_as_it_is_anew() {
    let fits = run("mill-direct").fits;
    for name in ["fit", "fit-lengths"] {
        let problem = &fits.iter().find(|fit| fit.name == name).expect("a fit").problem;
        let before = Judgement::new(problem, None).expect("a judgement");
        let solved = fits.iter().find(|fit| fit.name == name).map(|fit| problem.values_of(&fit.calibration));
        let moved = problem.with_values(&solved.expect("values"));
        let (again, anew) = (before.again(&moved).expect("again"), Judgement::new(&moved, None).expect("anew"));
        assert_ne!(before.terms(), anew.terms(), "{name}: amplitudes have no effect");
        for ((again, anew), unknown) in again.terms().iter().zip(anew.terms()).zip(&problem.unknowns) {
            assert!((again - anew).abs() <= 1e-5 * anew, "{name} {}: {again} {anew}", unknown.name);
        }
        assert_eq!(again.factor().norms(), anew.factor().norms());
    }
}
