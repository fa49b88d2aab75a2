//! Plane facets that are touched at several places, or beside their nominal points.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use abbe_core::Calibration;
use serde_json::json;

use crate::support::{Random, abbe, json_file, read, temporary, write};

/// Half the width of the block, mm, and its faces: normals.
const HALF: f64 = 100.0;
const FACES: [[f64; 3]; 5] = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];

const LENGTH: f64 = 120.0;
const STYLUS: f64 = 3.0;
const ERRORS: [&str; 3] = ["EC0Y", "EA0Z", "EB0Z"];

const RECIPE: &str = "abbe: 1
name: r
stages:
  touches: { ingest: csv, path: touches.csv }
  block: { artefact: facets, from: touches, nominal: facets.csv, standard_uncertainty_um: 1 }
  machine:
    model: serial-chain
    chain: \"w b X Y Z t\"
    tool_length_mm: 120
    stylus_radius_mm: 3
    errors: [{ location: [EC0Y, EA0Z, EB0Z] }]
  fit: { estimate: gauss-newton, machine: machine, observations: [block], parameters: [\"E*\", \"block.*\"] }
";

/// A place on a face: its point, and what is beside it in the plane.
fn beside(normal: [f64; 3], by: [f64; 2]) -> [f64; 3] {
    let along = normal.iter().position(|part| *part != 0.0).expect("a normal");
    let mut place = [0.0; 3];
    (place[(along + 1) % 3], place[(along + 2) % 3]) = (by[0], by[1]);
    place
}

/// Nominal facets, each moved within its plane.
fn facets(moved: impl Fn(usize) -> [f64; 2]) -> String {
    let mut text = "feature,x_mm,y_mm,z_mm,nx,ny,nz\n".to_owned();
    for (face, normal) in FACES.into_iter().enumerate() {
        let by = beside(normal, moved(face));
        let [x, y, z] = [0, 1, 2].map(|axis| HALF * normal[axis] + by[axis]);
        let [i, j, k] = normal;
        let _ = writeln!(text, "{},{x},{y},{z},{i},{j},{k}", face + 1);
    }
    text
}

/// Touches of faces, by the commands that aim at them on a machine without errors.
fn touches(places: &[(usize, [f64; 2])]) -> String {
    let mut text = "feature,X_mm,Y_mm,Z_mm\n".to_owned();
    for (face, by) in places {
        let (normal, by) = (FACES[*face], beside(FACES[*face], *by));
        let [x, y, z] = [0, 1, 2].map(|axis| (HALF + STYLUS) * normal[axis] + by[axis]);
        let _ = writeln!(text, "{},{x:.4},{y:.4},{:.4}", face + 1, z + LENGTH);
    }
    text
}

fn fitted(folder: &std::path::Path, out: &str) -> Calibration {
    let printed = abbe(folder, &["run", "r.yaml", "--out", out]);
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    Calibration::from_json(&read(&folder.join(out).join("r/fit.calibration.json"))).expect("a calibration")
}

/// One face, one label, many places: what they tell is told, the virtual machine touches where it was said, and where in its plane the
/// nominal point lies changes neither values nor uncertainties.
#[test]
fn a_face_may_be_touched_at_many_places() {
    for seed in 0..12 {
        let mut random = Random::new(seed);
        let folder = temporary();
        let at = |name: &str| folder.path().join(name);
        let places: Vec<(usize, [f64; 2])> =
            (0..45).map(|touch| (touch % 5, [random.within(-80.0, 80.0), random.within(-80.0, 80.0)])).collect();
        write(&at("r.yaml"), RECIPE);
        write(&at("touches.csv"), &touches(&places));
        write(&at("facets.csv"), &facets(|_| [0.0; 2]));
        let truth: BTreeMap<&str, f64> = ERRORS.into_iter().map(|name| (name, random.within(-1e-4, 1e-4))).collect();
        write(&at("truth.json"), &json!({ "parameters": truth }).to_string());
        let made =
            abbe(folder.path(), &["simulate", "r.yaml", "--truth", "truth.json", "--seed", "1", "--out", "made"]);
        assert_eq!(made.status, 0, "{}", made.stderr);
        let measured = read(&at("made/touches.csv"));
        let rows = |text: &str| -> Vec<Vec<f64>> {
            let lines = text.lines().filter(|line| !line.starts_with('#')).skip(1);
            lines.map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect()).collect()
        };
        for (aimed, touched) in rows(&touches(&places)).iter().zip(rows(&measured)) {
            assert!(aimed.iter().zip(&touched).all(|(one, other)| (one - other).abs() < 0.1), "{aimed:?} {touched:?}");
        }
        write(&at("touches.csv"), &measured);
        let found = fitted(folder.path(), "first");
        let moved: Vec<[f64; 2]> = (0..5).map(|_| [random.within(-70.0, 70.0), random.within(-70.0, 70.0)]).collect();
        write(&at("facets.csv"), &facets(|face| moved[face]));
        let other = fitted(folder.path(), "other");
        for (name, value) in &truth {
            let (one, two) = (found.get(name).expect("estimated"), other.get(name).expect("estimated"));
            assert!((one.value - value).abs() < 1e-9, "{seed}: {name}: {} of {value}", one.value);
            assert!((one.value - two.value).abs() < 1e-12, "{seed}: {name}");
            let ratio = two.standard_uncertainty / one.standard_uncertainty;
            assert!(one.standard_uncertainty > 0.0 && (ratio - 1.0).abs() < 1e-6, "{seed}: {name}: {ratio}");
        }
        assert_eq!(found.fit.rank, other.fit.rank, "{seed}");
    }
}

/// Touches that miss the point by less than a millimetre are aimed at it: what they miss it by is no information.
#[test]
fn what_touches_miss_the_point_by_is_no_information() {
    for seed in 0..12 {
        let mut random = Random::new(100 + seed);
        let folder = temporary();
        let places: Vec<(usize, [f64; 2])> =
            (0..45).map(|touch| (touch % 5, [random.within(-0.6, 0.6), random.within(-0.6, 0.6)])).collect();
        write(&folder.path().join("r.yaml"), RECIPE);
        write(&folder.path().join("touches.csv"), &touches(&places));
        write(&folder.path().join("facets.csv"), &facets(|_| [0.0; 2]));
        let checked = abbe(folder.path(), &["check", "r.yaml", "--json"]);
        write(&folder.path().join("checked.json"), &checked.stdout);
        let text = json_file(&folder.path().join("checked.json")).to_string();
        assert!(ERRORS.iter().any(|name| text.contains(name)), "{seed}: {text}");
        assert_ne!(checked.status, 0, "{seed}: {}", checked.stdout);
    }
}

/// What `check` says of touches, in one line.
fn checked(places: &[(usize, [f64; 2])]) -> String {
    let folder = temporary();
    write(&folder.path().join("r.yaml"), RECIPE);
    write(&folder.path().join("touches.csv"), &touches(places));
    write(&folder.path().join("facets.csv"), &facets(|_| [0.0; 2]));
    let checked = abbe(folder.path(), &["check", "r.yaml"]);
    let said = format!("{} {}", checked.stdout, checked.stderr);
    said.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

/// Side faces that are touched 50 mm too low in a part of the rows fit as well: the length of the tool, or a work offset, was another one.
#[test]
fn touches_beside_the_points_in_a_part_of_the_rows_are_told() {
    let words = "beside the nominal points of their facets";
    for seed in 0..12 {
        let mut random = Random::new(200 + seed);
        let within = [0.3, 60.0][seed as usize % 2];
        let mut place = |touch: usize| (touch % 5, [random.within(-within, within), random.within(-within, within)]);
        let places: Vec<(usize, [f64; 2])> = (0..45).map(&mut place).collect();
        let good = checked(&places);
        assert!(!good.contains(words), "{seed}: {good}");
        let lowered = |(touch, (face, [one, other])): (usize, &(usize, [f64; 2]))| {
            let by = if (15..30).contains(&touch) { -50.0 } else { 0.0 };
            let lowered = match face {
                0 | 1 => [*one, other + by],
                2 | 3 => [one + by, *other],
                _ => [*one, *other],
            };
            (*face, lowered)
        };
        let mistaken = checked(&places.iter().enumerate().map(lowered).collect::<Vec<_>>());
        let is_told = mistaken.contains("block: 12 of 45 touches, the first in")
            && mistaken.contains("touches.csv:17, lie ")
            && mistaken.contains("is the tool length, or the work offset, of these rows another one?");
        assert_eq!(is_told, within < 1.0, "{seed}: {mistaken}");
    }
}
