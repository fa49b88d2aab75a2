//! How long the pipelines take, beside the time of one QR decomposition, which tells how fast the machine is.

use std::cell::LazyCell;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use abbe_bundle as _;
use abbe_compensation::{Compensator, Correct, Settings};
use abbe_controllers::{Dialect, Machine, Options, compensate};
use abbe_core::{
    Build, Calibration, Context, Error, Fit, Kind, KinematicModel, Poses, Problem, Registry, StatusRole, in_parallel,
    machine_values,
};
use abbe_engine::{model_of, prepare};
use abbe_plugin::{Library, Limits};
use abbe_thermal::{Hold, Output, Reference, SensorLog, Structure};
use criterion::{Criterion, criterion_group, criterion_main};
use faer::Mat;

/// A fit of a recipe of the repository. It takes a whole run, so it is made only for what is measured.
fn fit_of(recipe: &'static str, name: &'static str) -> LazyCell<Fit, impl FnOnce() -> Fit> {
    LazyCell::new(move || {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines").join(recipe);
        let fits = Registry::built_in()
            .and_then(|registry| prepare(&path, &registry)?.run(&abbe_core::Monitor::default()))
            .unwrap_or_else(|error| panic!("{error}"))
            .fits;
        let of_name = fits.into_iter().find(|fit| fit.name == name);
        of_name.unwrap_or_else(|| panic!("{recipe} has no {name}"))
    })
}

/// The fit S4 of a five-axis machine.
fn tango_s4() -> LazyCell<Fit, impl FnOnce() -> Fit> {
    fit_of("tango-hu40t-exact.yaml", "fit-S4")
}

