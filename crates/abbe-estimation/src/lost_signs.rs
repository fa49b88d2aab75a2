//! Readings of a channel that lost their minus from one row on: none is negative, and the others say that some are.

use std::collections::BTreeMap;

use abbe_core::{Problem, SetIndex};

use crate::compared::{Explained, Fitted};
use crate::mistakes::spread;
use crate::turned_readings::{Reading, readings};
use crate::weighted::Weighted;

/// Most rows of a set that are tried.
const ROWS: usize = 300;

/// Fewest readings above zero in turn that tell, most readings of a run, and most runs.
const SEVERAL: usize = 8;
const LONGEST: usize = 300;
const MOST: usize = 40;

/// Standard deviations of chi-squared above what is expected from which anything is looked for.
const DOUBTFUL: f64 = 1.0;

/// Readings in turn of a channel, none of which is negative.
struct Run {
    words: String,
    /// Their equations and values.
    readings: Vec<(usize, f64)>,
}

/// The run of readings with some of which negative the residuals scatter as stated, and far less than as they are; none if there is none.
///
/// Which of them are negative, all others say: these readings take no part in the fit that tells. So the signs are chosen before the
/// readings are looked at, and what chance makes of them is that of one correction.
pub(crate) fn lost_signs(problem: &Problem, estimate: Option<&[f64]>) -> Option<Explained> {
    let few = spread(problem, ROWS);
    let is_as_stated = |now: Fitted| now.squares < now.free + DOUBTFUL * (2.0 * now.free).sqrt();
    if Fitted::scatter_at(&few, estimate).is_some_and(is_as_stated) || is_as_stated(Fitted::after_a_step(&few)?) {
        return None;
    }
    let runs = runs(&few);
    let before = Fitted::of(&few)?;
    let tried = runs.iter().filter_map(|run| {
        let (added, count) = negative(&few, run)?;
        let after = Fitted::of(&few.disturbed(&added))?;
        before.is_far_less_likely_than(&after, runs.len()).then_some((run, count, after))
    });
    let (run, count, after) = tried.min_by(|(.., one), (.., other)| one.squares.total_cmp(&other.squares))?;
    Some(Explained {
        squares: after.squares,
        words: format!(
            "{}, none of which is negative: with {count} of them negative the residuals scatter {:.2} times as much as stated, and as they \
             are {:.2} times as much: is their minus lost?",
            run.words,
            after.scatter(),
            before.scatter()
        ),
    })
}

/// What is added to the residuals if readings of a run are negative where all others expect that, and how many these are.
fn negative(problem: &Problem, run: &Run) -> Option<(Vec<f64>, usize)> {
    let uncertainties = problem.standard_uncertainties();
    let column = |(equation, _): &(usize, f64)| {
        let mut column = vec![0.0; problem.equations()];
        column[*equation] = *uncertainties.get(*equation)?;
        Some(column)
    };
    let columns: Vec<Vec<f64>> = run.readings.iter().map(column).collect::<Option<_>>()?;
    let weighted = Weighted::with_columns(problem, &columns).ok()?;
    let step = weighted.factor(&problem.start(), None).ok()?.step()?;
    let own = step.get(problem.unknowns.len()..).filter(|own| own.len() == run.readings.len())?;
    let mut added = vec![0.0; problem.equations()];
    let mut count = 0;
    // What is left is taken up by the column: the expected reading is the reading less of it.
    for ((equation, value), step) in run.readings.iter().zip(own) {
        if value - step * uncertainties[*equation] < 0.0 && *value > 0.0 {
            added[*equation] = 2.0 * value;
            count += 1;
        }
    }
    (count > 0).then_some((added, count))
}

/// The longest run of readings of each channel of each file in which none is negative.
fn runs(problem: &Problem) -> Vec<Run> {
    let mut found = Vec::new();
    for (set, own, names) in SetIndex::enumerate(&problem.sets).filter_map(|(index, _)| readings(problem, index)) {
        let mut channels: BTreeMap<(usize, usize), Vec<&Reading>> = BTreeMap::new();
        for reading in &own {
            channels.entry((reading.file, reading.channel)).or_default().push(reading);
        }
        for ((file, channel), readings) in channels {
            let runs = readings.split(|reading| reading.value < 0.0);
            let above = |run: &&[&Reading]| run.iter().filter(|reading| reading.value > 0.0).count();
            let Some(run) = runs.max_by_key(above).filter(|run| above(run) >= SEVERAL && run.len() <= LONGEST) else {
                continue;
            };
            let path = set.info().layout.data.files.get(file);
            let of = path.map_or(String::new(), |path| format!(" in `{}`", path.display()));
            found.push(Run {
                words: format!("{}: {} readings in turn of `{}`{of}", set.name, run.len(), names[channel]),
                readings: run.iter().map(|reading| (reading.equation, reading.value)).collect(),
            });
        }
    }
    found.truncate(MOST);
    found
}
