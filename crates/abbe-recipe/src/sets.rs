//! Named sets of parameter patterns, which can include each other.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{Error, PathItem};
use serde_json::{Map, Value};

use crate::document::{At, Node};

/// The sets of a recipe. None refers to an unknown set or, directly or through others, to itself.
pub(crate) struct Sets<'a>(BTreeMap<&'a str, Vec<Node<'a>>>);

impl<'a> Sets<'a> {
    /// Reads the top-level `sets`.
    pub fn read(root: &Node<'a>) -> Result<Self, Error> {
        let mut sets = Self(BTreeMap::new());
        let entries = root.get("sets").map_or_else(|| Ok(Vec::new()), |node| node.map())?;
        for (name, set) in &entries {
            let patterns = set.list()?;
            patterns.iter().try_for_each(|pattern| pattern.text().map(drop))?;
            sets.0.insert(name, patterns);
        }
        sets.check(entries.iter().map(|(name, _)| *name))?;
        Ok(sets)
    }

    /// Refuses unknown sets, and sets that include each other in a circle. Each set is looked at once.
    fn check(&self, names: impl Iterator<Item = &'a str>) -> Result<(), Error> {
        // Whether a set is done; those that are not are open.
        let mut done: BTreeMap<&str, bool> = BTreeMap::new();
        for name in names {
            if done.insert(name, false) == Some(true) {
                done.insert(name, true);
                continue;
            }
            let mut open = vec![(name, self.0[name].iter())];
            while let Some((name, nodes)) = open.last_mut() {
                let Some(node) = nodes.next() else {
                    done.insert(name, true);
                    open.pop();
                    continue;
                };
                let Some(other) = node.value.as_str().and_then(|text| text.strip_prefix('@')) else { continue };
                let set = self.named(other, node)?;
                match done.get(other) {
                    Some(true) => {}
                    Some(false) => {
                        let names = open.iter().map(|(name, _)| *name).skip_while(|name| *name != other);
                        let circle = names.chain([other]).collect::<Vec<_>>().join(" -> ");
                        return Err(node.error(At::Value, format!("the sets include each other in a circle: {circle}")));
                    }
                    None => {
                        done.insert(other, false);
                        open.push((other, set.iter()));
                    }
                }
            }
        }
        Ok(())
    }

    /// The set that an entry of a list names.
    fn named(&self, name: &str, node: &Node<'a>) -> Result<&Vec<Node<'a>>, Error> {
        self.0.get(name).ok_or_else(|| {
            let error = node.error(At::Value, format!("there is no set `{name}`"));
            error.suggest(name, self.0.keys().copied())
        })
    }

    /// The patterns of a list with sets in place of their names, each once.
    pub fn expand(&self, list: Vec<Node<'a>>) -> Result<Vec<Node<'a>>, Error> {
        let mut expanded = Vec::new();
        let mut seen = BTreeSet::new();
        let mut open = vec![list.into_iter()];
        while let Some(nodes) = open.last_mut() {
            let Some(node) = nodes.next() else {
                open.pop();
                continue;
            };
            let Some(text) = node.value.as_str() else {
                expanded.push(node); // not a pattern: the plugin will say so
                continue;
            };
            if let Some(name) = text.strip_prefix('@') {
                let set = self.named(name, &node)?;
                if seen.insert(text) {
                    open.push(set.clone().into_iter());
                }
            } else if seen.insert(text) {
                expanded.push(node);
            }
        }
        Ok(expanded)
    }
}

/// A list with sets in place of their names: its way in the settings, and the way in the recipe to each of its entries.
pub(crate) type Expanded = (Vec<PathItem>, Vec<Vec<PathItem>>);

/// A setting with sets in place of their names, in whatever list they stand; `expanded` gets the places of the entries of each such
/// list.
pub(crate) fn with_sets<'a>(
    node: &Node<'a>,
    path: Vec<PathItem>,
    sets: &Sets<'a>,
    expanded: &mut Vec<Expanded>,
) -> Result<Value, Error> {
    let below = |item: PathItem| path.iter().cloned().chain([item]).collect::<Vec<_>>();
    match node.value {
        Value::Array(list) => {
            let names_set = |value: &Value| value.as_str().is_some_and(|text| text.starts_with('@'));
            let nodes = match list.iter().any(names_set) {
                false => node.list()?,
                true => {
                    let nodes = sets.expand(node.list()?)?;
                    expanded.push((path.clone(), nodes.iter().map(|node| node.path.clone()).collect()));
                    nodes
                }
            };
            let entries = nodes.iter().enumerate();
            entries.map(|(index, entry)| with_sets(entry, below(PathItem::Index(index)), sets, expanded)).collect()
        }
        Value::Object(_) => {
            let mut map = Map::new();
            for (key, entry) in node.map()? {
                map.insert(key.to_owned(), with_sets(&entry, below(PathItem::Key(key.to_owned())), sets, expanded)?);
            }
            Ok(Value::Object(map))
        }
        _ => Ok(node.value.clone()),
    }
}
