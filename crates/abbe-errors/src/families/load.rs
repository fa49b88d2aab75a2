//! Errors under the weight of the workpiece.

use abbe_core::{Quantity, SettingsError, Whole};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::knots::{Knots, knots, within};
use super::{Argument, Family, Functions, Group, PiecewisePolynomial, Subject, Term, piecewise, suits};

/// Errors under the weight of the workpiece (Soons 1993, eq. 3.20), from the columns `load_N` and `load_z_mm`. A column
/// that is missing counts as zero. Motion errors: piecewise polynomials `EAX[load:1]`, `EAX[load:pp3,2]`, the error
/// under the reference load at the centre of the table. Location errors: `EA0B[load]`, the error under the reference
/// load, and `EA0B[load*z]`, its change per mm of the distance of the load from the centre along z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Load {
    /// Motion or location errors by ISO 230-1 symbol, e.g. EAX or EA0B; `?` and `*` are wildcards.
    pub load: Vec<String>,
    /// The load to which the coefficients refer.
    #[serde(rename = "reference_N")]
    #[schemars(range(min = 1e-3, max = 1e7))]
    pub reference_n: f64,
    /// Distance of the twisted guideway from the centre of the table, along z: a load at the guideway has no effect.
    /// If it is missing, the error does not depend on the position of the load.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub guideway_distance_mm: Option<f64>,
    /// Degree of the pieces of a motion error, 1 to 9.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub degree: Option<Whole<1, 9>>,
    /// What is continuous at knots: 0 the value, 1 the slope too. Required if there are knots.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub continuity: Option<Whole<0, 8>>,
    /// Inner knots of errors of a linear axis; none if it is a plain polynomial.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub knots_mm: Option<Knots>,
    /// Inner knots of errors of a rotary axis; none if it is a plain polynomial.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub knots_deg: Option<Knots>,
}

impl Load {
    fn has_knots(&self) -> bool {
        self.knots_mm.is_some() || self.knots_deg.is_some()
    }

    fn motion(&self, degree: Whole<1, 9>, subject: &Subject<'_>) -> Result<Box<dyn Functions>, SettingsError> {
        suits(("knots", "knots"), subject, self.knots_mm.is_some(), self.knots_deg.is_some())?;
        let knots = match self.has_knots() {
            true => knots("a piecewise polynomial", &self.knots_mm, &self.knots_deg, 1)?,
            false => Vec::new(),
        };
        if let Some(range) = subject.range {
            within(&knots, range, subject.command == Quantity::Angle)?;
        }
        let range = subject.range.filter(|_| self.has_knots());
        let continuity = self.continuity.unwrap_or(Whole::new(0));
        let shape = PiecewisePolynomial::new(knots, 1..=degree.get() as u8, continuity.get() as u8, range);
        Ok(Box::new(UnderLoad { shape, reference: self.reference_n, distance: self.guideway_distance_mm }))
    }
}

impl Family for Load {
    fn symbols(&self) -> &[String] {
        &self.load
    }

    fn group(&self) -> Group {
        Group::LocationOrMotion
    }

    fn check(&self) -> Result<(), SettingsError> {
        if !(self.reference_n > 0.0 && self.reference_n.is_finite()) {
            return Err(SettingsError::new("reference_N", "a positive force was expected"));
        }
        if self.guideway_distance_mm.is_some_and(|distance| !(1.0..=1e5).contains(&distance.abs())) {
            let message = "a distance of 1 to 100000 mm, to either side, was expected";
            return Err(SettingsError::new("guideway_distance_mm", message));
        }
        if self.has_knots() {
            knots("a piecewise polynomial", &self.knots_mm, &self.knots_deg, 1)?;
        }
        match (self.degree, self.continuity, self.has_knots()) {
            (None, None, false) => Ok(()),
            (None, ..) => Err(SettingsError::new("", "pieces need a `degree`")),
            (Some(_), None, true) => Err(SettingsError::new("", "knots need a `continuity`")),
            (Some(_), Some(_), false) => Err(SettingsError::new("continuity", "there are no knots")),
            (Some(degree), continuity, _) => piecewise::check(degree, continuity.unwrap_or(Whole::new(0))),
        }
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        Ok(vec![match (subject.location, self.degree) {
            (true, None) if self.guideway_distance_mm.is_none() => {
                Box::new(LocationUnderLoad { reference: self.reference_n })
            }
            (true, None) => {
                let message = "a location error under load has a term of its own for the place of the load";
                return Err(SettingsError::new("guideway_distance_mm", message));
            }
            (true, Some(_)) => {
                let error = SettingsError::new("degree", "a location error does not change with the command");
                return Err(error.help("give motion errors and location errors a line each"));
            }
            (false, Some(degree)) => self.motion(degree, subject)?,
            (false, None) => return Err(SettingsError::new("", "a motion error under load needs a `degree`")),
        }])
    }
}

