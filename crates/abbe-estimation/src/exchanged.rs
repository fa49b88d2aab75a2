//! Columns of two axes that are exchanged: what is measured often fits nearly as well, and errors of one axis become those of the other.

use abbe_core::{Axis, AxisKind, Problem};

use crate::compared::Fitted;
use crate::mistakes::{spread, with_commands};
use crate::weighted::Weighted;

/// Most rows of a set that are tried: the difference is small, and shows in many.
const ROWS: usize = 4000;

/// The sentence on two axes with whose commands exchanged the residuals scatter as stated; none where they do so as they are, and where
/// no exchange makes them.
pub(crate) fn exchanged(problem: &Problem, estimate: Option<&[f64]>) -> Option<String> {
    let few = spread(problem, ROWS);
    let now = Fitted::beyond_chance(&few, estimate)?;
    let pairs = pairs(&problem.model.info().axes).into_iter().filter(|pair| stays_within_travel(&few, pair));
    let tried = pairs.filter_map(|[one, other]| {
        let exchanged = with_commands(&few, |status| status.swap(one.status, other.status));
        let after = Fitted::of(&exchanged).filter(|after| now.is_explained_by_exchange(after))?;
        is_determined(&exchanged).then_some((after, [one, other]))
    });
    let (after, [one, other]) = tried.min_by(|(one, _), (other, _)| one.squares.total_cmp(&other.squares))?;
    Some(format!(
        "with the positions of {} and {} exchanged the residuals scatter as stated ({:.2} times as much), and as they are {:.2} times as \
         much: are these two columns exchanged?",
        one.name,
        other.name,
        after.scatter(),
        now.scatter()
    ))
}

/// Part of a travel that commands may be beyond it: rounding.
const ROUNDING: f64 = 1e-9;

/// Whether two axes would stand within their travel if their commands were exchanged: elsewhere nobody has measured.
fn stays_within_travel(problem: &Problem, [one, other]: &[&Axis; 2]) -> bool {
    let holds = |axis: &Axis, column: usize| {
        let Some([from, to]) = axis.range else { return true };
        let slack = ROUNDING * (to - from);
        let mut commands = problem.sets.iter().flat_map(|set| {
            let poses = set.poses();
            set.poses_of(&set.rows).map(move |pose| poses.row(pose)[column])
        });
        commands.all(|command| (from - slack..=to + slack).contains(&command))
    };
    holds(one, other.status) && holds(other, one.status)
}

/// Whether rows determine all unknowns: what leaves some free fits anything.
fn is_determined(problem: &Problem) -> bool {
    let factor = Weighted::new(problem).and_then(|weighted| weighted.factor(&problem.start(), None));
    factor.is_ok_and(|factor| factor.step().is_some())
}

/// Two axes of a kind each, in the order of the machine.
fn pairs(axes: &[Axis]) -> Vec<[&Axis; 2]> {
    let mut pairs = Vec::new();
    for kind in [AxisKind::Linear, AxisKind::Rotary] {
        let alike: Vec<&Axis> = axes.iter().filter(|axis| axis.kind == kind).collect();
        for (place, one) in alike.iter().enumerate() {
            pairs.extend(alike[place + 1..].iter().map(|other| [*one, *other]));
        }
    }
    pairs
}
