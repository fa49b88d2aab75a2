//! The files for LinuxCNC on LinuxCNC itself, in simulation without a display: programs run, and what the joints do in every servo cycle
//! is what the exporters predict.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use abbe_core::{AxisKind, ExportedFile, StatusRole};
use serde_json::json;

use crate::compensation::calibration;
use crate::controls::law::{ByAxis, Machine, exporter};
use crate::controls::linuxcnc_five_axis::{Linuxcnc, random_of_2_9};
use crate::controls::temperature::warming;
use crate::support::{read, root, skipped, temporary, write};

/// The user that runs the control: it refuses root.
pub(super) const USER: &str = "abbe-linuxcnc";

/// Longest run of the control; a run takes 10 to 20 s.
const LONGEST: Duration = Duration::from_secs(300);

/// `halsampler` writes six decimals; positions are multiplied by this before.
const FINER: f64 = 1e6;

/// There is one control on a computer.
pub(super) static ALONE: Mutex<()> = Mutex::new(());

pub(super) fn answers(program: &str, arguments: &[&str]) -> bool {
    Command::new(program).args(arguments).output().is_ok_and(|output| output.status.success())
}

/// Why the control cannot be run here.
pub(super) fn missing() -> Option<String> {
    if !answers("sh", &["-c", "command -v linuxcnc && command -v halcompile && command -v halsampler"]) {
        return Some("there is no LinuxCNC (Debian: apt-get install linuxcnc-uspace linuxcnc-uspace-dev)".to_owned());
    }
    if !answers("sh", &["-c", "test \"$(id -u)\" = 0"]) {
        return Some("only root can install a component and start the control as another user".to_owned());
    }
    (!answers("id", &[USER])).then(|| format!("there is no user `{USER}` (cargo xtask linuxcnc --create-user)"))
}

/// A component that is installed for the time of a test.
pub(super) struct Installed(String);

impl Installed {
    pub(super) fn new(folder: &Path, name: &str) -> Self {
        let file = format!("{name}.comp");
        let output =
            Command::new("halcompile").args(["--install", &file]).current_dir(folder).output().expect("it starts");
        assert!(output.status.success(), "halcompile: {}", String::from_utf8_lossy(&output.stderr));
        Self(name.to_owned())
    }
}

impl Drop for Installed {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(format!("/usr/lib/linuxcnc/modules/{}.so", self.0));
    }
}

/// Letters of the joints, in the order of LinuxCNC.
fn letters(machine: &Machine) -> Vec<String> {
    let names = ["X", "Y", "Z", "A", "B", "C"].into_iter().map(str::to_owned);
    names.filter(|name| machine.model.info().axes.iter().any(|axis| axis.name == *name)).collect()
}

/// `MAX_ACCELERATION` of joints, mm/s^2 and deg/s^2.
const ACCELERATION: f64 = 500.0;

/// Where a joint stands at first: far from the pole of the rotary axes. LinuxCNC takes its motor to be at zero there.
fn home(letter: &str) -> f64 {
    if ["A", "B"].contains(&letter) { 20.0 } else { 0.0 }
}

/// What joints can do, mm/s and mm/s^2 or degrees, and where they stand at first.
pub(super) struct Joints {
    pub(super) velocity: f64,
    pub(super) acceleration: f64,
    pub(super) home: fn(&str) -> f64,
}

pub(super) fn ini(
    letters: &[String],
    joints: &Joints,
    kinematics: &str,
    compensated: &BTreeMap<String, (String, u8)>,
) -> String {
    let mut text = format!(
        "[EMC]\nVERSION = 1.1\nMACHINE = abbe\n[DISPLAY]\nDISPLAY = ./ui.py\n[TASK]\nTASK = milltask\nCYCLE_TIME = 0.001\n[RS274NGC]\n\
         PARAMETER_FILE = abbe.var\n[EMCMOT]\nEMCMOT = motmod\nCOMM_TIMEOUT = 4.0\nSERVO_PERIOD = 1000000\n[EMCIO]\nEMCIO = io\n\
         CYCLE_TIME = 0.1\nTOOL_TABLE = abbe.tbl\n[HAL]\nHALFILE = abbe.hal\n[TRAJ]\nCOORDINATES = {}\nLINEAR_UNITS = mm\n\
         ANGULAR_UNITS = degree\nDEFAULT_LINEAR_VELOCITY = 100\nMAX_LINEAR_VELOCITY = 2000\nMAX_ANGULAR_VELOCITY = 2000\n\
         NO_FORCE_HOMING = 1\n[KINS]\nKINEMATICS = {kinematics}\nJOINTS = {}\n",
        letters.join(" "),
        letters.len()
    );
    for (joint, letter) in letters.iter().enumerate() {
        let kind = if ["A", "B", "C"].contains(&letter.as_str()) { "ANGULAR" } else { "LINEAR" };
        let limits = format!("MIN_LIMIT = -1000\nMAX_LIMIT = 1000\nMAX_VELOCITY = {}\n", joints.velocity);
        let limits = format!("{limits}MAX_ACCELERATION = {}\n", joints.acceleration);
        let home = (joints.home)(letter);
        let _ = write!(
            text,
            "[AXIS_{letter}]\n{limits}[JOINT_{joint}]\nTYPE = {kind}\n{limits}HOME = {home}\nHOME_OFFSET = {home}\nHOME_SEQUENCE = 0\nFERROR = 10\nMIN_FERROR = 10\n"
        );
        if let Some((file, kind)) = compensated.get(letter) {
            let _ = write!(text, "COMP_FILE = {file}\nCOMP_FILE_TYPE = {kind}\n");
        }
    }
    text
}

