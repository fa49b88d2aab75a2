//! Proves nothing by itself: least squares problems made of numbers that look random and are the same in every run.

use abbe_numerics::{Accumulator, Factor, LeastSquares};

/// splitmix64.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5851_f42d_4c95_7f2d)
    }

    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Between -1 and 1.
    pub fn signed(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    /// As good as normal, of standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.signed()).sum::<f64>() / 2.0
    }

    pub fn below(&mut self, count: usize) -> usize {
        (self.bits() % count as u64) as usize
    }

    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.below(i + 1));
        }
    }
}

pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}

/// A linear problem: rows of J, and r.
#[derive(Clone)]
pub struct Linear {
    pub rows: Vec<Vec<f64>>,
    pub residuals: Vec<f64>,
}

impl Linear {
    pub fn random(random: &mut Random, rows: usize, unknowns: usize) -> Self {
        let mut row = |_| (0..unknowns).map(|_| random.signed()).collect();
        let rows: Vec<Vec<f64>> = (0..rows).map(&mut row).collect();
        let residuals = rows.iter().map(|_| random.signed()).collect();
        Self { rows, residuals }
    }

    pub fn unknowns(&self) -> usize {
        self.rows[0].len()
    }

    pub fn column(&self, index: usize) -> Vec<f64> {
        self.rows.iter().map(|row| row[index]).collect()
    }

    pub fn scale_columns(&mut self, by: &[f64]) {
        for row in &mut self.rows {
            row.iter_mut().zip(by).for_each(|(value, by)| *value *= by);
        }
    }

    /// `J x`.
    pub fn apply(&self, x: &[f64]) -> Vec<f64> {
        self.rows.iter().map(|row| dot(row, x)).collect()
    }

    /// Factorised with room for about `hint` rows at a time.
    pub fn factor(&self, hint: usize) -> Factor {
        let mut accumulator = Accumulator::new(self.unknowns(), hint);
        for (row, residual) in self.rows.iter().zip(&self.residuals) {
            accumulator.push(row, *residual, 1.0);
        }
        accumulator.finish()
    }
}

/// Residuals and the rows of their derivatives.
pub type Linearised = (Vec<f64>, Vec<Vec<f64>>);

/// A problem given by a function: residuals and derivatives row by row at some unknowns.
pub struct Given<F> {
    pub unknowns: usize,
    pub rows: usize,
    pub at: F,
}

impl<F: Fn(&[f64]) -> Linearised> LeastSquares for Given<F> {
    type Error = std::convert::Infallible;

    fn unknowns(&self) -> usize {
        self.unknowns
    }

    fn rows(&self) -> usize {
        self.rows
    }

    fn linearise(&self, x: &[f64], sink: &mut dyn FnMut(usize, &[f64], &[f64])) -> Result<(), Self::Error> {
        let (residuals, rows) = (self.at)(x);
        // In blocks of several sizes, as problems come.
        let (mut first, mut size) = (0, 1);
        while first < residuals.len() {
            let end = (first + size).min(residuals.len());
            sink(first, &residuals[first..end], &rows[first..end].concat());
            (first, size) = (end, size + 3);
        }
        Ok(())
    }
}

/// A straight line through points: unknowns are offset and slope.
pub fn line(x: &[f64], y: &[f64]) -> Linear {
    Linear { rows: x.iter().map(|x| vec![1.0, *x]).collect(), residuals: y.iter().map(|y| -y).collect() }
}

/// A linear problem as one to iterate on.
pub fn given(linear: &Linear) -> Given<impl Fn(&[f64]) -> Linearised + '_> {
    Given {
        unknowns: linear.unknowns(),
        rows: linear.rows.len(),
        at: |x: &[f64]| {
            let residuals = linear.apply(x).iter().zip(&linear.residuals).map(|(a, b)| a + b).collect();
            (residuals, linear.rows.clone())
        },
    }
}
