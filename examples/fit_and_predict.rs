//! Reads a recipe, runs it, and predicts where the tip really is at a pose of the machine.
//!
//!     cargo run --release -p abbe-examples --example fit_and_predict

use std::path::Path;

use abbe_core::{Poses, Registry, Result};
use abbe_engine::{model_of, prepare};

// Naming the bundle links the plugins of the stock program.
use abbe_bundle as _;

/// Prints what it finds.
pub fn main() -> Result<()> {
    for (name, [x, y, z]) in deviations()? {
        println!("{name}: {:+.1}, {:+.1}, {:+.1} µm", x * 1e3, y * 1e3, z * 1e3);
    }
    Ok(())
}

/// Deviation of the tip from its nominal place in the table frame, mm, by every estimate of a recipe, at B 90°, C 180°.
pub fn deviations() -> Result<Vec<(String, [f64; 3])>> {
    let registry = Registry::built_in()?;
    let recipe = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines/first-steps.yaml");
    let outcome = prepare(&recipe, &registry)?.run(&abbe_core::Monitor::default())?;
    let mut all = Vec::new();
    for fit in &outcome.fits {
        // A calibration carries its model: a calibration.json from disk (`Calibration::from_json`) does as well.
        let model = model_of(&fit.calibration, &registry)?;
        let status: Vec<f64> = (model.info().status.iter())
            .map(|column| match column.name.as_str() {
                "B" => 90_f64.to_radians(),
                "C" => 180_f64.to_radians(),
                _ => 0.0,
            })
            .collect();
        let values: Vec<f64> = fit.calibration.parameters.iter().map(|parameter| parameter.value).collect();
        let tip = |values: &[f64]| -> Result<[f64; 3]> {
            let mut poses = Poses::default();
            model.poses(&status, values, &[], false, &mut poses)?;
            Ok(poses.positions[0])
        };
        let (real, nominal) = (tip(&values)?, tip(&model.info().nominal)?);
        all.push((fit.name.clone(), [0, 1, 2].map(|axis| real[axis] - nominal[axis])));
    }
    Ok(all)
}
