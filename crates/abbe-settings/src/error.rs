//! The one error type of the project: what is wrong, where, what was expected, what to do.

use std::fmt;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::settings::PathItem;

/// Shorthand of this crate's results.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Class of an error. It decides the exit status.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Class {
    /// Wrong use, or any error that can be found without reading data rows: exit status 2.
    #[default]
    Use,
    /// An error that is found only with the data or in the run: exit status 1.
    Data,
    /// No error: the work was cancelled. Exit status 130.
    Interrupted,
}

/// A place in a file; lines and columns count from 1.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Place {
    /// The file.
    pub file: PathBuf,
    /// Line, where one line is to blame.
    pub line: Option<usize>,
    /// Column (character) in the line.
    pub column: Option<usize>,
}

/// What is wrong, where, and what to do about it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Error {
    /// Its class.
    pub class: Class,
    /// What is wrong and what was expected, in one sentence.
    pub message: String,
    /// What to do, or the nearest valid spelling.
    #[serde(default)]
    pub help: Option<String>,
    /// Where in which file.
    #[serde(default)]
    pub place: Option<Place>,
    /// The stage of the recipe that is concerned.
    #[serde(default)]
    pub stage: Option<String>,
    /// The setting of that stage that is concerned; the recipe turns it into a place.
    #[serde(default)]
    pub setting: Vec<PathItem>,
    /// Index of the pose that causes the error, among the poses that a model evaluated together. The problem turns it into a
    /// place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose: Option<usize>,
    /// Whether other numbers would fail, too: the code itself failed (it ended, gave no answer, panicked, broke its contract), or
    /// the work has to end. If false, an evaluation failed only for the given numbers and may succeed for others.
    #[serde(rename = "fault", default, skip_serializing_if = "std::ops::Not::not")]
    pub fatal: bool,
    /// The time that the user allowed is over.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub out_of_time: bool,
    /// State of an iteration that does not converge.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub convergence: Option<Box<Convergence>>,
}

/// How an iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Termination {
    /// The last step was below the tolerance.
    Converged,
    /// No step made the residuals smaller, or steps no longer shrank, and the last one was not small.
    NoProgress,
    /// The limit of iterations was reached.
    IterationLimit,
    /// The limit of rounds of robust weights was reached, and they still change.
    RoundLimit,
}

/// State of an iteration at its end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Convergence {
    /// How it ended.
    pub termination: Termination,
    /// Iterations done.
    pub iterations: usize,
    /// Size of the last step, in standard uncertainties of all rows together; none if no step could be computed.
    #[serde(default)]
    pub last_step: Option<f64>,
    /// Tolerance for the size of the last step.
    pub tolerance: f64,
    /// Largest cosine of the angle between the residuals and a column of the derivatives.
    #[serde(default)]
    pub gradient_cosine: Option<f64>,
}

impl Error {
    fn new(class: Class, message: impl Into<String>) -> Self {
        Self {
            class,
            message: message.into(),
            help: None,
            place: None,
            stage: None,
            setting: Vec::new(),
            pose: None,
            fatal: false,
            out_of_time: false,
            convergence: None,
        }
    }

    /// Wrong use of the recipe or of the command.
    pub fn usage(message: impl Into<String>) -> Self {
        Self::new(Class::Use, message)
    }

    /// The work was cancelled. It is fatal, so that code that tries other numbers after an error ends, too.
    pub fn interrupted() -> Self {
        Self::new(Class::Interrupted, "interrupted").fatal()
    }

    /// The time that the user allowed is over. It is fatal, so that code that tries other numbers after an error ends, too.
    pub fn out_of_time(message: impl Into<String>) -> Self {
        Self { out_of_time: true, ..Self::data(message).fatal() }.help("allow more time, or make the recipe smaller")
    }

    /// Wrong or insufficient data.
    pub fn data(message: impl Into<String>) -> Self {
        Self::new(Class::Data, message)
    }

    /// Adds what to do.
    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }

    /// Adds a suggestion if one of `candidates` is close to `given`.
    pub fn suggest<'a>(mut self, given: &str, candidates: impl IntoIterator<Item = &'a str>) -> Self {
        if let Some(near) = nearest(given, candidates) {
            self.help = Some(format!("did you mean `{near}`?"));
        }
        self
    }

    /// Adds the file.
    pub fn in_file(mut self, file: &Path) -> Self {
        self.place = Some(Place { file: file.to_owned(), line: None, column: None });
        self
    }

    /// Adds file, line and, if one is to blame, column.
    pub fn at(mut self, file: &Path, line: usize, column: Option<usize>) -> Self {
        self.place = Some(Place { file: file.to_owned(), line: Some(line), column });
        self
    }

    /// Sets the index of the pose that causes the error, among the poses that were evaluated together.
    pub fn at_pose(mut self, pose: usize) -> Self {
        self.pose = Some(pose);
        self
    }

    /// Marks it as an error that other numbers do not avoid: the code itself failed.
    pub fn fatal(mut self) -> Self {
        self.fatal = true;
        self
    }

    /// Adds the state of the iteration.
    pub fn convergence(mut self, convergence: Convergence) -> Self {
        self.convergence = Some(Box::new(convergence));
        self
    }

    /// Names the setting that causes the error.
    pub fn setting(mut self, name: &str) -> Self {
        self.setting = vec![PathItem::Key(name.to_owned())];
        self
    }

    /// Names the setting that causes the error, by the keys that lead to it.
    pub fn setting_at(mut self, keys: &[&str]) -> Self {
        self.setting = keys.iter().map(|key| PathItem::Key((*key).to_owned())).collect();
        self
    }

    /// Names the stage, unless one is named already.
    pub fn stage(mut self, stage: &str) -> Self {
        self.stage.get_or_insert_with(|| stage.to_owned());
        self
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(place) = &self.place {
            write!(f, "{}", place.file.display())?;
            if let Some(line) = place.line {
                write!(f, ":{line}")?;
            }
            if let Some(column) = place.column {
                write!(f, ":{column}")?;
            }
            write!(f, ": ")?;
        }
        if let Some(stage) = &self.stage {
            write!(f, "stage `{stage}`: ")?;
        }
        write!(f, "{}", self.message)?;
        if let Some(help) = &self.help {
            write!(f, " ({help})")?;
        }
        Ok(())
    }
}

impl std::error::Error for Error {}

/// The candidate that is most similar to `given`, if one is similar enough.
pub fn nearest<'a>(given: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|candidate| (strsim::damerau_levenshtein(&given.to_lowercase(), &candidate.to_lowercase()), candidate))
        // Short names of one or two letters are all similar: for these only upper and lower case may differ.
        .filter(|(distance, candidate)| *distance <= candidate.chars().count().max(given.chars().count()) / 3)
        .min()
        .map(|(_, candidate)| candidate)
}
