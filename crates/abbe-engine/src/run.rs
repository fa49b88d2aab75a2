//! Runs the graph: data sets, then estimates, validators and exporters.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Instant, SystemTime};

use abbe_core::{
    Class, DataRecord, Dataset, Error, EstimateSource, Event, Export, ExportedFile, Findings, Fit, Kind, Monitor,
    Problem, Result, Verdict, in_parallel,
};
use abbe_estimation::{copies, falling_times, remarks, remarks_of_chosen_rows, with_factors_found};
use abbe_recipe::Stage;

use crate::batches::{InBatches, Sources};
use crate::doubts::doubts;
use crate::evidence;
use crate::groups::{GroupProblem, is_of};
use crate::outcome::{Failure, Outcome};
use crate::plausibility::check_uncertainties;
use crate::prediction::{Predicted, prediction_fit};
use crate::prepare::Prepared;
use crate::problems::Taken;
use crate::readings::has_readings;
use crate::record::{FileRecord, Remark, Stamp, changed, input_records, sha256, stamp, unchanged};
use crate::saved::fit_without_rows;
use crate::statuses;
use crate::units::doubts as doubtful_units;

/// What is known before the first fit.
struct Known<'a> {
    problems: &'a BTreeMap<String, Problem>,
    batches: &'a InBatches<'a>,
    groups: &'a BTreeMap<String, Vec<GroupProblem>>,
    data: &'a Datasets,
    evidence: &'a BTreeMap<String, Vec<DataRecord>>,
    digests: &'a evidence::Digests,
}

/// Files by the stage that made them.
type Exports = Vec<(String, Vec<ExportedFile>)>;
pub(crate) type Datasets = BTreeMap<String, Arc<Dataset>>;

