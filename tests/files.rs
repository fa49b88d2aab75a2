//! The files of a run: their schemas, and that a calibration can be read without other files.

use abbe_core::{Calibration, EstimateSource, Kind, KinematicModel as _, Poses, Problem, Quantities, Quantity};
use abbe_engine::{model_of, prepare};
use serde_json::{Value, json};

use crate::plugins::valid;
use crate::support::{Small, json_file, read, recipes_without_twins, registry, root, temporary};

fn schema(name: &str) -> Value {
    json_file(&root().join(format!("docs/schemas/{name}.schema.json")))
}

#[test]
fn results_are_as_their_schemas_say_and_calibrations_stand_on_their_own() {
    for (recipe, file) in recipes_without_twins() {
        let prepared = prepare(&file, &registry()).unwrap_or_else(|error| panic!("{error}"));
        let outcome = prepared.run(&abbe_core::Monitor::default()).unwrap_or_else(|error| panic!("{error}"));
        let out = temporary();
        let folder = outcome.write(out.path()).unwrap_or_else(|error| panic!("{error}"));
        valid(&recipe, &schema("verdicts"), &json_file(&folder.join("verdicts.json")));
        valid(&recipe, &schema("run"), &json_file(&folder.join("run.json")));
        let estimates = prepared.recipe.stages.iter().any(|stage| stage.kind == Kind::Estimate);
        assert_eq!(!outcome.fits.is_empty(), estimates, "{recipe} has no estimate");
        for fit in &outcome.fits {
            let what = format!("{recipe}: {}", fit.name);
            let file = folder.join(format!("{}.calibration.json", fit.name));
            valid(&what, &schema("calibration"), &json_file(&file));
            let read = Calibration::from_json(&read(&file)).unwrap_or_else(|error| panic!("{what}: {error}"));
            assert!(read == fit.calibration, "{what} is read as something else than what was written");

            if registry()
                .find(Kind::Estimate, &read.model.plugin)
                .is_ok_and(|plugin| plugin.estimate_source == EstimateSource::Readings)
            {
                // It was made of readings that are no geometry: it has quantities, and neither machine nor poses.
                let quantities = Quantities::of(&read).unwrap_or_else(|error| panic!("{what}: {error}"));
                assert_eq!(quantities.info().parameters, fit.problem.model.info().parameters, "{what}");
                continue;
            }
            let model = model_of(&read, &registry()).unwrap_or_else(|error| panic!("{what}: {error}"));
            assert_eq!(model.info().parameters, fit.problem.model.info().parameters, "{what}");
            // As text, because a status that is unknown without its column is NaN.
            assert_eq!(
                format!("{:?}", model.info().status),
                format!("{:?}", fit.problem.model.info().status),
                "{what}"
            );
            let values: Vec<f64> = read.parameters.iter().map(|parameter| parameter.value).collect();
            for set in &fit.problem.sets {
                let table = &set.observations.info().layout.poses;
                let statuses: Vec<f64> = table.indices().flat_map(|pose| table.row(pose).to_vec()).collect();
                let tips = |model: &dyn abbe_core::KinematicModel| {
                    let mut poses = Poses::default();
                    let evaluated = model.poses(&statuses, &values, &[], true, &mut poses);
                    evaluated.unwrap_or_else(|error| panic!("{what}: {error}"));
                    assert_eq!(poses.positions.len(), table.len());
                    poses
                };
                assert!(tips(model.as_ref()) == tips(fit.problem.model.as_ref()), "{what}: {} differs", set.name);
            }
            let rebuilt = Problem { model, ..Problem::clone(&fit.problem) };
            let residuals = rebuilt.residuals(&rebuilt.values_of(&read)).unwrap_or_else(|error| panic!("{error}"));
            let outliers: Vec<usize> = read.outliers.iter().map(|outlier| outlier.line).collect();
            let kept: Vec<(Quantity, f64)> = (residuals.iter().zip(rebuilt.quantities()).zip(rebuilt.equation_rows()))
                .filter(|(_, (set, row))| {
                    let origin = rebuilt.origin(*set, *row).map(|(_, origin)| origin.line);
                    let blamed = read.outliers.iter().any(|outlier| outlier.stage == rebuilt.sets[*set].name);
                    !(blamed && origin.is_some_and(|line| outliers.contains(&line)))
                })
                .map(|((residual, quantity), _)| (quantity, *residual))
                .collect();
            assert_eq!(kept.len(), read.fit.observations, "{what}");
            let rms = |of: Quantity| {
                let of = kept.iter().filter(|(quantity, _)| *quantity == of);
                let squares: Vec<f64> = of.map(|(_, residual)| residual * residual).collect();
                (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
            };
            // Where only angles are observed, lengths are told as zero.
            let told = Some(read.fit.residual_rms_um).filter(|told| *told > 0.0);
            let lengths = (rms(Quantity::Length) * 1e3, told);
            let angles = (rms(Quantity::Angle) * 1e6, read.fit.residual_rms_urad);
            for (rms, told) in [lengths, angles] {
                assert_eq!(rms.is_nan(), told.is_none(), "{what}");
                let told = told.unwrap_or_default();
                assert!(
                    rms.is_nan() || (rms - told).abs() <= 1e-12 + 1e-9 * told,
                    "{what}: {rms}, the file says {told}"
                );
            }
        }
    }
}

/// A calibration of one parameter and one artefact.
fn small() -> Value {
    let estimated = |name: &str| json!({ "name": name, "value": 0.1, "unit": "mm", "standard_uncertainty": 0.01, "status": "estimated" });
    json!({
        "abbe_calibration": 1,
        "estimate": "fit",
        "model": {
            "plugin": "serial-chain",
            "settings": { "chain": "w b Z t", "tool_length_mm": 100.0, "stylus_radius_mm": 3.0 },
        },
        "parameters": [estimated("dzt")],
        "artefacts": [estimated("table.facet[1].d")],
        "covariance": { "order": ["dzt", "table.facet[1].d"], "rows": [[1e-4, 0.0], [0.0, 1e-4]] },
        "outliers": [],
        "fit": {
            "observations": 3, "unknowns": 2, "rank": 2, "condition": 1.0, "degrees_of_freedom": 1, "sigma": 1.0,
            "iterations": 2, "termination": "converged",
            "residual_max_um": 1.0, "residual_mean_abs_um": 1.0, "residual_rms_um": 1.0, "null_space": [],
        },
    })
}

/// A budget of one parameter with the coverage factor 2.
fn budget(name: &str, standard: f64, expanded: f64) -> Value {
    json!({
        "coverage_probability": 0.95, "scale": 1.0, "correlations": [],
        "joint": { "quantities": 1, "ellipsoid_factor": 2.0, "rectangle_factor": 2.0 },
        "parameters": [{
            "name": name, "unit": "mm", "standard_uncertainty": standard, "stated_standard_uncertainty": standard,
            "degrees_of_freedom": 10.0, "coverage_factor": 2.0, "expanded_uncertainty": expanded, "contributions": [],
        }],
    })
}

#[test]
fn broken_calibrations_are_refused_with_a_reason() {
    let text = |change: fn(&mut Value)| {
        let mut calibration = small();
        change(&mut calibration);
        calibration.to_string()
    };
    assert!(Calibration::from_json(&text(|_| {})).is_ok());
    assert!(Calibration::from_json(&text(|it| it["uncertainty"] = budget("dzt", 0.01, 0.02))).is_ok());
    valid("the small calibration", &schema("calibration"), &small());
    let cases: Vec<(&str, String)> = vec![
        ("not_json", "abbe".to_owned()),
        ("half_a_file", small().to_string().split_at(200).0.to_owned()),
        ("another_json", "[1, 2]".to_owned()),
        ("no_format", text(|it| drop(it.as_object_mut().expect("a map").remove("abbe_calibration")))),
        ("later_format", text(|it| it["abbe_calibration"] = json!(2))),
        ("no_covariance", text(|it| drop(it.as_object_mut().expect("a map").remove("covariance")))),
        ("no_value", text(|it| drop(it["parameters"][0].as_object_mut().expect("a map").remove("value")))),
        ("nan", small().to_string().replacen("0.1,", "NaN,", 1)),
        ("null_value", text(|it| it["parameters"][0]["value"] = Value::Null)),
        ("text_value", text(|it| it["parameters"][0]["value"] = json!("0.1"))),
        ("negative_uncertainty", text(|it| it["artefacts"][0]["standard_uncertainty"] = json!(-0.01))),
        ("unknown_unit", text(|it| it["parameters"][0]["unit"] = json!("furlong"))),
        ("unknown_status", text(|it| it["parameters"][0]["status"] = json!("guessed"))),
        ("covariance_too_small", text(|it| it["covariance"]["rows"] = json!([[1e-4]]))),
        ("names_twice_in_the_covariance", text(|it| it["covariance"]["order"] = json!(["dzt", "dzt"]))),
        ("negative_variance", text(|it| it["covariance"]["rows"] = json!([[-1e-4, 0.0], [0.0, 1e-4]]))),
        ("covariance_too_large", text(|it| it["covariance"]["rows"] = json!([[1e-4, 2e-4], [2e-4, 1e-4]]))),
        ("another_uncertainty", text(|it| it["parameters"][0]["standard_uncertainty"] = json!(0.02))),
        ("budget_of_nothing", text(|it| it["uncertainty"] = budget("EXX[1]", 0.01, 0.02))),
        ("budget_of_another_uncertainty", text(|it| it["uncertainty"] = budget("dzt", 0.02, 0.04))),
        ("negative_expanded_uncertainty", text(|it| it["uncertainty"] = budget("dzt", 0.01, -0.02))),
        ("not_in_the_covariance", text(|it| it["covariance"] = json!({ "order": [], "rows": [] }))),
        ("covariance_not_square", text(|it| it["covariance"]["rows"] = json!([[1e-4, 0.0], [0.0]]))),
    ];
    let mut said = String::new();
    for (case, text) in &cases {
        match Calibration::from_json(text) {
            Err(error) => said.push_str(&format!("{case}: {error}\n")),
            Ok(_) => said.push_str(&format!("{case}: TAKEN\n")),
        }
    }
    insta::assert_snapshot!("broken_calibrations", said);
    assert!(!said.contains("TAKEN"), "{said}");
}

#[test]
fn a_calibration_of_a_model_that_cannot_be_built_is_refused() {
    let cases: [fn(&mut Value); 3] = [
        |it| it["model"]["plugin"] = json!("serial-chian"),
        |it| it["model"]["settings"]["chain"] = json!("w Z t"),
        |it| it["model"]["settings"]["tool_length_mm"] = json!("long"),
    ];
    let mut said = String::new();
    for change in cases {
        let mut calibration = small();
        change(&mut calibration);
        let calibration = Calibration::from_json(&calibration.to_string()).unwrap_or_else(|error| panic!("{error}"));
        match model_of(&calibration, &registry()) {
            Err(error) => said.push_str(&format!("{error}\n")),
            Ok(_) => panic!("{:?} was built", calibration.model),
        }
    }
    insta::assert_snapshot!("models_that_cannot_be_built", said);
}

/// Files that are no measurements are bounded before anything of them is read.
#[test]
fn an_endless_statement_is_refused_at_once() {
    let small = Small::new();
    let stated = "  stated: { estimate: stated, machine: machine, path: stated.csv }\n";
    small.write("recipe.yaml", &(small.read("recipe.yaml") + stated));
    let file = std::fs::File::create(small.path("stated.csv")).expect("a file");
    file.set_len(40 << 30).expect("a file with a hole");
    let printed = small.abbe(&["run", "recipe.yaml", "--out", "out"]);
    assert_eq!(printed.status, 2, "{}", printed.stderr);
    assert!(
        printed.stderr.contains("40 GiB; 4 at most") && printed.stderr.contains("recipe.yaml:"),
        "{}",
        printed.stderr
    );
}
