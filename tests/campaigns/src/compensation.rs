//! Corrected set-points of random machines with random errors.
//!
//! Laws: linear axes bring the tip where the nominal machine has it, to 1e-9 mm in at most four passes; rotary axes that span both tilts
//! bring the tool axis there, to 1e-9 rad; no rotary correction exceeds its bound; no tool axis gets worse; directions of approach
//! stay; a correction with the wrong sign makes it worse.

use abbe_compensation::{Compensator, Correct, Correction, Settings, figures};
use abbe_core::{AxisKind, KinematicModel, Poses, StatusRole, Variable, in_parallel};
use nalgebra::{DMatrix, Quaternion, UnitQuaternion, Vector3};
use serde_json::json;

use crate::Random;
use crate::machine::{error, machine, model};
use crate::machines::Report;

/// Set-points of a machine.
const POINTS: usize = 40;

/// Rotary axes span both tilts if the smaller singular value of their derivatives is not below this.
const SPANNED: f64 = 0.02;

/// Smaller singular value of the points that are far from a pole.
const FAR: f64 = 0.2;

/// Smallest singular value of linear axes that are not parallel.
const APART: f64 = 0.3;

/// Largest correction of a rotary axis, rad.
const BOUND: f64 = 50e-3;

/// Random set-points, each approached from a random side.
fn set_points(random: &mut Random, model: &dyn KinematicModel) -> Vec<f64> {
    let info = model.info();
    let value = |random: &mut Random, role: &StatusRole| match role {
        StatusRole::Command(axis) if info.axes[*axis].kind == AxisKind::Linear => random.within(200.0),
        // Poles are at zero and at right angles.
        StatusRole::Command(_) if random.chance(0.2) => random.of(&[0.0, 1e-6, 1e-4, 0.003]),
        StatusRole::Command(_) => random.within(1.7),
        _ => random.of(&[-1.0, 1.0]),
    };
    let of_axis = |index: usize| info.axes.iter().position(|axis| axis.status == index).map(StatusRole::Command);
    let roles: Vec<StatusRole> =
        info.status.iter().enumerate().map(|(index, column)| of_axis(index).unwrap_or(column.role.clone())).collect();
    let candidates: Vec<f64> =
        (0..4 * POINTS).flat_map(|_| roles.iter().map(|role| value(random, role)).collect::<Vec<_>>()).collect();
    // Rotary axes between linear ones can make these parallel: no machine works there.
    let spans = spans(model, &info.nominal, &candidates);
    let apart = candidates.chunks(roles.len()).zip(spans).filter(|(_, [linear, _])| *linear > APART);
    apart.take(POINTS).flat_map(|(status, _)| status.to_vec()).collect()
}

/// The smallest singular value of what linear commands change of the tip, and the second one of what rotary commands change of the tool
/// axis, for every point.
fn spans(model: &dyn KinematicModel, values: &[f64], statuses: &[f64]) -> Vec<[f64; 2]> {
    let all = (0..model.info().axes.len()).map(Variable::Command).collect::<Vec<_>>();
    let of_kind =
        |kind: AxisKind| (0..all.len()).filter(|&axis| model.info().axes[axis].kind == kind).collect::<Vec<_>>();
    let (linear, rotary) = (of_kind(AxisKind::Linear), of_kind(AxisKind::Rotary));
    let mut poses = Poses::default();
    model.poses(statuses, values, &all, true, &mut poses).expect("poses");
    let value = |columns: Vec<Vector3<f64>>, index: usize| {
        if columns.len() <= index {
            return 0.0;
        }
        let mut found: Vec<f64> = DMatrix::from_fn(3, columns.len(), |row, column| columns[column][row])
            .singular_values()
            .iter()
            .copied()
            .collect();
        found.sort_by(|a, b| b.total_cmp(a));
        found[index]
    };
    let spans = |point: usize| {
        let [w, x, y, z] = poses.orientations[point];
        let axis = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)) * Vector3::z();
        let start = point * all.len();
        let shifts = linear.iter().map(|index| Vector3::from(poses.position_derivatives[start + index]));
        let turns = rotary.iter().map(|index| Vector3::from(poses.rotation_derivatives[start + index]).cross(&axis));
        [value(shifts.collect(), 2), value(turns.collect(), 1)]
    };
    (0..poses.positions.len()).map(spans).collect()
}

fn correct(
    model: &dyn KinematicModel,
    values: &[f64],
    statuses: &[f64],
    correct: Correct,
) -> Result<(Vec<f64>, Vec<Correction>), String> {
    let settings = Settings {
        correct,
        largest_tip_correction_mm: 1e3,
        largest_axis_correction_mrad: 1e3,
        largest_rotary_correction_mrad: BOUND * 1e3,
        ..Settings::default()
    };
    let compensator = Compensator::new(model, values, &settings).map_err(|error| error.to_string())?;
    compensator.correct(statuses).map_err(|error| error.to_string())
}

