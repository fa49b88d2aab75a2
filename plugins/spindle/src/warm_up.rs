//! Estimator plugin `spindle-warm-up`: drift of a spindle while it warms up, and how it follows temperatures.

use abbe_core::{
    Calibration, ColumnHeader, Context, DataRow, Dataset, Error, Estimate, EstimateSource, Identifiability, PathItem,
    Problem, Quantity, Result, SettingsError, positive,
};
use abbe_standards::thermal_drift::{range, slope_at_end, time_to_part};
use abbe_thermal::{
    Fitted, Hold, Output, Reference, SensorLog, Structure, exchanged, is_dead, not_copied, quieter, stuck,
};
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::motion::{check_plausible, readings_alone};
use crate::parameters::{Combined, Found, Sizes};
use crate::readings::check_column;

/// The name of the plugin.
pub const PLUGIN: &str = "spindle-warm-up";

abbe_core::register!(
    Estimate,
    "spindle-warm-up",
    "drift of a spindle that warms up: end, range, slope, time to 95 %, gains on temperatures",
    WarmUp,
    example,
    build,
    "../reference/estimate-spindle-warm-up.md",
    EstimateSource::Readings,
);

/// Settings of a warm-up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WarmUp {
    /// Columns of displacements, without their units.
    pub drift: Vec<String>,
    /// Columns of temperatures that the drift follows at once, without their units.
    #[serde(default)]
    pub temperatures: Vec<String>,
    /// The column of the time, without its unit.
    #[serde(default = "time")]
    pub time: String,
    /// The slope is that of the last minutes.
    #[serde(default = "window")]
    pub slope_over_min: f64,
    /// Smallest and largest plausible range of the column that drifts most: they find readings in another unit.
    #[serde(default = "plausible")]
    pub plausible_um: [f64; 2],
}

fn time() -> String {
    "time".to_owned()
}

fn window() -> f64 {
    5.0
}

fn plausible() -> [f64; 2] {
    [0.5, 1000.0]
}

/// Part of the smallest plausible range below which any single column is told.
const STILL: f64 = 0.2;

/// Longest warm-up, s: a week.
const LONGEST: f64 = 7.0 * 86_400.0;

/// Part of the way from the first reading to the last one that the time is told of.
const PART: f64 = 0.95;

fn example() -> Value {
    json!({ "drift": ["drift_x", "drift_y", "drift_z"], "temperatures": ["T02", "T03"], "slope_over_min": 5 })
}

fn build(settings: WarmUp, _: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    if settings.drift.is_empty() {
        return Err(SettingsError::new("drift", "at least one column was expected"));
    }
    for (key, names) in [("drift", &settings.drift), ("temperatures", &settings.temperatures)] {
        if let Some(twice) = names.iter().enumerate().find(|(place, name)| names[..*place].contains(name)) {
            return Err(SettingsError::new(key, format!("`{}` is there twice", twice.1)));
        }
    }
    positive("slope_over_min", settings.slope_over_min)?;
    check_plausible(settings.plausible_um)?;
    Ok(Box::new(settings))
}

