//! The linear system that ties the circles of the tests to the unknowns, and its uncertainty.
//!
//! Half the squared length of a test has the constant (R² + h² + o²)/2, the cosine R o1 and the sine R o2. An unknown that
//! changes the length by J changes the squared length by 2 L J. Its effect on the three numbers is the projection of L J on
//! constant, cosine and sine. So the sensitivities to location errors, of the moving axis and of the axes under it, are those
//! of the model: with its signs, and from the tool ball to the origin.

use std::collections::BTreeMap;

use abbe_core::{
    Calibration, Combination, FitReport, Identifiability, Owner, Problem, Result, Termination, WeakDirection,
};
use abbe_estimation::calibration;
use nalgebra::{DMatrix, DVector};

use crate::evaluation::Evaluated;
use crate::reduction::Projection;
use crate::sweep::{Linearisation, Sweep, sweeps};

/// Singular values below this part of the largest count as zero; columns have norm 1.
const RANK_TOLERANCE: f64 = 1e-9;

/// Parts of a lost direction below this part of the largest are rounding and are left out.
const NOTHING: f64 = 1e-6;

/// Number of weakest combinations that are reported. Unknowns with an effect below this part of the largest are not named.
const WEAKEST: usize = 5;
const NAMED: f64 = 0.1;

/// The circles of a problem as functions of its unknowns, at nominal values.
pub struct System {
    /// The problem with nominal values of all unknowns.
    nominal: Problem,
    pub sweeps: Vec<Sweep>,
    /// Derivatives of the equations to the unknowns, then to the considered parameters.
    linearisation: Linearisation,
    /// Effect of the equations on the numbers of the tests: three rows a test, mm.
    reduction: DMatrix<f64>,
    /// Scale of every unknown: one over the norm of its effect.
    scale: DVector<f64>,
    /// Generalised inverse: scaled unknowns from the numbers of the tests.
    inverse: DMatrix<f64>,
    identifiability: Identifiability,
}

impl System {
    /// Finds the tests in a problem and what they depend on.
    pub fn new(problem: &Problem, tests: &str) -> Result<Self> {
        let nominal = at_nominal(problem);
        let sweeps = sweeps(&nominal, tests)?;
        let unknowns = nominal.unknowns.iter().chain(&nominal.considered.unknowns).cloned().collect();
        let linearisation = Linearisation::new(&nominal, unknowns)?;
        let reduction = reduction(&sweeps, linearisation.residuals.len());
        let effects = &reduction * linearisation.jacobian.columns(0, nominal.unknowns.len());
        let norm = |column: usize| Some(effects.column(column).norm()).filter(|norm| *norm > 1e-12).unwrap_or(1.0);
        let scale = DVector::from_fn(effects.ncols(), |column, _| 1.0 / norm(column));
        // At least as many rows as columns, so that the singular vectors include the lost directions.
        let rows = effects.nrows().max(effects.ncols());
        let scaled = DMatrix::from_fn(rows, effects.ncols(), |row, column| {
            if row < effects.nrows() { effects[(row, column)] * scale[column] } else { 0.0 }
        });
        let (inverse, identifiability) = solved(&nominal, &scaled, &scale, linearisation.residuals.len());
        Ok(Self { nominal, sweeps, linearisation, reduction, scale, inverse, identifiability })
    }

    /// What the circles determine.
    pub fn identifiability(&self) -> Identifiability {
        self.identifiability.clone()
    }

    /// The values of the unknowns.
    pub fn solve(&self, evaluated: &Evaluated) -> Vec<f64> {
        let mut numbers = DVector::zeros(self.inverse.ncols());
        for (place, (sweep, circle)) in self.sweeps.iter().zip(&evaluated.circles).enumerate() {
            let (radius, height, beside) = (sweep.radius, sweep.height, circle.nominal_offset);
            let size = radius * circle.radius + height * circle.height + beside.dot(&circle.offset);
            numbers[3 * place] = size / length(sweep);
            let offset = circle.offset + beside * (circle.radius / radius);
            numbers[3 * place + 1] = offset.x;
            numbers[3 * place + 2] = offset.y;
        }
        let scaled = &self.inverse * numbers;
        let start = self.nominal.start();
        start.iter().zip(scaled.component_mul(&self.scale).iter()).map(|(start, change)| start + change).collect()
    }

    /// Sensitivities of the unknowns to errors of the equations: unknowns x equations.
    fn sensitivities(&self) -> DMatrix<f64> {
        let own = self.inverse.columns(0, self.reduction.nrows()) * &self.reduction;
        let mut answer = -own;
        for (mut row, scale) in answer.row_iter_mut().zip(self.scale.iter()) {
            row *= *scale;
        }
        answer
    }

