//! What is measured on a random machine: an artefact on its table and the programme that measures it, as files of a recipe.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use abbe_core::{AxisKind, KinematicModel, Poses};
use abbe_estimation::InverseKinematics;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde_json::{Value, json};

use crate::Random;
use crate::machine::Artefact;

/// Positions of the rotary axes by their status, degrees.
pub type Indexation = BTreeMap<usize, f64>;

/// A point that the tip goes to, with the cells that stand in its row before the axes.
struct Point {
    cells: String,
    tip: [f64; 3],
}

/// Rows of a programme, and the artefact stage that reads them.
struct Programme {
    text: String,
    stage: Value,
}

/// Writes the programme, with the nominal artefact beside it; gives the artefact stage.
pub fn write(
    random: &mut Random,
    artefact: Artefact,
    model: &dyn KinematicModel,
    indexations: &[Indexation],
    file: &Path,
) -> Value {
    let features: Vec<[f64; 3]> = (0..random.count(3, 8)).map(|_| place(random)).collect();
    let nominal = |text: String| fs::write(file.with_file_name("nominal.csv"), text).expect("the folder is there");
    let measured = |columns: &str, points: Vec<Point>, stage: Value| Programme {
        text: rows(model, columns, &points, indexations),
        stage,
    };
    let Programme { text, mut stage } = match artefact {
        Artefact::Facets => {
            let (text, points) = facets(random, &features);
            nominal(text);
            measured("feature", points, json!({ "artefact": "facets", "nominal": "nominal.csv" }))
        }
        Artefact::Probed => {
            let (text, points) = probed(random, model, &features);
            nominal(text);
            let stage = json!({ "artefact": "probed-points", "nominal": "nominal.csv" });
            Programme { text: with_measured(model, &points, indexations), stage }
        }
        Artefact::Touches | Artefact::Centres => {
            let touches = artefact == Artefact::Touches;
            let (text, points) = balls(random, &features, touches);
            nominal(text);
            let kind = if touches { "touches" } else { "centres" };
            measured("feature", points, json!({ "artefact": "balls", "nominal": "nominal.csv", "rows": kind }))
        }
        Artefact::Bar => {
            let (text, points) = bar(random, &features);
            nominal(text);
            let lengths = random.of(&["known", "estimated"]);
            let stage = json!({ "artefact": "ball-bar", "nominal": "nominal.csv", "bars_mm": { "100": 100 }, "lengths": lengths });
            measured("ball,test,reading_mm", points, stage)
        }
        Artefact::Plate => {
            let (points_text, placements, points) = plate(random);
            nominal(points_text);
            fs::write(file.with_file_name("placements.csv"), placements).expect("the folder is there");
            let stage =
                json!({ "artefact": "calibrated-points", "points": "nominal.csv", "placements": "placements.csv" });
            measured("point,placement", points, stage)
        }
        Artefact::Lengths => lengths(random, model, indexations),
        Artefact::Direct => direct(random),
        Artefact::Poses => {
            // What is observed follows from the true machine, and is filled in when that is known.
            let points: Vec<Point> =
                features.iter().map(|tip| Point { cells: OBSERVED.map(|_| "0").join(","), tip: *tip }).collect();
            let observer = random.of(&["estimated", "at-tool"]);
            let stage = json!({ "artefact": "poses", "observer": observer, "standard_uncertainty_urad": 10 });
            measured(&OBSERVED.join(","), points, stage)
        }
    };
    if stage.get("standard_uncertainty_um").is_none()
        && stage.get("standard_uncertainty_urad").is_none_or(|_| artefact == Artefact::Poses)
    {
        stage["standard_uncertainty_um"] = json!(1);
    }
    fs::write(file, text).expect("the folder is there");
    stage
}

fn place(random: &mut Random) -> [f64; 3] {
    [random.within(150.0), random.within(150.0), random.within(100.0)].map(f64::round)
}

fn at(point: [f64; 3], by: [f64; 3], size: f64) -> [f64; 3] {
    [0, 1, 2].map(|k| point[k] + by[k] * size)
}

fn facets(random: &mut Random, features: &[[f64; 3]]) -> (String, Vec<Point>) {
    let mut text = "feature,x_mm,y_mm,z_mm,nx,ny,nz\n".to_owned();
    let normals = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut points = Vec::new();
    for (index, point) in features.iter().chain(features).enumerate() {
        let (label, normal) = (format!("{}", index + 1), random.of(&normals));
        let [x, y, z] = at(*point, [1.0, 0.5, 0.25], 10.0 * index as f64);
        let [nx, ny, nz] = normal;
        writeln!(text, "{label},{x},{y},{z},{nx},{ny},{nz}").expect("a text");
        points.push(Point { cells: label, tip: at([x, y, z], normal, 3.0) });
    }
    (text, points)
}

