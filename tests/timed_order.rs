//! `plan` with `minutes` and `order`: the chosen order fits into the time, and the drift that it is made against is determined as well as
//! promised, in simulated measurements of random machines.

use std::path::Path;

use abbe_engine::{Measurements, prepare};
use serde_json::{Map, Value, json};

use crate::controls::law::{seeds, uniform};
use crate::support::{fit, read, registry, write};
use crate::until::begun;

/// The drift that is estimated.
const DRIFT: &str = "dzt[t1]";

/// The recipe of a begun calibration with a drift of the length of the tool, a program and other keys of the plan.
fn planned(at: &Path, keys: &str) -> Result<Measurements, String> {
    let machine = read(&at.join("m/machine.yaml"));
    if !machine.contains("drift:") {
        let drift = "  - { drift: [dzt], degrees: [1] }\n  - { polynomial:";
        write(&at.join("m/machine.yaml"), &machine.replacen("  - { polynomial:", drift, 1));
    }
    let recipe = read(&at.join("m/recipe.yaml")).replacen("parameters: [", &format!("parameters: [\"{DRIFT}\", "), 1);
    let start = recipe.find("  number:").expect("a number");
    let end = start + recipe[start..].find('\n').expect("a line");
    let program = "  program:\n    control: linuxcnc\n    unreachable: leave-out\n    clearance: { sphere: { centre_mm: [60, 20, 60], \
                   radius_mm: 140 } }\n    probe: [{ diameter_mm: 4, length_mm: 40 }, { diameter_mm: 40, length_mm: 110 }]\n";
    let text =
        format!("{}  parameters: [\"E*\"]\n  restarts: 2\n{keys}{program}{}", &recipe[..start], &recipe[end + 1..]);
    write(&at.join("m/p.yaml"), &text);
    let prepared = prepare(&at.join("m/p.yaml"), &registry());
    prepared
        .and_then(|prepared| prepared.plan())
        .map_err(|error| format!("{error} {}", error.help.as_deref().unwrap_or_default()))
}

/// A true value of an unknown: tens of micrometres, of microradians, of micrometres in a metre.
fn truth_of(name: &str, random: &mut impl FnMut() -> f64) -> f64 {
    let size = match name {
        DRIFT => return 0.03,
        name if name.ends_with("[1]") => 2e-5,
        name if ["EA", "EB", "EC"].iter().any(|begins| name.starts_with(begins)) => 5e-5,
        _ => 0.02,
    };
    size * (2.0 * random() - 1.0)
}

/// Squares of deviations in standard uncertainties.
#[derive(Default)]
struct Squares {
    drift: f64,
    all: f64,
    freedom: f64,
    trials: f64,
}

#[test]
fn an_order_within_minutes_determines_the_drift_as_promised() {
    let mut squares = Squares::default();
    let mut better = 0;
    for seed in seeds(2) {
        let mut random = uniform(7700 + seed);
        let (folder, chain) = begun("ball", &mut random);
        let at = folder.path();
        let order = |minutes: f64| {
            format!("  minutes: {minutes:.3}\n  order: {{ duration_s: 8, references: [1], times: 3, start_s: 600 }}\n")
        };
        let least = planned(at, &order(0.05)).err().expect("too little time");
        let least: f64 = least
            .split_once("the shortest program that was found takes ")
            .and_then(|(_, rest)| rest.split(' ').next()?.parse().ok())
            .unwrap_or_else(|| panic!("{chain}: {least}"));
        let minutes = least * (1.8 + random());
        let found = planned(at, &order(minutes)).unwrap_or_else(|error| panic!("{chain}: {error}"));
        let seconds = found.seconds.expect("a program");
        assert!(seconds <= 60.0 * minutes * (1.0 + 1e-9), "{chain}: {seconds} s in {minutes} minutes");
        let order = found.plan.order.as_ref().expect("an order");
        assert!(order.rows.windows(2).all(|pair| pair[0].1 < pair[1].1) && order.rows[0].1 == 600.0, "{chain}");
        if let Some(listed) = &order.as_listed {
            assert!(order.figures.log_determinant >= listed.log_determinant - 1e-9, "{chain}");
            better += usize::from(order.figures.log_determinant > listed.log_determinant + 1e-3);
        }
        measured(at, &chain, &found, seed, &mut random, &mut squares);
    }
    let Squares { drift, all, freedom, trials } = squares;
    println!(
        "chi-squared {all:.1} of {freedom} degrees of freedom; of the drift {drift:.1} of {trials}; {better} orders better"
    );
    // Four standard deviations around the mean.
    assert!((all - freedom).abs() < 4.0 * (2.0 * freedom).sqrt(), "{all} of {freedom}");
    assert!((drift - trials).abs() < 4.0 * (2.0 * trials).sqrt(), "{drift} of {trials}");
    assert!(better > 0);
}

