//! What the analysis of a history says: figures, sentences, tables.

use std::fmt::Write as _;

use abbe_core::{Error, Figure, Findings, Limit, Result, Unit};
use serde_json::json;

use crate::analysis::{Analysis, Event, ParameterTrend, Series, State};
use crate::calibrations::History;
use crate::change::{Change, Uncertain};

/// A unit in letters of ASCII, as figures have it.
pub(crate) fn ascii(symbol: &str) -> String {
    symbol.replace('µ', "u").replace('²', "2").replace('³', "3")
}

/// The unit that people read, in ASCII, and the factor to it.
fn people(unit: &str) -> (String, f64) {
    unit.parse::<Unit>().map_or_else(|_| (unit.to_owned(), 1.0), |unit| unit.for_people())
}

/// All findings about a history.
pub fn findings(of: &str, history: &History, analysis: &Analysis, changes: Limit) -> Result<Findings> {
    let mut findings = Findings::default();
    // The volumetric error is no parameter: it changes with them.
    let counts = |parameter: &&ParameterTrend| is_alarm(parameter.state) && !parameter.derived;
    let changed = analysis.parameters.iter().filter(counts).count();
    let rejected = analysis.tests.iter().filter(|test| !test.good).count();
    // Without a test that counts there is no number of changes, and no limit is kept.
    let changed = if analysis.is_judged() { changed as f64 } else { f64::NAN };
    findings.figures.extend([
        Figure::new(of, "changed parameters", changed, "1").limited(changes),
        Figure::new(of, "tests", analysis.tests.len() as f64, "1"),
        Figure::new(of, "rejected", rejected as f64, "1"),
        Figure::new(of, "missing", analysis.missing.len() as f64, "1"),
    ]);
    for parameter in &analysis.parameters {
        figures(of, parameter, analysis, &mut findings.figures);
    }
    findings.remarks = sentences(history, analysis);
    findings.tables.insert("charts.csv".to_owned(), charts(analysis));
    findings.tables.insert("tests.csv".to_owned(), tests(history, analysis));
    let text =
        serde_json::to_string_pretty(&json!({ "abbe_trend": 1, "analysis": analysis, "quality": history.quality }));
    let text = text.map_err(|error| Error::data(format!("the trend cannot be written: {error}")))?;
    findings.tables.insert("trend.json".to_owned(), text + "\n");
    Ok(findings)
}

fn is_alarm(state: State) -> bool {
    matches!(state, State::Changed | State::Alarm)
}

/// The figures of one parameter: what it does.
fn figures(of: &str, parameter: &ParameterTrend, analysis: &Analysis, figures: &mut Vec<Figure>) {
    let (unit, factor) = people(&parameter.unit);
    let unit = ascii(&unit);
    let mut figure = |what: &str, value: Uncertain, factor: f64, unit: &str| {
        let name = format!("{} {what}", parameter.name);
        let uncertainty = value.standard_uncertainty * factor;
        figures.push(Figure::new(of, name, value.value * factor, unit).uncertain(uncertainty));
    };
    let time = &analysis.time_unit;
    match parameter.change {
        Change::None => {}
        Change::Step { size, .. } => figure("step", size, factor, &unit),
        Change::Line { rate } => figure("drift", rate, factor, &format!("{unit}/{time}")),
        Change::Exponential { amplitude, time_constant } => {
            figure("settling", amplitude, factor, &unit);
            figure("settling time constant", time_constant, 1.0, time);
        }
        Change::Regressor { coefficient } => figure("follows undeclared", coefficient, factor, &unit),
    }
    if let Some(seasonal) = &parameter.seasonal {
        let unit = if unit.contains('/') {
            format!("({unit})/{}", seasonal.unit)
        } else {
            format!("{unit}/{}", seasonal.unit)
        };
        figure(&format!("by {}", seasonal.regressor), seasonal.coefficient, factor, &unit);
    }
    if let Some(again) = &parameter.again {
        figures.push(Figure::new(
            of,
            format!("{} measure again after", parameter.name),
            again.after.map_or(f64::NAN, |after| after as f64),
            time,
        ));
    }
}

/// The factor from a unit as people write it to that of a parameter; none if it is a unit of something else.
pub fn unit_factor(written: &str, unit: &str) -> Option<f64> {
    if written == unit {
        return Some(1.0);
    }
    let (people, factor) = unit.parse::<Unit>().ok()?.for_people();
    (written == people || written == ascii(&people)).then(|| 1.0 / factor)
}

