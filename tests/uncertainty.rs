//! The uncertainty of results: pooled repeats against the noise of the simulated data, known inputs against closed forms,
//! covariances stated in different ways, and errors about them.

use abbe_core::{Calibration, ParameterBudget, Status};
use abbe_engine::prepare;
use abbe_simulation::{Lobing, contact_directions};
use serde_json::{Value, json};

use crate::support::{Small, Variant, fit, json_file, recipes, registry, root, temporary, write};

fn repeated() -> Variant {
    Variant::of(&recipes()["tango-uncertainty"])
}

fn budget<'a>(calibration: &'a Calibration, name: &str) -> &'a ParameterBudget {
    let budget = calibration.uncertainty.as_ref().expect("an estimate has a budget");
    budget.parameters.iter().find(|parameter| parameter.name == name).unwrap_or_else(|| panic!("no budget of {name}"))
}

/// The part of a standard uncertainty that comes from the inputs whose name begins so.
fn part(budget: &ParameterBudget, input: &str) -> f64 {
    let parts = budget.contributions.iter().filter(|part| part.input.starts_with(input));
    parts.map(|part| part.standard_uncertainty.powi(2)).sum::<f64>().sqrt()
}

/// Values of every (day, cycle), and the sum of squared deviations from the mean of those with the same `by`.
fn pooled(values: &[(u64, u64, f64)], by: &str) -> (f64, usize) {
    let key = |value: &(u64, u64, f64)| if by == "day" { value.0 } else { value.1 };
    let mut groups: Vec<u64> = values.iter().map(key).collect();
    groups.sort_unstable();
    groups.dedup();
    let mut sum = 0.0;
    for group in &groups {
        let own: Vec<f64> = values.iter().filter(|value| key(value) == *group).map(|value| value.2).collect();
        let mean = own.iter().sum::<f64>() / own.len() as f64;
        sum += own.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
    }
    (sum, values.len() - groups.len())
}

#[test]
fn pooled_repeats_give_the_variances_that_were_put_in() {
    let truth = json_file(&root().join("tests/truth/tango-hu40t-repeats.json"));
    let outcome = repeated().only(&["stated", "by-cycle", "by-day"]).run();
    let cycles = truth["per_cycle"].as_array().expect("cycles");
    // 0.6 um of probing, 1.5 um of surface and the rounding of three axes to 0.1 um stand for the 1.6 um that the recipe states.
    let noise = (0.6_f64.powi(2) + 1.5_f64.powi(2) + 0.01 / 12.0) / 1.6_f64.powi(2);
    let mut worst = 0.0_f64;
    for by in ["cycle", "day"] {
        let calibration = &fit(&outcome, &format!("by-{by}")).calibration;
        for name in truth["estimated"].as_array().expect("names").iter().filter_map(Value::as_str) {
            let true_values: Vec<(u64, u64, f64)> = cycles
                .iter()
                .map(|cycle| {
                    let value = cycle["parameters"][name].as_f64().expect("a number");
                    (cycle["day"].as_u64().expect("a day"), cycle["cycle"].as_u64().expect("a cycle"), value)
                })
                .collect();
            let (squares, freedom) = pooled(&true_values, by);
            assert_eq!(freedom, if by == "cycle" { 16 } else { 15 });
            let stated = budget(&fit(&outcome, "stated").calibration, name);
            let variance = noise * part(stated, "table").powi(2) + part(stated, "bar").powi(2);
            let found = part(budget(calibration, name), &format!("table-by-{by}, bar-by-{by}")).powi(2);
            // Given what the machine really did, only the noise is a matter of chance.
            let freedom = freedom as f64;
            let expected = squares / freedom + variance;
            let deviation = (4.0 * squares * variance + 2.0 * freedom * variance * variance).sqrt() / freedom;
            worst = worst.max((found - expected).abs() / deviation);
            assert!((found - expected).abs() < 4.0 * deviation, "{name} by {by}: {found:e}, expected {expected:e}");
        }
    }
    assert!(worst > 0.5, "40 figures agree too well to be a matter of chance: {worst}");
}

