//! Total error motion: all readings of a run, which only its data have.

use std::collections::BTreeMap;

use abbe_core::{Calibration, Figure, Findings, Fit, Passes, Result};
use abbe_standards::spindle::{Harmonics, Sectors};

use super::checked::Checked;
use super::tables;
use crate::bins::Table;
use crate::motion::Motion;
use crate::parameters::{harmonics, value};
use crate::run::{Run, first_look, second_look};
use crate::sensors::{along_rotating, between};
use crate::stretches::Stretch;

/// Smallest and largest value.
#[derive(Clone, Copy)]
struct Span(f64, f64);

impl Span {
    const EMPTY: Self = Self(f64::MAX, f64::MIN);

    fn push(&mut self, value: f64) {
        *self = Self(self.0.min(value), self.1.max(value));
    }
}

/// Mean and fundamental: a circle in a polar plot.
#[derive(Clone, Copy, Default)]
struct Circle([f64; 3]);

impl Circle {
    fn of(motion: &Harmonics) -> Self {
        let part = |list: &[f64], order: usize| list.get(order).copied().unwrap_or(0.0);
        Self([part(&motion.cos, 0), part(&motion.cos, 1), part(&motion.sin, 1)])
    }

    fn at(&self, [cos, sin]: [f64; 2]) -> f64 {
        self.0[0] + self.0[1] * cos + self.0[2] * sin
    }
}

/// The readings of a run, less what is taken off before their range is told.
struct Total {
    /// Constant and slope of each sensor, mm, mm/s.
    lines: Vec<(f64, f64)>,
    middle: f64,
    /// The form of the artefact in each radial sensor: synchronous part as read less the one without form.
    forms: Table,
    /// The least squares circles: axial motions keep their fundamental.
    circles: Vec<Circle>,
    /// Angle between a pair, and the circle along the direction that turns.
    pair: Option<(f64, Circle)>,
    spans: Vec<Span>,
    turning: Span,
    bands: Vec<Sectors>,
    readings: Vec<f64>,
}

/// Figures of runs from the data sets that they are in, by their names; none of those that are in none of them.
pub fn figures(
    fit: &Fit,
    motion: &Motion,
    judged: &[Checked],
    data: &[&dyn Passes],
    findings: &mut Findings,
) -> Result<BTreeMap<String, Vec<Figure>>> {
    let mut all = BTreeMap::new();
    for &data in data {
        if judged.iter().all(|checked| all.contains_key(&checked.run)) {
            break;
        }
        let runs = first_look(&[data], &motion.expected(), &mut |_| ())?;
        let mut totals: Vec<Option<(&Checked, Total)>> = Vec::new();
        for (number, run) in runs.iter().enumerate() {
            let name = motion.name(run);
            let is_known = all.contains_key(&name) || runs[..number].iter().any(|other| motion.name(other) == name);
            let checked = judged.iter().find(|checked| checked.run == name && !is_known);
            totals.push(checked.map(|checked| (checked, Total::new(&fit.calibration, motion, checked, run))));
        }
        second_look(&[data], &motion.expected(), &runs, &mut |stretch, _| {
            if let Some((_, total)) = totals.get_mut(stretch.run).and_then(Option::as_mut) {
                total.add(stretch);
            }
        })?;
        for (checked, total) in totals.into_iter().flatten() {
            all.insert(checked.run.clone(), total.figures(fit, motion, checked, findings));
        }
    }
    Ok(all)
}

impl Total {
    /// Without readings.
    fn new(calibration: &Calibration, motion: &Motion, checked: &Checked, run: &Run) -> Self {
        let of = |what: &str| value(calibration, &format!("run[{}].{what}", checked.run)).unwrap_or(0.0);
        let line = |sensor: &String| (of(&format!("mean.{sensor}")), of(&format!("drift.{sensor}")));
        let form = |(number, sensor): (usize, &String)| {
            let prefix = format!("run[{}].sync.{sensor}", checked.run);
            let read = harmonics(calibration, &prefix, usize::from(motion.harmonics)).without(1);
            read.combined(1.0, &checked.sensor(number, &checked.values).without(1), -1.0)
        };
        let forms: Vec<Harmonics> = motion.radial.keys().enumerate().map(form).collect();
        let lines: Vec<(f64, f64)> = motion.radial.keys().chain(&motion.axial).map(line).collect();
        let circle = |number: usize| match number < motion.radial.len() {
            true => Circle::of(&checked.sensor(number, &checked.values)),
            false => Circle::default(),
        };
        let sensors = lines.len();
        let rotating = checked.rotating(&checked.values).unwrap_or_default();
        let pair = between(&motion.radial).map(|between| (between, Circle::of(&rotating)));
        Self {
            middle: 0.5 * (run.times[0] + run.times[1]),
            forms: Table::new(&forms),
            circles: (0..sensors).map(circle).collect(),
            spans: vec![Span::EMPTY; sensors],
            turning: Span::EMPTY,
            bands: vec![Sectors::new(usize::from(motion.sectors)); sensors + usize::from(pair.is_some())],
            readings: vec![0.0; sensors],
            lines,
            pair,
        }
    }

    /// Adds readings.
    fn add(&mut self, stretch: &Stretch<'_>) {
        let sensors = self.lines.len();
        for (index, (&angle, time)) in stretch.angles.iter().zip(stretch.times).enumerate() {
            let (forms, sector) = (self.forms.at(angle), self.bands[0].sector(angle));
            let (sin, cos) = angle.sin_cos();
            for (number, (mean, slope)) in self.lines.iter().enumerate() {
                let line = mean + slope * (time - self.middle);
                self.readings[number] = stretch.readings[number][index] - line - forms[number];
                let rest = self.readings[number] - self.circles[number].at([cos, sin]);
                self.spans[number].push(rest);
                self.bands[number].push_in(sector, rest * 1e3);
            }
            if let Some((between, circle)) = &self.pair {
                let rest = along_rotating(&self.readings, *between, [cos, sin]) - circle.at([cos, sin]);
                self.turning.push(rest);
                self.bands[sensors].push_in(sector, rest * 1e3);
            }
        }
    }

    fn figures(self, fit: &Fit, motion: &Motion, checked: &Checked, findings: &mut Findings) -> Vec<Figure> {
        let uncertainty = motion.standard_uncertainty_um.map(|reading| reading * std::f64::consts::SQRT_2);
        let figure = |name: String, span: Span| {
            Figure::new(&fit.name, name, (span.1 - span.0) * 1e3, "um").uncertain(uncertainty)
        };
        let mut all = Vec::new();
        if self.pair.is_some() {
            all.push(figure(format!("total rotating[{}]", checked.run), self.turning));
        }
        for (sensor, span) in motion.radial.keys().zip(&self.spans) {
            all.push(figure(format!("total fixed[{} {sensor}]", checked.run), *span));
        }
        if let (Some(_), Some(span)) = (&motion.axial, self.spans.last()) {
            all.push(figure(format!("total axial[{}]", checked.run), *span));
        }
        tables::bands(motion, checked, &self.bands, findings);
        all
    }
}