/// What is wrong with the corrections of one machine; and how many points had both tilts, and how many were held at the bound.
fn case(seed: u64, number: u64) -> (Vec<String>, usize, usize) {
    let mut random = Random::new(seed, number);
    let mut settings = machine(&mut random);
    if let Some(errors) = settings["errors"].as_array_mut() {
        errors.push(json!({ "backlash": ["EXX", "EYY"] }));
    }
    let model = model(&settings);
    let model = model.as_ref();
    let values: Vec<f64> = model.info().parameters.iter().map(|parameter| error(&mut random, parameter)).collect();
    let programmed = set_points(&mut random, model);
    if programmed.is_empty() {
        return (Vec::new(), 0, 0);
    }
    let mut wrong = Vec::new();
    let mut law = |holds: bool, what: String| {
        if !holds {
            wrong.push(what);
        }
    };
    let width = model.info().status.len();
    let changed = |now: &[f64], is_it: &dyn Fn(usize) -> bool| {
        let pairs = now.iter().zip(&programmed).enumerate().filter(|(index, _)| is_it(index % width));
        pairs.map(|(_, (now, before))| (now - before).abs()).fold(0.0, f64::max)
    };
    let kind = |wanted: AxisKind| {
        move |status: usize| model.info().axes.iter().any(|axis| axis.status == status && axis.kind == wanted)
    };
    let is_command = |status: usize| model.info().axes.iter().any(|axis| axis.status == status);
    let (mut spanned, mut bounded) = (0, 0);
    for what in [Correct::Position, Correct::FiveAxes] {
        let name = format!("{what:?}");
        let (now, corrections) = match correct(model, &values, &programmed, what.clone()) {
            Ok(found) => found,
            Err(error) => return (vec![format!("{name}: {error}")], 0, 0),
        };
        let found = figures(&corrections);
        law(changed(&now, &|status| !is_command(status)) == 0.0, format!("{name}: directions are changed"));
        let turned = changed(&now, &kind(AxisKind::Rotary));
        // What linear axes tilt on the way of their correction, where the bound leaves it.
        let shifted = changed(&now, &kind(AxisKind::Linear));
        if what == Correct::Position {
            law(turned == 0.0, format!("{name}: rotary axes are corrected by {turned}"));
        }
        law(turned <= BOUND * (1.0 + 1e-9), format!("{name}: a rotary axis is corrected by {turned} rad"));
        for ((point, correction), [_, span]) in corrections.iter().enumerate().zip(spans(model, &values, &programmed)) {
            let distance = correction.after.distance();
            law(distance < 1e-9, format!("{name}, point {point}: the tip is {distance:e} mm off"));
            let (before, after) = (correction.before.angle(), correction.after.angle());
            if what == Correct::FiveAxes {
                bounded += usize::from(correction.is_bounded);
                law(
                    after <= before + 1e-6 * (1.0 + shifted),
                    format!("point {point}: the tool axis goes from {before:e} to {after:e} rad"),
                );
                if span > SPANNED && !correction.is_bounded {
                    spanned += 1;
                    law(after < 1e-9, format!("point {point}: the tool axis is {after:e} rad off"));
                    law(span < FAR || correction.passes <= 4, format!("point {point}: {} passes", correction.passes));
                }
                law(
                    !correction.is_bounded || span < before / BOUND * 2.0,
                    format!("point {point}: the bound is reached far from a pole"),
                );
            }
        }
        // The wrong sign.
        let negative: Vec<f64> = values.iter().map(|value| -value).collect();
        let tips = |statuses: &[f64], values: &[f64]| {
            let mut poses = Poses::default();
            model.poses(statuses, values, &[], false, &mut poses).expect("poses");
            poses.positions
        };
        let Ok((flipped, _)) = correct(model, &negative, &programmed, what) else { continue };
        let goal = tips(&programmed, &model.info().nominal);
        let flipped = tips(&flipped, &values);
        let off = flipped
            .iter()
            .zip(&goal)
            .map(|(tip, goal)| tip.iter().zip(goal).map(|(tip, goal)| (tip - goal).powi(2)).sum::<f64>().sqrt());
        let off = off.fold(0.0, f64::max);
        law(
            off > 1.5 * found.tip_before.max,
            format!("{name}: the wrong sign leaves {off} mm of {} mm", found.tip_before.max),
        );
    }
    (wrong, spanned, bounded)
}

/// Runs `count` cases.
pub fn run(seed: u64, count: u64) -> Report {
    let numbers: Vec<u64> = (0..count).collect();
    let cases = in_parallel(&numbers, None, |&number| case(seed, number));
    let (spanned, bounded) = cases.iter().fold((0, 0), |sum, (_, spanned, bounded)| (sum.0 + spanned, sum.1 + bounded));
    let mut broken: Vec<String> = (cases.iter().enumerate().filter(|(_, (wrong, ..))| !wrong.is_empty()))
        .map(|(number, (wrong, ..))| {
            format!("{number}: {}", wrong.iter().take(3).cloned().collect::<Vec<_>>().join("; "))
        })
        .collect();
    if spanned == 0 || bounded == 0 {
        broken.push("no point had both tilts, or none met the bound".to_owned());
    }
    let mut text = format!(
        "{count} machines, seed {seed}, {} set-points; both tilts in {spanned}, bound in {bounded}: {} broken\n",
        2 * count * POINTS as u64,
        broken.len()
    );
    broken.iter().for_each(|line| text.push_str(&format!("  {line}\n")));
    Report { text, broken }
}
