//! Simulated measurements in files of other layouts: what is written, the same recipe reads back.

use abbe_engine::prepare;
use serde_json::json;

use crate::controls::law::uniform;
use crate::support::{abbe, as_typed, registry, temporary, write};

/// A way to lay out a table, as settings of `ingest: csv` and as it is written.
struct Written {
    settings: &'static str,
    separator: char,
    decimal: char,
    header: bool,
    /// Lines before the header row, and between it and the data.
    before: &'static str,
    between: &'static str,
    /// How many of the unit of the file a mm is, for the measured coordinates.
    factor: f64,
    encode: fn(&str) -> Vec<u8>,
}

fn latin_1(text: &str) -> Vec<u8> {
    text.chars().map(|character| u8::try_from(u32::from(character)).expect("Latin-1")).collect()
}

fn utf_16_big(text: &str) -> Vec<u8> {
    [0xfe, 0xff].into_iter().chain(text.encode_utf16().flat_map(u16::to_be_bytes)).collect()
}

/// 长 stands for the one character of these tables that is not ASCII.
fn gb_18030(text: &str) -> Vec<u8> {
    text.chars()
        .flat_map(|character| if character == '长' { vec![0xb3, 0xa4] } else { vec![character as u8] })
        .collect()
}

fn utf_8(text: &str) -> Vec<u8> {
    [b"\xef\xbb\xbf".as_slice(), text.as_bytes()].concat()
}

const NAMED: &str = "{ X_mm: Achse X, Y_mm: Achse Y, Z_mm: Achse Z, x_mm: { column: Punkt x, unit: in }, y_mm: { column: Punkt y, unit: in }, z_mm: { column: Punkt z, unit: in } }";

fn ways() -> Vec<Written> {
    vec![
        Written {
            settings: "separator: semicolon, decimal: comma, thousands: point, encoding: latin-1, skip_lines: 2, skip_after_header: 1, no_data: [\"---\"]",
            separator: ';',
            decimal: ',',
            header: true,
            before: "Prüfung 12;;\nHalle 3\n",
            between: "[mm];[mm];[mm];[in];[in];[in]\n---;1;1;1;1;1\n",
            factor: 1.0 / 25.4,
            encode: latin_1,
        },
        Written {
            settings: "separator: tab, encoding: utf-16, header: false",
            separator: '\t',
            decimal: '.',
            header: false,
            before: "# a comment\n",
            between: "",
            factor: 1.0,
            encode: utf_16_big,
        },
        Written {
            settings: "separator: space, decimal: comma, header: false",
            separator: ' ',
            decimal: ',',
            header: false,
            before: "",
            between: "",
            factor: 1.0,
            encode: utf_8,
        },
        Written {
            settings: "decimal: comma",
            separator: ',',
            decimal: ',',
            header: true,
            before: "",
            between: "",
            factor: 1.0 / 25.4,
            encode: utf_8,
        },
        Written {
            settings: "separator: stroke, encoding: gb18030, skip_lines: 1",
            separator: '|',
            decimal: '.',
            header: true,
            before: "长\r\n",
            between: "",
            factor: 1.0 / 25.4,
            encode: gb_18030,
        },
    ]
}

fn recipe(way: &Written) -> String {
    let by_number = "{ X_mm: 1, Y_mm: 2, Z_mm: 3, x_mm: 4, y_mm: 5, z_mm: 6 }";
    let columns = if way.header { NAMED } else { by_number };
    format!(
        "abbe: 1\nname: t\nstages:\n  poses: {{ ingest: csv, path: poses.csv, {}, columns: {columns} }}\n  tracker: {{ artefact: positions, from: poses, standard_uncertainty_um: 2 }}\n  machine:\n    model: serial-chain\n    chain: w b X Y Z t\n    tool_length_mm: 120\n    stylus_radius_mm: 0\n    errors: [{{ polynomial: [EXX, EYY, EZZ, EYX], degrees: [1] }}]\n  fit: {{ estimate: gauss-newton, machine: machine, observations: tracker, parameters: [\"E*\", \"tracker.*\"], trust_uncertainties: true }}\n",
        way.settings
    )
}

