//! Artefacts measured on a CMM, and the rigid motion between its frame and the machine's.

use std::path::{Path, PathBuf};

use abbe_core::{DataRow, Dataset, Error, Feature, Figure, Findings, Fit, LabelText, Quantity, Result};
use nalgebra::{DMatrix, DVector, UnitQuaternion, Vector3, Vector6};

use crate::figures::{Limits, Sample, UM, judged};

/// Largest difference of nominal points (mm) and of normals between the CMM file and the artefact.
const AGREEMENT: f64 = 1e-3;

/// What a CMM found of the features of an artefact.
pub struct Cmm {
    path: PathBuf,
    table: Dataset,
    labels: Vec<String>,
    /// Nominal points of facets, measured centres of balls, mm.
    points: Vec<Vector3<f64>>,
    /// Normals and offsets along them, for facets.
    offsets: Option<(Vec<Vector3<f64>>, Vec<f64>)>,
}

/// Measured deviation of a feature from its nominal place, in one of the directions in which it can deviate.
#[derive(Debug, Clone, PartialEq)]
pub struct Shift {
    /// Index of the artefact's own unknown for it.
    pub own: usize,
    /// Nominal point of the feature, mm.
    pub point: Vector3<f64>,
    /// Unit direction.
    pub direction: Vector3<f64>,
    /// Measured shift, mm.
    pub measured: f64,
    /// The measured point in the frame of the CMM, mm: a centre, or a point of a facet.
    pub found: Vector3<f64>,
    /// Whether a plane was measured, of which only the offset along its normal counts.
    pub plane: bool,
}

/// The features that both sides have.
pub struct Matched {
    /// Number of features.
    pub features: usize,
    /// Their shifts.
    pub shifts: Vec<Shift>,
    /// The features that were left out and the reason, as text.
    pub left_out: Vec<String>,
}

impl Cmm {
    /// Reads a CMM file: `feature`, `x_mm`, `y_mm`, `z_mm` and for facets `nx`, `ny`, `nz`, `d_um`.
    pub fn read(path: &Path) -> Result<Self> {
        let table = abbe_table::read(path)?;
        abbe_table::unique_labels(&table, "feature")?;
        let labels = abbe_table::labels(&table, "feature")?.iter().map(LabelText::to_string).collect();
        let points = abbe_table::points(&table, ["x", "y", "z"])?.into_iter().map(Vector3::from).collect();
        let facets = ["nx", "ny", "nz", "d"].iter().any(|name| table.column(name).is_some());
        let offsets = if facets {
            let mut normals = Vec::new();
            for (row, normal) in DataRow::enumerate(abbe_table::vectors(&table, ["nx", "ny", "nz"])?) {
                let normal = Vector3::from(normal);
                if (normal.norm() - 1.0).abs() > 1e-2 {
                    let message = format!("the normal has length {:.4}; 1 was expected", normal.norm());
                    return Err(table.error_at(row, message));
                }
                normals.push(normal.normalize());
            }
            match table.column("d") {
                None => {
                    let message = "there is no column `d_um`, the measured offset along the normal";
                    return Err(Error::usage(message).in_file(path));
                }
                Some(_) => Some((normals, abbe_table::numbers(&table, "d", Quantity::Length)?.to_vec())),
            }
        } else {
            None
        };
        Ok(Self { path: path.to_owned(), table, labels, points, offsets })
    }

    /// The shifts of the features that both the file and the artefact have.
    pub fn matched(&self, features: &[Feature]) -> Result<Matched> {
        let mut matched = Matched { features: 0, shifts: Vec::new(), left_out: Vec::new() };
        let mut absent = Vec::new();
        for feature in features {
            match self.labels.iter().position(|label| *label == feature.label) {
                Some(row) => {
                    matched.features += 1;
                    matched.shifts.extend(self.shifts(DataRow(row), feature)?);
                }
                None => absent.push(feature.label.as_str()),
            }
        }
        if matched.features == 0 {
            return Err(Error::data("no feature of this file is one of the artefact's").in_file(&self.path));
        }
        let unknown = self.labels.iter().filter(|label| features.iter().all(|feature| feature.label != **label));
        let unknown: Vec<&str> = unknown.map(String::as_str).collect();
        if !unknown.is_empty() {
            matched.left_out.push(format!("not estimated and left out: {}", unknown.join(", ")));
        }
        if !absent.is_empty() {
            matched.left_out.push(format!("not in the CMM file and left out: {}", absent.join(", ")));
        }
        Ok(matched)
    }

