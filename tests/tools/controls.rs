//! Files of controls, each read by a reader that shares no code with its writer.

use std::collections::BTreeMap;

use super::{number, run, table};
use crate::support::{Variant, abbe, read, recipes, temporary};

/// What a control knows of its tools afterwards: length and radius it works with, mm, by number.
pub(super) type Tools = BTreeMap<u32, (f64, f64)>;

/// What a reader found: tools with offsets, and locked ones.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Control {
    pub(super) tools: Tools,
    pub(super) locked: Vec<u32>,
}

fn linuxcnc(text: &str) -> Control {
    let mut control = Control::default();
    for line in text.lines() {
        if let Some(comment) = line.strip_prefix(';') {
            let word = comment.split_whitespace().next().expect("a word");
            control.locked.push(word.strip_prefix('T').expect("a tool").parse().expect("a number"));
            continue;
        }
        let mut words: BTreeMap<char, f64> = BTreeMap::new();
        for word in line.split(';').next().expect("an entry").split_whitespace() {
            let letter = word.chars().next().expect("a letter");
            assert!(words.insert(letter, number(&word[1..])).is_none(), "{line}");
        }
        assert_eq!(words[&'T'], words[&'P']);
        control.tools.insert(words[&'T'] as u32, (words[&'Z'], words[&'D'] / 2.0));
    }
    control
}

fn fanuc(text: &str) -> Control {
    let mut memory: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    let mut control = Control::default();
    let (mut absolute, mut metric, mut ended) = (false, false, false);
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!((lines.first(), lines.last()), (Some(&"%"), Some(&"%")));
    for line in &lines[1..lines.len() - 1] {
        assert!(!ended, "{line} after the end");
        if let Some(comment) = line.strip_prefix('(') {
            assert!(comment.ends_with(')') && comment.is_ascii() && comment.to_uppercase() == *comment);
            if comment.contains(" LOCKED") {
                let tool = comment.strip_prefix('T').and_then(|rest| rest.split(' ').next()).expect("a tool");
                control.locked.push(tool.parse().expect("a number"));
            }
            continue;
        }
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            [program, ..] if program.starts_with('O') => assert!(program[1..].parse::<u32>().is_ok()),
            ["G21", "G90"] => (metric, absolute) = (true, true),
            ["G10", l, p, r] => {
                assert!(absolute && metric && r.contains('.'), "{line}");
                let [l, p] = [l.strip_prefix('L'), p.strip_prefix('P')]
                    .map(|it| it.expect("a letter").parse().expect("a number"));
                memory.insert((l, p), number(r.strip_prefix('R').expect("R")));
            }
            ["M30"] => ended = true,
            _ => panic!("{line}"),
        }
    }
    assert!(ended);
    for &(_, tool) in memory.keys().filter(|(l, _)| *l == 10) {
        // H: geometry and wear of the length; D: of the radius.
        let total = |geometry, wear| memory[&(geometry, tool)] + memory[&(wear, tool)];
        control.tools.insert(tool, (total(10, 11), total(12, 13)));
    }
    control
}

fn siemens(text: &str) -> Control {
    let mut edges: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    let mut control = Control::default();
    for line in text.lines().filter(|line| !line.starts_with(';') && *line != "M30") {
        let (left, right) = line.split_once('=').expect("an assignment");
        let (name, index) = left.strip_suffix(']').and_then(|left| left.split_once('[')).expect("an index");
        if name == "$TC_TP8" {
            assert_eq!(right, format!("$TC_TP8[{index}] B_OR 4"), "bit 2 and no other");
            control.locked.push(index.parse().expect("a number"));
            continue;
        }
        let (tool, edge) = index.split_once(',').expect("tool and edge");
        assert_eq!(edge, "1");
        let parameter = name.strip_prefix("$TC_DP").expect("cutting edge data").parse().expect("a number");
        edges.insert((tool.parse().expect("a number"), parameter), number(right));
    }
    for &(tool, _) in edges.keys().filter(|(_, parameter)| *parameter == 3) {
        let total = |basic, wear| edges[&(tool, basic)] + edges[&(tool, wear)];
        control.tools.insert(tool, (total(3, 12), total(6, 15)));
    }
    control
}

fn heidenhain(text: &str) -> Control {
    let mut control = Control::default();
    let lines: Vec<&str> = text.split("\r\n").collect();
    let [begin, header, tools @ .., end, ""] = lines.as_slice() else { panic!("{text}") };
    assert_eq!((*begin, *end), ("BEGIN TOOL .T MM", "[END]"));
    // Columns begin where their names do.
    let mut starts: Vec<(usize, &str)> = Vec::new();
    for name in header.split_whitespace() {
        let after = starts.last().map_or(0, |(start, name)| start + name.len());
        starts.push((after + header[after..].find(name).expect("the name"), name));
    }
    for line in tools {
        let cell = |name: &str| {
            let place = starts.iter().position(|(_, other)| *other == name).expect("a column");
            let end = starts.get(place + 1).map_or(line.len(), |next| next.0).min(line.len());
            line.get(starts[place].0..end).unwrap_or_default().trim()
        };
        let tool: u32 = cell("T").parse().expect("a number");
        match cell("TL") {
            "L" => {
                assert_eq!((cell("DL"), cell("DR")), ("", ""), "{line}");
                control.locked.push(tool);
            }
            "" => {
                // The length of the tool is L + DL.
                let total = |base, more| number(cell(base)) + number(cell(more));
                control.tools.insert(tool, (total("L", "DL"), total("R", "DR")));
            }
            other => panic!("TL {other}"),
        }
    }
    control
}