/// The unit of all times: one QR decomposition of a dense matrix of the size of the fit S4.
fn qr(criterion: &mut Criterion) {
    // Numbers without a pattern (the finaliser of SplitMix64): a matrix of full rank, which the sine of a sum would not be.
    let number = |row: usize, column: usize| {
        let mut bits = ((row * 115 + column) as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((bits ^ (bits >> 31)) >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    let matrix = Mat::from_fn(384, 115, number);
    criterion.bench_function("qr_384_115", |bencher| bencher.iter(|| black_box(&matrix).qr()));
}

fn product(criterion: &mut Criterion) {
    let entries = |row: usize, column: usize| ((row * 7 + column * 3) % 11) as f64 - 5.0;
    let (a, b) = (Mat::from_fn(256, 256, entries), Mat::from_fn(256, 256, entries));
    criterion.bench_function("matrix_product_256", |bencher| bencher.iter(|| black_box(&a) * black_box(&b)));
}

fn tango(criterion: &mut Criterion) {
    let fit = tango_s4();
    criterion.bench_function("tango_s4_fit", |bencher| {
        bencher.iter(|| fit.estimator.estimate(black_box(&fit.problem)).map(|calibration| calibration.fit.sigma))
    });
    let fit = fit_of("tango-hu40t-exact.yaml", "fit-S3");
    criterion.bench_function("tango_s3_trial", |bencher| {
        let problem = fit.problem.with_values(&fit.problem.values_of(&fit.calibration));
        let errors: Vec<f64> = (0..problem.equations()).map(|row| 1e-3 * ((row * 7 % 11) as f64 - 5.0) / 3.0).collect();
        let values = fit.estimator.values_near(&problem);
        bencher.iter(|| values(&problem.disturbed(black_box(&errors))).map(|values| values[0]))
    });
    criterion.bench_function("tango_run", |bencher| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines/tango-hu40t.yaml");
        bencher.iter(|| {
            let prepared = prepare(black_box(&path), &Registry::built_in()?)?;
            prepared.run(&abbe_core::Monitor::default()).map(|outcome| outcome.fits.len())
        })
    });
}

/// The bridge CMM: 73 parameters from 2,011 lengths, and fifty lengths chosen for 32 parameters out of 3,978 in 20 searches.
fn cmm(criterion: &mut Criterion) {
    let fit = fit_of("cmm-brute-force.yaml", "fit");
    criterion.bench_function("cmm_brute_force", |bencher| {
        bencher.iter(|| fit.estimator.estimate(black_box(&fit.problem)).map(|calibration| calibration.fit.sigma))
    });
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines/cmm-fifty-lengths.yaml");
    criterion.bench_function("plan_fifty_lengths", |bencher| {
        bencher.iter(|| {
            let prepared = prepare(black_box(&path), &Registry::built_in()?)?;
            prepared.plan().map(|measurements| measurements.plan.figures.log_determinant)
        })
    });
}

/// All direct measurements of a milling machine at once: 19,668 rows, 550 unknowns.
fn mill(criterion: &mut Criterion) {
    let fit = fit_of("mill-direct-exact.yaml", "fit");
    criterion.bench_function("mill_joint_fit", |bencher| {
        bencher.iter(|| fit.estimator.estimate(black_box(&fit.problem)).map(|calibration| calibration.fit.sigma))
    });
    criterion.bench_function("mill_direct_run", |bencher| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines/mill-direct.yaml");
        bencher.iter(|| {
            let prepared = prepare(black_box(&path), &Registry::built_in()?)?;
            prepared.run(&abbe_core::Monitor::default()).map(|outcome| outcome.fits.len())
        })
    });
}

/// Three time constants and 207 gains from 19,573 readings of a spindle that warms up (Soons 1993, 3.4).
fn thermal(criterion: &mut Criterion) {
    const INPUTS: [&str; 3] = ["T34", "T52", "T01"];
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines/data/thermal-spindle/exact/thermal-const.csv");
    let data = abbe_table::read(&path).unwrap_or_else(|error| panic!("{error}"));
    let times = data.numbers("time").unwrap_or_else(|| panic!("no times")).to_vec();
    let sensors = data.columns.iter().filter_map(|column| {
        let name = column.header.name.clone();
        let values = data.numbers(&name).filter(|_| !["time", "speed"].contains(&name.as_str()))?;
        Some((name, values.to_vec()))
    });
    let log = SensorLog::new(times.clone(), sensors.collect(), Hold::FirstOrder, None)
        .and_then(|log| log.elevations(Reference::FirstRow))
        .unwrap_or_else(|error| panic!("{error}"));
    let is_output = |name: &&String| !INPUTS.contains(&name.as_str());
    let outputs: Vec<Output> = (log.names().iter().enumerate())
        .filter(|(_, name)| is_output(name))
        .map(|(sensor, name)| Output::of_run(name, times.clone(), log.values(sensor).to_vec()))
        .collect();
    let inputs = INPUTS.iter().filter_map(|name| log.sensor(name).ok()).collect();
    let structure = Structure { inputs, at_once: Vec::new(), time_constants: 3, starts_warm: false, guess: None };
    criterion.bench_function("thermal_spindle_fit", |bencher| {
        bencher.iter(|| {
            abbe_thermal::fit(std::slice::from_ref(black_box(&log)), &outputs, &structure).map(|fitted| fitted.passes)
        })
    });
}

/// Statuses of so many poses of a machine along a line through the middle of its travel, all directions positive.
fn statuses(model: &dyn KinematicModel, count: u32) -> Vec<f64> {
    let info = model.info();
    let of_pose = |point: u32| {
        let part = 0.3 + 0.4 * f64::from(point) / f64::from(count);
        let direction = |role: &StatusRole| if matches!(role, StatusRole::Direction(_)) { 1.0 } else { 0.0 };
        let mut status: Vec<f64> = info.status.iter().map(|column| direction(&column.role)).collect();
        for axis in &info.axes {
            let [from, to] = axis.range.unwrap_or([-100.0, 100.0]);
            status[axis.status] = from + part * (to - from);
        }
        status
    };
    (0..count).flat_map(of_pose).collect()
}

/// A million tips of the five-axis machine, to first order in its errors and exactly, on all cores.
fn predictions(criterion: &mut Criterion) {
    const COUNT: u32 = 1_000_000;
    let fit = tango_s4();
    for evaluation in ["first-order", "exact"] {
        let model = LazyCell::new(|| {
            let mut settings = fit.problem.model.info().settings.clone();
            settings["evaluation"] = evaluation.into();
            let registry = Registry::built_in().unwrap_or_else(|error| panic!("{error}"));
            let Ok(Build::Model(model)) = registry.find(Kind::Model, "serial-chain").map(|plugin| &plugin.build) else {
                panic!("there is no serial chain")
            };
            let built = model.build(&settings, &Context { base: PathBuf::new() });
            let built = built.map_err(|error| Error::data(error.to_string())).and_then(|model| model.build(&[]));
            let model = built.unwrap_or_else(|error| panic!("{error}"));
            let (values, statuses) = (machine_values(model.as_ref(), &fit.calibration), statuses(&*model, COUNT));
            (model, values, statuses)
        });
        criterion.bench_function(&format!("tips_1000000_{}", evaluation.replace('-', "_")), |bencher| {
            let (model, values, statuses) = &*model;
            let parts: Vec<&[f64]> = statuses.chunks(1000 * model.info().status.len()).collect();
            bencher.iter(|| {
                in_parallel(&parts, None, |part| {
                    let mut poses = Poses::default();
                    model.poses(part, values, &[], false, &mut poses).map(|()| poses.positions)
                })
            });
        });
    }
}

/// Corrected set-points of the five-axis machine, position and tool axis: 10,000 between the ends of its travel.
fn set_points(criterion: &mut Criterion) {
    let fit = tango_s4();
    let wide = Settings {
        correct: Correct::FiveAxes,
        largest_tip_correction_mm: 1e3,
        largest_axis_correction_mrad: 1e3,
        ..Settings::default()
    };
    criterion.bench_function("set_points_10000", |bencher| {
        let model = fit.problem.model.as_ref();
        let (values, statuses) = (machine_values(model, &fit.calibration), statuses(model, 10_000));
        let compensator = Compensator::new(model, &values, &wide).unwrap_or_else(|error| panic!("{error}"));
        bencher.iter(|| compensator.correct(black_box(&statuses)).unwrap_or_else(|error| panic!("{error}")).1.len())
    });
}

/// Corrected programs: ten thousand blocks that stay whole, for a machine with three axes and one with five.
fn programs(criterion: &mut Criterion) {
    const COUNT: u32 = 10_000;
    let file = |name: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join("calibrations").join(name);
    for (name, correct) in [("three-axis", Correct::Position), ("table-table", Correct::FiveAxes)] {
        let text = std::fs::read_to_string(file(&format!("{name}.calibration.json")));
        let text = text.unwrap_or_else(|error| panic!("{name}: {error}"));
        let calibration = Calibration::from_json(&text).unwrap_or_else(|error| panic!("{error}"));
        let registry = Registry::built_in().unwrap_or_else(|error| panic!("{error}"));
        let model = model_of(&calibration, &registry).unwrap_or_else(|error| panic!("{error}"));
        let values = machine_values(model.as_ref(), &calibration);
        let turns = if correct == Correct::FiveAxes { " A-20 C-30" } else { "" };
        let mut program = format!("G21 G90 G17 G94 G54\nG0 X-90 Y-90 Z10{turns}\nG1 F1000\n");
        for block in 0..COUNT {
            let part = f64::from(block) / f64::from(COUNT);
            let turns = match correct {
                Correct::FiveAxes => {
                    format!(" A{:.4} C{:.4}", 10.0f64.mul_add(part, -20.0), 20.0f64.mul_add(part, -30.0))
                }
                _ => String::new(),
            };
            program.push_str(&format!(
                "X{:.4} Y{:.4} Z{:.4}{turns}\n",
                180.0f64.mul_add(part, -90.0),
                150.0f64.mul_add(part, -90.0),
                30.0f64.mul_add(part, 10.0)
            ));
        }
        program.push_str("M2\n");
        let settings = Settings { correct, ..Settings::default() };
        let build = |length: Option<f64>| {
            Machine::new(model.clone(), values.clone(), settings.clone(), length.unwrap_or(100.0), None)
        };
        let options = Options { start: [Some(0.0); 9], ..Options::new(Dialect::Linuxcnc) };
        criterion.bench_function(&format!("program_blocks_10000_{}", name.replace('-', "_")), |bencher| {
            bencher.iter(|| {
                let summary = compensate(&mut black_box(program.as_bytes()), &mut std::io::sink(), &build, &options);
                summary.unwrap_or_else(|error| panic!("{error}")).blocks
            })
        });
    }
}

/// Builds packages in the profile of the benchmarks; returns the folder of the built files.
fn built(packages: &[&str]) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    let mut command = Command::new(env!("CARGO"));
    command.args(["build", "--release", "--locked", "--quiet"]).current_dir(&root);
    for package in packages {
        command.args(["--package", package]);
    }
    match command.status() {
        Ok(status) if status.success() => target.join("release"),
        other => panic!("the packages cannot be built: {other:?}"),
    }
}

