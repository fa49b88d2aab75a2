//! What all validators share: limits, statistics, outliers.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{
    Calibration, Figure, Findings, Limit, PathItem, Problem, Result, RowIndex, SetIndex, SettingsError, in_parallel,
};

/// Largest admissible values by [`key`].
pub type Limits = BTreeMap<String, Limit>;

/// Unit of coordinates and sizes in figures.
pub const MM: &str = "mm";
/// Unit of lengths in figures.
pub const UM: &str = "um";
/// Unit of angles in figures.
pub const URAD: &str = "urad";
/// Unit of numbers without one.
pub const ONE: &str = "1";

/// How `limits` calls a figure: `max_um`, `standard_deviation_um`, `rank`.
pub fn key(name: &str, unit: &str) -> String {
    let name = name.replace(' ', "_");
    if unit == ONE { name } else { format!("{name}_{unit}") }
}

/// A unit in letters of ASCII, as figures have it.
pub fn ascii(symbol: &str) -> String {
    let letters = symbol.chars().map(|letter| match letter {
        'µ' => 'u',
        '²' => '2',
        '³' => '3',
        '⁴'..='⁹' => char::from_digit(letter as u32 - '⁰' as u32, 10).unwrap_or(letter),
        other => other,
    });
    letters.collect()
}

/// The unit as it ends a setting: `_um_per_m2`.
pub fn suffix(symbol: &str) -> String {
    if symbol == ONE { String::new() } else { format!("_{}", ascii(symbol).replace('/', "_per_")) }
}

/// Refuses limits for anything but these keys.
pub fn check_limits(limits: &Limits, keys: &[&str]) -> Result<(), SettingsError> {
    for (key, limit) in limits {
        let at = [PathItem::Key("limits".to_owned())];
        if !keys.contains(&key.as_str()) {
            let mut error = SettingsError::new(key, format!("there is no figure `{key}` to limit"));
            error.key = true;
            return Err(error.suggest(key, keys.iter().copied()).under(at));
        }
        check_finite(key, limit).map_err(|error| error.under(at))?;
    }
    Ok(())
}

/// Refuses a limit that is no finite number.
pub fn check_finite(key: &str, limit: &Limit) -> Result<(), SettingsError> {
    match limit.value.is_finite() {
        true => Ok(()),
        false => Err(SettingsError::new(key, "a finite number was expected")),
    }
}

/// Sets the limits of some of the main figures.
pub fn apply_limits(limits: &Limits, figures: &mut [Figure]) {
    for figure in figures.iter_mut().filter(|figure| !figure.detail) {
        figure.set_limit(limits.get(&key(&figure.name, &figure.unit)).copied());
    }
}

/// Sets the limits of all main figures. A limit of a figure that none of them is fails: what it asks for was not measured.
pub fn set_limits(limits: &Limits, figures: &mut Vec<Figure>) {
    apply_limits(limits, figures);
    let Some(of) = figures.first().map(|figure| figure.of.clone()) else { return };
    for (limited, &limit) in limits {
        if !figures.iter().any(|figure| !figure.detail && key(&figure.name, &figure.unit) == *limited) {
            let (name, unit) = named(limited);
            let mut absent = Figure { of: of.clone(), ..Figure::new("", name, f64::NAN, unit) };
            absent.set_limit(Some(limit));
            figures.push(absent);
        }
    }
}

/// Name and unit of the figure that a [`key`] is of.
fn named(key: &str) -> (String, &'static str) {
    let units = [UM, URAD, MM].into_iter();
    let split = units.filter_map(|unit| Some((key.strip_suffix(unit)?.strip_suffix('_')?, unit))).next();
    let (name, unit) = split.unwrap_or((key, ONE));
    (name.replace('_', " "), unit)
}

/// Relative standard uncertainty of a standard deviation or standard uncertainty with these degrees of freedom; zero if they
/// are infinite (JCGM 100:2008, E.4.3, equation E.7, and G.4.2, equation G.3).
pub fn relative_uncertainty(degrees_of_freedom: f64) -> f64 {
    (2.0 * degrees_of_freedom).sqrt().recip()
}

/// Standard uncertainty of a standard deviation, or of a standard uncertainty, with this relative one. With a limit it is that of one
/// which is at least as large as the limit: what came out small by chance has an uncertainty that is too small in proportion, and
/// a rule with a guard band would accept far more than it says.
pub fn uncertainty_of_scatter(scatter: f64, relative: f64, limit: Option<Limit>) -> f64 {
    relative * limit.map_or(scatter, |limit| scatter.max(limit.value))
}

/// A sample of numbers. A statistic that needs more numbers than there are is NaN.
#[derive(Debug, Clone, Default)]
pub struct Sample(pub Vec<f64>);

impl Sample {
    fn mean_of(&self, value: impl Fn(f64) -> f64) -> f64 {
        self.0.iter().map(|&number| value(number)).sum::<f64>() / self.0.len() as f64
    }

    /// The value that is better than all others; NaN if one is NaN.
    fn best(&self, beats: impl Fn(f64, f64) -> bool) -> f64 {
        let better = |a: f64, b: f64| if b.is_nan() || beats(b, a) { b } else { a };
        self.0.iter().copied().reduce(better).unwrap_or(f64::NAN)
    }

    /// Largest value.
    pub fn max(&self) -> f64 {
        self.best(|a, b| a > b)
    }

    /// Smallest value.
    pub fn min(&self) -> f64 {
        self.best(|a, b| a < b)
    }

