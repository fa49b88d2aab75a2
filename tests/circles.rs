//! What makes the circles of a ball bar: the diagnosis against expected values, against the truth, and on random machines that a
//! model of its own measures.

use std::fmt::Write as _;
use std::sync::OnceLock;

use abbe_core::{Calibration, Problem, Status};
use abbe_engine::Outcome;
use nalgebra::{Matrix4, Vector3, Vector4};
use serde_json::{Value, json};

use crate::support::{Random, Variant, fit, json_file, read, recipes, registry, root, temporary, values, write};

fn kept(name: &str) -> Value {
    json_file(&root().join(format!("tests/truth/standards-{name}.json")))
}

fn exact() -> &'static Outcome {
    static OUTCOME: OnceLock<Outcome> = OnceLock::new();
    OUTCOME.get_or_init(|| Variant::of(&recipes()["standards-ball-bar-exact"]).run())
}

fn value(calibration: &Calibration, name: &str) -> f64 {
    calibration.get(name).unwrap_or_else(|| panic!("no {name}")).value
}

/// The unknowns of a usual diagnosis, their names here, and the sign between both.
const USUAL: [(&str, &str, f64); 14] = [
    ("centre_x", "linear-bar.ball[1].x", -1.0),
    ("centre_y", "linear-bar.ball[1].y", -1.0),
    ("scale_x", "EXX[1]", 1.0),
    ("scale_y", "EYY[1]", 1.0),
    ("squareness", "EC0X", 1.0),
    ("backlash_x", "EXX[b]", 1.0),
    ("backlash_y", "EYY[b]", 1.0),
    ("lateral_y_when_x_moves", "EYX[b]", 1.0),
    ("lateral_x_when_y_moves", "EXY[b]", 1.0),
    ("servo_mismatch_s", "EXX[lag]", 1.0),
    ("cyclic_x_cos", "EXX[cyc10:cos1]", 1.0),
    ("cyclic_x_sin", "EXX[cyc10:sin1]", 1.0),
    ("cyclic_y_cos", "EYY[cyc12:cos1]", 1.0),
    ("cyclic_y_sin", "EYY[cyc12:sin1]", 1.0),
];

fn is_usual(calibration: &Calibration, data: &str) {
    let expected = &kept(&format!("{data}-expected"))["circular"]["diagnostics"];
    for (key, name, sign) in USUAL {
        let (found, expected) = (sign * value(calibration, name), expected["values"][key].as_f64().expect("a number"));
        assert!((found - expected).abs() <= 2e-8 * expected.abs(), "{data}: {name}: {found} instead of {expected}");
    }
    let report = &calibration.fit;
    let is = |key: &str, found: usize| assert_eq!(json!(found), expected[key], "{data}: {key}");
    is("observations", report.observations);
    is("unknowns", report.unknowns);
    is("rank", report.rank);
    let number = |key: &str| expected[key].as_f64().expect("a number");
    let condition = number("condition");
    assert!((report.condition - condition).abs() < 1e-3 * condition, "{} {condition}", report.condition);
    let mismatch = value(calibration, "EXX[1]") - value(calibration, "EYY[1]");
    assert!((mismatch - number("scale_mismatch")).abs() <= 2e-8 * mismatch.abs(), "{data}: {mismatch}");
    // Readings of the exact data are rounded to 0.1 nm, which their residuals are not far above.
    let rms = report.residual_rms_um;
    assert!((rms - number("rms_um")).abs() <= 1e-6 * number("rms_um"), "{data}: {rms}");
}

/// The usual diagnosis takes positions from the angle; recorded ones are rounded to 1e-9 mm, and to 0.1 um in the realistic data.
fn unrounded(data: &str, feed: &str) -> String {
    let text = read(&root().join(format!("pipelines/data/standards/{data}/ballbar-xy-{feed}.csv")));
    let mut all = String::new();
    for line in text.lines() {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if let Some(Ok(angle)) = cells.get(6).map(|cell| cell.parse::<f64>()) {
            let (sin, cos) = angle.to_radians().sin_cos();
            (cells[3], cells[4]) = ((150.0 * cos).to_string(), (150.0 * sin).to_string());
        }
        let _ = writeln!(all, "{}", cells.join(","));
    }
    all
}

