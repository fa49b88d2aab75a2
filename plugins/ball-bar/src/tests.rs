//! Derivatives, and what is refused.

use std::fs;
use std::path::Path;

use abbe_core::{Build, Ingest, Kind, ObservationSet, Problem, Registry, path_text};
use abbe_serial_chain as _;

use super::*;

const BALLS: &str = "feature,x_mm,y_mm,z_mm\n1,130,100,0\n2,100,0,0\n";
const ROWS: &str = "X_mm,Y_mm,Z_mm,A_deg,C_deg,ball,bar,reading_um\n\
    130,0,160,0,0,1,100,12\n130,0,160,40,15,1,100,-7\n18.2,0,160,-20,0,1,150,3\n0,0,160,0,200,2,100,5\n";

fn write(folder: &Path, files: &[(&str, &str)]) {
    for (name, text) in files {
        fs::write(folder.join(name), text).unwrap();
    }
}

fn model() -> Arc<dyn KinematicModel> {
    let registry = Registry::built_in().unwrap();
    let Build::Model(constructor) = &registry.find(Kind::Model, "serial-chain").unwrap().build else { panic!() };
    let settings = json!({ "chain": "w C' A' b X Y Z t", "tool_length_mm": 160, "stylus_radius_mm": 0,
        "errors": [{ "location": ["E?0A", "E?0C"] }] });
    constructor.build(&settings, &Context { base: PathBuf::new() }).unwrap().build(&[]).unwrap()
}

fn settings() -> Value {
    json!({ "nominal": "balls.csv", "bars_mm": { "100": 100.0, "150": 150.0 }, "standard_uncertainty_um": 0.5 })
}

/// The problem of everything that the artefact knows and of some errors, or the text of what is refused.
fn observed(balls: &str, rows: &str, settings: &Value) -> Result<Problem, String> {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &[("balls.csv", balls), ("rows.csv", rows)]);
    let context = Context { base: folder.path().to_owned() };
    let artefact = abbe_core::from_settings(settings)
        .and_then(|settings| build(settings, &context))
        .map_err(|error| format!("{}: {error}", path_text(&error.path)))?;
    let model = model();
    let made = || {
        let data = Arc::new(abbe_table::read(&folder.path().join("rows.csv"))?);
        artefact.check(&data.headers(), data.files.first(), model.as_ref())?;
        let sets = vec![ObservationSet::new("bar", artefact.observe(&data, &model)?)];
        Problem::new(
            "fit",
            "serial-chain",
            model.clone(),
            sets,
            &["E??A".to_owned(), "E??C".to_owned(), "bar.*".to_owned()],
        )
    };
    made().map_err(|error| error.to_string().replace(&format!("{}/", folder.path().display()), ""))
}

#[test]
fn derivatives_are_those_of_differences() {
    let mut all = settings();
    all["tool_ball_standard_uncertainty_um"] = json!(0.2);
    for (lengths, known) in [("known", json!(0.4)), ("estimated", json!(0.0))] {
        all["lengths"] = json!(lengths);
        all["length_standard_uncertainty_um"] = known;
        let mut problem = observed(BALLS, ROWS, &all).unwrap();
        problem.unknowns.extend(problem.considered.unknowns.clone());
        assert_eq!(problem.unknowns.len(), 12 + 6 + 2 + 3);
        // Not at zero, where the tool ball's place has no effect through the orientation.
        let x: Vec<f64> = problem
            .start()
            .iter()
            .enumerate()
            .map(|(index, start)| start + 1e-3 * (1.0 + 0.3 * index as f64) * if index % 2 == 0 { 1.0 } else { -1.0 })
            .collect();
        let mut analytic = Vec::new();
        problem.linearise(&x, |block| analytic.extend_from_slice(block.jacobian)).unwrap();
        let residuals = |x: &[f64]| {
            let mut found = Vec::new();
            problem.linearise(x, |block| found.extend_from_slice(block.residuals)).unwrap();
            found
        };
        let (count, step) = (problem.unknowns.len(), 1e-5);
        for (column, unknown) in problem.unknowns.iter().enumerate() {
            let shifted = |by: f64| {
                let mut x = x.clone();
                x[column] += by;
                residuals(&x)
            };
            let (up, down) = (shifted(step), shifted(-step));
            for (row, (up, down)) in up.iter().zip(&down).enumerate() {
                let (expected, found) = ((up - down) / (2.0 * step), analytic[row * count + column]);
                assert!((expected - found).abs() < 1e-6, "{}, row {row}: {found} {expected}", unknown.name);
            }
        }
    }
}

