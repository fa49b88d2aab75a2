//! The measuring program of a calibration that begins: how its probe and what stands on the table are taken to be.

use abbe_kinematics::StructuralLoop;

use super::{Controller, Method};

/// What surrounds an artefact, table frame.
struct Surroundings {
    /// Centre and radius of a sphere outside of which nothing stands.
    sphere: ([f64; 3], f64),
    /// Settings of the solids on the table.
    solids: &'static str,
}

/// As of `Method::nominal`.
fn surroundings(method: Method) -> Option<Surroundings> {
    let (centre, radius, solids) = match method {
        Method::Table => ([0.0, 0.0, -30.0], 230.0, "box: { from_mm: [-150, -150, -60], to_mm: [150, 150, 0] }"),
        Method::Ball => {
            ([60.0, 20.0, 60.0], 140.0, "cylinder: { from_mm: [90, 30, 0], to_mm: [90, 30, 108], radius_mm: 5 }")
        }
        Method::Balls => ([0.0, 0.0, 80.0], 190.0, "box: { from_mm: [-150, -150, -40], to_mm: [150, 150, 0] }"),
        Method::BallBar | Method::Poses | Method::Lengths => return None,
    };
    Some(Surroundings { sphere: (centre, radius), solids })
}

/// The name of a control in `plan: program`, and the reader of its logs.
fn names(controller: Controller) -> (&'static str, &'static str) {
    match controller {
        Controller::Linuxcnc => ("linuxcnc", "linuxcnc-log"),
        Controller::Fanuc => ("fanuc", "dprnt"),
        Controller::Siemens => ("siemens", "siemens-log"),
        Controller::Heidenhain => ("heidenhain", "heidenhain-log"),
        Controller::Grbl => ("grbl", "grbl-log"),
    }
}

/// Whether a program is written: a touch probe measures, and the names of axes are letters that controls have.
pub fn is_written(method: Method, chain: &StructuralLoop) -> bool {
    surroundings(method).is_some() && chain.axes.iter().all(|axis| axis.name.len() == 1)
}

/// The key `program` under `plan`; nothing where none is written.
pub fn program(method: Method, controller: Controller, chain: &StructuralLoop) -> String {
    let around = surroundings(method).filter(|_| is_written(method, chain));
    let Some(Surroundings { sphere: ([x, y, z], radius), solids }) = around else { return String::new() };
    let (control, _) = names(controller);
    format!(
        "  program:                              # is written beside the plan, with a dry run; read docs/measure.md first\n    \
         control: {control}\n    \
         probe: [{{ diameter_mm: 4, length_mm: 60 }}, {{ diameter_mm: 40, length_mm: 90 }}]   # fill in: from tip to spindle\n    \
         clearance: {{ sphere: {{ centre_mm: [{x}, {y}, {z}], radius_mm: {radius} }} }}   # fill in: nothing stands outside\n    \
         solids: [{{ {solids} }}]   # fill in: what stands on the table\n    \
         measuring_feed_mm_per_min: 30\n    \
         unreachable: leave-out              # touches that cannot be reached are named, and not made\n"
    )
}

/// How the log of the program is read instead of a table, by a stage of this name.
pub fn reader(controller: Controller, ingest: &str) -> String {
    let (_, reader) = names(controller);
    let line = format!("{ingest}: {{ ingest: {reader}, path: measure.log, plan: plan/plan.csv, repeats: average }}");
    format!("  # {line}   # the log of the program in its place\n")
}
