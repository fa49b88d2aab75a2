//! The methods: what is measured, with which artefact, in which file.

use std::fmt::Write as _;

use abbe_core::AxisKind;
use abbe_kinematics::{NamedAxis, StructuralLoop};

use super::Method;

/// How a recipe chooses among what could be measured.
#[derive(Debug, Clone, Copy)]
pub enum Choice {
    /// So many positions of the rotary axes, with all rows there.
    Groups(usize),
    /// So many rows.
    Rows(usize),
}

/// Indexations that a first calibration measures.
const INDEXATIONS: usize = 12;

/// Lengths that a first calibration measures.
const LENGTHS: usize = 30;

/// Indexations that are candidates, about: every one is tried, so that the time grows with their number.
const CANDIDATES: usize = 256;

/// Poses that a first calibration measures.
pub const POSES: usize = 60;

impl Method {
    /// Name of the artefact stage.
    pub fn stage(self) -> &'static str {
        match self {
            Self::Table => "table",
            Self::Ball => "ball",
            Self::Balls => "balls",
            Self::BallBar => "bar",
            Self::Poses => "target",
            Self::Lengths => "lengths",
        }
    }

    /// Name of the ingest stage.
    pub fn ingest(self) -> &'static str {
        match self {
            Self::Table | Self::Ball | Self::Balls => "touches",
            Self::BallBar => "readings",
            Self::Poses => "seen",
            Self::Lengths => "measured",
        }
    }

    /// The file with what is measured.
    pub fn data_file(self) -> &'static str {
        match self {
            Self::Table | Self::Ball | Self::Balls => "touches.csv",
            Self::BallBar => "readings.csv",
            Self::Poses => "poses.csv",
            Self::Lengths => "lengths.csv",
        }
    }

    /// What the file has, for people.
    pub fn data(self) -> &'static str {
        match self {
            Self::Table | Self::Ball | Self::Balls => "positions of the axes when the stylus touched",
            Self::BallBar => "positions of the axes, and what the bar read there",
            Self::Poses => "positions of the axes, and how the target was seen there",
            Self::Lengths => "positions of the axes at both ends of each length",
        }
    }

    /// The file of nominal places, if the artefact has some.
    pub fn nominal_file(self) -> Option<&'static str> {
        match self {
            Self::Table => Some("facets.csv"),
            Self::Ball | Self::Balls | Self::BallBar => Some("balls.csv"),
            Self::Poses | Self::Lengths => None,
        }
    }

    /// Nominal places, table frame; empty if the artefact has none.
    pub fn nominal(self) -> String {
        match self {
            Self::Table => faces(),
            Self::Ball => "feature,x_mm,y_mm,z_mm,diameter_mm\n1,90,30,120,25\n".to_owned(),
            Self::Balls => "feature,x_mm,y_mm,z_mm,diameter_mm\n1,110,20,60,25\n2,-70,100,140,25\n3,-60,-90,60,25\n4,40,-60,180,25\n".to_owned(),
            Self::BallBar => "feature,x_mm,y_mm,z_mm\n1,90,30,120\n".to_owned(),
            Self::Poses | Self::Lengths => String::new(),
        }
    }

    /// Plugin and settings of the artefact stage, with `from` left out, and the comment on them.
    pub fn artefact(self, chain: &StructuralLoop) -> (String, &'static str) {
        match self {
            Self::Table => ("facets, nominal: facets.csv, standard_uncertainty_um: 2".to_owned(), "of one touch"),
            Self::Ball | Self::Balls => {
                // Without rotary axes nothing but the form of a ball tells squareness.
                let pattern = if turning(chain).next().is_some() { "" } else { ", pattern: twenty-five" };
                (format!("balls, nominal: balls.csv, standard_uncertainty_um: 2{pattern}"), "of one touch")
            }
            Self::BallBar => (
                "ball-bar, nominal: balls.csv, bars_mm: { 150: 150 }, standard_uncertainty_um: 1, length_standard_uncertainty_um: 1".to_owned(),
                "fill in: length, of one reading, of the length",
            ),
            Self::Poses => {
                let observer = if turns_about_two(chain) { "estimated" } else { "at-tool" };
                (
                    format!("poses, observer: {observer}, standard_uncertainty_um: 20, standard_uncertainty_urad: 50"),
                    "fill in: of a position, of an orientation",
                )
            }
            Self::Lengths => (
                "length, standard_uncertainty_um: 2, reference_standard_uncertainty_um: 1".to_owned(),
                "fill in: of one length, of its calibration",
            ),
        }
    }

    /// What is measured, for people.
    pub fn measured(self) -> &'static str {
        match self {
            Self::Table => "touching the faces of the machine's own table, or of a block on it",
            Self::Ball => "touching a ball on the table",
            Self::Balls => "touching balls on the table",
            Self::BallBar => "a ball bar between the tool and a ball on the table",
            Self::Poses => "poses of a target on the table, seen by an observer in the tool",
            Self::Lengths => "calibrated lengths: a bar, or a step gauge, on the table",
        }
    }

    /// One row and several of them, and what is known of one.
    pub fn rows(self) -> [&'static str; 3] {
        match self {
            Self::Table | Self::Ball | Self::Balls => ["touch", "touches", "2 µm a touch"],
            Self::BallBar => ["reading", "readings", "1 µm a reading, 1 µm the length of the bar"],
            Self::Poses => ["pose", "poses", "20 µm and 50 µrad a pose"],
            Self::Lengths => ["length", "lengths", "2 µm a length, 1 µm its calibration"],
        }
    }

    /// Whether the tool has to come to places of the table, which takes three linear axes.
    pub fn needs_three_linear_axes(self) -> bool {
        self != Self::Poses
    }

    /// Whether candidates are generated; else they are written once.
    pub fn generates(self) -> bool {
        self != Self::Poses
    }

    /// What is chosen of so many rows at so many positions of the rotary axes.
    pub fn choice(self, rows: usize, groups: usize) -> Choice {
        match self {
            Self::Lengths => Choice::Rows(rows.min(LENGTHS)),
            Self::Poses => Choice::Rows(rows),
            _ if groups > 1 => Choice::Groups(groups.min(INDEXATIONS)),
            _ => Choice::Rows(rows),
        }
    }

    /// Whether a choice leaves something out.
    pub fn chooses(self, choice: Choice, rows: usize, groups: usize) -> bool {
        match choice {
            Choice::Groups(number) => number < groups,
            Choice::Rows(number) => number < rows,
        }
    }

    /// Largest root mean square of the residuals that a first calibration lets pass, µm.
    pub fn largest_rms(self) -> u8 {
        if self == Self::Poses { 50 } else { 10 }
    }

    /// The column whose labels make up the folds of the hold-out.
    pub fn held_out_by(self) -> &'static str {
        match self {
            Self::Poses => "pose",
            Self::Lengths => "length",
            _ => "group",
        }
    }

    /// The grid of candidates, as it stands under `generate`.
    pub fn grid(self, chain: &StructuralLoop) -> String {
        if self == Self::Lengths {
            return "\n    lengths:                            # in the frame of the table, rotary axes at zero\n      \
                    lengths_mm: [300]                   # fill in: those that are calibrated\n      \
                    x_mm: [-150, 150]\n      y_mm: [-150, 150]\n      z_mm: [0, 50]\n      \
                    azimuth_deg: { from: 0, to: 315, step: 45 }\n      elevation_deg: [0, 45, 90]"
                .to_owned();
        }
        let positions = positions_of_each(turning(chain).count());
        let indexations: Vec<String> = turning(chain)
            .map(|axis| {
                let [from, to, step] = grid_of(positions, turns_round(axis.direction()));
                format!("{}: {{ from: {from}, to: {to}, step: {step} }}", axis.name)
            })
            .collect();
        let mut settings = vec!["reach_deg: 90".to_owned()];
        if !indexations.is_empty() {
            settings.push(format!("indexations_deg: {{ {} }}", indexations.join(", ")));
        }
        if self == Self::BallBar {
            settings.push("columns: { reading_mm: 0 }".to_owned());
        }
        format!(" {{ {} }}", settings.join(", "))
    }

    /// Why this method tells nothing of a machine.
    pub fn useless(self) -> &'static str {
        match self {
            Self::Table => {
                "faces of unknown places and directions tell errors only where rotary axes turn the table or swing the tool: touch balls of known diameter"
            }
            Self::Ball | Self::Balls => "no error of this machine changes where the balls are touched",
            Self::BallBar => "no error of this machine changes what the bar reads",
            Self::Poses => "where target and observer stand does the same as every error of this machine",
            Self::Lengths => "no error of this machine changes a length on the table",
        }
    }
}

