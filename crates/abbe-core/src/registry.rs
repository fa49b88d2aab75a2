//! The registry: every plugin, built in or loaded, under its kind and name.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::stage::{Artefact, Estimate, Export, Ingest, Model, Validate};
use abbe_settings::{Error, Result, nearest};
use abbe_settings::{SettingsError, ranges};

/// The six kinds of stage, in the order in which data flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Files to data sets.
    Ingest,
    /// Data sets to observations.
    Artefact,
    /// Machine description to kinematic model.
    Model,
    /// Problem to calibration.
    Estimate,
    /// Calibration to verdict.
    Validate,
    /// Calibration to files.
    Export,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 6] =
        [Self::Ingest, Self::Artefact, Self::Model, Self::Estimate, Self::Validate, Self::Export];

    /// The key that declares a stage of this kind in a recipe.
    pub fn key(self) -> &'static str {
        match self {
            Self::Ingest => "ingest",
            Self::Artefact => "artefact",
            Self::Model => "model",
            Self::Estimate => "estimate",
            Self::Validate => "validate",
            Self::Export => "export",
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.key())
    }
}

/// What a stage gets, beside its settings, when it is built.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Context {
    /// Folder that relative paths in the settings start from.
    pub base: PathBuf,
}

impl Context {
    /// A path of the settings, resolved from the base folder.
    pub fn path(&self, path: &str) -> PathBuf {
        self.base.join(Path::new(path))
    }
}

/// The function that a loaded plugin is built with.
type DynamicBuild<T> = dyn Fn(&Value, &Context) -> Result<Box<T>, SettingsError> + Send + Sync;

/// Builds a stage from its settings.
pub enum Constructor<T: ?Sized> {
    /// Of a built-in plugin.
    Static(fn(&Value, &Context) -> Result<Box<T>, SettingsError>),
    /// Of a loaded one.
    Dynamic(Arc<DynamicBuild<T>>),
}

impl<T: ?Sized> Constructor<T> {
    /// Builds the stage.
    pub fn build(&self, settings: &Value, context: &Context) -> Result<Box<T>, SettingsError> {
        match self {
            Self::Static(build) => build(settings, context),
            Self::Dynamic(build) => build(settings, context),
        }
    }
}

/// The constructor of a plugin, which also says its kind.
pub enum Build {
    /// An ingest plugin.
    Ingest(Constructor<dyn Ingest>),
    /// An artefact plugin.
    Artefact(Constructor<dyn Artefact>),
    /// A model plugin.
    Model(Constructor<dyn Model>),
    /// An estimator.
    Estimate(Constructor<dyn Estimate>),
    /// A validator.
    Validate(Constructor<dyn Validate>),
    /// An exporter.
    Export(Constructor<dyn Export>),
}

/// A JSON value that a plugin provides.
pub enum Provider {
    /// Made when first asked for, once in a process.
    Static(fn() -> Value),
    /// Handed over when the plugin was loaded.
    Value(Value),
}

impl Provider {
    /// The value.
    pub fn get(&self) -> &Value {
        match self {
            Self::Static(make) => made(*make),
            Self::Value(value) => value,
        }
    }
}

/// What a function gives, which is asked once. The record of a built-in plugin is constant, so it cannot keep it.
fn made(make: fn() -> Value) -> &'static Value {
    type Values = BTreeMap<fn() -> Value, &'static Value>;
    static MADE: Mutex<Values> = Mutex::new(BTreeMap::new());
    let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
    made.entry(make).or_insert_with(|| Box::leak(Box::new(make())))
}

/// Where a plugin comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    /// Linked into the program.
    BuiltIn,
    /// Loaded from a library.
    Library {
        /// Its file.
        file: PathBuf,
        /// SHA-256 of the file.
        sha256: String,
    },
}

/// What an estimate is made from. It decides which keys the estimate stage has in a recipe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EstimateSource {
    /// Measurements on a machine (`machine`, `observations`, `parameters`), or another estimate that it analyses (`of`).
    #[default]
    Measurements,
    /// Another estimate, which it analyses (`of`).
    Analysis,
    /// Stated values of the parameters of a machine (`machine`).
    Statement,
    /// A calibration that was made outside this recipe. It contains its machine.
    Calibration,
    /// Several other estimates (`of`), and a `machine` unless the machine of the first of them has all parameters that they
    /// know.
    Combination,
    /// Readings that are no geometry (`from`): temperatures, displacement sensors, tool setters. There is no machine.
    Readings,
}

/// One record of the registry, the same for built-in and for loaded plugins.
pub struct Plugin {
    /// The name that recipes use.
    pub name: Cow<'static, str>,
    /// One line that says what it does.
    pub about: Cow<'static, str>,
    /// Text of its reference page beside the settings, as Markdown with headings of level 2: when to use it, equation, notes,
    /// source. May be empty.
    pub reference: &'static str,
    /// The version of the program or library that it is part of.
    pub version: Cow<'static, str>,
    /// Where it comes from.
    pub origin: Origin,
    /// JSON Schema of its settings.
    pub schema: Provider,
    /// Settings that it can be built from.
    pub example: Provider,
    /// Its constructor.
    pub build: Build,
    /// What its estimates are made from, if it is an estimator; [`EstimateSource::Readings`] for a validator that judges data by
    /// itself, so that it needs no estimate.
    pub estimate_source: EstimateSource,
}

impl EstimateSource {
    /// Whether an estimate may analyse another one.
    pub fn may_analyse(self) -> bool {
        matches!(self, Self::Measurements | Self::Analysis)
    }
}

