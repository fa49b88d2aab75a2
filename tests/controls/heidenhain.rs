//! An interpreter of axis-error tables of Heidenhain, from the technical manuals of MANUALplus 620 (pp. 716, 718) and TNC 407 (p. 153).

use std::collections::BTreeMap;

use abbe_core::ExportedFile;
use serde_json::{Value, json};

use super::law::{ByAxis, Control, Machine, exporter, holds, predicted, seeds};
use super::random;

/// A table: the text of cells by column, and where its points are if no column says it.
struct Table {
    columns: BTreeMap<String, Vec<f64>>,
    datum: Option<(f64, f64)>,
}

/// The tables of the active line by moving axis, and what was found about the sense of values.
pub(super) struct Heidenhain {
    tables: BTreeMap<String, Table>,
    sense: f64,
}

fn text_of<'a>(files: &'a [ExportedFile], name: &str) -> &'a str {
    let file = files.iter().find(|file| file.name == name).unwrap_or_else(|| panic!("no {name}"));
    std::str::from_utf8(&file.content).expect("text")
}

impl Heidenhain {
    pub(super) fn load(files: &[ExportedFile], sense: f64) -> Self {
        let mut lines = text_of(files, "CONFIG.CMA").lines();
        assert_eq!(lines.next(), Some("BEGIN CONFIG.CMA"));
        let head = lines.next().expect("columns");
        let active: Vec<&str> = lines.filter(|line| line.split_whitespace().nth(1) == Some("*")).collect();
        assert_eq!(active.len(), 1);
        // Cells stand below the names of their columns.
        let cell = |name: &str| {
            let from = format!("{head} ").find(&format!(" {name} ")).unwrap() + 1;
            active[0].get(from..).and_then(|rest| rest.split(' ').next()).filter(|cell| !cell.is_empty())
        };
        let axes = head.split_whitespace().skip(2);
        let table = |axis: &str| Some((axis.to_owned(), Table::read(text_of(files, cell(axis)?))));
        Self { tables: axes.filter_map(table).collect(), sense }
    }
}

impl Table {
    fn read(text: &str) -> Self {
        let mut lines = text.lines();
        let begin = lines.next().expect("a line");
        assert!(begin.starts_with("BEGIN ") && text.ends_with("[END]\n"), "{text}");
        let after = |word: &str| Some(begin.split(word).nth(1)?.split(' ').next()?.parse::<f64>().unwrap());
        let names: Vec<&str> = lines.next().expect("columns").split_whitespace().collect();
        let mut columns: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for (row, line) in lines.take_while(|line| *line != "[END]").enumerate() {
            let words: Vec<&str> = line.split_whitespace().collect();
            assert_eq!(words.len(), names.len(), "{line}");
            assert_eq!(words[0], row.to_string());
            for (name, word) in names.iter().zip(words) {
                columns.entry((*name).to_owned()).or_default().push(word.parse().unwrap());
            }
        }
        assert!(columns["NR"].len() <= 256);
        Self { columns, datum: after("DATUM:").zip(after("DISTANCE:")) }
    }

    fn point(&self, row: usize) -> f64 {
        match (self.columns.get("AXISPOS"), self.datum) {
            (Some(column), _) => column[row],
            (None, Some((datum, distance))) => datum + row as f64 * distance,
            (None, None) => panic!("no points"),
        }
    }

    fn value(&self, column: &str, at: f64) -> f64 {
        let (values, mut row) = (&self.columns[column], 0);
        let last = values.len() - 1;
        assert!(at > self.point(0) - 1e-6 && at < self.point(last) + 1e-6, "{at}: nothing is documented there");
        while row + 1 < last && self.point(row + 1) <= at {
            row += 1;
        }
        let part = (at - self.point(row)) / (self.point(row + 1) - self.point(row));
        values[row] + part * (values[row + 1] - values[row])
    }
}

impl Control for Heidenhain {
    fn motors(&self, commands: &ByAxis, directions: &ByAxis) -> ByAxis {
        let mut motors = commands.clone();
        for (cause, table) in &self.tables {
            // "With an axis of rotation, the system only recognizes corrections of entries from 0 to 360."
            let is_turn = table.datum.is_some() && ["A", "B", "C"].contains(&cause.as_str());
            let at = if is_turn { commands[cause].rem_euclid(360.0) } else { commands[cause] };
            for corrected in table.columns.keys().filter(|name| !["NR", "AXISPOS", "BACKLASH"].contains(&name.as_str()))
            {
                let is_backward = directions[cause] < 0.0 && corrected == cause;
                let column = if is_backward && table.columns.contains_key("BACKLASH") { "BACKLASH" } else { corrected };
                *motors.get_mut(corrected).expect("an axis") += self.sense * table.value(column, at);
            }
        }
        motors
    }
}

