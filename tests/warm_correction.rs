//! Set-points and measured points of a machine that is warm now: `abbe compensate` and `abbe correct` with another log than that of the
//! calibration.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use abbe_core::Calibration;
use serde_json::{Value, json};

use crate::controls::law::{Machine, uniform};
use crate::controls::temperature::warming;
use crate::support::{abbe, read, temporary, write};

/// Columns of a log by their headers.
type Log = BTreeMap<&'static str, Vec<f64>>;

/// A log of another day: it begins warm and at rest.
fn another_day(seed: u64) -> Log {
    let mut random = uniform(seed + 5);
    let times: Vec<f64> = (0..80).map(|row| 1000.0 + 45.0 * f64::from(row)).collect();
    let mut reading = |from: f64| {
        let (swing, period) = (0.5 + random(), 30.0 + 30.0 * random());
        (0..80).map(|row| from + swing * (f64::from(row) / period).sin()).collect::<Vec<f64>>()
    };
    BTreeMap::from([("T_scale_degC", reading(21.0)), ("T_column_degC", reading(21.5)), ("time_s", times)])
}

fn csv(columns: &Log) -> String {
    let mut text = columns.keys().copied().collect::<Vec<_>>().join(",") + "\n";
    for row in 0..columns["time_s"].len() {
        let cells: Vec<String> = columns.values().map(|values| format!("{}", values[row])).collect();
        let _ = writeln!(text, "{}", cells.join(","));
    }
    text
}

/// The state of the column at a time, above `reference`: fine steps, from rest at the first reading.
fn lagged(log: &Log, constant: f64, time: f64) -> f64 {
    let (times, values) = (&log["time_s"], &log["T_column_degC"]);
    let at = |time: f64| {
        let after = times.iter().position(|row| *row >= time).unwrap_or(times.len() - 1).max(1);
        let part = (time - times[after - 1]) / (times[after] - times[after - 1]);
        values[after - 1] + part * (values[after] - values[after - 1])
    };
    let steps = 20_000;
    let dt = (time - times[0]) / f64::from(steps);
    let mut now = values[0];
    for step in 0..steps {
        let middle = at(times[0] + (f64::from(step) + 0.5) * dt);
        now += (middle - now) * (1.0 - (-dt / constant).exp());
    }
    now
}

/// The machine as it stands at a time of a log: gains as plain offsets and slopes.
fn frozen(warm: &Machine, reference: f64, log: &Log, time: f64) -> Machine {
    let value = |name: &str| warm.calibration.get(name).map_or(0.0, |known| known.value);
    let settings = &warm.calibration.model.settings;
    let mut errors = Vec::new();
    let mut parameters = Vec::new();
    let after = log["time_s"].iter().position(|row| *row >= time).expect("within the log").max(1);
    let part = (time - log["time_s"][after - 1]) / (log["time_s"][after] - log["time_s"][after - 1]);
    let scale = &log["T_scale_degC"];
    let scale = scale[after - 1] + part * (scale[after] - scale[after - 1]) - 20.0;
    let constants: Vec<f64> = [1, 2].map(|number| value(&format!("time_constant[{number}]_s"))).to_vec();
    let states: Vec<f64> = constants.iter().map(|constant| lagged(log, *constant, time) - reference).collect();
    for symbol in ["EXX", "EYY", "EZZ"] {
        errors.push(json!({ "polynomial": [symbol], "degrees": [0, 1] }));
        let offset: f64 =
            (1..=2).map(|number| value(&format!("{symbol}[T_column:{number}]")) * states[number - 1]).sum();
        let slope = value(&format!("{symbol}[1*T_scale]")) * scale;
        for (degree, value, unit) in [(0, offset, "mm"), (1, slope, "mm/mm")] {
            parameters.push(json!({ "name": format!("{symbol}[{degree}]"), "value": value, "unit": unit,
                "standard_uncertainty": 0, "status": "fixed" }));
        }
    }
    let mut calibration: Value = serde_json::from_str(&warm.calibration.to_json().expect("JSON")).expect("JSON");
    calibration["parameters"] = json!(parameters);
    calibration["model"]["settings"] = settings.clone();
    calibration["model"]["settings"]["errors"] = json!(errors);
    Machine::of(&calibration)
}