impl Plugin {
    /// A built-in plugin, for `inventory::submit!`.
    pub const fn built_in(
        name: &'static str,
        about: &'static str,
        schema: fn() -> Value,
        example: fn() -> Value,
        build: Build,
    ) -> Self {
        Self {
            name: Cow::Borrowed(name),
            about: Cow::Borrowed(about),
            reference: "",
            version: Cow::Borrowed(env!("CARGO_PKG_VERSION")),
            origin: Origin::BuiltIn,
            schema: Provider::Static(schema),
            example: Provider::Static(example),
            build,
            estimate_source: EstimateSource::Measurements,
        }
    }

    /// Gives the text of its reference page.
    pub const fn with_reference(mut self, reference: &'static str) -> Self {
        self.reference = reference;
        self
    }

    /// Sets what its estimates are made from.
    pub const fn with_estimate_source(mut self, estimate_source: EstimateSource) -> Self {
        self.estimate_source = estimate_source;
        self
    }

    /// Its kind.
    pub fn kind(&self) -> Kind {
        match self.build {
            Build::Ingest(_) => Kind::Ingest,
            Build::Artefact(_) => Kind::Artefact,
            Build::Model(_) => Kind::Model,
            Build::Estimate(_) => Kind::Estimate,
            Build::Validate(_) => Kind::Validate,
            Build::Export(_) => Kind::Export,
        }
    }
}

inventory::collect!(Plugin);

/// Registers a built-in plugin: kind, name, the line that says what it does, type of its settings, function that gives an
/// example of them, function that builds the stage from settings and context, and the file with the text of its reference
/// page. Last, for estimators, what estimates are made of ([`EstimateSource`]) if that is not measurements.
///
/// ```ignore
/// abbe_core::register!(
///     Validate,
///     "largest",
///     "the largest residual",
///     Settings,
///     || json!({ "limit_um": 10 }),
///     build,
///     "../reference/validate-largest.md",
/// );
///
/// fn build(settings: Settings, context: &Context) -> Result<Box<dyn Validate>, SettingsError> {
///     Ok(Box::new(Largest { settings }))
/// }
/// ```
#[macro_export]
macro_rules! register {
    ($kind:ident, $name:literal, $about:literal, $settings:ty, $example:expr, $build:path, $page:literal
        $(, $estimate_source:expr)? $(,)?) => {
        $crate::inventory::submit! {
            $crate::Plugin::built_in(
                $name,
                $about,
                $crate::schema_of::<$settings>,
                $example,
                $crate::Build::$kind($crate::Constructor::Static(|settings, context| {
                    $build($crate::from_settings::<$settings>(settings)?, context)
                })),
            )
            .with_reference(include_str!($page))
            $(.with_estimate_source($estimate_source))?
        }
    };
}

/// All plugins that a run can use, sorted by kind and name.
pub struct Registry {
    plugins: Vec<Entry>,
}

enum Entry {
    BuiltIn(&'static Plugin),
    Loaded(Box<Plugin>),
}

impl Entry {
    fn plugin(&self) -> &Plugin {
        match self {
            Self::BuiltIn(plugin) => plugin,
            Self::Loaded(plugin) => plugin,
        }
    }
}

impl Registry {
    /// The plugins linked into the program; two of the same kind and name are refused.
    pub fn built_in() -> Result<Self> {
        let mut registry = Self { plugins: Vec::new() };
        for plugin in inventory::iter::<Plugin> {
            registry.insert(Entry::BuiltIn(plugin))?;
        }
        Ok(registry)
    }

    /// Adds a loaded plugin; a name that is taken is refused.
    pub fn add(&mut self, mut plugin: Plugin) -> Result<()> {
        if let Provider::Value(schema) = &mut plugin.schema {
            ranges::complete(schema);
        }
        self.insert(Entry::Loaded(Box::new(plugin)))
    }

    fn insert(&mut self, entry: Entry) -> Result<()> {
        let order = |plugin: &Plugin| (plugin.kind(), plugin.name.to_string());
        let key = order(entry.plugin());
        match self.plugins.binary_search_by_key(&key, |other| order(other.plugin())) {
            Ok(_) => Err(Error::usage(format!("there are two {} plugins named `{}`", key.0, key.1))),
            Err(place) => {
                self.plugins.insert(place, entry);
                Ok(())
            }
        }
    }

    /// All plugins, sorted.
    pub fn iter(&self) -> impl Iterator<Item = &Plugin> {
        self.plugins.iter().map(Entry::plugin)
    }

    /// The plugin of that kind and name, or an error with the nearest one.
    pub fn find(&self, kind: Kind, name: &str) -> Result<&Plugin, SettingsError> {
        self.iter().find(|plugin| plugin.kind() == kind && plugin.name == name).ok_or_else(|| {
            let names: Vec<&str> =
                self.iter().filter(|plugin| plugin.kind() == kind).map(|plugin| plugin.name.as_ref()).collect();
            let error = SettingsError::new(kind.key(), format!("there is no {kind} plugin `{name}`"));
            match nearest(name, names.iter().copied()) {
                Some(near) => error.help(format!("did you mean `{near}`?")),
                None => error.help(format!("there are: {}", names.join(", "))),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[test]
    fn a_schema_is_made_when_it_is_first_asked_for_and_once() {
        static MADE: AtomicUsize = AtomicUsize::new(0);
        let schema = || Value::from(MADE.fetch_add(1, Ordering::Relaxed));
        let build = Build::Ingest(Constructor::Static(|_, _| Err(SettingsError::new("", "nothing"))));
        let plugin = Plugin::built_in("counted", "counts", schema, || Value::Null, build);
        assert_eq!(MADE.load(Ordering::Relaxed), 0);
        assert_eq!([plugin.schema.get(), plugin.schema.get()], [&Value::from(0); 2]);
        assert_eq!(MADE.load(Ordering::Relaxed), 1);
    }
}
