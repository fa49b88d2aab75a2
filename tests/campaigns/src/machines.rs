//! Random machines of three to six axes, all artefacts, random parameters, with and without what is known.
//!
//! What has to hold in every case:
//!
//! 1. `check` and `run` agree on what the data determine;
//! 2. no parameter without effect on the measurements is called estimated: the effect is told by differences, far from zero;
//! 3. an estimate from parts of the rows is that of all rows;
//! 4. no value that is called estimated is off by more than ten of its standard uncertainties;
//! 5. nobody is told that signs are turned, columns exchanged, rows planned, outliers gathered or a row wrong: data are as simulated.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use abbe_core::{Fit, Monitor, Owner, Problem, Registry, Status, Unknown, in_parallel};
use abbe_engine::prepare;
use abbe_estimation::laws::check_parts;
use abbe_estimation::{at_contact, comparisons, doubtful_row, gathered_outliers, remarks};
use serde_json::{Value, json};

use crate::Random;
use crate::machine::{Artefact, Case, error};
use crate::programme::{PoseNoise, observe};

use abbe_bundle as _;

/// What a campaign found.
#[derive(Debug, Default)]
pub struct Report {
    /// For people.
    pub text: String,
    /// The broken laws, one line each.
    pub broken: Vec<String>,
}

/// How a case ended.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum End {
    /// Estimated, all values called so.
    Full,
    /// Estimated, some values marked as confounded.
    Marked,
    /// Refused because the data do not determine all.
    Refused,
    /// It was refused for another reason: too few rows, or no scatter.
    Other(String),
}

/// Runs the cases `0..count` of a seed.
pub fn run(seed: u64, count: u64) -> Report {
    let cases: Vec<u64> = (0..count).collect();
    let found = in_parallel(&cases, None, |case| one(seed, *case));
    let mut ends: BTreeMap<String, usize> = BTreeMap::new();
    let mut report = Report::default();
    let mut worst = 0.0_f64;
    for (case, (kind, end, broken, off)) in found.into_iter().enumerate() {
        let name = match &end {
            End::Other(message) => format!("{kind}: other: {message}"),
            end => format!("{kind}: {end:?}"),
        };
        *ends.entry(name).or_default() += 1;
        worst = worst.max(off);
        report.broken.extend(broken.into_iter().map(|law| format!("seed {seed}, case {case}: {law}")));
    }
    for (name, count) in ends {
        writeln!(report.text, "{count:6} {name}").expect("a text");
    }
    writeln!(report.text, "largest deviation of an estimated value: {worst:.1} standard uncertainties")
        .expect("a text");
    writeln!(report.text, "{} of {count} cases broke a law", report.broken.len()).expect("a text");
    report.broken.iter().for_each(|law| writeln!(report.text, "  {law}").expect("a text"));
    report
}

/// What is asked of a case.
pub struct Wanted {
    pub(crate) parameters: Vec<String>,
    pub(crate) known: Vec<String>,
    pub(crate) estimator: Value,
    pub(crate) truth: BTreeMap<String, f64>,
    noise: f64,
}

pub(crate) fn wanted(random: &mut Random, case: &Case) -> Wanted {
    let names: Vec<&str> = case.model.info().parameters.iter().map(|parameter| parameter.name.as_str()).collect();
    let mut shuffled = random.shuffled(&names);
    if case.artefact == Artefact::Direct && random.chance(0.7) {
        // Readings along single lines tell little of the places of axes.
        shuffled.sort_by_key(|name| !name.contains('['));
    }
    let machine = random.of(&[1, 2, 3, 4, 6, 8, 12]).min(names.len() - 1);
    let mut parameters: Vec<String> = shuffled[..machine].iter().map(|&name| name.to_owned()).collect();
    let known: Vec<String> = match random.chance(0.4) {
        true => shuffled[machine..].iter().take(random.count(1, 10)).map(|&name| name.to_owned()).collect(),
        false => Vec::new(),
    };
    if case.stage["artefact"] != "length" {
        parameters.push("art.*".to_owned());
    }
    let confounded = random.of(&["error", "drop", "minimum-norm"]);
    let mut estimator = json!({ "estimate": "gauss-newton", "on_confounded": confounded });
    if random.chance(0.15) {
        estimator["robust"] = json!(random.of(&["huber", "tukey"]));
    }
    let noise = if random.chance(0.4) { 0.0 } else { 1e-3 };
    if noise > 0.0 {
        estimator["trust_uncertainties"] = json!(true);
    }
    let of = |name: &String| case.model.info().parameters.iter().find(|parameter| parameter.name == *name);
    let own = parameters.iter().chain(&known);
    let truth = own.filter_map(|name| Some((name.clone(), error(random, of(name)?)))).collect();
    Wanted { parameters, known, estimator, truth, noise }
}

