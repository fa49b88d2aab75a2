//! Recipes: checked, run, and what a run found.

use std::path::{Path, PathBuf};
use std::time::Duration;

use abbe_core::{Error, Fit, Verdict};
use abbe_engine::REPORT;
use abbe_report::Residuals;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use serde_json::json;

use crate::calibration::Calibration;
use crate::columns::{Collected, Columns};
use crate::failure::{OrRaise, raised};
use crate::problem::Problem;
use crate::recipe::Asked;
use crate::work::at_work;

/// What the planned estimates of a recipe could determine, as JSON.
#[pyfunction]
#[pyo3(signature = (path, recipe=None, data=None, artefacts=Vec::new()))]
pub fn check(
    py: Python<'_>,
    path: PathBuf,
    recipe: Option<String>,
    data: Option<Bound<'_, PyDict>>,
    artefacts: Vec<Bound<'_, PyAny>>,
) -> PyResult<String> {
    let asked = Asked::new(path, recipe, data.as_ref(), artefacts)?;
    let planned = at_work(py, None, None, |monitor| asked.prepare()?.check_until(monitor))?;
    let planned = planned.iter().map(|planned| {
        json!({
            "estimate": planned.estimate, "accepted": planned.accepted, "machine": planned.machine,
            "identifiability": planned.identifiability,
        })
    });
    Ok(planned.collect::<serde_json::Value>().to_string())
}

/// Runs a recipe; nothing is written.
#[pyfunction]
#[pyo3(signature = (path, recipe=None, data=None, artefacts=Vec::new(), progress=None, time_limit_s=None))]
pub fn run(
    py: Python<'_>,
    path: PathBuf,
    recipe: Option<String>,
    data: Option<Bound<'_, PyDict>>,
    artefacts: Vec<Bound<'_, PyAny>>,
    progress: Option<Bound<'_, PyAny>>,
    time_limit_s: Option<f64>,
) -> PyResult<Outcome> {
    let asked = Asked::new(path, recipe, data.as_ref(), artefacts)?;
    let limit = time_limit_s.map(Duration::try_from_secs_f64).transpose();
    let limit = limit.map_err(|_| PyValueError::new_err("time_limit_s: a number of seconds above 0 was expected"))?;
    at_work(py, progress, limit, |monitor| {
        let mut outcome = asked.prepare()?.run(monitor)?;
        abbe::attach_report(&mut outcome);
        Ok(Outcome(outcome))
    })
}

/// What a run found.
#[pyclass(frozen, module = "abbe._abbe")]
pub struct Outcome(abbe_engine::Outcome);

impl Outcome {
    fn fit(&self, name: &str) -> PyResult<&Fit> {
        let missing = || PyValueError::new_err(format!("there is no estimate `{name}`"));
        self.0.fits.iter().find(|fit| fit.name == name).ok_or_else(missing)
    }
}

#[pymethods]
impl Outcome {
    /// Name of the recipe.
    #[getter]
    fn recipe(&self) -> &str {
        &self.0.recipe
    }

    /// What the recipe says that it is.
    #[getter]
    fn title(&self) -> &str {
        &self.0.title
    }

    /// Names of the estimates.
    #[getter]
    fn estimates(&self) -> Vec<&str> {
        self.0.fits.iter().map(|fit| fit.name.as_str()).collect()
    }

    /// "pass", "inconclusive" or "fail".
    #[getter]
    fn decision(&self) -> String {
        self.0.decision().to_string()
    }

    /// Whether no stage failed and no verdict fails.
    #[getter]
    fn passes(&self) -> bool {
        self.0.passes()
    }

    /// The record of the run, as in `run.json`.
    fn record(&self, py: Python<'_>) -> PyResult<String> {
        let text = serde_json::to_string(&self.0.record());
        text.map_err(|error| raised(py, &Error::data(error.to_string())))
    }

    /// The exceptions of stages that failed themselves: stage and exception.
    fn failures(&self, py: Python<'_>) -> Vec<(String, Py<PyAny>)> {
        let own = self.0.failures.iter().filter(|failure| failure.needs.is_none());
        let of = |error: &Error| raised(py, error).into_value(py).into_any();
        own.map(|failure| (failure.stage.clone(), of(&failure.error))).collect()
    }

    /// The verdicts: stage, plugin, decision, figures, remarks.
    fn verdicts(&self) -> PyResult<Vec<Told>> {
        self.0.verdicts.iter().map(verdict).collect()
    }

