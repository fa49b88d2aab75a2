//! `abbe history`: what is added is there once, whoever is killed and however many write.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::support::{Printed, Small, abbe, printed, program, read, root, temporary, write};

/// A history that commands name, and the password of its server.
pub struct Plant {
    pub place: String,
    pub password: Option<String>,
}

impl Plant {
    fn file() -> Self {
        Self { place: "plant.sqlite".to_owned(), password: None }
    }

    pub fn program(&self, small: &Small, arguments: &[&str]) -> Command {
        let mut command = program(&small.path(""), arguments);
        command.env("COLUMNS", "10000").envs(self.password.iter().map(|password| ("PGPASSWORD", password)));
        command
    }

    pub fn abbe(&self, small: &Small, arguments: &[&str]) -> Printed {
        printed(&mut self.program(small, arguments))
    }
}

/// Results that differ in one name, so that each is an entry of its own.
pub fn results(small: &Small, count: usize) -> Vec<String> {
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "out"]).status, 0);
    let name = |number: usize| format!("results-{number}");
    for number in 0..count {
        for file in ["run.json", "verdicts.json", "rough.calibration.json", "fine.calibration.json"] {
            let text = read(&small.path(&format!("out/recipe/{file}")));
            let text = text.replace("\"iterations\": ", &format!("\"iterations\": 1{number}"));
            write(&small.path(&format!("{}/{file}", name(number))), &text);
        }
        record(&small.path(&name(number)));
    }
    (0..count).map(name).collect()
}

/// Makes the record of a run that of the files as they are now.
fn record(folder: &Path) {
    let file = folder.join("run.json");
    let mut run: Value = serde_json::from_str(&read(&file)).expect("a record");
    for output in run["outputs"].as_array_mut().expect("files") {
        if let Ok(content) = fs::read(folder.join(output["file"].as_str().expect("a name"))) {
            let hash = Sha256::digest(content);
            output["sha256"] = hash.iter().map(|byte| format!("{byte:02x}")).collect::<String>().into();
        }
    }
    write(&file, &run.to_string());
}

fn entries(small: &Small, plant: &Plant) -> usize {
    let listed = plant.abbe(small, &["history", "list", &plant.place]);
    assert_eq!(listed.status, 0, "{}", listed.stderr);
    listed.stdout.lines().filter(|line| line.starts_with(' ')).count()
}

#[test]
fn what_is_added_is_there_once_and_comes_back() {
    comes_back(&Plant::file());
}

/// Commands add, list, show and export; what cannot be done is told with its exit status.
pub fn comes_back(plant: &Plant) {
    let small = Small::new();
    let place = plant.place.as_str();
    let all = results(&small, 3);
    for (folder, told) in [(&all[0], "entry 1"), (&all[1], "entry 2"), (&all[0], "is entry 1 already")] {
        let added = plant.abbe(&small, &["history", "add", place, folder]);
        assert!(added.status == 0 && added.stdout.contains(told), "{} {}", added.stdout, added.stderr);
    }
    assert_eq!(entries(&small, plant), 2);
    let shown = plant.abbe(&small, &["history", "show", place, "2"]);
    assert!(shown.status == 0 && shown.stdout.contains("fine with"), "{}", shown.stdout);
    assert_eq!(plant.abbe(&small, &["history", "export", place, "2", "--out", "copy"]).status, 0);
    let file = "fine.calibration.json";
    assert_eq!(small.read(&format!("copy/{file}")), small.read(&format!("{}/{file}", all[1])));
    assert_eq!(plant.abbe(&small, &["history", "show", place, "9"]).status, 2);
    assert_eq!(plant.abbe(&small, &["history", "add", place, "data"]).status, 2);
    assert_eq!(entries(&small, plant), 2);
}

#[test]
fn a_recipe_keeps_what_it_finds_once() {
    kept_by_a_recipe(&Plant::file());
}