impl Prepared {
    /// Runs the recipe. `monitor` receives events and can cancel the run. Stages that do not depend on each other run at the
    /// same time.
    pub fn run(&self, monitor: &Monitor) -> Result<Outcome> {
        let (started, clock) = (SystemTime::now(), Instant::now());
        // Before a plugin may change the folder that relative paths start from.
        let places = self.files.iter().filter_map(|file| std::fs::canonicalize(file).ok());
        let seen: Vec<(PathBuf, Stamp)> = places.map(|file| (file.clone(), stamp(&file))).collect();
        let inputs = input_records(&self.files)?;
        let of_text = sha256(self.recipe.text.as_bytes());
        if self.is_of_its_file && inputs.first().is_some_and(|recipe| recipe.sha256 != of_text) {
            return Err(changed(&self.recipe.path));
        }
        self.same_content(&inputs).iter().for_each(|sentence| tracing::warn!("{sentence}"));
        // What is wrong with a file that has changed meanwhile is not wrong with the file that there was.
        let unless_changed = |error| unchanged(&seen, &inputs).err().unwrap_or(error);
        let sources = self.sources_read_once().map_err(unless_changed)?;
        let data = self.read_with(monitor, &sources).map_err(unless_changed)?;
        let inputs = self.with_given(inputs.clone(), &data)?;
        let mut taken = Taken::default();
        let problems = self.problems_of(&data, &mut taken, |stage| !self.has_batches(stage))?;
        let batches = InBatches::new(self, sources, &data, &inputs, monitor, &mut taken).map_err(unless_changed)?;
        let digests = digests(&inputs);
        let evidence = self.evidence(&problems, &batches, &data, &digests)?;
        let groups = self.group_problems(&data)?;
        let unseen = self.predicted(&problems, &batches, &data, &mut taken)?;
        let twice = self.repeated_evidence(&problems, &unseen, &data);
        twice
            .iter()
            .chain(&self.seen_before(&unseen, &evidence, &digests))
            .chain(&self.pasted(&problems, &unseen))
            .for_each(|sentence| tracing::warn!("{sentence}"));
        // Before the first fit, so that a feature that no artefact has is found before a long run.
        self.nothing_left_over(&data, &taken)?;
        self.rehearse(false, (&problems, &groups, &batches), &BTreeMap::new(), &unseen, &data)?;
        let mut failures = Vec::new();
        let known = Known {
            problems: &problems,
            batches: &batches,
            groups: &groups,
            data: &data,
            evidence: &evidence,
            digests: &digests,
        };
        let mut fits = self.estimates(&known, monitor, &mut failures)?;
        let implausible = self.implausible_by_chosen_rows(&mut fits, &batches, monitor)?;
        let from_rows = fits.iter().any(|fit| !fit.problem.sets.is_empty()) || self.has_readings(&fits);
        if let (false, Some(failure)) = (from_rows, failures.first()) {
            // Nothing was made of measurements: an earlier run keeps its results.
            return Err(unless_changed(failure.error.clone()));
        }
        let (verdicts, mut exports) = self.verdicts(&fits, &unseen, (&data, &batches), monitor, &mut failures)?;
        let fits = batches.without_rows(&fits.iter().collect::<Vec<_>>())?;
        let (fits, shown) = with_rows_to_show(fits, &batches, monitor)?;
        exports.extend(self.exports(&fits, monitor, &mut failures)?);
        // What needs them has been made all the same.
        failures.extend(implausible);
        let told = |&(name, problem): &(&String, &Problem)| {
            let fit = fits.iter().find(|fit| fit.name == *name);
            let estimate = fit.map(|fit| problem.values_of(&fit.calibration));
            let compared =
                self.recipe_stage(name).map(|stage| self.comparisons(stage, (problem, estimate.as_deref()), &data));
            let compared = compared.unwrap_or_default();
            ([remarks(problem), copies(problem)].concat(), compared)
        };
        let is_there = |name: &String| fits.iter().any(|fit| fit.name == *name);
        let with_rows: Vec<_> =
            problems.iter().filter(|(name, problem)| is_there(name) && !problem.sets.is_empty()).collect();
        let told = in_parallel(&with_rows, None, told);
        let of_fits = with_rows.into_iter().zip(told).flat_map(|((name, _), (own, compared))| {
            compared.iter().for_each(|remark| tracing::warn!("{name}: {remark}"));
            let texts = own.into_iter().chain(compared);
            texts.map(|text| Remark { estimate: name.clone(), text }).collect::<Vec<_>>()
        });
        let of_groups = self.copied_groups(&fits, &problems);
        of_groups.iter().for_each(|remark| tracing::warn!("{}: {}", remark.estimate, remark.text));
        let doubts = doubts(&fits);
        let remarks = of_fits.chain(of_groups).chain(shown).chain(doubts.iter().cloned()).collect();
        unchanged(&seen, &inputs)?;
        Ok(Outcome {
            recipe: self.recipe.id.clone(),
            title: self.recipe.name.clone(),
            remarks,
            doubts,
            attached: Vec::new(),
            fits,
            verdicts,
            exports,
            failures,
            inputs,
            input_files: seen.into_iter().map(|(file, _)| file).collect(),
            plugins: self.plugins.clone(),
            started,
            duration: clock.elapsed(),
        })
    }

    /// The estimates from measurements with errors that are implausible ([`implausible`](Self::implausible)). Of rows that are read in
    /// batches some are chosen at random: they tell how far axes travel.
    fn implausible_by_chosen_rows(
        &self,
        fits: &mut [Fit],
        batches: &InBatches<'_>,
        monitor: &Monitor,
    ) -> Result<Vec<Failure>> {
        let whole: Vec<Arc<Problem>> = fits.iter().map(|fit| fit.problem.clone()).collect();
        for fit in &mut *fits {
            if let Some((problem, _)) = chosen_rows(fit, batches, monitor)? {
                fit.problem = Arc::new(problem);
            }
        }
        let failures = self.implausible(fits);
        fits.iter_mut().zip(whole).for_each(|(fit, whole)| fit.problem = whole);
        failures
    }

