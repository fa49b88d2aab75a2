//! What standard uncertainties of predictions are worth: an ordinary fit, residuals drawn again in blocks, and the scatter of a run that
//! was not seen. `ABBE_COVERAGE_SETS=1000` asks for more systems than the usual ones.

use abbe_numerics::Generator;
use abbe_thermal::{Bootstrap, Fitted, Hold, Output, Response, SensorLog, Structure, Terms, fit};
use faer::Mat;

/// Systems of each kind.
fn sets() -> u64 {
    std::env::var("ABBE_COVERAGE_SETS").ok().and_then(|sets| sets.parse().ok()).unwrap_or(200)
}

/// What disturbs readings.
#[derive(Debug, Clone, Copy)]
struct Disturbed {
    /// Noise of the output.
    noise: f64,
    /// Part of it that stays from row to row.
    stays: f64,
    /// Noise of the sensors, K.
    sensors: f64,
}

const STEP: f64 = 60.0;
const ROWS: usize = 600;

/// A run: the log as it was read, the output without noise, and as it was read.
struct Run {
    log: SensorLog,
    times: Vec<f64>,
    truth: Vec<f64>,
    readings: Vec<f64>,
}

fn part(random: &mut Generator) -> f64 {
    random.index(1_000_003) as f64 / 1_000_003.0
}

/// Inputs that go to other levels now and then, as the load of a spindle does.
fn run(random: &mut Generator, (constants, gains): (&[f64], &[f64]), disturbed: Disturbed) -> Run {
    let times: Vec<f64> = (0..ROWS).map(|row| STEP * row as f64).collect();
    let (mut truth, mut noisy) = (Vec::new(), Vec::new());
    for sensor in 0..2 {
        let (mut level, mut value) = (0.0, 0.0);
        let values: Vec<f64> = (0..ROWS)
            .map(|row| {
                if row > 0 && part(random) < 0.02 {
                    level = 4.0 * random.normal();
                }
                value += 0.15 * (level - value);
                value
            })
            .collect();
        let read = values.iter().map(|value| value + disturbed.sensors * random.normal()).collect();
        truth.push((format!("T{sensor}"), values));
        noisy.push((format!("T{sensor}"), read));
    }
    let log = |sensors| SensorLog::new(times.clone(), sensors, Hold::FirstOrder, None).expect("a log");
    let (exact, log) = (log(truth), log(noisy));
    let mut truth = vec![0.0; ROWS];
    for sensor in 0..2 {
        for (index, constant) in constants.iter().enumerate() {
            let response = Response::new(&exact, sensor, *constant, &times).expect("a response");
            let gain = gains[sensor * constants.len() + index];
            truth.iter_mut().zip(response.values).for_each(|(value, state)| *value += gain * state);
        }
    }
    let mut noise = 0.0;
    let spread = (1.0 - disturbed.stays * disturbed.stays).sqrt();
    let readings = truth.iter().map(|value| {
        noise = disturbed.stays * noise + spread * disturbed.noise * random.normal();
        value + noise
    });
    Run { log, readings: readings.collect(), times, truth }
}

/// Standard uncertainties of predictions by a covariance of logarithms of time constants and gains.
fn uncertainties(found: &Fitted, terms: &Terms, covariance: &Mat<f64>) -> Vec<f64> {
    let (count, gains) = (found.time_constants.len(), &found.gains[0]);
    (0..terms.columns.nrows())
        .map(|row| {
            let mut derivatives = vec![0.0; count + gains.len()];
            for gain in 0..gains.len() {
                derivatives[count + gain] = terms.columns[(row, gain)];
                derivatives[gain % count] += gains[gain] * terms.slopes[(row, gain)];
            }
            let mut sum = 0.0;
            for (one, by) in derivatives.iter().enumerate() {
                for (other, and) in derivatives.iter().enumerate() {
                    sum += by * covariance[(one, other)] * and;
                }
            }
            sum.max(0.0).sqrt()
        })
        .collect()
}

