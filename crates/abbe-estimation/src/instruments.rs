//! Instruments that say nothing, or say it in another unit than the others.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Contact, Problem, Quantity, Unit};

/// Fewest readings that are looked at.
const SEVERAL: usize = 8;

/// Part of their standard uncertainty within which readings do not lie by chance. For 8 readings that scatter as stated the probability
/// is 8 (0.3 / sqrt(2 pi))^7 = 3e-6 at most, for more it is smaller.
const FAINT: f64 = 0.3;

/// The same, of another file, from which on that file is one of readings that scatter as stated.
const USUAL: f64 = 1.0;

/// The readings of a file.
struct Readings<'a> {
    set: &'a str,
    file: &'a Path,
    count: usize,
    /// From where to where they go, in the unit of memory.
    range: [f64; 2],
    /// The smallest standard uncertainty of their rows, in the unit of memory.
    uncertainty: f64,
    quantity: Quantity,
}

impl Readings<'_> {
    fn width(&self) -> f64 {
        self.range[1] - self.range[0]
    }

    fn is_silent(&self) -> bool {
        self.count >= SEVERAL && self.width() == 0.0
    }

    fn is_faint(&self) -> bool {
        self.count >= SEVERAL && self.width() > 0.0 && self.width() < FAINT * self.uncertainty
    }

    /// What is wrong with them, if those of some other file are as they should be.
    fn sentence(&self) -> Option<String> {
        let (set, count, file) = (self.set, self.count, self.file.display());
        if self.is_silent() {
            return Some(format!(
                "{set}: all {count} readings of `{file}` are the same, and those of other files are not: was the instrument connected?"
            ));
        }
        let (unit, factor) = Unit::for_people(Unit { of: self.quantity, per: None, and_per: None });
        self.is_faint().then(|| {
            format!(
                "{set}: the {count} readings of `{file}` lie within {:.1e} {unit}, far below their standard uncertainty of {:.1e} {unit}, \
                 and those of other files do not: is their unit right?",
                self.width() * factor,
                self.uncertainty * factor
            )
        })
    }
}

/// Files whose readings are all the same, or differ by far less than they scatter, while those of others do not: an instrument that was
/// not connected, or another unit than that of the column.
pub(crate) fn instruments(problem: &Problem) -> Vec<String> {
    let all = readings(problem);
    let is_usual = |readings: &Readings<'_>| readings.width() > USUAL * readings.uncertainty;
    match all.iter().any(is_usual) {
        true => all.iter().filter_map(Readings::sentence).collect(),
        false => Vec::new(),
    }
}

/// The readings of all files of instruments that read one number.
fn readings(problem: &Problem) -> Vec<Readings<'_>> {
    let mut of_files: BTreeMap<(&str, &Path), Readings<'_>> = BTreeMap::new();
    let equations = problem.equation_rows().into_iter().zip(problem.standard_uncertainties()).zip(problem.quantities());
    for (((set, row), uncertainty), quantity) in equations {
        let (name, info) = (problem.sets[set].name.as_str(), problem.sets[set].info());
        let Contact::Reading(column) = &info.contact else { continue };
        let data = &info.layout.data;
        let Some((readings, row)) = data.numbers(column).zip(info.layout.rows[row].data_row) else { continue };
        let Some(file) = data.files.get(data.origins[row].file) else { continue };
        let found = of_files.entry((name, file)).or_insert(Readings {
            set: name,
            file,
            count: 0,
            range: [f64::INFINITY, f64::NEG_INFINITY],
            uncertainty,
            quantity,
        });
        found.count += 1;
        found.range = [found.range[0].min(readings[row]), found.range[1].max(readings[row])];
        found.uncertainty = found.uncertainty.min(uncertainty);
    }
    of_files.into_values().collect()
}
