//! Programs of random machines that touch faces, in all five languages: the faces of a block and of plates that look anywhere, each off
//! its nominal place. The right face, place, side, sense and order, clear of everything; and what their logs tell.

use std::collections::BTreeSet;
use std::fmt::Write;

use abbe_core::Calibration;

use super::bodies::{Face, Faces};
use super::machine::{Machine, dot, minus, norm};
use super::random::{READERS, chain, in_order, limited, seconds, settings};
use super::{CONTROLS, Planned, Setup};
use crate::controls::law::{seeds, uniform};
use crate::support::{fit, read, registry, write};

/// Faces of a recipe that has begun.
const FACES: usize = 11;

/// Most that a face is off, mm.
const OFF: f64 = 0.08;

/// What is on the table, how the recipe says it, and a sphere around it.
struct Table {
    faces: Faces,
    setup: Setup<'static>,
    clearance: String,
}

impl Table {
    fn new(faces: Faces, solids: String, centre: [f64; 3], reach: f64) -> Self {
        let mut nominal = "feature,x_mm,y_mm,z_mm,nx,ny,nz\n".to_owned();
        for Face { feature, point, normal, .. } in &faces.faces {
            let cells: Vec<String> = point.iter().chain(normal).map(|value| format!("{value:.9}")).collect();
            let _ = writeln!(nominal, "{feature},{}", cells.join(","));
        }
        let [x, y, z] = centre;
        let clearance = format!("sphere: {{ centre_mm: [{x:.3}, {y:.3}, {z:.3}], radius_mm: {:.3} }}", reach + 12.0);
        Self { faces, setup: Setup { method: "table", nominal: Some(("facets.csv", nominal)), solids }, clearance }
    }

    /// A block that stands on the table, three faces above and two on each side.
    fn block(random: &mut impl FnMut() -> f64) -> Self {
        let mut between = |from: f64, to: f64| ((from + (to - from) * random()) * 1e3).round() / 1e3;
        let (x, y, top) = (between(-30.0, 30.0), between(-30.0, 30.0), between(60.0, 90.0));
        let (long, wide) = (between(45.0, 80.0), between(45.0, 80.0));
        let block = [[x - long, y - wide, 0.0], [x + long, y + wide, top]];
        let mut faces = Vec::new();
        let mut add = |point: [f64; 3], normal: [f64; 3]| {
            faces.push(Face { feature: (faces.len() + 1).to_string(), point, normal, off: 0.0 });
        };
        for [right, back] in [[0.5, 0.4], [-0.6, 0.3], [0.1, -0.6]] {
            add([x + right * long, y + back * wide, top], [0.0, 0.0, 1.0]);
        }
        for side in [1.0, -1.0] {
            for along in [-0.5, 0.5] {
                let (down, other) = (top - between(12.0, 28.0), top - between(12.0, 28.0));
                add([x + side * long, y + along * wide, down], [side, 0.0, 0.0]);
                add([x + along * long, y + side * wide, other], [0.0, side, 0.0]);
            }
        }
        let [from, to] = block;
        let solids = format!("    solids: [{{ box: {{ from_mm: {from:?}, to_mm: {to:?} }} }}]\n");
        let faces = Faces { faces, radius: 5.0, thickness: 5.0, block: Some(block) };
        Self::new(faces, solids, [x, y, top / 2.0], norm([long, wide, top / 2.0]))
    }

    /// Plates around a point that look away from it, upwards and to the sides.
    fn plates(random: &mut impl FnMut() -> f64) -> Self {
        let centre = [60.0 * random() - 30.0, 60.0 * random() - 30.0, 80.0 + 20.0 * random()];
        let (mut faces, apart): (Vec<Face>, f64) = (Vec::new(), 50.0 + 20.0 * random());
        while faces.len() < FACES {
            let (up, turn) = (1.0 - 1.2 * random(), std::f64::consts::TAU * random());
            let flat = (1.0 - up * up).sqrt();
            let normal = [flat * turn.cos(), flat * turn.sin(), up];
            if faces.iter().all(|face| dot(face.normal, normal) < 0.82) {
                let point = [0, 1, 2].map(|axis| centre[axis] + apart * normal[axis]);
                faces.push(Face { feature: (faces.len() + 1).to_string(), point, normal, off: 0.0 });
            }
        }
        let faces = Faces { faces, radius: 8.0, thickness: 6.0, block: None };
        let solids = "    facets: { radius_mm: 8, thickness_mm: 6 }\n".to_owned();
        Self::new(faces, solids, centre, apart + 8.0)
    }

