//! Proves that bodies move the machine as small rigid slices do, put one behind the other: random chains, bodies and temperatures; and
//! the cases of exact arithmetic, laws of warming, signs, derivatives, uncertainties and wrong declarations.

use abbe_core::{KinematicModel, Variable};
use nalgebra::{Matrix4, Rotation3, Unit, Vector3};
use serde_json::{Map, Value, json};

use crate::oracle::{Machine, OracleAxis, Random, place, rotation_vector, translation, turn};
use crate::subject;

/// Coefficients of expansion of the bodies here, 1/K.
const EXPANSION: f64 = 11.5e-6;

fn vector(value: &Value) -> Vector3<f64> {
    Vector3::from(<[f64; 3]>::deserialize(value))
}

/// Reads three numbers.
trait Three {
    fn deserialize(value: &Value) -> Self;
}

impl Three for [f64; 3] {
    fn deserialize(value: &Value) -> Self {
        std::array::from_fn(|part| value[part].as_f64().expect("a number"))
    }
}

fn rotation(about: Vector3<f64>, angle: f64) -> Matrix4<f64> {
    Rotation3::from_axis_angle(&Unit::new_normalize(about), angle).to_homogeneous()
}

/// A rotation about a line through a point.
fn about(point: Vector3<f64>, by: &Matrix4<f64>) -> Matrix4<f64> {
    translation(point) * by * translation(-point)
}

/// A straight body with temperatures as a plane over each section: T = a + g . (place from its axis).
#[derive(Debug, Clone)]
struct Profile {
    begin: Vector3<f64>,
    along: Vector3<f64>,
    /// Place, temperature on the axis above the reference, gradient.
    sections: Vec<(f64, f64, Vector3<f64>)>,
}

impl Profile {
    fn at(&self, x: f64) -> (f64, Vector3<f64>) {
        let (first, last) = (&self.sections[0], &self.sections[self.sections.len() - 1]);
        if x <= first.0 {
            return (first.1, first.2);
        }
        let pair = self.sections.windows(2).find(|pair| x <= pair[1].0);
        let Some([from, to]) = pair else { return (last.1, last.2) };
        let part = (x - from.0) / (to.0 - from.0);
        (from.1 + part * (to.1 - from.1), from.2 + (to.2 - from.2) * part)
    }

    /// What slices from one place to another do to all that is behind them.
    fn slices(&self, from: f64, to: f64, stretch: bool) -> Matrix4<f64> {
        let mut cuts = vec![from, to];
        cuts.extend(self.sections.iter().map(|section| section.0).filter(|x| (*x - from) * (*x - to) < 0.0));
        cuts.sort_by(f64::total_cmp);
        if from > to {
            cuts.reverse();
        }
        const SLICES: usize = 400;
        let mut total = Matrix4::identity();
        for pair in cuts.windows(2) {
            let step = (pair[1] - pair[0]) / SLICES as f64;
            for slice in 0..SLICES {
                let x = pair[0] + (slice as f64 + 0.5) * step;
                let (temperature, gradient) = self.at(x);
                // Warmer fibres are longer: the section turns about (along x gradient) the other way round.
                let bend = gradient.cross(&self.along) * (EXPANSION * step);
                let grown = if stretch { self.along * (EXPANSION * temperature * step) } else { Vector3::zeros() };
                let turned = if bend.norm() > 0.0 { rotation(bend, bend.norm()) } else { Matrix4::identity() };
                total *= translation(grown) * about(self.begin + self.along * x, &turned);
            }
        }
        total
    }

    /// Elongation between two places.
    fn growth(&self, from: f64, to: f64) -> f64 {
        let displaced = Profile {
            sections: self.sections.iter().map(|(x, a, _)| (*x, *a, Vector3::zeros())).collect(),
            ..self.clone()
        };
        place(&displaced.slices(from, to, true)).dot(&self.along)
    }
}

/// What a body does, where it stands in the loop.
enum Effect {
    /// Behind this axis (none: the bed), on the side of the tool or of the workpiece.
    Behind(Option<usize>, bool, Matrix4<f64>),
    /// What an axis carries.
    Carried(usize, Matrix4<f64>),
}

/// The machine as motions of what each axis carries, points in machine coordinates with all axes at zero; `tip` of the tool.
fn slices(machine: &Machine, tip: Vector3<f64>, commands: &[f64], effects: &[Effect]) -> Matrix4<f64> {
    let sense = |k: usize| if (k < machine.bed) == machine.axes[k].reverse { 1.0 } else { -1.0 };
    let motion = |k: usize| {
        let OracleAxis { rotary, direction, point, .. } = machine.axes[k];
        match rotary {
            true => about(point, &rotation(direction, sense(k) * commands[k])),
            false => translation(direction / direction.norm() * (sense(k) * commands[k])),
        }
    };
    let side = |order: Vec<usize>, of_tool: bool| {
        let all = |behind: Option<usize>| {
            let matching = effects.iter().filter_map(move |effect| match effect {
                Effect::Behind(axis, tool, by) if *axis == behind && *tool == of_tool => Some(by),
                _ => None,
            });
            matching.fold(Matrix4::identity(), |total, by| total * by)
        };
        let mut total = all(None);
        let mut origin = Vector3::zeros();
        for k in order {
            for effect in effects {
                if let Effect::Carried(axis, by) = effect
                    && *axis == k
                {
                    total *= by;
                }
            }
            total *= motion(k) * all(Some(k));
            if machine.axes[k].rotary {
                origin = machine.axes[k].point;
            }
        }
        (total, origin)
    };
    let (table, table_origin) = side((0..machine.bed).rev().collect(), false);
    let (tool, tool_origin) = side((machine.bed..machine.axes.len()).collect(), true);
    let table = table * translation(table_origin);
    table.try_inverse().expect("a rigid motion") * tool * translation(tool_origin + tip)
}

