//! The virtual machine: measures the programme of a recipe and writes a folder in which the same recipe runs.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fs;
use std::io;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use abbe_core::{
    Approach, AxisKind, Contact, Dataset, Error, Kind, Layout, ObservationSet, Observations, Problem, Quantity, Result,
    Row,
};
use abbe_recipe::Stage;
use abbe_simulation::{Truth, measure};
use abbe_table::Cells;

use crate::folder::write_folder;
use crate::prepare::Prepared;
use crate::run::has_problem;

/// A recipe with simulated data, in memory.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// The recipe, relative to the folder that it is written into.
    pub recipe: PathBuf,
    /// The data files that were simulated.
    pub data: Vec<SimulatedFile>,
    /// What differs from nominal, and the noise; one line each.
    pub varied: Vec<String>,
    /// All files with their contents, relative to the folder that they are written into.
    files: BTreeMap<PathBuf, Vec<u8>>,
}

/// A data file with simulated rows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SimulatedFile {
    /// The file, relative to the folder that it is written into.
    pub file: PathBuf,
    /// Rows that were measured.
    pub measured: usize,
    /// Rows that no artefact takes, which are as they were.
    pub copied: usize,
}

/// What the truth is called in the folder.
const TRUTH: &str = "truth.json";

/// Decimals of a number whose scale has no step, of a coordinate in mm: what a double holds of a metre.
const DECIMALS: usize = 12;

impl Prepared {
    /// Measures the programme of the recipe on the machine that the file `truth` describes.
    ///
    /// `machine` says which model stage it is; it may be left out if all estimates use one. Fails for a truth that is wrong
    /// or that the recipe does not know, and for rows in which the machine cannot reach the artefact.
    pub fn simulate(&self, truth: &Path, seed: u64, machine: Option<&str>) -> Result<Simulated> {
        let bytes = fs::read(truth).map_err(|error| unreadable(truth, &error))?;
        let text = String::from_utf8_lossy(&bytes);
        let values = Truth::parse(truth, &text)?;
        let programme = self.programme(self.machine(machine)?)?;
        let of_truth = |error: Error| if error.place.is_none() { error.in_file(truth) } else { error };
        let measured = measure(&programme, &values, seed).map_err(of_truth)?;
        let cells = recorded(&measured, values.noise.resolution_mm)?;

        let mut places = Places::new(&self.recipe.base);
        let mut files = BTreeMap::new();
        let mut data = Vec::new();
        let recipe = PathBuf::from(self.recipe.path.file_name().unwrap_or(OsStr::new("recipe.yaml")));
        let own = [(recipe.as_path(), self.recipe.path.as_path()), (Path::new(TRUTH), truth)];
        own.into_iter().try_for_each(|(place, source)| places.take(place, source))?;
        let named = truth.file_name().unwrap_or(OsStr::new(TRUTH)).to_string_lossy();
        for source in self.files.iter().filter(|file| **file != self.recipe.path).collect::<BTreeSet<_>>() {
            let place = places.of(source)?;
            let mut content = fs::read(source).map_err(|error| unreadable(source, &error))?;
            if let Some(cells) = cells.get(source) {
                let copied = abbe_table::read(source)?.rows() - cells.len();
                let text = abbe_table::with_cells(source, &content, cells)?;
                let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
                content = format!("{}{text}", comment(&named, seed, copied)).into_bytes();
                data.push(SimulatedFile { file: place.clone(), measured: cells.len(), copied });
            }
            files.insert(place, content);
        }
        files.insert(recipe.clone(), places.adapt(&self.recipe.text)?.into_bytes());
        files.insert(PathBuf::from(TRUTH), bytes);
        Ok(Simulated { recipe, data, varied: values.summary(&programme), files })
    }

