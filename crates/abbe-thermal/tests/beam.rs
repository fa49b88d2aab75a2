//! Beams against exact arithmetic, and laws of random ones.

use abbe_numerics::Generator;
use abbe_thermal::{Beam, SectionDisplacement, Segment, TemperaturePlane};
use serde_json::Value;

fn numbers(found: &SectionDisplacement) -> [f64; 5] {
    [found.elongation, found.rotation_y, found.rotation_z, found.deflection_y, found.deflection_z]
}

#[test]
fn published_cases_are_met() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../pipelines/data/thermal-spindle/beam.json");
    let text = std::fs::read_to_string(path).expect("a file");
    let all: Value = serde_json::from_str(&text).expect("JSON");
    let number = |value: &Value| value.as_f64().expect("a number");
    let cases = all["cases"].as_array().expect("cases");
    assert_eq!(cases.len(), 4);
    for case in cases {
        let segments = case["segments"].as_array().expect("segments").iter();
        let segments = segments
            .map(|one| Segment { length: number(&one["length_mm"]), expansion: number(&one["expansion_per_K"]) });
        let beam = Beam::new(segments.collect()).expect("a beam");
        let (mut planes, mut misfits) = (Vec::new(), Vec::new());
        for section in case["sections"].as_array().expect("sections") {
            let corners = section["corners"].as_array().expect("corners").iter();
            let corners: Vec<[f64; 3]> =
                corners.map(|corner| ["y_mm", "z_mm", "T_K"].map(|name| number(&corner[name]))).collect();
            let (plane, misfit) = TemperaturePlane::through(&corners).expect("a plane");
            planes.push(plane);
            misfits.push(misfit);
        }
        let found = beam.sections(&planes).expect("sections");
        for (found, expected) in found.iter().zip(case["expected"].as_array().expect("expected")) {
            let names = ["elongation_mm", "rotation_y_rad", "rotation_z_rad", "deflection_y_mm", "deflection_z_mm"];
            for (found, name) in numbers(found).iter().zip(names) {
                assert!((found - number(&expected[name])).abs() < 1e-13, "{} {name}: {found}", case["name"]);
            }
        }
        for (found, expected) in misfits.iter().zip(case["plane_misfit_K"].as_array().expect("misfits")) {
            assert!((found - number(expected)).abs() < 1e-9, "{}: {found} {expected}", case["name"]);
        }
    }
}

fn random(seed: u64) -> (Vec<Segment>, Vec<TemperaturePlane>) {
    let mut random = Generator::new(seed, 0);
    let count = 1 + random.index(5);
    let segments = (0..count)
        .map(|_| Segment { length: 60.0 + 30.0 * random.uniform(), expansion: 1e-5 * (2.0 + random.uniform()) })
        .collect();
    let planes = (0..=count).map(|_| TemperaturePlane {
        on_axis: 5.0 * random.normal(),
        along_y: 0.05 * random.normal(),
        along_z: 0.05 * random.normal(),
    });
    (segments, planes.collect())
}

/// A beam cut anywhere is the same beam: places between sections are those of a section there.
#[test]
fn a_section_more_changes_nothing() {
    for seed in 0..200 {
        let (segments, planes) = random(seed);
        let mut generator = Generator::new(seed, 1);
        let beam = Beam::new(segments.clone()).expect("a beam");
        let cut = generator.index(segments.len());
        let part = 0.5 + 0.2 * generator.uniform();
        let between = |a: f64, b: f64| a + part * (b - a);
        let (from, to) = (planes[cut], planes[cut + 1]);
        let here = TemperaturePlane {
            on_axis: between(from.on_axis, to.on_axis),
            along_y: between(from.along_y, to.along_y),
            along_z: between(from.along_z, to.along_z),
        };
        let (mut more, mut more_planes) = (segments.clone(), planes.clone());
        more[cut].length *= part;
        more.insert(cut + 1, Segment { length: segments[cut].length * (1.0 - part), ..segments[cut] });
        more_planes.insert(cut + 1, here);
        let cut_beam = Beam::new(more.clone()).expect("a beam");
        let found = cut_beam.sections(&more_planes).expect("sections");
        let whole = beam.sections(&planes).expect("sections");
        let x: f64 = more[..=cut].iter().map(|segment| segment.length).sum();
        let at = beam.at(&planes, x).expect("a place");
        let same = |a: &SectionDisplacement, b: &SectionDisplacement| {
            numbers(a).iter().zip(numbers(b)).all(|(a, b)| (a - b).abs() < 1e-12)
        };
        assert!(same(&at, &found[cut + 1]), "seed {seed}: {at:?} {found:?}");
        assert!(same(whole.last().expect("an end"), found.last().expect("an end")), "seed {seed}");
    }
}

/// Warmed all over, a beam grows in proportion and does not bend; turned about x by a quarter, its bending turns with it.
#[test]
fn laws_of_beams() {
    for seed in 0..100 {
        let (segments, planes) = random(seed);
        let beam = Beam::new(segments.clone()).expect("a beam");
        let same = vec![TemperaturePlane { on_axis: 7.0, along_y: 0.0, along_z: 0.0 }; planes.len()];
        let end = *beam.sections(&same).expect("sections").last().expect("an end");
        let grown: f64 = segments.iter().map(|segment| 7.0 * segment.length * segment.expansion).sum();
        assert!((end.elongation - grown).abs() < 1e-12);
        assert_eq!([end.deflection_y, end.deflection_z, end.rotation_y, end.rotation_z], [0.0; 4]);
        // y to z, z to -y: what was along y is along z then.
        let turned: Vec<TemperaturePlane> = (planes.iter())
            .map(|plane| TemperaturePlane { along_y: -plane.along_z, along_z: plane.along_y, ..*plane })
            .collect();
        let (one, other) = (beam.sections(&planes).expect("sections"), beam.sections(&turned).expect("sections"));
        for (one, other) in one.iter().zip(&other) {
            let expected = [one.elongation, -one.rotation_z, one.rotation_y, -one.deflection_z, one.deflection_y];
            let found = numbers(other);
            assert!(
                expected.iter().zip(found).all(|(a, b)| (a - b).abs() < 1e-14),
                "seed {seed}: {expected:?} {found:?}"
            );
        }
    }
}

#[test]
fn planes_take_what_sensors_tell() {
    let (plane, _) = TemperaturePlane::through(&[[40.0, -30.0, 2.5]]).expect("a plane");
    assert_eq!((plane.on_axis, plane.along_y, plane.along_z), (2.5, 0.0, 0.0));
    // Two sensors on a line through the axis tell the gradient along it.
    let (plane, _) = TemperaturePlane::through(&[[0.0, -50.0, 1.0], [0.0, 50.0, 3.0]]).expect("a plane");
    assert!((plane.on_axis - 2.0).abs() < 1e-12 && plane.along_y == 0.0 && (plane.along_z - 0.02).abs() < 1e-14);
    assert!(TemperaturePlane::through(&[]).is_err());
    assert!(TemperaturePlane::through(&[[0.0, 0.0, f64::NAN]]).is_err());
    assert!(Beam::new(Vec::new()).is_err());
    assert!(Beam::new(vec![Segment { length: -1.0, expansion: 1e-5 }]).is_err());
    let beam = Beam::new(vec![Segment { length: 10.0, expansion: 1e-5 }]).expect("a beam");
    assert!(beam.sections(&[plane]).expect_err("one plane").to_string().contains("2 sections"));
    assert!(beam.at(&[plane, plane], 11.0).expect_err("beyond").to_string().contains("not on the beam"));
}
