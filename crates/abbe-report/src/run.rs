//! The results of a run, from memory or from its folder.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use abbe_core::{
    Calibration, Error, EstimateSource, ExportedFile, Kind, KinematicModel, Quantities, Registry, Result, Verdict,
};
use abbe_engine::{CALIBRATION, Outcome, RunRecord, VERDICTS, model_of, residuals_file};
use abbe_files::{LARGEST_RESULT, LARGEST_TEXT, read_text};
use abbe_trend::{Analysis, Quality};
use sha2::{Digest, Sha256};

use crate::analysis::Analysis as VolumetricAnalysis;
use crate::residuals::Residuals;
use crate::sections::AcceptanceTable;

/// An estimate with what the page needs of it.
pub struct FitResult {
    /// Its name.
    pub name: String,
    /// Its result.
    pub calibration: Calibration,
    /// The machine, or the quantities in its place.
    pub model: Arc<dyn KinematicModel>,
    /// Its residuals; none if they are not known.
    pub residuals: Residuals,
    analysis: OnceLock<Result<Option<VolumetricAnalysis>>>,
}

impl FitResult {
    /// An estimate with its residuals; without any where they are not known.
    pub fn new(name: &str, calibration: Calibration, model: Arc<dyn KinematicModel>, residuals: Residuals) -> Self {
        Self { name: name.to_owned(), calibration, model, residuals, analysis: OnceLock::new() }
    }

    /// Its volumetric error and the causes; none for an estimate without axes or without errors of axes. Sections ask for it again, it is
    /// computed once.
    ///
    /// Fails where the model fails in the measured travel.
    pub fn analysis(&self) -> Result<Option<&VolumetricAnalysis>> {
        let found = self.analysis.get_or_init(|| VolumetricAnalysis::of(self));
        found.as_ref().map(Option::as_ref).map_err(Clone::clone)
    }
}

/// Files by their names in the folder of a run.
pub type Files = Vec<(PathBuf, Vec<u8>)>;

/// The results of one run.
pub struct Run {
    /// The name that tells it from others on the page.
    pub name: String,
    /// What its recipe says that it is.
    pub title: String,
    /// The estimates.
    pub fits: Vec<FitResult>,
    /// The verdicts.
    pub verdicts: Vec<Verdict>,
    /// What the history of the machine tells, by the stages that judged it, and how good each test is.
    pub trends: Vec<(String, Analysis, Vec<Quality>)>,
    /// The tables of acceptance tests.
    pub acceptance: Vec<AcceptanceTable>,
    /// The record; none for a calibration without its run.
    pub record: Option<RunRecord>,
    /// Text of the recipe, if it is as it was.
    pub recipe: Option<String>,
}

impl Run {
    /// The results of a run, and the tables of residuals that belong into its folder.
    ///
    /// Fails where a model fails at the values of its calibration.
    pub fn of(outcome: &Outcome) -> Result<(Self, Files)> {
        let mut tables = Vec::new();
        let mut fits = Vec::new();
        for fit in &outcome.fits {
            let mut residuals = Residuals::default();
            // Those of every week would be a page each.
            if !fit.problem.sets.is_empty() && fit.calibration.group.is_none() {
                // What is written is what is shown.
                let table = Residuals::of(fit)?.to_csv()?;
                residuals = Residuals::from_csv(&table)?;
                tables.push((residuals_file(&fit.name), table.into_bytes()));
            }
            let (calibration, model) = (fit.calibration.clone(), fit.problem.model.clone());
            fits.push(FitResult::new(&fit.name, calibration, model, residuals));
        }
        let record = outcome.record();
        let run = Self {
            name: outcome.recipe.clone(),
            title: outcome.title.clone(),
            fits: shown(fits),
            verdicts: outcome.verdicts.clone(),
            trends: trends_of(outcome)?,
            acceptance: acceptance_of(outcome),
            recipe: recipe_of(&record),
            record: Some(record),
        };
        Ok((run, tables))
    }

    /// Reads the folder of a run, or one calibration.
    ///
    /// Fails on a path that is neither, and on files that are wrong.
    pub fn read(path: &Path, registry: &Registry) -> Result<Self> {
        if path.is_dir() { Self::of_folder(path, registry) } else { Self::of_calibration(path, registry) }
    }

