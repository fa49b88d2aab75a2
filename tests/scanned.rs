//! Circles that a probe scans on a ring or a sphere: the same figures as those of a ball bar on the same machine, and the errors that
//! make them.

use std::fmt::Write as _;

use abbe_core::{Figure, Status};
use serde_json::{Value, json};

use crate::misread::changed;
use crate::support::{Random, Variant, fit, json_file, read, recipes, root, temporary, values, write};

/// Scales, squareness of X to Y, and reversals of X and Y: mm and rad.
struct Machine {
    scales: [f64; 2],
    squareness: f64,
    reversals: [f64; 2],
}

impl Machine {
    fn new(random: &mut Random) -> Self {
        Self {
            scales: [0; 2].map(|_| random.within(-5e-5, 5e-5)),
            squareness: random.within(-5e-5, 5e-5),
            reversals: [0; 2].map(|_| random.within(-4e-3, 4e-3)),
        }
    }

    /// Where the tip is, on `w b Y X Z t`, at these positions that were approached from these sides.
    fn tip(&self, [x, y]: [f64; 2], sides: [f64; 2]) -> [f64; 2] {
        let along_x = x * (1.0 + self.scales[0]) + self.reversals[0] * sides[0];
        let along_y = y * (1.0 + self.scales[1]) + self.reversals[1] * sides[1];
        let (sin, cos) = self.squareness.sin_cos();
        [cos * along_x, along_y + sin * along_x]
    }

    /// The positions at which the tip is at a point.
    fn positions(&self, point: [f64; 2], sides: [f64; 2]) -> [f64; 2] {
        let mut at = point;
        for _ in 0..50 {
            let tip = self.tip(at, sides);
            at = [at[0] + point[0] - tip[0], at[1] + point[1] - tip[1]];
        }
        at
    }
}

const RADIUS: f64 = 60.0;

/// Rows of both ways: angle, way and the sides from which the axes come.
fn circle() -> impl Iterator<Item = (f64, f64, [f64; 2])> {
    [1.0, -1.0].into_iter().flat_map(|way| {
        (0..120).map(move |step| {
            let degrees = 1.5 + 3.0 * f64::from(if way > 0.0 { step } else { 119 - step });
            let angle = degrees.to_radians();
            (angle, way, [-way * angle.sin().signum(), way * angle.cos().signum()])
        })
    })
}

/// What a ball bar reads: the tip at the commanded circle, about a ball beside its centre.
fn of_ball_bar(machine: &Machine, centre: [f64; 2]) -> String {
    let mut text = "direction,angle_deg,reading_mm\n".to_owned();
    for (angle, way, sides) in circle() {
        let tip = machine.tip([RADIUS * angle.cos(), RADIUS * angle.sin()], sides);
        let reading = (tip[0] - centre[0]).hypot(tip[1] - centre[1]) - RADIUS;
        writeln!(text, "{way},{:.9},{reading:.12}", angle.to_degrees()).expect("text");
    }
    text
}

/// What a probe scans: the tip on the ring, positions that are commanded and a probe that is deflected, or positions alone.
fn of_probe(machine: &Machine, centre: [f64; 2], is_deflected: bool) -> String {
    let mut text = "direction,X_mm,Y_mm,defl_x_mm,defl_y_mm\n".to_owned();
    for (angle, way, sides) in circle() {
        let [sin, cos] = [angle.sin(), angle.cos()];
        let at = machine.positions([centre[0] + RADIUS * cos, centre[1] + RADIUS * sin], sides);
        let commanded = if is_deflected { [RADIUS * cos, RADIUS * sin] } else { at };
        let [dx, dy] = [at[0] - commanded[0], at[1] - commanded[1]];
        writeln!(text, "{way},{:.12},{:.12},{dx:.12},{dy:.12}", commanded[0], commanded[1]).expect("text");
    }
    text
}

