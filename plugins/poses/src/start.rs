//! Where target and observer stand, found in closed form with the nominal machine: the robot-world/hand-eye problem.
//!
//! With tool poses T, observed poses O, target G (table frame) and observer C (tool frame), `T C O = G` in every row.
//! Orientations come first, then positions by linear least squares. The equations of the orientations are linear in the 18
//! entries of Rg and Rc (Li, Wang & Wu 2010, Int. J. Phys. Sci. 5:1530); over vectors of fixed length their sum of squares is
//! least for the singular vectors of the largest singular value of `K = mean(O' (x) T)` (Shah 2013, J. Mechanisms Robotics
//! 5:031007), 9 x 9, which are brought back to rotations. Where several singular values are the largest, positions choose among
//! what agrees with all orientations.

use abbe_core::{Error, Result};
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix3, Matrix6, Rotation3, SMatrix, Translation3, UnitQuaternion, Vector3, Vector6,
};

/// Most steps of a singular value decomposition; finite matrices need far fewer.
const STEPS: usize = 1000;

/// Smallest difference of the largest singular value of the mean rotation from 1. It is 1 if all poses share a direction:
/// rotations out of it by less than 1e-4 rad determine nothing.
const SPREAD: f64 = 1e-8;

/// Singular values that are smaller than the largest by less than this part of it are as large: what belongs to them agrees with all
/// orientations.
const ALIKE: f64 = 1e-3;

/// Part of the largest singular value from which positions tell something.
const TOLD: f64 = 1e-9;

/// Smallest determinant of what the positions choose: that of a rotation is 1.
const LEAST_DETERMINANT: f64 = 0.1;

/// If half of the orientations differ by more than this angle, rad, from the nominal machine, the data do not belong to it.
const AGREEMENT: f64 = 0.1;

/// Start poses of target and observer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    /// The target in the table frame, mm.
    pub target: Isometry3<f64>,
    /// The observer in the tool frame, mm.
    pub observer: Isometry3<f64>,
}

/// Target and observer from the nominal poses of the tool in the table frame and the poses of the target in the observer's.
///
/// Fails if the tool turns, relative to the table, about one direction only, or if the orientations do not agree.
pub fn target_and_observer(tools: &[Isometry3<f64>], seen: &[Isometry3<f64>]) -> Result<Start> {
    let mean = mean(tools.iter().map(rotation));
    let spread = decomposed(mean).map(|(_, largest, _)| 1.0 - largest).filter(|spread| *spread > SPREAD);
    let found = spread.and_then(|_| orientations(tools, seen)).and_then(|(target, observer)| {
        let (from, to) = positions(tools, seen, mean, observer)?;
        Some(Start {
            target: Isometry3::from_parts(Translation3::from(from), target),
            observer: Isometry3::from_parts(Translation3::from(to), observer),
        })
    });
    let start = found.ok_or_else(|| {
        let message = format!("{} do not determine where target and observer stand", poses(tools.len()));
        Error::data(message).help(
            "tool and table have to turn relative to each other about two directions at least, which takes three poses; if \
             the observer is the tool, say `observer: at-tool`",
        )
    })?;
    agrees(tools, seen, start)
}

/// The target alone, the observer being the tool; arguments and errors as in [`target_and_observer`].
pub fn target(tools: &[Isometry3<f64>], seen: &[Isometry3<f64>]) -> Result<Start> {
    let in_table: Vec<Isometry3<f64>> = tools.iter().zip(seen).map(|(tool, seen)| tool * seen).collect();
    let orientation = nearest_rotation(mean(in_table.iter().map(rotation)));
    let orientation = orientation.ok_or_else(|| Error::data("the poses do not determine where the target stands"))?;
    let position = in_table.iter().map(|pose| pose.translation.vector).sum::<Vector3<f64>>() / in_table.len() as f64;
    let target = Isometry3::from_parts(Translation3::from(position), orientation);
    agrees(tools, seen, Start { target, observer: Isometry3::identity() })
}

fn poses(count: usize) -> String {
    if count == 1 { "1 pose".to_owned() } else { format!("{count} poses") }
}

fn rotation(pose: &Isometry3<f64>) -> Matrix3<f64> {
    pose.rotation.to_rotation_matrix().into_inner()
}

fn mean(matrices: impl ExactSizeIterator<Item = Matrix3<f64>>) -> Matrix3<f64> {
    let count = matrices.len() as f64;
    matrices.sum::<Matrix3<f64>>() / count
}