fn control(files: &[ExportedFile], sense: f64) -> Box<dyn Control> {
    Box::new(Heidenhain::load(files, sense))
}

fn file(name: &str, text: &str) -> ExportedFile {
    ExportedFile { name: name.to_owned(), content: text.into() }
}

/// The examples of both manuals: Z and Y are corrected along Y, points of Y every 6.5536 mm from -90 mm: 77 of them reach over 500 mm,
/// and 1.7504 mm is the fifteenth.
#[test]
fn the_control_does_what_the_manuals_say() {
    let rows: String =
        (0..=77).map(|row| format!("{row} {:.4} {:.4}\n", 0.001 * row as f64, -0.002 * row as f64)).collect();
    let table = format!("BEGIN AXIS-Y.COM DATUM:-90.0000 DISTANCE:+6.5536\nNR Z Y\n{rows}[END]\n");
    let assigned = "BEGIN CONFIG.CMA\nNR ACTIVE X          Y          Z\n0                    AXIS-Z.COM\n\
                    1  *                 AXIS-Y.COM\n[END]\n";
    let control = control(&[file("CONFIG.CMA", assigned), file("AXIS-Y.COM", &table)], 1.0);
    for (y, row) in [(-90.0, 0.0), (-76.8928, 2.0), (-63.7856, 4.0), (-50.6784, 6.0), (1.7504, 14.0), (-86.7232, 0.5)] {
        let at = |values: [f64; 3]| ["X", "Y", "Z"].map(str::to_owned).into_iter().zip(values).collect::<ByAxis>();
        let found = control.motors(&at([5.0, y, 7.0]), &at([1.0; 3]));
        for (axis, expected) in [("X", 5.0), ("Y", y - 0.002 * row), ("Z", 7.0 + 0.001 * row)] {
            assert!((found[axis] - expected).abs() < 1e-9, "{axis} at {y}: {}", found[axis]);
        }
    }
}

/// Half a unit of the last digit, 0.1 µm, of own and cross compensation for three axes; and of an angle at the radius of the tool.
const ROUNDING: f64 = 1e-6;

fn settings(tables: Value, values: &str) -> Value {
    json!({ "tables": tables, "values": values })
}

/// Pairs of axes that all machines have.
fn cross(machine: &Machine) -> Vec<Value> {
    let pairs = [("X", "Y"), ("Y", "Z"), ("Z", "X"), ("Z", "Y")];
    let travels = |axis: &str| machine.model.info().axes.iter().any(|other| other.name == axis);
    let fits = |(correct, along): &(&str, &str)| travels(correct) && travels(along);
    pairs.into_iter().filter(fits).map(|(correct, along)| json!({ "correct": correct, "along": along })).collect()
}

#[test]
fn the_law_holds() {
    let public = ["table-table", "head-table", "three-axis"].map(Machine::public).into_iter();
    let random = seeds(50).map(|seed| random::machine(seed, random::Errors::Any));
    for (seed, machine) in public.chain(random).enumerate() {
        for (values, sense) in [("added", 1.0), ("subtracted", -1.0)] {
            let tables = json!({ "step_mm": 50, "cross": cross(&machine) });
            let export = exporter("heidenhain-tables", &settings(tables, values));
            let statuses = machine.anywhere(60, &[], seed as u64 + 5);
            predicted(&machine, export.as_ref(), &|files| control(files, sense), &statuses, ROUNDING);
            // A control that takes values the other way round is told apart.
            let files = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
            let turned = super::law::left(&machine, export.as_ref(), control(&files, -sense).as_ref(), &statuses);
            assert!(turned.from_predicted > 10.0 * ROUNDING, "seed {seed}: {turned:?}");
        }
    }
}

/// Where axes have no other errors, nothing is left but interpolation and the digits of the file.
#[test]
fn positioning_errors_and_reversal_are_corrected() {
    for seed in seeds(50) {
        let machine = random::machine(seed, random::Errors::Positioning);
        let statuses = machine.anywhere(100, &[], seed + 1);
        for step in [75.0, 10.0] {
            let export = exporter("heidenhain-tables", &settings(json!({ "step_mm": step }), "subtracted"));
            let left = holds(&machine, export.as_ref(), &|files| control(files, -1.0), &statuses, ROUNDING);
            assert!(left.before > 1e-3 && left.after < random::bow(step) + 1e-4, "seed {seed}, step {step}: {left:?}");
        }
    }
}

