//! Units: the suffixes of columns and settings, and the units of parameters.

use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};

/// The kind of quantity of a column or a parameter. In memory each kind has one unit only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// An identifier: text that is compared, never computed with.
    Label,
    /// Dimensionless number, and ratios such as mm/mm.
    Ratio,
    /// mm.
    Length,
    /// rad.
    Angle,
    /// s.
    Time,
    /// °C.
    Temperature,
    /// N.
    Force,
    /// 1/K.
    PerTemperature,
    /// Revolutions per minute.
    RotationalSpeed,
    /// mm/s.
    Speed,
}

/// Suffix, quantity, and the factor that turns a value with that suffix into the unit used in memory.
const SUFFIXES: [(&str, Quantity, f64); 15] = [
    ("_um_per_m", Quantity::Ratio, 1e-6),
    ("_per_K", Quantity::PerTemperature, 1.0),
    ("_mm_per_min", Quantity::Speed, 1.0 / 60.0),
    ("_mm_per_s", Quantity::Speed, 1.0),
    ("_mm", Quantity::Length, 1.0),
    ("_um", Quantity::Length, 1e-3),
    ("_deg", Quantity::Angle, std::f64::consts::PI / 180.0),
    ("_rad", Quantity::Angle, 1.0),
    ("_mrad", Quantity::Angle, 1e-3),
    ("_urad", Quantity::Angle, 1e-6),
    ("_s", Quantity::Time, 1.0),
    ("_min", Quantity::Time, 60.0),
    ("_degC", Quantity::Temperature, 1.0),
    ("_N", Quantity::Force, 1.0),
    ("_rpm", Quantity::RotationalSpeed, 1.0),
];

impl Quantity {
    /// Splits a column name such as `X_mm` into its base name, its quantity and the factor to the unit in memory.
    ///
    /// Names without a unit are labels, except the dimensionless numbers that the conventions list (`dir_*`, `meas_*`,
    /// components of unit vectors and quaternions).
    pub fn of_column(header: &str) -> (&str, Self, f64) {
        for (suffix, quantity, factor) in SUFFIXES {
            if let Some(base) = header.strip_suffix(suffix)
                && !base.is_empty()
                && !(matches!(suffix, "_min" | "_s") && base.ends_with("_per"))
            {
                return (base, quantity, factor);
            }
        }
        let number = ["dir_", "dir1_", "dir2_", "meas_"].iter().any(|prefix| header.starts_with(prefix))
            || ["nx", "ny", "nz", "qw", "qx", "qy", "qz", "ux", "uy", "uz", "vx", "vy", "vz", "ax", "ay", "az"]
                .contains(&header);
        (header, if number { Self::Ratio } else { Self::Label }, 1.0)
    }

    /// The unit used in memory, as it is written in results.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Label => "text",
            Self::Ratio => "1",
            Self::Length => "mm",
            Self::Angle => "rad",
            Self::Time => "s",
            Self::Temperature => "degC",
            Self::Force => "N",
            Self::PerTemperature => "1/K",
            Self::RotationalSpeed => "rpm",
            Self::Speed => "mm/s",
        }
    }

    /// The usual suffix for this quantity in files, for messages.
    pub fn usual_suffix(self) -> &'static str {
        match self {
            Self::Label | Self::Ratio => "",
            Self::Length => "_mm",
            Self::Angle => "_deg",
            Self::Time => "_s",
            Self::Temperature => "_degC",
            Self::Force => "_N",
            Self::PerTemperature => "_per_K",
            Self::RotationalSpeed => "_rpm",
            Self::Speed => "_mm_per_min",
        }
    }

    fn from_symbol(symbol: &str) -> Option<Self> {
        const ALL: [Quantity; 8] = [
            Quantity::Ratio,
            Quantity::Length,
            Quantity::Angle,
            Quantity::Time,
            Quantity::Temperature,
            Quantity::Force,
            Quantity::PerTemperature,
            Quantity::RotationalSpeed,
        ];
        ALL.into_iter().find(|quantity| quantity.symbol() == symbol)
    }
}

/// The unit of a parameter: a quantity, a quantity per power of another (`mm/rad^2`), or per this and a third one (`rad/(mm K)`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Unit {
    /// The numerator.
    pub of: Quantity,
    /// The denominator and its power.
    pub per: Option<(Quantity, u8)>,
    /// What else is below the line.
    pub and_per: Option<Quantity>,
}

impl JsonSchema for Unit {
    fn schema_name() -> Cow<'static, str> {
        "Unit".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "string",
            "description": "The unit of a parameter: a quantity, a quantity per power of another, or per this and a third one.",
            "examples": ["mm", "rad", "mm/mm", "mm/rad^2", "rad/(mm K)"]
        })
    }
}

impl Unit {
    /// mm.
    pub const MM: Self = Self::of(Quantity::Length);
    /// rad.
    pub const RAD: Self = Self::of(Quantity::Angle);

    /// A quantity alone.
    pub const fn of(of: Quantity) -> Self {
        Self { of, per: None, and_per: None }
    }

    /// `of` per `per` to the `power`; power 0 is `of` alone.
    pub fn per(of: Quantity, per: Quantity, power: u8) -> Self {
        Self { of, per: (power > 0).then_some((per, power)), and_per: None }
    }

    /// The same per another quantity.
    pub fn and_per(self, per: Quantity) -> Self {
        match self.per {
            Some(_) => Self { and_per: Some(per), ..self },
            None => Self { per: Some((per, 1)), ..self },
        }
    }

