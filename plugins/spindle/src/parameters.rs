//! Named parameters of estimates, and harmonics read back from them.

use std::collections::BTreeMap;

use abbe_core::{
    CALIBRATION_FORMAT, Calibration, Contribution, Estimated, FitReport, JointCoverage, ModelRecord, NamedCovariance,
    ParameterBudget, Status, UncertaintyBudget,
};
use abbe_numerics::{coverage_factor, rectangular_coverage_factor};
use abbe_standards::spindle::Harmonics;
use nalgebra::DMatrix;
use serde_json::Value;

/// Probability that intervals cover.
const COVERAGE: f64 = 0.95;

/// The names of the coefficients of an order: `prefix[cos2]`, `prefix[sin2]`.
pub fn of_order(prefix: &str, order: usize) -> [String; 2] {
    [format!("{prefix}[cos{order}]"), format!("{prefix}[sin{order}]")]
}

/// A parameter as a sum of raw coefficients.
pub struct Combined {
    pub name: String,
    pub unit: &'static str,
    /// Places of raw coefficients and their factors.
    pub terms: Vec<(usize, f64)>,
}

impl Combined {
    /// A length.
    pub fn length(name: String, terms: Vec<(usize, f64)>) -> Self {
        Self { name, unit: "mm", terms }
    }
}

/// Parameters that were found, piece by piece.
#[derive(Default)]
pub struct Found {
    pub parameters: Vec<Estimated>,
    blocks: Vec<(Vec<String>, DMatrix<f64>)>,
    freedom: BTreeMap<String, f64>,
}

impl Found {
    /// Adds combinations of raw coefficients with their covariance, which has these degrees of freedom.
    pub fn add(&mut self, combined: &[Combined], raw: &[f64], covariance: &DMatrix<f64>, freedom: f64) {
        let product = |one: &Combined, other: &Combined| -> f64 {
            let pairs = one.terms.iter().flat_map(|one| other.terms.iter().map(move |other| (one, other)));
            pairs.map(|((row, one), (column, other))| one * other * covariance[(*row, *column)]).sum()
        };
        let size = combined.len();
        let own =
            DMatrix::from_fn(size, size, |row, column| product(&combined[row.min(column)], &combined[row.max(column)]));
        for (place, Combined { name, unit, terms }) in combined.iter().enumerate() {
            self.freedom.insert(name.clone(), freedom);
            self.parameters.push(Estimated {
                name: name.clone(),
                value: terms.iter().map(|(place, factor)| factor * raw[*place]).sum(),
                unit: (*unit).to_owned(),
                standard_uncertainty: own[(place, place)].max(0.0).sqrt(),
                status: Status::Estimated,
            });
        }
        let own =
            DMatrix::from_fn(
                size,
                size,
                |row, column| {
                    if row == column { own[(row, row)].max(0.0) } else { own[(row, column)] }
                },
            );
        self.blocks.push((combined.iter().map(|combined| combined.name.clone()).collect(), own));
    }

    /// Adds a value that is told without an uncertainty.
    pub fn fixed(&mut self, name: String, value: f64, unit: &str) {
        let unit = unit.to_owned();
        self.parameters.push(Estimated { name, value, unit, standard_uncertainty: 0.0, status: Status::Fixed });
    }

    /// The calibration; `scatter` says where its uncertainties come from.
    pub fn calibration(self, name: &str, plugin: &str, settings: Value, scatter: &str, fit: FitReport) -> Calibration {
        let order: Vec<String> = self.blocks.iter().flat_map(|(names, _)| names.iter().cloned()).collect();
        let mut rows = vec![vec![0.0; order.len()]; order.len()];
        let mut first = 0;
        for (names, block) in &self.blocks {
            for row in 0..names.len() {
                for column in 0..names.len() {
                    rows[first + row][first + column] = block[(row, column)];
                }
            }
            first += names.len();
        }
        let uncertainty = self.budget(scatter);
        Calibration {
            abbe_calibration: CALIBRATION_FORMAT,
            estimate: name.to_owned(),
            model: ModelRecord { plugin: plugin.to_owned(), settings },
            parameters: self.parameters,
            artefacts: Vec::new(),
            covariance: NamedCovariance { order, rows },
            inputs: Some(Vec::new()),
            data: Vec::new(),
            outliers: Vec::new(),
            fit: FitReport { null_space: fit.null_space.clone(), ..fit },
            uncertainty: Some(uncertainty),
            monte_carlo: None,
            group: None,
        }
    }

    fn budget(&self, scatter: &str) -> UncertaintyBudget {
        let estimated: Vec<&Estimated> =
            self.parameters.iter().filter(|parameter| parameter.status == Status::Estimated).collect();
        let entry = |parameter: &&Estimated| {
            let (uncertainty, freedom) = (parameter.standard_uncertainty, self.freedom.get(&parameter.name).copied());
            let factor = coverage_factor(COVERAGE, freedom.unwrap_or(f64::INFINITY));
            ParameterBudget {
                name: parameter.name.clone(),
                unit: parameter.unit.clone(),
                standard_uncertainty: uncertainty,
                stated_standard_uncertainty: uncertainty,
                degrees_of_freedom: freedom,
                coverage_factor: factor,
                expanded_uncertainty: factor * uncertainty,
                contributions: vec![Contribution { input: scatter.to_owned(), standard_uncertainty: uncertainty }],
            }
        };
        let fewest = self.freedom.values().copied().fold(f64::INFINITY, f64::min);
        UncertaintyBudget {
            coverage_probability: COVERAGE,
            scale: 1.0,
            joint: JointCoverage {
                quantities: estimated.len(),
                degrees_of_freedom: fewest.is_finite().then_some(fewest),
                ellipsoid_factor: None,
                rectangle_factor: rectangular_coverage_factor(estimated.len().max(1), COVERAGE, fewest),
            },
            parameters: estimated.iter().map(entry).collect(),
            correlations: Vec::new(),
        }
    }
}

/// Sizes of residuals, mm, as they come.
#[derive(Default)]
pub struct Sizes {
    count: usize,
    largest: f64,
    sum: f64,
    squares: f64,
}

impl Sizes {
    pub fn push(&mut self, rest: f64) {
        self.count += 1;
        self.largest = self.largest.max(rest.abs());
        self.sum += rest.abs();
        self.squares += rest * rest;
    }

    /// A report of a fit with these residuals.
    pub fn report(&self, unknowns: usize, rank: usize, condition: f64) -> FitReport {
        let count = self.count.max(1) as f64;
        FitReport {
            observations: self.count,
            rank,
            condition,
            degrees_of_freedom: self.count.saturating_sub(rank),
            residual_max_um: self.largest * 1e3,
            residual_mean_abs_um: self.sum / count * 1e3,
            residual_rms_um: (self.squares / count).sqrt() * 1e3,
            ..FitReport::without_rows(unknowns)
        }
    }
}

/// The value of a parameter.
pub fn value(calibration: &Calibration, name: &str) -> Option<f64> {
    calibration.get(name).map(|parameter| parameter.value)
}

/// Harmonics of these orders under a prefix; those that are not there are zero.
pub fn harmonics(calibration: &Calibration, prefix: &str, highest: usize) -> Harmonics {
    let mut found = Harmonics::zero(highest);
    for order in 1..=highest {
        let [cos, sin] = of_order(prefix, order).map(|name| value(calibration, &name).unwrap_or(0.0));
        (found.cos[order], found.sin[order]) = (cos, sin);
    }
    found
}
