//! Poses of a target on a positioner of two rotary axes against the truth that simulated files were made from, and poses
//! that others measured.

use abbe_core::{Calibration, Status};
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::{Value, json};

use crate::support::{Variant, effect, fit, json_file, recipes, root, skipped, values};

fn truth() -> Value {
    json_file(&root().join("tests/truth/positioner.json"))
}

fn recipe(data: &str) -> Variant {
    let file = root().join(format!("pipelines/data/positioner/{data}/poses.csv"));
    Variant::of(&recipes()["positioner"]).set("seen", "path", json!(file))
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// What the truth says less what was estimated, in mm and rad at the end of travel, with the standard uncertainty in the same
/// unit. Orientations of target and observer are told as differences from where the estimate started: they are not
/// compared here.
fn errors(calibration: &Calibration) -> Vec<(String, bool, f64, f64)> {
    let truth = truth();
    let parameters = truth["parameters"].as_object().expect("parameters");
    let estimated = values(calibration).filter(|estimated| estimated.status == Status::Estimated);
    let compared = estimated.filter_map(|estimated| {
        let name = estimated.name.strip_prefix("target.").filter(|_| estimated.name.matches('.').count() == 2);
        let value = parameters.get(name.unwrap_or(&estimated.name))?;
        let (is_angle, factor) = effect(&estimated.unit);
        let off = (number(value) - estimated.value) * factor;
        Some((estimated.name.clone(), is_angle, off, estimated.standard_uncertainty * factor))
    });
    compared.collect()
}

#[test]
fn exact_poses_give_the_truth_back() {
    let outcome = recipe("exact").run();
    let errors = errors(&fit(&outcome, "fit").calibration);
    assert_eq!(errors.len(), 12);
    for (name, is_angle, off, _) in errors {
        // Coordinates of the file are rounded to 1e-4 mm or better, the 56 poses average that.
        assert!(off.abs() < if is_angle { 1e-10 } else { 1e-8 }, "{name} is off by {off:e}");
    }
}

#[test]
fn noisy_poses_give_the_truth_back_within_the_stated_uncertainty() {
    let outcome = recipe("realistic").run();
    let errors = errors(&fit(&outcome, "fit").calibration);
    assert_eq!(errors.len(), 12);
    for (name, _, off, uncertainty) in errors {
        assert!(off.abs() < 4.0 * uncertainty, "{name} is off by {} standard uncertainties", off / uncertainty);
    }
}

#[test]
fn positions_and_orientations_are_told_apart() {
    let outcome = recipe("realistic").run();
    let report = &fit(&outcome, "fit").calibration.fit;
    let (positions, angles) = (report.residual_rms_um, report.residual_rms_urad.expect("orientations were seen"));
    // 20 um and 50 urad were added; 318 degrees of freedom are left of 336 equations.
    assert!((positions / 20.0 - 1.0).abs() < 0.2 && (angles / 50.0 - 1.0).abs() < 0.2, "{positions} um, {angles} urad");
}

/// A tilt-and-rotate positioner that others measured; the figures are those of an independent fit of two lines to the same
/// positions: 89.982 degrees, 0.635 mm, 0.40 mm RMS and 0.84 mm at most.
#[test]
fn a_real_positioner() {
    let file = root().join("../shared/real/positioner/poses.csv");
    if !file.is_file() {
        return skipped("a_real_positioner", "the poses that others measured are not shipped");
    }
    // The independent fit used positions alone.
    let recipe =
        recipe("realistic").set("seen", "path", json!(file)).set("target", "standard_uncertainty_um", json!(400));
    let found = recipe.set("target", "standard_uncertainty_urad", json!(1e7)).run();
    let lines = fit(&found, "lines");
    let value = |name: &str| lines.calibration.get(name).expect("it is estimated").value;
    let direction = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, value("EB0C"), 0.0)) * Vector3::z();
    let angle = direction.dot(&Vector3::x()).acos().to_degrees();
    assert!((angle - 89.982).abs() < 5e-4, "{angle} degrees");
    assert!((value("EY0C") - 0.635).abs() < 5e-4, "{} mm", value("EY0C"));

    let problem = &lines.problem;
    let residuals = problem.residuals(&problem.values_of(&lines.calibration)).expect("residuals");
    let norms: Vec<f64> = residuals.chunks_exact(6).map(|row| Vector3::from_column_slice(&row[..3]).norm()).collect();
    assert_eq!(norms.len(), 205);
    let rms = (norms.iter().map(|norm| norm * norm).sum::<f64>() / 205.0).sqrt();
    let max = norms.iter().copied().fold(0.0, f64::max);
    assert!((rms - 0.40).abs() < 5e-3 && (max - 0.84).abs() < 5e-3, "{rms} mm RMS, {max} mm at most");
}
