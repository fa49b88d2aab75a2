//! A milling machine with bodies that grow and bend: factors from touches, what stated coefficients of expansion leave uncertain, and
//! temperatures that are not there.

use std::collections::BTreeMap;
use std::fs;

use abbe_core::{Calibration, Problem, Unit};
use abbe_engine::prepare;
use abbe_numerics::Generator;
use abbe_simulation::{Noise, StandardDeviation, Truth, measure};
use serde_json::{Value, json};

use crate::controls::law::seeds;
use crate::support::{Variant, fit, json_file, read, recipes, registry, root, temporary};

const BODIES: [&str; 5] = ["column", "ram", "head", "tool", "scale-x"];

fn recipe() -> Variant {
    Variant::of(&recipes()["mill-warming"])
}

/// The true values of the data set.
fn values() -> BTreeMap<String, f64> {
    let truth = json_file(&root().join("tests/truth/mill-warming.json"));
    let parameters = truth["parameters"].as_object().expect("parameters");
    parameters.iter().map(|(name, value)| (name.clone(), value.as_f64().expect("a number"))).collect()
}

/// Those of a random machine: geometry of the same size, and factors up to a fifth from 1.
fn random_values(seed: u64) -> BTreeMap<String, f64> {
    let mut random = Generator::new(171, seed);
    let mut truth = values();
    for (name, value) in &mut truth {
        *value = match name.starts_with("body[") {
            true => 1.0 + 0.1 * random.normal(),
            false => 1.5 * value.abs() * random.normal(),
        };
    }
    truth
}

fn own_name(name: &str) -> &str {
    name.strip_prefix("cubes.").unwrap_or(name)
}

fn measured(problem: &Problem, parameters: &BTreeMap<String, f64>, sigma: f64, seed: u64) -> Problem {
    let probing_sigma_mm = StandardDeviation::ByStage([("cubes".to_owned(), sigma)].into());
    let truth = Truth { parameters: parameters.clone(), noise: Noise { probing_sigma_mm, ..Noise::default() } };
    measure(problem, &truth, seed).unwrap_or_else(|error| panic!("{error}"))
}

/// Error and standard uncertainty of the unknowns that the truth has, by name.
fn errors(calibration: &Calibration, truth: &BTreeMap<String, f64>) -> Vec<(String, f64, f64)> {
    let of = |parameter: &abbe_core::Estimated| {
        let error = parameter.value - truth.get(own_name(&parameter.name))?;
        Some((parameter.name.clone(), error, parameter.standard_uncertainty))
    };
    calibration.parameters.iter().filter_map(of).collect()
}

fn exactly(problem: &Problem, name: &str) -> f64 {
    let unknown = problem.unknowns.iter().find(|unknown| unknown.name == name).expect("an unknown");
    match unknown.unit {
        Unit::MM => 1e-8,
        unit if unit.to_string() == "1" => 1e-6,
        _ => 1e-11,
    }
}

#[test]
fn exact_touches_give_geometry_and_factors_back() {
    let outcome = recipe().only(&["fit"]).run();
    let planned = fit(&outcome, "fit");
    for seed in seeds(8) {
        let truth = random_values(seed);
        let problem = measured(&planned.problem, &truth, 0.0, seed);
        let calibration = planned.estimator.estimate(&problem).unwrap_or_else(|error| panic!("{seed}: {error}"));
        let found = errors(&calibration, &truth);
        assert_eq!(found.len(), 10);
        for (name, error, _) in found {
            assert!(error.abs() < exactly(&problem, &name), "seed {seed}: {name} is off by {error:e}");
        }
    }
}

/// The touches of the recipe hold the truth, with the factors; without temperatures they do not.
#[test]
fn what_bends_is_no_geometry() {
    let outcome = recipe().only(&["fit", "fit-without"]).run();
    let [with, without] = ["fit", "fit-without"].map(|name| fit(&outcome, name));
    let largest = |calibration: &Calibration, truth: &BTreeMap<String, f64>| {
        errors(calibration, truth).iter().map(|(_, error, u)| (error / u).abs()).fold(0.0, f64::max)
    };
    let truth = values();
    assert!(largest(&with.calibration, &truth) < 4.0, "{:?}", errors(&with.calibration, &truth));
    assert!(largest(&without.calibration, &truth) > 8.0);
    for seed in seeds(8) {
        let truth = random_values(100 + seed);
        let problem = measured(&with.problem, &truth, 1e-3, seed);
        let right = with.estimator.estimate(&problem).unwrap_or_else(|error| panic!("{error}"));
        assert!(largest(&right, &truth) < 5.0, "seed {seed}: {:?}", errors(&right, &truth));
        // The same readings for the other estimate.
        let other = Problem { sets: problem.sets.clone(), ..without.problem.as_ref().clone() };
        let wrong = without.estimator.estimate(&other).unwrap_or_else(|error| panic!("{error}"));
        let wrong = largest(&wrong, &truth);
        assert!(wrong > 4.0, "seed {seed}: {wrong} standard uncertainties without temperatures");
    }
}

