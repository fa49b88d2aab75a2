//! Corrected programs for LinuxCNC as its own interpreter reads them, `rs274`.

use std::process::Command;

use abbe_controllers::{Dialect, Options};

use super::linuxcnc::answers;
use crate::controls::law::Machine;
use crate::programs::{corrected, grammar, interpreter::Control};
use crate::support::{skipped, temporary, write};

/// The numbers of the canonical commands for motion: the first coordinates, and whether it is an arc.
fn commands(output: &str) -> Vec<(Vec<f64>, String)> {
    let of_line = |line: &str| {
        let name = ["STRAIGHT_TRAVERSE", "STRAIGHT_FEED", "ARC_FEED"]
            .into_iter()
            .find(|name| line.contains(&format!(" {name}(")))?;
        let (_, numbers) = line.split_once('(')?;
        let numbers = numbers.trim_end_matches(')').split(',').map(|number| number.trim().parse().ok());
        Some((numbers.collect::<Option<Vec<f64>>>()?, name.to_owned()))
    };
    output.lines().filter_map(of_line).collect()
}

#[test]
fn linuxcnc_reads_every_corrected_program() {
    if !answers("sh", &["-c", "command -v rs274"]) {
        return skipped(
            "linuxcnc_reads_every_corrected_program",
            "there is no rs274 (Debian: apt-get install linuxcnc-uspace)",
        );
    }
    let mut compared = 0;
    for seed in 1..=8 {
        let (name, rotary): (&str, &[&str]) =
            if seed % 2 == 0 { ("table-table", &["A", "C"]) } else { ("three-axis", &[]) };
        let machine = Machine::random(name, seed);
        let wanted = grammar::Wanted { dialect: Dialect::Linuxcnc, rotary, tip: false, blocks: 40 };
        let text = grammar::program(wanted, 100 + seed);
        let (done, _) =
            corrected(&machine, &text, &Options::new(Dialect::Linuxcnc), 1.0).unwrap_or_else(|error| panic!("{error}"));
        let folder = temporary();
        write(&folder.path().join("part.ngc"), &done);
        write(&folder.path().join("tool.tbl"), "T1 P1 Z10\n");
        let output = Command::new("rs274")
            .args(["-g", "-t", "tool.tbl", "part.ngc"])
            .current_dir(folder.path())
            .output()
            .expect("it starts");
        let said = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.contains("PROGRAM_END"), "{said}\n{done}");
        let (read, own) = (commands(&said), Control::new(&machine).run(&done));
        assert_eq!(read.len(), own.len(), "{done}");
        for ((numbers, name), block) in read.iter().zip(&own) {
            assert_eq!(name == "ARC_FEED", block.is_arc, "line {}", block.line);
            assert_eq!(name == "STRAIGHT_TRAVERSE", block.is_rapid, "line {}", block.line);
            let end = &block.path[block.path.len() - 1];
            if !block.is_arc {
                let off = ["X", "Y", "Z"].iter().zip(numbers).map(|(axis, number)| (end[*axis] - number).abs());
                assert!(off.fold(0.0, f64::max) < 1e-4, "line {}: {numbers:?} and {end:?}", block.line);
                compared += 1;
            }
        }
    }
    assert!(compared > 200, "{compared}");
}
