//! The combinations of variables that a family has a job for.

use std::path::Path;

use abbe_core::{Error, Result};
use abbe_recipe::yaml::{At, Node};
use serde_json::Value;

use crate::text::Variables;

/// One combination: its variables, and the values of those that name the job.
#[derive(Debug, Clone, Default)]
pub struct Combination {
    /// All variables.
    pub variables: Variables,
    /// The values that stand in its name.
    pub named: Vec<Value>,
}

/// Most jobs of a fleet.
pub const MOST_JOBS: usize = 1_000_000;

/// Bytes of the largest table of machines: 256 MiB.
const LARGEST_TABLE: u64 = 256 << 20;

/// Bytes of the longest cell: 64 KiB, as in tables of measurements.
const LONGEST_CELL: usize = 64 << 10;

/// Most cells of a row.
const MOST_CELLS: usize = 1 << 17;

/// What stands under `for`: every value of each variable with every value of the others, the last one fastest. `folder` is that of the
/// fleet.
pub fn read(node: Option<&Node<'_>>, folder: &Path) -> Result<Vec<Combination>> {
    let mut all = vec![Combination::default()];
    let Some(node) = node else { return Ok(all) };
    for (name, node) in node.map()? {
        let is_name = |letter: char| letter.is_alphanumeric() || matches!(letter, '_' | '-');
        if name.is_empty() || !name.chars().all(is_name) {
            let message = format!("`{name}` cannot name a variable: letters, digits, `-` and `_` were expected");
            return Err(node.error(At::Key, message));
        }
        let values = if node.value.is_object() { table(name, &node, folder)? } else { list(name, &node)? };
        if values.is_empty() {
            return Err(node.error(At::Value, format!("{name}: at least one value was expected")));
        }
        if all.len().saturating_mul(values.len()) > MOST_JOBS {
            let message = format!("these are more than {MOST_JOBS} jobs, the most of a fleet");
            return Err(node.error(At::Key, message).help("make a fleet for each week, or for each hall"));
        }
        let before = all.first().map(|first| first.variables.clone()).unwrap_or_default();
        if let Some(twice) = values[0].0.keys().find(|name| before.contains_key(*name)) {
            return Err(node.error(At::Key, format!("the variable `{twice}` is there already")));
        }
        let with = |one: &Combination, (variables, value): &(Variables, Value)| {
            let mut made = one.clone();
            made.variables.extend(variables.clone());
            made.named.push(value.clone());
            made
        };
        all = all.iter().flat_map(|one| values.iter().map(move |value| with(one, value))).collect();
    }
    Ok(all)
}

/// The values of a list.
fn list(name: &str, node: &Node<'_>) -> Result<Vec<(Variables, Value)>> {
    let value = |item: Node<'_>| match item.value {
        Value::String(_) | Value::Number(_) => {
            Ok((Variables::from_iter([(name.to_owned(), item.value.clone())]), item.value.clone()))
        }
        _ => Err(item.error(At::Value, format!("{name}: texts or numbers were expected"))),
    };
    node.list()?.into_iter().map(value).collect()
}

