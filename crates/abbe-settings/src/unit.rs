//! Units: the suffixes of columns and settings, and the units of parameters.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// The kind of quantity of a column or a parameter. In memory each kind has one unit only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
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

/// The unit of a parameter: a quantity, or a quantity per power of another (`mm/rad^2`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Unit {
    /// The numerator.
    pub of: Quantity,
    /// The denominator and its power.
    pub per: Option<(Quantity, u8)>,
}

impl Unit {
    /// mm.
    pub const MM: Self = Self { of: Quantity::Length, per: None };
    /// rad.
    pub const RAD: Self = Self { of: Quantity::Angle, per: None };

    /// `of` per `per` to the `power`; power 0 is `of` alone.
    pub fn per(of: Quantity, per: Quantity, power: u8) -> Self {
        Self { of, per: (power > 0).then_some((per, power)) }
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
            symbol = format!("{symbol}/{per_symbol}");
            if power > 1 {
                let digits = ["⁰", "¹", "²", "³", "⁴", "⁵", "⁶", "⁷", "⁸", "⁹"];
                power.to_string().bytes().for_each(|digit| symbol.push_str(digits[usize::from(digit - b'0')]));
            }
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
        match self.per {
            None => f.write_str(self.of.symbol()),
            Some((per, 1)) => write!(f, "{}/{}", self.of.symbol(), denominator(per)),
            Some((per, power)) => write!(f, "{}/{}^{power}", self.of.symbol(), denominator(per)),
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
            return Ok(Self { of, per: None });
        }
        let (of, per) = text.split_once('/').ok_or_else(unknown)?;
        let (per, power) = match per.split_once('^') {
            None => (per, 1),
            Some((per, power)) => (per, power.parse().map_err(|_| unknown())?),
        };
        let quantity = |symbol| Quantity::from_symbol(symbol).ok_or_else(unknown);
        let per = if per == KELVIN { Quantity::Temperature } else { quantity(per)? };
        Ok(Self { of: quantity(of)?, per: Some((per, power)) })
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
        ];
        for (unit, text, people, factor) in cases {
            assert_eq!(unit.to_string(), text);
            assert_eq!(text.parse(), Ok(unit));
            assert_eq!(unit.for_people(), (people.to_owned(), factor));
        }
        assert!("mm/furlong".parse::<Unit>().is_err());
    }
}
