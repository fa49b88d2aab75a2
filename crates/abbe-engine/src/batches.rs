//! Estimates from data sets that are read in batches: a run holds one batch for each of its threads, and what least squares need of all
//! rows.
//!
//! The rows are read again each time that the estimator asks something of them. What batches answer is added up in their order,
//! whichever thread was first: so results do not depend on the number of threads.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use abbe_core::{
    AskedOfPart, Batches, Class, DataRecord, Dataset, Error, Fit, Identifiability, Kind, KinematicModel, Monitor,
    PartEvidence, Parts, Problem, QuestionToRows, Result, VarianceFactor, WeighedSums, free_threads,
};
use abbe_estimation::{joined_evidence, missed, part_evidence, remarks_of_chosen_rows, with_factors_found};
use abbe_recipe::Stage;

use crate::in_order::in_order;
use crate::parts::{Part, Rows};
use crate::passes::{Seen, no_rows, tell_left_out};
use crate::plausibility::check_uncertainties;
use crate::prepare::Prepared;
use crate::problems::Taken;
use crate::record::{FileRecord, Remark};
use crate::run::Datasets;
use crate::saved::fit_without_rows;
use crate::statuses;

/// The data sets that are read in batches, by their ingest stages.
pub(crate) type Sources<'a> = BTreeMap<String, Box<dyn Batches + 'a>>;

/// The estimates of a recipe whose rows are read in batches, after the first pass over the rows. That pass reads them, and evaluates
/// nothing.
pub(crate) struct InBatches<'a> {
    pub(crate) prepared: &'a Prepared,
    sources: Sources<'a>,
    /// The other data sets, and the first batch of those that are read in batches.
    pub(crate) data: Datasets,
    /// Rows of the data sets that are read in batches.
    rows: BTreeMap<String, usize>,
    estimates: BTreeMap<String, Known>,
    /// What is said of estimates whose outliers are not all listed.
    unlisted: Mutex<BTreeMap<String, Remark>>,
    /// Rows that were chosen at random of a data set.
    pub(crate) chosen: Mutex<BTreeMap<String, Arc<Dataset>>>,
    /// The rows of data sets that stages have looked at in passes.
    pub(crate) seen: Mutex<BTreeMap<String, Seen>>,
    pub(crate) monitor: Monitor,
}

/// What is known of an estimate after the first pass.
struct Known {
    /// The unknowns of all batches, and no rows.
    problem: Problem,
    /// What all batches are together.
    part: Part,
    /// What they tell at the start, once that was asked.
    at_start: OnceLock<Arc<PartEvidence>>,
}

/// What a batch gives in the first pass.
#[derive(Default)]
struct First {
    /// By the estimates.
    parts: BTreeMap<String, Part>,
    /// Rows of data sets that are held.
    taken: Taken,
    /// Its rows, and how many rows are left out because a number was not measured.
    rows: [usize; 2],
}

impl First {
    fn join(&mut self, other: Self) -> Result<()> {
        for (estimate, part) in other.parts {
            match self.parts.get_mut(&estimate) {
                Some(known) => known.join(&part).map_err(|error| error.stage(&estimate))?,
                None => drop(self.parts.insert(estimate, part)),
            }
        }
        for (ingest, rows) in other.taken {
            self.taken.entry(ingest).or_default().extend(rows);
        }
        self.rows.iter_mut().zip(other.rows).for_each(|(all, own)| *all += own);
        Ok(())
    }
}

