//! Runs, stretch by stretch: rows of one run that follow one another, as data sets show them.

use abbe_core::{DataRow, Dataset, Error, LabelText, Passes, Result};

use crate::encoder::Counter;
use crate::readings::{Columns, Expected};

/// Rows of one run that follow one another.
pub struct Stretch<'a> {
    data: &'a Dataset,
    /// Its first row in the data set that is shown.
    row: usize,
    /// The run, counted over all data sets.
    pub run: usize,
    /// The label of the run, or that of its file.
    pub label: &'a str,
    /// The number of its first reading in the run.
    pub first: u64,
    /// Angle of the spindle, rad, counted on.
    pub angles: &'a [f64],
    /// s
    pub times: &'a [f64],
    /// Readings of each sensor, mm.
    pub readings: &'a [&'a [f64]],
}

impl Stretch<'_> {
    /// An error at one of its readings.
    pub fn error_at(&self, index: usize, message: String) -> Error {
        self.data.error_at(DataRow(self.row + index), message)
    }

    /// The file of its first reading.
    pub fn file(&self) -> Option<&std::path::PathBuf> {
        let origin = self.data.origins.get(self.row)?;
        self.data.files.get(origin.file)
    }
}

/// Shows all runs of data sets, in their order.
///
/// Fails where a run goes on behind readings of another one.
pub fn each_stretch(
    data: &[&dyn Passes],
    expected: &Expected<'_>,
    look: &mut dyn FnMut(&Stretch<'_>) -> Result<()>,
) -> Result<()> {
    let mut before = 0;
    for data in data {
        let mut walk = Walk { expected, before, labels: Vec::new(), counter: Counter::new(expected.encoder), rows: 0 };
        data.pass(&mut |shown| walk.shown(shown, look))?;
        before += walk.labels.len();
    }
    Ok(())
}

/// What is known of a data set so far.
struct Walk<'a> {
    expected: &'a Expected<'a>,
    /// Runs of data sets before this one.
    before: usize,
    /// Labels of its runs.
    labels: Vec<String>,
    counter: Counter,
    /// Readings of the present run so far.
    rows: usize,
}

impl Walk<'_> {
    fn shown(&mut self, data: &Dataset, look: &mut dyn FnMut(&Stretch<'_>) -> Result<()>) -> Result<()> {
        let Columns { angle, time, run } = self.expected.columns;
        let (angles, times) = (data.required_numbers(angle)?, data.required_numbers(time)?);
        let sensors = self.expected.sensors.iter().map(|sensor| data.required_numbers(sensor));
        let sensors = sensors.collect::<Result<Vec<&[f64]>>>()?;
        let labels = data.labels(run);
        let mut row = 0;
        while row < data.rows() {
            let end = match labels {
                Some(labels) => row + labels[row..].iter().take_while(|label| **label == labels[row]).count(),
                None => data.rows(),
            };
            self.enter(data, row, labels)?;
            let readings: Vec<&[f64]> = sensors.iter().map(|readings| &readings[row..end]).collect();
            let counted = self.counter.counted(&angles[row..end]);
            look(&Stretch {
                data,
                row,
                run: self.before + self.labels.len() - 1,
                label: self.labels.last().map_or("", String::as_str),
                first: self.rows as u64,
                angles: &counted,
                times: &times[row..end],
                readings: &readings,
            })?;
            self.rows += end - row;
            row = end;
        }
        Ok(())
    }

    /// Begins a run if a row is not of the present one.
    fn enter(&mut self, data: &Dataset, row: usize, labels: Option<&[LabelText]>) -> Result<()> {
        let label = match labels {
            Some(labels) if self.labels.last().is_some_and(|last| labels[row] == *last) => return Ok(()),
            None if !self.labels.is_empty() => return Ok(()),
            Some(labels) => labels[row].to_string(),
            None => {
                let file = data.files.first().and_then(|file| file.file_stem());
                file.map_or(String::new(), |stem| stem.to_string_lossy().into_owned())
            }
        };
        if self.labels.contains(&label) {
            let message = format!("the run `{label}` goes on here, behind readings of another one");
            return Err(data.error_at(DataRow(row), message).help("readings of a run have to follow one another"));
        }
        self.labels.push(label);
        self.counter = Counter::new(self.expected.encoder);
        self.rows = 0;
        Ok(())
    }
}
