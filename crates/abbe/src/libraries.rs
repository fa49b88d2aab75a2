//! The registry that a command works with: built-in plugins and those of the libraries that the user names.

use std::path::{Path, PathBuf};
use std::time::Duration;

use abbe_core::{Error, Registry, Result};
use abbe_files::{LARGEST_TEXT, read_text};
use abbe_plugin::Limits;
use abbe_recipe::Recipe;

/// Where more plugins come from, as the command line says. Libraries are loaded from these files and never searched for.
pub struct Libraries {
    /// Libraries beside those of the recipe.
    pub files: Vec<PathBuf>,
    /// Their plugins run in processes of their own.
    pub isolate: bool,
    /// No library is loaded.
    pub refuse: bool,
}

/// How long an isolated plugin of `--plugin` may work without an answer or a question, s.
const SILENCE_S: f64 = 60.0;

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
            self.add(&mut registry, &library.path, library.sha256.as_deref(), library.isolate).map_err(located)?;
            known.extend(library.path.canonicalize());
        }
        let silence = self.isolate.then_some(SILENCE_S);
        for file in &self.files {
            if !file.canonicalize().is_ok_and(|file| known.contains(&file)) {
                self.add(&mut registry, file, None, silence)?;
            }
        }
        Ok(registry)
    }

    fn add(&self, registry: &mut Registry, file: &Path, pin: Option<&str>, isolate: Option<f64>) -> Result<()> {
        if self.refuse {
            let message = format!("the plugin library {} is not loaded: `--no-dynamic-plugins`", file.display());
            return Err(Error::usage(message));
        }
        let library = match isolate {
            None => abbe_plugin::load(file, pin)?,
            Some(silence) => abbe_plugin::isolated(
                file,
                pin,
                &Limits {
                    program: this_program()?,
                    arguments: ["plugin", "serve"].map(str::to_owned).to_vec(),
                    answer_timeout: Duration::from_secs_f64(silence),
                },
            )?,
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
