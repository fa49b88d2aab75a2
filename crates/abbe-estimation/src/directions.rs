//! What the touches themselves say of signs and zeros: directions of approach that lead away from the surface, and rotary axes that
//! are off by a constant angle. Both fit as well as the truth: backlash takes up the first, offsets of features the second.

use abbe_core::{
    Axis, AxisKind, CHUNK, Contact, Evaluation, Owner, ParameterRole, Problem, SetIndex, StatusRole, Unit, Variable,
};
use nalgebra::{DMatrix, DVector};

use crate::contact::gradients;

/// Effect of an axis on the distance from contact, mm/mm, from which its direction is that of the approach.
const LEADS: f64 = 0.5;

/// Fewest touches that tell, the part of them that has to lead away, and the same of at least so many that do: half of them do where
/// two columns are swapped, a quarter where they are off by a row.
const TOUCHES: usize = 10;
const MOST: f64 = 0.8;
const MANY: f64 = 0.15;

/// Smallest angle that is told, rad, and the distance from contact that it has to explain, mm.
const ANGLE: f64 = 2e-3;
const DISTANCE: f64 = 0.3;

/// Part of that distance that may be left, however many features there are.
const LEFT: f64 = 0.75;

/// Probability with which features that are off at random may look as if an axis were off.
const BY_CHANCE: f64 = 1e-8;

/// A touch at the start of an estimate.
struct Touch {
    /// Distance from contact, mm.
    distance: f64,
    /// Its derivatives to the commands of all axes, then to the unknown place of the tip.
    effects: Vec<f64>,
    /// Directions of approach of all axes, 0 where the data do not say.
    directions: Vec<f64>,
    /// The only axis that moves until contact; none if all linear axes do, or it is not known.
    approach: Option<usize>,
}

impl Touch {
    /// Whether the direction of an axis leads away from the surface. None if this touch does not tell: the axis does not move until
    /// contact, or hardly towards the surface, or the data do not say from where it came.
    fn leads_away(&self, axis: usize) -> Option<bool> {
        let moves = self.approach.is_none_or(|own| own == axis);
        let (direction, effect) = (self.directions[axis], self.effects[axis]);
        (moves && direction != 0.0 && effect.abs() > LEADS).then_some(direction * effect > 0.0)
    }
}

/// Sentences on directions that are turned and on rotary axes that are off.
pub fn turned(problem: &Problem) -> Vec<String> {
    let mut sentences = Vec::new();
    for (index, set) in SetIndex::enumerate(&problem.sets) {
        if set.info().contact != Contact::LinearAxes || !set.info().angles.is_empty() {
            continue;
        }
        let Some(touches) = touches(problem, index) else { continue };
        sentences.extend(away(&problem.model.info().axes, &touches).map(|words| format!("{}: {words}", set.name)));
        sentences.extend(off(problem, index, &touches).map(|words| format!("{}: {words}", set.name)));
    }
    sentences
}

/// The touches of a set, one equation and one pose each.
fn touches(problem: &Problem, index: SetIndex) -> Option<Vec<Touch>> {
    let (set, info) = (&problem.sets[index], problem.model.info());
    let is_of_tip = |index: &usize| {
        let parameter = &info.parameters[*index];
        parameter.role == ParameterRole::SetUp && parameter.unit == Unit::MM
    };
    let of_machine = problem.unknowns.iter().filter(|unknown| unknown.owner == Owner::Machine);
    let of_tip = of_machine.map(|unknown| unknown.index).filter(is_of_tip).map(Variable::Parameter);
    let commands: Vec<Variable> = (0..info.axes.len()).map(Variable::Command).chain(of_tip).collect();
    let columns: Vec<Option<usize>> =
        (0..info.axes.len()).map(|axis| info.status_index(&StatusRole::Direction(axis))).collect();
    let single = |row: &&abbe_core::RowIndex| {
        let row = &set.info().layout.rows[**row];
        row.equations == 1 && row.poses == 1
    };
    let rows: Vec<_> = set.rows.iter().filter(single).copied().collect();
    let (mut touches, mut work) = (Vec::new(), Evaluation::default());
    for rows in rows.chunks(CHUNK) {
        problem.evaluate(index, rows, &commands, &mut work).ok()?;
        let effects = gradients(&work, set, rows, commands.len());
        for (place, &row) in rows.iter().enumerate() {
            let status = set.poses().row(set.info().layout.rows[row].first_pose);
            touches.push(Touch {
                distance: work.equations.residuals()[place],
                effects: effects[place * commands.len()..(place + 1) * commands.len()].to_vec(),
                directions: columns.iter().map(|column| column.map_or(0.0, |column| status[column])).collect(),
                approach: set.info().approach(row).map(|approach| approach.axis),
            });
        }
    }
    Some(touches)
}

/// Linear axes by whose directions many touches lead away from the surface: on the way to contact the distance falls.
fn away(axes: &[Axis], touches: &[Touch]) -> Option<String> {
    let mut names = Vec::new();
    for (axis, own) in axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Linear) {
        let told = touches.iter().filter_map(|touch| touch.leads_away(axis));
        let (count, wrong) = told.fold((0, 0), |(count, wrong), away| (count + 1, wrong + usize::from(away)));
        let part = wrong as f64 / count.max(1) as f64;
        if count >= TOUCHES && (part > MOST || (wrong >= TOUCHES && part > MANY)) {
            names.push(format!("`dir_{}` ({wrong} of {count})", own.name));
        }
    }
    let names = names.join(", ");
    (!names.is_empty()).then(|| {
        format!(
            "touches lead away from the surface by {names}: are their signs turned, or columns swapped? Backlash then gets a wrong value"
        )
    })
}

