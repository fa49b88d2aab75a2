//! Random linear problems: the update is the estimate from old and new rows at once, the test is that of the innovation.

use std::sync::Arc;

use abbe_core::{
    Absent, Build, Calibration, Contact, Context, Dataset, Equations, Estimate, Fit, Kind, KinematicModel, KnownInput,
    Layout, ModelInfo, ObservationSet, Observations, ObservationsInfo, Parameter, PoseBatch, PosesMut, Problem,
    Quantity, Registry, Result, RowBatch, RowIndex, Status, StatusColumn, Unit, Variable,
};
use abbe_gauss_newton as _;
use abbe_monte_carlo as _;
use abbe_numerics::{Generator, chi_squared_upper_tail};
use nalgebra::{DMatrix, DVector};
use serde_json::{Value, json};

/// A machine whose tip position along x is a linear function of its parameters: the factors are its status.
struct Linear(ModelInfo);

impl Linear {
    fn new(parameters: usize) -> Self {
        let name = |index: usize| format!("p{index}");
        let parameter = |index| Parameter::new(name(index), Unit::MM);
        let status = |index| StatusColumn {
            name: name(index),
            role: abbe_core::StatusRole::Other,
            quantity: Quantity::Ratio,
            levels: Vec::new(),
            absent: Absent::Default(0.0),
        };
        let (status, parameters) = ((0..parameters).map(status).collect(), (0..parameters).map(parameter).collect());
        Self(ModelInfo::new(Vec::new(), status, parameters, Value::Null))
    }
}

impl KinematicModel for Linear {
    fn info(&self) -> &ModelInfo {
        &self.0
    }

    fn evaluate(&self, batch: PoseBatch<'_>, out: PosesMut<'_>) -> Result<()> {
        let (PoseBatch { statuses, values, wanted, .. }, width) = (batch, self.0.status.len());
        for (index, factors) in statuses.chunks_exact(width).enumerate() {
            out.positions[index] = [factors.iter().zip(values).map(|(factor, value)| factor * value).sum(), 0.0, 0.0];
            for (k, variable) in wanted.iter().enumerate() {
                if let Variable::Parameter(parameter) = variable {
                    out.position_derivatives[index * wanted.len() + k] = [factors[*parameter], 0.0, 0.0];
                }
            }
        }
        Ok(())
    }
}

/// Readings of that position, all off by known inputs with factors of their own.
struct Readings {
    info: ObservationsInfo,
    readings: Vec<f64>,
    factors: Vec<Vec<f64>>,
}

impl Observations for Readings {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        for (&RowIndex(row), position) in batch.rows.iter().zip(batch.positions) {
            let by_input: f64 = self.factors[row].iter().zip(batch.inputs).map(|(factor, input)| factor * input).sum();
            out.equation(position[0] - self.readings[row] - by_input);
            out.position([1.0, 0.0, 0.0]);
            self.factors[row].iter().enumerate().for_each(|(input, factor)| out.input(input, -factor));
        }
        Ok(())
    }
}

/// The numbers of some rows.
struct Rows {
    name: &'static str,
    /// Factors of the parameters.
    design: DMatrix<f64>,
    readings: Vec<f64>,
    uncertainties: Vec<f64>,
    /// Names and standard uncertainties of the inputs, and their factors.
    inputs: Vec<(&'static str, f64)>,
    factors: DMatrix<f64>,
}

/// Two measurements of one machine: they share the input `scale`, and the second one has an input of its own.
struct World {
    random: Generator,
    truth: Vec<f64>,
    scale: f64,
}

const SCALE: f64 = 5e-4;

impl World {
    fn new(seed: u64) -> Self {
        let mut random = Generator::new(4711, seed);
        let count = 3 + random.index(5);
        let truth = (0..count).map(|_| random.normal()).collect();
        let scale = SCALE * random.normal();
        Self { random, truth, scale }
    }

