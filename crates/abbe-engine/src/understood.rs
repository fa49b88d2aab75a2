//! What the ingest stages of a recipe make of their files: for people who look at their data before a run.

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_core::{Axis, ColumnHeader, Dataset, Kind, KinematicModel, Monitor, Result, StatusRole};
use abbe_recipe::Stage;
use serde_json::Value;

use crate::prepare::Prepared;
use crate::readings::has_readings;

/// The data set of an ingest stage.
pub struct Understood {
    /// Name of the stage.
    pub stage: String,
    /// Its plugin.
    pub plugin: String,
    /// Its settings.
    pub settings: Value,
    /// The files of its rows, without joined tables.
    pub files: Vec<PathBuf>,
    /// The rows that it gives.
    pub data: Dataset,
    /// What columns are used as, by the name without unit; a column without an entry is one that no stage needs or names.
    pub roles: BTreeMap<String, String>,
}

impl Prepared {
    /// The data sets of all ingest stages.
    ///
    /// Fails as a run does for files that do not fit their stage.
    pub fn understood(&self) -> Result<Vec<Understood>> {
        let read = self.read(&Monitor::default(), None)?;
        let mut all = Vec::new();
        for stage in self.stages(Kind::Ingest) {
            let inputs = self.ingests[&stage.name].inputs();
            all.push(Understood {
                stage: stage.name.clone(),
                plugin: stage.plugin.clone(),
                settings: stage.settings.clone(),
                files: inputs.into_iter().filter(|input| input.setting == "path").map(|input| input.path).collect(),
                data: read[&stage.name].as_ref().clone(),
                roles: self.roles(stage, read[&stage.name].as_ref())?,
            });
        }
        Ok(all)
    }

