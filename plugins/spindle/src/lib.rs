//! Plugins of spindle checks: displacement sensors at an artefact that turns with the spindle, read against its encoder.
//!
//! `estimate: spindle-motion` fits harmonics to every run, `estimate: donaldson-reversal` tells the form of the artefact from the
//! motion of the spindle, `estimate: spindle-warm-up` fits the drift to temperatures, `validate: spindle` makes figures of them in
//! the manner of ISO 230-7.

mod bins;
mod doubts;
mod encoder;
mod evaluated;
mod harmonics;
mod motion;
mod parameters;
mod readings;
mod rests;
mod reversal;
mod run;
mod sensors;
mod speed;
mod stretches;
mod validate;
mod warm_up;

#[cfg(test)]
mod tests;
