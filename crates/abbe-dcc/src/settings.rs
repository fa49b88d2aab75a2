//! The setting of stages that take a certificate.

use std::path::PathBuf;

use abbe_core::{Context, Error, InputFile, KnownInput, Label, Parameter, Result, SettingsError, Unit};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{DigitalCertificate, ValueIndex};

/// A digital calibration certificate and the item that is meant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CertificateFile {
    /// The certificate: a DCC of version 3 (XML).
    pub path: String,
    /// Serial number, or another identification, of the item that was used. A certificate of another item is refused.
    pub item: Label,
    /// Name or refType of the quantities that count, where a certificate states several of one label.
    #[serde(default)]
    pub quantity: Option<String>,
}

impl CertificateFile {
    /// The place of the file.
    ///
    /// Fails for an item without a text: it is what tells one bar from another.
    pub fn path(&self, context: &Context) -> Result<PathBuf, SettingsError> {
        if self.item.0.trim().is_empty() {
            let error = SettingsError::new("item", "the number of the item was expected, and this is empty");
            return Err(error.help("it stands on the item and in its certificate"));
        }
        Ok(context.path(&self.path))
    }
}

/// One length of a digital calibration certificate: a diameter, a distance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CertifiedLength {
    /// The certificate: a DCC of version 3 (XML).
    pub path: String,
    /// Serial number, or another identification, of the item that was used. A certificate of another item is refused.
    pub item: Label,
    /// Name or refType of the quantities that count, where a certificate states several of one label.
    #[serde(default)]
    pub quantity: Option<String>,
    /// Label of the length in the certificate. Default: the only length that it states.
    #[serde(default)]
    pub label: Option<Label>,
    /// The place of the file, once it is known.
    #[serde(skip)]
    file: PathBuf,
}

impl CertifiedLength {
    /// Finds the place of the file. Fails for an item without a text.
    pub fn resolve(&mut self, context: &Context) -> Result<(), SettingsError> {
        self.file = self.settings().path(context)?;
        Ok(())
    }

    /// The file as an input of a stage.
    pub fn input(&self) -> InputFile {
        InputFile { setting: "certificate", path: self.file.clone() }
    }

    /// The length and its standard uncertainty, mm.
    ///
    /// # Errors
    /// As [`DigitalCertificate::read`]; and for a label that it does not state, for several lengths without a label, for a length that
    /// is not above zero, and for one without uncertainty.
    pub fn length(&self) -> Result<(f64, f64)> {
        let (certificate, index) = self.read()?;
        Ok((certificate.value(index), certificate.standard_uncertainty(index)))
    }

    /// The length as a known input with this name.
    pub fn input_of(&self, name: &str) -> Result<KnownInput> {
        let (certificate, index) = self.read()?;
        let (length, uncertainty) = (certificate.value(index), certificate.standard_uncertainty(index));
        let input = KnownInput::new(Parameter::new(name, Unit::MM), length, uncertainty);
        Ok(input.with_certificate(certificate.label(index), certificate.content_of(index)))
    }

    /// Tells what has to be known of the certificate.
    pub fn tell(&self) -> Result<()> {
        self.read()?.0.tell();
        Ok(())
    }

    fn settings(&self) -> CertificateFile {
        CertificateFile { path: self.path.clone(), item: self.item.clone(), quantity: self.quantity.clone() }
    }

    fn read(&self) -> Result<(DigitalCertificate, ValueIndex)> {
        let certificate = DigitalCertificate::read(&self.file, &self.settings())?;
        let index = match &self.label {
            Some(label) => certificate.find(&label.0, Unit::MM)?,
            None => certificate.only(Unit::MM)?,
        };
        let (length, label) = (certificate.value(index), certificate.label(index));
        let message = match (length > 0.0, certificate.standard_uncertainty(index) > 0.0) {
            (true, true) => return Ok((certificate, index)),
            (false, _) => format!("the certificate states {length} mm for `{label}`; a length above 0 was expected"),
            (true, false) => format!("the certificate states no uncertainty of `{label}`"),
        };
        Err(Error::data(message).in_file(&self.file))
    }
}