/// Parts of 95 % intervals that hold what they promise: those of an ordinary fit and of blocks for what is without noise, and those of
/// the scatter of a run that was not seen for the readings of another one.
fn coverage(disturbed: Disturbed) -> [f64; 3] {
    let (mut inside, mut all, mut refused) = ([0_usize; 3], 0_usize, 0);
    for seed in 0..sets() {
        let mut random = Generator::new(seed, 0);
        let constants = [200.0 + 300.0 * part(&mut random), 1500.0 + 2000.0 * part(&mut random)];
        let gains: Vec<f64> = (0..4).map(|_| 2.0 + 6.0 * part(&mut random)).collect();
        let mut make = || run(&mut random, (&constants, &gains), disturbed);
        let (seen, judged, unseen) = (make(), make(), make());
        let outputs = [Output::of_run("drift".to_owned(), seen.times.clone(), seen.readings.clone())];
        let structure =
            Structure { inputs: vec![0, 1], at_once: Vec::new(), time_constants: 2, starts_warm: false, guess: None };
        let logs = std::slice::from_ref(&seen.log);
        // Noise may tell no two time constants.
        let Ok(found) = fit(logs, &outputs, &structure) else {
            refused += 1;
            continue;
        };
        let block = found.time_constants[1].min(STEP * ROWS as f64 / 10.0);
        let drawn = found.bootstrap(logs, &outputs, Bootstrap { draws: 300, block, seed }).expect("draws");
        let rms = {
            let predicted = found.predict(&judged.log, 0, &judged.times).expect("a prediction");
            let off = predicted.iter().zip(&judged.readings).map(|(one, other)| (one - other).powi(2));
            (off.sum::<f64>() / ROWS as f64).sqrt()
        };
        let times: Vec<f64> = (0..20).map(|_| unseen.times[20 + random.index(ROWS - 20)]).collect();
        let terms = Terms::new(&unseen.log, &structure, &found.time_constants, &times).expect("terms");
        let predicted = terms.output(&found.gains[0]);
        let [ordinary, blocks] =
            [&found.covariance, &drawn].map(|covariance| uncertainties(&found, &terms, covariance));
        for (row, time) in times.iter().enumerate() {
            let at = (time / STEP) as usize;
            let off = (predicted[row] - unseen.truth[at]).abs();
            inside[0] += usize::from(off < 1.96 * ordinary[row]);
            inside[1] += usize::from(off < 1.96 * blocks[row]);
            inside[2] += usize::from((predicted[row] - unseen.readings[at]).abs() < 1.96 * rms);
            all += 1;
        }
    }
    assert!(refused * 50 <= sets(), "{refused} fits were refused");
    inside.map(|inside| inside as f64 / all as f64)
}

#[test]
fn intervals_of_predictions_hold_what_they_promise() {
    let white = Disturbed { noise: 1.0, stays: 0.0, sensors: 0.0 };
    let cases = [white, Disturbed { stays: 0.9, ..white }, Disturbed { sensors: 0.3, ..white }];
    let found = cases.map(|case| {
        let found = coverage(case);
        println!(
            "{case:?}: ordinary {:.3}, blocks {:.3}, by a run that was not seen {:.3}",
            found[0], found[1], found[2]
        );
        found
    });
    let [white, staying, noisy_sensors] = found;
    assert!((0.92..0.97).contains(&white[0]) && (0.92..0.97).contains(&white[1]), "{white:?}");
    // Noise that stays: an ordinary fit is far too sure of itself, blocks are nearly right.
    assert!(staying[0] < 0.5 && staying[1] > 0.86, "{staying:?}");
    // Noisy sensors make gains small: neither of both knows that.
    assert!(noisy_sensors[0] < 0.5 && noisy_sensors[1] < 0.8, "{noisy_sensors:?}");
    // What was predicted wrong of another run is right in all of them.
    assert!(found.iter().all(|found| (0.92..0.975).contains(&found[2])), "{found:?}");
}
