//! What a user says of a measuring program: probe, clearance, feeds, what stands on the table, and what the control needs.

use std::collections::BTreeMap;

use abbe_core::{PathItem, SettingsError, Whole, not_negative, positive};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::solid::Solid;

/// The program that measures a plan with a touch probe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Measuring {
    /// The control that runs the program.
    pub control: Control,
    /// The probe from the tip ball to the spindle: cylinders one after the other on the line of the spindle. The tip ball itself has
    /// the stylus radius of the machine.
    pub probe: Vec<Section>,
    /// Where nothing is in the way, so that axes may go from one touch to the next.
    pub clearance: Clearance,
    /// What stands on the table beside the artefact: holder, clamps, the table itself; table frame. Faces that are touched may lie on
    /// one of them, as the faces of the table do: where a touch is made on its surface, and it lies behind the plane of contact, the
    /// tip may meet it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub solids: Vec<Solid>,
    /// What facets look like to the probe; balls are found from their touches.
    #[serde(default)]
    pub facets: FacetSize,
    /// Smallest distance between the probe and anything else.
    #[serde(default = "one")]
    pub margin_mm: f64,
    /// Distance of the tip from its nominal contact at which a touch begins.
    #[serde(default = "five")]
    pub approach_mm: f64,
    /// Distance beyond the nominal contact at which a touch gives up.
    #[serde(default = "three")]
    pub overtravel_mm: f64,
    /// Feed of all touches that count. One feed for all: the delay of the probe is then the same everywhere.
    #[serde(default = "thirty")]
    pub measuring_feed_mm_per_min: f64,
    /// Feed of a first touch, which only finds the surface. Default: there is none, touches are slow from the beginning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub search_feed_mm_per_min: Option<f64>,
    /// Distance by which the tip goes back after the first touch, before it touches slowly.
    #[serde(default = "half")]
    pub back_off_mm: f64,
    /// Feed of all other moves of linear axes. They stop where the probe triggers.
    #[serde(default = "thousand")]
    pub positioning_feed_mm_per_min: f64,
    /// Rapid traverse of linear axes, in which Heidenhain's touch probe cycle goes back; no other control needs it. It changes no
    /// program, only the time that it is said to take.
    #[serde(default = "ten_thousand")]
    pub rapid_feed_mm_per_min: f64,
    /// Feed of moves of rotary axes; of several that move together, of the root of the sum of their squares.
    #[serde(default = "thousand")]
    pub rotary_feed_deg_per_min: f64,
    /// Time that the program waits after rotary axes have moved, before it goes on.
    #[serde(default)]
    pub settle_s: f64,
    /// The unit of lengths to which the control is set; positions and feeds of program and log have it.
    #[serde(default)]
    pub units: Units,
    /// How often each touch is made.
    #[serde(default = "once")]
    pub repeats: Whole<1, 99>,
    /// How often a touch that missed is tried again.
    #[serde(default = "retries")]
    pub retries: Whole<0, 9>,
    /// So many misses of different touches one after the other end the program: then the artefact is not where the plan has it.
    #[serde(default = "misses")]
    pub misses: Whole<1, 1000>,
    /// The order of touches. Default: as planned where the plan has times, otherwise the shortest way.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub order: Option<TouchOrder>,
    /// What happens to touches that cannot be reached.
    #[serde(default)]
    pub unreachable: Unreachable,
    /// Where the program waits for the operator. Default: only at its beginning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pause: Option<Pause>,
    /// Distance beside its position to which a linear axis goes first, where the plan has the side from which it comes (`dir_X`).
    #[serde(default = "two")]
    pub overshoot_mm: f64,
    /// The same for rotary axes.
    #[serde(default = "two")]
    pub overshoot_deg: f64,
    /// Orientation of the spindle. Default: the program does not orient it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spindle_deg: Option<f64>,
    /// Writes a second program for the first time, the same moves this much higher (towards the spindle) and without contact. 0 writes
    /// none.
    #[serde(default = "fifty")]
    pub dry_run_mm: f64,
    /// A work offset of the control that is zero in all axes, so that positions are those of the machine. Default: the last one that
    /// the control has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work_offset: Option<String>,
    /// The value of the control that is a temperature in °C, as the control writes it. Default: no temperatures in the log.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature: Option<String>,
    /// The value of the control that is its clock in seconds, as the control writes it. Default: its own clock, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clock: Option<String>,
    /// File name of the log on the control. Default: the usual one of the control.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log: Option<String>,
    /// Names of axes on the control, one letter each, where they differ from those of the machine: `{ C1: C }`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub axis_names: BTreeMap<String, String>,
}

