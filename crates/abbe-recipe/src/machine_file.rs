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
    whole(Document::parse(&path, &text)?)
}

/// The document, unless it is no map, or a machine file that was cut off: a chain without axes, and without an end of its last line. The
/// machine would have its axes at the origin.
fn whole(document: Document) -> Result<Document, Error> {
    let has = |key: &str| document.root().map().map(|keys| keys.iter().any(|(own, _)| *own == key));
    match document.unended_line {
        Some(line) if has("chain")? && !has("axes")? => {
            let message = "the machine file ends here within a line, and has no `axes`: it looks cut off";
            let help = "take the whole file; if this is all of it, end its last line";
            Err(Error::usage(message).at(&document.file, line, None).help(help))
        }
        _ => {
            document.root().map()?;
            Ok(document)
        }
    }
}

/// The content of a machine file.
///
/// # Errors
/// A file that cannot be read, and YAML that is wrong or no map, with line and column.
pub fn machine_description(file: &Path) -> Result<Value, Error> {
    let text = read_text(file).map_err(|error| error.in_file(file))?;
    Ok(whole(Document::parse(file, &text)?)?.value)
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