/// The rows of a table in CSV: each of its columns is a variable. A cell that is written as a number is one.
fn table(name: &str, node: &Node<'_>, folder: &Path) -> Result<Vec<(Variables, Value)>> {
    node.only(&["table"])?;
    let Some(file) = node.get("table") else {
        return Err(node.missing(&["table"], "a list of values was expected, or `{ table: machines.csv }`"));
    };
    let path = folder.join(file.text()?);
    let unreadable = |why: String| file.error(At::Value, format!("{} cannot be read: {why}", path.display()));
    let text = abbe_files::read_text(&path, LARGEST_TABLE).map_err(|error| unreadable(abbe_files::why(&error)))?;
    if let Some(at) = text.bytes().position(|byte| byte == 0) {
        let line = 1 + text.as_bytes()[..at].iter().filter(|byte| **byte == b'\n').count();
        let error = Error::usage("a zero byte stands here: this is no text, or it is damaged").at(&path, line, None);
        return Err(error.help("write the table again"));
    }
    // Before any cell is made of a row: each would take room.
    for (line, row) in text.lines().enumerate().filter(|(_, row)| row.len() > MOST_CELLS) {
        let cells = row.bytes().filter(|byte| *byte == b',').count() + 1;
        if cells > MOST_CELLS {
            let message = format!("this is no table: the row has {cells} cells; at most {MOST_CELLS} are read");
            return Err(Error::usage(message).at(&path, line + 1, None).help("each row needs a line of its own"));
        }
    }
    // A quotation mark that nothing closes takes the last line end, too.
    let text = text + "\n";
    let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).flexible(true).from_reader(text.as_bytes());
    let at = |error: &csv::Error| {
        let line = error.position().map_or(1, |position| position.line() as usize);
        Error::usage(format!("this is no table: {error}"))
            .at(&path, line, None)
            .help("a row of names and then rows of values were expected, separated by commas, as UTF-8")
    };
    let header = reader.headers().map_err(|error| at(&error)).and_then(|header| {
        within_bounds(header, (&path, &text))?;
        Ok(header.iter().map(|name| name.trim().to_owned()).collect::<Vec<_>>())
    })?;
    let Some(column) = header.iter().position(|own| own == name) else {
        let message = format!("{} has no column `{name}`", path.display());
        return Err(file.error(At::Value, message).suggest(name, header.iter().map(String::as_str)));
    };
    if let Some(twice) = header.iter().enumerate().find(|(index, own)| header[..*index].contains(own)) {
        let message = format!("the column `{}` is there twice", twice.1);
        return Err(Error::usage(message).at(&path, 1, None).help("give each column a name of its own"));
    }
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| at(&error))?;
        within_bounds(&record, (&path, &text))?;
        if record.len() != header.len() {
            let message =
                format!("this is no table: the row has {} cells; {} were expected", record.len(), header.len());
            let error = Error::usage(message).at(&path, line_of(&record, &text), None);
            return Err(error
                .help("correct the row: a comma is missing there or one too many, or a text with one is not quoted"));
        }
        let cells: Variables = header.iter().cloned().zip(record.iter().map(cell)).collect();
        let value = record.get(column).map(cell).unwrap_or_default();
        if value == "" {
            let error = Error::usage(format!("`{name}` is empty here")).at(&path, line_of(&record, &text), None);
            return Err(error.help("write its value, or remove the row"));
        }
        rows.push((cells, value));
    }
    Ok(rows)
}

/// The line in which a row begins. The reader counts blank lines and remarks before a row as a part of it.
fn line_of(record: &csv::StringRecord, text: &str) -> usize {
    let Some(position) = record.position() else { return 1 };
    let rest = text.get(position.byte() as usize..).unwrap_or_default();
    let is_before_it = |line: &&str| line.is_empty() || line.starts_with('#');
    position.line() as usize + rest.lines().take_while(is_before_it).count()
}

/// Fails for a cell over several lines, which a quotation mark makes that nothing closes, and for one that is too long.
fn within_bounds(record: &csv::StringRecord, (path, text): (&Path, &str)) -> Result<()> {
    let wrong =
        |message: String, help: &str| Err(Error::usage(message).at(path, line_of(record, text), None).help(help));
    for (cell, number) in record.iter().zip(1..) {
        if cell.contains(['\n', '\r']) {
            let message = format!("cell {number} of the row that begins here goes over several lines");
            return wrong(message, "is a quotation mark not closed?");
        }
        if cell.len() > LONGEST_CELL {
            let (length, most) = (cell.len().div_ceil(1 << 10), LONGEST_CELL >> 10);
            return wrong(format!("cell {number} has {length} KiB; at most {most} are read"), "shorten it");
        }
    }
    Ok(())
}

/// A number if it is written as one and nothing of it would be lost; `007` is a text.
fn cell(text: &str) -> Value {
    let text = text.trim();
    let number = serde_json::from_str::<serde_json::Number>(text).ok();
    let number = number.filter(|number| number.to_string().as_str() == text);
    number.map_or_else(|| Value::String(text.to_owned()), Value::Number)
}

#[cfg(test)]
mod tests {
    use abbe_recipe::yaml::Document;
    use serde_json::json;

    use super::*;

    fn combinations(folder: &Path, text: &str) -> Result<Vec<Combination>> {
        let document = Document::parse(Path::new("fleet.yaml"), text)?;
        read(Some(&document.root()), folder)
    }