/// The rotary axes that move.
fn turning(chain: &StructuralLoop) -> impl Iterator<Item = &NamedAxis> {
    chain.axes.iter().filter(|axis| axis.kind() == AxisKind::Rotary && !axis.indexed)
}

/// Positions of each of so many rotary axes in the grid of candidates; none if they get all that make sense.
fn positions_of_each(rotary_axes: usize) -> Option<usize> {
    let fits = |positions: usize| positions.pow(rotary_axes as u32) <= CANDIDATES;
    match rotary_axes {
        0..=3 => None,
        _ => Some((2..=5).rev().find(|positions| fits(*positions)).unwrap_or(2)),
    }
}

/// First and last position of an axis, and the step between them, degrees. Two positions differ in sine and cosine of the angle.
fn grid_of(positions: Option<usize>, turns_round: bool) -> [i32; 3] {
    match (positions, turns_round) {
        (Some(2), true) => [0, 90, 90],
        (Some(2), false) => [-60, 30, 90],
        (Some(3), true) => [0, 240, 120],
        (Some(3), false) => [-60, 60, 60],
        (Some(4), true) => [0, 270, 90],
        (Some(4), false) => [-60, 60, 40],
        (_, true) => [0, 300, 60],
        (_, false) => [-60, 60, 30],
    }
}

