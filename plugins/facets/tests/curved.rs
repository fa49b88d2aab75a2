//! Curved facets: touches anywhere on the surface fit exactly, derivatives are those of differences, and what does not go
//! together is refused.

use std::path::Path;
use std::sync::Arc;

use abbe_core::{Build, Context, Kind, KinematicModel, ObservationSet, Plugin, Problem, Registry};
use abbe_facets as _;
use abbe_serial_chain as _;
use serde_json::{Value, json};

const NOMINAL: &str = "feature,x_mm,y_mm,z_mm,nx,ny,nz\nround,250,0,40,1,0,0\nball,0,30,90,0,0,1\nflat,0,0,50,0,0,1\n";

fn take<T>(kind: Kind, name: &str, of: impl Fn(&Plugin) -> T) -> T {
    of(Registry::built_in().unwrap().find(kind, name).unwrap())
}

/// The residuals of tips on facets (label, tip), and their derivatives to the linear axes.
fn evaluated(curved: Value, touches: &[(&str, [f64; 3])]) -> Result<(Vec<f64>, Vec<f64>), String> {
    evaluated_on(NOMINAL, curved, touches)
}

fn evaluated_on(nominal: &str, curved: Value, touches: &[(&str, [f64; 3])]) -> Result<(Vec<f64>, Vec<f64>), String> {
    let folder = tempfile::tempdir().unwrap();
    let context = Context { base: folder.path().to_owned() };
    std::fs::write(folder.path().join("facets.csv"), nominal).unwrap();
    let rows: String = touches.iter().map(|(label, [x, y, z])| format!("{label},{x},{y},{}\n", z + 100.0)).collect();
    let file = folder.path().join("touches.csv");
    std::fs::write(&file, format!("feature,X_mm,Y_mm,Z_mm\n{rows}")).unwrap();
    let machine = json!({ "chain": "w b X Y Z t", "tool_length_mm": 100, "stylus_radius_mm": 3 });
    let model: Arc<dyn KinematicModel> = take(Kind::Model, "serial-chain", |plugin| match &plugin.build {
        Build::Model(constructor) => constructor.build(&machine, &context).unwrap().build(&[]).unwrap(),
        _ => unreachable!(),
    });
    let settings = json!({ "nominal": "facets.csv", "standard_uncertainty_um": 1, "curved": curved });
    let artefact = take(Kind::Artefact, "facets", |plugin| match &plugin.build {
        Build::Artefact(constructor) => constructor.build(&settings, &context).map_err(|error| error.to_string()),
        _ => unreachable!(),
    })?;
    let data = Arc::new(abbe_table::read(&file).unwrap());
    let observations = artefact.observe(&data, &model);
    let observations = observations.map_err(|error| error.to_string().replace(&shown(folder.path()), ""))?;
    // The tool offsets move the tip along the axes: derivatives to them are those to the tip.
    let patterns = ["dxt", "dyt", "dzt"].map(str::to_owned);
    let problem = Problem::new("fit", "serial-chain", model, vec![ObservationSet::new("t", observations)], &patterns);
    let problem = problem.unwrap();
    let (mut residuals, mut derivatives) = (Vec::new(), Vec::new());
    problem
        .linearise(&[0.0; 3], |block| {
            residuals.extend_from_slice(block.residuals);
            derivatives.extend_from_slice(block.jacobian);
        })
        .unwrap();
    Ok((residuals, derivatives))
}

fn shown(folder: &Path) -> String {
    format!("{}/", folder.display())
}

#[test]
fn touches_anywhere_on_the_surface_fit() {
    let on_cylinder = |radius: f64, angle: f64, z: f64| {
        // The tip is one stylus radius outside a hump, inside a hollow; both have their top at (250, 0, 40).
        let distance = radius + 3.0;
        [250.0 - radius + distance * angle.cos(), distance * angle.sin(), z]
    };
    for radius in [250.0, -80.0] {
        let touches: Vec<(&str, [f64; 3])> =
            (-5..=5).map(|k| ("round", on_cylinder(radius, 0.01 * f64::from(k), 40.0 + f64::from(k)))).collect();
        let curved = json!([{ "features": ["round"], "radius_mm": radius, "axis": [0, 0, 2] }]);
        let (residuals, _) = evaluated(curved, &touches).unwrap();
        assert!(residuals.iter().all(|residual| residual.abs() < 1e-11), "{radius}: {residuals:?}");
        // As planes they are off by the square of the way beside the point over twice the radius of the tip's surface.
        let (plane, _) = evaluated(json!([]), &touches).unwrap();
        let beside = touches[0].1[1];
        let expected = -beside * beside / (2.0 * (radius + 3.0));
        assert!((plane[0] / expected - 1.0).abs() < 2e-3, "{radius}: {} {expected}", plane[0]);
    }
    let (side, up) = (40.0 * 0.2_f64.sin(), 40.0 * 0.2_f64.cos());
    let touches = [("ball", [side * 0.6, 30.0 + side * 0.8, 90.0 - 37.0 + up])];
    let (residuals, _) = evaluated(json!([{ "features": ["ball"], "radius_mm": 37 }]), &touches).unwrap();
    assert!(residuals[0].abs() < 1e-11, "{residuals:?}");
}

