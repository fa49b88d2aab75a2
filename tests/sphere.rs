//! The machine as a measuring machine (Rahman 2016, chapter 6): a sphere on the table against the figures of an independent
//! evaluation (`tests/truth/sphere-hu40t-*.json`). Estimates never see the truth.

use std::sync::{Arc, OnceLock};

use abbe_core::{Build, Context, Figure, Findings, Fit, Kind, Status};
use abbe_engine::Outcome;
use serde_json::{Value, json};

use crate::support::{Variant, effect, fit, json_file, recipes, registry, root, values};

fn truth(data: &str) -> Value {
    json_file(&root().join(format!("tests/truth/sphere-hu40t-{data}.json")))
}

fn recipe(data: &str) -> Variant {
    Variant::of(&recipes()[if data == "exact" { "sphere-hu40t-exact" } else { "sphere-hu40t" }])
}

/// The recipe as it stands in the repository, run once for all tests.
fn outcome(data: &str) -> &'static Outcome {
    static EXACT: OnceLock<Outcome> = OnceLock::new();
    static REALISTIC: OnceLock<Outcome> = OnceLock::new();
    let once = if data == "exact" { &EXACT } else { &REALISTIC };
    once.get_or_init(|| recipe(data).run())
}

fn figure(figures: &[Figure], of: &str, name: &str) -> f64 {
    let found = figures.iter().find(|figure| figure.of.as_deref() == Some(of) && figure.name == name);
    found.and_then(|figure| figure.value).unwrap_or_else(|| panic!("no figure {name} of {of}"))
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// Asserts the figures of one model to 1e-3 um.
fn agree(figures: &[Figure], of: &str, expected: &Value, what: &str) {
    for (name, key, factor) in [
        ("out of sphericity", "out_of_sphericity_um", 1.0),
        ("max", "max_residual_um", 1.0),
        ("min", "min_residual_um", 1.0),
        ("standard deviation", "std_residual_um", 1.0),
        ("diameter", "diameter_mm", 1e3),
        ("size error", "size_error_um", 1.0),
    ] {
        let off = (figure(figures, of, name) * factor - number(&expected[key]) * factor).abs();
        assert!(off < 1e-3, "{what}: {name} of {of} is off by {off} um");
    }
}

/// The figures that the verdict of a stage has.
fn figures<'a>(outcome: &'a Outcome, stage: &str) -> &'a [Figure] {
    &outcome.verdicts.iter().find(|verdict| verdict.stage == stage).expect("a verdict").figures
}

const STRATEGIES: [(&str, &str); 2] = [("calibration-set", "strategy_1"), ("validation-set", "strategy_2")];

#[test]
fn figures_of_the_nominal_model() {
    for data in ["exact", "realistic"] {
        let truth = truth(data);
        for (stage, strategy) in STRATEGIES {
            let found = figures(outcome(data), stage);
            agree(found, "nominal", &truth["sphericity"][strategy]["nominal_model"], &format!("{data} {strategy}"));
            assert_eq!(figure(found, "nominal", "points"), number(&truth["sphericity"][strategy]["touches"]));
        }
    }
}

/// What a validator finds with these settings in a fit, and in a file of data.
fn judged(settings: &Value, fit: &Fit, file: Option<&str>) -> Findings {
    let registry = registry();
    let plugin = registry.find(Kind::Validate, "sphericity").expect("it is built in");
    let Build::Validate(constructor) = &plugin.build else { panic!("it is a validator") };
    let validator = constructor.build(settings, &Context { base: root() }).expect("its settings are right");
    let data: Vec<_> = file.iter().map(|file| read_csv(file)).collect();
    validator.validate(&[fit], &data.iter().collect::<Vec<_>>()).expect("it finds something")
}

fn read_csv(file: &str) -> abbe_core::Dataset {
    let registry = registry();
    let plugin = registry.find(Kind::Ingest, "csv").expect("it is built in");
    let Build::Ingest(constructor) = &plugin.build else { panic!("it is an ingest") };
    let ingest =
        constructor.build(&json!({ "path": file }), &Context { base: root() }).expect("its settings are right");
    ingest.read().expect("the file of the repository")
}

/// The fit of the recipe with the true values in place of the estimated ones.
fn given_truth(data: &str) -> Fit {
    let estimated = fit(outcome(data), "fit");
    let truth = truth(data);
    let mut calibration = estimated.calibration.clone();
    for parameter in &mut calibration.parameters {
        parameter.value = truth["parameters"].get(&parameter.name).map_or(0.0, number);
    }
    let (problem, estimator) = (Arc::clone(&estimated.problem), Arc::clone(&estimated.estimator));
    Fit { name: "given".to_owned(), problem, estimator, calibration }
}

