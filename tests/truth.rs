//! The TANGO test against the values that it was simulated with. Estimates never see them.

use std::collections::BTreeSet;
use std::sync::OnceLock;

use abbe_core::{Calibration, Estimated, Status};
use abbe_engine::Outcome;
use serde_json::{Value, json};

use crate::support::{Small, Variant, effect, fit, json_file, list, root, values};

/// What the data of `pipelines/data/tango-hu40t/<data>` were simulated with.
fn truth(data: &str) -> Value {
    json_file(&root().join(format!("tests/truth/tango-hu40t-{data}.json")))
}

/// The recipe as it stands in the repository, run once for all tests.
fn outcome(data: &str) -> &'static Outcome {
    static EXACT: OnceLock<Outcome> = OnceLock::new();
    static REALISTIC: OnceLock<Outcome> = OnceLock::new();
    let once = if data == "exact" { &EXACT } else { &REALISTIC };
    once.get_or_init(|| Variant::tango(data).run())
}

/// Every value of a calibration that the truth knows, with its true value. The balls are not: the bar has a length only.
fn with_truth<'a>(calibration: &'a Calibration, truth: &Value) -> Vec<(&'a Estimated, f64)> {
    let known = truth["parameters"].as_object().expect("parameters");
    let mut found = Vec::new();
    for (name, value) in known.iter().filter(|(name, _)| !name.starts_with("ball[")) {
        let name = if name.starts_with("facet[") { format!("table.{name}") } else { name.clone() };
        let estimated = calibration.get(&name).unwrap_or_else(|| panic!("{name} is missing"));
        found.push((estimated, value.as_f64().expect("a number")));
    }
    assert!(found.len() > 100, "the truth has {} values only", found.len());
    found
}

#[test]
fn exact_data_give_the_truth_back() {
    // Effects at the end of the travel: mm, rad.
    for (estimate, length, angle) in [("fit-S4r", 1e-8, 1e-10), ("fit-S4", 1e-6, 1e-8)] {
        let calibration = &fit(outcome("exact"), estimate).calibration;
        for (estimated, truth) in with_truth(calibration, &truth("exact")) {
            let (is_angle, factor) = effect(&estimated.unit);
            let off = (estimated.value - truth).abs() * factor;
            let allowed = if is_angle { angle } else { length };
            assert!(off <= allowed, "{estimate}: {} is off by {off:e}", estimated.name);
        }
    }
}

#[test]
fn noisy_data_give_the_truth_back_within_the_stated_uncertainty() {
    let truth = truth("realistic");
    for estimate in ["fit-S4r", "fit-S4"] {
        let calibration = &fit(outcome("realistic"), estimate).calibration;
        let mut errors: Vec<(String, f64)> = Vec::new();
        for (estimated, truth) in with_truth(calibration, &truth) {
            let normalised = match (estimated.name.as_str(), estimated.status) {
                ("dzt", _) => {
                    let (value, uncertainty) = at_time_zero(calibration);
                    (value - truth) / uncertainty
                }
                (_, Status::Estimated) => (estimated.value - truth) / estimated.standard_uncertainty,
                (name, status) => {
                    assert!(truth == 0.0, "{estimate} leaves out {name} ({status:?}), which is {truth}");
                    continue;
                }
            };
            errors.push((estimated.name.clone(), normalised));
        }
        let estimated = values(calibration).filter(|estimated| estimated.status == Status::Estimated).count();
        // All unknowns but the four terms of the drift, which the truth has in another form.
        assert_eq!(errors.len() + 4, estimated, "{estimate}");
        for (name, error) in &errors {
            assert!(error.abs() < 4.0, "{estimate}: {name} is {error} standard uncertainties off");
        }
        let rms = (errors.iter().map(|(_, error)| error * error).sum::<f64>() / errors.len() as f64).sqrt();
        assert!((0.6..1.4).contains(&rms), "{estimate}: RMS of the normalised errors {rms}");
    }
}