/// First tests whose mean is held against a baseline.
const FIRST: usize = 5;

/// Standard uncertainties that this mean is off, and times the range of all tests, where it is told.
const FAR: f64 = 10.0;
const BEYOND: f64 = 5.0;

/// A parameter that follows something, and is so far off its baseline from the first tests on that what it follows does not explain it. It is
/// compared with its own line, and not with the baseline.
fn beside_baseline(series: &Series) -> Option<String> {
    let (target, regressor) = series.target.zip(series.regressor.as_ref().filter(|regressor| regressor.declared))?;
    let values: Vec<&Uncertain> = series.values.iter().flatten().collect();
    let first = &values[..values.len().min(FIRST)];
    if first.is_empty() {
        return None;
    }
    let mean = first.iter().map(|value| value.value).sum::<f64>() / first.len() as f64;
    let (low, high) =
        values.iter().fold((f64::MAX, f64::MIN), |(low, high), own| (low.min(own.value), high.max(own.value)));
    let u = first.iter().fold(target.standard_uncertainty, |most, own| most.max(own.standard_uncertainty));
    let off = mean - target.value;
    let (unit, factor) = people(&series.unit);
    (off.abs() > (FAR * u).max(BEYOND * (high - low))).then(|| {
        format!(
            "{} is {:+.3} {unit} off its baseline in the first tests, and all tests together have a range of {:.3} {unit}: what follows {} does \
             not explain it. Are the readings of one of the two in another unit, or was the machine changed?",
            series.name,
            off * factor,
            (high - low) * factor,
            regressor.name
        )
    })
}

/// What happened, in words.
pub fn sentences(history: &History, analysis: &Analysis) -> Vec<String> {
    let unit = &analysis.time_unit;
    let mut told = Vec::new();
    for quality in history.quality.iter().filter(|quality| !quality.good) {
        told.push(format!(
            "{unit} {} is rejected as a whole: chi-squared {:.0} with {} degrees of freedom ({}); something moved, or was \
             mounted wrongly",
            quality.label,
            quality.chi_squared,
            quality.degrees_of_freedom,
            probability(quality.probability)
        ));
    }
    told.extend(of_rejected(analysis));
    if !analysis.missing.is_empty() {
        told.push(format!("{unit} {} has no test", analysis.missing.join(", ")));
    }
    told.extend(analysis.events.iter().map(|event| event_in_words(event, analysis)));
    told.extend(history.series.iter().filter_map(beside_baseline));
    for parameter in &analysis.parameters {
        let label = |place: &usize| analysis.tests[parameter.tests[*place]].label.as_str();
        let alone = parameter.charts.unconfirmed();
        let labels: Vec<&str> = alone.iter().map(label).collect();
        let confirmed: Vec<&str> = parameter.charts.confirmed().iter().map(label).collect();
        match parameter.state {
            State::Unconfirmed if !confirmed.is_empty() => told.push(format!(
                "{} has an alarm in {unit} {}, and all its tests together scatter as chance makes: no change is told",
                parameter.name,
                confirmed.join(", ")
            )),
            State::Unconfirmed => told.push(format!(
                "{} has an unconfirmed alarm in {unit} {}: no other chart and no later test says so",
                parameter.name,
                labels.join(", ")
            )),
            State::Alarm => {
                let first = confirmed.first().or(labels.first()).copied().unwrap_or_default();
                told.push(format!(
                    "{} is in alarm from {unit} {first} on, but no step, line or settling explains it",
                    parameter.name
                ));
            }
            State::Changed if parameter.left < 1e-4 && !parameter.derived => told.push(format!(
                "{} does more than one change explains (p = {:.1e} of what is left)",
                parameter.name, parameter.left
            )),
            _ => {}
        }
        if let Some(seasonal) = parameter.seasonal.as_ref().filter(|_| parameter.state != State::Unconfirmed) {
            let (people_unit, factor) = people(&parameter.unit);
            told.push(format!(
                "{} follows {} by {} {people_unit} for each {}",
                parameter.name,
                seasonal.regressor,
                with_uncertainty(seasonal.coefficient, factor),
                seasonal.unit
            ));
        }
        if let Some(again) = &parameter.again {
            let (people_unit, factor) = people(&parameter.unit);
            let limit = rounded(again.rule.limit * factor);
            let last = analysis.tests.last().map_or("", |test| test.label.as_str());
            told.push(match (again.now, again.after) {
                (true, _) => format!(
                    "{} may exceed {limit} {people_unit} now with more than {} %: measure again at once",
                    parameter.name,
                    100.0 * again.rule.risk
                ),
                (_, Some(after)) => format!(
                    "{} keeps {limit} {people_unit} with a risk of {} % for {after} {unit}{plural} after {unit} {last}: measure again then",
                    parameter.name,
                    100.0 * again.rule.risk,
                    plural = if after == 1 { "" } else { "s" }
                ),
                (_, None) => format!("{} keeps {limit} {people_unit} as far as can be told", parameter.name),
            });
        }
    }
    told
}

