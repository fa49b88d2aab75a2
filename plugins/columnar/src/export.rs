//! Exporter `parquet`: residuals, parameters, covariances, samples and the volumetric error as Parquet files.

use abbe_core::{Calibration, Context, Export, ExportedFile, Fit, KinematicModel, PathItem, Result, SettingsError};
use abbe_volumetric::Grid;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::format::{self, Format};
use crate::tables::{self, Table};

abbe_core::register!(
    Export,
    "parquet",
    "residuals, parameters, covariances, samples and the volumetric error with all digits, as Parquet",
    Settings,
    example,
    build,
    "../reference/export-parquet.md",
);

/// Settings of the tables.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The tables that are written for every estimate.
    #[serde(default = "usual")]
    tables: Vec<Kind>,
    /// Poses at which the volumetric error is written, too.
    grid: Option<Grid>,
}

/// A table of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    /// The residuals of all rows.
    Residuals,
    /// Values and standard uncertainties.
    Parameters,
    /// The covariance matrix.
    Covariance,
    /// The trials of a Monte Carlo calculation with `keep_samples`.
    Samples,
}

fn usual() -> Vec<Kind> {
    vec![Kind::Residuals, Kind::Parameters, Kind::Covariance]
}

fn example() -> Value {
    json!({
        "tables": ["residuals", "parameters", "covariance"],
        "grid": { "points": 5, "axes": { "X": { "from_mm": -400, "to_mm": 400 } } }
    })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    format::check(Format::Parquet, abbe_core::Kind::Export)?;
    if let Some(grid) = &settings.grid {
        grid.check().map_err(|error| error.under([PathItem::Key("grid".to_owned())]))?;
    } else if settings.tables.is_empty() {
        return Err(SettingsError::new("tables", "at least one table, or a `grid`, was expected")
            .help("write `tables: [residuals]`"));
    }
    Ok(Box::new(Parquet { settings }))
}

struct Parquet {
    settings: Settings,
}

impl Parquet {
    /// The tables that a calibration tells without rows; `name` is that of the estimate.
    fn of_calibration(&self, name: &str, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<Table>> {
        let mut found = Vec::new();
        for kind in &self.settings.tables {
            match kind {
                Kind::Parameters => found.push(tables::parameters(name, calibration)),
                Kind::Covariance => found.push(tables::covariance(name, calibration)),
                Kind::Residuals | Kind::Samples => {}
            }
        }
        if let Some(grid) = &self.settings.grid {
            found.push(tables::volumetric(name, calibration, model, grid)?);
        }
        Ok(found)
    }
}

fn written(tables: &[Table]) -> Result<Vec<ExportedFile>> {
    let file =
        |table: &Table| Ok(ExportedFile { name: format!("{}.parquet", table.name), content: format::parquet(table)? });
    tables.iter().map(file).collect()
}

impl Export for Parquet {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        written(&self.of_calibration(&calibration.estimate, calibration, model)?)
    }

    fn export_fit(&self, fit: &Fit) -> Result<Vec<ExportedFile>> {
        let mut found = self.of_calibration(&fit.name, &fit.calibration, fit.problem.model.as_ref())?;
        for kind in &self.settings.tables {
            match kind {
                Kind::Residuals => found.push(tables::residuals(fit)?),
                Kind::Samples => found.push(tables::samples(&fit.name, &fit.calibration)?),
                Kind::Parameters | Kind::Covariance => {}
            }
        }
        written(&found)
    }
}