    /// Largest absolute value.
    pub fn max_absolute(&self) -> f64 {
        self.best(|a, b| a.abs() > b.abs()).abs()
    }

    /// Mean.
    pub fn mean(&self) -> f64 {
        self.mean_of(|value| value)
    }

    /// Root mean square.
    pub fn rms(&self) -> f64 {
        self.mean_of(|value| value * value).sqrt()
    }

    /// Standard deviation, divided by n - 1.
    pub fn standard_deviation(&self) -> f64 {
        let mean = self.mean();
        let squares: f64 = self.0.iter().map(|value| (value - mean).powi(2)).sum();
        (squares / (self.0.len() as f64 - 1.0)).sqrt()
    }
}

/// The keys of limits of the figures of residuals, and further ones.
pub fn residual_limits<'a>(further: &[&'a str]) -> Vec<&'a str> {
    [&["max_um", "mean_um", "rms_um", "max_urad", "mean_urad", "rms_urad"], further].concat()
}

/// The (set, row) of the rows that a calibration lists as outliers.
pub fn outliers(problem: &Problem, calibration: &Calibration) -> BTreeSet<(SetIndex, RowIndex)> {
    ListedOutliers::new(calibration).among(problem)
}

/// The rows that a calibration lists as outliers: stage, file, row.
pub struct ListedOutliers<'a>(BTreeSet<(&'a str, &'a str, usize)>);

impl<'a> ListedOutliers<'a> {
    /// Those of a calibration.
    pub fn new(calibration: &'a Calibration) -> Self {
        let listed = calibration.outliers.iter();
        Self(listed.map(|outlier| (outlier.stage.as_str(), outlier.file.as_str(), outlier.row)).collect())
    }

    /// Those among the rows of a problem.
    pub fn among(&self, problem: &Problem) -> BTreeSet<(SetIndex, RowIndex)> {
        let mut found = BTreeSet::new();
        if self.0.is_empty() {
            return found;
        }
        for (index, set) in SetIndex::enumerate(&problem.sets) {
            for &row in &set.rows {
                if let Some((file, origin)) = problem.origin(index, row)
                    && self.0.contains(&(set.name.as_str(), file.display().to_string().as_str(), origin.row))
                {
                    found.insert((index, row));
                }
            }
        }
        found
    }
}

/// The findings of `judge` on every fit, with the limits of the settings.
pub fn judged<F>(fits: &[F], limits: &Limits, judge: impl Fn(&F, &mut Findings) -> Result<()>) -> Result<Findings> {
    let mut findings = Findings::default();
    fits.iter().try_for_each(|fit| judge(fit, &mut findings))?;
    set_limits(limits, &mut findings.figures);
    Ok(findings)
}

/// The same, with threads that share the fits.
pub fn judged_side_by_side<F: Sync>(
    fits: &[F],
    limits: &Limits,
    judge: impl Fn(&F, &mut Findings) -> Result<()> + Sync,
) -> Result<Findings> {
    let of_fits = in_parallel(fits, None, |fit| {
        let mut findings = Findings::default();
        judge(fit, &mut findings).map(|()| findings)
    });
    judged(&of_fits, limits, |found, all| {
        let Findings { figures, remarks, tables } = found.clone()?;
        all.figures.extend(figures);
        all.remarks.extend(remarks);
        all.tables.extend(tables);
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_a_few_numbers() {
        let sample = Sample(vec![1.0, -4.0, 3.0]);
        assert_eq!((sample.max(), sample.min(), sample.max_absolute(), sample.mean()), (3.0, -4.0, 4.0, 0.0));
        assert!((sample.rms() - (26.0_f64 / 3.0).sqrt()).abs() < 1e-15);
        assert!((sample.standard_deviation() - 13.0_f64.sqrt()).abs() < 1e-15);
        assert!(Sample(vec![1.0, f64::NAN, 2.0]).max().is_nan());
        assert!(Sample::default().max().is_nan() && Sample(vec![1.0]).standard_deviation().is_nan());
    }

    #[test]
    fn a_limit_of_what_was_not_measured_fails() {
        let limits = Limits::from([("max_um".to_owned(), 1.0.into()), ("mean_urad".to_owned(), 2.0.into())]);
        let mut figures = vec![Figure::new("fit", "max", 0.5, UM), Figure::new("other", "max", 0.6, UM)];
        set_limits(&limits, &mut figures);
        let decided: Vec<_> =
            figures.iter().map(|figure| (figure.name.as_str(), figure.value, figure.decide())).collect();
        let (pass, fail) = (Some(abbe_core::Decision::Pass), Some(abbe_core::Decision::Fail));
        assert_eq!(decided, [("max", Some(0.5), pass), ("max", Some(0.6), pass), ("mean", None, fail)]);
        assert_eq!(figures[2].unit, URAD);
    }

    #[test]
    fn limits_that_do_not_exist_are_refused() {
        let cases = [
            ("max_um", 1.0, ""),
            ("max_umm", 1.0, "limits.max_umm: there is no figure `max_umm` to limit (did you mean `max_um`?)"),
            ("sigma", 1.0, "limits.sigma: there is no figure `sigma` to limit (possible are: max_um, rank)"),
            ("rank", f64::NAN, "limits.rank: a finite number was expected"),
        ];
        for (key, limit, expected) in cases {
            let limits = Limits::from([(key.to_owned(), limit.into())]);
            let found =
                check_limits(&limits, &["max_um", "rank"]).map_or_else(|error| error.to_string(), |()| String::new());
            assert_eq!(found, expected);
        }
    }
}
