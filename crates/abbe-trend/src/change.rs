//! What has changed: nothing, a step, a straight line, an exponential, or what follows a regressor.
//!
//! Every form is fitted to all values by weighted least squares. A form counts if it explains more than chance would, also
//! after the best of all weeks and all time constants was looked for; among those that count the Bayesian information
//! criterion decides (Schwarz 1978). A search for steps alone would take wear, settling and season for steps.

use abbe_numerics::chi_squared_quantile;
use serde::{Deserialize, Serialize};

use crate::least_squares::{Solution, fit};

/// A value with its standard uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Uncertain {
    /// The value.
    pub value: f64,
    /// Its standard uncertainty.
    pub standard_uncertainty: f64,
}

impl From<(f64, f64)> for Uncertain {
    fn from((value, standard_uncertainty): (f64, f64)) -> Self {
        Self { value, standard_uncertainty }
    }
}

/// What has changed. Places are indices of the values that were given.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "form", rename_all = "kebab-case")]
pub enum Change {
    /// Nothing that chance would not make.
    None,
    /// A jump: a crash, a repair.
    Step {
        /// Its size.
        size: Uncertain,
        /// The first value after it.
        first: usize,
        /// The earliest first value that the data allow with 95 %.
        earliest: usize,
        /// The latest one.
        latest: usize,
    },
    /// A straight line: wear.
    Line {
        /// Change for each unit of time.
        rate: Uncertain,
    },
    /// A change that comes to rest: settling.
    Exponential {
        /// From the target, or the first value, to the end.
        amplitude: Uncertain,
        /// Time constant.
        time_constant: Uncertain,
    },
    /// It follows the regressor, which was not declared for it.
    Regressor {
        /// Change for each unit of the regressor.
        coefficient: Uncertain,
    },
}

/// Values of one parameter over time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Values<'a> {
    /// Times, ascending.
    pub at: &'a [f64],
    /// Values, relative to the target.
    pub values: &'a [f64],
    /// Standard uncertainties, above zero.
    pub uncertainties: &'a [f64],
    /// Columns that are fitted whatever has changed: none if the target is known.
    pub base: &'a [Vec<f64>],
    /// A constant beside a target: what has changed before the first test; none where the base has a free constant.
    pub offset: Option<&'a [f64]>,
    /// The first value that a step may come before: those before it are no tests.
    pub from: usize,
    /// Time at which the target was true, if it is known.
    pub target_at: Option<f64>,
    /// A regressor that the change may follow.
    pub regressor: Option<&'a [f64]>,
}

/// The change, the fit that decided, and what nothing explains: the probability of the chi-squared that is left.
#[derive(Debug, Clone)]
pub(crate) struct Decided {
    pub change: Change,
    /// Sum of squares that the change explains.
    pub gain: f64,
    /// What is left, and its degrees of freedom.
    pub left: (f64, usize),
}

/// A form that was tried.
struct Candidate {
    change: Change,
    chi_squared: f64,
    unknowns: usize,
    /// What chance explains at most.
    needed: f64,
}

/// Fewest values of which something is decided.
const FEWEST: usize = 4;

/// Decides what has changed; `significance` is the probability of a decision for a change where there is none.
pub(crate) fn decide(values: &Values<'_>, significance: f64) -> Option<Decided> {
    let unchanged = fit(values.base, values.values, values.uncertainties)?;
    let rows = values.at.len();
    let none =
        Candidate { change: Change::None, chi_squared: unchanged.chi_squared, unknowns: 0, needed: f64::NEG_INFINITY };
    let mut candidates = vec![none];
    candidates.extend(step(values, unchanged.chi_squared, significance));
    if rows >= FEWEST + values.base.len() {
        candidates.extend(line(values, significance));
        candidates.extend(exponential(values, significance));
        candidates.extend(regressor(values, significance));
    }
    candidates.retain(|candidate| unchanged.chi_squared - candidate.chi_squared > candidate.needed);
    let criterion = |candidate: &Candidate| candidate.chi_squared + candidate.unknowns as f64 * (rows as f64).ln();
    let best = candidates.into_iter().min_by(|one, other| criterion(one).total_cmp(&criterion(other)))?;
    let freedom = rows.saturating_sub(values.base.len() + best.unknowns);
    Some(Decided {
        gain: unchanged.chi_squared - best.chi_squared,
        left: (best.chi_squared, freedom),
        change: best.change,
    })
}