/// Pins of a joint in a servo cycle.
const PINS: usize = 4;

/// The pins of every joint, finer, and whether axes are commanded, into the sampler of one servo cycle.
fn hal(letters: &[String]) -> String {
    let pins = PINS * letters.len();
    let mut text = format!(
        "loadrt [KINS]KINEMATICS\nloadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS\n\
         loadrt scale count={pins}\nloadrt sampler depth=100000 cfg={}b\naddf motion-command-handler servo-thread\n\
         addf motion-controller servo-thread\nnet estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in\n\
         net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared\n\
         net change iocontrol.0.tool-change => iocontrol.0.tool-changed\n\
         net coordinated motion.coord-mode => sampler.0.pin.{pins}\n",
        "f".repeat(pins)
    );
    for (joint, letter) in letters.iter().enumerate() {
        let axis = format!("axis.{}.pos-cmd", letter.to_lowercase());
        let _ = writeln!(text, "net motor{joint} joint.{joint}.motor-pos-cmd => joint.{joint}.motor-pos-fb");
        let sources = [
            format!("axis{joint} {axis} =>"),
            format!("coarse{joint} joint.{joint}.coarse-pos-cmd =>"),
            format!("joint{joint} joint.{joint}.pos-cmd =>"),
            format!("motor{joint}"),
        ];
        for (kind, source) in sources.iter().enumerate() {
            let pin = PINS * joint + kind;
            let _ = write!(
                text,
                "net {source} scale.{pin}.in\nsetp scale.{pin}.gain {FINER}\nnet finer{pin} scale.{pin}.out => sampler.0.pin.{pin}\n\
                 addf scale.{pin} servo-thread\n"
            );
        }
    }
    text + "addf sampler.0 servo-thread\n"
}

/// One servo cycle, mm and degrees.
#[derive(Debug, Clone, PartialEq)]
struct Cycle {
    /// What the program asks for.
    axes: Vec<f64>,
    /// What the kinematics make of it.
    kinematics: Vec<f64>,
    /// What joints are given: three of the cycles before, smoothed by LinuxCNC.
    joints: Vec<f64>,
    /// What motors are given: joints with the trims of their compensation files.
    motors: Vec<f64>,
    /// Whether axes are commanded, not joints.
    is_coordinated: bool,
}

impl Cycle {
    fn of(line: &str, homes: &[f64]) -> Option<Self> {
        let count = homes.len();
        let cells: Vec<f64> = line.split_whitespace().map_while(|cell| cell.parse().ok()).collect();
        let of = |kind: usize| (0..count).map(|joint| cells[1 + PINS * joint + kind] / FINER).collect::<Vec<_>>();
        (cells.len() == PINS * count + 2).then(|| Self {
            axes: of(0),
            kinematics: of(1),
            joints: of(2),
            motors: of(3).iter().zip(homes).map(|(motor, home)| motor + home).collect(),
            is_coordinated: cells[PINS * count + 1] != 0.0,
        })
    }
}

/// A file that sets the pins of the kinematics, where a folder has it.
const PINS_OF_KINEMATICS: &str = "five-axis.hal";

/// Runs a program on the control.
fn run(
    folder: &Path,
    machine: &Machine,
    kinematics: &str,
    compensated: &BTreeMap<String, (String, u8)>,
    program: &str,
) -> Vec<Cycle> {
    let joints = Joints { velocity: 200.0, acceleration: ACCELERATION, home };
    let mut ini = ini(&letters(machine), &joints, kinematics, compensated);
    if folder.join(PINS_OF_KINEMATICS).exists() {
        ini = ini.replace("HALFILE = abbe.hal\n", &format!("HALFILE = abbe.hal\nHALFILE = {PINS_OF_KINEMATICS}\n"));
    }
    write(&folder.join("abbe.ini"), &ini);
    write(&folder.join("abbe.hal"), &hal(&letters(machine)));
    write(&folder.join("abbe.tbl"), "");
    write(&folder.join("program.ngc"), program);
    started(folder, LONGEST);
    assert!(folder.join("samples.txt").exists(), "no samples: {}", read(&folder.join("log.txt")));
    let samples = read(&folder.join("samples.txt"));
    let homes: Vec<f64> = letters(machine).iter().map(|letter| home(letter)).collect();
    let mut lines: Vec<&str> = samples.lines().collect();
    // The last line may have been cut off.
    lines.pop();
    let of = |line: &&str| Cycle::of(line, &homes).unwrap_or_else(|| panic!("a cycle of {homes:?}: {line}"));
    lines.iter().map(of).collect()
}

/// Starts the control in a folder with its files and waits for its end. What it says stands in `log.txt`.
pub(super) fn started(folder: &Path, longest: Duration) {
    if let Some(why) = failure(folder, longest) {
        panic!("{why}{}", read(&folder.join("log.txt")));
    }
}