    /// The model stage whose measurements are simulated.
    fn machine<'a>(&'a self, wanted: Option<&'a str>) -> Result<&'a str> {
        let estimates = self.stages(Kind::Estimate).filter(has_problem);
        let used: BTreeSet<&str> = estimates.map(|stage| stage.reference("machine")[0].as_str()).collect();
        let list = used.iter().copied().collect::<Vec<_>>().join(", ");
        match (wanted, used.first()) {
            (Some(wanted), _) if used.contains(wanted) => Ok(wanted),
            (Some(wanted), _) => Err(Error::usage(format!("no estimate uses a machine `{wanted}`"))
                .help(format!("used are: {list}"))
                .suggest(wanted, used.iter().copied())
                .in_file(&self.recipe.path)),
            (None, Some(only)) if used.len() == 1 => Ok(only),
            (None, None) => Err(Error::usage("no estimate uses a machine, so that there is nothing to simulate")
                .in_file(&self.recipe.path)),
            (None, Some(_)) => Err(Error::usage(format!("the estimates use several machines: {list}"))
                .help("say which one is simulated: `--machine NAME`")
                .in_file(&self.recipe.path)),
        }
    }

    /// Everything that the estimates with a machine observe, every row of a file once: with the first artefact stage that
    /// takes it.
    fn programme(&self, machine: &str) -> Result<Problem> {
        let estimates = self.stages(Kind::Estimate).filter(has_problem);
        let estimates = estimates.filter(|stage| stage.reference("machine")[0] == machine);
        let observed: BTreeSet<&String> = estimates.flat_map(|stage| stage.reference("observations")).collect();
        let mut data: BTreeMap<&str, Arc<Dataset>> = BTreeMap::new();
        let mut sources = Vec::new();
        for stage in self.stages(Kind::Artefact).filter(|stage| observed.contains(&stage.name)) {
            for from in std::iter::once(self.artefact(&stage.name)?.0).chain(self.repeats(&stage.name)?) {
                sources.push((stage, from));
                if !data.contains_key(from) {
                    let read = self.ingests[from].read();
                    data.insert(from, Arc::new(self.located(self.recipe_stage(from)?, read)?));
                }
            }
        }
        let stage = self.recipe_stage(machine)?;
        let used: Vec<&Dataset> = data.values().map(AsRef::as_ref).collect();
        let model = self.located(stage, self.models[machine].build(&used))?;
        let mut claimed = BTreeSet::new();
        let (mut sets, mut combined) = (Vec::new(), Vec::new());
        for (artefact, from) in sources {
            let observe = |artefact: &Stage| self.artefacts[&artefact.name].observe(&data[from], model.as_ref());
            let observations = self.located(artefact, observe(artefact))?;
            match observations.layout().merged.is_empty() && !data[from].averaged {
                true => sets.push(unclaimed(&artefact.name, observations, &mut claimed)),
                false => combined.push((artefact, observations)),
            }
        }
        for (artefact, observations) in combined {
            // What is recorded are the single touches: they have to be measured by an artefact that takes them as such.
            if !unclaimed(&artefact.name, observations, &mut claimed).rows.is_empty() {
                let error =
                    Error::usage("its rows combine several recorded ones, which cannot be told from the combination");
                let error =
                    error.help("observe an artefact in another estimate that takes the recorded rows one by one");
                return self.located(artefact, Err(error));
            }
        }
        // Nothing is estimated here: neither unknowns nor the uncertainty of inputs matter.
        Ok(Problem {
            name: machine.to_owned(),
            machine: vec![0.0; model.parameters().len()],
            model,
            model_plugin: stage.plugin.clone(),
            sets,
            unknowns: Vec::new(),
            inputs: Vec::new(),
            considered: abbe_core::Considered::default(),
        })
    }
}

/// Observations with those of their rows that nobody has claimed yet.
fn unclaimed(
    name: &str,
    observations: Arc<dyn Observations>,
    claimed: &mut BTreeSet<(PathBuf, usize)>,
) -> ObservationSet {
    let mut set = ObservationSet::new(name, observations);
    let layout = set.observations.layout();
    let data = &layout.data;
    set.rows.retain(|&row| match layout.rows[row].data_row.map(|row| data.origins[row]) {
        Some(origin) => claimed.insert((data.files[origin.file].clone(), origin.line)),
        None => true,
    });
    set
}

