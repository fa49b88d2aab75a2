//! What follows the temperatures of a log: states, readings, and what is left of the beginning, along an axis or everywhere.

use std::sync::{Arc, RwLock};

use abbe_core::{Quantity, Unit};
use abbe_thermal::History;

use super::{Argument, Functions, Term};
use crate::log::{SeriesLog, SeriesLogs};

/// How errors depend on the command of their axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Along {
    /// They do not.
    All,
    /// They grow with it.
    Slope,
    /// Each position has its own, and between two of them they run straight.
    Positions(Vec<f64>),
}

impl Along {
    /// The number of places with coefficients of their own.
    pub fn places(&self) -> usize {
        match self {
            Self::All | Self::Slope => 1,
            Self::Positions(positions) => positions.len(),
        }
    }

    /// What names of coefficients have in the bracket before the input.
    pub fn prefix(&self, place: usize) -> String {
        match self {
            Self::All => String::new(),
            Self::Slope => "1*".to_owned(),
            Self::Positions(_) => format!("at{place}*"),
        }
    }

    /// Places that count at a command, with their weights.
    fn weights(&self, command: f64) -> [(usize, f64); 2] {
        match self {
            Self::All => [(0, 1.0), (0, 0.0)],
            Self::Slope => [(0, command), (0, 0.0)],
            Self::Positions(positions) => {
                let place = interval(positions, command);
                let (from, to) = (positions[place], positions[place + 1]);
                let part = ((command - from) / (to - from)).clamp(0.0, 1.0);
                [(place, 1.0 - part), (place + 1, part)]
            }
        }
    }

    /// The derivatives of the weights to the command.
    fn slopes(&self, command: f64) -> [(usize, f64); 2] {
        match self {
            Self::All => [(0, 0.0); 2],
            Self::Slope => [(0, 1.0), (0, 0.0)],
            Self::Positions(positions) => {
                let place = interval(positions, command);
                let (from, to) = (positions[place], positions[place + 1]);
                // What is beyond the ends is taken as the end.
                let slope = if (positions[0]..=positions[positions.len() - 1]).contains(&command) {
                    1.0 / (to - from)
                } else {
                    0.0
                };
                [(place, -slope), (place + 1, slope)]
            }
        }
    }
}

/// The position before a command that has another one behind it.
fn interval(positions: &[f64], command: f64) -> usize {
    positions.partition_point(|position| *position <= command).clamp(1, positions.len() - 1) - 1
}

/// States by input and time constant, temperatures, and what states at the beginning add; all are zero where the time, or the log, is
/// not known.
#[derive(Debug)]
pub struct ThermalTerms {
    /// Names of the inputs, and units of their gains.
    pub(super) inputs: Vec<(String, Unit)>,
    pub(super) at_once: Vec<(String, Unit)>,
    /// Their places in the log.
    pub(super) sensors: [Vec<usize>; 2],
    /// Nominal time constants, s.
    pub(super) time_constants: Vec<f64>,
    pub(super) along: Along,
    /// Unit of states at the beginning, if they are unknown.
    pub(super) start: Option<Unit>,
    /// States begin with the first readings.
    pub(super) at_rest: bool,
    pub(super) logs: SeriesLogs,
    /// States over the log, of the time constants that were needed last.
    pub(super) histories: RwLock<Vec<Known>>,
}

/// Log, sensor, bits of the time constant, and the states.
pub(super) type Known = ((usize, usize, u64), Arc<History>);

/// States that are kept: those of a step of an iteration and of its derivatives by differences.
const KEPT: usize = 16;

impl ThermalTerms {
    /// The place of the first time constant among the arguments.
    fn first(&self) -> usize {
        self.command_place() + usize::from(self.along != Along::All)
    }

    /// The place of the command among the arguments, if the errors depend on it.
    fn command_place(&self) -> usize {
        1 + usize::from(self.logs.series.is_some())
    }

    /// The index of the label of the series of a pose.
    fn label_of(&self, arguments: &[f64]) -> Option<f64> {
        self.logs.series.as_ref().map(|_| arguments[1])
    }

    fn history(&self, series: usize, sensor: usize, time_constant: f64) -> Arc<History> {
        let (log, key) = (&self.logs.logs[series].log, (series, sensor, time_constant.to_bits()));
        let of = |known: &Vec<Known>| known.iter().find(|(own, _)| *own == key).map(|(_, history)| history.clone());
        if let Some(found) = self.histories.read().ok().and_then(|known| of(&known)) {
            return found;
        }
        let made = match self.at_rest {
            true => History::from_rest(log, sensor, time_constant),
            false => History::new(log, sensor, time_constant),
        };
        let made = Arc::new(made);
        if let Ok(mut known) = self.histories.write()
            && of(&known).is_none()
        {
            known.push((key, made.clone()));
            let more = known.len().saturating_sub(KEPT * (self.inputs.len() * self.logs.logs.len()).max(1));
            known.drain(..more);
        }
        made
    }

