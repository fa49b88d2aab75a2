//! Estimates of readings that are no geometry: they have data and no machine.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use abbe_core::{
    Calibration, ColumnHeader, DataRecord, Dataset, Error, EstimateSource, Fit, Kind, KinematicModel, Model, Passes,
    Quantities, Result,
};
use abbe_recipe::Stage;

use crate::batches::InBatches;
use crate::evidence::{Digests, of_rows};
use crate::prepare::Prepared;
use crate::run::Datasets;
use crate::saved::fit_without_rows;

/// The quantities of a calibration from another run, in the place of a machine.
pub(crate) struct SavedQuantities(pub Calibration);

impl Model for SavedQuantities {
    fn build(&self, _: &[&Dataset]) -> Result<Arc<dyn KinematicModel>> {
        Ok(Arc::new(Quantities::of(&self.0)?))
    }
}

/// Whether an estimate is made of readings that are no geometry.
pub(crate) fn has_readings(stage: &Stage) -> bool {
    stage.estimate_source == EstimateSource::Readings
}

/// The data sets under `from`.
pub(crate) fn read_by<'a>(stage: &Stage, data: &'a Datasets) -> Vec<&'a Dataset> {
    stage.reference("from").iter().map(|name| data[name].as_ref()).collect()
}

/// The rows that it rests on: all that it reads.
pub(crate) fn rows(stage: &Stage, data: &Datasets, digests: &Digests) -> Vec<DataRecord> {
    let mut rows: BTreeMap<String, BTreeSet<usize>> = BTreeMap::new();
    for data in read_by(stage, data) {
        for origin in &data.origins {
            rows.entry(data.files[origin.file].display().to_string()).or_default().insert(origin.row);
        }
    }
    of_rows(rows, digests)
}

impl Prepared {
    /// Fails if its data do not have the columns that it needs.
    pub(crate) fn check_readings(&self, stage: &Stage) -> Result<()> {
        let (estimator, from) = (&self.estimators[&stage.name], stage.reference("from"));
        let headers = from.iter().map(|ingest| self.headers(ingest)).collect::<Result<Vec<_>>>()?;
        estimator.check_readings(&headers).map_err(|error| {
            // Of several data sets the first one that is refused in the place of all others, too.
            let is_refused = |own: &&Vec<ColumnHeader>| {
                let alike = vec![(*own).clone(); headers.len()];
                estimator.check_readings(&alike).is_err_and(|alone| alone.setting == error.setting)
            };
            let ingest = headers.iter().position(|own| is_refused(&own)).map(|place| &from[place]);
            let file = ingest.and_then(|ingest| Some(self.ingests[ingest].inputs().first()?.path.clone()));
            match file.filter(|_| error.place.is_none() && !error.setting.is_empty()) {
                Some(file) => error.in_file(&file),
                None => error,
            }
        })
    }

    /// Fails if a validator or an exporter that needs a machine is given an estimate without one.
    pub(crate) fn check_machines(&self, stage: &Stage, accepts_readings: bool) -> Result<()> {
        for fit in stage.reference("of") {
            let estimate = self.own_estimate(fit)?;
            let is_saved = self.saved.get(fit).is_some_and(|saved| saved.of_readings);
            if !accepts_readings && (is_saved || has_readings(estimate)) {
                let message =
                    format!("`{}` needs a machine, and `{fit}` was made of readings without one", stage.plugin);
                return Err(Error::usage(message).setting("of"));
            }
        }
        Ok(())
    }

    /// The estimate.
    pub(crate) fn of_readings(&self, stage: &Stage, data: &Datasets, batches: &InBatches<'_>) -> Result<Fit> {
        let estimator = self.estimators[&stage.name].clone();
        let found = || {
            let calibration = match self.has_passes(stage) {
                true => {
                    let passes = batches.passes(stage, data)?;
                    let all: Vec<&dyn Passes> = passes.iter().map(AsRef::as_ref).collect();
                    estimator.estimate_readings_in_passes(&stage.name, &all)?
                }
                false => estimator.estimate_readings(&stage.name, &read_by(stage, data))?,
            };
            let model = Arc::new(Quantities::of(&calibration)?);
            fit_without_rows(calibration, model, estimator.clone())
        };
        self.located(stage, found())
    }

    /// Whether some estimate is made of readings.
    pub(crate) fn has_readings(&self, fits: &[Fit]) -> bool {
        let mut stages = self.stages(Kind::Estimate).filter(|stage| has_readings(stage));
        stages.any(|stage| fits.iter().any(|fit| fit.name == stage.name))
    }
}
