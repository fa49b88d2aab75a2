//! Estimators of the other side.

use std::sync::Arc;

use abbe_core::{Calibration, Estimate, Fit, Identifiability, Problem, Result};
use serde::de::DeserializeOwned;

use super::ask;
use crate::abi::*;
use crate::peer::{Peer, Received, broken};
use crate::served::Served;
use crate::texts::{FitText, ProblemText};

/// The estimator that was received. An object that is no estimator fails when it is used.
pub(crate) fn estimator(object: &Received) -> Arc<dyn Estimate> {
    match object {
        Received::Local(served) => match served.as_ref() {
            Served::Estimate(estimator) => estimator.clone(),
            _ => Arc::new(NoEstimator),
        },
        Received::Remote(peer) => Arc::new(Estimator::new(peer.clone())),
    }
}

/// Replaces an object that is no estimator: every call fails.
struct NoEstimator;

impl Estimate for NoEstimator {
    fn estimate(&self, _: &Problem) -> Result<Calibration> {
        Err(broken("the other side", "gave an object that is no estimator"))
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(broken("the other side", "gave an object that is no estimator"))
    }
}

/// An estimator of the other side.
pub(crate) struct Estimator {
    peer: Arc<dyn Peer>,
}

impl Estimator {
    pub fn new(peer: Arc<dyn Peer>) -> Self {
        Self { peer }
    }

    fn ask<A: DeserializeOwned>(&self, method: u32, problem: &Problem) -> Result<A> {
        let mut objects = Vec::new();
        let text = ProblemText::of(problem, &mut objects);
        ask(self.peer.as_ref(), method, &text, &objects)
    }

    /// Checks a calibration like one that is read from a file.
    fn checked(&self, calibration: Calibration) -> Result<Calibration> {
        let text = calibration.to_json().and_then(|text| Calibration::from_json(&text));
        text.map_err(|error| broken(self.peer.who(), format!("gave a wrong calibration: {error}")))
    }
}

impl Estimate for Estimator {
    fn estimate(&self, problem: &Problem) -> Result<Calibration> {
        self.ask(ABBE_SOLVE, problem).and_then(|calibration| self.checked(calibration))
    }

    fn explain(&self, problem: &Problem) -> Result<Calibration> {
        self.ask(ABBE_EXPLAIN, problem).and_then(|calibration| self.checked(calibration))
    }

    fn values(&self, problem: &Problem) -> Result<Vec<f64>> {
        let values: Vec<f64> = self.ask(ABBE_VALUES, problem)?;
        match values.len() == problem.unknowns.len() {
            true => Ok(values),
            false => {
                let what = format!("gave {} values for {} unknowns", values.len(), problem.unknowns.len());
                Err(broken(self.peer.who(), what))
            }
        }
    }

    fn analyse(&self, fit: &Fit) -> Result<Calibration> {
        let mut objects = Vec::new();
        let text = FitText::of(fit, &mut objects);
        ask(self.peer.as_ref(), ABBE_ANALYSE, &text, &objects).and_then(|calibration| self.checked(calibration))
    }

    fn identify(&self, problem: &Problem) -> Result<Identifiability> {
        self.ask(ABBE_IDENTIFY, problem)
    }

    fn accepts(&self, found: &Identifiability) -> Result<bool> {
        ask(self.peer.as_ref(), ABBE_ACCEPTS, found, &[])
    }
}
