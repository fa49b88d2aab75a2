//! Nobody's files are lost: a run replaces what an earlier run wrote, as it wrote it, and nothing else.

#[cfg(unix)]
mod ways;

#[cfg(unix)]
mod kept;

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use abbe_core::{Event, Monitor};
use abbe_engine::prepare;

use crate::support::{Small, abbe, recipes, registry, temporary, tree};

fn run(small: &Small, out: &str) -> (i32, String) {
    let printed = small.abbe(&["run", "recipe.yaml", "--out", out]);
    (printed.status, printed.stderr)
}

#[test]
fn what_somebody_puts_beside_the_results_stays() {
    let small = Small::new();
    assert_eq!(run(&small, "out").0, 0);
    let results = tree(&small.path("out/recipe"));
    small.write("out/recipe/notes.txt", "mine");
    small.write("out/recipe/written/more/notes.txt", "mine, too");
    fs::create_dir(small.path("out/recipe/empty")).expect("a folder");
    #[cfg(unix)]
    std::os::unix::fs::symlink("/nowhere", small.path("out/recipe/link")).expect("a link");
    let modified = fs::metadata(small.path("out/recipe/notes.txt")).and_then(|file| file.modified()).expect("a time");
    // A stage less: its files were ours, and go.
    let recipe = small.read("recipe.yaml").replace("  written: {", "  table-of-errors: {");
    small.write("recipe.yaml", &recipe);
    assert_eq!(run(&small, "out").0, 0);
    assert_eq!(small.read("out/recipe/notes.txt"), "mine");
    assert_eq!(small.read("out/recipe/written/more/notes.txt"), "mine, too");
    assert!(small.path("out/recipe/empty").is_dir());
    #[cfg(unix)]
    assert_eq!(fs::read_link(small.path("out/recipe/link")).expect("it is there"), Path::new("/nowhere"));
    let now = fs::metadata(small.path("out/recipe/notes.txt")).and_then(|file| file.modified()).expect("a time");
    assert_eq!(now, modified);
    assert!(!small.path("out/recipe/written").join("error-table.csv").exists());
    assert!(small.path("out/recipe/table-of-errors").is_dir());
    // Nothing temporary is left, and all results are there.
    assert_eq!(fs::read_dir(small.path("out")).expect("a folder").count(), 1);
    assert!(tree(&small.path("out/recipe")).len() >= results.len() + 3);
}

#[test]
fn a_changed_result_is_somebodys_file() {
    let small = Small::new();
    assert_eq!(run(&small, "out").0, 0);
    small.write("out/recipe/fine.calibration.json", "{ \"edited\": true }");
    let (status, stderr) = run(&small, "out");
    assert_eq!(status, 1, "{stderr}");
    let name = Path::new("out/recipe/fine.calibration.json").display().to_string();
    assert!(stderr.contains(&name) && stderr.contains("is in the way"), "{stderr}");
    assert_eq!(small.read("out/recipe/fine.calibration.json"), "{ \"edited\": true }");

    // What is known only after the run costs no results either.
    let small = Small::new();
    assert_eq!(run(&small, "out").0, 0);
    let exported = tree(&small.path("out/recipe/written")).remove(0);
    let exported = Path::new("out/recipe/written").join(exported).display().to_string();
    small.write(&exported, "mine");
    let (status, stderr) = run(&small, "out");
    assert_eq!(status, 1, "{stderr}");
    assert!(stderr.contains("recipe-new-1"), "{stderr}");
    assert_eq!(small.read(&exported), "mine");
    assert!(small.path("out/recipe-new-1/fine.calibration.json").exists());
    assert!(small.path("out/recipe-new-1/run.json").exists());
}

