//! What libraries and the processes of isolated plugins say.

use std::path::Path;
use std::sync::Arc;

use abbe_core::{Build, Context, Kind, KinematicModel, Observations, Registry};
use abbe_plugin::trials;
use serde_json::{Value, json};

use super::Target;
use super::programs::machine;
use super::seeds::{folder, texts};
use super::texts::text;

/// The description of a machine as `plugins/vendor-three-axis-c` gives it.
const MACHINE: &str = r#"{"axes":[{"name":"X","kind":"linear","branch":"tool","sense":1,"direction":[1,0,0],"status":0}],
"status":[{"name":"X","role":{"command":0},"quantity":"length","absent":"refused"}],
"parameters":[{"name":"EXX[1]","unit":"mm/mm"}],"settings":{}}"#;

const LISTED: &str = r#"{"name":"v","version":"1","plugins":[{"kind":2,"name":"m","version":"1","about":"does","reference":"",
"schema":"{\"type\":\"object\"}","example":"{}"}]}"#;

/// Lengths along X.
const LENGTHS: &str =
    "length,X1_mm,Y1_mm,Z1_mm,X2_mm,Y2_mm,Z2_mm,reference_mm\n1,0,0,0,100,0,0,100\n2,0,9,0,200,0,5,200.2\n";

/// The answers of `docs/schemas/plugin`.
fn documented() -> Vec<Vec<u8>> {
    let examples = folder("docs/schemas/plugin", &[".example.json"]).into_iter();
    let examples = examples.map(|text| serde_json::from_slice::<Value>(&text).expect("an example is JSON"));
    examples.map(|example| example.get("answer").unwrap_or(&example).to_string().into_bytes()).collect()
}

/// Observations of [`LENGTHS`].
fn observed(machine: &Arc<dyn KinematicModel>) -> Arc<dyn Observations> {
    let data = abbe_table::parse(Path::new("lengths.csv"), LENGTHS.as_bytes()).expect("a table");
    let registry = Registry::built_in().expect("plugins");
    let plugin = registry.find(Kind::Artefact, "length").expect("an artefact");
    let Build::Artefact(constructor) = &plugin.build else { unreachable!() };
    let settings = json!({ "standard_uncertainty_um": 1 });
    let stage = constructor.build(&settings, &Context { base: std::env::temp_dir() }).expect("an artefact");
    stage.observe(&Arc::new(data), machine).expect("observations")
}

/// Questions of a plugin about a machine and observations that it was lent.
fn questions() -> Target {
    let (machine, _) = machine();
    let observed = observed(&machine);
    let seeds = trials::questions(machine.as_ref(), observed.as_ref());
    Target::new("plugin-question", seeds, move |input| trials::question(input, &machine, &observed))
}

pub fn targets() -> Vec<Target> {
    let mut answers = texts([
        MACHINE,
        LISTED,
        r#"[{"setting":"path","path":"touches.csv"}]"#,
        r#"{"message":"no","help":"do","path":["a",1],"pose":3,"fault":true}"#,
        r#"{"figures":[{"of":"fit","name":"form","value":11.5,"standard_uncertainty":2.5,"unit":"um","limit":10}],"remarks":[]}"#,
        r#"[{"name":"list.txt","text":"x"},{"name":"b","bytes":[1,2]}]"#,
        r#"{"value":1e-3,"derivatives":[[0,1.0]]}"#,
    ]);
    answers.extend(documented());
    let mut libraries = folder("tests/fuzz/seeds/elf", &[""]);
    libraries.push(b"\x7fELF\x02\x01\x01".to_vec());
    vec![
        Target::new("plugin-answer", answers.clone(), |input| trials::answer(&text(input))),
        Target::new("plugin-list", texts([LISTED]), |input| trials::list(&text(input))),
        Target::new("plugin-failure", answers, |input| {
            let (status, text) = input.split_first().map_or((0, input), |(status, text)| (*status, text));
            trials::failure(u32::from(status), &String::from_utf8_lossy(text))
        }),
        questions(),
        Target::new("wire", trials::messages(), trials::message),
        Target::new("elf", libraries, trials::library_file),
    ]
}
