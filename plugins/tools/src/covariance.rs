//! Covariance of dimensions, and of what is linear in them.

use nalgebra::DMatrix;

use crate::dimensions::Dimension;
use crate::wear::Line;

/// Covariance of dimensions, mm2: all of a quantity share the master's, and those of a session its readings.
pub fn of_dimensions(dimensions: &[Dimension], master_variance: f64) -> DMatrix<f64> {
    let count = dimensions.len();
    DMatrix::from_fn(count, count, |row, column| {
        let (one, other) = (&dimensions[row], &dimensions[column]);
        if one.quantity != other.quantity {
            return 0.0;
        }
        let mut covariance = master_variance;
        if one.session == other.session {
            for part in &one.parts {
                let same = other.parts.iter().find(|other| other.method == part.method);
                covariance += same.map_or(0.0, |other| part.weight * other.weight * part.of_master);
            }
        }
        if row == column {
            covariance += one.parts.iter().map(|part| part.weight.powi(2) * part.own).sum::<f64>();
        }
        covariance
    })
}

/// Covariance of dimensions and lines: dimensions first, then wear and size before the first cut of each line.
///
/// The lines have equal weights, so the uncertainty of a wear rate is that of readings that are equally good: the mean of
/// the variances counts. A factor on row and column brings that about and leaves correlations as they are.
pub fn with_lines(dimensions: &DMatrix<f64>, lines: &[Line]) -> DMatrix<f64> {
    let count = dimensions.nrows();
    let mut weights = DMatrix::zeros(count + 2 * lines.len(), count);
    weights.fill_with_identity();
    for (place, line) in lines.iter().enumerate() {
        for (index, [wear, new]) in &line.weights {
            weights[(count + 2 * place, *index)] = *wear;
            weights[(count + 2 * place + 1, *index)] = *new;
        }
    }
    let mut all = &weights * dimensions * weights.transpose();
    for (place, line) in lines.iter().enumerate() {
        let row = count + 2 * place;
        let factor = line.wear_uncertainty / all[(row, row)].sqrt();
        all.row_mut(row).scale_mut(factor);
        all.column_mut(row).scale_mut(factor);
    }
    // Products of matrices are symmetric up to rounding.
    (&all + all.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dimensions::Part;
    use crate::settings::Quantity;

    fn dimension(session: usize, quantity: Quantity, weights: [f64; 2]) -> Dimension {
        let part = |index: usize| Part {
            method: ["contact", "laser"][index].to_owned(),
            weight: weights[index],
            own: 1.0 + index as f64,
            of_master: 10.0 * (1.0 + index as f64),
        };
        Dimension { check: 0, session, quantity, value: 1.0, parts: vec![part(0), part(1)] }
    }

    #[test]
    fn tools_share_the_master_of_their_session() {
        use Quantity::{Length, Radius};
        let dimensions = [
            dimension(0, Length, [0.25, 0.75]),
            dimension(0, Length, [0.5, 0.5]),
            dimension(1, Length, [0.5, 0.5]),
            dimension(0, Radius, [0.5, 0.5]),
        ];
        let found = of_dimensions(&dimensions, 100.0);
        assert_eq!(found[(0, 1)], 100.0 + 0.25 * 0.5 * 10.0 + 0.75 * 0.5 * 20.0);
        assert_eq!(found[(0, 2)], 100.0);
        assert_eq!(found[(0, 3)], 0.0);
        assert_eq!(found[(1, 1)], 100.0 + 0.25 * 11.0 + 0.25 * 22.0);
    }
}
