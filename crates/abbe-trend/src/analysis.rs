//! All together: tests and series in, charts, changes, events and intervals out.

use abbe_numerics::chi_squared_upper_tail;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::again::{Again, AgainRule, again};
use crate::change::{Change, Decided, Uncertain, Values, decide};
use crate::chart::{ChartDesign, ChartLimits, Charts};
use crate::events::events;
use crate::least_squares::fit;
use crate::source::{Explained, SharedInput};

/// A test of the machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Test {
    /// What it is called: `14`, `2026-03-02`.
    pub label: String,
    /// When it was, in the unit of time of the analysis; ascending.
    pub at: f64,
    /// Whether it counts. One that was rejected as a whole is on no chart.
    pub good: bool,
}

/// What a parameter is compared with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// Its value in the baseline.
    pub value: f64,
    /// The standard uncertainty of that; zero if it is taken as exact.
    pub standard_uncertainty: f64,
}

/// A quantity that a parameter may follow, such as a temperature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Regressor {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// The value at which it has no effect.
    pub reference: f64,
    /// Its value at every test; none if it is not known.
    pub values: Vec<Option<f64>>,
    /// Whether the parameter is known to follow it. Else it is only tried.
    pub declared: bool,
}

/// The values of one parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Name.
    pub name: String,
    /// Unit of values.
    pub unit: String,
    /// A value for every test; none where a test has none.
    pub values: Vec<Option<Uncertain>>,
    /// The part of the standard uncertainties that all tests share: that of a bar, say. It does not scatter.
    pub shared: f64,
    /// What it is compared with; without one, the mean of all tests, or of the first ones where something has changed.
    pub target: Option<Target>,
    /// What it may follow.
    pub regressor: Option<Regressor>,
    /// When to measure again.
    pub again: Option<AgainRule>,
    /// It is no parameter but follows from all of them: the volumetric error.
    pub derived: bool,
}

/// How a history is judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The charts.
    pub charts: ChartDesign,
    /// Probability that a change of a parameter is decided for where there is none.
    pub significance: f64,
    /// Time at which the targets were true.
    pub target_at: Option<f64>,
    /// Number of first tests whose mean is the target of a parameter without one that has changed.
    pub first_tests: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self { charts: ChartDesign::default(), significance: 1e-3, target_at: None, first_tests: 5 }
    }
}

/// What is to be said of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// No alarm, no change.
    InControl,
    /// It follows its declared regressor, and nothing else happens.
    Seasonal,
    /// A lone alarm that neither the other charts nor the next test confirm; or alarms that no form explains, where all tests together
    /// scatter as chance makes.
    Unconfirmed,
    /// Alarms that no form explains, where all tests together scatter more than chance makes. Where neither another chart nor the next
    /// test confirms them, the other tests have to do so without the farthest one.
    Alarm,
    /// A change was decided for.
    Changed,
}

/// What a parameter does with its declared regressor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Seasonal {
    /// Name of the regressor.
    pub regressor: String,
    /// Its unit.
    pub unit: String,
    /// Change for each unit of it.
    pub coefficient: Uncertain,
}

/// What a parameter tells. Values are those of the good tests that have one, listed in `tests`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterTrend {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// Indices of the tests.
    pub tests: Vec<usize>,
    /// The values.
    pub values: Vec<Uncertain>,
    /// What each is compared with: the target, or the line of the regressor.
    pub expected: Vec<f64>,
    /// The charts.
    pub charts: Charts,
    /// What is to be said.
    pub state: State,
    /// What has changed. Places are indices of all tests.
    pub change: Change,
    /// Sum of squares that the change explains.
    pub gain: f64,
    /// Probability that chance makes what is left.
    pub left: f64,
    /// What follows the declared regressor.
    pub seasonal: Option<Seasonal>,
    /// When to measure again.
    pub again: Option<Again>,
    /// It is no parameter but follows from all of them: the volumetric error.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub derived: bool,
}

