//! Uncertainty of the equations of some observations: standard uncertainties and covariances.

use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::index::{EquationIndex, LayoutEquation};
use abbe_settings::{Error, Result};

/// Covariance of some equations with one another, which are those of a layout ([`LayoutEquation`]) or of a problem
/// ([`EquationIndex`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CovarianceBlock<E> {
    /// Indices of the equations, ascending.
    pub equations: Vec<E>,
    /// Their covariance, mm² (rad²), positive definite.
    #[serde(with = "matrix")]
    #[schemars(with = "Vec<Vec<f64>>")]
    pub covariance: DMatrix<f64>,
}

impl<E: Copy + Ord> CovarianceBlock<E> {
    /// A block for `equations`, in any order. Fails unless the matrix is finite, symmetric, positive definite, and has one
    /// row and column for each equation. `name` is the name of the covariance in messages.
    pub fn new(name: &str, equations: &[E], covariance: &DMatrix<f64>) -> Result<Self> {
        let size = equations.len();
        let (rows, columns) = covariance.shape();
        if (rows, columns) != (size, size) {
            return Err(Error::data(format!(
                "the covariance of {name} has {rows} rows and {columns} columns; {size} x {size} was expected"
            )));
        }
        if covariance.iter().any(|value| !value.is_finite()) {
            return Err(Error::data(format!("the covariance of {name} has an entry that is no finite number")));
        }
        for row in 0..size {
            if covariance[(row, row)] <= 0.0 {
                let message = format!(
                    "the covariance of {name} has the variance {} in row {}; a positive number was expected",
                    covariance[(row, row)],
                    row + 1
                );
                return Err(Error::data(message));
            }
            for column in 0..row {
                let (one, other) = (covariance[(row, column)], covariance[(column, row)]);
                let size = (covariance[(row, row)] * covariance[(column, column)]).abs().sqrt();
                if (one - other).abs() > 1e-9 * size {
                    return Err(Error::data(format!(
                        "the covariance of {name} is not symmetric: rows {} and {} have {other} one way and {one} the other",
                        column + 1,
                        row + 1
                    )));
                }
            }
        }
        let mut order: Vec<usize> = (0..size).collect();
        order.sort_by_key(|&index| equations[index]);
        let sorted = DMatrix::from_fn(size, size, |row, column| {
            let (row, column) = (order[row.max(column)], order[row.min(column)]);
            covariance[(row, column)]
        });
        let block = Self { equations: order.iter().map(|&index| equations[index]).collect(), covariance: sorted };
        let broken = || {
            Error::data(format!("the covariance of {name} is singular or has negative eigenvalues"))
                .help("a covariance is positive definite: no correlation of one, no combination without variance")
        };
        block.lower().map(|_| block.clone()).ok_or_else(broken)
    }

    /// The lower triangle L with `L L^T` = covariance; None where the matrix is numerically not positive definite.
    pub fn lower(&self) -> Option<DMatrix<f64>> {
        let size = self.covariance.nrows();
        let scale: Vec<f64> = (0..size).map(|row| self.covariance[(row, row)].sqrt()).collect();
        let correlation =
            DMatrix::from_fn(size, size, |row, column| self.covariance[(row, column)] / scale[row] / scale[column]);
        let mut lower = correlation.cholesky()?.unpack();
        // The factor is that of a correlation matrix. Its diagonal element is the conditional standard deviation of the row,
        // given the rows above.
        if (0..size).any(|row| lower[(row, row)] < 1e-6) {
            return None;
        }
        scale.iter().enumerate().for_each(|(row, scale): (usize, &f64)| lower.row_mut(row).scale_mut(*scale));
        Some(lower)
    }
}

/// Scatter of repeated measurements, pooled over groups (Rahman 2016, section 5.6).
///
/// The covariance of the equations is the sum of the outer products of the deviations, divided by the degrees of freedom. It
/// is of low rank (there are more rows than repeats). So it is propagated to the estimates, but gives no weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PooledRepeatability {
    /// The column whose groups are pooled.
    pub by: String,
    /// Labels of the repetitions.
    pub repetitions: Vec<String>,
    /// For every repetition the deviation of every equation from the mean of its group, mm (rad).
    pub deviations: Vec<Vec<f64>>,
    /// Number of repetitions less the number of groups.
    pub degrees_of_freedom: usize,
}

/// Uncertainty of the equations of some observations, in the order of their layout.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct EquationUncertainty {
    /// Standard uncertainty of every equation, mm (rad).
    pub standard: Vec<f64>,
    /// Equations that are correlated; blocks do not overlap, all other equations are independent.
    pub blocks: Vec<CovarianceBlock<LayoutEquation>>,
    /// The scatter of repeats. If there is one, it is propagated instead of the standard uncertainties; these are then
    /// weights only.
    pub pooled: Option<PooledRepeatability>,
}

impl EquationUncertainty {
    /// Independent equations.
    pub fn independent(standard: Vec<f64>) -> Self {
        Self { standard, ..Self::default() }
    }

    /// The covariances of some of the equations (ascending), which are equations of a problem from `first` on.
    pub fn blocks_of(&self, equations: &[LayoutEquation], first: EquationIndex) -> Vec<CovarianceBlock<EquationIndex>> {
        let mut place = vec![None; self.standard.len()];
        for (&equation, number) in equations.iter().zip(0..) {
            place[equation] = Some(first + number);
        }
        let mut blocks = Vec::new();
        for block in &self.blocks {
            let kept: Vec<(usize, EquationIndex)> = (block.equations.iter().enumerate())
                .filter_map(|(index, &equation)| Some((index, place[equation]?)))
                .collect();
            if kept.is_empty() {
                continue;
            }
            let covariance =
                DMatrix::from_fn(kept.len(), kept.len(), |row, column| block.covariance[(kept[row].0, kept[column].0)]);
            blocks.push(CovarianceBlock { equations: kept.iter().map(|kept| kept.1).collect(), covariance });
        }
        blocks
    }

    /// The scatter of repeats, of some of the equations.
    pub fn pooled_of(&self, equations: &[LayoutEquation]) -> Option<PooledRepeatability> {
        let pooled = self.pooled.as_ref()?;
        let pick = |values: &Vec<f64>| equations.iter().map(|&equation| values[equation]).collect();
        Some(PooledRepeatability { deviations: pooled.deviations.iter().map(pick).collect(), ..pooled.clone() })
    }
}

/// A matrix as a list of rows.
mod matrix {
    use nalgebra::DMatrix;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(matrix: &DMatrix<f64>, serializer: S) -> Result<S::Ok, S::Error> {
        let rows: Vec<Vec<f64>> = matrix.row_iter().map(|row| row.iter().copied().collect()).collect();
        rows.serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<DMatrix<f64>, D::Error> {
        let rows = Vec::<Vec<f64>>::deserialize(deserializer)?;
        let columns = rows.first().map_or(0, Vec::len);
        if rows.iter().any(|row| row.len() != columns) {
            return Err(D::Error::custom("the rows of a matrix have different lengths"));
        }
        Ok(DMatrix::from_fn(rows.len(), columns, |row, column| rows[row][column]))
    }
}
