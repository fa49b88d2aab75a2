//! Readings in another unit, by their noise from row to row: what is stated of a reading tells how large that is. It takes part in the
//! search for a mistake once errors are implausible, and says nothing otherwise: errors that a model lacks scatter from row to row, too,
//! and smaller readings leave smaller residuals of any fit.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{Problem, SetIndex};
use abbe_numerics::row_noise;

use crate::turned_readings::{Reading, readings};

/// Noise over what is stated of a reading that is about as stated, and that is far from it.
const AS_STATED: std::ops::Range<f64> = 0.3..3.0;
const FAR: f64 = 5.0;

/// What readings are multiplied by if they were read in another unit.
const UNITS: [(f64, &str); 4] =
    [(25.4, "times 25.4"), (1.0 / 25.4, "divided by 25.4"), (1e3, "times 1000"), (1e-3, "divided by 1000")];

/// Most files of a set that are tried one by one.
const FILES: usize = 40;

/// Some readings of a set: of a channel, of a file, or all.
#[derive(Debug, Clone, Copy)]
struct Chosen {
    set: SetIndex,
    channel: Option<usize>,
    file: Option<usize>,
}

impl Chosen {
    fn has(&self, reading: &Reading) -> bool {
        self.channel.is_none_or(|own| own == reading.channel) && self.file.is_none_or(|own| own == reading.file)
    }
}

/// Units in which readings scatter from row to row as stated, where they do not as they are: `with the readings of table times 25.4`, and
/// what that adds to the residuals of `few`, which has some rows of the problem.
pub(crate) fn other_units(problem: &Problem, few: &Problem) -> Vec<(String, Vec<f64>)> {
    let mut found = Vec::new();
    let stated = problem.standard_uncertainties();
    for (index, _) in SetIndex::enumerate(&problem.sets) {
        let Some((set, all, names)) = readings(problem, index) else { continue };
        let files: BTreeSet<usize> = all.iter().map(|reading| reading.file).collect();
        let whole = Chosen { set: index, channel: None, file: None };
        let channels =
            (0..names.len()).filter(|_| names.len() > 1).map(|channel| Chosen { channel: Some(channel), ..whole });
        let of_files = files.iter().filter(|_| (2..=FILES).contains(&files.len()));
        let of_files = of_files.map(|file| Chosen { file: Some(*file), ..whole });
        for chosen in [whole].into_iter().chain(channels).chain(of_files) {
            let own: Vec<&Reading> = all.iter().filter(|reading| chosen.has(reading)).collect();
            let Some(ratio) = noise_over_stated(&own, &stated) else { continue };
            if (1.0 / FAR..FAR).contains(&ratio) {
                continue;
            }
            let file = chosen.file.and_then(|file| set.info().layout.data.files.get(file));
            let which = match (chosen.channel, file) {
                (Some(channel), _) => format!("`{}` of {}", names[channel], set.name),
                (_, Some(file)) => format!("the readings of `{}`", file.display()),
                _ => format!("the readings of {}", set.name),
            };
            let units = UNITS.iter().filter(|(factor, _)| AS_STATED.contains(&(factor * ratio)));
            found.extend(units.map(|(factor, words)| (format!("with {which} {words}"), added(few, chosen, *factor))));
        }
    }
    found
}

/// What readings scatter from row to row, over what is stated of them; none if they are too few, or not all scatter alike.
fn noise_over_stated(readings: &[&Reading], stated: &[f64]) -> Option<f64> {
    let mut rows: BTreeMap<(usize, usize), Vec<f64>> = BTreeMap::new();
    for reading in readings {
        let u = stated.get(reading.equation).copied().filter(|u| *u > 0.0)?;
        rows.entry((reading.file, reading.channel)).or_default().push(reading.value / u);
    }
    let noises: Option<Vec<f64>> =
        rows.values().map(|values| Some(row_noise(values).filter(|noise| noise.is_white)?.size)).collect();
    let (low, high) = noises?.into_iter().fold((f64::MAX, 0.0_f64), |(low, high), own| (low.min(own), high.max(own)));
    (low > 0.0 && high < FAR * low).then(|| (low * high).sqrt())
}

/// What is added to residuals if some readings are multiplied by a factor: residuals have the reading with a minus sign.
fn added(few: &Problem, chosen: Chosen, factor: f64) -> Vec<f64> {
    let mut added = vec![0.0; few.equations()];
    let own = readings(few, chosen.set).map_or_else(Vec::new, |(_, own, _)| own);
    for reading in own.iter().filter(|reading| chosen.has(reading)) {
        added[reading.equation] = (1.0 - factor) * reading.value;
    }
    added
}