/// Mean square of error over uncertainty, of the geometry, if coefficients of expansion are off as their uncertainty says.
fn chi_square(recipe: &Variant, sets: u64) -> (f64, Calibration) {
    let outcome = recipe.run();
    let planned = fit(&outcome, "fit-stated");
    let uncertainties = [0.6 / 10.5, 0.6 / 11.5, 0.6 / 11.5, 0.6 / 11.5, 0.3 / 10.6];
    let (mut sum, mut count) = (0.0, 0.0);
    for seed in seeds(sets) {
        let mut random = Generator::new(5, seed);
        let mut truth = values();
        for (name, uncertainty) in BODIES.iter().zip(uncertainties) {
            truth.insert(format!("body[{name}].factor"), 1.0 + uncertainty * random.normal());
        }
        let problem = measured(&planned.problem, &truth, 1e-3, seed);
        let calibration = planned.estimator.estimate(&problem).unwrap_or_else(|error| panic!("{error}"));
        for (_, error, u) in errors(&calibration, &truth) {
            sum += (error / u).powi(2);
            count += 1.0;
        }
    }
    (sum / count, planned.calibration.clone())
}

#[test]
fn stated_coefficients_of_expansion_are_part_of_the_uncertainty() {
    let recipe = recipe().only(&["fit-stated"]);
    let (right, calibration) = chi_square(&recipe, 30);
    let considered = calibration.inputs.clone().unwrap_or_default();
    for name in BODIES {
        let name = format!("body[{name}].factor");
        assert!(considered.iter().any(|input| input.name == name), "{name}");
        assert!(calibration.covariance.index(&name).is_some(), "{name}");
    }
    assert!((0.7..1.4).contains(&right), "{right}");
    // As if all were known.
    let mut known = recipe.clone();
    let machine = machine();
    known.stage("mill")["bodies"] = machine["bodies"].clone();
    for name in BODIES {
        known.stage("mill")["bodies"][name]["standard_uncertainty_per_K"] = json!(0);
    }
    let (wrong, _) = chi_square(&known, 30);
    assert!(wrong > 1.5 * right, "{wrong} {right}");
}

/// The machine file.
fn machine() -> Value {
    serde_yaml::from_str(&read(&recipe().path("mill", "file"))).expect("YAML")
}

#[test]
fn a_calibration_is_the_same_machine_again() {
    let outcome = recipe().only(&["fit"]).run();
    let fit = fit(&outcome, "fit");
    let read = Calibration::from_json(&fit.calibration.to_json().expect("JSON")).expect("a calibration");
    let settings = &read.model.settings["bodies"];
    let names = |body: &str| settings[body]["log"].as_object().map(|log| log.keys().cloned().collect::<Vec<_>>());
    assert_eq!(names("tool").unwrap_or_default(), ["H1_degC", "air_degC", "n_rpm", "time_s"]);
    assert_eq!(names("ram").unwrap_or_default().len(), 13);
    let registry = registry();
    let plugin = registry.find(abbe_core::Kind::Model, "serial-chain").expect("the plugin");
    let abbe_core::Build::Model(constructor) = &plugin.build else { panic!("a model") };
    let context = abbe_core::Context { base: ".".into() };
    let again = constructor.build(&read.model.settings, &context).expect("settings").build(&[]).expect("a model");
    let first = &fit.problem.model;
    let width = first.info().status.len();
    let time = first.info().status.iter().position(|status| status.name == "time").expect("a time");
    for z in [0.0, 250.0, 600.0] {
        let mut status = vec![0.0; width];
        status[2] = z;
        status[time] = 9000.0;
        let pose = |model: &dyn abbe_core::KinematicModel| {
            let mut out = abbe_core::Poses::default();
            model.poses(&status, &model.info().nominal, &[], false, &mut out).expect("a pose");
            out.positions[0]
        };
        assert_eq!(pose(first.as_ref()), pose(again.as_ref()));
    }
}

