//! The scatter of repeats, pooled over groups (Rahman 2016, section 5.6).

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_core::{DataRow, Error, LabelText, Layout, PooledRepeatability, Result, RowIndex};

use crate::row_settings::PooledRepeats;

/// The columns that tell repetitions apart.
const REPETITION: [&str; 2] = ["day", "cycle"];

/// A repetition: its label and its rows.
type Repetition = (Vec<LabelText>, Vec<RowIndex>);

/// The rows of a layout by repetition, in the order in which repetitions appear.
fn repetitions(layout: &Layout) -> Result<Vec<Repetition>> {
    let data = &layout.data;
    let columns: Vec<&[LabelText]> = REPETITION.iter().filter_map(|name| data.labels(name)).collect();
    if columns.is_empty() {
        let error = Error::data("the repeats have neither a column `cycle` nor a column `day`").setting("pooled");
        return Err(error);
    }
    let mut all: Vec<Repetition> = Vec::new();
    for (index, row) in RowIndex::enumerate(&layout.rows) {
        let Some(data_row) = row.data_row else { continue };
        let label: Vec<LabelText> = columns.iter().map(|column| column[data_row].clone()).collect();
        match all.iter_mut().find(|(other, _)| *other == label) {
            Some((_, rows)) => rows.push(index),
            None => all.push((label, vec![index])),
        }
    }
    Ok(all)
}

/// The scatter of `repeats` (their rows and residuals at nominal values) for the rows of `layout`.
///
/// Every repetition has the same rows in the same order; `layout` has one repetition or several. Each of these has the
/// scatter of one repetition; several are treated as independent.
pub fn pooled(
    settings: &PooledRepeats,
    layout: &Layout,
    repeats: &Layout,
    residuals: &[f64],
) -> Result<PooledRepeatability> {
    let known = repetitions(repeats)?;
    let own = match repetitions(layout) {
        Ok(own) => own,
        Err(_) => {
            vec![(Vec::new(), layout.row_indices().filter(|&row| layout.rows[row].data_row.is_some()).collect())]
        }
    };
    for (_, rows) in known.iter().skip(1) {
        same_rows((repeats, &known[0].1), (repeats, rows))?;
    }
    for (_, rows) in &own {
        same_rows((repeats, &known[0].1), (layout, rows))?;
    }
    let group_of = groups(settings, repeats, &known)?;
    let count = group_of.iter().max().map_or(0, |last| last + 1);
    let degrees_of_freedom = known.len() - count;
    if degrees_of_freedom == 0 {
        let by = settings.by.as_deref().unwrap_or("repetition");
        return Err(Error::data(format!("the repeats leave no degrees of freedom: every {by} was measured once only"))
            .help("measure again, or pool by another column")
            .setting("pooled"));
    }
    let values = |rows: &[RowIndex]| -> Vec<f64> {
        let rows = rows.iter().map(|&row| repeats.rows[row]);
        rows.flat_map(|row| residuals[row.equation_indices()].to_vec()).collect()
    };
    let measured: Vec<Vec<f64>> = known.iter().map(|(_, rows)| values(rows)).collect();
    let deviations: Vec<Vec<f64>> = (0..known.len())
        .map(|repetition| {
            let same: Vec<&Vec<f64>> = (0..known.len())
                .filter(|&other| group_of[other] == group_of[repetition])
                .map(|other| &measured[other])
                .collect();
            let mean = |equation: usize| same.iter().map(|values| values[equation]).sum::<f64>() / same.len() as f64;
            measured[repetition].iter().enumerate().map(|(equation, value)| value - mean(equation)).collect()
        })
        .collect();
    let mut pooled = PooledRepeatability {
        by: settings.by.clone().unwrap_or_else(|| "all".to_owned()),
        repetitions: Vec::new(),
        deviations: Vec::new(),
        degrees_of_freedom,
    };
    for (label, rows) in &own {
        for ((of, _), deviation) in known.iter().zip(&deviations) {
            let mut line = vec![0.0; layout.standard_uncertainties.len()];
            let mut values = deviation.iter();
            for row in rows.iter().map(|&row| layout.rows[row]) {
                line[row.equation_indices()].iter_mut().zip(values.by_ref()).for_each(|(to, value)| *to = *value);
            }
            pooled.repetitions.push(format!("{} <- {}", label.join("."), of.join(".")));
            pooled.deviations.push(line);
        }
    }
    Ok(pooled)
}

