//! The loop, closed on LinuxCNC itself: a machine with hidden errors is begun and planned, its own control probes the plan, the log
//! tells the errors, and with them the control measures the same plan again.
//!
//! The hidden machine is a component of HAL (`world/abbe_world.comp`), which shares no code with Abbe: from where the joints are it
//! computes where the tip of the stylus really is on the table, and closes the probe two milliseconds after the contact.
//!
//! What LinuxCNC 2.9 was seen to do:
//! - The position of a trigger is that of the servo cycle in which the probe is seen closed, no cycle later: with the delay and half a
//!   cycle on average, touches at 30 mm/min come 1.25 um late (found 1.28 um, standard uncertainty 0.06 um, in 100 touches).
//! - `(LOG,..)` writes a parameter with six decimals, `%f#n` with four, `%.6f#n` with six, `%d#n` a whole number. A format stays for all
//!   parameters behind it in the comment.
//! - After a miss `#5061`.. are where the move ended, and `#5070` is 0.
//! - `G38.3` runs on behind the trigger by its braking distance. Where the probe is closed when it begins, or closes in a move that does
//!   not probe, the program ends with an error: the retract of a measuring program must not touch anything.
//! - On SIGTERM its script ends all processes, realtime too, and takes away its lock and shared memory.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::PoisonError;
use std::time::{Duration, Instant};

use abbe_numerics::Generator;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::linuxcnc::{ALONE, Installed, Joints, failure, ini, missing};
use crate::support::{Variant, abbe, json_file, read, skipped, temporary, write};

/// Longest run of the control: some ten times what it needs, since it runs in real time, and slower where others use the processor.
const LONGEST: Duration = Duration::from_secs(600);

/// What a program stops with where LinuxCNC's task gets no time between the end of a probing move and its status: seen where others use the
/// processor (latency excursions of 60 ms), never on a machine that does nothing else. The flag of the last touch is read once more then, or
/// the queue is not empty. The program is run again, at most so many times: a way that is not free is not free the next time either.
const STARVED: [&str; 2] = ["Queue is not empty after probing", "the probe met something on its way"];
const REPEATED: usize = 3;

/// Standard deviation of a contact (mm), and time from the contact to the signal (s).
const NOISE: f64 = 3e-4;
const DELAY: f64 = 2e-3;

/// Standard uncertainty of a touch, µm: with the noise the way that the probe goes in a servo cycle, 0.5 µm, evenly spread.
const OF_A_TOUCH_UM: f64 = 0.4;

/// The log that a program writes.
const LOG: &str = "measured.log";

/// A kind of machine and what is touched.
struct Case {
    name: &'static str,
    chain: &'static str,
    method: &'static str,
    artefact: &'static str,
    number: usize,
    /// What is estimated on a machine that is taken to have no errors.
    without_errors: &'static [&'static str],
}

const FIVE_AXES: Case = Case {
    name: "linuxcnc-table",
    chain: "w C' A' b X Y Z t",
    method: "table",
    artefact: "table",
    number: 6,
    without_errors: &["dxt", "dyt", "dzt", "table.*"],
};

const THREE_AXES: Case = Case {
    name: "linuxcnc-balls",
    chain: "w Y' b X Z t",
    method: "balls",
    artefact: "balls",
    number: 44,
    without_errors: &["alone.*", "probe.r0"],
};

/// A surface: a face around a point, or a ball.
struct Surface {
    at: [f64; 3],
    normal: [f64; 3],
    radius: f64,
}

/// A machine with hidden errors.
struct World {
    case: &'static Case,
    folder: TempDir,
    recipe: Value,
    truth: BTreeMap<String, f64>,
    surfaces: Vec<Surface>,
    /// Contacts of the second surface that the probe does not feel.
    deaf: usize,
    seed: u64,
}

fn number(text: &str) -> f64 {
    text.trim().parse().unwrap_or_else(|_| panic!("{text} is no number"))
}

/// Where joints stand at first: Z is up.
fn home(letter: &str) -> f64 {
    if letter == "Z" { 400.0 } else { 0.0 }
}

