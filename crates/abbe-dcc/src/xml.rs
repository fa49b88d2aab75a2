//! Elements by their names, with errors that say the line.

use std::path::Path;

use abbe_core::{Error, Result};
use roxmltree::{Document, Node, TextPos};

/// A document and its file.
pub(crate) struct Xml<'a> {
    pub(crate) file: &'a Path,
    pub(crate) document: &'a Document<'a>,
}

/// The document of a text. A DTD is refused, and with it every entity of its own.
pub(crate) fn document<'a>(file: &Path, text: &'a str) -> Result<Document<'a>> {
    let document = Document::parse(text).map_err(|error| {
        let place = error.pos();
        let message = match error {
            roxmltree::Error::DtdDetected => "the certificate has a DTD, which is not read".to_owned(),
            error => format!("the certificate is no XML: {error}"),
        };
        let error = Error::data(message).at(file, place.row as usize, Some(place.col as usize));
        error.help("take the file as the laboratory issued it")
    })?;
    match divided(&document) {
        None => Ok(document),
        Some(place) => Err(Error::data("a comment inside of a text")
            .at(file, place.row as usize, Some(place.col as usize))
            .help("take the file as the laboratory issued it")),
    }
}

/// Where a comment, or an instruction, stands inside of a text: whoever reads its first piece would lose the others.
fn divided(document: &Document<'_>) -> Option<TextPos> {
    let is_between = |node: &Node<'_, '_>| node.is_comment() || node.is_pi();
    let is_text = |node: Option<Node<'_, '_>>| {
        node.is_some_and(|node| node.is_text() && node.text().is_some_and(|text| !text.trim().is_empty()))
    };
    let divides = |node: &Node<'_, '_>| {
        let before = node.prev_siblings().find(|node| !is_between(node));
        is_between(node) && is_text(before) && is_text(node.next_siblings().find(|node| !is_between(node)))
    };
    document.descendants().find(divides).map(|node| document.text_pos_at(node.range().start))
}

/// The children with a name.
pub(crate) fn children<'a, 'input>(node: Node<'a, 'input>, name: &str) -> impl Iterator<Item = Node<'a, 'input>> {
    node.children().filter(move |child| child.tag_name().name() == name)
}

/// The first child with one of several names.
pub(crate) fn child<'a, 'input>(node: Node<'a, 'input>, names: &[&str]) -> Option<Node<'a, 'input>> {
    node.children().find(|child| names.contains(&child.tag_name().name()))
}

/// The element at the end of a path of names.
pub(crate) fn at<'a, 'input>(node: Node<'a, 'input>, path: &[&str]) -> Option<Node<'a, 'input>> {
    path.iter().try_fold(node, |node, name| child(node, &[name]))
}

/// The text of an element without the space around it.
pub(crate) fn text<'a>(node: Node<'a, '_>) -> &'a str {
    node.text().unwrap_or_default().trim()
}

/// The names of an element in all languages, English first.
pub(crate) fn names<'a>(node: Node<'a, '_>) -> Vec<&'a str> {
    let Some(name) = child(node, &["name"]) else { return Vec::new() };
    let mut contents: Vec<Node<'a, '_>> = children(name, "content").filter(|it| !text(*it).is_empty()).collect();
    contents.sort_by_key(|content| content.attribute("lang") != Some("en"));
    contents.into_iter().map(text).collect()
}

/// The words of the attribute `refType`.
pub(crate) fn ref_types<'a>(node: Node<'a, '_>) -> impl Iterator<Item = &'a str> {
    node.attribute("refType").unwrap_or_default().split_whitespace()
}

/// What stands in a message of a text of a file: short, and without control characters.
pub(crate) fn shown(text: &str) -> String {
    let short: String = text.chars().map(|letter| if letter.is_control() { '?' } else { letter }).take(60).collect();
    if text.chars().count() > 60 { format!("{short}...") } else { short }
}

impl Xml<'_> {
    /// The line of an element.
    pub(crate) fn line(&self, node: Node<'_, '_>) -> usize {
        self.document.text_pos_at(node.range().start).row as usize
    }

    /// An error at an element.
    pub(crate) fn wrong(&self, node: Node<'_, '_>, message: impl Into<String>) -> Error {
        let place = self.document.text_pos_at(node.range().start);
        Error::data(message).at(self.file, place.row as usize, Some(place.col as usize))
    }

    /// The numbers of an element, which are separated by space.
    pub(crate) fn numbers(&self, node: Node<'_, '_>) -> Result<Vec<f64>> {
        let number = |written: &str| {
            let is_written = written.bytes().all(|byte| byte.is_ascii_digit() || b"+-.eE".contains(&byte));
            let number = written.parse::<f64>().ok().filter(|number| is_written && number.is_finite());
            number.ok_or_else(|| {
                let name = node.tag_name().name();
                self.wrong(node, format!("`{}` in <{name}>; a number was expected", shown(written)))
            })
        };
        text(node).split_whitespace().map(number).collect()
    }
}
