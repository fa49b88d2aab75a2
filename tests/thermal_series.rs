//! Several logs, one for each series of measurements: bodies that follow them, and corrections of controls from a calibration that has
//! them.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;

use abbe_core::{Calibration, Export, StatusRole};
use abbe_engine::prepare;
use abbe_numerics::Generator;
use serde_json::{Value, json};

use crate::controls::law::{Machine, exporter, seeds};
use crate::controls::temperature::warming;
use crate::support::{Variant, abbe, fit, read, recipes, registry, temporary, write};

fn mill() -> Variant {
    Variant::of(&recipes()["mill-warming"]).only(&["fit"])
}

/// The mill with a log for each of some days. All bodies take theirs by the column `day`.
fn by_days(touches: &str, log: &str, folder: &std::path::Path) -> Variant {
    let mut recipe = mill();
    let mut machine: Value = serde_yaml::from_str(&read(&recipe.path("mill", "file"))).expect("YAML");
    for body in machine["bodies"].as_object_mut().expect("bodies").values_mut() {
        body["series"] = json!("day");
    }
    let stage = recipe.stage("mill").as_object_mut().expect("a stage");
    stage.remove("file");
    stage.extend(machine.as_object().expect("a machine").clone());
    for (stage, name, text) in [("touches", "touches.csv", touches), ("sensors", "log.csv", log)] {
        write(&folder.join(name), text);
        recipe.stage(stage)["path"] = json!(folder.join(name));
    }
    recipe
}

/// Header and rows of a table, each row with the number of its day in front and its time on the clock of that day.
fn table(
    text: &str,
    time: &str,
    mut row_of: impl FnMut(&mut Vec<String>, usize) -> Vec<(usize, Vec<String>)>,
) -> String {
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let head = lines.next().expect("a header");
    let column = head.split(',').position(|name| name == time).expect("a time");
    let mut written = format!("day,{head}\n");
    for line in lines {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        for (day, cells) in row_of(&mut cells, column) {
            let _ = writeln!(written, "{day},{}", cells.join(","));
        }
    }
    written
}

/// The same with bodies that count from a temperature, or from the mean of idle minutes.
fn counted(mut recipe: Variant, from_idle: bool) -> Variant {
    for body in recipe.stage("mill")["bodies"].as_object_mut().expect("bodies").values_mut().filter(|_| !from_idle) {
        let body = body.as_object_mut().expect("a body");
        body.remove("reference_until_s");
        body.insert("reference_degC".to_owned(), json!(20.18));
    }
    recipe
}

/// Each touch was made on one of three days, which have clocks of their own, or other temperatures in their idle minutes: nothing of
/// this changes what is estimated.
#[test]
fn bodies_follow_the_log_of_their_day() {
    let recipe = mill();
    let (touches, log) = (read(&recipe.path("touches", "path")), read(&recipe.path("sensors", "path")));
    let one_day = |cells: &mut Vec<String>, _: usize| vec![(1, cells.clone())];
    let expected = [false, true].map(|from_idle| {
        let folder = temporary();
        let days = by_days(&table(&touches, "time_s", one_day), &table(&log, "time_s", one_day), folder.path());
        let found = fit(&counted(days, from_idle).run(), "fit").calibration.clone();
        // With one day it is the recipe itself.
        let whole = fit(&recipe.run(), "fit").calibration.clone();
        let same = |one: &abbe_core::Estimated| whole.get(&one.name).is_some_and(|other| other.value == one.value);
        assert_eq!(found.parameters.iter().all(same), from_idle);
        found
    });
    for seed in seeds(6) {
        let folder = temporary();
        let mut random = Generator::new(77, seed);
        let from_idle = seed % 2 == 1;
        let clock = if from_idle { 0.0 } else { 1e5 };
        let clocks: Vec<f64> = (0..3).map(|_| (clock * random.uniform()).round()).collect();
        let offset = if from_idle { 2.0 } else { 0.0 };
        let offsets: Vec<f64> = (0..3).map(|_| offset * random.uniform()).collect();
        let expected = &expected[usize::from(from_idle)];
        let on_clock = |cells: &[String], column: usize, day: usize| {
            let mut cells = cells.to_vec();
            cells[column] = format!("{}", cells[column].parse::<f64>().expect("a time") + clocks[day]);
            cells
        };
        let touches = table(&touches, "time_s", |cells, column| {
            let day = random.index(3);
            vec![(day + 1, on_clock(cells, column, day))]
        });
        // Rows of all days one after another, each day in its order.
        let mut rows: Vec<Vec<String>> = vec![Vec::new(); 3];
        let whole = table(&log, "time_s", |cells, column| {
            for day in 0..3 {
                let mut cells = on_clock(cells, column, day);
                let last = cells.len() - 1;
                for (place, cell) in cells.iter_mut().enumerate() {
                    if place != column && place != last {
                        *cell = format!("{:.9}", cell.parse::<f64>().expect("a temperature") + offsets[day]);
                    }
                }
                rows[day].push(format!("{},{}", day + 1, cells.join(",")));
            }
            Vec::new()
        });
        let log = whole + &rows.concat().join("\n") + "\n";
        let outcome = counted(by_days(&touches, &log, folder.path()), from_idle).run();
        let found = &fit(&outcome, "fit").calibration;
        for parameter in &expected.parameters {
            let other = found.get(&parameter.name).expect("the same parameters");
            // Touches in another order add up in another order.
            let off = (other.value - parameter.value).abs();
            assert!(off <= 1e-6 * parameter.standard_uncertainty, "seed {seed}: {} is off by {off:e}", parameter.name);
        }
        // What is kept is the same machine again.
        let text = found.to_json().expect("JSON");
        let logs = &found.model.settings["bodies"]["ram"]["logs"];
        assert_eq!(logs.as_object().map(|logs| logs.len()), Some(3), "{logs}");
        assert_eq!(&Calibration::from_json(&text).expect("a calibration"), found);
    }
}

