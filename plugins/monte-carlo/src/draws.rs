//! The inputs that vary from trial to trial.

use abbe_core::{
    CovarianceBlock, EquationIndex, Error, Fit, Owner, PathItem, Problem, Quantity, RepeatedTogether, Result, RowIndex,
    SetIndex, Unknown, matches,
};
use abbe_numerics::Generator;
use abbe_simulation::{Lobing, contact_directions};
use nalgebra::{DMatrix, DVector, SymmetricEigen};

use crate::settings::{Distribution, LobingSetting, Neglected, Settings};

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
    /// Standard uncertainty of the equations that are independent; zero for all others.
    independent: Vec<f64>,
    /// Correlated equations with the root of their covariance.
    blocks: Vec<(CovarianceBlock<EquationIndex>, DMatrix<f64>)>,
    repeated_together: Vec<RepeatedTogether>,
    /// For every set the errors to draw from, over the standard uncertainties; empty unless resampled.
    residuals: Vec<Vec<f64>>,
    /// The set of every equation.
    set_of: Vec<SetIndex>,
    considered: Vec<Source>,
    /// Values of the considered parameters at the estimate.
    known: Vec<f64>,
    neglected: Vec<(Unknown, Distribution, f64)>,
    lobing: Vec<Pretravel>,
    /// The root of the covariance of a calibration without rows, from which its values are drawn.
    stated: Option<DMatrix<f64>>,
}

/// Considered parameters that are correlated, with the root of their covariance.
struct Source {
    members: Vec<usize>,
    /// The prior of the problem that comes from the same earlier estimate. What it knows of unknowns comes first in the root.
    prior: Option<usize>,
    root: DMatrix<f64>,
    distribution: Distribution,
}

/// Lobing that affects some equations.
struct Pretravel {
    setting: LobingSetting,
    /// Equations with their directions of contact.
    touches: Vec<(EquationIndex, [f64; 3])>,
}

impl<'a> Draws<'a> {
    /// The inputs of a fit as the settings vary them.
    pub fn new(settings: &'a Settings, fit: &Fit) -> Result<Self> {
        let problem = fit.problem.watched_by(fit.problem.monitor.without_events());
        let mut problem = problem.with_values(&problem.values_of(&fit.calibration));
        if !fit.estimator.counts_priors() {
            problem.priors.clear();
        }
        // Rows scatter by the factor that the estimate found, unless it trusts the stated uncertainties.
        let scale = fit.calibration.uncertainty.as_ref().map_or(1.0, |budget| budget.scale);
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
        let set_of = problem.equation_rows().iter().map(|(set, _)| *set).collect();
        let residuals = match settings.rows.fixed() {
            Some(_) => Vec::new(),
            None if blocks.is_empty() => residuals(fit, &problem, scale)?,
            None => {
                let error = Error::usage("correlated rows cannot be drawn from residuals one by one").setting("rows");
                return Err(error.help("leave out `resampled`, or the covariance under `uncertainty` of the artefacts"));
            }
        };
        let considered = sources(settings, &problem)?;
        let known = problem.considered.unknowns.iter().map(|unknown| problem.value_of(unknown)).collect();
        let mut neglected = Vec::new();
        for (index, line) in settings.vary.iter().enumerate() {
            neglected.extend(line.parameters_of(index, &problem)?);
        }
        let mut lobing = Vec::new();
        for (index, setting) in settings.lobing.iter().enumerate() {
            lobing.push(Pretravel::new(index, setting, &problem)?);
        }
        let draws = Self {
            problem,
            settings,
            independent,
            blocks,
            repeated_together,
            residuals,
            set_of,
            considered,
            known,
            neglected,
            lobing,
            stated: stated(settings, fit)?,
        };
        Ok(draws)
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
        self.problem.unknowns.len() + self.known.len()
    }

