//! Files with tables that are active in the control already.

use std::path::Path;

use abbe_compensation::AxisTable;
use abbe_compensation::active::{Believed, positions_in_file};
use abbe_core::{Error, KinematicModel, Result};
use abbe_files::{LARGEST_TEXT, read_text};
use abbe_volumetric::position_unit;

/// The text of a file that a setting names.
pub fn text(path: &Path) -> Result<String> {
    read_text(path, LARGEST_TEXT)
        .map_err(|error| Error::data(format!("it cannot be read: {error}")).in_file(path).setting("existing"))
}

/// An error at a line of such a file, counted from 0.
pub fn wrong(path: &Path, line: usize, message: impl Into<String>) -> Error {
    Error::data(message).at(path, line + 1, None).setting("existing")
}

/// A table with the lines of its points, forward and reverse, counted from 0.
pub struct Placed<'a> {
    pub table: &'a AxisTable,
    pub lines: [&'a [usize]; 2],
}

impl Placed<'_> {
    /// Refuses values that are not believed, and points on less than half of the axis along which they stand.
    pub fn check(&self, believed: &Believed<'_>, path: &Path, model: &dyn KinematicModel) -> Result<()> {
        let axes = &model.info().axes;
        let (Some(input), Some(output)) = (axes.get(self.table.input), axes.get(self.table.output)) else {
            return Ok(());
        };
        let factor = position_unit(output).1;
        let is_believed = || {
            for (values, lines) in [&self.table.forward, &self.table.reverse].into_iter().zip(self.lines) {
                for (value, line) in values.iter().zip(lines) {
                    let help = "are unit and layout those of the file?";
                    believed.value(output.kind, value * factor, path, line + 1, help)?;
                }
            }
            // The points of a turn lie anywhere; those that do not increase are refused with a better message.
            let positions = positions_in_file(input, &self.table.positions);
            let increases = positions.windows(2).all(|pair| pair[0] < pair[1]);
            let first = self.lines[0].first().map(|line| line + 1);
            match self.table.repeats || !increases {
                true => Ok(()),
                false => believed.coverage(input, &positions, path, first),
            }
        };
        is_believed().map_err(|error: Error| error.setting("existing"))
    }
}
