//! Corrected NC programs: what an interpreter that shares no code with the corrector, and a virtual machine with errors, make of them.

mod empty;
#[cfg(target_os = "linux")]
mod ended;
pub mod grammar;
pub mod interpreter;
mod klartext;

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_compensation::Settings;
use abbe_controllers::{Coordinates, Dialect, Machine as OfPrograms, Options, Summary, Tools, compensate, table};
use abbe_core::{Result, machine_values};
use abbe_engine::model_of;
use serde_json::json;

use crate::compensation::calibration;
use crate::controls::law::{ByAxis, Machine, uniform};
use crate::support::{abbe, read, registry, root, temporary, write};
use interpreter::{Block, Control, tips, tips_with};

const TOLERANCE: f64 = 1e-3;

/// A machine with another tool.
fn with_tool(machine: &Machine, length: Option<f64>) -> Machine {
    let mut calibration = machine.calibration.clone();
    if let Some(length) = length {
        calibration.model.settings["tool_length_mm"] = json!(length);
    }
    let model = model_of(&calibration, &registry()).expect("a model");
    let values = machine_values(model.as_ref(), &calibration);
    Machine { calibration, model, values }
}

/// The corrected text of a program; `sign` turns the errors that are corrected.
pub fn corrected(machine: &Machine, text: &str, options: &Options, sign: f64) -> Result<(String, Summary)> {
    let build = |length: Option<f64>| {
        let own = with_tool(machine, length);
        let values = own.values.iter().map(|value| value * sign).collect();
        let length = own.calibration.model.settings["tool_length_mm"].as_f64().expect("a length");
        OfPrograms::new(own.model.clone(), values, Settings::default(), length, None)
    };
    let mut out = Vec::new();
    let summary = compensate(&mut text.as_bytes(), &mut out, &build, options)?;
    Ok((String::from_utf8(out).expect("text"), summary))
}

/// The path of the programmed tip, with the directions from which the axes come.
struct Goal {
    tips: Vec<[f64; 3]>,
    /// Of the step that ends at each of them.
    directions: Vec<ByAxis>,
    length: Vec<f64>,
}

fn turned(directions: &mut ByAxis, from: &ByAxis, to: &ByAxis) {
    for (axis, at) in to {
        if (at - from[axis]).abs() > 1e-9 {
            directions.insert(axis.clone(), (at - from[axis]).signum());
        }
    }
}

fn distance(one: [f64; 3], other: [f64; 3]) -> f64 {
    (0..3).map(|axis| (one[axis] - other[axis]).powi(2)).sum::<f64>().sqrt()
}

pub fn from_segment(point: [f64; 3], from: [f64; 3], to: [f64; 3]) -> f64 {
    let along = [0, 1, 2].map(|axis| to[axis] - from[axis]);
    let length: f64 = along.iter().map(|part| part * part).sum();
    let by: f64 = (0..3).map(|axis| along[axis] * (point[axis] - from[axis])).sum();
    let part = if length > 0.0 { (by / length).clamp(0.0, 1.0) } else { 0.0 };
    distance(point, [0, 1, 2].map(|axis| from[axis] + part * along[axis]))
}

/// Runs of blocks in feed between rapid moves.
fn runs(blocks: &[Block]) -> Vec<(Vec<&Block>, Option<&Block>)> {
    let mut found = vec![(Vec::new(), None)];
    for block in blocks {
        let last = found.last_mut().expect("one");
        if block.is_rapid {
            last.1 = Some(block);
            found.push((Vec::new(), None));
        } else {
            last.0.push(block);
        }
    }
    found
}

/// A block that only takes up a reversal: its ends count, because its middle is nowhere in the program.
fn is_small(block: &Block) -> bool {
    block.path.iter().all(|to| block.path[0].iter().all(|(axis, at)| (to[axis] - at).abs() < 0.08))
}

/// How far ahead, mm, of the step of one place that of the next may be.
const AHEAD: f64 = 1.5;

/// The largest distance of the tip of the machine with errors from the programmed path, mm; rapid moves by their ends.
pub fn worst(machine: &Machine, programmed: &[Block], corrected: &[Block]) -> f64 {
    let is_tip = programmed.iter().any(|block| block.is_tip);
    let (programmed, corrected) = (runs(programmed), runs(corrected));
    assert_eq!(programmed.len(), corrected.len(), "rapid moves");
    let mut directions = ByAxis::new();
    let mut found: f64 = 0.0;
    for (own, other) in programmed.iter().zip(&corrected) {
        let goal = goal(machine, &own.0, &mut directions);
        found = found.max(along(machine, &goal, &other.0, is_tip));
        let (Some(rapid), Some(done)) = (own.1, other.1) else { continue };
        for step in rapid.path.windows(2) {
            turned(&mut directions, &step[0], &step[1]);
        }
        if rapid.is_machine {
            continue;
        }
        let nominal = tips(machine, &[(rapid.path[rapid.path.len() - 1].clone(), ByAxis::new())], false)[0];
        let actual = tips(machine, &[(done.path[done.path.len() - 1].clone(), directions.clone())], true)[0];
        found = found.max(distance(nominal, actual));
    }
    found
}

fn goal(machine: &Machine, blocks: &[&Block], directions: &mut ByAxis) -> Goal {
    let (mut points, mut all) = (Vec::new(), Vec::new());
    for block in blocks {
        for (index, at) in block.path.iter().enumerate() {
            if index > 0 {
                turned(directions, &block.path[index - 1], at);
            }
            if index > 0 || points.is_empty() {
                points.push((at.clone(), ByAxis::new()));
                all.push(directions.clone());
            }
        }
    }
    let tips = tips(machine, &points, false);
    let mut length = vec![0.0; tips.len()];
    for index in 1..tips.len() {
        length[index] = length[index - 1] + distance(tips[index], tips[index - 1]);
    }
    Goal { tips, directions: all, length }
}

/// The distance of what is cut from the path: every place of the tip has its step of the path, none before the step of the last place,
/// and of all such assignments the one counts whose largest distance is smallest. (The nearest step of each place alone would go astray
/// where a path comes close to itself.) With bounds, because far assignments are many: the next bound where none is within one.
fn along(machine: &Machine, goal: &Goal, blocks: &[&Block], is_tip: bool) -> f64 {
    let (Some(last), Some(block)) = (goal.tips.last(), blocks.last()) else { return 0.0 };
    let end = (block.path[block.path.len() - 1].clone(), goal.directions[goal.directions.len() - 1].clone());
    let at_end = distance(tips(machine, &[end], true)[0], *last);
    if goal.tips.len() < 2 {
        return at_end;
    }
    let mut bounds = [1.05 * TOLERANCE, 5.0 * TOLERANCE, 50.0 * TOLERANCE, LOST, f64::INFINITY].into_iter();
    bounds.find_map(|bound| assigned(machine, goal, blocks, is_tip, bound)).expect("an assignment").max(at_end)
}

/// The largest distance of the best assignment, if it is at most `bound`.
fn assigned(machine: &Machine, goal: &Goal, blocks: &[&Block], is_tip: bool, bound: f64) -> Option<f64> {
    // The steps of the path at which the last place may be, each with the largest distance up to there.
    let mut reached = vec![(0, 0.0)];
    for block in blocks {
        let first = if is_small(block) { block.path.len() - 1 } else { 0 };
        for position in &block.path[first..] {
            let next = next_reached(&reached, goal, bound, &mut from_step(machine, goal, position, is_tip));
            if next.is_empty() {
                println!("more than {:.3} µm off in line {}, at {position:?}", bound * 1e3, block.line);
                return None;
            }
            reached = next;
        }
    }
    reached.iter().map(|(_, largest)| *largest).min_by(f64::total_cmp)
}

