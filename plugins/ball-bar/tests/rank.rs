//! What the readings of a bar determine: random machines and set-ups whose lost directions are known.

use std::fmt::Write as _;
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;

use abbe_ball_bar as _;
use abbe_core::{
    AxisKind, Build, Combination, Context, Estimate, Identifiability, Kind, KinematicModel, ObservationSet, Poses,
    Problem, Registry, Variable,
};
use abbe_estimation::rank_point;
use abbe_gauss_newton as _;
use abbe_serial_chain as _;
use nalgebra::{DMatrix, DVector, Vector3};
use serde_json::{Value, json};

/// Numbers that look random and are the same in every run.
struct Random(u64);

impl Random {
    /// Evenly distributed between -1 and 1 (Knuth's linear congruential generator).
    fn number(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.number() + 1.0) / 2.0
    }

    fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from([(); 3].map(|()| self.number())) * size
    }

    /// A place that is off in every direction, by 0.3 to 1 times `size`: where one is off by nothing but a nanometre, rounding decides
    /// what is lost.
    fn off(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from([(); 3].map(|()| self.number())).map(|part| size * part.signum() * (0.3 + 0.7 * part.abs()))
    }

    fn direction(&mut self) -> Vector3<f64> {
        loop {
            let vector = self.vector(1.0);
            if (0.1..1.0).contains(&vector.norm()) {
                return vector.normalize();
            }
        }
    }

    fn of<'a, T>(&mut self, list: &'a [T]) -> &'a T {
        &list[(self.between(0.0, list.len() as f64) as usize).min(list.len() - 1)]
    }
}

fn context(base: PathBuf) -> Context {
    Context { base }
}

fn model(settings: &Value) -> Arc<dyn KinematicModel> {
    let registry = Registry::built_in().unwrap();
    let Build::Model(constructor) = &registry.find(Kind::Model, "serial-chain").unwrap().build else { panic!() };
    constructor.build(settings, &context(PathBuf::new())).unwrap().build(&[]).unwrap()
}

fn estimator(settings: &Value) -> Box<dyn Estimate> {
    let registry = Registry::built_in().unwrap();
    let Build::Estimate(constructor) = &registry.find(Kind::Estimate, "gauss-newton").unwrap().build else { panic!() };
    constructor.build(settings, &context(PathBuf::new())).unwrap()
}

/// A row that is to be measured: commands by status (mm, rad), ball, bar and test.
#[derive(Clone)]
struct Planned {
    status: Vec<f64>,
    ball: usize,
    bar: usize,
    test: usize,
}

/// A machine, balls as the file has them, bars, and rows.
#[derive(Clone)]
struct Setup {
    machine: Value,
    settings: Value,
    balls: Vec<Vector3<f64>>,
    bars: Vec<f64>,
    rows: Vec<Planned>,
    parameters: Vec<String>,
}

impl Setup {
    fn model(&self) -> Arc<dyn KinematicModel> {
        model(&self.machine)
    }

    /// The problem with these readings, mm.
    fn problem(&self, readings: &[f64], patterns: &[String]) -> Problem {
        let folder = tempfile::tempdir().unwrap();
        let model = self.model();
        let mut balls = "feature,x_mm,y_mm,z_mm\n".to_owned();
        for (index, ball) in self.balls.iter().enumerate() {
            writeln!(balls, "{},{},{},{}", index + 1, ball.x, ball.y, ball.z).unwrap();
        }
        fs::write(folder.path().join("balls.csv"), balls).unwrap();
        let axes = &model.info().axes;
        let columns: Vec<String> = (axes.iter())
            .map(|axis| format!("{}{}", axis.name, if axis.kind == AxisKind::Linear { "_mm" } else { "_rad" }))
            .collect();
        let mut text = format!("{},ball,bar,test,reading_mm\n", columns.join(","));
        for (row, reading) in self.rows.iter().zip(readings) {
            axes.iter().for_each(|axis| write!(text, "{},", row.status[axis.status]).unwrap());
            writeln!(text, "{},b{},t{},{reading}", row.ball + 1, row.bar + 1, row.test).unwrap();
        }
        let file = folder.path().join("rows.csv");
        fs::write(&file, text).unwrap();
        let data = Arc::new(abbe_table::read(&file).unwrap());
        let mut settings = self.settings.clone();
        settings["nominal"] = json!("balls.csv");
        settings["standard_uncertainty_um"] = json!(0.5);
        settings["bars_mm"] =
            self.bars.iter().enumerate().map(|(index, length)| (format!("b{}", index + 1), json!(length))).collect();
        let registry = Registry::built_in().unwrap();
        let Build::Artefact(constructor) = &registry.find(Kind::Artefact, "ball-bar").unwrap().build else { panic!() };
        let artefact = constructor.build(&settings, &context(folder.path().to_owned())).unwrap();
        let observations = artefact.observe(&data, &model).unwrap();
        let sets = vec![ObservationSet::new("bar", observations)];
        Problem::new("fit", "serial-chain", model, sets, patterns).unwrap()
    }

