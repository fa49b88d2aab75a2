//! A solver to compare with: linear least squares held in memory, refined until the coefficients are right to working
//! precision.
//!
//! Plain QR loses as many digits as the condition number has, and its square counts where residuals are large. Refinement of
//! coefficients and residuals together (Björck 1967), with what is left of the equations summed in doubled precision, gives
//! them back as long as the condition number is below 1e16. The iteration of `abbe_numerics::solve` does not do this: its
//! residuals come from a model that has rounding of its own.

use faer::Mat;
use faer::linalg::solvers::Qr;

/// Rows of known functions, each entry in one part or in two that are added up.
#[derive(Debug, Clone)]
pub struct DesignMatrix {
    entries: Mat<f64>,
    /// What the entries leave out, as powers of a number that were rounded do.
    rest: Option<Mat<f64>>,
}

impl DesignMatrix {
    /// Rows of the same length.
    pub fn new(rows: &[Vec<f64>]) -> Self {
        Self { entries: matrix(rows), rest: None }
    }

    /// Rows whose entries are `rows` + `rest`, to twice the digits.
    pub fn doubled(rows: &[Vec<f64>], rest: &[Vec<f64>]) -> Self {
        Self { entries: matrix(rows), rest: Some(matrix(rest)) }
    }

    /// Adds `factor` times an entry.
    fn add(&self, row: usize, column: usize, factor: f64, sum: &mut Doubled) {
        sum.add_product(self.entries[(row, column)], factor);
        if let Some(rest) = &self.rest {
            sum.add_product(rest[(row, column)], factor);
        }
    }
}

fn matrix(rows: &[Vec<f64>]) -> Mat<f64> {
    Mat::from_fn(rows.len(), rows.first().map_or(0, Vec::len), |row, column| rows[row][column])
}

/// A sum in doubled precision (Dekker 1971; Ogita, Rump and Oishi 2005).
#[derive(Debug, Clone, Copy, Default)]
struct Doubled {
    high: f64,
    low: f64,
}

impl Doubled {
    fn add(&mut self, value: f64) {
        let sum = self.high + value;
        let part = sum - self.high;
        self.low += (self.high - (sum - part)) + (value - part);
        self.high = sum;
    }

    fn add_product(&mut self, a: f64, b: f64) {
        let product = a * b;
        self.add(product);
        self.low += a.mul_add(b, -product);
    }

    fn value(self) -> f64 {
        self.high + self.low
    }
}

/// The least squares coefficients of a design, and what they leave.
#[derive(Debug, Clone)]
pub struct LinearFit {
    /// The coefficients.
    pub values: Vec<f64>,
    /// Right side minus fit.
    pub residuals: Vec<f64>,
    /// Leverage of every row: how much of its own fitted value comes from itself, 0 to 1.
    pub leverages: Vec<f64>,
    /// Size of the last correction relative to the coefficients: about what these are uncertain by from rounding.
    pub last_correction: f64,
    /// Inverse of the triangular factor.
    inverse: Mat<f64>,
}

/// Most corrections; each gains as many digits as the condition number leaves.
const CORRECTIONS: usize = 30;

/// Solves `design x = right` in the least squares sense. None with fewer rows than columns, or columns of which one follows from
/// the others to within rounding.
pub fn fit_linear(design: &DesignMatrix, right: &[f64]) -> Option<LinearFit> {
    let (m, n) = (design.entries.nrows(), design.entries.ncols());
    if m < n || right.len() != m {
        return None;
    }
    // Columns of norm 1, by powers of two: nothing is rounded, and rank can be judged.
    let scale: Vec<f64> = (0..n).map(|column| power_of_two(design.entries.col(column).norm_l2())).collect();
    let scaled = Mat::from_fn(m, n, |row, column| design.entries[(row, column)] / scale[column]);
    let factor = Qr::new(scaled.as_ref());
    let (q, r) = (factor.compute_thin_Q(), factor.thin_R().to_owned());
    let counts = |k: usize| r[(k, k)].abs() > f64::EPSILON * n as f64;
    if !(0..n).all(counts) {
        return None;
    }
    let (mut x, mut residuals) = (vec![0.0; n], vec![0.0; m]);
    let (mut f, mut g) = (right.to_vec(), vec![0.0; n]);
    let mut last_correction = f64::INFINITY;
    for _ in 0..CORRECTIONS {
        // Corrections of the residuals and the coefficients (columns scaled): dr + J dx = f, J^T dr = g.
        let z = transposed_solve(&r, &g);
        let along: Vec<f64> = (0..n).map(|k| (0..m).map(|row| q[(row, k)] * f[row]).sum()).collect();
        let step = solve_upper(&r, along.iter().zip(&z).map(|(along, z)| along - z).collect());
        for row in 0..m {
            let inside: f64 = (0..n).map(|k| q[(row, k)] * (z[k] - along[k])).sum();
            residuals[row] += f[row] + inside;
        }
        x.iter_mut().zip(step.iter().zip(&scale)).for_each(|(x, (step, scale))| *x += step / scale);
        let size = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0_f64, |size, value| size.max(value.abs()));
        let of_all = size(&mut x.iter().zip(&scale).map(|(x, scale)| x * scale));
        let correction = size(&mut step.iter().copied()) / of_all;
        if !correction.is_finite() {
            return (of_all == 0.0).then(|| finish(x, residuals, 0.0, &q, &r, &scale));
        }
        let done = correction <= 0.5 * f64::EPSILON || correction > 0.5 * last_correction;
        last_correction = correction;
        if done {
            break;
        }
        for row in 0..m {
            let mut sum = Doubled::default();
            sum.add(right[row]);
            sum.add(-residuals[row]);
            (0..n).for_each(|column| design.add(row, column, -x[column], &mut sum));
            f[row] = sum.value();
        }
        for (column, g) in g.iter_mut().enumerate() {
            let mut sum = Doubled::default();
            (0..m).for_each(|row| design.add(row, column, -residuals[row], &mut sum));
            *g = sum.value() / scale[column];
        }
    }
    x.iter().all(|value| value.is_finite()).then(|| finish(x, residuals, last_correction, &q, &r, &scale))
}

