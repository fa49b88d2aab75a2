//! A problem as independent rows of unit variance: residuals divided by their standard uncertainties. Correlated residuals
//! are transformed to uncorrelated ones.

use abbe_core::{CompactBlock, CovarianceBlock, EquationIndex, Error, IndexRange, Problem, Result};
use abbe_numerics::{Accumulator, Factor, LeastSquares, Sink};

/// Unknowns that one triangle may have. Their covariances in `calibration.json` have some 500 MB then.
pub const MOST_AT_ONCE: usize = 5_000;

/// Rows of a part that is factorised by itself, for each unknown: of fewer its triangle saves little.
const ROWS_OF_PART: usize = 4;

/// Rows times the square of unknowns of such a part: what takes longer than a thread takes to begin.
const WORK_OF_PART: usize = 10_000_000;

/// Most parts that are factorised by themselves.
const MOST_PARTS: usize = 8;

/// A problem in weighted rows.
pub struct Weighted<'a> {
    problem: &'a Problem,
    uncertainties: Vec<f64>,
    blocks: Vec<Correlated>,
    /// Block and place in it of every equation; empty without blocks.
    place: Vec<Option<(usize, usize)>>,
    /// More columns: what is added to all residuals by one unit of something.
    columns: &'a [Vec<f64>],
    /// Which equations are constraints.
    constraints: Vec<bool>,
}

/// Equations that are correlated.
struct Correlated {
    equations: Vec<EquationIndex>,
    /// The lower triangle L of their covariance `L L^T`, row by row.
    lower: Vec<Vec<f64>>,
}

impl Correlated {
    fn new(block: &CovarianceBlock<EquationIndex>) -> Result<Self> {
        let broken = || Error::data("the covariance of some rows is singular");
        let lower = block.lower().ok_or_else(broken)?;
        let size = block.equations.len();
        let row = |row: usize| (0..=row).map(|column| lower[(row, column)]).collect();
        Ok(Self { equations: block.equations.clone(), lower: (0..size).map(row).collect() })
    }

    /// `L^-1` times rows of `width` numbers.
    fn whiten(&self, rows: &mut [f64], width: usize) {
        for (row, lower) in self.lower.iter().enumerate() {
            let (above, own) = rows.split_at_mut(row * width);
            let own = &mut own[..width];
            for (factor, above) in lower.iter().zip(above.chunks_exact(width)) {
                own.iter_mut().zip(above).for_each(|(value, above)| *value -= factor * above);
            }
            own.iter_mut().for_each(|value| *value /= lower[row]);
        }
    }
}

impl<'a> Weighted<'a> {
    /// The rows of a problem.
    pub fn new(problem: &'a Problem) -> Result<Self> {
        Self::with_columns(problem, &[])
    }

    /// The rows of a problem with more columns after those of its unknowns, each with one number for every equation.
    pub fn with_columns(problem: &'a Problem, columns: &'a [Vec<f64>]) -> Result<Self> {
        let uncertainties = problem.standard_uncertainties();
        let blocks = problem.covariance_blocks().iter().map(Correlated::new).collect::<Result<Vec<_>>>()?;
        let mut place = if blocks.is_empty() { Vec::new() } else { vec![None; uncertainties.len()] };
        for (index, block) in blocks.iter().enumerate() {
            block.equations.iter().enumerate().for_each(|(row, &equation)| place[equation.0] = Some((index, row)));
        }
        Ok(Self { problem, uncertainties, blocks, place, columns, constraints: problem.constraints() })
    }

    /// Whether rows are combinations of several equations.
    pub fn is_correlated(&self) -> bool {
        !self.blocks.is_empty()
    }

    /// The factor at x; rows with the given statistical weights, all 1 if there are none.
    ///
    /// Fails for more than [`MOST_AT_ONCE`] unknowns, and where a row has no finite value or derivative.
    pub fn factor(&self, x: &[f64], weights: Option<&[f64]>) -> Result<Factor> {
        let all = EquationIndex::first(self.rows());
        let mut factors = self.factors(x, weights, std::slice::from_ref(&all))?;
        factors.pop().ok_or_else(|| Error::data("there are no rows"))
    }

