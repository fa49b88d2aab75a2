//! What crosses the border: its schemas in `docs/schemas/plugin` are those of the program, and the examples beside them were said.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use abbe_core::{Build, Context, Monitor, Registry};
use abbe_engine::prepare;
use abbe_plugin::messages::{FAILURE, Message, listen, schemas};
use jsonschema::Validator;
use serde_json::{Map, Value, json};

use super::cargo_library;
use super::same_results::{by_vendor, six_kinds, with_renamed};
use crate::support::{Variant, abbe, files_in, json_file, read, root, temporary, write};

fn folder() -> PathBuf {
    root().join("docs/schemas/plugin")
}

/// A recipe that is small enough to be read in examples: two facets with two touches each, four lengths, two scales.
fn small(folder: &Path) -> Variant {
    write(&folder.join("facets.csv"), "feature,x_mm,y_mm,z_mm,nx,ny,nz\n1,100,0,0,1,0,0\n2,0,80,0,0,1,0\n");
    write(
        &folder.join("touches.csv"),
        "touch,feature,X_mm,Y_mm,Z_mm\n1,1,102.004,0,0\n2,1,102.002,0,0\n3,2,0,82.001,0\n4,2,0,82.003,0\n",
    );
    write(
        &folder.join("lengths.csv"),
        "length,X1_mm,Y1_mm,Z1_mm,X2_mm,Y2_mm,Z2_mm,reference_mm\n1,0,0,0,100.003,0,0,100\n2,0,0,0,200.005,0,0,200\n\
         3,0,0,0,0,100.001,0,100\n4,0,0,0,0,200.004,0,200\n",
    );
    Variant(json!({ "abbe": 1, "name": "Two scales", "stages": {
        "touches": { "ingest": "csv", "path": "touches.csv" },
        "runs": { "ingest": "csv", "path": "lengths.csv" },
        "table": { "artefact": "facets", "from": "touches", "nominal": "facets.csv", "standard_uncertainty_um": 1.5 },
        "bar": { "artefact": "length", "from": "runs", "standard_uncertainty_um": 1.0 },
        "machine": {
            "model": "serial-chain", "chain": "w b X Y Z t", "tool_length_mm": 100.0, "stylus_radius_mm": 2.0,
            "axes": { "X": { "range_mm": [0, 200] }, "Y": { "range_mm": [0, 200] }, "Z": { "range_mm": [-10, 10] } },
            "errors": [{ "polynomial": ["EXX", "EYY"], "degrees": [1] }],
        },
        "fit": { "estimate": "gauss-newton", "machine": "machine", "observations": ["table", "bar"],
                 "parameters": ["EXX[1]", "EYY[1]", "table.*"] },
        "judge": { "validate": "residuals", "of": "fit", "limits": { "max_um": 10 } },
        "unseen": { "validate": "hold-out", "of": "fit", "rows": "bar", "column": "length", "folds": [["1"], ["3"]] },
        "trials": { "estimate": "monte-carlo", "of": "fit", "trials": 200, "coverage_probability": 0.5, "seed": 1 },
        "written": { "export": "error-table", "of": "fit", "step_mm": 200 },
    } }))
}

/// What was heard: the shortest message of each name that says something, and what is not as its schema says.
#[derive(Default)]
struct Heard {
    shortest: BTreeMap<String, Value>,
    wrong: BTreeSet<String>,
    count: usize,
}

impl Heard {
    fn hear(&mut self, validators: &BTreeMap<String, Validator>, message: Message) {
        self.count += 1;
        let Message { name, question, answer, failure, .. } = message;
        let said = answer.map(|answer| (name, json!({ "question": question, "answer": answer })));
        for (name, value) in said.into_iter().chain(failure.map(|failure| (FAILURE, failure))) {
            let errors = validators[name].iter_errors(&value);
            self.wrong.extend(errors.take(3).map(|error| format!("{name}: {}: {error}", error.instance_path())));
            let is_empty = |value: &Value| value["answer"].is_null() || value["answer"] == json!([]);
            let key = |value: &Value| (is_empty(value), value.to_string().len(), value.to_string());
            match self.shortest.get(name) {
                Some(shorter) if key(shorter) <= key(&value) => {}
                _ => drop(self.shortest.insert(name.to_owned(), value)),
            }
        }
    }
}