/// Whether rotary axes turn the tool relative to the table about two directions at least.
pub fn turns_about_two(chain: &StructuralLoop) -> bool {
    let mut directions = turning(chain).map(NamedAxis::direction);
    let Some(first) = directions.next() else { return false };
    directions.any(|other| (0..3).map(|part| first[part] * other[part]).sum::<f64>().abs() < 1.0 - 1e-6)
}

/// Whether a rotary axis turns about the axis of the spindle or of the table: all round.
pub fn turns_round(direction: [f64; 3]) -> bool {
    direction[2] != 0.0
}

/// Three places on the top of a block and two on each of its sides.
fn faces() -> String {
    let mut text = "feature,x_mm,y_mm,z_mm,nx,ny,nz\n".to_owned();
    let mut add = |place: [f64; 3], normal: [f64; 3], number: usize| {
        let cells: Vec<String> = place.iter().chain(&normal).map(f64::to_string).collect();
        let _ = writeln!(text, "{number},{}", cells.join(","));
    };
    let mut number = 0;
    let mut next = || {
        number += 1;
        number
    };
    for [x, y] in [[100.0, 80.0], [-110.0, 70.0], [20.0, -100.0]] {
        add([x, y, 0.0], [0.0, 0.0, 1.0], next());
    }
    for side in [1.0, -1.0] {
        for [along, below] in [[-70.0, -20.0], [80.0, -45.0]] {
            add([side * 150.0, along, below], [side, 0.0, 0.0], next());
            add([along, side * 150.0, below], [0.0, side, 0.0], next());
        }
    }
    text
}
