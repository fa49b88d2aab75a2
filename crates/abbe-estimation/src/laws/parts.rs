//! The law of estimators that take rows in parts.

use std::collections::BTreeMap;
use std::sync::Arc;

use abbe_core::{AskedOfPart, Calibration, Class, Estimate, PartEvidence, Parts, Problem, Result};

use crate::parts::part_evidence;

/// By how much an estimate from parts may differ from that of all rows, in stated standard uncertainties.
const ALLOWED: f64 = 1e-8;

/// The parts of a problem whose rows are all here.
struct Here(Vec<Problem>);

impl Parts for Here {
    fn count(&self) -> usize {
        self.0.len()
    }

    fn evidence(&self, part: usize, asked: AskedOfPart, at: &BTreeMap<String, f64>) -> Result<Arc<PartEvidence>> {
        let values: Vec<f64> = self.0[part].unknowns.iter().map(|unknown| at[&unknown.name]).collect();
        part_evidence(&self.0[part], asked, &values).map(Arc::new)
    }
}

/// Whether an estimator that takes rows in parts makes of `count` parts what it makes of all rows: values, uncertainties, scatter. Empty
/// if it does, if it does not take parts, or if the rows depend on each other.
///
/// Fails if the estimate of all rows does.
pub fn check_parts(estimator: &dyn Estimate, problem: &Problem, count: usize) -> Result<Vec<String>> {
    if estimator.accepts_parts().is_err() {
        return Ok(Vec::new());
    }
    let all = estimator.explain(problem)?;
    let part = |part: usize| {
        let mut own = problem.clone();
        for set in &mut own.sets {
            let rows = std::mem::take(&mut set.rows);
            set.rows = rows.into_iter().enumerate().filter(|(index, _)| index % count == part).map(|it| it.1).collect();
        }
        own
    };
    let mut without_rows = problem.clone();
    without_rows.sets.iter_mut().for_each(|set| set.rows.clear());
    match estimator.estimate_parts(&without_rows, &Here((0..count).map(part).collect())) {
        Ok(found) => Ok(differences(&all, &found)),
        Err(error) if error.class == Class::Use => Ok(Vec::new()),
        Err(error) => Ok(vec![format!("from {count} parts it fails: {error}")]),
    }
}

fn differences(all: &Calibration, found: &Calibration) -> Vec<String> {
    let (one, other) = (&all.fit, &found.fit);
    let mut broken = Vec::new();
    if (one.observations, one.rank, one.degrees_of_freedom)
        != (other.observations, other.rank, other.degrees_of_freedom)
    {
        broken.push(format!("all rows have rank {} and parts {}, or another number of rows", one.rank, other.rank));
    }
    if (one.sigma - other.sigma).abs() > ALLOWED * one.sigma.max(1.0) {
        broken.push(format!("all rows scatter by {:e}, parts by {:e}", one.sigma, other.sigma));
    }
    let budgets = all.uncertainty.iter().zip(&found.uncertainty);
    for (own, of_parts) in budgets.flat_map(|(all, found)| all.parameters.iter().zip(&found.parameters)) {
        let allowed = ALLOWED * own.stated_standard_uncertainty;
        let value = |calibration: &Calibration| calibration.get(&own.name).map_or(f64::NAN, |known| known.value);
        let apart = (value(all) - value(found)).abs();
        let uncertainties = (own.stated_standard_uncertainty - of_parts.stated_standard_uncertainty).abs();
        if own.name != of_parts.name || !(apart <= allowed && uncertainties <= allowed) {
            broken.push(format!(
                "`{}` is {:e} (stated uncertainty {:e}) from all rows, and {:e} ({:e}) from parts",
                own.name,
                value(all),
                own.stated_standard_uncertainty,
                value(found),
                of_parts.stated_standard_uncertainty
            ));
        }
    }
    broken
}
