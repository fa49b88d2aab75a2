//! Numbers of instructions of the main kernels, counted by callgrind on one core. Times differ from run to run, these hardly: they are
//! compared with `benches/instructions.json`, and the gate fails where one has grown.
//!
//! What is counted is the program of the tests, which the gate has built anyway. Counts depend on the compiler and on the vector units
//! of the processor: with others than those of the file nothing is compared, and the reason is told.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::{Value, json};

use crate::{Outcome, root};

/// Part by which a count may grow, as it is written into the file. Repeated counts differ by up to 1.9 % (`docs/performance.md`).
const TOLERANCE: f64 = 0.05;

/// Blocks of the program that is corrected.
const BLOCKS: u32 = 300;

/// A kernel: its name in the file, the run in which it is counted, and its function, all that it calls included.
struct Kernel {
    name: &'static str,
    run: &'static str,
    function: &'static str,
}

/// What is counted.
const KERNELS: [Kernel; 4] = [
    Kernel { name: "tango_s4_fit", run: "fit", function: "abbe_gauss_newton::GaussNewton::estimate_all" },
    Kernel { name: "tango_s3_trials", run: "trials", function: "abbe_monte_carlo::Propagation::solve" },
    Kernel {
        name: "tango_s3_in_batches",
        run: "trials",
        function: "abbe_gauss_newton::parts::<impl abbe_gauss_newton::GaussNewton>::of_parts",
    },
    Kernel { name: "program_blocks", run: "blocks", function: "abbe_controllers::program::compensate" },
];

type Counts = BTreeMap<String, u64>;

/// What a comparison found.
pub enum Compared {
    /// All counts are those of the file, or there are fewer; with words for people.
    Kept(String),
    /// Why nothing could be compared.
    Skipped(String),
}

/// Counts, and compares with the file, or writes it.
pub fn run(save: bool) -> Outcome<Compared> {
    if let Some(missing) = missing() {
        return Ok(Compared::Skipped(missing));
    }
    let file = root().join("benches/instructions.json");
    let here = conditions()?;
    if save {
        let stated = json!({ "conditions": here, "tolerance": TOLERANCE, "instructions": counted()? });
        let text = serde_json::to_string_pretty(&stated).map_err(|error| error.to_string())?;
        fs::write(&file, text + "\n").map_err(|error| format!("{}: {error}", file.display()))?;
        return Ok(Compared::Kept(format!("{} is written", file.display())));
    }
    let text = fs::read_to_string(&file).map_err(|error| format!("{}: {error}", file.display()))?;
    let stated: Value = serde_json::from_str(&text).map_err(|error| format!("{}: {error}", file.display()))?;
    if let Some(other) = differs(&stated["conditions"], &here) {
        return Ok(Compared::Skipped(other));
    }
    compared(&stated, &counted()?).map(Compared::Kept)
}

/// Why counts cannot be taken here.
fn missing() -> Option<String> {
    for program in ["valgrind", "taskset"] {
        if !Command::new(program).arg("--version").output().is_ok_and(|output| output.status.success()) {
            return Some(format!("{program} is not installed"));
        }
    }
    None
}

/// What counts depend on besides the sources.
fn conditions() -> Outcome<Value> {
    let rustc = said(Command::new(std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into())).arg("--version"))?;
    let valgrind = said(Command::new("valgrind").arg("--version"))?;
    Ok(json!({ "profile": "dev", "rustc": rustc, "valgrind": valgrind, "vectors": vectors() }))
}

/// The widest vectors that the counted program may use. Valgrind knows those of AVX2 and none that are wider.
fn vectors() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
            return "x86_64, avx2 and fma";
        }
    }
    std::env::consts::ARCH
}

fn said(command: &mut Command) -> Outcome<String> {
    let output = succeeded(command)?;
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn succeeded(command: &mut Command) -> Outcome<Output> {
    let output = command.output().map_err(|error| format!("{command:?} cannot be run: {error}"))?;
    if output.status.success() {
        return Ok(output);
    }
    let [told, errors] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned());
    Err(format!("{command:?} ended with {}: {told}{errors}", output.status))
}

/// In what these counts were taken otherwise than the stated ones.
fn differs(stated: &Value, here: &Value) -> Option<String> {
    let others = here.as_object()?.iter().filter(|(name, value)| stated[name.as_str()] != **value);
    let words: Vec<String> =
        others.map(|(name, value)| format!("{name} {value} instead of {}", stated[name])).collect();
    (!words.is_empty()).then(|| format!("the counts are of other conditions: {}", words.join(", ")))
}

