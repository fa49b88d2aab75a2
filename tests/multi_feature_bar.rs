//! Multi-feature bar and datum sphere (Viprey et al. 2019) against the values that the data were simulated with and the figures
//! of an independent evaluation. Estimates never see them.

use std::sync::OnceLock;

use abbe_core::{Calibration, Status, Verdict};
use abbe_engine::Outcome;
use serde_json::{Value, json};

use crate::support::{Variant, fit, json_file, recipes, root, values};

fn truth(data: &str) -> Value {
    json_file(&root().join(format!("tests/truth/mfb-ucp710-{data}.json")))["parameters"].clone()
}

fn recipe(data: &str) -> Variant {
    Variant::of(&recipes()[if data == "exact" { "mfb-ucp710-exact" } else { "mfb-ucp710" }])
}

/// The recipe as it stands in the repository, run once for all tests.
fn outcome(data: &str) -> &'static Outcome {
    static EXACT: OnceLock<Outcome> = OnceLock::new();
    static REALISTIC: OnceLock<Outcome> = OnceLock::new();
    let once = if data == "exact" { &EXACT } else { &REALISTIC };
    once.get_or_init(|| recipe(data).run())
}

/// Every estimated value that the truth knows: name, unit, error, standard uncertainty.
fn errors(calibration: &Calibration, truth: &Value) -> Vec<(String, String, f64, f64)> {
    let estimated = values(calibration).filter(|estimated| estimated.status == Status::Estimated);
    let found = estimated.filter_map(|estimated| {
        let own = estimated.name.strip_prefix("bar.").unwrap_or(&estimated.name);
        let error = estimated.value - truth[own].as_f64()?;
        Some((estimated.name.clone(), estimated.unit.clone(), error, estimated.standard_uncertainty))
    });
    found.collect()
}

fn verdict<'a>(outcome: &'a Outcome, stage: &str) -> &'a Verdict {
    outcome.verdicts.iter().find(|verdict| verdict.stage == stage).unwrap_or_else(|| panic!("no verdict {stage}"))
}

fn figure(outcome: &Outcome, stage: &str, name: &str) -> f64 {
    let found = verdict(outcome, stage).figures.iter().find(|figure| figure.name == name);
    found.and_then(|figure| figure.value).unwrap_or_else(|| panic!("no figure {name} of {stage}"))
}

#[test]
fn exact_data_give_the_truth_back() {
    let (outcome, truth) = (outcome("exact"), truth("exact"));
    for (name, count) in [("fit-bar", 220), ("fit-sphere", 14), ("fit-sphere-known", 14)] {
        let errors = errors(&fit(outcome, name).calibration, &truth);
        // Squarenesses are those of the bar and of the sphere alike: the truth has one value.
        assert_eq!(errors.len(), count, "{name}");
        for (parameter, unit, error, _) in errors {
            // 1e-5 um and 1e-4 urad.
            let allowed = if unit == "rad" { 1e-10 } else { 1e-8 };
            assert!(error.abs() <= allowed, "{name}: {parameter} is off by {error:e} {unit}");
        }
    }
}

#[test]
fn noisy_data_give_the_truth_back_within_the_stated_uncertainty() {
    let (outcome, truth) = (outcome("realistic"), truth("realistic"));
    for (name, count) in [("fit-bar", 220), ("fit-sphere-known", 14), ("fit-sphere-drift", 14)] {
        let errors = errors(&fit(outcome, name).calibration, &truth);
        assert_eq!(errors.len(), count, "{name}");
        for (parameter, _, error, uncertainty) in &errors {
            let off = error.abs() / uncertainty;
            assert!(off < 4.0, "{name}: {parameter} is off by {off} standard uncertainties");
        }
        let mean_square =
            errors.iter().map(|(_, _, error, uncertainty)| (error / uncertainty).powi(2)).sum::<f64>() / count as f64;
        assert!((0.25..4.0).contains(&mean_square), "{name}: uncertainties do not fit errors, {mean_square}");
    }
}

#[test]
fn rank_and_condition_are_those_of_the_data() {
    for (data, condition) in [("exact", 146.437_685), ("realistic", 146.435_021)] {
        let report = &fit(outcome(data), "fit-bar").calibration.fit;
        assert_eq!((report.observations, report.unknowns, report.rank), (394, 220, 220), "{data}");
        assert!((report.condition / condition - 1.0).abs() < 1e-3, "{data}: {}", report.condition);
    }
    let rms = fit(outcome("realistic"), "fit-bar").calibration.fit.residual_rms_um;
    assert!((rms - 0.235_894).abs() < 1e-5, "{rms}");
}

/// What each part of the design is for: slopes of roll come from the second measurement of a positioning, squarenesses from
/// the diagonals.
#[test]
fn parts_of_the_design_that_are_left_out_are_missed() {
    let all = ["@motion", "@squareness", "stylus[2].*", "bar.bar[*].x", "bar.bar[*].y", "bar.bar[*].z"];
    let tilts = ["bar.bar[*].b", "bar.bar[*].c"];
    let complete = [&all[..], &tilts].concat();
    let without_stylus: Vec<&str> = complete.iter().copied().filter(|name| !name.starts_with("stylus")).collect();
    let cases = [
        (json!({ "measurement": [2, 5, 7] }), json!(without_stylus), 217, 196),
        (json!({ "positioning": [6, 7, 8] }), json!(complete), 205, 191),
    ];
    for (ignored, parameters, unknowns, rank) in cases {
        let variant = recipe("exact")
            .only(&["fit-bar"])
            .set("bar-runs", "ignore", ignored.clone())
            .set("fit-bar", "parameters", parameters)
            .set("fit-bar", "on_confounded", json!("minimum-norm"));
        let outcome = variant.run();
        let report = &fit(&outcome, "fit-bar").calibration.fit;
        assert_eq!((report.unknowns, report.rank), (unknowns, rank), "{ignored}");
    }
}

