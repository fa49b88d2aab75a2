//! Campaigns: laws that have to hold on many random machines and seeds, where a single example proves nothing.
//!
//! `cargo xtask campaign machines 2000 1` and the like run them in full; the tests run some of each.

pub mod bad_inputs;
pub mod batches;
pub mod compensation;
pub mod fleet;
pub mod fuzz;
pub mod hostile;
mod machine;
pub mod machines;
mod process;
mod programme;
pub mod signals;
pub mod sizes;
mod source;
pub mod spindle;
pub mod tango;
pub mod touches;

use abbe_numerics::Generator;

/// Random choices of one case; they depend on nothing but the seed and the number of the case.
pub(crate) struct Random(Generator);

impl Random {
    pub fn new(seed: u64, case: u64) -> Self {
        Self(Generator::new(seed, case))
    }

    /// A number between two others, all with the same probability.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.uniform() / 3.0_f64.sqrt() + 1.0) / 2.0
    }

    /// A number between minus and plus `size`.
    pub fn within(&mut self, size: f64) -> f64 {
        self.between(-size, size)
    }

    /// True with this probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.between(0.0, 1.0) < probability
    }

    /// A whole number from `low` to below `high`.
    pub fn count(&mut self, low: usize, high: usize) -> usize {
        low + self.0.index(high - low)
    }

    /// One of a list.
    pub fn of<T: Copy>(&mut self, list: &[T]) -> T {
        list[self.0.index(list.len())]
    }

    /// A list in another order (Fisher and Yates).
    pub fn shuffled<T: Copy>(&mut self, list: &[T]) -> Vec<T> {
        let mut list = list.to_vec();
        for last in (1..list.len()).rev() {
            list.swap(last, self.0.index(last + 1));
        }
        list
    }

    /// A normal number.
    pub fn normal(&mut self) -> f64 {
        self.0.normal()
    }

    /// A point of a unit sphere.
    pub fn direction(&mut self) -> [f64; 3] {
        let vector = [(); 3].map(|()| self.normal());
        let size = vector.iter().map(|part| part * part).sum::<f64>().sqrt();
        vector.map(|part| part / size)
    }
}
