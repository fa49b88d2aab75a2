//! Neglected errors: parameters of the machine that are not estimated and vary from trial to trial.

use abbe_core::{Error, Owner, PathItem, Problem, Quantity, Result, Unknown, matches};

use crate::settings::{Distribution, Neglected};

/// A neglected parameter, its distribution and its standard uncertainty.
pub type Varied = (Unknown, Distribution, f64);

impl Neglected {
    /// The parameters that a line under `vary` names; `largest` gives the largest factor of one in its motion error ([`largest_factor`]).
    pub fn parameters_of(
        &self,
        line: usize,
        problem: &Problem,
        largest: &dyn Fn(usize) -> Result<f64>,
    ) -> Result<Vec<Varied>> {
        let at = |mut error: Error, path: &[PathItem]| {
            error.setting = [&[PathItem::Key("vary".to_owned()), PathItem::Index(line)], path].concat();
            error
        };
        let mut found: Vec<Varied> = Vec::new();
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
                let size = self.size(&unknown, largest).map_err(|error| at(error, &[]))?;
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
    fn size(&self, unknown: &Unknown, largest: &dyn Fn(usize) -> Result<f64>) -> Result<f64> {
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
        let largest = largest(unknown.index)?;
        match largest > 0.0 {
            true => Ok(size / largest),
            false if unknown.unit.per.is_none() => Ok(size),
            false => Err(Error::usage(format!("{} has no effect on any row", unknown.name))
                .help("give its `standard_uncertainty`, or leave it out")),
        }
    }
}

/// The largest factor of a parameter in its motion error at the recorded statuses.
pub fn largest_factor(parameter: usize, problem: &Problem) -> Result<f64> {
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