/// Stage in the recipe, file, and reader of a control.
type Reader = (&'static str, &'static str, fn(&str) -> Control);

pub(super) const CONTROLS: [Reader; 4] = [
    ("linuxcnc", "tool.tbl", linuxcnc),
    ("fanuc", "offsets.nc", fanuc),
    ("siemens", "offsets.mpf", siemens),
    ("heidenhain", "TOOL.T", heidenhain),
];

/// What the last session says: dimensions of the tools that may be used, and those that may not.
fn wanted(files: &BTreeMap<String, String>) -> Control {
    let mut tools: BTreeMap<u32, (f64, f64)> = BTreeMap::new();
    for row in table(files, "history/dimensions.csv").iter().filter(|row| row["session"] == "14") {
        let tool = tools.entry(row["tool"].parse().expect("a number")).or_default();
        *(if row["quantity"] == "length" { &mut tool.0 } else { &mut tool.1 }) = number(&row["value_mm"]);
    }
    tools.remove(&3).expect("the worn tool");
    Control { tools, locked: vec![3, 5, 6] }
}

/// Whether a control works with the dimensions of the tools, to half an increment.
pub(super) fn agrees(found: &Control, wanted: &Control, increment: f64) -> bool {
    let near = |one: f64, other: f64| (one - other).abs() <= 0.5 * increment + 1e-9;
    found.locked == wanted.locked
        && found.tools.keys().eq(wanted.tools.keys())
        && found
            .tools
            .values()
            .zip(wanted.tools.values())
            .all(|(one, other)| near(one.0, other.0) && near(one.1, other.1))
}

#[test]
fn controls_work_with_what_was_measured() {
    for recipe in ["tool-check-exact", "tool-check"] {
        let (_, files) = run(recipe);
        let wanted = wanted(&files);
        for (stage, file, reader) in CONTROLS {
            let text = &files[&format!("{stage}/{file}")];
            let found = reader(text);
            assert!(agrees(&found, &wanted, 1e-4), "{recipe} {stage}: {found:#?} {wanted:#?}");
            let list: Vec<u32> =
                table(&files, &format!("{stage}/locked.csv")).iter().map(|row| number(&row["tool"]) as u32).collect();
            assert_eq!(list, found.locked);
        }
    }
}

/// The file with the sign of what is worn turned.
fn flipped(control: &str, text: &str) -> String {
    let turned = |value: &str| {
        if let Some(rest) = value.strip_prefix('-') {
            format!("+{rest}")
        } else {
            format!("-{}", value.trim_start_matches('+'))
        }
    };
    let line = |line: &str| match control {
        "linuxcnc" => line.replace("Z+", "Z-"),
        "fanuc" if line.starts_with("G10 L11") || line.starts_with("G10 L13") => {
            let (before, value) = line.split_once(" R").expect("a value");
            format!("{before} R{}", turned(value).trim_start_matches('+'))
        }
        "siemens" if line.starts_with("$TC_DP12") || line.starts_with("$TC_DP15") => {
            let (before, value) = line.split_once('=').expect("a value");
            format!("{before}={}", turned(value).trim_start_matches('+'))
        }
        // The columns DL and DR begin at 50 and 61.
        "heidenhain" if line.starts_with(|c: char| c.is_ascii_digit()) && line.len() > 61 => {
            let (before, worn) = line.split_at(50);
            let signs = worn.chars().map(|c| match c {
                '+' => '-',
                '-' => '+',
                c => c,
            });
            format!("{before}{}", signs.collect::<String>())
        }
        _ => line.to_owned(),
    };
    let end = if control == "heidenhain" { "\r\n" } else { "\n" };
    text.split(end).map(line).collect::<Vec<_>>().join(end)
}

#[test]
fn with_the_sign_turned_no_control_would_work() {
    let (_, files) = run("tool-check");
    let wanted = wanted(&files);
    for (stage, file, reader) in CONTROLS {
        let text = &files[&format!("{stage}/{file}")];
        let turned = flipped(stage, text);
        assert_ne!(&turned, text, "{stage}");
        assert!(!agrees(&reader(&turned), &wanted, 1e-4), "{stage}");
    }
}

#[test]
fn increments_and_numbers_are_those_of_the_control() {
    let folder = temporary();
    let recipe = Variant::of(&recipes()["tool-check"])
        .only(&["tools", "fanuc"])
        .set("fanuc", "decimals", 3.into())
        .set("fanuc", "numbers", serde_json::json!({ "1": 21 }));
    let file = recipe.write(folder.path());
    let out = folder.path().join("out");
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), out.as_os_str()]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let text = read(&out.join("recipe/fanuc/offsets.nc"));
    let found = fanuc(&text);
    assert!(found.tools.contains_key(&21) && !found.tools.contains_key(&1), "{text}");
    assert!(
        text.lines()
            .filter(|line| line.starts_with("G10"))
            .filter_map(|line| line.split_once(" R"))
            .all(|(_, value)| { value.split_once('.').is_some_and(|(_, decimals)| decimals.len() == 3) })
    );
    for (numbers, told) in [
        (serde_json::json!({ "1": 2 }), "tools 1 and 2 have the same number in the control"),
        (serde_json::json!({ "77": 9 }), "the table has no tool `77`"),
    ] {
        let file = recipe.clone().set("fanuc", "numbers", numbers).write(folder.path());
        let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), out.as_os_str()]);
        assert!(printed.status != 0 && printed.stderr.contains(told), "{} {}", printed.status, printed.stderr);
    }
}
