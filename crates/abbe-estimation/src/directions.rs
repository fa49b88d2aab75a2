//! What the touches themselves say of signs and zeros: directions of approach that lead away from the surface, and rotary axes that
//! are off by a constant angle. Both fit as well as the truth: backlash takes up the first, offsets of features the second.

use abbe_core::{AxisKind, CHUNK, Contact, Evaluation, Problem, SetIndex, StatusRole, Variable};

use crate::contact::gradients;

/// Effect of an axis on the distance from contact, mm/mm, from which its direction is that of the approach.
const LEADS: f64 = 0.5;

/// Fewest touches that tell, and the part of them that has to lead away.
const TOUCHES: usize = 10;
const MOST: f64 = 0.8;

/// Smallest angle that is told, rad, the distance from contact that it has to explain, mm, and the part of it that may be left.
const ANGLE: f64 = 2e-3;
const DISTANCE: f64 = 0.3;
const LEFT: f64 = 0.25;

/// A touch at the start of an estimate.
struct Touch {
    /// Distance from contact, mm.
    distance: f64,
    /// Its derivatives to the commands of all axes.
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
        sentences.extend(off(problem, &touches).map(|words| format!("{}: {words}", set.name)));
    }
    sentences
}

/// The touches of a set, one equation and one pose each.
fn touches(problem: &Problem, index: SetIndex) -> Option<Vec<Touch>> {
    let (set, info) = (&problem.sets[index], problem.model.info());
    let commands: Vec<Variable> = (0..info.axes.len()).map(Variable::Command).collect();
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

/// Linear axes by whose directions most touches lead away from the surface: on the way to contact the distance falls.
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
        if count >= TOUCHES && wrong as f64 > MOST * count as f64 {
            names.push(format!("`dir_{}` ({wrong} of {count})", own.name));
        }
    }
    let names = names.join(", ");
    (!names.is_empty()).then(|| {
        format!(
            "touches lead away from the surface by {names}: are their signs turned? Backlash then gets the wrong sign"
        )
    })
}

/// The rotary axis that brings the touches to contact best if all its commands are off by the same angle.
fn off(problem: &Problem, touches: &[Touch]) -> Option<String> {
    let rms = |distances: &mut dyn Iterator<Item = f64>| {
        (distances.map(|distance| distance * distance).sum::<f64>() / touches.len() as f64).sqrt()
    };
    let before = rms(&mut touches.iter().map(|touch| touch.distance));
    if touches.len() < TOUCHES || before.is_nan() || before < DISTANCE {
        return None;
    }
    let axes = problem.model.info().axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Rotary);
    let tried = axes.filter_map(|(axis, own)| {
        let square: f64 = touches.iter().map(|touch| touch.effects[axis].powi(2)).sum();
        let angle = -touches.iter().map(|touch| touch.effects[axis] * touch.distance).sum::<f64>() / square;
        let after = rms(&mut touches.iter().map(|touch| touch.distance + touch.effects[axis] * angle));
        (angle.abs() > ANGLE && after < LEFT * before).then_some((own.name.as_str(), angle, after))
    });
    let (name, angle, after) = tried.min_by(|one, other| one.2.total_cmp(&other.2))?;
    Some(format!(
        "with {name} at {:+.3}° from where it is said to stand, the touches miss nominal contact by {after:.3} mm and not by {before:.3} mm \
         (RMS): is its zero right, or does the artefact lie turned?",
        angle.to_degrees()
    ))
}
