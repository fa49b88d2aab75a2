//! Unknowns that rows tell at the nominal places of an artefact, and hardly where they were recorded.
//!
//! What rows tell is judged in nominal contact, where errors of the machine cannot pass for information. A nominal place that is wrong can:
//! a height that is off by less than a millimetre separates what a section of a cylinder does not. The rows themselves know nothing of it.

use abbe_core::Problem;
use abbe_numerics::CovarianceRoot;

/// Times of its standard uncertainty in nominal contact from which that of an unknown at the recorded positions is told.
const WORSE: f64 = 3.0;

/// Most unknowns that are named.
const NAMED: usize = 4;

/// The sentence on unknowns that the recorded positions tell far less of than nominal contact does, the worst first.
pub(crate) fn told_by_nominal_places(
    problem: &Problem,
    in_contact: &CovarianceRoot,
    recorded: &CovarianceRoot,
) -> Option<String> {
    let pairs = recorded.standard_uncertainties().into_iter().zip(in_contact.standard_uncertainties());
    let ratios = problem.unknowns.iter().zip(pairs.map(|(recorded, in_contact)| recorded / in_contact));
    let mut worse: Vec<(&str, f64)> =
        ratios.filter(|(_, ratio)| *ratio > WORSE).map(|(unknown, ratio)| (unknown.name.as_str(), ratio)).collect();
    worse.sort_by(|(_, one), (_, other)| other.total_cmp(one));
    let (_, most) = worse.first()?;
    let named: Vec<&str> = worse.iter().take(NAMED).map(|(name, _)| *name).collect();
    let more = if worse.len() > NAMED { format!(" and {} more", worse.len() - NAMED) } else { String::new() };
    Some(format!(
        "{}{more}: the touches as they were recorded tell this far less well than touches at the nominal places would; standard \
         uncertainties there are up to {most:.0} times as large. The nominal places may be wrong, and these values are not to be trusted",
        named.join(", ")
    ))
}
