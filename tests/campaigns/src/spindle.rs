//! Figures of a spindle from very many samples that are read in batches: processor time and memory, for people; nothing is judged.
//!
//! A run at 3000 revolutions a minute, 128 samples a turn, with two radial sensors and an axial one: harmonics, swings that do not come
//! back, and 10 nm of noise; and its error motions with their limits.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;

use crate::Random;
use crate::fleet::processors;
use crate::machines::Report;
use crate::sizes::measured;

const RECIPE: &str = "abbe: 1
name: Many samples of a spindle
stages:
  samples: { ingest: csv, path: samples.csv, batch_rows: 20000 }
  motion:
    estimate: spindle-motion
    from: [samples]
    radial: { r1: { azimuth_deg: 0 }, r2: { azimuth_deg: 90 } }
    axial: z
    speeds_rpm: [3000]
    harmonics: 24
    linear_drift: true
    standard_uncertainty_um: 0.01
  spindle: { validate: spindle, of: [motion], from: [samples], limits: { total_rotating_um: 5 } }
";

/// Samples of a turn, and the time of one, s.
const OF_TURN: u64 = 128;
const TURN: f64 = 0.02;

/// Writes the recipe and so many samples.
fn write(folder: &Path, seed: u64, count: u64) {
    fs::write(folder.join("recipe.yaml"), RECIPE).expect("the recipe can be written");
    let mut file = BufWriter::new(File::create(folder.join("samples.csv")).expect("the samples can be written"));
    writeln!(file, "S_deg,time_s,r1_um,r2_um,z_um").expect("the samples can be written");
    let mut random = Random::new(seed, 0);
    for sample in 0..count {
        let turns = sample as f64 / OF_TURN as f64;
        let angle = turns * std::f64::consts::TAU;
        let mut noise = || 0.01 * random.normal();
        let r1 = 8.0 + 3.0 * angle.cos() + 0.2 * (2.0 * angle).cos() + 0.1 * (0.43 * angle).sin() + noise();
        let r2 = -6.0 + 3.0 * angle.sin() + 0.1 * (3.0 * angle).sin() + 0.1 * (0.43 * angle).cos() + noise();
        let z = 31.0 + 0.3 * (angle + 0.5).cos() + 0.2 * (0.61 * angle).sin() + noise();
        let (degrees, seconds) = (360.0 * turns, TURN * turns);
        writeln!(file, "{degrees:.4},{seconds:.7},{r1:.4},{r2:.4},{z:.4}").expect("the samples can be written");
    }
    file.flush().expect("the samples can be written");
}

/// Measures the figures of `count` samples.
pub fn run(program: &Path, seed: u64, count: u64) -> Report {
    let folder = tempfile::tempdir().expect("a temporary folder");
    write(folder.path(), seed, count);
    let before = processors()[1];
    let (seconds, mebibytes) = measured(program, folder.path(), "run");
    let processors = processors()[1] - before;
    let text = format!(
        "{count} samples: {processors:.1} s of processors ({:.2} us a sample), {seconds:.1} s, {mebibytes} MiB\n",
        1e6 * processors / count as f64
    );
    Report { text, broken: Vec::new() }
}
