//! The vocabulary: covariances, indices, roles and rotations.

mod covariance;
mod indices;
mod roles;
mod rotation;
