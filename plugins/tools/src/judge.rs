//! Verdicts on tools: wrong tool, broken, chipped, worn, to be measured again, in order; the first that holds.
//!
//! Acceptance in the manner of ISO 14253-1: out of limits only beyond the limit plus U, in order only below the limit minus
//! U, and between them the tool is measured again.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::record::{Store, Tool};
use crate::settings::Quantity;

/// What a verdict says, in the order in which rules are tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Name {
    /// Another tool of the table is in its place.
    WrongTool,
    /// Its length is short by far.
    Broken,
    /// Its radius has dropped at once.
    Chipped,
    /// Length or radius is beyond its wear limit.
    Worn,
    /// It cannot be told: a value is too near to its limit, methods do not agree, or something was not measured.
    Recheck,
    /// In order.
    Ok,
}

impl Name {
    /// Verdicts by which a tool must not be used.
    pub const BAD: [Self; 4] = [Self::WrongTool, Self::Broken, Self::Chipped, Self::Worn];

    /// As in results.
    pub fn text(self) -> &'static str {
        match self {
            Self::WrongTool => "wrong-tool",
            Self::Broken => "broken",
            Self::Chipped => "chipped",
            Self::Worn => "worn",
            Self::Recheck => "recheck",
            Self::Ok => "ok",
        }
    }
}

/// The verdict on a tool in a session.
#[derive(Debug, Clone, PartialEq)]
pub struct Judged {
    /// Index of the check.
    pub check: usize,
    /// What it says.
    pub name: Name,
    /// The rule that decided.
    pub rule: &'static str,
    /// What was compared.
    pub quantity: Quantity,
    /// The value that was compared, um; NaN for a quantity that was not measured.
    pub value_um: f64,
    /// Its limit, um.
    pub limit_um: f64,
    /// Expanded uncertainty U = k u of the value, um.
    pub expanded_um: f64,
    /// The tool that a wrong one looks like.
    pub looks_like: Option<String>,
}

/// A value, its limit and its expanded uncertainty, um.
#[derive(Debug, Clone, Copy)]
struct Compared {
    quantity: Quantity,
    value: f64,
    limit: f64,
    expanded: f64,
}

impl Compared {
    fn is_out(&self) -> bool {
        self.value > self.limit + self.expanded
    }

    fn is_in(&self) -> bool {
        self.value < self.limit - self.expanded
    }

    fn excess(&self) -> f64 {
        self.value - self.limit
    }
}

/// Verdicts on all checks, in their order.
pub fn judge(store: &Store) -> Vec<Judged> {
    // The radius of each tool when it was last in order.
    let mut good: BTreeMap<&str, usize> = BTreeMap::new();
    let mut verdicts = Vec::new();
    for (check, tool) in store.record.checks.iter().enumerate().map(|(index, check)| (index, check.tool.as_str())) {
        let found = Case::new(store, check, good.get(tool).copied()).verdict();
        if matches!(found.name, Name::Ok | Name::Recheck)
            && let Some(radius) = store.index(check, Quantity::Radius)
        {
            good.insert(tool, radius);
        }
        verdicts.push(found);
    }
    verdicts
}

/// A tool in a session and all that is compared.
struct Case<'a> {
    store: &'a Store,
    check: usize,
    tool: &'a Tool,
    /// Indices of length and radius.
    values: [Option<usize>; 2],
    /// Loss of radius since it was last in order.
    drop: Option<Compared>,
}

impl<'a> Case<'a> {
    fn new(store: &'a Store, check: usize, good: Option<usize>) -> Self {
        let values = Quantity::ALL.map(|quantity| store.index(check, quantity));
        let settings = &store.record.settings;
        let drop = good.zip(values[1]).map(|(before, now)| {
            let c = |row, column| store.covariance[(row, column)];
            // What both share, the master, is not in the difference.
            let variance = (c(now, now) + c(before, before) - 2.0 * c(now, before)).max(0.0);
            Compared {
                quantity: Quantity::Radius,
                value: (store.values[before].value - store.values[now].value) * 1e3,
                limit: settings.limits.chip_um,
                expanded: settings.coverage_factor * variance.sqrt() * 1e3,
            }
        });
        Self { store, check, tool: store.record.tool(check), values, drop }
    }

    /// How much a quantity is short of its preset, against a limit in um.
    fn short(&self, quantity: Quantity, limit: f64) -> Option<Compared> {
        let index = self.values[quantity.index()]?;
        let expanded = self.store.record.settings.coverage_factor * self.store.short_uncertainty_um(index);
        Some(Compared { quantity, value: self.store.short_um(index), limit, expanded })
    }

