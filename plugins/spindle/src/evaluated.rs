//! Runs from their readings: harmonics with their covariance, and residuals, in two looks at the rows.

use abbe_core::{Passes, Result};

use crate::harmonics::{Basis, Gathered, Solved, Sums, enough, factored};
use crate::parameters::Sizes;
use crate::readings::Expected;
use crate::rests::{Fitted, Left, Rests, Wanted};
use crate::run::{Run, first_look, second_look};

/// What is fitted to runs.
#[derive(Debug, Clone, Copy)]
pub struct Fits {
    /// The highest order.
    pub highest: usize,
    /// Whether there is a straight line in time.
    pub linear_drift: bool,
    /// What residuals tell.
    pub rests: Wanted,
}

/// A run with its harmonics.
pub struct Evaluated {
    /// The run.
    pub run: Run,
    /// Its harmonics, and what they leave; or why there are none.
    pub fitted: Result<(Fitted, Left)>,
}

/// The runs of data sets with their harmonics, and the sizes of all residuals.
///
/// Fails as [`second_look`] does; why a run has no harmonics is told with it.
pub fn evaluate(data: &[&dyn Passes], expected: &Expected<'_>, fits: Fits) -> Result<(Vec<Evaluated>, Sizes)> {
    let (runs, sums) = gathered(data, expected, fits)?;
    let solved = solved(data, expected, fits, &runs, &sums)?;
    let (mut sizes, mut rests): (Sizes, Vec<Option<Rests<'_>>>) = (Sizes::default(), Vec::new());
    let mut left: Vec<Option<(Fitted, Left)>> = Vec::new();
    second_look(data, expected, &runs, &mut |stretch, run| {
        if stretch.first == 0 {
            left.extend(rests.pop().map(|rests| rests.map(|rests| rests.finish(&runs[stretch.run - 1]))));
            let solved = solved[stretch.run].as_ref().ok();
            rests.push(solved.map(|solved| Rests::new(run, solved, fits.rests)));
        }
        rests.iter_mut().flatten().for_each(|rests| rests.add(run, stretch, &mut sizes));
    })?;
    if let (Some(last), Some(run)) = (rests.pop(), runs.last()) {
        left.push(last.map(|rests| rests.finish(run)));
    }
    let evaluated = runs.into_iter().zip(solved).zip(left).map(|((run, solved), left)| {
        let none = run.error("its harmonics cannot be told apart");
        Evaluated { run, fitted: solved.and_then(|_| left.ok_or(none)) }
    });
    Ok((evaluated.collect(), sizes))
}

/// The first look, with sums for normal equations.
fn gathered(data: &[&dyn Passes], expected: &Expected<'_>, fits: Fits) -> Result<(Vec<Run>, Vec<Sums>)> {
    let (mut sums, mut present): (Vec<Sums>, Option<Gathered>) = (Vec::new(), None);
    let runs = first_look(data, expected, &mut |stretch| {
        if stretch.first == 0 {
            sums.extend(present.take().map(Gathered::sums));
        }
        present.get_or_insert_with(|| Gathered::new(stretch, fits.highest)).add(stretch);
    })?;
    sums.extend(present.map(Gathered::sums));
    Ok((runs, sums))
}

/// The harmonics of runs, by their sums, or where these lose too many digits by another look at their rows.
fn solved(
    data: &[&dyn Passes],
    expected: &Expected<'_>,
    fits: Fits,
    runs: &[Run],
    sums: &[Sums],
) -> Result<Vec<Result<Solved>>> {
    let (mut solved, mut hard) = (Vec::new(), Vec::new());
    for (number, (run, sums)) in runs.iter().zip(sums).enumerate() {
        let basis = Basis::new(run, fits.highest, fits.linear_drift);
        let found = enough(run, &basis).map(|()| sums.solve(basis));
        if let Ok(None) = found {
            hard.push((number, run, basis));
        }
        solved.push(found);
    }
    let mut others = if hard.is_empty() { Vec::new() } else { factored(data, expected, &hard)? }.into_iter();
    let of_run = |(found, run): (Result<Option<Solved>>, &Run)| match found? {
        Some(solved) => Ok(solved),
        None => others.next().unwrap_or_else(|| Err(run.error("its harmonics cannot be told apart"))),
    };
    Ok(solved.into_iter().zip(runs).map(of_run).collect())
}