impl WarmUp {
    fn one<'a>(&self, data: &[&'a Dataset]) -> Result<&'a Dataset> {
        match data {
            [one] => Ok(one),
            _ => {
                Err(Error::usage(format!("{} data sets were found; one warm-up was expected", data.len()))
                    .setting("from"))
            }
        }
    }

    /// Refuses times that are no warm-up: the slope is that of its end.
    fn check_times(&self, data: &Dataset, times: &[f64]) -> Result<()> {
        if let Some(row) = (1..times.len()).find(|row| times[*row] <= times[row - 1]) {
            return Err(data
                .error_at(DataRow(row), "the time does not go on")
                .help("did the clock jump, or are rows there twice?"));
        }
        let (last, window) = (times.len() - 1, 60.0 * self.slope_over_min);
        let lasts = times[last] - times[0];
        if lasts > window && lasts <= LONGEST {
            return Ok(());
        }
        let message = format!(
            "the warm-up ends after {:.4} minutes; more than the {} minutes of `slope_over_min`, and a week at most, were \
             expected",
            lasts / 60.0,
            self.slope_over_min
        );
        Err(data.error_at(DataRow(last), message).help("is the time in the unit that its column says?"))
    }

    /// Refuses displacements that are too small or too large for a spindle that warms up.
    fn check_ranges(&self, data: &Dataset, times: &[f64]) -> Result<()> {
        let range = |name: &String| {
            let range = range(times, data.required_numbers(name)?, times[0], times[times.len() - 1]);
            Ok(1e3 * range.unwrap_or_default())
        };
        let ranges = self.drift.iter().map(range).collect::<Result<Vec<f64>>>()?;
        let largest =
            (0..ranges.len()).max_by(|one, other| ranges[*one].total_cmp(&ranges[*other])).unwrap_or_default();
        let [least, most] = self.plausible_um;
        for (name, range) in
            self.drift.iter().zip(&ranges).filter(|(_, range)| **range > 0.0 && **range < STILL * least)
        {
            tracing::warn!("{name} drifts by {range:.4} um in all: is it in the unit that its column says?");
        }
        // A sensor that is dead is told by its own message.
        if ranges[largest] == 0.0 || (least..=most).contains(&ranges[largest]) {
            return Ok(());
        }
        let message = format!(
            "{} drifts most, by {:.4} um, and {least} um to {most} um are plausible",
            self.drift[largest], ranges[largest]
        );
        let error = Error::data(message).help("is it in the unit that its column says? else widen `plausible_um`");
        Err(match data.files.first() {
            Some(file) => error.in_file(file),
            None => error,
        })
    }

    /// Temperatures counted from their means: the noise of no single row is in all differences.
    fn log(names: &[String], data: &Dataset, times: &[f64]) -> Result<SensorLog> {
        let sensor = |name: &String| Ok((name.clone(), data.required_numbers(name)?.to_vec()));
        let sensors = names.iter().map(sensor).collect::<Result<_>>()?;
        SensorLog::new(times.to_vec(), sensors, Hold::FirstOrder, None)?
            .elevations(Reference::MeanUntil(times[times.len() - 1]))
    }

    /// Figures of a drift, which have no uncertainty of their own.
    fn figures(&self, found: &mut Found, data: &Dataset, times: &[f64], name: &str) -> Result<()> {
        let readings = data.required_numbers(name)?;
        let last = readings.len() - 1;
        if is_dead(readings) {
            let message = format!("{name} reads {} um in all rows", readings[0] * 1e3);
            return Err(data.error_at(DataRow(0), message).help("is the sensor connected, and within its range?"));
        }
        stuck(name, readings, 1).iter().for_each(|doubt| tracing::warn!("{doubt}"));
        let told = [
            ("end", Some(readings[last]), "mm"),
            ("range", range(times, readings, times[0], times[last]), "mm"),
            ("slope", slope_at_end(times, readings, 60.0 * self.slope_over_min), "mm/s"),
            ("time_to_95", time_to_part(times, readings, PART), "s"),
        ];
        for (what, value, unit) in told {
            if let Some(value) = value {
                found.fixed(format!("{name}.{what}"), value, unit);
            }
        }
        Ok(())
    }

    /// Tells of temperatures that explain what drifts most far better with their rows in the reverse order, or with another sensor of the
    /// file in the place of one.
    fn tell_better(
        &self,
        log: &SensorLog,
        data: &Dataset,
        outputs: &[Output],
        structure: &Structure,
        fitted: &Fitted,
    ) -> Result<()> {
        let most = |output: &Output| output.runs[0].values.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        let largest = (0..outputs.len()).max_by(|one, other| most(&outputs[*one]).total_cmp(&most(&outputs[*other])));
        let Some(largest) = largest else { return Ok(()) };
        let scatter = |fitted: &Fitted| 1e3 * fitted.scatter[largest];
        let (name, sensors, as_read) = (&self.drift[largest], self.temperatures.join(", "), scatter(fitted));
        let turned = scatter(&abbe_thermal::fit(&[log.turned()], outputs, structure)?);
        if turned < BETTER * as_read {
            tracing::warn!(
                "{name} follows {sensors} far better with the temperatures in the reverse order of their rows (scatter {turned:.3} um, and \
                 {as_read:.3} um as they are): are the rows of one of them sorted the other way round?"
            );
        }
        let mut best: Option<(f64, [String; 2])> = None;
        for (place, sensor) in self.temperatures.iter().enumerate() {
            for other in self.others(data) {
                let mut names = self.temperatures.clone();
                names[place].clone_from(&other);
                // What cannot be fitted explains nothing.
                let with =
                    Self::log(&names, data, log.times()).and_then(|log| abbe_thermal::fit(&[log], outputs, structure));
                let Ok(with) = with.map(|with| scatter(&with)) else { continue };
                if with < BETTER * as_read && best.as_ref().is_none_or(|(least, _)| with < *least) {
                    best = Some((with, [sensor.clone(), other]));
                }
            }
        }
        if let Some((with, [sensor, other])) = best {
            tracing::warn!(
                "{name} follows {sensors} far better with {other} in the place of {sensor} (scatter {with:.3} um, and {as_read:.3} um as it \
                 is): are these columns exchanged?"
            );
        }
        Ok(())
    }

    /// The temperatures of a file that the drift is not said to follow, as far as they move.
    fn others(&self, data: &Dataset) -> Vec<String> {
        let columns = data.columns.iter().map(|column| &column.header);
        let temperatures = columns.filter(|header| header.quantity == Quantity::Temperature);
        let names = temperatures.map(|header| &header.name).filter(|name| !self.temperatures.contains(name));
        names.filter(|name| data.numbers(name).is_some_and(|readings| !is_dead(readings))).cloned().collect()
    }

    /// Gains of a drift on temperatures, with the covariance that its residuals tell.
    fn gains(&self, found: &mut Found, fitted: &Fitted, log: &SensorLog, output: usize, inverse: &DMatrix<f64>) {
        let name = &self.drift[output];
        let combined: Vec<Combined> = (self.temperatures.iter().enumerate())
            .map(|(place, sensor)| Combined {
                name: format!("{name}[{sensor}]"),
                unit: "mm/K",
                terms: vec![(place, 1.0)],
            })
            .collect();
        // The mean is one more unknown.
        let (rows, unknowns) = (log.times().len() as f64, self.temperatures.len() as f64);
        let freedom = (rows - unknowns - 1.0).max(1.0);
        let covariance = inverse * (fitted.scatter[output].powi(2) * (rows - unknowns) / freedom);
        found.add(&combined, &fitted.gains[output], &covariance, freedom);
    }
}

