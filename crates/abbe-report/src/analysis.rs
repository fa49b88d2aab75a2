//! What the page says of one estimate: which errors make its volumetric error.

use std::collections::BTreeMap;

use abbe_core::{AxisKind, Calibration, KinematicModel, Result, Status, StatusRole};
use abbe_volumetric::{Cause, Causes, Known, causes, rms_without, standing};

use crate::number::{short, with_uncertainty};
use crate::run::{FitResult, Run};
use crate::words::{ErrorGroup, groups, meaning, remedy};

/// Most poses of the grid, one direction.
const MOST_POSES: usize = 400;

/// Points along an axis at most.
const MOST_POINTS: usize = 7;

/// The volumetric error of a calibrated machine and its causes, in the travel that was measured.
pub struct Analysis {
    /// Root mean square over the workspace, mm.
    pub rms: Known,
    /// The largest, mm.
    pub largest: Known,
    /// Where it is largest: commands with units.
    pub at: String,
    /// Root mean square of its standard uncertainty, mm.
    pub unknown: f64,
    /// The causes, those first without which the error falls most.
    pub causes: Vec<NamedCause>,
    /// Root mean square without the three largest, mm; none with fewer.
    pub without_three: Option<f64>,
    /// Over which travel: text.
    pub travel: String,
    /// Number of poses.
    pub poses: usize,
    /// For every pose the nominal tip in the table frame and the error, mm.
    pub field: Field,
    /// The statuses of the poses, row by row.
    statuses: Vec<f64>,
    /// The parameters of the three largest causes; none with fewer.
    three: Vec<usize>,
}

/// Places in the table frame and errors there, mm.
pub type Field = Vec<([f64; 3], [f64; 3])>;

/// A cause with its name.
pub struct NamedCause {
    /// Its symbol.
    pub name: String,
    /// What it is.
    pub meaning: String,
    /// The value of its parameter with the expanded uncertainty, k = 2, in the unit of people; empty where several make it.
    pub value: String,
    /// What to do about it.
    pub remedy: &'static str,
    /// Its parameters: indices into those of the model.
    pub parameters: Vec<usize>,
    /// Its part.
    pub part: Cause,
    /// The data cannot tell it from other errors.
    pub is_confounded: bool,
}

impl NamedCause {
    /// Whether the loss is more than its expanded uncertainty, in either direction.
    pub fn is_proven(&self) -> bool {
        self.part.loss.value.abs() > 2.0 * self.part.loss.uncertainty
    }

    /// What to do about it where the RMS volumetric error of the machine is `rms`, mm.
    pub fn advice(&self, rms: f64) -> &'static str {
        match (self.is_proven(), self.part.alone >= SMALL * rms) {
            (true, true) => self.remedy,
            (true, false) => "nothing: it is small",
            (false, _) => "nothing yet: it is not proven",
        }
    }
}

/// Part of the volumetric error below which a cause is small.
const SMALL: f64 = 0.1;

/// Whether two estimates are of machines with the same axes and the same status of a pose.
pub fn same_machine(one: &FitResult, other: &FitResult) -> bool {
    let axes = |fit: &FitResult| -> Vec<_> {
        let axes = fit.model.info().axes.iter();
        axes.map(|axis| (axis.name.clone(), axis.kind, axis.branch, axis.status)).collect()
    };
    let columns = |fit: &FitResult| -> Vec<_> {
        fit.model.info().status.iter().map(|column| (column.name.clone(), column.levels.clone())).collect()
    };
    axes(one) == axes(other) && columns(one) == columns(other)
}

/// How the text of a probable direction of approach is for people.
const NEGATIVE: &str = ", approached in negative direction";

