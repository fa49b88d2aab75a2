//! Estimates whose rows are read in batches, on random machines: what a run that holds all rows says, it says in batches of any size.
//!
//! With and without `select`, `robust`, `variance: per-stage` and `hold-out`, of one artefact stage or of two. What has to hold in every case:
//!
//! 1. both runs estimate, or both refuse;
//! 2. values and standard uncertainties agree to 1e-7 standard uncertainties;
//! 3. the same terms are selected, in the same steps, with the same probabilities;
//! 4. residuals and predictions have the same figures;
//! 5. `check` accepts what `run` estimates.
//!
//! Robust estimates of few rows have several solutions: by how much they are apart is told and no law. So is the number of cases in which
//! one way does not converge, of the estimate or of a fold of `hold-out`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use abbe_core::{Calibration, Monitor, Owner, Registry, Verdict, in_parallel};
use abbe_engine::{Outcome, prepare};
use serde_json::{Value, json};

use crate::Random;
use crate::machine::{Artefact, Case};
use crate::machines::{Report, recipe, shortened, wanted};

/// The artefacts whose rows do not depend on each other.
const ARTEFACTS: [Artefact; 4] = [Artefact::Facets, Artefact::Touches, Artefact::Centres, Artefact::Plate];

/// By how much values and uncertainties may differ, in standard uncertainties.
const ALLOWED: f64 = 1e-7;

/// A case: its kind, how it ended, the laws that it broke, and the largest difference of values and uncertainties.
struct Ended {
    kind: String,
    end: String,
    broken: Vec<String>,
    apart: f64,
}

/// Runs the cases `0..count` of a seed.
pub fn run(seed: u64, count: u64) -> Report {
    let cases: Vec<u64> = (0..count).collect();
    let (mut ends, mut report) = (BTreeMap::<String, (usize, f64)>::new(), Report::default());
    for (case, found) in in_parallel(&cases, None, |case| one(seed, *case)).into_iter().enumerate() {
        let (number, apart) = ends.entry(format!("{}: {}", found.kind, found.end)).or_default();
        (*number, *apart) = (*number + 1, apart.max(found.apart));
        report.broken.extend(found.broken.into_iter().map(|law| format!("seed {seed}, case {case}: {law}")));
    }
    for (name, (count, apart)) in ends {
        writeln!(report.text, "{count:6} {name}, largest difference {apart:.1e} u").expect("a text");
    }
    writeln!(report.text, "{} laws broken in {count} cases", report.broken.len()).expect("a text");
    report.broken.iter().for_each(|law| writeln!(report.text, "  {law}").expect("a text"));
    report
}

/// What a case tries, in words, and the settings of its estimate.
fn settings(random: &mut Random, recipe: &mut Value, machine: &[String]) -> Vec<&'static str> {
    let mut named = Vec::new();
    let fit = &mut recipe["stages"]["fit"];
    if random.chance(0.45) && !machine.is_empty() {
        let candidates = random.shuffled(&machine.iter().map(String::as_str).collect::<Vec<_>>());
        fit["select"] = json!({
            "candidates": candidates[random.count(0, machine.len())..],
            "level": random.of(&[1e-6, 1e-4, 1e-2, 0.1, 0.5]),
            "direction": random.of(&["backward", "forward", "both"]),
        });
        named.push("select");
    } else if random.chance(0.3) {
        fit["robust"] = json!(random.of(&["huber", "tukey"]));
        named.push("robust");
    }
    if random.chance(0.4) && !named.contains(&"robust") {
        fit["variance"] = json!("per-stage");
        named.push("per-stage");
    }
    if random.chance(0.4) {
        let folds = random.count(2, 5);
        recipe["stages"]["unseen"] = json!({ "validate": "hold-out", "of": "fit", "rows": "art", "folds": folds });
        named.push("hold-out");
    }
    recipe["stages"]["left"] = json!({ "validate": "residuals", "of": "fit" });
    named
}

/// A recipe and its measurement.
struct Measured {
    kind: String,
    recipe: Value,
    rows: usize,
    /// Whether it has robust weights.
    is_robust: bool,
}

