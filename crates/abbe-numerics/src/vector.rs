//! Products and lengths of vectors that are slices.

/// The inner product. If one vector is longer, its further entries are ignored.
pub fn dot(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(one, other)| one * other).sum()
}

/// The Euclidean norm.
pub fn norm(vector: &[f64]) -> f64 {
    norm_of(vector.iter().copied())
}

/// The Euclidean norm of the values of an iterator.
pub(crate) fn norm_of(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|value| value * value).sum::<f64>().sqrt()
}
