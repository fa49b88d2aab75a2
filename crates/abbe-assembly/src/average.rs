//! Means of rows that were measured again and again: series of the same programme.

use std::collections::BTreeMap;

use abbe_core::{Column, DataRow, Dataset, LabelText, Quantity, Result, Values};
use abbe_estimation::repeated_in_words;
use schemars::JsonSchema;
use serde::Deserialize;

/// Rows of several series at angles that differ by more than this, in rad, are no repetitions of each other.
const TURNED: f64 = 1e-3;

/// Means of repeated rows.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Average {
    /// The column whose labels tell the series apart, e.g. `file`.
    over: String,
    /// Columns of labels that have to agree. If a series has several rows with the same labels, its first row is
    /// averaged with the first rows of the other series, its second with their second ones, and so on. All other
    /// columns of labels are left out.
    by: Vec<String>,
    /// If a series has several rows with the same labels, take the first one only.
    #[serde(default)]
    first_only: bool,
}

impl Average {
    /// One row for every group of rows, in the order of the first of each: the means of all numbers.
    pub fn of(&self, data: &Dataset) -> Result<Dataset> {
        let labels = |setting: &str, name: &str| {
            abbe_table::labels(data, name).map_err(|error| error.setting_at(&["average", setting]))
        };
        let series = labels("over", &self.over)?;
        let by = self.by.iter().map(|name| labels("by", name)).collect::<Result<Vec<_>>>()?;
        if let Some(words) = repeated_in_words(data, data.row_indices()) {
            tracing::warn!("{words}; each counts in the means as a measurement of its own");
        }
        let mut times: BTreeMap<(Vec<&str>, &str), usize> = BTreeMap::new();
        let mut places: BTreeMap<(Vec<&str>, usize), usize> = BTreeMap::new();
        let mut groups: Vec<Vec<DataRow>> = Vec::new();
        for row in data.row_indices() {
            let point: Vec<&str> = by.iter().map(|labels| labels[row].as_str()).collect();
            let time = times.entry((point.clone(), &series[row])).or_insert(0);
            if self.first_only && *time > 0 {
                continue;
            }
            let place = *places.entry((point, *time)).or_insert_with(|| {
                groups.push(Vec::new());
                groups.len() - 1
            });
            groups[place].push(row);
            *time += 1;
        }
        if let Some(words) = uneven(&times) {
            tracing::warn!("`{}` {words}", self.over);
        }
        let mut columns = Vec::new();
        for Column { header, values } in &data.columns {
            let values = match values {
                Values::Numbers(numbers) => {
                    if header.quantity == Quantity::Angle {
                        same_angles(data, &header.header, numbers, &groups)?;
                    }
                    if header.quantity == Quantity::Length {
                        let others = deviating_series(numbers, series, &groups).into_iter();
                        others.for_each(|(series, off)| {
                            tracing::warn!(
                                "`{}` {series}: `{}` is {off:.3} mm away from the other series (median): does it belong to them?",
                                self.over,
                                header.header
                            );
                        });
                    }
                    let mean =
                        |rows: &Vec<DataRow>| rows.iter().map(|&row| numbers[row]).sum::<f64>() / rows.len() as f64;
                    Values::Numbers(groups.iter().map(mean).collect())
                }
                Values::Labels(labels) if self.by.contains(&header.name) => {
                    Values::Labels(groups.iter().map(|rows| labels[rows[0]].clone()).collect())
                }
                Values::Labels(_) => continue,
            };
            columns.push(Column { header: header.clone(), values });
        }
        let origins = groups.iter().map(|rows| data.origins[rows[0]]).collect();
        Ok(Dataset {
            columns,
            origins,
            files: data.files.clone(),
            averaged: true,
            is_log: false,
            stated_tips: data.stated_tips.clone(),
        })
    }
}