#[test]
fn to_first_order_it_is_the_usual_diagnosis() {
    for data in ["exact", "realistic"] {
        let folder = temporary();
        let paths = ["f500", "f2000"].map(|feed| {
            let file = folder.path().join(format!("ballbar-xy-{feed}.csv"));
            write(&file, &unrounded(data, feed));
            json!(file)
        });
        let variant = Variant::of(&recipes()["standards-ball-bar-exact"]).only(&["linear"]);
        let variant =
            variant.set("circles", "path", json!(paths)).set("circles", "within", json!({ "angle_deg": [0, 360] }));
        is_usual(&fit(&variant.run(), "linear").calibration, data);
    }
}

/// The true values by the names of the model, of the machine and of the ball.
fn truth(data: &str) -> Value {
    let (file, mut all) = (kept(&format!("{data}-truth")), json!({}));
    all.clone_from(&file["parameters"]);
    let circular = &file["circular"];
    // The set has half of the mismatch on either axis.
    let mismatch = circular["servo_mismatch_s"].as_f64().expect("a number");
    all["EXX[lag]"] = json!(mismatch / 2.0);
    all["EYY[lag]"] = json!(-mismatch / 2.0);
    for (key, name) in [("cyclic_x", "EXX[cyc10:"), ("cyclic_y", "EYY[cyc12:")] {
        for wave in ["cos", "sin"] {
            all[format!("{name}{wave}1]")] = circular[format!("{key}_{wave}")].clone();
        }
    }
    for (axis, own) in ["x", "y"].iter().enumerate() {
        all[format!("bar.ball[1].{own}")] = circular["centre_mm"][axis].clone();
    }
    all
}

/// The whole kinematics with the other errors of the machine at their true values give the truth back.
#[test]
fn with_the_whole_kinematics_it_is_the_truth() {
    let truth = truth("exact");
    let mut variant = Variant::of(&recipes()["standards-ball-bar-exact"]).only(&["fit"]);
    // Z came from below.
    variant = variant.set("circles", "constants", json!({ "A_deg": 0, "C_deg": 0, "dir_Z": 1 }));
    let lines = variant.stage("mill")["errors"].as_array_mut().expect("errors");
    lines.push(json!({ "location": ["E?0A", "E?0C", "EA0Z", "EB0Z"] }));
    lines.push(json!({ "polynomial": ["EZZ"], "degrees": [1] }));
    lines.push(json!({ "backlash": ["EZZ"] }));
    let outcome = variant.run();
    let fitted = fit(&outcome, "fit");
    let mut problem: Problem = fitted.problem.as_ref().clone();
    for (parameter, own) in problem.model.info().parameters.iter().zip(&mut problem.machine_values) {
        *own = truth.get(&parameter.name).and_then(Value::as_f64).unwrap_or(0.0);
    }
    let calibration = fitted.estimator.estimate(&problem).unwrap_or_else(|error| panic!("{error}"));
    let estimated = values(&calibration).filter(|own| own.status == Status::Estimated);
    let mut count = 0;
    for own in estimated {
        let expected = truth[&own.name].as_f64().unwrap_or_else(|| panic!("no {}", own.name));
        // The set has lag and cyclic errors along the table, ours are those of the axes, which stand 4e-5 rad askew to it: the part
        // across, 3e-4 s x 33 mm/s x 4e-5, looks like lateral play.
        let allowed = match own.name.as_str() {
            "EYX[b]" | "EXY[b]" => 5e-7,
            name if name.contains("cyc") => 3e-9,
            _ => 1e-9,
        };
        let off = (own.value - expected).abs();
        assert!(off < allowed, "{} is off by {off:e}", own.name);
        count += 1;
    }
    assert_eq!(count, 14);
}

