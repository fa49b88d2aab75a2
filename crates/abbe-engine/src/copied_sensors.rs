//! Sensors of temperature whose column is that of another one.

use abbe_core::{Dataset, Quantity};

/// Fewest different readings with which two sensors do not agree in all rows.
const DIFFERENT: usize = 20;

/// Two sensors of temperature that read the same in all rows, in words: one column is a copy of the other one. Sensors beside each other
/// may agree for a while.
pub(crate) fn copied_sensors(data: &Dataset) -> Option<String> {
    let columns = data.columns.iter().filter(|column| column.header.quantity == Quantity::Temperature);
    let sensors = columns.filter_map(|column| {
        let name = column.header.name.as_str();
        Some((name, data.numbers(name)?)).filter(|(_, values)| has_many(values))
    });
    let sensors: Vec<(&str, &[f64])> = sensors.collect();
    let pairs =
        sensors.iter().enumerate().flat_map(|(place, one)| sensors[..place].iter().map(move |other| (one, other)));
    pairs.into_iter().find(|((_, one), (_, other))| one == other).map(|((one, values), (other, _))| {
        format!(
            "{one} reads what {other} reads in all {} rows: was a column copied, or is one sensor read twice?",
            values.len()
        )
    })
}

/// Whether there are as many different readings.
fn has_many(values: &[f64]) -> bool {
    let mut bits: Vec<u64> = values.iter().map(|value| value.to_bits()).collect();
    bits.sort_unstable();
    bits.dedup();
    bits.len() >= DIFFERENT
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// What is told of a log of two sensors that warm up together, of which the second one is off by this much from some row on.
    fn told(digits: f64, off: f64, from: usize) -> Option<String> {
        let warm = |row: usize| 20.0 + 15.0 * (1.0 - (-(row as f64) / 40.0).exp());
        let written = |value: f64| (value / digits).round() * digits;
        let other = |row: usize| if row < from { warm(row) } else { warm(row) + off };
        let rows = (0..120).map(|row| format!("{row},{},{}\n", written(warm(row)), written(other(row))));
        let text = format!("time_s,T1_degC,T2_degC\n{}", rows.collect::<String>());
        copied_sensors(&abbe_table::parse(Path::new("log.csv"), text.as_bytes()).unwrap())
    }

    #[test]
    fn a_copied_column_is_told_and_sensors_that_agree_for_a_while_are_not() {
        let words = told(0.01, 0.0, 0).unwrap();
        assert!(words.starts_with("T2 reads what T1 reads in all 120 rows"), "{words}");
        assert_eq!(told(0.01, 0.01, 119), None);
        // Coarse digits hide what is between two sensors.
        assert_eq!(told(1.0, 0.0, 0), None);
    }
}
