//! Fits of exact, noisy, short, far and degenerate points, and of real scans.

use std::path::Path;

use abbe_geometry::{FitError, Fitted, across, circle, cylinder, line, plane, spatial_circle, sphere};
use nalgebra::{DMatrix, Isometry3, Rotation3, Vector2, Vector3};

/// Random numbers of a linear congruential generator: the same everywhere.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((self.0 >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }

    fn direction(&mut self) -> Vector3<f64> {
        Vector3::new(self.normal(), self.normal(), self.normal()).normalize()
    }

    fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::new(self.between(-size, size), self.between(-size, size), self.between(-size, size))
    }
}

/// Points of a cylinder about the z axis, turned so that the axis points along `direction`.
fn on_cylinder(
    random: &mut Random,
    count: usize,
    radius: f64,
    arc: f64,
    direction: &Vector3<f64>,
) -> Vec<Vector3<f64>> {
    let [u, v] = across(direction);
    (0..count)
        .map(|_| {
            let (sine, cosine) = random.between(0.0, arc).sin_cos();
            radius * (cosine * u + sine * v) + random.between(0.0, 2.0 * radius * arc.min(1.0)) * direction
        })
        .collect()
}

fn on_circle(random: &mut Random, count: usize, radius: f64, arc: f64) -> Vec<Vector2<f64>> {
    let angles = (0..count).map(|_| random.between(0.0, arc));
    angles.map(|angle| radius * Vector2::new(angle.cos(), angle.sin())).collect()
}

/// Points of the cap of a sphere about the z axis.
fn on_cap(random: &mut Random, count: usize, radius: f64, half_angle: f64) -> Vec<Vector3<f64>> {
    (0..count)
        .map(|_| {
            let height = random.between(half_angle.cos(), 1.0);
            let angle = random.between(0.0, std::f64::consts::TAU);
            let across = (1.0 - height * height).sqrt();
            radius * Vector3::new(across * angle.cos(), across * angle.sin(), height)
        })
        .collect()
}

#[track_caller]
fn near(found: f64, expected: f64, tolerance: f64, what: &str) {
    assert!((found - expected).abs() <= tolerance, "{what}: {found:e}, expected {expected:e} to {tolerance:e}");
}

#[track_caller]
fn along(found: &Vector3<f64>, expected: &Vector3<f64>, tolerance: f64) {
    near(found.cross(expected).norm(), 0.0, tolerance, "direction");
    near(found.norm(), 1.0, 1e-14, "norm of a direction");
    assert!(found[found.iamax()] > 0.0);
}

#[test]
fn exact_shapes_come_back() {
    let mut random = Random(1);
    for case in 0..40 {
        let radius = 10_f64.powf(random.between(-3.0, 4.0));
        let centre = random.vector(10.0 * radius);
        let direction = random.direction();
        let count = 5 + case;
        let close = 1e-12 * (radius + centre.norm());

        let points: Vec<Vector3<f64>> =
            on_cap(&mut random, count, radius, 3.0).iter().map(|point| point + centre).collect();
        let found = sphere(&points).unwrap();
        near(found.shape.radius, radius, close, "radius of a sphere");
        near((found.shape.centre - centre).norm(), 0.0, close, "centre of a sphere");
        near(found.range(), 0.0, close, "sphericity");
        assert_eq!((found.residuals.len(), found.degrees_of_freedom), (count, count - 4));

        let flat: Vec<Vector2<f64>> =
            on_circle(&mut random, count, radius, 5.0).iter().map(|point| point + centre.xy()).collect();
        let found = circle(&flat).unwrap();
        near(found.shape.radius, radius, close, "radius of a circle");
        near((found.shape.centre - centre.xy()).norm(), 0.0, close, "centre of a circle");

        let [u, v] = across(&direction);
        let in_space: Vec<Vector3<f64>> =
            flat.iter().map(|point| point - centre.xy()).map(|point| centre + point.x * u + point.y * v).collect();
        let found = spatial_circle(&in_space).unwrap();
        near(found.circle.shape.radius, radius, close, "radius of a circle in space");
        near((found.circle.shape.centre - centre).norm(), 0.0, 3.0 * close, "centre of a circle in space");
        along(&found.circle.shape.normal, &direction, 1e-11);
        near(found.plane.range(), 0.0, close, "flatness of a circle in space");

        let found = plane(&in_space).unwrap();
        along(&found.shape.normal, &direction, 1e-11);
        near(found.rms(), 0.0, close, "flatness");

        let straight: Vec<Vector3<f64>> =
            (0..count).map(|_| centre + random.between(-radius, radius) * direction).collect();
        let found = line(&straight).unwrap();
        along(&found.shape.direction, &direction, 1e-11);
        near(found.max(), 0.0, close, "straightness");
        near((found.shape.point - centre).cross(&direction).norm(), 0.0, close, "place of a line");

        let points: Vec<Vector3<f64>> =
            on_cylinder(&mut random, count + 5, radius, 4.0, &direction).iter().map(|point| point + centre).collect();
        let found = cylinder(&points).unwrap();
        near(found.shape.radius, radius, 10.0 * close, "radius of a cylinder");
        along(&found.shape.direction, &direction, 1e-11);
        near((found.shape.point - centre).cross(&direction).norm(), 0.0, 20.0 * close, "place of a cylinder");
        near(found.range(), 0.0, 10.0 * close, "cylindricity");
    }
}

