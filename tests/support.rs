//! What the tests share: the program, the recipes of the repository and variants of them, a small recipe of its own.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use abbe_core::{Calibration, Estimated, Fit, Registry};
use abbe_engine::{Outcome, prepare};
use serde_json::{Value, json};
use tempfile::TempDir;

use abbe_bundle as _;

/// The root of the workspace.
pub fn root() -> PathBuf {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR"));
    tests.parent().expect("the tests are a folder of the workspace").to_owned()
}

/// What a command printed, and its exit status.
#[derive(Debug)]
pub struct Printed {
    pub status: i32,
    pub stdout: String,
    pub stderr: String,
}

/// The program in the folder `at`, ready to be started.
pub fn program<S: AsRef<OsStr>>(at: &Path, arguments: &[S]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_abbe-under-test"));
    command.args(arguments).current_dir(at).env("NO_COLOR", "1").env_remove("COLUMNS");
    command
}

/// Runs the program in the folder `at`. A run prints all of its results (`--verbose`); what the log says of its work is left out.
pub fn abbe<S: AsRef<OsStr>>(at: &Path, arguments: &[S]) -> Printed {
    let mut all: Vec<&OsStr> = arguments.iter().map(AsRef::as_ref).collect();
    let is_run = all.first().is_some_and(|command| *command == "run");
    if !is_run {
        // Whole sentences are looked for.
        return printed(program(at, &all).env("COLUMNS", "10000"));
    }
    all.push("--verbose".as_ref());
    let printed = as_typed(at, &all);
    let of_interest = |line: &&str| !line.trim_start().starts_with("INFO ");
    let stderr = printed.stderr.split_inclusive('\n').filter(of_interest).collect();
    Printed { stderr, ..printed }
}

/// Runs the program in the folder `at` as a user does.
pub fn as_typed<S: AsRef<OsStr>>(at: &Path, arguments: &[S]) -> Printed {
    printed(&mut program(at, arguments))
}

/// The same on a terminal of 80 columns.
pub fn narrow<S: AsRef<OsStr>>(at: &Path, arguments: &[S]) -> Printed {
    printed(program(at, arguments).env("COLUMNS", "80"))
}

/// Runs a program to its end.
pub fn printed(program: &mut Command) -> Printed {
    let output = program.output().expect("the program starts");
    let text = |bytes| String::from_utf8(bytes).expect("the program prints UTF-8");
    Printed {
        status: output.status.code().expect("the program ends by itself"),
        stdout: text(output.stdout),
        stderr: text(output.stderr),
    }
}

/// Says that a test was skipped, and why; `cargo xtask ci` tells it again at its end.
pub fn skipped(test: &str, reason: &str) {
    // Written to the stream directly: the test harness captures only what macros print.
    let line = format!("\nSKIPPED: {test}: {reason}\n");
    std::io::stdout().write_all(line.as_bytes()).expect("standard output is open");
}

/// The recipes of the repository, by name.
pub fn recipes() -> BTreeMap<String, PathBuf> {
    let files = files_in(&root().join("pipelines"));
    let recipes: BTreeMap<String, PathBuf> = (files.into_iter())
        .filter(|file| file.extension() == Some("yaml".as_ref()))
        .map(|file| (stem(&file), file))
        .collect();
    assert!(!recipes.is_empty(), "there are no recipes");
    recipes
}

/// Those of them that are no twin of another one: on data without noise, with the same stages.
pub fn recipes_without_twins() -> BTreeMap<String, PathBuf> {
    let all = recipes();
    let is_twin = |name: &str| name.strip_suffix("-exact").is_some_and(|other| all.contains_key(other));
    all.iter().filter(|(name, _)| !is_twin(name)).map(|(name, file)| (name.clone(), file.clone())).collect()
}

/// Few of them, those with little data first, in which every plugin occurs that occurs in any.
pub fn recipes_with_every_plugin() -> BTreeMap<String, PathBuf> {
    const KINDS: [&str; 6] = ["ingest", "artefact", "model", "estimate", "validate", "export"];
    let mut all = Vec::new();
    for (name, file) in recipes_without_twins() {
        let recipe = Variant::of(&file).0;
        let mut plugins = BTreeSet::new();
        for stage in recipe["stages"].as_object().expect("stages").values() {
            let plugin = |kind: &'static str| Some((kind, stage.get(kind)?.as_str()?.to_owned()));
            plugins.extend(KINDS.into_iter().filter_map(plugin));
        }
        all.push((bytes_of_data(&recipe), plugins, name, file));
    }
    all.sort();
    let mut seen = BTreeSet::new();
    // All of its plugins are seen then: `any` would stop at the first new one.
    all.retain(|(_, plugins, ..)| plugins.iter().filter(|plugin| seen.insert((*plugin).clone())).count() > 0);
    all.into_iter().map(|(.., name, file)| (name, file)).collect()
}

