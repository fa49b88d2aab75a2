//! What is to be looked at in the rows of a file: columns of one name, times that jump, sums at the end.

use std::collections::BTreeMap;

use super::{Found, Jump, Summary};

/// The column that is the time of rows.
pub(super) const TIME: &str = "time";

/// Whether a column without a unit is a time or a date, by its name or because its cells are written so.
pub(super) fn is_time(name: &str, cells: &[&str]) -> bool {
    let name = name.to_lowercase();
    let is_named = ["time", "zeit", "uhrzeit", "datum", "date"].iter().any(|word| name.starts_with(word));
    let is_clock = |cell: &&str| {
        let parts: Vec<&str> = cell.split([':', ' ', 'T', '-', '.', '/']).collect();
        let counts = |part: &&str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
        cell.matches(':').count() >= 1 && parts.len() >= 2 && parts.iter().all(counts)
    };
    let filled = cells.iter().filter(|cell| !cell.is_empty());
    is_named || (!cells.is_empty() && filled.clone().count() > 0 && filled.clone().all(is_clock))
}

/// Names that stand twice or more, each once.
pub(super) fn twins(columns: &[Found]) -> Vec<String> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    columns.iter().for_each(|column| *counts.entry(&column.name).or_default() += 1);
    counts.into_iter().filter(|(_, count)| *count > 1).map(|(name, _)| name.to_owned()).collect()
}

/// What rows of sums, means and extremes are called.
const SUMMARIES: [&str; 33] = [
    "sum",
    "total",
    "totals",
    "grand total",
    "count",
    "mean",
    "average",
    "avg",
    "median",
    "min",
    "max",
    "minimum",
    "maximum",
    "range",
    "std",
    "std dev",
    "stdev",
    "standard deviation",
    "summe",
    "gesamt",
    "mittel",
    "mittelwert",
    "durchschnitt",
    "standardabweichung",
    "spannweite",
    "somme",
    "moyenne",
    "suma",
    "media",
    "totale",
    "合计",
    "总计",
    "平均",
];

/// The rows at the end that a word calls sums or means.
pub(super) fn summaries(rows: &[Vec<String>], lines: &[usize]) -> Vec<Summary> {
    let of = |row: &Vec<String>, line: usize| {
        let is_word = |cell: &String| {
            let word = cell.trim_end_matches([':', '.']).trim().to_lowercase();
            SUMMARIES.contains(&word.as_str())
        };
        let column = row.iter().position(is_word)?;
        Some(Summary { line, column, word: row[column].clone() })
    };
    let mut found: Vec<Summary> = rows.iter().zip(lines).rev().map_while(|(row, line)| of(row, *line)).collect();
    found.reverse();
    // A table of nothing else is no table with sums at its end.
    if found.len() == rows.len() { Vec::new() } else { found }
}

/// A step of time is a jump from this number of usual steps.
const JUMP: f64 = 10.0;

/// Where times go back, or jump.
pub(super) fn jumps(column: &str, times: &[(usize, f64)], lines: &[usize]) -> Vec<Jump> {
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1].1 - pair[0].1).filter(|step| *step > 0.0).collect();
    steps.sort_by(f64::total_cmp);
    let Some(&usual) = steps.get(steps.len() / 2) else { return Vec::new() };
    let found = times.windows(2).filter_map(|pair| {
        let step = pair[1].1 - pair[0].1;
        let is_jump = step < 0.0 || step > JUMP * usual;
        is_jump.then(|| Jump { column: column.to_owned(), line: lines[pair[1].0], step, usual })
    });
    found.collect()
}
