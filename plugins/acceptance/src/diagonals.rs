//! Validator plugin `diagonals`: diagonal displacement tests in the manner of ISO 230-6.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{
    Context, DataRow, Dataset, EstimateSource, Findings, PathItem, Quantity, Result, SettingsError, Validate,
};
use abbe_standards::diagonals::{Diagonal, EDITION, Kind, cancelling, squareness};
use abbe_standards::positioning::Positioning;
use abbe_standards::positioning::plan::{Axis, Fault, faults};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::common::{
    Acceptance, Judge, Key, Limits, Sheet, check_limits, doubted, finite, names, no_data, run_name, undecided,
};
use crate::positioning::{Uncertainty, values, words};
use crate::targets::Readings;

abbe_core::register!(
    Validate,
    "diagonals",
    "displacements along body and face diagonals in the manner of ISO 230-6, with what they hide",
    Diagonals,
    example,
    build,
    "../reference/validate-diagonals.md",
    EstimateSource::Readings,
);

/// Settings of diagonals.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Diagonals {
    /// What is known of the measurement. Without it figures have no uncertainty.
    #[serde(default)]
    uncertainty: Option<Uncertainty>,
    /// Largest admissible values: of each diagonal `A_um`, `E_um`, `M_um`, `R_um`, `B_um`; of all body and of all face diagonals
    /// `E_d_um`, `B_d_um`; the size of `squareness_urad`.
    #[serde(default)]
    limits: Limits,
}

fn example() -> Value {
    json!({ "limits": { "E_d_um": 20, "squareness_urad": 30 } })
}

const EACH: [Key; 5] = [("A_um", "A"), ("E_um", "E"), ("M_um", "M"), ("R_um", "R"), ("B_um", "B")];
const ALL: [Key; 3] = [("E_d_um", "E_d"), ("B_d_um", "B_d"), ("squareness_urad", "|squareness|")];
/// Directions by place, and faces by the place of the axis that does not move.
const AXES: [&str; 3] = ["X", "Y", "Z"];
const FACES: [&str; 3] = ["yz", "zx", "xy"];

fn build(settings: Diagonals, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    let under = |error: SettingsError| error.under([PathItem::Key("uncertainty".to_owned())]);
    settings.uncertainty.iter().try_for_each(Uncertainty::check).map_err(under)?;
    check_limits(&settings.limits, &names(&[&EACH[..], &ALL].concat()))?;
    Ok(Box::new(Judge(settings)))
}

/// A figure of a diagonal.
type OfDiagonal = fn(&Positioning) -> Option<f64>;

/// A diagonal that was measured.
struct Measured {
    /// The name of its run.
    name: String,
    diagonal: Diagonal,
    kind: Kind,
    found: Positioning,
    /// Standard uncertainties of E and B.
    uncertainties: [Option<f64>; 2],
    /// Faults of its readings.
    doubts: Vec<String>,
}

/// The way of a diagonal, from the axes of its rows. All rows have to be on it, as far along as `position` says.
fn way(data: &Dataset) -> Result<Diagonal> {
    let along = finite(data, "position", Quantity::Length)?;
    let axes = AXES.map(|axis| finite(data, axis, Quantity::Length));
    let [x, y, z] = axes;
    let axes = [x?, y?, z?];
    let rows = || 0..along.len();
    let ends = rows()
        .min_by(|one, other| along[*one].total_cmp(&along[*other]))
        .zip(rows().max_by(|one, other| along[*one].total_cmp(&along[*other])));
    let Some((first, last)) = ends else { return Err(no_data()) };
    let diagonal = Diagonal { way: [0, 1, 2].map(|k| axes[k][last] - axes[k][first]) };
    let travel = along[last] - along[first];
    for row in rows() {
        let part = (along[row] - along[first]) / travel;
        let off = [0, 1, 2].map(|k| axes[k][row] - axes[k][first] - part * diagonal.way[k]);
        let off = Diagonal { way: off }.length().max((diagonal.length() - travel).abs());
        // Also where there is no travel at all.
        if off.is_nan() || off > 1e-3 * travel {
            let message = format!("X, Y and Z are {off:.3} mm off the diagonal at this `position`");
            return Err(data
                .error_at(DataRow(row), message)
                .help("one file has one straight diagonal, from end to end"));
        }
    }
    Ok(diagonal)
}