    fn of_folder(folder: &Path, registry: &Registry) -> Result<Self> {
        let file = folder.join("run.json");
        let text = read_text(&file, LARGEST_RESULT).map_err(|error| {
            let message = format!("{} is no folder with the results of a run: run.json {error}", folder.display());
            Error::usage(message).help("name the folder that `abbe run` wrote, or a calibration")
        })?;
        let record = RunRecord::from_json(&text).map_err(|error| error.in_file(&file))?;
        let names = record.outputs.iter().filter_map(|output| output.file.strip_suffix(CALIBRATION));
        let names: Vec<&str> = names.filter(|name| !name.contains('/')).collect();
        let fits = names.iter().map(|name| {
            let file = format!("{name}{CALIBRATION}");
            let mut fit = fit_result(&folder.join(&file), &record.written_text(folder, &file)?, registry)?;
            (*name).clone_into(&mut fit.name);
            let table = residuals_file(name);
            if let Some(output) = record.outputs.iter().find(|output| Path::new(&output.file) == table) {
                let text = record.written_text(folder, &output.file)?;
                fit.residuals = Residuals::from_csv(&text).map_err(|error| error.in_file(&folder.join(table)))?;
            }
            Ok(fit)
        });
        let fits: Vec<FitResult> = fits.collect::<Result<_>>()?;
        let verdicts = Verdict::list_from_json(&record.written_text(folder, VERDICTS)?)
            .map_err(|error| error.in_file(&folder.join(VERDICTS)))?;
        let title = if record.title.is_empty() { record.recipe.clone() } else { record.title.clone() };
        let recipe = recipe_of(&record);
        let trends = trends_in(folder, &record)?;
        let acceptance = acceptance_in(folder, &record, &verdicts)?;
        let fits = shown(fits);
        Ok(Self {
            name: record.recipe.clone(),
            title,
            fits,
            verdicts,
            trends,
            acceptance,
            record: Some(record),
            recipe,
        })
    }

    fn of_calibration(file: &Path, registry: &Registry) -> Result<Self> {
        let text = read_text(file, LARGEST_RESULT).map_err(|error| unreadable(file, &error))?;
        let fit = fit_result(file, &text, registry)?;
        let title = format!("Calibration {}", fit.name);
        let (name, fits) = (fit.name.clone(), vec![fit]);
        Ok(Self {
            name,
            title,
            fits,
            verdicts: Vec::new(),
            trends: Vec::new(),
            acceptance: Vec::new(),
            record: None,
            recipe: None,
        })
    }

    /// Calibrations and verdicts that were kept without the folder of their run.
    ///
    /// Fails where the plugin of a model is not known, or the model cannot be built.
    pub fn kept(
        title: &str,
        calibrations: Vec<Calibration>,
        verdicts: Vec<Verdict>,
        registry: &Registry,
    ) -> Result<Self> {
        let fits: Vec<FitResult> =
            calibrations.into_iter().map(|calibration| modelled(calibration, registry)).collect::<Result<_>>()?;
        Ok(Self {
            name: String::new(),
            title: title.to_owned(),
            fits: shown(fits),
            verdicts,
            trends: Vec::new(),
            acceptance: Vec::new(),
            record: None,
            recipe: None,
        })
    }

    /// The estimate of that name.
    pub fn fit(&self, name: &str) -> Option<&FitResult> {
        self.fits.iter().find(|fit| fit.name == name)
    }
}

/// The estimates that a page shows: of those of many groups the last one, which is how the machine is now.
fn shown(mut fits: Vec<FitResult>) -> Vec<FitResult> {
    let stage = |fit: &FitResult| fit.name.split('.').next().unwrap_or_default().to_owned();
    let time = |fit: &FitResult| fit.calibration.group.as_ref().map(|group| group.at);
    let all: Vec<(String, Option<f64>)> = fits.iter().map(|fit| (stage(fit), time(fit))).collect();
    let is_last = |fit: &FitResult| {
        let later = |(name, at): &(String, Option<f64>)| *name == stage(fit) && *at > time(fit);
        time(fit).is_none() || !all.iter().any(later)
    };
    fits.retain(|fit| is_last(fit));
    fits
}

/// The file in which `validate: trend` keeps all that it found.
const TREND: &str = "trend.json";

