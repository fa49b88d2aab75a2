//! Tests of `uncertainty`.

use super::*;
use crate::testing::{UPWARDS, check, judge};
use tempfile::TempDir;

/// A fit whose machine has uncertain tool offsets and a rotation of the tool; two touches on facet a, one on b.
fn fit() -> (TempDir, Fit) {
    let (folder, mut fit) = crate::testing::fit(&UPWARDS, &[("a", "1", 0.0, 0.0), ("a", "1", 0.0, 2.0)], false);
    let known = [("dxt", 0.3, 2e-3), ("dyt", 0.4, 1e-3), ("dct", 0.0, 5e-6)];
    let calibration = &mut fit.calibration;
    for parameter in &mut calibration.parameters {
        if let Some((_, value, uncertainty)) = known.iter().find(|(name, ..)| *name == parameter.name) {
            (parameter.value, parameter.standard_uncertainty) = (*value, *uncertainty);
            parameter.status = Status::Estimated;
        }
    }
    calibration.covariance.order = known.map(|(name, ..)| name.to_owned()).to_vec();
    let row = |row: usize| (0..3).map(|column| if row == column { known[row].2.powi(2) } else { 0.0 }).collect();
    calibration.covariance.rows = (0..3).map(row).collect();
    (folder, fit)
}

/// Checks which figures have a standard uncertainty, to a picometre.
fn assert_uncertain(findings: &Findings, expected: &[(&str, f64)]) {
    let found = (findings.figures.iter())
        .filter_map(|figure| Some((figure.name.as_str(), figure.standard_uncertainty?)))
        .collect::<Vec<_>>();
    let near =
        |((one, size), (other, expected)): (&(&str, f64), &(&str, f64))| one == other && (size - expected).abs() < 1e-6;
    assert!(found.len() == expected.len() && found.iter().zip(expected).all(near), "{found:?}, expected {expected:?}");
}

#[test]
fn parameters_against_their_limits() {
    let (folder, fit) = fit();
    let settings = json!({ "parameters": [
        { "names": ["d?t"], "expanded_um": 3 },
        { "names": ["dct"], "standard_uncertainty_urad": 5 },
        { "names": ["table.facet[a].d"], "standard_uncertainty_um": 1.1 }
    ] });
    // The rotation is in another unit than the offsets.
    assert_eq!(
        judge("uncertainty", folder.path(), &settings, &fit).unwrap_err(),
        "parameters[0].expanded_um: `dct` is in µrad, `expanded_um` is not its limit (write `expanded_urad`)"
    );
    let mut settings = settings;
    settings["parameters"][0]["names"] = json!(["dxt", "dyt"]);
    let found = judge("uncertainty", folder.path(), &settings, &fit).unwrap();
    // Residuals of -1 and 1 µm with one degree of freedom: 1.414 µm, over the root of two touches.
    check(
        &found,
        &[
            ("expanded[dxt, dyt]", 4.0),
            ("expanded[dxt]", 4.0),
            ("expanded[dyt]", 2.0),
            ("standard uncertainty[dct]", 5.0),
            ("standard uncertainty[table.facet[a].d]", 1.0),
        ],
    );
    let failed: Vec<&str> =
        found.figures.iter().filter(|figure| !figure.passes()).map(|figure| figure.name.as_str()).collect();
    assert_eq!(failed, ["expanded[dxt, dyt]", "expanded[dxt]"]);
    assert_eq!(found.remarks, ["fit: dxt, dyt: the largest is that of dxt (4.000 µm)"]);
    settings["coverage_factor"] = json!(3);
    check(&judge("uncertainty", folder.path(), &settings, &fit).unwrap(), &[("expanded[dyt]", 3.0)]);
}

