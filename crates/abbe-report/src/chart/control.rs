//! Control charts: normalised deviations over time, with their moving average and the limits.

use super::{Canvas, Scale, range};

/// What a control chart shows.
pub struct Control {
    /// The parameter.
    pub name: String,
    /// What is said of it.
    pub state: String,
    /// Unit of time.
    pub time: String,
    /// Time, normalised deviation, moving average, and whether there is an alarm.
    pub points: Vec<(f64, f64, f64, bool)>,
    /// Limits of single values and of the average.
    pub limits: [f64; 2],
    /// Times without a good test.
    pub absent: Vec<f64>,
}

/// Beyond this multiple of the limit a chart is cut: a crash would flatten all else.
const CUT: f64 = 4.0;

/// A small chart.
pub fn control(told: &Control) -> String {
    let (left, right, top, bottom) = (40.0, 344.0, 34.0, 142.0);
    let mut canvas = Canvas::new(356.0, 178.0, &format!("Control chart of {}: {}", told.name, told.state));
    let most = CUT * told.limits[0];
    let cut = |value: f64| value.clamp(-most, most);
    let values = told.points.iter().flat_map(|(_, z, average, _)| [cut(*z), cut(*average)]);
    let y = Scale::new(range(values.chain([-1.15 * told.limits[0], 1.15 * told.limits[0]])), [bottom, top]);
    let times = || told.points.iter().map(|(at, ..)| *at).chain(told.absent.iter().copied());
    let x = Scale::new(range(times()), [left, right]);
    canvas.text("n", [left, 12.0], &told.name);
    canvas.text("t l", [left, 26.0], &told.state);
    canvas.left(y, [left, right], 5);
    canvas.bottom(x, [bottom, top], 8, &told.time);
    for limit in [told.limits[0], -told.limits[0]] {
        canvas.line("z", [left, y.at(limit), right, y.at(limit)]);
    }
    for limit in [told.limits[1], -told.limits[1]] {
        canvas.line("s1 d", [left, y.at(limit), right, y.at(limit)]);
    }
    let average: Vec<[f64; 2]> =
        told.points.iter().map(|(at, _, average, _)| [x.at(*at), y.at(cut(*average))]).collect();
    canvas.path("s1 c h", &average);
    canvas.dots("s0 p", told.points.iter().map(|(at, z, ..)| [x.at(*at), y.at(cut(*z))]));
    for (at, z, ..) in told.points.iter().filter(|(.., alarm)| *alarm) {
        let beyond = if z.abs() > most { ", beyond the chart" } else { "" };
        canvas.ring("o", [x.at(*at), y.at(cut(*z))], 4.0, &format!("{} {at}: {z:+.1}{beyond}", told.time));
    }
    for at in &told.absent {
        canvas.text("m l", [x.at(*at), bottom - 3.0], "×");
    }
    canvas.svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alarms_are_ringed_and_a_crash_is_cut() {
        let points = vec![(1.0, 0.4, 0.1, false), (2.0, -3.4, -0.6, true), (4.0, 60.0, 12.0, true)];
        let told = Control {
            name: "EY0C".to_owned(),
            state: "step".to_owned(),
            time: "week".to_owned(),
            points,
            limits: [3.0, 0.95],
            absent: vec![3.0],
        };
        let svg = control(&told);
        assert_eq!(svg.matches("<circle").count(), 2);
        assert!(svg.contains("week 4: +60.0, beyond the chart") && svg.contains('×') && !svg.contains("NaN"));
    }
}
