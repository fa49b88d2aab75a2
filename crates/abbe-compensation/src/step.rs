//! One step of a set-point: rotary axes turn the tool axis, linear axes move the tip.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Singular values below this part of the largest are those of directions that the axes cannot correct.
const LOST: f64 = 1e-6;

/// Linear axes are parallel if their smallest singular value over the largest is below this: what they cannot correct stays.
const PARALLEL: f64 = 1e-3;

/// Which components of the tip are corrected.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Task {
    /// All of them; the weights matter where they cannot all be corrected.
    Components(Vector3<f64>),
    /// The component in this direction.
    Along(Vector3<f64>),
}

impl Task {
    /// The rows that have to vanish, of vectors in the table frame.
    fn rows(&self, vectors: &[Vector3<f64>]) -> DMatrix<f64> {
        match self {
            Self::Components(weights) => {
                DMatrix::from_fn(3, vectors.len(), |row, column| weights[row] * vectors[column][row])
            }
            Self::Along(direction) => DMatrix::from_fn(1, vectors.len(), |_, column| direction.dot(&vectors[column])),
        }
    }

    /// Whether steps of axes move the tip along the sensitive direction, if there is one.
    pub(crate) fn is_moved_by(&self, derivatives: &[Vector3<f64>]) -> bool {
        match self {
            // What linear axes cannot correct stays, or rotary axes do it.
            Self::Components(_) => true,
            Self::Along(direction) => derivatives.iter().any(|derivative| direction.dot(derivative).abs() > PARALLEL),
        }
    }
}

/// How far an axis may be corrected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bounds {
    pub least: f64,
    pub most: f64,
}

impl Bounds {
    fn contain(self, value: f64) -> bool {
        value >= self.least && value <= self.most
    }
}

/// Total corrections of rotary axes, and whether the bound is reached.
///
/// `change` is what the tool axis lacks, `derivatives` what it changes with each axis (vectors in the table frame, both orthogonal to
/// the tool axis but for second order), `so_far` the corrections until now. In the directions of the singular vectors corrections are
/// independent of each other: each is held at the bound by itself, the one that turns the tool axis most goes first. So accuracy is
/// lost only where a command would be beyond the bound.
pub(crate) fn rotary_corrections(
    change: &Vector3<f64>,
    derivatives: &[Vector3<f64>],
    so_far: &[f64],
    bound: f64,
) -> (Vec<f64>, bool) {
    let axes = derivatives.len();
    let matrix = DMatrix::from_fn(3, axes, |row, column| derivatives[column][row]);
    let svd = matrix.svd(true, true);
    let (Some(u), Some(v_t)) = (&svd.u, &svd.v_t) else { return (so_far.to_vec(), false) };
    let mut order: Vec<usize> = (0..svd.singular_values.len()).collect();
    order.sort_by(|a, b| svd.singular_values[*b].total_cmp(&svd.singular_values[*a]));
    let largest = order.first().map_or(0.0, |&first| svd.singular_values[first]);
    let (mut total, mut is_bounded) = (vec![0.0; axes], false);
    for index in order {
        let value = svd.singular_values[index];
        let direction = v_t.row(index);
        let before: f64 = direction.iter().zip(so_far).map(|(part, so_far)| part * so_far).sum();
        // A direction that turns the tool axis about itself, or not at all, stays as it is.
        let is_spanned = largest > 0.0 && value > LOST * largest.max(LOST);
        let wanted = if is_spanned { before + u.column(index).dot(change) / value } else { before };
        let mut allowed = Bounds { least: f64::NEG_INFINITY, most: f64::INFINITY };
        for (part, total) in direction.iter().zip(&total).filter(|(part, _)| part.abs() > f64::EPSILON) {
            let ends = [(-bound - total) / part, (bound - total) / part];
            allowed.least = allowed.least.max(ends[0].min(ends[1]));
            allowed.most = allowed.most.min(ends[0].max(ends[1]));
        }
        // Rounding of the sums before can leave nothing between the ends.
        let held = wanted.min(allowed.most.max(allowed.least)).max(allowed.least);
        is_bounded |= !allowed.contain(wanted);
        for (total, part) in total.iter_mut().zip(direction.iter()) {
            *total += held * part;
        }
    }
    (total, is_bounded)
}

