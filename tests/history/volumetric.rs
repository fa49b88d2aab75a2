//! The volumetric error over time, against a computation that shares no code with it, and drawn errors.

use abbe_core::{Variable, machine_values};
use abbe_volumetric::{Grid, Points, machine_covariance, predict};
use nalgebra::DVector;
use serde_json::Value;

use super::{near, number, parameter, trend, uncertain};
use crate::support::{Random, Variant, recipes};

/// Largest size and root mean square.
fn figures(sizes: &[f64]) -> [f64; 2] {
    let largest = sizes.iter().copied().fold(0.0, f64::max);
    let squares: f64 = sizes.iter().map(|size| size * size).sum();
    [largest, (squares / sizes.len() as f64).sqrt()]
}

#[test]
fn the_volumetric_error_of_every_week_is_that_of_its_calibration() {
    let outcome = Variant::of(&recipes()["history"]).run();
    let found = trend(&outcome);
    let weeks: Vec<_> = outcome.fits.iter().filter(|fit| fit.calibration.group.is_some()).collect();
    let model = weeks[0].problem.model.as_ref();
    let grid = Grid { points: Some(Points::Every(3)), both_directions: true, ..Grid::default() };
    let statuses = grid.statuses(model).expect("poses");
    let [largest, rms] = ["volumetric largest", "volumetric RMS"].map(|name| parameter(&found, name));
    let tests = largest["tests"].as_array().expect("tests");
    assert!(tests.len() > 35);
    let mut random = Random(7);
    for (place, test) in tests.iter().enumerate() {
        let label = &found["analysis"]["tests"][test.as_u64().expect("a test") as usize]["label"];
        let is_it = |label: &Value, own: &str| label.as_str() == Some(own);
        let week = weeks.iter().find(|fit| is_it(label, &fit.calibration.group.as_ref().expect("a group").label));
        let calibration = &week.expect("the week").calibration;
        let sizes: Vec<f64> =
            predict(model, calibration, &statuses).expect("errors").iter().map(|error| error.size()).collect();
        let [of_largest, of_rms] = figures(&sizes);
        let (value, uncertainty) = uncertain(&largest["values"][place]);
        near(value, of_largest, 1e-9, "largest");
        near(uncertain(&rms["values"][place]).0, of_rms, 1e-9, "root mean square");
        if place % 12 != 0 {
            continue;
        }
        // The spread of drawn errors is the stated uncertainty.
        let (wanted, covariance) = machine_covariance(model, calibration);
        let factor = covariance.cholesky().expect("a covariance").l();
        let drawn: Vec<[f64; 2]> = (0..400)
            .map(|_| {
                let steps = &factor * DVector::from_fn(wanted.len(), |_, _| random.normal());
                let mut moved = calibration.clone();
                let values = machine_values(model, calibration);
                for (variable, step) in wanted.iter().zip(&steps) {
                    let Variable::Parameter(index) = variable else { continue };
                    let name = &model.info().parameters[*index].name;
                    let known = moved.parameters.iter_mut().find(|known| known.name == *name).expect("a parameter");
                    known.value = values[*index] + step;
                }
                let errors = predict(model, &moved, &statuses).expect("errors");
                figures(&errors.iter().map(|error| error.size()).collect::<Vec<_>>())
            })
            .collect();
        for (figure, stated) in [(0, uncertainty), (1, uncertain(&rms["values"][place]).1)] {
            let mean = drawn.iter().map(|one| one[figure]).sum::<f64>() / 400.0;
            let spread = (drawn.iter().map(|one| (one[figure] - mean).powi(2)).sum::<f64>() / 399.0).sqrt();
            assert!((spread / stated - 1.0).abs() < 0.2, "{label}: {spread} drawn, {stated} stated");
        }
    }
    // It is no parameter: the number of changed ones is that without it.
    let verdict = outcome.verdicts.iter().find(|verdict| verdict.stage == "trend").expect("the verdict");
    let changed = verdict.figures.iter().find(|figure| figure.name == "changed parameters").expect("a figure");
    assert_eq!(changed.value, Some(4.0));
    assert!(number(&largest["again"]["value"]["value"]) > 0.0);
}
