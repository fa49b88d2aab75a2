//! Temperature compensation of controls: emulators of Siemens and ISG with the PLC that their text asks for, and the component of LinuxCNC
//! compiled as a plain program. Machines are random, and warm up along random logs.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::process::{Command, Stdio};

use abbe_core::{Build, Context, ExportedFile, Kind, StatusRole};
use serde_json::{Value, json};

use super::law::{Machine, exporter, refused, seeds, uniform};
use crate::support::{registry, skipped, temporary, write};

/// A machine that warms up, and the log of its sensors by their headers.
pub struct Warming {
    pub machine: Machine,
    pub log: BTreeMap<String, Vec<f64>>,
}

/// Largest correction of an axis of these machines is some hundredths of a millimetre.
const GAIN: f64 = 4e-3;

/// Three linear axes in any order and side, scales that follow one sensor at once, and a column that lags behind another one.
pub fn warming(seed: u64) -> Warming {
    let mut random = uniform(seed + 77);
    (0..20).for_each(|_| {
        let _ = random();
    });
    let orders = ["w X b Y Z t", "w Z Y b X t", "w b Y X Z t", "w X Y Z b t", "w Y b Z X t"];
    let chain = orders[(random() * 5.0) as usize];
    let step = 20.0 + 60.0 * random();
    let times: Vec<f64> = (0..90).map(|row| f64::from(row) * step).collect();
    let mut reading = |swing: f64| {
        let (phase, period) = (6.3 * random(), 20.0 + 60.0 * random());
        let at = |row: usize| 20.5 + swing * ((row as f64 / period + phase).sin() - phase.sin()) + 0.03 * row as f64;
        (0..times.len()).map(at).collect::<Vec<f64>>()
    };
    let (scale, column) = (reading(2.0), reading(4.0));
    let constants = [150.0 + 300.0 * random(), 1000.0 + 2000.0 * random()];
    let of = |columns: &[(&str, &Vec<f64>)]| {
        let columns = columns.iter().map(|(name, values)| ((*name).to_owned(), json!(values)));
        Value::Object([("time_s".to_owned(), json!(times))].into_iter().chain(columns).collect())
    };
    let errors = json!([
        { "thermal": ["EXX", "EYY", "EZZ"], "at_once": ["T_scale"], "slope": true, "reference_degC": 20,
          "log": of(&[("T_scale_degC", &scale)]) },
        { "thermal": ["EXX", "EYY", "EZZ"], "inputs": ["T_column"], "time_constants_s": constants,
          "reference_until_s": 3.0 * step, "log": of(&[("T_column_degC", &column)]) },
    ]);
    let axes =
        json!({ "X": { "range_mm": [-300, 300] }, "Y": { "range_mm": [0, 400] }, "Z": { "range_mm": [-250, 50] } });
    let settings =
        json!({ "chain": chain, "tool_length_mm": 100, "stylus_radius_mm": 0, "axes": axes, "errors": errors });
    let log = [("time_s", times), ("T_scale_degC", scale), ("T_column_degC", column)];
    let log = log.map(|(name, values)| (name.to_owned(), values)).into_iter().collect();
    Warming { machine: of_settings(&settings, &mut random), log }
}

fn of_settings(settings: &Value, random: &mut dyn FnMut() -> f64) -> Machine {
    let registry = registry();
    let Build::Model(plugin) = &registry.find(Kind::Model, "serial-chain").expect("built in").build else { panic!() };
    let built = plugin.build(settings, &Context { base: ".".into() }).unwrap_or_else(|error| panic!("{error}"));
    let model = built.build(&[]).unwrap_or_else(|error| panic!("{error}"));
    let info = model.info();
    let parameters = info.parameters.iter().zip(&info.nominal).filter_map(|(parameter, nominal)| {
        let value = match parameter.name.as_str() {
            name if name.starts_with("time_constant") => *nominal,
            name if name.contains("[1*T_scale]") => 3e-5 * (random() - 0.5),
            name if name.contains("[T_column:") => GAIN * (random() - 0.5),
            _ => return None,
        };
        let unit = parameter.unit.to_string();
        Some(json!({ "name": parameter.name, "value": value, "unit": unit, "standard_uncertainty": 0, "status": "fixed" }))
    });
    let mut calibration = crate::compensation::calibration("three-axis");
    calibration["parameters"] = json!(parameters.collect::<Vec<_>>());
    calibration["model"]["settings"] = settings.clone();
    Machine::of(&calibration)
}

