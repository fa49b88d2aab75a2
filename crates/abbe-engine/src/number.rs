//! Numbers as text.

/// A value with its standard uncertainty to two significant digits of the latter (GUM 7.2.6): `-9.31 ± 0.41`.
pub fn with_uncertainty(value: f64, uncertainty: f64) -> String {
    if !(uncertainty > 0.0 && uncertainty.is_finite()) {
        return short(value);
    }
    let decimals = 1 - uncertainty.log10().floor() as i32;
    if (0..=9).contains(&decimals) {
        let decimals = decimals as usize;
        return format!("{} ± {uncertainty:.decimals$}", unsigned_zero(format!("{value:.decimals$}")));
    }
    if decimals < 0 && value.abs() < 1e7 && uncertainty < 1e7 {
        let step = 10_f64.powi(-decimals);
        let rounded = |value: f64| unsigned_zero(format!("{:.0}", (value / step).round() * step));
        return format!("{} ± {}", rounded(value), rounded(uncertainty));
    }
    format!("{value:.3e} ± {uncertainty:.1e}")
}

/// A value beside its limit, with its uncertainty: as [`with_uncertainty`], but a value that this rounds to zero although it is a part of
/// the limit that is told keeps its digits.
pub fn beside_limit(value: f64, uncertainty: f64, limit: f64) -> String {
    let text = with_uncertainty(value, uncertainty);
    let (own, rest) = text.split_once(' ').unwrap_or((&text, ""));
    let is_zero = own.chars().all(|c| c == '0' || c == '.');
    if is_zero && value.abs() >= PART * limit.abs() && value != 0.0 { format!("{} {rest}", short(value)) } else { text }
}

/// Part of a limit that is told.
const PART: f64 = 0.01;

/// A size with its uncertainty for people: an uncertainty that is rounding beside the value, or below `least`, is left out.
pub fn sized(value: f64, uncertainty: f64, least: f64) -> String {
    let is_rounding = uncertainty < least || uncertainty < 1e-6 * value.abs();
    if is_rounding { short(value) } else { with_uncertainty(value, uncertainty) }
}

/// Zero has no sign.
fn unsigned_zero(text: String) -> String {
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| c == '0' || c == '.') => rest.to_owned(),
        _ => text,
    }
}

/// A number to four significant digits.
pub fn short(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let magnitude = value.abs().log10().floor() as i32;
    if (-4..5).contains(&magnitude) {
        let decimals = (3 - magnitude).max(0) as usize;
        return format!("{value:.decimals$}");
    }
    format!("{value:.3e}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers() {
        let cases = [
            (-9.3123, 0.4123, "-9.31 ± 0.41"),
            (304.668_612, 0.000_93, "304.66861 ± 0.00093"),
            (1234.5, 123.0, "1230 ± 120"),
            (67.3, 4099.0, "100 ± 4100"),
            (-0.001, 1.2, "0.0 ± 1.2"),
            (3.2e-9, 1.5e-11, "3.200e-9 ± 1.5e-11"),
            (2.0, 0.0, "2.000"),
        ];
        for (value, uncertainty, expected) in cases {
            assert_eq!(with_uncertainty(value, uncertainty), expected);
        }
        // 78 % of its limit is not zero, however uncertain it is.
        assert_eq!(with_uncertainty(15.6, 31_000.0), "0 ± 31000");
        assert_eq!(beside_limit(15.6, 31_000.0, 20.0), "15.60 ± 31000");
        assert_eq!(beside_limit(-0.02, 1.2, 1.0), "-0.02000 ± 1.2");
        assert_eq!(beside_limit(-0.001, 1.2, 1.0), "0.0 ± 1.2");
        assert_eq!(beside_limit(15.6, 1.2, 20.0), "15.6 ± 1.2");
        assert_eq!(beside_limit(0.0, 1.2, 0.0), "0.0 ± 1.2");
        assert_eq!(sized(80.0, 1e-10, 1e-4), "80.00");
        assert_eq!(sized(80.0, 0.5, 1e-4), "80.00 ± 0.50");
        assert_eq!(short(0.0), "0");
        assert_eq!(short(1.0276e5), "1.028e5");
        assert_eq!(short(4.2345), "4.234");
    }
}
