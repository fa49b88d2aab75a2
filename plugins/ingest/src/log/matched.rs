//! From a log and its plan to a data set.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use abbe_core::{Column, ColumnHeader, DataRow, Dataset, Error, Result, RowOrigin, StatedTip, Values};
use schemars::JsonSchema;
use serde::Deserialize;

use super::far::{Away, Bounds, near};
use super::plan::Plan;
use super::record::{Hit, Log, ONCE, Positions, Touch, is_rotary};

/// What becomes of repeats of a touch.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Repeats {
    /// Each is a row, with its number in the column `repeat`.
    #[default]
    Keep,
    /// One row for each touch: the mean of its hits.
    Average,
}

/// What becomes of a log whose program did not come to its end.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Aborted {
    /// It is an error.
    #[default]
    Refuse,
    /// Its touches are taken, and a remark tells how many there are.
    Accept,
}

/// Where the column `time_s` comes from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Time {
    /// From the clock of the control; no column if the log has no clock.
    #[default]
    Log,
    /// From the plan: when each touch was planned to be.
    Plan,
    /// No column.
    None,
}

/// What the settings say of all logs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    pub(crate) repeats: Repeats,
    pub(crate) aborted: Aborted,
    pub(crate) time: Time,
    pub(crate) bounds: Bounds,
    pub(crate) tool_length: Option<f64>,
    pub(crate) stylus_diameter: Option<f64>,
}

/// mm in an inch.
const INCH: f64 = 25.4;

/// Lengths of a tool that are the same one, mm.
const SAME_TOOL: f64 = 1e-3;

/// A data set, and what is to be told of it.
pub(crate) type Told = (Dataset, Vec<String>);

/// The rows of a log, with what the plan says of them.
pub(crate) fn matched(path: &Path, log: &Log, plan: &Plan, wanted: &Wanted) -> Result<Told> {
    let matching = Matching { path, log, plan, wanted };
    matching.same_plan()?;
    matching.same_tool()?;
    let mut remarks = matching.complete()?;
    let rows = matching.rows()?;
    if rows.is_empty() {
        return Err(Error::data("no touch of the log has hit").in_file(path));
    }
    matching.near(&rows)?;
    remarks.extend(matching.missed());
    let rows = match wanted.repeats {
        Repeats::Keep => rows,
        Repeats::Average => averaged(rows),
    };
    Ok((matching.dataset(&rows)?, remarks))
}

/// A hit in mm, rad, s and °C, machine coordinates.
struct Row {
    number: u32,
    repeat: u32,
    line: usize,
    plan: DataRow,
    hit: Hit,
}

struct Matching<'a> {
    path: &'a Path,
    log: &'a Log,
    plan: &'a Plan,
    wanted: &'a Wanted,
}