/// Size of the files that a recipe names; of a pattern, that of the files in its folder.
fn bytes_of_data(value: &Value) -> u64 {
    let size = |file: &Path| fs::metadata(file).ok().filter(|found| found.is_file()).map_or(0, |found| found.len());
    match value {
        Value::String(text) if text.contains('*') => {
            let folder = Path::new(text).parent().filter(|folder| folder.is_dir());
            folder.map_or(0, |folder| files_in(folder).iter().map(|file| size(file)).sum())
        }
        Value::String(text) => size(Path::new(text)),
        Value::Array(values) => values.iter().map(bytes_of_data).sum(),
        Value::Object(values) => values.values().map(bytes_of_data).sum(),
        _ => 0,
    }
}

/// The files (not folders) in a folder, sorted.
pub fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry of the folder").path()).collect();
    files.retain(|path| path.is_file());
    files.sort();
    files
}

/// The files under a folder, relative to it, sorted.
pub fn tree(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).unwrap_or_else(|error| panic!("{}: {error}", next.display())) {
            let path = entry.expect("an entry of the folder").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.push(path.strip_prefix(folder).expect("a path in the folder").to_owned());
            }
        }
    }
    found.sort();
    found
}

/// The name of a file without its last extension.
pub fn stem(file: &Path) -> String {
    file.file_stem().expect("a file has a name").to_string_lossy().into_owned()
}

pub fn read(file: &Path) -> String {
    fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

pub fn write(file: &Path, text: &str) {
    if let Some(folder) = file.parent() {
        fs::create_dir_all(folder).expect("the folder of the file");
    }
    fs::write(file, text).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
}

pub fn registry() -> Registry {
    Registry::built_in().expect("the built-in plugins have different names")
}

/// A recipe of the repository that a test changes before it runs it.
#[derive(Clone)]
pub struct Variant(pub Value);

impl Variant {
    /// The recipe `tango-hu40t-exact` or `tango-hu40t`, by the name of its folder of data.
    pub fn tango(data: &str) -> Self {
        let name = if data == "exact" { "tango-hu40t-exact" } else { "tango-hu40t" };
        Self::of(&recipes()[name])
    }

    /// Any recipe of the repository; its paths become absolute, so that it can be written anywhere.
    pub fn of(file: &Path) -> Self {
        let mut recipe: Value = serde_yaml::from_str(&read(file)).expect("the recipe is YAML");
        absolute(&mut recipe, file.parent().expect("a recipe stands in a folder"));
        Self(recipe)
    }

    /// Leaves out all estimates, validators and exporters but these.
    pub fn only(mut self, kept: &[&str]) -> Self {
        let stages = self.0["stages"].as_object_mut().expect("stages");
        for name in kept {
            assert!(stages.contains_key(*name), "no stage {name}");
        }
        stages.retain(|name, stage| {
            let input = ["ingest", "artefact", "model"].iter().any(|kind| stage.get(kind).is_some());
            input || kept.contains(&name.as_str())
        });
        // Validators of estimates that are gone judge those that are left.
        let left: Vec<String> = stages.keys().cloned().collect();
        for stage in stages.values_mut() {
            if let Some(Value::Array(of)) = stage.get_mut("of") {
                of.retain(|name| left.iter().any(|left| name == left));
            }
        }
        self
    }

    /// Changes a setting of a stage.
    pub fn set(mut self, stage: &str, setting: &str, value: Value) -> Self {
        self.stage(stage)[setting] = value;
        self
    }

    /// A stage that exists.
    pub fn stage(&mut self, name: &str) -> &mut Value {
        self.0["stages"].get_mut(name).unwrap_or_else(|| panic!("no stage {name}"))
    }

    /// The path that a stage reads under `setting`.
    pub fn path(&self, stage: &str, setting: &str) -> PathBuf {
        PathBuf::from(self.0["stages"][stage][setting].as_str().expect("a path"))
    }

    /// Writes it where it can be run. (JSON is YAML.)
    pub fn write(&self, folder: &Path) -> PathBuf {
        let file = folder.join("recipe.yaml");
        write(&file, &serde_json::to_string_pretty(&self.0).expect("a recipe is JSON"));
        file
    }

    /// Runs it in this process.
    pub fn run(&self) -> Outcome {
        let folder = temporary();
        let outcome = prepare(&self.write(folder.path()), &registry())
            .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()));
        outcome.unwrap_or_else(|error| panic!("{error}"))
    }
}

/// Makes the paths of a recipe absolute: whatever in it names a file that exists, or files of a folder that does.
fn absolute(value: &mut Value, base: &Path) {
    let is_path = |text: &str| {
        let path = base.join(text);
        path.is_file() || (text.contains('*') && path.parent().is_some_and(Path::is_dir))
    };
    match value {
        Value::String(text) if text.contains('/') && is_path(text) => {
            *text = base.join(&text).to_str().expect("paths are UTF-8").to_owned();
        }
        Value::Array(items) => items.iter_mut().for_each(|item| absolute(item, base)),
        Value::Object(map) => map.values_mut().for_each(|item| absolute(item, base)),
        _ => {}
    }
}

