//! Thermal states of a calibration, and the corrections that each of them asks for.

use std::sync::Arc;

use abbe_core::{Calibration, Error, KinematicModel, Quantity, Result, StatusRole, machine_values};
use abbe_errors::{Declaration, Thermal};
use abbe_thermal::{History, Hold, SensorLog};

use crate::temperatures::declarations;
use crate::{Compensator, Settings};

/// What a control has to know of a state.
#[derive(Debug, Clone, PartialEq)]
pub struct ThermalState {
    /// The sensor that drives it, without its unit.
    pub input: String,
    /// Its column with the unit: `T34_degC`.
    pub header: String,
    /// Time constant, s; none if the state is the reading itself.
    pub time_constant: Option<f64>,
    /// Whether readings stay until the next one, or run straight.
    pub hold: Hold,
    /// The reading that it counts from.
    pub reference: f64,
    /// Readings of the calibration: smallest and largest.
    pub range: [f64; 2],
    /// Names of the errors that follow it, as parameters.
    pub gains: Vec<String>,
    parameters: Vec<usize>,
    /// Column of a status with the time, and that with the label of the series if there are several logs.
    moment: Moment,
    logs: Vec<StateLog>,
}

/// Columns of a status that say where in the logs it is: time, and the label of the series if there are several logs.
type Moment = (usize, Option<usize>);

/// A state over a log of the calibration.
#[derive(Debug, Clone, PartialEq)]
struct StateLog {
    /// The index of the label of its series; none for a single log.
    label: Option<f64>,
    log: Arc<SensorLog>,
    sensor: usize,
    history: Option<Arc<History>>,
}

impl StateLog {
    fn at(&self, time: f64) -> Result<f64> {
        match &self.history {
            Some(history) => history.at(&self.log, time).map(|[state, _]| state),
            None => self.log.at(self.sensor, time),
        }
    }

    /// Times and values at the rows of the log.
    fn rows(&self) -> Result<Vec<(f64, f64)>> {
        self.log.times().iter().map(|time| Ok((*time, self.at(*time)?))).collect()
    }
}

impl ThermalState {
    /// Its value at a status on the clock of the calibration's own log, in the unit of the reading; zero where the time is not known.
    ///
    /// Fails for a time outside the log, and for a status of a series without one.
    pub fn at(&self, status: &[f64]) -> Result<f64> {
        let (time, label) = (status[self.moment.0], self.moment.1.map(|column| status[column]));
        if time.is_nan() {
            return Ok(0.0);
        }
        match self.logs.iter().find(|log| log.label == label) {
            Some(log) => log.at(time),
            None => Err(Error::data(format!("no log of {} belongs to the series of this row", self.input))),
        }
    }

    /// The largest value in its logs, with its sign, in the unit of the reading.
    pub(crate) fn largest(&self) -> Result<f64> {
        self.at_largest().map(|(_, _, value)| value)
    }

    /// The row of its logs at which it is largest: label, time and value.
    fn at_largest(&self) -> Result<(Option<f64>, f64, f64)> {
        let mut found = (None, f64::NAN, 0.0_f64);
        for log in &self.logs {
            for (time, value) in log.rows()? {
                if value.abs() > found.2.abs() {
                    found = (log.label, time, value);
                }
            }
        }
        Ok(found)
    }

    /// How fast it changes at most from row to row of its logs, in the unit of the reading per s.
    pub(crate) fn fastest(&self) -> Result<f64> {
        let mut fastest = 0.0_f64;
        for log in &self.logs {
            let rows = log.rows()?;
            let rates = rows.windows(2).map(|pair| ((pair[1].1 - pair[0].1) / (pair[1].0 - pair[0].0)).abs());
            fastest = rates.fold(fastest, f64::max);
        }
        Ok(fastest)
    }
}

/// A state below this, in the unit of its reading, tells no correction.
const SMALLEST: f64 = 1e-6;

/// A calibrated machine whose errors follow states.
pub struct ThermalResponses<'a> {
    model: &'a dyn KinematicModel,
    /// Values of the parameters without thermal errors.
    cold: Vec<f64>,
    values: Vec<f64>,
    settings: Settings,
    /// The states.
    pub states: Vec<ThermalState>,
}