impl Values<'_> {
    fn fit(&self, columns: impl IntoIterator<Item = Vec<f64>>) -> Option<Solution> {
        let mut all = self.base.to_vec();
        all.extend(columns);
        fit(&all, self.values, self.uncertainties)
    }

    /// The column of a constant, unless the base has a free one.
    fn constant(&self) -> Option<Vec<f64>> {
        self.offset.map(<[f64]>::to_vec)
    }

    /// A column for the tests; what is no test has zero.
    fn of_tests(&self, function: impl Fn(f64) -> f64) -> Vec<f64> {
        let tests = |row: usize| self.offset.is_none_or(|offset| offset[row] != 0.0);
        self.at.iter().enumerate().map(|(row, at)| if tests(row) { function(*at) } else { 0.0 }).collect()
    }

    /// The time of the first test.
    fn begin(&self) -> f64 {
        let tests = |row: &usize| self.offset.is_none_or(|offset| offset[*row] != 0.0);
        (0..self.at.len()).find(tests).map_or(0.0, |row| self.at[row])
    }

    fn span(&self) -> f64 {
        self.at.last().unwrap_or(&0.0) - self.begin()
    }
}

/// The best step of all, by the part of each step that the base cannot produce.
fn step(values: &Values<'_>, unchanged: f64, significance: f64) -> Option<Candidate> {
    let rows = values.at.len();
    let after = |first: usize| (0..rows).map(|row| f64::from(u8::from(row >= first))).collect::<Vec<f64>>();
    let fits: Vec<(usize, Solution)> =
        (values.from..rows).filter_map(|first| Some((first, values.fit([after(first)])?))).collect();
    let (first, best) = fits.iter().min_by(|one, other| one.1.chi_squared.total_cmp(&other.1.chi_squared))?;
    let allowed = best.chi_squared + chi_squared_quantile(0.95, 1.0);
    let mut places = fits.iter().filter(|(_, fit)| fit.chi_squared <= allowed).map(|(first, _)| *first);
    let earliest = places.next().unwrap_or(*first);
    let size = Uncertain::from(best.value(values.base.len()));
    Some(Candidate {
        change: Change::Step { size, first: *first, earliest, latest: places.next_back().unwrap_or(earliest) },
        chi_squared: best.chi_squared.min(unchanged),
        unknowns: 2,
        needed: chi_squared_quantile(1.0 - significance / fits.len() as f64, 1.0),
    })
}

fn line(values: &Values<'_>, significance: f64) -> Option<Candidate> {
    let (constant, begin) = (values.constant(), values.begin());
    let added = 1 + usize::from(constant.is_some());
    let time = values.of_tests(|at| at - begin);
    let fitted = values.fit(constant.into_iter().chain([time]))?;
    Some(Candidate {
        change: Change::Line { rate: fitted.value(values.base.len() + added - 1).into() },
        chi_squared: fitted.chi_squared,
        unknowns: added,
        needed: chi_squared_quantile(1.0 - significance, added as f64),
    })
}

fn regressor(values: &Values<'_>, significance: f64) -> Option<Candidate> {
    let constant = values.constant();
    let added = 1 + usize::from(constant.is_some());
    let fitted = values.fit(constant.into_iter().chain([values.regressor?.to_vec()]))?;
    Some(Candidate {
        change: Change::Regressor { coefficient: fitted.value(values.base.len() + added - 1).into() },
        chi_squared: fitted.chi_squared,
        unknowns: added,
        needed: chi_squared_quantile(1.0 - significance, added as f64),
    })
}

