//! Rows that are read and not touched, and rows that cannot be reached: on a machine with a single axis.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    Absent, Axis, AxisKind, Branch, Column, ColumnHeader, Contact, Dataset, Equations, KinematicModel, Layout,
    ModelInfo, ObservationSet, Observations, ObservationsInfo, Parameter, PoseBatch, PoseIndex, PosesMut, Problem,
    Quantity, Result, RowBatch, RowOrigin, StatusColumn, Unit, Values, Variable, plain_naming,
};
use abbe_estimation::{is_judged_as_recorded, rank_point};
use abbe_simulation::{Noise, StandardDeviation, Truth, measure};
use serde_json::Value;

/// The tip is at (X (1 + EXX[1]) + dxt, 0, 0).
struct Rail(ModelInfo);

impl Rail {
    fn new() -> Self {
        let axis = Axis {
            name: "X".to_owned(),
            kind: AxisKind::Linear,
            branch: Branch::Tool,
            sense: 1.0,
            direction: [1.0, 0.0, 0.0],
            range: None,
            indexed: false,
            endless: false,
            status: 0,
        };
        let status = StatusColumn {
            name: "X".to_owned(),
            role: abbe_core::StatusRole::Command(0),
            quantity: Quantity::Length,
            levels: Vec::new(),
            absent: Absent::Required,
        };
        let gain = Parameter::new("EXX[1]", Unit::per(Quantity::Length, Quantity::Length, 1));
        let tool = Parameter::new("dxt", Unit::MM);
        Self(ModelInfo::new(vec![axis], vec![status], vec![gain, tool], Value::Null))
    }
}

impl KinematicModel for Rail {
    fn info(&self) -> &ModelInfo {
        &self.0
    }

    fn evaluate(&self, batch: PoseBatch<'_>, out: PosesMut<'_>) -> Result<()> {
        let PoseBatch { statuses, values, wanted, .. } = batch;
        for (pose, x) in statuses.iter().enumerate() {
            out.positions[pose] = [x * (1.0 + values[0]) + values[1], 0.0, 0.0];
            for (k, variable) in wanted.iter().enumerate() {
                let slope = match variable {
                    Variable::Command(_) => 1.0 + values[0],
                    Variable::Parameter(0) => *x,
                    Variable::Parameter(_) => 1.0,
                };
                out.position_derivatives[pose * wanted.len() + k] = [slope, 0.0, 0.0];
            }
        }
        Ok(())
    }
}

/// `p[axis] - (zero + reading) = 0`; without a column of readings the axis moves instead.
struct Dial {
    info: ObservationsInfo,
    axis: usize,
    column: Option<&'static str>,
}

impl Observations for Dial {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        for (&row, tip) in batch.rows.iter().zip(batch.positions) {
            let Layout { data, rows, .. } = &self.info.layout;
            let data_row = rows[row].data_row.expect("it is measured");
            let reading = self.column.and_then(|column| data.numbers(column)).map_or(0.0, |all| all[data_row]);
            out.equation(tip[self.axis] - batch.own[0] - reading);
            let mut unit = [0.0; 3];
            unit[self.axis] = 1.0;
            out.position(unit);
            out.own(0, -1.0);
        }
        Ok(())
    }
}

fn problem(header: &str, axis: usize, column: Option<&'static str>) -> Problem {
    let cells = |header: &str, numbers: [f64; 3]| Column {
        header: ColumnHeader::parse(header),
        values: Values::Numbers(numbers.to_vec()),
    };
    let data = Arc::new(Dataset {
        columns: vec![cells("X_mm", [10.0, 20.0, 30.0]), cells(header, [10.0, 20.5, 30.0])],
        origins: (0..3).map(|row| RowOrigin { file: 0, line: row + 2, row: row + 1 }).collect(),
        files: vec![PathBuf::from("dial.csv")],
        averaged: false,
        is_log: false,
        stated_tips: Vec::new(),
    });
    let model: Arc<dyn KinematicModel> = Arc::new(Rail::new());
    let mut layout = Layout::new(&data, model.as_ref(), &[&plain_naming]).unwrap();
    data.row_indices().for_each(|row| layout.push(model.as_ref(), row, &[1e-3]).unwrap());
    let contact = column.map_or(Contact::LinearAxes, |column| Contact::Reading(column.to_owned()));
    let info = ObservationsInfo::new(layout, vec![Parameter::new("zero", Unit::MM)], contact);
    let set = ObservationSet::new("dial", Arc::new(Dial { info, axis, column }));
    Problem::new("fit", "rail", model, vec![set], &["*".to_owned()]).unwrap()
}

fn truth(noise: Noise) -> Truth {
    let parameters = [("EXX[1]", 1e-3), ("dxt", 0.123456), ("dial.zero", -0.5)];
    Truth { parameters: parameters.map(|(name, value)| (name.to_owned(), value)).into(), noise }
}

