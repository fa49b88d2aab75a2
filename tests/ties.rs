//! Tied parameters: a fit with ties is the fit with the substitution made by hand, and what follows from it.

use abbe_core::{Calibration, Fit, Poses, Problem};
use abbe_engine::prepare_text;
use nalgebra::{DMatrix, DVector};
use serde_json::{Value, json};

use crate::support::{as_typed, registry, temporary, write};

const CHAINS: [&str; 6] =
    ["w b X Y Z t", "w b Z Y X t", "w C' b X Y Z t", "w C' A' b Y X Z t", "w B b Z X Y t", "w X Y b Z C A t"];

const ERRORS: &str = "[{ location: [EC0X, EC0Y] }, { polynomial: [EXX, EYY, EZZ, EYX, EXY], degrees: [1] }]";

/// A recipe of a random machine that a tracker sees, with `more` keys of its estimate and further stages.
fn recipe(chain: &str, estimate: &str, more: &str) -> String {
    format!(
        "abbe: 1\nname: t\nstages:\n  poses: {{ ingest: csv, path: poses.csv }}\n  tracker: {{ artefact: positions, from: poses, standard_uncertainty_um: 2 }}\n  machine:\n    model: serial-chain\n    chain: \"{chain}\"\n    tool_length_mm: 120\n    stylus_radius_mm: 0\n    errors: {ERRORS}\n  fit: {{ estimate: gauss-newton, machine: machine, observations: tracker, {estimate} }}\n{more}"
    )
}

/// What a tracker sees of a machine with these errors, with noise of some mm.
fn poses(chain: &str, truth: &[(&str, f64)], noise: f64, seed: u64) -> String {
    let text = recipe(chain, "parameters: [\"E*\"]", "").split("  fit:").next().expect("a recipe").to_owned();
    let text = text
        .lines()
        .filter(|line| !line.contains("poses.csv") && !line.contains("tracker:"))
        .fold(String::new(), |text, line| text + line + "\n");
    let prepared =
        prepare_text(std::path::Path::new("t.yaml"), &text, &registry()).unwrap_or_else(|error| panic!("{error}"));
    let model = prepared.described().expect("a machine").remove(0).model;
    let info = model.info();
    let mut values = info.nominal.clone();
    for (name, value) in truth {
        values[info.parameter(name).unwrap_or_else(|| panic!("{name}"))] = *value;
    }
    let mut random = crate::controls::law::uniform(seed);
    let is_rotary = |axis: &abbe_core::Axis| axis.kind == abbe_core::AxisKind::Rotary;
    let mut text = info
        .axes
        .iter()
        .map(|axis| format!("{}_{}", axis.name, if is_rotary(axis) { "deg" } else { "mm" }))
        .collect::<Vec<_>>()
        .join(",");
    text.push_str(",x_mm,y_mm,z_mm\n");
    for _ in 0..60 {
        let mut status = vec![0.0; info.status.len()];
        let mut cells = Vec::new();
        for axis in &info.axes {
            let command = (random() - 0.5) * if is_rotary(axis) { 160.0 } else { 600.0 };
            status[axis.status] = if is_rotary(axis) { command.to_radians() } else { command };
            cells.push(command.to_string());
        }
        let mut found = Poses::default();
        model.poses(&status, &values, &[], false, &mut found).expect("a pose");
        // A sum of uniform numbers is nearly normal.
        let noise = |random: &mut dyn FnMut() -> f64| noise * ((0..12).map(|_| random()).sum::<f64>() - 6.0);
        cells.extend(found.positions[0].iter().map(|part| (part + noise(&mut random)).to_string()));
        text.push_str(&(cells.join(",") + "\n"));
    }
    text
}

fn run(chain: &str, data: &str, estimate: &str, more: &str) -> Result<Vec<Fit>, String> {
    let folder = temporary();
    write(&folder.path().join("poses.csv"), data);
    let file = folder.path().join("t.yaml");
    write(&file, &recipe(chain, estimate, more));
    let prepared = abbe_engine::prepare(&file, &registry()).map_err(|error| error.to_string())?;
    let outcome = prepared.run(&abbe_core::Monitor::default()).map_err(|error| error.to_string())?;
    match outcome.failures.first() {
        Some(failure) => Err(failure.error.to_string()),
        None => Ok(outcome.fits),
    }
}

