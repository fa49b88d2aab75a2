//! Identifiability: rank, lost directions, weakly determined directions.

use abbe_core::{Combination, Error, Identifiability, Problem, WeakDirection};
use abbe_numerics::{Factor, SingularValues, Spectrum};

use crate::judgement::at_nominal_geometry;
use crate::separation::SeparationTrials;

/// Number of weakest combinations that are told.
const WEAKEST: usize = 5;

/// Part of the largest effect from which an unknown is named in a weak combination.
const NAMED: f64 = 0.1;

/// Rank, condition and lost directions.
pub fn identifiability(problem: &Problem, factor: &Factor, tolerance: f64) -> Identifiability {
    let singular_values = factor.singular_values();
    let rank = singular_values.rank(tolerance);
    let found = identified(problem, factor, &singular_values, rank);
    match rank < factor.unknowns() {
        true => Identifiability { null_space: null_space(problem, &factor.spectrum(), rank), ..found },
        false => found,
    }
}

/// The same, with the combinations that are determined worst.
pub fn explained_identifiability(problem: &Problem, factor: &Factor, tolerance: f64) -> Identifiability {
    let spectrum = factor.spectrum();
    let rank = spectrum.singular_values().rank(tolerance);
    Identifiability {
        null_space: null_space(problem, &spectrum, rank),
        weakest: weakest(problem, &spectrum, rank),
        ..identified(problem, factor, spectrum.singular_values(), rank)
    }
}

/// Rank and condition alone.
fn identified(problem: &Problem, factor: &Factor, values: &SingularValues, rank: usize) -> Identifiability {
    Identifiability {
        observations: factor.rows(),
        unknowns: problem.unknowns.len(),
        rank,
        condition: values.condition(rank),
        null_space: Vec::new(),
        weakest: Vec::new(),
        equivalent_motion_errors: Vec::new(),
        uncertainty: None,
        remarks: Vec::new(),
    }
}

/// The lost directions with the names and in the units of the unknowns, those with the largest effect first.
pub(crate) fn null_space(problem: &Problem, spectrum: &Spectrum, rank: usize) -> Vec<WeakDirection> {
    let basis = spectrum.null_basis(rank).into_iter();
    basis.map(|(singular_value, direction)| named(problem, spectrum, singular_value, &direction, 0.0)).collect()
}

/// The combinations with the smallest singular values within `rank`, the weakest first.
pub fn weakest(problem: &Problem, spectrum: &Spectrum, rank: usize) -> Vec<WeakDirection> {
    let values = spectrum.singular_values().values();
    let largest = values.first().copied().unwrap_or(1.0);
    let weakest = (0..rank).rev().take(WEAKEST);
    weakest.map(|k| named(problem, spectrum, values[k] / largest, &spectrum.direction(k), NAMED)).collect()
}

/// A direction in scaled unknowns, in the units of the unknowns; those below `least` times the largest effect are left out.
fn named(problem: &Problem, spectrum: &Spectrum, singular_value: f64, direction: &[f64], least: f64) -> WeakDirection {
    let largest = direction.iter().fold(0.0, |largest: f64, effect| largest.max(effect.abs()));
    let mut parts: Vec<(f64, Combination)> = Vec::new();
    for (unknown, (&effect, &scale)) in problem.unknowns.iter().zip(direction.iter().zip(spectrum.scale())) {
        if effect != 0.0 && effect.abs() >= least * largest {
            let combination =
                Combination { name: unknown.name.clone(), coefficient: effect * scale, unit: unknown.unit.to_string() };
            parts.push((effect.abs(), combination));
        }
    }
    // Effects that differ by rounding only stay in the order of the unknowns, on any machine.
    let size = |part: &(f64, Combination)| (part.0 / largest * 1e6).round();
    parts.sort_by(|a, b| size(b).total_cmp(&size(a)));
    let unit = parts.first().map_or(1.0, |(_, largest)| largest.coefficient);
    let combination = parts.into_iter().map(|(_, mut part)| {
        part.coefficient /= unit;
        part
    });
    WeakDirection { singular_value, combination: combination.collect(), separated_by: Vec::new() }
}

/// The same with the measurements that separate what is lost. Where none can be told, nothing is.
pub fn separated(problem: &Problem, mut found: Identifiability) -> Identifiability {
    if found.null_space.is_empty() {
        return found;
    }
    let nominal = at_nominal_geometry(problem);
    if let Ok(trials) = SeparationTrials::new(&nominal, &nominal.start()) {
        for vector in &mut found.null_space {
            vector.separated_by = trials.separating(vector).unwrap_or_default();
        }
    }
    found
}

/// The condition from which unknowns are at the mercy of the noise: an error of one reading by its uncertainty moves them by a million
/// times what it moves an unknown that the readings tell directly.
pub(crate) const ILL_CONDITIONED: f64 = 1e6;

/// What people should know of the combinations that the data hardly determine; none if the condition is not above `least`. `factor` is
/// that of a [`Judgement`](crate::Judgement).
pub fn ill_conditioned(problem: &Problem, factor: &Factor, tolerance: f64, least: f64) -> Option<String> {
    let singular_values = factor.singular_values();
    let rank = singular_values.rank(tolerance);
    let condition = singular_values.condition(rank);
    if condition <= least {
        return None;
    }
    let mut weak = weakest(problem, &factor.spectrum(), rank);
    weak.retain(|vector| vector.singular_value * least < 1.0);
    let nominal = at_nominal_geometry(problem);
    let trials = SeparationTrials::new(&nominal, &nominal.start()).ok();
    let told = weak.iter().map(|vector| {
        let advice = trials.as_ref().and_then(|trials| trials.separating(vector).ok()?.into_iter().next());
        let advice = advice.map_or_else(String::new, |advice| format!("; {advice}"));
        format!("- {} (to one part in {:.0e}){advice}", vector.changes(), 1.0 / vector.singular_value)
    });
    Some(format!(
        "the condition is {condition:.1e}: the data hardly tell these changes, and what they are is at the mercy of the noise:\n{}\nmeasure \
         what tells them apart, leave one of each out, or let a `rank_tolerance` above {:.0e} count them as lost, with `on_confounded: drop`",
        told.collect::<Vec<_>>().join("\n"),
        weak.iter().map(|vector| vector.singular_value).fold(0.0, f64::max)
    ))
}

/// The error for data that cannot determine what was chosen.
pub fn confounded(found: &Identifiability) -> Error {
    let lost: Vec<String> = found.null_space.iter().map(WeakDirection::advise).collect();
    Error::data(format!(
        "the data determine {} of {} unknowns:\n- {}",
        found.rank,
        found.unknowns,
        lost.join("\n- ")
    ))
    .help("leave what has no effect and one of each combination out of `parameters`, add measurements that tell them apart, or set `on_confounded`")
}
