//! Validators of readings: tests of axes, circles, coordinate measuring machines and drifts.

use std::fmt::Write as _;

use abbe_core::Figure;
use serde_json::{Value, json};

use super::{Counted, Draw, MACHINES, Scene, count, guarded, machines, simple};
use crate::support::Random;

fn holds(validator: &str, kind: &str, keys: &[&str], draw: Draw) -> Counted {
    let counted = count(validator, kind, keys, draw, guarded, machines(MACHINES));
    counted.hold();
    counted
}

/// The same text before and after errors of measurement: rows with a true value and an error.
struct Tables {
    exact: String,
    measured: String,
}

impl Tables {
    fn new(header: &str) -> Self {
        Self { exact: format!("{header}\n"), measured: format!("{header}\n") }
    }

    /// Adds a row: its first cells, and the true values with their errors.
    fn row(&mut self, cells: &str, values: &[(f64, f64)]) {
        let text = |of: &dyn Fn(&(f64, f64)) -> f64| {
            values.iter().fold(cells.to_owned(), |text, value| format!("{text},{:.9}", of(value)))
        };
        let _ = writeln!(self.exact, "{}", text(&|(value, _)| *value));
        let _ = writeln!(self.measured, "{}", text(&|(value, error)| value + error));
    }

    fn scene(self, settings: Value) -> Scene {
        Tables::scene_of(vec![("test", self)], settings)
    }

    fn scene_of(tables: Vec<(&str, Self)>, settings: Value) -> Scene {
        let mut scene = Scene { settings, exact: Vec::new(), measured: Vec::new() };
        for (name, table) in tables {
            let file = format!("{name}.csv");
            scene.exact.push((file.clone(), table.exact));
            scene.measured.push((file, table.measured));
        }
        scene
    }
}

/// What a laser knows: how large its contributions are, and the settings that state them.
#[derive(Clone, Copy)]
struct Laser {
    device: f64,
    misalignment: f64,
    temperature: f64,
    expansion: f64,
    drift: f64,
}

const EXPANSION: f64 = 11.0;
const OFFSET: f64 = 3.0;

impl Laser {
    const ALL: Self = Self { device: 0.8, misalignment: 1.0, temperature: 0.6, expansion: 2.0, drift: 1.2 };
    /// What is in proportion to the length is nearly everything.
    const WARM: Self = Self { drift: 0.1, ..Self::ALL };
    /// The drift is everything.
    const DRIFTING: Self = Self { device: 0.0, misalignment: 0.0, temperature: 0.0, expansion: 0.0, drift: 4.0 };

    fn settings(self) -> Value {
        json!({ "uncertainty": {
            "device_U_um_per_m": self.device, "misalignment_mm": self.misalignment, "alpha_um_per_m_K": EXPANSION,
            "temperature_range_K": self.temperature, "alpha_range_um_per_m_K": self.expansion,
            "offset_from_20_K": OFFSET, "eve_range_um": self.drift,
        } })
    }

    /// An error of scale, um over a length in mm: normal by the device, rectangular by all else.
    fn scale(self, length: f64, random: &mut Random) -> f64 {
        let metres = 1e-3 * length;
        let mut range = |range: f64| range * random.within(-0.5, 0.5);
        let rectangular = range(1e3 * self.misalignment.powi(2) / (2.0 * length))
            + range(EXPANSION * metres * self.temperature)
            + range(self.expansion * metres * OFFSET);
        rectangular + 0.5 * self.device * metres * random.normal()
    }
}

/// An axis with a scale, a bend and a reversal that scatters, over these targets.
fn axis(
    laser: Laser,
    targets: &[f64],
    runs: usize,
    header: &str,
    way: impl Fn(f64) -> String,
    random: &mut Random,
) -> Tables {
    let first = targets[0];
    let travel = targets[targets.len() - 1] - first;
    let slope = random.sign() * random.within(5.0, 15.0);
    let [bend, reversal, scatter] = [random.within(-3.0, 3.0), random.within(-3.0, 3.0), random.within(0.2, 0.9)];
    let off = laser.scale(travel, random);
    // The range is that of differences between two readings.
    let drift = laser.drift / 2.0_f64.sqrt();
    let mut tables = Tables::new(header);
    for run in 1..=runs {
        for direction in [1.0, -1.0] {
            for place in 0..targets.len() {
                let place = if direction > 0.0 { place } else { targets.len() - 1 - place };
                let part = (targets[place] - first) / travel;
                let value = slope * part + bend * (6.0 * part).sin() + reversal * direction + scatter * random.normal();
                let error = off * part + drift * random.within(-0.5, 0.5);
                let at = targets[place];
                tables.row(&format!("{run},{direction},{at:.4}{}", way(at)), &[(value, error)]);
            }
        }
    }
    tables
}

