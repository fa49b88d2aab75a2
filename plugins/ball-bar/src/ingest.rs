//! Ingest plugin `ball-bar`: the tests of a ball bar as one data set.
//!
//! Every test is a file in which one rotary axis moves. The data set has the columns of the files, `test` (the name of the
//! test), and what the settings say of each test: ball, bar, positions of axes that stand still, and the angle of the moving axis where
//! the file has samples by time only. Samples of the overshoot are left out. Within a cycle rows come in the order of the angle, so that
//! sweeps in both directions measure the same rows.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use abbe_core::{
    Column, ColumnHeader, Context, DataRow, Dataset, Error, Ingest, InputFile, Label, PathItem, Quantity, Result,
    RowOrigin, SettingsError, StatedTip, Values, positive,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

/// Ball bar tests.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Settings {
    /// The tests, one file each.
    tests: Vec<Test>,
}

/// A ball bar test in which one rotary axis moves.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Test {
    /// The CSV file with the samples, relative to the recipe.
    file: String,
    /// Name of the test in the column `test`; without it the name of the file without its extension.
    #[serde(default)]
    name: Option<String>,
    /// Name of the rotary axis that moves.
    moves: String,
    /// Label of the pivot ball, for files without the column `ball`.
    #[serde(default)]
    ball: Option<Label>,
    /// Label of the bar, for files without the column `bar`.
    #[serde(default)]
    bar: Option<Label>,
    /// Positions of axes for which the file has no column: `X_mm: 130`.
    #[serde(default)]
    positions: BTreeMap<String, f64>,
    /// Range of the moving axis; samples outside it (overshoot) are left out.
    #[serde(default)]
    range_deg: Option<[f64; 2]>,
    /// The motion, for files whose samples have a time but no angle.
    #[serde(default)]
    feed: Option<Feed>,
}

/// A motion with constant feed: the angle follows from the time since the first sample of its cycle.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Feed {
    /// Feed on the circle.
    mm_per_min: f64,
    /// Radius of that circle: distance of the pivot from the axis.
    radius_mm: f64,
    /// Angle of the axis at the first sample of the first cycle.
    from_deg: f64,
    /// Angle at which it stops; the samples may end earlier.
    to_deg: f64,
    /// Every second cycle runs back, from `to_deg` to `from_deg`.
    #[serde(default)]
    alternating: bool,
}

/// What the limits of a range may be missed by, rad: rounding of a file with four decimals of a degree.
const AT_LIMIT: f64 = 1e-6;

/// An axis that moves less than this, rad, stands still: rounding of a file with three decimals of a degree.
const STILL: f64 = 2e-5;

/// Part of the sweep of the axis that moves by which another one may follow its command badly.
const OF_MOVER: f64 = 1e-3;

/// Part of its range by which a test overshoots at most at both ends together; of a longer one the range is a part that was chosen.
const OVERSHOOT: f64 = 0.3;

/// Distance between the middle of a test and that of its range that is told, rad: 0.2 degrees, or a step from sample to
/// sample where that is more. The angles to start and to stop in are alike.
const BESIDE: f64 = 3.5e-3;

/// Part of the stated range that a test has to cover: one of which the axis counts the other way round covers less.
const COVERED: f64 = 0.5;

abbe_core::register!(
    Ingest,
    "ball-bar",
    "tests of a double ball bar, by angle or by time and feed, without overshoot",
    Settings,
    example,
    build,
    "../reference/ingest-ball-bar.md",
);

fn example() -> Value {
    json!({ "tests": [
        { "file": "ballbar-a.csv", "moves": "A", "ball": 1, "bar": 100, "range_deg": [-20, 70] },
        { "file": "ballbar-c.csv", "moves": "C", "ball": 2, "bar": 100, "range_deg": [0, 360],
          "positions": { "X_mm": 0, "Y_mm": 0, "Z_mm": 160, "A_deg": 0 },
          "feed": { "mm_per_min": 500, "radius_mm": 100, "from_deg": -45, "to_deg": 405 } },
    ] })
}