#[test]
fn source_data_among_copied_results_stay() {
    let small = Small::new();
    assert_eq!(run(&small, "out").0, 0);
    for name in ["run.json", "verdicts.json", "fine.calibration.json"] {
        fs::copy(small.path("out/recipe").join(name), small.path("data").join(name)).expect("a copy");
    }
    fs::rename(small.path("recipe.yaml"), small.path("data.yaml")).expect("a new name");
    let before =
        ["touches.csv", "facets.csv", "lengths.csv", "machine.yaml"].map(|name| small.read(&format!("data/{name}")));
    let printed = small.abbe(&["run", "data.yaml", "--out", "."]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let after =
        ["touches.csv", "facets.csv", "lengths.csv", "machine.yaml"].map(|name| small.read(&format!("data/{name}")));
    assert_eq!(before, after);
    assert!(small.path("data/rough.calibration.json").exists());
}

#[test]
fn a_run_never_replaces_what_it_reads() {
    let small = Small::new();
    assert_eq!(run(&small, "out").0, 0);
    let recipe = small.read("recipe.yaml").replace(
        "  rough:\n    estimate: gauss-newton",
        "  before: { estimate: calibration, path: out/recipe/rough.calibration.json }\n  rough:\n    estimate: gauss-newton",
    );
    small.write("recipe.yaml", &recipe);
    let before = small.read("out/recipe/rough.calibration.json");
    let (status, stderr) = run(&small, "out");
    assert!(status == 1 && stderr.contains("is in the way"), "{stderr}");
    assert_eq!(small.read("out/recipe/rough.calibration.json"), before);
}

/// What a killed run has left is removed by its name: nobody's data have it.
#[test]
fn data_with_the_name_of_temporary_folders_are_refused() {
    let small = Small::new();
    let recipe = small.read("recipe.yaml");
    let (ours, alike) = (".abbe-partial-0123456789ab", ".abbe-partial-0123456789");
    for (folder, is_taken) in [(ours, false), (alike, true)] {
        small.write(&format!("out/{folder}/touches.csv"), &small.read("data/touches.csv"));
        small.write("recipe.yaml", &recipe.replace("data/touches.csv", &format!("out/{folder}/touches.csv")));
        let (status, stderr) = run(&small, "out");
        let is_told = stderr.contains("recipe.yaml:") && stderr.contains("a name of temporary");
        assert_eq!((status == 0, !is_told), (is_taken, is_taken), "{stderr}");
        assert!(small.path(&format!("out/{folder}/touches.csv")).exists(), "{folder}");
    }
    small.write(&format!("{ours}.yaml"), &recipe);
    let printed = small.abbe(&["run", &format!("{ours}.yaml"), "--out", "out2"]);
    assert!(printed.status == 2 && printed.stderr.contains("a name of temporary"), "{}", printed.stderr);
}

#[test]
fn a_folder_without_results_is_never_taken() {
    let small = Small::new();
    for (name, text) in [("out/recipe/notes.txt", "mine"), ("out2/recipe/run.json", "{ \"abbe_run\": true }")] {
        small.write(name, text);
        let out = name.split('/').next().expect("a folder");
        let (status, stderr) = run(&small, out);
        assert!(status == 1 && stderr.contains("holds no results of a run"), "{stderr}");
        assert_eq!(small.read(name), text);
    }
    small.write("out3", "a file");
    let (status, stderr) = run(&small, "out3");
    assert!(status == 1 && stderr.contains("cannot be written"), "{stderr}");
    assert_eq!(small.read("out3"), "a file");
}

#[cfg(unix)]
#[test]
fn a_link_to_a_folder_of_results_stays_one() {
    let small = Small::new();
    fs::create_dir_all(small.path("elsewhere/results")).expect("a folder");
    fs::create_dir(small.path("out")).expect("a folder");
    std::os::unix::fs::symlink("../elsewhere/results", small.path("out/recipe")).expect("a link");
    for _ in 0..2 {
        let (status, stderr) = run(&small, "out");
        assert_eq!(status, 0, "{stderr}");
        assert!(small.path("out/recipe").is_symlink());
        assert!(small.path("elsewhere/results/run.json").exists());
    }
}

#[test]
fn a_run_that_fails_leaves_no_folder() {
    let small = Small::new();
    let touches = small.read("data/touches.csv").replacen("\n1,", "\n1,nonsense", 1);
    let broken = touches.lines().enumerate().map(|(line, text)| if line == 3 { "1,2,x" } else { text });
    small.write("data/touches.csv", &(broken.collect::<Vec<_>>().join("\n") + "\n"));
    for out in ["new", "new/deeper/still"] {
        assert_eq!(run(&small, out).0, 1);
        assert!(!small.path("new").exists());
    }
}

/// Runs that end at the same time write one after the other.
#[test]
fn two_runs_at_once_leave_the_results_of_one() {
    let small = Small::new();
    for _ in 0..6 {
        let start = |_| {
            let mut run = crate::support::program(small.folder.path(), &["run", "recipe.yaml", "--out", "out"]);
            run.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::null()).spawn().expect("a run")
        };
        let runs: Vec<_> = (0..3).map(start).collect();
        for mut run in runs {
            assert_eq!(run.wait().expect("it ends").code(), Some(0));
        }
        assert_eq!(fs::read_dir(small.path("out")).expect("a folder").count(), 1);
        fs::remove_dir_all(small.path("out")).expect("it is removed");
    }
}

