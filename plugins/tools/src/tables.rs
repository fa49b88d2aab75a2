//! Tables of verdicts, dimensions, wear and locked tools.

use std::fmt::Write as _;

use abbe_core::Calibration;

use crate::impossible::{grown, too_long};
use crate::judge::{Judged, Name};
use crate::record::Store;
use crate::settings::Quantity;
use crate::wear::Wear;

/// A number of a table; none is an empty cell.
fn cell(value: Option<f64>, decimals: usize) -> String {
    value.filter(|value| value.is_finite()).map_or(String::new(), |value| format!("{value:.decimals$}"))
}

/// All verdicts.
pub fn verdicts(store: &Store, judged: &[Judged]) -> String {
    let mut text =
        "session,tool,cutting_min,verdict,looks_like,rule,quantity,value_um,limit_um,expanded_uncertainty_um,\
                    length_deviation_um,length_expanded_uncertainty_um,radius_deviation_um,\
                    radius_expanded_uncertainty_um\n"
            .to_owned();
    for it in judged {
        let check = &store.record.checks[it.check];
        let mut cells = vec![
            check.session.clone(),
            check.tool.clone(),
            cell(Some(check.cutting_s / 60.0), 2),
            it.name.text().to_owned(),
            it.looks_like.clone().unwrap_or_default(),
            format!("\"{}\"", it.rule),
            it.quantity.name().to_owned(),
            cell(Some(it.value_um), 6),
            cell(Some(it.limit_um), 6),
            cell(Some(it.expanded_um), 6),
        ];
        for quantity in Quantity::ALL {
            let index = store.index(it.check, quantity);
            let expanded = |index| store.record.settings.coverage_factor * store.short_uncertainty_um(index);
            cells.push(cell(index.map(|index| -store.short_um(index)), 6));
            cells.push(cell(index.map(expanded), 6));
        }
        let _ = writeln!(text, "{}", cells.join(","));
    }
    text
}

/// All dimensions.
pub fn dimensions(calibration: &Calibration, store: &Store) -> String {
    let mut text = "session,tool,quantity,value_mm,standard_uncertainty_um\n".to_owned();
    for value in &store.values {
        let check = &store.record.checks[value.check];
        let known = calibration.get(&store.record.name(value.check, value.quantity));
        let uncertainty = known.map(|known| known.standard_uncertainty * 1e3);
        let (session, tool, name) = (&check.session, &check.tool, value.quantity.name());
        let _ = writeln!(text, "{session},{tool},{name},{:.9},{}", value.value, cell(uncertainty, 6));
    }
    text
}

/// Wear, and when limits are reached.
pub fn wear(store: &Store, wear: &[Wear]) -> String {
    let mut text = "tool,quantity,um_per_100_min,standard_uncertainty_um_per_100_min,cutting_min,limit_reached_min,\
                    limit_reached_standard_uncertainty_min\n"
        .to_owned();
    for Wear { tool, quantity, rate, uncertainty, reached } in wear {
        let cutting = store.record.last_check(tool).map(|check| store.record.checks[check].cutting_s / 60.0);
        let _ = writeln!(
            text,
            "{tool},{},{:.9},{:.9},{},{},{}",
            quantity.name(),
            rate * PER_100_MIN,
            uncertainty * PER_100_MIN,
            cell(cutting, 2),
            cell(reached.map(|reached| reached.time / 60.0), 6),
            cell(reached.map(|reached| reached.uncertainty / 60.0), 6)
        );
    }
    text
}

/// From mm/s to um per 100 minutes of cutting.
pub const PER_100_MIN: f64 = 1e3 * 6000.0;

/// A tool that must not be used.
#[derive(Debug, Clone, PartialEq)]
pub struct Locked<'a> {
    /// The tool.
    pub tool: &'a str,
    /// Why.
    pub reason: &'static str,
    /// The session that says so: its last one.
    pub session: &'a str,
    /// The tool that a wrong one looks like.
    pub looks_like: Option<&'a str>,
}

/// Tools that must not be used: those whose last verdict locks them, those that the last session did not measure in length and
/// radius, and, unless nothing is to be locked, those whose size no wear explains.
pub fn locked<'a>(store: &'a Store, judged: &'a [Judged], lock: &[Name]) -> Vec<Locked<'a>> {
    let (record, grown) = (&store.record, grown(store, judged));
    let mut list = Vec::new();
    for tool in &record.tools {
        let Some(it) = record.last_check(&tool.tool).and_then(|check| judged.get(check)) else { continue };
        let session = record.checks[it.check].session.as_str();
        let reason = match lock.contains(&it.name) {
            true => it.name.text(),
            false if session != record.last_session() || record.checks[it.check].measured.contains(&false) => {
                "not-measured"
            }
            false if !lock.is_empty() && too_long(store, it).is_some() => "too-long",
            false if !lock.is_empty() && grown.iter().any(|grown| grown.check == it.check) => "grown",
            false => continue,
        };
        list.push(Locked { tool: &tool.tool, reason, session, looks_like: it.looks_like.as_deref() });
    }
    list
}

/// The list as a table.
pub fn lock_list(locked: &[Locked<'_>]) -> String {
    let mut text = "tool,reason,session,looks_like\n".to_owned();
    for Locked { tool, reason, session, looks_like } in locked {
        let _ = writeln!(text, "{tool},{reason},{session},{}", looks_like.unwrap_or_default());
    }
    text
}