/// A random machine with a body at every frame, and random temperatures.
struct Case {
    machine: Machine,
    settings: Value,
    /// Name and profile of every body.
    profiles: Vec<(String, Profile)>,
    /// Temperatures by column.
    temperatures: Map<String, Value>,
}

fn offset(random: &mut Random, along: Vector3<f64>) -> Vector3<f64> {
    let any = random.vector(120.0);
    any - along * along.dot(&any)
}

/// A body of random sections, each with four sensors on a plane of temperatures.
fn body(random: &mut Random, name: &str, begin: Vector3<f64>, end: Vector3<f64>, case: &mut Case) -> Value {
    let (length, along) = ((end - begin).norm(), (end - begin).normalize());
    let count = 1 + random.below(4);
    let mut sections = Vec::new();
    let mut profile = Profile { begin, along, sections: Vec::new() };
    for index in 0..count {
        let x = length * (index as f64 + 0.5 + 0.4 * random.signed()) / count as f64;
        let temperature = 2.0 * random.signed();
        let gradient = offset(random, along) * 2e-4;
        let mut sensors = Map::new();
        for sensor in 0..4 {
            let at = offset(random, along);
            let column = format!("T_{name}_{index}_{sensor}");
            case.temperatures.insert(column.clone(), json!(20.0 + temperature + gradient.dot(&at)));
            sensors.insert(column, json!(<[f64; 3]>::from(at)));
        }
        sections.push(json!({ "at_mm": x, "sensors": sensors }));
        profile.sections.push((x, temperature, gradient));
    }
    case.profiles.push((name.to_owned(), profile));
    json!({
        "begin_mm": <[f64; 3]>::from(begin), "end_mm": <[f64; 3]>::from(end), "sections": sections,
        "expansion_per_K": EXPANSION, "standard_uncertainty_per_K": 0.5e-6,
    })
}

fn random_case(random: &mut Random) -> Case {
    let (machine, names, mut settings) = subject::random(random, "exact");
    settings["errors"] = json!([]);
    let mut case = Case { machine, settings, profiles: Vec::new(), temperatures: Map::new() };
    let mut bodies = Map::new();
    let count = case.machine.axes.len();
    let bed = case.machine.bed;
    let mut between: Vec<(String, String)> = Vec::new();
    let name = |k: usize| names[k].to_owned();
    // From the bed outwards.
    let tool: Vec<String> =
        std::iter::once("bed".to_owned()).chain((bed..count).map(name)).chain(["tool".to_owned()]).collect();
    let workpiece: Vec<String> =
        std::iter::once("bed".to_owned()).chain((0..bed).rev().map(name)).chain(["workpiece".to_owned()]).collect();
    for side in [tool, workpiece] {
        between.extend(side.windows(2).map(|pair| (pair[0].clone(), pair[1].clone())));
    }
    for (number, (from, to)) in between.into_iter().enumerate() {
        let key = format!("b{number}");
        let carrier = names.iter().position(|name| **name == from).filter(|k| !case.machine.axes[*k].rotary);
        let slides = carrier.filter(|_| random.one_in(2));
        let begin = random.vector(300.0);
        let way = match slides {
            Some(k) => case.machine.axes[k].direction.normalize() * if random.one_in(2) { -1200.0 } else { 1200.0 },
            None => random.vector(400.0) + Vector3::new(100.0, 0.0, 0.0),
        };
        let mut settings = body(random, &key, begin, begin + way, &mut case);
        settings["from"] = json!(from);
        settings["to"] = json!(to);
        settings["held_at_mm"] = json!(way.norm() * 0.5 * (1.0 + random.signed()));
        if slides.is_some() {
            settings["slides"] = json!(true);
            settings["at_zero_mm"] = json!(600.0 + 150.0 * random.signed());
        }
        bodies.insert(key, settings);
    }
    let linear: Vec<usize> = (0..count).filter(|k| !case.machine.axes[*k].rotary).collect();
    for k in linear {
        for what in ["guideway", "scale"] {
            let key = format!("{what}-{}", names[k]);
            let begin = random.vector(300.0);
            let way = case.machine.axes[k].direction.normalize() * if random.one_in(2) { -1300.0 } else { 1300.0 };
            let mut settings = body(random, &key, begin, begin + way, &mut case);
            settings[what] = json!(names[k]);
            settings["at_zero_mm"] = json!(650.0 + 150.0 * random.signed());
            settings["held_at_mm"] = json!(650.0 * (1.0 + random.signed()));
            if what == "scale" && random.one_in(2) {
                settings["slides"] = json!(true);
            }
            bodies.insert(key, settings);
        }
    }
    case.settings["bodies"] = Value::Object(bodies);
    case
}

impl Case {
    fn axis(&self, name: &str) -> Option<usize> {
        let names: Vec<String> = self.names();
        names.iter().position(|own| own == name)
    }

    fn names(&self) -> Vec<String> {
        let chain = self.settings["chain"].as_str().expect("a chain");
        chain.split(' ').filter(|part| !["w", "b", "t"].contains(part) && !part.is_empty()).map(str::to_owned).collect()
    }