fn next_reached(
    reached: &[(usize, f64)],
    goal: &Goal,
    bound: f64,
    off: &mut dyn FnMut(usize) -> f64,
) -> Vec<(usize, f64)> {
    let mut next = Vec::new();
    let Some(((first, _), (last, _))) = reached.first().zip(reached.last()) else { return next };
    // Whether a place at `step` may follow one at `before`.
    let follows =
        |step: usize, before: usize| step < before + 5 || goal.length[step] - goal.length[before + 1] <= AHEAD;
    let (mut oldest, mut newest) = (0, 0);
    for step in *first..goal.tips.len() - 1 {
        if step > *last && !follows(step, *last) {
            break;
        }
        while newest < reached.len() && reached[newest].0 <= step {
            newest += 1;
        }
        while oldest < newest && !follows(step, reached[oldest].0) {
            oldest += 1;
        }
        let before = reached[oldest..newest].iter().map(|(_, largest)| *largest).fold(f64::INFINITY, f64::min);
        if before.is_finite() {
            let largest = before.max(off(step));
            if largest <= bound {
                next.push((step, largest));
            }
        }
    }
    next
}

/// The distance of the tip at a position from a step of the path, with the directions that the axes have there.
fn from_step<'a>(
    machine: &'a Machine,
    goal: &'a Goal,
    position: &'a ByAxis,
    is_tip: bool,
) -> impl FnMut(usize) -> f64 + 'a {
    let mut known: BTreeMap<String, [f64; 3]> = BTreeMap::new();
    move |step| {
        let off = approaches(goal, step, is_tip).into_iter().map(|directions| {
            let actual = *known
                .entry(format!("{directions:?}"))
                .or_insert_with(|| tips(machine, &[(position.clone(), directions.clone())], true)[0]);
            from_segment(actual, goal.tips[step], goal.tips[step + 1])
        });
        off.fold(f64::INFINITY, f64::min)
    }
}

/// Path, mm, beside a step on which an axis may turn around where the tip is programmed. An axis that begins with the slope zero, as Z
/// does when a head tilts, moves by less than a nanometre there.
const TURNING: f64 = 0.02;

/// The directions that the axes may have in a step of the path. Where the tip is programmed an axis turns around somewhere in the steps
/// beside, and each at a place of its own.
fn approaches(goal: &Goal, step: usize, is_tip: bool) -> Vec<ByAxis> {
    let own = &goal.directions[step + 1];
    let mut found = vec![own.clone()];
    if !is_tip {
        return found;
    }
    let before =
        (0..=step).rev().take_while(|other| *other == step || goal.length[step] - goal.length[*other] <= TURNING);
    let after = (step + 2..goal.directions.len())
        .take_while(|other| *other == step + 2 || goal.length[*other - 1] - goal.length[step + 1] <= TURNING);
    let beside: Vec<&ByAxis> = before.chain(after).map(|other| &goal.directions[other]).collect();
    for (axis, direction) in own {
        if beside.iter().any(|other| other.get(axis).unwrap_or(&1.0) != direction) {
            let turned: Vec<ByAxis> = found
                .iter()
                .cloned()
                .map(|mut other| {
                    other.insert(axis.clone(), -direction);
                    other
                })
                .collect();
            found.extend(turned);
        }
    }
    found
}

fn options(dialect: Dialect) -> Options {
    let mut options = Options::new(dialect);
    let offset: Coordinates = [12.5, -3.25, 40.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    options.offsets.insert(0, offset);
    options.tools.only = Some(95.5);
    options.start = [Some(0.0); 9];
    // From which side axes come after a change of the tool is in no program of plain text.
    options.stays_at_tool_change = dialect == Dialect::Heidenhain;
    options.calibration = "0123456789abcdef".to_owned();
    options
}

fn moved(machine: &Machine, text: &str) -> Vec<Block> {
    let mut control = Control::new(machine);
    control.length = 95.5;
    let offset = [("X", 12.5), ("Y", -3.25), ("Z", 40.0)].map(|(axis, at)| (axis.to_owned(), at));
    control.offsets.insert("G54".to_owned(), offset.into());
    if text.contains("BEGIN PGM") { control.run_klartext(text) } else { control.run(text) }
}

/// The rotary axes of a public machine.
fn rotary(name: &str) -> &'static [&'static str] {
    match name {
        "table-table" => &["A", "C"],
        "head-table" => &["B", "C"],
        _ => &[],
    }
}

/// Distances, mm, that no error makes: where a path comes close to itself, a tip that is far off may belong to another part of it.
const LOST: f64 = 0.3;

/// The law: on the machine with errors the corrected program makes the path that the original makes on the machine without.
fn law(name: &str, dialect: Dialect, tip: bool, seed: u64) {
    let machine = with_tool(&Machine::random(name, seed), Some(95.5));
    let wanted = grammar::Wanted { dialect, rotary: rotary(name), tip, blocks: 25 };
    let text = grammar::program(wanted, seed);
    let options = options(dialect);
    let (done, summary) = corrected(&machine, &text, &options, 1.0)
        .unwrap_or_else(|error| panic!("{name} {dialect:?} {seed}: {error}\n{text}"));
    let programmed = moved(&machine, &text);
    let off = worst(&machine, &programmed, &moved(&machine, &done));
    assert!(off <= TOLERANCE + 2e-5, "{name} {dialect:?} {seed}: {} µm\n{text}\n{done}", off * 1e3);
    assert!(summary.remaining <= TOLERANCE);
    let before = worst(&machine, &programmed, &programmed);
    assert!(before > 5e-3, "{name} {dialect:?} {seed}: {before}");
    let (wrong, _) = corrected(&machine, &text, &options, -1.0).expect("a program");
    let wrong = worst(&machine, &programmed, &moved(&machine, &wrong));
    let is_more = wrong > before || before > LOST;
    assert!(wrong > 10.0 * TOLERANCE && is_more, "{name} {dialect:?} {seed}: {wrong} of {before}\n{text}");
    // What is no motion stays: every comment is there once.
    assert_eq!(text.matches("as G1 X99 was").count(), done.matches("as G1 X99 was").count());
}

/// First seed and number of seeds: `ABBE_SEEDS="100 5000"` for more.
fn seeds(usual: u64) -> std::ops::Range<u64> {
    let asked = std::env::var("ABBE_SEEDS").unwrap_or_default();
    let mut numbers = asked.split_whitespace().filter_map(|number| number.parse::<u64>().ok());
    let (count, first) = (numbers.next().unwrap_or(usual), numbers.next().unwrap_or(1));
    first..first + count
}

#[test]
fn three_axes_make_the_programmed_path() {
    for seed in seeds(1) {
        for dialect in [Dialect::Linuxcnc, Dialect::Iso, Dialect::Fanuc, Dialect::Siemens, Dialect::Grbl] {
            law("three-axis", dialect, false, seed);
        }
    }
}

#[test]
fn five_axes_make_the_programmed_path() {
    for seed in seeds(1) {
        for name in ["table-table", "head-table"] {
            law(name, Dialect::Linuxcnc, false, seed);
            law(name, Dialect::Fanuc, false, seed);
        }
    }
}

#[test]
fn programmed_tips_make_the_programmed_path() {
    for seed in seeds(1) {
        for name in ["table-table", "head-table"] {
            law(name, Dialect::Fanuc, true, seed);
            law(name, Dialect::Siemens, true, seed);
        }
    }
}

#[test]
fn no_errors_leave_every_byte() {
    let machine = Machine::public("three-axis");
    for dialect in [Dialect::Linuxcnc, Dialect::Fanuc, Dialect::Siemens, Dialect::Grbl, Dialect::Heidenhain] {
        let wanted = grammar::Wanted { dialect, rotary: &[], tip: false, blocks: 60 };
        let text = grammar::program(wanted, 7).replace('\n', "\r\n");
        let (done, _) = corrected(&machine, &text, &options(dialect), 0.0).expect("a program");
        assert_eq!(done, text);
    }
}

