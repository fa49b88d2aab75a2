//! Tables and parameters for controls, each against an emulator of the control that shares no code with the exporter.
//!
//! One law for all ([`law`]): the exported files go into the emulator, the commands of its motors go to the virtual machine with the
//! errors of the calibration, and its tool is where the exporter's own prediction says. With the sign turned the law fails.

mod active;
mod endless;
mod fanuc;
mod fanuc_five_axis;
mod five_axes;
mod grbl;
mod grid;
mod heidenhain;
mod heidenhain_kinematics;
mod isg;
mod isg_volumetric;
pub(crate) mod law;
pub(crate) mod linuxcnc_five_axis;
mod linuxcnc_kinematics;
mod linuxcnc_screw;
mod pages;
mod printer_skew;
mod random;
mod siemens;
mod siemens_kinematics;
pub(crate) mod temperature;
mod three_axes;