    /// The same faces, each off by so much.
    fn off(&self, mut off: impl FnMut() -> f64) -> Faces {
        let faces = self.faces.faces.iter().map(|face| Face { off: off(), ..face.clone() }).collect();
        Faces { faces, ..self.faces }
    }
}

/// A chain whose rotary axes turn the tool against the table: else faces tell nothing.
fn that_swings(random: &mut impl FnMut() -> f64) -> String {
    loop {
        let chain = chain(random);
        let (table, tool) = chain.split_once(" b ").expect("a bed");
        if tool.contains(['A', 'B']) || table.contains(['A', 'B', 'C']) {
            return chain;
        }
    }
}

/// The fit of a log.
fn calibration(planned: &Planned, control: &str, log: &str) -> Result<Calibration, String> {
    let begun = planned.folder.path().join("begun");
    write(&begun.join("measure.log"), log);
    write(&begun.join("plan.csv"), &planned.files["plan.csv"]);
    let reader = READERS.iter().find(|(name, _)| *name == control).expect("a reader").1;
    let ingest = format!("{{ ingest: {reader}, path: measure.log, plan: plan.csv, repeats: average }}");
    let recipe = read(&begun.join("recipe.yaml")).replacen("{ ingest: csv, path: touches.csv }", &ingest, 1);
    let recipe = recipe.replace("robust: tukey", "trust_uncertainties: true");
    write(&begun.join("logged.yaml"), &recipe[..recipe.find("\nplan:").expect("a plan")]);
    let outcome = abbe_engine::prepare(&begun.join("logged.yaml"), &registry())
        .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()))
        .map_err(|error| format!("{control}: {error} {}", error.help.as_deref().unwrap_or_default()))?;
    Ok(fit(&outcome, "fit").calibration.clone())
}

#[test]
fn programs_of_random_machines_touch_the_right_faces() {
    let (mut touched, mut turned, mut told, mut other_sign, mut left_out) = (0, 0, 0, 0, 0);
    for seed in seeds(5) {
        let mut random = uniform(4100 + seed);
        let (control, file, dry) = CONTROLS[seed as usize % CONTROLS.len()];
        let chain = that_swings(&mut random);
        let table = if seed % 2 == 0 { Table::block(&mut random) } else { Table::plates(&mut random) };
        let (more, inches) = settings(&mut random);
        let what = format!("{seed}: {chain} {control} {}\n{}{more}", table.clearance, table.setup.solids);
        let plan = |number: usize| {
            let number = format!("  number: {number}");
            Planned::of_setup((&chain, &table.setup), control, &table.clearance, &more, &limited(&number))
        };
        // As many indexations as determine this chain, and as it has.
        let few = |error: &String| error.contains("too small to determine") || error.contains("not so many candidates");
        let numbers = [8, 16, 6, 5, 4, 3].into_iter().map(plan);
        let planned = numbers.into_iter().find(|planned| !planned.as_ref().err().is_some_and(few));
        let planned = planned.expect("a plan").unwrap_or_else(|error| panic!("{what}{error}"));
        let faces = table.off(|| OFF * (2.0 * random() - 1.0));
        let off: Vec<f64> = faces.faces.iter().map(|face| face.off).collect();
        let mut machine = planned.with(faces);
        let (hits, misses) =
            planned.measured(control, file, &mut machine).unwrap_or_else(|error| panic!("{what}{error}"));
        assert_eq!(machine.unit, Some(if inches { 25.4 } else { 1.0 }), "{what}");
        let order = in_order(&planned, (&hits, misses), &more, &what);
        let features: BTreeSet<&String> = planned.features.values().collect();
        assert!(features.len() >= 3, "{what}only {features:?}");
        touched += order.len();
        let unreached = planned.files[file].to_uppercase().matches("LEFT OUT: ").count();
        left_out += unreached;
        // Its log has the faces where they are.
        let (right, wrong) = match calibration(&planned, control, &(machine.log.join("\n") + "\n")) {
            Ok(calibration) => places(&calibration, &off).unwrap_or_else(|error| panic!("{what}{error}")),
            // What the program could not reach is missing.
            Err(error) if unreached > 0 && error.contains(" determine ") => (0, 0),
            Err(error) => panic!("{what}{error}"),
        };
        (told, other_sign) = (told + right, other_sign + wrong);
        // With the faces in their places all moves take what was said.
        let mut machine = planned.with(table.off(|| 0.0));
        planned.measured(control, file, &mut machine).unwrap_or_else(|error| panic!("{what}{error}"));
        let said = seconds(&planned);
        assert!((machine.seconds / said - 1.0).abs() < 1e-3, "{what}{} s, said are {said} s", machine.seconds);
        // The dry run ends without contact.
        let mut machine = planned.with(table.off(|| 0.0));
        planned.run(control, dry, &mut machine).unwrap_or_else(|error| panic!("{what}dry: {error}"));
        assert_eq!((machine.alarm, machine.triggered), (None, false), "{what}dry");
        // Faces that have each other's names are the wrong ones.
        let mut swapped = table.off(|| 0.0);
        let first = swapped.faces[0].feature.clone();
        for place in 0..FACES {
            swapped.faces[place].feature =
                swapped.faces.get(place + 1).map_or(first.clone(), |next| next.feature.clone());
        }
        let mut machine = planned.with(swapped);
        let found = planned.measured(control, file, &mut machine);
        assert!(found.is_err_and(|error| error.contains("from its place")), "{what}other names");
        turned += the_other_way(&planned, &table, (control, file), hits.len(), &what);
    }
    println!(
        "{touched} touches, {left_out} left out; {turned} axes the other way; {told} faces found, {other_sign} of them not with \
         the other sign"
    );
    assert!(turned > 0 && told > 0 && 2 * other_sign > told);
}