/// Time constants that are tried, before the best is improved.
const TIME_CONSTANTS: usize = 40;

/// A change that comes to rest within the values: its time constant is at most half of their span.
fn exponential(values: &Values<'_>, significance: f64) -> Option<Candidate> {
    let (shortest, longest) = (shortest_interval(values.at)? / 3.0, values.span() / 2.0);
    if shortest >= longest {
        return None;
    }
    let chi_squared = |logarithm: f64| curve(values, logarithm.exp()).map_or(f64::INFINITY, |fit| fit.chi_squared);
    let step = (longest / shortest).ln() / (TIME_CONSTANTS - 1) as f64;
    let grid: Vec<f64> = (0..TIME_CONSTANTS).map(|index| shortest.ln() + index as f64 * step).collect();
    let best = grid.into_iter().min_by(|one, other| chi_squared(*one).total_cmp(&chi_squared(*other)))?;
    let best = minimum(best - step, (best + step).min(longest.ln()), chi_squared);
    let (time_constant, fitted) = (best.exp(), curve(values, best.exp())?);
    let added = fitted.values.len() - values.base.len();
    Some(Candidate {
        change: with_uncertainties(values, time_constant, &fitted)?,
        chi_squared: fitted.chi_squared,
        unknowns: added + 1,
        needed: chi_squared_quantile(1.0 - significance / 4.0, added as f64 + 1.0),
    })
}

/// The fit with a time constant: `amplitude (1 - exp(-(t - t0) / tau))` from the target, or with a constant of its own where it
/// is not known when the target was true.
fn curve(values: &Values<'_>, time_constant: f64) -> Option<Solution> {
    values.fit(curve_columns(values, time_constant))
}

fn curve_columns(values: &Values<'_>, time_constant: f64) -> Vec<Vec<f64>> {
    match values.target_at {
        Some(begin) => vec![values.of_tests(|at| 1.0 - (-(at - begin) / time_constant).exp())],
        None => {
            let begin = values.begin();
            let decay = values.of_tests(|at| -(-(at - begin) / time_constant).exp());
            values.constant().into_iter().chain([decay]).collect()
        }
    }
}

/// Amplitude and time constant with their joint uncertainty: one more column, the derivative to the time constant.
fn with_uncertainties(values: &Values<'_>, time_constant: f64, fitted: &Solution) -> Option<Change> {
    let mut columns = curve_columns(values, time_constant);
    let begin = values.target_at.unwrap_or_else(|| values.begin());
    let size = fitted.values[fitted.values.len() - 1];
    let slope = |at: f64| -size * (at - begin) / time_constant.powi(2) * (-(at - begin) / time_constant).exp();
    columns.push(values.of_tests(slope));
    let joint = values.fit(columns)?;
    let last = joint.values.len() - 1;
    // With a constant beside the target, that is what the parameter ends at; else what decays.
    let own = if values.target_at.is_none() && values.offset.is_some() { values.base.len() } else { last - 1 };
    let uncertainty = |column: usize| joint.covariance[(column, column)].max(0.0).sqrt();
    Some(Change::Exponential {
        amplitude: (fitted.values[own], uncertainty(own)).into(),
        time_constant: (time_constant, uncertainty(last)).into(),
    })
}

fn shortest_interval(at: &[f64]) -> Option<f64> {
    at.windows(2).map(|pair| pair[1] - pair[0]).filter(|gap| *gap > 0.0).min_by(f64::total_cmp)
}

/// Smallest value of a function with one minimum between two places, by the golden section.
pub(crate) fn minimum(low: f64, high: f64, function: impl Fn(f64) -> f64) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_749_894_8;
    let (mut low, mut high) = (low, high);
    for _ in 0..30 {
        let (left, right) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
        if function(left) < function(right) { high = right } else { low = left }
    }
    (low + high) / 2.0
}