/// What so many rejected tests mean, or that of today.
fn of_rejected(analysis: &Analysis) -> Option<String> {
    let unit = &analysis.time_unit;
    let (all, rejected) = (analysis.tests.len(), analysis.tests.iter().filter(|test| !test.good).count());
    let last = analysis.tests.last()?;
    if !analysis.is_judged() {
        return Some(match rejected == all {
            true => format!(
                "no test counts, all {all} are rejected: nothing is known of the machine; are the standard uncertainties of the \
                 readings too small, or is the artefact not what the recipe says?"
            ),
            false => "no test has a charted parameter: nothing is known of the machine".to_owned(),
        });
    }
    if 2 * rejected > all {
        return Some(format!(
            "{rejected} of {all} tests are rejected, the charts are of the others: are the standard uncertainties of the readings too \
             small, or is the artefact not what the recipe says?"
        ));
    }
    (!last.good).then(|| {
        format!("the last test ({unit} {}) is rejected: how the machine is now is not known; measure again", last.label)
    })
}

/// A probability in words; far out the distribution has no digits.
fn probability(p: f64) -> String {
    if p < 1e-16 { "p below 1e-16".to_owned() } else { format!("p = {p:.1e}") }
}

/// A stated number, which a change of its unit may have given a tail of digits.
pub fn rounded(value: f64) -> f64 {
    format!("{value:.12e}").parse().unwrap_or(value)
}

fn event_in_words(event: &Event, analysis: &Analysis) -> String {
    let unit = &analysis.time_unit;
    let of = |name: &String| analysis.parameters.iter().find(|parameter| parameter.name == *name);
    let sizes: Vec<String> = event.parameters.iter().filter_map(of).map(size_in_words).collect();
    let mut text = match event.change {
        Change::Step { first, earliest, latest, .. } => {
            let label = |test: usize| analysis.tests[test].label.as_str();
            let when = match earliest == latest {
                true => format!("{unit} {}", label(first)),
                false => format!("{unit} {} ({} to {})", label(first), label(earliest), label(latest)),
            };
            format!("jump in {when}: {}", sizes.join(", "))
        }
        Change::Line { .. } => format!("drift, per {unit}: {}", sizes.join(", ")),
        Change::Exponential { time_constant, .. } => {
            format!("settling with {} {unit}s: {}", with_uncertainty(time_constant, 1.0), sizes.join(", "))
        }
        Change::Regressor { .. } => {
            format!("{} follows a temperature: declare it under `regressors`", event.parameters.join(", "))
        }
        Change::None => String::new(),
    };
    if let Some(explained) = &event.explained {
        let (people_unit, factor) = people(&explained.unit);
        let _ = write!(
            text,
            "; a change of `{}` by {} {people_unit} explains all of it (p = {:.2}): look at the artefact before the machine",
            explained.input,
            with_uncertainty(explained.change, factor),
            explained.probability
        );
    }
    text
}

fn size_in_words(parameter: &ParameterTrend) -> String {
    let (unit, factor) = people(&parameter.unit);
    let size = match parameter.change {
        Change::Step { size, .. } => size,
        Change::Line { rate } => rate,
        Change::Exponential { amplitude, .. } => amplitude,
        Change::Regressor { coefficient } => coefficient,
        Change::None => return parameter.name.clone(),
    };
    format!("{} {} {unit}", parameter.name, with_uncertainty(size, factor))
}

