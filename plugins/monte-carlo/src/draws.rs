//! The inputs that vary from trial to trial.

use abbe_core::{Error, Fit, Problem, Result, SetIndex};
use abbe_numerics::Generator;
use nalgebra::{DMatrix, DVector};

use crate::lobing::Pretravel;
use crate::neglected::largest_factor;
use crate::rows::RowErrors;
use crate::settings::{Distribution, LobingSetting, Settings};
use crate::shared::{Shared, Source, root};

/// One trial: the problem with its drawn inputs, and the drawn values of the considered parameters.
pub struct Drawn {
    /// The problem.
    pub problem: Problem,
    /// Values of the considered parameters, in their order.
    pub considered: Vec<f64>,
}

/// The distributions of all inputs of an estimate.
pub struct Draws<'a> {
    /// The problem at the estimate.
    problem: Problem,
    settings: &'a Settings,
    rows: RowErrors,
    shared: Shared,
    lobing: Vec<Pretravel>,
    /// The root of the covariance of a calibration without rows, from which its values are drawn.
    stated: Option<DMatrix<f64>>,
}

impl<'a> Draws<'a> {
    /// The inputs of a fit as the settings vary them.
    pub fn new(settings: &'a Settings, fit: &Fit) -> Result<Self> {
        let problem = at_estimate(fit);
        let rows = RowErrors::new(settings.rows, fit, &problem, scale(fit))?;
        let shared = Shared::new(settings, &problem, &|parameter| largest_factor(parameter, &problem))?;
        let mut lobing = Vec::new();
        for (index, setting) in settings.lobing.iter().enumerate() {
            lobing.push(Pretravel::new(index, setting, &problem)?);
        }
        Ok(Self { problem, settings, rows, shared, lobing, stated: stated(settings, fit)? })
    }

    /// The problem at the estimate.
    pub fn problem(&self) -> &Problem {
        &self.problem
    }

    /// The estimate of one trial, followed by its considered parameters; `solve` gives the values of a problem.
    pub fn trial(&self, generator: &mut Generator, solve: impl Fn(&Problem) -> Result<Vec<f64>>) -> Result<Vec<f64>> {
        if let Some(root) = &self.stated {
            let numbers = DVector::from_fn(root.ncols(), |_, _| generator.normal());
            let changes = root * numbers;
            return Ok(self.problem.start().iter().zip(changes.iter()).map(|(value, change)| value + change).collect());
        }
        let drawn = self.draw(generator);
        solve(&drawn.problem).map(|values| [values, drawn.considered].concat())
    }

    /// Number of quantities of a trial: the unknowns and the considered parameters.
    pub fn quantities(&self) -> usize {
        self.problem.unknowns.len() + self.shared.count()
    }

    /// What varies, in words.
    pub fn described(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if self.stated.is_some() {
            lines.push("the values of the calibration: multivariate normal".to_owned());
        }
        lines.extend(described(self.settings, &self.problem, &self.rows, &self.shared));
        lines
    }

    /// One trial.
    pub fn draw(&self, generator: &mut Generator) -> Drawn {
        let mut errors = self.rows.draw(generator);
        for lobing in &self.lobing {
            lobing.add(&lobing.setting.draw(generator), &mut errors);
        }
        let mut problem = self.problem.disturbed(&errors);
        let drawn = self.shared.draw(&problem, generator);
        for (prior, changes) in drawn.priors {
            problem.priors[prior].values.iter_mut().zip(changes).for_each(|(value, change)| *value += change);
        }
        drawn.changes.iter().for_each(|(unknown, change)| problem.shift(unknown, *change));
        Drawn { problem, considered: drawn.considered }
    }
}

/// The problem of a fit at its estimate.
pub fn at_estimate(fit: &Fit) -> Problem {
    let problem = fit.problem.watched_by(fit.problem.monitor.without_events());
    let mut problem = problem.with_values(&problem.values_of(&fit.calibration));
    if !fit.estimator.counts_priors() {
        problem.priors.clear();
    }
    problem
}

/// Rows scatter by the factor that the estimate found, unless it trusts the stated uncertainties.
pub fn scale(fit: &Fit) -> f64 {
    fit.calibration.uncertainty.as_ref().map_or(1.0, |budget| budget.scale)
}

/// What varies of rows, and beside them, in words.
pub fn described(settings: &Settings, problem: &Problem, rows: &RowErrors, shared: &Shared) -> Vec<String> {
    let repeated = |set: &SetIndex| rows.repeated_together.iter().any(|together| together.sets.contains(set));
    let mut lines = Vec::new();
    for (index, set) in SetIndex::enumerate(&problem.sets).filter(|(index, _)| !repeated(index)) {
        let distribution = match settings.rows.fixed() {
            None => "drawn from the residuals".to_owned(),
            Some(distribution) => words(distribution),
        };
        let how = if rows.is_correlated(index) { "correlated, multivariate normal" } else { &distribution };
        lines.push(format!("rows of {}: {how}", set.name));
    }
    for together in &rows.repeated_together {
        let names: Vec<&str> = together.sets.iter().map(|&set| problem.sets[set].name.as_str()).collect();
        lines.push(format!(
            "rows of {}: scatter of repeats pooled by {}, multivariate t with {} degrees of freedom",
            names.join(", "),
            together.pooled.by,
            together.pooled.degrees_of_freedom
        ));
    }
    for Source { members, prior, distribution, .. } in &shared.considered {
        let known = prior.iter().flat_map(|&prior| {
            let prior = &problem.priors[prior];
            prior.unknowns.iter().take(prior.values.len())
        });
        let members = members.iter().map(|&member| &problem.considered.unknowns[member]);
        let names: Vec<&str> = known.chain(members).map(|unknown| unknown.name.as_str()).collect();
        lines.push(format!("{}: {}", names.join(", "), words(*distribution)));
    }
    for (unknown, distribution, size) in &shared.neglected {
        lines.push(format!(
            "{}: {}, standard uncertainty {size:e} {}",
            unknown.name,
            words(*distribution),
            unknown.unit
        ));
    }
    for LobingSetting { artefact, amplitude_um, lobes, .. } in &settings.lobing {
        lines.push(format!("touches of {artefact}: {} lobes of amplitude {amplitude_um} um", lobes.get()));
    }
    lines
}

fn words(distribution: Distribution) -> String {
    match distribution {
        Distribution::Normal => "normal".to_owned(),
        Distribution::Uniform => "rectangular".to_owned(),
        Distribution::Student(freedom) => format!("Student's t with {freedom} degrees of freedom"),
    }
}

/// The root of the covariance of a calibration without rows: only its values can be drawn.
fn stated(settings: &Settings, fit: &Fit) -> Result<Option<DMatrix<f64>>> {
    if !fit.problem.sets.is_empty() {
        return Ok(None);
    }
    let given = [
        ("vary", settings.vary.is_empty()),
        ("lobing", settings.lobing.is_empty()),
        ("inputs", settings.inputs.is_empty()),
    ];
    if let Some((setting, _)) = given.iter().find(|(_, empty)| !empty) {
        let message = format!("`{}` brings no rows: its values are drawn by their covariance alone", fit.name);
        return Err(Error::usage(message).setting(setting));
    }
    let names: Vec<&str> = fit.problem.unknowns.iter().map(|unknown| unknown.name.as_str()).collect();
    Ok(Some(root(&fit.calibration.covariance.block(&names))))
}
