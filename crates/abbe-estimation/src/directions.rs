//! What the touches themselves say of signs and zeros: directions of approach that lead away from the surface, and rotary axes that
//! are off by a constant angle. Both fit as well as the truth: backlash takes up the first, offsets of features the second.

use abbe_core::{
    AxisKind, CHUNK, Contact, Evaluation, Owner, ParameterRole, Problem, SetIndex, StatusRole, Unit, Variable,
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
}

/// Sentences on directions that are turned and on rotary axes that are off.
pub fn turned(problem: &Problem) -> Vec<String> {
    let mut sentences = Vec::new();
    for (index, set) in SetIndex::enumerate(&problem.sets) {
        if set.info().contact != Contact::LinearAxes || !set.info().angles.is_empty() {
            continue;
        }
        let Some(touches) = touches(problem, index) else { continue };
        sentences.extend(away(problem, &touches).map(|words| format!("{}: {words}", set.name)));
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
            });
        }
    }
    Some(touches)
}

/// Linear axes by whose directions many touches lead away from the surface: on the way to contact the distance falls.
fn away(problem: &Problem, touches: &[Touch]) -> Option<String> {
    let axes = &problem.model.info().axes;
    let mut names = Vec::new();
    for (axis, own) in axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Linear) {
        let told = touches.iter().filter(|touch| touch.directions[axis] != 0.0 && touch.effects[axis].abs() > LEADS);
        let (mut count, mut wrong) = (0, 0);
        for touch in told {
            count += 1;
            wrong += usize::from(touch.directions[axis] * touch.effects[axis] > 0.0);
        }
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
