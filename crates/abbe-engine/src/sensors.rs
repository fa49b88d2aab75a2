//! Sensors of a log that are exchanged: with their columns the other way round the machine explains what was measured.

use abbe_core::{Dataset, Problem, Quantity, Result};
use abbe_estimation::explaining_machine;
use abbe_recipe::Stage;

use crate::prepare::Prepared;
use crate::run::Datasets;
use crate::told::untold;

/// Most pairs of sensors that are tried: all of 60 sensors.
const PAIRS: usize = 2000;

impl Prepared {
    /// What comparisons with other readings of the same rows tell of an estimate, and of its values of the unknowns if they are known.
    pub(crate) fn comparisons(
        &self,
        stage: &Stage,
        (problem, estimate): (&Problem, Option<&[f64]>),
        data: &Datasets,
    ) -> Vec<String> {
        let mut told = abbe_estimation::comparisons(problem, estimate);
        told.extend(self.exchanged_sensors(stage, (problem, estimate), data).ok().flatten());
        told
    }

    /// The sentence on two sensors with whose columns exchanged the residuals scatter as stated; none where they do so as they are, and
    /// where no exchange makes them.
    fn exchanged_sensors(
        &self,
        stage: &Stage,
        (problem, estimate): (&Problem, Option<&[f64]>),
        data: &Datasets,
    ) -> Result<Option<String>> {
        let stage = self.built_for(stage)?;
        let logs = self.logs(self.machine(stage)?.0, |log| Ok(data[log].clone()))?;
        let pairs = logs.iter().enumerate().flat_map(|(log, own)| pairs(own).into_iter().map(move |pair| (log, pair)));
        let mut pairs = pairs.take(PAIRS).peekable();
        if pairs.peek().is_none() {
            return Ok(None);
        }
        let machines = pairs.filter_map(|(log, [one, other])| {
            let mut exchanged = logs.clone();
            let columns = &mut exchanged[log].columns;
            let values = columns[one].values.clone();
            columns[one].values = std::mem::replace(&mut columns[other].values, values);
            // A machine that cannot be built explains nothing, and what is wrong with its sensors has been told of the right one.
            let machine = untold(|| self.machine_with(stage, data, &exchanged));
            Some(((log, [one, other]), machine.ok()?))
        });
        let found = explaining_machine(problem, estimate, machines);
        Ok(found.map(|((log, pair), [before, after])| {
            let [one, other] = pair.map(|column| logs[log].columns[column].header.name.as_str());
            format!(
                "with the temperatures {one} and {other} exchanged the residuals scatter as stated ({after:.2} times as much), and as they \
                 are {before:.2} times as much: are these two sensors exchanged?"
            )
        }))
    }
}

/// Two columns of temperatures each.
fn pairs(log: &Dataset) -> Vec<[usize; 2]> {
    let is_temperature = |column: &usize| log.columns[*column].header.quantity == Quantity::Temperature;
    let columns: Vec<usize> = (0..log.columns.len()).filter(is_temperature).collect();
    let of = |place: usize| columns[place + 1..].iter().map(move |other| (place, *other));
    (0..columns.len()).flat_map(of).map(|(place, other)| [columns[place], other]).collect()
}
