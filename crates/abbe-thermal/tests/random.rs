//! Random systems: any sampling, both holds, outputs with clocks of their own.

use abbe_numerics::Generator;
use abbe_thermal::{Bootstrap, Hold, Output, Readings, Response, SensorLog, Structure, fit};

/// A log of inputs that wander, and outputs of a system with these time constants.
struct System {
    log: SensorLog,
    structure: Structure,
    time_constants: Vec<f64>,
    gains: Vec<Vec<f64>>,
    outputs: Vec<Output>,
}

/// A number from 0 to 1.
fn part(random: &mut Generator) -> f64 {
    random.index(1_000_003) as f64 / 1_000_003.0
}

fn system(seed: u64, noise: f64) -> System {
    let mut random = Generator::new(seed, 0);
    let count = 1 + random.index(3);
    let sensors = 1 + random.index(3);
    let hold = if part(&mut random) < 0.5 { Hold::FirstOrder } else { Hold::ZeroOrder };
    let mut times = vec![1000.0 * part(&mut random)];
    for _ in 0..500 {
        let gap = if part(&mut random) < 0.02 { 400.0 } else { 0.0 };
        times.push(times[times.len() - 1] + 20.0 + 60.0 * part(&mut random) + gap);
    }
    let mut readings = Vec::new();
    for sensor in 0..sensors {
        let mut level = 0.0;
        let values = times.iter().map(|_| {
            if part(&mut random) < 0.03 {
                level = 20.0 * part(&mut random) - 10.0;
            }
            level + 0.5 * random.normal()
        });
        readings.push((format!("T{sensor}"), values.collect::<Vec<f64>>()));
    }
    let log = SensorLog::new(times.clone(), readings, hold, None).expect("a log");
    let mut time_constants = vec![150.0 + 300.0 * part(&mut random)];
    for _ in 1..count {
        time_constants.push(time_constants[time_constants.len() - 1] * (3.0 + 3.0 * part(&mut random)));
    }
    let structure = Structure {
        inputs: (0..sensors).collect(),
        at_once: if part(&mut random) < 0.3 { vec![0] } else { Vec::new() },
        time_constants: count,
        starts_warm: part(&mut random) < 0.3,
        guess: None,
    };
    let (mut outputs, mut gains) = (Vec::new(), Vec::new());
    for output in 0..4 {
        // Two outputs of the log's clock, two of their own.
        let own: Vec<f64> = match output {
            0 | 1 => times.clone(),
            _ => (0..300).map(|_| times[0] + (times[500] - times[0]) * part(&mut random)).collect(),
        };
        let of_output: Vec<f64> = (0..structure.gains(1)).map(|_| 0.2 + part(&mut random)).collect();
        let mut values = vec![0.0; own.len()];
        let mut add = |gain: f64, by: &[f64]| values.iter_mut().zip(by).for_each(|(value, by)| *value += gain * by);
        for input in 0..sensors {
            for (index, time) in time_constants.iter().enumerate() {
                let response = Response::new(&log, input, *time, &own).expect("a response");
                add(of_output[structure.gain(input, index)], &response.values);
            }
        }
        let states = sensors * count;
        for (place, sensor) in structure.at_once.iter().enumerate() {
            let at: Vec<f64> = own.iter().map(|time| log.at(*sensor, *time).expect("a reading")).collect();
            add(of_output[states + place], &at);
        }
        if structure.starts_warm {
            for (index, time) in time_constants.iter().enumerate() {
                let response = Response::of_beginning(&log, *time, &own);
                add(of_output[states + structure.at_once.len() + index], &response.values);
            }
        }
        values.iter_mut().for_each(|value| *value += noise * random.normal());
        outputs.push(Output::of_run(format!("y{output}"), own, values));
        gains.push(of_output);
    }
    System { log, structure, time_constants, gains, outputs }
}

#[test]
fn exact_readings_give_random_systems_back() {
    for seed in 0..150 {
        let made = system(seed, 0.0);
        let found = fit(std::slice::from_ref(&made.log), &made.outputs, &made.structure)
            .unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        for (found, expected) in found.time_constants.iter().zip(&made.time_constants) {
            assert!((found / expected - 1.0).abs() < 1e-7, "seed {seed}: {found} {expected}");
        }
        for (found, expected) in found.gains.iter().flatten().zip(made.gains.iter().flatten()) {
            assert!((found - expected).abs() < 1e-6, "seed {seed}: {found} {expected}");
        }
    }
}

