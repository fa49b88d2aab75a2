//! Numbers in settings: every one has a range in the schema, which the program keeps, with the line of the recipe.

use std::fs;

use abbe_core::{EstimateSource, Kind, Plugin, ranges};
use abbe_engine::prepare;
use serde_json::{Map, Value, json};

use crate::misread::changed;
use crate::support::{SMALL, Small, Variant, abbe, recipes, registry, temporary};

/// A number in a schema, and settings that have a number there.
struct Place {
    name: String,
    schema: Map<String, Value>,
    settings: Box<dyn Fn(Value) -> Value>,
}

/// Makes settings around a value.
type Around = dyn Fn(Value) -> Value;

fn is_number(schema: &Map<String, Value>) -> bool {
    let all = schema.get("type").map(|types| types.as_array().cloned().unwrap_or_else(|| vec![types.clone()]));
    let all = all.unwrap_or_default();
    all.iter().any(|kind| kind == "number" || kind == "integer") && !all.contains(&json!("string"))
}

/// Something that a schema takes, as far as tags and kinds go.
fn any(schema: &Value) -> Value {
    if let Some(constant) = schema.get("const") {
        return constant.clone();
    }
    match schema["type"].as_str() {
        Some("array") => json!([]),
        Some("object") => json!({}),
        Some("number" | "integer") => schema.get("minimum").cloned().unwrap_or(json!(1)),
        _ => json!("x"),
    }
}

/// All numbers of a schema.
fn places(root: &Value, schema: &Value, name: &str, around: std::rc::Rc<Around>, depth: usize, found: &mut Vec<Place>) {
    let Some(map) = schema.as_object().filter(|_| depth < 12) else { return };
    if let Some(defined) = map.get("$ref").and_then(Value::as_str).and_then(|path| path.strip_prefix("#/$defs/")) {
        // What holds itself was seen already.
        if depth < 6 {
            places(root, &root["$defs"][defined], name, around.clone(), depth + 1, found);
        }
    }
    if is_number(map) {
        let around = around.clone();
        found.push(Place {
            name: name.to_owned(),
            schema: map.clone(),
            settings: Box::new(move |value| around(value)),
        });
    }
    let needed: Vec<String> = map
        .get("required")
        .and_then(Value::as_array)
        .into_iter()
        .flatten()
        .filter_map(Value::as_str)
        .map(str::to_owned)
        .collect();
    for (key, inner) in map.get("properties").and_then(Value::as_object).into_iter().flatten() {
        let mut beside = Map::new();
        for key in &needed {
            beside.insert(key.clone(), any(&map["properties"][key]));
        }
        let (around, own) = (around.clone(), key.clone());
        let wrapped = move |value: Value| {
            let mut all = beside.clone();
            all.insert(own.clone(), value);
            around(Value::Object(all))
        };
        places(root, inner, &format!("{name}.{key}"), std::rc::Rc::new(wrapped), depth + 1, found);
    }
    if let Some(inner) = map.get("additionalProperties") {
        let around = around.clone();
        places(
            root,
            inner,
            &format!("{name}.*"),
            std::rc::Rc::new(move |value| around(json!({ "a": value }))),
            depth + 1,
            found,
        );
    }
    for key in ["items", "prefixItems"] {
        let inner: Vec<&Value> = match map.get(key) {
            Some(Value::Array(all)) => all.iter().collect(),
            Some(one @ Value::Object(_)) => vec![one],
            _ => Vec::new(),
        };
        for (index, inner) in inner.into_iter().enumerate() {
            let around = around.clone();
            let wrapped = move |value: Value| {
                let mut list = vec![Value::Null; index];
                list.push(value);
                around(Value::Array(list))
            };
            places(root, inner, &format!("{name}[{index}]"), std::rc::Rc::new(wrapped), depth + 1, found);
        }
    }
    for key in ["anyOf", "oneOf", "allOf"] {
        for inner in map.get(key).and_then(Value::as_array).into_iter().flatten() {
            places(root, inner, name, around.clone(), depth + 1, found);
        }
    }
}

fn all_places(schema: &Value) -> Vec<Place> {
    let mut found = Vec::new();
    places(schema, schema, "", std::rc::Rc::new(|value| value), 0, &mut found);
    found
}

/// Least and most of a range, and whether the ends belong to it.
fn range(schema: &Map<String, Value>) -> Option<([f64; 2], [bool; 2])> {
    let end = |inclusive: &str, exclusive: &str| {
        let of = |key: &str| schema.get(key).and_then(Value::as_f64);
        of(inclusive).map(|end| (end, true)).or_else(|| of(exclusive).map(|end| (end, false)))
    };
    let (least, most) = (end("minimum", "exclusiveMinimum")?, end("maximum", "exclusiveMaximum")?);
    Some(([least.0, most.0], [least.1, most.1]))
}