/// A rotary axis stands where it should: what is left are 0.0001 degrees at the radius of the tool.
#[test]
fn rotary_axes_are_corrected() {
    let (mut all, mut below) = (0, 0);
    for seed in seeds(25) {
        let machine = random::machine(seed, random::Errors::Rotary);
        let statuses = machine.anywhere(100, &[], seed + 1);
        let export = exporter("heidenhain-tables", &settings(json!({}), "added"));
        all += 1;
        // Errors below the last digit of the file.
        if export
            .export(&machine.calibration, machine.model.as_ref())
            .is_err_and(|error| error.message.contains(NOTHING))
        {
            below += 1;
            continue;
        }
        let left = holds(&machine, export.as_ref(), &|files| control(files, 1.0), &statuses, ROUNDING);
        assert!(left.before > left.after && left.after < 1e-3, "seed {seed}: {left:?}");
    }
    assert!(below * 50 <= all, "{below} of {all} machines have nothing to correct");
}

/// What the exporter says then.
const NOTHING: &str = "there is nothing to correct";

/// Older controls: points by datum and distance, the same in both directions of travel.
#[test]
fn older_forms_correct_what_has_no_direction() {
    for seed in seeds(20) {
        let machine = random::machine(seed, random::Errors::OfOneAxis);
        let machine = random::without_reversal(&machine);
        let statuses = machine.anywhere(100, &[], seed + 1);
        let axes = ["X", "Y", "Z"];
        let pairs = axes.iter().flat_map(|correct| axes.map(|along| json!({ "correct": correct, "along": along })));
        let cross: Vec<Value> = pairs.filter(|pair| pair["correct"] != pair["along"]).collect();
        let reach = 26.2144 * 12.0;
        let ranges: BTreeMap<&str, Value> =
            axes.map(|axis| (axis, json!({ "from_mm": -reach, "to_mm": reach }))).into();
        for (form, tables) in [
            ("datum-and-distance", json!({ "step_mm": 25, "cross": cross })),
            ("power-of-two", json!({ "step_mm": 26.2144, "cross": cross, "ranges": ranges })),
        ] {
            let mut settings = settings(tables, "subtracted");
            settings["form"] = json!(form);
            let export = exporter("heidenhain-tables", &settings);
            let left = holds(&machine, export.as_ref(), &|files| control(files, -1.0), &statuses, ROUNDING);
            assert!(left.after < random::bow(26.3) + 5e-4 && left.before > 10.0 * left.after, "seed {seed}: {left:?}");
        }
    }
}

#[test]
fn tables_that_are_active_are_added() {
    for seed in seeds(10) {
        let machine = random::machine(seed, random::Errors::Any);
        let other = random::machine_like(seed, seed + 1000);
        let folder = crate::support::temporary();
        let old = json!({ "step_mm": 100, "positioning": ["X", "Y"], "cross": [{ "correct": "Z", "along": "X" }] });
        let before = exporter("heidenhain-tables", &settings(old, "subtracted"))
            .export(&other.calibration, machine.model.as_ref())
            .expect("files");
        let mut added = settings(json!({ "step_mm": 50, "cross": cross(&machine) }), "subtracted");
        added["existing"] = json!({});
        for file in before.iter().filter(|file| file.name.ends_with(".COM")) {
            let path = folder.path().join(&file.name);
            std::fs::write(&path, &file.content).expect("a file");
            added["existing"][&file.name[5..6]] = json!(path);
        }
        let export = exporter("heidenhain-tables", &added);
        let after = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
        let correction = export.correction(&machine.calibration, machine.model.as_ref()).expect("one").expect("tables");
        let statuses = machine.anywhere(50, &[], seed);
        let predicted = correction.commands(&statuses).expect("commands");
        let [old, new] = [before, after].map(|files| machine.driven(control(&files, -1.0).as_ref(), &statuses));
        for (((status, old), new), predicted) in statuses.iter().zip(old).zip(new).zip(predicted) {
            assert!((new - old - (predicted - status)).abs() < ROUNDING, "seed {seed}");
        }
    }
}

#[test]
fn wrong_settings_are_refused() {
    let machine = Machine::public("three-axis");
    for (change, expected) in [
        (json!({ "form": "datum-and-distance" }), "form: the correction of "),
        (json!({ "most_points": 5 }), "tables.step_mm: axis "),
        (json!({ "tables": { "step_mm": 0.00005 } }), "tables.step_mm: "),
        (
            json!({ "tables": { "ranges": { "X": { "from_mm": 0.000_05, "to_mm": 100.000_05 } }, "positioning": ["X"] } }),
            "tables.step_mm: points of X",
        ),
        (
            json!({ "tables": { "positioning": ["X"] }, "form": "power-of-two" }),
            "tables.step_mm: a distance of a power of two",
        ),
        (json!({ "existing": { "X": "nowhere.com" } }), "existing: ./nowhere.com: it cannot be read"),
        (json!({ "existing": { "V": "nowhere.com" } }), "existing.V: the machine has no axis V"),
    ] {
        let mut settings = settings(json!({}), "added");
        change.as_object().unwrap().iter().for_each(|(name, value)| settings[name] = value.clone());
        let export = exporter("heidenhain-tables", &settings);
        let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("an error");
        let found = format!("{}: {error}", abbe_core::path_text(&error.setting));
        assert!(found.starts_with(expected), "{change}: {found}");
    }
    let said = super::law::refused("heidenhain-tables", &json!({}));
    assert!(said.contains("values"), "{said}");
}

