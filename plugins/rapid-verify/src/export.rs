//! Exporter `verify-sensitivity`: the effect of each error on the reading of each point, the size that a tolerance detects,
//! and the combinations that respond to one error alone.

use std::path::PathBuf;

use abbe_core::{
    Calibration, Context, Export, ExportedFile, InputFile, KinematicModel, PathItem, Result, SettingsError, positive,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::candidates::{self, Candidates, Names, ParameterGroups};
use crate::combination::combination;
use crate::diagnosis::Pattern;
use crate::points::{Points, Touch};

abbe_core::register!(
    Export,
    "verify-sensitivity",
    "what each error does to each probed point, what tolerances detect, and combinations that answer to one error alone",
    Settings,
    example,
    build,
    "../reference/export-verify-sensitivity.md",
);

/// Settings of the sensitivities.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the nominal points.
    nominal: String,
    /// Patterns of the parameters.
    #[serde(default)]
    candidates: Names,
    /// Groups of parameters that change by the same amount, by the name of the group.
    #[serde(default)]
    together: ParameterGroups,
    /// Tolerances whose detectable sizes are listed.
    #[serde(default)]
    compare_um: Vec<f64>,
}

fn example() -> Value {
    json!({ "nominal": "points.csv", "candidates": ["E*", "d?t"], "compare_um": [4, 12, 20] })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    for (index, tolerance) in settings.compare_um.iter().enumerate() {
        let path = vec![PathItem::Key("compare_um".to_owned()), PathItem::Index(index)];
        positive("", *tolerance).map_err(|error| SettingsError { path, ..error })?;
    }
    Ok(Box::new(Sensitivity { nominal: context.path(&settings.nominal), settings }))
}

struct Sensitivity {
    nominal: PathBuf,
    settings: Settings,
}

impl Export for Sensitivity {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "nominal", path: self.nominal.clone() }]
    }

    fn export(&self, _: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let points = Points::read(&self.nominal)?;
        let (names, together) = (self.settings.candidates.clone(), self.settings.together.clone());
        let mut machine = Candidates { names, together, places: false }.of(model)?;
        let (statuses, nominal) = (points.in_contact(model)?, model.info().nominal.clone());
        for (pose, point) in statuses.indices().zip(&points.list) {
            let touch = Touch::new(model, point, statuses.row(pose))?;
            candidates::add_effects(&mut machine, &touch, &nominal)?;
        }
        let of_machine = machine.iter().filter(|pattern| !pattern.parameters.is_empty()).count();
        let artefact = machine.split_off(of_machine);
        let file = |name: &str, text: String| ExportedFile { name: name.to_owned(), content: text.into_bytes() };
        Ok(vec![
            file("sensitivity.csv", self.sensitivity(&points, &machine)),
            file("combinations.csv", combinations(&points, &machine, &artefact)),
        ])
    }
}

impl Sensitivity {
    fn sensitivity(&self, points: &Points, machine: &[Pattern]) -> String {
        let labels: Vec<&str> = points.list.iter().map(|point| point.label.as_str()).collect();
        let mut text = "# d(reading, mm)/d(parameter) at nominal contact; detectable: the size that moves the most sensitive point by a tolerance\n".to_owned();
        text.push_str(&format!("parameter,unit,{},most_sensitive", labels.join(",")));
        self.settings.compare_um.iter().for_each(|tolerance| text.push_str(&format!(",detectable_at_{tolerance}um")));
        text.push('\n');
        for pattern in machine {
            let most = (0..labels.len()).fold(0, |most, point| {
                if pattern.effect[point].abs() > pattern.effect[most].abs() { point } else { most }
            });
            let effects: Vec<String> = pattern.effect.iter().map(|effect| number(*effect)).collect();
            let largest = pattern.effect.get(most).copied().unwrap_or_default().abs();
            let name = if largest > 0.0 { labels[most] } else { "none" };
            text.push_str(&format!("{},{},{},{name}", pattern.name, pattern.unit, effects.join(",")));
            for tolerance in &self.settings.compare_um {
                let size = if largest > 0.0 { format!("{:.6e}", tolerance * 1e-3 / largest) } else { String::new() };
                text.push_str(&format!(",{size}"));
            }
            text.push('\n');
        }
        text
    }
}

/// Nine decimals without the zeros at the end.
fn number(value: f64) -> String {
    let text = format!("{value:.9}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

fn combinations(points: &Points, machine: &[Pattern], artefact: &[Pattern]) -> String {
    let blind_to: Vec<Vec<f64>> = artefact.iter().map(|pattern| pattern.effect.clone()).collect();
    let mut text = "# weighted sum of deviations that answers to the parameter and not to a shift, a turn or the expansion of the artefact, \
                    with the least sum of weights; gain: its value per unit of the parameter\n\
                    parameter,combination,gain_mm_per_unit\n"
        .to_owned();
    for pattern in machine {
        let line = match combination(&pattern.effect, &blind_to) {
            None => "none,0".to_owned(),
            Some(found) => {
                let parts = found.weights.iter().zip(&points.list).filter(|(weight, _)| weight.abs() > 0.0);
                let parts: Vec<String> = parts.map(|(weight, point)| format!("{weight:+.6}*{}", point.label)).collect();
                format!("{},{:.6}", parts.join(" "), found.gain)
            }
        };
        text.push_str(&format!("{},{line}\n", pattern.name));
    }
    text
}
