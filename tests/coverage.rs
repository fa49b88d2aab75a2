//! Whether intervals of 95 % cover the truth in 95 % of simulated TANGO tests, parameter by parameter.
//!
//! Every set is touched anew on the virtual machine: exact contact, 1.6 um of noise, a bar and a stylus that are off by what
//! their calibration allows. `ABBE_COVERAGE_SETS=5000` asks for the large run that the documentation tells of.

use abbe_core::{Fit, Problem, in_parallel};
use abbe_numerics::{Generator, binomial_band};
use abbe_simulation::{Noise, Sigma, Truth, measure};
use serde_json::{Value, json};

use crate::support::{Variant, fit, json_file, root};

/// Sets that are simulated unless more are asked for.
const SETS: usize = 200;

/// The fit S3 of the TANGO test (set-up, location errors, scale gains, reversal, facets) with its known inputs.
fn planned() -> Fit {
    let recipe = Variant::tango("realistic")
        .only(&["fit-S3"])
        .set("table", "stylus_radius_standard_uncertainty_um", json!(0.5))
        .set("bar", "reference_standard_uncertainty_um", json!(0.4))
        .set("fit-S3", "robust", Value::Null)
        .set("fit-S3", "parameters", json!(["@S3", "table.*"]));
    let mut outcome = recipe.run();
    assert_eq!(fit(&outcome, "fit-S3").problem.unknowns.len(), 46);
    outcome.fits.remove(0)
}

/// The truth of one set: that of the data set in what S3 knows, and known inputs as their uncertainty allows.
fn truth(problem: &Problem, values: &Value, set: u64) -> Truth {
    let mut random = Generator::new(77, set);
    let own = |name: &str| name.strip_prefix("table.").unwrap_or(name).to_owned();
    let mut parameters: std::collections::BTreeMap<String, f64> = (problem.unknowns.iter())
        .map(|unknown| (own(&unknown.name), values[own(&unknown.name)].as_f64().expect("a true value")))
        .collect();
    parameters.insert("stylus_radius".to_owned(), 3.0 + 0.5e-3 * random.normal());
    parameters.insert("bar.reference_error".to_owned(), 0.4e-3 * random.normal());
    let by_stage = [("table".to_owned(), 1.6e-3), ("bar".to_owned(), 0.9e-3)];
    Truth { parameters, noise: Noise { probing_sigma_mm: Sigma::ByStage(by_stage.into()), ..Noise::default() } }
}

#[test]
fn intervals_cover_as_often_as_they_say() {
    let asked = std::env::var("ABBE_COVERAGE_SETS").ok();
    let sets = asked.map_or(SETS, |asked| asked.parse().expect("ABBE_COVERAGE_SETS is a number"));
    let planned = planned();
    let values = json_file(&root().join("tests/truth/tango-hu40t-realistic.json"))["parameters"].clone();
    let numbers: Vec<u64> = (0..sets as u64).collect();
    let covered = in_parallel(&numbers, None, |&number| {
        let truth = truth(&planned.problem, &values, number);
        let measured = measure(&planned.problem, &truth, number).unwrap_or_else(|error| panic!("{error}"));
        let calibration = planned.estimator.explain(&measured).unwrap_or_else(|error| panic!("{error}"));
        let budget = calibration.uncertainty.as_ref().expect("a budget");
        let covers = budget.parameters.iter().map(|parameter| {
            let own = parameter.name.strip_prefix("table.").unwrap_or(&parameter.name);
            let estimate = calibration.get(&parameter.name).expect("an estimate").value;
            (estimate - truth.parameters[own]).abs() <= parameter.expanded_uncertainty
        });
        covers.collect::<Vec<bool>>()
    });
    let parameters = &planned.problem.unknowns;
    // By Bonferroni a perfect program keeps all bands together with 99 % probability or more.
    let (low, high) = binomial_band(sets, 0.95, 1.0 - 0.01 / parameters.len() as f64);
    let counts: Vec<usize> =
        (0..parameters.len()).map(|index| covered.iter().filter(|covers| covers[index]).count()).collect();
    for (unknown, count) in parameters.iter().zip(&counts) {
        println!("{:<22} {:.2} %", unknown.name, *count as f64 / sets as f64 * 100.0);
        assert!((low..=high).contains(count), "{}: {count} of {sets}, {low} to {high} expected", unknown.name);
    }
    let part = |count: usize| count as f64 / sets as f64 * 100.0;
    let mean = part(counts.iter().sum()) / counts.len() as f64;
    let (least, most) = (counts.iter().min().copied().unwrap_or(0), counts.iter().max().copied().unwrap_or(0));
    println!(
        "{sets} sets: {:.2} % to {:.2} %, mean {mean:.2} %; band {:.2} % to {:.2} %",
        part(least),
        part(most),
        part(low),
        part(high)
    );
}
