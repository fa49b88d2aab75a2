//! What remains of the errors after a correction, and how sure that is.

use abbe_core::{
    Calibration, Error, KinematicModel, Poses, Result, SettingsError, Variable, in_parallel, machine_values,
};
use abbe_numerics::Generator;
use abbe_volumetric::machine_covariance;
use nalgebra::{DMatrix, DVector, SymmetricEigen};

use crate::compensator::deviation;
use crate::figures::Spread;

/// How many machines are drawn from what a calibration knows of one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trials {
    /// Number of trials.
    pub number: usize,
    /// Seed of their random numbers.
    pub seed: u64,
    /// Probability with which an error is below its upper limit.
    pub probability: f64,
}

impl Trials {
    /// Refuses fewer trials than the probability needs.
    pub fn check(&self) -> Result<(), SettingsError> {
        if !(self.probability > 0.0 && self.probability < 1.0) {
            return Err(SettingsError::new("probability", "a number between 0 and 1 was expected"));
        }
        // One in ten trials of those beyond, and ten of them: JCGM 101:2008, 7.2.2 asks for more.
        let least = (10.0 / (1.0 - self.probability)).ceil();
        if (self.number as f64) < least {
            let message = format!("{} trials tell no limit of this probability; at least {least} do", self.number);
            return Err(SettingsError::new("trials", message));
        }
        Ok(())
    }
}

/// A figure of the errors over some set-points.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Expected {
    /// Its value for the estimated machine.
    pub estimate: f64,
    /// Its root mean square deviation from the estimate over the trials.
    pub standard_uncertainty: f64,
    /// The value that it has at most with the probability of the [`Trials`].
    pub upper: f64,
}

/// The errors of the tool over some set-points: tip in mm, tool axis in rad.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Remaining {
    /// Largest distance of the tip from its goal.
    pub tip_max: Expected,
    /// Root mean square distance of the tip.
    pub tip_rms: Expected,
    /// Largest angle of the tool axis from its goal.
    pub axis_max: Expected,
    /// Root mean square angle of the tool axis.
    pub axis_rms: Expected,
}

/// The errors of the tool for several ways to drive the machine along the same set-points.
///
/// `programmed` are the statuses of the set-points (points x columns of the status); their goals are the nominal poses. Each of
/// `driven` has the statuses with the commands that the motors get. The true machine is drawn from the covariance of the calibration,
/// while the commands stay those made from its estimate: so the upper limits hold what the calibration does not know. What it states
/// no uncertainty of is not drawn.
///
/// Fails where the model has no pose.
pub fn remaining(
    model: &dyn KinematicModel,
    calibration: &Calibration,
    programmed: &[f64],
    driven: &[&[f64]],
    trials: &Trials,
) -> Result<Vec<Remaining>> {
    if let Some(other) = driven.iter().find(|statuses| statuses.len() != programmed.len()) {
        return Err(Error::usage(format!("{} numbers drive {} programmed ones", other.len(), programmed.len())));
    }
    let mut goal = Poses::default();
    model.poses(programmed, &model.info().without_errors(), &[], true, &mut goal)?;
    let estimate = machine_values(model, calibration);
    let of_machine = |values: &[f64]| -> Result<Vec<[f64; 4]>> {
        driven.iter().map(|statuses| sizes(model, values, statuses, &goal)).collect()
    };
    let machine = Drawn::new(model, calibration);
    let numbers: Vec<usize> = (0..trials.number).collect();
    let drawn = in_parallel(&numbers, None, |&trial| of_machine(&machine.values(&estimate, trials.seed, trial)));
    let drawn = drawn.into_iter().collect::<Result<Vec<_>>>()?;
    let found = of_machine(&estimate)?;
    let expected = |way: usize, figure: usize| {
        let mut values: Vec<f64> = drawn.iter().map(|trial| trial[way][figure]).collect();
        values.sort_by(f64::total_cmp);
        let estimate = found[way][figure];
        let squares: f64 = values.iter().map(|value| (value - estimate).powi(2)).sum();
        let place = (trials.probability * values.len() as f64).ceil() as usize;
        let upper = values.get(place.max(1) - 1).or(values.last()).copied().unwrap_or(estimate);
        Expected { estimate, standard_uncertainty: (squares / values.len().max(1) as f64).sqrt(), upper }
    };
    let of_way = |way: usize| Remaining {
        tip_max: expected(way, 0),
        tip_rms: expected(way, 1),
        axis_max: expected(way, 2),
        axis_rms: expected(way, 3),
    };
    Ok((0..driven.len()).map(of_way).collect())
}

/// Largest and root mean square distance of the tip, mm, then angle of the tool axis, rad.
fn sizes(model: &dyn KinematicModel, values: &[f64], statuses: &[f64], goal: &Poses) -> Result<[f64; 4]> {
    let mut now = Poses::default();
    model.poses(statuses, values, &[], true, &mut now)?;
    let deviations: Vec<_> = (0..goal.positions.len()).map(|point| deviation(&now, goal, point)).collect();
    let tip = Spread::of(deviations.iter().map(|deviation| deviation.distance()));
    let axis = Spread::of(deviations.iter().map(|deviation| deviation.angle()));
    Ok([tip.max, tip.rms, axis.max, axis.rms])
}

/// Machines that a calibration allows: normal, or Student's where it knows degrees of freedom.
struct Drawn {
    parameters: Vec<usize>,
    /// A root of the covariance: its product with its transpose.
    root: DMatrix<f64>,
    degrees_of_freedom: f64,
}

impl Drawn {
    fn new(model: &dyn KinematicModel, calibration: &Calibration) -> Self {
        let (variables, covariance) = machine_covariance(model, calibration);
        let parameters: Vec<usize> = (variables.into_iter())
            .filter_map(|variable| match variable {
                Variable::Parameter(index) => Some(index),
                Variable::Command(_) => None,
            })
            .collect();
        let is_machine = |name: &str| model.info().parameter(name).is_some();
        let degrees_of_freedom = calibration.degrees_of_freedom(is_machine);
        if parameters.is_empty() {
            // Stated errors without an uncertainty.
            return Self { parameters, root: covariance, degrees_of_freedom };
        }
        // Parameters have units of their own: only correlations are decomposed.
        let sizes = DVector::from_iterator(covariance.nrows(), covariance.diagonal().iter().map(|value| value.sqrt()));
        let part = |row: usize, column: usize| covariance[(row, column)] / (sizes[row] * sizes[column]);
        let correlation = DMatrix::from_fn(covariance.nrows(), covariance.ncols(), |row, column| {
            if sizes[row] * sizes[column] > 0.0 { part(row, column) } else { 0.0 }
        });
        let eigen = SymmetricEigen::new(correlation);
        let roots = eigen.eigenvalues.map(|value| value.max(0.0).sqrt());
        let root = DMatrix::from_diagonal(&sizes) * eigen.eigenvectors * DMatrix::from_diagonal(&roots);
        Self { parameters, root, degrees_of_freedom }
    }

    fn values(&self, estimate: &[f64], seed: u64, trial: usize) -> Vec<f64> {
        let mut generator = Generator::new(seed, trial as u64);
        let factor = generator.student_factor(self.degrees_of_freedom);
        let normal = DVector::from_fn(self.parameters.len(), |_, _| generator.normal());
        let mut values = estimate.to_vec();
        for (&parameter, by) in self.parameters.iter().zip((&self.root * normal).iter()) {
            values[parameter] += factor * by;
        }
        values
    }
}
