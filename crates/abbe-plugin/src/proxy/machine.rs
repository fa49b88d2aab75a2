//! Machines of the other side.

use std::collections::BTreeSet;
use std::sync::Arc;

use abbe_core::{
    Axis, ErrorFunction, KinematicModel, ModelInfo, MotionError, Parameter, ParameterRole, PeriodicError, PoseBatch,
    PosesMut, Result, StatusColumn, StatusRole,
};

use super::{ask, finite};
use crate::abi::*;
use crate::peer::{Failure, Peer, Received, broken};
use crate::served::Served;
use crate::spare::Spare;
use crate::texts::MotionText;

/// A machine of the other side.
pub(super) struct Machine {
    pub peer: Arc<dyn Peer>,
    info: ModelInfo,
    spare: Spare,
}

/// The machine that was received.
pub(crate) fn machine(object: &Received) -> Result<Arc<dyn KinematicModel>, Failure> {
    match object {
        Received::Local(served) => match served.as_ref() {
            Served::Machine(machine) => Ok(machine.clone()),
            _ => Err(Failure::of("the other side", "gives an object that is no machine")),
        },
        Received::Remote(peer) => {
            let mut info: ModelInfo = ask(peer.as_ref(), ABBE_DESCRIBE, &(), &[])?;
            for values in [&mut info.nominal, &mut info.nominal_uncertainties] {
                if values.is_empty() {
                    values.resize(info.parameters.len(), 0.0);
                }
            }
            check_machine(&info).map_err(|what| Failure::of(peer.who(), what))?;
            Ok(Arc::new(Machine { peer: peer.clone(), info, spare: Spare::default() }))
        }
    }
}

fn check_machine(info: &ModelInfo) -> Result<(), String> {
    if info.status.is_empty() {
        return Err("describes a machine whose poses have no status".to_owned());
    }
    if let Some(axis) = info.axes.iter().find(|axis| axis.status >= info.status.len()) {
        return Err(format!(
            "describes a machine whose axis {} has status {}, which is not there",
            axis.name, axis.status
        ));
    }
    let command = |(index, axis): &(usize, &Axis)| info.status[axis.status].role == StatusRole::Command(*index);
    if let Some((_, axis)) = info.axes.iter().enumerate().find(|axis| !command(axis)) {
        return Err(format!(
            "describes a machine whose axis {} has status {}, whose role is not the command of this axis",
            axis.name, axis.status
        ));
    }
    let of_no_axis = |column: &&StatusColumn| match column.role {
        StatusRole::Command(axis) | StatusRole::Direction(axis) | StatusRole::Velocity(axis) => axis >= info.axes.len(),
        _ => false,
    };
    if let Some(column) = info.status.iter().find(of_no_axis) {
        return Err(format!("describes a machine whose status {} is of an axis that is not there", column.name));
    }
    let of_no_axis = |parameter: &&Parameter| match parameter.role {
        ParameterRole::Motion { axis, component } | ParameterRole::Location { axis, component } => {
            axis >= info.axes.len() || component >= 6
        }
        _ => false,
    };
    if let Some(parameter) = info.parameters.iter().find(of_no_axis) {
        return Err(format!("describes a machine whose parameter {} is of no axis or component", parameter.name));
    }
    let roles = (0..info.axes.len()).map(StatusRole::Direction).chain([StatusRole::Time, StatusRole::Stylus]);
    for role in roles {
        let name = role.column_name(&info.axes);
        let meant = |column: &&StatusColumn| column.role == StatusRole::Other && name.as_ref() == Some(&column.name);
        if let Some(column) = info.status.iter().find(meant) {
            return Err(format!("describes a machine whose status {} does not say its role", column.name));
        }
    }
    if let Some(function) = info.error_functions.iter().find(|f| f.axis >= info.axes.len() || f.component >= 6) {
        return Err(format!("describes a machine whose error {} is of no axis or component", function.symbol));
    }
    let own = |function: &ErrorFunction, parameter: &Parameter| {
        parameter.role == ParameterRole::Motion { axis: function.axis, component: function.component }
    };
    let without = |function: &&ErrorFunction| !info.parameters.iter().any(|parameter| own(function, parameter));
    if let Some(function) = info.error_functions.iter().find(without) {
        return Err(format!("describes a machine whose error {} no parameter has the role of", function.symbol));
    }
    let wrong = |period: &&PeriodicError| {
        let named = period.parameters.iter().chain(&period.shapes);
        let outside = named.into_iter().any(|parameter| *parameter >= info.parameters.len());
        outside || period.axis >= info.axes.len() || !(period.length > 0.0 && period.length.is_finite())
    };
    if let Some(period) = info.periods.iter().find(wrong) {
        return Err(format!(
            "describes a machine whose {} has a period of no axis, parameter or length",
            period.symbol
        ));
    }
    if !info.stylus_radius.is_finite() || info.stylus_radius < 0.0 {
        return Err(format!("describes a machine with a stylus radius of {} mm", info.stylus_radius));
    }
    if info.nominal.len() != info.parameters.len() || !info.nominal.iter().all(|value| value.is_finite()) {
        return Err("describes a machine whose nominal values are not one finite number a parameter".to_owned());
    }
    let uncertainties = &info.nominal_uncertainties;
    if uncertainties.len() != info.parameters.len() || !uncertainties.iter().all(|u| u.is_finite() && *u >= 0.0) {
        return Err("describes a machine whose nominal values have not one standard uncertainty a parameter".to_owned());
    }
    let mut names = BTreeSet::new();
    match info.parameters.iter().find(|parameter| parameter.name.is_empty() || !names.insert(&parameter.name)) {
        Some(parameter) => {
            Err(format!("describes a machine with two parameters `{}`, or one without a name", parameter.name))
        }
        None => Ok(()),
    }
}

