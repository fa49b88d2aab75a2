//! What a correction of a path achieves, in figures.

use abbe_core::{KinematicModel, Poses, Result, StatusRole};

use nalgebra::{Matrix3, SymmetricEigen};

use crate::compensator::{Correction, Deviation};
use crate::set_points::directions_of;

/// Largest value and root mean square.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Spread {
    /// The largest.
    pub max: f64,
    /// Root mean square.
    pub rms: f64,
}

impl Spread {
    pub(crate) fn of(values: impl Iterator<Item = f64>) -> Self {
        let (mut max, mut squares, mut count) = (0_f64, 0.0, 0);
        for value in values {
            (max, squares, count) = (max.max(value), squares + value * value, count + 1);
        }
        Self { max, rms: (squares / f64::from(count.max(1))).sqrt() }
    }
}

/// The largest standard uncertainty in any direction, of a covariance: the root of its largest eigenvalue.
pub(crate) fn largest_uncertainty(covariance: &[[f64; 3]; 3]) -> f64 {
    let matrix = Matrix3::from_fn(|row, column| covariance[row][column]);
    SymmetricEigen::new(matrix).eigenvalues.max().max(0.0).sqrt()
}

/// Errors of tip and tool axis over a path.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Figures {
    /// Distance of the tip from its goal before the correction, mm.
    pub tip_before: Spread,
    /// The same after it.
    pub tip_after: Spread,
    /// Angle of the tool axis from its goal before the correction, rad.
    pub axis_before: Spread,
    /// The same after it.
    pub axis_after: Spread,
    /// Points where the bound on rotary corrections is reached.
    pub bounded: usize,
    /// Points where an axis stands at an end of its travel.
    pub held: usize,
    /// Most passes of a point.
    pub passes: usize,
}

/// The figures of a path.
pub fn figures(corrections: &[Correction]) -> Figures {
    let of = |value: fn(&Deviation) -> f64, after: bool| {
        Spread::of(corrections.iter().map(|point| value(if after { &point.after } else { &point.before })))
    };
    Figures {
        tip_before: of(Deviation::distance, false),
        tip_after: of(Deviation::distance, true),
        axis_before: of(Deviation::angle, false),
        axis_after: of(Deviation::angle, true),
        bounded: corrections.iter().filter(|point| point.is_bounded).count(),
        held: corrections.iter().filter(|point| !point.held.is_empty()).count(),
        passes: corrections.iter().map(|point| point.passes).max().unwrap_or(0),
    }
}

/// Moves of an axis that the correction reverses: the axis comes from the other side than its backlash was corrected for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReversedMoves {
    /// The axis: index into [`ModelInfo::axes`](abbe_core::ModelInfo::axes).
    pub axis: usize,
    /// Number of moves of the program that are reversed.
    pub count: usize,
    /// Number of moves that the correction alone makes against the last direction, while the axis stands in the program.
    pub while_standing: usize,
    /// Largest distance of the tip that the other direction makes at the ends of these moves, mm.
    pub reversal: f64,
}

/// Moves, mm and rad, below which an axis stands: files have nine decimals.
const STANDS: f64 = 1e-9;

/// What a correction makes of a move.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Move {
    Kept,
    Reversed,
    ReversedWhileStanding,
}

/// What becomes of the moves of one axis, from the second point on. `direction` is that of the programmed path at every point.
fn moves(programmed: &[f64], corrected: &[f64], direction: &[f64]) -> Vec<Move> {
    let by = |commands: &[f64], point: usize| commands[point] - commands[point - 1];
    let of_point = |point: usize| {
        let (asked, made) = (by(programmed, point), by(corrected, point));
        match asked == 0.0 {
            false if asked * made < 0.0 => Move::Reversed,
            true if made.abs() > STANDS && made * direction[point] < 0.0 => Move::ReversedWhileStanding,
            _ => Move::Kept,
        }
    };
    (1..programmed.len()).map(of_point).collect()
}

/// The moves of every axis that the correction reverses; axes without any are left out.
///
/// `programmed` and `corrected` are the statuses of a path, points x columns of the status. Fails where the model has no pose.
pub fn reversed_moves(
    model: &dyn KinematicModel,
    values: &[f64],
    programmed: &[f64],
    corrected: &[f64],
) -> Result<Vec<ReversedMoves>> {
    let info = model.info();
    let width = info.status.len().max(1);
    let column =
        |statuses: &[f64], place: usize| statuses.chunks(width).map(|status| status[place]).collect::<Vec<_>>();
    let mut found = Vec::new();
    for (index, axis) in info.axes.iter().enumerate() {
        let commands = column(programmed, axis.status);
        let direction = info.status_index(&StatusRole::Direction(index));
        let directions = match direction {
            Some(place) => column(programmed, place),
            None => directions_of(&commands),
        };
        let moves = moves(&commands, &column(corrected, axis.status), &directions);
        let count = |what: Move| moves.iter().filter(|&&found| found == what).count();
        let (count, while_standing) = (count(Move::Reversed), count(Move::ReversedWhileStanding));
        if count + while_standing == 0 {
            continue;
        }
        let ends = moves.iter().enumerate().filter(|(_, found)| **found != Move::Kept);
        let ends: Vec<f64> =
            ends.flat_map(|(before, _)| corrected[(before + 1) * width..(before + 2) * width].to_vec()).collect();
        let reversal = direction.map_or(Ok(0.0), |place| largest_reversal(model, values, &ends, place))?;
        found.push(ReversedMoves { axis: index, count, while_standing, reversal });
    }
    Ok(found)
}

/// Largest distance of the tip, mm, between these statuses and the same ones with the other direction.
pub(crate) fn largest_reversal(
    model: &dyn KinematicModel,
    values: &[f64],
    statuses: &[f64],
    direction: usize,
) -> Result<f64> {
    let mut other = statuses.to_vec();
    other.chunks_mut(model.info().status.len()).for_each(|status| status[direction] = -status[direction]);
    let (mut one_way, mut other_way) = (Poses::default(), Poses::default());
    model.poses(statuses, values, &[], false, &mut one_way)?;
    model.poses(&other, values, &[], false, &mut other_way)?;
    let apart = |(one, other): (&[f64; 3], &[f64; 3])| {
        one.iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum::<f64>().sqrt()
    };
    Ok(one_way.positions.iter().zip(&other_way.positions).map(apart).fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each move by hand: kept, reversed, made shorter, standing, and pushed back while standing.
    #[test]
    fn moves_that_are_reversed() {
        let programmed = [0.0, 1.0, 0.9, 0.8, 0.8, 0.8, 0.8];
        let corrected = [0.0, 1.1, 1.2, 0.7, 0.7, 0.6, 0.7];
        let directions = directions_of(&programmed);
        assert_eq!(directions, [1.0, 1.0, -1.0, -1.0, -1.0, -1.0, -1.0]);
        use Move::{Kept, Reversed, ReversedWhileStanding};
        let expected = [Kept, Reversed, Kept, Kept, Kept, ReversedWhileStanding];
        assert_eq!(moves(&programmed, &corrected, &directions), expected);
    }
}
