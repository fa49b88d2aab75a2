//! What parameters are called in ISO 230-1 and in these conventions, from what they are.

use abbe_core::{AxisKind, ModelInfo, Parameter, ParameterRole, ProbeTerm};

const LETTERS: [char; 3] = ['X', 'Y', 'Z'];

/// What a parameter is called: error motions and location errors by their terms in ISO 230-1.
pub fn of(info: &ModelInfo, parameter: &Parameter) -> String {
    match parameter.role {
        ParameterRole::Motion { axis, component } => {
            format!("Error motion (ISO 230-1), {}", motion(info, axis, component))
        }
        ParameterRole::Location { axis, component } => {
            format!("Location error (ISO 230-1), {}", location(info, axis, component))
        }
        ParameterRole::SetUp => set_up(&parameter.name),
        ParameterRole::Shape => {
            "Shape of a function that coefficients multiply, as a wavelength or a time constant".to_owned()
        }
        ParameterRole::Factor => "Factor of errors that are known from elsewhere; 1 if they are as told".to_owned(),
        ParameterRole::Feature => "Place or size of a feature of the artefact".to_owned(),
        ParameterRole::Probe { term, .. } => format!("Effective stylus radius of the probe, {}", probe(term)),
        ParameterRole::Other => "Parameter that only this model knows".to_owned(),
    }
}

/// The frame in which an error of an axis is told.
pub fn frame(info: &ModelInfo, axis: usize, is_motion: bool) -> String {
    let name = &info.axes[axis].name;
    let fixed = info.settings.get("axes").and_then(|axes| axes.get(name)?.get("error_frame")?.as_str())
        == Some("fixed")
        || info.settings.get("error_frame").and_then(|frame| frame.as_str()) == Some("fixed");
    match is_motion && !fixed {
        true => format!("x, y, z of what {name} carries (those of the machine with all axes at zero)"),
        false => format!("x, y, z of what carries {name} (those of the machine with all axes at zero)"),
    }
}

/// Direction of x, y, z that an axis has nearly; none if it is oblique.
fn own(info: &ModelInfo, axis: usize) -> Option<usize> {
    (0..3).find(|part| info.axes[axis].direction[*part].abs() > 0.99)
}

fn motion(info: &ModelInfo, axis: usize, component: usize) -> String {
    let (name, letter) = (&info.axes[axis].name, LETTERS[component % 3]);
    let (is_turn, is_own) = (component >= 3, own(info, axis) == Some(component % 3));
    match (info.axes[axis].kind, is_turn, is_own) {
        (AxisKind::Linear, false, true) => format!("linear positioning of {name}"),
        (AxisKind::Linear, false, false) => format!("straightness of {name} in the direction of {letter}"),
        (AxisKind::Linear, true, true) => format!("roll of {name}"),
        (AxisKind::Linear, true, false) => format!("tilt of {name} about {letter}"),
        (AxisKind::Rotary, true, true) => format!("angular positioning of {name}"),
        (AxisKind::Rotary, true, false) => format!("tilt of {name} about {letter}"),
        (AxisKind::Rotary, false, true) => format!("axial error motion of {name}"),
        (AxisKind::Rotary, false, false) => format!("radial error motion of {name} in the direction of {letter}"),
    }
}

fn location(info: &ModelInfo, axis: usize, component: usize) -> String {
    let (name, letter) = (&info.axes[axis].name, LETTERS[component % 3]);
    let (is_turn, is_own) = (component >= 3, own(info, axis) == Some(component % 3));
    match (info.axes[axis].kind, is_turn, is_own) {
        (AxisKind::Linear, true, false) => format!("orientation of {name} about {letter} (squareness)"),
        (AxisKind::Linear, true, true) => format!("orientation of what {name} carries, about {letter}"),
        (AxisKind::Linear, false, true) => format!("zero position of {name}"),
        (AxisKind::Linear, false, false) => format!("position of what {name} carries, in the direction of {letter}"),
        (AxisKind::Rotary, true, true) => format!("zero position of {name}"),
        (AxisKind::Rotary, true, false) => format!("orientation of the axis average line of {name} about {letter}"),
        (AxisKind::Rotary, false, true) => format!("position of what {name} carries, along its line"),
        (AxisKind::Rotary, false, false) => {
            format!("position of the axis average line of {name} in the direction of {letter}")
        }
    }
}

/// `dzt`, `daw`, `stylus[2].x`, and what follows the time or a temperature: `dzt[t1]`.
fn set_up(name: &str) -> String {
    let (base, follows) = match name.split_once('[') {
        Some((base, rest)) if base.starts_with('d') => {
            (base, format!(", the part [{rest} of it that follows what its bracket names"))
        }
        _ => (name, String::new()),
    };
    let letters: Vec<char> = base.chars().collect();
    let side = match letters.as_slice() {
        ['d', part, 't'] => Some((part, "the tool", "the tool tip")),
        ['d', part, 'w'] => Some((part, "the workpiece", "the workpiece")),
        _ => None,
    };
    match side {
        Some((part @ ('x' | 'y' | 'z'), of, what)) => format!("Set-up, offset of {what} along {part} of {of}{follows}"),
        Some((part, of, _)) => {
            let about = ['x', 'y', 'z'][(*part as usize).saturating_sub('a' as usize).min(2)];
            format!("Set-up, turn of {of} about its {about}{follows}")
        }
        None => "Set-up, a value that is not known before it is measured".to_owned(),
    }
}

fn probe(term: ProbeTerm) -> String {
    match term {
        ProbeTerm::Radius => "the same in all directions".to_owned(),
        ProbeTerm::Delay => "the time from contact to trigger, times the feed".to_owned(),
        ProbeTerm::Cosine { around, along } | ProbeTerm::Sine { around, along } => {
            format!("its part with {around} periods around the tool and power {along} along it")
        }
    }
}
