//! Lobing of the probe, whose amplitude and phase vary from trial to trial.

use abbe_core::{EquationIndex, Error, PathItem, Problem, Result};
use abbe_numerics::Generator;
use abbe_simulation::{Lobing, contact_directions};

use crate::settings::LobingSetting;

/// Lobing that affects some equations.
pub struct Pretravel {
    /// How it varies.
    pub setting: LobingSetting,
    /// Equations with their directions of contact.
    touches: Vec<(EquationIndex, [f64; 3])>,
}

impl Pretravel {
    /// The touches of the rows of a problem.
    ///
    /// Fails where the artefact is not there, or has rows that are no single touches.
    pub fn new(index: usize, setting: &LobingSetting, problem: &Problem) -> Result<Self> {
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

    /// Adds what one lobing makes of the touches.
    pub fn add(&self, lobing: &Lobing, errors: &mut [f64]) {
        for &(equation, direction) in &self.touches {
            errors[equation] += lobing.pretravel_variation(direction);
        }
    }
}

impl LobingSetting {
    /// The lobing of one trial.
    pub fn draw(&self, generator: &mut Generator) -> Lobing {
        let amplitude = self.amplitude_um * 1e-3 * generator.normal();
        let phase = match self.phase_deg {
            Some(phase) => phase.to_radians(),
            // A rectangular number of unit variance lies within plus and minus the root of three.
            None => std::f64::consts::PI * generator.uniform() / 3.0_f64.sqrt(),
        };
        Lobing { amplitude, lobes: self.lobes.get() as u32, phase }
    }
}
