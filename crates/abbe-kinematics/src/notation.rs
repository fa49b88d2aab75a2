//! The structural loop in the notation of ISO 10791-6, e.g. `w C' B' X' b Z Y (S) t`.

use std::fmt;
use std::str::FromStr;

use abbe_core::{AxisKind, Branch};

/// Error in the notation of a chain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChainError(pub String);

impl fmt::Display for ChainError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for ChainError {}

/// An axis as the notation has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NamedAxis {
    /// Letter and number: `X`, `C1`.
    pub name: String,
    /// Side of the bed.
    pub branch: Branch,
    /// In parentheses: indexed and not interpolated.
    pub indexed: bool,
}

impl NamedAxis {
    /// Linear or rotary, by the letter (ISO 841).
    pub fn kind(&self) -> AxisKind {
        if self.name.starts_with(['A', 'B', 'C', 'S']) { AxisKind::Rotary } else { AxisKind::Linear }
    }

    /// The direction that the letter stands for.
    pub fn direction(&self) -> [f64; 3] {
        match self.name.chars().next() {
            Some('X' | 'U' | 'A') => [1.0, 0.0, 0.0],
            Some('Y' | 'V' | 'B') => [0.0, 1.0, 0.0],
            _ => [0.0, 0.0, 1.0],
        }
    }
}

/// The axes of a machine from workpiece to tool.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StructuralLoop {
    /// The axes, in the order of the notation.
    pub axes: Vec<NamedAxis>,
}

impl fmt::Display for StructuralLoop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "w")?;
        let mut bed_passed = false;
        for axis in &self.axes {
            if axis.branch == Branch::Tool && !bed_passed {
                write!(f, " b")?;
                bed_passed = true;
            }
            let prime = if axis.branch == Branch::Workpiece { "'" } else { "" };
            match axis.indexed {
                true => write!(f, " ({}{prime})", axis.name)?,
                false => write!(f, " {}{prime}", axis.name)?,
            }
        }
        write!(f, "{} t", if bed_passed { "" } else { " b" })
    }
}

impl FromStr for StructuralLoop {
    type Err = ChainError;

    fn from_str(text: &str) -> Result<Self, ChainError> {
        let wrong = |message: String| ChainError(format!("`{text}`: {message}"));
        let error = |message: String| Err(wrong(message));
        let mut rest = text.trim();
        let Some(after) = rest.strip_prefix('w') else {
            return error("it has to begin with the workpiece `w`".to_owned());
        };
        rest = after;
        let mut axes: Vec<NamedAxis> = Vec::new();
        let (mut bed, mut tool) = (false, false);
        let mut primes = Vec::new();
        loop {
            rest = rest.trim_start();
            let Some(first) = rest.chars().next() else { break };
            if tool {
                return error(format!("nothing may follow the tool `t`, but `{rest}` does"));
            }
            match first {
                'b' | 'f' if bed => return error("it has two beds (`b` or `f`); one was expected".to_owned()),
                'b' | 'f' => (bed, rest) = (true, &rest[1..]),
                't' => (tool, rest) = (true, &rest[1..]),
                '(' | 'A'..='Z' => {
                    let (axis, prime, after) = read_axis(rest, bed).map_err(wrong)?;
                    if axes.iter().any(|other| other.name == axis.name) {
                        return error(format!("axis {} stands in it twice; number them, e.g. C1 and C2", axis.name));
                    }
                    axes.push(axis);
                    primes.push(prime);
                    rest = after;
                }
                other => {
                    return error(format!("`{other}` was not expected; axes are capital letters, blanks separate"));
                }
            }
        }
        if !bed {
            return error("it has no bed; write `b` (or `f`) between workpiece side and tool side".to_owned());
        }
        if !tool {
            return error("it has to end with the tool `t`".to_owned());
        }
        // Primes may be left out: of all axes, or of none.
        let has_primes = primes.contains(&true);
        for (axis, prime) in axes.iter().zip(primes) {
            let name = &axis.name;
            match axis.branch {
                Branch::Tool if prime => {
                    return error(format!(
                        "the prime of {name}' says that it carries the workpiece, but it stands on the tool side of the bed"
                    ));
                }
                Branch::Workpiece if has_primes && !prime => {
                    return error(format!(
                        "{name} stands on the workpiece side of the bed, and others there have a prime: write {name}' if it carries the \
                         workpiece, or write it behind the bed"
                    ));
                }
                _ => {}
            }
        }
        Ok(Self { axes })
    }
}

/// Characters that are used for the prime.
const PRIMES: [char; 3] = ['\'', '\u{2019}', '\u{2032}'];

