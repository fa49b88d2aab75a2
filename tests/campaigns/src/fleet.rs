//! What a fleet costs beside its calibrations, and what a million machines a day need.
//!
//! The first part measures the time of processors for COUNT small machines: by `abbe fleet`, by preparing their recipes in a loop, and
//! by running them in a loop. What a job takes beside running its recipe, which reads the data and estimates, is overhead. The second
//! part simulates a day. Figures for people; the one law is that every job is done.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

use abbe_core::{Monitor, Registry, in_parallel};
use abbe_engine::prepare;

use crate::Random;
use crate::machines::Report;

/// What every machine is calibrated by: as in the tests of fleets, without their validator and exporter.
const RECIPE: &str = include_str!("../../fleet/recipe.yaml");

const FLEET: &str = r#"abbe_fleet: 1
families:
  all:
    recipe: recipe.yaml
    for: { machine: { table: machines.csv } }
    set: { runs.path: "data/{machine}.csv" }
    machine: "{machine}"
    at: 2026-03-02
"#;

/// Twelve lengths between random points.
fn lengths(random: &mut Random) -> String {
    let mut text = "length,X1_mm,Y1_mm,Z1_mm,X2_mm,Y2_mm,Z2_mm,reference_mm\n".to_owned();
    for row in 0..12 {
        let ends: [f64; 6] = std::array::from_fn(|_| (random.within(300.0) * 1e3).round() / 1e3);
        let length = (0..3).map(|axis| (ends[axis] - ends[axis + 3]).powi(2)).sum::<f64>().sqrt();
        let cells: Vec<String> = ends.iter().map(f64::to_string).collect();
        text.push_str(&format!("{row},{},{}\n", cells.join(","), length + random.within(2e-3)));
    }
    text
}

/// Measures `count` machines, then simulates a day.
pub fn run(program: &Path, seed: u64, count: u64) -> Report {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    fs::create_dir(at.join("data")).expect("a folder");
    let mut machines = "machine\n".to_owned();
    for case in 0..count {
        fs::write(at.join(format!("data/{case}.csv")), lengths(&mut Random::new(seed, case))).expect("a file");
        machines.push_str(&format!("{case}\n"));
    }
    for (name, text) in [("machines.csv", machines.as_str()), ("recipe.yaml", RECIPE), ("fleet.yaml", FLEET)] {
        fs::write(at.join(name), text).expect("a file");
    }
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut report = Report { text: String::new(), broken: Vec::new() };
    let a_job = |seconds: f64| 1e3 * seconds / count as f64;
    let told = |what: &str, [clock, processors]: [f64; 2]| {
        format!("{what:<34}{clock:8.2} s  {processors:8.2} s  {:7.3} ms\n", a_job(processors))
    };
    report.text.push_str("                                      clock   processors      a job\n");
    let mut run = f64::NAN;
    for command in [
        &["plan", "fleet.yaml"][..],
        &["run", MANIFEST],
        &["run", MANIFEST],
        &["status", MANIFEST],
        &["merge", MANIFEST],
    ] {
        let (seconds, succeeded) = timed(program, at, command);
        if !succeeded {
            report.broken.push(format!("`abbe fleet {}` failed", command.join(" ")));
        }
        // The first one: in the second all is done already.
        if command[0] == "run" && run.is_nan() {
            run = seconds[1];
        }
        report.text.push_str(&told(&format!("abbe fleet {}", command[0]), seconds));
    }
    let (prepared, all) = alone(at, count, cores);
    report.text.push_str(&told("recipes prepared in one process", prepared));
    report.text.push_str(&told("recipes prepared and run in one", all));
    let work = all[1] - prepared[1];
    report.text.push_str(&format!(
        "a job takes {:.3} ms of a core: {:.3} ms to run its recipe, {:.3} ms to prepare it, {:.3} ms overhead with that\n",
        a_job(run),
        a_job(work),
        a_job(prepared[1]),
        a_job(run - work)
    ));
    let size = |name: &str| size(&at.join(name)) as f64 / count as f64;
    let (result, line, data) = (size("fleet.results"), size(MANIFEST), size("data"));
    report.text.push_str(&format!("bytes a job: result {result:.0}, manifest {line:.0}, data {data:.0}\n\n"));
    report.text.push_str(&day(seed, MILLION, 300.0));
    report
}

const MANIFEST: &str = "fleet.manifest.jsonl";

/// Seconds to prepare all recipes in one process, without files of results; and to prepare and run them.
fn alone(at: &Path, count: u64, cores: usize) -> ([f64; 2], [f64; 2]) {
    let registry = Registry::built_in().expect("the built-in plugins");
    let recipes: Vec<_> = (0..count)
        .map(|case| {
            let path = at.join(format!("alone-{case}.yaml"));
            fs::write(&path, RECIPE.replace("lengths.csv", &format!("data/{case}.csv"))).expect("a file");
            path
        })
        .collect();
    let [prepared, all] = [false, true].map(|runs| {
        let began = Clock::now();
        let done: usize = in_parallel(&recipes, Some(cores), |path| {
            let prepared = prepare(path, &registry).expect("a recipe");
            if runs { prepared.run(&Monitor::default()).map_or(0, |outcome| outcome.fits.len()) } else { 1 }
        })
        .into_iter()
        .sum();
        assert_eq!(done as u64, count);
        began.own()
    });
    recipes.iter().for_each(|path| drop(fs::remove_file(path)));
    (prepared, all)
}