#[test]
fn short_arcs() {
    let (arc, mut random) = (5_f64.to_radians(), Random(2));
    for _ in 0..20 {
        // Rounding of coordinates alone is magnified by 1 / (1 - cos 2.5 degrees) = 1000.
        let points = on_circle(&mut random, 30, 250.0, arc);
        let found = circle(&points).unwrap();
        near(found.shape.radius, 250.0, 250.0 * 5e-12, "circle");
        let found = sphere(&on_cap(&mut random, 40, 250.0, arc / 2.0)).unwrap();
        near(found.shape.radius, 250.0, 250.0 * 5e-12, "sphere");
        let direction = random.direction();
        let found = cylinder(&on_cylinder(&mut random, 60, 250.0, arc, &direction)).unwrap();
        near(found.shape.radius, 250.0, 250.0 * 1e-10, "cylinder");
        along(&found.shape.direction, &direction, 1e-10);
    }
    // With noise of a thousandth of the height of the arc the radius is right to what its covariance says.
    let points = on_circle(&mut random, 400, 250.0, arc);
    let noise = 250.0 * (1.0 - (arc / 2.0).cos()) * 1e-3;
    let noisy: Vec<Vector2<f64>> =
        points.iter().map(|point| point + noise * Vector2::new(random.normal(), random.normal())).collect();
    let found = circle(&noisy).unwrap();
    let uncertainty = noise * found.covariance[2][2].sqrt();
    assert!((found.shape.radius - 250.0).abs() < 3.0 * uncertainty && uncertainty < 0.1, "{uncertainty}");
}

#[test]
fn far_from_the_origin() {
    let (mut random, far) = (Random(3), Vector3::new(1e6, -2e6, 3e6));
    let direction = random.direction();
    // Coordinates of 3e6 hold 5e-10.
    let close = 2e-9;
    let moved = |points: &[Vector3<f64>]| points.iter().map(|point| point + far).collect::<Vec<_>>();
    let found = sphere(&moved(&on_cap(&mut random, 50, 10.0, 2.0))).unwrap();
    near(found.shape.radius, 10.0, close, "sphere");
    near((found.shape.centre - far).norm(), 0.0, close, "sphere");
    let found = cylinder(&moved(&on_cylinder(&mut random, 50, 10.0, 3.0, &direction))).unwrap();
    near(found.shape.radius, 10.0, close, "cylinder");
    along(&found.shape.direction, &direction, 1e-9);
    let flat: Vec<Vector2<f64>> = on_circle(&mut random, 50, 10.0, 3.0).iter().map(|point| point + far.xy()).collect();
    near(circle(&flat).unwrap().shape.radius, 10.0, close, "circle");
    // Points on a line that rounding takes 5e-10 off it are on a line.
    let straight: Vec<Vector2<f64>> = (0..9).map(|i| far.xy() + f64::from(i) * Vector2::new(0.3, 0.7)).collect();
    assert!(circle(&straight).is_err());
    let straight: Vec<Vector3<f64>> = (0..9).map(|i| far + f64::from(i) * direction).collect();
    along(&line(&straight).unwrap().shape.direction, &direction, 1e-9);
    assert!(plane(&straight).is_err() && sphere(&straight).is_err());
}

fn same<S>(one: &Fitted<S>, other: &Fitted<S>, order: impl Fn(usize) -> usize, tolerance: f64) {
    for (index, residual) in one.residuals.iter().enumerate() {
        near(other.residuals[order(index)], *residual, tolerance, "residual");
    }
    near(one.standard_deviation(), other.standard_deviation(), tolerance, "standard deviation");
}

