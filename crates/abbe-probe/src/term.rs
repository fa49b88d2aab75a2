//! Terms: polynomials of a unit vector that are smooth on the whole sphere.

use abbe_core::{Parameter, ParameterRole, ProbeTerm, Quantity, Unit};
use nalgebra::Vector3;

/// Highest number of periods around the axis, and highest power along it.
const HIGHEST: u8 = 24;

/// Reads `cosM`, `sinM`, `cosM,J` or `sinM,J`.
///
/// Fails with a text that says what was expected.
///
/// ```
/// # use abbe_core::ProbeTerm;
/// assert_eq!(abbe_probe::polynomial("sin3,1"), Ok(ProbeTerm::Sine { around: 3, along: 1 }));
/// assert!(abbe_probe::polynomial("sin0").is_err());
/// ```
pub fn polynomial(text: &str) -> Result<ProbeTerm, String> {
    let expected = || {
        format!(
            "`{text}` is no term; `cos3`, `sin3` or `cos0,2` was expected: periods around the axis, and the power of the component along it"
        )
    };
    let (sine, numbers) = match (text.strip_prefix("cos"), text.strip_prefix("sin")) {
        (Some(numbers), _) => (false, numbers),
        (_, Some(numbers)) => (true, numbers),
        _ => return Err(expected()),
    };
    let (around, along) = numbers.split_once(',').unwrap_or((numbers, "0"));
    let number = |text: &str| match text.bytes().all(|byte| byte.is_ascii_digit()) {
        true => text.parse::<u8>().map_err(|_| expected()),
        false => Err(expected()),
    };
    let (around, along) = (number(around)?, number(along)?);
    if around > HIGHEST || along > HIGHEST {
        return Err(format!("`{text}`: numbers up to {HIGHEST} were expected"));
    }
    match (sine, around) {
        (true, 0) => {
            Err(format!("`{text}` is zero in every direction: a sine has one period around the axis at least"))
        }
        (true, _) => Ok(ProbeTerm::Sine { around, along }),
        (false, _) => Ok(ProbeTerm::Cosine { around, along }),
    }
}

/// The name of a polynomial in parameters: `cos3`, `sin3,1`.
pub fn name(term: ProbeTerm) -> String {
    let of = |function: &str, around: u8, along: u8| match along {
        0 => format!("{function}{around}"),
        _ => format!("{function}{around},{along}"),
    };
    match term {
        ProbeTerm::Radius => "r0".to_owned(),
        ProbeTerm::Delay => "delay".to_owned(),
        ProbeTerm::Cosine { around, along } => of("cos", around, along),
        ProbeTerm::Sine { around, along } => of("sin", around, along),
    }
}

/// Reads a term of the effective stylus radius: `r0`, `delay`, `lobe[cos3]`, `lobe[sin3,1]`.
///
/// Fails with a text that says what was expected. First harmonics are refused: they are offsets of the tip, because they change
/// the radius as a shift of the tip by the same amount does.
pub fn read(text: &str) -> Result<ProbeTerm, String> {
    match text {
        "r0" => return Ok(ProbeTerm::Radius),
        "delay" => return Ok(ProbeTerm::Delay),
        _ => {}
    }
    let inside = text.strip_prefix("lobe[").and_then(|rest| rest.strip_suffix(']'));
    let inside = inside.ok_or_else(|| {
        format!(
            "`{text}` is no term of a probe; `r0`, `delay` or `lobe[...]` with a term such as `lobe[cos3]` was expected"
        )
    })?;
    let term = polynomial(inside)?;
    let offset = match term {
        ProbeTerm::Cosine { around: 1, along: 0 } => "dxt",
        ProbeTerm::Sine { around: 1, along: 0 } => "dyt",
        ProbeTerm::Cosine { around: 0, along: 1 } => "dzt",
        ProbeTerm::Cosine { around: 0, along: 0 } => {
            return Err("`lobe[cos0]` is the same in all directions: it is `r0`".to_owned());
        }
        _ => return Ok(term),
    };
    Err(format!("`{text}` is a shift of the tip: it is {offset}, which every machine has as a parameter"))
}

/// The parameter of a term of a probe: `probe.r0`, `stylus[2].probe.lobe[cos3]`. Coefficients are in mm, a delay in s.
pub fn parameter(prefix: &str, stylus: usize, term: ProbeTerm) -> Parameter {
    let (name, unit) = match term {
        ProbeTerm::Radius => ("r0".to_owned(), Unit::MM),
        ProbeTerm::Delay => ("delay".to_owned(), Unit::of(Quantity::Time)),
        term => (format!("lobe[{}]", name(term)), Unit::MM),
    };
    Parameter::new(format!("{prefix}probe.{name}"), unit).with_role(ParameterRole::Probe { stylus, term })
}

