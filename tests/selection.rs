//! Terms that chance alone explains are left out: a laser along one axis with a scale that bends at two knots of nine.

use abbe_core::SelectionDirection;
use abbe_numerics::Generator;
use serde_json::{Value, json};

use crate::support::{Variant, abbe, fit, read, temporary, write};

const KNOTS: [f64; 9] = [50.0, 100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0, 450.0];

/// What the scale is off at a position, mm: it bends at knots 3 and 7.
fn scale_error(x: f64) -> f64 {
    let beyond = |knot: f64| (x - knot).max(0.0);
    2e-5 * x - 4e-8 * x * x + 6e-7 * beyond(KNOTS[2]).powi(2) - 8e-7 * beyond(KNOTS[6]).powi(2)
}

/// Lengths from the start of the axis, with 0.2 µm of noise.
fn lengths(seed: u64) -> String {
    let mut random = Generator::new(seed, 0);
    let mut text = "length,X1_mm,X2_mm,reference_mm\n".to_owned();
    for run in 0..2 {
        for step in 1..=50 {
            let x = 10.0 * f64::from(step);
            let reference = x + scale_error(x) + 2e-4 * random.normal();
            text.push_str(&format!("{},0,{x},{reference:.7}\n", run * 50 + step));
        }
    }
    text
}

fn recipe(select: Value) -> Variant {
    let knots: Vec<f64> = KNOTS.to_vec();
    Variant(json!({
        "abbe": 1,
        "name": "A laser along one axis",
        "stages": {
            "lengths": { "ingest": "csv", "path": "lengths.csv" },
            "laser": { "artefact": "length", "from": "lengths", "standard_uncertainty_um": 0.2 },
            "machine": { "model": "serial-chain", "chain": "w b X t", "tool_length_mm": 100, "stylus_radius_mm": 0,
                "axes": { "X": { "range_mm": [0, 500] } },
                "errors": [{ "piecewise": ["EXX"], "degree": 2, "continuity": 1, "knots_mm": knots }] },
            "fit": { "estimate": "gauss-newton", "machine": "machine", "observations": ["laser"],
                "parameters": ["EXX*"], "select": select },
            "rows": { "validate": "influence", "of": "fit" },
        },
    }))
}

/// The recipe on data of its own.
fn run(select: Value, seed: u64) -> abbe_engine::Outcome {
    let folder = temporary();
    let data = folder.path().join("lengths.csv");
    write(&data, &lengths(seed));
    recipe(select).set("lengths", "path", json!(data)).run()
}

#[test]
fn knots_that_bend_the_scale_are_kept_and_others_dropped() {
    for direction in ["backward", "forward", "both"] {
        let mut surplus = 0;
        for seed in 0..6 {
            let select = json!({ "candidates": ["EXX[pp*"], "level": 1e-4, "direction": direction });
            let outcome = run(select, seed);
            let calibration = &fit(&outcome, "fit").calibration;
            let selection = calibration.fit.selection.as_ref().expect("a selection");
            // Forwards, knots beside the right ones may come in first and stay.
            if direction != "forward" {
                for knot in ["EXX[pp3,2]", "EXX[pp7,2]"] {
                    assert!(selection.kept.iter().any(|kept| kept == knot), "{direction} {seed}: {:?}", selection.kept);
                }
            }
            assert_eq!(selection.kept.len() + selection.left_out.len(), 9);
            surplus += selection.kept.len() - 2;
            // A parameter that is left out is zero and is not used. The kept ones have the values of a fit of them alone.
            assert_eq!(calibration.fit.rank, 2 + selection.kept.len());
            for name in &selection.left_out {
                let left_out = calibration.get(name).expect("a parameter");
                assert_eq!((left_out.value, left_out.standard_uncertainty), (0.0, 0.0));
            }
            for step in &selection.steps {
                assert_eq!(step.probability < selection.level, step.entered, "{step:?}");
            }
        }
        let most = if direction == "forward" { 30 } else { 5 };
        assert!(surplus <= most, "{direction}: {surplus} surplus knots in six data sets");
    }
}

