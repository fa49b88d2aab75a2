//! `abbe test`: runs recipes and compares what they find with what is expected of them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Instant;

use abbe_core::{Class, Error, Monitor, Result};
use abbe_engine::{prepare, sha256};
use abbe_files::{LARGEST_TEXT, is_same, place, read_text};
use clap::Args;

use crate::expected::{Expected, NEW};
use crate::libraries::Libraries;
use crate::outputs::{are_different, can_be_written, is_file_name, replace};
use crate::report;

/// What is asked of the command.
#[derive(Debug, Clone, Args)]
pub struct Test {
    /// Recipes, or folders with recipes.
    #[arg(default_value = ".")]
    recipes: Vec<PathBuf>,
    /// Take what was found as what is expected from now on.
    #[arg(long)]
    accept: bool,
    /// Part of its standard uncertainty by which a value may differ, and of itself by which an uncertainty may.
    #[arg(long, default_value = "0.1", value_parser = part)]
    part: f64,
    /// Write the results as JUnit XML.
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
    /// Write a summary as Markdown.
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Folder for the results and reports of the runs; without it they are not kept.
    #[arg(long)]
    out: Option<PathBuf>,
}

fn part(text: &str) -> std::result::Result<f64, String> {
    let part = text.parse::<f64>().ok().filter(|part| *part > 0.0 && *part <= 10.0);
    part.ok_or_else(|| "a part above 0 was expected, 10 at most".to_owned())
}

/// How the test of one recipe ended.
enum Ending {
    Same,
    Accepted(usize),
    Changed(Vec<String>),
    /// Nothing is expected of it yet.
    New,
    Error(String),
}

/// One recipe.
struct Tested {
    recipe: String,
    ending: Ending,
    seconds: f64,
}

impl Tested {
    fn is_good(&self) -> bool {
        matches!(self.ending, Ending::Same | Ending::Accepted(_))
    }

    fn word(&self) -> String {
        match &self.ending {
            Ending::Same => "as expected".to_owned(),
            Ending::Accepted(0) => "accepted: nothing had changed".to_owned(),
            Ending::Accepted(count) => format!("accepted: {} changes", count),
            Ending::Changed(found) => format!("CHANGED: {} differences", found.len()),
            Ending::New => "NEW: nothing is expected of it yet; `--accept` takes what it found".to_owned(),
            Ending::Error(_) => "ERROR".to_owned(),
        }
    }

    fn lines(&self) -> Vec<&str> {
        match &self.ending {
            Ending::Changed(found) => found.iter().map(String::as_str).collect(),
            Ending::Error(error) => error.lines().collect(),
            _ => Vec::new(),
        }
    }
}

impl Test {
    /// Runs the recipes one after another; gives what to print and the exit status.
    ///
    /// Fails if there are no recipes, if a file cannot be written, and after an interruption.
    pub fn run(&self, libraries: &Libraries, monitor: &Monitor) -> Result<(String, u8)> {
        let recipes = self.listed()?;
        self.are_own()?;
        self.check_outputs(&recipes)?;
        // Before anything is accepted.
        self.reports().into_iter().try_for_each(|(_, file)| can_be_written(file))?;
        let mut all = Vec::new();
        for recipe in recipes {
            let clock = Instant::now();
            let ending = match self.one(&recipe, libraries, monitor) {
                Ok(ending) => ending,
                Err(error) if error.class == Class::Interrupted => return Err(error),
                Err(error) => Ending::Error(crate::failure::text(&error)),
            };
            let seconds = clock.elapsed().as_secs_f64();
            all.push(Tested { recipe: recipe.display().to_string(), ending, seconds });
        }
        // Somebody may have put something there in the meantime.
        self.are_own()?;
        let mut is_written = true;
        for (file, content) in [(&self.junit, junit(&all)), (&self.markdown, markdown(&all))] {
            // What was found is printed, whether or not it can be kept.
            if let Some(Err(error)) = file.as_deref().map(|file| replace(file, &sealed(&content))) {
                crate::tell(&crate::failure::text(&error));
                is_written = false;
            }
        }
        let status = u8::from(!is_written || !all.iter().all(Tested::is_good));
        Ok((text(&all), status))
    }