#[test]
fn derivatives_are_those_of_differences() {
    let curved = json!([
        { "features": ["round"], "radius_mm": 250, "axis": [0, 0, 1] },
        { "features": ["ball"], "radius_mm": -37 }
    ]);
    for (label, tip) in [("round", [252.0, 20.0, 60.0]), ("ball", [4.0, 25.0, 95.0]), ("flat", [1.0, 2.0, 53.0])] {
        let (_, derivatives) = evaluated(curved.clone(), &[(label, tip)]).unwrap();
        for axis in 0..3 {
            let moved = |by: f64| {
                let mut tip = tip;
                tip[axis] += by;
                evaluated(curved.clone(), &[(label, tip)]).unwrap().0[0]
            };
            let difference = (moved(1e-3) - moved(-1e-3)) / 2e-3;
            assert!((difference - derivatives[axis]).abs() < 1e-6, "{label}: {difference} {}", derivatives[axis]);
        }
    }
}

#[test]
fn what_does_not_go_together_is_refused() {
    let touch = [("round", [253.0, 0.0, 40.0])];
    let cases = [
        (json!([{ "features": ["rond"], "radius_mm": 250 }]), "the nominal file has no facet rond"),
        (
            json!([{ "features": ["flat"], "radius_mm": 250, "axis": [0, 0, 1] }]),
            "facets.csv:4: the normal of facet flat is not perpendicular to the axis of its cylinder",
        ),
        (json!([{ "radius_mm": 0 }]), "curved[0].radius_mm: a radius that is not zero was expected"),
        (
            json!([{ "radius_mm": 10, "axis": [0, 0, 0] }]),
            "curved[0].axis: a direction was expected: x, y, z, not all zero",
        ),
    ];
    for (curved, expected) in cases {
        assert_eq!(evaluated(curved, &touch).unwrap_err(), expected);
    }
}

/// Facets around a cylinder and on a ball, both with an offset: their radius is in their points and normals. On two balls they tell
/// nothing.
#[test]
fn a_radius_that_the_nominal_facets_contradict_is_refused() {
    let header = "feature,x_mm,y_mm,z_mm,nx,ny,nz\n";
    let facet = |label: usize, centre: [f64; 3], radius: f64, normal: [f64; 3]| {
        let at: Vec<String> = (0..3).map(|k| (centre[k] + radius * normal[k]).to_string()).collect();
        format!("{label},{},{:.4},{:.4},{:.4}\n", at.join(","), normal[0], normal[1], normal[2])
    };
    let around = |turn: f64| [turn.cos(), turn.sin(), 0.0];
    let touch = [("0", [103.0, 0.0, 40.0])];
    for radius in [60.0, -60.0] {
        let ring: String =
            (0..5).map(|k| facet(k, [40.0, 5.0, 7.0 * k as f64], radius, around(0.6 * k as f64))).collect();
        let ring = format!("{header}{ring}");
        let of = |stated: f64| evaluated_on(&ring, json!([{ "radius_mm": stated, "axis": [0, 0, 1] }]), &touch);
        assert!(of(radius).is_ok() && of(radius * 1.01).is_ok());
        for wrong in [radius / 2.0, radius * 2.0, -radius, radius * 1.05] {
            let told = of(wrong).unwrap_err();
            assert!(told.contains(&format!("lie on a surface of {radius:.3} mm")), "{told}");
        }
    }
    // A sphere, and a cylinder in a line after it: each is held against its own facets.
    let tilted = |turn: f64, up: f64| [turn.cos() * up.cos(), turn.sin() * up.cos(), up.sin()];
    let sphere: String =
        (0..5).map(|k| facet(k, [40.0, 5.0, 9.0], 43.0, tilted(0.5 * k as f64, 0.3 * k as f64))).collect();
    let ring: String = (5..9).map(|k| facet(k, [0.0, 5.0, 7.0 * k as f64], 60.0, around(0.6 * k as f64))).collect();
    let two = format!("{header}{sphere}{ring}");
    let of = |sphere: f64, ring: f64| {
        let sphere = json!({ "features": ["0", "1", "2", "3", "4"], "radius_mm": sphere });
        evaluated_on(&two, json!([sphere, { "radius_mm": ring, "axis": [0, 0, 1] }]), &touch)
    };
    assert!(of(43.0, 60.0).is_ok());
    assert!(of(21.5, 60.0).unwrap_err().contains("lie on a surface of 43.000 mm"));
    assert!(of(43.0, 30.0).unwrap_err().contains("lie on a surface of 60.000 mm"));
    let balls: String =
        (0..4).map(|k| facet(k, [[0.0, 0.0, 0.0], [80.0, 5.0, 0.0]][k % 2], 20.0, around(0.4 * k as f64))).collect();
    let balls = format!("{header}{balls}");
    assert!(evaluated_on(&balls, json!([{ "radius_mm": 20 }]), &touch).is_ok());
}
