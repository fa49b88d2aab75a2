//! Logs of measuring programs and files of other software, from the file to the parameters: the same as from a table.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use abbe_engine::Outcome;
use serde_json::json;

use crate::support::{Variant, abbe, fit, json_file, read, recipes, registry, root, temporary, values, write};

/// A table as rows of cells by the name of their column.
fn table(path: &Path) -> Vec<BTreeMap<String, String>> {
    let text = read(path);
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let names: Vec<String> = lines.next().expect("a header").split(',').map(str::to_owned).collect();
    lines.map(|line| names.iter().cloned().zip(line.split(',').map(str::to_owned)).collect()).collect()
}

fn number(row: &BTreeMap<String, String>, name: &str) -> f64 {
    row[name].parse().expect("a number")
}

/// All values of an estimate.
fn found(outcome: &Outcome, name: &str) -> BTreeMap<String, f64> {
    values(&fit(outcome, name).calibration).map(|value| (value.name.clone(), value.value)).collect()
}

fn same(one: &BTreeMap<String, f64>, other: &BTreeMap<String, f64>) {
    assert!(one.len() > 3 && one.keys().eq(other.keys()), "{one:?}\n{other:?}");
    for (name, value) in one {
        assert!((value - other[name]).abs() < 1e-9, "{name}: {value} {}", other[name]);
    }
}

/// Touches of the machine's own table, and what they tell.
fn touched() -> (Variant, Vec<BTreeMap<String, String>>) {
    let recipe = Variant::of(&recipes()["tango-hu40t-exact"]).only(&["fit-S3"]);
    let rows = table(&recipe.path("touches", "path"));
    (recipe, rows)
}

#[test]
fn a_log_gives_what_its_touches_give() {
    let (mut recipe, rows) = touched();
    let expected = found(&recipe.run(), "fit-S3");
    let folder = temporary();
    let file = |name: &str| folder.path().join(name);
    // Planned is what is measured, to the nearest 0.1 mm.
    let kept = ["feature", "B_deg", "C_deg", "S_deg", "dir_X", "dir_Y", "dir_Z", "dir_B", "dir_C", "time_s", "group"];
    let mut plan = format!("touch,X_mm,Y_mm,Z_mm,{}\n", kept.join(","));
    for row in &rows {
        let planned = ["X_mm", "Y_mm", "Z_mm"].map(|axis| format!("{:.1}", number(row, axis)));
        let others: Vec<&str> = kept.iter().map(|name| row[*name].as_str()).collect();
        let _ = writeln!(plan, "{},{},{}", row["touch"], planned.join(","), others.join(","));
    }
    write(&file("plan.csv"), &plan);
    let offset = [-200.0, 150.5, 300.25];
    let log = |identity: &str, shift: f64| {
        let mut text = format!(
            "ABBE 1\nPLAN {identity}\nCONTROL LINUXCNC\nUNITS MM\nFRAME WORK\nOFFSET X{} Y{} Z{} B0 C0\nTOUCHES {}\n",
            offset[0],
            offset[1],
            offset[2] + shift,
            rows.len()
        );
        // Another order, and a miss before each third touch.
        for row in rows.iter().rev() {
            if row["touch"].parse::<usize>().expect("a number") % 3 == 0 {
                let _ = writeln!(text, "T{}.000000 R1.000000 H0.000000 X0 Y0 Z0 B0 C0", row["touch"]);
            }
            let [x, y, z] = [("X_mm", 0), ("Y_mm", 1), ("Z_mm", 2)].map(|(axis, k)| number(row, axis) - offset[k]);
            let (b, c) = (number(row, "B_deg"), number(row, "C_deg").rem_euclid(360.0));
            let _ = writeln!(text, "T{}.000000 R1 H1 X{x:.12} Y{y:.12} Z{z:.12} B{b} C{c} F50", row["touch"]);
        }
        text + "END\n"
    };
    let settings = json!({ "ingest": "linuxcnc-log", "path": file("measure.log"), "plan": file("plan.csv"), "time": "plan",
        "ignore": { "feature": [1, 2] } });
    recipe.0["stages"]["touches"] = settings;
    let path = recipe.write(folder.path());
    let run = || abbe(folder.path(), &[Path::new("run"), &path]);
    // Another plan is refused, and the message says which one this is.
    write(&file("measure.log"), &log("0123456789ABCDEF", 0.0));
    let told = run().stderr;
    let identity =
        told.split("plan.csv` is ").nth(1).and_then(|rest| rest.get(..16)).unwrap_or_else(|| panic!("{told}"));
    write(&file("measure.log"), &log(identity, 0.0));
    same(&expected, &found(&recipe.run(), "fit-S3"));
    // The header may state the tip: it is the machine's, of 3 mm radius, and a calibrated one is a little smaller.
    let with_tip = |tip: &str| log(identity, 0.0).replace("TOUCHES", &format!("TOOL {tip}\nTOUCHES"));
    write(&file("measure.log"), &with_tip("L326.674 D5.97"));
    same(&expected, &found(&recipe.run(), "fit-S3"));
    write(&file("measure.log"), &with_tip("L326.674 D4"));
    let told = run();
    assert!(told.status == 1 && told.stderr.contains("measure.log:7"), "{}", told.stderr);
    assert!(told.stderr.contains("a stylus tip of 4 mm diameter, and the machine has one of 6 mm"), "{}", told.stderr);
    // A tool that is longer by 10 mm than the control believed.
    write(&file("measure.log"), &log(identity, 10.0));
    let told = run();
    assert!(told.status == 1 && told.stderr.contains("farther from the plan than 2 mm"), "{}", told.stderr);
    assert!(told.stderr.contains("is the length of the tool wrong"), "{}", told.stderr);
}