/// The same; gives what the control stopped with, if it did.
pub(super) fn failure(folder: &Path, longest: Duration) -> Option<String> {
    write(&folder.join("ui.py"), &read(&root().join("xtask/linuxcnc/ui.py")));
    let at = folder.to_str().expect("a plain path");
    assert!(answers("chmod", &["755", &format!("{at}/ui.py")]) && answers("chown", &["-R", USER, at]));
    let log = std::fs::File::create(folder.join("log.txt")).expect("a file");
    let mut command = Command::new("timeout");
    let seconds = longest.as_secs().to_string();
    command.args(["--kill-after=10", &seconds, "runuser", "-u", USER, "--", "env"]);
    command.args([&format!("HOME={at}"), "linuxcnc", "-r", "abbe.ini"]).current_dir(folder);
    command.stdout(log.try_clone().expect("a file")).stderr(log);
    let clock = Instant::now();
    command.status().expect("it starts");
    let log = || read(&folder.join("log.txt"));
    assert!(clock.elapsed() < longest, "LinuxCNC did not end: {}", log());
    // A process that has ended and that nobody has asked for yet (Z) does nothing any more.
    let is_left = || answers("pgrep", &["--runstates", "D,R,S,T", "-u", USER]);
    let clock = Instant::now();
    while is_left() && clock.elapsed() < Duration::from_secs(10) {
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(!is_left(), "processes of the control are left");
    let failed = folder.join("failed.txt");
    failed.exists().then(|| read(&failed))
}

/// Statuses with these commands (mm, degrees) and directions of the joints.
fn statuses(machine: &Machine, rows: &[(&[f64], &[f64])]) -> Vec<f64> {
    let (info, letters) = (machine.model.info(), letters(machine));
    let one = |(commands, directions): &(&[f64], &[f64])| {
        let mut status = vec![0.0; info.status.len()];
        for ((letter, command), direction) in letters.iter().zip(*commands).zip(*directions) {
            let index = info.axes.iter().position(|axis| axis.name == *letter).expect("an axis");
            let is_rotary = info.axes[index].kind == AxisKind::Rotary;
            status[info.axes[index].status] = if is_rotary { command.to_radians() } else { *command };
            if let Some(column) = info.status_index(&StatusRole::Direction(index)) {
                status[column] = *direction;
            }
        }
        status
    };
    rows.iter().flat_map(one).collect()
}

/// The commands of statuses, mm and degrees, in the order of joints.
fn commands(machine: &Machine, statuses: &[f64]) -> Vec<Vec<f64>> {
    let (info, letters) = (machine.model.info(), letters(machine));
    let of = |status: &[f64]| {
        let one = |letter: &String| {
            let axis = info.axes.iter().find(|axis| axis.name == *letter).expect("an axis");
            if axis.kind == AxisKind::Rotary { status[axis.status].to_degrees() } else { status[axis.status] }
        };
        letters.iter().map(one).collect()
    };
    statuses.chunks(info.status.len()).map(of).collect()
}

fn put(folder: &Path, files: &[ExportedFile]) {
    files.iter().for_each(|file| std::fs::write(folder.join(&file.name), &file.content).expect("a file"));
}

fn largest<'a>(pairs: impl Iterator<Item = (&'a Vec<f64>, &'a Vec<f64>)>) -> f64 {
    pairs.flat_map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).abs())).fold(0.0, f64::max)
}

/// A joint stands still for so many cycles before it is taken to be at rest.
const LONG: usize = 200;

/// Cycles at rest for long, with the direction in which each joint moved last.
fn at_rest(cycles: &[Cycle]) -> Vec<(Cycle, Vec<f64>)> {
    let mut directions = vec![0.0; cycles[0].joints.len()];
    let (mut still, mut found) = (0, Vec::new());
    for pair in cycles.windows(2) {
        let moves = pair[0].joints.iter().zip(&pair[1].joints).map(|(before, after)| after - before);
        let mut is_still = true;
        for (direction, by) in directions.iter_mut().zip(moves).filter(|(_, by)| *by != 0.0) {
            (*direction, is_still) = (by.signum(), false);
        }
        still = if is_still { still + 1 } else { 0 };
        if still == LONG && directions.iter().all(|direction| *direction != 0.0) {
            found.push((pair[1].clone(), directions.clone()));
        }
    }
    found
}

/// Joints of cycles: LinuxCNC puts a spline through what kinematics gave in the cycles before (`cubic.c`), one cycle long.
fn smoothed(cycles: &[Cycle]) -> Vec<f64> {
    let at = |cycle: usize, joint: usize| cycles[cycle].kinematics[joint];
    (0..cycles[0].joints.len()).map(|joint| (at(0, joint) + 4.0 * at(1, joint) + at(2, joint)) / 6.0).collect()
}

const FIVE_AXES: &str = "G21 G90 G17 G61\nG0 X50 Y-40 Z30 A40 C15\nG4 P0.3\nG1 F6000 X-120 Y80 Z110 A15 C60\nG4 P0.3\n\
    G2 X-20 Y80 I50 J0\nG1 X-60 Y-70 Z40 A50 C-90\nG3 X-60 Y-70 I40 J10\nG4 P0.3\nG1 X10 Y10 Z10 A25 C5\nG4 P0.3\nM2\n";

