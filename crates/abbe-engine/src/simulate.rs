//! The virtual machine: measures the programme of a recipe and writes a folder in which the same recipe runs.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use abbe_core::{
    Contact, DataRow, Dataset, Error, Kind, Layout, ObservationSet, Observations, Problem, Result, Tie, from_settings,
};
use abbe_files::LARGEST_TEXT;
use abbe_recipe::Stage;
use abbe_simulation::{Sensors, Truth, measure};
use abbe_table::{Cells, Declared, Layout as FileLayout};

use crate::folder::write_folder;
use crate::places::Places;
use crate::prepare::Prepared;
use crate::readings::has_readings;
use crate::recorded::recorded;
use crate::run::has_rows;

/// A recipe with simulated data, in memory.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// The recipe, relative to the folder that it is written into.
    pub recipe: PathBuf,
    /// The data files that were simulated.
    pub data: Vec<SimulatedFile>,
    /// The data files that are not changed: their data are not from the simulated machine.
    pub not_simulated: Vec<UnchangedFile>,
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
    /// Rows that no artefact uses; they are copied without change.
    pub copied: usize,
    /// The stages that use what is read from it.
    pub read_by: BTreeSet<String>,
}

/// A data file of which no row is simulated.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnchangedFile {
    /// The file, relative to the folder that it is written into.
    pub file: PathBuf,
    /// The stages that use what is read from it.
    pub read_by: BTreeSet<String>,
}

/// Name of the file with the truth in the folder.
const TRUTH: &str = "truth.json";

impl Prepared {
    /// Measures the programme of the recipe on the machine that the file `truth` describes.
    ///
    /// `machine` is the name of its model stage; it may be left out if all estimates use one machine. Fails if the truth is
    /// wrong or names something that the recipe does not have, and if the machine cannot reach the artefact in a row.
    pub fn simulate(&self, truth: &Path, seed: u64, machine: Option<&str>) -> Result<Simulated> {
        let bytes = abbe_files::read(truth, LARGEST_TEXT).map_err(|error| unreadable(truth, &error))?;
        let text = String::from_utf8_lossy(&bytes);
        let values = Truth::parse(truth, &text)?;
        let machine = self.simulated_machine(machine)?;
        let programme = self.programme(machine)?;
        let of_truth = |error: Error| if error.place.is_none() { error.in_file(truth) } else { error };
        self.check_truth(machine, &values.of(&programme)).map_err(of_truth)?;
        let measured = measure(&programme, &values, seed).map_err(of_truth)?;
        let mut cells = recorded(&measured, values.noise.resolution_mm)?;
        let logs = self.logs(self.machine(self.recipe_stage(machine)?)?.0, |log| self.data(log))?;
        let layouts = self.layouts()?;
        sensed(&measured, &logs, (&values.noise.sensors, seed), &layouts, &mut cells).map_err(of_truth)?;

        let mut places = Places::new(&self.recipe.base);
        let mut files = BTreeMap::new();
        let (mut data, mut not_simulated) = (Vec::new(), Vec::new());
        let readers = self.readers()?;
        let recipe = PathBuf::from(self.recipe.path.file_name().unwrap_or(OsStr::new("recipe.yaml")));
        let own = [(recipe.as_path(), self.recipe.path.as_path()), (Path::new(TRUTH), truth)];
        own.into_iter().try_for_each(|(place, source)| places.take(place, source))?;
        let named = truth.file_name().unwrap_or(OsStr::new(TRUTH)).to_string_lossy();
        for source in self.files.iter().filter(|file| **file != self.recipe.path).collect::<BTreeSet<_>>() {
            let place = places.of(source)?;
            let mut content = abbe_files::read(source, u64::MAX).map_err(|error| unreadable(source, &error))?;
            let of_packing = |error: io::Error| abbe_table::unreadable(source, &error);
            if let Some(cells) = cells.get(source) {
                let layout = layouts.get(source).cloned().unwrap_or_default();
                let copied = abbe_table::read_laid_out(source, &layout)?.0.rows() - cells.len();
                let comment = comment(&named, seed, copied);
                let (table, packing) = abbe_files::content_of(content).map_err(of_packing)?;
                content = packing.pack(abbe_table::with_cells_laid_out(source, &table, cells, &layout, &comment)?);
                let read_by = readers.get(source).cloned().unwrap_or_default();
                data.push(SimulatedFile { file: place.clone(), measured: cells.len(), copied, read_by });
            } else if let Some(read_by) = readers.get(source) {
                not_simulated.push(UnchangedFile { file: place.clone(), read_by: read_by.clone() });
            }
            files.insert(place, content);
        }
        files.insert(recipe.clone(), places.adapt(&self.recipe.text)?.into_bytes());
        files.insert(PathBuf::from(TRUTH), bytes);
        Ok(Simulated { recipe, data, not_simulated, varied: values.summary(&programme), files })
    }

