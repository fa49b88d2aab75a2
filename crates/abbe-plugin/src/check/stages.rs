//! Plugins with missing, empty or extreme data: an error or an answer is accepted, a panic or a crash is not.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    Absent, Axis, AxisKind, Branch, Build, CALIBRATION_FORMAT, Calibration, Column, ColumnHeader, Considered, Context,
    Dataset, Error, Estimate, Estimated, Fit, FitReport, Identifiability, KinematicModel, ModelInfo, ModelRecord,
    NamedCovariance, Plugin, PoseBatch, PosesMut, Problem, Quantity, Result, RowOrigin, Status, StatusColumn,
    StatusRole, Values, Variable,
};
use serde_json::json;

use super::Findings;
use crate::loader::Library;

pub(super) fn no_data(library: &Library, findings: &mut Findings) {
    for plugin in &library.plugins {
        for (given, result) in trials(plugin) {
            let Err(error) = result else { continue };
            let bug = ["panicked", "not UTF-8", "lacks a function", "without a message", "unknown status"];
            if error.message.trim().is_empty() || bug.iter().any(|bug| error.message.contains(bug)) {
                findings.wrong(format!("`{}`, given {given}: {error}", plugin.name));
            }
        }
    }
}

/// What a plugin is given, and its result. A crash ends this process, which the result of the test shows.
fn trials(plugin: &Plugin) -> Vec<(&'static str, Result<()>)> {
    let (example, context) = (plugin.example.get(), Context { base: std::env::temp_dir() });
    let data =
        || [("no data", Dataset::default()), ("columns without rows", rows(0, 0.0)), ("huge numbers", rows(3, 1e308))];
    let fits = || [("an estimate of nothing", fit(&[])), ("an estimate of huge values", fit(&[1e308, -1e308]))];
    let machine: Arc<dyn KinematicModel> = Arc::new(Plain::new());
    // The test of settings reports an example that cannot be built.
    match &plugin.build {
        Build::Ingest(constructor) => match constructor.build(example, &context) {
            Ok(stage) => vec![("a file that is not there", stage.read().map(drop))],
            Err(_) => Vec::new(),
        },
        Build::Artefact(constructor) => match constructor.build(example, &context) {
            Ok(stage) => data().map(|(given, data)| (given, stage.observe(&Arc::new(data), &machine).map(drop))).into(),
            Err(_) => Vec::new(),
        },
        Build::Estimate(constructor) => match constructor.build(example, &context) {
            Ok(stage) => vec![("a problem without observations", stage.estimate(&problem()).map(drop))],
            Err(_) => Vec::new(),
        },
        Build::Validate(constructor) => match constructor.build(example, &context) {
            Ok(stage) => {
                fits().map(|(given, fit)| (given, stage.validate(&[&fit], &[&Dataset::default()]).map(drop))).into()
            }
            Err(_) => Vec::new(),
        },
        Build::Export(constructor) => match constructor.build(example, &context) {
            Ok(stage) => {
                fits().map(|(given, fit)| (given, stage.export(&fit.calibration, machine.as_ref()).map(drop))).into()
            }
            Err(_) => Vec::new(),
        },
        Build::Model(constructor) => match constructor.build(example, &context) {
            Ok(stage) => data().map(|(given, data)| (given, stage.build(&[&data]).map(drop))).into(),
            Err(_) => Vec::new(),
        },
    }
}

/// Commands of three axes and a feature.
fn rows(count: usize, value: f64) -> Dataset {
    let column = |name: &str, quantity, values| Column {
        header: ColumnHeader { name: name.to_owned(), header: name.to_owned(), quantity },
        values,
    };
    let mut columns = vec![column("feature", Quantity::Label, Values::Labels(vec!["1".into(); count]))];
    columns.extend(AXES.map(|axis| column(axis, Quantity::Length, Values::Numbers(vec![value; count]))));
    let origin = |row: usize| RowOrigin { file: 0, line: row + 2, row: row + 1 };
    Dataset {
        columns,
        origins: (0..count).map(origin).collect(),
        files: vec![PathBuf::from("none.csv")],
        averaged: false,
        is_log: false,
        stated_tips: Vec::new(),
    }
}

fn problem() -> Problem {
    Problem {
        monitor: abbe_core::Monitor::default(),
        name: "fit".to_owned(),
        model: Arc::new(Plain::new()),
        model_plugin: "plain".to_owned(),
        sets: Vec::new(),
        unknowns: Vec::new(),
        ties: Vec::new(),
        machine_values: Vec::new(),
        inputs: Vec::new(),
        considered: Considered::default(),
        priors: Vec::new(),
    }
}

fn fit(values: &[f64]) -> Fit {
    let estimated = |(index, value): (usize, &f64)| Estimated {
        name: format!("p[{index}]"),
        value: *value,
        unit: "mm".to_owned(),
        standard_uncertainty: 0.0,
        status: Status::Estimated,
    };
    let calibration = Calibration {
        abbe_calibration: CALIBRATION_FORMAT,
        estimate: "fit".to_owned(),
        model: ModelRecord { plugin: "plain".to_owned(), settings: json!({}) },
        parameters: values.iter().enumerate().map(estimated).collect(),
        artefacts: Vec::new(),
        covariance: NamedCovariance::default(),
        inputs: None,
        data: Vec::new(),
        outliers: Vec::new(),
        fit: FitReport::without_rows(0),
        uncertainty: None,
        monte_carlo: None,
        group: None,
    };
    Fit { name: "fit".to_owned(), problem: Arc::new(problem()), estimator: Arc::new(Nobody), calibration }
}

/// An estimator that has nothing to estimate.
struct Nobody;

impl Estimate for Nobody {
    fn estimate(&self, _: &Problem) -> Result<Calibration> {
        Err(Error::data("there is nothing to estimate"))
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(Error::data("there is nothing to estimate"))
    }
}

const AXES: [&str; 3] = ["X", "Y", "Z"];

/// Three axes without errors.
struct Plain(ModelInfo);

impl Plain {
    fn new() -> Self {
        let axis = |status: usize| {
            let mut direction = [0.0; 3];
            direction[status] = 1.0;
            Axis {
                name: AXES[status].to_owned(),
                kind: AxisKind::Linear,
                branch: Branch::Tool,
                sense: 1.0,
                direction,
                range: None,
                indexed: false,
                endless: false,
                status,
            }
        };
        let column = |axis: usize| StatusColumn {
            name: AXES[axis].to_owned(),
            role: StatusRole::Command(axis),
            quantity: Quantity::Length,
            levels: Vec::new(),
            absent: Absent::Required,
        };
        let (axes, status) = ((0..3).map(axis).collect(), (0..3).map(column).collect());
        Self(ModelInfo::new(axes, status, Vec::new(), json!({})))
    }
}

impl KinematicModel for Plain {
    fn info(&self) -> &ModelInfo {
        &self.0
    }

    fn evaluate(&self, batch: PoseBatch<'_>, out: PosesMut<'_>) -> Result<()> {
        out.positions.as_flattened_mut().copy_from_slice(batch.statuses);
        out.orientations.fill([1.0, 0.0, 0.0, 0.0]);
        for (by, variable) in out.position_derivatives.iter_mut().zip(batch.wanted.iter().cycle()) {
            if let Variable::Command(axis) = *variable {
                by[axis] = 1.0;
            }
        }
        Ok(())
    }
}
