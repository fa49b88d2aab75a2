//! Acceptance tests as standards evaluate them: validators over the data that Abbe reads. The figures are those of `abbe-standards`.

mod positioning;
mod targets;
