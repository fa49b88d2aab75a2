//! Whether intervals of 95 % cover the truth in 95 % of simulated tests, parameter by parameter.
//!
//! Every set is touched anew on the virtual machine: exact contact, noise, a bar and a stylus that are off by what their
//! calibration allows, and where weights are robust also gross errors. `cargo xtask campaign coverage 5000` makes the large runs that
//! the documentation tells of.

use std::collections::BTreeMap;

use abbe_core::{Fit, Problem, in_parallel};
use abbe_numerics::{Generator, binomial_band};
use abbe_simulation::{Noise, Outliers, StandardDeviation, Truth, measure};
use serde_json::{Value, json};

use crate::support::{Variant, fit, json_file, recipes, root};

/// Sets that are simulated unless more are asked for; fewer with 115 unknowns.
const SETS: usize = 60;
const SETS_OF_MANY: usize = 30;

/// Part of the sets, at most, in which robust weights may go round without settling: with 46 unknowns or less, and with 115. These
/// sets give an error and no interval, and are left out of what is counted.
const UNSETTLED: f64 = 0.02;
const UNSETTLED_OF_MANY: f64 = 0.10;

/// Part of the touches that are hit where there are gross errors, and by how much, mm.
const GROSS_PART: f64 = 0.02;
const GROSS: [f64; 2] = [0.020, 0.200];

/// A measurement that is simulated again and again.
struct Campaign {
    /// The fit that each set is given to; the rows of its problem are the programme.
    planned: Fit,
    /// True values by own names, mm and rad; what is not named is zero, or nominal.
    values: BTreeMap<String, f64>,
    /// Nominal value and standard uncertainty of the known inputs, mm: every set has others.
    inputs: &'static [(&'static str, f64, f64)],
    /// Noise of every artefact stage, mm.
    noise: &'static [(&'static str, f64)],
    /// Whether there are gross errors.
    gross: bool,
}

impl Campaign {
    /// The TANGO test (set-up, location errors, scale gains, reversal, facets: set S3; S4 with motion errors), its known inputs
    /// and robust weights.
    fn tango(set: &str, robust: &Value, variance: &str, gross: bool) -> Self {
        let estimate = format!("fit-{set}");
        let recipe = Variant::tango("realistic")
            .only(&[&estimate])
            .set("table", "stylus_radius_standard_uncertainty_um", json!(0.5))
            .set("bar", "reference_standard_uncertainty_um", json!(0.4))
            .set(&estimate, "robust", robust.clone())
            .set(&estimate, "variance", json!(variance))
            .set(&estimate, "parameters", json!([format!("@{set}"), "table.*"]));
        let mut outcome = recipe.run();
        let unknowns = if set == "S3" { 46 } else { 115 };
        assert_eq!(fit(&outcome, &estimate).problem.unknowns.len(), unknowns);
        Self {
            planned: outcome.fits.remove(0),
            values: values("tango-hu40t-realistic"),
            inputs: &[("stylus_radius", 3.0, 0.5e-3), ("bar.reference_error", 0.0, 0.4e-3)],
            noise: &[("table", 1.6e-3), ("bar", 0.9e-3)],
            gross,
        }
    }

    /// A sphere on the same machine: 17 unknowns, 428 touches.
    fn sphere(robust: &Value, gross: bool) -> Self {
        let recipe = Variant::of(&recipes()["sphere-hu40t"]).only(&["fit"]).set("fit", "robust", robust.clone()).set(
            "fit",
            "parameters",
            json!(["@errors", "dzt", "sphere.*"]),
        );
        let mut outcome = recipe.run();
        assert_eq!(fit(&outcome, "fit").problem.unknowns.len(), 17);
        let values = values("sphere-hu40t-realistic");
        Self { planned: outcome.fits.remove(0), values, inputs: &[], noise: &[("sphere", 0.65e-3)], gross }
    }

