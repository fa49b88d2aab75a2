//! The kinematics component of LinuxCNC without LinuxCNC: its C code, compiled as a plain program, behind the interface that the control
//! calls (`kinematicsInverse`, `kinematicsForward` of LinuxCNC's kinematics.h).

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::Mutex;

use abbe_core::ExportedFile;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::law::{ByAxis, Control, Machine, exporter, holds, seeds};
use super::random;
use crate::compensation::calibration;
use crate::support::{skipped, temporary, write};

/// What LinuxCNC gives to a component.
const HEADER: &str = "\
#include <math.h>
#include <stdio.h>
#include <string.h>
typedef struct { double x, y, z; } PmCartesian;
typedef struct EmcPose { PmCartesian tran; double a, b, c, u, v, w; } EmcPose;
typedef unsigned long KINEMATICS_FORWARD_FLAGS;
typedef unsigned long KINEMATICS_INVERSE_FLAGS;
typedef enum { KINEMATICS_IDENTITY = 1, KINEMATICS_FORWARD_ONLY, KINEMATICS_INVERSE_ONLY, KINEMATICS_BOTH } KINEMATICS_TYPE;
#define EXPORT_SYMBOL(x) struct abbe_unused
#define KINS_NOT_SWITCHABLE
";

/// Reads `i` (inverse) or `f` (forward) and nine numbers; answers with nine numbers.
const PROGRAM: &str = "
int main(void)
{
    char what;
    double n[9];
    while (scanf(\" %c %lf %lf %lf %lf %lf %lf %lf %lf %lf\", &what, n, n + 1, n + 2, n + 3, n + 4, n + 5, n + 6, n + 7, n + 8) == 10) {
        EmcPose world = {{n[0], n[1], n[2]}, n[3], n[4], n[5], n[6], n[7], n[8]};
        double joint[9];
        int i, failed;
        memcpy(joint, n, sizeof joint);
        failed = what == 'i' ? kinematicsInverse(&world, joint, 0, 0) : kinematicsForward(n, &world, 0, 0);
        if (what == 'f') {
            double found[9] = {world.tran.x, world.tran.y, world.tran.z, world.a, world.b, world.c, world.u, world.v, world.w};
            memcpy(joint, found, sizeof joint);
        }
        for (i = 0; i < 9; i++)
            printf(\"%.17g \", failed ? NAN : joint[i]);
        printf(\"\\n\");
        fflush(stdout);
    }
    return 0;
}
";

const LETTERS: [&str; 9] = ["X", "Y", "Z", "A", "B", "C", "U", "V", "W"];

/// The component in a process of its own, and the compensation files of its joints.
struct Component {
    pipes: Mutex<(ChildStdin, BufReader<ChildStdout>)>,
    child: Child,
    letters: Vec<&'static str>,
    reversals: BTreeMap<&'static str, Vec<[f64; 3]>>,
    _folder: TempDir,
}

impl Drop for Component {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Component {
    fn load(files: &[ExportedFile], machine: &Machine) -> Self {
        let text = |name: &str| {
            let file = files.iter().find(|file| file.name == name);
            file.map(|file| String::from_utf8(file.content.clone()).expect("text"))
        };
        let folder = temporary();
        let at = |name: &str| folder.path().join(name);
        let component = text("abbekins.comp").expect("a component");
        let (_, code) = component.split_once("\n;;\n").expect("halcompile wants ;; between declarations and code");
        for name in ["kinematics.h", "rtapi_math.h"] {
            write(&at(name), "");
        }
        write(&at("component.c"), &format!("{HEADER}{code}{PROGRAM}"));
        let warnings = ["-O2", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function"];
        let compiled = Command::new("cc")
            .args(warnings)
            .args(["-I", ".", "component.c", "-o", "component", "-lm"])
            .current_dir(folder.path())
            .output();
        let compiled = compiled.expect("cc starts");
        assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
        let mut program = Command::new(at("component"));
        let mut child = program.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("it starts");
        let pipes = (child.stdin.take().expect("input"), BufReader::new(child.stdout.take().expect("output")));
        let axes = &machine.model.info().axes;
        let letters = LETTERS.into_iter().filter(|letter| axes.iter().any(|axis| axis.name == *letter)).collect();
        let rows = |text: String| {
            let row = |line: &str| {
                let cells: Vec<f64> = line.split_whitespace().map(|cell| cell.parse().expect("a number")).collect();
                <[f64; 3]>::try_from(cells).expect("three numbers")
            };
            text.lines().map(row).collect::<Vec<_>>()
        };
        let reversals = LETTERS
            .into_iter()
            .filter_map(|letter| Some((letter, rows(text(&format!("abbekins-{}.txt", letter.to_lowercase()))?))));
        Self { pipes: Mutex::new(pipes), child, letters, reversals: reversals.collect(), _folder: folder }
    }

    fn ask(&self, what: &str, numbers: &[f64; 9]) -> [f64; 9] {
        let mut pipes = self.pipes.lock().expect("no thread failed");
        let line: Vec<String> = numbers.iter().map(|number| format!("{number:.17e}")).collect();
        writeln!(pipes.0, "{what} {}", line.join(" ")).expect("it reads");
        let mut answer = String::new();
        pipes.1.read_line(&mut answer).expect("it answers");
        let cells: Vec<f64> = answer.split_whitespace().map(|cell| cell.parse().expect("a number")).collect();
        cells.try_into().expect("nine numbers")
    }

    fn inverse(&self, commands: &ByAxis) -> ByAxis {
        let world = LETTERS.map(|letter| commands.get(letter).copied().unwrap_or_default());
        let joints = self.ask("i", &world);
        self.letters.iter().zip(joints).map(|(letter, joint)| ((*letter).to_owned(), joint)).collect()
    }

    fn forward(&self, joints: &ByAxis) -> ByAxis {
        let mut numbers = [0.0; 9];
        self.letters.iter().zip(&mut numbers).for_each(|(letter, number)| *number = joints[*letter]);
        let world = self.ask("f", &numbers);
        let found = LETTERS.into_iter().zip(world).filter(|(letter, _)| self.letters.contains(letter));
        found.map(|(letter, at)| (letter.to_owned(), at)).collect()
    }
}

impl Control for Component {
    fn motors(&self, commands: &ByAxis, directions: &ByAxis) -> ByAxis {
        let mut joints = self.inverse(commands);
        for (letter, rows) in &self.reversals {
            let joint = joints.get_mut(*letter).expect("a joint");
            let column = if directions[*letter] > 0.0 { 1 } else { 2 };
            let after = rows.iter().position(|row| row[0] > *joint);
            *joint += match after {
                Some(0) => rows[0][column],
                None => rows[rows.len() - 1][column],
                Some(index) => {
                    let (a, b) = (rows[index - 1], rows[index]);
                    a[column] + (*joint - a[0]) / (b[0] - a[0]) * (b[column] - a[column])
                }
            };
        }
        joints
    }
}

fn no_compiler(test: &str) -> bool {
    let missing = Command::new("cc").arg("--version").output().is_err();
    if missing {
        skipped(test, "there is no C compiler `cc`");
    }
    missing
}

fn settings(form: &str, correct: &str) -> Value {
    json!({ "form": form, "step_mm": 150, "step_deg": 90, "correction": { "correct": correct, "largest_rotary_correction_mrad": 1 },
        "ranges": { "C": { "from_deg": -180, "to_deg": 180 } } })
}

#[test]
fn the_model_in_c_gives_the_exact_set_points() {
    if no_compiler("linuxcnc_kinematics") {
        return;
    }
    for (name, correct) in [
        ("table-table", "position"),
        ("table-table", "five-axes"),
        ("head-table", "position"),
        ("head-table", "five-axes"),
        ("three-axis", "position"),
    ] {
        let machine = Machine::public(name);
        let mut settings = settings("model", correct);
        settings.as_object_mut().expect("settings").remove("ranges");
        let export = exporter("linuxcnc-kinematics", &settings);
        let load = |files: &[ExportedFile]| Box::new(Component::load(files, &machine)) as Box<dyn Control>;
        for seed in 1..=5 {
            let statuses = machine.anywhere(60, &[], seed);
            let found = holds(&machine, export.as_ref(), &load, &statuses, 1e-9);
            // What is left is reversal along other axes' effects, of second order.
            assert!(found.after < 1e-4 && found.before > 0.03, "{name} {correct}: {found:?}");
        }
    }
}

/// Machines that no one has seen, with all kinds of error motions; the tool points where it should, too.
#[test]
fn the_model_in_c_is_that_of_random_machines() {
    if no_compiler("linuxcnc_kinematics_random") {
        return;
    }
    for seed in seeds(12) {
        let errors = [random::Errors::Smooth, random::Errors::Any][seed as usize % 2];
        let machine = random::machine(seed, errors);
        let rotary = machine.model.info().axes.len() - 3;
        let correct = if rotary == 2 && seed % 3 != 0 { "five-axes" } else { "position" };
        let mut settings = settings("model", correct);
        settings.as_object_mut().expect("settings").remove("ranges");
        let export = exporter("linuxcnc-kinematics", &settings);
        let load = |files: &[ExportedFile]| Box::new(Component::load(files, &machine)) as Box<dyn Control>;
        // Near a pole the passes of both leave other parts of the angle.
        let left = holds(&machine, export.as_ref(), &load, &machine.anywhere(60, &[], seed + 1), 1e-7);
        assert!(left.from_predicted < 1e-9, "seed {seed}: {left:?}");
    }
}

#[test]
fn the_table_in_c_interpolates_as_predicted() {
    if no_compiler("linuxcnc_kinematics_table") {
        return;
    }
    for (name, correct, still) in [("table-table", "position", "C"), ("three-axis", "position", "")] {
        let machine = Machine::public(name);
        let mut settings = settings("table", correct);
        let ranges = settings["ranges"].as_object_mut().expect("ranges");
        if name == "three-axis" {
            ranges.clear();
        }
        let export = exporter("linuxcnc-kinematics", &settings);
        let load = |files: &[ExportedFile]| Box::new(Component::load(files, &machine)) as Box<dyn Control>;
        for seed in 1..=3 {
            let statuses = machine.anywhere(60, &[still], seed);
            holds(&machine, export.as_ref(), &load, &statuses, 1e-7);
        }
    }
}

#[test]
fn forward_kinematics_is_the_inverse_of_the_inverse() {
    if no_compiler("linuxcnc_kinematics_forward") {
        return;
    }
    for (name, form) in [("table-table", "model"), ("head-table", "model"), ("three-axis", "table")] {
        let machine = Machine::public(name);
        let mut settings = settings(form, "position");
        settings.as_object_mut().expect("settings").remove("ranges");
        let files = exporter("linuxcnc-kinematics", &settings)
            .export(&machine.calibration, machine.model.as_ref())
            .unwrap_or_else(|error| panic!("{error}"));
        let component = Component::load(&files, &machine);
        let (mut furthest, info) = (0.0_f64, machine.model.info());
        for status in machine.anywhere(200, &[], 7).chunks(info.status.len()) {
            let value = |axis: &abbe_core::Axis| match axis.kind {
                abbe_core::AxisKind::Rotary => status[axis.status].to_degrees(),
                abbe_core::AxisKind::Linear => status[axis.status],
            };
            let commands: ByAxis = info.axes.iter().map(|axis| (axis.name.clone(), value(axis))).collect();
            let joints = component.inverse(&commands);
            let found = component.forward(&joints);
            for (letter, command) in &commands {
                furthest = furthest.max((joints[letter] - command).abs());
                assert!((found[letter] - command).abs() < 1e-9, "{name} {letter}: {} {command}", found[letter]);
            }
        }
        assert!(furthest > 0.01, "{name}: nothing was corrected");
    }
}

#[test]
fn what_the_control_cannot_know_is_refused() {
    let refusal = |calibration: &Value, form: &str| {
        let machine = Machine::of(calibration);
        let mut settings = settings(form, "position");
        settings.as_object_mut().expect("settings").remove("ranges");
        settings["step_deg"] = json!(360);
        let found = exporter("linuxcnc-kinematics", &settings).export(&machine.calibration, machine.model.as_ref());
        found.err().map(|error| format!("{error} {}", error.help.as_deref().unwrap_or_default())).unwrap_or_default()
    };
    // A reversal is not taken to be the same everywhere where nobody says where the axis ends.
    let mut endless = calibration("table-table");
    endless["model"]["settings"]["axes"]["C"].as_object_mut().expect("settings").remove("range_deg");
    let text = refusal(&endless, "model");
    assert!(text.contains("the range of axis C is not known") && text.contains("range_deg"), "{text}");
    // Temperatures.
    let mut warm = calibration("three-axis");
    let expansion = json!({ "expansion": ["EXX"], "temperature": "T_X", "coefficient_per_K": 11.5e-6 });
    warm["model"]["settings"]["errors"].as_array_mut().expect("errors").push(expansion);
    warm["parameters"].as_array_mut().expect("parameters").push(json!({
        "name": "EXX[expansion]", "value": 11.5e-6, "unit": "1/K", "standard_uncertainty": 0, "status": "fixed"
    }));
    for form in ["table", "model"] {
        let text = refusal(&warm, form);
        assert!(!text.is_empty(), "{form}: errors with a temperature are taken");
        assert!(form == "model" || text.contains("`T_X`, which the control does not know"), "{text}");
    }
    for form in ["table", "model"] {
        assert_eq!(refusal(&calibration("three-axis"), form), "");
    }
}
