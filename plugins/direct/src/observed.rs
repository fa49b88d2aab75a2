//! The readings: their rows, unknowns and equations.

use std::collections::BTreeMap;
use std::sync::Arc;

use abbe_core::rotation::inverse_left_jacobian;
use abbe_core::{
    Contact, DataRow, Dataset, Equations, KinematicModel, LabelText, Layout, LayoutEquation, Observations,
    ObservationsInfo, Orientation, Parameter, ParameterRole, Poses, Quantity, Result, RowBatch, RowIndex, Unit, Values,
};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::line::{self, Leg, Line, Tilt};

/// One reading.
#[derive(Debug, Clone)]
struct Reading {
    /// Derivative to the translation (rotation) of the tool relative to the table.
    sensitivity: Vector3<f64>,
    /// The unknowns of its equation, with their factors: offset, drift, tilt.
    own: Vec<(usize, f64)>,
    /// mm or rad.
    value: f64,
}

/// The machine without errors, with which readings are compared.
enum Nominal {
    Tips(Vec<Vector3<f64>>),
    Orientations(Vec<UnitQuaternion<f64>>),
}

/// All readings.
struct Observed {
    info: ObservationsInfo,
    readings: Vec<Reading>,
    nominal: Nominal,
}

/// Unknowns by name, in the order in which they occur.
#[derive(Default)]
struct Unknowns {
    all: Vec<Parameter>,
    index: BTreeMap<String, usize>,
}

impl Unknowns {
    fn get(&mut self, name: String, unit: Unit) -> usize {
        *self.index.entry(name).or_insert_with_key(|name| {
            self.all.push(Parameter::new(name, unit).with_role(ParameterRole::SetUp));
            self.all.len() - 1
        })
    }
}

/// Readings that share an offset and a drift.
struct Run {
    first_row: DataRow,
    rows: usize,
    first_time: f64,
    several_times: bool,
}

/// Makes the observations; `labels` has the label of every row, each that of a line.
pub fn observe(
    data: &Arc<Dataset>,
    labels: &[LabelText],
    lines: &BTreeMap<&str, Line>,
    model: &dyn KinematicModel,
) -> Result<Arc<dyn Observations>> {
    let mut layout = Layout::new(data, model, &[&line::naming])?;
    let names: Vec<String> =
        data.row_indices().map(|row| run_of(data, row, &labels[row], &lines[labels[row].as_str()])).collect();
    let runs = runs(data, &names, |row| &lines[labels[row].as_str()])?;
    let columns = Columns::of(data);
    let values = data.required_numbers("reading")?;
    let (mut unknowns, mut readings) = (Unknowns::default(), Vec::new());
    for row in data.row_indices() {
        let (label, line) = (&labels[row], &lines[labels[row].as_str()]);
        let leg = columns.leg(data, row, line)?;
        let pose = layout.poses.end();
        layout.push(model, row, &[line.standard_uncertainty])?;
        let position = columns.settle(data, row, line, leg, layout.poses.row_mut(pose))?;

        let unit = if line.angle { Unit::RAD } else { Unit::MM };
        let run = &names[row];
        let mut own = vec![(unknowns.get(format!("{run}.datum"), unit), 1.0)];
        if line.drift {
            let per_time = Unit::per(unit.of, Quantity::Time, 1);
            let since = columns.time(row) - runs[run.as_str()].first_time;
            own.push((unknowns.get(format!("{run}.drift"), per_time), since));
        }
        if let Some(tilt) = &line.tilt {
            let name = match tilt {
                Tilt::Slope(Some(face)) => format!("{face}.slope"),
                Tilt::Slope(None) => format!("{label}.slope"),
                Tilt::Angle => format!("{label}.angle"),
            };
            own.push((unknowns.get(name, line::of_tilt(model, leg)), leg.by_tilt * position));
        }
        readings.push(Reading { sensitivity: leg.sensitivity, own, value: values[row] });
    }
    let angles = lines.values().any(|line| line.angle);
    let nominal = nominal(&layout, model, angles)?;
    // No features: a line is none.
    let mut info = ObservationsInfo::new(layout, unknowns.all, Contact::Reading("reading".to_owned()));
    if angles {
        info.orientation = Orientation::FirstOrder;
        info.angles = LayoutEquation::first(info.layout.standard_uncertainties.len()).collect();
    }
    Ok(Arc::new(Observed { info, readings, nominal }))
}

/// The name of a group of readings that has its own offset: `EXX[1]`, or `EXX` if the measurement has one offset.
fn run_of(data: &Dataset, row: DataRow, label: &str, line: &Line) -> String {
    let values =
        line.datum_columns.iter().filter_map(|column| match data.column(column).map(|column| &column.values) {
            Some(Values::Labels(labels)) => Some(labels[row].to_string()),
            Some(Values::Numbers(numbers)) => Some(format!("{}", (numbers[row] * 1e9).round() / 1e9)),
            None => None,
        });
    match values.collect::<Vec<_>>().join(".") {
        none if none.is_empty() => label.to_owned(),
        values => format!("{label}[{values}]"),
    }
}