    fn effects(&self, commands: &[f64]) -> Vec<Effect> {
        let mut effects = Vec::new();
        for (name, profile) in &self.profiles {
            let settings = &self.settings["bodies"][name];
            let number = |key: &str| settings[key].as_f64().unwrap_or(0.0);
            let (held, at_zero) = (number("held_at_mm"), number("at_zero_mm"));
            let end = (vector(&settings["end_mm"]) - vector(&settings["begin_mm"])).norm();
            let moved = |k: usize| {
                let axis = &self.machine.axes[k];
                let sense = if (k < self.machine.bed) == axis.reverse { 1.0 } else { -1.0 };
                sense * axis.direction.normalize().dot(&profile.along) * commands[k]
            };
            let along = |by: f64| translation(profile.along * by);
            let slides = settings["slides"] == json!(true);
            if let Some(axis) = settings["guideway"].as_str() {
                let k = self.axis(axis).expect("an axis");
                effects.push(Effect::Carried(k, profile.slices(held, at_zero + moved(k), false)));
            } else if let Some(axis) = settings["scale"].as_str() {
                let k = self.axis(axis).expect("an axis");
                let (place, sign) = if slides { (at_zero - moved(k), -1.0) } else { (at_zero + moved(k), 1.0) };
                effects.push(Effect::Carried(k, along(sign * profile.growth(held, place))));
            } else {
                let from = self.axis(settings["from"].as_str().expect("a frame"));
                let to = settings["to"].as_str().expect("a frame");
                let of_tool = to == "tool" || self.axis(to).is_some_and(|k| k >= self.machine.bed);
                let by = match (slides, from) {
                    (true, Some(k)) => {
                        let guided = at_zero - moved(k);
                        along(profile.growth(held, guided)) * profile.slices(guided, end, true)
                    }
                    _ => profile.slices(held, end, true),
                };
                effects.push(Effect::Behind(from, of_tool, by));
            }
        }
        effects
    }

    /// A pose with this temperature above the reference, in parts of that of the case.
    fn status(&self, model: &dyn KinematicModel, commands: &[f64], stylus: usize, part: f64) -> Vec<f64> {
        let of = |(index, status): (usize, &abbe_core::StatusColumn)| match commands.get(index) {
            Some(command) => *command,
            None if status.name == "stylus" => stylus as f64,
            None => match self.temperatures.get(&status.name) {
                Some(value) => 20.0 + part * (value.as_f64().expect("a number") - 20.0),
                None => 0.0,
            },
        };
        model.info().status.iter().enumerate().map(of).collect()
    }
}

#[test]
fn bodies_move_the_machine_as_rigid_slices_do() {
    let mut worst = 0.0_f64;
    for seed in 0..25 {
        let random = &mut Random::new(seed);
        let case = random_case(random);
        let model = subject::model(&case.settings, &[]);
        let styli = [
            vector(&case.settings["probe_offset_mm"])
                - Vector3::z() * case.settings["tool_length_mm"].as_f64().expect("a number"),
            vector(&case.settings["styli"]["2"]["tip_mm"]),
            vector(&case.settings["styli"]["5"]["tip_mm"]),
        ];
        let commands = case.machine.random_commands(random);
        let stylus = random.below(3);
        let pose = |part: f64| {
            let found =
                subject::poses(&*model, &case.status(&*model, &commands, stylus, part), &model.info().nominal, &[]);
            let [w, x, y, z] = found.orientations[0];
            let turned = nalgebra::UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(w, x, y, z));
            (Vector3::from(found.positions[0]), turned.to_rotation_matrix().into_inner())
        };
        let exact = |part: f64| {
            let mut case = Case {
                machine: case.machine.clone(),
                settings: case.settings.clone(),
                profiles: case.profiles.clone(),
                temperatures: Map::new(),
            };
            for section in case.profiles.iter_mut().flat_map(|(_, profile)| &mut profile.sections) {
                section.1 *= part;
                section.2 *= part;
            }
            slices(&case.machine, styli[stylus], &commands, &case.effects(&commands))
        };
        let cold = pose(0.0);
        assert!((cold.0 - place(&exact(0.0))).norm() < 1e-9, "seed {seed}: another machine");
        let misfit = |part: f64| {
            let (found, expected) = (pose(part), exact(part));
            let effect = (found.0 - cold.0).norm();
            (
                effect,
                (found.0 - place(&expected)).norm(),
                rotation_vector(&(found.1 * turn(&expected).transpose())).norm(),
            )
        };
        // Of second order in the temperatures: some nanometres for bends of 0.3 mrad, and a quarter of it for half of them.
        let (effect, off, turned) = misfit(1.0);
        assert!(effect > 1e-3 && off < 5e-5 && turned < 2e-7, "seed {seed}: {effect:e} {off:e} {turned:e}");
        let ratio = off / misfit(0.5).1;
        assert!(off < 1e-7 || (3.5..4.5).contains(&ratio), "seed {seed}: {off:e}, {ratio}");
        let (effect, off, turned) = misfit(1e-3);
        worst = worst.max(off / effect);
        assert!(off < 2e-6 * effect + 2e-12 && turned < 1e-12, "seed {seed}: {effect:e} {off:e} {turned:e}");
    }
    println!("largest misfit of slices: {worst:.1e} of the effect");
}