    /// What varies, in words.
    pub fn described(&self) -> Vec<String> {
        let repeated = |set: &SetIndex| self.repeated_together.iter().any(|together| together.sets.contains(set));
        let mut lines = Vec::new();
        if self.stated.is_some() {
            lines.push("the values of the calibration: multivariate normal".to_owned());
        }
        for (index, set) in SetIndex::enumerate(&self.problem.sets).filter(|(index, _)| !repeated(index)) {
            let distribution = match self.settings.rows.fixed() {
                None => "drawn from the residuals".to_owned(),
                Some(distribution) => words(distribution),
            };
            let correlated = self.blocks.iter().any(|(block, _)| self.set_of[block.equations[0]] == index);
            let how = if correlated { "correlated, multivariate normal" } else { &distribution };
            lines.push(format!("rows of {}: {how}", set.name));
        }
        for together in &self.repeated_together {
            let names: Vec<&str> = together.sets.iter().map(|&set| self.problem.sets[set].name.as_str()).collect();
            lines.push(format!(
                "rows of {}: scatter of repeats pooled by {}, multivariate t with {} degrees of freedom",
                names.join(", "),
                together.pooled.by,
                together.pooled.degrees_of_freedom
            ));
        }
        for source in &self.considered {
            let known = source.prior.iter().flat_map(|&prior| {
                let prior = &self.problem.priors[prior];
                prior.unknowns.iter().take(prior.values.len())
            });
            let members = source.members.iter().map(|&member| &self.problem.considered.unknowns[member]);
            let names: Vec<&str> = known.chain(members).map(|unknown| unknown.name.as_str()).collect();
            lines.push(format!("{}: {}", names.join(", "), words(source.distribution)));
        }
        for (unknown, distribution, size) in &self.neglected {
            lines.push(format!(
                "{}: {}, standard uncertainty {size:e} {}",
                unknown.name,
                words(*distribution),
                unknown.unit
            ));
        }
        for Pretravel { setting, .. } in &self.lobing {
            let LobingSetting { artefact, amplitude_um, lobes, .. } = setting;
            lines.push(format!("touches of {artefact}: {} lobes of amplitude {amplitude_um} um", lobes.get()));
        }
        lines
    }

    /// One trial.
    pub fn draw(&self, generator: &mut Generator) -> Drawn {
        let mut errors = vec![0.0; self.independent.len()];
        self.draw_rows(generator, &mut errors);
        for (block, root) in &self.blocks {
            let drawn = root * DVector::from_fn(block.equations.len(), |_, _| generator.normal());
            block.equations.iter().zip(drawn.iter()).for_each(|(&equation, value)| errors[equation] += value);
        }
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
        for lobing in &self.lobing {
            lobing.add(generator, &mut errors);
        }
        let mut problem = self.problem.disturbed(&errors);
        let mut considered = self.known.clone();
        for source in &self.considered {
            let numbers = DVector::from_fn(source.root.ncols(), |_, _| source.distribution.draw(generator));
            let drawn = &source.root * numbers;
            let mut changes = drawn.iter();
            if let Some(prior) = source.prior {
                let known = problem.priors[prior].values.iter_mut();
                known.zip(&mut changes).for_each(|(value, change)| *value += change);
            }
            for (&member, change) in source.members.iter().zip(changes) {
                considered[member] += change;
                problem.shift(&self.problem.considered.unknowns[member], *change);
            }
        }
        for (unknown, distribution, size) in &self.neglected {
            problem.shift(unknown, size * distribution.draw(generator));
        }
        Drawn { problem, considered }
    }

    fn draw_rows(&self, generator: &mut Generator, errors: &mut [f64]) {
        let distribution = self.settings.rows.fixed();
        for ((error, uncertainty), &set) in errors.iter_mut().zip(&self.independent).zip(&self.set_of) {
            if *uncertainty > 0.0 {
                *error = uncertainty
                    * match distribution {
                        Some(distribution) => distribution.draw(generator),
                        None => self.residuals[set][generator.index(self.residuals[set].len())],
                    };
            }
        }
    }
}

