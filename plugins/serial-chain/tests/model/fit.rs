//! Proves that a linear fit of all location and set-up errors leaves the same residuals wherever the machine origin is:
//! the set is closed under moving it.

use abbe_core::KinematicModel;
use abbe_core::{Poses, Variable};
use abbe_numerics::{Accumulator, End, LeastSquares, Options, solve};
use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::oracle::Random;
use crate::subject;

/// Residuals of the fit to `readings` of the positions at `statuses`.
fn residuals(settings: &Value, statuses: &[f64], readings: &[f64]) -> Vec<f64> {
    let model = subject::model(settings, &[]);
    let count = model.info().parameters.len();
    let wanted: Vec<Variable> = (0..count).map(Variable::Parameter).collect();
    let mut poses = Poses::default();
    model.poses(statuses, &vec![0.0; count], &wanted, false, &mut poses).expect("poses");
    let row = |equation: usize| -> Vec<f64> {
        let derivatives = &poses.position_derivatives[equation / 3 * count..(equation / 3 + 1) * count];
        derivatives.iter().map(|derivative| derivative[equation % 3]).collect()
    };
    let mut accumulator = Accumulator::new(count, readings.len());
    for (equation, reading) in readings.iter().enumerate() {
        accumulator.push(&row(equation), *reading, 1.0);
    }
    let spectrum = accumulator.finish().spectrum();
    let step = spectrum.step(spectrum.singular_values().rank(1e-9));
    let after = |equation: usize| row(equation).iter().zip(&step).map(|(by, step)| by * step).sum::<f64>();
    readings.iter().enumerate().map(|(equation, reading)| reading + after(equation)).collect()
}

fn settings(chain: &str, rotary: [&str; 2], points: [Vector3<f64>; 2], offset: Vector3<f64>) -> Value {
    let point = |index: usize| json!({ "point_mm": <[f64; 3]>::from(points[index]) });
    let axes: serde_json::Map<String, Value> = (0..2)
        .filter(|&index| chain.contains(rotary[index]))
        .map(|index| (rotary[index].into(), point(index)))
        .collect();
    json!({
        "chain": chain, "tool_length_mm": 200.0, "stylus_radius_mm": 0.0, "axes": axes,
        "probe_offset_mm": <[f64; 3]>::from(offset), "errors": [{ "location": ["E?0*"] }],
    })
}

#[test]
fn residuals_of_a_fit_do_not_depend_on_the_origin() {
    let mut farthest = 0.0_f64;
    // With and without a rotary axis on the tool side: without, the tip itself is relative to the origin.
    for (seed, (chain, rotary, tip_hangs_on_rotary)) in [
        ("w C B X b Z Y t", ["C", "B"], false),
        ("w X Y b Z C A t", ["C", "A"], true),
        ("w C X b Y Z B t", ["C", "B"], true),
        ("w X b Y Z t", ["A", "B"], false),
        ("w A X b B Y Z t", ["A", "B"], true),
    ]
    .into_iter()
    .enumerate()
    {
        let random = &mut Random::new(seed as u64);
        let points = [random.vector(200.0), random.vector(200.0)];
        let (offset, v) = (random.vector(50.0), random.vector(400.0));
        let here = settings(chain, rotary, points, offset);
        let moved_offset = if tip_hangs_on_rotary { offset } else { offset - v };
        let there = settings(chain, rotary, points.map(|point| point - v), moved_offset);
        let statuses = subject::statuses(&*subject::model(&here, &[]), random, 60);
        let readings: Vec<f64> = (0..180).map(|_| 0.01 * random.signed()).collect();
        let [here, there] = [here, there].map(|settings| residuals(&settings, &statuses, &readings));
        let size = here.iter().fold(0.0_f64, |size, residual| size.max(residual.abs()));
        assert!(size > 1e-3, "{chain}: noise cannot be fitted away");
        for (here, there) in here.iter().zip(&there) {
            farthest = farthest.max((here - there).abs() / size);
        }
    }
    println!("largest change of a residual: {farthest:.1e} of the largest");
    assert!(farthest < 1e-10, "{farthest:e}");
}

