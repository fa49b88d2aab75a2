//! Reads the log of a tool setter and the tool table, and refuses what contradicts itself.

mod agreement;
mod dead;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use abbe_core::{ColumnHeader, DataRow, Dataset, Error, Quantity as Kind, Result, nearest};

use crate::record::Tool;
use crate::settings::{Quantity, Settings};

/// The columns of a log.
const COLUMNS: [(&str, Kind); 9] = [
    ("session", Kind::Label),
    ("tool", Kind::Label),
    ("quantity", Kind::Label),
    ("method", Kind::Label),
    ("repeat", Kind::Label),
    ("value", Kind::Length),
    ("time", Kind::Time),
    ("spindle", Kind::Temperature),
    ("cutting", Kind::Time),
];

/// Longest time that a tool cuts, s: a thousand hours.
const LONGEST_CUT: f64 = 3.6e6;

/// Latest time of a log, s: three hundred years, so that seconds of any epoch are possible.
const LATEST: f64 = 1e10;

/// The columns of a tool table besides `tool`.
const TABLE: [&str; 4] = ["length", "radius", "wear_limit_length", "wear_limit_radius"];

/// Fails if a log with these columns cannot be used.
pub fn check_log(headers: &[ColumnHeader]) -> Result<()> {
    abbe_table::require(headers, None, &COLUMNS)
}

/// Fails if a tool table with these columns cannot be used.
pub fn check_table(path: &Path) -> Result<()> {
    let lengths = TABLE.map(|name| (name, Kind::Length));
    let columns: Vec<(&str, Kind)> = [("tool", Kind::Label)].into_iter().chain(lengths).collect();
    abbe_table::require(&abbe_table::read_headers(path)?, Some(&path.to_owned()), &columns)
}

/// The tools of a table, each with its line.
pub fn tools(path: &Path, settings: &Settings) -> Result<Vec<(Tool, usize)>> {
    check_table(path)?;
    let data = abbe_table::read(path)?;
    abbe_table::unique_labels(&data, "tool")?;
    let columns = TABLE.map(|name| abbe_table::numbers(&data, name, Kind::Length));
    let [length, radius, wear_length, wear_radius] = columns;
    let (length, radius, wear_length, wear_radius) = (length?, radius?, wear_length?, wear_radius?);
    let mut tools = Vec::new();
    for (row, name) in DataRow::enumerate(abbe_table::labels(&data, "tool")?) {
        usable(name).map_err(|message| data.error_at(row, message))?;
        if *name == settings.master.tool.0 {
            let message = format!("tool {name} is the master, which has its values in the recipe and none here");
            return Err(data.error_at(row, message));
        }
        let tool = Tool {
            tool: name.to_string(),
            preset: [length[row], radius[row]],
            wear_limit: [wear_length[row], wear_radius[row]],
        };
        if let Some(index) = tool.preset.iter().chain(&tool.wear_limit).position(|value| *value <= 0.0) {
            let message = format!("{} of tool {name} is not above zero", TABLE[index]);
            return Err(data.error_at(row, message));
        }
        if let Some(index) = (0..2).find(|&index| tool.wear_limit[index] >= tool.preset[index]) {
            let message = format!(
                "{} of tool {name} is {} um, and the tool has {} mm",
                TABLE[2 + index],
                tool.wear_limit[index] * 1e3,
                tool.preset[index]
            );
            return Err(data.error_at(row, message).help("is it in the unit that its column says?"));
        }
        let breakage = settings.limits.breakage_um;
        if tool.wear_limit[0] * 1e3 >= breakage * (1.0 - 1e-9) {
            let message = format!(
                "{} of tool {name} is {} um, and a tool is broken that is short by more than {breakage} um (`breakage_um`)",
                TABLE[2],
                tool.wear_limit[0] * 1e3
            );
            let help = "such a tool would never be worn: is one of the two in another unit?";
            return Err(data.error_at(row, message).help(help));
        }
        tools.push((tool, data.origins[row].line));
    }
    match tools.is_empty() {
        true => Err(Error::data("the table has no tool").in_file(path)),
        false => Ok(tools),
    }
}