    /// The model stage whose measurements are simulated.
    fn simulated_machine<'a>(&'a self, wanted: Option<&'a str>) -> Result<&'a str> {
        let estimates = self.stages(Kind::Estimate).filter(has_rows);
        let used = estimates.map(|stage| Ok(self.machine_stage(stage)?.name.as_str()));
        let used = used.collect::<Result<BTreeSet<&str>>>()?;
        let list = used.iter().copied().collect::<Vec<_>>().join(", ");
        match (wanted, used.first()) {
            (Some(wanted), _) if used.contains(wanted) => Ok(wanted),
            (Some(wanted), _) => Err(Error::usage(format!("no estimate uses a machine `{wanted}`"))
                .help(format!("used are: {list}"))
                .suggest(wanted, used.iter().copied())
                .in_file(&self.recipe.path)),
            (None, Some(only)) if used.len() == 1 => Ok(only),
            (None, None) => Err(Error::usage("no estimate uses a machine, so that there is nothing to simulate")
                .help("simulated is what an estimate with `machine` and `observations` is made from")
                .in_file(&self.recipe.path)),
            (None, Some(_)) => Err(Error::usage(format!("the estimates use several machines: {list}"))
                .help("say which one is simulated: `--machine NAME`")
                .in_file(&self.recipe.path)),
        }
    }

    /// The layout of every file that `ingest: csv` reads rows from.
    ///
    /// Fails for a file that is read with two layouts.
    pub(crate) fn layouts(&self) -> Result<BTreeMap<PathBuf, FileLayout>> {
        let mut layouts: BTreeMap<PathBuf, FileLayout> = BTreeMap::new();
        for stage in self.stages(Kind::Ingest) {
            if !self.ingests[&stage.name].is_of_tables() {
                let error = Error::usage(format!(
                    "`{}` reads lines of a log, or tables that are no text, and rows are written into tables of text only",
                    stage.name
                ));
                let error =
                    error.help("take a table (`ingest: csv`) here, and read the log of the measurement afterwards");
                return self.located(stage, Err(error.stage(&stage.name)));
            }
            // Other readers have other settings; their files have the usual layout, or are refused where they are written.
            let layout = from_settings::<Declared>(&stage.settings).and_then(Declared::layout).unwrap_or_default();
            for file in &self.data(&stage.name)?.files {
                if layouts.insert(file.clone(), layout.clone()).is_some_and(|other| other != layout) {
                    let message = "the file is read with two layouts, and simulated rows can be written in one only";
                    return Err(Error::usage(message).in_file(file).help("read it by one stage, or copy it"));
                }
            }
        }
        Ok(layouts)
    }

    /// The stages that use measurements, by the file that these are read from.
    fn readers(&self) -> Result<BTreeMap<PathBuf, BTreeSet<String>>> {
        let mut readers: BTreeMap<PathBuf, BTreeSet<String>> = BTreeMap::new();
        let uses = |stage: &Stage, ingest: &String| {
            ["from", "repeats", "logs"].iter().any(|key| stage.reference(key).contains(ingest))
        };
        for ingest in self.ingests.keys() {
            let users = self.recipe.stages.iter().filter(|stage| uses(stage, ingest));
            let users: BTreeSet<String> = users.map(|stage| stage.name.clone()).collect();
            // Only files that rows come from. Files that are joined to them contain no measurements.
            for file in &self.data(ingest)?.files {
                readers.entry(file.clone()).or_default().extend(users.iter().cloned());
            }
        }
        // Nominal geometry is not measured, for any reader.
        let nominal: BTreeSet<PathBuf> =
            self.artefacts.values().flat_map(|artefact| artefact.inputs()).map(|file| file.path).collect();
        for (name, validator) in &self.validators {
            for file in validator.inputs().into_iter().filter(|file| !nominal.contains(&file.path)) {
                readers.entry(file.path).or_default().insert(name.clone());
            }
        }
        Ok(readers)
    }

