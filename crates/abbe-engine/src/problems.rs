//! The problems of estimates: their machine, the observations of their artefacts, and that no row is left over.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use abbe_core::{
    DataRow, Dataset, EstimateSource, Kind, KinematicModel, ObservationSet, Observations, Problem, Result,
};
use abbe_recipe::Stage;

use crate::plausibility::{check_stated, check_tips};
use crate::prepare::Prepared;
use crate::row_settings::Wanted;
use crate::run::{Datasets, has_problem};
use crate::told::untold;
use crate::travel::check_travel;
use crate::units::tell_minutes;

/// Rows of each data set that some artefact took.
pub(crate) type Taken = BTreeMap<String, BTreeSet<DataRow>>;

/// Notes the rows of a data set that a set has of it.
pub(crate) fn take(taken: &mut Taken, ingest: &str, set: &ObservationSet) {
    let layout = &set.info().layout;
    let rows = layout.rows.iter().filter_map(|row| row.data_row);
    let mut rows = rows.chain(layout.merged.iter().copied()).collect();
    taken.entry(ingest.to_owned()).or_default().append(&mut rows);
}

impl Prepared {
    /// The problems of all estimates, those of calibrations from outside this recipe included.
    pub(crate) fn problems(&self, data: &Datasets, taken: &mut Taken) -> Result<BTreeMap<String, Problem>> {
        self.problems_of(data, taken, |_| true)
    }

    /// The same of some estimates.
    pub(crate) fn problems_of(
        &self,
        data: &Datasets,
        taken: &mut Taken,
        is_wanted: impl Fn(&Stage) -> bool,
    ) -> Result<BTreeMap<String, Problem>> {
        let mut problems = BTreeMap::new();
        for stage in self.stages(Kind::Estimate).filter(has_problem).filter(|stage| is_wanted(stage)) {
            let problem = self.located(stage, self.problem(stage, data, taken))?;
            self.located(stage, self.plausible[&stage.name].check_names(&problem))?;
            problems.insert(stage.name.clone(), problem);
        }
        Ok(problems)
    }

    /// Model and observations of an estimate.
    pub(crate) fn problem(&self, stage: &Stage, data: &Datasets, taken: &mut Taken) -> Result<Problem> {
        self.problem_on(stage, self.built_machine(stage, data)?, data, taken)
    }

    /// The same on a machine that is there.
    pub(crate) fn problem_on(
        &self,
        stage: &Stage,
        model: Arc<dyn KinematicModel>,
        data: &Datasets,
        taken: &mut Taken,
    ) -> Result<Problem> {
        let names = stage.reference("observations");
        let sets = self.sets(names, &model, data, Wanted::Seen, taken)?;
        let plugin = self.model_plugin(stage)?;
        match stage.parameters.as_slice() {
            // All parameters of the machine, which are stated or known.
            [] if stage.estimate_source != EstimateSource::Measurements => {
                Problem::new(&stage.name, &plugin, model, sets, &["*".to_owned()])
            }
            patterns => Problem::with_ties(&stage.name, &plugin, model.clone(), sets, (patterns, &stage.ties))
                .map_err(|error| self.with_substitute(stage, model.as_ref(), error)),
        }
    }

    /// Name of the plugin of an estimate's model.
    pub(crate) fn model_plugin(&self, estimate: &Stage) -> Result<String> {
        let stage = self.machine_stage(estimate)?;
        let saved = self.saved.get(&stage.name);
        Ok(saved.map_or_else(|| stage.plugin.clone(), |saved| saved.calibration.model.plugin.clone()))
    }

    /// The machine of an estimate. If it is that of another estimate, it has the settings that follow from the data of that
    /// estimate.
    pub(crate) fn built_machine(&self, stage: &Stage, data: &Datasets) -> Result<Arc<dyn KinematicModel>> {
        self.machine_of(stage, data, true)
    }

    /// The same; whether doubts about the data and the logs are told.
    pub(crate) fn machine_of(&self, stage: &Stage, data: &Datasets, tells: bool) -> Result<Arc<dyn KinematicModel>> {
        let stage = self.built_for(stage)?;
        let (machine, _) = self.machine(stage)?;
        let logs = self.logs(machine, |log| Ok(data[log].clone()))?;
        if !tells {
            return untold(|| self.machine_with(stage, data, &logs));
        }
        tell_minutes(&self.rows_of(stage, data)?, &logs);
        self.machine_with(stage, data, &logs)
    }