/// Derivatives to the logarithm of a time constant against differences, at any time and for both holds.
#[test]
fn slopes_are_derivatives() {
    for seed in 0..100 {
        let made = system(seed, 0.0);
        let mut random = Generator::new(seed, 1);
        let times: Vec<f64> = made.outputs[3].runs[0].times.clone();
        let time_constant = 10.0 * (1000.0_f64).powf(part(&mut random));
        let at = |factor: f64| Response::new(&made.log, 0, time_constant * factor, &times).expect("a response");
        let (here, step) = (at(1.0), 1e-5_f64);
        let (more, less) = (at(step.exp()), at((-step).exp()));
        for (row, slope) in here.slopes.iter().enumerate() {
            let difference = (more.values[row] - less.values[row]) / (2.0 * step);
            assert!((slope - difference).abs() < 1e-6, "seed {seed}: {slope} {difference}");
        }
    }
}

/// Noise of the outputs alone: intervals of two standard uncertainties hold what they promise.
#[test]
fn uncertainties_cover() {
    let (mut inside, mut all, mut squares) = (0_u32, 0_u32, 0.0);
    for seed in 0..200 {
        let made = system(seed, 0.05);
        let found = fit(std::slice::from_ref(&made.log), &made.outputs, &made.structure)
            .unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        let times = found.time_constants.iter().zip(&made.time_constants).zip(&found.relative_uncertainties);
        let of_times = times.map(|((found, expected), relative)| (found / expected).ln() / relative);
        let gains = found.gains.iter().flatten().zip(made.gains.iter().flatten());
        let of_gains =
            gains.zip(found.gain_uncertainties.iter().flatten()).map(|((found, expected), u)| (found - expected) / u);
        for score in of_times.chain(of_gains) {
            (all, squares) = (all + 1, squares + score * score);
            inside += u32::from(score.abs() < 2.0);
        }
    }
    let (part, mean) = (f64::from(inside) / f64::from(all), squares / f64::from(all));
    println!("{all} scores: {part:.4} within two, mean square {mean:.3}");
    assert!((part - 0.9545).abs() < 0.01 && (mean - 1.0).abs() < 0.06, "{part} {mean}");
}

#[test]
fn what_logs_cannot_tell_is_refused() {
    let log = |times: &[f64], values: &[f64]| {
        SensorLog::new(times.to_vec(), vec![("T1".to_owned(), values.to_vec())], Hold::FirstOrder, Some(100.0))
    };
    let says = |result: abbe_core::Result<SensorLog>, words: &str| {
        let said = result.expect_err("a bad log").to_string();
        assert!(said.contains(words), "{said}");
    };
    says(log(&[0.0, 60.0, 50.0], &[1.0, 2.0, 3.0]), "goes from 60 s to 50 s in row 3");
    says(log(&[0.0, 60.0, 60.0], &[1.0, 2.0, 3.0]), "goes from 60 s to 60 s");
    says(log(&[0.0, 60.0, 300.0], &[1.0, 2.0, 3.0]), "gap of 240 s before row 3");
    says(log(&[0.0, f64::NAN, 60.0], &[1.0, 2.0, 3.0]), "row 2 of the log has no time");
    says(log(&[0.0, 60.0, 90.0], &[1.0, f64::NAN, 3.0]), "T1 has no reading in row 2");
    says(log(&[0.0], &[1.0]), "at least two rows");

    let made = system(5, 0.01);
    let refused = |log: &SensorLog, outputs: &[Output], structure: &Structure, words: &str| {
        let said = fit(std::slice::from_ref(log), outputs, structure).expect_err("no fit").to_string();
        assert!(said.contains(words), "{said}");
    };
    // A reading from another clock.
    let mut outputs = made.outputs.clone();
    outputs[1].runs[0].times[3] = 1e9;
    refused(&made.log, &outputs, &made.structure, "outside the log");
    // Two sensors that read the same.
    let twice = SensorLog::new(
        made.log.times().to_vec(),
        vec![("T0".to_owned(), made.log.values(0).to_vec()), ("T9".to_owned(), made.log.values(0).to_vec())],
        made.log.hold(),
        None,
    )
    .expect("a log");
    let both = Structure { inputs: vec![0, 1], at_once: Vec::new(), starts_warm: false, ..made.structure.clone() };
    refused(&twice, &made.outputs, &both, "T9 with time constant 1 cannot be told from the terms before it");
    // Fewer readings than gains.
    let mut few = made.outputs.clone();
    few[0] = Output::of_run("y0", few[0].runs[0].times[..3].to_vec(), few[0].runs[0].values[..3].to_vec());
    refused(&made.log, &few, &made.structure, "y0 has 3 readings");
    let guess = Structure { guess: Some(vec![-1.0; made.structure.time_constants]), ..made.structure.clone() };
    refused(&made.log, &made.outputs, &guess, "times above 0 s");
    // A sensor that is stuck is named.
    let mut with_stuck: Vec<(String, Vec<f64>)> = vec![("T0".to_owned(), made.log.values(0).to_vec())];
    with_stuck.push(("T7".to_owned(), vec![21.5; made.log.times().len()]));
    let stuck = SensorLog::new(made.log.times().to_vec(), with_stuck, made.log.hold(), None).expect("a log");
    assert_eq!(stuck.stuck(), ["T7"]);
}

