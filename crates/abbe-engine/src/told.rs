//! Warnings once: work whose warnings were given before, and sentences that many groups have in common.

use std::collections::BTreeMap;

use tracing::subscriber::{NoSubscriber, with_default};

/// Does work again, on what somebody has been warned of already.
pub(crate) fn untold<T>(work: impl FnOnce() -> T) -> T {
    with_default(NoSubscriber::default(), work)
}

/// One sentence for all those that differ in numbers alone, in the order of the first of each: that of the first `name`, with how many
/// have it.
pub(crate) fn gathered(all: impl IntoIterator<Item = (String, String)>) -> Vec<String> {
    let mut found: Vec<(String, usize)> = Vec::new();
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    for (name, sentence) in all {
        let place = *places.entry(without_numbers(&sentence)).or_insert(found.len());
        match found.get_mut(place) {
            Some((_, count)) => *count += 1,
            None => found.push((format!("{name}: {sentence}"), 1)),
        }
    }
    let sentence = |(sentence, count): (String, usize)| match count {
        1 => sentence,
        count => format!("{sentence} (the first of {count} such warnings)"),
    };
    found.into_iter().map(sentence).collect()
}

fn without_numbers(sentence: &str) -> String {
    sentence.chars().filter(|letter| !letter.is_ascii_digit() && !"+-.".contains(*letter)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_that_differ_in_numbers_are_one() {
        let of = |name: &str, sentence: &str| (name.to_owned(), sentence.to_owned());
        let all = [
            of("a", "T1 reads the same from row 3 to row 90"),
            of("a", "the residuals are large"),
            of("b", "T1 reads the same from row 12 to row 80"),
            of("c", "T1 reads the same from row 1 to row 77"),
        ];
        let told = gathered(all);
        let expected =
            ["a: T1 reads the same from row 3 to row 90 (the first of 3 such warnings)", "a: the residuals are large"];
        assert_eq!(told, expected);
        assert_eq!(gathered([]), Vec::<String>::new());
    }
}
