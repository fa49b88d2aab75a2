//! The volumetric error of poses and its covariance.

use abbe_core::{Calibration, Error, KinematicModel, Poses, Result, Variable, machine_values};
use nalgebra::DMatrix;

use crate::ellipsoid::Ellipsoid;

/// Number of poses that are evaluated together: it bounds the memory for derivatives.
const CHUNK: usize = 64;

/// The volumetric error of a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VolumetricError {
    /// Actual tip minus nominal tip, table frame, mm.
    pub mean: [f64; 3],
    /// Its covariance, mm².
    pub covariance: [[f64; 3]; 3],
    /// Smallest degrees of freedom with which the uncertainty of a parameter of the machine is known; infinite if all were
    /// stated.
    pub degrees_of_freedom: f64,
}

impl VolumetricError {
    /// The region that holds the error with some probability.
    ///
    /// Fails as [`Ellipsoid::of`] does.
    pub fn ellipsoid(&self, probability: f64) -> Result<Ellipsoid> {
        Ellipsoid::of(&self.covariance, probability, self.degrees_of_freedom)
    }

    /// Size of the error, mm.
    pub fn size(&self) -> f64 {
        self.mean.iter().map(|component| component * component).sum::<f64>().sqrt()
    }

    /// Standard uncertainty of the size, mm: that of the error along its own direction, by the law of propagation of
    /// uncertainty (JCGM 100:2008, 5.1.2), which is of first order. None where there is no error and so no direction.
    pub fn size_uncertainty(&self) -> Option<f64> {
        let size = self.size();
        let direction = self.mean.map(|component| component / size);
        let along = |row: &[f64; 3]| row.iter().zip(&direction).map(|(entry, part)| entry * part).sum::<f64>();
        let variance: f64 = self.covariance.iter().zip(&direction).map(|(row, part)| part * along(row)).sum();
        (size > 0.0).then(|| variance.max(0.0).sqrt())
    }
}

/// The volumetric error of a batch of poses: `statuses` is rows x [`status`](abbe_core::ModelInfo::status), row by row.
///
/// The error is the tip with the values of the calibration minus the tip with nominal ones. Its covariance is `F C F^T`
/// (Soons 1993, equation A.4). F has the derivatives of the tip, at the values of the calibration, to those parameters of the
/// machine that the covariance of the calibration names; C is their covariance. Unknowns of artefacts are not used.
/// Parameters that the calibration does not have are nominal.
///
/// Fails if `statuses` has no whole number of rows, or where the model fails.
pub fn predict(
    model: &dyn KinematicModel,
    calibration: &Calibration,
    statuses: &[f64],
) -> Result<Vec<VolumetricError>> {
    let width = model.info().status.len().max(1);
    if !statuses.len().is_multiple_of(width) {
        return Err(Error::usage(format!("{} numbers are no poses of {width} statuses each", statuses.len())));
    }
    let without = &model.info().without_errors();
    let values = machine_values(model, calibration);
    let is_machine = |name: &str| model.info().parameters.iter().any(|parameter| parameter.name == name);
    let degrees_of_freedom = calibration.degrees_of_freedom(is_machine);
    let (wanted, covariance) = machine_covariance(model, calibration);
    let (mut actual, mut nominal) = (Poses::default(), Poses::default());
    let mut errors = Vec::with_capacity(statuses.len() / width);
    for chunk in statuses.chunks(width * CHUNK) {
        model.poses(chunk, &values, &wanted, false, &mut actual)?;
        model.poses(chunk, without, &[], false, &mut nominal)?;
        let poses = actual.positions.len();
        // One column for each component of each pose: F^T and C F^T.
        let derivatives = DMatrix::from_fn(wanted.len(), 3 * poses, |parameter, column| {
            actual.position_derivatives[column / 3 * wanted.len() + parameter][column % 3]
        });
        let weighted = &covariance * &derivatives;
        for pose in 0..poses {
            let mean = [0, 1, 2].map(|axis| actual.positions[pose][axis] - nominal.positions[pose][axis]);
            let entry = |row: usize, column: usize| {
                derivatives.column(3 * pose + row.max(column)).dot(&weighted.column(3 * pose + row.min(column)))
            };
            let covariance = [0, 1, 2].map(|row| [0, 1, 2].map(|column| entry(row, column)));
            errors.push(VolumetricError { mean, covariance, degrees_of_freedom });
        }
    }
    Ok(errors)
}

