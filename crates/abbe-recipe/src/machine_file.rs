//! Machine descriptions in files of their own, which model stages name.

use std::path::Path;

use abbe_core::Error;
use serde_json::Value;

use crate::document::{At, Document, Node};
use crate::read_text;

/// The machine description that a `file` setting names.
pub(crate) fn read_description(node: &Node<'_>, base: &Path) -> Result<Document, Error> {
    let path = base.join(node.text()?);
    let text = read_text(&path).map_err(|error| node.error(At::Value, error.message))?;
    let document = Document::parse(&path, &text)?;
    document.root().map()?;
    Ok(document)
}

/// The content of a machine file.
///
/// # Errors
/// A file that cannot be read, and YAML that is wrong or no map, with line and column.
pub fn machine_description(file: &Path) -> Result<Value, Error> {
    let text = read_text(file).map_err(|error| error.in_file(file))?;
    let document = Document::parse(file, &text)?;
    document.root().map()?;
    Ok(document.value)
}

/// Maps are merged, anything else of `over` replaces what is `under` it.
pub(crate) fn merge(under: Value, over: Value) -> Value {
    match (under, over) {
        (Value::Object(mut under), Value::Object(over)) => {
            for (key, value) in over {
                let value = match under.get_mut(&key) {
                    Some(old) => merge(old.take(), value),
                    None => value,
                };
                under.insert(key, value);
            }
            Value::Object(under)
        }
        (_, over) => over,
    }
}
