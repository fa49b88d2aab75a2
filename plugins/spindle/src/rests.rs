//! What harmonics leave of the readings of a run: residuals, the scatter of single turns, and what single readings tell.

use abbe_standards::spindle::{Harmonics, Sectors};
use nalgebra::{DMatrix, DVector};

use crate::bins::Table;
use crate::doubts::Creeping;
use crate::harmonics::{Basis, Solved};
use crate::parameters::Sizes;
use crate::run::Run;
use crate::sensors::along_rotating;
use crate::stretches::Stretch;

/// Harmonics of a run with their covariance.
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

/// What is looked at in residuals.
#[derive(Debug, Clone, Copy)]
pub struct Wanted {
    /// Sectors of a turn.
    pub sectors: usize,
    /// Angle from the first to the second sensor, where they are a pair, rad.
    pub between: Option<f64>,
}

/// What harmonics leave of a run.
pub struct Left {
    /// Ranges by sectors, of each sensor.
    pub sectors: Vec<Sectors>,
    /// The same of a pair, along the direction that turns with the spindle.
    pub rotating: Sectors,
    /// Mean squares of the residuals of each sensor, mm².
    pub squares: Vec<f64>,
    /// The fundamental of the first sensor at the begin and at the end.
    pub creeping: Creeping,
}

/// The residuals of a run while it is read.
pub struct Rests<'a> {
    solved: &'a Solved,
    table: Table,
    scores: Scores,
    wanted: Wanted,
    left: Left,
}

impl<'a> Rests<'a> {
    /// Without readings.
    pub fn new(run: &Run, solved: &'a Solved, wanted: Wanted) -> Self {
        let sensors = solved.values.len();
        let function = |values: &Vec<f64>| {
            let mut function = Harmonics::zero(solved.basis.highest);
            function.cos[0] = values[0];
            for order in 1..=solved.basis.highest {
                function.cos[order] = values[Basis::cos(order)];
                function.sin[order] = values[Basis::sin(order)];
            }
            function
        };
        Self {
            solved,
            table: Table::new(&solved.values.iter().map(function).collect::<Vec<_>>()),
            scores: Scores::new(&solved.basis, sensors),
            wanted,
            left: Left {
                sectors: vec![Sectors::new(wanted.sectors); sensors],
                rotating: Sectors::new(wanted.sectors),
                squares: vec![0.0; sensors],
                creeping: Creeping::new(run.whole_turns()),
            },
        }
    }

    /// Adds readings; `sizes` gets all residuals.
    pub fn add(&mut self, run: &Run, stretch: &Stretch<'_>, sizes: &mut Sizes) {
        let basis = &self.solved.basis;
        let lines: Vec<f64> = match basis.line() {
            Some((line, _)) => self.solved.values.iter().map(|values| values[line]).collect(),
            None => vec![0.0; self.solved.values.len()],
        };
        let Left { sectors, rotating, squares, creeping } = &mut self.left;
        let mut rest = vec![0.0; lines.len()];
        for (index, (&angle, &time)) in stretch.angles.iter().zip(stretch.times).enumerate() {
            let (fitted, line) = (self.table.at(angle), basis.line_at(time));
            let sector = sectors[0].sector(angle);
            for (sensor, rest) in rest.iter_mut().enumerate() {
                *rest = stretch.readings[sensor][index] - fitted[sensor] - lines[sensor] * line;
                squares[sensor] += *rest * *rest;
                sectors[sensor].push_in(sector, *rest);
                sizes.push(*rest);
            }
            let (sin, cos) = angle.sin_cos();
            if let Some(between) = self.wanted.between {
                rotating.push_in(sector, along_rotating(&rest, between, [cos, sin]));
            }
            creeping.push((angle - run.angles[0]).abs(), stretch.readings[0][index] - run.readings[0], [cos, sin]);
            self.scores.push(run.turn(angle), [cos, sin], line, &rest);
        }
    }

    /// The harmonics with their covariance, and what they leave. The sum of all scores would be zero but for rounding, which it takes off.
    pub fn finish(self, run: &Run) -> (Fitted, Left) {
        let Self { scores, mut left, .. } = self;
        let Solved { basis, values, inverse, condition } = self.solved;
        let (squares, sums, unknowns) = scores.finish(basis, run.whole_turns());
        left.squares.iter_mut().for_each(|square| *square /= run.count as f64);
        let mut values = values.clone();
        for (values, sums) in values.iter_mut().zip(&sums) {
            values.iter_mut().zip((inverse * sums).iter()).for_each(|(value, step)| *value += step);
        }
        let mut covariance = DMatrix::zeros(squares.nrows(), squares.nrows());
        for one in 0..values.len() {
            for other in 0..=one {
                let at = (one * unknowns, other * unknowns);
                let block = inverse * squares.view(at, (unknowns, unknowns)) * inverse;
                covariance.view_mut(at, (unknowns, unknowns)).copy_from(&block);
                if one != other {
                    covariance.view_mut((at.1, at.0), (unknowns, unknowns)).copy_from(&block.transpose());
                }
            }
        }
        (Fitted { basis: *basis, values, covariance, condition: *condition }, left)
    }
}