    /// Value and derivative to the logarithm of its time constant of every term at one place of the axis, as if its weight were 1.
    fn each(&self, arguments: &[f64], mut put: impl FnMut(usize, [f64; 2], Option<usize>)) {
        let Some(series) = self.logs.of(arguments[0], self.label_of(arguments)) else { return };
        let log = &self.logs.logs[series].log;
        let time_constants = &arguments[self.first()..];
        let mut term = 0;
        for &sensor in &self.sensors[0] {
            for (index, &time_constant) in time_constants.iter().enumerate() {
                // Iterations may try what is no time.
                if time_constant > 0.0
                    && let Ok(state) = self.history(series, sensor, time_constant).at(log, arguments[0])
                {
                    put(term, state, Some(index));
                }
                term += 1;
            }
        }
        for &sensor in &self.sensors[1] {
            if let Ok(value) = log.at(sensor, arguments[0]) {
                put(term, [value, 0.0], None);
            }
            term += 1;
        }
        if self.start.is_some() {
            for (index, &time_constant) in time_constants.iter().enumerate().filter(|(_, time)| **time > 0.0) {
                let a = (arguments[0] - log.times()[0]) / time_constant;
                put(term + series * time_constants.len() + index, [(-a).exp(), a * (-a).exp()], Some(index));
            }
        }
    }

    /// What names of beginnings have before them, one for each log: `day2.`.
    fn beginnings(&self) -> Vec<String> {
        let of = |own: &SeriesLog| match (&self.logs.series, &own.label) {
            (Some(series), Some(label)) => format!("{series}{label}."),
            _ => String::new(),
        };
        match self.logs.logs.is_empty() {
            true => vec![String::new()],
            false => self.logs.logs.iter().map(of).collect(),
        }
    }

    /// The number of terms at each place of the axis.
    fn count(&self) -> usize {
        let states = self.time_constants.len();
        self.inputs.len() * states
            + self.at_once.len()
            + if self.start.is_some() { states * self.logs.logs.len().max(1) } else { 0 }
    }

    /// The command of the axis; no number if the errors do not depend on it.
    fn command(&self, arguments: &[f64]) -> f64 {
        if self.along == Along::All { f64::NAN } else { arguments[self.command_place()] }
    }
}

impl Functions for ThermalTerms {
    fn arguments(&self) -> Vec<Argument> {
        let unit = Unit::of(Quantity::Time);
        let shapes = (self.time_constants.iter().enumerate())
            .map(|(index, time)| Argument::SharedShape(format!("time_constant[{}]_s", index + 1), *time, unit));
        let command = (self.along != Along::All).then_some(Argument::Command);
        let series = self.logs.series.clone().map(Argument::Series);
        std::iter::once(Argument::Time).chain(series).chain(command).chain(shapes).collect()
    }

    fn terms(&self) -> Vec<Term> {
        let mut terms = Vec::new();
        for place in 0..self.along.places() {
            let prefix = self.along.prefix(place);
            let term =
                |suffix: &str, unit: Unit| Term { unit: Some(unit), ..Term::new(format!("[{prefix}{suffix}]"), 0) };
            let states = 1..=self.time_constants.len();
            for (name, unit) in &self.inputs {
                terms.extend(states.clone().map(|index| term(&format!("{name}:{index}"), *unit)));
            }
            terms.extend(self.at_once.iter().map(|(name, unit)| term(name, *unit)));
            if let Some(unit) = self.start {
                for series in self.beginnings() {
                    terms.extend(states.clone().map(|index| term(&format!("{series}start:{index}"), unit)));
                }
            }
        }
        terms
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        let (weights, count) = (self.along.weights(self.command(arguments)), self.count());
        self.each(arguments, |term, [value, _], _| {
            weights.iter().for_each(|(place, weight)| out[place * count + term] += weight * value);
        });
    }

    fn slopes(&self, by: usize, arguments: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        let (command, count) = (self.command(arguments), self.count());
        if self.along != Along::All && by == self.command_place() {
            let slopes = self.along.slopes(command);
            return self.each(arguments, |term, [value, _], _| {
                slopes.iter().for_each(|(place, slope)| out[place * count + term] += slope * value);
            });
        }
        let Some(wanted) = by.checked_sub(self.first()) else { return };
        let weights = self.along.weights(command);
        self.each(arguments, |term, [_, slope], index| {
            if index == Some(wanted) {
                weights.iter().for_each(|(place, weight)| out[place * count + term] += weight * slope / arguments[by]);
            }
        });
    }

    fn range(&self) -> Option<[f64; 2]> {
        match &self.along {
            Along::Positions(positions) => Some([positions[0], positions[positions.len() - 1]]),
            _ => None,
        }
    }

    fn breaks(&self) -> &[f64] {
        match &self.along {
            Along::Positions(positions) => &positions[1..positions.len() - 1],
            _ => &[],
        }
    }

    fn refused(&self, arguments: &[f64]) -> Option<String> {
        if arguments[self.first()..].iter().any(|time| *time <= 0.0) {
            let message = "the iteration leads to a time constant of 0 s or less: these data tell fewer time constants, or need others to start from";
            return Some(message.to_owned());
        }
        self.logs.refused(arguments[0], self.label_of(arguments))
    }
}
