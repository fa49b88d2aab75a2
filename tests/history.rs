//! The history of one machine: every figure of the set, the events of its truth, and a file that loses nothing.

pub(crate) mod kept;
mod machines;
pub(crate) mod serve;
pub(crate) mod stored;
mod volumetric;
mod worn;

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::Calibration;
use abbe_engine::Outcome;
use serde_json::Value;

use crate::support::{Variant, json_file, recipes, root};

const DATA: [(&str, &str); 2] = [("exact", "history-exact"), ("realistic", "history")];

fn truth(data: &str) -> Value {
    json_file(&root().join(format!("tests/truth/history-{data}.json")))
}

fn expected(data: &str) -> Value {
    json_file(&root().join(format!("tests/truth/history-{data}-expected.json")))
}

/// What `validate: trend` wrote.
fn trend(outcome: &Outcome) -> Value {
    let files = &outcome.exports.iter().find(|(stage, _)| stage == "trend").expect("tables").1;
    let file = files.iter().find(|file| file.name == "trend.json").expect("trend.json");
    serde_json::from_slice(&file.content).expect("JSON")
}

fn parameter<'a>(trend: &'a Value, name: &str) -> &'a Value {
    let parameters = trend["analysis"]["parameters"].as_array().expect("parameters");
    parameters.iter().find(|parameter| parameter["name"] == name).unwrap_or_else(|| panic!("{name}"))
}