/// Reads one axis; returns the axis, whether it has a prime, and the rest of the text.
fn read_axis<'a>(text: &'a str, bed_passed: bool) -> Result<(NamedAxis, bool, &'a str), String> {
    let (indexed, inner) = match text.strip_prefix('(') {
        Some(inner) => (true, inner.trim_start()),
        None => (false, text),
    };
    let letter = inner.chars().next().unwrap_or(' ');
    if !"XYZUVWABCS".contains(letter) {
        return Err(format!("`{letter}` is no axis; known are X Y Z U V W (linear) and A B C S (rotary)"));
    }
    let digits = inner[1..].find(|c: char| !c.is_ascii_digit()).unwrap_or(inner.len() - 1);
    let (name, mut rest) = inner.split_at(1 + digits);
    if name[1..].starts_with('0') {
        return Err(format!("`{name}`: axis numbers start from 1"));
    }
    let mut prime = false;
    let mut read_prime = |rest: &mut &'a str| {
        if let Some(after) = rest.strip_prefix(PRIMES) {
            (prime, *rest) = (true, after);
        }
    };
    read_prime(&mut rest);
    if indexed {
        rest = rest
            .trim_start()
            .strip_prefix(')')
            .ok_or_else(|| format!("the parenthesis of the spindle {name} is not closed"))?;
        // People write (C') and (C)'.
        read_prime(&mut rest);
    }
    let branch = if bed_passed { Branch::Tool } else { Branch::Workpiece };
    Ok((NamedAxis { name: name.to_owned(), branch, indexed }, prime, rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notation() {
        let cases = [
            ("w C' B' X' b Z Y (S) t", Ok("w C' B' X' b Z Y (S) t")),
            ("wC'B'X'bZY(S)t", Ok("w C' B' X' b Z Y (S) t")),
            ("wCBXfZYSt", Ok("w C' B' X' b Z Y S t")),
            ("w b Y X Z t", Ok("w b Y X Z t")),
            ("w C2' C1' b t", Ok("w C2' C1' b t")),
            ("w X' Y' b Z (C1) t", Ok("w X' Y' b Z (C1) t")),
            ("w (C') b Z t", Ok("w (C') b Z t")),
            ("w (C)' b Z t", Ok("w (C') b Z t")),
            ("w (C\u{2032}) X\u{2019} b Z t", Ok("w (C') X' b Z t")),
            (
                "w X' Y' Z t",
                Err("`w X' Y' Z t`: it has no bed; write `b` (or `f`) between workpiece side and tool side"),
            ),
            (
                "w b X' t",
                Err(
                    "`w b X' t`: the prime of X' says that it carries the workpiece, but it stands on the tool side of the bed",
                ),
            ),
            (
                "w C' A' Z b Y X t",
                Err(
                    "`w C' A' Z b Y X t`: Z stands on the workpiece side of the bed, and others there have a prime: write Z' if it \
                     carries the workpiece, or write it behind the bed",
                ),
            ),
            ("X b t", Err("`X b t`: it has to begin with the workpiece `w`")),
            ("w b X", Err("`w b X`: it has to end with the tool `t`")),
            ("w b b t", Err("`w b b t`: it has two beds (`b` or `f`); one was expected")),
            ("w b X X t", Err("`w b X X t`: axis X stands in it twice; number them, e.g. C1 and C2")),
            ("w b Q t", Err("`w b Q t`: `Q` is no axis; known are X Y Z U V W (linear) and A B C S (rotary)")),
            ("w b (S t", Err("`w b (S t`: the parenthesis of the spindle S is not closed")),
            ("w b C0 t", Err("`w b C0 t`: `C0`: axis numbers start from 1")),
            ("w b X t t", Err("`w b X t t`: nothing may follow the tool `t`, but `t` does")),
        ];
        for (text, expected) in cases {
            let read = text.parse::<StructuralLoop>();
            match expected {
                Ok(expected) => assert_eq!(read.map(|chain| chain.to_string()), Ok(expected.to_owned())),
                Err(message) => assert_eq!(read, Err(ChainError(message.to_owned()))),
            }
        }
    }

    proptest::proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "\\PC*") {
            let _ = text.parse::<StructuralLoop>();
        }

        #[test]
        fn near_misses_are_read_or_refused(text in "w?[ ()'XYZABCS0-9bft]{0,16}t?") {
            if let Ok(chain) = text.parse::<StructuralLoop>() {
                assert_eq!(chain.to_string().parse(), Ok(chain));
            }
        }
    }
}