/// Fastest touch, mm/min, that probes of machine tools are made for.
const FASTEST: f64 = 3000.0;

/// Controls that measuring programs are written for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Control {
    /// LinuxCNC: G38.3, `(LOG,...)`.
    Linuxcnc,
    /// Fanuc and Haas: G31, Custom Macro B, DPRNT.
    Fanuc,
    /// Siemens SINUMERIK: MEAS, $AA_MM, WRITE.
    Siemens,
    /// Heidenhain TNC: TCH PROBE 4, FN 16.
    Heidenhain,
    /// grbl and its relatives: G38.3, the host keeps the answers.
    Grbl,
}

/// The unit of lengths of a program and of its log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Units {
    /// Millimetres, mm/min.
    #[default]
    Mm,
    /// Inches, inches per minute.
    Inch,
}

impl Control {
    /// All of them, with their names.
    pub const ALL: [(&'static str, Self); 5] = [
        ("linuxcnc", Self::Linuxcnc),
        ("fanuc", Self::Fanuc),
        ("siemens", Self::Siemens),
        ("heidenhain", Self::Heidenhain),
        ("grbl", Self::Grbl),
    ];
}

/// A cylindrical section of the probe.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Section {
    /// Its diameter.
    pub diameter_mm: f64,
    /// Its length; that of the first section counts from the centre of the tip ball.
    pub length_mm: f64,
}

/// Where nothing is in the way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Clearance {
    /// A position of one linear axis: from there everything is clear, however the rotary axes stand.
    Plane {
        /// The linear axis that retracts.
        axis: String,
        /// Its machine position when it has.
        at_mm: f64,
    },
    /// A sphere in the table frame, around all that stands there. The probe retracts along its own line until its tip is outside.
    Sphere {
        /// Its centre.
        centre_mm: [f64; 3],
        /// Its radius.
        radius_mm: f64,
    },
}

/// The solid that a facet counts as: a disc around the touched point, behind the surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FacetSize {
    /// Radius of the disc.
    #[serde(default = "five")]
    pub radius_mm: f64,
    /// Thickness of the disc, into the material.
    #[serde(default = "five")]
    pub thickness_mm: f64,
}

impl Default for FacetSize {
    fn default() -> Self {
        Self { radius_mm: five(), thickness_mm: five() }
    }
}

/// In which order a program touches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TouchOrder {
    /// As the plan has it, which may be meant against drift.
    Planned,
    /// All touches of one position of the rotary axes together, and short ways. Touches keep their numbers.
    Shortest,
}

/// What happens to touches that cannot be reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Unreachable {
    /// Nothing is written, and they are named with the reasons.
    #[default]
    Refuse,
    /// They are left out, and comments of the program name them.
    LeaveOut,
}

/// Where the program waits.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Pause {
    /// After so many touches.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub touches: Option<Whole<1, 100_000>>,
    /// Before rotary axes move.
    #[serde(default)]
    pub at_swings: bool,
}

fn half() -> f64 {
    0.5
}

fn one() -> f64 {
    1.0
}

fn two() -> f64 {
    2.0
}

fn three() -> f64 {
    3.0
}

fn five() -> f64 {
    5.0
}

fn thirty() -> f64 {
    30.0
}

fn fifty() -> f64 {
    50.0
}

fn thousand() -> f64 {
    1000.0
}

fn ten_thousand() -> f64 {
    10_000.0
}

fn once() -> Whole<1, 99> {
    Whole::new(1)
}

fn retries() -> Whole<0, 9> {
    Whole::new(1)
}

fn misses() -> Whole<1, 1000> {
    Whole::new(3)
}

