//! How a file is laid out that an instrument or a spreadsheet has written, and the units that people write in.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use abbe_core::{ColumnHeader, Quantity};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::number::plain;

/// What separates the columns of a table.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Separator {
    /// `,`
    #[default]
    Comma,
    /// `;`
    Semicolon,
    /// One tabulator.
    Tab,
    /// `|`
    Stroke,
    /// Any number of spaces and tabulators; those at the ends of a line do not count.
    Space,
}

impl Separator {
    /// All separators, the likeliest first, with their names in messages and in settings.
    pub(crate) const ALL: [(Self, char, &str, &str); 5] = [
        (Self::Comma, ',', "commas", "comma"),
        (Self::Semicolon, ';', "semicolons", "semicolon"),
        (Self::Tab, '\t', "tabs", "tab"),
        (Self::Stroke, '|', "vertical strokes", "stroke"),
        (Self::Space, ' ', "spaces", "space"),
    ];

    pub(crate) fn character(self) -> char {
        Self::ALL.into_iter().find(|(separator, ..)| *separator == self).map_or(',', |(_, character, ..)| character)
    }

    /// Its name in settings.
    pub fn name(self) -> &'static str {
        Self::ALL.into_iter().find(|(separator, ..)| *separator == self).map_or("comma", |(.., name)| name)
    }

    /// Its name in messages, with an article.
    pub(crate) fn expected(self) -> &'static str {
        match self {
            Self::Comma => "a comma",
            Self::Semicolon => "a semicolon",
            Self::Tab => "a tab",
            Self::Stroke => "a vertical stroke",
            Self::Space => "white space",
        }
    }
}

/// The character before the decimals of a number.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Decimal {
    /// `1.5`
    #[default]
    Point,
    /// `1,5`
    Comma,
}

impl Decimal {
    pub(crate) fn character(self) -> char {
        if self == Self::Point { '.' } else { ',' }
    }

    /// Its name in settings.
    pub fn name(self) -> &'static str {
        if self == Self::Point { "point" } else { "comma" }
    }
}

/// What separates groups of three digits before the decimals of a number.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Thousands {
    /// Nothing: `1234.5`. A number with such separators is refused.
    #[default]
    None,
    /// A space, also one that does not break the line: `1 234,5`
    Blank,
    /// `1.234,5`
    Point,
    /// `1,234.5`
    Comma,
    /// `1'234.5`
    Apostrophe,
}

impl Thousands {
    /// The separators, with their names in settings and the advice to declare them.
    pub(crate) const ALL: [(Self, &str, &str); 4] = [
        (Self::Blank, "blank", "write `thousands: blank` where it is read by `ingest: csv`"),
        (Self::Point, "point", "write `thousands: point` where it is read by `ingest: csv`"),
        (Self::Comma, "comma", "write `thousands: comma` where it is read by `ingest: csv`"),
        (Self::Apostrophe, "apostrophe", "write `thousands: apostrophe` where it is read by `ingest: csv`"),
    ];

    pub(crate) fn characters(self) -> &'static [char] {
        match self {
            Self::None => &[],
            Self::Blank => &[' ', '\u{a0}', '\u{202f}', '\u{2009}'],
            Self::Point => &['.'],
            Self::Comma => &[','],
            Self::Apostrophe => &['\'', '’'],
        }
    }

    /// Its name in settings.
    pub fn name(self) -> &'static str {
        Self::ALL.into_iter().find(|(thousands, ..)| *thousands == self).map_or("none", |(_, name, _)| name)
    }
}

/// How characters stand in a file.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
pub enum Encoding {
    /// UTF-8, with a byte order mark or without.
    #[default]
    #[serde(rename = "utf-8")]
    Utf8,
    /// UTF-16, as its byte order mark says; without one the low byte comes first.
    #[serde(rename = "utf-16")]
    Utf16,
    /// ISO 8859-1, with the characters of Windows-1252 for 0x80 to 0x9F.
    #[serde(rename = "latin-1")]
    Latin1,
    /// GB 18030, which contains GBK and GB 2312: spreadsheets in China.
    #[serde(rename = "gb18030")]
    Gb18030,
}

