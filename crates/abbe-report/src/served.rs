//! Pages of a history: its machines, what the tests of one tell, an entry. Every link leads to another page of the same kind.

use std::fmt::Write as _;

use abbe_trend::{Analysis, Quality};

use crate::html::{Cell, details, escape, paragraph, table};
use crate::page::{page, parts_of, whole};
use crate::run::Run;
use crate::sections::trend;

/// A machine in the list.
#[derive(Debug, Clone)]
pub struct ListedMachine {
    /// Its name.
    pub name: String,
    /// Number of its calibrations.
    pub calibrations: i64,
    /// When the last one was: `week 40`, `2026-03-02`.
    pub last: String,
    /// Its state: `in control`, `alarm`, `not judged`; none where there are too many machines to judge all at once.
    pub state: Option<&'static str>,
}

/// An entry in the list.
#[derive(Debug, Clone)]
pub struct ListedEntry {
    /// Its number.
    pub number: i64,
    /// The recipe.
    pub recipe: String,
    /// SHA-256 of its content.
    pub sha256: String,
}

/// A calibration, and where it is kept.
#[derive(Debug, Clone)]
pub struct KeptCalibration {
    /// Number of the entry.
    pub entry: i64,
    /// The estimate.
    pub estimate: String,
    /// The machine.
    pub machine: String,
    /// When it was: `week 40`, `2026-03-02`.
    pub when: String,
}

/// What is shown of a machine.
pub struct MachinePage<'a> {
    /// Its name.
    pub machine: &'a str,
    /// The estimate that was repeated, and all that the machine has.
    pub estimate: &'a str,
    /// Names of all its estimates.
    pub estimates: &'a [String],
    /// The estimate that the charts are compared with.
    pub baseline: Option<&'a str>,
    /// `in control`, `alarm`, `not judged`.
    pub state: &'a str,
    /// What its tests tell; an error in words where they tell nothing.
    pub told: Result<(&'a Analysis, &'a [Quality], &'a [String]), String>,
    /// Its tests, the last one first.
    pub tests: &'a [KeptCalibration],
}

/// The first page: machines and entries. `older` is the number of the entry before those that are shown.
pub fn machines_page(machines: &[ListedMachine], entries: &[ListedEntry], older: Option<i64>) -> String {
    let rows = machines.iter().map(|machine| {
        let link = to_machine(&machine.name, None, None);
        vec![
            Cell::Html(anchor(&link, &machine.name)),
            Cell::figure(machine.calibrations.to_string()),
            Cell::text(&machine.last),
            Cell::Html(machine.state.map_or_else(String::new, |state| {
                format!("<span class=\"{}\">{}</span>", class_of(state), escape(state))
            })),
        ]
    });
    let rows: Vec<Vec<Cell>> = rows.collect();
    let of_machines = match rows.is_empty() {
        true => paragraph("No machine yet: `abbe history add` adds the results of runs."),
        false => table("Every machine with its last calibration", &["machine", "calibrations", "last", "state"], &rows),
    };
    let rows = entries.iter().map(|entry| {
        let short: String = entry.sha256.chars().take(12).collect();
        vec![
            Cell::Html(anchor(&format!("/entry/{}", entry.number), &format!("entry {}", entry.number))),
            Cell::text(&entry.recipe),
            Cell::Html(format!("<code>{}</code>", escape(&short))),
        ]
    });
    let mut of_entries =
        table("Results of runs, the last one first", &["report", "recipe", "SHA-256"], &rows.collect::<Vec<_>>());
    if let Some(older) = older {
        let _ = writeln!(of_entries, "<p>{}</p>", anchor(&format!("/?before={}", older + 1), "older ones"));
    }
    let parts = [("machines", "Machines", of_machines), ("reports", "Reports", of_entries)];
    whole("Calibrations over time", &[], &parts.map(|(id, name, html)| (id.to_owned(), name.to_owned(), html)))
}