#[test]
fn order_and_frame_do_not_matter() {
    let mut random = Random(4);
    for _ in 0..10 {
        let direction = random.direction();
        let mut noisy = |points: Vec<Vector3<f64>>| -> Vec<Vector3<f64>> {
            points
                .iter()
                .map(|point| point + 0.01 * Vector3::new(random.normal(), random.normal(), random.normal()))
                .collect()
        };
        let ball = noisy(on_cap(&mut Random(5), 30, 8.0, 1.5));
        let tube = noisy(on_cylinder(&mut Random(6), 30, 8.0, 2.0, &direction));
        let [u, v] = across(&direction);
        let ring =
            noisy(on_circle(&mut Random(7), 30, 8.0, 2.0).iter().map(|point| point.x * u + point.y * v).collect());
        let motion = Isometry3::from_parts(
            random.vector(100.0).into(),
            Rotation3::from_axis_angle(&nalgebra::Unit::new_normalize(random.direction()), 2.0).into(),
        );
        let moved = |points: &[Vector3<f64>]| {
            points.iter().map(|point| (motion * nalgebra::Point3::from(*point)).coords).collect::<Vec<_>>()
        };
        let reversed = |points: &[Vector3<f64>]| points.iter().rev().copied().collect::<Vec<_>>();
        let place = |point: Vector3<f64>| (motion * nalgebra::Point3::from(point)).coords;

        let (one, other, back) =
            (sphere(&ball).unwrap(), sphere(&moved(&ball)).unwrap(), sphere(&reversed(&ball)).unwrap());
        same(&one, &other, |index| index, 1e-11);
        same(&one, &back, |index| 29 - index, 1e-11);
        near((place(one.shape.centre) - other.shape.centre).norm(), 0.0, 1e-10, "centre");

        let (one, other, back) =
            (cylinder(&tube).unwrap(), cylinder(&moved(&tube)).unwrap(), cylinder(&reversed(&tube)).unwrap());
        same(&one, &other, |index| index, 1e-9);
        same(&one, &back, |index| 29 - index, 1e-9);
        near((place(one.shape.point) - other.shape.point).norm(), 0.0, 1e-8, "place of a cylinder");
        near(one.shape.radius, other.shape.radius, 1e-8, "radius of a cylinder");

        let (one, other) = (spatial_circle(&ring).unwrap(), spatial_circle(&moved(&ring)).unwrap());
        same(&one.circle, &other.circle, |index| index, 1e-11);
        near((place(one.circle.shape.centre) - other.circle.shape.centre).norm(), 0.0, 1e-10, "centre of a circle");
        near(one.plane.rms(), other.plane.rms(), 1e-11, "flatness");

        let (one, other) = (line(&tube).unwrap(), line(&moved(&tube)).unwrap());
        same(&one, &other, |index| index, 1e-10);
    }
}

/// Largest relative deviation of the scatter of fits to noisy points from their stated covariance, and of the mean of the
/// standard deviations from the noise; `parameters` gives what a fit changes from the truth.
fn scatter(trials: usize, stated: &[Vec<f64>], mut trial: impl FnMut() -> (Vec<f64>, f64)) -> (f64, f64) {
    let count = stated.len();
    let (mut sum, mut variance) = (DMatrix::zeros(count, count), 0.0);
    for _ in 0..trials {
        let (changes, deviation) = trial();
        let changes = DMatrix::from_vec(count, 1, changes);
        sum += &changes * changes.transpose() / trials as f64;
        variance += deviation * deviation / trials as f64;
    }
    let scale = |index: usize| stated[index][index].sqrt();
    let mut off = 0.0_f64;
    for row in 0..count {
        for column in 0..count {
            off = off.max((sum[(row, column)] - stated[row][column]).abs() / (scale(row) * scale(column)));
        }
    }
    (off, variance.sqrt())
}