    /// The estimate that the machine of an estimate is built for.
    pub(crate) fn built_for<'a>(&'a self, mut stage: &'a Stage) -> Result<&'a Stage> {
        while let Some(name) = stage.reference("machine").first().or(stage.reference("of").first()) {
            let other = self.recipe_stage(name)?;
            if other.kind != Kind::Estimate {
                break;
            }
            stage = other;
        }
        Ok(stage)
    }

    /// The machine that is built for an estimate, with other logs.
    pub(crate) fn machine_with(
        &self,
        stage: &Stage,
        data: &Datasets,
        logs: &[Dataset],
    ) -> Result<Arc<dyn KinematicModel>> {
        let (machine, model) = self.machine(stage)?;
        let rows = self.rows_of(stage, data)?;
        let used: Vec<&Dataset> = rows.into_iter().map(|(_, rows)| rows).chain(logs).collect();
        model.build(&used).map_err(|error| error.stage(&machine.name))
    }

    /// The rows that an estimate observes, with the names of their ingest stages.
    fn rows_of<'a>(&'a self, stage: &'a Stage, data: &'a Datasets) -> Result<Vec<(&'a str, &'a Dataset)>> {
        let names = stage.reference("observations");
        let mut rows: Vec<(&str, &Dataset)> = Vec::new();
        for name in names {
            let (ingest, _) = self.artefact(name)?;
            if !rows.iter().any(|(own, _)| *own == ingest) {
                rows.push((ingest, data[ingest].as_ref()));
            }
        }
        Ok(rows)
    }

    /// The observation sets of some artefact stages on a machine.
    pub(crate) fn sets(
        &self,
        names: &[String],
        model: &Arc<dyn KinematicModel>,
        data: &Datasets,
        wanted: Wanted,
        taken: &mut Taken,
    ) -> Result<Vec<ObservationSet>> {
        let mut sets = Vec::new();
        for name in names {
            let (ingest, artefact) = self.artefact(name)?;
            check_tips(&data[ingest], model.as_ref()).map_err(|error| error.stage(ingest))?;
            let observations = artefact.observe(&data[ingest], model).map_err(|error| error.stage(name))?;
            let set = self.set(name, observations, model, data, wanted)?;
            take(taken, ingest, &set);
            sets.push(set);
        }
        Ok(sets)
    }

    /// The observation set of an artefact stage, from its observations.
    pub(crate) fn set(
        &self,
        name: &str,
        observations: Arc<dyn Observations>,
        model: &Arc<dyn KinematicModel>,
        data: &Datasets,
        wanted: Wanted,
    ) -> Result<ObservationSet> {
        let (_, artefact) = self.artefact(name)?;
        let repeats = self.repeats(name)?.map(|repeats| artefact.observe(&data[repeats], model));
        let repeats = repeats.transpose().map_err(|error| error.stage(name))?;
        let set = self.rows[name].set(name, observations, repeats, model, wanted).map_err(|error| error.stage(name))?;
        check_travel(&set, model.as_ref()).and_then(|()| check_stated(&set)).map_err(|error| error.stage(name))?;
        Ok(set)
    }

    /// Fails if a row was used by no artefact: a feature without nominal geometry must not be ignored without a message.
    pub(crate) fn nothing_left_over(&self, data: &Datasets, taken: &Taken) -> Result<()> {
        for (ingest, rows) in taken {
            let data = &data[ingest];
            let left_over = || data.row_indices().find(|row| !rows.contains(row));
            let Some(row) = (rows.len() < data.rows()).then(left_over).flatten() else { continue };
            let (feature, ignore) = match data.labels("feature") {
                Some(labels) => (
                    format!("feature {} is taken by no artefact", labels[row]),
                    format!("; or leave it out by `ignore: {{ feature: [{}] }}` in stage `{ingest}`", labels[row]),
                ),
                None => ("this row is taken by no artefact".to_owned(), String::new()),
            };
            return Err(data
                .error_at(row, feature)
                .stage(ingest)
                .help(format!("add it to the nominal geometry of an artefact that is observed{ignore}")));
        }
        Ok(())
    }
}