/// The page about one machine.
pub fn machine_page(page: &MachinePage<'_>) -> String {
    let class = class_of(page.state);
    let mut first = format!("<p class=\"verdict {class}\">{}</p>\n", escape(&capital(page.state)));
    first.push_str(&choices(page));
    let mut parts = vec![("state".to_owned(), "State".to_owned(), first)];
    match &page.told {
        Ok((analysis, quality, remarks)) => {
            parts.push((
                "trend".to_owned(),
                format!("Over time, {}", page.estimate),
                trend(analysis, quality, remarks),
            ));
        }
        Err(why) => parts[0].2.push_str(&paragraph(why)),
    }
    let rows = page.tests.iter().map(|test| {
        vec![
            Cell::text(&test.when),
            Cell::Html(anchor(&to_calibration(test.entry, &test.estimate), &test.estimate)),
            Cell::Html(anchor(&format!("/entry/{}", test.entry), &format!("entry {}", test.entry))),
        ]
    });
    let rows = rows.collect::<Vec<_>>();
    let tests = table("Calibrations, the last one first", &["when", "report", "kept in"], &rows);
    parts.push((
        "tests".to_owned(),
        "Calibrations".to_owned(),
        details(&format!("{} calibrations", rows.len()), false, &tests),
    ));
    with_way_back(&whole(page.machine, &[], &parts))
}

fn class_of(state: &str) -> &'static str {
    match state {
        "in control" => "pass",
        "alarm" => "fail",
        _ => "unsure",
    }
}

/// Other estimates of the machine, to be charted or compared with.
fn choices(page: &MachinePage<'_>) -> String {
    let mut html = String::new();
    let others = page.estimates.iter().filter(|name| *name != page.estimate);
    let links: Vec<String> =
        others.clone().map(|name| anchor(&to_machine(page.machine, Some(name), None), name)).collect();
    if !links.is_empty() {
        let _ = writeln!(html, "<p>Chart another estimate: {}</p>", links.join(", "));
    }
    if !page.estimate.is_empty() {
        let others = others.filter(|name| Some(name.as_str()) != page.baseline);
        let compared = |name: &String| anchor(&to_machine(page.machine, Some(page.estimate), Some(name)), name);
        let mut links: Vec<String> = others.map(compared).collect();
        if page.baseline.is_some() {
            links.push(anchor(&to_machine(page.machine, Some(page.estimate), None), "the mean of its own tests"));
        }
        let told = page.baseline.map_or_else(|| "the mean of its own tests".to_owned(), escape);
        let _ = write!(html, "<p>{} is compared with {told}", escape(page.estimate));
        if !links.is_empty() {
            let _ = write!(html, "; compare it with {}", links.join(", "));
        }
        html.push_str(".</p>\n");
    }
    html
}

/// The report about what an entry has. `files` are those that were read for it, with their hashes.
pub fn entry_page(
    number: i64,
    sha256: &str,
    kept: &[KeptCalibration],
    files: &[(String, String)],
    run: &Run,
) -> String {
    let mut machines: Vec<&str> = kept.iter().map(|own| own.machine.as_str()).collect();
    machines.sort_unstable();
    machines.dedup();
    let links: Vec<String> = machines.iter().map(|name| anchor(&to_machine(name, None, None), name)).collect();
    let mut html =
        format!("<p>Entry {number} of the history, {}. <code>{}</code></p>\n", links.join(", "), escape(sha256));
    let rows = kept.iter().map(|own| {
        let page = to_calibration(number, &own.estimate);
        let name = encoded(&own.estimate);
        vec![
            Cell::Html(anchor(&page, &own.estimate)),
            Cell::text(&own.when),
            Cell::Html(anchor(&format!("/entry/{number}/{name}.calibration.json"), "JSON")),
        ]
    });
    let rows: Vec<Vec<Cell>> = rows.collect();
    let all = table("What the entry has", &["calibration", "when", "file"], &rows);
    html.push_str(&details(&format!("{} calibrations", rows.len()), rows.len() <= 8, &all));
    let row = |(file, sha256): &(String, String)| {
        vec![Cell::text(file), Cell::Html(format!("<code>{}</code>", escape(sha256)))]
    };
    let read = table("Files that were read", &["file", "SHA-256"], &files.iter().map(row).collect::<Vec<_>>());
    html.push_str(&details(&format!("{} files that were read", files.len()), false, &read));
    let mut parts = vec![("kept".to_owned(), "In the history".to_owned(), html)];
    parts.extend(parts_of(std::slice::from_ref(run)));
    with_way_back(&whole(&run.title, &[&run.name], &parts))
}

