//! Artefacts that are written in Python: residuals by a function, derivatives by differences. Slow: the interpreter
//! computes them, one thread at a time.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    Artefact, Build, ColumnHeader, Constructor, Contact, Dataset, Equations, Error, InputFile, KinematicModel,
    LabelText, Layout, Observations, ObservationsInfo, Origin, Parameter, Plugin, Provider, Quantity, RankPoint,
    Result, RowBatch, RowIndex, SettingsError, Target, Unit, Values, plain_naming, pose_columns, positive,
};
use pyo3::buffer::PyBuffer;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{Value, json};

use crate::columns::bytes_of;
use crate::failure::of_python;

/// Steps of differences: mm for tips and lengths, rad for angles, and for all else this part of 1.
const STEP_MM: f64 = 1e-3;
const STEP: f64 = 1e-6;

/// Why such rows cannot be simulated.
const NOT_SIMULATED: &str = "an artefact in Python says nothing of how it is touched";

/// What `@abbe.artefact` says of an artefact.
pub struct Definition {
    object: Py<PyAny>,
    name: String,
    about: String,
    equations: usize,
    unknowns: Vec<Parameter>,
    columns: Vec<String>,
    has_nominal_tip: bool,
}

impl Definition {
    /// Reads it off the object of Python.
    pub fn of(object: &Bound<'_, PyAny>) -> PyResult<Self> {
        let unknowns: Vec<(String, String)> = object.call_method0("_unknowns")?.extract()?;
        let unknown = |(name, unit): (String, String)| -> PyResult<Parameter> {
            let unit = unit.parse::<Unit>().map_err(|error| PyValueError::new_err(format!("`{name}`: {error}")))?;
            Ok(Parameter::new(&name, unit))
        };
        Ok(Self {
            name: object.getattr("name")?.extract()?,
            about: object.getattr("about")?.extract()?,
            equations: object.getattr("equations")?.extract()?,
            unknowns: unknowns.into_iter().map(unknown).collect::<PyResult<_>>()?,
            columns: object.getattr("columns")?.extract()?,
            has_nominal_tip: !object.getattr("nominal_tips")?.is_none(),
            object: object.clone().unbind(),
        })
    }

    /// The plugin that recipes name.
    pub fn plugin(self: &Arc<Self>) -> Plugin {
        let definition = self.clone();
        let build = move |settings: &Value, _: &abbe_core::Context| -> Result<Box<dyn Artefact>, SettingsError> {
            let um = settings.get("standard_uncertainty_um").and_then(Value::as_f64).ok_or_else(|| {
                let message = "the setting `standard_uncertainty_um` is missing";
                SettingsError::new("standard_uncertainty_um", message)
            })?;
            positive("standard_uncertainty_um", um)?;
            let (definition, settings) = (definition.clone(), settings.clone());
            Ok(Box::new(InPython { definition, settings, standard_uncertainty: um * 1e-3 }))
        };
        Plugin {
            name: self.name.clone().into(),
            about: self.about.clone().into(),
            reference: "",
            version: env!("CARGO_PKG_VERSION").into(),
            origin: Origin::BuiltIn,
            schema: Provider::Value(json!({
                "type": "object",
                "properties": { "standard_uncertainty_um": { "type": "number" } },
                "required": ["standard_uncertainty_um"],
            })),
            example: Provider::Value(json!({ "standard_uncertainty_um": 1.0 })),
            build: Build::Artefact(Constructor::Dynamic(Arc::new(build))),
            estimate_source: abbe_core::EstimateSource::default(),
        }
    }
}

/// The stage.
struct InPython {
    definition: Arc<Definition>,
    settings: Value,
    /// mm, or rad.
    standard_uncertainty: f64,
}

impl Artefact for InPython {
    fn inputs(&self) -> Vec<InputFile> {
        Vec::new()
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &plain_naming)?;
        for column in &self.definition.columns {
            if !headers.iter().any(|header| header.header == *column) {
                let there: Vec<String> = headers.iter().map(|header| format!("`{}`", header.header)).collect();
                let message = format!("there is no column `{column}`; the columns are {}", there.join(", "));
                let error = Error::usage(message);
                return Err(file.map_or_else(|| error.clone(), |file| error.clone().in_file(file)));
            }
        }
        Ok(())
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        let model = model.as_ref();
        let mut layout = Layout::new(data, model, &[&plain_naming])?;
        for row in data.row_indices() {
            layout.push(model, row, &vec![self.standard_uncertainty; self.definition.equations])?;
        }
        let bound = Python::attach(|py| self.bind(py, data).map_err(|error| self.failed(py, &error)))?;
        let contact = Contact::NotSimulated(NOT_SIMULATED.to_owned());
        let mut info = ObservationsInfo::new(layout, self.definition.unknowns.clone(), contact);
        let mut nominal = None;
        if self.definition.has_nominal_tip {
            info.rank_point = RankPoint::InContact;
            let tips = Python::attach(|py| tips(bound.bind(py)).map_err(|error| self.failed(py, &error)))?;
            if tips.len() != data.rows() {
                let message = format!("`nominal_tips` gave {} tips for {} rows", tips.len(), data.rows());
                return Err(Error::data(message).fatal());
            }
            nominal = Some(tips);
        }
        Ok(Arc::new(Evaluated { definition: self.definition.clone(), info, bound, nominal }))
    }

    fn targets(&self, _stylus_radius: f64) -> Result<Vec<Target>> {
        Err(Error::usage(NOT_SIMULATED))
    }
}