    /// The shifts of the feature in a row, after a check that both sides mean the same feature.
    fn shifts(&self, row: DataRow, feature: &Feature) -> Result<Vec<Shift>> {
        let point = Vector3::from(feature.point);
        let label = &feature.label;
        let Some((normals, offsets)) = &self.offsets else {
            let shift = |&(own, direction): &(usize, [f64; 3])| {
                let direction = Vector3::from(direction);
                let (found, plane) = (self.points[row], false);
                Shift { own, point, direction, measured: direction.dot(&(found - point)), found, plane }
            };
            return Ok(feature.shifts.iter().map(shift).collect());
        };
        let wrong = |message: String| Err(self.table.error_at(row, message));
        let &[(own, direction)] = feature.shifts.as_slice() else {
            return wrong(format!(
                "an offset along a normal does not tell where feature {label} is, which can be off in {} directions; \
                 its measured centre was expected",
                feature.shifts.len()
            ));
        };
        let direction = Vector3::from(direction);
        if (self.points[row] - point).norm() > AGREEMENT {
            return wrong(format!(
                "the nominal point of feature {label} is {:.4} mm away from the artefact's",
                (self.points[row] - point).norm()
            ));
        }
        if (normals[row] - direction).norm() > AGREEMENT {
            return wrong(format!(
                "the normal of feature {label} is {:.4} rad off the artefact's",
                normals[row].angle(&direction)
            ));
        }
        let (measured, found) = (offsets[row], point + direction * offsets[row]);
        Ok(vec![Shift { own, point, direction, measured, found, plane: true }])
    }
}

/// Where an artefact is on the machine, seen from the frame of the CMM: a rigid motion, turns and all.
///
/// Turns are measured by the way that they move points at the artefact's own size, so that all six unknowns of a motion are lengths
/// and the shortest one means something.
#[derive(Clone)]
pub struct Placement {
    origin: Vector3<f64>,
    size: f64,
    rotation: UnitQuaternion<f64>,
    translation: Vector3<f64>,
}

impl Placement {
    /// Both frames the same, for an artefact with these shifts.
    pub fn of(shifts: &[Shift]) -> Self {
        let count = shifts.len().max(1) as f64;
        let origin = shifts.iter().map(|shift| shift.point).sum::<Vector3<f64>>() / count;
        let squares: f64 = shifts.iter().map(|shift| (shift.point - origin).norm_squared()).sum();
        let size = (squares / count).sqrt();
        let size = if size > 0.0 { size } else { 1.0 };
        Self { origin, size, rotation: UnitQuaternion::identity(), translation: Vector3::zeros() }
    }

    /// The same after one more motion: translation and turn times size, mm.
    pub fn moved(&self, motion: &Vector6<f64>) -> Self {
        let turn = UnitQuaternion::from_scaled_axis(motion.fixed_rows::<3>(3) / self.size);
        let translation = self.translation + motion.fixed_rows::<3>(0);
        Self { rotation: turn * self.rotation, translation, ..self.clone() }
    }

    /// How far the feature as the CMM measured it is off its nominal point on the machine, along the direction of its shift: a
    /// facet where its plane, tilted as it is, meets the line along the nominal normal.
    pub fn shift(&self, shift: &Shift) -> f64 {
        let (normal, off, _) = self.place(shift);
        normal.dot(&off) / normal.dot(&shift.direction)
    }

    /// What a further motion does to that, to first order.
    pub fn effect(&self, shift: &Shift) -> Vector6<f64> {
        let (normal, off, lever) = self.place(shift);
        let along = normal.dot(&shift.direction);
        let mut turn = lever.cross(&normal);
        if shift.plane {
            turn += normal.cross(&off) - normal.cross(&shift.direction) * (normal.dot(&off) / along);
        }
        let (step, turn) = (normal / along, turn / along / self.size);
        Vector6::new(step.x, step.y, step.z, turn.x, turn.y, turn.z)
    }

