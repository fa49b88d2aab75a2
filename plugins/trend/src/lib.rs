//! Validator `trend`: charts of every parameter over the calibrations of a machine, what has changed and since when, and when to
//! measure again. The statistics are those of `abbe-trend`.

use std::collections::BTreeMap;

use abbe_core::{
    Calibration, Context, Dataset, Error, Findings, Fit, Limit, PathItem, Result, SettingsError, Validate, positive,
};
use abbe_trend::{
    AgainRule, Analysis, ChartDesign, Forecast, History, Settings as Judged, Tested, TimedTest, add_volumetric,
    analyse, findings, follow, history, out_of_order, unit_factor,
};
use abbe_volumetric::{Grid, within};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

abbe_core::register!(
    Validate,
    "trend",
    "charts of calibrations over time, what has changed and since when, when to measure again",
    Settings,
    example,
    build,
    "../reference/validate-trend.md",
);

/// Settings of the history.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Names and patterns of what is charted. Default: all parameters of the machine that the tests estimate.
    #[serde(default)]
    parameters: Vec<String>,
    /// Time at which the baseline was measured, in the unit of the groups. A settling starts there.
    #[serde(default)]
    baseline_at: Option<f64>,
    /// Number of first tests whose mean is the target of what has changed, where there is no baseline. Of what has not, the mean of all is.
    #[serde(default = "default_first_tests")]
    first_tests: usize,
    /// Average number of tests between false alarms of each chart of a machine in control.
    #[serde(default = "default_run_length")]
    run_length: f64,
    /// Weight of the newest value in the moving average, 0 to 1.
    #[serde(default = "default_weight")]
    average_weight: f64,
    /// Half the change that the cumulative sums find fastest, in standard uncertainties.
    #[serde(default = "default_reference")]
    sum_reference: f64,
    /// Probability below which the residuals of a test reject it as a whole (chi-squared).
    #[serde(default = "default_rejected")]
    rejected_below: f64,
    /// Probability that a change of a parameter is decided for where there is none.
    #[serde(default = "default_significance")]
    significance: f64,
    /// What parameters are known to follow, by names or patterns of parameters.
    #[serde(default)]
    regressors: BTreeMap<String, Follows>,
    /// Chart the volumetric error as well, at these poses: `volumetric RMS` and `volumetric largest`.
    #[serde(default)]
    volumetric: Option<Grid>,
    /// When to measure again.
    #[serde(default)]
    again: Vec<AgainSetting>,
    /// Largest number of parameters that may have changed.
    #[serde(default = "default_changes")]
    changes: Limit,
}

/// A column that a parameter follows.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Follows {
    /// The column in the data under `from`, without its unit. The mean of the rows of each group counts.
    column: String,
    /// Its value without an effect, in the unit of the column: 20 for a temperature in degC.
    #[serde(default)]
    reference: f64,
}

/// A limit that a parameter must keep until the next test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct AgainSetting {
    /// The parameter; or `volumetric largest` or `volumetric RMS`, where `volumetric` is given.
    parameter: String,
    /// Its largest admissible size.
    limit: f64,
    /// Unit of the limit, as in calibration files or as people read it (`um`, `urad`, `um/m`).
    unit: String,
    /// Accepted probability that the limit is exceeded.
    #[serde(default = "default_risk")]
    risk: f64,
    /// Number of last tests that a line goes through.
    #[serde(default = "default_tests")]
    tests: usize,
    /// How the future is told.
    #[serde(default)]
    forecast: ForecastSetting,
}

/// How the future of a parameter is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum ForecastSetting {
    /// A straight line through the last tests; value and slope count as independent.
    #[default]
    Line,
    /// The same line with the covariance of value and slope.
    CorrelatedLine,
    /// A random walk with a trend, from all tests.
    RandomWalk,
}

fn default_first_tests() -> usize {
    5
}

fn default_run_length() -> f64 {
    ChartDesign::default().run_length
}

fn default_weight() -> f64 {
    ChartDesign::default().weight
}

fn default_reference() -> f64 {
    ChartDesign::default().reference
}

fn default_rejected() -> f64 {
    1e-4
}

fn default_significance() -> f64 {
    1e-3
}