/// A model with one time constant too many says so.
#[test]
fn time_constants_that_are_one_are_told() {
    let mut told = 0;
    for seed in 0..40 {
        let made = system(seed, 0.0);
        if made.structure.time_constants > 1 || made.structure.starts_warm {
            continue;
        }
        let more = Structure { time_constants: 2, ..made.structure.clone() };
        match fit(std::slice::from_ref(&made.log), &made.outputs, &more) {
            Err(_) => told += 1,
            // The second one has no effect: its uncertainty is beyond all measure.
            Ok(found) => {
                assert!(found.relative_uncertainties.iter().any(|relative| *relative > 1e-3), "{seed}: {found:?}")
            }
        }
    }
    println!("{told} times refused");
}

/// One system seen in two runs: gains and time constants are shared, states at the beginning are not.
#[test]
fn several_runs_share_gains_and_time_constants() {
    for seed in 0..60 {
        let made = system(seed, 0.0);
        let half = made.log.times().len() / 2;
        // The second half as a run of its own begins warm.
        let part = |rows: std::ops::Range<usize>| {
            let sensors = made.log.names().iter().enumerate();
            let sensors = sensors.map(|(sensor, name)| (name.clone(), made.log.values(sensor)[rows.clone()].to_vec()));
            let log = SensorLog::new(made.log.times()[rows.clone()].to_vec(), sensors.collect(), made.log.hold(), None);
            log.expect("a log")
        };
        let logs = [part(0..half + 1), part(half..made.log.times().len())];
        let outputs: Vec<Output> = (made.outputs.iter())
            .map(|output| {
                let all = &output.runs[0];
                let of = |log: &SensorLog| {
                    let (first, last) = (log.times()[0], log.times()[log.times().len() - 1]);
                    let inside = all.times.iter().zip(&all.values).filter(|(time, _)| (first..=last).contains(*time));
                    let (times, values) = inside.map(|(time, value)| (*time, *value)).unzip();
                    Readings { times, values }
                };
                Output { runs: logs.iter().map(of).collect(), ..output.clone() }
            })
            .collect();
        let structure = Structure { starts_warm: true, ..made.structure.clone() };
        let found = fit(&logs, &outputs, &structure).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        for (found, expected) in found.time_constants.iter().zip(&made.time_constants) {
            assert!((found / expected - 1.0).abs() < 1e-6, "seed {seed}: {found} {expected}");
        }
        for (found, expected) in found.gains.iter().zip(&made.gains) {
            for (found, expected) in found.iter().zip(expected).take(structure.of_any_run()) {
                assert!((found - expected).abs() < 1e-5, "seed {seed}: {found} {expected}");
            }
        }
    }
}

/// White noise: residuals drawn again in short blocks say what the ordinary covariance says. Noise that stays for a while: the
/// ordinary one is too small, that of blocks is not.
#[test]
fn blocks_of_residuals_know_noise_that_stays() {
    let (mut white, mut ordinary_of_staying, mut drawn_of_staying, mut count) = (0.0, 0.0, 0.0, 0.0);
    for seed in 0..60 {
        let quiet = system(seed, 0.0);
        let logs = std::slice::from_ref(&quiet.log);
        for stays in [0.0, 0.95] {
            let mut random = Generator::new(seed, 7);
            let mut outputs = quiet.outputs[..2].to_vec();
            for output in &mut outputs {
                let mut noise = 0.0;
                for value in &mut output.runs[0].values {
                    noise = stays * noise + random.normal();
                    *value += 0.02 * noise;
                }
            }
            let found = fit(logs, &outputs, &quiet.structure).expect("a fit");
            let how = Bootstrap { draws: 200, block: if stays > 0.0 { 4000.0 } else { 60.0 }, seed };
            let drawn = found.bootstrap(logs, &outputs, how).expect("draws");
            let first = quiet.time_constants.len();
            let pairs = found.gains.iter().flatten().zip(quiet.gains[..2].iter().flatten());
            for (place, (found_gain, expected)) in pairs.enumerate() {
                let (at, off) = (first + place, (found_gain - expected).powi(2));
                let (ordinary, drawn) = (found.covariance[(at, at)], drawn[(at, at)]);
                if stays > 0.0 {
                    ordinary_of_staying += off / ordinary;
                    drawn_of_staying += off / drawn;
                    count += 1.0;
                } else {
                    white += drawn / ordinary;
                }
            }
        }
    }
    let [white, ordinary, drawn] = [white, ordinary_of_staying, drawn_of_staying].map(|sum| sum / count);
    assert!((0.8..1.2).contains(&white), "{white}");
    assert!(ordinary > 15.0 && drawn < 5.0, "{ordinary} {drawn}");
}