#[test]
fn figures_of_a_given_model() {
    for data in ["exact", "realistic"] {
        let (given, sphericity) = (given_truth(data), &truth(data)["sphericity"]);
        let found = judged(&json!({ "rows": "sphere" }), &given, None).figures;
        agree(&found, "given", &sphericity["strategy_1"]["true_model"], &format!("{data} strategy_1"));
        for number in [1, 2] {
            let file = format!("pipelines/data/sphere-hu40t/{data}/touches-{number}.csv");
            let found = judged(&json!({ "diameter_mm": 19.05 }), &given, Some(&file)).figures;
            let what = format!("{data} {file}");
            agree(&found, "given", &sphericity[format!("strategy_{number}")]["true_model"], &what);
        }
    }
}

#[test]
fn single_errors() {
    for data in ["exact", "realistic"] {
        let truth = &truth(data)["sphericity"]["one_at_a_time"]["effects"];
        let found = figures(outcome(data), "calibration-set");
        // Noise of a micrometre turns directions of touching by 1e-4.
        let tolerance = if data == "exact" { 1e-8 } else { 2e-4 };
        let mut compared = 0;
        for error in truth.as_array().expect("a list").iter().filter(|error| error["parameter"] != "none") {
            let name = error["parameter"].as_str().expect("a name");
            for (figure_name, key) in [("size error", "size_error_mm"), ("out of sphericity", "out_of_sphericity_mm")] {
                let off = figure(found, "fit", &format!("{figure_name}[{name}]")) - 1e3 * number(&error[key]);
                assert!(off.abs() < tolerance, "{data}: {figure_name} of {name} is off by {off:e} um");
            }
            compared += 1;
        }
        assert_eq!(compared, 13);
    }
}

/// The table of the data's README to its digits: size error in nm, out of sphericity in um, each with its last digit.
#[test]
fn single_errors_as_they_are_printed() {
    let printed = [
        ("EA0B", -11.0, 1.0, 1.26),
        ("EA0C", 3.1, 0.1, 1.36),
        ("EA0Y", 8.0, 0.1, 1.90),
        ("EB0C", -11.0, 1.0, 1.36),
        ("EB0Z", 20.0, 1.0, 1.18),
        ("EC0B", -9.3, 0.1, 1.36),
        ("EC0Y", 7.4, 0.1, 0.45),
        ("EX0C", -0.02, 0.01, 2.28),
        ("EY0S", -3.2, 0.1, 2.31),
        ("EX0S", -0.03, 0.01, 2.07),
        ("EXX[1]", -77.0, 1.0, 0.70),
        ("EYY[1]", -14.0, 1.0, 0.30),
        ("EZZ[1]", -320.0, 10.0, 1.82),
    ];
    let found = figures(outcome("exact"), "calibration-set");
    for (name, size, digit, form) in printed {
        let size_error = figure(found, "fit", &format!("size error[{name}]")) * 1e3;
        assert!((size_error - size).abs() <= 0.6 * digit, "size error of {name}: {size_error} nm, printed {size}");
        let off = (figure(found, "fit", &format!("out of sphericity[{name}]")) - form).abs();
        assert!(off <= 0.006, "out of sphericity of {name} is off by {off} um");
    }
}

#[test]
fn exact_data_give_the_truth_and_the_sphere_back() {
    let truth = truth("exact");
    let calibration = &fit(outcome("exact"), "fit").calibration;
    let mut compared = 0;
    for (name, value) in truth["parameters"].as_object().expect("parameters") {
        let name = if name.starts_with("ball[") { format!("sphere.{name}") } else { name.clone() };
        let estimated = calibration.get(&name).unwrap_or_else(|| panic!("{name} is missing"));
        let (is_angle, factor) = effect(&estimated.unit);
        let off = (estimated.value - number(value)).abs() * factor;
        assert!(off < if is_angle { 1e-10 } else { 1e-8 }, "{name} is off by {off:e}");
        compared += 1;
    }
    assert_eq!(compared, 19);
    assert_eq!((calibration.fit.rank, calibration.fit.unknowns, calibration.fit.observations), (17, 17, 428));
    assert!((calibration.fit.condition - 97.0).abs() < 0.5, "{}", calibration.fit.condition);
    for (stage, _) in STRATEGIES {
        assert!(figure(figures(outcome("exact"), stage), "fit", "out of sphericity") < 1e-5);
    }
}

#[test]
fn noisy_data_give_the_truth_back_within_the_stated_uncertainty() {
    let (truth, calibration) = (truth("realistic"), &fit(outcome("realistic"), "fit").calibration);
    let mut errors = Vec::new();
    for estimated in values(calibration).filter(|estimated| estimated.status == Status::Estimated) {
        let name = estimated.name.strip_prefix("sphere.").unwrap_or(&estimated.name);
        // The truth has the drift in another form, and dzt where it begins.
        if let Some(value) = truth["parameters"].get(name).filter(|_| name != "dzt") {
            errors.push((number(value) - estimated.value) / estimated.standard_uncertainty);
        }
    }
    assert_eq!(errors.len(), 16);
    assert!(errors.iter().all(|error| error.abs() < 3.5), "{errors:?}");
    for (stage, _) in STRATEGIES {
        let found = figures(outcome("realistic"), stage);
        let better = figure(found, "nominal", "out of sphericity") / figure(found, "fit", "out of sphericity");
        assert!(better > 40.0, "{stage}: better by the factor {better}");
    }
}