#[test]
fn every_number_has_a_range_that_is_kept() {
    let mut count = 0;
    for plugin in registry().iter() {
        let schema = plugin.schema.get();
        assert_eq!(ranges::check(schema, plugin.example.get()), Ok(()), "{}: its example", plugin.name);
        for place in all_places(schema) {
            let what = format!("{} `{}`{}", plugin.kind(), plugin.name, place.name);
            let ([least, most], [has_least, has_most]) =
                range(&place.schema).unwrap_or_else(|| panic!("{what} has no range"));
            assert!(least < most, "{what}: {least} to {most}");
            let refused = |value: f64| ranges::check(schema, &(place.settings)(json!(value))).is_err();
            let is_whole = place.schema["type"].to_string().contains("integer");
            // Another alternative may take what this one does not, but nothing takes what is beyond all of them.
            for value in [1e300, -1e300] {
                assert!(refused(value), "{what}: {value:e} is taken");
            }
            let inside = if is_whole { least.max(0.0) } else { 0.5 * (least + most) };
            assert!(
                !refused(inside),
                "{what}: {inside} is refused: {:?}",
                ranges::check(schema, &(place.settings)(json!(inside)))
            );
            let alone = all_places(schema).iter().filter(|other| other.name == place.name).count() == 1;
            let step = if is_whole { 1.0 } else { 1e-6 * most.abs().max(1.0) };
            let beyond = [
                (least - step, true),
                (most + step, most < 1e15),
                (least, !has_least),
                (most, !has_most),
                (0.0, least > 0.0),
                (-1.0, least > -1.0),
            ];
            for (value, is_refused) in beyond.into_iter().filter(|_| alone) {
                assert!(!is_refused || refused(value), "{what}: {value} is taken");
            }
            // Contributions to the uncertainty of figures only add to it: a small one does nothing.
            let is_part = ["positioning", "diagonals"].contains(&&*plugin.name) && place.name.contains("uncertainty.");
            let is_uncertainty =
                place.name.contains("uncertainty") && !place.schema["type"].to_string().contains("integer") && !is_part;
            assert!(!is_uncertainty || refused(1e-300), "{what}: 1e-300 is taken");
            count += 1;
        }
    }
    assert!(count > 300, "{count} numbers");
}

/// A stage of a plugin in a recipe that is right otherwise.
fn recipe(plugin: &Plugin, settings: &Value) -> String {
    let references = match (plugin.kind(), plugin.estimate_source) {
        (Kind::Ingest | Kind::Model, _) | (Kind::Estimate, EstimateSource::Calibration) => "",
        (Kind::Artefact, _) | (Kind::Estimate | Kind::Validate, EstimateSource::Readings) => "from: touches, ",
        (Kind::Estimate, EstimateSource::Measurements) => "machine: machine, observations: table, parameters: [dxt], ",
        (Kind::Estimate, EstimateSource::Statement) => "machine: machine, ",
        (Kind::Estimate, _) | (Kind::Validate | Kind::Export, _) => "of: fine, ",
    };
    let own: String =
        settings.as_object().into_iter().flatten().map(|(key, value)| format!("{key}: {value}, ")).collect();
    format!("{SMALL}  tried: {{ {}: {}, {references}{own} }}\n", plugin.kind(), plugin.name)
}

/// Keys that the recipe itself reads.
const OF_RECIPE: [&str; 7] = ["of", "from", "machine", "known", "start", "observations", "exports"];

#[test]
fn what_is_refused_has_its_line() {
    let small = Small::new();
    let registry = registry();
    let mut count = 0;
    for plugin in registry.iter() {
        for place in all_places(plugin.schema.get()) {
            let settings = (place.settings)(json!(1e300));
            if settings.as_object().is_some_and(|map| map.keys().any(|key| OF_RECIPE.contains(&key.as_str()))) {
                continue;
            }
            let text = recipe(plugin, &settings);
            small.write("recipe.yaml", &text);
            let what = format!("{} `{}`{}", plugin.kind(), plugin.name, place.name);
            let error =
                prepare(&small.path("recipe.yaml"), &registry).err().unwrap_or_else(|| panic!("{what} is taken"));
            let line = error.place.as_ref().and_then(|place| place.line);
            assert_eq!(line, Some(text.lines().count()), "{what}: {error}");
            assert!(error.message.contains("1e300: a "), "{what}: {error}");
            for nan in [".nan", ".inf"] {
                small.write("recipe.yaml", &text.replace("1e300", nan).replace("1e+300", nan));
                let error = prepare(&small.path("recipe.yaml"), &registry)
                    .err()
                    .unwrap_or_else(|| panic!("{what}: {nan} is taken"));
                assert!(error.place.is_some_and(|place| place.line.is_some()), "{what}: {nan}");
            }
            count += 1;
        }
    }
    assert!(count > 300, "{count} numbers");
}

