//! Measured lengths whose columns contradict each other, in words.

use std::collections::BTreeSet;

use abbe_core::{Column, Dataset, Quantity};

/// Most different references of a bar with a few lengths. Where there are more, they may be as near to each other as they like.
const FEW: usize = 5;

/// Parts by which references of one length differ that are two: expansion makes less of them, and other lengths are further apart.
const TWO: std::ops::Range<f64> = 2e-4..2e-3;

/// The numbers of a column of lengths.
fn lengths<'a>(data: &'a Dataset, name: &str) -> Option<&'a [f64]> {
    let is_length = |column: &&Column| column.header.quantity == Quantity::Length;
    data.column(name).filter(is_length).and_then(|_| data.numbers(name))
}

/// Two references that are too near for two lengths, and too far from each other for one.
pub(crate) fn two_references(data: &Dataset) -> Option<String> {
    let references = lengths(data, "reference")?;
    lengths(data, "X2")?;
    let mut different: Vec<(f64, usize)> = Vec::new();
    for (row, reference) in references.iter().enumerate() {
        if different.iter().all(|(known, _)| known != reference) {
            different.push((*reference, row));
        }
        if different.len() > FEW {
            return None;
        }
    }
    let apart = |one: f64, other: f64| (one / other - 1.0).abs();
    let pairs = (0..different.len()).flat_map(|other| (0..other).map(move |one| (one, other)));
    let (one, other) =
        pairs.into_iter().find(|(one, other)| TWO.contains(&apart(different[*one].0, different[*other].0)))?;
    let place = |(reference, row): (f64, usize)| {
        format!("{reference} mm in line {}", data.origins.get(row).map_or(0, |origin| origin.line))
    };
    Some(format!(
        "the reference is {}, and {}: one length has no two, and two lengths are further apart",
        place(different[one]),
        place(different[other])
    ))
}

/// Fewest rows that tell, and the digits of a measured position: one that was commanded is rounder.
const ROWS: usize = 5;
const DIGITS: f64 = 1e-3;

/// A coordinate of the ends of lengths that is the same in all rows, and no round one, while all others differ from row to row.
pub(crate) fn stands(data: &Dataset) -> Option<String> {
    let names = ["X1", "Y1", "Z1", "X2", "Y2", "Z2"];
    let columns: Vec<&[f64]> = names.iter().map(|name| lengths(data, name)).collect::<Option<_>>()?;
    let rows = data.rows();
    let different = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<BTreeSet<u64>>().len();
    let counts: Vec<usize> = columns.iter().map(|values| different(values)).collect();
    let standing: Vec<usize> = (0..names.len()).filter(|column| counts[*column] == 1).collect();
    let &[column] = standing.as_slice() else { return None };
    let value = columns[column][0];
    let is_round = (value / DIGITS - (value / DIGITS).round()).abs() < 1e-6;
    let vary = (0..names.len()).filter(|other| *other != column).all(|other| 2 * counts[other] > rows);
    (rows >= ROWS && !is_round && vary).then(|| {
        let line = data.origins.first().map_or(0, |origin| origin.line);
        format!(
            "{} is {value} mm in all {rows} rows, from line {line} on, while the other ends differ from row to row: was it measured?",
            names[column]
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(rows: &[[f64; 7]]) -> Dataset {
        let mut text = "X1_mm,Y1_mm,Z1_mm,X2_mm,Y2_mm,Z2_mm,reference_mm\n".to_owned();
        for row in rows {
            text.push_str(&(row.map(|value| format!("{value:.4}")).join(",") + "\n"));
        }
        abbe_table::parse(std::path::Path::new("a.csv"), text.as_bytes()).expect("a table")
    }

    /// Ends that scatter by some micrometres about their places, of a bar of this length.
    fn bar(seed: usize, rows: usize) -> Vec<[f64; 7]> {
        let scatter = |row: usize, column: usize| 0.01 * ((seed + 7 * row + 13 * column) as f64 * 1.7).sin();
        (0..rows)
            .map(|row| {
                let mut ends = [-152.1665, 59.9276, 556.6144, 152.4983, 60.245, 556.7617, 304.6686];
                (0..6).for_each(|column| ends[column] += scatter(row, column));
                ends
            })
            .collect()
    }

    #[test]
    fn a_bar_with_two_references_or_an_end_that_stands_is_told() {
        for seed in 0..200 {
            let good = bar(seed, 20);
            assert_eq!((two_references(&table(&good)), stands(&table(&good))), (None, None), "{seed}");
            let mut two = good.clone();
            (8..12).for_each(|row| two[row][6] += 0.1);
            let told = two_references(&table(&two)).expect("two references");
            assert!(told.contains("304.7686 mm in line 10"), "{told}");
            for column in 0..6 {
                let mut stuck = good.clone();
                let value = (stuck[0][column] * 1e3).round() * 1e-3 + 3e-4;
                stuck.iter_mut().for_each(|row| row[column] = value);
                assert!(stands(&table(&stuck)).is_some(), "{seed} {column}");
                // What was commanded stands, too.
                stuck.iter_mut().for_each(|row| row[column] = value.round());
                assert_eq!(stands(&table(&stuck)), None);
            }
        }
        // A bar that expands by 10 K, several lengths, and a gauge with many.
        let with = |references: &[f64]| {
            let rows = bar(1, references.len()).into_iter().zip(references).map(|(mut row, of)| {
                row[6] = *of;
                row
            });
            two_references(&table(&rows.collect::<Vec<_>>()))
        };
        assert_eq!(with(&[304.6686, 304.7021, 304.6686]), None);
        assert_eq!(with(&[100.0, 200.0, 300.0, 301.0, 100.0]), None);
        assert_eq!(with(&(0..40).map(|step| 900.0 + 0.5 * f64::from(step)).collect::<Vec<f64>>()), None);
    }
}
