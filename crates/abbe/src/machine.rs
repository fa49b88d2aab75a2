//! `abbe model`: a machine in text: its axes, its chain, its errors, and which location errors are independent.

mod joints;

use std::fmt::Write;
use std::path::{Path, PathBuf};

use abbe_core::{Axis, AxisKind, Branch, Error, ModelInfo, ParameterRole, Result};
use abbe_engine::{Described, LocationError, LocationErrors, Prepared, Standing, prepare, prepare_text};
use abbe_report::{ErrorGroup, meaning};
use clap::Args;
use serde_json::Value;

use crate::explain::position;
use crate::libraries::Libraries;
use crate::lines;
use crate::outputs::{Written, is_file_name};
use crate::picture;
use crate::table::{self, plain};

/// What is asked.
#[derive(Debug, Args)]
pub struct Machine {
    /// A machine file or a recipe (`.yaml`), or a chain in the notation of ISO 10791-6, as "w C' A' b X Y Z t".
    #[arg(value_name = "MACHINE.yaml|RECIPE|CHAIN")]
    machine: String,
    /// Draw it as SVG: the chain with its joints, frames and axes, and what each error does at the tool. The file must not exist.
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Where axes stand in the picture, in mm and degrees, as `X=200,C=90`. Default: linear axes a quarter of their travel beyond its
    /// middle.
    #[arg(long, value_name = "AXIS=POSITION,..", value_delimiter = ',', value_parser = position, requires = "svg")]
    at: Vec<(String, f64)>,
}

/// Tool length of a machine that is given by its chain alone, mm: some length, so that tilts of the tool move its tip.
const TOOL_LENGTH: f64 = 200.0;

impl Machine {
    /// The machine of this file, recipe or chain.
    pub fn named(machine: &str) -> Self {
        Self { machine: machine.to_owned(), svg: None, at: Vec::new() }
    }

    /// Looks at the machine; gives what to print.
    pub fn run(&self, libraries: &Libraries) -> Result<Written> {
        let machines = self.described(libraries)?;
        let texts: Vec<String> = machines.iter().map(|machine| text(machine, lines::width())).collect();
        let mut written = Written { text: texts.join("\n"), files: Vec::new() };
        if let Some(file) = &self.svg {
            is_file_name(file)?;
            let [machine] = machines.as_slice() else {
                return Err(Error::usage("this recipe has several machines, and one is drawn")
                    .help("name the file of the machine")
                    .in_file(Path::new(&self.machine)));
            };
            let drawn = picture::svg(machine, &self.at, &libraries.registry(None)?)?;
            written.text.push_str(&format!("\nDrawn: {}\n", file.display()));
            written.files.push((file.clone(), drawn.into_bytes()));
        }
        Ok(written)
    }

    /// The machines, at least one.
    pub fn described(&self, libraries: &Libraries) -> Result<Vec<Described>> {
        let described = self.prepared(libraries)?.described();
        let machines = described.map_err(|error| of_file(error, Path::new(&self.machine)))?;
        match machines.is_empty() {
            true => Err(Error::usage("this recipe has no machine").in_file(Path::new(&self.machine))),
            false => Ok(machines),
        }
    }

    fn prepared(&self, libraries: &Libraries) -> Result<Prepared> {
        let path = PathBuf::from(&self.machine);
        let is_file = path.extension().is_some_and(|extension| extension == "yaml" || extension == "yml");
        let unreadable = |error: std::io::Error| {
            Error::usage(format!("the file cannot be read: {}", abbe_files::why(&error))).in_file(&path)
        };
        // A chain has blanks, and no file is named like one.
        if !is_file && path.exists() {
            abbe_files::open(&path).map_err(unreadable)?;
            let error = Error::usage("this is no machine file and no recipe; a file `.yaml` was expected");
            return Err(error.in_file(&path).help("`abbe data FILE` tells what is in a file of measurements"));
        }
        if !is_file {
            let registry = libraries.registry(None)?;
            let chain = Value::from(self.machine.as_str());
            let stage = format!(
                "{{ model: serial-chain, chain: {chain}, tool_length_mm: {TOOL_LENGTH}, stylus_radius_mm: 0 }}"
            );
            let made = prepare_text(Path::new("chain.yaml"), &recipe(&stage), &registry);
            let help = "name a machine file or a recipe (`.yaml`), or write a chain, as \"w C' A' b X Y Z t\"";
            return made.map_err(|error| match self.machine.trim().contains(' ') {
                // The recipe was made here: its lines say nothing.
                true => Error { place: None, stage: None, ..error },
                false => Error::usage("there is no such file").in_file(&path).help(help),
            });
        }
        let content = abbe_files::read_text(&path, abbe_files::LARGEST_TEXT).map_err(unreadable)?;
        // Lines may end in CR alone.
        if content.split(['\n', '\r']).any(|line| line.starts_with("stages:")) {
            return prepare(&path, &libraries.registry(Some(&path))?);
        }
        let registry = libraries.registry(None)?;
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let stage = format!("{{ model: serial-chain, file: {} }}", Value::from(name));
        let made = prepare_text(&around(&path), &recipe(&stage), &registry);
        made.map_err(|error| of_file(error, &path))
    }
}

