//! What was found: gains, uncertainties, and predictions of other runs.

use abbe_core::Result;
use abbe_numerics::Generator;
use faer::{Mat, MatRef, Side};

use crate::basis::Basis;
use crate::fit::{Fitted, Output, Readings, Search, Structure, inverse, inverse_of_upper, product};
use crate::log::SensorLog;
use crate::response::Response;

/// What each output takes from a step of the time constants, and from its own readings.
struct Parts {
    /// For each output: gains by logarithms, what gains lose when a logarithm grows.
    follow: Vec<Mat<f64>>,
    /// For each output the inverse of the triangle of its terms, and its scatter.
    roots: Vec<Mat<f64>>,
    /// Covariance of the logarithms.
    logarithms: Mat<f64>,
}

impl Search<'_> {
    /// Gains and uncertainties; the logarithms are sorted.
    pub(crate) fn all(&self) -> Result<Fitted> {
        let scatter = self.scatter()?;
        let count = self.logarithms.len();
        let normal = self.normal(&self.logarithms)?;
        // With weights that are not those of the scatter: sandwich of Huber, White.
        let bread = inverse(&normal.matrix);
        let mut meat = Mat::<f64>::zeros(count, count);
        let outputs = self.outputs.len();
        let (mut gains, mut residuals) = (vec![Vec::new(); outputs], vec![Vec::new(); outputs]);
        let mut follow = vec![Mat::zeros(0, 0); outputs];
        let mut own = vec![Mat::zeros(0, 0); outputs];
        let terms = self.structure.gains(self.logs.len());
        // Scalar products of all columns, each output by itself: (logarithms and gains) squared.
        let mut products = vec![Mat::zeros(0, 0); outputs];
        for group in &self.groups {
            let (values, basis) = self.group(group, &self.logarithms)?;
            let found = basis.gains(values.as_ref());
            let rest = &values - &basis.columns * &found;
            let roots = inverse_of_upper(basis.qr.thin_R());
            let among = basis.columns.transpose() * &basis.columns;
            for (place, &output) in group.iter().enumerate() {
                let scale = self.scales[output];
                let of_output = found.as_ref().subcols(place, 1).to_owned();
                let moved: Vec<Mat<f64>> = (0..count).map(|index| self.changed(&basis, &of_output, index)).collect();
                let relative = scatter[output] / scale;
                for row in 0..count {
                    let rest = basis.rest(moved[row].clone());
                    for column in 0..count {
                        meat[(row, column)] += relative * relative * product(&rest, &moved[column]);
                    }
                }
                follow[output] = Mat::zeros(terms, count);
                for (index, moved) in moved.iter().enumerate() {
                    let with = basis.gains(moved.as_ref());
                    (0..terms).for_each(|gain| follow[output][(gain, index)] = scale * with[(gain, 0)]);
                }
                gains[output] = (0..terms).map(|gain| scale * found[(gain, place)]).collect();
                residuals[output] = rest.col(place).iter().map(|value| scale * value).collect();
                own[output] = faer::Scale(scatter[output]) * &roots;
                products[output] = products_of(&among, &basis.columns, &moved);
            }
        }
        let parts = Parts { follow, roots: own, logarithms: &bread * meat * &bread };
        let covariance = covariance(&parts, terms);
        let uncertainty = |place: usize| covariance[(place, place)].max(0.0).sqrt();
        Ok(Fitted {
            structure: self.structure.clone(),
            time_constants: self.logarithms.iter().map(|logarithm| logarithm.exp()).collect(),
            relative_uncertainties: (0..count).map(uncertainty).collect(),
            gain_uncertainties: (0..outputs)
                .map(|output| (0..terms).map(|gain| uncertainty(count + output * terms + gain)).collect())
                .collect(),
            condition: condition(&products, count, terms),
            covariance,
            gains,
            residuals,
            scatter,
            passes: self.passes,
        })
    }
}

/// Covariance of the logarithms, then of the gains of each output: a change of the logarithms moves the gains of all outputs.
fn covariance(parts: &Parts, terms: usize) -> Mat<f64> {
    let count = parts.logarithms.nrows();
    let size = count + parts.follow.len() * terms;
    let mut moves = Mat::<f64>::zeros(size, count);
    (0..count).for_each(|index| moves[(index, index)] = 1.0);
    for (output, follow) in parts.follow.iter().enumerate() {
        moves.as_mut().subrows_mut(count + output * terms, terms).copy_from(faer::Scale(-1.0) * follow);
    }
    let mut covariance = &moves * &parts.logarithms * moves.transpose();
    for (output, root) in parts.roots.iter().enumerate() {
        let first = count + output * terms;
        let mut block = covariance.as_mut().submatrix_mut(first, first, terms, terms);
        block += root * root.transpose();
    }
    symmetric(covariance)
}