fn figures(text: &str, settings: &Value) -> Vec<Figure> {
    let folder = temporary();
    write(&folder.path().join("circle.csv"), text);
    let mut stage = json!({ "validate": "circular", "from": "circle", "radius_mm": RADIUS });
    stage.as_object_mut().expect("a map").extend(settings.as_object().expect("a map").clone());
    let recipe = Variant(json!({ "abbe": 1, "name": "circle", "stages": {
        "circle": { "ingest": "csv", "path": folder.path().join("circle.csv") }, "figures": stage,
    }}));
    let outcome = recipe.run();
    let failures: Vec<String> = outcome.failures.iter().map(|failure| failure.error.to_string()).collect();
    assert!(failures.is_empty(), "{failures:?}");
    outcome.verdicts[0].figures.clone()
}

#[test]
fn a_ring_tells_what_a_ball_bar_tells() {
    for seed in 0..24 {
        let random = &mut Random::new(40 + seed);
        let (machine, centre) = (Machine::new(random), [0; 2].map(|_| random.within(-0.05, 0.05)));
        let of_bar = figures(&of_ball_bar(&machine, centre), &json!({}));
        for is_deflected in [false, true] {
            let mut settings = json!({ "scanned": { "plane": ["X", "Y"], "centre_mm": [0, 0] } });
            if is_deflected {
                settings["scanned"]["deflections"] = json!(["defl_x", "defl_y"]);
            }
            let of_ring = figures(&of_probe(&machine, centre, is_deflected), &settings);
            for bar in of_bar.iter().filter(|figure| figure.unit == "um" && !figure.name.starts_with("centre")) {
                // As set up the ring is where the ball is, but what is further out for one is further in for the other.
                if bar.name.contains("as set up") {
                    continue;
                }
                let ring = of_ring.iter().find(|figure| figure.name == bar.name).expect("the same figures");
                let off = bar.value.expect("it") - ring.value.expect("it");
                // Readings of 50 um over 60 mm: squares of them, um.
                assert!(off.abs() < 0.15, "seed {seed}, {}: {:?} {:?}", bar.name, bar.value, ring.value);
            }
        }
        // D has the sign of the scales: of the machine, not of what it measures.
        let d = of_bar.iter().find(|figure| figure.name.starts_with("D[")).and_then(|figure| figure.value).expect("D");
        let expected = 1e3 * RADIUS * (machine.scales[0] + machine.scales[1]) / 2.0;
        assert!((d - expected).abs() < 0.1, "seed {seed}: {d} {expected}");
    }
}

/// The points are touches as well, and the calibrated diameter tells both scales.
#[test]
fn a_scanned_ring_gives_its_errors_back() {
    let recipe = Variant::of(&recipes()["standards-scanned-ring"]);
    let mut recipe = recipe.set("scan", "constants", json!({ "feature": 1 }));
    let data = root().join("pipelines/data/standards/scanned/rings.csv");
    let stages = recipe.0["stages"].as_object_mut().expect("stages");
    stages.insert(
        "ring".to_owned(),
        json!({ "artefact": "rings", "from": "scan", "nominal": data, "standard_uncertainty_um": 0.2 }),
    );
    stages.insert(
        "machine".to_owned(),
        json!({ "model": "serial-chain", "chain": "w b Y X Z t", "tool_length_mm": 0, "stylus_radius_mm": 3, "errors": [
            { "location": ["EC0X"] }, { "polynomial": ["EXX", "EYY"], "degrees": [1] }, { "backlash": ["EXX", "EYY"] }] }),
    );
    let fitted = json!({ "estimate": "gauss-newton", "machine": "machine", "observations": ["ring"],
        "parameters": ["E*", "ring.*"] });
    stages.insert("fit".to_owned(), fitted);
    let outcome = recipe.run();
    let calibration = &fit(&outcome, "fit").calibration;
    let truth = json_file(&root().join("tests/truth/standards-scanned-ring.json"));
    let mut count = 0;
    for own in values(calibration).filter(|own| own.status == Status::Estimated) {
        let expected = truth["parameters"][&own.name].as_f64().unwrap_or_else(|| panic!("no {}", own.name));
        let error = (own.value - expected) / own.standard_uncertainty;
        assert!(error.abs() < 3.3, "{}: {} instead of {expected}", own.name, own.value);
        count += 1;
    }
    assert_eq!(count, 7);
    // Half of what both scales make of the radius.
    let scales = ["EXX[1]", "EYY[1]"].map(|name| truth["parameters"][name].as_f64().expect("a scale"));
    let d = outcome.verdicts.iter().flat_map(|verdict| &verdict.figures).find(|figure| figure.name == "D[ring]");
    let (d, expected) = (d.and_then(|figure| figure.value).expect("D"), 1e3 * 47.0 * (scales[0] + scales[1]) / 2.0);
    assert!((d - expected).abs() < 0.1, "{d} {expected}");
}

