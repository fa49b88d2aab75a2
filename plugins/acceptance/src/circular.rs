//! Validator plugin `circular`: circular tests in the manner of ISO 230-4.

use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;

use abbe_core::{
    Context, DataRow, Dataset, EstimateSource, Findings, PathItem, Quantity, Result, SettingsError, Validate,
    not_negative, positive,
};
use abbe_standards::circular::{Bidirectional, EDITION, Sample, Trace};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::both_directions::{place_of_angle, smaller_direction};
use crate::channel_units::range;
use crate::circle_positions::{beside_any_plane, contradicted};
use crate::common::{
    Acceptance, Judge, Key, Limits, MOST_STEPS, Sheet, against, check_limits, directions, doubted, faults, finite,
    names, run_name, too_quiet, undecided,
};

abbe_core::register!(
    Validate,
    "circular",
    "circular tests of a ball bar in the manner of ISO 230-4: G, G(b), F, D, H",
    Circular,
    example,
    build,
    "../reference/validate-circular.md",
    EstimateSource::Readings,
);

/// Settings of circular tests.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Circular {
    /// The nominal radius of all circles under `from`.
    radius_mm: f64,
    /// The column of angles, without its unit. Default: `angle`. Not beside `scanned`.
    #[serde(default)]
    angle: Option<String>,
    /// The column of readings, length less the nominal radius, without its unit. Default: `reading`. Not beside `scanned`.
    #[serde(default)]
    reading: Option<String>,
    /// Points that a probe scanned on a ring or a sphere, instead of angles and readings.
    #[serde(default)]
    scanned: Option<Scanned>,
    /// Standard uncertainty of a reading. D and F have it, G and H that of a difference of two. 0: it is not known, and none has one.
    #[serde(default)]
    standard_uncertainty_um: f64,
    /// Largest admissible values: `G_um` (both directions, smallest zone), `G_b_um`, `G_lsc_um`, `G_b_lsc_um`, `H_um`, and of the sizes
    /// of `D_um` and of `F_um` as set up.
    #[serde(default)]
    limits: Limits,
}

/// Points of a circle on a ring or a sphere.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Scanned {
    /// The columns of the positions of two axes, without their unit: the first one at 0 deg, the second one at 90 deg.
    plane: [String; 2],
    /// The nominal centre of the circle in this plane.
    centre_mm: [f64; 2],
    /// The columns of the deflections of the probe along them, tip less probe, without their unit. Default: none, the probe is
    /// a point of the machine, or its control has added them.
    #[serde(default)]
    deflections: Option<[String; 2]>,
}

impl Scanned {
    /// Angles and readings. The tip is on the ring or the sphere: where the positions say that it is further out, the machine is
    /// further in, so that the deviation of its path has the opposite sign.
    fn samples(&self, data: &Dataset, radius: f64) -> Result<[Vec<f64>; 2]> {
        let along = |axis: usize| -> Result<Vec<f64>> {
            let column = |name: &str, setting: &str| {
                finite(data, name, Quantity::Length).map_err(|error| {
                    let mut error = error.setting_at(&["scanned", setting]);
                    error.setting.push(PathItem::Index(axis));
                    error
                })
            };
            let mut all = column(&self.plane[axis], "plane")?.to_vec();
            if let Some(names) = &self.deflections {
                let deflections = column(&names[axis], "deflections")?;
                all.iter_mut().zip(deflections).for_each(|(own, deflection)| *own += deflection);
            }
            all.iter_mut().for_each(|own| *own -= self.centre_mm[axis]);
            Ok(all)
        };
        let (one, other) = (along(0)?, along(1)?);
        let angles = one.iter().zip(&other).map(|(x, y)| y.atan2(*x)).collect();
        Ok([angles, one.iter().zip(&other).map(|(x, y)| radius - x.hypot(*y)).collect()])
    }
}

fn example() -> Value {
    json!({ "radius_mm": 150, "limits": { "G_um": 20, "G_b_um": 25, "H_um": 15 } })
}

const KEYS: [Key; 7] = [
    ("G_um", "G"),
    ("G_lsc_um", "G_lsc"),
    ("G_b_um", "G(b)"),
    ("G_b_lsc_um", "G(b)_lsc"),
    ("H_um", "H"),
    ("D_um", "|D|"),
    ("F_um", "|F| as set up"),
];

