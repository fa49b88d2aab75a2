//! From touches to centres: the least squares sphere of known radius through the touches of a ball at one indexation.

use std::collections::BTreeMap;
use std::sync::Arc;

use abbe_core::{
    AxisKind, DataRow, Dataset, Error, KinematicModel, Layout, PoseIndex, Poses, Result, Variable, plain_naming,
};
use nalgebra::{Matrix3, Vector3};

use crate::Ball;

/// The touches of one ball at one indexation.
struct Group {
    ball: usize,
    /// The data row of every touch, and its pose in the layout of touches.
    touches: Vec<(DataRow, PoseIndex)>,
}

/// A centre in the table frame, by the nominal machine.
struct Centre {
    centre: Vector3<f64>,
    /// Standard uncertainties of its coordinates per unit of the standard uncertainty of a touch.
    spread: [f64; 3],
    /// Its derivative to the radius of the fit: zero if the touches lie all around the ball.
    by_radius: Vector3<f64>,
}

/// Centres instead of touches.
pub struct Centres {
    /// One row for every centre.
    pub layout: Layout,
    /// The ball of every row.
    pub ball_of_row: Vec<usize>,
    /// For every row the derivative of the centre to the effective stylus radius, table frame.
    pub by_radius: Vec<Vector3<f64>>,
}

/// A layout with one row for every ball and label of the column `by`: the pose at which the tip of the nominal machine is at
/// the centre of the touches.
///
/// Correlations of a centre's coordinates are left out; touches along the coordinate axes and their diagonals have none.
/// Fails for touches of one centre at different rotary positions, and where they do not determine it.
pub fn of_touches(
    data: &Arc<Dataset>,
    model: &dyn KinematicModel,
    touched: &[(DataRow, usize)],
    balls: &[Ball],
    by: &str,
    uncertainty: f64,
) -> Result<Centres> {
    let labels = abbe_table::labels(data, by).map_err(|error| error.setting("centres_by"))?;
    let mut touches = Layout::new(data, model, &[&plain_naming])?;
    for (row, _) in touched {
        touches.push(model, *row, &[uncertainty])?;
    }
    let mut index: BTreeMap<(usize, &str), usize> = BTreeMap::new();
    let mut groups: Vec<Group> = Vec::new();
    for (&(data_row, ball), pose) in touched.iter().zip(touches.poses.indices()) {
        let place = *index.entry((ball, &labels[data_row])).or_insert_with(|| {
            groups.push(Group { ball, touches: Vec::new() });
            groups.len() - 1
        });
        groups[place].touches.push((data_row, pose));
    }
    let (mut layout, mut by_radius) = (Layout::new(data, model, &[&plain_naming])?, Vec::new());
    for group in &groups {
        let first = group.touches[0].0;
        let wrong = |message: String| data.error_at(first, message);
        let status = mean_status(&touches, model, group).map_err(wrong)?;
        let tips = tips(&touches, model, group)?;
        let ball = &balls[group.ball];
        let centre = centre(&tips, ball.centre, ball.radius + model.info().stylus_radius).ok_or_else(|| {
            wrong(format!(
                "{} touches of ball {} with {by} {} do not determine its centre",
                tips.len(),
                ball.label,
                labels[first]
            ))
            .help(
                "three touches or more in different directions are needed; if there are, the recorded positions do not lie around this \
                 ball: a sign, a unit, a place or the length of the tool may be wrong",
            )
        })?;
        let pose = layout.poses.end();
        layout.push(model, first, &centre.spread.map(|spread| spread * uncertainty))?;
        layout.merged.extend(group.touches[1..].iter().map(|(data_row, _)| *data_row));
        layout.poses.row_mut(pose).copy_from_slice(&reach(model, status, centre.centre)?);
        by_radius.push(centre.by_radius);
    }
    Ok(Centres { layout, ball_of_row: groups.iter().map(|group| group.ball).collect(), by_radius })
}

/// The mean of the statuses of a group; those of rotary axes have to be the same.
fn mean_status(touches: &Layout, model: &dyn KinematicModel, group: &Group) -> Result<Vec<f64>, String> {
    let rows: Vec<&[f64]> = group.touches.iter().map(|(_, pose)| touches.poses.row(*pose)).collect();
    for axis in model.info().axes.iter().filter(|axis| axis.kind == AxisKind::Rotary) {
        if rows.iter().any(|row| (row[axis.status] - rows[0][axis.status]).abs() > 1e-9) {
            return Err(format!("touches of one centre are to be made at one position of {}", axis.name));
        }
    }
    let mean = |column: usize| rows.iter().map(|row| row[column]).sum::<f64>() / rows.len() as f64;
    Ok((0..rows[0].len()).map(mean).collect())
}

