//! What is hard to believe of a fit: for its heading in the summary.

use abbe_core::{Fit, Quantity, in_parallel};
use abbe_estimation::{copied_runs, doubtful_row, gathered_outliers, quiet_channels, statement};

use crate::number::short;
use crate::record::Remark;

mod files;

/// Stated uncertainties are rarely wrong by a larger factor.
const MISSTATED: f64 = 2.0;

/// Normal quantile of one in a million.
const MILLIONTH: f64 = 4.75;

/// The scatter of residuals, over what is true of it, that chance makes once in a million cases (quantile of chi-squared by Wilson &
/// Hilferty 1931).
fn by_chance(degrees_of_freedom: usize) -> f64 {
    let part = 2.0 / 9.0 / degrees_of_freedom.max(1) as f64;
    (1.0 - part + MILLIONTH * part.sqrt()).powf(1.5)
}

/// The scatter of residuals, over what was stated, above which a fit is not trusted: what chance makes of stated uncertainties that are
/// wrong by [`MISSTATED`].
fn unlikely_above(degrees_of_freedom: usize) -> f64 {
    MISSTATED * by_chance(degrees_of_freedom)
}

/// Stated uncertainties are rarely too large by more than this factor.
const OVERSTATED: f64 = 5.0;

/// The scatter below which stated uncertainties are not believed; as [`unlikely_above`].
fn unlikely_below(degrees_of_freedom: usize) -> f64 {
    let part = 2.0 / 9.0 / degrees_of_freedom.max(1) as f64;
    (1.0 - part - MILLIONTH * part.sqrt()).max(0.0).powf(1.5) / OVERSTATED
}

/// A fit whose residuals are far smaller than stated.
fn overstated(fit: &Fit) -> Option<String> {
    let report = &fit.calibration.fit;
    (report.sigma < unlikely_below(report.degrees_of_freedom)).then(|| {
        // How much smaller it is tells nothing more.
        let part = if report.sigma < 1e-3 { "less than 0.001".to_owned() } else { format!("only {}", short(report.sigma)) };
        format!(
            "the residuals scatter {part} times as much as the stated uncertainties promise: these are too large, or nothing was measured"
        )
    })
}

/// A fit with the residuals of its rows, mm or rad, for all who look at them; none where they cannot be evaluated.
struct Seen<'a> {
    fit: &'a Fit,
    residuals: Vec<f64>,
}

