//! The errors of the rows of a problem.

use abbe_core::{CovarianceBlock, EquationIndex, Error, Fit, Problem, RepeatedTogether, Result, RowIndex, SetIndex};
use abbe_numerics::Generator;
use nalgebra::{DMatrix, DVector};

use crate::settings::RowDistribution;

/// The distributions of the errors of rows.
pub struct RowErrors {
    distribution: RowDistribution,
    /// Standard uncertainty of the equations that are independent; zero for all others.
    independent: Vec<f64>,
    /// Correlated equations with the root of their covariance.
    blocks: Vec<(CovarianceBlock<EquationIndex>, DMatrix<f64>)>,
    /// Repeats that are pooled.
    pub repeated_together: Vec<RepeatedTogether>,
    /// For every set the errors to draw from, over the standard uncertainties; empty unless resampled.
    residuals: Vec<Vec<f64>>,
    /// The set and the row of every equation.
    row_of: Vec<(SetIndex, RowIndex)>,
}

impl RowErrors {
    /// The errors of the rows of a problem at the estimate of a fit, or of some of its rows, which scatter by `scale` times what is
    /// stated.
    pub fn new(distribution: RowDistribution, fit: &Fit, problem: &Problem, scale: f64) -> Result<Self> {
        let mut independent: Vec<f64> =
            problem.standard_uncertainties().iter().map(|uncertainty| uncertainty * scale).collect();
        let repeated_together = problem.repeated_together();
        let ranges = problem.equation_ranges();
        for set in repeated_together.iter().flat_map(|together| &together.sets) {
            independent[ranges[*set].clone()].fill(0.0);
        }
        // An equation that states a certificate has no noise of its own: its known input is drawn.
        for (uncertainty, _) in independent.iter_mut().zip(problem.constraints()).filter(|(_, constraint)| *constraint)
        {
            *uncertainty = 0.0;
        }
        let mut blocks = Vec::new();
        for block in problem.covariance_blocks() {
            if block.equations.iter().all(|&equation| independent[equation] == 0.0) {
                continue; // The scatter of repeats counts instead.
            }
            block.equations.iter().for_each(|&equation| independent[equation] = 0.0);
            let root = block.lower().ok_or_else(|| Error::data("the covariance of some rows is singular"))?;
            blocks.push((block, root * scale));
        }
        let residuals = match distribution.fixed() {
            Some(_) => Vec::new(),
            None if blocks.is_empty() => residuals(fit, problem, scale)?,
            None => {
                let error = Error::usage("correlated rows cannot be drawn from residuals one by one").setting("rows");
                return Err(error.help("leave out `resampled`, or the covariance under `uncertainty` of the artefacts"));
            }
        };
        let row_of = problem.equation_rows();
        Ok(Self { distribution, independent, blocks, repeated_together, residuals, row_of })
    }

    /// Number of equations.
    pub fn equations(&self) -> usize {
        self.independent.len()
    }

    /// Whether rows of a set are correlated.
    pub fn is_correlated(&self, set: SetIndex) -> bool {
        self.blocks.iter().any(|(block, _)| self.row_of[block.equations[0]].0 == set)
    }

    /// The errors of one trial, from one stream of random numbers.
    pub fn draw(&self, generator: &mut Generator) -> Vec<f64> {
        let mut errors = vec![0.0; self.equations()];
        EquationIndex::first(self.equations()).for_each(|equation| self.draw_one(equation, generator, &mut errors));
        self.blocks.iter().for_each(|block| add_block(block, generator, &mut errors));
        for together in &self.repeated_together {
            let pooled = &together.pooled;
            // A covariance that was itself found by repeats makes a multivariate t distribution (JCGM 101, 6.4.9).
            let freedom = pooled.degrees_of_freedom;
            let chi_squared: f64 = (0..freedom).map(|_| generator.normal().powi(2)).sum();
            let factor = 1.0 / chi_squared.sqrt();
            for deviations in &pooled.deviations {
                let drawn = factor * generator.normal();
                errors.iter_mut().zip(deviations).for_each(|(error, deviation)| *error += drawn * deviation);
            }
        }
        errors
    }

