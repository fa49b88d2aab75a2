//! What the validators of this crate share.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{
    DataRow, Dataset, Error, Figure, Findings, Fit, Limit, PathItem, Quantity, Result, SettingsError, Validate,
};

/// Limits by key.
pub type Limits = BTreeMap<String, Limit>;

/// A figure that a limit is for: its key in settings, and its name.
pub type Key = (&'static str, &'static str);

/// The keys of figures.
pub fn names(keys: &[Key]) -> Vec<&'static str> {
    keys.iter().map(|(key, _)| *key).collect()
}

/// Refuses limits for anything but these keys, and those that are no numbers.
pub fn check_limits(limits: &Limits, keys: &[&str]) -> Result<(), SettingsError> {
    for (key, limit) in limits {
        let at = [PathItem::Key("limits".to_owned())];
        if !keys.contains(&key.as_str()) {
            let mut error = SettingsError::new(key, format!("there is no figure `{key}` to limit"));
            error.key = true;
            return Err(error.suggest(key, keys.iter().copied()).under(at));
        }
        if !limit.value.is_finite() {
            return Err(SettingsError::new(key, "a finite number was expected").under(at));
        }
    }
    Ok(())
}

/// A figure of a data set, which has no estimate.
pub fn figure(name: String, value: f64, unit: &str) -> Figure {
    Figure { of: None, ..Figure::new("", name, value, unit) }
}

/// The figures of one data set, with the limits that settings state for them.
pub struct Sheet<'a> {
    run: &'a str,
    limits: &'a Limits,
    met: BTreeSet<&'static str>,
    figures: Vec<Figure>,
}

impl<'a> Sheet<'a> {
    /// For the data set of this name.
    pub fn new(run: &'a str, limits: &'a Limits) -> Self {
        Self { run, limits, met: BTreeSet::new(), figures: Vec::new() }
    }

    /// Adds a figure without a limit.
    pub fn tell(&mut self, name: &str, value: f64, unit: &str) -> &mut Figure {
        let place = self.figures.len();
        self.figures.push(figure(format!("{name}[{}]", self.run), value, unit));
        &mut self.figures[place]
    }

    /// Adds a figure in the unit of its key that is not negative, with its standard uncertainty and the limit of its key.
    pub fn limit(&mut self, name: &str, value: f64, uncertainty: Option<f64>, key: &'static str) {
        let limit = self.limits.get(key).copied();
        self.met.insert(key);
        self.tell(name, value, unit(key)).standard_uncertainty = uncertainty;
        if let Some(last) = self.figures.last_mut() {
            last.set_limit(limit);
        }
    }

    /// Adds a figure in the unit of its key that has a sign. A limit is one of its size, which is told then, too.
    pub fn limit_size(&mut self, name: &str, value: f64, uncertainty: Option<f64>, key: &'static str) {
        self.tell(name, value, unit(key)).standard_uncertainty = uncertainty;
        if self.limits.contains_key(key) {
            self.limit(&format!("|{name}|"), value.abs(), uncertainty, key);
        }
    }

    /// The figures. What a limit asks for and the data set does not give is there without a value, which fails.
    pub fn finish(mut self, keys: &[Key]) -> Vec<Figure> {
        for (key, name) in keys {
            if self.limits.contains_key(*key) && !self.met.contains(key) {
                self.limit(name, f64::NAN, None, key);
            }
        }
        self.figures
    }
}

/// The unit that a key names.
fn unit(key: &str) -> &str {
    key.rsplit_once('_').map_or("1", |(_, unit)| unit)
}

/// How a data set is called: the name of its file.
pub fn run_name(data: &Dataset) -> String {
    let stem = data.files.first().and_then(|file| file.file_stem());
    stem.map_or_else(|| "data".to_owned(), |stem| stem.to_string_lossy().into_owned())
}

/// The numbers of a column, all of which are finite.
pub fn finite<'a>(data: &'a Dataset, name: &str, quantity: Quantity) -> Result<&'a [f64]> {
    let numbers = abbe_table::numbers(data, name, quantity)?;
    match numbers.iter().position(|number| !number.is_finite()) {
        Some(row) => Err(data.error_at(DataRow(row), format!("`{name}` is no finite number here"))),
        None => Ok(numbers),
    }
}

/// Whether each row is in the positive direction, by the column `direction` with 1 and -1.
pub fn directions(data: &Dataset) -> Result<Vec<bool>> {
    let labels = abbe_table::labels(data, "direction")?;
    let of = |(row, label): (usize, &String)| match label.trim().parse::<f64>() {
        Ok(1.0) => Ok(true),
        Ok(-1.0) => Ok(false),
        _ => {
            let message = format!("`direction` is {label}; 1 or -1 was expected");
            Err(data.error_at(DataRow(row), message).help("1 in the positive direction, -1 in the negative one"))
        }
    };
    labels.iter().enumerate().map(of).collect()
}

/// The error for a validator without data sets, or with an empty one.
pub fn no_data() -> Error {
    Error::usage("there are no readings to judge").help("name ingest stages under `from`").setting("from")
}

/// An acceptance test of readings, which needs no estimate.
pub trait Acceptance: Send + Sync {
    /// The findings on data sets; there is at least one.
    fn findings(&self, data: &[&Dataset]) -> Result<Findings>;
}

/// The validator of an acceptance test.
pub struct Judge<T>(pub T);

impl<T: Acceptance> Validate for Judge<T> {
    fn accepts_data(&self) -> bool {
        true
    }

    fn accepts_readings(&self) -> bool {
        true
    }

    fn validate(&self, _: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        if data.is_empty() { Err(no_data()) } else { self.0.findings(data) }
    }
}
