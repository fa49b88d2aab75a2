//! `abbe explain`: what a symbol means on a machine, from the model, its roles and the functions of its errors.

use std::fmt::Write;

use abbe_core::{Branch, Error, ModelInfo, Parameter, ParameterRole, Result};
use abbe_engine::{Described, Standing};
use clap::Args;
use serde_json::{Value, json};

use crate::effects::{Stand, with_errors};
use crate::libraries::Libraries;
use crate::lines;
use crate::machine::Machine;

mod formula;
mod names;

pub use formula::foot as foot_of;

/// What is asked.
#[derive(Debug, Args)]
pub struct Explain {
    /// The symbol: an error (EC0B, EXX), a parameter (EAY[2], EXX[b]), or one of the set-up (dzt).
    symbol: String,
    /// The machine: a machine file or a recipe.
    #[arg(long, value_name = "MACHINE.yaml|RECIPE", conflicts_with = "chain")]
    machine: Option<String>,
    /// The machine by its chain, in the notation of ISO 10791-6, as "w C' A' b X Y Z t".
    #[arg(long)]
    chain: Option<String>,
    /// Where axes stand, in mm and degrees, as `X=200,C=90`. Default: linear axes a quarter of their travel beyond its middle.
    #[arg(long, value_name = "AXIS=POSITION,..", value_delimiter = ',', value_parser = position)]
    at: Vec<(String, f64)>,
}

/// Farthest that an axis may stand, mm or degrees.
const FARTHEST: f64 = 1e6;

/// A position of an axis: `X=200`.
pub fn position(text: &str) -> std::result::Result<(String, f64), String> {
    let wrong = || format!("`{text}`: an axis and its position was expected, as `X=200`");
    let (axis, position) = text.split_once('=').ok_or_else(wrong)?;
    let position: f64 = position.trim().parse().map_err(|_| wrong())?;
    match position.abs() <= FARTHEST {
        true => Ok((axis.trim().to_owned(), position)),
        false => Err(format!("`{text}`: a position from -{FARTHEST} to {FARTHEST} mm or degrees was expected")),
    }
}

/// A parameter of a machine that has it.
struct Found {
    /// The machine as it was asked for, or one that has this error, too.
    machine: Described,
    /// Its parameters that are the symbol, by their index.
    parameters: Vec<usize>,
    /// Whether `errors` of the machine lists it.
    listed: bool,
}

impl Explain {
    /// Looks at the machine; gives what to print.
    pub fn run(&self, libraries: &Libraries) -> Result<String> {
        let machine = match (&self.machine, &self.chain) {
            (Some(machine), _) => machine,
            (None, Some(chain)) => chain,
            (None, None) => {
                let error = Error::usage("of which machine: `--machine` or `--chain` is missing");
                return Err(
                    error.help("a symbol means something on a machine only: which axis is it, and what carries it?")
                );
            }
        };
        let machines = Machine::named(machine).described(libraries)?;
        let mut texts = Vec::new();
        for machine in machines {
            let found = found(machine, &self.symbol, libraries)?;
            texts.push(lines::wrapped(&self.told(&found)?, lines::width()));
        }
        Ok(texts.join("\n"))
    }

    fn told(&self, found: &Found) -> Result<String> {
        let model = found.machine.model.as_ref();
        let stand = Stand::new(model, &self.at)?;
        let effects = stand.effects(model, &found.parameters)?;
        let info = model.info();
        let mut text = format!("{}\n", self.symbol);
        let first = &info.parameters[found.parameters[0]];
        let _ = writeln!(text, "  {}", what_it_is(info, first, &self.symbol));
        let carried = carried(info, first);
        let standing = standing(&found.machine, first);
        let _ = writeln!(text, "  {carried}{}{standing}", unlisted(found, first));
        for (&parameter, effect) in found.parameters.iter().zip(&effects) {
            text.push_str(&formula::text(model, parameter, &stand, effect)?);
        }
        Ok(text)
    }
}