#[test]
fn what_is_confounded_fails() {
    let (folder, mut fit) = fit();
    fit.calibration.parameters.iter_mut().find(|parameter| parameter.name == "dyt").unwrap().status =
        Status::Confounded;
    let settings = json!({ "parameters": [{ "names": ["dxt", "dyt"], "expanded_um": 30 }],
        "volumetric": { "grid": { "poses": [{}] }, "expanded_um": 30 } });
    let found = judge("uncertainty", folder.path(), &settings, &fit).unwrap();
    let failed: Vec<(&str, Option<f64>)> = (found.figures.iter())
        .filter(|figure| !figure.passes())
        .map(|figure| (figure.name.as_str(), figure.value))
        .collect();
    assert_eq!(failed, [("expanded[dxt, dyt]", None), ("expanded[dyt]", None)]);
    assert_eq!(
        found.remarks,
        [
            "fit: dyt has no uncertainty: the data cannot separate it from others",
            "fit: the volumetric uncertainty leaves out what the data cannot separate: dyt"
        ]
    );
}

#[test]
fn the_tip_over_the_workspace() {
    let (folder, fit) = fit();
    let grid = json!({ "points": { "X": 3 }, "axes": { "X": { "from_mm": -100, "to_mm": 100 } } });
    let settings = json!({ "volumetric": { "grid": grid, "expanded_um": 4.8 } });
    let found = judge("uncertainty", folder.path(), &settings, &fit).unwrap();
    // Two directions are uncertain, by 2 and 1 µm, and a rotation about the tool's own axis moves nothing.
    let semi_axis = (-2.0 * 0.05_f64.ln()).sqrt() * 2.0;
    check(
        &found,
        &[
            ("volumetric error max", 500.0),
            ("volumetric error mean", 500.0),
            ("volumetric expanded max", semi_axis),
            ("volumetric expanded mean", semi_axis),
            ("volumetric poses", 3.0),
        ],
    );
    assert_eq!(found.figures.iter().filter(|figure| !figure.passes()).count(), 1);
    // The error points along (0.6, 0.8), where the offsets are uncertain by 2 and 1 µm.
    assert_uncertain(&found, &[("volumetric error max", (0.36_f64 * 4.0 + 0.64).sqrt())]);
}

#[test]
fn uncertainties_are_as_certain_as_their_degrees_of_freedom() {
    let (folder, mut fit) = fit();
    let judged = |settings: Value, fit: &Fit| judge("uncertainty", folder.path(), &settings, fit).unwrap();
    let limited = |key: &str, limit: f64| json!({ "parameters": [{ "names": ["table.facet[a].d"], key: limit }] });
    let of = |key: &str| limited(key, 0.5);
    // Nobody says how many there are.
    assert_uncertain(&judged(of("expanded_um"), &fit), &[]);
    fit.calibration.uncertainty = fit.estimator.explain(&fit.problem).unwrap().uncertainty;
    // Two touches leave one: 1 µm, expanded by 12.706.
    let half = 0.5_f64.sqrt();
    let (standard, expanded) = ("standard uncertainty[table.facet[a].d]", "expanded[table.facet[a].d]");
    assert_uncertain(&judged(of("standard_uncertainty_um"), &fit), &[(standard, half)]);
    // Below a limit it is that of one as large as the limit.
    assert_uncertain(&judged(limited("standard_uncertainty_um", 30.0), &fit), &[(standard, 30.0 * half)]);
    let mut one = fit.calibration.uncertainty.as_ref().unwrap().parameters[0].clone();
    assert!((one.coverage_factor - 12.706).abs() < 1e-3, "{one:?}");
    assert_uncertain(&judged(of("expanded_um"), &fit), &[(expanded, one.coverage_factor * half)]);
    let mut twice = of("expanded_um");
    twice["coverage_factor"] = json!(2);
    assert_uncertain(&judged(twice.clone(), &fit), &[(expanded, 2.0 * half)]);
    // The largest of several is as certain as the one that it is.
    (one.name, one.degrees_of_freedom) = ("dxt".to_owned(), Some(8.0));
    fit.calibration.uncertainty.as_mut().unwrap().parameters.push(one);
    twice["parameters"][0]["names"] = json!(["table.*", "dxt"]);
    let main = ("expanded[table.*, dxt]", 1.0);
    assert_uncertain(&judged(twice.clone(), &fit), &[main, ("expanded[dxt]", 1.0), (expanded, 2.0 * half)]);
    // Infinitely many: known exactly.
    fit.calibration.uncertainty.as_mut().unwrap().parameters[0].degrees_of_freedom = None;
    assert_uncertain(&judged(of("expanded_um"), &fit), &[(expanded, 0.0)]);
}

