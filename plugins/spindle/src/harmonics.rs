//! Harmonics of readings by least squares, with the covariance that single turns tell.

use std::collections::BTreeSet;
use std::f64::consts::TAU;

use abbe_core::{Error, Result};
use abbe_numerics::{Accumulator, Spectrum};
use nalgebra::{DMatrix, DVector};

use crate::readings::Run;

/// What is fitted to every sensor: a constant, cosine and sine of each order, and a straight line in time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Basis {
    /// The highest order.
    pub highest: usize,
    /// Middle and half of the time, s, where there is a line.
    drift: Option<(f64, f64)>,
}

impl Basis {
    fn new(run: &Run<'_>, highest: usize, linear_drift: bool) -> Self {
        let (first, last) = (run.times[0], run.times[run.times.len() - 1]);
        Self { highest, drift: linear_drift.then_some((0.5 * (first + last), 0.5 * (last - first))) }
    }

    /// Number of unknowns of a sensor.
    pub fn unknowns(&self) -> usize {
        1 + 2 * self.highest + usize::from(self.drift.is_some())
    }

    /// Place of a cosine.
    pub fn cos(order: usize) -> usize {
        2 * order - 1
    }

    /// Place of a sine.
    pub fn sin(order: usize) -> usize {
        2 * order
    }

    /// Place of the line, and the time (s) in which it rises by its coefficient.
    pub fn line(&self) -> Option<(usize, f64)> {
        self.drift.map(|(_, half)| (self.unknowns() - 1, half))
    }

    fn row(&self, angle: f64, time: f64, row: &mut [f64]) {
        let (sin, cos) = angle.sin_cos();
        row[0] = 1.0;
        let (mut c, mut s) = (1.0, 0.0);
        for order in 1..=self.highest {
            (c, s) = (c * cos - s * sin, s * cos + c * sin);
            (row[Self::cos(order)], row[Self::sin(order)]) = (c, s);
        }
        if let Some((middle, half)) = self.drift {
            row[1 + 2 * self.highest] = (time - middle) / half;
        }
    }

    fn name(&self, place: usize) -> String {
        match place {
            0 => "the constant".to_owned(),
            _ if place > 2 * self.highest => "the line in time".to_owned(),
            _ if place % 2 == 1 => format!("cos {} S", place.div_ceil(2)),
            _ => format!("sin {} S", place / 2),
        }
    }
}

/// The harmonics of a run.
pub struct Fitted {
    /// What was fitted.
    pub basis: Basis,
    /// Coefficients of each sensor, mm.
    pub values: Vec<Vec<f64>>,
    /// Covariance of the coefficients, sensor after sensor, mm².
    pub covariance: DMatrix<f64>,
    /// Condition with columns of norm 1.
    pub condition: f64,
}

/// Singular values below this part of the largest are none: what they tell would be noise.
const RANK_TOLERANCE: f64 = 1e-6;

/// Fits a run.
///
/// The covariance is that of the mean of single turns: the scores of the turns, which are what each of them would change, scatter
/// about zero, and the law of propagation takes this to the coefficients (Liang & Zeger 1986). On a grid of angles it is the scatter
/// of harmonics of single turns over the root of their number. What swings with a frequency of its own is in it.
///
/// Fails for fewer readings than unknowns, and where angles do not tell harmonics apart.
pub fn fit(run: &Run<'_>, highest: usize, linear_drift: bool) -> Result<Fitted> {
    let basis = Basis::new(run, highest, linear_drift);
    let unknowns = basis.unknowns();
    let (count, sensors) = (run.angles.len(), run.readings.len());
    if count <= unknowns {
        let message = format!("{count} readings cannot tell {unknowns} unknowns of each sensor");
        return Err(run.error(message).help("read more often, or choose fewer `harmonics`"));
    }
    let mut row = vec![0.0; unknowns];
    let mut values = Vec::new();
    let mut first = None;
    for readings in &run.readings {
        let mut rows = Accumulator::new(unknowns, count);
        // Counted from the first reading, so that a large constant costs no digits.
        for (index, reading) in readings.iter().enumerate() {
            basis.row(run.angles[index], run.times[index], &mut row);
            rows.push(&row, readings[0] - reading, 1.0);
        }
        let factor = rows.finish();
        if first.is_none() {
            // A column of rounding is none: scaled to norm 1 it would look like one.
            let least = RANK_TOLERANCE * (count as f64).sqrt();
            let zero: Vec<bool> = factor.norms().iter().map(|norm| *norm < least).collect();
            let spectrum = factor.with_zeros(&zero).spectrum();
            let rank = spectrum.singular_values().rank(RANK_TOLERANCE);
            if rank < unknowns {
                return Err(aliases(run, &basis, &spectrum, rank));
            }
            let covariance = factor.covariance_root(rank).covariance();
            let inverse = DMatrix::from_fn(unknowns, unknowns, |row, column| covariance[row][column]);
            first = Some((inverse, spectrum.singular_values().condition(rank)));
        }
        let mut found = factor.step().ok_or_else(|| run.error("its harmonics cannot be told apart"))?;
        found[0] += readings[0];
        values.push(found);
    }
    let Some((inverse, condition)) = first else { return Err(Error::usage("at least one sensor was expected")) };
    let scores = scores(run, &basis, &values);
    let mut covariance = DMatrix::zeros(sensors * unknowns, sensors * unknowns);
    for one in 0..sensors {
        for other in 0..=one {
            let at = (one * unknowns, other * unknowns);
            let block = &inverse * scores.view(at, (unknowns, unknowns)) * &inverse;
            covariance.view_mut(at, (unknowns, unknowns)).copy_from(&block);
            if one != other {
                covariance.view_mut((at.1, at.0), (unknowns, unknowns)).copy_from(&block.transpose());
            }
        }
    }
    Ok(Fitted { basis, values, covariance, condition })
}

