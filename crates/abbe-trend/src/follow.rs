//! What parameters follow: a temperature of every test, from tables.

use abbe_core::{Dataset, Quantity, matches};

use crate::analysis::Regressor;
use crate::calibrations::History;

/// Gives series what they follow: the mean of a column over the rows of each test, found by its label in the column `by`.
///
/// Series whose names fit the pattern are known to follow it; for all others that follow nothing yet it is only tried.
///
/// # Errors
/// A sentence if no data have these columns, or no series fits the pattern.
pub fn follow(
    found: &mut History,
    by: &str,
    (pattern, column, reference): (&str, &str, f64),
    data: &[&Dataset],
) -> Result<(), String> {
    let labels: Vec<String> = found.tests.iter().map(|test| test.label.clone()).collect();
    let values = means(data, column, by, &labels)
        .ok_or_else(|| format!("no data have the columns `{column}` (numbers) and `{by}`"))?;
    if values.iter().all(Option::is_none) {
        return Err(format!("no row of the data has the `{by}` of a test"));
    }
    let unit = unit_of(data, column);
    let mut any = false;
    for series in &mut found.series {
        let declared = matches(pattern, &series.name);
        any |= declared;
        if declared || series.regressor.is_none() {
            series.regressor = Some(Regressor {
                name: column.to_owned(),
                unit: unit.clone(),
                reference,
                values: values.clone(),
                declared,
            });
        }
    }
    if any { Ok(()) } else { Err(format!("no charted parameter fits `{pattern}`")) }
}

/// The mean of a column over the rows of each group; none where a group has no row. None without such a column.
fn means(data: &[&Dataset], column: &str, by: &str, labels: &[String]) -> Option<Vec<Option<f64>>> {
    let found = data.iter().find_map(|data| Some((data.numbers(column)?, data.labels(by)?)))?;
    let mean = |label: &String| {
        let rows = found.0.iter().zip(found.1).filter(|(_, own)| *own == label);
        let (sum, count) = rows.fold((0.0, 0.0), |(sum, count), (value, _)| (sum + value, count + 1.0));
        (count > 0.0).then(|| sum / count)
    };
    Some(labels.iter().map(mean).collect())
}

fn unit_of(data: &[&Dataset], column: &str) -> String {
    let header = data.iter().find_map(|data| data.column(column)).map(|column| column.header.quantity);
    match header {
        Some(Quantity::Temperature) => "K".to_owned(),
        Some(quantity) => quantity.symbol().to_owned(),
        None => String::new(),
    }
}
