//! Files of a control under `existing`: those that exporters wrote are believed, with one misread digit, in another unit or of
//! another axis they are refused, with the line.

use abbe_core::{Error, ExportedFile};
use serde_json::{Value, json};

use super::law::{Machine, exporter};

/// An exporter whose file is active.
struct Case {
    name: &'static str,
    settings: Value,
    /// The file, and where it stands under `existing`: the key, and `{ X: path }` if it is by axis.
    file: &'static str,
    key: &'static str,
    by_axis: bool,
}

fn cases() -> Vec<Case> {
    let numbers = json!({ "X": 1, "Y": 2, "Z": 3 });
    let tables = json!({ "step_mm": 50, "positioning": ["X"], "cross": [] });
    let case = |name, settings, file, by_axis| Case { name, settings, file, key: "existing", by_axis };
    let volumetric = |format: &str| json!({ "axis_numbers": numbers, "format": format, "step_mm": 50 });
    let kinematics = json!({ "tool_length_mm": 100.0, "values": "added", "step_mm": 50 });
    vec![
        case("isg-tables", json!({ "tables": tables, "axis_numbers": numbers }), "x.lis", true),
        case("heidenhain-tables", json!({ "tables": tables, "values": "added" }), "AXIS_X.COM", true),
        case("heidenhain-kinematics", kinematics.clone(), "AXIS-X.COM", true),
        Case { key: "existing_kinematics", ..case("heidenhain-kinematics", kinematics, "KINEMATICS.TAB", false) },
        case("siemens-tables", json!({ "tables": tables, "machine_axes": { "X": "AX1" } }), "cec.ini", false),
        case(
            "fanuc-pitch",
            json!({ "tables": { "step_mm": 50, "positioning": ["X"] }, "axis_numbers": numbers, "values": "added", "largest_value": 127 }),
            "fanuc-pitch.txt",
            false,
        ),
        case("isg-volumetric", volumetric("isg-csv"), "isg-volumetric.csv", false),
        case("isg-volumetric", volumetric("etalon-exchange"), "isg-volumetric.txt", false),
        case("grid", json!({ "grid": { "points": { "X": 5, "Y": 3 } } }), "corrections.csv", false),
    ]
}

impl Case {
    fn file(&self, machine: &Machine) -> String {
        let files = exporter(self.name, &self.settings).export(&machine.calibration, machine.model.as_ref());
        let files = files.unwrap_or_else(|error| panic!("{}: {error}", self.name));
        let found: Option<&ExportedFile> = files.iter().find(|file| file.name == self.file);
        let found = found
            .unwrap_or_else(|| panic!("{}: {:?}", self.name, files.iter().map(|file| &file.name).collect::<Vec<_>>()));
        String::from_utf8(found.content.clone()).expect("text")
    }

    /// What is said with this text as the active file.
    fn with(&self, machine: &Machine, text: &str, more: &Value) -> Result<Vec<ExportedFile>, Error> {
        let folder = crate::support::temporary();
        let path = folder.path().join(self.file);
        std::fs::write(&path, text).expect("a file");
        let mut settings = self.settings.clone();
        more.as_object().expect("settings").iter().for_each(|(key, value)| settings[key] = value.clone());
        settings[self.key] = match (self.by_axis, self.name) {
            (true, _) => json!({ "X": path }),
            (false, "siemens-tables" | "isg-volumetric") => json!([path]),
            (false, _) => json!(path),
        };
        exporter(self.name, &settings).export(&machine.calibration, machine.model.as_ref())
    }

