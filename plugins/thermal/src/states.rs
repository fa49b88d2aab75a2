//! Estimator plugin `thermal-states`: gains and time constants of readings that follow temperatures or speeds.

use abbe_core::{
    CALIBRATION_FORMAT, Calibration, ColumnHeader, Context, Dataset, Error, Estimate, EstimateSource, Estimated,
    FitReport, Identifiability, ModelRecord, NamedCovariance, PredictedStructure, Problem, Quantity, Result,
    SelectionByPrediction, SettingsError, Status, Unit,
};
use abbe_thermal::{
    Fitted, Output, PARTS, Readings, SensorLog, Structure, Tried, exchanged, fit, in_another_unit, select, stuck,
};
use serde_json::{Value, json};

use crate::settings::{Run, Settings, Uncertainty, gain_unit, quantity};
use crate::validate::run_name;

/// Name of the plugin, and of the model in its calibrations.
pub const NAME: &str = "thermal-states";

abbe_core::register!(
    Estimate,
    "thermal-states",
    "gains and time constants of readings that follow temperatures or speeds",
    Settings,
    example,
    build,
    "../reference/estimate-thermal-states.md",
    EstimateSource::Readings,
);

fn example() -> Value {
    json!({ "inputs": ["T34", "T52"], "outputs": ["T1?", "drift_*"], "time_constants": 2, "reference_until_s": 600 })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    settings.check()?;
    Ok(Box::new(ThermalStates { settings }))
}

struct ThermalStates {
    settings: Settings,
}

/// What is wrong with the unit of displacements of a run.
fn other_unit(run: &Run, data: &Dataset) -> Option<String> {
    let lengths = run.outputs.iter().filter(|(_, quantity, _)| *quantity == Quantity::Length);
    let lengths: Vec<(&str, &[f64])> =
        lengths.map(|(name, _, readings)| (name.as_str(), readings.values.as_slice())).collect();
    in_another_unit(&lengths, &temperatures(data))
}

/// All columns of temperatures of a run.
pub fn temperatures(data: &Dataset) -> Vec<&[f64]> {
    let columns = data.columns.iter().filter(|column| column.header.quantity == Quantity::Temperature);
    columns.filter_map(|column| data.numbers(&column.header.name)).collect()
}

/// Part by which a smaller structure may predict worse.
const WORSE: f64 = 0.02;

/// Seconds in a minute.
pub const MINUTE: f64 = 60.0;

/// Clocks of the same sampling differ by less than this part.
const ALIKE: f64 = 0.02;

impl Estimate for ThermalStates {
    fn check_readings(&self, headers: &[Vec<ColumnHeader>]) -> Result<()> {
        headers.iter().try_for_each(|headers| self.settings.chosen(headers).map(drop))
    }

    fn estimate_readings(&self, name: &str, data: &[&Dataset]) -> Result<Calibration> {
        let runs = data.iter().map(|data| self.settings.run(data)).collect::<Result<Vec<Run>>>()?;
        let outputs = outputs(&runs)?;
        let logs: Vec<SensorLog> = runs.iter().map(|run| run.log.clone()).collect();
        for (log, data) in logs.iter().zip(data) {
            let is_temperature = |sensor: &usize| quantity(data, &log.names()[*sensor]) == Quantity::Temperature;
            let faults = (0..log.names().len()).filter(is_temperature).flat_map(|sensor| log.faults(sensor));
            faults.for_each(|fault| tracing::warn!("{name}: {}: {fault}", run_name(data)));
        }
        for (run, data) in runs.iter().zip(data) {
            let doubts = exchanged(data).or_else(|| other_unit(run, data)).into_iter();
            let lengths = run.outputs.iter().filter(|(_, quantity, _)| *quantity == Quantity::Length);
            let doubts = doubts.chain(lengths.filter_map(|(output, _, readings)| stuck(output, &readings.values, 1)));
            doubts.for_each(|doubt| tracing::warn!("{name}: {}: {doubt}", run_name(data)));
        }
        if let Some([minutes, seconds]) = of_two_units(&logs) {
            let [minutes, seconds] = [minutes, seconds].map(|run| run_name(data[run]));
            tracing::warn!(
                "{name}: rows of {minutes} are 60 times as close as those of {seconds}: are its times in minutes, under `time_s`?"
            );
        }
        let (mut structure, mut selection) = (self.settings.structure(), None);
        if self.settings.select.is_some() {
            let (smallest, tried) = select(&logs, &outputs, &structure, WORSE)?;
            selection = selected(logs[0].names(), (&structure, &smallest), &tried, &left_out_runs(data, &structure));
            structure = smallest;
        }
        let fitted = fit(&logs, &outputs, &structure)?;
        let quantities: Vec<Quantity> = runs[0].outputs.iter().map(|(_, quantity, _)| *quantity).collect();
        let of_input = |sensor: usize| quantity(data[0], &logs[0].names()[sensor]);
        let found = Found { fitted: &fitted, logs: &logs, outputs: &outputs, quantities: &quantities };
        let values = found.values(of_input);
        let ordinary = found.named(&values, |row, column| fitted.covariance[(row, column)]);
        let (covariance, ordinary) = match self.settings.uncertainty {
            Uncertainty::Ordinary => (ordinary, None),
            Uncertainty::Blocks => {
                let how = self.settings.bootstrap(&logs, &fitted.time_constants)?;
                let drawn = fitted.bootstrap(&logs, &outputs, how)?;
                (found.named(&values, |row, column| drawn[(row, column)]), Some(ordinary))
            }
        };
        let rows = &covariance.rows;
        let parameters = values.iter().enumerate().map(|(place, (name, value, unit))| Estimated {
            name: name.clone(),
            value: *value,
            unit: unit.to_string(),
            standard_uncertainty: rows[place][place].max(0.0).sqrt(),
            status: Status::Estimated,
        });
        Ok(Calibration {
            abbe_calibration: CALIBRATION_FORMAT,
            estimate: name.to_owned(),
            model: ModelRecord { plugin: NAME.to_owned(), settings: self.resolved(&fitted, &logs, &outputs)? },
            parameters: parameters.collect(),
            artefacts: Vec::new(),
            covariance: covariance.clone(),
            inputs: Some(Vec::new()),
            data: Vec::new(),
            outliers: Vec::new(),
            fit: FitReport { ordinary_covariance: ordinary, selection_by_prediction: selection, ..found.report() },
            uncertainty: None,
            monte_carlo: None,
            group: None,
        })
    }