#[test]
fn pooled_repeats_propagate_to_the_scatter_of_single_estimates() {
    let all = repeated().only(&["stated", "by-cycle", "by-day"]);
    let outcome = all.run();
    let names: Vec<String> =
        fit(&outcome, "stated").problem.unknowns.iter().map(|unknown| unknown.name.clone()).collect();
    let machine = |name: &&String| !name.starts_with("table.");
    let mut single: Vec<(u64, u64, Calibration)> = Vec::new();
    for day in 1..=5 {
        for cycle in 1..=4 {
            let keep = json!({ "day": [day], "cycle": [cycle] });
            let one = repeated().only(&["stated"]).set("touches", "keep", keep.clone()).set("lengths", "keep", keep);
            single.push((day, cycle, fit(&one.run(), "stated").calibration.clone()));
        }
    }
    for by in ["cycle", "day"] {
        for name in names.iter().filter(machine) {
            let values: Vec<(u64, u64, f64)> = single
                .iter()
                .map(|(day, cycle, calibration)| (*day, *cycle, calibration.get(name).expect("estimated").value))
                .collect();
            let (squares, freedom) = pooled(&values, by);
            let scatter = (squares / freedom as f64).sqrt();
            let propagated = part(budget(&fit(&outcome, &format!("by-{by}")).calibration, name), "table-by");
            assert!((propagated / scatter - 1.0).abs() < 2e-3, "{name} by {by}: {propagated:e}, {scatter:e}");
        }
    }
}

#[test]
fn a_shared_input_acts_as_its_closed_form_says() {
    let outcome = repeated().only(&["stated"]).run();
    let calibration = &fit(&outcome, "stated").calibration;
    // The bar is the only length: if it is longer by a part, everything is, so that the scale of every axis is.
    for name in ["EXX[1]", "EYY[1]", "EZZ[1]"] {
        let found = part(budget(calibration, name), "bar.reference_error");
        assert!((found / (0.4e-3 / 304.6686) - 1.0).abs() < 1e-3, "{name}: {found:e}");
    }
    // A larger stylus makes all facets lie lower by as much, and the bar tells nothing of it.
    let radius = part(budget(calibration, "table.facet[3].d"), "stylus_radius");
    assert!((radius / 0.5e-3 - 1.0).abs() < 1e-6, "{radius:e}");
    let considered = calibration.get("stylus_radius").expect("known inputs are listed");
    assert_eq!((considered.value, considered.standard_uncertainty), (3.0, 0.5e-3));
    for parameter in &calibration.uncertainty.as_ref().expect("a budget").parameters {
        let sum = parameter.contributions.iter().map(|part| part.standard_uncertainty.powi(2)).sum::<f64>().sqrt();
        assert!((sum / parameter.standard_uncertainty - 1.0).abs() < 1e-9, "{}", parameter.name);
        let told = calibration.get(&parameter.name).expect("an estimated parameter").standard_uncertainty;
        assert!((told / parameter.standard_uncertainty - 1.0).abs() < 1e-9, "{}", parameter.name);
        let expanded = parameter.expanded_uncertainty / parameter.standard_uncertainty;
        assert!((expanded - 1.959_964).abs() < 1e-5, "stated uncertainties are trusted: {expanded}");
    }
}

#[test]
fn thermal_expansion_acts_as_its_closed_form_says() {
    let expansion = json!({
        "coefficient_per_K": 11.5e-6,
        "standard_uncertainty_per_K": 1e-6,
        "temperature_degC": 22.0,
        "temperature_standard_uncertainty_K": 0.1,
    });
    let cold = repeated().only(&["stated"]).run();
    let warm = repeated().only(&["stated"]).set("bar", "expansion", expansion).run();
    let of = |outcome, name: &str| fit(outcome, "stated").calibration.get(name).expect("estimated").value;
    // The bar is longer by 23 um/m than its reference, so that the relative motions are: X carries the table.
    for (name, sign) in [("EXX[1]", -1.0), ("EYY[1]", 1.0), ("EZZ[1]", 1.0)] {
        let change = of(&warm, name) - of(&cold, name);
        assert!((change / (sign * 23e-6) - 1.0).abs() < 2e-3, "{name}: {change:e}");
        let budget = budget(&fit(&warm, "stated").calibration, name);
        assert!((part(budget, "bar.expansion_coefficient") / 2e-6 - 1.0).abs() < 2e-3, "{budget:?}");
        assert!((part(budget, "bar.temperature_error") / 1.15e-6 - 1.0).abs() < 2e-3, "{budget:?}");
    }
}

