//! One estimate from rows in parts: what the rows of this recipe give as one part, and the estimate of all parts.

use std::collections::BTreeMap;
use std::sync::Arc;

use abbe_core::{
    AskedOfPart, Contact, DataRecord, Equations, Error, Estimate, EstimateSource, Fit, Kind, KinematicModel,
    KnownInput, Layout, ModelRecord, Monitor, ObservationSet, Observations, ObservationsInfo, Orientation, Parameter,
    PartEvidence, Parts, Problem, Result, RowBatch, matches,
};
use abbe_estimation::{joined_evidence, part_evidence};
use abbe_recipe::Stage;
use serde::{Deserialize, Serialize};

use crate::evidence;
use crate::plausibility::{check_tips, check_uncertainties};
use crate::prepare::Prepared;
use crate::problems::{Taken, take};
use crate::record::{FailureRecord, FileRecord, input_records};
use crate::row_settings::Wanted;
use crate::run::{Datasets, digests};
use crate::statuses;

/// What to do about rows that cannot be taken in parts.
const AT_ONCE: &str = "estimate all rows at once: `abbe run`, without `batch_rows` where they are read";

/// What a part has of the rows of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share<'a> {
    /// The ingest stage whose rows lie in parts: those of this recipe are the part.
    pub from: &'a str,
    /// Whether the rows of all other stages are in this part. One part has them, or they would count several times.
    pub with_others: bool,
}

/// What a part of the rows of an estimate is, and what it answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// The files that it was read from, the recipe first.
    pub inputs: Vec<FileRecord>,
    /// The machine.
    pub model: ModelRecord,
    /// The artefacts.
    pub sets: Vec<PartSet>,
    /// The rows.
    pub data: Vec<DataRecord>,
    /// Smallest and largest load, temperature and the like, by the name of the column.
    pub statuses: BTreeMap<String, [f64; 2]>,
    /// The answer.
    pub evidence: PartEvidence,
}

impl Part {
    /// The answer of the rows of a problem at some values of its unknowns.
    fn of(problem: &Problem, asked: AskedOfPart, values: &[f64], inputs: &[FileRecord]) -> Result<Self> {
        Ok(Self { evidence: part_evidence(problem, asked, values)?, ..Self::unasked(problem, inputs) })
    }

    /// The rows of a problem before they are asked anything.
    pub(crate) fn unasked(problem: &Problem, inputs: &[FileRecord]) -> Self {
        Self {
            model: problem.model_record(),
            sets: problem.sets.iter().map(PartSet::of).collect(),
            data: evidence::of_problem(problem, &digests(inputs)),
            statuses: statuses::of_problem(problem),
            evidence: PartEvidence::default(),
            inputs: inputs.to_vec(),
        }
    }

    /// Adds another part of the rows of the same estimate.
    ///
    /// Fails where both know one thing differently.
    pub(crate) fn join(&mut self, other: &Self) -> Result<()> {
        if self.model != other.model {
            return Err(differing_machines());
        }
        for set in &other.sets {
            match self.sets.iter_mut().find(|known| known.name == set.name) {
                Some(known) => known.join(set)?,
                None => self.sets.push(set.clone()),
            }
        }
        self.data = evidence::joined(std::mem::take(&mut self.data), &other.data);
        statuses::join(&mut self.statuses, &other.statuses);
        self.evidence = joined_evidence(&self.evidence, &other.evidence)?;
        Ok(())
    }
}

/// The error for parts whose machines differ.
fn differing_machines() -> Error {
    Error::data("the machine takes settings from its data, and they differ from part to part")
        .help("state in the recipe what the machine takes from the data: the time scale of a drift")
}

/// The artefact of a part: what a problem has to know of it besides its rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PartSet {
    /// The artefact stage.
    pub name: String,
    /// Own unknowns.
    pub unknowns: Vec<Parameter>,
    /// Their start values.
    pub start: Vec<f64>,
    /// Known inputs.
    pub inputs: Vec<KnownInput>,
    /// Their declared identities.
    pub ids: Vec<Option<String>>,
    /// Whether its equations depend on the orientation of the tool.
    #[serde(default)]
    pub orientation: Orientation,
}

