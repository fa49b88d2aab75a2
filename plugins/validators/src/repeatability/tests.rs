//! Tests of `repeatability`.

use super::*;
use crate::testing::{Touch, UPWARDS, check, judge, validator};
use std::path::Path;

fn data(text: &str) -> (tempfile::TempDir, Dataset) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("repeats.csv");
    std::fs::write(&file, text).unwrap();
    (folder, abbe_table::read(&file).unwrap())
}

fn judged(settings: &Value, text: &str) -> Result<Findings, String> {
    let (folder, data) = data(text);
    let found = validator("repeatability", Path::new(""), settings)?.validate(&[], &[&data]);
    found.map_err(|error| {
        let text = error.to_string().replace(&format!("{}/", folder.path().display()), "");
        format!("{}: {text}", abbe_core::path_text(&error.setting))
    })
}

/// The figures in the order of their names, NaN where there is none.
fn values(findings: &Findings, label: Option<&str>) -> Vec<f64> {
    let value = |name: &str| {
        let name = label.map_or(name.to_owned(), |label| format!("{name}[{label}]"));
        let found = findings.figures.iter().find(|figure| figure.name == name).unwrap();
        assert_eq!((&found.of, found.unit.as_str(), found.detail), (&None, "um", label.is_some()));
        found.value.unwrap_or(f64::NAN)
    };
    FIGURES.iter().map(|name| value(name)).collect()
}

fn close(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    for ((found, expected), name) in found.iter().zip(expected).zip(FIGURES) {
        let same = (found - expected).abs() < 1e-9 || found.is_nan() && expected.is_nan();
        assert!(same, "{name}: {found}, expected {expected}");
    }
}

/// Point a: 0 2 | 4 8 | 6, point b: 1 1 | 3 3 | 12, in micrometres; windows of 2, the last one of a single value.
#[test]
fn closed_forms() {
    let text = "feature,cycle,d_um\na,1,0\nb,1,1\na,2,2\nb,2,1\na,3,4\nb,3,3\na,10,6\na,4,8\nb,4,3\nb,10,12\n";
    let settings = json!({ "value": "d", "cycle": "cycle", "window": 2, "limits": { "repeatability_um": 2 } });
    let found = judged(&settings, text).unwrap();
    // Squares within windows: a 2 + 8, b 0 + 0, two degrees of freedom each; means 4 and 4.
    // Cycle means: 0.5, 1.5, 3.5, 5.5, 9: mean 4, squares 12.25 + 6.25 + 0.25 + 2.25 + 25 = 46.
    // All: mean 4, squares 16 + 4 + 0 + 16 + 4 + 9 + 9 + 1 + 1 + 64 = 124.
    let expected = [5.0_f64.sqrt(), 2.5_f64.sqrt(), 0.0, 0.0, 11.5_f64.sqrt(), 8.5, (124.0 / 9.0_f64).sqrt(), 12.0];
    close(&values(&found, None), &expected);
    let failed: Vec<&str> =
        found.figures.iter().filter(|figure| !figure.passes()).map(|figure| figure.name.as_str()).collect();
    assert_eq!(failed, ["repeatability"]);
    assert!(found.remarks.is_empty());
    // A last window of two counts with one degree of freedom: 0 2 4 | 8 6 and 1 1 3 | 3 12.
    let settings = json!({ "value": "d", "cycle": "cycle", "window": 3 });
    let (a, b) = (8.0 + 2.0, 8.0 / 3.0 + 40.5);
    let found = values(&judged(&settings, text).unwrap(), None);
    close(&found[..2], &[(b / 3.0_f64).sqrt(), ((a + b) / 6.0_f64).sqrt()]);
}

