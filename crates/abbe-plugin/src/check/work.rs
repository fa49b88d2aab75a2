//! Whether a plugin computes at all, and whether one stage gets on with another.

use abbe_core::{KinematicModel, Plugin, Poses, Result};
use abbe_estimation::laws::samples;

use super::Findings;
use super::promises::{built, machines};
use crate::loader::Library;

/// Poses that are tried.
const POSES: usize = 8;

/// Positions of a machine.
fn positions(machine: &dyn KinematicModel, statuses: &[f64], values: &[f64]) -> Result<Vec<[f64; 3]>> {
    let mut out = Poses::default();
    machine.poses(statuses, values, &[], false, &mut out).map(|()| out.positions)
}

/// A machine whose tip stays where it is, whatever is commanded or wrong, would pass every law of derivatives.
pub(super) fn computes(library: &Library, findings: &mut Findings) {
    for (name, machine) in machines(library, findings) {
        let machine = machine.as_ref();
        let (statuses, values) = samples(machine, POSES);
        // A machine may refuse poses and values; what it takes is compared.
        let taken = |values: &[f64]| -> Vec<Option<[f64; 3]>> {
            let poses = statuses.chunks(machine.info().status.len().max(1));
            poses.map(|status| positions(machine, status, values).ok()?.first().copied()).collect()
        };
        let (found, without_errors) = (taken(&values), taken(&machine.info().nominal));
        let known: Vec<[f64; 3]> = found.iter().flatten().copied().collect();
        if known.len() < 2 {
            findings.skip(format!("`{name}`: it takes less than two of {POSES} poses"));
        } else if known.windows(2).all(|pair| pair[0] == pair[1]) {
            findings.wrong(format!("`{name}` computes nothing: the tip is at the same place for all commands"));
        }
        let pairs: Vec<_> =
            found.iter().zip(&without_errors).filter_map(|(one, other)| Some((*one)? == (*other)?)).collect();
        if !values.is_empty() && !pairs.is_empty() && pairs.iter().all(|is_same| *is_same) {
            findings.wrong(format!("`{name}`: no parameter changes any position"));
        }
    }
}

/// Two stages of one plugin at once: neither is refused, and neither changes the other.
pub(super) fn twice(library: &Library, findings: &mut Findings) {
    library.plugins.iter().for_each(|plugin| stands_beside_another(plugin, findings));
    // What cannot be built at all is told by other tests.
    let mut ignored = Findings::default();
    let (first, second) = (machines(library, &mut ignored), machines(library, &mut ignored));
    for ((name, one), (_, other)) in first.iter().zip(&second) {
        let (statuses, values) = samples(one.as_ref(), POSES);
        let (before, others) =
            (positions(one.as_ref(), &statuses, &values), positions(other.as_ref(), &statuses, &values));
        if before != others || before != positions(one.as_ref(), &statuses, &values) {
            findings.wrong(format!("`{name}`: two machines of the same settings give different positions"));
        }
    }
}

fn stands_beside_another(plugin: &Plugin, findings: &mut Findings) {
    let example = plugin.example.get();
    // The test of settings reports an example that cannot be built.
    let Ok(first) = built(plugin, example) else { return };
    if let Err(error) = built(plugin, example) {
        findings.wrong(format!("`{}` cannot be created a second time: {error}", plugin.name));
    }
    drop(first);
    if let Err(error) = built(plugin, example) {
        findings.wrong(format!("`{}` cannot be created again after it was let go of: {error}", plugin.name));
    }
}