/// The table with nominal positions.
fn table(way: &Written, seed: u64) -> Vec<u8> {
    let mut random = uniform(seed);
    let mut text = way.before.to_owned();
    let separator = way.separator.to_string();
    if way.header {
        let names = ["Achse X", "Achse Y", "Achse Z", "Punkt x", "Punkt y", "Punkt z"];
        text.push_str(&(names.join(&separator) + "\n"));
    }
    text.push_str(way.between);
    for _ in 0..30 {
        let at: [f64; 3] = std::array::from_fn(|_| (random() - 0.5) * 1e3);
        let seen = [at[0], at[1], at[2] - 120.0].map(|part| part * way.factor);
        let cell = |number: &f64| {
            let written = format!("{number:.6}").replace('.', &way.decimal.to_string());
            if written.contains(way.separator) { format!("\"{written}\"") } else { written }
        };
        let cells: Vec<String> = at.iter().chain(&seen).map(cell).collect();
        text.push_str(&(cells.join(&separator) + "\n"));
    }
    (way.encode)(&text)
}

#[test]
fn what_is_simulated_in_another_layout_is_read_back() {
    for (seed, way) in ways().iter().enumerate() {
        let mut random = uniform(seed as u64 + 7);
        let folder = temporary();
        std::fs::write(folder.path().join("poses.csv"), table(way, seed as u64)).expect("a file");
        write(&folder.path().join("t.yaml"), &recipe(way));
        let names = ["EXX[1]", "EYY[1]", "EZZ[1]", "EYX[1]"];
        let truth: Vec<f64> = names.iter().map(|_| (random() - 0.5) * 4e-4).collect();
        let parameters: serde_json::Map<String, serde_json::Value> =
            names.iter().zip(&truth).map(|(name, value)| ((*name).to_owned(), json!(value))).collect();
        write(&folder.path().join("truth.json"), &json!({ "parameters": parameters }).to_string());
        let simulate = ["simulate", "t.yaml", "--truth", "truth.json", "--seed", "1", "--out", "virtual"];
        let printed = as_typed(folder.path(), &simulate);
        assert_eq!(printed.status, 0, "{}: {}{}", way.settings, printed.stdout, printed.stderr);
        let prepared = prepare(&folder.path().join("virtual/t.yaml"), &registry())
            .unwrap_or_else(|error| panic!("{}: {error}", way.settings));
        let outcome =
            prepared.run(&abbe_core::Monitor::default()).unwrap_or_else(|error| panic!("{}: {error}", way.settings));
        assert!(outcome.failures.is_empty(), "{}: {}", way.settings, outcome.failures[0].error);
        for (name, expected) in names.iter().zip(&truth) {
            let found = outcome.fits[0].calibration.get(name).expect("estimated").value;
            assert!((found - expected).abs() < 1e-10, "{}: {name} is {found}, not {expected}", way.settings);
        }
        // Everything but the measured numbers stays, the titles in their encoding too.
        let written = std::fs::read(folder.path().join("virtual/poses.csv")).expect("a file");
        if way.settings.contains("latin-1") {
            assert!(written.starts_with(&latin_1("Prüfung 12;;\nHalle 3\n# simulated")));
        }
        let printed = abbe(&folder.path().join("virtual"), &["data", "t.yaml"]);
        assert!(printed.stdout.contains("30 rows"), "{}{}", printed.stdout, printed.stderr);
    }
}

/// `abbe plan` writes rows of the usual layout, and nothing that its own recipe could not read.
#[test]
fn a_plan_of_a_file_in_another_layout_is_refused() {
    let folder = temporary();
    let way = &ways()[0];
    std::fs::write(folder.path().join("poses.csv"), table(way, 1)).expect("a file");
    let plan = "plan: { estimate: fit, candidates: tracker, number: 12 }\n";
    write(&folder.path().join("t.yaml"), &(recipe(way) + plan));
    let printed = as_typed(folder.path(), &["plan", "t.yaml", "--out", "planned"]);
    assert_eq!(printed.status, 2, "{}", printed.stdout);
    assert!(
        printed.stderr.contains("layout of its own") && printed.stderr.contains("`generate`"),
        "{}",
        printed.stderr
    );
}

/// A file that two stages read in two ways could be written in one only.
#[test]
fn a_file_with_two_layouts_is_refused() {
    let folder = temporary();
    let way = &ways()[3];
    std::fs::write(folder.path().join("poses.csv"), table(way, 1)).expect("a file");
    let other = "  other: { ingest: csv, path: poses.csv, decimal: comma, columns: { X_mm: Achse X } }\n";
    write(&folder.path().join("t.yaml"), &(recipe(way) + other));
    write(&folder.path().join("truth.json"), "{ \"parameters\": {} }");
    let simulate = ["simulate", "t.yaml", "--truth", "truth.json", "--seed", "1", "--out", "virtual"];
    let printed = as_typed(folder.path(), &simulate);
    assert_eq!(printed.status, 2, "{}", printed.stdout);
    assert!(printed.stderr.contains("read with two layouts"), "{}", printed.stderr);
}
