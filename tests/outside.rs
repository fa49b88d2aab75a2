//! Tests that need a program which Rust does not bring: they say what is missing where it is, and are the second part of the
//! gate.

mod arrow;
mod browser;
mod certificate;
mod driver;
mod first_error_family;
mod fleet;
mod handed_on;
mod instruction_sets;
mod linuxcnc;
mod measured;
mod page;
mod programs;
mod served;
mod server;