impl Diagonals {
    /// The figures of one diagonal.
    fn one(&self, data: &Dataset, findings: &mut Findings) -> Result<Measured> {
        let (readings, run) = (Readings::of(data)?, run_name(data));
        let diagonal = way(data)?;
        let Some(kind) = diagonal.kind() else {
            let error = data.error_at(DataRow(0), "one axis moves alone: this is no diagonal");
            return Err(error.help("`validate: positioning` is for single axes"));
        };
        let found = Positioning::of(&readings.targets);
        let copied = doubted(&run, &[&readings.in_order]);
        let doubts = readings.faults(copied.is_some());
        findings.remarks.extend(copied);
        findings.remarks.extend(doubts.iter().map(|doubt| format!("{run}: {doubt}")));
        findings.remarks.extend(self.uncertainty.and_then(|stated| stated.quiet(&readings)));
        let terms = self.uncertainty.and_then(|stated| stated.terms(&readings));
        let expanded = terms.and_then(|terms| terms.expanded(readings.runs()));
        let mut sheet = Sheet::new(&run, &self.limits);
        for (name, value, uncertainty) in values(&found, expanded.as_ref()) {
            let (Some(value), half) = (value, uncertainty.map(|expanded| 0.5 * expanded)) else { continue };
            match EACH.iter().find(|(_, own)| *own == name) {
                Some((key, _)) => sheet.limit(name, value, half, key),
                None => sheet.tell(name, value, "um").standard_uncertainty = half,
            }
        }
        if let Some(slope) = found.slope() {
            sheet.tell("slope", 1e3 * slope, "um/m");
        }
        let mut figures = sheet.finish(&EACH);
        undecided(&mut figures, &doubts);
        findings.figures.extend(figures);
        let told = faults(Axis::Linear, &readings.targets).into_iter();
        let told = told.filter(|fault| matches!(fault, Fault::OneDirection | Fault::MissingRuns(_)));
        findings.remarks.extend(told.map(|fault| format!("{run}: {}", words(&fault, Axis::Linear))));
        let uncertainties = [expanded.map(|own| 0.5 * own.systematic), expanded.map(|own| 0.5 * own.reversal)];
        Ok(Measured { name: run, diagonal, kind, found, uncertainties, doubts })
    }

    /// E_d and B_d: the largest of all body and of all face diagonals.
    fn largest(&self, name: &str, all: &[&Measured], findings: &mut Findings) {
        let lacking = lacking(all);
        findings.remarks.extend(lacking.iter().map(|lacking| format!("{name} diagonals: {lacking}")));
        let mut sheet = Sheet::new(name, &self.limits).lacking(lacking);
        let figures: [(Key, OfDiagonal, usize); 2] =
            [(ALL[0], |own| own.systematic, 0), (ALL[1], |own| own.reversal, 1)];
        for ((key, symbol), of, place) in figures {
            let values: Option<Vec<(f64, Option<f64>)>> =
                all.iter().map(|own| Some((of(&own.found)?, own.uncertainties[place]))).collect();
            let most = values.and_then(|all| all.into_iter().reduce(|a, b| if b.0 > a.0 { b } else { a }));
            if let Some((value, uncertainty)) = most {
                sheet.limit(symbol, value, uncertainty, key);
            }
        }
        let mut figures = sheet.finish(&ALL[..2]);
        all.iter().for_each(|own| undecided(&mut figures, &own.doubts));
        findings.figures.extend(figures);
    }