/// What a control adds at a time to commands of axes, mm, by axis.
type Added<'a> = &'a mut dyn FnMut(f64, &[(String, f64)]) -> BTreeMap<String, f64>;

impl Warming {
    /// Statuses anywhere at random times within the log.
    fn anywhere(&self, count: usize, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let info = self.machine.model.info();
        let time = info.status_index(&StatusRole::Time).expect("a time");
        let last = self.log["time_s"][self.log["time_s"].len() - 1];
        let mut random = uniform(seed);
        let mut times: Vec<f64> = (0..count).map(|_| last * random()).collect();
        times.sort_by(f64::total_cmp);
        let mut statuses = self.machine.anywhere(count, &[], seed);
        for (status, at) in statuses.chunks_mut(info.status.len()).zip(&times) {
            status[time] = *at;
        }
        (statuses, times)
    }

    /// The reading of a sensor at a time: straight between the rows.
    fn reading(&self, header: &str, time: f64) -> f64 {
        let (times, values) = (&self.log["time_s"], &self.log[header]);
        let after = times.iter().position(|row| *row >= time).unwrap_or(times.len() - 1).max(1);
        let part = (time - times[after - 1]) / (times[after] - times[after - 1]);
        values[after - 1] + part * (values[after] - values[after - 1])
    }

    /// Statuses with what a control adds, mm, by axis: of (readings that lag, axis, position).
    fn driven(&self, statuses: &[f64], added: Added<'_>) -> Vec<f64> {
        let info = self.machine.model.info();
        let time = info.status_index(&StatusRole::Time).expect("a time");
        let mut found = statuses.to_vec();
        for status in found.chunks_mut(info.status.len()) {
            let commands: Vec<(String, f64)> =
                info.axes.iter().map(|axis| (axis.name.clone(), status[axis.status])).collect();
            let added = added(status[time], &commands);
            for axis in &info.axes {
                status[axis.status] += added.get(&axis.name).copied().unwrap_or_default();
            }
        }
        found
    }
}

/// The largest distance of tips, mm.
fn apart(one: &[[f64; 3]], other: &[[f64; 3]]) -> f64 {
    let size = |(a, b): (&[f64; 3], &[f64; 3])| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    one.iter().zip(other).map(size).fold(0.0, f64::max)
}

fn text_of(files: &[ExportedFile], name: &str) -> String {
    let file = files.iter().find(|file| file.name == name).unwrap_or_else(|| panic!("no {name}"));
    String::from_utf8(file.content.clone()).expect("text")
}

/// A row of the table for the PLC.
#[derive(Debug, Clone)]
struct Row {
    axis: String,
    input: String,
    constant: Option<f64>,
    reading: f64,
    values: [f64; 2],
}

/// A PLC that follows the rule of the text: lags in steps of `dt`, sums of rows between which values are straight.
struct Plc {
    rows: Vec<Row>,
    /// Lagged readings over the log, by input and time constant, at multiples of `dt`.
    lagged: Vec<(String, Option<f64>, Vec<f64>)>,
    dt: f64,
}

impl Plc {
    fn new(table: &str, warming: &Warming, dt: f64) -> Self {
        let row = |line: &str| {
            let cells: Vec<&str> = line.split(',').collect();
            let number = |cell: &str| cell.parse::<f64>().unwrap_or_else(|_| panic!("{line}"));
            Row {
                axis: cells[0].to_owned(),
                input: cells[1].to_owned(),
                constant: (!cells[2].is_empty()).then(|| number(cells[2])),
                reading: number(cells[3]),
                values: [number(cells[4]), number(cells[5])],
            }
        };
        let rows: Vec<Row> = table.lines().skip(1).map(row).collect();
        let mut lagged: Vec<(String, Option<f64>, Vec<f64>)> = Vec::new();
        let last = *warming.log["time_s"].last().expect("rows");
        // States of these calibrations begin at their reference: the mean of the idle rows.
        let times = &warming.log["time_s"];
        let idle: Vec<f64> = (0..4).map(|row| warming.log["T_column_degC"][row]).collect();
        assert!(times.len() > 4);
        let mean = idle.iter().sum::<f64>() / idle.len() as f64;
        for row in &rows {
            if lagged.iter().any(|(input, constant, _)| *input == row.input && *constant == row.constant) {
                continue;
            }
            let mut now = mean;
            let steps = (last / dt).ceil() as usize + 2;
            let values = (0..steps).map(|step| {
                let reading = warming.reading(&row.input, (step as f64 * dt).min(last));
                match row.constant {
                    None => reading,
                    Some(constant) => {
                        let before = now;
                        let middle = warming.reading(&row.input, ((step as f64 + 0.5) * dt).min(last));
                        now += (middle - now) * (1.0 - (-dt / constant).exp());
                        before
                    }
                }
            });
            lagged.push((row.input.clone(), row.constant, values.collect()));
        }
        Self { rows, lagged, dt }
    }

