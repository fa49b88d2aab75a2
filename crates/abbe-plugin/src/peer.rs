//! One object of the other side, which is a library's table of functions or another process.

use std::any::Any;
use std::fmt::Display;
use std::sync::Arc;

use abbe_core::{
    Class, Convergence, Equations, Error, PathItem, Place, Poses, RowBatch, SettingsError, Variable, from_json,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::abi::{ABBE_FAILED, ABBE_FAILED_WITH_DETAILS, ABBE_PANICKED, ABBE_UNKNOWN_METHOD};
use crate::served::Served;

/// An object of the other side.
pub(crate) trait Peer: Send + Sync {
    /// Whose object it is, for messages: "the plugin `x` of libx.so".
    fn who(&self) -> &str;

    /// Carries out a method.
    fn call(&self, method: u32, text: &str, objects: &[Arc<Served>]) -> Result<Answer, Failure>;

    /// Poses of a batch; `out` has the right size and is zero.
    fn poses(&self, statuses: &[f64], values: &[f64], wanted: &[Variable], out: &mut Poses) -> Result<(), Failure>;

    /// Equations of some rows.
    fn equations(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<(), Failure>;

    /// The concrete type. It shows whether the object belongs to the side to which it is sent; it is then sent as that
    /// side's own object.
    fn as_any(&self) -> &dyn Any;
}

/// What a method answers.
pub(crate) struct Answer {
    pub text: String,
    #[cfg_attr(not(feature = "host"), allow(dead_code, reason = "a vendor's side asks for no stages"))]
    pub objects: Vec<Received>,
}

/// An object that was received: one of the other side, or one of ours that returns.
#[derive(Clone)]
pub(crate) enum Received {
    Remote(Arc<dyn Peer>),
    Local(Arc<Served>),
}

/// Why a call failed: status and text of the ABI.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Failure {
    pub status: u32,
    pub text: String,
}

/// The text of [`ABBE_FAILED_WITH_DETAILS`].
#[derive(Default, Deserialize, JsonSchema)]
pub(crate) struct Details {
    /// What is wrong, in one sentence.
    message: String,
    /// What to do about it.
    #[serde(default)]
    help: Option<String>,
    /// Whether the use is wrong or the data are.
    #[serde(default)]
    class: Option<Class>,
    /// Where it stands in a file.
    #[serde(default)]
    place: Option<Place>,
    /// The stage that it is about.
    #[serde(default)]
    stage: Option<String>,
    /// The setting of a stage that it is about: keys and indices.
    #[serde(default)]
    setting: Vec<PathItem>,
    /// The pose that failed, by its index among those that were asked for together.
    #[serde(default)]
    pose: Option<usize>,
    /// Whether the code itself failed, so that other numbers would fail, too.
    #[serde(rename = "fault", default)]
    fatal: bool,
    /// The time that the user allowed is over.
    #[serde(default)]
    out_of_time: bool,
    /// State of an iteration that does not converge.
    #[serde(default)]
    convergence: Option<Box<Convergence>>,
    /// Where the wrong setting is among the settings that were given: keys and indices.
    #[serde(default)]
    path: Vec<PathItem>,
    /// Whether the name of that setting is wrong, and not its value.
    #[serde(default)]
    #[cfg_attr(not(feature = "host"), allow(dead_code, reason = "a vendor's side asks for no stages"))]
    key: bool,
}

/// The error for a violation of the interface; names the other side. No setting is the cause.
pub(crate) fn broken(who: &str, what: impl Display) -> Error {
    Error::data(format!("{who} {what}")).fatal()
}

impl Failure {
    /// A violation of the interface; names the other side.
    pub fn of(who: &str, what: impl Display) -> Self {
        broken(who, what).into()
    }

    fn details(self, who: &str) -> Details {
        let refusal = |message| Details { message, ..Details::default() };
        let fatal = |what: String| Details { message: format!("{who} {what}"), fatal: true, ..Details::default() };
        match self.status {
            ABBE_FAILED if self.text.trim().is_empty() => refusal(format!("{who} failed without a message")),
            ABBE_FAILED => refusal(self.text),
            ABBE_FAILED_WITH_DETAILS => from_json(&self.text)
                .unwrap_or_else(|error| fatal(format!("failed with details that cannot be read: {error}"))),
            ABBE_PANICKED => fatal(format!("panicked: {}", self.text)),
            ABBE_UNKNOWN_METHOD => fatal(format!("lacks a function: {}", self.text)),
            other => fatal(format!("gave the unknown status {other}: {}", self.text)),
        }
    }

    /// The error of a run.
    pub fn error(self, who: &str) -> Error {
        let details = self.details(who);
        let mut error = match details.class {
            Some(Class::Use) => Error::usage(details.message),
            _ => Error::data(details.message),
        };
        (error.help, error.place, error.stage) = (details.help, details.place, details.stage);
        (error.pose, error.fatal, error.convergence) = (details.pose, details.fatal, details.convergence);
        error.out_of_time = details.out_of_time;
        error.setting = if details.setting.is_empty() { details.path } else { details.setting };
        error
    }

    /// The error of settings: of the class "use" if the plugin refuses them, of the class "data" if the plugin itself fails.
    /// A class that the plugin states counts first.
    #[cfg(feature = "host")]
    pub fn settings_error(self, who: &str) -> SettingsError {
        let refused = matches!(self.status, ABBE_FAILED | ABBE_FAILED_WITH_DETAILS);
        let details = self.details(who);
        let path = if details.path.is_empty() { details.setting } else { details.path };
        let class = details.class.unwrap_or(if refused { Class::Use } else { Class::Data });
        SettingsError { path, key: details.key, message: details.message, help: details.help, class }
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let text = serde_json::to_string(&error).unwrap_or_else(|_| json!({ "message": error.message }).to_string());
        Self { status: ABBE_FAILED_WITH_DETAILS, text }
    }
}

impl From<SettingsError> for Failure {
    fn from(error: SettingsError) -> Self {
        let text = serde_json::to_string(&error).unwrap_or_else(|_| json!({ "message": error.message }).to_string());
        Self { status: ABBE_FAILED_WITH_DETAILS, text }
    }
}

impl From<serde_json::Error> for Failure {
    fn from(error: serde_json::Error) -> Self {
        Error::data(format!("a text that crosses the border cannot be read: {error}")).fatal().into()
    }
}
