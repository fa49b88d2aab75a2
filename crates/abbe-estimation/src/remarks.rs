//! Remarks on a problem that users should know before they trust its results.

use abbe_core::{Owner, ParameterRole, Problem};

use crate::aliasing::aliased;

/// Most forgotten unknowns that a remark names.
const NAMED: usize = 3;

/// Sentences on effects of the choice of rows and unknowns: aliasing ([`aliased`]), and zeros of instruments that are not
/// estimated.
pub fn remarks(problem: &Problem) -> Vec<String> {
    let mut remarks = aliased(problem);
    remarks.extend(forgotten(problem));
    remarks
}

/// Own unknowns of the set-up ([`ParameterRole::SetUp`]) that are neither estimated nor known from an earlier estimate: their
/// values then change the estimated errors of the machine.
fn forgotten(problem: &Problem) -> Option<String> {
    let mut names = Vec::new();
    for (index, set) in problem.sets.iter().enumerate() {
        let mut settled = vec![false; set.own.len()];
        for unknown in problem.unknowns.iter().chain(&problem.considered.unknowns) {
            if unknown.owner == Owner::Set(index) {
                settled[unknown.index] = true;
            }
        }
        let own = set.info().unknowns.iter().zip(settled);
        let own = own.filter(|(own, settled)| own.role == ParameterRole::SetUp && !settled);
        names.extend(own.map(|(own, _)| format!("{}.{}", set.name, own.name)));
    }
    let more = names.len().saturating_sub(NAMED);
    names.truncate(NAMED);
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    (!names.is_empty()).then(|| {
        format!(
            "{}{rest} count as zero, and what they are goes into the errors of the machine: list them under `parameters`",
            names.join(", ")
        )
    })
}
