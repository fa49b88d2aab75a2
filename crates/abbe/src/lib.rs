//! The command line of Abbe: `new`, `run`, `report`, `test`, `check`, `data`, `model`, `explain`, `simulate`, `plan`, `history`, `fleet`, `serve`, `plugins`, `plugin`, `schema`.
//!
//! Exit status: 0 no verdict failed (inconclusive verdicts are reported); 1 an error that only the data or the run show; 2 wrong
//! use, or an error that can be found without reading data rows; 3 a verdict failed; 130 interrupted by Ctrl-C, 143 by SIGTERM,
//! 129 by a closed terminal (SIGHUP).

pub use report::attach as attach_report;

mod arguments;
mod brief;
mod browser;
mod calibrated;
mod checked;
mod children;
mod compensate;
mod correct;
mod data;
mod effects;
mod expected;
mod explain;
mod failure;
mod fleet;
mod history;
mod interrupt;
mod libraries;
mod lines;
mod listed;
mod machine;
mod nc_program;
mod new;
mod outputs;
mod pages;
mod picture;
mod planning;
mod progress;
mod report;
#[cfg(feature = "serve")]
mod serve;
mod simulated;
mod summary;
mod table;
mod terminal;
mod test;
mod uncertainty_summary;
mod written_out;

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use abbe_core::{Class, Error, Kind, Monitor, Origin, Result, harmless, harmless_json};
use abbe_engine::{can_write_folder, prepare};
use abbe_plugin::Allowance;
use abbe_plugin::check::Findings;
use abbe_recipe::HistoryPlace;
use abbe_report::plan_page;
use arguments::{Arguments, Command, PluginCommand};
use clap::Parser;
use libraries::Libraries;
use serde_json::Value;
use terminal::{Harmless, tell};

use abbe_bundle as _;

/// Carries out the command line of this process; gives its exit status.
pub fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return not_understood(&error),
    };
    // Who starts this program for a library alone looks at what it answers.
    if !matches!(arguments.command, Command::Plugin { .. }) {
        abbe_plugin::guard_exit();
    }
    // Also when a panic ends this function.
    let _end = ExpectedEnd;
    carried_out(arguments)
}

/// Says what is wrong with the arguments, or the help that they ask for; gives the exit status. Arguments may be names of files that
/// somebody else has chosen (`*`).
fn not_understood(error: &clap::Error) -> ExitCode {
    let text = error.render().to_string();
    if error.use_stderr() {
        tell(&failure::readable(&text));
    } else {
        return printed(&harmless(&text), u8::try_from(error.exit_code()).unwrap_or(2));
    }
    ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2))
}

/// Prints what a command found; gives its exit status, or that of an output which cannot be written.
fn printed(text: &str, status: u8) -> ExitCode {
    match io::stdout().lock().write_all(text.as_bytes()) {
        Ok(()) if interrupt::happened() => ExitCode::from(interrupt::status()),
        Ok(()) => ExitCode::from(status),
        // The reader of the output has closed it.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => ExitCode::from(status),
        Err(error) => {
            tell(&format!("the output cannot be written: {}\n", abbe_files::why(&error)));
            ExitCode::from(1)
        }
    }
}

/// Marks the end of the process, when dropped, as intended by the program and not caused by a plugin.
struct ExpectedEnd;

impl Drop for ExpectedEnd {
    fn drop(&mut self) {
        abbe_plugin::expect_exit();
    }
}

