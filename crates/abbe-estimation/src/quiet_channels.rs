//! Channels of an instrument whose noise is not that of the others.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{DataRow, Problem, SetIndex};
use abbe_numerics::row_noise;

use crate::channels::channels_of;
use crate::copies::{least_uncertainties, step};

/// Rows that were measured together: those of an artefact stage in a file.
type Part<'a> = (&'a str, &'a Path);

/// The residuals of each channel in standard uncertainties, in the order of the rows, where an instrument has several channels.
fn of_channels<'a>(problem: &'a Problem, residuals: &[f64]) -> BTreeMap<Part<'a>, Vec<(String, Vec<f64>)>> {
    let names: Vec<Vec<String>> = problem.sets.iter().map(channels_of).collect();
    let rows = residuals.iter().zip(problem.standard_uncertainties()).zip(problem.constraints());
    let mut found: BTreeMap<Part<'a>, Vec<(String, Vec<f64>)>> = BTreeMap::new();
    let (mut last, mut channel) = (None, 0);
    for (((residual, u), is_known), (index, row)) in rows.zip(problem.equation_rows()) {
        channel = if last == Some((index, row)) { channel + 1 } else { 0 };
        last = Some((index, row));
        let set = &problem.sets[index];
        let Some((file, _)) = problem.origin(index, row).filter(|_| !is_known) else { continue };
        let names = &names[index.0];
        if names.len() > 1 && names.len() == set.info().layout.rows[row].equations {
            let none = || names.iter().map(|name| (name.clone(), Vec::new())).collect();
            let channels = found.entry((set.name.as_str(), file)).or_insert_with(none);
            channels[channel].1.push(residual / u);
        }
    }
    found
}

/// Part of the noise of each other channel below which that of a channel is in another unit, and the part of what was stated. One
/// direction may be read better than another one, and not ten times.
const OF_OTHERS: f64 = 0.1;
const OF_STATED: f64 = 0.2;

/// Part of what was stated above which the noise of the others is about as stated. What it is far above is no noise.
const AS_STATED: std::ops::Range<f64> = 0.3..3.0;

/// Part of what was stated below which residuals are those of exact data: no other unit makes them so small.
const EXACT: f64 = 1e-6;

/// The step of the digits of a channel over the least standard uncertainty of its readings.
fn digits(problem: &Problem, stage: &str, channel: &str) -> f64 {
    let set = SetIndex::enumerate(&problem.sets).find(|(_, set)| set.name == stage);
    let found = set.and_then(|(index, set)| {
        let data = &set.info().layout.data;
        let quantity = data.column(channel)?.header.quantity;
        let rows: Vec<DataRow> = data.row_indices().collect();
        let step = step(&(quantity, data.numbers(channel)?), &rows);
        Some(step / least_uncertainties(problem).get(&index)?.of(quantity))
    });
    found.unwrap_or(f64::INFINITY)
}

/// Most channels that are named.
const NAMED: usize = 5;

/// The same where only one channel is left that is read as stated.
const OF_ONE: f64 = 0.06;

/// Channels with far less noise from row to row than all others of their instrument: their readings are in another unit. What a model
/// lacks is in the residuals of all channels, and is mostly smooth. `residuals` are those of the fit, mm or rad. Sentences, one a channel.
pub fn quiet_channels(problem: &Problem, residuals: &[f64]) -> Vec<String> {
    let mut found = Vec::new();
    for ((stage, file), channels) in of_channels(problem, residuals) {
        let noises: Option<Vec<f64>> = channels.iter().map(|(_, own)| Some(row_noise(own)?.size)).collect();
        let Some(noises) = noises else { continue };
        let others: Vec<f64> = noises.iter().copied().filter(|noise| AS_STATED.contains(noise)).collect();
        let least = others.iter().copied().fold(f64::MAX, f64::min);
        let part = if others.len() > 1 || noises.len() == 2 { OF_OTHERS } else { OF_ONE };
        let most = (part * least).min(OF_STATED);
        // What its digits hide may be there.
        let is_quiet = |(own, (channel, _)): &(&f64, &(String, Vec<f64>))| {
            **own < most && **own > EXACT && **own + digits(problem, stage, channel) < most
        };
        let quiet: Vec<_> = noises.iter().zip(&channels).filter(is_quiet).collect();
        // Noise of one that is larger than stated is no noise, and leaves nothing to compare with.
        if others.is_empty() || noises.iter().any(|noise| *noise >= AS_STATED.end) {
            continue;
        }
        found.extend(quiet.into_iter().map(|(own, (channel, _))| {
            format!(
                "the residuals of `{channel}` of {stage} in `{}` scatter from row to row by {own:.3} of what is stated, those of the \
                 other channels {least:.2} times or more: is the unit of this channel right?",
                file.display()
            )
        }));
    }
    found.truncate(NAMED);
    found
}
