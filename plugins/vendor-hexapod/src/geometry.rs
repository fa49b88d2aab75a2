//! Poses of a hexapod and their derivatives.

use abbe_plugin::sdk::*;
use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};

use crate::settings::Settings;

/// Parameters of a strut: the error of its length, those of its base joint, those of its platform joint.
const OF_A_STRUT: usize = 7;

/// The tip of the tool in the platform frame.
const TIP: [&str; 3] = ["dxt", "dyt", "dzt"];

/// A smaller step ends the iteration, mm (and rad): the remaining error is about its square.
const SMALL: f64 = 1e-9;

/// Most steps: Newton's iteration needs five from anywhere in the workspace.
const STEPS: usize = 30;

/// A hexapod.
pub struct Hexapod {
    settings: Settings,
    info: ModelInfo,
}

/// Joints and lengths, errors included.
struct Actual {
    base: [Vector3<f64>; 6],
    platform: [Vector3<f64>; 6],
    lengths: [f64; 6],
}

/// The platform's frame in the machine's.
#[derive(Clone, Copy)]
struct Frame {
    at: Vector3<f64>,
    turn: UnitQuaternion<f64>,
}

impl Hexapod {
    /// Fails for settings that describe no hexapod.
    pub fn new(settings: Settings) -> Result<Self, SettingsError> {
        let [low, high] = settings.strut_range_mm;
        if !(low > 0.0 && high > low) {
            return Err(SettingsError::new(
                "strut_range_mm",
                "two lengths above 0 were expected, the smaller one first",
            ));
        }
        not_negative("stylus_radius_mm", settings.stylus_radius_mm)?;
        let axes = (0..6).map(|strut| Axis {
            name: format!("L{}", strut + 1),
            kind: AxisKind::Linear,
            branch: Branch::Tool,
            sense: 1.0,
            direction: [0.0, 0.0, 1.0],
            range: Some([low, high]),
            indexed: false,
            endless: false,
            status: strut,
        });
        let axes: Vec<Axis> = axes.collect();
        let status = axes.iter().enumerate().map(|(index, axis)| StatusColumn {
            name: axis.name.clone(),
            role: StatusRole::Command(index),
            quantity: Quantity::Length,
            levels: Vec::new(),
            absent: Absent::Required,
        });
        let status = status.collect();
        let of_strut = |strut: usize| {
            let names = ["length", "base.x", "base.y", "base.z", "platform.x", "platform.y", "platform.z"];
            names.map(|name| Parameter::new(format!("strut[{}].{name}", strut + 1), Unit::MM))
        };
        let tip = TIP.map(|name| Parameter::new(name, Unit::MM).with_role(ParameterRole::SetUp));
        let parameters = (0..6).flat_map(of_strut).chain(tip).collect();
        let written = serde_json::to_value(&settings).unwrap_or_default();
        let stylus_radius = settings.stylus_radius_mm;
        let info = ModelInfo { stylus_radius, ..ModelInfo::new(axes, status, parameters, written) };
        let hexapod = Self { settings, info };
        let middle = [(low + high) / 2.0; 6];
        let home = hexapod.actual(&middle, &hexapod.info.nominal);
        let singular = |_| {
            SettingsError::new(
                "",
                "with all struts at the middle of their range the platform has no pose near `home_mm`",
            )
        };
        hexapod.solve(&home).map_err(singular)?;
        Ok(hexapod)
    }

    fn actual(&self, commands: &[f64], values: &[f64]) -> Actual {
        let joint = |nominal: &[[f64; 3]; 6], strut: usize, first: usize| {
            let errors = &values[strut * OF_A_STRUT + first..];
            Vector3::from(nominal[strut]) + Vector3::new(errors[0], errors[1], errors[2])
        };
        let struts = [0, 1, 2, 3, 4, 5];
        Actual {
            base: struts.map(|strut| joint(&self.settings.base_joints_mm, strut, 1)),
            platform: struts.map(|strut| joint(&self.settings.platform_joints_mm, strut, 4)),
            lengths: struts.map(|strut| commands[strut] + values[strut * OF_A_STRUT]),
        }
    }

    fn tip(&self, values: &[f64]) -> Vector3<f64> {
        let errors = &values[6 * OF_A_STRUT..];
        Vector3::from(self.settings.tip_mm) + Vector3::new(errors[0], errors[1], errors[2])
    }

