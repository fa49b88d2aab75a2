//! Readings that follow errors to first order: their derivatives are those of differences on random chains, they do not depend on the
//! errors, and they are those of exact readings where there are none.

use std::fmt::Write as _;
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;

use abbe_ball_bar as _;
use abbe_core::{AxisKind, Build, Context, Kind, KinematicModel, ObservationSet, Owner, Problem, Registry};
use abbe_serial_chain as _;
use serde_json::json;

/// Numbers that look random and are the same in every run.
struct Random(u64);

impl Random {
    fn within(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
}

const CHAINS: [&str; 8] = [
    "w b X Y Z t",
    "w X' b Y Z t",
    "w Y' X' b Z t",
    "w C' A' b Y X Z t",
    "w C' B' X' b Z Y t",
    "w C' X' b Y Z B t",
    "w X' Y' b Z C A t",
    "w A' Y' b X Z C t",
];

fn model(chain: &str, evaluation: &str, random: &mut Random) -> Arc<dyn KinematicModel> {
    let axes: Vec<char> = chain.chars().filter(char::is_ascii_uppercase).collect();
    let linear: Vec<String> =
        axes.iter().filter(|axis| ('X'..='Z').contains(axis)).map(|axis| format!("E?{axis}")).collect();
    let mut points = serde_json::Map::new();
    for axis in axes.iter().filter(|axis| ('A'..='C').contains(axis)) {
        let point = [0; 3].map(|_| random.within(-40.0, 40.0));
        points.insert(axis.to_string(), json!({ "point_mm": point }));
    }
    let settings = json!({
        "chain": chain, "tool_length_mm": random.within(50.0, 200.0), "stylus_radius_mm": 0, "axes": points,
        "evaluation": evaluation,
        "errors": [
            { "location": axes.iter().map(|axis| format!("E?0{axis}")).collect::<Vec<_>>() },
            { "polynomial": linear, "degrees": [1, 2] },
        ],
    });
    let registry = Registry::built_in().unwrap();
    let Build::Model(constructor) = &registry.find(Kind::Model, "serial-chain").unwrap().build else { panic!() };
    constructor.build(&settings, &Context { base: PathBuf::new() }).unwrap().build(&[]).unwrap()
}

/// The problem of two balls and two bars of unknown length at random poses, in some of which the bar is far from the tip's way.
fn problem(chain: &str, evaluation: &str, seed: u64) -> Problem {
    let random = &mut Random(seed);
    let model = model(chain, evaluation, random);
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("balls.csv"), "feature,x_mm,y_mm,z_mm\n1,20,-30,40\n2,-60,50,10\n").unwrap();
    let axes = &model.info().axes;
    let column = |kind: AxisKind| if kind == AxisKind::Linear { "_mm" } else { "_rad" };
    let columns: Vec<String> = axes.iter().map(|axis| format!("{}{}", axis.name, column(axis.kind))).collect();
    let mut text = format!("{},ball,bar,reading_mm\n", columns.join(","));
    for row in 0..24 {
        for axis in axes {
            let reach = if axis.kind == AxisKind::Linear { 180.0 } else { 1.2 };
            write!(text, "{},", random.within(-reach, reach)).unwrap();
        }
        writeln!(text, "{},b{},{}", 1 + row % 2, 1 + row / 12, random.within(-0.5, 0.5)).unwrap();
    }
    let file = folder.path().join("rows.csv");
    fs::write(&file, text).unwrap();
    let data = Arc::new(abbe_table::read(&file).unwrap());
    let settings = json!({
        "nominal": "balls.csv", "bars_mm": { "b1": 100.0, "b2": 150.0 }, "lengths": "estimated",
        "standard_uncertainty_um": 0.5, "tool_ball_standard_uncertainty_um": 0.2, "evaluation": evaluation,
    });
    let registry = Registry::built_in().unwrap();
    let Build::Artefact(constructor) = &registry.find(Kind::Artefact, "ball-bar").unwrap().build else { panic!() };
    let artefact = constructor.build(&settings, &Context { base: folder.path().to_owned() }).unwrap();
    let observations = artefact.observe(&data, &model).unwrap();
    let sets = vec![ObservationSet::new("bar", observations)];
    Problem::new("fit", "serial-chain", model, sets, &["*".to_owned()]).unwrap()
}