/// A name that stands in names of results.
fn usable(name: &str) -> std::result::Result<(), String> {
    match name.is_empty() || name.contains([',', '[', ']', ';', '(', ')', '"']) {
        true => {
            Err(format!("`{name}` is no name of a tool or a session: it is empty or has brackets, `,`, `;` or `\"`"))
        }
        false => Ok(()),
    }
}

/// Where a reading stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct At {
    /// Index of the data set.
    pub data: usize,
    /// Its row.
    pub row: DataRow,
}

/// One reading of a tool setter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Where it stands.
    pub at: At,
    /// mm.
    pub value: f64,
}

/// Repeats of one quantity of one tool by one method.
pub type Repeats = BTreeMap<(Quantity, String), Vec<Reading>>;

/// A visit of a tool to the tool setter.
#[derive(Debug, Clone, PartialEq)]
pub struct Visit {
    /// The tool.
    pub tool: String,
    /// Time that it has cut so far, s.
    pub cutting: f64,
    /// Time of its first reading by the clock, s.
    pub time: f64,
    /// Its first row.
    pub first: At,
    /// Its readings.
    pub repeats: Repeats,
}

/// A session: the master and the tools.
#[derive(Debug, Clone, PartialEq)]
pub struct Session {
    /// Its name.
    pub name: String,
    /// The master.
    pub master: Repeats,
    /// The tools, in the order of the log.
    pub visits: Vec<Visit>,
}

/// The log of a tool setter.
pub struct Log<'a> {
    data: &'a [&'a Dataset],
    /// The sessions in their order.
    pub sessions: Vec<Session>,
}

/// The cells of a row.
struct Row<'a> {
    at: At,
    session: &'a str,
    tool: &'a str,
    quantity: &'a str,
    method: &'a str,
    repeat: &'a str,
    value: f64,
    time: f64,
    spindle: f64,
    cutting: f64,
}

