//! Problems for estimators of one's own: residuals, derivatives, and factors of parts that are combined to that of
//! the whole.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{Error, Result, RowIndex, SetIndex};
use abbe_estimation::Weighted;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyDict};

use crate::columns::bytes_of;
use crate::failure::OrRaise;
use crate::recipe::Asked;
use crate::work::at_work;

/// The problems of the estimates of a recipe, by their names; nothing is solved.
#[pyfunction]
#[pyo3(signature = (path, recipe=None, data=None, artefacts=Vec::new()))]
pub fn problems(
    py: Python<'_>,
    path: PathBuf,
    recipe: Option<String>,
    data: Option<Bound<'_, PyDict>>,
    artefacts: Vec<Bound<'_, PyAny>>,
) -> PyResult<Vec<(String, Problem)>> {
    let asked = Asked::new(path, recipe, data.as_ref(), artefacts)?;
    let posed = at_work(py, None, None, |monitor| asked.prepare()?.posed(monitor))?;
    Ok(posed.into_iter().map(|(name, problem)| (name, Problem(Arc::new(problem)))).collect())
}

/// Model, observations, unknowns and rows.
#[pyclass(frozen, module = "abbe._abbe")]
pub struct Problem(pub Arc<abbe_core::Problem>);

impl Problem {
    fn check(&self, x: &[f64]) -> Result<()> {
        let expected = self.0.unknowns.len();
        match x.len() == expected {
            true => Ok(()),
            false => Err(Error::usage(format!("{} values; {expected} were expected, one for each unknown", x.len()))),
        }
    }
}

#[pymethods]
impl Problem {
    /// Names of the unknowns.
    #[getter]
    fn names(&self) -> Vec<&str> {
        self.0.unknowns.iter().map(|unknown| unknown.name.as_str()).collect()
    }

    /// Units of the unknowns.
    #[getter]
    fn units(&self) -> Vec<String> {
        self.0.unknowns.iter().map(|unknown| unknown.unit.to_string()).collect()
    }

    /// Number of equations.
    #[getter]
    fn equations(&self) -> usize {
        self.0.equations()
    }

    /// Number of rows.
    #[getter]
    fn rows(&self) -> usize {
        self.0.sets.iter().map(|set| set.rows.len()).sum()
    }

    /// Start values of the unknowns.
    fn start<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyByteArray>> {
        bytes_of(py, &self.0.start())
    }

    /// Standard uncertainties of the equations, mm or rad.
    fn uncertainties<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyByteArray>> {
        bytes_of(py, &self.0.standard_uncertainties())
    }

    /// Residuals at x, mm or rad.
    fn residuals<'py>(&self, py: Python<'py>, x: Vec<f64>) -> PyResult<Bound<'py, PyByteArray>> {
        let residuals = py.detach(|| self.check(&x).and_then(|()| self.0.residuals(&x))).or_raise(py)?;
        bytes_of(py, &residuals)
    }

    /// Residuals at x and their derivatives, equations x unknowns, row by row.
    fn linearise<'py>(
        &self,
        py: Python<'py>,
        x: Vec<f64>,
    ) -> PyResult<(Bound<'py, PyByteArray>, Bound<'py, PyByteArray>)> {
        let linearised = || -> Result<(Vec<f64>, Vec<f64>)> {
            self.check(&x)?;
            let (mut residuals, mut jacobian) = (Vec::new(), Vec::new());
            self.0.linearise(&x, |block| {
                residuals.extend_from_slice(block.residuals);
                jacobian.extend_from_slice(block.jacobian);
            })?;
            Ok((residuals, jacobian))
        };
        let (residuals, jacobian) = py.detach(linearised).or_raise(py)?;
        Ok((bytes_of(py, &residuals)?, bytes_of(py, &jacobian)?))
    }

    /// The triangular factor at x, of rows of unit variance.
    fn factor(&self, py: Python<'_>, x: Vec<f64>) -> PyResult<Factor> {
        let factor = || -> Result<abbe_numerics::Factor> {
            self.check(&x)?;
            Weighted::new(&self.0)?.factor(&x, None)
        };
        py.detach(factor).map(Factor).or_raise(py)
    }

    /// The problem in `count` parts, each with its share of the rows.
    fn parts(&self, py: Python<'_>, count: usize) -> PyResult<Vec<Self>> {
        parts(&self.0, count).map(|parts| parts.into_iter().map(|part| Self(Arc::new(part))).collect()).or_raise(py)
    }
}

/// Rows that follow each other go into one part.
fn parts(problem: &abbe_core::Problem, count: usize) -> Result<Vec<abbe_core::Problem>> {
    let rows: Vec<(SetIndex, RowIndex)> =
        SetIndex::enumerate(&problem.sets).flat_map(|(set, of)| of.rows.iter().map(move |row| (set, *row))).collect();
    if count == 0 || count > rows.len() {
        let message = format!("{count} parts of {} rows; from 1 to as many parts as rows were expected", rows.len());
        return Err(Error::usage(message));
    }
    if count > 1 && !problem.covariance_blocks().is_empty() {
        let error = Error::usage("rows of this problem are correlated, so that parts of it do not make the whole");
        return Err(error.help("take the factor of the whole problem"));
    }
    let part = |index: usize| {
        let own = &rows[rows.len() * index / count..rows.len() * (index + 1) / count];
        let of_set = |set: SetIndex| -> Vec<RowIndex> {
            own.iter().filter(|(other, _)| *other == set).map(|(_, row)| *row).collect()
        };
        problem.set_indices().fold(problem.clone(), |part, set| part.with_rows(set, of_set(set)))
    };
    Ok((0..count).map(part).collect())
}

/// The triangular factor of rows of unit variance: all that they tell of the unknowns.
#[pyclass(frozen, module = "abbe._abbe")]
pub struct Factor(abbe_numerics::Factor);

#[pymethods]
impl Factor {
    /// Number of rows that went in.
    #[getter]
    fn rows(&self) -> usize {
        self.0.rows()
    }

    /// Number of unknowns.
    #[getter]
    fn unknowns(&self) -> usize {
        self.0.unknowns()
    }

    /// Sum of squares of the weighted residuals.
    #[getter]
    fn cost(&self) -> f64 {
        self.0.cost()
    }

    /// The same after the full step.
    #[getter]
    fn remaining_cost(&self) -> f64 {
        self.0.remaining_cost()
    }

    /// The upper triangle R, row by row, and `Q^T r`.
    fn triangle<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyByteArray>, Bound<'py, PyByteArray>)> {
        let columns: Vec<Vec<f64>> = (0..self.0.unknowns()).map(|unknown| self.0.column(unknown)).collect();
        let rows: Vec<f64> = (0..columns.len()).flat_map(|row| columns.iter().map(move |column| column[row])).collect();
        Ok((bytes_of(py, &rows)?, bytes_of(py, self.0.right())?))
    }

    /// The Gauss-Newton step; None if an unknown has no effect.
    fn step<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyByteArray>>> {
        self.0.step().map(|step| bytes_of(py, &step)).transpose()
    }
}

/// The factor of all rows of several factors.
#[pyfunction]
pub fn combine(factors: Vec<PyRef<'_, Factor>>) -> PyResult<Factor> {
    let all: Vec<&abbe_numerics::Factor> = factors.iter().map(|factor| &factor.0).collect();
    abbe_numerics::Factor::combined(&all)
        .map(Factor)
        .ok_or_else(|| PyValueError::new_err("factors of the same unknowns were expected, at least one"))
}