fn near(found: f64, expected: f64, relative: f64, what: &str) {
    assert!((found - expected).abs() <= relative * expected.abs().max(1e-12), "{what}: {found} against {expected}");
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Value and standard uncertainty.
fn uncertain(value: &Value) -> (f64, f64) {
    (number(&value["value"]), number(&value["standard_uncertainty"]))
}

fn weeks(outcome: &Outcome) -> BTreeMap<String, &Calibration> {
    let group = |calibration: &Calibration| Some(calibration.group.as_ref()?.label.clone());
    outcome.fits.iter().filter_map(|fit| Some((group(&fit.calibration)?, &fit.calibration))).collect()
}

/// The labels of the tests at which a chart has an alarm.
fn alarms(trend: &Value, name: &str, chart: &str) -> Vec<u64> {
    let parameter = parameter(trend, name);
    let label = |test: &Value| {
        let test = &trend["analysis"]["tests"][test.as_u64().unwrap_or(0) as usize];
        test["label"].as_str().and_then(|label| label.parse().ok()).expect("a week")
    };
    let tests = parameter["tests"].as_array().expect("tests").iter();
    let flags = parameter["charts"]["alarms"].as_array().expect("alarms");
    tests.zip(flags).filter(|(_, flags)| flags[chart] == true).map(|(test, _)| label(test)).collect()
}

#[test]
fn every_week_is_a_calibration_of_its_own() {
    for (data, recipe) in DATA {
        let (outcome, expected) = (Variant::of(&recipes()[recipe]).run(), expected(data));
        let (weeks, wanted) = (weeks(&outcome), expected["weeks"].as_object().expect("weeks"));
        assert_eq!(weeks.keys().collect::<BTreeSet<_>>(), wanted.keys().collect::<BTreeSet<_>>());
        let trend = trend(&outcome);
        let quality = trend["quality"].as_array().expect("tests");
        for (week, wanted) in wanted {
            let calibration = weeks[week];
            assert_eq!(calibration.fit.rank as u64, wanted["rank"].as_u64().expect("a rank"), "{data} {week}");
            near(calibration.fit.condition, number(&wanted["condition"]), 0.05, "condition");
            let quality = quality.iter().find(|quality| quality["label"] == *week).expect("the week");
            assert_eq!(quality["good"], wanted["good"], "{data} {week}");
            assert_eq!(quality["degrees_of_freedom"], wanted["degrees_of_freedom"]);
            if data == "realistic" {
                // The set evaluates residuals where they are recorded, Abbe with the exact distance to the centre.
                near(number(&quality["chi_squared"]), number(&wanted["chi2"]), 2e-3, "chi-squared");
            }
            for (name, value) in wanted["values"].as_object().expect("values") {
                let found = calibration.parameters.iter().find(|known| known.name == *name).expect("the parameter");
                let uncertainty = number(&wanted["standard_uncertainties"][name]);
                near(found.standard_uncertainty, uncertainty, 1e-3, name);
                let apart = (found.value - number(value)).abs();
                assert!(apart < 1e-3 * uncertainty, "{data} {week} {name}: {apart} of {uncertainty}");
            }
        }
        // The week with fewer touches knows less, and is none the worse for it.
        let uncertainty = |week: &str| {
            weeks[week].parameters.iter().find(|known| known.name == "EX0C").expect("EX0C").standard_uncertainty
        };
        assert!(uncertainty("31") > 1.1 * uncertainty("30"));
        assert_eq!(trend["analysis"]["missing"], serde_json::json!(["18"]));
    }
}

#[test]
fn charts_have_the_alarms_of_the_set() {
    for (data, recipe) in DATA {
        let (trend, expected) = (trend(&Variant::of(&recipes()[recipe]).run()), expected(data));
        for (name, wanted) in expected["charts"].as_object().expect("charts") {
            for (chart, of_set) in [("individuals", "individuals"), ("average", "ewma"), ("sum", "cusum")] {
                let wanted: Vec<u64> =
                    wanted["flags"][of_set].as_array().expect("flags").iter().filter_map(Value::as_u64).collect();
                assert_eq!(alarms(&trend, name, chart), wanted, "{data} {name} {chart}");
            }
        }
        let limits = &trend["analysis"]["limits"];
        near(number(&limits["individuals"]), 3.0, 1e-3, "individuals");
        near(number(&limits["average"]), 2.86 / 3.0, 1e-3, "average");
        near(number(&limits["sum"]), 4.77, 2e-3, "sum");
    }
}

#[test]
fn what_happened_is_told() {
    for (data, recipe) in DATA {
        let outcome = Variant::of(&recipes()[recipe]).run();
        let (trend, expected, truth) = (trend(&outcome), expected(data), truth(data));
        let within = |found: (f64, f64), wanted: f64, what: &str| {
            assert!((found.0 - wanted).abs() <= 3.0 * found.1, "{data} {what}: {found:?} against {wanted}");
        };
        for (name, class) in expected["classification"].as_object().expect("classes") {
            let found = parameter(&trend, name);
            let change = &found["change"];
            let state = found["state"].as_str().unwrap_or_default();
            match class.as_str().unwrap_or_default() {
                "in control" => assert!(["in-control", "unconfirmed"].contains(&state), "{data} {name}: {state}"),
                "seasonal" => assert_eq!(state, "seasonal"),
                "settling" => assert_eq!(change["form"], "exponential"),
                "wear" => assert_eq!(change["form"], "line"),
                step => {
                    assert_eq!(change["form"], "step", "{name}");
                    let first = change["first"].as_u64().expect("a test") as usize;
                    let label = &trend["analysis"]["tests"][first]["label"];
                    assert_eq!(format!("step in week {}", label.as_str().unwrap_or_default()), step);
                }
            }
        }
        for event in truth["events"].as_array().expect("events") {
            let of = |event: &Value| parameter(&trend, event["parameter"].as_str().expect("a name")).clone();
            match event["kind"].as_str().unwrap_or_default() {
                "settling" => {
                    let change = &of(event)["change"];
                    within(uncertain(&change["amplitude"]), number(&event["amplitude"]), "settling");
                    within(uncertain(&change["time_constant"]), number(&event["tau_weeks"]), "time constant");
                }
                "seasonal" => {
                    within(uncertain(&of(event)["seasonal"]["coefficient"]), number(&event["per_K"]), "season");
                }
                "wear" => within(uncertain(&of(event)["change"]["rate"]), number(&event["per_week"]), "wear"),
                "crash" => {
                    for (name, size) in event["parameters"].as_object().expect("parameters") {
                        within(uncertain(&parameter(&trend, name)["change"]["size"]), number(size), name);
                    }
                    let names: BTreeSet<&str> =
                        event["parameters"].as_object().into_iter().flatten().map(|(name, _)| name.as_str()).collect();
                    let events = trend["analysis"]["events"].as_array().expect("events");
                    let jump = events.iter().find(|event| event["change"]["form"] == "step").expect("a jump");
                    let found = jump["parameters"].as_array().into_iter().flatten().filter_map(Value::as_str);
                    // What they do together stands beside them.
                    let found: BTreeSet<&str> = found.filter(|name| !name.starts_with("volumetric")).collect();
                    assert_eq!(found, names, "{data}");
                }
                _ => {}
            }
        }
        let again = &parameter(&trend, "EXX[b]")["again"];
        assert_eq!(again["after"], expected["wear"]["reverification_weeks"], "{data}");
        let unconfirmed = |name: &str| parameter(&trend, name)["state"] == "unconfirmed";
        let alone = expected["false_alarms"].as_object().expect("false alarms");
        for name in expected["classification"].as_object().expect("classes").keys() {
            assert_eq!(unconfirmed(name), alone.contains_key(name), "{data} {name}");
        }
        assert!(outcome.passes(), "the changes are known");
    }
}