pub(crate) fn recipe(case: &Case, wanted: &Wanted, random: &mut Random) -> Value {
    let mut stage = case.stage.clone();
    stage["from"] = json!("data");
    let mut machine = case.machine.clone();
    machine["model"] = json!("serial-chain");
    let mut fit = wanted.estimator.clone();
    fit["machine"] = json!("machine");
    fit["observations"] = json!("art");
    fit["parameters"] = json!(wanted.parameters);
    let mut stages = serde_json::Map::new();
    stages.insert("data".to_owned(), json!({ "ingest": "csv", "path": case.programme }));
    stages.insert("art".to_owned(), stage);
    stages.insert("machine".to_owned(), machine);
    if !wanted.known.is_empty() {
        let stated = wanted.known.iter().map(|name| {
            let unknown = case.model.info().parameters.iter().find(|parameter| parameter.name == *name);
            let unit = unknown.map_or_else(String::new, |parameter| parameter.unit.to_string());
            let (value, uncertainty) = (wanted.truth[name], wanted.truth[name].abs() * 1e-2);
            let stated = value + uncertainty * random.normal();
            (name.clone(), json!({ "value": stated, "standard_uncertainty": uncertainty, "unit": unit }))
        });
        let values: serde_json::Map<String, Value> = stated.collect();
        stages.insert("before".to_owned(), json!({ "estimate": "stated", "machine": "machine", "values": values }));
        fit["known"] = json!("before");
    }
    stages.insert("fit".to_owned(), fit);
    json!({ "abbe": 1, "name": "Random machine", "stages": stages })
}

/// Writes a case into a folder, for a closer look: recipe, programme, nominal artefact and truth.
pub fn write(seed: u64, number: u64, folder: &Path) -> (String, Wanted) {
    let random = &mut Random::new(seed, number);
    let case = Case::new(random, folder);
    let wanted = wanted(random, &case);
    let text = serde_json::to_string_pretty(&recipe(&case, &wanted, random)).expect("JSON");
    fs::write(folder.join("recipe.yaml"), text).expect("the folder is there");
    let truth = json!({ "parameters": wanted.truth, "noise": { "probing_sigma_mm": wanted.noise } });
    fs::write(folder.join("truth.json"), truth.to_string()).expect("the folder is there");
    if case.artefact == Artefact::Poses {
        let info = case.model.info();
        let parameters = info.parameters.iter().zip(&info.nominal);
        let values: Vec<f64> =
            parameters.map(|(own, nominal)| wanted.truth.get(&own.name).copied().unwrap_or(*nominal)).collect();
        let noise = PoseNoise { length: wanted.noise, angle: wanted.noise * 1e-2 };
        let at_tool = case.stage["observer"] == "at-tool";
        observe(random, case.model.as_ref(), &values, at_tool, &noise, &folder.join(&case.programme));
    }
    (format!("{:?}", case.artefact), wanted)
}

/// The laws that one case breaks.
pub fn broken(seed: u64, number: u64) -> Vec<String> {
    one(seed, number).2
}