/// Measures a plan on machines with known errors.
fn measured(
    at: &Path,
    chain: &str,
    found: &Measurements,
    seed: u64,
    random: &mut impl FnMut() -> f64,
    squares: &mut Squares,
) {
    let candidates = found.files.iter().find(|(name, _)| name.ends_with("candidates.csv")).expect("candidates").1;
    std::fs::write(at.join("m/touches.csv"), candidates).expect("written");
    let promised = found.standard_uncertainties();
    let unknowns = &found.plan.problem.unknowns;
    let text = read(&at.join("m/p.yaml")).replace("robust: tukey", "trust_uncertainties: true");
    write(&at.join("m/r.yaml"), &text[..text.find("\nplan:").expect("a plan")]);
    for trial in 0..6 {
        let machine = unknowns.iter().filter(|unknown| !unknown.name.starts_with("ball."));
        let truth: Map<String, Value> =
            machine.map(|unknown| (unknown.name.clone(), json!(truth_of(&unknown.name, random)))).collect();
        let file = at.join("truth.json");
        write(&file, &json!({ "parameters": truth, "noise": { "probing_sigma_mm": 0.002 } }).to_string());
        let simulated = prepare(&at.join("m/r.yaml"), &registry())
            .and_then(|prepared| prepared.simulate(&file, 500 * seed + trial, None))
            .unwrap_or_else(|error| panic!("{chain}: {error}"));
        let folder = at.join(format!("measured-{trial}"));
        simulated.write(&folder).expect("a folder");
        let outcome = prepare(&folder.join("r.yaml"), &registry())
            .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()))
            .unwrap_or_else(|error| panic!("{chain}: {error}"));
        let calibration = &fit(&outcome, "fit").calibration;
        let names: Vec<&str> = unknowns.iter().map(|unknown| unknown.name.as_str()).collect();
        let value = |name: &str| calibration.get(name).unwrap_or_else(|| panic!("{chain}: no {name}"));
        let of_truth = |name: &str| truth.get(name).and_then(Value::as_f64).unwrap_or_default();
        let off = nalgebra::DVector::from_iterator(names.len(), names.iter().map(|it| value(it).value - of_truth(it)));
        let covariance = calibration.covariance.block(&names);
        // What was promised is what the fit finds; the plan stands at the nominal machine.
        for (index, name) in names.iter().enumerate() {
            let ratio = covariance[(index, index)].sqrt() / promised[index];
            assert!((ratio - 1.0).abs() < 0.02, "{chain}: {name} has {ratio} of what was promised");
        }
        let drift = names.iter().position(|name| *name == DRIFT).expect("a drift");
        let own = covariance[(drift, drift)];
        squares.drift += off[drift].powi(2) / own;
        squares.trials += 1.0;
        let information = covariance.clone().try_inverse().expect("a covariance");
        squares.all += (off.transpose() * &information * &off)[(0, 0)];
        squares.freedom += names.len() as f64;
        // The other sign is not what was measured.
        assert!(value(DRIFT).value + of_truth(DRIFT) > 10.0 * own.sqrt(), "{chain}: {}", value(DRIFT).value);
    }
}
