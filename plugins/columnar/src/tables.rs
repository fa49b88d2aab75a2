//! Results as columns, in the units used in memory.

use std::collections::BTreeSet;

use abbe_core::{
    AxisKind, Calibration, Error, Fit, KinematicModel, NamedCovariance, Result, Status, StatusRole, Values,
};
use abbe_estimation::{RowResidual, residual_rows};
use abbe_volumetric::{Grid, predict, within};

/// A table.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// The name of its file, without the ending.
    pub name: String,
    /// The columns, all of the same length.
    pub columns: Vec<OfTable>,
}

/// A column of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct OfTable {
    /// Its name, with its unit.
    pub name: String,
    /// Its unit.
    pub unit: Option<String>,
    /// Its cells.
    pub values: OfRows,
}

/// The cells of a column.
#[derive(Debug, Clone, PartialEq)]
pub enum OfRows {
    /// Numbers.
    Numbers(Vec<f64>),
    /// Numbers that may be missing.
    Optional(Vec<Option<f64>>),
    /// Whole numbers.
    Whole(Vec<i64>),
    /// Texts.
    Labels(Vec<String>),
}

fn column(name: impl Into<String>, unit: &str, values: OfRows) -> OfTable {
    let unit = (!unit.is_empty()).then(|| unit.to_owned());
    OfTable { name: name.into(), unit, values }
}

fn labels(name: &str, labels: impl IntoIterator<Item = String>) -> OfTable {
    column(name, "", OfRows::Labels(labels.into_iter().collect()))
}

/// The residuals of an estimate: rows as in the table of residuals in CSV, with all digits.
pub fn residuals(fit: &Fit) -> Result<Table> {
    let rows = residual_rows(fit)?;
    let sets = &fit.problem.sets;
    let data = |row: &RowResidual| &sets[row.set].info().layout.data;
    let origin = |row: &RowResidual| data(row).origins[row.data_row];
    let optional = |name: &str, unit: &str, value: &dyn Fn(&RowResidual) -> Option<f64>| {
        column(name, unit, OfRows::Optional(rows.iter().map(value).collect()))
    };
    let whole = |name: &str, value: &dyn Fn(&RowResidual) -> usize| {
        let number = |row| i64::try_from(value(row)).unwrap_or(i64::MAX);
        column(name, "", OfRows::Whole(rows.iter().map(number).collect()))
    };
    let file = |row: &RowResidual| data(row).files[origin(row).file].display().to_string();
    let mut columns = vec![
        labels("stage", rows.iter().map(|row| sets[row.set].name.clone())),
        labels("file", rows.iter().map(file)),
        whole("line", &|row| origin(row).line),
        whole("row", &|row| origin(row).row),
        optional("residual_mm", "mm", &|row| (!row.is_angle).then_some(row.value)),
        optional("uncertainty_mm", "mm", &|row| (!row.is_angle).then_some(row.uncertainty)),
        optional("residual_rad", "rad", &|row| row.is_angle.then_some(row.value)),
        optional("uncertainty_rad", "rad", &|row| row.is_angle.then_some(row.uncertainty)),
        optional("time_s", "s", &|row| {
            data(row).numbers("time").map(|times| times[row.data_row]).filter(|time| time.is_finite())
        }),
    ];
    for (part, name) in ["x", "y", "z"].into_iter().enumerate() {
        columns.push(optional(&format!("tip_{name}_mm"), "mm", &|row| row.tip.map(|tip| tip[part])));
    }
    for (part, name) in ["x", "y", "z"].into_iter().enumerate() {
        columns.push(optional(&format!("direction_{name}"), "1", &|row| row.direction.map(|to| to[part])));
    }
    for (index, axis) in fit.problem.model.info().axes.iter().enumerate() {
        let unit = if axis.kind == AxisKind::Linear { "mm" } else { "rad" };
        columns.push(optional(&format!("{}_{unit}", axis.name), unit, &|row| {
            Some(row.commands[index]).filter(|command| command.is_finite())
        }));
    }
    let mut taken: BTreeSet<String> = columns.iter().map(|column| column.name.clone()).collect();
    for own in sets.iter().flat_map(|set| &set.info().layout.data.columns) {
        let name = &own.header.name;
        if matches!(own.values, Values::Labels(_)) && taken.insert(name.clone()) {
            let label = |row| data(row).labels(name).map_or_else(String::new, |cells| cells[row.data_row].to_string());
            columns.push(labels(name, rows.iter().map(label)));
        }
    }
    Ok(Table { name: format!("{}.residuals", fit.name), columns })
}

