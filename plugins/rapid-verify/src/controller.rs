//! What the exporters of both controllers share: settings, checks, and the two programs.

use std::path::PathBuf;

use abbe_core::{
    Calibration, Context, Export, ExportedFile, InputFile, KinematicModel, PathItem, Result, SettingsError, positive,
};

use abbe_measuring::language;

use crate::plan::Motion;
use crate::points::Points;
use crate::program::{Programme, Step};

/// What every controller is told.
pub struct Common {
    nominal: PathBuf,
    tolerance_um: f64,
    motion: Motion,
}

/// The exporter of both programs in the language of a controller.
struct Programs<D> {
    common: Common,
    dialect: D,
}

impl<D: Dialect> Export for Programs<D> {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "nominal", path: self.common.nominal.clone() }]
    }

    fn export(&self, _: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        self.common.write(&self.dialect, model)
    }
}

/// A controller's language.
pub trait Dialect: Send + Sync + 'static {
    /// The text of a program.
    fn program(&self, programme: &Programme, kind: Kind, steps: &[Step]) -> Result<String>;

    /// The name of its file.
    fn file(&self, kind: Kind) -> String;
}

/// One of the two programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The baseline.
    Baseline,
    /// The check before a cut.
    Verify,
}

impl Common {
    /// From the settings that all exporters of programs have: nominal file, tolerance in µm, and how the machine moves.
    pub fn new(context: &Context, nominal: &str, tolerance_um: f64, motion: &Motion) -> Result<Self, SettingsError> {
        positive("tolerance_um", tolerance_um)?;
        motion.check().map_err(|error| error.under([PathItem::Key("motion".to_owned())]))?;
        Ok(Self { nominal: context.path(nominal), tolerance_um, motion: motion.clone() })
    }

    /// The exporter of the programs in a controller's language.
    pub fn exporter(self, dialect: impl Dialect) -> Box<dyn Export> {
        Box::new(Programs { common: self, dialect })
    }

    /// Both programs.
    fn write(&self, dialect: &dyn Dialect, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let points = Points::read(&self.nominal)?;
        let programme = self.motion.programme(&points, model, self.tolerance_um * 1e-3)?;
        let programs = [(Kind::Baseline, programme.baseline()), (Kind::Verify, programme.verify())];
        let file = |(kind, steps): (Kind, Vec<Step>)| {
            let content = dialect.program(&programme, kind, &steps)?.into_bytes();
            Ok(ExportedFile { name: dialect.file(kind), content })
        };
        programs.into_iter().map(file).collect()
    }
}

/// A number with at most six decimals, and at least one.
pub fn number(value: f64) -> String {
    language::number(value, 6)
}

/// A number without a decimal point where it needs none, for what is no position.
pub fn short_number(value: f64) -> String {
    number(value).trim_end_matches('0').trim_end_matches('.').to_owned()
}