#[test]
fn the_minimal_set_is_that_of_table_1_with_a_reason_for_every_other_one() {
    for data in ["exact", "realistic"] {
        let outcome = outcome(data);
        let figures = ["candidates", "rank", "left out"].map(|name| figure(outcome, "selection", name));
        assert_eq!(figures, [31.0, 14.0, 17.0], "{data}");
        let condition = figure(outcome, "selection", "condition");
        assert!((condition - 5.619_472_611_19).abs() < 1e-3, "{data}: {condition}");
        let told: Vec<&str> = verdict(outcome, "selection")
            .remarks
            .iter()
            .map(|remark| remark.strip_prefix("fit-sphere: ").expect("the fit's name comes first"))
            .collect();
        assert_eq!(
            told,
            [
                "kept are dxt dyt dzt dxw dyw dzw EC0Y EA0Z EB0Z EB0A EC0A EY0C EA0C EB0C",
                "no effect: dat dbt dct",
                "EY0A = -dyt",
                "EZ0A = -dzt",
                "EX0C = -dxt",
                "EX0X = dxt",
                "EB0X = -EB0A",
                "EC0X = -EC0A",
                "EY0Y = dyt",
                "EA0Y = -EA0C",
                "EZ0Z = dzt",
                "EA0A = EA0C",
                "EC0C = -96 dxw + 148 dyw",
                "daw = -104 dyw + 96 dzw",
                "dbw = 104 dxw - 148 dzw",
                "dcw = -96 dxw + 148 dyw",
            ],
            "{data}"
        );
    }
}

/// Whoever prefers others gets others; their number stays.
#[test]
fn preferred_parameters_are_kept_instead() {
    let variant = recipe("exact").only(&["fit-bar", "fit-sphere", "selection"]).set(
        "selection",
        "prefer",
        json!(["EA0Y", "E?0X", "d?w"]),
    );
    let outcome = variant.run();
    assert_eq!(figure(&outcome, "selection", "rank"), 14.0);
    let remarks = &verdict(&outcome, "selection").remarks;
    let kept: Vec<&str> = remarks[0].rsplit_once("are ").expect("names").1.split(' ').collect();
    for name in ["EA0Y", "EX0X", "EB0X", "EC0X", "dxw", "dyw", "dzw"] {
        assert!(kept.contains(&name), "{name}: {kept:?}");
    }
    for name in ["EA0C", "EA0A", "dxt", "EB0A", "EC0A", "daw", "dbw", "dcw"] {
        assert!(!kept.contains(&name), "{name}: {kept:?}");
    }
    assert!(remarks.iter().any(|remark| remark.ends_with("EB0A = -EB0X")), "{remarks:?}");
}

#[test]
fn bias_and_residue_are_those_of_the_independent_evaluation() {
    let outcome = outcome("realistic");
    let cases = [
        ("bias", "bias mean", 117.26),
        ("bias", "bias max", 174.44),
        ("bias", "residue mean", 11.08),
        ("bias", "residue max", 31.37),
        ("bias-known", "compensated mean", 28.19),
        ("bias-known", "compensated max", 45.86),
        ("bias-known", "residue mean", 8.02),
        ("bias-known", "residue max", 13.64),
    ];
    for (stage, name, expected) in cases {
        let found = figure(outcome, stage, name);
        assert!((found - expected).abs() < 0.006, "{name} of {stage}: {found}, {expected} was expected");
    }
    // The independent evaluation takes the drift as straight between repetitions, the recipe as a parabola over the series.
    let drift = |name| figure(outcome, "bias-drift", name);
    assert!((drift("residue mean") - 8.01).abs() < 0.1, "{}", drift("residue mean"));
    assert!((drift("remaining bias mean") - 118.09).abs() < 0.5, "{}", drift("remaining bias mean"));
    assert!((drift("characterised") - 93.2).abs() < 0.1, "{}", drift("characterised"));
}

/// Without what is known of the motion errors they pass for location errors: uncertainties are then far too small.
#[test]
fn motion_errors_that_are_left_in_spoil_the_location_errors() {
    let (outcome, truth) = (outcome("realistic"), truth("realistic"));
    let worst = errors(&fit(outcome, "fit-sphere").calibration, &truth)
        .into_iter()
        .map(|(_, _, error, uncertainty)| error.abs() / uncertainty)
        .fold(0.0, f64::max);
    assert!(worst > 4.0, "{worst}");
    // What the bar does not know for certain counts in the known fit.
    let known = fit(outcome, "fit-sphere-known").calibration.parameters.iter();
    let considered = known.filter(|known| known.status == Status::Considered && known.name.starts_with('E'));
    assert_eq!(considered.count(), 174);
}