    /// The text with one value of 30 (mm, degrees or more), the text with positions in inches, and the texts of another axis.
    fn wrong(&self, text: &str) -> (String, Option<String>, Vec<String>) {
        let once = |start: &str, to: &dyn Fn(&str) -> String| {
            let mut is_done = false;
            let change = |line: &str| match line.starts_with(start)
                && !std::mem::replace(&mut is_done, line.starts_with(start))
            {
                true => to(line),
                false => line.to_owned(),
            };
            let changed: Vec<String> = text.lines().map(change).collect();
            assert!(is_done, "{}: no line begins with `{start}` in\n{text}", self.name);
            changed.join("\n") + "\n"
        };
        let all = |is_of: &dyn Fn(&str) -> bool, to: &dyn Fn(&str) -> String| {
            let change = |line: &str| if is_of(line) { to(line) } else { line.to_owned() };
            Some(text.lines().map(change).collect::<Vec<_>>().join("\n") + "\n")
        };
        match self.file {
            "x.lis" => {
                let setpoint = |line: &str| line.contains("].setpoint ") || line.starts_with("kw.ssfk.kw_startpos");
                (
                    once("kw.ssfk.table[3].pos ", &|_| "kw.ssfk.table[3].pos 300000".to_owned()),
                    all(&setpoint, &|line| scaled(line, ' ', 1)),
                    vec![
                        text.replace("kopf.log_achs_name X", "kopf.log_achs_name Y"),
                        text.replace("kopf.log_achs_nr 1", "kopf.log_achs_nr 2"),
                    ],
                )
            }
            "AXIS_X.COM" => (
                once("2 ", &|line| replaced_last(line, "+30.0000")),
                all(&|line| line.starts_with(|first: char| first.is_ascii_digit()), &|line| scaled(line, ' ', 1)),
                vec![text.replace("AXIS_X.COM", "AXIS_Z.COM")],
            ),
            "AXIS-X.COM" => (
                once("2 ", &|line| replaced_last(line, "+30.0000")),
                Some(text.replace("DISTANCE:+50.0000", "DISTANCE:+2.0000")),
                vec![text.replace("AXIS-X.COM", "AXIS-Y.COM")],
            ),
            "KINEMATICS.TAB" => {
                let row = format!("{:<7} {:<15} {:<10} {:<5} {:<15}\n", 9, "X0Y", "Trans", "X", "+30.0000");
                (text.replace("[END]\n", &format!("{row}[END]\n")), None, Vec::new())
            }
            "cec.ini" => (
                once("$AN_CEC[0,3]=", &|_| "$AN_CEC[0,3]=30".to_owned()),
                all(&|line| ["_STEP[", "_MIN[", "_MAX["].iter().any(|name| line.contains(name)), &|line| {
                    scaled(line, '=', 1)
                }),
                Vec::new(),
            ),
            "fanuc-pitch.txt" => (
                once("N10003P", &|_| "N10003P30000".to_owned()),
                Some(text.replace("N03624A1P50000", "N03624A1P2000")),
                Vec::new(),
            ),
            "isg-volumetric.csv" => {
                let mut is_next = false;
                let value = |line: &str| {
                    let is_row = std::mem::replace(&mut is_next, line.starts_with("X EXX"));
                    if is_row { replaced_last(line, "1.5") } else { line.to_owned() }
                };
                let changed: Vec<String> = text.lines().map(value).collect();
                let mut is_of_x = false;
                let inches = |line: &str| {
                    is_of_x = line.starts_with("X EXX") || (is_of_x && !line.starts_with('#'));
                    if is_of_x && !line.starts_with('X') { scaled(line, ' ', 0) } else { line.to_owned() }
                };
                let scaled: Vec<String> = text.lines().map(inches).collect();
                (changed.join("\n") + "\n", Some(scaled.join("\n") + "\n"), Vec::new())
            }
            "isg-volumetric.txt" => {
                let is_row = |line: &str| line.starts_with(|first: char| first == '-' || first.is_ascii_digit());
                (once("50 ", &|_| "50 30".to_owned()), all(&is_row, &|line| scaled(line, ' ', 0)), Vec::new())
            }
            _ => (
                once("forward,", &|line| {
                    let cells: Vec<&str> = line.split(',').collect();
                    format!("{},30,{}", cells[..3].join(","), cells[4..].join(","))
                }),
                Some(beginning(text)),
                Vec::new(),
            ),
        }
    }
}

