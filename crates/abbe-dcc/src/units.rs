//! Units of the D-SI in the units of memory.

use abbe_core::{Quantity, Unit};

/// Powers of mm, rad, s, K and N.
type Powers = [i32; 5];

/// A unit: how much of the units of memory it is, and of which.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DsiUnit {
    /// The factor to the units of memory.
    pub(crate) factor: f64,
    pub(crate) powers: Powers,
    /// It is a temperature in °C, which counts from elsewhere than one in K.
    pub(crate) is_celsius: bool,
}

/// Prefixes with their factors.
const PREFIXES: [(&str, f64); 12] = [
    ("giga", 1e9),
    ("mega", 1e6),
    ("kilo", 1e3),
    ("hecto", 1e2),
    ("deca", 1e1),
    ("deci", 1e-1),
    ("centi", 1e-2),
    ("milli", 1e-3),
    ("micro", 1e-6),
    ("nano", 1e-9),
    ("pico", 1e-12),
    ("femto", 1e-15),
];

impl DsiUnit {
    const ONE: Self = Self { factor: 1.0, powers: [0; 5], is_celsius: false };

    /// A unit as the D-SI writes it: `\milli\metre\tothe{2}`. None for one of another kind (`\kilogram`) and for what is no unit.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let mut whole = Self::ONE;
        let (mut prefix, mut sign, mut last) = (1.0, 1, None);
        let mut is_celsius_alone = false;
        for (place, token) in text.strip_prefix('\\')?.split('\\').enumerate() {
            if let Some(power) = token.strip_prefix("tothe{").and_then(|rest| rest.strip_suffix('}')) {
                let power: i32 = power.parse().ok().filter(|power| (-9..=9).contains(power))?;
                // The factor was counted once already.
                whole = whole.times(last?, power - 1);
                last = None;
            } else if token == "per" {
                sign = -1;
            } else if let Some((_, factor)) = PREFIXES.iter().find(|(name, _)| *name == token) {
                prefix *= factor;
            } else {
                let mut factor = base(token)?;
                factor.factor *= prefix;
                let factor = Self::ONE.times(factor, sign);
                is_celsius_alone = place == 0 && token.eq_ignore_ascii_case("degreecelsius");
                whole = whole.times(factor, 1);
                (prefix, sign, last) = (1.0, 1, Some(factor));
            }
        }
        let is_whole = prefix == 1.0 && sign == 1;
        whole.is_celsius = is_celsius_alone && whole.powers == [0, 0, 0, 1, 0];
        is_whole.then_some(whole)
    }

    /// This times a power of another.
    pub(crate) fn times(mut self, other: Self, power: i32) -> Self {
        self.factor *= other.factor.powi(power);
        self.powers.iter_mut().zip(other.powers).for_each(|(own, other)| *own += power * other);
        self
    }

    /// Whether it is of the same kind as the unit of a parameter.
    pub(crate) fn is_of(&self, unit: Unit) -> bool {
        powers(unit) == Some(self.powers)
    }
}

/// A unit without prefix.
fn base(name: &str) -> Option<DsiUnit> {
    let degree = std::f64::consts::PI / 180.0;
    let (factor, powers) = match name {
        "one" => (1.0, [0, 0, 0, 0, 0]),
        "percent" => (1e-2, [0, 0, 0, 0, 0]),
        "ppm" => (1e-6, [0, 0, 0, 0, 0]),
        "metre" | "meter" => (1e3, [1, 0, 0, 0, 0]),
        "radian" => (1.0, [0, 1, 0, 0, 0]),
        "degree" => (degree, [0, 1, 0, 0, 0]),
        "arcminute" => (degree / 60.0, [0, 1, 0, 0, 0]),
        "arcsecond" => (degree / 3600.0, [0, 1, 0, 0, 0]),
        "second" => (1.0, [0, 0, 1, 0, 0]),
        "minute" => (60.0, [0, 0, 1, 0, 0]),
        "hour" => (3600.0, [0, 0, 1, 0, 0]),
        "kelvin" | "degreecelsius" | "degreeCelsius" => (1.0, [0, 0, 0, 1, 0]),
        "newton" => (1.0, [0, 0, 0, 0, 1]),
        _ => return None,
    };
    Some(DsiUnit { factor, powers, is_celsius: false })
}

fn powers(unit: Unit) -> Option<Powers> {
    let mut powers = of(unit.of)?;
    let below = unit.per.into_iter().chain(unit.and_per.map(|per| (per, 1)));
    for (per, power) in below {
        of(per)?.iter().zip(&mut powers).for_each(|(of, own)| *own -= of * i32::from(power));
    }
    Some(powers)
}

fn of(quantity: Quantity) -> Option<Powers> {
    Some(match quantity {
        Quantity::Ratio => [0; 5],
        Quantity::Length => [1, 0, 0, 0, 0],
        Quantity::Angle => [0, 1, 0, 0, 0],
        Quantity::Time => [0, 0, 1, 0, 0],
        Quantity::Temperature => [0, 0, 0, 1, 0],
        Quantity::Force => [0, 0, 0, 0, 1],
        Quantity::PerTemperature => [0, 0, 0, -1, 0],
        Quantity::Speed => [1, 0, -1, 0, 0],
        Quantity::Label | Quantity::RotationalSpeed => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_read_with_prefix_power_and_per() {
        for (text, factor, unit) in [
            (r"\metre", 1e3, "mm"),
            (r"\milli\metre", 1.0, "mm"),
            (r"\micro\metre", 1e-3, "mm"),
            (r"\micro\radian", 1e-6, "rad"),
            (r"\arcsecond", 4.848_136_811_095_36e-6, "rad"),
            (r"\one", 1.0, "1"),
            (r"\percent", 1e-2, "1"),
            (r"\micro\metre\metre\tothe{-1}", 1e-6, "mm/mm"),
            (r"\micro\metre\per\metre", 1e-6, "mm/mm"),
            (r"\milli\metre\radian\tothe{-2}", 1.0, "mm/rad^2"),
            (r"\radian\milli\metre\tothe{-1}\kelvin\tothe{-1}", 1.0, "rad/(mm K)"),
            (r"\kelvin\tothe{-1}", 1.0, "1/K"),
            (r"\degreecelsius", 1.0, "degC"),
        ] {
            let found = DsiUnit::parse(text).unwrap_or_else(|| panic!("{text}"));
            assert!((found.factor / factor - 1.0).abs() < 1e-12, "{text}: {}", found.factor);
            assert!(found.is_of(unit.parse().expect("a unit")), "{text}");
        }
        assert!(DsiUnit::parse(r"\degreecelsius").is_some_and(|unit| unit.is_celsius));
        assert!(DsiUnit::parse(r"\milli\metre").is_some_and(|unit| !unit.is_of(Unit::RAD)));
        for text in ["", "metre", r"\kilo\gram", r"\milli", r"\metre\per", r"\metre\tothe{x}", r"\tothe{2}", r"\\metre"]
        {
            assert_eq!(DsiUnit::parse(text), None, "{text}");
        }
        assert_eq!(DsiUnit::parse(r"\milli\metre\tothe{2}").map(|unit| unit.factor), Some(1.0));
        assert_eq!(DsiUnit::parse(r"\metre\tothe{2}").map(|unit| unit.factor), Some(1e6));
    }
}
