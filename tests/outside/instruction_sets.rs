//! The same program on a processor with other instructions. Linear algebra and the sines of the C library use the
//! instructions of the processor, and other instructions round differently. These tests hold what is promised in spite of
//! that.

use std::path::{Path, PathBuf};
use std::process::Command;

use abbe_core::Calibration;
use serde_json::json;

use crate::support::{Small, Variant, files_in, program, read, recipes, skipped, temporary, values};

/// What two processors may differ by, in standard uncertainties: the larger of the one that is told and the one that
/// follows from what was stated. Of exact data the scatter of the residuals, and with it the first, is rounding itself.
const ALLOWED: f64 = 1e-9;

/// The emulator, and a processor for it: one without AVX, or one with AVX2 where this one has none.
fn emulator() -> Result<(PathBuf, &'static str), String> {
    if !cfg!(all(target_arch = "x86_64", target_os = "linux")) {
        return Err("programs for x86-64 and Linux are emulated".to_owned());
    }
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&folders).map(|folder| folder.join("qemu-x86_64")).find(|file| file.is_file());
    let emulator = found.ok_or("there is no qemu-x86_64 (Debian: apt-get install qemu-user)")?;
    #[cfg(target_arch = "x86_64")]
    let wide = std::arch::is_x86_feature_detected!("avx2");
    #[cfg(not(target_arch = "x86_64"))]
    let wide = false;
    Ok((emulator, if wide { "Nehalem" } else { "Haswell" }))
}

/// The calibrations of a recipe, run by a command that gets the program's own arguments.
fn run(mut command: Command, out: &Path) -> Vec<(String, Calibration)> {
    let output = command.output().expect("the program starts");
    let status = output.status.code();
    assert!(matches!(status, Some(0 | 3)), "{command:?}: {status:?} {}", String::from_utf8_lossy(&output.stderr));
    let folder = std::fs::read_dir(out).expect("results").next().expect("one recipe").expect("a folder").path();
    let calibrations = files_in(&folder).into_iter().filter_map(|file| {
        let name = file.file_name()?.to_str()?.strip_suffix(".calibration.json")?.to_owned();
        Some((name, Calibration::from_json(&read(&file)).expect("a calibration")))
    });
    calibrations.collect()
}

/// By how many standard uncertainties values and uncertainties differ, and where most.
fn difference(one: &Calibration, other: &Calibration) -> (f64, String) {
    assert_eq!((one.fit.rank, one.fit.null_space.len()), (other.fit.rank, other.fit.null_space.len()));
    let stated = |name: &str| {
        let budget = one.uncertainty.iter().flat_map(|budget| &budget.parameters);
        budget.filter(|of| of.name == name).map(|of| of.stated_standard_uncertainty).fold(0.0, f64::max)
    };
    let mut worst = (0.0, String::new());
    for (one, other) in values(one).zip(values(other)) {
        assert_eq!((&one.name, one.status), (&other.name, other.status));
        let unit = one.standard_uncertainty.max(stated(&one.name));
        for (what, one_value, other_value) in
            [("value", one.value, other.value), ("uncertainty", one.standard_uncertainty, other.standard_uncertainty)]
        {
            // What is not estimated has no uncertainty, and does not differ.
            let off = if one_value == other_value { 0.0 } else { (one_value - other_value).abs() / unit };
            if off > worst.0 || off.is_nan() {
                worst = (off, format!("{what} of {}", one.name));
            }
        }
    }
    worst
}

/// Recipes, or parts of them, that are quick enough for an emulator.
fn cases(small: &Small) -> Vec<(&'static str, Variant)> {
    let of = |name: &str, kept: &[&str]| Variant::of(&recipes()[name]).only(kept);
    let mut trials = Variant::of(&small.path("recipe.yaml")).only(&["fine", "rough"]);
    trials.0["stages"]["trials"] =
        json!({ "estimate": "monte-carlo", "of": "fine", "trials": 300, "coverage_probability": 0.5, "seed": 1 });
    vec![
        ("TANGO", of("tango-hu40t", &["fit-S2", "fit-S3"])),
        ("TANGO, exact", of("tango-hu40t-exact", &["fit-S3", "fit-S4r"])),
        ("lengths of a CMM", of("cmm-brute-force", &["fit"])),
        ("ball bar", of("ballbar-c600u", &["fit", "closed-form", "squared-length"])),
        ("ball bar, exact", of("ballbar-c600u-exact", &["fit", "closed-form"])),
        ("first steps, robust", of("first-steps", &["fit"])),
        ("Monte Carlo", trials),
    ]
}

#[test]
fn estimates_do_not_depend_on_the_instructions_of_the_processor() {
    let (emulator, processor) = match emulator() {
        Ok(emulator) => emulator,
        Err(reason) => return skipped("estimates_do_not_depend_on_the_instructions_of_the_processor", &reason),
    };
    let small = Small::new();
    let (mut told, mut wrong) = (String::new(), Vec::new());
    for (name, recipe) in cases(&small) {
        let folder = temporary();
        let file = recipe.write(folder.path());
        let arguments = |out: &str| ["run".into(), file.clone(), "--out".into(), folder.path().join(out)];
        let here = run(program(folder.path(), &arguments("here")), &folder.path().join("here"));
        let mut there = Command::new(&emulator);
        let known = program(folder.path(), &arguments("there"));
        there.args(["-cpu", processor]).arg(known.get_program()).args(known.get_args()).current_dir(folder.path());
        let there = run(there, &folder.path().join("there"));
        assert!(!here.is_empty() && here.len() == there.len(), "{name}");
        for ((fit, here), (_, there)) in here.iter().zip(&there) {
            let (off, place) = difference(here, there);
            told.push_str(&format!("{name}, {fit}: {off:.1e} ({place})\n"));
            if off.is_nan() || off > ALLOWED {
                wrong.push(format!("{name}, {fit}: {off:.1e} ({place})"));
            }
        }
    }
    println!("{told}");
    assert!(wrong.is_empty(), "on a {processor} these differ by more than {ALLOWED:e} of an uncertainty: {wrong:#?}");
}