#[test]
fn lobing_of_the_probe_adds_its_share_to_trials() {
    let mut recipe = repeated().only(&["stated", "trials"]);
    recipe.0["stages"]["with"] = json!({
        "estimate": "monte-carlo", "of": "stated", "trials": 3000,
        "lobing": [{ "artefact": "table", "amplitude_um": 2.0, "lobes": 3 }],
    });
    recipe = recipe.set("trials", "trials", json!(3000));
    let outcome = recipe.run();
    let stated = fit(&outcome, "stated");
    let problem = stated.problem.with_values(&stated.problem.values_of(&stated.calibration));
    let directions = contact_directions(&problem).expect("directions");
    let answers: Vec<Vec<f64>> = [0.0, std::f64::consts::FRAC_PI_2]
        .map(|phase| {
            let lobing = Lobing { amplitude: 2e-3, lobes: 3, phase };
            let errors: Vec<f64> = directions
                .iter()
                .map(|direction| direction.map_or(0.0, |direction| lobing.pretravel_variation(direction)))
                .collect();
            stated.estimator.values(&problem.disturbed(&errors)).expect("an estimate")
        })
        .into();
    for (index, unknown) in problem.unknowns.iter().enumerate().take(20) {
        let deviation =
            |name: &str| fit(&outcome, name).calibration.get(&unknown.name).expect("estimated").standard_uncertainty;
        let value = stated.calibration.get(&unknown.name).expect("estimated").value;
        // Any phase is as likely as another: half the square of either answer.
        let share = answers.iter().map(|answer| (answer[index] - value).powi(2)).sum::<f64>() / 2.0;
        let expected = (deviation("trials").powi(2) + share).sqrt();
        // Two standard deviations from 3000 trials, each to 1.3 %.
        assert!((deviation("with") / expected - 1.0).abs() < 0.08, "{}", unknown.name);
    }
    let largest = |name: &str| fit(&outcome, name).calibration.get("EXX[b]").expect("estimated").standard_uncertainty;
    assert!(largest("with") > 1.05 * largest("trials"), "lobing has no effect on EXX[b]");
}

/// The small recipe with settings of the table's rows.
fn with(settings: &Value) -> (Small, String) {
    let small = Small::new();
    let more: String =
        settings.as_object().expect("settings").iter().map(|(key, value)| format!("{key}: {value}, ")).collect();
    let recipe =
        small.read("recipe.yaml").replace("nominal: data/facets.csv, ", &format!("nominal: data/facets.csv, {more}"));
    small.write("recipe.yaml", &recipe);
    let printed = small.abbe(&["run", "recipe.yaml"]);
    let told = if printed.status == 0 { String::new() } else { format!("{}: {}", printed.status, printed.stderr) };
    (small, told)
}

fn result(settings: &Value) -> Calibration {
    let (small, told) = with(settings);
    assert_eq!(told, "");
    Calibration::from_json(&small.read("out/recipe/fine.calibration.json")).expect("a calibration")
}

/// Largest difference of values and standard uncertainties, in standard uncertainties.
fn difference(one: &Calibration, other: &Calibration) -> f64 {
    let pairs = one.parameters.iter().chain(&one.artefacts).zip(other.parameters.iter().chain(&other.artefacts));
    pairs
        .filter(|(one, _)| one.standard_uncertainty > 0.0)
        .map(|(one, other)| {
            let value = (one.value - other.value).abs() / one.standard_uncertainty;
            value.max((one.standard_uncertainty / other.standard_uncertainty - 1.0).abs())
        })
        .fold(0.0, f64::max)
}

/// A covariance file of the small recipe's touches.
fn matrix(small: &Small, entry: impl Fn(&str, &str) -> f64) -> String {
    let touches = small.read("data/touches.csv");
    let rows: Vec<Vec<&str>> = touches.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let header: Vec<String> = rows.iter().map(|row| format!("{}_um2", row[0])).collect();
    let mut text = format!("touch,{}\n", header.join(","));
    for (index, row) in rows.iter().enumerate() {
        let line: Vec<String> = (rows.iter().enumerate())
            .map(|(other, column)| {
                let own = if index == other { 1.6 * 1.6 } else { 0.0 };
                (own + entry(row[1], column[1])).to_string()
            })
            .collect();
        text.push_str(&format!("{},{}\n", row[0], line.join(",")));
    }
    text
}