/// All parameters, of the machine first.
pub fn parameters(name: &str, calibration: &Calibration) -> Table {
    let all: Vec<_> = calibration.parameters.iter().chain(&calibration.artefacts).collect();
    let numbers = |value: fn(&abbe_core::Estimated) -> f64| OfRows::Numbers(all.iter().map(|own| value(own)).collect());
    let columns = vec![
        labels("name", all.iter().map(|own| own.name.clone())),
        column("value", "", numbers(|own| own.value)),
        labels("unit", all.iter().map(|own| own.unit.clone())),
        column("standard_uncertainty", "", numbers(|own| own.standard_uncertainty)),
        labels("status", all.iter().map(|own| status(own.status).to_owned())),
    ];
    Table { name: format!("{name}.parameters"), columns }
}

fn status(status: Status) -> &'static str {
    match status {
        Status::Estimated => "estimated",
        Status::Fixed => "fixed",
        Status::Considered => "considered",
        Status::Confounded => "confounded",
    }
}

/// The covariance matrix: a column for every parameter.
pub fn covariance(name: &str, calibration: &Calibration) -> Table {
    let NamedCovariance { order, rows } = &calibration.covariance;
    let unit = |name: &String| calibration.get(name).map_or_else(String::new, |own| own.unit.clone());
    let mut columns = vec![labels("name", order.iter().cloned()), labels("unit", order.iter().map(unit))];
    for (index, name) in order.iter().enumerate() {
        let entries = rows.iter().map(|row| row[index]).collect();
        columns.push(column(name, &unit(name), OfRows::Numbers(entries)));
    }
    Table { name: format!("{name}.covariance"), columns }
}

/// The values of the trials of a Monte Carlo calculation. Fails if the estimate has none.
pub fn samples(name: &str, calibration: &Calibration) -> Result<Table> {
    let found = calibration.monte_carlo.as_ref().and_then(|found| found.samples.as_ref()).ok_or_else(|| {
        Error::usage(format!("`{name}` has no samples"))
            .help("`of` names an estimate by `monte-carlo` with `keep_samples: true`; else leave `samples` out")
            .setting("tables")
    })?;
    let width = found.quantities.len().max(1);
    let trials = found.values.len() / width;
    let mut columns = vec![column("trial", "", OfRows::Whole((1..).take(trials).collect()))];
    for (index, (name, unit)) in found.quantities.iter().enumerate() {
        let values = found.values.iter().skip(index).step_by(width).copied().collect();
        columns.push(column(name, unit, OfRows::Numbers(values)));
    }
    Ok(Table { name: format!("{name}.samples"), columns })
}

/// The volumetric error over a grid, with its covariance.
pub fn volumetric(name: &str, calibration: &Calibration, model: &dyn KinematicModel, grid: &Grid) -> Result<Table> {
    let statuses = grid.statuses(model).map_err(|error| within(error, &["grid"]))?;
    let errors = predict(model, calibration, &statuses)?;
    let width = model.info().status.len().max(1);
    let of_status = |place: usize| OfRows::Numbers(statuses.iter().skip(place).step_by(width).copied().collect());
    let mut columns = Vec::new();
    for axis in &model.info().axes {
        let unit = if axis.kind == AxisKind::Linear { "mm" } else { "rad" };
        columns.push(column(format!("{}_{unit}", axis.name), unit, of_status(axis.status)));
    }
    for (place, own) in model.info().status.iter().enumerate() {
        if grid.both_directions && matches!(own.role, StatusRole::Direction(_)) {
            columns.push(column(&own.name, "1", of_status(place)));
        }
    }
    let names = ["x", "y", "z"];
    for (part, name) in names.into_iter().enumerate() {
        let values = errors.iter().map(|error| error.mean[part]).collect();
        columns.push(column(format!("{name}_mm"), "mm", OfRows::Numbers(values)));
    }
    for (row, column_of) in [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)] {
        let values = errors.iter().map(|error| error.covariance[row][column_of]).collect();
        columns.push(column(format!("{}{}_mm2", names[row], names[column_of]), "mm^2", OfRows::Numbers(values)));
    }
    Ok(Table { name: format!("{name}.volumetric"), columns })
}
