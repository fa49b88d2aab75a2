//! Artefact plugin `balls`: balls touched with the machine's probe, or their centres fitted already.
//!
//! Equations: one touch `|p - P - c| - R - f - r = 0`; a fitted centre `p - P - c = 0` (three equations); a calibrated
//! distance between two balls `|P2 + c2 - P1 - c1| - L = 0`. p is the tip and P the nominal centre in the table frame, c
//! the ball's own offset, R its radius, f its form, r the effective stylus radius.
//!
//! Plugin `rings`: the inside of rings.

mod centres;
mod form;
mod rings;
mod size;
mod touches;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    AboveZero, Artefact, ColumnHeader, Contact, Context, DataRow, Dataset, Error, Feature, InputFile, KinematicModel,
    KnownInput, Label, Layout, Observations, ObservationsInfo, Parameter, PathItem, Quantity, Result, SettingsError,
    Target, Unit, not_negative, plain_naming, pose_columns, positive,
};
use abbe_dcc::CertifiedLength;
use abbe_probe::EffectiveRadius;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use form::Form;
use size::{Diameter, Quantities, Size, sizes};
use touches::{TouchedBall, Touches};

abbe_core::register!(
    Artefact,
    "balls",
    "touches on balls or their fitted centres, with calibrated distances between balls",
    Settings,
    example,
    build,
    "../reference/artefact-balls.md",
);

/// Settings of the balls.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the nominal balls: feature, x_mm, y_mm, z_mm, diameter_mm in the table frame.
    nominal: String,
    /// Standard uncertainty of one touch, or of each coordinate of a centre.
    #[schemars(with = "AboveZero")]
    standard_uncertainty_um: f64,
    /// What a data row is.
    #[serde(default)]
    rows: Rows,
    /// Fit the centre of every ball first, from its touches with the same label in this column (the indexation), and
    /// use the centres as observations instead of the touches.
    #[serde(default)]
    centres_by: Option<String>,
    /// Whether the radius of every ball is known or estimated (`ball[1].radius`, its deviation from nominal).
    #[serde(default)]
    radius: Radius,
    /// Diameters that are estimated (`ball[1].diameter`) or stated by a certificate with uncertainty.
    #[serde(default)]
    diameters: Vec<Diameter>,
    /// Terms of the form of the balls, in the table frame: `cos2`, `sin3,1` (`ball[1].form[cos2]`).
    #[serde(default)]
    form: Vec<String>,
    /// Calibrated distances between centres.
    #[serde(default)]
    distances: Vec<Distance>,
    /// Standard uncertainty of the effective stylus radius, shared by all touches.
    #[serde(default)]
    stylus_radius_standard_uncertainty_um: f64,
    /// The touches on every ball that `abbe plan` generates.
    #[serde(default)]
    pattern: Pattern,
}

/// Touches on a ball.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Pattern {
    /// Four on the equator and one on the pole (Rahman 2016, section 2.3.3.6): the place of the ball.
    #[default]
    Five,
    /// The 25 points of ISO 10360-5 on a hemisphere: its size and its form as well, which tell squareness and scales.
    TwentyFive,
}

impl Pattern {
    /// Outward normals at the places that are touched, table frame.
    fn normals(self) -> Vec<Vector3<f64>> {
        let diagonal = std::f64::consts::FRAC_1_SQRT_2;
        match self {
            Self::Five => [(1.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (0.0, 0.0, 1.0)]
                .map(|(x, y, z): (f64, f64, f64)| Vector3::new(diagonal * x, diagonal * y, z))
                .to_vec(),
            Self::TwentyFive => abbe_standards::probing::hemisphere_of_25().map(Vector3::from).to_vec(),
        }
    }
}

/// What a data row is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Rows {
    /// One touch.
    #[default]
    Touches,
    /// The machine position with the tip at the centre of a ball.
    Centres,
}

/// Whether the radius is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Radius {
    /// It is known: that of the nominal file.
    #[default]
    Known,
    /// It is estimated.
    Estimated,
}

/// A calibrated distance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Distance {
    /// The two balls.
    between: [Label; 2],
    /// Distance of their centres.
    #[serde(default)]
    #[schemars(range(min = 1e-3, max = 1e6))]
    length_mm: Option<f64>,
    /// Its standard uncertainty.
    #[serde(default)]
    #[schemars(with = "Option<AboveZero>")]
    standard_uncertainty_um: Option<f64>,
    /// The digital calibration certificate that states both, in their place.
    #[serde(default)]
    certificate: Option<CertifiedLength>,
}

