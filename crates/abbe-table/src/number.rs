//! Numbers as they stand in cells.

use std::borrow::Cow;

use abbe_core::Quantity;
use abbe_core::ranges::TEMPERATURES;

use crate::layout::{Decimal, Layout, Thousands, Unit};

/// Characters of a cell that a message shows.
const SHOWN: usize = 60;

/// Zero of the scale of °C, K.
const KELVIN: f64 = 273.15;

/// Reads a number as it stands in a cell of the column `header`, in the unit used in memory; else says what is wrong.
pub fn number(header: &str, cell: &str) -> Result<f64, String> {
    number_of(header, cell, None, &Layout::default())
}

/// The same with a unit other than that of the header, and with this character before the decimals.
pub fn number_in(header: &str, cell: &str, unit: Option<Unit>, decimal: Decimal) -> Result<f64, String> {
    number_of(header, cell, unit, &Layout { decimal, ..Layout::default() })
}

/// The same with a unit other than that of the header, and as a layout writes numbers.
pub(crate) fn number_of(header: &str, cell: &str, unit: Option<Unit>, layout: &Layout) -> Result<f64, String> {
    let (_, quantity, factor) = Quantity::of_column(header);
    number_in_column(header, (quantity, factor), cell, unit, layout)
}

/// The same where the quantity of the column is known, and the factor to the unit used in memory: a file has many cells.
pub(crate) fn number_in_column(
    header: &str,
    (quantity, factor): (Quantity, f64),
    cell: &str,
    unit: Option<Unit>,
    layout: &Layout,
) -> Result<f64, String> {
    let cell = cell.trim();
    let read = |written: &str| match unit {
        Some(unit) => unit.read(written),
        None => written.parse().ok().map(|value: f64| value * factor),
    };
    // Blanks separate degrees, minutes and seconds.
    let thousands = if unit.is_some_and(Unit::is_sexagesimal) { Thousands::None } else { layout.thousands };
    let value = plain(cell, layout.decimal, thousands).and_then(|written| read(&written));
    checked(header, quantity, value, || cell.into()).unwrap_or_else(|| match cell.is_empty() {
        true => Err(format!("`{header}` is empty; a number was expected")),
        false => Err(format!("`{header}` is `{}`; {} was expected", shown(cell), expected(cell, layout))),
    })
}

/// A number that a file holds as such, in the unit used in memory; else says what is wrong. The same as [`number_of`] of its digits.
/// `of_header` is the quantity of the column, and the factor to the unit used in memory.
pub(crate) fn number_held(
    header: &str,
    of_header: (Quantity, f64),
    held: f64,
    unit: Option<Unit>,
) -> Result<f64, String> {
    let (quantity, factor) = of_header;
    let value = match unit {
        Some(unit) => unit.convert(held),
        None => held * factor,
    };
    checked(header, quantity, Some(value), || held.to_string().into()).unwrap_or(Ok(value))
}

/// A number that may stand in a column, or what is wrong with it; none where there is none. `cell` is how it is written.
fn checked<'a>(
    header: &str,
    quantity: Quantity,
    value: Option<f64>,
    cell: impl Fn() -> Cow<'a, str>,
) -> Option<Result<f64, String>> {
    Some(match value? {
        value if quantity == Quantity::Temperature && !TEMPERATURES.contains(&value) => Err(format!(
            "`{header}` is `{}`; a temperature from {} to {} °C was expected",
            shown(&cell()),
            TEMPERATURES.start(),
            TEMPERATURES.end()
        )),
        value if value.is_finite() => Ok(value),
        _ => Err(format!("`{header}` is `{}`, which is not a finite number", shown(&cell()))),
    })
}

/// What was expected in the place of a cell that is no number.
fn expected(cell: &str, layout: &Layout) -> &'static str {
    match layout.decimal {
        Decimal::Point if plain(cell, Decimal::Comma, Thousands::None).is_some_and(|it| it.parse::<f64>().is_ok()) => {
            "a number with a decimal point"
        }
        Decimal::Comma if cell.contains('.') && layout.thousands == Thousands::None => {
            "a number with a decimal comma and without separators of thousands"
        }
        _ => "a number",
    }
}

/// The setting that a cell of the column `header` which is not read seems to need.
pub(crate) fn help_for(header: &str, cell: &str, layout: &Layout) -> Option<Cow<'static, str>> {
    let is = |decimal, thousands| is_number(cell.trim(), decimal, thousands);
    if is(layout.decimal, layout.thousands) {
        let value = plain(cell.trim(), layout.decimal, layout.thousands).and_then(|it| it.parse::<f64>().ok())?;
        let is_kelvin = TEMPERATURES.contains(&(value - KELVIN)) && !TEMPERATURES.contains(&value);
        let source =
            format!("`columns: {{ {header}: {{ column: NAME, unit: K }} }}` where it is read by `ingest: csv`");
        return is_kelvin.then(|| format!("if it is in kelvin, write {source}, with its name in the file").into());
    }
    if cell.trim().is_empty() {
        return Some("write `no_data: [\"\"]` where it is read by `ingest: csv` to leave such rows out".into());
    }
    let other = if layout.decimal == Decimal::Point { Decimal::Comma } else { Decimal::Point };
    if is(other, Thousands::None) {
        return Some(format!("write `decimal: {}` where it is read by `ingest: csv`", other.name()).into());
    }
    let separated = Thousands::ALL.into_iter().find(|(thousands, ..)| {
        layout.thousands != *thousands && [layout.decimal, other].into_iter().any(|decimal| is(decimal, *thousands))
    });
    Some(match separated {
        Some((.., advice)) => advice.into(),
        None => {
            "correct the cell; `no_data` of `ingest: csv` lists what stands for a number that was not measured".into()
        }
    })
}