    fn rows(&mut self, name: &'static str, count: usize, inputs: &[(&'static str, f64)]) -> Rows {
        let random = &mut self.random;
        let errors: Vec<f64> = inputs
            .iter()
            .map(|(name, size)| if *name == "scale" { self.scale } else { size * random.normal() })
            .collect();
        let design = DMatrix::from_fn(count, self.truth.len(), |_, _| random.normal());
        let factors = DMatrix::from_fn(count, inputs.len(), |_, _| random.normal());
        let uncertainties: Vec<f64> = (0..count).map(|_| 1e-3 * (1.0 + 0.5 * random.uniform())).collect();
        let exact = &design * DVector::from_column_slice(&self.truth) - &factors * DVector::from_vec(errors);
        let readings = exact.iter().zip(&uncertainties).map(|(exact, u)| exact + u * random.normal()).collect();
        Rows { name, design, readings, uncertainties, inputs: inputs.to_vec(), factors }
    }
}

fn set(rows: &Rows, model: &Arc<dyn KinematicModel>) -> ObservationSet {
    let count = model.info().parameters.len();
    let header: Vec<String> = (0..count).map(|index| format!("p{index}")).collect();
    let line = |row: usize| rows.design.row(row).iter().map(f64::to_string).collect::<Vec<_>>().join(",") + "\n";
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(format!("{}.csv", rows.name));
    let text: String = (0..rows.readings.len()).map(line).collect();
    std::fs::write(&file, format!("{}\n{text}", header.join(","))).unwrap();
    let mut data: Dataset = abbe_table::read(&file).unwrap();
    for column in &mut data.columns {
        // Ratios without a unit in their name come as labels: these are the factors of the parameters.
        if let abbe_core::Values::Labels(labels) = &column.values {
            column.values = abbe_core::Values::Numbers(labels.iter().map(|label| label.parse().unwrap()).collect());
            column.header.quantity = Quantity::Ratio;
        }
    }
    let data = Arc::new(data);
    let mut layout = Layout::new(&data, model.as_ref(), &[&abbe_core::plain_naming]).unwrap();
    for (row, uncertainty) in data.row_indices().zip(&rows.uncertainties) {
        layout.push(model.as_ref(), row, &[*uncertainty]).unwrap();
    }
    let input = |(name, size): &(&str, f64)| KnownInput::new(Parameter::new(*name, Unit::MM), 0.0, *size);
    let inputs = rows.inputs.iter().map(input).collect();
    let contact = Contact::Reading("reading".to_owned());
    let readings = Readings {
        readings: rows.readings.clone(),
        factors: (0..rows.readings.len()).map(|row| rows.factors.row(row).iter().copied().collect()).collect(),
        info: ObservationsInfo { inputs, ..ObservationsInfo::new(layout, Vec::new(), contact) },
    };
    ObservationSet::new(rows.name, Arc::new(readings))
}

fn problem(rows: &[&Rows], parameters: &[String]) -> Problem {
    let model: Arc<dyn KinematicModel> = Arc::new(Linear::new(rows[0].design.ncols()));
    let sets = rows.iter().map(|rows| set(rows, &model)).collect();
    Problem::new("linear", "linear", model, sets, parameters).unwrap()
}

fn estimator(name: &str, settings: &Value) -> Box<dyn Estimate> {
    let registry = Registry::built_in().unwrap();
    let context = Context { base: std::path::PathBuf::new() };
    match &registry.find(Kind::Estimate, name).unwrap().build {
        Build::Estimate(constructor) => constructor.build(settings, &context).unwrap_or_else(|error| panic!("{error}")),
        _ => unreachable!("an estimator was found"),
    }
}

fn all() -> Vec<String> {
    vec!["*".to_owned()]
}

fn at_once(rows: &[&Rows]) -> Calibration {
    let least_squares = estimator("gauss-newton", &json!({ "trust_uncertainties": true }));
    Calibration { estimate: "month".to_owned(), ..least_squares.explain(&problem(rows, &all())).unwrap() }
}

