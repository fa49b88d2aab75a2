//! A path: set-points with everything that the errors of a machine depend on.

use std::path::{Path, PathBuf};

use abbe_core::{
    Absent, AxisKind, DataRow, Dataset, Error, KinematicModel, PoseTable, Quantity, Result, StatusRole, StatusSource,
    plain_naming, pose_columns,
};
use abbe_table::Cells;

use crate::path::MARK;

/// Names that axes have (ISO 841). A column with such a name and the unit of a length or an angle commands an axis.
const LETTERS: &str = "XYZABCUVW";

/// The set-points of a path, in their order.
#[derive(Debug, Clone, PartialEq)]
pub struct SetPoints {
    /// The file, and its text.
    path: PathBuf,
    text: String,
    data: Dataset,
    statuses: Vec<f64>,
    /// The axes whose directions of approach are those of the path, by index.
    directions_of_path: Vec<usize>,
}

impl SetPoints {
    /// Reads the set-points of a machine from a CSV file, one a row.
    ///
    /// Every axis needs a column (`X_mm`, `B_deg`); a spindle without one is taken to stand at 0°, with a warning. Directions of
    /// approach (`dir_X`) that the file does not have are those of the path: the sign of the last move; at the first point that of
    /// the next move; +1 before the axis has moved.
    ///
    /// Fails for an axis without a column, a column of an axis that the machine does not have, a value that errors of the machine
    /// depend on and that the file does not have (time, temperature, stylus), and a command that is no number.
    pub fn read(path: &Path, model: &dyn KinematicModel) -> Result<Self> {
        Self::read_at(path, model, None)
    }

    /// The same for set-points that are all commanded at one time, s; NaN leaves out what depends on time.
    ///
    /// Fails as [`read`](Self::read) does, and for a file that has times of its own.
    pub fn read_at(path: &Path, model: &dyn KinematicModel, time: Option<f64>) -> Result<Self> {
        // What is corrected is what was read.
        let text = abbe_table::read_text(path)?;
        let data = abbe_table::parse(path, text.as_bytes())?;
        Ok(Self { path: path.to_owned(), text, ..Self::of_data(data, model, time)? })
    }

    /// The same for set-points that are read. They have no text: only a file can be written again with other commands.
    ///
    /// Fails as [`read_at`](Self::read_at) does.
    pub fn of_data(data: Dataset, model: &dyn KinematicModel, time: Option<f64>) -> Result<Self> {
        let file = data.files.first();
        let in_file = |error: Error| file.map_or_else(|| error.clone(), |file| error.clone().in_file(file));
        let info = model.info();
        for column in &data.columns {
            let (name, is_motion) = (&column.header.name, column.header.quantity);
            let is_axis = name.len() == 1 && LETTERS.contains(name.as_str());
            if is_axis
                && matches!(is_motion, Quantity::Length | Quantity::Angle)
                && !info.axes.iter().any(|axis| axis.name == *name)
            {
                let axes: Vec<&str> = info.axes.iter().map(|axis| axis.name.as_str()).collect();
                let message = format!(
                    "`{}` commands an axis that the machine of the calibration does not have",
                    column.header.header
                );
                return Err(in_file(Error::usage(message).help(format!("its axes are {}", axes.join(", ")))));
            }
        }
        let columns = pose_columns(&data.headers(), file, model, &|status, axis| {
            let (names, absent) = plain_naming(status, axis);
            let absent = match status.role {
                // Those of the path.
                StatusRole::Direction(_) => Absent::Default(f64::NAN),
                // What counts as zero in measurements need not be zero on the path.
                StatusRole::Load | StatusRole::Stylus | StatusRole::Other => Absent::Required,
                _ => absent,
            };
            (names, absent)
        })?;
        let mut poses = PoseTable::new(model);
        for row in data.row_indices() {
            poses.push(&data, row, model, &columns)?;
        }
        let width = info.status.len();
        let mut statuses: Vec<f64> = poses.indices().flat_map(|pose| poses.row(pose).to_vec()).collect();
        let mut directions_of_path = Vec::new();
        for (index, (status, source)) in info.status.iter().zip(&columns).enumerate() {
            match (&status.role, source) {
                (StatusRole::Direction(axis), StatusSource::Taken(_)) => {
                    fill_directions(&mut statuses, width, info.axes[*axis].status, index);
                    directions_of_path.push(*axis);
                }
                (StatusRole::Time, StatusSource::Taken(_)) if time.is_some() => {
                    statuses.chunks_mut(width).for_each(|pose| pose[index] = time.unwrap_or(f64::NAN));
                    continue;
                }
                (StatusRole::Time, _) if time.is_some() => {
                    let error = Error::usage("the set-points have times of their own, and one time was given for all");
                    return Err(in_file(error.help("leave out the time, or the column `time_s`")));
                }
                (StatusRole::Command(axis), StatusSource::Taken(value)) if !value.is_nan() => {
                    let (axis, column) = (&info.axes[*axis], status.quantity.usual_suffix());
                    let (place, unit) = match axis.kind {
                        AxisKind::Rotary => (value.to_degrees(), "°"),
                        AxisKind::Linear => (*value, " mm"),
                    };
                    let name = &axis.name;
                    tracing::warn!("there is no column `{name}{column}`: {name} is taken to stand at {place}{unit}");
                }
                (_, StatusSource::Taken(value)) if value.is_nan() => {
                    let column = format!("{}{}", status.name, status.quantity.usual_suffix());
                    let message = format!(
                        "errors of this machine depend on `{}`: set-points need the column `{column}`",
                        status.name
                    );
                    return Err(in_file(Error::usage(message)));
                }
                _ => {}
            }
            let unknown = statuses.chunks(width.max(1)).position(|pose| pose[index].is_nan());
            if let Some(row) = unknown {
                return Err(
                    data.error_at(DataRow(row), format!("the calibration does not know this `{}`", status.name))
                );
            }
        }
        Ok(Self { path: PathBuf::new(), text: String::new(), data, statuses, directions_of_path })
    }

