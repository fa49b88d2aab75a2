//! What is asked of a correction of programs.

use std::collections::BTreeMap;
use std::path::PathBuf;

use crate::dialect::Dialect;
use crate::geometry::Coordinates;
use crate::tools::Tools;

/// Settings of a correction of programs.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// The language.
    pub dialect: Dialect,
    /// The program, for messages.
    pub file: PathBuf,
    /// Largest distance, mm, of the corrected tip from the programmed one anywhere along feed moves.
    pub tolerance: f64,
    /// Decimals of linear axes, mm.
    pub decimals: usize,
    /// Decimals of rotary axes, degrees.
    pub rotary_decimals: usize,
    /// Lengths of tools.
    pub tools: Tools,
    /// Work offsets by their index: 0 is G54.
    pub offsets: BTreeMap<usize, Coordinates>,
    /// Where the axes stand at the start, machine coordinates.
    pub start: [Option<f64>; 9],
    /// Whether the control leaves out blocks that begin with `/`; none if that is not known.
    pub block_delete: Option<bool>,
    /// Whether numbers without a point are mm on a control where that is a parameter.
    pub integers_are_mm: bool,
    /// Whether F under G93 is the time in seconds, and not 1/minutes, where that differs.
    pub inverse_is_seconds: Option<bool>,
    /// Whether the axes stand after a change of the tool (M6) where they stood before; else their positions are not known then.
    pub stays_at_tool_change: bool,
    /// What the mark in a corrected program says of the calibration.
    pub calibration: String,
}

impl Options {
    /// The usual ones for a dialect.
    pub fn new(dialect: Dialect) -> Self {
        Self {
            dialect,
            file: PathBuf::new(),
            tolerance: 1e-3,
            decimals: 4,
            rotary_decimals: 6,
            tools: Tools::default(),
            offsets: BTreeMap::new(),
            start: [None; 9],
            block_delete: None,
            integers_are_mm: false,
            inverse_is_seconds: None,
            stays_at_tool_change: false,
            calibration: String::new(),
        }
    }
}

/// What the comment in a corrected program begins with.
pub const MARK: &str = abbe_compensation::MARK;
