//! The settings that say how a file is laid out.

use std::collections::BTreeMap;

use abbe_core::{ColumnHeader, Label, PathItem, SettingsError};
use abbe_table::{ColumnSource, Decimal, Encoding, Layout, Separator, Unit};
use schemars::JsonSchema;
use serde::Deserialize;

/// What separates the columns.
#[derive(Debug, Clone, Copy, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum SeparatorName {
    /// `,`
    #[default]
    Comma,
    /// `;`
    Semicolon,
    /// One tabulator.
    Tab,
    /// `|`
    Stroke,
    /// Any number of spaces and tabulators.
    Space,
}

/// The character before the decimals of all numbers.
#[derive(Debug, Clone, Copy, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum DecimalName {
    /// `1.5`
    #[default]
    Point,
    /// `1,5`
    Comma,
}

/// How characters are stored.
#[derive(Debug, Clone, Copy, Default, Deserialize, JsonSchema)]
pub(crate) enum EncodingName {
    /// UTF-8, with a byte order mark or without.
    #[default]
    #[serde(rename = "utf-8")]
    Utf8,
    /// UTF-16, as its byte order mark says; without one the low byte comes first.
    #[serde(rename = "utf-16")]
    Utf16,
    /// ISO 8859-1 and Windows-1252.
    #[serde(rename = "latin-1")]
    Latin1,
}

/// Where a column stands in the files.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "the name of a column of the file, or a map with `column` and `unit`, was expected")]
pub(crate) enum Source {
    /// Its name in the header row; without a header row its number, from 1. The unit is that of the name on the left.
    Column(Label),
    /// A column in another unit.
    InUnit(ColumnInUnit),
}

#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ColumnInUnit {
    /// Its name in the header row; without a header row its number, from 1.
    column: Label,
    /// The unit of its numbers: nm, um, mm, cm, m, in, thou; deg, dms (degrees, minutes, seconds), gon, rad, mrad, urad, arcmin,
    /// arcsec, rev; us, ms, s, min, h; degC, K, degF; N, kN; rpm, 1/s; mm/s, mm/min, m/min, in/min; 1, %, ppm, um/m.
    unit: String,
}

/// What is declared of the files.
pub(crate) struct Declared {
    pub(crate) separator: SeparatorName,
    pub(crate) decimal: DecimalName,
    pub(crate) encoding: EncodingName,
    pub(crate) skip_lines: usize,
    pub(crate) skip_after_header: usize,
    pub(crate) has_header: bool,
    pub(crate) no_data: Vec<Label>,
    pub(crate) columns: Option<BTreeMap<String, Source>>,
}

/// Lines that may be skipped.
const MOST_LINES: usize = 10_000;

impl Declared {
    pub(crate) fn layout(self) -> Result<Layout, SettingsError> {
        for (setting, lines) in [("skip_lines", self.skip_lines), ("skip_after_header", self.skip_after_header)] {
            if lines > MOST_LINES {
                return Err(SettingsError::new(setting, format!("{lines} lines; at most {MOST_LINES} are skipped")));
            }
        }
        if !self.has_header && self.columns.is_none() {
            let message = "without a header row `columns` has to say what the columns are: `X_mm: 1`";
            return Err(SettingsError::new("header", message));
        }
        Ok(Layout {
            separator: match self.separator {
                SeparatorName::Comma => Separator::Comma,
                SeparatorName::Semicolon => Separator::Semicolon,
                SeparatorName::Tab => Separator::Tab,
                SeparatorName::Stroke => Separator::Stroke,
                SeparatorName::Space => Separator::Space,
            },
            decimal: match self.decimal {
                DecimalName::Point => Decimal::Point,
                DecimalName::Comma => Decimal::Comma,
            },
            encoding: match self.encoding {
                EncodingName::Utf8 => Encoding::Utf8,
                EncodingName::Utf16 => Encoding::Utf16,
                EncodingName::Latin1 => Encoding::Latin1,
            },
            skip_lines: self.skip_lines,
            skip_after_header: self.skip_after_header,
            has_header: self.has_header,
            no_data: self.no_data.into_iter().map(|Label(mark)| mark.trim().to_owned()).collect(),
            columns: self.columns.map(|columns| sources(columns, self.has_header)).transpose()?,
        })
    }
}

fn sources(
    written: BTreeMap<String, Source>,
    has_header: bool,
) -> Result<BTreeMap<String, ColumnSource>, SettingsError> {
    if written.is_empty() {
        return Err(SettingsError::new("columns", "at least one column was expected"));
    }
    let mut taken: BTreeMap<String, String> = BTreeMap::new();
    let mut sources = BTreeMap::new();
    for (name, source) in written {
        let wrong = |message: String| SettingsError::new(&name, message).under([PathItem::Key("columns".to_owned())]);
        let header = ColumnHeader::parse(&name);
        if header.name.trim().is_empty() {
            return Err(wrong("a column needs a name".to_owned()));
        }
        if let Some(twin) = taken.insert(header.name.clone(), name.clone()) {
            return Err(wrong(format!("`{twin}` and `{name}` are both named `{}`", header.name)));
        }
        let (Label(column), unit) = match source {
            Source::Column(column) => (column, None),
            Source::InUnit(ColumnInUnit { column, unit }) => (column, Some(Unit::of(&unit, &header).map_err(wrong)?)),
        };
        if !has_header && !column.parse::<usize>().is_ok_and(|number| number > 0) {
            return Err(wrong(format!(
                "`{column}` is no number of a column; without a header row 1, 2, ... was expected"
            )));
        }
        sources.insert(name, ColumnSource { column, unit });
    }
    Ok(sources)
}
