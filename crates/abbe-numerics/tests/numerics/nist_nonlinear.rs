//! Proves the iteration on NIST's non-linear reference problems from both starts: it ends at the certified values, or says
//! that it did not converge.

use abbe_numerics::{End, LeastSquares, Options, solve};
use serde_json::Value;

/// A value with its derivatives to the parameters.
#[derive(Clone)]
struct Dual(f64, Vec<f64>);

impl Dual {
    fn of(value: f64, count: usize) -> Self {
        Self(value, vec![0.0; count])
    }

    fn chain(self, value: f64, slope: f64) -> Self {
        Self(value, self.1.into_iter().map(|by| by * slope).collect())
    }

    fn combine(self, other: &Self, value: f64, own: f64, others: f64) -> Self {
        Self(value, self.1.iter().zip(&other.1).map(|(a, b)| own * a + others * b).collect())
    }
}

/// Evaluates a formula such as `b1*(1 - exp(-b2*x))` from left to right, with derivatives.
struct Formula<'a> {
    rest: &'a str,
    parameters: &'a [f64],
    x: &'a [f64],
}

impl Formula<'_> {
    fn take(&mut self, token: &str) -> bool {
        let rest = self.rest.trim_start();
        let found = rest.starts_with(token) && !(token == "*" && rest.starts_with("**"));
        if found {
            self.rest = &rest[token.len()..];
        }
        found
    }

    fn sum(&mut self) -> Dual {
        let mut total = self.product();
        loop {
            let sign = if self.take("+") {
                1.0
            } else if self.take("-") {
                -1.0
            } else {
                return total;
            };
            let other = self.product();
            let value = total.0 + sign * other.0;
            total = total.combine(&other, value, 1.0, sign);
        }
    }

    fn product(&mut self) -> Dual {
        let mut total = self.signed();
        loop {
            if self.take("*") {
                let other = self.signed();
                let (a, b) = (total.0, other.0);
                total = total.combine(&other, a * b, b, a);
            } else if self.take("/") {
                let other = self.signed();
                let (a, b) = (total.0, other.0);
                total = total.combine(&other, a / b, 1.0 / b, -a / (b * b));
            } else {
                return total;
            }
        }
    }

    fn signed(&mut self) -> Dual {
        if self.take("-") {
            let inner = self.signed();
            let value = -inner.0;
            return inner.chain(value, -1.0);
        }
        let base = self.atom();
        if !self.take("**") {
            return base;
        }
        let exponent = self.signed();
        let (a, b) = (base.0, exponent.0);
        let value = a.powf(b);
        let by_exponent = if exponent.1.iter().all(|by| *by == 0.0) { 0.0 } else { value * a.ln() };
        base.combine(&exponent, value, b * a.powf(b - 1.0), by_exponent)
    }

    fn atom(&mut self) -> Dual {
        if self.take("(") {
            let inner = self.sum();
            assert!(self.take(")"), "{}", self.rest);
            return inner;
        }
        let count = self.parameters.len();
        let rest = self.rest.trim_start();
        let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '.')).unwrap_or(rest.len());
        let word = &rest[..end];
        self.rest = &rest[end..];
        if let Ok(number) = word.parse() {
            return Dual::of(number, count);
        }
        match word {
            "pi" => Dual::of(std::f64::consts::PI, count),
            "x" => Dual::of(self.x[0], count),
            "x2" => Dual::of(self.x[1], count),
            "exp" | "cos" | "sin" | "atan" | "sqrt" => {
                let inner = self.atom();
                let at = inner.0;
                let (value, slope) = match word {
                    "exp" => (at.exp(), at.exp()),
                    "cos" => (at.cos(), -at.sin()),
                    "sin" => (at.sin(), at.cos()),
                    "atan" => (at.atan(), 1.0 / (1.0 + at * at)),
                    _ => (at.sqrt(), 0.5 / at.sqrt()),
                };
                inner.chain(value, slope)
            }
            name => {
                let index: usize = name.strip_prefix('b').and_then(|index| index.parse().ok()).expect("a parameter");
                let mut value = Dual::of(self.parameters[index - 1], count);
                value.1[index - 1] = 1.0;
                value
            }
        }
    }
}

struct Curve {
    formula: String,
    x: Vec<Vec<f64>>,
    y: Vec<f64>,
    count: usize,
    /// What residuals are divided by: a millionth of the largest response.
    unit: f64,
}

impl LeastSquares for Curve {
    type Error = std::convert::Infallible;

    fn unknowns(&self) -> usize {
        self.count
    }

    fn rows(&self) -> usize {
        self.y.len()
    }

    fn linearise(&self, parameters: &[f64], sink: &mut dyn FnMut(usize, &[f64], &[f64])) -> Result<(), Self::Error> {
        for (row, (x, y)) in self.x.iter().zip(&self.y).enumerate() {
            let Dual(value, by) = Formula { rest: &self.formula, parameters, x }.sum();
            let by: Vec<f64> = by.iter().map(|by| by / self.unit).collect();
            sink(row, &[(value - y) / self.unit], &by);
        }
        Ok(())
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    let number = |value: &Value| value.as_f64().or_else(|| value.as_str()?.parse().ok()).expect("a number");
    value.as_array().map_or_else(|| vec![number(value)], |list| list.iter().map(number).collect())
}

#[test]
fn it_ends_at_the_certified_values_or_says_that_it_does_not() {
    let reference: Value = serde_json::from_str(include_str!("../data/nist-nonlinear.json")).expect("JSON");
    let mut solved = 0;
    let mut wrong = Vec::new();
    for (name, set) in reference["sets"].as_object().expect("sets") {
        let formula = set["model"].as_str().expect("a formula").rsplit('=').next().expect("a side").to_owned();
        let logarithm = set["log_response"] == true;
        let y: Vec<f64> = numbers(&set["y"]).iter().map(|y| if logarithm { y.ln() } else { *y }).collect();
        let certified = numbers(&set["exact"]["parameters"]);
        let unit = 1e-6 * y.iter().fold(0.0_f64, |largest, y| largest.max(y.abs()));
        let x = set["x"].as_array().expect("a list").iter().map(numbers).collect();
        let curve = Curve { formula, x, y, count: certified.len(), unit };
        for start in ["start_1", "start_2"] {
            let options = Options { iterations: 500, ..Options::USUAL };
            let Ok(solution) = solve(&curve, &numbers(&set[start]), &options);
            let off = solution.x.iter().zip(&certified).map(|(found, exact)| ((found - exact) / exact).abs());
            let digits = -off.fold(1e-16, f64::max).log10();
            println!("{name} {start}: {digits:.1} digits, {:?} after {} iterations", solution.end, solution.iterations);
            match solution.end {
                End::Converged if digits >= 6.0 => solved += 1,
                End::Converged => wrong.push(format!("{name} {start}: {digits:.1}")),
                // The second starts are near enough for all.
                _ => assert_eq!(start, "start_1", "{name}"),
            }
        }
    }
    println!("solved: {solved} of 54");
    assert!(wrong.is_empty(), "converged elsewhere: {wrong:?}");
    // BoxBOD, Eckerle4, MGH09, MGH10, MGH17 and Rat43 start where full or halved steps of Gauss and Newton lead astray.
    assert!(solved >= 48, "{solved}");
}