impl KinematicModel for Machine {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn evaluate(&self, batch: PoseBatch<'_>, out: PosesMut<'_>) -> Result<()> {
        let PoseBatch { statuses, values, wanted, orientation } = batch;
        // Into lists of our own: they have room behind their ends, where wrong writes are detected and do no harm.
        let mut poses = self.spare.take();
        poses.reset(statuses.len() / self.info.status.len(), wanted.len(), orientation);
        let peer = self.peer.as_ref();
        peer.poses(statuses, values, wanted, &mut poses).map_err(|failure| failure.error(peer.who()))?;
        finite(peer, "positions", poses.positions.as_flattened())?;
        finite(peer, "derivatives", poses.position_derivatives.as_flattened())?;
        let norm = |turn: &[f64; 4]| turn.iter().map(|part| part * part).sum::<f64>();
        // NaN fails this comparison, too.
        if !poses.orientations.iter().all(|turn| (norm(turn) - 1.0).abs() < 1e-6) {
            return Err(broken(peer.who(), "gave orientations that are no unit quaternions"));
        }
        finite(peer, "derivatives of orientations", poses.rotation_derivatives.as_flattened())?;
        out.copy_from(&poses);
        self.spare.give_back(poses);
        Ok(())
    }

    fn motion_error(&self, function: &ErrorFunction, values: &[f64], status: &[f64]) -> Result<MotionError> {
        let status = status.iter().copied().map(Some).collect();
        let question = MotionText { function: function.clone(), values: values.to_vec(), status };
        let peer = self.peer.as_ref();
        let error: MotionError = ask(peer, ABBE_MOTION_ERROR, &question, &[])?;
        if error.derivatives.iter().any(|by| by.0 >= self.info.parameters.len()) {
            return Err(broken(peer.who(), "gave a derivative to a parameter that is not there"));
        }
        finite(peer, "motion errors", std::iter::once(&error.value).chain(error.derivatives.iter().map(|by| &by.1)))?;
        Ok(error)
    }
}
