//! Observations of the other side.

use std::collections::BTreeMap;
use std::sync::Arc;

use abbe_core::{
    Contact, Dataset, Equations, Observations, ObservationsInfo, Orientation, RankPoint, Result, RowBatch, RowIndex,
};

use super::{ask, finite};
use crate::abi::*;
use crate::peer::{Failure, Peer, Received, broken};
use crate::served::Served;
use crate::texts::{ObservationsText, TipText};

/// Observations of the other side.
pub(super) struct Observed {
    pub peer: Arc<dyn Peer>,
    info: ObservationsInfo,
}

/// The observations that were received, made of the data set `given`.
pub(crate) fn observations(object: &Received, given: Option<&Arc<Dataset>>) -> Result<Arc<dyn Observations>, Failure> {
    match object {
        Received::Local(served) => match served.as_ref() {
            Served::Observations(observations, _) => Ok(observations.clone()),
            _ => Err(Failure::of("the other side", "gives an object that is no observations")),
        },
        Received::Remote(peer) => {
            let ObservationsText { mut info, data } = ask(peer.as_ref(), ABBE_DESCRIBE, &(), &[])?;
            info.layout.data = match (data, given) {
                (Some(data), _) => Arc::new(data),
                (None, Some(given)) => given.clone(),
                (None, None) => return Err(Failure::of(peer.who(), "gives observations without a data set")),
            };
            if info.start.is_empty() {
                info.start.resize(info.unknowns.len(), 0.0);
            }
            if info.rank_point == RankPoint::NominalReading(BTreeMap::new()) {
                info.rank_point = RankPoint::of(&info.contact);
            }
            check_observations(&info).map_err(|what| Failure::of(peer.who(), what))?;
            Ok(Arc::new(Observed { peer: peer.clone(), info }))
        }
    }
}

fn check_observations(info: &ObservationsInfo) -> Result<(), String> {
    let layout = &info.layout;
    let (poses, equations) = (layout.poses.len(), layout.standard_uncertainties.len());
    for (index, row) in layout.rows.iter().enumerate() {
        let inside = row.first_pose.0.checked_add(row.poses).is_some_and(|end| end <= poses)
            && row.first_equation.0.checked_add(row.equations).is_some_and(|end| end <= equations)
            && row.data_row.is_none_or(|data_row| data_row.0 < layout.data.rows());
        if !inside {
            return Err(format!(
                "gives observations whose row {index} names a pose, equation or data row that is not there"
            ));
        }
    }
    if layout.standard_uncertainties.iter().any(|value| !(*value > 0.0 && value.is_finite())) {
        return Err("gives equations whose standard uncertainty is no positive number".to_owned());
    }
    if info.start.len() != info.unknowns.len() {
        return Err(format!("gives {} start values for {} unknowns", info.start.len(), info.unknowns.len()));
    }
    if layout.data.origins.iter().any(|origin| origin.file >= layout.data.files.len()) {
        return Err("gives data rows of a file that is not there".to_owned());
    }
    if let Some(equation) = info.angles.iter().find(|equation| equation.0 >= equations) {
        return Err(format!("says that equation {equation} is of an angle, and there is no such equation"));
    }
    let fits = matches!(
        (&info.rank_point, &info.contact),
        (RankPoint::AsRecorded, _)
            | (RankPoint::InContact, Contact::LinearAxes)
            | (RankPoint::NominalReading(_), Contact::Reading(_) | Contact::Readings(_))
    );
    if !fits {
        return Err("gives observations whose `rank_point` does not go with their `contact`".to_owned());
    }
    for (index, nominal) in info.rank_point.nominal_readings() {
        let equations = layout.rows.get(index.0).map(|row| row.equations);
        if equations != Some(nominal.residuals.len()) || !nominal.residuals.iter().all(|value| value.is_finite()) {
            return Err(format!("gives a nominal reading of row {index} that is not one finite number an equation"));
        }
    }
    if !info.approaches.is_empty() && info.approaches.len() != layout.rows.len() {
        return Err(format!("gives {} approaches for {} rows", info.approaches.len(), layout.rows.len()));
    }
    let unknown = |(index, _): &(usize, [f64; 3])| *index >= info.unknowns.len();
    match info.features.iter().find(|feature| feature.shifts.iter().any(unknown)) {
        Some(feature) => Err(format!("gives a feature {} that an unknown shifts which is not there", feature.label)),
        None => Ok(()),
    }
}

impl Observations for Observed {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        let peer = self.peer.as_ref();
        let mut given = Equations::default();
        peer.equations(batch, &mut given).map_err(|failure| failure.error(peer.who()))?;
        self.check(batch.rows, &given)?;
        out.append(&given);
        Ok(())
    }

    fn contact_tip(&self, row: RowIndex, tip: [f64; 3], own: &[f64], inputs: &[f64]) -> Result<Option<[f64; 3]>> {
        let question = TipText { row, tip, own: own.to_vec(), inputs: inputs.to_vec() };
        let peer = self.peer.as_ref();
        let tip: Option<[f64; 3]> = ask(peer, ABBE_CONTACT_TIP, &question, &[])?;
        finite(peer, "points of contact", tip.as_slice().as_flattened())?;
        Ok(tip)
    }
}

impl Observed {
    /// Checks that the numbers of equations and derivatives are those of the layout, that derivatives are to unknowns and
    /// inputs that exist, and that all values are finite.
    fn check(&self, rows: &[RowIndex], given: &Equations) -> Result<()> {
        let peer = self.peer.as_ref();
        let rows = || rows.iter().map(|&row| self.info.layout.rows[row]);
        let (equations, poses): (usize, usize) =
            (rows().map(|row| row.equations).sum(), rows().map(|row| row.equations * row.poses).sum());
        let turned = if self.info.orientation != Orientation::Unused { poses } else { 0 };
        let found = (given.residuals().len(), given.by_position().len(), given.by_rotation().len());
        if found != (equations, poses, turned) {
            let what = format!(
                "gave {} equations with {} derivatives to positions and {} to rotations; {equations}, {poses} and {turned} were expected",
                found.0, found.1, found.2
            );
            return Err(broken(peer.who(), what));
        }
        let outside = given.by_own().iter().any(|by| by.1 >= self.info.unknowns.len())
            || given.by_input().iter().any(|by| by.1 >= self.info.inputs.len());
        if outside {
            return Err(broken(peer.who(), "gave a derivative to an unknown or input that is not there"));
        }
        finite(peer, "residuals", given.residuals())?;
        finite(peer, "derivatives", given.by_position().as_flattened())?;
        finite(peer, "derivatives", given.by_rotation().as_flattened())?;
        finite(peer, "derivatives", given.by_own().iter().chain(given.by_input()).map(|by| &by.2))
    }
}
