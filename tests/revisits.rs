//! When references are measured again, against simulated machines that move as it was said.

use abbe_core::{Fit, PoseIndex, Problem, RowIndex, StatusRole};
use abbe_engine::{Measurements, Revisit, prepare};
use abbe_numerics::Generator;
use abbe_simulation::{Noise, StandardDeviation, Truth, measure};
use serde_json::{Value, json};

use crate::controls::law::seeds;
use crate::support::{Variant, abbe, fit, recipes, registry, temporary};

/// A TANGO test on a machine that warms up, with the plan of its touches.
fn recipe(order: &Value) -> Variant {
    let mut recipe = Variant::of(&recipes()["tango-warming"]).only(&["fit"]);
    recipe.stage("fit")["trust_uncertainties"] = json!(true);
    recipe.stage("fit")["parameters"] =
        json!(["@geometry", "dzt[t1]", "dzt[t2]", "EA0B[T_column:1]", "EXX[1*T_scale]", "table.*"]);
    recipe.0["plan"] = json!({ "estimate": "fit", "candidates": "table", "by": "group", "number": 15, "restarts": 1,
        "parameters": ["E*"], "order": order });
    recipe
}

fn planned(recipe: &Variant) -> Result<Measurements, String> {
    let folder = temporary();
    let told = |error: abbe_core::Error| format!("{error}\n{}", error.help.clone().unwrap_or_default());
    prepare(&recipe.write(folder.path()), &registry()).and_then(|prepared| prepared.plan()).map_err(told)
}

/// The problem of the touches of one group alone, at a time.
fn at(fit: &Fit, group: &str, time: f64) -> Problem {
    let column = fit.problem.model.info().status_index(&StatusRole::Time).expect("a time");
    let mut problem = fit.problem.as_ref().clone();
    problem.sets.retain(|set| set.name == "table");
    let set = &mut problem.sets[abbe_core::SetIndex(0)];
    let layout = &set.info().layout;
    let labels = layout.data.labels("group").expect("groups");
    let rows: Vec<RowIndex> = (set.rows.iter().copied())
        .filter(|row| layout.rows[*row].data_row.is_some_and(|row| labels[row] == group))
        .collect();
    set.rows = rows;
    let mut poses = set.poses().clone();
    let indices: Vec<PoseIndex> = poses.indices().collect();
    indices.into_iter().for_each(|pose| poses.row_mut(pose)[column] = time);
    set.set_poses(poses);
    problem
}

/// What the touches of a group read on a machine with these values at a time, mm: contact is met where the true machine meets it, and
/// the machine of `fit` says what that means.
fn readings(fit: &Fit, group: &str, time: f64, truth: &Truth) -> Vec<f64> {
    let measured = measure(&at(fit, group, time), truth, 1).unwrap_or_else(|error| panic!("{error}"));
    measured.residuals(&measured.start()).unwrap_or_else(|error| panic!("{error}"))
}

fn moved(fit: &Fit, revisit: &Revisit, truth: &Truth) -> Vec<Vec<f64>> {
    let all: Vec<Vec<f64>> = revisit.times.iter().map(|time| readings(fit, &revisit.reference, *time, truth)).collect();
    let between = |pair: &[Vec<f64>]| pair[0].iter().zip(&pair[1]).map(|(before, after)| after - before).collect();
    all.windows(2).map(between).collect()
}

/// The root mean square of what moves between two visits, of the touch that moves most, over what was wanted.
fn beside(wanted: f64, all: &[Vec<Vec<f64>>]) -> Vec<f64> {
    let visits = all[0].len();
    let of_visit = |visit: usize| {
        let touches = all[0][visit].len();
        let of =
            |touch: usize| (all.iter().map(|trial| trial[visit][touch].powi(2)).sum::<f64>() / all.len() as f64).sqrt();
        (0..touches).map(of).fold(0.0, f64::max) / wanted
    };
    (0..visits).map(of_visit).collect()
}