pub(crate) fn build(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    if settings.tests.is_empty() {
        return Err(SettingsError::new("tests", "at least one test was expected"));
    }
    let mut tests: Vec<Named> = Vec::new();
    for (index, test) in settings.tests.into_iter().enumerate() {
        let under = |error: SettingsError| error.under([PathItem::Key("tests".to_owned()), PathItem::Index(index)]);
        let named = Named::new(test, index, context).map_err(under)?;
        if tests.iter().any(|other| other.name == named.name) {
            let error = SettingsError::new("name", format!("there is a test `{}` already", named.name));
            return Err(under(error.help("give one of them another `name`")));
        }
        tests.push(named);
    }
    Ok(Box::new(Tests { tests }))
}

/// A test with its name and path.
struct Named {
    name: String,
    path: PathBuf,
    index: usize,
    test: Test,
}

impl Named {
    fn new(test: Test, index: usize, context: &Context) -> Result<Self, SettingsError> {
        let path = context.path(&test.file);
        let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let name = test.name.clone().or(stem).unwrap_or_default();
        if let Some([from, to]) = test.range_deg
            && from >= to
        {
            return Err(
                SettingsError::new("range_deg", format!("{from} to {to} is no range")).help("write `[from, to]`")
            );
        }
        for header in test.positions.keys() {
            let column = ColumnHeader::parse(header);
            if ![Quantity::Length, Quantity::Angle].contains(&column.quantity) {
                let error = SettingsError::new(header, "the position of an axis has a unit: `X_mm` or `A_deg`");
                return Err(error.under([PathItem::Key("positions".to_owned())]));
            }
        }
        if let Some(feed) = &test.feed {
            let under = |error: SettingsError| error.under([PathItem::Key("feed".to_owned())]);
            positive("mm_per_min", feed.mm_per_min).map_err(under)?;
            positive("radius_mm", feed.radius_mm).map_err(under)?;
            if feed.from_deg == feed.to_deg {
                return Err(under(SettingsError::new(
                    "to_deg",
                    "the axis does not move between `from_deg` and `to_deg`",
                )));
            }
        }
        Ok(Self { name, path, index, test })
    }

    /// An error at a setting of this test.
    fn wrong(&self, setting: &str, error: Error) -> Error {
        let setting =
            [PathItem::Key("tests".to_owned()), PathItem::Index(self.index), PathItem::Key(setting.to_owned())];
        Error { setting: setting.into(), ..error }
    }

    /// The samples of the test, from its file as read.
    fn samples(&self, mut data: Dataset) -> Result<Dataset> {
        let rows = data.rows();
        for (header, value) in &self.test.positions {
            let column = ColumnHeader::parse(header);
            if data.column(&column.name).is_some() {
                let error = Error::usage(format!("`{}` has a column `{header}` already", self.path.display()));
                return Err(self.wrong("positions", error));
            }
            let (.., factor) = Quantity::of_column(header);
            data.columns.push(Column { header: column, values: Values::Numbers(vec![value * factor; rows]) });
        }
        if let Some(feed) = &self.test.feed {
            if data.column(&self.test.moves).is_some() {
                let message = format!(
                    "`{}` has a column for {}: its samples need no `feed`",
                    self.path.display(),
                    self.test.moves
                );
                return Err(self.wrong("feed", Error::usage(message)));
            }
            let header = ColumnHeader::parse(&format!("{}_deg", self.test.moves));
            let angles = Values::Numbers(feed.angles(&data)?);
            data.columns.push(Column { header, values: angles });
        }
        for (name, label) in [("ball", &self.test.ball), ("bar", &self.test.bar)] {
            let Some(Label(label)) = label else { continue };
            if data.column(name).is_some() {
                let error = Error::usage(format!("`{}` has a column `{name}` already", self.path.display()));
                return Err(self.wrong(name, error));
            }
            data.columns
                .push(Column { header: ColumnHeader::parse(name), values: Values::Labels(vec![label.into(); rows]) });
        }
        if data.column("test").is_some() {
            let error = Error::usage("there is a column `test`, which is the name of the test in the data set");
            return Err(error.in_file(&self.path));
        }
        let names = Values::Labels(vec![self.name.as_str().into(); rows]);
        data.columns.push(Column { header: ColumnHeader::parse("test"), values: names });
        self.swept(data)
    }

