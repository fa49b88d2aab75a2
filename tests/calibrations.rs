//! Calibrations that one recipe estimates and another one uses: as known values, as start, for validation and in a
//! combination. Inputs that both share are counted once.

use std::path::Path;

use abbe_core::{Calibration, Status};
use abbe_engine::{Outcome, prepare};
use serde_json::{Value, json};

use crate::support::{Small, Variant, abbe, fit, json_file, read, recipes, registry, temporary, tree, write};

/// The machine parameters of the TANGO test that a set of one cycle determines.
const MACHINE: [&str; 9] = ["dxt", "dyt", "dzt", "EXX[1]", "EYY[1]", "EZZ[1]", "E?0?", "EXX[b]", "E??[b]"];

/// The repeated TANGO test: machine and ingest of one cycle of one day, `touches-<name>` and `lengths-<name>`, with the
/// artefacts `table-<name>` and `bar-<name>`.
fn tango(sets: &[(&str, u32, u32)]) -> Variant {
    let mut recipe = Variant::of(&recipes()["tango-uncertainty"]).only(&[]);
    let stages = recipe.0["stages"].as_object_mut().expect("stages");
    let (touches, lengths) = (stages["touches"].clone(), stages["lengths"].clone());
    let (table, bar, machine) = (stages["table"].clone(), stages["bar"].clone(), stages["hu40t"].clone());
    stages.clear();
    stages.insert("hu40t".to_owned(), machine);
    for (name, day, cycle) in sets {
        for (kind, ingest, artefact, of) in [("touches", &touches, "table", &table), ("lengths", &lengths, "bar", &bar)]
        {
            let (mut ingest, mut of) = (ingest.clone(), of.clone());
            ingest["keep"] = json!({ "day": [day], "cycle": [cycle] });
            of["from"] = json!(format!("{kind}-{name}"));
            stages.insert(format!("{kind}-{name}"), ingest);
            stages.insert(format!("{artefact}-{name}"), of);
        }
    }
    recipe
}

/// What the equations of touches are linear in: set-up and scales.
const LINEAR: [&str; 6] = ["dxt", "dyt", "dzt", "EXX[1]", "EYY[1]", "EZZ[1]"];

/// An estimate of the machine from some sets.
fn estimate(sets: &[&str]) -> Value {
    estimate_of(&MACHINE, sets)
}

fn estimate_of(machine: &[&str], sets: &[&str]) -> Value {
    let observed: Vec<String> = sets.iter().flat_map(|set| [format!("table-{set}"), format!("bar-{set}")]).collect();
    let own = sets.iter().map(|set| format!("table-{set}.*"));
    let parameters: Vec<String> = machine.iter().map(|name| (*name).to_owned()).chain(own).collect();
    json!({
        "estimate": "gauss-newton", "machine": "hu40t", "observations": observed, "parameters": parameters,
        "trust_uncertainties": true,
    })
}

fn with(mut recipe: Variant, stage: &str, settings: Value) -> Variant {
    recipe.0["stages"][stage] = settings;
    recipe
}

/// Runs a recipe that was written into a folder, and leaves its results there.
fn run(recipe: &Variant, folder: &Path) -> Outcome {
    let outcome =
        prepare(&recipe.write(folder), &registry()).and_then(|prepared| prepared.run(&abbe_core::Monitor::default()));
    let outcome = outcome.unwrap_or_else(|error| panic!("{error}"));
    outcome.write(&folder.join("out")).unwrap_or_else(|error| panic!("{error}"));
    outcome
}

fn error_of(recipe: &Variant) -> String {
    let folder = temporary();
    match prepare(&recipe.write(folder.path()), &registry())
        .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()))
    {
        Ok(outcome) => outcome.failures.first().expect("a stage that fails").error.to_string(),
        Err(error) => error.to_string(),
    }
}