fn carried_out(arguments: Arguments) -> ExitCode {
    let level = match &arguments.command {
        // What users should know of a job stands in its result.
        Command::Fleet(asked) if asked.is_worker() => tracing::Level::ERROR,
        _ if arguments.verbose => tracing::Level::INFO,
        _ => tracing::Level::WARN,
    };
    tracing_subscriber::fmt()
        .with_writer(|| Harmless(io::stderr()))
        .with_max_level(level)
        .without_time()
        .with_target(false)
        .init();
    let machine = match &arguments.command {
        Command::Run { json, .. } | Command::Check { json, .. } | Command::Plan { json, .. } => *json,
        Command::Compensate(asked) => asked.json,
        Command::Correct(asked) => asked.json,
        Command::History(asked) => asked.is_json(),
        Command::Fleet(asked) => asked.is_json(),
        _ => false,
    };
    let is_json = machine
        || matches!(
            arguments.command,
            Command::Schema
                | Command::Plugins { json: true, .. }
                | Command::Plugin {
                    command: PluginCommand::Check { json: true, .. }
                        | PluginCommand::Test { .. }
                        | PluginCommand::Messages
                }
        );
    let shown = |text: &str| {
        if is_json { harmless_json(text).into_owned() } else { brief::coloured(&harmless(text)).into_owned() }
    };
    let libraries = Libraries {
        files: arguments.plugins,
        isolate: arguments.isolate_plugins,
        trust: arguments.trust_plugins,
        refuse: arguments.no_dynamic_plugins,
    };
    interrupt::tell_limits_of_files();
    let result = dispatch(arguments.command, &libraries, arguments.verbose);
    interrupt::done();
    match result {
        Ok((text, status)) => printed(&shown(&text), status),
        Err(error) => {
            // After an interruption other errors are its consequences, also that of a process that was ended.
            let error = if interrupt::happened() { Error::interrupted() } else { error };
            match error.class {
                _ if machine => {
                    // The status tells, too.
                    let _ = writeln!(io::stdout(), "{}", harmless_json(&failure::json(&error).to_string()));
                }
                Class::Interrupted => tell(&format!("{}\n", error.message)),
                Class::Use | Class::Data => tell(&failure::text(&error)),
            }
            ExitCode::from(match error.class {
                Class::Use => 2,
                Class::Data => 1,
                Class::Interrupted => interrupt::status(),
            })
        }
    }
}

/// The folder that a command was started in. A plugin may change it under way; what the user named does not move with it.
struct Here(Option<PathBuf>);

impl Here {
    fn now() -> Self {
        Self(std::env::current_dir().ok())
    }

    /// A path that was named when the command started; as it was named if the folder is still the same.
    fn path(&self, named: &Path) -> PathBuf {
        match &self.0 {
            Some(here) if std::env::current_dir().ok().as_ref() != Some(here) => here.join(named),
            _ => named.to_owned(),
        }
    }

    /// A history that was named when the command started.
    fn place(&self, named: &HistoryPlace) -> HistoryPlace {
        match named {
            HistoryPlace::File(path) => HistoryPlace::File(self.path(path)),
            server => server.clone(),
        }
    }
}