impl Prepared {
    /// Looks through the data sets that are read in batches.
    pub(crate) fn sources(&self) -> Result<Sources<'_>> {
        let stages = self.stages(Kind::Ingest).filter(|stage| self.is_in_batches(&stage.name));
        let source =
            |stage: &Stage| Ok((stage.name.clone(), self.located(stage, self.ingests[&stage.name].batches())?));
        stages.map(source).collect()
    }

    /// Whether a data set is read in batches.
    pub(crate) fn is_in_batches(&self, ingest: &str) -> bool {
        self.ingests.get(ingest).is_some_and(|built| built.batch_rows().is_some())
    }

    /// The data sets of an estimate that are read in batches, in the order in which it observes them.
    pub(crate) fn batched_of(&self, stage: &Stage) -> Result<Vec<String>> {
        let mut batched: Vec<String> = Vec::new();
        if stage.kind == Kind::Estimate {
            for name in stage.reference("observations") {
                let (ingest, _) = self.artefact(name)?;
                if self.is_in_batches(ingest) && !batched.iter().any(|known| known == ingest) {
                    batched.push(ingest.to_owned());
                }
            }
        }
        Ok(batched)
    }

    /// Whether an estimate reads rows in batches.
    pub(crate) fn has_batches(&self, stage: &Stage) -> bool {
        self.batched_of(stage).is_ok_and(|batched| !batched.is_empty())
    }
}

impl<'a> InBatches<'a> {
    /// The first pass over all rows: what estimates are of. `data` has the data sets that are
    /// held, and the first batch of the others; `taken` gets the rows that artefacts take of those that are held.
    pub fn new(
        prepared: &'a Prepared,
        sources: Sources<'a>,
        data: &Datasets,
        inputs: &[FileRecord],
        monitor: &Monitor,
        taken: &mut Taken,
    ) -> Result<Self> {
        let (rows, estimates, unlisted, chosen, seen) = Default::default();
        let mut batches = Self {
            prepared,
            sources,
            data: data.clone(),
            rows,
            estimates,
            unlisted,
            chosen,
            seen,
            monitor: monitor.clone(),
        };
        let (mut all, mut rows) = (First::default(), BTreeMap::new());
        for ingest in batches.sources.keys().filter(|ingest| !prepared.is_only_looked_at(ingest)) {
            let first = batches.first_pass(ingest, inputs, monitor)?;
            rows.insert(ingest.clone(), first.rows[0]);
            all.join(first)?;
        }
        batches.rows = rows;
        for (ingest, rows) in std::mem::take(&mut all.taken) {
            taken.entry(ingest).or_default().extend(rows);
        }
        let stages: Vec<&Stage> = prepared.stages(Kind::Estimate).filter(|stage| prepared.has_batches(stage)).collect();
        for stage in stages {
            let known = prepared.located(stage, batches.known(stage, all.parts.remove(&stage.name)))?;
            batches.estimates.insert(stage.name.clone(), known);
        }
        Ok(batches)
    }

    /// The problem of an estimate without its rows.
    pub fn problem(&self, estimate: &str) -> Option<&Problem> {
        Some(&self.estimates.get(estimate)?.problem)
    }

    /// The rows that an estimate is made of.
    pub fn rows(&self, estimate: &str) -> &[DataRecord] {
        self.estimates.get(estimate).map_or(&[], |known| &known.part.data)
    }

    /// The estimate of a stage, if its rows are read in batches. Its problem has no rows.
    pub fn fit(&self, stage: &Stage, monitor: &Monitor) -> Result<Option<Fit>> {
        let Some(known) = self.estimates.get(&stage.name) else { return Ok(None) };
        let monitor = monitor.of_stage(&stage.name);
        let problem = known.problem.watched_by(monitor.clone());
        let estimator = self.prepared.estimators[&stage.name].clone();
        tracing::info!("{}: rows in batches, {} unknowns", stage.name, problem.unknowns.len());
        let parts = AllBatches { batches: self, stage, known, monitor, factors: None };
        let found = estimator.estimate_parts(&problem, &parts).inspect_err(|error| tell_missed(&parts, error));
        let mut calibration = self.prepared.located(stage, found)?;
        statuses::join(&mut calibration.fit.statuses, &known.part.statuses);
        self.prepared.located(stage, check_uncertainties(&calibration))?;
        Ok(Some(Fit { name: stage.name.clone(), problem: Arc::new(problem), estimator, calibration }))
    }

    /// What is to be said of an estimate because not all its outliers are listed.
    pub fn unlisted(&self, estimate: &str) -> Option<Remark> {
        self.unlisted.lock().unwrap_or_else(PoisonError::into_inner).get(estimate).cloned()
    }

