//! What the data determine: rank, lost directions, weak ones.

use abbe_core::{Combination, Error, Identifiability, NullVector, Problem};
use abbe_numerics::{Factor, Spectrum};

use crate::separation::SeparationTrials;

/// Number of weakest combinations that are told.
const WEAKEST: usize = 5;

/// Part of the largest effect from which an unknown is named in a weak combination.
const NAMED: f64 = 0.1;

/// Rank, condition and lost directions.
pub fn identifiability(problem: &Problem, factor: &Factor, tolerance: f64) -> Identifiability {
    let singular_values = factor.singular_values();
    let rank = singular_values.rank(tolerance);
    let null_space = if rank < factor.unknowns() { null_space(problem, &factor.spectrum(), rank) } else { Vec::new() };
    Identifiability {
        observations: factor.rows(),
        unknowns: problem.unknowns.len(),
        rank,
        condition: singular_values.condition(rank),
        null_space,
        weakest: Vec::new(),
        same_motion: Vec::new(),
        uncertainty: None,
        remarks: Vec::new(),
    }
}

/// The lost directions with the names and in the units of the unknowns, those with the largest effect first.
fn null_space(problem: &Problem, spectrum: &Spectrum, rank: usize) -> Vec<NullVector> {
    let basis = spectrum.null_basis(rank).into_iter();
    basis.map(|(singular_value, direction)| named(problem, spectrum, singular_value, &direction, 0.0)).collect()
}

/// The combinations with the smallest singular values within `rank`, the weakest first.
pub fn weakest(problem: &Problem, spectrum: &Spectrum, rank: usize) -> Vec<NullVector> {
    let values = spectrum.singular_values().values();
    let largest = values.first().copied().unwrap_or(1.0);
    let weakest = (0..rank).rev().take(WEAKEST);
    weakest.map(|k| named(problem, spectrum, values[k] / largest, &spectrum.direction(k), NAMED)).collect()
}

/// A direction in scaled unknowns, in the units of the unknowns; those below `least` times the largest effect are left out.
fn named(problem: &Problem, spectrum: &Spectrum, singular_value: f64, direction: &[f64], least: f64) -> NullVector {
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
    NullVector { singular_value, combination: combination.collect(), separated_by: Vec::new() }
}

/// The same with the measurements that separate what is lost at `x`. Where none can be told, nothing is.
pub fn separated(problem: &Problem, x: &[f64], mut found: Identifiability) -> Identifiability {
    if found.null_space.is_empty() {
        return found;
    }
    if let Ok(trials) = SeparationTrials::new(problem, x) {
        for vector in &mut found.null_space {
            vector.separated_by = trials.separating(vector).unwrap_or_default();
        }
    }
    found
}

/// The error for data that cannot determine what was chosen.
pub fn confounded(found: &Identifiability) -> Error {
    let lost: Vec<String> = found.null_space.iter().map(NullVector::advise).collect();
    Error::data(format!(
        "the data determine {} of {} unknowns:\n- {}",
        found.rank,
        found.unknowns,
        lost.join("\n- ")
    ))
    .help("leave what has no effect and one of each combination out of `parameters`, add measurements that tell them apart, or set `on_confounded`")
}