#[test]
fn noisy_circles_hold_the_truth_within_their_uncertainty() {
    let outcome = Variant::of(&recipes()["standards-ball-bar"]).run();
    let (calibration, truth) = (&fit(&outcome, "fit").calibration, truth("realistic"));
    let mut errors = Vec::new();
    for own in values(calibration).filter(|own| own.status == Status::Estimated) {
        let name = own.name.as_str();
        let expected = match name {
            // The lag of Y is the reference; other errors of the machine shift the centre.
            "EXX[lag]" => truth["EXX[lag]"].as_f64().expect("it") - truth["EYY[lag]"].as_f64().expect("it"),
            name if name.contains("ball") => continue,
            _ => truth[name].as_f64().unwrap_or_else(|| panic!("no {name}")),
        };
        let error = (own.value - expected) / own.standard_uncertainty;
        assert!(error.abs() < 3.3, "{name}: {} instead of {expected}, {error} standard uncertainties", own.value);
        errors.push(error);
    }
    assert_eq!(errors.len(), 12);
    let considered: Vec<&str> = calibration.inputs.iter().flatten().map(|input| input.name.as_str()).collect();
    assert_eq!(considered, ["bar.bar[150].length"]);
    // An error of the bar goes into both scales alike.
    let scale = calibration.get("EXX[1]").expect("it").standard_uncertainty;
    assert!((scale - 0.7e-3 / 150.0).abs() < 2e-7, "{scale}");
}

/// What the circles cannot tell is named.
#[test]
fn lags_and_scales_are_one_rank_short() {
    let recipe = || Variant::of(&recipes()["standards-ball-bar-exact"]).only(&["fit"]);
    let told = |variant: Variant| {
        let folder = temporary();
        let prepared = abbe_engine::prepare(&variant.write(folder.path()), &registry());
        let run = prepared.and_then(|prepared| prepared.run(&abbe_core::Monitor::default()));
        run.err().expect("it is one rank short").to_string()
    };
    let mut both = recipe();
    both.stage("fit")["parameters"].as_array_mut().expect("patterns").push(json!("EYY[lag]"));
    let message = told(both);
    assert!(message.contains("the data determine 14 of 15 unknowns"), "{message}");
    assert!(message.contains("EXX[lag] and EYY[lag] cannot be told apart"), "{message}");
    let mut length = recipe().set("bar", "lengths", json!("estimated"));
    length.stage("fit")["parameters"].as_array_mut().expect("patterns").push(json!("bar.bar[150].length"));
    let message = told(length);
    for data in ["exact-expected", "realistic-expected"] {
        let expected = &kept(data)["circular"]["diagnostics"];
        let [rank, unknowns] = ["rank_with_radius", "unknowns_with_radius"].map(|key| expected[key].to_string());
        assert!(message.contains(&format!("the data determine {rank} of {unknowns} unknowns")), "{message}");
    }
    assert!(
        message.contains("all of these do: bar.bar[150].length +1 µm, EXX[1] +6.667 µm/m, EYY[1] +6.667 µm/m"),
        "{message}"
    );
}

/// The errors of an axis that moves, in the directions of its frame, and its place.
type Moved = (Vector3<f64>, Vector3<f64>);

fn shift(by: Vector3<f64>) -> Matrix4<f64> {
    Matrix4::new_translation(&by)
}