impl Analysis {
    /// The analysis for [`FitResult::analysis`].
    pub(crate) fn of(fit: &FitResult) -> Result<Option<Self>> {
        let (model, calibration) = (fit.model.as_ref(), &fit.calibration);
        let info = model.info();
        let mut groups = groups(info);
        groups.retain(|group| group.parameters.iter().any(|index| is_known(calibration, info, *index)));
        let grid = Grid::of(fit);
        if groups.is_empty() || grid.varied.is_empty() {
            return Ok(None);
        }
        let statuses = grid.statuses(model);
        let parameters: Vec<Vec<usize>> = groups.iter().map(|group| group.parameters.clone()).collect();
        let found = causes(model, calibration, &statuses, &parameters)?;
        let confounded = |index: &usize| {
            let known = calibration.get(&info.parameters[*index].name);
            known.is_some_and(|known| known.status == Status::Confounded)
        };
        let mut named: Vec<NamedCause> = groups
            .iter()
            .zip(found.causes)
            .map(|(group, part)| NamedCause {
                name: group.name.clone(),
                meaning: meaning(info, group),
                value: value(calibration, info, group),
                remedy: remedy(info, group),
                parameters: group.parameters.clone(),
                part,
                is_confounded: group.parameters.iter().any(confounded),
            })
            .collect();
        named.sort_by(|one, other| other.part.loss.value.total_cmp(&one.part.loss.value));
        let three: Vec<usize> = named.iter().take(3).flat_map(|cause| cause.parameters.clone()).collect();
        let three = if named.len() > 3 { three } else { Vec::new() };
        let without_three = match three.is_empty() {
            false => Some(rms_without(model, calibration, &statuses, &three)?),
            true => None,
        };
        let width = info.status.len().max(1);
        let at = statuses.chunks(width).nth(found.at).map_or(String::new(), |status| place(model, &grid, status));
        let (rms, largest, unknown) = (found.rms, found.largest, found.unknown);
        let poses = statuses.len() / width;
        let field = found.field;
        let (causes, travel) = (named, grid.text());
        Ok(Some(Self { rms, largest, at, unknown, causes, without_three, travel, poses, field, statuses, three }))
    }

    /// The statuses of the poses, row by row.
    pub fn statuses(&self) -> &[f64] {
        &self.statuses
    }

    /// The parameters of the three largest causes; none where there are not more.
    pub fn three(&self) -> &[usize] {
        &self.three
    }

    /// The volumetric error of another calibration of such a machine at the same poses.
    ///
    /// Fails where its model fails.
    pub fn elsewhere(&self, fit: &FitResult) -> Result<Causes> {
        causes(fit.model.as_ref(), &fit.calibration, &self.statuses, &[])
    }
}

/// The value of the only parameter of a group, with its expanded uncertainty; of lost motion the whole step, which is twice the
/// parameter (ISO 230-2: reversal value).
fn value(calibration: &Calibration, info: &abbe_core::ModelInfo, group: &ErrorGroup) -> String {
    let mut own = group.parameters.iter().filter(|index| is_known(calibration, info, **index));
    let (Some(index), None) = (own.next(), own.next()) else { return String::new() };
    let parameter = &info.parameters[*index];
    let Some(known) = calibration.get(&parameter.name) else { return String::new() };
    let (unit, factor) = parameter.unit.for_people();
    let budget = calibration.uncertainty.iter().flat_map(|budget| &budget.parameters);
    let uncertainty =
        budget.filter(|entry| entry.name == parameter.name).map(|entry| entry.standard_uncertainty).next();
    let told = |times: f64| match uncertainty {
        Some(uncertainty) if uncertainty > 0.0 && known.status == Status::Estimated => {
            with_uncertainty(times * known.value * factor, 2.0 * times * uncertainty * factor)
        }
        _ => short(times * known.value * factor),
    };
    match group.is_reversal {
        true => format!("{} {unit} at reversal (2 × {})", told(2.0), told(1.0)),
        false => format!("{} {unit}", told(1.0)),
    }
}

/// Whether a parameter has a value of its own.
fn is_known(calibration: &Calibration, info: &abbe_core::ModelInfo, index: usize) -> bool {
    let known = calibration.get(&info.parameters[index].name);
    known.is_some_and(|known| known.status != Status::Fixed || known.value != info.nominal[index])
}

/// Commands of a status, for people.
fn place(model: &dyn KinematicModel, grid: &Grid, status: &[f64]) -> String {
    let info = model.info();
    let commands = grid.varied.iter().map(|(axis, _)| {
        let axis = &info.axes[*axis];
        let (unit, factor) = unit(axis.kind);
        format!("{} {:.0} {unit}", axis.name, status[axis.status] * factor)
    });
    let text = commands.collect::<Vec<_>>().join(", ");
    let is_negative = info
        .status
        .iter()
        .zip(status)
        .any(|(column, value)| matches!(column.role, StatusRole::Direction(_)) && *value < 0.0);
    if is_negative { text + NEGATIVE } else { text }
}

