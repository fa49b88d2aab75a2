//! Proves diagnostics against numbers found by hand and against their definitions by leaving rows out, and the selection of
//! terms on data that are made of some of them.

use abbe_numerics::{Accumulator, Influence, StepwiseDirection, StepwiseSelection, coverage_factor, f_test};

use crate::linear::{DesignMatrix, LinearFit, fit_linear};
use crate::problems::{Linear, Random};

fn line(y: &[f64]) -> LinearFit {
    let rows: Vec<Vec<f64>> = (1..=y.len()).map(|x| vec![1.0, x as f64]).collect();
    fit_linear(&DesignMatrix::new(&rows), y).expect("full rank")
}

fn close(found: &[f64], expected: &[f64]) {
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }
}

#[test]
fn a_line_by_hand() {
    // x = 1..5: leverages 1/5 + (x - 3)^2 / 10; slope 1.2, residuals 0.2, 0, -0.2, -0.4, 0.4 with variance 0.4 / 3.
    let fit = line(&[1.0, 2.0, 3.0, 4.0, 6.0]);
    close(&fit.values, &[-0.4, 1.2]);
    close(&fit.residuals, &[0.2, 0.0, -0.2, -0.4, 0.4]);
    close(&fit.leverages, &[0.6, 0.3, 0.2, 0.3, 0.6]);
    let influence = Influence::new(&fit.residuals, &fit.leverages, fit.values.len());
    assert!((influence.studentised[4] - 3.0_f64.sqrt()).abs() < 1e-12);
    assert!((influence.cook[4] - 2.25).abs() < 1e-12, "{}", influence.cook[4]);
    // Without the last row the others are on a line.
    assert!(influence.deleted[4] > 1e6, "{}", influence.deleted[4]);
    // At the mean the band is s / sqrt(5) wide, times Student's 3.182 of three degrees of freedom.
    let (value, uncertainty) = fit.at(&[1.0, 3.0]);
    close(&[value, uncertainty], &[3.2, (0.4_f64 / 15.0).sqrt()]);
    assert!((coverage_factor(0.95, fit.degrees_of_freedom() as f64) - 3.182_446).abs() < 1e-6);
}

#[test]
fn influence_is_what_leaving_a_row_out_does() {
    let random = &mut Random::new(3);
    for _ in 0..10 {
        let Linear { rows, residuals } = Linear::random(random, 12, 3);
        let fit = fit_linear(&DesignMatrix::new(&rows), &residuals).expect("full rank");
        let influence = Influence::new(&fit.residuals, &fit.leverages, fit.values.len());
        for out in 0..rows.len() {
            let kept = |index: &usize| *index != out;
            let others: Vec<Vec<f64>> = (0..rows.len()).filter(kept).map(|row| rows[row].clone()).collect();
            let right: Vec<f64> = (0..rows.len()).filter(kept).map(|row| residuals[row]).collect();
            let without = fit_linear(&DesignMatrix::new(&others), &right).expect("full rank");
            let moved: f64 = rows.iter().map(|row| (fit.at(row).0 - without.at(row).0).powi(2)).sum();
            assert!((influence.cook[out] - moved / (3.0 * fit.variance())).abs() < 1e-10);
            // The prediction error of the row over its standard deviation, both without it.
            let (value, uncertainty) = without.at(&rows[out]);
            let deleted = (residuals[out] - value) / (without.variance() + uncertainty * uncertainty).sqrt();
            assert!((influence.deleted[out] - deleted).abs() < 1e-9 * deleted.abs().max(1.0), "{deleted}");
        }
    }
}

/// The selection among terms (columns) that make up `right`.
fn stepwise(
    terms: &[Vec<f64>],
    right: &[f64],
    always: &[usize],
    level: f64,
    direction: StepwiseDirection,
) -> Option<StepwiseSelection> {
    let mut accumulator = Accumulator::new(terms.len(), right.len());
    for row in 0..right.len() {
        let entries: Vec<f64> = terms.iter().map(|term| term[row]).collect();
        accumulator.push(&entries, -right[row], 1.0);
    }
    let candidates: Vec<usize> = (0..terms.len()).filter(|term| !always.contains(term)).collect();
    let freedom = right.len() - terms.len();
    accumulator.finish().stepwise(&vec![0.0; terms.len()], &candidates, freedom, level, direction)
}

