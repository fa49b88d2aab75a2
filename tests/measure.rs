//! Programs that measure a plan, run by an interpreter of each control's language on a machine whose ball or faces are not quite where
//! the plan has them: the right place, sense, side and order, without collision; misses, and what is refused.

mod bodies;
mod faces;
mod klartext;
mod machine;
mod random;
mod rs274;

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use tempfile::TempDir;

use crate::gcode::{End, fanuc, siemens};
use crate::support::{Printed, abbe, read, registry, skipped, temporary, write};
use bodies::{Ball, Body};
use machine::{ByAxis, Machine};

/// Names of controls, with the files of their programs and dry runs.
const CONTROLS: [(&str, &str, &str); 5] = [
    ("linuxcnc", "measure.ngc", "dry-run.ngc"),
    ("fanuc", "O9910.nc", "O9912.nc"),
    ("siemens", "ABBE_MEASURE.MPF", "ABBE_DRY_RUN.MPF"),
    ("heidenhain", "MEASURE.H", "DRYRUN.H"),
    ("grbl", "measure.gcode", "dry-run.gcode"),
];

/// Tables and heads, three to five axes.
const CHAINS: [&str; 7] = [
    "w C' A' b X Y Z t",
    "w C' B' b Y X Z t",
    "w B' X' b Y Z t",
    "w b X Y Z C A t",
    "w X' Y' b Z B t",
    "w C' X' b Y Z B t",
    "w X' Y' b Z t",
];

const SPHERE: &str = "sphere: { centre_mm: [60, 20, 60], radius_mm: 140 }";
/// A rod where nothing comes.
const AWAY: [[f64; 3]; 2] = [[900.0, 0.0, 0.0], [900.0, 0.0, 1.0]];

const PLANE: &str = "plane: { axis: Z, at_mm: 420 }";

/// A begun calibration with its plan and program.
struct Planned {
    folder: TempDir,
    files: BTreeMap<String, String>,
    /// Positions of all axes and normals, by the number of the touch.
    touches: BTreeMap<usize, ByAxis>,
    /// What they touch.
    features: BTreeMap<usize, String>,
    /// Whether touches that are left out were told.
    tells: bool,
    /// `plan.json`.
    record: serde_json::Value,
}

fn plan(chain: &str, control: &str, clearance: &str, more: &str) -> (TempDir, Printed) {
    changed((chain, &Setup::ball()), control, clearance, more, &str::to_owned)
}

/// What is measured, and where on the table it is.
struct Setup<'a> {
    method: &'a str,
    /// A nominal file in the place of the one that was begun, with its name.
    nominal: Option<(&'a str, String)>,
    /// Settings of the program: what stands on the table.
    solids: String,
}

impl Setup<'_> {
    /// A ball on a rod.
    fn ball() -> Self {
        let rod = "    solids: [{ cylinder: { from_mm: [90, 30, 0], to_mm: [90, 30, 108], radius_mm: 5 } }]\n";
        Self { method: "ball", nominal: None, solids: rod.to_owned() }
    }
}

