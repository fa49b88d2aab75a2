//! Two merges at once, and manifests with more lines than they have jobs.

use std::fs;
use std::path::Path;
use std::time::Duration;

use super::plant::{Plant, bounded, ok, quiet, start};
use super::{merged, reference, same};
use crate::support::{read, temporary, write};

/// How long a merge may take.
const MOST: Duration = Duration::from_secs(600);

fn planned(folder: &Path, plant: &Plant) {
    plant.write(folder);
    ok(&quiet(folder, &["fleet", "plan", "fleet.yaml"]));
    ok(&quiet(folder, &["fleet", "run", "fleet.manifest.jsonl", "--workers", "2"]));
}

/// Both find no history and no tables: one waits for the other, and the results are those of one.
#[test]
fn two_merges_at_once_leave_what_one_does() {
    let plant = Plant { weeks: (1..=3).collect(), ..Plant::of(4) };
    let expected = reference(&plant);
    let folder = temporary();
    let at = folder.path();
    planned(at, &plant);
    for round in 0..3 {
        let _ = fs::remove_file(at.join("plant.sqlite"));
        let _ = fs::remove_dir_all(at.join("fleet.merged"));
        let merge = ["fleet", "merge", "fleet.manifest.jsonl", "--calibrations"];
        let both: Vec<_> = (0..2).map(|_| start(at, &merge)).collect();
        let mut entries = Vec::new();
        for process in both {
            let printed = bounded(process, MOST);
            ok(&printed);
            entries.push(printed.stdout.contains(&format!(", {} new entries", plant.jobs())));
        }
        entries.sort_unstable();
        assert_eq!(entries, [false, true], "round {round}");
        same(&super::contents(at), &expected, "merged twice at once");
    }
    same(&merged(at), &expected, "merged again");
}

/// Two fleets with one history that is not there yet: it has the entries of both.
#[test]
fn two_fleets_with_one_history_are_merged_at_once() {
    let folder = temporary();
    let at = folder.path();
    let plants = [Plant::of(3), Plant { seed: 6, ..Plant::of(4) }];
    for (number, plant) in plants.iter().enumerate() {
        let own = at.join(number.to_string());
        plant.write(&own);
        let fleet = read(&own.join("fleet.yaml"));
        write(&own.join("fleet.yaml"), &fleet.replace("history: plant.sqlite", "history: ../plant.sqlite"));
        ok(&quiet(&own, &["fleet", "plan", "fleet.yaml"]));
        ok(&quiet(&own, &["fleet", "run", "fleet.manifest.jsonl", "--workers", "2"]));
    }
    let both: Vec<_> = ["0", "1"].map(|own| start(&at.join(own), &["fleet", "merge", "fleet.manifest.jsonl"])).into();
    both.into_iter().for_each(|process| ok(&bounded(process, MOST)));
    let listed = quiet(at, &["history", "list", "plant.sqlite"]);
    ok(&listed);
    for (machine, count) in [("m00000", 2), ("m00002", 2), ("m00003", 1)] {
        assert!(listed.stdout.contains(&format!("{machine}: {count} calibration")), "{}", listed.stdout);
    }
}

#[test]
fn lines_behind_the_last_job_are_told() {
    let folder = temporary();
    let at = folder.path();
    planned(at, &Plant::of(3));
    let manifest = at.join("fleet.manifest.jsonl");
    let text = read(&manifest);
    let last = text.lines().last().expect("a line");
    let commands: [&[&str]; 4] = [&["status"], &["run"], &["merge"], &["job", "--index", "2"]];
    let all = |command: &[&str]| {
        let mut arguments = vec!["fleet", command[0], "fleet.manifest.jsonl"];
        arguments.extend(&command[1..]);
        quiet(at, &arguments)
    };
    for (more, line) in [(format!("{last}\n"), 5), (format!("\n \n{last}"), 7), ("a note\n".to_owned(), 5)] {
        write(&manifest, &format!("{text}{more}"));
        for command in commands {
            let printed = all(command);
            let said = printed.stderr.replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ");
            assert_eq!(printed.status, 1, "{command:?}: {}{said}", printed.stdout);
            assert!(said.contains(&format!("fleet.manifest.jsonl:{line}")), "{command:?}: {said}");
            assert!(said.contains("behind the last of the 3 jobs") && said.contains("plan the fleet again"), "{said}");
        }
    }
    // Empty lines are nothing.
    write(&manifest, &format!("{text}\n \n"));
    commands.iter().for_each(|command| ok(&all(command)));
}