/// Rounding makes halves differ.
fn symmetric(matrix: Mat<f64>) -> Mat<f64> {
    Mat::from_fn(matrix.nrows(), matrix.ncols(), |row, column| (matrix[(row, column)] + matrix[(column, row)]) / 2.0)
}

/// Scalar products of the derivatives of one output's readings: to the logarithms, then to its gains.
fn products_of(among: &Mat<f64>, columns: &Mat<f64>, moved: &[Mat<f64>]) -> Mat<f64> {
    let count = moved.len();
    Mat::from_fn(count + among.nrows(), count + among.ncols(), |row, column| match (row < count, column < count) {
        (true, true) => product(&moved[row], &moved[column]),
        (true, false) => dot(moved[row].as_ref(), 0, columns.as_ref(), column - count),
        (false, true) => dot(moved[column].as_ref(), 0, columns.as_ref(), row - count),
        (false, false) => among[(row - count, column - count)],
    })
}

fn dot(one: MatRef<'_, f64>, of_one: usize, other: MatRef<'_, f64>, of_other: usize) -> f64 {
    one.col(of_one).iter().zip(other.col(of_other).iter()).map(|(a, b)| a * b).sum()
}

/// Condition of the derivatives of all readings with columns of norm 1.
fn condition(products: &[Mat<f64>], count: usize, terms: usize) -> f64 {
    let size = count + products.len() * terms;
    let mut all = Mat::<f64>::zeros(size, size);
    for (output, of_output) in products.iter().enumerate() {
        let place = |index: usize| if index < count { index } else { index + output * terms };
        for row in 0..count + terms {
            (0..count + terms).for_each(|column| all[(place(row), place(column))] += of_output[(row, column)]);
        }
    }
    let norm = |index: usize| all[(index, index)].sqrt();
    let scaled = Mat::from_fn(size, size, |row, column| all[(row, column)] / (norm(row) * norm(column)));
    let Ok(values) = scaled.self_adjoint_eigenvalues(Side::Lower) else { return f64::INFINITY };
    let smallest = values.iter().copied().fold(f64::INFINITY, f64::min);
    let largest = values.iter().copied().fold(0.0, f64::max);
    if smallest > 0.0 { (largest / smallest).sqrt() } else { f64::INFINITY }
}

/// How residuals are drawn again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bootstrap {
    /// Number of draws.
    pub draws: usize,
    /// Length of a block, s: residuals further apart are as good as independent.
    pub block: f64,
    /// Seed of the random numbers.
    pub seed: u64,
}

impl Fitted {
    /// An output at some times of a log, also another one than it was fitted to: sensors are those of the same indices. States are
    /// zero at the beginning of the log.
    ///
    /// Fails for times outside the log.
    pub fn predict(&self, log: &SensorLog, output: usize, times: &[f64]) -> Result<Vec<f64>> {
        let terms = Terms::new(log, &self.structure, &self.time_constants, times)?;
        Ok(terms.output(&self.gains[output][..self.structure.of_any_run()]))
    }

    /// Adds what states at the beginning of one of its own runs leave.
    pub(crate) fn add_beginnings(&self, log: &SensorLog, output: usize, run: usize, times: &[f64], values: &mut [f64]) {
        let count = self.time_constants.len();
        let first = self.structure.of_any_run() + run * count;
        for (index, time_constant) in self.time_constants.iter().enumerate().filter(|_| self.structure.starts_warm) {
            let left = Response::of_beginning(log, *time_constant, times);
            let gain = self.gains[output][first + index];
            values.iter_mut().zip(left.values).for_each(|(value, left)| *value += gain * left);
        }
    }

    fn logarithms(&self) -> Vec<f64> {
        self.time_constants.iter().map(|time| time.ln()).collect()
    }

