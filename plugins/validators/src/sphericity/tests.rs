//! Tests of `sphericity`.

use super::*;
use crate::testing::{check, figure_of, fit_to, judge, validator};
use abbe_core::path_text;
use std::path::Path;
use tempfile::TempDir;

/// Radius of the balls plus that of the stylus, mm.
const REACH: f64 = 10.0 + 3.0;
/// The six touches along the axes.
const SIX: [[f64; 3]; 6] =
    [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
/// Too far by 4 um in x, by 1 um in y and by -2 um in z: the radius is 1 um too large.
const FORM: [f64; 6] = [4.0, 4.0, 1.0, 1.0, -2.0, -2.0];

fn machine() -> Value {
    json!({
        "chain": "w b X Y Z t", "tool_length_mm": 100, "stylus_radius_mm": 3,
        "errors": [{ "polynomial": ["EXX"], "degrees": [1, 2] }, { "drift": ["dxt"], "degrees": [1], "per": "data-set",
            "time_s": { "": [0, 100] } }],
    })
}

/// Rows of a file of touches on ball `label` at (x, 0, 50); the X axis moves too far by the factor 1 + `gain`.
fn touches(label: &str, group: &str, x: f64, gain: f64, directions: &[[f64; 3]], off: &[f64]) -> String {
    let row = |(direction, off): (&[f64; 3], &f64)| {
        let [x, y, z] = [0, 1, 2].map(|axis| [x, 0.0, 50.0][axis] + (REACH + off * 1e-3) * direction[axis]);
        format!("{label},{group},50,{},{y},{}\n", x / (1.0 + gain), z + 100.0)
    };
    directions.iter().zip(off).map(row).collect()
}

const HEADER: &str = "feature,group,time_s,X_mm,Y_mm,Z_mm\n";
const BALLS: &str = "feature,x_mm,y_mm,z_mm,diameter_mm\n1,0,0,50,20\n2,100,0,50,20\n";

fn of(rows: &str, robust: bool) -> (TempDir, Fit) {
    fit_to("balls", BALLS, &format!("{HEADER}{rows}"), &machine(), robust)
}

#[test]
fn form_and_size_of_one_ball() {
    let (folder, fit) = of(&touches("1", "a", 0.0, 0.0, &SIX, &FORM), false);
    let settings = json!({ "rows": "table", "limits": { "out_of_sphericity_um": 5, "absolute_size_error_um": 0.9 } });
    let found = judge("sphericity", folder.path(), &settings, &fit).unwrap();
    let expected = [
        ("out of sphericity", 6.0),
        ("max", 3.0),
        ("min", -3.0),
        ("standard deviation", 18.0_f64.sqrt()),
        ("diameter", 20.002),
        ("size error", 1.0),
        ("absolute size error", 1.0),
        ("points", 6.0),
    ];
    check(&found, &expected);
    check(&found, &[("outliers", 0.0)]);
    expected.iter().for_each(|(name, value)| assert!((figure_of(&found, NOMINAL, name) - value).abs() < 1e-6));
    // Limits are for the calibrated model.
    let failed: Vec<_> = found.figures.iter().filter(|figure| !figure.passes()).collect();
    let failed: Vec<_> = failed.iter().map(|figure| (figure.of.as_deref(), figure.name.as_str())).collect();
    assert_eq!(failed, [(Some("fit"), "out of sphericity"), (Some("fit"), "absolute size error")]);
    assert!(!found.figures.iter().any(|figure| figure.detail));
}

#[test]
fn several_balls_and_programmes() {
    let off = [1.0; 6];
    let rows = [
        touches("1", "a", 0.0, 0.0, &SIX, &FORM),
        touches("2", "a", 100.0, 0.0, &SIX, &off),
        touches("2", "b", 100.0, 0.0, &SIX, &FORM.map(|off| -off)),
    ];
    let (folder, fit) = of(&rows.concat(), false);
    let found = judge("sphericity", folder.path(), &json!({ "rows": "table" }), &fit).unwrap();
    check(
        &found,
        &[
            ("out of sphericity", 6.0),
            ("out of sphericity[feature=1]", 6.0),
            ("size error[feature=1]", 1.0),
            ("size error[feature=2]", 0.0),
            ("points[feature=2]", 12.0),
            ("points", 18.0),
        ],
    );
    assert!(!found.figures.iter().any(|figure| figure.name == "diameter"));
    let found = judge("sphericity", folder.path(), &json!({ "rows": "table", "column": "group" }), &fit).unwrap();
    check(
        &found,
        &[
            ("out of sphericity[feature=2, group=a]", 0.0),
            ("size error[feature=2, group=b]", -1.0),
            ("diameter[feature=2, group=b]", 19.998),
            ("max", 3.0),
            ("min", -3.0),
            ("absolute size error", 1.0),
        ],
    );
    let few = [rows[0].clone(), touches("2", "b", 100.0, 0.0, &[SIX[0], SIX[2], SIX[4]], &off)];
    let (folder, fit) = of(&few.concat(), false);
    assert_eq!(
        judge("sphericity", folder.path(), &json!({ "rows": "table" }), &fit).unwrap_err(),
        ": feature=2: a sphere needs 4 points or more, and there are 3"
    );
}

#[test]
fn the_model_of_the_fit_and_single_errors() {
    let gain = 1e-3;
    let (folder, mut fit) = of(&touches("1", "a", 0.0, gain, &SIX, &[0.0; 6]), false);
    // A given model: nobody estimates it from these rows.
    fit.calibration.parameters.iter_mut().find(|parameter| parameter.name == "EXX[1]").unwrap().value = gain;
    let settings = json!({
        "rows": "table",
        "sensitivity": { "parameters": ["EXX[1]", "dzt"], "um": 1, "um_per_m": 1000 },
    });
    let found = judge("sphericity", folder.path(), &settings, &fit).unwrap();
    check(&found, &[("out of sphericity", 0.0), ("diameter", 20.0), ("size error", 0.0)]);
    // The two touches along x are short by as much as the axis moves too far.
    let short = 1e3 * REACH * gain / (1.0 + gain);
    assert!((figure_of(&found, NOMINAL, "out of sphericity") - short).abs() < 1e-6);
    assert!((figure_of(&found, NOMINAL, "size error") + short / 3.0).abs() < 1e-6);
    check(
        &found,
        &[("out of sphericity[EXX[1]]", short), ("size error[EXX[1]]", -short / 3.0), ("out of sphericity[dzt]", 0.0)],
    );
    let table: Vec<&str> =
        found.figures.iter().map(|figure| figure.name.as_str()).filter(|name| name.contains('[')).collect();
    let parameters = ["dzt", "EXX[1]"];
    assert_eq!(
        table,
        parameters.map(|name| [format!("size error[{name}]"), format!("out of sphericity[{name}]")]).concat()
    );
    assert_eq!(found.remarks, ["fit: of single errors EXX[1] does most to the sphericity (12.99 µm)"]);
}

#[test]
fn outliers_are_left_out() {
    let directions: Vec<[f64; 3]> = (0..40)
        .map(|index| {
            let (height, angle) = (f64::from(index) / 20.0 - 0.95, f64::from(index) * 2.4);
            let across = (1.0 - height * height).sqrt();
            [across * angle.cos(), across * angle.sin(), height]
        })
        .collect();
    let mut off: Vec<f64> = (0..40).map(|index| 0.1 * (f64::from(index * index) * 1.7).sin()).collect();
    off[7] = 50.0;
    let (folder, fit) = of(&touches("1", "a", 0.0, 0.0, &directions, &off), true);
    let found =
        judge("sphericity", folder.path(), &json!({ "rows": "table", "limits": { "outliers": 0 } }), &fit).unwrap();
    check(&found, &[("outliers", 1.0), ("points", 39.0)]);
    assert!(figure_of(&found, "fit", "out of sphericity") < 0.3);
    assert_eq!(found.figures.iter().filter(|figure| !figure.passes()).count(), 1);
}

/// What is found in other data, by a fit that drifted while its own were taken.
fn elsewhere(settings: &Value, text: &str) -> std::result::Result<Findings, String> {
    let (folder, mut fit) = of(&touches("1", "a", 0.0, 0.0, &SIX, &FORM), false);
    fit.calibration.parameters.iter_mut().find(|parameter| parameter.name == "dxt[t1]").unwrap().value = 1.0;
    let file = folder.path().join("others.csv");
    std::fs::write(&file, text).unwrap();
    let data = abbe_table::read(&file).unwrap();
    let found = validator("sphericity", folder.path(), settings)?.validate(&[&fit], &[&data]);
    found.map_err(|error| {
        let text = error.to_string().replace(&format!("{}/", folder.path().display()), "");
        format!("{}: {text}", path_text(&error.setting))
    })
}

#[test]
fn other_data() {
    let rows = touches("9", "a", 40.0, 0.0, &SIX, &FORM);
    let mut later = format!("{HEADER}{rows}");
    later = later.replacen(",50,", ",100,", 1);
    let found = elsewhere(&json!({ "diameter_mm": 20 }), &later).unwrap();
    check(&found, &[("out of sphericity", 6.0), ("size error", 1.0), ("diameter", 20.002), ("points", 6.0)]);
    assert!(!found.figures.iter().any(|figure| figure.name == "outliers"));
    let single = json!({ "sensitivity": { "parameters": ["EXX[2]"], "um_per_m2": 1000 } });
    let found = elsewhere(&single, &later).unwrap();
    assert!(!found.figures.iter().any(|figure| figure.name == "size error"));
    // Along x the stretch is 2 e x at x = 40 mm, so less than 0.1 um over the ball.
    assert!((figure_of(&found, "fit", "out of sphericity[EXX[2]]") - 1.04).abs() < 0.01);
    let without: String = later.lines().map(|line| line.split_once(',').unwrap().1.to_owned() + "\n").collect();
    check(&elsewhere(&json!({}), &without).unwrap(), &[("out of sphericity", 6.0), ("diameter", 20.002)]);
}

#[test]
fn settings_and_data_that_make_no_sense_are_refused() {
    let rows = format!("{HEADER}{}", touches("1", "a", 0.0, 0.0, &SIX, &FORM));
    let cases = [
        (json!({ "rows": "table" }), "rows: either `rows` or data under `from` are judged, not both"),
        (
            json!({ "rows": "table", "diameter_mm": 20 }),
            "diameter_mm: the artefact under `rows` says how large its spheres are",
        ),
        (json!({ "diameter_mm": -1 }), "diameter_mm: -1: a positive number was expected"),
        (
            json!({ "limits": { "size_error_um": 1 } }),
            "limits.size_error_um: there is no figure `size_error_um` to limit (possible are: \
             out_of_sphericity_um, standard_deviation_um, absolute_size_error_um, outliers)",
        ),
        (
            json!({ "limits": { "absolute_size_error_um": 1 } }),
            "limits.absolute_size_error_um: without `diameter_mm` there is no size error to limit",
        ),
        (
            json!({ "column": "day" }),
            "column: others.csv: there is no column `day`; the columns are `feature`, `group`, `time_s`, `X_mm`, `Y_mm`, \
             `Z_mm`",
        ),
        (json!({ "sensitivity": { "parameters": [] } }), "sensitivity.parameters: at least one name was expected"),
        (
            json!({ "sensitivity": { "parameters": ["dxt"] } }),
            "sensitivity: a value for each unit was expected (e.g. `um: 1, urad: 2.5`)",
        ),
        (
            json!({ "sensitivity": { "parameters": ["dxt"], "um": 0 } }),
            "sensitivity.um: 0: a number other than zero was expected",
        ),
        (
            json!({ "sensitivity": { "parameters": ["dxt", "dxx"], "um": 1 } }),
            "sensitivity.parameters[1]: `dxx` matches no parameter of the model (did you mean `dxt`?)",
        ),
        (
            json!({ "sensitivity": { "parameters": ["EXX[1]"], "um": 1 } }),
            "sensitivity: `EXX[1]` is in µm/m, for which there is no value (e.g. `um_per_m: 1`)",
        ),
        (
            json!({ "sensitivity": { "parameters": ["dxt"], "um": 1, "mm": 1 } }),
            "sensitivity.mm: none of these parameters is in `mm`",
        ),
    ];
    for (settings, expected) in cases {
        let told = elsewhere(&settings, &rows).unwrap_err();
        assert!(told.starts_with(expected), "{settings}: {told}");
    }
    let (folder, fit) = crate::testing::fit(&crate::testing::UPWARDS, &[("a", "1", 0.0, 0.0)], false);
    assert_eq!(
        judge("sphericity", folder.path(), &json!({ "rows": "table" }), &fit).unwrap_err(),
        "rows: the rows of `table` are no touches on spheres"
    );
    assert_eq!(
        judge("sphericity", folder.path(), &json!({}), &fit).unwrap_err(),
        ": `rows`, an artefact stage, or one ingest stage under `from` was expected, not 0"
    );
    assert!(validator("sphericity", Path::new(""), &json!({ "rows": 1 })).is_err());
}

#[test]
fn nominal_figures_of_several_fits() {
    let (_folder, one) = of(&touches("1", "a", 0.0, 0.0, &SIX, &FORM), false);
    let (_other_folder, mut other) = of(&touches("1", "a", 0.0, 0.0, &SIX, &[0.0; 6]), false);
    other.name = "other".to_owned();
    let judge = validator("sphericity", Path::new(""), &json!({ "rows": "table" })).unwrap();
    let names = |fits: &[&Fit]| {
        let mut names: Vec<String> =
            judge.validate(fits, &[]).unwrap().figures.into_iter().filter_map(|figure| figure.of).collect();
        names.dedup();
        names
    };
    assert_eq!(names(&[&one, &one]), ["nominal", "fit"]);
    assert_eq!(names(&[&one, &other]), ["nominal", "fit", "nominal of other", "other"]);
}
