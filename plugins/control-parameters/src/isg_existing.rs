//! Reads volumetric tables of ISG and Beckhoff: `ISG_CSV` and `ETALON_EXCHANGE`.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_compensation::active::Believed;
use abbe_compensation::rigid::LETTERS;
use abbe_core::{Axis, AxisKind, Error, Result};
use abbe_files::{LARGEST_TEXT, read_text};

/// What tables say, by the names of the control; positions in mm or degrees.
#[derive(Debug, Default)]
pub struct Active {
    /// Location errors and places.
    pub constants: BTreeMap<String, f64>,
    /// Error motions: positions and values, positions increasing.
    pub motions: BTreeMap<String, Vec<(f64, f64)>>,
    /// What the file that is read now has: constants (line and value), and motions.
    single: Vec<(String, usize, f64)>,
    rows: Vec<(String, Vec<Row>)>,
}

/// Refuses values and positions that are not believed.
struct Check<'a> {
    believed: &'a Believed<'a>,
    axes: &'a [Axis],
    path: &'a Path,
}

impl Check<'_> {
    /// A value, mm or rad, of a parameter that begins with the letter of its component.
    fn value(&self, component: &str, value: f64, line: usize) -> Result<()> {
        let (kind, factor) = match component.starts_with(['A', 'B', 'C']) {
            true => (AxisKind::Rotary, 1_f64.to_degrees()),
            false => (AxisKind::Linear, 1.0),
        };
        self.believed.value(kind, value * factor, self.path, line, "are they tables of this machine, in mm and rad?")
    }

    /// A location error: `X0C`, ..., `C0C`.
    fn constant(&self, line: usize, name: &str, value: f64) -> Result<()> {
        let letter = LETTERS.iter().find_map(|letter| name.strip_prefix(letter));
        let axis = letter.and_then(|rest| rest.strip_prefix('0'));
        match axis.is_some_and(|of| self.axes.iter().any(|axis| axis.name == of)) {
            true => self.value(name, value, line),
            false => Ok(()),
        }
    }

    /// An error motion: `EXX`, ..., `ECX`.
    fn motion(&self, name: &str, rows: &[Row]) -> Result<()> {
        let axis = self.axes.iter().find(|axis| name.get(2..) == Some(&axis.name));
        let Some((axis, component)) = axis.zip(name.strip_prefix('E')) else { return Ok(()) };
        rows.iter().try_for_each(|row| self.value(component, row.value, row.line))?;
        let positions: Vec<f64> = rows.iter().map(|row| row.position).collect();
        self.believed.coverage(axis, &positions, self.path, rows.first().map(|row| row.line))
    }
}

/// One point of an error motion.
#[derive(Debug)]
struct Row {
    line: usize,
    position: f64,
    value: f64,
}

/// A message, and the line that it is about, counted from 1.
type Wrong = (usize, String);

impl Active {
    /// Adds what a file says.
    pub fn read(&mut self, path: &Path, believed: &Believed<'_>, axes: &[Axis]) -> Result<()> {
        let text = read_text(path, LARGEST_TEXT)
            .map_err(|error| Error::data(format!("it cannot be read: {error}")).in_file(path).setting("existing"))?;
        let lines: Vec<(usize, &str)> =
            (1..).zip(text.lines().map(str::trim)).filter(|(_, line)| !line.is_empty()).collect();
        let lines: Vec<(usize, &str)> = lines.into_iter().filter(|(_, line)| !line.starts_with("//")).collect();
        let is_etalon = lines.first().is_some_and(|(_, line)| line.starts_with('['));
        let found = if is_etalon { self.sections(&lines) } else { self.blocks(&lines) };
        found.map_err(|(line, message)| Error::data(message).at(path, line, None).setting("existing"))?;
        let check = Check { believed, axes, path };
        let constants = std::mem::take(&mut self.single);
        let mut motions = std::mem::take(&mut self.rows).into_iter();
        (constants.iter().try_for_each(|(name, line, value)| check.constant(*line, name, *value)))
            .and_then(|()| motions.try_for_each(|(name, rows)| check.motion(&name, &rows)))
            .map_err(|error| error.setting("existing"))
    }

    fn blocks(&mut self, lines: &[(usize, &str)]) -> Result<(), Wrong> {
        for block in lines.split(|(_, line)| line.starts_with('#')) {
            let Some(((at, header), rows)) = block.split_first() else { continue };
            let names: Vec<&str> = header.split_whitespace().collect();
            let mut values: Vec<Vec<f64>> = Vec::new();
            let first = rows.first().map_or(*at, |(line, _)| *line);
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
                        self.constant(*at, first, name, *value)?;
                    }
                }
                ([argument], _) => {
                    for (place, name) in names.iter().enumerate().filter(|(place, _)| place != argument) {
                        if !name.ends_with(names[*argument]) {
                            return Err((*at, format!("{name} over {} is not added", names[*argument])));
                        }
                        let of_line = |(values, (line, _)): (&Vec<f64>, &(usize, &str))| Row {
                            line: *line,
                            position: values[*argument],
                            value: values[place],
                        };
                        self.motion(*at, name, values.iter().zip(rows).map(of_line).collect())?;
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
                Some(("VALUE", value)) => self.constant(*at, *at + 1, name, number(*at + 1, value)?)?,
                Some(("Gridpoints", "{")) => {
                    let mut pairs = Vec::new();
                    loop {
                        let (line, text) = rest.next().ok_or_else(|| (*at, format!("[{name}] has no end `}}`")))?;
                        match text.split_whitespace().collect::<Vec<_>>().as_slice() {
                            ["}"] => break,
                            [position, value] => {
                                let (position, value) = (number(*line, position)?, number(*line, value)?);
                                pairs.push(Row { line: *line, position, value });
                            }
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

    /// A value, which stands in the line `of_value`.
    fn constant(&mut self, line: usize, of_value: usize, name: &str, value: f64) -> Result<(), Wrong> {
        self.single.push((name.to_owned(), of_value, value));
        match self.constants.insert(name.to_owned(), value) {
            None => Ok(()),
            Some(_) => Err((line, format!("{name} stands there twice"))),
        }
    }

    fn motion(&mut self, line: usize, name: &str, rows: Vec<Row>) -> Result<(), Wrong> {
        if rows.is_empty() || rows.windows(2).any(|pair| pair[0].position >= pair[1].position) {
            return Err((line, format!("positions of {name} have to increase")));
        }
        let pairs = rows.iter().map(|row| (row.position, row.value)).collect();
        self.rows.push((name.to_owned(), rows));
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