/// Carries out a command; gives what to print and the exit status.
fn dispatch(command: Command, libraries: &Libraries, verbose: bool) -> Result<(String, u8)> {
    match command {
        Command::Run { recipe, out, json, progress, time_limit } => {
            let here = Here::now();
            let (monitor, bar) = progress.monitor();
            let monitor = match time_limit {
                Some(limit) => monitor.with_time_limit(limit),
                None => monitor,
            };
            interrupt::cancel_on_signal(monitor.clone())?;
            let what = "the run is not at its end: no results are written";
            interrupt::end_after(time_limit, interrupt::GRACE, json, what)?;
            let prepared = prepare(&recipe, &libraries.registry(Some(&recipe))?)?;
            prepared.can_write(&out)?;
            prepared.recipe.history.iter().try_for_each(|place| history::can_add(&here.place(place)))?;
            let mut outcome = prepared.run(&monitor)?;
            let made = report::attach(&mut outcome);
            bar.finish_and_clear();
            let folder = interrupt::while_writing(|| outcome.write(&here.path(&out)))?;
            if let Some(place) = &prepared.recipe.history {
                history::add_outcome(&here.place(place), &outcome)?;
            }
            let status = match (outcome.failures.is_empty(), outcome.passes()) {
                (false, _) => 1,
                (true, false) => 3,
                (true, true) => 0,
            };
            if json {
                return Ok((pretty(&summary::json(&outcome, &folder))?, status));
            }
            for failure in outcome.failures.iter().filter(|failure| failure.needs.is_none()) {
                tell(&failure::text(&failure.error));
            }
            let text = match made {
                Some(made) if !verbose => brief::text(&made, &folder, lines::width()),
                _ => summary::text(&prepared.recipe.name, &outcome, &folder),
            };
            Ok((text, status))
        }
        Command::Report { results, out } => {
            interrupt::cancel_on_signal(Monitor::default())?;
            written(report::beside(&results, out, &libraries.registry(None)?)?)
        }
        Command::Test(asked) => {
            let monitor = Monitor::default();
            interrupt::cancel_on_signal(monitor.clone())?;
            asked.run(libraries, &monitor)
        }
        Command::Check { recipe, json, explain, time_limit } => {
            interrupt::cancel_on_signal(Monitor::default())?;
            interrupt::end_after(time_limit, Duration::ZERO, json, "the check is not at its end")?;
            let prepared = prepare(&recipe, &libraries.registry(Some(&recipe))?)?;
            prepared.recipe.history.iter().try_for_each(history::can_add)?;
            let planned = prepared.check()?;
            let status = if planned.iter().all(|planned| planned.accepted) { 0 } else { 1 };
            let text = match json {
                true => pretty(&summary::planned_json(&planned))?,
                false => checked::text(&prepared.recipe, &planned, explain || verbose),
            };
            Ok((text, status))
        }
        Command::Simulate { recipe, truth, seed, out, machine, time_limit } => {
            let here = Here::now();
            interrupt::cancel_on_signal(Monitor::default())?;
            let what = "the measurements are not simulated: nothing is written";
            interrupt::end_after(time_limit, Duration::ZERO, false, what)?;
            let prepared = prepare(&recipe, &libraries.registry(Some(&recipe))?)?;
            can_write_folder(&out)?;
            let simulated = prepared.simulate(&truth, seed, machine.as_deref())?;
            interrupt::while_writing(|| simulated.write(&here.path(&out)))?;
            Ok((simulated::text(&simulated, &out), 0))
        }
        Command::Plan { recipe, out, program, json, time_limit } => {
            let here = Here::now();
            interrupt::cancel_on_signal(Monitor::default())?;
            let what = "there is no plan yet: nothing is printed or written";
            interrupt::end_after(time_limit, Duration::ZERO, json, what)?;
            let prepared = prepare(&recipe, &libraries.registry(Some(&recipe))?)?;
            out.iter().try_for_each(|out| can_write_folder(out))?;
            let mut measurements = prepared.plan_for(program)?;
            let page = plan_page(&prepared.recipe.name, &measurements);
            measurements.files.insert(PathBuf::from("report.html"), page.into_bytes());
            interrupt::while_writing(|| out.iter().try_for_each(|out| measurements.write(&here.path(out))))?;
            let status = if measurements.accepted { 0 } else { 1 };
            Ok((planning::shown(&prepared.recipe.name, measurements, out.as_deref(), json), status))
        }
        Command::New(asked) => Ok((asked.run(libraries)?, 0)),
        Command::Data(asked) => {
            interrupt::cancel_on_signal(Monitor::default())?;
            Ok((asked.run(libraries)?, 0))
        }
        Command::Model(asked) => {
            interrupt::cancel_on_signal(Monitor::default())?;
            written(asked.run(libraries)?)
        }
        Command::Explain(asked) => {
            interrupt::cancel_on_signal(Monitor::default())?;
            Ok((asked.run(libraries)?, 0))
        }
        Command::Compensate(asked) if asked.is_program() => {
            interrupt::cancel_on_signal(Monitor::default())?;
            asked.run_program(&libraries.registry(None)?)
        }
        Command::Compensate(asked) => {
            interrupt::cancel_on_signal(Monitor::default())?;
            written(asked.run(&libraries.registry(None)?)?)
        }
        Command::Correct(asked) => {
            interrupt::cancel_on_signal(Monitor::default())?;
            written(asked.run(&libraries.registry(None)?)?)
        }
        Command::Fleet(asked) => asked.run(libraries, verbose),
        #[cfg(feature = "serve")]
        Command::Serve(asked) => asked.run(libraries.registry(None)?),
        Command::History(asked) => {
            interrupt::cancel_on_signal(Monitor::default())?;
            asked.run(libraries)
        }
        Command::Plugin { command: PluginCommand::Check { file, recipe, time_limit, total_time_limit, json } } => {
            let program = libraries::this_program()?;
            let report = {
                let limits = abbe_plugin::check::Limits { of_test: time_limit, total: total_time_limit };
                abbe_plugin::check::check(&file, &program, limits, recipe.as_deref())?
            };
            let status = if report.passes() { 0 } else { 1 };
            let text = match json {
                true => pretty(&report.json())?,
                false => report.text(),
            };
            Ok((text, status))
        }
        Command::Plugin { command: PluginCommand::Messages } => {
            Ok((pretty(&Value::Object(abbe_plugin::messages::schemas()))?, 0))
        }
        Command::Plugin { command: PluginCommand::Test { file, test, recipe } } => match recipe {
            None => abbe_plugin::check::test(&file, &test).map(|text| (text, 0)),
            Some(recipe) => Ok((laws(&recipe, file, libraries)?.line()?, 0)),
        },
        Command::Plugin { command: PluginCommand::Serve { file, sha256, memory_limit_mib, may_read } } => {
            let allowance = Allowance { may_read, memory_limit_mib, ..Allowance::default() };
            abbe_plugin::serve(&file, &sha256, &allowance).map(|()| (String::new(), 0))
        }
        Command::Plugins { json, pages } => {
            let registry = libraries.registry(None)?;
            if let Some(folder) = pages {
                interrupt::cancel_on_signal(Monitor::default())?;
                return pages::write(&registry, &folder).map(|text| (text, 0));
            }
            let text = if json { pretty(&listed::plugins_json(&registry))? } else { listed::plugins_text(&registry) };
            Ok((text, 0))
        }
        Command::Schema => Ok((pretty(&abbe_recipe::schema(&libraries.registry(None)?))?, 0)),
    }
}