fn parameters(model: &dyn KinematicModel, ending: &str) -> Vec<usize> {
    let parameters = model.info().parameters.iter().enumerate();
    parameters.filter(|(_, parameter)| parameter.name.ends_with(ending)).map(|(index, _)| index).collect()
}

#[test]
fn derivatives_are_those_of_the_poses() {
    for seed in 0..20 {
        let random = &mut Random::new(100 + seed);
        let mut case = random_case(random);
        // Other bodies find their temperatures in a log, and one is colder while it turns.
        let names: Vec<String> = case.profiles.iter().map(|(name, _)| name.clone()).collect();
        for (number, name) in names.iter().enumerate().filter(|(number, _)| number % 2 == 0) {
            let body = &mut case.settings["bodies"][name];
            let mut log = json!({ "time_s": [0.0, 1000.0, 3700.0], "air_degC": [19.0, 20.5, 21.5], "n_rpm": [0.0, 6000.0, 3000.0] });
            for section in body["sections"].as_array().expect("sections") {
                for column in section["sensors"].as_object().expect("sensors").keys() {
                    let read = |random: &mut Random| 20.0 + 3.0 * random.signed();
                    log[format!("{column}_degC")] = json!([read(random), read(random), read(random)]);
                }
            }
            body["log"] = log;
            body["longest_gap_s"] = json!(3000.0);
            if number % 4 == 0 {
                body["turning"] =
                    json!({ "speed": "n", "at_rpm": 5000, "share": 0.3, "air": "air", "time_constant_s": 700 });
            }
        }
        case.settings["evaluation"] = json!(if seed % 4 == 3 { "first-order" } else { "exact" });
        let model = subject::model(&case.settings, &[]);
        let commands = case.machine.random_commands(random);
        let mut status = case.status(&*model, &commands, random.below(3), 1.0);
        let time = model.info().status.iter().position(|status| status.name == "time").expect("a time");
        status[time] = 1850.0 + 1850.0 * random.signed();
        let mut values = model.info().nominal.clone();
        let factors = parameters(&*model, "].factor");
        assert_eq!(factors.len(), case.profiles.len());
        factors.iter().for_each(|&index| values[index] = 1.0 + 0.3 * random.signed());
        let wanted: Vec<Variable> = factors
            .iter()
            .map(|&index| Variable::Parameter(index))
            .chain((0..commands.len()).map(Variable::Command))
            .collect();
        let found = subject::poses(&*model, &status, &values, &wanted);
        let matrix = |quaternion: [f64; 4]| {
            let [w, x, y, z] = quaternion;
            let turned = nalgebra::UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(w, x, y, z));
            turned.to_rotation_matrix().into_inner()
        };
        for (index, variable) in wanted.iter().enumerate() {
            let (moved, step): (Box<dyn Fn(f64) -> abbe_core::Poses>, f64) = match *variable {
                Variable::Parameter(parameter) => {
                    let (model, status, values) = (&model, &status, &values);
                    (
                        Box::new(move |by| {
                            let mut values = values.clone();
                            values[parameter] += by;
                            subject::poses(&**model, status, &values, &[])
                        }),
                        0.1,
                    )
                }
                Variable::Command(axis) => {
                    let (model, status, values) = (&model, &status, &values);
                    let step = if model.info().axes[axis].kind == abbe_core::AxisKind::Linear { 0.05 } else { 1e-5 };
                    (
                        Box::new(move |by| {
                            let mut status = status.clone();
                            status[axis] += by;
                            subject::poses(&**model, &status, values, &[])
                        }),
                        step,
                    )
                }
            };
            let (above, below) = (moved(step), moved(-step));
            let shift = (Vector3::from(above.positions[0]) - Vector3::from(below.positions[0])) / (2.0 * step);
            let turned = rotation_vector(&(matrix(above.orientations[0]) * matrix(below.orientations[0]).transpose()))
                / (2.0 * step);
            let off = (shift - Vector3::from(found.position_derivatives[index])).norm();
            let off_turn = (turned - Vector3::from(found.rotation_derivatives[index])).norm();
            let rotary = matches!(*variable, Variable::Command(axis) if model.info().axes[axis].kind == abbe_core::AxisKind::Rotary);
            let allowed = if rotary { 1e-6 } else { 2e-8 };
            assert!(off < allowed && off_turn < 2e-9, "seed {seed}, {variable:?}: {off:e} {off_turn:e}");
        }
    }
}

/// The errors of a frame by symbol, from the pose of a tip that is its origin and from its orientation.
fn errors_of(model: &dyn KinematicModel, status: &[f64]) -> [f64; 6] {
    let nominal = model.info().nominal.clone();
    let cold: Vec<f64> = nominal.iter().map(|_| 0.0).collect();
    let [warm, cold] = [&nominal, &cold].map(|values| subject::poses(model, status, values, &[]));
    let shift = Vector3::from(warm.positions[0]) - Vector3::from(cold.positions[0]);
    let [w, x, y, z] = warm.orientations[0];
    let turned = nalgebra::UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(w, x, y, z));
    let turned = turned.to_rotation_matrix().into_inner();
    // Rz Ry Rx.
    let [a, b, c] =
        [turned[(2, 1)].atan2(turned[(2, 2)]), -turned[(2, 0)].asin(), turned[(1, 0)].atan2(turned[(0, 0)])];
    [shift.x, shift.y, shift.z, a, b, c]
}

fn status_of(model: &dyn KinematicModel, value: impl Fn(&str) -> f64) -> Vec<f64> {
    model.info().status.iter().map(|status| value(&status.name)).collect()
}

