//! What may explain a run besides the candidates: other errors of the model, and those that the model lacks.

use abbe_core::{AxisKind, Fit, KinematicModel, ParameterRole};

use crate::diagnosis::{CAUSE, Diagnoser, Diagnosis, Pattern};
use crate::verify::{Report, short};

/// What may explain a run besides the candidates.
pub struct OtherExplanations<'a> {
    /// All parameters of the model, and what can happen to the artefact.
    pub patterns: &'a [Pattern],
    /// Finds their part in the deviations; none if the scatter has no covariance.
    pub diagnoser: Option<&'a Diagnoser<'a>>,
    /// Names of the location errors that the chain can have and the model does not.
    pub undeclared: &'a [String],
}

impl OtherExplanations<'_> {
    /// A sentence on an error that is no candidate and explains the deviations better than `found` does, or on those that the model
    /// lacks, where several touches would have to fail at once.
    pub fn sentence(&self, report: &Report<'_>, found: &Diagnosis, deviations: &[f64]) -> Option<String> {
        let candidate = |pattern: &Pattern| report.patterns.iter().any(|other| other.name == pattern.name);
        let better = self
            .diagnoser
            .map(|diagnoser| diagnoser.diagnose(deviations))
            .filter(|all| all.score + CAUSE < found.score);
        let better = better.and_then(|all| all.causes.into_iter().next());
        if let Some(cause) = better.filter(|cause| !candidate(&self.patterns[cause.pattern])) {
            let pattern = &self.patterns[cause.pattern];
            let (symbol, factor) = pattern.unit.for_people();
            return Some(format!(
                "but the pattern is that of a change of {} ({} {symbol}), which explains {:.1} % and is not among the `candidates`",
                pattern.name,
                short(cause.size * factor),
                cause.explained.clamp(0.0, 1.0) * 100.0
            ));
        }
        let unlikely = found.touches.len() > 1 || !found.is_complete();
        (unlikely && !self.undeclared.is_empty()).then(|| {
            format!(
                "before the probe is blamed: the model lacks {}; declare `location: [\"E?0?\"]` under `errors`, so that they can be told",
                listed_names(self.undeclared)
            )
        })
    }
}

/// Whether a pattern is that of what shapes a function, and no error.
pub fn shapes(fit: &Fit, pattern: &Pattern) -> bool {
    let parameters = &fit.problem.model.info().parameters;
    pattern.parameters.iter().any(|&index| parameters[index].role == ParameterRole::Shape)
}

/// Location errors (ISO 230-1) that the axes of a model can have and that are not among its parameters. A model that has none of its
/// axes describes them in another way: none.
pub fn undeclared(model: &dyn KinematicModel) -> Vec<String> {
    let info = model.info();
    let has = |wanted: (usize, usize)| {
        let is = |role: ParameterRole| matches!(role, ParameterRole::Location { axis, component } if (axis, component) == wanted);
        info.parameters.iter().any(|parameter| is(parameter.role))
    };
    let located = info.parameters.iter().any(|parameter| matches!(parameter.role, ParameterRole::Location { .. }));
    let axes = info.axes.iter().enumerate().filter(|_| located);
    let all = axes.flat_map(|(index, axis)| {
        // Of a linear axis no place is an error: it has a direction alone.
        let components = if axis.kind == AxisKind::Linear { 3..6 } else { 0..6 };
        components
            .filter(move |component| !has((index, *component)))
            .map(move |component| format!("E{}0{}", ["X", "Y", "Z", "A", "B", "C"][component], axis.name))
    });
    all.collect()
}

/// `EA0X, EB0X and 4 more`.
fn listed_names(names: &[String]) -> String {
    const SHOWN: usize = 6;
    let shown = names.iter().take(SHOWN).cloned().collect::<Vec<_>>().join(", ");
    if names.len() > SHOWN { format!("{shown} and {} more", names.len() - SHOWN) } else { shown }
}
