//! What the closed form refuses, and how its reduction works.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use abbe_ball_bar as _;
use abbe_core::{Build, EquationIndex, Kind, ObservationSet, Registry, SetIndex};
use abbe_serial_chain as _;
use nalgebra::Vector2;

use super::*;
use crate::reduction::{Projection, polar_plot};
use crate::sweep::Sweep;

const HEADER: &str = "test,X_mm,Y_mm,Z_mm,A_deg,C_deg,ball,bar,reading_um\n";

/// Samples of a test in which C or A turns; the bar is 100 mm long.
fn samples(test: &str, from: f64, to: f64, row: impl Fn(f64) -> String) -> String {
    let angle = |sample: i32| from + (to - from) * f64::from(sample) / 40.0;
    (0..=40).map(|sample| format!("{test},{}\n", row(angle(sample)))).collect()
}

/// C turns about the tool ball, ball 2, no readings.
fn circle(test: &str, from: f64, to: f64) -> String {
    samples(test, from, to, |angle| format!("0,0,160,0,{angle},2,100,0"))
}

fn problem(folder: &Path, chain: &str, rows: &str, parameters: &[&str]) -> Problem {
    let context = Context { base: folder.to_owned() };
    fs::write(folder.join("balls.csv"), "feature,x_mm,y_mm,z_mm\n1,130,100,0\n2,100,0,0\n3,0,0,100\n").unwrap();
    fs::write(folder.join("rows.csv"), format!("{HEADER}{rows}")).unwrap();
    let registry = Registry::built_in().unwrap();
    let machine = json!({ "chain": chain, "tool_length_mm": 160, "stylus_radius_mm": 0,
        "errors": [{ "location": ["E?0A", "E?0C"] }] });
    let Build::Model(constructor) = &registry.find(Kind::Model, "serial-chain").unwrap().build else { panic!() };
    let model = constructor.build(&machine, &context).unwrap().build(&[]).unwrap();
    let settings = json!({ "nominal": "balls.csv", "bars_mm": { "100": 100.0 }, "standard_uncertainty_um": 0.5 });
    let Build::Artefact(constructor) = &registry.find(Kind::Artefact, "ball-bar").unwrap().build else { panic!() };
    let data = Arc::new(abbe_table::read(&folder.join("rows.csv")).unwrap());
    let observations = constructor.build(&settings, &context).unwrap().observe(&data, &model).unwrap();
    let parameters: Vec<String> = parameters.iter().map(|name| (*name).to_owned()).collect();
    Problem::new("fit", "serial-chain", model, vec![ObservationSet::new("bar", observations)], &parameters).unwrap()
}

fn estimator(settings: &Value) -> Box<dyn Estimate> {
    build(abbe_core::from_settings(settings).unwrap(), &Context { base: std::path::PathBuf::new() }).unwrap()
}

/// The message of what a problem is refused with.
fn refused(chain: &str, rows: &str, parameters: &[&str]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let problem = problem(folder.path(), chain, rows, parameters);
    estimator(&json!({})).estimate(&problem).unwrap_err().message
}

#[test]
fn what_is_no_circle_of_one_table_axis_is_refused() {
    const TRUNNION: &str = "w C' A' b X Y Z t";
    let both = samples("c", 0.0, 360.0, |angle| format!("0,0,160,{angle},{angle},2,100,0"));
    let linear = samples("c", 0.0, 360.0, |angle| format!("{angle},0,160,0,0,2,100,0"));
    let still = samples("c", 0.0, 0.0, |angle| format!("0,0,160,0,{angle},2,100,0"));
    let on_axis = samples("c", 0.0, 360.0, |angle| format!("0,0,160,0,{angle},3,100,0"));
    let beside = samples("c", 0.0, 360.0, |angle| format!("25,0,160,0,{angle},2,100,0"));
    let balls = circle("c", 0.0, 90.0) + &samples("c", 90.0, 180.0, |angle| format!("0,0,160,0,{angle},1,100,0"));
    let cases: [(&str, &str, &str); 8] = [
        (TRUNNION, &both, "in test `c` C and A move; one rotary axis was expected to"),
        (TRUNNION, &linear, "in test `c` X moves; the closed form takes rotary axes that carry the table, one a test"),
        (
            "w b X Y Z C A t",
            &circle("c", 0.0, 360.0),
            "in test `c` C moves; the closed form takes rotary axes that carry the table",
        ),
        (TRUNNION, &still, "in test `c` no axis moves; one rotary axis was expected to"),
        (TRUNNION, &circle("c", 0.0, 20.0), "test `c` sweeps 20.0 deg only"),
        (TRUNNION, &on_axis, "in test `c` the pivot stands on the line of C"),
        (TRUNNION, &beside, "in test `c` the tool ball stands 25.000 mm beside the line of C"),
        (TRUNNION, &balls, "test `c` measures to the balls 2 and 1; one pivot a test was expected"),
    ];
    for (chain, rows, expected) in cases {
        let message = refused(chain, rows, &["EX0C", "EY0C"]);
        assert!(message.starts_with(expected), "{message}");
    }
}