/// Where hardly a file may be open, what could not be written is removed all the same.
#[cfg(unix)]
#[test]
fn a_run_that_may_open_few_files_leaves_nothing_half_written() {
    let small = Small::new();
    small.write("truth.json", "{ \"parameters\": {} }");
    let mut ends = std::collections::BTreeSet::new();
    let commands: [&[&str]; 2] = [
        &["run", "recipe.yaml", "--out", "out"],
        &["simulate", "recipe.yaml", "--truth", "truth.json", "--seed", "1", "--out", "out/simulated"],
    ];
    for (files, arguments) in (5..14).flat_map(|files| commands.map(|arguments| (files, arguments))) {
        fs::create_dir_all(small.path("out")).expect("a folder");
        let run = crate::support::program(small.folder.path(), arguments);
        let mut limited = std::process::Command::new("sh");
        limited
            .args(["-c", &format!("ulimit -n {files}; exec \"$0\" \"$@\"")])
            .arg(run.get_program())
            .args(run.get_args());
        let end = limited.current_dir(small.folder.path()).output().expect("a shell");
        let left = fs::read_dir(small.path("out")).into_iter().flatten().flatten().map(|entry| entry.file_name());
        let left: Vec<_> = left.filter(|name| name.to_string_lossy().starts_with('.')).collect();
        assert!(left.is_empty(), "{arguments:?}, {files} files: {left:?}: {}", String::from_utf8_lossy(&end.stderr));
        ends.insert(end.status.code());
        let _ = fs::remove_dir_all(small.path("out"));
    }
    assert!(ends.contains(&Some(0)) && ends.contains(&Some(1)), "{ends:?}");
}

/// What comes into the folder while the work is done costs no results: they are beside it.
#[test]
fn results_are_kept_beside_a_folder_that_somebody_has_taken_meanwhile() {
    let small = Small::new();
    let prepared = prepare(&small.path("recipe.yaml"), &registry()).expect("a recipe");
    let out = small.path("out");
    prepared.can_write(&out).expect("nothing is there");
    let outcome = prepared.run(&Monitor::default()).expect("a run");
    small.write("out/recipe/notes.txt", "mine");
    let error = outcome.write(&out).expect_err("somebody's file is there");
    let help = error.help.unwrap_or_default();
    assert!(error.message.contains("holds no results of a run") && help.contains("recipe-new-1"), "{help}");
    assert_eq!(tree(&small.path("out/recipe")), [Path::new("notes.txt")]);
    assert!(small.path("out/recipe-new-1/run.json").exists());
    assert_eq!(fs::read_dir(&out).expect("a folder").count(), 2);
    // So it is where a file has taken the name of the folder.
    small.write("out2/recipe", "mine");
    let error = outcome.write(&small.path("out2")).expect_err("somebody's file is there");
    assert!(error.help.unwrap_or_default().contains("recipe-new-1"), "{}", error.message);
    assert!(small.path("out2/recipe-new-1/run.json").exists());
    assert_eq!(small.read("out2/recipe"), "mine");
}