/// The name of the recipe that is made around a machine file: beside it, so that its paths hold.
fn around(machine: &Path) -> PathBuf {
    machine.with_extension("recipe around it")
}

/// An error with the user's own file in the place of the recipe around it, which nobody wrote.
fn of_file(error: Error, machine: &Path) -> Error {
    match &error.place {
        Some(place) if place.file != around(machine) => Error { stage: None, ..error },
        _ => Error { place: None, stage: None, ..error }.in_file(machine),
    }
}

/// A recipe of a machine alone.
fn recipe(stage: &str) -> String {
    format!("abbe: 1\nname: A machine\nstages:\n  machine: {stage}\n")
}

/// What is told of a machine, in lines of this width.
fn text(machine: &Described, width: usize) -> String {
    let info = machine.model.info();
    let mut text = format!("{} (model: {})\n", machine.stage, machine.plugin);
    if let Some(chain) = info.settings.get("chain").and_then(Value::as_str) {
        let _ = writeln!(text, "  chain {chain}");
    }
    text.push_str(&picture(info, width));
    text.push_str(&axes(info, width));
    text.push_str(&joints::text(info, width));
    if let Some(locations) = &machine.locations {
        text.push_str(&location_text(info, locations, width));
    }
    text.push_str(&motions(info));
    text.push_str(&listed(info, width));
    lines::wrapped(&text, width)
}

/// The chain from the workpiece to the tool, with what each axis does below its name.
fn picture(info: &ModelInfo, width: usize) -> String {
    let mut cells = vec![("workpiece".to_owned(), String::new())];
    let bed = || ("bed".to_owned(), String::new());
    let mut has_bed = false;
    for axis in &info.axes {
        if axis.branch == Branch::Tool && !has_bed {
            cells.push(bed());
            has_bed = true;
        }
        let what = if axis.kind == AxisKind::Rotary { "turns" } else { "moves" };
        let prime = if axis.branch == Branch::Workpiece { "'" } else { "" };
        let name = format!("{}{prime}", axis.name);
        let name = if axis.indexed { format!("({name})") } else { name };
        cells.push((name, format!("{what} {}", nearest(axis))));
    }
    if !has_bed {
        cells.push(bed());
    }
    cells.push(("tool".to_owned(), String::new()));
    let mut text = String::new();
    let (mut above, mut below) = (INDENT.to_owned(), INDENT.to_owned());
    for (place, (name, does)) in cells.iter().enumerate() {
        let cell = name.chars().count().max(does.chars().count());
        let last = place + 1 == cells.len();
        if above.chars().count() + cell + 4 > width && above != INDENT {
            // The chain goes on below.
            let _ = write!(text, "\n{}\n{}\n", above.trim_end(), below.trim_end());
            (above, below) = (format!("{INDENT}--- "), format!("{INDENT}    "));
        }
        let fill = if last { String::new() } else { format!(" {}", "-".repeat(cell - name.chars().count() + 3)) };
        let _ = write!(above, "{name}{fill} ");
        let _ = write!(below, "{does:<cell$}     ");
    }
    let _ = write!(text, "\n{}\n{}\n", above.trim_end(), below.trim_end());
    text
}

const INDENT: &str = "  ";

/// The direction of x, y, z that an axis is nearest to.
pub fn nearest(axis: &Axis) -> String {
    let part = (0..3).max_by(|&a, &b| axis.direction[a].abs().total_cmp(&axis.direction[b].abs())).unwrap_or(0);
    let tilted = if axis.direction[part].abs() < 1.0 - 1e-9 { " (tilted)" } else { "" };
    let preposition = if axis.kind == AxisKind::Rotary { "about" } else { "along" };
    format!("{preposition} {}{tilted}", ["x", "y", "z"][part])
}