fn build(settings: Circular, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    positive("radius_mm", settings.radius_mm)?;
    not_negative("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    if let Some(scanned) = &settings.scanned
        && scanned.centre_mm.iter().any(|value| !value.is_finite())
    {
        let at = [PathItem::Key("scanned".to_owned())];
        return Err(SettingsError::new("centre_mm", "finite numbers were expected").under(at));
    }
    for (setting, column) in [("angle", &settings.angle), ("reading", &settings.reading)] {
        if column.is_some() && settings.scanned.is_some() {
            let message =
                "angles and readings follow from the positions of the scanned points, so that this column is not read";
            return Err(SettingsError::new(setting, message).help(format!("leave out `{setting}`, or `scanned`")));
        }
    }
    check_limits(&settings.limits, &names(&KEYS))?;
    Ok(Box::new(Judge(settings)))
}

/// Turns above which angles are not those of a circle with its overshoot, which is half a turn or less at both ends.
const MOST_TURNS: f64 = 3.0;

/// An arc has so many angles that are farther apart than the next number, rad, over so much of a turn, rad.
const FEWEST_ANGLES: usize = 8;
const SAME_ANGLE: f64 = 1e-6;
const SHORTEST_ARC: f64 = PI / 18.0;

/// The name of a direction.
fn name_of(positive: bool) -> &'static str {
    if positive { "ccw" } else { "cw" }
}

impl Circular {
    /// Standard uncertainties of a reading and of a difference of two, um.
    fn uncertainties(&self) -> [Option<f64>; 2] {
        let u = self.standard_uncertainty_um;
        [1.0, 2.0_f64.sqrt()].map(|factor| (u > 0.0).then_some(factor * u))
    }

    /// Angles and readings of all rows.
    fn samples(&self, data: &Dataset) -> Result<[Vec<f64>; 2]> {
        match &self.scanned {
            Some(scanned) => scanned.samples(data, self.radius_mm),
            None => {
                let column = |name: &str, quantity, setting: &str| {
                    let numbers = finite(data, name, quantity).map_err(|error| error.setting(setting))?;
                    Ok(numbers.to_vec())
                };
                let angle = self.angle();
                Ok([column(angle, Quantity::Angle, "angle")?, column(self.reading(), Quantity::Length, "reading")?])
            }
        }
    }

    /// The column of readings.
    fn reading(&self) -> &str {
        self.reading.as_deref().unwrap_or("reading")
    }

    /// The trace of one direction; none without readings.
    fn trace(&self, data: &Dataset, [angles, readings]: &[Vec<f64>; 2], positive: bool) -> Result<Option<Trace>> {
        let directions = directions(data)?;
        let rows: Vec<usize> = (0..angles.len()).filter(|row| directions[*row] == positive).collect();
        // A second circle in one direction would be mixed with the first.
        if let Some(runs) = data.labels("run")
            && let Some(row) = rows.iter().find(|row| runs[**row] != runs[rows[0]])
        {
            let (first, second) = (&runs[rows[0]], &runs[*row]);
            let message = format!("runs `{first}` and `{second}` both go {}", name_of(positive));
            let error = data.error_at(DataRow(*row), message);
            return Err(error.help("one run a direction was expected: leave others out with `keep` of `ingest: csv`"));
        }
        if let Some(row) = rows.iter().find(|row| readings[**row].abs() >= 0.1 * self.radius_mm) {
            let message = format!("the reading {} mm is no deviation from {} mm", readings[*row], self.radius_mm);
            return Err(data.error_at(DataRow(*row), message).help(match self.scanned {
                Some(_) => {
                    "are `plane`, `centre_mm` and `radius_mm`, that of the way of the tip, those of this circle?"
                }
                None => "readings are lengths less the nominal radius",
            }));
        }
        let sample = |row: &usize| Sample { angle: angles[*row], radius: self.radius_mm + readings[*row] };
        let samples: Vec<Sample> = rows.iter().map(sample).collect();
        Ok((!samples.is_empty()).then(|| Trace::new(&samples)))
    }