    /// The covariance of the same values as [`covariance`](Self::covariance) from residuals that are drawn again in blocks (moving
    /// block bootstrap, Künsch 1989), one linear step for each draw: residuals that follow each other count as few, and those of
    /// outputs that were read together stay together. With few blocks it is larger by the part that the unknowns are of them. `logs` and `outputs` are those of the fit.
    ///
    /// Fails for readings outside their log.
    pub fn bootstrap(&self, logs: &[SensorLog], outputs: &[Output], how: Bootstrap) -> Result<Mat<f64>> {
        let search = Search::new(logs, outputs, &self.structure, self.scales(), self.logarithms());
        let count = self.time_constants.len();
        let terms = self.structure.gains(logs.len());
        let size = count + outputs.len() * terms;
        let bread = inverse(&search.normal(&self.logarithms())?.matrix);
        let mut groups = Vec::new();
        for group in &search.groups {
            let (values, basis) = search.group(group, &search.logarithms)?;
            let found = basis.gains(values.as_ref());
            let moved: Vec<Mat<f64>> = (0..count).map(|index| search.changed(&basis, &found, index)).collect();
            let rest: Vec<Mat<f64>> = moved.iter().map(|moved| basis.rest(moved.clone())).collect();
            let follow: Vec<Mat<f64>> = moved.iter().map(|moved| basis.gains(moved.as_ref())).collect();
            groups.push((group, &values - &basis.columns * &found, basis, rest, follow));
        }
        let (mut sum, mut squares) = (Mat::<f64>::zeros(size, 1), Mat::<f64>::zeros(size, size));
        for draw in 0..how.draws {
            let mut random = Generator::new(how.seed, draw as u64);
            let mut gradient = Mat::<f64>::zeros(count, 1);
            let mut own = Vec::new();
            for (group, residuals, basis, rest, _) in &groups {
                let rows = drawn_rows(&outputs[group[0]], how.block, &mut random);
                let drawn =
                    Mat::from_fn(residuals.nrows(), residuals.ncols(), |row, column| residuals[(rows[row], column)]);
                (0..count).for_each(|index| gradient[(index, 0)] += product(&rest[index], &drawn));
                own.push(basis.gains(drawn.as_ref()));
            }
            let step = &bread * gradient;
            let mut change = Mat::<f64>::zeros(size, 1);
            (0..count).for_each(|index| change[(index, 0)] = step[(index, 0)]);
            for ((group, _, _, _, follow), own) in groups.iter().zip(&own) {
                for (place, &output) in group.iter().enumerate() {
                    for gain in 0..terms {
                        let with: f64 = (0..count).map(|index| step[(index, 0)] * follow[index][(gain, place)]).sum();
                        change[(count + output * terms + gain, 0)] =
                            search.scales[output] * (own[(gain, place)] - with);
                    }
                }
            }
            sum += &change;
            squares += &change * change.transpose();
        }
        let draws = how.draws as f64;
        // The fit took a part of what residuals do together: as much as its unknowns are of the blocks.
        let blocks = outputs.first().map_or(1.0, |output| blocks(output, how.block));
        let few = 1.0 + (terms as f64 + count as f64 / outputs.len().max(1) as f64) / blocks;
        let covariance =
            (squares - faer::Scale(1.0 / draws) * (&sum * sum.transpose())) * faer::Scale(few / (draws - 1.0).max(1.0));
        Ok(symmetric(covariance))
    }

    /// What outputs are divided by.
    fn scales(&self) -> Vec<f64> {
        self.scatter.iter().map(|scatter| if *scatter > 0.0 { *scatter } else { 1.0 }).collect()
    }
}

/// How many blocks the runs of an output have, at least one row each.
fn blocks(output: &Output, block: f64) -> f64 {
    let of = |run: &Readings| match run.times.as_slice() {
        [first, .., last] => ((last - first) / block).clamp(1.0, run.times.len() as f64),
        _ => 1.0,
    };
    output.runs.iter().map(of).sum()
}

/// Rows of an output, drawn again in blocks that stay within their run.
fn drawn_rows(output: &Output, block: f64, random: &mut Generator) -> Vec<usize> {
    let mut rows = Vec::new();
    let mut first = 0;
    for run in &output.runs {
        let count = run.times.len();
        let until = first + count;
        while rows.len() < until {
            let start = random.index(count);
            let end = run.times.partition_point(|time| *time < run.times[start] + block).max(start + 1);
            rows.extend((start..end).take(until - rows.len()).map(|row| first + row));
        }
        first = until;
    }
    rows
}

/// The terms of an output at some times of one run.
#[derive(Debug, Clone, PartialEq)]
pub struct Terms {
    /// Times x gains of any run.
    pub columns: Mat<f64>,
    /// Derivatives of the columns to the logarithm of the time constant that each has; zero for what outputs follow at once.
    pub slopes: Mat<f64>,
}

impl Terms {
    /// The terms of a structure with these time constants, s. States are zero at the beginning of the log.
    ///
    /// Fails for times outside the log.
    pub fn new(log: &SensorLog, structure: &Structure, time_constants: &[f64], times: &[f64]) -> Result<Self> {
        let structure = Structure { starts_warm: false, ..structure.clone() };
        let logarithms: Vec<f64> = time_constants.iter().map(|time| time.ln()).collect();
        let basis = Basis::new(std::slice::from_ref(log), &structure, &logarithms, &[times])?;
        Ok(Self { columns: basis.columns, slopes: basis.slopes })
    }

    /// An output with these gains at each time.
    pub fn output(&self, gains: &[f64]) -> Vec<f64> {
        let of = |row: usize| gains.iter().enumerate().map(|(gain, value)| self.columns[(row, gain)] * value).sum();
        (0..self.columns.nrows()).map(of).collect()
    }
}