/// Orientations of target and observer; none if the numbers are not finite.
fn orientations(
    tools: &[Isometry3<f64>],
    seen: &[Isometry3<f64>],
) -> Option<(UnitQuaternion<f64>, UnitQuaternion<f64>)> {
    let mut product = SMatrix::<f64, 9, 9>::zeros();
    for (tool, seen) in tools.iter().zip(seen) {
        product += rotation(seen).transpose().kronecker(&rotation(tool));
    }
    let product = DMatrix::from_column_slice(9, 9, (product / tools.len() as f64).as_slice());
    let svd = product.try_svd(true, true, f64::EPSILON, STEPS)?;
    let (of_target, of_observer, values) = (svd.u?, svd.v_t?, svd.singular_values);
    let is_largest = |index: &usize| values[*index] >= (1.0 - ALIKE) * values.max();
    let matrices = |index: usize| {
        let target = Matrix3::from_iterator(of_target.column(index).iter().copied());
        (target, Matrix3::from_iterator(of_observer.row(index).iter().copied()))
    };
    let (targets, observers): (Vec<_>, Vec<_>) = (0..9).filter(is_largest).map(matrices).unzip();
    // Singular vectors have no sign of their own; rotations have.
    let alone = vec![observers.first()?.determinant().signum()];
    let parts = match observers.len() {
        1 => alone,
        _ => chosen_by_positions(tools, seen, &observers).unwrap_or(alone),
    };
    let sum = |of: &[Matrix3<f64>]| -> Matrix3<f64> { of.iter().zip(&parts).map(|(one, part)| one * *part).sum() };
    let (target, observer) = (sum(&targets), sum(&observers));
    Some((nearest_rotation(target)?, nearest_rotation(observer)?))
}

/// The coefficients of the combination that the positions choose among matrices M which all agree with the orientations:
/// `R (M o + pc) - pg = -p` is linear in them and in the positions of target and observer. None where it is no rotation.
///
/// Two orientations agree with all poses where one relative turn is a half turn, and the axis of the others is square to its axis.
fn chosen_by_positions(
    tools: &[Isometry3<f64>],
    seen: &[Isometry3<f64>],
    observers: &[Matrix3<f64>],
) -> Option<Vec<f64>> {
    let count = observers.len();
    let mut rows = DMatrix::zeros(3 * tools.len(), count + 6);
    let mut right = DVector::zeros(3 * tools.len());
    for (row, (tool, seen)) in tools.iter().zip(seen).enumerate() {
        let turned = rotation(tool);
        for (column, observer) in observers.iter().enumerate() {
            rows.fixed_view_mut::<3, 1>(3 * row, column).copy_from(&(turned * observer * seen.translation.vector));
        }
        rows.fixed_view_mut::<3, 3>(3 * row, count).copy_from(&turned);
        rows.fixed_view_mut::<3, 3>(3 * row, count + 3).copy_from(&-Matrix3::identity());
        right.fixed_rows_mut::<3>(3 * row).copy_from(&-tool.translation.vector);
    }
    let svd = rows.try_svd(true, true, f64::EPSILON, STEPS)?;
    let least = TOLD * svd.singular_values.max();
    let found = svd.solve(&right, least).ok()?;
    let sum: Matrix3<f64> = observers.iter().zip(found.iter()).map(|(observer, part)| observer * *part).sum();
    (sum.determinant() > LEAST_DETERMINANT).then(|| found.iter().take(count).copied().collect())
}

/// Positions of target and observer, which make `R' pg - pc` equal to `R' p + Rc o` as well as they can; `mean` is that of the
/// rotations R.
fn positions(
    tools: &[Isometry3<f64>],
    seen: &[Isometry3<f64>],
    mean: Matrix3<f64>,
    observer: UnitQuaternion<f64>,
) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let mut right = Vector6::zeros();
    for (tool, seen) in tools.iter().zip(seen) {
        let in_tool = tool.rotation.inverse() * tool.translation.vector + observer * seen.translation.vector;
        let mut part = right.fixed_rows_mut::<3>(0);
        part += tool.rotation * in_tool;
        let mut part = right.fixed_rows_mut::<3>(3);
        part -= in_tool;
    }
    let mut normal = Matrix6::identity();
    normal.fixed_view_mut::<3, 3>(0, 3).copy_from(&-mean);
    normal.fixed_view_mut::<3, 3>(3, 0).copy_from(&-mean.transpose());
    let found = normal.cholesky()?.solve(&(right / tools.len() as f64));
    Some((found.fixed_rows::<3>(0).into_owned(), found.fixed_rows::<3>(3).into_owned()))
}

/// U, the largest singular value and V' of a matrix; none if it is not finite.
fn decomposed(matrix: Matrix3<f64>) -> Option<(Matrix3<f64>, f64, Matrix3<f64>)> {
    let svd = matrix.try_svd(true, true, f64::EPSILON, STEPS)?;
    Some((svd.u?, svd.singular_values.max(), svd.v_t?))
}

/// The rotation that is nearest to a matrix of positive determinant.
pub fn nearest_rotation(matrix: Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let (u, _, v_t) = decomposed(matrix)?;
    let turned = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * turned * v_t)))
}

/// Refuses a start with which half of the orientations do not agree. Robust estimates are for gross errors; here the machine,
/// or the observed body, is another one.
fn agrees(tools: &[Isometry3<f64>], seen: &[Isometry3<f64>], start: Start) -> Result<Start> {
    let rows = tools.iter().zip(seen);
    let mut angles: Vec<f64> = rows
        .map(|(tool, seen)| {
            let predicted = (tool * start.observer).inverse() * start.target;
            predicted.rotation.angle_to(&seen.rotation)
        })
        .collect();
    angles.sort_by(f64::total_cmp);
    let median = angles[angles.len() / 2];
    if median < AGREEMENT {
        return Ok(start);
    }
    let message = format!(
        "wherever target and observer stand, half of the orientations are {:.0}° or more off those of the machine",
        median.to_degrees()
    );
    Err(Error::data(message).help("is `pose` right, and do all axes turn the way that the model says (`reverse`)?"))
}
