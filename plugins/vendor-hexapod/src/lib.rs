//! A vendor's plugin library: a hexapod, a parallel machine that no serial chain can express.
//!
//! Six struts of commanded lengths l_i join base joints B_i to platform joints P_i: `|t + R P_i - B_i| = l_i`. The pose (t, R)
//! follows from the lengths by Newton's iteration (Merlet 2006, chapter 4); its derivatives follow from the same six equations
//! without an iteration (implicit function theorem). Parameters are the errors of strut lengths and of joint positions.
//!
//! The crate knows `abbe-plugin` alone, and registers as a built-in plugin does.

mod geometry;
mod settings;

use std::sync::Arc;

use abbe_plugin::sdk::*;

use geometry::Hexapod;
use settings::Settings;

abbe_plugin::export!(Plugin::built_in(
    "vendor-hexapod",
    "a parallel machine on six struts, with errors of strut lengths and joint positions",
    schema_of::<Settings>,
    settings::example,
    Build::Model(Constructor::Static(build)),
));

fn build(settings: &serde_json::Value, _: &Context) -> Result<Box<dyn Model>, SettingsError> {
    let settings: Settings = from_settings(settings)?;
    // Finds all errors before anything runs.
    Ok(Box::new(Description { machine: Arc::new(Hexapod::new(settings)?) }))
}

struct Description {
    machine: Arc<Hexapod>,
}

impl Model for Description {
    fn build(&self, _: &[&Dataset]) -> Result<Arc<dyn KinematicModel>> {
        Ok(self.machine.clone())
    }
}

#[cfg(test)]
mod tests;