    /// Refuses commands that contradict `moves`: the axis stands still, or another rotary axis moves as well.
    fn only_mover(&self, data: &Dataset, angles: &[f64]) -> Result<()> {
        let own = sweep(angles);
        let rotary = |column: &&Column| {
            let name = column.header.name.trim_end_matches(|c: char| c.is_ascii_digit());
            column.header.quantity == Quantity::Angle && ["A", "B", "C"].contains(&name)
        };
        let others = data.columns.iter().filter(rotary).filter(|column| column.header.name != self.test.moves);
        let moving = others.filter_map(|column| match &column.values {
            Values::Numbers(angles) => Some((&column.header.name, sweep(angles))),
            Values::Labels(_) => None,
        });
        let other = moving.max_by(|(_, one), (_, other)| one.total_cmp(other)).filter(|(_, sweep)| *sweep > STILL);
        let name = &self.test.moves;
        let message = match other {
            Some((other, sweep)) if own <= STILL => {
                format!(
                    "stands still in `{}`, and {other} moves over {:.3} deg",
                    self.path.display(),
                    sweep.to_degrees()
                )
            }
            Some((other, sweep)) if sweep > STILL + OF_MOVER * own => {
                format!(
                    "is not the only one that moves in `{}`: {other} does, over {:.3} deg",
                    self.path.display(),
                    sweep.to_degrees()
                )
            }
            None if own <= STILL && data.rows() > 1 => format!("stands still in `{}`", self.path.display()),
            _ => return Ok(()),
        };
        Err(self.wrong(
            "moves",
            Error::data(format!("{name} {message}")).help("one rotary axis moves in a test; name that one"),
        ))
    }

    /// Tells a test that starts and stops otherwise than its range lets expect: all of its angles are off.
    fn tell_beside(&self, angles: &[f64], range: [f64; 2]) {
        let [from, to] = ends(angles);
        let width = range[1] - range[0];
        let beside = 0.5 * (from + to - range[0] - range[1]);
        let overshoot = to - from - width;
        if width.is_finite() && overshoot <= OVERSHOOT * width && beside.abs() > BESIDE.max(usual_step(angles)) {
            let [from, to, beside] = [from, to, beside].map(f64::to_degrees);
            tracing::warn!(
                "{}: {} goes from {from:.3} to {to:.3} deg, and the middle of its range is {:.3} deg away from that of this test: is its \
                 zero right?",
                self.path.display(),
                self.test.moves,
                beside.abs()
            );
        }
    }