    /// All observations of the estimates of a machine, every row of a file once, with the first artefact stage that uses it.
    /// Then the rows that their artefacts use of data that only validators judge.
    fn programme(&self, machine: &str) -> Result<Problem> {
        let mut observed: BTreeSet<&String> = BTreeSet::new();
        for estimate in self.stages(Kind::Estimate).filter(has_rows) {
            if self.is_of(estimate, machine)? {
                observed.extend(estimate.reference("observations"));
            }
        }
        for validator in self.stages(Kind::Validate) {
            if self.judges(validator, machine)? {
                observed.extend(validator.reference("observations"));
            }
        }
        let mut data: BTreeMap<&str, Arc<Dataset>> = BTreeMap::new();
        let mut sources = Vec::new();
        for stage in self.stages(Kind::Artefact).filter(|stage| observed.contains(&stage.name)) {
            for from in std::iter::once(self.artefact(&stage.name)?.0).chain(self.repeats(&stage.name)?) {
                sources.push((stage, from));
                if !data.contains_key(from) {
                    data.insert(from, self.data(from)?);
                }
            }
        }
        let stage = self.recipe_stage(machine)?;
        let (described, model) = self.machine(stage)?;
        let logs = self.logs(described, |log| self.data(log))?;
        let used: Vec<&Dataset> = data.values().map(AsRef::as_ref).chain(&logs).collect();
        let model = self.located(stage, model.build(&used))?;
        let mut claimed = Claimed::default();
        let (mut sets, mut combined) = (Vec::new(), Vec::new());
        for (artefact, from) in sources {
            let observations = self.artefacts[&artefact.name].observe(&data[from], &model);
            let observations = self.located(artefact, observations)?;
            if let Contact::NotSimulated(why) = &observations.info().contact {
                let error = Error::usage(format!("the artefact `{}` cannot be simulated yet: {why}", artefact.plugin))
                    .help("leave out the estimates that observe it");
                return self.located(artefact, Err(error));
            }
            match observations.info().layout.merged.is_empty() && !data[from].averaged {
                true => sets.push(claimed.unclaimed(&artefact.name, observations)),
                false => combined.push((artefact, observations)),
            }
        }
        for (artefact, observations) in combined {
            // The single touches are recorded: they have to be simulated by an artefact that uses them one by one.
            if !claimed.has_all(&observations.info().layout) {
                let error =
                    Error::usage("its rows combine several recorded ones, which cannot be told from the combination");
                let error =
                    error.help("observe an artefact in another estimate that takes the recorded rows one by one");
                return self.located(artefact, Err(error));
            }
        }
        for (artefact, from) in self.judged(machine)? {
            // Data that these artefacts cannot use are not changed; they are listed in `not_simulated`.
            let data = self.data(from)?;
            let Ok(observations) = self.artefacts[artefact].observe(&data, &model) else { continue };
            let measures = observations.info().layout.merged.is_empty();
            if measures && !matches!(observations.info().contact, Contact::NotSimulated(_)) {
                let set = claimed.unclaimed(artefact, observations);
                sets.extend(Some(set).filter(|set| !set.rows.is_empty()));
            }
        }
        let mut ties: Vec<Tie> = Vec::new();
        for estimate in self.stages(Kind::Estimate).filter(has_rows) {
            if self.is_of(estimate, machine)? {
                let declared = self.located(estimate, Tie::declared(model.as_ref(), &estimate.ties))?;
                ties.extend(declared.into_iter().filter(|tie| !ties.contains(tie)).collect::<Vec<_>>());
            }
        }
        // Nothing is estimated here: neither unknowns nor the uncertainty of inputs matter.
        Ok(Problem {
            name: machine.to_owned(),
            machine_values: model.info().nominal.clone(),
            model,
            model_plugin: self.model_plugin(stage)?,
            sets,
            unknowns: Vec::new(),
            ties,
            inputs: Vec::new(),
            considered: abbe_core::Considered::default(),
            priors: Vec::new(),
            monitor: abbe_core::Monitor::default(),
        })
    }

    /// The rows of an ingest stage.
    fn data(&self, ingest: &str) -> Result<Arc<Dataset>> {
        let read = self.ingests[ingest].read();
        Ok(Arc::new(self.located(self.recipe_stage(ingest)?, read)?))
    }

