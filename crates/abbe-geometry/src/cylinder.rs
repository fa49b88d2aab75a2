//! Cylinder.

use std::f64::consts::{PI, TAU};

use abbe_numerics::Accumulator;
use nalgebra::{Matrix2, SVector, Vector2, Vector3};

use crate::cloud::Cloud;
use crate::error::FitError;
use crate::fitted::Fitted;
use crate::flat::{across, upright};
use crate::iteration::{Distances, covariance, minimise};
use crate::round::{Radial, taubin};

/// A cylinder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cylinder {
    /// The point of the axis nearest to the centroid of the fitted points.
    pub point: Vector3<f64>,
    /// Unit direction of the axis; its largest component is positive.
    pub direction: Vector3<f64>,
    /// Radius.
    pub radius: f64,
}

const SHAPE: &str = "cylinder";

/// Points that take part in the search for a direction to start from.
const SEARCHED: usize = 300;

/// Directions all over the half sphere that are tried: about 10 degrees from one to the next.
const DIRECTIONS: usize = 150;

/// Starts from which the iteration is tried, the best first.
const STARTS: usize = 4;

/// The least squares cylinder of five points or more.
///
/// Residuals are radial, positive outside. Covariance: shift of the axis at `point` along the two directions of [`across`] the
/// axis, then the changes of its direction along them (rad), radius.
///
/// Fails for points that coincide, lie on a line or in a plane, or do not determine the cylinder for another reason.
pub fn cylinder(points: &[Vector3<f64>]) -> Result<Fitted<Cylinder>, FitError> {
    let cloud = Cloud::of(SHAPE, 5, points)?;
    for (direction, because) in [(1, "they lie on a line"), (2, "they lie in a plane")] {
        if cloud.is_flat(direction) {
            return Err(FitError::Undetermined { shape: SHAPE, because });
        }
    }
    let nowhere = FitError::Undetermined { shape: SHAPE, because: "none fits them best" };
    let starts = starts(&cloud);
    let minima = starts.iter().filter_map(|direction| from_direction(&cloud.points, direction));
    let best = minima.min_by(|(_, one), (_, other)| one.total_cmp(other)).ok_or(nowhere)?;
    let Cylinder { point, direction, radius } = best.0;
    let frame = Frame::of(&direction);
    let turned = frame.turned(&cloud.points);
    let across_axis = frame.inside(&point);
    let parameters = [across_axis.x, across_axis.y, 0.0, 0.0, radius];
    let distances = FromAxis(&turned);
    let mut covariance = covariance(SHAPE, &distances, &parameters)?;
    // Directions are rad per scaled length so far.
    let unit = |index: usize| if index == 2 || index == 3 { cloud.scale } else { 1.0 };
    for (row, line) in covariance.iter_mut().enumerate() {
        line.iter_mut().enumerate().for_each(|(column, value)| *value /= unit(row) * unit(column));
    }
    Ok(Fitted {
        shape: Cylinder { point: cloud.place(point), direction, radius: radius * cloud.scale },
        residuals: distances.distances(&parameters).iter().map(|distance| distance * cloud.scale).collect(),
        covariance,
        degrees_of_freedom: points.len() - 5,
    })
}

/// Directions of the axis to start from: those along which the points look most like a circle.
fn starts(cloud: &Cloud<3>) -> Vec<Vector3<f64>> {
    let step = cloud.points.len().div_ceil(SEARCHED);
    let points: Vec<Vector3<f64>> = cloud.points.iter().step_by(step).copied().collect();
    let mut tried: Vec<(f64, Vector3<f64>)> = (patch_axis(cloud).into_iter())
        .chain(cloud.directions.iter().copied())
        .chain(half_sphere())
        .map(|direction| (circle_along(&points, &direction).map_or(f64::INFINITY, |(_, cost)| cost), direction))
        .collect();
    tried.sort_by(|(one, _), (other, _)| one.total_cmp(other));
    tried.into_iter().take(STARTS).map(|(_, direction)| direction).collect()
}

/// Directions spread evenly over a half sphere, on a spiral.
fn half_sphere() -> impl Iterator<Item = Vector3<f64>> {
    let golden = PI * (3.0 - 5.0_f64.sqrt());
    (0..DIRECTIONS).map(move |index| {
        let height = (index as f64 + 0.5) / DIRECTIONS as f64;
        let (sine, cosine) = (golden * index as f64 % TAU).sin_cos();
        let radius = (1.0 - height * height).sqrt();
        Vector3::new(radius * cosine, radius * sine, height)
    })
}

