//! The gate, in two parts: tests that need only Rust, and tests that need another program. It ends with the time of each
//! part, and with the skipped tests and the reasons.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::{Outcome, borders, cargo, counts, header, linuxcnc, packages, python, root, run as run_command, untested};

/// Tests that need another program stand in a module of this name.
const OUTSIDE: &str = "outside::";

/// What the tests are built with besides the default: histories on a server, which the second part tries on a real one, and tables
/// in Parquet and Arrow, which it exchanges with another implementation. One list, so that nothing is built twice.
pub const FEATURES: [&str; 2] = ["--features", "abbe-tests/postgres,abbe-tests/parquet"];

/// What a test prints before its name and the reason why it was skipped.
const SKIPPED: &str = "SKIPPED: ";

/// The numbers of tests of a part, by result.
#[derive(Debug, Default)]
struct Tests {
    passed: usize,
    failed: usize,
    skipped: Vec<String>,
}

/// Runs both parts. With `all`, skipped tests count as failed.
pub fn run(all: bool) -> Outcome {
    let (mut tests, mut times) = (Tests::default(), Vec::new());
    let mut failed = Vec::new();
    for (name, part) in [("Rust alone", rust_alone as fn(&mut Tests) -> Outcome), ("other programs", other_programs)] {
        let clock = Instant::now();
        failed.extend(part(&mut tests).err().map(|error| format!("{name}: {error}")));
        times.push((name, clock.elapsed()));
    }
    println!();
    times.iter().for_each(|(name, time)| println!("{name}: {}", minutes(*time)));
    println!("{} passed, {} failed, {} skipped", tests.passed, tests.failed, tests.skipped.len());
    tests.skipped.iter().for_each(|what| println!("  skipped: {what}"));
    if all && !tests.skipped.is_empty() {
        failed.push("nothing may be skipped with --all".to_owned());
    }
    if failed.is_empty() { Ok(()) } else { Err(failed.join("; ")) }
}

fn minutes(time: Duration) -> String {
    format!("{:.1} min", time.as_secs_f64() / 60.0)
}

/// Cargo with the lints of Clippy, where a warning is an error. Clippy's compiler is that of Rust: what it has read it compiles as well.
/// To run `cargo clippy` beside a build would compile every library twice.
pub fn linted(arguments: &[&str]) -> Command {
    let mut command = cargo(arguments);
    let clippy = Path::new(command.get_program()).with_file_name("clippy-driver");
    // `cargo clippy` hands over its arguments so.
    command.env("RUSTC_WORKSPACE_WRAPPER", clippy).env("CLIPPY_ARGS", "-D__CLIPPY_HACKERY__warnings__CLIPPY_HACKERY__");
    command
}

fn rust_alone(tests: &mut Tests) -> Outcome {
    run_command(cargo(&["fmt", "--all", "--check"]))?;
    let packages = packages()?;
    borders::check(&packages)?;
    untested::check(&packages)?;
    header::check()?;
    // Tests build all else.
    let benches = ["test", "--no-run", "--workspace", "--bench", "*", "--locked"];
    run_command(linted(&[&benches[..], &FEATURES].concat()))?;
    let all = ["test", "--workspace", "--locked", "--no-fail-fast"];
    // Many tests wait, for limits of time or for other processes: one thread more than processors.
    let threads = format!("--test-threads={}", std::thread::available_parallelism().map_or(1, usize::from) + 1);
    let of_tests = tests.run(&[&all[..], &FEATURES, &["--", "--skip", OUTSIDE, &threads]].concat());
    // What the recipes find is what was reviewed. The program of the tests stands beside this one: no second build.
    let this = std::env::current_exe().map_err(|error| error.to_string())?;
    let mut abbe = Command::new(this.with_file_name("abbe-under-test"));
    let of_recipes = run_command({
        abbe.args(["test", "pipelines"]).current_dir(root());
        abbe
    });
    of_tests.and(of_recipes)
}

/// Names the file that is there while `.ci/run` installs other programs.
const INSTALLING: &str = "ABBE_INSTALLING";

/// Longest time that is waited for them.
const INSTALLED: Duration = Duration::from_secs(900);

/// Waits until other programs are installed.
fn installed() {
    let Some(file) = std::env::var_os(INSTALLING) else { return };
    let began = Instant::now();
    while Path::new(&file).exists() && began.elapsed() < INSTALLED {
        std::thread::sleep(Duration::from_millis(200));
    }
    println!("waited {} for other programs to be installed", minutes(began.elapsed()));
}

fn other_programs(tests: &mut Tests) -> Outcome {
    installed();
    linuxcnc::create_user()?;
    let whole = ["test", "--workspace", "--test", "whole", "--locked", FEATURES[0], FEATURES[1], "--"];
    // LinuxCNC runs in real time: nothing else runs beside it.
    let of_control = tests.run(&[&whole[..], &linuxcnc::TESTS, &["--test-threads=1"]].concat());
    // Tests that wait for other programs leave processors idle: the oldest Rust compiles meanwhile.
    let oldest = OldestRust::start();
    let without_control = linuxcnc::TESTS.iter().flat_map(|name| ["--skip", *name]);
    let of_tests = tests.run(&whole.into_iter().chain([OUTSIDE]).chain(without_control).collect::<Vec<_>>());
    let of_python = tests.python();
    let of_counts = tests.counts();
    let of_oldest = oldest.and_then(|oldest| tests.oldest_rust(oldest));
    let others = [of_control, of_tests, of_python, of_counts, of_oldest, tests.licences()];
    let failed: Vec<String> = others.into_iter().filter_map(Result::err).collect();
    if failed.is_empty() { Ok(()) } else { Err(failed.join("; ")) }
}