    /// The rows within the range, those of a cycle in the order of the angle.
    fn swept(&self, data: Dataset) -> Result<Dataset> {
        let angles = abbe_table::numbers(&data, &self.test.moves, Quantity::Angle).map_err(|error| {
            let help = error.help.clone().unwrap_or_else(|| "samples by time need a `feed`".to_owned());
            self.wrong("moves", error.help(help))
        })?;
        self.only_mover(&data, angles)?;
        let [from, to] = self.test.range_deg.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]).map(f64::to_radians);
        let within = |row: &DataRow| (from - AT_LIMIT..=to + AT_LIMIT).contains(&angles[*row]);
        let mut rows: Vec<DataRow> = data.row_indices().filter(within).collect();
        if rows.is_empty() && data.rows() > 0 {
            let [least, most] = ends(angles);
            let message = format!(
                "no sample of `{}` is within the range of {}: its samples go from {:.3} to {:.3} deg",
                self.path.display(),
                self.test.moves,
                least.to_degrees(),
                most.to_degrees()
            );
            return Err(self.wrong("range_deg", Error::data(message)));
        }
        let covered = sweep(&rows.iter().map(|row| angles[*row]).collect::<Vec<f64>>());
        if data.rows() > 0 && (to - from).is_finite() && covered < COVERED * (to - from) {
            let message = format!(
                "{} of `{}` covers {:.1} deg of this range of {:.1} deg",
                self.test.moves,
                self.path.display(),
                covered.to_degrees(),
                (to - from).to_degrees()
            );
            let help = "does the axis count the other way round, or is the range that of another test?";
            return Err(self.wrong("range_deg", Error::data(message).help(help)));
        }
        self.tell_beside(angles, [from, to]);
        let cycles = cycles(&data);
        rows.sort_by(|&a, &b| cycles[a.0].cmp(&cycles[b.0]).then(angles[a].total_cmp(&angles[b])));
        Ok(picked(&data, &rows))
    }
}

/// How far an axis moves, rad.
fn sweep(angles: &[f64]) -> f64 {
    let [least, most] = ends(angles);
    (most - least).max(0.0)
}

/// The smallest and the largest angle, rad.
fn ends(angles: &[f64]) -> [f64; 2] {
    angles.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], angle| [least.min(*angle), most.max(*angle)])
}

/// The usual step from a sample to the next one, rad: some may be missing where a test starts and stops.
fn usual_step(angles: &[f64]) -> f64 {
    let mut steps: Vec<f64> = angles.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    let middle = steps.len() / 2;
    match steps.get(middle) {
        Some(_) => *steps.select_nth_unstable_by(middle, f64::total_cmp).1,
        None => 0.0,
    }
}

/// The number of every row's cycle, in the order in which cycles appear.
fn cycles(data: &Dataset) -> Vec<usize> {
    let Some(labels) = data.labels("cycle") else { return vec![0; data.rows()] };
    let mut known: BTreeMap<&str, usize> = BTreeMap::new();
    labels
        .iter()
        .map(|label| {
            let next = known.len();
            *known.entry(label).or_insert(next)
        })
        .collect()
}

impl Feed {
    /// The angle of the axis in every row, rad.
    fn angles(&self, data: &Dataset) -> Result<Vec<f64>> {
        let times = abbe_table::numbers(data, "time", Quantity::Time)?;
        let cycles = cycles(data);
        let mut starts: BTreeMap<usize, f64> = BTreeMap::new();
        for (cycle, time) in cycles.iter().zip(times) {
            let start = starts.entry(*cycle).or_insert(*time);
            *start = start.min(*time);
        }
        let [from, to] = [self.from_deg, self.to_deg].map(f64::to_radians);
        let speed = self.mm_per_min / 60.0 / self.radius_mm;
        let angle = |(cycle, time): (&usize, &f64)| {
            let (from, to) = if self.alternating && cycle % 2 == 1 { (to, from) } else { (from, to) };
            // At the end it stands.
            let swept = (speed * (time - starts[cycle])).min((to - from).abs());
            from + swept * (to - from).signum()
        };
        Ok(cycles.iter().zip(times).map(angle).collect())
    }
}

/// The stage.
struct Tests {
    tests: Vec<Named>,
}

impl Tests {
    fn assemble(&self, load: &dyn Fn(&Path) -> Result<Dataset>) -> Result<Dataset> {
        let mut all: Option<Dataset> = None;
        for test in &self.tests {
            let part = test.samples(load(&test.path)?)?;
            match &mut all {
                None => all = Some(part),
                Some(all) => append(all, part, &test.path)?,
            }
        }
        Ok(all.unwrap_or_default())
    }
}

