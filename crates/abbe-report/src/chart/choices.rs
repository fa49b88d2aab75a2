//! Choices beside each other, and measurements one after another.

use super::{Canvas, Scale, range};
use crate::number::short;

/// A choice: its name, its value, and whether it was taken.
pub struct Choice {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Whether it was taken.
    pub taken: bool,
}

/// A bar for every choice; that which was taken is marked.
pub fn choices(title: &str, unit: &str, all: &[Choice]) -> String {
    let (left, right, top, line) = (330.0, 700.0, 6.0, 17.0);
    let height = line * all.len() as f64;
    let mut canvas = Canvas::new(720.0, top + height + 36.0, title);
    let x = Scale::new(range(all.iter().map(|choice| choice.value).chain([0.0])), [left, right]);
    canvas.bottom(x, [top + height, top], 6, unit);
    for (index, choice) in all.iter().enumerate() {
        let y = top + line * index as f64;
        canvas.text(if choice.taken { "e n" } else { "e t" }, [left - 6.0, y + 12.0], &choice.name);
        canvas.rectangle("bar", [x.at(0.0), y + 3.0, x.at(choice.value) - x.at(0.0), line - 6.0]);
        if choice.taken {
            canvas.mark(1, [x.at(choice.value), y + line / 2.0], &format!("{}: {}", choice.name, short(choice.value)));
        }
    }
    canvas.svg()
}

/// What is measured from one time to another.
pub struct Span {
    /// Its name; the same name may come again.
    pub name: String,
    /// Beginning and end.
    pub times: [f64; 2],
}

/// Spans in the order of time up to `until`, each name on a line of its own. `marked` are names that stand above all others.
pub fn sequence(title: &str, unit: &str, (spans, until): (&[Span], f64), marked: &[String]) -> String {
    let mut names: Vec<&str> = marked.iter().map(String::as_str).collect();
    for span in spans {
        if !names.contains(&span.name.as_str()) {
            names.push(&span.name);
        }
    }
    let (left, right, top, line) = (110.0, 700.0, 6.0, 15.0);
    let height = line * names.len() as f64;
    let mut canvas = Canvas::new(720.0, top + height + 36.0, title);
    let ends = spans.iter().flat_map(|span| span.times).chain([until]);
    let x = Scale::new(range(ends), [left, right]);
    canvas.bottom(x, [top + height, top], 8, unit);
    for (index, name) in names.iter().enumerate() {
        let y = top + line * index as f64;
        let is_marked = index < marked.len();
        canvas.text(if is_marked { "e n" } else { "e t" }, [left - 6.0, y + 11.0], name);
        for span in spans.iter().filter(|span| span.name == **name) {
            let [from, to] = span.times.map(|time| x.at(time));
            canvas
                .rectangle(if is_marked { "gauge" } else { "bar" }, [from, y + 2.0, (to - from).max(2.0), line - 4.0]);
        }
    }
    canvas.svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_and_sequences() {
        let choice = |name: &str, value, taken| Choice { name: name.to_owned(), value, taken };
        let all = [choice("all candidates", 1.2, false), choice("without *T2:*", 1.1, true)];
        let span = |name: &str, from, to| Span { name: name.to_owned(), times: [from, to] };
        let spans = [span("1", 0.0, 5.0), span("7", 5.0, 9.0), span("1", 9.0, 14.0)];
        let bars = choices("Choices", "RMS", &all);
        assert!(bars.contains("without *T2:*: 1.100") && bars.matches("class=\"bar\"").count() == 2, "{bars}");
        let told = sequence("Order", "min", (&spans, 20.0), &["1".to_owned()]);
        // What is measured twice stands above all others, on one line.
        assert!(told.matches("class=\"gauge\"").count() == 2 && told.matches("class=\"bar\"").count() == 1, "{told}");
        assert!(told.find(">1</text>") < told.find(">7</text>"), "{told}");
    }
}
