//! Numbers and vectors of several poses, in the vector units of a processor.
//!
//! They are written as those of one pose are. Each pose gets what it would get alone, to the last digit: numbers of different poses
//! never meet, and no product is joined with a sum.

use std::ops::{Add, Mul, Sub};

use nalgebra::Vector3;
use pulp::Simd;

/// One number of each of some poses.
#[derive(Clone, Copy)]
pub(crate) struct Number<S: Simd>(pub S::f64s, S);

impl<S: Simd> Number<S> {
    /// The same number for all poses.
    #[inline(always)]
    pub fn all(simd: S, number: f64) -> Self {
        Self(simd.splat_f64s(number), simd)
    }

    /// The numbers at a place of a list.
    #[inline(always)]
    pub fn at(simd: S, list: &[S::f64s], place: usize) -> Self {
        Self(list[place], simd)
    }

    /// The same number for all poses, as these are.
    #[inline(always)]
    pub fn like(self, number: f64) -> Self {
        Self::all(self.1, number)
    }
}

impl<S: Simd> Add for Number<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.1.add_f64s(self.0, other.0), self.1)
    }
}

impl<S: Simd> Sub for Number<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.1.sub_f64s(self.0, other.0), self.1)
    }
}

impl<S: Simd> Mul for Number<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(self.1.mul_f64s(self.0, other.0), self.1)
    }
}

/// One vector of each of some poses.
#[derive(Clone, Copy)]
pub(crate) struct Vector<S: Simd>(pub [Number<S>; 3]);

impl<S: Simd> Vector<S> {
    /// The same vector for all poses.
    #[inline(always)]
    pub fn all(simd: S, vector: &Vector3<f64>) -> Self {
        Self([Number::all(simd, vector.x), Number::all(simd, vector.y), Number::all(simd, vector.z)])
    }

    /// The vectors at a place of a list, x of all poses, then y, then z.
    #[inline(always)]
    pub fn at(simd: S, list: &[S::f64s], place: usize) -> Self {
        let own = &list[3 * place..3 * place + 3];
        Self([Number(own[0], simd), Number(own[1], simd), Number(own[2], simd)])
    }

    /// Writes the vectors to a place of a list.
    #[inline(always)]
    pub fn write(self, list: &mut [S::f64s], place: usize) {
        let own = &mut list[3 * place..3 * place + 3];
        (own[0], own[1], own[2]) = (self.0[0].0, self.0[1].0, self.0[2].0);
    }

    #[inline(always)]
    pub fn dot(self, Self([x, y, z]): Self) -> Number<S> {
        self.0[0] * x + self.0[1] * y + self.0[2] * z
    }

    #[inline(always)]
    pub fn cross(self, Self([x, y, z]): Self) -> Self {
        let [a, b, c] = self.0;
        Self([b * z - c * y, c * x - a * z, a * y - b * x])
    }
}

impl<S: Simd> Add for Vector<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, Self([x, y, z]): Self) -> Self {
        let [a, b, c] = self.0;
        Self([a + x, b + y, c + z])
    }
}

impl<S: Simd> Sub for Vector<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, Self([x, y, z]): Self) -> Self {
        let [a, b, c] = self.0;
        Self([a - x, b - y, c - z])
    }
}

impl<S: Simd> Mul<Number<S>> for Vector<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, factor: Number<S>) -> Self {
        let [x, y, z] = self.0;
        Self([x * factor, y * factor, z * factor])
    }
}

/// The directions of a frame's axes in another frame: a rotation.
#[derive(Clone, Copy)]
pub(crate) struct Directions<S: Simd>(pub [Vector<S>; 3]);

impl<S: Simd> Directions<S> {
    /// Those of the other frame.
    #[inline(always)]
    pub fn same(simd: S) -> Self {
        let (one, zero) = (Number::all(simd, 1.0), Number::all(simd, 0.0));
        Self([Vector([one, zero, zero]), Vector([zero, one, zero]), Vector([zero, zero, one])])
    }

    /// Those at a place of a list.
    #[inline(always)]
    pub fn at(simd: S, list: &[S::f64s], place: usize) -> Self {
        Self([Vector::at(simd, list, place), Vector::at(simd, list, place + 1), Vector::at(simd, list, place + 2)])
    }

    /// Writes them to a place of a list of vectors.
    #[inline(always)]
    pub fn write(self, list: &mut [S::f64s], place: usize) {
        let [x, y, z] = self.0;
        x.write(list, place);
        y.write(list, place + 1);
        z.write(list, place + 2);
    }

    /// A vector of the frame, in the other one.
    #[inline(always)]
    pub fn outwards(self, Vector([a, b, c]): Vector<S>) -> Vector<S> {
        let [x, y, z] = self.0;
        x * a + y * b + z * c
    }

    /// A vector of the other frame, in this one.
    #[inline(always)]
    pub fn inwards(self, vector: Vector<S>) -> Vector<S> {
        let [x, y, z] = self.0;
        Vector([x.dot(vector), y.dot(vector), z.dot(vector)])
    }

    /// The same of three vectors.
    #[inline(always)]
    pub fn all_inwards(self, [x, y, z]: [Vector<S>; 3]) -> [Vector<S>; 3] {
        [self.inwards(x), self.inwards(y), self.inwards(z)]
    }
}