    fn patterns(&self) -> Vec<String> {
        [self.parameters.clone(), vec!["bar.*".to_owned()]].concat()
    }

    /// What a perfect instrument reads on a machine and a set-up with random errors (balls off by up to `offset`, mm).
    fn readings(&self, random: &mut Random, offset: f64) -> Vec<f64> {
        let nothing = vec![0.0; self.rows.len()];
        let all = self.problem(&nothing, &["*".to_owned()]);
        let truth: Vec<f64> = (all.unknowns.iter().zip(all.start()))
            .map(|(unknown, start)| {
                let size = match unknown.name.as_str() {
                    name if name.starts_with("bar.ball") => offset,
                    name if name.starts_with("bar.") => 0.02,
                    name if name.contains('[') => 5e-5,
                    name if ["EX", "EY", "EZ", "dx", "dy", "dz"].iter().any(|kind| name.starts_with(kind)) => 0.05,
                    _ => 1e-4,
                };
                start + size * random.number()
            })
            .collect();
        all.residuals(&truth).unwrap()
    }

    /// The commands that bring the tip of the nominal machine to a point of the table, other statuses as given.
    fn reach(&self, model: &dyn KinematicModel, status: &[f64], target: &Vector3<f64>) -> Vec<f64> {
        let axes = model.info().axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Linear);
        let (wanted, places): (Vec<Variable>, Vec<usize>) =
            axes.map(|(index, axis)| (Variable::Command(index), axis.status)).unzip();
        let mut status = status.to_vec();
        for _ in 0..3 {
            let mut poses = Poses::default();
            model.poses(&status, &model.info().nominal, &wanted, false, &mut poses).unwrap();
            let jacobian = DMatrix::from_fn(3, wanted.len(), |row, k| poses.position_derivatives[k][row]);
            let missing = target - Vector3::from(poses.positions[0]);
            let step = jacobian.svd(true, true).solve(&DVector::from_column_slice(missing.as_slice()), 1e-9).unwrap();
            places.iter().zip(step.iter()).for_each(|(&place, step)| status[place] += step);
        }
        status
    }
}

/// Lost directions, in unknowns that are multiplied by the norms of their columns.
struct Lost {
    /// Orthonormal columns.
    basis: DMatrix<f64>,
    norms: Vec<f64>,
}