impl PartSet {
    fn of(set: &ObservationSet) -> Self {
        let ObservationsInfo { unknowns, start, inputs, orientation, .. } = set.info();
        Self {
            name: set.name.clone(),
            unknowns: unknowns.clone(),
            start: start.clone(),
            inputs: inputs.clone(),
            ids: set.ids.clone(),
            orientation: *orientation,
        }
    }

    /// Adds what another part knows of the same artefact.
    ///
    /// Fails where both know one thing differently: then rows are not independent of each other.
    fn join(&mut self, other: &Self) -> Result<()> {
        let differs = |name: &str, what: &str| {
            let message = format!("`{}.{name}` has another {what} in another part of the rows", self.name);
            Err(Error::data(message).help(AT_ONCE).stage(&self.name))
        };
        let places = |names: Vec<&str>| -> BTreeMap<String, usize> {
            names.into_iter().enumerate().map(|(place, name)| (name.to_owned(), place)).collect()
        };
        let unknowns = places(self.unknowns.iter().map(|known| known.name.as_str()).collect());
        let inputs = places(self.inputs.iter().map(|known| known.parameter.name.as_str()).collect());
        for (unknown, start) in other.unknowns.iter().zip(&other.start) {
            match unknowns.get(&unknown.name).copied() {
                None => {
                    self.unknowns.push(unknown.clone());
                    self.start.push(*start);
                }
                Some(place) if self.unknowns[place] != *unknown => return differs(&unknown.name, "unit or role"),
                Some(place) if self.start[place] != *start => return differs(&unknown.name, "start value"),
                Some(_) => {}
            }
        }
        for (input, id) in other.inputs.iter().zip(&other.ids) {
            let name = &input.parameter.name;
            match inputs.get(name).copied() {
                None => {
                    self.inputs.push(input.clone());
                    self.ids.push(id.clone());
                }
                Some(place) if self.inputs[place] != *input => return differs(name, "value or certificate"),
                Some(_) => {}
            }
        }
        Ok(())
    }
}

/// The observations of all parts without their rows: what they are called, and nothing to evaluate.
struct WithoutRows(ObservationsInfo);

impl Observations for WithoutRows {
    fn info(&self) -> &ObservationsInfo {
        &self.0
    }

    fn evaluate(&self, _: RowBatch<'_>, _: &mut Equations) -> Result<()> {
        Err(Error::data("these observations have no rows: they lie in parts"))
    }
}

/// The estimate of all parts.
pub struct OfParts {
    /// The calibration.
    pub calibration: abbe_core::Calibration,
    /// Why it cannot be that of a machine, if it cannot.
    pub failures: Vec<FailureRecord>,
}

impl Prepared {
    /// Fails if an estimate cannot be made of rows of an ingest stage in parts, as far as that shows without reading rows.
    pub fn check_parts(&self, estimate: &str, from: &str) -> Result<()> {
        self.check_rows(estimate, from, |estimator| estimator.accepts_parts())
    }

    /// The same of rows that are read in batches.
    pub(crate) fn check_rows_in_batches(&self, estimate: &str, from: &str) -> Result<()> {
        self.check_rows(estimate, from, |estimator| estimator.accepts_batches())
    }