/// The machine with the symbol, as `errors` lists it, or as it would.
///
/// Fails for a symbol that the chain does not have, with those that are near.
fn found(machine: Described, symbol: &str, libraries: &Libraries) -> Result<Found> {
    let is_whole = !symbol.contains(['[', ']'])
        || symbol.split_once('[').is_some_and(|(base, rest)| !base.is_empty() && rest.len() > 1 && rest.ends_with(']'));
    if !is_whole {
        let message = format!(
            "`{symbol}` is no symbol: what stands in brackets was expected to be there and to end, as in `EXX[1]`"
        );
        return Err(Error::usage(message));
    }
    let (base, bracket) =
        symbol.split_once('[').map_or((symbol, ""), |(base, rest)| (base, rest.trim_end_matches(']')));
    let of = |machine: &Described| -> Vec<usize> {
        let parameters = machine.model.info().parameters.iter().enumerate();
        let is_it = |name: &str| name == symbol || (bracket.is_empty() && name.split('[').next() == Some(base));
        parameters.filter(|(_, parameter)| is_it(&parameter.name)).map(|(index, _)| index).collect()
    };
    let parameters = of(&machine);
    if !parameters.is_empty() {
        return Ok(Found { machine, parameters, listed: true });
    }
    let registry = libraries.registry(None)?;
    let all = json!([{ "location": ["E?0*"] }, { "polynomial": ["E??*"], "degrees": [0] }]);
    let every = with_errors(&machine, &all, &registry)?;
    let info = every.as_ref().unwrap_or(&machine).model.info();
    let plain_name = |parameter: &Parameter| parameter.name.trim_end_matches("[0]").to_owned();
    let known = info.parameters.iter().find(|parameter| plain_name(parameter) == base);
    let Some(known) = known else { return Err(unknown(&machine, info, symbol)) };
    let Some(declared) = declared(known.role, base, bracket) else {
        let message = format!(
            "`{symbol}` is not listed under `errors` of this machine, and its bracket does not say what it would be"
        );
        return Err(Error::usage(message).help(format!(
            "`abbe explain {base}` says what the error is; [2], [b], [cos1] and [sin1] need not be listed"
        )));
    };
    let with = with_errors(&machine, &json!([declared]), &registry).map_err(|error| {
        let error = Error { setting: Vec::new(), ..error };
        Error { message: format!("`{symbol}` does not exist on this machine: {}", error.message), ..error }
    })?;
    let Some(machine) = with else { return Err(unknown(&machine, info, symbol)) };
    let parameters = of(&machine);
    if parameters.is_empty() {
        return Err(unknown(&machine, machine.model.info(), symbol));
    }
    Ok(Found { machine, parameters, listed: false })
}

/// The line of a machine file that would list a symbol; none if its bracket does not say which family it is of.
fn declared(role: ParameterRole, base: &str, bracket: &str) -> Option<Value> {
    if matches!(role, ParameterRole::Location { .. }) {
        return bracket.is_empty().then(|| json!({ "location": [base] }));
    }
    let number = |prefix: &str| bracket.strip_prefix(prefix).and_then(|rest| rest.parse::<u8>().ok());
    match bracket {
        "" => Some(json!({ "polynomial": [base], "degrees": [0] })),
        "b" => Some(json!({ "backlash": [base] })),
        "lag" => Some(json!({ "lag": [base] })),
        _ => number("")
            .filter(|degree| *degree <= 9)
            .map(|degree| json!({ "polynomial": [base], "degrees": [degree] }))
            .or_else(|| {
                let order = number("cos").or_else(|| number("sin")).filter(|order| *order > 0)?;
                Some(json!({ "fourier": [base], "orders": [order] }))
            }),
    }
}

/// Names that are told as near at most.
const NEAR: usize = 3;