/// The report about one calibration of an entry.
pub fn calibration_page(entry: i64, run: &Run) -> String {
    let way =
        format!("<header>\n<p><a href=\"/\">All machines</a> · <a href=\"/entry/{entry}\">entry {entry}</a></p>\n");
    page(std::slice::from_ref(run)).replacen("<header>\n", &way, 1)
}

/// A page that says what went wrong.
pub fn refusal_page(title: &str, text: &str) -> String {
    let parts = [("told".to_owned(), "What happened".to_owned(), paragraph(text))];
    with_way_back(&whole(title, &[], &parts))
}

/// Adds the link to the first page.
fn with_way_back(page: &str) -> String {
    page.replacen("<header>\n", "<header>\n<p><a href=\"/\">All machines</a></p>\n", 1)
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

fn to_machine(name: &str, estimate: Option<&str>, baseline: Option<&str>) -> String {
    let mut link = format!("/machine?name={}", encoded(name));
    for (key, value) in [("estimate", estimate), ("baseline", baseline)] {
        if let Some(value) = value {
            let _ = write!(link, "&{key}={}", encoded(value));
        }
    }
    link
}

fn to_calibration(entry: i64, estimate: &str) -> String {
    format!("/entry/{entry}/{}", encoded(estimate))
}

fn anchor(link: &str, text: &str) -> String {
    format!("<a href=\"{}\">{}</a>", escape(link), escape(text))
}

/// Text in an address: all but letters and digits of ASCII and `-_.` as `%` and two hexadecimal digits.
fn encoded(text: &str) -> String {
    let mut address = String::new();
    for byte in text.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' => address.push(char::from(byte)),
            other => {
                let _ = write!(address, "%{other:02X}");
            }
        }
    }
    address
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names come from whoever adds results: none becomes markup, an address of its own, or a script.
    #[test]
    fn names_are_text() {
        let name = "<script>alert(1)</script>\"' onclick=x &amp; javascript:alert(1) ../../etc";
        let machine = ListedMachine { name: name.into(), calibrations: 3, last: name.into(), state: Some("alarm") };
        let entry = ListedEntry { number: 7, recipe: name.into(), sha256: name.into() };
        let kept = KeptCalibration { entry: 7, estimate: name.into(), machine: name.into(), when: name.into() };
        let estimates = [name.to_owned(), "other".to_owned()];
        let shown = MachinePage {
            machine: name,
            estimate: name,
            estimates: &estimates,
            baseline: Some(name),
            state: "alarm",
            told: Err(name.to_owned()),
            tests: &[kept],
        };
        for told in [machines_page(&[machine], &[entry], Some(3)), machine_page(&shown), refusal_page(name, name)] {
            let body = told.split("<body>").nth(1).unwrap().split("<script>\"use strict\"").next().unwrap();
            assert!(!body.contains("<script>alert") && !body.contains("\"' onclick"), "{body}");
            for link in body.split("href=\"").skip(1) {
                assert!(link.starts_with('/') || link.starts_with('#'), "{link}");
                assert!(!link.split('"').next().unwrap().contains(['<', '\'', ' ']), "{link}");
            }
            assert!(told.contains("&lt;script&gt;alert(1)&lt;/script&gt;"));
        }
    }
}