fn turn_about_z(angle: f64) -> Matrix4<f64> {
    let (sin, cos) = angle.sin_cos();
    Matrix4::new(cos, -sin, 0.0, 0.0, sin, cos, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
}

/// A machine with X and Y, by the definitions alone: which of them carry the workpiece, and its errors.
struct Machine {
    chain: &'static str,
    /// Whether X and Y carry the workpiece.
    carries: [bool; 2],
    /// The squareness, of the axis that is carried.
    squareness: (&'static str, f64),
    errors: Vec<(&'static str, f64)>,
    ball: [f64; 2],
}

impl Machine {
    fn new(kind: usize, random: &mut Random) -> Self {
        let (chain, carries, square) = [
            ("w b Y X Z t", [false, false], "EC0X"),
            ("w X' b Y Z t", [true, false], "EC0X"),
            ("w X' Y' b Z t", [true, true], "EC0X"),
            ("w Y' b X Z t", [false, true], "EC0Y"),
        ][kind];
        let sizes = [
            ("EXX[1]", 3e-5),
            ("EYY[1]", 3e-5),
            ("EXX[b]", 4e-3),
            ("EYY[b]", 4e-3),
            ("EYX[b]", 2e-3),
            ("EXY[b]", 2e-3),
            ("EXX[lag]", 1e-3),
            ("EXX[cyc10:cos1]", 1e-3),
            ("EXX[cyc10:sin1]", 1e-3),
            ("EYY[cyc12:cos1]", 1e-3),
            ("EYY[cyc12:sin1]", 1e-3),
        ];
        let errors = sizes.map(|(name, size)| (name, random.within(-size, size))).to_vec();
        let ball = [random.within(-0.05, 0.05), random.within(-0.05, 0.05)];
        Self { chain, carries, squareness: (square, random.within(-4e-5, 4e-5)), errors, ball }
    }

    fn of(&self, name: &str) -> f64 {
        self.errors.iter().find(|(own, _)| *own == name).map_or(0.0, |(_, value)| *value)
    }

    /// Where an axis is, and its errors there; an axis below the workpiece moves against its command, and so does its lag.
    fn moved(&self, axis: usize, command: f64, velocity: f64) -> Moved {
        let (own, across, pitch) = [("XX", "YX", 10.0), ("YY", "XY", 12.0)][axis];
        let sense = if self.carries[axis] { -1.0 } else { 1.0 };
        let wave = std::f64::consts::TAU * command / pitch;
        let along = self.of(&format!("E{own}[1]")) * command + self.of(&format!("E{own}[b]")) * velocity.signum()
            - self.of(&format!("E{own}[lag]")) * sense * velocity
            + self.of(&format!("E{own}[cyc{pitch}:cos1]")) * wave.cos()
            + self.of(&format!("E{own}[cyc{pitch}:sin1]")) * wave.sin();
        let lateral = self.of(&format!("E{across}[b]")) * velocity.signum();
        let unit = |axis: usize, size: f64| {
            if axis == 0 { Vector3::new(size, 0.0, 0.0) } else { Vector3::new(0.0, size, 0.0) }
        };
        (unit(axis, sense * command), unit(axis, along) + unit(1 - axis, lateral))
    }

    /// The reading at a place of the circle.
    fn reading(&self, radius: f64, place: [f64; 2], velocity: [f64; 2]) -> f64 {
        let body = |axis: usize| {
            let (at, error) = self.moved(axis, place[axis], velocity[axis]);
            let name = if axis == 0 { "EC0X" } else { "EC0Y" };
            let askew = if self.squareness.0 == name { self.squareness.1 } else { 0.0 };
            turn_about_z(askew) * shift(at) * shift(error)
        };
        let [x, y] = [body(0), body(1)];
        let one = Matrix4::identity();
        // From the bed outwards: of the tool, and of the workpiece.
        let (tool, table) = match self.chain {
            "w b Y X Z t" => (y * x, one),
            "w X' b Y Z t" => (y, x),
            "w X' Y' b Z t" => (one, y * x),
            _ => (x, y),
        };
        let tip = table.try_inverse().expect("a rigid motion") * tool * Vector4::new(0.0, 0.0, 0.0, 1.0);
        Vector3::new(tip.x - self.ball[0], tip.y - self.ball[1], tip.z).norm() - radius
    }

    /// Two circles both ways, with this noise in mm.
    fn rows(&self, radius: f64, sigma: f64, random: &mut Random) -> String {
        let mut text = String::from("run,X_mm,Y_mm,Z_mm,time_s,reading_mm\n");
        for (run, feed) in [8.0, -8.0, 40.0, -40.0].into_iter().enumerate() {
            for step in 0..240 {
                // Not at a reversal, and not where the steps of both ways agree.
                let angle = (0.37 + f64::from(step) * 1.5_f64).to_radians() * f64::signum(feed);
                let (sin, cos) = angle.sin_cos();
                let reading = self.reading(radius, [radius * cos, radius * sin], [-feed * sin, feed * cos]);
                let time = (f64::from(step) * 1.5_f64).to_radians() * radius / f64::abs(feed);
                let (x, y, noisy) = (radius * cos, radius * sin, reading + sigma * random.normal());
                let _ = writeln!(text, "{run},{x:.13},{y:.13},0,{time:.13},{noisy:.16}");
            }
        }
        text
    }

    /// What the fit finds: name, value, standard uncertainty and truth.
    fn found(&self, radius: f64, sigma: f64, random: &mut Random) -> Vec<(String, f64, f64, f64)> {
        let folder = temporary();
        write(&folder.path().join("circles.csv"), &self.rows(radius, sigma, random));
        write(&folder.path().join("balls.csv"), "feature,x_mm,y_mm,z_mm\n1,0,0,0\n");
        let recipe = Variant(json!({ "abbe": 1, "name": "circles", "stages": {
            "circles": { "ingest": "csv", "path": folder.path().join("circles.csv"), "motion": { "axes": ["X", "Y"] } },
            "bar": { "artefact": "ball-bar", "from": "circles", "nominal": folder.path().join("balls.csv"),
                "bars_mm": { "1": radius }, "standard_uncertainty_um": if sigma > 0.0 { sigma * 1e3 } else { 1e-6 } },
            "machine": { "model": "serial-chain", "chain": self.chain, "tool_length_mm": 0, "stylus_radius_mm": 0, "errors": [
                { "location": [self.squareness.0] }, { "polynomial": ["EXX", "EYY"], "degrees": [1] },
                { "backlash": ["EXX", "EYY", "EYX", "EXY"] }, { "lag": ["EXX"] },
                { "cyclic": ["EXX"], "pitch_mm": 10 }, { "cyclic": ["EYY"], "pitch_mm": 12 }] },
            "fit": { "estimate": "gauss-newton", "machine": "machine", "observations": ["bar"],
                "parameters": ["E*", "bar.ball[1].x", "bar.ball[1].y"] },
        }}));
        let outcome = recipe.run();
        let failures: Vec<String> = outcome.failures.iter().map(|failure| failure.error.to_string()).collect();
        assert!(failures.is_empty(), "{}: {failures:?}", self.chain);
        let calibration = &fit(&outcome, "fit").calibration;
        let all = values(calibration).filter(|own| own.status == Status::Estimated).map(|own| {
            let truth = match own.name.as_str() {
                "bar.ball[1].x" => self.ball[0],
                "bar.ball[1].y" => self.ball[1],
                name if name == self.squareness.0 => self.squareness.1,
                name => self.of(name),
            };
            (own.name.clone(), own.value, own.standard_uncertainty, truth)
        });
        let all: Vec<_> = all.collect();
        assert_eq!(all.len(), 14, "{}", self.chain);
        all
    }
}

#[test]
fn errors_of_random_machines_come_back() {
    for seed in 0..48 {
        let random = &mut Random::new(1000 + seed);
        let machine = Machine::new(seed as usize % 4, random);
        let radius = random.within(80.0, 200.0);
        for (name, value, _, truth) in machine.found(radius, 0.0, random) {
            // Lengths in mm; the effect of a lag at 40 mm/s and of slopes over the radius.
            let effect = if name.contains("lag") {
                40.0
            } else if name.contains("[1]") && !name.contains("ball") || name.contains('0') {
                radius
            } else {
                1.0
            };
            let off = (value - truth).abs() * effect;
            assert!(off < 1e-9, "seed {seed}, {}: {name} is {value} instead of {truth}", machine.chain);
        }
    }
}

#[test]
fn uncertainties_of_random_machines_hold() {
    let (mut squares, mut count, mut beyond) = (0.0, 0, 0);
    for seed in 0..40 {
        let random = &mut Random::new(7000 + seed);
        let machine = Machine::new(seed as usize % 4, random);
        for (_, value, uncertainty, truth) in machine.found(150.0, 3e-4, random) {
            let error = (value - truth) / uncertainty;
            squares += error * error;
            count += 1;
            beyond += usize::from(error.abs() > 2.0);
        }
    }
    // 560 numbers: the mean square within four of its standard deviations, and 4.6 % beyond two standard uncertainties.
    let mean = squares / f64::from(count);
    assert!((mean - 1.0).abs() < 4.0 * (2.0 / f64::from(count)).sqrt() * 1.3, "{mean} of {count}");
    assert!((8..=50).contains(&beyond), "{beyond} of {count}");
}

/// Contributions are ranges of what each error does by itself: by hand for the largest ones.
#[test]
fn the_diagnosis_ranks_errors_by_what_they_do() {
    let verdict = exact().verdicts.iter().find(|verdict| verdict.stage == "diagnosis").expect("a verdict");
    let of = |name: &str| {
        let found = verdict.figures.iter().find(|figure| figure.name == name).unwrap_or_else(|| panic!("no {name}"));
        found.value.expect("a value")
    };
    let lag = 6.913e-4;
    // Reading v/2 sin 2t x mismatch: range v x mismatch in um, both ways together the same; 500 and 2000 mm/min.
    for (file, feed) in [("ballbar-xy-f500", 500.0), ("ballbar-xy-f2000", 2000.0)] {
        let (found, expected) = (of(&format!("servo mismatch EXX[lag][{file}]")), feed / 60.0 * lag * 1e3);
        assert!((found - expected).abs() < 2e-3 * expected, "{found} {expected}");
        // R/2 sin 2t x squareness.
        let (found, expected) = (of(&format!("squareness EC0X[{file}]")), 150.0 * 1.555e-5 * 1e3);
        assert!((found - expected).abs() < 2e-3 * expected, "{found} {expected}");
        // Scale of X: R cos^2 t x scale, of which a centre takes nothing.
        let (found, expected) = (of(&format!("scale error EXX[1][{file}]")), 150.0 * 1.8811e-5 * 1e3);
        assert!((found - expected).abs() < 2e-3 * expected, "{found} {expected}");
        assert!(of(&format!("not explained[{file}]")) < 1e-2);
        let circle = of(&format!("G(b)_lsc[{file}]"));
        let expected = kept("exact-expected")["circular"][format!("{file}.csv")]["G_b_lsc"].as_f64().expect("it");
        // Its reversals are left out here.
        assert!((circle - expected).abs() < 0.05 * expected, "{circle} {expected}");
    }
    let (_, files) = exact().exports.iter().find(|(stage, _)| stage == "diagnosis").expect("its files");
    let file = files.iter().find(|file| file.name == "diagnosis-ballbar-xy-f2000.csv").expect("a table");
    let table = String::from_utf8_lossy(&file.content).into_owned();
    let mut lines = table.lines().skip(1);
    assert!(lines.next().expect("a row").starts_with("1,EXX[lag],servo mismatch,23.0"), "{table}");
    let shares: f64 =
        table.lines().skip(1).map(|line| line.split(',').nth(5).expect("a share").parse::<f64>().expect("it")).sum();
    assert!((shares - 100.0).abs() < 0.1, "{table}");
}