/// Points that are touched along the linear axis that moves the tip most along their normal, nearly upright or slanted.
fn probed(random: &mut Random, model: &dyn KinematicModel, features: &[[f64; 3]]) -> (String, Vec<(Point, usize)>) {
    let mut text = "point,facet,x_mm,y_mm,z_mm,nx,ny,nz,approach\n".to_owned();
    let mut points = Vec::new();
    for (index, point) in features.iter().chain(features).enumerate() {
        let [x, y, z] = at(*point, [1.0, 0.5, 0.25], 10.0 * index as f64);
        let (along, sense) = (random.count(0, 3), random.of(&[1.0, -1.0]));
        let slanted = if random.chance(0.3) { 0.4 } else { 0.0 };
        let normal =
            Vector3::from_fn(|k, _| if k == along { -sense } else { slanted * random.within(1.0) }).normalize();
        let axis = ["X", "Y", "Z"][along];
        let carries_table =
            model.info().axes.iter().find(|own| own.name == axis).is_some_and(|own| moves_table(model, own.status));
        let sign = if (sense > 0.0) == carries_table { "-" } else { "+" };
        let [nx, ny, nz] = [normal.x, normal.y, normal.z];
        writeln!(text, "{0},{0},{x},{y},{z},{nx},{ny},{nz},{sign}{axis}", index + 1).expect("a text");
        points.push((Point { cells: format!("{}", index + 1), tip: at([x, y, z], [nx, ny, nz], 3.0) }, along));
    }
    (text, points)
}

/// Whether a positive command of a linear axis moves the tip against its direction relative to the table.
fn moves_table(model: &dyn KinematicModel, status: usize) -> bool {
    let mut here = vec![0.0; model.info().status.len()];
    let reach = InverseKinematics::new(model, &model.info().nominal, None);
    let axis = model.info().axes.iter().find(|axis| axis.status == status).map_or("", |axis| axis.name.as_str());
    let along = ["X", "Y", "Z"].iter().position(|name| *name == axis).unwrap_or(0);
    let start = here.clone();
    here[status] = 1.0;
    let tips = reach.tips(&[start, here]).expect("a serial chain has all poses");
    tips[1][along] < tips[0][along]
}

fn balls(random: &mut Random, features: &[[f64; 3]], touches: bool) -> (String, Vec<Point>) {
    let mut text = "feature,x_mm,y_mm,z_mm,diameter_mm\n".to_owned();
    let mut points = Vec::new();
    for (index, point) in features.iter().enumerate() {
        let (label, [x, y, z]) = (format!("{}", index + 1), *point);
        writeln!(text, "{label},{x},{y},{z},20").expect("a text");
        for _ in 0..if touches { 6 } else { 1 } {
            let away = random.direction();
            let tip = if touches { at(*point, away, 13.0) } else { *point };
            points.push(Point { cells: label.clone(), tip });
        }
    }
    (text, points)
}

fn bar(random: &mut Random, features: &[[f64; 3]]) -> (String, Vec<Point>) {
    let mut text = "feature,x_mm,y_mm,z_mm\n".to_owned();
    let mut points = Vec::new();
    for (index, point) in features.iter().take(3).enumerate() {
        let [x, y, z] = *point;
        writeln!(text, "{},{x},{y},{z}", index + 1).expect("a text");
        for _ in 0..12 {
            let away = random.direction();
            points.push(Point { cells: format!("{0},{0},0", index + 1), tip: at(*point, away, 100.0) });
        }
    }
    (text, points)
}

