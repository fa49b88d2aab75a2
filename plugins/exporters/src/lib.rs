//! Exporters: corrected set-points, tables of motion errors, volumetric errors and uncertainties, screw compensation files of LinuxCNC.

mod error_table;
mod linuxcnc;
mod probe;
mod sampling;
mod screw_file;
mod set_points;
#[cfg(test)]
mod testing;
mod uncertainty;
mod volumetric;
