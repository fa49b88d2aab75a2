//! Candidates on a grid: the measurements that the nominal machine can reach.

use std::collections::BTreeSet;
use std::fmt::Write;

use abbe_core::{
    Absent, Artefact, AxisKind, Error, KinematicModel, PathItem, Poses, Result, Series, StatusRole, Target,
};
use abbe_estimation::InverseKinematics;
use abbe_numerics::dot;

use crate::settings::{GeneratedLengths, Generation};
use crate::wrong;

mod interpolation;

/// A larger number of candidates is taken as a mistake in the settings.
const MOST: usize = 1_000_000;

/// An axis that moves by less than this during the approach stands still, mm/mm. Its direction of approach is then positive.
const AT_REST: f64 = 1e-6;

/// The candidates as the text of a data file, nominal positions of all axes in every row.
///
/// Fails for axes that the machine does not have, an artefact without features, a machine that needs other columns than the
/// grid has, and a grid of which the machine reaches no candidate.
pub fn generate(wanted: &Generation, artefact: &dyn Artefact, model: &dyn KinematicModel) -> Result<String> {
    let grid = Grid::new(wanted, model)?;
    if !wanted.interpolations.is_empty() {
        return grid.interpolations(wanted, &artefact.targets(model.info().stylus_radius)?);
    }
    match &wanted.lengths {
        Some(lengths) => grid.lengths(wanted, lengths),
        None => grid.touches(wanted, &artefact.targets(model.info().stylus_radius)?),
    }
}

/// An error about a setting of the grid.
fn wrong_grid(key: &str, message: impl Into<String>) -> Error {
    let mut error = wrong(key, message);
    error.setting.insert(0, PathItem::Key("generate".to_owned()));
    error
}

/// The nominal machine at every indexation.
struct Grid<'a> {
    model: &'a dyn KinematicModel,
    nominal: Vec<f64>,
    /// The status of axes that all stand at zero.
    standing: Vec<f64>,
    /// One status for every indexation, linear axes at zero.
    indexations: Vec<Vec<f64>>,
}