#[test]
fn set_points_of_a_machine_that_is_warm_now_are_corrected() {
    for seed in 0..6 {
        let place = temporary();
        let at = |name: &str| place.path().join(name);
        let warming = warming(seed);
        let reference = warming.log["T_column_degC"][..4].iter().sum::<f64>() / 4.0;
        let log = another_day(seed);
        write(&at("machine.calibration.json"), &warming.machine.calibration.to_json().expect("JSON"));
        write(&at("log.csv"), &csv(&log));
        let mut random = uniform(seed);
        let rows: Vec<[f64; 3]> =
            (0..15).map(|_| [-290.0 + 580.0 * random(), 390.0 * random(), -240.0 + 280.0 * random()]).collect();
        let points: String = rows.iter().map(|[x, y, z]| format!("{x:.3},{y:.3},{z:.3}\n")).collect();
        write(&at("points.csv"), &format!("X_mm,Y_mm,Z_mm\n{points}"));
        let time = 1000.0 + 3000.0 * random();
        let run = |more: &[&str]| {
            let arguments = [&["compensate", "machine.calibration.json", "points.csv"][..], more].concat();
            abbe(place.path(), &arguments)
        };
        let told = run(&["--out", "no.csv"]);
        assert!(told.status == 2 && told.stderr.contains("the log is missing"), "{}", told.stderr);
        let told = run(&["--log", "log.csv", "--at", "99999", "--out", "no.csv"]);
        assert!(told.status != 0 && told.stderr.contains("outside the log"), "{}", told.stderr);
        assert!(!at("no.csv").exists());
        let told = run(&["--log", "log.csv", "--at", &format!("{time}"), "--out", "corrected.csv"]);
        assert_eq!(told.status, 0, "{}", told.stderr);
        let machine = frozen(&warming.machine, reference, &log, time);
        let info = machine.model.info();
        let status = |text: &str| -> Vec<f64> {
            let mut lines = text.lines().filter(|line| !line.starts_with('#'));
            let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
            let row = |line: &str| {
                let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
                let mut status = standing(&machine);
                for axis in &info.axes {
                    let column = names.iter().position(|name| **name == format!("{}_mm", axis.name)).expect("an axis");
                    status[axis.status] = cells[column];
                }
                status
            };
            lines.flat_map(row).collect()
        };
        let goals = machine.tips(&status(&read(&at("points.csv"))), false);
        let reached = machine.tips(&status(&read(&at("corrected.csv"))), true);
        let uncorrected = machine.tips(&status(&read(&at("points.csv"))), true);
        let apart = |one: &[[f64; 3]]| {
            let size = |(a, b): (&[f64; 3], &[f64; 3])| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
            one.iter().zip(&goals).map(size).fold(0.0, f64::max).sqrt()
        };
        println!("seed {seed}: {:.1e} mm, before {:.1e} mm", apart(&reached), apart(&uncorrected));
        assert!(apart(&reached) < 3e-7 && apart(&uncorrected) > 1e-3, "{} {}", apart(&reached), apart(&uncorrected));
        // At the reference temperatures nothing is left of what follows temperatures.
        let told = run(&["--at-reference", "--out", "cold.csv"]);
        assert_eq!(told.status, 0, "{}", told.stderr);
        let cold = status(&read(&at("cold.csv")));
        let points = status(&read(&at("points.csv")));
        assert!(cold.iter().zip(&points).all(|(one, other)| one.is_nan() || (one - other).abs() < 1e-9));
        // A measured point is where the machine really is.
        let told = abbe(
            place.path(),
            &[
                "correct",
                "machine.calibration.json",
                "points.csv",
                "--log",
                "log.csv",
                "--at",
                &format!("{time}"),
                "--out",
                "measured.csv",
            ],
        );
        assert_eq!(told.status, 0, "{}", told.stderr);
        let text = read(&at("measured.csv"));
        let mut lines = text.lines();
        let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
        let columns = ["corrected_x_mm", "corrected_y_mm", "corrected_z_mm"]
            .map(|name| names.iter().position(|own| *own == name));
        if let [Some(x), Some(y), Some(z)] = columns {
            for (line, tip) in lines.zip(&uncorrected) {
                let cells: Vec<&str> = line.split(',').collect();
                for (column, expected) in [x, y, z].into_iter().zip(tip) {
                    let found: f64 = cells[column].parse().expect("a number");
                    assert!((found - expected).abs() < 1e-6, "{line}: {expected}");
                }
            }
        } else {
            panic!("{names:?}");
        }
    }
}

/// The status of a machine that stands, all else as for data without a column.
fn standing(machine: &Machine) -> Vec<f64> {
    let info = machine.model.info();
    vec![0.0; info.status.len()]
}

#[test]
fn logs_that_do_not_fit_a_calibration_are_refused() {
    let place = temporary();
    let at = |name: &str| place.path().join(name);
    let warming = warming(2);
    let calibration: &Calibration = &warming.machine.calibration;
    write(&at("machine.calibration.json"), &calibration.to_json().expect("JSON"));
    write(&at("points.csv"), "X_mm,Y_mm,Z_mm\n10,20,30\n");
    let log = another_day(2);
    let with = |change: &dyn Fn(&mut Log)| {
        let mut log = log.clone();
        change(&mut log);
        write(&at("log.csv"), &csv(&log));
        let arguments = [
            "compensate",
            "machine.calibration.json",
            "points.csv",
            "--log",
            "log.csv",
            "--at",
            "end",
            "--out",
            "o.csv",
        ];
        let _ = std::fs::remove_file(at("o.csv"));
        abbe(place.path(), &arguments)
    };
    for (change, told) in [
        (&(|log: &mut Log| drop(log.remove("T_column_degC"))) as &dyn Fn(&mut _), "T_column"),
        (&|log: &mut Log| log.get_mut("time_s").unwrap()[40] = 1000.0, "time"),
        (&|log: &mut Log| log.get_mut("T_scale_degC").unwrap()[4] = f64::NAN, "T_scale"),
        (&|log: &mut Log| log.get_mut("T_scale_degC").unwrap().fill(20.0), "T_scale_degC reads the same all the time"),
    ] {
        let printed = with(change);
        assert!(printed.status != 0 && printed.stderr.contains(told), "{told}: {}", printed.stderr);
        assert!(!at("o.csv").exists());
    }
    let hot = with(&|log| log.get_mut("T_scale_degC").unwrap().iter_mut().for_each(|value| *value += 30.0));
    assert!(hot.status == 0 && hot.stderr.contains("extrapolated"), "{}", hot.stderr);
    assert!(with(&|_| ()).status == 0);
}
