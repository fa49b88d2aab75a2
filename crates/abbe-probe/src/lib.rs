//! The effective stylus radius of a touching probe, by the direction of contact and the feed.
//!
//! `r = r_stylus + r0 - delay feed + sum of c Re((nx + i ny)^M) nz^J + sum of s Im((nx + i ny)^M) nz^J`, with the outward unit normal
//! n of the touched surface seen from the probe, that is in the frame of the tool (Rahman 2016, sections 2.3.4 and 7.3: triggering
//! radius and delay). The terms span the spherical harmonics and are smooth at the pole. The normal is turned into the frame of the
//! tool by the orientation of the model with all its errors.
//!
//! [`EffectiveRadius`] serves all artefacts that are touched; [`value`] alone describes the form of spheres, too.

mod radius;
mod term;

pub use radius::{ContactRadius, EffectiveRadius, LARGEST_FEED, check_columns, deviation, has_delay, has_terms};
pub use term::{name, parameter, polynomial, read, value};