    /// The gradient `J^T r` of the weighted rows at x, and the residuals there, mm or rad.
    pub(crate) fn gradient_and_residuals(&self, x: &[f64]) -> Result<(Vec<f64>, Vec<f64>)> {
        if !self.is_correlated() {
            let counts = |row: EquationIndex, residual: f64| residual / self.uncertainties[row].powi(2);
            let (mut gradient, residuals) = self.problem.gradient(x, &counts)?;
            let all = EquationIndex::first(self.rows());
            gradient.extend(self.columns.iter().map(|column| {
                let products =
                    residuals.iter().zip(all.clone()).map(|(residual, row)| counts(row, *residual) * column[row]);
                products.sum::<f64>()
            }));
            if gradient.iter().chain(&residuals).all(|number| number.is_finite()) {
                return Ok((gradient, residuals));
            }
        }
        // What is not finite is looked for row by row.
        let mut gradient = vec![0.0; self.unknowns()];
        self.linearise_compact(x, |block| {
            for (_, residual, line) in block.lines() {
                let own = block.unknowns.iter().zip(line);
                own.for_each(|(&unknown, derivative)| gradient[unknown] += derivative * residual);
            }
        })?;
        Ok((gradient, self.problem.residuals(x)?))
    }

    /// Fails for more unknowns than one triangle may have: its memory and time grow with their square, and with their third power.
    fn check_unknowns(&self) -> Result<()> {
        let count = self.problem.unknowns.len();
        if count <= MOST_AT_ONCE {
            return Ok(());
        }
        let message =
            format!("{count} unknowns are too many for one triangle: {MOST_AT_ONCE} at most may be estimated at once");
        Err(Error::usage(message)
            .help("estimate fewer, or let own unknowns of artefacts be eliminated (`own_covariances`)"))
    }

    /// The factors of some ranges of rows.
    pub fn factors(
        &self,
        x: &[f64],
        weights: Option<&[f64]>,
        ranges: &[IndexRange<EquationIndex>],
    ) -> Result<Vec<Factor>> {
        self.check_unknowns()?;
        if self.is_correlated() || !self.columns.is_empty() {
            let mut accumulators = self.accumulators(ranges, 1);
            self.linearise_compact(x, |block| push(&block, |_| 1.0, weights, (ranges, &mut accumulators)))?;
            return Ok(accumulators.into_iter().map(Accumulator::finish).collect());
        }
        // Rows as they come need not be copied once more.
        let scale = |equation: EquationIndex| 1.0 / self.uncertainties[equation];
        let take = |block: &CompactBlock<'_>, (accumulators, broken): &mut Taken| {
            *broken = broken.or_else(|| broken_in(block));
            push(block, scale, weights, (ranges, accumulators));
        };
        let parts = self.parts();
        let (accumulators, broken) = match parts {
            1 => {
                let mut all = (self.accumulators(ranges, 1), None);
                self.problem.linearise_compact(x, |block| take(&block, &mut all))?;
                all
            }
            _ => {
                let found = self.problem.linearise_in_parts(x, parts, |rows| {
                    let mut part = (self.accumulators(ranges, parts), None);
                    rows.linearise(|block| take(&block, &mut part))?;
                    part.0.iter_mut().for_each(Accumulator::reduce);
                    Ok(part)
                })?;
                found.into_iter().reduce(joined).unwrap_or_default()
            }
        };
        match broken {
            Some(equation) => Err(not_finite(self.problem, equation)),
            None => Ok(accumulators.into_iter().map(Accumulator::finish).collect()),
        }
    }

    /// Room for the rows of some ranges, in so many parts.
    fn accumulators(&self, ranges: &[IndexRange<EquationIndex>], parts: usize) -> Vec<Accumulator> {
        ranges.iter().map(|range| Accumulator::new(self.unknowns(), range.len().div_ceil(parts))).collect()
    }

    /// Parts of the rows that are factorised by themselves, before their triangles are; one where that would make more work. Their number
    /// does not depend on that of threads.
    fn parts(&self) -> usize {
        let (rows, unknowns) = (self.rows(), self.unknowns().max(1));
        (rows / (ROWS_OF_PART * unknowns)).min(rows * unknowns * unknowns / WORK_OF_PART).clamp(1, MOST_PARTS)
    }
}

