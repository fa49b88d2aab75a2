//! Lobing of a touch probe.

use abbe_core::{Contact, Equations, Poses, Problem, Result};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Lobing of a probe: how its pre-travel varies with the direction of contact.
///
/// A touch is off by `amplitude * cos(lobes * azimuth + phase) * sin²(polar angle)` along the direction of contact, with the
/// angles of that direction in the frame of the tool: a probe with three contacts has three lobes across its axis and none
/// along it (Rahman 2016, section 7.3).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lobing {
    /// Amplitude, mm.
    pub amplitude: f64,
    /// Number of lobes on a turn.
    pub lobes: u32,
    /// Phase, rad.
    pub phase: f64,
}

impl Lobing {
    /// The variation of the pre-travel in this direction of contact (tool frame, unit vector), mm.
    pub fn pretravel_variation(&self, direction: [f64; 3]) -> f64 {
        let [x, y, _] = direction;
        self.amplitude * (f64::from(self.lobes) * y.atan2(x) + self.phase).cos() * (x * x + y * y)
    }
}

/// The direction of contact of every equation, from the touched feature to the probe, unit vector in the tool frame; none
/// where an equation is not that of a single touch.
pub fn contact_directions(problem: &Problem) -> Result<Vec<Option<[f64; 3]>>> {
    let mut directions = Vec::with_capacity(problem.equations());
    let (mut poses, mut equations) = (Poses::default(), Equations::default());
    for set in &problem.sets {
        let layout = &set.info().layout;
        for &index in &set.rows {
            let row = layout.rows[index];
            if row.poses != 1 || row.equations != 1 || set.info().contact != Contact::LinearAxes {
                directions.extend(std::iter::repeat_n(None, row.equations));
                continue;
            }
            problem.model.poses(set.poses().row(row.first_pose), &problem.machine_values, &[], true, &mut poses)?;
            equations.clear();
            let inputs = set.inputs_with(&problem.machine_values);
            set.observations.evaluate(set.batch(&[index], &poses, &inputs), &mut equations)?;
            let [w, x, y, z] = poses.orientations[0];
            let tool = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
            let normal = Vector3::from(equations.by_position()[0]).try_normalize(0.0);
            directions.push(normal.map(|normal| tool.inverse_transform_vector(&normal).into()));
        }
    }
    Ok(directions)
}