/// Sum of squares and products of the scores of single turns.
fn scores(run: &Run<'_>, basis: &Basis, values: &[Vec<f64>]) -> DMatrix<f64> {
    let (unknowns, whole) = (basis.unknowns(), run.whole_turns());
    let size = values.len() * unknowns;
    let mut squares = DMatrix::zeros(size, size);
    let mut row = vec![0.0; unknowns];
    let (mut score, mut turn) = (DVector::zeros(size), 0);
    for index in 0..run.angles.len() {
        if run.turn(index) != turn {
            squares.ger(1.0, &score, &score, 1.0);
            score.fill(0.0);
            turn = run.turn(index);
        }
        basis.row(run.angles[index], run.times[index], &mut row);
        for (sensor, values) in values.iter().enumerate() {
            let fitted: f64 = row.iter().zip(values).map(|(row, value)| row * value).sum();
            let rest = run.readings[sensor][index] - fitted;
            let own = score.as_mut_slice()[sensor * unknowns..][..unknowns].iter_mut();
            own.zip(&row).for_each(|(score, row)| *score += row * rest);
        }
    }
    squares.ger(1.0, &score, &score, 1.0);
    squares * (whole as f64 / (whole as f64 - 1.0))
}

impl Fitted {
    /// What is left of a reading, for each sensor, mm.
    pub fn each_rest(&self, run: &Run<'_>, mut look: impl FnMut(usize, &[f64])) {
        let mut row = vec![0.0; self.basis.unknowns()];
        let mut rest = vec![0.0; self.values.len()];
        for index in 0..run.angles.len() {
            self.basis.row(run.angles[index], run.times[index], &mut row);
            for ((rest, values), readings) in rest.iter_mut().zip(&self.values).zip(&run.readings) {
                *rest = readings[index] - row.iter().zip(values).map(|(row, value)| row * value).sum::<f64>();
            }
            look(index, &rest);
        }
    }
}

/// The error for harmonics that the angles of the readings do not tell apart.
fn aliases(run: &Run<'_>, basis: &Basis, spectrum: &Spectrum, rank: usize) -> Error {
    let lost = spectrum.null_basis(rank);
    let told = lost.iter().take(3).map(|(_, direction)| {
        let names = direction.iter().enumerate().filter(|(_, value)| **value != 0.0);
        names.map(|(place, _)| basis.name(place)).collect::<Vec<_>>().join(" and ")
    });
    let told = told.collect::<Vec<_>>().join("; ");
    let more = if lost.len() > 3 { "; ..." } else { "" };
    // A turn in parts of 1e-6 rad.
    let part = |angle: &f64| (angle.rem_euclid(TAU) * 1e6).round() as i64 % (TAU * 1e6).round() as i64;
    let mut places = BTreeSet::new();
    for angle in run.angles.iter() {
        places.insert(part(angle));
        if places.len() > 2 * basis.highest {
            break;
        }
    }
    let count = places.len();
    let (why, help) = if count <= 2 * basis.highest {
        let most = count.saturating_sub(1) / 2;
        (
            format!(": all turns are read at the same {count} angles, which tell {most} harmonics at most"),
            format!("choose `harmonics: {most}`, or read at other angles"),
        )
    } else {
        (String::new(), "choose fewer `harmonics`, or read all round the turn".to_owned())
    };
    run.error(format!("its angles do not tell apart {told}{more}{why}")).help(help)
}
