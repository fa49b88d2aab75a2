//! Sizes that no wear explains: tools that are longer or wider than their presets, or than they were.

use std::collections::BTreeMap;

use crate::judge::{Judged, Name};
use crate::record::Store;
use crate::settings::Quantity;

/// A dimension that has grown since the tool was last in use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grown {
    /// Index of the check.
    pub check: usize,
    /// What has grown.
    pub quantity: Quantity,
    /// By how much, um.
    pub by_um: f64,
    /// What chance makes of two measurements, um.
    pub allowed_um: f64,
}

/// Dimensions that are larger than when the tool was measured before, by more than `consistency_factor` standard uncertainties.
/// Tools that are others or broken do not count.
pub fn grown(store: &Store, judged: &[Judged]) -> Vec<Grown> {
    let mut last: BTreeMap<(&str, Quantity), usize> = BTreeMap::new();
    let mut found = Vec::new();
    for (check, it) in judged.iter().enumerate() {
        if matches!(it.name, Name::WrongTool | Name::Broken) {
            continue;
        }
        let tool = store.record.checks[check].tool.as_str();
        for quantity in Quantity::ALL {
            let Some(now) = store.index(check, quantity) else { continue };
            let Some(before) = last.insert((tool, quantity), now) else { continue };
            let by_um = (store.values[now].value - store.values[before].value) * 1e3;
            let c = |row, column| store.covariance[(row, column)];
            // What both share, the master, is not in the difference.
            let variance = (c(now, now) + c(before, before) - 2.0 * c(now, before)).max(0.0);
            let allowed_um = store.record.settings.consistency_factor * variance.sqrt() * 1e3;
            if by_um > allowed_um {
                found.push(Grown { check, quantity, by_um, allowed_um });
            }
        }
    }
    found
}

/// By how much a tool is longer or wider than its preset, um, if that is more than a tool may be off and it looks like no other.
pub fn too_long(store: &Store, it: &Judged) -> Option<f64> {
    let settings = &store.record.settings;
    let indices = (0..store.values.len()).filter(|&index| store.values[index].check == it.check);
    let long = indices.map(|index| {
        let expanded = settings.coverage_factor * store.short_uncertainty_um(index);
        (-store.short_um(index), settings.limits.wrong_um + expanded)
    });
    let most = long.filter(|(long, most)| long > most).map(|(long, _)| long).reduce(f64::max);
    most.filter(|_| it.looks_like.is_none())
}

/// Fewest tools of which more than half make a sentence on all of them.
const SEVERAL: usize = 3;

/// Sentences for the user: what has grown, by sessions, and presets that most tools are beyond.
pub fn sentences(store: &Store, judged: &[Judged]) -> Vec<String> {
    let mut told = Vec::new();
    let found = grown(store, judged);
    let mut sessions: Vec<&str> = store.record.checks.iter().map(|check| check.session.as_str()).collect();
    sessions.dedup();
    for (session, quantity) in
        sessions.into_iter().flat_map(|session| Quantity::ALL.map(|quantity| (session, quantity)))
    {
        let in_session = |check: usize| store.record.checks[check].session == session;
        let own: Vec<&Grown> = found.iter().filter(|it| it.quantity == quantity && in_session(it.check)).collect();
        let Some([least, most]) = extremes(own.iter().map(|it| it.by_um)) else { continue };
        let measured =
            store.values.iter().filter(|value| value.quantity == quantity && in_session(value.check)).count();
        let name = quantity.name();
        told.push(match own.len() >= SEVERAL && 2 * own.len() > measured {
            true => format!(
                "session {session}: the {name} of {} of {measured} tools has grown by {least:.1} to {most:.1} um since they were \
                 measured before, and no wear does that: is the master clean, and the same one?",
                own.len()
            ),
            false => {
                let each = own.iter().map(|it| format!("{} ({:.1} um)", store.record.checks[it.check].tool, it.by_um));
                let each: Vec<String> = each.collect();
                format!(
                    "session {session}: the {name} of tool {} has grown since it was measured before, and no wear does that",
                    each.join(" and of tool ")
                )
            }
        });
    }
    told.extend(Quantity::ALL.into_iter().filter_map(|quantity| beyond_presets(store, judged, quantity)));
    told
}

/// Whether most tools were beyond their presets when they were first measured: then it is not the tools.
fn beyond_presets(store: &Store, judged: &[Judged], quantity: Quantity) -> Option<String> {
    let mut first: BTreeMap<&str, usize> = BTreeMap::new();
    for (index, value) in store.values.iter().enumerate().filter(|(_, value)| value.quantity == quantity) {
        if !matches!(judged[value.check].name, Name::WrongTool | Name::Broken) {
            first.entry(&store.record.checks[value.check].tool).or_insert(index);
        }
    }
    let factor = store.record.settings.consistency_factor;
    let long = first.values().filter(|index| -store.short_um(**index) > factor * store.short_uncertainty_um(**index));
    let long: Vec<f64> = long.map(|index| -store.short_um(*index)).collect();
    let [least, most] = extremes(long.iter().copied())?;
    (long.len() >= SEVERAL && 2 * long.len() > first.len()).then(|| {
        format!(
            "the {0} of {1} of {2} tools was {least:.1} to {most:.1} um beyond their presets when they were first measured: is \
             `{0}_mm` of the master right?",
            quantity.name(),
            long.len(),
            first.len()
        )
    })
}

fn extremes(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    values.fold(None, |found, value| {
        let [least, most] = found.unwrap_or([value; 2]);
        Some([value.min(least), value.max(most)])
    })
}
