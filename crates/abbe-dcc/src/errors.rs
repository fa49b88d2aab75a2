//! The errors of certified values as known inputs.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use abbe_core::{Certificate, KnownInput, Parameter, Quantity, Unit};
use nalgebra::DMatrix;

use crate::{DigitalCertificate, Uncertainty, ValueIndex};

/// The errors of certified values: `e_i = sum of c_ik z_k` with independent known inputs z.
///
/// Values without a covariance have an input each. With one, z is what the errors of earlier values of the list do not explain
/// (Cholesky: C = L L^T, c_ik = L_ik / L_kk, u(z_k) = L_kk). The list as a whole makes the inputs, whichever of its values are used: an
/// input is the same quantity wherever the certificate is used.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Errors {
    /// The known inputs; all are zero unless the certificate is wrong.
    pub inputs: Vec<KnownInput>,
    of: BTreeMap<ValueIndex, Vec<(usize, f64)>>,
}

/// What belongs to a list of a certificate: a factor of its covariance, the number of the input of each column, if it has one, and what
/// the list is.
type OfList = (DMatrix<f64>, Vec<Option<usize>>, String);

impl Errors {
    /// The errors of some lengths of a certificate, with the names of their inputs. `first` is how many inputs stand before them.
    pub fn new(certificate: &DigitalCertificate, named: &[(ValueIndex, String)], first: usize) -> Self {
        let mut errors = Self::default();
        let mut of_list: BTreeMap<usize, OfList> = BTreeMap::new();
        for (index, _) in named {
            let (factor, inputs, content) = of_list.entry(index.quantity).or_insert_with(|| {
                let quantity = &certificate.quantities[index.quantity];
                let count = quantity.values.len();
                let factor = match &quantity.uncertainty {
                    Uncertainty::Covariance(matrix) => cholesky(matrix),
                    _ => DMatrix::from_fn(count, count, |row, column| match row == column {
                        true => quantity.standard_uncertainty(row),
                        false => 0.0,
                    }),
                };
                (factor, vec![None; count], certificate.content(index.quantity))
            });
            let mut terms = Vec::new();
            for column in (0..=index.value).filter(|column| factor[(index.value, *column)] != 0.0) {
                let input = *inputs[column].get_or_insert_with(|| {
                    let value = ValueIndex { quantity: index.quantity, value: column };
                    let label = certificate.label(value);
                    let name = named.iter().find(|(other, _)| *other == value).map(|(_, name)| name.clone());
                    let name = name.unwrap_or_else(|| format!("certificate[{label}]"));
                    let parameter = Parameter::new(name, Unit::of(Quantity::Length));
                    let input = KnownInput::new(parameter, 0.0, factor[(column, column)]);
                    errors.inputs.push(input.with_certificate(label, content.as_str()));
                    first + errors.inputs.len() - 1
                });
                terms.push((input, factor[(index.value, column)] / factor[(column, column)]));
            }
            errors.of.insert(*index, terms);
        }
        errors
    }

    /// The inputs that make the error of a value, by their numbers among all inputs, with their derivatives.
    pub fn of(&self, index: ValueIndex) -> &[(usize, f64)] {
        self.of.get(&index).map_or(&[], Vec::as_slice)
    }

    /// The error of a value by all inputs.
    pub fn error(&self, index: ValueIndex, inputs: &[f64]) -> f64 {
        self.of(index).iter().map(|(input, factor)| inputs[*input] * factor).sum()
    }
}

impl DigitalCertificate {
    /// What identifies the list of a value.
    pub(crate) fn content_of(&self, index: ValueIndex) -> String {
        self.content(index.quantity)
    }

    /// What identifies the values of a quantity: the certificate, and what it says of them, as a hash.
    fn content(&self, quantity: usize) -> String {
        let stated = &self.quantities[quantity];
        let mut text = format!("certificate {} of {}, item {}:", self.identifier, self.laboratory, self.item);
        for (row, (label, value)) in stated.labels.iter().zip(&stated.values).enumerate() {
            let _ = write!(text, " {label} = {value:e}");
            for column in 0..=row {
                let covariance = stated.covariance(row, column);
                if covariance != 0.0 {
                    let _ = write!(text, " {column}:{covariance:e}");
                }
            }
        }
        Certificate::new("values", text).identity()
    }
}

/// The lower triangle L of C = L L^T. A value that follows from earlier ones (a pivot that is rounding only) has no part of its own.
fn cholesky(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let count = matrix.nrows();
    let mut factor = DMatrix::<f64>::zeros(count, count);
    for column in 0..count {
        let left = |factor: &DMatrix<f64>, row: usize| -> f64 {
            let known: f64 = (0..column).map(|k| factor[(row, k)] * factor[(column, k)]).sum();
            matrix[(row, column)] - known
        };
        let pivot = left(&factor, column);
        if pivot <= 1e-10 * matrix[(column, column)] {
            continue;
        }
        factor[(column, column)] = pivot.sqrt();
        for row in column + 1..count {
            factor[(row, column)] = left(&factor, row) / factor[(column, column)];
        }
    }
    factor
}
