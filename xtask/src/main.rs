//! Chores of the project.
//!
//! - `cargo xtask ci [--all]`: everything the gate asks for, the same on every machine; with `--all` nothing may be skipped.
//! - `cargo xtask bench [--save]`: run the benchmarks, compare with (or write) `benches/baseline.json`.
//! - `cargo xtask counts [--save]`: count the instructions of the main kernels, compare with (or write) `benches/instructions.json`.
//! - `cargo xtask campaign coverage SETS`: whether intervals cover the truth, in SETS simulated measurements each (`tests/coverage.rs`).
//! - `cargo xtask campaign limits MACHINES`: how many of MACHINES that stand exactly at their limit are accepted
//!   (`tests/at_the_limit.rs`).
//! - `cargo xtask campaign controls COUNT SEED`: the laws of `tests/controls` on COUNT random machines each.
//! - `cargo xtask campaign faults all`: let every system call that writes fail, one by one (`tests/faults.rs`).
//! - `cargo xtask campaign machines|batches|compensation|tango|bad-inputs|signals|hostile|fleet|sizes|spindle|touches COUNT SEED`: run a campaign over many
//!   random cases (`tests/campaigns`).
//! - `cargo xtask fuzz --executions COUNT --seed SEED [TARGET]`: COUNT inputs for every reader of bytes, or for one, built with the
//!   checks of debug builds (`tests/campaigns/src/fuzz.rs`; `tests/fuzz` has the same targets for cargo-fuzz). With `--release` first it
//!   is optimised and has these checks, too.
//! - `cargo xtask mutate --runs COUNT --seed SEED`: recipes and their data with random mistakes: `campaign bad-inputs`, built with the
//!   checks of debug builds.
//! - `cargo xtask header`: write the C header of the plugin interface.
//! - `cargo xtask linuxcnc [--create-user]`: run the files for LinuxCNC on LinuxCNC itself, in simulation; it needs a user of its own.
//! - `cargo xtask python`: build the Python package and run its tests and doctests; they need numpy and pytest.
//! - `cargo xtask schema`: write what follows from the plugins: the schema of recipes, the pages in `docs/plugins`, and the schemas of what
//!   crosses the border of plugins, in `docs/schemas/plugin`.

mod borders;
mod counts;
mod gate;
mod header;
mod linuxcnc;
mod python;
mod untested;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use serde_json::{Value, json};

type Outcome<T = ()> = Result<T, String>;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let outcome = match arguments.as_slice() {
        ["ci"] => gate::run(false),
        ["ci", "--all"] => gate::run(true),
        ["bench"] => bench(false),
        ["bench", "--save"] => bench(true),
        ["counts"] => count(false),
        ["counts", "--save"] => count(true),
        ["campaign", "coverage", sets] => {
            let mut tests = cargo(&["test", "--release", "--locked", "--package", "abbe-tests", "--", "coverage::"]);
            tests.env("ABBE_COVERAGE_SETS", sets);
            run(tests)
        }
        ["campaign", "limits", machines] => {
            let mut tests =
                cargo(&["test", "--release", "--locked", "--package", "abbe-tests", "--", "--nocapture", "at_the_limit::"]);
            tests.env("ABBE_LIMIT_MACHINES", machines);
            run(tests)
        }
        ["mutate", "--runs", count, "--seed", seed] => {
            let campaign = ["run", "--locked", "--package", "abbe-campaigns", "--", "bad-inputs", count, seed];
            run(cargo(&campaign))
        }
        ["campaign", "faults", "all"] => {
            let mut tests = cargo(&["test", "--locked", "--package", "abbe-tests", "--", "--nocapture", "faults::"]);
            tests.env("ABBE_FAULTS", "all");
            run(tests)
        }
        ["campaign", "controls", count, seed] => {
            let mut tests = cargo(&["test", "--release", "--locked", "--package", "abbe-tests", "--", "controls::"]);
            tests.env("ABBE_SEEDS", format!("{count} {seed}"));
            run(tests)
        }
        ["fuzz", "--executions", count, "--seed", seed, targets @ ..] if targets.len() < 2 => {
            fuzz(&[], count, seed, targets)
        }
        // As fast as a release build, with the checks of debug builds.
        ["fuzz", "--release", "--executions", count, "--seed", seed, targets @ ..] if targets.len() < 2 => {
            let checks = ["overflow-checks", "debug-assertions"].map(|check| format!("profile.release.{check}=true"));
            fuzz(&["--release", "--config", &checks[0], "--config", &checks[1]], count, seed, targets)
        }
        ["campaign", name, count, seed] => {
            run(cargo(&["run", "--release", "--locked", "--package", "abbe-campaigns", "--", name, count, seed]))
        }
        ["header"] => header::write(),
        ["linuxcnc"] => linuxcnc::run(false),
        ["linuxcnc", "--create-user"] => linuxcnc::run(true),
        ["python"] => python::run(),
        ["schema"] => schema(),
        _ => Err("usage: cargo xtask ci [--all] | bench [--save] | counts [--save] | campaign NAME COUNT SEED | fuzz [--release] --executions COUNT --seed SEED [TARGET] | mutate --runs COUNT --seed SEED | header | linuxcnc [--create-user] \
                     | python | schema\ncampaigns: controls, machines, batches, compensation, tango, bad-inputs, signals, hostile, fleet, sizes, spindle, touches; \
                     coverage COUNT; limits COUNT; faults all"
            .to_owned()),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("xtask: {message}");
            ExitCode::FAILURE
        }
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn cargo(arguments: &[&str]) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.args(arguments).current_dir(root());
    command
}

