//! Legendre and Chebyshev polynomials of the command.

use abbe_core::{SettingsError, Whole};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::travel::{Travel, legendre};
use super::{Argument, Family, Functions, Subject, Term, check_numbers, numbers};

/// Makes the family of one kind of orthogonal polynomials: the same settings, other polynomials.
macro_rules! orthogonal {
    ($family:ident, $key:ident, $kind:expr, $doc:literal) => {
        #[doc = $doc]
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct $family {
            /// Motion errors by ISO 230-1 symbol, e.g. EXX; `?` and `*` are wildcards.
            pub $key: Vec<String>,
            /// The degrees, 0 to 9.
            pub degrees: Vec<Whole<0, 9>>,
            /// Travel of a linear axis. Default: the range of the axis.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub range_mm: Option<[f64; 2]>,
            /// Travel of a rotary axis. Default: the range of the axis.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub range_deg: Option<[f64; 2]>,
            /// For straightness: every function is taken without its least-squares line over the travel.
            #[serde(default, skip_serializing_if = "std::ops::Not::not")]
            pub without_line: bool,
            /// For errors of a rotary axis: every function is taken without its once-per-turn part.
            #[serde(default, skip_serializing_if = "std::ops::Not::not")]
            pub without_once_per_turn: bool,
        }

        impl $family {
            fn travel(&self) -> Travel {
                Travel {
                    range_mm: self.range_mm,
                    range_deg: self.range_deg,
                    without_line: self.without_line,
                    without_once_per_turn: self.without_once_per_turn,
                }
            }
        }

        impl Family for $family {
            fn symbols(&self) -> &[String] {
                &self.$key
            }

            fn check(&self) -> Result<(), SettingsError> {
                check_numbers("degrees", "degree", &self.degrees)?;
                self.travel().check()?;
                self.travel().check_degrees("degrees", &numbers(&self.degrees))
            }

            fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
                let range = self.travel().required_range(subject, concat!("a ", stringify!($family), " polynomial"))?;
                let functions = OrthogonalPolynomial { kind: $kind, degrees: numbers(&self.degrees), range };
                Ok(vec![self.travel().without_trend(Box::new(functions), subject)?])
            }
        }
    };
}

orthogonal!(
    Legendre,
    legendre,
    Orthogonal::Legendre,
    "Legendre polynomials of the command scaled to -1..1 over the travel: `EXX[leg1]`, `EXX[leg2]`, ... in the unit of the error."
);
orthogonal!(
    Chebyshev,
    chebyshev,
    Orthogonal::Chebyshev,
    "Chebyshev polynomials of the first kind of the command scaled to -1..1 over the travel: `EXX[cheb1]`, `EXX[cheb2]`, ... in the unit of the error."
);

/// Which polynomials.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Orthogonal {
    /// Orthogonal with equal weight over the travel.
    Legendre,
    /// Of the first kind: between -1 and 1, orthogonal with more weight at the ends.
    Chebyshev,
}

/// Orthogonal polynomials of the command scaled to -1..1 over a range.
#[derive(Debug, Clone, PartialEq)]
pub struct OrthogonalPolynomial {
    /// Which polynomials.
    pub kind: Orthogonal,
    /// The degrees.
    pub degrees: Vec<u8>,
    /// The travel, mm or rad.
    pub range: [f64; 2],
}

impl OrthogonalPolynomial {
    /// Values and slopes in the scaled command.
    fn at(&self, command: f64) -> impl Iterator<Item = (f64, f64)> {
        let [from, to] = self.range;
        let scaled = (2.0 * command - from - to) / (to - from);
        let of = match self.kind {
            Orthogonal::Legendre => legendre,
            Orthogonal::Chebyshev => chebyshev,
        };
        self.degrees.iter().map(move |&degree| of(degree, scaled))
    }
}

impl Functions for OrthogonalPolynomial {
    fn arguments(&self) -> Vec<Argument> {
        vec![Argument::Command]
    }

    fn terms(&self) -> Vec<Term> {
        let name = match self.kind {
            Orthogonal::Legendre => "leg",
            Orthogonal::Chebyshev => "cheb",
        };
        self.degrees.iter().map(|degree| Term::new(format!("[{name}{degree}]"), 0)).collect()
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        out.iter_mut().zip(self.at(arguments[0])).for_each(|(out, (value, _))| *out = value);
    }

    fn slopes(&self, _: usize, arguments: &[f64], out: &mut [f64]) {
        let scale = 2.0 / (self.range[1] - self.range[0]);
        out.iter_mut().zip(self.at(arguments[0])).for_each(|(out, (_, slope))| *out = slope * scale);
    }

    fn range(&self) -> Option<[f64; 2]> {
        Some(self.range)
    }
}

/// The Chebyshev polynomial of the first kind and its slope, by the recursion.
fn chebyshev(degree: u8, x: f64) -> (f64, f64) {
    let (mut before, mut current) = ((1.0, 0.0), (x, 1.0));
    if degree == 0 {
        return before;
    }
    for _ in 1..degree {
        let next = (2.0 * x * current.0 - before.0, 2.0 * current.0 + 2.0 * x * current.1 - before.1);
        (before, current) = (current, next);
    }
    current
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::families::testing::{names, slopes_agree, values};

    fn polynomial(kind: Orthogonal, degrees: &[u8]) -> OrthogonalPolynomial {
        OrthogonalPolynomial { kind, degrees: degrees.to_vec(), range: [-250.0, 150.0] }
    }

    #[test]
    fn values_by_hand() {
        let legendre = polynomial(Orthogonal::Legendre, &[0, 1, 2, 3]);
        assert_eq!(names(&legendre), ["[leg0]", "[leg1]", "[leg2]", "[leg3]"]);
        assert_eq!(values(&legendre, &[150.0]), [1.0; 4]);
        assert_eq!(values(&legendre, &[50.0]), [1.0, 0.5, -0.125, -0.4375]);
        let chebyshev = polynomial(Orthogonal::Chebyshev, &[0, 1, 2, 3]);
        assert_eq!(names(&chebyshev), ["[cheb0]", "[cheb1]", "[cheb2]", "[cheb3]"]);
        assert_eq!(values(&chebyshev, &[50.0]), [1.0, 0.5, -0.5, -1.0]);
    }

    proptest! {
        #[test]
        fn chebyshev_polynomials_are_cosines(degree in 0u8..10, angle in 0.0..3.0_f64) {
            let value = values(&polynomial(Orthogonal::Chebyshev, &[degree]), &[200.0 * angle.cos() - 50.0])[0];
            prop_assert!((value - (f64::from(degree) * angle).cos()).abs() < 1e-11);
        }

        #[test]
        fn slopes_are_those_of_the_values(at in -250.0..150.0_f64, degree in 0u8..10) {
            for kind in [Orthogonal::Legendre, Orthogonal::Chebyshev] {
                slopes_agree(&polynomial(kind, &[degree]), at, 1e-4, 1e-7);
            }
        }
    }
}
