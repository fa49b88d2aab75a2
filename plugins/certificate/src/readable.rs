//! Exporter `certificate`: a calibration as a certificate for people, a draft until all is there that ISO/IEC 17025 asks for.

use abbe_core::{Calibration, Context, Export, ExportedFile, KinematicModel, Result, SettingsError};

use crate::draft::Draft;
use crate::page::page;
use crate::settings::example;
use crate::{PAGE, certified};

abbe_core::register!(
    Export,
    "certificate",
    "a calibration certificate for people, marked as draft until it is complete (HTML)",
    Draft,
    example,
    build,
    "../reference/export-certificate.md",
);

fn build(draft: Draft, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    draft.check()?;
    Ok(Box::new(Readable { draft }))
}

struct Readable {
    draft: Draft,
}

impl Export for Readable {
    fn export(&self, calibration: &Calibration, _: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let certified = certified(&self.draft.parameters, calibration)?;
        let page = page(&self.draft, calibration, &certified)?;
        Ok(vec![ExportedFile { name: PAGE.to_owned(), content: page.into_bytes() }])
    }
}