fn warned() -> Value {
    json!({ "on_disagreement": "warn" })
}

fn updated(settings: &Value, new: &Rows, parameters: &[String], known: &Calibration) -> Result<Calibration> {
    estimator("sequential", settings).explain(&problem(&[new], parameters).with_prior(known).unwrap())
}

/// Largest differences of values, and of covariances, in the uncertainties of `one`, for all names of `names`.
fn differences(one: &Calibration, other: &Calibration, names: &[String]) -> (f64, f64) {
    let u = |name: &String| one.covariance.variance(name).unwrap().sqrt();
    let entry = |of: &Calibration, a: &String, b: &String| {
        of.covariance.rows[of.covariance.index(a).unwrap()][of.covariance.index(b).unwrap()]
    };
    let (mut values, mut covariances) = (0.0_f64, 0.0_f64);
    for a in names {
        values = values.max((one.get(a).unwrap().value - other.get(a).unwrap().value).abs() / u(a));
        for b in names {
            covariances = covariances.max((entry(one, a, b) - entry(other, a, b)).abs() / u(a) / u(b));
        }
    }
    (values, covariances)
}

fn parameters(of: &Calibration) -> Vec<String> {
    of.parameters.iter().map(|parameter| parameter.name.clone()).collect()
}

/// Values, covariances and sensitivities to shared inputs are those of old and new rows at once.
#[test]
fn an_update_is_the_estimate_from_old_and_new_rows_at_once() {
    let mut worst = (0.0_f64, 0.0_f64);
    for seed in 0..200 {
        let mut world = World::new(seed);
        let old = world.rows("old", 24, &[("scale", SCALE)]);
        let new = world.rows("new", 3, &[("scale", SCALE), ("own", 3e-4)]);
        let (month, joint) = (at_once(&[&old]), at_once(&[&old, &new]));
        let found = updated(&warned(), &new, &all(), &month).unwrap();
        let (values, covariances) = differences(&joint, &found, &parameters(&joint));
        worst = (worst.0.max(values), worst.1.max(covariances));
        // Each input once, with the same sensitivities.
        let (ours, theirs) = (found.inputs.as_ref().unwrap(), joint.inputs.as_ref().unwrap());
        assert_eq!(ours.len(), 2);
        for their in theirs {
            let our = ours.iter().find(|our| our.identity == their.identity).expect("the same input");
            for name in parameters(&joint) {
                let of = |calibration: &Calibration, input: &abbe_core::ConsideredInput| {
                    input.sensitivities[calibration.covariance.index(&name).unwrap()]
                };
                assert!((of(&found, our) - of(&joint, their)).abs() < 1e-9, "seed {seed}: {name} to {}", our.name);
            }
        }
        // A second update goes on from the first.
        let third = world.rows("third", 2, &[("scale", SCALE)]);
        let again = updated(&warned(), &third, &all(), &Calibration { estimate: "week".to_owned(), ..found }).unwrap();
        let (values, covariances) = differences(&at_once(&[&old, &new, &third]), &again, &parameters(&joint));
        worst = (worst.0.max(values), worst.1.max(covariances));
    }
    println!("update against all at once: values {:.1e}, covariances {:.1e}", worst.0, worst.1);
    assert!(worst.0 < 1e-9 && worst.1 < 1e-9, "{worst:?}");
}