/// A number without what rounding leaves of a zero.
pub fn tidy(number: f64) -> String {
    plain(if number.abs() < 1e-9 { 0.0 } else { number })
}

/// Three numbers.
fn vector(of: [f64; 3]) -> String {
    of.map(tidy).join(" ")
}

/// A vector of the settings of an axis.
fn setting(info: &ModelInfo, axis: &str, key: &str) -> Option<[f64; 3]> {
    let value = info.settings.get("axes")?.get(axis)?.get(key)?;
    serde_json::from_value(value.clone()).ok()
}

fn axes(info: &ModelInfo, width: usize) -> String {
    let mut rows =
        vec![["axis", "kind", "carries the", "direction", "point of its line mm", "range"].map(str::to_owned).to_vec()];
    for axis in &info.axes {
        let (kind, factor, unit) = match axis.kind {
            AxisKind::Linear => ("linear", 1.0, "mm"),
            AxisKind::Rotary => ("rotary", 1f64.to_degrees(), "°"),
        };
        let point =
            (axis.kind == AxisKind::Rotary).then(|| vector(setting(info, &axis.name, "point_mm").unwrap_or_default()));
        let range = match axis.range {
            Some([from, to]) => format!("{} to {} {unit}", tidy(from * factor), tidy(to * factor)),
            None => "not known".to_owned(),
        };
        rows.push(vec![
            axis.name.clone(),
            format!("{kind}{}", if axis.indexed { ", indexed" } else { "" }),
            if axis.branch == Branch::Workpiece { "workpiece" } else { "tool" }.to_owned(),
            vector(axis.direction.map(|part| part * axis.sense * side(axis))),
            point.unwrap_or_default(),
            range,
        ]);
    }
    let note = "  A positive command moves the tool in this direction as seen from the workpiece.\n";
    format!("\nAxes, with all of them at zero\n{}{note}", table::within(&rows, &[], 1, width))
}

/// A body on the side of the workpiece moves the other way.
fn side(axis: &Axis) -> f64 {
    if axis.branch == Branch::Workpiece { -1.0 } else { 1.0 }
}

fn location_text(info: &ModelInfo, locations: &LocationErrors, width: usize) -> String {
    let count = locations.independent().count();
    let mut text = format!(
        "\nLocation errors: {} exist, 6 of each axis; {count} are independent, once workpiece and tool are set up\n",
        locations.all.len()
    );
    let mut rows = vec![["error", "what it is", "in its place, alone", "told by"].map(str::to_owned).to_vec()];
    for error in locations.independent() {
        let Standing::Independent { by_position, substitutes } = &error.standing else { continue };
        let told = if *by_position { "positions of one tip" } else { "other tool lengths or directions" };
        let substitutes = if substitutes.is_empty() { "-".to_owned() } else { substitutes.join(", ") };
        rows.push(vec![error.name.clone(), meaning(info, &group(error)), substitutes, told.to_owned()]);
    }
    text.push_str(&table::within(&rows, &[], 1, width));
    let dependent: Vec<String> = locations.all.iter().filter_map(same_as).collect();
    if !dependent.is_empty() {
        let _ = write!(
            text,
            "\nThe same as others, offsets and turns of workpiece and tool apart\n{}",
            listing(&dependent, width)
        );
    }
    text.push_str(&zero_positions(info, locations, width));
    let free: Vec<String> = locations
        .all
        .iter()
        .filter(|error| error.standing == Standing::SetUp && !is_zero_position(info, error))
        .map(|error| error.name.clone())
        .collect();
    if !free.is_empty() {
        let _ = write!(text, "\nFree: where workpiece and tool are does the same\n{}", listing(&free, width));
    }
    let ((position, all), (pose, _)) = (locations.by_position, locations.by_pose);
    let _ = writeln!(
        text,
        "\n  Of {all} location and set-up errors, positions of one tip tell {position}, poses tell {pose}."
    );
    text
}

/// A location error as a group of parameters, for its words.
fn group(error: &LocationError) -> ErrorGroup {
    let role = ParameterRole::Location { axis: error.axis, component: error.component };
    ErrorGroup { name: error.name.clone(), parameters: Vec::new(), role, is_reversal: false }
}

/// Whether an error is a shift along, or a turn about, the axis' own direction: where it is at zero.
fn is_zero_position(info: &ModelInfo, error: &LocationError) -> bool {
    let axis = &info.axes[error.axis];
    let is_turn = error.component >= 3;
    is_turn == (axis.kind == AxisKind::Rotary) && axis.direction[error.component % 3].abs() > 0.99
}

