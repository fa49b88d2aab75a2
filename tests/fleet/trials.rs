//! Trials in blocks: one calculation, however they are dealt out.

use std::fs;

use abbe_core::Calibration;

use super::plant::{Plant, lengths, ok, quiet, sabotaged};
use super::{contents, same};
use crate::support::{Random, read, temporary, write};

const TRIALS: &str = "  spread: { estimate: monte-carlo, of: fit, trials: 2000, seed: 9, \
                      vary: [{ parameters: [EXZ], standard_uncertainty: 0.001 }] }\n  \
                      told: { validate: uncertainty, of: [spread], parameters: [{ names: [EC0Y], expanded_urad: 50 }] }\n";

#[test]
fn blocks_of_trials_are_one_calculation() {
    let mut random = Random::new(3);
    let folder = temporary();
    let at = folder.path();
    let plant = Plant::of(1);
    write(&at.join("lengths.csv"), &lengths(&mut random));
    let errors = "      - { polynomial: [EXX, EYY, EZZ], degrees: [1] }\n";
    let more = format!("{errors}      - {{ polynomial: [EXX], degrees: [2] }}\n");
    let trials = TRIALS.replace("[EXZ], standard_uncertainty: 0.001", "[\"EXX[2]\"], standard_uncertainty: 1e-9");
    let recipe = plant.recipe().replace(errors, &more).replace("[\"E*[1]\"", "[\"E??[1]\"");
    write(&at.join("recipe.yaml"), &(recipe + &trials));
    let single = quiet(at, &["run", "recipe.yaml", "--out", "single"]);
    assert!([0, 3].contains(&single.status), "{}", single.stderr);
    let single = at.join("single/recipe");
    let expected = ["fit", "spread"].map(|name| read(&single.join(format!("{name}.calibration.json"))));
    let found = Calibration::from_json(&expected[1]).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(found.monte_carlo.as_ref().expect("trials").trials, 2000);
    let mut first = None;
    for block in [2000, 1 + random.below(1000), 333] {
        for name in ["fleet.results", "fleet.merged"] {
            let _ = fs::remove_dir_all(at.join(name));
        }
        let fleet = format!(
            "abbe_fleet: 1\nfamilies:\n  study: {{ recipe: recipe.yaml, trials: {{ stage: spread, block: {block} }} }}\n"
        );
        write(&at.join("fleet.yaml"), &fleet);
        let blocks = 2000_usize.div_ceil(block);
        let printed = quiet(at, &["fleet", "plan", "fleet.yaml"]);
        ok(&printed);
        assert!(printed.stdout.starts_with(&format!("{blocks} jobs in ")), "{}", printed.stdout);
        for _ in 0..2 {
            let index = random.below(blocks).to_string();
            ok(&quiet(at, &["fleet", "job", "fleet.manifest.jsonl", "--index", &index, "--count", "3"]));
            sabotaged(&at.join("fleet.results"), &mut random);
        }
        ok(&quiet(at, &["fleet", "run", "fleet.manifest.jsonl", "--workers", "2"]));
        let printed = quiet(at, &["fleet", "merge", "fleet.manifest.jsonl"]);
        assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
        let merged = contents(at);
        // Bit for bit what one run finds: a trial draws from the stream of its number.
        for (name, expected) in ["fit", "spread"].into_iter().zip(&expected) {
            let path = format!("calibrations/study.{name}.calibration.json");
            let found = String::from_utf8(merged[path.as_ref() as &std::path::Path].clone()).expect("text");
            assert!(found == *expected, "{block}: {name}");
        }
        let table = String::from_utf8(merged["distributions.csv".as_ref() as &std::path::Path].clone()).expect("text");
        assert!(table.contains("study,") && table.contains(",spread,EC0Y,rad,"), "{table}");
        let verdicts = String::from_utf8(merged["verdicts.csv".as_ref() as &std::path::Path].clone()).expect("text");
        assert!(verdicts.contains(",told,uncertainty,"), "{verdicts}");
        // The table of jobs says how they were dealt out; the others do not know.
        let mut rest = merged.clone();
        rest.retain(|name, _| name != "jobs.csv".as_ref() as &std::path::Path && !name.ends_with("jobs.parquet"));
        same(first.get_or_insert_with(|| rest.clone()), &rest, &format!("blocks of {block}"));
    }
}

#[test]
fn what_cannot_be_dealt_out_is_refused() {
    let folder = temporary();
    let at = folder.path();
    write(&at.join("lengths.csv"), &lengths(&mut Random::new(3)));
    let fleet = "abbe_fleet: 1\nfamilies:\n  study: { recipe: recipe.yaml, trials: { stage: STAGE, block: 100 } }\n";
    let trials = "  spread: { estimate: monte-carlo, of: fit, SETTINGS }\n";
    for (settings, stage, said) in [
        ("trials: 2000", "fit", "this is no estimate by trials in blocks"),
        ("adaptive: { most: 20000 }", "spread", "a number that is fixed before"),
        ("seed: 2", "spread", "the number of trials is missing"),
        ("trials: 1000000000000", "spread", "10000000000 jobs, at most 10000 were expected"),
    ] {
        write(&at.join("recipe.yaml"), &(Plant::of(1).recipe().to_owned() + &trials.replace("SETTINGS", settings)));
        write(&at.join("fleet.yaml"), &fleet.replace("STAGE", stage));
        let printed = quiet(at, &["fleet", "plan", "fleet.yaml"]);
        assert!(printed.status == 2 && printed.stderr.contains(said), "{}", printed.stderr);
    }
    // A block by itself, and values from nowhere, are nothing that a recipe may have by mistake.
    for (settings, said) in [
        ("trials: 2000, block: { first: 1900, count: 101 }", "the block ends with trial 2001"),
        ("trials: 2000, block: { first: 0, count: 10 }, solved: lengths.csv", "`block` or `solved`"),
        ("adaptive: {}, solved: lengths.csv", "and not `adaptive`"),
        ("trials: 2000, solved: lengths.csv", "are 96000 bytes; the file has"),
        ("trials: 2000, solved: none.f64", "does not exist"),
    ] {
        write(&at.join("recipe.yaml"), &(Plant::of(1).recipe().to_owned() + &trials.replace("SETTINGS", settings)));
        let printed = quiet(at, &["run", "recipe.yaml"]);
        assert!(printed.status != 0 && printed.stderr.contains(said), "{settings}: {}", printed.stderr);
    }
}
