//! Units of results as the D-SI writes them.

/// The unit in the D-SI (BIPM's names with a backslash, powers by `\tothe`): `mm/rad^2` is `\milli\metre\radian\tothe{-2}`; none for a unit
/// that results do not have.
pub fn dsi(unit: &str) -> Option<String> {
    // The scale of an axis is a number.
    if unit == "mm/mm" {
        return Some(r"\one".to_owned());
    }
    let (above, below) = unit.split_once('/').unwrap_or((unit, ""));
    let below = below.trim_start_matches('(').trim_end_matches(')');
    let mut text = match above {
        "1" if below.is_empty() => return Some(r"\one".to_owned()),
        "1" => String::new(),
        above => name(above)?.to_owned(),
    };
    for factor in below.split(' ').filter(|factor| !factor.is_empty()) {
        let (of, power) = factor.split_once('^').unwrap_or((factor, "1"));
        let power: u32 = power.parse().ok()?;
        text.push_str(&format!(r"{}\tothe{{-{power}}}", name(of)?));
    }
    Some(text)
}

/// The unit of a product of two, which need not be different.
pub fn product(one: &str, other: &str) -> String {
    match (one, other) {
        (r"\one", other) => other.to_owned(),
        (one, r"\one") => one.to_owned(),
        (one, other) => format!("{one}{other}"),
    }
}

fn name(unit: &str) -> Option<&'static str> {
    Some(match unit {
        "mm" => r"\milli\metre",
        "um" => r"\micro\metre",
        "rad" => r"\radian",
        "urad" => r"\micro\radian",
        "deg" => r"\degree",
        "s" => r"\second",
        "K" => r"\kelvin",
        "degC" => r"\degreecelsius",
        "N" => r"\newton",
        "%" => r"\percent",
        "hPa" => r"\hecto\pascal",
        _ => return None,
    })
}
