//! Components of LinuxCNC: C code that corrects the errors of a calibration inside the control.

mod code;
mod joints;
mod kinematics;
mod reversal;
mod table;
mod temperature;