/// The group of every repetition.
fn groups(settings: &PooledRepeats, repeats: &Layout, known: &[Repetition]) -> Result<Vec<usize>> {
    let Some(by) = &settings.by else { return Ok(vec![0; known.len()]) };
    let present: Vec<&str> = REPETITION.iter().copied().filter(|name| repeats.data.labels(name).is_some()).collect();
    let Some(column) = present.iter().position(|name| name == by) else {
        let message = format!("repeats are pooled by {}, not by `{by}`", present.join(" or by "));
        return Err(Error::data(message).setting("pooled"));
    };
    let mut labels: Vec<&str> = Vec::new();
    let groups = known.iter().map(|(label, _)| {
        labels.iter().position(|other| *other == label[column]).unwrap_or_else(|| {
            labels.push(&label[column]);
            labels.len() - 1
        })
    });
    Ok(groups.collect())
}

/// The first file of which one repetition has another number of rows than the other, if both have rows of the same files.
fn shorter(
    (one, rows): (&Layout, &[RowIndex]),
    (other, others): (&Layout, &[RowIndex]),
) -> Option<(PathBuf, usize, usize)> {
    let of_files = |layout: &Layout, rows: &[RowIndex]| {
        let mut counts: BTreeMap<PathBuf, usize> = BTreeMap::new();
        for data_row in rows.iter().filter_map(|&row| layout.rows[row].data_row) {
            let file = layout.data.files.get(layout.data.origins[data_row].file).cloned().unwrap_or_default();
            *counts.entry(file).or_default() += 1;
        }
        counts
    };
    let (expected, found) = (of_files(one, rows), of_files(other, others));
    let are_same = expected.len() > 1 && expected.keys().eq(found.keys());
    let mut counts = expected.into_iter().zip(found.into_values()).filter(|_| are_same);
    counts.find(|((_, expected), found)| expected != found).map(|((file, expected), found)| (file, found, expected))
}

/// Refuses repetitions whose rows do not measure the same in the same order.
fn same_rows((one, rows): (&Layout, &[RowIndex]), (other, others): (&Layout, &[RowIndex])) -> Result<()> {
    let data_row = |layout: &Layout, row: RowIndex| layout.rows[row].data_row.unwrap_or_default();
    for (&row, &other_row) in rows.iter().zip(others) {
        for name in ["feature", "group"] {
            let (expected, found) = (one.data.labels(name), other.data.labels(name));
            let (Some(expected), Some(found)) = (expected, found) else { continue };
            let (at, other_at) = (data_row(one, row), data_row(other, other_row));
            if expected[at] != found[other_at] {
                let message = format!(
                    "repeats measure the same rows in the same order: {name} {} was expected here, as in the first repetition, not {}",
                    expected[at], found[other_at]
                );
                return Err(other.data.error_at(other_at, message));
            }
        }
    }
    if rows.len() != others.len() {
        // What a repetition measured stands in several files: the one that lacks rows is named.
        if let Some((file, found, expected)) = shorter((one, rows), (other, others)) {
            let message = format!("a repetition has {found} rows of this file; the first one has {expected}");
            return Err(Error::data(message).in_file(&file));
        }
        let last = others.last().map_or(DataRow(0), |&row| data_row(other, row));
        let message = format!("a repetition with {} rows ends here; the first one has {}", others.len(), rows.len());
        return Err(other.data.error_at(last, message));
    }
    Ok(())
}