impl Encoding {
    /// Its name in settings.
    pub fn name(self) -> &'static str {
        match self {
            Self::Utf8 => "utf-8",
            Self::Utf16 => "utf-16",
            Self::Latin1 => "latin-1",
            Self::Gb18030 => "gb18030",
        }
    }
}

/// Where a column of the data set stands in the file.
#[derive(Debug, Clone, PartialEq)]
pub struct ColumnSource {
    /// Name in the header row; without a header row its number, from 1.
    pub column: String,
    /// The unit of the numbers in the file, if it is another one than the name of the column of the data set says.
    pub unit: Option<Unit>,
}

/// The layout of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// What separates the columns.
    pub separator: Separator,
    /// The decimal character of all numbers.
    pub decimal: Decimal,
    /// What separates thousands in all numbers.
    pub thousands: Thousands,
    /// How characters are stored.
    pub encoding: Encoding,
    /// Lines before the header row (or before the first row of data).
    pub skip_lines: usize,
    /// Rows between the header row and the first row of data.
    pub skip_after_header: usize,
    /// Whether there is a header row.
    pub has_header: bool,
    /// Contents of cells that stand for a number that was not measured: such rows are left out. A number counts as one, however it is
    /// written: a recipe has `0.50` as 0.5.
    pub no_data: Vec<String>,
    /// The columns to take, by the name (with unit) that they have in the data set; none: all, as the header row names them.
    pub columns: Option<BTreeMap<String, ColumnSource>>,
}

impl Default for Layout {
    fn default() -> Self {
        Self {
            separator: Separator::Comma,
            decimal: Decimal::Point,
            thousands: Thousands::None,
            encoding: Encoding::Utf8,
            skip_lines: 0,
            skip_after_header: 0,
            has_header: true,
            no_data: Vec::new(),
            columns: None,
        }
    }
}

impl Layout {
    /// Whether a cell, without space around it, has a mark of `no_data`.
    pub(crate) fn is_mark(&self, cell: &str) -> bool {
        let number = || plain(cell, self.decimal, self.thousands)?.parse::<f64>().ok();
        let is_number = |mark: &String| mark.parse::<f64>().is_ok_and(|mark| number() == Some(mark));
        self.no_data.iter().any(|mark| mark == cell || is_number(mark))
    }
}

/// A unit that numbers of a file may have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    symbol: &'static str,
    quantity: Quantity,
    /// Value of the zero of the unit used in memory.
    zero: f64,
    /// Factor to the unit used in memory.
    factor: f64,
}

const fn unit(symbol: &'static str, quantity: Quantity, factor: f64) -> Unit {
    Unit { symbol, quantity, zero: 0.0, factor }
}

const DEGREE: f64 = PI / 180.0;

/// Degrees, minutes and seconds: `12°34'56.7"`, `12 34 56.7`, `-0:30`.
const SEXAGESIMAL: &str = "dms";