#[test]
fn rows_that_make_no_sense_are_refused() {
    let changed = |from: &str, to: &str| ROWS.replacen(from, to, 1);
    let set = |key: &str, value: Value| {
        let mut settings = settings();
        settings[key] = value;
        settings
    };
    let cases = [
        (
            changed(",2,100,5", ",3,100,5"),
            settings(),
            "rows.csv:5: ball 3 is not among the nominal balls (there are: 1, 2)",
        ),
        (changed("1,150,3", "1,200,3"), settings(), "rows.csv:4: bar 200 is not among `bars_mm` (there are: 100, 150)"),
        (changed(",12\n", ",NaN\n"), settings(), "rows.csv:2:"),
        (changed(",12\n", ",-100001\n"), settings(), "rows.csv:2: the measured length is"),
        (
            changed("130,0,160,0,0,1", "130,100,160,0,0,1"),
            settings(),
            "rows.csv:2: the tool ball stands in the centre of ball 1",
        ),
        (changed("reading_um", "reading"), settings(), "rows.csv: the column `reading` does not say its unit"),
        (ROWS.to_owned(), set("bars_mm", json!({ "100": 0.0 })), "bars_mm.100: bars_mm.100: "),
        (ROWS.to_owned(), set("bars_mm", json!({})), "bars_mm: bars_mm: a ball bar has a length"),
        (ROWS.to_owned(), set("standard_uncertainty_um", json!(-1)), "standard_uncertainty_um: "),
    ];
    for (rows, settings, expected) in cases {
        let message = observed(BALLS, &rows, &settings).err().expect(expected);
        assert!(message.starts_with(expected), "{message}\n{expected}");
    }
    // A single ball and a single bar need no columns.
    let plain = "X_mm,Y_mm,Z_mm,A_deg,C_deg,reading_um\n0,0,160,0,200,5\n";
    let one = "feature,x_mm,y_mm,z_mm\n2,100,0,0\n";
    let problem = observed(one, plain, &set("bars_mm", json!({ "100": 100.0 }))).unwrap();
    assert_eq!(problem.sets[0].observations.info().unknowns[0].name, "ball[2].x");
    assert!(
        observed(BALLS, plain, &set("bars_mm", json!({ "100": 100.0 })))
            .err()
            .is_some_and(|message| message.contains("no column `ball`"))
    );
}

/// Reads tests, or gives the setting and the text of what is refused.
fn read(files: &[(&str, &str)], tests: Value) -> Result<Dataset, String> {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), files);
    let context = Context { base: folder.path().to_owned() };
    let stage: Box<dyn Ingest> = abbe_core::from_settings(&json!({ "tests": tests }))
        .and_then(|settings| ingest::build(settings, &context))
        .map_err(|error| format!("{}: {}", path_text(&error.path), error.message))?;
    let headers = stage.headers();
    let data = stage.read().map_err(|error| {
        let text = error.to_string().replace(&format!("{}/", folder.path().display()), "");
        format!("{}: {text}", path_text(&error.setting))
    })?;
    assert_eq!(headers, Ok(data.headers()));
    Ok(data)
}

fn degrees(data: &Dataset, axis: &str) -> Vec<f64> {
    data.numbers(axis).unwrap().iter().map(|angle| (angle.to_degrees() * 1e9).round() / 1e9).collect()
}

#[test]
fn tests_become_one_data_set_without_overshoot() {
    let files = [
        ("a.csv", "A_deg,reading_um,cycle\n-12,1,1\n-10,2,1\n20,3,1\n21,4,1\n21,5,2\n20,6,2\n-10,7,2\n"),
        ("c.csv", "reading_um,C_deg,cycle,time_s\n8,0,1,0\n9,360,1,5\n"),
    ];
    let tests = json!([
        { "file": "a.csv", "moves": "A", "ball": 1, "bar": 100, "range_deg": [-10, 20], "positions": { "C_deg": 0 } },
        { "file": "c.csv", "name": "whole", "moves": "C", "ball": 2, "bar": 150, "positions": { "A_deg": 5 } },
    ]);
    let data = read(&files, tests).unwrap();
    assert_eq!(degrees(&data, "A"), [-10.0, 20.0, -10.0, 20.0, 5.0, 5.0]);
    let readings: Vec<f64> = data.numbers("reading").unwrap().iter().map(|reading| (reading * 1e3).round()).collect();
    assert_eq!(readings, [2.0, 3.0, 7.0, 6.0, 8.0, 9.0]);
    assert!(data.column("time").is_none(), "one test has no times");
    assert_eq!(data.labels("test").unwrap(), ["a", "a", "a", "a", "whole", "whole"]);
    assert_eq!(data.labels("bar").unwrap(), ["100", "100", "100", "100", "150", "150"]);
    assert_eq!((data.origins[2].line, data.origins[4].file), (8, 1));
}