const THREE_AXES: &str = "G21 G90 G17 G61\nG0 X50 Y-40 Z30\nG4 P0.3\nG1 F9000 X-120 Y80 Z110\nG4 P0.3\nG2 X-20 Y80 I50 J0\n\
    G1 X-60 Y-70 Z40\nG3 X-60 Y-70 I40 J10\nG4 P0.3\nG1 X10 Y10 Z10\nG4 P0.3\nM2\n";

/// A component on the control, against what its exporter predicts. `tolerance` is that of the tool at rest, mm.
fn component_holds(name: &str, form: &str, correct: &str, program: &str, tolerance: f64) {
    let machine = Machine::public(name);
    let folder = temporary();
    let component = format!("abbe_test_{form}");
    let mut settings = json!({ "component": component, "form": form, "step_mm": 100, "correction": { "correct": correct,
        "largest_rotary_correction_mrad": 1 } });
    if name != "three-axis" {
        settings["ranges"] = json!({ "C": { "from_deg": -180, "to_deg": 180 } });
    }
    let export = exporter("linuxcnc-kinematics", &settings);
    let files = export.export(&machine.calibration, machine.model.as_ref()).unwrap_or_else(|error| panic!("{error}"));
    put(folder.path(), &files);
    let own = |letter: &String| {
        let file = format!("{component}-{}.txt", letter.to_lowercase());
        files.iter().any(|other| other.name == file).then(|| (letter.clone(), (file, 1)))
    };
    let compensated: BTreeMap<_, _> = letters(&machine).iter().filter_map(own).collect();
    assert!(compensated.len() >= 3, "{compensated:?}");
    let installed = Installed::new(folder.path(), &component);
    let cycles = run(folder.path(), &machine, &component, &compensated, program);
    drop(installed);
    let from = cycles.iter().position(|cycle| cycle.is_coordinated).expect("a program");
    let cycles = &cycles[from..];
    assert!(cycles.len() > 3000, "{} cycles", cycles.len());
    let correction = export.correction(&machine.calibration, machine.model.as_ref()).expect("a prediction");
    let correction = correction.expect("a correction");
    let predicted = |rows: &[(&[f64], &[f64])]| -> Vec<Vec<f64>> {
        commands(&machine, &correction.commands(&statuses(&machine, rows)).expect("commands"))
    };
    // Kinematics in the same cycle: they know no directions. Then joints.
    let none = vec![0.0; cycles[0].axes.len()];
    let rows: Vec<(&[f64], &[f64])> = cycles.iter().map(|cycle| (&cycle.axes[..], &none[..])).collect();
    let expected = predicted(&rows);
    let in_cycle = largest(cycles.iter().map(|cycle| &cycle.kinematics).zip(&expected));
    let corrected = largest(cycles.iter().map(|cycle| (&cycle.kinematics, &cycle.axes)));
    let splines: Vec<Vec<f64>> = cycles.windows(3).map(smoothed).collect();
    let of_joints = largest(cycles[3..].iter().map(|cycle| &cycle.joints).zip(&splines));
    // Motors at rest: the compensation files too.
    let rest = at_rest(cycles);
    assert!(rest.len() >= 3, "{} times at rest", rest.len());
    let axes: Vec<(&[f64], &[f64])> = rest.iter().map(|(cycle, by)| (&cycle.axes[..], &by[..])).collect();
    let motors: Vec<(&[f64], &[f64])> = rest.iter().map(|(cycle, by)| (&cycle.motors[..], &by[..])).collect();
    let resting = largest(rest.iter().map(|(cycle, _)| &cycle.motors).zip(&predicted(&axes)));
    // The tool of the machine against the program: all the way in the servo cycle, and at rest.
    let kinematics: Vec<(&[f64], &[f64])> = cycles.iter().map(|cycle| (&cycle.kinematics[..], &none[..])).collect();
    let along =
        apart(&machine.tips(&statuses(&machine, &kinematics), true), &machine.tips(&statuses(&machine, &rows), false));
    let goals = machine.tips(&statuses(&machine, &axes), false);
    let off = apart(&machine.tips(&statuses(&machine, &motors), true), &goals);
    let before = apart(&machine.tips(&statuses(&machine, &axes), true), &goals);
    println!(
        "linuxcnc {name} {form} {correct}: {} cycles, corrections to {corrected:.4}, kinematics within {in_cycle:.1e}, joints within \
         {of_joints:.1e}, motors at {} rests within {resting:.1e}, tool at rest within {off:.1e} of {before:.1e} mm, without reversal \
         within {along:.1e} mm all the way",
        cycles.len(),
        rest.len()
    );
    assert!(in_cycle < 1e-6 && of_joints < 1e-6 && resting < 1e-6, "{name}: {in_cycle:e} {of_joints:e} {resting:e}");
    assert!(along < tolerance, "{name}: the tool is {along} mm off on its way");
    assert!(off < tolerance && before > 10.0 * tolerance, "{name}: the tool is {off} mm off, {before} mm before");
}

/// Largest distance of points.
fn apart(one: &[[f64; 3]], other: &[[f64; 3]]) -> f64 {
    let apart = |(a, b): (&[f64; 3], &[f64; 3])| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    one.iter().zip(other).map(apart).fold(0.0, f64::max)
}

