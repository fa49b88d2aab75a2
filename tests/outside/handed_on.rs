//! Files that hand a calibration on: certificates that are read back as statements, QIF results that are read back as data and are valid
//! by the schema, where there is a copy of it.

use std::path::Path;
use std::process::Command;

use abbe_core::{Build, Context, Dataset, Kind};
use serde_json::json;

use crate::support::{SMALL, Small, json_file, read, registry, skipped, write};

/// Positions of the machine of the small recipe, two runs.
const POINTS: &str = "feature,run,X_mm,Y_mm,Z_mm,B_deg,C_deg,x_mm,y_mm,z_mm\n\
    a & b,1,10,20,230,0,0,10,20,-130\nc,1,-40,5,220,0,30,1,2,3\na & b,2,10.001,20,230,0,0,10,20,-130\n";

/// A small recipe with these stages behind it; its run, with what it prints.
fn run(stages: &str) -> (Small, String) {
    let small = Small::new();
    small.write("points.csv", POINTS);
    small.write("recipe.yaml", &format!("{SMALL}{stages}"));
    let printed = small.abbe(&["run", "recipe.yaml", "--out", "out"]);
    assert!([0, 3].contains(&printed.status), "{} {}", printed.stdout, printed.stderr);
    (small, printed.stdout + &printed.stderr)
}

const CERTIFICATE: &str = "
    identifier: EXAMPLE-1
    country: DE
    begin: 2026-03-02
    end: 2026-03-02
    place: customer
    laboratory: { name: Laboratory, city: Musterstadt, country: DE }
    persons: [{ name: A. Person, role: head of the laboratory }]
    customer: { name: Customer, city: Musterstadt, country: DE }
    item: { name: machine, manufacturer: Maker, model: M1, serial_number: '123' }
    methods: [{ name: touches }]
    equipment: [{ name: touch probe, serial_number: '456' }]
    conditions: [{ name: temperature of the air, from: 19.8, to: 20.4, unit: degC }]
    parameters: [EX0C, 'EXX[1]']
";

/// What `export: dcc` writes, `estimate: stated` reads: values, uncertainties, correlation.
#[test]
fn certificates_of_machines_are_statements_again() {
    for version in ["3.2.1", "3.3"] {
        let export = format!("  handed-on:\n    export: dcc\n    of: fine\n    version: \"{version}\"{CERTIFICATE}");
        let (small, _) = run(&export);
        let page = small.read("out/recipe/handed-on/certificate.html");
        assert!(page.contains("DRAFT") && page.contains("EX0C"), "{page}");
        let xml = small.read("out/recipe/handed-on/certificate.xml");
        small.write("given.xml", &xml);
        small.write(
            "again.yaml",
            &SMALL.replace(
                "  judge:",
                "  again: { estimate: stated, machine: machine, certificate: { path: given.xml, item: 123 } }\n  judge:",
            ),
        );
        let printed = small.abbe(&["run", "again.yaml", "--out", "again"]);
        assert!([0, 3].contains(&printed.status), "{} {}", printed.stdout, printed.stderr);
        let fine = json_file(&small.path("out/recipe/fine.calibration.json"));
        let again = json_file(&small.path("again/again/again.calibration.json"));
        let of = |calibration: &serde_json::Value, name: &str| {
            let parameters = calibration["parameters"].as_array().expect("parameters");
            let one = parameters.iter().find(|one| one["name"] == name).expect("it");
            ["value", "standard_uncertainty"].map(|key| one[key].as_f64().expect("a number"))
        };
        for name in ["EX0C", "EXX[1]"] {
            for (one, other) in of(&fine, name).into_iter().zip(of(&again, name)) {
                assert!((one - other).abs() <= 1e-12 * one.abs(), "{version} {name}: {one} {other}");
            }
        }
        let other = small.read("again.yaml").replace("item: 123", "item: 124");
        small.write("again.yaml", &other);
        let printed = small.abbe(&["run", "again.yaml", "--out", "other"]);
        let told = printed.stdout + &printed.stderr;
        assert!(printed.status != 0 && told.contains("the item `124` was expected"), "{told}");
    }
}

/// The rows of a file by the reader of this name.
fn ingested(reader: &str, file: &Path) -> Dataset {
    let registry = registry();
    let Build::Ingest(constructor) = &registry.find(Kind::Ingest, reader).expect("a reader").build else {
        panic!("{reader} reads nothing")
    };
    let stage =
        constructor.build(&json!({ "path": file }), &Context { base: file.parent().expect("a folder").to_owned() });
    stage.expect("settings").read().expect("data")
}

/// What `export: qif-results` writes, `ingest: qif-results` reads: the points that `abbe correct` gives.
#[test]
fn corrected_points_are_results_that_are_read_back() {
    let (small, _) = run("  points: { export: qif-results, of: fine, path: points.csv }\n");
    let file = small.path("out/recipe/points/results.qif");
    let data = ingested("qif-results", &file);
    assert_eq!(data.labels("feature").expect("labels"), ["a & b", "c", "a & b"]);
    assert_eq!(data.labels("run").expect("labels").iter().collect::<std::collections::BTreeSet<_>>().len(), 2);
    let printed = small.abbe(&["correct", "out/recipe/fine.calibration.json", "points.csv", "--out", "corrected.csv"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let corrected = ingested("csv", &small.path("corrected.csv"));
    for (axis, name) in ["X", "Y", "Z"].into_iter().enumerate() {
        let lower = name.to_lowercase();
        let expected = corrected.required_numbers(&format!("corrected_{lower}")).expect("a column");
        assert_eq!(data.required_numbers(name).expect("a column"), expected, "{axis}");
        let nominal = corrected.required_numbers(&lower).expect("a column");
        assert_eq!(data.required_numbers(&lower).expect("a column"), nominal, "{axis}");
    }
    is_valid(&read(&file), &small);
}

/// Fails unless the document is valid by the schema of QIF 3, and one with a mistake is not.
fn is_valid(text: &str, small: &Small) {
    const CHECK: &str = "import sys\nfrom lxml import etree\n\
        schema = etree.XMLSchema(etree.parse(sys.argv[2] + '/QIFDocument.xsd'))\n\
        print('' if schema.validate(etree.parse(sys.argv[1])) else schema.error_log)";
    let test = "the schema of QIF";
    let has_lxml = Command::new("python3").args(["-c", "import lxml"]).output();
    if !has_lxml.is_ok_and(|found| found.status.success()) {
        skipped(test, "the Python package lxml is not installed");
        return;
    }
    let Ok(schemas) = std::env::var("ABBE_QIF_SCHEMAS") else {
        skipped(test, "ABBE_QIF_SCHEMAS names no folder with QIFDocument.xsd and those beside it");
        return;
    };
    let file = small.path("checked.qif");
    let check = |text: &str| {
        write(&file, text);
        let found = Command::new("python3").args(["-c", CHECK]).arg(&file).arg(&schemas).output().expect("Python");
        assert!(found.status.success(), "{}", String::from_utf8_lossy(&found.stderr));
        String::from_utf8_lossy(&found.stdout).trim().to_owned()
    };
    assert_eq!(check(text), "");
    assert_ne!(check(&text.replacen("<FeatureItemId>", "<FeatureItemId>9", 1)), "", "a feature that is not there");
    assert_ne!(check(&text.replacen("NOT_CALCULATED", "perhaps", 1)), "");
}
