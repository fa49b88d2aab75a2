//! Means of rows that were measured again and again: series of the same programme.

use std::collections::BTreeMap;

use abbe_core::{Column, DataRow, Dataset, Error, PathItem, Quantity, Result, Values};
use schemars::JsonSchema;
use serde::Deserialize;

/// Rows of several series at angles that differ by more than this, in rad, are no repetitions of each other.
const TURNED: f64 = 1e-3;

/// Means of repeated rows.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Average {
    /// The column whose labels tell the series apart, e.g. `file`.
    over: String,
    /// Columns of labels that have to agree. What a series measures twice are two rows: its first row with the same labels is
    /// averaged with the first ones of the others, its second with their second ones. All other columns of labels are left out.
    by: Vec<String>,
    /// Of what a series measures several times take the first row only.
    #[serde(default)]
    first_only: bool,
}

impl Average {
    /// One row for every group of rows, in the order of the first of each: the means of all numbers.
    pub(crate) fn of(&self, data: &Dataset) -> Result<Dataset> {
        let labels = |setting: &str, name: &str| {
            abbe_table::labels(data, name).map_err(|error| Error {
                place: None,
                setting: ["average", setting].map(|key| PathItem::Key(key.to_owned())).into(),
                ..error
            })
        };
        let series = labels("over", &self.over)?;
        let by = self.by.iter().map(|name| labels("by", name)).collect::<Result<Vec<_>>>()?;
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
        let mut columns = Vec::new();
        for Column { header, values } in &data.columns {
            let values = match values {
                Values::Numbers(numbers) => {
                    if header.quantity == Quantity::Angle {
                        same_angles(data, &header.header, numbers, &groups)?;
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
        Ok(Dataset { columns, origins, files: data.files.clone(), averaged: true })
    }
}

/// Refuses rows at different angles: their mean is no pose that was measured.
fn same_angles(data: &Dataset, header: &str, angles: &[f64], groups: &[Vec<DataRow>]) -> Result<()> {
    for rows in groups {
        if let Some(other) = rows.iter().find(|&&row| (angles[row] - angles[rows[0]]).abs() > TURNED) {
            let (file, line) = (data.origins[rows[0]].file, data.origins[rows[0]].line);
            let message = format!(
                "`{header}` differs from that of line {line} of `{}`, with which this row would be averaged",
                data.files[file].display()
            );
            return Err(data
                .error_at(*other, message)
                .help("name under `by` of `average` all columns that tell points apart"));
        }
    }
    Ok(())
}
