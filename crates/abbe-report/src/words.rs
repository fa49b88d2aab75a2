//! What errors of a machine are, and what to do about them, in words.

use abbe_core::{AxisKind, ModelInfo, ParameterRole};

const LETTERS: [char; 3] = ['X', 'Y', 'Z'];

/// The parameters that are one error to a service engineer: all coefficients of one symbol, its reversal apart.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorGroup {
    /// Its name: the symbol, or the symbol and `[b]`.
    pub name: String,
    /// Indices of its parameters.
    pub parameters: Vec<usize>,
    /// What it is.
    pub role: ParameterRole,
    /// Whether it is lost motion at reversal.
    pub is_reversal: bool,
}

/// The symbol of a parameter, and what stands in its brackets.
pub fn symbol(name: &str) -> (&str, &str) {
    let (symbol, bracket) = name.split_once('[').unwrap_or((name, ""));
    (symbol, bracket.split(']').next().unwrap_or_default())
}

/// The errors of a machine, in the order of its parameters.
pub fn groups(info: &ModelInfo) -> Vec<ErrorGroup> {
    let mut groups: Vec<ErrorGroup> = Vec::new();
    for (index, parameter) in info.parameters.iter().enumerate() {
        if !abbe_volumetric::is_machine_error(parameter.role) {
            continue;
        }
        let (symbol, bracket) = symbol(&parameter.name);
        let is_reversal = bracket == "b";
        let name = if is_reversal { format!("{symbol}[b]") } else { symbol.to_owned() };
        match groups.iter_mut().find(|group| group.name == name) {
            Some(group) => group.parameters.push(index),
            None => groups.push(ErrorGroup { name, parameters: vec![index], role: parameter.role, is_reversal }),
        }
    }
    groups
}

/// 0..3 of the direction that a vector has nearly; none if it is oblique.
fn main_direction(direction: [f64; 3]) -> Option<usize> {
    (0..3).find(|part| direction[*part].abs() > 0.99)
}

/// What an error is, for people who have not read the symbol.
pub fn meaning(info: &ModelInfo, group: &ErrorGroup) -> String {
    let (axis, component, is_location) = match group.role {
        ParameterRole::Motion { axis, component } => (axis, component, false),
        ParameterRole::Location { axis, component } => (axis, component, true),
        _ => return "shape of an error".to_owned(),
    };
    let Some(axis) = info.axes.get(axis) else { return String::new() };
    let (name, own) = (&axis.name, main_direction(axis.direction));
    let (letter, is_turn) = (LETTERS[component % 3], component >= 3);
    let along_own = own == Some(component % 3);
    if group.is_reversal {
        return if along_own && is_turn == (axis.kind == AxisKind::Rotary) {
            format!("lost motion (backlash) of {name} at reversal")
        } else if is_turn {
            format!("tilt of {name} about {letter} at reversal")
        } else {
            format!("shift of {name} along {letter} at reversal")
        };
    }
    match (axis.kind, is_location, is_turn) {
        (AxisKind::Linear, true, true) => format!("{name} out of square, turned about {letter}"),
        (AxisKind::Linear, true, false) => format!("zero of {name} along {letter}"),
        (AxisKind::Rotary, true, true) if along_own => format!("zero angle of {name}"),
        (AxisKind::Rotary, true, true) => format!("direction of the axis of {name}, turned about {letter}"),
        (AxisKind::Rotary, true, false) => format!("position of the axis of {name} along {letter}"),
        (AxisKind::Linear, false, false) if along_own => format!("positioning of {name} (scale)"),
        (AxisKind::Linear, false, false) => format!("straightness of {name} along {letter}"),
        (AxisKind::Linear, false, true) if along_own => format!("roll of {name}"),
        (AxisKind::Linear, false, true) => format!("tilt of {name} about {letter} (pitch or yaw)"),
        (AxisKind::Rotary, false, true) if along_own => format!("angular positioning of {name}"),
        (AxisKind::Rotary, false, true) => format!("wobble of {name} about {letter}"),
        (AxisKind::Rotary, false, false) if along_own => format!("axial motion of {name}"),
        (AxisKind::Rotary, false, false) => format!("radial motion of {name} along {letter}"),
    }
}

/// What one does about an error.
pub fn remedy(info: &ModelInfo, group: &ErrorGroup) -> &'static str {
    let (axis, is_location) = match group.role {
        ParameterRole::Motion { axis, .. } => (axis, false),
        ParameterRole::Location { axis, .. } => (axis, true),
        _ => return "",
    };
    let Some(axis) = info.axes.get(axis) else { return "" };
    match (group.is_reversal, axis.kind, is_location) {
        (true, ..) => {
            "look at nut, bearings and gibs; else enter the whole step in the control's backlash compensation"
        }
        (_, AxisKind::Linear, true) => "align the guideways, or set the control's squareness compensation",
        (_, AxisKind::Rotary, true) => "enter the measured axis in the control's kinematics (pivot) table",
        (_, AxisKind::Linear, false) => "load a compensation table for this axis",
        (_, AxisKind::Rotary, false) => "load a compensation table for this axis; look at bearing and encoder",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use abbe_core::{Axis, Branch, Parameter, Unit};
    use serde_json::Value;

    fn info() -> ModelInfo {
        let axis = |name: &str, kind, direction| Axis {
            name: name.to_owned(),
            kind,
            branch: Branch::Tool,
            sense: 1.0,
            direction,
            range: None,
            indexed: false,
            endless: false,
            status: 0,
        };
        let axes = vec![axis("X", AxisKind::Linear, [1.0, 0.0, 0.0]), axis("C", AxisKind::Rotary, [0.0, 0.0, -1.0])];
        let named = |(name, role): (&str, ParameterRole)| Parameter::new(name, Unit::MM).with_role(role);
        let motion = |axis, component| ParameterRole::Motion { axis, component };
        let location = |axis, component| ParameterRole::Location { axis, component };
        let parameters = [
            ("EXX[1]", motion(0, 0)),
            ("EXX[b]", motion(0, 0)),
            ("EXX[2]", motion(0, 0)),
            ("EYX[2]", motion(0, 1)),
            ("EAX[1]", motion(0, 3)),
            ("EC0X", location(0, 5)),
            ("EX0C", location(1, 0)),
            ("EA0C", location(1, 3)),
            ("ECC[b]", motion(1, 5)),
            ("EZC[1]", motion(1, 2)),
            ("dxt", ParameterRole::SetUp),
        ];
        ModelInfo::new(axes, Vec::new(), parameters.map(named).to_vec(), Value::Null)
    }

    #[test]
    fn errors_have_names_and_remedies() {
        let info = info();
        let told: Vec<String> = groups(&info)
            .iter()
            .map(|group| {
                format!("{} {:?}: {}; {}", group.name, group.parameters, meaning(&info, group), remedy(&info, group))
            })
            .collect();
        insta::assert_snapshot!(told.join("\n"));
    }
}