/// The largest difference of values and of covariances of machine parameters, in standard uncertainties.
fn difference(one: &Calibration, other: &Calibration, of: impl Fn(&str) -> bool) -> (f64, f64) {
    let names: Vec<&String> = one.covariance.order.iter().filter(|name| of(name)).collect();
    assert!(names.len() > 5, "{:?}", one.covariance.order);
    let place = |calibration: &Calibration, name: &String| {
        calibration.covariance.order.iter().position(|it| it == name).unwrap_or_else(|| panic!("no {name}"))
    };
    let u = |name: &String| one.get(name).expect("a value").standard_uncertainty;
    let (mut values, mut covariances) = (0.0_f64, 0.0_f64);
    for name in &names {
        let off = one.get(name).expect("a value").value - other.get(name).unwrap_or_else(|| panic!("no {name}")).value;
        values = values.max(off.abs() / u(name));
        for second in &names {
            let entry = |it: &Calibration| it.covariance.rows[place(it, name)][place(it, second)];
            covariances = covariances.max((entry(one) - entry(other)).abs() / u(name) / u(second));
        }
    }
    (values, covariances)
}

fn of_machine(calibration: &Calibration) -> impl Fn(&str) -> bool + '_ {
    |name| calibration.parameters.iter().any(|it| it.name == name && it.status == Status::Estimated)
}

/// Two days, each with an estimate of its own, the second in another recipe that knows the file of the first.
fn monday(folder: &Path) -> Outcome {
    run(&with(tango(&[("one", 1, 2)]), "fit", estimate(&["one"])), folder)
}

#[test]
fn two_days_combined_are_both_days_at_once_with_the_bar_counted_once() {
    // The days differ by many of their uncertainties (the machine drifts), and covariances are those at nominal contact, not at
    // the recorded positions 0.1 mm beside it: that leaves a part of 1e-4 or so of what the days differ by.
    combined_against_joint(&LINEAR, 5e-4);
    combined_against_joint(&MACHINE, 1e-3);
}

fn combined_against_joint(machine: &[&str], allowed: f64) {
    let folder = temporary();
    run(&with(tango(&[("one", 1, 2)]), "fit", estimate_of(machine, &["one"])), &folder.path().join("monday"));
    let joint = with(tango(&[("one", 1, 2), ("two", 4, 3)]), "joint", estimate_of(machine, &["one", "two"]));
    let joint = run(&joint, &folder.path().join("joint"));
    let joint = &fit(&joint, "joint").calibration;
    // One bar and one stylus on both days.
    let names: Vec<&str> = joint.inputs.as_ref().expect("inputs").iter().map(|input| input.name.as_str()).collect();
    assert_eq!(names, ["stylus_radius", "bar-one.reference_error"]);

    let tuesday = |id: Option<&str>| {
        let mut recipe = with(tango(&[("two", 4, 3)]), "fit", estimate_of(machine, &["two"]));
        if let Some(id) = id {
            recipe.0["stages"]["bar-two"]["id"] = json!(id);
        }
        let file = json!({ "estimate": "calibration", "path": "../monday/out/recipe/fit.calibration.json" });
        let recipe = with(recipe, "monday", file);
        let both = json!({ "estimate": "combine", "of": ["monday", "fit"], "on_disagreement": "warn" });
        with(recipe, "both", both)
    };
    let outcome = run(&tuesday(None), &folder.path().join("tuesday"));
    let both = &fit(&outcome, "both").calibration;
    let (values, covariances) = difference(joint, both, of_machine(joint));
    println!("combined against joint: values {values:.1e}, covariances {covariances:.1e} standard uncertainties");
    assert!(values < allowed && covariances < 1e-6, "{values:e}, {covariances:e}");
    assert_eq!(both.data.len(), 2);
    assert!(both.fit.agreement.is_some());

    // Counted as two bars, their errors would average out.
    let outcome = run(&tuesday(Some("bar 0815")), &folder.path().join("two-bars"));
    let apart = &fit(&outcome, "both").calibration;
    let of_scale = |it: &Calibration| it.get("EXX[1]").expect("a scale").standard_uncertainty;
    let averaged = of_scale(both).powi(2) - of_scale(apart).powi(2);
    let half = (0.4e-3_f64 / 304.6686).powi(2) / 2.0;
    assert!((averaged / half - 1.0).abs() < 0.01, "{averaged:e}, {half:e}");
}