const UNITS: [Unit; 38] = [
    unit("nm", Quantity::Length, 1e-6),
    unit("um", Quantity::Length, 1e-3),
    unit("µm", Quantity::Length, 1e-3),
    unit("mm", Quantity::Length, 1.0),
    unit("cm", Quantity::Length, 10.0),
    unit("m", Quantity::Length, 1e3),
    unit("in", Quantity::Length, 25.4),
    unit("thou", Quantity::Length, 0.0254),
    unit("deg", Quantity::Angle, DEGREE),
    unit("gon", Quantity::Angle, PI / 200.0),
    unit("rad", Quantity::Angle, 1.0),
    unit("mrad", Quantity::Angle, 1e-3),
    unit("urad", Quantity::Angle, 1e-6),
    unit("µrad", Quantity::Angle, 1e-6),
    unit("arcmin", Quantity::Angle, DEGREE / 60.0),
    unit("arcsec", Quantity::Angle, DEGREE / 3600.0),
    unit(SEXAGESIMAL, Quantity::Angle, DEGREE),
    unit("rev", Quantity::Angle, 2.0 * PI),
    unit("us", Quantity::Time, 1e-6),
    unit("ms", Quantity::Time, 1e-3),
    unit("s", Quantity::Time, 1.0),
    unit("min", Quantity::Time, 60.0),
    unit("h", Quantity::Time, 3600.0),
    unit("degC", Quantity::Temperature, 1.0),
    Unit { symbol: "K", quantity: Quantity::Temperature, zero: 273.15, factor: 1.0 },
    Unit { symbol: "degF", quantity: Quantity::Temperature, zero: 32.0, factor: 5.0 / 9.0 },
    unit("N", Quantity::Force, 1.0),
    unit("kN", Quantity::Force, 1e3),
    unit("rpm", Quantity::RotationalSpeed, 1.0),
    unit("1/s", Quantity::RotationalSpeed, 60.0),
    unit("mm/s", Quantity::Speed, 1.0),
    unit("mm/min", Quantity::Speed, 1.0 / 60.0),
    unit("m/min", Quantity::Speed, 1e3 / 60.0),
    unit("in/min", Quantity::Speed, 25.4 / 60.0),
    unit("1", Quantity::Ratio, 1.0),
    unit("%", Quantity::Ratio, 1e-2),
    unit("ppm", Quantity::Ratio, 1e-6),
    unit("um/m", Quantity::Ratio, 1e-6),
];

impl Unit {
    /// The unit `symbol` for the column `header` of the data set; else what is wrong.
    pub fn of(symbol: &str, header: &ColumnHeader) -> Result<Self, String> {
        let of_quantity = |unit: &&Unit| unit.quantity == header.quantity;
        let fitting = || UNITS.iter().filter(of_quantity).map(|unit| unit.symbol).collect::<Vec<_>>().join(", ");
        if header.quantity == Quantity::Label {
            return Err(format!("`{}` holds labels, which have no unit", header.header));
        }
        match UNITS.into_iter().find(|unit| unit.symbol == symbol) {
            Some(unit) if unit.quantity == header.quantity => Ok(unit),
            Some(_) => Err(format!("`{symbol}` is no unit of `{}`; one of {} was expected", header.header, fitting())),
            None => Err(format!("there is no unit `{symbol}`; one of {} was expected", fitting())),
        }
    }

    /// Whether its numbers are degrees, minutes and seconds.
    pub(crate) fn is_sexagesimal(self) -> bool {
        self.symbol == SEXAGESIMAL
    }

    /// Its symbol.
    pub fn symbol(self) -> &'static str {
        self.symbol
    }

    /// A number in the unit used in memory as it is written in this unit, with a decimal point.
    pub(crate) fn write(self, value: f64) -> String {
        format!("{}", value / self.factor + self.zero)
    }

    /// A number as it is written in this unit (with a decimal point), in the unit used in memory.
    pub(crate) fn read(self, written: &str) -> Option<f64> {
        Some(self.convert(if self.is_sexagesimal() { sexagesimal(written)? } else { written.parse().ok()? }))
    }

    /// A number of this unit in the unit used in memory.
    pub(crate) fn convert(self, value: f64) -> f64 {
        (value - self.zero) * self.factor
    }

    /// The unit of that symbol, whatever it is a unit of.
    pub(crate) fn named(symbol: &str) -> Option<Self> {
        UNITS.into_iter().find(|unit| unit.symbol == symbol)
    }

    /// Whether both are one unit, however they are written.
    pub(crate) fn is_same(self, other: Self) -> bool {
        (self.quantity, self.zero, self.factor, self.is_sexagesimal())
            == (other.quantity, other.zero, other.factor, other.is_sexagesimal())
    }

    /// What it is a unit of.
    pub(crate) fn quantity(self) -> Quantity {
        self.quantity
    }

    /// The symbols of all units, for messages.
    pub(crate) fn symbols() -> String {
        UNITS.map(|unit| unit.symbol).join(", ")
    }
}

