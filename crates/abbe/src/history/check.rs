//! `abbe history check`: what the tests of one machine tell.

use std::collections::BTreeSet;
use std::path::PathBuf;

use abbe_core::{Calibration, Error, Estimated, Limit, Registry, Result};
use abbe_engine::model_of;
use abbe_history::{Filter, History, Stored};
use abbe_trend::{
    AgainRule, Analysis, Forecast, Quality, Settings, Tested, add_volumetric, analyse, findings, follow, history,
    unit_factor,
};
use abbe_volumetric::{Grid, Points};
use clap::Args;
use serde_json::{Value, json};

use super::read;
use crate::libraries::Libraries;

/// A machine to check.
#[derive(Args)]
pub struct Check {
    /// The history.
    history: PathBuf,
    #[command(flatten)]
    question: Question,
    /// Print the findings as JSON.
    #[arg(long)]
    pub(super) json: bool,
}

/// What is asked of a history.
#[derive(Args, Clone, Default)]
pub struct Question {
    /// The machine, if the history has several.
    #[arg(long)]
    pub machine: Option<String>,
    /// The estimate that was repeated, if the entries have several.
    #[arg(long)]
    pub estimate: Option<String>,
    /// The estimate that is the target of all charts. Default: the mean of all tests, or of the first five of what has changed.
    #[arg(long)]
    pub baseline: Option<String>,
    /// A limit that has to be kept until the next test, with its unit: `EXX[b]=4.5um`.
    #[arg(long, value_name = "PARAMETER=LIMIT")]
    pub limit: Vec<String>,
    /// Accepted probability that a limit is exceeded.
    #[arg(long, default_value_t = 0.05, value_parser = risk, allow_negative_numbers = true)]
    pub risk: f64,
    /// How limits are forecast: a straight line through the last 12 tests, or a random walk with a trend.
    #[arg(long, value_enum, default_value_t)]
    pub forecast: ForecastAsked,
    /// What a parameter is known to follow: a column of `--from`, and its value without an effect, as `EYY[1]=T01@20`.
    #[arg(long, value_name = "PARAMETER=COLUMN@REFERENCE", requires = "from")]
    pub follows: Vec<String>,
    /// CSV file with temperatures by test: a column as `week` or `day` with the label of the test, and the columns of `--follows`.
    #[arg(long, value_name = "FILE", requires = "follows")]
    pub from: Option<PathBuf>,
    /// Chart the volumetric error too, at so many points along every axis: `volumetric RMS` and `volumetric largest` (mm).
    #[arg(long, value_name = "POINTS")]
    pub volumetric: Option<usize>,
}

/// How the future is told.
#[derive(clap::ValueEnum, Clone, Copy, Default)]
pub enum ForecastAsked {
    /// A straight line; value and slope count as independent.
    #[default]
    Line,
    /// The same line with the covariance of value and slope.
    CorrelatedLine,
    /// A random walk with a trend.
    RandomWalk,
}

/// What the tests of a machine tell. Some of it is for the pages of `abbe serve` alone.
#[cfg_attr(not(feature = "serve"), allow(dead_code))]
pub struct Checked {
    /// The machine.
    pub machine: String,
    /// The estimate that was repeated.
    pub estimate: String,
    /// Number of tests.
    pub tests: usize,
    /// Charts, changes, events.
    pub analysis: Analysis,
    /// How good each test is.
    pub quality: Vec<Quality>,
    /// The same in words.
    pub remarks: Vec<String>,
}

impl Checked {
    /// The state of the machine, and the exit status that tells it.
    pub fn state(&self) -> (&'static str, u8) {
        match (self.analysis.is_judged(), self.analysis.alarm()) {
            (false, _) => ("not judged", 3),
            (true, true) => ("alarm", 3),
            (true, false) => ("in control", 0),
        }
    }
}