fn timed(program: &Path, at: &Path, arguments: &[&str]) -> ([f64; 2], bool) {
    let began = Clock::now();
    let mut command = Command::new(program);
    command.arg("fleet").args(arguments).current_dir(at).env("ABBE_CAMPAIGN_PROGRAM", "1");
    let status = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status();
    (began.others(), status.is_ok_and(|status| status.success()))
}

/// A clock, and the time that processors have worked.
struct Clock {
    began: Instant,
    processors: [f64; 2],
}

impl Clock {
    fn now() -> Self {
        Self { began: Instant::now(), processors: processors() }
    }

    /// Seconds since then, and those that processors have worked for this process.
    fn own(&self) -> [f64; 2] {
        [self.began.elapsed().as_secs_f64(), processors()[0] - self.processors[0]]
    }

    /// The same for processes that this one has started and that have ended.
    fn others(&self) -> [f64; 2] {
        [self.began.elapsed().as_secs_f64(), processors()[1] - self.processors[1]]
    }
}

/// Seconds that processors have worked for this process, and for those that it has started and that have ended. Linux counts
/// hundredths; other systems are not asked.
pub(crate) fn processors() -> [f64; 2] {
    let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The name of a program may have blanks and brackets. The numbers 14 to 17 are times.
    let after = stat.rsplit_once(") ").map_or("", |(_, after)| after);
    let times: Vec<f64> = after.split_whitespace().skip(11).take(4).filter_map(|number| number.parse().ok()).collect();
    match times.as_slice() {
        [user, system, others, others_system] => [(user + system) / 100.0, (others + others_system) / 100.0],
        _ => [f64::NAN; 2],
    }
}

/// Bytes of a file, or of all files under a folder.
fn size(path: &Path) -> u64 {
    let Ok(found) = path.symlink_metadata() else { return 0 };
    if !found.is_dir() {
        return found.len();
    }
    fs::read_dir(path).into_iter().flatten().flatten().map(|entry| size(&entry.path())).sum()
}

const MILLION: usize = 1_000_000;

/// Seconds of a day.
const DAY: f64 = 86_400.0;

/// How many jobs of one worker end with its death: one of 10,000.
const DEATHS: f64 = 1e-4;

/// How long it takes until a dead worker is replaced, s.
const REPLACED: f64 = 30.0;

/// A day on which machines are measured at the begin of three shifts: how long their results are waited for, by the number of cores.
/// A job takes `job_ms` of a core, from half of it to half as much again.
fn day(seed: u64, machines: usize, job_ms: f64) -> String {
    let mut random = Random::new(seed, u64::MAX);
    let mut arrivals: Vec<f64> = (0..machines)
        .map(|index| {
            let shift = 6.0 + 8.0 * (index % 3) as f64;
            // About an hour after the begin, more or less: the sum of three uniform numbers is nearly normal.
            let spread = random.within(1.0) + random.within(1.0) + random.within(1.0);
            (3600.0 * (shift + 1.0) + 3600.0 * spread / 2.0).rem_euclid(DAY)
        })
        .collect();
    arrivals.sort_by(f64::total_cmp);
    let work = machines as f64 * job_ms / 1e3;
    let least = (work / DAY).ceil().max(1.0);
    let mut text =
        format!("{machines} machines a day, {job_ms} ms of a core each: {:.1} hours of one core\n", work / 3600.0);
    text.push_str("  cores  busy   results are there within (half, 99 %, all)\n");
    for times in [1.0, 2.0, 4.0, 8.0] {
        let cores = (least * times) as usize;
        let waits = waits(&arrivals, cores, job_ms / 1e3, &mut random);
        let at = |part: f64| waits[((waits.len() - 1) as f64 * part) as usize];
        text.push_str(&format!(
            "{cores:7} {:4.0} %  {:9.1} s {:9.1} s {:9.1} s\n",
            100.0 * work / (cores as f64 * DAY),
            at(0.5),
            at(0.99),
            at(1.0)
        ));
    }
    text
}

/// How long each job takes from its arrival to its result, in seconds, the shortest first: whoever comes first is served first.
fn waits(arrivals: &[f64], cores: usize, job_s: f64, random: &mut Random) -> Vec<f64> {
    // Times as whole numbers of microseconds: these have an order.
    let mut free: BinaryHeap<Reverse<u64>> = (0..cores).map(|_| Reverse(0)).collect();
    let mut waits: Vec<f64> = arrivals
        .iter()
        .map(|arrival| {
            let begin = free.pop().map_or(0.0, |Reverse(time)| time as f64 / 1e6).max(*arrival);
            let takes = job_s * (1.0 + random.within(0.5));
            // The job is done again by a new worker.
            let lost = if random.chance(DEATHS) { takes + REPLACED } else { 0.0 };
            let end = begin + takes + lost;
            free.push(Reverse((end * 1e6) as u64));
            end - arrival
        })
        .collect();
    waits.sort_by(f64::total_cmp);
    waits
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waiting_is_what_queues_are() {
        let arrivals: Vec<f64> = (0..20_000).map(|index| f64::from(index) * 0.1).collect();
        let of = |cores| waits(&arrivals, cores, 0.15, &mut Random::new(1, 2));
        // One core cannot keep up: the last job waits for nearly half of all work.
        let one = of(1);
        let work = 20_000.0 * 0.15;
        assert!((one[one.len() - 1] - (work - 2000.0)).abs() < 0.1 * work, "{}", one[one.len() - 1]);
        // Two do, nearly always; with many nobody waits.
        let (two, many) = (of(2), of(100));
        assert!(two[two.len() / 2] < 0.3 && many[many.len() / 2] < 0.16);
        assert!(many[0] >= 0.075 && many[(many.len() as f64 * 0.99) as usize] <= 0.225);
    }
}
