//! Exporters of tables along axes: pitch and cross compensation of controls.

mod existing;
mod fanuc;
mod fanuc_file;
mod fanuc_points;
mod heidenhain;
mod heidenhain_file;
mod heidenhain_kinematics;
mod heidenhain_sequence;
mod isg;
mod isg_file;
mod isg_temperature;
mod siemens;
mod siemens_file;
mod siemens_temperature;
mod tables;
mod temperature_table;
