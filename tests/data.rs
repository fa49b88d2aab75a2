//! `abbe data`: what is told of files, and that what it proposes reads them.

use std::fs;

use serde_json::{Value, json};

use crate::support::{Variant, abbe, read, recipes, root, temporary, write};

#[test]
fn a_plain_file_is_understood_as_it_is() {
    let folder = temporary();
    write(
        &folder.path().join("t.csv"),
        "feature,X_mm,B_deg,time_s\n1,1.5,90,0\n2,2.5,45,1\n2,2.5,45,40\n3,4,45,41\n4,5,45,42\n",
    );
    let printed = abbe(folder.path(), &["data", "t.csv"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    assert!(printed.stdout.contains("reads this file as it is: 5 rows"), "{}", printed.stdout);
    assert!(printed.stdout.contains("time_s jumps (its usual step is 1): by 39 at line 4"), "{}", printed.stdout);
    insta::assert_snapshot!(printed.stdout);
}

/// Columns that count by chance are compared; a number of rows in front, without a unit, is not.
#[test]
fn rows_are_there_twice_only_if_they_are() {
    for (text, twice) in [
        ("X_mm,Y_mm\n1,2\n2,3\n3,4\n", false),
        ("X_mm,err_um\n0,0.0\n1,0.0\n2,0.1\n", false),
        ("P,X_mm\n1,2.5\n2,3.5\n3,4.5\n", false),
        ("P,X_mm\n1,2.5\n2,3.5\n3,2.5\n", true),
    ] {
        let folder = temporary();
        write(&folder.path().join("t.csv"), text);
        let printed = abbe(folder.path(), &["data", "t.csv"]);
        assert_eq!(printed.stdout.contains("there twice: lines"), twice, "{text}{}", printed.stdout);
    }
}

/// A German file with titles, units, marks and rows that are there twice: what is proposed reads it, once names are given.
#[test]
fn what_is_proposed_for_a_spreadsheet_reads_it() {
    let folder = temporary();
    let mut text = "Prüfung 12;;;\nHalle 3;;;\nPunkt;Länge X;Winkel;Notiz\n;[mm];[°];\n".to_owned();
    for row in 0..6 {
        let x = if row == 2 { "---".to_owned() } else { format!("1.{row}34,5") };
        text.push_str(&format!("{};{x};{row},25;gut\n", row + 1));
    }
    text.push_str("7;1.534,5;5,25;gut\n");
    let bytes: Vec<u8> = text.chars().map(|character| u8::try_from(u32::from(character)).expect("Latin-1")).collect();
    fs::write(folder.path().join("messung.csv"), bytes).expect("a file");
    let printed = abbe(folder.path(), &["data", "messung.csv"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    insta::assert_snapshot!(printed.stdout);
    // No unit is proposed.
    assert!(
        printed.stdout.contains("NAME_UNIT: \"Länge X\"") && !printed.stdout.contains("X_mm"),
        "{}",
        printed.stdout
    );
    let start = printed.stdout.find("  ingest: csv").expect("settings");
    let settings: String = printed.stdout[start..]
        .lines()
        .take_while(|line| !line.trim_start().starts_with('?'))
        .fold(String::new(), |text, line| text + "  " + line + "\n");
    let settings = settings
        .replace("NAME_UNIT: \"Punkt\"", "feature: \"Punkt\"")
        .replace("NAME_UNIT: \"Länge X\"", "X_mm: \"Länge X\"")
        .replace("NAME_UNIT: \"Winkel\"", "B_deg: \"Winkel\"")
        .replace("NAME: \"Notiz\"", "note: \"Notiz\"");
    let recipe = format!("abbe: 1\nname: t\nstages:\n  points:\n{settings}");
    write(&folder.path().join("r.yaml"), &recipe);
    let printed = abbe(folder.path(), &["data", "r.yaml"]);
    assert_eq!(printed.status, 0, "{recipe}\n{}", printed.stderr);
    assert!(printed.stdout.contains("points (ingest: csv): 6 rows"), "{}", printed.stdout);
    assert!(printed.stdout.contains("1 of 7 rows is left out"), "{}", printed.stdout);
}

fn told(text: &str) -> String {
    let folder = temporary();
    write(&folder.path().join("t.csv"), text);
    let printed = abbe(folder.path(), &["data", "t.csv"]);
    assert_eq!(printed.status, 0, "{text}{}", printed.stderr);
    printed.stdout
}

#[test]
fn a_comma_in_a_quoted_number_is_a_thousand_and_what_is_open_is_asked() {
    let american = told("load_N,X_mm\n\"1,234\",1.5\n\"3,456\",2.5\n");
    assert!(american.contains("thousands: comma") && !american.contains("  decimal: comma"), "{american}");
    assert!(american.contains("? every number with a comma is like `1,234`"), "{american}");
    // With decimals there is nothing to ask.
    let sure = told("load_N,X_mm\n\"1,234.5\",1.5\n\"3,456\",2.5\n");
    assert!(sure.contains("thousands: comma") && !sure.contains("  ? "), "{sure}");
    let german = told("X_mm;Y_mm\n\"1,5\";2\n\"2,25\";3\n");
    assert!(german.contains("decimal: comma") && !german.contains("  ? "), "{german}");
    for (text, is_open) in [
        ("X_mm;Y_mm\n1.234;2\n3.456;4\n", true),
        ("X_mm\tY_mm\n-1.234\t2\n3.456\t4\n", true),
        ("X_mm;Y_mm\n0.234;2\n3.456;4\n", false),
        ("X_mm;Y_mm\n1.234;2\n3.45;4\n", false),
        ("X_mm,Y_mm\n1.234,2\n3.456,4\n", false),
    ] {
        let told = told(text);
        assert_eq!(told.contains("? every number with a point is like"), is_open, "{text}{told}");
    }
}

#[test]
fn sums_at_the_end_are_named_with_the_setting_that_leaves_them_out() {
    let text = "Punkt;X_mm\nP1;1,5\nP2;2,5\nP3;3,5\nSumme;7,5\nMittelwert:;2,5\n";
    let found = told(text);
    assert!(found.contains("line 5 (`Summe`), line 6 (`Mittelwert:`) seems to hold sums or means"), "{found}");
    assert!(found.contains("`ignore: { NAME: [\"Summe\", \"Mittelwert:\"] }`"), "{found}");
    let folder = temporary();
    write(&folder.path().join("t.csv"), text);
    write(
        &folder.path().join("r.yaml"),
        "abbe: 1\nname: t\nstages:\n  points:\n    ingest: csv\n    path: t.csv\n    separator: semicolon\n    decimal: comma\n    ignore: { Punkt: [\"Summe\", \"Mittelwert:\"] }\n",
    );
    let printed = abbe(folder.path(), &["data", "r.yaml"]);
    assert!(printed.stdout.contains("points (ingest: csv): 3 rows"), "{}{}", printed.stdout, printed.stderr);
    let found = told("X_mm,Y_mm\n1,2\n2,3\n3,4\nTotal,9\n");
    assert!(found.contains("`no_data: [\"Total\"]` leaves it out"), "{found}");
    // A point may have any name in the middle.
    assert!(!told("P,X_mm\nmin,1\nmax,2\nb,3\n").contains("sums or means"));
}

#[test]
fn the_time_of_rows_alone_is_judged_and_other_times_are_named() {
    let found =
        told("time_s,cutting_min,Zeit,X_mm\n1,5,10:20:30,3\n2,6,10:20:31,4\n3,1,10:20:32,4.5\n4,2,10:20:33,4.5\n");
    assert!(!found.contains("goes back"), "{found}");
    for name in ["cutting_min", "Zeit"] {
        assert!(found.contains(&format!("Not looked at: order and steps of `{name}`")), "{found}");
    }
    let found = told("time_min,X_mm\n1,3\n2,4\n3,4.5\n1,4.5\n");
    assert!(found.contains("time_min goes back") && !found.contains("Not looked at"), "{found}");
    let printed = abbe(&root(), &["data", "pipelines/tool-check.yaml"]);
    assert!(!printed.stdout.contains("cutting_min goes back"), "{}", printed.stdout);
}

#[test]
fn what_no_setting_cures_says_what_to_do() {
    let found = told("a,b,a\n1.5,2,3\n4.5,5\n1,2,4\n");
    assert!(found.contains("no setting mends that, and a run refuses it: correct the file"), "{found}");
    assert!(found.contains("several columns are named `a`") && found.contains("  header: false"), "{found}");
    assert!(told("X_mm,Y_mm 1,2 3,4").contains("the file is one line"));
    // What is proposed for columns of one name reads them.
    let folder = temporary();
    write(&folder.path().join("t.csv"), "a,b,a\n1.5,2,3\n4.5,5,6\n");
    write(
        &folder.path().join("r.yaml"),
        "abbe: 1\nname: t\nstages:\n  points: { ingest: csv, path: t.csv, skip_lines: 1, header: false, columns: { X_mm: 1, Y_mm: 3 } }\n",
    );
    let printed = abbe(folder.path(), &["data", "r.yaml"]);
    assert!(printed.stdout.contains("points (ingest: csv): 2 rows"), "{}{}", printed.stdout, printed.stderr);
}

/// What columns are used as is told for every column that a stage needs or names.
#[test]
fn no_column_that_a_stage_needs_is_without_its_use() {
    for (recipe, column, used) in [
        ("mill-warming", "feature", "needed by `cubes`"),
        ("mill-warming", "time_s", "time"),
        ("mill-warming", "file", "the name of the file"),
        ("tool-check", "tool", "needed by `"),
        ("spindle-motion", "r1_um", "needed by `"),
        ("tango-warming", "reference_mm", "needed by `"),
    ] {
        let printed = abbe(&root(), &["data", recipes()[recipe].to_str().expect("UTF-8")]);
        let mut lines = printed.stdout.lines();
        let line = lines.find(|line| line.trim_start().starts_with(&format!("{column} "))).unwrap_or_default();
        assert!(line.contains(used), "{recipe}: {line}");
    }
}

#[test]
fn numbers_of_things_agree_with_their_words() {
    let folder = temporary();
    write(&folder.path().join("t.csv"), "# a comment\nX_mm,Y_mm\n1.5,2\n");
    write(&folder.path().join("r.yaml"), "abbe: 1\nname: t\nstages:\n  points: { ingest: csv, path: t.csv }\n");
    let found = abbe(folder.path(), &["data", "t.csv"]).stdout + &abbe(folder.path(), &["data", "r.yaml"]).stdout;
    for words in ["1 rows", "1 lines", "(lines 3 to 3)"] {
        assert!(!found.contains(words), "{words}: {found}");
    }
    // Nothing is estimated here, so that nothing was judged.
    let printed = abbe(folder.path(), &["check", "r.yaml"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    assert!(printed.stdout.starts_with("t: 1 stage\nNOTHING JUDGED: nothing is estimated"), "{}", printed.stdout);
    assert!(!printed.stdout.contains("PASS"), "{}", printed.stdout);
}

/// Lines fit 80 columns, but for words that are longer, and for settings, which are to be copied.
#[test]
fn lines_fit_a_terminal() {
    let all = recipes();
    let of = |name: &str| all[name].to_str().expect("UTF-8").to_owned();
    let mut commands: Vec<Vec<String>> = Vec::new();
    for name in ["robot-ur5", "tango-warming", "first-steps", "positioner"] {
        commands.push(vec!["check".to_owned(), of(name)]);
        commands.push(vec!["check".to_owned(), "--explain".to_owned(), of(name)]);
        commands.push(vec!["model".to_owned(), of(name)]);
        commands.push(vec!["data".to_owned(), of(name)]);
    }
    commands.push(vec!["model".to_owned(), "w C' A' b X Y Z (S) t".to_owned()]);
    commands.push(vec!["data".to_owned(), "pipelines/data/tango-warming/touches.csv".to_owned()]);
    for command in commands {
        let printed = crate::support::narrow(&root(), &command);
        assert_eq!(printed.status, 0, "{command:?}: {}", printed.stderr);
        for line in printed.stdout.lines() {
            let is_one_word = line.split_whitespace().count() <= 1;
            assert!(line.chars().count() <= 80 || is_one_word, "{command:?}: {line}");
        }
    }
}

/// The data of every recipe of the repository: their columns with what machines use them for.
#[test]
fn the_data_of_recipes_are_told_with_their_roles() {
    for name in ["robot-ur5", "first-steps", "tango-warming"] {
        let printed = abbe(&root(), &["data", recipes()[name].to_str().expect("UTF-8")]);
        assert_eq!(printed.status, 0, "{name}: {}", printed.stderr);
        assert!(printed.stdout.contains("axis "), "{name}: {}", printed.stdout);
    }
    let printed = abbe(&root(), &["data", "pipelines/first-steps.yaml"]);
    assert!(printed.stdout.contains("direction of approach of X"), "{}", printed.stdout);
    assert!(printed.stdout.contains("rows are left out by the settings"), "{}", printed.stdout);
}

#[test]
fn what_is_no_table_is_refused() {
    let folder = temporary();
    fs::write(folder.path().join("a.csv"), b"\x00\x01\x02\x03").expect("a file");
    write(&folder.path().join("empty.csv"), "");
    assert_eq!(abbe(folder.path(), &["data", "a.csv"]).status, 1);
    assert_eq!(abbe(folder.path(), &["data", "none.csv"]).status, 2);
    for (text, message) in [
        ("", "the file is empty"),
        ("# a comment\n", "the file is empty"),
        ("X_mm,Y_mm\n", "the file has names of columns, and no rows of data"),
    ] {
        write(&folder.path().join("empty.csv"), text);
        let printed = abbe(folder.path(), &["data", "empty.csv"]);
        assert_eq!(printed.status, 1, "{text}: {}", printed.stdout);
        assert!(printed.stdout.is_empty() && printed.stderr.contains(message), "{text}: {}", printed.stderr);
    }
}

/// `ignore` and `keep` may name rows that other data do not have: that is told, and the rest goes on.
#[test]
fn rows_of_other_data_are_told() {
    let folder = temporary();
    write(&folder.path().join("t.csv"), "feature,X_mm\n1,1.5\n2,2.5\n");
    for (filter, rows) in
        [("ignore: { feature: [2, 99] }", 1), ("keep: { feature: [1, 2, 99] }", 2), ("ignore: { feature: [99] }", 2)]
    {
        write(
            &folder.path().join("r.yaml"),
            &format!("abbe: 1\nname: t\nstages:\n  points: {{ ingest: csv, path: t.csv, {filter} }}\n"),
        );
        let printed = abbe(folder.path(), &["data", "r.yaml"]);
        assert_eq!(printed.status, 0, "{}", printed.stderr);
        let count = if rows == 1 { "1 row".to_owned() } else { format!("{rows} rows") };
        assert!(printed.stdout.contains(&format!("points (ingest: csv): {count}\n")), "{}", printed.stdout);
        assert!(printed.stderr.contains("names feature 99, which is in no row of these data"), "{}", printed.stderr);
    }
    write(
        &folder.path().join("r.yaml"),
        "abbe: 1\nname: t\nstages:\n  points: { ingest: csv, path: t.csv, keep: { feature: [99] } }\n",
    );
    assert_eq!(abbe(folder.path(), &["data", "r.yaml"]).status, 1);
}

/// A log in the manner of a control whose rotary axes stand still for several touches.
#[test]
fn a_log_of_lines_is_the_same_as_its_table() {
    let folder = temporary();
    let table = read(&root().join("pipelines/data/sphere-hu40t/exact/touches-1.csv"));
    let mut lines = table.lines();
    let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let all: Vec<&str> = header.iter().copied().filter(|name| name.ends_with("_deg")).collect();
    let rotary = &all;
    let (mut log, mut above) = ("%\nPROBING 1\n".to_owned(), String::new());
    for line in lines {
        let cells: Vec<(&str, &str)> = header.iter().copied().zip(line.split(',')).collect();
        let cells = &cells;
        let of = |wanted: bool| cells.iter().filter(move |(name, _)| rotary.contains(name) == wanted);
        let heading = of(true).map(|(name, cell)| format!("{name}={cell}")).collect::<Vec<_>>().join(" ");
        if heading != above {
            log.push_str(&format!("({heading})\n"));
            above = heading;
        }
        let inches = |name: &str, cell: &str| match name {
            "X_mm" => format!("{}", cell.parse::<f64>().expect("a number") / 25.4),
            _ => cell.to_owned(),
        };
        let row = of(false).map(|(name, cell)| format!("{name}:{}", inches(name, cell))).collect::<Vec<_>>().join("; ");
        log.push_str(&format!("  {row}  \nMISS\n"));
    }
    write(&folder.path().join("touches.log"), &log);
    let group = |name: &&str| format!(r"(?<{name}>\S+)");
    let heading = rotary.iter().map(|name| format!("{name}={}", group(name))).collect::<Vec<_>>().join(" ");
    let others = header.iter().filter(|name| !rotary.contains(name));
    let line = others.map(|name| format!(r"{name}:(?<{name}>[^;]+)")).collect::<Vec<_>>().join("; ");
    let recipe = &recipes()["sphere-hu40t-exact"];
    let estimates = |mut variant: Variant, stage: Option<Value>| {
        if let Some(stage) = stage {
            let own = variant.stage("strategy-1");
            let (mut stage, old) = (stage, own.clone());
            for key in ["ignore", "keep", "constants", "join"] {
                if let Some(value) = old.get(key) {
                    stage[key] = value.clone();
                }
            }
            *own = stage;
        }
        let outcome = variant.run();
        outcome.fits.iter().map(|fit| fit.calibration.parameters.clone()).collect::<Vec<_>>()
    };
    let stage = json!({
        "ingest": "text", "path": folder.path().join("touches.log"), "begins_after": "PROBING.*", "line": line,
        "headings": [format!(r"\({heading}\)")], "skip": ["MISS"], "units": { "X_mm": "in" },
    });
    let mut of_log = Variant::of(recipe);
    *of_log.stage("strategy-1") = stage.clone();
    let file = of_log.only(&["fit"]).write(folder.path());
    write(&folder.path().join("truth.json"), "{ \"parameters\": {} }");
    let simulated = abbe(
        folder.path(),
        &[
            "simulate".as_ref(),
            file.as_os_str(),
            "--truth".as_ref(),
            "truth.json".as_ref(),
            "--seed".as_ref(),
            "1".as_ref(),
            "--out".as_ref(),
            "sim".as_ref(),
        ],
    );
    assert!(simulated.status == 2 && simulated.stderr.contains("reads lines of a log"), "{}", simulated.stderr);
    assert!(!folder.path().join("sim").exists());
    let (from_table, from_log) = (estimates(Variant::of(recipe), None), estimates(Variant::of(recipe), Some(stage)));
    assert_eq!(from_table.len(), from_log.len());
    for (one, other) in from_table.iter().flatten().zip(from_log.iter().flatten()) {
        // Inches have other digits.
        assert!(one.name == other.name && (one.value - other.value).abs() < 1e-11, "{one:?} {other:?}");
    }
}
