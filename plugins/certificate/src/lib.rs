//! Exporter `dcc`: a calibration as a digital calibration certificate (DCC 3.2.1 or 3.3.0; Physikalisch-Technische Bundesanstalt,
//! <https://ptb.de/dcc>).
//!
//! The values, their expanded uncertainties and their whole covariance come from the calibration. Who calibrated what, for whom and under
//! which conditions is for people to say: Abbe is no laboratory, so nothing of it has a default.

mod conformity;
mod contents;
mod draft;
mod element;
mod mistaken_places;
mod page;
mod qif;
mod readable;
mod settings;
mod symbols;
mod uncertainty;
mod units;

use abbe_core::{
    Calibration, Context, Error, Estimated, Export, ExportedFile, KinematicModel, Result, SettingsError, Status,
    matches,
};

use crate::contents::certificate;
use crate::draft::Draft;
use crate::page::page;
use crate::settings::{Settings, example};

abbe_core::register!(
    Export,
    "dcc",
    "a digital calibration certificate (DCC 3.2.1 or 3.3)",
    Settings,
    example,
    build,
    "../reference/export-dcc.md",
);

/// The files that are written.
const FILE: &str = "certificate.xml";
const PAGE: &str = "certificate.html";

/// Most parameters of a certificate: their covariance has the square of it.
const MOST: usize = 300;

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    settings.check()?;
    Ok(Box::new(Dcc { settings }))
}

struct Dcc {
    settings: Settings,
}

impl Export for Dcc {
    fn export(&self, calibration: &Calibration, _: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let certified = certified(&self.settings.parameters, calibration)?;
        let text = certificate(&self.settings, calibration, &certified)?;
        let page = page(&Draft::from(&self.settings), calibration, &certified)?;
        let file = |name: &str, text: String| ExportedFile { name: name.to_owned(), content: text.into_bytes() };
        Ok(vec![file(FILE, text), file(PAGE, page)])
    }
}

/// The parameters of a certificate: those of the machine that were estimated, or those of them that patterns name.
fn certified<'a>(patterns: &[String], calibration: &'a Calibration) -> Result<Vec<&'a Estimated>> {
    let is_named = |name: &str| patterns.is_empty() || patterns.iter().any(|pattern| matches(pattern, name));
    let named = || calibration.parameters.iter().filter(|parameter| is_named(&parameter.name));
    if let Some(unknown) = named().find(|parameter| parameter.status == Status::Confounded) {
        let message =
            format!("the measurements do not determine {}, so that no certificate can state it", unknown.name);
        return Err(Error::usage(message).help("measure what is missing, or name the others").setting("parameters"));
    }
    let certified: Vec<&Estimated> = named().filter(|parameter| parameter.status == Status::Estimated).collect();
    match certified.len() {
        0 => Err(Error::usage("there is no estimated parameter of the machine to certify").setting("parameters")),
        1..=MOST => Ok(certified),
        many => {
            let message = format!("{many} parameters; at most {MOST} fit in a certificate with their covariance");
            Err(Error::usage(message).help("name fewer, by patterns").setting("parameters"))
        }
    }
}

#[cfg(test)]
mod tests;