#[test]
fn the_control_follows_the_kinematics_component() {
    if let Some(reason) = missing() {
        return skipped("linuxcnc", &reason);
    }
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    component_holds("table-table", "model", "position", FIVE_AXES, 1e-6);
    component_holds("table-table", "model", "five-axes", FIVE_AXES, 1e-6);
    let of_head = FIVE_AXES.replace('A', "B");
    component_holds("head-table", "model", "five-axes", &of_head, 1e-6);
    component_holds("three-axis", "table", "position", THREE_AXES, 1e-3);
}

/// The interpreter of LinuxCNC alone reads a program to its end.
fn is_read(program: &Path) -> bool {
    let output = Command::new("timeout").args(["20", "rs274", "-g"]).arg(program).output().expect("it starts");
    output.status.success() && String::from_utf8_lossy(&output.stdout).contains("PROGRAM_END")
}

/// Places of a program that random machines reach, for a tilting axis `A`.
const TILTING: &str = "G21 G90 G17 G61\nG0 X20 Y-15 Z10 A40 C15\nG4 P0.3\nG1 F6000 X-20 Y25 Z-10 A15 C60\nG4 P0.3\n\
    G2 X-10 Y25 I5 J0\nG1 X-10 Y-20 Z15 A50 C-90\nG4 P0.3\nG1 X5 Y10 Z10 A25 C5\nG4 P0.3\nM2\n";

/// The stock kinematics of tilting tables with the pins of the exporter, and its program that moves work offsets.
#[test]
fn the_control_takes_the_pins_of_its_five_axis_kinematics() {
    if let Some(reason) = missing() {
        return skipped("linuxcnc_five_axis", &reason);
    }
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    for seed in [1, 2] {
        pins_hold(seed);
    }
}

fn pins_hold(seed: u64) {
    let (machine, kinematics, settings) = random_of_2_9(seed);
    let folder = temporary();
    let export = exporter("linuxcnc-five-axis", &settings);
    let files = export.export(&machine.calibration, machine.model.as_ref()).unwrap_or_else(|error| panic!("{error}"));
    put(folder.path(), &files);
    let offsets = folder.path().join("work-offsets.ngc");
    assert!(is_read(&offsets), "{}", read(&offsets));
    let control = Linuxcnc::load(&kinematics, &files);
    // What the exporter leaves as it is, the machine's own files set.
    let own = ["z-rot-point", "tool-offset"]
        .map(|pin| format!("setp {}.{pin} {}\n", kinematics.module, kinematics.pins[pin]));
    let pins = read(&folder.path().join(PINS_OF_KINEMATICS));
    write(&folder.path().join(PINS_OF_KINEMATICS), &(pins + &own.concat()));
    let letters = letters(&machine);
    let set = read(&offsets).replace("M2\n", "");
    let program = format!("G54\n{set}{}", TILTING.replace('A', &letters[3]));
    let module = format!("{} coordinates={}", kinematics.module, letters.concat());
    let cycles = run(folder.path(), &machine, &module, &BTreeMap::new(), &program);
    let from = cycles.iter().position(|cycle| cycle.is_coordinated).expect("a program");
    let cycles = &cycles[from..];
    let by_axis = |values: &[f64]| -> ByAxis { letters.iter().cloned().zip(values.iter().copied()).collect() };
    let listed = |values: &ByAxis| -> Vec<f64> { letters.iter().map(|letter| values[letter]).collect() };
    // Joints in every cycle: the emulated kinematics with the new pins.
    let expected: Vec<Vec<f64>> =
        cycles.iter().map(|cycle| listed(&control.new.joints(&by_axis(&cycle.axes)))).collect();
    let in_cycle = largest(cycles.iter().map(|cycle| &cycle.kinematics).zip(&expected));
    // At rest: places of the program, moved by the work offset, and the tool there.
    let rest = at_rest(cycles);
    assert!(rest.len() >= 3, "{} times at rest", rest.len());
    let correction = export.correction(&machine.calibration, machine.model.as_ref()).expect("a prediction");
    let correction = correction.expect("a correction");
    let (mut off, mut before, mut from_predicted) = (0.0_f64, 0.0_f64, 0.0_f64);
    for (cycle, directions) in &rest {
        let mut program = by_axis(&cycle.axes);
        for (letter, by) in ["X", "Y", "Z"].iter().zip(control.offset) {
            *program.get_mut(*letter).expect("an axis") -= by;
        }
        let is_programmed = |at: &f64| (at / 5.0 - (at / 5.0).round()).abs() < 1e-7;
        assert!(program.values().all(is_programmed), "no place of the program: {program:?}");
        let joints = listed(&kinematics.joints(&program));
        let nominal = statuses(&machine, &[(&joints, directions)]);
        let predicted = commands(&machine, &correction.commands(&nominal).expect("commands"));
        from_predicted = from_predicted.max(largest([(&cycle.motors, &predicted[0])].into_iter()));
        let goal = machine.tips(&nominal, false);
        let tip = |commands: &[f64]| machine.tips(&statuses(&machine, &[(commands, directions)]), true);
        off = off.max(apart(&tip(&cycle.motors), &goal));
        before = before.max(apart(&tip(&joints), &goal));
    }
    println!(
        "linuxcnc pins of {}: {} cycles, kinematics within {in_cycle:.1e}, motors at {} rests within {from_predicted:.1e} of the \
         prediction, tool within {off:.4} of {before:.4} mm",
        kinematics.module,
        cycles.len(),
        rest.len()
    );
    assert!(in_cycle < 1e-9 && from_predicted < 1e-8, "{in_cycle:e} {from_predicted:e}");
    assert!(off < before, "the tool is {off} mm off, {before} mm before");
}

