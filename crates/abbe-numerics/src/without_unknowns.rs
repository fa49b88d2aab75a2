//! Takes unknowns out of a factor.

use faer::Mat;

use crate::factor::Factor;

impl Factor {
    /// The factor of the same rows without some unknowns: their columns are taken out, and what is left below the diagonal is turned into it
    /// (Givens 1958).
    pub fn without_unknowns(&self, dropped: impl Fn(usize) -> bool) -> Self {
        let n = self.unknowns();
        let kept: Vec<usize> = (0..n).filter(|&unknown| !dropped(unknown)).collect();
        let mut triangle = Mat::zeros(kept.len(), kept.len());
        let mut turns: Vec<Turn> = Vec::new();
        for (column, &from) in kept.iter().enumerate() {
            let mut entries = self.column(from);
            turns.iter().for_each(|turn| turn.apply(&mut entries));
            for row in (column + 1..=from).rev() {
                let turn = Turn::into_upper(&entries, row);
                turn.apply(&mut entries);
                turns.push(turn);
            }
            triangle.col_as_slice_mut(column)[..=column].copy_from_slice(&entries[..=column]);
        }
        let mut right = self.right().to_vec();
        turns.iter().for_each(|turn| turn.apply(&mut right));
        let rest = self.remaining_cost() + right.drain(kept.len()..).map(|value| value * value).sum::<f64>();
        let norms = kept.iter().map(|&unknown| self.norms()[unknown]).collect();
        Self::new(triangle, right, norms, rest, self.rows())
    }
}

/// A rotation of two rows, the one before `row` and `row`.
struct Turn {
    row: usize,
    cosine: f64,
    sine: f64,
}

impl Turn {
    /// The one that leaves nothing of an entry, and adds it to the one before.
    fn into_upper(entries: &[f64], row: usize) -> Self {
        let (upper, lower) = (entries[row - 1], entries[row]);
        let size = upper.hypot(lower);
        if size == 0.0 {
            return Self { row, cosine: 1.0, sine: 0.0 };
        }
        Self { row, cosine: upper / size, sine: lower / size }
    }

    fn apply(&self, entries: &mut [f64]) {
        let (upper, lower) = (entries[self.row - 1], entries[self.row]);
        entries[self.row - 1] = self.cosine * upper + self.sine * lower;
        entries[self.row] = self.cosine * lower - self.sine * upper;
    }
}
