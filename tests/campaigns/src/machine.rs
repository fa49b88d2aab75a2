//! A random machine.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use abbe_core::{AxisKind, Build, Context, Kind, KinematicModel, Parameter, ParameterRole, Quantity, Registry};
use serde_json::{Value, json};

use crate::programme::Indexation;
use crate::{Random, programme};

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Artefact {
    /// Touches on plane facets.
    Facets,
    /// Touches on balls.
    Touches,
    /// The machine at the centres of balls.
    Centres,
    /// A ball bar.
    Bar,
    /// Lengths of a laser.
    Lengths,
    /// A calibrated plate in several placements.
    Plate,
    /// Points that are touched along one axis.
    Probed,
    /// Single errors that instruments read along lines.
    Direct,
    /// A target with six degrees of freedom.
    Poses,
}

/// All of them.
pub const ARTEFACTS: [Artefact; 9] = [
    Artefact::Facets,
    Artefact::Touches,
    Artefact::Centres,
    Artefact::Bar,
    Artefact::Lengths,
    Artefact::Plate,
    Artefact::Probed,
    Artefact::Direct,
    Artefact::Poses,
];

/// Terms of a probe. A delay needs feeds, which the programmes do not have.
const PROBE: [&str; 8] =
    ["r0", "lobe[cos0,2]", "lobe[cos2]", "lobe[sin2]", "lobe[cos3]", "lobe[sin3]", "lobe[cos3,1]", "lobe[cos6]"];

/// A machine with its measurement, in a folder of its own.
pub struct Case {
    /// What is measured.
    pub artefact: Artefact,
    /// Settings of the model.
    pub machine: Value,
    /// The nominal machine.
    pub model: Arc<dyn KinematicModel>,
    /// The artefact stage of the recipe.
    pub stage: Value,
    /// Name of the file of the programme.
    pub programme: PathBuf,
}

/// A model of these settings.
pub fn model(settings: &Value) -> Arc<dyn KinematicModel> {
    let registry = Registry::built_in().expect("the plugins have different names");
    let plugin = registry.find(Kind::Model, "serial-chain").expect("it is built in");
    let Build::Model(constructor) = &plugin.build else { unreachable!("it is a model") };
    let built = constructor.build(settings, &Context { base: PathBuf::new() });
    let built = built.unwrap_or_else(|error| panic!("{settings}: {}", error.message));
    built.build(&[]).unwrap_or_else(|error| panic!("{settings}: {error}"))
}

/// A machine of three linear and up to three rotary axes in any order.
pub fn machine(random: &mut Random) -> Value {
    let rotary: Vec<&str> = random.shuffled(&["A", "B", "C"]).into_iter().take(random.count(0, 4)).collect();
    let axes: Vec<&str> = random.shuffled(&[&["X", "Y", "Z"][..], &rotary].concat());
    let split = random.count(0, axes.len() + 1);
    let mut chain = "w".to_owned();
    axes[..split].iter().for_each(|axis| write!(chain, " {axis}'").expect("a text"));
    chain.push_str(" b");
    axes[split..].iter().for_each(|axis| write!(chain, " {axis}").expect("a text"));
    chain.push_str(" t");
    let apart = random.chance(0.5);
    let mut settings = serde_json::Map::new();
    for axis in &axes {
        let own = match ["X", "Y", "Z"].contains(axis) {
            true => json!({ "range_mm": [-2000, 2000] }),
            false => {
                let point = if apart { [(); 3].map(|()| random.within(150.0).round()) } else { [0.0; 3] };
                json!({ "range_deg": [-180, 180], "point_mm": point })
            }
        };
        settings.insert((*axis).to_owned(), own);
    }
    let mut errors = vec![json!({ "location": ["E?0?"] })];
    if random.chance(0.6) {
        errors.push(json!({ "polynomial": [format!("E?{}", random.of(&["X", "Y", "Z"]))], "degrees": [1, 2] }));
    }
    json!({
        "chain": chain,
        "tool_length_mm": random.between(50.0, 250.0).round(),
        "stylus_radius_mm": 3.0,
        "axes": settings,
        "errors": errors,
    })
}

/// Names and positions of the rotary axes of a programme: commands in degrees, one list an indexation.
fn indexations(random: &mut Random, model: &dyn KinematicModel) -> Vec<Indexation> {
    let rotary: Vec<usize> =
        model.info().axes.iter().filter(|axis| axis.kind == AxisKind::Rotary).map(|axis| axis.status).collect();
    // Axes that stand still leave parameters without effect.
    let still: Vec<bool> = rotary.iter().map(|_| random.chance(0.2)).collect();
    let count = if rotary.is_empty() { 1 } else { random.of(&[1, 4, 12, 12, 12]) };
    let round = random.chance(0.5);
    (0..count)
        .map(|_| {
            let angle = |(status, still): (&usize, &bool), random: &mut Random| {
                let angle = match (still, round) {
                    (true, _) => 0.0,
                    (false, true) => random.of(&[-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0]),
                    (false, false) => random.within(100.0),
                };
                (*status, angle)
            };
            rotary.iter().zip(&still).map(|place| angle(place, random)).collect()
        })
        .collect()
}

impl Case {
    /// A random machine with a random artefact, written into a folder.
    pub fn new(random: &mut Random, folder: &Path) -> Self {
        Self::of(random, &ARTEFACTS, folder)
    }

    /// The same with one of these artefacts.
    pub fn of(random: &mut Random, artefacts: &[Artefact], folder: &Path) -> Self {
        let artefact = random.of(artefacts);
        let mut machine = machine(random);
        let bare = model(&machine);
        let programme = PathBuf::from("programme.csv");
        let indexations = indexations(random, bare.as_ref());
        let stage = programme::write(random, artefact, bare.as_ref(), &indexations, &folder.join(&programme));
        if random.chance(0.35) {
            let terms = random.count(1, PROBE.len() + 1);
            machine["probe"] = json!(random.shuffled(&PROBE)[..terms]);
        }
        let model = model(&machine);
        Self { artefact, machine, model, stage, programme }
    }
}

/// A value that a parameter may have on a real machine.
pub fn error(random: &mut Random, parameter: &Parameter) -> f64 {
    if let ParameterRole::Probe { .. } = parameter.role {
        return random.within(0.01);
    }
    let size = match (parameter.unit.of, parameter.unit.per) {
        (Quantity::Angle, None) => 1e-4,
        (Quantity::Length, None) => 0.05,
        (Quantity::Angle, Some((_, degree))) => 1e-4 / 200.0_f64.powi(i32::from(degree)),
        (_, Some((_, degree))) => 0.02 / 200.0_f64.powi(i32::from(degree)),
        _ => 1e-4,
    };
    random.within(size)
}