/// `dzt` before the machine drifted, and its standard uncertainty.
fn at_time_zero(calibration: &Calibration) -> (f64, f64) {
    let errors = calibration.model.settings["errors"].as_array().expect("errors");
    let drift = errors.iter().find(|family| family.get("drift").is_some()).expect("a drift");
    let time = |index: usize| drift["time_s"][""][index].as_f64().expect("a time");
    let t = 2.0 * (0.0 - time(0)) / (time(1) - time(0)) - 1.0;
    let legendre = [t, (3.0 * t.powi(2) - 1.0) / 2.0, (5.0 * t.powi(3) - 3.0 * t) / 2.0, {
        (35.0 * t.powi(4) - 30.0 * t.powi(2) + 3.0) / 8.0
    }];
    let names = ["dzt", "dzt[t1]", "dzt[t2]", "dzt[t3]", "dzt[t4]"];
    let weights: Vec<f64> = [1.0].into_iter().chain(legendre).collect();
    let of = |name: &str| calibration.get(name).expect("a term of the drift").value;
    let place = |name: &str| calibration.covariance.order.iter().position(|other| other == name).expect("estimated");
    let value = names.iter().zip(&weights).map(|(name, weight)| weight * of(name)).sum();
    let mut variance = 0.0;
    for (one, a) in names.iter().zip(&weights) {
        for (other, b) in names.iter().zip(&weights) {
            variance += a * b * calibration.covariance.rows[place(one)][place(other)];
        }
    }
    (value, variance.sqrt())
}

#[test]
fn the_four_gross_touches_are_found_and_no_others() {
    let truth = truth("realistic");
    let gross = truth["noise"]["outliers"].as_object().expect("outliers");
    let expected: BTreeSet<usize> = gross.keys().map(|touch| touch.parse().expect("a number")).collect();
    assert_eq!(expected.len(), 4);
    for estimate in ["fit-S3", "fit-S4r", "fit-S4"] {
        let outliers = &fit(outcome("realistic"), estimate).calibration.outliers;
        // Touches are numbered as the rows of their file.
        let found: BTreeSet<usize> = outliers.iter().map(|outlier| outlier.row).collect();
        assert_eq!((found, outliers.len()), (expected.clone(), 4), "{estimate}");
        for outlier in outliers {
            assert_eq!((outlier.stage.as_str(), outlier.line), ("table", outlier.row + 1));
            let extra = gross[&outlier.row.to_string()].as_f64().expect("a distance") * 1e3;
            assert!((outlier.residual_um - extra).abs() < 8.0, "{estimate}: {outlier:?}, in truth {extra} µm");
        }
    }
}

#[test]
fn without_drift_terms_residuals_follow_time() {
    let remarks = |outcome: &Outcome| {
        let judged = outcome.verdicts.iter().find(|verdict| verdict.stage == "residuals").expect("a verdict");
        let about: Vec<String> = judged.remarks.iter().filter(|text| text.contains("follow time")).cloned().collect();
        about
    };
    let mut without = Variant::tango("realistic").only(&["fit-S4r", "residuals"]);
    let patterns = without.stage("fit-S4r")["parameters"].as_array_mut().expect("parameters");
    patterns.retain(|pattern| pattern != "dzt[t?]");
    let errors = without.stage("hu40t")["errors"].as_array_mut().expect("errors");
    errors.retain(|family| family.get("drift").is_none());
    let said = remarks(&without.run());
    let [said] = said.as_slice() else { panic!("{said:?}") };
    assert!(said.contains("fit-S4r") && said.contains("dzt"), "{said}");

    let told: Vec<String> = remarks(outcome("realistic"));
    for estimate in ["fit-S3", "fit-S4r", "fit-S4"] {
        assert!(told.iter().all(|said| !said.contains(&format!("{estimate} follow"))), "{told:?}");
    }
}

