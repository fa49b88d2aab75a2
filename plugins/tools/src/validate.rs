//! Validator `tools`.

use std::collections::BTreeMap;

use abbe_core::{Context, Dataset, Figure, Findings, Fit, Label, Limit, PathItem, Result, SettingsError, Validate};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::impossible::{Grown, grown, too_long};
use crate::judge::{Judged, Name, judge};
use crate::record::{Record, Store};
use crate::tables;
use crate::wear::{self, Wear};

abbe_core::register!(
    Validate,
    "tools",
    "verdicts on tools: wrong tool, broken, chipped, worn, to be measured again, in order",
    Settings,
    example,
    build,
    "../reference/validate-tools.md",
);

/// Settings of the verdicts. Limits and factors are those of the estimate.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The sessions that decide.
    #[serde(default)]
    sessions: Sessions,
    /// The tools that the next cut needs: each has to be measured in the last session. Default: all that a session has.
    #[serde(default)]
    tools: Option<Vec<Label>>,
    /// Verdicts that fail. An empty list reports only.
    #[serde(default = "bad")]
    fail: Vec<Name>,
    /// Verdicts by which a tool is on the list of locked ones.
    #[serde(default = "bad")]
    lock: Vec<Name>,
}

/// Which sessions decide.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Sessions {
    /// The last one: whether the next cut may begin.
    #[default]
    Last,
    /// All: whether anything ever was wrong.
    All,
}

/// Verdicts by which a tool must not be used.
pub fn bad() -> Vec<Name> {
    Name::BAD.to_vec()
}

fn example() -> Value {
    json!({ "sessions": "last", "tools": [1, 2, 4], "fail": ["wrong-tool", "broken", "chipped", "worn"] })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    for (setting, names) in [("fail", &settings.fail), ("lock", &settings.lock)] {
        if names.contains(&Name::Ok) {
            return Err(SettingsError::new(setting, "a tool that is `ok` can neither fail nor be locked"));
        }
    }
    if settings.tools.as_ref().is_some_and(Vec::is_empty) {
        return Err(SettingsError::new("tools", "no tool would be judged; at least one was expected")
            .help("leave `tools` out to judge all that the last session measured"));
    }
    let listed = settings.tools.as_deref().unwrap_or_default();
    if let Some((place, twice)) = listed.iter().enumerate().find(|(place, tool)| listed[..*place].contains(tool)) {
        let at = [PathItem::Key("tools".to_owned()), PathItem::Index(place)];
        return Err(SettingsError::new("", format!("the tool {} is listed twice", twice.0)).under(at));
    }
    Ok(Box::new(Tools { settings }))
}

struct Tools {
    settings: Settings,
}

impl Validate for Tools {
    fn accepts_readings(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        for fit in fits {
            let store = Store::of(&fit.calibration)?;
            let judged = judge(&store);
            let wear = wear::of(&fit.calibration, &store);
            self.needed(&store.record)?;
            findings.figures.extend(self.figures(&fit.name, &store, &judged));
            findings.figures.extend(wear_figures(&fit.name, &store, &wear));
            findings.remarks.extend(self.remarks(&store, &judged));
            let locked = tables::locked(&store, &judged, &self.settings.lock);
            let texts = [
                ("verdicts", tables::verdicts(&store, &judged)),
                ("dimensions", tables::dimensions(&fit.calibration, &store)),
                ("wear", tables::wear(&store, &wear)),
                ("locked", tables::lock_list(&locked)),
            ];
            for (name, text) in texts {
                let name = if fits.len() > 1 { format!("{}-{name}.csv", fit.name) } else { format!("{name}.csv") };
                findings.tables.insert(name, text);
            }
        }
        Ok(findings)
    }
}

