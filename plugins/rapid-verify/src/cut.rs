//! Validator `verify-cut`: the stock that a roughing or pre-finishing cut left, probed on the machine, against the allowance that was
//! planned (Muelaner et al. 2014, sections 3.3 and 4.1).
//!
//! A kinematic error of the machine moves cut and probe alike and is not visible here: run `verify` before.

use std::path::PathBuf;

use abbe_core::{
    Context, DataRow, Dataset, Error, Figure, Findings, Fit, InputFile, Limit, PoseTable, Quantity, Result,
    SettingsError, Validate, plain_naming, pose_columns, positive,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::points::{Points, Touch, holds_trigger};

abbe_core::register!(
    Validate,
    "verify-cut",
    "the stock that a pre-finishing cut left, against the planned allowance, point by point",
    Settings,
    example,
    build,
    "../reference/validate-verify-cut.md",
);

/// Settings of the check.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of points on the finished surface, as for `probed-points`; its column `stock_mm`, if there is one, has the
    /// allowance of each point.
    nominal: String,
    /// Allowance of points for which the file has none: the stock that has to be left on the finished surface, along
    /// its normal.
    #[serde(default)]
    stock_mm: Option<f64>,
    /// Largest admissible difference between stock and allowance.
    tolerance_um: Limit,
}

fn example() -> Value {
    json!({ "nominal": "part.csv", "stock_mm": 0.3, "tolerance_um": 20 })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    positive("tolerance_um", settings.tolerance_um.value)?;
    settings.stock_mm.map_or(Ok(0.0), |stock| abbe_core::not_negative("stock_mm", stock))?;
    Ok(Box::new(VerifyCut { nominal: context.path(&settings.nominal), settings }))
}

struct VerifyCut {
    nominal: PathBuf,
    settings: Settings,
}

impl Validate for VerifyCut {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "nominal", path: self.nominal.clone() }]
    }

    fn accepts_data(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        let [fit] = fits else {
            return Err(Error::usage("one estimate was expected: that of the machine").setting("of"));
        };
        if data.is_empty() {
            let error = Error::usage("`from` is missing: the ingest stage of the touches on the part");
            return Err(error.setting("of").help("add `from: <ingest stage>`"));
        }
        let points = Points::read(&self.nominal)?;
        let allowances = self.allowances(&points)?;
        self.leaves_stock(&points, &allowances)?;
        let mut findings = Findings::default();
        let (mut worst, mut out, mut count) = (0.0_f64, 0, 0);
        let mut touched = vec![false; points.list.len()];
        for data in data {
            for (point, stock) in stocks(fit, &points, data)? {
                touched[point] = true;
                let (label, allowance) = (&points.list[point].label, allowances[point]);
                // A picometre is rounded away: binary fractions do not hold decimal ones.
                let off = ((stock - allowance) * 1e9).round() / 1e6;
                count += 1;
                worst = worst.max(off.abs());
                findings.figures.push(Figure::new(&fit.name, format!("stock[{label}]"), stock, "mm").detail());
                if off.abs() > self.settings.tolerance_um.value {
                    out += 1;
                    findings.remarks.push(format!("{label}: no-go: {}", advice(stock, allowance)));
                } else if stock < 0.0 {
                    findings.remarks.push(format!(
                        "{label}: go, and {:.1} µm below the finished surface: nothing is left to finish; {allowance} mm of stock planned",
                        -1e3 * stock
                    ));
                } else {
                    findings.remarks.push(format!("{label}: go: {stock:.4} mm of stock, {allowance} mm planned"));
                }
            }
        }
        if count == 0 {
            return Err(Error::data("no row touches a point of the part"));
        }
        let mut largest = Figure::new(&fit.name, "largest deviation", worst, "um").limited(self.settings.tolerance_um);
        if largest.passes() {
            largest.inconclusive = untouched(&points, &touched);
        }
        let figures = [
            largest,
            Figure::new(&fit.name, "points", f64::from(count), "1"),
            Figure::new(&fit.name, "points out", f64::from(out), "1"),
        ];
        findings.figures.splice(0..0, figures);
        Ok(findings)
    }
}

