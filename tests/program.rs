//! The program under a second name: Cargo builds it before these tests, and tells them where it is.

use std::process::ExitCode;

fn main() -> ExitCode {
    abbe::main()
}
