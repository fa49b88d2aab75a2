//! Corrected programs for LinuxCNC as its own interpreter reads them, `rs274`.

use std::process::Command;

use abbe_controllers::{Dialect, Options};

use super::linuxcnc::answers;
use crate::controls::law::{Machine, uniform};
use crate::programs::{corrected, grammar, interpreter::Control, worst};
use crate::support::{abbe, read, root, skipped, temporary, write};

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

/// A program with a subprogram, a loop, a branch, variables and canned cycles.
fn with_loops(seed: u64) -> String {
    let mut random = uniform(seed);
    let mut between = |from: f64, to: f64| (from + (to - from) * random()).round();
    let (x, y, step, count) = (between(-120.0, 40.0), between(-120.0, 60.0), between(6.0, 25.0), between(2.0, 5.0));
    let (radius, depth, hole) = (between(4.0, 18.0), between(-20.0, 20.0), between(0.0, count - 1.0));
    format!(
        "(subprogram, loop, branch)\nG21 G90 G17 G54\n#<step> = {step}\n#<_radius> = {radius}\n\
         o200 sub\n  G1 X[#1] Y[#2] Z[{depth}] F300 ; to the circle\n  G2 X[#1 + 2 * #<_radius>] Y[#2] I#<_radius> J0\n\
         \x20 G91 G1 X-3.5 Y[#<_radius> / 3] Z0.25\n  G90\no200 endsub\n\
         G0 X{x} Y{y} Z80\n#10 = 0\no210 while [#10 LT {count}]\n  o200 call [{x} + #10 * #<step>] [{y} + #10 * 3]\n\
         o211 if [#10 EQ {hole}]\n  G81 X[{x} - 5] Y[{y} + 7] Z[{depth} - 4] R[{depth} + 30] F80\n  G80\no211 endif\n\
         \x20 #10 = [#10 + 1]\no210 endwhile\nG18 G3 X[{x} + 10] Z[{depth} + 10] R{}\nG17 G0 Z80\nM2\n",
        radius + 200.0,
    )
}

/// Programs that LinuxCNC's interpreter writes out: the blocks are those that it makes of the program itself, and corrected they hold
/// the law.
#[test]
fn loops_and_subprograms_are_written_out() {
    if !answers("sh", &["-c", "command -v rs274"]) {
        let name = "loops_and_subprograms_are_written_out";
        return skipped(name, "there is no rs274 (Debian: apt-get install linuxcnc-uspace)");
    }
    let public = read(&root().join("tests/programs/public/linuxcnc-o-word.ngc"));
    let programs = (1..=4).map(with_loops).chain([public.clone()]);
    for (seed, text) in programs.enumerate() {
        let machine = Machine::random("three-axis", seed as u64 + 1);
        let folder = temporary();
        let at = folder.path();
        let mut perfect = machine.calibration.clone();
        perfect.parameters.iter_mut().for_each(|parameter| parameter.value = 0.0);
        write(&at.join("errors.calibration.json"), &machine.calibration.to_json().expect("JSON"));
        write(&at.join("perfect.calibration.json"), &perfect.to_json().expect("JSON"));
        write(&at.join("part.ngc"), &text);
        let run = |calibration: &str, out: &str, more: &[&str]| {
            let fixed = ["compensate", calibration, "part.ngc", "--dialect", "linuxcnc", "--out", out];
            abbe(at, &[&fixed[..], &["--write-out", "--start", "X0,Y0,Z0"], more].concat())
        };
        for (calibration, out) in [("perfect.calibration.json", "plain.ngc"), ("errors.calibration.json", "done.ngc")] {
            let found = run(calibration, out, &[]);
            assert_eq!(found.status, 0, "{}\n{text}", found.stderr);
            assert!(found.stdout.contains("comments are lost, positions have 0.1 µm"), "{}", found.stdout);
        }
        let [plain, done] = ["plain.ngc", "done.ngc"].map(|name| read(&at.join(name)));
        let [programmed, corrected] = [&plain, &done].map(|text| Control::new(&machine).run(text));
        let off = worst(&machine, &programmed, &corrected);
        assert!(off <= 1.02e-3, "{seed}: {} µm\n{text}\n{done}", off * 1e3);
        assert!(worst(&machine, &programmed, &programmed) > 5e-3);
        // The same moves as of the program as it was.
        let output = Command::new("rs274").args(["-g", "part.ngc"]).current_dir(at).output().expect("it starts");
        let own = commands(&String::from_utf8_lossy(&output.stdout));
        let lines: Vec<&Vec<f64>> = own.iter().filter(|(_, name)| name != "ARC_FEED").map(|(ends, _)| ends).collect();
        let ends = programmed.iter().filter(|block| !block.is_arc).map(|block| &block.path[block.path.len() - 1]);
        let ends: Vec<_> = ends.collect();
        // A move to where the axes stand already is no block.
        let mut of = lines.iter();
        for end in &ends {
            let is_there =
                |line: &[f64]| ["X", "Y", "Z"].iter().zip(line).all(|(axis, at)| (end[*axis] - at).abs() < 2e-4);
            assert!(of.any(|line| is_there(line)), "{end:?} is none of {lines:?}");
        }
        assert!(ends.len() > 3 && 2 * ends.len() >= lines.len(), "{ends:?} {lines:?}");
        // The file is checked, and what is wrong in it is found with the line of the program.
        let found = run("errors.calibration.json", "done.ngc", &["--check", "--json"]);
        assert_eq!(found.status, 0, "{}", found.stderr);
        let json: serde_json::Value = serde_json::from_str(&found.stdout).expect("JSON");
        let line = json["check"]["path"]["line_of_program"].as_u64().expect("a line") as usize;
        let own = text.lines().nth(line - 1).expect("a line of the program");
        assert!(own.contains('G'), "line {line}: {own}");
    }
    // The points that the public program comes to.
    let machine = Machine::public("three-axis");
    let folder = temporary();
    let at = folder.path();
    let mut perfect = machine.calibration.clone();
    perfect.parameters.iter_mut().for_each(|parameter| parameter.value = 0.0);
    write(&at.join("perfect.calibration.json"), &perfect.to_json().expect("JSON"));
    let correct = |text: &str, more: &[&str]| {
        write(&at.join("part.ngc"), text);
        let _ = std::fs::remove_file(at.join("plain.ngc"));
        let fixed = ["compensate", "perfect.calibration.json", "part.ngc", "--dialect", "linuxcnc", "--write-out"];
        abbe(at, &[&fixed[..], &["--out", "plain.ngc"], more].concat())
    };
    assert_eq!(correct(&public, &["--start", "X0,Y0,Z0"]).status, 0);
    let blocks = Control::new(&machine).run(&read(&at.join("plain.ngc")));
    let ends: Vec<[f64; 2]> = (blocks.iter().filter(|block| !block.is_rapid))
        .map(|block| ["X", "Y"].map(|axis| block.path[block.path.len() - 1][axis]))
        .collect();
    assert_eq!(ends, [[0.0, 10.0], [6.0, 10.0], [20.0, 11.0], [26.0, 11.0], [40.0, 12.0], [46.0, 12.0]]);
    // What the interpreter refuses, and what only a control knows.
    for (text, line, says) in [
        ("G21\nG0 X0 Y0 Z50\nG1 X#5\nM2\n", 3, "zero feed rate"),
        ("G21\nG0 X0 Y0 Z50\no<other> call\nM2\n", 4, "o<other>"),
        ("G21\nG0 X#5061\nM2\n", 2, "#5061"),
        ("G21\nG91\nG0 X5\nM2\n", 3, "--start"),
        ("G21\nG0 Z9\nM62 P1\nM2\n", 3, "SET_"),
        ("G21\nT3 M6\nG43 H3\nG0 Z50\nM2\n", 3, "nobody gave"),
    ] {
        let found = correct(text, &[]);
        assert!(found.status == 1 && found.stderr.contains(says), "{text}: {}", found.stderr);
        assert!(found.stderr.contains(&format!("part.ngc:{line}:")), "{text}: {}", found.stderr);
        assert!(!at.join("plain.ngc").exists(), "{text}");
    }
    let found = correct("G20\nG0 X1\nM2\n", &[]);
    assert!(found.status == 2 && found.stderr.contains("2.54 µm"), "{}", found.stderr);
    let found = correct(&public, &["--tolerance-um", "0.05", "--decimals", "6"]);
    assert!(found.status == 2 && found.stderr.contains("0.1 µm"), "{}", found.stderr);
}

