//! Recipes in YAML: a checked graph of stages, errors that point at line and column, and a JSON Schema for editors.
//!
//! **Architecture invariant:** no other crate knows YAML, and this one reads nothing but recipes and the YAML files
//! that the `file` settings of model stages name. It builds no stage: it passes the settings on as JSON values, and gives
//! errors of a plugin about them their place ([`Recipe::settings_error`]). Other files in YAML that this program reads are read
//! by its [`yaml`].

mod document;
mod graph;
mod libraries;
mod located;
mod machine_file;
mod page;
mod place;
mod schema;
mod sets;
mod stage;
mod template;
#[cfg(test)]
mod tests;
mod ties;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use abbe_core::{Error, EstimateSource, Kind, PathItem, Plugin, Registry, SettingsError, nearest};
use abbe_planning::Planning;
use serde_json::{Map, Value};

use document::{At, Document, Node};
use libraries::libraries;
pub use libraries::{Isolation, Library};
pub use machine_file::machine_description;
use machine_file::{merge, read_description};
pub use page::{PAGE_MARK, index, page, page_name};
pub use place::HistoryPlace;
pub use schema::schema;
use sets::{Expanded, Sets, with_sets};
pub use stage::Stage;
pub use template::Template;

/// YAML text as values that know their place in the text.
pub mod yaml {
    pub use crate::document::{At, Document, Node};
}

/// The keys of an artefact stage that are the same for all artefact plugins ([`abbe_estimation::RowSettings`]).
const ROW_SETTINGS: [&str; 4] = ["uncertainty", "pooled", "id", "unseen"];

/// The key of an estimate that may use rows again from which its known values were estimated, and the only value of this key.
const SHARED_ROWS: &str = "shared_rows";
const ACCEPTED: &str = "accepted";

/// The key of an estimate from measurements with the largest plausible errors ([`abbe_estimation::Plausible`]).
const PLAUSIBLE: &str = "plausible";

/// The key of an estimate from measurements with parameters that are one unknown.
const TIE: &str = "tie";

/// The key of an estimate from measurements that is made for every group of rows: `week`, `day`, another column, or `file`.
const PER: &str = "per";

/// The key under which measurements are planned ([`Planning`]).
const PLAN: &str = "plan";

/// The key with the file that keeps what every run finds.
const HISTORY: &str = "history";

/// Bytes of the longest name of a stage: files are named after stages.
const LONGEST_NAME: usize = 200;

/// The version of recipes that this program reads.
const VERSION: u64 = 1;

/// A recipe whose references are valid. The plugins check the settings of its stages later.
#[derive(Debug, Clone, PartialEq)]
pub struct Recipe {
    /// The file.
    pub path: PathBuf,
    /// Its folder, where relative paths start.
    pub base: PathBuf,
    /// Its text.
    pub text: String,
    /// Title for people.
    pub name: String,
    /// Name of the file without extension, which names the folder of results.
    pub id: String,
    /// The stages, each after those that it refers to.
    pub stages: Vec<Stage>,
    /// Libraries with more plugins.
    pub libraries: Vec<Library>,
    /// Which measurements are to be chosen, if any.
    pub plan: Option<Planning>,
    /// The history to which every run adds what it finds; relative paths start at the folder of the recipe.
    pub history: Option<HistoryPlace>,
    document: Document,
    origins: BTreeMap<String, Origin>,
    /// The keys of every stage that are not passed on to its plugin.
    reserved_keys: BTreeMap<String, Vec<&'static str>>,
}

/// Origin of settings that differ between the recipe and what the plugin gets.
#[derive(Debug, Clone, PartialEq)]
struct Origin {
    /// The file of a model.
    file: Option<Document>,
    /// The lists in which sets stood.
    expanded: Vec<Expanded>,
}

impl Origin {
    /// The way in the recipe to an entry of a list in which sets stood, and the rest of the way to a setting.
    fn expanded<'a>(&'a self, setting: &'a [PathItem]) -> Option<(&'a [PathItem], &'a [PathItem])> {
        self.expanded.iter().find_map(|(list, entries)| match setting.strip_prefix(list.as_slice())? {
            [PathItem::Index(index), rest @ ..] => Some((entries.get(*index)?.as_slice(), rest)),
            _ => None,
        })
    }
}

/// A stage whose kind and plugin are known.
struct Head<'a> {
    name: &'a str,
    node: Node<'a>,
    plugin: &'a Plugin,
}

