//! Probing errors in the manner of ISO 230-10 and ISO 10360-5: form and size of a calibrated ring or sphere as it is probed.
//!
//! The texts of the standards were not at hand: symbols, the fit (least squares) and the pattern of 25 points are those that
//! instrument makers and Rahman (2016), section 2.3.4, describe.

use abbe_geometry::{FitError, Fitted, circle, sphere};
use nalgebra::{Vector2, Vector3};

/// Edition of a standard, which gives the figures their symbols.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Edition {
    /// ISO 230-10, machine tools.
    #[default]
    Iso230Part10,
    /// ISO 10360-5:2010, coordinate measuring machines.
    Iso10360Part5Of2010,
    /// ISO 10360-5:2020.
    Iso10360Part5Of2020,
}

/// Ring or sphere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Gauge {
    /// A ring, in the plane of its points.
    Ring,
    /// A sphere.
    Sphere,
}

impl Edition {
    /// The name of the standard.
    pub fn name(self) -> &'static str {
        match self {
            Self::Iso230Part10 => "ISO 230-10:2016",
            Self::Iso10360Part5Of2010 => "ISO 10360-5:2010",
            Self::Iso10360Part5Of2020 => "ISO 10360-5:2020",
        }
    }

    /// The symbol of the form error, as far as it is known. The standard for coordinate measuring machines has no ring.
    pub fn form(self, gauge: Gauge) -> &'static str {
        match (self, gauge) {
            (_, Gauge::Ring) => "P_FTU,2D",
            (Self::Iso230Part10, Gauge::Sphere) => "P_FTU,3D",
            (Self::Iso10360Part5Of2010, Gauge::Sphere) => "P_FTU",
            (Self::Iso10360Part5Of2020, Gauge::Sphere) => "P_Form.Sph.1x25",
        }
    }

    /// The symbol of the size error, as far as it is known.
    pub fn size(self, gauge: Gauge) -> &'static str {
        match (self, gauge) {
            (_, Gauge::Ring) => "P_STU,2D",
            (Self::Iso230Part10, Gauge::Sphere) => "P_STU,3D",
            (Self::Iso10360Part5Of2010, Gauge::Sphere) => "P_STU",
            (Self::Iso10360Part5Of2020, Gauge::Sphere) => "P_Size.Sph.1x25",
        }
    }
}

/// A gauge as it was probed, in the unit of its points.
#[derive(Debug, Clone, PartialEq)]
pub struct Probed {
    /// Centre of the least squares circle (z is 0) or sphere.
    pub centre: [f64; 3],
    /// Its radius, to the recorded tips.
    pub radius: f64,
    /// Radial distance of every tip from it.
    pub residuals: Vec<f64>,
    /// Form error: the range of the radial distances.
    pub form: f64,
    /// Standard deviation of the radial distances, by the degrees of freedom of the fit; NaN without any.
    pub standard_deviation: f64,
}

impl Probed {
    fn of<S>(fitted: &Fitted<S>, centre: [f64; 3], radius: f64) -> Self {
        let standard_deviation = fitted.standard_deviation();
        Self { centre, radius, residuals: fitted.residuals.clone(), form: fitted.range(), standard_deviation }
    }
}

/// A ring by tips in its plane.
///
/// Fails for tips that do not determine a circle.
pub fn ring(tips: &[[f64; 2]]) -> Result<Probed, FitError> {
    let tips: Vec<Vector2<f64>> = tips.iter().map(|tip| Vector2::from(*tip)).collect();
    let fitted = circle(&tips)?;
    let centre = fitted.shape.centre;
    Ok(Probed::of(&fitted, [centre.x, centre.y, 0.0], fitted.shape.radius))
}

/// A sphere by tips.
///
/// Fails for tips that do not determine a sphere.
pub fn ball(tips: &[[f64; 3]]) -> Result<Probed, FitError> {
    let tips: Vec<Vector3<f64>> = tips.iter().map(|tip| Vector3::from(*tip)).collect();
    let fitted = sphere(&tips)?;
    Ok(Probed::of(&fitted, fitted.shape.centre.into(), fitted.shape.radius))
}

/// A sphere as it was probed by several styli of one probe (multi-stylus test).
#[derive(Debug, Clone, PartialEq)]
pub struct MultiStylus {
    /// The sphere through the points of all styli: its form is P_FTM, its diameter less the calibrated one P_STM.
    pub all: Probed,
    /// The sphere of each stylus.
    pub each: Vec<Probed>,
    /// Range of the centres of the styli along x, y, z; P_LTM is the largest.
    pub location: [f64; 3],
}