/// The points of a plate, its placements, and where its points then are.
fn plate(random: &mut Random) -> (String, String, Vec<Point>) {
    let own: Vec<[f64; 3]> =
        (0..8).map(|_| [random.within(100.0), random.within(100.0), random.within(20.0)]).collect();
    let mut calibrated = "point,x_mm,y_mm,z_mm\n".to_owned();
    for (index, [x, y, z]) in own.iter().enumerate() {
        writeln!(calibrated, "{},{x},{y},{z}", index + 1).expect("a text");
    }
    let mut placements = "placement,x_mm,y_mm,z_mm,ux,uy,uz,vx,vy,vz\n".to_owned();
    let frames = [[[1, 0, 0], [0, 1, 0]], [[0, 1, 0], [0, 0, 1]], [[0, 0, 1], [1, 0, 0]]];
    let mut points = Vec::new();
    for (index, [u, v]) in frames.into_iter().take(random.count(1, 4)).enumerate() {
        let [x, y, z] = place(random);
        writeln!(placements, "{},{x},{y},{z},{},{},{},{},{},{}", index + 1, u[0], u[1], u[2], v[0], v[1], v[2])
            .expect("a text");
        let w = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        for (point, own) in own.iter().enumerate() {
            let along = |k: usize| f64::from(u[k]) * own[0] + f64::from(v[k]) * own[1] + f64::from(w[k]) * own[2];
            let tip = [x + along(0), y + along(1), z + along(2)];
            points.push(Point { cells: format!("{},{}", point + 1, index + 1), tip });
        }
    }
    (calibrated, placements, points)
}

/// Where the axes stand with the tip at each point in each indexation; none where it cannot be.
fn statuses(model: &dyn KinematicModel, tips: &[[f64; 3]], angles: &Indexation) -> Vec<Option<Vec<f64>>> {
    let mut status = vec![0.0; model.info().status.len()];
    angles.iter().for_each(|(at, angle)| status[*at] = angle.to_radians());
    let values = &model.info().nominal;
    InverseKinematics::new(model, values, None)
        .solve(vec![status; tips.len()], tips)
        .expect("a serial chain has all poses")
}

/// Columns of the axes: name, unit, and the factor to it.
fn columns_of(model: &dyn KinematicModel) -> Vec<(String, &'static str, f64, usize)> {
    let of = |axis: &abbe_core::Axis| match axis.kind {
        AxisKind::Linear => (axis.name.clone(), "_mm", 1.0, axis.status),
        AxisKind::Rotary => (axis.name.clone(), "_deg", 1.0_f64.to_degrees(), axis.status),
    };
    model.info().axes.iter().map(of).collect()
}

/// The cells of the axes at a status.
fn cells(model: &dyn KinematicModel, status: &[f64]) -> String {
    let cells: Vec<String> =
        columns_of(model).iter().map(|(.., factor, at)| format!("{}", status[*at] * factor)).collect();
    cells.join(",")
}

/// The names of the columns of the axes, with a number where a row has several poses.
fn names(model: &dyn KinematicModel, number: &str) -> String {
    let names: Vec<String> = columns_of(model).iter().map(|(name, unit, ..)| format!("{name}{number}{unit}")).collect();
    names.join(",")
}

fn rows(model: &dyn KinematicModel, columns: &str, points: &[Point], indexations: &[Indexation]) -> String {
    let mut text = format!("{columns},{}\n", names(model, ""));
    let tips: Vec<[f64; 3]> = points.iter().map(|point| point.tip).collect();
    for angles in indexations {
        for (point, status) in points.iter().zip(statuses(model, &tips, angles)) {
            let Some(status) = status else { continue };
            writeln!(text, "{},{}", point.cells, cells(model, &status)).expect("a text");
        }
    }
    text
}

/// The rows of points that are touched along one axis: its position is what was measured.
fn with_measured(model: &dyn KinematicModel, points: &[(Point, usize)], indexations: &[Indexation]) -> String {
    let mut text = format!("point,measured_mm,{}\n", names(model, ""));
    let tips: Vec<[f64; 3]> = points.iter().map(|(point, _)| point.tip).collect();
    for angles in indexations {
        for ((point, along), status) in points.iter().zip(statuses(model, &tips, angles)) {
            let Some(status) = status else { continue };
            let axis = model.info().axes.iter().find(|axis| axis.name == ["X", "Y", "Z"][*along]);
            let measured = axis.map_or(0.0, |axis| status[axis.status]);
            writeln!(text, "{},{measured},{}", point.cells, cells(model, &status)).expect("a text");
        }
    }
    text
}

fn lengths(random: &mut Random, model: &dyn KinematicModel, indexations: &[Indexation]) -> Programme {
    let mut ends = Vec::new();
    for _ in 0..20 {
        let start = place(random);
        let away = random.direction();
        ends.extend([start, at(start, away, random.between(50.0, 250.0))]);
    }
    let mut text = format!("reference_mm,{},{}\n", names(model, "1"), names(model, "2"));
    for angles in indexations {
        let statuses = statuses(model, &ends, angles);
        for (ends, at) in ends.chunks_exact(2).zip(statuses.chunks_exact(2)) {
            let [Some(start), Some(end)] = at else { continue };
            let length = (Vector3::from(ends[1]) - Vector3::from(ends[0])).norm();
            writeln!(text, "{length:.9},{},{}", cells(model, start), cells(model, end)).expect("a text");
        }
    }
    Programme { text, stage: json!({ "artefact": "length", "standard_uncertainty_um": 1 }) }
}

