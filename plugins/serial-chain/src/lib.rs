//! Model plugin `serial-chain`: any serial machine in ISO 10791-6 notation with location, motion and set-up errors.

mod bodies;
mod builder;
mod c_code;
mod derivatives;
mod evaluate;
mod finish;
mod model;
mod nominal;
mod robot;
mod settings;

use abbe_core::inventory;
use abbe_core::{Build, Constructor, Context, Dataset, KinematicModel, Model, Plugin, Result, SettingsError};
use std::sync::Arc;

use model::SerialChain;
use settings::{Settings, example, schema};

inventory::submit! {
    Plugin::built_in(
        "serial-chain",
        "any serial machine in ISO 10791-6 notation, e.g. w C' B' X' b Z Y (S) t",
        schema,
        example,
        Build::Model(Constructor::Static(|settings, context| build(abbe_core::from_settings(settings)?, context))),
    )
    .with_reference(include_str!("../reference/model-serial-chain.md"))
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Model>, SettingsError> {
    let settings = robot::resolved(settings)?;
    // Finds all errors that need no data, before anything runs.
    SerialChain::new(&settings, &[])?;
    Ok(Box::new(Description { settings }))
}

struct Description {
    settings: Settings,
}

impl Model for Description {
    fn build(&self, data: &[&Dataset]) -> Result<Arc<dyn KinematicModel>> {
        let model = SerialChain::new(&self.settings, data).map_err(|error| {
            let mut wrong = abbe_core::Error::usage(error.message);
            wrong.help = error.help;
            wrong.setting = error.path;
            wrong
        })?;
        Ok(Arc::new(model))
    }
}