/// Something that happened to the machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// The parameters, the most clearly changed first.
    pub parameters: Vec<String>,
    /// Of the first of them; for a jump, places are those of all.
    pub change: Change,
    /// The shared input that would explain it all: the artefact has changed, not the machine.
    pub explained: Option<Explained>,
}

/// What a history tells.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Analysis {
    /// Unit of time: `week`, `day`, `test`.
    pub time_unit: String,
    /// All tests.
    pub tests: Vec<Test>,
    /// Whole times between the first and the last test without one.
    pub missing: Vec<String>,
    /// How the charts were made.
    pub design: ChartDesign,
    /// Their limits.
    pub limits: ChartLimits,
    /// Every parameter.
    pub parameters: Vec<ParameterTrend>,
    /// What happened.
    pub events: Vec<Event>,
}

impl Analysis {
    /// Whether a change or a confirmed alarm was found.
    pub fn alarm(&self) -> bool {
        self.parameters.iter().any(|parameter| matches!(parameter.state, State::Changed | State::Alarm))
    }

    /// Whether there is a parameter with a test that counts. Without one a history says nothing of the machine.
    pub fn is_judged(&self) -> bool {
        !self.parameters.is_empty()
    }
}

/// Judges the history of a machine.
///
/// `covariances` has the covariance of all series at every test, without what all tests share (none where it is not known);
/// `inputs` are what they share.
pub fn analyse(
    time_unit: &str,
    tests: &[Test],
    series: &[Series],
    covariances: &[Option<DMatrix<f64>>],
    inputs: &[SharedInput],
    settings: &Settings,
) -> Analysis {
    let limits = settings.charts.limits();
    let parameters: Vec<ParameterTrend> =
        series.iter().filter_map(|series| trend(tests, series, &limits, settings)).collect();
    let events = events(series, &parameters, covariances, inputs);
    Analysis {
        time_unit: time_unit.to_owned(),
        missing: missing(tests),
        tests: tests.to_vec(),
        design: settings.charts,
        limits,
        parameters,
        events,
    }
}

/// Whole times between the first and the last test without one, where all times are whole and most have a test.
fn missing(tests: &[Test]) -> Vec<String> {
    let (Some(first), Some(last)) = (tests.first(), tests.last()) else { return Vec::new() };
    let count = last.at - first.at + 1.0;
    if tests.iter().any(|test| test.at.fract() != 0.0 || test.label.parse() != Ok(test.at)) || count > 2e6 {
        return Vec::new();
    }
    let gap = shortest_gap(tests);
    let steps = ((count - 1.0) / gap).floor() as usize;
    if steps + 1 > 4 * tests.len() {
        return Vec::new();
    }
    let whole = (0..=steps).map(|step| first.at + step as f64 * gap);
    whole.filter(|at| !tests.iter().any(|test| test.at == *at)).map(|at| at.to_string()).collect()
}

fn shortest_gap(tests: &[Test]) -> f64 {
    let gaps = tests.windows(2).map(|pair| pair[1].at - pair[0].at).filter(|gap| *gap > 0.0);
    gaps.min_by(f64::total_cmp).unwrap_or(1.0)
}

/// The values of good tests, with what is needed to judge them.
struct Good {
    tests: Vec<usize>,
    at: Vec<f64>,
    values: Vec<Uncertain>,
    regressor: Option<Vec<f64>>,
}

impl Good {
    fn of(tests: &[Test], series: &Series) -> Self {
        let declared = series.regressor.as_ref();
        let known =
            |index: usize| declared.is_none_or(|regressor| regressor.values[index].is_some() || !regressor.declared);
        let counts = |(index, value): (usize, &Option<Uncertain>)| {
            let usable = value.filter(|value| value.value.is_finite() && value.standard_uncertainty > 0.0)?;
            (tests[index].good && known(index)).then_some((index, usable))
        };
        let (tests_of, values): (Vec<usize>, Vec<Uncertain>) =
            series.values.iter().enumerate().filter_map(counts).unzip();
        let deviation = |regressor: &Regressor| {
            let values = tests_of.iter().map(|index| regressor.values[*index].map(|value| value - regressor.reference));
            values.collect::<Option<Vec<f64>>>()
        };
        let regressor = declared.and_then(deviation);
        Self { at: tests_of.iter().map(|index| tests[*index].at).collect(), tests: tests_of, values, regressor }
    }

