//! Readings whose signs are turned: those of a channel, of a file or of one instrument of several.

use std::collections::BTreeSet;

use abbe_core::{ObservationSet, Problem, SetIndex};
use abbe_numerics::LeastSquares;

use crate::channels::channels_of;
use crate::compared::{Explained, Fitted};
use crate::mistakes::spread;
use crate::weighted::Weighted;

/// Fewest readings that tell.
const SEVERAL: usize = 8;

/// How many times smaller the residuals of these readings have to become, and what they are before, in standard uncertainties.
const FALLS: f64 = 3.0;
const SIGNIFICANT: f64 = 2.0;

/// The scatter of residuals, over what is stated, below which data are exact, and one that they never have.
const EXACT: f64 = 0.05;
const INEXACT: f64 = 0.2;

/// Difference of sums of squares, in those of an equation, within which another group explains as well; and most of these that are named.
const ALIKE: f64 = 9.0;
const NAMED: usize = 2;

/// Most rows of a set that are tried.
const ROWS: usize = 2000;

/// Most groups of readings that are tried.
const MOST: usize = 200;

/// Readings that may have another sign than the rest.
struct Group {
    set: String,
    /// `meas_y` in `a.csv`.
    words: String,
    /// Their equations, and what is added to the residuals of these if the sign is turned.
    added: Vec<(usize, f64)>,
}

/// A reading: its equation, its file and its channel.
pub(crate) struct Reading {
    pub equation: usize,
    pub file: usize,
    pub channel: usize,
    pub value: f64,
}

/// The sentence on the readings that agree with the rest if their signs are turned; none if they do as they are.
///
/// Residuals have the reading with a minus sign, so that a turned sign adds its double. All groups are tried in one factorisation, and
/// the best is fitted.
pub(crate) fn turned_readings(problem: &Problem) -> Option<Explained> {
    let few = spread(problem, ROWS);
    let groups = groups(&few);
    if groups.is_empty() {
        return None;
    }
    let columns: Vec<Vec<f64>> = groups.iter().map(|group| group.column(few.equations())).collect();
    let (costs, now) = costs(&few, &columns)?;
    let free = few.equations().checked_sub(few.unknowns.len()).filter(|free| *free > 0)? as f64;
    let fitted = |squares: f64| Fitted { squares, free };
    let tried = costs.iter().zip(&groups).zip(&columns);
    let mut explained: Vec<_> =
        tried.filter(|((cost, group), _)| group.explains(fitted(now), fitted(**cost))).collect();
    explained.sort_by(|((one, _), _), ((other, _), _)| one.total_cmp(other));
    let &((least, group), column) = explained.first()?;
    let most = least + ALIKE * (least / free).max(EXACT * EXACT);
    let alike = explained.iter().skip(1).take_while(|((cost, _), _)| **cost <= most).take(NAMED);
    let others: String = alike.map(|((_, other), _)| format!(", or else of {},", other.words)).collect();
    let (before, after) = (Fitted::of(&few)?, Fitted::of(&few.disturbed(column))?);
    group.explains(before, after).then(|| Explained {
        squares: after.squares,
        words: format!(
            "{}: with the signs of {}{others} turned the residuals scatter {:.2} times as much as stated, and as they are {:.2} times as much: is the sign of these \
             readings right?",
            group.set,
            group.words,
            after.scatter(),
            before.scatter()
        ),
    })
}

impl Group {
    fn column(&self, rows: usize) -> Vec<f64> {
        let mut column = vec![0.0; rows];
        self.added.iter().for_each(|&(equation, added)| column[equation] = added);
        column
    }

    /// Whether a turned sign of these readings is what was wrong: their residuals fall to a third, all scatter as stated then, or data are
    /// exact then.
    fn explains(&self, before: Fitted, after: Fitted) -> bool {
        let each = (before.squares - after.squares) / self.added.len() as f64;
        let falls = each > (FALLS * FALLS - 1.0) * after.squares / after.free && each > SIGNIFICANT * SIGNIFICANT;
        let is_exact = after.scatter() < EXACT && before.scatter() > INEXACT;
        falls || is_exact || before.is_explained_by(&after)
    }
}

