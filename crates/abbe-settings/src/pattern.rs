//! Patterns of parameter names: `?` is any one character, `*` any number of characters, everything else (brackets too) is
//! literal.

/// Whether `name` matches `pattern`.
pub fn matches(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<char>, Vec<char>) = (pattern.chars().collect(), name.chars().collect());
    // `reached[j]`: the part of the pattern read so far matches the first j characters of the name.
    let mut reached = vec![false; name.len() + 1];
    reached[0] = true;
    for &token in &pattern {
        if token == '*' {
            for j in 1..=name.len() {
                reached[j] |= reached[j - 1];
            }
        } else {
            for j in (1..=name.len()).rev() {
                reached[j] = reached[j - 1] && (token == '?' || token == name[j - 1]);
            }
            reached[0] = false;
        }
    }
    reached[name.len()]
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
}
