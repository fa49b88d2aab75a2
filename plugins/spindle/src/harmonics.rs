//! Harmonics of readings by least squares.
//!
//! Sums over the readings of a run give the normal equations (`bins.rs`), which lose digits where angles hardly tell harmonics apart:
//! there the rows are read once more, and factored.

use std::cmp::Ordering;
use std::collections::BTreeSet;
use std::f64::consts::TAU;

use abbe_core::{Error, Passes, Result};
use abbe_numerics::{Accumulator, Factor, Spectrum};
use abbe_standards::spindle::Harmonics;
use nalgebra::{DMatrix, DVector};

use crate::bins::Moments;
use crate::readings::Expected;
use crate::run::Run;
use crate::stretches::{Stretch, each_stretch};

/// What is fitted to every sensor: a constant, cosine and sine of each order, and a straight line in time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Basis {
    /// The highest order.
    pub highest: usize,
    /// Middle and half of the time, s, where there is a line.
    drift: Option<(f64, f64)>,
}

impl Basis {
    /// Of a run.
    pub fn new(run: &Run, highest: usize, linear_drift: bool) -> Self {
        let [first, last] = run.times;
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

    /// The value of the line at a time; zero where there is none.
    pub fn line_at(&self, time: f64) -> f64 {
        self.drift.map_or(0.0, |(middle, half)| (time - middle) / half)
    }

    fn row(&self, angle: f64, time: f64, row: &mut [f64]) {
        let (sin, cos) = angle.sin_cos();
        row[0] = 1.0;
        let (mut c, mut s) = (1.0, 0.0);
        for order in 1..=self.highest {
            (c, s) = (c * cos - s * sin, s * cos + c * sin);
            (row[Self::cos(order)], row[Self::sin(order)]) = (c, s);
        }
        if let Some((line, _)) = self.line() {
            row[line] = self.line_at(time);
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
pub struct Solved {
    /// What was fitted.
    pub basis: Basis,
    /// Coefficients of each sensor, mm.
    pub values: Vec<Vec<f64>>,
    /// The inverse of the normal equations.
    pub inverse: DMatrix<f64>,
    /// Condition with columns of norm 1.
    pub condition: f64,
}

/// Sums over readings while a run is read.
pub struct Gathered {
    moments: Moments,
    highest: usize,
    /// The time that others are counted from.
    time: f64,
    sums: Sums,
}

/// Sums over all readings of a run, for its normal equations.
#[derive(Default)]
pub struct Sums {
    /// With harmonics: of 1, of the time, and of the readings of sensors.
    one: Harmonics,
    time: Harmonics,
    readings: Vec<Harmonics>,
    /// The readings that others are counted from: a large constant costs no digits.
    first: Vec<f64>,
    /// Sum of the squares of times.
    squares: f64,
    /// Sums of times times the readings of sensors.
    times_readings: Vec<f64>,
}

/// Places of quantities among the moments: 1, the time, then the readings of sensors.
const ONE: usize = 0;
const TIME: usize = 1;
const READINGS: usize = 2;

impl Gathered {
    /// Without readings, of the run that a stretch begins.
    pub fn new(stretch: &Stretch<'_>, highest: usize) -> Self {
        let first: Vec<f64> = stretch.readings.iter().map(|readings| readings[0]).collect();
        let moments = Moments::new(2 * highest, READINGS + first.len());
        let sums = Sums { times_readings: vec![0.0; first.len()], first, ..Sums::default() };
        Self { moments, highest, time: stretch.times[0], sums }
    }

    /// Adds readings.
    pub fn add(&mut self, stretch: &Stretch<'_>) {
        let sums = &mut self.sums;
        let mut quantities = vec![1.0; READINGS + sums.first.len()];
        for (index, (angle, time)) in stretch.angles.iter().zip(stretch.times).enumerate() {
            quantities[TIME] = time - self.time;
            sums.squares += quantities[TIME] * quantities[TIME];
            let sensors = stretch.readings.iter().zip(&sums.first);
            for (place, (readings, first)) in sensors.enumerate() {
                let reading = readings[index] - first;
                quantities[READINGS + place] = reading;
                sums.times_readings[place] += quantities[TIME] * reading;
            }
            self.moments.push(*angle, &quantities);
        }
    }

    /// The sums, at the end of the run.
    pub fn sums(self) -> Sums {
        let Self { moments, highest, sums, .. } = self;
        let readings = 0..sums.first.len();
        Sums {
            one: moments.with_harmonics(ONE, 2 * highest),
            time: moments.with_harmonics(TIME, highest),
            readings: readings.map(|sensor| moments.with_harmonics(READINGS + sensor, highest)).collect(),
            ..sums
        }
    }
}

impl Sums {
    /// The matrix of the normal equations.
    fn matrix(&self, basis: &Basis) -> DMatrix<f64> {
        let one = &self.one;
        let sine = |order: isize| one.sin[order.unsigned_abs()] * order.signum() as f64;
        let product = |row: usize, column: usize| {
            // Orders, and whether of a sine; the constant is a cosine of order 0.
            let [(k, is_sin), (l, is_other)] =
                [row, column].map(|place| (place.div_ceil(2) as isize, place > 0 && place % 2 == 0));
            let (apart, both) = ((k - l).unsigned_abs(), (k + l) as usize);
            0.5 * match (is_sin, is_other) {
                (false, false) => one.cos[apart] + one.cos[both],
                (true, true) => one.cos[apart] - one.cos[both],
                (true, false) => sine(k + l) + sine(k - l),
                (false, true) => sine(k + l) - sine(k - l),
            }
        };
        let mut matrix = DMatrix::zeros(basis.unknowns(), basis.unknowns());
        for row in 0..=2 * basis.highest {
            for column in 0..=row {
                matrix[(row, column)] = product(row, column);
                matrix[(column, row)] = matrix[(row, column)];
            }
        }
        if let Some((line, half)) = basis.line() {
            // The line is (time - half) / half of times from the first one.
            for place in 0..line {
                let [time, plain] = [&self.time, one].map(|sums| part(sums, place));
                matrix[(line, place)] = (time - half * plain) / half;
                matrix[(place, line)] = matrix[(line, place)];
            }
            let (times, count) = (self.time.cos[0], one.cos[0]);
            matrix[(line, line)] = (self.squares - 2.0 * half * times + half * half * count) / (half * half);
        }
        matrix
    }

    /// The right-hand side of a sensor.
    fn right_side(&self, basis: &Basis, sensor: usize) -> DVector<f64> {
        let read = &self.readings[sensor];
        DVector::from_fn(basis.unknowns(), |place, _| match basis.line() {
            Some((line, half)) if place == line => (self.times_readings[sensor] - half * read.cos[0]) / half,
            _ => part(read, place),
        })
    }

    /// The harmonics of the run; none where its angles hardly tell them apart, or not at all.
    pub fn solve(&self, basis: Basis) -> Option<Solved> {
        let matrix = self.matrix(&basis);
        let scale: Vec<f64> = matrix.diagonal().iter().map(|square| square.sqrt().recip()).collect();
        let least = matrix.diagonal().min();
        if !(least > matrix[(0, 0)] * HARDLY && matrix.iter().all(|value| value.is_finite())) {
            return None;
        }
        let scaled = DMatrix::from_fn(scale.len(), scale.len(), |row, column| {
            scale[row] * matrix[(row, column)] * scale[column]
        });
        let parts = scaled.symmetric_eigen();
        let (most, least) = (parts.eigenvalues.max(), parts.eigenvalues.min());
        if least.partial_cmp(&(HARDLY * most)) != Some(Ordering::Greater) {
            return None;
        }
        let by = DMatrix::from_fn(scale.len(), scale.len(), |row, column| {
            scale[row] * parts.eigenvectors[(row, column)] / parts.eigenvalues[column].sqrt()
        });
        let inverse = &by * by.transpose();
        let values = self.first.iter().enumerate().map(|(sensor, first)| {
            let mut values: Vec<f64> = (&inverse * self.right_side(&basis, sensor)).iter().copied().collect();
            values[0] += first;
            values
        });
        Some(Solved { basis, values: values.collect(), condition: (most / least).sqrt(), inverse })
    }
}

/// The sum at a place of the basis.
fn part(sums: &Harmonics, place: usize) -> f64 {
    let order = place.div_ceil(2);
    if place > 0 && place.is_multiple_of(2) { sums.sin[order] } else { sums.cos[order] }
}

/// Eigenvalues of the scaled normal equations below this part of the largest cost too many digits: a condition of 100.
const HARDLY: f64 = 1e-4;

/// Singular values below this part of the largest are none: what they tell would be noise.
const RANK_TOLERANCE: f64 = 1e-6;

/// Fails for fewer readings than unknowns, and for what the second look refuses.
pub fn enough(run: &Run, basis: &Basis) -> Result<()> {
    let (count, unknowns) = (run.count, basis.unknowns());
    if run.whole_turns() < 2 || run.times[1] <= run.times[0] {
        return Err(run.error("there are no two turns"));
    }
    if count > unknowns {
        return Ok(());
    }
    let message = format!("{count} readings cannot tell {unknowns} unknowns of each sensor");
    Err(run.error(message).help("read more often, or choose fewer `harmonics`"))
}

/// The readings of a run, to be factored.
struct Rows<'a> {
    run: &'a Run,
    basis: Basis,
    sensors: Vec<Accumulator>,
    /// Different angles of a turn in parts of 1e-6 rad, one more than tell all harmonics at most.
    angles: BTreeSet<i64>,
}

/// The harmonics of some runs, by factors of all their readings: each of them, or why its angles do not tell them.
pub fn factored(
    data: &[&dyn Passes],
    expected: &Expected<'_>,
    runs: &[(usize, &Run, Basis)],
) -> Result<Vec<Result<Solved>>> {
    let (mut solved, mut present): (Vec<Result<Solved>>, Option<Rows<'_>>) = (Vec::new(), None);
    each_stretch(data, expected, &mut |stretch| {
        if stretch.first == 0 {
            solved.extend(present.take().map(Rows::solve));
            let own = runs.iter().find(|(number, ..)| *number == stretch.run);
            present = own.map(|(_, run, basis)| Rows::new(run, *basis));
        }
        present.iter_mut().for_each(|rows| rows.add(stretch));
        Ok(())
    })?;
    solved.extend(present.map(Rows::solve));
    Ok(solved)
}

impl<'a> Rows<'a> {
    fn new(run: &'a Run, basis: Basis) -> Self {
        let sensors = run.readings.iter().map(|_| Accumulator::new(basis.unknowns(), run.count));
        Self { run, basis, sensors: sensors.collect(), angles: BTreeSet::new() }
    }

    fn add(&mut self, stretch: &Stretch<'_>) {
        let mut row = vec![0.0; self.basis.unknowns()];
        for (index, (angle, time)) in stretch.angles.iter().zip(stretch.times).enumerate() {
            self.basis.row(*angle, *time, &mut row);
            for ((rows, readings), first) in self.sensors.iter_mut().zip(stretch.readings).zip(&self.run.readings) {
                rows.push(&row, first - readings[index], 1.0);
            }
            if self.angles.len() <= 2 * self.basis.highest {
                self.angles.insert((angle.rem_euclid(TAU) * 1e6).round() as i64 % (TAU * 1e6).round() as i64);
            }
        }
    }

    fn solve(self) -> Result<Solved> {
        let Self { run, basis, sensors, angles } = self;
        let unknowns = basis.unknowns();
        let factors: Vec<Factor> = sensors.into_iter().map(Accumulator::finish).collect();
        let Some(factor) = factors.first() else { return Err(Error::usage("at least one sensor was expected")) };
        // A column of rounding is none: scaled to norm 1 it would look like one.
        let least = RANK_TOLERANCE * (run.count as f64).sqrt();
        let zero: Vec<bool> = factor.norms().iter().map(|norm| *norm < least).collect();
        let spectrum = factor.with_zeros(&zero).spectrum();
        let rank = spectrum.singular_values().rank(RANK_TOLERANCE);
        if rank < unknowns {
            return Err(aliases(run, &basis, &spectrum, rank, angles.len()));
        }
        let covariance = factor.covariance_root(rank).covariance();
        let inverse = DMatrix::from_fn(unknowns, unknowns, |row, column| covariance[row][column]);
        let values = factors.iter().zip(&run.readings).map(|(factor, first)| {
            let mut found = factor.step().ok_or_else(|| run.error("its harmonics cannot be told apart"))?;
            found[0] += first;
            Ok(found)
        });
        let values = values.collect::<Result<_>>()?;
        Ok(Solved { basis, values, inverse, condition: spectrum.singular_values().condition(rank) })
    }
}

/// The error for harmonics that the angles of the readings do not tell apart.
fn aliases(run: &Run, basis: &Basis, spectrum: &Spectrum, rank: usize, count: usize) -> Error {
    let lost = spectrum.null_basis(rank);
    let told = lost.iter().take(3).map(|(_, direction)| {
        let names = direction.iter().enumerate().filter(|(_, value)| **value != 0.0);
        names.map(|(place, _)| basis.name(place)).collect::<Vec<_>>().join(" and ")
    });
    let told = told.collect::<Vec<_>>().join("; ");
    let more = if lost.len() > 3 { "; ..." } else { "" };
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