/// What is known and not chosen has its part in the gain: chosen values are those of an estimate of all.
#[test]
fn considered_states_have_their_part_in_the_gain() {
    for seed in 0..100 {
        let mut world = World::new(1000 + seed);
        let old = world.rows("old", 24, &[]);
        let new = world.rows("new", 4, &[]);
        let (month, joint) = (at_once(&[&old]), at_once(&[&old, &new]));
        let chosen: Vec<String> = (0..2).map(|index| format!("p{index}")).collect();
        let found = updated(&warned(), &new, &chosen, &month).unwrap();
        let (values, covariances) = differences(&joint, &found, &chosen);
        assert!(values < 1e-9 && covariances < 1e-9, "seed {seed}: {values:e}, {covariances:e}");
        let before = differences(&month, &found, &["p2".to_owned()]);
        assert_eq!(before, (0.0, 0.0), "what is considered stays");
        assert_eq!(found.get("p2").unwrap().status, Status::Considered);
        // Schmidt's covariance of chosen with considered states: P - K H P.
        let size = world.truth.len();
        let p = DMatrix::from_fn(size, size, |row, column| month.covariance.rows[row][column]);
        let noise = DMatrix::from_diagonal(&DVector::from_vec(new.uncertainties.iter().map(|u| u * u).collect()));
        let s = &new.design * &p * new.design.transpose() + noise;
        let gain = &p * new.design.transpose() * s.try_inverse().unwrap();
        let after = &p - gain * &new.design * &p;
        for row in 0..2 {
            for column in 2..size {
                let place = |index: usize| found.covariance.index(&format!("p{index}")).unwrap();
                let off = found.covariance.rows[place(row)][place(column)] - after[(row, column)];
                let size = (p[(row, row)] * p[(column, column)]).sqrt();
                assert!(off.abs() < 1e-9 * size, "seed {seed}: {off:e} of {size:e}");
            }
        }
    }
}

/// New unknowns of which nothing is known are determined by the new rows.
#[test]
fn unknowns_without_knowledge_come_from_new_rows() {
    for seed in 0..50 {
        let mut world = World::new(2000 + seed);
        let (old, new) = (world.rows("old", 24, &[("scale", SCALE)]), world.rows("new", 6, &[("scale", SCALE)]));
        let less = Rows { design: old.design.clone(), readings: old.readings.clone(), ..world.rows("less", 24, &[]) };
        let some: Vec<String> = (1..world.truth.len()).map(|index| format!("p{index}")).collect();
        let least_squares = estimator("gauss-newton", &json!({ "trust_uncertainties": true }));
        let month = least_squares.explain(&problem(&[&less], &some)).unwrap();
        let found = updated(&warned(), &new, &all(), &month).unwrap();
        let agreement = found.fit.agreement.as_ref().unwrap();
        assert_eq!(agreement.degrees_of_freedom, 5);
        assert!(found.get("p0").unwrap().standard_uncertainty > 1e-4);
    }
}

/// Chi-squared is that of the innovation with its whole covariance, and probabilities are even where all holds.
#[test]
fn the_test_is_that_of_the_innovation() {
    let mut probabilities = Vec::new();
    for seed in 0..400 {
        let mut world = World::new(3000 + seed);
        let old = world.rows("old", 24, &[("scale", SCALE)]);
        let new = world.rows("new", 3, &[("scale", SCALE), ("own", 3e-4)]);
        let month = at_once(&[&old]);
        let agreement = updated(&warned(), &new, &all(), &month).unwrap().fit.agreement.unwrap();
        probabilities.push(agreement.probability);
        if seed >= 50 {
            continue;
        }
        let size = world.truth.len();
        let start = DVector::from_iterator(size, month.parameters.iter().map(|parameter| parameter.value));
        let v = &new.design * start - DVector::from_column_slice(&new.readings);
        let c = DMatrix::from_fn(size, size, |row, column| month.covariance.rows[row][column]);
        let s = DVector::from_iterator(size, month.inputs.as_ref().unwrap()[0].sensitivities[..size].iter().copied());
        let k = -&new.factors;
        let shared = &new.design * s * k.column(0).transpose() * SCALE.powi(2);
        let mut covariance = &new.design * c * new.design.transpose() + &shared + shared.transpose();
        for (input, (_, uncertainty)) in new.inputs.iter().enumerate() {
            covariance += k.column(input) * k.column(input).transpose() * uncertainty.powi(2);
        }
        new.uncertainties.iter().enumerate().for_each(|(row, u)| covariance[(row, row)] += u * u);
        let expected = (v.transpose() * covariance.try_inverse().unwrap() * &v)[0];
        assert!((agreement.chi_squared - expected).abs() < 1e-8 * (1.0 + expected), "{agreement:?} {expected}");
        assert_eq!(agreement.degrees_of_freedom, 3);
        assert!((agreement.probability - chi_squared_upper_tail(expected, 3.0)).abs() < 1e-8);
    }
    // 400 numbers that are even from 0 to 1: three standard deviations of their counts.
    for (level, band) in [(0.5, 30), (0.1, 18)] {
        let below = probabilities.iter().filter(|p| **p < level).count() as f64;
        assert!((below - 400.0 * level).abs() < f64::from(band), "{below} of 400 below {level}");
    }
}

