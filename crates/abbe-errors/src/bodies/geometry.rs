//! Vectors of three numbers.

pub(super) type Vector = [f64; 3];

pub(super) fn sum(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(super) fn difference(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(super) fn times(a: Vector, factor: f64) -> Vector {
    a.map(|part| part * factor)
}

pub(super) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(super) fn norm(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

/// Directions of a body: along it, and two at right angles, right-handed. A body along x has those of the machine.
pub(super) fn directions(along: Vector) -> [Vector; 3] {
    // The direction of the machine after the one that the body follows most: y for x, z for y, x for z.
    let most = (0..3).fold(0, |most, part| if along[part].abs() > along[most].abs() + 1e-9 { part } else { most });
    let mut next = [0.0; 3];
    next[(most + 1) % 3] = 1.0;
    let across = difference(next, times(along, dot(next, along)));
    let across = times(across, 1.0 / norm(across));
    [along, across, cross(along, across)]
}
