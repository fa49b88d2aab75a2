//! The exact kinematics of a chain as C code: the same walk along both branches as `abbe_kinematics::Chain`, with the numbers of
//! the machine written into it.

use std::fmt::Write;

use abbe_core::{Absent, AxisKind, Branch, Error, Result, StatusRole};
use abbe_kinematics::ErrorFrame;
use nalgebra::Vector3;

use crate::model::{FunctionBasis, SerialChain, Source};

/// Frames, and how motions and errors move them.
const FRAMES: &str = include_str!("frames.c");

/// The six errors of a slot as expressions.
type Expressions = [String; 6];

impl SerialChain {
    /// One C function for each name and values of the parameters.
    pub(crate) fn in_c(&self, functions: &[(&str, &[f64])]) -> Result<String> {
        if self.first_order {
            let message = "a model with `evaluation: first-order` has no form in C";
            return Err(Error::usage(message).help("its exact kinematics has one"));
        }
        let mut text = FRAMES.to_owned();
        for (name, values) in functions {
            let errors = self.errors_in_c(values)?;
            let _ = write!(text, "\nstatic void {name}(const double *q, double *tip, double *axis)\n{{\n");
            text.push_str("    abbe_frame workpiece = ABBE_BED, tool = ABBE_BED;\n");
            self.branch_in_c(Branch::Workpiece, &errors, &mut text);
            push_errors(&mut text, "workpiece", &errors[self.chain.workpiece_slot()]);
            self.branch_in_c(Branch::Tool, &errors, &mut text);
            push_shift(&mut text, "tool", &self.tips[0]);
            push_errors(&mut text, "tool", &errors[self.chain.tool_slot()]);
            text.push_str("    abbe_seen(&workpiece, &tool, tip, axis);\n}\n");
        }
        Ok(text)
    }

    fn branch_in_c(&self, branch: Branch, errors: &[Expressions], text: &mut String) {
        let frame = if branch == Branch::Tool { "tool" } else { "workpiece" };
        let axes = self.chain.axes().iter().enumerate().filter(|(_, axis)| axis.branch == branch);
        let mut axes: Vec<_> = axes.collect();
        // From the bed outwards.
        if branch == Branch::Workpiece {
            axes.reverse();
        }
        let mut nominal = Vector3::zeros();
        for (index, axis) in axes {
            let _ = writeln!(text, "    /* {} */", axis.name);
            if axis.kind == AxisKind::Rotary {
                push_shift(text, frame, &(axis.point - nominal));
                nominal = axis.point;
            }
            push_errors(text, frame, &errors[self.chain.location_slot(index)]);
            let motion = &errors[self.chain.motion_slot(index)];
            if axis.error_frame == ErrorFrame::Fixed {
                push_errors(text, frame, motion);
            }
            let function = if axis.kind == AxisKind::Rotary { "abbe_turn" } else { "abbe_move" };
            let [x, y, z] = axis.direction.into();
            let _ = writeln!(text, "    {function}(&{frame}, {x:e}, {y:e}, {z:e}, {:e} * q[{index}]);", axis.sense());
            if axis.error_frame == ErrorFrame::Moving {
                push_errors(text, frame, motion);
            }
        }
    }

    /// The errors of every slot.
    fn errors_in_c(&self, values: &[f64]) -> Result<Vec<Expressions>> {
        let mut errors = vec![Expressions::default(); self.chain.slots()];
        for basis in &self.bases {
            let Some(&(first, _)) = basis.coefficients.iter().find(|(parameter, _)| values[*parameter] != 0.0) else {
                continue;
            };
            let functions = self.functions_in_c(basis, values).ok_or_else(|| {
                let name = &self.info.parameters[first].name;
                Error::usage(format!("`{name}` has no form in C, or depends on what a control does not know"))
            })?;
            for (parameter, place) in basis.coefficients.iter().filter(|(parameter, _)| values[*parameter] != 0.0) {
                let sum = &mut errors[place.slot][place.component];
                let joint = if sum.is_empty() { "" } else { " + " };
                let _ = write!(sum, "{joint}({:e}) * {}", values[*parameter], functions[place.function - basis.first]);
            }
        }
        Ok(errors)
    }

    /// The functions of a basis; none if they have no form, or if an argument has no value.
    fn functions_in_c(&self, basis: &FunctionBasis, values: &[f64]) -> Option<Vec<String>> {
        let (mut arguments, mut numbers) = (Vec::new(), Vec::new());
        for source in &basis.arguments {
            let number = match *source {
                Source::Parameter(index) => Some(values[index]),
                Source::Status(index) => match (&self.info.status[index].role, self.info.status[index].absent) {
                    (StatusRole::Command(_), _) => None,
                    (StatusRole::Direction(_), _) => Some(0.0),
                    (_, Absent::Default(value)) if value.is_finite() => Some(value),
                    _ => return None,
                },
            };
            arguments.push(match (number, source) {
                (None, Source::Status(index)) => format!("q[{index}]"),
                (number, _) => format!("({:e})", number.unwrap_or_default()),
            });
            numbers.extend(number);
        }
        if numbers.len() < arguments.len() {
            return basis.functions.in_c(&arguments);
        }
        let mut constants = vec![0.0; basis.count];
        basis.functions.values(&numbers, &mut constants);
        Some(constants.iter().map(|constant| format!("({constant:e})")).collect())
    }
}

fn push_shift(text: &mut String, frame: &str, by: &Vector3<f64>) {
    let _ = writeln!(text, "    abbe_shift(&{frame}, {:e}, {:e}, {:e});", by.x, by.y, by.z);
}

fn push_errors(text: &mut String, frame: &str, errors: &Expressions) {
    if errors.iter().all(String::is_empty) {
        return;
    }
    let lines: Vec<&str> = errors.iter().map(|error| if error.is_empty() { "0.0" } else { error }).collect();
    let _ = writeln!(text, "    abbe_errors(&{frame},\n        {});", lines.join(",\n        "));
}