/// What remains of the sum of squares of the residuals with each column added to them, and without any.
pub(crate) fn costs(problem: &Problem, columns: &[Vec<f64>]) -> Option<(Vec<f64>, f64)> {
    let weighted = Weighted::with_columns(problem, columns).ok()?;
    let lines = weighted.factor(&problem.start(), None).ok()?.lines();
    let (own, all) = (problem.unknowns.len(), weighted.unknowns());
    let left = |column: Option<usize>| {
        let added = |line: &Vec<f64>| line[all] + column.map_or(0.0, |column| line[own + column]);
        lines[own..].iter().map(added).map(|rest| rest * rest).sum::<f64>()
    };
    let found: Vec<f64> = (0..columns.len()).map(|column| left(Some(column))).collect();
    let now = left(None);
    let is_finite = now.is_finite() && found.iter().all(|cost| cost.is_finite());
    is_finite.then_some((found, now))
}

/// The groups of readings that are tried: channels, files, channels of files, and all of a set where there are several.
fn groups(problem: &Problem) -> Vec<Group> {
    let mut groups = Vec::new();
    let mut known = BTreeSet::new();
    let several = problem.sets.len() > 1;
    for (set, readings, names) in SetIndex::enumerate(&problem.sets).filter_map(|(index, _)| readings(problem, index)) {
        let files: BTreeSet<usize> = readings.iter().map(|reading| reading.file).collect();
        let channels: Vec<usize> = (0..names.len()).collect();
        let file_name = |file: usize| {
            let file = set.info().layout.data.files.get(file);
            file.map_or_else(String::new, |file| format!(" in `{}`", file.display()))
        };
        let mut group = |words: String, is_of: &dyn Fn(&Reading) -> bool| {
            let own: Vec<&Reading> = readings.iter().filter(|reading| is_of(reading)).collect();
            let equations: Vec<usize> = own.iter().map(|reading| reading.equation).collect();
            // Where there is one file, a channel of it is the channel.
            if own.len() >= SEVERAL && groups.len() < MOST && known.insert(equations) {
                let added = own.iter().map(|reading| (reading.equation, 2.0 * reading.value)).collect();
                groups.push(Group { set: set.name.clone(), words, added });
            }
        };
        for &channel in channels.iter().filter(|_| channels.len() > 1) {
            group(format!("`{}`", names[channel]), &|reading| reading.channel == channel);
        }
        for &file in files.iter().filter(|_| files.len() > 1) {
            group(format!("all readings{}", file_name(file)), &|reading| reading.file == file);
            for &channel in channels.iter().filter(|_| channels.len() > 1) {
                let is_of = |reading: &Reading| reading.file == file && reading.channel == channel;
                group(format!("`{}`{}", names[channel], file_name(file)), &is_of);
            }
        }
        if several {
            group("all its readings".to_owned(), &|_| true);
        }
    }
    groups
}

/// The readings of a set and the names of its channels; none if it has none.
pub(crate) fn readings(problem: &Problem, index: SetIndex) -> Option<(&ObservationSet, Vec<Reading>, Vec<String>)> {
    let set = &problem.sets[index];
    let (layout, names) = (&set.info().layout, channels_of(set));
    let columns: Vec<&[f64]> = names.iter().map(|name| layout.data.numbers(name)).collect::<Option<_>>()?;
    let first = problem.equation_ranges().get(index.0)?.start().0;
    let mut found = Vec::new();
    let mut equation = first;
    for &row in &set.rows {
        let own = &layout.rows[row];
        let data_row = own.data_row.filter(|_| own.equations == columns.len());
        for (channel, column) in columns.iter().enumerate().filter(|_| data_row.is_some()) {
            let Some(row) = data_row else { continue };
            let file = layout.data.origins[row].file;
            found.push(Reading { equation: equation + channel, file, channel, value: column[row] });
        }
        equation += own.equations;
    }
    (!found.is_empty()).then_some((set, found, names))
}