/// Rows of a CSV file by the names of its columns.
fn rows(file: &Path) -> Vec<BTreeMap<String, String>> {
    let text = read(file);
    let mut lines = text.lines().filter(|line| !line.starts_with('#')).map(|line| line.split(',').map(str::to_owned));
    let header: Vec<String> = lines.next().expect("a header").collect();
    lines.map(|cells| header.iter().cloned().zip(cells).collect()).collect()
}

impl World {
    /// Begins a calibration, and draws the errors of its machine and the places of what is touched.
    fn new(case: &'static Case, seed: u64) -> Self {
        let folder = temporary();
        let begun = abbe(
            folder.path(),
            &["new", "begun", "--chain", case.chain, "--method", case.method, "--controller", "linuxcnc"],
        );
        assert_eq!(begun.status, 0, "{}", begun.stderr);
        let mut generator = Generator::new(seed, 0);
        let mut draw = |most: f64| most / 3.0_f64.sqrt() * generator.uniform();
        let begun = folder.path().join("begun");
        let recipe = Variant::of(&begun.join("recipe.yaml")).only(&["fit", "residuals", "control"]).0;
        let mut truth = BTreeMap::new();
        for name in recipe["stages"]["fit"]["parameters"].as_array().expect("a list") {
            let name = name.as_str().expect("a name");
            let most = match name {
                _ if name.contains('.') => continue,
                _ if name.ends_with("[1]") => 5e-5,
                "dxt" | "dyt" | "dzt" => 0.04,
                _ if name.starts_with("EX") || name.starts_with("EY") || name.starts_with("EZ") => 0.04,
                _ => 6e-5,
            };
            truth.insert(name.to_owned(), draw(most));
        }
        let is_ball = case.method == "balls";
        let nominal = rows(&begun.join(if is_ball { "balls.csv" } else { "facets.csv" }));
        let surface = |row: &BTreeMap<String, String>| {
            let at = ["x_mm", "y_mm", "z_mm"].map(|name| number(&row[name]));
            if is_ball {
                let by = [draw(0.1), draw(0.1), draw(0.1)];
                let at = std::array::from_fn(|axis| at[axis] + by[axis]);
                return Surface { at, normal: [0.0; 3], radius: number(&row["diameter_mm"]) / 2.0 };
            }
            let normal = ["nx", "ny", "nz"].map(|name| number(&row[name]));
            let by = draw(0.03);
            Surface { at: std::array::from_fn(|axis| at[axis] + by * normal[axis]), normal, radius: 0.0 }
        };
        let surfaces: Vec<Surface> = nominal.iter().map(surface).collect();
        let mut world = Self { case, folder, recipe, truth, surfaces, deaf: 0, seed };
        world.complete_recipe();
        world
    }

