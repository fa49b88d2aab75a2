//! Abbe as a whole: every recipe as a snapshot, the command line driven as a user drives it, and what must be true of
//! the results whatever the code looks like inside.

mod ball_bar;
mod coverage;
mod errors;
mod files;
mod first_order;
mod interrupted;
mod laws;
mod methods;
mod plugins;
mod recipes;
mod simulate;
mod sphere;
mod support;
mod truth;
mod uncertainty;
