//! Aliasing: periodic errors that were measured in steps too long to determine their wavelength (Soons 1993, section 3.2).

use abbe_core::{AxisKind, PeriodicError, Problem};

/// Commands closer than this, mm or rad, count as equal.
const SAME: f64 = 1e-6;

/// Commands count as points of a grid if their distance from it is less than this part of a period.
const OFF: f64 = 0.05;

/// Fractions of a period per step below this count as zero: no wave is visible.
const NONE: f64 = 1e-6;

/// Remarks on the estimated periodic errors that may be aliased: wherever their axis moved, it stood on a grid coarser than
/// half the period. A longer wave fits such data as well. The right wavelength is found only because the iteration starts
/// near it.
pub fn aliased(problem: &Problem) -> Vec<String> {
    let estimated = |period: &PeriodicError| {
        problem.machine_unknowns().iter().any(|unknown| period.parameters.contains(&unknown.index))
    };
    let periods = problem.model.info().periods.iter().filter(|period| estimated(period));
    periods.filter_map(|period| aliased_period(problem, period)).collect()
}

fn aliased_period(problem: &Problem, period: &PeriodicError) -> Option<String> {
    let axis = &problem.model.info().axes[period.axis];
    let grid = grid(travelled(problem, axis.status), period.length)?;
    let length = period.length;
    if grid <= 0.5 * length {
        return None;
    }
    let (unit, factor) = if axis.kind == AxisKind::Rotary { ("deg", 1f64.to_degrees()) } else { ("mm", 1.0) };
    let shown = |length: f64| format!("{} {unit}", (length * factor * 1e4).round() / 1e4);
    let per_step = grid / length;
    let off = (per_step - per_step.round()).abs();
    let looks = match off > NONE {
        true => format!("a wave of {}", shown(grid / off)),
        false => "no wave at all".to_owned(),
    };
    Some(format!(
        "{} has a period of {}, but {} was measured on a grid of {} only, on which it looks like {looks}: its wavelength is \
         that near the nominal one; measure some of it in steps below {}",
        period.symbol,
        shown(length),
        axis.name,
        shown(grid),
        shown(0.5 * length)
    ))
}

/// The commands of an axis at the poses between which it moved.
fn travelled(problem: &Problem, status: usize) -> Vec<f64> {
    let mut commands = Vec::new();
    for set in &problem.sets {
        let all: Vec<f64> = set.poses_of(&set.rows).map(|pose| set.poses().row(pose)[status]).collect();
        for pair in all.windows(2).filter(|pair| (pair[0] - pair[1]).abs() > SAME) {
            commands.extend_from_slice(pair);
        }
    }
    commands
}

/// The step of the grid on which all commands lie, within a small part of a period; none if there is no such grid.
fn grid(mut commands: Vec<f64>, period: f64) -> Option<f64> {
    commands.retain(|command| command.is_finite());
    commands.sort_by(f64::total_cmp);
    commands.dedup_by(|next, last| (*next - *last).abs() <= SAME);
    let steps = || commands.windows(2).map(|pair| pair[1] - pair[0]);
    let step = steps().fold(f64::INFINITY, f64::min);
    let on_grid = |step_there: f64| (step_there - (step_there / step).round() * step).abs() < OFF * period;
    (step.is_finite() && steps().all(on_grid)).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::grid;

    #[test]
    fn a_grid_is_found_where_there_is_one() {
        let even: Vec<f64> = (0..71).map(|step| 10.0 * f64::from(step)).collect();
        assert_eq!(grid(even.clone(), 0.635), Some(10.0));
        let both: Vec<f64> = even.iter().copied().chain((0..100).map(|step| 3.0 * f64::from(step))).collect();
        assert_eq!(grid(both, 0.635), Some(1.0));
        let uneven = even.iter().enumerate().map(|(index, command)| command + 0.2 * (index % 3) as f64).collect();
        assert_eq!(grid(uneven, 0.635), None);
        assert_eq!(grid(vec![5.0], 0.635), None);
    }
}