    /// The TANGO test on a machine that warms up, with the temperatures that it follows.
    fn warming() -> Self {
        let mut outcome = Variant::of(&recipes()["tango-warming"]).only(&["fit"]).run();
        let values = values("tango-warming");
        Self {
            planned: outcome.fits.remove(0),
            values,
            inputs: &[],
            noise: &[("table", 1.6e-3), ("bar", 0.9e-3)],
            gross: false,
        }
    }

    /// The truth of one set: its inputs are off as their uncertainty allows, its gross errors anywhere.
    fn truth(&self, set: u64) -> Truth {
        let mut random = Generator::new(77, set);
        let mut parameters: BTreeMap<String, f64> = (self.planned.problem.unknowns.iter())
            .map(|unknown| own_name(&self.planned.problem, &unknown.name))
            .map(|name| (name.to_owned(), self.values.get(name).copied().unwrap_or(0.0)))
            .collect();
        for (name, nominal, uncertainty) in self.inputs {
            parameters.insert((*name).to_owned(), nominal + uncertainty * random.normal());
        }
        let by_stage = self.noise.iter().map(|(stage, sigma)| ((*stage).to_owned(), *sigma)).collect();
        let listed = if self.gross { gross(&self.planned.problem, &mut random) } else { BTreeMap::new() };
        let outliers = Outliers { listed, random: None };
        Truth {
            parameters,
            noise: Noise { probing_sigma_mm: StandardDeviation::ByStage(by_stage), outliers, ..Noise::default() },
        }
    }

    /// The errors of the estimates of one set, over their expanded uncertainties: up to 1 the interval covers the truth. None where
    /// the robust weights do not settle.
    fn errors(&self, set: u64) -> Option<Vec<f64>> {
        let Self { planned, .. } = self;
        let truth = self.truth(set);
        let measured = measure(&planned.problem, &truth, set).unwrap_or_else(|error| panic!("{error}"));
        let calibration = match planned.estimator.explain(&measured) {
            Ok(calibration) => calibration,
            Err(error) if error.message.contains("does not converge") => return None,
            Err(error) => panic!("{error}"),
        };
        let budget = calibration.uncertainty.as_ref().expect("a budget");
        let errors = budget.parameters.iter().map(|parameter| {
            let estimate = calibration.get(&parameter.name).expect("an estimate").value;
            let own = own_name(&planned.problem, &parameter.name);
            (estimate - truth.parameters[own]).abs() / parameter.expanded_uncertainty
        });
        Some(errors.collect())
    }

    /// Asserts that the intervals of every parameter cover as often as they say; `unsettled` is the part of the sets that may
    /// give none.
    fn check(&self, what: &str, unsettled: f64) {
        let many = self.planned.problem.unknowns.len() > 100;
        let asked = asked().unwrap_or(if many { SETS_OF_MANY } else { SETS });
        let numbers: Vec<u64> = (0..asked as u64).collect();
        let errors: Vec<Vec<f64>> =
            in_parallel(&numbers, None, |&number| self.errors(number)).into_iter().flatten().collect();
        let (sets, parameters) = (errors.len(), &self.planned.problem.unknowns);
        // By Bonferroni a perfect program keeps all bands together with 99 % probability or more.
        let (low, high) = binomial_band(sets, 0.95, 1.0 - 0.01 / parameters.len() as f64);
        let counts: Vec<usize> =
            (0..parameters.len()).map(|index| errors.iter().filter(|errors| errors[index] <= 1.0).count()).collect();
        let part = |count: usize| count as f64 / sets as f64 * 100.0;
        for (index, (unknown, count)) in parameters.iter().zip(&counts).enumerate() {
            // In expanded uncertainties; 0.51 where these are those of normal quantities.
            let rms = (errors.iter().map(|errors| errors[index].powi(2)).sum::<f64>() / sets as f64).sqrt();
            println!("{what}: {:<22} {:.2} %, RMS error {rms:.4} U", unknown.name, part(*count));
        }
        let mean = part(counts.iter().sum()) / counts.len() as f64;
        let (least, most) = (counts.iter().min().copied().unwrap_or(0), counts.iter().max().copied().unwrap_or(0));
        println!(
            "{what}: {sets} of {asked} sets: {:.2} % to {:.2} %, mean {mean:.2} %; band {:.2} % to {:.2} %",
            part(least),
            part(most),
            part(low),
            part(high)
        );
        assert!((asked - sets) as f64 <= unsettled * asked as f64, "{what}: {} sets do not converge", asked - sets);
        for (unknown, count) in parameters.iter().zip(&counts) {
            let name = &unknown.name;
            assert!((low..=high).contains(count), "{what}: {name}: {count} of {sets}, {low} to {high} expected");
        }
    }
}