impl Recipe {
    /// Reads a recipe and the YAML files that its models name.
    ///
    /// Fails with the place, what was expected and the nearest valid spelling on anything that can be wrong in a recipe
    /// apart from the plugins' own settings.
    pub fn read(path: &Path, registry: &Registry) -> Result<Self, Error> {
        Self::parse(path, &read_text(path)?, registry)
    }

    /// Like [`Recipe::read`], of a text that is to be treated as the file at `path`.
    pub fn parse(path: &Path, text: &str, registry: &Registry) -> Result<Self, Error> {
        Self::of_document(path, text, Document::parse(path, text)?, registry)
    }

    fn of_document(path: &Path, text: &str, document: Document, registry: &Registry) -> Result<Self, Error> {
        let base = path.parent().unwrap_or(Path::new("")).to_owned();
        has_a_name(path)?;
        let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        // A folder of results is named after the recipe, and lies in the one that `--out` names.
        let id = stem.filter(|stem| !stem.chars().all(|letter| letter == '.')).unwrap_or_else(|| "recipe".to_owned());
        let root = document.root();
        check_top(&root)?;
        let name = root.get("name").map(|node| node.text()).transpose()?.unwrap_or(&id).to_owned();
        let libraries = libraries(&root, &base)?;
        let sets = Sets::read(&root)?;
        let history = root.get(HISTORY).map(|node| history(&node, &base)).transpose()?;
        let heads = heads(&root, registry)?;
        let mut ready = Vec::new();
        let mut nodes = Vec::new();
        let (mut origins, mut reserved_keys) = (BTreeMap::new(), BTreeMap::new());
        for head in &heads {
            reserved_keys.insert(head.name.to_owned(), head.reserved_keys());
            let (stage, origin, named) = head.read(&heads, &sets, &base).map_err(|error| error.stage(head.name))?;
            ready.push(Some(stage));
            nodes.push(named);
            origins.insert(head.name.to_owned(), origin);
        }
        let stages = graph::order(&heads, &nodes)?.into_iter().filter_map(|index| ready[index].take()).collect();
        let mut recipe = Self {
            path: path.to_owned(),
            base,
            text: text.to_owned(),
            name,
            id,
            stages,
            libraries,
            plan: None,
            history,
            document,
            origins,
            reserved_keys,
        };
        recipe.plan = recipe.planning()?;
        Ok(recipe)
    }

    /// The libraries that a recipe asks for. Nothing else of it is checked: its stages may need their plugins.
    pub fn libraries(path: &Path, text: &str) -> Result<Vec<Library>, Error> {
        libraries(&Document::parse(path, text)?.root(), path.parent().unwrap_or(Path::new("")))
    }

    /// What stands under `plan`; the stages that it names are there.
    fn planning(&self) -> Result<Option<Planning>, Error> {
        let Some(settings) = self.document.get(&[PathItem::Key(PLAN.to_owned())]) else { return Ok(None) };
        let plan: Planning = abbe_core::from_settings_in_range(settings).map_err(|error| self.plan_error(error))?;
        plan.check().map_err(|error| self.plan_error(error))?;
        for (key, name, kind) in
            [("estimate", &plan.estimate, Kind::Estimate), ("candidates", &plan.candidates, Kind::Artefact)]
        {
            let of_kind = || self.stages.iter().filter(|stage| stage.kind == kind).map(|stage| stage.name.as_str());
            if !of_kind().any(|stage| stage == name) {
                let message = format!("there is no stage `{name}` of the kind {kind}");
                return Err(self.plan_error(SettingsError::new(key, message).suggest(name, of_kind())));
            }
        }
        Ok(Some(plan))
    }
}

/// Refuses a recipe whose name is no text: results lie in a folder of its name, and two such names would be the same there.
fn has_a_name(path: &Path) -> Result<(), Error> {
    if path.file_stem().is_none_or(|stem| stem.to_str().is_some()) {
        return Ok(());
    }
    let message = "the name of this file is no text in UTF-8, and results lie in a folder of the name of their recipe";
    Err(Error::usage(message).in_file(path).help("give the file another name"))
}

fn read_text(path: &Path) -> Result<String, Error> {
    abbe_files::read_text(path, abbe_files::LARGEST_TEXT).map_err(|error| {
        let message = match error.kind() {
            std::io::ErrorKind::NotFound => format!("the file `{}` does not exist", path.display()),
            _ => format!("the file `{}` cannot be read: {}", path.display(), abbe_files::why(&error)),
        };
        Error::usage(message)
    })
}

