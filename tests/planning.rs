//! Plans of measurements: ball bars on a planar CMM against Soons (1993), section 4.4, indexations of a table by condition number
//! (Rahman 2016, Table 8-4), and what is refused.

use std::path::Path;

use abbe_engine::{Measurements, prepare};
use serde_json::{Value, json};

use crate::support::{Variant, abbe, as_typed, fit, json_file, read, recipes, registry, root, temporary};

fn planned(recipe: &Variant) -> Measurements {
    try_plan(recipe).unwrap_or_else(|error| panic!("{error}"))
}

fn try_plan(recipe: &Variant) -> Result<Measurements, String> {
    let folder = temporary();
    let plan = prepare(&recipe.write(folder.path()), &registry()).and_then(|prepared| prepared.plan());
    plan.map_err(|error| error.to_string())
}

fn ball_bars(change: impl Fn(&mut Value)) -> Variant {
    let mut recipe = Variant::of(&recipes()["design-2d"]);
    change(&mut recipe.0["plan"]);
    recipe
}

/// As Table 4.1 scales it: the cubic root of the determinant of n Cov / sigma², 1/mm².
fn scaled_root(measurements: &Measurements, number: f64) -> f64 {
    // One ball bar is uncertain by 1 um.
    number * (-(measurements.plan.figures.log_determinant + 6.0 * 1e-3_f64.ln()) / 3.0).exp()
}

#[test]
fn every_seed_finds_the_best_six_ball_bars() {
    for seed in 0..20 {
        let found = planned(&ball_bars(|plan| plan["seed"] = json!(seed)));
        assert!((scaled_root(&found, 6.0) / 2.5e-5 - 1.0).abs() < 1e-9, "seed {seed}: {}", scaled_root(&found, 6.0));
        assert_eq!(found.plan.chosen.iter().map(|chosen| chosen.times).sum::<usize>(), 6);
        // By the equivalence theorem the largest variance of a D-optimal design is the number of unknowns.
        assert!((found.plan.figures.response_variance[1] - 3.0).abs() < 1e-9);
    }
}

#[test]
fn designs_of_table_4_1() {
    let text = read(&root().join("pipelines/data/design-2d/designs.csv"));
    // Cubic root, largest variance of a response, and the matrices of equations 4.24 to 4.26.
    let printed = [
        (1, "2.98", 9.0, [[6.0, 1.0, 1.0], [1.0, 1.0, 0.0], [1.0, 0.0, 1.0]]),
        (2, "2.60", 4.0, [[4.0, 0.0, 0.0], [0.0, 5.0 / 6.0, -1.0 / 6.0], [0.0, -1.0 / 6.0, 5.0 / 6.0]]),
        (3, "2.50", 3.0, [[8.0 / 3.0, 0.0, 0.0], [0.0, 1.0, -1.0 / 3.0], [0.0, -1.0 / 3.0, 1.0]]),
    ];
    for (design, root, largest, matrix) in printed {
        let lines = text.lines().filter(|line| line.starts_with(&format!("{design},")));
        let mut required = Vec::new();
        for line in lines {
            let cells: Vec<&str> = line.split(',').collect();
            let times: usize = cells[2].parse().expect("a number");
            required.extend(std::iter::repeat_n(json!(cells[1]), times));
        }
        assert_eq!(required.len(), 6);
        let found = planned(&ball_bars(|plan| plan["required"] = json!(required)));
        assert_eq!(format!("{:.2}", scaled_root(&found, 6.0) * 1e5), root, "design {design}");
        assert!((found.plan.figures.response_variance[1] - largest).abs() < 1e-9, "design {design}");
        let unit = 1e-6 / (2.0 * 400.0_f64.powi(2));
        for (found, expected) in found.plan.figures.covariance.iter().zip(matrix.as_flattened()) {
            assert!((found / unit - expected).abs() < 1e-9, "design {design}: {}, expected {expected}", found / unit);
        }
    }
}