/// The fit of that name.
fn named<'a>(fits: &'a [Fit], name: &str) -> &'a Fit {
    fits.iter().find(|fit| fit.name == name).unwrap_or_else(|| panic!("there is no {name}"))
}

/// Why a recipe is refused.
fn refused(chain: &str, data: &str, estimate: &str) -> String {
    run(chain, data, estimate, "").err().unwrap_or_else(|| panic!("{estimate}: it is not refused"))
}

const TIES: &str =
    "tie: { \"EXX[1]\": scale, \"EYY[1]\": { to: scale, factor: -0.5 }, \"EYX[1]\": shear, \"EXY[1]\": shear }";

/// The fit with the substitution made by hand: the derivatives of the machine without ties, times the matrix of the ties.
fn by_hand(of: &Fit) -> (DVector<f64>, DMatrix<f64>) {
    let tied = &of.problem;
    let names = ["EXX[1]", "EYY[1]", "EYX[1]", "EXY[1]", "EZZ[1]", "tracker.*"].map(str::to_owned);
    let free =
        Problem::new("free", &tied.model_plugin, tied.model.clone(), tied.sets.clone(), &names).expect("a problem");
    let unknowns: Vec<&str> = tied.unknowns.iter().map(|unknown| unknown.name.as_str()).collect();
    let ties = DMatrix::from_fn(free.unknowns.len(), unknowns.len(), |row, column| {
        match (free.unknowns[row].name.as_str(), unknowns[column]) {
            ("EXX[1]", "scale") | ("EYX[1]" | "EXY[1]", "shear") => 1.0,
            ("EYY[1]", "scale") => -0.5,
            (one, other) if one == other => 1.0,
            _ => 0.0,
        }
    });
    let mut x = DVector::from_vec(tied.start());
    let mut covariance = DMatrix::zeros(0, 0);
    for _ in 0..8 {
        let (mut residuals, mut rows) = (Vec::new(), Vec::new());
        let at = &ties * &x;
        free.linearise(at.as_slice(), |block| {
            residuals.extend_from_slice(block.residuals);
            rows.extend_from_slice(block.jacobian);
        })
        .expect("derivatives");
        let residuals = DVector::from_vec(residuals);
        let jacobian = DMatrix::from_row_slice(residuals.len(), free.unknowns.len(), &rows) * &ties;
        let scale: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
        let scaled =
            DMatrix::from_fn(jacobian.nrows(), jacobian.ncols(), |row, column| jacobian[(row, column)] / scale[column]);
        let inverse = (scaled.transpose() * &scaled).try_inverse().expect("full rank");
        let step = &inverse * scaled.transpose() * &residuals;
        let s2 = residuals.norm_squared() / (jacobian.nrows() - jacobian.ncols()) as f64;
        covariance = DMatrix::from_fn(step.len(), step.len(), |row, column| {
            s2 * inverse[(row, column)] / (scale[row] * scale[column])
        });
        x -= DVector::from_fn(step.len(), |row, _| step[row] / scale[row]);
    }
    (x, covariance)
}