#[test]
fn the_same_covariance_stated_in_different_ways_gives_the_same_result() {
    let folder = temporary();
    let file = folder.path().join("covariance.csv");
    let small = Small::new();
    let plain = result(&json!({}));

    write(&file, &matrix(&small, |_, _| 0.0));
    let independent = result(&json!({ "uncertainty": { "covariance": file } }));
    assert!(difference(&plain, &independent) < 1e-6);
    let by = json!({ "uncertainty": { "by": "feature", "standard_um": { "3": 1.6, "4": 1.6 } } });
    assert!(difference(&plain, &result(&by)) == 0.0);
    assert!(difference(&plain, &result(&json!({ "uncertainty": { "directions_um": [1.6] } }))) == 0.0);

    write(&file, &matrix(&small, |one, other| if one == other { 9.0 } else { 0.0 }));
    let full = result(&json!({ "uncertainty": { "covariance": file } }));
    let shared = json!({ "uncertainty": { "shared": [{ "by": "feature", "standard_uncertainty_um": 3.0 }] } });
    let shared = result(&shared);
    assert!(difference(&full, &shared) < 1e-6, "{}", difference(&full, &shared));
    // What all touches of a facet share is its offset: nothing else becomes less certain, the offsets do. (Exact data leave
    // no scatter of their own, so that only stated uncertainties are compared.)
    let stated = |calibration: &Calibration, name: &str| budget(calibration, name).stated_standard_uncertainty;
    assert!((stated(&shared, "EXX[1]") / stated(&plain, "EXX[1]") - 1.0).abs() < 1e-6);
    let offset = "table.facet[5].d";
    let expected = (stated(&plain, offset).powi(2) + 3e-3_f64.powi(2)).sqrt();
    assert!((stated(&shared, offset) / expected - 1.0).abs() < 1e-6);
}

#[test]
fn uncertainties_that_are_none_are_refused() {
    let folder = temporary();
    let file = folder.path().join("covariance.csv");
    let small = Small::new();
    let touches = |change: &dyn Fn(String) -> String| {
        write(&file, &change(matrix(&small, |_, _| 0.0)));
        let (_, told) = with(&json!({ "uncertainty": { "covariance": file } }));
        told.replace(&format!("{}/", folder.path().display()), "")
    };
    let singular = matrix(&small, |one, other| if one == other { 1.0 } else { 0.0 }).replace("3.5600000000000005", "1");
    let mut messages = vec![
        touches(&|_| singular.clone()),
        touches(&|text| text.replacen("2.5600000000000005", "-2.56", 1)),
        touches(&|text| text.replacen("2.5600000000000005,0,0", "2.5600000000000005,0.5,0", 1)),
        touches(&|text| text.lines().take(40).collect::<Vec<_>>().join("\n") + "\n"),
        touches(&|text| text.replacen("2.5600000000000005", "two", 1)),
        touches(&|text| text.replacen("2_um2", "2_mm", 1)),
        touches(&|_| String::new()),
    ];
    for settings in [
        json!({ "uncertainty": { "covariance": "missing.csv" } }),
        json!({ "uncertainty": { "colum": "u" } }),
        json!({ "uncertainty": { "column": "u" } }),
        json!({ "uncertainty": { "column": "u", "directions_um": [1] } }),
        json!({ "uncertainty": { "by": "feature" } }),
        json!({ "uncertainty": { "by": "feature", "standard_um": { "99": 1.0 } } }),
        json!({ "uncertainty": { "by": "feature", "standard_um": { "3": -1.0 } } }),
        json!({ "uncertainty": { "directions_um": [1, 1, 1] } }),
        json!({ "uncertainty": { "row_covariance_um2": [[1, 2], [2, 1]] } }),
        json!({ "uncertainty": { "row_covariance_um2": [[1, 0], [0, 1]] } }),
        json!({ "uncertainty": { "shared": [{ "by": "grup", "standard_uncertainty_um": 1 }] } }),
        json!({ "uncertainty": { "shared": [{ "by": "group", "standard_uncertainty_um": 0 }] } }),
        json!({ "pooled": { "by": "cycle" } }),
        json!({ "repeats": "touches" }),
    ] {
        messages.push(with(&settings).1);
    }
    // Every touch is its own day: nothing was repeated.
    let days = |text: &str, rows_a_day: usize| {
        let mut lines = text.lines().enumerate();
        let header = format!("{},day\n", lines.next().expect("a header").1);
        header + &lines.map(|(line, text)| format!("{text},{}\n", line / rows_a_day)).collect::<String>()
    };
    for (rows_a_day, by) in [(usize::MAX, "day"), (21, "day"), (usize::MAX, "cycle")] {
        let small = Small::new();
        small.write("data/touches.csv", &days(&small.read("data/touches.csv"), rows_a_day));
        let nominal = "nominal: data/facets.csv,";
        let recipe = small.read("recipe.yaml").replace(nominal, &format!("{nominal} pooled: {{ by: {by} }},"));
        small.write("recipe.yaml", &recipe);
        let printed = small.abbe(&["run", "recipe.yaml"]);
        messages.push(format!("{}: {}", printed.status, printed.stderr));
    }
    insta::assert_snapshot!(messages.join("\n"));
}

