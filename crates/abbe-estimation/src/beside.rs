//! Touches of a part of the rows that lie beside the nominal points of their facets, all by the same: the tool length or the work offset of
//! these rows is another one. A plane facet fits as well wherever it is touched, and places of axes get wrong values.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{AxisKind, Contact, ObservationSet, Poses, Problem, RowIndex, SetIndex, Variable};
use nalgebra::{Matrix3, Quaternion, SymmetricEigen, UnitQuaternion, Vector3};

/// Part of the touches that is beside by less than the scatter of good ones, and the smallest scatter, mm.
const GOOD: f64 = 0.35;
const SCATTER: f64 = 0.5;

/// A touch is where it was aimed at within so many times this scatter, and elsewhere beyond so many.
const NEAR: f64 = 4.0;
const FAR: f64 = 6.0;

/// Most touches, as a part, that are neither near nor far; most that are far; the part of these that have to be beside by the same.
const BETWEEN: f64 = 0.1;
const MOST: f64 = 0.65;
const ALIKE: f64 = 0.8;

/// Fewest touches that are told, their rows on the average in one stretch, and most stretches of fewer.
const FEWEST: usize = 4;
const STRETCH: usize = 4;
const STRETCHES: usize = 2;

/// Part of these touches whose facets were touched elsewhere, too: a facet may have a place of its own where it can be reached.
const ELSEWHERE: f64 = 0.5;

/// Most touches of a set that are looked at.
const TOUCHES: usize = 50_000;

/// Displacements that are tried in each kind of axes.
const TRIED: usize = 60;

/// Axes in which a displacement is the same for all rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Frame {
    Tool,
    Machine,
    Workpiece,
}

const FRAMES: [Frame; 3] = [Frame::Tool, Frame::Machine, Frame::Workpiece];

impl Frame {
    fn name(self) -> &'static str {
        match self {
            Self::Tool => "the tool",
            Self::Machine => "the linear axes",
            Self::Workpiece => "the workpiece",
        }
    }
}

/// A touch of a facet by the machine as it is known before the estimate, in the frame of the table.
#[derive(Debug, Clone)]
struct Touch {
    facet: usize,
    /// Where the tip is beside the nominal point, in the plane of the facet, mm.
    beside: Vector3<f64>,
    /// What a displacement along the axes of each frame adds to that.
    effects: [Matrix3<f64>; 3],
    /// The label of its stylus.
    stylus: Option<String>,
}

/// Touches that are beside by the same.
#[derive(Debug, Clone, PartialEq)]
struct Displaced {
    /// Their places in the list.
    touches: Vec<usize>,
    /// The displacement, mm, and the axes in which it is the same for all, the best first.
    by: Vector3<f64>,
    frames: Vec<Frame>,
    /// Median distance of these touches beside, and the largest of the others that are where they were aimed at, mm.
    beside: f64,
    others: f64,
}

impl Displaced {
    /// What is likely to be wrong.
    fn cause(&self) -> &'static str {
        let is_along_tool = self.by.z.abs() > 0.9 * self.by.norm();
        match (self.frames.contains(&Frame::Tool) && is_along_tool, self.frames.len()) {
            (true, 1) => "the tool length",
            (true, _) => "the tool length, or the work offset,",
            (false, _) => "the work offset",
        }
    }
}

/// Sentences on touches of a part of a set that lie beside the nominal points of their facets by the same.
pub(crate) fn beside_facets(problem: &Problem) -> Vec<String> {
    let sets = SetIndex::enumerate(&problem.sets).filter(|(_, set)| set.info().contact == Contact::LinearAxes);
    sets.filter_map(|(index, set)| of_set(problem, index, set)).collect()
}

fn of_set(problem: &Problem, index: SetIndex, set: &ObservationSet) -> Option<String> {
    let (rows, touches) = touches(problem, set)?;
    let found = displaced(&touches)?;
    let (file, origin) = problem.origin(index, rows[*found.touches.first()?])?;
    let [x, y, z] = [found.by.x, found.by.y, found.by.z];
    Some(format!(
        "{}: {} of {} touches, the first in {}, lie {:.1} mm beside the nominal points of their facets (median), all by the same ({x:+.1}, \
         {y:+.1}, {z:+.1}) mm along {}, and the others within {:.1} mm: is {} of these rows another one? A plane facet fits as well wherever \
         it is touched, and places of axes then get wrong values",
        set.name,
        found.touches.len(),
        touches.len(),
        origin.in_file(file),
        found.beside,
        found.frames[0].name(),
        found.others,
        found.cause()
    ))
}

