//! Sensors: where they stand, and what readings of a working one look like.

use std::collections::BTreeMap;

use abbe_core::{Error, PathItem, Result, SettingsError};
use abbe_numerics::Ends;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::run::Run;

/// A radial sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Radial {
    /// Its direction from the axis of the spindle, in the sense in which the angle of the spindle counts.
    pub azimuth_deg: f64,
}

/// Radial sensors by their columns without unit.
pub type RadialSensors = BTreeMap<String, Radial>;

/// Smallest sine of the angle between a pair of sensors.
const ACROSS: f64 = 0.5;

/// Fails for more than two sensors, and for two that look along one line.
pub fn check_radial(radial: &RadialSensors) -> Result<(), SettingsError> {
    if radial.len() > 2 {
        return Err(SettingsError::new("radial", "one sensor, or a pair of sensors, was expected"));
    }
    for (name, sensor) in radial {
        if !sensor.azimuth_deg.is_finite() {
            let error = SettingsError::new("azimuth_deg", "a finite angle was expected");
            return Err(error.under([PathItem::Key("radial".to_owned()), PathItem::Key(name.clone())]));
        }
    }
    if let Some(between) = between(radial)
        && between.sin().abs() < ACROSS
    {
        let message = format!(
            "the sensors stand {:.0} deg apart and tell one direction alone; 90 deg were expected, 30 to 150 do",
            between.to_degrees()
        );
        return Err(SettingsError::new("radial", message));
    }
    Ok(())
}

/// Angle from the first sensor of a pair to the second one, rad.
pub fn between(radial: &RadialSensors) -> Option<f64> {
    let mut azimuths = radial.values().map(|sensor| sensor.azimuth_deg);
    let (one, other) = (azimuths.next()?, azimuths.next()?);
    Some((other - one).to_radians())
}

/// What two sensors read along the direction that turns with the spindle; `between` is the angle from one to the other, `angle` the
/// cosine and the sine of that of the spindle.
pub fn along_rotating(readings: &[f64], between: f64, angle: [f64; 2]) -> f64 {
    let [x, y] = [readings[0], (readings[1] - readings[0] * between.cos()) / between.sin()];
    x * angle[0] + y * angle[1]
}

/// Fails for readings that stand still, and that move more or less than a spindle does.
pub fn check_range(run: &Run, name: &str, ends: &Ends, plausible: [f64; 2]) -> Result<()> {
    let [lowest, highest] = ends.range().unwrap_or_default();
    let range = highest - lowest;
    if range == 0.0 {
        let message = format!("{name} reads {} um all the time", lowest * 1e3);
        return Err(run.error(message).help("is the sensor connected, and within its range?"));
    }
    if !(plausible[0]..=plausible[1]).contains(&range) {
        let message = format!(
            "{name} moves by {:.4} um, and {} um to {} um are plausible",
            range * 1e3,
            plausible[0] * 1e3,
            plausible[1] * 1e3
        );
        return Err(run.error(message).help("is it in the unit that its column says? else widen `plausible_um`"));
    }
    Ok(())
}

/// The error for readings that are cut off at one end, and the number of the first one that is.
pub fn clipped(name: &str, ends: &Ends) -> Option<(u64, Error)> {
    let (end, first) = ends.clipped().into_iter().next()?;
    let message = format!(
        "{name} reads its {} value, {:.4} um, {} times, and the next ones {} times at most: it is clipped",
        if end.is_largest { "largest" } else { "smallest" },
        end.value * 1e3,
        end.count,
        end.nearby
    );
    Some((first, Error::data(message).help("set the sensor to the middle of its range, or centre the artefact")))
}
