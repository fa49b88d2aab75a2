//! Exporters for corrections over the workspace, for parameters of small controls, and for five-axis transformations.
//!
//! Each one predicts from the numbers that it writes what the control does with them
//! ([`Export::correction`](abbe_core::Export::correction)).

mod fanuc_five_axis;
mod files;
mod five_axis;
mod grbl;
mod grid;
mod grid_file;
mod isg_existing;
mod isg_volumetric;
mod lattice;
mod linear;
mod linuxcnc_five_axis;
mod motion_tables;
mod printer_skew;
mod siemens_kinematics;
