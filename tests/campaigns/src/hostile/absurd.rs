//! Calibrations that no machine has: signs, columns, units and lengths that are wrong in recipes that are right.
//!
//! Law: the run fails, or tells more than it does of the right recipe.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};

use serde_json::Value;

use super::Case;
use super::stock::Stock;
use crate::Random;
use crate::process::{Bounds, Ended, ended};
use crate::source::Source;

/// What a run says beside its figures, without numbers.
type Said = BTreeSet<String>;

/// What the right recipes say and find, by name.
static RIGHT: OnceLock<Mutex<BTreeMap<String, Right>>> = OnceLock::new();

/// How a recipe without a mistake ends.
#[derive(Clone)]
struct Right {
    status: Option<i32>,
    said: Said,
    values: Vec<f64>,
    /// Scatter of the residuals of each estimate, over what is stated.
    scatter: Vec<f64>,
}

/// What no measurement of a recipe can tell, by parts of its name, of its file and of the mistake (docs/reliability.md). The run has to
/// prove it: all residuals stay what they are.
const UNTELLABLE: [(&str, &str, &str); 9] = [
    // A cylinder may lie turned about its axis; on a single section, where two directions are lost, about the other one as well.
    ("cylinder-kx8", "touches-", "C_deg off by"),
    ("cylinder-uncertainty", "touches-", "C_deg off by"),
    ("cylinder-kx8", "single-section", "A_deg off by"),
    // A spindle that turns a straight tool moves its tip by micrometres.
    ("first-steps", "", "S_deg off by"),
    // Poses of one target: with one axis counted otherwise they fit as well, and its axis lies elsewhere.
    ("positioner", "", " negated"),
    ("positioner", "", " off by"),
    // A robot may stand turned about its first joint, and its tool about the last one.
    ("robot-ur5", "", "C1_deg off by"),
    ("robot-ur5", "", "B4_deg off by"),
    // Distances of points that three linear axes reach do not depend on the tool.
    ("cmm-fifty-lengths", "", "tool_length_mm"),
];

/// Part by which the scatter of residuals may change where a mistake cannot be told: stated uncertainties are believed within a factor of
/// two, and the normals of a cylinder that are off by two degrees change less.
const SAME_SCATTER: f64 = 0.5;

/// Whether a mistake is one that no measurement tells: it is listed, and changes no scatter of residuals.
fn is_untellable(recipe: &str, file: &Path, what: &str, scatter: &[f64], right: &[f64]) -> bool {
    let file = file.display().to_string();
    let is_listed = UNTELLABLE
        .iter()
        .any(|(name, part, mistake)| recipe.starts_with(name) && file.contains(part) && what.contains(mistake));
    let is_same = |(one, other): (&f64, &f64)| (one / other - 1.0).abs() < SAME_SCATTER || one.max(*other) < 1e-3;
    is_listed && scatter.len() == right.len() && scatter.iter().zip(right).all(is_same)
}

/// Remarks, failures and warnings, numbers left out: the same remark with other numbers is not told anew.
fn said(end: &Ended) -> Said {
    let mut all = Said::new();
    let mut add = |text: &str| {
        let without: String =
            text.chars().filter(|letter| !letter.is_ascii_digit() && !"+-.eµ".contains(*letter)).collect();
        all.insert(without);
    };
    end.stderr.lines().filter(|line| line.contains("WARN")).for_each(&mut add);
    remarks(&serde_json::from_str(&end.stdout).unwrap_or_default(), false, &mut add);
    all
}

fn remarks(value: &Value, is_remark: bool, add: &mut impl FnMut(&str)) {
    match value {
        Value::String(text) if is_remark => add(text),
        Value::Array(items) => items.iter().for_each(|item| remarks(item, is_remark, add)),
        Value::Object(map) => {
            for (key, item) in map {
                let own = matches!(key.as_str(), "remarks" | "failures" | "doubts" | "implausible" | "message");
                remarks(item, is_remark || own, add);
            }
        }
        _ => {}
    }
}

fn run(program: &Path, source: &Source, folder: &Path) -> Option<Ended> {
    let recipe = source.recipe().display().to_string();
    ended(program, folder, &["run", &recipe, "--out", "out", "--json"], Bounds::default())
}

/// The calibrations of a run.
fn calibrations(folder: &Path) -> Vec<Value> {
    let mut files: Vec<PathBuf> = (fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()))
        .flat_map(|folder| fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()))
        .filter(|file| file.to_string_lossy().ends_with(".calibration.json"))
        .collect();
    files.sort();
    files.iter().filter_map(|file| serde_json::from_slice(&fs::read(file).ok()?).ok()).collect()
}

