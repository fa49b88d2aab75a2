//! Sensors and counters that read the same in all rows of a log.

use super::Row;

/// Fewest rows in which a reading that never changes is told.
const DEAD: usize = 20;

/// Tells of a sensor or a counter that reads the same in all rows.
pub(super) fn tell_dead(rows: &[Row<'_>]) {
    let Some(first) = rows.first().filter(|_| rows.len() >= DEAD) else { return };
    if rows.iter().all(|row| row.spindle == first.spindle) {
        tracing::warn!(
            "the spindle is at {} °C in all {} rows: was the sensor connected? `temperature_limit_K` guards nothing then",
            first.spindle,
            rows.len()
        );
    }
    if rows.iter().all(|row| row.cutting == first.cutting) && rows.iter().any(|row| row.session != first.session) {
        tracing::warn!("cutting minutes are the same in all {} rows: no rate of wear follows from them", rows.len());
    }
}