#[test]
fn selection_finds_the_terms_that_made_the_data() {
    let random = &mut Random::new(5);
    let terms: Vec<Vec<f64>> = (0..8).map(|_| (0..60).map(|_| random.signed()).collect()).collect();
    let noise: Vec<f64> = (0..60).map(|_| 0.05 * random.normal()).collect();
    let right: Vec<f64> = (0..60).map(|row| 1.5 * terms[2][row] - 0.8 * terms[5][row] + noise[row]).collect();
    for direction in [StepwiseDirection::Forward, StepwiseDirection::Backward, StepwiseDirection::Both] {
        let selection = stepwise(&terms, &right, &[], 1e-4, direction).expect("separable terms");
        assert_eq!(selection.kept, [2, 5], "{direction:?}");
        let kept = stepwise(&terms, &right, &[0], 1e-4, direction).expect("separable terms").kept;
        assert_eq!(kept, [2, 5], "{direction:?}");
        let kept = stepwise(&terms, &right, &[2], 1e-4, direction).expect("separable terms").kept;
        assert_eq!(kept, [5], "{direction:?}");
    }
    // The strongest comes first.
    let forward = stepwise(&terms, &right, &[], 1e-4, StepwiseDirection::Forward).expect("separable terms");
    assert_eq!(forward.steps[0].term, 2);
    assert!(forward.steps.iter().all(|step| step.entered && step.probability < 1e-4));
    // A term that others make superfluous goes out again: a mixture of two others is the best single one.
    let both: Vec<f64> = (0..60).map(|row| terms[2][row] + terms[5][row] + noise[row]).collect();
    let near: Vec<f64> = (0..60).map(|row| terms[2][row] + 0.6 * terms[5][row] + 0.2 * terms[7][row]).collect();
    let candidates = vec![terms[2].clone(), terms[5].clone(), near];
    let selection = stepwise(&candidates, &both, &[], 1e-4, StepwiseDirection::Both).expect("separable terms");
    assert_eq!(selection.kept, [0, 1], "{:?}", selection.steps);
    assert_eq!(selection.steps[0].term, 2);
    assert!(selection.steps.iter().any(|step| step.term == 2 && !step.entered));
    // Noise alone keeps nothing at a strict level.
    assert!(stepwise(&terms, &noise, &[], 1e-6, StepwiseDirection::Both).expect("separable terms").kept.is_empty());
}

#[test]
fn every_step_of_a_selection_is_an_f_test_of_two_fits() {
    let random = &mut Random::new(9);
    let Linear { rows, residuals } = Linear::random(random, 40, 7);
    let columns: Vec<Vec<f64>> = (0..7).map(|term| rows.iter().map(|row| row[term]).collect()).collect();
    let cost = |terms: &[usize]| -> f64 {
        let rows: Vec<Vec<f64>> =
            rows.iter().map(|row| [0].iter().chain(terms).map(|&term| row[term]).collect()).collect();
        fit_linear(&DesignMatrix::new(&rows), &residuals).expect("full rank").cost()
    };
    for (direction, mut terms) in
        [(StepwiseDirection::Forward, vec![]), (StepwiseDirection::Backward, (1..7).collect::<Vec<_>>())]
    {
        // A level at which everything comes in, or everything goes out.
        let level = if direction == StepwiseDirection::Forward { 1.0 } else { 0.0 };
        let steps = stepwise(&columns, &residuals, &[0], level, direction).expect("separable terms").steps;
        assert_eq!(steps.len(), 6);
        for step in steps {
            let before = cost(&terms);
            match step.entered {
                true => terms.push(step.term),
                false => terms.retain(|term| *term != step.term),
            }
            let (with, without) = if step.entered { (cost(&terms), before) } else { (before, cost(&terms)) };
            let freedom = 40 - 1 - terms.len() - usize::from(!step.entered);
            let probability = f_test((without - with) / (with / freedom as f64), 1, freedom).expect("freedom");
            assert!((step.probability - probability).abs() < 1e-9, "{step:?} {probability}");
        }
    }
    // A term that follows from others.
    let twice = [&columns[..], &[columns[1].iter().map(|value| 2.0 * value).collect()]].concat();
    assert_eq!(stepwise(&twice, &residuals, &[], 1e-4, StepwiseDirection::Both), None);
}

#[test]
fn columns_that_follow_from_others_are_told() {
    let rows: Vec<Vec<f64>> = (0..9).map(|row| vec![1.0, f64::from(row), 3.0 + 2.0 * f64::from(row)]).collect();
    assert!(fit_linear(&DesignMatrix::new(&rows), &[1.0; 9]).is_none());
    assert!(fit_linear(&DesignMatrix::new(&rows[..2]), &[1.0; 2]).is_none());
    let zero = fit_linear(&DesignMatrix::new(&[vec![1.0], vec![2.0]]), &[0.0; 2]).expect("a solution");
    assert_eq!(zero.values, [0.0]);
}
