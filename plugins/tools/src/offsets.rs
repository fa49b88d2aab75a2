//! Exporter `tool-offsets`.

use std::collections::BTreeMap;

use abbe_core::{Calibration, Context, Error, Export, ExportedFile, KinematicModel, Result, SettingsError};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::controls::{Entry, Locked, fanuc, heidenhain, linuxcnc, siemens};
use crate::judge::{Name, judge};
use crate::record::Store;
use crate::settings::Quantity;
use crate::tables;
use crate::validate::bad;

abbe_core::register!(
    Export,
    "tool-offsets",
    "offsets of tools for a control, and the list of locked tools",
    Settings,
    example,
    build,
    "../reference/export-tool-offsets.md",
);

/// Settings of the offsets.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Who reads the file.
    control: Control,
    /// Decimals of a millimetre: the increment of the control. Default: 3 for Fanuc, 4 for others.
    #[serde(default)]
    decimals: Option<u32>,
    /// Numbers of tools in the control, by their names in the log. Default: the names themselves.
    #[serde(default)]
    numbers: BTreeMap<String, u32>,
    /// Verdicts by which a tool is locked. A tool that the last session did not measure is locked as well.
    #[serde(default = "bad")]
    lock: Vec<Name>,
    /// Number of the program of Fanuc.
    #[serde(default = "program")]
    program: u32,
}

/// Who reads the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Control {
    /// LinuxCNC: a tool table.
    Linuxcnc,
    /// Fanuc: a program of `G10`.
    Fanuc,
    /// Siemens: a program that sets `$TC_DP`.
    Siemens,
    /// Heidenhain: the table `TOOL.T`.
    Heidenhain,
}

fn program() -> u32 {
    8001
}

fn example() -> Value {
    json!({ "control": "fanuc", "decimals": 3, "numbers": { "1": 11 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    if settings.decimals.is_some_and(|decimals| !(2..=6).contains(&decimals)) {
        return Err(SettingsError::new("decimals", "2 to 6 decimals of a millimetre were expected"));
    }
    if settings.lock.contains(&Name::Ok) {
        return Err(SettingsError::new("lock", "a tool that is `ok` cannot be locked"));
    }
    if !(1..=9999).contains(&settings.program) {
        return Err(SettingsError::new("program", "a number from 1 to 9999 was expected"));
    }
    Ok(Box::new(ToolOffsets { settings }))
}

struct ToolOffsets {
    settings: Settings,
}

impl ToolOffsets {
    /// The number of a tool in the control.
    fn number(&self, tool: &str) -> Result<u32> {
        let own = || tool.parse().ok().filter(|number| *number > 0);
        self.settings.numbers.get(tool).copied().or_else(own).ok_or_else(|| {
            Error::usage(format!("tool `{tool}` has no number for the control"))
                .help(format!("state it: `numbers: {{ {tool}: 12 }}`"))
                .setting("numbers")
        })
    }

    /// The number of a tool, if the control has such numbers.
    fn number_within(&self, tool: &str) -> Result<u32> {
        let (number, most) = (self.number(tool)?, Range::of(self.settings.control).number);
        match (1..=most).contains(&number) {
            true => Ok(number),
            false => Err(Error::usage(format!("tool `{tool}`: {number}; the control has numbers from 1 to {most}"))
                .help(format!("state one of them: `numbers: {{ {tool}: 12 }}`"))
                .setting("numbers")),
        }
    }

    /// Fails if two tools have one number, or if a number is stated of a tool that there is not.
    fn check_numbers(&self, store: &Store) -> Result<()> {
        let mut seen: BTreeMap<u32, &str> = BTreeMap::new();
        for tool in &store.record.tools {
            if let Some(other) = seen.insert(self.number_within(&tool.tool)?, &tool.tool) {
                let message = format!("tools {other} and {} have the same number in the control", tool.tool);
                return Err(Error::usage(message).setting("numbers"));
            }
        }
        let known = |name: &&String| store.record.tools.iter().any(|tool| tool.tool == **name);
        match self.settings.numbers.keys().find(|name| !known(name)) {
            Some(name) => Err(Error::usage(format!("the table has no tool `{name}`")).setting("numbers")),
            None => Ok(()),
        }
    }
}

/// What a control takes: numbers of tools, and sizes of dimensions and of what is worn, mm.
struct Range {
    number: u32,
    dimension: f64,
    worn: f64,
}

impl Range {
    fn of(control: Control) -> Self {
        match control {
            Control::Linuxcnc => Self { number: 99_999, dimension: f64::INFINITY, worn: f64::INFINITY },
            Control::Fanuc => Self { number: 999, dimension: 1000.0, worn: 100.0 },
            Control::Siemens => Self { number: 32_000, dimension: f64::INFINITY, worn: f64::INFINITY },
            Control::Heidenhain => Self { number: 32_767, dimension: 100_000.0, worn: 100.0 },
        }
    }

    /// Fails for offsets that the control does not take.
    fn check(&self, tool: &str, preset: [f64; 2], value: [f64; 2]) -> Result<()> {
        for (what, (preset, value)) in ["length", "radius"].into_iter().zip(preset.into_iter().zip(value)) {
            for (name, size, most) in [("", preset, self.dimension), ("wear of the ", value - preset, self.worn)] {
                if size.abs() >= most {
                    let message =
                        format!("tool `{tool}`: a {name}{what} of {size:.4} mm; the control takes less than {most} mm");
                    return Err(Error::data(message)
                        .help("is the preset of the tool table right? Set the tool anew, or lock it"));
                }
            }
        }
        Ok(())
    }
}

impl Export for ToolOffsets {
    fn accepts_readings(&self) -> bool {
        true
    }

    fn export(&self, calibration: &Calibration, _: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let store = Store::of(calibration)?;
        self.check_numbers(&store)?;
        let judged = judge(&store);
        let list = tables::locked(&store, &judged, &self.settings.lock);
        let (mut entries, mut locked) = (Vec::new(), Vec::new());
        for tool in &store.record.tools {
            let number = self.number(&tool.tool)?;
            if let Some(it) = list.iter().find(|it| it.tool == tool.tool) {
                locked.push(Locked { number, preset: tool.preset, reason: it.reason });
                continue;
            }
            let Some(check) = store.record.last_check(&tool.tool) else { continue };
            let value = |quantity| store.index(check, quantity).map(|index| store.values[index].value);
            // A tool that lacks one of them is locked.
            let (Some(length), Some(radius)) = (value(Quantity::Length), value(Quantity::Radius)) else { continue };
            let recheck = judged.get(check).is_some_and(|it| it.name == Name::Recheck);
            Range::of(self.settings.control).check(&tool.tool, tool.preset, [length, radius])?;
            entries.push(Entry { number, preset: tool.preset, value: [length, radius], recheck });
        }
        let decimals = self.settings.decimals.unwrap_or(if self.settings.control == Control::Fanuc { 3 } else { 4 });
        let (name, text) = match self.settings.control {
            Control::Linuxcnc => ("tool.tbl", linuxcnc::table(&entries, &locked, decimals)),
            Control::Fanuc => ("offsets.nc", fanuc::program(self.settings.program, &entries, &locked, decimals)),
            Control::Siemens => ("offsets.mpf", siemens::program(&entries, &locked, decimals)),
            Control::Heidenhain => ("TOOL.T", heidenhain::table(&entries, &locked, decimals)),
        };
        let file = |name: &str, text: String| ExportedFile { name: name.to_owned(), content: text.into_bytes() };
        Ok(vec![file(name, text), file("locked.csv", tables::lock_list(&list))])
    }
}
