//! Materials of references for a range of temperatures (Muelaner et al. 2014, eq. 1 and table 1).

/// A material that references are made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Its name.
    pub name: &'static str,
    /// The largest admissible expansion has to be above this one, 1/K.
    pub above: f64,
}

/// Materials of table 1 of Muelaner et al. 2014, that of the largest expansion first.
pub const MATERIALS: [Material; 3] = [
    Material { name: "aluminium", above: 23e-6 },
    Material { name: "tooling steel", above: 11e-6 },
    Material { name: "invar", above: 1.2e-6 },
];

/// The largest coefficient of expansion (1/K) of an artefact whose length (mm) may change by half a tolerance (mm) when the
/// temperature leaves its mean by half its range (K): tolerance / (2 length half-range), eq. 1.
///
/// None unless all are above zero. Without a range any material will do: infinite.
///
/// ```
/// use abbe_standards::material::largest_expansion;
///
/// let expansion = largest_expansion(0.030, 650.0, 2.0).unwrap();
/// assert!((expansion - 11.54e-6).abs() < 1e-8);
/// ```
pub fn largest_expansion(tolerance: f64, length: f64, half_range: f64) -> Option<f64> {
    let valid = tolerance > 0.0 && length > 0.0 && half_range >= 0.0;
    (valid && tolerance.is_finite() && length.is_finite()).then(|| tolerance / (2.0 * length * half_range))
}

/// The materials that are admissible. The largest expansion has to be above that of the material: as large is not enough.
pub fn admissible(largest_expansion: f64) -> impl Iterator<Item = Material> {
    // One part in 10¹²: a quotient of rounded numbers is not above a limit that it equals.
    MATERIALS.into_iter().filter(move |material| largest_expansion > material.above * (1.0 + 1e-12))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    #[test]
    fn published_examples_are_met() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../pipelines/data/thermal-spindle/beam.json");
        let text = std::fs::read_to_string(path).expect("a file");
        let all: Value = serde_json::from_str(&text).expect("JSON");
        let examples = all["material_rule"]["examples"].as_array().expect("examples");
        assert_eq!(examples.len(), 2);
        for example in examples {
            let number = |name: &str| example[name].as_f64().expect("a number");
            let found =
                largest_expansion(1e-3 * number("tolerance_um"), 1e3 * number("length_m"), number("half_range_K"))
                    .expect("an expansion");
            assert!((found * 1e6 - number("E_max_um_per_m_K")).abs() < 1e-9);
            let names: Vec<&str> = admissible(found).map(|material| material.name).collect();
            let expected: Vec<&str> =
                example["allowed"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
            assert_eq!(names, expected);
        }
        assert_eq!(largest_expansion(0.01, 0.0, 1.0), None);
        assert_eq!(admissible(largest_expansion(0.01, 500.0, 0.0).expect("any")).count(), 3);
    }
}
