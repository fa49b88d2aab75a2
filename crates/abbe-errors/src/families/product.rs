//! Cross-coupling: errors that depend on the commands of several axes.

use abbe_core::{PathItem, Quantity, SettingsError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Argument, Family, Functions, Subject, Term};

/// Cross-coupling (Soons 1993, eq. 3.19): `EAY[X*Y]` is the product of the commands of axes, `EAY[X]` the command of another one; in the
/// unit of the error per mm or rad.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Product {
    /// Motion errors by ISO 230-1 symbol, e.g. EAY; `?` and `*` are wildcards.
    pub product: Vec<String>,
    /// The axes whose commands are multiplied; all linear or all rotary.
    pub of: Vec<String>,
}

impl Family for Product {
    fn symbols(&self) -> &[String] {
        &self.product
    }

    fn check(&self) -> Result<(), SettingsError> {
        match self.of.len() {
            1..=9 => Ok(()),
            count => Err(SettingsError::new("of", format!("a product of {count} axes: 1 to 9 was expected"))),
        }
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        let mut quantity = None;
        for (index, name) in self.of.iter().enumerate() {
            let at = [PathItem::Key("of".to_owned()), PathItem::Index(index)];
            let Some((_, own)) = subject.axes.iter().find(|(axis, _)| axis == name) else {
                let axes = subject.axes.iter().map(|(axis, _)| axis.as_str());
                let error = SettingsError::new("", format!("the chain has no axis {name}")).suggest(name, axes);
                return Err(error.under(at));
            };
            if *quantity.get_or_insert(*own) != *own {
                return Err(SettingsError::new("", "a product is one of linear axes, or one of rotary axes").under(at));
            }
        }
        Ok(vec![Box::new(CrossCoupling { of: self.of.clone(), quantity: quantity.unwrap_or(Quantity::Ratio) })])
    }
}

/// The product of the commands of axes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CrossCoupling {
    /// The axes.
    pub of: Vec<String>,
    /// What their commands are.
    pub quantity: Quantity,
}

impl Functions for CrossCoupling {
    fn arguments(&self) -> Vec<Argument> {
        self.of.iter().cloned().map(Argument::CommandOf).collect()
    }

    fn terms(&self) -> Vec<Term> {
        let term = Term::new(format!("[{}]", self.of.join("*")), self.of.len() as u8);
        vec![Term { per: Some(self.quantity), ..term }]
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        out[0] = arguments.iter().product();
    }

    fn slopes(&self, by: usize, arguments: &[f64], out: &mut [f64]) {
        out[0] = arguments.iter().enumerate().filter(|(index, _)| *index != by).map(|(_, command)| command).product();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::{names, slopes_agree_by, values};

    #[test]
    fn values_and_units() {
        let product = CrossCoupling { of: vec!["X".to_owned(), "Y".to_owned()], quantity: Quantity::Length };
        assert_eq!(names(&product), ["[X*Y]"]);
        assert_eq!(values(&product, &[3.0, -4.0]), [-12.0]);
        assert_eq!(product.terms()[0].unit(Quantity::Angle, Quantity::Angle).to_string(), "rad/mm^2");
    }

    proptest::proptest! {
        #[test]
        fn slopes_are_those_of_the_values(x in -5.0..5.0_f64, y in -5.0..5.0_f64, by in 0usize..3) {
            let of = vec!["X".to_owned(), "Y".to_owned(), "Y".to_owned()];
            slopes_agree_by(&CrossCoupling { of, quantity: Quantity::Length }, by, &[x, y, 2.0], 1e-5, 1e-6);
        }
    }
}