/// The positioner with settings of the target's rows: its calibration, or the message.
fn of_poses(uncertainty: &Value) -> Result<Calibration, String> {
    let recipe =
        Variant::of(&recipes()["positioner"]).only(&["lines"]).set("target", "uncertainty", uncertainty.clone());
    let folder = temporary();
    let printed = crate::support::abbe(folder.path(), &["run", recipe.write(folder.path()).to_str().expect("UTF-8")]);
    if printed.status != 0 {
        return Err(printed.stderr);
    }
    let text = std::fs::read_to_string(folder.path().join("out/recipe/lines.calibration.json")).expect("a calibration");
    Ok(Calibration::from_json(&text).expect("a calibration"))
}

#[test]
fn angles_of_poses_are_stated_apart_from_their_lengths() {
    // The recipe states 20 um and 50 urad.
    let plain = of_poses(&json!({})).expect("a fit");
    let diagonal = |variance: f64| json!([[variance, 0, 0], [0, variance, 0], [0, 0, variance]]);
    for same in [
        json!({ "directions_um": [20, 20, 20] }),
        json!({ "directions_urad": [50, 50, 50] }),
        json!({ "directions_um": [20, 20, 20], "directions_urad": [50, 50, 50] }),
        json!({ "row_covariance_um2": diagonal(400.0), "row_covariance_urad2": diagonal(2500.0) }),
    ] {
        let found = of_poses(&same).expect("a fit");
        assert!(difference(&plain, &found) < 1e-6, "{same}: {}", difference(&plain, &found));
    }
    // Ten times as many µrad leave the axes to the positions, which hardly tell the angle between them.
    let stated = |calibration: &Calibration| budget(calibration, "EB0C").stated_standard_uncertainty;
    let blunt = of_poses(&json!({ "directions_urad": [500, 500, 500] })).expect("a fit");
    assert!(stated(&blunt) > 1.1 * stated(&plain), "{:e} {:e}", stated(&blunt), stated(&plain));
    let shared = json!({ "shared": [{ "by": "pose", "standard_uncertainty_urad": 50 }] });
    let twice = json!({ "directions_urad": vec![50.0 * 2.0_f64.sqrt(); 3] });
    let (shared, twice) = (of_poses(&shared), of_poses(&twice));
    match (shared, twice) {
        (Ok(shared), Ok(twice)) => assert!(difference(&shared, &twice) < 1e-6),
        (shared, twice) => panic!("{:?} {:?}", shared.err(), twice.err()),
    }
    for (settings, expected) in [
        (
            json!({ "directions_um": [20, 20, 20, 50, 50, 50] }),
            "`directions_um` is for 6 lengths, but a row of this artefact has 3 equations that are lengths",
        ),
        (
            json!({ "row_covariance_um2": [[400]] }),
            "`row_covariance_um2` is for 1 lengths, but a row of this artefact has 3",
        ),
        (
            json!({ "shared": [{ "by": "pose" }] }),
            "`standard_uncertainty_um` or `standard_uncertainty_urad` was expected",
        ),
        (json!({ "column": "qw" }), "the column `qw` holds neither lengths nor angles"),
    ] {
        let told = of_poses(&settings).expect_err("an error");
        assert!(told.contains(expected), "{told}");
    }
    let (_, told) = with(&json!({ "uncertainty": { "by": "feature", "standard_urad": { "3": 5.0 } } }));
    assert!(told.contains("`standard_urad` states angles, but no equation of this artefact is one"), "{told}");
    let (_, told) = with(&json!({ "uncertainty": { "shared": [{ "by": "group", "standard_uncertainty_urad": 5 }] } }));
    assert!(told.contains("`shared` states angles, but no equation of this artefact is one"), "{told}");
    let (_, told) = with(&json!({ "uncertainty": { "row_covariance_um2": [[-1]] } }));
    assert!(told.contains("the variance -1 in row 1"), "{told}");
}