/// The plan of a recipe with a change of its own.
fn changed(
    (chain, setup): (&str, &Setup<'_>),
    control: &str,
    clearance: &str,
    more: &str,
    change: &dyn Fn(&str) -> String,
) -> (TempDir, Printed) {
    let folder = temporary();
    let at = folder.path();
    let begun = abbe(at, &["new", "begun", "--chain", chain, "--method", setup.method]);
    assert_eq!(begun.status, 0, "{chain}: {}", begun.stderr);
    if let Some((name, text)) = &setup.nominal {
        write(&at.join("begun").join(name), text);
    }
    let recipe = at.join("begun/recipe.yaml");
    let program = format!(
        "  program:\n    control: {control}\n    clearance: {{ {clearance} }}\n    probe: [{{ diameter_mm: 4, length_mm: 40 }}, \
         {{ diameter_mm: 40, length_mm: 110 }}]\n{}{more}\n",
        setup.solids
    );
    let text = read(&recipe).replacen("  generate: {", &format!("{program}  generate: {{"), 1);
    let number = text.find("  number: ").map(|start| &text[start..][..text[start..].find(['\n', '#']).unwrap_or(0)]);
    let text = match number.map(str::trim_end).map(str::to_owned) {
        Some(number) if number.ends_with("12") => text.replacen(&number, "  number: 7", 1),
        _ => text,
    };
    write(&recipe, &change(&text));
    let printed = abbe(at, &["plan", "begun/recipe.yaml", "--out", "plan", "--program", control]);
    (folder, printed)
}

impl Planned {
    fn new(chain: &str, control: &str, clearance: &str, more: &str) -> Self {
        let planned = Self::of(chain, control, clearance, more, &str::to_owned);
        planned.unwrap_or_else(|error| panic!("{chain} {control}: {error}"))
    }

    /// The same of a recipe with a change of its own; the message, on one line, if there is no plan.
    fn of(
        chain: &str,
        control: &str,
        clearance: &str,
        more: &str,
        change: &dyn Fn(&str) -> String,
    ) -> Result<Self, String> {
        Self::of_setup((chain, &Setup::ball()), control, clearance, more, change)
    }

    /// The same of another artefact.
    fn of_setup(
        what: (&str, &Setup<'_>),
        control: &str,
        clearance: &str,
        more: &str,
        change: &dyn Fn(&str) -> String,
    ) -> Result<Self, String> {
        let (folder, printed) = changed(what, control, clearance, more, change);
        if printed.status != 0 {
            return Err(printed.stderr.replace(['\n', '│'], " ").split_whitespace().collect::<Vec<_>>().join(" "));
        }
        let tells = printed.stderr.contains("the program leaves out");
        let at = folder.path().join("plan");
        let name = |entry: std::fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
        let names = std::fs::read_dir(&at).expect("a folder").map(|entry| name(entry.expect("a file")));
        let files: BTreeMap<String, String> = names.map(|name| (name.clone(), read(&at.join(&name)))).collect();
        let mut rows = files["plan.csv"].lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
        let header = rows.next().expect("a header");
        let rows: Vec<Vec<String>> = rows.collect();
        let column = |name: &str| header.iter().position(|own| own == name).expect("a column");
        let (number, feature) = (column("touch"), column("feature"));
        let features = rows.iter().map(|row| (row[number].parse().expect("a number"), row[feature].clone())).collect();
        let touches = rows.iter().map(|row| {
            let cells = header.iter().zip(row).filter_map(|(name, cell)| Some((name.clone(), cell.parse().ok()?)));
            let cells: ByAxis = cells.collect();
            (cells["touch"] as usize, cells)
        });
        let record = serde_json::from_str(&files["plan.json"]).expect("JSON");
        Ok(Self { touches: touches.collect(), features, record, folder, files, tells })
    }

    /// The machine, its ball beside its place by some hundredths of a millimetre.
    fn machine(&self, off: [f64; 3]) -> Machine {
        let centre = [90.0 + off[0], 30.0 + off[1], 120.0 + off[2]];
        self.with(Ball { centre, radius: 12.5, stand: [[90.0, 30.0, 0.0], [90.0, 30.0, 103.0]] })
    }

    /// The machine with this on its table.
    fn with(&self, body: impl Body + 'static) -> Machine {
        let prepared =
            abbe_engine::prepare(&self.folder.path().join("begun/recipe.yaml"), &registry()).expect("a recipe");
        let model = prepared.described().expect("machines").remove(0).model;
        Machine::new(model, Box::new(body), &self.first())
    }

    /// The rotary axes stand where the first touch has them.
    fn first(&self) -> ByAxis {
        let rotary = self
            .touches
            .values()
            .next()
            .expect("a touch")
            .iter()
            .filter_map(|(name, place)| Some((name.strip_suffix("_deg")?.to_owned(), *place)));
        rotary.collect()
    }

    fn run(&self, control: &str, file: &str, machine: &mut Machine) -> Result<(), String> {
        let text = &self.files[file];
        let end = match control {
            "fanuc" => fanuc::run(text, &mut BTreeMap::new(), machine)?,
            "siemens" => {
                let stem = |name: &String| name.split('.').next().unwrap_or_default().to_owned();
                let programs = self.files.iter().filter(|(name, _)| name.ends_with("PF"));
                let programs: BTreeMap<String, String> =
                    programs.map(|(name, text)| (stem(name), text.clone())).collect();
                let name = file.split('.').next().unwrap_or_default();
                siemens::run_among(&programs, name, &mut BTreeMap::new(), machine)?
            }
            "heidenhain" => return klartext::run(&self.files, file, machine),
            control => return rs274::run(text, control == "grbl", machine),
        };
        if let End::Alarm(number, text) = end {
            machine.alarm = Some(format!("{number} {text}"));
        }
        Ok(())
    }

    /// Runs the program and looks at its log: the touches with hits, in the order of the log, and the number of misses.
    fn measured(&self, control: &str, file: &str, machine: &mut Machine) -> Result<(Vec<usize>, usize), String> {
        self.run(control, file, machine)?;
        if let Some(alarm) = &machine.alarm {
            return Err(format!("alarm: {alarm}"));
        }
        let (hits, misses) = logged(&machine.log)?;
        let radius = machine.model.info().stylus_radius;
        for (number, logged) in &hits {
            let planned = self.touches.get(number).ok_or_else(|| format!("touch {number} is not planned"))?;
            let mut at = machine.at.clone();
            let rotary =
                planned.iter().filter_map(|(name, place)| Some((name.strip_suffix("_deg")?.to_owned(), *place)));
            at.extend(rotary);
            for (axis, place) in logged {
                if planned.get(&format!("{axis}_deg")).is_some_and(|planned| (planned - place).abs() > 1e-3) {
                    return Err(format!("touch {number}: {axis} stands at {place}"));
                }
            }
            at.extend(logged.clone());
            let normal = ["nx", "ny", "nz"].map(|name| planned[name]);
            let [off, beside] = machine.body.contact(&self.features[number], normal, machine.tip(&at).0, radius);
            // grbl reports three decimals of millimetres, or four of inches.
            if off.abs() > 3e-3 || beside > 0.3 {
                return Err(format!("touch {number} is {off} mm from contact, {beside} mm from its place"));
            }
        }
        Ok((hits.into_iter().map(|(number, _)| number).collect(), misses))
    }
}

/// Hits with the positions that the log has, and the number of misses. A reader of its own.
fn logged(log: &[String]) -> Result<(Vec<(usize, ByAxis)>, usize), String> {
    let (mut hits, mut misses, mut block, mut header, mut unit) = (Vec::new(), 0, None, BTreeSet::new(), 1.0);
    for line in log {
        let line = line.trim().trim_matches(['(', ')']);
        let known = ["ABBE 1", "PLAN", "CONTROL", "UNITS ", "FRAME MACHINE", "TOOL L0.0000 D", "TOUCHES", "END"];
        if line == "UNITS INCH" {
            unit = 25.4;
        }
        if let Some(diameter) = line.strip_prefix("TOOL L0.0000 D").and_then(|rest| rest.parse::<f64>().ok()) {
            let off = (diameter * unit - 6.0).abs();
            header.extend((off > 2e-4).then(|| format!("a diameter {off} mm off")));
        }
        header.extend(known.iter().filter(|known| line.starts_with(*known)).map(|known| (*known).to_owned()));
        if let Some(number) = line.strip_prefix('N') {
            block = number.split(' ').next().and_then(|number| number.parse::<usize>().ok());
        } else if let Some(answer) = line.strip_prefix("[PRB:").and_then(|rest| rest.strip_suffix(']')) {
            let Some(number) = block.take() else { continue };
            let (places, hit) = answer.split_once(':').ok_or("no answer")?;
            let places = ["X", "Y", "Z"]
                .iter()
                .zip(places.split(','))
                .map(|(axis, place)| ((*axis).to_owned(), unit * place.parse().unwrap_or(f64::NAN)));
            if hit == "1" { hits.push((number / 100, places.collect())) } else { misses += 1 }
        } else if line
            .strip_prefix('T')
            .is_some_and(|rest| rest.trim_start().starts_with(|next: char| next.is_ascii_digit()))
        {
            // Blanks between a letter and its number are allowed.
            let mut words: Vec<(String, String)> = Vec::new();
            for letter in line.chars() {
                if letter.is_ascii_alphabetic() {
                    words.push((letter.to_string(), String::new()));
                } else if let Some((_, number)) = words.last_mut().filter(|_| letter != ' ') {
                    number.push(letter);
                }
            }
            let parsed: ByAxis =
                words.iter().filter_map(|(name, number)| Some((name.clone(), number.parse().ok()?))).collect();
            if parsed.len() != words.len() {
                return Err(format!("`{line}`"));
            }
            if parsed["H"] == 0.0 {
                misses += 1;
                continue;
            }
            let axes = parsed.iter().filter(|(name, _)| "XYZABCUVW".contains(name.as_str()));
            let scaled = |(name, value): (&String, &f64)| {
                (name.clone(), if "XYZUVW".contains(name.as_str()) { unit * value } else { *value })
            };
            hits.push((parsed["T"] as usize, axes.map(scaled).collect()));
        }
    }
    if header.len() == 8 { Ok((hits, misses)) } else { Err(format!("the header has {header:?}")) }
}

fn random(seed: usize) -> [f64; 3] {
    [0, 1, 2].map(|axis| ((seed * 37 + axis * 11 + 5) as f64 * 0.731).sin() * 0.08)
}

#[test]
fn every_control_touches_the_right_places_in_order_and_without_collision() {
    for (seed, chain) in CHAINS.iter().enumerate() {
        for (index, (control, file, dry)) in CONTROLS.iter().enumerate() {
            if (seed + index) % 3 == 2 {
                continue;
            }
            let search = if (seed + index) % 2 == 0 { "    search_feed_mm_per_min: 200\n" } else { "" };
            let clearance = if chain.ends_with("Z t") && index % 2 == 0 { PLANE } else { SPHERE };
            let planned = Planned::new(chain, control, clearance, &format!("{search}    unreachable: leave-out\n"));
            let what = format!("{chain} {control} {clearance}");
            let mut machine = planned.machine(random(seed * 7 + index));
            let (hits, misses) =
                planned.measured(control, file, &mut machine).unwrap_or_else(|error| panic!("{what}: {error}"));
            assert_eq!(misses, 0, "{what}");
            assert_eq!(hits.iter().collect::<BTreeSet<_>>().len(), hits.len(), "{what}: {hits:?}");
            // What cannot be reached is named in the program, and is none of its plan.
            let told = planned.files[*file].to_uppercase().matches("LEFT OUT: ").count();
            // It is told before anything is measured, too, since the expected uncertainties count it.
            assert_eq!(planned.tells, told > 0, "{what}");
            assert!(told > 0 || planned.touches.keys().copied().eq(1..=planned.touches.len()), "{what}");
            assert_eq!(hits.len(), planned.touches.len(), "{what}");
            assert!(hits.len() >= 4, "{what}: {} of {}", hits.len(), planned.touches.len());
            // Touches of one position of the rotary axes are made together.
            let turned = |touch: &usize| -> Vec<String> {
                let rotary = planned.touches[touch].iter().filter(|(name, _)| name.ends_with("_deg"));
                rotary.map(|(name, place)| format!("{name}{place:.3}")).collect()
            };
            let changes = hits.windows(2).filter(|pair| turned(&pair[0]) != turned(&pair[1])).count();
            let groups = hits.iter().map(turned).collect::<BTreeSet<_>>().len();
            assert_eq!(changes + 1, groups, "{what}");
            // The dry run ends without contact.
            let mut machine = planned.machine(random(seed));
            planned.run(control, dry, &mut machine).unwrap_or_else(|error| panic!("{what}, dry: {error}"));
            assert_eq!((machine.alarm, machine.triggered), (None, false), "{what}, dry");
        }
    }
}

/// A machine whose X goes the other way touches nothing where the plan has it.
#[test]
fn an_axis_with_the_wrong_sign_is_noticed() {
    for (control, file, _) in CONTROLS {
        let planned = Planned::new(CHAINS[0], control, SPHERE, "    search_feed_mm_per_min: 200\n");
        for axis in ["X", "Y", "C"] {
            let mut machine = planned.machine([0.0; 3]);
            machine.flipped = Some(axis.to_owned());
            let found = planned.measured(control, file, &mut machine);
            let all = found.as_ref().is_ok_and(|(hits, misses)| hits.len() == planned.touches.len() && *misses == 0);
            assert!(!all, "{control} {axis}: {found:?}");
        }
    }
}

#[test]
fn a_touch_that_misses_is_tried_again_and_a_ball_that_is_not_there_ends_the_program() {
    for (control, file, _) in CONTROLS {
        let planned = Planned::new(CHAINS[0], control, SPHERE, "    repeats: 2\n");
        let mut machine = planned.machine([0.02, -0.03, 0.01]);
        machine.blind = 1;
        let found = planned.measured(control, file, &mut machine);
        let (hits, misses) = found.unwrap_or_else(|error| panic!("{control}: {error}"));
        let tried_again = usize::from(control == "grbl");
        assert_eq!((hits.len() + tried_again, misses), (2 * planned.touches.len(), 1), "{control}");
        let mut machine = planned.with(Ball { centre: [90.0, 30.0, 60.0], radius: 12.5, stand: AWAY });
        let found = planned.measured(control, file, &mut machine);
        match control {
            "grbl" => assert!(found.is_err() || found.is_ok_and(|(hits, _)| hits.is_empty()), "{control}"),
            _ => assert!(found.expect_err(control).contains("alarm"), "{control}"),
        }
    }
}

/// Something that the plan does not know stops the program before the probe breaks.
#[test]
fn a_move_that_meets_something_ends_the_program() {
    for (control, file, _) in CONTROLS {
        let planned = Planned::new(CHAINS[0], control, SPHERE, "");
        let mut machine = planned.with(Ball { centre: [90.0, 30.0, 120.0], radius: 40.0, stand: AWAY });
        let found = planned.measured(control, file, &mut machine);
        let message = found.expect_err(control);
        let watched = message.starts_with("alarm") || message.contains("begins in contact");
        assert!(watched, "{control}: {message}");
    }
}

#[test]
fn what_cannot_be_reached_is_named_and_nothing_is_written() {
    let refused = |clearance: &str, more: &str| {
        let (folder, printed) = plan(CHAINS[0], "linuxcnc", clearance, more);
        assert_eq!(printed.status, 2, "{}", printed.stderr);
        assert!(!folder.path().join("plan").exists());
        printed.stderr.replace(['\n', '│'], " ").split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let message = refused(SPHERE, "    margin_mm: 14\n");
    assert!(message.contains("a distance below `approach_mm` was expected"), "{message}");
    let message = refused(SPHERE, "    overtravel_mm: 30\n");
    assert!(
        message.contains("touches cannot be reached")
            && message.contains("(feature 1): beyond the nominal contact the tip"),
        "{message}"
    );
    assert!(message.contains("solid 1 of `solids`"), "{message}");
    let message = refused("plane: { axis: Z, at_mm: 600 }", "");
    assert!(message.contains("Z would stand at 600 mm; it goes from -500 to 500"), "{message}");
    let message = refused("plane: { axis: Z, at_mm: 200 }", "");
    assert!(message.contains("beyond the plane of clearance"), "{message}");
    let message = refused("plane: { axis: Q, at_mm: 200 }", "");
    assert!(message.contains("no linear axis Q"), "{message}");
    let message = refused(SPHERE, "    log: \"a(b\"\n");
    assert!(message.contains("cannot stand in a program"), "{message}");
}

/// LinuxCNC's own interpreter reads the program, and its moves are those of the test's interpreter where nothing is touched.
#[test]
fn the_interpreter_of_linuxcnc_takes_the_programs() {
    if Command::new("rs274").arg("-g").arg("/dev/null").output().is_err() {
        skipped("the_interpreter_of_linuxcnc_takes_the_programs", "rs274 is not installed");
        return;
    }
    let planned = Planned::new(CHAINS[0], "linuxcnc", SPHERE, "    search_feed_mm_per_min: 200\n    misses: 1000\n");
    let file = planned.folder.path().join("plan/measure.ngc");
    let printed =
        Command::new("rs274").arg("-g").arg(&file).current_dir(planned.folder.path()).output().expect("rs274");
    let printed = String::from_utf8_lossy(&printed.stdout).into_owned();
    let misses = printed.matches(" H0\")").count();
    assert_eq!(misses, 2 * planned.touches.len(), "{printed}");
    assert!(printed.contains("LOG(\"END\")") && printed.contains("PROGRAM_END"), "{printed}");
    let probes: Vec<&str> = printed.lines().filter(|line| line.contains("STRAIGHT_PROBE")).collect();
    let last = planned.touches.len();
    assert!(probes.len() > 4 * last, "{} moves are watched", probes.len());
}