    /// All estimates, each as soon as those are there that it needs. One that fails costs those alone that need it.
    fn estimates(&self, known: &Known<'_>, monitor: &Monitor, failures: &mut Vec<Failure>) -> Result<Vec<Fit>> {
        let mut fits: Vec<Fit> = Vec::new();
        let mut waiting: Vec<&Stage> = self.stages(Kind::Estimate).collect();
        while !waiting.is_empty() {
            let needs = |stage: &Stage| -> Vec<String> {
                ["start", "known", "of"].iter().flat_map(|key| stage.reference(key).to_vec()).collect()
            };
            waiting.retain(|stage| match failed(&needs(stage), failures) {
                Some(failure) => {
                    failures.push(failure(stage));
                    false
                }
                None => true,
            });
            let done = |name: &String| fits.iter().any(|fit| is_of(fit, name));
            let ready: Vec<&Stage> = waiting.iter().copied().filter(|stage| needs(stage).iter().all(done)).collect();
            waiting.retain(|stage| !ready.iter().any(|ready| ready.name == stage.name));
            let done = in_parallel(&ready, None, |stage| {
                self.started(stage, monitor)?;
                if let Some(groups) = known.groups.get(&stage.name) {
                    return Ok(self.fit_groups(stage, groups, known.digests, monitor));
                }
                let problem =
                    known.problems.get(&stage.name).map(|problem| problem.watched_by(monitor.of_stage(&stage.name)));
                let mut fit = match known.batches.fit(stage, monitor)? {
                    Some(fit) => fit,
                    None if has_readings(stage) => {
                        let mut fit = self.of_readings(stage, known.data, known.batches)?;
                        fit.calibration.data = match self.has_passes(stage) {
                            true => known.batches.rows_read(stage, known.data, known.digests)?,
                            false => known.evidence[&stage.name].clone(),
                        };
                        return Ok(vec![Ok(fit)]);
                    }
                    None => self.estimate(stage, problem.as_ref(), (&fits, known.batches), monitor)?,
                };
                fit.calibration.data.clone_from(&known.evidence[&stage.name]);
                Ok(vec![Ok(fit)])
            });
            for (stage, result) in ready.into_iter().zip(done) {
                for fit in unless_failed(stage, result, failures)?.unwrap_or_default() {
                    match fit {
                        Ok(fit) => fits.push(fit),
                        Err(failure) if failure.error.class == Class::Interrupted => return Err(failure.error),
                        Err(failure) => failures.push(failure),
                    }
                }
                if !fits.iter().any(|fit| is_of(fit, &stage.name)) && known.groups.contains_key(&stage.name) {
                    failures.push(Failure::own(stage, Error::data("no group of rows gives an estimate")));
                }
            }
        }
        Ok(fits)
    }