/// What is hard to believe of some fits, one remark for each thing: all on the scatter first, then those of the next kind.
pub(crate) fn doubts(all: &[Fit]) -> Vec<Remark> {
    let kinds: [fn(&Seen<'_>) -> Vec<String>; 14] = [
        |seen| understated(seen.fit).into_iter().collect(),
        |seen| overstated(seen.fit).into_iter().collect(),
        |seen| too_good(seen.fit).into_iter().collect(),
        files::too_good,
        quiet,
        files::too_bad,
        |seen| copied(seen.fit),
        |seen| too_many_outliers(seen.fit).into_iter().collect(),
        |seen| spoiled(seen.fit).into_iter().collect(),
        gathered,
        |seen| contradicted(seen).into_iter().collect(),
        |seen| disagreeing(seen.fit).into_iter().collect(),
        |seen| misstated(seen.fit),
        |seen| seen.fit.calibration.fit.remarks.clone(),
    ];
    let of_fits = in_parallel(all, None, |fit| {
        let residuals = fit.problem.residuals(&fit.problem.values_of(&fit.calibration)).unwrap_or_default();
        let seen = Seen { fit, residuals };
        kinds.map(|told| told(&seen))
    });
    let of_kind = |kind: usize| {
        let told = all.iter().zip(&of_fits).flat_map(move |(fit, told)| told[kind].iter().map(move |text| (fit, text)));
        told.map(|(fit, text)| Remark { estimate: fit.name.clone(), text: text.clone() })
    };
    (0..kinds.len()).flat_map(of_kind).collect()
}

/// A fit whose residuals are far larger than stated.
fn understated(fit: &Fit) -> Option<String> {
    let report = &fit.calibration.fit;
    (report.degrees_of_freedom > 0 && report.sigma > unlikely_above(report.degrees_of_freedom)).then(|| {
        format!(
            "the residuals scatter {} times as much as the stated uncertainties promise: the model lacks errors, or units, signs or \
             uncertainties are wrong",
            short(report.sigma)
        )
    })
}

/// Estimates that are not what the recipe states, but could be.
fn misstated(fit: &Fit) -> Vec<String> {
    let found = abbe_estimation::contradicted(&fit.problem, &fit.calibration);
    let told = found.iter().filter(|stated| !stated.is_mistake());
    told.map(|stated| format!("{}: is the statement right?", stated.describe())).collect()
}

/// Probability below which new rows and what was known do not agree.
const DISAGREEING: f64 = 0.01;

/// An update whose new rows do not agree with what was known.
fn disagreeing(fit: &Fit) -> Option<String> {
    let found = fit.calibration.fit.agreement.as_ref().filter(|found| found.probability < DISAGREEING)?;
    Some(format!(
        "the new rows do not agree with what was known: chi-squared {:.1} with {} degrees of freedom, probability {:.1e}",
        found.chi_squared, found.degrees_of_freedom, found.probability
    ))
}

/// Part of what was stated below which residuals of one quantity are not believed where those of another are as stated: by more than a
/// factor of [`OVERSTATED`] both, and centimetres are one of ten.
const TOO_GOOD: f64 = 0.2;

/// Part of what was stated above which residuals are about as stated.
const AS_STATED: f64 = 0.5;

/// A fit whose residuals of lengths are far smaller than stated while those of angles are not, or the other way round: the unit of one of
/// them is wrong. Where both are small the data are exact.
fn too_good(fit: &Fit) -> Option<String> {
    let stated = |wanted: Quantity| {
        let rows = fit.problem.standard_uncertainties().into_iter().zip(fit.problem.quantities());
        let squares: Vec<f64> = rows.filter(|(_, quantity)| *quantity == wanted).map(|(u, _)| u * u).collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    };
    let report = &fit.calibration.fit;
    let lengths = report.residual_rms_um * 1e-3 / stated(Quantity::Length);
    let angles = report.residual_rms_urad? * 1e-6 / stated(Quantity::Angle);
    let (small, other, part) =
        if lengths < angles { ("lengths", "angles", lengths) } else { ("angles", "lengths", angles) };
    let wrong = lengths.max(angles) > AS_STATED && part < TOO_GOOD && part.is_finite();
    wrong.then(|| {
        format!(
            "the residuals of {small} are {} of what is stated, those of {other} are not: is the unit of the {small} right?",
            short(part)
        )
    })
}

/// Standard uncertainties that a certificate is off by at most.
const OFF: f64 = 5.0;

/// Certificates that the estimate contradicts: known values that it is far from.
fn contradicted(seen: &Seen<'_>) -> Option<String> {
    let problem = &seen.fit.problem;
    let rows = seen.residuals.iter().zip(problem.standard_uncertainties()).zip(problem.constraints());
    let off = rows.zip(problem.equation_rows()).filter(|((_, is_known), _)| *is_known);
    let (worst, (set, row)) = off
        .map(|(((residual, u), _), row)| ((residual / u).abs(), row))
        .max_by(|(one, _), (other, _)| one.total_cmp(other))?;
    (worst > OFF).then(|| {
        format!(
            "{} is off by {} of its standard uncertainties: certificates contradict each other, or the machine lacks errors",
            statement(problem, set, row).unwrap_or_else(|| format!("a known value of {}", problem.sets[set].name)),
            short(worst)
        )
    })
}

/// The scatter below which data are exact, and runs repeat to the last digit.
const EXACT: f64 = 0.01;

/// Runs whose readings are those of others to the last digit.
fn copied(fit: &Fit) -> Vec<String> {
    match fit.calibration.fit.sigma > EXACT {
        true => copied_runs(&fit.problem),
        false => Vec::new(),
    }
}

/// Channels of an instrument with far less noise than the others.
fn quiet(seen: &Seen<'_>) -> Vec<String> {
    quiet_channels(&seen.fit.problem, &seen.residuals)
}

/// Outliers that gather where one axis is not where it usually is.
fn gathered(seen: &Seen<'_>) -> Vec<String> {
    gathered_outliers(&seen.fit.problem, &seen.fit.calibration, &seen.residuals)
}

/// One row that spoils a fit. Robust weights have left it out, and listed it.
fn spoiled(fit: &Fit) -> Option<String> {
    if fit.calibration.outliers.is_empty() { doubtful_row(&fit.problem) } else { None }
}

/// Part of the rows above which outliers are no gross errors any more.
const MOST_OUTLIERS: f64 = 0.25;

/// A fit that takes much of what was measured for outliers.
fn too_many_outliers(fit: &Fit) -> Option<String> {
    let outliers = fit.calibration.outliers.len();
    let rows = match fit.problem.sets.iter().map(|set| set.rows.len()).sum::<usize>() {
        // An estimate of readings that are no geometry has no sets; it reports the readings that it used.
        0 => fit.calibration.fit.observations + outliers,
        rows => rows,
    };
    (outliers as f64 > MOST_OUTLIERS * rows as f64).then(|| {
        format!(
            "{outliers} of {rows} rows are outliers: the stated uncertainties, the limit of outliers or the model are wrong"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_unlikely_hangs_on_the_degrees_of_freedom() {
        // Chi-squared at 0.999999: 23.93 (1), 51.97 (12, as tables have it), 6,315 (5,800); Wilson and Hilferty are within 8 %.
        for (freedom, chi_squared) in [(1, 23.93_f64), (12, 51.97), (5800, 6315.0)] {
            let expected = MISSTATED * (chi_squared / freedom as f64).sqrt();
            assert!((unlikely_above(freedom) / expected - 1.0).abs() < 0.08, "{freedom}: {}", unlikely_above(freedom));
        }
        assert!(unlikely_above(5800) < 2.7);
    }
}