/// The parameters of the model that a calibration has a covariance of, and that covariance.
///
/// The variables are all [`Variable::Parameter`]; the covariance is in the squared units of memory, in their order.
pub fn machine_covariance(model: &dyn KinematicModel, calibration: &Calibration) -> (Vec<Variable>, DMatrix<f64>) {
    let parameters = model.info().parameters.iter().enumerate();
    let known = parameters.filter(|(_, parameter)| calibration.covariance.index(&parameter.name).is_some());
    let (wanted, names): (Vec<Variable>, Vec<&str>) =
        known.map(|(index, parameter)| (Variable::Parameter(index), parameter.name.as_str())).unzip();
    (wanted, calibration.covariance.block(&names))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{calibration, chain};
    use serde_json::json;

    /// Values of some parameters and a factor of their covariance: two unknown causes move several parameters together.
    const PARAMETERS: [(&str, f64, [f64; 2]); 6] = [
        ("EC0Y", 3e-5, [2e-6, 1e-6]),
        ("EA0B", -4e-5, [0.0, 3e-6]),
        ("EXX[1]", 2e-5, [1e-6, -2e-6]),
        ("EXX[b]", 2e-3, [4e-4, 0.0]),
        ("EYB[1]", 5e-3, [1e-3, -1e-3]),
        ("dzt", 0.2, [5e-4, 2e-3]),
    ];

    fn model() -> std::sync::Arc<dyn KinematicModel> {
        let errors = json!([{ "location": ["EC0Y", "EA0B"] }, { "polynomial": ["EXX", "EYB"], "degrees": [1] },
            { "backlash": ["EXX"] }]);
        chain("w B' b X Y Z t", json!({}), errors)
    }

    fn known() -> Calibration {
        let values: Vec<(&str, f64)> = PARAMETERS.iter().map(|(name, value, _)| (*name, *value)).collect();
        let mut calibration = calibration(&values);
        // In another order than the model's, with an unknown of an artefact in between.
        let order: Vec<Option<usize>> = vec![Some(5), Some(0), None, Some(3), Some(1), Some(4), Some(2)];
        let name = |index: &Option<usize>| index.map_or("table.ball[1].x", |index| PARAMETERS[index].0).to_owned();
        let effect = |index: &Option<usize>, cause: usize| index.map_or(1.0, |index| PARAMETERS[index].2[cause]);
        let entry = |a: &Option<usize>, b: &Option<usize>| (0..2).map(|k| effect(a, k) * effect(b, k)).sum();
        calibration.covariance.order = order.iter().map(name).collect();
        calibration.covariance.rows = order.iter().map(|a| order.iter().map(|b| entry(a, b)).collect()).collect();
        calibration
    }

    /// 150 poses in the whole workspace, approached in both directions.
    fn statuses(model: &dyn KinematicModel) -> Vec<f64> {
        let names: Vec<&str> = model.info().status.iter().map(|column| column.name.as_str()).collect();
        assert_eq!(names, ["B", "X", "Y", "Z", "dir_X"]);
        let pose = |i: usize| {
            let t = i as f64;
            [(t * 0.7).sin() * 2.0, (t * 1.3).sin() * 400.0, (t * 2.1).sin() * 300.0, (t * 0.3).cos() * 200.0]
                .into_iter()
                .chain([if i.is_multiple_of(2) { 1.0 } else { -1.0 }])
        };
        (0..150).flat_map(pose).collect()
    }

    fn tips(model: &dyn KinematicModel, statuses: &[f64], values: &[(&str, f64)]) -> Vec<[f64; 3]> {
        let value = |name: &str| values.iter().find(|(other, _)| *other == name).map_or(0.0, |(_, value)| *value);
        let values: Vec<f64> = model.info().parameters.iter().map(|parameter| value(&parameter.name)).collect();
        let mut poses = Poses::default();
        model.poses(statuses, &values, &[], false, &mut poses).unwrap();
        poses.positions
    }

    /// The covariance is that of the two causes, each changed by itself: the sum of the outer products of their effects on
    /// the tip.
    #[test]
    fn covariance_is_that_of_the_causes() {
        let (model, calibration) = (model(), known());
        let statuses = statuses(model.as_ref());
        let found = predict(model.as_ref(), &calibration, &statuses).unwrap();
        assert_eq!(found.len(), 150);
        let moved = |cause: usize, by: f64| {
            let values = PARAMETERS
                .map(|(name, value, causes)| (name, value + if cause < 2 { by * causes[cause] } else { 0.0 }));
            tips(model.as_ref(), &statuses, &values)
        };
        let (actual, nominal) = (moved(2, 0.0), tips(model.as_ref(), &statuses, &[]));
        let effects = [0, 1].map(|cause| (moved(cause, 1.0), moved(cause, -1.0)));
        for (pose, found) in found.iter().enumerate() {
            for row in 0..3 {
                assert_eq!(found.mean[row], actual[pose][row] - nominal[pose][row]);
                for column in 0..3 {
                    let product = |(up, down): &(Vec<[f64; 3]>, Vec<[f64; 3]>)| {
                        (up[pose][row] - down[pose][row]) * (up[pose][column] - down[pose][column]) / 4.0
                    };
                    let expected: f64 = effects.iter().map(product).sum();
                    let difference = (found.covariance[row][column] - expected).abs();
                    // Entries are of the order of 1e-6 mm².
                    assert!(difference < 1e-12, "pose {pose}, {row} {column}: {difference}");
                    assert_eq!(found.covariance[row][column], found.covariance[column][row]);
                }
            }
            assert!((found.size().powi(2) - found.mean.iter().map(|x| x * x).sum::<f64>()).abs() < 1e-15);
            // Effects of the causes on the size, up to terms of third order in the effect over the size.
            let size = |tips: &[[f64; 3]]| {
                (0..3).map(|axis| (tips[pose][axis] - nominal[pose][axis]).powi(2)).sum::<f64>().sqrt()
            };
            let by_causes =
                effects.iter().map(|(up, down)| ((size(up) - size(down)) / 2.0).powi(2)).sum::<f64>().sqrt();
            let uncertainty = found.size_uncertainty().unwrap();
            assert!((uncertainty - by_causes).abs() < 1e-3 * by_causes, "pose {pose}: {uncertainty}, {by_causes}");
        }
    }

    #[test]
    fn without_a_covariance_there_is_none() {
        let model = model();
        let found = predict(model.as_ref(), &calibration(&[("dzt", 0.5)]), &[0.0, 10.0, 20.0, 30.0, 1.0]).unwrap();
        assert_eq!(found[0].covariance, [[0.0; 3]; 3]);
        assert_eq!(found[0].mean, [0.0, 0.0, 0.5]);
        assert_eq!(found[0].size_uncertainty(), Some(0.0));
        let perfect = predict(model.as_ref(), &calibration(&[]), &[0.0, 10.0, 20.0, 30.0, 1.0]).unwrap();
        assert_eq!((perfect[0].size(), perfect[0].size_uncertainty()), (0.0, None));
        assert_eq!(
            predict(model.as_ref(), &known(), &[0.0; 6]).unwrap_err().message,
            "6 numbers are no poses of 5 statuses each"
        );
        assert_eq!(predict(model.as_ref(), &known(), &[]).unwrap(), []);
    }
}