/// Rows of some ranges, and the first equation that has no finite value.
type Taken = (Vec<Accumulator>, Option<EquationIndex>);

/// The rows of two parts, one after the other.
fn joined((mut rows, broken): Taken, (more, also_broken): Taken) -> Taken {
    rows.iter_mut().zip(more).for_each(|(rows, more)| rows.append(more));
    (rows, broken.or(also_broken))
}

/// The first equation of a block without a finite value.
fn broken_in(block: &CompactBlock<'_>) -> Option<EquationIndex> {
    // To test all values is faster than to stop at the first one.
    let is_broken =
        |residual: f64, line: &[f64]| line.iter().fold(!residual.is_finite(), |bad, value| bad | !value.is_finite());
    block.lines().find(|(_, residual, line)| is_broken(*residual, line)).map(|(equation, ..)| equation)
}

/// Adds the rows of a block, each multiplied by its scale and by the root of its statistical weight, to those of the ranges that they
/// are in.
fn push(
    block: &CompactBlock<'_>,
    scale: impl Fn(EquationIndex) -> f64,
    weights: Option<&[f64]>,
    (ranges, accumulators): (&[IndexRange<EquationIndex>], &mut [Accumulator]),
) {
    for (equation, residual, line) in block.lines() {
        let weight = weights.map_or(1.0, |weights| weights[equation].sqrt()) * scale(equation);
        for (range, accumulator) in ranges.iter().zip(&mut *accumulators) {
            if range.contains(equation) {
                accumulator.push_some(block.unknowns, line, residual, weight);
            }
        }
    }
}

impl LeastSquares for Weighted<'_> {
    type Error = Error;

    fn is_final(&self, error: &Error) -> bool {
        error.fatal
    }

    fn is_out_of_time(&self, error: &Error) -> bool {
        error.out_of_time
    }

    fn has_stepped(&self, iteration: usize, size: f64) {
        self.problem.monitor.iteration(iteration, size);
    }

    fn unknowns(&self) -> usize {
        self.problem.unknowns.len() + self.columns.len()
    }

    fn rows(&self) -> usize {
        self.uncertainties.len()
    }

    fn keeps_weight(&self, row: usize) -> bool {
        self.constraints[row]
    }

    fn linearise(&self, x: &[f64], sink: Sink<'_>) -> Result<()> {
        let mut derivatives = Vec::new();
        self.linearise_compact(x, |block| {
            block.fill(self.unknowns(), &mut derivatives);
            sink(block.first.0, block.residuals, &derivatives);
        })
    }

    fn gradient(&self, x: &[f64]) -> Result<Vec<f64>> {
        self.gradient_and_residuals(x).map(|(gradient, _)| gradient)
    }

    fn factor_near(&self, x: &[f64], known: &Factor) -> Result<Option<Factor>> {
        if self.is_correlated() {
            return Ok(None);
        }
        let (gradient, residuals) = self.gradient_and_residuals(x)?;
        let squares = self.in_uncertainties(residuals).iter().map(|residual| residual * residual).sum();
        Ok(known.with_gradient(&gradient, squares))
    }

    fn factor(&self, x: &[f64], weights: Option<&[f64]>) -> Result<Factor> {
        Weighted::factor(self, x, weights)
    }
}