/// The values of all estimates of a run.
fn values(calibrations: &[Value]) -> Vec<f64> {
    let parameters = calibrations.iter().filter_map(|calibration| calibration["parameters"].as_array());
    parameters.flatten().filter_map(|parameter| parameter["value"].as_f64()).collect()
}

/// The scatter of the residuals of all estimates of a run, over what is stated.
fn scatter(calibrations: &[Value]) -> Vec<f64> {
    calibrations.iter().filter_map(|calibration| calibration["fit"]["sigma"].as_f64()).collect()
}

fn right(program: &Path, source: &Source) -> Right {
    let known = RIGHT.get_or_init(Mutex::default);
    if let Some(found) = known.lock().expect("no thread panics with it").get(&source.name) {
        return found.clone();
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    source.write(folder.path());
    let end = run(program, source, folder.path());
    let made = calibrations(&folder.path().join("out"));
    let found = Right {
        status: end.as_ref().and_then(|end| end.status.code()),
        said: end.as_ref().map(said).unwrap_or_default(),
        values: values(&made),
        scatter: scatter(&made),
    };
    known.lock().expect("no thread panics with it").insert(source.name.clone(), found.clone());
    found
}

/// A table of measurements: its lines, where its header is, and the columns of axes.
struct Table {
    lines: Vec<Vec<String>>,
    header: usize,
    /// Columns of commands of axes.
    axes: Vec<usize>,
}

impl Table {
    /// None if it has no commands of axes.
    fn read(content: &[u8]) -> Option<Self> {
        let text = std::str::from_utf8(content).ok()?;
        let lines: Vec<Vec<String>> = text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect();
        let header = lines.iter().position(|line| !line[0].starts_with('#'))?;
        let is_axis = |name: &&String| {
            let (base, unit) = name.rsplit_once('_').unwrap_or((name, ""));
            let letters = base.trim_end_matches(|letter: char| letter.is_ascii_digit());
            matches!(unit, "mm" | "deg")
                && letters.len() == 1
                && letters.chars().all(|letter| letter.is_ascii_uppercase())
        };
        let axes = (0..lines[header].len()).filter(|&column| is_axis(&&lines[header][column])).collect::<Vec<_>>();
        (axes.len() > 1).then_some(Self { lines, header, axes })
    }

    fn change(&mut self, column: usize, change: impl Fn(f64) -> f64) {
        for line in self.lines.iter_mut().skip(self.header + 1).filter(|line| !line[0].starts_with('#')) {
            if let Some(cell) = line.get_mut(column)
                && let Ok(value) = cell.parse::<f64>()
            {
                *cell = format!("{}", change(value));
            }
        }
    }

    /// The largest size of a column, and whether it changes from row to row.
    fn extent(&self, column: usize) -> (f64, bool) {
        let values: Vec<f64> = (self.lines.iter().skip(self.header + 1))
            .filter_map(|line| line.get(column).and_then(|cell| cell.parse().ok()))
            .collect();
        let most = values.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        (most, values.windows(2).any(|pair| pair[0] != pair[1]))
    }

    fn text(&self) -> String {
        self.lines.iter().map(|line| line.join(",") + "\n").collect()
    }
}

/// A mistake in the measurements; none where it would change nothing.
fn mistaken(random: &mut Random, table: &mut Table) -> Option<String> {
    let (axes, header) = (table.axes.clone(), table.lines[table.header].clone());
    let moving: Vec<usize> =
        axes.iter().copied().filter(|&axis| table.extent(axis).1 && table.extent(axis).0 > 10.0).collect();
    if moving.is_empty() {
        return None;
    }
    let unit = |unit: &str| moving.iter().copied().filter(|&axis| header[axis].ends_with(unit)).collect::<Vec<_>>();
    let (linear, rotary) = (unit("_mm"), unit("_deg"));
    let every = |table: &mut Table, axes: &[usize], factor: f64| {
        axes.iter().for_each(|&axis| table.change(axis, |value| value * factor));
    };
    match random.count(0, 7) {
        0 => {
            let axis = random.of(&moving);
            // Both ends of a length, and all columns of an axis, are read by one encoder.
            let letter = &header[axis][..1];
            let own: Vec<usize> = axes.iter().copied().filter(|&other| header[other].starts_with(letter)).collect();
            every(table, &own, -1.0);
            Some(format!("{letter} negated"))
        }
        1 if linear.len() > 1 => {
            let (one, other) = (random.of(&linear), random.of(&linear));
            if one == other || header[one][..1] == header[other][..1] {
                return None;
            }
            for line in table.lines.iter_mut().filter(|line| line.len() > one.max(other) && !line[0].starts_with('#')) {
                line.swap(one, other);
            }
            table.lines[table.header] = header.clone();
            Some(format!("{} and {} swapped", header[one], header[other]))
        }
        2 if !linear.is_empty() => {
            let (what, factor) =
                random.of(&[("inches", 1.0 / 25.4), ("25.4 times as long", 25.4), ("metres", 1e-3), ("um", 1e3)]);
            let all: Vec<usize> = axes.iter().copied().filter(|&axis| header[axis].ends_with("_mm")).collect();
            every(table, &all, factor);
            Some(what.to_owned())
        }
        3 if !rotary.is_empty() => {
            let axis = random.of(&rotary);
            table.change(axis, f64::to_radians);
            Some(format!("{} in radians", header[axis]))
        }
        4 if !rotary.is_empty() => {
            let (axis, off) = (random.of(&rotary), random.of(&[-5.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 5.0]));
            table.change(axis, |value| value + off);
            Some(format!("{} off by {off} degrees", header[axis]))
        }
        5 => {
            let axis = random.of(&moving);
            table.change(axis, |value| value * 1e3);
            Some(format!("{} beyond its travel", header[axis]))
        }
        _ => {
            let axis = random.of(&moving);
            table.change(axis, |value| (value * 0.01).round() / 0.01);
            Some(format!("{} rounded to hundreds", header[axis]))
        }
    }
}

/// A mistake in the machine; none where the text has no such setting.
fn mistaken_machine(random: &mut Random, text: &str) -> Option<(String, String)> {
    let (name, change): (&str, fn(f64) -> f64) = random.of(&[
        ("tool_length_mm: ", (|value| -value) as fn(f64) -> f64),
        ("tool_length_mm: ", |value| value + 45.0),
        ("tool_length_mm: ", |value| value * 25.4),
        ("stylus_radius_mm: ", |value| 2.0 * value),
        ("stylus_radius_mm: ", |value| -value),
        ("stylus_radius_mm: ", |value| value * 25.4),
    ]);
    let from = text.find(name)? + name.len();
    let to = from + text[from..].find(|letter: char| !letter.is_ascii_digit() && !".-".contains(letter))?;
    let value: f64 = text[from..to].parse().ok().filter(|value: &f64| value.abs() > 0.1)?;
    let new = change(value);
    Some((format!("{name}{new} and not {value}"), format!("{}{new}{}", &text[..from], &text[to..])))
}

/// A recipe of the repository with an absurd mistake.
pub fn case(program: &Path, stock: &Stock, random: &mut Random) -> Case {
    loop {
        let source = &stock.sources[random.count(0, stock.sources.len())];
        let mut files = source.files.clone();
        let (file, what) = if random.chance(0.7) {
            let tables: Vec<&PathBuf> =
                files.keys().filter(|file| file.extension().is_some_and(|end| end == "csv")).collect();
            if tables.is_empty() {
                continue;
            }
            let file = random.of(&tables).clone();
            let Some(mut table) = Table::read(&files[&file]) else { continue };
            let Some(what) = mistaken(random, &mut table) else { continue };
            files.insert(file.clone(), table.text().into_bytes());
            (file, what)
        } else {
            let texts: Vec<&PathBuf> =
                files.keys().filter(|file| file.extension().is_some_and(|end| end == "yaml")).collect();
            let file = random.of(&texts).clone();
            let text = String::from_utf8_lossy(&files[&file]).into_owned();
            let Some((what, text)) = mistaken_machine(random, &text) else { continue };
            files.insert(file.clone(), text.into_bytes());
            (file, what)
        };
        let folder = tempfile::tempdir().expect("a temporary folder");
        let changed = Source { name: source.name.clone(), files };
        changed.write(folder.path());
        let end = run(program, &changed, folder.path());
        let mut case = Case::new(format!("{}, {}: {what}", source.name, file.display()), end.as_ref());
        let right = right(program, source);
        if let Some(end) = &end {
            let is_told = case.status != right.status || !said(end).is_subset(&right.said);
            // What is not used changes nothing.
            let made = calibrations(&folder.path().join("out"));
            let has_no_effect = values(&made) == right.values;
            let is_untellable = is_untellable(&source.name, &file, &what, &scatter(&made), &right.scatter);
            let holds = is_told || has_no_effect || is_untellable;
            case.law(holds, || "it passes without a word".to_owned());
        }
        // What stays is whole.
        case.wrong.extend(crate::bad_inputs::wrong(end.as_ref(), folder.path()));
        let _ = fs::remove_dir_all(folder.path().join("out"));
        return case;
    }
}