#[test]
fn plans_and_simulations_are_kept_beside_a_folder_that_somebody_has_taken_meanwhile() {
    let folder = temporary();
    let at = |name: &str| folder.path().join(name);
    let registry = registry();
    let plan = prepare(&recipes()["design-2d"], &registry).and_then(|prepared| prepared.plan()).expect("a plan");
    fs::write(at("truth.json"), "{ \"parameters\": {} }").expect("a file");
    let small = Small::new();
    let prepared = prepare(&small.path("recipe.yaml"), &registry).expect("a recipe");
    let simulated = prepared.simulate(&at("truth.json"), 1, None).expect("a simulation");
    let write = |name: &str| match name {
        "plan" => plan.write(&at(name)),
        _ => simulated.write(&at(name)),
    };
    for name in ["plan", "simulated"] {
        write(name).expect("nothing is there");
        let before = tree(&at(name));
        let error = write(name).expect_err("something is there");
        let place = at(name).display().to_string();
        assert!(error.message.contains(&place), "{}", error.message);
        assert!(error.help.unwrap_or_default().contains(&format!("{place}-new-1")), "{}", error.message);
        assert_eq!((tree(&at(name)), tree(&at(&format!("{name}-new-1")))), (before.clone(), before));
    }
}

#[test]
fn a_slash_behind_the_name_of_a_file_does_not_replace_it() {
    let small = Small::new();
    small.write("mine.txt", "mine");
    for name in ["mine.txt/", "mine.txt/.", "./mine.txt//"] {
        for option in ["--junit", "--markdown"] {
            let printed = small.abbe(&["test", "recipe.yaml", option, name]);
            assert!(printed.status != 0 && printed.stderr.contains("names a folder"), "{name}: {}", printed.stderr);
        }
        let printed = small.abbe(&["new", name, "--chain", "w b X Y Z t", "--method", "ball"]);
        assert!(printed.status != 0 && printed.stderr.contains("is no folder"), "{name}: {}", printed.stderr);
    }
    assert_eq!(small.read("mine.txt"), "mine");
    assert!(!small.path("mine.txt-new-1").exists());
}

/// The folder in which a command runs is not replaced under it, whatever it is called; others are written by any of their names.
#[test]
fn an_empty_folder_may_be_named_in_several_ways() {
    let folder = temporary();
    let here = folder.path().join("here");
    fs::create_dir(&here).expect("a folder");
    let new = |out: &str| abbe(&here, &["new", out, "--chain", "w b X Y Z t", "--method", "ball"]);
    for out in [".", "./", "../here", "../here/.", "../here/"] {
        let printed = new(out);
        assert!(
            printed.status == 1 && printed.stderr.contains("the folder that this command runs in"),
            "{out}: {}",
            printed.stderr
        );
        assert!(tree(&here).is_empty(), "{out}");
    }
    for out in ["new", "other/.", "third/", "link/", "deep/er/./"] {
        #[cfg(unix)]
        if out == "link/" {
            fs::create_dir(here.join("led")).expect("a folder");
            std::os::unix::fs::symlink("led", here.join("link")).expect("a link");
        }
        let printed = new(out);
        assert_eq!(printed.status, 0, "{out}: {}", printed.stderr);
        assert!(!tree(&here.join(out)).is_empty(), "{out}");
    }
    let entries = |folder: &Path| -> Vec<String> {
        let names = fs::read_dir(folder).expect("a folder").flatten().map(|entry| entry.file_name());
        let mut names: Vec<String> = names.map(|name| name.to_string_lossy().into_owned()).collect();
        names.sort();
        names
    };
    assert_eq!(entries(&here), ["deep", "led", "link", "new", "other", "third"]);
    assert_eq!(entries(folder.path()), ["here"]);
}

