//! Numbers for people.

/// A value with its standard uncertainty to two significant digits of the latter (GUM 7.2.6): `-9.31 ± 0.41`.
pub fn with_uncertainty(value: f64, uncertainty: f64) -> String {
    if !(uncertainty > 0.0 && uncertainty.is_finite()) {
        return short(value);
    }
    let decimals = 1 - uncertainty.log10().floor() as i32;
    if (0..=9).contains(&decimals) {
        let decimals = decimals as usize;
        return format!("{value:.decimals$} ± {uncertainty:.decimals$}");
    }
    if decimals < 0 && value.abs() < 1e6 && uncertainty < 1e6 {
        return format!("{value:.0} ± {uncertainty:.0}");
    }
    format!("{} ± {uncertainty:.1e}", short(value))
}

/// A number to four significant digits.
pub fn short(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let magnitude = value.abs().log10().floor() as i32;
    if (-4..6).contains(&magnitude) {
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
            (1234.5, 120.0, "1234 ± 120"),
            (3.2e-9, 1.5e-11, "3.200e-9 ± 1.5e-11"),
            (2.0, 0.0, "2.000"),
        ];
        for (value, uncertainty, expected) in cases {
            assert_eq!(with_uncertainty(value, uncertainty), expected);
        }
        assert_eq!(short(0.0), "0");
        assert_eq!(short(1.0e5), "100000");
        assert_eq!(short(4.2345), "4.234");
    }
}
