//! What an artefact may be made of (Muelaner et al. 2014, section 3.4, eq. 1 and Table 1).

use abbe_core::{SettingsError, positive};
use schemars::JsonSchema;
use serde::Deserialize;

/// Materials of Table 1, best last, with the coefficient in 1e-6/K that the largest admissible one has to exceed.
pub const MATERIALS: [(&str, f64); 3] = [("aluminium", 23.0), ("tool steel", 11.0), ("Invar", 1.2)];

/// The largest coefficient of expansion, 1e-6/K, with which an artefact of `length` metres stays within `tolerance` µm while the
/// temperature keeps within plus and minus `half_range` K: `E = tolerance / (safety · length · half range)`.
pub fn largest_expansion(tolerance_um: f64, length_m: f64, half_range: f64, safety: f64) -> f64 {
    tolerance_um / (safety * length_m * half_range)
}

/// The first material of Table 1 that will do. Its coefficient has to be exceeded: 1.2, the paper's own example, does not
/// admit Invar, and calls for the temperature to be monitored.
pub fn material(largest_expansion: f64) -> Option<&'static str> {
    MATERIALS.iter().find(|(_, coefficient)| largest_expansion > *coefficient).map(|(name, _)| *name)
}

/// The artefact and its surroundings.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(non_snake_case)] // Settings end in their unit.
pub struct ArtefactSettings {
    /// Largest length over which the artefact is probed.
    #[schemars(range(min = 1e-3, max = 1e6))]
    pub length_mm: f64,
    /// Half the range of the temperature: the temperature stays within plus and minus this value.
    pub temperature_half_range_degC: f64,
    /// Factor of safety; 2 in the paper.
    #[serde(default = "two")]
    pub safety_factor: f64,
    /// Coefficient of expansion of the artefact that is used, if it is known.
    #[serde(default)]
    pub expansion_per_K: Option<f64>,
}

fn two() -> f64 {
    2.0
}

/// No solid expands as much, 1/K: the coefficient is in another unit.
const LARGEST_EXPANSION: f64 = 1e-3;

impl ArtefactSettings {
    /// Refuses what is not positive.
    pub fn check(&self) -> Result<(), SettingsError> {
        positive("length_mm", self.length_mm)?;
        positive("temperature_half_range_degC", self.temperature_half_range_degC)?;
        positive("safety_factor", self.safety_factor)?;
        let Some(expansion) = self.expansion_per_K else { return Ok(()) };
        match positive("expansion_per_K", expansion)? < LARGEST_EXPANSION {
            true => Ok(()),
            false => Err(SettingsError::new(
                "expansion_per_K",
                format!("{expansion} was found; steel has 11.5e-6, and no material {LARGEST_EXPANSION}"),
            )),
        }
    }

    /// The largest admissible coefficient at a tolerance, 1e-6/K, and what follows from it in words.
    pub fn advise(&self, tolerance_um: f64) -> (f64, String) {
        let (half_range, safety) = (self.temperature_half_range_degC, self.safety_factor);
        let largest = largest_expansion(tolerance_um, self.length_mm * 1e-3, half_range, safety);
        let mut text = match material(largest) {
            Some(name) => {
                format!("at {tolerance_um} µm the artefact may be of {name} (expansion below {largest:.2} µm/m per K)")
            }
            None => format!(
                "at {tolerance_um} µm not even Invar will do (expansion below {largest:.2} µm/m per K): monitor the temperature"
            ),
        };
        if let Some(own) = self.expansion_per_K.map(|own| own * 1e6).filter(|own| *own >= largest) {
            text.push_str(&format!("; the artefact expands by {own:.2} µm/m per K, which is too much"));
        }
        (largest, text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_that_of_the_paper_and_its_limits_are_to_be_exceeded() {
        let cases = [
            (24.0, Some("aluminium")),
            (23.0, Some("tool steel")),
            (11.1, Some("tool steel")),
            (11.0, Some("Invar")),
            (1.3, Some("Invar")),
            (1.2, None),
            (0.5, None),
        ];
        for (largest, expected) in cases {
            assert_eq!(material(largest), expected, "{largest}");
        }
    }

    #[test]
    fn the_worked_example_of_the_paper_gives_exactly_what_does_not_do() {
        let largest = largest_expansion(12.0, 1.0, 5.0, 2.0);
        assert_eq!((largest, material(largest)), (1.2, None));
        // A short artefact in a room of plus and minus 1 K.
        assert_eq!(material(largest_expansion(12.0, 0.16, 1.0, 2.0)), Some("aluminium"));
    }

    #[test]
    fn an_artefact_that_expands_too_much_is_told() {
        let settings = ArtefactSettings {
            length_mm: 160.0,
            temperature_half_range_degC: 2.0,
            safety_factor: 2.0,
            expansion_per_K: Some(11.5e-6),
        };
        let (largest, text) = settings.advise(4.0);
        assert_eq!(largest, 6.25);
        assert!(text.contains("Invar") && text.ends_with("which is too much"), "{text}");
        assert!(!settings.advise(12.0).1.contains("too much"));
    }
}