impl Distance {
    /// Fails unless it is given by numbers or by a certificate, whose file is found.
    fn check(&mut self, context: &Context) -> Result<(), SettingsError> {
        match (&mut self.certificate, self.length_mm, self.standard_uncertainty_um) {
            (None, Some(length), Some(uncertainty)) => {
                positive("length_mm", length)?;
                positive("standard_uncertainty_um", uncertainty)?;
            }
            (Some(certificate), None, None) => {
                let under = |error: SettingsError| error.under([PathItem::Key("certificate".to_owned())]);
                certificate.resolve(context).map_err(under)?;
            }
            (None, ..) => {
                let message = "`length_mm` and `standard_uncertainty_um` were expected, or `certificate`";
                return Err(SettingsError::new("", message));
            }
            (Some(_), ..) => {
                let error = SettingsError::new("certificate", "it states the length and its uncertainty");
                return Err(error.help("leave out `length_mm` and `standard_uncertainty_um`"));
            }
        }
        if self.between[0] == self.between[1] {
            return Err(SettingsError::new("between", "two different balls were expected"));
        }
        Ok(())
    }

    /// The distance as a known input.
    fn input(&self) -> Result<KnownInput> {
        let [from, to] = &self.between;
        let name = format!("length[{}-{}]", from.0, to.0);
        if let Some(certificate) = &self.certificate {
            return certificate.input_of(&name);
        }
        // Settings without a certificate have both numbers.
        let length = self.length_mm.unwrap_or_default();
        let uncertainty = self.standard_uncertainty_um.unwrap_or_default() * 1e-3;
        let content = format!("distance of balls {} and {}: {length:e} mm, u = {uncertainty:e} mm", from.0, to.0);
        let parameter = Parameter::new(&name, Unit::MM);
        Ok(KnownInput::new(parameter, length, uncertainty).with_certificate(name, content))
    }
}

fn example() -> Value {
    json!({
        "nominal": "balls.csv",
        "standard_uncertainty_um": 1.0,
        "distances": [{ "between": [1, 2], "length_mm": 304.6686, "standard_uncertainty_um": 0.5 }],
    })
}

fn build(mut settings: Settings, context: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    not_negative("stylus_radius_standard_uncertainty_um", settings.stylus_radius_standard_uncertainty_um)?;
    if settings.centres_by.is_some() && settings.rows == Rows::Centres {
        return Err(SettingsError::new("centres_by", "the rows are centres already"));
    }
    if settings.rows == Rows::Centres && settings.stylus_radius_standard_uncertainty_um > 0.0 {
        let message = "how the centres depend on the stylus radius is not known: their touches are";
        return Err(SettingsError::new("stylus_radius_standard_uncertainty_um", message)
            .help("fit them from touches with `centres_by`, or state what their rows share under `uncertainty`"));
    }
    if settings.centres_by.is_some() && settings.radius == Radius::Estimated {
        return Err(SettingsError::new("centres_by", "centres are fitted with known radii; they cannot tell radii")
            .help("leave out `centres_by`, or `radius: estimated`"));
    }
    if settings.radius == Radius::Estimated && !settings.diameters.is_empty() {
        return Err(SettingsError::new("diameters", "`radius: estimated` estimates all sizes already"));
    }
    let centres = settings.centres_by.is_some() || settings.rows == Rows::Centres;
    for (setting, none) in [("diameters", settings.diameters.is_empty()), ("form", settings.form.is_empty())] {
        if centres && !none {
            return Err(SettingsError::new(setting, "this belongs to touches, and centres are observed here"));
        }
    }
    size::check(&mut settings.diameters, context)?;
    let form = Form::read(&settings.form)?;
    for index in 0..settings.distances.len() {
        let at = |error: SettingsError| error.under([PathItem::Key("distances".to_owned()), PathItem::Index(index)]);
        let (earlier, rest) = settings.distances.split_at_mut(index);
        let distance = &mut rest[0];
        distance.check(context).map_err(at)?;
        let [one, other] = &distance.between;
        let same = |earlier: &Distance| earlier.between.contains(one) && earlier.between.contains(other);
        if earlier.iter().any(same) {
            return Err(at(SettingsError::new("between", "the distance of these balls stands here a second time")));
        }
    }
    Ok(Box::new(Balls { nominal: context.path(&settings.nominal), settings, form }))
}

/// Names the distance that causes an error, at its balls, or at one of the two.
fn at_distance(mut error: Error, index: usize, ball: Option<usize>) -> Error {
    let key = |name: &str| PathItem::Key(name.to_owned());
    error.setting = vec![key("distances"), PathItem::Index(index), key("between")];
    error.setting.extend(ball.map(PathItem::Index));
    error
}

struct Balls {
    nominal: PathBuf,
    settings: Settings,
    form: Form,
}

/// A nominal ball, table frame.
#[derive(Debug, Clone, PartialEq)]
struct Ball {
    label: String,
    centre: Vector3<f64>,
    radius: f64,
}