#[test]
fn what_circles_do_not_determine_is_named() {
    const TRUNNION: &str = "w C' A' b X Y Z t";
    let message = refused(TRUNNION, &circle("c", 0.0, 360.0), &["EX0C", "EY0C", "EX0A", "bar.ball[2].y"]);
    assert!(message.starts_with("the circles of the tests determine 2 of 4 unknowns"), "{message}");
    assert!(message.contains("bar.ball[2].y has no effect on these measurements"), "{message}");
    assert!(
        message.contains("EX0A and EX0C cannot be told apart") || message.contains("EX0C and EX0A cannot"),
        "{message}"
    );
}

#[test]
fn tests_are_told_apart_by_their_column() {
    let folder = tempfile::tempdir().unwrap();
    let rows = circle("c", 0.0, 360.0);
    let problem = problem(folder.path(), "w C' A' b X Y Z t", &rows, &["EX0C", "EY0C"]);
    assert!(estimator(&json!({})).estimate(&problem).is_ok());
    let error = estimator(&json!({ "tests": "sweep" })).estimate(&problem).unwrap_err();
    assert!(error.message.starts_with("there is no column `sweep`"), "{error}");
    assert_eq!(abbe_core::path_text(&error.setting), "tests");
}

/// Samples of a circle of 100 mm whose centre is off, with the tool ball 50 mm up.
fn off_centre(centre: Vector2<f64>, arc: f64) -> Sweep {
    let angles: Vec<f64> = (0..=200).map(|sample| arc * f64::from(sample) / 200.0).collect();
    let nominal = 100.0_f64.hypot(50.0);
    let length = |angle: &f64| {
        let along = centre.x * angle.cos() + centre.y * angle.sin();
        (100.0_f64.powi(2) + 50.0_f64.powi(2) + centre.norm_squared() + 200.0 * along).sqrt()
    };
    Sweep {
        name: "c".to_owned(),
        equations: EquationIndex::first(angles.len()).collect(),
        axis: 0,
        pivot: (SetIndex(0), 0),
        measured: angles.iter().map(length).collect(),
        nominal: vec![nominal; angles.len()],
        angles,
        radius: 100.0,
        height: 50.0,
    }
}

#[test]
fn the_squared_length_is_exact_and_the_polar_plot_bends() {
    for arc in [std::f64::consts::TAU, std::f64::consts::FRAC_PI_2] {
        let centre = Vector2::new(0.03, -0.05);
        let sweep = off_centre(centre, arc);
        let found = Projection::new(&sweep.angles).of(sweep.measured.iter().map(|length| length * length));
        assert!((Vector2::new(found[1], found[2]) / 200.0 - centre).norm() < 1e-11);
        let (plotted, radius) = polar_plot(&sweep, &sweep.measured).unwrap();
        let off = (plotted - centre).norm();
        // An offset o bends the plot by o²/R; a quarter of a circle enlarges it.
        let bend = centre.norm_squared() / 100.0;
        assert!(off > 1e-9 * bend && off < 5.0 * bend, "{off} {bend}");
        assert!((radius - 100.0).abs() < 10.0 * bend);
    }
    let sweep = off_centre(Vector2::zeros(), 6.0);
    assert!(polar_plot(&sweep, &vec![40.0; 201]).is_none());
    let short = Sweep { measured: vec![40.0; 201], ..sweep };
    let error = Evaluated::new(&[short], Evaluation::PolarPlot).unwrap_err();
    assert!(error.message.starts_with("the lengths of test `c` lie on no circle"), "{error}");
}
