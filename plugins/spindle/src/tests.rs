//! Random spindles: harmonics, covariance, reversal, and what is refused.

use std::f64::consts::TAU;

use abbe_core::{Calibration, Column, ColumnHeader, Dataset, Estimate, Result, RowOrigin, Values, from_settings};
use serde_json::{Value, json};

use crate::motion::Motion;
use crate::reversal::Reversal;
use crate::speed::check_speeds;

mod passes;

/// Numbers without a law.
struct Random(u64);

impl Random {
    /// From 0 to 1.
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let mixed = (self.0 ^ (self.0 >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        ((mixed ^ (mixed >> 32)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (TAU * self.uniform()).cos()
    }
}

/// A spindle with an artefact, mm.
struct Simulated {
    highest: usize,
    eccentricity: [f64; 2],
    backward: [f64; 2],
    /// Motion along x, y and z: cosine and sine by order, from 0.
    motion: [Vec<[f64; 2]>; 3],
    form: Vec<[f64; 2]>,
    azimuths: [f64; 2],
    rpm: f64,
}

impl Simulated {
    fn new(random: &mut Random, highest: usize) -> Self {
        let part = |random: &mut Random, order: usize| {
            [random.normal(), random.normal()].map(|value| 1e-4 * value / order.max(1) as f64)
        };
        let mut list = |lowest: usize| -> Vec<[f64; 2]> {
            (0..=highest).map(|order| if order < lowest { [0.0; 2] } else { part(random, order) }).collect()
        };
        let (motion, form) = ([list(2), list(2), list(1)], list(2));
        let first = random.between(-180.0, 180.0);
        Self {
            highest,
            eccentricity: [random.between(1e-3, 5e-3), random.between(-5e-3, 5e-3)],
            backward: [random.between(-1e-4, 1e-4), random.between(-1e-4, 1e-4)],
            motion,
            form,
            azimuths: [first, first + [90.0, 60.0, 120.0, -90.0][(4.0 * random.uniform()) as usize % 4]],
            rpm: random.between(50.0, 20_000.0).round(),
        }
    }

    fn sum(list: &[[f64; 2]], angle: f64) -> f64 {
        let orders = list.iter().enumerate();
        orders.map(|(order, [cos, sin])| cos * (order as f64 * angle).cos() + sin * (order as f64 * angle).sin()).sum()
    }

    /// What two radial sensors and an axial one read; `sign` of the motion is -1 in the second set-up of a reversal.
    fn readings(&self, angle: f64, sign: f64) -> [f64; 3] {
        let ([ex, ey], [bc, bs], (s, c)) = (self.eccentricity, self.backward, angle.sin_cos());
        let x = ex * c - ey * s + bc * c + bs * s;
        let y = ex * s + ey * c - bc * s + bs * c;
        let apart = (self.azimuths[1] - self.azimuths[0]).to_radians();
        let form = |sensor: usize| Self::sum(&self.form, self.azimuths[sensor].to_radians() - angle);
        let motion = |axis: usize| sign * Self::sum(&self.motion[axis], angle);
        [
            x + motion(0) + form(0) + 0.02,
            x * apart.cos() + y * apart.sin() + motion(1) + form(1) - 0.01,
            motion(2) + 0.03,
        ]
    }

    fn settings(&self, linear_drift: bool) -> Value {
        json!({
            "radial": { "r1": { "azimuth_deg": self.azimuths[0] }, "r2": { "azimuth_deg": self.azimuths[1] } },
            "axial": "z", "harmonics": self.highest, "sectors": 16, "linear_drift": linear_drift,
            "speeds_rpm": [self.rpm],
        })
    }
}

/// A data set of columns.
fn data(columns: &[(&str, Vec<f64>)]) -> Dataset {
    let rows = columns[0].1.len();
    let column = |(name, values): &(&str, Vec<f64>)| Column {
        header: ColumnHeader::parse(name),
        values: Values::Numbers(values.clone()),
    };
    Dataset {
        columns: columns.iter().map(column).collect(),
        origins: (0..rows).map(|row| RowOrigin { file: 0, line: row + 2, row: row + 1 }).collect(),
        files: vec!["run.csv".into()],
        averaged: false,
        is_log: false,
        stated_tips: Vec::new(),
    }
}

/// How a run is sampled.
struct Sampling {
    turns: f64,
    per_turn: f64,
    /// Off the grid, in parts of a step.
    jitter: f64,
    start: f64,
}

impl Sampling {
    fn angles(&self, random: &mut Random) -> Vec<f64> {
        let count = (self.turns * self.per_turn).round() as usize;
        let step = TAU / self.per_turn;
        (0..count).map(|index| self.start + step * (index as f64 + self.jitter * random.uniform())).collect()
    }
}

/// The run of a simulated spindle; `disturb` adds what does not come back, for each of three sensors.
fn run(spindle: &Simulated, angles: &[f64], sign: f64, mut disturb: impl FnMut(usize, f64) -> f64) -> Dataset {
    let times: Vec<f64> = angles.iter().map(|angle| (angle - angles[0]).abs() / TAU * 60.0 / spindle.rpm).collect();
    let mut readings = [Vec::new(), Vec::new(), Vec::new()];
    for angle in angles {
        let all = spindle.readings(*angle, sign);
        (0..3).for_each(|sensor| readings[sensor].push(all[sensor] + disturb(sensor, *angle)));
    }
    let [r1, r2, z] = readings;
    let degrees = angles.to_vec();
    data(&[("S_rad", degrees), ("time_s", times), ("r1_mm", r1), ("r2_mm", r2), ("z_mm", z)])
}

fn estimate(settings: &Value, data: &[&Dataset]) -> Result<Calibration> {
    let motion: Motion = from_settings(settings).expect("settings");
    motion.estimate_readings("motion", data)
}

fn value(calibration: &Calibration, name: &str) -> f64 {
    calibration.get(name).unwrap_or_else(|| panic!("no {name}")).value
}

/// Pairs of a name and what the simulated spindle has there, as read.
fn truths(spindle: &Simulated) -> Vec<(String, f64)> {
    let run = |own: &str| format!("run[{}].{own}", spindle.rpm);
    let mut all = vec![
        (run("ecc.x"), spindle.eccentricity[0]),
        (run("ecc.y"), spindle.eccentricity[1]),
        (run("back.cos"), spindle.backward[0]),
        (run("back.sin"), spindle.backward[1]),
        (run("sync.z[cos1]"), spindle.motion[2][1][0]),
        (run("sync.z[sin1]"), spindle.motion[2][1][1]),
    ];
    for order in 2..=spindle.highest {
        for (axis, sensor) in ["r1", "r2", "z"].into_iter().enumerate() {
            let [mut cos, mut sin] = spindle.motion[axis][order];
            if axis < 2 {
                let (s, c) = (order as f64 * spindle.azimuths[axis].to_radians()).sin_cos();
                let [by_cos, by_sin] = spindle.form[order];
                cos += by_cos * c + by_sin * s;
                sin += by_cos * s - by_sin * c;
            }
            all.push((run(&format!("sync.{sensor}[cos{order}]")), cos));
            all.push((run(&format!("sync.{sensor}[sin{order}]")), sin));
        }
    }
    all
}

#[test]
fn random_spindles_without_noise_come_back() {
    for seed in 0..60 {
        let mut random = Random(seed);
        let highest = 3 + (9.0 * random.uniform()) as usize;
        let spindle = Simulated::new(&mut random, highest);
        let sampling = Sampling {
            turns: random.between(2.1, 9.0),
            per_turn: (2 * highest) as f64 + random.between(18.0, 40.0).round(),
            jitter: if seed % 2 == 0 { 0.0 } else { 0.2 },
            start: random.between(-30.0, 30.0),
        };
        let mut angles = sampling.angles(&mut random);
        if seed % 3 == 0 {
            // A spindle that turns the other way.
            angles.iter_mut().for_each(|angle| *angle = -*angle);
        }
        let found = estimate(&spindle.settings(seed % 2 == 1), &[&run(&spindle, &angles, 1.0, |_, _| 0.0)]);
        let found = found.unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        for (name, truth) in truths(&spindle) {
            assert!((value(&found, &name) - truth).abs() < 1e-13, "seed {seed}: {name}");
        }
        let speed = value(&found, &format!("run[{}].speed", spindle.rpm));
        assert!((speed / spindle.rpm - 1.0).abs() < 1e-9, "seed {seed}");
        // It can be written and read again.
        let text = found.to_json().expect("text");
        assert_eq!(Calibration::from_json(&text).expect("a calibration"), found, "seed {seed}");
    }
}

/// Swings of bearings: of a frequency of its own, with another phase in every turn, beside white noise.
fn swing(random: &mut Random, turns: usize) -> impl FnMut(usize, f64) -> f64 {
    let phases: Vec<[f64; 6]> = (0..=turns).map(|_| [0; 6].map(|_| random.between(0.0, TAU))).collect();
    let mut noise = Random(random.0 ^ 0x5555);
    move |sensor, angle| {
        let turn = ((angle / TAU).floor().max(0.0) as usize).min(turns);
        let of = |place: usize, order: f64| 5e-5 * (order * angle + phases[turn][2 * sensor + place]).sin();
        of(0, 0.42) + of(1, 5.3) + 6e-6 * noise.normal()
    }
}

#[test]
fn intervals_cover_the_truth_in_ninety_five_of_a_hundred() {
    let (mut inside, mut all, mut squares) = (0_usize, 0_usize, 0.0);
    for seed in 0..150 {
        let mut random = Random(1000 + seed);
        let highest = 3 + (6.0 * random.uniform()) as usize;
        let spindle = Simulated::new(&mut random, highest);
        let turns = 6 + (20.0 * random.uniform()) as usize;
        let on_grid = seed % 2 == 0;
        let sampling = Sampling {
            turns: turns as f64 + if on_grid { 0.0 } else { 0.3 },
            per_turn: if on_grid { 48.0 } else { 47.3 },
            jitter: if on_grid { 0.0 } else { 0.2 },
            start: 0.0,
        };
        let angles = sampling.angles(&mut random);
        let data = run(&spindle, &angles, 1.0, swing(&mut random, turns));
        let found = estimate(&spindle.settings(false), &[&data]).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        let budget = found.uncertainty.as_ref().expect("a budget");
        for (name, truth) in truths(&spindle) {
            let entry = budget.parameters.iter().find(|entry| entry.name == name).expect("a budget of it");
            let off = value(&found, &name) - truth;
            inside += usize::from(off.abs() <= entry.expanded_uncertainty);
            squares += (off / entry.standard_uncertainty).powi(2);
            all += 1;
        }
    }
    let part = inside as f64 / all as f64;
    println!("{part:.4} of {all} intervals cover, mean square {:.3}", squares / all as f64);
    assert!((0.93..0.975).contains(&part), "{part}");
}

#[test]
fn a_reversal_tells_form_and_motion_apart_and_says_that_order_one_is_lost() {
    let (mut inside, mut all) = (0_usize, 0_usize);
    for seed in 0..60 {
        let mut random = Random(5000 + seed);
        let mut spindle = Simulated::new(&mut random, 6);
        let settings = json!({ "radial": { "r1": { "azimuth_deg": spindle.azimuths[0] } }, "harmonics": 6 });
        let reversal: Reversal = from_settings(&settings).expect("settings");
        let exact = seed % 3 == 0;
        let mut pair = Vec::new();
        for (setup, sign) in [(0, 1.0), (1, -1.0)] {
            let turns = 12;
            let (per_turn, jitter) = if setup == 0 { (40.0, 0.0) } else { (37.4, 0.2) };
            let angles = Sampling { turns: f64::from(turns), per_turn, jitter, start: 3.0 * random.uniform() }
                .angles(&mut random);
            // Each set-up has an eccentricity of its own.
            spindle.eccentricity = [random.between(-4e-3, 4e-3), random.between(-4e-3, 4e-3)];
            let mut swing = swing(&mut random, 12);
            pair.push(run(&spindle, &angles, sign, |sensor, angle| if exact { 0.0 } else { swing(sensor, angle) }));
        }
        let found = reversal.estimate_readings("reversal", &[&pair[0], &pair[1]]).expect("a reversal");
        let budget = found.uncertainty.as_ref().expect("a budget");
        for order in 2..=6 {
            for (part, index) in [("cos", 0), ("sin", 1)] {
                for (name, truth) in [
                    (format!("form[{part}{order}]"), spindle.form[order][index]),
                    (format!("sync.r1[{part}{order}]"), spindle.motion[0][order][index]),
                ] {
                    let off = (value(&found, &name) - truth).abs();
                    if exact {
                        assert!(off < 1e-13, "seed {seed}: {name} is off by {off:e}");
                    } else {
                        let entry = budget.parameters.iter().find(|entry| entry.name == name).expect("a budget");
                        inside += usize::from(off <= entry.expanded_uncertainty);
                        all += 1;
                    }
                }
            }
        }
        assert_eq!((found.fit.unknowns - found.fit.rank, found.fit.null_space.len()), (4, 4));
        assert!(found.fit.null_space[0].describe().contains("form[cos1]"));
        Calibration::from_json(&found.to_json().expect("text")).expect("a calibration");
    }
    let part = inside as f64 / all as f64;
    println!("{part:.4} of {all} intervals cover");
    assert!((0.93..0.985).contains(&part), "{part}");
}

/// A usual run that a case spoils.
fn usual() -> (Value, Vec<(&'static str, Vec<f64>)>) {
    let mut random = Random(77);
    let spindle = Simulated { azimuths: [0.0, 90.0], rpm: 600.0, ..Simulated::new(&mut random, 6) };
    let angles = Sampling { turns: 8.0, per_turn: 48.0, jitter: 0.0, start: 0.0 }.angles(&mut random);
    let set = run(&spindle, &angles, 1.0, swing(&mut random, 8));
    let of = |name: &str| set.numbers(name).expect("numbers").to_vec();
    let columns =
        vec![("S_rad", of("S")), ("time_s", of("time")), ("r1_mm", of("r1")), ("r2_mm", of("r2")), ("z_mm", of("z"))];
    let settings = json!({
        "radial": { "r1": { "azimuth_deg": 0 }, "r2": { "azimuth_deg": 90 } },
        "axial": "z", "harmonics": 6, "sectors": 16,
    });
    (settings, columns)
}

/// What is said about a run that was changed.
fn said(settings: &Value, columns: &[(&str, Vec<f64>)]) -> String {
    match estimate(settings, &[&data(columns)]) {
        Ok(_) => "nothing".to_owned(),
        Err(error) => error.to_string(),
    }
}

#[test]
fn bad_readings_are_refused_with_what_is_wrong() {
    type Change = fn(&mut Value, &mut Vec<(&'static str, Vec<f64>)>);
    let cases: [(Change, &str); 19] = [
        (|_, _| (), "nothing"),
        (|_, c| c[0].1[100..].iter_mut().for_each(|s| *s += 0.05), "run.csv:102: the angle of the spindle goes on by"),
        (|_, c| c[0].1[100..].iter_mut().for_each(|s| *s -= 0.5), "run.csv:102: the angle of the spindle goes back"),
        (|_, c| c[0].1.iter_mut().for_each(|s| *s %= TAU), "write `encoder: wrapped`"),
        (
            |s, c| {
                c[0].1.iter_mut().for_each(|s| *s %= TAU);
                s["encoder"] = json!("wrapped");
            },
            "nothing",
        ),
        (|_, c| c.iter_mut().for_each(|c| c.1.truncate(70)), "its angle covers 1.46 turns"),
        (|_, c| c[0].1.iter_mut().for_each(|s| *s *= TAU / 360.0), "is the angle in the unit"),
        (
            |_, c| c.iter_mut().for_each(|c| drop(c.1.drain(100..120))),
            "run.csv:102: readings are missing before this one: over 157.5 deg",
        ),
        (|_, c| c[0].1.iter_mut().for_each(|s| *s = 1.0), "the angle of the spindle stands"),
        (
            |_, c| c[1].1[200..].iter_mut().enumerate().for_each(|(row, t)| *t += 0.3 * row as f64 * 0.002_083),
            "turn 1 has 600 rpm, the run",
        ),
        (|_, c| c[1].1.swap(20, 30), "the time goes back"),
        (
            |_, c| {
                let other = c[2].1.clone();
                c[2].1 = std::mem::replace(&mut c[3].1, other);
            },
            "are r1 and r2 swapped, or is one of them the column of another sensor",
        ),
        (|_, c| c[2].1.iter_mut().for_each(|r| *r = r.min(0.0215)), "r1 reads its largest value, 21.5000 um,"),
        (|_, c| c[4].1.iter_mut().for_each(|r| *r = r.max(0.0299)), "z reads its smallest value, 29.9000 um,"),
        (|_, c| c[4].1.fill(0.4), "z reads 400 um all the time"),
        (|_, c| c[3].1.iter_mut().for_each(|r| *r *= 1e3), "r2 moves by"),
        (|s, _| s["harmonics"] = json!(24), "which tell 23 harmonics at most"),
        (|s, _| s["harmonics"] = json!(25), "do not tell apart sin 24 S; cos 23 S and cos 25 S; sin 23 S and sin 25 S"),
        (|s, _| s["sectors"] = json!(100), "choose fewer `sectors`: there are 48 readings a turn"),
    ];
    for (number, (change, expected)) in cases.into_iter().enumerate() {
        let (mut settings, mut columns) = usual();
        change(&mut settings, &mut columns);
        let said = said(&settings, &columns);
        assert!(said.contains(expected), "case {number}: {said}");
        assert_eq!(said == "nothing", expected == "nothing", "case {number}: {said}");
    }
}

#[test]
fn a_time_in_another_unit_is_refused_with_the_unit() {
    let stated = |speed: f64| {
        let (mut settings, columns) = usual();
        settings["speeds_rpm"] = json!([speed, 4.0 * speed]);
        (settings, columns)
    };
    let within = |slowest: f64, fastest: f64| {
        let (mut settings, columns) = usual();
        settings["plausible_rpm"] = json!([slowest, fastest]);
        (settings, columns)
    };
    for (unit, seconds) in [("min", 60.0), ("ms", 1e-3), ("us", 1e-6), ("h", 3600.0)] {
        for (settings, mut columns) in [usual(), stated(600.0), within(550.0, 650.0)] {
            assert_eq!(said(&settings, &columns), "nothing");
            columns[1].1.iter_mut().for_each(|time| *time /= seconds);
            let said = said(&settings, &columns);
            assert!(said.contains(&format!("with a time in {unit} it would have 600.0 rpm")), "{unit}: {said}");
        }
    }
    let (settings, columns) = stated(800.0);
    assert!(said(&settings, &columns).contains("it has 600.0000 rpm; the speeds that were set are 800, 3200 rpm"));
    let (settings, columns) = within(1000.0, 2000.0);
    assert!(said(&settings, &columns).contains("and 1000 to 2000 rpm were expected"));
    for speeds in [[0.0, 10.0], [20.0, 10.0], [10.0, f64::INFINITY]] {
        assert!(check_speeds(speeds, &[]).is_err(), "{speeds:?}");
    }
}

#[test]
fn coarse_steps_and_missing_single_readings_are_no_fault() {
    for step in [1e-6, 1e-5, 5e-5, 2e-4] {
        let (settings, mut columns) = usual();
        for (_, values) in &mut columns[2..] {
            values.iter_mut().for_each(|value| *value = (*value / step).round() * step);
        }
        assert_eq!(said(&settings, &columns), "nothing", "steps of {step} mm");
    }
    let (settings, mut columns) = usual();
    columns.iter_mut().for_each(|column| drop(column.1.drain(150..152)));
    assert_eq!(said(&settings, &columns), "nothing");
    // Times in whole milliseconds, a step is 2.08 ms.
    let (settings, mut columns) = usual();
    columns[1].1.iter_mut().for_each(|time| *time = (*time * 1e3).round() / 1e3);
    assert_eq!(said(&settings, &columns), "nothing");
}

#[test]
fn one_radial_sensor_tells_its_fundamental_as_a_whole() {
    let (mut settings, columns) = usual();
    settings["radial"] = json!({ "r1": { "azimuth_deg": 0 } });
    settings.as_object_mut().expect("a map").remove("axial");
    let found = estimate(&settings, &[&data(&columns)]).expect("an estimate");
    let names: Vec<&str> = found.parameters.iter().map(|parameter| parameter.name.as_str()).collect();
    assert!(names.contains(&"run[600].fundamental.r1[cos]") && !names.contains(&"run[600].ecc.x"), "{names:?}");
}