    /// The files that the test writes for others, by their options.
    fn reports(&self) -> Vec<(&'static str, &Path)> {
        let named = [("--junit", &self.junit), ("--markdown", &self.markdown)];
        named.into_iter().filter_map(|(option, file)| Some((option, file.as_deref()?))).collect()
    }

    /// Fails if something that an earlier test did not write stands where a file is to be written.
    fn are_own(&self) -> Result<()> {
        let results = [(&self.junit, JUNIT), (&self.markdown, MARKDOWN)];
        results.into_iter().try_for_each(|(file, head)| file.as_deref().map_or(Ok(()), |file| is_own(file, head)))
    }

    /// Fails if two of the files and folders that the test writes or reads would have the same place.
    fn check_outputs(&self, recipes: &[PathBuf]) -> Result<()> {
        let reports = self.reports();
        are_different(&reports)?;
        let refused = |message: String, help: &str| Err(Error::usage(message).help(help));
        let mut expectations: BTreeMap<PathBuf, &Path> = BTreeMap::new();
        let mut results: BTreeMap<PathBuf, &Path> = BTreeMap::new();
        for recipe in recipes {
            let expected = expectation(recipe);
            for (option, file) in &reports {
                if is_same(file, recipe) || is_same(file, &expected) {
                    let message = format!("`{option}` names {}, which belongs to {}", file.display(), recipe.display());
                    return refused(message, "name another file");
                }
            }
            if let Some(other) = expectations.insert(place(&expected), recipe) {
                let (one, two) = (other.display(), recipe.display());
                let message =
                    format!("{one} and {two} have one file of what is expected of them: {}", expected.display());
                return refused(message, "give one of the recipes another name");
            }
            let Some(out) = &self.out else { continue };
            let folder = out.join(recipe.file_stem().unwrap_or_default());
            if let Some(other) = results.insert(place(&folder), recipe) {
                let (one, two) = (other.display(), recipe.display());
                let message = format!("the results of {one} and {two} would both be written to {}", folder.display());
                return refused(message, "test them one by one, with different folders");
            }
            for (option, file) in &reports {
                // The file would stand in a folder of results, or a folder would have to stand where the file is.
                if place(file).starts_with(place(&folder)) || place(out).starts_with(place(file)) {
                    let message = format!("`{option}` names {}, where `--out` has results", file.display());
                    return refused(message, "name another file");
                }
            }
        }
        Ok(())
    }

    /// The recipes: those that are named, and those in folders that are named, by name; each once. Fails if one that is named is not
    /// there.
    fn listed(&self) -> Result<Vec<PathBuf>> {
        let mut all = Vec::new();
        for path in &self.recipes {
            if !path.is_dir() {
                path.metadata().map_err(|error| is_not_there(path, &error))?;
                all.push(path.clone());
                continue;
            }
            let unreadable = |error: std::io::Error| {
                Error::usage(format!("{} cannot be read: {}", path.display(), abbe_files::why(&error)))
            };
            let entries = std::fs::read_dir(path).map_err(unreadable)?.flatten().map(|entry| entry.path());
            let is_yaml = |file: &PathBuf| file.extension().is_some_and(|ending| ending == "yaml" || ending == "yml");
            let (files, others): (Vec<PathBuf>, Vec<PathBuf>) = entries.partition(is_yaml);
            let (mut recipes, no_recipes): (Vec<PathBuf>, Vec<PathBuf>) =
                files.into_iter().partition(|file| is_recipe(file));
            // What something is expected of is looked at, and told if it is no recipe any more, or is gone.
            let expected: Vec<PathBuf> = others.into_iter().filter(|file| is_expectation(file)).collect();
            recipes.extend(no_recipes.into_iter().filter(|file| expected.contains(&expectation(file))));
            let known: BTreeSet<PathBuf> = recipes.iter().map(|recipe| expectation(recipe)).collect();
            let left = expected.iter().filter(|file| !known.contains(*file));
            recipes.extend(left.map(|file| file.with_extension("yaml")));
            if recipes.is_empty() {
                return Err(Error::usage(format!("there are no recipes in {}", path.display()))
                    .help("name recipes, or a folder with some"));
            }
            recipes.sort();
            all.append(&mut recipes);
        }
        let here = Path::new(".");
        let mut seen = BTreeSet::new();
        all.retain(|file| seen.insert(place(file)));
        Ok(all.into_iter().map(|file| file.strip_prefix(here).map(Path::to_owned).unwrap_or(file)).collect())
    }

