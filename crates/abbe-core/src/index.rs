//! Indices that say what they count, so that one kind is not taken for another.

use std::fmt::{self, Display, Formatter};
use std::marker::PhantomData;
use std::ops::{Add, AddAssign, Index, IndexMut, Range};

use abbe_settings::Quantity;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::dataset::{LabelText, RowOrigin};
use crate::layout::Row;
use crate::problem::ObservationSet;

/// Items of lists that have one for each index of this kind. Such lists take these indices and no others. Labels in a column
/// take the rows of the data set:
///
/// ```
/// # use abbe_core::DataRow;
/// fn label(labels: &[String], data_row: DataRow) -> &str {
///     &labels[data_row]
/// }
/// ```
///
/// but not the rows of observations, which are others:
///
/// ```compile_fail,E0277
/// # use abbe_core::RowIndex;
/// fn label(labels: &[String], row: RowIndex) -> &str {
///     &labels[row]
/// }
/// ```
///
/// An artefact says what it lists by its own rows:
///
/// ```
/// # use abbe_core::{ListedBy, RowIndex};
/// struct Touch {
///     feature: usize,
/// }
///
/// impl ListedBy<RowIndex> for Touch {}
///
/// fn feature(touches: &[Touch], row: RowIndex) -> usize {
///     touches[row].feature
/// }
/// ```
pub trait ListedBy<I> {}

/// What all kinds of index have in common.
pub trait TypedIndex: Copy {
    /// The index with this number.
    fn from_number(number: usize) -> Self;

    /// Its number.
    fn number(self) -> usize;
}

/// A kind of index, and items that are listed by it.
macro_rules! index {
    ($(#[$doc:meta])* $name:ident: $($item:ty),*) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize, JsonSchema)]
        #[serde(transparent)]
        pub struct $name(pub usize);

        impl $name {
            /// The first `count` of them.
            pub fn first(count: usize) -> IndexRange<Self> {
                IndexRange::new(Self(0), count)
            }

            /// Items with their indices.
            pub fn enumerate<T>(items: impl IntoIterator<Item = T>) -> impl Iterator<Item = (Self, T)> {
                items.into_iter().enumerate().map(|(number, item)| (Self(number), item))
            }
        }

        impl TypedIndex for $name {
            fn from_number(number: usize) -> Self {
                Self(number)
            }

            fn number(self) -> usize {
                self.0
            }
        }

        impl Add<usize> for $name {
            type Output = Self;

            fn add(self, further: usize) -> Self {
                Self(self.0 + further)
            }
        }

        impl AddAssign<usize> for $name {
            fn add_assign(&mut self, further: usize) {
                self.0 += further;
            }
        }

        impl Display for $name {
            fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }

        $(impl ListedBy<$name> for $item {})*

        index!(@ $name, [T]);
        index!(@ $name, Vec<T>);
    };
    (@ $name:ident, $list:ty) => {
        impl<T: ListedBy<$name>> Index<$name> for $list {
            type Output = T;

            fn index(&self, index: $name) -> &T {
                &self[index.0]
            }
        }

        impl<T: ListedBy<$name>> IndexMut<$name> for $list {
            fn index_mut(&mut self, index: $name) -> &mut T {
                &mut self[index.0]
            }
        }
    };
}

index! {
    /// A set of a problem: an item of [`Problem::sets`](crate::Problem::sets).
    SetIndex: ObservationSet, IndexRange<EquationIndex>, Vec<f64>
}

index! {
    /// A row of some observations: an item of [`Layout::rows`](crate::Layout::rows). Other observations have other rows.
    RowIndex: Row, bool, usize, Vector3<f64>
}

index! {
    /// A row of a data set: an item of [`Dataset::origins`](crate::Dataset::origins), a cell of every column.
    DataRow: RowOrigin, f64, String, LabelText, bool, [f64; 3], Vector3<f64>
}

index! {
    /// A pose of some observations, in their [`PoseTable`](crate::PoseTable).
    PoseIndex:
}

index! {
    /// An equation of some observations, whether its row takes part or not: an item of
    /// [`Layout::standard_uncertainties`](crate::Layout::standard_uncertainties).
    LayoutEquation: f64, Quantity, LayoutEquation, Option<EquationIndex>
}

index! {
    /// An equation of a problem. It has those of the rows that take part, set by set.
    EquationIndex: f64, bool, Quantity, SetIndex, (SetIndex, RowIndex)
}

/// Indices that follow one another. A list takes them together, as it takes a range of numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IndexRange<I> {
    numbers: Range<usize>,
    kind: PhantomData<I>,
}

impl<I: TypedIndex> IndexRange<I> {
    /// As many indices as `count`, from `first` on.
    pub fn new(first: I, count: usize) -> Self {
        Self { numbers: first.number()..first.number() + count, kind: PhantomData }
    }

    /// The first of them, if there are any.
    pub fn start(&self) -> I {
        I::from_number(self.numbers.start)
    }

    /// The index after the last of them.
    pub fn end(&self) -> I {
        I::from_number(self.numbers.end)
    }

    /// Whether an index is one of them.
    pub fn contains(&self, index: I) -> bool {
        self.numbers.contains(&index.number())
    }
}

impl<I: TypedIndex> Iterator for IndexRange<I> {
    type Item = I;

    fn next(&mut self) -> Option<I> {
        self.numbers.next().map(I::from_number)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.numbers.size_hint()
    }
}

impl<I: TypedIndex> ExactSizeIterator for IndexRange<I> {}

impl<T: ListedBy<I>, I> Index<IndexRange<I>> for [T] {
    type Output = [T];

    fn index(&self, range: IndexRange<I>) -> &[T] {
        &self[range.numbers]
    }
}

impl<T: ListedBy<I>, I> IndexMut<IndexRange<I>> for [T] {
    fn index_mut(&mut self, range: IndexRange<I>) -> &mut [T] {
        &mut self[range.numbers]
    }
}

impl<T: ListedBy<I>, I> Index<IndexRange<I>> for Vec<T> {
    type Output = [T];

    fn index(&self, range: IndexRange<I>) -> &[T] {
        &self[range.numbers]
    }
}

impl<T: ListedBy<I>, I> IndexMut<IndexRange<I>> for Vec<T> {
    fn index_mut(&mut self, range: IndexRange<I>) -> &mut [T] {
        &mut self[range.numbers]
    }
}
