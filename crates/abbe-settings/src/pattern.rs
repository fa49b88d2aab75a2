//! Patterns of parameter names: `?` is any one character, `*` any number of characters, everything else (brackets too) is
//! literal.

/// Whether `name` matches `pattern`.
pub fn matches(pattern: &str, name: &str) -> bool {
    let (mut pattern, mut name) = (pattern.chars(), name.chars());
    // What follows the last `*`, and the part of the name that it has to match where `*` takes no more than before.
    let mut last = None;
    loop {
        let (mut after, mut rest) = (pattern.clone(), name.clone());
        match (after.next(), rest.next()) {
            (None, None) => return true,
            (Some('*'), _) => {
                last = Some((after.clone(), name.clone()));
                pattern = after;
            }
            (Some(token), Some(letter)) if token == '?' || token == letter => (pattern, name) = (after, rest),
            // `*` takes one letter more.
            _ => {
                let Some((after, rest)) = &mut last else { return false };
                if rest.next().is_none() {
                    return false;
                }
                (pattern, name) = (after.clone(), rest.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::matches;

    #[test]
    fn patterns() {
        let cases = [
            ("E?0?", "EA0B", true),
            ("E?0?", "EA0BB", false),
            ("E??[b]", "EXX[b]", true),
            ("E??[b]", "EXXb", false),
            ("table.*", "table.facet[7].d", true),
            ("*", "", true),
            ("?", "", false),
            ("dzt[t?]", "dzt[t12]", false),
            ("*[t*]", "dzt[day2.t1]", false),
            ("dzt[*t?]", "dzt[day2.t1]", true),
            ("", "x", false),
        ];
        for (pattern, name, expected) in cases {
            assert_eq!(matches(pattern, name), expected, "{pattern} on {name}");
        }
    }

    /// Every pattern of up to five of these letters, on every name of up to four, against the definition.
    #[test]
    fn patterns_are_as_they_are_defined() {
        fn defined(pattern: &[u8], name: &[u8]) -> bool {
            match (pattern, name) {
                ([], name) => name.is_empty(),
                ([b'*', after @ ..], name) => (0..=name.len()).any(|taken| defined(after, &name[taken..])),
                ([token, after @ ..], [letter, rest @ ..]) => {
                    (*token == b'?' || token == letter) && defined(after, rest)
                }
                _ => false,
            }
        }
        let texts = |letters: &[char], longest: usize| -> Vec<String> {
            let (mut all, mut place) = (vec![String::new()], 0);
            while all[place].len() < longest {
                let longer: Vec<String> = letters.iter().map(|letter| format!("{}{letter}", all[place])).collect();
                all.extend(longer);
                place += 1;
            }
            all
        };
        for pattern in texts(&['a', 'b', '?', '*'], 5) {
            for name in texts(&['a', 'b'], 4) {
                let expected = defined(pattern.as_bytes(), name.as_bytes());
                assert_eq!(matches(&pattern, &name), expected, "{pattern} on {name}");
            }
        }
    }
}
