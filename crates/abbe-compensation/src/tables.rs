//! Tables along axes: what a control adds to the command of an axis at positions of another, or of the same.

use abbe_core::{CommandCorrection, Error, ModelInfo, Result, StatusRole};

/// What is added to the command of an axis, at positions of the same axis or another: linear between the points, constant beyond
/// them. All in mm and rad.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AxisTable {
    /// The axis whose position is looked up: index into [`ModelInfo::axes`].
    pub input: usize,
    /// The axis whose command is corrected.
    pub output: usize,
    /// Increasing positions of the input axis.
    pub positions: Vec<f64>,
    /// What is added where the input axis last moved in its positive direction.
    pub forward: Vec<f64>,
    /// The same for the negative direction.
    pub reverse: Vec<f64>,
    /// The table repeats itself after its last position, which is its first one.
    pub repeats: bool,
}

impl AxisTable {
    /// Whether both tables correct the same axis along the same one.
    pub fn is_for_same_axes(&self, other: &Self) -> bool {
        (self.input, self.output) == (other.input, other.output)
    }

    /// The correction at a position, for a direction of travel; the middle of both if the direction is not known (0).
    pub fn at(&self, position: f64, direction: f64) -> f64 {
        let part = |values: &[f64]| self.interpolated(values, position);
        match direction {
            direction if direction > 0.0 => part(&self.forward),
            direction if direction < 0.0 => part(&self.reverse),
            _ => f64::midpoint(part(&self.forward), part(&self.reverse)),
        }
    }

    fn interpolated(&self, values: &[f64], position: f64) -> f64 {
        let (Some(first), Some(last)) = (self.positions.first(), self.positions.last()) else { return 0.0 };
        let position = match self.repeats {
            true => first + (position - first).rem_euclid(last - first),
            false => position.clamp(*first, *last),
        };
        let after = self.positions.partition_point(|point| *point <= position).min(self.positions.len() - 1);
        let before = after.saturating_sub(1);
        let length = self.positions[after] - self.positions[before];
        let part = if length > 0.0 { (position - self.positions[before]) / length } else { 0.0 };
        values[before] + part * (values[after] - values[before])
    }

    /// The table with values changed one by one.
    pub fn map(self, change: impl Fn(f64) -> f64) -> Self {
        let changed = |values: Vec<f64>| values.into_iter().map(&change).collect();
        Self { forward: changed(self.forward), reverse: changed(self.reverse), ..self }
    }

    /// The table with the values of another one of the same points added.
    ///
    /// Fails for tables with other points.
    pub fn plus(&self, other: &Self) -> Result<Self> {
        if self.positions != other.positions {
            return Err(Error::usage("tables with different points cannot be added"));
        }
        let sum = |one: &[f64], other: &[f64]| one.iter().zip(other).map(|(one, other)| one + other).collect();
        let (forward, reverse) = (sum(&self.forward, &other.forward), sum(&self.reverse, &other.reverse));
        Ok(Self { forward, reverse, ..self.clone() })
    }

    /// The largest change of the correction between neighbouring points, for the change of position: mm/mm and the like.
    pub fn steepest(&self) -> f64 {
        let slopes = |values: &[f64]| {
            let steps = values.windows(2).zip(self.positions.windows(2));
            steps.map(|(value, place)| ((value[1] - value[0]) / (place[1] - place[0])).abs()).fold(0.0, f64::max)
        };
        slopes(&self.forward).max(slopes(&self.reverse))
    }

    /// Whether travel in both directions is corrected alike.
    pub fn is_same_both_ways(&self) -> bool {
        self.forward == self.reverse
    }

    fn check(&self, axes: usize) -> Result<()> {
        let points = self.positions.len();
        let values = [&self.positions, &self.forward, &self.reverse];
        let is_right = self.input < axes
            && self.output < axes
            && points > 0
            && values.iter().all(|list| list.len() == points && list.iter().all(|value| value.is_finite()))
            && self.positions.windows(2).all(|pair| pair[0] < pair[1])
            && (!self.repeats || points > 1);
        match is_right {
            true => Ok(()),
            false => {
                Err(Error::usage("a table needs increasing positions and a finite value for both directions at each"))
            }
        }
    }
}