/// A machine with errors along its axes alone.
fn along_its_axes(name: &str) -> Machine {
    let mut calibration = calibration(name);
    for parameter in calibration["parameters"].as_array_mut().expect("parameters") {
        let is_own =
            ["EXX", "EYY", "EZZ"].iter().any(|own| parameter["name"].as_str().expect("a name").starts_with(own));
        if !is_own {
            parameter["value"] = json!(0.0);
        }
    }
    Machine::of(&calibration)
}

/// The trim of a screw table as LinuxCNC reads it, between rows too.
fn trim(rows: &[[f64; 3]], kind: u8, at: f64, direction: f64) -> f64 {
    let column = if direction > 0.0 { 1 } else { 2 };
    let of = |row: &[f64; 3]| if kind == 0 { row[0] - row[column] } else { row[column] };
    let after = rows.iter().position(|row| row[0] > at).expect("within the table");
    let (a, b) = (&rows[after - 1], &rows[after]);
    of(a) + (at - a[0]) / (b[0] - a[0]) * (of(b) - of(a))
}

#[test]
fn the_control_adds_the_screw_tables() {
    if let Some(reason) = missing() {
        return skipped("linuxcnc_screw_tables", &reason);
    }
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let machine = along_its_axes("three-axis");
    // Nodes of all tables, from both sides, and places between them.
    let program = "G21 G90 G61\nG0 X50 Y-50 Z50\nG4 P0.3\nG1 F9000 X-100 Y100 Z150\nG4 P0.3\nX50 Y-50 Z50\nG4 P0.3\nX0 Y0 Z100\nG4 P0.3\n\
        X-100 Y-100 Z0\nG4 P0.3\nX-73.25 Y-31.75 Z61.5\nG4 P0.3\nM2\n";
    for kind in [0_u8, 1] {
        let folder = temporary();
        let export = exporter("linuxcnc", &json!({ "type": kind, "step_mm": 50 }));
        let files =
            export.export(&machine.calibration, machine.model.as_ref()).unwrap_or_else(|error| panic!("{error}"));
        put(folder.path(), &files);
        let letters = letters(&machine);
        let file = |letter: &String| format!("{}.comp", letter.to_lowercase());
        let compensated = letters.iter().map(|letter| (letter.clone(), (file(letter), kind))).collect();
        let tables: Vec<Vec<[f64; 3]>> = letters.iter().map(|letter| rows(&folder.path().join(file(letter)))).collect();
        let cycles = run(folder.path(), &machine, "trivkins coordinates=XYZ", &compensated, program);
        let rest = at_rest(&cycles);
        assert!(rest.len() >= 6, "{} times at rest", rest.len());
        let (mut added, mut largest, mut wrong, mut between) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
        let (mut off, mut before) = (0.0_f64, 0.0_f64);
        for (cycle, directions) in &rest {
            for (joint, table) in tables.iter().enumerate() {
                let expected = trim(table, kind, cycle.joints[joint], directions[joint]);
                let other = trim(table, kind, cycle.joints[joint], -directions[joint]);
                let found = cycle.motors[joint] - cycle.joints[joint];
                added = added.max((found - expected).abs());
                wrong = wrong.max((found + expected).abs());
                between = between.max((found - other).abs());
                largest = largest.max(expected.abs());
            }
            let is_node = cycle.joints.iter().all(|at| (at / 50.0 - (at / 50.0).round()).abs() < 1e-9);
            if is_node {
                let tip =
                    |commands: &[f64], errors| machine.tips(&statuses(&machine, &[(commands, directions)]), errors);
                let goal = tip(&cycle.axes, false);
                off = off.max(apart(&tip(&cycle.motors, true), &goal));
                before = before.max(apart(&tip(&cycle.axes, true), &goal));
            }
        }
        println!(
            "linuxcnc screw tables of type {kind}: {} rests, trims to {largest:.4} within {added:.1e}, tool at nodes within {off:.1e} of \
             {before:.1e} mm",
            rest.len()
        );
        assert!(added < 1e-6, "type {kind}: {added} mm");
        // Neither the other sign nor the other direction would do.
        assert!(wrong > 1e-3 && between > 1e-3, "type {kind}: {wrong} {between}");
        assert!(off < 1e-5 && before > 5e-3, "type {kind}: the tool is {off} mm off, {before} mm before");
    }
}