/// A line whose number in some cell is in inches.
fn scaled(line: &str, by: char, place: usize) -> String {
    let mut cells: Vec<String> = match by {
        ' ' => line.split_whitespace().map(str::to_owned).collect(),
        by => line.split(by).map(str::to_owned).collect(),
    };
    let number: f64 = cells[place].parse().unwrap_or_else(|_| panic!("{line}"));
    // Whole numbers of twenty-fifths: points keep equal distances, and no more than four decimals.
    cells[place] = (number / 25.0).to_string();
    cells.join(&by.to_string())
}

/// The first two of five nodes along the first axis of a grid.
fn beginning(text: &str) -> String {
    let node = |line: &&str| line.split(',').nth(1).and_then(|cell| cell.parse::<f64>().ok());
    let mut nodes: Vec<f64> = text.lines().filter_map(|line| node(&line)).collect();
    nodes.sort_by(f64::total_cmp);
    nodes.dedup();
    let kept = text.lines().filter(|line| node(line).is_none_or(|at| at <= nodes[1]));
    kept.map(|line| format!("{line}\n")).collect()
}

fn replaced_last(line: &str, by: &str) -> String {
    let mut cells: Vec<&str> = line.split_whitespace().collect();
    *cells.last_mut().expect("a cell") = by;
    cells.join(" ")
}

#[test]
fn files_of_a_control_that_cannot_be_meant_are_refused() {
    let machine = Machine::public("three-axis");
    for case in cases() {
        let text = case.file(&machine);
        let name = (case.name, case.file);
        case.with(&machine, &text, &json!({})).unwrap_or_else(|error| panic!("{name:?}: {error}"));
        let refused = |changed: &str, says: &str| {
            assert_ne!(changed, text, "{name:?}: nothing was changed for `{says}`\n{text}");
            let error = case.with(&machine, changed, &json!({})).err().unwrap_or_else(|| panic!("{name:?}: {says}"));
            let told = format!("{error} {:?}", error.help);
            assert!(told.contains(says), "{name:?}: {told}");
            let place = error.place.unwrap_or_else(|| panic!("{name:?}: no place of {told}"));
            assert!(place.file.ends_with(case.file), "{name:?}: {told}");
            (place.line, told)
        };
        let (value, inches, others) = case.wrong(&text);
        let first_changed = |changed: &str| {
            let same = changed.lines().zip(text.lines()).take_while(|(one, other)| one == other).count();
            Some(same + 1)
        };
        let (line, told) = refused(&value, "more than 1 ");
        // Values of Fanuc are added up from the reference point, so that one of them moves all points on its other side.
        let expected = if case.name == "fanuc-pitch" { line } else { first_changed(&value) };
        assert!(line.is_some() && line == expected, "{name:?}: {line:?} {told}");
        if let Some(inches) = inches {
            refused(&inches, "it covers ");
        }
        for other in others {
            let (line, told) = refused(&other, "this is a table of axis ");
            assert_eq!(line, first_changed(&other), "{name:?}: {told}");
        }
        // The message names the setting that allows more.
        let (setting, more) = match case.name {
            "grid" => ("largest_tip_correction_mm", json!({ "largest_tip_correction_mm": 100 })),
            "heidenhain-kinematics" | "isg-volumetric" => {
                ("largest_", json!({ "largest_mm": 100, "largest_deg": 100 }))
            }
            _ => {
                let mut tables = case.settings["tables"].clone();
                tables["largest_mm"] = json!(100);
                tables["largest_slope_um_per_mm"] = json!(1e4);
                ("tables.largest_mm", json!({ "tables": tables, "largest_value": 127 }))
            }
        };
        assert!(told.contains(setting), "{name:?}: {told}");
        if !["fanuc-pitch", "isg-tables", "siemens-tables", "heidenhain-tables"].contains(&case.name) {
            case.with(&machine, &value, &more).unwrap_or_else(|error| panic!("{name:?}: {error}"));
        }
    }
}