#[test]
fn what_monday_knows_is_known_on_tuesday_as_in_a_joint_estimate() {
    let folder = temporary();
    monday(&folder.path().join("monday"));
    // One touch on every facet: it determines the place of the facet and nothing of the machine.
    let data = recipes()["tango-uncertainty"].parent().expect("a folder").join("data/tango-hu40t/repeats/touches.csv");
    let mut seen = std::collections::BTreeSet::new();
    let text = read(&data);
    let header = text.lines().find(|line| !line.starts_with('#')).expect("a header");
    let column = |name: &str| header.split(',').position(|it| it == name).expect("a column");
    let (day, cycle, feature) = (column("day"), column("cycle"), column("feature"));
    let first = text.lines().filter(|line| {
        let cells: Vec<&str> = line.split(',').collect();
        let of_day = cells.len() > day.max(cycle) && cells[day] == "4" && cells[cycle] == "3";
        of_day && !["1", "2"].contains(&cells[feature]) && seen.insert(cells[feature].to_owned())
    });
    let rows: Vec<&str> = std::iter::once(header).chain(first).collect();
    write(&folder.path().join("few.csv"), &(rows.join("\n") + "\n"));
    let few = |recipe: Variant| {
        let mut recipe = recipe;
        let ingest = json!({ "ingest": "csv", "path": folder.path().join("few.csv") });
        recipe.0["stages"]["touches-two"] = ingest;
        recipe.0["stages"].as_object_mut().expect("stages").remove("bar-two");
        recipe.0["stages"].as_object_mut().expect("stages").remove("lengths-two");
        recipe
    };
    let mut tuesday = few(tango(&[("two", 4, 3)]));
    tuesday.0["stages"].as_object_mut().expect("stages").remove("hu40t");
    let file = json!({ "estimate": "calibration", "path": "../monday/out/recipe/fit.calibration.json" });
    let tuesday = with(tuesday, "monday", file);
    let tuesday = with(
        tuesday,
        "fit",
        json!({
            "estimate": "gauss-newton", "machine": "monday", "observations": ["table-two"], "parameters": ["table-two.*"],
            "known": "monday", "trust_uncertainties": true,
        }),
    );
    let tuesday = run(&tuesday, &folder.path().join("tuesday"));
    let known = &fit(&tuesday, "fit").calibration;
    let mut joint = estimate(&["one", "two"]);
    joint["observations"] = json!(["table-one", "bar-one", "table-two"]);
    let joint = with(few(tango(&[("one", 1, 2), ("two", 4, 3)])), "joint", joint);
    let joint = run(&joint, &folder.path().join("joint"));
    let joint = &fit(&joint, "joint").calibration;
    let of = |name: &str| name.starts_with("table-two.") || of_machine(joint)(name);
    let (values, covariances) = difference(joint, known, of);
    println!("known against joint: values {values:.1e}, covariances {covariances:.1e} standard uncertainties");
    assert!(values < 1e-6 && covariances < 1e-6, "{values:e}, {covariances:e}");

    // Both depend on the inputs in the same way, under one identity.
    let inputs = |it: &Calibration| -> Vec<(String, Vec<f64>)> {
        let names: Vec<usize> = (0..it.covariance.order.len()).filter(|&at| of(&it.covariance.order[at])).collect();
        let sorted = |input: &abbe_core::ConsideredInput| {
            let mut named: Vec<(&String, f64)> =
                names.iter().map(|&at| (&it.covariance.order[at], input.sensitivities[at])).collect();
            named.sort_by(|one, other| one.0.cmp(other.0));
            (input.identity.clone(), named.into_iter().map(|(_, value)| value).collect())
        };
        let mut all: Vec<_> = it.inputs.as_ref().expect("inputs").iter().map(sorted).collect();
        all.sort_by(|one, other| one.0.cmp(&other.0));
        all
    };
    let (one, other) = (inputs(joint), inputs(known));
    assert_eq!(one.len(), 2);
    for ((identity, one), (same, other)) in one.iter().zip(&other) {
        assert_eq!(identity, same);
        let largest = one.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
        for (one, other) in one.iter().zip(other) {
            assert!((one - other).abs() < 1e-6 * largest, "{identity}: {one:e}, {other:e}");
        }
    }
    // The calibration lists the files that it was made of: a third recipe that knows both days gets a message.
    assert!(known.data.len() == 3 && known.data.iter().all(|record| record.sha256.is_some()), "{:?}", known.data);
}

