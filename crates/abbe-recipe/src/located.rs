//! Where errors of stages stand.

use abbe_core::{Error, PathItem, Place, SettingsError, nearest, path_text};
use serde_json::Value;

use crate::document::At;
use crate::{PLAN, Recipe};

impl Recipe {
    /// Gives an error about a setting under `plan` its place, unless it has one or is about a stage.
    pub fn locate_plan(&self, error: Error) -> Error {
        if error.stage.is_some() {
            return self.locate(error);
        }
        let error = match self.names_file(&error) {
            true => with_file(error),
            false if error.place.is_some() => return error,
            false => error,
        };
        let path = [&[PathItem::Key(PLAN.to_owned())], error.setting.as_slice()].concat();
        self.document.locate(error, &path, At::Value)
    }

    pub(crate) fn plan_error(&self, error: SettingsError) -> Error {
        let at = if error.key { At::Key } else { At::Value };
        let path = [&[PathItem::Key(PLAN.to_owned())], error.path.as_slice()].concat();
        let mut located = self.document.locate(Error::usage(error.message), &path, at);
        located.help = error.help;
        located
    }

    /// Gives an error about a stage (and a setting) its file, line and column, unless it has a place. What a setting names and a file
    /// as a whole does not have (a column) stands at the setting; the message has the file, too.
    pub fn locate(&self, error: Error) -> Error {
        let Some(stage) = error.stage.clone() else { return error };
        let error = match self.names_file(&error) {
            true => with_file(error),
            false if error.place.is_some() => return error,
            false => error,
        };
        let setting = error.setting.clone();
        self.place(error, &stage, &setting, At::Value)
    }

    /// Whether an error is about a setting and another file than the recipe as a whole.
    fn names_file(&self, error: &Error) -> bool {
        let is_whole = |place: &Place| place.line.is_none() && place.file != self.path;
        !error.setting.is_empty() && error.place.as_ref().is_some_and(is_whole)
    }

    /// What a plugin says about the settings of a stage, with its place: the wrong key, the wrong value or, if a
    /// setting is missing, the name of the stage.
    pub fn settings_error(&self, stage: &str, error: SettingsError) -> Error {
        let at = if error.key { At::Key } else { At::Value };
        let message = match path_text(&error.path) {
            name if error.key || name.is_empty() => error.message.clone(),
            name => format!("{name}: {}", error.message),
        };
        let mut located = self.place(Error::usage(message).stage(stage), stage, &error.path, at);
        let is_missing = error.message.starts_with("the setting `") && error.message.ends_with("` is missing");
        let listed = "`abbe plugins --json` shows the settings of every plugin, with an example";
        located.help =
            self.reference_near(stage, &error).or(error.help).or_else(|| is_missing.then(|| listed.to_owned()));
        located.setting = error.path;
        located.class = error.class;
        located
    }

    /// A similar key among those that are not passed on to the plugin, which the plugin therefore cannot suggest.
    fn reference_near(&self, stage: &str, error: &SettingsError) -> Option<String> {
        let ([PathItem::Key(key)], true) = (error.path.as_slice(), error.key) else { return None };
        let near = nearest(key, self.reserved_keys.get(stage)?.iter().copied())?;
        Some(format!("did you mean `{near}`?"))
    }

    fn place(&self, error: Error, stage: &str, setting: &[PathItem], at: At) -> Error {
        let Some(origin) = self.origins.get(stage) else { return error.in_file(&self.path) };
        if let Some((path, rest)) = origin.expanded(setting) {
            return self.document.locate(error, &[path, rest].concat(), at);
        }
        let path = [&[PathItem::Key("stages".to_owned()), PathItem::Key(stage.to_owned())], setting].concat();
        let known = self.document.known(&path);
        // A map of the recipe is merged with that of the file; anything else, and all in a list, replaces the file's.
        let merged = known < path.len()
            && path[..known].iter().all(|item| matches!(item, PathItem::Key(_)))
            && self.document.get(&path[..known]).is_some_and(Value::is_object);
        match &origin.file {
            Some(file) if merged && file.known(setting) + 2 > known => file.locate(error, setting, at),
            _ if known <= 2 => self.document.locate(error, &path[..2], At::Key),
            _ => self.document.locate(error, &path, at),
        }
    }
}

/// An error whose message names the setting and the file, without a place.
fn with_file(error: Error) -> Error {
    let file = error.place.as_ref().map(|place| format!("{}: ", place.file.display())).unwrap_or_default();
    let message = format!("{}: {file}{}", path_text(&error.setting), error.message);
    Error { message, place: None, ..error }
}
