//! Laws of estimators: kept by one that is right, and broken by those that are not.

use std::path::PathBuf;

use abbe_core::{
    Build, Calibration, Context, Error, Estimate, Identifiability, Kind, PoseIndex, Problem, Registry, Result,
};
use abbe_estimation::laws::{check_estimator, virtual_problem};
use abbe_gauss_newton as _;

fn right() -> Box<dyn Estimate> {
    let registry = Registry::built_in().unwrap();
    let Build::Estimate(constructor) = &registry.find(Kind::Estimate, "gauss-newton").ok().unwrap().build else {
        panic!("it estimates")
    };
    constructor.build(&serde_json::json!({}), &Context { base: PathBuf::new() }).ok().unwrap()
}

/// An estimator whose calibrations are changed.
struct Changed(Box<dyn Estimate>, fn(&Problem, &mut Calibration));

impl Estimate for Changed {
    fn estimate(&self, problem: &Problem) -> Result<Calibration> {
        let mut found = self.0.estimate(problem)?;
        (self.1)(problem, &mut found);
        Ok(found)
    }

    fn identify(&self, problem: &Problem) -> Result<Identifiability> {
        self.0.identify(problem)
    }
}

fn broken(change: fn(&Problem, &mut Calibration)) -> Vec<String> {
    check_estimator(&Changed(right(), change)).unwrap()
}

#[test]
fn least_squares_keep_the_laws() {
    assert_eq!(check_estimator(right().as_ref()).unwrap(), Vec::<String>::new());
    assert_eq!(broken(|_, _| {}), Vec::<String>::new());
}

#[test]
fn ten_nanometres_too_much_are_found() {
    let found = broken(|_, found| found.parameters[0].value += 1e-5 / 180.0);
    assert!(found[0].starts_with("a virtual machine: `EXX[1]` is "), "{found:#?}");
}

#[test]
fn what_hangs_on_the_order_of_rows_is_found() {
    let found = broken(|problem, found| {
        // The first row is another one.
        if problem.sets[0].poses().row(PoseIndex(0))[2] > 0.0 {
            found.parameters[3].value += 1e-6;
        }
    });
    assert!(!found.is_empty() && found.iter().all(|law| !law.starts_with("a virtual machine")), "{found:#?}");
}

#[test]
fn an_uncertainty_that_is_not_that_of_the_covariance_is_found() {
    let found = broken(|_, found| found.parameters[1].standard_uncertainty += 1e-6);
    assert!(found[0].contains("`EYY[1]` has the uncertainty"), "{found:#?}");
}

#[test]
fn who_takes_no_measurements_is_not_judged() {
    struct Other;
    impl Estimate for Other {
        fn estimate(&self, _: &Problem) -> Result<Calibration> {
            Err(Error::usage("it takes circles of a ball bar"))
        }
        fn identify(&self, _: &Problem) -> Result<Identifiability> {
            Err(Error::usage("it takes circles of a ball bar"))
        }
    }
    assert_eq!(check_estimator(&Other).unwrap_err().message, "it takes circles of a ball bar");
    assert_eq!(virtual_problem().unwrap().1.len(), 9);
}
