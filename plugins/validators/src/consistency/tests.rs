//! Tests of `consistency`.

use super::*;
use crate::testing::{UPWARDS, figure_of, validator};
use abbe_core::ConsideredInput;
use tempfile::TempDir;

type Known<'a> = (&'a [(&'a str, f64)], &'a [&'a [f64]]);

/// A fit with some values of the machine, µm, and their covariance, µm².
fn fit(name: &str, (values, covariance): Known) -> (TempDir, Fit) {
    let (folder, mut fit) = crate::testing::fit(&UPWARDS, &[("a", "1", 0.0, 0.0), ("a", "1", 0.0, 2.0)], false);
    fit.name = name.to_owned();
    let calibration = &mut fit.calibration;
    for parameter in &mut calibration.parameters {
        if let Some((_, value)) = values.iter().find(|(name, _)| *name == parameter.name) {
            parameter.value = value * 1e-3;
            parameter.status = Status::Estimated;
        }
    }
    calibration.covariance.order = values.iter().map(|(name, _)| (*name).to_owned()).collect();
    calibration.covariance.rows = covariance.iter().map(|row| row.iter().map(|entry| entry * 1e-6).collect()).collect();
    (folder, fit)
}

fn judge(settings: &Value, fits: &[&Fit]) -> Result<Findings, String> {
    let found = validator("consistency", Path::new(""), settings)?.validate(fits, &[]);
    found.map_err(|error| format!("{}: {error}", abbe_core::path_text(&error.setting)))
}

const FIRST: Known =
    (&[("dxt", 1.0), ("dyt", 2.0), ("dzt", 5.0)], &[&[2.0, 0.5, 0.0], &[0.5, 1.0, 0.0], &[0.0, 0.0, 9.0]]);

#[test]
fn chi_squared_by_hand() {
    let (_a, first) = fit("a", FIRST);
    let (_b, other) = fit("b", (&[("dyt", 5.0), ("dxt", 2.0)], &[&[3.0, 1.5], &[1.5, 2.0]]));
    let found = judge(&json!({}), &[&first, &other]).unwrap();
    // d = (1, 3), C = (4, 2; 2, 4): d^T C^-1 d = (4 - 12 + 36) / 12; Q(7/3; 2) = exp(-7/6).
    let value = |name: &str| figure_of(&found, "b", name);
    assert!((value("chi-squared") - 28.0 / 12.0).abs() < 1e-12);
    assert_eq!(value("degrees of freedom"), 2.0);
    assert!((value("probability") - (-14.0_f64 / 12.0).exp()).abs() < 1e-9);
    assert!((value("largest normalised difference") - 1.5).abs() < 1e-12);
    let main = &found.figures[0];
    assert!((main.limit.unwrap() + 2.0 * 0.05_f64.ln()).abs() < 1e-6);
    assert!(main.passes());
    assert_eq!(found.remarks, ["b against a: dyt differs most, by +1.5 of its standard uncertainties"]);
    // At a significance of one half the limit is 2 ln 2.
    let found = judge(&json!({ "significance": 0.5 }), &[&first, &other]).unwrap();
    assert!(!found.figures[0].passes());
    let found = judge(&json!({ "parameters": ["dx?"] }), &[&first, &other, &first]).unwrap();
    assert!((figure_of(&found, "b", "chi-squared") - 0.25).abs() < 1e-12);
    assert_eq!(figure_of(&found, "a", "chi-squared"), 0.0);
    assert!(found.remarks.iter().any(|remark| remark.starts_with("a against a: both use rows of ")));
}

/// Two calibrations of dxt and dyt that depend on one bar, µm.
fn with_a_bar(name: &str, values: [f64; 2], sensitivities: [f64; 2], rows: &[&[f64]]) -> (TempDir, Fit) {
    let (folder, mut fit) = fit(name, (&[("dxt", values[0]), ("dyt", values[1])], rows));
    fit.calibration.inputs = Some(vec![ConsideredInput {
        name: format!("{name}.length"),
        identity: "bar 7: length".to_owned(),
        value: 300.0,
        unit: "mm".to_owned(),
        standard_uncertainty: 1e-3,
        sensitivities: sensitivities.to_vec(),
    }]);
    (folder, fit)
}

#[test]
fn what_both_share_is_no_part_of_their_difference() {
    // The bar, u = 1 um, moves dxt of both by as much as it is off, and dyt by twice as much, in the second one backwards. Of
    // C1 = C2 = (3, 2; 2, 7) it is (1, 2; 2, 4) and (1, -2; -2, 4); C12 = (1, -2; 2, -4).
    let (_a, first) = with_a_bar("a", [1.0, 0.0], [1.0, 2.0], &[&[3.0, 2.0], &[2.0, 7.0]]);
    let (_b, mut other) = with_a_bar("b", [3.0, 0.0], [1.0, -2.0], &[&[3.0, -2.0], &[-2.0, 7.0]]);
    // C = C1 + C2 - C12 - C12' = (4, 0; 0, 22).
    let found = judge(&json!({}), &[&first, &other]).unwrap();
    assert!((figure_of(&found, "b", "chi-squared") - 1.0).abs() < 1e-12);
    assert!((figure_of(&found, "b", "largest normalised difference") - 1.0).abs() < 1e-12);
    assert!(found.remarks.iter().any(|remark| remark.ends_with("both share the errors of a.length")));
    // Another bar: C = (6, 0; 0, 14).
    other.calibration.inputs.as_mut().unwrap()[0].identity = "bar 8: length".to_owned();
    let found = judge(&json!({}), &[&first, &other]).unwrap();
    assert!((figure_of(&found, "b", "chi-squared") - 4.0 / 6.0).abs() < 1e-12);
    // Nothing but the bar: what both know is the same, whatever it is, and a difference cannot be chance.
    let rows: &[&[f64]] = &[&[1.0, 2.0], &[2.0, 4.0]];
    let (_a, first) = with_a_bar("a", [1.0, 0.0], [1.0, 2.0], rows);
    for (value, chi_squared) in [(1.0, Some(0.0)), (1.1, None)] {
        let (_b, other) = with_a_bar("b", [value, 0.0], [1.0, 2.0], rows);
        let found = judge(&json!({}), &[&first, &other]).unwrap();
        assert_eq!((found.figures[0].value, figure_of(&found, "b", "degrees of freedom")), (chi_squared, 0.0));
    }
}

#[test]
fn directions_without_uncertainty() {
    let (_a, first) =
        fit("a", (&[("dxt", 0.0), ("dyt", 0.0), ("dzt", 3.0)], &[&[1.0, 1.0, 0.0], &[1.0, 1.0, 0.0], &[0.0; 3]]));
    let cases = [
        // Both move together, as they have to.
        ([2.0, 2.0, 3.0], Some(2.0), 0.157_299_207),
        // The difference of the two is exact and is not zero.
        ([2.0, 1.9, 3.0], None, 0.0),
        // dzt is exact in both.
        ([2.0, 2.0, 3.1], None, 0.0),
    ];
    for ([x, y, z], chi_squared, probability) in cases {
        let rows: &[&[f64]] = &[&[1.0, 1.0, 0.0], &[1.0, 1.0, 0.0], &[0.0; 3]];
        let (_b, other) = fit("b", (&[("dxt", x), ("dyt", y), ("dzt", z)], rows));
        let found = judge(&json!({}), &[&first, &other]).unwrap();
        let main = &found.figures[0];
        assert_eq!(main.value.map(|value| (value * 1e9).round() / 1e9), chi_squared);
        assert_eq!((main.passes(), figure_of(&found, "b", "degrees of freedom")), (chi_squared.is_some(), 1.0));
        assert!((figure_of(&found, "b", "probability") - probability).abs() < 1e-8);
        assert_eq!(found.remarks.len(), if chi_squared.is_some() { 1 } else { 2 });
    }
}

/// Calibrations whose differences are drawn from their covariance fail as often as they are allowed to.
#[test]
fn true_agreement_fails_at_the_significance() {
    let mut state = 7_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((state >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    };
    let mut normal = || (-2.0 * uniform().ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos();
    let (_a, mut first) = fit("a", FIRST);
    let (_b, mut other) = fit("b", FIRST);
    let mut failed = 0;
    for _ in 0..2000 {
        for fit in [&mut first, &mut other] {
            // The root of the covariance: 2 = 1.414², 0.5 = 1.414 * 0.354, 1 = 0.354² + 0.935².
            let (one, two, three) = (normal(), normal(), normal());
            let root = 0.875_f64.sqrt();
            let drawn = [2.0_f64.sqrt() * one, one / 8.0_f64.sqrt() + root * two, 3.0 * three];
            for (name, value) in ["dxt", "dyt", "dzt"].into_iter().zip(drawn) {
                let parameters = &mut fit.calibration.parameters;
                parameters.iter_mut().find(|parameter| parameter.name == name).unwrap().value = value * 1e-3;
            }
        }
        let found = judge(&json!({ "significance": 0.1 }), &[&first, &other]).unwrap();
        failed += usize::from(!found.figures[0].passes());
    }
    // 200 expected, standard deviation 13.4.
    assert!((150..250).contains(&failed), "{failed}");
}

/// Two parameters whose covariances were found by repeats, or by trials that drew from them.
#[test]
fn degrees_of_freedom_count_in_fits_and_in_trials() {
    let budget = |name: &str, freedom: f64| {
        json!({
            "name": name, "unit": "mm", "standard_uncertainty": 1.0, "stated_standard_uncertainty": 1.0,
            "degrees_of_freedom": freedom, "coverage_factor": 2.0, "expanded_uncertainty": 2.0, "contributions": [],
        })
    };
    let trial = |name: &str, freedom: f64| {
        json!({
            "name": name, "unit": "mm", "mean": 0.0, "standard_uncertainty": 1.0, "degrees_of_freedom": freedom,
            "symmetric_interval": [0.0, 1.0], "shortest_interval": [0.0, 1.0],
            "gum": { "interval": [0.0, 1.0], "differences": [0.0, 0.0], "tolerance": 1.0, "validated": true },
        })
    };
    let with = |fit: &mut Fit, freedom: f64, trials: bool| {
        let all = |one: &dyn Fn(&str, f64) -> Value| vec![one("dxt", freedom), one("dyt", 40.0), one("dct", 1.0)];
        fit.calibration.uncertainty = (!trials).then(|| {
            let joint = json!({ "quantities": 3, "ellipsoid_factor": null, "rectangle_factor": 2.0 });
            let parameters = all(&budget);
            let budget = json!({
                "coverage_probability": 0.95, "scale": 1.0, "joint": joint, "parameters": parameters, "correlations": [],
            });
            serde_json::from_value(budget).unwrap()
        });
        fit.calibration.monte_carlo = trials.then(|| {
            let found = json!({
                "trials": 1000, "seed": 1, "stable": null, "failed": 0, "coverage_probability": 0.95, "inputs": [],
                "parameters": all(&trial),
            });
            serde_json::from_value(found).unwrap()
        });
    };
    let (_a, mut first) = fit("a", FIRST);
    let (_b, mut other) = fit("b", (&[("dyt", 5.0), ("dxt", 2.0)], &[&[3.0, 1.5], &[1.5, 2.0]]));
    for trials in [false, true] {
        with(&mut first, 10.0, trials);
        with(&mut other, 12.0, trials);
        let found = judge(&json!({}), &[&first, &other]).unwrap();
        // Two quantities and ten degrees of freedom: 20/9 of F(0.95; 2, 9) = 4.2565.
        assert!((found.figures[0].limit.unwrap() - 20.0 / 9.0 * 4.2565).abs() < 1e-3, "{trials}");
        with(&mut other, 1.5, trials);
        assert_eq!(
            judge(&json!({}), &[&first, &other]).unwrap_err(),
            "parameters: b against a: 2 parameters cannot be compared by a covariance that was found with 1.5 degrees of \
             freedom (compare at most 1 `parameters`)"
        );
    }
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let (_a, first) = fit("a", FIRST);
    let (_b, mut other) = fit("b", (&[("dxt", 2.0)], &[&[1.0]]));
    let cases = [
        (
            json!({ "parameters": ["dzt"] }),
            "parameters[0]: `dzt` matches no parameter that a and b both estimated (did you mean `dxt`?)",
        ),
        (json!({ "significance": 5 }), "significance: a number between 0 and 1 was expected"),
    ];
    for (settings, expected) in cases {
        assert_eq!(judge(&settings, &[&first, &other]).unwrap_err(), expected);
    }
    assert_eq!(
        judge(&json!({}), &[&first]).unwrap_err(),
        "of: two estimates or more were expected: they are compared with the first"
    );
    for parameter in &mut other.calibration.parameters {
        if parameter.name == "dxt" {
            parameter.status = Status::Confounded;
        }
    }
    assert_eq!(
        judge(&json!({}), &[&first, &other]).unwrap_err(),
        ": a and b estimated no parameter of the machine in common"
    );
}