    /// A remark on directions that the order of angles contradicts. Readings of an instrument may be sorted by the angle, those of one
    /// direction against it: then half of all steps are.
    fn turned(&self, data: &Dataset, angles: &[f64], run: &str) -> Result<Option<String>> {
        let ways = against(angles, &directions(data)?);
        let [positive, negative] = ways;
        if 2 * (positive.0 + negative.0) > positive.1 + negative.1 {
            return Ok(Some(format!(
                "{run}: the angles run against `direction` in most rows: are cw and ccw exchanged, or is the sign of the angle wrong?"
            )));
        }
        let is_against = |&(count, all): &(usize, usize)| count as f64 > MOST_STEPS * all as f64;
        let way = ways.iter().position(is_against).filter(|_| self.scanned.is_some());
        Ok(way.map(|way| {
            let (count, all) = ways[way];
            format!(
                "{run}: the scan runs against `direction` in {count} of {all} steps of the {} run: is that its direction, and is it the right \
                 scan?",
                name_of(way == 0)
            )
        }))
    }

    /// The column of the angle.
    fn angle(&self) -> &str {
        self.angle.as_deref().unwrap_or("angle")
    }

    /// A sentence on positions that are in no plane, or that contradict the angles or the radius beside which they stand.
    fn beside(&self, data: &Dataset, angles: &[f64]) -> Result<Option<String>> {
        let ways = directions(data)?;
        Ok([true, false].into_iter().find_map(|way| {
            let rows: Vec<usize> = (0..angles.len()).filter(|row| ways[*row] == way).collect();
            match self.scanned {
                // Angles and readings are made of positions, two of three.
                Some(_) => beside_any_plane(data, &rows, self.radius_mm),
                None => contradicted(data, self.angle(), angles, &rows, self.radius_mm),
            }
        }))
    }

    fn judge(&self, data: &Dataset, findings: &mut Findings) -> Result<()> {
        let run = run_name(data);
        let samples = self.samples(data)?;
        let [angles, readings] = &samples;
        findings.remarks.extend(self.turned(data, angles, &run)?);
        findings.remarks.extend(doubted(&run, &[readings]));
        let mut faults = faults(&[(self.reading(), readings)], 1e-3 * self.standard_uncertainty_um, (1e3, "um"));
        let um: Vec<f64> = readings.iter().map(|value| 1e3 * value).collect();
        findings.remarks.extend(too_quiet(&run, &um, self.standard_uncertainty_um, "um"));
        let traces = [self.trace(data, &samples, true)?, self.trace(data, &samples, false)?];
        let both = traces[0].as_ref().zip(traces[1].as_ref()).and_then(|(one, other)| Bidirectional::of(one, other));
        faults.extend(traces.iter().flatten().find_map(too_many_turns));
        faults.extend(traces.iter().flatten().find_map(hardly_an_arc));
        faults.extend(unequal_arcs(&traces));
        let places: Vec<usize> = angles.iter().map(|angle| place_of_angle(*angle)).collect();
        faults.extend(smaller_direction(&[&um], &directions(data)?, &places, "um"));
        faults.extend(self.beside(data, angles)?);
        findings.remarks.extend(faults.iter().map(|fault| format!("{run}: {fault}")));
        let mut sheet = Sheet::new(&run, &self.limits);
        for (trace, way) in traces.iter().zip([true, false]) {
            let way = name_of(way);
            let Some(trace) = trace else {
                findings.remarks.push(format!("{run}: there is no {way} direction: G(b), D and H are absent"));
                continue;
            };
            findings.remarks.extend(told(trace, &run, way));
            self.one(trace, way, both.as_ref(), &mut sheet);
        }
        if let Some(both) = &both {
            self.both(both, &mut sheet);
        }
        let mut figures = sheet.finish(&KEYS);
        undecided(&mut figures, &faults);
        findings.figures.extend(figures);
        self.polar(&run, &traces, both.as_ref(), findings);
        Ok(())
    }

    /// Figures of both directions together.
    fn both(&self, both: &Bidirectional, sheet: &mut Sheet<'_>) {
        let (um, [one, two]) = (1e3, self.uncertainties());
        if let Some(zone) = both.minimum_zone {
            sheet.limit("G(b)", um * zone.width, two, "G_b_um");
        }
        if let Some(range) = both.about_least_squares {
            sheet.limit("G(b)_lsc", um * range, two, "G_b_lsc_um");
        }
        sheet.limit_size("D", um * both.radial_deviation(self.radius_mm), one, "D_um");
        if let Some((size, angle)) = both.hysteresis {
            sheet.limit("H", um * size, two, "H_um");
            sheet.tell("angle of H", angle.to_degrees(), "deg");
        }
        let centre = both.circle.centre;
        for (name, value) in [("centre along 0 deg", centre.x), ("centre along 90 deg", centre.y)] {
            sheet.tell(name, um * value, "um").detail = true;
        }
    }

