//! Values and conditions of the languages, as far as our programs use them.

/// The value of a variable.
pub type Variables<'a> = &'a dyn Fn(&str) -> Result<f64, String>;

/// A word, and whether two values compare so.
type Comparison = (&'static str, fn(f64, f64) -> bool);

pub struct Expression<'a> {
    text: &'a str,
    brackets: (char, char),
    variables: Variables<'a>,
}

/// The value of a text; 1 and 0 of a condition.
pub fn value(text: &str, brackets: (char, char), variables: Variables<'_>) -> Result<f64, String> {
    let mut expression = Expression { text, brackets, variables };
    let value = expression.all()?;
    match expression.text.trim() {
        "" => Ok(value),
        rest => Err(format!("`{rest}` is left of `{text}`")),
    }
}

impl Expression<'_> {
    fn take(&mut self, word: &str) -> bool {
        let rest = self.text.trim_start().strip_prefix(word);
        self.text = rest.unwrap_or(self.text);
        rest.is_some()
    }

    fn all(&mut self) -> Result<f64, String> {
        let mut value = self.comparison()?;
        while self.take("AND ") {
            let other = self.comparison()?;
            value = f64::from(u8::from(value != 0.0 && other != 0.0));
        }
        Ok(value)
    }

    fn comparison(&mut self) -> Result<f64, String> {
        let one = self.sum()?;
        let all: [Comparison; 9] = [
            ("EQ ", |a, b| a == b),
            ("NE ", |a, b| a != b),
            ("GE ", |a, b| a >= b),
            ("LE ", |a, b| a <= b),
            ("GT ", |a, b| a > b),
            ("LT ", |a, b| a < b),
            (">=", |a, b| a >= b),
            ("<=", |a, b| a <= b),
            ("<", |a, b| a < b),
        ];
        for (word, holds) in all {
            if !self.text.trim_start().starts_with("<<") && self.take(word) {
                return Ok(f64::from(u8::from(holds(one, self.sum()?))));
            }
        }
        Ok(one)
    }

    fn sum(&mut self) -> Result<f64, String> {
        let mut value = self.product()?;
        loop {
            if self.take("+") {
                value += self.product()?;
            } else if self.take("-") {
                value -= self.product()?;
            } else {
                return Ok(value);
            }
        }
    }

    fn product(&mut self) -> Result<f64, String> {
        let mut value = self.factor()?;
        loop {
            if self.take("*") {
                value *= self.factor()?;
            } else if self.take("/") {
                value /= self.factor()?;
            } else {
                return Ok(value);
            }
        }
    }

    fn factor(&mut self) -> Result<f64, String> {
        if self.take("-") {
            return Ok(-self.factor()?);
        }
        if self.take("+") {
            return self.factor();
        }
        if self.take("ABS") {
            return Ok(self.factor()?.abs());
        }
        if self.take("ROUND") {
            return Ok(self.factor()?.round());
        }
        let (open, close) = self.brackets;
        if self.take(&open.to_string()) {
            let value = self.all()?;
            return if self.take(&close.to_string()) { Ok(value) } else { Err(format!("`{}` is open", self.text)) };
        }
        let text = self.text.trim_start();
        let first = text.chars().next().unwrap_or(' ');
        if first.is_ascii_digit() || first == '.' {
            let end = text.find(|letter: char| !letter.is_ascii_digit() && letter != '.').unwrap_or(text.len());
            self.text = &text[end..];
            return text[..end].parse().map_err(|_| format!("`{text}` is no number"));
        }
        let end = match (text.starts_with("#<"), text.starts_with('$')) {
            (true, _) => text.find('>').map(|end| end + 1),
            (_, true) => {
                let name =
                    text[1..].find(|letter: char| !letter.is_ascii_alphanumeric() && letter != '_').map(|end| end + 1);
                match name {
                    Some(end) if text[end..].starts_with('[') => text.find(']').map(|end| end + 1),
                    name => name,
                }
            }
            _ => text[1.min(text.len())..]
                .find(|letter: char| !letter.is_ascii_alphanumeric() && letter != '_')
                .map(|end| end + 1),
        };
        let name = &text[..end.unwrap_or(text.len())];
        if name.is_empty() {
            return Err("a value is missing".to_owned());
        }
        self.text = &text[name.len()..];
        (self.variables)(name)
    }
}