    /// Both values of an axis at a time.
    fn values(&self, warming: &Warming, axis: &str, time: f64) -> [f64; 2] {
        let mut sum = [0.0; 2];
        for (input, constant, values) in &self.lagged {
            let rows: Vec<&Row> = self
                .rows
                .iter()
                .filter(|row| row.axis == axis && row.input == *input && row.constant == *constant)
                .collect();
            if rows.is_empty() {
                continue;
            }
            let step = (time / self.dt) as usize;
            let part = time / self.dt - step as f64;
            let reading = match constant {
                None => warming.reading(input, time),
                Some(_) => values[step] + part * (values[step + 1] - values[step]),
            };
            let after = rows.iter().position(|row| row.reading > reading).unwrap_or(rows.len() - 1).max(1);
            let (a, b) = (rows[after - 1], rows[after]);
            let part = ((reading - a.reading) / (b.reading - a.reading)).clamp(0.0, 1.0);
            for (sum, (a, b)) in sum.iter_mut().zip(a.values.iter().zip(b.values)) {
                *sum += a + part * (b - a);
            }
        }
        sum
    }
}

/// What is left of a warm machine under a control: before, after, from the prediction, and with all turned round.
fn left(warming: &Warming, name: &str, settings: &Value, seed: u64, sense: f64) -> [f64; 4] {
    let machine = &warming.machine;
    let export = exporter(name, settings);
    let files = export.export(&machine.calibration, machine.model.as_ref()).unwrap_or_else(|error| panic!("{error}"));
    let table = text_of(&files, &format!("{name}.csv"));
    let plc = Plc::new(&table, warming, 0.5);
    let zeroes = |axis: &str| match name {
        "siemens-temperature" => {
            let text = text_of(&files, "siemens-temperature.ini");
            let number = ["X", "Y", "Z"].iter().position(|own| *own == axis).expect("an axis") + 1;
            let key = format!("$SA_TEMP_COMP_REF_POSITION[AX{number}]=");
            assert!(text.contains(&format!("$MA_TEMP_COMP_TYPE[AX{number}]=3")), "{text}");
            text.lines().find_map(|line| line.strip_prefix(&key)?.parse::<f64>().ok()).expect("P0")
        }
        _ => {
            let text = text_of(&files, &format!("{}-temperature.lis", axis.to_lowercase()));
            let key = "lr_param.temp_comp_position_0 ";
            assert!(text.contains("lr_param.temp_comp 1\n"), "{text}");
            text.lines().find_map(|line| line.strip_prefix(key)?.parse::<f64>().ok()).expect("position_0") * 1e-4
        }
    };
    let units = if name == "siemens-temperature" { [1.0, 1.0] } else { [1e-4, 1e-6] };
    let corrected: Vec<String> = plc.rows.iter().map(|row| row.axis.clone()).collect();
    let with = |sign: f64| {
        let mut added = |time: f64, commands: &[(String, f64)]| {
            let of = |(axis, position): &(String, f64)| {
                let [offset, slope] = plc.values(warming, axis, time);
                let value = offset * units[0] + slope * units[1] * (position - zeroes(axis));
                (axis.clone(), sign * sense * value)
            };
            commands.iter().filter(|(axis, _)| corrected.contains(axis)).map(of).collect()
        };
        let (statuses, _) = warming.anywhere(60, seed);
        warming.driven(&statuses, &mut added)
    };
    let (statuses, _) = warming.anywhere(60, seed);
    let goal = machine.tips(&statuses, false);
    let [right, turned] = [1.0, -1.0].map(|sign| machine.tips(&with(sign), true));
    let correction = export.correction(&machine.calibration, machine.model.as_ref()).expect("a prediction");
    let predicted = correction.expect("a correction").commands(&statuses).expect("commands");
    [
        apart(&machine.tips(&statuses, true), &goal),
        apart(&right, &goal),
        apart(&right, &machine.tips(&predicted, true)),
        apart(&turned, &goal),
    ]
}

