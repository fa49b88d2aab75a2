//! The scatter of readings and the statements of certificates: a factor for every artefact, and certificates, whose
//! uncertainty is not scaled.

use abbe_core::{Calibration, Fit, in_parallel};
use abbe_numerics::{Generator, binomial_band};
use abbe_simulation::{Noise, StandardDeviation, Truth, measure};
use serde_json::{Value, json};

use crate::support::{Variant, fit, recipes};

/// The touches of a TANGO test in two halves, `even` and `odd` indexations, each an artefact stage; a fit of set-up and location
/// errors from both.
fn halves(uncertainties_um: [f64; 2]) -> Variant {
    let mut recipe = Variant::tango("realistic").only(&["fit-S3"]);
    let stages = recipe.0["stages"].as_object_mut().expect("stages");
    let (touches, table) = (stages["touches"].clone(), stages["table"].clone());
    for (name, first, uncertainty) in [("even", 2, uncertainties_um[0]), ("odd", 1, uncertainties_um[1])] {
        let (mut ingest, mut table) = (touches.clone(), table.clone());
        ingest["keep"] = json!({ "group": (first..=28).step_by(2).collect::<Vec<u32>>() });
        table["from"] = json!(format!("touches-{name}"));
        table["standard_uncertainty_um"] = json!(uncertainty);
        stages.insert(format!("touches-{name}"), ingest);
        stages.insert(name.to_owned(), table);
    }
    let parameters: Vec<Value> = ["@S3", "even.*", "odd.*"].map(|it| json!(it)).to_vec();
    stages.insert(
        "both".to_owned(),
        json!({
            "estimate": "gauss-newton", "machine": "hu40t", "observations": ["even", "odd", "bar"],
            "parameters": parameters, "variance": "per-stage",
        }),
    );
    recipe.only(&["both"])
}

fn factor(calibration: &Calibration, stage: &str) -> (f64, Option<f64>) {
    let found = calibration.fit.variance.iter().find(|found| found.stage == stage);
    let found = found.unwrap_or_else(|| panic!("no factor of {stage}"));
    (found.factor, found.degrees_of_freedom)
}

#[test]
fn groups_without_a_common_unknown_have_the_factor_of_their_own_fit() {
    // Each half has its own facets and nothing else: s² = v^T v / (n - p), with as many degrees of freedom.
    let mut recipe = halves([1.6, 1.6]);
    recipe.0["stages"]["both"]["parameters"] = json!(["even.*", "odd.*"]);
    recipe.0["stages"]["both"]["observations"] = json!(["even", "odd"]);
    let together = recipe.run();
    let together = &fit(&together, "both").calibration;
    for half in ["even", "odd"] {
        let mut alone = recipe.clone();
        alone.0["stages"]["both"]["parameters"] = json!([format!("{half}.*")]);
        alone.0["stages"]["both"]["observations"] = json!([half]);
        alone.0["stages"]["both"]["variance"] = json!("common");
        let alone = alone.run();
        let report = &fit(&alone, "both").calibration.fit;
        let (found, freedom) = factor(together, half);
        assert!((found / report.sigma - 1.0).abs() < 1e-9, "{half}: {found}, {}", report.sigma);
        let freedom = freedom.expect("degrees of freedom");
        assert!((freedom - report.degrees_of_freedom as f64).abs() < 1e-6, "{half}: {freedom}");
    }
}

#[test]
fn what_was_stated_of_a_stage_does_not_matter_once_its_factor_is_estimated() {
    let first = halves([1.6, 1.6]).run();
    let first = &fit(&first, "both").calibration;
    // The single reading of the bar is checked by nothing: what was stated of it counts.
    assert_eq!(factor(first, "bar"), (1.0, None));
    for stated in [[0.4, 1.6], [1.6, 9.0], [5.0, 0.3]] {
        let other = halves(stated).run();
        let other = &fit(&other, "both").calibration;
        for (half, stated) in ["even", "odd"].iter().zip(stated) {
            let (one, two) = (factor(first, half), factor(other, half));
            assert!((one.0 * 1.6 / (two.0 * stated) - 1.0).abs() < 1e-6, "{half}: {one:?}, {two:?}");
            assert!((one.1.expect("freedom") / two.1.expect("freedom") - 1.0).abs() < 1e-6, "{half}: {one:?}, {two:?}");
        }
        for one in &first.parameters {
            let two = other.get(&one.name).expect("the same parameters");
            let u = one.standard_uncertainty;
            assert!((one.value - two.value).abs() <= 1e-6 * u, "{}: {one:?}, {two:?}", one.name);
            assert!((two.standard_uncertainty - u).abs() <= 1e-6 * u, "{}: {one:?}, {two:?}", one.name);
        }
    }
}