impl Balls {
    fn read_nominal(&self) -> Result<Vec<Ball>> {
        let table = abbe_table::read(&self.nominal)?;
        abbe_table::unique_labels(&table, "feature")?;
        let labels = abbe_table::labels(&table, "feature")?;
        let points = abbe_table::points(&table, ["x", "y", "z"])?;
        let diameters = abbe_table::numbers(&table, "diameter", Quantity::Length)?;
        let rows = DataRow::enumerate(labels.iter().zip(points).zip(diameters));
        rows.map(|(row, ((label, point), diameter))| {
            if *diameter <= 0.0 {
                return Err(table.error_at(row, format!("ball {label} has the diameter {diameter} mm")));
            }
            Ok(Ball { label: label.to_string(), centre: Vector3::from(point), radius: diameter / 2.0 })
        })
        .collect()
    }

    /// The ball of every data row: by the column `feature`, or the only ball there is.
    fn ball_of_rows(&self, data: &Dataset, nominal: &[Ball]) -> Result<Vec<Option<usize>>> {
        if data.column("feature").is_none() && nominal.len() == 1 {
            return Ok(vec![Some(0); data.rows()]);
        }
        let by_label: BTreeMap<&str, usize> =
            nominal.iter().enumerate().map(|(index, ball)| (ball.label.as_str(), index)).collect();
        Ok(abbe_table::labels(data, "feature")?.iter().map(|label| by_label.get(label.as_str()).copied()).collect())
    }
}

impl Balls {
    /// The certificates of diameters and distances.
    fn certificates(&self) -> impl Iterator<Item = &CertifiedLength> {
        let diameters = self.settings.diameters.iter().filter_map(|diameter| diameter.certificate.as_ref());
        diameters.chain(self.settings.distances.iter().filter_map(|distance| distance.certificate.as_ref()))
    }

    /// Whether a row of the equations is one touch.
    fn touches_are_rows(&self) -> bool {
        self.settings.centres_by.is_none() && self.settings.rows == Rows::Touches
    }

    /// The effective stylus radius of the rows; that of centres is the same in all directions.
    fn effective_radius(&self, model: &dyn KinematicModel, layout: &Layout) -> Result<EffectiveRadius> {
        let uncertainty = self.settings.stylus_radius_standard_uncertainty_um * 1e-3;
        if self.touches_are_rows() {
            return EffectiveRadius::new(model, layout, uncertainty);
        }
        if self.settings.centres_by.is_some() && abbe_probe::has_terms(model) {
            let message = "centres are fitted with one stylus radius for all directions, and the model has a `probe`";
            return Err(Error::usage(message)
                .setting("centres_by")
                .help("leave `centres_by` out: touches are observations then"));
        }
        Ok(EffectiveRadius::constant(model, uncertainty))
    }

    /// Data rows as they are, with the ball of each.
    fn rows(
        &self,
        data: &Arc<Dataset>,
        model: &dyn KinematicModel,
        touched: &[(DataRow, usize)],
        uncertainty: f64,
    ) -> Result<(Layout, Vec<usize>)> {
        let mut layout = Layout::new(data, model, &[&plain_naming])?;
        let uncertainties = match self.settings.rows {
            Rows::Touches => vec![uncertainty],
            Rows::Centres => vec![uncertainty; 3],
        };
        for (row, _) in touched {
            layout.push(model, *row, &uncertainties)?;
        }
        Ok((layout, touched.iter().map(|(_, ball)| *ball).collect()))
    }
}