/// A file that is no table, one at a time.
#[test]
fn files_that_are_no_tables_are_refused() {
    let machine = Machine::public("three-axis");
    let folder = crate::support::temporary();
    let path = folder.path().join("AXIS_X.COM");
    for (text, expected) in [
        ("", "`BEGIN` was expected"),
        ("BEGIN AXIS_X.COM MM\n0 1 2\n", "`NR` was expected"),
        ("BEGIN AXIS_X.COM INCH\nNR AXISPOS X\n0 0 0\n1 1 0\n[END]\n", "a table in mm was expected"),
        ("BEGIN AXIS_X.COM MM\nNR AXISPOS X\n0 0 0\n1 1\n[END]\n", "3 numbers were expected"),
        ("BEGIN AXIS_X.COM MM\nNR AXISPOS X\n0 0 NaN\n1 1 0\n[END]\n", "3 numbers were expected"),
        ("BEGIN AXIS_X.COM MM\nNR AXISPOS X\n0 0 0\n1 1 0\n", "`[END]`"),
        ("BEGIN AXIS_X.COM MM\nNR X\n0 0\n1 1\n[END]\n", "`AXISPOS`, or `DATUM:`"),
        ("BEGIN AXIS_X.COM MM\nNR AXISPOS C1\n0 0 0\n1 1 0\n[END]\n", "the machine has no axis C1"),
        ("BEGIN AXIS_X.COM MM\nNR AXISPOS BACKLASH Y\n0 0 0 0\n1 1 0 0\n[END]\n", "`BACKLASH` needs"),
        ("BEGIN AXIS_X.COM MM\nNR AXISPOS X\n0 1 0\n1 0 0\n[END]\n", "increasing positions"),
    ] {
        std::fs::write(&path, text).expect("a file");
        let mut settings = settings(json!({}), "added");
        settings["existing"] = json!({ "X": path });
        let export = exporter("heidenhain-tables", &settings);
        let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("an error").to_string();
        assert!(error.contains(expected), "{text}: {error}");
    }
}

/// A recipe writes the files, and the validator says what they leave.
#[test]
fn a_recipe_writes_tables_and_judges_them() {
    let place = crate::support::temporary();
    let truth = crate::compensation::calibration("three-axis").to_string();
    std::fs::write(place.path().join("truth.calibration.json"), truth).expect("a file");
    let recipe = "abbe: 1\nname: Tables\nstages:\n  truth: { estimate: calibration, path: truth.calibration.json }\n  \
                  tables: { export: heidenhain-tables, of: truth, values: subtracted, \
                  tables: { step_mm: 50, cross: [{ correct: X, along: Y }] } }\n  \
                  pitch: { export: fanuc-pitch, of: truth, values: added, axis_numbers: { X: 1, Y: 2, Z: 3 }, \
                  tables: { step_mm: 50 }, largest_value: 127 }\n  \
                  after: { validate: compensated, of: truth, grid: { points: 4, both_directions: true }, \
                  exports: [tables, pitch] }\n";
    std::fs::write(place.path().join("tables.yaml"), recipe).expect("a file");
    let printed = crate::support::abbe(place.path(), &["run", "tables.yaml"]);
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    let out = place.path().join("out/tables");
    for name in ["tables/AXIS_X.COM", "tables/AXIS_Y.COM", "tables/CONFIG.CMA", "pitch/fanuc-pitch.txt"] {
        assert!(out.join(name).exists(), "{name}");
    }
    let verdicts = crate::support::json_file(&out.join("verdicts.json"));
    let figure = |name: &str| {
        let figures = verdicts[0]["figures"].as_array().expect("figures");
        let found = figures.iter().find(|figure| figure["name"] == json!(name));
        found.and_then(|figure| figure["value"].as_f64()).unwrap_or_else(|| panic!("no {name} in {verdicts}"))
    };
    let [before, tables, pitch] = ["tip max[before]", "tip max[tables]", "tip max[pitch]"].map(figure);
    assert!(tables < before && pitch < before, "{before} {tables} {pitch}");
}