/// The null space of a problem at its start by a singular value decomposition of its rows as they are, and nothing else.
fn brute_force(problem: &Problem) -> Lost {
    let (count, mut rows) = (problem.unknowns.len(), Vec::new());
    problem.linearise(&problem.start(), |block| rows.extend_from_slice(block.jacobian)).unwrap();
    let jacobian = DMatrix::from_row_slice(rows.len() / count, count, &rows);
    let columns: Vec<DVector<f64>> = jacobian.column_iter().map(|column| column.into_owned()).collect();
    // What rounding leaves of nothing.
    let norms: Vec<f64> =
        columns.iter().map(|column| if column.norm() < 1e-10 { 0.0 } else { column.norm() }).collect();
    let scaled: Vec<DVector<f64>> = (columns.iter().zip(&norms))
        .map(|(column, norm)| if *norm > 0.0 { column / *norm } else { column * 0.0 })
        .collect();
    let scaled = DMatrix::from_columns(&scaled);
    let svd = scaled.clone().insert_rows(scaled.nrows(), scaled.ncols(), 0.0).svd(false, true);
    let (values, vectors) = (svd.singular_values, svd.v_t.unwrap());
    assert!(values.iter().all(|value| !(1e-10..1e-7).contains(value)), "it is open what is lost: {values}");
    let lost: Vec<usize> = (0..norms.len()).filter(|&k| values[k] < 1e-10).collect();
    Lost { basis: vectors.select_rows(&lost).transpose(), norms }
}

impl Lost {
    /// What an estimator finds, in the measure of another.
    fn found(problem: &Problem, found: &Identifiability, like: &Self) -> Self {
        let vectors: Vec<DVector<f64>> =
            found.null_space.iter().map(|vector| like.scaled(problem, &vector.combination)).collect();
        let basis = if vectors.is_empty() {
            DMatrix::zeros(like.norms.len(), 0)
        } else {
            DMatrix::from_columns(&vectors).qr().q()
        };
        Self { basis, norms: like.norms.clone() }
    }

    fn count(&self) -> usize {
        self.basis.ncols()
    }

    /// A change of unknowns, in units of its length.
    fn scaled(&self, problem: &Problem, combination: &[Combination]) -> DVector<f64> {
        let change = |(unknown, norm): (&abbe_core::Unknown, &f64)| {
            let part = combination.iter().find(|part| part.name == unknown.name);
            part.map_or(0.0, |part| part.coefficient) * if *norm > 0.0 { *norm } else { 1.0 }
        };
        let changes = problem.unknowns.iter().zip(&self.norms).map(change);
        DVector::from_iterator(self.norms.len(), changes).normalize()
    }

    /// How much of a direction of norm 1 is not lost.
    fn outside(&self, direction: &DVector<f64>) -> f64 {
        (direction - &self.basis * (self.basis.transpose() * direction)).norm()
    }

    /// How much of the other's directions is not lost.
    fn all_outside(&self, other: &Self) -> f64 {
        other.basis.column_iter().map(|column| self.outside(&column.into_owned())).fold(0.0, f64::max)
    }
}

fn told(found: &Identifiability) -> String {
    found.null_space.iter().map(|vector| format!("    {:.1e} {}\n", vector.singular_value, vector.changes())).collect()
}

/// Where a row is measured: in which test, with which bar on which ball, on which of the axes X, Y, Z it moves, and where
/// it is about the centre of the test.
#[derive(Clone)]
struct Point {
    ball: usize,
    bar: usize,
    test: usize,
    /// Standing rotary axes, rad, in the order of the chain.
    moving: [bool; 3],
    direction: Vector3<f64>,
    /// Length less that of the bar, mm.
    telescoped: f64,
}

/// Tests of linear axes, on a random machine.
struct Linear {
    setup: Setup,
    /// A status with the rotary axes where they stand.
    standing: Vec<f64>,
    points: Vec<Point>,
    /// The centre of the tests on every ball.
    centres: Vec<Vector3<f64>>,
}

/// What a bar is swept over with the linear axes.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Sweep {
    /// Full circles in three planes.
    Planes,
    /// A full circle and two arcs above it, as a bar on a table can reach.
    Arcs,
    /// Points all over the upper half of a sphere.
    Dome,
    /// One circle.
    Circle,
}

const CHAINS: [&str; 7] = [
    "w b X Y Z t",
    "w X' b Y Z t",
    "w Y' X' b Z t",
    "w C' B' b X Y Z t",
    "w C' A' b X Y Z t",
    "w C' B' X' b Z Y t",
    "w C' b X Y Z t",
];