/// A direction of the table in the machine's frame: on `w C' B' X' b ..` the table turns by -C, then by -B.
fn turned([x, y, z]: [f64; 3], b: f64, c: f64) -> [f64; 3] {
    let (sc, cc) = (-c.to_radians()).sin_cos();
    let [x, y] = [cc * x - sc * y, sc * x + cc * y];
    let (sb, cb) = (-b.to_radians()).sin_cos();
    [cb * x + sb * z, y, -sb * x + cb * z]
}

#[test]
fn results_of_an_inspection_give_what_their_touches_give() {
    let (mut recipe, rows) = touched();
    let expected = found(&recipe.run(), "fit-S3");
    let folder = temporary();
    let facets = table(&recipe.path("table", "nominal"));
    let normal = |feature: &str| {
        let row = facets.iter().find(|row| row["feature"] == feature).expect("a facet");
        ["nx", "ny", "nz"].map(|name| number(row, name))
    };
    let kept = ["B_deg", "C_deg", "S_deg", "dir_X", "dir_Y", "dir_Z", "dir_B", "dir_C", "time_s", "group"];
    let mut sets = format!("set,{}\n", kept.join(","));
    let mut results = String::new();
    let touches = rows.iter().filter(|row| !["1", "2"].contains(&row["feature"].as_str()));
    for (index, row) in touches.enumerate() {
        let others: Vec<&str> = kept.iter().map(|name| row[*name].as_str()).collect();
        let _ = writeln!(sets, "{},{}", index + 1, others.join(","));
        let centre = ["X_mm", "Y_mm", "Z_mm"].map(|axis| number(row, axis));
        let n = turned(normal(&row["feature"]), number(row, "B_deg"), number(row, "C_deg"));
        let [x, y, z] = [0, 1, 2].map(|k| centre[k] - 3.0 * n[k]);
        let (number, [i, j, k], [cx, cy, cz]) = (&row["feature"], n, centre);
        let _ = write!(
            results,
            "START\nTOOLPATHID 7\nG800 N{number} X{x:.3} Y{y:.3} Z{z:.3} I{i:.6} J{j:.6} K{k:.6} O0. U.1 L-.1\n\
             G801 N{number} X{cx:.9} Y{cy:.9} Z{cz:.9} R3.\nEND\n"
        );
    }
    write(&folder.path().join("results.txt"), &results);
    write(&folder.path().join("sets.csv"), &sets);
    recipe.0["stages"]["touches"] = json!({ "ingest": "inspection-g800", "path": folder.path().join("results.txt"),
        "units": "mm", "join": { "table": folder.path().join("sets.csv"), "on": "set" } });
    same(&expected, &found(&recipe.run(), "fit-S3"));
}

