//! Exporters: tables of motion errors, screw compensation files of LinuxCNC.

mod error_table;
mod linuxcnc;
mod sampling;
#[cfg(test)]
mod testing;