impl Tools {
    /// Fails for a tool that the table does not have.
    fn needed(&self, record: &Record) -> Result<()> {
        let known: Vec<&str> = record.tools.iter().map(|tool| tool.tool.as_str()).collect();
        match self.settings.tools.iter().flatten().find(|tool| !known.contains(&tool.0.as_str())) {
            None => Ok(()),
            Some(tool) => Err(abbe_core::Error::usage(format!("the table has no tool {}", tool.0))
                .help(format!("there are: {}", known.join(", ")))
                .setting("tools")),
        }
    }

    fn is_needed(&self, tool: &str) -> bool {
        self.settings.tools.as_ref().is_none_or(|tools| tools.iter().any(|needed| needed.0 == tool))
    }

    fn decides(&self, store: &Store, it: &Judged) -> bool {
        let check = &store.record.checks[it.check];
        let session = self.settings.sessions == Sessions::All || check.session == store.record.last_session();
        session && self.is_needed(&check.tool)
    }

    /// One figure for every tool in every session, and one for every needed tool that was not measured.
    fn figures(&self, of: &str, store: &Store, judged: &[Judged]) -> Vec<Figure> {
        let record = &store.record;
        let mut figures: Vec<Figure> = judged.iter().map(|it| self.figure(of, store, it)).collect();
        let last = record.last_session();
        let is_there = |tool: &str| record.checks.iter().any(|check| check.session == last && check.tool == tool);
        for Label(tool) in self.settings.tools.iter().flatten().filter(|tool| !is_there(&tool.0)) {
            let name = format!("not measured[tool={tool},session={last}]");
            figures.push(Figure::new(of, name, f64::NAN, "um").limited(Limit::from(0.0)));
        }
        figures.extend(judged.iter().filter_map(|it| self.too_long(of, store, it)));
        figures.extend(grown(store, judged).iter().filter_map(|it| self.grown(of, store, it, &judged[it.check])));
        figures
    }

    /// The figure of a tool that is larger than it was: it is to be looked at.
    fn grown(&self, of: &str, store: &Store, it: &Grown, judged: &Judged) -> Option<Figure> {
        let decides = self.decides(store, judged) && !self.settings.fail.is_empty();
        let check = &store.record.checks[it.check];
        let name = format!("grown {}[tool={},session={}]", it.quantity.name(), check.tool, check.session);
        let why = "larger than when it was measured before, and no wear does that: look at the master and the tool";
        decides.then(|| self.looked_at(Figure::new(of, name, it.by_um, "um").limited(Limit::from(it.allowed_um)), why))
    }

    /// A figure beyond its limit that asks for a look: it fails where tools that are to be measured again fail.
    fn looked_at(&self, figure: Figure, why: &str) -> Figure {
        let fails = self.settings.fail.contains(&Name::Recheck);
        Figure { inconclusive: (!fails).then(|| why.to_owned()), ..figure }
    }

    /// The figure of a tool that is longer or wider than it can be, and that no rule refuses: it is to be looked at.
    fn too_long(&self, of: &str, store: &Store, it: &Judged) -> Option<Figure> {
        let long = too_long(store, it).filter(|_| self.decides(store, it) && !self.settings.fail.is_empty())?;
        let check = &store.record.checks[it.check];
        let name = format!("too long[tool={},session={}]", check.tool, check.session);
        let limits = &store.record.settings.limits;
        let figure = Figure::new(of, name, long, "um").limited(Limit::from(limits.wrong_um));
        let why = "longer or wider than its preset, and like no other tool: look which tool it is";
        Some(self.looked_at(figure, why))
    }