    /// Pairs (artefact, ingest stage): ingest stages that validators read, with the artefacts of the estimates that they
    /// judge.
    fn judged(&self, machine: &str) -> Result<BTreeSet<(&str, &str)>> {
        let mut judged = BTreeSet::new();
        for stage in self.stages(Kind::Validate) {
            for of in stage.reference("of") {
                let estimate = self.own_estimate(of)?;
                if self.is_of(estimate, machine)? {
                    let from = || stage.reference("from").iter().map(String::as_str);
                    let artefacts = estimate.reference("observations");
                    judged.extend(artefacts.iter().flat_map(|name| from().map(move |from| (name.as_str(), from))));
                }
            }
        }
        Ok(judged)
    }

    /// Whether a validator judges an estimate of a machine.
    fn judges(&self, validator: &Stage, machine: &str) -> Result<bool> {
        for of in validator.reference("of") {
            if self.is_of(self.own_estimate(of)?, machine)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Whether an estimate is one of a machine. Estimates of readings that are no geometry have none.
    pub(crate) fn is_of(&self, estimate: &Stage, machine: &str) -> Result<bool> {
        Ok(!has_readings(estimate) && self.machine_stage(estimate)?.name == machine)
    }
}

/// Rows of files that an artefact already uses: (file, line).
#[derive(Default)]
struct Claimed(BTreeSet<(PathBuf, usize)>);

impl Claimed {
    /// The observations with only the rows that are not claimed yet.
    fn unclaimed(&mut self, name: &str, observations: Arc<dyn Observations>) -> ObservationSet {
        let mut set = ObservationSet::new(name, observations);
        let layout = &set.observations.info().layout;
        set.rows.retain(|&row| layout.rows[row].data_row.is_some_and(|row| self.0.insert(place(layout, row))));
        set
    }

    /// Whether all rows that were used for these observations are claimed.
    fn has_all(&self, layout: &Layout) -> bool {
        let mut recorded = layout.rows.iter().filter_map(|row| row.data_row).chain(layout.merged.iter().copied());
        recorded.all(|row| self.0.contains(&place(layout, row)))
    }
}

/// Where a row of the data stands.
fn place(layout: &Layout, row: DataRow) -> (PathBuf, usize) {
    let origin = layout.data.origins[row];
    (layout.data.files[origin.file].clone(), origin.line)
}

/// What sensors record in the logs of the machine, and beside measured rows.
fn sensed(
    measured: &Problem,
    logs: &[Dataset],
    (sensors, seed): (&Sensors, u64),
    layouts: &BTreeMap<PathBuf, FileLayout>,
    files: &mut BTreeMap<PathBuf, Cells>,
) -> Result<()> {
    let rows: Vec<&Dataset> = measured.sets.iter().map(|set| set.info().layout.data.as_ref()).collect();
    sensors.known(rows.iter().copied().chain(logs))?;
    if sensors.are_exact() {
        return Ok(());
    }
    for data in rows.into_iter().chain(logs) {
        let own = |file: &PathBuf| match layouts.get(file) {
            Some(layout) => abbe_table::read_headers_laid_out(file, layout),
            None => abbe_table::read_headers(file),
        };
        let headers = data.files.iter().map(own).collect::<Result<Vec<_>>>()?;
        for (header, readings) in sensors.recorded(data, seed) {
            for (origin, reading) in data.origins.iter().zip(readings) {
                let lines = files.entry(data.files[origin.file].clone()).or_default();
                // A temperature of measured rows may be one of `constants`: that is stated, and not read.
                let has_it = || headers[origin.file].iter().any(|own| own.header == header);
                if data.is_log || (lines.contains_key(&origin.line) && has_it()) {
                    lines.entry(origin.line).or_default().insert(header.clone(), format!("{reading:.6}"));
                }
            }
        }
    }
    Ok(())
}

fn comment(truth: &str, seed: u64, copied: usize) -> String {
    let rows = if copied == 1 { "row that no artefact takes was" } else { "rows that no artefact takes were" };
    let copied = if copied == 0 { String::new() } else { format!("; {copied} {rows} copied") };
    format!("# simulated: {truth}, seed {seed}{copied}\n")
}

fn unreadable(file: &Path, error: &io::Error) -> Error {
    let message = match error.kind() {
        io::ErrorKind::NotFound => "there is no such file".to_owned(),
        _ => format!("the file cannot be read: {}", abbe_files::why(error)),
    };
    Error::usage(message).help("name a file that can be read").in_file(file)
}

impl Simulated {
    /// Writes everything into the folder `out`, which must not exist or be empty: whole or not at all.
    pub fn write(&self, out: &Path) -> Result<()> {
        write_folder(out, &self.files)
    }
}