/// One case: its kind, how it ended, the laws that it broke, the largest deviation of an estimated value in standard uncertainties.
fn one(seed: u64, number: u64) -> (String, End, Vec<String>, f64) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (kind, wanted) = write(seed, number, folder.path());
    let is_observed = kind == format!("{:?}", Artefact::Poses);
    let other = |message: String| (kind.clone(), End::Other(message), Vec::new(), 0.0);
    let registry = Registry::built_in().expect("the plugins have different names");
    let programme = match prepare(&folder.path().join("recipe.yaml"), &registry) {
        Ok(programme) => programme,
        Err(error) => return other(format!("recipe: {}", error.message)),
    };
    if is_observed {
        return judge(folder.path(), &registry, &wanted, kind);
    }
    let simulated = programme.simulate(&folder.path().join("truth.json"), number, Some("machine"));
    let measured = folder.path().join("measured");
    match simulated.map(|simulated| simulated.write(&measured)) {
        Ok(Ok(())) => {}
        Ok(Err(error)) | Err(error) => return other(format!("not simulated: {}", shortened(&error.message))),
    }
    judge(&measured, &registry, &wanted, kind)
}

fn judge(folder: &Path, registry: &Registry, wanted: &Wanted, kind: String) -> (String, End, Vec<String>, f64) {
    let prepared = prepare(&folder.join("recipe.yaml"), registry).expect("the recipe was prepared before");
    let planned = match prepared.check() {
        Ok(planned) => planned,
        Err(error) => return (kind, End::Other(format!("check: {}", shortened(&error.message))), Vec::new(), 0.0),
    };
    let planned = &planned[0];
    let found = &planned.identifiability;
    let mut broken = Vec::new();
    let run = prepared.run(&Monitor::default()).and_then(|outcome| match outcome.failures.first() {
        Some(failure) => Err(failure.error.clone()),
        None => Ok(outcome),
    });
    let outcome = match run {
        Ok(outcome) => outcome,
        Err(error) => {
            let refused = format!("the data determine {} of {} unknowns", found.rank, found.unknowns);
            let end = match (planned.accepted, error.message.starts_with("the data determine")) {
                (false, true) if error.message.starts_with(&refused) => End::Refused,
                (accepted, _) => {
                    let message = shortened(&error.message);
                    // Too few rows, or exact ones: nothing is said of what they determine.
                    let words = ["# equations cannot", "degrees of freedom", "residuals are exactly zero"];
                    if !words.iter().any(|words| message.contains(words)) {
                        broken.push(format!(
                            "check says rank {} of {} (condition {:.1e}, accepted: {accepted}), run fails: {}",
                            found.rank,
                            found.unknowns,
                            found.condition,
                            error.message.lines().next().unwrap_or_default()
                        ));
                    }
                    End::Other(message)
                }
            };
            return (kind, end, broken, 0.0);
        }
    };
    let fit = outcome.fits.iter().find(|fit| fit.name == "fit").expect("it was estimated");
    if !planned.accepted || fit.calibration.fit.rank != found.rank {
        broken.push(format!("check says rank {}, run {}", found.rank, fit.calibration.fit.rank));
    }
    broken.extend(without_effect(fit));
    broken.extend(false_alarms(fit));
    // Two to five parts, by the number of rows.
    let of_parts = check_parts(fit.estimator.as_ref(), &fit.problem, 2 + fit.problem.equations() % 4);
    broken.extend(of_parts.unwrap_or_else(|error| vec![format!("all rows again: {error}")]));
    let (wrong, off) = beyond(fit, wanted);
    broken.extend(wrong);
    let marked = fit.calibration.parameters.iter().any(|parameter| parameter.status == Status::Confounded);
    (kind, if marked { End::Marked } else { End::Full }, broken, off)
}

/// A message with its numbers hidden, so that like ones are counted together.
pub(crate) fn shortened(message: &str) -> String {
    let line: String = message.lines().next().unwrap_or_default().chars().take(70).collect();
    let mut text = String::new();
    for character in line.chars() {
        match character.is_ascii_digit() || character == '.' {
            true if text.ends_with('#') => {}
            true => text.push('#'),
            false => text.push(character),
        }
    }
    text
}