/// How many faces are found where they are, and how many of them would not be with the other sign.
fn places(calibration: &Calibration, off: &[f64]) -> Result<(usize, usize), String> {
    let (mut right, mut wrong) = (0, 0);
    for (index, off) in off.iter().enumerate() {
        let name = format!("table.facet[{}].d", index + 1);
        let found = calibration.get(&name).filter(|found| found.status == abbe_core::Status::Estimated);
        let Some(found) = found else { continue };
        let within = 4.0 * found.standard_uncertainty + 1e-3;
        if (found.value - off).abs() > within {
            return Err(format!("{name} is {}, not {off}", found.value));
        }
        wrong += usize::from((found.value + off).abs() > within);
        right += 1;
    }
    Ok((right, wrong))
}

/// Axes that go the other way are noticed, one after another; how many.
fn the_other_way(planned: &Planned, table: &Table, (control, file): (&str, &str), hits: usize, what: &str) -> usize {
    let mut turned = 0;
    for axis in planned.with(table.off(|| 0.0)).model.info().axes.clone() {
        let mut machine = planned.with(table.off(|| 0.0));
        if !moves_the_tip(planned, &mut machine, &axis.name) {
            continue;
        }
        machine.flipped = Some(axis.name.clone());
        let found = planned.measured(control, file, &mut machine);
        let all = found.as_ref().is_ok_and(|(again, misses)| again.len() == hits && *misses == 0);
        assert!(!all, "{what}{}: {found:?}", axis.name);
        turned += 1;
    }
    turned
}

/// Whether a touch is elsewhere if this axis goes the other way: one that turns the tool about itself, say, moves no tip.
pub fn moves_the_tip(planned: &Planned, machine: &mut Machine, axis: &str) -> bool {
    planned.touches.values().any(|touch| {
        let place = |(name, place): (&String, &f64)| {
            Some((name.strip_suffix("_mm").or(name.strip_suffix("_deg"))?.to_owned(), *place))
        };
        let mut at = machine.at.clone();
        at.extend(touch.iter().filter_map(place).filter(|(name, _)| machine.at.contains_key(name)));
        let tip = machine.tip(&at).0;
        machine.flipped = Some(axis.to_owned());
        let other = machine.tip(&at).0;
        machine.flipped = None;
        norm(minus(tip, other)) > 5.0
    })
}