#[test]
fn circles_that_were_not_scanned_here_are_refused() {
    let text = of_probe(&Machine::new(&mut Random::new(1)), [0.0; 2], false);
    let folder = temporary();
    write(&folder.path().join("circle.csv"), &text);
    let refused = |scanned: Value, radius: f64| {
        let recipe = Variant(json!({ "abbe": 1, "name": "circle", "stages": {
            "circle": { "ingest": "csv", "path": folder.path().join("circle.csv") },
            "figures": { "validate": "circular", "from": "circle", "radius_mm": radius, "scanned": scanned },
        }}));
        let written = recipe.write(folder.path());
        let run = abbe_engine::prepare(&written, &crate::support::registry())
            .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()));
        match run {
            Err(error) => error.to_string(),
            Ok(outcome) => outcome.failures.iter().map(|failure| failure.error.to_string()).collect(),
        }
    };
    let plane = |centre: Value| json!({ "plane": ["X", "Y"], "centre_mm": centre });
    let beside = refused(plane(json!([20, 0])), RADIUS);
    assert!(beside.contains("is no deviation from 60 mm") && beside.contains("circle.csv"), "{beside}");
    assert!(refused(json!({ "plane": ["X", "Q"], "centre_mm": [0, 0] }), RADIUS).contains('Q'));
    assert_eq!(refused(plane(json!([0, 0])), RADIUS), "");
}

/// Figures use two positions of three: a row that is elsewhere along the third is told.
#[test]
fn a_scanned_point_beside_the_plane_of_its_ring_is_told() {
    let recipe = || Variant::of(&recipes()["standards-scanned-ring"]);
    let file = recipe().path("scan", "path");
    for (z, is_told) in [("50000", true), ("-150", true), ("0.05", false)] {
        let (folder, mut recipe) = (temporary(), recipe());
        let moved = |row: usize, cell: &str| if row == 40 { z.to_owned() } else { cell.to_owned() };
        recipe.stage("scan")["path"] = json!(changed(&file, folder.path(), "Z_mm", moved));
        let remarks: Vec<String> = recipe.run().verdicts.into_iter().flat_map(|verdict| verdict.remarks).collect();
        assert_eq!(remarks.join("\n").contains("mm beside any plane"), is_told, "{z}: {remarks:?}");
    }
}

/// A scan that went round the other way than its direction says: one of the two alone, too.
#[test]
fn a_scan_against_its_direction_is_told() {
    let recipe = || Variant::of(&recipes()["standards-scanned-ring"]);
    let file = recipe().path("scan", "path");
    let rows = read(&file).lines().filter(|line| !line.starts_with('#')).count() - 1;
    let told = |is_mirrored: &dyn Fn(usize) -> bool| {
        let (folder, mut recipe) = (temporary(), recipe());
        let mirrored = |row: usize, cell: &str| match is_mirrored(row) {
            true => (-cell.parse::<f64>().expect("a coordinate")).to_string(),
            false => cell.to_owned(),
        };
        recipe.stage("scan")["path"] = json!(changed(&file, folder.path(), "Y_mm", mirrored));
        let remarks: Vec<String> = recipe.run().verdicts.into_iter().flat_map(|verdict| verdict.remarks).collect();
        remarks.join("\n")
    };
    assert!(!told(&|_| false).contains("against `direction`"), "{}", told(&|_| false));
    let second = told(&|row| 2 * row >= rows);
    assert!(
        second.contains("the scan runs against `direction` in") && second.contains("steps of the cw run"),
        "{second}"
    );
    assert!(told(&|row| 2 * row < rows).contains("steps of the ccw run"));
    assert!(told(&|_| true).contains("the angles run against `direction` in most rows"));
}