    /// Exported files and tables of validators: stage, name, content.
    fn exports<'py>(&self, py: Python<'py>) -> Vec<(String, String, Bound<'py, PyBytes>)> {
        let all = self.0.exports.iter().flat_map(|(stage, files)| files.iter().map(move |file| (stage, file)));
        all.map(|(stage, file)| (stage.clone(), file.name.clone(), PyBytes::new(py, &file.content))).collect()
    }

    /// The page about the run, HTML; None if it could not be made.
    fn report(&self) -> Option<String> {
        let page = self.0.attached.iter().find(|(name, _)| name == Path::new(REPORT))?;
        String::from_utf8(page.1.clone()).ok()
    }

    /// Writes the results into a folder named after the recipe in `out`, as `abbe run` does; gives that folder.
    fn write(&self, py: Python<'_>, out: PathBuf) -> PyResult<PathBuf> {
        py.detach(|| self.0.write(&out)).or_raise(py)
    }

    /// The calibration of an estimate.
    fn calibration(&self, name: &str) -> PyResult<Calibration> {
        let fit = self.fit(name)?;
        Ok(Calibration::new(fit.calibration.clone(), fit.problem.model.clone()))
    }

    /// The problem that an estimate solved.
    fn problem(&self, name: &str) -> PyResult<Problem> {
        Ok(Problem(self.fit(name)?.problem.clone()))
    }

    /// The residuals of an estimate, as in `<estimate>.residuals.csv`.
    fn residuals(&self, py: Python<'_>, name: &str) -> PyResult<Columns> {
        let fit = self.fit(name)?;
        let found = py.detach(|| Residuals::of(fit)).or_raise(py)?;
        residuals(&found)
    }
}

/// A verdict: stage, plugin, decision, figures, remarks.
type Told = (String, String, String, Columns, Vec<String>);

fn verdict(verdict: &Verdict) -> PyResult<Told> {
    let figures = &verdict.figures;
    let mut columns = Collected::default();
    columns.texts("of", figures.iter().map(|figure| figure.of.as_deref()));
    columns.texts("name", figures.iter().map(|figure| Some(&figure.name)));
    columns.some_numbers("value", figures.iter().map(|figure| figure.value).collect());
    columns.some_numbers("standard_uncertainty", figures.iter().map(|figure| figure.standard_uncertainty).collect());
    columns.texts("unit", figures.iter().map(|figure| Some(&figure.unit)));
    columns.some_numbers("limit", figures.iter().map(|figure| figure.limit).collect());
    columns.texts("decision", figures.iter().map(|figure| figure.decision.map(|decision| decision.to_string())));
    columns.texts("why_undecided", figures.iter().map(|figure| figure.inconclusive.as_deref()));
    let decision = verdict.decision.to_string();
    Ok((verdict.stage.clone(), verdict.plugin.clone(), decision, columns.finish()?, verdict.remarks.clone()))
}

fn residuals(found: &Residuals) -> PyResult<Columns> {
    let rows = &found.rows;
    let mut columns = Collected::default();
    let of = |is_angle: bool, value: fn(&abbe_report::Residual) -> f64| -> Vec<Option<f64>> {
        rows.iter().map(|row| (row.is_angle == is_angle).then(|| value(row))).collect()
    };
    columns.texts("stage", rows.iter().map(|row| Some(&row.stage)));
    columns.texts("file", rows.iter().map(|row| Some(&row.file)));
    columns.counts("line", rows.iter().map(|row| row.line));
    columns.counts("row", rows.iter().map(|row| row.row));
    columns.some_numbers("residual_um", of(false, |row| row.value));
    columns.some_numbers("uncertainty_um", of(false, |row| row.uncertainty));
    columns.some_numbers("residual_urad", of(true, |row| row.value));
    columns.some_numbers("uncertainty_urad", of(true, |row| row.uncertainty));
    columns.some_numbers("time_s", rows.iter().map(|row| row.time).collect());
    for (axis, name) in ["tip_x_mm", "tip_y_mm", "tip_z_mm"].into_iter().enumerate() {
        columns.some_numbers(name, rows.iter().map(|row| row.tip.map(|tip| tip[axis])).collect());
    }
    for (axis, name) in ["direction_x", "direction_y", "direction_z"].into_iter().enumerate() {
        columns.some_numbers(name, rows.iter().map(|row| row.direction.map(|direction| direction[axis])).collect());
    }
    for (index, name) in found.labels.iter().enumerate() {
        columns.texts(name, rows.iter().map(|row| row.labels.get(index)));
    }
    for (index, (axis, unit)) in found.axes.iter().enumerate() {
        columns.numbers(
            format!("{axis}_{unit}"),
            rows.iter().map(|row| row.commands.get(index).copied().unwrap_or(f64::NAN)).collect(),
        );
    }
    columns.finish()
}