    /// The verdicts, and the tables that go with them.
    fn verdicts(
        &self,
        fits: &[Fit],
        unseen: &Predicted,
        (data, batches): (&Datasets, &InBatches<'_>),
        monitor: &Monitor,
        failures: &mut Vec<Failure>,
    ) -> Result<(Vec<Verdict>, Exports)> {
        let mut stages: Vec<&Stage> = self.stages(Kind::Validate).collect();
        stages.retain(|stage| match failed(stage.reference("of"), failures) {
            Some(failure) => {
                failures.push(failure(stage));
                false
            }
            None => true,
        });
        let judged = in_parallel(&stages, None, |stage| {
            self.started(stage, monitor)?;
            let watched: Vec<Fit> = (named(stage.reference("of"), fits).into_iter())
                .map(|fit| watched(fit, monitor.of_stage(&stage.name)))
                .collect();
            let fits: Vec<&Fit> = watched.iter().collect();
            let judged = self.validators[&stage.name].as_ref();
            let others = fits.iter().filter_map(|fit| {
                let problem = unseen.get(&(stage.name.as_str(), fit.name.as_str()))?;
                Some(self.located(stage, prediction_fit(fit, problem, judged)))
            });
            let others = others.collect::<Result<Vec<Fit>>>()?;
            let said = match others.as_slice() {
                [] if judged.accepts_rows_in_parts() && fits.iter().any(|fit| batches.has(&fit.name)) => {
                    self.said_of_parts(stage, &fits, data, batches)
                }
                [] => {
                    let fits = batches.without_rows(&fits)?;
                    self.said_of(stage, &fits.iter().collect::<Vec<_>>(), data, batches)
                }
                others => self.said_of(stage, &others.iter().collect::<Vec<_>>(), data, batches),
            };
            let mut findings = self.located(stage, said)?;
            let tables = std::mem::take(&mut findings.tables);
            let files = tables.into_iter().map(|(name, text)| ExportedFile { name, content: text.into_bytes() });
            Ok((Verdict::new(&stage.name, &stage.plugin, findings), (stage.name.clone(), files.collect())))
        });
        let mut found: Vec<(Verdict, (String, Vec<ExportedFile>))> = Vec::new();
        for (stage, result) in stages.into_iter().zip(judged) {
            found.extend(unless_failed(stage, result, failures)?);
        }
        let (verdicts, mut exports): (Vec<Verdict>, Exports) = found.into_iter().unzip();
        exports.retain(|(_, files)| !files.is_empty());
        Ok((verdicts, exports))
    }

    /// What a validator says, with the exporters that it judges.
    pub(crate) fn findings(&self, stage: &Stage, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        let validator = &self.validators[&stage.name];
        let exports: Vec<(&str, &dyn Export)> =
            (stage.reference("exports").iter()).map(|name| (name.as_str(), self.exporters[name].as_ref())).collect();
        match exports.is_empty() {
            true => validator.validate(fits, data),
            false => validator.validate_exports(fits, data, &exports),
        }
    }

    /// The files of all exporters. An exporter of several estimates writes those of the ones that are there.
    fn exports(&self, fits: &[Fit], monitor: &Monitor, failures: &mut Vec<Failure>) -> Result<Exports> {
        let mut exports = Vec::new();
        for stage in self.stages(Kind::Export) {
            if unless_failed(stage, self.started(stage, monitor), failures)?.is_none() {
                continue;
            }
            if let Some(failure) = failed(stage.reference("of"), failures) {
                failures.push(failure(stage));
            }
            for fit in named(stage.reference("of"), fits) {
                let exporter = &self.exporters[&stage.name];
                let files = self.located(stage, exporter.export_fit(fit));
                exports.extend(unless_failed(stage, files, failures)?.map(|files| (stage.name.clone(), files)));
            }
        }
        Ok(exports)
    }

    /// The result of an estimate stage; `fits` has all that it refers to.
    fn estimate(
        &self,
        stage: &Stage,
        problem: Option<&Problem>,
        (fits, batches): (&[Fit], &InBatches<'_>),
        monitor: &Monitor,
    ) -> Result<Fit> {
        let Some(problem) = problem else { return self.fit_again(stage, (fits, batches), monitor) };
        let estimator = self.estimators[&stage.name].clone();
        let calibration = match stage.estimate_source {
            EstimateSource::Measurements | EstimateSource::Analysis | EstimateSource::Readings => {
                let mut fit = self.fit(stage, self.located(stage, start(stage, problem.clone(), fits))?)?;
                for known in named(stage.reference("known"), fits) {
                    fit.calibration.keep_limits_of_known(&known.calibration);
                    statuses::join(&mut fit.calibration.fit.statuses, &known.calibration.fit.statuses);
                }
                return Ok(fit);
            }
            EstimateSource::Calibration => Ok(self.saved[&stage.name].calibration.clone()),
            EstimateSource::Statement => estimator.explain(problem),
            EstimateSource::Combination => {
                let of = named(stage.reference("of"), fits);
                estimator.combine(problem, &of).map(|combined| statuses::with_those_of(combined, &of))
            }
        };
        let fit = |calibration| fit_without_rows(calibration, problem.model.clone(), estimator);
        self.located(stage, calibration.and_then(fit))
    }

    pub(crate) fn fit(&self, stage: &Stage, problem: Problem) -> Result<Fit> {
        remarks(&problem).iter().chain(&copies(&problem)).for_each(|remark| tracing::warn!("{}: {remark}", stage.name));
        self.fit_untold(stage, problem)
    }

    /// The same without remarks on the problem.
    pub(crate) fn fit_untold(&self, stage: &Stage, problem: Problem) -> Result<Fit> {
        let estimator = self.estimators[&stage.name].clone();
        tracing::info!("{}: {} equations, {} unknowns", stage.name, problem.equations(), problem.unknowns.len());
        let explained = estimator.explain(&problem).map_err(|error| self.with_mistakes(stage, &problem, error));
        let mut calibration = self.located(stage, explained)?;
        calibration.fit.statuses = statuses::of_problem(&problem);
        self.located(stage, check_uncertainties(&calibration))?;
        // Later users of the problem get the rows with the uncertainties that the fit used.
        let problem = with_factors_found(&problem, &calibration.fit.variance);
        Ok(Fit { name: stage.name.clone(), problem: Arc::new(problem), estimator, calibration })
    }

    /// The analysis of an earlier estimate, with its problem and its estimator.
    fn fit_again(&self, stage: &Stage, (fits, batches): (&[Fit], &InBatches<'_>), monitor: &Monitor) -> Result<Fit> {
        let of = named(stage.reference("of"), fits);
        let fit = of.first().ok_or_else(|| Error::usage("the estimate under `of` is not there").stage(&stage.name))?;
        self.located(stage, self.check_plausible(fit))?;
        let (monitor, estimator) = (monitor.of_stage(&stage.name), &self.estimators[&stage.name]);
        let analysed = match batches.parts(fit, &monitor)? {
            Some(parts) => estimator.analyse_parts(&watched(fit, monitor), parts.as_ref()),
            None => estimator.analyse(&watched(fit, monitor)),
        };
        let mut calibration = self.located(stage, analysed)?;
        calibration.estimate = stage.name.clone();
        calibration.fit.statuses.clone_from(&fit.calibration.fit.statuses);
        let (problem, estimator) = (fit.problem.clone(), fit.estimator.clone());
        Ok(Fit { name: stage.name.clone(), problem, estimator, calibration })
    }

    /// Adds the name and the place of a stage to its errors.
    pub(crate) fn located<T>(&self, stage: &Stage, result: Result<T>) -> Result<T> {
        result.map_err(|error| self.recipe.locate(error.stage(&stage.name)))
    }

    /// Reports that a stage starts. Fails if the run has been cancelled.
    fn started(&self, stage: &Stage, monitor: &Monitor) -> Result<()> {
        let works = |stage: &&Stage| !matches!(stage.kind, Kind::Artefact | Kind::Model);
        let working: Vec<&Stage> = self.recipe.stages.iter().filter(works).collect();
        let done = working.iter().position(|other| other.name == stage.name).unwrap_or(0);
        let kind = stage.kind.key();
        monitor.report(&Event::Started { stage: &stage.name, kind, done, all: working.len() });
        monitor.check().map_err(|error| error.stage(&stage.name))
    }

    /// The data sets of all ingest stages; `made` replaces the data of one of them.
    pub(crate) fn read(&self, monitor: &Monitor, made: Option<(&str, &Arc<Dataset>)>) -> Result<Datasets> {
        self.read_by(monitor, |stage| match made.filter(|(ingest, _)| *ingest == stage.name) {
            Some((_, made)) => Ok(made.clone()),
            None => self.ingests[&stage.name].read().map(Arc::new),
        })
    }

    /// The same; of what is read in batches the first batch alone.
    pub(crate) fn read_with(&self, monitor: &Monitor, sources: &Sources<'_>) -> Result<Datasets> {
        self.read_by(monitor, |stage| match sources.get(&stage.name) {
            Some(source) => source.read(0).map(|batch| Arc::new(batch.data)),
            None => self.ingests[&stage.name].read().map(Arc::new),
        })
    }

    fn read_by(&self, monitor: &Monitor, read: impl Fn(&Stage) -> Result<Arc<Dataset>>) -> Result<Datasets> {
        let mut data = BTreeMap::new();
        for stage in self.stages(Kind::Ingest) {
            self.started(stage, monitor)?;
            let read = self.located(stage, read(stage))?;
            doubtful_units(&read).iter().for_each(|told| tracing::warn!("{}: {told}", stage.name));
            // Rows that an artefact takes are told of with its estimate.
            if !self.stages(Kind::Artefact).any(|artefact| artefact.reference("from").contains(&stage.name)) {
                let told = falling_times(&read, read.row_indices());
                told.iter().for_each(|told| tracing::warn!("{}: {told}", stage.name));
            }
            data.insert(stage.name.clone(), read);
        }
        Ok(data)
    }
}

/// Whether an estimate has its own problem and is not an analysis of another estimate.
pub(crate) fn has_problem(stage: &&Stage) -> bool {
    !has_readings(stage) && (!stage.estimate_source.may_analyse() || stage.reference("of").is_empty())
}

/// Whether an estimate has its own observations.
pub(crate) fn has_rows(stage: &&Stage) -> bool {
    !stage.reference("observations").is_empty()
}

/// What a stage found; none if it failed, which is noted. An interruption ends the run.
fn unless_failed<T>(stage: &Stage, result: Result<T>, failures: &mut Vec<Failure>) -> Result<Option<T>> {
    match result {
        Ok(found) => Ok(Some(found)),
        Err(error) if error.class == Class::Interrupted => Err(error),
        Err(error) => {
            failures.push(Failure::own(stage, error));
            Ok(None)
        }
    }
}

/// How a stage fails that needs these, if one of them failed.
fn failed(needed: &[String], failures: &[Failure]) -> Option<impl Fn(&Stage) -> Failure + use<>> {
    let failed = needed.iter().find(|name| failures.iter().any(|failure| failure.stage == **name))?.clone();
    Some(move |stage: &Stage| Failure::of_needed(stage, &failed))
}

/// Estimates whose rows are read in batches, with some rows that tables of residuals and charts can show; and what to say of these.
fn with_rows_to_show(
    mut fits: Vec<Fit>,
    batches: &InBatches<'_>,
    monitor: &Monitor,
) -> Result<(Vec<Fit>, Vec<Remark>)> {
    let mut all = Vec::new();
    for fit in &mut fits {
        if let Some((problem, remarks)) = chosen_rows(fit, batches, monitor)? {
            let told = remarks_of_chosen_rows(&problem);
            told.iter().for_each(|remark| tracing::warn!("{}: {remark}", fit.name));
            all.extend(told.into_iter().map(|text| Remark { estimate: fit.name.clone(), text }));
            all.extend(remarks);
            fit.problem = Arc::new(problem);
        }
    }
    Ok((fits, all))
}

/// Rows of an estimate in batches that are chosen at random, and what to say of them; none where they cannot be read any more.
fn chosen_rows(fit: &Fit, batches: &InBatches<'_>, monitor: &Monitor) -> Result<Option<(Problem, Vec<Remark>)>> {
    match batches.sampled(fit, monitor) {
        Err(error) if error.class == Class::Interrupted => Err(error),
        Err(error) => {
            tracing::warn!(
                "{}: its rows cannot be read again, so that no errors are held against their travel, and there is no table of residuals: {error}",
                fit.name
            );
            Ok(None)
        }
        chosen => chosen,
    }
}

/// The digests of input files.
pub(crate) fn digests(inputs: &[FileRecord]) -> evidence::Digests {
    inputs.iter().map(|input| (input.file.clone(), input.sha256.clone())).collect()
}

/// The problem with the results of earlier estimates: start values, or known values with their covariance.
fn start(stage: &Stage, problem: Problem, fits: &[Fit]) -> Result<Problem> {
    let known = named(stage.reference("known"), fits);
    let problem = known.iter().try_fold(problem, |problem, fit| problem.with_prior(&fit.calibration))?;
    let start = named(stage.reference("start"), fits);
    Ok(start.iter().fold(problem, |problem, fit| problem.with_values(&problem.values_of(&fit.calibration))))
}

pub(crate) fn named<'a>(names: &[String], fits: &'a [Fit]) -> Vec<&'a Fit> {
    names.iter().flat_map(|name| fits.iter().filter(move |fit| is_of(fit, name))).collect()
}

/// The same fit; `monitor` observes the work on its problem.
fn watched(fit: &Fit, monitor: Monitor) -> Fit {
    Fit {
        name: fit.name.clone(),
        problem: Arc::new(fit.problem.watched_by(monitor)),
        estimator: fit.estimator.clone(),
        calibration: fit.calibration.clone(),
    }
}
