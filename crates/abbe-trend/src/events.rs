//! Changes of several parameters as one event, and the shared input that explains them.

use nalgebra::{DMatrix, DVector};

use crate::analysis::{Event, ParameterTrend, Series};
use crate::change::Change;
use crate::source::{Differences, Explained, SharedInput, explained_by};

/// What happened: jumps of several parameters at one time are one event, and so are drifts that one input explains.
pub(crate) fn events(
    series: &[Series],
    parameters: &[ParameterTrend],
    covariances: &[Option<DMatrix<f64>>],
    inputs: &[SharedInput],
) -> Vec<Event> {
    let mut changed: Vec<&ParameterTrend> =
        parameters.iter().filter(|parameter| parameter.change != Change::None).collect();
    changed.sort_by(|one, other| other.gain.total_cmp(&one.gain));
    let mut events = Vec::new();
    let lasting: Vec<&ParameterTrend> =
        changed.iter().copied().filter(|parameter| matches!(parameter.change, Change::Line { .. })).collect();
    let explained = explain(series, parameters, &lasting, covariances, inputs);
    let mut left: Vec<&ParameterTrend> = changed;
    if let Some(explained) = explained {
        left.retain(|parameter| !lasting.iter().any(|other| other.name == parameter.name));
        let names = lasting.iter().map(|parameter| parameter.name.clone()).collect();
        events.push(Event { parameters: names, change: lasting[0].change, explained: Some(explained) });
    }
    while let Some(first) = left.first().copied() {
        let (same, others): (Vec<&ParameterTrend>, Vec<&ParameterTrend>) =
            left.iter().partition(|other| other.name == first.name || together(&first.change, &other.change));
        let explained = match first.change {
            Change::Step { .. } => explain(series, parameters, &same, covariances, inputs),
            _ => None,
        };
        let names = same.iter().map(|parameter| parameter.name.clone()).collect();
        events.push(Event { parameters: names, change: first.change, explained });
        left = others;
    }
    events
}

/// Whether two jumps may be one.
fn together(one: &Change, other: &Change) -> bool {
    match (one, other) {
        (
            Change::Step { first: one, earliest, latest, .. },
            Change::Step { first: other, earliest: other_earliest, latest: other_latest, .. },
        ) => one.abs_diff(*other) <= 1 || (other_earliest <= latest && earliest <= other_latest),
        _ => false,
    }
}

/// Whether one shared input explains a change, of these parameters and of none that has not changed.
fn explain(
    series: &[Series],
    parameters: &[ParameterTrend],
    same: &[&ParameterTrend],
    covariances: &[Option<DMatrix<f64>>],
    inputs: &[SharedInput],
) -> Option<Explained> {
    let first = same.first()?;
    let index_of = |parameter: &ParameterTrend| {
        let index = series.iter().position(|series| series.name == parameter.name)?;
        (!series[index].derived && parameter.seasonal.is_none()).then_some(index)
    };
    let counts = |parameter: &&ParameterTrend| {
        parameter.change == Change::None || same.iter().any(|other| other.name == parameter.name)
    };
    let chosen: Vec<(usize, &ParameterTrend)> =
        parameters.iter().filter(counts).filter_map(|parameter| Some((index_of(parameter)?, parameter))).collect();
    let number = covariances.len();
    let (before, after): (Vec<usize>, Vec<usize>) = match first.change {
        Change::Step { first, .. } => (0..number).partition(|test| *test < first),
        _ => ((0..number / 3).collect(), (number - number / 3..number).collect()),
    };
    let (one, other) = (mean(&chosen, covariances, &before), mean(&chosen, covariances, &after)?);
    let from_target = || {
        let targets = chosen.iter().map(|(index, _)| series[*index].target.map(|target| target.value));
        let values = targets.collect::<Option<Vec<f64>>>()?;
        Some((DVector::from_vec(values), DMatrix::zeros(chosen.len(), chosen.len())))
    };
    let one = one.or_else(from_target)?;
    let differences = Differences {
        series: chosen.iter().map(|(index, _)| *index).collect(),
        values: other.0 - one.0,
        covariance: other.1 + one.1,
    };
    explained_by(&differences, inputs, 0.01)
}

/// The mean of some series over those tests that have all of them, with its covariance.
fn mean(
    chosen: &[(usize, &ParameterTrend)],
    covariances: &[Option<DMatrix<f64>>],
    tests: &[usize],
) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let size = chosen.len();
    let (mut sum, mut covariance, mut count) = (DVector::zeros(size), DMatrix::zeros(size, size), 0.0);
    for test in tests {
        let value = |parameter: &ParameterTrend| {
            parameter.tests.iter().position(|own| own == test).map(|place| parameter.values[place].value)
        };
        let values: Option<Vec<f64>> = chosen.iter().map(|(_, parameter)| value(parameter)).collect();
        let (Some(values), Some(of_test)) = (values, &covariances[*test]) else { continue };
        sum += DVector::from_vec(values);
        covariance += DMatrix::from_fn(size, size, |row, column| of_test[(chosen[row].0, chosen[column].0)]);
        count += 1.0;
    }
    (count > 0.0).then(|| (sum / count, covariance / (count * count)))
}