    /// The direction that counts, where the measured point is from the nominal one, and where it is from the origin of turns.
    fn place(&self, shift: &Shift) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
        let lever = self.rotation * (shift.found - self.origin);
        let off = self.origin + lever + self.translation - shift.point;
        (if shift.plane { self.rotation * shift.direction } else { shift.direction }, off, lever)
    }
}

/// Most steps to the best placement; each leaves the square of what the last one left.
const STEPS: usize = 20;

/// The placement with the smallest residuals, these residuals, and how many of the six motions they tell.
///
/// `linearise` gives residuals at a placement and what a further motion adds to them.
pub fn best_placement(
    start: Placement,
    linearise: impl Fn(&Placement) -> Result<(Vec<f64>, Vec<Vector6<f64>>)>,
) -> Result<(Vec<f64>, usize)> {
    let mut placement = start;
    for _ in 0..STEPS {
        let (residuals, effects) = linearise(&placement)?;
        let (step, rank) = best_motion(&effects, &residuals);
        if step.amax() < 1e-12 {
            return Ok((residuals, rank));
        }
        placement = placement.moved(&-step);
    }
    let (residuals, effects) = linearise(&placement)?;
    let rank = best_motion(&effects, &residuals).1;
    Ok((residuals, rank))
}

/// The least squares solution of `effects * motion = values`, of all such the shortest, and how many of the six motions
/// the effects tell.
fn best_motion(effects: &[Vector6<f64>], values: &[f64]) -> (Vector6<f64>, usize) {
    let finite = effects.iter().flat_map(|effect| effect.iter()).chain(values).all(|value| value.is_finite());
    if effects.is_empty() || !finite {
        return (Vector6::zeros(), 0);
    }
    let svd = DMatrix::from_fn(effects.len(), 6, |row, column| effects[row][column]).svd(true, true);
    let tolerance = 1e-6 * svd.singular_values.max();
    let rank = svd.rank(tolerance);
    let motion = svd.solve(&DVector::from_column_slice(values), tolerance);
    (motion.map_or_else(|_| Vector6::zeros(), |motion| Vector6::from_iterator(motion.iter().copied())), rank)
}

/// The remark about a motion that is not determined.
pub fn rank_remark(fit: &str, rank: usize) -> Option<String> {
    (rank < 6).then(|| {
        format!(
            "{fit}: the features tell only {rank} of the 6 motions between the frames of machine and CMM; of those that \
             fit equally well the smallest was taken"
        )
    })
}

/// Differences from a CMM that no machine has, µm.
const FAR: f64 = 500.0;

/// The remark about differences that are no errors of a machine.
pub fn distance_remark(fit: &str, left: &Sample) -> Option<String> {
    let rms = left.rms();
    (rms > FAR).then(|| {
        format!(
            "{fit}: the touches are {:.3} mm (RMS) from the features as the CMM measured them: are unit, sign and labels of the CMM \
             file right?",
            rms * 1e-3
        )
    })
}

/// What offsets along normals are multiplied by if they have the other sign or were read in another unit.
const MISREAD: [(f64, &str); 5] = [
    (-1.0, "with the other sign"),
    (25.4, "times 25.4"),
    (1.0 / 25.4, "divided by 25.4"),
    (1e3, "times 1000"),
    (1e-3, "divided by 1000"),
];

/// Differences from offsets that were read as they stand, µm, from which they are read otherwise, and the part of them that is left then.
const DOUBTFUL: f64 = 5.0;
const LEFT: f64 = 0.1;

/// Offsets that tell: six motions bring six of them to whatever was measured.
const TELLING: usize = 10;

