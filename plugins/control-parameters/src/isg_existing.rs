//! Reads volumetric tables of ISG and Beckhoff: `ISG_CSV` and `ETALON_EXCHANGE`.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Error, Result};
use abbe_files::{LARGEST_TEXT, read_text};

/// What tables say, by the names of the control; positions in mm or degrees.
#[derive(Debug, Default)]
pub struct Active {
    /// Location errors and places.
    pub constants: BTreeMap<String, f64>,
    /// Error motions: positions and values, positions increasing.
    pub motions: BTreeMap<String, Vec<(f64, f64)>>,
}

/// A message, and the line that it is about, counted from 1.
type Wrong = (usize, String);

impl Active {
    /// Adds what a file says.
    pub fn read(&mut self, path: &Path) -> Result<()> {
        let text = read_text(path, LARGEST_TEXT)
            .map_err(|error| Error::data(format!("it cannot be read: {error}")).in_file(path).setting("existing"))?;
        let lines: Vec<(usize, &str)> =
            (1..).zip(text.lines().map(str::trim)).filter(|(_, line)| !line.is_empty()).collect();
        let lines: Vec<(usize, &str)> = lines.into_iter().filter(|(_, line)| !line.starts_with("//")).collect();
        let is_etalon = lines.first().is_some_and(|(_, line)| line.starts_with('['));
        let found = if is_etalon { self.sections(&lines) } else { self.blocks(&lines) };
        found.map_err(|(line, message)| Error::data(message).at(path, line, None).setting("existing"))
    }

    fn blocks(&mut self, lines: &[(usize, &str)]) -> Result<(), Wrong> {
        for block in lines.split(|(_, line)| line.starts_with('#')) {
            let Some(((at, header), rows)) = block.split_first() else { continue };
            let names: Vec<&str> = header.split_whitespace().collect();
            let mut values: Vec<Vec<f64>> = Vec::new();
            for (line, text) in rows {
                let row =
                    text.split_whitespace().map(|word| number(*line, word)).collect::<Result<Vec<f64>, Wrong>>()?;
                if row.len() != names.len() {
                    return Err((*line, format!("{} numbers were expected, here are {}", names.len(), row.len())));
                }
                values.push(row);
            }
            let arguments: Vec<usize> = (0..names.len()).filter(|&place| names[place].len() == 1).collect();
            match (arguments.as_slice(), values.as_slice()) {
                ([], [row]) => {
                    for (name, value) in names.iter().zip(row) {
                        self.constant(*at, name, *value)?;
                    }
                }
                ([argument], _) => {
                    for (place, name) in names.iter().enumerate().filter(|(place, _)| place != argument) {
                        if !name.ends_with(names[*argument]) {
                            return Err((*at, format!("{name} over {} is not added", names[*argument])));
                        }
                        let pairs = values.iter().map(|row| (row[*argument], row[place])).collect();
                        self.motion(*at, name, pairs)?;
                    }
                }
                ([], _) => {
                    return Err((*at, "one line of numbers was expected after names without an axis".to_owned()));
                }
                _ => return Err((*at, "errors over several axes are not added".to_owned())),
            }
        }
        Ok(())
    }

    fn sections(&mut self, lines: &[(usize, &str)]) -> Result<(), Wrong> {
        let mut rest = lines.iter();
        while let Some((at, line)) = rest.next() {
            let name = line.strip_prefix('[').and_then(|line| line.strip_suffix(']'));
            let name = name.ok_or_else(|| (*at, "a section `[NAME]` was expected".to_owned()))?;
            let expected = || (*at, format!("`VALUE = ..` or `Gridpoints = {{` was expected after [{name}]"));
            let (_, first) = rest.next().ok_or_else(expected)?;
            match first.split_once('=').map(|(key, value)| (key.trim(), value.trim())) {
                Some(("VALUE", value)) => self.constant(*at, name, number(*at + 1, value)?)?,
                Some(("Gridpoints", "{")) => {
                    let mut pairs = Vec::new();
                    loop {
                        let (line, text) = rest.next().ok_or_else(|| (*at, format!("[{name}] has no end `}}`")))?;
                        match text.split_whitespace().collect::<Vec<_>>().as_slice() {
                            ["}"] => break,
                            [position, value] => pairs.push((number(*line, position)?, number(*line, value)?)),
                            _ => return Err((*line, "a position and a value were expected".to_owned())),
                        }
                    }
                    self.motion(*at, name, pairs)?;
                }
                _ => return Err(expected()),
            }
        }
        Ok(())
    }

    fn constant(&mut self, line: usize, name: &str, value: f64) -> Result<(), Wrong> {
        match self.constants.insert(name.to_owned(), value) {
            None => Ok(()),
            Some(_) => Err((line, format!("{name} stands there twice"))),
        }
    }

    fn motion(&mut self, line: usize, name: &str, pairs: Vec<(f64, f64)>) -> Result<(), Wrong> {
        if pairs.is_empty() || pairs.windows(2).any(|pair| pair[0].0 >= pair[1].0) {
            return Err((line, format!("positions of {name} have to increase")));
        }
        match self.motions.insert(name.to_owned(), pairs) {
            None => Ok(()),
            Some(_) => Err((line, format!("{name} stands there twice"))),
        }
    }
}

fn number(line: usize, word: &str) -> Result<f64, Wrong> {
    let number = word.parse().ok().filter(|number: &f64| number.is_finite());
    number.ok_or_else(|| (line, "a number was expected".to_owned()))
}
