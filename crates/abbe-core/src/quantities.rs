//! What was estimated without a machine.

use serde_json::Value;

use crate::model::{KinematicModel, ModelInfo, PoseBatch, PosesMut};
use crate::parameter::Parameter;
use abbe_results::Calibration;
use abbe_settings::{Error, Result, Unit};

/// Named quantities of an estimate of readings that are no geometry
/// ([`EstimateSource::Readings`](crate::EstimateSource::Readings)), in the place of a machine. It has no axes and no poses.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantities {
    info: ModelInfo,
}

impl Quantities {
    /// The quantities of a calibration.
    ///
    /// Fails for a unit that is none.
    pub fn of(calibration: &Calibration) -> Result<Self> {
        let parameters = calibration.parameters.iter().map(|estimated| {
            let unit: Unit =
                estimated.unit.parse().map_err(|error| Error::data(format!("{}: {error}", estimated.name)))?;
            Ok(Parameter::new(&estimated.name, unit))
        });
        let settings: Value = calibration.model.settings.clone();
        Ok(Self { info: ModelInfo::new(Vec::new(), Vec::new(), parameters.collect::<Result<_>>()?, settings) })
    }
}

impl KinematicModel for Quantities {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn evaluate(&self, _: PoseBatch<'_>, _: PosesMut<'_>) -> Result<()> {
        Err(Error::usage("this estimate has no machine: it was made of readings that are no geometry"))
    }
}