impl Check {
    pub(super) fn run(self, libraries: &Libraries) -> Result<(String, u8)> {
        let checked = self.question.answer(&read(&self.history)?, &|| libraries.registry(None))?;
        let (state, status) = checked.state();
        let Checked { machine, analysis, .. } = &checked;
        if self.json {
            let text = serde_json::to_string_pretty(
                &json!({ "machine": machine, "alarm": analysis.alarm(), "judged": analysis.is_judged(), "analysis": analysis }),
            );
            let text = text.map_err(|error| Error::data(format!("the output cannot be written: {error}")))?;
            return Ok((text + "\n", status));
        }
        let mut text = format!("{machine}: {} tests, {state}\n", checked.tests);
        checked.remarks.iter().for_each(|remark| text.extend(["  ", remark, "\n"]));
        Ok((text, status))
    }
}

/// Newest calibrations of a machine whose entries are compared with their hashes before they are judged. All entries are when they are
/// shown or exported.
const VERIFIED: usize = 8;

impl Question {
    /// Reads the tests of the machine and judges them.
    fn answer(&self, kept: &History, registry: &dyn Fn() -> Result<Registry>) -> Result<Checked> {
        let machine = self.machine(kept)?;
        let all = kept.calibrations(&Filter { machine: Some(machine.clone()), entry: None })?;
        let newest: BTreeSet<i64> = all.iter().rev().take(VERIFIED).map(|(entry, _)| *entry).collect();
        kept.verify(newest)?;
        self.judge(&machine, &all, registry)
    }

    /// Judges the calibrations of a machine, which are in the order of time. Plugins are asked for where the machine itself is needed.
    pub fn judge(
        &self,
        machine: &str,
        all: &[(i64, Stored)],
        registry: &dyn Fn() -> Result<Registry>,
    ) -> Result<Checked> {
        let tests = self.tests(all)?;
        let tested: Vec<Tested<'_>> = tests
            .iter()
            .map(|stored| Tested { label: &stored.label, at: stored.at, calibration: &stored.calibration })
            .collect();
        let baseline = self.baseline(all)?;
        let mut known = history(&tested, baseline, &[], 1e-4)?;
        if let Some(points) = self.volumetric {
            volumetric(&mut known, points, &tested, baseline, &registry()?)?;
        }
        self.follow(&mut known, &tests)?;
        for limit in &self.limit {
            let (name, rule) = self.rule(limit, &known.series)?;
            known.series.iter_mut().filter(|series| series.name == name).for_each(|series| series.again = Some(rule));
        }
        let unit = tests.first().map_or("test", |stored| stored.unit.as_str());
        let analysis =
            analyse(unit, &known.tests, &known.series, &known.covariances, &known.inputs, &Settings::default());
        let mut remarks = findings(machine, &known, &analysis, Limit::from(0.0))?.remarks;
        remarks.extend(copies(&tests));
        let estimate = tests.first().map_or("", |stored| estimate_of(stored)).to_owned();
        Ok(Checked {
            machine: machine.to_owned(),
            estimate,
            tests: tests.len(),
            analysis,
            quality: known.quality,
            remarks,
        })
    }

    /// Gives parameters what they follow.
    fn follow(&self, known: &mut abbe_trend::History, tests: &[&Stored]) -> Result<()> {
        let Some(file) = &self.from else { return Ok(()) };
        let data = abbe_table::read(file)?;
        let group = tests.first().and_then(|stored| stored.calibration.group.as_ref());
        let by = group.map_or("day", |group| group.by.as_str());
        for text in &self.follows {
            let wrong = || {
                Error::usage(format!("--follows: `{text}`: one as `EYY[1]=T01@20` was expected"))
                    .help("the parameter, a column of `--from` without its unit, and its value without an effect")
            };
            let (pattern, followed) = text.rsplit_once('=').ok_or_else(wrong)?;
            let (column, reference) = followed.split_once('@').unwrap_or((followed, "0"));
            let reference: f64 = reference.parse().map_err(|_| wrong())?;
            follow(known, by, (pattern, column, reference), &[&data])
                .map_err(|told| Error::usage(format!("--follows: `{text}`: {told}")).in_file(file))?;
        }
        Ok(())
    }

