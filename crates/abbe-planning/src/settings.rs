//! What a recipe says of measurements that are to be chosen.

use std::collections::BTreeMap;

use abbe_core::{AboveZero, Label, PathItem, Series, SettingsError, Whole, positive};
use abbe_measuring::Measuring;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The key `plan` of a recipe: which measurements to choose, and what makes a choice good.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Planning {
    /// The estimate that is planned. Its observations other than the candidates count as measured already.
    pub estimate: String,
    /// The artefact stage whose rows are the candidates.
    pub candidates: String,
    /// Makes candidates on a grid. Default: the candidates are the rows of the stage's data.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub generate: Option<Generation>,
    /// Column of labels: rows with the same label are measured together (an indexation). Default: every row is a
    /// candidate by itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
    /// Number of candidates to choose, including the required ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub number: Option<Whole<1, 10_000>>,
    /// Largest total time of the chosen candidates. The candidates need a column `duration_s`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget_s: Option<f64>,
    /// Largest duration of the measuring program (`program`): the sum of its moves at their feeds and of its times to settle. It takes
    /// the place of `number` or `budget_s`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub minutes: Option<f64>,
    /// How often each touch of the measuring program is made. Default: once, and what `repeats` of `program` says changes no
    /// uncertainty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<Repeating>,
    /// Choose the fewest candidates with which this is reached; `number`, `budget_s` and `minutes` are then the most that are allowed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<Until>,
    /// What makes a choice good.
    #[serde(default)]
    pub criterion: PlanningCriterion,
    /// Names or patterns of the unknowns that the criterion counts. Default: all unknowns.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parameters: Vec<String>,
    /// Whether a candidate may be measured more than once.
    #[serde(default)]
    pub replications: bool,
    /// Candidates that have to be in the plan: labels of `by`, else numbers of data rows (`beams:113` where the data
    /// come from several files). A candidate that is listed twice is measured twice.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub required: Vec<Label>,
    /// Candidates that must not be chosen.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub forbidden: Vec<Label>,
    /// In which order the chosen candidates are measured, against what follows the time. Default: no order.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub order: Option<Ordering>,
    /// Writes the program that measures the plan on the machine's control. Default: no program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<Measuring>,
    /// Number of random starts of the search.
    #[serde(default = "restarts")]
    pub restarts: Whole<1, 1_000>,
    /// Seed of the random starts.
    #[serde(default)]
    pub seed: u64,
}

/// How often a touch is made; its mean counts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Repeating {
    /// The part of the standard uncertainty of a row that is new at every touch: the noise of the probe. What stays the same while the
    /// machine stands (its own errors, the surface) is no part of it.
    pub noise_um: f64,
    /// How often. Default: as often as makes the best plan of these `minutes`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub times: Option<Whole<1, 99>>,
    /// The most that are tried.
    #[serde(default = "five_times")]
    pub most: Whole<1, 99>,
}

fn five_times() -> Whole<1, 99> {
    Whole::new(5)
}

impl Repeating {
    /// Standard uncertainty of the mean of so many touches, mm; that of a row is one of the recipe.
    pub(crate) fn of_mean(&self, row: f64, repeats: usize) -> f64 {
        let noise = self.noise_um * 1e-3;
        (row.powi(2) - noise.powi(2) * (1.0 - 1.0 / repeats as f64)).max(0.0).sqrt()
    }
}

/// A wanted uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Until {
    /// Largest expanded uncertainty of a length, from the noise of the rows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expanded_um: Option<f64>,
    /// Largest expanded uncertainty of an angle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expanded_urad: Option<f64>,
    /// Of what.
    #[serde(default)]
    pub of: Of,
    /// The coverage factor.
    #[serde(default = "twice")]
    pub coverage_factor: f64,
}

/// Of what an uncertainty is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Of {
    /// Of every unknown that counts (`parameters`) and is a length or an angle.
    #[default]
    Parameters,
    /// Of the tip along x, y and z at all candidates, by the errors that are estimated.
    Tool,
}

fn twice() -> f64 {
    2.0
}

impl Until {
    fn check(&self) -> Result<(), SettingsError> {
        if self.expanded_um.is_none() && (self.expanded_urad.is_none() || self.of == Of::Tool) {
            return Err(SettingsError::new("expanded_um", "how large it may be is missing"));
        }
        if self.of == Of::Tool && self.expanded_urad.is_some() {
            return Err(SettingsError::new(
                "expanded_urad",
                "the tip has a place and no angle: `expanded_um` limits it",
            ));
        }
        let limits = [("expanded_um", self.expanded_um), ("expanded_urad", self.expanded_urad)];
        limits
            .into_iter()
            .try_for_each(|(name, limit)| limit.map_or(Ok(()), |limit| positive(name, limit).map(drop)))?;
        match (1.0..=10.0).contains(&self.coverage_factor) {
            true => Ok(()),
            false => Err(SettingsError::new("coverage_factor", "a number from 1 to 10 was expected")),
        }
    }
}