#[test]
fn a_file_starts_an_estimate_and_is_judged_and_exported_like_any_other() {
    let folder = temporary();
    let first = monday(&folder.path().join("monday"));
    let plain = with(tango(&[("two", 4, 3)]), "fit", estimate(&["two"]));
    let alone = run(&plain, &folder.path().join("alone"));
    let file = json!({ "estimate": "calibration", "path": "../monday/out/recipe/fit.calibration.json" });
    let mut recipe = with(plain, "monday", file);
    recipe.0["stages"]["fit"]["start"] = json!("monday");
    let limits = json!([{ "names": ["EA0B"], "expanded_urad": 1000.0 }]);
    let recipe = with(recipe, "enough", json!({ "validate": "uncertainty", "of": "monday", "parameters": limits }));
    let recipe =
        with(recipe, "agree", json!({ "validate": "consistency", "of": ["monday", "fit"], "parameters": ["E?0?"] }));
    let recipe =
        with(recipe, "unseen", json!({ "validate": "residuals", "of": "monday", "observations": ["bar-two"] }));
    let recipe =
        with(recipe, "table", json!({ "export": "error-table", "of": "monday", "step_mm": 100, "step_deg": 30 }));
    let recipe = with(recipe, "trials", json!({ "estimate": "monte-carlo", "of": "monday", "trials": 4000 }));
    let outcome = run(&recipe, &folder.path().join("tuesday"));

    let (values, covariances) =
        difference(&fit(&alone, "fit").calibration, &fit(&outcome, "fit").calibration, |name| name != "stylus_radius");
    assert!(values < 1e-6 && covariances < 1e-6, "a start changes nothing: {values:e}, {covariances:e}");
    let monday = &fit(&first, "fit").calibration;
    let recalled = &fit(&outcome, "monday").calibration;
    assert_eq!((&recalled.parameters, &recalled.covariance), (&monday.parameters, &monday.covariance));
    let trials = &fit(&outcome, "trials").calibration;
    for simulated in &trials.monte_carlo.as_ref().expect("trials").parameters {
        let known = monday.get(&simulated.name).expect("a value");
        let u = known.standard_uncertainty;
        assert!((simulated.standard_uncertainty / u - 1.0).abs() < 0.06, "{}", simulated.name);
        assert!((simulated.mean - known.value).abs() < 0.08 * u, "{}", simulated.name);
    }
    let verdict = |name: &str| outcome.verdicts.iter().find(|verdict| verdict.stage == name).expect("a verdict");
    assert!(verdict("enough").pass);
    assert!(
        verdict("agree")
            .remarks
            .iter()
            .any(|it| it.contains("share the errors of stylus_radius, bar-one.reference_error"))
    );
    assert!(verdict("unseen").figures.iter().any(|figure| figure.name == "max" && figure.value.is_some()));
    let written = tree(&folder.path().join("tuesday/out/recipe/table"));
    assert!(!written.is_empty());
}

#[test]
fn a_second_recipe_adds_errors_to_the_machine_of_the_first() {
    let folder = temporary();
    monday(&folder.path().join("monday"));
    let mut recipe = tango(&[("two", 4, 3)]);
    recipe.0["stages"]["hu40t"] =
        json!({ "model": "serial-chain", "machine": "monday", "errors": [{ "polynomial": ["EXB"], "degrees": [2] }] });
    let file = json!({ "estimate": "calibration", "path": "../monday/out/recipe/fit.calibration.json" });
    let mut more = estimate(&["two"]);
    more["parameters"].as_array_mut().expect("patterns").push(json!("EXB[2]"));
    let recipe = with(with(recipe, "monday", file), "fit", more);
    let outcome = run(&recipe, &folder.path().join("tuesday"));
    let calibration = &fit(&outcome, "fit").calibration;
    assert_eq!(calibration.get("EXB[2]").expect("the added error").status, Status::Estimated);
    assert_eq!(calibration.get("EA0B").expect("an error of the first").status, Status::Estimated);

    // An error in what was added is told where it stands in the second recipe.
    let mut wrong = recipe.clone();
    wrong.0["stages"]["hu40t"]["errors"][0]["degrees"] = json!(["two"]);
    let file = wrong.write(&folder.path().join("tuesday"));
    let told = prepare(&file, &registry()).map(drop).expect_err("a wrong degree").to_string();
    assert!(told.contains("errors[0].degrees"), "{told}");
}

