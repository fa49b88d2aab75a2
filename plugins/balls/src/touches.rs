//! The equations of balls: touches, centres, distances and certified diameters.

use abbe_core::{Equations, Observations, ObservationsInfo, Result, RowBatch, RowIndex};
use abbe_probe::EffectiveRadius;
use nalgebra::{Matrix3, Vector3};

use crate::Rows;
use crate::form::Form;
use crate::size::{CertifiedDiameter, Size};

/// A ball that was touched: its nominal centre and where its unknowns stand.
#[derive(Debug, Clone)]
pub struct TouchedBall {
    /// Table frame, mm.
    pub centre: Vector3<f64>,
    /// The unknown x; y and z follow.
    pub first: usize,
    pub size: Size,
    /// The first coefficient of its form.
    pub form: usize,
}

/// Touches on balls.
pub struct Touches {
    pub info: ObservationsInfo,
    pub balls: Vec<TouchedBall>,
    pub ball_of_row: Vec<usize>,
    /// Of centres that were fitted: their derivative to the stylus radius.
    pub centre_by_radius: Vec<Vector3<f64>>,
    pub distances: Vec<(usize, usize)>,
    /// The input of the first distance.
    pub first_distance: usize,
    pub diameters: Vec<CertifiedDiameter>,
    pub rows: Rows,
    pub radius: EffectiveRadius,
    pub form: Form,
}

impl Touches {
    fn centre(&self, ball: usize, own: &[f64]) -> Vector3<f64> {
        let TouchedBall { centre, first, .. } = &self.balls[ball];
        centre + Vector3::new(own[*first], own[first + 1], own[first + 2])
    }

    /// What another stylus radius than that of the fit changes in the centre of a row.
    fn by_stylus(&self, row: usize, inputs: &[f64]) -> Vector3<f64> {
        let by_radius = self.centre_by_radius.get(row).copied().unwrap_or_default();
        by_radius * (inputs[0] - self.info.inputs[0].value)
    }

    /// Derivatives to the offsets of a ball's centre.
    fn by_centre(&self, ball: usize, derivative: Vector3<f64>, out: &mut Equations) {
        for (axis, value) in derivative.iter().enumerate() {
            out.own(self.balls[ball].first + axis, *value);
        }
    }

    /// The equation of one touch.
    fn touch(&self, row: RowIndex, pose: usize, ball: usize, batch: &RowBatch<'_>, out: &mut Equations) {
        let RowBatch { own, inputs, .. } = *batch;
        let from_centre = Vector3::from(batch.positions[pose]) - self.centre(ball, own);
        let (distance, normal) = (from_centre.norm(), from_centre.normalize());
        let TouchedBall { size, form, .. } = self.balls[ball];
        let (deviation, slope, terms) = self.form.at(&normal, &own[form..form + self.form.len()]);
        let radius = self.radius.at(row, pose, batch, &normal);
        // Form and stylus radius follow the normal, which turns with the tip.
        let turning = (Matrix3::identity() - normal * normal.transpose()) / distance;
        let by_tip = normal - turning * (slope + radius.by_normal);
        radius.write(distance - size.radius(own, inputs) - deviation - radius.value, &by_tip, out);
        self.by_centre(ball, -by_tip, out);
        size.write(-1.0, out);
        terms.iter().enumerate().for_each(|(index, value)| out.own(form + index, -value));
    }

    /// The equation of a constraint: a distance, or a certified diameter.
    fn constraint(&self, index: usize, RowBatch { own, inputs, .. }: &RowBatch<'_>, out: &mut Equations) {
        let Some(&(from, to)) = self.distances.get(index) else {
            self.diameters[index - self.distances.len()].write(own, inputs, out);
            return;
        };
        let (between, input) = (self.centre(to, own) - self.centre(from, own), self.first_distance + index);
        out.equation(between.norm() - inputs[input]);
        self.by_centre(to, between.normalize(), out);
        self.by_centre(from, -between.normalize(), out);
        out.input(input, -1.0);
    }

    /// The equations of a centre.
    fn fitted_centre(&self, row: usize, pose: usize, ball: usize, batch: &RowBatch<'_>, out: &mut Equations) {
        let from_centre = Vector3::from(batch.positions[pose]) - self.centre(ball, batch.own);
        let off = from_centre + self.by_stylus(row, batch.inputs);
        for axis in 0..3 {
            let mut unit = [0.0; 3];
            unit[axis] = 1.0;
            out.equation(off[axis]);
            out.position(unit);
            out.own(self.balls[ball].first + axis, -1.0);
            if let Some(by_radius) = self.centre_by_radius.get(row) {
                out.input(0, by_radius[axis]);
            }
        }
    }
}

impl Observations for Touches {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        let mut pose = 0;
        for &row in batch.rows {
            let Some(&ball) = self.ball_of_row.get(row.0) else {
                self.constraint(row.0 - self.ball_of_row.len(), &batch, out);
                continue;
            };
            match self.rows {
                Rows::Touches => self.touch(row, pose, ball, &batch, out),
                Rows::Centres => self.fitted_centre(row.0, pose, ball, &batch, out),
            }
            pose += 1;
        }
        Ok(())
    }

    fn contact_tip(
        &self,
        RowIndex(row): RowIndex,
        tip: [f64; 3],
        own: &[f64],
        inputs: &[f64],
    ) -> Result<Option<[f64; 3]>> {
        let Some(&ball) = self.ball_of_row.get(row) else { return Ok(None) };
        let centre = self.centre(ball, own);
        if self.rows == Rows::Centres {
            return Ok(Some((centre - self.by_stylus(row, inputs)).into()));
        }
        let TouchedBall { size, form, .. } = self.balls[ball];
        let has_form = own[form..form + self.form.len()].iter().any(|coefficient| *coefficient != 0.0);
        if has_form || !self.radius.is_constant(inputs) {
            return Ok(None);
        }
        let Some(outward) = (Vector3::from(tip) - centre).try_normalize(0.0) else { return Ok(None) };
        Ok(Some((centre + (size.radius(own, inputs) + inputs[0]) * outward).into()))
    }
}
