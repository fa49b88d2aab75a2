//! The command line of Abbe: `run`, `check`, `simulate`, `plugins`, `schema`.
//!
//! Exit status: 0 all verdicts pass; 1 what only the data or the run show; 2 wrong use, or anything that can be found
//! without reading data rows; 3 a verdict failed.

mod failure;
mod number;
mod summary;
mod table;
mod trust;

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use abbe_core::{Class, Error, Origin, Registry, Result};
use abbe_engine::{Event, Outcome, Simulated, prepare};
use clap::{Parser, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};

use abbe_bundle as _;

/// Calibrates machine tools and coordinate measuring machines from declared recipes.
#[derive(Parser)]
#[command(name = "abbe", version, about)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
    /// Say more about what is going on.
    #[arg(short, long, global = true)]
    verbose: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Run a recipe: estimates, verdicts, exported files.
    Run {
        /// The recipe.
        recipe: PathBuf,
        /// Folder under which the results go, in a folder named after the recipe.
        #[arg(long, default_value = "out")]
        out: PathBuf,
        /// Print the summary as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Check a recipe without running it, and tell what its fits could determine.
    Check {
        /// The recipe.
        recipe: PathBuf,
        /// Print the findings as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Measure the programme of a recipe on a virtual machine, and write a folder in which the same recipe runs.
    Simulate {
        /// The recipe.
        recipe: PathBuf,
        /// JSON file with the true values and the noise.
        #[arg(long)]
        truth: PathBuf,
        /// Seed of the random numbers: the same seed gives the same data.
        #[arg(long)]
        seed: u64,
        /// Folder that is written; it must not exist or be empty.
        #[arg(long)]
        out: PathBuf,
        /// The model stage that is simulated, where the estimates use several.
        #[arg(long)]
        machine: Option<String>,
    },
    /// List the plugins.
    Plugins {
        /// Print them as JSON, with the schemas and examples of their settings.
        #[arg(long)]
        json: bool,
    },
    /// Print the JSON Schema of recipes, for editors.
    Schema,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let level = if arguments.verbose { tracing::Level::INFO } else { tracing::Level::WARN };
    tracing_subscriber::fmt().with_writer(io::stderr).with_max_level(level).without_time().with_target(false).init();
    let machine = matches!(arguments.command, Command::Run { json: true, .. } | Command::Check { json: true, .. });
    match dispatch(arguments.command) {
        Ok((text, status)) => match io::stdout().lock().write_all(text.as_bytes()) {
            Ok(()) => ExitCode::from(status),
            // Whoever reads our output has seen enough.
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => ExitCode::from(status),
            Err(error) => {
                eprintln!("the output cannot be written: {error}");
                ExitCode::from(1)
            }
        },
        Err(error) => {
            if machine {
                println!("{}", failure::json(&error));
            } else {
                eprint!("{}", failure::text(&error));
            }
            ExitCode::from(match error.class {
                Class::Use => 2,
                Class::Data => 1,
            })
        }
    }
}

/// Carries out a command; gives what to print and the exit status.
fn dispatch(command: Command) -> Result<(String, u8)> {
    let registry = Registry::built_in()?;
    match command {
        Command::Run { recipe, out, json } => {
            let prepared = prepare(&recipe, &registry)?;
            Outcome::can_write(&out, &prepared.recipe.id)?;
            let bar = ProgressBar::new(0).with_style(style());
            let outcome = prepared.run(&|event| show(&bar, event))?;
            bar.finish_and_clear();
            let folder = outcome.write(&out)?;
            let status = if outcome.passes() { 0 } else { 3 };
            let text = match json {
                true => pretty(&summary::json(&outcome, &folder))?,
                false => summary::text(&prepared.recipe.name, &outcome, &folder),
            };
            Ok((text, status))
        }
        Command::Check { recipe, json } => {
            let prepared = prepare(&recipe, &registry)?;
            let planned = prepared.check()?;
            let status = if planned.iter().all(|planned| planned.accepted) { 0 } else { 1 };
            let text = match json {
                true => pretty(&summary::planned_json(&planned))?,
                false => summary::planned_text(&prepared.recipe, &planned),
            };
            Ok((text, status))
        }
        Command::Simulate { recipe, truth, seed, out, machine } => {
            let prepared = prepare(&recipe, &registry)?;
            Simulated::can_write(&out)?;
            let simulated = prepared.simulate(&truth, seed, machine.as_deref())?;
            simulated.write(&out)?;
            Ok((simulated_text(&simulated, &out), 0))
        }
        Command::Plugins { json } => match json {
            true => Ok((pretty(&plugins_json(&registry))?, 0)),
            false => Ok((plugins_text(&registry), 0)),
        },
        Command::Schema => Ok((pretty(&abbe_recipe::schema(&registry))?, 0)),
    }
}

/// What was simulated, and how to go on.
fn simulated_text(simulated: &Simulated, out: &Path) -> String {
    let mut text = "Simulated\n".to_owned();
    for file in &simulated.data {
        text.push_str(&format!("  {}: {} rows measured, {} copied\n", file.file.display(), file.measured, file.copied));
    }
    for file in &simulated.not_simulated {
        let readers: Vec<&str> = file.read_by.iter().map(String::as_str).collect();
        let readers = if readers.is_empty() { "no stage".to_owned() } else { format!("{} only", readers.join(", ")) };
        text.push_str(&format!("  not simulated: {} (read by {readers})\n", file.file.display()));
    }
    text.push_str("\nVaried\n");
    simulated.varied.iter().for_each(|line| text.push_str(&format!("  {line}\n")));
    let recipe = out.join(&simulated.recipe);
    text.push_str(&format!("\nWritten: {}\nGo on with: abbe run {}\n", out.display(), recipe.display()));
    text
}

/// Progress on a terminal; nothing in a pipe.
fn show(bar: &ProgressBar, event: Event<'_>) {
    let Event::Started { stage, kind, done, all } = event;
    bar.set_length(all as u64);
    bar.set_position(done as u64);
    bar.set_message(format!("{kind} {stage}"));
    bar.tick();
}

fn style() -> ProgressStyle {
    ProgressStyle::with_template("{pos}/{len} {msg}").unwrap_or_else(|_| ProgressStyle::default_bar())
}

fn pretty(value: &Value) -> Result<String> {
    serde_json::to_string_pretty(value)
        .map(|text| text + "\n")
        .map_err(|error| Error::data(format!("the output cannot be written: {error}")))
}

fn origin(origin: &Origin) -> String {
    match origin {
        Origin::BuiltIn => "built-in".to_owned(),
        Origin::Library { file, sha256 } => format!("{} ({sha256})", file.display()),
    }
}

fn plugins_text(registry: &Registry) -> String {
    let mut rows = vec![["kind", "name", "origin", "what it does"].map(str::to_owned).to_vec()];
    rows.extend(registry.iter().map(|plugin| {
        vec![plugin.kind().to_string(), plugin.name.to_string(), origin(&plugin.origin), plugin.about.to_string()]
    }));
    table::text(&rows, &[])
}

fn plugins_json(registry: &Registry) -> Value {
    let plugins = registry.iter().map(|plugin| {
        json!({
            "kind": plugin.kind().key(),
            "name": plugin.name,
            "origin": origin(&plugin.origin),
            "about": plugin.about,
            "schema": plugin.schema.get(),
            "example": plugin.example.get(),
        })
    });
    Value::Array(plugins.collect())
}
