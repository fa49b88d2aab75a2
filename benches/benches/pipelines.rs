//! How long the work takes, beside a plain matrix product that tells how fast the machine is.

use std::hint::black_box;
use std::path::Path;

use abbe_bundle as _;
use abbe_core::{Error, Fit, Registry};
use abbe_engine::prepare;
use criterion::{Criterion, criterion_group, criterion_main};
use faer::Mat;

/// The fits of a recipe of the repository.
fn fits(recipe: &str) -> Result<Vec<Fit>, Error> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines").join(recipe);
    Ok(prepare(&path, &Registry::built_in()?)?.run(&|_| {})?.fits)
}

fn product(criterion: &mut Criterion) {
    let entries = |row: usize, column: usize| ((row * 7 + column * 3) % 11) as f64 - 5.0;
    let (a, b) = (Mat::from_fn(256, 256, entries), Mat::from_fn(256, 256, entries));
    criterion.bench_function("matrix_product_256", |bencher| bencher.iter(|| black_box(&a) * black_box(&b)));
}

fn tango(criterion: &mut Criterion) {
    let fits = fits("tango-hu40t-exact.yaml").unwrap_or_else(|error| panic!("{error}"));
    let Some(fit) = fits.iter().find(|fit| fit.name == "fit-S4") else { panic!("the recipe has no fit-S4") };
    criterion.bench_function("tango_s4_fit", |bencher| {
        bencher.iter(|| fit.estimator.estimate(black_box(&fit.problem)).map(|calibration| calibration.fit.sigma))
    });
    let Some(fit) = fits.iter().find(|fit| fit.name == "fit-S3") else { panic!("the recipe has no fit-S3") };
    let problem = fit.problem.at(&fit.problem.values_of(&fit.calibration));
    let errors: Vec<f64> = (0..problem.equations()).map(|row| 1e-3 * ((row * 7 % 11) as f64 - 5.0) / 3.0).collect();
    criterion.bench_function("tango_s3_trial", |bencher| {
        bencher.iter(|| fit.estimator.values(&problem.disturbed(black_box(&errors))).map(|values| values[0]))
    });
    criterion.bench_function("tango_run", |bencher| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines/tango-hu40t.yaml");
        bencher.iter(|| {
            let prepared = prepare(black_box(&path), &Registry::built_in()?)?;
            prepared.run(&|_| {}).map(|outcome| outcome.fits.len())
        })
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).warm_up_time(std::time::Duration::from_secs(1)).without_plots();
    targets = product, tango
}
criterion_main!(benches);