    fn keep_unlisted(&self, estimate: &str, remark: Option<Remark>) {
        let mut known = self.unlisted.lock().unwrap_or_else(PoisonError::into_inner);
        known.extend(remark.map(|remark| (estimate.to_owned(), remark)));
    }

    /// Estimates as those use them who look at no rows: those of batches bring none.
    pub fn without_rows(&self, fits: &[&Fit]) -> Result<Vec<Fit>> {
        let without = |fit: &&Fit| {
            let Fit { name, problem, estimator, calibration } = *fit;
            let (problem, estimator, calibration) = (problem.clone(), estimator.clone(), calibration.clone());
            match self.has(name) {
                true => fit_without_rows(calibration, problem.model.clone(), estimator),
                false => Ok(Fit { name: name.clone(), problem, estimator, calibration }),
            }
        };
        fits.iter().map(without).collect()
    }

    /// Whether the rows of an estimate, or of the one that it analyses, are read in batches.
    pub fn has(&self, estimate: &str) -> bool {
        self.prepared.own_estimate(estimate).is_ok_and(|own| self.estimates.contains_key(&own.name))
    }

    /// The rows of an estimate for those who repeat it, with the uncertainties that it used, if they are read in batches; `monitor` observes
    /// this work.
    pub fn parts<'b>(&'b self, fit: &'b Fit, monitor: &Monitor) -> Result<Option<Box<dyn Parts + 'b>>> {
        let own = self.prepared.own_estimate(&fit.name)?;
        let Some(known) = self.estimates.get(&own.name) else { return Ok(None) };
        let monitor = monitor.without_events();
        let factors = Some(fit.calibration.fit.variance.as_slice());
        Ok(Some(Box::new(AllBatches { batches: self, stage: own, known, monitor, factors })))
    }

    /// What the rows of an estimate determine, if they are read in batches.
    pub fn identify(&self, stage: &Stage, monitor: &Monitor) -> Result<Option<Identifiability>> {
        let Some(known) = self.estimates.get(&stage.name) else { return Ok(None) };
        let monitor = monitor.of_stage(&stage.name);
        let parts = AllBatches { batches: self, stage, known, monitor, factors: None };
        let found = self.prepared.estimators[&stage.name].identify_parts(&known.problem, &parts);
        let mut found = self.prepared.located(stage, found)?;
        let chosen = self.prepared.located(stage, parts.sample())?;
        found.remarks.extend(chosen.iter().flat_map(remarks_of_chosen_rows));
        Ok(Some(found))
    }

    /// What all batches of a data set are, for all estimates that observe it.
    fn first_pass(&self, ingest: &str, inputs: &[FileRecord], monitor: &Monitor) -> Result<First> {
        let stage = self.prepared.recipe_stage(ingest)?;
        let mut estimates = Vec::new();
        for estimate in self.prepared.stages(Kind::Estimate) {
            let batched = self.prepared.batched_of(estimate)?;
            if batched.iter().any(|own| own == ingest) {
                estimates.push((estimate, batched[0] == ingest));
            }
        }
        let monitor = &monitor.of_stage(ingest);
        let all: Vec<usize> = (0..self.count(ingest)).collect();
        let first = |batch: &usize| self.first(ingest, *batch, &estimates, inputs, monitor);
        let told = |done: usize| monitor.parts_done("batches", done, Some(all.len()));
        let found = in_order(&all, free_threads(), first, First::join, told);
        let first = self.prepared.located(stage, found)?.unwrap_or_default();
        let [rows, left_out] = first.rows;
        tell_left_out(ingest, left_out);
        match rows {
            0 => self.prepared.located(stage, Err(no_rows())),
            _ => Ok(first),
        }
    }

