//! What symbols of errors mean, in words.

/// A letter of a direction or of a rotation.
fn direction(letter: char) -> Option<&'static str> {
    Some(match letter {
        'X' => "along X",
        'Y' => "along Y",
        'Z' => "along Z",
        'A' => "about X",
        'B' => "about Y",
        'C' => "about Z",
        _ => return None,
    })
}

/// What a parameter is, as ISO 230-1 names it; empty for a name of another kind.
///
/// ```text
/// EA0B    orientation of the axis line of B, about X
/// EYX[2]  straightness: deviation along Y while X moves, term 2
/// ```
pub fn meaning(name: &str) -> String {
    let (symbol, term) = name.split_once('[').map_or((name, ""), |(symbol, term)| (symbol, term.trim_end_matches(']')));
    let letters: Vec<char> = symbol.chars().collect();
    let ['E', of, rest @ ..] = &letters[..] else { return String::new() };
    let Some(along) = direction(*of) else { return String::new() };
    let is_turn = "ABC".contains(*of);
    let term = if term.is_empty() { String::new() } else { format!(", term {term}") };
    match rest {
        ['0', axis @ ..] if !axis.is_empty() => {
            let axis: String = axis.iter().collect();
            let what = if is_turn { "orientation" } else { "position" };
            format!("{what} of the axis line of {axis}, {along}{term}")
        }
        [axis] if axis.is_ascii_uppercase() => {
            let is_own = axis == of || matches!((of, axis), ('X', 'U') | ('Y', 'V') | ('Z', 'W'));
            let what = match (is_own, is_turn, "XYZUVW".contains(*axis)) {
                (true, ..) => "positioning error".to_owned(),
                (false, false, true) => "straightness error".to_owned(),
                (false, true, true) => "angular error".to_owned(),
                (false, false, false) => "error motion".to_owned(),
                (false, true, false) => "tilt error motion".to_owned(),
            };
            match is_own {
                true => format!("{what} of {axis}{term}"),
                false => format!("{what} {along} while {axis} moves{term}"),
            }
        }
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symbols_are_told_in_words() {
        for (name, words) in [
            ("EA0B", "orientation of the axis line of B, about X"),
            ("EX0C", "position of the axis line of C, along X"),
            ("EYX[2]", "straightness error along Y while X moves, term 2"),
            ("EAX[1]", "angular error about X while X moves, term 1"),
            ("EXX[b]", "positioning error of X, term b"),
            ("EBB[cos1]", "positioning error of B, term cos1"),
            ("EZC[sin1]", "error motion along Z while C moves, term sin1"),
            ("EAC[cos1]", "tilt error motion about X while C moves, term cos1"),
            ("dxt", ""),
            ("E", ""),
            ("EÄX", ""),
        ] {
            assert_eq!(meaning(name), words, "{name}");
        }
    }
}
