//! Kubernetes: the file of the example against the schemas that it publishes. There is no cluster; the command of a pod is run by `sh`.

use std::io::Write as _;
use std::os::unix::fs::symlink;
use std::process::{Command, Stdio};

use serde_json::Value;

use super::{ABBE, example, packages, python_has};
use crate::fleet::plant::{Plant, bounded, ok, quiet};
use crate::fleet::{merged, same};
use crate::support::{read, skipped, temporary};

/// Prints what is wrong with the file on standard input, a line for each version of Kubernetes that knows retries of an index without
/// being asked to. A field that the schema does not know is wrong.
const CHECK: &str = r#"
import sys, yaml
from kubernetes_validate import ValidationError, utils
from packaging.version import Version
job = yaml.safe_load(sys.stdin)
for version in dict.fromkeys(utils.all_versions()):
    if Version(version) >= Version("1.29"):
        try:
            utils.validate(job, version, strict=True)
            print(version)
        except ValidationError as wrong:
            print(version, ".".join(map(str, wrong.path)) + ":", wrong.message)
"#;

/// What versions of Kubernetes say of a file; empty if a version takes it.
fn said(text: &str) -> Vec<String> {
    let mut python = Command::new("python3");
    python.args(["-c", CHECK]).env("PYTHONPATH", packages()).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut python = python.spawn().expect("Python starts");
    python.stdin.take().expect("a pipe").write_all(text.as_bytes()).expect("it reads");
    let output = python.wait_with_output().expect("its output");
    assert!(output.status.success(), "the file cannot be checked");
    let lines = String::from_utf8_lossy(&output.stdout).into_owned();
    lines.lines().map(|line| line.split_once(' ').map_or("", |(_, wrong)| wrong).to_owned()).collect()
}

#[test]
fn the_job_is_one_that_kubernetes_takes() {
    if !python_has("kubernetes_validate") {
        let why = "the Python package kubernetes-validate is not installed";
        return skipped("the_job_is_one_that_kubernetes_takes", why);
    }
    let text = read(&example("kubernetes_fleet.yaml"));
    let found = said(&text);
    assert!(found.len() > 5 && found.iter().all(String::is_empty), "{found:#?}");
    for (right, wrong, place) in [
        ("completionMode:", "completionmode:", "spec:"),
        ("completions: 100", "completions: \"100\"", "spec.completions:"),
        ("backoffLimitPerIndex: 3", "backoffLimitPerIndex: few", "spec.backoffLimitPerIndex:"),
        ("operator: In, ", "", "spec.podFailurePolicy.rules.0.onExitCodes:"),
        ("volumeMounts:", "volumeMount:", "spec.template.spec.containers.0:"),
        ("claimName: fleet", "claim: fleet", "spec.template.spec.volumes.0.persistentVolumeClaim:"),
        ("  template:", "  templates:", "spec:"),
    ] {
        assert_eq!(text.matches(right).count(), 1, "{right}");
        let found = said(&text.replace(right, wrong));
        assert!(found.len() > 5 && found.iter().all(|wrong| wrong.starts_with(place)), "{wrong}: {found:#?}");
    }
}

/// The pods of the job, one after the other and the last one first, do all jobs of the fleet.
#[test]
fn what_a_pod_runs_is_its_batch() {
    let plant = Plant { weeks: vec![1, 2], ..Plant::of(5) };
    let (one, other) = (temporary(), temporary());
    for folder in [&one, &other] {
        plant.write(folder.path());
        ok(&quiet(folder.path(), &["fleet", "plan", "fleet.yaml"]));
    }
    ok(&quiet(one.path(), &["fleet", "run", "fleet.manifest.jsonl", "--workers", "1"]));
    // Three batches of four in the place of 100 batches of 100.
    let text = read(&example("kubernetes_fleet.yaml")).replace("completions: 100", "completions: 3");
    let text =
        text.replace("* 100", "* 4").replace("--count 100", "--count 4").replace("plant.manifest", "fleet.manifest");
    let job: Value = serde_yaml::from_str(&text).expect("YAML");
    let container = &job["spec"]["template"]["spec"]["containers"][0];
    let words = |key: &str| -> Vec<String> {
        let words = container[key].as_array().expect("a list").iter();
        words.map(|word| word.as_str().expect("a text").to_owned()).collect()
    };
    let (command, arguments) = (words("command"), words("args"));
    let programs = temporary();
    symlink(ABBE, programs.path().join("abbe")).expect("a link");
    let path = format!("{}:{}", programs.path().display(), std::env::var("PATH").expect("a path"));
    for index in (0..job["spec"]["completions"].as_u64().expect("a number")).rev() {
        let mut pod = Command::new(&command[0]);
        pod.args(&command[1..]).args(&arguments).current_dir(other.path()).env("PATH", &path);
        pod.env("JOB_COMPLETION_INDEX", index.to_string());
        pod.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        ok(&bounded(pod.spawn().expect("a shell"), std::time::Duration::from_secs(600)));
    }
    let status = quiet(other.path(), &["fleet", "status", "fleet.manifest.jsonl"]);
    assert_eq!(status.stdout, format!("{} done, 0 failed, 0 open\n", plant.jobs()));
    same(&merged(other.path()), &merged(one.path()), "pods");
}
