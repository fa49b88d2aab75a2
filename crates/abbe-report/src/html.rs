//! Text that becomes part of a page.

use std::fmt::Write;

/// Text as HTML shows it: what comes from files cannot become markup. Control characters become blanks.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            '\n' | '\t' => escaped.push(letter),
            // Marks of the direction of writing reorder what follows them.
            '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => escaped.push('\u{fffd}'),
            letter if letter.is_control() => escaped.push(' '),
            letter => escaped.push(letter),
        }
    }
    escaped
}

/// A cell of a table.
pub enum Cell {
    /// Text, which is escaped.
    Text(String),
    /// A number or a figure: right-aligned text, which is escaped.
    Figure(String),
    /// HTML that is used as it is.
    Html(String),
}

impl Cell {
    /// A cell with text.
    pub fn text(text: impl Into<String>) -> Self {
        Self::Text(text.into())
    }

    /// A cell with a figure.
    pub fn figure(text: impl Into<String>) -> Self {
        Self::Figure(text.into())
    }
}

/// A table with a caption for screen readers; the first cell of each row is its heading.
pub fn table(caption: &str, head: &[&str], rows: &[Vec<Cell>]) -> String {
    let mut html = format!("<div class=\"scroll\"><table><caption>{}</caption><thead><tr>", escape(caption));
    let is_figure = |column: usize| {
        rows.iter().all(|row| !matches!(row.get(column), Some(Cell::Text(_) | Cell::Html(_)))) && !rows.is_empty()
    };
    for (column, name) in head.iter().enumerate() {
        let class = if is_figure(column) { " class=\"n\"" } else { "" };
        let _ = write!(html, "<th scope=\"col\"{class}>{}</th>", escape(name));
    }
    html.push_str("</tr></thead><tbody>\n");
    for row in rows {
        html.push_str("<tr>");
        for (column, cell) in row.iter().enumerate() {
            let tag = if column == 0 { "th scope=\"row\"" } else { "td" };
            let end = if column == 0 { "th" } else { "td" };
            let (class, content) = match cell {
                Cell::Text(text) => ("", escape(text)),
                Cell::Figure(text) => (" class=\"n\"", escape(text)),
                Cell::Html(html) => ("", html.clone()),
            };
            let _ = write!(html, "<{tag}{class}>{content}</{end}>");
        }
        html.push_str("</tr>\n");
    }
    html.push_str("</tbody></table></div>\n");
    html
}

/// A part of the page that can be opened.
pub fn details(summary: &str, open: bool, body: &str) -> String {
    let open = if open { " open" } else { "" };
    format!("<details{open}><summary>{}</summary>\n{body}</details>\n", escape(summary))
}

/// A paragraph of text.
pub fn paragraph(text: &str) -> String {
    format!("<p>{}</p>\n", escape(text))
}

/// A list of sentences; nothing if there are none.
pub fn list(items: &[String]) -> String {
    if items.is_empty() {
        return String::new();
    }
    let items: String = items.iter().map(|item| format!("<li>{}</li>\n", escape(item))).collect();
    format!("<ul>\n{items}</ul>\n")
}

/// A chart with its caption.
pub fn figure(svg: &str, caption: &str) -> String {
    format!("<figure>\n{svg}<figcaption>{}</figcaption>\n</figure>\n", escape(caption))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_from_files_becomes_markup() {
        assert_eq!(escape("<b a='1'>\"&\u{1b}[31m\u{202e}x"), "&lt;b a=&#39;1&#39;&gt;&quot;&amp; [31m\u{fffd}x");
        let told = table("a<b", &["<i>"], &[vec![Cell::text("<script>"), Cell::figure("1<2")]]);
        assert!(!told.contains("<script") && !told.contains("<i>") && told.contains("1&lt;2"), "{told}");
        assert!(details("</summary>", true, "").contains("&lt;/summary&gt;"));
        assert!(list(&["<li>".to_owned()]).contains("&lt;li&gt;"));
    }
}
