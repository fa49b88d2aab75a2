//! Proves the coefficients and their standard deviations against the certified ones of NIST's linear reference problems,
//! to as many digits as the condition of each leaves in double precision.

use abbe_numerics::{End, Options, solve};
use serde_json::Value;

use crate::linear::{DesignMatrix, fit_linear};
use crate::problems::{Linear, given};

fn numbers(value: &Value) -> Vec<f64> {
    let number = |value: &Value| value.as_f64().or_else(|| value.as_str()?.parse().ok()).expect("a number");
    value.as_array().expect("a list").iter().map(number).collect()
}

fn problem(set: &Value) -> Linear {
    let row = |x: &Value| -> Vec<f64> {
        if set["form"] == "polynomial" {
            let x = x.as_f64().expect("a number");
            return (0..=set["degree"].as_i64().expect("a degree")).map(|degree| x.powi(degree as i32)).collect();
        }
        let mut row = if set["intercept"] == true { vec![1.0] } else { Vec::new() };
        row.extend(x.as_f64().map_or_else(|| numbers(x), |x| vec![x]));
        row
    };
    Linear {
        rows: set["x"].as_array().expect("a list").iter().map(row).collect(),
        residuals: numbers(&set["y"]).iter().map(|y| -y).collect(),
    }
}

/// Powers of a number, each as two numbers that are added up.
fn doubled_powers(x: f64, degree: i64) -> (Vec<f64>, Vec<f64>) {
    let (mut high, mut low) = (vec![1.0], vec![0.0]);
    for power in 1..=degree as usize {
        let product = high[power - 1] * x;
        high.push(product);
        low.push(high[power - 1].mul_add(x, -product) + low[power - 1] * x);
    }
    (high, low)
}

/// The problem with polynomials to twice the digits: rounded powers alone move the coefficients of Filip by 2e-8.
fn design(set: &Value, rows: &[Vec<f64>]) -> DesignMatrix {
    if set["form"] != "polynomial" {
        return DesignMatrix::new(rows);
    }
    let degree = set["degree"].as_i64().expect("a degree");
    let (high, low): (Vec<_>, Vec<_>) = numbers(&set["x"]).into_iter().map(|x| doubled_powers(x, degree)).unzip();
    DesignMatrix::doubled(&high, &low)
}

#[test]
fn refined_coefficients_have_at_least_twelve_digits() {
    let reference: Value = serde_json::from_str(include_str!("../data/nist-linear.json")).expect("JSON");
    for (name, set) in reference["sets"].as_object().expect("sets") {
        let problem = problem(set);
        let right: Vec<f64> = problem.residuals.iter().map(|value| -value).collect();
        let fit = fit_linear(&design(set, &problem.rows), &right).expect("full rank");
        let exact = if set["rounded_to_double"].is_null() { &set["exact"] } else { &set["rounded_to_double"] };
        let found = digits(&fit.values, &numbers(&exact["parameters"]));
        let published = numbers(&set["exact"]["standard_deviations"]);
        let deviations = if published[0] > 0.0 { digits(&fit.standard_uncertainties(), &published) } else { 16.0 };
        println!("{name}: {found:.1} digits, deviations {deviations:.1}, last correction {:.0e}", fit.last_correction);
        assert!(found >= 12.0, "{name}: {found}");
        // Deviations come from the triangular factor, which is not refined.
        assert!(deviations >= if name == "Filip" { 7.0 } else { 9.0 }, "{name}: {deviations}");
    }
}

/// Correct digits of the worst value.
fn digits(found: &[f64], certified: &[f64]) -> f64 {
    assert_eq!(found.len(), certified.len());
    let worst = found.iter().zip(certified).map(|(found, certified)| ((found - certified) / certified).abs());
    -worst.fold(1e-16, f64::max).log10()
}

#[test]
fn coefficients_are_the_certified_ones() {
    let reference: Value = serde_json::from_str(include_str!("../data/nist-linear.json")).expect("JSON");
    // Digits that double precision permits: of the coefficients and of the standard deviations.
    let expected = [
        ("Norris", 11.0, 12.0),
        ("Pontius", 11.0, 11.0),
        ("NoInt1", 14.0, 13.0),
        ("NoInt2", 14.0, 13.0),
        ("Filip", 6.0, 6.0),
        ("Longley", 9.0, 9.0),
        ("Wampler1", 8.5, 0.0),
        ("Wampler2", 9.0, 0.0),
        ("Wampler3", 8.5, 9.0),
        ("Wampler4", 7.0, 9.0),
        ("Wampler5", 5.0, 9.0),
    ];
    assert_eq!(reference["sets"].as_object().map(serde_json::Map::len), Some(expected.len()));
    for (name, of_coefficients, of_deviations) in expected {
        let set = &reference["sets"][name];
        let problem = problem(set);
        let factor = problem.factor(problem.rows.len());
        let exact = if set["rounded_to_double"].is_null() { &set["exact"] } else { &set["rounded_to_double"] };
        let certified = numbers(&exact["parameters"]);
        let found = digits(&factor.step().expect("full rank"), &certified);
        let by_pieces = digits(&problem.factor(1).step().expect("full rank"), &certified);
        let by_spectrum = digits(&factor.spectrum().step(certified.len()), &certified);
        let freedom = (factor.rows() - factor.unknowns()) as f64;
        let variance = factor.remaining_cost() / freedom;
        let covariance = factor.covariance_root(certified.len()).covariance();
        let deviations: Vec<f64> = (0..certified.len()).map(|k| (variance * covariance[k][k]).sqrt()).collect();
        let published = numbers(&set["exact"]["standard_deviations"]);
        let of_spread = if published[0] > 0.0 { digits(&deviations, &published) } else { 0.0 };
        let options = Options { iterations: 20, tolerance: 1e-14, ..Options::USUAL };
        let Ok(solution) = solve(&given(&problem), &vec![0.0; certified.len()], &options);
        let iterated = digits(&solution.x, &certified);
        println!(
            "{name}: {found:.1} digits, {by_pieces:.1} in pieces, {by_spectrum:.1} by singular values, {iterated:.1} iterated; \
             deviations {of_spread:.1}"
        );
        assert!(found >= of_coefficients && by_pieces >= of_coefficients, "{name}: {found} {by_pieces}");
        assert!(by_spectrum >= of_coefficients - 1.0, "{name}: {by_spectrum}");
        assert!(of_spread >= of_deviations, "{name}: {of_spread}");
        assert!(iterated >= of_coefficients && solution.end == End::Converged, "{name}: {iterated} {:?}", solution.end);
        // What an exact fit leaves is rounding only.
        if published[0] == 0.0 {
            assert!(factor.remaining_cost() < 1e-20 * factor.cost(), "{name}");
        }
    }
}