#[test]
fn temperatures_that_are_not_there_are_told() {
    let folder = temporary();
    let path = recipe().path("sensors", "path");
    let text = read(&path);
    let refused = |log: &str, change: &dyn Fn(&mut Variant)| {
        let mut variant = recipe().only(&["fit"]);
        fs::write(folder.path().join("log.csv"), log).expect("a file");
        variant.stage("sensors")["path"] = json!(folder.path().join("log.csv"));
        // What stands in a file cannot be taken away from a recipe.
        let mill = variant.stage("mill").as_object_mut().expect("a stage");
        mill.remove("file");
        mill.extend(machine().as_object().expect("a machine").clone());
        change(&mut variant);
        let prepared = prepare(&variant.write(folder.path()), &registry());
        let error = prepared.and_then(|prepared| prepared.check().map(drop)).expect_err("it is refused");
        format!("{error} {}", error.help.clone().unwrap_or_default())
    };
    let same = |_: &mut Variant| {};
    let without = |name: &str| text.replace(&format!("{name}_degC"), "another_degC");

    // The sensor is in neither: where it is missing, and what to do.
    let head_alone = |variant: &mut Variant| {
        let head = variant.stage("mill")["bodies"]["head"].clone();
        variant.stage("mill")["bodies"] = json!({ "head": head });
        variant.stage("mill")["bodies"]["head"].as_object_mut().expect("a body").remove("reference_until_s");
        variant.stage("fit")["parameters"] = json!(["dzt", "body[head].factor", "cubes.*"]);
    };
    let said = refused(&without("H3"), &head_alone);
    assert!(said.contains("the machine has no log with the column `H3_degC`, and"), "{said}");
    assert!(said.contains("touches.csv does not have it either") && said.contains("`logs` at the machine"), "{said}");
    // The line of this sensor (or of the numbers in it).
    let written = read(&folder.path().join("recipe.yaml"));
    let line = said.split(':').nth(1).and_then(|line| line.parse::<usize>().ok()).expect("a line");
    let near: String = written.lines().skip(line - 2).take(2).collect();
    assert!(near.contains("\"H3\""), "{said} {near}");
    // Idle minutes are those of a log.
    let said = refused(&without("R11"), &same);
    assert!(said.contains("`R11` is no column of a log of the machine; only a log has idle minutes"), "{said}");
    let no_logs = |variant: &mut Variant| {
        variant.stage("mill").as_object_mut().expect("a stage").remove("logs");
    };
    let said = refused(&text, &no_logs);
    assert!(said.contains("name the log by `logs: sensors` at the machine"), "{said}");
    // What turns needs speeds.
    let said = refused(&text.replace("n_rpm", "n2_rpm"), &same);
    assert!(said.contains("the log has no column of numbers `n`"), "{said}");
    // A sensor that is no temperature.
    let said = refused(&text.replace("H2_degC", "H2_mm"), &same);
    assert!(said.contains("the column `H2` of the log is no temperature: `H2_degC` was expected"), "{said}");
    // A clock of another time zone, a gap, a sensor that is stuck.
    let rows: Vec<&str> = text.lines().collect();
    let moved = |row: &str| match row.split_once(',').and_then(|(time, rest)| Some((time.parse::<f64>().ok()?, rest))) {
        Some((time, rest)) => format!("{},{rest}\n", time + 3600.0),
        None => format!("{row}\n"),
    };
    let later: String = rows.iter().map(|row| moved(row)).collect();
    let said = refused(&later, &same);
    assert!(
        said.contains("is outside the log of temperatures") || said.contains("behind the span of its reference"),
        "{said}"
    );
    let gap: String = rows
        .iter()
        .enumerate()
        .filter(|(row, _)| !(90..100).contains(row))
        .map(|(_, row)| format!("{row}\n"))
        .collect();
    assert!(refused(&gap, &same).contains("the log has a gap of 660 s"));
    // Touches without a clock.
    let touches = read(&recipe().path("touches", "path")).replace("time_s", "number");
    fs::write(folder.path().join("touches.csv"), touches).expect("a file");
    let said = refused(&text, &|variant: &mut Variant| {
        variant.stage("touches")["path"] = json!(folder.path().join("touches.csv"));
    });
    assert!(said.contains("has no column `time_s`, by which temperatures are found"), "{said}");
}

/// Temperatures in the rows of the touches themselves: a head that is 5 K too warm all the time is a longer one, with the uncertainty of
/// its material.
#[test]
fn temperatures_may_be_columns_of_the_touches() {
    let mut variant = recipe().only(&["fit-stated"]);
    let mut mill = variant.stage("cold-mill").clone();
    let mut head = machine()["bodies"]["head"].clone();
    head.as_object_mut().expect("a body").remove("reference_until_s");
    mill["bodies"] = json!({ "head": head });
    variant.0["stages"]["head-mill"] = mill;
    variant.0["stages"]["with"] = variant.0["stages"]["fit-stated"].clone();
    variant.stage("with")["machine"] = json!("head-mill");
    variant.stage("fit-stated")["machine"] = json!("cold-mill");
    variant.stage("touches")["constants"] = json!({ "H1_degC": 25, "H2_degC": 25, "H3_degC": 25, "H4_degC": 25 });
    let outcome = variant.run();
    let [with, without] = ["with", "fit-stated"].map(|name| fit(&outcome, name).calibration.clone());
    let dzt = |calibration: &Calibration| calibration.get("dzt").expect("an unknown").value;
    let longer = 100.0 * 11.5e-6 * 5.0;
    assert!((dzt(&with) - dzt(&without) - longer).abs() < 1e-9, "{} {}", dzt(&with), dzt(&without));
    let variance = |calibration: &Calibration| calibration.get("dzt").expect("an unknown").standard_uncertainty.powi(2);
    let more = (variance(&with) - variance(&without)).sqrt();
    assert!((more / (longer * 0.6 / 11.5) - 1.0).abs() < 0.02, "{more}");
}