/// Checks the laws for everything that a recipe uses, including the plugins of a library.
fn laws(recipe: &Path, library: PathBuf, libraries: &Libraries) -> Result<Findings> {
    let files = libraries.files.iter().cloned().chain([library.clone()]).collect();
    let libraries = Libraries { files, ..*libraries };
    let found =
        libraries.registry(Some(recipe)).and_then(|registry| Ok((prepare(recipe, &registry)?.laws()?, registry)));
    let (laws, registry) = match found {
        Ok(found) => found,
        Err(error) => return Ok(Findings { wrong: vec![error.to_string()], skipped: Vec::new() }),
    };
    let mut findings = Findings { wrong: laws.broken, skipped: laws.skipped };
    // There are laws for these kinds only. The recipe may name the library by another path.
    let name = library.file_name();
    let own = registry.iter().filter(|plugin| {
        let of_library = matches!(&plugin.origin, Origin::Library { file, .. } if file.file_name() == name);
        of_library && matches!(plugin.kind(), Kind::Artefact | Kind::Model | Kind::Estimate)
    });
    let (seen, unseen): (Vec<_>, Vec<_>) =
        own.partition(|plugin| laws.seen.iter().any(|(_, seen)| *seen == plugin.name));
    if seen.is_empty() {
        findings.wrong.push("the recipe uses no model, artefact or estimator of the library".to_owned());
    }
    findings.skipped.extend(unseen.iter().map(|plugin| format!("`{}`: the recipe does not use it", plugin.name)));
    Ok(findings)
}

/// Writes files, then tells what was found.
fn written(found: outputs::Written) -> Result<(String, u8)> {
    interrupt::while_writing(|| found.write())?;
    Ok((found.text, 0))
}

fn pretty(value: &Value) -> Result<String> {
    serde_json::to_string_pretty(value)
        .map(|text| text + "\n")
        .map_err(|error| Error::data(format!("the output cannot be written: {error}")))
}
