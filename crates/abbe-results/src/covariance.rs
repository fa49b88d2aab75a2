//! A covariance whose rows and columns have names.

use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Covariance of named values, in the units of these.
///
/// ```
/// use abbe_results::NamedCovariance;
///
/// let order = ["EXX[1]", "EC0Y"].map(str::to_owned).to_vec();
/// let known = NamedCovariance { order, rows: vec![vec![4.0, 3.0], vec![3.0, 9.0]] };
/// assert_eq!(known.variance("EC0Y"), Some(9.0));
/// assert_eq!(known.correlation("EXX[1]", "EC0Y"), Some(0.5));
/// // What is not known has no covariance with anything.
/// assert_eq!(known.block(&["EC0Y", "dxt"]).as_slice(), [9.0, 0.0, 0.0, 0.0]);
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct NamedCovariance {
    /// Names, in the order of rows and columns.
    pub order: Vec<String>,
    /// The full symmetric matrix.
    pub rows: Vec<Vec<f64>>,
}

impl NamedCovariance {
    /// The row, and column, of a value; none if it has none.
    pub fn index(&self, name: &str) -> Option<usize> {
        self.order.iter().position(|known| known == name)
    }

    /// The variance of a value; none if it is not known.
    pub fn variance(&self, name: &str) -> Option<f64> {
        self.index(name).map(|index| self.rows[index][index])
    }

    /// The correlation of two values, from -1 to 1; none if one of them is not known or has no variance.
    pub fn correlation(&self, one: &str, other: &str) -> Option<f64> {
        let (row, column) = (self.index(one)?, self.index(other)?);
        let scale = (self.rows[row][row] * self.rows[column][column]).sqrt();
        (scale > 0.0).then(|| self.rows[row][column] / scale)
    }

    /// Adds a value that is another one times a factor, unless it is there.
    pub fn add_multiple(&mut self, of: &str, name: &str, factor: f64) {
        let (Some(place), None) = (self.index(of), self.index(name)) else { return };
        let mut row: Vec<f64> = self.rows[place].iter().map(|entry| entry * factor).collect();
        self.rows.iter_mut().zip(&row).for_each(|(line, entry)| line.push(*entry));
        row.push(self.rows[place][place] * factor * factor);
        self.rows.push(row);
        self.order.push(name.to_owned());
    }

    /// The covariance of some values, in the order of `names`; zero for those that are not known.
    pub fn block<S: AsRef<str>>(&self, names: &[S]) -> DMatrix<f64> {
        let places: Vec<Option<usize>> = names.iter().map(|name| self.index(name.as_ref())).collect();
        DMatrix::from_fn(names.len(), names.len(), |row, column| match (places[row], places[column]) {
            (Some(row), Some(column)) => self.rows[row][column],
            _ => 0.0,
        })
    }
}
