//! Worn artefact or worn machine: which of them explains a change, on data of a forward model that has either.

use serde_json::{Value, json};

use super::machines::{Story, Worn, analysed_by, programme};
use crate::support::{Random, Variant};

/// Histories of each kind.
const EACH: u64 = 3;

/// The recipe with the certificates of both balls and of the stylus.
fn with_certificates(variant: Variant) -> Variant {
    let ball = |feature: u32| json!({ "feature": feature, "standard_uncertainty_um": 0.3 });
    variant.set("bar", "diameters", json!([ball(1), ball(2)]))
}

fn story(seed: u64) -> Story {
    let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    random.unit();
    Story::quiet(&mut random)
}

fn told(story: &Story, seed: u64) -> Value {
    analysed_by(story, seed.wrapping_mul(0xD1B5_4A32_D192_ED03), &programme(), with_certificates)
}

#[test]
fn explore() {
    for seed in 1..=EACH {
        for (kind, worn, crash) in [
            ("bar", Worn { from: 20, length: 0.006, ..Worn::default() }, (99, "EX0C", 0.0)),
            ("ball", Worn { from: 20, balls: [0.0, -0.003], ..Worn::default() }, (99, "EX0C", 0.0)),
            ("both", Worn { from: 20, balls: [-0.003, -0.003], ..Worn::default() }, (99, "EX0C", 0.0)),
            ("axis", Worn::default(), (20, "EXX[1]", 25e-6)),
            ("axes", Worn::default(), (20, "EB0C", 25e-6)),
        ] {
            let story = story(seed).with(worn, crash);
            let found = told(&story, seed);
            eprintln!("{seed} {kind}: {}", found["analysis"]["events"]);
            let bad: Vec<&Value> = found["quality"]
                .as_array()
                .unwrap()
                .iter()
                .filter(|q| q["good"] == false)
                .map(|q| &q["label"])
                .collect();
            eprintln!("   rejected {}", bad.len());
        }
    }
    panic!();
}