/// The exact recipe with all equations weighing the same, as the data's table of condition numbers has it.
fn equal_weights() -> Variant {
    let fits = ["fit-S1", "fit-S2", "fit-S3", "fit-S4r", "fit-S4"];
    Variant::tango("exact").only(&fits).set("bar", "standard_uncertainty_um", json!(1.6))
}

#[test]
fn rank_and_condition_are_those_of_the_data() {
    /// The digits that the data's table prints.
    fn printed(condition: f64) -> String {
        match condition {
            small if small < 10.0 => format!("{small:.1}"),
            large if large >= 1e4 => format!("{large:.1e}"),
            medium => format!("{medium:.0}"),
        }
    }
    let left_out = json!({ "feature": [1, 2], "group": [5, 8, 10, 16, 19] });
    let cases = [
        (equal_weights(), [(29, "4.2"), (32, "62"), (46, "78"), (102, "286"), (115, "1.0e5")]),
        (
            equal_weights().set("touches", "ignore", left_out),
            [(29, "4.1"), (32, "57"), (46, "72"), (102, "304"), (115, "1.4e5")],
        ),
    ];
    for (recipe, expected) in cases {
        let outcome = recipe.run();
        for (fit, (rank, condition)) in outcome.fits.iter().zip(expected) {
            let found = &fit.calibration.fit;
            assert_eq!((found.unknowns, found.rank), (rank, rank), "{}", fit.name);
            assert_eq!(printed(found.condition), condition, "{}: {}", fit.name, found.condition);
        }
    }
}

/// The recipe without what holds the scale.
fn without_bar(fits: &[&str]) -> Variant {
    let mut recipe = Variant::tango("exact").only(fits);
    for fit in fits {
        recipe.stage(fit)["observations"] = list(&["table"]);
    }
    recipe
}

#[test]
fn without_the_bar_scale_is_lost_and_named() {
    let fits = ["fit-S2", "fit-S3", "fit-S4r"];
    let recipe = without_bar(&fits);
    let small = Small::new();
    recipe.write(small.folder.path());

    let checked = small.abbe(&["check", "recipe.yaml", "--json"]);
    assert_eq!(checked.status, 1, "{}", checked.stderr);
    let checked: Value = serde_json::from_str(&checked.stdout).expect("JSON");
    let facets = facets(&recipe);
    let planned = checked["estimates"].as_array().expect("estimates");
    assert_eq!(planned.len(), fits.len());
    for planned in planned {
        let name = planned["estimate"].as_str().expect("a name");
        let found = &planned["planned"];
        assert_eq!(found["rank"].as_u64().map(|rank| rank + 1), found["unknowns"].as_u64(), "{name}");
        let [vector] = found["null_space"].as_array().expect("directions").as_slice() else { panic!("{found}") };
        let parts: Vec<(&str, f64)> = (vector["combination"].as_array().expect("parts").iter())
            .map(|part| (part["name"].as_str().expect("a name"), part["coefficient"].as_f64().expect("a number")))
            .collect();
        let scale = parts.iter().find(|(name, _)| *name == "EXX[1]").expect("EXX[1]").1;
        let mut expected = vec![("EXX[1]", -1.0), ("EYY[1]", 1.0), ("EZZ[1]", 1.0), ("dzt", -326.674)];
        expected.extend(facets.iter().map(|(name, change)| (name.as_str(), *change)));
        for (part, change) in &expected {
            let found = parts.iter().find(|(name, _)| name == part).unwrap_or_else(|| panic!("{name}: no {part}")).1;
            let found = found / -scale;
            assert!((found - change).abs() < 1e-6 * change.abs().max(1.0), "{name}: {part} {found}, not {change}");
        }
        for (part, _) in parts {
            assert!(expected.iter().any(|(name, _)| *name == part), "{name}: {part} has nothing to do with it");
        }
    }

    let run = small.abbe(&["run", "recipe.yaml", "--out", "out"]);
    assert_eq!((run.status, run.stdout.as_str()), (1, ""));
    for part in ["EXX[1]", "EYY[1]", "EZZ[1]", "dzt"] {
        assert!(run.stderr.contains(part), "{part} is missing: {}", run.stderr);
    }
    assert!(!small.path("out/recipe").exists());
}

