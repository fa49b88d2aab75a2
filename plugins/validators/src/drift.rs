//! Whether residuals depend on time: the test for a drift that is not in the model.
//!
//! A drift of a tool set-up parameter p adds to every residual a polynomial in time times dr/dp. The residuals are regressed
//! on the part of it that the unknowns of the fit cannot produce. An F test gives the probability that chance explains as
//! much.

use std::collections::BTreeSet;

use abbe_core::{Fit, Owner, Problem, Quantity, Result, RowIndex, SetIndex, Unknown};
use abbe_numerics::{Accumulator, f_test};
use nalgebra::{DMatrix, DVector, DVectorView};

/// Tool set-up parameters that may drift.
const PARAMETERS: [&str; 3] = ["dxt", "dyt", "dzt"];
/// Highest degree in time.
pub const DEGREES: usize = 4;
/// Residuals below this part of their standard uncertainty are rounding: they may depend on time, but that has no meaning.
const ROUNDING: f64 = 1e-2;

/// What a drift of one parameter would explain.
#[derive(Debug, Clone, PartialEq)]
pub struct Drift {
    /// The parameter.
    pub parameter: &'static str,
    /// Number of terms in time that the model does not have yet.
    pub terms: usize,
    /// Part of the residuals' sum of squares that they would explain.
    pub share: f64,
    /// Probability of such a part without any drift.
    pub p: f64,
    /// RMS of the remaining residuals, relative to the standard uncertainties.
    pub sigma: f64,
}

