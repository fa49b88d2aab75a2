//! Weighted least squares with few columns.

use nalgebra::{DMatrix, DVector};

/// The result of a fit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Solution {
    /// One value for each column.
    pub values: DVector<f64>,
    /// Their covariance, of the stated standard uncertainties.
    pub covariance: DMatrix<f64>,
    /// Sum of the squared residuals over their standard uncertainties.
    pub chi_squared: f64,
}

impl Solution {
    /// Value and standard uncertainty of one column.
    pub fn value(&self, column: usize) -> (f64, f64) {
        (self.values[column], self.covariance[(column, column)].max(0.0).sqrt())
    }
}

/// Fits columns to values with standard uncertainties; none if the columns are not independent.
pub(crate) fn fit(columns: &[Vec<f64>], values: &[f64], uncertainties: &[f64]) -> Option<Solution> {
    let rows = values.len();
    let weighted = |column: &[f64]| DVector::from_fn(rows, |row, _| column[row] / uncertainties[row]);
    let target = weighted(values);
    if columns.is_empty() {
        let chi_squared = target.norm_squared();
        return Some(Solution { values: DVector::zeros(0), covariance: DMatrix::zeros(0, 0), chi_squared });
    }
    let weighted: Vec<DVector<f64>> = columns.iter().map(|column| weighted(column)).collect();
    let norms: Vec<f64> = weighted.iter().map(DVector::norm).collect();
    if rows < columns.len() || norms.iter().any(|norm| !(*norm > 0.0 && norm.is_finite())) {
        return None;
    }
    let scaled: Vec<DVector<f64>> = weighted.iter().zip(&norms).map(|(column, norm)| column / *norm).collect();
    let matrix = DMatrix::from_columns(&scaled);
    let factor = matrix.clone().qr();
    let triangle = factor.r();
    if (0..columns.len()).any(|index| triangle[(index, index)].abs() < 1e-9) {
        return None;
    }
    let solution = triangle.solve_upper_triangular(&(factor.q().transpose() * &target))?;
    let chi_squared = (&target - &matrix * &solution).norm_squared();
    let inverse = triangle.solve_upper_triangular(&DMatrix::identity(columns.len(), columns.len()))?;
    let covariance = &inverse * inverse.transpose();
    Some(Solution {
        values: DVector::from_fn(columns.len(), |index, _| solution[index] / norms[index]),
        covariance: DMatrix::from_fn(columns.len(), columns.len(), |i, j| covariance[(i, j)] / (norms[i] * norms[j])),
        chi_squared,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_straight_line_is_that_of_the_closed_form() {
        let times = [1.0, 2.0, 4.0, 7.0];
        let values = [2.0, 3.0, 5.5, 8.0];
        let solution = fit(&[vec![1.0; 4], times.to_vec()], &values, &[0.5; 4]).unwrap();
        // Slope = Sxy / Sxx, u(slope) = u / sqrt(Sxx), about the mean 3.5 with Sxx = 21.
        let products: f64 = times.iter().zip(values).map(|(time, value)| (time - 3.5) * value).sum();
        assert!((solution.value(1).0 - products / 21.0).abs() < 1e-12);
        assert!((solution.value(1).1 - 0.5 / 21f64.sqrt()).abs() < 1e-12);
        assert_eq!(fit(&[vec![1.0; 4], vec![2.0; 4]], &values, &[0.5; 4]), None);
        assert_eq!(fit(&[vec![0.0; 4]], &values, &[0.5; 4]), None);
    }
}
