//! One estimate from very many touches that are read in batches: processor time and memory, for people; nothing is judged.
//!
//! The touches on facets of `pipelines/tango-hu40t.yaml` over and over, each moved by half a micrometre of noise, and its fit S3.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;

use crate::Random;
use crate::fleet::processors;
use crate::machines::Report;
use crate::sizes::measured;

/// Noise of a coordinate, mm.
const NOISE: f64 = 5e-4;

/// The recipe of one estimate: its lines up to this one, and the estimate.
const FIRST_ESTIMATE: &str = "  fit-S1:";
const ESTIMATE: &str = "  fit-S3: { estimate: gauss-newton, machine: hu40t, observations: [table, bar], parameters: [\"@S3\", \"table.*\"] }\n";

/// Where the recipe reads its touches, and where it reads them here.
const TOUCHES: &str = "data/tango-hu40t/realistic/touches.csv,";
const IN_BATCHES: &str = "touches.csv, batch_rows: 5000,";

/// Writes the recipe and so many touches.
fn write(folder: &Path, seed: u64, count: u64) {
    let pipelines = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../pipelines");
    let read = |file: &str| fs::read_to_string(pipelines.join(file)).expect("a file of the repository");
    let recipe = read("tango-hu40t.yaml");
    let (head, _) = recipe.split_once(FIRST_ESTIMATE).expect("a recipe with estimates");
    let data = format!("{}/data/", pipelines.display());
    let recipe = head.replace(TOUCHES, IN_BATCHES).replace("data/", &data) + ESTIMATE;
    fs::write(folder.join("recipe.yaml"), recipe).expect("the recipe can be written");
    let touches = read(TOUCHES.trim_end_matches(','));
    let mut lines = touches.lines().filter(|line| !line.starts_with('#'));
    let header = lines.next().expect("a header");
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    // The balls of the bar, which have no normal.
    let rows: Vec<&Vec<&str>> = rows.iter().filter(|row| !["1", "2"].contains(&row[1])).collect();
    let mut file = BufWriter::new(File::create(folder.join("touches.csv")).expect("the touches can be written"));
    writeln!(file, "{header}").expect("the touches can be written");
    let mut random = Random::new(seed, 0);
    for (touch, row) in (1..=count).zip(rows.iter().cycle()) {
        let mut line = format!("{touch},{}", row[1]);
        for coordinate in &row[2..5] {
            let recorded: f64 = coordinate.parse().expect("a coordinate");
            let _ = write!(line, ",{:.4}", recorded + NOISE * random.normal());
        }
        writeln!(file, "{line},{}", row[5..].join(",")).expect("the touches can be written");
    }
    file.flush().expect("the touches can be written");
}

/// Measures an estimate from `count` touches.
pub fn run(program: &Path, seed: u64, count: u64) -> Report {
    let folder = tempfile::tempdir().expect("a temporary folder");
    write(folder.path(), seed, count);
    let before = processors()[1];
    let (seconds, mebibytes) = measured(program, folder.path(), "run");
    let processors = processors()[1] - before;
    let text = format!(
        "{count} touches: {processors:.1} s of processors ({:.2} us a touch), {seconds:.1} s, {mebibytes} MiB\n",
        1e6 * processors / count as f64
    );
    Report { text, broken: Vec::new() }
}