/// The touches of facets in the order of the data, with their rows, by the machine as it is known at the start.
fn touches(problem: &Problem, set: &ObservationSet) -> Option<(Vec<RowIndex>, Vec<Touch>)> {
    let (info, layout, axes) = (set.info(), &set.info().layout, &problem.model.info().axes);
    let (labels, styli) = (layout.data.labels("feature")?, layout.data.labels("stylus"));
    // One normal makes a facet; a ball is shifted in three directions.
    let facets = info.features.iter().enumerate().filter_map(|(index, feature)| match feature.shifts[..] {
        [(_, normal)] => Some((feature.label.as_str(), (index, Vector3::from(feature.point), Vector3::from(normal)))),
        _ => None,
    });
    let facets: BTreeMap<&str, (usize, Vector3<f64>, Vector3<f64>)> = facets.collect();
    let facet_of = |row: RowIndex| {
        let row = &layout.rows[row];
        facets.get(labels[row.data_row?].as_str()).filter(|_| row.poses == 1)
    };
    let mut rows: Vec<RowIndex> = set.rows.iter().copied().filter(|row| facet_of(*row).is_some()).collect();
    if rows.len() < 2 * FEWEST || rows.len() > TOUCHES {
        return None;
    }
    rows.sort_by_key(|row| layout.rows[*row].data_row);
    let statuses: Vec<f64> =
        rows.iter().flat_map(|row| set.poses().row(layout.rows[*row].first_pose)).copied().collect();
    let linear = axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Linear);
    let commands: Vec<Variable> = linear.map(|(index, _)| Variable::Command(index)).collect();
    let mut poses = Poses::default();
    problem.model.poses(&statuses, &problem.machine_values, &commands, true, &mut poses).ok()?;
    let touch = |(place, row): (usize, &RowIndex)| {
        let (facet, point, normal) = *facet_of(*row)?;
        let [w, x, y, z] = poses.orientations[place];
        let tool = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix();
        let mut machine = Matrix3::zeros();
        let own = &poses.position_derivatives[place * commands.len()..(place + 1) * commands.len()];
        own.iter().take(3).enumerate().for_each(|(axis, effect)| machine.set_column(axis, &Vector3::from(*effect)));
        let in_plane = Matrix3::identity() - normal * normal.transpose();
        Some(Touch {
            facet,
            beside: in_plane * (Vector3::from(poses.positions[place]) - point),
            effects: [*tool.matrix(), machine, Matrix3::identity()].map(|frame| in_plane * frame),
            stylus: styli.zip(layout.rows[*row].data_row).map(|(styli, row)| styli[row].to_string()),
        })
    };
    let touches: Vec<Touch> = rows.iter().enumerate().filter_map(touch).collect();
    (touches.len() == rows.len() && touches.iter().all(|touch| touch.beside.iter().all(|part| part.is_finite())))
        .then_some((rows, touches))
}

/// The touches beside that have most in common.
fn displaced(touches: &[Touch]) -> Option<Displaced> {
    let off = set_up(touches);
    let left: Vec<Vector3<f64>> = touches.iter().map(|touch| touch.beside - touch.effects[2] * off).collect();
    let mut sizes: Vec<f64> = left.iter().map(|left| left.norm()).collect();
    sizes.sort_by(f64::total_cmp);
    let scatter = sizes.get((GOOD * sizes.len() as f64) as usize)?.max(SCATTER);
    let is_far = |place: &usize| left[*place].norm() > FAR * scatter;
    let is_near = |place: &usize| left[*place].norm() <= NEAR * scatter;
    let all = touches.len() as f64;
    let far: Vec<usize> = (0..touches.len()).filter(is_far).collect();
    let near: Vec<usize> = (0..touches.len()).filter(is_near).collect();
    let between = touches.len() - far.len() - near.len();
    if far.len() < FEWEST || far.len() as f64 > MOST * all || between as f64 > BETWEEN * all {
        return None;
    }
    let mut tried: Vec<Tried> =
        FRAMES.into_iter().filter_map(|frame| tried_in(touches, &left, &far, frame, NEAR * scatter)).collect();
    tried.sort_by(|one, other| other.alike.len().cmp(&one.alike.len()).then(one.rest.total_cmp(&other.rest)));
    let best = tried.first()?;
    let alike = &best.alike;
    let is_elsewhere = |place: &&usize| near.iter().any(|near| touches[*near].facet == touches[**place].facet);
    let elsewhere = alike.iter().filter(is_elsewhere).count();
    let is_told = alike.len() >= FEWEST
        && alike.len() as f64 >= ALIKE * far.len() as f64
        && elsewhere as f64 >= ELSEWHERE * alike.len() as f64
        && alike.iter().map(|place| touches[*place].facet).collect::<BTreeSet<_>>().len() > 1
        && (in_stretches(touches, best, FAR * scatter) || of_one_stylus(touches, best, FAR * scatter));
    let equal =
        tried.iter().filter(|other| other.alike.len() == alike.len() && other.rest <= best.rest + 0.1 * scatter);
    let mut sizes: Vec<f64> = alike.iter().map(|place| touches[*place].beside.norm()).collect();
    sizes.sort_by(f64::total_cmp);
    let others = near.iter().map(|place| touches[*place].beside.norm()).fold(0.0, f64::max);
    is_told.then(|| Displaced {
        touches: alike.clone(),
        by: best.by,
        frames: equal.map(|tried| tried.frame).collect(),
        beside: sizes[sizes.len() / 2],
        others,
    })
}