#[test]
fn dmis_output_and_qif_results_of_a_plate_give_what_its_table_gives() {
    let mut recipe = Variant::of(&recipes()["mill-hole-plate-exact"]).only(&["before"]);
    let expected = found(&recipe.run(), "before");
    let folder = temporary();
    let data = root().join("pipelines/data/mill-5axis");
    let mut paths: Vec<PathBuf> = Vec::new();
    for name in ["plate-xy", "plate-xz", "plate-yz"] {
        let mut output = String::from("$$ holes\nUNITS/INCH,ANGDEC\n");
        for row in table(&data.join(format!("exact/{name}.csv"))).iter().filter(|row| row["run"] == "1") {
            let [x, y, z] = ["X_mm", "Y_mm", "Z_mm"].map(|axis| number(row, axis) / 25.4);
            let _ = write!(
                output,
                "OUTPUT/FA({0})\nFA({0})=FEAT/CIRCLE,INNER,CART,{x:.14},{y:.14},{z:.14},$\n  0.,0.,1.,.787\n",
                row["hole"]
            );
        }
        paths.push(folder.path().join(format!("{name}.dmo")));
        write(paths.last().expect("a path"), &output);
    }
    // Names in DMIS are in capitals.
    let plate = read(&data.join("plate.csv")).replace("hole,x_mm", "point,x_mm").replace("\nh", "\nH");
    write(&folder.path().join("plate.csv"), &plate);
    let csv = recipe.0["stages"]["plate-files"].clone();
    recipe.0["stages"]["plate-files"] = json!({ "ingest": "csv", "path": csv["path"], "constants": csv["constants"],
        "join": csv["join"], "keep": { "run": [1] } });
    let expected_of_first = found(&recipe.run(), "before");
    assert_eq!(expected.len(), expected_of_first.len());
    recipe.0["stages"]["plate-files"] =
        json!({ "ingest": "dmis-output", "path": paths, "constants": csv["constants"], "join": csv["join"] });
    let mut recipe =
        recipe.set("plate", "points", json!(folder.path().join("plate.csv"))).set("plate", "point", json!("point"));
    same(&expected_of_first, &found(&recipe.run(), "before"));
    // The same as QIF results.
    for path in &mut paths {
        let output = read(path);
        *path = path.with_extension("qif");
        write(path, &qif(&output));
    }
    recipe.0["stages"]["plate-files"] =
        json!({ "ingest": "qif-results", "path": paths, "constants": csv["constants"], "join": csv["join"] });
    same(&expected_of_first, &found(&recipe.run(), "before"));
}

/// QIF results with the circles of a DMIS output.
fn qif(output: &str) -> String {
    let (mut items, mut measured) = (String::new(), String::new());
    let circles = output.lines().filter_map(|line| line.strip_prefix("FA(")?.split_once(")=FEAT/CIRCLE,INNER,CART,"));
    for (index, (name, rest)) in circles.enumerate() {
        let name = name.to_uppercase();
        let place = rest.trim_end_matches(",$").replace(',', " ");
        let _ = write!(items, "<CircleFeatureItem id='{index}'><FeatureName>{name}</FeatureName></CircleFeatureItem>");
        let _ = write!(
            measured,
            "<CircleFeatureMeasurement><FeatureItemId>{index}</FeatureItemId>\n<Location>{place}</Location></CircleFeatureMeasurement>"
        );
    }
    format!(
        "<QIFDocument versionQIF='3.0.0'><FileUnits><PrimaryUnits><LinearUnit><SIUnitName>meter</SIUnitName>\
         <UnitName>inch</UnitName><UnitConversion><Factor>0.0254</Factor></UnitConversion></LinearUnit></PrimaryUnits>\
         </FileUnits><Features><FeatureItems>{items}</FeatureItems></Features><Results><MeasurementResultsSet>\
         <MeasurementResults><MeasuredFeatures>{measured}</MeasuredFeatures></MeasurementResults>\
         </MeasurementResultsSet></Results></QIFDocument>"
    )
}

/// The recipe reads what it writes: the file beside it is its own export, the corrected holes are where the plate has them, and without
/// the correction they are not.
#[test]
fn qif_results_that_a_recipe_writes_are_those_that_it_reads() {
    let recipe = Variant::of(&recipes()["qif-results"]);
    let outcome = recipe.run();
    let (_, files) = outcome.exports.iter().find(|(stage, _)| stage == "holes").expect("the export");
    let kept = read(&root().join("pipelines/data/qif/results.qif"));
    assert_eq!(String::from_utf8_lossy(&files[0].content), kept);
    let truth = json_file(&root().join("tests/truth/qif-results.json"));
    for (name, expected) in truth["parameters"].as_object().expect("a map") {
        let found = fit(&outcome, "fit").calibration.get(name).unwrap_or_else(|| panic!("no {name}"));
        let error = (found.value - expected.as_f64().expect("a number")) / found.standard_uncertainty;
        assert!(error.abs() < 3.5, "{name}: {error}");
    }
    let rms = |outcome: &Outcome| fit(outcome, "inspected").calibration.fit.residual_rms_um;
    assert!(rms(&outcome) < 0.6, "{}", rms(&outcome));
    let mut recipe = recipe;
    recipe.0["stages"]["read-back"] = json!({ "ingest": "csv", "path": root().join("pipelines/data/qif/workpiece.csv"),
        "columns": { "X_mm": "X_mm", "Y_mm": "Y_mm", "Z_mm": "Z_mm", "run": "run", "point": "feature" },
        "constants": { "meas_z": 0, "placement": "last" } });
    assert!(rms(&recipe.run()) > 1.2);
}