impl<'a> Log<'a> {
    /// Reads a log.
    pub fn read(data: &'a [&'a Dataset], settings: &Settings) -> Result<Self> {
        let mut rows = Vec::new();
        for (index, data) in data.iter().enumerate() {
            if data.averaged {
                return Err(Error::usage("readings of tools are compared one by one; they cannot be averages")
                    .help("leave out `average`")
                    .setting("from"));
            }
            rows.extend(rows_of(index, data)?);
        }
        let mut log = Self { data, sessions: Vec::new() };
        log.each_once(&rows)?;
        log.in_order(&rows)?;
        for part in rows.chunk_by(|one, other| one.session == other.session) {
            let session = log.session(part, settings)?;
            log.sessions.push(session);
        }
        log.tools_age()?;
        if !log.tell_copies() {
            let scatter = |quantity, method: &str| Some(settings.repeatability_um.get(method)?.of(quantity));
            log.tell_copied_tools(scatter);
        }
        Ok(log)
    }

    /// An error that points at a reading.
    pub fn error(&self, at: At, message: impl Into<String>) -> Error {
        self.data[at.data].error_at(at.row, message)
    }

    /// File, line and number of a row.
    pub fn place(&self, at: At) -> (String, usize, usize) {
        let data = self.data[at.data];
        let origin = data.origins[at.row];
        (data.files[origin.file].display().to_string(), origin.line, origin.row)
    }

    fn line(&self, at: At) -> String {
        let (_, line, _) = self.place(at);
        if self.data.len() > 1 { format!("line {line} of another log or part") } else { format!("line {line}") }
    }

    /// Refuses a reading that is in the log twice.
    fn each_once(&self, rows: &[Row<'_>]) -> Result<()> {
        let mut seen = BTreeMap::new();
        for row in rows {
            let key = (row.session, row.tool, row.quantity, row.method, row.repeat);
            if let Some(first) = seen.insert(key, row.at) {
                let (session, tool, quantity, method, repeat) = key;
                let message = format!(
                    "repeat {repeat} of the {quantity} of tool {tool} by {method} in session {session} is in {} already",
                    self.line(first)
                );
                return Err(self.error(row.at, message));
            }
        }
        Ok(())
    }

    /// Refuses sessions that are not in the order of time.
    fn in_order(&self, rows: &[Row<'_>]) -> Result<()> {
        let number = |name: &str| name.parse::<f64>().ok();
        let mut over = BTreeSet::new();
        for (before, row) in rows.iter().zip(rows.iter().skip(1)) {
            let (now, last) = (row.session, before.session);
            let out_of_order = |message: String| {
                Err(self
                    .error(row.at, format!("sessions are out of order: {message}"))
                    .help("a log is sorted by time, and so are logs that are read together"))
            };
            if now != last {
                over.insert(last);
                if over.contains(now) {
                    return out_of_order(format!("session {now} goes on after session {last}"));
                }
                if let (Some(one), Some(other)) = (number(last), number(now))
                    && other < one
                {
                    return out_of_order(format!("{now} follows {last}"));
                }
            }
            if row.time < before.time {
                return out_of_order(format!("time falls from {} s to {} s", before.time, row.time));
            }
        }
        Ok(())
    }

    fn session(&self, rows: &[Row<'_>], settings: &Settings) -> Result<Session> {
        let mut session = Session { name: rows[0].session.to_owned(), master: Repeats::new(), visits: Vec::new() };
        usable(&session.name).map_err(|message| self.error(rows[0].at, message))?;
        let master = settings.master.tool.0.as_str();
        let temperatures: Vec<f64> = rows.iter().filter(|row| row.tool == master).map(|row| row.spindle).collect();
        if temperatures.is_empty() {
            return Err(self
                .error(rows[0].at, format!("session {} has no reading of the master, tool {master}", session.name))
                .help(
                    "without it neither bias of the setter nor growth of the spindle is known: leave the session out",
                ));
        }
        let temperature = temperatures.iter().sum::<f64>() / temperatures.len() as f64;
        for row in rows {
            let key = self.key(row, settings)?;
            let reading = Reading { at: row.at, value: row.value };
            self.is_as_warm(row, temperature, settings)?;
            if row.tool == master {
                self.is_master(row, key.0, settings)?;
                session.master.entry(key).or_default().push(reading);
                continue;
            }
            let place = session.visits.iter().position(|visit| visit.tool == row.tool).unwrap_or_else(|| {
                let (tool, repeats) = (row.tool.to_owned(), Repeats::new());
                session.visits.push(Visit { tool, cutting: row.cutting, time: row.time, first: row.at, repeats });
                session.visits.len() - 1
            });
            let visit = &mut session.visits[place];
            if visit.cutting != row.cutting {
                let message = format!(
                    "tool {} has cut {} min here and {} min in {} of the same session",
                    row.tool,
                    row.cutting / 60.0,
                    visit.cutting / 60.0,
                    self.line(visit.first)
                );
                return Err(self.error(row.at, message));
            }
            visit.repeats.entry(key).or_default().push(reading);
        }
        self.has_masters(&session)?;
        Ok(session)
    }

    /// Quantity and method of a row.
    fn key(&self, row: &Row<'_>, settings: &Settings) -> Result<(Quantity, String)> {
        let unknown = |what: &str, given: &str, known: &[&str]| {
            let mut error = self.error(row.at, format!("there is no {what} `{given}`; known are {}", known.join(", ")));
            if let Some(near) = nearest(given, known.iter().copied()) {
                error = error.help(format!("did you mean `{near}`?"));
            }
            error
        };
        let quantity = Quantity::ALL.into_iter().find(|quantity| quantity.name() == row.quantity);
        let quantity = quantity.ok_or_else(|| unknown("quantity", row.quantity, &Quantity::ALL.map(Quantity::name)))?;
        let methods: Vec<&str> = settings.repeatability_um.keys().map(String::as_str).collect();
        match methods.contains(&row.method) {
            true => Ok((quantity, row.method.to_owned())),
            false => Err(unknown("method", row.method, &methods)),
        }
    }

    /// Refuses a reading at a temperature of the spindle for which the master says nothing.
    fn is_as_warm(&self, row: &Row<'_>, master: f64, settings: &Settings) -> Result<()> {
        let (change, most) = (row.spindle - master, settings.temperature_limit);
        match change.abs() <= most {
            true => Ok(()),
            false => Err(self
                .error(
                    row.at,
                    format!("the spindle is {change:+.2} K from where it was with the master (at most {most} K)"),
                )
                .help("measure the master again, as a session of its own, or raise `temperature_limit_K`")),
        }
    }

    /// Refuses a master that is another tool, or in another unit.
    fn is_master(&self, row: &Row<'_>, quantity: Quantity, settings: &Settings) -> Result<()> {
        let (value, most) = (settings.master.value(quantity), settings.master_limit_um);
        match (row.value - value).abs() * 1e3 <= most {
            true => Ok(()),
            false => Err(self
                .error(
                    row.at,
                    format!(
                        "the {} of the master reads {} mm; it is {value} mm, and at most {most} um from that were expected",
                        row.quantity, row.value
                    ),
                )
                .help("is it the master, and is the unit of the column right? else raise `master_limit_um`")),
        }
    }

    /// Refuses a session in which tools were measured in a way in which the master was not.
    fn has_masters(&self, session: &Session) -> Result<()> {
        for visit in &session.visits {
            for ((quantity, method), readings) in &visit.repeats {
                if !session.master.contains_key(&(*quantity, method.clone())) {
                    let message = format!(
                        "session {} has no {} of the master by {method}, and that of tool {}",
                        session.name,
                        quantity.name(),
                        visit.tool
                    );
                    return Err(self
                        .error(readings[0].at, message)
                        .help("the master corrects every quantity and method"));
                }
            }
        }
        Ok(())
    }
}

fn rows_of<'a>(index: usize, data: &'a Dataset) -> Result<Vec<Row<'a>>> {
    let label = |name| abbe_table::labels(data, name);
    let (session, tool, quantity) = (label("session")?, label("tool")?, label("quantity")?);
    let (method, repeat) = (label("method")?, label("repeat")?);
    let value = abbe_table::numbers(data, "value", Kind::Length)?;
    let time = abbe_table::numbers(data, "time", Kind::Time)?;
    let spindle = abbe_table::numbers(data, "spindle", Kind::Temperature)?;
    let cutting = abbe_table::numbers(data, "cutting", Kind::Time)?;
    let mut rows = Vec::new();
    for row in data.row_indices() {
        let at = At { data: index, row };
        let numbers =
            [("value", value[row]), ("time", time[row]), ("temperature", spindle[row]), ("cutting", cutting[row])];
        if let Some((name, _)) = numbers.iter().find(|(_, number)| !number.is_finite()) {
            return Err(data.error_at(row, format!("the {name} is missing")));
        }
        for (name, label) in [("session", &session[row]), ("repeat", &repeat[row])] {
            if let Ok(number) = label.parse::<f64>()
                && !(number >= 0.0 && number.fract() == 0.0)
            {
                let message = format!("{name} {label}: a whole number from 0, or a name, was expected");
                return Err(data.error_at(row, message));
            }
        }
        if value[row] <= 0.0 || cutting[row] < 0.0 {
            return Err(data.error_at(row, "a dimension above zero and cutting minutes from zero were expected"));
        }
        if cutting[row] > LONGEST_CUT || time[row].abs() > LATEST {
            let message =
                format!("{:e} minutes of cutting, at {:e} s: no tool lasts that long", cutting[row] / 60.0, time[row]);
            return Err(data.error_at(row, message).help("are the columns in the units that they say?"));
        }
        rows.push(Row {
            at,
            session: &session[row],
            tool: &tool[row],
            quantity: &quantity[row],
            method: &method[row],
            repeat: &repeat[row],
            value: value[row],
            time: time[row],
            spindle: spindle[row],
            cutting: cutting[row],
        });
    }
    dead::tell_dead(&rows);
    Ok(rows)
}