/// Checks the version first: the format of other versions is not known here.
fn check_top(root: &Node<'_>) -> Result<(), Error> {
    root.map()?;
    let expected = format!("this program reads recipes of version {VERSION}");
    let Some(version) = root.get("abbe") else {
        return Err(root.missing(&["abbe"], format!("the key `abbe` is missing: {expected}, `abbe: {VERSION}`")));
    };
    if version.value.as_u64() != Some(VERSION) {
        return Err(version.error(At::Value, format!("{expected}, not {}", version.value)));
    }
    root.only(&["abbe", "name", "sets", "plugins", "stages", PLAN, HISTORY])
}

/// Where a history is.
fn history(node: &Node<'_>, base: &Path) -> Result<HistoryPlace, Error> {
    let place = HistoryPlace::parse(node.text()?).map_err(|wrong| node.error(At::Value, wrong))?;
    Ok(match place {
        HistoryPlace::File(path) => HistoryPlace::File(base.join(path)),
        server => server,
    })
}

fn heads<'a>(root: &Node<'a>, registry: &'a Registry) -> Result<Vec<Head<'a>>, Error> {
    let Some(stages) = root.get("stages") else { return Err(root.error(At::Value, "the key `stages` is missing")) };
    let heads: Result<Vec<_>, Error> = stages
        .map()?
        .into_iter()
        .map(|(name, node)| {
            if name.len() > LONGEST_NAME {
                let message =
                    format!("the name of a stage has {} bytes; {LONGEST_NAME} at most are expected", name.len());
                return Err(node.error(At::Key, message));
            }
            if name.is_empty() || !name.chars().all(|c| c.is_alphanumeric() || c == '-' || c == '_') {
                let message = format!("`{name}` cannot name a stage: letters, digits, `-` and `_` were expected");
                return Err(node.error(At::Key, message));
            }
            let plugin = plugin(&node, registry).map_err(|error| error.stage(name))?;
            Ok(Head { name, node, plugin })
        })
        .collect();
    heads.and_then(|heads| match heads.is_empty() {
        true => Err(stages.error(At::Value, "stages: at least one stage was expected")),
        false => Ok(heads),
    })
}

/// The plugin that the one kind key of a stage names.
fn plugin<'a>(stage: &Node<'_>, registry: &'a Registry) -> Result<&'a Plugin, Error> {
    let keys = stage.map()?;
    let kinds: Vec<_> = keys
        .iter()
        .filter_map(|(key, node)| Some((Kind::ALL.into_iter().find(|kind| kind.key() == *key)?, node)))
        .collect();
    match kinds.as_slice() {
        [(kind, node)] => registry.find(*kind, node.text()?).map_err(|error| {
            let refused = node.error(At::Value, error.message);
            if let Some(help) = error.help { refused.help(help) } else { refused }
        }),
        [] => {
            let all = Kind::ALL.map(Kind::key);
            Err(stage.missing(&all, format!("one of the keys {} was expected: the kind of the stage", all.join(", "))))
        }
        [(first, _), (second, node), ..] => {
            Err(node.error(At::Key, format!("a stage is of one kind; this one has `{first}` and `{second}`")))
        }
    }
}

