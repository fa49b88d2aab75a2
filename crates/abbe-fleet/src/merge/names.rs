//! Names of files after names of jobs.

use std::collections::BTreeSet;

/// Bytes of a name of a file that a name of a job gets.
const LONGEST: usize = 150;

/// The names that are taken.
#[derive(Default)]
pub struct Names(BTreeSet<String>);

impl Names {
    /// The name of the file of a calibration; one that is taken by another job gets a number.
    pub fn of(&mut self, job: &str, estimate: &str) -> String {
        let plain = |letter: char| match letter {
            '/' => '-',
            letter if letter.is_alphanumeric() || matches!(letter, '-' | '_' | '.') => letter,
            _ => '_',
        };
        let name: String = job.chars().map(plain).collect();
        let end = (0..=name.len().min(LONGEST)).rev().find(|end| name.is_char_boundary(*end)).unwrap_or(0);
        let name = format!("{}.{estimate}", &name[..end]);
        let mut found = name.clone();
        for number in 2.. {
            // Some disks take upper and lower case for the same.
            if self.0.insert(found.to_lowercase()) {
                break;
            }
            found = format!("{name}-{number}");
        }
        found + ".calibration.json"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_are_different() {
        let mut names = Names::default();
        let made: Vec<String> = [("f/a b", "fit"), ("f/a_b", "fit"), ("F/A_B", "fit"), ("../..", "fit")]
            .map(|(job, fit)| names.of(job, fit))
            .into();
        let expected = ["f-a_b.fit", "f-a_b.fit-2", "F-A_B.fit-3", "..-...fit"];
        assert_eq!(made, expected.map(|name| format!("{name}.calibration.json")));
    }
}
