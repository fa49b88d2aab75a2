//! The parts of the page, from verdict to provenance.

mod acceptance;
mod around;
mod causes;
mod curves;
mod held_out;
mod history;
mod parameters;
mod probe;
mod provenance;
mod residuals;
mod scene;
mod selection;
mod tables;
mod trend;
mod uncertainty;
mod untold;
mod verdict;

pub use acceptance::{AcceptanceTable, acceptance};
pub use causes::{causes, compared, compared_cells};
pub use curves::curves;
pub use history::history;
pub use parameters::parameters;
pub use probe::{has_lobes, probe};
pub use provenance::provenance;
use residuals::RINGED;
pub use residuals::residuals;
pub use scene::Scene;
pub use selection::selection;
pub use tables::tables;
pub use trend::trend;
pub use uncertainty::{budget, correlations};
pub use untold::untold;
pub use verdict::{decided, judged, judged_remarks, told_figure, undetermined, used, verdict};

use crate::number::{short, sized};

/// Uncertainties below this are rounding, µm.
pub const ROUNDING_UM: f64 = 1e-4;

/// A length in mm as µm, with its expanded uncertainty (k = 2).
pub fn micrometres(known: abbe_volumetric::Known) -> String {
    format!("{} µm", sized(known.value * 1e3, 2.0 * known.uncertainty * 1e3, ROUNDING_UM))
}

/// The unit of a figure as people write it: `um/m3` is µm/m³.
pub fn unit_of(unit: &str) -> String {
    if unit == "1" {
        return String::new();
    }
    unit.split('/').map(part_of_unit).collect::<Vec<_>>().join("/")
}

fn part_of_unit(part: &str) -> String {
    let symbol = part.trim_end_matches(|letter: char| letter.is_ascii_digit() || letter == '^');
    let power = part[symbol.len()..].chars().filter_map(|digit| "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().nth(digit.to_digit(10)? as usize));
    let symbol = match symbol {
        "um" => "µm",
        "urad" => "µrad",
        "deg" => "°",
        "degC" => "°C",
        // A number alone is no power.
        "" => return part.to_owned(),
        other => other,
    };
    symbol.chars().chain(power).collect()
}

/// The value of a figure with its unit.
pub fn valued(value: f64, unit: &str) -> String {
    let counted = unit == "1" && value.fract() == 0.0 && value.abs() < 1e9;
    let text = if counted { format!("{value:.0}") } else { short(value) };
    if unit == "1" { text } else { format!("{text} {}", unit_of(unit)) }
}

#[cfg(test)]
mod tests {
    use super::unit_of;

    #[test]
    fn units_of_figures_are_those_that_people_write() {
        for (key, people) in [
            ("1", ""),
            ("um", "µm"),
            ("um/m3", "µm/m³"),
            ("urad/m2", "µrad/m²"),
            ("um/m/K", "µm/m/K"),
            ("um/rad^4", "µm/rad⁴"),
            ("deg", "°"),
            ("degC", "°C"),
            ("1/K", "1/K"),
            ("mm", "mm"),
            ("%", "%"),
        ] {
            assert_eq!(unit_of(key), people);
        }
    }
}
