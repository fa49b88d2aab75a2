//! One estimate from rows in parts: what the rows of this recipe give as one part, and the estimate of all parts.

use std::collections::BTreeMap;
use std::sync::Arc;

use abbe_core::{
    AskedOfPart, Contact, DataRecord, Equations, Error, EstimateSource, Fit, Kind, KinematicModel, KnownInput, Layout,
    ModelRecord, Monitor, ObservationSet, Observations, ObservationsInfo, Parameter, PartEvidence, Parts, Problem,
    Result, RowBatch, matches,
};
use abbe_estimation::part_evidence;
use abbe_recipe::Stage;
use serde::{Deserialize, Serialize};

use crate::evidence;
use crate::plausibility::check_uncertainties;
use crate::prepare::Prepared;
use crate::record::{FailureRecord, FileRecord, input_records};
use crate::row_settings::Wanted;
use crate::run::{Datasets, Taken, digests};
use crate::statuses;

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
}

impl PartSet {
    fn of(set: &ObservationSet) -> Self {
        let ObservationsInfo { unknowns, start, inputs, .. } = set.info();
        Self {
            name: set.name.clone(),
            unknowns: unknowns.clone(),
            start: start.clone(),
            inputs: inputs.clone(),
            ids: set.ids.clone(),
        }
    }

    /// Adds what another part knows of the same artefact.
    ///
    /// Fails where both know one thing differently: then rows are not independent of each other.
    fn join(&mut self, other: &Self) -> Result<()> {
        let differs = |name: &str, what: &str| {
            let message = format!("`{}.{name}` has another {what} in another part of the rows", self.name);
            Err(Error::data(message).help("estimate all rows at once: `abbe run`").stage(&self.name))
        };
        for (unknown, start) in other.unknowns.iter().zip(&other.start) {
            match self.unknowns.iter().position(|known| known.name == unknown.name) {
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
            match self.inputs.iter().position(|known| known.parameter.name == *name) {
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
        let stage = self.recipe_stage(estimate)?;
        let wrong = |error: Error| self.recipe.locate(error.stage(&stage.name));
        let refused = |message: String| Err(wrong(Error::usage(message).help("estimate all rows at once: `abbe run`")));
        if stage.kind != Kind::Estimate || stage.estimate_source != EstimateSource::Measurements {
            return refused(format!("`{estimate}` is no estimate from measurements"));
        }
        if stage.per.is_some() {
            return refused(format!("`{estimate}` has groups (`per`), each of which is an estimate by itself"));
        }
        if let Some(key) = ["start", "known"].into_iter().find(|key| !stage.reference(key).is_empty()) {
            return refused(format!("`{key}` of `{estimate}` names an estimate, and a part knows none"));
        }
        self.located(stage, self.estimators[&stage.name].accepts_parts())?;
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
            let error = error.help("average the files before, or estimate all rows at once: `abbe run`");
            return Err(self.recipe.locate(error.setting("average").stage(share.from)));
        }
        let problem = self.located(stage, self.part_problem(stage, Some(share), &data, &mut taken))?;
        self.nothing_left_over(&data, &taken)?;
        let values = problem.unknowns.iter().zip(problem.start());
        let values: Vec<f64> = values.map(|(unknown, start)| at.get(&unknown.name).copied().unwrap_or(start)).collect();
        Ok(Part {
            model: problem.model_record(),
            sets: problem.sets.iter().map(PartSet::of).collect(),
            data: evidence::of_problem(&problem, &digests(&inputs)),
            statuses: statuses::of_problem(&problem),
            evidence: self.located(stage, part_evidence(&problem, asked, &values))?,
            inputs,
        })
    }

    /// The problem of a share, or of all rows of this recipe. Unknowns that other parts have need not be here.
    fn part_problem(
        &self,
        stage: &Stage,
        share: Option<Share<'_>>,
        data: &Datasets,
        taken: &mut Taken,
    ) -> Result<Problem> {
        let model = self.built_machine(stage, data)?;
        let mut observed = Vec::new();
        for name in stage.reference("observations") {
            let (ingest, _) = self.artefact(name)?;
            if share.is_none_or(|share| share.with_others || share.from == ingest) {
                observed.push(name.clone());
            }
        }
        let sets = self.sets(&observed, &model, data, Wanted::Seen, taken)?;
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
        let problem = self.located(stage, self.problem_of_parts(stage, known))?;
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
    fn problem_of_parts(&self, stage: &Stage, known: &[Arc<Part>]) -> Result<Problem> {
        let (data, mut taken) = (self.read(&Monitor::default(), None)?, Taken::default());
        let own = self.part_problem(stage, None, &data, &mut taken)?;
        let record = own.model_record();
        if known.iter().any(|part| part.model != record) {
            let error = Error::data("the machine takes settings from its data, and they differ from part to part");
            return Err(
                error.help("state in the recipe what the machine takes from the data: the time scale of a drift")
            );
        }
        let sets = own.sets.iter().map(|set| joined(set, known, own.model.as_ref()));
        let sets = sets.collect::<Result<Vec<ObservationSet>>>()?;
        let plugin = self.model_plugin(stage)?;
        Problem::with_ties(&stage.name, &plugin, own.model.clone(), sets, (&stage.parameters, &stage.ties))
    }
}

/// The observations of one artefact in all parts, without rows.
fn joined(set: &ObservationSet, known: &[Arc<Part>], model: &dyn KinematicModel) -> Result<ObservationSet> {
    let mut all =
        PartSet { unknowns: Vec::new(), start: Vec::new(), inputs: Vec::new(), ids: Vec::new(), ..PartSet::of(set) };
    for part in known {
        part.sets.iter().filter(|own| own.name == set.name).try_for_each(|own| all.join(own))?;
    }
    let none = Arc::new(abbe_core::Dataset::default());
    let layout = Layout::new(&none, model, &[])?;
    let contact = Contact::NotSimulated("its rows lie in parts".to_owned());
    let info = ObservationsInfo {
        start: all.start,
        inputs: all.inputs,
        orientation: set.info().orientation,
        ..ObservationsInfo::new(layout, all.unknowns, contact)
    };
    let mut joined = ObservationSet::new(&set.name, Arc::new(WithoutRows(info)));
    joined.ids = all.ids;
    Ok(joined)
}