impl Sweep {
    /// Tests: which axes move, and directions.
    fn tests(self, random: &mut Random) -> Vec<([bool; 3], Vec<Vector3<f64>>)> {
        let circle = |axes: [usize; 2], from: f64, to: f64, random: &mut Random| {
            let directions = (0..24).map(|sample| {
                let angle = (from + (to - from) * (f64::from(sample) + 0.4 * random.number()) / 24.0).to_radians();
                let mut direction = Vector3::zeros();
                (direction[axes[0]], direction[axes[1]]) = (angle.cos(), angle.sin());
                direction
            });
            let directions = directions.collect();
            ([0, 1, 2].map(|axis| axes.contains(&axis)), directions)
        };
        match self {
            Self::Planes => [[0, 1], [1, 2], [2, 0]].map(|axes| circle(axes, 0.0, 360.0, random)).into(),
            Self::Arcs => vec![
                circle([0, 1], 0.0, 360.0, random),
                circle([0, 2], -20.0, 200.0, random),
                circle([1, 2], -20.0, 200.0, random),
            ],
            Self::Dome => {
                let up = |direction: Vector3<f64>| Vector3::new(direction.x, direction.y, direction.z.abs());
                vec![([true; 3], (0..60).map(|_| up(random.direction())).collect())]
            }
            Self::Circle => vec![circle([0, 1], 0.0, 360.0, random)],
        }
    }
}

impl Linear {
    /// On a machine with one of these chains, with balls that the file has up to `off` mm beside the centres of the tests.
    fn on(chains: &[&str], sweep: Sweep, random: &mut Random, off: f64) -> Self {
        let machine = json!({
            "chain": random.of(chains), "tool_length_mm": random.between(80.0, 200.0), "stylus_radius_mm": 0,
            "errors": [{ "location": SQUARENESS }, { "polynomial": ["EXX", "EYY", "EZZ"], "degrees": [1] }],
        });
        let bars: Vec<f64> = [100.0, 150.0, 300.0][..1 + random.between(0.0, 2.99) as usize].to_vec();
        let count = 1 + random.between(0.0, 1.99) as usize;
        let centres: Vec<Vector3<f64>> = (0..count).map(|_| random.vector(300.0)).collect();
        let balls: Vec<Vector3<f64>> = centres.iter().map(|centre| centre + random.off(off)).collect();
        let parameters = [&SQUARENESS[..], &["E??[1]"]].concat().iter().map(|name| (*name).to_owned()).collect();
        let settings = json!({ "lengths": "estimated" });
        let setup = Setup { machine, settings, balls, bars, rows: Vec::new(), parameters };
        let model = setup.model();
        let mut standing = vec![0.0; model.info().status.len()];
        for axis in model.info().axes.iter().filter(|axis| axis.kind == AxisKind::Rotary) {
            standing[axis.status] = 0.7 * random.number();
        }
        let mut points = Vec::new();
        let mut test = 0;
        for ball in 0..count {
            for bar in 0..setup.bars.len() {
                for (moving, directions) in sweep.tests(random) {
                    let point = |direction| Point { ball, bar, test, moving, direction, telescoped: 0.0 };
                    points.extend(directions.into_iter().map(point));
                    test += 1;
                }
            }
        }
        Self { setup, standing, points, centres }
    }

    /// The rows as they are commanded, and recorded up to `sampled` mm beside that where axes move.
    fn recorded(&self, random: &mut Random, sampled: f64) -> Setup {
        self.with_rows(|point, centre, _| {
            let length = self.setup.bars[point.bar] + point.telescoped;
            let noise = random.vector(sampled);
            [0, 1, 2].map(|axis| {
                centre[axis] + if point.moving[axis] { length * point.direction[axis] + noise[axis] } else { 0.0 }
            })
        })
    }

    /// The rows as they would be on a perfect machine whose balls are where the file has them: axes that stand are where they are
    /// recorded, and the bar keeps its length.
    fn ideal(&self) -> Setup {
        self.with_rows(|point, centre, ball| {
            let length = self.setup.bars[point.bar] + point.telescoped;
            let across: f64 =
                (0..3).filter(|&axis| !point.moving[axis]).map(|axis| (centre[axis] - ball[axis]).powi(2)).sum();
            let radius = (length * length - across).sqrt();
            [0, 1, 2].map(|axis| match point.moving[axis] {
                true => ball[axis] + radius * point.direction[axis],
                false => centre[axis],
            })
        })
    }