    fn machine(&self, history: &History) -> Result<String> {
        let machines = history.machines()?;
        let names: Vec<&str> = machines.iter().map(|(name, _)| name.as_str()).collect();
        match (&self.machine, names.as_slice()) {
            (Some(machine), names) if names.contains(&machine.as_str()) => Ok(machine.clone()),
            (Some(machine), names) => {
                let error = Error::usage(format!("the history {} has no machine `{machine}`", history.name()));
                let listed = error.help(format!("its machines are: {}", names.join(", ")));
                Err(listed.suggest(machine, names.iter().copied()))
            }
            (None, [only]) => Ok((*only).to_owned()),
            (None, names) => {
                let message =
                    format!("the history {} has {} machines: {}", history.name(), names.len(), names.join(", "));
                Err(Error::usage(message).help("name one by `--machine`"))
            }
        }
    }

    /// The tests in the order of time; of one time the entry that was added last counts.
    fn tests<'a>(&self, all: &'a [(i64, Stored)]) -> Result<Vec<&'a Stored>> {
        let mut names: Vec<&str> = Vec::new();
        let is_baseline = |name: &str| self.baseline.as_deref() == Some(name);
        let grouped = all.iter().any(|(_, stored)| stored.calibration.group.is_some());
        for (_, stored) in all {
            let name = estimate_of(stored);
            let counts = !grouped || stored.calibration.group.is_some();
            if counts && !is_baseline(name) && !names.contains(&name) {
                names.push(name);
            }
        }
        let estimate = match (&self.estimate, names.as_slice()) {
            (Some(estimate), _) => estimate.as_str(),
            (None, [only]) => only,
            (None, []) => return Err(Error::usage("the history has no calibration of this machine")),
            (None, several) => {
                return Err(Error::usage(format!("the entries have several estimates: {}", several.join(", ")))
                    .help("name the one that was repeated by `--estimate`"));
            }
        };
        let mut tests: Vec<&Stored> = Vec::new();
        for (_, stored) in all.iter().filter(|(_, stored)| estimate_of(stored) == estimate) {
            match tests.iter_mut().find(|known| known.at == stored.at && known.unit == stored.unit) {
                Some(known) => *known = stored,
                None => tests.push(stored),
            }
        }
        match tests.as_slice() {
            [] => Err(Error::usage(format!("the history has no `{estimate}` of this machine"))),
            [first, others @ ..] if others.iter().any(|other| other.unit != first.unit) => {
                Err(Error::data(format!("the tests of `{estimate}` have times of different kinds"))
                    .help("keep tests by week and tests by date in histories of their own"))
            }
            all => same_machine(all, estimate).map(|()| tests),
        }
    }

    fn baseline<'a>(&self, all: &'a [(i64, Stored)]) -> Result<Option<&'a Calibration>> {
        let Some(name) = &self.baseline else { return Ok(None) };
        let last =
            all.iter().filter(|(_, stored)| stored.calibration.estimate == *name).max_by_key(|(entry, _)| *entry);
        match last {
            Some((_, stored)) => Ok(Some(&stored.calibration)),
            None => Err(Error::usage(format!("the history has no `{name}` of this machine"))),
        }
    }

    fn rule(&self, text: &str, series: &[abbe_trend::Series]) -> Result<(String, AgainRule)> {
        let wrong = || Error::usage(format!("`{text}` is no limit: one as `EXX[b]=4.5um` was expected"));
        let (name, limit) = text.rsplit_once('=').ok_or_else(wrong)?;
        let digits = limit.find(|letter: char| !(letter.is_ascii_digit() || letter == '.')).ok_or_else(wrong)?;
        let (number, unit) = limit.split_at(digits);
        let series = series.iter().find(|series| series.name == name);
        let series = series.ok_or_else(|| Error::usage(format!("`{name}` is not among what the tests estimate")))?;
        let factor = unit_factor(unit.trim(), &series.unit)
            .ok_or_else(|| Error::usage(format!("`{}` is no unit of `{name}`", unit.trim())))?;
        let limit: f64 = number.parse().map_err(|_| wrong())?;
        let rule = AgainRule { limit: limit * factor, risk: self.risk, tests: 12, forecast: self.forecast.into() };
        Ok((name.to_owned(), rule))
    }
}