#[test]
fn noise_scatters_as_the_covariance_says() {
    const NOISE: f64 = 1e-4;
    let mut random = Random(8);
    let trials = 2000;
    let noisy = |random: &mut Random, points: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
        points
            .iter()
            .map(|point| point + NOISE * Vector3::new(random.normal(), random.normal(), random.normal()))
            .collect()
    };
    let unit = |changes: Vec<f64>| changes.into_iter().map(|change| change / NOISE).collect::<Vec<f64>>();
    let judge = |(off, deviation): (f64, f64), what: &str| {
        assert!(off < 0.12, "{what}: covariance off by {off}");
        near(deviation, NOISE, 0.02 * NOISE, what);
    };

    let points = on_cap(&mut random, 20, 10.0, 1.0);
    let truth = sphere(&points).unwrap();
    let found = scatter(trials, &truth.covariance, || {
        let found = sphere(&noisy(&mut random, &points)).unwrap();
        let mut changes = (found.shape.centre - truth.shape.centre).as_slice().to_vec();
        changes.push(found.shape.radius - truth.shape.radius);
        (unit(changes), found.standard_deviation())
    });
    judge(found, "sphere");

    let direction = random.direction();
    let [u, v] = across(&direction);
    let points = on_cylinder(&mut random, 25, 10.0, 2.0, &direction);
    let truth = cylinder(&points).unwrap();
    let [u_own, v_own] = across(&truth.shape.direction);
    let found = scatter(trials, &truth.covariance, || {
        let found = cylinder(&noisy(&mut random, &points)).unwrap();
        // The point of the noisy axis in the plane across the true one.
        let tilt = found.shape.direction - truth.shape.direction;
        let from = found.shape.point - truth.shape.point;
        let shift = from
            - found.shape.direction * truth.shape.direction.dot(&from)
                / truth.shape.direction.dot(&found.shape.direction);
        let changes = vec![
            u_own.dot(&shift),
            v_own.dot(&shift),
            u_own.dot(&tilt),
            v_own.dot(&tilt),
            found.shape.radius - truth.shape.radius,
        ];
        (unit(changes), found.standard_deviation())
    });
    judge(found, "cylinder");

    let points: Vec<Vector3<f64>> =
        (0..15).map(|_| random.between(0.0, 4.0) * u + random.between(0.0, 9.0) * v).collect();
    let truth = plane(&points).unwrap();
    let [u_own, v_own] = across(&truth.shape.normal);
    let found = scatter(trials, &truth.covariance, || {
        let found = plane(&noisy(&mut random, &points)).unwrap();
        let tilt = found.shape.normal - truth.shape.normal;
        let offset = truth.shape.normal.dot(&(found.shape.point - truth.shape.point));
        (unit(vec![offset, u_own.dot(&tilt), v_own.dot(&tilt)]), found.standard_deviation())
    });
    judge(found, "plane");

    let points: Vec<Vector3<f64>> = (0..15).map(|_| random.between(0.0, 9.0) * direction).collect();
    let truth = line(&points).unwrap();
    let [u_own, v_own] = across(&truth.shape.direction);
    let found = scatter(trials, &truth.covariance, || {
        let found = line(&noisy(&mut random, &points)).unwrap();
        let (tilt, shift) = (found.shape.direction - truth.shape.direction, found.shape.point - truth.shape.point);
        let changes = vec![u_own.dot(&shift), v_own.dot(&shift), u_own.dot(&tilt), v_own.dot(&tilt)];
        (unit(changes), found.standard_deviation())
    });
    judge(found, "line");

    // Points at equal angles all around: variances 2/n, 2/n, 1/n (Chernov).
    let angles = (0..12).map(|i| f64::from(i) * std::f64::consts::TAU / 12.0);
    let all_around: Vec<Vector2<f64>> = angles.map(|angle: f64| 5.0 * Vector2::new(angle.cos(), angle.sin())).collect();
    let stated = circle(&all_around).unwrap().covariance;
    for (row, expected) in [1.0 / 6.0, 1.0 / 6.0, 1.0 / 12.0].into_iter().enumerate() {
        for (column, value) in stated[row].iter().enumerate() {
            near(*value, if row == column { expected } else { 0.0 }, 1e-12, "covariance of a circle");
        }
    }
}

#[test]
fn statistics() {
    // Two points inside and two outside by 0.1.
    let points: Vec<Vector2<f64>> =
        [(1.1, 0.0), (0.0, 0.9), (-1.1, 0.0), (0.0, -0.9)].iter().map(|&(x, y)| Vector2::new(x, y)).collect();
    let found = circle(&points).unwrap();
    near(found.shape.radius, 1.0, 1e-12, "radius");
    for (value, expected) in [
        (found.max(), 0.1),
        (found.min(), -0.1),
        (found.range(), 0.2),
        (found.rms(), 0.1),
        (found.standard_deviation(), 0.2),
    ] {
        near(value, expected, 1e-12, "statistic");
    }
    assert_eq!(found.degrees_of_freedom, 1);
    assert!(circle(&points[..3]).unwrap().standard_deviation().is_nan());
}