/// Remainders of rounding are carried: 2,000 relative moves end where they should.
#[test]
fn remainders_do_not_add_up() {
    let machine = with_tool(&Machine::public("three-axis"), Some(95.5));
    let text = format!("G21 G90 G54\nG0 X0 Y0 Z10\nG91\nG1 F100\n{}", "X0.0371 Y-0.0113\n".repeat(2000));
    let mut options = options(Dialect::Linuxcnc);
    (options.decimals, options.tolerance) = (3, 2e-3);
    let (done, _) = corrected(&machine, &text, &options, 1.0).expect("a program");
    let last = |text: &str| moved(&machine, text).pop().expect("a block").path.pop().expect("a position");
    let nominal = tips(&machine, &[(last(&text), ByAxis::new())], false)[0];
    let directions = ByAxis::from([("X".to_owned(), 1.0), ("Y".to_owned(), -1.0), ("Z".to_owned(), 1.0)]);
    let actual = tips(&machine, &[(last(&done), directions)], true)[0];
    assert!(distance(nominal, actual) < 0.9e-3, "{}", distance(nominal, actual));
}

/// The time of a block under G93 is that of its pieces.
#[test]
fn inverse_time_stays() {
    let machine = with_tool(&Machine::public("table-table"), Some(95.5));
    let text = "G21 G90 G54\nG0 X-60 Y-60 Z10 A0 C0\nG93 G1 X60 Y60 A20 C80 F2.5\nX-60 A-20 F4\n";
    let (done, summary) = corrected(&machine, text, &options(Dialect::Linuxcnc), 1.0).expect("a program");
    assert!(summary.blocks > 6, "{done}");
    let minutes =
        |text: &str| moved(&machine, text).iter().filter_map(|block| Some(1.0 / block.inverse_feed?)).sum::<f64>();
    assert!((minutes(&done) / minutes(text) - 1.0).abs() < 1e-3, "{} {}\n{done}", minutes(&done), minutes(text));
}

fn public(name: &str) -> String {
    read(&root().join("tests/programs/public").join(name))
}

fn refused(machine: &Machine, text: &str, options: &Options, line: usize, says: &str) {
    match corrected(machine, text, options, 1.0) {
        Ok((done, _)) => panic!("line {line} is not refused:\n{done}"),
        Err(error) => {
            let place = error.place.clone().unwrap_or_else(|| panic!("no place: {error}"));
            assert_eq!(place.line, Some(line), "{error}");
            assert!(error.to_string().contains(says), "{error}");
            assert!(place.column.is_some() && error.help.is_some(), "{error}");
        }
    }
}

/// The line `keep` of a program, without the other lines of a list.
fn alone(text: &str, keep: usize, others: &[usize]) -> String {
    let lines = text.lines().enumerate();
    lines
        .map(
            |(index, line)| {
                if others.contains(&(index + 1)) && index + 1 != keep { "\n".to_owned() } else { format!("{line}\n") }
            },
        )
        .collect()
}

/// The public programs, line by line.
#[test]
fn public_programs_are_handled_or_refused() {
    let mill = Machine::public("three-axis");
    let table = Machine::public("table-table");
    let head = Machine::public("head-table");

    let mut linuxcnc = Options::new(Dialect::Linuxcnc);
    let arcs = public("linuxcnc-arcs.ngc");
    let ends = [
        (5, [40.0, 0.0, -2.0]),
        (6, [60.0, 20.0, -2.0]),
        (7, [80.0, 40.0, -2.0]),
        (8, [100.0, 60.0, -2.0]),
        (10, [100.0, 80.0, -4.0]),
        (11, [60.0, 80.0, -4.0]),
        (12, [60.0, 60.0, -4.0]),
        (13, [50.0, 50.0, -4.0]),
        (14, [0.0, 0.0, -4.0]),
        (15, [0.0, 0.0, 25.0]),
    ];
    let programmed = Control::new(&mill).run(&arcs);
    for (line, end) in ends {
        let block = programmed.iter().find(|block| block.line == line).expect("a block");
        let at = &block.path[block.path.len() - 1];
        assert!(
            ["X", "Y", "Z"].iter().zip(end).all(|(axis, end)| (at[*axis] - end).abs() < 1e-9),
            "line {line}: {at:?}"
        );
    }
    let (done, summary) = corrected(&mill, &arcs, &linuxcnc, 1.0).expect("it is handled");
    let off = worst(&mill, &programmed, &Control::new(&mill).run(&done));
    assert!(off <= TOLERANCE, "{off}");
    assert!(summary.arcs[0] == 6 && summary.arcs[1] >= 6, "{summary:?}");

    refused(&table, &public("linuxcnc-5axis-g93.ngc"), &linuxcnc, 4, "length of the tool 4");
    linuxcnc.start = [Some(0.0); 9];
    linuxcnc.tools = Tools::read("T4 P4 Z87.5\n", &PathBuf::from("tool.tbl")).expect("a table");
    let text = public("linuxcnc-5axis-g93.ngc");
    let (done, _) = corrected(&table, &text, &linuxcnc, 1.0).expect("it is handled");
    let of_tool = with_tool(&table, Some(87.5));
    let control = || {
        let mut control = Control::new(&of_tool);
        control.tools.insert(4, 87.5);
        control
    };
    let (programmed, found) = (control().run(&text), control().run(&done));
    let off = worst(&of_tool, &programmed[..programmed.len() - 1], &found[..found.len() - 1]);
    assert!(off <= TOLERANCE, "{off}\n{done}");
    assert!(done.contains("\nG53 G0 Z0\n"), "{done}");

    refused(&mill, &public("linuxcnc-o-word.ngc"), &linuxcnc, 2, "`#");
    refused(&mill, &alone(&public("linuxcnc-o-word.ngc"), 4, &[2, 3]), &linuxcnc, 4, "O-word");

    let text = public("linuxcnc-refuse.ngc");
    let lines = [3, 7, 8, 9, 10];
    for (line, says) in [(3, "`G41`"), (7, "`G81`"), (8, "`G38.2`"), (9, "`G33`"), (10, "`G5`")] {
        refused(&mill, &alone(&text, line, &lines), &linuxcnc, line, says);
    }
    let (done, _) = corrected(&mill, &alone(&text, 0, &lines), &linuxcnc, 1.0).expect("inches are handled");
    let off = worst(&mill, &Control::new(&mill).run(&alone(&text, 0, &lines)), &Control::new(&mill).run(&done));
    assert!(off <= TOLERANCE, "{off}\n{done}");

    let mut fanuc = Options::new(Dialect::Fanuc);
    refused(&head, &public("fanuc-tcp.nc"), &fanuc, 5, "length of the tool 2");
    fanuc.tools.only = Some(110.0);
    let text = public("fanuc-tcp.nc");
    let (done, _) = corrected(&head, &text, &fanuc, 1.0).expect("it is handled");
    assert!(done.contains("\nN120 G28 G91 Z0.\n"), "{done}");
    let of_tool = with_tool(&head, Some(110.0));
    let until = |text: &str| {
        let mut control = Control::new(&of_tool);
        control.length = 110.0;
        control.run(text.split("N110 G49").next().expect("text"))
    };
    // The first rapid move is not corrected: Z is not known yet.
    let off = worst(&of_tool, &until(&text)[1..], &until(&done)[1..]);
    assert!(off <= TOLERANCE, "{off}\n{done}");

    let text = public("fanuc-macro.nc");
    refused(&mill, &text, &fanuc, 4, "`#");
    let others: Vec<usize> = (4..=15).collect();
    for (line, says) in [(5, "WHILE"), (6, "X["), (9, "`M98`"), (10, "`G65`"), (11, "`/`"), (12, "`G68`")] {
        refused(&mill, &alone(&text, line, &others), &fanuc, line, says);
    }

    let mut siemens = Options::new(Dialect::Siemens);
    refused(&table, &public("siemens-traori.mpf"), &siemens, 3, "length of the tool");
    siemens.tools.only = Some(105.0);
    let text = public("siemens-traori.mpf");
    let others: Vec<usize> = (10..=14).collect();
    for (line, says) in [(10, "`CIP`"), (11, "`A3`"), (12, "`TRANS`"), (13, "`R1`"), (14, "expected")] {
        refused(&table, &alone(&text, line, &others), &siemens, line, says);
    }
    let text = alone(&text, 0, &others);
    let (done, _) = corrected(&table, &text, &siemens, 1.0).expect("it is handled");
    let of_tool = with_tool(&table, Some(105.0));
    let until = |text: &str| {
        let mut control = Control::new(&of_tool);
        control.length = 105.0;
        control.run(text.split("N150 SUPA").next().expect("text"))
    };
    let off = worst(&of_tool, &until(&text), &until(&done));
    assert!(off <= TOLERANCE, "{off}\n{done}");
    assert!(done.contains("\nN150 SUPA G0 Z0 D0\n"), "{done}");

    let text = public("edge-cases.ngc");
    let lines = [4, 5, 6, 7, 8, 9, 13, 14];
    let mut edge = Options::new(Dialect::Linuxcnc);
    (edge.block_delete, edge.start) = (Some(false), [Some(0.0); 9]);
    for (line, says) in [
        (4, "exponent"),
        (5, "twice"),
        (6, "modal group"),
        (7, "off its circle by 1."),
        (8, "radius"),
        (9, "number"),
        (13, "`G92`"),
        (14, "`A370`"),
    ] {
        refused(&table, &alone(&text, line, &lines), &edge, line, says);
    }
    let text = alone(&text, 0, &lines);
    let (done, _) = corrected(&mill, &text, &edge, 1.0).expect("it is handled");
    let off = worst(&mill, &Control::new(&mill).run(&text), &Control::new(&mill).run(&done));
    assert!(off <= TOLERANCE, "{off}\n{done}");
    assert!(
        done.contains("( a comment with G1 X99 in it )")
            && done.contains("; and X77 here")
            && done.contains("\nG4 P0.5\n")
    );
    edge.block_delete = None;
    refused(&mill, &text, &edge, 11, "--block-delete");
}

