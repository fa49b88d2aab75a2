//! The rows of an artefact as the recipe states them: their uncertainty, from files and repeats, and which of them no estimate
//! uses.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    EquationUncertainty, Error, KinematicModel, ObservationSet, Observations, PathItem, Problem, Result, Row,
    SettingsError, from_settings_in_range,
};
use abbe_estimation::{RowSettings, repeats, row_uncertainty};
use abbe_recipe::Stage;

/// Which rows of an artefact are wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wanted {
    /// Those that estimates use.
    Seen,
    /// Those that validators predict: the unseen ones, or all where none is unseen.
    Predicted,
}

/// Settings of the recipe for an artefact's rows.
pub struct ArtefactRowSettings {
    settings: RowSettings,
    covariance: Option<PathBuf>,
}

impl ArtefactRowSettings {
    /// Reads and checks the settings of an artefact stage.
    pub fn new(stage: &Stage, base: &std::path::Path) -> Result<Self, SettingsError> {
        let settings: RowSettings = from_settings_in_range(&stage.row_settings)?;
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

    /// The wanted rows of an artefact with their uncertainty. `repeats` are the observations of its repeats, if it has some.
    pub fn set(
        &self,
        name: &str,
        observations: Arc<dyn Observations>,
        repeats: Option<Arc<dyn Observations>>,
        model: &Arc<dyn KinematicModel>,
        wanted: Wanted,
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
        if !self.settings.unseen.is_empty() {
            let unseen = self.unseen(&set)?;
            let predicted = wanted == Wanted::Predicted;
            set.rows.retain(|&row| unseen[row] == predicted);
        }
        Ok(set)
    }

    /// For every row of a set whether no estimate uses it. Constraints are statements of a certificate: they hold in any estimate.
    fn unseen(&self, set: &ObservationSet) -> Result<Vec<bool>> {
        let layout = &set.info().layout;
        let mut unseen = vec![false; layout.rows.len()];
        for (column, listed) in &self.settings.unseen {
            let setting = ["unseen", column].map(|key| PathItem::Key(key.to_owned()));
            let labels = abbe_table::labels(&layout.data, column);
            let labels = labels.map_err(|error| Error { setting: setting.to_vec(), ..error })?;
            let label_of = |row: &Row| row.data_row.map(|data_row| labels[data_row].as_str());
            for (index, label) in listed.iter().enumerate() {
                let mut found = false;
                for (unseen, row) in unseen.iter_mut().zip(&layout.rows) {
                    if label_of(row) == Some(label.0.as_str()) {
                        (*unseen, found) = (true, true);
                    }
                }
                if !found {
                    let message = format!("no row of `{}` has the {column} {}", set.name, label.0);
                    let mut error = Error::data(message).suggest(&label.0, layout.rows.iter().filter_map(label_of));
                    error.setting = setting.iter().cloned().chain([PathItem::Index(index)]).collect();
                    return Err(error);
                }
            }
        }
        let measured = |row: &Row| row.data_row.is_some();
        if layout.rows.iter().zip(&unseen).all(|(row, unseen)| *unseen || !measured(row)) {
            let message = format!("every row of `{}` is unseen: nothing is left to estimate from", set.name);
            return Err(Error::data(message).setting("unseen"));
        }
        Ok(unseen)
    }
}
