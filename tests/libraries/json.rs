//! `abbe_json.h` reads what serde reads, and no more; what it writes is the same again.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use crate::support::{files_in, read, root, temporary};

/// The program of `tests/vendor-plugins/json.c`, with sanitizers where the compiler has them.
fn program(folder: &Path) -> PathBuf {
    let file = folder.join("json");
    let build = |options: &[&str]| {
        let mut command = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
        command.args(["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1", "-I"]).args(options);
        command.arg(root().join("crates/abbe-plugin/include")).arg(root().join("tests/vendor-plugins/json.c"));
        command.arg("-o").arg(&file).arg("-lm").output().expect("the C compiler runs")
    };
    let include = root().join("crates/abbe-plugin/include").display().to_string();
    let sanitized =
        build(&[&include, "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-I"]).status.success();
    if !sanitized {
        let built = build(&[]);
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    }
    file
}

/// What the program says to each text; none where it is no JSON.
fn said(folder: &Path, texts: &[Vec<u8>], member: Option<&str>) -> Vec<Option<Value>> {
    let mut command = Command::new(program(folder));
    command.args(member).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("it starts");
    let mut input = child.stdin.take().expect("its input");
    let bytes: Vec<u8> =
        texts.iter().flat_map(|text| [&(text.len() as u32).to_ne_bytes()[..], text].concat()).collect();
    let writes = std::thread::spawn(move || input.write_all(&bytes));
    let output = child.wait_with_output().expect("it ends");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    writes.join().expect("no panic").expect("it reads all");
    let (mut answers, mut rest) = (Vec::new(), output.stdout.as_slice());
    while let Some((length, after)) = rest.split_first_chunk::<4>() {
        let (text, after) = after.split_at(u32::from_ne_bytes(*length) as usize);
        answers.push((!text.is_empty()).then(|| {
            serde_json::from_slice(text).unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(text)))
        }));
        rest = after;
    }
    assert_eq!(answers.len(), texts.len());
    answers
}

/// Numbers as floating-point numbers, which is what C has.
fn in_floats(value: &Value) -> Value {
    match value {
        Value::Number(number) => json!(number.as_f64()),
        Value::Array(items) => items.iter().map(in_floats).collect(),
        Value::Object(map) => map.iter().map(|(key, value)| (key.clone(), in_floats(value))).collect(),
        other => other.clone(),
    }
}

fn examples() -> Vec<Vec<u8>> {
    let files = files_in(&root().join("docs/schemas/plugin"));
    let texts: Vec<Vec<u8>> = files
        .iter()
        .filter(|file| file.extension().is_some_and(|end| end == "json"))
        .map(|file| read(file).into_bytes())
        .collect();
    assert!(texts.len() > 30);
    texts
}

#[test]
fn the_c_header_reads_and_writes_what_is_said_across_the_border() {
    let folder = temporary();
    let mut texts = examples();
    let more = [
        r#" [ "a\"b\\\/\b\f\n\r\té\u00e9\ud83d\ude00€" , -0.5e-3, 1E+2, true, false, null, {}, [], "" ] "#,
        "0",
        "{\"a\":{\"a\":[1,[2,{\"b\":\"\\u0041\"}]]}}",
    ];
    texts.extend(more.map(|text| text.as_bytes().to_vec()));
    for (text, said) in texts.iter().zip(said(folder.path(), &texts, None)) {
        let expected: Value = serde_json::from_slice(text).expect("JSON");
        assert_eq!(said.map(|value| in_floats(&value)), Some(in_floats(&expected)));
    }
    for name in ["question", "answer"] {
        for (text, said) in texts.iter().zip(said(folder.path(), &texts, Some(name))) {
            let expected: Value = serde_json::from_slice(text).expect("JSON");
            assert_eq!(said.map(|value| in_floats(&value)), expected.get(name).map(in_floats));
        }
    }
}

/// Examples with random changes: what serde refuses is refused, and what it reads is read alike.
#[test]
fn the_c_header_refuses_what_is_no_json() {
    let folder = temporary();
    let seeds: Vec<Vec<u8>> = examples().into_iter().map(|text| text.into_iter().take(3000).collect()).collect();
    let mut state = 27_u64;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let mut texts: Vec<Vec<u8>> = [
        "",
        " ",
        "[1,]",
        "{,}",
        "{\"a\"}",
        "01",
        "1.",
        "-",
        ".5",
        "1e",
        "nul",
        "\"\\x\"",
        "\"\t\"",
        "[1 2]",
        "{\"a\":1,}",
    ]
    .iter()
    .map(|text| text.as_bytes().to_vec())
    .collect();
    texts.push(b"[".repeat(100_000));
    for seed in &seeds {
        let whole: Value = match serde_json::from_slice(seed) {
            Ok(value) => value,
            Err(_) => json!([seed.len(), "x\u{e9}\n", { "k": [null, true, -1.5e-7] }]),
        };
        for _ in 0..60 {
            let mut text = whole.to_string().into_bytes();
            text.truncate(1500);
            for _ in 0..=random(3) {
                let at = random(text.len().max(1));
                match random(4) {
                    0 => text.truncate(at),
                    1 if at < text.len() => drop(text.remove(at)),
                    2 => text.insert(at.min(text.len()), b"{}[]\",:\\ue0-.1 tfn"[random(18)]),
                    _ if at < text.len() => text[at] = b"{}[]\",:\\ue0-.1 tfn"[random(18)],
                    _ => {}
                }
            }
            texts.push(text);
        }
    }
    // Bytes that are no UTF-8 never come from the program.
    texts.retain(|text| std::str::from_utf8(text).is_ok_and(|text| !text.contains("\\u0000")));
    let mut read = 0;
    for (text, said) in texts.iter().zip(said(folder.path(), &texts, None)) {
        let expected = serde_json::from_slice::<Value>(text);
        let shown = String::from_utf8_lossy(text);
        match (expected, said) {
            (Ok(expected), said) => {
                read += 1;
                assert_eq!(said.map(|value| in_floats(&value)), Some(in_floats(&expected)), "{shown}");
            }
            (Err(error), Some(_)) => {
                // Serde refuses halves of pairs, and numbers that are none of floating point.
                let known = ["surrogate", "out of range", "unexpected end of hex escape"];
                assert!(known.iter().any(|known| error.to_string().contains(known)), "{error}: {shown}");
            }
            (Err(_), None) => {}
        }
    }
    assert!(read > 50 && read + 500 < texts.len(), "{read} of {} are read", texts.len());
}
