//! What a parameter does at the tool, as a formula, with numbers at a stand of the machine.

use std::fmt::Write;

use abbe_core::{AxisKind, KinematicModel, ParameterRole, Quantity, Result, StatusRole};

use crate::effects::{Effect, Stand, digits, norm, vector};
use crate::table::plain;

/// Commands at which functions are looked at, over a range.
const SAMPLES: usize = 9;

/// Range of a linear and of a rotary axis that is not known: mm, rad.
const RANGES: [f64; 2] = [500.0, std::f64::consts::PI];

/// Formula, and what ten units of the error do.
pub fn text(model: &dyn KinematicModel, parameter: usize, stand: &Stand, effect: &Effect) -> Result<String> {
    let own = &model.info().parameters[parameter];
    let function = Function::of(model, parameter, stand)?;
    let (name, is_angle) = (own.name.trim_end_matches("[0]"), norm(effect.turn) > 1e-15);
    let (size, factor) = (effect.size(), function.factor());
    if size == 0.0 {
        let why = match own.role {
            ParameterRole::Shape | ParameterRole::Factor => "it changes what other errors do, and is nothing by itself",
            ParameterRole::Probe { .. } => "it changes where a touch triggers, and not where the tip is",
            _ if function.text.is_empty() => "the tip stays where it is",
            _ => "at this stand it is zero",
        };
        let follows =
            if function.text.is_empty() { String::new() } else { format!(", its function is {}", function.text) };
        return Ok(format!("\n  {name}: no effect here ({why}){follows}\n"));
    }
    let sign = if function.value < 0.0 { -1.0 } else { 1.0 };
    let mut text = String::new();
    let line = match is_angle {
        true => {
            let turn = effect.turn.map(|part| sign * part / size);
            let foot = foot(stand.tip, effect);
            format!("tip moves by {name}{factor} {} × (p - {}) mm", direction(turn), vector(foot))
        }
        false => format!("tip moves by {name}{factor} {}", direction(effect.shift.map(|part| sign * part / size))),
    };
    let _ = writeln!(text, "\n  {line}");
    if is_angle {
        text.push_str("    p is the tip, the point is the nearest one of the line about which it turns here; ");
    } else {
        text.push_str("    ");
    }
    text.push_str("seen from the workpiece, x, y, z of the table\n");
    function.samples.iter().for_each(|line| text.push_str(&format!("    {line}\n")));
    let ten = if is_angle { 1e-5 } else { 1e-2 };
    let scale = sign * ten / size;
    let shift = effect.shift.map(|part| part * scale * 1e3);
    let unit = if is_angle { "µrad" } else { "µm" };
    let _ = writeln!(text, "    at {}:", stand.text(model.info()));
    let _ = write!(text, "    10 {unit} of it move the tip by {} µm, {} µm in all", vector(shift), digits(norm(shift)));
    if is_angle {
        let _ = write!(text, ", and turn the tool by {} µrad", vector(effect.turn.map(|part| part * scale * 1e6)));
    }
    if own.unit.per.is_some() || own.unit.and_per.is_some() {
        let (people, factor) = own.unit.for_people();
        let _ = write!(text, "; 10 {unit} here are {name} = {} {people}", plain(scale.abs() * factor));
    }
    text.push_str(".\n");
    Ok(text)
}

/// The point nearest to the tip of the line about which an error turns.
pub fn foot(tip: [f64; 3], effect: &Effect) -> [f64; 3] {
    let ([a, b, c], [x, y, z]) = (effect.turn, effect.shift);
    let across = [b * z - c * y, c * x - a * z, a * y - b * x];
    let square = norm(effect.turn).powi(2);
    [0, 1, 2].map(|part| tip[part] + across[part] / square)
}

/// A unit vector by its letter if it has one.
fn direction(unit: [f64; 3]) -> String {
    match (0..3).find(|part| unit[*part].abs() > 1.0 - 1e-9) {
        Some(part) => format!("{}{}", if unit[part] < 0.0 { "-" } else { "" }, ["x", "y", "z"][part]),
        None => vector(unit),
    }
}

/// What an error is per unit of its parameter: a function of the status.
struct Function {
    /// As a formula; empty if it is 1 everywhere.
    text: String,
    /// Its value at the stand.
    value: f64,
    /// Values, where there is no formula, and what the letters are.
    samples: Vec<String>,
}

impl Function {
    fn factor(&self) -> String {
        if self.text.is_empty() { " ·".to_owned() } else { format!(" · {} ·", self.text) }
    }

