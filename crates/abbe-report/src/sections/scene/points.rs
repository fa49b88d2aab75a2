//! Points of the viewer as little-endian numbers: small, and as the graphics card takes them.

use serde_json::{Value, json};

use crate::base64::base64;
use crate::residuals::Residual;

/// Numbers of some ranges, each as a part of its range in 16 bits.
struct Parts {
    ranges: Vec<[f64; 2]>,
    bytes: Vec<u8>,
}

impl Parts {
    /// Of rows of `width` numbers; what is not finite is at the start of its range.
    fn of<'a>(width: usize, rows: impl Iterator<Item = &'a [f64]> + Clone) -> Self {
        let mut ranges = vec![[f64::INFINITY, f64::NEG_INFINITY]; width];
        for row in rows.clone() {
            for ([from, to], number) in ranges.iter_mut().zip(row).filter(|(_, number)| number.is_finite()) {
                (*from, *to) = (from.min(*number), to.max(*number));
            }
        }
        for range in ranges.iter_mut().filter(|[from, to]| from > to) {
            *range = [0.0, 0.0];
        }
        let mut bytes = Vec::new();
        for row in rows {
            for ([from, to], number) in ranges.iter().zip(row) {
                let part = if to > from && number.is_finite() { (number - from) / (to - from) } else { 0.0 };
                bytes.extend(((part * f64::from(u16::MAX)).round() as u16).to_le_bytes());
            }
        }
        Self { ranges, bytes }
    }

    fn json(&self) -> Value {
        json!({ "ranges": self.ranges, "parts": base64(&self.bytes) })
    }
}

/// What the script needs of every point, and the commands of so many axes.
pub fn packed(rows: &[&Residual], axes: usize) -> Value {
    let tips: Vec<[f64; 3]> = rows.iter().map(|row| row.tip.unwrap_or_default()).collect();
    let (mut directions, mut values, mut over, mut lines, mut texts) =
        <(Vec<u8>, Vec<u8>, Vec<u8>, Vec<u8>, Vec<u8>)>::default();
    let mut names: Vec<&str> = Vec::new();
    for row in rows {
        for part in row.direction.unwrap_or_default() {
            directions.extend(((part * f64::from(i8::MAX)).round() as i8).to_le_bytes());
        }
        // Rows of four bytes are read fastest.
        directions.push(0);
        values.extend((row.value as f32).to_le_bytes());
        over.extend(((row.normalised() * 100.0).round() as i16).to_le_bytes());
        [row.line as u32, row.row as u32].iter().for_each(|number| lines.extend(number.to_le_bytes()));
        for text in [row.stage.as_str(), row.file.as_str()] {
            let known = names.iter().position(|name| *name == text).unwrap_or_else(|| {
                names.push(text);
                names.len() - 1
            });
            texts.extend((known as u16).to_le_bytes());
        }
    }
    json!({
        "count": rows.len(),
        "tips": Parts::of(3, tips.iter().map(<[f64; 3]>::as_slice)).json(),
        "commands": Parts::of(axes, rows.iter().map(|row| row.commands.as_slice())).json(),
        "directions": base64(&directions),
        "values": base64(&values),
        "over": base64(&over),
        "lines": base64(&lines),
        "texts": base64(&texts),
        "names": names,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_parts_of_their_ranges() {
        let rows = [[0.0, 5.0, f64::NAN], [10.0, 5.0, f64::NAN], [2.5, 5.0, 7.0]];
        let parts = Parts::of(3, rows.iter().map(<[f64; 3]>::as_slice));
        assert_eq!(parts.ranges, [[0.0, 10.0], [5.0, 5.0], [7.0, 7.0]]);
        let numbers: Vec<u16> = parts.bytes.chunks(2).map(|two| u16::from_le_bytes([two[0], two[1]])).collect();
        assert_eq!(numbers, [0, 0, 0, 65535, 0, 0, 16384, 0, 0]);
        assert_eq!(Parts::of(1, std::iter::empty()).ranges, [[0.0, 0.0]]);
    }
}
