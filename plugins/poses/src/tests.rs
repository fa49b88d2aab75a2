//! Poses of simulated targets, and what is refused.

use std::fs;
use std::sync::Arc;

use abbe_core::{Build, Calibration, Estimate, Identifiability, Kind, ObservationSet, Problem, Registry};
use abbe_gauss_newton as _;
use abbe_serial_chain as _;
use nalgebra::{DMatrix, DVector, Vector3};

use super::*;

/// Numbers that look random and are the same in every run.
pub struct Random(pub u64);

impl Random {
    /// Evenly distributed between -1 and 1 (Knuth's linear congruential generator).
    pub fn number(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::from([(); 3].map(|()| self.number()))
    }

    /// A pose whose coordinates are within `size`, turned by anything.
    pub fn pose(&mut self, size: f64) -> Isometry3<f64> {
        Isometry3::new(self.vector() * size, self.vector().normalize() * self.number() * 3.1)
    }
}

/// Which way the target was seen, on what chain, and with which axes.
struct Scene {
    machine: Value,
    columns: &'static str,
    settings: Value,
    errors: &'static [(&'static str, f64)],
}

/// A tilt-and-rotate positioner in front of a camera.
fn positioner() -> Scene {
    Scene {
        machine: json!({
            "chain": "w C' A' b t", "tool_length_mm": 0, "stylus_radius_mm": 0,
            "errors": [{ "location": ["EB0C", "EY0C"] }],
        }),
        columns: "A_deg,C_deg",
        settings: json!({ "standard_uncertainty_um": 20, "standard_uncertainty_urad": 50 }),
        errors: &[("EB0C", 3e-4), ("EY0C", -0.2)],
    }
}

/// A five-axis machine with an R-test in its spindle.
fn five_axes() -> Scene {
    Scene {
        machine: json!({
            "chain": "w C' B' X' b Z Y t", "tool_length_mm": 150, "stylus_radius_mm": 0,
            "errors": [{ "location": ["EA0B", "EX0C", "EC0Y"] }, { "polynomial": ["EXX"], "degrees": [1] }],
        }),
        columns: "X_mm,Y_mm,Z_mm,B_deg,C_deg",
        settings: json!({ "standard_uncertainty_um": 1, "standard_uncertainty_urad": 5, "observer": "at-tool" }),
        errors: &[("EA0B", -1e-4), ("EX0C", 0.05), ("EC0Y", 2e-5), ("EXX[1]", 3e-5)],
    }
}

fn artefact(settings: &Value) -> Box<dyn Artefact> {
    build(abbe_core::from_settings(settings).unwrap(), &Context { base: PathBuf::new() }).unwrap()
}

fn model(settings: &Value) -> Arc<dyn KinematicModel> {
    let registry = Registry::built_in().unwrap();
    let Build::Model(constructor) = &registry.find(Kind::Model, "serial-chain").unwrap().build else { panic!() };
    constructor.build(settings, &Context { base: PathBuf::new() }).unwrap().build(&[]).unwrap()
}

fn estimator() -> Box<dyn Estimate> {
    let registry = Registry::built_in().unwrap();
    let Build::Estimate(constructor) = &registry.find(Kind::Estimate, "gauss-newton").unwrap().build else { panic!() };
    constructor.build(&json!({}), &Context { base: PathBuf::new() }).unwrap()
}

fn table(text: &str) -> Arc<Dataset> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("poses.csv");
    fs::write(&file, text).unwrap();
    let mut data = abbe_table::read(&file).unwrap();
    data.files = vec![PathBuf::from("poses.csv")];
    Arc::new(data)
}

impl Scene {
    fn model(&self) -> Arc<dyn KinematicModel> {
        model(&self.machine)
    }

    fn sees_target(&self) -> bool {
        self.settings["pose"] != "observer-in-target"
    }

    /// The table that is observed at commands (mm or degrees), with target and observer as given.
    fn seen(&self, commands: &[Vec<f64>], target: &Isometry3<f64>, observer: &Isometry3<f64>) -> String {
        self.seen_off(commands, target, observer, |_| Isometry3::identity())
    }