/// The control follows a step of the trim at rest unless it is between one quarter and one half of acceleration times period squared:
/// there `compute_screw_comp` goes on at the velocity that it has, which is none.
#[test]
fn the_control_stays_behind_in_a_gap_of_small_trims() {
    if let Some(reason) = missing() {
        return skipped("linuxcnc_gap", &reason);
    }
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let (machine, folder) = (along_its_axes("three-axis"), temporary());
    let unit = ACCELERATION * 1e-3_f64.powi(2);
    let trims = [0.2 * unit, 0.4 * unit, 0.6 * unit];
    let mut compensated = BTreeMap::new();
    for (letter, trim) in letters(&machine).iter().zip(trims) {
        let file = format!("{letter}.txt");
        write(&folder.path().join(&file), &format!("-300 {trim:e} {trim:e}\n300 {trim:e} {trim:e}\n"));
        compensated.insert(letter.clone(), (file, 1));
    }
    let program = "G21 G90 G61\nG0 X50 Y50 Z50\nG4 P0.3\nM2\n";
    let cycles = run(folder.path(), &machine, "trivkins coordinates=XYZ", &compensated, program);
    let rest = at_rest(&cycles);
    let (cycle, _) = rest.last().expect("a time at rest");
    for (joint, expected) in [trims[0], 0.0, trims[2]].into_iter().enumerate() {
        let found = cycle.motors[joint] - cycle.joints[joint];
        assert!((found - expected).abs() < 1e-9, "joint {joint}: {found:e} instead of {expected:e}");
    }
}

/// The rows of a screw table.
fn rows(file: &Path) -> Vec<[f64; 3]> {
    let row = |line: &str| {
        let cells: Vec<f64> = line.split_whitespace().map(|cell| cell.parse().expect("a number")).collect();
        <[f64; 3]>::try_from(cells).expect("three numbers")
    };
    read(file).lines().map(row).collect()
}

/// A component of HAL on the control's own realtime: its pins take temperatures, and offsets go to where the prediction is, no faster than
/// they may.
#[test]
fn the_temperature_component_runs_in_hal() {
    const TEST: &str = "linuxcnc_temperature";
    if let Some(why) = missing() {
        return skipped(TEST, &why);
    }
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let warming = warming(5);
    let machine = &warming.machine;
    let rate = 50.0;
    let settings = json!({ "component": "abbe_test_temp", "largest_rate_um_per_s": rate });
    let export = exporter("linuxcnc-temperature", &settings);
    let files = export.export(&machine.calibration, machine.model.as_ref()).unwrap_or_else(|error| panic!("{error}"));
    let folder = temporary();
    put(folder.path(), &files);
    let installed = Installed::new(folder.path(), "abbe_test_temp");
    let middle = |header: &str| {
        let values = &warming.log[header];
        values.iter().sum::<f64>() / values.len() as f64
    };
    let scale = middle("T_scale_degC");
    let script = format!(
        "loadrt threads name1=servo-thread period1=1000000\nloadrt abbe_test_temp\naddf abbe-test-temp servo-thread\n\
         setp abbe-test-temp.position-x 200\nsetp abbe-test-temp.reading-t-scale {scale}\nstart\nloadusr -w sleep 3\n\
         getp abbe-test-temp.offset-x\ngetp abbe-test-temp.counts-x\ngetp abbe-test-temp.beyond\n"
    );
    write(&folder.path().join("run.hal"), &script);
    let at = folder.path().to_str().expect("a plain path");
    assert!(answers("chown", &["-R", USER, at]));
    let output = Command::new("timeout")
        .args(["--kill-after=10", "60", "runuser", "-u", USER, "--", "env"])
        .args([&format!("HOME={at}"), "halrun", "-f", "run.hal"])
        .current_dir(folder.path())
        .output()
        .expect("it starts");
    drop(installed);
    let told = String::from_utf8_lossy(&output.stdout);
    let mut lines = told.lines().filter_map(|line| line.trim().parse::<f64>().ok());
    let (offset, counts) = (lines.next(), lines.next());
    let wrong = || panic!("{told}{}", String::from_utf8_lossy(&output.stderr));
    let (Some(offset), Some(counts)) = (offset, counts) else { wrong() };
    // Once more by hand: states of the column rest at their reference, and that of the scale is 200 mm long.
    let gain = machine.calibration.get("EXX[1*T_scale]").expect("a gain").value;
    let axis = machine.model.info().axes.iter().find(|axis| axis.name == "X").expect("X");
    assert!(axis.range.is_some());
    let expected = -gain * 200.0 * (scale - 20.0);
    println!("linuxcnc temperature: {offset:.6} mm, {counts} counts, expected {expected:.6} mm");
    assert!(
        (offset.abs() - expected.abs()).abs() < 1e-6 && offset.signum() == expected.signum(),
        "{offset} {expected}"
    );
    assert!((counts * 1e-4 - offset).abs() < 0.6e-4, "{counts} {offset}");
    assert!(told.contains("FALSE"), "{told}");
}