    /// Figures of one direction.
    fn one(&self, trace: &Trace, way: &str, both: Option<&Bidirectional>, sheet: &mut Sheet<'_>) {
        let (um, [one, two]) = (1e3, self.uncertainties());
        if let Some(zone) = trace.minimum_zone() {
            sheet.limit(&format!("G_{way}"), um * zone.width, two, "G_um");
        }
        if let Some(range) = trace.about_least_squares() {
            sheet.limit(&format!("G_{way}_lsc"), um * range, two, "G_lsc_um");
        }
        if let Some(values) = trace.as_set_up(self.radius_mm) {
            for (name, value) in ["F_max", "F_min"].into_iter().zip(values) {
                sheet.limit_size(&format!("{name}_{way} as set up"), um * value, one, "F_um");
            }
        }
        if let Some(values) = both.and_then(|both| trace.about(both.circle.centre.into(), self.radius_mm)) {
            for (name, value) in ["F_max", "F_min"].into_iter().zip(values) {
                sheet.tell(&format!("{name}_{way}"), um * value, "um").standard_uncertainty = one;
            }
        }
    }

    /// The table of a polar chart: deviations from the nominal radius about the centre.
    fn polar(&self, run: &str, traces: &[Option<Trace>; 2], both: Option<&Bidirectional>, findings: &mut Findings) {
        let centre: [f64; 2] = both.map_or([0.0, 0.0], |both| both.circle.centre.into());
        let mut text = String::from("direction,angle_deg,as_set_up_um,centred_um\n");
        for (trace, way) in traces.iter().zip(["1", "-1"]) {
            for (sample, radius) in trace.iter().flat_map(|trace| trace.samples().iter().zip(trace.radii(centre))) {
                let (angle, r) = (sample.angle.to_degrees(), self.radius_mm);
                let _ = writeln!(text, "{way},{angle:.4},{:.4},{:.4}", 1e3 * (sample.radius - r), 1e3 * (radius - r));
            }
        }
        findings.tables.insert(format!("polar-{run}.csv"), text);
    }
}

impl Acceptance for Circular {
    fn findings(&self, data: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        data.iter().try_for_each(|data| self.judge(data, &mut findings))?;
        let of_run = |data: &&Dataset| -> Result<(String, f64)> {
            let [_, readings] = self.samples(data)?;
            Ok((run_name(data), 1e3 * range(&readings)))
        };
        findings.remarks.extend(far_smaller(&data.iter().map(of_run).collect::<Result<Vec<_>>>()?));
        findings.remarks.push(format!(
            "{EDITION} (its text was not at hand). A choice of this project: D, F and H count from the least squares circle of both \
             directions. G = smallest zone, `_lsc` = range about the least squares circle: both are in use"
        ));
        Ok(findings)
    }
}

/// How much further the readings of all other runs range from where on a run is asked about: feeds and planes differ, and by less than inches.
const FAR_SMALLER: f64 = 15.0;

/// A sentence on the run whose readings range over far less, um, than those of all others.
fn far_smaller(runs: &[(String, f64)]) -> Option<String> {
    let mut sorted: Vec<&(String, f64)> = runs.iter().collect();
    sorted.sort_by(|(_, one), (_, other)| one.total_cmp(other));
    let [(run, smallest), (_, next), ..] = sorted.as_slice() else { return None };
    (*next > FAR_SMALLER * smallest).then(|| {
        format!(
            "{run}: the readings range over {smallest:.2} um, and those of all other runs over {next:.1} um or more: is one of them in \
             another unit?"
        )
    })
}

/// Angles that no circle has.
fn too_many_turns(trace: &Trace) -> Option<String> {
    let turns = trace.travel() / TAU;
    (turns > MOST_TURNS).then(|| {
        format!(
            "the angles go over {turns:.1} turns, and a circle is measured over one, with an overshoot at both ends: is the unit of the \
             angle right?"
        )
    })
}

/// Angles of what is no arc: all of them are alike, or nearly.
fn hardly_an_arc(trace: &Trace) -> Option<String> {
    let mut angles: Vec<f64> = trace.samples().iter().map(|sample| sample.angle).collect();
    angles.sort_by(f64::total_cmp);
    angles.dedup_by(|next, angle| (*next - *angle).abs() < SAME_ANGLE);
    (angles.len() < FEWEST_ANGLES || trace.travel() < SHORTEST_ARC).then(|| {
        format!(
            "there are {} angles over {:.2} deg, and an arc has {FEWEST_ANGLES} over {:.0} deg at least: is this the column of the angle?",
            angles.len(),
            trace.travel().to_degrees(),
            SHORTEST_ARC.to_degrees()
        )
    })
}