#[test]
fn logs_of_bodies_by_series_are_checked() {
    let recipe = mill();
    let (touches, log) = (read(&recipe.path("touches", "path")), read(&recipe.path("sensors", "path")));
    let folder = temporary();
    let touches = table(&touches, "time_s", |cells, _| vec![(1, cells.clone())]);
    let log = table(&log, "time_s", |cells, _| vec![(1, cells.clone())]);
    let refused = |touches: &str, log: &str, change: &dyn Fn(&mut Variant)| {
        let mut recipe = by_days(touches, log, folder.path());
        change(&mut recipe);
        let prepared = prepare(&recipe.write(folder.path()), &registry());
        let error = prepared.and_then(|prepared| prepared.check().map(drop)).expect_err("it is refused");
        format!("{error} {}", error.help.clone().unwrap_or_default())
    };
    let same = |_: &mut Variant| {};
    let other = touches.replacen("\n1,", "\n2,", 1);
    let said = refused(&other, &log, &same);
    assert!(said.contains("no log has rows with day 2, and the rows"), "{said}");
    let said = refused(&touches.replacen("day,", "run,", 1), &log, &same);
    assert!(said.contains("have no column of labels `day`, by which their log is found"), "{said}");
    let said = refused(&touches, &log.replacen("day,", "run,", 1), &same);
    assert!(said.contains("the log has no column of labels `day`"), "{said}");
    let rows: Vec<&str> = log.lines().collect();
    let kept = |(row, line): (usize, &&str)| (!(90..100).contains(&row)).then(|| format!("{line}\n"));
    let gap: String = rows.iter().enumerate().filter_map(kept).collect();
    let said = refused(&touches, &gap, &same);
    assert!(said.contains("day 1: the log has a gap of 660 s"), "{said}");
    let number = |recipe: &mut Variant| recipe.stage("mill")["bodies"]["ram"]["series"] = json!("day_s");
    let said = refused(&touches, &log, &number);
    assert!(said.contains("`day_s` is a column of numbers; labels were expected"), "{said}");
}

/// A calibration of a random machine whose log was cut into days: both ends of the first one are in the log of the second, too.
fn in_days(machine: &Machine, reference: bool) -> Machine {
    let mut calibration: Value =
        serde_json::from_str(&machine.calibration.to_json().expect("JSON")).expect("a calibration");
    for line in calibration["model"]["settings"]["errors"].as_array_mut().expect("lines") {
        let line = line.as_object_mut().expect("a line");
        let log = line.remove("log").expect("a log");
        let part = |rows: std::ops::Range<usize>| -> Value {
            let of = |(header, values): (&String, &Value)| {
                (header.clone(), json!(values.as_array().expect("readings")[rows.clone()]))
            };
            Value::Object(log.as_object().expect("columns").iter().map(of).collect())
        };
        line.insert("logs".to_owned(), json!({ "monday": part(0..60), "tuesday": part(30..90) }));
        line.insert("series".to_owned(), json!("day"));
        line.remove("reference_until_s");
        line.remove("reference_degC");
        if reference {
            line.insert("reference_degC".to_owned(), json!(20));
        }
    }
    Machine::of(&calibration)
}