/// Runs recipes by a library of all built-in plugins, and gives what was heard of it: all of the small recipe, of others whether it is
/// as schemas say.
fn heard() -> Heard {
    let here = temporary();
    let library = here.path().join("librecorded.so");
    fs::copy(cargo_library("abbe-stock-library"), &library).expect("a copy of the library");
    let validators = schemas().into_iter().map(|(name, schema)| {
        (name, jsonschema::validator_for(&schema).unwrap_or_else(|error| panic!("no JSON Schema: {error}")))
    });
    let validators: BTreeMap<String, Validator> = validators.collect();
    let heard: Arc<Mutex<Heard>> = Arc::default();
    let writes = heard.clone();
    listen(move |message| {
        if message.who.contains("librecorded.so") {
            writes.lock().expect("no panic").hear(&validators, message);
        }
    });
    let registry = with_renamed(abbe_plugin::load(&library, None).expect("it loads"));

    let recipe = small(here.path());
    let by_vendor_alone = by_vendor(&recipe);
    // Built-in validators and trials ask the library's estimator.
    let mut mixed = by_vendor_alone.clone();
    for (stage, kind) in [("unseen", "validate"), ("trials", "estimate")] {
        mixed.0["stages"][stage][kind] = recipe.0["stages"][stage][kind].clone();
    }
    for recipe in [&by_vendor_alone, &mixed] {
        run(recipe, here.path(), &registry);
    }
    let facets = registry.find(abbe_core::Kind::Artefact, "vendor-facets").expect("the artefact");
    let Build::Artefact(constructor) = &facets.build else { panic!("it is an artefact") };
    let settings = json!({ "nominal": "facets.csv", "standard_uncertainty_um": 1.5 });
    let artefact = constructor.build(&settings, &Context { base: here.path().to_owned() }).expect("it is built");
    artefact.targets(2.0).expect("a programme");
    let touches = read(&here.path().join("touches.csv"));
    write(&here.path().join("touches.csv"), &touches.replace("X_mm", "X"));
    let failed = prepare(&by_vendor_alone.write(here.path()), &registry).and_then(|prepared| prepared.check());
    assert!(failed.is_err(), "a column without a unit is refused");
    let examples = heard.lock().expect("no panic").shortest.clone();

    let other = temporary();
    run(&by_vendor(&six_kinds()), other.path(), &registry);
    let mut heard = std::mem::take(&mut *heard.lock().expect("no panic"));
    heard.shortest = examples.into_iter().map(|(name, value)| (name, without(here.path(), &value))).collect();
    heard
}

fn run(recipe: &Variant, folder: &Path, registry: &Registry) {
    let prepared = prepare(&recipe.write(folder), registry).unwrap_or_else(|error| panic!("{error}"));
    prepared.check().unwrap_or_else(|error| panic!("{error}"));
    prepared.run(&Monitor::default()).unwrap_or_else(|error| panic!("{error}"));
}

/// The same with another name of a folder.
fn without(folder: &Path, value: &Value) -> Value {
    let text = value.to_string().replace(&*folder.to_string_lossy(), "/home/vendor");
    serde_json::from_str(&text).expect("JSON")
}

/// JSON with what is short in one line.
fn text(value: &Value, indent: usize) -> String {
    const WIDTH: usize = 110;
    let line = value.to_string();
    let deeper = "  ".repeat(indent + 1);
    let items: Vec<String> = match value {
        Value::Array(items) if line.len() > WIDTH => items.iter().map(|item| text(item, indent + 1)).collect(),
        Value::Object(map) if line.len() > WIDTH => {
            map.iter().map(|(key, item)| format!("{}: {}", json!(key), text(item, indent + 1))).collect()
        }
        _ => return line,
    };
    let [open, close] = if value.is_array() { ["[", "]"] } else { ["{", "}"] };
    let items: Vec<String> = items.iter().map(|item| format!("\n{deeper}{item}")).collect();
    format!("{open}{}\n{}{close}", items.join(","), "  ".repeat(indent))
}