    /// Squareness of each face that has both diagonals.
    fn squarenesses(&self, all: &[Measured], findings: &mut Findings) {
        let mut found = false;
        for pair in [[0, 1], [1, 2], [0, 2]] {
            let face = FACES[3 - pair[0] - pair[1]];
            let of = |sign: f64| {
                let own = move |own: &&Measured| {
                    own.kind == Kind::Face(pair) && sign * own.diagonal.way[pair[0]] * own.diagonal.way[pair[1]] > 0.0
                };
                all.iter().filter(own).collect::<Vec<_>>()
            };
            let (same, opposite) = (of(1.0), of(-1.0));
            let travel = |own: &Measured| pair.map(|axis| own.diagonal.way[axis].abs());
            if same.is_empty() && opposite.is_empty() {
                continue;
            }
            found = true;
            let value = match (&same[..], &opposite[..]) {
                ([one], [other]) if alike(travel(one), travel(other)) => one
                    .found
                    .slope()
                    .zip(other.found.slope())
                    .map(|(same, opposite)| squareness(1e3 * same, 1e3 * opposite, travel(one))),
                _ => None,
            };
            let mut sheet = Sheet::new(face, &self.limits);
            match value {
                Some(value) => sheet.limit_size("squareness", value, None, ALL[2].0),
                None => findings.remarks.push(format!(
                    "face {face}: squareness needs one diagonal of either sort over the same travels, and it is absent"
                )),
            }
            let mut figures = sheet.finish(&ALL[2..]);
            same.iter().chain(&opposite).for_each(|own| undecided(&mut figures, &own.doubts));
            findings.figures.extend(figures);
        }
        if !found && self.limits.contains_key(ALL[2].0) {
            findings.figures.extend(Sheet::new("no face", &self.limits).finish(&ALL[2..]));
        }
    }
}

/// What keeps diagonals of one sort from deciding: a body has four, a face two.
fn lacking(all: &[&Measured]) -> Option<String> {
    let of = |own: &Measured| match own.kind {
        Kind::Body => (3, 4),
        Kind::Face([one, other]) => (3 - one - other, 2),
    };
    // The ways of a diagonal and back are one.
    let sense = |own: &Measured| {
        let signs = own.diagonal.way.map(|part| if part.abs() < 1e-9 { 0.0 } else { part.signum() });
        let first = signs.into_iter().find(|sign| *sign != 0.0).unwrap_or(1.0);
        signs.map(|sign| (sign * first) as i8)
    };
    let mut found: BTreeMap<(usize, usize), BTreeSet<[i8; 3]>> = BTreeMap::new();
    for own in all {
        found.entry(of(own)).or_default().insert(sense(own));
    }
    let ((place, wanted), ways) = found.iter().find(|((_, wanted), ways)| ways.len() < *wanted)?;
    let of = FACES.get(*place).map_or_else(|| "the body".to_owned(), |face| format!("face {face}"));
    Some(format!(
        "{} of {wanted} of {of} were measured: ISO 230-6 asks for all, and the others may be worse",
        ways.len()
    ))
}

/// How much of the lost motion of the others that of a diagonal may be off with its sign turned, and they from each other.
const SAME_LOST_MOTION: f64 = 0.5;

/// How many times its standard uncertainty a lost motion has to be.
const CERTAIN: f64 = 5.0;

/// Mean lost motion along a diagonal, µm; none if its targets do not tell its sign.
fn lost_motion(found: &Positioning) -> Option<f64> {
    let reversals: Vec<f64> = found.targets.iter().filter_map(|target| target.reversal).collect();
    let (count, mean) = (reversals.len() as f64, found.mean_reversal?);
    let squares: f64 = reversals.iter().map(|reversal| (reversal - mean).powi(2)).sum();
    let uncertainty = (squares / (count - 1.0) / count).sqrt();
    (count >= 4.0 && mean.abs() > CERTAIN * uncertainty && mean.abs() > 1e-3).then_some(mean)
}

/// Diagonals with a lost motion of the other sign than all others of their sort, by their places, in words.
///
/// An axis that moves along any diagonal of a sort moves as far, so that its lost motion adds the same to each of them. What angles of the
/// axes add is less: two of a face may differ by it, and are told only.
fn turned(all: &[Measured]) -> Vec<(usize, String)> {
    let lost: Vec<Option<f64>> = all.iter().map(|own| lost_motion(&own.found)).collect();
    let is_turned = |place: &usize| {
        let (own, kind) = (lost[*place]?, all[*place].kind);
        let others = (0..all.len()).filter(|other| other != place && all[*other].kind == kind);
        let others: Vec<f64> = others.map(|other| lost[other]).collect::<Option<_>>()?;
        let mean = others.iter().sum::<f64>() / others.len() as f64;
        let agrees = |lost: f64| (lost - mean).abs() < SAME_LOST_MOTION * mean.abs();
        let fewest = if kind == Kind::Body { 2 } else { 1 };
        (others.len() >= fewest && agrees(-own) && others.iter().all(|other| agrees(*other))).then_some((own, mean))
    };
    let told = |place: usize| {
        let (own, mean) = is_turned(&place)?;
        let words = format!(
            "its lost motion is {own:.2} um, that of the other diagonals of its sort {mean:.2} um, and axes add the same to each: is the \
             sign of these readings wrong, or that of `direction`?"
        );
        Some((place, words))
    };
    (0..all.len()).filter_map(told).collect()
}

