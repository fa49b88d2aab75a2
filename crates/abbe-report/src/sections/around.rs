//! Residuals around a circle: of a rotary axis that turns, or of two linear axes that go round.

use std::collections::{BTreeMap, BTreeSet};

use crate::chart::Polar;
use crate::residuals::Residual;
use crate::run::FitResult;
use crate::subset::subset;

/// Different degrees from which on something turns.
const TURNING: usize = 45;

/// Points of a plot.
const POINTS: usize = 4000;

/// Plots of circles of linear axes at most.
const CIRCLES: usize = 6;

/// How far from a circle commands may be, as part of its radius.
const ROUND: f64 = 0.02;

/// Rows of one file and stage.
type OfFile<'a> = BTreeMap<(&'a str, &'a str), Vec<&'a Residual>>;

/// The plots of an estimate.
pub fn around(fit: &FitResult, rows: &[&Residual]) -> Vec<Polar> {
    let mut of_file: OfFile<'_> = BTreeMap::new();
    for row in rows {
        of_file.entry((&row.stage, &row.file)).or_default().push(row);
    }
    let axes = &fit.residuals.axes;
    let mut found = Vec::new();
    for (index, (axis, _)) in axes.iter().enumerate().filter(|(_, (_, unit))| unit == "deg") {
        let of_axis = of_file.values().map(|rows| {
            let known = rows.iter().filter(|row| row.commands[index].is_finite());
            known.map(|row| (row.commands[index], row.value)).collect::<Vec<_>>()
        });
        let at: Vec<(f64, f64)> = of_axis.filter(|at| turns(at)).flatten().collect();
        if !at.is_empty() {
            found.push(Polar { axis: axis.clone(), of: "of the axis".to_owned(), series: vec![some(at)] });
        }
    }
    let linear: Vec<usize> = (0..axes.len()).filter(|index| axes[*index].1 == "mm").collect();
    let mut circles = Vec::new();
    for ((stage, file), rows) in &of_file {
        for (number, one) in linear.iter().enumerate() {
            for other in &linear[number + 1..] {
                let Some(at) = circle(rows, *one, *other) else { continue };
                let name = file.rsplit(['/', '\\']).next().unwrap_or_default();
                let axis = format!("a circle of {} and {}, {stage}, {name}", axes[*one].0, axes[*other].0);
                let of = format!("from {} to {} in {name}", axes[*one].0, axes[*other].0);
                circles.push(Polar { axis, of, series: vec![some(at)] });
            }
        }
    }
    circles.truncate(CIRCLES);
    found.extend(circles);
    found
}

fn some(all: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    subset(all.len(), POINTS, |_| false).into_iter().map(|index| all[index]).collect()
}

/// Whether angles go round by many steps.
fn turns(at: &[(f64, f64)]) -> bool {
    let steps: BTreeSet<i64> = at.iter().map(|(degrees, _)| degrees.round() as i64).collect();
    steps.len() >= TURNING
}

/// Angles and residuals of rows whose commands of two axes lie on a circle; none if they do not.
fn circle(rows: &[&Residual], one: usize, other: usize) -> Option<Vec<(f64, f64)>> {
    let ends = |axis: usize| {
        let all = rows.iter().map(|row| row.commands[axis]).filter(|at| at.is_finite());
        all.fold([f64::INFINITY, f64::NEG_INFINITY], |[from, to], at| [from.min(at), to.max(at)])
    };
    let [across, up] = [ends(one), ends(other)];
    // What lies on a part of a circle has its middle elsewhere: that is no plot around it.
    let (middle, radius) = ([across, up].map(|[from, to]| from.midpoint(to)), (across[1] - across[0]) / 2.0);
    if !(radius > 1e-3 && ((up[1] - up[0]) / 2.0 - radius).abs() < ROUND * radius) {
        return None;
    }
    let mut at = Vec::with_capacity(rows.len());
    for row in rows {
        let [x, y] = [row.commands[one] - middle[0], row.commands[other] - middle[1]];
        let away = (x.hypot(y) - radius).abs();
        if away.is_nan() || away >= ROUND * radius {
            return None;
        }
        at.push((y.atan2(x).to_degrees(), row.value));
    }
    turns(&at).then_some(at)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(x: f64, y: f64) -> Residual {
        Residual {
            stage: "circles".to_owned(),
            file: "data/xy.csv".to_owned(),
            line: 2,
            row: 1,
            is_angle: false,
            value: x / 100.0,
            uncertainty: 1.0,
            time: None,
            tip: None,
            direction: None,
            labels: Vec::new(),
            commands: vec![x, y],
        }
    }

    #[test]
    fn circles_alone_are_circles() {
        let at = |degrees: f64, radius: f64| {
            let (sine, cosine) = degrees.to_radians().sin_cos();
            row(30.0 + radius * cosine, -20.0 + radius * sine)
        };
        let all = |radius: &dyn Fn(usize) -> f64, count: usize| -> Vec<Residual> {
            (0..count).map(|index| at(index as f64 * 2.0, radius(index))).collect()
        };
        let found = |rows: &[Residual]| circle(&rows.iter().collect::<Vec<_>>(), 0, 1);
        let circle = found(&all(&|_| 150.0, 180)).expect("a circle");
        assert_eq!(circle.len(), 180);
        assert!((circle[45].0 - 90.0).abs() < 1e-9, "{:?}", circle[45]);
        // A spiral, a quarter, and a point are none.
        assert!(found(&all(&|index| 100.0 + index as f64, 180)).is_none());
        assert!(found(&all(&|_| 150.0, 45)).is_none());
        assert!(found(&[row(0.0, 0.0)]).is_none() && found(&[]).is_none());
    }
}