    fn broken(&self) -> Option<Compared> {
        self.short(Quantity::Length, self.store.record.settings.limits.breakage_um)
    }

    /// Wear against its limits, the one that is nearest or furthest beyond first.
    fn wear(&self) -> Vec<Compared> {
        let short = |quantity: Quantity| self.short(quantity, self.tool.wear_limit[quantity.index()] * 1e3);
        let mut wear: Vec<Compared> = Quantity::ALL.into_iter().filter_map(short).collect();
        wear.sort_by(|one, other| other.excess().total_cmp(&one.excess()));
        wear
    }

    /// The other tool that it looks like, and by what it is off its own preset.
    fn wrong(&self) -> Option<(Compared, String)> {
        let limits = &self.store.record.settings.limits;
        let [length, radius] = Quantity::ALL.map(|quantity| self.short(quantity, limits.wrong_um));
        let off = |compared: Compared| Compared { value: compared.value.abs(), ..compared };
        let (length, radius) = (length?, radius?);
        let worst = if off(length).excess() >= off(radius).excess() { off(length) } else { off(radius) };
        if !off(length).is_out() && !off(radius).is_out() {
            return None;
        }
        let mut best: Option<(f64, &str)> = None;
        for other in self.store.record.tools.iter().filter(|other| other.tool != self.tool.tool) {
            let distance = |compared: &Compared| {
                let place = compared.quantity.index();
                (other.preset[place] - self.tool.preset[place]) * 1e3 + compared.value
            };
            let matches = |compared: &Compared| distance(compared).abs() < limits.match_um - compared.expanded;
            let far = distance(&length).hypot(distance(&radius));
            if matches(&length) && matches(&radius) && best.is_none_or(|(least, _)| far < least) {
                best = Some((far, &other.tool));
            }
        }
        best.map(|(_, tool)| (worst, tool.to_owned()))
    }

    fn says(&self, name: Name, rule: &'static str, by: Compared) -> Judged {
        let Compared { quantity, value, limit, expanded } = by;
        Judged {
            check: self.check,
            name,
            rule,
            quantity,
            value_um: value,
            limit_um: limit,
            expanded_um: expanded,
            looks_like: None,
        }
    }

    fn verdict(&self) -> Judged {
        if let Some((by, tool)) = self.wrong() {
            let rule = "off its preset by more than wrong + U, and another tool matches";
            return Judged { looks_like: Some(tool), ..self.says(Name::WrongTool, rule, by) };
        }
        let wear = self.wear();
        let (broken, drop) = (self.broken(), self.drop);
        if let Some(by) = broken.filter(Compared::is_out) {
            return self.says(Name::Broken, "length short by more than breakage + U", by);
        }
        if let Some(by) = drop.filter(Compared::is_out) {
            return self.says(Name::Chipped, "radius dropped by more than chip + U", by);
        }
        if let Some(by) = wear.iter().copied().find(Compared::is_out) {
            return self.says(Name::Worn, "short by more than its wear limit + U", by);
        }
        self.doubt(&wear).unwrap_or_else(|| {
            // Something was measured: without a value there is a doubt.
            let by = wear.first().copied().unwrap_or(self.not_measured(Quantity::Length));
            self.says(Name::Ok, "below all limits - U", by)
        })
    }

    /// The reason why it cannot be told.
    fn doubt(&self, wear: &[Compared]) -> Option<Judged> {
        let near = |by: &Compared| !by.is_in();
        if let Some(by) = wear.iter().copied().find(near) {
            return Some(self.says(Name::Recheck, "within U of its wear limit", by));
        }
        if let Some(by) = self.broken().filter(near) {
            return Some(self.says(Name::Recheck, "within U of the breakage limit", by));
        }
        if let Some(by) = self.drop.filter(near) {
            return Some(self.says(Name::Recheck, "drop within U of the chip limit", by));
        }
        if let Some(pair) = self.store.record.checks[self.check].inconsistent.first() {
            let by =
                Compared { quantity: pair.quantity, value: pair.difference_um, limit: pair.allowed_um, expanded: 0.0 };
            return Some(self.says(Name::Recheck, "methods do not agree", by));
        }
        let missing = Quantity::ALL.into_iter().find(|quantity| self.values[quantity.index()].is_none())?;
        Some(self.says(Name::Recheck, "not measured", self.not_measured(missing)))
    }

    fn not_measured(&self, quantity: Quantity) -> Compared {
        let limit = self.tool.wear_limit[quantity.index()] * 1e3;
        Compared { quantity, value: f64::NAN, limit, expanded: f64::NAN }
    }
}