    #[test]
    fn zero_bytes_are_no_rows() {
        let folder = tempfile::tempdir().unwrap();
        for content in ["q\n1\n2\n\0\0\0", "q\n\0\0a\n", "\0\0\0\0"] {
            std::fs::write(folder.path().join("z.csv"), content).unwrap();
            let error = combinations(folder.path(), "q: { table: z.csv }\n").unwrap_err();
            assert!(error.message.contains("zero byte"), "{content:?}: {error}");
        }
    }

    #[test]
    fn cells_stay_on_their_line_and_below_64_kib() {
        let folder = tempfile::tempdir().unwrap();
        let long = |length: usize| format!("q,r\n{},1\n", "a".repeat(length));
        for (content, said) in [
            ("q,r\n\"a,1\nb,2\n".to_owned(), "z.csv:2: cell 1 of the row"),
            ("q,r\na,1\n\nb,\"2".to_owned(), "z.csv:4: cell 2 of the row"),
            ("q,\"r\na,1\n".to_owned(), "z.csv:1: cell 2 of the row"),
            (long(65_537), "z.csv:2: cell 1 has 65 KiB; at most 64"),
            (format!("q,{}\na,1\n", "r".repeat(70_000)), "z.csv:1: cell 2 has 69 KiB"),
        ] {
            std::fs::write(folder.path().join("z.csv"), content).unwrap();
            let error = combinations(folder.path(), "q: { table: z.csv }\n").unwrap_err().to_string();
            assert!(error.contains(said), "{said}: {error}");
        }
        for content in [long(65_536), "q , r\n \"a\", 5\" plate \r\nb,\"x, y\"".to_owned()] {
            std::fs::write(folder.path().join("z.csv"), content).unwrap();
            combinations(folder.path(), "q: { table: z.csv }\n").unwrap();
        }
    }

    #[test]
    fn every_value_meets_every_other() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("m.csv"), "# ours\nmachine,serial,row\na,007,1\nb,12,2\n").unwrap();
        let all = combinations(folder.path(), "machine: { table: m.csv }\nweek: [1, 2]\n").unwrap();
        let named: Vec<Value> = all.iter().map(|one| json!(one.named)).collect();
        assert_eq!(named, [json!(["a", 1]), json!(["a", 2]), json!(["b", 1]), json!(["b", 2])]);
        assert_eq!(json!(all[1].variables), json!({ "machine": "a", "serial": "007", "row": 1, "week": 2 }));
    }

    #[test]
    fn what_is_wrong_has_its_place() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("m.csv"), "machine,week\na,1\n,2\n").unwrap();
        std::fs::write(folder.path().join("broken.csv"), "machine,week\na,1,2\n").unwrap();
        for (text, said) in [
            ("a: []\n", "fleet.yaml:1:4: a: at least one"),
            ("a: [[1]]\n", "fleet.yaml:1:5: a: texts or numbers"),
            ("a: 1\n", "fleet.yaml:1:4: a: a list was expected"),
            ("'a b': [1]\n", "fleet.yaml:1:1: `a b` cannot name"),
            ("machine: { tabel: m.csv }\n", "did you mean `table`?"),
            ("machine: { table: n.csv }\n", "fleet.yaml:1:19: "),
            ("machnie: { table: m.csv }\n", "did you mean `machine`?"),
            ("machine: { table: m.csv }\n", "m.csv:3: `machine` is empty"),
            ("machine: { table: broken.csv }\n", "broken.csv:2: this is no table"),
            ("week: [1]\nmachine: { table: m.csv }\n", "`machine` is empty"),
        ] {
            let error = combinations(folder.path(), text).unwrap_err().to_string();
            assert!(error.contains(said), "{text}: {error}");
        }
        std::fs::write(folder.path().join("m.csv"), "machine,week\na,1\n").unwrap();
        let error = combinations(folder.path(), "week: [1]\nmachine: { table: m.csv }\n").unwrap_err().to_string();
        assert!(error.contains("fleet.yaml:2:1: the variable `week` is there already"), "{error}");
        let many: Vec<String> = (0..1001).map(|value| value.to_string()).collect();
        let error = combinations(folder.path(), &format!("a: [{0}]\nb: [{0}]\n", many.join(","))).unwrap_err();
        assert!(error.message.contains("the most of a fleet"), "{error}");
    }
}
