//! Estimator `tool-dimensions`.

use std::path::PathBuf;

use abbe_core::{
    CALIBRATION_FORMAT, Calibration, Certificate, ColumnHeader, ConsideredInput, Context, Dataset, Error, Estimate,
    EstimateSource, Estimated, FitReport, Identifiability, InputFile, ModelRecord, NamedCovariance, Problem,
    Quantity as Kind, Result, SettingsError, Status, Unit,
};
use nalgebra::DMatrix;

use crate::covariance::{of_dimensions, with_lines};
use crate::dimensions::{Reduced, Scatter};
use crate::impossible::sentences;
use crate::judge::judge;
use crate::log::{Log, check_log, check_table, tools};
use crate::record::{ESTIMATOR, Measured, Record, Store, new_name, wear_name};
use crate::settings::{Quantity, Settings, example};
use crate::wear::{Line, lines};

abbe_core::register!(
    Estimate,
    "tool-dimensions",
    "dimensions and wear of tools from the log of a tool setter",
    Settings,
    example,
    build,
    "../reference/estimate-tool-dimensions.md",
    EstimateSource::Readings,
);

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    settings.check()?;
    Ok(Box::new(ToolDimensions { table: context.path(&settings.table), settings }))
}

struct ToolDimensions {
    settings: Settings,
    table: PathBuf,
}

impl Estimate for ToolDimensions {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "table", path: self.table.clone() }]
    }

    fn check_readings(&self, headers: &[Vec<ColumnHeader>]) -> Result<()> {
        headers.iter().try_for_each(|headers| check_log(headers).map_err(|error| error.setting("from")))?;
        check_table(&self.table)
    }

    fn estimates_readings_at_once(&self) -> bool {
        true
    }

    fn estimate_readings(&self, name: &str, data: &[&Dataset]) -> Result<Calibration> {
        let settings = &self.settings;
        let log = Log::read(data, settings)?;
        let table = tools(&self.table, settings)?;
        log.check_tools(&table, &self.table)?;
        let reduced = Reduced::new(name, &log, settings)?;
        if reduced.dimensions.is_empty() {
            return Err(Error::data("no tool has a dimension: the log has the master alone, or no repeats that agree"));
        }
        let master_variance = (settings.master.standard_uncertainty_um * 1e-3).powi(2);
        let of_value =
            |it: &crate::dimensions::Dimension| Measured { check: it.check, quantity: it.quantity, value: it.value };
        let store = Store {
            record: Record {
                settings: settings.clone(),
                tools: table.into_iter().map(|(tool, _)| tool).collect(),
                checks: reduced.checks,
            },
            values: reduced.dimensions.iter().map(of_value).collect(),
            covariance: of_dimensions(&reduced.dimensions, master_variance),
        };
        let judged = judge(&store);
        for sentence in sentences(&store, &judged) {
            tracing::warn!("{name}: {sentence}");
        }
        let lines = lines(&store, &judged);
        let covariance = with_lines(&store.covariance, &lines);
        let report = report(&reduced.scatter, store.values.len());
        let mut calibration = calibration(name, &store, &lines, &covariance, report)?;
        calibration.outliers = reduced.spoiled;
        Ok(calibration)
    }

    fn estimate(&self, _: &Problem) -> Result<Calibration> {
        Err(Error::usage("the log of a tool setter is no problem of a machine: it stands under `from`").setting("from"))
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(Error::usage("the log of a tool setter is no problem of a machine: it stands under `from`").setting("from"))
    }
}

/// The scatter of repeats as the report of a fit.
fn report(scatter: &Scatter, unknowns: usize) -> FitReport {
    let degrees_of_freedom = scatter.readings - scatter.means;
    let over = |sum: f64| sum / scatter.readings.max(1) as f64;
    FitReport {
        observations: scatter.readings,
        degrees_of_freedom,
        sigma: if degrees_of_freedom > 0 { (scatter.weighted / degrees_of_freedom as f64).sqrt() } else { 1.0 },
        residual_max_um: scatter.largest * 1e3,
        residual_mean_abs_um: over(scatter.sizes) * 1e3,
        residual_rms_um: over(scatter.squares).sqrt() * 1e3,
        ..FitReport::without_rows(unknowns)
    }
}