    /// Commands of X, Y, Z from those at which the nominal tip is in the centre of a test and in the ball of the file.
    fn with_rows(&self, mut commands: impl FnMut(&Point, [f64; 3], [f64; 3]) -> [f64; 3]) -> Setup {
        let mut setup = self.setup.clone();
        let model = setup.model();
        let places: Vec<usize> =
            ["X", "Y", "Z"].map(|name| model.info().axes.iter().find(|axis| axis.name == name).unwrap().status).into();
        let at = |target: &Vector3<f64>| {
            let status = setup.reach(model.as_ref(), &self.standing, target);
            [0, 1, 2].map(|axis| status[places[axis]])
        };
        let centres: Vec<([f64; 3], [f64; 3])> =
            self.centres.iter().zip(&setup.balls).map(|(centre, ball)| (at(centre), at(ball))).collect();
        let rows = self.points.iter().map(|point| {
            let (centre, ball) = centres[point.ball];
            let mut status = self.standing.clone();
            places.iter().zip(commands(point, centre, ball)).for_each(|(&place, command)| status[place] = command);
            Planned { status, ball: point.ball, bar: point.bar, test: point.test }
        });
        setup.rows = rows.collect();
        setup
    }

    /// The direction that no bar of unknown length sees, however it is swept: machine, balls and bars grow together.
    fn similarity(&self, problem: &Problem, readings: &[f64]) -> Vec<Combination> {
        let model = &problem.model;
        let mut poses = Poses::default();
        model.poses(&self.standing, &model.info().nominal, &[], false, &mut poses).unwrap();
        let origin = Vector3::from(poses.positions[0]);
        // An axis that carries the workpiece may well be positive where its scale moves the tip back.
        let sign = |scale: &abbe_core::Unknown| {
            let axis = model.info().axes.iter().position(|axis| axis.name == scale.name[2..3]).unwrap();
            let mut status = self.standing.clone();
            status[model.info().axes[axis].status] = 1.0;
            let wanted = [Variable::Parameter(scale.index), Variable::Command(axis)];
            let mut poses = Poses::default();
            model.poses(&status, &model.info().nominal, &wanted, false, &mut poses).unwrap();
            Vector3::from(poses.position_derivatives[0]).dot(&Vector3::from(poses.position_derivatives[1])).signum()
        };
        let combination = problem.unknowns.iter().map(|unknown| {
            let number = |own: &str| own[5..6].parse::<usize>().unwrap() - 1;
            let coefficient = match unknown.name.strip_prefix("bar.") {
                None if unknown.name.ends_with("[1]") => sign(unknown),
                None => 0.0,
                Some(own) if own.starts_with("bar[b") => {
                    let bar = number(own);
                    let of_bar = self.points.iter().zip(readings).filter(|(point, _)| point.bar == bar);
                    let of_bar: Vec<f64> = of_bar.map(|(_, reading)| *reading).collect();
                    let (least, most) =
                        (of_bar.iter().copied().reduce(f64::min), of_bar.iter().copied().reduce(f64::max));
                    self.setup.bars[bar] + (least.unwrap() + most.unwrap()) / 2.0
                }
                Some(own) => {
                    let axis = "xyz".find(&own[own.len() - 1..]).unwrap();
                    (self.setup.balls[number(own)] - origin)[axis]
                }
            };
            Combination { name: unknown.name.clone(), coefficient, unit: unknown.unit.to_string() }
        });
        combination.collect()
    }
}

const SQUARENESS: [&str; 3] = ["EC0Y", "EB0Z", "EA0Z"];

/// How far the file has balls beside the centres of tests, and recorded positions are off, mm.
const OFF: [(f64, f64); 5] = [(0.0, 0.0), (0.1, 0.0), (0.0, 0.01), (0.3, 0.02), (0.01, 1e-4)];