/// Nominal places of two holes that are exchanged say that each was found where the other should be; a part that lies elsewhere as a
/// whole, and a hole that is off, are results.
#[test]
fn nominal_places_that_are_exchanged_are_refused() {
    let exported = |change: &dyn Fn(&mut [String])| {
        let folder = temporary();
        let mut recipe = Variant::of(&recipes()["qif-results"]).only(&["fit", "holes"]);
        let lines = read(&recipe.path("holes", "path"));
        let changed = lines.lines().map(|line| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if line.starts_with(['1', '2']) {
                change(&mut cells);
            }
            cells.join(",") + "\n"
        });
        let file = folder.path().join("workpiece.csv");
        write(&file, &changed.collect::<String>());
        recipe.stage("holes")["path"] = json!(file);
        let written = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["run".as_ref(), written.as_os_str(), "--out".as_ref(), "out".as_ref()]);
        let is_there = folder.path().join("out/recipe/holes/results.qif").is_file();
        (printed.status, printed.stderr, is_there)
    };
    let exchanged = |cells: &mut [String]| match cells[1].as_str() {
        "b1" => (cells[5], cells[6]) = ("170".to_owned(), "160".to_owned()),
        "b5" => (cells[5], cells[6]) = ("70".to_owned(), "60".to_owned()),
        _ => {}
    };
    let (status, told, is_there) = exported(&exchanged);
    assert!(status != 0 && !is_there, "{told}");
    assert!(told.contains("point `b1` was found 141.") && told.contains("where `b5` should be"), "{told}");
    assert!(told.contains("workpiece.csv:3"), "{told}");
    let by = |cell: &str, by: f64| format!("{}", cell.parse::<f64>().expect("a number") + by);
    let elsewhere = |cells: &mut [String]| cells[5] = by(&cells[5], 100.0);
    let off = |cells: &mut [String]| {
        if cells[1] == "b4" {
            cells[6] = by(&cells[6], 1.5);
        }
    };
    for good in [&elsewhere as &dyn Fn(&mut [String]), &off, &|_: &mut [String]| ()] {
        let (status, told, is_there) = exported(good);
        assert!(status == 0 && is_there, "{told}");
    }
}

/// What LinuxCNC has logged in simulation, with hidden errors: the truth is inside four standard uncertainties, and the log in another
/// order of its lines, or without one of them, is no other measurement.
#[test]
fn logs_of_linuxcnc_itself_tell_what_was_hidden() {
    for name in ["linuxcnc-table", "linuxcnc-balls"] {
        let recipe = Variant::of(&recipes()[name]).only(&["fit"]);
        let outcome = recipe.run();
        let truth = json_file(&root().join(format!("tests/truth/{name}.json")));
        let calibration = &fit(&outcome, "fit").calibration;
        let hidden = truth["parameters"].as_object().expect("a map");
        assert!(hidden.len() >= 6, "{name}");
        for (parameter, hidden) in hidden {
            let found = calibration.get(parameter).unwrap_or_else(|| panic!("{name}: {parameter} is not estimated"));
            let hidden = hidden.as_f64().expect("a number");
            let off = (found.value - hidden) / found.standard_uncertainty;
            assert!(
                off.abs() < 4.0,
                "{name}: {parameter} is {} of {hidden}, {off} standard uncertainties",
                found.value
            );
        }
        // The other sign is not what was measured.
        let beyond = hidden.iter().filter(|(parameter, hidden)| {
            let found = calibration.get(parameter).expect("it is estimated");
            ((found.value + hidden.as_f64().expect("a number")) / found.standard_uncertainty).abs() > 10.0
        });
        assert!(beyond.count() >= 3, "{name}");
        let log = read(&recipe.path("touches", "path"));
        let folder = temporary();
        let with = |lines: Vec<&str>, file: &str| {
            let file = folder.path().join(file);
            write(&file, &(lines.join("\n") + "\n"));
            let changed = Variant(recipe.0.clone()).set("touches", "path", json!(file));
            abbe_engine::prepare(&changed.write(folder.path()), &registry()).and_then(|prepared| prepared.check())
        };
        let touches: Vec<usize> = log
            .lines()
            .enumerate()
            .filter(|(_, line)| line.starts_with('T') && line.contains(" H1 "))
            .map(|(at, _)| at)
            .collect();
        let mut lines: Vec<&str> = log.lines().collect();
        assert!(with(lines.clone(), "same.log").is_ok());
        lines.swap(touches[2], touches[9]);
        assert!(with(lines.clone(), "swapped.log").is_ok());
        lines.remove(touches[4]);
        assert!(with(lines, "lost.log").is_err(), "{name}: a lost line passes");
    }
}
