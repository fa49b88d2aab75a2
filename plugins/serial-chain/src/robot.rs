//! Robots by Denavit and Hartenberg's parameters or by the lines of their joints, as a chain in machine coordinates.
//!
//! A chain has lines of axes and the tip in machine coordinates, all joints at zero. These follow from every convention: the
//! frames of the links at zero give the lines, the frame of the flange gives the tip. Errors are then those of the chain.

use abbe_core::{PathItem, SettingsError};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::settings::Settings;

/// A robot: the joints from the base to the flange in one of three conventions, and the tip.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Robot {
    /// Standard Denavit-Hartenberg parameters: link = Rz(theta + q) Tz(d) Tx(a) Rx(alpha); joint i turns about z of frame i - 1.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dh: Vec<Link>,
    /// Modified Denavit-Hartenberg parameters (Craig): link = Rx(alpha) Tx(a) Rz(theta + q) Tz(d), alpha and a before the joint.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub modified_dh: Vec<Link>,
    /// Lines of the joints in the base frame, all joints at zero (product of exponentials).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lines: Vec<Line>,
    /// The tip. With Denavit-Hartenberg parameters in the frame of the flange (the last one), with lines in the base frame, all
    /// joints at zero.
    #[serde(default)]
    pub tip_mm: [f64; 3],
}

/// A link by its four parameters; those that are left out are 0.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Link {
    /// Name of the joint, as the columns of the data have it: a letter by which it is rotary (A, B, C) or linear (X, Y, Z), and
    /// a number. Without it, the letter is that of the direction that is nearest to the joint's, numbered from 1: C1, B1, B2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Length of the link.
    #[serde(default)]
    pub a_mm: f64,
    /// Twist of the link.
    #[serde(default)]
    pub alpha_deg: f64,
    /// Offset of the link; of a linear joint, at zero.
    #[serde(default)]
    pub d_mm: f64,
    /// Angle of the joint; of a rotary joint, at zero.
    #[serde(default)]
    pub theta_deg: f64,
    /// The joint is linear: its command adds to d.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub linear: bool,
}

/// A joint by its line.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// Name of the joint, as for links.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Direction about (along) which a positive command moves.
    pub direction: [f64; 3],
    /// A point on the line of a rotary joint.
    #[serde(default)]
    pub point_mm: [f64; 3],
    /// The joint is linear.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub linear: bool,
}

/// A joint in the base frame, all joints at zero.
struct Joint<'a> {
    name: Option<&'a str>,
    direction: Vector3<f64>,
    point: Vector3<f64>,
    linear: bool,
}

/// The settings with `chain` and `axes` in the place of `robot`.
pub fn resolved(mut settings: Settings) -> Result<Settings, SettingsError> {
    let Some(robot) = settings.robot.take() else {
        return match settings.chain.is_empty() {
            true => Err(SettingsError::new("", "`chain` is missing").help("write `chain: ...`, or `robot: ...`")),
            false => Ok(settings),
        };
    };
    let at = |error: SettingsError| error.under([PathItem::Key("robot".to_owned())]);
    if !settings.chain.is_empty() {
        return Err(SettingsError::new("robot", "the machine has a `chain` already").help("leave one of them out"));
    }
    if settings.probe_offset_mm.is_some() || settings.tool_length_mm != 0.0 {
        let error =
            SettingsError::new("tip_mm", "a robot has its tip here, and neither a tool length nor a probe offset");
        return Err(at(error.help("write `tool_length_mm: 0` and leave `probe_offset_mm` out")));
    }
    let (joints, tip) = robot.at_zero().map_err(at)?;
    let names = names(&joints).map_err(at)?;
    settings.chain = format!("w b {} t", names.join(" "));
    let mut origin = Vector3::zeros();
    for (joint, name) in joints.iter().zip(&names) {
        let axis = settings.axes.entry(name.clone()).or_default();
        if axis.direction.is_some() || axis.point_mm.is_some() {
            let error = SettingsError::new(name, "the line of this axis follows from `robot`");
            return Err(error.help("leave `direction` and `point_mm` out").under([PathItem::Key("axes".to_owned())]));
        }
        axis.direction = Some(joint.direction.into());
        if !joint.linear {
            axis.point_mm = Some(joint.point.into());
            origin = joint.point;
        }
    }
    settings.probe_offset_mm = Some((tip - origin).into());
    Ok(settings)
}

