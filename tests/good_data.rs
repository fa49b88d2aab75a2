//! Good data that look like a mistake at first sight: nobody is asked about them.

use std::ffi::OsStr;
use std::path::Path;

use serde_json::json;

use crate::misread::changed;
use crate::support::{Random, Variant, abbe, read, recipes, root, temporary, write};

/// What a run says on its standard error, in one line.
fn said(recipe: &Variant, folder: &Path) -> String {
    let file = recipe.write(folder);
    let printed = abbe(folder, &["run".as_ref(), file.as_os_str(), "--out".as_ref(), folder.join("out").as_os_str()]);
    printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

/// The touches of a baseline once more, as a machine repeats them. `change` changes the directions of X, Y and Z of a row, beside its axis
/// of approach.
fn touched_again(text: &str, random: &mut Random, change: impl Fn(&str, usize, &str) -> String) -> String {
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let header = lines.next().expect("a header");
    let place = |name: &str| header.split(',').position(|column| column == name).expect("a column");
    let axes = ["X", "Y", "Z"];
    let mut again = format!("{header}\n");
    for line in lines {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        let approach = cells[place("approach")].clone();
        let axis = format!("{}_mm", &approach[1..]);
        let reading: f64 = cells[place("measured_mm")].parse().expect("a reading");
        let reading = format!("{:.4}", reading + 3e-4 * random.normal());
        cells[place(&axis)].clone_from(&reading);
        cells[place("measured_mm")] = reading;
        for (index, axis) in axes.iter().enumerate() {
            let column = place(&format!("dir_{axis}"));
            cells[column] = change(&approach, index, &cells[column]);
        }
        again += &(cells.join(",") + "\n");
    }
    again
}

/// Uncertainties that are stated too small make no exchange of axes: one that leads beyond the travel, or that leaves a part of what the
/// residuals are too large by.
#[test]
fn uncertainties_that_are_too_small_are_no_exchange_of_axes() {
    for factor in [0.75, 0.45] {
        let folder = temporary();
        let mut recipe = Variant::of(&recipes()["probe-lobing"]);
        let stages = recipe.0["stages"].as_object_mut().expect("stages");
        for stage in stages.values_mut().filter(|stage| stage.get("artefact").is_some()) {
            let stated = stage["standard_uncertainty_um"].as_f64().expect("an uncertainty");
            stage["standard_uncertainty_um"] = json!(factor * stated);
        }
        let said = said(&recipe, folder.path());
        assert!(!said.contains("exchanged"), "{factor}: {said}");
    }
}

/// A machine of which the model lacks a little is not asked whether two of its 31 sensors are exchanged: one of 465 exchanges makes up for
/// a part of it in a quarter of such machines.
#[test]
fn what_a_model_lacks_is_no_exchange_of_sensors() {
    let recipe = Variant::of(&recipes()["mill-warming"]).only(&["fit-stated"]);
    let truth = root().join("tests/truth/mill-warming.json");
    for seed in 10..17 {
        let folder = temporary();
        let (file, out) = (recipe.write(folder.path()), folder.path().join("simulated"));
        let seed = seed.to_string();
        let words: [&OsStr; 8] = [
            "simulate".as_ref(),
            file.as_ref(),
            "--truth".as_ref(),
            truth.as_ref(),
            "--seed".as_ref(),
            seed.as_ref(),
            "--out".as_ref(),
            out.as_ref(),
        ];
        assert_eq!(abbe(folder.path(), &words).status, 0);
        let name = file.file_name().expect("a file");
        let printed = abbe(&out, &["run".as_ref(), name, "--out".as_ref(), "results".as_ref()]);
        assert!(printed.status == 0 && !printed.stderr.contains("exchanged"), "{seed}: {}", printed.stderr);
    }
}

/// Only the axis that touches says whether its direction leads to the surface: those of the others say from where they came.
#[test]
fn a_baseline_of_several_files_is_not_asked_for_signs() {
    let recipe = Variant::of(&recipes()["rapid-verify-five-axis"]).only(&["calibrated"]);
    let text = read(&recipe.path("baseline", "path"));
    let words = "touches lead away from the surface";
    for seed in 0..8 {
        let mut random = Random::new(seed);
        let folder = temporary();
        for file in 0..1 + seed {
            write(
                &folder.path().join(format!("touches-{file}.csv")),
                &touched_again(&text, &mut random, |_, _, cell| cell.to_owned()),
            );
        }
        let recipe = recipe.clone().set("baseline", "path", json!(folder.path().join("touches-*.csv")));
        let said = said(&recipe, folder.path());
        assert!(!said.contains(words), "{seed}: {said}");
    }
    let mut random = Random::new(100);
    let folder = temporary();
    let turned = |_: &str, axis: usize, cell: &str| match axis {
        2 => cell.replace('+', "*").replace('-', "+").replace('*', "-"),
        _ => cell.to_owned(),
    };
    write(&folder.path().join("touches.csv"), &touched_again(&text, &mut random, turned));
    let recipe = recipe.clone().set("baseline", "path", json!(folder.path().join("touches.csv")));
    let said = said(&recipe, folder.path());
    assert!(said.contains(&format!("{words} by `dir_Z`")), "{said}");
}

/// A good spindle moves along its axis by less than a sensor tells.
#[test]
fn an_axial_motion_below_the_noise_is_not_asked_for() {
    let recipe = Variant::of(&recipes()["spindle-motion"]).only(&["motion"]);
    for (noise, is_told) in [(6e-3, false), (4e-3, false), (1e-5, true)] {
        let folder = temporary();
        let random = std::cell::RefCell::new(Random::new(1));
        let mut recipe = recipe.clone();
        for run in ["run-600", "run-3000", "run-9000"] {
            let file = recipe.path(run, "path");
            let only_noise = |_: usize, _: &str| format!("{:.6}", 12.0 + noise * random.borrow_mut().normal());
            recipe.stage(run)["path"] = json!(changed(&file, folder.path(), "z_um", only_noise));
        }
        let said = said(&recipe, folder.path());
        assert_eq!(said.contains("z moves by"), is_told, "{noise}: {said}");
    }
}
