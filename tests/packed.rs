//! Tables that gzip or Zstandard has packed: they mean what is packed, whatever their names are.

use std::fs;
use std::path::{Path, PathBuf};

use abbe_files::Packing;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::support::{Variant, abbe, json_file, read, recipes, temporary, write};

/// The recipe of these tests with other touches.
pub fn with_touches(ingest: &str, path: &Path) -> Variant {
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    recipe.stage("touches")["ingest"] = json!(ingest);
    recipe.stage("touches")["path"] = json!(path);
    recipe
}

/// The touches of the recipe, as they are in the repository.
pub fn touches() -> PathBuf {
    Variant::of(&recipes()["first-steps"]).path("touches", "path")
}

/// What a run of a recipe finds, without the names and hashes of its data, and without the lines of files that have none.
pub fn found(recipe: &Variant, folder: &Path) -> Value {
    let file = recipe.write(folder);
    let out = folder.join("out");
    let printed = abbe(folder, &["run".as_ref(), file.as_os_str(), "--out".as_ref(), out.as_os_str()]);
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    let mut calibration = json_file(&out.join("recipe/fit.calibration.json"));
    let data = calibration["data"].as_array_mut().expect("the data");
    assert_eq!(data.len(), 1);
    data[0]["file"] = Value::Null;
    data[0]["sha256"] = Value::Null;
    for outlier in calibration["outliers"].as_array_mut().expect("outliers") {
        outlier["file"] = Value::Null;
        outlier["line"] = Value::Null;
    }
    calibration
}

/// A table with one column of it negated.
pub fn negated(text: &str, column: &str) -> String {
    let mut place = None;
    let line = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        match place {
            None if line.starts_with('#') => {}
            None => place = cells.iter().position(|cell| cell == column),
            Some(at) => cells[at] = (-cells[at].parse::<f64>().expect("a number")).to_string(),
        }
        cells.join(",") + "\n"
    };
    let negated = text.lines().map(line).collect();
    assert!(place.is_some());
    negated
}

const PACKINGS: [(Packing, &str); 2] = [(Packing::Gzip, "gz"), (Packing::Zstandard, "zst")];

#[test]
fn packed_tables_give_the_same_calibration() {
    let folder = temporary();
    let text = read(&touches());
    let expected = found(&with_touches("csv", &touches()), folder.path());
    for (packing, ending) in PACKINGS {
        // The content decides: the name may be that of a table that is not packed.
        for name in [format!("touches.csv.{ending}"), "touches.csv".to_owned()] {
            let file = folder.path().join(&name);
            let packed = packing.pack(text.clone().into_bytes());
            assert!(packed.len() < text.len() / 2);
            fs::write(&file, &packed).expect("a file");
            assert_eq!(found(&with_touches("csv", &file), folder.path()), expected, "{name}");
            // The hash is that of the file on the disk.
            let record = json_file(&folder.path().join("out/recipe/run.json"));
            let inputs = record["inputs"].as_array().expect("inputs");
            let own = inputs.iter().find(|input| input["file"].as_str().is_some_and(|own| own.ends_with(&name)));
            let hash: String = Sha256::digest(&packed).iter().map(|byte| format!("{byte:02x}")).collect();
            assert_eq!(own.expect("the file")["sha256"], json!(hash));
        }
        let file = folder.path().join("turned.csv");
        fs::write(&file, packing.pack(negated(&text, "time_s").into_bytes())).expect("a file");
        let turned = found(&with_touches("csv", &file), folder.path());
        assert_eq!(turned["parameters"], expected["parameters"]);
        fs::write(&file, packing.pack(negated(&text, "dir_X").into_bytes())).expect("a file");
        assert_ne!(found(&with_touches("csv", &file), folder.path()), expected);
    }
}

#[test]
fn messages_name_the_line_of_what_is_packed() {
    let folder = temporary();
    let cut = read(&touches()).replacen("-17", "-17x", 1);
    let line = 1 + cut.lines().position(|line| line.contains("-17x")).expect("a line");
    for (packing, ending) in PACKINGS {
        let file = folder.path().join(format!("touches.csv.{ending}"));
        let packed = packing.pack(cut.clone().into_bytes());
        fs::write(&file, &packed).expect("a file");
        let run = || {
            let recipe = with_touches("csv", &file).write(folder.path());
            let printed = abbe(folder.path(), &["run".as_ref(), recipe.as_os_str()]);
            (printed.status, printed.stderr)
        };
        let (status, said) = run();
        assert!(status != 0 && said.contains("a number was expected"), "{said}");
        assert!(said.contains(&format!("touches.csv.{ending}:{line}:")), "{said}");
        fs::write(&file, &packed[..packed.len() / 2]).expect("a file");
        let (status, said) = run();
        assert!(status != 0 && said.contains("it is packed by") && said.contains("pack the table again"), "{said}");
    }
}

#[test]
fn a_simulation_packs_what_was_packed() {
    let folder = temporary();
    let truth = crate::support::root().join("tests/truth/tango-hu40t-realistic.json");
    let simulated = |file: &Path, name: &str| {
        let recipe = with_touches("csv", file).write(folder.path());
        let out = folder.path().join(name);
        let arguments = ["simulate", "--truth", "--seed", "7", "--out"];
        let [command, of_truth, seed, number, of_out] = arguments.map(std::ffi::OsStr::new);
        let printed = abbe(
            folder.path(),
            &[command, recipe.as_os_str(), of_truth, truth.as_os_str(), seed, number, of_out, out.as_os_str()],
        );
        assert_eq!(printed.status, 0, "{}", printed.stderr);
        let found = crate::support::tree(&out).into_iter().find(|file| file.to_string_lossy().contains("touches"));
        fs::read(out.join(found.expect("the touches"))).expect("a file")
    };
    let expected = simulated(&touches(), "plain");
    for (packing, ending) in PACKINGS {
        let file = folder.path().join(format!("touches.csv.{ending}"));
        fs::write(&file, packing.pack(fs::read(touches()).expect("touches"))).expect("a file");
        let (content, found) = abbe_files::content_of(simulated(&file, ending)).expect("a packed table");
        assert_eq!((content, found), (expected.clone(), packing));
    }
}

#[test]
fn the_file_of_a_row_has_the_same_name_when_it_is_packed() {
    let folder = temporary();
    write(&folder.path().join("one.csv"), "X_mm,feature\n1,a\n");
    let packed = Packing::Gzip.pack(b"X_mm,feature\n2,b\n".to_vec());
    fs::write(folder.path().join("two.csv.gz"), packed).expect("a file");
    let context = abbe_core::Context { base: folder.path().to_owned() };
    let registry = crate::support::registry();
    let plugin = registry.find(abbe_core::Kind::Ingest, "csv").expect("csv");
    let abbe_core::Build::Ingest(constructor) = &plugin.build else { panic!("csv is an ingest plugin") };
    write(&folder.path().join("table.csv"), "file,cycle\none.csv,1\ntwo.csv,2\n");
    let settings = json!({ "path": ["one.csv", "two.*"], "join": { "table": "table.csv", "on": "file" } });
    let data = constructor.build(&settings, &context).expect("a stage").read().expect("data");
    assert_eq!(data.labels("file").expect("files"), ["one", "two"]);
    assert_eq!(data.labels("cycle").expect("cycles"), ["1", "2"]);
}