/// Guideway and scale of the beams of `beam.json`, their carriage at each section; a body to each section; from columns of the
/// measurements and from a log.
#[test]
fn cases_of_exact_arithmetic_are_met_through_the_description_of_a_machine() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../pipelines/data/thermal-spindle/beam.json");
    let all: Value = serde_json::from_str(&std::fs::read_to_string(path).expect("a file")).expect("JSON");
    let cases = all["cases"].as_array().expect("cases");
    assert_eq!(cases.len(), 4);
    for (case, by_log) in cases.iter().flat_map(|case| [(case, false), (case, true)]) {
        let given = case["sections"].as_array().expect("sections");
        let (mut temperatures, mut log) = (Map::new(), json!({ "time_s": [0.0, 60.0] }));
        let mut sections = Vec::new();
        for (index, section) in given.iter().enumerate() {
            let mut sensors = Map::new();
            for (corner, reading) in section["corners"].as_array().expect("corners").iter().enumerate() {
                let name = format!("T{index}{corner}");
                sensors.insert(name.clone(), json!([0.0, reading["y_mm"], reading["z_mm"]]));
                log[format!("{name}_degC")] = json!([0.25, reading["T_K"]]);
                temperatures.insert(name, reading["T_K"].clone());
            }
            let mut one = json!({ "at_mm": section["x_mm"], "sensors": sensors });
            if index + 1 < given.len() {
                one["expansion_per_K"] = case["segments"][index]["expansion_per_K"].clone();
            }
            sections.push(one);
        }
        let mut beam = json!({
            "begin_mm": [0, 0, 0], "end_mm": [800, 0, 0], "sections": sections, "expansion_per_K": EXPANSION, "reference_degC": 0,
        });
        if by_log {
            beam["log"] = log;
        }
        let with = |more: Value| {
            let mut body = beam.clone();
            body.as_object_mut().expect("a body").extend(more.as_object().expect("settings").clone());
            body
        };
        let model = |bodies: Value| {
            subject::model(
                &json!({ "chain": "w b X t", "tool_length_mm": 0, "stylus_radius_mm": 0, "bodies": bodies }),
                &[],
            )
        };
        let along = model(json!({
            "guide": with(json!({ "guideway": "X", "at_zero_mm": 0 })), "scale": with(json!({ "scale": "X", "at_zero_mm": 0 })),
        }));
        let read = |name: &str| temperatures.get(name).and_then(Value::as_f64);
        let names = ["elongation_mm", "deflection_y_mm", "deflection_z_mm", "", "rotation_y_rad", "rotation_z_rad"];
        for (section, expected) in given.iter().zip(case["expected"].as_array().expect("expected")) {
            let x = section["x_mm"].as_f64().expect("a number");
            let status = status_of(&*along, |name| match name {
                "X" => x,
                "time" => 60.0,
                other => read(other).expect("a temperature"),
            });
            let found = errors_of(&*along, &status);
            for (found, name) in found.iter().zip(names) {
                let expected = expected[name].as_f64().unwrap_or(0.0);
                assert!((found - expected).abs() < 1e-12, "{} at {x}, {name}: {found} {expected}", case["name"]);
            }
            // The same as errors of the motion, one by one.
            for function in &along.info().error_functions {
                let value = along.motion_error(function, &along.info().nominal, &status).expect("a value").value;
                let expected = expected[names[function.component]].as_f64().unwrap_or(0.0);
                assert!((value - expected).abs() < 1e-14, "{}", function.symbol);
            }
        }
        // The whole of it below the axis: the frame of X is the end of the beam if its origin is there.
        let held = model(
            json!({ "beam": with(json!({ "from": "bed", "to": "X", "begin_mm": [-800, 0, 0], "end_mm": [0, 0, 0] })) }),
        );
        let status = status_of(&*held, |name| read(name).unwrap_or(if name == "time" { 60.0 } else { 0.0 }));
        let expected = &case["expected"][4];
        for (found, name) in errors_of(&*held, &status).iter().zip(names) {
            let expected = expected[name].as_f64().unwrap_or(0.0);
            assert!((found - expected).abs() < 1e-12, "{}, {name}: {found} {expected}", case["name"]);
        }
    }
}

