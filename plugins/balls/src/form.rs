//! Form of spheres: how the radius follows the direction in the frame of the table.

use abbe_core::{PathItem, ProbeTerm, SettingsError};
use abbe_probe::{name, polynomial, value};
use nalgebra::Vector3;

/// Terms of the form, the same for all balls of a stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Form(Vec<ProbeTerm>);

impl Form {
    /// Reads `form: [cos2, sin2]`.
    ///
    /// Fails for what is no term, for terms that are the place of a ball or its size, and for one that stands there twice.
    pub fn read(texts: &[String]) -> Result<Self, SettingsError> {
        let mut terms = Vec::new();
        for (index, text) in texts.iter().enumerate() {
            let wrong = |message: String| {
                SettingsError::new("", message).under([PathItem::Key("form".to_owned()), PathItem::Index(index)])
            };
            let term = polynomial(text).map_err(wrong)?;
            let is = match term {
                ProbeTerm::Cosine { around: 0, along: 0 } => Some("the radius"),
                ProbeTerm::Cosine { around: 1, along: 0 }
                | ProbeTerm::Sine { around: 1, along: 0 }
                | ProbeTerm::Cosine { around: 0, along: 1 } => Some("the centre"),
                _ => None,
            };
            if let Some(is) = is {
                return Err(wrong(format!("`{text}` is no form: it is {is} of the ball")));
            }
            if terms.contains(&term) {
                return Err(wrong(format!("`{text}` stands here twice")));
            }
            terms.push(term);
        }
        Ok(Self(terms))
    }

    /// The names of its terms: `cos2`.
    pub fn names(&self) -> impl Iterator<Item = String> {
        self.0.iter().map(|term| name(*term))
    }

    /// Number of terms.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Deviation of the radius in a direction, its derivative to the direction, and the value of every term.
    pub fn at(&self, direction: &Vector3<f64>, coefficients: &[f64]) -> (f64, Vector3<f64>, Vec<f64>) {
        let (mut deviation, mut slope, mut values) = (0.0, Vector3::zeros(), Vec::with_capacity(self.len()));
        for (term, coefficient) in self.0.iter().zip(coefficients) {
            let (of_term, by_direction) = value(*term, direction, 0.0);
            deviation += coefficient * of_term;
            slope += *coefficient * by_direction;
            values.push(of_term);
        }
        (deviation, slope, values)
    }
}
