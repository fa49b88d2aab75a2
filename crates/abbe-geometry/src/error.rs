//! What a fit can fail on.

use std::fmt;

/// Why points do not determine a shape.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FitError {
    /// There are fewer points than the shape needs.
    TooFew {
        /// The shape.
        shape: &'static str,
        /// Number of points that it needs.
        needed: usize,
        /// Number of points that there are.
        found: usize,
    },
    /// A coordinate is not a finite number.
    NotFinite {
        /// Index of the point.
        point: usize,
    },
    /// The points lie such that many shapes fit them equally well, or none does best.
    Undetermined {
        /// The shape.
        shape: &'static str,
        /// How the points lie.
        because: &'static str,
    },
}

impl fmt::Display for FitError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooFew { shape, needed, found } => {
                write!(f, "a {shape} needs {needed} points or more, and there are {found}")
            }
            Self::NotFinite { point } => write!(f, "point {} has a coordinate that is no finite number", point + 1),
            Self::Undetermined { shape, because } => write!(f, "the points determine no {shape}: {because}"),
        }
    }
}

impl std::error::Error for FitError {}

impl FitError {
    /// The same error with the name of the shape that the caller asked for.
    pub(crate) fn of(self, asked: &'static str) -> Self {
        match self {
            Self::TooFew { needed, found, .. } => Self::TooFew { shape: asked, needed, found },
            Self::Undetermined { because, .. } => Self::Undetermined { shape: asked, because },
            other => other,
        }
    }
}
