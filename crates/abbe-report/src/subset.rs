//! Some of many: a choice that is always the same.

/// Seed of the choice.
pub const SEED: u64 = 1;

/// Places of `most` out of `count`, in order: all that `always` names as far as there is room, and others by chance. All
/// if there are not more.
pub fn subset(count: usize, most: usize, always: impl Fn(usize) -> bool) -> Vec<usize> {
    if count <= most {
        return (0..count).collect();
    }
    // Chance decides among equals: evenly spaced ones would miss what alternates.
    let mut order: Vec<(bool, u64, usize)> = (0..count).map(|index| (!always(index), chance(index), index)).collect();
    order.select_nth_unstable(most.min(count - 1));
    let mut chosen: Vec<usize> = order[..most].iter().map(|(.., index)| *index).collect();
    chosen.sort_unstable();
    chosen
}

/// A number by chance for an index: the output function of SplitMix64 (Steele, Lea, Flood 2014).
fn chance(index: usize) -> u64 {
    let mut bits = (index as u64).wrapping_add(SEED).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_choice_is_even_and_keeps_what_it_has_to() {
        assert_eq!(subset(3, 5, |_| false), [0, 1, 2]);
        let chosen = subset(100_000, 4000, |index| index % 1000 == 7);
        assert_eq!(chosen.len(), 4000);
        assert!(chosen.is_sorted() && (0..100).all(|part| chosen.contains(&(1000 * part + 7))));
        // About as many of each tenth, and of odd and even ones.
        for part in 0..10 {
            let count = chosen.iter().filter(|index| **index / 10_000 == part).count();
            assert!((300..500).contains(&count), "{part}: {count}");
        }
        let odd = chosen.iter().filter(|index| **index % 2 == 1).count();
        assert!((1800..2300).contains(&odd), "{odd}");
        assert_eq!(subset(100_000, 4000, |index| index % 1000 == 7), chosen);
        // More than there is room for.
        assert_eq!(subset(100, 10, |_| true).len(), 10);
    }
}