fn finish(
    values: Vec<f64>,
    residuals: Vec<f64>,
    last_correction: f64,
    q: &Mat<f64>,
    r: &Mat<f64>,
    scale: &[f64],
) -> LinearFit {
    let n = values.len();
    let unit = |column: usize| (0..n).map(|row| f64::from(row == column)).collect();
    let columns: Vec<Vec<f64>> = (0..n).map(|column| solve_upper(r, unit(column))).collect();
    let leverages = (0..q.nrows()).map(|row| (0..n).map(|k| q[(row, k)] * q[(row, k)]).sum());
    LinearFit {
        leverages: leverages.collect(),
        inverse: Mat::from_fn(n, n, |row, column| columns[column][row] / scale[row]),
        values,
        residuals,
        last_correction,
    }
}

impl LinearFit {
    /// Rows minus coefficients.
    pub fn degrees_of_freedom(&self) -> usize {
        self.residuals.len() - self.values.len()
    }

    /// Sum of squares of the residuals.
    pub fn cost(&self) -> f64 {
        self.residuals.iter().map(|residual| residual * residual).sum()
    }

    /// Variance of one row, from the residuals; NaN without degrees of freedom.
    pub fn variance(&self) -> f64 {
        self.cost() / self.degrees_of_freedom() as f64
    }

    /// Standard uncertainty of every coefficient.
    pub fn standard_uncertainties(&self) -> Vec<f64> {
        let n = self.values.len();
        let square = |row: usize| (0..n).map(|k| self.inverse[(row, k)] * self.inverse[(row, k)]).sum::<f64>();
        (0..n).map(|row| (self.variance() * square(row)).sqrt()).collect()
    }

    /// The fitted value of a row of the functions, and its standard uncertainty: times a coverage factor for these degrees of
    /// freedom, the half width of the confidence band of the curve there.
    pub fn at(&self, row: &[f64]) -> (f64, f64) {
        let value = row.iter().zip(&self.values).map(|(entry, value)| entry * value).sum();
        let n = self.values.len();
        let along = |k: usize| (0..n).map(|j| row[j] * self.inverse[(j, k)]).sum::<f64>();
        let leverage: f64 = (0..n).map(|k| along(k) * along(k)).sum();
        (value, (self.variance() * leverage).sqrt())
    }
}

/// The power of two next to a norm; 1 if it is zero.
fn power_of_two(norm: f64) -> f64 {
    if norm > 0.0 && norm.is_finite() { norm.log2().round().exp2() } else { 1.0 }
}

fn solve_upper(r: &Mat<f64>, mut right: Vec<f64>) -> Vec<f64> {
    for row in (0..right.len()).rev() {
        right[row] /= r[(row, row)];
        for above in 0..row {
            right[above] -= r[(above, row)] * right[row];
        }
    }
    right
}

fn transposed_solve(r: &Mat<f64>, right: &[f64]) -> Vec<f64> {
    let mut solved = right.to_vec();
    for row in 0..solved.len() {
        let before: f64 = (0..row).map(|column| r[(column, row)] * solved[column]).sum();
        solved[row] = (solved[row] - before) / r[(row, row)];
    }
    solved
}
