//! Trials against the closed form on random linear problems, the same bytes on any number of threads, and refusals.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use abbe_core::{
    Absent, Build, Calibration, Contact, Context, CovarianceBlock, Dataset, EquationUncertainty, Equations, Error,
    Estimate, Fit, Identifiability, Kind, KinematicModel, KnownInput, Layout, LayoutEquation, ModelInfo,
    ObservationSet, Observations, ObservationsInfo, Parameter, PooledRepeatability, PoseBatch, PosesMut, Problem,
    Quantity, Registry, Result, RowBatch, RowIndex, StatusColumn, Unit, Variable, path_text,
};
use abbe_gauss_newton as _;
use abbe_numerics::Generator;
use nalgebra::DMatrix;
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

/// Readings of that position, all off by one known input with a factor of their own.
struct Readings {
    info: ObservationsInfo,
    readings: Vec<f64>,
    factors: Vec<f64>,
}

impl Observations for Readings {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        for (&RowIndex(row), position) in batch.rows.iter().zip(batch.positions) {
            out.equation(position[0] - self.readings[row] - self.factors[row] * batch.inputs[0]);
            out.position([1.0, 0.0, 0.0]);
            out.input(0, -self.factors[row]);
        }
        Ok(())
    }
}

/// Which kinds of input a random problem has.
#[derive(Clone, Copy)]
enum Rows {
    Independent,
    Correlated,
    Repeated,
}

const ROWS: usize = 24;

fn problem(seed: u64, kind: Rows) -> Problem {
    let mut random = Generator::new(seed, 0);
    let count = 2 + random.index(4);
    let model: Arc<dyn KinematicModel> = Arc::new(Linear::new(count));
    let data: String = (0..ROWS)
        .map(|_| (0..count).map(|_| random.normal().to_string()).collect::<Vec<_>>().join(",") + "\n")
        .collect();
    let header: Vec<String> = (0..count).map(|index| format!("p{index}")).collect();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("rows.csv");
    std::fs::write(&file, format!("{}\n{data}", header.join(","))).unwrap();
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
    let uncertainty = |random: &mut Generator| 1e-3 * (1.0 + 0.5 * random.uniform());
    for row in data.row_indices() {
        layout.push(model.as_ref(), row, &[uncertainty(&mut random)]).unwrap();
    }
    let input = KnownInput::new(Parameter::new("scale", Unit::MM), 0.0, 5e-4);
    let contact = Contact::Reading("reading".to_owned());
    let readings = Readings {
        readings: (0..ROWS).map(|_| random.normal()).collect(),
        factors: (0..ROWS).map(|_| random.normal()).collect(),
        info: ObservationsInfo { inputs: vec![input], ..ObservationsInfo::new(layout, Vec::new(), contact) },
    };
    let mut set = ObservationSet::new("rows", Arc::new(readings));
    let mut uncertainty = EquationUncertainty::clone(&set.uncertainty);
    match kind {
        Rows::Independent => {}
        Rows::Correlated => {
            let root = DMatrix::from_fn(10, 10, |_, _| 1e-3 * random.normal());
            let covariance = &root * root.transpose() + DMatrix::identity(10, 10) * 1e-7;
            let equations: Vec<LayoutEquation> = LayoutEquation::first(20).step_by(2).collect();
            let block = CovarianceBlock::new("the rows", &equations, &covariance).unwrap();
            for (index, &equation) in equations.iter().enumerate() {
                uncertainty.standard[equation] = block.covariance[(index, index)].sqrt();
            }
            uncertainty.blocks.push(block);
        }
        Rows::Repeated => {
            uncertainty.pooled = Some(PooledRepeatability {
                by: "cycle".to_owned(),
                repetitions: (0..60).map(|index| index.to_string()).collect(),
                deviations: (0..60).map(|_| (0..ROWS).map(|_| 1e-3 * random.normal()).collect()).collect(),
                degrees_of_freedom: 50,
            });
        }
    }
    set.uncertainty = Arc::new(uncertainty);
    Problem::new("linear", "linear", model, vec![set], &["*".to_owned()]).unwrap()
}

