//! Columns of two axes that are exchanged: what is measured often fits nearly as well, and errors of one axis become those of the other.

use abbe_core::{Axis, AxisKind, Problem};

use crate::compared::Fitted;
use crate::mistakes::{spread, with_commands};
use crate::weighted::Weighted;

/// Most rows of a set that are tried: the difference is small, and shows in many.
const ROWS: usize = 4000;

/// The sentence on two axes with whose commands exchanged the residuals scatter as stated; none where they do so as they are, and where
/// no exchange makes them.
pub(crate) fn exchanged(problem: &Problem) -> Option<String> {
    let few = spread(problem, ROWS);
    if !Fitted::after_a_step(&few)?.is_beyond_chance() {
        return None;
    }
    let now = Fitted::of(&few).filter(Fitted::is_beyond_chance)?;
    let tried = pairs(&problem.model.info().axes).into_iter().filter_map(|[one, other]| {
        let exchanged = with_commands(&few, |status| status.swap(one.status, other.status));
        let after = Fitted::of(&exchanged).filter(|after| now.is_explained_by(after))?;
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
