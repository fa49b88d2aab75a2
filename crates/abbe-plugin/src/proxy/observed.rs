//! Observations of the other side.

use std::any::Any;
use std::sync::Arc;

use abbe_core::{
    Contact, Dataset, Equations, Feature, KnownInput, Layout, NominalReading, Observations, Parameter, PoseValues,
    Quantity, Result,
};

use super::{FirstFailure, ask, finite};
use crate::abi::*;
use crate::peer::{Failure, Known, Peer, Transit, broken};
use crate::served::Served;
use crate::texts::{ObservationsText, TipText};

/// Observations of the other side.
pub(super) struct Observed {
    pub peer: Arc<dyn Peer>,
    text: ObservationsText,
    failure: FirstFailure,
}

/// The observations that came over, made of the data set `given`.
pub(crate) fn observations(object: &Transit, given: Option<&Arc<Dataset>>) -> Result<Arc<dyn Observations>, Failure> {
    match object {
        Transit::Local(served) => match served.as_ref() {
            Served::Observations(observations, _) => Ok(observations.clone()),
            _ => Err(Failure::of("the other side", "gives an object that is no observations")),
        },
        Transit::Remote(peer) => {
            let mut text: ObservationsText = ask(peer.as_ref(), ABBE_DESCRIBE, &(), &[])?;
            text.layout.data = match (text.data.take(), given) {
                (Some(data), _) => Arc::new(data),
                (None, Some(given)) => given.clone(),
                (None, None) => return Err(Failure::of(peer.who(), "gives observations without a data set")),
            };
            check_observations(&text).map_err(|what| Failure::of(peer.who(), what))?;
            Ok(Arc::new(Observed { peer: peer.clone(), text, failure: FirstFailure::default() }))
        }
    }
}

fn check_observations(text: &ObservationsText) -> Result<(), String> {
    let layout = &text.layout;
    let (poses, equations) = (layout.poses.len(), layout.standard_uncertainties.len());
    for (index, row) in layout.rows.iter().enumerate() {
        let inside = row.first_pose.checked_add(row.poses).is_some_and(|end| end <= poses)
            && row.first_equation.checked_add(row.equations).is_some_and(|end| end <= equations)
            && row.data_row.is_none_or(|data_row| data_row < layout.data.rows());
        if !inside {
            return Err(format!(
                "gives observations whose row {index} names a pose, equation or data row that is not there"
            ));
        }
    }
    if layout.standard_uncertainties.iter().any(|value| !(*value > 0.0 && value.is_finite())) {
        return Err("gives equations whose standard uncertainty is no positive number".to_owned());
    }
    if text.start.len() != text.unknowns.len() {
        return Err(format!("gives {} start values for {} unknowns", text.start.len(), text.unknowns.len()));
    }
    if layout.data.origins.iter().any(|origin| origin.file >= layout.data.files.len()) {
        return Err("gives data rows of a file that is not there".to_owned());
    }
    if let Some(equation) = text.angles.iter().find(|equation| **equation >= equations) {
        return Err(format!("says that equation {equation} is of an angle, and there is no such equation"));
    }
    for (index, nominal) in &text.nominal_readings {
        let equations = layout.rows.get(*index).map(|row| row.equations);
        if equations != Some(nominal.residuals.len()) || !nominal.residuals.iter().all(|value| value.is_finite()) {
            return Err(format!("gives a nominal reading of row {index} that is not one finite number an equation"));
        }
    }
    let unknown = |(index, _): &(usize, [f64; 3])| *index >= text.unknowns.len();
    match text.features.iter().find(|feature| feature.shifts.iter().any(unknown)) {
        Some(feature) => Err(format!("gives a feature {} that an unknown shifts which is not there", feature.label)),
        None => Ok(()),
    }
}

impl Observations for Observed {
    fn layout(&self) -> &Layout {
        &self.text.layout
    }

    fn unknowns(&self) -> &[Parameter] {
        &self.text.unknowns
    }

    fn start(&self) -> Vec<f64> {
        self.text.start.clone()
    }