#[test]
fn indexations_are_chosen_by_condition_number() {
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    let plan = json!({ "estimate": "fit", "candidates": "table", "by": "group", "number": 12, "criterion": "condition", "restarts": 4 });
    recipe.0["plan"] = plan;
    let found = planned(&recipe);
    assert_eq!(found.plan.chosen.len(), 12);
    assert_eq!(found.plan.candidates, 28);
    let evenly = found.plan.spread_evenly.as_ref().map_or(f64::INFINITY, |figures| figures.condition);
    assert!(found.plan.figures.condition < 0.8 * evenly, "{} and {evenly}", found.plan.figures.condition);
    assert!((found.identifiability.condition / found.plan.figures.condition - 1.0).abs() < 1e-6);

    // What is required is chosen, what is forbidden is not.
    let left = (1..=28).map(|group| group.to_string());
    let mut left = left.filter(|group| !found.plan.chosen.iter().any(|chosen| chosen.label == *group));
    let (required, forbidden) = (left.next().expect("a group"), left.next().expect("a group"));
    recipe.0["plan"]["required"] = json!([required]);
    recipe.0["plan"]["forbidden"] = json!([forbidden]);
    let bound = planned(&recipe);
    assert!(bound.plan.chosen.iter().any(|chosen| chosen.label == required && chosen.required));
    assert!(bound.plan.chosen.iter().all(|chosen| chosen.label != forbidden));
    assert!(bound.plan.figures.condition >= found.plan.figures.condition);
}

#[test]
fn what_was_measured_counts() {
    let mut recipe = ball_bars(|plan| {
        plan["number"] = json!(1);
        plan["replications"] = json!(false);
    });
    // Two orientations are there: the third of the triangle is what is missing.
    recipe.0["stages"]["done"] =
        json!({ "ingest": "csv", "path": recipe.path("places", "path"), "keep": { "candidate": [53, 129] } });
    recipe.0["stages"]["measured"] = json!({ "artefact": "length", "from": "done", "standard_uncertainty_um": 1 });
    recipe.0["stages"]["fit"]["observations"] = json!(["measured", "bar"]);
    let found = planned(&recipe);
    assert_eq!(found.plan.figures.equations, 3);
    assert!((scaled_root(&found, 3.0) / 2.5e-5 - 1.0).abs() < 1e-9, "{}", scaled_root(&found, 3.0));
}

#[test]
fn the_written_plan_can_be_filled_in() {
    let folder = temporary();
    let out = folder.path().join("plan");
    let recipe = &recipes()["design-2d"];
    let told = abbe(folder.path(), &[Path::new("plan"), recipe, Path::new("--out"), &out]);
    assert_eq!(told.status, 0, "{}", told.stderr);
    let rows = read(&out.join("candidates.csv"));
    assert_eq!(rows.lines().filter(|line| !line.starts_with('#')).count(), 1 + 6, "{rows}");
    let record = json_file(&out.join("plan.json"));
    assert_eq!((record["abbe_plan"].as_u64(), record["rank"].as_u64()), (Some(1), Some(3)));
    let fitted = Variant::of(recipe).set("places", "path", json!(out.join("candidates.csv"))).run();
    assert_eq!(fitted.fits[0].calibration.fit.observations, 6);
}

#[test]
fn wrong_plans_are_refused() {
    let cases: [(&str, Value, &str); 8] = [
        ("number", json!(0), "0: a whole number from 1 to"),
        ("number", json!(2), "too small to determine 3 unknowns"),
        ("candidates", json!("baar"), "there is no stage `baar` of the kind artefact"),
        ("estimate", json!("fitt"), "there is no stage `fitt` of the kind estimate"),
        ("by", json!("candidat"), "there is no column `candidat`"),
        ("parameters", json!(["EZZ[1]"]), "`EZZ[1]` matches nothing that is estimated"),
        ("budget_s", json!(60), "there is no column `duration`"),
        ("criterion", json!("d"), "unknown choice `d`"),
    ];
    for (key, value, expected) in cases {
        let error = try_plan(&ball_bars(|plan| plan[key] = value.clone())).err().unwrap_or_default();
        assert!(error.contains(expected), "{key}: {value}: {error}");
    }
    let none = Variant::of(&recipes()["first-steps"]);
    assert!(try_plan(&none).is_err_and(|error| error.contains("says nothing of what is to be planned")));
}