#[test]
fn time_and_feed_give_the_angle() {
    // 60 mm/min on a circle of 180/pi mm: one degree a second. The second cycle runs back, and its clock goes on.
    let rows = "time_s,reading_um,cycle\n5,1,1\n7,1,1\n10,1,1\n100,1,2\n103,1,2\n108,1,2\n";
    let feed = json!({ "mm_per_min": 60, "radius_mm": 180.0 / std::f64::consts::PI, "from_deg": 10, "to_deg": 16, "alternating": true });
    let test = |more: Value| {
        let mut test = json!({ "file": "c.csv", "moves": "C", "feed": feed });
        test.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        json!([test])
    };
    let data = read(&[("c.csv", rows)], test(json!({}))).unwrap();
    // Sorted by angle; at the end of its way the axis stands.
    assert_eq!(degrees(&data, "C"), [10.0, 12.0, 15.0, 10.0, 13.0, 16.0]);
    let within = read(&[("c.csv", rows)], test(json!({ "range_deg": [11.5, 13.4] }))).unwrap();
    assert_eq!(degrees(&within, "C"), [12.0, 13.0]);
}

#[test]
fn tests_that_make_no_sense_are_refused() {
    let files = [
        ("a.csv", "A_deg,reading_um\n0,1\n1,2\n"),
        ("c.csv", "C_deg,time_s,reading_um\n0,1,1\n"),
        ("still.csv", "A_deg,C_deg,reading_um\n5,0,1\n5,90,2\n"),
        ("both.csv", "A_deg,C_deg,reading_um\n0,0,1\n10,0.1,2\n"),
        ("none.csv", "A_deg,reading_um\n5,1\n5,2\n"),
    ];
    let feed = json!({ "mm_per_min": 500, "radius_mm": 100, "from_deg": 0, "to_deg": 90 });
    let still = json!({ "mm_per_min": 500, "radius_mm": 100, "from_deg": 0, "to_deg": 0 });
    let cases = [
        (json!([]), "tests: at least one test was expected"),
        (
            json!([{ "file": "a.csv", "moves": "A", "range_deg": [5, 6] }]),
            "tests[0].range_deg: no sample of `a.csv` is within the range of A: its samples go from 0.000 to 1.000 deg",
        ),
        (json!([{ "file": "a.csv", "moves": "A", "range_deg": [6, 5] }]), "tests[0].range_deg: 6 to 5 is no range"),
        (json!([{ "file": "a.csv", "moves": "C" }]), "tests[0].moves: a.csv: there is no column `C_deg`"),
        (
            json!([{ "file": "still.csv", "moves": "A" }]),
            "tests[0].moves: A stands still in `still.csv`, and C moves over 90.000 deg",
        ),
        (
            json!([{ "file": "both.csv", "moves": "A" }]),
            "tests[0].moves: A is not the only one that moves in `both.csv`: C does, over 0.100 deg",
        ),
        (json!([{ "file": "none.csv", "moves": "A" }]), "tests[0].moves: A stands still in `none.csv`"),
        (
            json!([{ "file": "a.csv", "moves": "A" }, { "file": "a.csv", "moves": "A" }]),
            "tests[1].name: there is a test `a` already",
        ),
        (
            json!([{ "file": "a.csv", "moves": "A" }, { "file": "c.csv", "moves": "C" }]),
            ": c.csv: the column `A_deg` is missing here",
        ),
        (json!([{ "file": "a.csv", "moves": "A", "positions": { "A_deg": 1 } }]), "tests[0].positions: "),
        (
            json!([{ "file": "a.csv", "moves": "A", "positions": { "X": 1 } }]),
            "tests[0].positions.X: the position of an axis has a unit",
        ),
        (json!([{ "file": "c.csv", "moves": "C", "feed": feed }]), "tests[0].feed: "),
        (json!([{ "file": "a.csv", "moves": "C", "feed": feed }]), ": a.csv: there is no column `time_s`"),
        (json!([{ "file": "a.csv", "moves": "C", "feed": still }]), "tests[0].feed.to_deg: the axis does not move"),
    ];
    for (tests, expected) in cases {
        let message = read(&files, tests).expect_err(expected);
        assert!(message.starts_with(expected), "{message}\n{expected}");
    }
}