/// The recipe of a case and its measurement, in a folder; none if it cannot be simulated.
fn measured(random: &mut Random, seed: u64, number: u64, folder: &Path) -> Option<Measured> {
    let case = Case::of(random, &ARTEFACTS, folder);
    let mut wanted = wanted(random, &case);
    wanted.estimator = json!({ "estimate": "gauss-newton" });
    for name in std::mem::take(&mut wanted.known) {
        wanted.truth.remove(&name);
    }
    // Some errors are there, and some are not.
    let (there, all) = (random.between(0.3, 1.5), wanted.truth.keys().cloned().collect::<Vec<String>>());
    for name in all {
        if !random.chance(there) {
            wanted.truth.remove(&name);
        }
    }
    let mut recipe = recipe(&case, &wanted, random);
    fs::write(folder.join("recipe.yaml"), recipe.to_string()).expect("the folder is there");
    let truth = json!({ "parameters": wanted.truth, "noise": { "probing_sigma_mm": 1e-3 } });
    fs::write(folder.join("truth.json"), truth.to_string()).expect("the folder is there");
    let registry = Registry::built_in().expect("the plugins have different names");
    let simulated = prepare(&folder.join("recipe.yaml"), &registry)
        .and_then(|prepared| prepared.simulate(&folder.join("truth.json"), seed ^ number, Some("machine")));
    let measured = folder.join("measured");
    simulated.ok()?.write(&measured).ok()?;
    let file = measured.join("programme.csv");
    let (head, rows) = simulated_rows(&file);
    fs::write(&file, head.clone() + &rows.concat()).expect("the folder is there");
    let in_two = random.chance(0.4);
    if in_two {
        halve(random, &mut recipe, &file, (&head, &rows));
    }
    let mut machine: Vec<String> = wanted.parameters.iter().filter(|name| *name != "art.*").cloned().collect();
    if random.chance(0.9) {
        machine = determined(&mut recipe, &measured)?;
    }
    let mut named = settings(random, &mut recipe, &machine);
    named.extend(in_two.then_some("two stages"));
    let words = if named.is_empty() { "plain".to_owned() } else { named.join(", ") };
    let kind = format!("{:?}, {words}", case.artefact);
    let is_robust = named.contains(&"robust");
    Some(Measured { kind, recipe, rows: rows.len(), is_robust })
}

/// Leaves out what the rows do not determine; gives the parameters of the machine that are left. None where nothing is left.
fn determined(recipe: &mut Value, folder: &Path) -> Option<Vec<String>> {
    let mut dropping = recipe.clone();
    dropping["stages"]["fit"]["on_confounded"] = json!("drop");
    let outcome = Said::new(folder, &dropping).outcome.ok()?;
    let fit = outcome.fits.iter().find(|fit| fit.name == "fit")?;
    let names = fit.problem.unknowns.iter().filter(|unknown| !fit.calibration.fit.dropped.contains(&unknown.name));
    let left: Vec<_> = names.collect();
    recipe["stages"]["fit"]["parameters"] = left.iter().map(|unknown| unknown.name.as_str()).collect();
    Some(left.iter().filter(|unknown| unknown.owner == Owner::Machine).map(|unknown| unknown.name.clone()).collect())
}

/// A table as it was simulated: what stands before its rows, and these, each with a label of a group.
fn simulated_rows(file: &Path) -> (String, Vec<String>) {
    let text = fs::read_to_string(file).expect("it was simulated");
    let (comments, table): (Vec<&str>, Vec<&str>) = text.lines().partition(|line| line.starts_with('#'));
    let comments: String = comments.iter().map(|line| format!("{line}\n")).collect();
    let header = table.first().copied().unwrap_or_default();
    let rows = table.iter().skip(1).enumerate().map(|(row, line)| format!("{line},{}\n", row % 7));
    (format!("{comments}{header},group\n"), rows.collect())
}

/// Every other row for an artefact stage of its own, which states another uncertainty.
fn halve(random: &mut Random, recipe: &mut Value, file: &Path, (head, rows): (&str, &[String])) {
    let half = |first: usize| rows.iter().skip(first).step_by(2).fold(head.to_owned(), |text, row| text + row);
    fs::write(file.with_file_name("second.csv"), half(1)).expect("the folder is there");
    fs::write(file, half(0)).expect("the folder is there");
    let stages = &mut recipe["stages"];
    stages["data-2"] = json!({ "ingest": "csv", "path": "second.csv" });
    stages["art-2"] = stages["art"].clone();
    stages["art-2"]["from"] = json!("data-2");
    stages["art-2"]["standard_uncertainty_um"] = json!(random.of(&[0.3, 1.0, 4.0]));
    stages["fit"]["observations"] = json!(["art", "art-2"]);
    if let Some(parameters) = stages["fit"]["parameters"].as_array_mut().filter(|all| all.contains(&json!("art.*"))) {
        parameters.push(json!("art-2.*"));
    }
}

/// What a recipe says of some measurements: results, or why there are none.
struct Said {
    outcome: Result<Outcome, String>,
    /// Whether `check` accepts the estimate; none if it fails.
    accepted: Option<bool>,
}