/// Where the tips of a group are by the nominal machine, table frame.
fn tips(touches: &Layout, model: &dyn KinematicModel, group: &Group) -> Result<Vec<Vector3<f64>>> {
    let statuses: Vec<f64> = group.touches.iter().flat_map(|(_, pose)| touches.poses.row(*pose).to_vec()).collect();
    let mut poses = Poses::default();
    model.poses(&statuses, &model.info().nominal, &[], false, &mut poses)?;
    Ok(poses.positions.iter().map(|position| Vector3::from(*position)).collect())
}

/// The least squares sphere of a given radius through tips, from a start near it; none if they do not determine it.
fn centre(tips: &[Vector3<f64>], start: Vector3<f64>, radius: f64) -> Option<Centre> {
    let mut centre = start;
    for _ in 0..50 {
        let (mut normal, mut right, mut sum) = (Matrix3::zeros(), Vector3::zeros(), Vector3::zeros());
        for tip in tips {
            let direction = (tip - centre).try_normalize(0.0)?;
            normal += direction * direction.transpose();
            right += direction * ((tip - centre).norm() - radius);
            sum += direction;
        }
        // Directions that are within a few degrees of a plane do not determine the centre well enough.
        if normal.symmetric_eigenvalues().min() < 1e-2 {
            return None;
        }
        let inverse = normal.try_inverse()?;
        let step = inverse * right;
        centre += step;
        if step.norm() < 1e-12 * (1.0 + centre.norm()) {
            // At the minimum the sum of n (|tip - centre| - radius) is zero for every radius: N'N dc + N'1 dr = 0.
            let (spread, by_radius) = ([0, 1, 2].map(|axis| inverse[(axis, axis)].sqrt()), -(inverse * sum));
            return Some(Centre { centre, spread, by_radius });
        }
    }
    None
}

/// The status at which the tip of the nominal machine is at a point of the table frame, by its linear axes.
fn reach(model: &dyn KinematicModel, mut status: Vec<f64>, point: Vector3<f64>) -> Result<Vec<f64>> {
    let linear = model.info().axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Linear);
    let (commands, columns): (Vec<Variable>, Vec<usize>) =
        linear.map(|(index, axis)| (Variable::Command(index), axis.status)).unzip();
    let nominal = &model.info().nominal;
    let mut poses = Poses::default();
    for _ in 0..20 {
        model.poses(&status, nominal, &commands, false, &mut poses)?;
        let off = point - Vector3::from(poses.positions[0]);
        if off.norm() < 1e-11 * (1.0 + point.norm()) {
            return Ok(status);
        }
        let moves = nalgebra::DMatrix::from_fn(3, commands.len(), |row, k| poses.position_derivatives[k][row]);
        let step = moves.svd(true, true).solve(&nalgebra::DVector::from_column_slice(off.as_slice()), 1e-9);
        let step = step.map_err(|message| Error::data(format!("a centre cannot be reached: {message}")))?;
        columns.iter().zip(step.iter()).for_each(|(&column, step)| status[column] += step);
    }
    Err(Error::data("the linear axes cannot bring the tip to the centre of a ball"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_centre_moves_with_the_radius_as_its_derivative_says() {
        // Four touches on the equator and one on the pole, a micrometre off here and there.
        let diagonal = std::f64::consts::FRAC_1_SQRT_2;
        let directions = [(1.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 0.0), (1.0, -1.0, 0.0)]
            .map(|(x, y, z)| diagonal * Vector3::new(x, y, z))
            .into_iter()
            .chain([Vector3::z(), Vector3::new(0.6, 0.0, 0.8)]);
        let place = Vector3::new(100.0, -20.0, 30.0);
        let tips: Vec<Vector3<f64>> = directions
            .enumerate()
            .map(|(index, direction)| place + (12.5 + 1e-3 * (index % 3) as f64) * direction)
            .collect();
        let at = |radius: f64| centre(&tips, place, radius).unwrap();
        let differences = (at(12.5 + 1e-3).centre - at(12.5 - 1e-3).centre) / 2e-3;
        let derivative = at(12.5).by_radius;
        assert!((differences - derivative).norm() < 1e-3, "{differences} {derivative}");
        // With a larger stylus the centre of the fit lies further below the touch on the pole.
        assert!(derivative.z < -0.8, "{derivative}");
        // With the pole alone: by the change of the radius.
        let pole = centre(&tips[..5], place, 12.5).unwrap().by_radius;
        assert!((pole - Vector3::new(0.0, 0.0, -1.0)).norm() < 1e-3, "{pole}");
    }
}
