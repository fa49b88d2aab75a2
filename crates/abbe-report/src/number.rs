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
        assert_eq!(sized(80.0, 1e-10, 1e-4), "80.00");
        assert_eq!(sized(80.0, 0.5, 1e-4), "80.00 ± 0.50");
        assert_eq!(short(0.0), "0");
        assert_eq!(short(1.0276e5), "1.028e5");
        assert_eq!(short(4.2345), "4.234");
    }
}