    /// The same, every observed pose turned and shifted by what `off` says of its row.
    fn seen_off(
        &self,
        commands: &[Vec<f64>],
        target: &Isometry3<f64>,
        observer: &Isometry3<f64>,
        mut off: impl FnMut(usize) -> Isometry3<f64>,
    ) -> String {
        let model = self.model();
        let place = |name: &str| model.info().parameters.iter().position(|parameter| parameter.name == name).unwrap();
        let mut values = model.info().nominal.clone();
        self.errors.iter().for_each(|(name, value)| values[place(name)] = *value);
        let mut text = format!("{},x_mm,y_mm,z_mm,qw,qx,qy,qz\n", self.columns);
        for (row, commands) in commands.iter().enumerate() {
            let status = model.info().status.iter().map(|status| {
                let column = self.columns.split(',').position(|column| column.starts_with(&status.name));
                let factor = if status.quantity == Quantity::Angle { 1_f64.to_radians() } else { 1.0 };
                column.map_or(0.0, |column| commands[column] * factor)
            });
            let mut poses = abbe_core::Poses::default();
            model.poses(&status.collect::<Vec<_>>(), &values, &[], true, &mut poses).unwrap();
            let observer = tools(&poses.positions, &poses.orientations).next().unwrap() * observer;
            let seen = if self.sees_target() { observer.inverse() * target } else { target.inverse() * observer };
            let off = off(row);
            let shifted = seen.translation.vector + off.translation.vector;
            let seen = Isometry3::from_parts(shifted.into(), off.rotation * seen.rotation);
            let (p, q) = (seen.translation.vector, seen.rotation);
            let sign = if row % 2 == 0 { 1.0 } else { -1.005 }; // Neither sign nor a norm of almost 1 matters.
            let q = [q.w, q.i, q.j, q.k].map(|part| part * sign);
            let cells: Vec<String> = commands.iter().chain(&[p.x, p.y, p.z]).chain(&q).map(f64::to_string).collect();
            text.push_str(&(cells.join(",") + "\n"));
        }
        text
    }

    fn observe(&self, text: &str) -> Result<Arc<dyn Observations>> {
        artefact(&self.settings).observe(&table(text), &self.model())
    }

    fn problem(&self, text: &str) -> Problem {
        let sets = vec![ObservationSet::new("seen", self.observe(text).unwrap())];
        let patterns: Vec<String> = self.errors.iter().map(|(name, _)| (*name).to_owned()).collect();
        let patterns = [patterns, vec!["seen.*".to_owned()]].concat();
        Problem::new("fit", "serial-chain", self.model(), sets, &patterns).unwrap()
    }

    /// The problem of everything that machine and artefact know.
    fn problem_of_all(&self, text: &str) -> Problem {
        let sets = vec![ObservationSet::new("seen", self.observe(text).unwrap())];
        let patterns = ["E*", "seen.*"].map(str::to_owned);
        Problem::new("fit", "serial-chain", self.model(), sets, &patterns).unwrap()
    }

    fn fit(&self, text: &str) -> Calibration {
        estimator().estimate(&self.problem(text)).unwrap()
    }

    fn commands(&self, random: &mut Random) -> Vec<Vec<f64>> {
        let range = |column: &str| if column.ends_with("_mm") { 200.0 } else { 60.0 };
        (0..20).map(|_| self.columns.split(',').map(|column| range(column) * random.number()).collect()).collect()
    }

    fn observer(&self, random: &mut Random) -> Isometry3<f64> {
        if self.settings["observer"] == "at-tool" { Isometry3::identity() } else { random.pose(1500.0) }
    }
}

/// All scenes, seen both ways.
fn scenes() -> Vec<Scene> {
    let mut scenes = vec![positioner(), five_axes(), positioner(), five_axes()];
    scenes[2].settings["pose"] = json!("observer-in-target");
    scenes[3].settings["pose"] = json!("observer-in-target");
    scenes
}