/// What has changed since is named, and a wrong row is.
#[test]
fn what_disagrees_is_named() {
    let (mut changed, mut wrong) = (0, 0);
    for seed in 0..40 {
        let mut world = World::new(4000 + seed);
        let old = world.rows("old", 24, &[("scale", SCALE)]);
        let month = at_once(&[&old]);
        let mut new = world.rows("new", 8, &[("scale", SCALE)]);
        let fine = updated(&json!({ "significance": 1e-6 }), &new, &all(), &month);
        assert!(fine.is_ok(), "seed {seed}");
        new.readings[4] += 0.02;
        let said = updated(&json!({}), &new, &all(), &month).expect_err("it disagrees");
        assert!(said.message.contains("the new rows do not agree with what is known"), "{said}");
        // The second line below the header and three rows.
        wrong += usize::from(said.message.contains("new.csv:6 alone were wrong"));
        let mut other = World { truth: world.truth.clone(), ..World::new(9000 + seed) };
        other.truth[1] += 0.02;
        other.scale = world.scale;
        let new = other.rows("new", 8, &[("scale", SCALE)]);
        let said = updated(&json!({}), &new, &all(), &month).expect_err("it disagrees").to_string();
        changed += usize::from(said.contains("if `p1` alone had changed"));
        // What may have changed is no disagreement.
        let may = json!({ "significance": 1e-6, "changed": [{ "parameters": ["p1"], "standard_uncertainty": 0.02 }] });
        let found = updated(&may, &new, &all(), &month).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        let p1 = found.get("p1").unwrap();
        assert!((p1.value - other.truth[1]).abs() < 5.0 * p1.standard_uncertainty);
    }
    assert!(changed >= 39 && wrong >= 39, "{changed} and {wrong} of 40");
}

/// Truth lies within 95 % intervals in 95 % of the updates, all inputs and the old rows drawn anew.
#[test]
fn intervals_cover() {
    let (mut within, mut all_values) = (0, 0);
    for seed in 0..400 {
        let mut world = World::new(5000 + seed);
        let old = world.rows("old", 12, &[("scale", SCALE)]);
        let new = world.rows("new", 3, &[("scale", SCALE), ("own", 3e-4)]);
        let chosen: Vec<String> = (0..2).map(|index| format!("p{index}")).collect();
        let some = if seed % 2 == 0 { all() } else { chosen };
        let found = updated(&warned(), &new, &some, &at_once(&[&old])).unwrap();
        for (parameter, truth) in found.parameters.iter().zip(&world.truth) {
            all_values += 1;
            within += usize::from((parameter.value - truth).abs() < 1.96 * parameter.standard_uncertainty);
        }
    }
    let part = f64::from(within as u32) / f64::from(all_values);
    assert!((part - 0.95).abs() < 0.02, "{part} of {all_values}");
}

