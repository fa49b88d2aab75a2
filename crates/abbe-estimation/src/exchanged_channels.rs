//! Channels of an instrument whose columns are exchanged: `meas_x` for `meas_y`.

use std::collections::BTreeSet;

use abbe_core::{Problem, SetIndex};

use crate::compared::{Explained, Fitted};
use crate::mistakes::spread;
use crate::turned_readings::{Reading, costs, readings};

/// Most rows of a set that are tried, and most exchanges.
const ROWS: usize = 2000;
const MOST: usize = 200;

/// Readings of a set with some channels exchanged.
struct Exchange {
    /// `table: with meas_x and meas_y of `a.csv` exchanged`.
    words: String,
    /// What is added to the residuals.
    added: Vec<f64>,
}

/// Channels with whose columns exchanged the residuals scatter as stated, and far less than as they are; none if there are none.
///
/// Residuals have the reading with a minus sign, so that another reading adds the difference.
pub(crate) fn exchanged_channels(problem: &Problem) -> Option<Explained> {
    let few = spread(problem, ROWS);
    let exchanges = exchanges(&few);
    if exchanges.is_empty() {
        return None;
    }
    let columns: Vec<Vec<f64>> = exchanges.iter().map(|exchange| exchange.added.clone()).collect();
    let (costs, _) = costs(&few, &columns)?;
    let best = costs.iter().enumerate().min_by(|(_, one), (_, other)| one.total_cmp(other))?.0;
    let (before, after) = (Fitted::of(&few)?, Fitted::of(&few.disturbed(&columns[best]))?);
    before.is_far_less_likely_than(&after, exchanges.len()).then(|| Explained {
        squares: after.squares,
        words: format!(
            "{} the residuals scatter {:.2} times as much as stated, and as they are {:.2} times as much: are these columns exchanged?",
            exchanges[best].words,
            after.scatter(),
            before.scatter()
        ),
    })
}

/// The orders of so many channels that are tried: two exchanged, or three in turn.
fn orders(channels: usize) -> Vec<Vec<usize>> {
    let all: Vec<usize> = (0..channels).collect();
    let mut found = Vec::new();
    for one in 0..channels {
        for other in one + 1..channels {
            let mut order = all.clone();
            order.swap(one, other);
            found.push(order);
        }
    }
    if channels == 3 {
        found.extend([vec![1, 2, 0], vec![2, 0, 1]]);
    }
    found
}

fn exchanges(problem: &Problem) -> Vec<Exchange> {
    let mut found = Vec::new();
    for (set, own, names) in SetIndex::enumerate(&problem.sets).filter_map(|(index, _)| readings(problem, index)) {
        let data = &set.info().layout.data;
        let quantity = |name: &String| data.column(name).map(|column| column.header.quantity);
        if names.len() < 2 || names.iter().any(|name| quantity(name) != quantity(&names[0])) {
            continue;
        }
        let files: BTreeSet<usize> = own.iter().map(|reading| reading.file).collect();
        let each = files.iter().filter(|_| files.len() > 1).map(|file| Some(*file));
        for file in [None].into_iter().chain(each) {
            for order in orders(names.len()) {
                let is_of = |row: &&[Reading]| file.is_none_or(|file| file == row[0].file);
                let mut added = vec![0.0; problem.equations()];
                // Each row has a reading of each channel.
                for row in own.chunks_exact(names.len()).filter(is_of) {
                    for (reading, other) in row.iter().zip(&order) {
                        added[reading.equation] = reading.value - row[*other].value;
                    }
                }
                let moved = || order.iter().enumerate().filter(|(place, other)| place != *other);
                let moved: Vec<String> = moved().map(|(place, _)| format!("`{}`", names[place])).collect();
                let path = file.and_then(|file| data.files.get(file));
                let of = path.map_or(String::new(), |path| format!(" of `{}`", path.display()));
                found.push(Exchange { words: format!("{}: with {}{of} exchanged", set.name, moved.join(", ")), added });
            }
        }
    }
    found.truncate(MOST);
    found
}