/// What is recorded in which cells of which files.
fn recorded(measured: &Problem, resolution: f64) -> Result<BTreeMap<PathBuf, Cells>> {
    let axes = measured.model.axes().iter().filter(|axis| axis.kind == AxisKind::Linear);
    let axes: Vec<usize> = axes.map(|axis| axis.status).collect();
    let mut files: BTreeMap<PathBuf, Cells> = BTreeMap::new();
    for set in &measured.sets {
        let layout = set.observations.layout();
        for &index in &set.rows {
            let row = &layout.rows[index];
            let Some(data_row) = row.data_row else { continue };
            let origin = layout.data.origins[data_row];
            let cells = match set.observations.contact() {
                Contact::LinearAxes => {
                    let mut cells = positions(set, row, &axes)?;
                    if let Some(Approach { axis, reading }) = set.observations.approach(index) {
                        let triggered = set.poses().row(row.first_pose)[measured.model.axes()[axis].status];
                        cells.push((header(layout, &reading)?, triggered));
                    }
                    cells
                }
                Contact::Reading(column) => reading(set, row, data_row, &column)?,
            };
            let line = files.entry(layout.data.files[origin.file].clone()).or_default().entry(origin.line).or_default();
            for (header, value) in cells {
                let written = number(&header, value, resolution);
                if line.insert(header.clone(), written.clone()).is_some_and(|other| other != written) {
                    let message = format!("`{header}` is recorded once, but differs between the poses of this row");
                    return Err(layout.data.error_at(data_row, message));
                }
            }
        }
    }
    Ok(files)
}

/// The positions of the linear axes at the poses of a row, by the header of their columns.
fn positions(set: &ObservationSet, row: &Row, axes: &[usize]) -> Result<Vec<(String, f64)>> {
    let layout = set.observations.layout();
    let mut found = Vec::new();
    for pose in 0..row.poses {
        let (status, before) = (set.poses().row(row.first_pose + pose), layout.poses.row(row.first_pose + pose));
        for &axis in axes {
            match layout.recorded(pose, axis) {
                Some(column) => found.push((header(layout, column)?, status[axis])),
                None if status[axis] == before[axis] => {}
                None => {
                    return Err(Error::usage("a linear axis has to move, but the data have no column that records it")
                        .stage(&set.name)
                        .help("give the data a column for every linear axis"));
                }
            }
        }
    }
    Ok(found)
}

/// The reading of a row, by the header of its column.
fn reading(set: &ObservationSet, row: &Row, data_row: usize, column: &str) -> Result<Vec<(String, f64)>> {
    let layout = set.observations.layout();
    let before = layout.data.required_numbers(column)?[data_row];
    // The equation has the reading with a minus sign: what is added to the one is taken from the other.
    let change = set.disturbances().map_or(0.0, |disturbances| disturbances[row.first_equation]);
    Ok(vec![(header(layout, column)?, before - change)])
}

/// The header of a column, as its file writes it.
fn header(layout: &Layout, column: &str) -> Result<String> {
    let missing = || Error::usage(format!("there is no column `{column}`"));
    layout.data.column(column).map(|column| column.header.header.clone()).ok_or_else(missing)
}

/// A value in the unit of its column, with the decimals that the resolution (mm) asks for.
fn number(header: &str, value: f64, resolution: f64) -> String {
    let (_, quantity, factor) = Quantity::of_column(header);
    if quantity != Quantity::Length {
        return format!("{}", value / factor);
    }
    let step = resolution / factor;
    let is_whole = |decimals: &usize| {
        let steps = step * 10_f64.powi(*decimals as i32);
        steps > 0.5 && (steps - steps.round()).abs() < 1e-6 * steps
    };
    let decimals = (0..=DECIMALS).find(is_whole).unwrap_or(DECIMALS);
    let text = format!("{:.decimals$}", value / factor);
    match text.strip_prefix('-') {
        Some(zero) if zero.bytes().all(|digit| matches!(digit, b'0' | b'.')) => zero.to_owned(),
        _ => text,
    }
}