    /// What one batch is. Estimates whose first data set this is have the rows that are held with the first batch.
    fn first(
        &self,
        ingest: &str,
        batch: usize,
        estimates: &[(&Stage, bool)],
        inputs: &[FileRecord],
        monitor: &Monitor,
    ) -> Result<First> {
        monitor.check()?;
        let (data, left_out) = self.with_batch(ingest, batch)?;
        let mut first = First { rows: [data[ingest].rows(), left_out], ..First::default() };
        let mut taken = Taken::default();
        for (stage, is_first) in estimates {
            let with_others = *is_first && batch == 0;
            if data[ingest].rows() == 0 && !with_others {
                continue;
            }
            let mut part = || {
                let model = self.prepared.machine_of(stage, &data, false)?;
                let problem = self.problem_of(stage, ingest, with_others, model, &data, Some(&mut taken))?;
                Ok(Part::unasked(&problem, inputs))
            };
            first.parts.insert(stage.name.clone(), self.prepared.located(stage, part())?);
        }
        let of_batch = taken.remove(ingest).map(|rows| (ingest.to_owned(), rows));
        self.prepared.nothing_left_over(&data, &of_batch.into_iter().collect())?;
        first.taken = taken;
        Ok(first)
    }

    /// What is known of an estimate after the first pass.
    fn known(&self, stage: &Stage, part: Option<Part>) -> Result<Known> {
        let part = part.ok_or_else(|| Error::data("there are no rows"))?;
        let model = self.prepared.built_machine(stage, &self.data)?;
        let part = Arc::new(part);
        let problem = self.prepared.problem_of_parts(stage, model, std::slice::from_ref(&part))?;
        self.prepared.plausible[&stage.name].check_names(&problem)?;
        Ok(Known { problem, part: Arc::unwrap_or_clone(part), at_start: OnceLock::new() })
    }

    /// How many rows a data set has that is read in batches.
    pub(crate) fn rows_of(&self, ingest: &str) -> usize {
        self.rows.get(ingest).copied().unwrap_or(0)
    }

    pub(crate) fn count(&self, ingest: &str) -> usize {
        self.sources.get(ingest).map_or(0, |source| source.count())
    }

    /// The batches of a data set.
    pub(crate) fn source(&self, ingest: &str) -> Result<&dyn Batches> {
        let source = self.sources.get(ingest).map(AsRef::as_ref);
        source.ok_or_else(|| Error::data("it is not read in batches").stage(ingest))
    }

    /// The data sets with one batch of one of them, and the rows that are left out of it because a number was not measured.
    pub(crate) fn with_batch(&self, ingest: &str, batch: usize) -> Result<(Datasets, usize)> {
        let stage = self.prepared.recipe_stage(ingest)?;
        let read = self.prepared.located(stage, self.source(ingest)?.read(batch))?;
        let mut data = self.data.clone();
        data.insert(ingest.to_owned(), Arc::new(read.data));
        Ok((data, read.left_out))
    }

    /// The problem of an estimate on one batch, with the rows that are held or without them.
    fn problem_of(
        &self,
        stage: &Stage,
        ingest: &str,
        with_others: bool,
        model: Arc<dyn KinematicModel>,
        data: &Datasets,
        taken: Option<&mut Taken>,
    ) -> Result<Problem> {
        let observed = self.prepared.observed(stage, |other| match other == ingest {
            true => Some(Rows::Some),
            false => (with_others && !self.prepared.is_in_batches(other)).then_some(Rows::All),
        })?;
        self.prepared.part_problem(stage, model, &observed, data, taken)
    }
}

/// Says of an estimate that fails whether its machine is far from contact, by rows that are chosen at random: a wrong machine file may look
/// like unknowns that the data do not determine.
fn tell_missed(rows: &AllBatches<'_>, error: &Error) {
    if error.class != Class::Data || error.fatal {
        return;
    }
    let remarks = rows.sample().ok().flatten().map_or_else(Vec::new, |problem| missed(&problem));
    remarks.iter().for_each(|remark| tracing::warn!("{}: {remark}", rows.stage.name));
}