/// A name, and how its problem is made.
type Named<'a> = (&'a str, &'a dyn Fn() -> Result<Problem, Error>);

/// The same fit with the model built in, through the border of a library, and in a process of its own.
fn border(criterion: &mut Criterion) {
    let folder = LazyCell::new(|| built(&["abbe", "abbe-stock-library"]));
    let name = format!("{}abbe_stock_library{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    let limits = || Limits {
        program: folder.join("abbe"),
        arguments: ["plugin", "serve"].map(str::to_owned).to_vec(),
        answer_timeout: Duration::from_secs(60),
        total_time: Duration::from_secs(3600),
        memory_limit_mib: abbe_plugin::MEMORY_LIMIT_MIB,
    };
    let fit = tango_s4();
    let through = |library: Result<Library, Error>| -> Result<Problem, Error> {
        let plugins = library?.plugins;
        let model = plugins.iter().find(|plugin| plugin.name == "serial-chain").map(|plugin| &plugin.build);
        let Some(Build::Model(model)) = model else { return Err(Error::data("the library has no serial chain")) };
        let built = model.build(&fit.problem.model.info().settings, &Context { base: PathBuf::new() });
        let model = built.map_err(|error| Error::data(error.to_string()))?.build(&[])?;
        Ok(Problem { model, ..fit.problem.as_ref().clone() })
    };
    let built_in = || Ok(fit.problem.as_ref().clone());
    let dynamic = || through(abbe_plugin::load(&folder.join(&name), None));
    let isolated = || through(abbe_plugin::isolated(&folder.join(&name), None, &limits()));
    let problems: [Named<'_>; 3] = [("built_in", &built_in), ("dynamic", &dynamic), ("isolated", &isolated)];
    for (name, problem) in problems {
        criterion.bench_function(&format!("tango_s4_fit_{name}"), |bencher| {
            let problem = problem().unwrap_or_else(|error| panic!("{error}"));
            bencher.iter(|| fit.estimator.estimate(black_box(&problem)).map(|calibration| calibration.fit.sigma))
        });
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).warm_up_time(Duration::from_secs(1)).without_plots();
    targets = qr, product, tango, cmm, mill, thermal, predictions, set_points, programs, border
}
criterion_main!(benches);