/// Trials draw what was known as well.
#[test]
fn trials_agree_with_the_closed_form() {
    for seed in 0..6 {
        let mut world = World::new(6000 + seed);
        let old = world.rows("old", 12, &[("scale", SCALE)]);
        let new = world.rows("new", 3, &[("scale", SCALE), ("own", 3e-4)]);
        let some: Vec<String> = if seed % 2 == 0 { all() } else { vec!["p0".to_owned(), "p1".to_owned()] };
        let problem = problem(&[&new], &some).with_prior(&at_once(&[&old])).unwrap();
        let sequential: Arc<dyn Estimate> = Arc::from(estimator("sequential", &warned()));
        let calibration = sequential.explain(&problem).unwrap();
        let fit = Fit { name: "fit".to_owned(), problem: Arc::new(problem), estimator: sequential, calibration };
        let trials = 4000;
        let found =
            estimator("monte-carlo", &json!({ "trials": trials, "seed": 3, "digits": 1 })).analyse(&fit).unwrap();
        assert_eq!(found.covariance.order, fit.calibration.covariance.order);
        let (a, b) = (&found.covariance.rows, &fit.calibration.covariance.rows);
        for row in 0..a.len() {
            for column in 0..=row {
                let deviation = ((b[row][row] * b[column][column] + b[row][column].powi(2)) / f64::from(trials)).sqrt();
                let off = (a[row][column] - b[row][column]).abs() / deviation;
                assert!(off < 4.5, "problem {seed}: {off} standard deviations in {row}, {column}");
            }
        }
    }
}

#[test]
fn what_cannot_be_updated_is_refused() {
    let mut world = World::new(1);
    let (old, new) = (world.rows("old", 24, &[]), world.rows("new", 3, &[]));
    let month = at_once(&[&old]);
    let said = |settings: &Value, known: &Calibration| {
        updated(settings, &new, &all(), known).expect_err("it is refused").to_string()
    };
    let no_match = json!({ "changed": [{ "parameters": ["p9"], "standard_uncertainty": 1.0 }] });
    assert!(said(&no_match, &month).contains("`p9` matches nothing that is estimated here and known from before"));
    let mut exact = month.clone();
    exact.covariance.rows.iter_mut().for_each(|row| row[0] = 0.0);
    exact.covariance.rows[0].fill(0.0);
    assert!(said(&json!({}), &exact).contains("`p0` is exact in `month`: no row can change it"));
    let mut lost = month.clone();
    lost.parameters[1].status = Status::Confounded;
    assert!(said(&json!({}), &lost).contains("cannot separate `p1` from others"));
    let mut singular = month.clone();
    let line = singular.covariance.rows[0].clone();
    singular.covariance.rows[1].clone_from(&line);
    singular.covariance.rows.iter_mut().for_each(|row| row[1] = row[0]);
    singular.covariance.rows[1][1] = singular.covariance.rows[0][0];
    assert!(said(&json!({}), &singular).contains("the covariance of `month` is singular"));
    let mut metres = month.clone();
    metres.parameters[0].unit = "rad".to_owned();
    let error = problem(&[&new], &all()).with_prior(&metres).err().expect("it is refused").to_string();
    assert!(error.contains("`p0` is in mm here and has another unit in `month`"), "{error}");
    let twice = problem(&[&new], &all()).with_prior(&month).unwrap().with_prior(&month).unwrap();
    let error = estimator("sequential", &json!({})).estimate(&twice).expect_err("it is refused").to_string();
    assert!(error.contains("both know what is estimated here"), "{error}");
    // Three rows without knowledge cannot determine more unknowns.
    let error = estimator("sequential", &json!({})).estimate(&problem(&[&new], &all()));
    assert!(error.is_err() || world.truth.len() <= 3);
    for (settings, expected) in [
        (json!({ "significance": 0 }), "significance"),
        (json!({ "rank_tolerance": 1 }), "rank_tolerance"),
        (json!({ "changed": [{ "parameters": [], "standard_uncertainty": 1 }] }), "parameters"),
        (json!({ "changed": [{ "parameters": ["*"], "standard_uncertainty": -1 }] }), "standard_uncertainty"),
    ] {
        let settings: super::Settings = serde_json::from_value(settings).unwrap();
        let error = settings.check().expect_err(expected);
        assert!(error.to_string().contains(expected), "{error}");
    }
}