impl InPython {
    fn failed(&self, py: Python<'_>, error: &PyErr) -> Error {
        of_python(py, &format!("artefact `{}`", self.definition.name), error)
    }

    /// The function with the columns of the data, in the units of their names.
    fn bind(&self, py: Python<'_>, data: &Dataset) -> PyResult<Py<PyAny>> {
        let columns = PyDict::new(py);
        for column in &data.columns {
            let (_, _, factor) = Quantity::of_column(&column.header.header);
            match &column.values {
                Values::Numbers(numbers) => {
                    let numbers: Vec<f64> = numbers.iter().map(|number| number / factor).collect();
                    columns.set_item(&column.header.header, bytes_of(py, &numbers)?)?;
                }
                Values::Labels(labels) => {
                    let labels: Vec<&str> = labels.iter().map(LabelText::as_str).collect();
                    columns.set_item(&column.header.header, labels)?;
                }
            }
        }
        let settings = py.import("json")?.call_method1("loads", (self.settings.to_string(),))?;
        Ok(self.definition.object.bind(py).call_method1("_bind", (columns, settings))?.unbind())
    }
}

/// The nominal tips of all rows.
fn tips(bound: &Bound<'_, PyAny>) -> PyResult<Vec<[f64; 3]>> {
    let numbers = numbers(&bound.call_method0("nominal_tips")?)?;
    Ok(numbers.as_chunks::<3>().0.to_vec())
}

fn numbers(value: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    PyBuffer::<f64>::get(value)?.to_vec(value.py())
}

struct Evaluated {
    definition: Arc<Definition>,
    info: ObservationsInfo,
    /// The function with the columns of the data.
    bound: Py<PyAny>,
    /// Nominal tips, row by row.
    nominal: Option<Vec<[f64; 3]>>,
}

impl Evaluated {
    /// The residuals of rows, equation by equation, for these tips and unknowns.
    fn residuals(&self, py: Python<'_>, rows: &[usize], tips: &[[f64; 3]], own: &[f64]) -> Result<Vec<f64>> {
        let tips = bytes_of(py, tips.as_flattened());
        let called = |tips| self.bound.bind(py).call_method1("residuals", (rows.to_vec(), tips, own.to_vec()));
        let found = tips.and_then(called).and_then(|found| numbers(&found));
        let found = found.map_err(|error| of_python(py, &format!("artefact `{}`", self.definition.name), &error))?;
        let expected = rows.len() * self.definition.equations;
        match found.len() == expected {
            true => Ok(found),
            false => Err(Error::data(format!("{} residuals; {expected} were expected", found.len())).fatal()),
        }
    }
}

/// Central differences of residuals.
fn difference(step: f64, at: impl Fn(f64) -> Result<Vec<f64>>) -> Result<Vec<f64>> {
    let (up, down) = (at(step)?, at(-step)?);
    Ok(up.iter().zip(&down).map(|(up, down)| (up - down) / (2.0 * step)).collect())
}

impl Observations for Evaluated {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        let rows: Vec<usize> = batch.rows.iter().map(|row| row.0).collect();
        Python::attach(|py| {
            let residuals = self.residuals(py, &rows, batch.positions, batch.own)?;
            let by_tip = [0, 1, 2].map(|axis| {
                difference(STEP_MM, |step| {
                    let mut tips = batch.positions.to_vec();
                    tips.iter_mut().for_each(|tip| tip[axis] += step);
                    self.residuals(py, &rows, &tips, batch.own)
                })
            });
            let [by_x, by_y, by_z] = by_tip;
            let (by_x, by_y, by_z) = (by_x?, by_y?, by_z?);
            let by_own = self.info.unknowns.iter().enumerate().map(|(index, unknown)| {
                let step = if unknown.unit == Unit::MM { STEP_MM } else { STEP };
                difference(step, |step| {
                    let mut own = batch.own.to_vec();
                    own[index] += step;
                    self.residuals(py, &rows, batch.positions, &own)
                })
            });
            let by_own = by_own.collect::<Result<Vec<_>>>()?;
            for (equation, residual) in residuals.iter().enumerate() {
                out.equation(*residual);
                out.position([by_x[equation], by_y[equation], by_z[equation]]);
                by_own.iter().enumerate().for_each(|(unknown, by)| out.own(unknown, by[equation]));
            }
            Ok(())
        })
    }

    fn contact_tip(&self, row: RowIndex, _tip: [f64; 3], _own: &[f64], _inputs: &[f64]) -> Result<Option<[f64; 3]>> {
        Ok(self.nominal.as_ref().map(|tips| tips[row.0]))
    }
}