/// Part of the scatter below which other temperatures are far better.
const BETTER: f64 = 0.5;

/// How many times a usual step is a jump, and the part of the range that it has to be.
const JUMP: f64 = 10.0;
const PART_OF_RANGE: f64 = 0.1;

/// Steps between readings, and a large one among them: nine of ten are smaller.
fn steps(readings: &[f64]) -> (Vec<f64>, f64) {
    let steps: Vec<f64> = readings.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mut sizes: Vec<f64> = steps.iter().map(|step| step.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let usual = sizes.get(sizes.len() * 9 / 10).copied().unwrap_or_default();
    (steps, usual)
}

/// Tells of a reading that is far from the one before: a jump, a spike or the end of a cable.
fn tell_jump(data: &Dataset, name: &str, readings: &[f64], times: &[f64]) {
    let (between, usual_time) = steps(times);
    let (mut steps, usual) = steps(readings);
    // Where readings are missing they may have gone on.
    steps.iter_mut().zip(between).filter(|(_, time)| *time > JUMP * usual_time).for_each(|(step, _)| *step = 0.0);
    let range = readings.iter().fold(f64::MIN, |most, value| most.max(*value))
        - readings.iter().fold(f64::MAX, |least, value| least.min(*value));
    let place = (0..steps.len()).max_by(|one, other| steps[*one].abs().total_cmp(&steps[*other].abs()));
    if let Some(place) = place.filter(|place| steps[*place].abs() > (JUMP * usual).max(PART_OF_RANGE * range)) {
        let origin = data.origins[DataRow(place + 1)];
        tracing::warn!(
            "{}:{}: {name} jumps here, by {:.0} % of all that it moves: was something touched, or is a cable loose?",
            data.files[origin.file].display(),
            origin.line,
            100.0 * steps[place].abs() / range
        );
    }
}

/// Scatter of a temperature, K, that is no noise, and the part of twice its variance that squares of its steps have on the average where
/// its rows are in no order (von Neumann 1941): of rows in their order they have far less.
const NO_NOISE: f64 = 1.0;
const IN_NO_ORDER: f64 = 0.5;
const FEWEST_ROWS: usize = 10;

/// The usual step of a temperature whose rows are in no order, K; none for others.
fn goes_up_and_down(readings: &[f64]) -> Option<f64> {
    let rows = readings.len() as f64;
    let mean = readings.iter().sum::<f64>() / rows;
    let variance = readings.iter().map(|reading| (reading - mean).powi(2)).sum::<f64>() / rows;
    let steps = readings.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum::<f64>() / (rows - 1.0);
    let is_told =
        readings.len() >= FEWEST_ROWS && variance > NO_NOISE * NO_NOISE && steps > IN_NO_ORDER * 2.0 * variance;
    is_told.then(|| steps.sqrt())
}

/// Tells of times without readings.
fn tell_gap(data: &Dataset, times: &[f64]) {
    let (steps, usual) = steps(times);
    if let Some(place) = steps.iter().position(|step| *step > JUMP * usual) {
        let origin = data.origins[DataRow(place + 1)];
        tracing::warn!(
            "{}:{}: {:.0} s without readings before this row, and {usual:.0} s are usual",
            data.files[origin.file].display(),
            origin.line,
            steps[place]
        );
    }
}

/// The inverse of the sums of squares and products of what sensors read, and the condition with columns of norm 1.
fn inverse_of(log: &SensorLog) -> Option<(DMatrix<f64>, f64)> {
    let (rows, columns) = (log.times().len(), log.names().len());
    let matrix = DMatrix::from_fn(rows, columns, |row, column| log.values(column)[row]);
    let norms: Vec<f64> = matrix.column_iter().map(|column| column.norm()).collect();
    let scaled = DMatrix::from_fn(rows, columns, |row, column| matrix[(row, column)] / norms[column]);
    let sizes = scaled.singular_values();
    let condition = sizes.max() / sizes.min();
    Some(((matrix.transpose() * &matrix).try_inverse()?, condition)).filter(|(_, condition)| condition.is_finite())
}

impl Estimate for WarmUp {
    fn check_readings(&self, headers: &[Vec<ColumnHeader>]) -> Result<()> {
        for (place, headers) in headers.iter().enumerate() {
            check_column(place, headers, &self.time, Quantity::Time).map_err(|error| error.setting("time"))?;
            let listed =
                [("drift", &self.drift, Quantity::Length), ("temperatures", &self.temperatures, Quantity::Temperature)];
            for (setting, names, quantity) in listed {
                for (index, name) in names.iter().enumerate() {
                    check_column(place, headers, name, quantity).map_err(|error| {
                        let setting = vec![PathItem::Key(setting.to_owned()), PathItem::Index(index)];
                        Error { setting, ..error }
                    })?;
                }
            }
        }
        Ok(())
    }

    fn estimates_readings_at_once(&self) -> bool {
        true
    }

    fn estimate_readings(&self, name: &str, data: &[&Dataset]) -> Result<Calibration> {
        let data = self.one(data)?;
        let times = data.required_numbers(&self.time)?;
        if times.len() < 3 {
            return Err(Error::data("three rows at least were expected of a warm-up").setting("from"));
        }
        self.check_times(data, times)?;
        self.check_ranges(data, times)?;
        not_copied(data, &self.drift)?;
        let mut found = Found::default();
        let (mut sizes, mut condition, mut unknowns) = (Sizes::default(), 1.0, 0);
        self.drift.iter().try_for_each(|name| self.figures(&mut found, data, times, name))?;
        for name in &self.temperatures {
            let readings = data.required_numbers(name)?;
            if is_dead(readings) {
                let message = format!("{name} reads {} °C in all rows: no drift follows it", readings[0]);
                return Err(data
                    .error_at(DataRow(0), message)
                    .help("is the sensor connected? else leave it out of `temperatures`"));
            }
            stuck(name, readings, 1).iter().for_each(|doubt| tracing::warn!("{doubt}"));
        }
        for name in self.drift.iter().chain(&self.temperatures) {
            tell_jump(data, name, data.required_numbers(name)?, times);
        }
        for name in &self.temperatures {
            let readings = data.required_numbers(name)?;
            if let Some(step) = goes_up_and_down(readings) {
                tracing::warn!(
                    "{name} goes up and down by {step:.1} K from row to row, as no temperature does: are its rows exchanged?"
                );
            }
        }
        tell_gap(data, times);
        let drifts = self.drift.iter().map(|name| Ok((name.as_str(), data.required_numbers(name)?)));
        let doubts = exchanged(data).into_iter().chain(quieter(&drifts.collect::<Result<Vec<_>>>()?));
        doubts.for_each(|doubt| tracing::warn!("{doubt}"));
        if !self.temperatures.is_empty() {
            let log = Self::log(&self.temperatures, data, times)?;
            let outputs = self.drift.iter().map(|name| {
                let readings = data.required_numbers(name)?;
                let mean = readings.iter().sum::<f64>() / readings.len() as f64;
                let values: Vec<f64> = readings.iter().map(|reading| reading - mean).collect();
                Ok(Output::of_run(name, times.to_vec(), values))
            });
            let outputs = outputs.collect::<Result<Vec<_>>>()?;
            let structure = Structure {
                inputs: Vec::new(),
                at_once: (0..self.temperatures.len()).collect(),
                time_constants: 0,
                starts_warm: false,
                guess: None,
            };
            let fitted = abbe_thermal::fit(std::slice::from_ref(&log), &outputs, &structure)?;
            self.tell_better(&log, data, &outputs, &structure, &fitted)?;
            let (inverse, worst) = inverse_of(&log)
                .ok_or_else(|| Error::data("the temperatures cannot be told apart").setting("temperatures"))?;
            for (output, readings) in outputs.iter().enumerate() {
                self.gains(&mut found, &fitted, &log, output, &inverse);
                let predicted = fitted.predict(&log, output, times)?;
                readings.runs[0]
                    .values
                    .iter()
                    .zip(predicted)
                    .for_each(|(value, predicted)| sizes.push(value - predicted));
                unknowns += self.temperatures.len();
            }
            condition = worst;
        }
        let report = sizes.report(unknowns, unknowns, condition);
        Ok(found.calibration(name, PLUGIN, json!(self), "residuals", report))
    }

    fn estimate(&self, _: &Problem) -> Result<Calibration> {
        Err(readings_alone())
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(readings_alone())
    }
}