/// A corrected program on the plain control does what the program does on the control that corrects by itself: at every rest the motors
/// stand where that control puts them, and all the way the tool is on the path of the program.
#[test]
fn corrected_programs_do_on_the_plain_control_what_the_corrected_control_does() {
    if let Some(reason) = missing() {
        return skipped("linuxcnc_programs", &reason);
    }
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    // Without backlash the whole path can be compared: a reversal is taken up in no time by one, in a block of its own by the other.
    let mut without_backlash = calibration("three-axis");
    for parameter in without_backlash["parameters"].as_array_mut().expect("parameters") {
        if parameter["name"].as_str().expect("a name").ends_with("[b]") {
            parameter["value"] = json!(0.0);
        }
    }
    let machine = Machine::of(&without_backlash);
    let mut options = abbe_controllers::Options::new(abbe_controllers::Dialect::Linuxcnc);
    (options.decimals, options.start) = (6, [Some(0.0); 9]);
    let tolerance = options.tolerance;
    let program = THREE_AXES.replace("X10 Y10 Z10\n", "X10 Y10 Z10 F20000\n");
    let corrected = |sign| crate::programs::corrected(&machine, &program, &options, sign).expect("a program").0;
    let (done, wrong) = (corrected(1.0), corrected(-1.0));

    // The control that corrects by itself.
    let folder = temporary();
    let component = "abbe_test_programs";
    let settings = json!({ "component": component, "form": "model", "correction": { "correct": "position" } });
    let export = exporter("linuxcnc-kinematics", &settings);
    let files = export.export(&machine.calibration, machine.model.as_ref()).unwrap_or_else(|error| panic!("{error}"));
    put(folder.path(), &files);
    let installed = Installed::new(folder.path(), component);
    let known = run(folder.path(), &machine, component, &BTreeMap::new(), &program);
    drop(installed);
    let on_plain = |program: &str| {
        let folder = temporary();
        run(folder.path(), &machine, "trivkins coordinates=XYZ", &BTreeMap::new(), program)
    };
    let plain = on_plain(&done);

    let coordinated =
        |cycles: &[Cycle]| -> Vec<Cycle> { cycles.iter().skip_while(|cycle| !cycle.is_coordinated).cloned().collect() };
    let (known, plain) = (coordinated(&known), coordinated(&plain));
    let [of_known, of_plain] = [&known, &plain].map(|cycles| at_rest(cycles));
    assert!(of_known.len() >= 3 && of_known.len() == of_plain.len(), "{} {}", of_known.len(), of_plain.len());
    let resting = largest(of_known.iter().zip(&of_plain).map(|((one, _), (other, _))| (&one.motors, &other.motors)));
    let none = [0.0; 3];
    let tips = |commands: Vec<&[f64]>, errors: bool| {
        let rows: Vec<(&[f64], &[f64])> = commands.into_iter().map(|commands| (commands, &none[..])).collect();
        machine.tips(&statuses(&machine, &rows), errors)
    };
    // From the first rest on: before it the program moves from where nobody has corrected.
    let after =
        |cycles: &[Cycle], rest: &Cycle| cycles.iter().skip_while(|cycle| *cycle != rest).cloned().collect::<Vec<_>>();
    let (of_program, of_tool) = (after(&known, &of_known[0].0), after(&plain, &of_plain[0].0));
    // The path as an interpreter that shares no code with the corrector has it.
    let blocks = crate::programs::interpreter::Control::new(&machine).run(&program);
    let positions = blocks[1..].iter().flat_map(|block| &block.path);
    let programmed: Vec<Vec<f64>> = positions.map(|at| ["X", "Y", "Z"].map(|axis| at[axis]).to_vec()).collect();
    let path = tips(programmed.iter().map(|at| &at[..]).collect(), false);
    let off = off_path(&tips(of_tool.iter().map(|cycle| &cycle.kinematics[..]).collect(), true), &path);
    let before = off_path(&tips(of_program.iter().map(|cycle| &cycle.axes[..]).collect(), true), &path);
    println!(
        "linuxcnc corrected programs: {} and {} cycles, motors at {} rests within {resting:.1e}, tool within {off:.1e} of the path, \
         {before:.1e} mm before",
        plain.len(),
        known.len(),
        of_plain.len()
    );
    assert!(resting < tolerance, "{resting} mm");
    assert!(off < 1.1 * tolerance && before > 10.0 * tolerance, "{off} mm, {before} mm before");
    // The negative correction is told apart by the same test; where its rests are follows from its text.
    let ends: Vec<&str> = wrong.lines().filter(|line| line.contains('X')).collect();
    let of_sign =
        ends.iter().zip(done.lines().filter(|line| line.contains('X'))).filter(|(one, other)| **one != *other).count();
    assert!(of_sign > 5, "{wrong}");
    let opposite: Vec<Vec<f64>> = of_plain
        .iter()
        .zip(&of_known)
        .map(|((cycle, _), (asked, _))| {
            cycle.motors.iter().zip(&asked.axes).map(|(motor, axis)| 2.0 * axis - motor).collect()
        })
        .collect();
    let off = apart(
        &tips(opposite.iter().map(|motors| &motors[..]).collect(), true),
        &tips(of_known.iter().map(|(cycle, _)| &cycle.axes[..]).collect(), false),
    );
    assert!(off > 10.0 * tolerance, "{off}");
}

/// Largest distance of points from a path.
fn off_path(points: &[[f64; 3]], path: &[[f64; 3]]) -> f64 {
    let of = |point: &[f64; 3]| {
        let off = path.windows(2).map(|step| crate::programs::from_segment(*point, step[0], step[1]));
        off.fold(f64::INFINITY, f64::min)
    };
    points.iter().step_by(5).map(of).fold(0.0, f64::max)
}