impl Said {
    fn new(folder: &Path, recipe: &Value) -> Self {
        let file = folder.join("recipe.yaml");
        fs::write(&file, recipe.to_string()).expect("the folder is there");
        let registry = Registry::built_in().expect("the plugins have different names");
        let message = |error: abbe_core::Error| error.message;
        let prepared = match prepare(&file, &registry) {
            Ok(prepared) => prepared,
            Err(error) => return Self { outcome: Err(message(error)), accepted: None },
        };
        let accepted = prepared.check().ok().and_then(|planned| planned.first().map(|planned| planned.accepted));
        let outcome = prepared.run(&Monitor::default()).and_then(|outcome| {
            let failed = outcome.failures.iter().find(|failure| failure.stage == "fit");
            failed.map_or(Ok(()), |failure| Err(failure.error.clone())).map(|()| outcome)
        });
        Self { outcome: outcome.map_err(message), accepted }
    }

    /// Whether the estimate and all stages after it converge.
    fn converges(&self) -> bool {
        let is_lost = |message: &String| message.contains("does not converge");
        match &self.outcome {
            Err(message) => !is_lost(message),
            Ok(outcome) => {
                let of_folds = outcome.verdicts.iter().flat_map(|verdict| &verdict.remarks);
                !outcome.failures.iter().map(|failure| &failure.error.message).chain(of_folds).any(is_lost)
            }
        }
    }

    fn calibration(outcome: &Outcome) -> &Calibration {
        &outcome.fits.iter().find(|fit| fit.name == "fit").expect("it was estimated").calibration
    }
}

fn one(seed: u64, number: u64) -> Ended {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let random = &mut Random::new(seed, number);
    let Some(Measured { kind, mut recipe, rows, is_robust }) = measured(random, seed, number, folder.path()) else {
        return Ended { kind: "any".to_owned(), end: "not simulated".to_owned(), broken: Vec::new(), apart: 0.0 };
    };
    let folder = folder.path().join("measured");
    let held = Said::new(&folder, &recipe);
    let mut ended = Ended { kind, end: end(&held), broken: Vec::new(), apart: 0.0 };
    for size in sizes(random, rows) {
        read_in_batches(&mut recipe, size);
        let batched = Said::new(&folder, &recipe);
        let (broken, apart) = compared(&held, &batched);
        ended.apart = ended.apart.max(apart);
        if held.converges() != batched.converges() {
            ended.end = "one way does not converge".to_owned();
            continue;
        }
        if is_robust {
            continue;
        }
        ended.broken.extend(broken.into_iter().map(|law| format!("{}, {size} rows a batch: {law}", ended.kind)));
    }
    ended
}

/// How many rows a batch has: all, a third of them or more, few.
fn sizes(random: &mut Random, rows: usize) -> [usize; 3] {
    [1_000_000, random.count(rows / 3 + 1, rows + 1), random.count(3, rows / 4 + 5)]
}

/// Has the recipe read its measurements in batches of so many rows.
fn read_in_batches(recipe: &mut Value, size: usize) {
    for ingest in ["data", "data-2"] {
        if recipe["stages"].get(ingest).is_some() {
            recipe["stages"][ingest]["batch_rows"] = json!(size);
        }
    }
}

/// Writes a case into a folder: its measurement, `held.yaml`, and `batches-N.yaml` with N rows a batch. Nothing if it cannot be simulated.
pub fn write(seed: u64, number: u64, folder: &Path) {
    let random = &mut Random::new(seed, number);
    let Some(Measured { mut recipe, rows, .. }) = measured(random, seed, number, folder) else { return };
    let write = |name: &str, recipe: &Value| {
        let text = serde_json::to_string_pretty(recipe).expect("JSON");
        fs::write(folder.join("measured").join(name), text).expect("the folder is there");
    };
    write("held.yaml", &recipe);
    for size in sizes(random, rows) {
        read_in_batches(&mut recipe, size);
        write(&format!("batches-{size}.yaml"), &recipe);
    }
}

fn end(said: &Said) -> String {
    match &said.outcome {
        Err(message) if message.starts_with("the data determine") => "refused".to_owned(),
        Err(message) => format!("other: {}", shortened(message)),
        Ok(outcome) => match &Said::calibration(outcome).fit.selection {
            Some(selection) if selection.kept.is_empty() => "estimated, none kept".to_owned(),
            Some(selection) if selection.left_out.is_empty() => "estimated, all kept".to_owned(),
            Some(_) => "estimated, some kept".to_owned(),
            None => "estimated".to_owned(),
        },
    }
}