/// A program that runs in circles is ended with Abbe, and nothing of it stays.
#[test]
fn a_signal_ends_the_interpreter_too() {
    if !answers("sh", &["-c", "command -v rs274"]) {
        return skipped(
            "a_signal_ends_the_interpreter_too",
            "there is no rs274 (Debian: apt-get install linuxcnc-uspace)",
        );
    }
    let machine = Machine::public("three-axis");
    let folder = temporary();
    let at = folder.path();
    write(&at.join("errors.calibration.json"), &machine.calibration.to_json().expect("JSON"));
    write(&at.join("part.ngc"), "G21\n#1=0\no1 while [1]\n#1=[#1+1]\no1 endwhile\nM2\n");
    let own = at.join("own");
    std::fs::create_dir(&own).expect("a folder");
    let arguments = ["compensate", "errors.calibration.json", "part.ngc", "--dialect", "linuxcnc", "--write-out"];
    let mut run = crate::support::program(at, &[&arguments[..], &["--out", "done.ngc"]].concat())
        .env("TMPDIR", &own)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .expect("it starts");
    let interpreters = || {
        let processes = std::fs::read_dir("/proc").expect("processes").flatten();
        processes
            .filter(|process| std::fs::read_link(process.path().join("cwd")).is_ok_and(|cwd| cwd.starts_with(&own)))
            .count()
    };
    let wait_for = |what: &str, is_so: &mut dyn FnMut() -> bool| {
        let found = (0..300).any(|_| {
            std::thread::sleep(std::time::Duration::from_millis(100));
            is_so()
        });
        assert!(found, "{what}");
    };
    wait_for("an interpreter", &mut || interpreters() == 1);
    let sent = Command::new("kill").args(["-TERM", &run.id().to_string()]).status().expect("kill is there");
    assert!(sent.success());
    wait_for("an end", &mut || run.try_wait().expect("it can be asked").is_some());
    assert_eq!(run.wait().expect("it has ended").code(), Some(143));
    assert_eq!(interpreters(), 0);
    assert_eq!(std::fs::read_dir(&own).expect("a folder").count(), 0);
    assert!(!at.join("done.ngc").exists());
}