#[test]
fn the_truth_comes_back_wherever_target_and_observer_stand() {
    let mut random = Random(2);
    for scene in scenes() {
        for _ in 0..10 {
            let (target, observer) = (random.pose(300.0), scene.observer(&mut random));
            let calibration = scene.fit(&scene.seen(&scene.commands(&mut random), &target, &observer));
            assert!(calibration.fit.iterations <= 6, "{}", calibration.fit.iterations);
            for (name, truth) in scene.errors {
                let off = calibration.get(name).unwrap().value - truth;
                assert!(off.abs() < 1e-8, "{name} is off by {off:e} in {}", scene.settings);
            }
            for (frame, truth) in [("target", &target), ("observer", &observer)] {
                for (axis, truth) in ["x", "y", "z"].iter().zip(&truth.translation.vector) {
                    let Some(estimated) = calibration.get(&format!("seen.{frame}.{axis}")) else {
                        assert_eq!((frame, observer == Isometry3::identity()), ("observer", true));
                        continue;
                    };
                    let off = estimated.value - truth;
                    assert!(off.abs() < 1e-7, "{frame}.{axis} is off by {off:e} in {}", scene.settings);
                }
            }
        }
    }
}

#[test]
fn linearised_problems_follow_differences() {
    let mut random = Random(3);
    for scene in scenes() {
        let (target, observer) = (random.pose(300.0), scene.observer(&mut random));
        let problem = scene.problem(&scene.seen(&scene.commands(&mut random), &target, &observer));
        let mut x = problem.start();
        x.iter_mut().for_each(|value| *value += 1e-2 * random.number());
        let (count, mut jacobian) = (x.len(), Vec::new());
        problem.linearise(&x, |block| jacobian.extend_from_slice(block.jacobian)).unwrap();
        for unknown in 0..count {
            let step = if problem.unknowns[unknown].unit == abbe_core::Unit::MM { 1e-3 } else { 1e-6 };
            let [plus, minus] = [step, -step].map(|step| {
                let mut x = x.clone();
                x[unknown] += step;
                problem.residuals(&x).unwrap()
            });
            for (equation, (plus, minus)) in plus.iter().zip(&minus).enumerate() {
                let (expected, found) = ((plus - minus) / (2.0 * step), jacobian[equation * count + unknown]);
                let name = &problem.unknowns[unknown].name;
                assert!((found - expected).abs() < 1e-5 * (1.0 + expected.abs()), "{name}: {found} {expected}");
            }
        }
    }
}

#[test]
fn rank_is_judged_at_the_recorded_poses() {
    let mut random = Random(4);
    let scene = five_axes();
    let (target, observer) = (random.pose(300.0), scene.observer(&mut random));
    let problem = scene.problem(&scene.seen(&scene.commands(&mut random), &target, &observer));
    let at_contact = abbe_estimation::at_contact(&problem, &problem.start()).unwrap();
    assert_eq!(at_contact.sets[0].poses(), problem.sets[0].poses());
    let found = estimator().identify(&problem).unwrap();
    assert_eq!((found.rank, found.unknowns), (10, 10));
}

/// The scenes with many more errors than poses of a target tell apart, with as few of them true.
fn scenes_with_lost_directions() -> Vec<Scene> {
    let mut scenes = scenes();
    for (index, scene) in scenes.iter_mut().enumerate() {
        let rotary = index % 2 == 0;
        scene.machine["errors"] = match rotary {
            true => json!([{ "location": ["E?0A", "E?0C"] }]),
            false => json!([{ "location": ["E?0?"] }, { "polynomial": ["EXX", "EYY", "EZZ"], "degrees": [1] }]),
        };
        if !rotary && index < 2 {
            scene.settings["observer"] = json!("estimated");
        }
    }
    scenes
}

/// Columns of norm 1 that span what is lost, with the norm of every unknown's column (1 where it has no effect).
struct Lost {
    basis: DMatrix<f64>,
    norms: Vec<f64>,
}

