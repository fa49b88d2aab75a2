//! Values that depend on directions which the data cannot tell.

use std::collections::BTreeSet;

use abbe_core::{Calibration, Identifiability, Problem, Quantity, Result, Status};
use abbe_estimation::Judgement;

use crate::GaussNewton;

/// Part of the largest effect in a lost direction from which the value of a parameter tells how far the direction may be off.
const MAIN_PART: f64 = 0.1;

/// What errors of machines do to readings of lengths, mm, and of angles, rad.
const TYPICAL_ERROR: f64 = 0.05;
const TYPICAL_TURN: f64 = 5e-5;

impl GaussNewton {
    /// Marks every value that depends on a lost direction: those that share it, and those that move by more than their standard
    /// uncertainty where one, or all together, are taken to be others, by products of errors.
    ///
    /// How far a lost direction may be off nobody knows; it is tried with the largest value that was found for what has a main part in
    /// it, and at least with what errors of machines are.
    /// `solve` gives the calibration from start values with the lost directions as they are there.
    pub(crate) fn mark_shared(
        &self,
        (problem, judged): (&Problem, &Judgement),
        found: &Identifiability,
        calibration: &mut Calibration,
        explained: bool,
        solve: impl Fn(&Problem) -> Result<Calibration>,
    ) -> Result<()> {
        let parts = found.null_space.iter().flat_map(|vector| &vector.combination);
        let mut shared: BTreeSet<String> = parts.map(|part| part.name.clone()).collect();
        let (start, x) = (problem.start(), problem.values_of(calibration));
        let readings =
            problem.standard_uncertainties().into_iter().zip(problem.quantities()).zip(problem.constraints());
        let readings =
            readings.filter(|(_, constraint)| !constraint).map(|((uncertainty, quantity), _)| match quantity {
                Quantity::Angle => TYPICAL_TURN / TYPICAL_ERROR / uncertainty,
                _ => 1.0 / uncertainty,
            });
        let one_mm = readings.map(|weight| weight * weight).sum::<f64>().sqrt();
        let mut shifts: Vec<(String, Vec<f64>)> = Vec::new();
        for vector in found.null_space.iter().filter(|_| explained) {
            let members = problem.unknowns.iter().enumerate().filter_map(|(index, unknown)| {
                let part = vector.combination.iter().find(|part| part.name == unknown.name)?;
                Some((index, part.coefficient))
            });
            let members: Vec<(usize, f64)> = members.collect();
            // What has no effect by itself may have one on what others do.
            let whole = |index: usize| Some(judged.factor().norms()[index]).filter(|norm| *norm > 0.0);
            let effect = |&(index, part): &(usize, f64)| whole(index).unwrap_or(judged.terms()[index]) * part.abs();
            let largest = members.iter().map(effect).fold(0.0, f64::max);
            let size = |&(index, part): &(usize, f64)| (x[index] - start[index]).abs() / part.abs();
            let main = members.iter().filter(|member| effect(member) >= MAIN_PART * largest);
            let typical = if largest > 0.0 { TYPICAL_ERROR * one_mm / largest } else { 0.0 };
            let size = main.map(size).fold(typical, f64::max);
            let mut shift = vec![0.0; x.len()];
            members.iter().for_each(|(index, part)| shift[*index] += size * part);
            shifts.push((format!("a lost direction ({})", vector.describe()), shift));
        }
        if shifts.len() > 1 {
            // Two of them may do by their product what neither does alone.
            let sum = |index: usize| shifts.iter().map(|(_, shift)| shift[index]).sum();
            shifts.push(("all lost directions together".to_owned(), (0..x.len()).map(sum).collect()));
        }
        for (lost, shift) in shifts {
            let shifted: Vec<f64> = x.iter().zip(shift).map(|(value, shift)| value + shift).collect();
            let other = match solve(&problem.with_values(&shifted)) {
                Ok(other) => other,
                Err(error) if error.fatal => return Err(error),
                Err(error) => {
                    tracing::warn!("{}: what depends on {lost} was not found: {error}", problem.name);
                    continue;
                }
            };
            for estimated in calibration.parameters.iter().chain(&calibration.artefacts) {
                let moved = other.get(&estimated.name).map_or(0.0, |other| (other.value - estimated.value).abs());
                if estimated.status == Status::Estimated && moved > estimated.standard_uncertainty {
                    shared.insert(estimated.name.clone());
                }
            }
        }
        for estimated in calibration.parameters.iter_mut().chain(&mut calibration.artefacts) {
            if shared.contains(&estimated.name) {
                estimated.status = Status::Confounded;
            }
        }
        Ok(())
    }
}
