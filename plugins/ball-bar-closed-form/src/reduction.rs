//! From the samples of a test to a constant, a cosine and a sine.

use nalgebra::{DMatrix, DVector, Matrix3, Vector2, Vector3};

use crate::sweep::Sweep;

/// The least squares projection of samples on a constant, the cosine and the sine of the angle.
#[derive(Debug, Clone)]
pub struct Projection {
    /// 3 x samples.
    matrix: DMatrix<f64>,
}

impl Projection {
    /// For the angles of a test. The arc has to be long enough for three numbers.
    pub fn new(angles: &[f64]) -> Self {
        let columns: Vec<Vector3<f64>> =
            angles.iter().map(|angle| Vector3::new(1.0, angle.cos(), angle.sin())).collect();
        let normal: Matrix3<f64> = columns.iter().map(|column| column * column.transpose()).sum();
        let inverse = normal.try_inverse().unwrap_or_else(Matrix3::zeros);
        let matrix = DMatrix::from_fn(3, angles.len(), |row, sample| (inverse * columns[sample])[row]);
        Self { matrix }
    }

    /// Constant, cosine and sine of samples.
    pub fn of(&self, samples: impl Iterator<Item = f64>) -> Vector3<f64> {
        let samples = DVector::from_iterator(self.matrix.ncols(), samples);
        let found = &self.matrix * samples;
        Vector3::new(found[0], found[1], found[2])
    }

    /// The factor of a sample in one of the three numbers.
    pub fn entry(&self, number: usize, sample: usize) -> f64 {
        self.matrix[(number, sample)]
    }
}

/// The circle fitted to the polar plot of a test: its centre, and its radius.
///
/// The circle minimises the sum of `(Y² + Z² + aY + bZ + c)²` (Jiang & Cripps 2015, eq. 7; eq. 8 lacks a minus sign). With the extension
/// the lengths are taken down to the plane of the circle first, with the nominal height (eq. 11). None if a bar is shorter than that height.
pub fn polar_plot(sweep: &Sweep, lengths: &[f64]) -> Option<(Vector2<f64>, f64)> {
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for (angle, length) in sweep.angles.iter().zip(lengths) {
        let square = length * length - sweep.height * sweep.height;
        if square <= 0.0 {
            return None;
        }
        // In units of the radius, so that the three columns have one size.
        let plotted = square.sqrt() / sweep.radius;
        let row = Vector3::new(plotted * angle.cos(), plotted * angle.sin(), 1.0);
        normal += row * row.transpose();
        right += row * plotted * plotted;
    }
    let found = normal.try_inverse()? * right;
    let centre = Vector2::new(found[0], found[1]) / 2.0;
    let radius = (found[2] + centre.norm_squared()).sqrt();
    Some((centre * sweep.radius, radius * sweep.radius))
}