/// The key `history` of a recipe keeps what every run finds, once. No result has the password.
pub fn kept_by_a_recipe(plant: &Plant) {
    let small = Small::new();
    let recipe = small.read("recipe.yaml");
    small.write("recipe.yaml", &recipe.replacen("stages:", &format!("history: {}\nstages:", plant.place), 1));
    for _ in 0..2 {
        let run = plant.abbe(&small, &["run", "recipe.yaml", "--out", "out"]);
        assert_eq!(run.status, 0, "{}", run.stderr);
        assert_eq!(entries(&small, plant), 1);
    }
    let Some(password) = &plant.password else { return };
    for file in fs::read_dir(small.path("out/recipe")).expect("results").flatten() {
        let content = fs::read(file.path()).unwrap_or_default();
        assert!(!String::from_utf8_lossy(&content).contains(password.as_str()), "{}", file.path().display());
    }
}

#[test]
fn a_history_that_is_not_there_is_told() {
    let small = Small::new();
    assert_eq!(small.abbe(&["history", "list", "absent.sqlite"]).status, 2);
    let listed = small.abbe(&["history", "list", "http://plant/abbe"]);
    assert!(listed.status == 2 && listed.stderr.contains("postgres://USER@HOST/DATABASE"), "{}", listed.stderr);
}

/// A history that cannot be made is told before a run, and not after it.
#[test]
fn a_history_whose_folder_is_not_there_is_told_first() {
    let small = Small::new();
    let recipe = small.read("recipe.yaml");
    std::os::unix::fs::symlink("circle.sqlite", small.path("circle.sqlite")).expect("a link");
    for place in ["absent/own.sqlite", "recipe.yaml/own.sqlite", "circle.sqlite"] {
        small.write("recipe.yaml", &recipe.replacen("stages:", &format!("history: {place}\nstages:"), 1));
        for arguments in [&["run", "recipe.yaml", "--out", "out"][..], &["check", "recipe.yaml"]] {
            let refused = small.abbe(arguments);
            assert!(matches!(refused.status, 1 | 2), "{place} {arguments:?}: {}", refused.stderr);
            let name = place.rsplit('/').next().expect("a name");
            assert!(refused.stderr.contains(name), "{}", refused.stderr);
            assert!(!small.path("out").exists() && !small.path("absent").exists());
        }
    }
}

/// A password in an address is refused wherever it stands, and no message repeats it.
#[test]
fn passwords_stand_in_no_address_and_in_no_message() {
    let small = Small::new();
    let recipe = small.read("recipe.yaml");
    for address in ["postgres://me:geheim@plant/abbe", "postgres://plant/abbe?user=me&password=geheim"] {
        small.write("recipe.yaml", &recipe.replacen("stages:", &format!("history: {address}\nstages:"), 1));
        for arguments in [
            &["run", "recipe.yaml", "--out", "out"][..],
            &["check", "recipe.yaml"],
            &["history", "list", address],
            &["history", "check", address, "--json"],
            &["history", "add", address, "out/recipe"],
            &["serve", address],
        ] {
            let refused = small.abbe(arguments);
            assert_eq!(refused.status, 2, "{arguments:?}: {}", refused.stderr);
            let told = refused.stdout + &refused.stderr;
            assert!(told.contains("PGPASSWORD") && !told.contains("geheim"), "{arguments:?}: {told}");
        }
    }
}

#[test]
fn killed_writers_lose_and_double_nothing() {
    killed_writers(&Plant::file());
}