/// The order of the chosen candidates in which what follows the time (drifts, thermal states) disturbs the estimate least.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Ordering {
    /// Time that a row takes, where the candidates have no column `duration_s`.
    #[serde(default = "half_a_minute")]
    pub duration_s: f64,
    /// When the first one begins, on the clock of the data.
    #[serde(default)]
    pub start_s: f64,
    /// Candidates that are measured again and again; the order says when.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub references: Vec<Label>,
    /// How often each of these is measured.
    #[serde(default = "thrice")]
    pub times: Whole<1, 1_000>,
    /// When each of these has to be measured again, so that what has moved since is known well enough. Default: not said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub again: Option<Again>,
}

/// How well what has moved since a reference was measured has to be known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Again {
    /// Largest standard uncertainty of what has moved.
    #[schemars(with = "AboveZero")]
    pub standard_uncertainty_um: f64,
    /// Until when this is wanted, on the clock of the data. Default: the end of the plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
    /// What is unknown of what follows the time. Default: what the planned measurements leave open.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub changes: Vec<Change>,
}

/// Parameters that may have any value of this size.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Change {
    /// Names or patterns: `dzt[t*]`, `EA0B[T_column:1]`.
    pub parameters: Vec<String>,
    /// Standard uncertainty of each, in its unit in memory (mm, rad, mm/K).
    #[schemars(with = "AboveZero")]
    pub standard_uncertainty: f64,
}

impl Again {
    fn check(&self) -> Result<(), SettingsError> {
        positive("standard_uncertainty_um", self.standard_uncertainty_um)?;
        for (line, change) in self.changes.iter().enumerate() {
            let at = [PathItem::Key("changes".to_owned()), PathItem::Index(line)];
            positive("standard_uncertainty", change.standard_uncertainty).map_err(|error| error.under(at))?;
        }
        match self.until_s.filter(|until| !until.is_finite()) {
            None => Ok(()),
            Some(_) => Err(SettingsError::new("until_s", "a finite number was expected")),
        }
    }
}

fn half_a_minute() -> f64 {
    30.0
}

fn thrice() -> Whole<1, 1_000> {
    Whole::new(3)
}

impl Ordering {
    fn check(&self) -> Result<(), SettingsError> {
        positive("duration_s", self.duration_s)?;
        if !self.start_s.is_finite() {
            return Err(SettingsError::new("start_s", "a finite number was expected"));
        }
        if let Some(again) = &self.again {
            again.check().map_err(|error| error.under([PathItem::Key("again".to_owned())]))?;
            if self.references.is_empty() {
                return Err(SettingsError::new("references", "which candidates are measured again is missing"));
            }
        }
        let twice =
            (1..self.references.len()).find(|&index| self.references[..index].contains(&self.references[index]));
        match twice {
            Some(index) => Err(SettingsError::new("", format!("{} stands here twice", self.references[index].0))
                .under([PathItem::Key("references".to_owned()), PathItem::Index(index)])),
            None => Ok(()),
        }
    }
}

/// Candidates on a grid: where the nominal machine can measure the artefact.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Generation {
    /// Positions of rotary axes, in degrees; every combination is an indexation, with a label of its own in the column `group`,
    /// and where the machine's model has a backlash of the axis, so is every direction from which it comes there.
    /// Axes that are not named stand at zero.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub indexations_deg: BTreeMap<String, Series>,
    /// Features are touched only where the direction away from their surface is off the direction from the tip into the spindle by
    /// no more than this, in degrees.
    #[serde(default = "reach")]
    pub reach_deg: f64,
    /// Lengths between two poses on a grid; without them the features of the artefact are measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lengths: Option<GeneratedLengths>,
    /// Interpolation tests: rotary axes turn, and the linear axes keep the tip at a point of the table.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub interpolations: Vec<Interpolation>,
    /// Columns that have the same number in every row, by their name with its unit: `reading_mm`, which nobody has read yet.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub columns: BTreeMap<String, f64>,
    /// Time that a row takes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
}