impl Ingest for Tests {
    fn inputs(&self) -> Vec<InputFile> {
        self.tests.iter().map(|test| InputFile { setting: "tests", path: test.path.clone() }).collect()
    }

    fn headers(&self) -> Result<Vec<ColumnHeader>> {
        // What `read` does, on tables without rows: so the columns cannot differ.
        let without_rows = |path: &Path| {
            let columns = abbe_table::read_headers(path)?.into_iter().map(abbe_table::empty_column).collect();
            Ok(Dataset {
                columns,
                origins: Vec::new(),
                files: vec![path.to_owned()],
                averaged: false,
                is_log: false,
                stated_tips: Vec::new(),
            })
        };
        Ok(self.assemble(&without_rows)?.headers())
    }

    fn read(&self) -> Result<Dataset> {
        let data = self.assemble(&abbe_table::read)?;
        if data.rows() == 0 {
            return Err(Error::data("the files of the tests have no samples"));
        }
        Ok(data)
    }
}

/// Whether a test cannot be used without this column: positions, readings, ball and bar.
fn is_needed(header: &ColumnHeader) -> bool {
    [Quantity::Length, Quantity::Angle].contains(&header.quantity) || ["ball", "bar"].contains(&header.name.as_str())
}

/// Appends the rows of another test. Other columns (times, numbers of samples) that only one of them has are left out.
fn append(data: &mut Dataset, mut part: Dataset, path: &Path) -> Result<()> {
    let only = |one: &Dataset, other: &Dataset| {
        let there: BTreeSet<&str> = other.columns.iter().map(|column| column.header.name.as_str()).collect();
        let mut headers = one.columns.iter().map(|column| &column.header).filter(|header| is_needed(header));
        headers.find(|header| !there.contains(header.name.as_str())).map(|header| header.header.clone())
    };
    let found = only(data, &part).map(|header| (header, "missing here, the tests before it have it"));
    if let Some((header, which)) = found.or_else(|| Some((only(&part, data)?, "here only"))) {
        let error = Error::usage(format!("the column `{header}` is {which}")).in_file(path);
        return Err(error.help("say what a file does not have under `ball`, `bar`, `positions` or `feed` of its test"));
    }
    let mut parts: BTreeMap<String, Values> =
        part.columns.into_iter().map(|column| (column.header.name, column.values)).collect();
    data.columns.retain(|column| parts.contains_key(&column.header.name));
    for column in &mut data.columns {
        match (&mut column.values, parts.get_mut(&column.header.name)) {
            (Values::Numbers(numbers), Some(Values::Numbers(more))) => numbers.append(more),
            (Values::Labels(labels), Some(Values::Labels(more))) => labels.append(more),
            _ => {
                let message = format!(
                    "the column `{}` does not have the unit that it has in the tests before",
                    column.header.header
                );
                return Err(Error::usage(message).in_file(path));
            }
        }
    }
    let files = data.files.len();
    data.origins.extend(part.origins.into_iter().map(|origin| RowOrigin { file: origin.file + files, ..origin }));
    data.stated_tips.extend(part.stated_tips.into_iter().map(|tip| StatedTip { file: tip.file + files, ..tip }));
    data.files.append(&mut part.files);
    Ok(())
}

/// Some rows, each with its origin.
fn picked(data: &Dataset, rows: &[DataRow]) -> Dataset {
    let values = |values: &Values| match values {
        Values::Numbers(numbers) => Values::Numbers(rows.iter().map(|&row| numbers[row]).collect()),
        Values::Labels(labels) => Values::Labels(rows.iter().map(|&row| labels[row].clone()).collect()),
    };
    let columns = data.columns.iter();
    Dataset {
        columns: columns
            .map(|column| Column { header: column.header.clone(), values: values(&column.values) })
            .collect(),
        origins: rows.iter().map(|&row| data.origins[row]).collect(),
        files: data.files.clone(),
        averaged: data.averaged,
        is_log: false,
        stated_tips: data.stated_tips.clone(),
    }
}