fn words(distribution: Distribution) -> String {
    match distribution {
        Distribution::Normal => "normal".to_owned(),
        Distribution::Uniform => "rectangular".to_owned(),
        Distribution::Student(freedom) => format!("Student's t with {freedom} degrees of freedom"),
    }
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

/// The considered parameters, those of one source together.
fn sources(settings: &Settings, problem: &Problem) -> Result<Vec<Source>> {
    let considered = &problem.considered;
    let mut names: Vec<&String> = Vec::new();
    for source in considered.sources.iter().chain(problem.priors.iter().map(|prior| &prior.estimate)) {
        if !names.contains(&source) {
            names.push(source);
        }
    }
    if let Some(unknown) = settings.inputs.keys().find(|name| !names.contains(name)) {
        let message = format!("`{unknown}` is no known input with an uncertainty");
        let mut error = Error::usage(message).suggest(unknown, names.iter().map(|name| name.as_str()));
        error.setting = vec![PathItem::Key("inputs".to_owned()), PathItem::Key(unknown.clone())];
        return Err(error);
    }
    let sources = names.into_iter().map(|name| {
        let members: Vec<usize> =
            (0..considered.sources.len()).filter(|&member| considered.sources[member] == *name).collect();
        let prior = problem.priors.iter().position(|prior| prior.estimate == *name);
        let covariance = joint_covariance(problem, &members, prior);
        let distribution = settings.inputs.get(name).copied().unwrap_or_default();
        Source { root: root(&covariance), members, prior, distribution }
    });
    Ok(sources.collect())
}

/// The covariance of what a prior knows of unknowns, if there is one, and of some of what is considered.
fn joint_covariance(problem: &Problem, members: &[usize], prior: Option<usize>) -> DMatrix<f64> {
    let considered = &problem.considered;
    let prior = prior.map(|prior| &problem.priors[prior]);
    let known = prior.map_or(0, |prior| prior.values.len());
    let place = |member: usize| {
        let unknown = &considered.unknowns[members[member - known]];
        let same = |other: &Unknown| (other.owner, other.index) == (unknown.owner, unknown.index);
        prior.and_then(|prior| prior.unknowns.iter().position(same))
    };
    DMatrix::from_fn(known + members.len(), known + members.len(), |row, column| {
        if row >= known && column >= known {
            return considered.covariance[members[row - known]][members[column - known]];
        }
        let of = |index: usize| if index < known { Some(index) } else { place(index) };
        let found = prior.zip(of(row)).zip(of(column));
        found.map_or(0.0, |((prior, row), column)| prior.covariance[row][column])
    })
}

/// A matrix whose product with its transpose is the covariance, which may be singular.
fn root(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let size = covariance.nrows();
    let scale: Vec<f64> = (0..size).map(|row| covariance[(row, row)].max(0.0).sqrt()).collect();
    let unit = |row: usize| if scale[row] > 0.0 { scale[row] } else { 1.0 };
    let correlation = DMatrix::from_fn(size, size, |row, column| covariance[(row, column)] / unit(row) / unit(column));
    let eigen = SymmetricEigen::new(correlation);
    DMatrix::from_fn(size, size, |row, k| {
        scale[row] * eigen.eigenvectors[(row, k)] * eigen.eigenvalues[k].max(0.0).sqrt()
    })
}

impl Neglected {
    /// The parameters that a line under `vary` names, with distribution and standard uncertainty.
    fn parameters_of(&self, line: usize, problem: &Problem) -> Result<Vec<(Unknown, Distribution, f64)>> {
        let at = |mut error: Error, path: &[PathItem]| {
            error.setting = [&[PathItem::Key("vary".to_owned()), PathItem::Index(line)], path].concat();
            error
        };
        let mut found: Vec<(Unknown, Distribution, f64)> = Vec::new();
        let parameters = &problem.model.info().parameters;
        for (index, pattern) in self.parameters.iter().enumerate() {
            let path = [PathItem::Key("parameters".to_owned()), PathItem::Index(index)];
            let before = found.len();
            for (index, parameter) in parameters.iter().enumerate().filter(|(_, it)| matches(pattern, &it.name)) {
                let named = |unknown: &Unknown| unknown.name == parameter.name;
                if problem.machine_unknowns().iter().chain(&problem.considered.unknowns).any(named) {
                    let message =
                        format!("{} is estimated or known; only what is neglected varies here", parameter.name);
                    return Err(at(Error::usage(message), &path));
                }
                let (name, unit) = (parameter.name.clone(), parameter.unit);
                let unknown = Unknown { name, unit, owner: Owner::Machine, index };
                let size = self.size(&unknown, problem).map_err(|error| at(error, &[]))?;
                found.push((unknown, self.distribution, size));
            }
            if found.len() == before {
                let names = parameters.iter().map(|parameter| parameter.name.as_str());
                let message = format!("`{pattern}` matches no parameter of the machine");
                let help = "a neglected error exists only if the model's `errors` list it";
                return Err(at(Error::usage(message).help(help).suggest(pattern, names), &path));
            }
        }
        Ok(found)
    }

    /// The standard uncertainty in the unit of the parameter.
    fn size(&self, unknown: &Unknown, problem: &Problem) -> Result<f64> {
        if let Some(size) = self.standard_uncertainty {
            return Ok(size);
        }
        let (quantity, size) = match (self.at_end_of_travel_um, self.at_end_of_travel_urad) {
            (Some(size), _) => (Quantity::Length, size * 1e-3),
            (None, size) => (Quantity::Angle, size.unwrap_or_default() * 1e-6),
        };
        if unknown.unit.of != quantity {
            let other = if quantity == Quantity::Length { "at_end_of_travel_urad" } else { "at_end_of_travel_um" };
            return Err(Error::usage(format!("{} has the unit {}; use `{other}`", unknown.name, unknown.unit)));
        }
        let largest = largest_factor(unknown.index, problem)?;
        match largest > 0.0 {
            true => Ok(size / largest),
            false if unknown.unit.per.is_none() => Ok(size),
            false => Err(Error::usage(format!("{} has no effect on any row", unknown.name))
                .help("give its `standard_uncertainty`, or leave it out")),
        }
    }
}

/// The largest factor of a parameter in its motion error at the recorded statuses.
fn largest_factor(parameter: usize, problem: &Problem) -> Result<f64> {
    let functions = &problem.model.info().error_functions;
    let mut largest = 0.0_f64;
    for set in &problem.sets {
        for pose in set.poses_of(&set.rows) {
            for function in functions {
                let error = problem.model.motion_error(function, &problem.machine_values, set.poses().row(pose))?;
                let own = error.derivatives.iter().filter(|(index, _)| *index == parameter);
                largest = own.fold(largest, |largest, (_, factor)| largest.max(factor.abs()));
            }
        }
    }
    Ok(largest)
}

impl Pretravel {
    fn new(index: usize, setting: &LobingSetting, problem: &Problem) -> Result<Self> {
        let wrong = |mut error: Error| {
            error.setting = ["lobing", "artefact"].map(|key| PathItem::Key(key.to_owned())).into();
            error.setting.insert(1, PathItem::Index(index));
            error
        };
        let names = problem.sets.iter().map(|set| set.name.as_str());
        let Some(set) = problem.set_named(&setting.artefact) else {
            let message = format!("`{}` is not among the observations of the estimate", setting.artefact);
            return Err(wrong(Error::usage(message).suggest(&setting.artefact, names)));
        };
        let range = problem.equation_ranges()[set].clone();
        let directions = EquationIndex::enumerate(contact_directions(problem)?);
        let touches: Vec<(EquationIndex, [f64; 3])> = directions
            .filter_map(|(equation, direction)| Some((equation, direction?)))
            .filter(|(equation, _)| range.contains(*equation))
            .collect();
        if touches.is_empty() {
            return Err(wrong(Error::usage(format!("the rows of `{}` are no single touches", setting.artefact))));
        }
        Ok(Self { setting: setting.clone(), touches })
    }

    fn add(&self, generator: &mut Generator, errors: &mut [f64]) {
        let amplitude = self.setting.amplitude_um * 1e-3 * generator.normal();
        let phase = match self.setting.phase_deg {
            Some(phase) => phase.to_radians(),
            // A rectangular number of unit variance lies within plus and minus the root of three.
            None => std::f64::consts::PI * generator.uniform() / 3.0_f64.sqrt(),
        };
        let lobing = Lobing { amplitude, lobes: self.setting.lobes.get() as u32, phase };
        for &(equation, direction) in &self.touches {
            errors[equation] += lobing.pretravel_variation(direction);
        }
    }
}