    /// The frame of the platform for these lengths, with the inverse of the derivatives of the strut lengths to the pose.
    fn solve(&self, actual: &Actual) -> Result<(Frame, Matrix6<f64>)> {
        let mut frame = Frame { at: self.settings.home_mm.into(), turn: UnitQuaternion::identity() };
        let singular = || {
            Error::data(format!(
                "the struts of lengths {:.3?} mm hold no platform, or one that they cannot hold",
                actual.lengths
            ))
            .help("a position out of the range of the machine, or a pose in which it is singular")
        };
        for _ in 0..STEPS {
            let (off, change) = struts(actual, &frame);
            let inverse = change.try_inverse().ok_or_else(singular)?;
            let step = inverse * off;
            if !step.iter().all(|value| value.is_finite()) {
                break;
            }
            frame.at -= step.fixed_rows::<3>(0);
            frame.turn = UnitQuaternion::from_scaled_axis(-step.fixed_rows::<3>(3).into_owned()) * frame.turn;
            if step.fixed_rows::<3>(0).norm() < SMALL && step.fixed_rows::<3>(3).norm() < SMALL * 1e-2 {
                return Ok((frame, struts(actual, &frame).1.try_inverse().ok_or_else(singular)?));
            }
        }
        Err(singular())
    }
}

/// Excess of each strut's length over its given length, and its derivatives to position and rotation vector of the platform.
fn struts(actual: &Actual, frame: &Frame) -> (Vector6<f64>, Matrix6<f64>) {
    let (mut off, mut change) = (Vector6::zeros(), Matrix6::zeros());
    for strut in 0..6 {
        let (arm, along) = arm_and_strut(actual, frame, strut);
        let direction = along.normalize();
        off[strut] = along.norm() - actual.lengths[strut];
        let moment = arm.cross(&direction);
        change.fixed_view_mut::<1, 3>(strut, 0).copy_from(&direction.transpose());
        change.fixed_view_mut::<1, 3>(strut, 3).copy_from(&moment.transpose());
    }
    (off, change)
}

/// From the platform's origin to a joint of it, and along the strut to that joint, both in the machine frame.
fn arm_and_strut(actual: &Actual, frame: &Frame, strut: usize) -> (Vector3<f64>, Vector3<f64>) {
    let arm = frame.turn * actual.platform[strut];
    (arm, frame.at + arm - actual.base[strut])
}

/// Derivatives of position and rotation vector of the platform, and of the tip in its frame, to a variable.
fn follows(variable: Variable, actual: &Actual, frame: &Frame, inverse: &Matrix6<f64>) -> (Vector6<f64>, Vector3<f64>) {
    // Strut i keeps |t + R P - B| - l = 0: a change of the left side by the variable is cancelled by the motion of the
    // platform.
    let (strut, part) = match variable {
        Variable::Command(axis) => (axis, 0),
        Variable::Parameter(index) if index < 6 * OF_A_STRUT => (index / OF_A_STRUT, index % OF_A_STRUT),
        Variable::Parameter(index) => return (Vector6::zeros(), unit(index - 6 * OF_A_STRUT)),
    };
    let direction = arm_and_strut(actual, frame, strut).1.normalize();
    let change = match part {
        0 => -1.0,
        1..=3 => -direction[part - 1],
        _ => (frame.turn.inverse() * direction)[part - 4],
    };
    (-inverse.column(strut) * change, Vector3::zeros())
}

fn unit(component: usize) -> Vector3<f64> {
    let mut unit = Vector3::zeros();
    unit[component] = 1.0;
    unit
}

impl KinematicModel for Hexapod {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn evaluate(&self, batch: PoseBatch<'_>, out: PosesMut<'_>) -> Result<()> {
        let PoseBatch { statuses, values, wanted, orientation } = batch;
        let tip = self.tip(values);
        for (pose, commands) in statuses.chunks_exact(6).enumerate() {
            let actual = self.actual(commands, values);
            let (frame, inverse) = self.solve(&actual).map_err(|error| error.at_pose(pose))?;
            let arm = frame.turn * tip;
            out.positions[pose] = (frame.at + arm).into();
            if orientation {
                let turn = frame.turn;
                out.orientations[pose] = [turn.w, turn.i, turn.j, turn.k];
            }
            for (k, &variable) in wanted.iter().enumerate() {
                let (platform, tip) = follows(variable, &actual, &frame, &inverse);
                let (moved, turned) = (platform.fixed_rows::<3>(0), platform.fixed_rows::<3>(3).into_owned());
                let by = pose * wanted.len() + k;
                out.position_derivatives[by] = (moved + turned.cross(&arm) + frame.turn * tip).into();
                if orientation {
                    out.rotation_derivatives[by] = turned.into();
                }
            }
        }
        Ok(())
    }
}