    fn estimate(&self, _: &Problem) -> Result<Calibration> {
        Err(Error::usage("thermal states follow from readings, and not from poses of a machine"))
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(Error::usage("thermal states follow from readings, and not from poses of a machine"))
    }
}

impl ThermalStates {
    /// The settings with which others predict: inputs that were selected, all outputs by their names, time constants.
    fn resolved(&self, fitted: &Fitted, logs: &[SensorLog], outputs: &[Output]) -> Result<Value> {
        let names = |sensors: &[usize]| sensors.iter().map(|&sensor| logs[0].names()[sensor].clone()).collect();
        let settings = Settings {
            inputs: names(&fitted.structure.inputs),
            at_once: names(&fitted.structure.at_once),
            outputs: outputs.iter().map(|output| output.name.clone()).collect(),
            time_constants: Some(fitted.time_constants.len()),
            time_constants_s: fitted.time_constants.clone(),
            select: None,
            ..self.settings.clone()
        };
        serde_json::to_value(settings).map_err(|error| Error::data(format!("the settings cannot be written: {error}")))
    }
}

/// What is left out in turn: whole runs, or parts of each.
fn left_out_runs(data: &[&Dataset], structure: &Structure) -> Vec<String> {
    match data.len() > 1 && !structure.starts_warm {
        true => data.iter().map(|data| run_name(data)).collect(),
        false => (1..=PARTS).map(|part| format!("part {part}")).collect(),
    }
}

/// What was tried, as a calibration tells it: inputs by their names, and time constants as `*:3`.
fn selected(
    names: &[String],
    (most, smallest): (&Structure, &Structure),
    tried: &[Tried],
    runs: &[String],
) -> Option<SelectionByPrediction> {
    let all = || most.inputs.iter().map(|&input| names[input].clone());
    let constants = 1..=most.time_constants;
    let has = |structure: &Structure, input: &String| structure.inputs.iter().any(|&own| names[own] == *input);
    let left_out = |structure: &Structure| -> Vec<String> {
        let more = constants.clone().filter(|index| *index > structure.time_constants);
        all().filter(|input| !has(structure, input)).chain(more.map(|index| format!("*:{index}"))).collect()
    };
    let told = |tried: &Tried| PredictedStructure { left_out: left_out(&tried.structure), error: tried.error };
    let is_chosen = |tried: &&Tried| {
        let (own, count) = (&tried.structure.inputs, tried.structure.time_constants);
        *own == smallest.inputs && count == smallest.time_constants
    };
    let chosen = tried.iter().find(is_chosen).map(told)?;
    let kept = constants.clone().filter(|index| *index <= smallest.time_constants).map(|index| format!("*:{index}"));
    Some(SelectionByPrediction {
        runs: runs.to_vec(),
        worse: WORSE,
        kept: all().filter(|input| has(smallest, input)).chain(kept).collect(),
        left_out: left_out(smallest),
        chosen,
        tried: tried.iter().map(told).collect(),
    })
}

