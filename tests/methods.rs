//! The other touch methods against the values that their data were simulated with. Estimates never see them.

use std::collections::BTreeSet;

use abbe_core::{Calibration, Status};
use abbe_engine::Outcome;
use serde_json::Value;

use crate::support::{Variant, effect, fit, json_file, recipes, root, values};

/// What the data set of a recipe was simulated with.
fn truth(name: &str) -> Value {
    json_file(&root().join(format!("tests/truth/{name}.json")))["parameters"].clone()
}

fn run(recipe: &str) -> Outcome {
    Variant::of(&recipes()[recipe]).run()
}

/// Every estimated value that the truth knows: name, unit, error, standard uncertainty.
fn errors(calibration: &Calibration, truth: &Value) -> Vec<(String, String, f64, f64)> {
    let own = |name: &str| match name.split_once('.') {
        Some((_, own)) if truth.get(name).is_none() => own.to_owned(),
        _ => name.to_owned(),
    };
    let estimated = values(calibration).filter(|estimated| estimated.status == Status::Estimated);
    let found: Vec<_> = estimated
        .filter_map(|estimated| {
            let error = estimated.value - truth[own(&estimated.name)].as_f64()?;
            Some((estimated.name.clone(), estimated.unit.clone(), error, estimated.standard_uncertainty))
        })
        .collect();
    assert!(found.len() > 20, "the truth knows {} values only", found.len());
    found
}

#[test]
fn exact_data_give_the_truth_back() {
    let fits = [
        ("cylinder-kx8", "fit-S1"),
        ("cylinder-kx8", "fit-S2"),
        ("cylinder-kx8", "fit-both"),
        ("cylinder-kx8", "fit-without-top"),
        ("samba", "fit"),
        ("samba", "fit-without-bar"),
        ("samba", "fit-all"),
    ];
    for system in ["cylinder-kx8", "samba"] {
        let (outcome, truth) = (run(&format!("{system}-exact")), truth(&format!("{system}-exact")));
        for (_, name) in fits.iter().filter(|(of, _)| *of == system) {
            for (parameter, unit, error, _) in errors(&fit(&outcome, name).calibration, &truth) {
                let (is_angle, factor) = effect(&unit);
                // 1e-5 um and 1e-4 urad.
                let allowed = if is_angle { 1e-10 } else { 1e-8 };
                assert!(error.abs() * factor <= allowed, "{system} {name}: {parameter} is off by {error:e}");
            }
        }
    }
}

#[test]
fn noisy_data_give_the_truth_back_within_the_stated_uncertainty() {
    let cylinder = ["fit-S1", "fit-S2", "fit-both", "fit-without-top"];
    for (system, names) in [("cylinder-kx8", &cylinder[..]), ("samba", &["fit", "fit-centres", "fit-without-bar"])] {
        let (outcome, truth) = (run(system), truth(&format!("{system}-realistic")));
        for name in names {
            for (parameter, _, error, uncertainty) in errors(&fit(&outcome, name).calibration, &truth) {
                // dzt is the mean of a run, the truth its start: they differ by the drift.
                let drift = if parameter == "dzt" { 2e-3 } else { 0.0 };
                let off = (error.abs() - drift).max(0.0) / uncertainty;
                assert!(off < 4.0, "{system} {name}: {parameter} is off by {off} standard uncertainties");
            }
        }
    }
}

#[test]
fn conditions_are_those_of_the_data() {
    let outcome = run("cylinder-kx8-exact");
    for (name, rank, condition) in
        [("fit-S1", 23, 27.0), ("fit-S2", 21, 32.0), ("fit-both", 31, 27.0), ("fit-without-top", 28, 32.0)]
    {
        let report = &fit(&outcome, name).calibration.fit;
        assert_eq!((report.rank, report.unknowns), (rank, rank), "{name}");
        assert!((report.condition / condition - 1.0).abs() < 0.02, "{name}: {}", report.condition);
    }
    // Standard uncertainties from 1.6 um of noise, in urad and um/m, as the data set's notes have them.
    for (name, expected) in [
        ("fit-S1", [1.9, 3.9, 3.5, 5.7]),
        ("fit-S2", [24.0, 29.0, 34.0, 10.0]),
        ("fit-both", [1.8, 3.1, 3.3, 4.8]),
        ("fit-without-top", [19.0, 23.0, 27.0, 7.5]),
    ] {
        let budget = fit(&outcome, name).calibration.uncertainty.as_ref().expect("a budget");
        for (parameter, expected) in ["EA0C", "EB0C", "EC0A", "EZZ[1]"].iter().zip(expected) {
            let found = budget.parameters.iter().find(|part| part.name == *parameter).expect("estimated");
            let found = found.stated_standard_uncertainty * 1e6;
            assert!((found / expected - 1.0).abs() < 0.04, "{name}: {parameter} {found}, {expected} expected");
        }
    }
}