#[test]
fn scales_and_unknown_lengths_are_found_together_or_not_at_all() {
    let mut random = Random(1);
    let mut wrong = Vec::new();
    let estimator = estimator(&json!({}));
    for trial in 0..240 {
        let sweep = [Sweep::Planes, Sweep::Arcs, Sweep::Dome, Sweep::Circle][trial % 4];
        let (mut off, sampled) = OFF[trial % OFF.len()];
        if sweep == Sweep::Circle {
            // In the plane of a circle the bar does not see its ball move across: that column would be rounding and nothing else.
            off += 0.01;
        }
        let mut linear = Linear::on(&CHAINS, sweep, &mut random, off);
        if trial % 3 == 1 {
            linear.setup.settings["tool_ball_standard_uncertainty_um"] = json!(0.2);
        }
        let ideal = linear.ideal();
        let expected = brute_force(&ideal.problem(&vec![0.0; ideal.rows.len()], &ideal.patterns()));
        let setup = linear.recorded(&mut random, sampled);
        let offset = random.between(0.0, 0.2);
        let readings = setup.readings(&mut random, offset);
        let problem = setup.problem(&readings, &setup.patterns());
        let found = estimator.identify(&problem).unwrap();
        let lost = Lost::found(&problem, &found, &expected);
        let off_expected = expected.all_outside(&lost);
        let off_similarity = lost.outside(&expected.scaled(&problem, &linear.similarity(&problem, &readings)));
        if lost.count() != expected.count() || off_expected > 0.02 || off_similarity > 1e-4 {
            wrong.push(format!(
                "{trial} {sweep:?} {} {off} {sampled}: {} of {}, {off_expected:.1e}, {off_similarity:.1e}\n{}",
                setup.machine["chain"],
                lost.count(),
                expected.count(),
                told(&found)
            ));
        }
    }
    assert!(wrong.is_empty(), "{} of 240:\n{}", wrong.len(), wrong.concat());
}

#[test]
fn what_is_lost_at_the_start_is_lost_at_the_solution() {
    let mut random = Random(3);
    for trial in 0..30 {
        let sweep = [Sweep::Planes, Sweep::Arcs, Sweep::Dome][trial % 3];
        let (off, sampled) = OFF[trial % OFF.len()];
        let linear = Linear::on(&CHAINS, sweep, &mut random, off);
        let setup = linear.recorded(&mut random, sampled);
        let readings = setup.readings(&mut random, 0.1);
        let problem = setup.problem(&readings, &setup.patterns());
        let error = estimator(&json!({})).estimate(&problem).expect_err("it is confounded").to_string();
        assert!(error.contains("EXX[1]") && error.contains("do not change when all of these do"), "{error}");
        let expected = estimator(&json!({})).identify(&problem).unwrap();
        for choice in ["minimum-norm", "drop"] {
            let calibration = estimator(&json!({ "on_confounded": choice })).estimate(&problem).unwrap();
            assert_eq!(calibration.fit.null_space.len(), expected.null_space.len(), "{trial} {choice}");
            // Of the true scale, 5e-5 at most, readings of 0.3 mm tell 0.015 um.
            assert!(calibration.fit.residual_max_um < 0.05, "{trial} {choice}: {}", calibration.fit.residual_max_um);
            // There the machine has errors, and rows are brought to contact by it.
            let at_solution = problem.with_values(&problem.values_of(&calibration));
            let found = estimator(&json!({})).identify(&at_solution).unwrap();
            assert_eq!(found.rank, expected.rank, "{trial} {sweep:?} {off} {sampled} {choice}:\n{}", told(&found));
        }
    }
}

