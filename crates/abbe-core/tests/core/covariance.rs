//! Covariance blocks of equations.

use abbe_core::{CovarianceBlock, EquationIndex, EquationUncertainty, LayoutEquation, Result};
use nalgebra::DMatrix;

fn block(equations: &[usize], entries: &[f64]) -> Result<CovarianceBlock<LayoutEquation>> {
    let size = (entries.len() as f64).sqrt() as usize;
    let equations: Vec<_> = equations.iter().copied().map(LayoutEquation).collect();
    CovarianceBlock::new("the rows", &equations, &DMatrix::from_row_slice(size, entries.len() / size, entries))
}

#[test]
fn matrices_that_are_no_covariance_are_refused() {
    let cases: [(&[f64], &str); 6] = [
        (&[1.0, 0.5, 0.4, 1.0], "is not symmetric: rows 1 and 2 have 0.5 one way and 0.4 the other"),
        (&[1.0, 1.0, 1.0, 1.0], "is singular or has negative eigenvalues"),
        (&[1.0, 2.0, 2.0, 1.0], "is singular or has negative eigenvalues"),
        (&[-1.0, 0.0, 0.0, 1.0], "has the variance -1 in row 1; a positive number was expected"),
        (&[1.0, f64::NAN, f64::NAN, 1.0], "has an entry that is no finite number"),
        (&[1.0], "has 1 rows and 1 columns; 2 x 2 was expected"),
    ];
    for (entries, expected) in cases {
        let message = block(&[0, 1], entries).unwrap_err().message;
        assert!(message.starts_with("the covariance of the rows") && message.ends_with(expected), "{message}");
    }
}

#[test]
fn blocks_follow_their_equations() {
    let uncertainty = EquationUncertainty {
        standard: vec![1.0, 2.0, 3.0],
        blocks: vec![block(&[2, 0], &[9.0, 1.5, 1.5, 1.0]).unwrap()],
        pooled: None,
    };
    assert_eq!(uncertainty.blocks[0].equations, [0, 2].map(LayoutEquation));
    assert_eq!(uncertainty.blocks[0].covariance, DMatrix::from_row_slice(2, 2, &[1.0, 1.5, 1.5, 9.0]));
    let lower = uncertainty.blocks[0].lower().unwrap();
    assert!((&lower * lower.transpose() - &uncertainty.blocks[0].covariance).amax() < 1e-14);
    let some = uncertainty.blocks_of(&[1, 2].map(LayoutEquation), EquationIndex(5));
    assert_eq!(some[0].equations, [EquationIndex(6)]);
    assert_eq!(some[0].covariance[(0, 0)], 9.0);
}