/// A program as users correct it: written, refused a second time, checked; a wrong number in it is found.
#[test]
fn users_correct_programs() {
    let folder = temporary();
    let at = folder.path();
    write(&at.join("fit.calibration.json"), &calibration("three-axis").to_string());
    write(&at.join("part.ngc"), &public("linuxcnc-arcs.ngc"));
    let run = |more: &[&str]| abbe(at, &[&["compensate", "fit.calibration.json"], more].concat());
    let done = run(&["part.ngc", "--dialect", "linuxcnc", "--out", "new.ngc", "--check"]);
    assert_eq!(done.status, 0, "{}{}", done.stdout, done.stderr);
    assert!(done.stdout.contains("Remaining along feed moves: 0."), "{}", done.stdout);
    let text = read(&at.join("new.ngc"));
    assert!(text.contains("(abbe compensated: calibration "), "{text}");
    let again = run(&["new.ngc", "--dialect", "linuxcnc", "--out", "newer.ngc"]);
    assert!(again.status == 1 && again.stderr.contains("compensated already"), "{}", again.stderr);
    assert!(!at.join("newer.ngc").exists());
    let taken = run(&["part.ngc", "--dialect", "linuxcnc", "--out", "new.ngc"]);
    assert!(taken.status == 1 && taken.stderr.contains("is there already"), "{}", taken.stderr);
    assert_eq!(read(&at.join("new.ngc")), text);

    // 5 µm in one number of every block in feed, one after the other.
    let mut planted = 0;
    for (index, line) in
        text.lines().enumerate().filter(|(_, line)| line.contains("Y") && !line.contains("G0") && !line.contains('('))
    {
        let place = line.find('Y').expect("it is there") + 1;
        let end = line[place..].find(' ').map_or(line.len(), |end| place + end);
        let number: f64 = line[place..end].parse().expect("a number");
        let wrong = format!("{}{:.4}{}", &line[..place], number + 0.005, &line[end..]);
        let lines: Vec<&str> =
            text.lines().enumerate().map(|(other, line)| if other == index { wrong.as_str() } else { line }).collect();
        let file = format!("wrong-{index}.ngc");
        write(&at.join(&file), &(lines.join("\n") + "\n"));
        let found = run(&["part.ngc", "--dialect", "linuxcnc", "--out", &file, "--check", "--json"]);
        let is_found = found.status == 3 || found.stdout.contains("off its circle");
        assert!(is_found, "{wrong}: {}{}", found.stdout, found.stderr);
        if found.status == 3 {
            let json: serde_json::Value = serde_json::from_str(&found.stdout).expect("JSON");
            let line = json["check"]["path"]["line"].as_u64().expect("a line") as usize;
            assert!(line == index + 1 || line == index + 2, "line {line} for {}: {}", index + 1, found.stdout);
            planted += 1;
        }
        if planted > 5 {
            break;
        }
    }
    assert!(planted > 2, "{planted}");

    // Another calibration, that of the errors with the other sign.
    let mut other = calibration("three-axis");
    for parameter in other["parameters"].as_array_mut().expect("parameters") {
        parameter["value"] = json!(-parameter["value"].as_f64().expect("a number"));
    }
    write(&at.join("other.calibration.json"), &other.to_string());
    let wrong = ["compensate", "other.calibration.json", "part.ngc", "--dialect", "linuxcnc", "--out", "other.ngc"];
    assert_eq!(abbe(at, &wrong).status, 0);
    let found = run(&["part.ngc", "--dialect", "linuxcnc", "--out", "other.ngc", "--check"]);
    assert!(found.status != 0, "{}{}", found.stdout, found.stderr);

    // A refusal writes nothing.
    write(&at.join("bad.ngc"), &public("linuxcnc-refuse.ngc"));
    let bad = run(&["bad.ngc", "--dialect", "linuxcnc", "--out", "bad-new.ngc"]);
    assert!(
        bad.status == 1 && bad.stderr.contains("bad.ngc:3:1") && !at.join("bad-new.ngc").exists(),
        "{}",
        bad.stderr
    );
    let left: Vec<_> = std::fs::read_dir(at)
        .expect("a folder")
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .collect();
    assert!(left.iter().all(|name| name.ends_with(".ngc") || name.ends_with(".json")), "{left:?}");
}

/// The table of the page is that of the code.
#[test]
fn the_page_has_the_table_of_the_code() {
    let page = read(&root().join("docs/programs.md"));
    assert!(page.contains(&table()), "docs/programs.md lacks the table:\n{}", table());
}

/// Nothing that bytes can be makes it panic.
#[test]
fn nonsense_is_refused_or_copied() {
    let machine = Machine::public("three-axis");
    let mut random = uniform(3);
    let pieces = [
        "G1",
        "X",
        "Y1.",
        "-",
        "G2",
        "R5",
        "(",
        ")",
        ";",
        "#1",
        "[",
        "G91",
        "F1",
        "\r",
        " ",
        "G43H1",
        "é",
        "%",
        "/",
        "I1",
        "K",
        "N",
        "=",
        "IC(",
        "\"",
        "G53",
        "1e5",
        ".",
        "L X+5 ",
        "C X+1",
        " DR+",
        "CC X+0",
        "CR ",
        "IY-2 ",
        " R0",
        " FMAX",
        "TOOL CALL",
        " M91",
        "CYCL DEF 7",
        "~",
        "M128",
        "FUNCTION TCPM ",
        "AXIS POS",
    ];
    for _ in 0..400 {
        let text: String = (0..40)
            .map(|index| {
                let piece = pieces[(random() * pieces.len() as f64) as usize % pieces.len()];
                if index % 7 == 6 { format!("{piece}\n") } else { piece.to_owned() }
            })
            .collect();
        for dialect in Dialect::ALL {
            let head = if dialect == Dialect::Heidenhain { "BEGIN PGM A MM\nL X+0 Y+0 Z+0 FMAX" } else { "G0X0Y0Z0" };
            let _ = corrected(&machine, &format!("{head}\n{text}"), &Options::new(dialect), 1.0);
        }
    }
}