/// Part of the arc of one direction that the other one has to go over: both go to and fro over one arc.
const SAME_ARC: f64 = 0.9;

/// Directions that go over different arcs: a part of one is missing.
fn unequal_arcs(traces: &[Option<Trace>; 2]) -> Option<String> {
    let [Some(ccw), Some(cw)] = traces else { return None };
    // Circles may have more overshoot in one direction.
    if ccw.is_full() && cw.is_full() {
        return None;
    }
    let [one, other] = [ccw, cw].map(Trace::travel);
    (one.min(other) < SAME_ARC * one.max(other)).then(|| {
        format!(
            "{} goes over {:.1} deg and {} over {:.1} deg: is a part of one missing?",
            name_of(true),
            one.to_degrees(),
            name_of(false),
            other.to_degrees()
        )
    })
}

/// What a trace is not.
fn told(trace: &Trace, run: &str, way: &str) -> Vec<String> {
    let mut told = Vec::new();
    if !trace.is_full() {
        told.push(format!("{run}: {way} is an arc of a circle, which has no figure but F as set up"));
    }
    if trace.left_out() > 0 {
        told.push(format!("{run}: {} samples of the overshoot of {way} are left out", trace.left_out()));
    }
    told
}

#[cfg(test)]
mod tests {
    use abbe_core::{Column, ColumnHeader, RowOrigin, Values};

    use super::*;

    /// Both directions of a circle of 150 mm in a plane, of which `change` changes the two positions.
    fn data(plane: [&str; 2], change: fn([f64; 2]) -> [f64; 2]) -> Dataset {
        let row = |row: usize| {
            let way = if row < 360 { 1.0 } else { -1.0 };
            let angle = way * (row % 360) as f64 * PI / 180.0;
            let at = change([150.0 * angle.cos() + 20.0, 150.0 * angle.sin() - 70.0]);
            [angle, at[0], at[1], 3e-3 * (2.0 * angle).sin() + 1e-3 * way + 1e-5 * (17.0 * angle).cos(), way]
        };
        let rows: Vec<[f64; 5]> = (0..720).map(row).collect();
        let numbers = |header: &str, place: usize| Column {
            header: ColumnHeader::parse(header),
            values: Values::Numbers(rows.iter().map(|row| row[place]).collect()),
        };
        let ways = Values::Labels(rows.iter().map(|row| row[4].to_string().into()).collect());
        Dataset {
            columns: vec![
                numbers("angle_deg", 0),
                numbers(plane[0], 1),
                numbers(plane[1], 2),
                numbers("reading_um", 3),
                Column { header: ColumnHeader::parse("direction"), values: ways },
            ],
            origins: (0..rows.len()).map(|row| RowOrigin { file: 0, line: row + 2, row: row + 1 }).collect(),
            files: vec!["circle.csv".into()],
            ..Dataset::default()
        }
    }

    /// The remarks, and whether all limits are decided.
    fn judged(radius: f64, data: &Dataset) -> (String, bool) {
        let settings = json!({ "radius_mm": radius, "limits": { "G_um": 100, "G_b_um": 100, "H_um": 100 } });
        let circular: Circular = abbe_core::from_settings(&settings).expect("settings");
        let found = circular.findings(&[data]).expect("findings");
        let limited = || found.figures.iter().filter(|figure| figure.limit.is_some());
        assert!(limited().count() >= 3);
        (found.remarks.join("\n"), limited().all(|figure| figure.inconclusive.is_none()))
    }

