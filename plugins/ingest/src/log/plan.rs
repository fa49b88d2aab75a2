//! The plan of the touches that a log has: where each was expected, and what else is known of it.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use abbe_core::{Column, DataRow, Dataset, Error, Quantity, Result, Values};
use sha2::{Digest, Sha256};

use super::record::{AXES, is_rotary};

/// The column with the numbers of the touches; without it these are the numbers of the rows.
const TOUCH: &str = "touch";

/// A plan.
pub(crate) struct Plan {
    pub(crate) path: PathBuf,
    pub(crate) data: Dataset,
    /// The row of each touch.
    pub(crate) rows: BTreeMap<u32, DataRow>,
    /// The axes of the plan, by letter.
    pub(crate) axes: Vec<char>,
}

impl Plan {
    /// Reads the plan.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let data = abbe_table::read(path)?;
        let mut rows = BTreeMap::new();
        for row in data.row_indices() {
            let number = match data.column(TOUCH).map(|column| &column.values) {
                Some(Values::Labels(labels)) => labels[row].trim().parse::<u32>().ok().filter(|number| *number > 0),
                _ => u32::try_from(row.0 + 1).ok(),
            };
            let number = number.ok_or_else(|| {
                data.error_at(row, "`touch` is no whole number from 1, which was expected").help(
                    "the number is what the measuring program writes behind T; without the column rows are counted",
                )
            })?;
            if let Some(first) = rows.insert(number, row) {
                let line = data.origins[first].line;
                return Err(data.error_at(row, format!("touch {number} is in line {line} already")));
            }
        }
        let mut axes = Vec::new();
        for axis in AXES {
            let Some(column) = data.column(&axis.to_string()) else { continue };
            let expected = if is_rotary(axis) { Quantity::Angle } else { Quantity::Length };
            if column.header.quantity != expected {
                let message = format!(
                    "the column `{}` is no position of the axis {axis}; `{axis}{}` was expected",
                    column.header.header,
                    expected.usual_suffix()
                );
                return Err(Error::usage(message).in_file(path));
            }
            axes.push(axis);
        }
        if axes.is_empty() {
            let error = Error::usage("the plan has no column with the position of an axis, as `X_mm` or `C_deg`");
            return Err(error
                .in_file(path)
                .help("`plan` names the table of the touches that the measuring program was made from"));
        }
        Ok(Self { path: path.to_owned(), data, rows, axes })
    }

    /// The expected positions of an axis, mm or rad.
    pub(crate) fn positions(&self, axis: char) -> &[f64] {
        self.data.numbers(&axis.to_string()).unwrap_or_default()
    }

    /// What the line `PLAN` of a log has to say.
    pub(crate) fn identity(&self) -> String {
        let mut text = String::new();
        for (number, &row) in &self.rows {
            // A text takes whatever is written into it.
            let _ = write!(text, "T{number}");
            for &axis in &self.axes {
                let position = self.positions(axis)[row];
                let written = format!("{:.6}", if is_rotary(axis) { position.to_degrees() } else { position });
                let is_zero = written.trim_start_matches('-').bytes().all(|it| it == b'0' || it == b'.');
                let _ = write!(text, " {axis}{}", if is_zero { written.trim_start_matches('-') } else { &written });
            }
            text.push('\n');
        }
        Sha256::digest(text.as_bytes()).iter().take(8).map(|byte| format!("{byte:02X}")).collect()
    }

    /// The columns that are no position of an axis and no number of a touch.
    pub(crate) fn further(&self) -> impl Iterator<Item = &Column> {
        let is_axis = |name: &str| self.axes.iter().any(|axis| name.chars().eq([*axis]));
        self.data.columns.iter().filter(move |column| column.header.name != TOUCH && !is_axis(&column.header.name))
    }
}