/// Several tables: the command of an axis is corrected by their sum, at the programmed commands.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisTables {
    tables: Vec<AxisTable>,
    /// The column with the command of each axis.
    commands: Vec<usize>,
    /// The column with the direction of each axis, if the status has one.
    directions: Vec<Option<usize>>,
    width: usize,
}

impl AxisTables {
    /// Tables for a machine.
    ///
    /// Fails for a table without points, with positions that do not increase, or with values that are no finite numbers.
    pub fn new(info: &ModelInfo, tables: Vec<AxisTable>) -> Result<Self> {
        tables.iter().try_for_each(|table| table.check(info.axes.len()))?;
        let directions = (0..info.axes.len()).map(|axis| info.status_index(&StatusRole::Direction(axis))).collect();
        let commands = info.axes.iter().map(|axis| axis.status).collect();
        Ok(Self { tables, commands, directions, width: info.status.len().max(1) })
    }
}

impl CommandCorrection for AxisTables {
    fn commands(&self, programmed: &[f64]) -> Result<Vec<f64>> {
        if !programmed.len().is_multiple_of(self.width) {
            let (values, width) = (programmed.len(), self.width);
            return Err(Error::usage(format!("{values} numbers are no statuses of {width} values each")));
        }
        let mut found = programmed.to_vec();
        for (status, programmed) in found.chunks_mut(self.width).zip(programmed.chunks(self.width)) {
            for table in &self.tables {
                let direction = self.directions[table.input].map_or(0.0, |column| programmed[column]);
                status[self.commands[table.output]] += table.at(programmed[self.commands[table.input]], direction);
            }
        }
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(repeats: bool) -> AxisTable {
        AxisTable {
            positions: vec![-10.0, 0.0, 20.0],
            forward: vec![1.0, 0.0, 1.0],
            reverse: vec![3.0, -2.0, 3.0],
            repeats,
            ..AxisTable::default()
        }
    }

    #[test]
    fn values_are_linear_between_points_and_constant_beyond() {
        let found = |position, direction| table(false).at(position, direction);
        assert_eq!(
            [-99.0, -10.0, -5.0, 0.0, 5.0, 20.0, 21.0].map(|at| found(at, 1.0)),
            [1.0, 1.0, 0.5, 0.0, 0.25, 1.0, 1.0]
        );
        assert_eq!([-99.0, -5.0, 0.0, 10.0, 21.0].map(|at| found(at, -1.0)), [3.0, 0.5, -2.0, 0.5, 3.0]);
        assert_eq!(found(0.0, 0.0), -1.0);
        assert_eq!(table(false).steepest(), 0.5);
    }

    #[test]
    fn a_table_can_repeat_itself() {
        for position in [-10.0, -7.5, 0.0, 3.0, 19.0] {
            for turns in [-2.0, 1.0, 3.0] {
                let there = table(true).at(position + 30.0 * turns, 1.0);
                assert!((there - table(false).at(position, 1.0)).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn what_is_no_table_is_refused() {
        let info = ModelInfo::default();
        assert!(AxisTables::new(&info, vec![table(false)]).is_err());
        assert!(AxisTable { positions: vec![0.0, 0.0, 1.0], ..table(false) }.check(1).is_err());
        assert!(AxisTable { forward: vec![0.0, f64::NAN, 1.0], ..table(false) }.check(1).is_err());
        assert!(AxisTable { reverse: vec![0.0], ..table(false) }.check(1).is_err());
        assert!(table(true).check(1).is_ok());
        let other = AxisTable { positions: vec![-10.0, 0.0, 21.0], ..table(false) };
        assert!(table(false).plus(&other).is_err());
    }
}
