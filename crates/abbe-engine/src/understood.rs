//! What the ingest stages of a recipe make of their files: for people who look at their data before a run.

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_core::{Axis, Dataset, Kind, Monitor, Result, StatusRole};
use serde_json::Value;

use crate::prepare::Prepared;

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
    /// What columns are for the machines that use them, by the name without unit.
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
                roles: self.roles()?,
            });
        }
        Ok(all)
    }

    /// The columns that the machines of this recipe read, and what for.
    fn roles(&self) -> Result<BTreeMap<String, String>> {
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
