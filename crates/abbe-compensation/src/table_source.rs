//! Tables along axes from a calibration.

use std::collections::BTreeMap;

use abbe_core::{
    Absent, AxisKind, Calibration, Error, KinematicModel, ParameterRole, Result, StatusRole, machine_values,
};

use crate::tables::AxisTable;
use crate::{Compensator, Settings, check_confounded};

/// Parts of a direction below this are zero.
const SMALL: f64 = 1e-9;

/// A calibrated machine that tables are made for.
///
/// A table along an axis has the exact corrections of commands while this axis moves and all others stand at a reference place, minus
/// the correction at that place: so the sum over axes counts the place once. Directions of the axes that stand are in the middle of
/// their reversal (0).
pub struct TableSource<'a> {
    model: &'a dyn KinematicModel,
    calibration: &'a Calibration,
    values: Vec<f64>,
    reference: Vec<f64>,
    settings: Settings,
}

impl<'a> TableSource<'a> {
    /// For a machine, with a reference place: commands, mm or rad, by the index of their axis; of others zero, or the middle of their
    /// range if zero is outside. `largest_mm` is the largest correction of the tip that is believed.
    pub fn new(
        model: &'a dyn KinematicModel,
        calibration: &'a Calibration,
        at: &BTreeMap<usize, f64>,
        largest_mm: f64,
    ) -> Self {
        let info = model.info();
        let axis_at = |column: usize| info.axes.iter().position(|axis| axis.status == column);
        let place = |axis: usize| {
            let range = info.axes[axis].range.filter(|[from, to]| *from > 0.0 || *to < 0.0);
            at.get(&axis).copied().unwrap_or_else(|| range.map_or(0.0, |[from, to]| f64::midpoint(from, to)))
        };
        let columns = info.status.iter().enumerate();
        let reference = columns
            .map(|(index, column)| match (axis_at(index), &column.role, column.absent) {
                (Some(axis), ..) => place(axis),
                (_, StatusRole::Direction(_), _) => 0.0,
                (.., Absent::Default(value)) => value,
                (.., Absent::Required) => f64::NAN,
            })
            .collect();
        let settings = Settings { largest_tip_correction_mm: largest_mm, ..Settings::default() };
        Self { model, calibration, values: machine_values(model, calibration), reference, settings }
    }

    /// The place of an axis, mm or rad, while another one moves.
    pub fn place(&self, axis: usize) -> f64 {
        self.reference[self.model.info().axes[axis].status]
    }

    /// The table that corrects a linear axis along any axis, or a rotary axis along itself. If `turned` lists rotary axes, tables of
    /// these correct their own positioning errors: what is left is corrected here.
    ///
    /// Fails where the model has no pose, where corrections are not believed, or if the calibration does not determine them.
    pub fn table(&self, output: usize, input: usize, positions: &[f64], turned: &[usize]) -> Result<AxisTable> {
        let points = positions.len();
        let mut statuses = Vec::with_capacity((2 * points + 1) * self.reference.len());
        statuses.extend(&self.reference);
        for direction in [1.0, -1.0] {
            positions.iter().for_each(|position| statuses.extend(self.status(input, *position, direction)));
        }
        check_confounded(self.model, self.calibration, &statuses)?;
        let found = match self.model.info().axes[output].kind {
            AxisKind::Linear => self.linear(output, &statuses, turned)?,
            AxisKind::Rotary if output == input => self.rotary(output, &statuses)?,
            AxisKind::Rotary => return Err(Error::usage("a rotary axis is corrected along itself only")),
        };
        let values: Vec<f64> = found[1..].iter().map(|value| value - found[0]).collect();
        let (forward, reverse) = values.split_at(points);
        let (positions, forward, reverse) = (positions.to_vec(), forward.to_vec(), reverse.to_vec());
        Ok(AxisTable { input, output, positions, forward, reverse, repeats: false })
    }