/// A plan that names rows of other data goes on without them, and says which setting it is.
#[test]
fn rows_of_other_data_are_passed_over_and_told() {
    let folder = temporary();
    let file = ball_bars(|plan| plan["required"] = json!([9999])).write(folder.path());
    let printed = as_typed(folder.path(), &["plan", file.to_str().expect("UTF-8")]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    assert!(printed.stderr.contains("plan.required[0]: there is no candidate 9999"), "{}", printed.stderr);
}

/// The ball bars of `design-2d` made on a grid, without a file.
fn on_a_grid() -> Variant {
    let even = |from: i32, to: i32, step: i32| json!({ "from": from, "to": to, "step": step });
    let mut recipe = ball_bars(|plan| {
        plan.as_object_mut().expect("a plan").remove("by");
        plan["generate"] = json!({ "lengths": {
            "lengths_mm": [400], "x_mm": even(50, 450, 50), "y_mm": even(50, 450, 50), "z_mm": [0],
            "azimuth_deg": even(0, 345, 15),
        } });
    });
    recipe.stage("places")["path"] = json!("not-measured-yet.csv");
    recipe
}

#[test]
fn lengths_on_a_grid_are_those_of_the_data_set() {
    let found = planned(&on_a_grid());
    assert_eq!(found.plan.candidates, 392);
    assert!((scaled_root(&found, 6.0) / 2.5e-5 - 1.0).abs() < 1e-9, "{}", scaled_root(&found, 6.0));
    let (_, file) = found.files.iter().find(|(name, _)| name.ends_with("candidates.csv")).expect("a file to fill in");
    let text = String::from_utf8(file.clone()).expect("text");
    assert!(text.contains("group,length,reference_mm,X1_mm,Y1_mm,X2_mm,Y2_mm\n"), "{text}");
    // The machine that lacks height lacks nothing: a bar that leaves the plane is out of reach.
    let mut upright = on_a_grid();
    upright.0["plan"]["generate"]["lengths"]["elevation_deg"] = json!([0, 90]);
    assert_eq!(planned(&upright).plan.candidates, 392);
    // With height each of the 81 places has one upright bar, whatever its azimuth.
    upright.stage("cmm")["chain"] = json!("w b X Y Z t");
    upright.stage("cmm")["axes"]["Z"] = json!({ "range_mm": [0, 500] });
    assert_eq!(planned(&upright).plan.candidates, 392 + 81);
    // Nothing has been measured yet: that is said where it matters.
    let folder = temporary();
    let file = on_a_grid().write(folder.path());
    let told = abbe(folder.path(), &[Path::new("run"), &file]);
    assert!(told.status == 2 && told.stderr.contains("there is no such file"), "{}", told.stderr);
}

#[test]
fn indexations_on_a_grid_are_those_that_the_machine_reaches() {
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    recipe.0["plan"] = json!({ "estimate": "fit", "candidates": "table", "by": "group", "number": 12, "restarts": 2,
        "generate": {
            "indexations_deg": { "B": { "from": -90, "to": 90, "step": 30 }, "C": [0, 90, 180, 270], "S": [0, 180] },
            "reach_deg": 90,
        } });
    let axes =
        json!({ "X": { "range_mm": [-700, 700] }, "Y": { "range_mm": [-700, 700] }, "Z": { "range_mm": [-200, 900] } });
    recipe.stage("machine")["axes"] = axes;
    let found = planned(&recipe);
    assert_eq!(found.plan.chosen.len(), 12);
    assert!(found.plan.candidates <= 8 * 56 && found.plan.candidates > 12, "{}", found.plan.candidates);
    assert!(found.accepted);
    // The file can be filled in: it is what `check` and `run` read, and says how axes approach.
    let folder = temporary();
    let file = folder.path().join("candidates.csv");
    let (_, content) = found.files.iter().find(|(name, _)| name.ends_with("candidates.csv")).expect("a file");
    std::fs::write(&file, content).expect("written");
    let text = read(&file);
    let header: Vec<&str> = text.lines().nth(1).expect("a header").split(',').collect();
    assert_eq!(header[..2], ["group", "feature"]);
    assert!(header.contains(&"dir_X") && header.contains(&"B_deg"), "{header:?}");
    recipe.0.as_object_mut().expect("a recipe").remove("plan");
    recipe.stage("touches")["path"] = json!(file);
    recipe.stage("touches").as_object_mut().expect("a stage").remove("ignore");
    // Nominal positions of a perfect machine: nothing to estimate is off.
    let outcome = recipe.run();
    for estimated in &outcome.fits[0].calibration.parameters {
        assert!(estimated.value.abs() < 1e-6, "{estimated:?}");
    }
    // With all round access there are more rows at fewer limits.
    let rows = |reach: f64| {
        let mut wider = recipe.clone();
        wider.0["plan"] = json!({ "estimate": "fit", "candidates": "table", "number": 60, "restarts": 1,
            "generate": { "indexations_deg": { "B": [-60, -30, 0, 30, 60], "C": [0, 90], "S": [0, 180] }, "reach_deg": reach } });
        planned(&wider).plan.candidates
    };
    assert!(rows(180.0) > rows(90.0));
    // What no candidate tells is named.
    recipe.0["plan"] = json!({ "estimate": "fit", "candidates": "table", "number": 60,
        "generate": { "indexations_deg": { "C": [0, 90], "S": [0, 180] } } });
    let error = try_plan(&recipe).err().unwrap_or_default();
    assert!(error.contains("even all candidates together leave something open") && error.contains("EBB[b]"), "{error}");
}

#[test]
fn wrong_grids_are_refused() {
    let cases = [
        (vec!["indexations_deg"], json!({ "B": [0] }), "the machine has no rotary axis B"),
        (vec!["reach_deg"], json!(0), "an angle above 0"),
        (vec!["duration_s"], json!(-3), "-3: a positive number was expected"),
        (vec!["lengths", "x_mm"], json!([5, 4]), "these have to increase; 4 does not"),
        (vec!["lengths", "lengths_mm"], json!([]), "at least one number"),
        (vec!["lengths", "lengths_mm"], json!([-400]), "-400: a positive number"),
        (vec!["lengths", "lengths_mm"], json!([4000]), "the machine reaches nothing of this"),
    ];
    for (path, value, expected) in cases {
        let mut recipe = on_a_grid();
        let mut place = &mut recipe.0["plan"]["generate"];
        for key in &path {
            place = &mut place[*key];
        }
        *place = value;
        let error = try_plan(&recipe).err().unwrap_or_default();
        assert!(error.contains(expected), "{path:?}: {error}");
    }
    let mut recipe = on_a_grid();
    recipe.0["plan"]["generate"] = json!({});
    let error = try_plan(&recipe).err().unwrap_or_default();
    assert!(error.contains("this artefact has no features that the tip is sent to"), "{error}");
}

/// Touches on a machine that warms up and whose tool drifts, by groups, in an order of their own.
fn ordered(change: impl Fn(&mut Value)) -> Variant {
    let mut recipe = Variant::of(&recipes()["tango-warming"]).only(&["fit"]);
    recipe.stage("fit")["trust_uncertainties"] = json!(true);
    recipe.stage("fit")["parameters"] = json!(["@geometry", "dzt[t1]", "dzt[t2]", "EA0B[T_column:1]", "table.*"]);
    recipe.0["plan"] = json!({ "estimate": "fit", "candidates": "table", "by": "group", "number": 15, "restarts": 3,
        "parameters": ["E*"], "order": { "duration_s": 16, "references": [1], "times": 3 } });
    change(&mut recipe.0["plan"]);
    recipe
}

#[test]
fn an_order_tells_drift_from_geometry() {
    let folder = temporary();
    let recipe = ordered(|_| {});
    let file = recipe.write(folder.path());
    let found =
        prepare(&file, &registry()).and_then(|prepared| prepared.plan()).unwrap_or_else(|error| panic!("{error}"));
    let order = found.plan.order.as_ref().expect("an order");
    assert_eq!(order.sequence.len(), 15 + 2);
    assert_eq!(order.sequence.iter().filter(|(label, _)| label == "1").count(), 3);
    // Touches one after another, each 16 s.
    let rows: Vec<f64> = order.rows.iter().map(|(_, time)| *time).collect();
    assert!(rows.iter().enumerate().all(|(row, time)| (time - 16.0 * row as f64).abs() < 1e-6), "{rows:?}");
    let begins = |from: &f64| rows.iter().any(|time| (time - from).abs() < 1e-6);
    assert!(order.sequence.iter().all(|(_, from)| begins(from)), "{:?}", order.sequence);
    let listed = order.as_listed.as_ref().expect("the order of the list");
    let gained = 1.0 / order.figures.efficiency_of(listed);
    println!("list {gained:.3} times, random {:.3} times as many", 1.0 / order.random_efficiency);
    assert!(gained > 1.005 && order.random_efficiency <= 1.0, "{gained} {}", order.random_efficiency);

    // The file to fill in, run as it is, has the uncertainties that the plan promises (its touches are not quite at nominal contact).
    let out = folder.path().join("plan");
    found.write(&out).unwrap_or_else(|error| panic!("{error}"));
    let mut filled = recipe.clone();
    filled.0.as_object_mut().expect("a recipe").remove("plan");
    filled.stage("touches")["path"] = json!(out.join("touches.csv"));
    filled.stage("touches").as_object_mut().expect("a stage").remove("ignore");
    let outcome = filled.run();
    let calibration = &fit(&outcome, "fit").calibration;
    let planned = found.plan.problem.unknowns.iter().zip(found.standard_uncertainties());
    let mut compared = 0;
    for (unknown, expected) in planned.filter(|(unknown, _)| unknown.name.starts_with('E')) {
        let is = calibration.get(&unknown.name).expect("an estimate").standard_uncertainty;
        assert!((is / expected - 1.0).abs() < 0.02, "{}: {is:e}, planned {expected:e}", unknown.name);
        compared += 1;
    }
    assert!(compared > 15, "{compared}");
    let told = abbe(folder.path(), &[Path::new("plan"), &file]);
    assert!(told.stdout.contains("In this order, candidate at seconds"), "{}", told.stdout);
    assert!(told.stdout.contains("In the order of the list"), "{}", told.stdout);
}

#[test]
fn orders_that_make_no_sense_are_refused() {
    let said = |change: &dyn Fn(&mut Value)| try_plan(&ordered(change)).err().expect("it is refused");
    let unknown = said(&|plan| plan["order"]["references"] = json!([99]));
    assert!(unknown.contains("there is no candidate 99"), "{unknown}");
    let twice = said(&|plan| plan["order"]["references"] = json!([1, 1]));
    assert!(twice.contains("1 stands here twice"), "{twice}");
    let late = said(&|plan| plan["order"]["start_s"] = json!(1e5));
    assert!(late.contains("is outside the log of temperatures"), "{late}");
    let mut still = ordered(|_| {});
    still.stage("fit")["parameters"] = json!(["@geometry", "table.*"]);
    let said = try_plan(&still).err().expect("it is refused");
    assert!(said.contains("nothing that is estimated follows the time"), "{said}");
}

/// The fewest touches that reach an uncertainty, on beginnings of random machines: one less does not, the reverse answer is exact, and
/// more that is allowed is never worse.
#[test]
fn a_wanted_uncertainty_is_reached_with_the_fewest() {
    let chains = crate::models::all_chains();
    for (seed, of) in [(1, "parameters"), (2, "tool"), (3, "parameters"), (4, "tool")] {
        let mut random = crate::controls::law::uniform(seed);
        let chain = &chains[840 + (random() * (chains.len() - 840) as f64) as usize % (chains.len() - 840)];
        let folder = temporary();
        let begun = abbe(folder.path(), &["new", "m", "--chain", chain, "--method", "ball"]);
        assert_eq!(begun.status, 0, "{}", begun.stderr);
        let plan_of = |um: f64, until: Value, number: usize| {
            let text = read(&folder.path().join("m/recipe.yaml"));
            let head = &text[..text.find("\nplan:").expect("a plan")].replace("_um: 2", &format!("_um: {um:?}"));
            let grid = text.lines().find(|line| line.contains("generate:")).expect("a grid");
            let plan = format!(
                "\nplan:\n  estimate: fit\n  candidates: ball\n  by: group\n  parameters: [\"E*\"]\n  restarts: 2\n  number: {number}\n  until: {until}\n{grid}\n"
            );
            std::fs::write(folder.path().join("m/p.yaml"), format!("{head}{plan}")).expect("a file");
            prepare(&folder.path().join("m/p.yaml"), &registry()).and_then(|prepared| prepared.plan())
        };
        let wanted = |um: f64| json!({ "expanded_um": um, "of": of });
        // With any uncertainty that tells all, then with a smaller one.
        let any = plan_of(2.0, wanted(1e6), 30).unwrap_or_else(|error| panic!("{chain}: {error}"));
        let any = any.plan.reached.expect("an uncertainty was wanted");
        let um = any.expanded * 1e3 / 1.2;
        let found = plan_of(2.0, wanted(um), 30).unwrap_or_else(|error| panic!("{chain}: {error}"));
        let reached = found.plan.reached.clone().expect("an uncertainty was wanted");
        assert!(reached.expanded <= reached.wanted, "{chain}: {reached:?}");
        if of == "parameters" {
            let unknowns = found.plan.problem.unknowns.iter().zip(found.standard_uncertainties());
            let lengths =
                unknowns.filter(|(unknown, _)| unknown.name.starts_with('E') && unknown.unit.to_string() == "mm");
            let largest = lengths.map(|(_, value)| 2.0 * value).fold(0.0, f64::max);
            assert!((largest / reached.expanded - 1.0).abs() < 1e-9, "{chain}: {largest}");
        }
        // The reverse question: with touches as bad as told, these candidates reach exactly what is wanted.
        let row = reached.largest_of_row.expect("all rows are touches") * 1e3;
        let number: usize = found.plan.chosen.iter().map(|chosen| chosen.times).sum();
        if number > 1 {
            let fewer = plan_of(2.0, wanted(um), number - 1);
            assert!(fewer.is_err(), "{chain}: {number} are not the fewest");
        }
        let worse = plan_of(row, wanted(um), number).unwrap_or_else(|error| panic!("{chain} {row}: {error}"));
        let exact = worse.plan.reached.expect("an uncertainty was wanted");
        assert!(exact.expanded <= exact.wanted * (1.0 + 1e-9), "{chain}: {exact:?}");
        if worse.plan.chosen == found.plan.chosen {
            assert!((exact.expanded / exact.wanted - 1.0).abs() < 1e-6, "{chain}: {exact:?}");
        }
        let refused = plan_of(2.0, wanted(um * 1e-3), 30).err().expect("out of reach").to_string();
        assert!(refused.contains("is wanted"), "{refused}");
    }
}