/// Degrees of an angle in degrees, minutes and seconds; only the last part may have decimals.
fn sexagesimal(written: &str) -> Option<f64> {
    let (sign, magnitude) = match written.strip_prefix(['-', '+', '\u{2212}']) {
        Some(rest) if !written.starts_with('+') => (-1.0, rest),
        Some(rest) => (1.0, rest),
        None => (1.0, written),
    };
    let marks = ['°', 'º', '\'', '′', '’', '"', '″', '”', ':'];
    let parts: Vec<&str> =
        magnitude.split(|c: char| marks.contains(&c) || c.is_whitespace()).filter(|part| !part.is_empty()).collect();
    if parts.is_empty() || parts.len() > 3 {
        return None;
    }
    let mut degrees = 0.0;
    for (place, part) in parts.iter().enumerate() {
        let is_last = place + 1 == parts.len();
        if !part.bytes().all(|byte| byte.is_ascii_digit() || (byte == b'.' && is_last)) {
            return None;
        }
        let value: f64 = part.parse().ok()?;
        if place > 0 && value >= 60.0 {
            return None;
        }
        degrees += value / 60f64.powi(i32::try_from(place).ok()?);
    }
    Some(sign * degrees)
}

#[cfg(test)]
mod tests {
    use abbe_core::ColumnHeader;

    use super::{UNITS, Unit, sexagesimal};

    #[test]
    fn units_are_those_of_the_si() {
        for (symbol, header, written, expected) in [
            ("in", "X_mm", "2", 50.8),
            ("thou", "d_um", "1", 0.0254),
            ("nm", "d_um", "12", 12e-6),
            ("m", "X_mm", "-0.5", -500.0),
            ("degF", "T_degC", "68", 20.0),
            ("K", "T_degC", "293.15", 20.0),
            ("arcsec", "B_deg", "3600", 1f64.to_radians()),
            ("gon", "B_deg", "100", 90f64.to_radians()),
            ("dms", "B_deg", "12°30'36\"", 12.51f64.to_radians()),
            ("h", "time_s", "1.5", 5400.0),
            ("in/min", "feed_mm_per_min", "60", 25.4),
            ("1/s", "speed_rpm", "10", 600.0),
        ] {
            let found = Unit::of(symbol, &ColumnHeader::parse(header)).unwrap().read(written).unwrap();
            assert!((found - expected).abs() < 1e-12 * expected.abs().max(1.0), "{symbol}: {found}");
        }
        let wrong = |symbol: &str, header: &str| Unit::of(symbol, &ColumnHeader::parse(header)).unwrap_err();
        assert_eq!(wrong("deg", "T_degC"), "`deg` is no unit of `T_degC`; one of degC, K, degF was expected");
        assert_eq!(wrong("inch", "F_N"), "there is no unit `inch`; one of N, kN was expected");
        assert_eq!(wrong("mm", "feature"), "`feature` holds labels, which have no unit");
        let mut symbols: Vec<_> = UNITS.iter().map(|unit| unit.symbol).collect();
        symbols.sort_unstable();
        symbols.dedup();
        assert_eq!(symbols.len(), UNITS.len());
    }

    #[test]
    fn degrees_minutes_and_seconds() {
        let close = |text: &str, expected: f64| {
            let found = sexagesimal(text).unwrap();
            assert!((found - expected).abs() < 1e-12, "{text}: {found}");
        };
        close("-0:30", -0.5);
        close("12 34 56.7", 12.0 + 34.0 / 60.0 + 56.7 / 3600.0);
        close("+359° 59′ 59.999″", 360.0 - 0.001 / 3600.0);
        close("7.25", 7.25);
        for text in ["", "-", "1:60", "1:2:60", "1.5:3", "1:2:3:4", "1:-2", "one", "1e3", "--1", "1:2.5:3", "inf"] {
            assert_eq!(sexagesimal(text), None, "{text}");
        }
    }
}
