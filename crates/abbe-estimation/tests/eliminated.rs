//! Own unknowns that are eliminated have the values and standard uncertainties that they have in one triangle of all unknowns, and so
//! have all others with their covariance.

use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use abbe_balls as _;
use abbe_core::{
    Build, Calibration, Context, Estimate, Kind, KinematicModel, ObservationSet, Plugin, Problem, Registry,
};
use abbe_estimation::{EliminatedRows, RowsAtHand, UncertaintyEvaluation};
use abbe_facets as _;
use abbe_gauss_newton as _;
use abbe_length as _;
use abbe_numerics::{End, Options};
use abbe_serial_chain as _;
use serde_json::{Value, json};

const EVALUATION: UncertaintyEvaluation = UncertaintyEvaluation {
    rank_tolerance: 1e-10,
    trust_uncertainties: false,
    coverage_probability: 0.95,
    explained: true,
};

fn plugin<T>(kind: Kind, name: &str, take: impl Fn(&Plugin) -> Option<T>) -> T {
    take(Registry::built_in().unwrap().find(kind, name).unwrap()).unwrap()
}

/// A problem: machine, then (stage, artefact, settings, file of rows) in a folder, then patterns of parameters.
fn problem(folder: &Path, machine: &Value, artefacts: &[(&str, &str, Value, &str)], parameters: &[&str]) -> Problem {
    let context = Context { base: folder.to_owned() };
    let data: Vec<_> =
        artefacts.iter().map(|(.., file)| Arc::new(abbe_table::read(&folder.join(file)).unwrap())).collect();
    let readings: Vec<_> = data.iter().map(Arc::as_ref).collect();
    let model: Arc<dyn KinematicModel> = plugin(Kind::Model, "serial-chain", |plugin| match &plugin.build {
        Build::Model(constructor) => Some(constructor.build(machine, &context).unwrap().build(&readings).unwrap()),
        _ => None,
    });
    let sets = artefacts.iter().zip(&data).map(|((stage, name, settings, _), data)| {
        let observations = plugin(Kind::Artefact, name, |plugin| match &plugin.build {
            Build::Artefact(constructor) => {
                Some(constructor.build(settings, &context).unwrap().observe(data, &model).unwrap())
            }
            _ => None,
        });
        ObservationSet::new(stage, observations)
    });
    let sets = sets.collect();
    let patterns: Vec<String> = parameters.iter().map(|pattern| (*pattern).to_owned()).collect();
    Problem::new("fit", "serial-chain", model, sets, &patterns).unwrap()
}

fn estimated(problem: &Problem) -> Calibration {
    let at_hand = RowsAtHand(problem);
    let rows = EliminatedRows::new(problem, &at_hand).unwrap();
    let judged = rows.judge(EVALUATION.rank_tolerance).unwrap();
    assert_eq!(judged.rank, problem.unknowns.len());
    let solved = rows.solve(&problem.start(), &Options::USUAL).unwrap();
    assert_eq!(solved.end, End::Converged);
    EVALUATION.calibration_of_eliminated(&rows, &solved).unwrap()
}

fn gauss_newton() -> Box<dyn Estimate> {
    plugin(Kind::Estimate, "gauss-newton", |plugin| match &plugin.build {
        Build::Estimate(constructor) => constructor.build(&json!({}), &Context { base: "".into() }).ok(),
        _ => None,
    })
}

