//! Acceptance tests of machine tools and coordinate measuring machines as standards evaluate them: validators over the
//! data that Abbe reads. The figures are those of `abbe-standards`.

mod both_directions;
mod channel_units;
mod circle_positions;
mod circular;
mod cmm_lengths;
mod cmm_probing;
mod common;
mod copied_run;
mod diagonals;
mod displaced;
mod positioning;
mod reading_units;
mod rotary_interpolation;
mod rotary_readings;
mod row_directions;
mod sign_change;
mod targets;