/// Two logs of which one has rows 60 times as close as the other.
fn of_two_units(logs: &[SensorLog]) -> Option<[usize; 2]> {
    let pairs = (0..logs.len()).flat_map(|one| (0..logs.len()).map(move |other| [one, other]));
    pairs.into_iter().find(|[one, other]| (logs[*other].step() / logs[*one].step() / MINUTE - 1.0).abs() < ALIKE)
}

/// The outputs of all runs; those of the first run have to be in all.
fn outputs(runs: &[Run]) -> Result<Vec<Output>> {
    let first = runs.first().ok_or_else(|| Error::usage("at least one run was expected").setting("from"))?;
    let of_runs = |name: &str| -> Result<Vec<Readings>> {
        let in_run =
            |run: &Run| run.outputs.iter().find(|(own, ..)| own == name).map(|(.., readings)| readings.clone());
        let missing = || Error::data(format!("the output {name} is missing in one of the runs"));
        runs.iter().map(|run| in_run(run).ok_or_else(missing)).collect()
    };
    first
        .outputs
        .iter()
        .map(|(name, ..)| Ok(Output { name: name.clone(), runs: of_runs(name)?, standard_uncertainty: None }))
        .collect()
}

/// What a fit found, with what is needed to name it.
struct Found<'a> {
    fitted: &'a Fitted,
    logs: &'a [SensorLog],
    outputs: &'a [Output],
    quantities: &'a [Quantity],
}

impl Found<'_> {
    /// Name, value and unit of everything that is estimated, in the order of the covariance.
    fn values(&self, of_input: impl Fn(usize) -> Quantity) -> Vec<(String, f64, Unit)> {
        let seconds = Unit::of(Quantity::Time);
        let times = self.fitted.time_constants.iter().enumerate();
        let mut values: Vec<(String, f64, Unit)> =
            times.map(|(index, time)| (format!("time_constant[{}]_s", index + 1), *time, seconds)).collect();
        for ((output, gains), quantity) in self.outputs.iter().zip(&self.fitted.gains).zip(self.quantities) {
            let terms = terms(&self.fitted.structure, self.logs[0].names(), self.logs.len());
            for ((suffix, sensor), gain) in terms.iter().zip(gains) {
                let unit = match sensor {
                    Some(sensor) => gain_unit(*quantity, of_input(*sensor)),
                    None => Unit::of(*quantity),
                };
                values.push((format!("{}{suffix}", output.name), *gain, unit));
            }
        }
        values
    }

    /// A covariance with the names and in the units of the values.
    fn named(&self, values: &[(String, f64, Unit)], covariance: impl Fn(usize, usize) -> f64) -> NamedCovariance {
        // Time constants are estimated by their logarithms.
        let scale = |place: usize| self.fitted.time_constants.get(place).copied().unwrap_or(1.0);
        let entry = |row: usize, column: usize| scale(row) * scale(column) * covariance(row, column);
        let all = 0..values.len();
        let rows = all.clone().map(|row| all.clone().map(|column| entry(row, column)).collect()).collect();
        NamedCovariance { order: values.iter().map(|(name, ..)| name.clone()).collect(), rows }
    }

    fn report(&self) -> FitReport {
        let unknowns = self.fitted.covariance.nrows();
        let observations: usize = self.outputs.iter().map(Output::count).sum();
        let lengths: Vec<f64> = (self.fitted.residuals.iter().zip(self.quantities))
            .filter(|(_, quantity)| **quantity == Quantity::Length)
            .flat_map(|(residuals, _)| residuals.iter().map(|residual| 1e3 * residual))
            .collect();
        let mean =
            |of: fn(f64) -> f64| lengths.iter().map(|value| of(*value)).sum::<f64>() / lengths.len().max(1) as f64;
        FitReport {
            observations,
            condition: self.fitted.condition,
            degrees_of_freedom: observations.saturating_sub(unknowns),
            iterations: self.fitted.passes,
            residual_max_um: lengths.iter().fold(0.0, |largest, value| value.abs().max(largest)),
            residual_mean_abs_um: mean(f64::abs),
            residual_rms_um: mean(|value| value * value).sqrt(),
            ..FitReport::without_rows(unknowns)
        }
    }
}

/// How the gains of an output are called after its name, and the sensor of each; none for states at the beginning.
pub fn terms(structure: &Structure, names: &[String], runs: usize) -> Vec<(String, Option<usize>)> {
    let states = 1..=structure.time_constants;
    let mut terms = Vec::new();
    for &input in &structure.inputs {
        terms.extend(states.clone().map(|state| (format!("[{}:{state}]", names[input]), Some(input))));
    }
    terms.extend(structure.at_once.iter().map(|&sensor| (format!("[{}]", names[sensor]), Some(sensor))));
    for run in (1..=runs).filter(|_| structure.starts_warm) {
        let of_run = if runs > 1 { format!(" of run {run}") } else { String::new() };
        terms.extend(states.clone().map(|state| (format!("[start:{state}{of_run}]"), None)));
    }
    terms
}