fn exporters() -> [(Box<dyn Export>, &'static str); 3] {
    let siemens = json!({ "machine_axes": { "X": "AX1", "Y": "AX2", "Z": "AX3" }, "values": "added" });
    let isg = json!({ "axis_numbers": { "X": 1, "Y": 2, "Z": 3 }, "values": "added" });
    [
        (exporter("siemens-temperature", &siemens), "siemens-temperature.csv"),
        (exporter("isg-temperature", &isg), "isg-temperature.csv"),
        (exporter("linuxcnc-temperature", &json!({})), "abbetemp.comp"),
    ]
}

/// Gains are those of the machine, whatever logs it was calibrated with: tables are those of a single log, and corrections hit their
/// goals on the clock of each day.
#[test]
fn controls_take_calibrations_with_a_log_for_each_day() {
    let mut largest = [0.0_f64; 3];
    for seed in seeds(12) {
        let single = warming(seed).machine;
        let days = in_days(&single, true);
        for (index, (export, file)) in exporters().into_iter().enumerate() {
            let text = |machine: &Machine| {
                let files = export.export(&machine.calibration, machine.model.as_ref());
                let files = files.unwrap_or_else(|error| panic!("{error}"));
                let file = files.iter().find(|one| one.name == file).expect("a table");
                String::from_utf8(file.content.clone()).expect("text")
            };
            let rows = |text: &str| text.lines().filter(|line| line.starts_with("pin") || line.contains(",T_")).count();
            assert!(rows(&text(&days)) > 3 && rows(&text(&days)) == rows(&text(&single)), "{}", text(&days));
            // On the clock of each day, anywhere.
            let info = days.model.info();
            let time = info.status_index(&StatusRole::Time).expect("a time");
            let day = info.status.iter().position(|status| status.role == StatusRole::Series).expect("a day");
            let mut random = Generator::new(5, seed);
            let mut statuses = days.anywhere(40, &[], seed);
            let log = &days.calibration.model.settings["errors"][0]["logs"];
            for status in statuses.chunks_mut(info.status.len()) {
                let label = random.index(2);
                let times = log[&info.status[day].levels[label]]["time_s"].as_array().expect("times");
                let [from, to] = [0, times.len() - 1].map(|row| times[row].as_f64().expect("a time"));
                status[time] = from + (to - from) * (random.index(10_000) as f64 / 1e4);
                status[day] = label as f64;
            }
            let correction = export.correction(&days.calibration, days.model.as_ref()).expect("a prediction");
            let driven = correction.expect("a correction").commands(&statuses).expect("commands");
            let goal = days.tips(&statuses, false);
            let apart = |tips: &[[f64; 3]]| {
                let size = |(a, b): (&[f64; 3], &[f64; 3])| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
                tips.iter().zip(&goal).map(size).fold(0.0, f64::max).sqrt()
            };
            let (before, after) = (apart(&days.tips(&statuses, true)), apart(&days.tips(&driven, true)));
            let finest = if index == 1 { 4e-4 } else { 4e-6 };
            assert!(after < finest && before > 20.0 * after, "{file} seed {seed}: {before:e} {after:e}");
            largest[index] = largest[index].max(after);
        }
    }
    println!("after correction: {:?} mm", largest.map(|size| format!("{size:.1e}")));
}

#[test]
fn days_with_references_of_their_own_are_refused_by_controls() {
    let days = in_days(&warming(2).machine, false);
    for (export, _) in exporters() {
        let error = export.export(&days.calibration, days.model.as_ref()).expect_err("it is refused");
        assert!(error.message.contains("each day of the calibration counts from a reference of its own"), "{error}");
        assert!(error.help.clone().unwrap_or_default().contains("`reference_degC`"), "{error}");
    }
}

/// Today's log takes the place of those of all days, and readings beyond all of theirs are told.
#[test]
fn bodies_of_several_days_are_corrected_with_the_log_of_today() {
    let recipe = mill();
    let folder = temporary();
    let (touches, log) = (read(&recipe.path("touches", "path")), read(&recipe.path("sensors", "path")));
    let one_day = |cells: &mut Vec<String>, _: usize| vec![(1, cells.clone())];
    let mut days = by_days(&table(&touches, "time_s", one_day), &table(&log, "time_s", one_day), folder.path());
    for body in days.stage("mill")["bodies"].as_object_mut().expect("bodies").values_mut() {
        let body = body.as_object_mut().expect("a body");
        body.remove("reference_until_s");
        body.insert("reference_degC".to_owned(), json!(20.18));
    }
    let calibration = fit(&days.run(), "fit").calibration.to_json().expect("JSON");
    write(&folder.path().join("fit.calibration.json"), &calibration);
    write(&folder.path().join("points.csv"), "X_mm,Y_mm,Z_mm,B_deg,C_deg\n300,200,300,0,0\n");
    let corrected = |log: &str, at: &str, out: &str| {
        write(&folder.path().join("today.csv"), log);
        let arguments =
            ["compensate", "fit.calibration.json", "points.csv", "--log", "today.csv", "--at", at, "--out", out];
        abbe(folder.path(), &arguments)
    };
    let same = corrected(&log, "9000", "same.csv");
    assert_eq!(same.status, 0, "{}", same.stderr);
    assert!(!same.stderr.contains("gains were found") && !same.stderr.contains("minutes"), "{}", same.stderr);
    // A machine that warms twice as fast is a machine; one that does so sixty times as fast is a clock in minutes.
    for (factor, told) in [(2.0, false), (60.0, true)] {
        let faster = table(&log, "time_s", |cells, column| {
            cells[column] = format!("{:.4}", cells[column].parse::<f64>().expect("a time") / factor);
            vec![(1, cells.clone())]
        });
        let faster = corrected(&faster, &(9000.0 / factor).to_string(), &format!("{factor}.csv"));
        assert_eq!((faster.status, faster.stderr.contains("is `time_s` in minutes?")), (0, told), "{}", faster.stderr);
    }
    let hot = table(&log, "time_s", |cells, column| {
        let last = cells.len() - 1;
        for (place, cell) in cells.iter_mut().enumerate() {
            if place != column && place != last {
                *cell = format!("{:.3}", cell.parse::<f64>().expect("a temperature") + 12.0);
            }
        }
        vec![(1, cells.clone())]
    });
    let hot = corrected(&hot, "9000", "hot.csv");
    assert!(hot.stderr.contains("gains were found from") && !hot.stderr.contains("minutes"), "{}", hot.stderr);
    let rows = |name: &str| fs::read_to_string(folder.path().join(name)).expect("a file");
    assert_ne!(rows("same.csv"), rows("hot.csv"));
    let _: BTreeMap<String, Value> = serde_json::from_str(&calibration).expect("JSON");
}

/// The recipe of an axis on four days, measured again and again: predictions choose its sensor and its time constant, and six lengths
/// of another day make no value worse.
#[test]
fn days_choose_the_sensor_and_a_friday_brings_it_up_to_date() {
    let outcome = Variant::of(&recipes()["warming-days"]).run();
    let [month, today] = ["month", "today"].map(|name| fit(&outcome, name));
    let truth = crate::support::json_file(&crate::support::root().join("tests/truth/warming-days.json"));
    let values: BTreeMap<String, f64> = (truth["parameters"].as_object().expect("parameters").iter())
        .map(|(name, value)| (name.clone(), value.as_f64().expect("a number")))
        .collect();
    let off = |calibration: &Calibration, name: &str| {
        let found = calibration.get(name).expect("a parameter");
        (found.value - values[name]) / found.standard_uncertainty
    };
    for (name, value) in &values {
        for fit in [month, today] {
            assert!(off(&fit.calibration, name).abs() < 4.0, "{}: {name} is not {value}", fit.name);
        }
        let u = |fit: &abbe_core::Fit| fit.calibration.get(name).expect("a parameter").standard_uncertainty;
        assert!(u(today) <= u(month) * (1.0 + 1e-9), "{name} is worse");
    }
    let (mut right, mut count, mut squares) = (0, 0, 0.0);
    for seed in seeds(8) {
        let noise = abbe_simulation::Noise {
            probing_sigma_mm: abbe_simulation::StandardDeviation::ByStage([("laser".to_owned(), 4e-4)].into()),
            ..abbe_simulation::Noise::default()
        };
        let truth = abbe_simulation::Truth { parameters: values.clone(), noise };
        let problem = abbe_simulation::measure(&month.problem, &truth, seed).unwrap_or_else(|error| panic!("{error}"));
        // Not all candidates settle for every seed; fewer do.
        let found = month.estimator.estimate(&problem).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        let selection = found.fit.selection_by_prediction.as_ref().expect("a selection");
        count += 1;
        if selection.kept == ["EXX[1*T_nut:1]"] {
            right += 1;
            squares += values.keys().map(|name| off(&found, name).powi(2)).sum::<f64>() / values.len() as f64;
        }
    }
    println!("{right} of {count} choices are right, mean square error {:.2}", squares / f64::from(right));
    assert!(f64::from(right) > 0.7 * f64::from(count), "{right} of {count}");
    assert!(squares / f64::from(right) < 1.8, "{}", squares / f64::from(right));
}