    /// The calibration at `x`, with its covariance by the law of propagation.
    pub fn calibration(&self, x: &[f64], trust_uncertainties: bool) -> Result<Calibration> {
        let problem = &self.nominal;
        let residuals = problem.residuals(x)?;
        let standard = problem.standard_uncertainties();
        let count = residuals.len();
        let degrees_of_freedom = count.saturating_sub(x.len());
        let weighted: f64 = residuals.iter().zip(&standard).map(|(residual, own)| (residual / own).powi(2)).sum();
        let sigma = (weighted / degrees_of_freedom.max(1) as f64).sqrt();
        let scale = if trust_uncertainties || degrees_of_freedom == 0 { 1.0 } else { sigma };
        let fit = FitReport {
            observations: count,
            unknowns: x.len(),
            rank: self.identifiability.rank,
            condition: self.identifiability.condition,
            degrees_of_freedom,
            sigma,
            iterations: 1,
            termination: Termination::Converged,
            last_step: None,
            gradient_cosine: None,
            residual_max_um: residuals.iter().fold(0.0_f64, |most, residual| most.max(residual.abs())) * 1e3,
            residual_mean_abs_um: residuals.iter().map(|residual| residual.abs()).sum::<f64>() / count as f64 * 1e3,
            residual_rms_um: (residuals.iter().map(|residual| residual.powi(2)).sum::<f64>() / count as f64).sqrt()
                * 1e3,
            residual_radial_rms_um: None,
            residual_max_urad: None,
            residual_mean_abs_urad: None,
            residual_rms_urad: None,
            rank_tolerance: None,
            null_space: Vec::new(),
            dropped: Vec::new(),
            weakest: self.identifiability.weakest.clone(),
            selection: None,
            selection_by_prediction: None,
            ordinary_covariance: None,
            equivalent_motion_errors: Vec::new(),
            implausible: Vec::new(),
            eliminated: 0,
            variance: Vec::new(),
            agreement: None,
            statuses: BTreeMap::new(),
            known_degrees_of_freedom: BTreeMap::new(),
            remarks: Vec::new(),
        };
        Ok(calibration(problem, x, self.covariance(&standard, scale), Vec::new(), fit))
    }

    /// Covariance of the unknowns, then of the considered parameters.
    fn covariance(&self, standard: &[f64], scale: f64) -> Vec<Vec<f64>> {
        let problem = &self.nominal;
        let answer = self.sensitivities();
        let own = answer.nrows();
        let repeated_together = problem.repeated_together();
        let ranges = problem.equation_ranges();
        let mut stated: Vec<f64> = standard.to_vec();
        for together in &repeated_together {
            together.sets.iter().for_each(|&set| stated[ranges[set].clone()].fill(0.0));
        }
        let mut blocks = problem.covariance_blocks();
        blocks.retain(|block| block.equations.iter().all(|&equation| stated[equation] > 0.0));
        blocks.iter().flat_map(|block| &block.equations).for_each(|&equation| stated[equation] = 0.0);
        let root = DMatrix::from_fn(own, stated.len(), |row, equation| answer[(row, equation)] * stated[equation]);
        let mut covariance = &root * root.transpose();
        for block in &blocks {
            let part = answer.select_columns(block.equations.iter().map(|equation| &equation.0));
            covariance += &part * &block.covariance * part.transpose();
        }
        covariance *= scale * scale;
        for together in &repeated_together {
            for deviation in &together.pooled.deviations {
                let shift = &answer * DVector::from_column_slice(deviation);
                covariance += &shift * shift.transpose() / together.pooled.degrees_of_freedom as f64;
            }
        }
        let considered = &problem.considered;
        let count = considered.unknowns.len();
        let known = DMatrix::from_fn(count, count, |row, column| considered.covariance[row][column]);
        let answer = &answer * self.linearisation.jacobian.columns(own, count);
        let cross = &answer * &known;
        covariance += &cross * answer.transpose();
        (0..own + count)
            .map(|row| {
                let entry = |column: usize| match (row < own, column < own) {
                    (true, true) => (covariance[(row, column)] + covariance[(column, row)]) / 2.0,
                    (true, false) => cross[(row, column - own)],
                    (false, true) => cross[(column, row - own)],
                    (false, false) => known[(row - own, column - own)],
                };
                (0..own + count).map(entry).collect()
            })
            .collect()
    }
}

