//! Benchmarks only; see `benches/pipelines.rs`. `cargo xtask bench` runs them and compares with `baseline.json`.