impl Tests {
    /// Runs `cargo test`, and counts.
    fn run(&mut self, arguments: &[&str]) -> Outcome {
        let mut command = linted(arguments);
        command.env("INSTA_UPDATE", "no").stdout(Stdio::piped());
        println!("$ {command:?}");
        let mut child = command.spawn().map_err(|error| format!("cargo test cannot be run: {error}"))?;
        let before = self.passed;
        let lines = BufReader::new(child.stdout.take().ok_or("cargo test has no output")?).lines();
        for line in lines.map_while(Result::ok) {
            println!("{line}");
            self.count(&line);
        }
        let status = child.wait().map_err(|error| format!("cargo test: {error}"))?;
        match status.success() && self.passed > before {
            true => Ok(()),
            false => Err(format!("cargo test ended with {status}")),
        }
    }

    fn count(&mut self, line: &str) {
        let number = |what: &str| -> usize {
            let before = line.split(what).next().unwrap_or_default();
            before.rsplit(' ').next().and_then(|number| number.parse().ok()).unwrap_or(0)
        };
        if line.starts_with("test result:") {
            self.passed += number(" passed;");
            self.failed += number(" failed;");
        }
        // Others may print at the same time: the line may begin with what they do.
        self.skipped.extend(line.split_once(SKIPPED).map(|(_, what)| what.to_owned()));
    }

    /// The tests and doctests of the Python package.
    fn python(&mut self) -> Outcome {
        let found = python::tests(linted)?;
        self.passed += found.passed;
        self.failed += found.failed;
        self.skipped.extend(found.skipped);
        Ok(())
    }

    /// Whether the main kernels take no more instructions than they did.
    fn counts(&mut self) -> Outcome {
        match counts::run(false).map_err(|error| format!("instructions: {error}"))? {
            counts::Compared::Kept(words) => {
                println!("{words}");
                self.passed += 1;
            }
            counts::Compared::Skipped(reason) => self.skipped.push(format!("instructions: {reason}")),
        }
        Ok(())
    }

    /// Counts what the oldest Rust said.
    fn oldest_rust(&mut self, oldest: OldestRust) -> Outcome {
        if let Some(version) = oldest.missing {
            self.skipped.push(format!("oldest_rust: Rust {version} is not installed"));
        }
        oldest.said.join().map_err(|_| "the oldest Rust was not asked".to_owned())??;
        self.passed += 1;
        Ok(())
    }

    /// Whether licences and advisories are those that `deny.toml` allows.
    fn licences(&mut self) -> Outcome {
        if !is_there(&mut cargo(&["deny"])) {
            self.skipped.push("licences: cargo-deny is not installed".to_owned());
            return Ok(());
        }
        run_command(cargo(&["deny", "check"]))?;
        self.passed += 1;
        Ok(())
    }
}

/// Whether the oldest Rust that the manifest promises compiles the program, and finds the documentation without fault. Where it is not
/// there, this Rust reads the documentation.
struct OldestRust {
    /// The version, if it is not installed.
    missing: Option<String>,
    said: JoinHandle<Outcome>,
}

impl OldestRust {
    /// Starts to compile, beside whatever comes next.
    fn start() -> Result<Self, String> {
        let manifest = std::fs::read_to_string(root().join("Cargo.toml")).map_err(|error| error.to_string())?;
        let promised = manifest.lines().find_map(|line| line.strip_prefix("rust-version = "));
        let version = promised.ok_or("Cargo.toml promises no Rust version")?.trim_matches('"').to_owned();
        let with = move |version: &str, arguments: &[&str]| {
            let mut rust = Command::new("rustup");
            rust.args(["run", version, "cargo"]).args(arguments).current_dir(root());
            // What this program was started with is not for another toolchain.
            ["RUSTUP_TOOLCHAIN", "RUSTC", "CARGO"].iter().for_each(|name| {
                rust.env_remove(name);
            });
            rust
        };
        let is_missing = !is_there(&mut with(&version, &[]));
        let missing = is_missing.then(|| version.clone());
        let said = std::thread::spawn(move || {
            let quiet = ["--locked", "--quiet", "--target-dir", "target/oldest"];
            let documents = [&["doc", "--workspace", "--no-deps"][..], &quiet, &FEATURES].concat();
            let mut documents = if is_missing { cargo(&documents) } else { with(&version, &documents) };
            documents.env("RUSTDOCFLAGS", "-D warnings");
            run_command(documents)?;
            // The documentation needs no functions of what nothing else is built on.
            let program = [&["check", "--workspace"][..], &quiet, &FEATURES].concat();
            if is_missing { Ok(()) } else { run_command(with(&version, &program)) }
        });
        Ok(Self { missing, said })
    }
}

/// Whether a program answers when it is asked for its version.
fn is_there(command: &mut Command) -> bool {
    let answer = command.arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    answer.is_ok_and(|status| status.success())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_tests_are_counted() {
        let mut tests = Tests::default();
        for line in [
            "test result: ok. 12 passed; 1 failed; 0 ignored; 0 measured",
            "test some::test ... SKIPPED: another: no emulator",
            "test result: ok. 3 passed; 0 failed; 0 ignored",
        ] {
            tests.count(line);
        }
        assert_eq!((tests.passed, tests.failed), (15, 1));
        assert_eq!(tests.skipped, ["another: no emulator"]);
    }
}