impl<'a> ThermalResponses<'a> {
    /// Finds the states of a calibration. Corrections of the tip are believed up to `largest_mm`.
    ///
    /// Fails for a calibration whose errors follow no temperature.
    pub fn new(model: &'a dyn KinematicModel, calibration: &Calibration, largest_mm: f64) -> Result<Self> {
        let info = model.info();
        let none = || {
            let error = Error::data("no error of this calibration follows a temperature");
            error.help("a line `thermal` of the machine, with gains that are estimated, was expected")
        };
        let time = info.status_index(&StatusRole::Time).ok_or_else(none)?;
        let values = machine_values(model, calibration);
        let mut cold = values.clone();
        let mut states: Vec<ThermalState> = Vec::new();
        for line in declarations(calibration) {
            let Declaration::Thermal(thermal) = line else { continue };
            let counted = counted(&thermal, model, time)?;
            if counted.logs.is_empty() {
                continue;
            }
            for (index, parameter) in info.parameters.iter().enumerate() {
                let Some(term) = Term::of(&parameter.name, &thermal) else { continue };
                cold[index] = 0.0;
                if let (Term::State(input, shape), true) = (term, values[index] != 0.0) {
                    let state = found(&mut states, &thermal, &counted, (input, shape), &|name| {
                        info.parameter(name).map(|place| values[place])
                    })?;
                    state.parameters.push(index);
                    state.gains.push(parameter.name.clone());
                }
            }
        }
        if states.is_empty() {
            return Err(none());
        }
        let settings = Settings { largest_tip_correction_mm: largest_mm, ..Settings::default() };
        Ok(Self { model, cold, values, settings, states })
    }

    /// Corrections that one unit of a state asks for, as commands with them minus commands without; `statuses` are points x columns.
    /// Errors are small: they grow with the state, and those of several states add up.
    pub fn of(&self, state: usize, statuses: &[f64]) -> Result<Vec<f64>> {
        let state = &self.states[state];
        let (label, time, value) = state.at_largest()?;
        if value.abs() < SMALLEST {
            return Err(Error::data(format!("{} did not move while the machine was calibrated", state.input)));
        }
        let mut warm = self.cold.clone();
        state.parameters.iter().for_each(|&index| warm[index] = self.values[index]);
        let mut at_time = statuses.to_vec();
        for status in at_time.chunks_mut(self.model.info().status.len()) {
            status[state.moment.0] = time;
            state.moment.1.zip(label).into_iter().for_each(|(column, label)| status[column] = label);
        }
        let corrected = |values: &[f64]| {
            let compensator = Compensator::new(self.model, values, &self.settings)?.beyond_travel_too();
            compensator.correct(&at_time).map(|(corrected, _)| corrected)
        };
        let (warm, cold) = (corrected(&warm)?, corrected(&self.cold)?);
        Ok(warm.iter().zip(cold).map(|(warm, cold)| (warm - cold) / value).collect())
    }
}

/// The logs of a line of errors, counted from its reference.
struct Counted {
    moment: Moment,
    logs: Vec<(Option<f64>, Arc<SensorLog>)>,
}

/// Counts the logs of a line. A control has one clock and one reference: which logs a calibration had is nothing to it, if all of them
/// count from the same temperature.
///
/// Fails for logs that count each from their own reference.
fn counted(line: &Thermal, model: &dyn KinematicModel, time: usize) -> Result<Counted> {
    let info = model.info();
    let column = line.series.as_ref().and_then(|series| {
        (info.status.iter()).position(|status| status.role == StatusRole::Series && status.name == *series)
    });
    if let (Some(series), None, true) = (&line.series, line.reference_degC, line.references.is_empty()) {
        let message = format!(
            "each {series} of the calibration counts from a reference of its own, and a control from a single one"
        );
        return Err(Error::data(message).help("calibrate with `reference_degC`: gains then hold for any log"));
    }
    let logs = line.sensor_logs().map_err(|error| Error::data(error.to_string()))?;
    let place = |label: &str| column.and_then(|column| info.status[column].levels.iter().position(|own| own == label));
    let of = |(label, log): (Option<&str>, SensorLog)| (label.and_then(place).map(|place| place as f64), Arc::new(log));
    Ok(Counted { moment: (time, column), logs: logs.into_iter().map(of).collect() })
}

