//! Readers of files: tables, logs of controls, files of instruments. Each reads a file, in memory where the system has such a folder.

use std::fs;
use std::path::Path;

use abbe_core::{Build, Context, Kind, Registry, Values};
use abbe_files::Packing;
use serde_json::{Value, json};

use super::Target;
use super::seeds::{file, folder};
use super::texts::text;

const LOG: &str = "pipelines/data/linuxcnc-probing/balls/measured.log";
const PLAN: &str = "pipelines/data/linuxcnc-probing/balls/plan.csv";

pub fn targets() -> Vec<Target> {
    let tables: Vec<Vec<u8>> = folder("pipelines/data", &[".csv"]).into_iter().map(head).collect();
    let mut targets = vec![
        Target::new("csv", tables.clone(), |input| {
            abbe_table::parse(Path::new("table.csv"), input).map(drop).map_err(|error| error.to_string())
        }),
        reader("csv-reader", "csv", json!({ "path": "input" }), tables.clone()),
        reader("packed-csv", "csv", json!({ "path": "input" }), packed(&tables)),
        survey(tables),
    ];
    // A program without the libraries of these formats refuses them.
    for plugin in ["parquet", "arrow-ipc"] {
        let settings = json!({ "path": "input", "no_data": [""] });
        targets.push(reader(plugin, plugin, settings, folder(&format!("tests/fuzz/seeds/{plugin}"), &[""])));
    }
    for control in ["linuxcnc", "dprnt", "siemens", "heidenhain"] {
        let plugin = if control == "dprnt" { control.to_owned() } else { format!("{control}-log") };
        let settings = json!({ "path": "input", "plan": "plan.csv", "tool_length_mm": 0 });
        targets.push(reader(&plugin, &plugin, settings, vec![log(control)]));
    }
    let settings = json!({ "path": "input", "plan": "plan.csv" });
    targets.push(reader("grbl-log", "grbl-log", settings, vec![console()]));
    for (plugin, more) in [
        ("inspection-g800", json!({ "units": "mm" })),
        ("dmis-output", json!({})),
        ("qif-results", json!({})),
        ("iso230-dat", json!({ "values": "positions", "units": "mm" })),
        ("probe-csv", json!({ "units": "mm" })),
    ] {
        let mut settings = json!({ "path": "input" });
        settings.as_object_mut().expect("a map").extend(more.as_object().expect("a map").clone());
        targets.push(reader(plugin, plugin, settings, folder(&format!("tests/fuzz/seeds/{plugin}"), &[""])));
    }
    let mut settings = registry().find(Kind::Ingest, "text").expect("a reader").example.get().clone();
    settings["path"] = json!("input");
    targets.push(reader("text", "text", settings, folder("tests/fuzz/seeds/text", &[""])));
    targets
}

fn registry() -> Registry {
    Registry::built_in().expect("plugins")
}

/// The first lines of a table.
fn head(table: Vec<u8>) -> Vec<u8> {
    table.split_inclusive(|byte| *byte == b'\n').take(12).flatten().copied().collect()
}

/// Tables as gzip and Zstandard pack them.
fn packed(tables: &[Vec<u8>]) -> Vec<Vec<u8>> {
    let ways = [Packing::Gzip, Packing::Zstandard];
    ways.into_iter().flat_map(|packing| tables.iter().map(move |table| packing.pack(table.clone()))).collect()
}

/// A folder in memory, if there is one.
fn memory() -> tempfile::TempDir {
    let shared = Path::new("/dev/shm");
    let made = if shared.is_dir() { tempfile::tempdir_in(shared) } else { tempfile::tempdir() };
    made.expect("a temporary folder")
}

/// A reader that finds its input in the file `input` beside a plan.
fn reader(name: &str, plugin: &str, settings: Value, seeds: Vec<Vec<u8>>) -> Target {
    let folder = memory();
    fs::write(folder.path().join("plan.csv"), file(PLAN)).expect("the plan can be written");
    let (registry, plugin) = (registry(), plugin.to_owned());
    Target::new(name, seeds, move |input| {
        fs::write(folder.path().join("input"), input).expect("the input can be written");
        let plugin = registry.find(Kind::Ingest, &plugin).map_err(|error| error.to_string())?;
        let Build::Ingest(constructor) = &plugin.build else { unreachable!() };
        let stage = constructor.build(&settings, &Context { base: folder.path().to_owned() });
        let stage = stage.map_err(|error| error.to_string())?;
        let data = stage.headers().and_then(|_| stage.read()).map_err(|error| error.to_string())?;
        for column in &data.columns {
            let cells = match &column.values {
                Values::Numbers(numbers) => numbers.len(),
                Values::Labels(labels) => labels.len(),
            };
            assert_eq!(cells, data.rows(), "cells of a column");
        }
        Ok(())
    })
}

/// What a file seems to be, and what is in it then.
fn survey(seeds: Vec<Vec<u8>>) -> Target {
    let folder = memory();
    Target::new("survey", seeds, move |input| {
        let path = folder.path().join("input");
        fs::write(&path, input).expect("the input can be written");
        let likely = abbe_table::likely(&path).map_err(|error| error.to_string())?;
        abbe_table::contents(&path, &likely.layout).map(drop).map_err(|error| error.to_string())
    })
}

/// The log of a measurement on LinuxCNC in the manner of another control.
fn log(control: &str) -> Vec<u8> {
    let log = String::from_utf8(file(LOG)).expect("a log");
    let written = match control {
        "dprnt" => log.replace("CONTROL LINUXCNC", "CONTROL FANUC"),
        "siemens" => {
            format!("%_N_LOG_MPF\n;$PATH=/_N_MPF_DIR\n{}", log.replace("CONTROL LINUXCNC", "CONTROL SIEMENS"))
        }
        "heidenhain" => log.replace("CONTROL LINUXCNC", "CONTROL HEIDENHAIN").replace('.', ","),
        _ => log,
    };
    written.into_bytes()
}

/// The console of a host that sent the same measurement to grbl.
fn console() -> Vec<u8> {
    let log = file(LOG);
    let log = text(&log);
    let mut console = "Grbl 1.1h ['$' for help]\nok\n".to_owned();
    for line in log.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        if !matches!(words.first(), Some(first) if first.starts_with('T') && words.len() > 4) {
            let said = line.replace("CONTROL LINUXCNC", "CONTROL GRBL");
            if !said.starts_with("END") && !said.starts_with("TOOL ") {
                console.push_str(&format!("({said})\nok\n"));
            }
            continue;
        }
        let number = |letter: char| words.iter().find_map(|word| word.strip_prefix(letter)).unwrap_or("0");
        let (x, y, z) = (number('X'), number('Y'), number('Z'));
        let block: usize = number('T').parse::<usize>().expect("a number of a touch") * 100 + 1;
        console.push_str(&format!("N{block} G91 G38.3 X1 F30\n[PRB:{x},{y},{z}:1]\nok\n"));
    }
    (console + "(END)\nok\n").into_bytes()
}