/// Sets that are simulated unless more are asked for.
const SETS: usize = 150;

#[test]
fn intervals_cover_where_stages_scatter_differently() {
    let asked = std::env::var("ABBE_COVERAGE_SETS").ok();
    let sets = asked.map_or(SETS, |asked| asked.parse().expect("ABBE_COVERAGE_SETS is a number"));
    // One half scatters by half of what is stated, the other by three times as much.
    let mut outcome = halves([1.6, 1.6]).run();
    let planned = outcome.fits.remove(0);
    let start: std::collections::BTreeMap<String, f64> = (planned.problem.unknowns.iter())
        .map(|unknown| (unknown.name.clone(), planned.calibration.get(&unknown.name).expect("a value").value))
        .collect();
    let problem = planned.problem.with_variance_factors(
        &planned.calibration.fit.variance.iter().map(|found| 1.0 / found.factor).collect::<Vec<f64>>(),
    );
    let numbers: Vec<u64> = (0..sets as u64).collect();
    let covered = in_parallel(&numbers, None, |&number| {
        let mut random = Generator::new(991, number);
        let by_stage = [("even".to_owned(), 0.8e-3), ("odd".to_owned(), 4.8e-3), ("bar".to_owned(), 0.9e-3)];
        let mut parameters = start.clone();
        parameters.values_mut().for_each(|value| *value *= 1.0 + 0.1 * random.normal());
        let parameters: std::collections::BTreeMap<String, f64> = parameters.into_iter().collect();
        let truth = Truth {
            parameters: parameters.clone(),
            noise: Noise { probing_sigma_mm: StandardDeviation::ByStage(by_stage.into()), ..Noise::default() },
        };
        let measured = measure(&problem, &truth, number).unwrap_or_else(|error| panic!("{error}"));
        let calibration = planned.estimator.explain(&measured).unwrap_or_else(|error| panic!("{error}"));
        let budget = calibration.uncertainty.as_ref().expect("a budget");
        let machine = budget.parameters.iter().filter(|it| !it.name.contains('.'));
        let covers = machine.map(|parameter| {
            let estimate = calibration.get(&parameter.name).expect("an estimate").value;
            (estimate - parameters[&parameter.name]).abs() <= parameter.expanded_uncertainty
        });
        (covers.collect::<Vec<bool>>(), ["even", "odd"].map(|half| factor(&calibration, half).0))
    });
    let count = covered[0].0.len();
    let (low, high) = binomial_band(sets, 0.95, 1.0 - 0.01 / count as f64);
    let mut all = 0;
    for parameter in 0..count {
        let hits = covered.iter().filter(|(covers, _)| covers[parameter]).count();
        all += hits;
        assert!((low..=high).contains(&hits), "parameter {parameter}: {hits} of {sets}, {low} to {high} expected");
    }
    let factors = |half: usize| covered.iter().map(move |(_, factors)| factors[half].powi(2));
    let [even, odd] = [0, 1].map(|half| (factors(half).sum::<f64>() / sets as f64).sqrt());
    println!("{sets} sets: {:.2} % cover; factors {even:.3} and {odd:.3}", 100.0 * all as f64 / (sets * count) as f64);
    assert!((even / 0.5 - 1.0).abs() < 0.03 && (odd / 3.0 - 1.0).abs() < 0.03, "{even}, {odd}");
}

/// The SAMBA test with touches that are said to scatter by so much.
fn samba(stated_um: f64) -> Variant {
    Variant::of(&recipes()["samba"]).only(&["fit"]).set("balls", "standard_uncertainty_um", json!(stated_um))
}