    fn numbers(&self) -> Vec<f64> {
        self.values.iter().map(|value| value.value).collect()
    }

    fn uncertainties(&self) -> Vec<f64> {
        self.values.iter().map(|value| value.standard_uncertainty).collect()
    }

    /// The uncertainties without what all tests share, which does not scatter.
    fn own_uncertainties(&self, shared: f64) -> Vec<f64> {
        let own = |u: f64| (u * u - shared * shared).max(1e-4 * u * u).sqrt();
        self.values.iter().map(|value| own(value.standard_uncertainty)).collect()
    }
}

/// The trend of one parameter; none without values.
fn trend(tests: &[Test], series: &Series, limits: &ChartLimits, settings: &Settings) -> Option<ParameterTrend> {
    let good = Good::of(tests, series);
    if good.tests.is_empty() {
        return None;
    }
    let (values, uncertainties) = (good.numbers(), good.uncertainties());
    let declared = series.regressor.as_ref().filter(|regressor| regressor.declared);
    let line = declared.zip(good.regressor.as_ref()).and_then(|(regressor, deviations)| {
        let columns = [vec![1.0; values.len()], deviations.clone()];
        let fitted = fit(&columns, &values, &good.own_uncertainties(series.shared))?;
        let expected = deviations.iter().map(|deviation| fitted.values[0] + fitted.values[1] * deviation).collect();
        let (name, unit) = (regressor.name.clone(), regressor.unit.clone());
        Some((expected, Seasonal { regressor: name, unit, coefficient: fitted.value(1).into() }))
    });
    let decided = changed(&good, series, line.is_some(), settings);
    // Without a baseline and a change all tests know the level best. The mean of a few alone would be off by so much that
    // averages and sums run away from it.
    let unchanged = decided.as_ref().is_none_or(|decided| decided.change == Change::None);
    let first = if unchanged { good.values.len() } else { settings.first_tests };
    let target = series.target.unwrap_or_else(|| first_mean(&good, first));
    let (expected, seasonal): (Vec<f64>, Option<Seasonal>) = match line {
        Some((expected, seasonal)) => (expected, Some(seasonal)),
        None => (vec![target.value; values.len()], None),
    };
    let in_mean = series.target.is_none() && unchanged;
    let of_target = if seasonal.is_some() || in_mean { 0.0 } else { target.standard_uncertainty };
    let normalised: Vec<f64> = (values.iter().zip(&expected).zip(&uncertainties))
        .map(|((value, expected), uncertainty)| (value - expected) / uncertainty.hypot(of_target))
        .collect();
    let charts = Charts::of(&normalised, &settings.charts, limits);
    let scatters = decided.as_ref().is_none_or(|decided| by_chance(decided.left) < settings.significance);
    let others_scatter = decided
        .as_ref()
        .is_some_and(|decided| by_chance(without_farthest(decided.left, &charts.normalised)) < settings.significance);
    let (change, gain, left) = match decided {
        Some(Decided { change, gain, left }) => (change, gain, by_chance(left)),
        None => (Change::None, 0.0, 1.0),
    };
    let change = of_tests(change, &good.tests);
    let clear =
        |seasonal: &Seasonal| seasonal.coefficient.value.abs() > 3.0 * seasonal.coefficient.standard_uncertainty;
    let state = match change {
        // Charts of many parameters over many tests give alarms by chance, and the next test may confirm them.
        Change::None if charts.has_confirmed() && scatters => State::Alarm,
        Change::None if !charts.unconfirmed().is_empty() && others_scatter => State::Alarm,
        Change::None if charts.has_confirmed() || !charts.unconfirmed().is_empty() => State::Unconfirmed,
        Change::None if seasonal.as_ref().is_some_and(clear) => State::Seasonal,
        Change::None => State::InControl,
        _ => State::Changed,
    };
    let end = tests.last().map_or(0.0, |test| test.at);
    let again = series.again.as_ref().and_then(|rule| again(rule, &good.at, &values, &uncertainties, end));
    Some(ParameterTrend {
        name: series.name.clone(),
        unit: series.unit.clone(),
        tests: good.tests,
        values: good.values,
        expected,
        charts,
        state,
        change,
        gain,
        left,
        seasonal,
        again,
        derived: series.derived,
    })
}

