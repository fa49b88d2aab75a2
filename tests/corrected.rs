//! What a correction refuses or tells: loads that were not measured, offsets that a program does not name, machines that differ.

use serde_json::json;

use crate::compensation::calibration;
use crate::support::{Variant, abbe, read, recipes, root, temporary, write};

/// What was printed, as one line.
fn said(text: &str) -> String {
    text.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

/// Loads from 0 to 4900 N were measured.
#[test]
fn loads_that_were_not_measured_are_told() {
    let folder = temporary();
    let at = folder.path();
    let recipe = Variant::of(&recipes()["mill-direct"]).only(&["fit-angles"]).write(at);
    let run = abbe(at, &["run".as_ref(), recipe.as_os_str(), "--out".as_ref(), "out".as_ref()]);
    assert_eq!(run.status, 0, "{}", run.stderr);
    let result = "out/recipe/fit-angles.calibration.json";
    let measured = crate::support::json_file(&at.join(result))["fit"]["statuses"]["load"].clone();
    assert!(measured[1].as_f64().is_some_and(|most| (4000.0..6000.0).contains(&most)), "{measured}");
    for (load, is_told, is_refused) in [
        ("0", false, false),
        ("4900", false, false),
        ("5100", false, false),
        ("9000", true, false),
        ("49000", true, true),
    ] {
        let row = |load: &str| format!("300,200,300,0,0,1,{load},0\n");
        let text = format!("X_mm,Y_mm,Z_mm,B_deg,C_deg,stylus,load_N,load_z_mm\n{}{}", row("1000"), row(load));
        write(&at.join("points.csv"), &text);
        for command in ["compensate", "correct"] {
            let more: &[&str] = match command {
                "compensate" => &["--largest-tip-correction-mm", "10"],
                _ => &["--largest-correction-mm", "10"],
            };
            let found = abbe(at, &[&[command, result, "points.csv"][..], more].concat());
            let text = said(&found.stderr);
            assert_eq!(found.status, i32::from(is_refused), "{command} {load}: {text}");
            assert_eq!(
                text.contains("`load_N` is") && text.contains("points.csv:3:"),
                is_told,
                "{command} {load}: {text}"
            );
            assert_eq!(
                text.contains("corrections are extrapolated"),
                is_told && !is_refused,
                "{command} {load}: {text}"
            );
        }
        // A program names its load as an option.
        write(&at.join("part.ngc"), "G21 G90 G17 G94 G54\nG0 X300 Y200 Z300 B0 C0\nG1 X310 F100\nM2\n");
        let load = format!("load_N={load}");
        let constants = ["--constant", &load, "--constant", "stylus=1", "--constant", "load_z_mm=0"];
        let program = ["compensate", result, "part.ngc", "--dialect", "linuxcnc", "--largest-tip-correction-mm", "10"];
        let found = abbe(at, &[&program[..], &constants, &["--offset", "G54=X0,Y0,Z0"]].concat());
        let text = said(&found.stderr);
        assert_eq!(found.status, i32::from(is_refused), "{load}: {text}");
        assert_eq!(text.contains("--constant: `load_N` is"), is_told, "{load}: {text}");
    }
}

/// On a SINUMERIK it is a parameter which work offset acts, and often none does.
#[test]
fn a_program_that_names_no_work_offset_is_told() {
    let folder = temporary();
    let at = folder.path();
    write(&at.join("truth.calibration.json"), &calibration("three-axis").to_string());
    for (dialect, head, line) in [
        ("siemens", "G71 G90 G17 G94\n", Some(2)),
        ("siemens", "G71 G90 G17 G94\nSUPA G0 Z100\n", Some(3)),
        ("siemens", "G71 G90 G17 G94\nG54\n", None),
        ("siemens", "G71 G90 G17 G94\nG500\n", None),
        ("siemens", "G71 G90 G17 G94\nSUPA G0 Z100\nG55\n", None),
        ("linuxcnc", "G21 G90 G17 G94\n", None),
        ("fanuc", "G21 G90 G17 G94\n", None),
    ] {
        write(&at.join("part.nc"), &format!("{head}G0 X0. Y0. Z100.\nG1 X50. F100\nX20.\nM30\n"));
        let found = abbe(at, &["compensate", "truth.calibration.json", "part.nc", "--dialect", dialect]);
        assert_eq!(found.status, 0, "{dialect} {head}: {}", found.stderr);
        let told = found.stdout.matches("no work offset (G54, .., G500) is named before this move").count();
        assert_eq!(told, usize::from(line.is_some()), "{dialect} {head}: {}", found.stdout);
        let place = line.map_or(String::new(), |line| format!("Line {line}: no work offset"));
        assert!(found.stdout.contains(&place), "{dialect} {head}: {}", found.stdout);
    }
}

/// A machine file with another tool or another travel.
#[test]
fn tools_and_travels_of_a_machine_file_are_compared() {
    let folder = temporary();
    let at = folder.path();
    let own = read(&root().join("pipelines/data/compensation/table-table/machine.yaml"));
    let mut machine: serde_json::Value = serde_yaml::from_str(&own).expect("YAML");
    let mut known = calibration("table-table");
    for axis in ["X", "Y", "Z", "A", "C"] {
        known["model"]["settings"]["axes"][axis] = machine["axes"][axis].clone();
    }
    // The first knot of Z stands at the end of its travel.
    let z = known["model"]["settings"]["axes"]["Z"]["range_mm"].as_array_mut().expect("a range");
    z[0] = json!(-200);
    machine["axes"]["Z"]["range_mm"][0] = json!(-200);
    write(&at.join("truth.calibration.json"), &known.to_string());
    write(&at.join("points.csv"), "X_mm,Y_mm,Z_mm,A_deg,C_deg\n10,20,-60,0,0\n20,20,-60,0,0\n");
    write(&at.join("part.ngc"), "G21 G90 G17 G94 G54\nG0 X0 Y0 Z-60 A0 C0\nG1 X10 F100\nM2\n");
    let length = machine["tool_length_mm"].as_f64().expect("a length");
    let mut shorter = machine.clone();
    shorter["tool_length_mm"] = json!(length - 20.0);
    let mut wider = machine.clone();
    wider["axes"]["X"]["range_mm"][1] = json!(machine["axes"]["X"]["range_mm"][1].as_f64().expect("an end") + 300.0);
    let words = ["mm long, that of machine.yaml is", "X goes from"];
    for (name, file, told) in
        [("own", &machine, [false; 2]), ("tool", &shorter, [true, false]), ("travel", &wider, [false, true])]
    {
        write(&at.join("machine.yaml"), &file.to_string());
        for command in ["compensate", "correct"] {
            let found = abbe(at, &[command, "truth.calibration.json", "points.csv", "--machine", "machine.yaml"]);
            let text = said(&found.stderr);
            assert_eq!(found.status, 0, "{name}: {text}");
            assert_eq!(words.map(|words| text.contains(words)), told, "{command} {name}: {text}");
        }
        // A program has tools of its own.
        let program = ["compensate", "truth.calibration.json", "part.ngc", "--dialect", "linuxcnc"];
        let found = abbe(at, &[&program[..], &["--machine", "machine.yaml", "--tool-length-mm", "90"]].concat());
        let text = said(&found.stderr);
        assert_eq!(found.status, 0, "{name}: {text}");
        assert_eq!(words.map(|words| text.contains(words)), [false, told[1]], "{name}: {text}");
    }
}

/// Temperatures from 20 to 24 °C were measured. Where the coefficient was known beforehand nothing is extrapolated.
#[test]
fn temperatures_that_were_not_measured_are_told() {
    let folder = temporary();
    let at = folder.path();
    for status in ["estimated", "fixed"] {
        let mut known = calibration("three-axis");
        let line = json!({ "expansion": ["EXX"], "temperature": "T_a", "coefficient_per_K": 1e-5 });
        known["model"]["settings"]["errors"].as_array_mut().expect("lines").push(line);
        let own = if status == "estimated" { 1e-7 } else { 0.0 };
        let parameter = json!({ "name": "EXX[expansion]", "value": 1.1e-5, "unit": "1/K", "standard_uncertainty": own, "status": status });
        known["parameters"].as_array_mut().expect("parameters").push(parameter);
        if status == "estimated" {
            let covariance = &mut known["covariance"];
            let rows = covariance["rows"].as_array_mut().expect("rows");
            rows.iter_mut().for_each(|row| row.as_array_mut().expect("a row").push(json!(0)));
            let mut own = vec![json!(0); rows.len()];
            own.push(json!(1e-14));
            rows.push(json!(own));
            covariance["order"].as_array_mut().expect("names").push(json!("EXX[expansion]"));
        }
        known["fit"]["statuses"] = json!({ "T_a": [20, 24] });
        write(&at.join("truth.calibration.json"), &known.to_string());
        for (temperature, is_told) in [(20.5, false), (24.3, false), (27.0, true), (12.0, true), (60.0, true)] {
            let text = format!("X_mm,Y_mm,Z_mm,T_a_degC\n100,20,-60,22\n100,20,-60,{temperature}\n");
            write(&at.join("points.csv"), &text);
            for command in ["compensate", "correct"] {
                let found = abbe(at, &[command, "truth.calibration.json", "points.csv"]);
                let text = said(&found.stderr);
                assert_eq!(found.status, 0, "{command} {temperature}: {text}");
                let is_told = is_told && status == "estimated";
                let words =
                    format!("points.csv:3: `T_a_degC` is {temperature}; the machine was measured from 20 to 24");
                assert_eq!(text.contains(&words), is_told, "{command} {temperature} {status}: {text}");
            }
        }
    }
}
