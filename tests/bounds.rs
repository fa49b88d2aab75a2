//! Bounds on what the program reads, on what it takes for a number, on its time, and on what it lets a terminal do.

use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::Stdio;
use std::sync::Arc;
use std::time::{Duration, Instant};

use abbe_core::{Monitor, harmless};

use crate::support::{Printed, SMALL, Small, json_file, program, registry};

const RECIPE: &str = "recipe.yaml";

/// Runs the program; fails if it does not end by itself within two minutes.
fn ended(small: &Small, arguments: &[&str]) -> Printed {
    let mut run = program(small.folder.path(), arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let (mut stdout, mut stderr) = (run.stdout.take().expect("its output"), run.stderr.take().expect("its errors"));
    let said = std::thread::spawn(move || {
        let mut text = String::new();
        stdout.read_to_string(&mut text).map(|_| text)
    });
    let started = Instant::now();
    let errors = std::thread::spawn(move || {
        let mut text = String::new();
        stderr.read_to_string(&mut text).map(|_| text)
    });
    let status = loop {
        match run.try_wait().expect("the program can be asked") {
            Some(status) => break status,
            None if started.elapsed() > Duration::from_secs(600) => {
                run.kill().expect("it can be ended");
                panic!("{arguments:?} does not end");
            }
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    let text = |thread: std::thread::JoinHandle<std::io::Result<String>>| {
        thread.join().expect("a reader").expect("the program prints UTF-8")
    };
    Printed { status: status.code().expect("it ends by itself"), stdout: text(said), stderr: text(errors) }
}

/// Refused with this status, these words, and no results.
fn refused(small: &Small, arguments: &[&str], status: i32, words: &[&str]) {
    let printed = ended(small, arguments);
    assert_eq!(printed.status, status, "{arguments:?}: {}{}", printed.stdout, printed.stderr);
    // Messages are broken into lines.
    let said = printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
    for word in words {
        assert!(said.contains(word), "{arguments:?}: {word} is not in {}", printed.stderr);
    }
    assert!(printed.stderr.len() < 4000, "{arguments:?}: {} bytes", printed.stderr.len());
    assert!(!small.path("out/recipe").exists(), "{arguments:?}: there are results");
}

const RUN: [&str; 4] = ["run", RECIPE, "--out", "out"];

#[cfg(unix)]
#[test]
fn pipes_devices_and_folders_are_no_files() {
    let pipe = |path: &Path| {
        assert!(std::process::Command::new("mkfifo").arg(path).status().expect("mkfifo").success());
    };
    let device = |path: &Path| std::os::unix::fs::symlink("/dev/zero", path).expect("a link");
    let folder = |path: &Path| fs::create_dir(path).expect("a folder");
    type Make<'a> = &'a dyn Fn(&Path);
    let kinds: [(&str, Make<'_>); 3] = [("a named pipe", &pipe), ("a device", &device), ("a folder", &folder)];
    let simulate = ["simulate", RECIPE, "--truth", "truth.json", "--seed", "1", "--out", "made"];
    let with_library = ["--plugin", "library.so", "run", RECIPE, "--out", "out"];
    let places: [(&str, &[&str]); 9] = [
        (RECIPE, &RUN),
        (RECIPE, &["check", RECIPE]),
        (RECIPE, &["plan", RECIPE]),
        ("data/machine.yaml", &RUN),
        ("data/touches.csv", &RUN),
        ("data/facets.csv", &RUN),
        ("truth.json", &simulate),
        ("library.so", &with_library),
        ("library.so", &["plugin", "check", "library.so"]),
    ];
    for (name, make) in kinds {
        for (file, arguments) in places {
            let small = Small::new();
            let _ = fs::remove_file(small.path(file));
            make(&small.path(file));
            refused(&small, arguments, 2, &[name, "a file was expected"]);
        }
        // A name without an ending is no chain of axes if there is something of that name.
        for file in ["machine", "machine.yaml"] {
            for arguments in [&["explain", "EXX", "--machine", file][..], &["model", file]] {
                let small = Small::new();
                make(&small.path(file));
                refused(
                    &small,
                    arguments,
                    2,
                    &[&format!("{file}: the file cannot be read: it is {name}; a file was expected")],
                );
            }
        }
    }
}

#[test]
fn calibrations_of_earlier_runs_are_files() {
    let small = Small::new();
    let recipe = SMALL.replace("  rough:\n", "  earlier: { estimate: calibration, path: earlier.json }\n  rough:\n");
    small.write(RECIPE, &recipe);
    fs::create_dir(small.path("earlier.json")).expect("a folder");
    refused(&small, &RUN, 2, &["is a folder"]);
}

#[test]
fn what_is_read_as_a_whole_has_a_bound() {
    let endless = |small: &Small, file: &str, bytes: u64| {
        fs::File::create(small.path(file)).and_then(|file| file.set_len(bytes)).expect("a file with a hole");
    };
    for file in [RECIPE, "data/machine.yaml"] {
        let small = Small::new();
        endless(&small, file, 17 << 20);
        refused(&small, &RUN, 2, &["larger than 16 MiB"]);
    }
    // More than any memory has.
    let small = Small::new();
    endless(&small, "data/touches.csv", 1 << 40);
    refused(&small, &RUN, 1, &["touches.csv", "zero byte"]);
    let small = Small::new();
    small.write("data/touches.csv", &"a".repeat(17 << 20));
    refused(&small, &RUN, 2, &["no line ends within 16 MiB"]);
}

#[test]
fn long_cells_are_refused_and_long_names_are_cut() {
    let small = Small::new();
    let touches = small.read("data/touches.csv");
    let cell = |length: usize| touches.replacen("\n3,", &format!("\n{},", "x".repeat(length)), 1);
    assert_ne!(cell(1), touches);
    small.write("data/touches.csv", &cell(70_000));
    refused(&small, &RUN, 1, &["touches.csv:4:", "a cell has 69 KiB; at most 64 are read"]);
    refused(&small, &["data", "data/touches.csv"], 1, &["touches.csv:4:", "a cell has 69 KiB; at most 64 are read"]);
    // A name of a column is a cell as well.
    small.write("data/touches.csv", &touches.replacen(',', &format!("{},", "x".repeat(70_000)), 1));
    for (command, status) in [(&["data", "data/touches.csv"][..], 1), (&RUN, 2)] {
        refused(&small, command, status, &["touches.csv:1:", "at most 64 are read"]);
    }
    small.write("data/touches.csv", &touches);
    small.write(RECIPE, &SMALL.replace("from: touches", &format!("from: {}", "x".repeat(5_000))));
    refused(&small, &RUN, 2, &["xxx..."]);
    small.write(RECIPE, SMALL);
    let (header, rows) = touches.split_once('\n').expect("a header");
    let long = rows.replacen(',', &format!("{},", "9".repeat(3_000)), 30);
    small.write("data/touches.csv", &format!("{header}\n{long}"));
    refused(&small, &RUN, 1, &["99...`"]);
}

/// Rows that are far too wide, for `abbe data` and for a run: refused with their place, in little memory.
#[cfg(target_os = "linux")]
#[test]
fn rows_of_millions_of_cells_are_refused() {
    const CELLS: usize = 5_000_000;
    let small = Small::new();
    assert_eq!(ended(&small, &RUN).status, 0);
    let touches = small.read("data/touches.csv");
    let header = touches.lines().next().expect("a header");
    let columns = header.split(',').count();
    let cells = |count: usize| "1,".repeat(count);
    let place = format!("touches.csv:{}", touches.lines().count() + 1);
    let expected = |count: usize| format!("the row has {} cells; {columns} were expected", count + 1);
    let limited = |arguments: &[&str]| {
        let run = program(small.folder.path(), arguments);
        let output = std::process::Command::new("sh")
            .args(["-c", "ulimit -v 1500000; exec \"$0\" \"$@\""])
            .arg(run.get_program())
            .args(run.get_args())
            .env("NO_COLOR", "1")
            .env("COLUMNS", "10000")
            .current_dir(small.folder.path())
            .output()
            .expect("a shell");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.code(), said.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" "))
    };
    for count in [CELLS, 200_000, 20_000] {
        small.write("data/touches.csv", &format!("{touches}{}", cells(count)));
        for arguments in [&["data", "data/touches.csv"][..], &RUN] {
            let (status, said) = limited(arguments);
            assert_eq!(status, Some(1), "{arguments:?} {count}: {said}");
            assert!(said.contains(&expected(count)) && said.contains(&place), "{arguments:?} {count}: {said}");
        }
    }
    let names = |count: usize| -> String { (0..count).map(|column| format!("T{column}_degC,")).collect() };
    // Nothing but one such row, as a header and without one.
    for (text, words) in [
        (cells(CELLS), "the row has 5000001 cells; at most 131072 are read"),
        ("a,".repeat(CELLS), "the row has 5000001 cells; at most 131072 are read"),
        ("a;".repeat(CELLS), "a cell has 9766 KiB; at most 64 are read"),
    ] {
        small.write("wide.csv", &text);
        let (status, said) = limited(&["data", "wide.csv"]);
        assert!(matches!(status, Some(1 | 2)), "{status:?} {said}");
        assert!(said.contains(words) && said.contains("wide.csv:"), "{words}: {said}");
    }
    // No room is made for cells that are not read.
    small.write("commas.csv", &",".repeat(60_000_000));
    let (status, said) = limited(&["correct", "out/recipe/fine.calibration.json", "commas.csv"]);
    assert!(matches!(status, Some(1 | 2)) && said.contains("commas.csv:1: the row has 60000001 cells"), "{said}");
    small.write(
        "recipe.fleet.yaml",
        "abbe_fleet: 1\nfamilies:\n  f:\n    recipe: recipe.yaml\n    for: { n: { table: commas.csv } }\n",
    );
    let (status, said) = limited(&["fleet", "plan", "recipe.fleet.yaml"]);
    assert!(status == Some(2) && said.contains("commas.csv:1: this is no table: the row has 60000001 cells"), "{said}");
    // Many columns are a table all the same.
    small.write("wide.csv", &format!("{}last\n{}20\n{}21\n", names(100_000), cells(100_000), cells(100_000)));
    let (status, said) = limited(&["data", "wide.csv"]);
    assert_eq!((status, said.as_str()), (Some(0), ""));
}

/// Each value of a recipe takes room while it is read, however short it is.
#[test]
fn recipes_of_millions_of_values_are_refused() {
    let small = Small::new();
    let recipe = small.read("recipe.yaml");
    for list in ["1,".repeat(300_000), "{ a: 1 },".repeat(130_000)] {
        small.write("recipe.yaml", &format!("{recipe}\nmany: [{list}]\n"));
        let printed = ended(&small, &["check", RECIPE]);
        assert_eq!(printed.status, 2, "{}", printed.stderr);
        assert!(printed.stderr.contains("250000 values stand before this one"), "{}", printed.stderr);
    }
}

#[test]
fn all_line_ends_are_read_and_other_separators_are_named() {
    let values = |small: &Small| {
        assert_eq!(ended(small, &RUN).status, 0);
        json_file(&small.path("out/recipe/fine.calibration.json"))["parameters"].clone()
    };
    let small = Small::new();
    let expected = values(&small);
    let touches = small.read("data/touches.csv");
    for end in ["\r", "\r\n", "\n\n", "\r\r"] {
        small.write("data/touches.csv", &format!("# a comment\n{touches}").replace('\n', end));
        assert_eq!(values(&small), expected, "{end:?}");
    }
    // The place of an error is the same, too.
    for (end, lines) in [("\r", 1), ("\n", 1), ("\r\n", 1), ("\r\r", 2), ("\r\r\n", 2)] {
        let small = Small::new();
        small.write("data/touches.csv", &format!("{touches}1,2\n").replace('\n', end));
        let line = lines * touches.lines().count() + 1;
        refused(&small, &RUN, 1, &["the row has 2 cells", &format!("touches.csv:{line}")]);
    }
    for (separator, name) in [(";", "semicolons"), ("\t", "tabs"), ("|", "vertical strokes"), (" ", "spaces")] {
        let small = Small::new();
        small.write("data/touches.csv", &touches.replace(',', separator));
        refused(&small, &RUN, 2, &[&format!("separated by {name}; a comma was expected"), "touches.csv:1:1"]);
    }
    let small = Small::new();
    let wide: Vec<u8> = [0xff, 0xfe].into_iter().chain(touches.encode_utf16().flat_map(u16::to_le_bytes)).collect();
    fs::write(small.path("data/touches.csv"), wide).expect("it can be written");
    refused(&small, &["check", RECIPE], 1, &["UTF-16; UTF-8 was expected"]);
}

#[test]
fn whole_numbers_say_their_range() {
    let trials = "  trials: { estimate: monte-carlo, of: fine, trials: NUMBER, seed: 1 }\n";
    let adaptive = "  trials: { estimate: monte-carlo, of: fine, adaptive: { most: NUMBER } }\n";
    let plan = "plan: { estimate: fine, candidates: table, number: NUMBER }\n";
    let window = "  repeats: { validate: repeatability, of: fine, rows: table, point: feature, window: NUMBER }\n";
    let cases = [
        (format!("{SMALL}{trials}"), "from 1 to 10000000"),
        (format!("{SMALL}{adaptive}"), "from 1 to 10000000"),
        (format!("{SMALL}{plan}"), "from 1 to 10000"),
        (format!("{SMALL}{window}"), "from 2 to 1000000"),
        (SMALL.replace("degrees: [1]", "degrees: [NUMBER]"), "from 0 to 9"),
        (SMALL.replace("start: rough", "start: rough\n    iterations: NUMBER"), "from 1 to 100000"),
        (SMALL.replace("- { backlash: [EXX] }", "- { backlash: [EXX], degrees: [NUMBER] }"), "from 1 to 9"),
        (SMALL.replace("- { backlash: [EXX] }", "- { fourier: [EBB], orders: [NUMBER] }"), "from 1 to 99"),
    ];
    for (recipe, range) in cases {
        for number in ["1e12", "18446744073709551615", "-1", "1.5", "many"] {
            let small = Small::new();
            small.write(RECIPE, &recipe.replace("NUMBER", number));
            refused(&small, &RUN, 2, &[range, &format!("{RECIPE}:")]);
        }
    }
}

/// What is finished when the time is over is written; the rest has failed.
#[test]
fn the_time_of_a_run_has_a_limit() {
    let small = Small::new();
    small.write(RECIPE, &format!("{SMALL}  trials: {{ estimate: monte-carlo, of: fine, trials: 5e6, seed: 1 }}\n"));
    let printed = ended(&small, &["run", RECIPE, "--out", "out", "--time-limit", "6"]);
    assert_eq!(printed.status, 1, "{}{}", printed.stdout, printed.stderr);
    assert!(printed.stderr.contains("stage `trials`") && printed.stderr.contains("time limit"), "{}", printed.stderr);
    assert!(printed.stdout.contains("trials (estimate): "), "{}", printed.stdout);
    assert!(small.path("out/recipe/fine.calibration.json").is_file());
    let record = json_file(&small.path("out/recipe/run.json"));
    let failed: Vec<&str> = record["failures"]
        .as_array()
        .expect("failures")
        .iter()
        .filter_map(|failure| failure["stage"].as_str())
        .collect();
    assert!(failed.contains(&"trials"), "{failed:?}");

    let small = Small::new();
    for wrong in ["0", "-1", "nan", "1e12", "soon"] {
        let limit = format!("--time-limit={wrong}");
        refused(&small, &["run", RECIPE, "--out", "out", &limit], 2, &["a number of seconds"]);
    }
    // Too little for anything.
    refused(&small, &["run", RECIPE, "--out", "out", "--time-limit", "0.000001"], 1, &["the time limit"]);
    let printed = ended(&small, &["run", RECIPE, "--out", "out", "--json", "--time-limit", "0.000001"]);
    let error: serde_json::Value = serde_json::from_str(&printed.stdout).expect("one error as JSON");
    assert!(error["error"]["message"].as_str().is_some_and(|message| message.contains("time limit")), "{error}");
}

/// Each command says what is not there when its time is over: a check has no results, and a plan is no run.
#[test]
fn what_is_missing_when_the_time_is_over_is_that_of_the_command() {
    let small = Small::new();
    small.write("truth.json", "{}");
    small.write("plan.yaml", &format!("{SMALL}plan: {{ estimate: fine, candidates: table, number: 40 }}\n"));
    let limit = "--time-limit=0.000001";
    let simulate = ["simulate", RECIPE, "--truth", "truth.json", "--seed", "1", "--out", "out", limit];
    for (arguments, what) in [
        (&["check", RECIPE, limit][..], "the check is not at its end"),
        (&["plan", "plan.yaml", "--out", "out", limit], "there is no plan yet: nothing is printed or written"),
        (&simulate, "the measurements are not simulated: nothing is written"),
    ] {
        refused(&small, arguments, 1, &[&format!("the time limit of 0.000001 s is over, and {what}")]);
        let said = ended(&small, arguments).stderr;
        assert!(!said.contains("results") && !said.contains("run"), "{arguments:?}: {said}");
        assert!(!small.path("out").exists(), "{arguments:?}");
    }
}

/// Escape sequences of terminals, 8-bit ones and reversed text.
const EVIL: &str = "\u{1b}[2J\u{9b}31m\u{202e}\u{7}";

/// A time limit that ends when all estimates are there costs no page and no residuals.
#[test]
fn what_is_made_of_results_that_are_there_has_no_time_limit() {
    let small = Small::new();
    let prepared = abbe_engine::prepare(&small.path(RECIPE), &registry()).expect("a recipe");
    let mut outcome = prepared.run(&Monitor::default()).expect("a run");
    for fit in &mut outcome.fits {
        let late = fit.problem.monitor.clone().with_time_limit(Duration::ZERO);
        fit.problem = Arc::new(fit.problem.watched_by(late));
        assert!(fit.problem.residuals(&fit.problem.start()).is_err(), "the time is over");
    }
    assert!(abbe::attach_report(&mut outcome).is_some());
    let names: Vec<String> = outcome.attached.iter().map(|(name, _)| name.display().to_string()).collect();
    assert_eq!(names, ["rough.residuals.csv", "fine.residuals.csv", "report.html"]);
}

#[test]
fn no_text_from_files_reaches_a_terminal_as_it_is() {
    let shown = |small: &Small, arguments: &[&str]| {
        let printed = ended(small, arguments);
        for text in [&printed.stdout, &printed.stderr] {
            assert_eq!(harmless(text), *text, "{arguments:?}");
        }
        printed
    };
    let yaml = "\\e[2J\\x9b31m\\u202e\\a";
    let named = SMALL.replace("name: Eight facets", &format!("name: \"Eight {yaml} facets\""));
    let small = Small::new();
    small.write(RECIPE, &named);
    for arguments in
        [&RUN[..], &["check", RECIPE], &["run", RECIPE, "--out", "out", "--json"], &["check", RECIPE, "--json"]]
    {
        let printed = shown(&small, arguments);
        assert_eq!(printed.status, 0, "{arguments:?}: {}", printed.stderr);
        match arguments.contains(&"--json") {
            true => drop(serde_json::from_str::<serde_json::Value>(&printed.stdout).expect("JSON")),
            false => assert!(printed.stdout.contains("␛[2J"), "{}", printed.stdout),
        }
    }
    // In wrong settings, headers, labels, cells, and in the lines that a message shows.
    let wrong_setting = named.replace("standard_uncertainty_um: 1.6", &format!("\"standard{yaml}\": 1.6"));
    small.write(RECIPE, &wrong_setting);
    assert_eq!(shown(&small, &RUN).status, 2);
    small.write(RECIPE, SMALL);
    let touches = small.read("data/touches.csv");
    let changed = [
        (touches.replacen("X_mm", &format!("{EVIL}_mm"), 1), 2),
        (touches.replacen("\n", &format!("\n# {EVIL}\n1,2 {EVIL}\n"), 1), 1),
    ];
    for (text, status) in changed {
        small.write("data/touches.csv", &text);
        let printed = shown(&small, &RUN);
        assert_eq!(printed.status, status, "{}", printed.stderr);
        assert!(printed.stderr.contains("␛[2J"), "{}", printed.stderr);
        let printed = shown(&small, &["run", RECIPE, "--out", "out", "--json"]);
        let error: serde_json::Value = serde_json::from_str(&printed.stdout).expect("an error as JSON");
        assert!(error["error"]["message"].is_string(), "{error}");
    }
}

/// Names of files come among the arguments by `*`; what is said of options that nobody knows has them.
#[test]
fn no_argument_reaches_a_terminal_as_it_is() {
    let small = Small::new();
    let evil = format!("--no{EVIL}");
    let value = format!("--time-limit={EVIL}");
    let cases: [&[&str]; 9] = [
        &["run", &evil],
        &["data", &evil],
        &["run", RECIPE, "--json", &evil],
        &["run", RECIPE, &value],
        &["run", RECIPE, "--progress", EVIL],
        &["history", EVIL],
        &["history", "list", &evil],
        &["new", &evil],
        &[EVIL],
    ];
    for arguments in cases {
        let printed = ended(&small, arguments);
        assert_eq!(printed.status, 2, "{arguments:?}: {}", printed.stderr);
        assert!(printed.stdout.is_empty() && printed.stderr.starts_with("error: "), "{arguments:?}: {printed:?}");
        assert_eq!(harmless(&printed.stderr), printed.stderr, "{arguments:?}");
        assert!(printed.stderr.contains("␛[2J"), "{arguments:?}: {}", printed.stderr);
    }
    let long = format!("--{}", "x".repeat(5_000));
    assert!(ended(&small, &["run", &long]).stderr.len() < 2_000);
    // Help is no error.
    for (arguments, word) in [(&["--help"][..], "Usage:"), (&["run", "--help"], "Usage:"), (&["--version"], "abbe ")] {
        let printed = ended(&small, arguments);
        assert!(printed.status == 0 && printed.stdout.contains(word) && printed.stderr.is_empty(), "{arguments:?}");
    }
}

/// Nobody reads what is said: the status and the results are there all the same.
#[cfg(target_os = "linux")]
#[test]
fn what_cannot_be_said_ends_nothing() {
    let small = Small::new();
    // Rows that are there twice are told before the end.
    let touches = small.read("data/touches.csv");
    let line = touches.lines().nth(3).expect("a row");
    small.write("data/touches.csv", &format!("{touches}{line}\n"));
    for (arguments, status) in [(&RUN[..], 0), (&["run", "no-such.yaml"], 2)] {
        let full = fs::OpenOptions::new().write(true).open("/dev/full").expect("a full disk");
        let mut run = program(small.folder.path(), arguments);
        let ended = run.stdin(Stdio::null()).stdout(Stdio::null()).stderr(full).status().expect("the program starts");
        assert_eq!(ended.code(), Some(status), "{arguments:?}");
    }
    assert!(small.path("out/recipe/run.json").is_file());
    // What is asked for and cannot be printed is an error, help too.
    for arguments in [&["--help"][..], &["--version"], &["run", "--help"], &["plugins"]] {
        let full = fs::OpenOptions::new().write(true).open("/dev/full").expect("a full disk");
        let mut asked = program(small.folder.path(), arguments);
        let ended = asked.stdin(Stdio::null()).stderr(Stdio::null()).stdout(full).status().expect("the program starts");
        assert_eq!(ended.code(), Some(1), "{arguments:?}");
    }
}

#[cfg(unix)]
#[test]
fn links_that_lead_nowhere_are_told() {
    let small = Small::new();
    std::os::unix::fs::symlink("nowhere", small.path("data/touches-2.csv")).expect("a link");
    small.write(RECIPE, &SMALL.replace("data/touches.csv", "data/touches*.csv"));
    refused(&small, &RUN, 2, &["touches-2.csv"]);
}

#[test]
fn temperatures_are_those_of_a_workshop() {
    let small = Small::new();
    let lengths = small.read("data/lengths.csv");
    for (temperature, status) in [("20.5", 0), ("-300.0", 1), ("293.15", 1)] {
        let rows = lengths.lines().enumerate().map(|(index, line)| match index {
            0 => format!("{line},T_degC\n"),
            _ => format!("{line},{temperature}\n"),
        });
        small.write("data/lengths.csv", &rows.collect::<String>());
        let printed = ended(&small, &RUN);
        assert_eq!(printed.status, status, "{}", printed.stderr);
        assert_eq!(printed.stderr.contains("a temperature from -100 to 200 °C was expected"), status == 1);
    }
}

/// Columns of labels: 30,000 of them take seconds, and not minutes.
#[test]
fn many_columns_of_labels_take_no_time_of_their_own() {
    let small = Small::new();
    const COLUMNS: usize = 30_000;
    let mut rows = small.read("data/touches.csv").lines().map(str::to_owned).collect::<Vec<_>>();
    rows[0].extend((0..COLUMNS).map(|column| format!(",label{column}")));
    rows[1..].iter_mut().for_each(|row| row.push_str(&",a".repeat(COLUMNS)));
    // Two files: what is the same in both is compared.
    let (head, all) = rows.split_first().expect("a header");
    let (one, other) = all.split_at(all.len() / 2);
    for (name, part) in [("a", one), ("b", other)] {
        small.write(&format!("data/touches-{name}.csv"), &format!("{head}\n{}\n", part.join("\n")));
    }
    let recipe = small.read("recipe.yaml").replace("data/touches.csv", "data/touches-?.csv");
    small.write("recipe.yaml", &recipe);
    let printed = ended(&small, &["run", RECIPE, "--time-limit", "60"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
}

/// A chain of 50,000 sets, each of which names the next one; and the same with a circle at its end.
#[test]
fn a_long_chain_of_sets_ends() {
    const SETS: usize = 50_000;
    let small = Small::new();
    let recipe = small.read(RECIPE);
    let with = |last: &str| {
        let chain = (0..SETS).map(|set| format!("  s{set}: [\"@s{}\"]\n", set + 1)).collect::<String>();
        let text = recipe.replacen("sets:\n", &format!("sets:\n{chain}  s{SETS}: [{last}]\n"), 1);
        let used = text.replacen("parameters: [", "parameters: [\"@s0\", ", 1);
        assert!(text != recipe && used != text);
        small.write(RECIPE, &used);
        ended(&small, &["check", RECIPE])
    };
    assert_eq!(with("dxt").status, 0);
    let circle = with("\"@s0\"");
    assert_eq!(circle.status, 2);
    assert!(circle.stderr.contains("in a circle: s0 -> s1"), "{}", &circle.stderr[..200]);
}

/// Where the system gives no more threads than that which waits for signals, the work is done without them, and finds the same. Where it
/// gives none at all, that is said.
#[cfg(target_os = "linux")]
#[test]
fn without_more_threads_the_results_are_the_same() {
    let small = Small::new();
    let trials = "  trials: { estimate: monte-carlo, of: fine, trials: 2000, seed: 1 }\n  judge:";
    small.write(RECIPE, &small.read(RECIPE).replace("  judge:", trials));
    let run = |out: &str, memory_kib: &str, stack: u64| {
        let limited = "ulimit -v \"$0\" && exec \"$@\"";
        let mut command = std::process::Command::new("sh");
        command.args(["-c", limited, memory_kib, env!("CARGO_BIN_EXE_abbe-under-test"), "run", RECIPE, "--out", out]);
        // Each thread asks for room of this size for its stack.
        command.current_dir(small.folder.path()).env("NO_COLOR", "1").env("RUST_MIN_STACK", stack.to_string());
        crate::support::printed(&mut command)
    };
    let read = |out: &str| {
        let read = |name: &str| small.read(&format!("{out}/recipe/{name}"));
        [read("fine.calibration.json"), read("trials.calibration.json"), read("verdicts.json")]
    };
    let usual = run("usual", "unlimited", 2 << 20);
    assert_eq!(usual.status, 0, "{}", usual.stderr);
    // Room for one stack, and not for two.
    let one = run("one", "4194304", 2500 << 20);
    assert_eq!(one.status, 0, "{}", one.stderr);
    assert_eq!(read("one"), read("usual"));
    let none = run("none", "4194304", 5000 << 20);
    assert!(none.status == 1 && none.stderr.contains("signals cannot be handled"), "{}", none.stderr);
    assert!(!none.stderr.contains("panicked") && !small.path("none").exists(), "{}", none.stderr);
}

/// A recipe whose lines end in CR alone is a recipe for those who show machines, too.
#[test]
fn a_recipe_with_old_line_ends_shows_its_machine() {
    let small = Small::new();
    let shown = |text: &str| {
        small.write("recipe.yaml", text);
        small.abbe(&["model", "recipe.yaml"])
    };
    let (usual, old) = (shown(SMALL), shown(&SMALL.replace('\n', "\r")));
    assert_eq!((old.status, &old.stdout), (0, &usual.stdout), "{}", old.stderr);
}