/// Drifts and thermal states of random size, on random references and from random beginnings: between two visits as much moves as was
/// wanted, and no more.
#[test]
fn what_was_declared_moves_by_what_was_wanted_between_two_visits() {
    let outcome = Variant::of(&recipes()["tango-warming"]).only(&["fit"]).run();
    let fit = fit(&outcome, "fit");
    let mut all = Vec::new();
    for seed in seeds(6) {
        let mut random = Generator::new(31, seed);
        let mut size = |most: f64| most * (0.3 + 0.7 * (random.index(1000) as f64 / 1e3));
        let changes = [("dzt[t1]", size(20e-3)), ("EA0B[T_column:1]", size(10e-6)), ("EXX[1*T_scale]", size(10e-6))];
        let (wanted, start) = (1.5 + size(3.0), (size(2500.0)).round());
        let reference = 1 + seed % 9;
        let stated = changes.map(|(name, u)| json!({ "parameters": [name], "standard_uncertainty": u }));
        let order = json!({ "duration_s": 16, "references": [reference], "start_s": start, "again":
            { "standard_uncertainty_um": wanted, "until_s": 9900, "changes": stated } });
        let found = planned(&recipe(&order)).unwrap_or_else(|error| panic!("{error}"));
        let revisit = &found.plan.order.as_ref().expect("an order").revisits[0];
        assert_eq!((revisit.times[0], revisit.until), (start, 9900.0));
        assert!(revisit.largest <= wanted * 1e-3);
        if revisit.times.len() < 2 {
            continue;
        }
        let trials: Vec<Vec<Vec<f64>>> = (0..200)
            .map(|trial| {
                let mut random = Generator::new(32 + seed, trial);
                let parameters = changes.iter().map(|(name, u)| ((*name).to_owned(), u * random.normal()));
                let shape = ("time_constant[1]_s".to_owned(), 1000.0);
                let parameters = parameters.chain([shape]).collect();
                moved(fit, revisit, &Truth { parameters, noise: Noise::default() })
            })
            .collect();
        let found = beside(wanted * 1e-3, &trials);
        println!("seed {seed}: {} visits, moved {found:.2?} of what was wanted", revisit.times.len());
        all.extend(found);
    }
    assert!(all.len() > 8, "{}", all.len());
    // 200 trials tell a standard deviation to 5 %.
    assert!(all.iter().all(|part| (0.8..1.2).contains(part)), "{all:?}");
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    assert!((0.94..1.03).contains(&mean), "{mean}");
}

/// What the planned measurements leave open: the estimate of the file that the plan wrote predicts what moves as well as was promised.
#[test]
fn what_the_plan_leaves_open_is_what_estimates_are_off() {
    let wanted = 1.0;
    let order = json!({ "duration_s": 16, "references": [1], "again":
        { "standard_uncertainty_um": wanted, "until_s": 9900 } });
    let recipe = recipe(&order);
    let found = planned(&recipe).unwrap_or_else(|error| panic!("{error}"));
    let revisit = &found.plan.order.as_ref().expect("an order").revisits[0];
    assert!(revisit.times.len() > 1, "{:?}", revisit.times);
    let folder = temporary();
    found.write(&folder.path().join("plan")).unwrap_or_else(|error| panic!("{error}"));
    let mut filled = recipe.clone();
    filled.0.as_object_mut().expect("a recipe").remove("plan");
    filled.stage("touches")["path"] = json!(folder.path().join("plan/touches.csv"));
    filled.stage("touches").as_object_mut().expect("a stage").remove("ignore");
    let outcome = filled.run();
    let fit = fit(&outcome, "fit");
    let trials: Vec<Vec<Vec<f64>>> = seeds(100)
        .map(|seed| {
            let mut random = Generator::new(41, seed);
            let sizes = [("dzt[t1]", 8e-3), ("dzt[t2]", 4e-3), ("EA0B[T_column:1]", 6e-6), ("EXX[1*T_scale]", 11e-6)];
            let parameters: std::collections::BTreeMap<String, f64> =
                sizes.iter().map(|(name, size)| ((*name).to_owned(), size * random.normal())).collect();
            let sigmas = [("table", 1.6e-3), ("bar", 0.9e-3)].map(|(stage, sigma)| (stage.to_owned(), sigma));
            let noise = Noise { probing_sigma_mm: StandardDeviation::ByStage(sigmas.into()), ..Noise::default() };
            let truth = Truth { parameters: parameters.clone(), noise };
            let problem = measure(&fit.problem, &truth, seed).unwrap_or_else(|error| panic!("{error}"));
            let calibration = fit.estimator.estimate(&problem).unwrap_or_else(|error| panic!("{error}"));
            // What is left of it by the estimate.
            let of = |name: &str| calibration.get(name).map_or(0.0, |found| found.value);
            let left = parameters.iter().map(|(name, value)| (name.clone(), value - of(name))).collect();
            moved(fit, revisit, &Truth { parameters: left, noise: Noise::default() })
        })
        .collect();
    let found = beside(wanted * 1e-3, &trials);
    println!("{} visits, off {found:.2?} of what was promised", revisit.times.len());
    assert!(found.iter().all(|part| (0.75..1.25).contains(part)), "{found:?}");
}

