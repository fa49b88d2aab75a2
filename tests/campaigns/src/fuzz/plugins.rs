//! What libraries and the processes of isolated plugins say.

use abbe_plugin::trials;

use super::Target;
use super::seeds::{folder, texts};
use super::texts::text;

/// The description of a machine as `plugins/vendor-three-axis-c` gives it.
const MACHINE: &str = r#"{"axes":[{"name":"X","kind":"linear","branch":"tool","sense":1,"direction":[1,0,0],"status":0}],
"status":[{"name":"X","role":{"command":0},"quantity":"length","absent":"refused"}],
"parameters":[{"name":"EXX[1]","unit":"mm/mm"}],"settings":{}}"#;

const LISTED: &str = r#"{"name":"v","version":"1","plugins":[{"kind":2,"name":"m","version":"1","about":"does","reference":"",
"schema":"{\"type\":\"object\"}","example":"{}"}]}"#;

pub fn targets() -> Vec<Target> {
    let answers = texts([
        MACHINE,
        LISTED,
        r#"[{"setting":"path","path":"touches.csv"}]"#,
        r#"{"message":"no","help":"do","path":["a",1],"pose":3,"fault":true}"#,
        r#"{"figures":[{"of":"fit","name":"form","value":11.5,"standard_uncertainty":2.5,"unit":"um","limit":10}],"remarks":[]}"#,
        r#"[{"name":"list.txt","text":"x"},{"name":"b","bytes":[1,2]}]"#,
        r#"{"value":1e-3,"derivatives":[[0,1.0]]}"#,
    ]);
    let mut libraries = folder("tests/fuzz/seeds/elf", &[""]);
    libraries.push(b"\x7fELF\x02\x01\x01".to_vec());
    vec![
        Target::new("plugin-answer", answers.clone(), |input| trials::answer(&text(input))),
        Target::new("plugin-list", texts([LISTED]), |input| trials::list(&text(input))),
        Target::new("plugin-failure", answers, |input| {
            let (status, text) = input.split_first().map_or((0, input), |(status, text)| (*status, text));
            trials::failure(u32::from(status), &String::from_utf8_lossy(text))
        }),
        Target::new("wire", trials::messages(), trials::message),
        Target::new("elf", libraries, trials::library_file),
    ]
}