impl VerifyCut {
    /// Refuses a tolerance that accepts a point without any stock, where stock was planned.
    fn leaves_stock(&self, points: &Points, allowances: &[f64]) -> Result<()> {
        let planned = || points.data.row_indices().zip(allowances).filter(|(_, allowance)| **allowance > 0.0);
        let Some((row, least)) = planned().min_by(|one, other| one.1.total_cmp(other.1)) else { return Ok(()) };
        let (label, tolerance) = (&points.list[row.0].label, self.settings.tolerance_um.value);
        let least = (1e9 * least).round() / 1e6;
        if tolerance < least {
            return Ok(());
        }
        let message = format!(
            "{tolerance} um: a tolerance below the stock that is planned, {least} um at point {label}, was expected: with this one a cut \
             below the finished surface passes"
        );
        Err(Error::usage(message).setting("tolerance_um").help("is it in micrometres, and `stock_mm` in millimetres?"))
    }

    /// The allowance of every point, mm.
    fn allowances(&self, points: &Points) -> Result<Vec<f64>> {
        if points.data.column("stock").is_some() {
            return abbe_table::numbers(&points.data, "stock", Quantity::Length).map(<[f64]>::to_vec);
        }
        let stock = self.settings.stock_mm.ok_or_else(|| {
            Error::usage("there is no allowance").setting("nominal").help("add `stock_mm: 0.3`, or a column `stock_mm`")
        })?;
        Ok(vec![stock; points.list.len()])
    }
}

/// The reason why points that were not touched leave the cut undecided; none if all were.
fn untouched(points: &Points, touched: &[bool]) -> Option<String> {
    let left = points.list.iter().zip(touched).filter(|(_, touched)| !**touched);
    let labels: Vec<&str> = left.map(|(point, _)| point.label.as_str()).collect();
    let (first, count) = (labels.first()?, labels.len());
    Some(format!(
        "{count} of {} points {} not touched, first {first}: leave out of the nominal file what is not to be judged",
        touched.len(),
        if count == 1 { "was" } else { "were" }
    ))
}

/// How far beside its nominal point a point may be touched, mm: there is another place of the surface.
const BESIDE: f64 = 1.0;

/// The stock at every touched point (its index), mm: the distance of the surface from the finished one.
fn stocks(fit: &Fit, points: &Points, data: &Dataset) -> Result<Vec<(usize, f64)>> {
    let problem = fit.problem.starting_from(&fit.calibration);
    let model = problem.model.as_ref();
    let columns = pose_columns(&data.headers(), data.files.first(), model, &plain_naming)?;
    let measured =
        data.column("measured").map(|_| abbe_table::numbers(data, "measured", Quantity::Length)).transpose()?;
    let by_label = points.by_label();
    let (mut found, mut touched) = (Vec::new(), Vec::new());
    for (row, label) in DataRow::enumerate(abbe_table::labels(data, "point")?) {
        let Some(&index) = by_label.get(label.as_str()) else {
            return Err(data.error_at(row, format!("point {label} is not in {}", file_name(points))));
        };
        let mut table = PoseTable::new(model);
        let pose = table.end();
        table.push(data, row, model, &columns)?;
        let mut touch = Touch::new(model, &points.list[index], table.row(pose))?;
        if let Some(measured) = measured {
            touched.push((row, points.list[index].axis.as_str(), measured[row]));
            touch.status[model.info().axes[touch.axis].status] = measured[row];
        }
        if found.iter().any(|(earlier, _)| *earlier == index) {
            return Err(data.error_at(row, format!("point {label} is touched a second time")));
        }
        let beside = touch.beside_here(&problem.machine_values)?;
        if beside > BESIDE || beside.is_nan() {
            let message = format!("point {label} is touched {beside:.1} mm beside its nominal point");
            return Err(data
                .error_at(row, message)
                .help("are the labels right, and is this the part of the nominal file?"));
        }
        found.push((index, touch.distance_here(&problem.machine_values)? - model.info().stylus_radius));
    }
    holds_trigger(data, &touched)?;
    Ok(found)
}

fn file_name(points: &Points) -> String {
    points.data.files.first().map_or_else(|| "the nominal file".to_owned(), |file| file.display().to_string())
}

/// What to do about stock that is not what was planned.
fn advice(stock: f64, allowance: f64) -> String {
    let off = (stock - allowance) * 1e3;
    if stock <= 0.0 {
        return format!(
            "the cut is {:.1} µm below the finished surface: nothing is left to finish; check tool, offsets and program",
            -stock * 1e3
        );
    }
    if off > 0.0 {
        return format!(
            "{off:.1} µm too much stock: the tool gave way, is worn, or is shorter or thinner than it was set; repeat the cut before finishing"
        );
    }
    format!(
        "{:.1} µm too little stock, {stock:.4} mm are left: the tool is longer or thicker than it was set, runs out, or an offset is \
         wrong; correct it before finishing",
        -off
    )
}