/// What a control does between blocks, or takes from its parameters, is not guessed.
#[test]
fn what_a_program_leaves_open_is_told_or_refused() {
    let folder = temporary();
    let at = folder.path();
    write(&at.join("fit.calibration.json"), &calibration("three-axis").to_string());
    let compensate = |dialect: &str, program: &str, more: &[&str]| {
        write(&at.join("part.nc"), program);
        let _ = std::fs::remove_file(at.join("new.nc"));
        let fixed = ["compensate", "fit.calibration.json", "part.nc", "--dialect", dialect, "--out", "new.nc"];
        abbe(at, &[&fixed, more].concat())
    };
    let written = || read(&at.join("new.nc"));
    // After a change of the tool Z may stand anywhere: it is not written until the program names it.
    let change = "G21 G17 G90 G94 G54\nG0 X0. Y0. Z100.\nG43 H1 Z50.\nG1 Z-5. F100\nX50.\nT2 M6\nG0 X-50. Y50.\nG43 H2 Z50.\nG1 Z-5.\nM30\n";
    let zero = ["--tool-length-mm", "120", "--offset", "G54=X0,Y0,Z0"];
    for dialect in ["fanuc", "iso", "linuxcnc"] {
        let found = compensate(dialect, change, &zero);
        assert_eq!(found.status, 0, "{dialect}: {}", found.stderr);
        let text = written();
        let after: Vec<&str> = text.lines().skip_while(|line| !line.contains("M6")).collect();
        assert_eq!(after[1], "G0 X-50. Y50.", "{dialect}: {text}");
        let stays = compensate(dialect, change, &[&zero[..], &["--tool-change", "stays"]].concat());
        assert_eq!(stays.status, 0, "{dialect}: {}", stays.stderr);
        let text = written();
        let after: Vec<&str> = text.lines().skip_while(|line| !line.contains("M6")).collect();
        assert!(after[1].contains('Z'), "{dialect}: {text}");
    }
    let fed = change.replace("G0 X-50. Y50.\nG43 H2 Z50.\n", "G1 X-50. Y50.\n");
    let found = compensate("fanuc", &fed, &zero);
    assert!(found.status == 1 && found.stderr.contains("part.nc:7:"), "{}", found.stderr);
    assert!(!at.join("new.nc").exists());
    // Tool 2 with the length of tool 1.
    write(&at.join("tool.tbl"), "T1 P1 Z120\nT2 P2 Z95\nT12 P12 Z95\n");
    for (called, fits) in [("H1", false), ("H2", true), ("H12", true)] {
        let program = change.replace("H2", called).replace("G21 G17", "T1 M6\nG21 G17");
        let found = compensate("fanuc", &program, &["--tools", "tool.tbl", "--offset", "G54=X0,Y0,Z0"]);
        assert_eq!(found.status, i32::from(!fits), "{called}: {}", found.stderr);
        assert_eq!(
            found.stderr.contains("part.nc:9:") && found.stderr.contains("tool 2 is in the spindle"),
            !fits,
            "{}",
            found.stderr
        );
    }
    // With D1 nobody knows where SUPA leaves the tip: Z is not written until the program names it; with D0 it is known.
    for (edge, is_written) in [("D1", false), ("D0", true)] {
        let parked = format!("G71 G90 G17 G94\nG54\nD1\nG0 X0 Y0 Z50\n{edge}\nSUPA G0 Z200\nG0 X50\nD1\nG0 Z50\nM30\n");
        let found = compensate("siemens", &parked, &zero);
        assert_eq!(found.status, 0, "{}", found.stderr);
        let text = written();
        let after: Vec<&str> = text.lines().skip_while(|line| !line.contains("SUPA")).collect();
        assert_eq!(after[1].contains('Z'), is_written, "{edge}: {text}");
    }
    // Units and absolute numbers.
    let silent = "G0 X0. Y0. Z100.\nG1 X50. F100\nM30\n";
    for (dialect, told) in [("fanuc", 2), ("iso", 2), ("linuxcnc", 1), ("grbl", 0)] {
        let found = compensate(dialect, silent, &[]);
        assert_eq!(found.status, 0, "{}", found.stderr);
        assert_eq!(found.stdout.matches("stands before the first move").count(), told, "{dialect}: {}", found.stdout);
    }
    assert!(!compensate("iso", &format!("G21 G90\n{silent}"), &[]).stdout.contains("stands before"));
    // LinuxCNC keeps G52 where it keeps G92: G92.1 takes both back.
    let shifted = |end: &str| format!("G21 G90\nG0 X0 Y0 Z100\nG52 X100\nG1 X0 F100\n{end}\nG1 X10\nM2\n");
    compensate("linuxcnc", &shifted("G52 X0"), &[]);
    let last = |text: String| text.lines().rev().nth(1).expect("a line").to_owned();
    let by_g52 = last(written());
    for end in ["G92.1", "G92.2"] {
        assert_eq!(compensate("linuxcnc", &shifted(end), &[]).status, 0);
        assert_eq!(last(written()), by_g52, "{end}");
    }
    for (more, said) in [
        (["--tool-length-mm", "-350"], "gauge line"),
        (["--offset", "G54=X100,X-50"], "twice"),
        (["--offset", "G54=A5"], "does not have"),
        (["--start", "X0,Y0,Z0,C5"], "does not have"),
    ] {
        let found = compensate("iso", silent, &more);
        assert!(found.status == 2 && found.stderr.contains(said), "{more:?}: {}", found.stderr);
    }
    // What is no file is refused before it is opened: nobody writes to this pipe.
    let pipe = at.join("pipe.nc");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
    for file in ["pipe.nc", "/dev/zero", "."] {
        let found = abbe(at, &["compensate", "fit.calibration.json", file, "--dialect", "iso", "--out", "other.nc"]);
        assert!(found.status == 2 && found.stderr.contains("cannot be read"), "{file}: {}", found.stderr);
    }
    let found = compensate("fanuc", &silent.replace("M30", "M198 P1\nM30"), &[]);
    assert!(found.status == 1 && found.stderr.contains("part.nc:3:"), "{}", found.stderr);
}

/// What is left of an arc where one axis alone is corrected is told, and pieces of it are not halved for ever.
#[test]
fn an_arc_that_one_axis_cannot_correct_is_refused() {
    let folder = temporary();
    let calibration = root().join("benches/calibrations/three-axis.calibration.json");
    write(&folder.path().join("arc.ngc"), "G21 G90 G17 G94 G54\nG0 X0 Y0 Z0\nG2 I14.4767 J-0.9173 F300\nM2\n");
    let calibration = calibration.to_string_lossy();
    let arguments = ["compensate", &*calibration, "arc.ngc", "--dialect", "linuxcnc", "--out", "out.ngc"];
    let all = abbe(folder.path(), &[&arguments[..], &["--correct", "position"]].concat());
    assert_eq!(all.status, 0, "{}", all.stderr);
    std::fs::remove_file(folder.path().join("out.ngc")).expect("it is there");
    for tolerance in ["0.2", "0.1"] {
        let more = ["--correct", "Z", "--tolerance-um", tolerance, "--decimals", "6"];
        let found = abbe(folder.path(), &[&arguments[..], &more].concat());
        assert!(found.status == 1 && found.stderr.contains("correct all linear axes"), "{}", found.stderr);
        assert!(!folder.path().join("out.ngc").exists());
    }
}

