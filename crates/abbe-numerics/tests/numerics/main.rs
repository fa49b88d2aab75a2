//! Proves the accumulated factorisation, rank, null space and covariance against closed forms and definitions, the
//! iteration and its robust weights on problems with known answers, and coefficients against NIST's certified ones.

mod accumulate;
mod arrow;
mod coverage;
mod design;
mod linear;
mod monte_carlo;
mod nist;
mod nist_nonlinear;
mod problems;
mod regression;
mod robust;
mod solve;
mod spectrum;
