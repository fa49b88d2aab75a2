//! Digital calibration certificates (DCC 3 of the Physikalisch-Technische Bundesanstalt, <https://ptb.de/dcc>) as calibrated values.
//!
//! A stage that needs calibrated values has a setting [`CertificateFile`]. [`DigitalCertificate::read`] gives what the certificate
//! says: values in the units of memory, standard uncertainties (U / k), covariance, and who they are of. [`Errors`] makes known inputs
//! of the errors of these values. Both ways in which versions name uncertainties are read (D-SI 1 and 2.1, D-SI 2.2).
//!
//! Nothing is fetched, and no entity is expanded: a document with a DTD is refused. A signature is told and not checked.

mod administrative;
mod errors;
mod points;
mod quantities;
mod settings;
mod units;
mod xml;

use std::path::{Path, PathBuf};

use abbe_core::{Error, Result, Unit};
use abbe_files::{LARGEST_TEXT, read_text};

pub use errors::Errors;
pub use points::CertifiedPoint;
pub use quantities::{Quantity, Uncertainty};
pub use settings::{CertificateFile, CertifiedLength};

use units::DsiUnit;
use xml::Xml;

/// Most values of a certificate: their covariance has the square of it.
const MOST_VALUES: usize = 1000;

/// A value of a certificate: the number of its quantity, and its own among those of the quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct ValueIndex {
    quantity: usize,
    value: usize,
}

/// What a certificate says.
#[derive(Debug, Clone, PartialEq)]
pub struct DigitalCertificate {
    /// The file.
    pub file: PathBuf,
    /// Number of the certificate.
    pub identifier: String,
    /// Who calibrated.
    pub laboratory: String,
    /// The item that was meant: its number.
    pub item: String,
    /// What whoever uses the values has to know: a signature that was not checked, a temperature far from 20 °C.
    pub remarks: Vec<String>,
    /// The measured quantities.
    pub quantities: Vec<Quantity>,
}

impl DigitalCertificate {
    /// Reads the certificate of an item.
    ///
    /// # Errors
    /// For a file that cannot be read, is larger than 16 MiB, is no XML, has a DTD, is no DCC of version 3, or is of another item; and
    /// for values that are none, with line and column.
    ///
    /// ```no_run
    /// # fn main() -> abbe_core::Result<()> {
    /// let settings = abbe_dcc::CertificateFile { path: "bar.xml".into(), item: abbe_core::Label("4711".into()), quantity: None };
    /// let certificate = abbe_dcc::DigitalCertificate::read(std::path::Path::new("bar.xml"), &settings)?;
    /// let length = certificate.find("L1", abbe_core::Unit::MM)?;
    /// println!("{} mm", certificate.value(length));
    /// # Ok(())
    /// # }
    /// ```
    pub fn read(file: &Path, settings: &CertificateFile) -> Result<Self> {
        let text = read_text(file, LARGEST_TEXT).map_err(|error| {
            let message = format!("the certificate cannot be read: {}", abbe_files::why(&error));
            Error::data(message).in_file(file)
        })?;
        Self::parse(file, &text, settings)
    }

    /// The same from the text of a file.
    pub fn parse(file: &Path, text: &str, settings: &CertificateFile) -> Result<Self> {
        let document = xml::document(file, text)?;
        let xml = Xml { file, document: &document };
        let root = document.root_element();
        xml.is_certificate(root)?;
        let item = settings.item.0.trim();
        xml.is_of(root, item)?;
        let quantities = xml.quantities(root, settings.quantity.as_deref())?;
        Ok(Self {
            file: file.to_owned(),
            identifier: xml.identifier(root)?,
            laboratory: xml.laboratory(root),
            item: item.to_owned(),
            remarks: xml.remarks(root),
            quantities,
        })
    }

    /// Tells what has to be known of it.
    pub fn tell(&self) {
        self.remarks.iter().for_each(|remark| tracing::warn!("{}: {remark}", self.file.display()));
    }

    /// The value, in the unit of memory.
    pub fn value(&self, index: ValueIndex) -> f64 {
        self.quantities[index.quantity].values[index.value]
    }

    /// Its standard uncertainty, in the unit of memory; zero if the certificate states none.
    pub fn standard_uncertainty(&self, index: ValueIndex) -> f64 {
        self.quantities[index.quantity].standard_uncertainty(index.value)
    }

