//! Total error motion: all readings of a run, which only its data have.

use abbe_core::{Calibration, Dataset, Figure, Findings, Fit, Result};
use abbe_standards::spindle::{Harmonics, Sectors};

use super::checked::Checked;
use super::tables;
use crate::motion::{Motion, along_rotating};
use crate::parameters::{harmonics, value};
use crate::readings::{Run, runs};
use crate::sensors::between;

/// Smallest and largest value.
#[derive(Clone, Copy)]
struct Span(f64, f64);

impl Span {
    const EMPTY: Self = Self(f64::MAX, f64::MIN);

    fn push(&mut self, value: f64) {
        *self = Self(self.0.min(value), self.1.max(value));
    }
}

/// What is taken off the readings of a run before their range is told.
struct Taken {
    /// Constant and slope of each sensor, mm, mm/s.
    lines: Vec<(f64, f64)>,
    middle: f64,
    /// The form of the artefact in each radial sensor: synchronous part as read less the one without form.
    forms: Vec<Harmonics>,
}

/// Figures of a run from the data set that it is in; none if it is in none of them.
pub fn figures(
    fit: &Fit,
    motion: &Motion,
    checked: &Checked,
    data: &[&Dataset],
    findings: &mut Findings,
) -> Result<Vec<Figure>> {
    for data in data {
        for run in runs(&[data], &motion.expected())? {
            if motion.name(&run) == checked.run {
                return Ok(of_run(fit, motion, checked, &run, findings));
            }
        }
    }
    Ok(Vec::new())
}

fn taken(calibration: &Calibration, motion: &Motion, checked: &Checked, run: &Run<'_>) -> Taken {
    let of = |what: &str| value(calibration, &format!("run[{}].{what}", checked.run)).unwrap_or(0.0);
    let line = |sensor: &String| (of(&format!("mean.{sensor}")), of(&format!("drift.{sensor}")));
    let form = |(number, sensor): (usize, &String)| {
        let prefix = format!("run[{}].sync.{sensor}", checked.run);
        let read = harmonics(calibration, &prefix, usize::from(motion.harmonics)).without(1);
        read.combined(1.0, &checked.sensor(number, &checked.values).without(1), -1.0)
    };
    Taken {
        lines: motion.radial.keys().chain(&motion.axial).map(line).collect(),
        middle: 0.5 * (run.times[0] + run.times[run.times.len() - 1]),
        forms: motion.radial.keys().enumerate().map(form).collect(),
    }
}

fn of_run(fit: &Fit, motion: &Motion, checked: &Checked, run: &Run<'_>, findings: &mut Findings) -> Vec<Figure> {
    let taken = taken(&fit.calibration, motion, checked, run);
    let sensors = taken.lines.len();
    let only = |motion: Harmonics, orders: usize| -> Harmonics {
        Harmonics {
            cos: motion.cos.into_iter().take(orders + 1).collect(),
            sin: motion.sin.into_iter().take(orders + 1).collect(),
        }
    };
    // The least squares circle: mean and fundamental of the synchronous part. Axial motions keep their fundamental.
    let circles: Vec<Harmonics> = (0..sensors)
        .map(|number| match number < motion.radial.len() {
            true => only(checked.sensor(number, &checked.values), 1),
            false => Harmonics::zero(0),
        })
        .collect();
    let circle = checked.rotating(&checked.values).map(|motion| only(motion, 1));
    let pair = between(&motion.radial);
    let (mut spans, mut turning) = (vec![Span::EMPTY; sensors], Span::EMPTY);
    let mut bands = vec![Sectors::new(usize::from(motion.sectors)); sensors + usize::from(pair.is_some())];
    let mut readings = vec![0.0; sensors];
    for index in 0..run.angles.len() {
        let angle = run.angles[index];
        for (number, (mean, slope)) in taken.lines.iter().enumerate() {
            let form = taken.forms.get(number).map_or(0.0, |form| form.at(angle));
            let line = mean + slope * (run.times[index] - taken.middle);
            readings[number] = run.readings[number][index] - line - form;
            let rest = readings[number] - circles[number].at(angle);
            spans[number].push(rest);
            bands[number].push(angle, rest * 1e3);
        }
        if let (Some(between), Some(circle)) = (pair, &circle) {
            let rest = along_rotating(&readings, between, angle) - circle.at(angle);
            turning.push(rest);
            bands[sensors].push(angle, rest * 1e3);
        }
    }
    let uncertainty = motion.standard_uncertainty_um.map(|reading| reading * std::f64::consts::SQRT_2);
    let figure =
        |name: String, span: Span| Figure::new(&fit.name, name, (span.1 - span.0) * 1e3, "um").uncertain(uncertainty);
    let mut all = Vec::new();
    if pair.is_some() {
        all.push(figure(format!("total rotating[{}]", checked.run), turning));
    }
    for (sensor, span) in motion.radial.keys().zip(&spans) {
        all.push(figure(format!("total fixed[{} {sensor}]", checked.run), *span));
    }
    if motion.axial.is_some() {
        all.push(figure(format!("total axial[{}]", checked.run), spans[sensors - 1]));
    }
    tables::bands(motion, checked, &bands, findings);
    all
}