/// Compares with one triangle of all unknowns: values, uncertainties, the covariance that is there, and the report.
fn agrees(found: &Calibration, dense: &Calibration, eliminated: usize) {
    assert_eq!(found.fit.eliminated, eliminated);
    assert_eq!(Calibration::from_json(&found.to_json().unwrap()).unwrap(), *found);
    let all = |of: &Calibration| of.parameters.iter().chain(&of.artefacts).cloned().collect::<Vec<_>>();
    assert_eq!(all(found).len(), all(dense).len());
    for (found, expected) in all(found).iter().zip(&all(dense)) {
        let (u, name) = (expected.standard_uncertainty, &expected.name);
        assert_eq!((&found.name, &found.unit, found.status), (name, &expected.unit, expected.status));
        let off = (found.value - expected.value).abs();
        assert!(off <= 1e-8 * u, "{name}: {} and {}, u = {u:e}", found.value, expected.value);
        let off = (found.standard_uncertainty - u).abs();
        assert!(off <= 1e-8 * u, "u of {name}: {:e} and {u:e}", found.standard_uncertainty);
    }
    let kept = &found.covariance;
    assert_eq!(kept.order.len(), dense.covariance.order.len() - eliminated);
    for (row, one) in kept.order.iter().enumerate() {
        for (column, other) in kept.order.iter().enumerate() {
            let expected = dense.covariance.block(&[one, other])[(0, 1)];
            let size = (dense.covariance.variance(one).unwrap() * dense.covariance.variance(other).unwrap()).sqrt();
            assert!((kept.rows[row][column] - expected).abs() <= 1e-8 * size, "{one} and {other}");
        }
    }
    let (one, other) = (&found.fit, &dense.fit);
    assert_eq!((one.observations, one.unknowns, one.rank), (other.observations, other.unknowns, other.rank));
    assert_eq!(one.degrees_of_freedom, other.degrees_of_freedom);
    assert!((one.sigma / other.sigma - 1.0).abs() < 1e-9 && (one.condition / other.condition - 1.0).abs() < 1e-3);
    let budgets = &found.uncertainty.as_ref().unwrap().parameters;
    assert_eq!(budgets.len(), dense.uncertainty.as_ref().unwrap().parameters.len() - eliminated);
    for budget in budgets {
        let of_dense = &dense.uncertainty.as_ref().unwrap().parameters;
        let expected = of_dense.iter().find(|expected| expected.name == budget.name).unwrap();
        assert!((budget.standard_uncertainty / expected.standard_uncertainty - 1.0).abs() < 1e-8, "{}", budget.name);
        assert_eq!(budget.contributions.len(), expected.contributions.len());
    }
}

/// TANGO in rows of two artefacts, with the stylus radius as an input that is considered.
fn tango(bar: bool) -> Problem {
    const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../pipelines/data/tango-hu40t/realistic");
    let machine = json!({
        "chain": "w C' B' X' b Z Y (S) t", "tool_length_mm": 326.674, "stylus_radius_mm": 3,
        "axes": {
            "X": { "range_mm": [-400, 400] }, "Y": { "range_mm": [-400, 400] }, "Z": { "range_mm": [150, 750] },
            "B": { "range_deg": [-90, 90] }, "C": { "range_deg": [-360, 360] }, "S": { "range_deg": [0, 360] }
        },
        "errors": [
            { "location": ["EA0B", "EC0B", "EX0C", "EA0C", "EB0C", "EB0Z", "EA0Y", "EC0Y", "EX0S", "EY0S"] },
            { "polynomial": ["EXX", "EYY", "EZZ"], "degrees": [1] },
            { "backlash": ["EXX", "EYY", "EZZ", "EBB", "ECC"] }
        ]
    });
    let folder = tempfile::tempdir().unwrap();
    for file in ["facets.csv", "lengths.csv"] {
        fs::copy(Path::new(DATA).join(file), folder.path().join(file)).unwrap();
    }
    let text = fs::read_to_string(Path::new(DATA).join("touches.csv")).unwrap();
    let rows = text.lines().filter(|line| !["1", "2"].contains(&line.split(',').nth(1).unwrap_or_default()));
    fs::write(folder.path().join("touches.csv"), rows.map(|line| format!("{line}\n")).collect::<String>()).unwrap();
    let facets = json!({
        "nominal": "facets.csv", "standard_uncertainty_um": 1.6, "stylus_radius_standard_uncertainty_um": 0.5
    });
    let mut artefacts = vec![
        ("table", "facets", facets, "touches.csv"),
        ("bar", "length", json!({ "standard_uncertainty_um": 1 }), "lengths.csv"),
    ];
    artefacts.truncate(1 + usize::from(bar));
    let parameters = ["dxt", "dyt", "dzt", "EXX[1]", "EYY[1]", "EZZ[1]", "E?0?", "table.*"];
    problem(folder.path(), &machine, &artefacts, &parameters)
}

#[test]
fn facets_of_a_five_axis_machine_with_a_bar() {
    let problem = tango(true);
    let facets = problem.unknowns.iter().filter(|unknown| unknown.name.starts_with("table.")).count();
    assert!(facets > 10 && !problem.considered.unknowns.is_empty());
    agrees(&estimated(&problem), &gauss_newton().explain(&problem).unwrap(), facets);
}