/// How every facet's offset changes with the scale: n . P + r.
fn facets(recipe: &Variant) -> Vec<(String, f64)> {
    let text = crate::support::read(&recipe.path("table", "nominal"));
    let rows = text.lines().skip(1).map(|line| {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |index: usize| cells[index].parse::<f64>().expect("a number");
        let along: f64 = (1..=3).map(|k| number(k) * number(k + 3)).sum();
        (format!("table.facet[{}].d", cells[0]), along + 3.0)
    });
    rows.collect()
}

#[test]
fn what_is_confounded_can_be_dropped_or_taken_at_its_smallest() {
    let with_bar = &fit(outcome("exact"), "fit-S3").calibration.fit;
    let rms = |choice: &str| {
        let outcome = without_bar(&["fit-S3"]).set("fit-S3", "on_confounded", json!(choice)).run();
        let calibration = &fit(&outcome, "fit-S3").calibration;
        assert_eq!(calibration.fit.rank, with_bar.rank - 1, "{choice}");
        assert_eq!(calibration.fit.null_space.len(), 1, "{choice}");
        let marked: Vec<&str> = values(calibration)
            .filter(|estimated| estimated.status == Status::Confounded)
            .map(|estimated| estimated.name.as_str())
            .collect();
        // Three gains, the tool length, every facet: all of them share the lost direction.
        assert_eq!(marked.len(), 4 + 26, "{choice}: {marked:?}");
        let left: Vec<&&str> =
            marked.iter().filter(|name| !calibration.covariance.order.iter().any(|other| other == *name)).collect();
        let start: Vec<f64> = left.iter().filter_map(|name| Some(calibration.get(name)?.value)).collect();
        assert_eq!(
            start,
            if choice == "drop" { vec![0.0] } else { Vec::new() },
            "{choice}: {left:?} left at the start"
        );
        let lost: Vec<&str> = calibration.fit.null_space[0].combination.iter().map(|part| part.name.as_str()).collect();
        assert!(marked.iter().all(|name| lost.contains(name)), "{choice}: {marked:?} of {lost:?}");
        calibration.fit.residual_rms_um
    };
    let (dropped, smallest) = (rms("drop"), rms("minimum-norm"));
    assert!((dropped - smallest).abs() < 1e-3 * smallest, "{dropped} µm, {smallest} µm");
}

#[test]
fn unexplained_errors_fall_from_subset_to_subset() {
    for data in ["exact", "realistic"] {
        let outcome = outcome(data);
        let figure = |stage: &str, name: &str, estimate: &str| {
            let verdict = outcome.verdicts.iter().find(|verdict| verdict.stage == stage).expect("a verdict");
            let of = |figure: &&abbe_core::Figure| figure.name == name && figure.of.as_deref() == Some(estimate);
            let found = verdict.figures.iter().find(of).and_then(|figure| figure.value);
            found.unwrap_or_else(|| panic!("{stage} has no {name} of {estimate}"))
        };
        // Explained touches, held-out ones, the artefact, tips, tips of held-out indexations (Tables 4-6 to 4-9); the factor
        // by which the step from S3 to S4r has to reduce them.
        let cases = [
            ("residuals", "rms", 1.5),
            ("unseen", "rms", 1.2),
            ("artefact", "max absolute", 1.2),
            ("tips", "rms", 1.2),
            ("unseen-tips", "rms", 1.2),
        ];
        for (stage, name, last) in cases {
            let [s2, s3, s4r] = ["fit-S2", "fit-S3", "fit-S4r"].map(|estimate| figure(stage, name, estimate));
            assert!(s3 < s2 / 4.0, "{data} {stage}: {s2} to {s3} µm");
            assert!(s4r < s3 / last, "{data} {stage}: {s3} to {s4r} µm");
        }
    }
}