/// `+10.23 ± 0.14`: two digits of the standard uncertainty.
fn with_uncertainty(value: Uncertain, factor: f64) -> String {
    let (value, uncertainty) = (value.value * factor, value.standard_uncertainty * factor);
    let places = if uncertainty > 0.0 { (1.0 - uncertainty.log10().floor()).clamp(0.0, 12.0) as usize } else { 3 };
    format!("{value:+.places$} ± {uncertainty:.places$}")
}

/// A name as a cell: that of a parameter may have a comma.
fn quoted(name: &str) -> String {
    if name.contains([',', '"']) { format!("\"{}\"", name.replace('"', "\"\"")) } else { name.to_owned() }
}

/// The charts as a table, one line for each value.
fn charts(analysis: &Analysis) -> String {
    let mut text = String::from(
        "parameter,test,at,value,standard_uncertainty,expected,unit,normalised,moving_range,average,above,below,alarms\n",
    );
    for parameter in &analysis.parameters {
        let charts = &parameter.charts;
        for (place, &test) in parameter.tests.iter().enumerate() {
            let alarms = charts.alarms[place];
            let names = [
                ("individuals", alarms.individuals),
                ("moving-range", alarms.moving_range),
                ("average", alarms.average),
                ("sum", alarms.sum),
            ];
            let names: Vec<&str> = names.into_iter().filter(|(_, alarm)| *alarm).map(|(name, _)| name).collect();
            let range = charts.moving_range[place].map_or_else(String::new, |range| format!("{range:.6}"));
            let value = parameter.values[place];
            let _ = writeln!(
                text,
                "{},{},{},{:e},{:e},{:e},{},{:.6},{range},{:.6},{:.6},{:.6},{}",
                quoted(&parameter.name),
                analysis.tests[test].label,
                analysis.tests[test].at,
                value.value,
                value.standard_uncertainty,
                parameter.expected[place],
                parameter.unit,
                charts.normalised[place],
                charts.average[place],
                charts.above[place],
                charts.below[place],
                names.join(" ")
            );
        }
    }
    text
}

/// The tests as a table.
fn tests(history: &History, analysis: &Analysis) -> String {
    let mut text = String::from("test,at,equations,rank,condition,degrees_of_freedom,chi_squared,probability,good\n");
    for (quality, test) in history.quality.iter().zip(&analysis.tests) {
        let _ = writeln!(
            text,
            "{},{},{},{},{:.6},{},{:.6},{:.6e},{}",
            quality.label,
            test.at,
            quality.equations,
            quality.rank,
            quality.condition,
            quality.degrees_of_freedom,
            quality.chi_squared,
            quality.probability,
            u8::from(quality.good)
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::{Regressor, Target};

    /// Tests of a scale that follows a temperature from 15 to 25 degrees, with a baseline.
    fn series(baseline: f64, declared: bool) -> Series {
        let temperature = |test: usize| 20.0 + 5.0 * (test as f64 / 4.0).sin();
        let value = |test: usize| Uncertain {
            value: -50e-6 + 2.6e-6 * (temperature(test) - 20.0),
            standard_uncertainty: 2.6e-6,
        };
        Series {
            name: "EYY[1]".to_owned(),
            unit: "mm/mm".to_owned(),
            values: (0..40).map(|test| Some(value(test))).collect(),
            shared: 0.0,
            target: Some(Target { value: baseline, standard_uncertainty: 1e-6 }),
            regressor: Some(Regressor {
                name: "T01".to_owned(),
                unit: "K".to_owned(),
                reference: 20.0,
                values: (0..40).map(|test| Some(temperature(test))).collect(),
                declared,
            }),
            again: None,
            derived: false,
        }
    }

    #[test]
    fn a_scale_that_follows_a_temperature_and_is_far_off_its_baseline_is_told() {
        let told = beside_baseline(&series(450e-6, true)).expect("a sentence");
        assert!(
            told.starts_with("EYY[1] is -")
                && told.contains("off its baseline")
                && told.contains("what follows T01 does not explain it"),
            "{told}"
        );
        // What the temperature explains, and what is compared with its baseline anyway.
        for good in [series(-47e-6, true), series(-120e-6, true), series(20e-6, true), series(450e-6, false)] {
            assert_eq!(beside_baseline(&good), None);
        }
        assert_eq!(beside_baseline(&Series { target: None, ..series(450e-6, true) }), None);
        assert_eq!(beside_baseline(&Series { values: Vec::new(), ..series(450e-6, true) }), None);
    }
}