#[test]
fn a_bar_that_telescopes_or_is_known_tells_the_scale() {
    let mut random = Random(4);
    for trial in 0..60 {
        let sweep = [Sweep::Planes, Sweep::Arcs, Sweep::Dome][trial % 3];
        let mut linear = Linear::on(&CHAINS, sweep, &mut random, 0.1);
        let telescopes = trial % 2 == 0;
        if telescopes {
            let reach = random.between(8.0, 40.0);
            linear.points.iter_mut().for_each(|point| point.telescoped = reach * random.number());
        } else {
            linear.setup.settings["lengths"] = json!("known");
        }
        let (setup, ideal) = (linear.recorded(&mut random, 0.01), linear.ideal());
        // Some machines can be turned as a whole: that is lost.
        let expected = brute_force(&ideal.problem(&vec![0.0; ideal.rows.len()], &ideal.patterns()));
        let readings = setup.readings(&mut random, 0.1);
        // As measured, and as a programme before that, whose readings are all the same.
        for readings in [readings, vec![0.0; setup.rows.len()]] {
            let problem = setup.problem(&readings, &setup.patterns());
            let found = estimator(&json!({})).identify(&problem).unwrap();
            assert_eq!(found.unknowns - found.rank, expected.count(), "{trial} {sweep:?}:\n{}", told(&found));
            assert!(!told(&found).contains("EXX[1]"), "{trial} {sweep:?}:\n{}", told(&found));
            let judged = rank_point(&problem, &problem.start()).unwrap();
            assert_eq!(judged.sets[0].poses() == problem.sets[0].poses(), telescopes, "{trial}");
        }
    }
}

#[test]
fn a_gross_reading_is_no_stroke() {
    let mut random = Random(7);
    for trial in 0..60 {
        let sweep = [Sweep::Planes, Sweep::Arcs, Sweep::Dome][trial % 3];
        let setup = Linear::on(&CHAINS, sweep, &mut random, 0.1).recorded(&mut random, 0.01);
        let mut readings = setup.readings(&mut random, 0.1);
        let rank = |readings: &[f64]| {
            estimator(&json!({})).identify(&setup.problem(readings, &setup.patterns())).unwrap().rank
        };
        let expected = rank(&readings);
        let hit = (random.between(0.0, readings.len() as f64) as usize).min(readings.len() - 1);
        readings[hit] += random.between(5.0, 40.0) * random.number().signum();
        assert_eq!(rank(&readings), expected, "{trial} {sweep:?}");
    }
}

#[test]
fn a_programme_is_judged_as_what_it_will_measure() {
    let mut random = Random(5);
    for trial in 0..60 {
        let sweep = [Sweep::Planes, Sweep::Arcs, Sweep::Dome, Sweep::Circle][trial % 4];
        let linear = Linear::on(&CHAINS, sweep, &mut random, 0.1);
        let setup = linear.recorded(&mut random, 0.01);
        let programme = setup.problem(&vec![0.0; setup.rows.len()], &setup.patterns());
        let readings = setup.readings(&mut random, 0.1);
        let measured = setup.problem(&readings, &setup.patterns());
        let disturbances: Vec<f64> = readings.iter().map(|reading| -reading).collect();
        let ranks = [&programme, &programme.disturbed(&disturbances), &measured]
            .map(|problem| estimator(&json!({})).identify(problem).unwrap().rank);
        assert!(ranks.iter().all(|rank| *rank == ranks[0] && *rank < programme.unknowns.len()), "{trial}: {ranks:?}");
    }
}