/// Words of remarks on rows of a plan among measured ones, and on labels, times and directions that other columns contradict.
const FALSE: [&str; 6] = [
    "or are they positions of a plan",
    "are the two labels exchanged",
    "are the two columns exchanged",
    "from row to row the axes move against",
    "the time falls",
    "beside the nominal points of their facets",
];

/// Remarks on signs that are turned, columns that are exchanged, rows of a plan, what other columns contradict, outliers that gather, and
/// a single row or statement that spoils a fit.
fn false_alarms(fit: &Fit) -> Vec<String> {
    let all = remarks(&fit.problem).into_iter();
    let told = all.filter(|remark| FALSE.iter().any(|words| remark.contains(words)));
    let compared = comparisons(&fit.problem, Some(&fit.problem.values_of(&fit.calibration)));
    let residuals = fit.problem.residuals(&fit.problem.values_of(&fit.calibration)).unwrap_or_default();
    let gathered = gathered_outliers(&fit.problem, &fit.calibration, &residuals);
    let spoiled = doubtful_row(&fit.problem).filter(|_| fit.calibration.outliers.is_empty());
    told.chain(compared)
        .chain(gathered)
        .chain(spoiled)
        .chain(fit.calibration.fit.remarks.clone())
        .map(|remark| format!("false alarm: {remark}"))
        .collect()
}

/// Parameters that are called estimated although residuals in nominal contact do not change when they change a lot.
fn without_effect(fit: &Fit) -> Vec<String> {
    let mut nominal = Problem::clone(&fit.problem);
    nominal.machine_values.clone_from(&nominal.model.info().nominal);
    nominal.sets.iter_mut().for_each(|set| set.own = set.info().start.clone());
    let Ok(contact) = at_contact(&nominal, &nominal.start()) else { return Vec::new() };
    let start = contact.start();
    let mut wrong = Vec::new();
    for (index, Unknown { name, unit, owner, .. }) in contact.unknowns.iter().enumerate() {
        let estimated = fit.calibration.get(name).is_some_and(|found| found.status == Status::Estimated);
        if *owner != Owner::Machine || !estimated {
            continue;
        }
        // A micrometre at the end of the travel, or a microradian, moves no residual by a billionth of that.
        let step = 1e-3 / unit.per.map_or(1.0, |(_, degree)| 200.0_f64.powi(i32::from(degree)));
        let moved = |by: f64| {
            let mut x = start.clone();
            x[index] += by;
            contact.residuals(&x)
        };
        let (Ok(over), Ok(under)) = (moved(step), moved(-step)) else { continue };
        let change = over.iter().zip(under).map(|(over, under)| (over - under).abs()).fold(0.0, f64::max);
        if change < 1e-11 {
            wrong.push(format!("{name} is called estimated and has no effect ({change:.1e})"));
        }
    }
    wrong
}

/// Values that are called estimated and are further from the truth than ten standard uncertainties.
fn beyond(fit: &Fit, wanted: &Wanted) -> (Vec<String>, f64) {
    let (mut wrong, mut largest) = (Vec::new(), 0.0_f64);
    // Few degrees of freedom tell no uncertainty.
    if wanted.noise == 0.0 && fit.calibration.fit.degrees_of_freedom < 10 {
        return (wrong, largest);
    }
    for estimated in fit.calibration.parameters.iter().filter(|estimated| estimated.status == Status::Estimated) {
        let truth = wanted.truth.get(&estimated.name).copied().unwrap_or(0.0);
        let (error, u) = ((estimated.value - truth).abs(), estimated.standard_uncertainty);
        let rounding = 1e-9 * truth.abs().max(1e-4);
        if error > rounding {
            largest = largest.max(error / u);
        }
        if error > 10.0 * u + rounding {
            wrong.push(format!("{} = {:e}, u = {u:.1e}, true is {truth:e}", estimated.name, estimated.value));
        }
    }
    (wrong, largest)
}