/// The crates of the workspace, as cargo describes them.
fn packages() -> Outcome<Vec<Value>> {
    let output = cargo(&["metadata", "--format-version", "1", "--no-deps", "--locked"])
        .output()
        .map_err(|error| format!("cargo metadata cannot be run: {error}"))?;
    let metadata: Value = serde_json::from_slice(&output.stdout).map_err(|error| format!("cargo metadata: {error}"))?;
    metadata["packages"].as_array().cloned().ok_or_else(|| "cargo metadata names no packages".to_owned())
}

fn run(mut command: Command) -> Outcome {
    println!("$ {command:?}");
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("{command:?} ended with {status}")),
        Err(error) => Err(format!("{command:?} cannot be run: {error}")),
    }
}

/// Counts instructions of the program of the tests as it is now, built as the gate builds it.
fn count(save: bool) -> Outcome {
    let build = ["test", "--workspace", "--test", "whole", "--no-run", "--locked"];
    run(gate::linted(&[&build[..], &gate::FEATURES].concat()))?;
    match counts::run(save)? {
        counts::Compared::Kept(words) => println!("{words}"),
        counts::Compared::Skipped(reason) => println!("skipped: {reason}"),
    }
    Ok(())
}

/// Inputs that nobody meant, in a program that is built with these options.
fn fuzz(build: &[&str], count: &str, seed: &str, targets: &[&str]) -> Outcome {
    let mut campaign = cargo(&["run", "--locked", "--package", "abbe-campaigns", "--features", "parquet"]);
    campaign.args(build).args(["--", "fuzz", count, seed]).args(targets);
    run(campaign)
}

/// The benchmark that tells how fast the machine is.
const UNIT: &str = "qr_384_115";

/// Runs the benchmarks and compares them, as multiples of a QR decomposition measured in the same run, with the baseline.
fn bench(save: bool) -> Outcome {
    run(cargo(&["bench", "--package", "abbe-benches", "--locked"]))?;
    let mut seconds = BTreeMap::new();
    let folder = root().join("target/criterion");
    let entries = fs::read_dir(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    for entry in entries.flatten() {
        let Ok(text) = fs::read_to_string(entry.path().join("new/estimates.json")) else { continue };
        let estimates: Value = serde_json::from_str(&text).map_err(|error| error.to_string())?;
        if let Some(nanoseconds) = estimates["median"]["point_estimate"].as_f64() {
            seconds.insert(entry.file_name().to_string_lossy().into_owned(), nanoseconds * 1e-9);
        }
    }
    let unit = *seconds.get(UNIT).ok_or_else(|| format!("the benchmark {UNIT} was not run"))?;
    let file = root().join("benches/baseline.json");
    if save {
        let ratios: BTreeMap<&String, f64> =
            seconds.iter().map(|(name, time)| (name, (time / unit * 100.0).round() / 100.0)).collect();
        let text = serde_json::to_string_pretty(&json!({ "unit": UNIT, "ratios": ratios }))
            .map_err(|error| error.to_string())?;
        return fs::write(&file, text + "\n").map_err(|error| format!("{}: {error}", file.display()));
    }
    let text = fs::read_to_string(&file).map_err(|error| format!("{}: {error}", file.display()))?;
    let baseline: Value = serde_json::from_str(&text).map_err(|error| error.to_string())?;
    println!("{:<28} {:>10} {:>12} {:>12}", "benchmark", "ms", "ratio", "baseline");
    for (name, time) in &seconds {
        let ratio = baseline["ratios"][name].as_f64().map_or("none".to_owned(), |ratio| format!("{ratio:.2}"));
        println!("{name:<28} {:>10.3} {:>12.2} {ratio:>12}", time * 1e3, time / unit);
    }
    Ok(())
}

/// Writes what follows from the plugins: the schema of recipes, and their reference pages.
fn schema() -> Outcome {
    let output = cargo(&["run", "--quiet", "--release", "--bin", "abbe", "--", "schema"])
        .output()
        .map_err(|error| format!("abbe cannot be run: {error}"))?;
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned());
    }
    let file = root().join("docs/schemas/recipe.schema.json");
    fs::write(&file, output.stdout).map_err(|error| format!("{}: {error}", file.display()))?;
    run(cargo(&["run", "--quiet", "--release", "--bin", "abbe", "--", "plugins", "--pages", "docs/plugins"]))?;
    messages()
}

/// Writes the schemas of what crosses the border of plugins, a file for each message.
fn messages() -> Outcome {
    let output = cargo(&["run", "--quiet", "--release", "--bin", "abbe", "--", "plugin", "messages"])
        .output()
        .map_err(|error| format!("abbe cannot be run: {error}"))?;
    let schemas: BTreeMap<String, Value> =
        serde_json::from_slice(&output.stdout).map_err(|error| format!("`abbe plugin messages`: {error}"))?;
    for (name, schema) in schemas {
        let file = root().join(format!("docs/schemas/plugin/{name}.schema.json"));
        let text = serde_json::to_string_pretty(&schema).map_err(|error| error.to_string())?;
        fs::write(&file, text + "\n").map_err(|error| format!("{}: {error}", file.display()))?;
    }
    Ok(())
}
