//! What a correction of a path achieves, in figures.

use abbe_core::{KinematicModel, Poses, Result, StatusRole};

use crate::compensator::{Correction, Deviation};

/// Largest value and root mean square.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Spread {
    /// The largest.
    pub max: f64,
    /// Root mean square.
    pub rms: f64,
}

impl Spread {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let (mut max, mut squares, mut count) = (0_f64, 0.0, 0);
        for value in values {
            (max, squares, count) = (max.max(value), squares + value * value, count + 1);
        }
        Self { max, rms: (squares / f64::from(count.max(1))).sqrt() }
    }
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
    /// Points where the bound on rotary corrections bites.
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

/// Moves of an axis that the correction turns round: the axis comes from the other side than its backlash was corrected for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurnedMoves {
    /// The axis: index into [`ModelInfo::axes`](abbe_core::ModelInfo::axes).
    pub axis: usize,
    /// Number of moves.
    pub count: usize,
    /// Largest distance of the tip that the other direction makes at the ends of these moves, mm.
    pub reversal: f64,
}

/// The moves of every axis that the correction turns round; axes without any are left out.
pub fn turned_moves(
    model: &dyn KinematicModel,
    values: &[f64],
    programmed: &[f64],
    corrected: &[f64],
) -> Result<Vec<TurnedMoves>> {
    let info = model.info();
    let width = info.status.len();
    let points = programmed.len() / width.max(1);
    let mut found = Vec::new();
    for (index, axis) in info.axes.iter().enumerate() {
        let by = |statuses: &[f64], point: usize| {
            statuses[point * width + axis.status] - statuses[(point - 1) * width + axis.status]
        };
        let turned: Vec<usize> =
            (1..points).filter(|&point| by(programmed, point) * by(corrected, point) < 0.0).collect();
        if turned.is_empty() {
            continue;
        }
        let mut reversal = 0_f64;
        if let Some(direction) = info.status_index(&StatusRole::Direction(index)) {
            let ends: Vec<f64> =
                turned.iter().flat_map(|point| corrected[point * width..(point + 1) * width].to_vec()).collect();
            let mut other = ends.clone();
            other.chunks_mut(width).for_each(|status| status[direction] = -status[direction]);
            let (mut one_way, mut other_way) = (Poses::default(), Poses::default());
            model.poses(&ends, values, &[], false, &mut one_way)?;
            model.poses(&other, values, &[], false, &mut other_way)?;
            for (one, other) in one_way.positions.iter().zip(&other_way.positions) {
                let apart = one.iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum::<f64>().sqrt();
                reversal = reversal.max(apart);
            }
        }
        found.push(TurnedMoves { axis: index, count: turned.len(), reversal });
    }
    Ok(found)
}