/// Orders that are found from those four before them: they wait for nothing else.
const STRIDE: usize = 4;

/// Turns whose scores are multiplied together.
const TOGETHER: usize = 32;

/// Sums of squares and products of the scores of single turns: of what each turn would change.
///
/// The covariance is that of the mean of single turns: their scores scatter about zero, and the law of propagation takes this to the
/// coefficients (Liang & Zeger 1986). On a grid of angles it is the scatter of harmonics of single turns over the root of their number.
/// What swings with a frequency of its own is in it.
struct Scores {
    /// Cosines, sines, 1, and the line: a multiple of [`STRIDE`] of each of the first two.
    row: Vec<f64>,
    orders: usize,
    turn: usize,
    /// The scores of the present turn, sensor after sensor.
    score: Vec<f64>,
    /// Those of turns before it that are not in the squares, a column each.
    waiting: DMatrix<f64>,
    columns: usize,
    squares: DMatrix<f64>,
    sums: Vec<f64>,
}

impl Scores {
    fn new(basis: &Basis, sensors: usize) -> Self {
        let orders = basis.highest.next_multiple_of(STRIDE);
        let size = sensors * (2 * orders + 2);
        Self {
            row: vec![1.0; 2 * orders + 2],
            orders,
            turn: 0,
            score: vec![0.0; size],
            waiting: DMatrix::zeros(size, TOGETHER),
            columns: 0,
            squares: DMatrix::zeros(size, size),
            sums: vec![0.0; size],
        }
    }

    /// Adds the residuals of a reading; `line` is the value of the line there.
    fn push(&mut self, turn: usize, [cos, sin]: [f64; 2], line: f64, rest: &[f64]) {
        if turn != self.turn {
            self.end_turn();
            self.turn = turn;
        }
        let (cosines, others) = self.row.split_at_mut(self.orders);
        let (sines, constants) = others.split_at_mut(self.orders);
        let times = |[c, s]: [f64; 2], [by_c, by_s]: [f64; 2]| [c * by_c - s * by_s, s * by_c + c * by_s];
        let mut present = [[cos, sin]; STRIDE];
        for order in 1..STRIDE {
            present[order] = times(present[order - 1], [cos, sin]);
        }
        let by = present[STRIDE - 1];
        for (cosines, sines) in cosines.chunks_exact_mut(STRIDE).zip(sines.chunks_exact_mut(STRIDE)) {
            for (place, own) in present.iter_mut().enumerate() {
                (cosines[place], sines[place]) = (own[0], own[1]);
                *own = times(*own, by);
            }
        }
        constants[1] = line;
        for (score, rest) in self.score.chunks_exact_mut(self.row.len()).zip(rest) {
            score.iter_mut().zip(&self.row).for_each(|(score, row)| *score += row * rest);
        }
    }

    fn end_turn(&mut self) {
        self.sums.iter_mut().zip(&self.score).for_each(|(sum, score)| *sum += score);
        self.waiting.column_mut(self.columns).copy_from_slice(&self.score);
        self.score.fill(0.0);
        self.columns += 1;
        if self.columns == TOGETHER {
            self.multiply();
        }
    }

    fn multiply(&mut self) {
        let own = self.waiting.columns(0, self.columns);
        self.squares.gemm(1.0, &own, &own.transpose(), 1.0);
        self.columns = 0;
    }

    /// Sum of squares and products as coefficients are ordered, the sums of each sensor, and the number of its coefficients.
    fn finish(mut self, basis: &Basis, whole: usize) -> (DMatrix<f64>, Vec<DVector<f64>>, usize) {
        self.end_turn();
        self.multiply();
        let unknowns = basis.unknowns();
        let own = |place: usize| match (basis.line(), place) {
            (_, 0) => 2 * self.orders,
            (Some((line, _)), _) if place == line => 2 * self.orders + 1,
            (_, place) if place % 2 == 1 => place / 2,
            (_, place) => self.orders + place / 2 - 1,
        };
        let of_all = |place: usize| place / unknowns * self.row.len() + own(place % unknowns);
        let sensors = self.score.len() / self.row.len();
        let factor = whole as f64 / (whole as f64 - 1.0);
        let size = sensors * unknowns;
        let squares = DMatrix::from_fn(size, size, |row, column| factor * self.squares[(of_all(row), of_all(column))]);
        let sums = (0..sensors)
            .map(|sensor| DVector::from_fn(unknowns, |place, _| self.sums[of_all(sensor * unknowns + place)]));
        (squares, sums.collect(), unknowns)
    }
}