/// Probability that chance makes so large a chi-squared, with its degrees of freedom, or a larger one.
fn by_chance((chi_squared, freedom): (f64, usize)) -> f64 {
    if freedom > 0 { chi_squared_upper_tail(chi_squared, freedom as f64) } else { 1.0 }
}

/// Chi-squared and degrees of freedom without the test that is farthest off.
fn without_farthest((chi_squared, freedom): (f64, usize), normalised: &[f64]) -> (f64, usize) {
    let farthest = normalised.iter().map(|z| z * z).fold(0.0, f64::max);
    ((chi_squared - farthest).max(0.0), freedom.saturating_sub(1))
}

/// The weighted mean of the first tests.
fn first_mean(good: &Good, count: usize) -> Target {
    let first = &good.values[..count.clamp(1, good.values.len())];
    let weight = |value: &Uncertain| value.standard_uncertainty.powi(-2);
    let weights: f64 = first.iter().map(weight).sum();
    Target {
        value: first.iter().map(|value| weight(value) * value.value).sum::<f64>() / weights,
        standard_uncertainty: weights.sqrt().recip(),
    }
}

/// What has changed, with indices of the values.
fn changed(good: &Good, series: &Series, seasonal: bool, settings: &Settings) -> Option<Decided> {
    let (mut at, mut values) = (good.at.clone(), good.numbers());
    let mut uncertainties = good.own_uncertainties(series.shared);
    let mut tried = good.regressor.clone().filter(|_| !seasonal);
    let rows = at.len();
    // What pins the level: the target and what all tests share.
    let pinned = series.target.filter(|_| !seasonal).map(|target| target.standard_uncertainty.hypot(series.shared));
    let typical = uncertainties.iter().copied().fold(f64::INFINITY, f64::min);
    let mut shift = 0;
    let (base, offset) = match (pinned, series.target) {
        (Some(pinned), Some(target)) => {
            values.iter_mut().for_each(|value| *value -= target.value);
            if pinned < 1e-3 * typical {
                (Vec::new(), Some(vec![1.0; rows]))
            } else {
                // The target is a value before all others; all share one unknown level.
                at.insert(0, settings.target_at.unwrap_or(at[0]));
                values.insert(0, 0.0);
                uncertainties.insert(0, pinned);
                tried.iter_mut().for_each(|tried| tried.insert(0, 0.0));
                shift = 1;
                let offset = (0..=rows).map(|row| f64::from(u8::from(row > 0))).collect();
                (vec![vec![1.0; rows + 1]], Some(offset))
            }
        }
        _ => {
            let mut base = vec![vec![1.0; rows]];
            base.extend(good.regressor.clone().filter(|_| seasonal));
            (base, None)
        }
    };
    let found = decide(
        &Values {
            at: &at,
            values: &values,
            uncertainties: &uncertainties,
            base: &base,
            offset: offset.as_deref(),
            from: if offset.is_some() { shift } else { 1 },
            target_at: settings.target_at.filter(|_| offset.is_some()),
            regressor: tried.as_deref(),
        },
        settings.significance,
    )?;
    let change = match found.change {
        Change::Step { size, first, earliest, latest } => {
            Change::Step { size, first: first - shift, earliest: earliest - shift, latest: latest - shift }
        }
        other => other,
    };
    Some(Decided { change, ..found })
}

/// The change with indices of all tests in place of those of the values.
fn of_tests(change: Change, tests: &[usize]) -> Change {
    match change {
        Change::Step { size, first, earliest, latest } => {
            Change::Step { size, first: tests[first], earliest: tests[earliest], latest: tests[latest] }
        }
        other => other,
    }
}