#[test]
fn temperature_tables_correct_machines_that_warm_up() {
    for (name, sense, finest) in [("siemens-temperature", "subtracted", 2e-6), ("isg-temperature", "added", 4e-4)] {
        let mut largest = [0.0_f64; 4];
        for seed in seeds(15) {
            let warming = warming(seed);
            let numbers = match name {
                "siemens-temperature" => json!({ "machine_axes": { "X": "AX1", "Y": "AX2", "Z": "AX3" } }),
                _ => json!({ "axis_numbers": { "X": 1, "Y": 2, "Z": 3 }, "cycles": 20 }),
            };
            let mut settings = numbers;
            settings["values"] = json!(sense);
            settings["lines"] = json!({ "reference": { "X_mm": 100.0 * (seed % 3) as f64 } });
            settings["points"] = json!(5 + seed % 20);
            let sign = if sense == "added" { 1.0 } else { -1.0 };
            let found = left(&warming, name, &settings, seed, sign);
            let [before, after, from_predicted, turned] = found;
            // Rounding of the file at each of three states and axes; the lag in steps of half a second.
            assert!(after < finest + 1e-6 && from_predicted < 1e-6, "{name} seed {seed}: {found:?}");
            assert!(before > 30.0 * after && turned > 1.5 * before, "{name} seed {seed}: {found:?}");
            largest.iter_mut().zip(found).for_each(|(largest, found)| *largest = largest.max(found));
        }
        let largest = largest.map(|size| format!("{size:.1e}"));
        println!("{name}: before, after, from prediction, turned: {largest:?} mm");
    }
}

#[test]
fn wrong_settings_of_temperature_tables_are_refused() {
    let axes = json!({ "X": "AX1", "Y": "AX2", "Z": "AX3" });
    for (settings, told) in [
        (json!({ "machine_axes": axes }), "values"),
        (json!({ "machine_axes": axes, "values": "added", "points": 1 }), "from 2 to 1000"),
        (json!({ "machine_axes": { "X": "AX 1" }, "values": "added" }), "no machine axis"),
        (json!({ "machine_axes": axes, "values": "added", "velocity_factor": 0 }), "velocity_factor"),
    ] {
        let found = refused("siemens-temperature", &settings);
        assert!(found.contains(told), "{settings}: {found}");
    }
    let warming = warming(1);
    let machine = &warming.machine;
    for (settings, told) in [
        (json!({ "machine_axes": { "X": "AX1" }, "values": "added" }), "the machine axis of"),
        (json!({ "machine_axes": axes, "values": "added", "lines": { "axes": ["Q"] } }), "no linear axis Q"),
        (json!({ "machine_axes": axes, "values": "added", "lines": { "at": { "X_deg": 3 } } }), "`X_mm` was expected"),
        (json!({ "machine_axes": axes, "values": "added", "velocity_factor": 1e-7 }), "the control takes"),
    ] {
        let export = exporter("siemens-temperature", &settings);
        let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("it is refused");
        assert!(error.message.contains(told), "{settings}: {error}");
    }
    // A machine whose errors follow nothing.
    let cold = Machine::public("three-axis");
    for (name, settings) in [
        ("siemens-temperature", json!({ "machine_axes": axes, "values": "added" })),
        ("isg-temperature", json!({ "axis_numbers": { "X": 1 }, "values": "added" })),
        ("linuxcnc-temperature", json!({})),
    ] {
        let error = exporter(name, &settings).export(&cold.calibration, cold.model.as_ref()).expect_err("refused");
        assert!(error.message.contains("follows a temperature"), "{name}: {error}");
    }
}

/// The component of LinuxCNC as a plain program: its pins are variables; it reads a line a cycle and answers with the offsets.
fn program(component: &str) -> String {
    let (head, body) = component.split_once("\n;;\n").expect("a component");
    let mut text =
        "#include <math.h>\n#include <stdio.h>\n#define FUNCTION(x) static void abbe_cycle(double fperiod)\n\
                    #define rtapi_math_included\n"
            .to_owned();
    let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
    for line in head.lines() {
        let words: Vec<&str> = line.trim_end_matches(';').split_whitespace().collect();
        let value = words.iter().position(|word| *word == "=").map_or("0", |place| words[place + 1]);
        let value = value.trim_end_matches(';');
        match words[..] {
            ["pin", way, kind, name, ..] => {
                let kind = if kind == "float" { "double" } else { "int" };
                let _ = writeln!(text, "static {kind} {name} = {value};");
                if way == "in" { &mut inputs } else { &mut outputs }.push((kind, name.to_owned()));
            }
            ["param", _, "float", name, ..] => {
                let _ = writeln!(text, "static double {name} = {value};");
            }
            ["variable", kind, name, ..] => {
                let _ = writeln!(text, "static {kind} {name};");
            }
            _ => {}
        }
    }
    text += &body.replace("#include \"rtapi_math.h\"\n", "");
    text += "int main(void)\n{\n    double period, n;\n    while (scanf(\"%lf\", &period) == 1) {\n";
    for (kind, name) in &inputs {
        let _ = writeln!(text, "        if (scanf(\"%lf\", &n) != 1) return 1;\n        {name} = ({kind})n;");
    }
    text += "        abbe_cycle(period);\n";
    for (_, name) in &outputs {
        let _ = writeln!(text, "        printf(\"{name} %.17g \", (double){name});");
    }
    text + "        printf(\"\\n\");\n    }\n    return 0;\n}\n"
}

