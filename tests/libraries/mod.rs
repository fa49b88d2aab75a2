//! Dynamic plugins: the same results as built in, from Rust and from C, isolated or not; and libraries that misbehave.

mod attacks;
mod conformance;
mod examples;
mod header;
mod json;
mod messages;
mod misbehaving;
mod same_results;
mod vendor;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

use abbe_plugin::Limits;
use serde_json::{Value, json};

use crate::support::{root, write};

/// The folder that the program was built into.
fn target() -> PathBuf {
    let program = Path::new(env!("CARGO_BIN_EXE_abbe-under-test"));
    program.ancestors().nth(2).expect("the program is in <target>/<profile>").to_owned()
}

/// A library of the workspace, built as it stands beside the program.
fn cargo_library(package: &str) -> PathBuf {
    static BUILT: OnceLock<()> = OnceLock::new();
    BUILT.get_or_init(|| {
        let mut command = Command::new(env!("CARGO"));
        command.args(["build", "--locked", "--quiet", "--target-dir"]).arg(target());
        // All that `cargo test --workspace` selects (`--examples` adds what only tests depend on), with the same features: else
        // shared crates would be built a second time.
        command.args(["--workspace", "--lib", "--examples"]);
        for (is_on, feature) in [(cfg!(feature = "postgres"), "postgres"), (cfg!(feature = "parquet"), "parquet")] {
            command.args(is_on.then_some(["--features", &format!("abbe-tests/{feature}")]).into_iter().flatten());
        }
        let built = command.current_dir(root()).output().expect("cargo runs");
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    });
    let name = package.replace('-', "_");
    target().join("debug").join(format!("{}{name}{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX))
}

/// A library of plain C.
pub fn c_library(folder: &Path, source: &str, name: &str, options: &[&str]) -> PathBuf {
    let file = folder.join(format!("lib{name}.so"));
    let mut command = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
    command.args(["-std=gnu11", "-Wall", "-Wextra", "-Werror", "-O2", "-shared", "-fPIC", "-I"]);
    command.arg(root().join("crates/abbe-plugin/include")).args(options).arg(root().join(source)).arg("-o").arg(&file);
    let built = command.args(["-lm", "-pthread"]).output().expect("the C compiler runs");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    file
}

fn bad(folder: &Path, name: &str, options: &[&str]) -> PathBuf {
    c_library(folder, "tests/bad-plugins/bad.c", name, options)
}

fn limits(silence: f64) -> Limits {
    Limits {
        program: env!("CARGO_BIN_EXE_abbe-under-test").into(),
        arguments: ["plugin", "serve"].map(str::to_owned).to_vec(),
        answer_timeout: Duration::from_secs_f64(silence),
        total_time: Duration::from_secs(600),
        memory_limit_mib: abbe_plugin::MEMORY_LIMIT_MIB,
    }
}

/// Lengths all over a workspace, of a machine with some errors and some noise.
fn lengths(folder: &Path) {
    let mut text = "length,X1_mm,Y1_mm,Z1_mm,X2_mm,Y2_mm,Z2_mm,reference_mm\n".to_owned();
    let steps = [2.0_f64, 3.0, 5.0, 7.0, 11.0, 13.0].map(f64::sqrt);
    let spread = |row: usize, column: usize| 600.0 * (((row + 1) as f64 * steps[column]).fract() - 0.5);
    for row in 0..40 {
        let ends: Vec<f64> = (0..6).map(|column| spread(row, column)).collect();
        let moved = |at: &[f64]| {
            let (x, y, z) = (at[0] * (1.0 + 3e-5), at[1] * (1.0 - 2e-5), at[2] * (1.0 + 1e-5));
            [x - 4e-5 * y + 2e-5 * z, y + 5e-5 * z, z]
        };
        let (one, other) = (moved(&ends[..3]), moved(&ends[3..]));
        let length: f64 = one.iter().zip(&other).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        let noise = 1e-3 * ((row * 7 % 11) as f64 - 5.0) / 3.0;
        let cells: Vec<String> = ends.iter().map(f64::to_string).collect();
        text.push_str(&format!("{row},{},{}\n", cells.join(","), length + noise));
    }
    write(&folder.join("lengths.csv"), &text);
}

/// A recipe of lengths on a machine with three axes.
fn three_axes(model: Value) -> Value {
    json!({ "abbe": 1, "stages": {
        "runs": { "ingest": "csv", "path": "lengths.csv" },
        "bar": { "artefact": "length", "from": "runs", "standard_uncertainty_um": 1.0 },
        "machine": model,
        "fit": { "estimate": "gauss-newton", "machine": "machine", "observations": ["bar"],
                 "parameters": ["E*[1]", "EC0Y", "EA0Z", "EB0Z"] },
    } })
}
