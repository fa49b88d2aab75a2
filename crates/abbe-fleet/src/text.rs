//! Texts with variables in braces: `data/{machine}/w{week}.csv`.

use serde_json::{Map, Value};

/// The values of the variables of a job, in their order.
pub type Variables = Map<String, Value>;

/// A value as text stands in a name.
pub fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

/// A text with the values of its variables; `{{` and `}}` are braces. A text that is nothing but a variable is its value, which may
/// be a number.
///
/// # Errors
/// A sentence for a variable that is not there, and for a brace that is not closed.
pub fn filled(text: &str, variables: &Variables) -> Result<Value, String> {
    if let Some(name) = text.strip_prefix('{').and_then(|rest| rest.strip_suffix('}'))
        && let Some(value) = variables.get(name)
    {
        return Ok(value.clone());
    }
    let (mut found, mut rest) = (String::new(), text);
    while let Some(place) = rest.find(['{', '}']) {
        found.push_str(&rest[..place]);
        let (brace, after) = rest[place..].split_at(1);
        if let Some(after) = after.strip_prefix(brace) {
            found.push_str(brace);
            rest = after;
            continue;
        }
        let Some((name, after)) = after.split_once('}').filter(|_| brace == "{") else {
            return Err(format!("`{text}` has a brace alone; `{{{{` stands for a brace, `{{name}}` for a variable"));
        };
        found.push_str(&plain(variables.get(name).ok_or_else(|| unknown(name, variables))?));
        rest = after;
    }
    found.push_str(rest);
    Ok(Value::String(found))
}

fn unknown(name: &str, variables: &Variables) -> String {
    let known: Vec<String> = variables.keys().map(|name| format!("`{name}`")).collect();
    match known.as_slice() {
        [] => format!("`{{{name}}}` is no variable: there are none under `for`"),
        known => format!("`{{{name}}}` is no variable; there are {}", known.join(", ")),
    }
}

/// The same for all texts in a value.
///
/// # Errors
/// As [`filled`].
pub fn filled_all(value: &Value, variables: &Variables) -> Result<Value, String> {
    match value {
        Value::String(text) => filled(text, variables),
        Value::Array(list) => list.iter().map(|item| filled_all(item, variables)).collect(),
        Value::Object(map) => {
            let entry = |(key, item): (&String, &Value)| Ok((key.clone(), filled_all(item, variables)?));
            map.iter().map(entry).collect::<Result<Map<_, _>, String>>().map(Value::Object)
        }
        other => Ok(other.clone()),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn variables_are_filled_in() {
        let variables = Variables::from_iter([("m".to_owned(), json!("A 1")), ("week".to_owned(), json!(3))]);
        for (text, expected) in [
            ("d/{m}/w{week}.csv", json!("d/A 1/w3.csv")),
            ("{week}", json!(3)),
            ("{m}", json!("A 1")),
            ("{{m}} {week}", json!("{m} 3")),
            ("", json!("")),
            ("ä{m}ö", json!("äA 1ö")),
        ] {
            assert_eq!(filled(text, &variables), Ok(expected), "{text}");
        }
        for wrong in ["{machine}", "{m", "m}", "{", "}{m}", "{m}{x}"] {
            assert!(filled(wrong, &variables).is_err(), "{wrong}");
        }
        let nested = filled_all(&json!({ "a": ["{week}", 1, { "b": "x{m}" }] }), &variables);
        assert_eq!(nested, Ok(json!({ "a": [3, 1, { "b": "xA 1" }] })));
    }
}
