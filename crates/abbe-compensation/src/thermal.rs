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
    log: Arc<SensorLog>,
    sensor: usize,
    history: Option<Arc<History>>,
}

impl ThermalState {
    /// Its value at a time of the calibration's own log, in the unit of the reading.
    ///
    /// Fails for a time outside the log.
    pub fn at(&self, time: f64) -> Result<f64> {
        match &self.history {
            Some(history) => history.at(&self.log, time).map(|[state, _]| state),
            None => self.log.at(self.sensor, time),
        }
    }

    /// The times of the log, s.
    pub fn times(&self) -> &[f64] {
        self.log.times()
    }

    /// The row of the log at which it is largest: time and value.
    pub(crate) fn largest(&self) -> Result<(f64, f64)> {
        let mut found = (f64::NAN, 0.0_f64);
        for time in self.log.times() {
            let value = self.at(*time)?;
            if value.abs() > found.1.abs() {
                found = (*time, value);
            }
        }
        Ok(found)
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
    time: usize,
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
        let values = machine_values(model, calibration);
        let mut cold = values.clone();
        let mut states: Vec<ThermalState> = Vec::new();
        for line in declarations(calibration) {
            let Declaration::Thermal(thermal) = line else { continue };
            if let Some(series) = &thermal.series {
                let error =
                    Error::data(format!("this calibration has a log for each {series}; a table takes a single one"));
                return Err(error.help("estimate the gains again, known from this calibration, with one log"));
            }
            let log = thermal.sensor_log().map_err(|error| Error::data(error.to_string()))?;
            let Some(log) = log.map(Arc::new) else { continue };
            for (index, parameter) in info.parameters.iter().enumerate() {
                let Some(term) = Term::of(&parameter.name, &thermal) else { continue };
                cold[index] = 0.0;
                if let (Term::State(input, shape), true) = (term, values[index] != 0.0) {
                    let state = found(&mut states, &thermal, &log, (input, shape), &|name| {
                        info.parameter(name).map(|place| values[place])
                    })?;
                    state.parameters.push(index);
                    state.gains.push(parameter.name.clone());
                }
            }
        }
        let time = info.status_index(&StatusRole::Time);
        let (Some(time), false) = (time, states.is_empty()) else {
            let error = Error::data("no error of this calibration follows a temperature");
            return Err(error.help("a line `thermal` of the machine, with gains that are estimated, was expected"));
        };
        let settings = Settings { largest_tip_correction_mm: largest_mm, ..Settings::default() };
        Ok(Self { model, cold, values, time, settings, states })
    }

    /// Corrections that one unit of a state asks for, as commands with them minus commands without; `statuses` are points x columns.
    /// Errors are small: they grow with the state, and those of several states add up.
    pub fn of(&self, state: usize, statuses: &[f64]) -> Result<Vec<f64>> {
        let state = &self.states[state];
        let (time, value) = state.largest()?;
        if value.abs() < SMALLEST {
            return Err(Error::data(format!("{} did not move while the machine was calibrated", state.input)));
        }
        let mut warm = self.cold.clone();
        state.parameters.iter().for_each(|&index| warm[index] = self.values[index]);
        let mut at_time = statuses.to_vec();
        at_time.chunks_mut(self.model.info().status.len()).for_each(|status| status[self.time] = time);
        let corrected = |values: &[f64]| {
            let compensator = Compensator::new(self.model, values, &self.settings)?.beyond_travel_too();
            compensator.correct(&at_time).map(|(corrected, _)| corrected)
        };
        let (warm, cold) = (corrected(&warm)?, corrected(&self.cold)?);
        Ok(warm.iter().zip(cold).map(|(warm, cold)| (warm - cold) / value).collect())
    }

    /// The column of the time in a status.
    pub fn time(&self) -> usize {
        self.time
    }
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
    log: &Arc<SensorLog>,
    (input, shape): (&str, Option<usize>),
    value_of: &dyn Fn(&str) -> Option<f64>,
) -> Result<&'s mut ThermalState> {
    let sensor = log.sensor(input)?;
    let time_constant = shape.map(|index| {
        let given = line.time_constants_s.get(index.wrapping_sub(1)).copied();
        value_of(&format!("time_constant[{index}]_s")).or(given).unwrap_or(f64::NAN)
    });
    if time_constant.is_some_and(|time| time.is_nan() || time <= 0.0) {
        return Err(Error::data(format!("the calibration does not know the time constant of {input}")));
    }
    let column = line.log.iter().find(|(header, _)| Quantity::of_column(header).0 == input);
    let Some((header, readings)) = column else {
        return Err(Error::data(format!("the log of the calibration has no column `{input}`")));
    };
    let reference = readings[0] - log.values(sensor)[0];
    let is_same = |state: &ThermalState| {
        let same_reference = (state.reference - reference).abs() < 1e-9;
        state.input == input && state.time_constant == time_constant && state.hold == log.hold() && same_reference
    };
    if let Some(place) = states.iter().position(is_same) {
        return Ok(&mut states[place]);
    }
    let history = time_constant.map(|time| match line.starts_at_rest {
        true => Arc::new(History::from_rest(log, sensor, time)),
        false => Arc::new(History::new(log, sensor, time)),
    });
    let ends = |least: [f64; 2], value: &f64| [least[0].min(*value), least[1].max(*value)];
    states.push(ThermalState {
        input: input.to_owned(),
        header: header.clone(),
        time_constant,
        hold: log.hold(),
        reference,
        range: readings.iter().fold([readings[0]; 2], ends),
        gains: Vec::new(),
        parameters: Vec::new(),
        log: log.clone(),
        sensor,
        history,
    });
    let last = states.len() - 1;
    Ok(&mut states[last])
}