/// A table of both, or an error that names what has grown by more than the tolerance, or is not there.
fn compared(stated: &Value, counts: &Counts) -> Outcome<String> {
    let tolerance =
        stated["tolerance"].as_f64().ok_or("benches/instructions.json: `tolerance` is missing: a number")?;
    let stated = stated["instructions"].as_object().ok_or("benches/instructions.json: `instructions` is missing")?;
    let (mut table, mut wrong, mut fewer) = (String::new(), Vec::new(), false);
    for (name, count) in counts {
        let Some(before) = stated.get(name).and_then(Value::as_u64).filter(|before| *before > 0) else {
            wrong.push(format!("{name} is not in benches/instructions.json"));
            continue;
        };
        let part = *count as f64 / before as f64 - 1.0;
        table.push_str(&format!("{name:<24} {count:>14} {before:>14} {:>+8.2} %\n", 100.0 * part));
        fewer |= part < -tolerance;
        if part > tolerance {
            wrong.push(format!("{name} takes {count} instructions, {before} before: {:+.1} %", 100.0 * part));
        }
    }
    let gone = stated.keys().filter(|name| !counts.contains_key(*name));
    wrong.extend(gone.map(|name| format!("{name} of benches/instructions.json is not counted")));
    if !wrong.is_empty() {
        let help = "make it as it was, or accept it with `cargo xtask counts --save` and say why";
        return Err(format!("{}\n{table}{help}", wrong.join("; ")));
    }
    if fewer {
        table.push_str("Fewer than before: `cargo xtask counts --save` renews benches/instructions.json\n");
    }
    Ok(table)
}