impl Measuring {
    /// Refuses settings that are wrong whatever the plan.
    pub fn check(&self) -> Result<(), SettingsError> {
        if self.probe.is_empty() {
            let error = SettingsError::new("probe", "at least one section was expected");
            return Err(error.help("`probe: [{ diameter_mm: 4, length_mm: 50 }, { diameter_mm: 60, length_mm: 100 }]`"));
        }
        for (index, section) in self.probe.iter().enumerate() {
            let at = |error: SettingsError| error.under([PathItem::Key("probe".to_owned()), PathItem::Index(index)]);
            positive("diameter_mm", section.diameter_mm).map_err(at)?;
            positive("length_mm", section.length_mm).map_err(at)?;
        }
        for (index, solid) in self.solids.iter().enumerate() {
            if let Some(fault) = solid.fault() {
                let at = [PathItem::Key("solids".to_owned()), PathItem::Index(index)];
                return Err(SettingsError::new("", fault).under(at));
            }
        }
        let under = |key: &str, error: SettingsError| error.under([PathItem::Key(key.to_owned())]);
        positive("radius_mm", self.facets.radius_mm).map_err(|error| under("facets", error))?;
        positive("thickness_mm", self.facets.thickness_mm).map_err(|error| under("facets", error))?;
        match &self.clearance {
            Clearance::Plane { at_mm, .. } if !at_mm.is_finite() => {
                return Err(under("clearance", SettingsError::new("plane", "a finite position was expected")));
            }
            Clearance::Sphere { radius_mm, .. } => {
                positive("radius_mm", *radius_mm).map_err(|error| under("clearance", under("sphere", error)))?;
            }
            Clearance::Plane { .. } => {}
        }
        for (name, value) in [
            ("approach_mm", self.approach_mm),
            ("overtravel_mm", self.overtravel_mm),
            ("back_off_mm", self.back_off_mm),
            ("measuring_feed_mm_per_min", self.measuring_feed_mm_per_min),
            ("positioning_feed_mm_per_min", self.positioning_feed_mm_per_min),
            ("rotary_feed_deg_per_min", self.rotary_feed_deg_per_min),
            ("rapid_feed_mm_per_min", self.rapid_feed_mm_per_min),
        ] {
            positive(name, value)?;
        }
        if let Some(feed) = self.search_feed_mm_per_min {
            positive("search_feed_mm_per_min", feed)?;
            if self.measuring_feed_mm_per_min > feed {
                let message = format!("a feed of at most the {feed} mm/min of `search_feed_mm_per_min` was expected");
                return Err(SettingsError::new("measuring_feed_mm_per_min", message)
                    .help("the search finds the surface fast, the touch that counts is slower"));
            }
        }
        if self.measuring_feed_mm_per_min > FASTEST {
            let message =
                format!("a feed of at most {FASTEST} mm/min was expected: a probe that touches faster may break");
            return Err(SettingsError::new("measuring_feed_mm_per_min", message).help("is it in mm/min?"));
        }
        if self.back_off_mm >= self.approach_mm {
            return Err(SettingsError::new("back_off_mm", "a distance below `approach_mm` was expected"));
        }
        not_negative("margin_mm", self.margin_mm)?;
        if self.margin_mm >= self.approach_mm {
            return Err(SettingsError::new("margin_mm", "a distance below `approach_mm` was expected"));
        }
        not_negative("dry_run_mm", self.dry_run_mm)?;
        not_negative("settle_s", self.settle_s)?;
        not_negative("overshoot_mm", self.overshoot_mm)?;
        not_negative("overshoot_deg", self.overshoot_deg)?;
        self.check_words()
    }

    /// Refuses texts that would become anything but a word of a program.
    fn check_words(&self) -> Result<(), SettingsError> {
        let words = [
            ("work_offset", &self.work_offset, ".", "G59.3"),
            ("temperature", &self.temperature, "#$_.:<>[]-+*/", "#<_hal[probe.temperature]>"),
            ("clock", &self.clock, "#$_.:<>[]-+*/", "#<_hal[motion.clock]>"),
            ("log", &self.log, "_.-/:", "probe.log"),
        ];
        for (name, text, signs, example) in words {
            let Some(text) = text else { continue };
            let allowed = |letter: char| letter.is_ascii_alphanumeric() || signs.contains(letter);
            if text.is_empty() || text.len() > 80 || !text.chars().all(allowed) {
                let message = format!("`{text}` cannot stand in a program; `{example}` could");
                return Err(SettingsError::new(name, message));
            }
        }
        for (name, letter) in &self.axis_names {
            if !(letter.len() == 1 && AXIS_LETTERS.contains(letter.as_str())) {
                let message = format!("`{letter}` is no name of an axis on a control; the letters are {AXIS_LETTERS}");
                return Err(SettingsError::new(name, message).under([PathItem::Key("axis_names".to_owned())]));
            }
        }
        if let Some(angle) = self.spindle_deg.filter(|angle| !(-360.0..=360.0).contains(angle)) {
            return Err(SettingsError::new("spindle_deg", format!("{angle}: an angle within a turn was expected")));
        }
        Ok(())
    }
}

/// Letters that controls, and the log, know as axes.
pub const AXIS_LETTERS: &str = "XYZABCUVW";