#[test]
fn directions_and_missing_measurements() {
    // In Z point b is not measured in the second cycle and c only once; without a column the rows make the cycles.
    let text = "feature,cycle,k,d_um\na,1,X,0\na,2,X,3\na,1,Z,0\nb,1,Z,5\nc,1,Z,7\na,2,Z,1\na,3,Z,2\nb,3,Z,7\n";
    let settings = json!({ "value": "d", "cycle": "cycle", "direction": "k" });
    let found = judged(&settings, text).unwrap();
    let nan = f64::NAN;
    let x = [4.5_f64.sqrt(), 4.5_f64.sqrt(), nan, nan, 4.5_f64.sqrt(), 3.0, 4.5_f64.sqrt(), 3.0];
    close(&values(&found, Some("X")), &x);
    // Point means 1, 6, 7; only a is measured in all cycles: 0, 1, 2. All: mean 11/3, squares 128 - 6 * 121/9.
    let total = ((128.0 - 242.0 / 3.0) / 5.0_f64).sqrt();
    let surface = ((86.0 - 196.0 / 3.0) / 2.0_f64).sqrt();
    let z = [2.0_f64.sqrt(), (4.0 / 3.0_f64).sqrt(), surface, 6.0, 1.0, 2.0, total, 7.0];
    close(&values(&found, Some("Z")), &z);
    // The main figures are the largest of both; what one of them does not have, nobody has.
    let largest: Vec<f64> = x.iter().zip(z).map(|(x, z)| if x.is_nan() { nan } else { x.max(z) }).collect();
    close(&values(&found, None), &largest);
    assert_eq!(found.remarks, ["feature measured once only in direction Z, no repeatability: c"]);
    // Without a point that is measured in all cycles there is no drift.
    let found = judged(&settings, "feature,cycle,k,d_um\na,1,X,0\na,2,X,3\nb,3,X,0\n").unwrap();
    assert!(values(&found, None)[DRIFT].is_nan());
    assert_eq!(found.remarks[1], "no feature is measured in all cycles in direction X: no drift is told");
    // By rows the second measurement of b belongs to the second cycle, so nobody has all three but a.
    close(&values(&judged(&json!({ "value": "d", "direction": "k" }), text).unwrap(), Some("Z"))[4..6], &[1.0, 2.0]);
}