/// The unit of commands for people, and how many of it make one in memory.
pub fn unit(kind: AxisKind) -> (&'static str, f64) {
    match kind {
        AxisKind::Linear => ("mm", 1.0),
        AxisKind::Rotary => ("°", 180.0 / std::f64::consts::PI),
    }
}

/// The travel of every axis of a fit in mm or rad: where it was measured, else the travel of the machine. None if neither is
/// known.
pub fn travel(fit: &FitResult) -> Vec<Option<[f64; 2]>> {
    let axes = fit.model.info().axes.iter();
    axes.map(|axis| {
        let factor = unit(axis.kind).1;
        let measured = fit.residuals.travel(&axis.name).map(|range| range.map(|end| end / factor));
        measured.or_else(|| axis.range.filter(|_| !axis.endless))
    })
    .collect()
}

/// Poses that stand for the travel.
struct Grid {
    /// Axes that vary, and their positions.
    varied: Vec<(usize, Vec<f64>)>,
    /// Positions of all axes that stand still, by axis.
    held: BTreeMap<usize, f64>,
    ranges: Vec<String>,
}

impl Grid {
    fn of(fit: &FitResult) -> Self {
        let axes = &fit.model.info().axes;
        let travel = travel(fit);
        let varies = |axis: usize| {
            let wide = |[from, to]: [f64; 2]| to - from > 1e-6;
            !axes[axis].indexed && travel[axis].is_some_and(wide)
        };
        let count = (0..axes.len()).filter(|axis| varies(*axis)).count();
        let points = (2..=MOST_POINTS).rev().find(|points| points.pow(count as u32) <= MOST_POSES).unwrap_or(2);
        let mut grid = Self { varied: Vec::new(), held: BTreeMap::new(), ranges: Vec::new() };
        for (axis, range) in travel.iter().enumerate() {
            let Some([from, to]) = *range else { continue };
            if !varies(axis) {
                grid.held.insert(axis, from.midpoint(to));
                continue;
            }
            let part = |index: usize| index as f64 / (points - 1) as f64;
            let (unit, factor) = unit(axes[axis].kind);
            grid.ranges.push(format!("{} {:.0} to {:.0} {unit}", axes[axis].name, from * factor, to * factor));
            grid.varied.push((axis, (0..points).map(|index| from + (to - from) * part(index)).collect()));
        }
        grid
    }

    fn text(&self) -> String {
        self.ranges.join(", ")
    }

    /// All combinations of positions, in both directions of approach where these matter.
    fn statuses(&self, model: &dyn KinematicModel) -> Vec<f64> {
        let info = model.info();
        let mut first = standing(model);
        for (axis, position) in &self.held {
            first[info.axes[*axis].status] = *position;
        }
        let mut rows = vec![first];
        for (axis, positions) in &self.varied {
            let place = info.axes[*axis].status;
            let moved = |row: &Vec<f64>, at: f64| {
                let mut row = row.clone();
                row[place] = at;
                row
            };
            rows = rows.iter().flat_map(|row| positions.iter().map(move |at| moved(row, *at))).collect();
        }
        let is_direction = |column: usize| matches!(info.status[column].role, StatusRole::Direction(_));
        if (0..info.status.len()).any(is_direction) {
            let turned = |row: &Vec<f64>| -> Vec<f64> {
                row.iter().enumerate().map(|(at, value)| if is_direction(at) { -value } else { *value }).collect()
            };
            let backward: Vec<Vec<f64>> = rows.iter().map(turned).collect();
            rows.extend(backward);
        }
        rows.concat()
    }
}

/// The estimate that the page is about first: the one that most stages with limits judge; of several the one with most unknowns,
/// of these the first.
pub fn main_fit(run: &Run) -> Option<&FitResult> {
    let judged = |fit: &FitResult| {
        let by = |verdict: &&abbe_core::Verdict| {
            let mut figures = verdict.figures.iter();
            figures.any(|figure| figure.decision.is_some() && figure.of.as_deref() == Some(fit.name.as_str()))
        };
        run.verdicts.iter().filter(by).count()
    };
    let key = |fit: &FitResult| {
        let report = &fit.calibration.fit;
        (judged(fit), report.observations > 0, report.unknowns)
    };
    // Of equal ones the last is found: from behind this is the first.
    run.fits.iter().rev().max_by_key(|fit| key(fit))
}
