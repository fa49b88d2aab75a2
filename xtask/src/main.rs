//! Chores of the project.
//!
//! - `cargo xtask ci`: everything the gate asks for, the same on every machine.
//! - `cargo xtask bench [--save]`: run the benchmarks, compare with (or write) `benches/baseline.json`.
//! - `cargo xtask header`: write the C header of the plugin interface.
//! - `cargo xtask schema`: write the schemas in `docs/schemas` that follow from the code.

mod borders;
mod header;

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use serde_json::{Value, json};

type Outcome<T = ()> = Result<T, String>;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let outcome = match arguments.as_slice() {
        ["ci"] => ci(),
        ["bench"] => bench(false),
        ["bench", "--save"] => bench(true),
        ["header"] => header::write(),
        ["schema"] => schema(),
        _ => Err("usage: cargo xtask ci | bench [--save] | header | schema".to_owned()),
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

fn run(mut command: Command) -> Outcome {
    println!("$ {command:?}");
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("{command:?} ended with {status}")),
        Err(error) => Err(format!("{command:?} cannot be run: {error}")),
    }
}

fn ci() -> Outcome {
    run(cargo(&["fmt", "--all", "--check"]))?;
    borders::check()?;
    header::check()?;
    run(cargo(&["clippy", "--workspace", "--all-targets", "--locked", "--", "-D", "warnings"]))?;
    let mut docs = cargo(&["doc", "--workspace", "--no-deps", "--locked", "--quiet"]);
    docs.env("RUSTDOCFLAGS", "-D warnings");
    run(docs)?;
    tests()
}

/// What a test prints before its name and the reason why it was skipped.
const SKIPPED: &str = "SKIPPED: ";

/// Runs all tests, and closes with how many there were and which were skipped, and why.
fn tests() -> Outcome {
    let mut command = cargo(&["test", "--workspace", "--locked", "--no-fail-fast"]);
    command.env("INSTA_UPDATE", "no").stdout(Stdio::piped());
    println!("$ {command:?}");
    let mut child = command.spawn().map_err(|error| format!("cargo test cannot be run: {error}"))?;
    let (mut passed, mut failed, mut skipped) = (0, 0, Vec::new());
    for line in BufReader::new(child.stdout.take().ok_or("cargo test has no output")?).lines().map_while(Result::ok) {
        println!("{line}");
        let count = |what: &str| -> usize {
            let before = line.split(what).next().unwrap_or_default();
            before.rsplit(' ').next().and_then(|number| number.parse().ok()).unwrap_or(0)
        };
        if line.starts_with("test result:") {
            passed += count(" passed;");
            failed += count(" failed;");
        }
        // Others may print at the same time: the line may begin with what they do.
        skipped.extend(line.split_once(SKIPPED).map(|(_, what)| what.to_owned()));
    }
    let status = child.wait().map_err(|error| format!("cargo test: {error}"))?;
    println!("{passed} passed, {failed} failed, {} skipped", skipped.len());
    skipped.iter().for_each(|what| println!("  skipped: {what}"));
    if status.success() && passed > 0 { Ok(()) } else { Err(format!("cargo test ended with {status}")) }
}

/// The benchmark that tells how fast the machine is.
const UNIT: &str = "matrix_product_256";

/// Runs the benchmarks and compares them, as multiples of a matrix product measured in the same run, with the baseline.
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

/// Writes what follows from the code: the schema of recipes.
fn schema() -> Outcome {
    let output = cargo(&["run", "--quiet", "--release", "--bin", "abbe", "--", "schema"])
        .output()
        .map_err(|error| format!("abbe cannot be run: {error}"))?;
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned());
    }
    let file = root().join("docs/schemas/recipe.schema.json");
    fs::write(&file, output.stdout).map_err(|error| format!("{}: {error}", file.display()))
}
