//! The TANGO recipe on virtual machines with other seeds: every robust fit settles, and intervals cover as often as they say.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use abbe_core::{Fit, Monitor, Owner, Registry, in_parallel};
use abbe_engine::prepare;
use abbe_simulation::{Noise, Truth};
use serde_json::Value;

pub use crate::machines::Report;

/// The robust estimates whose model has all errors of the truth. Others have to settle, too; what they cover means nothing.
const ROBUST: [&str; 2] = ["fit-S4", "fit-S4r"];

/// What one seed gives of one estimate.
struct Found {
    /// For every parameter of the machine: name, whether its 95 % interval holds the truth, and how far off it is in standard
    /// uncertainties.
    covers: Vec<(String, bool, f64)>,
    /// Gross errors that were put in, and how many of them were found.
    gross: (usize, usize),
}

/// Runs seeds `seed..seed + count`.
pub fn run(seed: u64, count: u64) -> Report {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let registry = Registry::built_in().expect("the plugins have different names");
    let prepared = prepare(&root.join("pipelines/tango-hu40t.yaml"), &registry).expect("the recipe is there");
    let truth = root.join("tests/truth/tango-hu40t-realistic.json");
    let text = fs::read_to_string(&truth).expect("the truth is there");
    let true_values: Value = serde_json::from_str(&text).expect("JSON");
    let noise = Truth::parse(&truth, &text).expect("the truth is one").noise;
    let seeds: Vec<u64> = (seed..seed + count).collect();
    let found = in_parallel(&seeds, None, |seed| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let measured = folder.path().join("measured");
        let simulated = prepared.simulate(&truth, *seed, None).and_then(|simulated| simulated.write(&measured));
        simulated.unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        let recipe = measured.join("tango-hu40t.yaml");
        let prepared = prepare(&recipe, &registry).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        let outcome = prepared.run(&Monitor::default()).map_err(|error| format!("seed {seed}: {error}"))?;
        if let Some(failure) = outcome.failures.first() {
            return Err(format!("seed {seed}: {}: {}", failure.stage, failure.error.message));
        }
        let failed =
            |verdict: &&abbe_core::Verdict| verdict.figures.iter().any(|figure| figure.name.starts_with("failed"));
        if let Some(verdict) = outcome.verdicts.iter().find(failed) {
            return Err(format!("seed {seed}: {}: {}", verdict.stage, verdict.remarks.join("; ")));
        }
        let of = |fit: &Fit| {
            let covers = fit.problem.unknowns.iter().filter(|unknown| unknown.owner == Owner::Machine);
            let covers = covers.filter_map(|unknown| {
                let budget = fit.calibration.uncertainty.as_ref()?;
                let told = budget.parameters.iter().find(|told| told.name == unknown.name)?;
                let mut truth = true_values["parameters"][&unknown.name].as_f64()?;
                if fit.calibration.get(&format!("{}[t1]", unknown.name)).is_some() {
                    truth += mean_drift(&noise, &unknown.name, fit);
                }
                let off = fit.calibration.get(&unknown.name)?.value - truth;
                let within = off.abs() <= told.expanded_uncertainty;
                Some((unknown.name.clone(), within, off / told.standard_uncertainty))
            });
            let gross: Vec<usize> = (true_values["noise"]["outliers"].as_object().into_iter().flatten())
                .filter_map(|(row, _)| row.parse().ok())
                .collect();
            let hit = gross.iter().filter(|row| fit.calibration.outliers.iter().any(|outlier| outlier.row == **row));
            Found { covers: covers.collect(), gross: (gross.len(), hit.count()) }
        };
        let robust = outcome.fits.iter().filter(|fit| ROBUST.contains(&fit.name.as_str()));
        Ok(robust.map(|fit| (fit.name.clone(), of(fit))).collect::<BTreeMap<String, Found>>())
    });
    report(found)
}

