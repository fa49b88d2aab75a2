//! A random machine, an artefact on its table, and a programme that measures it: as files of a recipe.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use abbe_core::{AxisKind, Build, Context, Kind, KinematicModel, Parameter, Quantity, Registry};
use abbe_estimation::Reach;
use serde_json::{Value, json};

use crate::Random;

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
}

/// All of them.
pub const ARTEFACTS: [Artefact; 6] =
    [Artefact::Facets, Artefact::Touches, Artefact::Centres, Artefact::Bar, Artefact::Lengths, Artefact::Plate];

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
fn indexations(random: &mut Random, model: &dyn KinematicModel) -> Vec<BTreeMap<usize, f64>> {
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
        let artefact = random.of(&ARTEFACTS);
        let machine = machine(random);
        let model = model(&machine);
        let programme = PathBuf::from("programme.csv");
        let stage = write(random, artefact, model.as_ref(), folder, &programme);
        Self { artefact, machine, model, stage, programme }
    }
}

/// Points that the tip goes to, with the labels that belong to them.
struct Point {
    labels: Vec<String>,
    tip: [f64; 3],
}

fn write(
    random: &mut Random,
    artefact: Artefact,
    model: &dyn KinematicModel,
    folder: &Path,
    programme: &Path,
) -> Value {
    let place =
        |random: &mut Random| [random.within(150.0), random.within(150.0), random.within(100.0)].map(f64::round);
    let features: Vec<[f64; 3]> = (0..random.count(3, 8)).map(|_| place(random)).collect();
    let file = |name: &str, text: &str| fs::write(folder.join(name), text).expect("the folder is there");
    let at = |point: [f64; 3], by: [f64; 3], size: f64| [0, 1, 2].map(|k| point[k] + by[k] * size);
    let (columns, points, stage): (&str, Vec<Point>, Value) = match artefact {
        Artefact::Facets => {
            let mut text = "feature,x_mm,y_mm,z_mm,nx,ny,nz\n".to_owned();
            let normals = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];
            let mut points = Vec::new();
            for (index, point) in features.iter().chain(&features.clone()).enumerate() {
                let (label, normal) = (format!("{}", index + 1), random.of(&normals));
                let [x, y, z] = at(*point, [1.0, 0.5, 0.25], 10.0 * index as f64);
                let [nx, ny, nz] = normal;
                writeln!(text, "{label},{x},{y},{z},{nx},{ny},{nz}").expect("a text");
                points.push(Point { labels: vec![label], tip: at([x, y, z], normal, 3.0) });
            }
            file("nominal.csv", &text);
            ("feature", points, json!({ "artefact": "facets", "nominal": "nominal.csv", "standard_uncertainty_um": 1 }))
        }
        Artefact::Touches | Artefact::Centres => {
            let mut text = "feature,x_mm,y_mm,z_mm,diameter_mm\n".to_owned();
            let mut points = Vec::new();
            let touches = artefact == Artefact::Touches;
            for (index, point) in features.iter().enumerate() {
                let (label, [x, y, z]) = (format!("{}", index + 1), *point);
                writeln!(text, "{label},{x},{y},{z},20").expect("a text");
                for _ in 0..if touches { 6 } else { 1 } {
                    let away = random.direction();
                    let tip = if touches { at(*point, away, 13.0) } else { *point };
                    points.push(Point { labels: vec![label.clone()], tip });
                }
            }
            file("nominal.csv", &text);
            let rows = if touches { "touches" } else { "centres" };
            (
                "feature",
                points,
                json!({ "artefact": "balls", "nominal": "nominal.csv", "rows": rows, "standard_uncertainty_um": 1 }),
            )
        }
        Artefact::Bar => {
            let mut text = "feature,x_mm,y_mm,z_mm\n".to_owned();
            let mut points = Vec::new();
            for (index, point) in features.iter().take(3).enumerate() {
                let (label, [x, y, z]) = (format!("{}", index + 1), *point);
                writeln!(text, "{label},{x},{y},{z}").expect("a text");
                for _ in 0..12 {
                    let away = random.direction();
                    let labels = vec![label.clone(), label.clone(), "0".to_owned()];
                    points.push(Point { labels, tip: at(*point, away, 100.0) });
                }
            }
            file("nominal.csv", &text);
            let lengths = random.of(&["known", "estimated"]);
            (
                "ball,test,reading_mm",
                points,
                json!({ "artefact": "ball-bar", "nominal": "nominal.csv", "bars_mm": { "100": 100 }, "lengths": lengths,
                        "standard_uncertainty_um": 1 }),
            )
        }
        Artefact::Lengths => {
            // Two poses a row: written below.
            let mut points = Vec::new();
            for _ in 0..20 {
                let start = place(random);
                let away = random.direction();
                let end = at(start, away, random.between(50.0, 250.0));
                let length = (0..3).map(|k| (end[k] - start[k]).powi(2)).sum::<f64>().sqrt();
                points.push(Point { labels: Vec::new(), tip: start });
                points.push(Point { labels: vec![format!("{length:.9}")], tip: end });
            }
            ("reference_mm", points, json!({ "artefact": "length", "standard_uncertainty_um": 1 }))
        }
        Artefact::Plate => {
            let mut text = "point,x_mm,y_mm,z_mm\n".to_owned();
            let own: Vec<[f64; 3]> =
                (0..8).map(|_| [random.within(100.0), random.within(100.0), random.within(20.0)]).collect();
            for (index, [x, y, z]) in own.iter().enumerate() {
                writeln!(text, "{},{x},{y},{z}", index + 1).expect("a text");
            }
            file("points.csv", &text);
            let mut text = "placement,x_mm,y_mm,z_mm,ux,uy,uz,vx,vy,vz\n".to_owned();
            let frames = [[[1, 0, 0], [0, 1, 0]], [[0, 1, 0], [0, 0, 1]], [[0, 0, 1], [1, 0, 0]]];
            let mut points = Vec::new();
            for (index, [u, v]) in frames.into_iter().take(random.count(1, 4)).enumerate() {
                let [x, y, z] = place(random);
                writeln!(text, "{},{x},{y},{z},{},{},{},{},{},{}", index + 1, u[0], u[1], u[2], v[0], v[1], v[2])
                    .expect("a text");
                let w = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
                for (point, own) in own.iter().enumerate() {
                    let along =
                        |k: usize| f64::from(u[k]) * own[0] + f64::from(v[k]) * own[1] + f64::from(w[k]) * own[2];
                    let tip = [x + along(0), y + along(1), z + along(2)];
                    points.push(Point { labels: vec![format!("{}", point + 1), format!("{}", index + 1)], tip });
                }
            }
            file("placements.csv", &text);
            (
                "point,placement",
                points,
                json!({ "artefact": "calibrated-points", "points": "points.csv", "placements": "placements.csv",
                        "standard_uncertainty_um": 1 }),
            )
        }
    };
    let indexations = indexations(random, model);
    let text = match artefact {
        Artefact::Lengths => lengths(model, columns, &points, &indexations),
        _ => rows(model, columns, &points, &indexations),
    };
    file(&programme.to_string_lossy(), &text);
    stage
}

