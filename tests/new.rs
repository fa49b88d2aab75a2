//! `abbe new`: what it writes passes `abbe check`, and gives a simulated truth back, on any chain.

use std::collections::BTreeMap;

use abbe_core::Status;
use serde_json::{Map, json};

use crate::models::all_chains;
use crate::support::{abbe, fit, read, registry, temporary, write};

const METHODS: [&str; 6] = ["table", "ball", "balls", "ball-bar", "poses", "lengths"];

/// Random numbers: xorshift64*.
struct Random(u64);

impl Random {
    /// From -1 to 1.
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// Tens of micrometres, of microradians, of micrometres in a metre.
fn size(name: &str) -> f64 {
    match name {
        name if name.ends_with("[1]") => 5e-5,
        name if name.starts_with('d') || ["EX", "EY", "EZ"].iter().any(|begins| name.starts_with(begins)) => 0.05,
        _ => 1e-4,
    }
}

/// Begins a calibration, measures it on a virtual machine and runs it. The number of parameters that came back and how far they are
/// off, or the reason why the method tells nothing.
fn closed(chain: &str, method: &str, seed: u64) -> Result<(usize, f64), String> {
    let folder = temporary();
    let at = folder.path();
    let begun = abbe(at, &["new", "begun", "--chain", chain, "--method", method]);
    if begun.status != 0 {
        assert_eq!(begun.status, 2, "{chain} {method}: {}", begun.stderr);
        return Err(begun.stderr);
    }
    let prepared = |recipe: &str| {
        let prepared = abbe_engine::prepare(&at.join(recipe), &registry());
        prepared.unwrap_or_else(|error| panic!("{chain} {method}: {error}"))
    };
    let planned = prepared("begun/recipe.yaml").check().unwrap_or_else(|error| panic!("{chain} {method}: {error}"));
    assert!(planned[0].accepted && planned[0].identifiability.null_space.is_empty(), "{chain} {method}");
    let mut random = Random(0x9E37_79B9_7F4A_7C15 ^ (seed + 1).wrapping_mul(0xD1B5_4A32_D192_ED03));
    let machine = planned[0].machine.iter();
    let truth: Map<_, _> = machine.map(|name| (name.clone(), json!(size(name) * random.next()))).collect();
    write(&at.join("truth.json"), &json!({ "parameters": truth }).to_string());
    let simulated = prepared("begun/recipe.yaml").simulate(&at.join("truth.json"), seed, None);
    let simulated = simulated.unwrap_or_else(|error| panic!("{chain} {method}: {error}"));
    simulated.write(&at.join("measured")).expect("a folder");
    let outcome = prepared("measured/recipe.yaml").run(&abbe_core::Monitor::default());
    let outcome = outcome.unwrap_or_else(|error| panic!("{chain} {method}: {error}"));
    let calibration = &fit(&outcome, "fit").calibration;
    let mut worst = 0.0_f64;
    for (name, value) in &truth {
        let found = calibration.get(name).unwrap_or_else(|| panic!("{chain} {method}: no {name}"));
        let off = (found.value - value.as_f64().expect("a number")).abs();
        assert!(found.status == Status::Estimated && off < 1e-7, "{chain} {method}: {name} is off by {off}");
        worst = worst.max(off);
    }
    // The same with the noise that the recipe states.
    if seed.is_multiple_of(NOISY) {
        let (length, angle) = noise(method);
        // The tool that the exact measurements have is tilted by degrees, which would be told.
        let upright =
            |(name, value): (&String, &serde_json::Value)| match ["dat", "dbt", "dct"].contains(&name.as_str()) {
                true => (name.clone(), json!(2e-3 * value.as_f64().expect("a number"))),
                false => (name.clone(), value.clone()),
            };
        let truth: Map<_, _> = truth.iter().map(upright).collect();
        let noisy =
            json!({ "parameters": truth, "noise": { "probing_sigma_mm": length, "orientation_sigma_rad": angle } });
        write(&at.join("noisy.json"), &noisy.to_string());
        let simulated = prepared("begun/recipe.yaml").simulate(&at.join("noisy.json"), seed, None);
        simulated.and_then(|simulated| simulated.write(&at.join("noisy"))).expect("a folder");
        let run = abbe(at, &["run", "noisy/recipe.yaml", "--json", "--out", "out"]);
        let said = format!("{}{}", run.stdout, run.stderr);
        let told: Vec<&&str> = MISTAKES.iter().filter(|words| said.contains(**words)).collect();
        assert!(told.is_empty() && [0, 3].contains(&run.status), "{chain} {method}, seed {seed}: {told:?}\n{said}");
    }
    Ok((truth.len(), worst))
}

/// Every so many cases are measured with noise, too: a number that shares no factor with that of the methods.
const NOISY: u64 = 5;

/// The noise of a reading that a beginning states: mm, rad.
fn noise(method: &str) -> (f64, f64) {
    match method {
        "poses" => (2e-2, 5e-5),
        "ball-bar" => (1e-3, 0.0),
        _ => (2e-3, 0.0),
    }
}

/// Words about mistakes, which good measurements do not have.
const MISTAKES: [&str; 14] = [
    "are they copies",
    "axes move against",
    "run round against",
    "lead away from the surface",
    "from where it is said to stand",
    "away from contact",
    "is it the right file",
    "is the unit",
    "is the statement right",
    "times as much as the stated",
    "certificates contradict",
    "are outliers:",
    "the time falls",
    "likely",
];

/// Which chains are tried, `SHARDS [SHARD [SEED]]`: every so many, from this one on, with truths of this seed.
fn shard() -> [usize; 3] {
    let Ok(text) = std::env::var("ABBE_NEW_CHAINS") else { return [421, 0, 0] };
    let numbers: Vec<usize> =
        text.split(' ').map(|number| number.parse().expect("ABBE_NEW_CHAINS: numbers")).chain([0, 0]).take(3).collect();
    let [shards, shard, seed] = numbers[..] else { panic!("ABBE_NEW_CHAINS: three numbers at most, not `{text}`") };
    assert!(shard < shards, "ABBE_NEW_CHAINS: shards are numbered from 0 to {}", shards.saturating_sub(1));
    [shards, shard, seed]
}

/// What came of a method on the chains with so many axes.
#[derive(Default)]
struct Tally {
    parameters: Vec<usize>,
    worst: f64,
    refused: usize,
    failed: usize,
}

/// A sample of the chains of three to five axes with every method. `ABBE_NEW_CHAINS=1` tries all of them, `ABBE_NEW_CHAINS="40 7 3"`
/// the shard 7 of 40 (from 0) with the seed 3. Prints a table, and goes on after a failure.
#[test]
fn a_beginning_gives_a_simulated_truth_back_or_says_why_not() {
    let [shards, shard, seed] = shard();
    let mut tallies: BTreeMap<(usize, &str), Tally> = BTreeMap::new();
    let mut failures = Vec::new();
    for (place, chain) in all_chains().iter().enumerate().skip(shard).step_by(shards) {
        let axes = chain.chars().filter(|letter| "XYZABC".contains(*letter)).count();
        for (number, method) in METHODS.into_iter().enumerate() {
            let seed = (1_000_000 * seed + place * METHODS.len() + number) as u64;
            let tally = tallies.entry((axes, method)).or_default();
            match std::panic::catch_unwind(|| closed(chain, method, seed)) {
                Ok(Ok((parameters, off))) => {
                    tally.parameters.push(parameters);
                    tally.worst = tally.worst.max(off);
                }
                Ok(Err(reason)) => {
                    // A rotary axis about the tool, on its side, moves no tip.
                    let tool = chain.split(" b ").nth(1).unwrap_or_default();
                    let table = chain.split(" b ").next().unwrap_or_default();
                    let swings = tool.contains(['A', 'B']) || table.contains(['A', 'B', 'C']);
                    tally.refused += 1;
                    if swings || method != "table" || !reason.contains("cannot calibrate a machine with the axes") {
                        failures.push(format!("{chain} {method}: {reason}"));
                    }
                }
                Err(panicked) => {
                    tally.failed += 1;
                    let said = panicked.downcast_ref::<String>().cloned().unwrap_or_default();
                    failures.push(format!("{chain} {method}, seed {seed}: {said}"));
                }
            }
        }
    }
    println!(
        "shard {shard} of {shards}, seed {seed}\naxes method    back refused failed parameters  largest deviation"
    );
    for ((axes, method), tally) in &tallies {
        let (least, most) = (tally.parameters.iter().min().unwrap_or(&0), tally.parameters.iter().max().unwrap_or(&0));
        println!(
            "{axes:<4} {method:<9} {:>4} {:>7} {:>6} {least:>4} to {most:<3} {:>14.1e}",
            tally.parameters.len(),
            tally.refused,
            tally.failed,
            tally.worst
        );
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert!(tallies.values().any(|tally| !tally.parameters.is_empty()), "nothing was tried");
}

#[test]
fn what_is_missing_is_asked_of_nobody_without_a_terminal() {
    let folder = temporary();
    let cases: [(&[&str], &str); 6] = [
        (&["new", "a"], "`--chain` is missing"),
        (&["new", "a", "--chain", "w b X Y Z t"], "`--method` is missing"),
        (&["new", "a", "--chain", "w b X Y Q t", "--method", "ball"], "Q"),
        (&["new", "a", "--chain", "w b X Y t", "--method", "ball"], "2 linear axes"),
        (&["new", "a", "--chain", "w b X Y Z t", "--method", "table"], "cannot calibrate a machine"),
        (&["new", "full", "--chain", "w b X Y Z t", "--method", "ball"], "not empty"),
    ];
    std::fs::create_dir(folder.path().join("full")).expect("a folder");
    write(&folder.path().join("full/mine.txt"), "mine");
    for (arguments, expected) in cases {
        let printed = abbe(folder.path(), arguments);
        assert!(printed.stderr.contains(expected), "{arguments:?}: {}", printed.stderr);
        assert_ne!(printed.status, 0, "{arguments:?}");
        assert!(!folder.path().join("a").exists(), "{arguments:?}");
    }
}

#[test]
fn axes_with_other_names_have_errors_of_theirs() {
    for chain in ["w b U V W t", "w b X1 X2 Y Z t", "w C1' A2' b X Y Z t"] {
        let (told, _) = closed(chain, "ball", 1).unwrap_or_else(|reason| panic!("{chain}: {reason}"));
        assert!(told >= 3, "{chain}: {told}");
    }
}

#[test]
fn the_control_gets_its_exporter_or_a_reason() {
    let folder = temporary();
    let chain = "w C' A' b X Y Z t";
    for (controller, expected) in [
        ("linuxcnc", "control: { export: linuxcnc-kinematics, of: fit }"),
        ("siemens", "# `export: siemens-tables` was left out"),
        ("grbl", "export: grbl"),
    ] {
        let arguments = ["new", controller, "--chain", chain, "--method", "ball", "--controller", controller];
        let printed = abbe(folder.path(), &arguments);
        assert_eq!(printed.status, 0, "{}", printed.stderr);
        let recipe = read(&folder.path().join(controller).join("recipe.yaml"));
        assert!(recipe.contains(expected), "{controller}: {recipe}");
        assert_eq!(abbe(folder.path(), &["check", &format!("{controller}/recipe.yaml")]).status, 0, "{controller}");
    }
}

/// What is touched comes with a program for the control: the plan writes it as it stands, and the recipe says how its log is read.
#[test]
fn the_plan_of_a_beginning_writes_the_program_of_its_control() {
    let cases = [
        ("linuxcnc", "table", "w C' A' b X Y Z t", "measure.ngc", "linuxcnc-log"),
        ("fanuc", "ball", "w b X Y Z C A t", "O9910.nc", "dprnt"),
        ("siemens", "balls", "w C' X' b Y Z B t", "ABBE_MEASURE.MPF", "siemens-log"),
        ("heidenhain", "ball", "w C' B' b Y X Z t", "MEASURE.H", "heidenhain-log"),
        ("grbl", "balls", "w X' Y' b Z t", "measure.gcode", "grbl-log"),
    ];
    for (control, method, chain, program, reader) in cases {
        let folder = temporary();
        let at = folder.path();
        let begun = abbe(at, &["new", "m", "--chain", chain, "--method", method, "--controller", control]);
        assert_eq!(begun.status, 0, "{control}: {}", begun.stderr);
        assert!(begun.stdout.contains("Run its dry run"), "{}", begun.stdout);
        let planned = abbe(at, &["plan", "m/recipe.yaml", "--out", "m/plan"]);
        assert_eq!(planned.status, 0, "{control} {method} {chain}: {}", planned.stderr);
        let text = read(&at.join("m/plan").join(program));
        let made = read(&at.join("m/plan/plan.csv")).lines().count() - 1;
        let left_out = text.to_uppercase().matches("LEFT OUT: ").count();
        assert!(made > 3 * left_out, "{control} {method} {chain}: {made} touches, {left_out} left out");
        // The comment is a stage: with the plan's own positions in a log it is read.
        let recipe = read(&at.join("m/recipe.yaml"));
        let commented = format!("  # touches: {{ ingest: {reader}, path: measure.log, plan: plan/plan.csv");
        let line = recipe.lines().find(|line| line.starts_with(&commented)).unwrap_or_else(|| panic!("{recipe}"));
        let csv = recipe.lines().find(|line| line.starts_with("  touches: { ingest: csv")).expect("a stage").to_owned();
        let logged = recipe.replace(line, &line.replacen("# ", "", 1)).replace(&csv, "");
        write(&at.join("m/logged.yaml"), &logged);
        write(&at.join("m/measure.log"), "no log\n");
        let told = abbe(at, &["check", "m/logged.yaml"]).stderr;
        assert!(told.contains("measure.log") && told.contains("`ABBE 1` was expected"), "{control}: {told}");
    }
    // Without letters of a control there is none, and without a control neither.
    let folder = temporary();
    for (name, more) in [("a", vec!["--controller", "linuxcnc"]), ("b", vec![])] {
        let chain = if name == "a" { "w C1' A2' b X Y Z t" } else { "w C' A' b X Y Z t" };
        let begun = abbe(folder.path(), &[vec!["new", name, "--chain", chain, "--method", "ball"], more].concat());
        assert_eq!(begun.status, 0, "{}", begun.stderr);
        let recipe = read(&folder.path().join(name).join("recipe.yaml"));
        assert!(!recipe.contains("program:") && !recipe.contains("-log"), "{recipe}");
    }
}

#[test]
fn machines_without_three_linear_axes_are_calibrated_by_poses_alone() {
    let folder = temporary();
    for method in ["ball-bar", "lengths", "balls"] {
        let printed = abbe(folder.path(), &["new", "a", "--chain", "w C' A' b t", "--method", method]);
        assert_eq!(printed.status, 2, "{method}");
        assert!(
            printed.stderr.contains("0 linear axes") && printed.stderr.contains("--method poses"),
            "{}",
            printed.stderr
        );
        assert!(!folder.path().join("a").exists());
    }
    for chain in ["w C' A' b t", "w b C B1 B2 B3 A C2 t", "w b X C t"] {
        closed(chain, "poses", 3).unwrap_or_else(|reason| panic!("{chain}: {reason}"));
    }
}

/// Poses of the positioner's recipe with noise: the truth is inside the stated uncertainty, and noise of angles is as told.
#[test]
fn poses_are_simulated_with_noise_of_both_kinds() {
    let folder = temporary();
    let at = folder.path();
    let begun = abbe(at, &["new", "begun", "--chain", "w C' A' b X Y Z t", "--method", "poses"]);
    assert_eq!(begun.status, 0, "{}", begun.stderr);
    write(
        &at.join("truth.json"),
        &json!({ "parameters": { "EA0C": 1e-4, "EB0Y": -5e-5, "EY0C": 0.03 },
                 "noise": { "probing_sigma_mm": 0.02, "orientation_sigma_rad": 5e-5 } })
        .to_string(),
    );
    let (mut chi, mut count) = (0.0, 0.0);
    for seed in 0..12 {
        let prepared = abbe_engine::prepare(&at.join("begun/recipe.yaml"), &registry()).expect("a recipe");
        let simulated = prepared.simulate(&at.join("truth.json"), seed, None).expect("poses are simulated");
        simulated.write(&at.join(format!("m{seed}"))).expect("a folder");
        let prepared = abbe_engine::prepare(&at.join(format!("m{seed}/recipe.yaml")), &registry()).expect("a recipe");
        let outcome = prepared.run(&abbe_core::Monitor::default()).expect("a run");
        let calibration = &fit(&outcome, "fit").calibration;
        for (name, truth) in [("EA0C", 1e-4), ("EB0Y", -5e-5), ("EY0C", 0.03), ("EXX[1]", 0.0)] {
            let found = calibration.get(name).expect("a parameter");
            chi += ((found.value - truth) / found.standard_uncertainty).powi(2);
            count += 1.0;
        }
    }
    assert!((0.5..1.8).contains(&(chi / count)), "{}", chi / count);
}

#[test]
fn a_beginning_ends_in_its_time() {
    let folder = temporary();
    let arguments = ["new", "begun", "--chain", "w C' A' b X Y Z t", "--method", "table", "--time-limit", "0.001"];
    let printed = abbe(folder.path(), &arguments);
    assert!(printed.status == 1 && printed.stderr.contains("time limit"), "{} {}", printed.status, printed.stderr);
    assert!(!folder.path().join("begun").exists());
}

/// Chains that nobody builds are refused before anything is tried, and long ones have fewer positions of each axis.
#[test]
fn long_chains_are_begun_or_refused() {
    let folder = temporary();
    let begin = |chain: &str, method: &str| {
        let printed = abbe(folder.path(), &["new", "begun", "--chain", chain, "--method", method]);
        let rows = std::fs::read_dir(folder.path().join("begun")).map_or(0, |files| files.count());
        let _ = std::fs::remove_dir_all(folder.path().join("begun"));
        (printed, rows)
    };
    let rotary = |count: usize| {
        let names: Vec<String> =
            (0..count).map(|number| format!("{}{}", ["A", "B", "C"][number % 3], number / 3 + 1)).collect();
        names.join(" ")
    };
    for (chain, method) in [
        (format!("w b {} t", rotary(14)), "poses"),
        (format!("w b {} X Y Z t", rotary(14)), "table"),
        (format!("w b {} X Y Z t", rotary(10)), "balls"),
        (format!("w b {} X Y Z t", rotary(200)), "ball-bar"),
    ] {
        let (printed, files) = begin(&chain, method);
        let says = printed.stderr.contains("12 axes at most") && printed.stderr.contains("leave out axes");
        assert!(printed.status == 2 && says && files == 0, "{chain}: {}{}", printed.stdout, printed.stderr);
    }
    for (chain, method) in [(format!("w b {} t", rotary(12)), "poses"), (format!("w b {} X Y Z t", rotary(4)), "table")]
    {
        let (printed, files) = begin(&chain, method);
        assert!(printed.status == 0 && files > 2, "{chain}: {}{}", printed.stdout, printed.stderr);
    }
}
