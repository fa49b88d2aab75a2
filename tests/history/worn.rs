//! Worn artefact or worn machine: which of them explains a change, on data of a forward model that has either.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use super::machines::{Story, Worn, analysed_by, programme};
use super::{parameter, uncertain};
use crate::support::{Random, Variant};

/// Histories of each kind.
const EACH: u64 = 3;

/// The week from which it is worn.
const FROM: u64 = 20;

/// The recipe with the diameters of both balls as unknowns, which are charted with the errors of the machine.
fn with_balls(mut variant: Variant) -> Variant {
    let ball = |feature: u32| json!({ "feature": feature, "estimated": true });
    let trend = variant.stage("trend").as_object_mut().expect("settings");
    trend.remove("volumetric");
    trend.remove("again");
    variant.set("bar", "diameters", json!([ball(1), ball(2)])).set(
        "trend",
        "parameters",
        json!(["E*", "bar.ball[*].diameter"]),
    )
}

/// What is told of a machine to which only this happens.
fn told(seed: u64, worn: Worn, crash: (u64, &'static str, f64)) -> Value {
    let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    random.unit();
    let story = Story::quiet(&mut random).with(worn, crash);
    analysed_by(&story, seed.wrapping_mul(0xD1B5_4A32_D192_ED03), &programme(), with_balls)
}

/// The parameters that have changed.
fn changed(found: &Value) -> BTreeSet<&str> {
    let parameters = found["analysis"]["parameters"].as_array().expect("parameters").iter();
    let changed = parameters.filter(|parameter| parameter["state"] == "changed");
    changed.filter_map(|parameter| parameter["name"].as_str()).collect()
}

fn first_event(found: &Value) -> &Value {
    found["analysis"]["events"].as_array().and_then(|events| events.first()).expect("an event")
}

fn agrees(value: &Value, truth: f64) {
    let (value, uncertainty) = uncertain(value);
    assert!((value - truth).abs() < 4.0 * uncertainty, "{value} ± {uncertainty} against {truth}");
}

/// A bar that has grown shifts all scales; the sentence says by how much, and in which direction.
#[test]
fn a_bar_that_has_changed_is_told_from_the_scales() {
    for seed in 1..=EACH {
        let size = if seed % 2 == 0 { 0.006 } else { -0.006 };
        let found = told(seed, Worn { from: FROM, length: size, ..Worn::default() }, (99, "EX0C", 0.0));
        assert!(changed(&found).is_superset(&["EXX[1]", "EYY[1]", "EZZ[1]"].into()), "{seed}: {:?}", changed(&found));
        let explained = &first_event(&found)["explained"];
        assert_eq!(explained["input"], "bar.length[1-2]", "{seed}");
        agrees(&explained["change"], size);
    }
}

/// A ball that was worn is found as that ball, and the machine is left alone.
#[test]
fn a_worn_ball_is_told_from_the_machine() {
    let mut others = 0;
    for seed in 1..=EACH {
        let balls = if seed % 2 == 0 { [0.0, -0.002] } else { [-0.002, 0.0] };
        let found = told(seed, Worn { from: FROM, balls, ..Worn::default() }, (99, "EX0C", 0.0));
        let worn = if seed % 2 == 0 { "bar.ball[2].diameter" } else { "bar.ball[1].diameter" };
        let changed = changed(&found);
        assert!(changed.contains(worn), "{seed}: {changed:?}");
        others += changed.len() - 1;
        let change = &parameter(&found, worn)["change"];
        assert_eq!(change["form"], "step", "{seed}");
        agrees(&change["size"], -0.004);
    }
    assert!(others <= 1, "{others} others");
}

/// An axis that has changed is explained by no artefact.
#[test]
fn a_worn_axis_is_told_from_the_artefact() {
    for seed in 1..=EACH {
        let (name, size) = [("EXX[1]", 25e-6), ("EB0C", -25e-6), ("EY0C", -0.008)][seed as usize % 3];
        let found = told(seed, Worn::default(), (FROM, name, size));
        let event = first_event(&found);
        assert_eq!((&event["parameters"], &event["explained"]), (&json!([name]), &Value::Null), "{seed}");
        agrees(&event["change"]["size"], size);
        assert!(changed(&found).len() <= 2, "{seed}: {:?}", changed(&found));
    }
}