#[test]
fn a_single_section_loses_two_directions() {
    for recipe in ["cylinder-kx8-exact", "cylinder-kx8"] {
        let outcome = run(recipe);
        let report = &fit(&outcome, "fit-section").calibration.fit;
        assert_eq!((report.unknowns, report.rank), (25, 23), "{recipe}");
        let lost: BTreeSet<Vec<&str>> = report
            .null_space
            .iter()
            .map(|vector| {
                let mut names: Vec<&str> = vector.combination.iter().map(|part| part.name.as_str()).collect();
                names.sort_unstable();
                names
            })
            .collect();
        assert_eq!(lost, [vec!["EA0C", "EY0C"], vec!["EB0C", "dxt", "dzt"]].into(), "{recipe}");
        for vector in &report.null_space {
            assert!(vector.separated_by.iter().any(|advice| advice.contains("z = 140 mm")), "{recipe}: {vector:?}");
        }
    }
}

/// A curved surface lies lower beside the nominal point: 1 mm beside it on a cylinder of 250 mm and a stylus of 3 mm by
/// 2 um. With the curvature in the model exact touches on it fit, without it they do not.
#[test]
fn touches_beside_the_point_of_a_curved_facet_are_lower() {
    let outcome = run("cylinder-kx8");
    let plane = Variant::of(&recipes()["cylinder-kx8"]).only(&["fit-S2"]).set("s2", "curved", serde_json::json!([]));
    let with = fit(&outcome, "fit-S2").calibration.fit.residual_rms_um;
    let without = fit(&plane.run(), "fit-S2").calibration.fit.residual_rms_um;
    assert!((with / without - 1.0).abs() < 0.1 && with != without, "{with} {without}");
}

#[test]
fn unseen_indexations_of_the_master_balls_are_predicted() {
    let outcome = run("samba");
    let verdict = outcome.verdicts.iter().find(|verdict| verdict.stage == "unseen").expect("a verdict");
    let figure = |name: &str| verdict.figures.iter().find(|figure| figure.name == name).and_then(|figure| figure.value);
    assert_eq!(figure("predicted"), Some(480.0));
    assert!(figure("rms").is_some_and(|rms| (0.7..1.0).contains(&rms)), "{:?}", figure("rms"));
}

#[test]
fn without_bar_and_radii_the_scale_is_lost() {
    let outcome = run("samba");
    let report = &fit(&outcome, "fit-no-scale").calibration.fit;
    assert_eq!(report.unknowns, report.rank + 1);
    let [lost] = report.null_space.as_slice() else { panic!("{:?}", report.null_space) };
    let of = |name: &str| lost.combination.iter().find(|part| part.name == name).map(|part| part.coefficient);
    let (Some(x), Some(y), Some(z)) = (of("EXX[1]"), of("EYY[1]"), of("EZZ[1]")) else { panic!("{lost:?}") };
    // X carries the table: its sign is the other one.
    assert!((x / z + 1.0).abs() < 1e-3 && (y / z - 1.0).abs() < 1e-3, "{x} {y} {z}");
    assert!(lost.separated_by.iter().any(|advice| advice.contains("calibrated length")), "{:?}", lost.separated_by);
    // Radii hold it, but less well than the bar.
    let of = |name: &str| fit(&outcome, name).calibration.get("EXX[1]").expect("estimated").standard_uncertainty;
    assert!(of("fit-without-bar") > 1.4 * of("fit"));
}

/// Heights of a cylinder's facets that are off change no uncertainty: touches are taken where they lie along the axis.
#[test]
fn wrong_heights_of_facets_on_a_cylinder_change_no_uncertainty() {
    let recipe = || Variant::of(&recipes()["cylinder-kx8"]).only(&["fit-S1"]);
    let uncertainties = |recipe: &Variant| -> Vec<(String, f64)> {
        let outcome = recipe.run();
        let estimated =
            fit(&outcome, "fit-S1").calibration.parameters.iter().filter(|own| own.status == Status::Estimated);
        estimated.map(|own| (own.name.clone(), own.standard_uncertainty)).collect()
    };
    let nominal = recipe().path("s1", "nominal");
    let right = uncertainties(&recipe());
    let (folder, mut wrong) = (crate::support::temporary(), recipe());
    // The facets 1 to 6, which are those round the cylinder.
    let moved = |row: usize, cell: &str| if row < 6 { format!("-{cell}") } else { cell.to_owned() };
    let file = crate::misread::changed(&nominal, folder.path(), "z_mm", moved);
    wrong.stage("s1")["nominal"] = serde_json::json!(file);
    let found = uncertainties(&wrong);
    assert_eq!(found.len(), right.len());
    for ((name, found), (_, right)) in found.iter().zip(&right) {
        assert!((found / right - 1.0).abs() < 0.02, "{name}: {found} {right}");
    }
}
