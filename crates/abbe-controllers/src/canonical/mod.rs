//! LinuxCNC programs that the control's own interpreter writes out: subprograms, loops, variables and canned cycles become moves.
//!
//! `rs274 -g` prints the canonical machining functions that a program comes down to (Kramer, Proctor, Messina 2000, The NIST RS274/NGC
//! Interpreter, chapter 4): one command a line, with four decimals. [`prepare`] makes the text that it reads, [`Canonical`] makes
//! blocks of what it prints. What only the running control knows (positions of a probe, reference points, values of its inputs) is
//! refused, because an interpreter without a machine takes it as zero.

mod commands;
mod source;

pub use commands::Canonical;
pub use source::{Prepared, prepare};

/// Where an axis stands before the program says it, machine coordinates, mm and degrees: far from where machines are.
const UNKNOWN: f64 = -98_765.0;

/// Length, mm, of a tool whose length nobody gave.
const NO_LENGTH: f64 = 76_543.0;

/// The last digit that the interpreter prints.
const DIGIT: f64 = 1e-4;

/// Largest line number that LinuxCNC reads.
const MOST_LINES: usize = 99_999;