/// The remark about offsets that explain the features far better with another sign or in another unit. `left` finds the differences in
/// µm for such offsets, after a placement that takes six motions at most.
pub fn misread_remark(
    fit: &str,
    as_read: &Sample,
    shifts: &[Shift],
    left: impl Fn(&[Shift]) -> Result<Sample>,
) -> Result<Option<String>> {
    let are_offsets = shifts.iter().all(|shift| shift.plane) && shifts.len() >= TELLING;
    if !are_offsets || as_read.rms() <= DOUBTFUL {
        return Ok(None);
    }
    let mut best: Option<(f64, &str)> = None;
    for (factor, words) in MISREAD {
        let other = |shift: &Shift| Shift {
            measured: factor * shift.measured,
            found: shift.point + shift.direction * (factor * shift.measured),
            ..shift.clone()
        };
        let rms = left(&shifts.iter().map(other).collect::<Vec<_>>())?.rms();
        if rms < best.map_or(LEFT * as_read.rms(), |(least, _)| least) {
            best = Some((rms, words));
        }
    }
    Ok(best.map(|(rms, words)| {
        format!(
            "{fit}: with the offsets of the CMM file {words} the differences fall from {:.1} µm to {rms:.1} µm (RMS): are their sign and \
             unit right?",
            as_read.rms()
        )
    }))
}

/// The findings of `judge` on every fit, against what the CMM measured.
pub fn against_cmm(
    file: &Path,
    fits: &[&Fit],
    limits: &Limits,
    judge: impl Fn(&Fit, &Cmm, &mut Findings) -> Result<()>,
) -> Result<Findings> {
    let cmm = Cmm::read(file)?;
    judged(fits, limits, |fit, findings| judge(fit, &cmm, findings))
}