#[test]
fn centres_that_are_fitted_first_hang_on_the_stylus_as_touches_do() {
    let radius = json!(5.0);
    let mut recipe = Variant::of(&recipes()["samba"]).only(&["fit", "fit-centres"]);
    for balls in ["balls", "centres"] {
        recipe = recipe.set(balls, "stylus_radius_standard_uncertainty_um", radius.clone());
    }
    recipe.0["stages"]["trials"] = json!({ "estimate": "monte-carlo", "of": "fit-centres", "trials": 2000 });
    let outcome = recipe.run();
    let centres = &fit(&outcome, "fit-centres").calibration;
    // Four touches on the equator and one on the pole: a larger stylus puts every centre lower by as much, as a longer tool does.
    let by_stylus = part(budget(centres, "dzt"), "stylus_radius");
    assert!((by_stylus / 5e-3 - 1.0).abs() < 0.1, "{by_stylus:e}");
    let trials = fit(&outcome, "trials").calibration.get("dzt").expect("estimated").standard_uncertainty;
    let stated = budget(centres, "dzt").standard_uncertainty;
    // 2000 trials: a standard deviation of 1.6 %.
    assert!((trials / stated - 1.0).abs() < 0.07, "{trials:e} by trials, {stated:e} by propagation");
}

#[test]
fn no_degrees_of_freedom_are_told() {
    let small = |trust: &str| {
        let small = Small::new();
        small.write("z.csv", "feature,X_mm,Y_mm,Z_mm\n1,3.01,0,100\n2,0,3.02,100\n3,0,0,103.01\n");
        small.write("zf.csv", "feature,x_mm,y_mm,z_mm,nx,ny,nz\n1,0,0,0,1,0,0\n2,0,0,0,0,1,0\n3,0,0,0,0,0,1\n");
        small.write(
            "z.yaml",
            &format!(
                "abbe: 1\nname: z\nstages:\n  t: {{ ingest: csv, path: z.csv }}\n  \
                 f: {{ artefact: facets, from: t, nominal: zf.csv, standard_uncertainty_um: 1 }}\n  \
                 m: {{ model: serial-chain, chain: \"w b X Y Z t\", tool_length_mm: 100, stylus_radius_mm: 3 }}\n  \
                 fit: {{ estimate: gauss-newton, machine: m, observations: f, parameters: [dxt, dyt, dzt]{trust} }}\n"
            ),
        );
        small
    };
    let scattered = small("");
    let run = scattered.abbe(&["run", "z.yaml"]);
    assert_eq!(run.status, 1);
    assert!(run.stderr.contains("no degrees of freedom (3 equations for 3 unknowns)"), "{}", run.stderr);
    assert!(run.stderr.contains("trust_uncertainties: true"), "{}", run.stderr);
    let check = scattered.abbe(&["check", "z.yaml"]);
    assert_eq!(check.status, 0, "{}", check.stderr);
    assert!(check.stdout.contains("fit: no degrees of freedom are left"), "{}", check.stdout);
    let trusted = small(", trust_uncertainties: true");
    let run = trusted.abbe(&["run", "z.yaml"]);
    assert_eq!(run.status, 0, "{}", run.stderr);
    assert!(!trusted.abbe(&["check", "z.yaml"]).stdout.contains("no degrees of freedom"));
    let calibration = Calibration::from_json(&trusted.read("out/z/fit.calibration.json")).expect("a calibration");
    assert!((calibration.get("dxt").expect("estimated").standard_uncertainty / 1e-3 - 1.0).abs() < 1e-9);
}