    /// Its label.
    pub fn label(&self, index: ValueIndex) -> &str {
        &self.quantities[index.quantity].labels[index.value]
    }

    /// The covariance of two values: zero if they are of different quantities.
    pub fn covariance(&self, one: ValueIndex, other: ValueIndex) -> f64 {
        match one.quantity == other.quantity {
            true => self.quantities[one.quantity].covariance(one.value, other.value),
            false => 0.0,
        }
    }

    /// All values of a unit.
    pub fn values(&self, unit: Unit) -> impl Iterator<Item = ValueIndex> {
        let of = move |(quantity, stated): (usize, &Quantity)| {
            let is_of = |value: &usize| stated.units[*value].is_some_and(|stated: DsiUnit| stated.is_of(unit));
            let values: Vec<usize> = (0..stated.values.len()).filter(is_of).collect();
            values.into_iter().map(move |value| ValueIndex { quantity, value })
        };
        self.quantities.iter().enumerate().flat_map(of)
    }

    /// The value with a label.
    ///
    /// # Errors
    /// If the certificate states none of this unit with the label, or several.
    pub fn find(&self, label: &str, unit: Unit) -> Result<ValueIndex> {
        let found: Vec<ValueIndex> = self.values(unit).filter(|index| self.label(*index) == label).collect();
        match found[..] {
            [] => {
                let labels: Vec<&str> = self.values(unit).map(|index| self.label(index)).collect();
                let message = format!("the certificate states no value `{label}` in {unit}");
                let error = Error::data(message).in_file(&self.file).suggest(label, labels.iter().copied());
                Err(if labels.is_empty() { error } else { error.help(format!("it states {}", listed(&labels))) })
            }
            [one] => Ok(one),
            [one, other, ..] => Err(self.twice(label, one, other)),
        }
    }

    /// The same, where a value of another unit with the label is an error that says so.
    ///
    /// # Errors
    /// As [`Self::find`], where no value of any unit has the label: a value of another unit is told as that.
    pub fn of_unit(&self, label: &str, unit: Unit) -> Result<ValueIndex> {
        let other = self.quantities.iter().find(|quantity| quantity.labels.iter().any(|own| own == label));
        self.find(label, unit).map_err(|error| match other {
            Some(quantity) if self.values(unit).all(|index| self.label(index) != label) => {
                let message = format!("`{label}` has a unit that is none of {unit}");
                Error::data(message).at(&self.file, quantity.line, None)
            }
            _ => error,
        })
    }

    /// All labels.
    pub fn labels(&self) -> impl Iterator<Item = &str> {
        self.quantities.iter().flat_map(|quantity| quantity.labels.iter().map(String::as_str))
    }

    /// The only value of a unit.
    ///
    /// # Errors
    /// If there is none, or more than one.
    pub fn only(&self, unit: Unit) -> Result<ValueIndex> {
        let mut values = self.values(unit);
        match (values.next(), values.next()) {
            (Some(one), None) => Ok(one),
            (None, _) => Err(Error::data(format!("the certificate states no value in {unit}")).in_file(&self.file)),
            (Some(_), Some(_)) => {
                let labels: Vec<&str> = self.values(unit).map(|index| self.label(index)).collect();
                let message = format!("the certificate states several values in {unit}: {}", listed(&labels));
                Err(Error::data(message).in_file(&self.file).help("say which one is meant"))
            }
        }
    }

    fn twice(&self, label: &str, one: ValueIndex, other: ValueIndex) -> Error {
        let [first, second] = [one, other].map(|index| &self.quantities[index.quantity]);
        let message = format!("`{label}` is stated twice: as {} in line {}", first.names.join(", "), first.line);
        let error = Error::data(format!("{message}, and as {}", second.names.join(", ")));
        error.at(&self.file, second.line, None).help("name the quantity that counts, by name or refType: `quantity`")
    }
}

/// Some of many labels, for messages.
fn listed(labels: &[&str]) -> String {
    let shown: Vec<String> = labels.iter().take(8).map(|label| format!("`{label}`")).collect();
    let more = if labels.len() > 8 { format!(" and {} more", labels.len() - 8) } else { String::new() };
    format!("{}{more}", shown.join(", "))
}

#[cfg(test)]
mod tests;
