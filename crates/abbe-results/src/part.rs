//! What some of the rows of an estimate tell, where no process has all of them.

use serde::{Deserialize, Serialize};

use crate::weighed::WeighedSums;

/// The upper triangle of the QR decomposition of rows `[J | r]`: all that least squares needs of them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Triangle {
    /// The names of its columns; the residuals are one more, the last.
    pub columns: Vec<String>,
    /// Its rows, each from its diagonal on: n + 1 numbers, then n, ..., then 1, in units of the standard uncertainties of the rows.
    pub values: Vec<f64>,
    /// How many rows it is of.
    pub rows: usize,
}

impl Triangle {
    /// Its rows with the zeros before the diagonal: derivatives and, last, the residual. None if it has another number of values.
    pub fn lines(&self) -> Option<Vec<Vec<f64>>> {
        let width = self.columns.len() + 1;
        let mut rest = self.values.as_slice();
        let mut lines = Vec::with_capacity(width);
        for zeros in 0..width {
            let (own, others) = rest.split_at_checked(width - zeros)?;
            lines.push([&vec![0.0; zeros], own].concat());
            rest = others;
        }
        rest.is_empty().then_some(lines)
    }
}

/// Sums of the sizes of residuals, mm or rad.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SizeSums {
    /// Their number.
    pub count: usize,
    /// The largest absolute value.
    pub max: f64,
    /// The sum of absolute values.
    pub absolute: f64,
    /// The sum of squares.
    pub squares: f64,
}

impl SizeSums {
    /// The sums of some residuals.
    pub fn of(residuals: impl IntoIterator<Item = f64>) -> Self {
        residuals.into_iter().fold(Self::default(), |sums, residual| {
            let size = residual.abs();
            sums.with(&Self { count: 1, max: size, absolute: size, squares: size * size })
        })
    }

    /// The sums of these residuals and others.
    pub fn with(&self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            max: self.max.max(other.max),
            absolute: self.absolute + other.absolute,
            squares: self.squares + other.squares,
        }
    }
}

/// Sums of all residuals of some rows.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ResidualSums {
    /// Those of lengths, mm.
    pub lengths: SizeSums,
    /// Those of angles, rad.
    pub angles: SizeSums,
    /// The sum of their squares, each in units of its standard uncertainty, uncorrelated.
    pub weighted_squares: f64,
    /// Points in space: their number, and the sum of the squares of their distances, mm².
    pub points: (usize, f64),
}

impl ResidualSums {
    /// The root mean square of the distances of points in space, mm; none if there are none.
    pub fn radial_rms(&self) -> Option<f64> {
        let (points, squares) = self.points;
        (points > 0).then(|| (squares / points as f64).sqrt())
    }

    /// The sums of these rows and others.
    pub fn with(&self, other: &Self) -> Self {
        Self {
            lengths: self.lengths.with(&other.lengths),
            angles: self.angles.with(&other.angles),
            weighted_squares: self.weighted_squares + other.weighted_squares,
            points: (self.points.0 + other.points.0, self.points.1 + other.points.1),
        }
    }
}

/// What is asked of a part of the rows of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AskedOfPart {
    /// Its rows at the start values, and what they determine at all.
    Start,
    /// Its rows at some values of the unknowns.
    Rows,
    /// Its rows at the solution: residuals, and what the uncertainties follow from.
    Solution,
}

/// What a part of the rows of an estimate answers.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PartEvidence {
    /// The rows as they were recorded; none at the solution.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<Triangle>,
    /// The rows in nominal contact at nominal geometry, columns without effect zero; only at the start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nominal: Option<Triangle>,
    /// The rows of each artefact stage in nominal contact, with columns for what is considered, too; only at the solution.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub in_contact: Vec<(String, Triangle)>,
    /// The residuals; only at the solution.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residuals: Option<ResidualSums>,
    /// What robust weights make of the rows; only where rows were weighed.
    #[serde(skip)]
    pub weighed: Option<WeighedSums>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_have_their_zeros_again() {
        let columns = vec!["EXX[1]".to_owned(), "EYX[1]".to_owned()];
        let triangle = Triangle { columns, values: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0], rows: 7 };
        let lines = triangle.lines().unwrap();
        assert_eq!(lines, [vec![1.0, 2.0, 3.0], vec![0.0, 4.0, 5.0], vec![0.0, 0.0, 6.0]]);
        for count in [0, 5, 7] {
            assert_eq!(Triangle { values: vec![1.0; count], ..triangle.clone() }.lines(), None);
        }
    }

    #[test]
    fn sums_are_those_of_all() {
        let all = SizeSums::of([1.0, -3.0, 2.0]);
        assert_eq!(all, SizeSums { count: 3, max: 3.0, absolute: 6.0, squares: 14.0 });
        assert_eq!(SizeSums::of([1.0]).with(&SizeSums::of([-3.0, 2.0])), all);
    }
}