/// Displacements and straightnesses along linear axes, or their rotations, each along some lines.
fn direct(random: &mut Random) -> Programme {
    let axes = ["X", "Y", "Z"];
    let angles = random.chance(0.4);
    let reading = if angles { "reading_urad" } else { "reading_um" };
    let mut text = format!("what,{reading},position_mm\n");
    let mut measurements = serde_json::Map::new();
    for index in 0..random.count(1, 9) {
        let moves = random.count(0, 3);
        let read = if random.chance(0.4) { moves } else { random.count(0, 3) };
        let others = (0..3)
            .filter(|axis| *axis != moves)
            .map(|axis| (axes[axis].to_owned(), json!(random.within(150.0).round())));
        let others: serde_json::Map<String, Value> = others.collect();
        let kind = match (angles, read == moves) {
            (true, _) => "angle",
            (false, true) => "displacement",
            (false, false) => "straightness",
        };
        let name = format!("line-{index}");
        let mut measurement = json!({ "kind": kind, "moves": axes[moves], "at_mm": others });
        if kind != "displacement" {
            measurement["direction"] = json!(axes[read]);
        }
        measurements.insert(name.clone(), measurement);
        let (from, count) = (random.within(50.0).round() - 150.0, random.count(6, 16));
        for step in 0..count {
            writeln!(text, "{name},0,{}", from + 300.0 * step as f64 / count as f64).expect("a text");
        }
    }
    let uncertainty = if angles { "standard_uncertainty_urad" } else { "standard_uncertainty_um" };
    let stage = json!({ "artefact": "direct", "measurement": "what", "measurements": measurements, uncertainty: 1 });
    Programme { text, stage }
}

/// Columns of an observed pose.
const OBSERVED: [&str; 7] = ["x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"];

/// Noise of an observed pose, mm and rad.
pub struct PoseNoise {
    /// Of each coordinate.
    pub length: f64,
    /// Of each component of the rotation.
    pub angle: f64,
}

/// Fills in what a target on the table looks like from the tool of a machine with these values of its parameters.
pub fn observe(
    random: &mut Random,
    model: &dyn KinematicModel,
    values: &[f64],
    at_tool: bool,
    noise: &PoseNoise,
    file: &Path,
) {
    let text = fs::read_to_string(file).expect("the programme is there");
    let turned = |random: &mut Random| {
        UnitQuaternion::from_scaled_axis(Vector3::from(random.direction()) * random.between(0.1, 2.5))
    };
    let (target, target_turned) = (Vector3::from(place(random)), turned(random));
    let (observer, observer_turned) = match at_tool {
        true => (Vector3::zeros(), UnitQuaternion::identity()),
        false => (Vector3::from(place(random)), turned(random)),
    };
    let mut lines = text.lines();
    let mut written = format!("{}\n", lines.next().unwrap_or_default());
    for line in lines {
        let commands: Vec<&str> = line.split(',').skip(OBSERVED.len()).collect();
        let mut status = vec![0.0; model.info().status.len()];
        for ((.., factor, at), command) in columns_of(model).iter().zip(&commands) {
            status[*at] = command.parse::<f64>().expect("a number") / factor;
        }
        let mut poses = Poses::default();
        model.poses(&status, values, &[], true, &mut poses).expect("a serial chain has all poses");
        let [w, x, y, z] = poses.orientations[0];
        let tool = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let mut normal = |size: f64| Vector3::from_fn(|_, _| size * random.normal());
        let seen = observer_turned.inverse()
            * (tool.inverse() * (target - Vector3::from(poses.positions[0])) - observer)
            + normal(noise.length);
        let turn = UnitQuaternion::from_scaled_axis(normal(noise.angle))
            * observer_turned.inverse()
            * tool.inverse()
            * target_turned;
        let numbers = [seen.x, seen.y, seen.z, turn.w, turn.i, turn.j, turn.k].map(|number| format!("{number}"));
        writeln!(written, "{},{}", numbers.join(","), commands.join(",")).expect("a text");
    }
    fs::write(file, written).expect("the folder is there");
}
