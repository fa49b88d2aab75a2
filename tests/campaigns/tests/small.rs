//! Some cases of each campaign; `cargo xtask campaign` runs them by the thousand.

use abbe_campaigns::{bad_inputs, batches, compensation, fuzz, hostile, machines, signals, tango};

/// Cases that broke a law once.
#[test]
fn what_went_wrong_on_random_machines_stays_right() {
    let cases = [
        // Of unknowns that hardly take part in what is lost, one was left out.
        (17021, 180),
        // Of eight unknowns that were left out each was a good choice, and all together had no solution.
        (18041, 3786),
        // Lobes that are zero in the directions of all touches were estimated from rounding.
        (18012, 11_988),
        (18012, 15_793),
        (18012, 19_959),
        (18012, 24_193),
        // Two orientations of an observer agreed with all poses: the positions choose.
        (18012, 33_647),
        // Values that the product of two lost directions moves were not marked.
        (18012, 4544),
        (18012, 13_891),
        (18012, 16_371),
        (18012, 19_302),
    ];
    for (seed, case) in cases {
        let broken = machines::broken(seed, case);
        assert!(broken.is_empty(), "seed {seed}, case {case}: {broken:?}");
    }
}

#[test]
fn random_machines_keep_the_laws() {
    let report = machines::run(7, 600);
    println!("{}", report.text);
    assert!(report.broken.is_empty(), "{}", report.broken.join("\n"));
    // Every end is seen, or the campaign would prove nothing.
    for end in ["Full", "Marked", "Refused"] {
        assert!(report.text.contains(end), "{end}: {}", report.text);
    }
}

/// Values that are held are off by up to 2.5 of their standard uncertainties, and readings have no noise: residuals are large where rows
/// see these values, and no column is wrong.
#[test]
fn what_held_values_lack_is_no_wrong_column() {
    for case in [33, 1742, 2557, 2722] {
        let broken = machines::broken(77, case);
        assert!(broken.is_empty(), "case {case}: {broken:?}");
    }
}

#[test]
fn rows_in_batches_say_what_rows_that_are_held_say() {
    let report = batches::run(1, 15);
    println!("{}", report.text);
    assert!(report.broken.is_empty(), "{}", report.broken.join("\n"));
    for end in ["select", "estimated"] {
        assert!(report.text.contains(end), "{end}: {}", report.text);
    }
}

#[test]
fn robust_fits_settle_on_other_seeds() {
    let report = tango::run(1, 4);
    println!("{}", report.text);
    let failed: Vec<&String> = report.broken.iter().filter(|law| law.starts_with("seed")).collect();
    assert!(failed.is_empty(), "{failed:?}");
}

#[test]
fn corrected_set_points_keep_the_laws() {
    let report = compensation::run(1, 150);
    assert!(report.broken.is_empty(), "{}", report.text);
}

/// This program is Abbe, too.
const PROGRAM: &str = env!("CARGO_BIN_EXE_abbe-campaigns");

#[test]
fn bad_inputs_do_no_harm() {
    let found = bad_inputs::run(PROGRAM.as_ref(), 1, 60);
    assert!(found.broken.is_empty(), "{}", found.text);
}

#[test]
fn signals_leave_whole_results() {
    let found = signals::run(PROGRAM.as_ref(), 1, 20);
    assert!(found.broken.is_empty(), "{}", found.text);
}

#[test]
fn hostile_surroundings_do_no_harm() {
    let found = hostile::run(PROGRAM.as_ref(), 1, 56);
    assert!(found.broken.is_empty(), "{}", found.text);
}

/// cargo-fuzz has the same targets.
#[test]
fn every_target_is_one_of_cargo_fuzz_too() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz");
    let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).expect("the manifest");
    let targets = fuzz::targets();
    assert_eq!(manifest.matches("[[bin]]").count(), targets.len());
    for target in targets {
        let file = format!("fuzz_targets/{}.rs", target.name.replace('-', "_"));
        assert!(manifest.contains(&format!("name = \"{}\"\npath = \"{file}\"", target.name)), "{}", target.name);
        let text = std::fs::read_to_string(folder.join(file)).expect("a target");
        assert!(text.contains(&format!("target!(\"{}\")", target.name)), "{}", target.name);
    }
}

/// Every reader gets some hundred inputs, and each takes its seeds: else the campaign would try the first refusal again and again.
#[test]
fn bytes_that_nobody_meant_do_no_harm() {
    let kept = std::env::temp_dir().join("abbe-fuzz");
    let found = fuzz::run(1, 150, None, &kept);
    println!("{}", found.text);
    assert!(found.broken.is_empty(), "{}", found.text);
    for target in fuzz::targets() {
        let answers: Vec<_> = target.seeds.iter().map(|seed| target.read(seed)).collect();
        let is_taken = answers.iter().any(Result::is_ok) || target.name == "plugin-failure";
        assert!(is_taken, "{} takes none of its seeds: {answers:?}", target.name);
    }
}
