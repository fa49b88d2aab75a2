//! The volumetric error over time: what all parameters together do to the tip, as series of their own.

use abbe_core::{Calibration, KinematicModel, Result};
use abbe_volumetric::{Known, causes};

use crate::analysis::{Series, Target};
use crate::calibrations::{History, Tested};
use crate::change::Uncertain;

/// Name of the series of the root mean square over the workspace.
pub const VOLUMETRIC_RMS: &str = "volumetric RMS";

/// Name of the series of the largest error in the workspace.
pub const VOLUMETRIC_LARGEST: &str = "volumetric largest";

/// Both figures of a calibration, mm.
fn figures(model: &dyn KinematicModel, calibration: &Calibration, statuses: &[f64]) -> Result<[Known; 2]> {
    let found = causes(model, calibration, statuses, &[])?;
    Ok([found.rms, found.largest])
}

/// Adds the series of the volumetric error at some poses: root mean square and largest size, mm.
///
/// Their uncertainties are of first order: they hold where the error is several times its own uncertainty. What all tests share,
/// such as the length of a bar, is told apart from what scatters. The series are derived: they say nothing that the parameters
/// do not say, but together.
///
/// # Errors
/// Where the model fails.
pub fn add_volumetric(
    found: &mut History,
    model: &dyn KinematicModel,
    tests: &[Tested<'_>],
    baseline: Option<&Calibration>,
    statuses: &[f64],
) -> Result<()> {
    let mut values: [Vec<Option<Uncertain>>; 2] = Default::default();
    for test in tests {
        for (known, values) in figures(model, test.calibration, statuses)?.into_iter().zip(&mut values) {
            values.push(Some(Uncertain { value: known.value, standard_uncertainty: known.uncertainty }));
        }
    }
    let shared = match tests.iter().zip(&found.tests).find(|(_, test)| test.good) {
        Some((test, _)) => shared(found, model, test.calibration, statuses)?,
        None => [0.0; 2],
    };
    let targets = match baseline {
        Some(baseline) => figures(model, baseline, statuses)?.map(Some),
        None => [None; 2],
    };
    let names = [VOLUMETRIC_RMS, VOLUMETRIC_LARGEST];
    for (((name, values), shared), target) in names.into_iter().zip(values).zip(shared).zip(targets) {
        found.series.push(Series {
            name: name.to_owned(),
            unit: "mm".to_owned(),
            values,
            shared,
            target: target.map(|known| Target { value: known.value, standard_uncertainty: known.uncertainty }),
            regressor: None,
            again: None,
            derived: true,
        });
    }
    Ok(())
}

/// The part of the uncertainties that all tests share: what the figures do when a shared input is wrong by its uncertainty.
fn shared(
    found: &History,
    model: &dyn KinematicModel,
    calibration: &Calibration,
    statuses: &[f64],
) -> Result<[f64; 2]> {
    let here = figures(model, calibration, statuses)?;
    let mut squares = [0.0; 2];
    let is_shared = |identity: &str| found.identities.iter().any(|own| own == identity);
    for input in calibration.inputs.iter().flatten().filter(|input| is_shared(&input.identity)) {
        let mut moved = calibration.clone();
        for (place, sensitivity) in input.sensitivities.iter().enumerate() {
            let Some(name) = calibration.covariance.order.get(place) else { continue };
            let known = moved.parameters.iter_mut().find(|known| known.name == *name);
            known.into_iter().for_each(|known| known.value += sensitivity * input.standard_uncertainty);
        }
        for ((square, there), here) in squares.iter_mut().zip(figures(model, &moved, statuses)?).zip(here) {
            *square += (there.value - here.value).powi(2);
        }
    }
    Ok(squares.map(f64::sqrt))
}