fn unknown(machine: &Described, info: &ModelInfo, symbol: &str) -> Error {
    let own = machine.model.info().parameters.iter().map(|parameter| parameter.name.clone());
    let all = info.parameters.iter().map(|parameter| parameter.name.trim_end_matches("[0]").to_owned());
    let mut known: Vec<String> = own.chain(all).collect();
    known.sort();
    known.dedup();
    let mut near = Vec::new();
    while let Some(name) = abbe_core::nearest(symbol, known.iter().map(String::as_str)).map(str::to_owned) {
        known.retain(|other| *other != name);
        near.push(format!("`{name}`"));
        if near.len() == NEAR {
            break;
        }
    }
    let chain = info.settings.get("chain").and_then(Value::as_str).unwrap_or(&machine.stage);
    let error = Error::usage(format!("`{symbol}` is no error and no parameter of the machine {chain}"));
    match near.as_slice() {
        [] => error.help("`abbe model` lists the errors of a machine"),
        _ => error.help(format!("near are {}; `abbe model` lists all", near.join(", "))),
    }
}

/// The first sentence: what it is, by its name in ISO 230-1, with sign, frame and unit.
fn what_it_is(info: &ModelInfo, parameter: &Parameter, symbol: &str) -> String {
    let unit = parameter.unit.to_string();
    let role = parameter.role;
    let words = names::of(info, parameter);
    match role {
        ParameterRole::Motion { axis, .. } | ParameterRole::Location { axis, .. } => {
            let frame = names::frame(info, axis, matches!(role, ParameterRole::Motion { .. }));
            let of = if symbol.ends_with("[b]") { ", half the difference of both directions of approach" } else { "" };
            format!("{words}{of}: actual minus nominal, in {unit}, in {frame}.")
        }
        _ => format!("{words}, in {unit}."),
    }
}

/// The side of the axis, and the sign that follows from it.
fn carried(info: &ModelInfo, parameter: &Parameter) -> String {
    let (ParameterRole::Motion { axis, .. } | ParameterRole::Location { axis, .. }) = parameter.role else {
        return match parameter.role {
            ParameterRole::SetUp => {
                "It belongs to the set-up and not to the machine: every new set-up has another one.".to_owned()
            }
            _ => "It belongs to all that the machine does, and to no single axis.".to_owned(),
        };
    };
    let axis = &info.axes[axis];
    let name = &axis.name;
    match axis.branch {
        Branch::Tool => format!("{name} carries the tool, which has this deviation as it is"),
        Branch::Workpiece => format!("{name} carries the workpiece, so that the tool seems to go the other way"),
    }
}

fn unlisted(found: &Found, parameter: &Parameter) -> &'static str {
    let of_chain = matches!(parameter.role, ParameterRole::Motion { .. } | ParameterRole::Location { .. });
    match (of_chain, found.listed) {
        (true, true) => "",
        (true, false) => "; `errors` of this machine does not list it",
        _ => "",
    }
}

/// Whether a location error is independent on this chain.
fn standing(machine: &Described, parameter: &Parameter) -> String {
    let of_chain = matches!(parameter.role, ParameterRole::Motion { .. } | ParameterRole::Location { .. });
    let known = machine.locations.as_ref().and_then(|locations| locations.get(&parameter.name));
    match known.map(|error| &error.standing) {
        Some(Standing::Independent { .. }) => {
            "; it is one of the independent location errors of this chain.".to_owned()
        }
        Some(Standing::Dependent(of)) => {
            let names: Vec<&str> = of.iter().map(|(name, _)| name.as_str()).collect();
            format!(
                "; on this chain it does what {} with the set-up.",
                names.join(", ") + if names.len() == 1 { " does" } else { " do" }
            )
        }
        Some(Standing::SetUp) => "; on this chain offsets and turns of workpiece and tool do the same.".to_owned(),
        None if of_chain => ".".to_owned(),
        None => String::new(),
    }
}