fn default_changes() -> Limit {
    Limit::from(0.0)
}

fn default_risk() -> f64 {
    0.05
}

fn default_tests() -> usize {
    12
}

fn example() -> Value {
    json!({
        "baseline_at": 0,
        "regressors": { "EYY[1]": { "column": "T01", "reference": 20 } },
        "again": [{ "parameter": "EXX[b]", "limit": 4.5, "unit": "um" }],
        "changes": 0
    })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    let between = |name: &str, value: f64, low: f64, high: f64| match value > low && value < high {
        true => Ok(()),
        false => Err(SettingsError::new(name, format!("a number between {low} and {high} was expected"))),
    };
    between("run_length", settings.run_length, 2.0, 1e6)?;
    between("average_weight", settings.average_weight, 0.009, 1.0)?;
    between("sum_reference", settings.sum_reference, 0.0, 5.0)?;
    between("rejected_below", settings.rejected_below, 0.0, 1.0)?;
    between("significance", settings.significance, 0.0, 1.0)?;
    if let Some(grid) = &settings.volumetric {
        grid.check().map_err(|error| error.under([PathItem::Key("volumetric".to_owned())]))?;
    }
    if settings.first_tests == 0 {
        return Err(SettingsError::new("first_tests", "a number of at least 1 was expected"));
    }
    for (index, again) in settings.again.iter().enumerate() {
        let check = || {
            positive("limit", again.limit)?;
            between("risk", again.risk, 0.0, 0.5)?;
            match again.tests >= 3 {
                true => Ok(()),
                false => Err(SettingsError::new("tests", "a number of at least 3 was expected")),
            }
        };
        check().map_err(|error| error.under([PathItem::Key("again".to_owned()), PathItem::Index(index)]))?;
    }
    Ok(Box::new(Trend { settings }))
}

struct Trend {
    settings: Settings,
}

impl Validate for Trend {
    fn accepts_data(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        let (mut tests, others): (Vec<&Fit>, Vec<&Fit>) = fits.iter().partition(|fit| fit.calibration.group.is_some());
        let time = |fit: &Fit| fit.calibration.group.as_ref().map_or(0.0, |group| group.at);
        tests.sort_by(|one, other| time(one).total_cmp(&time(other)));
        let Some(group) = tests.first().and_then(|fit| fit.calibration.group.clone()) else {
            let message = "an estimate with `per` was expected: a history has many calibrations";
            return Err(Error::usage(message).setting("of"));
        };
        let stage = |fit: &Fit| fit.name.split('.').next().unwrap_or_default().to_owned();
        if let Some(other) = tests.iter().find(|fit| stage(fit) != stage(tests[0])) {
            let message =
                format!("one estimate with `per` was expected, not both {} and {}", stage(tests[0]), stage(other));
            return Err(Error::usage(message).setting("of").help("judge each by a stage `validate: trend` of its own"));
        }
        if others.len() > 1 {
            let message = "one estimate without `per` at most was expected: the baseline";
            return Err(Error::usage(message).setting("of"));
        }
        let tested: Vec<Tested<'_>> = tests.iter().filter_map(|fit| tested(fit)).collect();
        let baseline = others.first().map(|fit| &fit.calibration);
        let mut found = history(&tested, baseline, &self.settings.parameters, self.settings.rejected_below)?;
        if let Some(grid) = &self.settings.volumetric {
            let model = tests[0].problem.model.as_ref();
            let statuses = grid.statuses(model).map_err(|error| within(error, &["volumetric"]))?;
            add_volumetric(&mut found, model, &tested, baseline, &statuses)?;
        }
        self.follow(&mut found, &group.by, data)?;
        self.rules(&mut found)?;
        let analysis = self.analyse(&group.unit, &found);
        let of = tests[0].name.split('.').next().unwrap_or_default();
        let mut findings = findings(of, &found, &analysis, self.settings.changes)?;
        let (of_rows, of_data) =
            (times_of_rows(&tests), data.iter().map(|data| times_of_labels(&tests, &group.by, data)));
        let timed = std::iter::once(of_rows).chain(of_data);
        findings.remarks.extend(timed.filter_map(|timed| out_of_order(&group.by, &timed)));
        Ok(findings)
    }
}