fn risk(text: &str) -> std::result::Result<f64, String> {
    let risk = text.parse::<f64>().ok().filter(|risk| *risk > 0.0 && *risk < 0.5);
    risk.ok_or_else(|| "a probability above 0 and below 0.5 was expected".to_owned())
}

impl From<ForecastAsked> for Forecast {
    fn from(asked: ForecastAsked) -> Self {
        match asked {
            ForecastAsked::Line => Self::Line,
            ForecastAsked::CorrelatedLine => Self::CorrelatedLine,
            ForecastAsked::RandomWalk => Self::RandomWalk,
        }
    }
}

/// Adds the series of the volumetric error over the ranges of the machine.
fn volumetric(
    known: &mut abbe_trend::History,
    points: usize,
    tested: &[Tested<'_>],
    baseline: Option<&Calibration>,
    registry: &Registry,
) -> Result<()> {
    let Some(first) = tested.first() else { return Ok(()) };
    let model = model_of(first.calibration, registry)?;
    let grid = Grid { points: Some(Points::Every(points)), both_directions: true, ..Grid::default() };
    grid.check().map_err(|wrong| Error::usage(format!("--volumetric: {}", wrong.message)))?;
    let statuses = grid.statuses(model.as_ref())?;
    add_volumetric(known, model.as_ref(), tested, baseline, &statuses)
}

/// The name of the estimate without its group.
pub fn estimate_of(stored: &Stored) -> &str {
    let name = stored.calibration.estimate.as_str();
    if stored.calibration.group.is_some() { name.split('.').next().unwrap_or(name) } else { name }
}

/// Refuses tests of machines that cannot be the same: their chains, or the plugins that describe them, differ.
/// Part of a standard uncertainty within which values are the same: no measurement repeats so.
const SAME: f64 = 1e-6;

/// Sentences on tests with the values of earlier ones: their rows are those of these, in whatever file they stand.
fn copies(tests: &[&Stored]) -> Vec<String> {
    let determined = |stored: &&Stored| {
        let all = stored.calibration.parameters.iter();
        all.filter(|own| own.standard_uncertainty > 0.0).cloned().collect::<Vec<Estimated>>()
    };
    let values: Vec<Vec<Estimated>> = tests.iter().map(determined).collect();
    let same = |one: &Estimated, other: &Estimated| {
        one.name == other.name && (one.value - other.value).abs() <= SAME * one.standard_uncertainty
    };
    let is_copy = |one: &[Estimated], other: &[Estimated]| {
        !one.is_empty() && one.len() == other.len() && one.iter().zip(other).all(|(one, other)| same(one, other))
    };
    let of_test = |place: usize| {
        let earlier = (0..place).find(|earlier| is_copy(&values[*earlier], &values[place]))?;
        let [one, other] = [earlier, place].map(|test| tests[test].label.as_str());
        Some(format!("{other} has the values of {one} to the last digit: are its rows those of {one}?"))
    };
    (0..tests.len()).filter_map(of_test).collect()
}

fn same_machine(tests: &[&Stored], estimate: &str) -> Result<()> {
    let chain = |stored: &Stored| {
        let model = &stored.calibration.model;
        (model.plugin.clone(), model.settings.get("chain").cloned())
    };
    let Some((first, other)) = tests
        .iter()
        .find_map(|other| Some((tests.first()?, other)).filter(|(first, other)| chain(first) != chain(other)))
    else {
        return Ok(());
    };
    let words = |stored: &Stored| {
        let (plugin, chain) = chain(stored);
        let chain = chain.as_ref().and_then(Value::as_str).map_or_else(|| plugin, |chain| format!("`{chain}`"));
        format!("{chain} in {} {}", stored.unit, stored.label)
    };
    let message = format!(
        "the tests of `{estimate}` under the name `{}` are of different machines: {}, {}",
        first.machine,
        words(first),
        words(other)
    );
    Err(Error::data(message).help("keep each machine under a name of its own: `abbe history add --machine NAME`"))
}