/// A byte order mark, which controls do not read, is left out. A program that ends within a line, with a move, may be cut off.
#[test]
fn the_first_and_the_last_bytes_of_a_program_are_looked_at() {
    let machine = Machine::public("three-axis");
    let part = "G21 G90 G17 G94 G54\nG0 X0. Y0. Z50.\nG1 X10. F100.\n";
    for dialect in [Dialect::Iso, Dialect::Fanuc, Dialect::Linuxcnc, Dialect::Grbl] {
        let options = Options::new(dialect);
        let (plain, summary) = corrected(&machine, &format!("{part}M2\n"), &options, 1.0).expect("a program");
        let (marked, _) = corrected(&machine, &format!("\u{feff}{part}M2\n"), &options, 1.0).expect("a program");
        assert_eq!(marked, plain);
        let is_told = |summary: &Summary| summary.remarks.iter().any(|remark| remark.contains("is the file whole?"));
        assert!(!is_told(&summary));
        for (end, is_open) in [("G1 X12.3", true), ("G1 X12.3\n", false), ("G1 X12.3\nM2", false), ("(the end)", false)]
        {
            let (_, summary) = corrected(&machine, &format!("{part}{end}"), &options, 1.0).expect("a program");
            assert_eq!(is_told(&summary), is_open, "{dialect:?} {end}: {:?}", summary.remarks);
        }
    }
}

/// What stands behind the end of a program, inside a comment or behind `/` moves some controls, and is not passed over.
#[test]
fn what_controls_would_run_is_not_passed_over() {
    let machine = Machine::public("three-axis");
    let part = "G21 G90 G17 G94 G54\nG0 X0. Y0. Z50.\nG1 X10. F100.\n";
    for (dialect, end) in [
        (Dialect::Fanuc, "M30\nO0002\nG1 X50. F100.\nM30\n%\n"),
        (Dialect::Iso, "M2\nG1 X50. F100.\n"),
        (Dialect::Siemens, "M30\nG1 X50. F100.\n"),
        (Dialect::Grbl, "M2\nG1 X50. F100.\nM2\n"),
        (Dialect::Fanuc, "M30\n#1=2\n"),
    ] {
        let head = if dialect == Dialect::Siemens { part.replace("G21", "G71") } else { part.to_owned() };
        let options = Options::new(dialect);
        let line = if end.contains("O0002") { 6 } else { 5 };
        refused(&machine, &format!("{head}{end}"), &options, line, "after the end of the program");
        let quiet = format!("{head}M30\n(the end)\n\n%\n")
            .replace("(the end)", if dialect == Dialect::Siemens { "; the end" } else { "(the end)" });
        corrected(&machine, &quiet, &options, 1.0).unwrap_or_else(|error| panic!("{dialect:?}: {error}"));
    }
    let (done, _) = corrected(&machine, &format!("{part}M2\nG1 X50. F100.\n"), &Options::new(Dialect::Linuxcnc), 1.0)
        .expect("LinuxCNC reads no further");
    assert!(done.ends_with("M2\nG1 X50. F100.\n"), "{done}");
    for dialect in [Dialect::Grbl, Dialect::Linuxcnc, Dialect::Fanuc] {
        for hidden in ["(a note)\rG1 Y300. F500.", "; note\rG1 Y300. F500.", "(note\rG1 Y300. F500.)"] {
            refused(&machine, &format!("{part}{hidden}\nM30\n"), &Options::new(dialect), 4, "carriage return");
        }
    }
    // grbl has no switch for blocks with `/`.
    let optional = format!("{part}/G1 Y20. F100.\nG1 X0.\nM30\n");
    let mut grbl = Options::new(Dialect::Grbl);
    let (done, _) = corrected(&machine, &optional, &grbl, 1.0).expect("it runs");
    assert!(done.lines().any(|line| line.starts_with('/') && line.contains("Y20")), "{done}");
    let programmed = Control::new(&machine).run(&optional);
    let off = worst(&machine, &programmed, &Control::new(&machine).run(&done));
    assert!(off <= TOLERANCE, "{off}");
    grbl.block_delete = Some(true);
    refused(&machine, &optional, &grbl, 4, "whatever a switch says");
}