impl Weighted<'_> {
    /// The rows at x without the columns that are zero in a whole block: residuals and derivatives divided by the standard
    /// uncertainties.
    pub(crate) fn linearise_compact(&self, x: &[f64], mut sink: impl FnMut(CompactBlock<'_>)) -> Result<()> {
        let own = self.problem.unknowns.len();
        let more = own..self.unknowns();
        let (mut residuals, mut derivatives, mut unknowns) = (Vec::new(), Vec::new(), Vec::new());
        // Rows of correlated blocks are kept until their block is complete: derivatives and, last, the residual.
        let width = self.unknowns() + 1;
        let mut waiting: Vec<Vec<f64>> =
            self.blocks.iter().map(|block| vec![0.0; block.equations.len() * width]).collect();
        let mut broken = None;
        self.problem.linearise_compact(x, |block| {
            unknowns.clear();
            unknowns.extend(block.unknowns.iter().copied().chain(more.clone()));
            let mut first = block.first;
            broken = broken.or_else(|| broken_in(&block));
            for (equation, residual, line) in block.lines() {
                let values = line.iter().copied().chain(self.columns.iter().map(|column| column[equation]));
                if let Some((block, place)) = self.place.get(equation.0).copied().flatten() {
                    let waiting = &mut waiting[block][place * width..(place + 1) * width];
                    unknowns.iter().zip(values).for_each(|(&unknown, value)| waiting[unknown] = value);
                    waiting[width - 1] = residual;
                    if !residuals.is_empty() {
                        let (residuals, derivatives) = (residuals.as_slice(), derivatives.as_slice());
                        sink(CompactBlock { first, residuals, unknowns: &unknowns, derivatives });
                    }
                    residuals.clear();
                    derivatives.clear();
                    first = EquationIndex(equation.0 + 1);
                } else {
                    let uncertainty = self.uncertainties[equation];
                    residuals.push(residual / uncertainty);
                    derivatives.extend(values.map(|value| value / uncertainty));
                }
            }
            if !residuals.is_empty() {
                sink(CompactBlock { first, residuals: &residuals, unknowns: &unknowns, derivatives: &derivatives });
                residuals.clear();
                derivatives.clear();
            }
        })?;
        if let Some(equation) = broken {
            return Err(not_finite(self.problem, equation));
        }
        unknowns.clear();
        unknowns.extend(0..self.unknowns());
        for (block, rows) in self.blocks.iter().zip(&mut waiting) {
            block.whiten(rows, width);
            for (&first, row) in block.equations.iter().zip(rows.chunks_exact(width)) {
                let (derivatives, residuals) = row.split_at(width - 1);
                sink(CompactBlock { first, residuals, unknowns: &unknowns, derivatives });
            }
        }
        Ok(())
    }
}

impl Weighted<'_> {
    /// Transforms residuals in mm or rad to the residuals of the rows of unit variance.
    pub fn in_uncertainties(&self, mut residuals: Vec<f64>) -> Vec<f64> {
        for block in &self.blocks {
            let mut own: Vec<f64> = block.equations.iter().map(|&equation| residuals[equation]).collect();
            block.whiten(&mut own, 1);
            // The division below, which is for all rows, cancels this factor.
            for (&equation, value) in block.equations.iter().zip(own) {
                residuals[equation] = value * self.uncertainties[equation];
            }
        }
        residuals.iter().zip(&self.uncertainties).map(|(residual, uncertainty)| residual / uncertainty).collect()
    }
}

/// The error for an equation without a finite value: a pose or an artefact where the geometry is singular.
fn not_finite(problem: &Problem, equation: EquationIndex) -> Error {
    let (set, row) = problem.equation_rows()[equation];
    let has_line = problem.origin(set, row).is_some();
    let which =
        if has_line { "of this row".to_owned() } else { format!("{} of the artefact, which no row has,", row.0 + 1) };
    let message = format!("the equation {which} has no finite value; its geometry is singular");
    problem.error_at_row(set, row, Error::data(message).stage(&problem.sets[set].name))
}