/// What a killed command has left is removed by the next one; what somebody else calls alike, or still writes, is not.
#[test]
fn files_of_killed_commands_are_removed() {
    let small = Small::new();
    assert_eq!(run(&small, "out").0, 0);
    for name in [".abbe-partial-AbCdEfGhIjK1", ".abbe-partial-mine", ".abbe-partial-AbCdEfGhIjK2"] {
        small.write(name, "<html>");
    }
    let written = fs::File::open(small.path(".abbe-partial-AbCdEfGhIjK2")).expect("a file");
    written.try_lock().expect("nobody else has it");
    let report = small.abbe(&["report", "out/recipe", "--out", "page.html"]);
    assert_eq!(report.status, 0, "{}", report.stderr);
    assert!(!small.path(".abbe-partial-AbCdEfGhIjK1").exists() && small.path("page.html").exists());
    assert!(small.path(".abbe-partial-mine").exists() && small.path(".abbe-partial-AbCdEfGhIjK2").exists());
}

/// A limit on the size of files is an error that is told, and not the end of the process.
#[cfg(unix)]
#[test]
fn a_limit_on_the_size_of_files_is_told() {
    let small = Small::new();
    let before = tree(small.folder.path());
    let run = crate::support::program(small.folder.path(), &["run", "recipe.yaml", "--out", "out"]);
    let program = std::process::Command::new("sh")
        .args(["-c", "ulimit -f 4; exec \"$0\" \"$@\""])
        .arg(run.get_program())
        .args(run.get_args())
        .current_dir(small.folder.path())
        .output()
        .expect("a shell");
    let stderr = String::from_utf8_lossy(&program.stderr);
    assert_eq!(program.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("larger than files may be here"), "{stderr}");
    assert_eq!(tree(small.folder.path()), before);
}

/// A name that the disk cannot take is told before the work, and leaves nothing.
#[test]
fn names_that_are_too_long_leave_nothing() {
    let small = Small::new();
    let before = tree(small.folder.path());
    let name = "x".repeat(300);
    for command in [
        vec!["run", "recipe.yaml", "--out", &name],
        vec!["new", &name, "--chain", "w C' A' b X Y Z t", "--method", "ball"],
    ] {
        let said = small.abbe(&command);
        assert!(said.status != 0 && said.stderr.contains("too long for the disk"), "{command:?}: {}", said.stderr);
        assert!(!said.stderr.contains("--out"), "{}", said.stderr);
        assert_eq!(tree(small.folder.path()), before);
    }
}

/// Names of 200 bytes and more, which leave no room for a longer one beside them; in one of them a letter of two bytes stands where it is
/// cut.
#[test]
fn results_under_long_names_are_replaced_and_kept() {
    for stem in ["n".repeat(200), "n".repeat(245), format!("{}{}", "n".repeat(199), "é".repeat(23)), "é".repeat(122)]
    {
        let small = Small::new();
        let recipe = format!("{stem}.yaml");
        small.write(&recipe, &small.read("recipe.yaml"));
        let run = || small.abbe(&["run", &recipe, "--out", "out"]);
        let place = format!("out/{stem}");
        assert_eq!(run().status, 0);
        let results = tree(&small.path(&place));
        small.write(&format!("{place}/notes.txt"), "mine");
        let again = run();
        assert_eq!(again.status, 0, "{}: {}", stem.len(), again.stderr);
        assert_eq!(small.read(&format!("{place}/notes.txt")), "mine");
        assert_eq!(tree(&small.path(&place)).len(), results.len() + 1, "{}", stem.len());
        assert_eq!(fs::read_dir(small.path("out")).expect("a folder").count(), 1, "{}", stem.len());
        // A result that somebody changed while the run went on: the new ones are kept beside it, and later runs leave them there.
        let prepared = prepare(&small.path(&recipe), &registry()).expect("a recipe");
        let outcome = prepared.run(&Monitor::default()).expect("a run");
        small.write(&format!("{place}/fine.calibration.json"), "{ \"edited\": true }");
        let error = outcome.write(&small.path("out")).expect_err("a file is in the way");
        assert!(
            error.help.as_ref().is_some_and(|help| help.contains("the results are in")),
            "{error} {:?}",
            error.help
        );
        let beside = |small: &Small| {
            let entries = fs::read_dir(small.path("out")).expect("a folder").flatten().map(|entry| entry.file_name());
            entries.filter(|name| *name != *stem).collect::<Vec<_>>()
        };
        let kept = beside(&small);
        assert!(kept.len() == 1 && kept[0].to_string_lossy().ends_with("-new-1"), "{kept:?}");
        fs::remove_file(small.path(&place).join("fine.calibration.json")).expect("a file");
        assert_eq!(run().status, 0);
        assert_eq!(beside(&small), kept);
        assert!(small.path("out").join(&kept[0]).join("fine.calibration.json").is_file());
    }
}

