//! Numbers and texts beyond measure in recipes and data: settings of every size, long cells, many columns and stages, line ends,
//! separators, what a terminal would obey.

use std::path::{Path, PathBuf};

use super::Case;
use super::stock::Stock;
use crate::Random;
use crate::bad_inputs::wrong;
use crate::process::{Bounds, Ended, ended};
use crate::source::Source;

/// Numbers that nobody means.
const NUMBERS: [&str; 20] = [
    "0",
    "-1",
    "1e-300",
    "-1e-300",
    "1e-12",
    "1e9",
    "1e12",
    "1e300",
    "-1e300",
    ".nan",
    ".inf",
    "-.inf",
    "0.5",
    "-0.0",
    "2147483648",
    "18446744073709551616",
    "1e400",
    "4e-324",
    "-1e9",
    "99999",
];

fn ran(program: &Path, source: &Source, folder: &Path, random: &mut Random) -> (Option<Ended>, &'static str) {
    source.write(folder);
    let recipe = source.recipe().display().to_string();
    let command = if random.chance(0.4) { "check" } else { "run" };
    let end = match command {
        "check" => ended(program, folder, &[command, &recipe], Bounds::default()),
        _ => ended(program, folder, &[command, &recipe, "--out", "out"], Bounds::default()),
    };
    (end, command)
}

fn judged(program: &Path, source: &Source, what: &str, file: &Path, random: &mut Random) -> Case {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (end, command) = ran(program, source, folder.path(), random);
    let mut case = Case::new(format!("{command} {}, {}: {what}", source.name, file.display()), end.as_ref());
    case.wrong.extend(wrong(end.as_ref(), folder.path()));
    if matches!(case.status, Some(1 | 2)) {
        // A message says where: in a recipe, in a file of data, or in a stage.
        if let Some(Ended { stdout, stderr, .. }) = &end {
            // `check` lists estimates that would fail.
            let has_place = [".yaml", ".csv", "stage `"].iter().any(|place| stderr.contains(place));
            case.law(has_place || (command == "check" && !stdout.is_empty()), || {
                format!("no place: {}", super::cut(stderr))
            });
        }
    }
    case
}

/// Where the numbers of settings begin and end: behind `: `, `[` or `, `, outside of comments.
fn numbers(text: &str) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    let mut start = 0;
    for line in text.split_inclusive('\n') {
        let code = line.split(" #").next().unwrap_or(line);
        let code = if line.starts_with('#') || line.starts_with("abbe:") { "" } else { code };
        let mut at = 0;
        for word in code.split_inclusive([' ', ',', '[', ']', '{', '}', '\n']) {
            let own = word.trim_end_matches([' ', ',', '[', ']', '{', '}', '\n']);
            if own.parse::<f64>().is_ok() {
                found.push((start + at, start + at + own.len()));
            }
            at += word.len();
        }
        start += line.len();
    }
    found
}

/// A setting of a recipe has a number that nobody means.
pub fn number(program: &Path, stock: &Stock, random: &mut Random) -> Case {
    loop {
        let mut source = stock.sources[random.count(0, stock.sources.len())].clone();
        let texts: Vec<PathBuf> =
            source.files.keys().filter(|file| file.extension().is_some_and(|end| end == "yaml")).cloned().collect();
        let file = texts[random.count(0, texts.len())].clone();
        let mut text = String::from_utf8_lossy(&source.files[&file]).into_owned();
        let all = numbers(&text);
        if all.is_empty() {
            continue;
        }
        let (from, to) = random.of(&all);
        let new = random.of(&NUMBERS);
        let before: String = text[..from].chars().rev().take(30).collect::<Vec<_>>().into_iter().rev().collect();
        let what = format!("{new} for {} after `{}`", &text[from..to], before.replace('\n', " "));
        text.replace_range(from..to, new);
        source.files.insert(file.clone(), text.into_bytes());
        return judged(program, &source, &what, &file, random);
    }
}

/// Texts that a terminal would obey, or that turn the direction of writing.
const ESCAPES: [&str; 5] = ["\x1b[2J\x1b[31m", "\x1b]0;owned\x07", "\u{9b}31m", "\u{202e}abc", "\x08\x08\x08"];

/// A table or a recipe has texts that nobody writes.
pub fn text(program: &Path, stock: &Stock, random: &mut Random) -> Case {
    let mut source = stock.sources[random.count(0, stock.sources.len())].clone();
    let files: Vec<PathBuf> = source.files.keys().cloned().collect();
    let mut file = files[random.count(0, files.len())].clone();
    let mut text = String::from_utf8_lossy(&source.files[&file]).into_owned();
    let is_table = file.extension().is_some_and(|end| end == "csv");
    let lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let line = random.count(0, lines.len());
    let what = match random.count(0, 8) {
        0 => {
            let size = random.of(&[1_000, 70_000, 1_000_000]);
            let mut lines = lines;
            lines[line].push_str(&format!(",{}", random.of(&["x", "9", "\u{e9}", "\u{1f600}"]).repeat(size)));
            text = lines.join("\n") + "\n";
            format!("a cell of {size} letters in line {}", line + 1)
        }
        1 if is_table => {
            let count = random.of(&[100, 3_000]);
            let header = lines.iter().position(|line| !line.starts_with('#')).unwrap_or(0);
            let wider = lines.iter().enumerate().map(|(place, line)| match place {
                _ if line.starts_with('#') => format!("{line}\n"),
                place if place == header => {
                    format!("{line}{}\n", (0..count).map(|column| format!(",more{column}_mm")).collect::<String>())
                }
                _ => format!("{line}{}\n", ",0".repeat(count)),
            });
            text = wider.collect();
            format!("{count} more columns")
        }
        2 => {
            file = source.recipe();
            text = String::from_utf8_lossy(&source.files[&file]).into_owned();
            let count = random.of(&[50, 400]);
            let more: String =
                (0..count).map(|stage| format!("  more-{stage}: {{ ingest: csv, path: none.csv }}\n")).collect();
            text = text.replacen("stages:\n", &format!("stages:\n{more}"), 1);
            format!("{count} more stages")
        }
        3 => {
            let end = random.of(&["\r", "\r\n", "\n\r", "\u{2028}", "\u{85}", "\0", "\n\n"]);
            text = lines.join(end);
            format!("lines end in {end:?}")
        }
        4 => {
            let separator = random.of(&[";", "\t", "|", " ", ", "]);
            text = text.replace(',', separator);
            format!("separators are {separator:?}")
        }
        5 | 6 => {
            let escape = random.of(&ESCAPES);
            let mut lines = lines;
            let at = random.count(0, lines[line].len() + 1);
            let at = (0..=at).rev().find(|at| lines[line].is_char_boundary(*at)).unwrap_or(0);
            lines[line].insert_str(at, escape);
            text = lines.join("\n") + "\n";
            format!("{escape:?} in line {}", line + 1)
        }
        _ => {
            let depth = random.of(&[50, 5_000, 100_000]);
            let (open, close) = random.of(&[("[", "]"), ("{a: ", "}"), ("\"", "\""), ("- ", "")]);
            let mut lines = lines;
            lines[line].push_str(&format!("{}{}", open.repeat(depth), close.repeat(depth)));
            text = lines.join("\n") + "\n";
            format!("{open:?} {depth} times in line {}", line + 1)
        }
    };
    source.files.insert(file.clone(), text.into_bytes());
    judged(program, &source, &what, &file, random)
}