#[test]
fn a_selection_is_told_and_can_be_propagated() {
    let folder = temporary();
    write(&folder.path().join("lengths.csv"), &lengths(3));
    let mut recipe = recipe(json!({ "candidates": ["EXX[pp*"] }));
    recipe.0["stages"]["trials"] = json!({ "estimate": "monte-carlo", "of": "fit", "trials": 2000 });
    recipe.0["stages"]["table"] = json!({ "export": "error-table", "of": "fit", "band_probability": 0.95 });
    let file = recipe.write(folder.path());
    let file = file.to_str().expect("text");
    let printed = abbe(folder.path(), &["run", file, "--out", "results"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    assert!(printed.stdout.contains("fit: 2 of 9 at level 0.0001: EXX[pp3,2] EXX[pp7,2]"), "{}", printed.stdout);
    let results = folder.path().join("results").join("recipe");
    assert_eq!(read(&results.join("rows/fit.csv")).lines().count(), 101);
    // Trials select anew: most keep the same knots and scatter as the fit says, a few take others.
    let calibration = abbe_core::Calibration::from_json(&read(&results.join("trials.calibration.json")));
    let trials = calibration.expect("a calibration").monte_carlo.expect("trials");
    let of = |name: &str| trials.parameters.iter().find(|parameter| parameter.name == name).expect("a parameter");
    assert!(of("EXX[pp1,2]").gum.is_none(), "no uncertainty is stated of what is left out");
    let kept = of("EXX[pp3,2]");
    let gum = kept.gum.as_ref().expect("a stated uncertainty");
    assert!(gum.validated, "{kept:?}");
    assert!(kept.standard_uncertainty * 2.0 > 0.5 * (gum.interval[1] - gum.interval[0]), "{kept:?}");
}

#[test]
fn selections_that_make_no_sense_are_refused() {
    let cases = [
        (json!({ "candidates": [] }), "there is nothing to choose from"),
        (json!({ "candidates": ["EXX[pp*"], "level": 5 }), "a probability between 0 and 1 was expected"),
        (json!({ "candidates": ["EYY*"] }), "`EYY*` matches no parameter of the machine that is estimated"),
    ];
    for (select, expected) in cases {
        let folder = temporary();
        write(&folder.path().join("lengths.csv"), &lengths(0));
        let file = recipe(select).write(folder.path());
        let printed = abbe(folder.path(), &["run", file.to_str().expect("text")]);
        assert_eq!(printed.status, 2, "{}", printed.stderr);
        assert!(printed.stderr.contains(expected), "{}", printed.stderr);
    }
    assert_eq!(SelectionDirection::default(), SelectionDirection::Backward);
}

/// The recipe with one unknown and a search for what else could explain the residuals; `off` is added to the reference of a row.
fn blamed(off: impl Fn(usize) -> f64, covariance: Option<&str>, robust: bool) -> String {
    let folder = temporary();
    let mut random = Generator::new(7, 0);
    let mut text = "length,X1_mm,X2_mm,reference_mm\n".to_owned();
    for row in 1..=50 {
        let x = 10.0 * row as f64;
        let reference = x * (1.0 + 2e-6) + 1e-4 * (x / 500.0).powi(2) + off(row) + 2e-4 * random.normal();
        text.push_str(&format!("{row},0,{x},{reference:.7}\n"));
    }
    write(&folder.path().join("lengths.csv"), &text);
    let mut recipe = recipe(json!(null));
    let stages = recipe.0["stages"].as_object_mut().expect("stages");
    stages.remove("rows");
    stages["fit"] = json!({ "estimate": "gauss-newton", "machine": "machine", "observations": ["laser"], "parameters": ["EXX[2]"] });
    stages.insert("why".to_owned(), json!({ "validate": "cause", "of": "fit", "candidates": ["EXX[1]"] }));
    if robust {
        stages["fit"]["robust"] = json!("tukey");
    }
    if let Some(covariance) = covariance {
        write(&folder.path().join("covariance.csv"), covariance);
        stages["laser"]["uncertainty"] = json!({ "covariance": "covariance.csv" });
    }
    let printed = abbe(folder.path(), &["run", recipe.write(folder.path()).to_str().expect("text")]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    printed.stdout
}

/// By how much the scale is said to have changed, um/m; it is 2.
fn change(told: &str) -> f64 {
    let (_, rest) = told.split_once("fit: EXX[1] changed by ").unwrap_or_else(|| panic!("{told}"));
    rest.split_whitespace().next().and_then(|number| number.parse().ok()).expect("a number")
}

#[test]
fn rows_that_are_left_out_do_not_decide_on_a_cause() {
    let wrong = |row: usize| if row == 49 { 0.05 } else { 0.0 };
    let told = blamed(wrong, None, true);
    assert!((change(&told) - 2.0).abs() < 0.6, "{told}");
    assert!((change(&blamed(|_| 0.0, None, true)) - change(&told)).abs() < 0.2, "{told}");
}

#[test]
fn what_rows_have_in_common_is_no_cause() {
    // All references are off by 4 um, which the covariance allows for.
    let common = |of: usize| (1..=50).map(move |row| if row == of { 25.04 } else { 25.0 });
    let mut covariance = format!("length{}\n", (1..=50).map(|row| format!(",{row}_um2")).collect::<String>());
    for row in 1..=50 {
        covariance.push_str(&format!("{row}{}\n", common(row).map(|entry| format!(",{entry}")).collect::<String>()));
    }
    let independent = change(&blamed(|_| 0.004, None, false));
    assert!((independent - 2.0).abs() > 5.0, "taken as independent, the rows blame the scale: {independent}");
    let correlated = blamed(|_| 0.004, Some(&covariance), false);
    assert!(correlated.contains("no single error explains the residuals better than chance does"), "{correlated}");
}

#[test]
fn influence_is_that_of_independent_rows() {
    let folder = temporary();
    write(&folder.path().join("lengths.csv"), &lengths(3));
    let labels = || 1..=100;
    let mut covariance = format!("length{}\n", labels().map(|row| format!(",{row}_um2")).collect::<String>());
    for row in labels() {
        let entry = |of: i32| if of == row { ",0.05" } else { ",0.01" };
        covariance.push_str(&format!("{row}{}\n", labels().map(entry).collect::<String>()));
    }
    write(&folder.path().join("covariance.csv"), &covariance);
    let mut recipe = recipe(json!(null));
    recipe.stage("laser")["uncertainty"] = json!({ "covariance": "covariance.csv" });
    let printed = abbe(folder.path(), &["run", recipe.write(folder.path()).to_str().expect("text")]);
    assert_eq!(printed.status, 2, "{}", printed.stderr);
    assert!(printed.stderr.contains("influence is that of rows that are independent"), "{}", printed.stderr);
}