/// A displacement in the axes of a frame, and the far touches that have it.
#[derive(Debug, Clone)]
struct Tried {
    frame: Frame,
    by: Vector3<f64>,
    alike: Vec<usize>,
    /// Mean of what is left of these, mm.
    rest: f64,
}

/// The displacement in one frame that most of the far touches have.
fn tried_in(touches: &[Touch], left: &[Vector3<f64>], far: &[usize], frame: Frame, within: f64) -> Option<Tried> {
    let of = |places: &[usize]| least_squares(touches, left, places, frame, |_| 1.0);
    let rest = |place: &usize, by: &Vector3<f64>| (left[*place] - touches[*place].effects[frame as usize] * by).norm();
    let alike =
        |by: &Vector3<f64>| far.iter().copied().filter(|place| rest(place, by) <= within).collect::<Vec<usize>>();
    let every = far.len().div_ceil(TRIED);
    let starts = far.windows(2).step_by(every).map(of).chain([of(far)]);
    let best = starts.map(|by| alike(&by)).max_by_key(Vec::len)?;
    let by = of(&best);
    let alike = alike(&by);
    let rest = alike.iter().map(|place| rest(place, &by)).sum::<f64>() / alike.len().max(1) as f64;
    Some(Tried { frame, by, alike, rest })
}

/// The displacement in a frame that explains best where touches are; zero in directions of which they tell nothing.
fn least_squares(
    touches: &[Touch],
    left: &[Vector3<f64>],
    places: &[usize],
    frame: Frame,
    weight: impl Fn(usize) -> f64,
) -> Vector3<f64> {
    let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for &place in places {
        let effect = &touches[place].effects[frame as usize];
        matrix += weight(place) * effect.transpose() * effect;
        right += weight(place) * effect.transpose() * left[place];
    }
    let eigen = SymmetricEigen::new(matrix);
    let least = 0.02 * eigen.eigenvalues.max();
    let mut by = Vector3::zeros();
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > least {
            by += vector.dot(&right) / value * vector;
        }
    }
    by
}

/// How far the artefact as a whole stands from its nominal place, mm, by the least sum of distances; zero if it is hardly off.
fn set_up(touches: &[Touch]) -> Vector3<f64> {
    let beside: Vec<Vector3<f64>> = touches.iter().map(|touch| touch.beside).collect();
    let places: Vec<usize> = (0..touches.len()).collect();
    let usual = |by: &Vector3<f64>| {
        let mut sizes: Vec<f64> = touches.iter().map(|touch| (touch.beside - touch.effects[2] * by).norm()).collect();
        sizes.sort_by(f64::total_cmp);
        sizes.get((GOOD * sizes.len() as f64) as usize).copied().unwrap_or_default()
    };
    if usual(&Vector3::zeros()) <= NEAR * SCATTER {
        return Vector3::zeros();
    }
    let mut by = Vector3::zeros();
    for _ in 0..20 {
        let left = |place: usize| (touches[place].beside - touches[place].effects[2] * by).norm();
        let weight = |place: usize| 1.0 / left(place).max(0.1);
        by = least_squares(touches, &beside, &places, Frame::Workpiece, weight);
    }
    if usual(&by) < 0.5 * usual(&Vector3::zeros()) { by } else { Vector3::zeros() }
}

/// Touches that the displacement would move far, in the order of the data: whether each has it.
fn moved<'a>(touches: &'a [Touch], tried: &'a Tried, far: f64) -> impl Iterator<Item = (usize, bool)> + 'a {
    let is_moved = move |place: &usize| (touches[*place].effects[tried.frame as usize] * tried.by).norm() > far;
    (0..touches.len()).filter(is_moved).map(|place| (place, tried.alike.binary_search(&place).is_ok()))
}

/// Whether the touches with a displacement follow each other.
fn in_stretches(touches: &[Touch], tried: &Tried, far: f64) -> bool {
    let all: Vec<bool> = moved(touches, tried, far).map(|(_, is_alike)| is_alike).collect();
    let stretches = all.chunk_by(|one, next| one == next).filter(|stretch| stretch[0]).count();
    stretches <= STRETCHES.max(tried.alike.len() / STRETCH)
}

/// Whether the touches with a displacement are those of one stylus.
fn of_one_stylus(touches: &[Touch], tried: &Tried, far: f64) -> bool {
    let own: BTreeSet<&Option<String>> = tried.alike.iter().map(|place| &touches[*place].stylus).collect();
    let other = moved(touches, tried, far).filter(|(_, is_alike)| !is_alike);
    let others = other.filter(|(place, _)| own.contains(&touches[*place].stylus)).count();
    own.len() == 1 && others * 10 <= tried.alike.len()
}

#[cfg(test)]
mod tests;