/// Sweeps of the rotary axes of a trunnion beside a tool ball that stands on their line, on a ball of their own; and tests in which
/// all axes move.
fn with_rotary_tests(
    linear: Option<Linear>,
    chain: &str,
    random: &mut Random,
    off: f64,
    sampled: f64,
) -> (Setup, Setup) {
    let tilting = if chain.contains('A') { ("A", 0) } else { ("B", 1) };
    let mut both = match linear {
        Some(linear) => [linear.recorded(random, sampled), linear.ideal()],
        None => {
            let machine = json!({
                "chain": chain, "tool_length_mm": random.between(80.0, 200.0), "stylus_radius_mm": 0,
                "errors": [{ "location": SQUARENESS }, { "polynomial": ["EXX", "EYY", "EZZ"], "degrees": [1] }],
            });
            let settings = json!({ "lengths": "estimated" });
            let none = Setup { machine, settings, balls: vec![], bars: vec![100.0], rows: vec![], parameters: vec![] };
            [none.clone(), none]
        }
    };
    let model = model(&both[0].machine);
    let place = |name: &str| model.info().axes.iter().find(|axis| axis.name == name).unwrap().status;
    let ball = both[0].balls.len();
    let length = both[0].bars[0];
    // Both tests reach it: from the tilting axis along the third direction, from C along the first or second.
    let (tilt_axis, other) = (tilting.1, 1 - tilting.1);
    let mut centre = Vector3::zeros();
    (centre[tilt_axis], centre[other]) = (random.between(20.0, 60.0), length * random.between(0.4, 0.6));
    centre.z = random.between(10.0, 30.0);
    let mut rows = Vec::new();
    let test = both[0].rows.iter().map(|row| row.test + 1).max().unwrap_or(0);
    for (index, (axis, from, to)) in [(tilting.0, -40.0_f64, 70.0_f64), ("C", 0.0, 360.0)].into_iter().enumerate() {
        // The tool ball on the line of the axis, as far along it as the bar reaches.
        let along = if index == 0 { tilt_axis } else { 2 };
        let mut across = centre;
        across[along] = 0.0;
        let mut tip = Vector3::zeros();
        tip[along] = centre[along] + (length * length - across.norm_squared()).sqrt();
        let mut status = both[0].reach(model.as_ref(), &vec![0.0; model.info().status.len()], &tip);
        for sample in 0..24 {
            status[place(axis)] = (from + (to - from) * f64::from(sample) / 24.0).to_radians();
            rows.push(Planned { status: status.clone(), ball, bar: 0, test: test + index });
        }
    }
    for setup in &mut both {
        setup.balls.push(centre + random.off(off));
        setup.rows.extend(rows.iter().cloned());
        let errors = setup.machine["errors"].as_array_mut().unwrap();
        errors.push(json!({ "location": [format!("E?0{}", tilting.0), "E?0C"] }));
        setup.parameters = ["E?0?", "E??[1]", "dxt", "dyt", "dzt"].map(str::to_owned).into();
    }
    let [recorded, mut ideal] = both;
    ideal.balls = recorded.balls.clone();
    (recorded, ideal)
}

#[test]
fn linear_axes_that_stand_while_rotary_ones_sweep_tell_nothing_of_themselves() {
    let mut random = Random(2);
    let mut wrong = Vec::new();
    let estimator = estimator(&json!({}));
    for trial in 0..200 {
        let (off, sampled) = OFF[trial % OFF.len()];
        let sweep = [None, Some(Sweep::Planes), Some(Sweep::Circle), None, Some(Sweep::Dome)][trial / 5 % 5];
        let chain = ["w C' B' b X Y Z t", "w C' A' b X Y Z t"][trial / 25 % 2];
        let linear = sweep.map(|sweep| Linear::on(&[chain], sweep, &mut random, off));
        let (mut setup, mut ideal) = with_rotary_tests(linear, chain, &mut random, off, sampled);
        if trial % 3 == 1 {
            let known = json!(0.2);
            setup.settings["tool_ball_standard_uncertainty_um"] = known.clone();
            ideal.settings["tool_ball_standard_uncertainty_um"] = known;
        }
        let expected = brute_force(&ideal.problem(&vec![0.0; ideal.rows.len()], &ideal.patterns()));
        let offset = random.between(0.0, 0.2);
        let readings = setup.readings(&mut random, offset);
        let problem = setup.problem(&readings, &setup.patterns());
        let found = estimator.identify(&problem).unwrap();
        let lost = Lost::found(&problem, &found, &expected);
        let outside = expected.all_outside(&lost);
        if lost.count() != expected.count() || outside > 0.02 {
            wrong.push(format!(
                "{trial} {sweep:?} {chain} {off} {sampled}: {} of {}, {outside:.1e}\n{}",
                lost.count(),
                expected.count(),
                told(&found)
            ));
        }
    }
    assert!(wrong.is_empty(), "{} of 200:\n{}", wrong.len(), wrong.concat());
}