/// A machine all of steel that is warmer by T is larger by k T in every direction: with bodies along its whole loop and scales.
#[test]
fn a_machine_that_is_warm_all_over_grows_in_proportion() {
    for seed in 0..10 {
        let random = &mut Random::new(seed);
        // Spindle beyond a column, a ram and a head; the table on a cross slide. All is at x = y = z = 0 with axes at zero.
        let section = json!([{ "at_mm": 0, "sensors": { "T": [0, 0, 0] } }]);
        let body = |from: Vector3<f64>, to: Vector3<f64>, more: Value| {
            let mut settings = json!({
                "begin_mm": <[f64; 3]>::from(from), "end_mm": <[f64; 3]>::from(to), "sections": section, "expansion_per_K": EXPANSION,
            });
            settings.as_object_mut().expect("a body").extend(more.as_object().expect("settings").clone());
            settings
        };
        let corner: Vec<Vector3<f64>> = (0..5).map(|_| random.vector(300.0)).collect();
        let tip = Vector3::new(0.0, 0.0, -150.0);
        let base = corner[0];
        let line = |axis: Vector3<f64>, name: &str| {
            body(
                corner[4] - axis * 700.0,
                corner[4] + axis * 700.0,
                json!({ "scale": name, "at_zero_mm": 700, "held_at_mm": 700 }),
            )
        };
        let settings = json!({
            "chain": "w X' Y' b Z t", "tool_length_mm": 150, "stylus_radius_mm": 0,
            "bodies": {
                "column": body(base, corner[1], json!({ "from": "bed", "to": "Z" })),
                "ram": body(corner[1], corner[2], json!({ "from": "Z", "to": "tool" })),
                "head": body(corner[2], tip, json!({ "from": "Z", "to": "tool" })),
                "saddle": body(base, corner[3], json!({ "from": "bed", "to": "Y" })),
                "slide": body(corner[3], corner[4], json!({ "from": "Y", "to": "X" })),
                "table": body(corner[4], Vector3::zeros(), json!({ "from": "X", "to": "workpiece" })),
                "x": line(Vector3::x(), "X"), "y": line(Vector3::y(), "Y"), "z": line(Vector3::z(), "Z"),
            },
        });
        let model = subject::model(&settings, &[]);
        let rise = 10.0 * random.signed();
        let commands = random.vector(400.0);
        let status = status_of(&*model, |name| match name {
            "X" => commands.x,
            "Y" => commands.y,
            "Z" => commands.z,
            _ => 20.0 + rise,
        });
        let found = errors_of(&*model, &status);
        let expected = (tip + commands) * (EXPANSION * rise);
        let off = (Vector3::new(found[0], found[1], found[2]) - expected).norm();
        assert!(off < 1e-12 && found[3..].iter().all(|turn| turn.abs() < 1e-15), "seed {seed}: {found:?} {expected}");
    }
}

fn one_body(more: Value) -> Value {
    let mut body = json!({
        "from": "Z", "to": "C", "begin_mm": [0, 0, 600], "end_mm": [0, 0, 0], "expansion_per_K": EXPANSION,
        "sections": [{ "at_mm": 0, "sensors": { "T1": [0, 100, 0], "T2": [0, -100, 0] } }],
    });
    body.as_object_mut().expect("a body").extend(more.as_object().expect("settings").clone());
    json!({
        "chain": "w B' X' Y' b Z C t", "tool_length_mm": 150, "stylus_radius_mm": 0, "bodies": { "ram": body },
        "axes": { "Z": { "range_mm": [0, 400] }, "B": { "point_mm": [350, 0, 150] } },
    })
}

fn tip(model: &dyn KinematicModel, z: f64, temperatures: [f64; 2]) -> [f64; 6] {
    let status = status_of(model, |name| match name {
        "Z" => z,
        "T1" => temperatures[0],
        "T2" => temperatures[1],
        _ => 0.0,
    });
    errors_of(model, &status)
}

/// Hot above, a ram droops: signs as in `beam.json`, and what slides is the longer the farther it is out.
#[test]
fn a_ram_that_is_hot_above_bends_down() {
    let held = subject::model(&one_body(json!({})), &[]);
    // 2 K over 200 mm, 600 mm long: it bends by k g L^2 / 2, and the tool goes on along its slope.
    let (gradient, length) = (0.01, 600.0);
    let [x, y, z, a, b, c] = tip(&*held, 0.0, [23.0, 21.0]);
    let bend = EXPANSION * gradient * length;
    let down = -bend * length / 2.0 - bend * 150.0;
    assert!(
        (y - down).abs() < 1e-7 && (a + bend).abs() < 1e-12 && x.abs().max(b.abs()).max(c.abs()) < 1e-12,
        "{y} {down} {a}"
    );
    // The mean of 2 K makes it longer, to -z.
    assert!((z + EXPANSION * 2.0 * length).abs() < 1e-6, "{z}");
    // The bearing at 200 mm from its rear end, with the axis at zero; drawn back by 300 mm there are 300 mm less beyond it.
    let slides = json!({ "slides": true, "at_zero_mm": 0, "held_at_mm": 0 });
    let slides = subject::model(&one_body(slides), &[]);
    assert_eq!(tip(&*slides, 0.0, [23.0, 21.0]), [x, y, z, a, b, c]);
    // Z positive carries the ram to +z: the bearing is nearer to its front.
    let [_, y, z, a, ..] = tip(&*slides, 300.0, [23.0, 21.0]);
    let bend = EXPANSION * gradient * 300.0;
    assert!((y + bend * 150.0 + bend * 150.0).abs() < 1e-7 && (a + bend).abs() < 1e-12, "{y} {a}");
    assert!((z + EXPANSION * 2.0 * length).abs() < 1e-7, "elongation counts from the scale: {z}");
}