/// Axes that a code only names, lengths that a change of the tool leaves open, and the shorter way of an axis.
#[test]
fn what_the_control_decides_is_not_guessed() {
    let machine = Machine::public("three-axis");
    let tools = |dialect| {
        let mut options = Options::new(dialect);
        options.tools.by_number.extend([(1, 120.5), (3, 160.5)]);
        options.stays_at_tool_change = true;
        options
    };
    // Fanuc: smoothing and the end of a mirror image name axes.
    let named = |block: &str| format!("G21 G90 G17 G94 G54\nG0 X100. Y100. Z100.\n{block}\nG1 X200. F500.\nM30\n");
    let fanuc = tools(Dialect::Fanuc);
    let plain = corrected(&machine, &named("(none)"), &fanuc, 1.0).expect("a program").0;
    for block in ["G05.1 Q2 X0. Y0. Z0.", "G5.1 Q1", "G50.1 X0. Y0."] {
        let done = corrected(&machine, &named(block), &fanuc, 1.0).unwrap_or_else(|error| panic!("{block}: {error}")).0;
        assert_eq!(done, plain.replace("(none)", block));
    }
    refused(&machine, &named("G1 G50.1 X0. Y0. F500."), &fanuc, 3, "the name of an axis");
    // LinuxCNC: H0 is the tool in the spindle, or tool 0.
    let mut linuxcnc = tools(Dialect::Linuxcnc);
    let called = |words: &str| format!("G21 G90 G17 G54\nT3 M6\n{words}\nG0 X100 Y100 Z100\nM2\n");
    let own = |words: &str, options: &Options| {
        let done = corrected(&machine, &called(words), options, 1.0).unwrap_or_else(|error| panic!("{words}: {error}"));
        done.0.lines().nth(4).expect("a move").to_owned()
    };
    assert_eq!(own("G43 H0", &linuxcnc), own("G43 H3", &linuxcnc));
    assert_ne!(own("G43 H0", &linuxcnc), own("G49", &linuxcnc));
    linuxcnc.tools.by_number.insert(0, 0.0);
    refused(&machine, &called("G43 H0"), &linuxcnc, 3, "or tool 0");
    // A cut with the length of the tool before.
    for dialect in [Dialect::Linuxcnc, Dialect::Fanuc, Dialect::Iso] {
        let changed = |words: &str| {
            format!(
                "G21 G90 G17 G94 G54\nT1 M6\nG43 H1\nG0 X0. Y0. Z100.\nT3 M6\nG0 X50.\n{words}\nG1 X60. F100.\nM30\n"
            )
        };
        refused(&machine, &changed("G0 Y5."), &tools(dialect), 8, "tool 3 is in the spindle");
        for words in ["G0 G43 H3 Z100.", "G0 G49 Z100."] {
            let done = corrected(&machine, &changed(words), &tools(dialect), 1.0);
            done.unwrap_or_else(|error| panic!("{dialect:?} {words}: {error}"));
        }
    }
    // SINUMERIK: which cutting edge acts after M6 without D is a machine datum.
    let siemens = tools(Dialect::Siemens);
    let edges = |first: &str, second: &str| {
        format!("G71 G90 G17 G94 G54\n{first}\nM6\nG0 X100 Y100 Z100\nT3\nM6\n{second}G0 X100 Y100 Z100\nM30\n")
    };
    let done = corrected(&machine, &edges("T1 D1", "D1 "), &siemens, 1.0).expect("a program").0;
    let moves: Vec<&str> = done.lines().filter(|line| line.contains("G0")).collect();
    assert_ne!(moves[0], moves[1].trim_start_matches("D1 "));
    refused(&machine, &edges("T1 D1", ""), &siemens, 7, "no D says");
    refused(&machine, &edges("T1", "D1"), &siemens, 4, "no D says");
    refused(&machine, &edges("T1 D2", "D1"), &siemens, 2, "first cutting edge");
    // In G18 the length of a SINUMERIK acts along Y.
    let planes = |edge: &str| {
        format!("G71 G90 G17 G94 G54\nT1 {edge}\nG0 X0 Y0 Z100\nG18\nG1 X10 F100\nG2 X20 Z90 I0 K-10\nM30\n")
    };
    refused(&machine, &planes("D1"), &siemens, 5, "acts along Y");
    corrected(&machine, &planes("D0"), &siemens, 1.0).unwrap_or_else(|error| panic!("{error}"));
    // What moves beside a dwell would not be seen; on these controls X alone says how long it is.
    let beside = |words: &str| format!("G21 G90 G17 G94 G54\nG0 X0. Y0. Z100.\n{words}\nG1 X5. F100.\nM30\n");
    for dialect in [Dialect::Linuxcnc, Dialect::Grbl, Dialect::Iso, Dialect::Fanuc] {
        let options = Options::new(dialect);
        refused(&machine, &beside("G1 X20. F500. G4 P1"), &options, 3, "beside a dwell");
        refused(&machine, &beside("G4 P1 Z50."), &options, 3, "beside a dwell");
        corrected(&machine, &beside("G4 P1"), &options, 1.0).unwrap_or_else(|error| panic!("{error}"));
        match dialect {
            Dialect::Iso | Dialect::Fanuc => {
                corrected(&machine, &beside("G4 X2."), &options, 1.0).unwrap_or_else(|error| panic!("{error}"));
            }
            _ => refused(&machine, &beside("G4 X2."), &options, 3, "beside a dwell"),
        }
    }
    // Fanuc: an H alone, and what takes the length back on some controls.
    let after = |words: &str| {
        format!(
            "G21 G90 G17 G94 G54\nT1 M6\nG0 G43 H1 Z100.\nG0 X0. Y0.\n{words}\nG0 X5.\nG0 Z90.\nG1 X60. F100.\nM30\n"
        )
    };
    for (words, line, says) in [
        ("G43 Z100.", 5, "without an H"),
        ("H0", 5, "an H alone"),
        ("H3", 5, "an H alone"),
        ("G53 G0 Z200.", 7, "take the length"),
        ("G28 Z150.", 7, "take the length"),
    ] {
        refused(&machine, &after(words), &fanuc, line, says);
        let again = after(&format!("{words}\nG43 H1 Z100."));
        if says == "take the length" {
            corrected(&machine, &again, &fanuc, 1.0).unwrap_or_else(|error| panic!("{words}: {error}"));
        }
    }
    // What G53 does not name stays where it was written: relative moves go on from there.
    for dialect in [Dialect::Linuxcnc, Dialect::Iso, Dialect::Grbl, Dialect::Siemens] {
        let inch = if dialect == Dialect::Siemens { "G71" } else { "G21" };
        for parked in ["G53 G0 Z200.", "G53 G0 X50.", "G53 G0 X50. Y20. Z200."] {
            let text = format!("{inch} G90 G17 G94 G54\nG0 X100. Y90. Z100.\n{parked}\nG91\nG1 X5. F100.\nY5.\nM30\n");
            let mut options = Options::new(dialect);
            options.start = [Some(0.0); 9];
            let (done, _) = corrected(&machine, &text, &options, 1.0).unwrap_or_else(|error| panic!("{error}"));
            let run = |text: &str| Control::new(&machine).run(text);
            let off = worst(&machine, &run(&text), &run(&done));
            assert!(off <= TOLERANCE + 2e-5, "{dialect:?} {parked}: {off}\n{done}");
        }
    }
    // So does a relative rapid move that stays as it is, because it is not known where another axis stands.
    let head = "G21 G90 G17 G94 G54\nG0 X-50 Y-40 Z30\n";
    let options = Options::new(Dialect::Linuxcnc);
    let written = |text: &str| {
        let (done, _) = corrected(&machine, text, &options, 1.0).unwrap_or_else(|error| panic!("{error}"));
        let words: Vec<f64> = (done.split_whitespace())
            .filter_map(|word| word.strip_prefix('X').and_then(|number| number.parse().ok()))
            .collect();
        (words, done)
    };
    let (ways, done) = written(&format!("{head}G91\nG28 Z10\nG0 X10\nG90 G53 G0 Z50\nG91 G0 X10\nM2\n"));
    let (places, _) = written(&format!("{head}G0 Z50\nG0 X-30\nM2\n"));
    let wanted = places[places.len() - 1];
    assert_eq!(ways[1], 10.0, "{done}");
    assert!((wanted + 30.0).abs() > 2e-3 && (ways.iter().sum::<f64>() - wanted).abs() < 2e-4, "{wanted}: {done}");
    // An offset on top of the others, on controls that have one.
    let offset = |place: &str| format!("G21 G90 G17 G94 G54\nG10 L2 {place} X5.\nG0 X0. Y0. Z0.\nM30\n");
    for dialect in [Dialect::Fanuc, Dialect::Iso] {
        refused(&machine, &offset("P0"), &Options::new(dialect), 2, "on top of the others");
    }
    for dialect in [Dialect::Linuxcnc, Dialect::Grbl] {
        let done = |place: &str| corrected(&machine, &offset(place), &Options::new(dialect), 1.0).expect("an offset").0;
        assert_eq!(done("P0"), done("P1").replace(" P1 ", " P0 "));
    }
    // The shorter way of an axis that has ends.
    let table = Machine::public("table-table");
    let turned = |to: &str| format!("G71 G90 G17 G94 G54\nG0 X0 Y0 Z100 A0 C170\nG1 X10 C={to} F100\nM30\n");
    let mut options = Options::new(Dialect::Siemens);
    corrected(&table, &turned("DC(10)"), &options, 1.0).expect("less than half a turn");
    refused(&table, &turned("DC(-170)"), &options, 3, "the shorter way");
    options = Options::new(Dialect::Heidenhain);
    options.tools.only = Some(95.5);
    options.stays_at_tool_change = true;
    let text = |way: &str, to: &str| {
        format!(
            "BEGIN PGM A MM\nTOOL CALL 5 Z S3000\nL X+0 Y+0 Z+50 A+0 C+170 FMAX {way}\nL X+10 C{to} F500\nEND PGM A MM\n"
        )
    };
    refused(&table, &text("M126", "-170"), &options, 4, "the shorter way");
    for (way, to) in [("M126", "+10"), ("M127", "-170"), ("", "-170")] {
        corrected(&table, &text(way, to), &options, 1.0).unwrap_or_else(|error| panic!("{way} {to}: {error}"));
    }
}

/// A block that was made rapid afterwards, and a calibration that was changed after its run, are found.
#[test]
fn what_was_changed_afterwards_is_found() {
    let folder = temporary();
    let at = folder.path();
    write(&at.join("fit.calibration.json"), &calibration("three-axis").to_string());
    write(&at.join("part.ngc"), "G21 G90 G17 G94\nG0 X0 Y0 Z50\nG1 X60 F500\nG1 Y40\nG0 Z80\nM2\n");
    let run = || {
        let fixed = ["compensate", "fit.calibration.json", "part.ngc", "--dialect", "linuxcnc"];
        abbe(at, &[&fixed[..], &["--out", "done.ngc", "--check"]].concat())
    };
    let found = run();
    assert_eq!(found.status, 0, "{}", found.stderr);
    let done = read(&at.join("done.ngc"));
    for (from, to) in [("G1 X", "G0 X"), ("G0 X", "G1 X")] {
        let at_line = done.lines().position(|line| line.starts_with(from)).expect("a block") + 1;
        write(&at.join("done.ngc"), &done.replacen(from, to, 1));
        let found = run();
        assert!(found.status == 1 && found.stderr.contains(&format!("done.ngc:{at_line}")), "{}", found.stderr);
    }
}