/// Tests every tool set-up parameter; none where no row has a time or nothing is left to explain.
pub fn test(fit: &Fit, left_out: &BTreeSet<(SetIndex, RowIndex)>) -> Result<Vec<Drift>> {
    let problem = &fit.problem;
    let rows = problem.equation_rows();
    let Some(times) = scaled_times(problem, &rows) else { return Ok(Vec::new()) };
    // The derivatives to the parameters are needed whether the fit estimates them or not.
    let mut extended = Problem::clone(problem);
    let mut tested: Vec<(&'static str, usize)> = Vec::new();
    for name in PARAMETERS {
        let parameters = &problem.model.info().parameters;
        let Some(index) = parameters.iter().position(|parameter| parameter.name == name) else { continue };
        let known = extended.unknowns.iter().position(|unknown| unknown.name == name);
        tested.push((name, known.unwrap_or(extended.unknowns.len())));
        if known.is_none() {
            let unit = parameters[index].unit;
            extended.unknowns.push(Unknown { name: name.to_owned(), unit, owner: Owner::Machine, index });
        }
    }
    let own = problem.unknowns.len();
    let uncertainties = problem.standard_uncertainties();
    // The residual is treated as another column: only the inner products of all columns count.
    let columns = own + DEGREES * tested.len() + 1;
    let mut accumulator = Accumulator::new(columns, rows.len());
    let mut entries = Vec::new();
    extended.linearise_compact(&extended.values_of(&fit.calibration), |block| {
        let count = block.unknowns.partition_point(|unknown| *unknown < own);
        let present: Vec<usize> = block.unknowns[..count].iter().copied().chain(own..columns).collect();
        let places = tested.iter().map(|(_, column)| block.unknowns.binary_search(column).ok());
        let places: Vec<Option<usize>> = places.collect();
        for (equation, residual, line) in block.lines() {
            if left_out.contains(&rows[equation]) {
                continue;
            }
            entries.clear();
            entries.extend_from_slice(&line[..count]);
            for place in &places {
                let derivative = place.map_or(0.0, |place| line[place]);
                entries.extend(legendre(times[equation]).map(|value| value * derivative));
            }
            entries.push(residual);
            accumulator.push_some(&present, &entries, 0.0, 1.0 / uncertainties[equation]);
        }
    })?;
    let factor = accumulator.finish();
    let count = factor.rows();
    let columns: Vec<DVector<f64>> = (0..columns).map(|column| DVector::from_vec(factor.column(column))).collect();
    let factor = DMatrix::from_columns(&columns);
    if count == 0 || factor.iter().any(|entry| !entry.is_finite()) {
        return Ok(Vec::new());
    }
    // The first rows of the triangle span what the unknowns can produce, if the rows determine them.
    let jacobian = match fit.calibration.fit.rank == own {
        true => DMatrix::identity(factor.nrows(), own),
        false => basis(factor.columns(0, own).column_iter(), 1e-10),
    };
    Ok(judge(&factor, &jacobian, own, count, &tested))
}

/// The test on the triangular factor of `[J | candidates | r]`, whose columns have the same inner products, with an
/// orthonormal basis of the columns of J.
fn judge(
    factor: &DMatrix<f64>,
    jacobian: &DMatrix<f64>,
    own: usize,
    rows: usize,
    tested: &[(&'static str, usize)],
) -> Vec<Drift> {
    let rest = orthogonal(factor.column(factor.ncols() - 1), jacobian);
    let freedom = rows.saturating_sub(jacobian.ncols());
    let squares = rest.norm_squared();
    if freedom == 0 || squares <= ROUNDING * ROUNDING * freedom as f64 {
        return Vec::new();
    }
    let mut found = Vec::new();
    for (index, (parameter, _)) in tested.iter().enumerate() {
        let candidates = (0..DEGREES).map(|degree| factor.column(own + index * DEGREES + degree));
        if let Some(Explained { terms, share, p, sigma }) = explained(&beyond(candidates, jacobian), &rest, freedom) {
            found.push(Drift { parameter, terms, share, p, sigma });
        }
    }
    found
}

/// What columns do that J cannot: an orthonormal basis. A column that J has already is only rounding after projection.
pub fn beyond<'a>(columns: impl Iterator<Item = DVectorView<'a, f64>>, jacobian: &DMatrix<f64>) -> DMatrix<f64> {
    let new = columns.map(|column| (orthogonal(column, jacobian), column.norm()));
    let new: Vec<DVector<f64>> = new.filter(|(part, norm)| part.norm() > 1e-6 * norm).map(|(part, _)| part).collect();
    basis(new.iter().map(DVector::as_view), 1e-6)
}

/// What some directions explain of residuals.
pub struct Explained {
    /// Number of directions.
    pub terms: usize,
    /// Part of the sum of squares that they explain.
    pub share: f64,
    /// Probability that chance explains as much, for independent rows (F test).
    pub p: f64,
    /// RMS of what would remain, over what the standard uncertainties promise.
    pub sigma: f64,
}

/// What orthonormal directions explain of weighted residuals with so many degrees of freedom; none without directions, or if none of
/// these are left.
pub fn explained(directions: &DMatrix<f64>, residuals: &DVector<f64>, freedom: usize) -> Option<Explained> {
    let (terms, squares) = (directions.ncols(), residuals.norm_squared());
    let left = freedom.checked_sub(terms).filter(|left| terms > 0 && *left > 0)?;
    let explained = (directions.transpose() * residuals).norm_squared().min(squares);
    let unexplained = ((squares - explained) / left as f64).max(f64::MIN_POSITIVE);
    let ratio = (explained / terms as f64 / unexplained).min(f64::MAX);
    let p = f_test(ratio, terms, left)?;
    Some(Explained { terms, share: explained / squares, p, sigma: unexplained.sqrt() })
}

/// Orthonormal basis of the space of some columns. Columns are scaled to norm 1; directions whose singular value is below
/// `tolerance` times the largest are left out.
pub fn basis<'a>(columns: impl Iterator<Item = DVectorView<'a, f64>>, tolerance: f64) -> DMatrix<f64> {
    let columns: Vec<DVector<f64>> =
        columns.filter(|column| column.norm() > 0.0).map(|column| column / column.norm()).collect();
    let Some(height) = columns.first().map(DVector::len) else { return DMatrix::zeros(0, 0) };
    let svd = DMatrix::from_columns(&columns).svd(true, false);
    let rank = svd.singular_values.iter().filter(|value| **value > tolerance * svd.singular_values[0]).count();
    svd.u.map_or_else(|| DMatrix::zeros(height, 0), |u| u.columns(0, rank).into_owned())
}

/// The part of a column that is orthogonal to a basis.
pub fn orthogonal(column: DVectorView<'_, f64>, basis: &DMatrix<f64>) -> DVector<f64> {
    let mut part = column.into_owned();
    if basis.ncols() == 0 {
        return part;
    }
    // The second pass removes the rounding of the first one.
    for _ in 0..2 {
        part -= basis * (basis.transpose() * &part);
    }
    part
}

/// Time of every equation's row, scaled to -1..1 over all rows that have one; NaN for those without.
pub fn scaled_times(problem: &Problem, rows: &[(SetIndex, RowIndex)]) -> Option<Vec<f64>> {
    let of_set: Vec<Option<&[f64]>> = (problem.sets.iter())
        .map(|set| {
            let data = &set.info().layout.data;
            data.column("time").filter(|column| column.header.quantity == Quantity::Time)?;
            data.numbers("time")
        })
        .collect();
    let time = |&(set, row): &(SetIndex, RowIndex)| {
        let data_row = problem.sets[set].info().layout.rows[row].data_row?;
        Some(of_set[set.0]?[data_row])
    };
    let times: Vec<f64> = rows.iter().map(|row| time(row).unwrap_or(f64::NAN)).collect();
    // f64::min and f64::max pass over NaN.
    let first = times.iter().copied().fold(f64::INFINITY, f64::min);
    let last = times.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (last > first).then(|| times.iter().map(|time| 2.0 * (time - first) / (last - first) - 1.0).collect())
}

/// Legendre polynomials of degree 1 to [`DEGREES`]; zero without a time.
pub fn legendre(t: f64) -> [f64; DEGREES] {
    if t.is_nan() {
        return [0.0; DEGREES];
    }
    let square = t * t;
    [t, 1.5 * square - 0.5, (2.5 * square - 1.5) * t, (35.0 * square * square - 30.0 * square + 3.0) / 8.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_are_orthogonal() {
        let count = 20_000;
        let mut sums = [[0.0; DEGREES]; DEGREES];
        for i in 0..count {
            let values = legendre((f64::from(2 * i + 1)) / f64::from(count) - 1.0);
            for (row, a) in values.iter().enumerate() {
                for (column, b) in values.iter().enumerate() {
                    sums[row][column] += a * b * 2.0 / f64::from(count);
                }
            }
        }
        for (row, line) in sums.iter().enumerate() {
            for (column, sum) in line.iter().enumerate() {
                let expected = if row == column { 2.0 / (2.0 * (row as f64 + 1.0) + 1.0) } else { 0.0 };
                assert!((sum - expected).abs() < 1e-6, "{row} {column}");
            }
        }
    }

    #[test]
    fn the_test_is_that_of_a_regression_on_what_the_fit_leaves() {
        // J = constant; candidate = t; residual = 1 + 2 t + e with e orthogonal to both: explained and rest are known.
        let t = [-3.0, -1.0, 1.0, 3.0];
        let e = [1.0, -1.0, -1.0, 1.0];
        let mut matrix = DMatrix::zeros(4, 2 + DEGREES);
        for row in 0..4 {
            matrix[(row, 0)] = 1.0;
            matrix[(row, 1)] = t[row];
            matrix[(row, 1 + DEGREES)] = 1.0 + 2.0 * t[row] + e[row];
        }
        let jacobian = basis(matrix.columns(0, 1).column_iter(), 1e-10);
        let found = judge(&matrix, &jacobian, 1, 4, &[("dzt", 0)]);
        let [drift] = found.as_slice() else { panic!("{found:?}") };
        assert_eq!((drift.parameter, drift.terms), ("dzt", 1));
        assert!((drift.share - 80.0 / 84.0).abs() < 1e-12);
        assert!((drift.p - f_test(80.0 / (4.0 / 2.0), 1, 2).unwrap()).abs() < 1e-12);
    }
}