/// What a run of a recipe with other settings says.
fn said(name: &str, change: impl Fn(&mut Variant, &std::path::Path)) -> (i32, String) {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()[name]);
    change(&mut recipe, folder.path());
    let file = recipe.write(folder.path());
    let printed = abbe(
        folder.path(),
        &["run".as_ref(), file.as_os_str(), "--out".as_ref(), folder.path().join("out").as_os_str()],
    );
    let text = format!("{} {}", printed.stderr, printed.stdout);
    (printed.status, text.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" "))
}

#[test]
fn uncertainties_that_nobody_can_mean_are_refused() {
    for (recipe, stage, setting, expected) in [
        ("spindle-motion", "motion", "standard_uncertainty_um", "from 1e-6 to 1e6 was"),
        ("first-steps", "table", "standard_uncertainty_um", "from 1e-6 to 1e6 was"),
        ("first-steps", "table", "stylus_radius_standard_uncertainty_um", "0 or at least 1e-6"),
    ] {
        let (status, text) = said(recipe, |recipe, _| recipe.stage(stage)[setting] = json!(1e-300));
        assert!(status == 2 && text.contains(expected), "{recipe}: {text}");
    }
    // The same in a column of the data.
    let column = |cell: &'static str| {
        said("first-steps", move |recipe, folder| {
            let text = crate::support::read(&recipe.path("touches", "path"));
            let mut is_header = true;
            let lines = text.lines().map(|line| match (line.starts_with('#'), std::mem::take(&mut is_header)) {
                (true, _) => format!("{line}\n"),
                (false, true) => format!("{line},u_um\n"),
                (false, false) => format!("{line},{cell}\n"),
            });
            fs::write(folder.join("touches.csv"), lines.collect::<String>()).expect("a file");
            recipe.stage("touches")["path"] = json!(folder.join("touches.csv"));
            recipe.stage("table")["uncertainty"] = json!({ "column": "u" });
        })
    };
    let (status, text) = column("1e-30");
    assert!(status == 1 && text.contains("1e-9 to 1e6 was expected") && text.contains("touches.csv:2:1"), "{text}");
    assert_eq!(column("1.6").0, 0);
}

#[test]
fn times_beyond_a_log_are_told() {
    for (stage, setting, value, expected) in [
        ("spindle", "block_s", 1e-9, "a time from one row to the next"),
        ("spindle", "block_s", 1e9, "half of the longest run"),
        ("spindle", "reference_until_s", 1e9, "and columns count from its first seconds"),
    ] {
        let (status, text) = said("thermal-spindle", |recipe, _| {
            recipe.stage(stage).as_object_mut().expect("a stage").remove("reference_degC");
            recipe.stage(stage)[setting] = json!(value);
        });
        assert!(status == 1 && text.contains(expected), "{setting} {value}: {status} {text}");
    }
}

#[test]
fn numbers_of_repeats_are_not_negative() {
    for (column, value) in [("repeat", "-1"), ("repeat", "1.5"), ("session", "-3")] {
        let (status, text) = said("tool-check", |recipe, folder| {
            let file = changed(&recipe.path("log", "path"), folder, column, |row, cell| {
                if row == 4 { value.to_owned() } else { cell.to_owned() }
            });
            recipe.stage("log")["path"] = json!(file);
        });
        assert!(status == 1 && text.contains(&format!("{column} {value}: a whole number from 0")), "{text}");
        assert!(text.contains(".csv:6:"), "{text}");
    }
}

#[test]
fn a_reversal_that_reads_twice_the_runs_is_told() {
    let twice = |stages: &'static [&'static str]| {
        said("spindle-motion", move |recipe, folder| {
            for stage in stages {
                let own = folder.join(stage);
                fs::create_dir(&own).expect("a folder");
                let file = changed(&recipe.path(stage, "path"), &own, "r1_um", |_, cell| {
                    format!("{}", 2.0 * cell.parse::<f64>().expect("a number"))
                });
                recipe.stage(stage)["path"] = json!(file);
            }
        })
        .1
    };
    let words = ["the reversal reads 2.0", "the asynchronous part of the second set-up is"];
    for (stages, is_told) in
        [(&["before", "after"][..], [true, false]), (&["after"][..], [false, true]), (&[][..], [false, false])]
    {
        let text = twice(stages);
        assert_eq!(words.map(|words| text.contains(words)), is_told, "{stages:?}: {text}");
    }
}