/// A piecewise polynomial times load / reference load, and times (distance - z) / distance for the position z of the load.
#[derive(Debug, Clone, PartialEq)]
pub struct UnderLoad {
    /// The error under the reference load at the centre.
    pub shape: PiecewisePolynomial,
    /// Reference load, N.
    pub reference: f64,
    /// Position where the load has no effect, mm along z; none if the error does not depend on the position.
    pub distance: Option<f64>,
}

impl UnderLoad {
    fn factor(&self, arguments: &[f64]) -> f64 {
        let lever = self.distance.map_or(1.0, |distance| (distance - arguments[2]) / distance);
        arguments[1] / self.reference * lever
    }
}

impl Functions for UnderLoad {
    fn arguments(&self) -> Vec<Argument> {
        let place = self.distance.map(|_| Argument::LoadZ);
        [Argument::Command, Argument::Load].into_iter().chain(place).collect()
    }

    fn terms(&self) -> Vec<Term> {
        self.shape.names().map(|(name, power)| Term::new(format!("[load:{name}]"), power)).collect()
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        self.shape.values(arguments, out);
        let factor = self.factor(arguments);
        out.iter_mut().for_each(|out| *out *= factor);
    }

    fn slopes(&self, by: usize, arguments: &[f64], out: &mut [f64]) {
        if by != 0 {
            return out.fill(0.0);
        }
        self.shape.slopes(0, arguments, out);
        let factor = self.factor(arguments);
        out.iter_mut().for_each(|out| *out *= factor);
    }

    fn range(&self) -> Option<[f64; 2]> {
        self.shape.range()
    }

    fn breaks(&self) -> &[f64] {
        self.shape.breaks()
    }
}

/// A constant per reference load, and the same per mm of the position of the load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocationUnderLoad {
    /// Reference load, N.
    pub reference: f64,
}

impl Functions for LocationUnderLoad {
    fn arguments(&self) -> Vec<Argument> {
        vec![Argument::Load, Argument::LoadZ]
    }

    fn terms(&self) -> Vec<Term> {
        vec![Term::new("[load]", 0), Term { per: Some(Quantity::Length), ..Term::new("[load*z]", 1) }]
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        let load = arguments[0] / self.reference;
        out.copy_from_slice(&[load, load * arguments[1]]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::{names, slopes_agree, values};

    fn under_load(distance: Option<f64>) -> UnderLoad {
        UnderLoad { shape: PiecewisePolynomial::new(vec![50.0], 1..=2, 1, None), reference: 4900.0, distance }
    }

    #[test]
    fn values_by_hand() {
        let error = under_load(Some(375.0));
        assert_eq!(names(&error), ["[load:1]", "[load:2]", "[load:pp1,2]"]);
        assert_eq!(values(&error, &[60.0, 4900.0, 0.0]), [60.0, 3600.0, 100.0]);
        assert_eq!(values(&error, &[60.0, 2450.0, -375.0]), [60.0, 3600.0, 100.0]);
        assert_eq!(values(&error, &[60.0, 2450.0, 375.0]), [0.0; 3]);
        assert_eq!(values(&under_load(None), &[60.0, 2450.0]), [30.0, 1800.0, 50.0]);
        let location = LocationUnderLoad { reference: 4900.0 };
        assert_eq!(names(&location), ["[load]", "[load*z]"]);
        assert_eq!(values(&location, &[2450.0, -200.0]), [0.5, -100.0]);
        assert_eq!(location.terms()[1].unit(Quantity::Angle, Quantity::Angle).to_string(), "rad/mm");
    }

    proptest::proptest! {
        #[test]
        fn slopes_are_those_of_the_values(at in 0.0..100.0_f64) {
            struct_slopes(at);
        }
    }

    fn struct_slopes(at: f64) {
        #[derive(Debug)]
        struct At(UnderLoad);
        impl Functions for At {
            fn arguments(&self) -> Vec<Argument> {
                vec![Argument::Command]
            }
            fn terms(&self) -> Vec<Term> {
                self.0.terms()
            }
            fn values(&self, arguments: &[f64], out: &mut [f64]) {
                self.0.values(&[arguments[0], 3000.0, -80.0], out);
            }
            fn slopes(&self, by: usize, arguments: &[f64], out: &mut [f64]) {
                self.0.slopes(by, &[arguments[0], 3000.0, -80.0], out);
            }
        }
        slopes_agree(&At(under_load(Some(375.0))), at, 1e-5, 1e-6);
    }
}
