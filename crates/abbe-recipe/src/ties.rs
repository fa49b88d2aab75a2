//! The key `tie` of an estimate: parameters that are one unknown.

use abbe_core::{DeclaredTie, Error};

use crate::document::{At, Node};

/// Reads `EXX[1]: scale` and `EYY[1]: { to: scale, factor: -1 }`.
pub(crate) fn read(node: &Node<'_>) -> Result<Vec<DeclaredTie>, Error> {
    let mut ties = Vec::new();
    for (pattern, value) in node.map()? {
        let (to, factor) = match value.get("to") {
            Some(to) => {
                value.only(&["to", "factor"])?;
                let factor = match value.get("factor") {
                    Some(factor) => {
                        let wrong = || factor.error(At::Value, "factor: a number was expected");
                        factor.value.as_f64().ok_or_else(wrong)?
                    }
                    None => 1.0,
                };
                (to.text()?, factor)
            }
            None => {
                let wrong = |_| {
                    let error = value.error(At::Value, "the name of the unknown was expected");
                    error.help("write `EXX[1]: scale`, or `EYY[1]: { to: scale, factor: -1 }`")
                };
                (value.text().map_err(wrong)?, 1.0)
            }
        };
        if to.trim().is_empty() || to.contains(['*', '?']) {
            return Err(value.error(At::Value, "the name of one unknown was expected"));
        }
        ties.push(DeclaredTie { pattern: pattern.to_owned(), to: to.to_owned(), factor });
    }
    Ok(ties)
}
