//! Abbe as a whole: every recipe as a snapshot, the command line driven as a user drives it, and what must be true of
//! the results whatever the code looks like inside.

mod ball_bar;
mod bounds;
mod calibrations;
mod cmm;
mod compensation;
mod controls;
mod coverage;
mod decisions;
mod errors;
mod files;
mod first_order;
mod frozen;
mod gcode;
mod interrupted;
mod laws;
mod libraries;
mod methods;
mod mill;
mod multi_feature_bar;
mod nobodys_files;
mod nonsense;
mod outside;
mod planning;
mod plugins;
mod poses;
mod rapid_verify;
mod recipes;
mod selection;
mod simulate;
mod sphere;
mod support;
mod truth;
mod uncertainty;
mod variance;
mod verdicts;