impl<'a> Head<'a> {
    /// The keys that are not passed on to the plugin.
    fn reserved_keys(&self) -> Vec<&'static str> {
        let own: &[&'static str] = match self.plugin.kind() {
            Kind::Model => &["file"],
            Kind::Artefact => &ROW_SETTINGS,
            Kind::Estimate if self.plugin.estimate_source == EstimateSource::Measurements => {
                &[SHARED_ROWS, PLAUSIBLE, TIE, PER]
            }
            Kind::Estimate => &[SHARED_ROWS],
            _ => &[],
        };
        graph::references(self.plugin).iter().map(|reference| reference.key).chain(own.iter().copied()).collect()
    }

    /// The stage, where its settings come from, and the places of its references.
    fn read(&self, heads: &[Self], sets: &Sets<'a>, base: &Path) -> Result<(Stage, Origin, Vec<Node<'a>>), Error> {
        let kind = self.plugin.kind();
        let mut references = BTreeMap::new();
        let mut nodes = Vec::new();
        let known = graph::references(self.plugin);
        for reference in known {
            let named = reference.read(self, heads)?;
            let names: Vec<String> = named.iter().filter_map(|node| node.value.as_str()).map(str::to_owned).collect();
            if !names.is_empty() {
                references.insert(reference.key.to_owned(), names);
            }
            nodes.extend(named);
        }
        let mut settings = Map::new();
        let mut row_settings = Map::new();
        let (mut parameters, mut ties) = (Vec::new(), Vec::new());
        let mut shared_rows = false;
        let mut plausible = Value::Object(Map::new());
        let mut per = None;
        let mut origin = Origin { file: None, expanded: Vec::new() };
        for (key, node) in self.node.map()? {
            if key == kind.key() || known.iter().any(|reference| reference.key == key) {
                continue;
            }
            if kind == Kind::Model && key == "file" {
                origin.file = Some(read_description(&node, base)?);
            } else if kind == Kind::Estimate && key == "parameters" {
                let patterns = sets.expand(node.list()?)?;
                let texts = patterns.iter().map(|pattern| pattern.text().map(str::to_owned));
                parameters = texts.collect::<Result<_, _>>()?;
                let places = patterns.into_iter().map(|pattern| pattern.path).collect();
                origin.expanded.push((vec![PathItem::Key(key.to_owned())], places));
            } else if self.reserved_keys().contains(&TIE) && key == TIE {
                ties = ties::read(&node)?;
            } else if self.reserved_keys().contains(&PER) && key == PER {
                per = Some(node.text()?.to_owned());
            } else if kind == Kind::Estimate && key == SHARED_ROWS {
                if node.text()? != ACCEPTED {
                    return Err(node.error(At::Value, format!("`{ACCEPTED}` was expected, or nothing")));
                }
                shared_rows = true;
            } else if kind == Kind::Estimate
                && key == PLAUSIBLE
                && self.plugin.estimate_source == EstimateSource::Measurements
            {
                plausible = node.value.clone();
            } else if kind == Kind::Artefact && ROW_SETTINGS.contains(&key) {
                row_settings.insert(key.to_owned(), node.value.clone());
            } else {
                let path = vec![PathItem::Key(key.to_owned())];
                settings.insert(key.to_owned(), with_sets(&node, path, sets, &mut origin.expanded)?);
            }
        }
        if graph::is_analysis(self) {
            for key in ["machine", "observations", "parameters", TIE, PER, "known", "start"] {
                if let Some(node) = self.node.get(key) {
                    let message = format!("`{key}` comes from the estimate that `{}` names", graph::ANALYSED);
                    return Err(node.error(At::Key, message));
                }
            }
        } else if kind == Kind::Estimate && self.plugin.estimate_source != EstimateSource::Measurements {
            let takes_parameters = self.plugin.estimate_source == EstimateSource::Combination;
            if let Some(node) = self.node.get("parameters").filter(|_| !takes_parameters) {
                let message = format!("`{}` estimates nothing: it takes what it is given", self.plugin.name);
                return Err(node.error(At::Key, message));
            }
        } else if kind == Kind::Estimate && self.node.get("parameters").is_none() {
            let keys = self.node.map()?;
            if let Some(near) = nearest("parameters", keys.iter().map(|(key, _)| *key))
                && let Some((_, node)) = keys.iter().find(|(key, _)| *key == near)
            {
                let message = format!("`{near}` is no setting of an estimate, and `parameters` is missing");
                return Err(node.error(At::Key, message).help("did you mean `parameters`?"));
            }
            let error = self.node.error(At::Key, "the setting `parameters` is missing: what is to be estimated?");
            return Err(error.help("`parameters: []` takes the machine as it is"));
        }
        let mut settings = Value::Object(settings);
        if let Some(file) = &origin.file {
            settings = merge(Value::Object(self.described(file)?), settings);
        }
        let files = origin.file.iter().map(|file| file.file.clone()).collect();
        let (name, plugin) = (self.name.to_owned(), self.plugin.name.to_string());
        let row_settings = Value::Object(row_settings);
        let estimate_source = self.plugin.estimate_source;
        let stage = Stage {
            name,
            kind,
            plugin,
            estimate_source,
            settings,
            parameters,
            ties,
            row_settings,
            shared_rows,
            plausible,
            per,
            references,
            files,
        };
        Ok((stage, origin, nodes))
    }

    /// The settings in the file of a model. Keys that the plugin does not know are notes. A key that looks like a misspelt
    /// setting is an error: the setting would be ignored without a message.
    fn described(&self, file: &Document) -> Result<Map<String, Value>, Error> {
        let schema = self.plugin.schema.get();
        let known = schema.get("properties").and_then(Value::as_object);
        let mut described = Map::new();
        let root = file.root();
        for (key, node) in root.map()? {
            let Some(known) = known.filter(|known| !known.contains_key(key)) else {
                described.insert(key.to_owned(), node.value.clone());
                continue;
            };
            let absent = known.keys().map(String::as_str).filter(|setting| root.get(setting).is_none());
            if let Some(near) = nearest(key, absent) {
                let error = node.error(At::Key, format!("`{key}` is no setting of `{}`", self.plugin.name));
                return Err(error.help(format!("did you mean `{near}`? a note needs another name")));
            }
        }
        Ok(described)
    }
}