/// The scale of `expansion`, and the lever between guideway and scale.
#[test]
fn scales_and_guideways_by_hand() {
    let model = |bodies: Value, errors: Value| {
        let settings = json!({ "chain": "w X' b Z t", "tool_length_mm": 0, "stylus_radius_mm": 0, "bodies": bodies, "errors": errors });
        subject::model(&settings, &[])
    };
    let line = json!({ "begin_mm": [-300, 0, 0], "end_mm": [500, 0, 0], "expansion_per_K": EXPANSION,
        "sections": [{ "at_mm": 400, "sensors": { "T1": [0, 0, 0] } }] });
    let with = |more: Value| {
        let mut body = line.clone();
        body.as_object_mut().expect("a body").extend(more.as_object().expect("settings").clone());
        body
    };
    // Held where the head is at zero: the family `expansion` says the same.
    let scale = model(json!({ "x": with(json!({ "scale": "X", "at_zero_mm": 300, "held_at_mm": 300 })) }), json!([]));
    let family =
        model(json!({}), json!([{ "expansion": ["EXX"], "temperature": "T1", "coefficient_per_K": EXPANSION }]));
    for x in [-200.0, 0.0, 130.0, 300.0] {
        let of = |model: &dyn KinematicModel| {
            errors_of(
                model,
                &status_of(model, |name| match name {
                    "X" => x,
                    "T1" => 24.5,
                    _ => 0.0,
                }),
            )
        };
        let (found, expected) = (of(&*scale), of(&*family));
        assert!(
            found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-13),
            "{found:?} {expected:?}"
        );
        // The table goes to -x by more than it should, the tool to +x relative to it.
        assert!((found[0] - EXPANSION * 4.5 * x).abs() < 1e-13);
    }
    // Bent upwards in its middle; with the scale 200 mm above the guideway pitch moves what is on the guideway, and not the scale.
    let guide = |more: Value| {
        let mut body = with(json!({ "guideway": "X", "at_zero_mm": 300 }));
        body["sections"] = json!([{ "at_mm": 0, "sensors": { "T1": [0, 0, 100], "T2": [0, 0, -100] } }]);
        body.as_object_mut().expect("a body").extend(more.as_object().expect("settings").clone());
        model(json!({ "guide": body }), json!([]))
    };
    let (low, high) = (guide(json!({})), guide(json!({ "scale_point_mm": [55, 0, 200] })));
    let [low, high] = [&low, &high].map(|model| tip_of_table(&**model));
    let pitch = EXPANSION * 0.01 * 200.0;
    // Table at x = -100: 200 mm behind the beginning of the guideway.
    assert!((low[4] + pitch).abs() < 1e-12 && (high[4] + pitch).abs() < 1e-12, "{low:?}");
    // The tip is 100 mm from the origin of the table, which turned by the pitch.
    assert!((low[2] - (pitch * 100.0 + pitch * 100.0)).abs() < 1e-7, "{low:?}");
    assert!(low[0].abs() < 1e-7 && (high[0] - pitch * 200.0).abs() < 1e-7, "{high:?}");
}

fn tip_of_table(model: &dyn KinematicModel) -> [f64; 6] {
    let status = status_of(model, |name| match name {
        "X" => 100.0,
        "T1" => 21.0,
        "T2" => 19.0,
        _ => 0.0,
    });
    errors_of(model, &status)
}

/// At rest a tool follows its holder; at speed it tends to a share of that, with its own time constant.
#[test]
fn a_tool_is_colder_while_it_turns() {
    let log = json!({ "time_s": [0.0, 1.0, 5000.0, 5001.0, 12000.0], "T1_degC": [30, 30, 30, 30, 30.5],
        "T2_degC": [20, 20, 20, 20, 20], "n_rpm": [0, 6000, 6000, 0, 0] });
    let tool = json!({ "tool": { "from": "Z", "to": "tool", "begin_mm": [0, 0, 0], "end_mm": [0, 0, -200], "expansion_per_K": EXPANSION,
        "sections": [{ "at_mm": 0, "sensors": { "T1": [0, 0, 0] } }], "log": log, "longest_gap_s": 1e4,
        "turning": { "speed": "n", "at_rpm": 5000, "share": 0.25, "air": "T2", "time_constant_s": 300 } } });
    let settings = json!({ "chain": "w X' b Z t", "tool_length_mm": 200, "stylus_radius_mm": 0, "bodies": tool });
    let model = subject::model(&settings, &[]);
    let elevation = |time: f64| {
        let found = errors_of(&*model, &status_of(&*model, |name| if name == "time" { time } else { 0.0 }));
        -found[2] / (EXPANSION * 200.0)
    };
    assert!((elevation(0.0) - 10.0).abs() < 1e-9);
    let expected = 2.5 + 7.5 * (-(300.0 - 0.5) / 300.0_f64).exp();
    assert!((elevation(300.0) - expected).abs() < 1e-4, "{} {expected}", elevation(300.0));
    assert!((elevation(4999.0) - 2.5).abs() < 1e-5);
    // After the stop it becomes warmer (Soons 1993, figure 5.16).
    assert!(elevation(5301.0) > 7.0 && (elevation(11999.0) - 10.5).abs() < 0.03, "{}", elevation(11999.0));
    // Nothing is known without a time, and nothing is outside the log.
    assert!(elevation(f64::NAN) == 0.0);
}

#[test]
fn factors_have_the_uncertainty_of_the_material() {
    let model = subject::model(&one_body(json!({ "standard_uncertainty_per_K": 0.46e-6 })), &[]);
    let [index] = parameters(&*model, "body[ram].factor")[..] else { panic!("one factor") };
    assert_eq!((model.info().nominal[index], model.info().parameters[index].unit.to_string()), (1.0, "1".to_owned()));
    assert!((model.info().nominal_uncertainties[index] - 0.04).abs() < 1e-15);
}