/// A scale at 25 degrees whose coefficient of expansion is known to 1e-6 / K: what that does to its error is the fivefold, and it is
/// undone where the scale is at 25 degrees again.
#[test]
fn what_is_known_of_the_expansion_of_a_scale_counts() {
    let folder = temporary();
    let file = |name: &str, temperature: f64| {
        let rows = (1..=20).map(|step| {
            let x = 20.0 * f64::from(step);
            format!("0,{x},{temperature},{:.9}\n", x * (1.0 + 3e-5 + 11.5e-6 * (temperature - 20.0)))
        });
        write(&folder.path().join(name), &format!("X1_mm,X2_mm,T_X_degC,reference_mm\n{}", rows.collect::<String>()));
    };
    file("warm.csv", 25.0);
    file("cold.csv", 20.0);
    let estimate = |of: &str, parameter: &str, known: Option<&str>| {
        let mut stage = json!({ "estimate": "gauss-newton", "machine": "machine", "observations": of,
            "parameters": [parameter], "trust_uncertainties": true });
        if let Some(known) = known {
            stage["known"] = json!(known);
            // Only how the known value counts is looked at.
            stage["shared_rows"] = json!("accepted");
        }
        stage
    };
    let length = |of: &str| json!({ "artefact": "length", "from": of, "standard_uncertainty_um": 0.1 });
    let recipe = Variant(json!({ "abbe": 1, "name": "A warm scale", "stages": {
        "warm-rows": { "ingest": "csv", "path": "warm.csv" },
        "cold-rows": { "ingest": "csv", "path": "cold.csv" },
        "warm": length("warm-rows"),
        "cold": length("cold-rows"),
        "machine": { "model": "serial-chain", "chain": "w b X t", "tool_length_mm": 100, "stylus_radius_mm": 0, "errors": [
            { "polynomial": ["EXX"], "degrees": [1, 2] },
            { "expansion": ["EXX"], "temperature": "T_X", "coefficient_per_K": 11.5e-6, "standard_uncertainty_per_K": 1e-6 },
        ] },
        "fit": estimate("warm", "EXX[1]", None),
        "again-warm": estimate("warm", "EXX[2]", Some("fit")),
        "then-cold": estimate("cold", "EXX[2]", Some("fit")),
        "free": estimate("warm", "EXX[expansion]", None),
    } }));
    let path = recipe.write(folder.path());
    let outcome = prepare(&path, &registry())
        .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()))
        .expect("a result");
    let of = |stage: &str, name: &str| fit(&outcome, stage).calibration.get(name).expect("a parameter").clone();
    let scale = of("fit", "EXX[1]");
    assert!((scale.value - 3e-5).abs() < 1e-11, "{scale:?}");
    // 0.1 um over a root sum of squares of 1071 mm beside 5 K of 1e-6 / K.
    let expected = ((1e-4_f64 / 1071.4).powi(2) + 5e-6_f64.powi(2)).sqrt();
    assert!((scale.standard_uncertainty / expected - 1.0).abs() < 1e-3, "{scale:?}");
    let known = of("fit", "EXX[expansion]");
    assert_eq!((known.value, known.standard_uncertainty, known.status), (11.5e-6, 1e-6, Status::Considered));
    let of_expansion = part(budget(&fit(&outcome, "fit").calibration, "EXX[1]"), "EXX[expansion]");
    assert!((of_expansion / 5e-6 - 1.0).abs() < 1e-9, "{of_expansion:e}");
    let [warm, cold] = ["again-warm", "then-cold"].map(|stage| of(stage, "EXX[2]").standard_uncertainty);
    assert!(cold > 10.0 * warm, "{warm:e} {cold:e}");
    assert_eq!(of("free", "EXX[expansion]").status, Status::Estimated);
}