/// What is to be said where more outliers were found than are listed.
fn unlisted(estimate: &str, sums: &WeighedSums) -> Option<Remark> {
    let (listed, all) = (sums.outliers.len(), sums.found);
    let text = format!("there are {all} outliers; the {listed} with the largest residuals are listed");
    (all > listed).then(|| Remark { estimate: estimate.to_owned(), text })
}

/// All batches of an estimate, as one part of its rows.
struct AllBatches<'a> {
    batches: &'a InBatches<'a>,
    stage: &'a Stage,
    known: &'a Known,
    monitor: Monitor,
    /// For those who repeat an estimate, the factors that it has found on the uncertainties of rows; none where the estimate itself asks.
    factors: Option<&'a [VarianceFactor]>,
}

impl Parts for AllBatches<'_> {
    fn count(&self) -> usize {
        1
    }

    fn evidence(&self, _: usize, asked: AskedOfPart, at: &BTreeMap<String, f64>) -> Result<Arc<PartEvidence>> {
        // With other uncertainties they tell something else.
        let kept = Some(&self.known.at_start).filter(|_| asked == AskedOfPart::Start && self.factors().is_empty());
        if let Some(told) = kept.and_then(OnceLock::get) {
            return Ok(told.clone());
        }
        let found = self.ask(&|_, problem| part_evidence(problem, asked, &problem.values_at(at)))?;
        let found = found.map(Arc::new).ok_or_else(|| Error::data("there are no rows"))?;
        Ok(kept.map_or_else(|| found.clone(), |kept| kept.get_or_init(|| found.clone()).clone()))
    }

    fn ask(&self, question: &QuestionToRows<'_>) -> Result<Option<PartEvidence>> {
        let batched = self.batches.prepared.batched_of(self.stage)?;
        let batches = batched.iter().flat_map(|ingest| {
            let all = 0..self.batches.count(ingest);
            all.map(move |batch| (ingest.as_str(), batch))
        });
        let all: Vec<(usize, (&str, usize))> = batches.enumerate().collect();
        let answer = |(number, (ingest, batch)): &(usize, (&str, usize))| {
            question(*number, &self.problem_of(ingest, *batch, *number == 0)?)
        };
        let join = |all: &mut PartEvidence, own: PartEvidence| {
            *all = joined_evidence(all, &own)?;
            Ok(())
        };
        let told = |done: usize| self.monitor.parts_done("batches", done, Some(all.len()));
        let found = in_order(&all, free_threads(), answer, join, told)?;
        if self.factors.is_none() {
            let sums = found.as_ref().and_then(|found| found.weighed.as_ref());
            self.batches.keep_unlisted(&self.stage.name, sums.and_then(|sums| unlisted(&self.stage.name, sums)));
        }
        Ok(found)
    }

    fn sample(&self) -> Result<Option<Problem>> {
        let found = self.batches.chosen_problem(self.stage, &self.known.problem, &self.monitor);
        found.map(|problem| Some(with_factors_found(&problem, self.factors()).watched_by(self.monitor.clone())))
    }
}

impl AllBatches<'_> {
    fn factors(&self) -> &[VarianceFactor] {
        self.factors.unwrap_or_default()
    }

    fn problem_of(&self, ingest: &str, batch: usize, with_others: bool) -> Result<Problem> {
        self.monitor.check()?;
        // Other values of the unknowns would not help.
        let (data, _) = self.batches.with_batch(ingest, batch).map_err(|error| Error { fatal: true, ..error })?;
        let model = self.known.problem.model.clone();
        let problem = self.batches.problem_of(self.stage, ingest, with_others, model, &data, None)?;
        Ok(match self.factors() {
            [] => problem,
            factors => with_factors_found(&problem, factors),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outliers_that_are_not_listed_are_counted() {
        let mut sums = WeighedSums { found: 12_345, ..WeighedSums::default() };
        let told = unlisted("fit", &sums).expect("a remark");
        assert_eq!(
            (told.estimate.as_str(), told.text.as_str()),
            ("fit", "there are 12345 outliers; the 0 with the largest residuals are listed")
        );
        sums.found = 0;
        assert_eq!(unlisted("fit", &sums), None);
    }
}