/// The direction in which a patch of the surface is not curved: exact enough where it covers a short arc.
fn patch_axis(cloud: &Cloud<3>) -> Option<Vector3<f64>> {
    let [u, v, w] = [0, 1, 2].map(|direction| cloud.directions[direction]);
    // The height of the patch as a polynomial of second degree: its constant, slopes and curvatures.
    let mut accumulator = Accumulator::new(6, cloud.points.len());
    for point in &cloud.points {
        let (x, y) = (u.dot(point), v.dot(point));
        accumulator.push(&[1.0, x, y, 0.5 * x * x, x * y, 0.5 * y * y], -w.dot(point), 1.0);
    }
    let height = accumulator.finish().step()?;
    let curvature = Matrix2::new(height[3], height[4], height[4], height[5]).symmetric_eigen();
    let flat = curvature.eigenvectors.column(curvature.eigenvalues.iamin()).into_owned();
    Some((u * flat.x + v * flat.y).normalize())
}

/// The algebraic circle of the points seen along a direction, with its sum of squared distances.
fn circle_along(points: &[Vector3<f64>], direction: &Vector3<f64>) -> Option<([f64; 3], f64)> {
    let [u, v] = across(direction);
    let seen: Vec<Vector2<f64>> = points.iter().map(|point| Vector2::new(u.dot(point), v.dot(point))).collect();
    let circle = taubin(&seen)?;
    let parameters = [circle.centre.x, circle.centre.y, circle.radius];
    let cost = Radial(&seen).distances(&parameters).iter().map(|distance| distance * distance).sum();
    Some((parameters, cost))
}

/// The cylinder that the iteration reaches from a direction of its axis, with its sum of squared distances.
fn from_direction(points: &[Vector3<f64>], direction: &Vector3<f64>) -> Option<(Cylinder, f64)> {
    let ([x, y, radius], _) = circle_along(points, direction)?;
    let frame = Frame::of(direction);
    let turned = frame.turned(points);
    let found = minimise(SHAPE, &FromAxis(&turned), &[x, y, 0.0, 0.0, radius]).ok()?;
    let cost = FromAxis(&turned).distances(&found).iter().map(|distance| distance * distance).sum();
    let along = Vector3::new(found[2], found[3], 1.0).normalize();
    let place = Vector3::new(found[0], found[1], 0.0);
    let nearest = place - along * along.dot(&place);
    let direction = upright(frame.outside(&along));
    Some((Cylinder { point: frame.outside(&nearest), direction, radius: found[4] }, cost))
}

/// An orthonormal frame whose third direction is given.
struct Frame([Vector3<f64>; 3]);

impl Frame {
    fn of(direction: &Vector3<f64>) -> Self {
        let [u, v] = across(direction);
        Self([u, v, *direction])
    }

    fn inside(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(self.0[0].dot(vector), self.0[1].dot(vector), self.0[2].dot(vector))
    }

    fn outside(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        self.0[0] * vector.x + self.0[1] * vector.y + self.0[2] * vector.z
    }

    fn turned(&self, points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        points.iter().map(|point| self.inside(point)).collect()
    }
}

/// Radial distances from an axis near the third direction; parameters: where it meets the plane of the others (2), slopes (2),
/// radius.
struct FromAxis<'a>(&'a [Vector3<f64>]);

impl Distances for FromAxis<'_> {
    fn points(&self) -> usize {
        self.0.len()
    }

    fn parameters(&self) -> usize {
        5
    }

    fn distance(&self, point: usize, parameters: &[f64], derivatives: &mut [f64]) -> f64 {
        let [x, y, a, b, radius] = SVector::<f64, 5>::from_column_slice(parameters).into();
        let slope = Vector3::new(a, b, 1.0);
        let length = slope.norm();
        let along = slope / length;
        let from_place = self.0[point] - Vector3::new(x, y, 0.0);
        let height = from_place.dot(&along);
        let radial = from_place - along * height;
        let distance = radial.norm();
        // On the axis every direction is as good as any other.
        let outward = if distance > 0.0 { radial / distance } else { Vector3::zeros() };
        derivatives[0] = -outward.x;
        derivatives[1] = -outward.y;
        derivatives[2] = -outward.x * height / length;
        derivatives[3] = -outward.y * height / length;
        derivatives[4] = -1.0;
        distance - radius
    }
}