fn estimator(name: &str, settings: &Value) -> Result<Box<dyn Estimate>, String> {
    let registry = Registry::built_in().unwrap();
    let context = Context { base: std::path::PathBuf::new() };
    match &registry.find(Kind::Estimate, name).unwrap().build {
        Build::Estimate(constructor) => constructor.build(settings, &context).map_err(|error| error.to_string()),
        _ => unreachable!("an estimator was found"),
    }
}

fn fit(problem: Problem) -> Fit {
    let estimator = estimator("gauss-newton", &json!({ "trust_uncertainties": true })).unwrap();
    let calibration = estimator.explain(&problem).unwrap();
    Fit { name: "fit".to_owned(), problem: Arc::new(problem), estimator: Arc::from(estimator), calibration }
}

fn trials(settings: &Value, fit: &Fit) -> Result<Calibration, String> {
    let found = estimator("monte-carlo", settings)?.analyse(fit);
    found.map_err(|error| format!("{}: {error}", path_text(&error.setting)))
}

/// Largest difference of two covariances in standard deviations of what trials scatter by: the variance of an entry is
/// (C_ii C_jj + C_ij^2) / M for normal quantities.
fn distance(found: &Calibration, expected: &Calibration, trials: usize) -> f64 {
    assert_eq!(found.covariance.order, expected.covariance.order);
    let (a, b) = (&found.covariance.rows, &expected.covariance.rows);
    let mut worst = 0.0_f64;
    for row in 0..a.len() {
        for column in 0..=row {
            let deviation = ((b[row][row] * b[column][column] + b[row][column].powi(2)) / trials as f64).sqrt();
            worst = worst.max((a[row][column] - b[row][column]).abs() / deviation);
        }
    }
    worst
}

#[test]
fn trials_agree_with_the_closed_form_of_linear_problems() {
    let settings = json!({ "trials": 4000, "seed": 3, "digits": 1 });
    for seed in 0..20 {
        let kind = if seed % 2 == 0 { Rows::Independent } else { Rows::Correlated };
        let fit = fit(problem(100 + seed, kind));
        let found = trials(&settings, &fit).unwrap();
        // Of some 300 entries the worst lies within 4.5 of its standard deviations but for one case in 300.
        let worst = distance(&found, &fit.calibration, 4000);
        assert!(worst < 4.5, "problem {seed}: {worst}");
        for (simulated, budget) in
            found.monte_carlo.unwrap().parameters.iter().zip(&fit.calibration.uncertainty.as_ref().unwrap().parameters)
        {
            let estimate = fit.calibration.get(&simulated.name).unwrap().value;
            let mean = (simulated.mean - estimate) / budget.standard_uncertainty * 4000.0_f64.sqrt();
            assert!(mean.abs() < 4.5, "problem {seed}: mean of {}", simulated.name);
            // An end of a normal 95 % interval scatters by 2.7 standard uncertainties over the root of the trials.
            let [low, high] = simulated.symmetric_interval;
            for (end, expected) in [(low, -1.0), (high, 1.0)] {
                let expected = estimate + expected * budget.expanded_uncertainty;
                let off = (end - expected) / budget.standard_uncertainty * 4000.0_f64.sqrt() / 2.7;
                assert!(off.abs() < 4.5, "problem {seed}: interval of {}", simulated.name);
            }
            let [shortest_low, shortest_high] = simulated.shortest_interval;
            assert!(shortest_high - shortest_low <= high - low);
        }
    }
}

/// An estimator whose trials all fail; counts them.
struct Failing {
    error: Error,
    asked: AtomicUsize,
}

impl Estimate for Failing {
    fn estimate(&self, _: &Problem) -> Result<Calibration> {
        Err(self.error.clone())
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(self.error.clone())
    }

    fn values(&self, _: &Problem) -> Result<Vec<f64>> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        Err(self.error.clone())
    }
}