/// Puts a new file in the place of another one, at once: others may read it meanwhile.
fn replace(file: &Path, text: &str) {
    static COUNT: AtomicUsize = AtomicUsize::new(0);
    let new = file.with_extension(format!("new-{}", COUNT.fetch_add(1, Ordering::Relaxed)));
    fs::write(&new, text).and_then(|()| fs::rename(&new, file)).expect("a change");
}

/// Results say which content they are of: a file that somebody changes while a run goes on ends it, and the results of an earlier run stay.
#[test]
fn a_file_that_changes_during_a_run_ends_it() {
    for (file, stage) in
        [("data/touches.csv", "ingest"), ("data/facets.csv", "estimate"), ("data/machine.yaml", "estimate")]
    {
        let small = Small::new();
        let prepared = prepare(&small.path("recipe.yaml"), &registry()).expect("a recipe");
        let path = small.path(file);
        let changed = path.clone();
        let monitor = Monitor::new(move |event| {
            if matches!(event, Event::Started { kind, .. } if *kind == stage) {
                let text = fs::read_to_string(&changed).expect("a text");
                replace(&changed, &(text + "# later\n"));
            }
        });
        let error = prepared.run(&monitor).err().unwrap_or_else(|| panic!("{file} was changed and nobody said so"));
        assert!(error.message.contains("changed while the run went on"), "{file}: {error}");
        assert!(
            error.to_string().contains(path.file_name().and_then(|name| name.to_str()).expect("a name")),
            "{error}"
        );
        // The same content at another time is no change.
        let prepared = prepare(&small.path("recipe.yaml"), &registry()).expect("a recipe");
        let monitor = Monitor::new(move |event| {
            if matches!(event, Event::Started { .. }) {
                replace(&path, &fs::read_to_string(&path).expect("a text"));
            }
        });
        assert!(prepared.run(&monitor).is_ok(), "{file}");
    }
    // A recipe that is another one when its run begins.
    let small = Small::new();
    let prepared = prepare(&small.path("recipe.yaml"), &registry()).expect("a recipe");
    small.write("recipe.yaml", &(small.read("recipe.yaml") + "# later\n"));
    let error = prepared.run(&Monitor::default()).err().expect("it is not the recipe that was read");
    assert!(error.to_string().contains("recipe.yaml") && error.message.contains("changed while"), "{error}");
}

/// A result that the run reads is not changed by anybody: the message says that the run reads it.
#[test]
fn a_run_that_reads_its_own_result_says_so() {
    let small = Small::new();
    assert_eq!(run(&small, "out").0, 0);
    let earlier = "  earlier: { estimate: calibration, path: out/recipe/fine.calibration.json }\n  rough:\n";
    small.write("recipe.yaml", &small.read("recipe.yaml").replace("  rough:\n", earlier));
    let before = small.read("out/recipe/fine.calibration.json");
    let (status, stderr) = run(&small, "out");
    let said = stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
    assert!(status != 0 && said.contains("is in the way: this run reads it"), "{stderr}");
    assert!(!said.contains("did not write it") && said.contains("copy"), "{stderr}");
    assert_eq!(small.read("out/recipe/fine.calibration.json"), before);
    small.write("out/recipe/verdicts.json", "{}");
    small.write("recipe.yaml", crate::support::SMALL);
    let (status, stderr) = run(&small, "out");
    assert!(status != 0 && stderr.contains("did not write it as it is now"), "{stderr}");
}
