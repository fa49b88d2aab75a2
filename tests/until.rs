//! `plan: until`: how good rows, artefact and probe have to be, and whether what is promised covers the true errors.

use std::path::Path;

use abbe_engine::{Measurements, prepare};
use serde_json::{Map, Value, json};
use tempfile::TempDir;

use crate::controls::law::{seeds, uniform};
use crate::support::{abbe, fit, read, registry, temporary, write};

/// A begun calibration of a random machine with five axes.
pub fn begun(method: &str, random: &mut impl FnMut() -> f64) -> (TempDir, String) {
    let chains = crate::models::all_chains();
    let chain = chains[840 + (random() * (chains.len() - 840) as f64) as usize % (chains.len() - 840)].clone();
    let folder = temporary();
    let printed = abbe(folder.path(), &["new", "m", "--chain", &chain, "--method", method]);
    assert_eq!(printed.status, 0, "{chain}: {}", printed.stderr);
    (folder, chain)
}

/// The plan of a begun recipe with other keys, and with texts of the recipe exchanged.
fn planned(folder: &Path, stage: &str, plan: &str, changes: &[(&str, String)]) -> Result<Measurements, String> {
    let mut text = read(&folder.join("m/recipe.yaml"));
    let grid = text.lines().find(|line| line.contains("generate:")).expect("a grid").to_owned();
    text.truncate(text.find("\nplan:").expect("a plan"));
    for (from, to) in changes {
        assert!(text.contains(from), "{from}: {text}");
        text = text.replace(from, to);
    }
    let own =
        format!("\nplan:\n  estimate: fit\n  candidates: {stage}\n  by: group\n  parameters: [\"E*\"]\n{plan}{grid}\n");
    write(&folder.join("m/p.yaml"), &(text + &own));
    let prepared = prepare(&folder.join("m/p.yaml"), &registry());
    prepared
        .and_then(|prepared| prepared.plan())
        .map_err(|error| format!("{error} {}", error.help.as_deref().unwrap_or_default()))
}

/// A bar, and a ball with its certificate and a probe: with an input as uncertain as the reverse answer allows, what is wanted is
/// reached exactly, and beyond it not.
#[test]
fn how_good_bar_ball_and_probe_have_to_be() {
    let bar: &[&str] = &["standard_uncertainty_um: 1, length_standard_uncertainty_um: {}"];
    let ball: &[&str] = &[
        "standard_uncertainty_um: 2, diameters: [{ feature: 1, standard_uncertainty_um: {} }]",
        "standard_uncertainty_um: 2, stylus_radius_standard_uncertainty_um: {}",
    ];
    let cases = [
        ("ball-bar", "bar", "standard_uncertainty_um: 1, length_standard_uncertainty_um: 1", bar),
        ("ball", "ball", "standard_uncertainty_um: 2", ball),
    ];
    let (mut exact, mut none) = (0, 0);
    for seed in seeds(3) {
        for (method, stage, from, ways) in cases {
            let mut random = uniform(310 + seed);
            let (folder, chain) = begun(method, &mut random);
            for way in ways {
                let what = format!("{seed}: {chain} {way}");
                let stated = 0.2 + random();
                let of = |um: f64, number: usize, stated: f64| {
                    let plan =
                        format!("  number: {number}\n  restarts: 2\n  until: {{ expanded_um: {um:?}, of: tool }}\n");
                    planned(folder.path(), stage, &plan, &[(from, way.replace("{}", &format!("{stated:?}")))])
                };
                let any = of(1e6, 12, stated).unwrap_or_else(|error| panic!("{what}: {error}"));
                let any = any.plan.reached.expect("an uncertainty was wanted");
                let all = of(1e6, 12, 1e-6).unwrap_or_else(|error| panic!("{what}: {error}")).plan.reached.expect("it");
                assert!(all.expanded <= any.expanded, "{what}");
                let um = any.expanded * 1e3 * 0.7;
                let Ok(found) = of(um, 12, stated) else { continue };
                let reached = found.plan.reached.clone().expect("an uncertainty was wanted");
                let Some(input) = reached.largest_of_inputs.first() else { continue };
                let part = input.part.expect("what is stated is enough");
                assert!((input.stated.expect("one quantity") * 1e3 / stated - 1.0).abs() < 1e-9, "{what}: {input:?}");
                assert!(part >= 1.0 - 1e-9, "{what}: {input:?}");
                // The same design has it to the last digit; the fewest stay as many, since nothing became better.
                let number = found.plan.chosen.iter().map(|chosen| chosen.times).sum();
                let worse = of(um, number, stated * part).unwrap_or_else(|error| panic!("{what}: {error}"));
                if worse.plan.chosen == found.plan.chosen {
                    let again = worse.plan.reached.expect("an uncertainty was wanted");
                    assert!((again.expanded / again.wanted - 1.0).abs() < 1e-6, "{what}: {again:?}");
                    let beyond = of(um, number, stated * part * 1.01).err().expect("it is beyond");
                    assert!(beyond.contains("or less instead of"), "{what}: {beyond}");
                    exact += 1;
                }
                // What the rows alone do not reach, no artefact does.
                let message = of(all.expanded * 1e3 * 1e-3, 12, stated).err().expect("out of reach");
                assert!(message.contains("no better calibration of artefact or probe suffices"), "{what}: {message}");
                none += 1;
            }
        }
    }
    println!("{exact} answers exact, {none} times none");
    assert!(exact > 0 && none > 0);
}

