//! How time and memory grow with the size of what is read: columns, rows and stages. Figures for people; nothing is judged.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::machines::Report;

/// The recipe that is made larger, with its touches.
const RECIPE: &str = "first-steps";
const TOUCHES: &str = "data/tango-hu40t/realistic/touches.csv";

/// Parts of the largest size that are tried.
const PARTS: [u64; 4] = [8, 4, 2, 1];

/// The recipe and its touches with `columns` more columns, each row `times` times, and `stages` more stages.
fn larger(folder: &Path, columns: u64, times: u64, stages: u64) {
    let pipelines = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../pipelines");
    let read = |file: &str| fs::read_to_string(pipelines.join(file)).expect("a file of the repository");
    let data = format!("{}/data/", pipelines.display());
    let mut recipe = read(&format!("{RECIPE}.yaml")).replace(TOUCHES, "touches.csv").replace("data/", &data);
    (0..stages).for_each(|stage| recipe.push_str(&format!("  more-{stage}: {{ validate: residuals, of: fit }}\n")));
    fs::write(folder.join("recipe.yaml"), recipe).expect("the recipe can be written");
    let touches = read(TOUCHES);
    let mut lines = touches.lines().filter(|line| !line.starts_with('#'));
    let more =
        |cell: &dyn Fn(u64) -> String| (0..columns).map(|column| format!(",{}", cell(column))).collect::<String>();
    let header = format!("{}{}\n", lines.next().expect("a header"), more(&|column| format!("more{column}_mm")));
    let rows: String = lines.map(|line| format!("{line}{}\n", more(&|_| "0".to_owned()))).collect();
    fs::write(folder.join("touches.csv"), header + &rows.repeat(times as usize)).expect("the touches can be written");
}

/// KiB that a process has used at most so far; none where the system does not say.
fn memory(child: &Child) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{}/status", child.id())).ok()?;
    status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.trim().trim_end_matches("kB").trim().parse().ok()
}

/// Seconds and MiB of a command.
pub(crate) fn measured(program: &Path, folder: &Path, command: &str) -> (f64, u64) {
    let start = Instant::now();
    let mut child = Command::new(program)
        .args([command, "recipe.yaml"])
        .current_dir(folder)
        .env("ABBE_CAMPAIGN_PROGRAM", "1")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the program starts");
    let mut most = 0;
    while child.try_wait().expect("the process can be waited for").is_none() {
        most = most.max(memory(&child).unwrap_or(0));
        std::thread::sleep(Duration::from_millis(1));
    }
    (start.elapsed().as_secs_f64(), most >> 10)
}

/// Measures up to `largest` more columns, a fifth as many more stages, and a hundredth of `largest` times as many rows.
pub fn run(program: &Path, largest: u64) -> Report {
    let mut text = String::new();
    let kinds: [(&str, &str, u64); 3] = [
        ("more columns", "run", largest),
        ("more stages", "check", largest / 5),
        ("times as many rows", "run", largest / 100),
    ];
    for (kind, command, most) in kinds {
        for part in PARTS {
            let size = most / part;
            let folder = tempfile::tempdir().expect("a temporary folder");
            match kind {
                "more columns" => larger(folder.path(), size, 1, 0),
                "more stages" => larger(folder.path(), 0, 1, size),
                _ => larger(folder.path(), 0, size.max(1), 0),
            }
            let (seconds, mebibytes) = measured(program, folder.path(), command);
            text.push_str(&format!("{command} with {size} {kind}: {seconds:.2} s, {mebibytes} MiB\n"));
        }
    }
    Report { text, broken: Vec::new() }
}