/// A hundred writers are killed at random moments, two at a time; then everything is added once more. All is there, each once.
pub fn killed_writers(plant: &Plant) {
    const KILLS: u64 = 100;
    const ENTRIES: usize = 12;
    let small = Small::new();
    let all = results(&small, ENTRIES);
    let begun = Instant::now();
    let add = |from: usize| {
        let mut arguments = vec!["history", "add", &plant.place];
        arguments.extend((0..ENTRIES).map(|number| all[(from + number) % ENTRIES].as_str()));
        plant.program(&small, &arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("a program")
    };
    let (mut state, mut whole, mut before) = (1_u64, 0, 0);
    for kill in 0..KILLS / 2 {
        let mut writers = [add(kill as usize), add(kill as usize + 5)];
        for writer in &mut writers {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sleep(Duration::from_micros((state >> 33) % 120_000));
            // SIGKILL: nothing is tidied up.
            writer.kill().expect("a program can be killed");
            whole += usize::from(writer.wait().expect("an end").success());
        }
        let listed = plant.abbe(&small, &["history", "list", &plant.place]);
        // Until the first entry is in it there is no history.
        let none = ["does not exist", "holds no history"].iter().any(|none| listed.stderr.contains(none));
        assert!(listed.status == 0 || (none && before == 0), "{}", listed.stderr);
        let found = listed.stdout.lines().filter(|line| line.starts_with(' ')).count();
        assert!(found >= before && found <= ENTRIES, "{before} entries, then {found}");
        before = found;
        assert!(begun.elapsed() < Duration::from_secs(300));
    }
    assert!(whole < KILLS as usize, "no writer was killed");
    assert!(add(0).wait().expect("an end").success());
    assert_eq!(entries(&small, plant), ENTRIES);
    for number in 1..=ENTRIES {
        assert_eq!(plant.abbe(&small, &["history", "show", &plant.place, &number.to_string()]).status, 0);
    }
}

#[test]
fn a_check_needs_to_know_what_was_repeated() {
    let small = Small::new();
    let all = results(&small, 6);
    for (number, folder) in all.iter().enumerate() {
        let date = format!("2026-01-{:02}", 1 + 7 * number % 28);
        let added = small.abbe(&["history", "add", "plant.sqlite", folder, "--date", &date]);
        assert_eq!(added.status, 0, "{}", added.stderr);
    }
    let check = small.abbe(&["history", "check", "plant.sqlite"]);
    assert!(check.status == 2 && check.stderr.contains("--estimate"), "{}", check.stderr);
    let check = small.abbe(&["history", "check", "plant.sqlite", "--machine", "nobody"]);
    assert!(check.status == 2 && check.stderr.contains("plant.sqlite has no machine `nobody`"), "{}", check.stderr);
    assert!(check.stderr.contains("its machines are: "), "{}", check.stderr);
    let shown = small.abbe(&["history", "show", "plant.sqlite", "99"]);
    assert!(shown.stderr.contains("plant.sqlite has no entry 99"), "{}", shown.stderr);
    let check = small.abbe(&["history", "check", "plant.sqlite", "--estimate", "fine", "--limit", "EX0C=3furlong"]);
    assert!(check.status == 2 && check.stderr.contains("no unit"), "{}", check.stderr);
    let added = small.abbe(&["history", "add", "absent/plant.sqlite", &all[0]]);
    assert!(added.status != 0 && added.stderr.contains("its folder does not exist"), "{}", added.stderr);
    assert!(!small.path("absent").exists());
}

/// No machine repeats to the last digit: the rows are those of another test, in whatever file.
#[test]
fn tests_that_are_copies_are_told() {
    let folder = temporary();
    let positioner = crate::support::Variant::of(&crate::support::recipes()["positioner"]);
    let recipe = read(&positioner.write(folder.path()));
    let at = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let asked = |arguments: &[&str]| abbe(folder.path(), arguments);
    for (name, date) in [("first", "2026-03-01"), ("second", "2026-03-02")] {
        write(&folder.path().join(format!("{name}.yaml")), &recipe);
        let run = asked(&["run", &at(&format!("{name}.yaml")), "--out", "out"]);
        assert_eq!(run.status, 0, "{}", run.stderr);
        let add = ["history", "add", &at("plant.sqlite"), &format!("out/{name}"), "--machine", "mill", "--date", date];
        let added = asked(&add);
        assert_eq!(added.status, 0, "{}", added.stderr);
    }
    let checked = asked(&["history", "check", &at("plant.sqlite"), "--estimate", "fit"]);
    assert!(checked.stdout.contains("to the last digit: are its rows those of"), "{}", checked.stdout);
}

#[test]
fn machines_that_cannot_be_the_same_are_no_history() {
    let small = Small::new();
    let all = results(&small, 2);
    let refused = small.abbe(&["history", "add", "plant.sqlite", &all[0], "--machine", " "]);
    assert!(refused.status == 2 && refused.stderr.contains("a name was expected"), "{}", refused.stderr);
    // The second is of a machine whose table turns about another axis.
    for file in ["fine.calibration.json", "rough.calibration.json"] {
        let file = small.path(&format!("{}/{file}", all[1]));
        let text = read(&file);
        let chain = text.lines().find(|line| line.contains("\"chain\"")).expect("a chain");
        write(&file, &text.replacen(chain, &chain.replace('B', "A"), 1));
        assert_ne!(text, read(&file), "{chain}");
    }
    record(&small.path(&all[1]));
    for (number, folder) in all.iter().enumerate() {
        let date = format!("2026-01-0{}", 1 + number);
        let added = small.abbe(&["history", "add", "plant.sqlite", folder, "--date", &date, "--machine", "mill"]);
        assert_eq!(added.status, 0, "{}", added.stderr);
    }
    let check = small.abbe(&["history", "check", "plant.sqlite", "--estimate", "fine"]);
    assert!(check.status == 1 && check.stderr.contains("different machines"), "{} {}", check.stdout, check.stderr);
}

/// What `validate: trend` tells of the weeks in one run, `check` tells of the same weeks in a history.
#[test]
fn a_check_of_forty_weeks_is_an_alarm() {
    let folder = temporary();
    let at = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (out, plant, results) = (at("out"), at("plant.sqlite"), at("out/history"));
    let asked = |arguments: &[&str]| abbe(&root(), arguments);
    assert_eq!(asked(&["run", "pipelines/history.yaml", "--out", &out]).status, 0);
    assert_eq!(asked(&["history", "add", &plant, &results]).status, 0);
    let check = ["history", "check", &plant, "--baseline", "baseline", "--limit", "EXX[b]=4.5um"];
    let checked = asked(&check);
    assert_eq!((checked.status, checked.stderr.as_str()), (3, ""), "{}", checked.stdout);
    for told in
        ["jump in week 23: EY0C", "EB0A -45", "week 14 is rejected", "week 18 has no test", "for 3 weeks", "drift"]
    {
        assert!(checked.stdout.contains(told), "{told}: {}", checked.stdout);
    }
    // With the temperatures the season is none; the volumetric error is a limit like any other, and the future may be a walk.
    let temperature = root().join("pipelines/data/history/realistic/temperature.csv").to_string_lossy().into_owned();
    let follows = ["--from", &temperature, "--follows", "EYY[1]=T01@20"];
    let limits = ["--volumetric", "3", "--limit", "volumetric largest=150um", "--forecast", "random-walk"];
    let checked = asked(&[&check[..], &follows, &limits].concat());
    assert_eq!((checked.status, checked.stderr.as_str()), (3, ""), "{}", checked.stdout);
    for told in [
        "EYY[1] follows T01 by +2.66",
        "for 4 weeks",
        "volumetric largest keeps 150 µm with a risk of 5 % for 15 weeks",
    ] {
        assert!(checked.stdout.contains(told), "{told}: {}", checked.stdout);
    }
    assert!(!checked.stdout.contains("jump in week 30"), "{}", checked.stdout);
    for (wrong, told) in [
        (["--from", &temperature, "--follows", "EYY[1]"], "EYY[1]=T01@20"),
        (["--from", &temperature, "--follows", "EYY[1]=T99@20"], "T99"),
        (["--from", &temperature, "--follows", "nothing=T01@20"], "nothing"),
        (["--from", &at("absent.csv"), "--follows", "EYY[1]=T01@20"], "absent.csv"),
        (["--volumetric", "0", "--limit", "EXX[b]=1um"], "at least one point"),
        (["--risk", "nan", "--forecast", "line"], "a probability above 0 and below 0.5"),
        (["--risk", "0.5", "--forecast", "line"], "a probability above 0 and below 0.5"),
    ] {
        let refused = asked(&[&check[..], &wrong].concat());
        assert!([1, 2].contains(&refused.status) && refused.stderr.contains(told), "{wrong:?}: {}", refused.stderr);
    }
    let copy = at("copy");
    assert_eq!(asked(&["history", "export", &plant, "1", "--out", &copy]).status, 0);
    let name = "weekly.week-14.calibration.json";
    assert_eq!(read(&folder.path().join("copy").join(name)), read(&folder.path().join("out/history").join(name)));
}
