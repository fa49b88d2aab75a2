//! The program `abbe`.

use std::process::ExitCode;

fn main() -> ExitCode {
    abbe::main()
}