#[test]
fn wrong_bodies_are_refused() {
    let cases = [
        (json!({ "from": "bed" }), "bodies.ram.from: a body lies between frames that follow one another; C follows Z"),
        (json!({ "from": "bet" }), "bodies.ram.from: `bet` is no frame of this chain (did you mean `bed`?)"),
        (json!({ "to": "D" }), "bodies.ram.to: `D` is no frame of this chain"),
        (json!({ "to": "bed" }), "bodies.ram.to: `bed` is no frame of this chain"),
        (json!({ "scale": "X" }), "bodies.ram: `from` and `to`, or `guideway`, or `scale` was expected"),
        (json!({ "end_mm": [0, 0, 600] }), "bodies.ram.end_mm: the body ends where it begins"),
        (
            json!({ "held_at_mm": 601 }),
            "bodies.ram.held_at_mm: 601 mm is beyond the ends of the body, which is 600.000 mm long",
        ),
        (
            json!({ "sections": [{ "at_mm": 650, "sensors": { "T1": [0, 0, 0] } }] }),
            "bodies.ram.sections[0].at_mm: 650 mm is beyond the ends of the body",
        ),
        (json!({ "sections": [] }), "bodies.ram.sections: at least one section"),
        (json!({ "sections": [{ "at_mm": 0, "sensors": {} }] }), "bodies.ram.sections[0].sensors: at least one sensor"),
        (
            json!({ "sections": [{ "at_mm": 9, "sensors": { "T1": [0, 0, 0] } }, { "at_mm": 9, "sensors": { "T1": [0, 0, 0] } }] }),
            "bodies.ram.sections[1].at_mm: these have to increase",
        ),
        (
            json!({ "sections": [{ "at_mm": 0, "sensors": { "T1_degC": [0, 0, 0] } }] }),
            "bodies.ram.sections[0].sensors.T1_degC: the name of a column without its unit was expected",
        ),
        (
            json!({ "sections": [{ "at_mm": 0, "sensors": { "T1": [0, 0, 40] } }] }),
            "bodies.ram.sections[0].sensors.T1: the sensor is -40.000 mm off the plane of its section",
        ),
        (json!({ "expansion_per_K": 11.5 }), "bodies.ram.expansion_per_K: 11.5: a coefficient up to 0.001 per K"),
        (json!({ "expansion_per_K": 0 }), "bodies.ram.expansion_per_K: 0: "),
        (json!({ "standard_uncertainty_per_K": -1 }), "bodies.ram.standard_uncertainty_per_K: "),
        (json!({ "slides": true }), "bodies.ram.at_zero_mm: the place on the body"),
        (json!({ "at_zero_mm": 5 }), "bodies.ram.at_zero_mm: only guideways, scales and bodies that slide have one"),
        (
            json!({ "slides": true, "at_zero_mm": 300 }),
            "bodies.ram.at_zero_mm: with Z at 400.000 mm the place 700.000 mm of the body counts, which is only 600.000 mm long",
        ),
        (
            json!({ "slides": true, "at_zero_mm": 0, "end_mm": [0, 30, 0], "sections": [{ "at_mm": 0, "sensors": { "T1": [0, 0, 0] } }] }),
            "bodies.ram.end_mm: the body is not parallel to the axis Z, which it has to be",
        ),
        (
            json!({ "from": "C", "to": "tool", "slides": true, "at_zero_mm": 0 }),
            "bodies.ram.slides: a body slides with a linear axis, and C is none",
        ),
        (json!({ "scale_point_mm": [0, 0, 0] }), "bodies.ram.scale_point_mm: only a guideway has one"),
        (
            json!({ "reference_degC": 20, "reference_until_s": 9 }),
            "bodies.ram.reference_until_s: there is `reference_degC` already",
        ),
        (
            json!({ "turning": { "speed": "n", "at_rpm": 9, "share": 2, "air": "T", "time_constant_s": 9 } }),
            "bodies.ram.turning.share: 2: a number from 0 to 1 was expected",
        ),
        (json!({ "metal": "steel" }), "bodies.ram.metal: "),
    ];
    for (more, expected) in cases {
        let error = subject::refused(&one_body(more));
        assert!(error.contains(expected), "{error}\n{expected}");
    }
    let mut settings = one_body(json!({}));
    let ram = settings["bodies"]["ram"].clone();
    settings["bodies"] = json!({ "ram[1]": ram });
    assert!(subject::refused(&settings).contains("a name of letters, digits, - and _ was expected"));
    let guide = |more: Value| {
        let mut settings = one_body(json!({}));
        let mut body = settings["bodies"]["ram"].take();
        for key in ["from", "to"] {
            body.as_object_mut().expect("a body").remove(key);
        }
        body.as_object_mut().expect("a body").extend(more.as_object().expect("settings").clone());
        settings["bodies"]["ram"] = body;
        subject::refused(&settings)
    };
    assert!(guide(json!({ "guideway": "B", "at_zero_mm": 0 })).contains("B is rotary; a linear axis was expected"));
    assert!(guide(json!({ "scale": "W", "at_zero_mm": 0 })).contains("the chain has no axis W"));
    assert!(guide(json!({ "guideway": "Z", "at_zero_mm": 600, "slides": true })).contains("a guideway stands still"));
    // A command beyond a body whose axis has no range is refused when it comes.
    let mut settings = one_body(json!({ "slides": true, "at_zero_mm": 0 }));
    settings["axes"] = json!({});
    let model = subject::model(&settings, &[]);
    let status = status_of(&*model, |name| if name == "Z" { 650.0 } else { 20.0 });
    let mut out = abbe_core::Poses::default();
    let error = model.poses(&status, &model.info().nominal, &[], false, &mut out).expect_err("beyond").to_string();
    assert!(error.contains("with Z at 650.000 mm the place 650.000 mm of the body counts"), "{error}");
}