#[test]
fn a_tied_fit_is_the_fit_with_the_substitution_by_hand() {
    for seed in 1..=18u64 {
        let chain = CHAINS[seed as usize % CHAINS.len()];
        let mut random = crate::controls::law::uniform(seed);
        let (scale, shear) = ((random() - 0.5) * 4e-4, (random() - 0.5) * 3e-4);
        let truth =
            [("EXX[1]", scale), ("EYY[1]", -0.5 * scale), ("EYX[1]", shear), ("EXY[1]", shear), ("EZZ[1]", 1e-4)];
        let data = poses(chain, &truth, 2e-3, seed);
        let estimate = format!("parameters: [scale, shear, \"EZZ[1]\", \"tracker.*\"], {TIES}");
        let fits = run(chain, &data, &estimate, "").unwrap_or_else(|error| panic!("{chain}: {error}"));
        let found = named(&fits, "fit");
        let (x, covariance) = by_hand(found);
        let result = &found.calibration;
        for (row, unknown) in found.problem.unknowns.iter().enumerate() {
            let own = result.get(&unknown.name).unwrap_or_else(|| panic!("{chain}: {}", unknown.name));
            let u = covariance[(row, row)].sqrt();
            assert!(
                (own.value - x[row]).abs() < 1e-5 * u,
                "{chain}: {} is {} and not {}",
                unknown.name,
                own.value,
                x[row]
            );
            assert!(
                (own.standard_uncertainty / u - 1.0).abs() < 1e-4,
                "{chain}: {}: {} and not {u}",
                unknown.name,
                own.standard_uncertainty
            );
        }
        members_follow(result);
        for (name, expected) in truth {
            let own = result.get(name).expect("a member");
            assert!(
                (own.value - expected).abs() < 5.0 * own.standard_uncertainty,
                "{chain}, seed {seed}: {name} is {own:?}"
            );
        }
    }
}

/// Members have value, uncertainty and covariance of the unknown times their factor.
fn members_follow(result: &Calibration) {
    let get = |name: &str| result.get(name).unwrap_or_else(|| panic!("{name}"));
    for (member, of, factor) in [("EXX[1]", "scale", 1.0), ("EYY[1]", "scale", -0.5), ("EYX[1]", "shear", 1.0)] {
        assert_eq!(get(member).value, factor * get(of).value, "{member}");
        assert!((get(member).standard_uncertainty - f64::abs(factor) * get(of).standard_uncertainty).abs() < 1e-18);
        let correlation = result.covariance.correlation(member, of).expect("both are there");
        assert!((correlation - f64::signum(factor)).abs() < 1e-9, "{member}: {correlation}");
        let cross = result.covariance.correlation(member, "EZZ[1]").expect("both are there");
        assert!(
            (cross - f64::signum(factor) * result.covariance.correlation(of, "EZZ[1]").expect("there")).abs() < 1e-9
        );
    }
    assert_eq!(result.covariance.order.len(), result.covariance.rows.len());
}

/// Mirrored shears are a turn, which is the tracker's: with that tie the data cannot tell it, though they tell each of them alone.
#[test]
fn what_ties_confound_is_judged_again() {
    let data = poses(CHAINS[0], &[("EXX[1]", 1e-4)], 0.0, 5);
    let estimate = |tie: &str| {
        format!(
            "parameters: [shear, \"tracker.*\"], trust_uncertainties: true, tie: {{ \"EYX[1]\": shear, \"EXY[1]\": {tie} }}"
        )
    };
    assert!(run(CHAINS[0], &data, &estimate("shear"), "").is_ok());
    let told = refused(CHAINS[0], &data, &estimate("{ to: shear, factor: -1 }"));
    assert!(told.contains("shear") && told.contains("tracker"), "{told}");
}

#[test]
fn selection_and_monte_carlo_take_tied_unknowns() {
    let truth = [("EXX[1]", 2e-4), ("EYY[1]", -1e-4)];
    let data = poses(CHAINS[2], &truth, 2e-3, 9);
    let estimate = format!(
        "parameters: [scale, shear, \"EZZ[1]\", \"tracker.*\"], {TIES}, select: {{ candidates: [scale, shear, \"EZZ[1]\"] }}"
    );
    let fits = run(CHAINS[2], &data, &estimate, "").unwrap_or_else(|error| panic!("{error}"));
    let found = named(&fits, "fit");
    assert_eq!(found.calibration.fit.selection.as_ref().expect("a selection").kept, ["scale"]);
    let estimate = format!("parameters: [scale, shear, \"EZZ[1]\", \"tracker.*\"], {TIES}");
    let more = "  trials: { estimate: monte-carlo, of: fit, trials: 2000, seed: 3, coverage_probability: 0.95 }\n";
    let fits = run(CHAINS[2], &data, &estimate, more).unwrap_or_else(|error| panic!("{error}"));
    let (found, trials) = (named(&fits, "fit"), &named(&fits, "trials").calibration);
    members_follow(trials);
    let ratio = trials.get("scale").expect("scale").standard_uncertainty
        / found.calibration.get("scale").expect("scale").standard_uncertainty;
    assert!((ratio - 1.0).abs() < 0.2, "{ratio}");
}

