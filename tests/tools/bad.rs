//! Logs and tables that contradict themselves: one clear error each, with its place.

use crate::support::{Variant, abbe, read, recipes, root, temporary, write};

/// Changes the lines of the log and of the table (header first); gives what standard error has to say.
type Case = (&'static str, fn(&mut Vec<String>, &mut Vec<String>), &'static [&'static str]);

/// The line with a cell replaced.
fn set(lines: &mut [String], line: usize, column: usize, value: &str) {
    let mut cells: Vec<&str> = lines[line].split(',').collect();
    cells[column] = value;
    lines[line] = cells.join(",");
}

fn cell(line: &str, column: usize) -> &str {
    line.split(',').nth(column).expect("a cell")
}

/// Index of the first line of a tool in a session.
fn first(lines: &[String], session: &str, tool: &str) -> usize {
    let found = lines.iter().position(|line| cell(line, 1) == session && cell(line, 2) == tool);
    found.expect("the tool is there")
}

const CASES: [Case; 27] = [
    ("in the log only", |_, table| drop(table.remove(4)), &["tool 4 is not in the table", "tool-log.csv:50"]),
    (
        "in the table only",
        |_, table| table.push("9,100,5,40,30".to_owned()),
        &["tool 9 is in no session", "tools.csv:10"],
    ),
    ("in the table twice", |_, table| table.push(table[1].clone()), &["tool `1` is in line 2 already", "tools.csv:10"]),
    (
        "the master in the table",
        |_, table| table.push("0,200,12,40,30".to_owned()),
        &["tool 0 is the master", "tools.csv:10"],
    ),
    (
        "no wear limit",
        |_, table| set(table, 2, 3, "0"),
        &["wear_limit_length of tool 2 is not above zero", "tools.csv:3"],
    ),
    (
        "a wear limit above that of breakage",
        |_, table| set(table, 2, 3, "40000"),
        &["wear_limit_length of tool 2 is", "(`breakage_um`)", "tools.csv:3"],
    ),
    (
        "a session without master",
        |log, _| log.retain(|line| !(cell(line, 1) == "5" && cell(line, 2) == "0")),
        &["session 5 has no reading of the master, tool 0"],
    ),
    (
        "a method without master",
        |log, _| log.retain(|line| !(cell(line, 1) == "5" && cell(line, 2) == "0" && cell(line, 4) == "laser")),
        &["session 5 has no length of the master by laser, and that of tool 1"],
    ),
    (
        "inches in millimetres",
        |log, _| set(log, 1, 6, "7.8747"),
        &["the length of the master reads 7.8747 mm", "tool-log.csv:2", "unit"],
    ),
    (
        "inches in the table",
        |_, table| {
            for line in 1..table.len() {
                let inches = cell(&table[line], 1).parse::<f64>().expect("a number") / 25.4;
                set(table, line, 1, &format!("{inches:.5}"));
            }
        },
        &["the length of tool 1 is 6.00051 mm here, and the setter reads 152.4", "tools.csv:2", "are the units"],
    ),
    (
        "radii of the table in um",
        |_, table| {
            for line in 1..table.len() {
                let um = cell(&table[line], 2).parse::<f64>().expect("a number") * 1e3;
                set(table, line, 2, &um.to_string());
            }
        },
        &["the radius of tool 1 is 10000 mm here, and the setter reads 9.99", "tools.csv:2"],
    ),
    (
        "diameters in the log",
        |log, _| {
            for line in 1..log.len() {
                if cell(&log[line], 3) == "radius" {
                    let value = 2.0 * cell(&log[line], 6).parse::<f64>().expect("a number");
                    set(log, line, 6, &value.to_string());
                }
            }
        },
        &["the radius of the master reads 24.9", "it is 12.4996 mm"],
    ),
    ("no unit", |log, _| set(log, 0, 6, "value"), &["the column `value` does not say its unit", "value_mm"]),
    ("an angle", |log, _| set(log, 0, 6, "value_deg"), &["the column `value_deg` has the wrong unit; mm was expected"]),
    (
        "a quantity",
        |log, _| set(log, 20, 3, "lenght"),
        &["no quantity `lenght`", "did you mean `length`?", "tool-log.csv:21"],
    ),
    (
        "a method",
        |log, _| set(log, 20, 4, "camera"),
        &["no method `camera`; known are contact, laser", "tool-log.csv:21"],
    ),
    (
        "a session goes on",
        |log, _| {
            let moved = log.remove(first(log, "3", "8"));
            log.push(moved);
        },
        &["sessions are out of order: session 3 goes on after session 14"],
    ),
    (
        "sessions swapped",
        |log, _| {
            let start = first(log, "2", "0");
            let end = first(log, "3", "0");
            let after = first(log, "4", "0");
            log[start..after].rotate_left(end - start);
        },
        &["sessions are out of order: 2 follows 3"],
    ),
    ("time falls", |log, _| set(log, 30, 7, "1"), &["sessions are out of order: time falls from", "tool-log.csv:31"]),
    (
        "twice",
        |log, _| log.insert(21, log[20].clone()),
        &["of tool 1 by laser in session 1 is in line 21 already", "tool-log.csv:22"],
    ),
    (
        "minutes fall",
        |log, _| {
            log.iter_mut().filter(|line| cell(line, 1) == "4" && cell(line, 2) == "3").for_each(|line| {
                let end = line.rfind(',').expect("cells");
                line.replace_range(end.., ",12");
            });
        },
        &["the cutting minutes of tool 3 fall from 70 to 12"],
    ),
    (
        "seconds in minutes",
        |log, _| {
            for line in 1..log.len() {
                let seconds = cell(&log[line], 9).parse::<f64>().expect("a number") * 60.0;
                set(log, line, 9, &format!("{seconds}"));
            }
        },
        &["tool 2 cut for 24840.0 minutes, and by the clock 585.0 minutes passed since line 26", "cutting_s"],
    ),
    (
        "minutes differ",
        |log, _| {
            let line = first(log, "4", "3");
            set(log, line + 1, 9, "999");
        },
        &["tool 3 has cut 999 min here and", "of the same session"],
    ),
    (
        "out of use",
        |log, _| log.retain(|line| !(cell(line, 1) == "7" && cell(line, 2) == "4")),
        &["tool 4 is measured in session 8, after it was taken out of use: it is not in session 7"],
    ),
    (
        "no temperature",
        |log, _| {
            log.iter_mut().for_each(|line| {
                let cells: Vec<&str> = line.split(',').collect();
                *line = [&cells[..8], &cells[9..]].concat().join(",");
            });
        },
        &["there is no column `spindle_degC`"],
    ),
    ("an empty temperature", |log, _| set(log, 20, 8, ""), &["tool-log.csv:21"]),
    (
        "another temperature",
        |log, _| set(log, 20, 8, "30"),
        &["the spindle is +9.60 K from where it was with the master", "tool-log.csv:21"],
    ),
];

#[test]
fn bad_logs_and_tables_get_one_clear_error() {
    let data = root().join("pipelines/data/tool-check/exact");
    for (what, change, told) in CASES {
        let folder = temporary();
        let lines = |name: &str| read(&data.join(name)).lines().map(str::to_owned).collect::<Vec<_>>();
        let (mut log, mut table) = (lines("tool-log.csv"), lines("tools.csv"));
        change(&mut log, &mut table);
        let mut recipe = Variant::of(&recipes()["tool-check-exact"]);
        for (stage, setting, name, lines) in
            [("log", "path", "tool-log.csv", log), ("tools", "table", "tools.csv", table)]
        {
            write(&folder.path().join(name), &(lines.join("\n") + "\n"));
            recipe = recipe.set(stage, setting, name.into());
        }
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), "out".as_ref()]);
        assert!(![0, 3].contains(&printed.status), "{what}: {}{}", printed.stdout, printed.stderr);
        for told in told {
            assert!(printed.stderr.contains(told), "{what}: `{told}` is not in\n{}", printed.stderr);
        }
    }
}

#[test]
fn a_tool_that_is_listed_twice_is_refused() {
    let folder = temporary();
    let recipe = Variant::of(&recipes()["before-the-cut"]).set("tools-of-the-cut", "tools", serde_json::json!([1, 1]));
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), "out".as_ref()]);
    assert!(printed.status == 2 && printed.stderr.contains("the tool 1 is listed twice"), "{}", printed.stderr);
}

#[test]
fn another_estimate_has_no_tools() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["before-the-cut"]);
    recipe.stage("tools-of-the-cut")["of"] = "calibrated".into();
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), "out".as_ref()]);
    assert_ne!(printed.status, 0);
    assert!(printed.stderr.contains("`calibrated` has no dimensions of tools"), "{}", printed.stderr);
}