/// What a parameter with Legendre polynomials of the time beside it drifts by on average: these have a mean of zero.
fn mean_drift(noise: &Noise, parameter: &str, fit: &Fit) -> f64 {
    const STEPS: usize = 1000;
    let times = fit.problem.sets.iter().filter_map(|set| set.info().layout.data.numbers("time"));
    let (first, last) = times
        .flatten()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(first, last), time| (first.min(*time), last.max(*time)));
    let steps = (0..STEPS).map(|step| first + (last - first) * (step as f64 + 0.5) / STEPS as f64);
    let drifts = noise.drift.values().filter(|drift| drift.parameter == parameter);
    drifts.map(|drift| steps.clone().map(|time| drift.at(time)).sum::<f64>() / STEPS as f64).sum()
}

fn report(found: Vec<Result<BTreeMap<String, Found>, String>>) -> Report {
    let mut report = Report::default();
    let mut all: BTreeMap<String, Vec<Found>> = BTreeMap::new();
    for found in found {
        match found {
            Ok(fits) => fits.into_iter().for_each(|(name, found)| all.entry(name).or_default().push(found)),
            Err(message) => report.broken.push(message),
        }
    }
    for (name, runs) in all {
        let mut covered: BTreeMap<&str, usize> = BTreeMap::new();
        for (parameter, covers, _) in runs.iter().flat_map(|found| &found.covers) {
            *covered.entry(parameter).or_default() += usize::from(*covers);
        }
        let count = runs.len() as f64;
        let pooled = covered.values().sum::<usize>() as f64 / count / covered.len().max(1) as f64;
        // A perfect program leaves every one of p parameters within this band with 99 % for all together (normal approximation).
        let band =
            normal_quantile(1.0 - 0.005 / covered.len().max(1) as f64) * (0.95 * 0.05 / count).sqrt() + 0.5 / count;
        let share = |hits: &usize| *hits as f64 / count;
        let least = covered.values().map(share).fold(1.0, f64::min);
        let most = covered.values().map(share).fold(0.0, f64::max);
        let (put_in, hit) = runs.iter().fold((0, 0), |(a, b), found| (a + found.gross.0, b + found.gross.1));
        writeln!(
            report.text,
            "{name}: {count} runs settle; {} parameters, covered {:.2} % pooled, {:.2} to {:.2} % each (band {:.2} to {:.2} %); {hit} of {put_in} gross errors found",
            covered.len(),
            100.0 * pooled,
            100.0 * least,
            100.0 * most,
            100.0 * (0.95 - band),
            100.0 * (0.95 + band).min(1.0),
        )
        .expect("a text");
        if count >= 500.0 && !(0.94..=0.96).contains(&pooled) {
            report.broken.push(format!("{name}: {:.2} % of true values are covered", 100.0 * pooled));
        }
        for (parameter, hits) in covered.iter().filter(|(_, hits)| (share(hits) - 0.95).abs() > band) {
            let all = runs.iter().flat_map(|found| &found.covers).filter(|(other, ..)| other == parameter);
            let off: Vec<f64> = all.map(|(.., off)| *off).collect();
            let mean = off.iter().sum::<f64>() / count;
            let deviation = (off.iter().map(|off| (off - mean).powi(2)).sum::<f64>() / count).sqrt();
            report.broken.push(format!(
                "{name}: {parameter} is covered in {:.2} % (off by {mean:.2} ± {deviation:.2} standard uncertainties)",
                100.0 * share(hits)
            ));
        }
    }
    writeln!(report.text, "{} broken", report.broken.len()).expect("a text");
    report.broken.iter().for_each(|law| writeln!(report.text, "  {law}").expect("a text"));
    report
}

/// The number below which a standard normal number is with this probability, by bisection.
fn normal_quantile(probability: f64) -> f64 {
    let (mut low, mut high) = (0.0, 10.0);
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        // Two-sided probability of a larger size.
        if abbe_numerics::two_sided_normal(middle) > 2.0 * (1.0 - probability) { low = middle } else { high = middle }
    }
    low
}
