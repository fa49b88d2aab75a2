//! Plain text tables.

use std::collections::HashSet;

use crate::lines;

/// Blanks between columns, and before the first one.
const GAP: &str = "   ";
const INDENT: &str = "  ";

/// The narrowest column of text that is made narrower.
const NARROW: usize = 10;

/// Rows as aligned text, the first one as header; columns in `right` are aligned to the right.
pub fn text(rows: &[Vec<String>], right: &[usize]) -> String {
    aligned_rows(rows, &marked(right, rows))
}

fn aligned_rows(rows: &[Vec<String>], right: &[bool]) -> String {
    let widths = widths(rows);
    rows.iter().map(|row| aligned(row, &widths, right)).collect()
}

/// Which of the columns are among these; a table may have many.
fn marked(columns: &[usize], rows: &[Vec<String>]) -> Vec<bool> {
    let columns: HashSet<&usize> = columns.iter().collect();
    (0..rows.iter().map(Vec::len).max().unwrap_or(0)).map(|column| columns.contains(&column)).collect()
}

/// The same in lines that are no longer than `width`: words of columns of text are set below one another; if that is not enough,
/// the columns stand in blocks below one another, each with the first `kept` ones.
pub fn within(rows: &[Vec<String>], right: &[usize], kept: usize, width: usize) -> String {
    let (natural, right) = (widths(rows), marked(right, rows));
    if total(&natural) <= width {
        return aligned_rows(rows, &right);
    }
    let longest_word = |column: usize| {
        let words = rows.iter().filter_map(|row| row.get(column)).flat_map(|cell| cell.split_whitespace());
        words.map(|word| word.chars().count()).max().unwrap_or(0)
    };
    let mut widths = natural.clone();
    let least: Vec<usize> = (0..widths.len()).map(|column| longest_word(column).max(NARROW)).collect();
    while total(&widths) > width {
        let can_shrink = |column: &usize| !right[*column] && widths[*column] > least[*column];
        let Some(widest) = (0..widths.len()).filter(can_shrink).max_by_key(|column| widths[*column]) else {
            return blocks(rows, &right, kept, width);
        };
        widths[widest] -= 1;
    }
    let mut text = String::new();
    for row in rows {
        let cells: Vec<Vec<String>> = row.iter().zip(&widths).map(|(cell, width)| lines::rows(cell, *width)).collect();
        for line in 0..cells.iter().map(Vec::len).max().unwrap_or(0) {
            let cell = |cell: &Vec<String>| cell.get(line).map_or(String::new(), |part| part.trim().to_owned());
            text.push_str(&aligned(&cells.iter().map(cell).collect::<Vec<_>>(), &widths, &right));
        }
    }
    text
}

/// The columns in blocks below one another.
fn blocks(rows: &[Vec<String>], right: &[bool], kept: usize, width: usize) -> String {
    let widths = widths(rows);
    let mut blocks: Vec<Vec<usize>> = Vec::new();
    for column in kept..widths.len() {
        let fits = |block: &Vec<usize>| {
            let own = block.iter().chain([&column]).map(|column| widths[*column]).collect::<Vec<_>>();
            total(&own) <= width
        };
        match blocks.last_mut().filter(|block| fits(block)) {
            Some(block) => block.push(column),
            None => blocks.push((0..kept).chain([column]).collect()),
        }
    }
    let block = |columns: &Vec<usize>| {
        let of =
            |row: &Vec<String>| columns.iter().map(|column| row.get(*column).cloned().unwrap_or_default()).collect();
        let right: Vec<bool> = columns.iter().map(|column| right[*column]).collect();
        aligned_rows(&rows.iter().map(of).collect::<Vec<_>>(), &right)
    };
    blocks.iter().map(block).collect::<Vec<_>>().join("\n")
}

fn widths(rows: &[Vec<String>]) -> Vec<usize> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    (0..columns).map(width).collect()
}

/// Length of a line.
fn total(widths: &[usize]) -> usize {
    INDENT.len() + widths.iter().sum::<usize>() + GAP.len() * widths.len().saturating_sub(1)
}

fn aligned(row: &[String], widths: &[usize], right: &[bool]) -> String {
    let mut line = String::new();
    for (column, cell) in row.iter().enumerate() {
        // A line end in a name makes no line of its own, which somebody could take for one of the program.
        let cell = cell.replace('\n', "\u{240a}");
        let fill = " ".repeat(widths[column].saturating_sub(cell.chars().count()));
        let (before, after) = if right[column] { (fill.as_str(), "") } else { ("", fill.as_str()) };
        line.push_str(if column == 0 { INDENT } else { GAP });
        line.push_str(&format!("{before}{cell}{after}"));
    }
    line.trim_end().to_owned() + "\n"
}

/// A number to nine digits, without zeros at its end.
pub fn plain(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{}", value + 0.0);
    }
    let scale = 10_f64.powi(8 - value.abs().log10().floor() as i32);
    let rounded = (value * scale).round() / scale;
    if (1e-5..1e12).contains(&value.abs()) { format!("{rounded}") } else { format!("{value:.3e}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_end_in_a_name_makes_no_line() {
        let rows = cells(&[&["machine", "entries"], &["mill\nPASS: all is well", "1"]]);
        for table in [text(&rows, &[1]), within(&rows, &[1], 1, 200)] {
            assert!(table.lines().count() == 2 && table.contains("mill\u{240a}PASS"), "{table}");
        }
    }

    fn cells(rows: &[&[&str]]) -> Vec<Vec<String>> {
        rows.iter().map(|row| row.iter().map(|cell| (*cell).to_owned()).collect()).collect()
    }

    #[test]
    fn tables_fit_by_words_and_then_by_blocks() {
        let words = cells(&[&["error", "what it is"], &["EB0Y", "Y out of square, turned about Y"]]);
        assert_eq!(text(&words, &[]), within(&words, &[], 1, 80));
        let found = within(&words, &[], 1, 26);
        assert_eq!(found, "  error   what it is\n  EB0Y    Y out of square,\n          turned about Y\n");
        let numbers = cells(&[&["", "one", "two", "three"], &["fit", "123456", "2", "3"]]);
        let found = within(&numbers, &[1, 2, 3], 1, 24);
        assert_eq!(found, "           one   two\n  fit   123456     2\n\n        three\n  fit       3\n");
        assert!(found.lines().all(|line| line.chars().count() <= 24));
    }
}