#[test]
fn a_fault_of_the_code_ends_all_trials_and_refused_numbers_one() {
    let run = |error: Error, threads: usize| {
        let failing = Arc::new(Failing { error, asked: AtomicUsize::new(0) });
        let fit = Fit { estimator: failing.clone(), ..fit(problem(1, Rows::Independent)) };
        let settings = json!({ "trials": 2000, "threads": threads });
        let error = estimator("monte-carlo", &settings).unwrap().analyse(&fit).unwrap_err();
        (error.message, failing.asked.load(Ordering::Relaxed))
    };
    let fatal = || Error::data("the machine has died").fatal();
    assert_eq!(run(fatal(), 1), ("the machine has died".to_owned(), 1));
    let (message, asked) = run(fatal(), 4);
    assert!(message == "the machine has died" && asked <= 4, "{asked}: {message}");
    let (message, asked) = run(Error::data("such numbers have no pose"), 1);
    assert_eq!(asked, 2000);
    assert!(
        message.starts_with("2000 of 2000 trials failed") && message.ends_with("such numbers have no pose"),
        "{message}"
    );
}

#[test]
fn repeats_make_a_multivariate_t_distribution() {
    let fit = fit(problem(7, Rows::Repeated));
    let found = trials(&json!({ "trials": 20000 }), &fit).unwrap();
    // 50 degrees of freedom: variances 50/48 times those of the scatter; what is not repeated stays.
    let budget = fit.calibration.uncertainty.as_ref().unwrap();
    for (part, simulated) in budget.parameters.iter().zip(found.monte_carlo.unwrap().parameters) {
        let variance: f64 = part
            .contributions
            .iter()
            .map(|contribution| {
                let factor = if contribution.input.contains("repeats") { 50.0 / 48.0 } else { 1.0 };
                factor * contribution.standard_uncertainty.powi(2)
            })
            .sum();
        let ratio = simulated.standard_uncertainty / variance.sqrt();
        assert!((ratio - 1.0).abs() < 0.03, "{}: {ratio}", part.name);
        assert!(simulated.gum.as_ref().unwrap().validated, "{}", part.name);
    }
}

#[test]
fn threads_do_not_change_a_bit() {
    let fit = fit(problem(5, Rows::Correlated));
    let run = |threads: usize| {
        let found = trials(&json!({ "trials": 2500, "threads": threads }), &fit).unwrap();
        found.to_json().unwrap()
    };
    let one = run(1);
    assert!(one == run(2) && one == run(3));
    let other = trials(&json!({ "trials": 2500, "seed": 2 }), &fit).unwrap().to_json().unwrap();
    assert!(one != other);
}

#[test]
fn distributions_have_their_shape() {
    let fit = fit(problem(11, Rows::Independent));
    let interval = |settings: Value| {
        let found = trials(&settings, &fit).unwrap().monte_carlo.unwrap();
        let first = &found.parameters[0];
        (first.standard_uncertainty, first.symmetric_interval[1] - first.symmetric_interval[0])
    };
    let normal = interval(json!({ "trials": 20000 }));
    let uniform = interval(json!({ "trials": 20000, "rows": "uniform", "inputs": { "rows.scale": "uniform" } }));
    let student = interval(json!({ "trials": 20000, "rows": { "student": 5 } }));
    // Same variance; and sums of many errors are almost normal.
    for (deviation, width) in [uniform, student] {
        assert!((deviation / normal.0 - 1.0).abs() < 0.03 && (width / normal.1 - 1.0).abs() < 0.05);
    }
    // Residuals of readings that are off by about 1 mm, not by the stated 1e-3.
    let resampled = interval(json!({ "trials": 4000, "rows": "resampled" }));
    assert!(resampled.0 > 100.0 * normal.0);
}

#[test]
fn the_adaptive_procedure_stops_when_it_is_stable() {
    let fit = fit(problem(13, Rows::Independent));
    let found = trials(&json!({ "adaptive": { "digits": 1 } }), &fit).unwrap().monte_carlo.unwrap();
    assert_eq!(found.stable, Some(true));
    assert!(found.trials >= 20_000 && found.trials.is_multiple_of(10_000), "{}", found.trials);
    let found = trials(&json!({ "adaptive": { "digits": 2, "most": 20000 } }), &fit).unwrap().monte_carlo.unwrap();
    assert_eq!((found.stable, found.trials), (Some(false), 20_000));
}

