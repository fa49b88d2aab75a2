//! `FLEET.yaml`: which jobs are wanted.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use abbe_core::{Error, Result};
use abbe_files::{LARGEST_TEXT, read_text};
use abbe_recipe::yaml::{At, Document, Node};
use abbe_recipe::{HistoryPlace, Template};
use serde_json::Value;

use crate::combinations::{Combination, MOST_JOBS, read as combinations};
use crate::manifest::{Kept, Setting};
use crate::text::{Variables, filled, filled_all, plain};

/// The version of `FLEET.yaml` that this program reads.
const VERSION: u64 = 1;

/// What is wanted.
#[derive(Debug)]
pub struct Fleet {
    /// Its name, for people.
    pub name: String,
    /// Its folder: all paths in it start there.
    pub folder: PathBuf,
    /// The history to which the results go.
    pub history: Option<String>,
    pub(crate) families: Vec<FamilyWanted>,
}

/// Jobs of one recipe.
#[derive(Debug)]
pub(crate) struct FamilyWanted {
    pub name: String,
    /// The recipe, from the folder of the fleet.
    pub recipe: PathBuf,
    pub template: Template,
    pub trials: Option<TrialsWanted>,
    pub shards: Option<ShardsWanted>,
    pub jobs: Vec<Wanted>,
}

/// One estimate from files that no process has all of.
#[derive(Debug, Clone)]
pub(crate) struct ShardsWanted {
    /// The estimate.
    pub stage: String,
    /// The ingest stage whose files are dealt out.
    pub from: String,
    /// How many of them a job has.
    pub files: usize,
}

/// Trials in blocks.
#[derive(Debug, Clone)]
pub(crate) struct TrialsWanted {
    /// The estimate whose trials they are.
    pub stage: String,
    /// How many a job has.
    pub block: usize,
}

/// One combination of variables.
#[derive(Debug)]
pub(crate) struct Wanted {
    pub name: String,
    pub variables: Variables,
    pub settings: Vec<Setting>,
    pub kept: Kept,
}

impl Fleet {
    /// Reads a file, and the recipes that it names.
    ///
    /// # Errors
    /// With file, line and column for anything that can be wrong in it; what is wrong with the recipes is found by [`crate::plan`].
    pub fn read(path: &Path) -> Result<Self> {
        let text = read_text(path, LARGEST_TEXT)
            .map_err(|error| Error::usage(format!("{} cannot be read: {}", path.display(), abbe_files::why(&error))))?;
        let document = Document::parse(path, &text)?;
        let root = document.root();
        root.map()?;
        let expected = format!("this program reads fleets of version {VERSION}");
        let Some(version) = root.get("abbe_fleet") else {
            let message = format!("the key `abbe_fleet` is missing: {expected}, `abbe_fleet: {VERSION}`");
            return Err(root.missing(&["abbe_fleet"], message));
        };
        if version.value.as_u64() != Some(VERSION) {
            return Err(version.error(At::Value, format!("{expected}, not {}", version.value)));
        }
        root.only(&["abbe_fleet", "name", "history", "families"])?;
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let name = root.get("name").map(|node| node.text()).transpose()?.map_or(stem, str::to_owned);
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let history = root.get("history").map(|node| history(&node)).transpose()?;
        let Some(families) = root.get("families") else {
            return Err(root.missing(&["families"], "the key `families` is missing: what is to be done?"));
        };
        let families: Vec<FamilyWanted> =
            families.map()?.into_iter().map(|(name, node)| family(name, &node, &folder)).collect::<Result<_>>()?;
        if families.is_empty() {
            return Err(root.error(At::Value, "families: at least one was expected"));
        }
        let fleet = Self { name, folder, history, families };
        fleet.check_names(&root)?;
        Ok(fleet)
    }

    /// Jobs are known by their names.
    fn check_names(&self, root: &Node<'_>) -> Result<()> {
        let mut seen = BTreeSet::new();
        for family in &self.families {
            let Some(twice) = family.jobs.iter().find(|job| !seen.insert(job.name.as_str())) else { continue };
            let message = format!("two jobs are called `{}`", twice.name);
            let node = root.get("families").and_then(|families| families.get(&family.name));
            let error = node.map_or_else(|| Error::usage(&message), |node| node.error(At::Key, &message));
            return Err(error.help("a value stands under `for` twice, or in two rows of a table"));
        }
        match seen.len() > MOST_JOBS {
            true => Err(Error::usage(format!("these are more than {MOST_JOBS} jobs, the most of a fleet"))
                .help("list fewer values under `for`, and plan the others as another fleet")),
            false => Ok(()),
        }
    }
}

fn history(node: &Node<'_>) -> Result<String> {
    let text = node.text()?;
    HistoryPlace::parse(text).map_err(|wrong| node.error(At::Value, wrong))?;
    Ok(text.to_owned())
}