/// Names and values: the present size and the wear of tools are parameters; sizes in earlier sessions, sizes before the first
/// cut and the master stand under `artefacts`.
fn calibration(
    name: &str,
    store: &Store,
    lines: &[Line],
    covariance: &DMatrix<f64>,
    fit: FitReport,
) -> Result<Calibration> {
    let (mut parameters, mut artefacts, mut order) = (Vec::new(), Vec::new(), Vec::new());
    let wear_unit = Unit::per(Kind::Length, Kind::Time, 1);
    let mut add = |list: &mut Vec<Estimated>, name: String, value: f64, unit: Unit| {
        let standard_uncertainty = covariance[(order.len(), order.len())].sqrt();
        order.push(name.clone());
        list.push(Estimated { name, value, unit: unit.to_string(), standard_uncertainty, status: Status::Estimated });
    };
    for &Measured { check, quantity, value } in &store.values {
        let is_last = store.record.last_check(&store.record.checks[check].tool) == Some(check);
        let list = if is_last { &mut parameters } else { &mut artefacts };
        add(list, store.record.name(check, quantity), value, Unit::MM);
    }
    for line in lines {
        add(&mut parameters, wear_name(&line.tool, line.quantity), line.wear, wear_unit);
        add(&mut artefacts, new_name(&line.tool, line.quantity), line.new, Unit::MM);
    }
    let mut rows: Vec<Vec<f64>> = covariance.row_iter().map(|row| row.iter().copied().collect()).collect();
    let mut inputs = Vec::new();
    for quantity in Quantity::ALL {
        let input = master(store, lines, quantity, &order);
        let variance = input.standard_uncertainty.powi(2);
        for (row, sensitivity) in rows.iter_mut().zip(&input.sensitivities) {
            row.push(sensitivity * variance);
        }
        let mut last: Vec<f64> = input.sensitivities.iter().map(|sensitivity| sensitivity * variance).collect();
        last.push(variance);
        rows.push(last);
        order.push(input.name.clone());
        artefacts.push(Estimated {
            name: input.name.clone(),
            value: input.value,
            unit: input.unit.clone(),
            standard_uncertainty: input.standard_uncertainty,
            status: Status::Considered,
        });
        inputs.push(input);
    }
    let places = order.iter().map(|name| Quantity::ALL.iter().position(|it| *name == master_name(*it)));
    let places: Vec<Option<usize>> = places.collect();
    for (index, input) in inputs.iter_mut().enumerate() {
        input.sensitivities.resize(order.len(), 0.0);
        if let Some(own) = places.iter().position(|place| *place == Some(index)) {
            input.sensitivities[own] = 1.0;
        }
    }
    let settings = serde_json::to_value(&store.record)
        .map_err(|error| Error::data(format!("the record of the tools cannot be written: {error}")))?;
    Ok(Calibration {
        abbe_calibration: CALIBRATION_FORMAT,
        estimate: name.to_owned(),
        model: ModelRecord { plugin: ESTIMATOR.to_owned(), settings },
        parameters,
        artefacts,
        covariance: NamedCovariance { order, rows },
        inputs: Some(inputs),
        data: Vec::new(),
        outliers: Vec::new(),
        fit,
        uncertainty: None,
        monte_carlo: None,
        group: None,
    })
}

fn master_name(quantity: Quantity) -> String {
    format!("master.{}", quantity.name())
}

/// The master as an input: it moves all values of a quantity alike, and no wear.
fn master(store: &Store, lines: &[Line], quantity: Quantity, order: &[String]) -> ConsideredInput {
    let master = &store.record.settings.master;
    let certificate = Certificate::new(
        quantity.name(),
        format!(
            "master tool {}: length {} mm, radius {} mm, u = {} um",
            master.tool.0, master.length_mm, master.radius_mm, master.standard_uncertainty_um
        ),
    );
    let mut sensitivities: Vec<f64> =
        store.values.iter().map(|value| f64::from(u8::from(value.quantity == quantity))).collect();
    for line in lines {
        sensitivities.extend([0.0, f64::from(u8::from(line.quantity == quantity))]);
    }
    sensitivities.resize(order.len(), 0.0);
    ConsideredInput {
        name: master_name(quantity),
        identity: master.id.as_ref().map_or(certificate.identity(), |id| certificate.declared_identity(id)),
        value: master.value(quantity),
        unit: Unit::MM.to_string(),
        standard_uncertainty: master.standard_uncertainty_um * 1e-3,
        sensitivities,
    }
}