#[test]
fn what_cannot_be_calculated_is_refused() {
    let fit = fit(problem(17, Rows::Correlated));
    let cases = [
        (
            json!({ "trials": 100 }),
            "trials: 100 trials are too few for intervals of probability 0.95: at least 2000 are needed (JCGM 101, 7.9.4)",
        ),
        (
            json!({ "trials": 10000, "coverage_probability": 0.999 }),
            "trials: 10000 trials are too few for intervals of probability 0.999: at least 100000 are needed (JCGM 101, 7.9.4)",
        ),
        (
            json!({ "adaptive": { "most": 10 } }),
            "adaptive.most: 10 trials are too few for intervals of probability 0.95: at least 2000 are needed (JCGM 101, 7.9.4)",
        ),
        (json!({ "coverage_probability": 1.5 }), "coverage_probability: a number between 0 and 1 was expected"),
        (
            json!({ "rows": { "student": 2 } }),
            "rows: 2 degrees of freedom have no variance that trials could show; at least 2.5 were expected",
        ),
        (
            json!({ "rows": "gauss" }),
            "rows: \"gauss\" is no distribution; normal, uniform, resampled or { student: 5 } was expected",
        ),
        (
            json!({ "rows": "resampled" }),
            "rows: correlated rows cannot be drawn from residuals one by one (leave out `resampled`, or the covariance under `uncertainty` of the artefacts)",
        ),
        (
            json!({ "inputs": { "rows.scales": "normal" } }),
            "inputs.rows.scales: `rows.scales` is no known input with an uncertainty (did you mean `rows.scale`?)",
        ),
        (
            json!({ "vary": [{ "parameters": ["p0"], "standard_uncertainty": 1.0 }] }),
            "vary[0].parameters[0]: p0 is estimated or known; only what is neglected varies here",
        ),
        (
            json!({ "vary": [{ "parameters": ["q*"], "standard_uncertainty": 1.0 }] }),
            "vary[0].parameters[0]: `q*` matches no parameter of the machine (a neglected error exists only if the model's `errors` list it)",
        ),
        (
            json!({ "vary": [{ "parameters": ["p0"] }] }),
            "vary[0]: one size was expected: `standard_uncertainty`, `at_end_of_travel_um` or `at_end_of_travel_urad`",
        ),
        (
            json!({ "lobing": [{ "artefact": "table", "amplitude_um": 1 }] }),
            "lobing[0].artefact: `table` is not among the observations of the estimate",
        ),
        (
            json!({ "lobing": [{ "artefact": "rows", "amplitude_um": 1 }] }),
            "lobing[0].artefact: the rows of `rows` are no single touches",
        ),
        (json!({ "threads": 0 }), "threads: the number 0 was found; a whole number from 1 to 1024 was expected"),
    ];
    for (settings, expected) in cases {
        assert_eq!(trials(&settings, &fit).map(drop).unwrap_err(), expected);
    }
}

#[test]
fn neglected_errors_add_their_share() {
    let whole = problem(23, Rows::Independent);
    let everything = fit(whole.clone());
    let less = fit(whole.without_unknowns(|unknown| unknown.name == "p0"));
    let before = trials(&json!({ "trials": 4000 }), &less).unwrap();
    let vary = json!({ "trials": 4000, "vary": [{ "parameters": ["p0"], "standard_uncertainty": 1e-2 }] });
    let after = trials(&vary, &less).unwrap();
    assert_eq!(everything.calibration.fit.unknowns, less.calibration.fit.unknowns + 1);
    // The answer of least squares to what is left out: difference of two fits with p0 shifted.
    let mut shifted = (*less.problem).clone();
    shifted.machine_values[0] = 1e-2;
    let answers = less.estimator.values(&shifted).unwrap();
    for (index, unknown) in less.problem.unknowns.iter().enumerate() {
        let answer = answers[index] - less.calibration.get(&unknown.name).unwrap().value;
        let variance = |calibration: &Calibration| calibration.covariance.rows[index][index];
        let expected = (variance(&before) + answer * answer).sqrt();
        assert!((variance(&after).sqrt() / expected - 1.0).abs() < 0.06, "{}", unknown.name);
    }
}