impl Matching<'_> {
    fn wrong(&self, line: usize, message: impl Into<String>) -> Error {
        Error::data(message).at(self.path, line, None)
    }

    fn plan_name(&self) -> String {
        self.plan.path.display().to_string()
    }

    fn same_plan(&self) -> Result<()> {
        let identity = self.plan.identity();
        match &self.log.plan {
            Some((written, line)) if *written != identity => Err(self
                .wrong(
                    *line,
                    format!("the log belongs to the plan {written}, and `{}` is {identity}", self.plan_name()),
                )
                .help("name the plan under `plan` from which the measuring program was made, unchanged")),
            _ => Ok(()),
        }?;
        match self.log.touches {
            Some(touches) if touches as usize != self.plan.rows.len() => {
                let message =
                    format!("TOUCHES is {touches}, but `{}` has {} touches", self.plan_name(), self.plan.rows.len());
                Err(Error::data(message).in_file(self.path).help("name under `plan` the plan of this log"))
            }
            _ => Ok(()),
        }
    }

    fn same_tool(&self) -> Result<()> {
        let wanted = [
            ("L", "length of the tool", "tool_length_mm", self.wanted.tool_length),
            ("D", "diameter of the stylus tip", "stylus_diameter_mm", self.wanted.stylus_diameter),
        ];
        let written = self.log.tool.map_or([None; 2], |(written, _)| written);
        for ((letter, what, setting, wanted), written) in wanted.into_iter().zip(written) {
            let Some(wanted) = wanted else { continue };
            let line = self.log.tool.map_or(1, |(_, line)| line);
            let Some(written) = written.map(|it| it * self.scale()) else {
                return Err(self
                    .wrong(
                        line,
                        format!(
                            "the header does not say the {what} (TOOL {letter}), which `{setting}` is compared with"
                        ),
                    )
                    .help(format!("leave out `{setting}`, or write TOOL into the header")));
            };
            if (written - wanted).abs() > SAME_TOOL {
                let message = format!("the {what} was {written} mm on the control, and is {wanted} mm in `{setting}`");
                return Err(self
                    .wrong(line, message)
                    .help("which one is right? Positions of a wrong length are off along the tool"));
            }
        }
        Ok(())
    }

    /// The tip of the header; none if it states none.
    fn stated_tip(&self) -> Option<StatedTip> {
        let ([_, diameter], line) = self.log.tool?;
        diameter.map(|diameter| StatedTip { diameter: diameter * self.scale(), file: 0, line })
    }

    /// mm in a unit of length of the log.
    fn scale(&self) -> f64 {
        if self.log.inches == Some(true) { INCH } else { 1.0 }
    }

    /// Whether every touch has its line; what is to be told if not.
    fn complete(&self) -> Result<Vec<String>> {
        let repeats = self.log.repeats.unwrap_or(ONCE);
        let there: BTreeSet<(u32, u32)> = self.log.records.iter().map(|touch| (touch.number, touch.repeat)).collect();
        if let Some(unknown) = self.log.records.iter().find(|touch| !self.plan.rows.contains_key(&touch.number)) {
            let message = format!("`{}` has no touch {}", self.plan_name(), unknown.number);
            return Err(self.wrong(unknown.line, message).help("name under `plan` the plan of this log"));
        }
        let all = self.plan.rows.len() as u64 * u64::from(repeats);
        if self.log.has_ended && there.len() as u64 == all {
            return Ok(Vec::new());
        }
        let message = match self.log.has_ended {
            false => format!(
                "the log has no END: the program was aborted, or the file is cut; {} of {all} touches are there",
                there.len()
            ),
            true => {
                let missing =
                    self.plan.rows.keys().flat_map(|&number| (1..=repeats).map(move |repeat| (number, repeat)));
                let (number, repeat) = missing.into_iter().find(|it| !there.contains(it)).unwrap_or_default();
                format!(
                    "{} of {all} touches stand in the log, and it has an END: lines are lost; the first is touch {number} (repeat {repeat})",
                    there.len()
                )
            }
        };
        match self.wanted.aborted {
            Aborted::Accept => Ok(vec![message]),
            Aborted::Refuse => Err(Error::data(message)
                .in_file(self.path)
                .help("measure again, or write `aborted: accept` to take what is there")),
        }
    }

    /// The hits, converted.
    fn rows(&self) -> Result<Vec<Row>> {
        let mut rows: Vec<Row> = Vec::new();
        let mut clock = f64::NEG_INFINITY;
        let mut first: Option<(&Touch, &Hit)> = None;
        for touch in &self.log.records {
            let (Some(hit), Some(&plan)) = (&touch.hit, self.plan.rows.get(&touch.number)) else { continue };
            let (head, other) = first.get_or_insert((touch, hit));
            let differs =
                [("F", hit.feed, other.feed), ("K", hit.clock, other.clock), ("J", hit.temperature, other.temperature)]
                    .into_iter()
                    .find(|(_, own, first)| own.is_some() != first.is_some());
            if let Some((letter, ..)) = differs {
                let message =
                    format!("this touch and that in line {} differ: one has {letter}, one has not", head.line);
                return Err(self.wrong(touch.line, message).help("was the line cut?"));
            }
            if let Some(now) = hit.clock.filter(|_| self.wanted.time == Time::Log) {
                if now < clock {
                    let message = format!("K is {now} s, and was {clock} s before: the clock ran backwards");
                    return Err(self.wrong(touch.line, message).help(
                        "are two runs in one log, or was the clock set? Write `time: none` if nothing follows the time",
                    ));
                }
                clock = now;
            }
            self.stands_still(touch, hit, other)?;
            let hit = self.converted(touch, hit, plan)?;
            rows.push(Row { number: touch.number, repeat: touch.repeat, line: touch.line, plan, hit });
        }
        Ok(rows)
    }

    /// Fails if an axis moves that the plan does not have; a control may write the positions of all its axes.
    fn stands_still(&self, touch: &Touch, hit: &Hit, first: &Hit) -> Result<()> {
        let moves = |axis: &char| match (hit.positions.get(axis), first.positions.get(axis)) {
            (Some(own), Some(first)) => (own - first).abs() > STANDS,
            (own, first) => own.is_some() != first.is_some(),
        };
        let mut axes = hit.positions.keys().chain(first.positions.keys());
        match axes.find(|axis| !self.plan.axes.contains(axis) && moves(axis)) {
            Some(axis) => {
                let message = format!("the axis {axis} moves, and the plan does not have it");
                Err(self.wrong(touch.line, message).help("name under `plan` the plan of this log"))
            }
            None => Ok(()),
        }
    }

    /// A hit in mm, rad and mm/s, machine coordinates; rotary axes in the turn of the plan.
    fn converted(&self, touch: &Touch, hit: &Hit, plan: DataRow) -> Result<Hit> {
        let mut positions = Positions::new();
        for &axis in &self.plan.axes {
            let written = hit.positions.get(&axis).ok_or_else(|| {
                let message = format!("the touch has no position of the axis {axis}, which the plan has");
                self.wrong(touch.line, message).help("the program has to write the positions of all axes of the plan")
            })?;
            let offset = match &self.log.offset {
                None => 0.0,
                Some((offset, line)) => *offset.get(&axis).ok_or_else(|| {
                    let error = self.wrong(*line, format!("OFFSET has no {axis}, which the touches have"));
                    error.help("write 0 where there is no offset")
                })?,
            };
            let machine = written + offset;
            let expected = self.plan.positions(axis)[plan];
            positions.insert(axis, if is_rotary(axis) { turned(machine, expected) } else { machine * self.scale() });
        }
        let feed = hit.feed.map(|feed| feed * self.scale() / 60.0);
        if feed.is_some_and(|feed| feed <= 0.0) {
            return Err(self.wrong(touch.line, "the feed F is not above zero"));
        }
        if hit.temperature.is_some_and(|it| !abbe_table::TEMPERATURES.contains(&it)) {
            return Err(self.wrong(touch.line, "J is no temperature in °C that a machine can have"));
        }
        Ok(Hit { positions, feed, ..hit.clone() })
    }

    fn near(&self, rows: &[Row]) -> Result<()> {
        let away = |row: &Row| Away {
            number: row.number,
            repeat: row.repeat,
            line: row.line,
            axes: (row.hit.positions.iter())
                .map(|(&axis, &position)| (axis, position - self.plan.positions(axis)[row.plan]))
                .collect(),
            turned: (self.plan.axes.iter().filter(|axis| is_rotary(**axis)))
                .map(|&axis| self.plan.positions(axis)[row.plan])
                .collect(),
        };
        let all: Vec<Away> = rows.iter().map(away).collect();
        near(&all, self.wanted.bounds, |line, message| self.wrong(line, message))
    }

    /// The touches that missed, in words.
    fn missed(&self) -> Vec<String> {
        let missed: Vec<&Touch> = self.log.records.iter().filter(|touch| touch.hit.is_none()).collect();
        let name = |touch: &&Touch| match touch.repeat {
            1 => touch.number.to_string(),
            repeat => format!("{} (repeat {repeat})", touch.number),
        };
        let names: Vec<String> = missed.iter().take(MISSES_LISTED).map(name).collect();
        let more = if missed.len() > MISSES_LISTED { ", ..." } else { "" };
        let of = self.log.records.len();
        match missed.len() {
            0 => Vec::new(),
            1 => vec![format!("1 touch of {of} missed and is left out: {}", names[0])],
            count => vec![format!("{count} touches of {of} missed and are left out: {}{more}", names.join(", "))],
        }
    }

    fn dataset(&self, rows: &[Row]) -> Result<Dataset> {
        let numbers = |name: &str, values: Vec<f64>| Column {
            header: ColumnHeader::parse(name),
            values: Values::Numbers(values),
        };
        let labels = |name: &str, of: &dyn Fn(&Row) -> u32| Column {
            header: ColumnHeader::parse(name),
            values: Values::Labels(rows.iter().map(|row| of(row).to_string().into()).collect()),
        };
        let mut columns = vec![labels("touch", &|row| row.number)];
        if self.wanted.repeats == Repeats::Keep {
            columns.push(labels("repeat", &|row| row.repeat));
        }
        for &axis in &self.plan.axes {
            let name = format!("{axis}_{}", if is_rotary(axis) { "deg" } else { "mm" });
            columns.push(numbers(&name, rows.iter().map(|row| row.hit.positions[&axis]).collect()));
        }
        let mut optional = |name: &str, of: &dyn Fn(&Hit) -> Option<f64>| {
            if let Some(values) = rows.iter().map(|row| of(&row.hit)).collect::<Option<Vec<f64>>>() {
                columns.push(numbers(name, values));
            }
        };
        optional("feed_mm_per_min", &|hit| hit.feed);
        optional("time_s", &|hit| hit.clock.filter(|_| self.wanted.time == Time::Log));
        optional("T_degC", &|hit| hit.temperature);
        let picked = |values: &Values| match values {
            Values::Numbers(numbers) => Values::Numbers(rows.iter().map(|row| numbers[row.plan]).collect()),
            Values::Labels(labels) => Values::Labels(rows.iter().map(|row| labels[row.plan].clone()).collect()),
        };
        // Columns of the plan have different names: what may be there already is of the log.
        let of_log: BTreeSet<String> = columns.iter().map(|own| own.header.name.clone()).collect();
        for column in self.plan.further() {
            let name = &column.header.name;
            // When a touch was planned is not when it was made.
            if !of_log.contains(name) && (name != "time" || self.wanted.time == Time::Plan) {
                columns.push(Column { header: column.header.clone(), values: picked(&column.values) });
            }
        }
        let origin = |(index, row): (usize, &Row)| RowOrigin { file: 0, line: row.line, row: index + 1 };
        Ok(Dataset {
            columns,
            origins: rows.iter().enumerate().map(origin).collect(),
            files: vec![self.path.to_owned()],
            averaged: self.wanted.repeats == Repeats::Average,
            is_log: false,
            stated_tips: self.stated_tip().into_iter().collect(),
        })
    }
}

