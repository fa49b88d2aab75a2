//! Proves the model that the plugin builds: its parameters act as the conventions name them, its derivatives are those
//! of its poses, and as many of its parameters can be identified as the kinematics of such machines allow.

mod bodies;
mod counting;
mod derivatives;
mod drift;
mod fit;
#[path = "../../../../crates/abbe-kinematics/tests/chains/oracle.rs"]
#[allow(dead_code)]
mod oracle;
mod subject;
mod values;