/// Diagonals over other travels than the others of their sort, which are alike, in words.
fn other_boxes(all: &[Measured]) -> Vec<String> {
    let travels = |own: &Measured| own.diagonal.way.map(f64::abs);
    let is_alike = |one: [f64; 3], other: [f64; 3]| {
        let longest = one.iter().chain(&other).fold(0.0_f64, |longest, own| longest.max(*own));
        (0..3).all(|axis| (one[axis] - other[axis]).abs() <= 1e-3 * longest)
    };
    let told = |own: &Measured| {
        let others = || all.iter().filter(|other| other.kind == own.kind && !std::ptr::eq(*other, own));
        let [first, ..] = others().map(travels).collect::<Vec<_>>()[..] else { return None };
        let fewest = if own.kind == Kind::Body { 2 } else { 1 };
        let others_agree = others().count() >= fewest && others().all(|other| is_alike(first, travels(other)));
        (others_agree && !is_alike(first, travels(own))).then(|| {
            let shown = |travels: [f64; 3]| travels.map(|travel| format!("{travel:.1}")).join(" x ");
            format!(
                "{}: it goes over {} mm, the other diagonals of its sort over {} mm: ISO 230-6 compares diagonals of one box",
                own.name,
                shown(travels(own)),
                shown(first)
            )
        })
    };
    all.iter().filter_map(told).collect()
}

fn alike(one: [f64; 2], other: [f64; 2]) -> bool {
    (0..2).all(|k| (one[k] - other[k]).abs() <= 1e-3 * one[k])
}

/// What diagonals hide: scales that cancel along them.
fn hidden(name: &str, all: &[&Measured]) -> Option<String> {
    let own = all.first()?;
    let moving: Vec<usize> = match own.kind {
        Kind::Body => vec![0, 1, 2],
        Kind::Face(pair) => pair.to_vec(),
    };
    let travel = |axis: usize| own.diagonal.way[axis];
    let first = moving[0];
    let other = |axis: &usize| {
        let scale = cancelling(10.0, [travel(first), travel(*axis)]);
        format!("one of {} of {scale:.1} um/m", AXES[*axis])
    };
    let others: Vec<String> = moving[1..].iter().map(other).collect();
    let alone = match own.kind {
        Kind::Body => "; a body diagonal alone tells no squareness",
        Kind::Face(_) => "; squareness is the difference of both diagonals of a face",
    };
    Some(format!(
        "{name} diagonals hide errors that cancel along them: a scale of {} of 10.0 um/m with {} changes none of them{alone}",
        AXES[first],
        others.join(" or ")
    ))
}

impl Acceptance for Diagonals {
    fn findings(&self, data: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        findings.remarks.push(format!(
            "{EDITION} (its text was not at hand). A choice of this project: E_d and B_d are the largest of all body, and of all face \
             diagonals; figures of each are those of ISO 230-2:2014"
        ));
        let mut all: Vec<Measured> = data.iter().map(|data| self.one(data, &mut findings)).collect::<Result<_>>()?;
        findings.remarks.extend(other_boxes(&all));
        let turned = turned(&all);
        findings.remarks.extend(turned.iter().map(|(place, words)| format!("{}: {words}", all[*place].name)));
        for (place, words) in turned {
            if all[place].kind == Kind::Body {
                all[place].doubts.push(words);
            }
        }
        let of = |body: bool| all.iter().filter(|own| (own.kind == Kind::Body) == body).collect::<Vec<_>>();
        for (name, own) in [("body", of(true)), ("face", of(false))] {
            if !own.is_empty() {
                self.largest(name, &own, &mut findings);
            }
        }
        self.squarenesses(&all, &mut findings);
        findings.remarks.extend(hidden("body", &of(true)));
        for pair in [[0, 1], [1, 2], [0, 2]] {
            let own: Vec<&Measured> = all.iter().filter(|own| own.kind == Kind::Face(pair)).collect();
            findings.remarks.extend(hidden(&format!("face {}", FACES[3 - pair[0] - pair[1]]), &own));
        }
        Ok(findings)
    }
}