fn family(name: &str, node: &Node<'_>, folder: &Path) -> Result<FamilyWanted> {
    if name.is_empty() || !name.chars().all(|letter| letter.is_alphanumeric() || letter == '-' || letter == '_') {
        let message = format!("`{name}` cannot name a family: letters, digits, `-` and `_` were expected");
        return Err(node.error(At::Key, message));
    }
    node.only(&["recipe", "for", "set", "machine", "label", "at", "unit", "trials", "shards"])?;
    let Some(recipe) = node.get("recipe") else {
        return Err(node.missing(&["recipe"], "the key `recipe` is missing: what does a job run?"));
    };
    let path = PathBuf::from(recipe.text()?);
    let template = Template::read(&folder.join(&path), &path).map_err(|mut error| match &mut error.place {
        None => recipe.error(At::Value, error.message),
        Some(place) => {
            place.file = folder.join(&path);
            error
        }
    })?;
    let trials = node.get("trials").map(|node| trials(&node, &template)).transpose()?;
    let shards = node.get("shards").map(|node| shards(&node, &template)).transpose()?;
    if let (Some(node), Some(_)) = (node.get("shards"), &trials) {
        return Err(node.error(At::Key, "a family has `trials` or `shards`, not both"));
    }
    let sets = node.get("set").map(|set| set.map()).transpose()?.unwrap_or_default();
    for (way, node) in &sets {
        let tried = template.clone().set(&parts(way), Value::Null);
        tried.map_err(|error| {
            let wrong = node.error(At::Key, error.message);
            error.help.into_iter().fold(wrong, Error::help)
        })?;
    }
    let words = ["machine", "label", "at", "unit"].map(|key| node.get(key));
    let one = |one: Combination| {
        let setting = |(way, node): &(&str, Node<'_>)| {
            let value = filled_all(node.value, &one.variables).map_err(|wrong| node.error(At::Value, wrong))?;
            Ok(Setting { at: parts(way), value })
        };
        let settings = sets.iter().map(setting).collect::<Result<_>>()?;
        let kept = kept(&words, &one.variables)?;
        let named = std::iter::once(name.to_owned()).chain(one.named.iter().map(plain));
        Ok(Wanted { name: named.collect::<Vec<_>>().join("/"), variables: one.variables, settings, kept })
    };
    let jobs = combinations(node.get("for").as_ref(), folder)?.into_iter().map(one).collect::<Result<_>>()?;
    Ok(FamilyWanted { name: name.to_owned(), recipe: path, template, trials, shards, jobs })
}

fn parts(way: &str) -> Vec<String> {
    way.split('.').map(str::to_owned).collect()
}

fn trials(node: &Node<'_>, template: &Template) -> Result<TrialsWanted> {
    node.only(&["stage", "block"])?;
    Ok(TrialsWanted {
        stage: stage(node, template, "stage", "the estimate whose trials are dealt out")?,
        block: count(node, "block", "the number of trials of a job")?,
    })
}

fn shards(node: &Node<'_>, template: &Template) -> Result<ShardsWanted> {
    node.only(&["stage", "from", "files"])?;
    Ok(ShardsWanted {
        stage: stage(node, template, "stage", "the estimate of all files")?,
        from: stage(node, template, "from", "the ingest stage whose files are dealt out")?,
        files: count(node, "files", "the number of files of a job")?,
    })
}

/// The name of a stage of the recipe under a key that has to be there.
fn stage(node: &Node<'_>, template: &Template, key: &str, what: &str) -> Result<String> {
    let stage = node.get(key).ok_or_else(|| node.missing(&[key], format!("the key `{key}` is missing: {what}")))?;
    let (name, names) = (stage.text()?, template.stages());
    match names.contains(&name) {
        true => Ok(name.to_owned()),
        false => Err(stage.error(At::Value, format!("the recipe has no stage `{name}`")).suggest(name, names)),
    }
}

/// A number from 1 under a key that has to be there.
fn count(node: &Node<'_>, key: &str, what: &str) -> Result<usize> {
    let count = node.get(key).ok_or_else(|| node.missing(&[key], format!("the key `{key}` is missing: {what}")))?;
    let number = count.value.as_u64().filter(|count| *count > 0).and_then(|count| usize::try_from(count).ok());
    number.ok_or_else(|| count.error(At::Value, format!("{key}: a whole number from 1 was expected")))
}

/// What the history gets to know of a job.
fn kept([machine, label, at, unit]: &[Option<Node<'_>>; 4], variables: &Variables) -> Result<Kept> {
    let word = |node: &Option<Node<'_>>| -> Result<Option<Value>> {
        let Some(node) = node else { return Ok(None) };
        match node.value {
            Value::Number(_) => Ok(Some(node.value.clone())),
            _ => filled(node.text()?, variables).map(Some).map_err(|wrong| node.error(At::Value, wrong)),
        }
    };
    let text = |node: &Option<Node<'_>>| -> Result<Option<String>> {
        let found = word(node)?.map(|value| plain(&value));
        match (node, found) {
            (Some(node), Some(text)) if text.trim().is_empty() => {
                Err(node.error(At::Value, "a text that is not empty was expected"))
            }
            (_, found) => Ok(found),
        }
    };
    let time = word(at)?;
    let number = time.as_ref().map(|value| {
        let text = plain(value);
        let number = text.parse().ok().filter(|number: &f64| number.is_finite()).or_else(|| abbe_engine::day_of(&text));
        number.ok_or_else(|| {
            let message = format!("`{text}` is no time: a number was expected, or a date as 2026-03-02");
            at.as_ref().map_or_else(|| Error::usage(&message), |node| node.error(At::Value, &message))
        })
    });
    Ok(Kept {
        machine: text(machine)?,
        label: text(label)?.or_else(|| time.as_ref().map(plain)),
        at: number.transpose()?,
        unit: text(unit)?.unwrap_or_else(|| "day".to_owned()),
    })
}
