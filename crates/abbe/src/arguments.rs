//! The command line: commands, their arguments and options.

use std::path::PathBuf;
use std::time::Duration;

use abbe_engine::Control;
use clap::{Parser, Subcommand};

use crate::interrupt::seconds;
use crate::progress::Progress;
#[cfg(feature = "serve")]
use crate::serve;
use crate::{compensate, correct, data, explain, fleet, history, machine, new, planning, test};

/// Calibrates machine tools and coordinate measuring machines from declared recipes.
#[derive(Parser)]
#[command(name = "abbe", version, about)]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
    /// Print all results of a run and not their summary, and more messages about the work.
    #[arg(short, long, global = true)]
    pub verbose: bool,
    /// A library with more plugins, in addition to those that a recipe names.
    #[arg(long = "plugin", global = true, value_name = "FILE")]
    pub plugins: Vec<PathBuf>,
    /// Run the plugins of all libraries in separate processes; those of libraries that no recipe pins are run so anyway.
    #[arg(long, global = true, conflicts_with = "trust_plugins")]
    pub isolate_plugins: bool,
    /// Load libraries into this program although nobody pins them.
    #[arg(long, global = true)]
    pub trust_plugins: bool,
    /// Refuse to load any library.
    #[arg(long, global = true)]
    pub no_dynamic_plugins: bool,
}

#[derive(Subcommand)]
pub enum Command {
    /// Run a recipe: estimates, verdicts, exported files.
    Run {
        /// The recipe.
        recipe: PathBuf,
        /// Folder for results: they are written into a folder in it that has the name of the recipe.
        #[arg(long, default_value = "out")]
        out: PathBuf,
        /// Print the summary as JSON.
        #[arg(long)]
        json: bool,
        /// How progress is shown, on standard error.
        #[arg(long, value_enum, default_value_t)]
        progress: Progress,
        /// Time limit of the run, seconds. Stages that are not finished by then fail; finished results are written.
        #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
        time_limit: Option<Duration>,
    },
    /// Make the page about a run again, or one page about several runs or calibrations beside each other.
    Report {
        /// Folders that `abbe run` wrote, or calibrations.
        #[arg(required = true, value_name = "FOLDER|CALIBRATION")]
        results: Vec<PathBuf>,
        /// The file to write: `.html`, `.pdf` (printed by an installed browser), `.md` (Markdown, for comments of a CI) or `.csv` (all
        /// parameters and figures). Nothing is replaced.
        #[arg(long, default_value = "report.html")]
        out: PathBuf,
    },
    /// Run recipes and compare what they find with what is expected of them, a file beside each.
    Test(Box<test::Test>),
    /// Check a recipe without running it, and report what its fits can determine.
    Check {
        /// The recipe.
        recipe: PathBuf,
        /// Print the findings as JSON.
        #[arg(long)]
        json: bool,
        /// Print all findings: what is determined worst, correlations, uncertainty budgets.
        #[arg(long, conflicts_with = "json")]
        explain: bool,
        /// Time limit, seconds. A check that is not at its end by then fails.
        #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
        time_limit: Option<Duration>,
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
        /// Folder to write. It must be empty, or not exist.
        #[arg(long)]
        out: PathBuf,
        /// The model stage to simulate, if the estimates use several.
        #[arg(long)]
        machine: Option<String>,
        /// Time limit, seconds. What is not simulated by then fails, and nothing is written.
        #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
        time_limit: Option<Duration>,
    },
    /// Choose which measurements to make, as the key `plan` of a recipe says, and write the data file to fill in.
    Plan {
        /// The recipe.
        recipe: PathBuf,
        /// Folder to write. It must be empty, or not exist. Without it the plan is only printed.
        #[arg(long)]
        out: Option<PathBuf>,
        /// The control that gets the measuring program, instead of that of the recipe: linuxcnc, fanuc, siemens, heidenhain or grbl.
        #[arg(long, value_name = "CONTROL", value_parser = planning::control)]
        program: Option<Control>,
        /// Print the plan as JSON.
        #[arg(long)]
        json: bool,
        /// Time limit, seconds. A plan that is not made by then fails, and nothing is written.
        #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
        time_limit: Option<Duration>,
    },
    /// Begin a calibration: write a machine file, an artefact, the touches to make and a recipe, for a chain of axes.
    New(new::New),
    /// Show what is understood of data files: layout, columns, ranges, gaps, and the settings that they seem to need.
    Data(data::Data),
    /// Show a machine: axes, chain, the errors that it has, which location errors are independent and how they are called.
    Model(machine::Machine),
    /// Say what a symbol means on a machine: an error, or a parameter.
    Explain(explain::Explain),
    /// Correct set-points, or an NC program (`--dialect`), for the errors of a calibrated machine.
    Compensate(Box<compensate::Compensate>),
    /// Correct measured positions for the errors of the calibrated machine that measured them.
    Correct(Box<correct::Correct>),
    /// Keep the results of runs, and tell what they say about a machine over time.
    #[command(subcommand)]
    History(history::Asked),
    /// Many calibrations as independent jobs: machines and weeks, or trials in blocks.
    #[command(subcommand)]
    Fleet(fleet::Asked),
    /// Show a history to browsers on this computer; nothing can be changed there.
    #[cfg(feature = "serve")]
    Serve(serve::Serve),
    /// Commands for vendors of plugin libraries.
    Plugin {
        #[command(subcommand)]
        command: PluginCommand,
    },
    /// List the plugins.
    Plugins {
        /// Print them as JSON, with the schemas and examples of their settings.
        #[arg(long)]
        json: bool,
        /// Write a reference page of every plugin, and a list of the pages, into this folder.
        #[arg(long, conflicts_with = "json")]
        pages: Option<PathBuf>,
    },
    /// Print the JSON Schema of recipes, for editors.
    Schema,
}

#[derive(Subcommand)]
pub enum PluginCommand {
    /// Check whether a library keeps the rules for plugins; each test runs in its own process.
    Check {
        /// The library.
        file: PathBuf,
        /// A recipe that uses its plugins: the rules are also checked for all stages of the recipe, on data of a
        /// virtual machine.
        #[arg(long)]
        recipe: Option<PathBuf>,
        /// Time limit of one test, seconds.
        #[arg(long, value_name = "SECONDS", default_value = "60", value_parser = seconds)]
        time_limit: Duration,
        /// Time limit of all tests together, seconds.
        #[arg(long, value_name = "SECONDS", default_value = "600", value_parser = seconds)]
        total_time_limit: Duration,
        /// Print the report as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Print the JSON Schemas of all that a plugin is asked and answers, by the name of the message.
    Messages,
    /// Run one test of a library in this process.
    #[command(hide = true)]
    Test {
        file: PathBuf,
        test: String,
        #[arg(long)]
        recipe: Option<PathBuf>,
    },
    /// Serve a library to the program that started this one.
    #[command(hide = true)]
    Serve {
        file: PathBuf,
        sha256: String,
        #[arg(long)]
        memory_limit_mib: u64,
        #[arg(long)]
        may_read: Vec<PathBuf>,
    },
}
