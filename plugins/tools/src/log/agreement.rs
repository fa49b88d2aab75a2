//! Whether sessions agree with each other, and the log with the tool table.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use abbe_core::{Error, Result};

use super::{Log, Reading, Visit};
use crate::record::Tool;
use crate::settings::Quantity;

/// The number of a session, and readings in it.
type OfSession = (usize, Vec<f64>);

/// Cutting time beyond that of the clock that rounded columns have, s.
const ROUNDED: f64 = 60.0;

/// Fewest series of readings that are no copies by chance.
const FEWEST: usize = 3;

/// Fewest readings of one tool that are no copies by chance, and the step of their digits over their scatter below which they are none.
const COPIED: usize = 10;
const FINE: f64 = 0.5;

/// The smallest difference of two readings: the step of their digits.
fn step(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).fold(f64::INFINITY, f64::min)
}

/// Times of the clock that no slip of it explains.
const BY_FAR: f64 = 5.0;

impl Log<'_> {
    /// Tells of a method whose readings in a session are all those of the session before: they were copied, or the setter stood. True if
    /// there is one.
    pub(super) fn tell_copies(&self) -> bool {
        let mut is_told = false;
        type Values<'a> = Vec<(&'a str, Quantity, Vec<f64>)>;
        for pair in self.sessions.windows(2) {
            let methods: BTreeSet<&str> = pair[1].master.keys().map(|(_, method)| method.as_str()).collect();
            for method in methods {
                let [before, now]: [Values<'_>; 2] = [&pair[0], &pair[1]].map(|session| {
                    let visits = session.visits.iter().map(|visit| (visit.tool.as_str(), &visit.repeats));
                    let all = visits.chain([("", &session.master)]);
                    let of_method = all.flat_map(|(tool, repeats)| {
                        let own = repeats.iter().filter(|((_, own), _)| own == method);
                        own.map(move |((quantity, _), readings)| {
                            (tool, *quantity, readings.iter().map(|reading| reading.value).collect())
                        })
                    });
                    of_method.collect()
                });
                let same = now.iter().filter(|values| before.contains(values)).count();
                if same == now.len() && same >= FEWEST {
                    is_told = true;
                    tracing::warn!(
                        "all readings by {method} in session {} are those of session {}: were they copied, or does the setter stand?",
                        pair[1].name,
                        pair[0].name
                    );
                }
            }
        }
        is_told
    }

    /// Tells of a tool whose readings in some sessions are those of an earlier one: they were copied. Coarse digits, which agree by chance,
    /// do not count. `repeatability` is the standard deviation of a reading by method and quantity, mm.
    pub(super) fn tell_copied_tools(&self, repeatability: impl Fn(Quantity, &str) -> Option<f64>) {
        let mut series: BTreeMap<(&str, Quantity, &str), Vec<OfSession>> = BTreeMap::new();
        for (session, visit) in
            self.sessions.iter().enumerate().flat_map(|(at, session)| session.visits.iter().map(move |it| (at, it)))
        {
            for ((quantity, method), readings) in &visit.repeats {
                let values = readings.iter().map(|reading| reading.value).collect();
                series.entry((&visit.tool, *quantity, method)).or_default().push((session, values));
            }
        }
        // Tool, later and earlier session, copied readings.
        let mut copied: BTreeMap<&str, (usize, usize, usize)> = BTreeMap::new();
        for ((tool, quantity, method), visits) in &series {
            let all: Vec<f64> = visits.iter().flat_map(|(_, values)| values.iter().copied()).collect();
            let scatter = repeatability(*quantity, method).unwrap_or_default();
            if step(all) >= FINE * scatter {
                continue;
            }
            for (place, (session, values)) in visits.iter().enumerate() {
                if let Some((earlier, _)) = visits[..place].iter().find(|(_, others)| others == values) {
                    // Repeats that are all the same agree by chance once, not several times.
                    let different: BTreeSet<u64> = values.iter().map(|value| value.to_bits()).collect();
                    copied.entry(*tool).or_insert((*session, *earlier, 0)).2 += different.len();
                }
            }
        }
        for (tool, (later, earlier, count)) in copied.into_iter().filter(|(_, (.., count))| *count >= COPIED) {
            tracing::warn!(
                "{count} readings of tool {tool} are those of an earlier session to the last digit (the first: session {} as session {}): \
                 were they copied?",
                self.sessions[later].name,
                self.sessions[earlier].name
            );
        }
    }

    /// Refuses cutting minutes that fall, or that the clock does not allow, and tools that come back.
    pub(super) fn tools_age(&self) -> Result<()> {
        let mut visits: BTreeMap<&str, Vec<(usize, &Visit)>> = BTreeMap::new();
        for (index, session) in self.sessions.iter().enumerate() {
            session.visits.iter().for_each(|visit| visits.entry(&visit.tool).or_default().push((index, visit)));
        }
        for visits in visits.values() {
            visits.windows(2).try_for_each(|pair| self.goes_on(pair[0], pair[1]))?;
            if let [(_, first), .., (_, last)] = visits.as_slice() {
                self.has_cut(first, last)?;
            }
        }
        Ok(())
    }

    /// Refuses a tool that sessions between two of its visits do not have, and one that lost cutting time.
    fn goes_on(&self, (before, earlier): (usize, &Visit), (now, visit): (usize, &Visit)) -> Result<()> {
        let message = if before + 1 < now {
            let (session, without) = (&self.sessions[now].name, &self.sessions[before + 1].name);
            let out_of_use = "after it was taken out of use: it is not in session";
            format!("tool {} is measured in session {session}, {out_of_use} {without}", visit.tool)
        } else if visit.cutting < earlier.cutting {
            let [from, to] = [earlier, visit].map(|visit| visit.cutting / 60.0);
            format!("the cutting minutes of tool {} fall from {from} to {to}", visit.tool)
        } else {
            return Ok(());
        };
        Err(self.error(visit.first, message).help("give a new or reground tool a number of its own"))
    }

    /// Tells of a tool that cut for longer than the clock went on between its first and its last visit, and refuses one that did so
    /// by far: minutes are seconds then.
    fn has_cut(&self, first: &Visit, last: &Visit) -> Result<()> {
        let (cut, clock) = (last.cutting - first.cutting - ROUNDED, last.time - first.time);
        if cut <= clock {
            return Ok(());
        }
        let message = format!(
            "tool {} cut for {:.1} minutes, and by the clock {:.1} minutes passed since {}",
            last.tool,
            (last.cutting - first.cutting) / 60.0,
            clock / 60.0,
            self.line(first.first)
        );
        let help = "are both columns in the units that they say, e.g. `cutting_s` for seconds?";
        // A clock that stands says nothing of minutes.
        if clock > 0.0 && cut > BY_FAR * clock {
            return Err(self.error(last.first, message).help(help));
        }
        let (file, line, _) = self.place(last.first);
        tracing::warn!("{file}:{line}: {message}: {help}");
        Ok(())
    }

    /// Refuses tools that only the log or only the table has.
    pub fn check_tools(&self, tools: &[(Tool, usize)], table: &Path) -> Result<()> {
        let names: Vec<&str> = tools.iter().map(|(tool, _)| tool.tool.as_str()).collect();
        let mut seen = BTreeSet::new();
        for visit in self.sessions.iter().flat_map(|session| &session.visits) {
            if !names.contains(&visit.tool.as_str()) {
                let message = format!("tool {} is not in the table {}", visit.tool, table.display());
                return Err(self
                    .error(visit.first, message)
                    .help("add its presets, or leave it out of the log by `ignore`"));
            }
            seen.insert(visit.tool.as_str());
        }
        match tools.iter().find(|(tool, _)| !seen.contains(tool.tool.as_str())) {
            Some((tool, line)) => Err(Error::data(format!("tool {} is in no session of the log", tool.tool))
                .at(table, *line, None)
                .help("measure it, or take it out of the table")),
            None => self.check_presets(tools, table),
        }
    }

    /// Refuses a table in another unit: all tools read more than five times their presets, or less than a fifth of them.
    fn check_presets(&self, tools: &[(Tool, usize)], table: &Path) -> Result<()> {
        let first = |tool: &str, quantity: Quantity| {
            let visits = self.sessions.iter().flat_map(|session| &session.visits);
            let mut repeats = visits.filter(|visit| visit.tool == tool).flat_map(|visit| &visit.repeats);
            repeats.find(|((other, _), _)| *other == quantity).and_then(|(_, readings)| readings.first())
        };
        for quantity in Quantity::ALL {
            let preset = |tool: &Tool| tool.preset[quantity.index()];
            let read: Vec<(&Tool, usize, &Reading)> = tools
                .iter()
                .filter_map(|(tool, line)| first(&tool.tool, quantity).map(|reading| (tool, *line, reading)))
                .collect();
            let all = |is_off: fn(f64) -> bool| read.iter().all(|(tool, _, it)| is_off(it.value / preset(tool)));
            if let Some((tool, line, reading)) = read.first()
                && (all(|ratio| ratio > 5.0) || all(|ratio| ratio < 0.2))
            {
                let message = format!(
                    "the {} of tool {} is {} mm here, and the setter reads {} mm ({}); the others are off alike",
                    quantity.name(),
                    tool.tool,
                    preset(tool),
                    reading.value,
                    self.line(reading.at)
                );
                return Err(Error::data(message)
                    .at(table, *line, None)
                    .help("are the units of the columns right, and are the presets of this table those of this log?"));
            }
        }
        Ok(())
    }
}