impl MultiStylus {
    /// The symbols of form, size and location in ISO 10360-5:2010.
    pub const SYMBOLS: [&'static str; 3] = ["P_FTM", "P_STM", "P_LTM"];

    /// P_LTM: the largest range of the centres along an axis.
    pub fn largest_location(&self) -> f64 {
        self.location.into_iter().fold(0.0, f64::max)
    }
}

/// A sphere by the points of each stylus, stylus radius taken off.
///
/// None for fewer than two styli. Fails for points that do not determine a sphere.
pub fn multi_stylus(styli: &[Vec<[f64; 3]>]) -> Result<Option<MultiStylus>, FitError> {
    if styli.len() < 2 {
        return Ok(None);
    }
    let each = styli.iter().map(|points| ball(points)).collect::<Result<Vec<_>, _>>()?;
    let location = [0, 1, 2].map(|axis| {
        let centres = || each.iter().map(|own| own.centre[axis]);
        centres().fold(f64::NEG_INFINITY, f64::max) - centres().fold(f64::INFINITY, f64::min)
    });
    Ok(Some(MultiStylus { all: ball(&styli.concat())?, each, location }))
}

/// Directions of the 25 points on a hemisphere about +z: one at the pole and 4, 8, 4 and 8 at 67.5, 45, 22.5 and 0 degrees above the
/// equator, evenly around, every ring turned by 22.5 degrees against the one above it.
pub fn hemisphere_of_25() -> [[f64; 3]; 25] {
    let mut all = [[0.0, 0.0, 1.0]; 25];
    let rings = [(4, 67.5_f64), (8, 45.0), (4, 22.5), (8, 0.0)].into_iter().enumerate();
    let points = rings.flat_map(|(ring, (count, elevation))| {
        (0..count).map(move |point| {
            let azimuth = (f64::from(point) * 360.0 / f64::from(count) + 22.5 * ring as f64).to_radians();
            let (height, across) = elevation.to_radians().sin_cos();
            [across * azimuth.cos(), across * azimuth.sin(), height]
        })
    });
    all[1..].iter_mut().zip(points).for_each(|(to, point)| *to = point);
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_a_gauge_with_three_lobes() {
        let around = |step: i32| 2.0 * std::f64::consts::PI * f64::from(step) / 36.0;
        let tips: Vec<[f64; 2]> = (0..36)
            .map(|step| {
                let radius = 9.5 + 0.003 * (3.0 * around(step)).cos();
                [84.0 + radius * around(step).cos(), -72.0 + radius * around(step).sin()]
            })
            .collect();
        let probed = ring(&tips).expect("a circle");
        assert!((probed.form - 0.006).abs() < 1e-9, "{}", probed.form);
        assert!((probed.radius - 9.5).abs() < 1e-6);
        // A sine of amplitude a has the variance a^2 / 2.
        let expected = 0.003 * (36.0_f64 / 2.0 / 33.0).sqrt();
        assert!((probed.standard_deviation - expected).abs() < 1e-8);
    }

    #[test]
    fn worked_example_of_two_styli() {
        // Two styli whose centres are 0.003 apart along y: each sees a perfect sphere, both together do not.
        let of = |shift: f64| -> Vec<[f64; 3]> {
            hemisphere_of_25().iter().map(|[x, y, z]| [12.5 * x, 12.5 * y + shift, 12.5 * z]).collect()
        };
        let found = multi_stylus(&[of(-0.0015), of(0.0015)]).expect("spheres").expect("two styli");
        assert!((found.largest_location() - 0.003).abs() < 1e-12 && found.location[0] < 1e-12);
        assert!(found.each.iter().all(|own| own.form < 1e-12));
        // A point is off by half of it times the y of its direction, once outwards and once inwards: the fit changes nothing.
        let most = hemisphere_of_25().iter().map(|[_, y, _]| y.abs()).fold(0.0, f64::max);
        assert!((found.all.form - 0.003 * most).abs() < 1e-6, "{}", found.all.form);
        assert_eq!(multi_stylus(&[of(0.0)]).expect("a sphere"), None);
    }

    #[test]
    fn the_pattern_is_even() {
        let points = hemisphere_of_25();
        let sum = points.iter().fold([0.0; 2], |sum, point| [sum[0] + point[0], sum[1] + point[1]]);
        assert!(sum.iter().all(|value| value.abs() < 1e-14));
        assert!(points.iter().all(|[x, y, z]| (x * x + y * y + z * z - 1.0).abs() < 1e-14 && *z > -1e-15));
        let probed = ball(&points.map(|point| point.map(|value| 12.5 * value))).expect("a sphere");
        assert!(probed.form < 1e-13 && (probed.radius - 12.5).abs() < 1e-13);
        let nearest = |of: usize| {
            let others = points.iter().enumerate().filter(|(index, _)| *index != of).map(|(_, other)| other);
            others
                .map(|other| (0..3).map(|axis| (other[axis] - points[of][axis]).powi(2)).sum::<f64>().sqrt())
                .fold(f64::INFINITY, f64::min)
        };
        assert!((0..25).all(|point| nearest(point) > 0.35));
    }
}
