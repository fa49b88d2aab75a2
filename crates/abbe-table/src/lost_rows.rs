//! Rows that would be left out as comments: those that begin with an error of a spreadsheet.

use std::path::Path;

use abbe_core::{Error, Result};

/// What spreadsheets write into a cell without a value, and does not end as most of their errors do.
const WITHOUT_VALUE: [&str; 7] = ["#N/A", "#NA", "#NV", "#N/V", "#N/D", "#DIV/0", "#GETTING_DATA"];

/// What separates cells, whatever the table says of itself.
const BETWEEN: [char; 4] = [',', ';', '\t', '|'];

/// Fails for a line that begins with such a cell: it is a row, and would be left out as a comment.
pub(crate) fn no_lost_row(path: &Path, line: usize, comment: &str) -> Result<()> {
    match without_value(comment.trim_end()) {
        None => Ok(()),
        Some(cell) => Err(Error::data(format!("the line begins with `{cell}`, a cell without a value"))
            .at(path, line, None)
            .help("lines that begin with # are comments: take the row out, or put another column first")),
    }
}

/// The first cell of a line, if a spreadsheet wrote it in the place of a value.
fn without_value(line: &str) -> Option<&str> {
    let cell = line.split(BETWEEN).next()?;
    let has_others = cell.len() < line.len();
    if is_error(cell.trim_end(), has_others) {
        return Some(cell.trim_end());
    }
    // Spaces separate columns of numbers, and the words of a comment.
    let (cell, rest) = line.split_once([' ', '\t'])?;
    let is_number = |cell: &str| cell.replace(',', ".").parse::<f64>().is_ok();
    (rest.split_whitespace().all(is_number) && is_error(cell, true)).then_some(cell)
}

/// Whether it is an error of a spreadsheet: `#REF!`, `#NAME?` and `#ÜBERLAUF!` in any language, `#N/A`, or the `####` of a column that is
/// too narrow. What is alone in its line has to be one of those that are known.
fn is_error(cell: &str, has_others: bool) -> bool {
    let Some(name) = cell.strip_prefix('#').filter(|name| !name.is_empty()) else { return false };
    if name.chars().all(|letter| letter == '#') {
        return has_others;
    }
    let is_known = WITHOUT_VALUE.iter().any(|known| known.eq_ignore_ascii_case(cell));
    let word = name.strip_suffix(['!', '?']).unwrap_or_default();
    let is_shouted = |letter: char| matches!(letter, '/' | '_' | '0') || letter.is_uppercase();
    is_known || !word.is_empty() && word.chars().all(is_shouted)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_spreadsheets_are_cells_and_words_are_comments() {
        for line in [
            "#N/A,1,2",
            "#n/a;1",
            "#NV\t2",
            "#N/D,3",
            "#REF!,1",
            "#DIV/0!,1",
            "#DIV/0,1",
            "#NAME?,1",
            "#SPILL!,1",
            "#CALC!",
            "#VALEUR!;2",
            "#ÜBERLAUF!;2",
            "#BEZUG!",
            "########,4",
            "#N/A 1.5 -2e3",
            "### 1,5 2",
            "#NULL!  ,2",
            "#N/A\r",
        ] {
            assert!(without_value(line).is_some(), "{line}");
        }
        for line in [
            "# N/A,1",
            "#N/A values are left out",
            "#NAME",
            "#VALUES! of today,1",
            "#",
            "##",
            "########",
            "#Attention!, cold",
            "#1,2,3",
            "#X_mm,Y_mm",
            "# 1 2",
            "#!",
            "#?",
            "#NAVY,1",
            "#!,2",
            "### results ###",
            "#N/A and 2",
        ] {
            assert_eq!(without_value(line), None, "{line}");
        }
    }
}