/// The rotary axis that brings the touches to contact best if all its commands are off by the same angle.
///
/// What the place of the tip and its size explain is taken off first: these are hardly ever known before.
fn off(problem: &Problem, set: SetIndex, touches: &[Touch]) -> Option<String> {
    if touches.len() < TOUCHES {
        return None;
    }
    let info = problem.model.info();
    let of_tip = |touch: &Touch| [1.0].into_iter().chain(touch.effects[info.axes.len()..].iter().copied()).collect();
    let before = left(touches, of_tip)?;
    // An own unknown for each feature can hide what it is off: by chance `features` of them look like an angle to this part.
    let features = problem.sets[set].info().unknowns.len().clamp(1, touches.len());
    let free = features as f64 - before.unknowns as f64 - 1.0;
    let most = if free > 0.0 { BY_CHANCE.powf(1.0 / free).min(LEFT) } else { 0.0 };
    if before.rms < DISTANCE {
        return None;
    }
    let axes = info.axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Rotary);
    let tried = axes.filter_map(|(axis, own)| {
        let after = left(touches, |touch| [touch.effects[axis]].into_iter().chain(of_tip(touch)).collect())?;
        (after.first.abs() > ANGLE && after.rms < most * before.rms).then_some((own.name.as_str(), after))
    });
    let (name, after) = tried.min_by(|one, other| one.1.rms.total_cmp(&other.1.rms))?;
    Some(format!(
        "with {name} at {:+.3}° from where it is said to stand, the touches miss nominal contact by {:.3} mm and not by {:.3} mm \
         (RMS, the tip where it fits best): is its zero right, or does the artefact lie turned?",
        after.first.to_degrees(),
        after.rms,
        before.rms
    ))
}

/// What is left of the distances from contact.
struct Left {
    /// mm
    rms: f64,
    /// Number of effects that were fitted, and the factor of the first.
    unknowns: usize,
    first: f64,
}

/// What effects leave of the distances, by least squares.
fn left(touches: &[Touch], effects: impl Fn(&Touch) -> Vec<f64>) -> Option<Left> {
    let rows: Vec<Vec<f64>> = touches.iter().map(effects).collect();
    let unknowns = rows.first()?.len();
    let matrix = DMatrix::from_fn(rows.len(), unknowns, |row, column| rows[row][column]);
    let distances = DVector::from_iterator(touches.len(), touches.iter().map(|touch| -touch.distance));
    if !matrix.iter().chain(&distances).all(|number| number.is_finite()) {
        return None;
    }
    let found = matrix.clone().svd(true, true).solve(&distances, 1e-9).ok()?;
    let rest = distances - matrix * &found;
    Some(Left { rms: (rest.norm_squared() / touches.len() as f64).sqrt(), unknowns, first: found[0] })
}

#[cfg(test)]
mod tests {
    use abbe_core::Branch;
    use abbe_numerics::Generator;

    use super::*;

    fn axes() -> Vec<Axis> {
        let axis = |(status, name): (usize, &str)| Axis {
            name: name.to_owned(),
            kind: AxisKind::Linear,
            branch: Branch::Tool,
            sense: 1.0,
            direction: [0, 1, 2].map(|part| f64::from(u8::from(part == status))),
            range: None,
            indexed: false,
            endless: false,
            status,
        };
        ["X", "Y", "Z"].into_iter().enumerate().map(axis).collect()
    }

    /// Touches of faces that lie anyhow, each along the axis that is steepest on it; the other axes came from where the programme led.
    fn along_one_axis(random: &mut Generator, count: usize, only: Option<usize>) -> Vec<Touch> {
        let mut touches = Vec::new();
        while touches.len() < count {
            let normal = [0; 3].map(|_| random.normal());
            let size = normal.iter().map(|part| part * part).sum::<f64>().sqrt();
            let normal = normal.map(|part| part / size);
            let steepest = (0..3).max_by(|one, other| normal[*one].abs().total_cmp(&normal[*other].abs()));
            let Some(axis) = steepest.filter(|axis| only.is_none_or(|only| only == *axis)) else { continue };
            let mut directions: Vec<f64> = (0..3).map(|_| if random.index(2) == 0 { 1.0 } else { -1.0 }).collect();
            directions[axis] = -normal[axis].signum();
            touches.push(Touch { distance: 0.0, effects: normal.to_vec(), directions, approach: Some(axis) });
        }
        touches
    }

    #[test]
    fn directions_of_axes_that_do_not_touch_are_not_judged() {
        let (axes, mut alike) = (axes(), 0);
        for seed in 0..2000 {
            let random = &mut Generator::new(seed, 1);
            let (count, only) = (10 + random.index(200), [None, Some(2)][random.index(2)]);
            let mut touches = along_one_axis(random, count, only);
            assert_eq!(away(&axes, &touches), None, "{seed}");
            touches.iter_mut().for_each(|touch| touch.approach = None);
            alike += usize::from(away(&axes, &touches).is_some());
        }
        assert!(alike > 1000, "{alike} if all axes were judged");
    }

    #[test]
    fn turned_directions_of_axes_that_touch_are_told() {
        let axes = axes();
        for seed in 0..500 {
            let random = &mut Generator::new(seed, 2);
            let (axis, count) = (random.index(3), 40 + random.index(200));
            let mut touches = along_one_axis(random, count, None);
            if touches.iter().filter(|touch| touch.approach == Some(axis)).count() < TOUCHES {
                continue;
            }
            touches.iter_mut().for_each(|touch| touch.directions[axis] *= -1.0);
            let name = format!("`dir_{}`", axes[axis].name);
            assert!(away(&axes, &touches).is_some_and(|words| words.contains(&name)), "{seed}");
        }
    }
}