#[test]
fn a_certificate_does_not_scatter_as_touches_do() {
    // Touches that scatter three times as much as stated: the certificate still states what it states.
    let sigma = fit(&samba(0.7).run(), "fit").calibration.fit.sigma;
    let recipe = samba(0.7 * sigma / 3.0).set("fit", "robust", Value::Null);
    let outcome = recipe.run();
    let calibration = &fit(&outcome, "fit").calibration;
    assert!((calibration.fit.sigma / 3.0 - 1.0).abs() < 0.2, "{}", calibration.fit.sigma);
    // By how much the scale follows the certified length, from two estimates.
    let length = |recipe: &Variant, by: f64| {
        let mut longer = recipe.clone();
        let distance = &mut longer.stage("balls")["distances"][0];
        distance["length_mm"] = json!(distance["length_mm"].as_f64().expect("a length") + by);
        let outcome = longer.run();
        fit(&outcome, "fit").calibration.clone()
    };
    let certified = 0.1e-3;
    let (more, less) = (length(&recipe, 1e-3), length(&recipe, -1e-3));
    let budgets = &calibration.uncertainty.as_ref().expect("a budget").parameters;
    let input = "balls.length[25-26]";
    let mut judged = 0;
    for budget in budgets.iter().filter(|budget| !budget.name.contains('.')) {
        let of = |it: &Calibration| it.get(&budget.name).expect("a value").value;
        let expected = ((of(&more) - of(&less)) / 2e-3 * certified).abs();
        let part = budget.contributions.iter().find(|part| part.input == input);
        let found = part.map_or(0.0, |part| part.standard_uncertainty);
        let close = (found - expected).abs() < 2e-3 * expected + 1e-6 * budget.standard_uncertainty;
        assert!(close, "{}: {found:e}, {expected:e}", budget.name);
        judged += usize::from(found > 0.0);
    }
    assert!(judged >= 3, "{judged} parameters depend on the certificate");
    let listed = calibration.inputs.as_ref().expect("inputs");
    assert!(listed.iter().any(|it| it.name == input && it.standard_uncertainty == certified), "{listed:?}");

    // Trials say the same.
    let mut trials = recipe.clone();
    trials.0["stages"]["trials"] = json!({ "estimate": "monte-carlo", "of": "fit", "trials": 2000, "seed": 5 });
    let outcome = trials.run();
    let simulated = fit(&outcome, "trials").calibration.monte_carlo.clone().expect("trials");
    for parameter in simulated.parameters.iter().filter(|it| !it.name.contains('.')) {
        let budget = budgets.iter().find(|budget| budget.name == parameter.name).expect("a budget");
        let ratio = parameter.standard_uncertainty / budget.standard_uncertainty;
        assert!((ratio - 1.0).abs() < 0.08, "{}: {ratio}", parameter.name);
    }
}

/// The distance of the centres of the two balls that the certificate is about.
fn distance(fit: &Fit) -> f64 {
    let features = &fit.problem.sets[0].observations.info().features;
    let centre = |label: &str| -> [f64; 3] {
        let ball = features.iter().find(|feature| feature.label == label).expect("the ball");
        let own = |axis: &str| fit.calibration.get(&format!("balls.ball[{label}].{axis}")).expect("a centre").value;
        [0, 1, 2].map(|axis| ball.point[axis] + own(["x", "y", "z"][axis]))
    };
    let (one, other) = (centre("25"), centre("26"));
    (0..3).map(|axis| (one[axis] - other[axis]).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn a_certificate_is_never_weighed_down() {
    // A certificate that is off by 20 um contradicts many touches: the touches lose weight, the certificate does not.
    let recipe = samba(0.7).set("fit", "robust", json!("huber"));
    let off = |by: f64| {
        let mut wrong = recipe.clone();
        let distance = &mut wrong.stage("balls")["distances"][0];
        distance["length_mm"] = json!(distance["length_mm"].as_f64().expect("a length") + by);
        let mut outcome = wrong.run();
        outcome.fits.remove(0)
    };
    let (right, wrong) = (off(0.0), off(0.02));
    assert!(wrong.calibration.outliers.iter().all(|outlier| !outlier.file.is_empty()), "constraints are no outliers");
    let follows = (distance(&wrong) - distance(&right)) / 0.02;
    assert!(follows > 0.9, "the distance follows its certificate by {follows:.3}");
}
