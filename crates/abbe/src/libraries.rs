//! The registry that a command works with: built-in plugins and those of the libraries that the user names.

use std::path::{Path, PathBuf};
use std::time::Duration;

use abbe_core::{Error, Registry, Result};
use abbe_files::{LARGEST_TEXT, read_text};
use abbe_plugin::{Limits, MEMORY_LIMIT_MIB};
use abbe_recipe::{Isolation, Recipe};

/// Where more plugins come from, as the command line says. Libraries are loaded from these files and never searched for.
pub struct Libraries {
    /// Libraries beside those of the recipe.
    pub files: Vec<PathBuf>,
    /// Plugins of all libraries run in processes of their own, also of pinned ones.
    pub isolate: bool,
    /// Libraries that nobody pins are loaded into the program.
    pub trust: bool,
    /// No library is loaded.
    pub refuse: bool,
}

/// This very program, to be started again.
pub fn this_program() -> Result<PathBuf> {
    std::env::current_exe().map_err(|error| Error::data(format!("this program cannot be found: {error}")))
}

impl Libraries {
    /// The built-in plugins, and those of the libraries that the command line and the recipe name.
    pub fn registry(&self, recipe: Option<&Path>) -> Result<Registry> {
        let mut registry = Registry::built_in()?;
        let mut known: Vec<PathBuf> = Vec::new();
        // `prepare` reports a recipe that cannot be read.
        let named = recipe.and_then(|recipe| Some((recipe, read_text(recipe, LARGEST_TEXT).ok()?)));
        let named = named.map(|(recipe, text)| Recipe::libraries(recipe, &text)).transpose()?.unwrap_or_default();
        for library in named {
            let located = |mut error: Error| {
                error.place = error.place.or(library.place.clone());
                error
            };
            let isolate = library.isolate.filter(|isolation| isolation.is_asked_for || !self.trust);
            let isolate = isolate.or(self.isolate.then(Isolation::default));
            self.add(&mut registry, &library.path, library.sha256.as_deref(), isolate).map_err(located)?;
            known.extend(library.path.canonicalize());
        }
        let isolate = (self.isolate || !self.trust).then(Isolation::default);
        for file in &self.files {
            if !file.canonicalize().is_ok_and(|file| known.contains(&file)) {
                self.add(&mut registry, file, None, isolate)?;
            }
        }
        Ok(registry)
    }

    fn add(&self, registry: &mut Registry, file: &Path, pin: Option<&str>, isolate: Option<Isolation>) -> Result<()> {
        if self.refuse {
            let message = format!("the plugin library {} is not loaded: `--no-dynamic-plugins`", file.display());
            return Err(Error::usage(message));
        }
        let library = match isolate {
            None => abbe_plugin::load(file, pin)?,
            Some(isolation) => {
                if let Some(missing) = abbe_plugin::missing() {
                    tracing::warn!("{}: {missing}", file.display());
                }
                abbe_plugin::isolated(
                    file,
                    pin,
                    &Limits {
                        program: this_program()?,
                        arguments: ["plugin", "serve"].map(str::to_owned).to_vec(),
                        answer_timeout: Duration::from_secs_f64(isolation.time_limit_s),
                        total_time: Duration::from_secs_f64(isolation.total_time_limit_s),
                        memory_limit_mib: isolation.memory_limit_mib.unwrap_or(MEMORY_LIMIT_MIB),
                    },
                )?
            }
        };
        tracing::info!(
            "{} {}: {} plugins from {}",
            library.name,
            library.version,
            library.plugins.len(),
            file.display()
        );
        library.register(registry)
    }
}