/// Positions of an axis that stands, in units of the log.
const STANDS: f64 = 1e-3;

/// Misses that a remark lists.
const MISSES_LISTED: usize = 10;

/// An angle in degrees as radians, in the turn of the expected one: a control that counts from 0 to 360 shows 350 for -10.
fn turned(degrees: f64, expected: f64) -> f64 {
    let turns = ((degrees - expected.to_degrees()) / 360.0).round();
    (degrees - 360.0 * turns).to_radians()
}

/// The means of the repeats of each touch, in the order of the first of each.
fn averaged(rows: Vec<Row>) -> Vec<Row> {
    let mut places: BTreeMap<u32, usize> = BTreeMap::new();
    let mut groups: Vec<Vec<Row>> = Vec::new();
    for row in rows {
        let place = *places.entry(row.number).or_insert_with(|| {
            groups.push(Vec::new());
            groups.len() - 1
        });
        groups[place].push(row);
    }
    let mean = |group: Vec<Row>| {
        let count = group.len() as f64;
        let of = |value: &dyn Fn(&Hit) -> Option<f64>| {
            group.iter().map(|row| value(&row.hit)).sum::<Option<f64>>().map(|sum| sum / count)
        };
        let axes = group.first().map(|row| row.hit.positions.keys().copied().collect::<Vec<_>>()).unwrap_or_default();
        let position = |axis: char| Some((axis, of(&|hit| hit.positions.get(&axis).copied())?));
        let hit = Hit {
            positions: axes.into_iter().filter_map(position).collect(),
            feed: of(&|hit| hit.feed),
            clock: of(&|hit| hit.clock),
            temperature: of(&|hit| hit.temperature),
        };
        group.into_iter().next().map(|first| Row { hit, ..first })
    };
    groups.into_iter().filter_map(mean).collect()
}