impl<'a> Grid<'a> {
    fn new(wanted: &Generation, model: &'a dyn KinematicModel) -> Result<Self> {
        let axes = &model.info().axes;
        for name in wanted.indexations_deg.keys() {
            let rotary = || axes.iter().filter(|axis| axis.kind == AxisKind::Rotary).map(|axis| axis.name.as_str());
            if !rotary().any(|axis| axis == name) {
                let error = wrong_grid("indexations_deg", format!("the machine has no rotary axis {name}"));
                return Err(error.suggest(name, rotary()));
            }
        }
        let mut status = Vec::new();
        for (index, column) in model.info().status.iter().enumerate() {
            let axis = axes.iter().any(|axis| axis.status == index);
            match column.absent {
                _ if matches!(column.role, StatusRole::Direction(_)) => status.push(1.0),
                Absent::Default(value) => status.push(value),
                Absent::Required if axis || column.role == StatusRole::Time => status.push(0.0),
                Absent::Required => {
                    let message =
                        format!("the machine needs a column `{}`, of which the grid knows nothing", column.name);
                    return Err(wrong("generate", message).help("give the candidates as a file"));
                }
            }
        }
        let standing = status.clone();
        let mut indexations = vec![status];
        for (index, axis) in axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Rotary) {
            let positions = wanted.indexations_deg.get(&axis.name).map_or(Ok(vec![0.0]), Series::values);
            let positions = positions.map_err(|error| wrong_grid("indexations_deg", error.message))?;
            // Backlash is visible only if a position is approached from both sides.
            let approach = model.info().status_index(&StatusRole::Direction(index));
            let sides: &[f64] = if wanted.indexations_deg.contains_key(&axis.name) && approach.is_some() {
                &[1.0, -1.0]
            } else {
                &[1.0]
            };
            let turned = |status: &Vec<f64>| -> Vec<Vec<f64>> {
                let at = |(position, side): (f64, f64)| {
                    let mut status = status.clone();
                    status[axis.status] = position.to_radians();
                    approach.iter().for_each(|&column| status[column] = side);
                    status
                };
                pairs(&positions, sides).map(at).collect()
            };
            indexations = indexations.iter().flat_map(turned).collect();
        }
        let in_range = |status: &Vec<f64>| {
            axes.iter().filter(|axis| axis.kind == AxisKind::Rotary).all(|axis| {
                axis.range.is_none_or(|[from, to]| (from - 1e-9..=to + 1e-9).contains(&status[axis.status]))
            })
        };
        indexations.retain(in_range);
        Ok(Self { model, nominal: model.info().nominal.clone(), standing, indexations })
    }

    /// Statuses in which the linear axes bring the tip to points of the table frame; none for points that they do not reach.
    fn reached(&self, indexation: &[f64], points: &[[f64; 3]]) -> Result<Vec<Option<Vec<f64>>>> {
        InverseKinematics::new(self.model, &self.nominal, None).solve(vec![indexation.to_vec(); points.len()], points)
    }

    /// Features that are touched at every indexation.
    fn touches(&self, wanted: &Generation, targets: &[Target]) -> Result<String> {
        if targets.is_empty() {
            let error = wrong("generate", "this artefact has no features that the tip is sent to");
            return Err(error.help("write `lengths` for lengths between two poses, or give the candidates as a file"));
        }
        let tips: Vec<[f64; 3]> = targets.iter().map(|target| target.tip).collect();
        let least = wanted.reach_deg.to_radians().cos() - 1e-9;
        let mut rows = Vec::new();
        for (group, indexation) in self.indexations.iter().enumerate() {
            let spindle_side = self.spindle_side(indexation)?;
            let accessible =
                |target: &Target| target.approach.is_none_or(|approach| -dot(&approach, &spindle_side) >= least);
            for (target, status) in targets.iter().zip(self.reached(indexation, &tips)?) {
                let Some(mut status) = status.filter(|_| accessible(target)) else { continue };
                self.approach(&mut status, target)?;
                rows.push((format!("{},{}", group + 1, target.feature), vec![status]));
            }
        }
        self.table("group,feature", &[""], wanted, rows)
    }

    /// Lengths at every indexation, each a candidate of its own.
    fn lengths(&self, wanted: &Generation, lengths: &GeneratedLengths) -> Result<String> {
        let values = |series: &Series| series.values().map_err(|error| wrong_grid("lengths", error.message));
        let [length, x, y, z, azimuth, elevation] = [
            values(&lengths.lengths_mm)?,
            values(&lengths.x_mm)?,
            values(&lengths.y_mm)?,
            values(&lengths.z_mm)?,
            values(&lengths.azimuth_deg)?,
            values(&lengths.elevation_deg)?,
        ];
        let each = [&length, &x, &y, &z, &azimuth, &elevation]
            .iter()
            .fold(self.indexations.len(), |all, series| all.saturating_mul(series.len()));
        if each > MOST {
            return Err(wrong_grid("lengths", format!("{each} candidates are too many; at most {MOST} are tried")));
        }
        let (mut ends, mut known, mut tried) = (Vec::new(), Vec::new(), BTreeSet::new());
        for &length in &length {
            for (azimuth, elevation) in pairs(&azimuth, &elevation) {
                let (azimuth, elevation) = (azimuth.to_radians(), elevation.to_radians());
                let along = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
                for (x, y) in pairs(&x, &y) {
                    for &z in &z {
                        let pair = [[x, y, z], [x + length * along[0], y + length * along[1], z + length * along[2]]];
                        // A vertical length is the same at every azimuth. A length and its reverse are two candidates: the
                        // axes move in opposite directions.
                        if tried.insert(pair.map(|end| end.map(|coordinate| (coordinate * 1e6).round() as i64))) {
                            ends.extend(pair);
                            known.push(length);
                        }
                    }
                }
            }
        }
        let mut rows = Vec::new();
        for (group, indexation) in self.indexations.iter().enumerate() {
            let reached = self.reached(indexation, &ends)?;
            for (pair, length) in reached.chunks_exact(2).zip(&known) {
                if let [Some(one), Some(other)] = pair {
                    rows.push((format!("{},{},{length}", group + 1, rows.len() + 1), vec![one.clone(), other.clone()]));
                }
            }
        }
        self.table("group,length,reference_mm", &["1", "2"], wanted, rows)
    }

    /// Direction from the tip to the spindle, unit vector in the table frame.
    fn spindle_side(&self, indexation: &[f64]) -> Result<[f64; 3]> {
        let mut poses = Poses::default();
        self.model.poses(indexation, &self.nominal, &[], true, &mut poses)?;
        let [w, x, y, z] = poses.orientations[0];
        // The z axis of the tool frame, turned by the quaternion.
        Ok([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])
    }

    /// Sets the directions in which axes move during the approach.
    fn approach(&self, status: &mut [f64], target: &Target) -> Result<()> {
        let Some(approach) = target.approach else { return Ok(()) };
        let back = [0, 1, 2].map(|k| target.tip[k] - approach[k]);
        let Some(from) = self.reached(status, &[back])?.pop().flatten() else { return Ok(()) };
        let linear = self.model.info().axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Linear);
        for (index, axis) in linear {
            let moved = status[axis.status] - from[axis.status];
            if let Some(column) = self.model.info().status_index(&StatusRole::Direction(index)) {
                status[column] = if moved < -AT_REST { -1.0 } else { 1.0 };
            }
        }
        Ok(())
    }

    /// The text of a data file; `ends` are the numbers that the names of columns get, one for every pose of a row.
    fn table(
        &self,
        labels: &str,
        ends: &[&str],
        wanted: &Generation,
        rows: Vec<(String, Vec<Vec<f64>>)>,
    ) -> Result<String> {
        if rows.is_empty() {
            return Err(wrong("generate", "the machine reaches nothing of this")
                .help("are the ranges of its axes, the nominal places and `reach_deg` right?"));
        }
        // Columns of the grid: positions of axes and, for rows of a single pose, directions of approach and time.
        let column = |index: &usize| {
            let of_one_pose =
                || matches!(self.model.info().status[*index].role, StatusRole::Direction(_) | StatusRole::Time);
            self.model.info().axes.iter().any(|axis| axis.status == *index) || (ends.len() == 1 && of_one_pose())
        };
        let columns: Vec<usize> = (0..self.model.info().status.len()).filter(column).collect();
        let mut text = labels.to_owned();
        for end in ends {
            for &index in &columns {
                let status = &self.model.info().status[index];
                let _ = write!(text, ",{}{end}{}", status.name, status.quantity.usual_suffix());
            }
        }
        let own: Vec<&str> = text.split(',').collect();
        if let Some(twice) = wanted.columns.keys().find(|name| own.contains(&name.as_str()) || *name == "duration_s") {
            return Err(wrong_grid("columns", format!("the grid has a column `{twice}` of its own")));
        }
        wanted.columns.keys().for_each(|name| text.push_str(&format!(",{name}")));
        text.push_str(if wanted.duration_s.is_some() { ",duration_s\n" } else { "\n" });
        for (row, (labels, poses)) in rows.iter().enumerate() {
            text.push_str(labels);
            for status in poses {
                for &index in &columns {
                    let column = &self.model.info().status[index];
                    let value = match self.model.info().axes.iter().find(|axis| axis.status == index) {
                        Some(axis) if axis.kind == AxisKind::Rotary => status[index].to_degrees(),
                        None if column.role == StatusRole::Time => row as f64 * wanted.duration_s.unwrap_or(1.0),
                        _ => status[index],
                    };
                    // To the nanometre, without a minus sign before zero.
                    let _ = write!(text, ",{}", (value * 1e6).round() / 1e6 + 0.0);
                }
            }
            wanted.columns.values().for_each(|value| text.push_str(&format!(",{value}")));
            let _ = match wanted.duration_s {
                Some(duration) => writeln!(text, ",{duration}"),
                None => writeln!(text),
            };
        }
        Ok(text)
    }
}

fn pairs<'a>(one: &'a [f64], other: &'a [f64]) -> impl Iterator<Item = (f64, f64)> + 'a {
    one.iter().flat_map(move |&a| other.iter().map(move |&b| (a, b)))
}
