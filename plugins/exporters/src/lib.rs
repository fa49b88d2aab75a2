//! Exporters: tables of motion errors, volumetric errors and uncertainties, screw compensation files of LinuxCNC.

mod error_table;
mod linuxcnc;
mod sampling;
#[cfg(test)]
mod testing;
mod uncertainty;
mod volumetric;
