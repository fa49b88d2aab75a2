//! What the exporters of temperature compensation share: offset and slope of a line along each axis, over temperature.

use std::fmt::Write as _;

use abbe_compensation::{LineSettings, ThermalLine, ThermalLines, ThermalState};
use abbe_core::{Calibration, CommandCorrection, Error, ExportedFile, KinematicModel, Quantity, Result, SettingsError};

use crate::tables::{Values, rounded};

/// How a control counts the values of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Units {
    /// Headers of the two columns.
    pub headers: [&'static str; 2],
    /// How many of a unit make one mm, and one mm/mm.
    pub factors: [f64; 2],
    /// Decimals of the numbers in the file.
    pub decimals: [i32; 2],
    /// Largest slope that the control takes, mm/mm.
    pub steepest: f64,
}

/// The values of one axis over the reading of one sensor that lags behind as its state does.
#[derive(Debug, Clone, PartialEq)]
struct Table {
    line: usize,
    state: usize,
    readings: Vec<f64>,
    /// Offset and slope as the file has them, at each reading.
    values: Vec<[f64; 2]>,
}

impl Table {
    /// Linear between readings, constant beyond them.
    fn at(&self, reading: f64) -> [f64; 2] {
        let (first, last) = (self.readings[0], self.readings[self.readings.len() - 1]);
        let reading = reading.clamp(first, last);
        let after = self.readings.partition_point(|point| *point <= reading).clamp(1, self.readings.len() - 1);
        let length = self.readings[after] - self.readings[after - 1];
        let part = if length > 0.0 { (reading - self.readings[after - 1]) / length } else { 0.0 };
        let [before, after] = [self.values[after - 1], self.values[after]];
        std::array::from_fn(|index| before[index] + part * (after[index] - before[index]))
    }
}

/// All tables of a calibration.
pub struct TemperatureTables {
    lines: ThermalLines,
    tables: Vec<Table>,
    units: Units,
    values: Values,
    commands: Vec<usize>,
    width: usize,
}

/// Most rows of a table.
const MOST: usize = 1000;

/// Refuses a number of rows that is no table.
pub fn check_points(points: usize) -> Result<(), SettingsError> {
    match (2..=MOST).contains(&points) {
        true => Ok(()),
        false => Err(SettingsError::new("points", format!("a whole number from 2 to {MOST} was expected"))),
    }
}

impl TemperatureTables {
    /// Makes tables of so many rows over the readings of the calibration.
    ///
    /// Fails as [`ThermalLines::new`] does, and for slopes that the control does not take.
    pub fn new(
        calibration: &Calibration,
        model: &dyn KinematicModel,
        (settings, points): (&LineSettings, usize),
        (units, values): (Units, Values),
    ) -> Result<Self> {
        let lines = ThermalLines::new(calibration, model, settings)?;
        let mut tables = Vec::new();
        for (index, line) in lines.lines.iter().enumerate() {
            for (number, state) in lines.states.iter().enumerate() {
                let table = table((index, line), (number, state), points, (units, values));
                if table.values.iter().any(|value| *value != [0.0; 2]) {
                    tables.push(table);
                }
            }
        }
        let info = model.info();
        let commands = info.axes.iter().map(|axis| axis.status).collect();
        let made = Self { lines, tables, units, values, commands, width: info.status.len() };
        made.check_slopes(model)?;
        Ok(made)
    }

    /// Refuses slopes that the control does not take: those of all states together.
    fn check_slopes(&self, model: &dyn KinematicModel) -> Result<()> {
        for (index, line) in self.lines.lines.iter().enumerate() {
            let own = self.tables.iter().filter(|table| table.line == index);
            let largest = |table: &Table| table.values.iter().map(|value| value[1].abs()).fold(0.0, f64::max);
            let steepest = own.map(largest).sum::<f64>() / self.units.factors[1];
            if steepest > self.units.steepest {
                let name = &model.info().axes[line.axis].name;
                let message = format!(
                    "the correction of {name} has a slope of up to {:.4} mm/m; the control takes {:.4} mm/m",
                    steepest * 1e3,
                    self.units.steepest * 1e3
                );
                return Err(Error::data(message));
            }
        }
        Ok(())
    }

    /// The reference position of a line, mm.
    pub fn lines(&self) -> &[ThermalLine] {
        &self.lines.lines
    }