/// The runs; each needs readings from which its offset and drift can be told apart.
fn runs<'a, 'b>(
    data: &Dataset,
    names: &'a [String],
    line: impl Fn(DataRow) -> &'b Line,
) -> Result<BTreeMap<&'a str, Run>> {
    let times = data.numbers("time");
    let mut runs: BTreeMap<&str, Run> = BTreeMap::new();
    for (row, name) in DataRow::enumerate(names) {
        let time = times.map_or(0.0, |times| times[row]);
        let run = runs.entry(name).or_insert(Run { first_row: row, rows: 0, first_time: time, several_times: false });
        run.rows += 1;
        run.several_times |= time != run.first_time;
    }
    for (name, run) in &runs {
        if run.rows == 1 {
            let message = format!("`{name}` has this one reading, which tells nothing beside its own offset");
            return Err(data.error_at(run.first_row, message).help("a run needs two readings or more; leave it out"));
        }
        if line(run.first_row).drift && !run.several_times {
            let message = format!("all readings of `{name}` are of one time: its drift cannot be told");
            return Err(data.error_at(run.first_row, message).help("set `drift: false` for this measurement"));
        }
    }
    Ok(runs)
}

/// The columns that rows are read from.
struct Columns<'a> {
    positions: Option<&'a [f64]>,
    directions: Option<&'a [LabelText]>,
    legs: Option<&'a [LabelText]>,
    times: Option<&'a [f64]>,
}

impl<'a> Columns<'a> {
    fn of(data: &'a Dataset) -> Self {
        Self {
            positions: data.numbers("position"),
            directions: data.labels("direction"),
            legs: data.labels("leg"),
            times: data.numbers("time"),
        }
    }

    fn time(&self, row: DataRow) -> f64 {
        self.times.map_or(0.0, |times| times[row])
    }

    /// The leg of a row.
    fn leg<'b>(&self, data: &Dataset, row: DataRow, line: &'b Line) -> Result<&'b Leg> {
        let (Some(legs), true) = (self.legs, line.legs.len() > 1) else { return Ok(&line.legs[0]) };
        line.legs.iter().find(|leg| leg.name == legs[row]).ok_or_else(|| {
            let names: Vec<&str> = line.legs.iter().map(|leg| leg.name.as_str()).collect();
            data.error_at(row, format!("leg `{}`: {} was expected", legs[row], names.join(" or ")))
        })
    }

    /// Completes the status of a row; gives the position of the axis that moves.
    fn settle(&self, data: &Dataset, row: DataRow, line: &Line, leg: &Leg, status: &mut [f64]) -> Result<f64> {
        line.at.iter().for_each(|&(index, value)| status[index] = value);
        let Some(command) = leg.command else { return Ok(0.0) };
        let position = self.positions.map_or(f64::NAN, |positions| positions[row]);
        status[command] = position;
        if let (Some(approach), Some(directions)) = (leg.approach, self.directions) {
            let direction = &directions[row];
            status[approach] = match direction.trim().parse::<f64>() {
                Ok(sign) if [1.0, -1.0, 0.0].contains(&sign) => sign,
                _ => return Err(data.error_at(row, format!("`direction` is {direction}; 1, -1 or 0 was expected"))),
            };
        }
        Ok(position)
    }
}

/// Tips or orientations of the machine without errors.
fn nominal(layout: &Layout, model: &dyn KinematicModel, angles: bool) -> Result<Nominal> {
    let statuses: Vec<f64> = layout.poses.indices().flat_map(|pose| layout.poses.row(pose)).copied().collect();
    let mut poses = Poses::default();
    model.poses(&statuses, &model.info().nominal, &[], angles, &mut poses)?;
    Ok(match angles {
        true => Nominal::Orientations(poses.orientations.iter().map(|at| rotation(*at)).collect()),
        false => Nominal::Tips(poses.positions.iter().map(|tip| Vector3::from(*tip)).collect()),
    })
}

fn rotation([w, x, y, z]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

impl Observations for Observed {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        let RowBatch { rows, own, .. } = batch;
        for (index, &RowIndex(row)) in rows.iter().enumerate() {
            let reading = &self.readings[row];
            let line = reading.own.iter().map(|&(unknown, factor)| factor * own[unknown]).sum::<f64>() - reading.value;
            match &self.nominal {
                Nominal::Tips(tips) => {
                    let moved = Vector3::from(batch.positions[index]) - tips[row];
                    out.equation(reading.sensitivity.dot(&moved) + line);
                    out.position(reading.sensitivity.into());
                }
                Nominal::Orientations(orientations) => {
                    let turned = (rotation(batch.orientations[index]) * orientations[row].inverse()).scaled_axis();
                    out.equation(reading.sensitivity.dot(&turned) + line);
                    out.position([0.0; 3]);
                    out.rotation((inverse_left_jacobian(&turned).transpose() * reading.sensitivity).into());
                }
            }
            reading.own.iter().for_each(|&(unknown, factor)| out.own(unknown, factor));
        }
        Ok(())
    }
}
