//! States of the terms of outputs, as columns of a linear problem.

use abbe_core::Result;
use faer::linalg::solvers::Qr;
use faer::{Mat, MatRef};

use crate::fit::Structure;
use crate::log::SensorLog;
use crate::response::Response;

/// Columns are dependent below this part of their size.
const DEPENDENT: f64 = 1e-10;

/// States of all terms at the readings of some outputs, and what they change with each time constant.
pub struct Basis {
    pub columns: Mat<f64>,
    /// Derivatives of columns to the logarithm of the time constant that each has; none for what outputs follow at once.
    pub slopes: Mat<f64>,
    pub qr: Qr<f64>,
    thin: Mat<f64>,
}

impl Basis {
    /// The basis at the times of each run.
    pub fn new(logs: &[SensorLog], structure: &Structure, logarithms: &[f64], times: &[&[f64]]) -> Result<Self> {
        let (rows, count) = (times.iter().map(|times| times.len()).sum(), structure.gains(logs.len()));
        let (mut columns, mut slopes) = (Mat::zeros(rows, count), Mat::zeros(rows, count));
        let mut first = 0;
        for (run, (log, times)) in logs.iter().zip(times).enumerate() {
            let put = |place: usize, response: Response| {
                for (row, (value, slope)) in response.values.iter().zip(&response.slopes).enumerate() {
                    (columns[(first + row, place)], slopes[(first + row, place)]) = (*value, *slope);
                }
            };
            of_run(log, structure, logarithms, times, run, put)?;
            first += times.len();
        }
        let qr = columns.as_ref().qr();
        let thin = qr.compute_thin_Q();
        Ok(Self { columns, slopes, qr, thin })
    }

    /// The first column that the ones before it explain.
    pub fn dependent(&self) -> Option<usize> {
        let upper = self.qr.thin_R();
        (0..self.columns.ncols()).find(|&column| {
            let norm = self.columns.col(column).norm_l2();
            upper[(column, column)].abs() <= DEPENDENT * norm || norm == 0.0
        })
    }

    /// Gains with the least squares.
    pub fn gains(&self, values: MatRef<'_, f64>) -> Mat<f64> {
        let mut gains = self.thin.transpose() * values;
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(
            self.qr.thin_R(),
            gains.as_mut(),
            faer::Par::Seq,
        );
        gains
    }

    /// What columns do not explain of vectors.
    pub fn rest(&self, vectors: Mat<f64>) -> Mat<f64> {
        let explained = &self.thin * (self.thin.transpose() * &vectors);
        vectors - explained
    }
}

/// Puts the terms at the times of one run where they belong.
fn of_run(
    log: &SensorLog,
    structure: &Structure,
    logarithms: &[f64],
    times: &[f64],
    run: usize,
    mut put: impl FnMut(usize, Response),
) -> Result<()> {
    for (input, sensor) in structure.inputs.iter().enumerate() {
        for (index, logarithm) in logarithms.iter().enumerate() {
            put(structure.gain(input, index), Response::new(log, *sensor, logarithm.exp(), times)?);
        }
    }
    let own = structure.inputs.len() * structure.time_constants;
    for (place, sensor) in structure.at_once.iter().enumerate() {
        let values = times.iter().map(|time| log.at(*sensor, *time)).collect::<Result<Vec<f64>>>()?;
        put(own + place, Response { slopes: vec![0.0; values.len()], values });
    }
    if structure.starts_warm {
        for (index, logarithm) in logarithms.iter().enumerate() {
            let place = structure.of_any_run() + run * structure.time_constants + index;
            put(place, Response::of_beginning(log, logarithm.exp(), times));
        }
    }
    Ok(())
}