    /// What the columns of an ingest stage are used as.
    fn roles(&self, ingest: &Stage, data: &Dataset) -> Result<BTreeMap<String, String>> {
        let of_machines = self.roles_of_machines()?;
        let (headers, file) = (data.headers(), data.files.first());
        let mut roles = BTreeMap::new();
        for (place, header) in headers.iter().enumerate() {
            let rest: Vec<ColumnHeader> = headers
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != place)
                .map(|(_, header)| header.clone())
                .collect();
            let mut told: Vec<String> = of_machines.get(&header.name).cloned().into_iter().collect();
            if told.is_empty() && header.name == "time" && self.has_logs(ingest) {
                told.push("time".to_owned());
            }
            let needed = self.needed_by(ingest, (&headers, &rest), file)?;
            if told.is_empty() && !needed.is_empty() {
                told.push(format!("needed by {}", needed.join(", ")));
            }
            let named = |stage: &&Stage| stage.name == ingest.name || stage.kind != Kind::Ingest;
            let stages = self.recipe.stages.iter().filter(named).filter(|stage| names(&stage.settings, header));
            let stages: Vec<String> = stages.map(|stage| format!("`{}`", stage.name)).collect();
            if told.is_empty() && !stages.is_empty() {
                told.push(format!("named by {}", stages.join(", ")));
            }
            if told.is_empty() && header.name == "file" {
                told.push("the name of the file".to_owned());
            }
            roles.extend(told.pop().map(|role| (header.name.clone(), role)));
        }
        Ok(roles)
    }

    /// Whether rows are looked up in a log by their time, or are those of a log.
    fn has_logs(&self, ingest: &Stage) -> bool {
        let machines = || self.stages(Kind::Model).filter(|machine| !machine.reference("logs").is_empty());
        let is_log = machines().any(|machine| machine.reference("logs").contains(&ingest.name));
        is_log || (machines().next().is_some() && self.readers_of(ingest).next().is_some())
    }

    /// The artefacts that read an ingest stage.
    fn readers_of<'a>(&'a self, ingest: &'a Stage) -> impl Iterator<Item = &'a Stage> {
        let reads = |stage: &&Stage| ["from", "repeats"].iter().any(|key| stage.reference(key).contains(&ingest.name));
        self.stages(Kind::Artefact).filter(reads)
    }

    /// The artefacts and the estimators of readings that take data with all these columns, and none with the rest.
    fn needed_by(
        &self,
        ingest: &Stage,
        (all, rest): (&[ColumnHeader], &[ColumnHeader]),
        file: Option<&PathBuf>,
    ) -> Result<Vec<String>> {
        let mut needed = Vec::new();
        for artefact in self.readers_of(ingest) {
            let check = |headers: &[ColumnHeader], model: &dyn KinematicModel| {
                self.artefacts[&artefact.name].check(headers, file, model).is_ok()
            };
            let observes = |estimate: &&Stage| estimate.reference("observations").contains(&artefact.name);
            for estimate in self.stages(Kind::Estimate).filter(observes) {
                let machine = self.machine_stage(estimate)?;
                let Some(model) = self.models.get(&machine.name) else { continue };
                let model = self.located(machine, model.build(&[]))?;
                if check(all, model.as_ref()) && !check(rest, model.as_ref()) {
                    needed.push(format!("`{}`", artefact.name));
                    break;
                }
            }
        }
        for estimate in self.stages(Kind::Estimate).filter(|stage| has_readings(stage)) {
            let from = estimate.reference("from");
            let with = |headers: &[ColumnHeader]| -> Result<bool> {
                let of = |name: &String| if *name == ingest.name { Ok(headers.to_vec()) } else { self.headers(name) };
                let lists = from.iter().map(of).collect::<Result<Vec<_>>>()?;
                Ok(self.estimators[&estimate.name].check_readings(&lists).is_ok())
            };
            if from.contains(&ingest.name) && with(all)? && !with(rest)? {
                needed.push(format!("`{}`", estimate.name));
            }
        }
        Ok(needed)
    }

    /// The columns that the machines of this recipe read, and what for.
    fn roles_of_machines(&self) -> Result<BTreeMap<String, String>> {
        let mut roles = BTreeMap::new();
        for stage in self.stages(Kind::Model) {
            let model = self.models[&stage.name].build(&[]).map_err(|error| error.stage(&stage.name))?;
            let info = model.info();
            for status in &info.status {
                if let Some(role) = words(&status.role, &info.axes) {
                    for name in [status.name.clone(), status.column_of_pose(1), status.column_of_pose(2)] {
                        roles.entry(name).or_insert_with(|| role.clone());
                    }
                }
            }
        }
        Ok(roles)
    }
}

/// Whether settings name a column, with its unit or without, as a text or as a key.
fn names(settings: &Value, header: &ColumnHeader) -> bool {
    let is_it = |text: &str| text == header.name || text == header.header;
    match settings {
        Value::String(text) => is_it(text),
        Value::Array(items) => items.iter().any(|item| names(item, header)),
        Value::Object(map) => map.iter().any(|(key, value)| {
            let is_filter = ["ignore", "keep"].contains(&key.as_str());
            names(value, header) || (is_filter && value.as_object().is_some_and(|map| map.keys().any(|key| is_it(key))))
        }),
        _ => false,
    }
}

fn words(role: &StatusRole, axes: &[Axis]) -> Option<String> {
    Some(match role {
        StatusRole::Command(axis) => format!("axis {}", axes[*axis].name),
        StatusRole::Direction(axis) => format!("direction of approach of {}", axes[*axis].name),
        StatusRole::Velocity(axis) => format!("velocity of {}", axes[*axis].name),
        StatusRole::Time => "time".to_owned(),
        StatusRole::Stylus => "stylus".to_owned(),
        StatusRole::Series => "series with unknowns of its own".to_owned(),
        StatusRole::Temperature => "temperature".to_owned(),
        StatusRole::Load => "load".to_owned(),
        StatusRole::Feed => "feed".to_owned(),
        StatusRole::Sensor(name) => format!("sensor {name}"),
        StatusRole::ThermalState(name) => format!("thermal state of {name}"),
        StatusRole::Probe => "probe".to_owned(),
        StatusRole::Other => return None,
    })
}