/// Names of the input pins, in their order.
fn inputs(component: &str) -> Vec<String> {
    let name = |line: &str| Some(line.strip_prefix("pin in ")?.split_whitespace().nth(1)?.to_owned());
    component.lines().filter_map(name).collect()
}

/// Runs cycles: for each the period and the pins by name; gives the outputs by name.
fn cycles(component: &str, rows: &[(f64, BTreeMap<String, f64>)]) -> Vec<BTreeMap<String, f64>> {
    let folder = temporary();
    write(&folder.path().join("c.c"), &program(component));
    let built = Command::new("cc")
        .args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-O1", "c.c", "-o", "c", "-lm"])
        .current_dir(folder.path())
        .output()
        .expect("it starts");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let mut text = String::new();
    for (period, pins) in rows {
        let _ = write!(text, "{period:.17e}");
        inputs(component).iter().for_each(|name| {
            let _ = write!(text, " {:.17e}", pins[name]);
        });
        text.push('\n');
    }
    let mut child =
        Command::new(folder.path().join("c")).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("it starts");
    let mut pipe = child.stdin.take().expect("a pipe");
    let writer = std::thread::spawn(move || pipe.write_all(text.as_bytes()));
    let output = child.wait_with_output().expect("it ends");
    writer.join().expect("no panic").expect("it reads");
    let answers = String::from_utf8(output.stdout).expect("text");
    let row = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().collect();
        words.chunks(2).map(|pair| (pair[0].to_owned(), pair[1].parse().expect("a number"))).collect()
    };
    answers.lines().map(row).collect()
}

fn no_compiler(test: &str) -> bool {
    let missing = Command::new("cc").arg("--version").output().is_err();
    if missing {
        skipped(test, "there is no C compiler `cc`");
    }
    missing
}