    #[test]
    fn positions_that_contradict_angles_or_the_radius_decide_nothing() {
        for plane in [["X_mm", "Y_mm"], ["Y_mm", "Z_mm"], ["Z_mm", "X_mm"]] {
            let (said, is_decided) = judged(150.0, &data(plane, |at| at));
            assert!(is_decided && !said.contains("the positions"), "{plane:?}: {said}");
            let [one, other] = plane;
            type Wrong = fn([f64; 2]) -> [f64; 2];
            let wrong: [(String, Wrong); 4] = [
                (format!("the sign of `{other}`"), |at| [at[0], -at[1]]),
                (format!("`{one}` times 2.0000"), |at| [0.5 * at[0], at[1]]),
                (format!("`{one}` and `{other}` exchanged"), |at| [at[1], at[0]]),
                ("are on a circle of 5.906 mm".to_owned(), |at| at.map(|own| own / 25.4)),
            ];
            for (words, change) in wrong {
                let (said, is_decided) = judged(150.0, &data(plane, change));
                assert!(!is_decided && said.contains(&words), "{plane:?} {words}: {said}");
            }
            let (said, is_decided) = judged(100.0, &data(plane, |at| at));
            assert!(!is_decided && said.contains("`radius_mm` is 100"), "{plane:?}: {said}");
            let (said, is_decided) = judged(1e6, &data(plane, |at| at));
            assert!(!is_decided && said.contains("`radius_mm` is 1000000"), "{plane:?}: {said}");
            let mut stretched = data(plane, |at| at);
            if let Values::Numbers(angles) = &mut stretched.columns[0].values {
                angles.iter_mut().for_each(|angle| *angle *= 1.02);
            }
            let (said, is_decided) = judged(150.0, &stretched);
            assert!(!is_decided && said.contains("off those of `angle`"), "{plane:?}: {said}");
        }
    }

    #[test]
    fn a_run_in_another_unit_beside_others_is_asked_about() {
        let runs = |ranges: &[f64]| {
            let named = ranges.iter().enumerate().map(|(number, range)| (format!("f{number}"), *range));
            named.collect::<Vec<_>>()
        };
        let told = far_smaller(&runs(&[45.0, 1.8, 40.0])).expect("a sentence");
        assert!(
            told.starts_with("f1: the readings range over 1.80 um, and those of all other runs over 40.0 um"),
            "{told}"
        );
        assert!(far_smaller(&runs(&[45.0, 0.045])).is_some());
        for good in [&[45.0, 3.1][..], &[45.0, 1.8, 1.8], &[1.8], &[]] {
            assert_eq!(far_smaller(&runs(good)), None, "{good:?}");
        }
    }

    #[test]
    fn an_arc_of_which_a_part_is_missing_decides_nothing() {
        let both = data(["A_mm", "B_mm"], |at| at);
        for (first, count, is_told) in [(360, 220, false), (400, 180, true), (360, 150, true), (365, 210, false)] {
            // 220 degrees in the positive direction, and a part of these in the other one.
            let rows: Vec<DataRow> = (0..220).chain(first..first + count).map(DataRow).collect();
            let circular: Circular =
                abbe_core::from_settings(&json!({ "radius_mm": 150, "limits": { "F_um": 100 } })).expect("settings");
            let found = circular.findings(&[&both.of_rows(&rows)]).expect("findings");
            let said = found.remarks.join("\n");
            let is_decided = found.figures.iter().all(|figure| figure.inconclusive.is_none());
            assert!(said.contains("a part of one missing") == is_told && is_decided != is_told, "{count}: {said}");
        }
    }

    #[test]
    fn what_is_hardly_an_arc_decides_nothing() {
        // An arc of so many degrees, with a reading at each `step`.
        let arc = |degrees: f64, step: f64| {
            let mut data = data(["A_mm", "B_mm"], |at| at);
            let count = (degrees / step).round() as usize + 1;
            let rows: Vec<DataRow> = (0..count).map(DataRow).collect();
            data = data.of_rows(&rows);
            data.columns[0].values = Values::Numbers((0..count).map(|row| (row as f64 * step).to_radians()).collect());
            let settings = json!({ "radius_mm": 150, "limits": { "F_um": 100 } });
            let circular: Circular = abbe_core::from_settings(&settings).expect("settings");
            let found = circular.findings(&[&data]).expect("findings");
            let is_decided = found.figures.iter().all(|figure| figure.inconclusive.is_none());
            (found.remarks.join("\n"), is_decided)
        };
        for (degrees, step) in [(20.0, 1.0), (90.0, 10.0), (220.0, 2.0)] {
            let (said, is_decided) = arc(degrees, step);
            assert!(is_decided && !said.contains("column of the angle"), "{said}");
        }
        for (degrees, step) in [(0.0, 1.0), (5.0, 0.1), (90.0, 30.0)] {
            let (said, is_decided) = arc(degrees, step);
            assert!(!is_decided && said.contains("column of the angle"), "{degrees} {step}: {said}");
        }
    }
}