impl Lost {
    /// By differences and a singular value decomposition, and nothing else.
    fn by_differences(problem: &Problem) -> Self {
        let (start, uncertainties) = (problem.start(), problem.standard_uncertainties());
        let column = |unknown: usize| {
            let step = if problem.unknowns[unknown].unit == abbe_core::Unit::MM { 1e-2 } else { 1e-5 };
            let [up, down] = [step, -step].map(|step| {
                let mut x = start.clone();
                x[unknown] += step;
                problem.residuals(&x).unwrap()
            });
            let differences = up.iter().zip(&down).zip(&uncertainties);
            DVector::from_iterator(
                uncertainties.len(),
                differences.map(|((up, down), uncertainty)| (up - down) / (2.0 * step * uncertainty)),
            )
        };
        let mut columns: Vec<DVector<f64>> = (0..start.len()).map(column).collect();
        let mut norms = Vec::new();
        for column in &mut columns {
            let norm = column.norm();
            // A unit of any unknown is 1e2 standard uncertainties or more; of nothing, differences leave 1e-5.
            *column *= if norm > 1e-2 { 1.0 / norm } else { 0.0 };
            norms.push(if norm > 1e-2 { norm } else { 1.0 });
        }
        let svd = DMatrix::from_columns(&columns).svd(false, true);
        let (values, vectors) = (svd.singular_values, svd.v_t.unwrap());
        assert!(values.iter().all(|value| !(1e-6..1e-4).contains(value)), "it is open what is lost: {values}");
        let lost: Vec<usize> = (0..norms.len()).filter(|&k| values[k] < 1e-6).collect();
        Self { basis: vectors.select_rows(&lost).transpose(), norms }
    }

    /// How much of what an estimator calls lost is not.
    fn outside(&self, problem: &Problem, found: &Identifiability) -> f64 {
        let outside = found.null_space.iter().map(|vector| {
            let change = problem.unknowns.iter().zip(&self.norms).map(|(unknown, norm)| {
                let part = vector.combination.iter().find(|part| part.name == unknown.name);
                part.map_or(0.0, |part| part.coefficient * norm)
            });
            let change = DVector::from_iterator(self.norms.len(), change).normalize();
            (&change - &self.basis * (self.basis.transpose() * &change)).norm()
        });
        outside.fold(0.0, f64::max)
    }
}

#[test]
fn what_is_lost_does_not_depend_on_what_was_seen() {
    let mut random = Random(6);
    for trial in 0..48 {
        let scene = &scenes_with_lost_directions()[trial % 4];
        let (target, observer) = (random.pose(300.0), scene.observer(&mut random));
        let commands = scene.commands(&mut random);
        let exact = scene.problem_of_all(&scene.seen(&commands, &target, &observer));
        let lost = Lost::by_differences(&exact);
        assert!(lost.basis.ncols() > 0);
        // As seen exactly, with noise, with noise that no instrument has, and with every tenth row all wrong.
        for (place, (shift, turn, wrong)) in
            [(0.0, 0.0, false), (0.02, 5e-5, false), (1.0, 1e-2, false), (0.02, 5e-5, true)].into_iter().enumerate()
        {
            let text = scene.seen_off(&commands, &target, &observer, |row| match wrong && row % 10 == 2 {
                true => Isometry3::new(random.vector() * 200.0, random.vector() * 0.5),
                false => Isometry3::new(random.vector() * shift, random.vector() * turn),
            });
            let problem = scene.problem_of_all(&text);
            let found = estimator().identify(&problem).unwrap();
            assert_eq!(found.unknowns - found.rank, lost.basis.ncols(), "{trial} {place}");
            // Where target and observer start depends on what was seen, and with it by how much they change.
            let there = Lost::by_differences(&problem);
            assert_eq!(there.basis.ncols(), lost.basis.ncols(), "{trial} {place}");
            let outside = there.outside(&problem, &found);
            assert!(outside < 1e-7, "{trial} {place}: {outside:e}");
        }
    }
}

