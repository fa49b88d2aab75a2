//! The text of a component: its frame, and the code of its form.

use abbe_compensation::{Correct, Settings as Correction};
use abbe_core::{AxisKind, Error, KinematicModel, Result};

use crate::joints::Joint;
use crate::table::Table;

const COMPONENT: &str = include_str!("component.c");
const SOLVER: &str = include_str!("solver.c");
const INTERPOLATION: &str = include_str!("table.c");

/// A component with this code for `abbe_joints`.
pub fn component(name: &str, title: &str, joints: &[Joint], code: &str) -> String {
    let fields = |of: &dyn Fn((usize, &Joint)) -> String, between: &str| {
        joints.iter().enumerate().map(of).collect::<Vec<_>>().join(between)
    };
    let letters: Vec<&str> = joints.iter().map(|joint| joint.letter).collect();
    COMPONENT
        .replace("@NAME@", name)
        .replace("@TITLE@", title)
        .replace("@LETTERS@", &letters.join(" "))
        .replace("@JOINTS@", &joints.len().to_string())
        .replace("@READ@", &fields(&|(_, joint)| format!("world->{}", joint.field), ", "))
        .replace(
            "@WRITE@",
            &fields(&|(index, joint)| format!("world->{} = command[{index}];", joint.field), "\n            "),
        )
        .replace("@CODE@", code)
}

/// The exact kinematics of the machine, and a solver.
pub fn model(model: &dyn KinematicModel, values: &[f64], joints: &[Joint], correction: &Correction) -> Result<String> {
    let of_kind = |kind| joints.iter().filter(move |joint| joint.kind == kind).collect::<Vec<_>>();
    let linear = of_kind(AxisKind::Linear);
    let rotary = if correction.correct == Correct::FiveAxes { of_kind(AxisKind::Rotary) } else { Vec::new() };
    let help = "`form: table` can";
    if linear.len() != 3 || rotary.len() > 2 {
        let message = format!("the solver cannot correct {} linear and {} rotary axes", linear.len(), rotary.len());
        return Err(Error::usage(message).help("it needs three linear axes, and corrects up to two rotary ones"));
    }
    let is_plain = correction.weights.is_none() && correction.sensitive_direction.is_none();
    if matches!(correction.correct, Correct::Axes(_)) || !is_plain || correction.method != Default::default() {
        let message = "the solver in C corrects all components of the tip exactly, with all linear axes";
        return Err(Error::usage(message).help(help).setting("correction"));
    }
    let nominal = &model.info().nominal;
    let poses = model
        .poses_in_c(&[("abbe_nominal", nominal), ("abbe_machine", values)])
        .map_err(|error| if error.help.is_some() { error } else { error.help(help) })?;
    let indices = |of: &[&Joint]| of.iter().map(|joint| joint.axis.to_string()).collect::<Vec<_>>().join(", ");
    let all: Vec<&Joint> = joints.iter().collect();
    let units: Vec<String> = joints.iter().map(|joint| format!("{:e}", joint.factor)).collect();
    let mut text = format!(
        "#define ABBE_AXES {}\n#define ABBE_ROTARY {}\n#define ABBE_BOUND {:e}\n\n",
        model.info().axes.len(),
        rotary.len(),
        correction.largest_rotary_correction_mrad * 1e-3
    );
    text.push_str(&format!(
        "/* Axis of each joint, and how many of its unit make one of the model (mm, rad). */\n\
         static const int abbe_axis[] = {{{}}};\nstatic const double abbe_unit[] = {{{}}};\n\
         static const int abbe_linear[] = {{{}}};\n",
        indices(&all),
        units.join(", "),
        indices(&linear)
    ));
    if !rotary.is_empty() {
        text.push_str(&format!("static const int abbe_rotary[] = {{{}}};\n", indices(&rotary)));
    }
    Ok(format!("{text}\n{poses}\n{SOLVER}"))
}

/// Corrections on a grid, and their interpolation.
pub fn table(table: &Table, joints: &[Joint]) -> String {
    let numbers = |list: &[f64]| list.iter().map(|x| format!("{:.9}", x + 0.0)).collect::<Vec<_>>().join(", ");
    let mut text = String::new();
    for (joint, places) in joints.iter().zip(&table.places) {
        let letter = joint.letter.to_lowercase();
        text.push_str(&format!("static const double abbe_place_{letter}[] = {{{}}};\n", numbers(places)));
    }
    let names: Vec<String> = joints.iter().map(|joint| format!("abbe_place_{}", joint.letter.to_lowercase())).collect();
    let counts: Vec<String> = table.places.iter().map(|places| places.len().to_string()).collect();
    let rows: Vec<String> =
        table.corrections.chunks(joints.len()).map(|row| format!("    {{{}}}", numbers(row))).collect();
    text.push_str(&format!(
        "static const double *const abbe_place[] = {{{}}};\nstatic const int abbe_count[] = {{{}}};\n\
         /* Corrections of the joints, mm and degrees; the place of the last joint changes fastest. */\n\
         static const double abbe_table[][ABBE_JOINTS] = {{\n{}\n}};\n\n{INTERPOLATION}",
        names.join(", "),
        counts.join(", "),
        rows.join(",\n")
    ));
    text
}