/// The mill of the hole plates with its true errors.
fn mill() -> Machine {
    let pipelines = root().join("pipelines");
    let yaml = |file: &str| -> serde_json::Value { serde_yaml::from_str(&read(&pipelines.join(file))).expect("YAML") };
    let mut settings = yaml("mill-hole-plate-exact.yaml")["stages"]["mill"].clone();
    let of_machine = yaml("data/mill-5axis/machine.yaml");
    let settings = settings.as_object_mut().expect("settings");
    settings.extend(of_machine.as_object().expect("a machine").clone());
    settings.retain(|key, _| !["model", "file", "name", "table_frame"].contains(&key.as_str()));
    // The true straightness has its line.
    for line in settings["errors"].as_array_mut().expect("errors") {
        line.as_object_mut().expect("a line").remove("without_line");
    }
    let mut found = calibration("three-axis");
    found["model"]["settings"] = serde_json::Value::Object(settings.clone());
    found["parameters"] = json!([]);
    let machine = Machine::of(&found);
    let truth = &serde_json::from_str::<serde_json::Value>(&read(&root().join("tests/truth/mill-5axis-exact.json")))
        .expect("JSON")["parameters"];
    let known = machine.model.info().parameters.iter().zip(&machine.model.info().nominal);
    let parameters: Vec<serde_json::Value> = known
        .map(|(parameter, nominal)| {
            let value = truth[&parameter.name].as_f64().unwrap_or(*nominal);
            json!({ "name": parameter.name, "value": value, "unit": parameter.unit, "standard_uncertainty": 0, "status": "fixed" })
        })
        .collect();
    let told = truth.as_object().expect("parameters").keys();
    let missing: Vec<&String> = told.filter(|name| !parameters.iter().any(|one| one["name"] == **name)).collect();
    // A constant part of straightness is where the workpiece lies.
    assert!(missing.iter().all(|name| name.ends_with("[0]")) && parameters.len() > 200, "{missing:?}");
    found["parameters"] = json!(parameters);
    Machine::of(&found)
}

/// Plates with holes in three planes of the mill: where the tip goes for a program, on the machine with the true errors.
#[test]
fn holes_are_where_the_program_says() {
    let folder = temporary();
    let at = folder.path();
    let machine = mill();
    write(&at.join("true.calibration.json"), &machine.calibration.to_json().expect("JSON"));
    let (mut before, mut after) = (0.0_f64, 0.0_f64);
    for (plane, stylus, level) in [("xy", 1, 0.0), ("xz", 6, 5.0), ("yz", 7, 6.0)] {
        let table = read(&root().join(format!("pipelines/data/mill-5axis/exact/plate-{plane}.csv")));
        let rows = table.lines().filter(|line| line.starts_with("1,"));
        let holes: Vec<Vec<f64>> =
            rows.map(|row| row.split(',').skip(2).map(|cell| cell.parse().expect("a number")).collect()).collect();
        let hole = |hole: &Vec<f64>| format!("G0 X{:.4} Y{:.4} Z{:.4}\n", hole[0], hole[1], hole[2]);
        let text =
            format!("G21 G90 G17 G94 G54\nG0 X350 Y250 Z300 B0 C0\n{}M2\n", holes.iter().map(hole).collect::<String>());
        write(&at.join("holes.ngc"), &text);
        let _ = std::fs::remove_file(at.join("done.ngc"));
        let fixed = ["compensate", "true.calibration.json", "holes.ngc", "--dialect", "linuxcnc", "--out", "done.ngc"];
        let more =
            [format!("--constant=stylus={stylus}"), "--constant=load_N=0".into(), "--constant=load_z_mm=0".into()];
        let finer = ["--decimals", "6", "--offset", "G54=X0,Y0,Z0", "--check"];
        let all: Vec<&str> = fixed.into_iter().chain(more.iter().map(String::as_str)).chain(finer).collect();
        let found = abbe(at, &all);
        assert_eq!(found.status, 0, "{}", found.stderr);
        let [programmed, done] = [text, read(&at.join("done.ngc"))].map(|text| Control::new(&machine).run(&text));
        let mut directions = ByAxis::new();
        let mut last = programmed[0].path[programmed[0].path.len() - 1].clone();
        for (one, other) in programmed.iter().zip(&done).skip(1) {
            let [nominal, moved] = [one, other].map(|block| block.path[block.path.len() - 1].clone());
            turned(&mut directions, &last, &nominal);
            last.clone_from(&nominal);
            let off = |at: &ByAxis| {
                let tip = |at: &ByAxis, with_errors| {
                    tips_with(&machine, &[(at.clone(), directions.clone())], with_errors, &[("stylus", level)])[0]
                };
                distance(tip(at, true), tip(&nominal, false))
            };
            before = before.max(off(&nominal));
            after = after.max(off(&moved));
        }
        assert!(programmed.len() > 20);
    }
    assert!(before > 0.1 && after < 1e-5, "{} µm before, {} µm after", before * 1e3, after * 1e3);
    // What errors depend on has to be said, with its unit.
    for (more, said) in [
        (vec![], "--constant load_N=0"),
        (vec!["--constant", "load_mm=0"], "wrong unit"),
        (vec!["--constant", "loads_N=0"], "no `loads`"),
        (vec!["--constant", "stylus=9", "--constant", "load_N=0"], "one of 1, 2"),
    ] {
        let _ = std::fs::remove_file(at.join("done.ngc"));
        let fixed = ["compensate", "true.calibration.json", "holes.ngc", "--dialect", "linuxcnc", "--out", "done.ngc"];
        let found = abbe(at, &[&fixed[..], &more].concat());
        assert!(found.status == 2 && found.stderr.contains(said), "{more:?}: {}", found.stderr);
    }
}

/// Programs in the manner of the posts of CAM programs: what they write at the head, around tools and at the end.
#[test]
fn programs_of_posts_are_handled_or_refused() {
    let [mill, head] = ["three-axis", "head-table"].map(|name| with_tool(&Machine::public(name), Some(95.5)));
    let mut handled = 0;
    for (file, dialect, machine, refusal) in [
        ("grbl-wood.nc", Dialect::Grbl, &mill, None),
        ("grbl-router.nc", Dialect::Grbl, &mill, None),
        ("grbl-engraving.nc", Dialect::Grbl, &mill, None),
        ("grbl-vector-drawing.nc", Dialect::Grbl, &mill, None),
        ("linuxcnc-open-cad.ngc", Dialect::Linuxcnc, &mill, None),
        ("linuxcnc-circuit-board.ngc", Dialect::Linuxcnc, &mill, None),
        ("iso-spiral.nc", Dialect::Iso, &mill, None),
        ("fanuc-mill.nc", Dialect::Fanuc, &mill, None),
        ("fanuc-drill.nc", Dialect::Fanuc, &mill, Some((14, "`G81`"))),
        ("siemens-mill.mpf", Dialect::Siemens, &mill, None),
        ("siemens-high-speed.mpf", Dialect::Siemens, &mill, Some((3, "`CYCLE832`"))),
        ("fanuc-five-axes.nc", Dialect::Fanuc, &head, None),
    ] {
        let text = read(&root().join("tests/programs/posts").join(file));
        let mut options = Options::new(dialect);
        options.tools.only = Some(95.5);
        options.stays_at_tool_change = true;
        options.start =
            [0, 1, 2, 3, 4, 5, 6, 7, 8].map(|axis| (axis < 3 || machine.model.info().axes.len() > 3).then_some(0.0));
        if let Some((line, says)) = refusal {
            refused(machine, &text, &options, line, says);
            continue;
        }
        let (done, summary) =
            corrected(machine, &text, &options, 1.0).unwrap_or_else(|error| panic!("{file}: {error}"));
        let run = |text: &str| {
            let mut control = Control::new(machine);
            control.length = 95.5;
            // Reference points stand at zero here.
            let lines: Vec<&str> = text.lines().filter(|line| !line.contains("G28")).collect();
            control.run(&lines.join("\n").replace("SUPA", "G53").replace("T=\"5\"", "T5"))
        };
        let (programmed, found) = (run(&text), run(&done));
        let off = worst(machine, &programmed, &found);
        let before = worst(machine, &programmed, &programmed);
        assert!(off <= TOLERANCE + 2e-5 && before > 3.0 * TOLERANCE, "{file}: {off} of {before}\n{done}");
        assert!(summary.moves > 5, "{file}");
        // What is no motion is there as it was.
        for line in text.lines().filter(|line| !line.contains(['X', 'Y', 'Z'])) {
            assert!(done.contains(line), "{file}: {line}\n{done}");
        }
        handled += 1;
    }
    assert_eq!(handled, 10);
}