/// Residuals and derivatives, row by row.
fn linearised(problem: &Problem, at: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let (mut residuals, mut jacobian) = (Vec::new(), Vec::new());
    problem
        .linearise(at, |block| {
            residuals.extend_from_slice(block.residuals);
            jacobian.extend_from_slice(block.jacobian);
        })
        .unwrap();
    (residuals, jacobian)
}

/// Random values near the start: a tenth of a millimetre, 1e-4 rad, and what has an effect like that.
fn random_values(problem: &Problem, random: &mut Random) -> Vec<f64> {
    let mut values = problem.start();
    for (value, unknown) in values.iter_mut().zip(&problem.unknowns) {
        let size = match unknown.unit.to_string().as_str() {
            "mm" => 0.1,
            "1/mm" | "rad/mm^2" => 1e-7,
            _ => 1e-4,
        };
        *value += random.within(-size, size);
    }
    values
}

#[test]
fn derivatives_are_those_of_differences_on_random_chains() {
    let mut worst = 0.0_f64;
    for seed in 0..32 {
        let chain = CHAINS[seed as usize % CHAINS.len()];
        let problem = problem(chain, "first-order", seed);
        let random = &mut Random(1000 + seed);
        let at = random_values(&problem, random);
        let (_, jacobian) = linearised(&problem, &at);
        let count = at.len();
        for unknown in 0..count {
            let largest = jacobian.iter().skip(unknown).step_by(count).fold(0.0_f64, |most, own| most.max(own.abs()));
            // Linear: a step may be large, with an effect of a millimetre.
            let step = 1.0 / largest.max(1e-3);
            let moved = |by: f64| {
                let mut at = at.clone();
                at[unknown] += by;
                linearised(&problem, &at).0
            };
            for (row, (plus, minus)) in moved(step).iter().zip(&moved(-step)).enumerate() {
                let off = (jacobian[row * count + unknown] - (plus - minus) / (2.0 * step)).abs();
                let relative = off / largest.max(1e-3);
                assert!(relative < 1e-9, "seed {seed}, {chain}: {} by {relative:e}", problem.unknowns[unknown].name);
                worst = worst.max(relative);
            }
        }
    }
    println!("largest deviation: {worst:.1e}");
}

#[test]
fn readings_are_linear_in_the_errors() {
    for seed in 0..16 {
        let chain = CHAINS[seed as usize % CHAINS.len()];
        let problem = problem(chain, "first-order", seed);
        let random = &mut Random(2000 + seed);
        let (start, at) = (problem.start(), random_values(&problem, random));
        let ((at_start, one), (there, other)) = (linearised(&problem, &start), linearised(&problem, &at));
        assert!(one.iter().zip(&other).all(|(one, other)| (one - other).abs() <= 1e-9 * one.abs().max(1.0)), "{chain}");
        for (row, (before, after)) in at_start.iter().zip(&there).enumerate() {
            let by: f64 = (0..at.len()).map(|own| one[row * at.len() + own] * (at[own] - start[own])).sum();
            assert!((after - before - by).abs() < 1e-10, "seed {seed}, {chain}, row {row}");
        }
    }
}

#[test]
fn without_errors_exact_readings_have_the_same_derivatives() {
    for (seed, chain) in (0..).zip(CHAINS) {
        let [linear, exact] = ["first-order", "exact"].map(|evaluation| problem(chain, evaluation, seed));
        let at = exact.start();
        let ((residuals, one), (of_exact, other)) = (linearised(&linear, &at), linearised(&exact, &at));
        assert!(residuals.iter().zip(&of_exact).all(|(one, other)| (one - other).abs() < 1e-10), "{chain}");
        let largest = other.iter().fold(0.0_f64, |most, own| most.max(own.abs()));
        assert!(one.iter().zip(&other).all(|(one, other)| (one - other).abs() < 1e-11 * largest), "{chain}");
        // Away from it they differ: the setting has reached both.
        let at = random_values(&exact, &mut Random(seed));
        let machine = |problem: &Problem| problem.unknowns.iter().filter(|own| own.owner == Owner::Machine).count();
        assert!(machine(&exact) > 10 && machine(&exact) == machine(&linear));
        let (one, other) = (linearised(&linear, &at).0, linearised(&exact, &at).0);
        assert!(one.iter().zip(&other).any(|(one, other)| (one - other).abs() > 1e-7), "{chain}");
    }
}