/// Steps of linear axes with which the tip moves by `change`, as well as they can; and which of them are held at the ends of
/// `travel` (the steps that are left of it).
pub(crate) fn linear_steps(
    task: &Task,
    change: &Vector3<f64>,
    derivatives: &[Vector3<f64>],
    travel: &[Bounds],
) -> (Vec<f64>, Vec<bool>) {
    let axes = derivatives.len();
    let (mut steps, mut held) = (vec![0.0; axes], vec![false; axes]);
    // Nearly always that is all there is to do.
    if let Some(found) = of_three(task, change, derivatives)
        && travel.iter().zip(&found).all(|(travel, step)| travel.contain(*step))
    {
        steps.copy_from_slice(&found);
        return (steps, held);
    }
    loop {
        let free: Vec<usize> = (0..axes).filter(|&axis| !held[axis]).collect();
        if free.is_empty() {
            return (steps, held);
        }
        let by_held = (0..axes).filter(|&axis| held[axis]);
        let rest = by_held.fold(*change, |rest, axis| rest - derivatives[axis] * steps[axis]);
        let columns: Vec<Vector3<f64>> = free.iter().map(|&axis| derivatives[axis]).collect();
        let found = solved(task, &rest, &columns);
        free.iter().zip(&found).for_each(|(&axis, step)| steps[axis] = *step);
        let beyond: Vec<usize> = free.into_iter().filter(|&axis| !travel[axis].contain(steps[axis])).collect();
        if beyond.is_empty() {
            return (steps, held);
        }
        for axis in beyond {
            steps[axis] = steps[axis].clamp(travel[axis].least, travel[axis].most);
            held[axis] = true;
        }
    }
}

/// The steps of three axes that are not nearly parallel: nothing is left.
fn of_three(task: &Task, change: &Vector3<f64>, columns: &[Vector3<f64>]) -> Option<[f64; 3]> {
    let (Task::Components(_), [x, y, z]) = (task, columns) else { return None };
    let matrix = Matrix3::from_columns(&[*x, *y, *z]);
    let steps = (matrix.determinant().abs() > PARALLEL).then(|| matrix.lu().solve(change)).flatten()?;
    Some(steps.into())
}

/// The smallest steps that leave the least.
///
/// Which directions axes cannot correct is judged without weights: these say what matters where not all can be corrected.
fn solved(task: &Task, change: &Vector3<f64>, columns: &[Vector3<f64>]) -> Vec<f64> {
    if let Some(steps) = of_three(task, change, columns) {
        return steps.to_vec();
    }
    let plain = match task {
        Task::Components(_) => Task::Components(Vector3::repeat(1.0)),
        Task::Along(_) => task.clone(),
    };
    let svd = plain.rows(columns).svd(true, true);
    let largest = svd.singular_values.iter().copied().fold(0.0, f64::max);
    // A step of 1 mm moves the tip by 1 mm, in some direction.
    let spanned = |value: &f64| *value > PARALLEL * largest.max(1.0);
    let Some(v_t) = &svd.v_t else { return vec![0.0; columns.len()] };
    let kept: Vec<usize> =
        (0..svd.singular_values.len()).filter(|&index| spanned(&svd.singular_values[index])).collect();
    if kept.is_empty() {
        return vec![0.0; columns.len()];
    }
    let directions = DMatrix::from_fn(columns.len(), kept.len(), |axis, index| v_t[(kept[index], axis)]);
    let weighted = task.rows(columns) * &directions;
    let change = DVector::from_column_slice(task.rows(&[*change]).as_slice());
    let parts = weighted.svd(true, true).solve(&change, 0.0);
    parts.map_or_else(|_| vec![0.0; columns.len()], |parts| (directions * parts).iter().copied().collect())
}