const TARGETS: [f64; 7] = [0.0, 81.0, 162.0, 260.0, 333.0, 428.0, 500.0];
const AXIS: &str = "run,direction,position_mm,reading_um";

fn alone(_: f64) -> String {
    String::new()
}

#[test]
fn positioning() {
    let keys = [
        "limits.A_um",
        "limits.A_up_um",
        "limits.E_um",
        "limits.E_down_um",
        "limits.M_um",
        "limits.R_um",
        "limits.R_up_um",
        "limits.B_um",
        "limits.mean_B_um",
    ];
    let warm: Draw = |random| axis(Laser::WARM, &TARGETS, 5, AXIS, alone, random).scene(Laser::WARM.settings());
    let drifting: Draw =
        |random| axis(Laser::DRIFTING, &TARGETS, 5, AXIS, alone, random).scene(Laser::DRIFTING.settings());
    let all: Draw = |random| axis(Laser::ALL, &TARGETS, 2, AXIS, alone, random).scene(Laser::ALL.settings());
    let found = holds("positioning", "temperatures", &keys, warm);
    holds("positioning", "drift", &keys, drifting);
    holds("positioning", "two runs", &keys, all);
    // One run each way.
    let single: Draw = |random| axis(Laser::ALL, &TARGETS, 1, AXIS, alone, random).scene(Laser::ALL.settings());
    holds("positioning", "one run", &["limits.E_um", "limits.M_um", "limits.B_um"], single);
    // With the sign of the guard band turned nearly all of them would be accepted, and without it one in two.
    let by_chance = count("positioning", "temperatures", &keys, warm, simple, 150);
    let what = "positioning, temperatures: limits.E_um";
    assert!((by_chance.share(what) - 0.5).abs() < 0.15 && found.share(what) < 0.11, "{}", by_chance.share(what));
}

#[test]
fn diagonals() {
    let draw: Draw = |random| {
        let travels = [400.0, 300.0, 250.0_f64];
        let length = travels.iter().map(|own| own * own).sum::<f64>().sqrt();
        let targets: Vec<f64> = [0.0, 0.21, 0.39, 0.58, 0.81, 1.0].iter().map(|part| part * length).collect();
        let mut tables = Vec::new();
        for (name, signs) in
            [("ppp", [1.0, 1.0, 1.0]), ("npp", [-1.0, 1.0, 1.0]), ("pnp", [1.0, -1.0, 1.0]), ("nnp", [-1.0, -1.0, 1.0])]
        {
            let way = |at: f64| {
                let along = |axis: usize| signs[axis] * travels[axis] * (at / length - 0.5);
                format!(",{:.6},{:.6},{:.6}", along(0), along(1), along(2))
            };
            let header = "run,direction,position_mm,X_mm,Y_mm,Z_mm,reading_um";
            tables.push((name, axis(Laser::ALL, &targets, 3, header, way, random)));
        }
        Tables::scene_of(tables, Laser::ALL.settings())
    };
    let keys = ["A_um", "E_um", "M_um", "R_um", "B_um", "E_d_um", "B_d_um"].map(|key| format!("limits.{key}"));
    holds("diagonals", "bodies", &keys.each_ref().map(String::as_str), draw);
}

/// Both ways around, with readings that have an error in common (`common` of the variance) and one of their own.
fn circle(common: f64, random: &mut Random) -> Scene {
    let u = 0.5;
    let [x, y, oval, reversal, size] = [
        random.within(-20.0, 20.0),
        random.within(-20.0, 20.0),
        random.within(-8.0, 8.0),
        random.within(1.0, 5.0),
        random.sign() * random.within(2.0, 6.0),
    ];
    let shared = common.sqrt() * u * random.normal();
    let mut tables = Tables::new("direction,angle_deg,reading_um");
    for direction in [1.0, -1.0] {
        for step in 0..36 {
            let degrees = if direction > 0.0 { 10 * step } else { 350 - 10 * step };
            let angle = f64::from(degrees).to_radians();
            let (sin, cos) = angle.sin_cos();
            let value = size
                + x * cos
                + y * sin
                + oval * (2.0 * angle).sin()
                + reversal * direction * (cos.abs() - 0.6)
                + random.within(-0.3, 0.3);
            let error = shared + (1.0 - common).sqrt() * u * random.normal();
            tables.row(&format!("{direction},{degrees}"), &[(value, error)]);
        }
    }
    tables.scene(json!({ "radius_mm": 150, "standard_uncertainty_um": u }))
}