/// A truth names the tied unknown; the simulated data give it back. An unknown may have the name of a member.
#[test]
fn a_virtual_machine_takes_tied_truths() {
    let folder = temporary();
    let chain = CHAINS[3];
    write(&folder.path().join("poses.csv"), &poses(chain, &[], 0.0, 4));
    let estimate = "parameters: [\"EXX[1]\", \"tracker.*\"], trust_uncertainties: true, tie: { \"EYY[1]\": { to: \"EXX[1]\", factor: -1 } }";
    write(&folder.path().join("t.yaml"), &recipe(chain, estimate, ""));
    let printed = as_typed(folder.path(), &["check", "t.yaml"]);
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    // The unknown alone is in the truth.
    let estimate_of_scale = "parameters: [scale, \"tracker.*\"], trust_uncertainties: true, tie: { \"EXX[1]\": scale, \"EYY[1]\": { to: scale, factor: -1 } }";
    write(&folder.path().join("s.yaml"), &recipe(chain, estimate_of_scale, ""));
    write(&folder.path().join("scale.json"), &json!({ "parameters": { "scale": 1.5e-4 } }).to_string());
    let printed =
        as_typed(folder.path(), &["simulate", "s.yaml", "--truth", "scale.json", "--seed", "1", "--out", "virtual"]);
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    let simulated = crate::support::read(&folder.path().join("virtual/poses.csv"));
    let fits = run(chain, &simulated, estimate_of_scale, "").unwrap_or_else(|error| panic!("{error}"));
    let scale = named(&fits, "fit").calibration.get("scale").expect("scale").value;
    assert!((scale - 1.5e-4).abs() < 1e-11, "{scale}");
    let data = poses(chain, &[("EXX[1]", 1.5e-4), ("EYY[1]", -1.5e-4)], 0.0, 4);
    let fits = run(chain, &data, estimate, "").unwrap_or_else(|error| panic!("{error}"));
    let found = named(&fits, "fit");
    assert!((found.calibration.get("EXX[1]").expect("there").value - 1.5e-4).abs() < 1e-12);
    assert!((found.calibration.get("EYY[1]").expect("there").value + 1.5e-4).abs() < 1e-12);
    let saved: Value = serde_json::to_value(&found.calibration).expect("JSON");
    assert_eq!(saved["parameters"].as_array().expect("a list").iter().filter(|own| own["name"] == "EXX[1]").count(), 1);
}

/// The plan of a recipe whose estimate is this, for some rows.
fn plan(chain: &str, data: &str, estimate: &str, required: &[String]) -> abbe_engine::Measurements {
    let folder = temporary();
    write(&folder.path().join("poses.csv"), data);
    let plan = json!({ "estimate": "fit", "candidates": "tracker", "number": 15, "restarts": 3, "required": required });
    let text = recipe(chain, estimate, "") + &format!("plan: {plan}\n");
    let file = folder.path().join("t.yaml");
    write(&file, &text);
    let prepared = abbe_engine::prepare(&file, &registry()).unwrap_or_else(|error| panic!("{error}"));
    prepared.plan().unwrap_or_else(|error| panic!("{error}"))
}