/// Places and directions of lengths, in the table frame: every combination whose ends the axes reach.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GeneratedLengths {
    /// The lengths.
    pub lengths_mm: Series,
    /// Positions of the first end.
    pub x_mm: Series,
    /// Positions of the first end.
    pub y_mm: Series,
    /// Positions of the first end.
    pub z_mm: Series,
    /// Direction to the other end in the plane of x and y, in degrees from x.
    #[serde(default = "along_x")]
    pub azimuth_deg: Series,
    /// Its angle to that plane, in degrees.
    #[serde(default = "along_x")]
    pub elevation_deg: Series,
}

/// A test in which rotary axes turn together while the linear axes follow a ball on the table, in the manner of ISO 10791-6.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Interpolation {
    /// What the test is called, in the column `test` of its rows.
    pub test: String,
    /// The ball that the tip follows, by its label in the nominal file; in the column `ball` of the rows.
    pub ball: String,
    /// The tip beside the centre of the ball, in directions that turn with the table: nothing for sensors and probes that centre
    /// themselves; the bar from the ball to the tip for a ball bar, along, across or on the way out from an axis.
    #[serde(default)]
    pub beside_mm: [f64; 3],
    /// Positions of rotary axes in degrees, in the order of the way up: as many for each axis that turns, one for an axis that
    /// stands. Axes that are not named stand at zero.
    pub turns_deg: BTreeMap<String, Series>,
    /// Whether the way is measured back, too.
    #[serde(default = "yes")]
    pub both_ways: bool,
}

fn yes() -> bool {
    true
}

impl Interpolation {
    fn check(&self) -> Result<(), SettingsError> {
        let is_plain = |text: &str| !text.is_empty() && !text.contains([',', '"', '\n', '\r']);
        for (name, text) in [("test", &self.test), ("ball", &self.ball)] {
            if !is_plain(text) {
                return Err(SettingsError::new(name, "a text without commas and quotation marks was expected"));
            }
        }
        if self.beside_mm.iter().any(|value| !value.is_finite()) {
            return Err(SettingsError::new("beside_mm", "finite numbers were expected"));
        }
        let under = |axis: &str| [PathItem::Key("turns_deg".to_owned()), PathItem::Key(axis.to_owned())];
        let mut longest = 1;
        for (axis, positions) in &self.turns_deg {
            let count = positions.values().map_err(|error| error.under(under(axis)))?.len();
            if count > 1 && longest > 1 && count != longest {
                let message =
                    format!("{count} positions; {longest} were expected, as many as of the other axis that turns");
                return Err(SettingsError::new("", message).under(under(axis)));
            }
            longest = longest.max(count);
        }
        match longest {
            0 | 1 => Err(SettingsError::new("turns_deg", "an axis with two positions or more was expected")),
            _ => Ok(()),
        }
    }
}

fn reach() -> f64 {
    // The side of a facet or ball that a stylus passes without touching with its shank.
    90.0
}

fn along_x() -> Series {
    Series::Listed(vec![0.0])
}

impl Generation {
    fn check(&self) -> Result<(), SettingsError> {
        let series = |name: &str, series: &Series| match series.values() {
            Ok(values) if values.is_empty() => Err(SettingsError::new(name, "at least one number was expected")),
            Ok(_) => Ok(()),
            Err(error) => Err(error.under([PathItem::Key(name.to_owned())])),
        };
        for (axis, positions) in &self.indexations_deg {
            let under = |error: SettingsError| error.under([PathItem::Key("indexations_deg".to_owned())]);
            series(axis, positions).map_err(under)?;
        }
        if !(self.reach_deg > 0.0 && self.reach_deg <= 180.0) {
            return Err(SettingsError::new("reach_deg", "an angle above 0 and up to 180 degrees was expected"));
        }
        if let Some(duration) = self.duration_s {
            positive("duration_s", duration)?;
        }
        let plain = |name: &String| name.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_');
        for (name, value) in &self.columns {
            let under = |error: SettingsError| error.under([PathItem::Key("columns".to_owned())]);
            if name.is_empty() || !plain(name) {
                return Err(under(SettingsError::new(name, "a name of letters, digits and `_` was expected")));
            }
            if !value.is_finite() {
                return Err(under(SettingsError::new(name, "a finite number was expected")));
            }
        }
        for (place, test) in self.interpolations.iter().enumerate() {
            let at = [PathItem::Key("interpolations".to_owned()), PathItem::Index(place)];
            test.check().map_err(|error| error.under(at))?;
        }
        if !self.interpolations.is_empty() && (self.lengths.is_some() || !self.indexations_deg.is_empty()) {
            let message = "`interpolations` have their own positions: leave `indexations_deg` and `lengths` out";
            return Err(SettingsError::new("interpolations", message));
        }
        let Some(lengths) = &self.lengths else { return Ok(()) };
        let all = [
            ("lengths_mm", &lengths.lengths_mm),
            ("x_mm", &lengths.x_mm),
            ("y_mm", &lengths.y_mm),
            ("z_mm", &lengths.z_mm),
            ("azimuth_deg", &lengths.azimuth_deg),
            ("elevation_deg", &lengths.elevation_deg),
        ];
        let under = |error: SettingsError| error.under([PathItem::Key("lengths".to_owned())]);
        all.into_iter().try_for_each(|(name, values)| series(name, values).map_err(under))?;
        let shortest = lengths.lengths_mm.values().map(|lengths| lengths[0]);
        positive("lengths_mm", shortest.unwrap_or_default()).map_err(under).map(drop)
    }
}