    /// The largest difference between a table and the exact correction in the middle between its points. It is the error of the
    /// linear interpolation, as far as the curvature does not change much between neighbouring points.
    pub fn interpolation(&self, table: &AxisTable, turned: &[usize]) -> Result<f64> {
        let middles: Vec<f64> = table.positions.windows(2).map(|pair| f64::midpoint(pair[0], pair[1])).collect();
        let exact = self.table(table.output, table.input, &middles, turned)?;
        let off = |direction: f64, values: &[f64]| {
            let middles = middles.iter().zip(values);
            middles.map(|(place, value)| (table.at(*place, direction) - value).abs()).fold(0.0, f64::max)
        };
        Ok(off(1.0, &exact.forward).max(off(-1.0, &exact.reverse)))
    }

    /// The correction at the reference place, which no table contains.
    pub fn constant(&self, output: usize, turned: &[usize]) -> Result<f64> {
        let found = match self.model.info().axes[output].kind {
            AxisKind::Linear => self.linear(output, &self.reference, turned)?,
            AxisKind::Rotary => self.rotary(output, &self.reference)?,
        };
        Ok(found.first().copied().unwrap_or_default())
    }

    fn status(&self, axis: usize, position: f64, direction: f64) -> Vec<f64> {
        let info = self.model.info();
        let mut status = self.reference.clone();
        status[info.axes[axis].status] = position;
        if let Some(column) = info.status_index(&StatusRole::Direction(axis)) {
            status[column] = direction;
        }
        status
    }

    /// Corrections of the command of a linear axis.
    fn linear(&self, output: usize, statuses: &[f64], turned: &[usize]) -> Result<Vec<f64>> {
        let values = self.without_own_errors(turned)?;
        let compensator = Compensator::new(self.model, &values, &self.settings)?.beyond_travel_too();
        let (corrected, _) = compensator.correct(statuses)?;
        let column = self.model.info().axes[output].status;
        let own = |all: &[f64]| all.chunks(self.reference.len()).map(|status| status[column]).collect::<Vec<_>>();
        Ok(own(&corrected).iter().zip(own(statuses)).map(|(corrected, programmed)| corrected - programmed).collect())
    }

    /// Corrections of the command of a rotary axis by its own positioning error.
    fn rotary(&self, axis: usize, statuses: &[f64]) -> Result<Vec<f64>> {
        let info = self.model.info();
        let of_axis = &info.axes[axis];
        let own = info.error_functions.iter().filter(|function| function.axis == axis && function.component >= 3);
        let parts: Vec<_> = own.map(|function| (of_axis.direction[function.component - 3], function)).collect();
        let correction = |status: &[f64]| -> Result<f64> {
            let mut sum = 0.0;
            for (part, function) in parts.iter().filter(|(part, _)| part.abs() > SMALL) {
                sum -= of_axis.sense * part * self.model.motion_error(function, &self.values, status)?.value;
            }
            Ok(sum)
        };
        statuses.chunks(self.reference.len()).map(correction).collect()
    }

    /// The values of the parameters, where tables of these rotary axes correct their own positioning errors.
    fn without_own_errors(&self, turned: &[usize]) -> Result<Vec<f64>> {
        let info = self.model.info();
        let mut values = self.values.clone();
        for (index, parameter) in info.parameters.iter().enumerate() {
            let ParameterRole::Motion { axis, component } = parameter.role else { continue };
            let along = component.checked_sub(3).map_or(0.0, |component| info.axes[axis].direction[component].abs());
            if !turned.contains(&axis) || along < SMALL {
                continue;
            }
            if along < 1.0 - SMALL {
                let name = &info.axes[axis].name;
                let message = format!(
                    "{name} is not parallel to X, Y or Z: its own table and others would correct the same error"
                );
                return Err(Error::usage(message).help("leave out its positioning or its cross tables"));
            }
            values[index] = info.nominal[index];
        }
        Ok(values)
    }
}
