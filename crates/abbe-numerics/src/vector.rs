//! Products and lengths of vectors that are slices.

/// The inner product; the sum of the first entries if one vector is longer.
pub fn dot(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(one, other)| one * other).sum()
}

/// The Euclidean norm.
pub fn norm(vector: &[f64]) -> f64 {
    norm_of(vector.iter().copied())
}

/// The Euclidean norm of values that stand in no slice.
pub(crate) fn norm_of(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|value| value * value).sum::<f64>().sqrt()
}