#[test]
fn circular() {
    let keys = ["G_um", "G_b_um", "G_lsc_um", "G_b_lsc_um", "H_um", "D_um", "F_um"].map(|key| format!("limits.{key}"));
    let keys = keys.each_ref().map(String::as_str);
    holds("circular", "own errors", &keys, |random| circle(0.0, random));
    // An error that all readings share is in D and F as it is; ranges do not have it.
    let found = holds("circular", "shared errors", &keys[5..], |random| circle(1.0, random));
    assert!(found.share("circular, shared errors: limits.D_um") < 0.12);
    let by_chance = count("circular", "shared errors", &keys[5..], |random| circle(1.0, random), simple, 150);
    let share = by_chance.share("circular, shared errors: limits.D_um");
    assert!((share - 0.5).abs() < 0.15, "{share}");
}

#[test]
fn rotary_interpolation() {
    let draw: Draw = |random| {
        let u = 0.4;
        let amplitudes: Vec<[f64; 3]> =
            (0..3).map(|_| [random.within(-8.0, 8.0), random.within(-8.0, 8.0), random.within(-3.0, 3.0)]).collect();
        let mut tables = Tables::new("direction,X_mm,Y_mm,Z_mm,C_deg,meas_x_um,meas_y_um,meas_z_um");
        for direction in [1.0, -1.0] {
            for step in 0..13 {
                let degrees = if direction > 0.0 { 30 * step } else { 360 - 30 * step };
                let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
                let cells = format!("{direction},{:.9},{:.9},0,{degrees}", 110.0 * cos, 110.0 * sin);
                let values: Vec<(f64, f64)> = (amplitudes.iter())
                    .map(|[a, b, c]| {
                        (a * cos + b * sin + c * direction + random.within(-0.2, 0.2), u * random.normal())
                    })
                    .collect();
                tables.row(&cells, &values);
            }
        }
        tables.scene(json!({
            "axis": "C", "direction": [0, 0, 1], "ball_from_axis_mm": [110, 0, 60], "reverse": true, "standard_uncertainty_um": u,
        }))
    };
    let keys = ["radial_um", "tangential_um", "axial_um", "x_um", "y_um", "z_um"].map(|key| format!("limits.{key}"));
    holds("rotary-interpolation", "own errors", &keys.each_ref().map(String::as_str), draw);
}

/// Fifteen lengths, each three times, with an error of the reference that all share or with errors of their own. The machine stands at
/// A + L/K: both are made so by its largest error.
fn lengths(is_shared: bool, random: &mut Random) -> [Scene; 2] {
    let (expanded, divisor) = (0.5, 1000.0);
    let (scale, scatter) = (random.sign() * random.within(1.5, 3.0), random.within(0.05, 0.25));
    let mut tables = Tables::new("group,reference_mm,measured_mm");
    let common = random.normal();
    for line in 1..=3 {
        for length in [60.0, 140.0, 220.0, 310.0, 390.0] {
            for _ in 0..3 {
                let reference: f64 = length + f64::from(line);
                let value = reference + 1e-3 * (scale * reference / 390.0 + scatter * random.normal());
                let u = 0.5e-3 * (expanded + reference / divisor);
                let error = u * if is_shared { common } else { random.normal() };
                tables.row(&format!("{line},{reference:.6}"), &[(value, error)]);
            }
        }
    }
    // The largest share of A + L/K is 1.
    let share = |text: &str| {
        let of = |line: &str| {
            let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
            1e3 * (cells[2] - cells[1]).abs() / (1.5 + cells[1] / 300.0)
        };
        text.lines().skip(1).map(of).fold(0.0, f64::max)
    };
    let most = share(&tables.exact);
    let settings = |decision: &str| {
        json!({
            "mpe": { "A_um": 1.5 * most, "K": 300.0 / most }, "decision": { "rule": decision },
            "expanded_uncertainty": { "A_um": expanded, "K": divisor },
        })
    };
    let (exact, measured) = (tables.exact.clone(), tables.measured.clone());
    let plain = Tables { exact, measured }.scene(settings("simple"));
    [tables.scene(settings("iso-14253-1-2017")), plain]
}