    fn check_rows(&self, estimate: &str, from: &str, accepts: impl Fn(&dyn Estimate) -> Result<()>) -> Result<()> {
        let stage = self.recipe_stage(estimate)?;
        let wrong = |error: Error| self.recipe.locate(error.stage(&stage.name));
        let refused = |message: String| Err(wrong(Error::usage(message).help(AT_ONCE)));
        if stage.kind != Kind::Estimate || stage.estimate_source != EstimateSource::Measurements {
            return refused(format!("`{estimate}` is no estimate from measurements"));
        }
        if stage.per.is_some() {
            let message = format!("`{estimate}` has groups (`per`), each of which is an estimate by itself");
            return Err(wrong(Error::usage(message).help(AT_ONCE).setting("per")));
        }
        if let Some(key) = ["start", "known"].into_iter().find(|key| !stage.reference(key).is_empty()) {
            let message = format!("`{key}` of `{estimate}` names an estimate, and a part of its rows knows none");
            return Err(wrong(Error::usage(message).help(AT_ONCE).setting(key)));
        }
        self.located(stage, accepts(self.estimators[&stage.name].as_ref()))?;
        let mut is_observed = false;
        for name in stage.reference("observations") {
            let (ingest, artefact) = self.artefact(name)?;
            if ingest != from {
                continue;
            }
            is_observed = true;
            if !artefact.rows_are_independent() || self.repeats(name)?.is_some() {
                let plugin = &self.recipe_stage(name)?.plugin;
                return refused(format!("the rows of `{name}` ({plugin}) depend on each other with these settings"));
            }
        }
        match is_observed {
            true => Ok(()),
            false => refused(format!("`{estimate}` observes nothing of `{from}`")),
        }
    }

    /// What the rows of this recipe, as one part, tell for an estimate at some values of its unknowns, by name. A name without a value
    /// is at its start.
    pub fn part(
        &self,
        estimate: &str,
        share: Share<'_>,
        asked: AskedOfPart,
        at: &BTreeMap<String, f64>,
    ) -> Result<Part> {
        self.check_parts(estimate, share.from)?;
        let stage = self.recipe_stage(estimate)?;
        let inputs = input_records(&self.files)?;
        let (data, mut taken) = (self.read(&Monitor::default(), None)?, Taken::default());
        if data[share.from].averaged {
            let error = Error::usage("rows are means of rows of several files, and no part has all files");
            let error = error.help(format!("average the files before, or {AT_ONCE}"));
            return Err(self.recipe.locate(error.setting("average").stage(share.from)));
        }
        let machine = self.built_machine(stage, &data)?;
        let observed = self.observed(stage, |ingest| match ingest == share.from {
            true => Some(Rows::Some),
            false => share.with_others.then_some(Rows::All),
        })?;
        let problem = self.part_problem(stage, machine, &observed, &data, Some(&mut taken));
        let problem = self.located(stage, problem)?;
        self.nothing_left_over(&data, &taken)?;
        let part = Part::of(&problem, asked, &problem.values_at(at), &inputs);
        self.located(stage, part)
    }