    /// The usual unit for display of the parameter, and the factor from the unit in memory: µm, µrad, µm/m, µrad/m²...
    pub fn for_people(self) -> (String, f64) {
        let (mut symbol, mut factor) = match self.of {
            Quantity::Length => ("µm".to_owned(), 1e3),
            Quantity::Angle => ("µrad".to_owned(), 1e6),
            Quantity::PerTemperature => ("µm/(m K)".to_owned(), 1e6),
            other => (other.symbol().to_owned(), 1.0),
        };
        if let Some((per, power)) = self.per {
            let (per_symbol, per_factor) = match per {
                Quantity::Length => ("m", 1e3),
                other => (denominator(other), 1.0),
            };
            let mut below = per_symbol.to_owned();
            if power > 1 {
                let digits = ["⁰", "¹", "²", "³", "⁴", "⁵", "⁶", "⁷", "⁸", "⁹"];
                power.to_string().bytes().for_each(|digit| below.push_str(digits[usize::from(digit - b'0')]));
            }
            symbol = match self.and_per {
                Some(other) => format!("{symbol}/({below} {})", denominator(other)),
                None => format!("{symbol}/{below}"),
            };
            factor *= f64::powi(per_factor, i32::from(power));
        }
        (symbol, factor)
    }
}

/// Differences of temperature.
const KELVIN: &str = "K";

/// The symbol of a quantity below the line.
fn denominator(quantity: Quantity) -> &'static str {
    if quantity == Quantity::Temperature { KELVIN } else { quantity.symbol() }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some((per, power)) = self.per else { return f.write_str(self.of.symbol()) };
        let power = if power == 1 { String::new() } else { format!("^{power}") };
        let (of, per) = (self.of.symbol(), denominator(per));
        match self.and_per {
            Some(other) => write!(f, "{of}/({per}{power} {})", denominator(other)),
            None => write!(f, "{of}/{per}{power}"),
        }
    }
}

impl TryFrom<String> for Unit {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Unit> for String {
    fn from(unit: Unit) -> Self {
        unit.to_string()
    }
}

impl FromStr for Unit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let unknown = || format!("unknown unit `{text}`");
        if let Some(of) = Quantity::from_symbol(text) {
            return Ok(Self::of(of));
        }
        let (of, below) = text.split_once('/').ok_or_else(unknown)?;
        let several = below.strip_prefix('(').and_then(|below| below.strip_suffix(')')?.split_once(' '));
        let (per, other) = several.map_or((below, None), |(per, other)| (per, Some(other)));
        let (per, power) = match per.split_once('^') {
            None => (per, 1),
            Some((per, power)) => (per, power.parse().map_err(|_| unknown())?),
        };
        let quantity = |symbol| Quantity::from_symbol(symbol).ok_or_else(unknown);
        let below = |symbol| if symbol == KELVIN { Ok(Quantity::Temperature) } else { quantity(symbol) };
        Ok(Self { of: quantity(of)?, per: Some((below(per)?, power)), and_per: other.map(below).transpose()? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_say_their_unit() {
        let cases = [
            ("X_mm", "X", Quantity::Length, 1.0),
            ("d_um", "d", Quantity::Length, 1e-3),
            ("gain_um_per_m", "gain", Quantity::Ratio, 1e-6),
            ("T01_degC", "T01", Quantity::Temperature, 1.0),
            ("time_s", "time", Quantity::Time, 1.0),
            ("cutting_min", "cutting", Quantity::Time, 60.0),
            ("feed_mm_per_min", "feed", Quantity::Speed, 1.0 / 60.0),
            ("feed_mm_per_s", "feed", Quantity::Speed, 1.0),
            ("spins_per_min", "spins_per_min", Quantity::Label, 1.0),
            ("dir_X", "dir_X", Quantity::Ratio, 1.0),
            ("feature", "feature", Quantity::Label, 1.0),
            ("X", "X", Quantity::Label, 1.0),
        ];
        for (header, base, quantity, factor) in cases {
            assert_eq!(Quantity::of_column(header), (base, quantity, factor), "{header}");
        }
        assert!((Quantity::of_column("B_deg").2 * 180.0 - std::f64::consts::PI).abs() < 1e-15);
    }

    #[test]
    fn units_round_trip_and_read_well() {
        let cases = [
            (Unit::MM, "mm", "µm", 1e3),
            (Unit::per(Quantity::Length, Quantity::Length, 1), "mm/mm", "µm/m", 1e6),
            (Unit::per(Quantity::Angle, Quantity::Length, 3), "rad/mm^3", "µrad/m³", 1e15),
            (Unit::per(Quantity::Length, Quantity::Angle, 2), "mm/rad^2", "µm/rad²", 1e3),
            (Unit::per(Quantity::Length, Quantity::Temperature, 1), "mm/K", "µm/K", 1e3),
            (Unit::per(Quantity::Angle, Quantity::RotationalSpeed, 1), "rad/rpm", "µrad/rpm", 1e6),
            (
                Unit::per(Quantity::Angle, Quantity::Length, 1).and_per(Quantity::Temperature),
                "rad/(mm K)",
                "µrad/(m K)",
                1e9,
            ),
            (
                Unit::per(Quantity::Length, Quantity::Angle, 2).and_per(Quantity::RotationalSpeed),
                "mm/(rad^2 rpm)",
                "µm/(rad² rpm)",
                1e3,
            ),
            (Unit::MM.and_per(Quantity::Temperature), "mm/K", "µm/K", 1e3),
        ];
        for (unit, text, people, factor) in cases {
            assert_eq!(unit.to_string(), text);
            assert_eq!(text.parse(), Ok(unit));
            assert_eq!(unit.for_people(), (people.to_owned(), factor));
        }
        for wrong in ["mm/furlong", "rad/(mm K", "rad/(mm)", "rad/(mm K K)", "rad/(mm^x K)"] {
            assert!(wrong.parse::<Unit>().is_err(), "{wrong}");
        }
    }
}