fn comment(truth: &str, seed: u64, copied: usize) -> String {
    let rows = if copied == 1 { "row that no artefact takes was" } else { "rows that no artefact takes were" };
    let copied = if copied == 0 { String::new() } else { format!("; {copied} {rows} copied") };
    format!("# simulated: {truth}, seed {seed}{copied}\n")
}

fn unreadable(file: &Path, error: &io::Error) -> Error {
    let message = match error.kind() {
        io::ErrorKind::NotFound => "there is no such file".to_owned(),
        _ => format!("the file cannot be read: {error}"),
    };
    Error::usage(message).in_file(file)
}

/// Where files go inside the folder, and how the recipe has to name them there.
struct Places<'a> {
    base: &'a Path,
    taken: BTreeMap<PathBuf, PathBuf>,
    /// Folders as the recipe may write them, with their names in the folder, and whether it has to write them.
    folders: BTreeMap<String, (String, bool)>,
}

impl<'a> Places<'a> {
    fn new(base: &'a Path) -> Self {
        Self { base, taken: BTreeMap::new(), folders: BTreeMap::new() }
    }

    /// Claims a place for a file.
    fn take(&mut self, place: &Path, source: &Path) -> Result<()> {
        match self.taken.insert(place.to_owned(), source.to_owned()) {
            Some(other) if other != source => Err(Error::usage(format!(
                "`{}` and `{}` would both be written to `{}`",
                other.display(),
                source.display(),
                place.display()
            ))
            .help("rename one of them")),
            _ => Ok(()),
        }
    }

    /// The place of a file: where the recipe has it, without what leads out of its folder.
    fn of(&mut self, source: &Path) -> Result<PathBuf> {
        let written = source.strip_prefix(self.base).unwrap_or(source);
        let normal = written.components().filter(|part| matches!(part, Component::Normal(_)));
        let place: PathBuf = normal.collect();
        self.take(&place, source)?;
        let target = folder(&place);
        let leads_out = written.components().any(|part| !matches!(part, Component::Normal(_) | Component::CurDir));
        if leads_out {
            self.folders.insert(folder(written), (target, true));
        } else if source.is_absolute() {
            // The recipe may name it by its absolute path all the same.
            self.folders.insert(folder(source), (target, false));
        }
        Ok(place)
    }

    /// The text of the recipe with the folders as they are named inside the folder.
    fn adapt(&self, text: &str) -> Result<String> {
        let mut adapted = text.to_owned();
        let mut folders: Vec<_> = self.folders.iter().collect();
        folders.sort_by_key(|(from, _)| std::cmp::Reverse(from.len()));
        for (from, (to, needed)) in folders {
            let (next, count) = replaced(&adapted, from, to);
            if *needed && count == 0 {
                return Err(Error::usage(format!("the recipe does not write the folder `{from}` as it is")).help(
                    "write paths that lead out of the recipe's folder without escapes, or copy these files into it",
                ));
            }
            adapted = next;
        }
        Ok(adapted)
    }
}

/// The folder of a file with a closing slash; empty if it has none.
fn folder(file: &Path) -> String {
    match file.parent() {
        Some(folder) if folder == Path::new("/") => "/".to_owned(),
        Some(folder) if folder != Path::new("") => format!("{}/", folder.display()),
        _ => String::new(),
    }
}

/// The text with `from` replaced wherever a path begins with it, and how often that is.
fn replaced(text: &str, from: &str, to: &str) -> (String, usize) {
    let (mut out, mut rest, mut count) = (String::with_capacity(text.len()), text, 0);
    while let Some(at) = rest.find(from) {
        let begins = !rest[..at].ends_with(|c: char| c.is_alphanumeric() || matches!(c, '.' | '/' | '_' | '-'));
        out.push_str(&rest[..at]);
        out.push_str(if begins { to } else { from });
        count += usize::from(begins);
        rest = &rest[at + from.len()..];
    }
    out.push_str(rest);
    (out, count)
}

impl Simulated {
    /// Writes everything into the folder `out`, which must not exist or be empty: whole or not at all.
    pub fn write(&self, out: &Path) -> Result<()> {
        write_folder(out, &self.files)
    }
}