#[test]
fn what_is_lost_has_the_same_name() {
    let problem = tango(false);
    let dense = gauss_newton().identify(&problem).unwrap();
    let found = EliminatedRows::new(&problem, &RowsAtHand(&problem)).unwrap().judge(EVALUATION.rank_tolerance).unwrap();
    assert_eq!((found.rank, found.unknowns), (dense.rank, dense.unknowns));
    assert!((found.condition / dense.condition - 1.0).abs() < 1e-3, "{} {}", found.condition, dense.condition);
    let [one] = found.null_space.as_slice() else { panic!("one direction: {:?}", found.null_space) };
    let [expected] = dense.null_space.as_slice() else { panic!("one direction") };
    assert_eq!(one.combination.len(), expected.combination.len());
    for part in &one.combination {
        let expected = expected.combination.iter().find(|expected| expected.name == part.name).unwrap();
        assert!((part.coefficient - expected.coefficient).abs() <= 1e-5 * expected.coefficient.abs(), "{}", part.name);
    }
}

/// Balls on a table of three axes, each touched from nine directions, with noise of about one micrometre.
fn balls(count: usize) -> Problem {
    let mut nominal = "feature,x_mm,y_mm,z_mm,diameter_mm\n".to_owned();
    let mut touches = "feature,X_mm,Y_mm,Z_mm\n".to_owned();
    let directions = [
        [1.0, 0.0, 0.0],
        [-1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, -1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.6, 0.0, 0.8],
        [-0.6, 0.0, 0.8],
        [0.0, 0.6, 0.8],
        [0.0, -0.6, 0.8],
    ];
    let mut bits = 1_u64;
    let mut noise = move || {
        bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((bits >> 11) as f64 / (1_u64 << 53) as f64 - 0.5) * 3.4e-3
    };
    for ball in 0..count {
        let centre = [(ball % 40) as f64 * 25.0, (ball / 40 % 40) as f64 * 25.0, (ball / 1600) as f64 * 25.0];
        writeln!(nominal, "{ball},{},{},{},20", centre[0], centre[1], centre[2]).unwrap();
        for direction in directions {
            let [x, y, z] = [0, 1, 2].map(|k| centre[k] + 13.0 * direction[k] + noise());
            // The X axis is 0.2 parts in a thousand too long.
            writeln!(touches, "{ball},{:.6},{:.6},{:.6}", x / 1.0002, y, z + 100.0).unwrap();
        }
    }
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("balls.csv"), nominal).unwrap();
    fs::write(folder.path().join("touches.csv"), touches).unwrap();
    let machine = json!({
        "chain": "w b X Y Z t", "tool_length_mm": 100, "stylus_radius_mm": 3,
        "axes": { "X": { "range_mm": [-50, 1050] }, "Y": { "range_mm": [-50, 1050] }, "Z": { "range_mm": [0, 400] } },
        "errors": [{ "polynomial": ["EXX", "EYY"], "degrees": [1] }],
    });
    let settings = json!({ "nominal": "balls.csv", "standard_uncertainty_um": 1 });
    let artefacts = [("table", "balls", settings, "touches.csv")];
    problem(folder.path(), &machine, &artefacts, &["EXX[1]", "EYY[1]", "table.*"])
}

#[test]
fn balls_whose_three_unknowns_go_together() {
    let problem = balls(40);
    agrees(&estimated(&problem), &gauss_newton().explain(&problem).unwrap(), 3 * 40);
}

#[test]
fn ten_thousand_own_unknowns_need_no_triangle_of_all() {
    // One triangle of all would have 0.8 GB.
    let problem = balls(3_400);
    let calibration = estimated(&problem);
    assert_eq!((calibration.fit.eliminated, calibration.covariance.order.len()), (10_200, 2));
    let scale = calibration.get("EXX[1]").unwrap();
    assert!((scale.value - 2e-4).abs() < 5.0 * scale.standard_uncertainty, "{scale:?}");
    let smallest = calibration.artefacts.iter().map(|own| own.standard_uncertainty).fold(f64::INFINITY, f64::min);
    assert!(smallest > 1e-4, "{smallest}");
}
