//! Tests of `monte_carlo`.

use super::*;

#[test]
fn memory_does_not_grow_with_the_number_of_trials() {
    let mut trials = Trials::new(3);
    let stored = |trials: &Trials| -> Vec<usize> {
        let size = |values: &Values| match values {
            Values::Kept(kept) => kept.len(),
            Values::Binned(bins) => bins.counts.len(),
        };
        trials.values.iter().map(size).collect()
    };
    let push = |trials: &mut Trials, count: usize| {
        (0..count).for_each(|_| {
            let k = trials.count() as f64;
            trials.push(&[k.sin(), 7.5, 1e9 + k.cos()]);
        });
    };
    push(&mut trials, KEPT);
    assert_eq!(stored(&trials), [KEPT; 3]);
    push(&mut trials, 1);
    assert_eq!(stored(&trials), [20_002, 3, 20_002]);
    push(&mut trials, 50_000);
    assert_eq!(stored(&trials), [20_002, 3, 20_002]);
    for values in &trials.values {
        let Values::Binned(bins) = values else { panic!("values are kept") };
        assert_eq!(bins.counts.iter().sum::<u32>() as usize, trials.count());
    }
}