    fn inputs(&self) -> &[KnownInput] {
        &self.text.inputs
    }

    fn quantity(&self, row: usize, equation: usize) -> Quantity {
        match self.text.angles.contains(&(self.text.layout.rows[row].first_equation + equation)) {
            true => Quantity::Angle,
            false => Quantity::Length,
        }
    }

    fn needs_orientation(&self) -> bool {
        self.text.needs_orientation
    }

    fn first_order_orientation(&self) -> bool {
        self.text.first_order_orientation
    }

    fn evaluate(&self, rows: &[usize], poses: PoseValues<'_>, own: &[f64], inputs: &[f64], out: &mut Equations) {
        let first = out.residuals().len();
        if self.try_evaluate(rows, poses, own, inputs, out).is_err() {
            let wanted: usize = rows.iter().map(|&row| self.text.layout.rows[row].equations).sum();
            (out.residuals().len()..first + wanted).for_each(|_| out.equation(f64::NAN));
        }
    }

    fn try_evaluate(
        &self,
        rows: &[usize],
        poses: PoseValues<'_>,
        own: &[f64],
        inputs: &[f64],
        out: &mut Equations,
    ) -> Result<()> {
        self.failure.told()?;
        let peer = self.peer.as_ref();
        let mut given = Equations::default();
        peer.equations(rows, poses, Known { own, inputs }, &mut given).map_err(|failure| failure.error(peer.who()))?;
        self.check(rows, &given)?;
        out.append(&given);
        Ok(())
    }

    fn behind(&self) -> Option<&dyn Any> {
        Some(self)
    }

    fn contact_tip(&self, row: usize, tip: [f64; 3], own: &[f64], inputs: &[f64]) -> Option<[f64; 3]> {
        let question = TipText { row, tip, own: own.to_vec(), inputs: inputs.to_vec() };
        let peer = self.peer.as_ref();
        let tip = ask(peer, ABBE_CONTACT_TIP, &question, &[]).and_then(|tip: Option<[f64; 3]>| {
            finite(peer, "points of contact", tip.as_slice().as_flattened()).map(|()| tip)
        });
        self.failure.keep(tip, None)
    }

    fn features(&self) -> Vec<Feature> {
        self.text.features.clone()
    }

    fn contact(&self) -> Contact {
        self.text.contact.clone()
    }

    fn own_are_offsets(&self) -> bool {
        self.text.own_are_offsets
    }

    fn is_met_anywhere(&self) -> bool {
        self.text.met_anywhere
    }

    fn nominal_reading(&self, row: usize) -> Option<&NominalReading> {
        self.text.nominal_readings.get(&row)
    }
}

impl Observed {
    /// Whether the equations are as many, and of as many poses, as the layout says, and of what there is.
    fn check(&self, rows: &[usize], given: &Equations) -> Result<()> {
        let peer = self.peer.as_ref();
        let rows = || rows.iter().map(|&row| self.text.layout.rows[row]);
        let (equations, poses): (usize, usize) =
            (rows().map(|row| row.equations).sum(), rows().map(|row| row.equations * row.poses).sum());
        let turned = if self.text.needs_orientation { poses } else { 0 };
        let found = (given.residuals().len(), given.by_position().len(), given.by_rotation().len());
        if found != (equations, poses, turned) {
            let what = format!(
                "gave {} equations with {} derivatives to positions and {} to rotations; {equations}, {poses} and {turned} were expected",
                found.0, found.1, found.2
            );
            return Err(broken(peer.who(), what));
        }
        let outside = given.by_own().iter().any(|by| by.1 >= self.text.unknowns.len())
            || given.by_input().iter().any(|by| by.1 >= self.text.inputs.len());
        if outside {
            return Err(broken(peer.who(), "gave a derivative to an unknown or input that is not there"));
        }
        finite(peer, "residuals", given.residuals())?;
        finite(peer, "derivatives", given.by_position().as_flattened())?;
        finite(peer, "derivatives", given.by_rotation().as_flattened())?;
        finite(peer, "derivatives", given.by_own().iter().chain(given.by_input()).map(|by| &by.2))
    }
}