#[test]
fn the_component_of_linuxcnc_corrects_machines_that_warm_up() {
    if no_compiler("linuxcnc_temperature") {
        return;
    }
    let mut largest = [0.0_f64; 3];
    for seed in seeds(8) {
        let warming = warming(seed);
        let machine = &warming.machine;
        let export = exporter("linuxcnc-temperature", &json!({ "largest_rate_um_per_s": 1e6 }));
        let files =
            export.export(&machine.calibration, machine.model.as_ref()).unwrap_or_else(|error| panic!("{error}"));
        let component = text_of(&files, "abbetemp.comp");
        let (statuses, times) = warming.anywhere(40, seed);
        let info = machine.model.info();
        // Cycles of 0.25 s up to each time; the sensors as the control reads them in the middle of a cycle.
        let dt = 0.25;
        let mut rows = Vec::new();
        let mut asked = Vec::new();
        let mut clock = 0.0;
        let mean = warming.log["T_column_degC"][..4].iter().sum::<f64>() / 4.0;
        for (status, until) in statuses.chunks(info.status.len()).zip(&times) {
            let mut pins = BTreeMap::from([("enable".to_owned(), 1.0)]);
            for axis in &info.axes {
                pins.insert(format!("position_{}", axis.name.to_lowercase()), status[axis.status]);
            }
            let mut cycle = |period: f64, at: f64, is_first: bool| {
                let mut pins = pins.clone();
                let column = if is_first { mean } else { warming.reading("T_column_degC", at) };
                pins.insert("reading_t_column".to_owned(), column);
                pins.insert("reading_t_scale".to_owned(), warming.reading("T_scale_degC", at));
                rows.push((period, pins));
            };
            if clock == 0.0 {
                cycle(1e-6, 0.0, true);
            }
            while clock < until - dt {
                cycle(dt, clock + dt / 2.0, false);
                clock += dt;
            }
            cycle(until - clock, f64::midpoint(clock, *until), false);
            clock = *until;
            // What is followed at once is read now.
            cycle(1e-6, clock, false);
            asked.push(rows.len() - 1);
        }
        let answers = cycles(&component, &rows);
        let mut index = 0;
        let mut added = |_: f64, commands: &[(String, f64)]| {
            let answer = &answers[asked[index]];
            index += 1;
            let of = |axis: &String| answer.get(&format!("offset_{}", axis.to_lowercase())).copied();
            commands.iter().filter_map(|(axis, _)| Some((axis.clone(), of(axis)?))).collect()
        };
        let driven = warming.driven(&statuses, &mut added);
        for &row in &asked {
            for axis in ["x", "y", "z"] {
                let answer = &answers[row];
                let (Some(offset), Some(counts)) =
                    (answer.get(&format!("offset_{axis}")), answer.get(&format!("counts_{axis}")))
                else {
                    continue;
                };
                assert!((counts * 1e-4 - offset).abs() <= 0.5001e-4, "{answer:?}");
            }
            assert_eq!(answers[row]["beyond"], 0.0);
        }
        let goal = machine.tips(&statuses, false);
        let correction = export.correction(&machine.calibration, machine.model.as_ref()).expect("a prediction");
        let predicted = correction.expect("a correction").commands(&statuses).expect("commands");
        let found = [
            apart(&machine.tips(&statuses, true), &goal),
            apart(&machine.tips(&driven, true), &goal),
            apart(&machine.tips(&driven, true), &machine.tips(&predicted, true)),
        ];
        assert!(found[1] < 1e-6 && found[2] < 1e-6 && found[0] > 0.002, "seed {seed}: {found:?}");
        largest.iter_mut().zip(found).for_each(|(largest, found)| *largest = largest.max(found));
    }
    let largest = largest.map(|size| format!("{size:.1e}"));
    println!("linuxcnc-temperature: before, after, from prediction: {largest:?} mm");
}

#[test]
fn the_component_of_linuxcnc_never_jumps() {
    if no_compiler("linuxcnc_temperature_rate") {
        return;
    }
    let warming = warming(3);
    let machine = &warming.machine;
    let export = exporter("linuxcnc-temperature", &json!({ "largest_rate_um_per_s": 2 }));
    let files = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
    let component = text_of(&files, "abbetemp.comp");
    let hal = text_of(&files, "abbetemp.hal");
    assert!(hal.contains("axis.x.eoffset-scale 0.0001") && hal.contains("reading-t-scale"), "{hal}");
    let pins = |scale: f64, column: f64, enable: f64| {
        let mut pins: BTreeMap<String, f64> = inputs(&component).into_iter().map(|name| (name, 200.0)).collect();
        pins.extend([("enable".to_owned(), enable), ("reading_t_scale".to_owned(), scale)]);
        pins.insert("reading_t_column".to_owned(), column);
        pins
    };
    let [least, most] = [f64::min as fn(f64, f64) -> f64, f64::max]
        .map(|of| warming.log["T_scale_degC"].iter().copied().chain([20.0]).reduce(of).expect("rows"));
    let mut rows: Vec<(f64, BTreeMap<String, f64>)> = Vec::new();
    // Rest, a jump to the end of the range, beyond it, a sensor that breaks, and off.
    for (scale, enable, count) in
        [(20.0, 1.0, 50), (most, 1.0, 9000), (most + 40.0, 1.0, 50), (f64::NAN, 1.0, 50), (least, 0.0, 9000)]
    {
        rows.extend((0..count).map(|_| (0.001, pins(scale, 21.0, enable))));
    }
    let answers = cycles(&component, &rows);
    let offset = |row: usize| answers[row]["offset_x"];
    let fastest = (1..rows.len()).map(|row| (offset(row) - offset(row - 1)).abs()).fold(0.0, f64::max);
    assert!(fastest <= 2e-3 * 0.001 * (1.0 + 1e-9) && fastest > 1e-6, "{fastest}");
    let rest = offset(9049);
    assert!(rest.abs() > 1e-4, "{rest}");
    assert!((offset(9099) - rest).abs() < 1e-12 && answers[9099]["beyond"] == 1.0, "{:?}", answers[9099]);
    assert!(offset(9149).is_finite() && answers[9149]["beyond"] == 1.0, "{:?}", answers[9149]);
    assert!(offset(rows.len() - 1).abs() < 1e-12, "{}", offset(rows.len() - 1));
}