/// Where the axes stand with the tip at each point in each indexation; none where it cannot be.
fn statuses(model: &dyn KinematicModel, points: &[Point], angles: &BTreeMap<usize, f64>) -> Vec<Option<Vec<f64>>> {
    let mut status = vec![0.0; model.info().status.len()];
    angles.iter().for_each(|(at, angle)| status[*at] = angle.to_radians());
    let tips: Vec<[f64; 3]> = points.iter().map(|point| point.tip).collect();
    let values = &model.info().nominal;
    Reach::new(model, values, None).at(vec![status; points.len()], &tips).expect("a serial chain has all poses")
}

/// Columns of the axes: name, unit, and the factor to it.
fn columns_of(model: &dyn KinematicModel) -> Vec<(String, &'static str, f64, usize)> {
    let of = |axis: &abbe_core::Axis| match axis.kind {
        AxisKind::Linear => (axis.name.clone(), "_mm", 1.0, axis.status),
        AxisKind::Rotary => (axis.name.clone(), "_deg", 1.0_f64.to_degrees(), axis.status),
    };
    model.info().axes.iter().map(of).collect()
}

fn rows(model: &dyn KinematicModel, columns: &str, points: &[Point], indexations: &[BTreeMap<usize, f64>]) -> String {
    let axes = columns_of(model);
    let names: Vec<String> = axes.iter().map(|(name, unit, ..)| format!("{name}{unit}")).collect();
    let mut text = format!("{columns},{}\n", names.join(","));
    for angles in indexations {
        for (point, status) in points.iter().zip(statuses(model, points, angles)) {
            let Some(status) = status else { continue };
            let cells: Vec<String> = axes.iter().map(|(.., factor, at)| format!("{}", status[*at] * factor)).collect();
            writeln!(text, "{},{}", point.labels.join(","), cells.join(",")).expect("a text");
        }
    }
    text
}

fn lengths(model: &dyn KinematicModel, column: &str, points: &[Point], indexations: &[BTreeMap<usize, f64>]) -> String {
    let axes = columns_of(model);
    let names = |end: usize| axes.iter().map(move |(name, unit, ..)| format!("{name}{end}{unit}"));
    let names: Vec<String> = names(1).chain(names(2)).collect();
    let mut text = format!("{column},{}\n", names.join(","));
    for angles in indexations {
        let statuses = statuses(model, points, angles);
        for (ends, at) in points.chunks_exact(2).zip(statuses.chunks_exact(2)) {
            let [Some(start), Some(end)] = at else { continue };
            let cells = [start, end]
                .into_iter()
                .flat_map(|status| axes.iter().map(move |(.., factor, at)| format!("{}", status[*at] * factor)));
            writeln!(text, "{},{}", ends[1].labels[0], cells.collect::<Vec<_>>().join(",")).expect("a text");
        }
    }
    text
}

/// A value that a parameter may have on a real machine.
pub fn error(random: &mut Random, parameter: &Parameter) -> f64 {
    let size = match (parameter.unit.of, parameter.unit.per) {
        (Quantity::Angle, None) => 1e-4,
        (Quantity::Length, None) => 0.05,
        (Quantity::Angle, Some((_, degree))) => 1e-4 / 200.0_f64.powi(i32::from(degree)),
        (_, Some((_, degree))) => 0.02 / 200.0_f64.powi(i32::from(degree)),
        _ => 1e-4,
    };
    random.within(size)
}
