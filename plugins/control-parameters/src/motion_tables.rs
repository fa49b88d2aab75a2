//! Errors of axes on points along each axis, rounded as files have them, linear between points.

use abbe_compensation::rigid::{Errors, Joint, Machine, Part, Six};
use abbe_core::{Calibration, CommandCorrection, KinematicModel, Result};
use abbe_volumetric::{Ranges, Steps, points_every, position_unit, range_of};
use nalgebra::Isometry3;

/// Most points along an axis.
const MOST: usize = 10_000;

/// Digits after the decimal point of errors in files, mm and rad.
const DIGITS: usize = 12;

/// A number as it stands in files.
pub fn text(value: f64) -> String {
    format!("{:.DIGITS$}", value + 0.0)
}

fn rounded(error: Six) -> Six {
    error.map(|value| text(value).parse().unwrap_or(value))
}

/// The errors of an axis: its location errors, and its error motions at points.
pub struct Curve {
    pub location: Six,
    /// Points along the axis, mm or deg.
    pub points: Vec<f64>,
    pub motions: Vec<Six>,
    /// How many of the unit of points make one in memory.
    factor: f64,
}

impl Curve {
    /// Adds error motions of each component at other points: positions and values. Points of all are points then.
    pub fn add(&mut self, others: &[Vec<(f64, f64)>; 6]) {
        let mut points = self.points.clone();
        points.extend(others.iter().flatten().map(|(point, _)| *point));
        points.sort_by(f64::total_cmp);
        points.dedup();
        let of = |other: &Vec<(f64, f64)>| -> Self {
            let motions = other.iter().map(|(_, value)| [*value; 6]).collect();
            Self {
                location: Six::default(),
                points: other.iter().map(|(point, _)| *point).collect(),
                motions,
                factor: 1.0,
            }
        };
        let others: Vec<Self> = others.iter().map(of).collect();
        let motion = |point: &f64| {
            let own = self.at(point / self.factor);
            let sum = |component: usize| {
                own[component] + others.get(component).map_or(0.0, |other| other.at(*point)[component])
            };
            rounded(std::array::from_fn(sum))
        };
        self.motions = points.iter().map(motion).collect();
        self.points = points;
    }

    /// The motion errors at a command; beyond the ends those of the ends.
    fn at(&self, command: f64) -> Six {
        let position = command * self.factor;
        let after = self.points.partition_point(|point| *point <= position);
        let Some(last) = self.points.len().checked_sub(1) else { return Six::default() };
        if after == 0 || after > last {
            return self.motions[after.min(last)];
        }
        let (a, b) = (self.points[after - 1], self.points[after]);
        let part = (position - a) / (b - a);
        std::array::from_fn(|component| {
            (1.0 - part) * self.motions[after - 1][component] + part * self.motions[after][component]
        })
    }
}

/// A machine with the errors of its axes in tables.
pub struct Tables {
    pub machine: Machine,
    /// One for every joint of the machine.
    pub curves: Vec<Curve>,
}

impl Tables {
    /// Samples the errors of a calibration. `ranges` is the name of the setting with the ranges of axes.
    pub fn new(
        calibration: &Calibration,
        model: &dyn KinematicModel,
        (ranges, setting): (&Ranges, &str),
        steps: Steps,
    ) -> Result<Self> {
        let machine = Machine::new(model)?;
        let mut curves = Vec::new();
        let errors = Errors::new(model, &machine, calibration);
        for (place, joint) in machine.joints.iter().enumerate() {
            let axis = &model.info().axes[joint.axis];
            let (_, factor) = position_unit(axis);
            let points = points_every(axis, range_of(axis, ranges, setting)?, steps, MOST)?;
            let motion = |point: &f64| Ok(rounded(errors.of(place, Part::Motion, point / factor)?));
            let motions = points.iter().map(motion).collect::<Result<Vec<Six>>>()?;
            let location = rounded(errors.of(place, Part::Location, 0.0)?);
            curves.push(Curve { location, points, motions, factor });
        }
        Ok(Self { machine, curves })
    }

    /// Joints with their curves.
    pub fn iter(&self) -> impl Iterator<Item = (&Joint, &Curve)> {
        self.machine.joints.iter().zip(&self.curves)
    }

    fn displacement(&self, place: usize, command: f64) -> Isometry3<f64> {
        let (joint, curve) = (&self.machine.joints[place], &self.curves[place]);
        joint.displaced(&curve.location) * joint.displaced(&curve.at(command))
    }
}

/// Commands of linear axes that undo the errors of the tip that tables tell.
pub struct TipCorrection {
    pub tables: Tables,
    /// Values of a status.
    pub width: usize,
}

impl CommandCorrection for TipCorrection {
    fn commands(&self, programmed: &[f64]) -> Result<Vec<f64>> {
        let mut all = Vec::with_capacity(programmed.len());
        for (point, status) in programmed.chunks(self.width).enumerate() {
            let corrected =
                self.tables.machine.corrected(status, &|place, command| self.tables.displacement(place, command));
            all.extend(corrected.map_err(|error| error.at_pose(point))?);
        }
        Ok(all)
    }
}
