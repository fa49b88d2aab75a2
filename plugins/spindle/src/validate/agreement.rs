//! Whether a reversal and the runs at its speed read the same artefact and the same spindle.

use abbe_core::Findings;
use abbe_standards::spindle::Harmonics;

use super::Estimates;
use super::checked::{Checked, Form};
use crate::parameters::value;

/// Part of the speed by which a run may differ from the reversal.
const SAME_SPEED: f64 = 0.05;

/// Most by which readings may be larger or smaller, and the least correlation of both.
const MOST: f64 = 1.3;
const ALIKE: f64 = 0.5;

/// The same for readings of which one is lost in noise.
const LOST: f64 = 3.0;

/// Standard uncertainties that both have to be above to tell anything.
const CLEAR: f64 = 10.0;

/// Tells of runs that read other harmonics than the first set-up of the reversal does, at the same speed and from the same side.
pub fn tell(estimates: &Estimates<'_>, form: Option<&Form>, findings: &mut Findings) {
    let Some((fit, reversal)) = &estimates.reversal else { return };
    let Some((name, radial)) = reversal.radial.iter().next() else { return };
    let Some(speed) = value(&fit.calibration, "reversal[1].speed") else { return };
    for (of, motion) in &estimates.motions {
        if let Some(own) = motion.radial.get(name).filter(|own| turned(own.azimuth_deg, radial.azimuth_deg)) {
            findings.remarks.insert(
                0,
                format!(
                    "the sensor {name} stands at {} deg in `{}` and at {} deg in `{}`: unless it was moved, one of them is wrong, and so is \
                     the form that is taken off",
                    own.azimuth_deg, of.name, radial.azimuth_deg, fit.name
                ),
            );
        }
        let number = motion.radial.values().position(|own| (own.azimuth_deg - radial.azimuth_deg).abs() < 0.1);
        let Some(number) = number else { continue };
        for run in super::judged::names(&of.calibration) {
            let own = value(&of.calibration, &format!("run[{run}].speed")).unwrap_or(f64::NAN);
            if (own / speed - 1.0).abs() > SAME_SPEED {
                continue;
            }
            let read = Checked::new(&of.calibration, motion, &run, None);
            let without = Checked::new(&of.calibration, motion, &run, form);
            let in_run = read.sensor(number, &read.values).without(1);
            // What the form makes of a reading there, and the motion that the reversal found.
            let of_form = in_run.combined(1.0, &without.sensor(number, &without.values).without(1), -1.0);
            let moved = Checked::of_prefix(&fit.calibration, &format!("sync.{name}"), usize::from(reversal.harmonics));
            let in_reversal = of_form.combined(1.0, &moved.sensor(0, &moved.values).without(1), 1.0);
            let uncertainty =
                noise(&read, number, motion.harmonics.into()).hypot(noise(&moved, 0, reversal.harmonics.into()));
            if let Some(words) = differ(&in_run, &in_reversal, uncertainty) {
                findings.remarks.push(format!("run `{run}` and the reversal `{}`, at one speed: {words}", fit.name));
            }
        }
    }
}

/// Whether two azimuths are different directions.
fn turned(one: f64, other: f64) -> bool {
    let off = (one - other).rem_euclid(360.0);
    off.min(360.0 - off) > 0.1
}

/// Standard uncertainties of the amplitudes from order 2 on, all together, mm.
fn noise(checked: &Checked, sensor: usize, highest: usize) -> f64 {
    (2..=highest).map(|order| checked.order(sensor, order).1.powi(2)).sum::<f64>().sqrt()
}

fn product(one: &Harmonics, other: &Harmonics) -> f64 {
    let of = |one: &[f64], other: &[f64]| one.iter().zip(other).map(|(one, other)| one * other).sum::<f64>();
    of(&one.cos, &other.cos) + of(&one.sin, &other.sin)
}

/// What differs between two readings of the same.
fn differ(in_run: &Harmonics, in_reversal: &Harmonics, uncertainty: f64) -> Option<String> {
    let [run, reversal] = [in_run, in_reversal].map(|harmonics| product(harmonics, harmonics).sqrt());
    let ratio = reversal / run;
    if run.max(reversal) < CLEAR * uncertainty {
        return None;
    }
    // What is that much smaller is lost in the noise of the other one, and need not look like it.
    let is_lost = run.min(reversal) < CLEAR * uncertainty;
    let alike = if is_lost { 1.0 } else { product(in_run, in_reversal) / (run * reversal) };
    if alike < ALIKE {
        let words =
            "they read other harmonics of the artefact: was it taken off in between, or has a sensor another sign?";
        return Some(words.to_owned());
    }
    let most = if is_lost { LOST } else { MOST };
    (!(1.0 / most..most).contains(&ratio)).then(|| {
        format!(
            "the reversal reads {ratio:.2} times what the run reads: has a sensor another range or unit? The form that is taken off is \
             wrong by as much"
        )
    })
}
