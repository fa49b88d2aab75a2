//! Machines of the other side.

use std::any::Any;
use std::collections::BTreeSet;
use std::sync::Arc;

use abbe_core::{Axis, Error, ErrorFunction, KinematicModel, Parameter, Poses, Result, StatusColumn, Variable};
use serde_json::Value;

use super::{Unsaid, ask, finite};
use crate::abi::*;
use crate::peer::{Failure, Peer, Transit};
use crate::served::Served;
use crate::texts::{MachineText, TermsText};

/// A machine of the other side.
pub(super) struct Machine {
    pub peer: Arc<dyn Peer>,
    text: MachineText,
    unsaid: Unsaid,
}

/// The machine that came over.
pub(crate) fn machine(object: &Transit) -> Result<Arc<dyn KinematicModel>, Failure> {
    match object {
        Transit::Local(served) => match served.as_ref() {
            Served::Machine(machine) => Ok(machine.clone()),
            _ => Err(Failure::of("the other side", "gives an object that is no machine")),
        },
        Transit::Remote(peer) => {
            let text: MachineText = ask(peer.as_ref(), ABBE_DESCRIBE, &(), &[])?;
            check_machine(&text).map_err(|what| Failure::of(peer.who(), what))?;
            Ok(Arc::new(Machine { peer: peer.clone(), text, unsaid: Unsaid::default() }))
        }
    }
}

fn check_machine(text: &MachineText) -> Result<(), String> {
    if text.status.is_empty() {
        return Err("describes a machine whose poses have no status".to_owned());
    }
    if let Some(axis) = text.axes.iter().find(|axis| axis.status >= text.status.len()) {
        return Err(format!(
            "describes a machine whose axis {} has status {}, which is not there",
            axis.name, axis.status
        ));
    }
    if let Some(function) = text.error_functions.iter().find(|f| f.axis >= text.axes.len() || f.component >= 6) {
        return Err(format!("describes a machine whose error {} is of no axis or component", function.symbol));
    }
    if !text.stylus_radius.is_finite() || text.stylus_radius < 0.0 {
        return Err(format!("describes a machine with a stylus radius of {} mm", text.stylus_radius));
    }
    let mut names = BTreeSet::new();
    match text.parameters.iter().find(|parameter| parameter.name.is_empty() || !names.insert(&parameter.name)) {
        Some(parameter) => {
            Err(format!("describes a machine with two parameters `{}`, or one without a name", parameter.name))
        }
        None => Ok(()),
    }
}

impl KinematicModel for Machine {
    fn axes(&self) -> &[Axis] {
        &self.text.axes
    }

    fn status(&self) -> &[StatusColumn] {
        &self.text.status
    }

    fn parameters(&self) -> &[Parameter] {
        &self.text.parameters
    }

    fn stylus_radius(&self) -> f64 {
        self.text.stylus_radius
    }

    fn evaluate(
        &self,
        statuses: &[f64],
        values: &[f64],
        wanted: &[Variable],
        orientation: bool,
        out: &mut Poses,
    ) -> Result<()> {
        self.unsaid.told()?;
        out.reset(statuses.len() / self.text.status.len(), wanted.len(), orientation);
        let peer = self.peer.as_ref();
        peer.poses(statuses, values, wanted, out).map_err(|failure| failure.error(peer.who()))?;
        finite(peer, "positions", out.positions.as_flattened())?;
        finite(peer, "derivatives", out.position_derivatives.as_flattened())?;
        let norm = |turn: &[f64; 4]| turn.iter().map(|part| part * part).sum::<f64>();
        // A comparison that NaN fails too.
        if !out.orientations.iter().all(|turn| (norm(turn) - 1.0).abs() < 1e-6) {
            return Err(Error::data(format!("{} gave orientations that are no unit quaternions", peer.who())));
        }
        finite(peer, "derivatives of orientations", out.rotation_derivatives.as_flattened())
    }

    fn behind(&self) -> Option<&dyn Any> {
        Some(self)
    }

    fn settings(&self) -> Value {
        self.text.settings.clone()
    }

    fn error_functions(&self) -> Vec<ErrorFunction> {
        self.text.error_functions.clone()
    }

    fn error_terms(&self, function: &ErrorFunction, status: &[f64]) -> Vec<(usize, f64)> {
        let question = TermsText { function: function.clone(), status: status.iter().copied().map(Some).collect() };
        let peer = self.peer.as_ref();
        let terms = ask(peer, ABBE_ERROR_TERMS, &question, &[]).and_then(|terms: Vec<(usize, f64)>| {
            match terms.iter().all(|term| term.0 < self.text.parameters.len() && term.1.is_finite()) {
                true => Ok(terms),
                false => {
                    Err(Error::data(format!("{} gave a term of no parameter, or one that is no number", peer.who())))
                }
            }
        });
        // No term would say that the motion has no error.
        let none = if self.text.parameters.is_empty() { Vec::new() } else { vec![(0, f64::NAN)] };
        self.unsaid.keep(terms, none)
    }
}