    /// The recipe with the program, what the probe can do, and a machine without errors to compare.
    fn complete_recipe(&mut self) {
        let case = self.case;
        let machine = self.machine();
        let radius = machine["stylus_radius_mm"].as_f64().expect("a radius");
        let length = machine["tool_length_mm"].as_f64().expect("a length");
        let certificate: Vec<Value> = (0..self.surfaces.len())
            .flat_map(|one| (one + 1..self.surfaces.len()).map(move |other| (one, other)))
            .map(|(one, other)| {
                let (a, b) = (self.surfaces[one].at, self.surfaces[other].at);
                let length = (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt();
                json!({ "between": [one + 1, other + 1], "length_mm": (length * 1e5).round() / 1e5,
                    "standard_uncertainty_um": 0.3 })
            })
            .collect();
        let stages = &mut self.recipe["stages"];
        stages[case.artefact]["standard_uncertainty_um"] = json!(OF_A_TOUCH_UM);
        if case.method == "balls" {
            stages[case.artefact]["distances"] = json!(certificate);
            stages["machine"]["probe"] = json!(["r0"]);
            stages["fit"]["parameters"].as_array_mut().expect("a list").push(json!("probe.r0"));
        }
        let mut without = stages["fit"].clone();
        if case.method == "balls" {
            // Nothing holds the balls in their places: errors of the machine are seen in the distances between them.
            let mut alone = stages[case.artefact].clone();
            alone.as_object_mut().expect("a map").remove("distances");
            stages["alone"] = alone;
            without["observations"] = json!(["alone"]);
        }
        without["parameters"] = json!(case.without_errors);
        without.as_object_mut().expect("a map").remove("robust");
        stages["without-errors"] = without;
        stages["control"]["component"] = json!(COMPONENT);
        let plan = &mut self.recipe["plan"];
        plan["number"] = json!(case.number);
        plan["program"] = json!({
            "control": "linuxcnc", "log": LOG, "unreachable": "leave-out",
            "probe": [{ "diameter_mm": 2.0 * radius, "length_mm": 50 }, { "diameter_mm": 30, "length_mm": length - 50.0 }],
            "clearance": { "plane": { "axis": "Z", "at_mm": 400 } },
            "approach_mm": 1, "margin_mm": 0.5, "overtravel_mm": 1, "back_off_mm": 0.1, "search_feed_mm_per_min": 240,
            "measuring_feed_mm_per_min": 30, "positioning_feed_mm_per_min": 100000, "rotary_feed_deg_per_min": 60000,
        });
    }

    fn machine(&self) -> Value {
        serde_yaml::from_str(&read(&self.folder.path().join("begun/machine.yaml"))).expect("a machine")
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Letters of the axes from the bed to the workpiece and to the tool.
    fn sides(&self) -> [Vec<String>; 2] {
        let letters =
            |text: &str| text.split_whitespace().map(|word| word.trim_matches('\'').to_owned()).collect::<Vec<_>>();
        let (work, tool) = self.case.chain.split_once(" b ").expect("a bed");
        let mut work = letters(work.trim_start_matches('w'));
        work.reverse();
        [work, letters(tool.trim_end_matches('t'))]
    }

    /// Letters of the joints, in the order of LinuxCNC.
    fn joints(&self) -> Vec<String> {
        let all = self.sides().concat();
        ["X", "Y", "Z", "A", "B", "C"].into_iter().map(str::to_owned).filter(|letter| all.contains(letter)).collect()
    }

    /// What the component is compiled with.
    fn header(&self) -> String {
        let list = |values: &[f64]| {
            format!("{{{}}}", values.iter().map(|value| format!("{value:.15e}")).collect::<Vec<_>>().join(","))
        };
        let index = |letter: char| "XYZABC".find(letter).expect("a direction");
        let joints = self.joints();
        let mut tool = [0.0, 0.0, -self.machine()["tool_length_mm"].as_f64().expect("a length")];
        let mut errors = vec![[[0.0; 6]; 2]; joints.len()];
        for (name, value) in &self.truth {
            let letters: Vec<char> = name.chars().collect();
            match letters[..] {
                ['d', axis, 't'] => tool[index(axis.to_ascii_uppercase())] += value,
                ['E', component, '0', axis] | ['E', component, axis, '[', '1', ']'] => {
                    let joint = joints.iter().position(|joint| joint.starts_with(axis)).expect("a joint");
                    errors[joint][usize::from(letters[2] != '0')][index(component)] = *value;
                }
                _ => panic!("{name} is not simulated"),
            }
        }
        let mut text = format!(
            "#define JOINTS {}\nstruct joint {{ int is_rotary, direction; double point[3], location[6], motion[6], home; }};\n\
             struct feature {{ double at[3], normal[3], radius, reach; int deaf; }};\nstatic const struct joint JOINT[JOINTS] = {{\n",
            joints.len()
        );
        for (letter, [location, motion]) in joints.iter().zip(&errors) {
            let number = index(letter.chars().next().expect("a letter"));
            let (location, motion) = (list(location), list(motion));
            let _ = writeln!(text, "{{{},{},{{0,0,0}},{location},{motion},{}}},", number / 3, number % 3, home(letter));
        }
        let places = |letters: &[String]| {
            let place = |letter: &String| joints.iter().position(|joint| joint == letter).expect("a joint").to_string();
            letters.iter().map(place).chain(["-1".to_owned()]).collect::<Vec<_>>().join(",")
        };
        let [work, side] = self.sides();
        let _ = writeln!(
            text,
            "}};\nstatic const int TOOL_SIDE[] = {{{}}}, WORK_SIDE[] = {{{}}};\nstatic const double TOOL[3] = {};\n\
             #define FEATURES {}\nstatic const struct feature FEATURE[] = {{",
            places(&side),
            places(&work),
            list(&tool),
            self.surfaces.len()
        );
        for (place, Surface { at, normal, radius }) in self.surfaces.iter().enumerate() {
            let deaf = if place == 1 { self.deaf } else { 0 };
            let _ = writeln!(text, "{{{},{},{radius},25,{deaf}}},", list(at), list(normal));
        }
        let radius = &self.machine()["stylus_radius_mm"];
        let _ = writeln!(
            text,
            "}};\n#define STYLUS {radius}\n#define NOISE {NOISE}\n#define DELAY {DELAY}\n#define SEED {}ULL",
            self.seed
        );
        text
    }

    /// Plans touches, and writes the program that measures them.
    fn plan(&self) {
        write(&self.at("begun/loop.yaml"), &self.recipe.to_string());
        let planned = abbe(self.folder.path(), &["plan", "begun/loop.yaml", "--out", "plan"]);
        assert!(planned.status <= 1, "{}", planned.stderr);
        assert!(self.at("plan/measure.ngc").exists(), "{}{}", planned.stdout, planned.stderr);
    }

    /// Runs the program on the control; gives the file of its log. Files of `with` are for the kinematics.
    fn measure(&self, name: &str, kinematics: &str, with: Option<&Path>, more: &Value) -> PathBuf {
        let folder = self.at(name);
        std::fs::create_dir(&folder).expect("a folder");
        let joints = self.joints();
        let limits = Joints { velocity: 2000.0, acceleration: 20000.0, home };
        write(&folder.join("abbe.ini"), &ini(&joints, &limits, kinematics, &BTreeMap::new()));
        let mut hal = "loadrt [KINS]KINEMATICS\n\
             loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS\nloadrt abbe_world\n\
             addf motion-command-handler servo-thread\naddf motion-controller servo-thread\naddf abbe-world servo-thread\n\
             net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in\n\
             net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared\n\
             net change iocontrol.0.tool-change => iocontrol.0.tool-changed\n\
             net probe abbe-world.trigger => motion.probe-input\n"
            .to_owned();
        for joint in 0..joints.len() {
            let _ = writeln!(
                hal,
                "net motor{joint} joint.{joint}.motor-pos-cmd => joint.{joint}.motor-pos-fb abbe-world.joint-{joint}"
            );
        }
        write(&folder.join("abbe.hal"), &hal);
        write(&folder.join("abbe.tbl"), "");
        write(&folder.join("program.ngc"), &read(&self.at("plan/measure.ngc")));
        write(&folder.join("abbe_world.h"), &self.header());
        write(&folder.join("abbe_world.comp"), include_str!("world/abbe_world.comp"));
        let mut how = json!({ "longest_s": LONGEST.as_secs() - 20, "pins": ["abbe-world.deepest", "abbe-world.contacts"],
            "log": LOG });
        more.as_object().expect("a map").iter().for_each(|(key, value)| how[key] = value.clone());
        write(&folder.join("ui.json"), &how.to_string());
        let _world = Installed::new(&folder, "abbe_world");
        let _kinematics = with.map(|from| {
            std::fs::copy(from.join(format!("{COMPONENT}.comp")), folder.join(format!("{COMPONENT}.comp")))
                .expect("a file");
            Installed::new(&folder, COMPONENT)
        });
        let clock = Instant::now();
        let again = [LOG, "failed.txt", "pins.json"].map(|name| folder.join(name));
        let mut why = failure(&folder, LONGEST);
        for _ in 0..REPEATED {
            let is_starved = |why: &String| STARVED.iter().any(|starved| why.contains(starved));
            if !why.as_ref().is_some_and(is_starved) {
                break;
            }
            println!("{} {name}: once more after {why:?}", self.case.name);
            again.iter().filter(|file| file.exists()).for_each(|file| std::fs::remove_file(file).expect("a file"));
            why = failure(&folder, LONGEST);
        }
        assert!(why.is_none(), "{why:?}{}", read(&folder.join("log.txt")));
        let pins = json_file(&folder.join("pins.json"));
        let log = folder.join(LOG);
        println!(
            "{} {name}: {:.0} s, {} contacts, {} lines of log, deepest {:.3} mm",
            self.case.name,
            clock.elapsed().as_secs_f64(),
            pins["abbe-world.contacts"],
            read(&log).lines().count(),
            pins["abbe-world.deepest"].as_f64().expect("a number")
        );
        assert!(pins["abbe-world.deepest"].as_f64().is_some_and(|deepest| deepest < 0.2), "{pins}");
        log
    }

    /// The recipe that reads a log, in a folder of its own.
    fn evaluation(&self, name: &str, log: &Path, more: &Value) -> PathBuf {
        let mut recipe = self.recipe.clone();
        let mut ingest = json!({ "ingest": "linuxcnc-log", "path": log, "plan": self.at("plan/plan.csv") });
        more.as_object().expect("a map").iter().for_each(|(key, value)| ingest[key] = value.clone());
        recipe["stages"]["touches"] = ingest;
        recipe.as_object_mut().expect("a map").remove("plan");
        let file = self.at(&format!("begun/{name}.yaml"));
        write(&file, &recipe.to_string());
        file
    }

    /// Evaluates a log: the calibrations with the errors of the machine and without them.
    fn evaluate(&self, name: &str, log: &Path) -> [Value; 2] {
        let recipe = self.evaluation(name, log, &json!({}));
        let run = abbe(self.folder.path(), &["run", recipe.to_str().expect("a plain path"), "--out", "out"]);
        assert!([0, 3].contains(&run.status), "{}{}", run.stdout, run.stderr);
        ["fit", "without-errors"].map(|fit| json_file(&self.at(&format!("out/{name}/{fit}.calibration.json"))))
    }
}

impl World {
    /// What a machine that is taken to have no errors leaves, µm: scatter of the residuals, or of the distances between balls, which
    /// are known.
    fn left(&self, calibration: &Value) -> f64 {
        if self.case.method != "balls" {
            return calibration["fit"]["sigma"].as_f64().expect("a number") * OF_A_TOUCH_UM;
        }
        let nominal = rows(&self.at("begun/balls.csv"));
        let found: BTreeMap<String, f64> = (calibration["artefacts"].as_array().expect("artefacts").iter())
            .map(|own| (own["name"].as_str().expect("a name").to_owned(), own["value"].as_f64().expect("a number")))
            .collect();
        let centre = |ball: usize| {
            ["x", "y", "z"].map(|axis| {
                number(&nominal[ball][&format!("{axis}_mm")]) + found[&format!("alone.ball[{}].{axis}", ball + 1)]
            })
        };
        let apart = |a: [f64; 3], b: [f64; 3]| (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt();
        let all = (0..nominal.len()).flat_map(|one| (one + 1..nominal.len()).map(move |other| (one, other)));
        let off = all.map(|(one, other)| {
            apart(centre(one), centre(other)) - apart(self.surfaces[one].at, self.surfaces[other].at)
        });
        let squares: Vec<f64> = off.map(|off| off * off).collect();
        1e3 * (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    }
}

/// The kinematics that Abbe writes for the control.
const COMPONENT: &str = "abbe_test_loop";

/// Values of the machine with their standard uncertainties.
fn found(calibration: &Value) -> BTreeMap<String, (f64, f64)> {
    let all = calibration["parameters"].as_array().expect("parameters").iter();
    let estimated = all.filter(|found| found["status"] == "estimated");
    let number = |found: &Value, key: &str| found[key].as_f64().expect("a number");
    let one = |found: &Value| {
        let name = found["name"].as_str().expect("a name").to_owned();
        (name, (number(found, "value"), number(found, "standard_uncertainty")))
    };
    estimated.map(one).collect()
}

/// Keeps the files of a measurement where `ABBE_LOOP_KEEP` says.
fn keep(world: &World, log: &Path) {
    let Ok(folder) = std::env::var("ABBE_LOOP_KEEP") else { return };
    let folder = Path::new(&folder).join(world.case.name);
    std::fs::create_dir_all(&folder).expect("a folder");
    let truth = json!({ "parameters": world.truth });
    write(&folder.join("truth.json"), &serde_json::to_string_pretty(&truth).expect("JSON"));
    write(&folder.join("recipe.json"), &serde_json::to_string_pretty(&world.recipe).expect("JSON"));
    for file in [log.to_owned(), world.at("plan/plan.csv"), world.at("begun/machine.yaml")] {
        std::fs::copy(&file, folder.join(file.file_name().expect("a name"))).expect("a copy");
    }
    for name in ["facets.csv", "balls.csv"] {
        let file = world.at("begun").join(name);
        if file.exists() {
            std::fs::copy(file, folder.join(name)).expect("a copy");
        }
    }
}

/// Measured, corrected and measured again.
fn closes(case: &'static Case, seed: u64) {
    let world = World::new(case, seed);
    world.plan();
    let log = world.measure("before", &format!("trivkins coordinates={}", world.joints().concat()), None, &json!({}));
    keep(&world, &log);
    let [fit, without] = world.evaluate("first", &log);
    let mut worst: f64 = 0.0;
    let values = found(&fit);
    for (name, hidden) in &world.truth {
        let (value, standard) = values.get(name).unwrap_or_else(|| panic!("{name} is not estimated"));
        let off = (value - hidden) / standard;
        println!("  {name}: {value:.3e} of {hidden:.3e}, {off:.2} standard uncertainties");
        worst = worst.max(off.abs());
    }
    assert!(worst < 4.0, "{worst}");
    let kinematics = world.at("out/first/control");
    let log = world.measure("after", COMPONENT, Some(&kinematics), &json!({}));
    let [again, left] = world.evaluate("second", &log);
    let (before, after) = (world.left(&without), world.left(&left));
    println!(
        "{} seed {seed}: worst {worst:.2} standard uncertainties; {before:.2} um left without correction and {after:.2} um with it, sigma {:.2}",
        case.name,
        again["fit"]["sigma"].as_f64().expect("a number")
    );
    assert!(before > 10.0 * after, "{before} {after}");
    assert!(after < 1.0, "what is left is not at the noise: {after}");
}

/// One seed in the gate; `ABBE_LOOP_SEEDS=n` runs n of them.
fn seeds() -> std::ops::Range<u64> {
    let more = std::env::var("ABBE_LOOP_SEEDS").ok().and_then(|count| count.parse().ok());
    1..1 + more.unwrap_or(1)
}

#[test]
fn a_five_axis_machine_measures_its_table_and_corrects_itself() {
    if let Some(reason) = missing() {
        return skipped("linuxcnc_loop_table", &reason);
    }
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    seeds().for_each(|seed| closes(&FIVE_AXES, seed));
}

#[test]
fn a_three_axis_machine_measures_balls_and_corrects_itself() {
    if let Some(reason) = missing() {
        return skipped("linuxcnc_loop_balls", &reason);
    }
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    seeds().for_each(|seed| closes(&THREE_AXES, seed));
}

/// A contact that the probe does not feel is a miss and is tried again; a program that is stopped leaves a log that says so.
#[test]
fn misses_and_stops_of_the_control_come_back_right() {
    if let Some(reason) = missing() {
        return skipped("linuxcnc_misses", &reason);
    }
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut world = World::new(&THREE_AXES, 7);
    world.recipe["plan"]["number"] = json!(14);
    world.deaf = 1;
    world.plan();
    let trivial = format!("trivkins coordinates={}", world.joints().concat());
    let log = world.measure("missed", &trivial, None, &json!({}));
    let text = read(&log);
    let missed: Vec<&str> = text.lines().filter(|line| line.contains("H0")).collect();
    assert_eq!(missed.len(), 1, "{text}");
    let touch = missed[0].split_whitespace().next().expect("a number");
    assert_eq!(text.lines().filter(|line| line.split_whitespace().next() == Some(touch)).count(), 2, "{text}");
    let checked = |name: &str, log: &Path, more: &Value| {
        let recipe = world.evaluation(name, log, more);
        abbe(world.folder.path(), &["check", recipe.to_str().expect("a plain path")])
    };
    // 14 touches and the certificate of 6 distances.
    let accepted = checked("missed", &log, &json!({}));
    assert!(
        accepted.status <= 1 && accepted.stdout.split_whitespace().any(|word| word == "20"),
        "{}{}",
        accepted.stdout,
        accepted.stderr
    );

    let log = world.measure("stopped", &trivial, None, &json!({ "abort_after": "T5 " }));
    assert!(!read(&log).contains("END"), "{}", read(&log));
    let refused = checked("stopped", &log, &json!({}));
    assert!(refused.status != 0 && refused.stderr.contains("aborted"), "{}{}", refused.stdout, refused.stderr);
    let taken = checked("taken", &log, &json!({ "aborted": "accept" }));
    assert!(taken.status <= 1 && taken.stderr.contains("no END"), "{}", taken.stderr);
}
