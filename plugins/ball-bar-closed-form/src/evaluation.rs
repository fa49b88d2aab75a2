//! The circles of all tests: where each axis passes the tool ball, and how large the circles are.

use abbe_core::{Error, Result};
use nalgebra::Vector2;

use crate::Evaluation;
use crate::reduction::{Projection, polar_plot};
use crate::sweep::Sweep;

/// Nominal heights that differ by less than this do not determine the height of the pivot, mm.
const HEIGHTS_DIFFER: f64 = 1.0;

/// Number of steps of the radius: an offset o changes it by o²/2R, the next step changes it by a millionth of that.
const STEPS: usize = 5;

/// The circle of a test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    /// Offset of the axis from the tool ball, in the directions of the cosine and of the sine, beyond the nominal one, mm.
    pub offset: Vector2<f64>,
    /// Distance of the pivot from the axis less the nominal one, mm.
    pub radius: f64,
    /// Height of the tool ball above the circle less the nominal one, mm; zero where a pivot was measured at one height only.
    pub height: f64,
    /// Offset by the nominal machine, mm.
    pub nominal_offset: Vector2<f64>,
}

/// The circles of all tests.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluated {
    pub circles: Vec<Circle>,
}

/// The two numbers of a test from which its circle follows, together with those of the other tests of its pivot and axis.
#[derive(Clone, Copy)]
struct CircleNumbers {
    /// Offset, or offset times radius in the squared length.
    offset: Vector2<f64>,
    /// Radius² + height² (+ offset² in the squared length).
    square: f64,
}

impl Evaluated {
    /// Evaluates all tests; those with one pivot and one axis share its radius and height.
    pub fn new(sweeps: &[Sweep], evaluation: Evaluation) -> Result<Self> {
        let numbers = |lengths: fn(&Sweep) -> &[f64]| -> Result<Vec<CircleNumbers>> {
            sweeps.iter().map(|sweep| circle_numbers(sweep, lengths(sweep), evaluation)).collect()
        };
        let measured = shapes(sweeps, &numbers(|sweep| &sweep.measured)?, evaluation);
        let nominal = shapes(sweeps, &numbers(|sweep| &sweep.nominal)?, evaluation);
        let circles = measured.iter().zip(&nominal).map(|(measured, nominal)| Circle {
            offset: measured.offset - nominal.offset,
            radius: measured.radius - nominal.radius,
            height: measured.height - nominal.height,
            nominal_offset: nominal.offset,
        });
        let circles: Vec<Circle> = circles.collect();
        match circles.iter().position(|circle| !(circle.radius + circle.height + circle.offset.norm()).is_finite()) {
            Some(place) => Err(no_circle(&sweeps[place].name)),
            None => Ok(Self { circles }),
        }
    }
}

fn no_circle(name: &str) -> Error {
    Error::data(format!("the lengths of test `{name}` lie on no circle of about the nominal size"))
        .help("are the readings, the length of the bar and the nominal balls those of this test?")
}

fn circle_numbers(sweep: &Sweep, lengths: &[f64], evaluation: Evaluation) -> Result<CircleNumbers> {
    match evaluation {
        Evaluation::PolarPlot => {
            let (offset, radius) = polar_plot(sweep, lengths).ok_or_else(|| no_circle(&sweep.name))?;
            Ok(CircleNumbers { offset, square: radius * radius + sweep.height * sweep.height })
        }
        // L² = h² + R² + o² + 2R (o1 cos + o2 sin), exactly, if one axis moves.
        Evaluation::SquaredLength => {
            let found = Projection::new(&sweep.angles).of(lengths.iter().map(|length| length * length));
            Ok(CircleNumbers { offset: Vector2::new(found[1], found[2]) / 2.0, square: found[0] })
        }
    }
}

/// Offsets, radii and heights of all tests.
fn shapes(sweeps: &[Sweep], numbers: &[CircleNumbers], evaluation: Evaluation) -> Vec<Circle> {
    let mut shapes: Vec<Circle> = sweeps
        .iter()
        .map(|sweep| Circle {
            offset: Vector2::zeros(),
            radius: sweep.radius,
            height: sweep.height,
            nominal_offset: Vector2::zeros(),
        })
        .collect();
    for _ in 0..STEPS {
        for (shape, numbers) in shapes.iter_mut().zip(numbers) {
            shape.offset = match evaluation {
                Evaluation::PolarPlot => numbers.offset,
                Evaluation::SquaredLength => numbers.offset / shape.radius,
            };
        }
        let squares = shapes.iter().zip(numbers).map(|(shape, numbers)| match evaluation {
            Evaluation::PolarPlot => numbers.square,
            Evaluation::SquaredLength => numbers.square - shape.offset.norm_squared(),
        });
        let squares: Vec<f64> = squares.collect();
        for (place, shape) in shapes.iter_mut().enumerate() {
            (shape.radius, shape.height) = size(sweeps, &squares, place);
        }
    }
    shapes
}

/// Radius and height of a test, from `square = radius² + height²` of all tests of its pivot and axis. Differences of heights
/// are nominal. The pivot is `up` lower than nominal, so that `square - nominal height² = (radius² + up²) + 2 up height`.
fn size(sweeps: &[Sweep], squares: &[f64], place: usize) -> (f64, f64) {
    let same = |sweep: &Sweep| (sweep.pivot, sweep.axis) == (sweeps[place].pivot, sweeps[place].axis);
    let together: Vec<(f64, f64)> = sweeps
        .iter()
        .zip(squares)
        .filter(|(sweep, _)| same(sweep))
        .map(|(sweep, square)| (sweep.height, square - sweep.height * sweep.height))
        .collect();
    let count = together.len() as f64;
    let mean = |value: &dyn Fn(&(f64, f64)) -> f64| together.iter().map(value).sum::<f64>() / count;
    let (height, square) = (mean(&|test| test.0), mean(&|test| test.1));
    let spread = mean(&|test| (test.0 - height).powi(2));
    let slope = if spread.sqrt() > HEIGHTS_DIFFER / 2.0 {
        mean(&|test| (test.0 - height) * (test.1 - square)) / spread
    } else {
        0.0
    };
    let up = slope / 2.0;
    ((square - slope * height - up * up).sqrt(), sweeps[place].height + up)
}