/// The problem with its unknowns at nominal values instead of their start values: the circles do not depend on a start.
fn at_nominal(problem: &Problem) -> Problem {
    let starts: Vec<Vec<f64>> = problem.sets.iter().map(|set| set.info().start.clone()).collect();
    let nominal = |owner: Owner, index: usize, start: f64| match owner {
        Owner::Machine => problem.model.info().nominal[index],
        Owner::Set(set) => starts[set][index],
        Owner::Input | Owner::Tie => start,
    };
    let unknowns = problem.unknowns.iter().zip(problem.start());
    let values: Vec<f64> = unknowns.map(|(unknown, start)| nominal(unknown.owner, unknown.index, start)).collect();
    problem.with_values(&values)
}

/// Nominal length of the bar of a test.
fn length(sweep: &Sweep) -> f64 {
    sweep.radius.hypot(sweep.height)
}

/// Effect of lengths on the numbers of the tests: size over length, and offsets in the directions of cosine and sine.
fn reduction(sweeps: &[Sweep], equations: usize) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(3 * sweeps.len(), equations);
    for (place, sweep) in sweeps.iter().enumerate() {
        let projection = Projection::new(&sweep.angles);
        // R o is half the cosine of the squared length, which changes by twice the length: the factors cancel.
        let units = [length(sweep), sweep.radius, sweep.radius];
        for (sample, (&equation, nominal)) in sweep.equations.iter().zip(&sweep.nominal).enumerate() {
            for (number, unit) in units.iter().enumerate() {
                matrix[(3 * place + number, equation.0)] = projection.entry(number, sample) * nominal / unit;
            }
        }
    }
    matrix
}

/// The generalised inverse of the scaled effects, and what the effects determine.
fn solved(
    problem: &Problem,
    scaled: &DMatrix<f64>,
    scale: &DVector<f64>,
    equations: usize,
) -> (DMatrix<f64>, Identifiability) {
    let svd = scaled.clone().svd(true, true);
    let values = &svd.singular_values;
    let largest = values.iter().copied().fold(0.0, f64::max);
    let determined = |value: f64| value > RANK_TOLERANCE * largest;
    let least = values.iter().copied().filter(|&value| determined(value)).fold(largest, f64::min);
    let rank = values.iter().filter(|&&value| determined(value)).count();
    // Singular values come with the largest first.
    let told = |place: usize, least: f64| {
        let right = svd.v_t.as_ref()?;
        Some(direction(problem, values[place] / largest, right.row(place).iter(), scale, least))
    };
    let null_space =
        (0..values.len()).filter(|&place| !determined(values[place])).filter_map(|place| told(place, NOTHING));
    let null_space = null_space.collect();
    let weakest = (0..rank).rev().take(WEAKEST).filter_map(|place| told(place, NAMED)).collect();
    let tolerance = RANK_TOLERANCE * largest;
    let inverse = svd.pseudo_inverse(tolerance).unwrap_or_else(|_| DMatrix::zeros(scaled.ncols(), scaled.nrows()));
    let found = Identifiability {
        observations: equations,
        unknowns: scaled.ncols(),
        rank,
        condition: largest / least,
        null_space,
        weakest,
        equivalent_motion_errors: Vec::new(),
        remarks: Vec::new(),
        uncertainty: None,
    };
    (inverse, found)
}

/// A direction in the units of the unknowns, the one with the largest effect 1; those with less than `least` of it are left out.
fn direction<'a>(
    problem: &Problem,
    singular_value: f64,
    direction: impl Iterator<Item = &'a f64>,
    scale: &DVector<f64>,
    least: f64,
) -> WeakDirection {
    let mut parts: Vec<(f64, Combination)> = problem
        .unknowns
        .iter()
        .zip(direction.zip(scale.iter()))
        .map(|(unknown, (effect, scale))| {
            let (name, unit) = (unknown.name.clone(), unknown.unit.to_string());
            (effect.abs(), Combination { name, coefficient: effect * scale, unit })
        })
        .collect();
    let largest = parts.iter().fold(0.0_f64, |largest, part| largest.max(part.0));
    parts.retain(|part| part.0 > least * largest);
    parts.sort_by(|a, b| b.0.total_cmp(&a.0));
    let unit = parts.first().map_or(1.0, |part| part.1.coefficient);
    let combination = parts.into_iter().map(|(_, mut part)| {
        part.coefficient /= unit;
        part
    });
    WeakDirection { singular_value, combination: combination.collect(), separated_by: Vec::new() }
}