/// How many sets the environment asks for.
fn asked() -> Option<usize> {
    let asked = std::env::var("ABBE_COVERAGE_SETS").ok()?;
    Some(asked.parse().expect("ABBE_COVERAGE_SETS is a number"))
}

/// The true values of a data set.
fn values(data: &str) -> BTreeMap<String, f64> {
    let truth = json_file(&root().join(format!("tests/truth/{data}.json")));
    let parameters = truth["parameters"].as_object().expect("parameters");
    parameters.iter().map(|(name, value)| (name.clone(), value.as_f64().expect("a number"))).collect()
}

/// The name of an unknown without the stage of its artefact.
fn own_name<'a>(problem: &Problem, name: &'a str) -> &'a str {
    let of_stage = |set: &abbe_core::ObservationSet| name.strip_prefix(&set.name)?.strip_prefix('.');
    problem.sets.iter().find_map(of_stage).unwrap_or(name)
}

/// Gross errors of random touches, outwards and inwards, by the label of the touch.
fn gross(problem: &Problem, random: &mut Generator) -> BTreeMap<String, f64> {
    // Between 0 and 1.
    let mut chance = || 0.5 * (random.uniform() / 3.0_f64.sqrt() + 1.0);
    let mut hit = BTreeMap::new();
    for touch in problem.sets.iter().filter_map(|set| set.observations.info().layout.data.labels("touch")).flatten() {
        let (is_hit, size, sign) = (chance() < GROSS_PART, chance(), chance());
        if is_hit {
            let size = GROSS[0] + size * (GROSS[1] - GROSS[0]);
            hit.insert(touch.to_string(), if sign < 0.5 { size } else { -size });
        }
    }
    hit
}

#[test]
fn intervals_cover_as_often_as_they_say() {
    Campaign::tango("S3", &Value::Null, "common", false).check("S3", 0.0);
}

#[test]
fn intervals_cover_on_a_machine_that_warms_up() {
    Campaign::warming().check("warming", 0.0);
}

/// Without gross errors and with them; the large runs do both, the suite no more than what tells most.
fn with_gross_errors() -> &'static [bool] {
    if asked().is_some() { &[false, true] } else { &[true] }
}

#[test]
fn intervals_of_robust_fits_cover_as_often_as_they_say() {
    for gross in [false, true] {
        Campaign::tango("S3", &json!("tukey"), "common", gross).check(&titled("S3 tukey", gross), UNSETTLED);
    }
    // Huber's loss bounds the effect of gross errors on touches, but part of it stays in their scatter. One factor for all
    // rows would also enlarge the uncertainty of the bar, which determines the scales: their intervals would cover too often.
    for &gross in with_gross_errors() {
        Campaign::tango("S3", &json!("huber"), "per-stage", gross).check(&titled("S3 huber", gross), UNSETTLED);
    }
}

#[test]
fn intervals_of_robust_fits_cover_where_rows_are_few() {
    for &gross in with_gross_errors() {
        Campaign::tango("S4", &json!("tukey"), "common", gross).check(&titled("S4 tukey", gross), UNSETTLED_OF_MANY);
    }
}

#[test]
fn intervals_of_robust_fits_cover_where_rows_are_many() {
    for &gross in with_gross_errors() {
        Campaign::sphere(&json!("tukey"), gross).check(&titled("sphere tukey", gross), UNSETTLED);
    }
}

fn titled(what: &str, gross: bool) -> String {
    format!("{what}{}", if gross { ", gross errors" } else { "" })
}