#[test]
fn what_a_report_states_is_known_like_a_calibration() {
    let small = Small::new();
    small.write("report.csv", "parameter,value,unit,standard_uncertainty\nEXX[1],-8.5,um/m,0.5\nEX0C,0.012,mm,0\n");
    small.write("truth.json", r#"{ "parameters": { "EXX[1]": -8.5e-6, "EX0C": 0.012, "facet[3].d": 1 } }"#);
    let base = small.read("recipe.yaml");
    let stage = |line: &str| base.replace("  rough:\n", &format!("  laser: {line}\n  rough:\n"));
    let known = |text: String| {
        let text = text
            .replace("parameters: [\"@tool\", EX0C, \"EXX[1]\", \"table.*\"]", "parameters: [\"@tool\", \"table.*\"]");
        text.replace("    start: rough\n", "    known: laser\n")
    };
    small.write("recipe.yaml", &known(stage("{ estimate: stated, machine: machine, path: report.csv }")));
    let printed = small.abbe(&["run", "recipe.yaml"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let laser = json_file(&small.path("out/recipe/laser.calibration.json"));
    let of = |file: &Value, name: &str| -> Value {
        let all = file["parameters"].as_array().expect("parameters");
        all.iter().find(|it| it["name"] == name).expect("the parameter").clone()
    };
    let scale = of(&laser, "EXX[1]");
    assert!((scale["value"].as_f64().expect("a number") + 8.5e-6).abs() < 1e-18);
    assert_eq!((&scale["status"], &of(&laser, "EX0C")["status"]), (&json!("estimated"), &json!("fixed")));
    let fine = json_file(&small.path("out/recipe/fine.calibration.json"));
    assert_eq!(of(&fine, "EXX[1]")["status"], "considered");
    assert_eq!(of(&fine, "EX0C")["value"], 0.012);
    let budget = fine["uncertainty"]["parameters"].as_array().expect("a budget");
    assert!(
        budget.iter().any(|it| it["contributions"]
            .as_array()
            .expect("parts")
            .iter()
            .any(|part| part["input"] == "laser"))
    );

    // A truth names artefacts without their stage: they are of no concern.
    small
        .write("recipe.yaml", &stage("{ estimate: stated, machine: machine, path: truth.json, ignore: [\"facet*\"] }"));
    assert_eq!(small.abbe(&["run", "recipe.yaml"]).status, 0);
    let cases = [
        ("unknown_parameter", "{ estimate: stated, machine: machine, path: truth.json }"),
        ("wrong_unit", "{ estimate: stated, machine: machine, values: { EX0C: { value: 1, unit: um/m } } }"),
        ("misspelt_parameter", "{ estimate: stated, machine: machine, values: { EX0D: { value: 1, unit: um } } }"),
        ("nothing_stated", "{ estimate: stated, machine: machine }"),
        ("parameters_of_a_statement", "{ estimate: stated, machine: machine, path: report.csv, parameters: [EX0C] }"),
        ("no_machine", "{ estimate: stated, path: report.csv }"),
        ("no_file", "{ estimate: calibration, path: tuesday.json }"),
        ("no_calibration", "{ estimate: calibration, path: truth.json }"),
        (
            "no_such_input",
            "{ artefact: length, from: runs, standard_uncertainty_um: 1, id: { reference_eror: bar 7 } }",
        ),
    ];
    let mut said = String::new();
    for (case, line) in cases {
        let observed = case == "no_such_input";
        let text = stage(line);
        let text = if observed { text.replace("[table, bar]", "[table, bar, laser]") } else { text };
        small.write("recipe.yaml", &text);
        let printed = small.abbe(&["run", "recipe.yaml"]);
        said.push_str(&format!("# {case}: {}\n{}{}\n", printed.status, printed.stdout, printed.stderr));
    }
    insta::assert_snapshot!("statements_and_files_that_are_refused", said);
}

#[test]
fn rows_do_not_count_twice() {
    let small = Small::new();
    let base = small.read("recipe.yaml");
    let known = base.replace("    start: rough\n", "    known: rough\n");
    small.write("recipe.yaml", &known);
    for command in ["check", "run"] {
        let printed = small.abbe(&[command, "recipe.yaml"]);
        assert_eq!(printed.status, 2, "{}", printed.stdout);
        for told in
            ["`fine` rests on rows on which `rough` rests already", "touches.csv rows 1 to 60", "lengths.csv rows 1"]
        {
            assert!(printed.stderr.replace("\n  │ ", " ").contains(told), "{told}: {}", printed.stderr);
        }
    }
    small.write("recipe.yaml", &known.replace("    known: rough\n", "    known: rough\n    shared_rows: accepted\n"));
    assert_eq!(small.abbe(&["run", "recipe.yaml"]).status, 0);

    // A copy under another name is the same measurement, and a calibration knows what it was made of.
    small.write("recipe.yaml", &base);
    assert_eq!(small.abbe(&["run", "recipe.yaml"]).status, 0);
    small.write("data/copy.csv", &small.read("data/touches.csv"));
    let file = "  rough: { estimate: calibration, path: out/recipe/rough.calibration.json }\n";
    let (before, rest) = known.split_once("  rough:\n").expect("the stage");
    let (_, after) = rest.split_once("  fine:\n").expect("the stage");
    let other = format!("{before}{file}  fine:\n{after}").replace("data/touches.csv", "data/copy.csv");
    small.write("other.yaml", &other.replace("of: [rough, fine]", "of: fine"));
    let printed = abbe(small.folder.path(), &["check", "other.yaml"]);
    assert!(
        printed.status == 2 && printed.stderr.replace("\n  │ ", " ").contains("copy.csv rows 1 to 60"),
        "{}",
        printed.stderr
    );
}

#[test]
fn what_cannot_be_combined_is_refused_by_name() {
    let other = json!({ "estimate": "combine", "of": ["fit", "less"] });
    let mut less = estimate(&["two"]);
    less["parameters"] = json!(["dxt", "dyt", "dzt", "EXX[1]", "EYY[1]", "E?0?", "E??[b]", "table-two.*"]);
    let recipe = with(tango(&[("one", 1, 2), ("two", 4, 3)]), "fit", estimate(&["one"]));
    let recipe = with(with(recipe, "less", less), "both", other);
    let told = error_of(&recipe);
    assert!(told.contains("`fit` has estimated EZZ[1], which `less` holds"), "{told}");

    let mut same = with(tango(&[("one", 1, 2)]), "fit", estimate(&["one"]));
    same.0["stages"]["again"] = same.0["stages"]["fit"].clone();
    let told = error_of(&with(same, "both", json!({ "estimate": "combine", "of": ["fit", "again"] })));
    assert!(told.contains("would count twice"), "{told}");

    // Two days of a machine whose scale was read wrong on one of them.
    let mut recipe = with(tango(&[("one", 1, 2), ("two", 4, 3)]), "fit", estimate(&["one"]));
    recipe = with(recipe, "later", estimate(&["two"]));
    recipe = with(
        recipe,
        "laser",
        json!({ "estimate": "stated", "machine": "hu40t", "values": {
        "EXX[1]": { "value": 500.0, "standard_uncertainty": 0.5, "unit": "um/m" } } }),
    );
    let told = error_of(&with(recipe, "both", json!({ "estimate": "combine", "of": ["fit", "laser"] })));
    assert!(told.contains("do not agree") && told.contains("EXX[1] of"), "{told}");
}
