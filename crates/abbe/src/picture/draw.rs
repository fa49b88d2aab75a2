//! Lines, arrows and words of an SVG, and how space is seen in it.

use std::fmt::Write;

use crate::effects::norm;

/// Colours of x, y and z.
pub const COLOURS: [&str; 3] = ["#b3261e", "#1e7a3c", "#1f4fa8"];

/// Colour of the side of the workpiece and of that of the tool.
pub const SIDES: [&str; 2] = ["#c77700", "#0b6b75"];

/// Colour of what is not in front.
pub const GREY: &str = "#8a8f98";

/// How x, y, z are seen: x to the right and a little to the front, y to the back, z up; in the directions of the page.
const SEEN: [[f64; 2]; 3] = [[0.92, 0.26], [0.56, -0.42], [0.0, -0.94]];

/// A direction in space on the page.
pub fn seen(of: [f64; 3]) -> [f64; 2] {
    [0, 1].map(|part| (0..3).map(|axis| of[axis] * SEEN[axis][part]).sum())
}

/// A drawing under way.
#[derive(Default)]
pub struct Drawing {
    body: String,
}

impl Drawing {
    /// The whole file.
    pub fn finished(self, width: f64, height: f64, title: &str) -> String {
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
             viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"Helvetica, Arial, 'DejaVu Sans', sans-serif\" \
             font-size=\"12\">\n<title>{}</title>\n<rect width=\"{width:.0}\" height=\"{height:.0}\" fill=\"white\"/>\n{}</svg>\n",
            escaped(title),
            self.body
        )
    }

    /// A line; `dashed` for what is only thought of.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], colour: &str, width: f64, dashed: bool) {
        let dash = if dashed { " stroke-dasharray=\"6 4\"" } else { "" };
        let _ = writeln!(
            self.body,
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{colour}\" stroke-width=\"{width}\"{dash}/>",
            from[0], from[1], to[0], to[1]
        );
    }

    /// An area with an edge.
    pub fn area(&mut self, corners: &[[f64; 2]], fill: &str, edge: &str) {
        let corners: Vec<String> = corners.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
        let _ = writeln!(self.body, "<polygon points=\"{}\" fill=\"{fill}\" stroke=\"{edge}\"/>", corners.join(" "));
    }

    /// A box.
    pub fn area_of(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], fill: &str, edge: &str) {
        self.area(&[[x, y], [x + width, y], [x + width, y + height], [x, y + height]], fill, edge);
    }

    /// A dot.
    pub fn dot(&mut self, [x, y]: [f64; 2], radius: f64, colour: &str) {
        let _ = writeln!(self.body, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{colour}\"/>");
    }

    /// An arrow: the line and its head. Too short a one is a dot.
    pub fn arrow(&mut self, from: [f64; 2], to: [f64; 2], colour: &str, width: f64) {
        let along = [to[0] - from[0], to[1] - from[1]];
        let length = along[0].hypot(along[1]);
        if length < 1.5 {
            return self.dot(from, 2.0, colour);
        }
        let head = (3.0 + 2.2 * width).min(0.7 * length);
        let unit = along.map(|part| part / length);
        let neck = [to[0] - unit[0] * head, to[1] - unit[1] * head];
        let side = [-unit[1] * head * 0.45, unit[0] * head * 0.45];
        self.line(from, neck, colour, width, false);
        self.area(
            &[to, [neck[0] + side[0], neck[1] + side[1]], [neck[0] - side[0], neck[1] - side[1]]],
            colour,
            colour,
        );
    }

    /// A turn about a direction in space, right-handed: an arc with a head around its line, as it is seen.
    pub fn turn(&mut self, centre: [f64; 2], about: [f64; 3], radius: f64, colour: &str, width: f64) {
        let [one, other] = across(about);
        let at = |angle: f64| {
            let around = [0, 1, 2].map(|part| radius * (one[part] * angle.cos() + other[part] * angle.sin()));
            let on_page = seen(around);
            [centre[0] + on_page[0], centre[1] + on_page[1]]
        };
        let steps = 28;
        let angle = |step: usize| -0.6 + 4.6 * step as f64 / steps as f64;
        for step in 1..steps {
            self.line(at(angle(step - 1)), at(angle(step)), colour, width, false);
        }
        self.arrow(at(angle(steps - 2)), at(angle(steps)), colour, width);
    }

    /// Words; `anchor` is `start`, `middle` or `end`.
    pub fn text(&mut self, [x, y]: [f64; 2], text: &str, anchor: &str, style: &str) {
        let _ = writeln!(
            self.body,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" {style}>{}</text>",
            escaped(text)
        );
    }

    /// The directions x, y, z of a frame on the page, with its unit vectors in space.
    pub fn frame(&mut self, origin: [f64; 2], axes: [[f64; 3]; 3], length: f64, letters: bool) {
        for (part, axis) in axes.iter().enumerate() {
            let on_page = seen(axis.map(|part| part * length));
            let to = [origin[0] + on_page[0], origin[1] + on_page[1]];
            self.arrow(origin, to, COLOURS[part], 1.4);
            if letters {
                let beyond = [origin[0] + on_page[0] * 1.25, origin[1] + on_page[1] * 1.25 + 4.0];
                self.text(beyond, ["x", "y", "z"][part], "middle", &format!("fill=\"{}\"", COLOURS[part]));
            }
        }
    }

    /// What follows is shown when a pointer rests on it.
    pub fn group(&mut self, title: &str, inside: impl FnOnce(&mut Self)) {
        let _ = writeln!(self.body, "<g><title>{}</title>", escaped(title));
        inside(self);
        self.body.push_str("</g>\n");
    }
}

/// Two unit vectors across a direction, which make a right-handed frame with it.
fn across(about: [f64; 3]) -> [[f64; 3]; 2] {
    let least = (0..3).min_by(|a, b| about[*a].abs().total_cmp(&about[*b].abs())).unwrap_or(0);
    let mut help = [0.0; 3];
    help[least] = 1.0;
    let unit = |of: [f64; 3]| of.map(|part| part / norm(of).max(1e-12));
    let about = unit(about);
    let one = unit(cross(help, about));
    [one, cross(about, one)]
}

/// The vector product.
pub fn cross([a, b, c]: [f64; 3], [x, y, z]: [f64; 3]) -> [f64; 3] {
    [b * z - c * y, c * x - a * z, a * y - b * x]
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
