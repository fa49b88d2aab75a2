//! Random plants: machines that are measured in some weeks, with data, a recipe and a fleet.

use std::fs;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::support::{Printed, Random, program, read, write};

/// A plant.
pub struct Plant {
    pub machines: Vec<String>,
    pub weeks: Vec<usize>,
    pub seed: u64,
    /// Whether the machines stand in a table.
    pub table: bool,
}

/// What every machine is calibrated by, and how that is judged. Campaigns take the file alone.
const RECIPE: &str = concat!(
    include_str!("recipe.yaml"),
    "  judge: { validate: residuals, of: fit, limits: { rms_um: 1 } }\n",
    "  table: { export: error-table, of: fit, step_mm: 100, ranges: { X: { from_mm: -300, to_mm: 300 }, ",
    "Y: { from_mm: -300, to_mm: 300 }, Z: { from_mm: -300, to_mm: 300 } } }\n",
);

impl Plant {
    pub fn random(random: &mut Random) -> Self {
        let machines = (0..1 + random.below(4)).map(|number| format!("m{number:02}")).collect();
        let first = 1 + random.below(50);
        let weeks = (first..first + 1 + random.below(3)).collect();
        Self { machines, weeks, seed: (random.unit() * 1e9) as u64, table: random.unit() < 0.5 }
    }

    /// With so many machines, each measured once.
    pub fn of(machines: usize) -> Self {
        Self {
            machines: (0..machines).map(|number| format!("m{number:05}")).collect(),
            weeks: vec![1],
            seed: 5,
            table: true,
        }
    }

    pub fn recipe(&self) -> &'static str {
        RECIPE
    }

    pub fn jobs(&self) -> usize {
        self.machines.len() * self.weeks.len()
    }

    /// Machines and weeks in the order of the jobs.
    pub fn each(&self) -> Vec<(String, usize)> {
        self.machines.iter().flat_map(|machine| self.weeks.iter().map(|week| (machine.clone(), *week))).collect()
    }

    pub fn write(&self, folder: &Path) {
        write(&folder.join("recipe.yaml"), RECIPE);
        let mut random = Random::new(self.seed);
        for (machine, week) in self.each() {
            write(&folder.join(format!("data/{machine}/w{week}.csv")), &lengths(&mut random));
        }
        let machines = if self.table {
            write(&folder.join("machines.csv"), &("machine,hall\n".to_owned() + &self.machines.join(",a\n") + ",a\n"));
            "{ table: machines.csv }".to_owned()
        } else {
            format!("[{}]", self.machines.join(", "))
        };
        let weeks: Vec<String> = self.weeks.iter().map(usize::to_string).collect();
        let text = format!(
            r#"abbe_fleet: 1
name: A plant
history: plant.sqlite
families:
  weekly:
    recipe: recipe.yaml
    for: {{ machine: {machines}, week: [{}] }}
    set: {{ runs.path: "data/{{machine}}/w{{week}}.csv" }}
    machine: "{{machine}}"
    label: "{{week}}"
    at: "{{week}}"
    unit: week
"#,
            weeks.join(", ")
        );
        write(&folder.join("fleet.yaml"), &text);
    }
}

/// Lengths all over a workspace, of a machine with random errors and some noise.
pub fn lengths(random: &mut Random) -> String {
    let [xx, yy, zz, xy, xz, yz] = std::array::from_fn(|_| 3e-5 * random.normal());
    let mut text = "length,X1_mm,Y1_mm,Z1_mm,X2_mm,Y2_mm,Z2_mm,reference_mm\n".to_owned();
    for row in 0..24 {
        let ends: [f64; 6] = std::array::from_fn(|_| (random.within(-300.0, 300.0) * 1e4).round() / 1e4);
        let moved = |at: &[f64]| {
            [at[0] * (1.0 + xx) + xy * at[1] + xz * at[2], at[1] * (1.0 + yy) + yz * at[2], at[2] * (1.0 + zz)]
        };
        let (one, other) = (moved(&ends[..3]), moved(&ends[3..]));
        let length: f64 = one.iter().zip(&other).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        let cells: Vec<String> = ends.iter().map(f64::to_string).collect();
        text.push_str(&format!("{row},{},{}\n", cells.join(","), length + 1e-3 * random.normal()));
    }
    text
}

/// Starts the program.
pub fn start(at: &Path, arguments: &[&str]) -> Child {
    let mut command = program(at, arguments);
    command.env("COLUMNS", "10000").stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command.spawn().expect("the program starts")
}

/// Waits for a process, which is ended when it takes longer than `most`.
pub fn bounded(mut process: Child, most: Duration) -> Printed {
    let began = Instant::now();
    while process.try_wait().expect("a process").is_none() {
        if began.elapsed() > most {
            let _ = process.kill();
            let _ = process.wait();
            panic!("it takes longer than {most:?}");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let output = process.wait_with_output().expect("its output");
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    Printed { status: output.status.code().unwrap_or(-1), stdout: text(output.stdout), stderr: text(output.stderr) }
}

/// Runs the program to its end.
pub fn quiet(at: &Path, arguments: &[&str]) -> Printed {
    bounded(start(at, arguments), Duration::from_secs(600))
}

pub fn ok(printed: &Printed) {
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
}

/// The lines of a manifest.
pub fn lines(manifest: &Path) -> Vec<Value> {
    read(manifest).lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
}

/// Takes some results away, cuts some off, changes a byte of some.
pub fn sabotaged(store: &Path, random: &mut Random) {
    let files = crate::support::tree(store).into_iter().filter(|name| name.extension() == Some("result".as_ref()));
    for name in files {
        let path = store.join(name);
        let mut content = fs::read(&path).expect("a result");
        match random.below(6) {
            0 => fs::remove_file(&path).expect("it goes"),
            1 => fs::write(&path, &content[..random.below(content.len())]).expect("it is cut off"),
            2 => {
                let place = random.below(content.len());
                content[place] ^= 1 << random.below(8);
                fs::write(&path, content).expect("it is changed");
            }
            _ => {}
        }
    }
}