/// A plan for tied unknowns has the covariance that the same rows give without ties and with the substitution by hand.
#[test]
fn a_plan_takes_tied_unknowns() {
    for seed in 1..=4 {
        let chain = CHAINS[seed as usize % CHAINS.len()];
        let data = poses(chain, &[], 0.0, seed);
        let tie = "tie: { \"EXX[1]\": scale, \"EYY[1]\": { to: scale, factor: -0.5 } }";
        let tied = format!("parameters: [scale, \"EZZ[1]\", \"tracker.*\"], trust_uncertainties: true, {tie}");
        let found = plan(chain, &data, &tied, &[]);
        let chosen: Vec<String> = found.plan.chosen.iter().map(|chosen| chosen.label.clone()).collect();
        assert_eq!(chosen.len(), 15, "{chain}");
        let free = "parameters: [\"EXX[1]\", \"EYY[1]\", \"EZZ[1]\", \"tracker.*\"], trust_uncertainties: true";
        let free = plan(chain, &data, free, &chosen);
        let names = |found: &abbe_engine::Measurements| -> Vec<String> {
            found.plan.problem.unknowns.iter().map(|unknown| unknown.name.clone()).collect()
        };
        let (of_tied, of_free) = (names(&found), names(&free));
        assert!(of_tied.contains(&"scale".to_owned()) && !of_tied.contains(&"EXX[1]".to_owned()), "{of_tied:?}");
        let ties = DMatrix::from_fn(of_free.len(), of_tied.len(), |row, column| {
            match (of_free[row].as_str(), of_tied[column].as_str()) {
                ("EXX[1]", "scale") => 1.0,
                ("EYY[1]", "scale") => -0.5,
                (one, other) => f64::from(one == other),
            }
        });
        let covariance = |found: &abbe_engine::Measurements, count: usize| {
            DMatrix::from_row_slice(count, count, &found.plan.figures.covariance)
        };
        let scaled = |matrix: DMatrix<f64>| {
            // Lengths, angles and scales together: in units of their own uncertainty.
            let size: Vec<f64> = matrix.diagonal().iter().map(|part| part.sqrt()).collect();
            (
                DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |row, column| {
                    matrix[(row, column)] / (size[row] * size[column])
                }),
                size,
            )
        };
        let (normal, size) = scaled(covariance(&free, of_free.len()));
        let information = normal.try_inverse().expect("full rank");
        let information = DMatrix::from_fn(size.len(), size.len(), |row, column| {
            information[(row, column)] / (size[row] * size[column])
        });
        let by_hand = ties.transpose() * information * &ties;
        let (normal, size) = scaled(by_hand);
        let by_hand = normal.try_inverse().expect("full rank");
        let stated = covariance(&found, of_tied.len());
        for row in 0..size.len() {
            let expected = by_hand[(row, row)] / size[row].powi(2);
            let ratio = stated[(row, row)] / expected;
            assert!((ratio - 1.0).abs() < 1e-6, "{chain}, {}: {ratio}", of_tied[row]);
        }
    }
}

#[test]
fn ties_that_make_no_sense_are_refused_with_their_place() {
    let data = poses(CHAINS[0], &[], 0.0, 1);
    let told_of = |tie: &str| {
        let estimate = format!("parameters: [\"tracker.*\"], tie: {{ {tie} }}");
        refused(CHAINS[0], &data, &estimate)
    };
    for (tie, message) in [
        ("\"EXX[2]\": scale, \"EYY[1]\": scale", "`EXX[2]` matches no parameter of the machine"),
        ("\"EXX[1]\": scale", "nothing else is tied to `scale`"),
        ("\"EXX[1]\": scale, \"EC0X\": scale", "they cannot be one number"),
        ("\"EXX[1]\": a, \"EYY[1]\": a, \"E??[1]\": b", "is tied to `a` already"),
        ("\"EXX[1]\": { to: s, factor: 0 }, \"EYY[1]\": s", "a finite factor that is not 0"),
        ("\"EXX[1]\": [s]", "the name of the unknown was expected"),
        ("\"tracker.observer.x\": s, \"EXX[1]\": s", "belongs to its observations"),
        ("\"EXX[1]\": tracker.observer.x, \"EYY[1]\": tracker.observer.x", "belongs to its observations"),
        ("\"EXX[1]\": { to: s, facto: 2 }", "unknown key `facto`"),
        ("\"EXX[1]\": \"*\"", "the name of one unknown was expected"),
        ("\"E??[1]\": { to: \"EXX[1]\", factor: -1 }", "would be -1 times itself"),
    ] {
        let told = told_of(tie);
        assert!(told.contains(message) && told.contains("t.yaml:"), "{tie}: {told}");
    }
}
