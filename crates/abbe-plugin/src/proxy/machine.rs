//! Machines of the other side.

use std::any::Any;
use std::collections::BTreeSet;
use std::sync::Arc;

use abbe_core::{
    Axis, ErrorFunction, KinematicModel, MotionError, Parameter, Period, Poses, Result, StatusColumn, StatusRole,
    Variable,
};
use serde_json::Value;

use super::{ask, finite};
use crate::abi::*;
use crate::peer::{Failure, Peer, Transit, broken};
use crate::served::Served;
use crate::texts::{MachineText, MotionText};

/// A machine of the other side.
pub(super) struct Machine {
    pub peer: Arc<dyn Peer>,
    text: MachineText,
}

/// The machine that came over.
pub(crate) fn machine(object: &Transit) -> Result<Arc<dyn KinematicModel>, Failure> {
    match object {
        Transit::Local(served) => match served.as_ref() {
            Served::Machine(machine) => Ok(machine.clone()),
            _ => Err(Failure::of("the other side", "gives an object that is no machine")),
        },
        Transit::Remote(peer) => {
            let mut text: MachineText = ask(peer.as_ref(), ABBE_DESCRIBE, &(), &[])?;
            for values in [&mut text.nominal, &mut text.nominal_uncertainties] {
                if values.is_empty() {
                    values.resize(text.parameters.len(), 0.0);
                }
            }
            // A machine that was built before there were roles tells them by its names.
            for column in text.status.iter_mut().filter(|column| column.role == StatusRole::Other) {
                column.role = StatusRole::of_name(&column.name, &text.axes);
            }
            check_machine(&text).map_err(|what| Failure::of(peer.who(), what))?;
            Ok(Arc::new(Machine { peer: peer.clone(), text }))
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
    let of_no_axis = |column: &&StatusColumn| match column.role {
        StatusRole::Command(axis) | StatusRole::Direction(axis) => axis >= text.axes.len(),
        _ => false,
    };
    if let Some(column) = text.status.iter().find(of_no_axis) {
        return Err(format!("describes a machine whose status {} is of an axis that is not there", column.name));
    }
    if let Some(function) = text.error_functions.iter().find(|f| f.axis >= text.axes.len() || f.component >= 6) {
        return Err(format!("describes a machine whose error {} is of no axis or component", function.symbol));
    }
    let wrong = |period: &&Period| {
        let outside = period.parameters.iter().any(|parameter| *parameter >= text.parameters.len());
        outside || period.axis >= text.axes.len() || !(period.length > 0.0 && period.length.is_finite())
    };
    if let Some(period) = text.periods.iter().find(wrong) {
        return Err(format!(
            "describes a machine whose {} has a period of no axis, parameter or length",
            period.symbol
        ));
    }
    if !text.stylus_radius.is_finite() || text.stylus_radius < 0.0 {
        return Err(format!("describes a machine with a stylus radius of {} mm", text.stylus_radius));
    }
    if text.nominal.len() != text.parameters.len() || !text.nominal.iter().all(|value| value.is_finite()) {
        return Err("describes a machine whose nominal values are not one finite number a parameter".to_owned());
    }
    let uncertainties = &text.nominal_uncertainties;
    if uncertainties.len() != text.parameters.len() || !uncertainties.iter().all(|u| u.is_finite() && *u >= 0.0) {
        return Err("describes a machine whose nominal values have not one standard uncertainty a parameter".to_owned());
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

    fn nominal(&self) -> Vec<f64> {
        self.text.nominal.clone()
    }

    fn nominal_uncertainties(&self) -> Vec<f64> {
        self.text.nominal_uncertainties.clone()
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
        out.reset(statuses.len() / self.text.status.len(), wanted.len(), orientation);
        let peer = self.peer.as_ref();
        peer.poses(statuses, values, wanted, out).map_err(|failure| failure.error(peer.who()))?;
        finite(peer, "positions", out.positions.as_flattened())?;
        finite(peer, "derivatives", out.position_derivatives.as_flattened())?;
        let norm = |turn: &[f64; 4]| turn.iter().map(|part| part * part).sum::<f64>();
        // A comparison that NaN fails too.
        if !out.orientations.iter().all(|turn| (norm(turn) - 1.0).abs() < 1e-6) {
            return Err(broken(peer.who(), "gave orientations that are no unit quaternions"));
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

    fn periods(&self) -> Vec<Period> {
        self.text.periods.clone()
    }

    fn motion_error(&self, function: &ErrorFunction, values: &[f64], status: &[f64]) -> Result<MotionError> {
        let status = status.iter().copied().map(Some).collect();
        let question = MotionText { function: function.clone(), values: values.to_vec(), status };
        let peer = self.peer.as_ref();
        let error: MotionError = ask(peer, ABBE_MOTION_ERROR, &question, &[])?;
        if error.derivatives.iter().any(|by| by.0 >= self.text.parameters.len()) {
            return Err(broken(peer.who(), "gave a derivative to a parameter that is not there"));
        }
        finite(peer, "motion errors", std::iter::once(&error.value).chain(error.derivatives.iter().map(|by| &by.1)))?;
        Ok(error)
    }
}
