//! A map over the directions from which a probe is touched.

use std::fmt::Write;

use super::Canvas;

/// Steps of the absolute value over the largest, weakest first; weaker ones are left white.
const STEPS: [f64; 5] = [0.1, 0.3, 0.5, 0.7, 0.9];

/// Degrees from cell to cell.
const CELL: usize = 10;

/// Values over a hemisphere seen along its axis: the pole in the middle, the equator outside. `value` takes azimuth and elevation in
/// degrees.
pub fn hemisphere(title: &str, unit: &str, value: impl Fn(f64, f64) -> f64) -> String {
    let (middle, radius) = ([150.0, 150.0], 118.0);
    let cells = || {
        (0..90 / CELL).flat_map(|ring| (0..360 / CELL).map(move |turn| ((turn * CELL) as f64, (ring * CELL) as f64)))
    };
    let half = CELL as f64 / 2.0;
    let at = |azimuth: f64, elevation: f64| value(azimuth + half, elevation + half);
    let most = cells().map(|(azimuth, elevation)| at(azimuth, elevation).abs()).fold(1e-9, f64::max);
    let mut canvas = Canvas::new(300.0, 346.0, title);
    let mut paths = vec![String::new(); 2 * STEPS.len()];
    for (azimuth, elevation) in cells() {
        let value = at(azimuth, elevation);
        let Some(step) = STEPS.iter().rposition(|least| value.abs() >= least * most) else { continue };
        let place = |azimuth: f64, elevation: f64| {
            let ((sine, cosine), out) = (azimuth.to_radians().sin_cos(), radius * (90.0 - elevation) / 90.0);
            format!("{} {}", super::coordinate(middle[0] + out * cosine), super::coordinate(middle[1] - out * sine))
        };
        let (next, above) = (azimuth + CELL as f64, elevation + CELL as f64);
        let corners = [place(azimuth, elevation), place(next, elevation), place(next, above), place(azimuth, above)];
        let path = &mut paths[2 * step + usize::from(value < 0.0)];
        let _ = write!(path, "M{}L{}L{}L{}z", corners[0], corners[1], corners[2], corners[3]);
    }
    for (index, path) in paths.iter().enumerate().filter(|(_, path)| !path.is_empty()) {
        canvas.raw_path(&format!("c{index}"), path);
    }
    for elevation in [0.0, 30.0, 60.0] {
        canvas.ring("g h", middle, radius * (90.0 - elevation) / 90.0, "");
    }
    for degrees in [0.0_f64, 90.0, 180.0, 270.0] {
        let (sine, cosine) = degrees.to_radians().sin_cos();
        canvas.text("m t", [middle[0] + 134.0 * cosine, middle[1] - 134.0 * sine + 4.0], &format!("{degrees:.0}°"));
    }
    for (index, sign) in ["+", "-"].iter().enumerate() {
        let x = 62.0 + 100.0 * index as f64;
        canvas.rectangle(&format!("c{}", 8 + index), [x, 318.0, 12.0, 12.0]);
        canvas.text("t", [x + 18.0, 328.0], &format!("{sign}{} {unit}", super::tick_label(most)));
    }
    canvas.svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_lobes_are_seen() {
        let lobes =
            |azimuth: f64, elevation: f64| (3.0 * azimuth.to_radians()).cos() * elevation.to_radians().cos().powi(3);
        insta::assert_snapshot!(hemisphere("Effective radius", "µm", lobes));
    }
}