#[test]
fn lengths_of_coordinate_measuring_machines() {
    let registry = crate::support::registry();
    let (mut counted, mut by_chance) = (Counted::default(), Counted::default());
    for (kind, is_shared) in [("own errors", false), ("shared errors", true)] {
        for seed in 0..machines(MACHINES) as u64 {
            let scenes = lengths(is_shared, &mut Random::new(1 + seed));
            for (scene, counted) in scenes.iter().zip([&mut counted, &mut by_chance]) {
                let found = super::limited(&registry, "cmm-lengths", &scene.settings, &scene.measured);
                assert!(!found.is_empty());
                // A test of few lengths decides nothing; what counts here is how one length is judged.
                let mut alone = found.into_iter().map(|figure| Figure { inconclusive: None, ..figure });
                let accepted = alone.all(|figure| figure.decide() == Some(abbe_core::Decision::Pass));
                counted.add(&format!("cmm-lengths, {kind}"), accepted);
            }
        }
    }
    counted.hold();
    let share = by_chance.share("cmm-lengths, shared errors");
    assert!((0.3..0.7).contains(&share), "{share}");
}

/// The 25 directions of a hemisphere: a pole and rings of 4, 8, 4 and 8.
fn hemisphere() -> Vec<[f64; 3]> {
    let mut all = vec![[0.0, 0.0, 1.0]];
    for (from_pole, count, turned) in [(22.5_f64, 4, 0.0), (45.0, 8, 22.5), (67.5, 4, 0.0), (90.0, 8, 22.5)] {
        for step in 0..count {
            let azimuth = (turned + f64::from(step) * 360.0 / f64::from(count)).to_radians();
            let (sin, cos) = from_pole.to_radians().sin_cos();
            all.push([sin * azimuth.cos(), sin * azimuth.sin(), cos]);
        }
    }
    all
}

/// A sphere by one stylus and by five others: its diameter is off, or its form is.
fn sphere(is_of_size: bool, random: &mut Random) -> Scene {
    let (radius, u) = (12.499_37, 0.3e-3);
    let mut tables = Tables::new("stylus,x_mm,y_mm,z_mm");
    let size = if is_of_size { 0.5 * u * random.normal() } else { 0.0 };
    let radius_off = random.sign() * random.within(0.3e-3, 1e-3);
    for stylus in 0..6 {
        let beside = [0; 3].map(|_| random.within(-1.5e-3, 1.5e-3));
        for direction in hemisphere() {
            let radial = radius + radius_off + random.within(-0.4e-3, 0.4e-3);
            let error = size + if is_of_size { 0.0 } else { u / 2.0_f64.sqrt() * random.normal() };
            let of = |axis: usize| (beside[axis] + radial * direction[axis], error * direction[axis]);
            tables.row(&stylus.to_string(), &[of(0), of(1), of(2)]);
        }
    }
    tables.scene(json!({ "diameter_mm": 2.0 * radius, "expanded_uncertainty_um": 2e3 * u }))
}

#[test]
fn probing_of_coordinate_measuring_machines() {
    holds("cmm-probing", "diameter", &["limits.PSTU_um", "limits.PSTM_um"], |random| sphere(true, random));
    let keys = ["limits.PFTU_um", "limits.PFTM_um", "limits.PLTM_um"];
    holds("cmm-probing", "form", &keys, |random| sphere(false, random));
    let by_chance = count("cmm-probing", "diameter", &["limits.PSTU_um"], |random| sphere(true, random), simple, 150);
    let share = by_chance.share("cmm-probing, diameter: limits.PSTU_um");
    assert!((share - 0.5).abs() < 0.15, "{share}");
}

#[test]
fn drifts() {
    let draw: Draw = |random| {
        let u = 0.3;
        let (size, tau, wave) =
            (random.sign() * random.within(5.0, 20.0), random.within(600.0, 3000.0), random.within(0.0, 1.0));
        let mut tables = Tables::new("time_s,drift_x_um");
        for step in 0..40 {
            let time = 180.0 * f64::from(step);
            let value = size * (1.0 - (-time / tau).exp()) + wave * (time / 400.0).sin();
            tables.row(&format!("{time}"), &[(value, u * random.normal())]);
        }
        tables.scene(json!({ "drift": { "readings": ["drift_x"], "standard_uncertainty_um": u, "limits": {} } }))
    };
    let keys = ["range_um", "first_range_um", "window_range_um", "end_um"].map(|key| format!("drift.limits.{key}"));
    let found = holds("thermal", "drift", &keys.each_ref().map(String::as_str), draw);
    assert!(found.share("thermal, drift: drift.limits.end_um") < 0.11);
    // A slope has no uncertainty, and proves nothing.
    let slope = count("thermal", "drift", &["drift.limits.slope_um_per_min"], draw, guarded, 20);
    assert_eq!(slope.share("thermal, drift: drift.limits.slope_um_per_min"), 0.0);
}
