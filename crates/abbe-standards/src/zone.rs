//! The ring of the smallest width that holds all points of a round trace (minimum zone, minimum radial separation).
//!
//! Distances from a centre are made linear about it, the best change of the centre is a linear programme (Chebyshev's
//! approximation, solved by the dual simplex method), and that is repeated until the centre stays.

use nalgebra::{Matrix4, Vector2, Vector4};

/// A ring that holds all points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Zone {
    /// Its centre, in the unit of the points.
    pub centre: [f64; 2],
    /// Outer less inner radius.
    pub width: f64,
}

/// Steps of the centre that are tried at most.
const STEPS: usize = 60;

/// The smallest zone near a centre, which has to be well inside the points: that of the least squares circle.
///
/// None for fewer than four points, or where it does not settle.
pub fn smallest(points: &[[f64; 2]], centre: [f64; 2]) -> Option<Zone> {
    if points.len() < 4 {
        return None;
    }
    let mut best = about(points, centre);
    let mut from = centre;
    for _ in 0..STEPS {
        let step = improvement(points, from)?;
        let next = [from[0] + step[0], from[1] + step[1]];
        let found = about(points, next);
        let settled = step.norm() <= 1e-13 * reach(points, from);
        if found.width < best.width {
            best = found;
        }
        if settled {
            return best.width.is_finite().then_some(best);
        }
        from = next;
    }
    None
}

fn about(points: &[[f64; 2]], centre: [f64; 2]) -> Zone {
    let radii = || points.iter().map(|[x, y]| (x - centre[0]).hypot(y - centre[1]));
    let width = radii().fold(f64::NEG_INFINITY, f64::max) - radii().fold(f64::INFINITY, f64::min);
    Zone { centre, width }
}

fn reach(points: &[[f64; 2]], centre: [f64; 2]) -> f64 {
    points.iter().map(|[x, y]| (x - centre[0]).hypot(y - centre[1])).fold(0.0, f64::max)
}

/// The change of the centre that makes the range of the linear distances smallest.
fn improvement(points: &[[f64; 2]], centre: [f64; 2]) -> Option<Vector2<f64>> {
    let from_centre = |[x, y]: &[f64; 2]| Vector2::new(x - centre[0], y - centre[1]);
    let normals: Vec<Vector2<f64>> = points.iter().map(|point| from_centre(point).normalize()).collect();
    let radii: Vec<f64> = points.iter().map(|point| from_centre(point).norm()).collect();
    let mean = radii.iter().sum::<f64>() / radii.len() as f64;
    let heights: Vec<f64> = radii.iter().map(|radius| radius - mean).collect();
    let unit = heights.iter().fold(0.0_f64, |most, height| most.max(height.abs()));
    if !unit.is_finite() || unit == 0.0 {
        return (unit == 0.0).then(Vector2::zeros);
    }
    let scaled: Vec<f64> = heights.iter().map(|height| height / unit).collect();
    Some(unit * chebyshev(&normals, &scaled)?)
}

/// A bound `side (height - normal . step - level) <= half width` of one point.
#[derive(Clone, Copy, PartialEq)]
struct Bound {
    point: usize,
    side: f64,
}

/// The step, with a level and a half width that is smallest, so that all bounds hold.
fn chebyshev(normals: &[Vector2<f64>], heights: &[f64]) -> Option<Vector2<f64>> {
    let row = |bound: Bound| {
        let normal = normals[bound.point];
        Vector4::new(bound.side * normal.x, bound.side * normal.y, bound.side, 1.0)
    };
    let mut basis = start(normals)?;
    for _ in 0..40 * normals.len() + 400 {
        let matrix = Matrix4::from_rows(&basis.map(|bound| row(bound).transpose()));
        let lu = matrix.lu();
        let right = Vector4::from(basis.map(|bound| bound.side * heights[bound.point]));
        let solution = lu.solve(&right)?;
        let excess = |bound: Bound| bound.side * heights[bound.point] - row(bound).dot(&solution);
        let both = |point: usize| [Bound { point, side: 1.0 }, Bound { point, side: -1.0 }];
        let worst = (0..normals.len()).flat_map(both).reduce(|a, b| if excess(b) > excess(a) { b } else { a })?;
        if excess(worst) <= 1e-13 || basis.contains(&worst) {
            return Some(Vector2::new(solution[0], solution[1]));
        }
        let transposed = matrix.transpose().lu();
        let weights = transposed.solve(&Vector4::new(0.0, 0.0, 0.0, 1.0))?;
        let entering = transposed.solve(&row(worst))?;
        let ratio = |place: usize| weights[place].max(0.0) / entering[place];
        let leaving = (0..4).filter(|place| entering[*place] > 1e-12);
        let leaving = leaving.reduce(|a, b| if ratio(b) < ratio(a) { b } else { a })?;
        basis[leaving] = worst;
    }
    None
}

/// Four bounds with weights that are not negative: both of one point, and one of two others far from it.
fn start(normals: &[Vector2<f64>]) -> Option<[Bound; 4]> {
    let first = normals.first()?;
    let area = |a: &Vector2<f64>, b: &Vector2<f64>, c: &Vector2<f64>| (b - a).perp(&(c - a)).abs();
    let farthest =
        |size: &dyn Fn(usize) -> f64| (0..normals.len()).reduce(|a, b| if size(b) > size(a) { b } else { a });
    let second = farthest(&|point| (normals[point] - first).norm())?;
    let third = farthest(&|point| area(first, &normals[second], &normals[point]))?;
    (area(first, &normals[second], &normals[third]) > 1e-9).then_some([
        Bound { point: 0, side: 1.0 },
        Bound { point: 0, side: -1.0 },
        Bound { point: second, side: 1.0 },
        Bound { point: third, side: 1.0 },
    ])
}
