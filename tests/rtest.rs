//! R-tests against the values that their data were simulated with.

use abbe_core::{Calibration, Status};
use serde_json::Value;

use crate::support::{Variant, fit, json_file, recipes, root, values};

/// True values with their factors.
type Sum = &'static [(&'static str, f64)];

/// What one ball on each axis tells, as sums of true values: tilts are those against the linear axes that follow, scales those against
/// the other linear axis, and the axis below counts with the one that it carries. A was approached upwards in the test of C.
const TOLD: [(&str, &str, Sum); 15] = [
    ("c-axis", "EA0C", &[("EA0C", 1.0), ("EA0A", 1.0), ("EAA[b]", 1.0)]),
    ("c-axis", "EB0C", &[("EB0C", 1.0), ("EB0A", 1.0)]),
    ("c-axis", "EC0X", &[("EC0X", 1.0)]),
    ("c-axis", "EYY[1]", &[("EYY[1]", 1.0), ("EXX[1]", -1.0)]),
    ("c-axis", "EXX[b]", &[("EXX[b]", 1.0)]),
    ("c-axis", "EYY[b]", &[("EYY[b]", 1.0)]),
    ("c-axis", "EYX[b]", &[("EYX[b]", 1.0)]),
    ("c-axis", "EXY[b]", &[("EXY[b]", 1.0)]),
    ("c-axis", "ECC[b]", &[("ECC[b]", 1.0)]),
    ("a-axis", "EB0A", &[("EB0A", 1.0), ("EB0Z", -1.0)]),
    ("a-axis", "EC0A", &[("EC0A", 1.0)]),
    ("a-axis", "EA0Z", &[("EA0Z", 1.0)]),
    ("a-axis", "EZZ[1]", &[("EZZ[1]", 1.0), ("EYY[1]", -1.0)]),
    ("a-axis", "EZZ[b]", &[("EZZ[b]", 1.0)]),
    ("a-axis", "EAA[b]", &[("EAA[b]", 1.0)]),
];

fn truth(data: &str) -> Value {
    json_file(&root().join(format!("tests/truth/standards-{data}-truth.json")))["parameters"].take()
}

fn told(calibration: &Calibration, name: &str, of: &[(&str, f64)], truth: &Value) -> (f64, f64) {
    let found = calibration.get(name).unwrap_or_else(|| panic!("no {name}"));
    // The set has no EA0A.
    let expected =
        of.iter().map(|(own, sign)| sign * truth.get(own).and_then(Value::as_f64).unwrap_or(0.0)).sum::<f64>();
    (found.value - expected, found.standard_uncertainty)
}

#[test]
fn exact_readings_give_the_truth_back() {
    let (outcome, truth) = (Variant::of(&recipes()["standards-rtest-exact"]).run(), truth("exact"));
    for (estimate, name, of) in TOLD {
        let (off, _) = told(&fit(&outcome, estimate).calibration, name, of, &truth);
        // Products of errors that are not estimated: mm and rad.
        let allowed =
            if name.ends_with("[b]") && name.starts_with(['E']) && !name.starts_with("EA") && !name.starts_with("EC") {
                3e-7
            } else {
                2e-8
            };
        assert!(off.abs() < allowed, "{estimate}: {name} is off by {off:e}");
    }
}

#[test]
fn noisy_readings_hold_the_truth_within_their_uncertainty() {
    let (outcome, truth) = (Variant::of(&recipes()["standards-rtest"]).run(), truth("realistic"));
    let mut squares = 0.0;
    for (estimate, name, of) in TOLD {
        let (off, uncertainty) = told(&fit(&outcome, estimate).calibration, name, of, &truth);
        let error = off / uncertainty;
        assert!(error.abs() < 3.0, "{estimate}: {name} is {error} standard uncertainties off");
        squares += error * error;
    }
    // Fifteen numbers: the root of their mean square within 99.8 %.
    let size = (squares / TOLD.len() as f64).sqrt();
    assert!((0.45..1.6).contains(&size), "{size}");
}

/// All errors of location and of the linear axes: seven directions are lost for C, and each is named.
#[test]
fn what_one_ball_cannot_tell_is_named() {
    let mut variant = Variant::of(&recipes()["standards-rtest-exact"]).only(&["c-axis"]);
    let stage = variant.stage("c-axis");
    stage["parameters"] = serde_json::json!(["dxt", "dyt", "dzt", "E?0C", "EXX[1]", "EYY[1]", "EC0X", "at-c.*"]);
    stage["on_confounded"] = serde_json::json!("minimum-norm");
    let outcome = variant.run();
    let calibration = &fit(&outcome, "c-axis").calibration;
    let names: Vec<&str> =
        values(calibration).filter(|own| own.status == Status::Confounded).map(|own| own.name.as_str()).collect();
    assert_eq!(calibration.fit.unknowns - calibration.fit.rank, 6, "{names:?}");
    for name in ["dxt", "EX0C", "dyt", "EY0C", "dzt", "EZ0C", "EC0C", "EXX[1]", "EYY[1]"] {
        assert!(names.contains(&name), "{name} of {names:?}");
    }
    for name in ["EA0C", "EB0C", "EC0X"] {
        assert!(!names.contains(&name), "{name} of {names:?}");
    }
}
