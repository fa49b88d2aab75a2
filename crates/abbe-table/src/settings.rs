//! The settings that say how a file is laid out.

use std::collections::BTreeMap;

use abbe_core::{ColumnHeader, Label, PathItem, SettingsError};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::layout::{ColumnSource, Decimal, Encoding, Layout, Separator, Thousands, Unit};

/// Where a column stands in the files.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "the name of a column of the file, or a map with `column` and `unit`, was expected")]
pub enum Source {
    /// Its name in the header row; without a header row its number, from 1. The unit is that of the name on the left.
    Column(Label),
    /// A column in another unit.
    InUnit(ColumnInUnit),
}

/// A column of a file that has another unit.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ColumnInUnit {
    /// Its name in the header row; without a header row its number, from 1.
    column: Label,
    /// The unit of its numbers: nm, um, mm, cm, m, in, thou; deg, dms (degrees, minutes, seconds), gon, rad, mrad, urad, arcmin,
    /// arcsec, rev; us, ms, s, min, h; degC, K, degF; N, kN; rpm, 1/s; mm/s, mm/min, m/min, in/min; 1, %, ppm, um/m.
    unit: String,
}

/// What settings say of the layout of files, with the names of `ingest: csv`. Other settings are not looked at.
#[derive(Debug, Deserialize)]
pub struct Declared {
    /// As [`Layout::separator`].
    #[serde(default)]
    pub separator: Separator,
    /// As [`Layout::decimal`].
    #[serde(default)]
    pub decimal: Decimal,
    /// As [`Layout::thousands`].
    #[serde(default)]
    pub thousands: Thousands,
    /// As [`Layout::encoding`].
    #[serde(default)]
    pub encoding: Encoding,
    /// As [`Layout::skip_lines`].
    #[serde(default)]
    pub skip_lines: usize,
    /// As [`Layout::skip_after_header`].
    #[serde(default)]
    pub skip_after_header: usize,
    /// As [`Layout::has_header`].
    #[serde(default = "yes")]
    pub header: bool,
    /// As [`Layout::no_data`].
    #[serde(default)]
    pub no_data: Vec<Label>,
    /// As [`Layout::columns`].
    pub columns: Option<BTreeMap<String, Source>>,
}

impl Default for Declared {
    fn default() -> Self {
        Self {
            separator: Separator::default(),
            decimal: Decimal::default(),
            thousands: Thousands::default(),
            encoding: Encoding::default(),
            skip_lines: 0,
            skip_after_header: 0,
            header: true,
            no_data: Vec::new(),
            columns: None,
        }
    }
}

fn yes() -> bool {
    true
}

/// Lines that may be skipped.
const MOST_LINES: usize = 10_000;

impl Declared {
    /// The layout; else which setting is wrong.
    pub fn layout(self) -> Result<Layout, SettingsError> {
        for (setting, lines) in [("skip_lines", self.skip_lines), ("skip_after_header", self.skip_after_header)] {
            if lines > MOST_LINES {
                return Err(SettingsError::new(setting, format!("{lines} lines; at most {MOST_LINES} are skipped"))
                    .help("take them out of the file"));
            }
        }
        if !self.header && self.columns.is_none() {
            let message = "without a header row `columns` has to say what the columns are: `X_mm: 1`";
            return Err(SettingsError::new("header", message).help("`abbe data FILE` shows the columns by number"));
        }
        let is_twice = match self.thousands {
            Thousands::None | Thousands::Apostrophe => false,
            Thousands::Blank => self.separator == Separator::Space,
            Thousands::Point => self.decimal == Decimal::Point,
            Thousands::Comma => self.decimal == Decimal::Comma,
        };
        if is_twice {
            let message = format!("`{}` has another meaning here already", self.thousands.name());
            let error = SettingsError::new("thousands", message);
            return Err(error.help("`decimal` and `separator` have to be other characters"));
        }
        Ok(Layout {
            separator: self.separator,
            decimal: self.decimal,
            thousands: self.thousands,
            encoding: self.encoding,
            skip_lines: self.skip_lines,
            skip_after_header: self.skip_after_header,
            has_header: self.header,
            no_data: self.no_data.into_iter().map(|Label(mark)| mark.trim().to_owned()).collect(),
            columns: self.columns.map(|columns| sources(columns, self.header)).transpose()?,
        })
    }
}

fn sources(
    written: BTreeMap<String, Source>,
    has_header: bool,
) -> Result<BTreeMap<String, ColumnSource>, SettingsError> {
    if written.is_empty() {
        return Err(SettingsError::new("columns", "at least one column was expected")
            .help("write `columns: { X_mm: NAME }`, or leave `columns` out to take all as they are named"));
    }
    let mut taken: BTreeMap<String, String> = BTreeMap::new();
    let mut sources = BTreeMap::new();
    for (name, source) in written {
        let wrong = |message: String| SettingsError::new(&name, message).under([PathItem::Key("columns".to_owned())]);
        let header = ColumnHeader::parse(&name);
        if header.name.trim().is_empty() {
            return Err(wrong("a column needs a name".to_owned()).help("write its name and unit: `X_mm`"));
        }
        if let Some(twin) = taken.insert(header.name.clone(), name.clone()) {
            return Err(wrong(format!("`{twin}` and `{name}` are both named `{}`", header.name))
                .help("a column has one name and one unit: leave one of them out"));
        }
        let (Label(column), unit) = match source {
            Source::Column(column) => (column, None),
            Source::InUnit(ColumnInUnit { column, unit }) => (
                column,
                Some(Unit::of(&unit, &header).map_err(|message| {
                    wrong(message)
                        .help("the unit after `unit` is that of the file, the one in the name that of the data set")
                })?),
            ),
        };
        if !has_header && !column.parse::<usize>().is_ok_and(|number| number > 0) {
            return Err(wrong(format!(
                "`{column}` is no number of a column; without a header row 1, 2, ... was expected"
            ))
            .help("`abbe data FILE` shows the columns by number"));
        }
        sources.insert(name, ColumnSource { column, unit });
    }
    Ok(sources)
}