/// What makes a choice of measurements good (Soons 1993, section 4.2; Rahman 2016, Table 8-4).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub enum PlanningCriterion {
    /// Largest determinant of the information: smallest ellipsoid of all estimates together.
    #[default]
    D,
    /// Smallest mean variance of the estimates, each in units of its effect on the candidates.
    A,
    /// Smallest variance of the combination that is determined worst, in the same units.
    E,
    /// Smallest of the largest variances of what the candidates would measure.
    G,
    /// Smallest condition number of the equations with columns of norm 1.
    #[serde(rename = "condition")]
    Condition,
}

fn restarts() -> Whole<1, 1_000> {
    Whole::new(20)
}

impl Planning {
    /// How often each touch is made, by what is stated of it.
    pub(crate) fn stated_repeats(&self) -> usize {
        let of_program = self.program.as_ref().map_or(1, |program| program.repeats.get());
        self.repeats.as_ref().map_or(of_program, |repeats| repeats.times.map_or(1, Whole::get))
    }

    fn check_time(&self) -> Result<(), SettingsError> {
        if let Some(minutes) = self.minutes {
            positive("minutes", minutes)?;
            if self.budget_s.is_some() {
                return Err(SettingsError::new("minutes", "`budget_s` stands beside it; one of the two was expected"));
            }
        }
        if self.program.is_none() {
            let needs = [("minutes", self.minutes.is_some()), ("repeats", self.repeats.is_some())];
            if let Some((name, _)) = needs.into_iter().find(|(_, stated)| *stated) {
                let error = SettingsError::new(name, "what a touch takes follows from `program`, which is missing");
                return Err(error.help("add `program: { control: .., probe: [..], clearance: .. }` to `plan`"));
            }
        }
        let Some(repeats) = &self.repeats else { return Ok(()) };
        let under = |error: SettingsError| error.under([PathItem::Key("repeats".to_owned())]);
        positive("noise_um", repeats.noise_um).map_err(under)?;
        if repeats.times.is_none() && self.minutes.is_none() {
            let error = SettingsError::new("times", "how often a touch is made is missing");
            return Err(under(error.help("without `minutes` more is always better: state `times`")));
        }
        if self.program.as_ref().is_some_and(|program| program.repeats.get() > 1) {
            let error = SettingsError::new("", "`repeats` stands in `program`, too; one of the two was expected");
            return Err(under(error));
        }
        Ok(())
    }

    /// Refuses settings that are wrong whatever the data.
    pub fn check(&self) -> Result<(), SettingsError> {
        if self.number.is_none() && self.budget_s.is_none() && self.minutes.is_none() && self.until.is_none() {
            let message = "`number`, `budget_s`, `minutes` or `until` is missing: how many may be measured?";
            return Err(SettingsError::new("", message));
        }
        self.check_time()?;
        if let Some(until) = &self.until {
            until.check().map_err(|error| error.under([PathItem::Key("until".to_owned())]))?;
        }
        if let Some(budget) = self.budget_s {
            positive("budget_s", budget)?;
        }
        if let Some(generate) = &self.generate {
            generate.check().map_err(|error| error.under([PathItem::Key("generate".to_owned())]))?;
        }
        if let Some(order) = &self.order {
            order.check().map_err(|error| error.under([PathItem::Key("order".to_owned())]))?;
        }
        if let Some(program) = &self.program {
            program.check().map_err(|error| error.under([PathItem::Key("program".to_owned())]))?;
        }
        let both = self.required.iter().position(|required| self.forbidden.contains(required));
        match both {
            Some(index) => Err(SettingsError::new("", format!("{} is forbidden, too", self.required[index].0))
                .under([PathItem::Key("required".to_owned()), PathItem::Index(index)])),
            None => Ok(()),
        }
    }
}
