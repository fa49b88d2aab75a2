//! Householder reflections of rows that stand one after another.

/// Reflects rows of `width` numbers so that the first `own` columns become an upper triangle.
pub(super) fn eliminate(lines: &mut [f64], width: usize, own: usize) {
    let rows = lines.len() / width;
    for column in 0..own.min(rows) {
        reflect(lines, width, column);
    }
}

/// Reflects the rows from number `column` on so that this column is zero below its first entry there (Golub and Van Loan 2013,
/// section 5.1).
pub(super) fn reflect(lines: &mut [f64], width: usize, column: usize) {
    let below = &mut lines[column * width..];
    let size = below.chunks_exact(width).map(|line| line[column] * line[column]).sum::<f64>().sqrt();
    if size == 0.0 {
        return;
    }
    let first = below[column];
    let pivot = -size.copysign(first);
    // The reflection is 1 - v v' / (size |v_0|), where v_0 = first - pivot.
    below[column] = first - pivot;
    let factor = 1.0 / (size * below[column].abs());
    let mut along = vec![0.0; width - column - 1];
    for line in below.chunks_exact(width) {
        let (by, rest) = (line[column], &line[column + 1..]);
        along.iter_mut().zip(rest).for_each(|(sum, value)| *sum += by * value);
    }
    along.iter_mut().for_each(|sum| *sum *= factor);
    for line in below.chunks_exact_mut(width) {
        let by = std::mem::replace(&mut line[column], 0.0);
        line[column + 1..].iter_mut().zip(&along).for_each(|(value, along)| *value -= by * along);
    }
    below[column] = pivot;
}

/// Exchanges two columns.
pub(super) fn exchange(lines: &mut [f64], width: usize, one: usize, other: usize) {
    lines.chunks_exact_mut(width).for_each(|line| line.swap(one, other));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inner_products_stay() {
        let before = [3.0, 1.0, 2.0, -4.0, 0.5, 1.0, 0.0, 2.0, -1.0, 1e-3, 1.0, 1.0];
        let mut after = before;
        eliminate(&mut after, 3, 2);
        assert!(after[3] == 0.0 && after[6] == 0.0 && after[7] == 0.0 && after[9] == 0.0);
        let product = |lines: &[f64], one: usize, other: usize| -> f64 {
            lines.chunks_exact(3).map(|line| line[one] * line[other]).sum()
        };
        for (one, other) in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)] {
            assert!((product(&before, one, other) - product(&after, one, other)).abs() < 1e-14);
        }
    }
}
