//! Tables to plot with other programs.

use std::f64::consts::TAU;
use std::fmt::Write;

use abbe_core::{Figure, Findings};
use abbe_standards::spindle::{Harmonics, Sectors};

use super::Spindle;
use super::checked::Checked;
use crate::motion::Motion;

/// A name that a file can have.
fn file(kind: &str, run: &str) -> String {
    let own: String =
        run.chars().map(|letter| if letter.is_alphanumeric() || letter == '.' { letter } else { '-' }).collect();
    format!("{kind}-{own}.csv")
}

/// Writes a line of cells.
fn line(text: &mut String, cells: impl IntoIterator<Item = String>) {
    let cells: Vec<String> = cells.into_iter().collect();
    // Writing to a text never fails.
    let _ = writeln!(text, "{}", cells.join(","));
}

/// The synchronous part of a run over the angle, µm: radial motions about their least squares circle, axial ones whole.
pub fn polar(settings: &Spindle, motion: &Motion, checked: &Checked, findings: &mut Findings) {
    let mut columns: Vec<(String, Harmonics)> = Vec::new();
    if let Some(rotating) = checked.rotating(&checked.values) {
        columns.push(("rotating_um".to_owned(), rotating.without(0).without(1)));
    }
    for (number, sensor) in motion.radial.keys().enumerate() {
        columns.push((format!("{sensor}_um"), checked.sensor(number, &checked.values).without(1)));
    }
    if let Some(axial) = &motion.axial {
        columns.push((format!("{axial}_um"), checked.sensor(motion.radial.len(), &checked.values)));
    }
    let mut text = String::new();
    line(&mut text, ["S_deg".to_owned()].into_iter().chain(columns.iter().map(|(name, _)| name.clone())));
    let angles = u32::from(settings.angles);
    for index in 0..=angles {
        let part = f64::from(index) / f64::from(angles);
        let values = columns.iter().map(|(_, motion)| format!("{:.6}", motion.at(part * TAU) * 1e3));
        line(&mut text, [format!("{}", part * 360.0)].into_iter().chain(values));
    }
    findings.tables.insert(file("polar", &checked.run), text);
}

/// Smallest and largest reading of each sector, µm.
pub fn bands(motion: &Motion, checked: &Checked, bands: &[Sectors], findings: &mut Findings) {
    let names = motion.radial.keys().chain(&motion.axial).map(String::as_str).chain(["rotating"]);
    let headers = names.take(bands.len()).flat_map(|name| [format!("{name}_low_um"), format!("{name}_high_um")]);
    let mut text = String::new();
    line(&mut text, ["S_deg".to_owned()].into_iter().chain(headers));
    for sector in 0..usize::from(motion.sectors) {
        let angle = 360.0 * sector as f64 / f64::from(motion.sectors);
        let cells = bands.iter().flat_map(|band| match band.extremes(sector) {
            Some(extremes) => extremes.map(|value| format!("{value:.6}")),
            None => [String::new(), String::new()],
        });
        line(&mut text, [format!("{angle}")].into_iter().chain(cells));
    }
    findings.tables.insert(file("total", &checked.run), text);
}

/// Values by the names of their columns.
type Row = Vec<(String, f64)>;

/// Figures against speed: name of the run, rpm, figures.
#[derive(Default)]
pub struct Speeds(Vec<(String, f64, Row)>);

impl Speeds {
    /// Adds the figures of a run.
    pub fn push(&mut self, run: &str, speed: Option<f64>, figures: &[Figure]) {
        let inside = |name: &str| {
            // `synchronous fixed[600 r1]` is `synchronous fixed r1` of run 600.
            let own = name.replacen(&format!("[{run}"), "", 1).replacen(']', "", 1);
            own.trim_end().replace(' ', "_")
        };
        let values = figures.iter().filter_map(|figure| {
            Some((format!("{}_{}", inside(&figure.name), figure.unit.replace('/', "_per_")), figure.value?))
        });
        self.0.push((run.to_owned(), speed.unwrap_or(f64::NAN), values.collect()));
    }

    /// The table, slow runs first.
    pub fn text(mut self) -> String {
        self.0.sort_by(|one, other| one.1.total_cmp(&other.1));
        let mut names: Vec<String> = Vec::new();
        for (name, _) in self.0.iter().flat_map(|(.., values)| values) {
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
        let mut text = String::new();
        line(&mut text, ["run", "speed_rpm"].map(str::to_owned).into_iter().chain(names.iter().cloned()));
        for (run, speed, values) in &self.0 {
            let cell = |name: &String| {
                let own = values.iter().find(|(other, _)| other == name);
                own.map_or(String::new(), |(_, value)| format!("{value:.6}"))
            };
            let begin = [format!("\"{}\"", run.replace('"', "'")), format!("{speed:.3}")];
            line(&mut text, begin.into_iter().chain(names.iter().map(cell)));
        }
        text
    }
}