/// The instructions of all kernels. The runs are beside each other as far as there are cores, each on one of its own.
fn counted() -> Outcome<Counts> {
    let folder = root().join("target/counts");
    prepare(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let cores = cores();
    let runs = [("fit", "test --accept fit.yaml"), ("trials", "test --accept trials.yaml"), ("blocks", COMPENSATE)];
    let mut texts = BTreeMap::new();
    for some in runs.chunks(cores.len()) {
        let results: Vec<Outcome<(&str, String)>> = std::thread::scope(|scope| {
            let started: Vec<_> = (some.iter().zip(&cores))
                .map(|((name, arguments), core)| scope.spawn(|| Ok((*name, one(&folder, name, arguments, *core)?))))
                .collect();
            let lost = || Err("a run was lost".to_owned());
            started.into_iter().map(|run| run.join().unwrap_or_else(|_| lost())).collect()
        });
        for result in results {
            let (name, text) = result?;
            texts.insert(name, text);
        }
    }
    KERNELS.iter().map(|kernel| Ok((kernel.name.to_owned(), inclusive(&texts[kernel.run], kernel.function)?))).collect()
}

/// How the program is corrected.
const COMPENSATE: &str = "compensate ../../benches/calibrations/table-table.calibration.json program.ngc \
                          --dialect linuxcnc --correct five-axes --out corrected.ngc";

/// Writes what the runs read into an empty folder, as deep as that of the recipes: their paths stay right.
fn prepare(folder: &Path) -> std::io::Result<()> {
    if folder.exists() {
        fs::remove_dir_all(folder)?;
    }
    fs::create_dir_all(folder)?;
    for recipe in ["fit.yaml", "trials.yaml"] {
        fs::copy(root().join("benches/counts").join(recipe), folder.join(recipe))?;
    }
    fs::write(folder.join("program.ngc"), program())
}

/// A program with five axes whose blocks stay whole.
fn program() -> String {
    let mut text = "G21 G90 G17 G94 G54\nG0 X-90 Y-90 Z10 A-20 C-30\nG1 F1000\n".to_owned();
    for block in 0..BLOCKS {
        let part = f64::from(block) / f64::from(BLOCKS);
        let [x, y, z] = [180.0 * part - 90.0, 150.0 * part - 90.0, 30.0 * part + 10.0];
        let [a, c] = [10.0 * part - 20.0, 20.0 * part - 30.0];
        text.push_str(&format!("X{x:.4} Y{y:.4} Z{z:.4} A{a:.4} C{c:.4}\n"));
    }
    text + "M2\n"
}

/// Cores that this process may use, as Linux lists them: `0-3,8`.
fn cores() -> Vec<usize> {
    let text = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let list = text.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:")).unwrap_or("0").trim();
    let ends = |part: &str| -> Option<(usize, usize)> {
        let (from, to) = part.split_once('-').unwrap_or((part, part));
        Some((from.parse().ok()?, to.parse().ok()?))
    };
    let cores: Vec<usize> = list.split(',').filter_map(ends).flat_map(|(from, to)| from..=to).collect();
    if cores.is_empty() { vec![0] } else { cores }
}

/// What callgrind writes about one run of the program of the tests, which stands beside this one. On one core, since a process that
/// finds more makes threads, and who waits for whom costs instructions, too.
fn one(folder: &Path, name: &str, arguments: &str, core: usize) -> Outcome<String> {
    let this = std::env::current_exe().map_err(|error| error.to_string())?;
    let program: PathBuf = this.with_file_name(format!("abbe-under-test{}", std::env::consts::EXE_SUFFIX));
    let written = folder.join(format!("{name}.callgrind"));
    let mut command = Command::new("taskset");
    command.args(["-c", &core.to_string(), "valgrind", "--tool=callgrind"]).current_dir(folder);
    command.arg(format!("--callgrind-out-file={}", written.display())).arg(program).args(arguments.split(' '));
    succeeded(&mut command)?;
    fs::read_to_string(&written).map_err(|error| format!("{}: {error}", written.display()))
}

/// The instructions of a function and all that it calls. Lines of the format: `cfn=(7) name` says who is called (the name only the first
/// time that this number stands there, also after `fn=`), then comes `calls=`, then a line with place and instructions.
fn inclusive(text: &str, function: &str) -> Outcome<u64> {
    let (mut numbers, mut called, mut costs_follow) = (Vec::new(), "", false);
    let mut sum = 0;
    for line in text.lines() {
        if costs_follow {
            costs_follow = false;
            let cost = line.split(' ').nth(1).and_then(|cost| cost.parse::<u64>().ok());
            if numbers.contains(&called) {
                sum += cost.ok_or_else(|| format!("callgrind wrote `{line}` instead of a place and a number"))?;
            }
            continue;
        }
        let (is_call, named) = match (line.strip_prefix("cfn="), line.strip_prefix("fn=")) {
            (Some(named), _) => (true, named),
            (None, Some(named)) => (false, named),
            (None, None) => {
                costs_follow = line.starts_with("calls=");
                continue;
            }
        };
        let (number, name) = named.split_once(' ').unwrap_or((named, ""));
        if name == function {
            numbers.push(number);
        }
        if is_call {
            called = number;
        }
    }
    match sum {
        0 => Err(format!("`{function}` is not called any more: name what is counted in xtask/src/counts.rs anew")),
        sum => Ok(sum),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stated(fit: u64, tolerance: f64) -> Value {
        json!({ "tolerance": tolerance, "instructions": { "fit": fit } })
    }

    fn counts(fit: u64) -> Counts {
        Counts::from([("fit".to_owned(), fit)])
    }

    #[test]
    fn a_count_above_the_tolerance_fails_and_is_named() {
        let stated = stated(1000, 0.03);
        let error = compared(&stated, &counts(1031)).expect_err("it has grown");
        assert!(error.contains("fit takes 1031 instructions, 1000 before: +3.1 %"), "{error}");
        let kept = compared(&stated, &counts(1029)).expect("within the tolerance");
        assert!(!kept.contains("--save"), "{kept}");
    }

    #[test]
    fn fewer_instructions_may_be_saved() {
        let kept = compared(&stated(1000, 0.03), &counts(960)).expect("fewer");
        assert!(kept.contains("cargo xtask counts --save"), "{kept}");
    }

    #[test]
    fn what_one_side_does_not_know_fails() {
        let other = Counts::from([("trial".to_owned(), 1)]);
        let error = compared(&stated(1000, 0.03), &other).expect_err("other kernels");
        assert!(error.contains("trial is not in") && error.contains("fit of"), "{error}");
        assert!(compared(&json!({ "instructions": {} }), &counts(1)).is_err());
    }

    #[test]
    fn counts_of_other_conditions_are_not_compared() {
        let here = json!({ "rustc": "rustc 2", "vectors": "x86_64" });
        assert_eq!(differs(&here, &here), None);
        let reason = differs(&json!({ "rustc": "rustc 1", "vectors": "x86_64" }), &here).expect("another compiler");
        assert!(reason.contains("rustc \"rustc 2\" instead of \"rustc 1\"") && !reason.contains("vectors"), "{reason}");
    }

    #[test]
    fn what_a_function_calls_is_counted_with_it() {
        let text = "fn=(1) main\n5 10\ncfn=(2) kernel\ncalls=1 7\n5 400\n6 3\ncfn=(3) other\ncalls=2 9\n6 50\n\
                    fn=(2)\n7 100\ncfn=(3)\ncalls=1 9\n8 300\nfn=(3)\n9 350\nfn=(4) again\ncfn=(2)\ncalls=3 7\n+2 30\n";
        assert_eq!(inclusive(text, "kernel"), Ok(430));
        assert_eq!(inclusive(text, "other"), Ok(350));
        assert!(inclusive(text, "none").is_err());
    }
}