/// Readings of the position error of X, as a problem in some of the model's parameters.
struct Positioning<'a> {
    model: &'a dyn KinematicModel,
    statuses: Vec<f64>,
    readings: Vec<f64>,
    /// Values of all parameters; those of `unknowns` give way to x.
    values: Vec<f64>,
    unknowns: Vec<usize>,
}

impl Positioning<'_> {
    fn poses(&self, x: &[f64]) -> Poses {
        let mut values = self.values.clone();
        self.unknowns.iter().zip(x).for_each(|(&unknown, value)| values[unknown] = *value);
        let wanted: Vec<Variable> = self.unknowns.iter().copied().map(Variable::Parameter).collect();
        let mut poses = Poses::default();
        self.model.poses(&self.statuses, &values, &wanted, false, &mut poses).expect("poses");
        poses
    }

    fn residuals_of(&self, poses: &Poses) -> Vec<f64> {
        // In units of 0.1 um.
        poses.positions.iter().zip(&self.readings).map(|(tip, reading)| (tip[0] - reading) / 1e-4).collect()
    }
}

impl LeastSquares for Positioning<'_> {
    type Error = std::convert::Infallible;

    fn unknowns(&self) -> usize {
        self.unknowns.len()
    }

    fn rows(&self) -> usize {
        self.readings.len()
    }

    fn linearise(&self, x: &[f64], sink: &mut dyn FnMut(usize, &[f64], &[f64])) -> Result<(), Self::Error> {
        let poses = self.poses(x);
        let derivatives: Vec<f64> = poses.position_derivatives.iter().map(|by| by[0] / 1e-4).collect();
        sink(0, &self.residuals_of(&poses), &derivatives);
        Ok(())
    }
}

#[test]
fn a_wavelength_is_found_from_the_nominal_pitch() {
    // 1100 periods over the travel, on a pitch that is 25 nm longer than the nominal one (Soons 1993, section 3.2.4).
    let settings = json!({
        "chain": "w b X t", "tool_length_mm": 100.0, "stylus_radius_mm": 0.0,
        "errors": [
            { "polynomial": ["EXX"], "degrees": [1, 2] },
            { "periodic": ["EXX"], "wavelength_mm": 0.635, "functions": 3, "estimate_wavelength": true },
        ],
    });
    let model = subject::model(&settings, &[]);
    let named = |name: &str| model.info().parameters.iter().position(|it| it.name == name).expect("a parameter");
    let names = ["EXX[1]", "EXX[2]", "EXX[per0.635:1]", "EXX[per0.635:2]", "EXX[per0.635:3]"].map(named);
    let wavelength = named("EXX[per0.635].wavelength");
    let mut truth = model.info().nominal.clone();
    assert_eq!(truth[wavelength], 0.635);
    names.iter().zip([1.1e-5, 2.7e-8, 0.057, -0.011, -0.038]).for_each(|(&name, value)| truth[name] = value);
    truth[wavelength] = 0.635025;
    let coarse = (0..=233).map(|step| 3.0 * f64::from(step));
    let statuses: Vec<f64> = coarse.chain((0..1000).map(|step| 0.025 * f64::from(step))).collect();
    let mut poses = Poses::default();
    model.poses(&statuses, &truth, &[], false, &mut poses).expect("poses");
    let readings = poses.positions.iter().map(|tip| tip[0]).collect();
    let mut problem = Positioning {
        model: &*model,
        statuses,
        readings,
        values: model.info().nominal.clone(),
        unknowns: names.to_vec(),
    };
    let options = Options { iterations: 60, ..Options::USUAL };
    let Ok(amplitudes) = solve(&problem, &[0.0; 5], &options);
    assert_eq!(amplitudes.end, End::Converged);
    problem.unknowns.push(wavelength);
    let Ok(all) = solve(&problem, &[&amplitudes.x[..], &[0.635]].concat(), &options);
    let off = (all.x[5] - 0.635025).abs();
    println!("wavelength off by {off:.1e} mm after {} iterations", all.iterations);
    assert_eq!(all.end, End::Converged);
    assert!(off < 1e-11, "{off:e}");
    for (found, name) in all.x.iter().zip(names) {
        assert!((found / truth[name] - 1.0).abs() < 1e-6, "{found} {}", truth[name]);
    }
}
