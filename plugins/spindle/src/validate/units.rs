//! A radial sensor in another unit than the one across: both see the same artefact go round.

use abbe_core::Calibration;

use super::checked::Checked;
use crate::motion::Motion;
use crate::parameters::value;

/// How many times the fundamental of one sensor is that of the other, and its asynchronous motion. A spindle that moves along one direction
/// has no such noise there, and noise of one sensor alone is no eccentricity.
const FUNDAMENTAL: f64 = 8.0;
const ASYNCHRONOUS: f64 = 5.0;

/// Standard uncertainties that the larger fundamental has to be above.
const CLEAR: f64 = 10.0;

/// Factors that people mistake, and the part by which a ratio may be off one of them. An eccentric artefact is seen alike within that.
const UNITS: [(f64, &str); 3] = [
    (25.4, "25.4, as inches are to millimetres"),
    (1e3, "1000, as millimetres are to micrometres"),
    (39.37, "39.4, as 0.001 inch is to micrometres"),
];
const NEAR: f64 = 0.2;

/// A sentence on a pair of sensors of which one reads far less of everything than the other.
pub fn other_unit(calibration: &Calibration, motion: &Motion, checked: &Checked) -> Option<String> {
    let names: Vec<&String> = motion.radial.keys().collect();
    let &[one, other] = &names[..] else { return None };
    let (sizes, uncertainties): (Vec<f64>, Vec<f64>) =
        [0, 1].map(|sensor| checked.order(sensor, 1)).into_iter().unzip();
    let of = |name: &str| value(calibration, &format!("run[{}].async.{name}", checked.run));
    let asynchronous = [of(one)?, of(other)?];
    let (small, large) = if sizes[0] < sizes[1] { (0, 1) } else { (1, 0) };
    let is_other = sizes[large] > FUNDAMENTAL * sizes[small]
        && asynchronous[large] > ASYNCHRONOUS * asynchronous[small]
        && sizes[large] > CLEAR * uncertainties[large];
    let ratio = sizes[large] / sizes[small];
    let near = UNITS.iter().find(|(factor, _)| (ratio / factor - 1.0).abs() < NEAR);
    let near = near.map_or_else(String::new, |(_, words)| format!(" (a factor near {words})"));
    is_other.then(|| {
        format!(
            "run `{}`: {} sees {:.4} um of the fundamental and {:.4} um of asynchronous motion, {} sees {:.4} um and {:.4} um, of one \
             artefact{near}: is the unit or the sensitivity of one of them right?",
            checked.run,
            names[small],
            sizes[small] * 1e3,
            asynchronous[small] * 1e3,
            names[large],
            sizes[large] * 1e3,
            asynchronous[large] * 1e3
        )
    })
}
