//! The uncertainty of the rows of an artefact as the recipe states it, from files and repeats.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    EquationUncertainty, InputUncertainty, KinematicModel, ObservationSet, Observations, Problem, Result,
    SettingsError, from_settings,
};
use abbe_estimation::{repeats, row_uncertainty};
use abbe_recipe::Stage;

/// Settings of the recipe for the uncertainty of an artefact's rows.
pub struct RowsOf {
    settings: InputUncertainty,
    covariance: Option<PathBuf>,
}

impl RowsOf {
    /// Reads and checks the settings of an artefact stage.
    pub fn new(stage: &Stage, base: &std::path::Path) -> Result<Self, SettingsError> {
        let settings: InputUncertainty = from_settings(&stage.input_uncertainty)?;
        row_uncertainty::check(&settings)?;
        if settings.pooled.is_none() && !stage.reference("repeats").is_empty() {
            return Err(SettingsError::new(
                "repeats",
                "`repeats` are there to be `pooled`; say by what, `pooled: { by: cycle }`",
            ));
        }
        let named = settings.uncertainty.as_ref().and_then(|rows| rows.covariance.as_ref());
        Ok(Self { covariance: named.map(|path| base.join(path)), settings })
    }

    /// The file that the settings name.
    pub fn input(&self) -> Option<&PathBuf> {
        self.covariance.as_ref()
    }

    /// The rows of an artefact with their uncertainty. `repeats` are the observations of its repeats, if it has some.
    pub fn set(
        &self,
        name: &str,
        observations: Arc<dyn Observations>,
        repeats: Option<Arc<dyn Observations>>,
        model: &Arc<dyn KinematicModel>,
    ) -> Result<ObservationSet> {
        let layout = &observations.info().layout;
        let mut uncertainty = EquationUncertainty::independent(layout.standard_uncertainties.clone());
        if let Some(rows) = &self.settings.uncertainty {
            let table = self.covariance.as_ref().map(|path| abbe_table::read(path)).transpose()?;
            uncertainty = row_uncertainty::of_rows(rows, observations.as_ref(), table.as_ref())?;
        }
        if let Some(pooled) = &self.settings.pooled {
            let repeated = repeats.unwrap_or_else(|| observations.clone());
            // Only differences between repeats are needed, so residuals at nominal values are sufficient.
            let sets = vec![ObservationSet::new(name, repeated.clone())];
            let residuals = Problem::new(name, "", model.clone(), sets, &[])?.residuals(&[])?;
            uncertainty.pooled = Some(repeats::pooled(pooled, layout, &repeated.info().layout, &residuals)?);
        }
        let mut set = ObservationSet::new(name, observations);
        if let Some(ids) = &self.settings.id {
            set.ids = ids.of_inputs(&set.observations.info().inputs)?;
        }
        set.uncertainty = Arc::new(uncertainty);
        Ok(set)
    }
}
