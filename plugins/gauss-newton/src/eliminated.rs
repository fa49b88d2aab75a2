//! Estimates with many own unknowns of artefacts: these are eliminated, one facet or ball after another.

use abbe_core::{Calibration, Error, Owner, Parts, Problem, Result, Unknown};
use abbe_estimation::{EliminatedRows, MOST_AT_ONCE, confounded};

use crate::GaussNewton;
use crate::convergence::converged;
use crate::settings::{OnConfounded, Variance};

impl GaussNewton {
    /// The rows of a problem if its own unknowns are to be eliminated: there are more of them than `own_covariances`.
    ///
    /// Where that is not possible, and there are few enough for one triangle of all unknowns, it is not done. Fails where there are too
    /// many.
    pub(crate) fn eliminating<'a>(
        &self,
        problem: &'a Problem,
        parts: &'a dyn Parts,
    ) -> Result<Option<EliminatedRows<'a>>> {
        let own = problem.unknowns.iter().filter(|unknown| matches!(unknown.owner, Owner::Set(_))).count();
        if own <= self.settings.own_covariances.get() {
            return Ok(None);
        }
        let found = self.may_eliminate(problem).and_then(|()| EliminatedRows::new(problem, parts));
        let at_once = match &found {
            Ok(rows) => problem.unknowns.len() - rows.eliminated(),
            Err(error) if error.fatal || error.out_of_time => return found.map(Some),
            Err(_) => problem.unknowns.len(),
        };
        match found {
            Ok(rows) if rows.eliminated() > 0 && at_once <= MOST_AT_ONCE => Ok(Some(rows)),
            _ if problem.unknowns.len() <= MOST_AT_ONCE => Ok(None),
            Err(error) => Err(error),
            Ok(_) => {
                let message = format!(
                    "{at_once} unknowns occur in rows with most others, so that they cannot be eliminated; {MOST_AT_ONCE} at most are \
                     estimated at once"
                );
                Err(Error::usage(message).help("estimate fewer").setting("parameters"))
            }
        }
    }

    /// Refuses settings and unknowns that need one triangle of all.
    fn may_eliminate(&self, problem: &Problem) -> Result<()> {
        let refused = |setting: &str| {
            let message = format!(
                "`{setting}` needs the covariances of all {} unknowns, and {MOST_AT_ONCE} at most have them",
                problem.unknowns.len()
            );
            Err(Error::usage(message)
                .help("leave it out, so that own unknowns are eliminated, or estimate fewer")
                .setting(setting))
        };
        if self.settings.robust.is_some() {
            return refused("robust");
        }
        if self.settings.select.is_some() {
            return refused("select");
        }
        if self.settings.variance == Variance::PerStage {
            return refused("variance");
        }
        if self.settings.on_confounded != OnConfounded::Error {
            return refused("on_confounded");
        }
        // A wavelength needs a better start: it has no effect as long as its amplitudes are zero.
        let nominal = &problem.model.info().nominal;
        let shapes = |unknown: &&Unknown| unknown.owner == Owner::Machine && nominal[unknown.index] != 0.0;
        if problem.unknowns.iter().any(|unknown| shapes(&unknown)) {
            return refused("parameters");
        }
        Ok(())
    }

    /// The estimate of a problem whose own unknowns are eliminated.
    pub(crate) fn of_eliminated(&self, rows: &EliminatedRows<'_>, explained: bool) -> Result<Calibration> {
        let found = rows.judge(self.settings.rank_tolerance)?;
        if found.rank < found.unknowns {
            return Err(confounded(&found));
        }
        let options = self.options(self.settings.tolerance, false);
        let solution = converged(rows.solve(&rows.problem().start(), &options)?, &options)?;
        self.evaluation(explained).calibration_of_eliminated(rows, &solution)
    }
}