    /// Finds it by what the model says at other values of its status.
    fn of(model: &dyn KinematicModel, parameter: usize, stand: &Stand) -> Result<Self> {
        let info = model.info();
        let value = value(model, parameter, stand)?;
        let (mut commands, mut others, mut samples) = (Vec::new(), Vec::new(), Vec::new());
        for (column, status) in info.status.iter().enumerate() {
            let tried: Vec<f64> = match status.role {
                StatusRole::Command(axis) => range(info.axes[axis].range, info.axes[axis].kind),
                StatusRole::Direction(_) => vec![1.0, -1.0],
                _ if status.quantity == Quantity::Label => (0..status.levels.len()).map(|level| level as f64).collect(),
                _ => vec![0.0, 1.0, 100.0],
            };
            let mut values = Vec::new();
            for tried in &tried {
                // Functions end where their range does.
                if let Ok(there) = stand.with(model, column, *tried) {
                    values.push((*tried, self::value(model, parameter, &there)?));
                }
            }
            let changes = values.iter().any(|(_, other)| (other - value).abs() > 1e-12 * value.abs().max(1e-3));
            match &status.role {
                _ if !changes => {}
                StatusRole::Command(axis) => commands.push((*axis, values)),
                StatusRole::Direction(axis) => {
                    others.push(format!("dir({})", info.axes[*axis].name));
                    samples.push("dir is +1 after a positive approach and -1 after a negative one: the error is half the lost motion".to_owned());
                }
                _ => others.push(status.name.clone()),
            }
        }
        let mut text = others;
        match commands.as_slice() {
            [] => {}
            [(axis, values)] if text.is_empty() => {
                let own = &info.axes[*axis];
                match form(&own.name, values) {
                    Some(form) => text.push(form),
                    None => {
                        text.push(format!("f({})", own.name));
                        let (factor, unit) =
                            if own.kind == AxisKind::Rotary { (1f64.to_degrees(), "°") } else { (1.0, " mm") };
                        let each = values
                            .iter()
                            .step_by(2)
                            .map(|(at, f)| format!("{} at {}{unit}", short(*f), plain((at * factor).round())));
                        samples.push(format!("f is {}", each.collect::<Vec<_>>().join(", ")));
                    }
                }
            }
            several => {
                let names: Vec<String> =
                    several.iter().map(|(axis, _)| info.axes[*axis].name.clone()).chain(text.drain(..)).collect();
                text.push(format!("f({})", names.join(", ")));
                samples.push(format!("f is {} at this stand", short(value)));
            }
        }
        Ok(Self { text: text.join(" "), value, samples })
    }
}

fn short(value: f64) -> String {
    if value != 0.0 && !(1e-2..1e4).contains(&value.abs()) { format!("{value:.2e}") } else { digits(value) }
}

/// The function of a parameter at a stand: for an error motion with its sign, else its size.
fn value(model: &dyn KinematicModel, parameter: usize, stand: &Stand) -> Result<f64> {
    let info = model.info();
    if let ParameterRole::Motion { axis, component } = info.parameters[parameter].role {
        let own = info.error_functions.iter().find(|function| (function.axis, function.component) == (axis, component));
        if let Some(own) = own {
            let found = model.motion_error(own, &info.without_errors(), &stand.status)?;
            let derivative = found.derivatives.iter().find(|(index, _)| *index == parameter);
            return Ok(derivative.map_or(0.0, |(_, value)| *value));
        }
    }
    Ok(stand.effects(model, &[parameter])?[0].size())
}

/// Commands over the range of an axis.
fn range(known: Option<[f64; 2]>, kind: AxisKind) -> Vec<f64> {
    let most = RANGES[usize::from(kind == AxisKind::Rotary)];
    let [from, to] = known.unwrap_or([-most, most]);
    (0..SAMPLES).map(|step| from + (to - from) * step as f64 / (SAMPLES - 1) as f64).collect()
}

/// A power, cosine or sine of the command that has these values.
fn form(axis: &str, values: &[(f64, f64)]) -> Option<String> {
    let largest = values.iter().fold(0.0_f64, |most, (_, value)| most.max(value.abs()));
    let is = |function: &dyn Fn(f64) -> f64| {
        values.len() >= SAMPLES && values.iter().all(|(at, value)| (function(*at) - value).abs() <= 1e-9 * largest)
    };
    let powers = (1..=9).find(|power| is(&|at: f64| at.powi(*power)));
    if let Some(power) = powers {
        return Some(if power == 1 { axis.to_owned() } else { format!("{axis}^{power}") });
    }
    (1..=36).find_map(|order| {
        let times = if order == 1 { String::new() } else { format!("{order} ") };
        let of = f64::from(order);
        if is(&|at: f64| (of * at).cos()) {
            Some(format!("cos({times}{axis})"))
        } else if is(&|at: f64| (of * at).sin()) {
            Some(format!("sin({times}{axis})"))
        } else {
            None
        }
    })
}