/// A half turn, and turns about an axis square to it: the same orientations are seen by an observer that is turned by half about that axis.
#[test]
fn positions_choose_where_two_orientations_agree() {
    let mut random = Random(8);
    for trial in 0..200 {
        let (target, observer, frame) = (random.pose(300.0), random.pose(1500.0), random.pose(0.0).rotation);
        let states = [Vector3::zeros(), Vector3::z() * std::f64::consts::PI, Vector3::x() * (1.3 * random.number())];
        let tools: Vec<Isometry3<f64>> = (0..12)
            .map(|row| Isometry3::new(random.vector() * 200.0, states[row % 3]))
            .map(|tool| Isometry3::from_parts(tool.translation, frame * tool.rotation))
            .collect();
        let noise = [0.0, 1e-4][trial % 2];
        let seen: Vec<Isometry3<f64>> = (tools.iter())
            .map(|tool| {
                (tool * observer).inverse() * target * Isometry3::new(Vector3::zeros(), random.vector() * noise)
            })
            .collect();
        let found = start::target_and_observer(&tools, &seen).unwrap();
        for (found, truth) in [(found.target, target), (found.observer, observer)] {
            let turned = found.rotation.angle_to(&truth.rotation);
            assert!(turned < 1e-9 + 20.0 * noise, "{trial}: {turned:e} with {noise:e}");
            let off = (found.translation.vector - truth.translation.vector).norm();
            assert!(off < 1e-5 + 4e4 * noise, "{trial}: {off:e}");
        }
    }
}

#[test]
fn bad_poses_are_refused() {
    let mut random = Random(5);
    let (target, observer) = (random.pose(300.0), random.pose(1500.0));
    let scene = positioner();
    let all = scene.commands(&mut random);
    let good = scene.seen(&all, &target, &observer);
    let error = |scene: &Scene, text: &str| scene.observe(text).err().map(|error| error.to_string()).unwrap();

    let undetermined = "do not determine where target and observer stand";
    for count in [1, 2] {
        let text = error(&scene, &scene.seen(&all[..count], &target, &observer));
        assert!(text.contains(&format!("{count} pose")) && text.contains(undetermined), "{text}");
    }
    let one_axis: Vec<Vec<f64>> = all.iter().map(|commands| vec![12.0, commands[1]]).collect();
    assert!(error(&scene, &scene.seen(&one_axis, &target, &observer)).contains(undetermined));
    assert!(scene.observe(&scene.seen(&all[..3], &target, &observer)).is_ok());

    // An observer that is the tool needs one pose.
    let mut at_tool = positioner();
    at_tool.settings["observer"] = json!("at-tool");
    assert!(at_tool.observe(&at_tool.seen(&all[..1], &target, &Isometry3::identity())).is_ok());
    assert!(error(&at_tool, &good).contains("of the orientations are"));

    // The other pose than the setting says, columns that are mixed up.
    let mut inverse = positioner();
    inverse.settings["pose"] = json!("observer-in-target");
    assert!(error(&inverse, &good).contains("is `pose` right"), "{}", error(&inverse, &good));
    assert!(error(&scene, &good.replacen("A_deg,C_deg", "C_deg,A_deg", 1)).contains("(`reverse`)"));

    let mut lines: Vec<String> = good.lines().map(str::to_owned).collect();
    let cut = lines[3].rfind(',').unwrap();
    lines[3] = format!("{},2", &lines[3][..cut]);
    let text = error(&scene, &lines.join("\n"));
    assert!(text.contains("poses.csv:4") && text.contains("the quaternion qw, qx, qy, qz has the norm 2."), "{text}");

    let headers: Vec<ColumnHeader> = ["A_deg", "C_deg", "x", "y_mm"].map(ColumnHeader::parse).into();
    let text = artefact(&scene.settings).check(&headers, None, scene.model().as_ref()).unwrap_err().to_string();
    assert!(text.contains("the column `x` does not say its unit"), "{text}");
    let settings = json!({ "standard_uncertainty_um": 20, "standard_uncertainty_urad": 0 });
    let text = abbe_core::from_settings(&settings)
        .and_then(|settings| build(settings, &Context { base: PathBuf::new() }))
        .err()
        .unwrap()
        .to_string();
    assert!(text.starts_with("standard_uncertainty_urad: 0: a positive number was expected"), "{text}");
}

#[test]
fn the_example_builds() {
    assert!(build(abbe_core::from_settings(&example()).unwrap(), &Context { base: PathBuf::new() }).is_ok());
}