/// What a zero position may be.
const KINDS: [&str; 3] = [
    "Independent, among those above",
    "The same as others, as told above",
    "Nothing to estimate, workpiece and tool set-up do the same",
];

/// Its place among [`KINDS`].
fn kind(standing: &Standing) -> usize {
    match standing {
        Standing::Independent { .. } => 0,
        Standing::Dependent(_) => 1,
        Standing::SetUp => 2,
    }
}

/// The zero positions: by what they are, and whether the machine lists them.
fn zero_positions(info: &ModelInfo, locations: &LocationErrors, width: usize) -> String {
    let of = |place: usize| -> Vec<String> {
        let zero = locations.all.iter().filter(|error| is_zero_position(info, error));
        let mark = |name: &str| if info.parameter(name).is_some() { " (listed)" } else { "" };
        let wanted = zero.filter(|error| kind(&error.standing) == place);
        wanted.map(|error| format!("{}{}", error.name, mark(&error.name))).collect()
    };
    let mut text = "\nZero positions: what the position of an axis is off by where its command is 0\n".to_owned();
    for (place, title) in KINDS.into_iter().enumerate() {
        let found = of(place);
        if !found.is_empty() {
            let _ = write!(text, "  {title}:\n{}", listing(&found, width));
        }
    }
    text.push_str(
        "  All axes have one, whether `errors` of the machine lists it (listed) or not; one that is not listed is zero.\n",
    );
    text
}

/// Parts of a dependent error that are shown.
const SHOWN: usize = 3;

/// What a dependent error is the same as.
fn same_as(error: &LocationError) -> Option<String> {
    let Standing::Dependent(of) = &error.standing else { return None };
    let is_turn = |name: &str| name.chars().nth(1).is_some_and(|letter| "ABC".contains(letter));
    let part = |(name, factor): &(String, f64)| match (is_turn(&error.name), is_turn(name)) {
        // Memory has mm and rad: 1 mm/rad is 0.001 µm/µrad.
        (true, false) => format!("{} µm/µrad {name}", plain(factor * 1e-3)),
        (false, true) => format!("{} µrad/µm {name}", plain(factor * 1e3)),
        _ if (factor - 1.0).abs() < 1e-9 => name.clone(),
        _ if (factor + 1.0).abs() < 1e-9 => format!("-{name}"),
        _ => format!("{} {name}", plain(*factor)),
    };
    let mut parts: Vec<String> = of.iter().take(SHOWN).map(part).collect();
    if of.len() > SHOWN {
        parts.push(format!("{} more", of.len() - SHOWN));
    }
    Some(format!("{} = {}", error.name, parts.join(" + ").replace("+ -", "- ")))
}

/// Words in lines of this width, with commas between them.
fn listing(words: &[String], width: usize) -> String {
    let mut text = String::new();
    let mut line = String::new();
    for word in words {
        if !line.is_empty() && line.chars().count() + word.chars().count() + 3 > width {
            let _ = writeln!(text, " {line}");
            line.clear();
        }
        let _ = write!(line, " {word}{}", if words.last() == Some(word) { "" } else { "," });
    }
    if line.is_empty() { text } else { format!("{text} {line}\n") }
}

fn motions(info: &ModelInfo) -> String {
    let mut rows = Vec::new();
    for axis in &info.axes {
        let symbols: Vec<String> =
            ["X", "Y", "Z", "A", "B", "C"].iter().map(|letter| format!("E{letter}{}", axis.name)).collect();
        rows.push(vec![axis.name.clone(), symbols.join(" ")]);
    }
    format!(
        "\nMotion errors that each axis may have (which functions of the command they are, `errors` says)\n{}",
        table::text(&rows, &[])
    )
}

/// The errors that the machine lists.
fn listed(info: &ModelInfo, width: usize) -> String {
    let is_error = |role: ParameterRole| {
        matches!(
            role,
            ParameterRole::Motion { .. }
                | ParameterRole::Location { .. }
                | ParameterRole::Shape
                | ParameterRole::Factor
        )
    };
    let names: Vec<String> = info
        .parameters
        .iter()
        .filter(|parameter| is_error(parameter.role))
        .map(|parameter| parameter.name.clone())
        .collect();
    if names.is_empty() {
        return "\nErrors that it lists: none\n".to_owned();
    }
    format!("\nErrors that it lists\n{}", listing(&names, width))
}