/// Whether a cell is a number that is written so.
pub(crate) fn is_number(cell: &str, decimal: Decimal, thousands: Thousands) -> bool {
    plain(cell, decimal, thousands).and_then(|written| written.parse::<f64>().ok()).is_some_and(f64::is_finite)
}

/// A number with a decimal point, a simple minus sign and no separators of thousands; none if it is not written as declared.
pub(crate) fn plain(cell: &str, decimal: Decimal, thousands: Thousands) -> Option<Cow<'_, str>> {
    let mut written = Cow::Borrowed(cell);
    // Swedish spreadsheets write this sign.
    if let Some(rest) = cell.strip_prefix('\u{2212}') {
        written = format!("-{rest}").into();
    }
    let separators = thousands.characters();
    if !separators.is_empty() && written.contains(separators) {
        let sign = written.len() - written.trim_start_matches(['+', '-']).len();
        let decimal = decimal.character();
        let end = written.find([decimal, 'e', 'E']).unwrap_or(written.len());
        let groups: Vec<&str> = written.get(sign..end)?.split(separators).collect();
        let is_group = |(place, group): (usize, &&str)| {
            let fits = if place == 0 { (1..=3).contains(&group.len()) } else { group.len() == 3 };
            fits && group.bytes().all(|byte| byte.is_ascii_digit())
        };
        // 0.123 is no thousand, whatever is declared.
        if !groups.iter().enumerate().all(is_group) || groups[0].starts_with('0') {
            return None;
        }
        written = format!("{}{}{}", &written[..sign], groups.concat(), &written[end..]).into();
    }
    match decimal {
        Decimal::Point => Some(written),
        Decimal::Comma if written.contains('.') => None,
        Decimal::Comma => Some(written.replacen(',', ".", 1).into()),
    }
}

/// The beginning of a cell, which may be long.
pub(crate) fn shown(cell: &str) -> Cow<'_, str> {
    match cell.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}...", &cell[..end]).into(),
        None => cell.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_read_as_declared_and_nothing_else() {
        let read = |cell: &str, decimal, thousands| {
            number_of("X_mm", cell, None, &Layout { decimal, thousands, ..Layout::default() })
        };
        for (cell, decimal, thousands, expected) in [
            ("1.234,5", Decimal::Comma, Thousands::Point, 1234.5),
            ("-1.234.567", Decimal::Comma, Thousands::Point, -1_234_567.0),
            ("1 234,5", Decimal::Comma, Thousands::Blank, 1234.5),
            ("\u{2212}1\u{a0}234,5", Decimal::Comma, Thousands::Blank, -1234.5),
            ("12\u{202f}345", Decimal::Comma, Thousands::Blank, 12345.0),
            ("1,234.5e-3", Decimal::Point, Thousands::Comma, 1.2345),
            ("1'234.5", Decimal::Point, Thousands::Apostrophe, 1234.5),
            ("234.5", Decimal::Point, Thousands::Comma, 234.5),
            ("1234567.25", Decimal::Point, Thousands::Comma, 1_234_567.25),
        ] {
            assert_eq!(read(cell, decimal, thousands), Ok(expected), "{cell}");
        }
        for (cell, decimal, thousands) in [
            ("1.23,5", Decimal::Comma, Thousands::Point),
            ("0.123", Decimal::Comma, Thousands::Point),
            ("-0,500", Decimal::Point, Thousands::Comma),
            ("1234.567,8", Decimal::Comma, Thousands::Point),
            (".234", Decimal::Comma, Thousands::Point),
            ("1..234", Decimal::Comma, Thousands::Point),
            ("1,5", Decimal::Point, Thousands::Comma),
            ("1 23", Decimal::Comma, Thousands::Blank),
            ("1,234.5", Decimal::Point, Thousands::None),
            ("1 234", Decimal::Point, Thousands::None),
            ("12,34,5", Decimal::Comma, Thousands::None),
        ] {
            assert!(read(cell, decimal, thousands).is_err(), "{cell}");
        }
        let help = |cell: &str, layout: &Layout| help_for("T_degC", cell, layout).unwrap_or_default();
        let comma = Layout { decimal: Decimal::Comma, ..Layout::default() };
        assert!(help("1.234,5", &comma).contains("`thousands: point`"));
        assert!(help("1\u{a0}234,5", &comma).contains("`thousands: blank`"));
        assert!(help("1,5", &Layout::default()).contains("`decimal: comma`"));
        assert!(help("1.5", &comma).contains("`decimal: point`"));
        assert!(help("one", &comma).contains("`no_data`") && help("", &comma).contains("`no_data: [\"\"]`"));
        let kelvin = help("293.15", &Layout::default());
        assert!(kelvin.contains("unit: K") && !kelvin.contains("thousands"), "{kelvin}");
        assert_eq!(help_for("T_degC", "9e9", &Layout::default()), None);
    }
}
