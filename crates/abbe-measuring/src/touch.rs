//! The touches of a plan: where the axes stand at nominal contact, and the outward normal there.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use abbe_core::{
    Absent, Axis, AxisKind, DataRow, Dataset, KinematicModel, PoseTable, Poses, Result, StatusColumn, StatusRole,
    Target, Values, pose_columns,
};
use nalgebra::Vector3;
use sha2::{Digest, Sha256};

use crate::solid::Solid;

/// A planned touch.
#[derive(Debug, Clone, PartialEq)]
pub struct Touch {
    /// Its number in the plan, from 1.
    pub number: usize,
    /// The label of the feature that it touches.
    pub feature: String,
    /// The status of the nominal machine in contact.
    pub status: Vec<f64>,
    /// The nominal place of the tip centre in contact, table frame, mm.
    pub tip: Vector3<f64>,
    /// The outward unit normal of the surface, table frame.
    pub normal: Vector3<f64>,
    /// From which side each axis comes to its position, +1 or -1, where the plan says it.
    pub directions: Vec<Option<f64>>,
    /// When it is planned, s.
    pub time: Option<f64>,
}

/// The touches of a plan, in its order.
#[derive(Debug, Clone, PartialEq)]
pub struct Touches {
    /// The touches; their numbers ascend.
    pub list: Vec<Touch>,
    /// Further labels of every touch (the indexation), by the name of their column.
    labels: Vec<(String, Vec<String>)>,
}

/// Distance from the nominal touches of a feature beyond which a planned position is none of them, mm.
const NEAR: f64 = 1.0;

impl Touches {
    /// The same without the touches of these numbers; the others keep theirs.
    pub fn without(&self, numbers: &BTreeSet<usize>) -> Self {
        let kept: Vec<bool> = self.list.iter().map(|touch| !numbers.contains(&touch.number)).collect();
        fn of<T: Clone>(all: &[T], kept: &[bool]) -> Vec<T> {
            all.iter().zip(kept).filter(|(_, kept)| **kept).map(|(item, _)| item.clone()).collect()
        }
        let labels = self.labels.iter().map(|(name, labels)| (name.clone(), of(labels, &kept)));
        Self { labels: labels.collect(), list: of(&self.list, &kept) }
    }

    /// Some rows of a table of candidates, in this order, with their planned times. `targets` are the nominal touches of the artefact.
    ///
    /// Fails if the tip is nowhere near a touch of its feature, and if the stylus changes.
    pub fn of_candidates(
        data: &Dataset,
        rows: &[(DataRow, Option<f64>)],
        targets: &[Target],
        model: &dyn KinematicModel,
    ) -> Result<Self> {
        let features = data.required_labels("feature")?;
        let statuses = statuses(data, rows.iter().map(|(row, _)| *row), model)?;
        let tips = tips(&statuses, model)?;
        let mut list = Vec::new();
        for (index, ((row, time), status)) in rows.iter().zip(&statuses).enumerate() {
            let distance = |target: &&Target| (Vector3::from(target.tip) - tips[index]).norm();
            let of_feature = targets.iter().filter(|target| target.feature == features[*row]);
            let nearest = of_feature.min_by(|one, other| distance(one).total_cmp(&distance(other)));
            let Some(approach) = nearest.filter(|target| distance(target) < NEAR).and_then(|target| target.approach)
            else {
                let message = format!("the tip is nowhere near a nominal touch of feature {}", features[*row]);
                let help = "positions of a measuring program are those in contact with the nominal artefact, and the artefact says how each is approached";
                return Err(data.error_at(*row, message).help(help));
            };
            list.push(Touch {
                number: index + 1,
                feature: features[*row].to_string(),
                status: status.clone(),
                tip: tips[index],
                normal: -Vector3::from(approach).normalize(),
                directions: directions(data, *row, model),
                time: *time,
            });
        }
        let rows: Vec<DataRow> = rows.iter().map(|(row, _)| *row).collect();
        Ok(Self { list, labels: labels(data, &rows) })
    }