#[test]
fn visits_are_told_and_those_that_make_no_sense_are_refused() {
    let order = |again: Value| json!({ "duration_s": 16, "references": [1], "again": again });
    let folder = temporary();
    let drift = json!([{ "parameters": ["dzt[t1]"], "standard_uncertainty": 0.01 }]);
    let file =
        recipe(&order(json!({ "standard_uncertainty_um": 3, "until_s": 9000, "changes": drift }))).write(folder.path());
    let out = folder.path().join("out");
    let told = abbe(folder.path(), &["plan".as_ref(), file.as_os_str(), "--out".as_ref(), out.as_os_str()]);
    assert!(
        told.stdout.contains("Measure 1 again after ") && told.stdout.contains(" rows) at the latest"),
        "{}",
        told.stdout
    );
    let page = crate::support::read(&out.join("report.html"));
    assert!(page.contains("When 1 is measured again") && page.contains("Order of the measurements"), "{page}");
    let json = abbe(folder.path(), &["plan".as_ref(), file.as_os_str(), "--json".as_ref()]);
    let json: Value = serde_json::from_str(&json.stdout).expect("JSON");
    // A drift that is straight moves by as much in the same time.
    let times = json["order"]["again"][0]["times_s"].as_array().expect("times");
    let times: Vec<f64> = times.iter().map(|time| time.as_f64().expect("a time")).collect();
    let steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(steps.len() > 1 && steps.iter().all(|step| (step - steps[0]).abs() < 10.0), "{times:?}");
    let refused = |again: Value| planned(&recipe(&order(again))).err().expect("it is refused");
    let said = refused(json!({ "standard_uncertainty_um": 0.01, "changes": drift }));
    assert!(said.contains("it cannot be held so well"), "{said}");
    let said = refused(json!({ "standard_uncertainty_um": 3, "until_s": 90000 }));
    assert!(said.contains("is outside the log of temperatures"), "{said}");
    let said = refused(json!({ "standard_uncertainty_um": 3, "until_s": -5 }));
    assert!(said.contains("a time behind the beginning of the plan was expected"), "{said}");
    let other = json!([{ "parameters": ["dzt[t9]"], "standard_uncertainty": 0.01 }]);
    let said = refused(json!({ "standard_uncertainty_um": 3, "changes": other }));
    assert!(said.contains("`dzt[t9]` matches nothing that is estimated"), "{said}");
    let said = planned(&recipe(&json!({ "again": { "standard_uncertainty_um": 3 } }))).err().expect("it is refused");
    assert!(said.contains("which candidates are measured again is missing"), "{said}");
    // Nothing that is wanted moves: once is enough.
    let none = json!([{ "parameters": ["EA0B"], "standard_uncertainty": 0.01 }]);
    let found = planned(&recipe(&order(json!({ "standard_uncertainty_um": 3, "changes": none })))).expect("a plan");
    let revisit = &found.plan.order.as_ref().expect("an order").revisits[0];
    assert_eq!((revisit.times.len(), revisit.shortest()), (1, None));
    assert!(revisit.largest < 1e-9, "{}", revisit.largest);
}