/// The laws that are broken, and the largest difference of values and uncertainties.
fn compared(held: &Said, batched: &Said) -> (Vec<String>, f64) {
    let (one, other) = match (&held.outcome, &batched.outcome) {
        (Ok(one), Ok(other)) => (one, other),
        // Words may differ: in batches less is told of what is lost.
        (Err(_), Err(_)) => return (Vec::new(), 0.0),
        (Ok(_), Err(message)) => return (vec![format!("refused in batches alone: {message}")], 0.0),
        (Err(message), Ok(_)) => return (vec![format!("refused with all rows alone: {message}")], 0.0),
    };
    let (mut broken, mut apart) = (Vec::new(), 0.0);
    if batched.accepted != Some(true) {
        broken.push(format!("`check` says {:?} in batches, and `run` estimates", batched.accepted));
    }
    let (one_is, other_is) = (Said::calibration(one), Said::calibration(other));
    broken.extend(selected(one_is, other_is));
    broken.extend(agree(one_is, other_is, &mut apart));
    if one.failures.len() != other.failures.len() {
        broken.push(format!("other stages fail: {:?} and {:?}", one.failures, other.failures));
    }
    for verdict in &one.verdicts {
        match other.verdicts.iter().find(|other| other.stage == verdict.stage) {
            Some(found) => broken.extend(figures(verdict, found)),
            None => broken.push(format!("no verdict of `{}`", verdict.stage)),
        }
    }
    (broken, apart)
}

/// Whether the same terms are selected.
fn selected(one: &Calibration, other: &Calibration) -> Option<String> {
    let (one, other) = match (&one.fit.selection, &other.fit.selection) {
        (Some(one), Some(other)) => (one, other),
        (one, other) => return (one.is_some() != other.is_some()).then(|| "only one has selected".to_owned()),
    };
    let near = |one: f64, other: f64| (one - other).abs() <= 1e-5 * one.max(other).max(1e-12);
    let same = (&one.kept, &one.left_out, one.steps.len()) == (&other.kept, &other.left_out, other.steps.len())
        && one.steps.iter().zip(&other.steps).all(|(one, other)| {
            (&one.parameter, one.entered) == (&other.parameter, other.entered)
                && near(one.probability, other.probability)
        });
    (!same).then(|| format!("selected {one:?} and {other:?}"))
}

/// Whether values, uncertainties and figures of the fit are the same.
fn agree(one: &Calibration, other: &Calibration, apart: &mut f64) -> Vec<String> {
    let mut broken = Vec::new();
    for (own, found) in one.fit.variance.iter().zip(&other.fit.variance) {
        let near = |one: f64, other: f64| (one / other - 1.0).abs() <= ALLOWED;
        let freedom = match (own.degrees_of_freedom, found.degrees_of_freedom) {
            (Some(one), Some(other)) => (one - other).abs() <= 1e-6 * one,
            (one, other) => one.is_none() && other.is_none(),
        };
        if own.stage != found.stage || !near(own.factor, found.factor) || !freedom {
            broken.push(format!("{own:?} and {found:?}"));
        }
    }
    if one.fit.variance.len() != other.fit.variance.len() {
        broken.push("not as many factors".to_owned());
    }
    let fit = |of: &Calibration| (of.fit.observations, of.fit.unknowns, of.fit.rank, of.fit.degrees_of_freedom);
    if fit(one) != fit(other) {
        broken.push(format!("observations, unknowns, rank, degrees of freedom: {:?} and {:?}", fit(one), fit(other)));
    }
    if (one.parameters.len(), one.artefacts.len()) != (other.parameters.len(), other.artefacts.len()) {
        broken.push("not the same parameters".to_owned());
    }
    for one in one.parameters.iter().chain(&one.artefacts) {
        let Some(other) = other.get(&one.name) else {
            broken.push(format!("{} is missing in batches", one.name));
            continue;
        };
        let u = one.standard_uncertainty;
        let off = (one.value - other.value).abs().max((u - other.standard_uncertainty).abs());
        if u > 0.0 {
            *apart = apart.max(off / u);
        }
        if one.status != other.status || off > ALLOWED * u {
            broken.push(format!("{one:?} and {other:?}"));
        }
    }
    broken
}

/// Whether a verdict has the same figures.
fn figures(one: &Verdict, other: &Verdict) -> Vec<String> {
    let of = |verdict: &Verdict| -> BTreeMap<String, Option<f64>> {
        let named = verdict.figures.iter().map(|own| (format!("{:?} {} {}", own.of, own.name, own.unit), own.value));
        named.collect()
    };
    let (one_is, other_is) = (of(one), of(other));
    if !one_is.keys().eq(other_is.keys()) {
        return vec![format!("`{}` has other figures: {one_is:?} and {other_is:?}", one.stage)];
    }
    let far = |(one, other): (&Option<f64>, &Option<f64>)| match (one, other) {
        (Some(one), Some(other)) => (one - other).abs() > 10.0 * ALLOWED * one.abs() + 1e-9,
        (one, other) => one.is_some() != other.is_some(),
    };
    let off = one_is.iter().zip(other_is.values()).filter(|((_, value), other)| far((value, other)));
    off.map(|((name, value), other)| format!("`{}`, {name}: {value:?} and {other:?}", one.stage)).collect()
}