/// The tests whose rows have times.
fn times_of_rows(tests: &[&Fit]) -> Vec<TimedTest> {
    let of_test = |fit: &&Fit| {
        let sets = fit.problem.sets.iter().filter_map(|set| {
            let layout = &set.info().layout;
            let times = layout.data.numbers("time")?;
            ends(set.rows.iter().filter_map(|row| Some(times[layout.rows[*row].data_row?])))
        });
        // Files may have clocks of their own.
        let time_s = sets.reduce(|one, other| [one[0].min(other[0]), one[1].max(other[1])])?;
        Some(TimedTest { label: fit.calibration.group.as_ref()?.label.clone(), time_s })
    };
    tests.iter().filter_map(of_test).collect()
}

/// The tests of which data have rows with times, by their labels.
fn times_of_labels(tests: &[&Fit], by: &str, data: &Dataset) -> Vec<TimedTest> {
    let (Some(labels), Some(times)) = (data.labels(by), data.numbers("time")) else { return Vec::new() };
    let of_test = |fit: &&Fit| {
        let label = &fit.calibration.group.as_ref()?.label;
        let rows = data.row_indices().filter(|row| labels[*row] == *label);
        Some(TimedTest { label: label.clone(), time_s: ends(rows.map(|row| times[row]))? })
    };
    tests.iter().filter_map(of_test).collect()
}

/// The smallest and the largest of some times; none without a finite one.
fn ends(times: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let finite = times.filter(|time| time.is_finite());
    finite.fold(None, |ends, time| match ends {
        None => Some([time; 2]),
        Some([first, last]) => Some([time.min(first), time.max(last)]),
    })
}

fn tested<'a>(fit: &'a Fit) -> Option<Tested<'a>> {
    let Calibration { group, .. } = &fit.calibration;
    let group = group.as_ref()?;
    Some(Tested { label: &group.label, at: group.at, calibration: &fit.calibration })
}

impl Trend {
    fn analyse(&self, unit: &str, found: &History) -> Analysis {
        let settings = &self.settings;
        let judged = Judged {
            charts: ChartDesign {
                run_length: settings.run_length,
                weight: settings.average_weight,
                reference: settings.sum_reference,
            },
            significance: settings.significance,
            target_at: settings.baseline_at,
            first_tests: settings.first_tests,
        };
        analyse(unit, &found.tests, &found.series, &found.covariances, &found.inputs, &judged)
    }

    /// Gives series what they follow. A temperature that is there is tried for the others.
    fn follow(&self, found: &mut History, by: &str, data: &[&Dataset]) -> Result<()> {
        for (pattern, follows) in &self.settings.regressors {
            follow(found, by, (pattern, &follows.column, follows.reference), data).map_err(|wrong| {
                let setting = ["regressors", pattern].map(|key| PathItem::Key(key.to_owned())).to_vec();
                Error { setting, ..Error::usage(wrong).help("the data stand under `from`") }
            })?;
        }
        Ok(())
    }

    fn rules(&self, found: &mut History) -> Result<()> {
        for (index, again) in self.settings.again.iter().enumerate() {
            let wrong = |key: &str, message: String| {
                let setting = vec![PathItem::Key("again".into()), PathItem::Index(index), PathItem::Key(key.into())];
                Error { setting, ..Error::usage(message) }
            };
            let series = found.series.iter_mut().find(|series| series.name == again.parameter);
            let Some(series) = series else {
                return Err(wrong("parameter", format!("`{}` is not charted", again.parameter)));
            };
            let Some(factor) = unit_factor(&again.unit, &series.unit) else {
                return Err(wrong("unit", format!("`{}` is no unit of `{}`", again.unit, series.name)));
            };
            let forecast = match again.forecast {
                ForecastSetting::Line => Forecast::Line,
                ForecastSetting::CorrelatedLine => Forecast::CorrelatedLine,
                ForecastSetting::RandomWalk => Forecast::RandomWalk,
            };
            series.again =
                Some(AgainRule { limit: again.limit * factor, risk: again.risk, tests: again.tests, forecast });
        }
        Ok(())
    }
}