/// The method, its artefact stage, and what is stated of its artefact and probe instead of the noise alone.
type Stated = (&'static str, &'static str, &'static [(&'static str, &'static str)]);

/// Noise alone; a stylus, a ball and a bar with their certificates.
const STATED: [Stated; 4] = [
    ("ball", "ball", &[]),
    ("ball", "ball", &[(NOISE_OF_BALL, "standard_uncertainty_um: 2, stylus_radius_standard_uncertainty_um: 1.5")]),
    (
        "ball",
        "ball",
        &[(NOISE_OF_BALL, "standard_uncertainty_um: 2, diameters: [{ feature: 1, standard_uncertainty_um: 2.5 }]")],
    ),
    ("ball-bar", "bar", &[(NOISE_OF_BAR, "standard_uncertainty_um: 2, length_standard_uncertainty_um: 2.5")]),
];

const NOISE_OF_BALL: &str = "standard_uncertainty_um: 2";
const NOISE_OF_BAR: &str = "standard_uncertainty_um: 1, length_standard_uncertainty_um: 1";

/// True values of what is known of artefact and probe, drawn within its uncertainty: mm.
fn drawn_inputs(problem: &abbe_core::Problem, random: &mut impl FnMut() -> f64) -> Map<String, Value> {
    let mut drawn = Map::new();
    for set in &problem.sets {
        for input in set.observations.info().inputs.iter().filter(|input| input.standard_uncertainty > 0.0) {
            let own = &input.parameter.name;
            let name = if input.shared { own.clone() } else { format!("{}.{own}", set.name) };
            // Box and Muller (1958).
            let (radius, turn) = ((-2.0 * (1.0 - random()).ln()).sqrt(), std::f64::consts::TAU * random());
            drawn.insert(name, json!(input.value + input.standard_uncertainty * radius * turn.cos()));
        }
    }
    drawn
}

/// Plans that promise an uncertainty, measured on random machines with the noise that was stated, an artefact and a probe that are
/// off as their certificates allow: what is found is off by what was promised, as often as it says.
#[test]
fn what_a_plan_promises_covers_the_true_errors() {
    for (case, stated) in STATED.into_iter().enumerate() {
        promises_cover(case as u64, stated);
    }
}

fn promises_cover(case: u64, (method, stage, changes): Stated) {
    let (mut squares, mut freedom, mut within, mut all) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
    let changes: Vec<(&str, String)> = changes.iter().map(|(from, to)| (*from, (*to).to_owned())).collect();
    for seed in seeds(2) {
        let mut random = uniform(77 + seed + 1000 * case);
        let (folder, chain) = begun(method, &mut random);
        let at = folder.path();
        let plan = "  number: 12\n  restarts: 2\n  until: { expanded_um: 1000000 }\n";
        let any = planned(at, stage, plan, &changes).unwrap_or_else(|error| panic!("{chain}: {error}"));
        let um = any.plan.reached.expect("an uncertainty was wanted").expanded * 1e3 * (0.6 + 0.3 * random());
        let plan = format!("  number: 16\n  restarts: 2\n  until: {{ expanded_um: {um:?} }}\n");
        let Ok(found) = planned(at, stage, &plan, &changes) else { continue };
        let reached = found.plan.reached.clone().expect("an uncertainty was wanted");
        assert!(reached.expanded <= reached.wanted * (1.0 + 1e-9), "{chain}");
        // Planned touches are the measured ones.
        let candidates = found.files.iter().find(|(name, _)| name.ends_with("candidates.csv")).expect("candidates").1;
        let measured = if method == "ball" { "m/touches.csv" } else { "m/readings.csv" };
        std::fs::write(at.join(measured), candidates).expect("written");
        let unknowns = &found.plan.problem.unknowns;
        let judged = |unknown: &abbe_core::Unknown| unknown.unit.to_string() == "mm" && unknown.name.starts_with('E');
        let size = |name: &str| {
            if name.ends_with("[1]") {
                2e-5
            } else if name.starts_with("EA") || name.starts_with("EB") || name.starts_with("EC") {
                5e-5
            } else {
                0.02
            }
        };
        for trial in 0..3 {
            let machine =
                unknowns.iter().filter(|unknown| unknown.name.starts_with('E') || unknown.name.starts_with('d'));
            let mut truth: Map<String, Value> = machine
                .map(|unknown| (unknown.name.clone(), json!(size(&unknown.name) * (2.0 * random() - 1.0))))
                .collect();
            truth.extend(drawn_inputs(&found.plan.problem, &mut random));
            let file = at.join("truth.json");
            write(&file, &json!({ "parameters": truth, "noise": { "probing_sigma_mm": 0.002 } }).to_string());
            let text = read(&at.join("m/recipe.yaml")).replace("robust: tukey", "trust_uncertainties: true");
            let text = changes.iter().fold(text, |text, (from, to)| text.replace(from, to));
            write(&at.join("m/r.yaml"), &text[..text.find("\nplan:").expect("a plan")]);
            let simulated = prepare(&at.join("m/r.yaml"), &registry())
                .and_then(|prepared| prepared.simulate(&file, 1000 * seed + trial + 100 * case, None));
            let measured = at.join(format!("measured-{trial}"));
            simulated.unwrap_or_else(|error| panic!("{chain}: {error}")).write(&measured).expect("a folder");
            let outcome = prepare(&measured.join("r.yaml"), &registry())
                .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()));
            let outcome = outcome.unwrap_or_else(|error| panic!("{chain}: {error}"));
            let calibration = &fit(&outcome, "fit").calibration;
            let names: Vec<&str> = unknowns.iter().map(|unknown| unknown.name.as_str()).collect();
            let off = names.iter().map(|name| {
                let is = calibration.get(name).unwrap_or_else(|| panic!("{chain}: no {name}")).value;
                is - truth.get(*name).and_then(Value::as_f64).unwrap_or_default()
            });
            let off = nalgebra::DVector::from_iterator(names.len(), off);
            // By the rows, by artefact and by probe.
            let covariance = calibration.covariance.block(&names);
            let information = covariance.clone().try_inverse().expect("a covariance");
            squares += (off.transpose() * &information * &off)[(0, 0)];
            freedom += names.len() as f64;
            for index in (0..names.len()).filter(|index| judged(&unknowns[*index])) {
                let expanded = reached.coverage_factor * covariance[(index, index)].sqrt();
                within += f64::from(u8::from(off[index].abs() <= expanded));
                all += 1.0;
            }
            // What was promised is what the fit finds; the plan stands at the nominal machine.
            let worst = names.iter().position(|name| *name == reached.worst).expect("an unknown");
            let expanded = reached.coverage_factor * covariance[(worst, worst)].sqrt();
            let ratio = expanded / reached.expanded;
            assert!((ratio - 1.0).abs() < 0.02, "{chain}: {} has {ratio} of what was promised", reached.worst);
        }
    }
    // Chi-squared with so many degrees of freedom, four of its standard deviations around its mean.
    println!(
        "{method} {changes:?}: chi-squared {squares:.1} of {freedom} degrees of freedom; {within} of {all} lengths within"
    );
    assert!(freedom > 50.0 && (squares - freedom).abs() < 4.0 * (2.0 * freedom).sqrt(), "{squares} of {freedom}");
    let expected = 0.9545 * all;
    assert!(within > expected - 4.0 * (0.0455 * expected).sqrt() - 1.0, "{within} of {all}");
}