/// A surface of 2 µm, a slow drift of 10 µm and noise of 0.6 µm are told apart.
#[test]
fn simulated_parts_are_found() {
    let mut state = 3_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((state >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    };
    let mut normal = || (-2.0 * uniform().ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos();
    let surface: Vec<f64> = (0..25).map(|_| 2.0 * normal()).collect();
    let mut text = "feature,d_urad\n".to_owned();
    for cycle in 0..100 {
        for (point, surface) in surface.iter().enumerate() {
            let drift = 10.0 * (-f64::from(cycle) / 30.0).exp();
            text.push_str(&format!("{point},{}\n", surface + drift + 0.6 * normal()));
        }
    }
    let found = judged(&json!({ "value": "d", "limits": { "repeatability_urad": 1 } }), &text).unwrap();
    let value = |name: &str| {
        let figure = found.figures.iter().find(|figure| figure.name == name).unwrap();
        assert_eq!(figure.unit, if name == "measurements" { "1" } else { "urad" });
        figure.value.unwrap()
    };
    assert_eq!(value("measurements"), 2500.0);
    // The drift inside a window of five, 0.33 µrad a cycle at first, adds a little.
    assert!((value("pooled repeatability") - 0.62).abs() < 0.03);
    assert!(value("repeatability") > value("pooled repeatability") && value("repeatability") < 0.8);
    let of_surface = Sample(surface);
    assert!((value("surface standard deviation") - of_surface.standard_deviation()).abs() < 0.05);
    assert!((value("surface range") - range(&of_surface)).abs() < 0.3);
    assert!((value("drift range") - 10.0 * (1.0 - (-3.3_f64).exp())).abs() < 0.5);
}

#[test]
fn residuals_of_a_fit() {
    // The offsets take the means 1 and 0: residuals of b are free of them as those of a are.
    let touches: [Touch; 7] = [
        ("a", "1", 0.0, 0.0),
        ("b", "1", 0.0, -1.0),
        ("a", "2", 0.0, 2.0),
        ("b", "2", 0.0, 1.0),
        ("c", "1", 0.0, 4.0),
        ("a", "3", 0.0, 1.0),
        ("b", "3", 0.0, 0.0),
    ];
    let (folder, fit) = crate::testing::fit(&UPWARDS, &touches, false);
    let settings = json!({ "rows": "table", "cycle": "group", "limits": { "outliers": 0, "drift_range_um": 1 } });
    let found = judge("repeatability", folder.path(), &settings, &fit).unwrap();
    check(
        &found,
        &[
            ("repeatability", 1.0),
            ("pooled repeatability", 1.0),
            ("surface range", 0.0),
            ("drift range", 2.0),
            ("drift standard deviation", 1.0),
            ("total range", 2.0),
            ("measurements", 7.0),
            ("outliers", 0.0),
        ],
    );
    assert_eq!(found.figures.iter().filter(|figure| !figure.passes()).count(), 1);
    assert_eq!(found.remarks, ["fit: feature measured once only, no repeatability: c"]);
    assert_eq!(
        judge(
            "repeatability",
            folder.path(),
            &json!({ "rows": "table", "point": "feature", "cycle": "feature" }),
            &fit
        )
        .unwrap_err(),
        "cycle: touches.csv:4: feature a is measured twice in cycle a"
    );
    assert_eq!(
        judge("repeatability", folder.path(), &json!({ "rows": "tabel" }), &fit).unwrap_err(),
        "rows: fit does not observe `tabel` (did you mean `table`?)"
    );
    assert_eq!(
        judge("repeatability", folder.path(), &json!({ "value": "d" }), &fit).unwrap_err(),
        "value: `value` is a column of one ingest stage under `from`, not of 0"
    );
}

/// Two facets at two indexations, each touched on two days in two cycles, in any order.
#[test]
fn points_and_cycles_of_several_columns() {
    let text = "feature,group,day,cycle,d_um\na,1,1,2,2\na,1,1,1,0\na,2,1,1,10\na,2,1,2,10\nb,1,1,1,5\nb,1,1,2,5\n\
                a,1,2,1,4\na,1,2,2,8\na,2,2,1,10\na,2,2,2,10\nb,1,2,1,5\nb,1,2,2,5\n";
    let settings = json!({ "value": "d", "cycle": ["day", "cycle"], "window": 2 });
    let found = judged(&settings, text).unwrap();
    // Windows of a.1: 0 2 | 4 8, squares 2 + 8; everything else repeats exactly. Cycle means 5, 17/3, 19/3, 23/3.
    let values = values(&found, None);
    assert!((values[0] - 5.0_f64.sqrt()).abs() < 1e-12 && (values[1] - (10.0 / 6.0_f64).sqrt()).abs() < 1e-12);
    assert!((values[DRIFT + 1] - 8.0 / 3.0).abs() < 1e-12, "{values:?}");
    assert!(found.remarks.is_empty());
    let without_group = json!({ "value": "d", "point": "feature", "cycle": ["day", "cycle"] });
    assert_eq!(
        judged(&without_group, text).unwrap_err(),
        "cycle: repeats.csv:4: feature a is measured twice in cycle 1.1"
    );
    let without_day = json!({ "value": "d", "cycle": "cycle" });
    assert_eq!(
        judged(&without_day, text).unwrap_err(),
        "cycle: repeats.csv:8: feature.group a.1 is measured twice in cycle 1"
    );
    assert_eq!(
        judged(&json!({ "value": "d", "cycle": 3 }), text).unwrap_err(),
        "cycle: a name or a list of names was expected"
    );
}

#[test]
fn settings_and_data_that_make_no_sense_are_refused() {
    let once = "feature,d_um,t_s\na,1,0\nb,2,0\n";
    let either =
        "either `rows`, an artefact stage, or `value`, a column of the data under `from`, was expected".to_owned();
    let columns = "the columns are `feature`, `d_um`, `t_s`";
    let cases = [
        (json!({}), either.clone()),
        (json!({ "rows": "table", "value": "d" }), either),
        (
            json!({ "value": "d", "window": 1 }),
            "window: the number 1 was found; a whole number from 2 to 1000000 was expected".into(),
        ),
        (
            json!({ "value": "d", "limits": { "repeatability": 1 } }),
            "limits.repeatability: there is no figure `repeatability` to limit (did you mean `repeatability_um`?)"
                .into(),
        ),
        (
            json!({ "value": "d", "limits": { "surface_range_urad": 1 } }),
            "limits.surface_range_urad: the measurements are in um, `surface_range_urad` limits nothing".into(),
        ),
        (json!({ "value": "d" }), ": no feature is measured twice".into()),
        (json!({ "value": "e" }), format!("value: repeats.csv: there is no column `e`; {columns}")),
        (json!({ "value": "t" }), "value: the column `t` holds neither lengths nor angles".into()),
        (json!({ "value": "d", "point": "grid" }), format!("point: repeats.csv: there is no column `grid`; {columns}")),
        (
            json!({ "value": "d", "cycle": "t" }),
            "cycle: repeats.csv: the column `t_s` holds numbers; labels were expected".into(),
        ),
        (
            json!({ "rows": "table" }),
            "rows: the residuals of `rows` need no data under `from` (say which column holds the measurements with \
             `value` instead)"
                .into(),
        ),
    ];
    for (settings, expected) in cases {
        let told = judged(&settings, once).unwrap_err();
        assert!(told.starts_with(&*expected), "{settings}: {told}");
    }
}