    /// The rows of a file that [`Self::table`] wrote.
    ///
    /// Fails for a missing column, numbers of touches that do not ascend from 1, and a normal that is none.
    pub fn of_table(data: &Dataset, model: &dyn KinematicModel) -> Result<Self> {
        let (numbers, features) = (data.required_labels("touch")?, data.required_labels("feature")?);
        let components = ["nx", "ny", "nz"].map(|name| data.required_numbers(name));
        let [x, y, z] = components;
        let (x, y, z) = (x?, y?, z?);
        let rows: Vec<DataRow> = data.row_indices().collect();
        let statuses = statuses(data, rows.iter().copied(), model)?;
        let tips = tips(&statuses, model)?;
        let mut list: Vec<Touch> = Vec::new();
        for (index, (&row, status)) in rows.iter().zip(&statuses).enumerate() {
            let least = list.last().map_or(1, |touch| touch.number + 1);
            let number = numbers[row].parse().ok().filter(|number| *number >= least).ok_or_else(|| {
                data.error_at(row, format!("touch `{}`: a number from {least} on was expected", numbers[row]))
            })?;
            let normal = Vector3::new(x[row], y[row], z[row]);
            let off = (normal.norm() - 1.0).abs();
            if off.is_nan() || off > 1e-2 {
                let message = format!("the normal of touch {number} has length {:.4}; 1 was expected", normal.norm());
                return Err(data.error_at(row, message));
            }
            list.push(Touch {
                number,
                feature: features[row].to_string(),
                status: status.clone(),
                tip: tips[index],
                normal: normal.normalize(),
                directions: directions(data, row, model),
                time: data.numbers("time").map(|times| times[row]),
            });
        }
        Ok(Self { list, labels: labels(data, &rows) })
    }

    /// The plan as a table: numbers of touches, positions of all axes in nominal contact, contact points and normals.
    pub fn table(&self, model: &dyn KinematicModel) -> String {
        let axes = &model.info().axes;
        let directed: Vec<usize> =
            (0..axes.len()).filter(|&axis| self.list.iter().any(|touch| touch.directions[axis].is_some())).collect();
        let timed = self.list.iter().any(|touch| touch.time.is_some());
        let mut text = "touch,feature".to_owned();
        self.labels.iter().for_each(|(name, _)| text.extend([",", name]));
        axes.iter().for_each(|axis| text.extend([",", &axis.name, unit(axis)]));
        directed.iter().for_each(|&axis| text.extend([",dir_", &axes[axis].name]));
        text.push_str(if timed { ",time_s" } else { "" });
        text.push_str(",x_mm,y_mm,z_mm,nx,ny,nz\n");
        for (index, touch) in self.list.iter().enumerate() {
            let _ = write!(text, "{},{}", touch.number, cell(&touch.feature));
            self.labels.iter().for_each(|(_, labels)| text.extend([",", &cell(&labels[index])]));
            axes.iter().for_each(|axis| text.extend([",", &number(position(axis, &touch.status))]));
            for &axis in &directed {
                let _ = write!(text, ",{}", touch.directions[axis].unwrap_or(1.0));
            }
            if timed {
                let _ = write!(text, ",{:.3}", touch.time.unwrap_or_default());
            }
            let contact = touch.tip - model.info().stylus_radius * touch.normal;
            for value in contact.iter().chain(&touch.normal) {
                let _ = write!(text, ",{}", number(*value));
            }
            text.push('\n');
        }
        text
    }

    /// The first 16 hexadecimal digits of the SHA-256 of the plan: for every touch in ascending number a line `T<number>`, then for
    /// every axis in alphabetical order a blank, its name and its position in contact with six decimals, in mm or degrees.
    pub fn hash(&self, model: &dyn KinematicModel) -> String {
        let mut axes: Vec<&Axis> = model.info().axes.iter().collect();
        axes.sort_by(|one, other| one.name.cmp(&other.name));
        let mut text = String::new();
        for touch in &self.list {
            let _ = write!(text, "T{}", touch.number);
            axes.iter().for_each(|axis| text.extend([" ", &axis.name, &number(position(axis, &touch.status))]));
            text.push('\n');
        }
        let digest = Sha256::digest(text.as_bytes());
        digest.iter().take(8).map(|byte| format!("{byte:02X}")).collect()
    }

    /// The features as solids, with their labels: a sphere where the touches of a feature have several normals that meet in one point,
    /// and a disc at every other touch. `targets` are further touches of the same artefact.
    pub fn solids(&self, targets: &[Target], stylus_radius: f64, size: crate::FacetSize) -> Vec<(String, Solid)> {
        let planned = self.list.iter().map(|touch| (touch.feature.as_str(), touch.tip, touch.normal));
        let others = targets.iter().filter_map(|target| {
            Some((target.feature.as_str(), Vector3::from(target.tip), -Vector3::from(target.approach?).normalize()))
        });
        let mut by_feature: BTreeMap<&str, Vec<TipAndNormal>> = BTreeMap::new();
        for (feature, tip, normal) in planned.chain(others) {
            let known = by_feature.entry(feature).or_default();
            if !known.iter().any(|(other, along)| (other - tip).norm() < SAME && (along - normal).norm() < SAME) {
                known.push((tip, normal));
            }
        }
        let mut solids = Vec::new();
        for (feature, touches) in by_feature {
            match sphere(&touches, stylus_radius) {
                Some(sphere) => solids.push((feature.to_owned(), sphere)),
                None => solids.extend(touches.iter().map(|(tip, normal)| {
                    let surface = tip - stylus_radius * normal;
                    let behind = surface - size.thickness_mm * normal;
                    let radius_mm = size.radius_mm;
                    let disc = Solid::Cylinder { from_mm: surface.into(), to_mm: behind.into(), radius_mm };
                    (feature.to_owned(), disc)
                })),
            }
        }
        solids
    }
}