#[test]
fn points_that_determine_nothing_are_refused() {
    let points = |list: &[[f64; 3]]| list.iter().map(|point| Vector3::from(*point)).collect::<Vec<_>>();
    let flat = |list: &[[f64; 2]]| list.iter().map(|point| Vector2::from(*point)).collect::<Vec<_>>();
    let text = |error: FitError| error.to_string();
    let square = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.2, 0.0]];
    let straight = [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [5.0, 5.0, 5.0], [7.0, 7.0, 7.0]];
    let one = [[3.0, 4.0, 5.0]; 6];
    let mut broken = square;
    broken[2][1] = f64::NAN;
    let cases = [
        (sphere(&points(&square[..3])).unwrap_err(), "a sphere needs 4 points or more, and there are 3"),
        (sphere(&points(&square)).unwrap_err(), "the points determine no sphere: they lie in a plane"),
        (sphere(&points(&straight)).unwrap_err(), "the points determine no sphere: they lie in a plane"),
        (sphere(&points(&one)).unwrap_err(), "the points determine no sphere: they coincide"),
        (sphere(&points(&broken)).unwrap_err(), "point 3 has a coordinate that is no finite number"),
        (circle(&flat(&[[0.0, 0.0], [1.0, 1.0]])).unwrap_err(), "a circle needs 3 points or more, and there are 2"),
        (
            circle(&flat(&[[0.0, 0.1], [1.0, 1.1], [3.0, 3.1]])).unwrap_err(),
            "the points determine no circle: they lie on a line",
        ),
        (plane(&points(&straight)).unwrap_err(), "the points determine no plane: they lie on a line"),
        (plane(&points(&one)).unwrap_err(), "the points determine no plane: they coincide"),
        (spatial_circle(&points(&straight)).unwrap_err(), "the points determine no circle: they lie on a line"),
        (line(&points(&one)).unwrap_err(), "the points determine no line: they coincide"),
        (line(&points(&one[..1])).unwrap_err(), "a line needs 2 points or more, and there are 1"),
        (
            line(&points(&square[..4])).unwrap_err(),
            "the points determine no line: they spread in several directions alike",
        ),
        (cylinder(&points(&square[..4])).unwrap_err(), "a cylinder needs 5 points or more, and there are 4"),
        (cylinder(&points(&straight)).unwrap_err(), "the points determine no cylinder: they lie on a line"),
        (cylinder(&points(&square)).unwrap_err(), "the points determine no cylinder: they lie in a plane"),
        (sphere(&[]).unwrap_err(), "a sphere needs 4 points or more, and there are 0"),
    ];
    for (found, expected) in cases {
        assert_eq!(text(found), expected);
    }
}

/// Scans of spheres of 50 mm radius; a third of the points are on the holder of the sphere.
#[test]
fn real_scans() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/real/spheres");
    if !folder.is_dir() {
        // Written to the stream directly: the test harness captures only what macros print. `cargo xtask ci` tells it again
        // at its end.
        let told = b"\nSKIPPED: real_scans: the scans that others measured are not shipped\n";
        return std::io::Write::write_all(&mut std::io::stdout(), told).unwrap();
    }
    // (file, points, radius and standard deviation in mm by an independent least squares of all points)
    for (file, count, radius, deviation) in
        [("SPH101.xyz", 6474, 66.572_053_62, 7.798_794_37), ("SPH108.xyz", 5703, 66.204_839_60, 8.568_342_08)]
    {
        let text = std::fs::read_to_string(folder.join(file)).unwrap();
        let rows = text.lines().filter(|line| !line.starts_with('#'));
        let mut points: Vec<Vector3<f64>> = rows
            .map(|row| row.split_whitespace().map(|cell| 1e3 * cell.parse::<f64>().unwrap()).collect())
            .map(|row: Vec<f64>| Vector3::from_column_slice(&row))
            .collect();
        let all = sphere(&points).unwrap();
        assert_eq!(points.len(), count);
        near(all.shape.radius, radius, 1e-6, file);
        near(all.standard_deviation(), deviation, 1e-6, file);
        // What is further off than twice the standard deviation does not belong to the sphere.
        loop {
            let found = sphere(&points).unwrap();
            let limit = 2.0 * found.standard_deviation();
            let before = points.len();
            let mut residuals = found.residuals.iter();
            points.retain(|_| residuals.next().is_some_and(|residual| residual.abs() < limit));
            if points.len() == before {
                near(found.shape.radius, 50.0, 0.1, file);
                assert!(points.len() > count / 3 && found.standard_deviation() < 0.2);
                break;
            }
        }
    }
}