    /// The errors of one trial, in which every row has random numbers of its own: `of_row` gives those of a row. Rows may be drawn in
    /// any order and in parts; no row is correlated with others.
    pub fn draw_by_row(&self, of_row: impl Fn(SetIndex, RowIndex) -> Generator) -> Vec<f64> {
        let mut errors = vec![0.0; self.equations()];
        let mut last: Option<((SetIndex, RowIndex), Generator)> = None;
        for (equation, &row) in EquationIndex::enumerate(&self.row_of) {
            let same = last.take().filter(|(known, _)| *known == row);
            let (_, generator) = last.insert(same.unwrap_or_else(|| (row, of_row(row.0, row.1))));
            self.draw_one(equation, generator, &mut errors);
        }
        for block in &self.blocks {
            let (set, row) = self.row_of[block.0.equations[0]];
            add_block(block, &mut of_row(set, row), &mut errors);
        }
        errors
    }

    fn draw_one(&self, equation: EquationIndex, generator: &mut Generator, errors: &mut [f64]) {
        let uncertainty = self.independent[equation];
        if uncertainty > 0.0 {
            errors[equation] = uncertainty
                * match self.distribution.fixed() {
                    Some(distribution) => distribution.draw(generator),
                    None => {
                        let of_set = &self.residuals[self.row_of[equation].0];
                        of_set[generator.index(of_set.len())]
                    }
                };
        }
    }
}

fn add_block(
    (block, root): &(CovarianceBlock<EquationIndex>, DMatrix<f64>),
    generator: &mut Generator,
    errors: &mut [f64],
) {
    let drawn = root * DVector::from_fn(block.equations.len(), |_, _| generator.normal());
    block.equations.iter().zip(drawn.iter()).for_each(|(&equation, value)| errors[equation] += value);
}

/// For every set its residuals without outliers, divided by the scaled standard uncertainties. Their mean is zero, and they
/// are enlarged to the size of the errors: the estimate adapts to the errors and makes residuals smaller.
fn residuals(fit: &Fit, problem: &Problem, scale: f64) -> Result<Vec<Vec<f64>>> {
    let all = problem.residuals(&problem.start())?;
    let report = &fit.calibration.fit;
    if report.degrees_of_freedom == 0 {
        let error =
            Error::data("there are no degrees of freedom: the residuals are zero whatever the errors").setting("rows");
        return Err(error.help("use the stated uncertainties: `rows: normal`"));
    }
    let taken = report.observations.max(1) as f64;
    let inflation = (taken / report.degrees_of_freedom as f64).sqrt();
    let outlier = |set: SetIndex, row: RowIndex| {
        let name = &problem.sets[set].name;
        problem.origin(set, row).is_some_and(|(file, origin)| {
            let same = |outlier: &abbe_core::Outlier| {
                outlier.stage == *name && outlier.row == origin.row && outlier.file == file.display().to_string()
            };
            fit.calibration.outliers.iter().any(same)
        })
    };
    let mut sets = vec![Vec::new(); problem.sets.len()];
    let rows = problem.equation_rows();
    let constraints = problem.constraints();
    let rows = rows.into_iter().zip(constraints);
    for ((residual, uncertainty), ((set, row), constraint)) in
        all.iter().zip(problem.standard_uncertainties()).zip(rows)
    {
        if !outlier(set, row) && !constraint {
            sets[set].push(residual / uncertainty / scale * inflation);
        }
    }
    for values in &mut sets {
        // The mean of one row is the row itself: its residual tells nothing about errors.
        if values.len() > 1 {
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            values.iter_mut().for_each(|value| *value -= mean);
        } else {
            values.clear();
        }
    }
    // A set without residuals of its own draws from those of all sets.
    let everything: Vec<f64> = sets.concat();
    sets.iter_mut().filter(|values| values.is_empty()).for_each(|values| values.clone_from(&everything));
    if everything.is_empty() {
        return Err(Error::data("there are no residuals to draw from").setting("rows"));
    }
    Ok(sets)
}