/// The value of a term in a direction, and its derivative to the direction. A delay multiplies minus `feed` in mm/s.
pub fn value(term: ProbeTerm, direction: &Vector3<f64>, feed: f64) -> (f64, Vector3<f64>) {
    let (sine, around, along) = match term {
        ProbeTerm::Radius => return (1.0, Vector3::zeros()),
        ProbeTerm::Delay => return (-feed, Vector3::zeros()),
        ProbeTerm::Cosine { around, along } => (false, i32::from(around), i32::from(along)),
        ProbeTerm::Sine { around, along } => (true, i32::from(around), i32::from(along)),
    };
    let (lower, full) = powers(direction.x, direction.y, around);
    let (power, slope) =
        (direction.z.powi(along), if along == 0 { 0.0 } else { f64::from(along) * direction.z.powi(along - 1) });
    let of = f64::from(around);
    // d(w^M)/dx = M w^(M-1), d(w^M)/dy = i M w^(M-1), with w = x + i y.
    let (value, by_x, by_y) = match sine {
        false => (full.0, of * lower.0, -of * lower.1),
        true => (full.1, of * lower.1, of * lower.0),
    };
    (value * power, Vector3::new(by_x * power, by_y * power, value * slope))
}

/// `(x + i y)^(power - 1)` and `(x + i y)^power` as real and imaginary parts; the first is zero for power 0.
fn powers(x: f64, y: f64, power: i32) -> ((f64, f64), (f64, f64)) {
    let (mut lower, mut full) = ((0.0, 0.0), (1.0, 0.0));
    for _ in 0..power {
        lower = full;
        full = (lower.0 * x - lower.1 * y, lower.0 * y + lower.1 * x);
    }
    (lower, full)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Some directions all around, poles among them.
    fn directions() -> Vec<Vector3<f64>> {
        let mut all = vec![Vector3::z(), -Vector3::z(), Vector3::x()];
        for step in 0..40 {
            let (azimuth, z) = (2.4 * f64::from(step), f64::from(step) / 20.0 - 0.975);
            let across = (1.0 - z * z).sqrt();
            all.push(Vector3::new(across * azimuth.cos(), across * azimuth.sin(), z));
        }
        all
    }

    #[test]
    fn terms_are_those_of_azimuth_and_elevation() {
        for direction in directions() {
            let (azimuth, elevation) = (direction.y.atan2(direction.x), direction.z.asin());
            for around in 0..8_u8 {
                for along in 0..4_u8 {
                    let common = elevation.cos().powi(around.into()) * elevation.sin().powi(along.into());
                    let angle = f64::from(around) * azimuth;
                    let (cosine, _) = value(ProbeTerm::Cosine { around, along }, &direction, 0.0);
                    assert!((cosine - angle.cos() * common).abs() < 1e-14);
                    if around > 0 {
                        let (sine, _) = value(ProbeTerm::Sine { around, along }, &direction, 0.0);
                        assert!((sine - angle.sin() * common).abs() < 1e-14);
                    }
                }
            }
        }
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let step = 1e-6;
        for direction in directions() {
            for around in 0..7_u8 {
                for along in 0..4_u8 {
                    let mut terms = vec![ProbeTerm::Cosine { around, along }];
                    terms.extend((around > 0).then_some(ProbeTerm::Sine { around, along }));
                    for term in terms {
                        let (_, slope) = value(term, &direction, 0.0);
                        for axis in 0..3 {
                            let at = |by: f64| {
                                let mut moved = direction;
                                moved[axis] += by;
                                value(term, &moved, 0.0).0
                            };
                            let difference = (at(step) - at(-step)) / (2.0 * step);
                            assert!((difference - slope[axis]).abs() < 1e-8, "{term:?} {direction} {axis}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn names_round_trip() {
        for text in ["r0", "delay", "lobe[cos0,2]", "lobe[cos1,1]", "lobe[sin1,1]", "lobe[cos2]", "lobe[sin6]"] {
            let parameter = parameter("", 0, read(text).unwrap());
            assert_eq!(parameter.name, format!("probe.{text}"));
        }
        assert_eq!(read("lobe[cos3,0]"), read("lobe[cos3]"));
        assert_eq!(parameter("stylus[2].", 1, ProbeTerm::Radius).name, "stylus[2].probe.r0");
    }

    #[test]
    fn shifts_of_the_tip_are_refused_with_their_names() {
        for (text, expected) in [
            ("lobe[cos1]", "it is dxt"),
            ("lobe[sin1]", "it is dyt"),
            ("lobe[cos0,1]", "it is dzt"),
            ("lobe[cos1,0]", "it is dxt"),
            ("lobe[cos0]", "it is `r0`"),
            ("lobe[sin0,2]", "zero in every direction"),
            ("lobe[tan3]", "no term"),
            ("lobe[cos-3]", "no term"),
            ("lobe[cos+3]", "no term"),
            ("lobe[cos]", "no term"),
            ("lobe[cos3", "no term of a probe"),
            ("lobe[cos99]", "numbers up to 24"),
            ("lobe[cos3,]", "no term"),
            ("radius", "no term of a probe"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains(expected), "{text}: {message}");
        }
        // They are: a shift of the tip changes the distance by its part along the normal.
        for direction in directions() {
            let (cosine, _) = value(ProbeTerm::Cosine { around: 1, along: 0 }, &direction, 0.0);
            assert!((cosine - direction.x).abs() < 1e-15);
        }
    }
}
