//! What each error does at the tip: a table of small arrows.

use abbe_core::{ParameterRole, Registry, Result};
use abbe_engine::{Described, Standing};
use serde_json::json;

use super::draw::{COLOURS, Drawing, GREY, SIDES, seen};
use super::{EDGE, WIDTH, heading, side};
use crate::effects::{Effect, Stand, digits, norm, with_errors};

/// Height of a row.
const HIGH: f64 = 92.0;

/// Width of the names of axes.
const NAMES: f64 = 46.0;

/// Length of the longest arrow.
const ARROW: f64 = 36.0;

/// An error, and what 10 µm or 10 µrad of it do: µm, µrad.
struct Shown {
    symbol: String,
    axis: usize,
    column: usize,
    shift: [f64; 3],
    turn: [f64; 3],
    independent: bool,
}

/// Draws the table; gives where it ends. Nothing for a model without a list of errors.
pub fn draw(drawing: &mut Drawing, machine: &Described, stand: &Stand, registry: &Registry, above: f64) -> Result<f64> {
    let all = json!([{ "location": ["E?0*"] }, { "polynomial": ["E??*"], "degrees": [0] }]);
    let Some(every) = with_errors(machine, &all, registry)? else { return Ok(above) };
    let shown = shown(machine, &every, stand)?;
    heading(drawing, above + 30.0, "What 10 µm or 10 µrad of each error do at the tip");
    let note = "Arrows: how the tip moves as seen from the workpiece, in µm along x, y, z of the table; lengths as square roots. \
                Bold: independent location errors of this chain; grey: others, which these or the set-up replace. A ring: nothing moves.";
    for (line, text) in crate::lines::rows(note, 190).iter().enumerate() {
        drawing.text(
            [EDGE, above + 50.0 + 15.0 * line as f64],
            text.trim(),
            "start",
            &format!("fill=\"{GREY}\" font-size=\"11\""),
        );
    }
    let top = above + 88.0;
    let wide = (WIDTH - 2.0 * EDGE - NAMES) / 12.0;
    for (group, title) in ["Location errors", "Error motions"].into_iter().enumerate() {
        let middle = EDGE + NAMES + wide * (6.0 * group as f64 + 3.0);
        drawing.text([middle, top], title, "middle", "font-weight=\"bold\"");
    }
    let axes = &machine.model.info().axes;
    let longest = shown.iter().map(|error| norm(error.shift)).fold(0.0, f64::max);
    for (row, axis) in axes.iter().enumerate() {
        let middle = top + 10.0 + HIGH * (row as f64 + 0.5);
        drawing.text(
            [EDGE, middle + 5.0],
            &axis.name,
            "start",
            &format!("font-size=\"16\" font-weight=\"bold\" fill=\"{}\"", side(axis)),
        );
    }
    for error in &shown {
        let corner = [EDGE + NAMES + wide * error.column as f64, top + 10.0 + HIGH * error.axis as f64];
        cell(drawing, error, corner, wide, longest);
    }
    Ok(top + 10.0 + HIGH * axes.len() as f64)
}

/// All errors of a machine and what they do.
fn shown(machine: &Described, every: &Described, stand: &Stand) -> Result<Vec<Shown>> {
    let info = every.model.info();
    let indices: Vec<usize> = (0..info.parameters.len()).collect();
    let effects = stand.in_model(every.model.as_ref())?.effects(every.model.as_ref(), &indices)?;
    let mut all = Vec::new();
    for (parameter, effect) in info.parameters.iter().zip(&effects) {
        let (axis, component, column) = match parameter.role {
            ParameterRole::Location { axis, component } => (axis, component, component),
            ParameterRole::Motion { axis, component } => (axis, component, 6 + component),
            _ => continue,
        };
        let Effect { shift, turn } = *effect;
        let ten = if component < 3 { 1e-2 } else { 1e-5 };
        let standing = machine.locations.as_ref().and_then(|locations| locations.get(&parameter.name));
        all.push(Shown {
            symbol: parameter.name.trim_end_matches("[0]").to_owned(),
            axis,
            column,
            shift: shift.map(|part| part * ten * 1e3),
            turn: turn.map(|part| part * ten * 1e6),
            independent: column >= 6
                || standing.is_some_and(|error| matches!(error.standing, Standing::Independent { .. })),
        });
    }
    Ok(all)
}

fn cell(drawing: &mut Drawing, error: &Shown, corner: [f64; 2], wide: f64, longest: f64) {
    let Shown { symbol, column, shift, turn, independent, .. } = error;
    let told = |of: [f64; 3]| of.map(digits).join(", ");
    let title = format!("{symbol}: tip ({}) µm, tool turned by ({}) µrad", told(*shift), told(*turn));
    drawing.group(&title, |drawing| {
        let edge = if *column >= 6 { "#dfe3e8" } else { "#eadfc9" };
        drawing.area_of(
            [corner[0] + 1.0, corner[1] + 1.0],
            [wide - 2.0, HIGH - 2.0],
            if *independent { "white" } else { "#f6f6f6" },
            edge,
        );
        let (colour, weight) = if *independent { ("#111111", "bold") } else { (GREY, "normal") };
        drawing.text(
            [corner[0] + 6.0, corner[1] + 14.0],
            symbol,
            "start",
            &format!("fill=\"{colour}\" font-weight=\"{weight}\" font-size=\"11\""),
        );
        let size = norm(*shift);
        let centre = [corner[0] + wide / 2.0, corner[1] + HIGH / 2.0 + 1.0];
        let small = |colour: &str| format!("font-size=\"9\" fill=\"{colour}\"");
        if size < 1e-9 {
            ring(drawing, centre);
        } else {
            // Square roots, so that what is a tenth of the longest is still seen.
            let long = ARROW * (size / longest.max(1e-12)).sqrt() / size;
            let on_page = seen(shift.map(|part| part * long));
            let own = if *independent { main_colour(*shift) } else { GREY };
            drawing.arrow(
                [centre[0] - on_page[0] / 2.0, centre[1] - on_page[1] / 2.0],
                [centre[0] + on_page[0] / 2.0, centre[1] + on_page[1] / 2.0],
                own,
                2.0,
            );
        }
        let text = match (size < 1e-9, norm(*turn) > 1e-9) {
            (true, true) => "turns the tool only".to_owned(),
            (true, false) => "nothing".to_owned(),
            _ => parts(*shift),
        };
        drawing.text(
            [corner[0] + wide / 2.0, corner[1] + HIGH - 8.0],
            &text,
            "middle",
            &small(if *independent { "#333333" } else { GREY }),
        );
    });
}

fn ring(drawing: &mut Drawing, centre: [f64; 2]) {
    drawing.dot(centre, 4.0, GREY);
    drawing.dot(centre, 2.6, "white");
}

/// The parts along x, y, z that are not zero: `x +2.5 z -1`.
fn parts(shift: [f64; 3]) -> String {
    let largest = norm(shift);
    let each = (0..3).filter(|part| shift[*part].abs() > 1e-3 * largest && digits(shift[*part]) != "0");
    let each = each.map(|part| {
        format!("{} {}{}", ["x", "y", "z"][part], if shift[part] > 0.0 { "+" } else { "" }, digits(shift[part]))
    });
    each.collect::<Vec<_>>().join(" ")
}

/// The colour of the direction that a vector has most of.
fn main_colour(shift: [f64; 3]) -> &'static str {
    let most = (0..3).max_by(|a, b| shift[*a].abs().total_cmp(&shift[*b].abs()));
    most.map_or(SIDES[0], |part| COLOURS[part])
}