    /// The table as a file: rows by axis, state and reading.
    pub fn csv(&self, name: &str, model: &dyn KinematicModel) -> ExportedFile {
        let [offset, slope] = self.units.headers;
        let mut text = format!("axis,input,time_constant_s,reading,{offset},{slope}\n");
        for table in &self.tables {
            let (axis, state) = (self.axis(table.line, model), &self.lines.states[table.state]);
            let time = state.time_constant.map(|time| format!("{time:.3}")).unwrap_or_default();
            for (reading, [offset, slope]) in table.readings.iter().zip(&table.values) {
                let _ = writeln!(text, "{axis},{},{time},{reading},{offset},{slope}", state.header);
            }
        }
        ExportedFile { name: name.to_owned(), content: text.into_bytes() }
    }

    /// Lines that say what the control has to compute, and what straight lines cannot correct.
    pub fn notes(&self, file: &str, model: &dyn KinematicModel) -> Result<String> {
        let [offset, slope] = self.units.headers;
        let mut text = self.values.warning();
        let _ = write!(
            text,
            "\nWhat the PLC computes from {file}, every dt seconds:\n\
             1. For each input without a time constant, lagged = reading. For each input and time constant T, lagged follows\n   \
             the reading: lagged = lagged + (reading - lagged) (1 - exp(-dt / T)), with dt below T / 100. After a long\n   \
             rest it begins with lagged = reading.\n\
             2. For each axis, {offset} and {slope} are the sums of their rows at these lagged readings: linear between\n   \
             rows, constant beyond them.\n\n"
        );
        for (state, most) in self.lines.states.iter().zip(&self.lines.largest) {
            let lag = state.time_constant.map_or("at once".to_owned(), |time| format!("T = {time:.1} s"));
            let _ = writeln!(
                text,
                "{}, {lag}: counted from {:.3}; read from {:.3} to {:.3} in the calibration, largest state {most:.3}.",
                state.header, state.reference, state.range[0], state.range[1]
            );
        }
        text.push('\n');
        for (index, line) in self.lines.lines.iter().enumerate() {
            let _ = writeln!(
                text,
                "{}: at most {:.2} um from a straight line along the axis, {:.2} um anywhere in the workspace, which only\n   \
                 volumetric corrections see; changes by at most {:.4} um/s.",
                self.axis(index, model),
                line.bent * 1e3,
                line.elsewhere * 1e3,
                self.lines.fastest(line)? * 1e3
            );
        }
        Ok(text)
    }

    fn axis<'a>(&self, line: usize, model: &'a dyn KinematicModel) -> &'a str {
        &model.info().axes[self.lines.lines[line].axis].name
    }

    /// What the control adds to the command of an axis, mm.
    fn correction(&self, index: usize, states: &[f64], position: f64) -> f64 {
        let mut sum = [0.0; 2];
        for table in self.tables.iter().filter(|table| table.line == index) {
            let found = table.at(states[table.state] + self.lines.states[table.state].reference);
            sum.iter_mut().zip(found).for_each(|(sum, found)| *sum += found);
        }
        let [offset, slope] = std::array::from_fn(|part| sum[part] / self.units.factors[part]);
        self.values.sign() * (offset + slope * (position - self.lines.lines[index].reference))
    }
}

/// The table of an axis and a state.
fn table(
    (line, of_line): (usize, &ThermalLine),
    (state, of_state): (usize, &ThermalState),
    points: usize,
    (units, values): (Units, Values),
) -> Table {
    let from = of_state.range[0].min(of_state.reference);
    let to = of_state.range[1].max(of_state.reference);
    let is_temperature = Quantity::of_column(&of_state.header).1 == Quantity::Temperature;
    let decimals = if is_temperature { 3 } else { 6 };
    let reading = |row: usize| rounded(from + (to - from) * row as f64 / (points - 1) as f64, decimals);
    let readings: Vec<f64> = (0..points).map(reading).collect();
    let gains = of_line.parts[state];
    let value = |reading: &f64| {
        let elevation = values.sign() * (reading - of_state.reference);
        std::array::from_fn(|part| rounded(gains[part] * elevation * units.factors[part], units.decimals[part]))
    };
    Table { line, state, values: readings.iter().map(value).collect(), readings }
}

impl CommandCorrection for TemperatureTables {
    fn commands(&self, programmed: &[f64]) -> Result<Vec<f64>> {
        if !programmed.len().is_multiple_of(self.width) {
            let (values, width) = (programmed.len(), self.width);
            return Err(Error::usage(format!("{values} numbers are no statuses of {width} values each")));
        }
        let mut found = programmed.to_vec();
        for (status, programmed) in found.chunks_mut(self.width).zip(programmed.chunks(self.width)) {
            let states = self.lines.states_at(programmed)?;
            for (index, line) in self.lines.lines.iter().enumerate() {
                let column = self.commands[line.axis];
                status[column] += self.correction(index, &states, programmed[column]);
            }
        }
        Ok(found)
    }
}
