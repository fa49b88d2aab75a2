//! Recipes, notations, and the JSON of results.

use std::collections::BTreeSet;
use std::path::Path;
use std::str::FromStr;

use abbe_core::{Build, Calibration, Context, Registry, Unit, Verdict, matches};
use abbe_engine::RunRecord;
use abbe_kinematics::StructuralLoop;
use abbe_recipe::Recipe;
use abbe_report::Residuals;
use abbe_simulation::Truth;

use super::seeds::{folder, root, texts};
use super::{Answer, Target};

/// The text of an input; what is no UTF-8 is replaced, as an editor would.
pub fn text(input: &[u8]) -> std::borrow::Cow<'_, str> {
    String::from_utf8_lossy(input)
}

fn answer<T, E: ToString>(result: Result<T, E>) -> Answer {
    result.map(drop).map_err(|error| error.to_string())
}

pub fn targets() -> Vec<Target> {
    let mut recipes = folder("pipelines", &[".yaml"]);
    recipes.extend(folder("tests/frozen", &[".yaml"]));
    let mut calibrations = folder("tests/frozen", &["calibration-1.json", "selected.json", "trials.json"]);
    calibrations.push(
        br#"{"abbe_calibration":1,"estimate":"fit","model":{"plugin":"m","settings":{}},"parameters":[]}"#.to_vec(),
    );
    vec![
        Target::new("recipe", recipes, recipe(Registry::built_in().expect("plugins"))),
        Target::new("chain", chains(), |input| answer(StructuralLoop::from_str(&text(input)))),
        Target::new(
            "pattern",
            texts(["E*[1]\nEXX[1]", "ball[?].*\nball[3].x", "E??\nEC0B", "*\n", "[[*]\n[]"]),
            pattern,
        ),
        Target::new(
            "unit",
            texts(["um_per_m", "X_mm", "per_K", "mm/mm", "rad/mm2", "B_deg", "F_mm_per_min", "-3.5e-2", "12"]),
            |input| {
                let text = text(input);
                let _ = Unit::from_str(&text).map(|unit| unit.to_string());
                let _ = abbe_table::number(&text, "1.5");
                answer(abbe_table::number("X_mm", &text))
            },
        ),
        Target::new("calibration", calibrations, calibration),
        Target::new("truth", folder("tests/truth", &[".json"]), |input| {
            answer(Truth::parse(Path::new("truth.json"), &text(input)))
        }),
        Target::new("verdicts", folder("tests/frozen", &["verdicts-1.json"]), |input| {
            answer(Verdict::list_from_json(&text(input)))
        }),
        Target::new("run-record", folder("tests/frozen", &["run-1.json", "run-1-library.json"]), |input| {
            answer(RunRecord::from_json(&text(input)))
        }),
        Target::new("residuals", folder("tests/fuzz/seeds/residuals", &[".csv"]), residuals),
    ]
}

/// A recipe, and the settings of its stages, which its plugins read.
fn recipe(registry: Registry) -> impl Fn(&[u8]) -> Answer {
    let base = root().join("pipelines");
    move |input| {
        let context = Context { base: base.clone() };
        let recipe =
            Recipe::parse(&base.join("fuzzed.yaml"), &text(input), &registry).map_err(|error| error.to_string())?;
        for stage in &recipe.stages {
            let plugin = registry.find(stage.kind, &stage.plugin).map_err(|error| error.to_string())?;
            let settings = &stage.settings;
            let built = match &plugin.build {
                Build::Ingest(constructor) => constructor.build(settings, &context).map(drop),
                Build::Artefact(constructor) => constructor.build(settings, &context).map(drop),
                Build::Model(constructor) => constructor.build(settings, &context).map(drop),
                Build::Estimate(constructor) => constructor.build(settings, &context).map(drop),
                Build::Validate(constructor) => constructor.build(settings, &context).map(drop),
                Build::Export(constructor) => constructor.build(settings, &context).map(drop),
            };
            answer(built)?;
        }
        Ok(())
    }
}

/// The chains of the recipes and machine files.
fn chains() -> Vec<Vec<u8>> {
    let mut found: BTreeSet<Vec<u8>> = texts(["w C' B' X' b Z Y (S) t", "w b X Y Z t"]).into_iter().collect();
    for recipe in folder("pipelines", &[".yaml"]) {
        let lines = text(&recipe).into_owned();
        found.extend(lines.lines().filter_map(|line| {
            let chain = line.split_once("chain:")?.1.trim().trim_matches(['"', '\'']);
            Some(chain.split(['#', ',', '}']).next()?.trim_matches(['"', ' ']).as_bytes().to_vec())
        }));
    }
    found.into_iter().collect()
}

/// Pattern and name, in two lines. A name fits itself, unless it is a pattern.
fn pattern(input: &[u8]) -> Answer {
    let text = text(input);
    let (pattern, name) = text.split_once('\n').unwrap_or((&text, ""));
    assert!(matches("*", name));
    assert!(name.contains(['*', '?']) || matches(name, name), "{name:?} does not fit itself");
    match matches(pattern, name) {
        true => Ok(()),
        false => Err("it does not fit".to_owned()),
    }
}

/// What is read is written and read again as the same.
fn calibration(input: &[u8]) -> Answer {
    let read = Calibration::from_json(&text(input)).map_err(|error| error.to_string())?;
    let written = serde_json::to_string(&read).expect("a calibration can be written");
    let again = Calibration::from_json(&written).expect("what was written is read");
    assert_eq!(serde_json::to_string(&again).expect("a calibration can be written"), written);
    Ok(())
}

/// What is read can be written and read again, with as many rows.
fn residuals(input: &[u8]) -> Answer {
    let read = Residuals::from_csv(&text(input)).map_err(|error| error.to_string())?;
    let written = read.to_csv().map_err(|error| error.to_string())?;
    let again = Residuals::from_csv(&written).expect("what was written is read");
    assert_eq!(again.rows.len(), read.rows.len());
    Ok(())
}