    /// What an estimate observes of the data sets that count, in its order.
    pub(crate) fn observed<'a>(
        &self,
        stage: &'a Stage,
        counts: impl Fn(&str) -> Option<Rows>,
    ) -> Result<Vec<(&'a str, Rows)>> {
        let mut observed = Vec::new();
        for name in stage.reference("observations") {
            let (ingest, _) = self.artefact(name)?;
            observed.extend(counts(ingest).map(|rows| (name.as_str(), rows)));
        }
        Ok(observed)
    }

    /// The problem of a part on a machine that is there. Unknowns that other parts have need not be here, nor artefacts whose rows are
    /// all in others.
    pub(crate) fn part_problem(
        &self,
        stage: &Stage,
        model: Arc<dyn KinematicModel>,
        observed: &[(&str, Rows)],
        data: &Datasets,
        mut taken: Option<&mut Taken>,
    ) -> Result<Problem> {
        let mut sets = Vec::new();
        for (name, rows) in observed {
            let (ingest, artefact) = self.artefact(name)?;
            check_tips(&data[ingest], model.as_ref()).map_err(|error| error.stage(ingest))?;
            if let Some(taken) = &mut taken {
                taken.entry(ingest.to_owned()).or_default();
            }
            let observations = match rows {
                Rows::All => artefact.observe(&data[ingest], &model).map(Some),
                Rows::Some => artefact.observe_some(&data[ingest], &model),
            };
            let Some(observations) = observations.map_err(|error| error.stage(name))? else { continue };
            let set = self.set(name, observations, &model, data, Wanted::Seen)?;
            if let Some(taken) = &mut taken {
                take(taken, ingest, &set);
            }
            sets.push(set);
        }
        let of_machine = model.info().parameters.iter().map(|parameter| parameter.name.clone());
        let of_ties = stage.ties.iter().map(|tie| tie.to.clone());
        let of_sets = sets
            .iter()
            .flat_map(|set| set.info().unknowns.iter().map(|unknown| format!("{}.{}", set.name, unknown.name)));
        let names: Vec<String> = of_machine.chain(of_ties).chain(of_sets).collect();
        let patterns = stage.parameters.iter().filter(|pattern| names.iter().any(|name| matches(pattern, name)));
        let patterns: Vec<String> = patterns.cloned().collect();
        Problem::with_ties(&stage.name, &self.model_plugin(stage)?, model, sets, (&patterns, &stage.ties))
    }

    /// The estimate of all parts; `known` are their answers at the start. This is the recipe of one of them.
    pub fn of_parts(&self, estimate: &str, known: &[Arc<Part>], parts: &dyn Parts) -> Result<OfParts> {
        let stage = self.recipe_stage(estimate)?;
        let data = self.read(&Monitor::default(), None)?;
        let model = self.built_machine(stage, &data)?;
        let problem = self.located(stage, self.problem_of_parts(stage, model, known))?;
        let estimator = self.estimators[&stage.name].clone();
        let mut calibration = self.located(stage, estimator.estimate_parts(&problem, parts))?;
        for part in known {
            statuses::join(&mut calibration.fit.statuses, &part.statuses);
            calibration.data = evidence::joined(calibration.data, &part.data);
        }
        self.located(stage, check_uncertainties(&calibration))?;
        let mut fits = [Fit { name: stage.name.clone(), problem: Arc::new(problem), estimator, calibration }];
        let failures = self.implausible(&mut fits)?;
        let [Fit { calibration, .. }] = fits;
        Ok(OfParts { calibration, failures: failures.iter().map(FailureRecord::of).collect() })
    }

    /// The problem with the unknowns of all parts, and without rows.
    pub(crate) fn problem_of_parts(
        &self,
        stage: &Stage,
        model: Arc<dyn KinematicModel>,
        known: &[Arc<Part>],
    ) -> Result<Problem> {
        let record = ModelRecord { plugin: self.model_plugin(stage)?, settings: model.info().settings.clone() };
        if known.iter().any(|part| part.model != record) {
            return Err(differing_machines());
        }
        let names = stage.reference("observations").iter();
        let sets = names.map(|name| self.joined(name, known, model.as_ref())).collect::<Result<Vec<_>>>()?;
        Problem::with_ties(&stage.name, &record.plugin, model, sets, (&stage.parameters, &stage.ties))
    }

    /// The observations of one artefact in all parts, without rows.
    fn joined(&self, name: &str, known: &[Arc<Part>], model: &dyn KinematicModel) -> Result<ObservationSet> {
        let mut of_parts = known.iter().flat_map(|part| &part.sets).filter(|set| set.name == name);
        let Some(mut all) = of_parts.next().cloned() else {
            let (ingest, _) = self.artefact(name)?;
            let error = Error::data(format!("no row of `{ingest}` is one of `{name}`")).stage(name);
            return Err(error.help("`feature` in the data and in the nominal file have to agree"));
        };
        of_parts.try_for_each(|own| all.join(own))?;
        let layout = Layout::new(&Arc::new(abbe_core::Dataset::default()), model, &[])?;
        let contact = Contact::NotSimulated("its rows lie in parts".to_owned());
        let info = ObservationsInfo {
            start: all.start,
            inputs: all.inputs,
            orientation: all.orientation,
            ..ObservationsInfo::new(layout, all.unknowns, contact)
        };
        let mut joined = ObservationSet::new(name, Arc::new(WithoutRows(info)));
        joined.ids = all.ids;
        Ok(joined)
    }
}

/// Which rows of a data set an artefact observes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Rows {
    /// All that there are.
    All,
    /// Some of them: others are in other parts.
    Some,
}
