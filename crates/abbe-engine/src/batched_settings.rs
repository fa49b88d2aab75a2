//! What a recipe may do with data sets that are read in batches: everything that needs all their rows is refused.

use abbe_core::{Error, Kind, Result};
use abbe_recipe::Stage;

use crate::prepare::Prepared;

impl Prepared {
    /// Fails for a stage that needs all rows of a data set that is read in batches.
    pub(crate) fn check_batches(&self, stage: &Stage) -> Result<()> {
        match stage.kind {
            Kind::Ingest | Kind::Export => Ok(()),
            Kind::Model => self.check_read_whole(stage, "logs"),
            Kind::Artefact => {
                self.check_read_whole(stage, "repeats")?;
                self.check_row_settings(stage)
            }
            Kind::Estimate => {
                if !self.estimators.get(&stage.name).is_some_and(|own| own.accepts_readings_in_passes()) {
                    self.check_read_whole(stage, "from")?;
                }
                self.check_analysed(stage)?;
                self.batched_of(stage)?.iter().try_for_each(|ingest| self.check_rows_in_batches(&stage.name, ingest))
            }
            Kind::Validate => {
                let own = self.validators.get(&stage.name);
                // What controls do with exported files is asked with all rows.
                let is_plain = stage.reference("exports").is_empty();
                if !(is_plain && own.is_some_and(|own| own.accepts_data_in_passes())) {
                    self.check_read_whole(stage, "from")?;
                }
                for name in stage.reference("observations") {
                    let (ingest, _) = self.artefact(name)?;
                    if self.is_in_batches(ingest) {
                        return Err(needs_all(stage, ingest).setting("observations"));
                    }
                }
                Ok(())
            }
        }
    }

    /// Fails if a stage refers to a data set that is read in batches by a key under which all rows are needed.
    fn check_read_whole(&self, stage: &Stage, key: &str) -> Result<()> {
        match stage.reference(key).iter().find(|ingest| self.is_in_batches(ingest)) {
            Some(ingest) => Err(needs_all(stage, ingest).setting(key)),
            None => Ok(()),
        }
    }

    /// Fails for settings of an artefact's rows that are about all of them.
    fn check_row_settings(&self, stage: &Stage) -> Result<()> {
        let Some(ingest) = stage.reference("from").first().filter(|ingest| self.is_in_batches(ingest)) else {
            return Ok(());
        };
        let is_there = |key: &&str| stage.row_settings.get(key).is_some();
        match ["pooled", "unseen"].into_iter().find(is_there) {
            Some(key) => Err(needs_all(stage, ingest).setting(key)),
            None => Ok(()),
        }
    }

    /// Fails for the analysis of an estimate whose rows are read in batches.
    fn check_analysed(&self, stage: &Stage) -> Result<()> {
        let own = self.own_estimate(&stage.name)?;
        let Some(ingest) = self.batched_of(own)?.into_iter().next().filter(|_| own.name != stage.name) else {
            return Ok(());
        };
        let refused = |why: Error| Error { setting: why.setting, ..needs_all(stage, &ingest) };
        self.estimators
            .get(&stage.name)
            .map_or(Ok(()), |estimator| estimator.accepts_analysis_of_parts().map_err(refused))
    }
}

fn needs_all(stage: &Stage, ingest: &str) -> Error {
    let message = format!("`{}` needs all rows of `{ingest}` at once, and they are read in batches", stage.name);
    Error::usage(message).help(format!("leave out `batch_rows` of `{ingest}`, or leave out what needs its rows"))
}