    /// The statuses, point by point: points x columns of [`ModelInfo::status`](abbe_core::ModelInfo::status).
    pub fn statuses(&self) -> &[f64] {
        &self.statuses
    }

    /// The axes, by their index in the model, of which the file has no directions of approach: they are those of the path.
    pub fn directions_of_path(&self) -> &[usize] {
        &self.directions_of_path
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.data.rows()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The line with the mark of a correction ([`MARK`](crate::MARK)), if these set-points are corrected already.
    pub fn marked(&self) -> Option<usize> {
        let mut lines = (1..).zip(self.text.lines());
        lines.find(|(_, line)| line.starts_with('#') && line.contains(MARK)).map(|(line, _)| line)
    }

    /// The line of a point in its file.
    pub fn line(&self, point: usize) -> usize {
        self.data.origins[DataRow(point)].line
    }

    /// An error about a pose with the line of its point, or with its row if it stands in a table of a program.
    pub fn locate(&self, error: Error) -> Error {
        match error.pose {
            Some(point) if point < self.len() && error.place.is_none() => {
                let origin = self.data.origins[DataRow(point)];
                origin.blame(error, &self.data.files[origin.file])
            }
            _ => error,
        }
    }

    /// Warns with the lines of points.
    pub(crate) fn tell(&self, sentences: &[(usize, String)]) {
        for (point, sentence) in sentences {
            tracing::warn!("{}: {sentence}", self.data.origins[DataRow(*point)].in_file(&self.path));
        }
    }

    /// The text of the file with columns more; all else stays as it is. `cells` are those of a point.
    ///
    /// Fails if the file has one of these columns.
    pub(crate) fn with_more_columns(&self, headers: &[&str], cells: impl Fn(usize) -> Vec<String>) -> Result<String> {
        let cells = (0..self.len()).map(|point| (self.line(point), cells(point))).collect();
        abbe_table::with_columns(&self.path, self.text.as_bytes(), headers, &cells)
    }

    /// The text of the file with other commands, which have nine decimals; all else stays as it is.
    ///
    /// `statuses` are those of all points with other commands.
    pub fn with_commands(&self, model: &dyn KinematicModel, statuses: &[f64]) -> Result<String> {
        let info = model.info();
        let headers = self.data.headers();
        let columns: Vec<(&str, f64, usize)> = (info.axes.iter())
            .filter_map(|axis| {
                let header = headers.iter().find(|header| header.name == axis.name)?;
                let (_, _, factor) = Quantity::of_column(&header.header);
                Some((header.header.as_str(), factor, axis.status))
            })
            .collect();
        let mut cells = Cells::new();
        for (row, (status, before)) in
            statuses.chunks(info.status.len()).zip(self.statuses.chunks(info.status.len())).enumerate()
        {
            // What is not corrected stays as it is written.
            let changed = columns.iter().filter(|(_, _, index)| status[*index] != before[*index]);
            let of_row = changed.map(|(header, factor, index)| {
                // Without the sign of a zero.
                let value = (status[*index] / factor * 1e9).round() / 1e9 + 0.0;
                ((*header).to_owned(), format!("{value:.9}"))
            });
            cells.insert(self.line(row), of_row.collect());
        }
        abbe_table::with_cells(&self.path, self.text.as_bytes(), &cells)
    }
}

/// Writes the directions of the moves of one axis.
fn fill_directions(statuses: &mut [f64], width: usize, command: usize, direction: usize) {
    let commands: Vec<f64> = statuses.chunks(width).map(|pose| pose[command]).collect();
    let directions = directions_of(&commands);
    statuses.chunks_mut(width).zip(directions).for_each(|(pose, of_point)| pose[direction] = of_point);
}

/// The directions of the last moves of an axis: at the first point that of its next move, +1 before it has moved.
pub(crate) fn directions_of(commands: &[f64]) -> Vec<f64> {
    let sign = |move_: f64| if move_ < 0.0 { -1.0 } else { 1.0 };
    let Some(first) = commands.first() else { return Vec::new() };
    let mut directions = vec![commands.get(1).map_or(1.0, |next| sign(next - first))];
    let mut last = 1.0;
    for pair in commands.windows(2) {
        if pair[1] != pair[0] {
            last = sign(pair[1] - pair[0]);
        }
        directions.push(last);
    }
    directions
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_those_of_the_path() {
        let of = directions_of;
        assert_eq!(of(&[0.0, -1.0, -1.0, 2.0, 2.0]), [-1.0, -1.0, -1.0, 1.0, 1.0]);
        assert_eq!(of(&[5.0, 5.0, 4.0, 4.0]), [1.0, 1.0, -1.0, -1.0]);
        assert_eq!(of(&[1.0]), [1.0]);
        assert_eq!(of(&[1.0, 1.0]), [1.0, 1.0]);
    }
}