pub fn temporary() -> TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// The fit of that name.
pub fn fit<'a>(outcome: &'a Outcome, name: &str) -> &'a Fit {
    outcome.fits.iter().find(|fit| fit.name == name).unwrap_or_else(|| panic!("no fit {name}"))
}

/// Everything that a calibration says about values: of the machine, then of the artefacts.
pub fn values(calibration: &Calibration) -> impl Iterator<Item = &Estimated> {
    calibration.parameters.iter().chain(&calibration.artefacts)
}

/// Whether a unit is that of an angle (in its numerator), and by what the value is multiplied to become its effect in
/// mm or rad: at the end of a travel of 400 mm or 180 degrees.
pub fn effect(unit: &str) -> (bool, f64) {
    let (over, under) = unit.split_once('/').unwrap_or((unit, ""));
    let (base, degree) = under.split_once('^').unwrap_or((under, "1"));
    let travel: f64 = match base {
        "" => 1.0,
        "mm" => 400.0,
        "rad" => std::f64::consts::PI,
        "s" => 1000.0,
        "K" => 10.0,
        other => panic!("what is the travel in {other}?"),
    };
    assert!(over == "mm" || over == "rad", "what is the effect of a value in {unit}?");
    (over == "rad", travel.powi(degree.parse().expect("a degree")))
}

/// A small recipe with its data: the first touches of eight facets of the TANGO test, a bar, six stages.
pub struct Small {
    pub folder: TempDir,
}

/// The recipe of [`Small`].
pub const SMALL: &str = r#"abbe: 1
name: Eight facets
sets:
  tool: [dxt, dyt, dzt]
stages:
  touches: { ingest: csv, path: data/touches.csv }
  runs:    { ingest: csv, path: data/lengths.csv }
  table:   { artefact: facets, from: touches, nominal: data/facets.csv, standard_uncertainty_um: 1.6 }
  bar:     { artefact: length, from: runs, standard_uncertainty_um: 0.9 }
  machine:
    model: serial-chain
    file: data/machine.yaml
    errors:
      - { location: [EA0B, EX0C] }
      - { polynomial: [EXX, EYY, EZZ], degrees: [1] }
      - { backlash: [EXX] }
  rough:
    estimate: gauss-newton
    machine: machine
    observations: [table, bar]
    parameters: ["@tool", "table.*"]
  fine:
    estimate: gauss-newton
    machine: machine
    observations: [table, bar]
    parameters: ["@tool", EX0C, "EXX[1]", "table.*"]
    start: rough
  judge:   { validate: residuals, of: [rough, fine], limits: { max_um: 1000 } }
  unseen:  { validate: hold-out, of: fine, rows: table, column: group, folds: [[2], [3]] }
  written: { export: error-table, of: fine, step_mm: 100, step_deg: 30 }
"#;

/// Facets that the small recipe knows.
const FACETS: std::ops::RangeInclusive<u32> = 3..=10;
/// Touches that it has.
const TOUCHES: usize = 60;

impl Small {
    pub fn new() -> Self {
        let small = Self { folder: temporary() };
        let tango = root().join("pipelines/data/tango-hu40t/exact");
        let known = |line: &str, column: usize| {
            line.split(',').nth(column).and_then(|cell| cell.parse().ok()).is_some_and(|cell| FACETS.contains(&cell))
        };
        let cut = |name: &str, column: usize, most: usize| {
            let text = read(&tango.join(name));
            let rows = text.lines().skip(1).filter(|line| known(line, column)).take(most);
            let kept: Vec<&str> = text.lines().take(1).chain(rows).collect();
            small.write(&format!("data/{name}"), &(kept.join("\n") + "\n"));
        };
        cut("touches.csv", 1, TOUCHES);
        cut("facets.csv", 0, usize::MAX);
        for name in ["lengths.csv", "machine.yaml"] {
            small.write(&format!("data/{name}"), &read(&tango.join(name)));
        }
        small.write("recipe.yaml", SMALL);
        small
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, text: &str) {
        write(&self.path(name), text);
    }

    pub fn read(&self, name: &str) -> String {
        read(&self.path(name))
    }

    /// Runs the program in its folder, so that messages show the same paths everywhere.
    pub fn abbe(&self, arguments: &[&str]) -> Printed {
        abbe(self.folder.path(), arguments)
    }
}

/// A JSON file.
pub fn json_file(file: &Path) -> Value {
    serde_json::from_str(&read(file)).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

/// Shorthand of a list in a recipe.
pub fn list(names: &[&str]) -> Value {
    json!(names)
}

/// Random numbers that share no code with the program: xorshift64*.
pub struct Random(pub u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0xD1B5_4A32_D192_ED03)
    }

    /// From 0 to 1.
    pub fn unit(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.unit()
    }

    /// A whole number below `count`.
    pub fn below(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count - 1)
    }

    /// 1 or -1.
    pub fn sign(&mut self) -> f64 {
        if self.unit() < 0.5 { -1.0 } else { 1.0 }
    }

    /// Standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.unit()).ln()).sqrt() * (std::f64::consts::TAU * self.unit()).cos()
    }
}