    fn one(&self, recipe: &Path, libraries: &Libraries, monitor: &Monitor) -> Result<Ending> {
        let prepared = prepare(recipe, &libraries.registry(Some(recipe))?)?;
        let mut outcome = prepared.run(monitor)?;
        let found = Expected::of(&outcome);
        if let Some(out) = &self.out {
            report::attach(&mut outcome);
            outcome.write(out)?;
        }
        let file = expectation(recipe);
        let before = match file.symlink_metadata().is_ok() {
            true => {
                let unreadable = |error: std::io::Error| {
                    Error::data(format!("the file cannot be read: {}", abbe_files::why(&error))).help(NEW)
                };
                let text = read_text(&file, LARGEST_TEXT).map_err(|error| unreadable(error).in_file(&file))?;
                Some((Expected::read(&text).map_err(|error| error.in_file(&file))?, text))
            }
            false => None,
        };
        let differences = before.as_ref().map(|(before, _)| before.differences(&found, self.part));
        if self.accept {
            let count = differences.as_ref().map_or(1, Vec::len);
            // A file that still holds is not touched, so that digits alone make no difference.
            if count > 0 {
                let name = recipe.file_name().unwrap_or_default().to_string_lossy();
                let before = before.as_ref().map_or("", |(_, text)| text.as_str());
                replace(&file, &found.text_with_remarks(&name, before))?;
            }
            return Ok(Ending::Accepted(count));
        }
        Ok(match differences {
            None => Ending::New,
            Some(differences) if differences.is_empty() => Ending::Same,
            Some(differences) => {
                Ending::Changed(differences.iter().map(|told| crate::failure::readable(told)).collect())
            }
        })
    }
}

/// The error of a recipe that was named and is not there.
fn is_not_there(path: &Path, error: &std::io::Error) -> Error {
    let message = match error.kind() {
        std::io::ErrorKind::NotFound => format!("the file `{}` does not exist", path.display()),
        _ => format!("the file `{}` cannot be read: {}", path.display(), abbe_files::why(error)),
    };
    Error::usage(message).help("name recipes, or a folder with some")
}

/// Whether a YAML file says that it is a recipe. What cannot be read may be one: its test says why.
fn is_recipe(file: &Path) -> bool {
    read_text(file, LARGEST_TEXT).map_or(true, |text| text.lines().any(|line| line.starts_with("abbe:")))
}

/// The file with what is expected of a recipe.
fn expectation(recipe: &Path) -> PathBuf {
    recipe.with_extension(EXPECTED)
}

/// Whether it is a file of what is expected of a recipe. Other programs may end names alike.
fn is_expectation(file: &Path) -> bool {
    let is_read = || read_text(file, LARGEST_TEXT).is_ok_and(|text| Expected::read(&text).is_ok());
    file.extension().is_some_and(|ending| ending == EXPECTED) && is_read()
}

/// How names of files of what is expected end.
const EXPECTED: &str = "expected";

/// How a file of results begins.
const JUNIT: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuites>\n<testsuite name=\"abbe test\"";
const MARKDOWN: &str = "| recipe | result | s |\n";

/// How the last line of a file of results begins: the hash of what is above it follows, by which a later test knows that nobody changed it.
const SEAL: &str = "<!-- as abbe test wrote it: ";

fn sealed(content: &str) -> String {
    format!("{content}{SEAL}{} -->\n", sha256(content.as_bytes()))
}

/// Whether a file of results is as a test wrote it.
fn is_sealed(text: &str) -> bool {
    text.rfind(SEAL).is_some_and(|at| sealed(&text[..at]) == text)
}

/// Fails if there is something of this name that an earlier test did not write, or that somebody changed.
fn is_own(file: &Path, head: &str) -> Result<()> {
    is_file_name(file)?;
    let Ok(found) = file.symlink_metadata() else { return Ok(()) };
    // A service may have made an empty one for it.
    let is_own = |text: String| text.is_empty() || (text.starts_with(head) && is_sealed(&text));
    if found.is_file() && read_text(file, LARGEST_TEXT).is_ok_and(is_own) {
        return Ok(());
    }
    let message = format!(
        "{} is there already, and is not as an earlier `abbe test` wrote it; it is not replaced",
        file.display()
    );
    Err(Error::usage(message).help("name another file"))
}

