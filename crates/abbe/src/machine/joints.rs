//! A robot in the conventions of robots: product of exponentials, Denavit and Hartenberg's parameters.

use std::fmt::Write;

use abbe_core::{AxisKind, Branch, ModelInfo};
use abbe_kinematics::{ChainAxis, ErrorFrame, denavit_hartenberg};

use super::{setting, side, tidy, vector};
use crate::table;

/// Whether a machine is read as a robot: all its axes carry the tool, and they are not the three linear ones of a machine tool
/// with a head, or the lines of all of them are declared.
fn is_robot(info: &ModelInfo) -> bool {
    let count = |kind| info.axes.iter().filter(|axis| axis.kind == kind).count();
    let is_declared = info.axes.iter().all(|axis| setting(info, &axis.name, "direction").is_some());
    let (linear, rotary) = (count(AxisKind::Linear), count(AxisKind::Rotary));
    info.axes.iter().all(|axis| axis.branch == Branch::Tool) && rotary > 0 && (is_declared || rotary > linear)
}

/// The joints of a chain without branches in the conventions of robots; nothing for a machine tool.
pub(super) fn text(info: &ModelInfo, width: usize) -> String {
    if !is_robot(info) {
        return String::new();
    }
    let chain: Vec<ChainAxis> = info
        .axes
        .iter()
        .map(|axis| ChainAxis {
            name: axis.name.clone(),
            kind: axis.kind,
            branch: axis.branch,
            direction: axis.direction.into(),
            point: setting(info, &axis.name, "point_mm").unwrap_or_default().into(),
            reverse: axis.sense * side(axis) < 0.0,
            error_frame: ErrorFrame::Moving,
        })
        .collect();
    let mut rows = vec![["joint", "direction", "moment: point x direction, mm"].map(str::to_owned).to_vec()];
    for axis in &chain {
        let direction = axis.direction * axis.sense();
        let moment = axis.point.cross(&direction);
        let moment = if axis.kind == AxisKind::Rotary { vector(moment.into()) } else { "linear".to_owned() };
        rows.push(vec![axis.name.clone(), vector(direction.into()), moment]);
    }
    let mut text =
        format!("\nProduct of exponentials: the joints in the base frame\n{}", table::within(&rows, &[], 1, width));
    let Some((links, flange)) = denavit_hartenberg(&chain) else {
        text.push_str(
            "  No Denavit-Hartenberg parameters without a base transformation: the first joint is not on z of the base.\n",
        );
        return text;
    };
    let header = ["joint", "a mm", "alpha °", "d mm", "theta °"].map(str::to_owned).to_vec();
    let (mut standard, mut modified) = (vec![header.clone()], vec![header]);
    let mut before = [0.0; 2];
    for (link, axis) in links.iter().zip(&chain) {
        let degrees = |angle: f64| tidy(angle.to_degrees());
        standard.push(vec![axis.name.clone(), tidy(link.a), degrees(link.alpha), tidy(link.d), degrees(link.theta)]);
        modified.push(vec![axis.name.clone(), tidy(before[0]), degrees(before[1]), tidy(link.d), degrees(link.theta)]);
        before = [link.a, link.alpha];
    }
    let last = chain.iter().rev().find(|axis| axis.kind == AxisKind::Rotary).map(|axis| axis.point).unwrap_or_default();
    let number =
        |key: &str| info.settings.get(key).cloned().and_then(|value| serde_json::from_value::<f64>(value).ok());
    let offset = info.settings.get("probe_offset_mm").cloned();
    let offset: [f64; 3] = offset.and_then(|value| serde_json::from_value(value).ok()).unwrap_or_default();
    let mut tip = last;
    (0..3).for_each(|part| tip[part] += offset[part]);
    tip[2] -= number("tool_length_mm").unwrap_or(0.0);
    let tip = flange.inverse_transform_point(&tip.into());
    let _ = write!(text, "\nDenavit-Hartenberg parameters (`dh`)\n{}", table::text(&standard, &[1, 2, 3, 4]));
    let _ = write!(text, "\nModified ones (`modified_dh`, Craig)\n{}", table::text(&modified, &[1, 2, 3, 4]));
    let linear: Vec<&str> =
        chain.iter().filter(|axis| axis.kind == AxisKind::Linear).map(|axis| axis.name.as_str()).collect();
    if !linear.is_empty() {
        let _ = writeln!(text, "  Linear joints (`linear: true`): {}.", linear.join(", "));
    }
    let _ = writeln!(text, "  The tip is at {} mm of the last frame (`tip_mm`).", vector(tip.coords.into()));
    text
}