impl Robot {
    /// The joints and the tip in the base frame, all joints at zero.
    fn at_zero(&self) -> Result<(Vec<Joint<'_>>, Vector3<f64>), SettingsError> {
        let declared = [!self.dh.is_empty(), !self.modified_dh.is_empty(), !self.lines.is_empty()];
        if declared.iter().filter(|declared| **declared).count() != 1 {
            return Err(SettingsError::new("", "exactly one of `dh`, `modified_dh` and `lines` was expected"));
        }
        let finite =
            |numbers: &[f64], setting: &str, index: usize| match numbers.iter().all(|number| number.is_finite()) {
                true => Ok(()),
                false => Err(SettingsError::new("", "finite numbers were expected")
                    .under([PathItem::Key(setting.to_owned()), PathItem::Index(index)])),
            };
        finite(&self.tip_mm, "tip_mm", 0)?;
        let tip = Point3::from(self.tip_mm);
        if !self.lines.is_empty() {
            let mut joints = Vec::new();
            for (index, line) in self.lines.iter().enumerate() {
                finite(&[line.direction, line.point_mm].concat(), "lines", index)?;
                let direction = Vector3::from(line.direction).try_normalize(1e-9).ok_or_else(|| {
                    SettingsError::new("direction", "three numbers that are not all zero were expected")
                        .under([PathItem::Key("lines".to_owned()), PathItem::Index(index)])
                })?;
                let point = Vector3::from(line.point_mm);
                joints.push(Joint { name: line.name.as_deref(), direction, point, linear: line.linear });
            }
            return Ok((joints, tip.coords));
        }
        let (links, is_modified) = if self.dh.is_empty() { (&self.modified_dh, true) } else { (&self.dh, false) };
        let (mut frame, mut joints) = (Isometry3::identity(), Vec::new());
        for (index, link) in links.iter().enumerate() {
            let setting = if is_modified { "modified_dh" } else { "dh" };
            finite(&[link.a_mm, link.alpha_deg, link.d_mm, link.theta_deg], setting, index)?;
            let twist = turn(Vector3::x_axis(), link.alpha_deg) * Translation3::new(link.a_mm, 0.0, 0.0);
            let joint = turn(Vector3::z_axis(), link.theta_deg) * Translation3::new(0.0, 0.0, link.d_mm);
            if is_modified {
                frame *= twist;
            }
            let direction = (frame.rotation * Vector3::z()).map(tidy);
            let point = frame.translation.vector.map(tidy);
            joints.push(Joint { name: link.name.as_deref(), direction, point, linear: link.linear });
            frame *= joint;
            if !is_modified {
                frame *= twist;
            }
        }
        Ok((joints, (frame * tip).coords.map(tidy)))
    }
}

fn turn(axis: nalgebra::UnitVector3<f64>, degrees: f64) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(&axis, degrees.to_radians()))
}

/// Without what rounding leaves of a zero.
fn tidy(number: f64) -> f64 {
    if number.abs() < 1e-13 { 0.0 } else { number }
}

/// Names of the joints: as given, else by the nearest direction and numbered.
fn names(joints: &[Joint<'_>]) -> Result<Vec<String>, SettingsError> {
    let mut counts = std::collections::BTreeMap::new();
    let mut names: Vec<String> = Vec::new();
    for (index, joint) in joints.iter().enumerate() {
        let nearest = (0..3).rev().max_by(|&a, &b| {
            let difference = joint.direction[a].abs() - joint.direction[b].abs();
            // Of directions that are as near, the last one.
            if difference.abs() < 1e-9 { a.cmp(&b) } else { difference.total_cmp(&0.0) }
        });
        let letters = if joint.linear { ["X", "Y", "Z"] } else { ["A", "B", "C"] };
        let letter = letters[nearest.unwrap_or(2)];
        let count = counts.entry(letter).or_insert(0);
        let name = match joint.name {
            Some(name) => name.to_owned(),
            None => {
                *count += 1;
                format!("{letter}{count}")
            }
        };
        let kinds = if joint.linear { ['X', 'Y', 'Z', 'U', 'V', 'W'].as_slice() } else { ['A', 'B', 'C'].as_slice() };
        if !name.starts_with(kinds) {
            let expected = kinds.iter().map(char::to_string).collect::<Vec<_>>().join(", ");
            let kind = if joint.linear { "linear" } else { "rotary" };
            let message =
                format!("joint {} is {kind}; a name with one of {expected} was expected, and not `{name}`", index + 1);
            return Err(SettingsError::new("", message));
        }
        names.push(name);
    }
    Ok(names)
}