/// Two series that have the same labels in different numbers of rows, in words; `rows` counts those of each point in each series. A point
/// that a series lacks altogether shifts nothing.
fn uneven(rows: &BTreeMap<(Vec<&str>, &str), usize>) -> Option<String> {
    let all: Vec<(&[&str], &str, usize)> =
        rows.iter().map(|((point, series), count)| (point.as_slice(), *series, *count)).collect();
    let least_and_most = |of_point: &[(&[&str], &str, usize)]| {
        let (_, few, least) = *of_point.iter().min_by_key(|(_, _, count)| *count)?;
        let (point, many, most) = *of_point.iter().rev().max_by_key(|(_, _, count)| *count)?;
        let point = point.join(", ");
        (least < most).then(|| {
            format!(
                "{few} has {least} rows of {point}, and {many} has {most}: first rows are averaged with first rows, second with second \
                 ones and so on, and one that is missing shifts those after it"
            )
        })
    };
    all.chunk_by(|(one, ..), (other, ..)| one == other).find_map(least_and_most)
}

/// Distance from the other series, in mm, that is told.
const FAR: f64 = 0.02;

/// How many times as far away as the other series.
const FARTHER: f64 = 10.0;

/// The series whose values are far from those of the others, with the median of the distances.
fn deviating_series<'a>(values: &[f64], series: &'a [LabelText], groups: &[Vec<DataRow>]) -> Vec<(&'a str, f64)> {
    let mut away: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for rows in groups.iter().filter(|rows| rows.len() > 2) {
        let middle = median(rows.iter().map(|&row| values[row]).collect());
        rows.iter().for_each(|&row| away.entry(&series[row]).or_default().push(values[row] - middle));
    }
    let away: Vec<(&str, f64)> = away.into_iter().map(|(series, away)| (series, median(away))).collect();
    let usual = median(away.iter().map(|(_, off)| off.abs()).collect());
    away.into_iter().filter(|(_, off)| off.abs() > FAR.max(FARTHER * usual)).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Refuses rows at different angles: their mean is no pose that was measured.
fn same_angles(data: &Dataset, header: &str, angles: &[f64], groups: &[Vec<DataRow>]) -> Result<()> {
    for rows in groups {
        if let Some(other) = rows.iter().find(|&&row| (angles[row] - angles[rows[0]]).abs() > TURNED) {
            let first = data.origins[rows[0]];
            let message = format!(
                "`{header}` differs from that of {} of `{}`, with which this row would be averaged",
                first.in_words(),
                data.files[first.file].display()
            );
            return Err(data
                .error_at(*other, message)
                .help("name under `by` of `average` all columns that tell points apart"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_series_that_lacks_a_repetition_is_found() {
        let rows = |counts: [usize; 3]| {
            let points = ["1", "2"].into_iter().flat_map(|point| ["a", "b", "c"].map(|series| (vec![point], series)));
            points.zip(counts.into_iter().chain([1, 1, 1])).filter(|(_, count)| *count > 0).collect()
        };
        assert_eq!(uneven(&rows([4, 4, 4])), None);
        assert_eq!(uneven(&rows([4, 0, 4])), None);
        let words = uneven(&rows([4, 3, 4])).unwrap();
        assert!(words.starts_with("b has 3 rows of 1, and a has 4: "), "{words}");
    }

    #[test]
    fn series_that_do_not_belong_are_found() {
        let names = ["a", "b", "c", "d"].map(str::to_owned);
        let found = |offset: f64| {
            let (mut values, mut series, mut groups) = (Vec::new(), Vec::new(), vec![Vec::new(); 5]);
            for (index, name) in names.iter().enumerate() {
                for (group, rows) in groups.iter_mut().enumerate() {
                    rows.push(DataRow(values.len()));
                    let scatter = 1e-3 * ((index * 7 + group * 5) % 4) as f64;
                    values.push(100.0 * group as f64 + scatter + if name == "c" { offset } else { 0.0 });
                    series.push(LabelText::from(name.as_str()));
                }
            }
            let found = deviating_series(&values, &series, &groups);
            found.into_iter().map(|(name, off)| (name.to_owned(), off)).collect::<Vec<_>>()
        };
        assert_eq!(found(0.0), []);
        assert_eq!(found(0.015), []);
        for offset in [0.025, -0.1, -5.0, 20.0] {
            let found = found(offset);
            assert!(found.len() == 1 && found[0].0 == "c" && (found[0].1 - offset).abs() < 5e-3, "{found:?}");
        }
    }
}
