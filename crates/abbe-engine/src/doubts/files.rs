//! Files whose residuals are not as those of the others.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::number::short;

use super::{MISSTATED, Seen, by_chance};

/// Residuals of equations over their stated standard uncertainties.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Residuals {
    sum: f64,
    count: usize,
}

impl Residuals {
    fn add(&mut self, other: Self) {
        self.sum += other.sum;
        self.count += other.count;
    }

    /// Root mean square.
    fn rms(self) -> f64 {
        (self.sum / self.count.max(1) as f64).sqrt()
    }
}

/// Those of each artefact stage in each file, without what certificates state and without outliers.
fn of_files<'a>(seen: &Seen<'a>) -> BTreeMap<(&'a str, &'a Path), Residuals> {
    let (fit, problem) = (seen.fit, &seen.fit.problem);
    let outliers: BTreeSet<(&str, &str, usize)> =
        fit.calibration.outliers.iter().map(|row| (row.stage.as_str(), row.file.as_str(), row.row)).collect();
    let rows = seen.residuals.iter().zip(problem.standard_uncertainties()).zip(problem.constraints());
    let mut found: BTreeMap<(&str, &Path), Residuals> = BTreeMap::new();
    for (((residual, u), is_known), (set, row)) in rows.zip(problem.equation_rows()) {
        let Some((file, origin)) = problem.origin(set, row).filter(|_| !is_known) else { continue };
        let stage = problem.sets[set].name.as_str();
        let is_outlier =
            !outliers.is_empty() && outliers.contains(&(stage, file.display().to_string().as_str(), origin.row));
        if !is_outlier {
            found.entry((stage, file)).or_default().add(Residuals { sum: (residual / u).powi(2), count: 1 });
        }
    }
    found
}

/// Fewest residuals of a file that are looked at: fewer may be what the unknowns make of them.
const OF_A_FILE: usize = 20;

/// Part of what was stated below which the residuals of a file are not believed where those of others are as stated: of few, and of
/// many. Seconds of arc for microradians are 0.21.
const TOO_GOOD: f64 = 0.05;
const TOO_GOOD_OF_MANY: f64 = 0.25;

/// Part of what was stated above which the residuals of the others are about as stated.
const OTHERS: f64 = 0.5;

/// Part of what was stated below which residuals are those of exact data: no other unit makes them so small.
const EXACT: f64 = 1e-6;

/// Residuals of a file that are about half of what is stated, where those of the others are about as stated; how many of them are many,
/// and rows of a file for each unknown.
const HALF: std::ops::Range<f64> = 0.45..0.55;
const AS_STATED: std::ops::Range<f64> = 0.85..1.2;
const MANY: usize = 100;
const ROWS_OF_AN_UNKNOWN: usize = 4;

/// Files whose residuals are far smaller than stated while those of the other files are not: their readings are in another unit.
pub(super) fn too_good(seen: &Seen<'_>) -> Vec<String> {
    let mut files: BTreeMap<&Path, Residuals> = BTreeMap::new();
    for ((_, file), own) in of_files(seen) {
        files.entry(file).or_default().add(own);
    }
    let mut all = Residuals::default();
    files.values().for_each(|own| all.add(*own));
    let others = |own: &Residuals| Residuals { sum: all.sum - own.sum, count: all.count - own.count }.rms();
    let is_too_good = |own: &Residuals| {
        let most = if own.count >= MANY { TOO_GOOD_OF_MANY } else { TOO_GOOD };
        own.count >= OF_A_FILE && (EXACT..most).contains(&own.rms()) && others(own) > OTHERS
    };
    let fewest = MANY.max(ROWS_OF_AN_UNKNOWN * seen.fit.problem.unknowns.len());
    let is_half =
        |own: &Residuals| own.count >= fewest && HALF.contains(&own.rms()) && AS_STATED.contains(&others(own));
    let sentence = |(file, own): (&Path, Residuals)| {
        let words = match (is_too_good(&own), is_half(&own)) {
            (true, _) => "those of other files are not: is the unit of its readings right?",
            (_, true) => {
                "about half of those of other files: are its readings those of a radius where the others are of a diameter?"
            }
            _ => return None,
        };
        let (file, rms) = (file.display(), short(own.rms()));
        Some(format!("the residuals of `{file}` are {rms} of what is stated, {words}"))
    };
    files.into_iter().filter_map(sentence).collect()
}

/// Fewest residuals of a file by which it is told how well uncertainties are stated, and fewest such files.
const TELLING: usize = 50;
const SEVERAL: usize = 8;

/// Factor by which uncertainties of files are misstated at least where those of most others agree better.
const ALIKE: f64 = 1.25;

/// The same factor where there are two files, of which nobody knows which is the usual one.
const OF_TWO: f64 = 8.0;

/// Files whose agreement is known are within this many times the spread of the others.
const SPREADS: f64 = 5.0;

/// Most files that are named.
const NAMED: usize = 5;

/// Files whose residuals are far larger than those of the others: files that were exchanged, another certificate, another unit, or an
/// error that the model lacks.
///
/// A file stands out if its residuals exceed the median of all by more than chance makes of them once in a million, times the factor by
/// which uncertainties are misstated: 2; or, where there are many files with many residuals, as much as these differ.
pub(super) fn too_bad(seen: &Seen<'_>) -> Vec<String> {
    let files = of_files(seen);
    if files.len() < 2 {
        return Vec::new();
    }
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(0.0)
    };
    // Data that are better than stated, or exact, make no other file worse. Of two files the better one says what is usual.
    let all = files.values().map(|own| own.rms());
    let usual = if files.len() == 2 { all.fold(f64::MAX, f64::min) } else { median(all.collect()) }.max(1.0);
    let deviations = files.values().filter(|own| own.count >= TELLING).map(|own| (own.rms() / usual).ln().abs());
    let deviations: Vec<f64> = deviations.collect();
    let misstated = match deviations.len() >= SEVERAL {
        // 1.4826 times the median of deviations is the standard deviation of normal ones.
        true => (SPREADS * 1.4826 * median(deviations)).exp().clamp(ALIKE, MISSTATED),
        false if files.len() == 2 => OF_TWO,
        false => MISSTATED,
    };
    // Where the larger of two files is the worse one, the scatter of the whole fit says it.
    let (is_pair, rows) = (files.len() == 2, files.values().map(|own| own.count).sum::<usize>());
    let mut found: Vec<(&str, &Path, Residuals)> = files
        .into_iter()
        .filter(|(_, own)| !is_pair || 2 * own.count < rows)
        .filter(|(_, own)| own.rms() > usual * misstated * by_chance(own.count))
        .map(|((stage, file), own)| (stage, file, own))
        .collect();
    found.sort_by(|one, other| other.2.rms().total_cmp(&one.2.rms()));
    let sentence = |(stage, file, own): &(&str, &Path, Residuals)| {
        format!(
            "the residuals of {stage} in `{}` are {} times what is stated, those of {} {} times: is it the right file, does \
             the model lack an error there, or is something misstated (certificate, unit, place, uncertainty)?",
            file.display(),
            short(own.rms()),
            if is_pair { "the other file" } else { "most others" },
            short(usual)
        )
    };
    found.iter().take(NAMED).map(sentence).collect()
}