impl Artefact for Balls {
    fn inputs(&self) -> Vec<InputFile> {
        let nominal = InputFile { setting: "nominal", path: self.nominal.clone() };
        [nominal].into_iter().chain(self.certificates().map(CertifiedLength::input)).collect()
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &plain_naming)?;
        self.certificates().try_for_each(CertifiedLength::tell)?;
        if self.touches_are_rows() {
            abbe_probe::check_columns(headers, file, model)?;
        }
        let nominal = abbe_table::read_headers(&self.nominal)?;
        let columns = [
            ("feature", Quantity::Label),
            ("x", Quantity::Length),
            ("y", Quantity::Length),
            ("z", Quantity::Length),
            ("diameter", Quantity::Length),
        ];
        abbe_table::require(&nominal, Some(&self.nominal), &columns)
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        self.observe_some(data, model)?.ok_or_else(|| abbe_table::untouched(&self.nominal))
    }

    fn observe_some(
        &self,
        data: &Arc<Dataset>,
        model: &Arc<dyn KinematicModel>,
    ) -> Result<Option<Arc<dyn Observations>>> {
        let model = model.as_ref();
        let nominal = self.read_nominal()?;
        let uncertainty = self.settings.standard_uncertainty_um * 1e-3;
        let of_rows = self.ball_of_rows(data, &nominal)?;
        let Some(touched) = abbe_table::touched_by_some(&of_rows) else { return Ok(None) };
        let balls: Vec<Ball> = touched.features.iter().map(|&ball| nominal[ball].clone()).collect();
        let (mut layout, ball_of_row, centre_by_radius) = match &self.settings.centres_by {
            Some(by) => {
                let found = centres::of_touches(data, model, &touched.rows, &balls, by, uncertainty)?;
                (found.layout, found.ball_of_row, found.by_radius)
            }
            None => {
                let (layout, balls) = self.rows(data, model, &touched.rows, uncertainty)?;
                (layout, balls, Vec::new())
            }
        };

        let radius = self.effective_radius(model, &layout)?;
        let mut quantities = Quantities { inputs: radius.inputs().to_vec(), ..Quantities::default() };
        let mut features = Vec::new();
        let mut touched_balls = Vec::new();
        for ball in &balls {
            let name = |own: &str| format!("ball[{}].{own}", ball.label);
            let [first, ..] = ["x", "y", "z"].map(|axis| quantities.unknown(name(axis), 0.0));
            let radius = ball.radius;
            let estimated = self.settings.radius == Radius::Estimated;
            let deviation = estimated.then(|| Size::Deviation(radius, quantities.unknown(name("radius"), 0.0)));
            let form = quantities.unknowns.len();
            for term in self.form.names() {
                quantities.unknown(name(&format!("form[{term}]")), 0.0);
            }
            let size = deviation.unwrap_or(Size::Known(radius));
            touched_balls.push(TouchedBall { centre: ball.centre, first, size, form });
            features.push(Feature {
                label: ball.label.clone(),
                point: ball.centre.into(),
                shifts: vec![(first, [1.0, 0.0, 0.0]), (first + 1, [0.0, 1.0, 0.0]), (first + 2, [0.0, 0.0, 1.0])],
            });
        }
        let first_distance = quantities.inputs.len();
        let mut distances = Vec::new();
        for (index, distance) in self.settings.distances.iter().enumerate() {
            let find = |place: usize| {
                let label = &distance.between[place].0;
                balls.iter().position(|ball| ball.label == *label).ok_or_else(|| {
                    let what = "which was not touched, or has no nominal centre";
                    let error = Error::data(format!("`distances` names ball {label}, {what}"))
                        .suggest(label, balls.iter().map(|ball| ball.label.as_str()));
                    at_distance(error, index, Some(place))
                })
            };
            let (one, other) = (find(0)?, find(1)?);
            if balls[one].centre == balls[other].centre {
                let [from, to] = &distance.between;
                let message = format!("balls {} and {} have the same nominal centre, and a distance", from.0, to.0);
                return Err(at_distance(Error::data(message), index, None));
            }
            distances.push((one, other));
            let input = distance.input()?;
            layout.push_constraint(&[input.standard_uncertainty]);
            quantities.inputs.push(input);
        }
        let rows = if self.settings.centres_by.is_some() { Rows::Centres } else { self.settings.rows };
        let labels: Vec<(&str, f64)> = balls.iter().map(|ball| (ball.label.as_str(), 2.0 * ball.radius)).collect();
        let (of_settings, diameters) = sizes(&self.settings.diameters, "ball", &labels, &mut quantities, &mut layout)?;
        for (ball, size) in touched_balls.iter_mut().zip(of_settings) {
            if !matches!(ball.size, Size::Deviation(..)) {
                ball.size = size;
            }
        }
        let Quantities { unknowns, start, inputs } = quantities;
        let orientation = radius.orientation();
        let info = ObservationsInfo {
            start,
            inputs,
            features,
            orientation,
            ..ObservationsInfo::new(layout, unknowns, Contact::LinearAxes)
        };
        let balls = touched_balls;
        let form = self.form.clone();
        Ok(Some(Arc::new(Touches {
            info,
            balls,
            ball_of_row,
            centre_by_radius,
            distances,
            first_distance,
            diameters,
            rows,
            radius,
            form,
        })))
    }

    /// Centres that are fitted have several rows, and what certificates state holds for all rows.
    fn rows_are_independent(&self) -> bool {
        let Settings { centres_by, distances, diameters, .. } = &self.settings;
        centres_by.is_none() && distances.is_empty() && diameters.is_empty()
    }

    fn targets(&self, stylus_radius: f64) -> Result<Vec<Target>> {
        let outward = self.settings.pattern.normals();
        let mut targets = Vec::new();
        for ball in self.read_nominal()? {
            let centre = Target { feature: ball.label.clone(), tip: ball.centre.into(), approach: None };
            match self.settings.rows {
                Rows::Centres => targets.push(centre),
                Rows::Touches => targets.extend(outward.iter().map(|normal| Target {
                    feature: ball.label.clone(),
                    tip: (ball.centre + (ball.radius + stylus_radius) * normal).into(),
                    approach: Some((-normal).into()),
                })),
            }
        }
        Ok(targets)
    }
}