#[test]
fn settings_that_make_no_sense_are_refused() {
    let (folder, fit) = fit();
    let cases = [
        (json!({}), "`parameters` or `volumetric` were expected: nothing is judged"),
        (
            json!({ "parameters": [{ "names": ["dxt"] }] }),
            "parameters[0]: 0 limits; one was expected (write one, e.g. `expanded_um: 5` or \
             `standard_uncertainty_urad: 2`)",
        ),
        (
            json!({ "parameters": [{ "names": ["dxt"], "max_um": 2 }] }),
            "parameters[0].max_um: unknown setting `max_um` (write one, e.g. `expanded_um: 5` or \
             `standard_uncertainty_urad: 2`)",
        ),
        (
            json!({ "parameters": [{ "names": [], "expanded_um": 2 }] }),
            "parameters[0].names: at least one name was expected",
        ),
        (
            json!({ "parameters": [{ "names": ["dxt"], "expanded_um": -2 }] }),
            "parameters[0].expanded_um: -2: a limit from 0 to 1e6 was expected",
        ),
        (
            json!({ "parameters": [{ "names": ["dxt"], "expanded_um": { "limit": -2 } }] }),
            "parameters[0].expanded_um: -2: a limit from 0 to 1e6 was expected",
        ),
        (
            json!({ "parameters": [{ "names": ["dxt"], "expanded_um": { "limit": 2, "decision": "simpel" } }] }),
            "parameters[0].expanded_um.decision: unknown choice `simpel` (did you mean `simple`?)",
        ),
        (
            json!({ "parameters": [{ "names": "dxt", "expanded_um": 2 }] }),
            "parameters[0].names: the text `dxt` was found; a list was expected",
        ),
        (json!({ "parameters": [{ "expanded_um": 2 }] }), "parameters[0]: the setting `names` is missing"),
        (json!({ "parameters": ["dxt"] }), "parameters[0]: the text `dxt` was found; a map of settings was expected"),
        (
            json!({ "parameters": [{ "names": ["dxt", "dxtt"], "expanded_um": 2 }] }),
            "parameters[0].names[1]: `dxtt` matches no estimated parameter of fit (did you mean `dxt`?)",
        ),
        (
            json!({ "parameters": [{ "names": ["dxt"], "expanded_mm": 2 }] }),
            "parameters[0].expanded_mm: `dxt` is in µm, `expanded_mm` is not its limit (write `expanded_um`)",
        ),
        (
            json!({ "volumetric": { "grid": { "points": 3 } } }),
            "volumetric.grid.axes: the range of axis X is not known (write `axes: { X: { from_mm: .., to_mm: .. } }` \
             here, or `range_mm` into the machine description; or hold the axis: `at: { X_mm: 0 }`)",
        ),
        (
            json!({ "volumetric": { "grid": {} } }),
            "volumetric.grid: `points`, `step_mm` with `step_deg`, or `poses` were expected",
        ),
        (
            json!({ "volumetric": { "grid": { "points": 3 }, "probability": 95 } }),
            "volumetric.probability: a number between 0 and 1 was expected",
        ),
    ];
    for (settings, expected) in cases {
        let told = judge("uncertainty", folder.path(), &settings, &fit).unwrap_err();
        assert!(told.starts_with(expected), "{told}");
    }
}

#[test]
fn limits_end_with_the_unit_of_people() {
    let cases = [
        ("mm", "_um", 1e3),
        ("rad", "_urad", 1e6),
        ("mm/mm", "_um_per_m", 1e6),
        ("rad/mm^2", "_urad_per_m2", 1e12),
        ("mm/rad^4", "_um_per_rad4", 1e3),
        ("1", "", 1.0),
    ];
    for (unit, expected, factor) in cases {
        let parameter = Estimated {
            name: "p".to_owned(),
            value: 0.0,
            unit: unit.to_owned(),
            standard_uncertainty: 0.0,
            status: Status::Estimated,
        };
        let (symbol, found) = for_people(&parameter).unwrap();
        assert_eq!((suffix(&symbol).as_str(), found), (expected, factor));
    }
}