fn trends_of(outcome: &Outcome) -> Result<Vec<(String, Analysis, Vec<Quality>)>> {
    let is_trend =
        |stage: &str| outcome.verdicts.iter().any(|verdict| verdict.stage == stage && verdict.plugin == "trend");
    let files = outcome.exports.iter().filter(|(stage, _)| is_trend(stage));
    let files = files.flat_map(|(stage, files)| files.iter().map(move |file| (stage, file)));
    let found = files.filter(|(_, file)| file.name == TREND);
    let trend = |(stage, file): (&String, &ExportedFile)| {
        let (analysis, quality) = parsed(&String::from_utf8_lossy(&file.content))?;
        Ok((stage.clone(), analysis, quality))
    };
    found.map(trend).collect()
}

fn trends_in(folder: &Path, record: &RunRecord) -> Result<Vec<(String, Analysis, Vec<Quality>)>> {
    let stages = record.outputs.iter().filter_map(|output| output.file.strip_suffix(TREND)?.strip_suffix('/'));
    let read = |stage: &str| {
        let file = format!("{stage}/{TREND}");
        let text = record.written_text(folder, &file)?;
        let (analysis, quality) = parsed(&text).map_err(|error| error.in_file(&folder.join(&file)))?;
        Ok((stage.to_owned(), analysis, quality))
    };
    stages.map(read).collect()
}

fn acceptance_of(outcome: &Outcome) -> Vec<AcceptanceTable> {
    let plugin = |stage: &str| outcome.verdicts.iter().find(|verdict| verdict.stage == stage);
    let files = outcome.exports.iter().flat_map(|(stage, files)| files.iter().map(move |file| (stage, file)));
    let table = |(stage, file): (&String, &ExportedFile)| {
        let (kind, name) = AcceptanceTable::of_file(&plugin(stage)?.plugin, &file.name)?;
        let text = String::from_utf8_lossy(&file.content).into_owned();
        Some(AcceptanceTable { stage: stage.clone(), name, kind, text })
    };
    files.filter_map(table).collect()
}

fn acceptance_in(folder: &Path, record: &RunRecord, verdicts: &[Verdict]) -> Result<Vec<AcceptanceTable>> {
    let mut tables = Vec::new();
    for output in &record.outputs {
        let Some((stage, file)) = output.file.split_once('/') else { continue };
        let plugin = verdicts.iter().find(|verdict| verdict.stage == stage).map(|verdict| verdict.plugin.as_str());
        if let Some((kind, name)) = AcceptanceTable::of_file(plugin.unwrap_or_default(), file) {
            let text = record.written_text(folder, &output.file)?;
            tables.push(AcceptanceTable { stage: stage.to_owned(), name, kind, text });
        }
    }
    Ok(tables)
}

fn parsed(text: &str) -> Result<(Analysis, Vec<Quality>)> {
    let wrong = |error: serde_json::Error| Error::data(format!("this is no trend: {error}"));
    let found: serde_json::Value = serde_json::from_str(text).map_err(wrong)?;
    let analysis = serde_json::from_value(found["analysis"].clone()).map_err(wrong)?;
    Ok((analysis, serde_json::from_value(found["quality"].clone()).map_err(wrong)?))
}

fn unreadable(file: &Path, error: &std::io::Error) -> Error {
    let message = format!("the file cannot be read: {}", abbe_files::why(error));
    let error = if error.kind() == std::io::ErrorKind::NotFound { Error::usage(message) } else { Error::data(message) };
    error.in_file(file)
}

fn fit_result(file: &Path, text: &str, registry: &Registry) -> Result<FitResult> {
    let calibration = Calibration::from_json(text).map_err(|error| error.in_file(file))?;
    modelled(calibration, registry).map_err(|error| error.in_file(file))
}

/// A calibration with its machine.
fn modelled(calibration: Calibration, registry: &Registry) -> Result<FitResult> {
    let plugin = registry.find(Kind::Estimate, &calibration.model.plugin);
    let of_readings = plugin.is_ok_and(|plugin| plugin.estimate_source == EstimateSource::Readings);
    let model: Arc<dyn KinematicModel> = match of_readings {
        true => Arc::new(Quantities::of(&calibration)?),
        false => model_of(&calibration, registry)?,
    };
    let name = calibration.estimate.clone();
    Ok(FitResult::new(&name, calibration, model, Residuals::default()))
}

/// The recipe of a run, if its file is there and as it was.
fn recipe_of(record: &RunRecord) -> Option<String> {
    let recipe = record.inputs.first()?;
    let text = read_text(Path::new(&recipe.file), LARGEST_TEXT).ok()?;
    let digest: String = Sha256::digest(text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect();
    (digest == recipe.sha256).then_some(text)
}