/// The centre of a tip in contact, and the outward normal there.
type TipAndNormal = (Vector3<f64>, Vector3<f64>);

/// Places, or directions, that differ by less are the same.
const SAME: f64 = 1e-3;

/// The ball on which all touches lie, if there is one: its centre is where their normals meet.
fn sphere(touches: &[TipAndNormal], stylus_radius: f64) -> Option<Solid> {
    let (first, along) = touches.first()?;
    // The tip is at the centre plus radius times normal.
    let other = touches.iter().find(|(_, other)| (other - along).norm() > 0.1)?;
    let (apart, turned) = (other.0 - first, other.1 - along);
    let radius = apart.dot(&turned) / turned.norm_squared();
    let centre = first - radius * along;
    let on_it = touches.iter().all(|(tip, normal)| (centre + radius * normal - tip).norm() < 0.1);
    let radius_mm = radius - stylus_radius;
    (on_it && radius_mm > 0.0).then(|| Solid::Sphere { centre_mm: centre.into(), radius_mm })
}

/// Statuses of rows; what is no axis may be missing.
fn statuses(data: &Dataset, rows: impl Iterator<Item = DataRow>, model: &dyn KinematicModel) -> Result<Vec<Vec<f64>>> {
    let naming = |status: &StatusColumn, axis: Option<&Axis>| {
        let absent = match (axis, status.absent) {
            (None, Absent::Required) => Absent::Default(0.0),
            (_, absent) => absent,
        };
        (vec![status.name.clone()], absent)
    };
    let columns = pose_columns(&data.headers(), data.files.first(), model, &naming)?;
    let stylus = model.info().status_index(&StatusRole::Stylus);
    let mut statuses: Vec<Vec<f64>> = Vec::new();
    for row in rows {
        let mut table = PoseTable::new(model);
        let pose = table.end();
        table.push(data, row, model, &columns)?;
        let status = table.row(pose).to_vec();
        let changes = |stylus: &usize| statuses.first().is_some_and(|first| first[*stylus] != status[*stylus]);
        if stylus.is_some_and(|stylus| changes(&stylus)) {
            let error = data.error_at(row, "the stylus changes here; a measuring program has one");
            return Err(error.help("plan and measure the touches of each stylus by themselves"));
        }
        statuses.push(status);
    }
    Ok(statuses)
}

fn tips(statuses: &[Vec<f64>], model: &dyn KinematicModel) -> Result<Vec<Vector3<f64>>> {
    let mut poses = Poses::default();
    model.poses(&statuses.concat(), &model.info().without_errors(), &[], false, &mut poses)?;
    Ok(poses.positions.into_iter().map(Vector3::from).collect())
}

/// Sides from which axes come, where the table has columns for them.
fn directions(data: &Dataset, row: DataRow, model: &dyn KinematicModel) -> Vec<Option<f64>> {
    let axes = &model.info().axes;
    let direction = |axis: usize| {
        let column = StatusRole::Direction(axis).column_name(axes)?;
        data.numbers(&column).map(|directions| directions[row]).filter(|direction| direction.abs() == 1.0)
    };
    (0..axes.len()).map(direction).collect()
}

/// Labels that a table has beside those that every plan has.
fn labels(data: &Dataset, rows: &[DataRow]) -> Vec<(String, Vec<String>)> {
    let own = ["touch", "feature"];
    let columns = data.columns.iter().filter(|column| !own.contains(&column.header.name.as_str()));
    let labels = columns.filter_map(|column| match &column.values {
        Values::Labels(labels) => {
            Some((column.header.header.clone(), rows.iter().map(|row| labels[*row].to_string()).collect()))
        }
        Values::Numbers(_) => None,
    });
    labels.collect()
}

/// Position of an axis in the units of files: mm or degrees.
pub fn position(axis: &Axis, status: &[f64]) -> f64 {
    match axis.kind {
        AxisKind::Linear => status[axis.status],
        AxisKind::Rotary => status[axis.status].to_degrees(),
    }
}

fn unit(axis: &Axis) -> &'static str {
    if axis.kind == AxisKind::Linear { "_mm" } else { "_deg" }
}

/// Six decimals, without a minus sign before zero.
fn number(value: f64) -> String {
    let text = format!("{value:.6}");
    if text == "-0.000000" { "0.000000".to_owned() } else { text }
}

/// A cell of a table.
fn cell(text: &str) -> String {
    match text.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.to_owned(),
    }
}