fn text(all: &[Tested]) -> String {
    let mut text = String::new();
    for tested in all {
        text.push_str(&format!("{}: {} ({:.1} s)\n", tested.recipe, tested.word(), tested.seconds));
        tested.lines().iter().for_each(|line| text.push_str(&format!("  {line}\n")));
    }
    let bad = all.iter().filter(|tested| !tested.is_good()).count();
    let recipes = crate::calibrated::counted(all.len(), "recipe");
    match bad {
        0 => text + &format!("{recipes}, all as expected\n"),
        bad => text + &format!("{recipes}, {bad} not as expected\n"),
    }
}

fn markdown(all: &[Tested]) -> String {
    // A cell ends at a bar, and a line at its end; markup of files shows as it is.
    let plain = |text: &str| -> String {
        let shown = |letter: char| match letter {
            '&' => "&amp;".to_owned(),
            '<' => "&lt;".to_owned(),
            '`' => "'".to_owned(),
            '\\' | '*' | '_' | '[' | '|' | '~' | '#' => format!("\\{letter}"),
            letter if letter.is_control() => " ".to_owned(),
            letter => letter.to_string(),
        };
        text.chars().map(shown).collect()
    };
    let mut text = format!("{MARKDOWN}|---|---|---|\n");
    for tested in all {
        let mark = if tested.is_good() { "✅" } else { "❌" };
        text.push_str(&format!("| {} | {mark} {} | {:.1} |\n", plain(&tested.recipe), tested.word(), tested.seconds));
    }
    for tested in all.iter().filter(|tested| !tested.lines().is_empty()) {
        text.push_str(&format!("\n**{}**\n\n", plain(&tested.recipe)));
        tested.lines().iter().for_each(|line| text.push_str(&format!("- {}\n", plain(line))));
    }
    text
}

fn junit(all: &[Tested]) -> String {
    let plain = |text: &str| {
        let escaped = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;");
        // XML 1.0 has no other control characters.
        escaped.replace(|letter: char| letter.is_control() && letter != '\n' && letter != '\t', " ")
    };
    let count = |is: fn(&Ending) -> bool| all.iter().filter(|tested| is(&tested.ending)).count();
    let failures = count(|ending| matches!(ending, Ending::Changed(_) | Ending::New));
    let errors = count(|ending| matches!(ending, Ending::Error(_)));
    let seconds: f64 = all.iter().map(|tested| tested.seconds).sum();
    let mut text = format!(
        "{JUNIT} tests=\"{}\" failures=\"{failures}\" \
         errors=\"{errors}\" time=\"{seconds:.3}\">\n",
        all.len()
    );
    for tested in all {
        let name = plain(&tested.recipe);
        text.push_str(&format!("<testcase classname=\"abbe\" name=\"{name}\" time=\"{:.3}\"", tested.seconds));
        let tag = if matches!(tested.ending, Ending::Error(_)) { "error" } else { "failure" };
        match tested.is_good() {
            true => text.push_str("/>\n"),
            false => text.push_str(&format!(
                ">\n<{tag} message=\"{}\">{}</{tag}>\n</testcase>\n",
                plain(&tested.word()),
                plain(&tested.lines().join("\n"))
            )),
        }
    }
    text + "</testsuite>\n</testsuites>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all() -> Vec<Tested> {
        let tested = |recipe: &str, ending| Tested { recipe: recipe.to_owned(), ending, seconds: 1.25 };
        vec![
            tested("a.yaml", Ending::Same),
            tested("b <|>.yaml", Ending::Changed(vec!["fit EXX[1]: 3 ± 1 µm & \u{1b}[31m \"so\"".to_owned()])),
            tested("c.yaml", Ending::New),
            tested("d.yaml", Ending::Error("the file does not exist\nhelp: name another\n".to_owned())),
        ]
    }

    #[test]
    fn results_for_people_and_machines() {
        insta::assert_snapshot!("test_text", text(&all()));
        insta::assert_snapshot!("test_junit", junit(&all()));
        insta::assert_snapshot!("test_markdown", markdown(&all()));
    }
}
