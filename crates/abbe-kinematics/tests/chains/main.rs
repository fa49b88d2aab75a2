//! Proves `Chain` against an independent implementation of the conventions, its derivatives against differences, its
//! first-order form against the exact one, and that predictions do not depend on where the machine origin is.

mod derivatives;
mod exact;
mod first_order;
// The tests of `serial-chain` use it too, and other parts of it.
#[allow(dead_code)]
mod oracle;
mod origin;
mod subject;