/// What the bracket of a thermal parameter says.
enum Term<'a> {
    /// An input, and which time constant; none if it is followed at once.
    State(&'a str, Option<usize>),
    /// What was there when the log began.
    Beginning,
}

impl<'a> Term<'a> {
    /// The term of a parameter of this line: `EXX[1*T34:2]`, `EYX[at0*T34:2]`, `dzt[T34]`, `dzt[start:1]`.
    fn of(name: &'a str, line: &Thermal) -> Option<Self> {
        let (symbol, bracket) = name.strip_suffix(']')?.split_once('[')?;
        let bracket = line.without_place(bracket)?;
        if !line.thermal.iter().any(|own| abbe_core::matches(own, symbol)) {
            return None;
        }
        match bracket.split_once(':') {
            Some(("start", _)) if line.starts_warm => Some(Self::Beginning),
            Some((input, index)) if line.inputs.iter().any(|own| own == input) => {
                Some(Self::State(input, Some(index.parse().ok()?)))
            }
            None if line.at_once.iter().any(|own| own == bracket) => Some(Self::State(bracket, None)),
            _ => None,
        }
    }
}

/// The state of an input and a time constant; lines that count it in the same way share it.
fn found<'s>(
    states: &'s mut Vec<ThermalState>,
    line: &Thermal,
    Counted { moment, logs }: &Counted,
    (input, shape): (&str, Option<usize>),
    value_of: &dyn Fn(&str) -> Option<f64>,
) -> Result<&'s mut ThermalState> {
    let time_constant = shape.map(|index| {
        let given = line.time_constants_s.get(index.wrapping_sub(1)).copied();
        value_of(&format!("time_constant[{index}]_s")).or(given).unwrap_or(f64::NAN)
    });
    if time_constant.is_some_and(|time| time.is_nan() || time <= 0.0) {
        return Err(Error::data(format!("the calibration does not know the time constant of {input}")));
    }
    let kept = || std::iter::once(&line.log).chain(line.logs.values()).flatten();
    let mut columns = kept().filter(|(header, _)| Quantity::of_column(header).0 == input).peekable();
    let (Some((header, first)), Some((_, log))) = (columns.peek().copied(), logs.first()) else {
        return Err(Error::data(format!("the log of the calibration has no column `{input}`")));
    };
    let (hold, reference) = (log.hold(), first[0] - log.values(log.sensor(input)?)[0]);
    let is_same = |state: &ThermalState| {
        let same_reference = (state.reference - reference).abs() < 1e-9;
        let same_clock = state.moment == *moment && state.hold == hold;
        state.input == input && state.time_constant == time_constant && same_clock && same_reference
    };
    if let Some(place) = states.iter().position(is_same) {
        return Ok(&mut states[place]);
    }
    let of_log = |(label, log): &(Option<f64>, Arc<SensorLog>)| -> Result<StateLog> {
        let sensor = log.sensor(input)?;
        let history = time_constant.map(|time| match line.starts_at_rest {
            true => Arc::new(History::from_rest(log, sensor, time)),
            false => Arc::new(History::new(log, sensor, time)),
        });
        Ok(StateLog { label: *label, log: log.clone(), sensor, history })
    };
    let ends = |least: [f64; 2], value: &f64| [least[0].min(*value), least[1].max(*value)];
    states.push(ThermalState {
        input: input.to_owned(),
        header: header.clone(),
        time_constant,
        hold,
        reference,
        range: columns.flat_map(|(_, readings)| readings).fold([first[0]; 2], ends),
        gains: Vec::new(),
        parameters: Vec::new(),
        moment: *moment,
        logs: logs.iter().map(of_log).collect::<Result<_>>()?,
    });
    let last = states.len() - 1;
    Ok(&mut states[last])
}
