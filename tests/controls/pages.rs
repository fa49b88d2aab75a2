//! The examples on the pages of five-axis kinematics: files have what the pages show.

use serde_json::{Value, json};

use super::law::{Machine, exporter};
use super::random::of_settings;
use crate::support::{read, root};

/// The machine of the pages, axes of A and C 50 mm below the spindle nose with all axes at zero, with these errors (mm, rad).
fn machine(errors: &[(&str, f64)]) -> Machine {
    let rotary = json!({ "range_deg": [-100, 100], "point_mm": [0, 0, -50] });
    let linear = json!({ "range_mm": [-300, 300] });
    let names: Vec<&str> = errors.iter().map(|(name, _)| *name).collect();
    let settings = json!({
        "chain": "w C A b X Y Z t", "tool_length_mm": 120, "stylus_radius_mm": 0,
        "axes": { "X": linear, "Y": linear, "Z": linear, "A": rotary, "C": rotary },
        "errors": [{ "location": names }],
    });
    let mut calibration = serde_json::to_value(of_settings(&settings, 1, 0.05).calibration).expect("JSON");
    for parameter in calibration["parameters"].as_array_mut().expect("parameters") {
        let value = errors.iter().find(|(name, _)| parameter["name"] == *name).map_or(0.0, |(_, value)| *value);
        parameter["value"] = json!(value);
    }
    Machine::of(&calibration)
}

/// The words that a page shows in its indented lines behind a line with `from` stand in a file in this order.
fn shows(page: &str, (export, settings): (&str, &Value), errors: &[(&str, f64)], file: &str, from: &str) {
    let machine = machine(errors);
    let files = exporter(export, settings).export(&machine.calibration, machine.model.as_ref()).expect("files");
    let found = files.iter().find(|own| own.name == file).expect("the file of the page");
    let text = std::str::from_utf8(&found.content).expect("text");
    let page = read(&root().join(format!("docs/controls/{page}.md")));
    let lines = page.lines().skip_while(|line| !line.contains(from)).skip(1).skip_while(|line| line.is_empty());
    let shown: Vec<&str> = lines.take_while(|line| line.starts_with("    ")).flat_map(str::split_whitespace).collect();
    assert!(shown.len() >= 5, "{export}: the page shows {shown:?}");
    let mut written = text.split_whitespace();
    for word in shown {
        assert!(written.any(|own| own == word), "{export}: `{word}` of the page is not in its place in\n{text}");
    }
}

const PLACES: [(&str, f64); 2] = [("EX0C", 0.02), ("EY0A", 0.01)];

#[test]
fn files_have_what_pages_show() {
    let linuxcnc = json!({ "module": "xyzac-trt-kins", "has_conventional_directions": true,
        "existing": { "x-rot-point": 0, "y-rot-point": 0, "y-offset": 0, "z-offset": -50 } });
    let errors = [PLACES[0], PLACES[1], ("EZ0A", -0.015)];
    shows("linuxcnc-five-axis", ("linuxcnc-five-axis", &linuxcnc), &errors, "five-axis.hal", "gives `five-axis.hal`");
    let siemens = json!({ "carrier": 1, "tool_length_mm": 120, "existing": { "I2": [0, 0, -50], "I3": [0, 0, 0],
        "I4": [0, 0, 50], "V1": [-1, 0, 0], "V2": [0, 0, -1] } });
    let file = "siemens-kinematics.mpf";
    shows("siemens-kinematics", ("siemens-kinematics", &siemens), &PLACES, file, "gives `siemens-kinematics.mpf`");
    let fanuc = json!({ "increment": "IS-C", "tool_length_mm": 120,
        "existing": { "19700": [0, 0, -50], "19703": [0, 0, 0] } });
    shows("fanuc-five-axis", ("fanuc-five-axis", &fanuc), &PLACES, "five-axis.prm", "gives `five-axis.prm`");
    let heidenhain = json!({ "tool_length_mm": 120, "values": "subtracted", "step_mm": 25 });
    let errors = [PLACES[0], ("EC0Y", 1e-4)];
    let file = "KINEMATICS.TAB";
    shows("heidenhain-kinematics", ("heidenhain-kinematics", &heidenhain), &errors, file, "and EC0Y = 100 µrad gives");
}