/// Where two values differ by more than the last digits.
fn differences(one: &Value, other: &Value, at: &str, found: &mut Vec<String>) {
    let close = |one: f64, other: f64| (one - other).abs() <= 1e-9 + 1e-6 * one.abs();
    match (one, other) {
        (Value::Number(one), Value::Number(other)) => {
            let near = one.as_f64().zip(other.as_f64()).is_some_and(|(one, other)| close(one, other));
            found.extend((!near).then(|| format!("{at}: {one} and {other}")));
        }
        (Value::Array(one), Value::Array(other)) if one.len() == other.len() => {
            for (index, (one, other)) in one.iter().zip(other).enumerate() {
                differences(one, other, &format!("{at}/{index}"), found);
            }
        }
        (Value::Object(one), Value::Object(other)) if one.keys().eq(other.keys()) => {
            one.iter().for_each(|(key, value)| differences(value, &other[key], &format!("{at}/{key}"), found));
        }
        _ => found.extend((one != other).then(|| format!("{at}: {one} and {other}"))),
    }
}

/// `INSTA_UPDATE=always` writes the examples anew.
#[test]
fn examples_of_messages_were_said_and_all_that_is_said_is_as_its_schema_says() {
    let Heard { shortest, wrong, count } = heard();
    assert!(wrong.is_empty(), "of {count} messages: {wrong:#?}");
    assert!(count > 1000, "{count} messages");
    let named: Map<String, Value> = schemas();
    let unsaid: Vec<&String> = named.keys().filter(|name| !shortest.contains_key(*name)).collect();
    assert!(unsaid.is_empty(), "no recipe has {unsaid:?}");
    for (name, value) in &shortest {
        let file = folder().join(format!("{name}.example.json"));
        if std::env::var("INSTA_UPDATE").is_ok_and(|update| update == "always") {
            write(&file, &(text(value, 0) + "\n"));
        }
        let mut found = Vec::new();
        differences(&json_file(&file), value, "", &mut found);
        assert!(found.is_empty(), "{name}: the example was not said so: {found:#?}");
    }
}

#[test]
fn schemas_of_messages_are_those_of_the_program() {
    let printed = abbe(&root(), &["plugin", "messages"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let printed: Map<String, Value> = serde_json::from_str(&printed.stdout).expect("JSON");
    assert_eq!(printed, schemas());
    let mut files = BTreeSet::new();
    for (name, schema) in &printed {
        let file = folder().join(format!("{name}.schema.json"));
        assert_eq!(&json_file(&file), schema, "{name}: `cargo xtask schema` writes it");
        crate::plugins::valid(name, schema, &json_file(&folder().join(format!("{name}.example.json"))));
        files.extend(["schema", "example"].map(|kind| format!("{name}.{kind}.json")));
    }
    let there = files_in(&folder()).into_iter().map(|file| file.file_name().expect("a name").display().to_string());
    let others: Vec<String> = there.filter(|file| !files.contains(file) && file != "README.md").collect();
    assert!(others.is_empty(), "no message has {others:?}");
}

/// Schemas refuse what is not meant: each key of an example but those that may be left out is asked for, and is of one type.
#[test]
fn schemas_of_messages_refuse_what_is_not_meant() {
    for (name, schema) in schemas() {
        let validator = jsonschema::validator_for(&schema).unwrap_or_else(|error| panic!("{name}: {error}"));
        let example = json_file(&folder().join(format!("{name}.example.json")));
        if name == FAILURE {
            assert!(!validator.is_valid(&json!({})) && !validator.is_valid(&json!({ "message": 1 })));
            continue;
        }
        for part in ["question", "answer"] {
            let mut other = example.clone();
            other[part] = json!({ "something": "else" });
            assert!(!validator.is_valid(&other), "{name}: any {part} is taken");
        }
    }
}
