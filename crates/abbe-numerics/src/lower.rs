//! Cholesky's triangle of small positive definite matrices.

/// The lower triangle L of a matrix L L'.
#[derive(Debug, Clone, PartialEq)]
pub struct Lower {
    size: usize,
    entries: Vec<f64>,
}

/// A pivot below this part of its diagonal entry is rounding.
const LEAST: f64 = 1e-12;

impl Lower {
    /// The triangle of a symmetric matrix, row by row; none if it is not positive definite.
    pub fn of(matrix: &[f64], size: usize) -> Option<Self> {
        let mut entries = matrix.to_vec();
        for row in 0..size {
            for column in 0..=row {
                let product = |k: usize| entries[row * size + k] * entries[column * size + k];
                let left = matrix[row * size + column] - (0..column).map(product).sum::<f64>();
                entries[row * size + column] = match row == column {
                    true if left > LEAST * matrix[row * size + row] && left.is_finite() => left.sqrt(),
                    true => return None,
                    false => left / entries[column * size + column],
                };
            }
        }
        Some(Self { size, entries })
    }

    /// Replaces a vector b by the solution of L x = b.
    pub fn solve(&self, vector: &mut [f64]) {
        for row in 0..self.size {
            let known: f64 = (0..row).map(|column| self.entries[row * self.size + column] * vector[column]).sum();
            vector[row] = (vector[row] - known) / self.entries[row * self.size + row];
        }
    }

    /// The logarithm of the determinant of the matrix.
    pub fn log_determinant(&self) -> f64 {
        (0..self.size).map(|row| 2.0 * self.entries[row * self.size + row].ln()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        let lower = Lower::of(&[4.0, 2.0, 2.0, 5.0], 2).expect("positive definite");
        assert!((lower.log_determinant() - 16.0_f64.ln()).abs() < 1e-15);
        let mut vector = [6.0, 7.0];
        lower.solve(&mut vector);
        assert_eq!(vector, [3.0, 2.0]);
        assert!(Lower::of(&[1.0, 1.0, 1.0, 1.0], 2).is_none());
        assert!(Lower::of(&[f64::NAN], 1).is_none());
        assert_eq!(Lower::of(&[], 0).expect("nothing").log_determinant(), 0.0);
    }
}