/// The figures of the differences after the best rigid motion.
pub fn differences(fit: &str, left: &Sample) -> [Figure; 5] {
    [
        Figure::new(fit, "max", left.max(), UM),
        Figure::new(fit, "min", left.min(), UM),
        Figure::new(fit, "max absolute", left.max_absolute(), UM),
        Figure::new(fit, "mean", left.mean(), UM),
        Figure::new(fit, "standard deviation", left.standard_deviation(), UM),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn matched(text: &str, features: &[Feature]) -> Result<Matched, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cmm.csv");
        fs::write(&path, text).unwrap();
        let found = Cmm::read(&path).and_then(|cmm| cmm.matched(features));
        found.map_err(|error| error.to_string().replace(&format!("{}/", folder.path().display()), ""))
    }

    fn facet(label: &str) -> Feature {
        Feature { label: label.to_owned(), point: [1.0, 2.0, 3.0], shifts: vec![(4, [0.0, 0.0, 1.0])] }
    }

    fn ball() -> Feature {
        let shifts = vec![(0, [1.0, 0.0, 0.0]), (1, [0.0, 1.0, 0.0]), (2, [0.0, 0.0, 1.0])];
        Feature { label: "1".to_owned(), point: [1.0, 2.0, 3.0], shifts }
    }

    #[test]
    fn shifts_of_facets_and_balls() {
        let facets = "feature,x_mm,y_mm,z_mm,nx,ny,nz,d_um\n7,1,2,3,0,0,1,12.5\n8,1,2,3,0,0,1,1\n";
        let found = matched(facets, &[facet("7"), facet("9")]).unwrap();
        let [shift] = found.shifts.as_slice() else { panic!("{:?}", found.shifts) };
        assert_eq!((found.features, shift.own, shift.measured), (1, 4, 0.0125));
        assert_eq!(found.left_out, ["not estimated and left out: 8", "not in the CMM file and left out: 9"]);
        let found = matched("feature,x_mm,y_mm,z_mm\n1,1.5,2,2\n", &[ball()]).unwrap();
        assert_eq!(found.shifts.iter().map(|shift| shift.measured).collect::<Vec<_>>(), [0.5, 0.0, -1.0]);
    }

    #[test]
    fn files_that_mean_something_else_are_refused() {
        let header = "feature,x_mm,y_mm,z_mm,nx,ny,nz,d_um\n";
        let cases = [
            (
                format!("{header}5,1,2,3,0,0,1,0\n"),
                facet("7"),
                "cmm.csv: no feature of this file is one of the artefact's",
            ),
            (
                format!("{header}7,1,2.1,3,0,0,1,0\n"),
                facet("7"),
                "cmm.csv:2: the nominal point of feature 7 is 0.1000 mm away from the artefact's",
            ),
            (
                format!("{header}7,1,2,3,0,0.6,0.8,0\n"),
                facet("7"),
                "cmm.csv:2: the normal of feature 7 is 0.6435 rad off the artefact's",
            ),
            (
                format!("{header}7,1,2,3,0,0,2,0\n"),
                facet("7"),
                "cmm.csv:2: the normal has length 2.0000; 1 was expected",
            ),
            (
                format!("{header}1,1,2,3,0,0,1,0\n"),
                ball(),
                "cmm.csv:2: an offset along a normal does not tell where feature 1 is, which can be off in 3 directions; \
                 its measured centre was expected",
            ),
            (
                format!("{header}7,1,2,3,0,0,1,0\n7,1,2,3,0,0,1,0\n"),
                facet("7"),
                "cmm.csv:3: feature `7` is in line 2 already",
            ),
            (
                "feature,x_mm,y_mm,z_mm,nx,ny,nz\n7,1,2,3,0,0,1\n".to_owned(),
                facet("7"),
                "cmm.csv: there is no column `d_um`, the measured offset along the normal",
            ),
        ];
        for (text, feature, expected) in cases {
            assert_eq!(matched(&text, &[feature]).err().unwrap(), expected);
        }
    }

    /// Nine facets of a cube, and three balls.
    fn features() -> Vec<Shift> {
        let mut shifts = Vec::new();
        for axis in 0..3 {
            for (u, v) in [(50.0, 20.0), (-40.0, 30.0), (10.0, -60.0)] {
                let mut point = Vector3::repeat(100.0);
                point[(axis + 1) % 3] = u;
                point[(axis + 2) % 3] = v;
                let (direction, measured) = (Vector3::ith(axis, 1.0), 0.01 * (u - v) / 100.0);
                let found = point + direction * measured;
                shifts.push(Shift { own: shifts.len(), point, direction, measured, found, plane: true });
            }
            let point = Vector3::new(70.0, -80.0, 90.0) - Vector3::ith(axis, 120.0);
            let found = point + Vector3::new(0.02, -0.01, 0.015);
            shifts.extend((0..3).map(|along| {
                let direction = Vector3::ith(along, 1.0);
                Shift { own: 0, point, direction, measured: direction.dot(&(found - point)), found, plane: false }
            }));
        }
        shifts
    }

    #[test]
    fn a_rigid_motion_is_found_however_large() {
        let shifts = features();
        let start = Placement::of(&shifts);
        for size in [1e-3, 1.0, 20.0] {
            let truth = start.moved(&(Vector6::new(0.1, -0.2, 0.3, 0.1, 0.2, -0.1) * size));
            let own: Vec<f64> = shifts.iter().map(|shift| truth.shift(shift)).collect();
            // What a plane is on the machine, told by two points of it.
            for shift in shifts.iter().filter(|shift| shift.plane) {
                let on_plane =
                    |point: Vector3<f64>| truth.rotation * (point - truth.origin) + truth.origin + truth.translation;
                let met = shift.point + shift.direction * truth.shift(shift);
                let normal = truth.rotation * shift.direction;
                assert!(normal.dot(&(met - on_plane(shift.found))).abs() < 1e-12);
            }
            let (left, rank) = best_placement(start.clone(), |placement| {
                let residuals = shifts.iter().zip(&own).map(|(shift, own)| placement.shift(shift) - own);
                Ok((residuals.collect(), shifts.iter().map(|shift| placement.effect(shift)).collect()))
            })
            .unwrap();
            let largest = left.iter().fold(0.0, |largest: f64, left| largest.max(left.abs()));
            assert!(rank == 6 && largest < 1e-11, "{size}: {rank} {largest:e}");
        }
    }

    #[test]
    fn effects_are_derivatives() {
        let shifts = features();
        let at = Placement::of(&shifts).moved(&Vector6::new(1.0, -2.0, 3.0, 4.0, 5.0, -6.0));
        for (index, shift) in shifts.iter().enumerate() {
            for k in 0..6 {
                let along = Vector6::ith(k, 1e-4);
                let difference = (at.moved(&along).shift(shift) - at.moved(&-along).shift(shift)) / 2e-4;
                assert!((difference - at.effect(shift)[k]).abs() < 1e-8, "{index} {k}");
            }
        }
    }
}