/// EXX[1], dxt, zero.
const TRUE: [f64; 3] = [1e-3, 0.123456, -0.5];

#[test]
fn a_reading_makes_up_for_the_difference() {
    let programme = problem("reading_um", 0, Some("reading"));
    let measured = measure(&programme, &truth(Noise::default()), 1).unwrap();
    assert_eq!(measured.sets[0].poses(), programme.sets[0].poses());
    assert_eq!(measured.start(), programme.start());
    assert!(measured.residuals(&TRUE).unwrap().iter().all(|residual| residual.abs() < 1e-14));
    // What is read is the recorded reading without what is added to the residual.
    let read: Vec<f64> = [10.0, 20.5, 30.0]
        .iter()
        .zip(measured.sets[0].disturbances().unwrap())
        .map(|(recorded, disturbance)| recorded - disturbance)
        .collect();
    for (read, x) in read.iter().zip([10.0, 20.0, 30.0]) {
        assert!((read - (x * 1.001 + 0.123456 + 0.5)).abs() < 1e-12, "{read}");
    }
}

#[test]
fn readings_without_a_nominal_one_are_judged_as_recorded() {
    let read = problem("reading_um", 0, Some("reading"));
    for problem in [read.clone(), read.disturbed(&[0.1, 0.2, -0.3])] {
        assert!(is_judged_as_recorded(&problem));
        assert_eq!(rank_point(&problem, &TRUE).unwrap().sets[0].poses(), problem.sets[0].poses());
    }
    // The same rows without a reading are touches.
    let touched = problem("note_mm", 0, None);
    assert!(!is_judged_as_recorded(&touched));
    assert_ne!(rank_point(&touched, &TRUE).unwrap().sets[0].poses(), touched.sets[0].poses());
}

#[test]
fn readings_have_noise_and_resolution() {
    let programme = problem("reading_um", 0, Some("reading"));
    let noise = Noise { probing_sigma_mm: StandardDeviation::All(0.01), resolution_mm: 0.001, ..Noise::default() };
    let measured = measure(&programme, &truth(noise), 1).unwrap();
    let off = measured.residuals(&TRUE).unwrap();
    assert!(off.iter().all(|residual| residual.abs() < 0.05) && off.iter().any(|residual| residual.abs() > 1e-3));
    for (recorded, disturbance) in [10.0, 20.5, 30.0].iter().zip(measured.sets[0].disturbances().unwrap()) {
        let steps = (recorded - disturbance) / 0.001;
        assert!((steps - steps.round()).abs() < 1e-6, "{steps}");
    }
}

#[test]
fn angles_that_are_read_have_no_noise_in_mm() {
    let programme = problem("tilt_urad", 0, Some("tilt"));
    let noise = Noise { probing_sigma_mm: StandardDeviation::All(0.01), resolution_mm: 0.001, ..Noise::default() };
    let measured = measure(&programme, &truth(noise), 1).unwrap();
    assert!(measured.residuals(&TRUE).unwrap().iter().all(|residual| residual.abs() < 1e-14));
}

#[test]
fn the_axis_moves_where_there_is_no_reading() {
    let programme = problem("note_mm", 0, None);
    let measured = measure(&programme, &truth(Noise::default()), 1).unwrap();
    assert!(measured.residuals(&TRUE).unwrap().iter().all(|residual| residual.abs() < 1e-11));
    assert!((measured.sets[0].poses().row(PoseIndex(0))[0] - (-0.5 - 0.123456) / 1.001).abs() < 1e-10);
}

#[test]
fn what_the_axis_cannot_reach_is_an_error_with_its_place() {
    let error = measure(&problem("note_mm", 2, None), &truth(Noise::default()), 1).err().unwrap().to_string();
    assert!(error.starts_with("dial.csv:2: the tip cannot reach `dial` in this row by its linear axes: "), "{error}");
}

#[test]
fn values_that_are_no_numbers_are_refused() {
    let wrong = |name: &str| Truth { parameters: BTreeMap::from([(name.to_owned(), f64::NAN)]), ..Truth::default() };
    let error = measure(&problem("note_mm", 0, None), &wrong("dxt"), 1).err().unwrap().to_string();
    assert_eq!(error, "parameters.dxt: NaN: a finite number was expected");
    for (noise, setting) in [
        (Noise { resolution_mm: 1e308, ..Noise::default() }, "resolution_mm"),
        (Noise { probing_sigma_mm: StandardDeviation::All(1e12), ..Noise::default() }, "probing_sigma_mm"),
    ] {
        let error = measure(&problem("note_mm", 0, None), &truth(noise), 1).err().unwrap().to_string();
        assert!(error.contains(setting) && error.contains("at most 100 mm were expected"), "{error}");
    }
}