    /// The figure of a verdict. Only what decides has a limit; what does not, or is in order, is a detail.
    fn figure(&self, of: &str, store: &Store, it: &Judged) -> Figure {
        let check = &store.record.checks[it.check];
        let name = format!("{} {}[tool={},session={}]", it.name.text(), it.quantity.name(), check.tool, check.session);
        let k = store.record.settings.coverage_factor;
        let figure = Figure::new(of, name, it.value_um, "um").uncertain(it.expanded_um / k);
        let decides = self.decides(store, it);
        let figure = if it.name == Name::Ok || !decides { figure.detail() } else { figure };
        let fails = self.settings.fail.contains(&it.name);
        match it.name {
            // Where nothing may fail, nothing is decided.
            _ if !decides || self.settings.fail.is_empty() => figure,
            Name::Ok => figure.limited(Limit::from(it.limit_um)),
            // Not below the limit minus U: the acceptance limit of the guard band decides.
            Name::Recheck if fails && it.expanded_um.is_finite() => {
                figure.limited(Limit::from((it.limit_um - it.expanded_um).next_down()))
            }
            // What was not measured has no value, and a figure without value fails.
            Name::Recheck if fails => figure.limited(Limit::from(it.limit_um)),
            Name::Recheck => Figure {
                inconclusive: Some(format!("{}: measure it again", it.rule)),
                ..figure.limited(Limit::from(it.limit_um))
            },
            _ if fails => figure.limited(Limit::from(it.limit_um)),
            _ => figure,
        }
    }

    fn remarks(&self, store: &Store, judged: &[Judged]) -> Vec<String> {
        let mut counts: BTreeMap<Name, usize> = BTreeMap::new();
        judged.iter().for_each(|it| *counts.entry(it.name).or_default() += 1);
        let counted: Vec<String> = counts.iter().map(|(name, count)| format!("{count} {}", name.text())).collect();
        let mut remarks = vec![format!("{} verdicts: {}", judged.len(), counted.join(", "))];
        let locked = tables::locked(store, judged, &self.settings.lock);
        let list = locked.iter().map(|it| format!("{} ({}, session {})", it.tool, it.reason, it.session));
        let list: Vec<String> = list.collect();
        remarks.push(match list.is_empty() {
            true => "no tool is locked".to_owned(),
            false => format!("locked: {}", list.join(", ")),
        });
        for it in judged {
            let check = &store.record.checks[it.check];
            if let Some(other) = &it.looks_like {
                remarks.push(format!("session {}: tool {} looks like tool {other}", check.session, check.tool));
            }
            if let Some(long) = too_long(store, it) {
                remarks.push(format!(
                    "session {}: tool {} is longer or wider than its preset by {long:.0} um, which no wear does, and looks like no \
                     tool of the table",
                    check.session, check.tool
                ));
            }
        }
        remarks
    }
}

/// Wear rates and the cutting minutes at which limits are reached; the first of those of a tool in use is shown.
fn wear_figures(of: &str, store: &Store, wear: &[Wear]) -> Vec<Figure> {
    let mut figures = Vec::new();
    let in_use = |tool: &str| {
        let last = store.record.last_check(tool);
        last.is_some_and(|check| store.record.checks[check].session == store.record.last_session())
    };
    let reached = |it: &&Wear| it.reached.filter(|_| in_use(&it.tool)).map(|reached| reached.time);
    let first = wear.iter().filter(|it| reached(it).is_some()).min_by(|one, other| {
        let time = |it: &&Wear| reached(it).unwrap_or(f64::INFINITY);
        time(one).total_cmp(&time(other))
    });
    let minutes = |name: String, it: &Wear| {
        it.reached
            .map(|reached| Figure::new(of, name, reached.time / 60.0, "min").uncertain(reached.uncertainty / 60.0))
    };
    if let Some(it) = first {
        figures.extend(minutes(format!("first limit reached: wear[{}].{}", it.tool, it.quantity.name()), it));
    }
    for it in wear {
        let name = format!("wear[{}].{}", it.tool, it.quantity.name());
        let (rate, uncertainty) = (it.rate * tables::PER_100_MIN, it.uncertainty * tables::PER_100_MIN);
        figures.push(Figure::new(of, &name, rate, "um per 100 min").uncertain(uncertainty).detail());
        figures.extend(minutes(format!("limit reached: {name}"), it).map(Figure::detail));
    }
    figures
}
