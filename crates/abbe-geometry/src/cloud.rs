//! Points made ready for a fit: checked, centred, scaled, with their principal directions.

use nalgebra::{DMatrix, DVector, SVector};

use crate::error::FitError;

/// A spread below this part of the largest spread counts as zero: the points are flat in that direction.
const FLAT: f64 = 1e-10;

/// Number of rounding errors of coordinates that a spread may accumulate.
const ROUNDINGS: f64 = 8.0;

/// Centred and scaled points.
pub struct Cloud<const D: usize> {
    /// Mean of the points.
    pub centroid: SVector<f64, D>,
    /// Root mean square distance from the centroid.
    pub scale: f64,
    /// The points minus the centroid, divided by the scale.
    pub points: Vec<SVector<f64, D>>,
    /// Directions of the largest to the smallest spread.
    pub directions: Vec<SVector<f64, D>>,
    /// Spread in these directions, relative to the largest.
    spreads: Vec<f64>,
    /// Relative spread that rounding of the coordinates alone can make.
    rounding: f64,
}

impl<const D: usize> Cloud<D> {
    /// Fails for fewer points than `needed`, coordinates that are not finite and points that all coincide.
    pub fn of(shape: &'static str, needed: usize, points: &[SVector<f64, D>]) -> Result<Self, FitError> {
        if points.len() < needed {
            return Err(FitError::TooFew { shape, needed, found: points.len() });
        }
        if let Some(point) = points.iter().position(|point| point.iter().any(|value| !value.is_finite())) {
            return Err(FitError::NotFinite { point });
        }
        // Sums differences from the first point: a plain sum of coordinates far from the origin would lose digits.
        let count = points.len() as f64;
        let centroid = points[0] + points.iter().map(|point| point - points[0]).sum::<SVector<f64, D>>() / count;
        let centred: Vec<SVector<f64, D>> = points.iter().map(|point| point - centroid).collect();
        let scale = (centred.iter().map(SVector::norm_squared).sum::<f64>() / count).sqrt();
        let far = points.iter().map(SVector::amax).fold(0.0, f64::max);
        if scale <= ROUNDINGS * f64::EPSILON * far || !scale.is_normal() {
            return Err(FitError::Undetermined { shape, because: "they coincide" });
        }
        let points: Vec<SVector<f64, D>> = centred.iter().map(|point| point / scale).collect();
        let (singular_values, directions) = right_singular(points.len(), D, |row, column| points[row][column]);
        let spreads = singular_values.iter().map(|value| value / singular_values[0]).collect();
        let directions = directions.iter().map(|direction| SVector::from_column_slice(direction.as_slice())).collect();
        let rounding = ROUNDINGS * f64::EPSILON * far / scale;
        Ok(Self { centroid, scale, points, directions, spreads, rounding })
    }

    /// Whether the points do not spread in the direction with this index.
    pub fn is_flat(&self, direction: usize) -> bool {
        self.spreads[direction] <= FLAT.max(self.rounding)
    }

    /// Whether the two largest spreads are equal, so that the points have no main direction.
    pub fn is_round(&self) -> bool {
        1.0 - self.spreads[1] <= FLAT.max(self.rounding)
    }

    /// Converts scaled coordinates to coordinates of the points.
    pub fn place(&self, scaled: SVector<f64, D>) -> SVector<f64, D> {
        self.centroid + scaled * self.scale
    }
}

/// Singular values and right singular vectors of a matrix, the largest first. Rows of zeros fill up what is missing to a
/// full set of vectors.
pub fn right_singular(
    rows: usize,
    columns: usize,
    entry: impl Fn(usize, usize) -> f64,
) -> (Vec<f64>, Vec<DVector<f64>>) {
    let filled = |row, column| if row < rows { entry(row, column) } else { 0.0 };
    let svd = DMatrix::from_fn(rows.max(columns), columns, filled).qr().r().svd(false, true);
    let vectors = svd.v_t.map(|vectors| vectors.row_iter().map(|vector| vector.transpose()).collect());
    (svd.singular_values.as_slice().to_vec(), vectors.unwrap_or_default())
}
