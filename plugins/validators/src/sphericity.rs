//! Validator `sphericity`: the machine as a measuring machine, on a sphere that is fixed on the table and touched at many
//! indexations (Rahman 2016, chapter 6).
//!
//! Perfect tips of a perfect model lie on one sphere. The residuals of the least squares sphere show the errors of the model:
//! for the nominal model all errors of the machine, for a calibrated model those that it does not describe.

use abbe_core::{
    Context, DataRow, Dataset, Error, Figure, Findings, Fit, KinematicModel, PathItem, Result, SettingsError, Validate,
    positive,
};
use abbe_estimation::pasted_rows;
use abbe_geometry::{Fitted, Sphere};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::{Limits, MM, ONE, Sample, UM, apply_limits, check_limits, outliers};
use crate::folds::set_of;
use crate::one_at_a_time::{Programme, Sensitivity};
use crate::sphere_touches::Touches;

abbe_core::register!(
    Validate,
    "sphericity",
    "form and size of a sphere as the machine measures it, by the nominal and by the calibrated model",
    Settings,
    example,
    build,
    "../reference/validate-sphericity.md",
);

/// Settings of the sphericity.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The artefact stage whose touches on spheres are evaluated. Default: the data under `from` are evaluated.
    #[serde(default)]
    rows: Option<String>,
    /// Diameter of the spheres of the data under `from`. If it is missing, no size error is reported.
    #[serde(default)]
    diameter_mm: Option<f64>,
    /// A column for whose labels spheres are fitted separately: programmes of measurement.
    #[serde(default)]
    column: Option<String>,
    /// The effect of single errors of the machine on what its nominal model measures.
    #[serde(default)]
    sensitivity: Option<Sensitivity>,
    /// Largest admissible values for the calibrated model: `out_of_sphericity_um`, `standard_deviation_um`,
    /// `absolute_size_error_um`, `outliers`.
    #[serde(default)]
    limits: Limits,
}

/// The name of the model whose parameters are all zero.
const NOMINAL: &str = "nominal";

fn example() -> Value {
    json!({
        "rows": "sphere",
        "sensitivity": { "parameters": ["E?0?", "EXX[1]"], "um": 1, "urad": 2.5, "um_per_m": 2.5 },
        "limits": { "out_of_sphericity_um": 10, "standard_deviation_um": 2 }
    })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    if let Some(diameter) = settings.diameter_mm {
        positive("diameter_mm", diameter)?;
        if settings.rows.is_some() {
            return Err(SettingsError::new("diameter_mm", "the artefact under `rows` says how large its spheres are"));
        }
    }
    if let Some(sensitivity) = &settings.sensitivity {
        sensitivity.check().map_err(|error| error.under([PathItem::Key("sensitivity".to_owned())]))?;
    }
    let keys = ["out_of_sphericity_um", "standard_deviation_um", "absolute_size_error_um", "outliers"];
    check_limits(&settings.limits, &keys)?;
    Ok(Box::new(Sphericity { settings }))
}

struct Sphericity {
    settings: Settings,
}

impl Validate for Sphericity {
    fn observations(&self) -> Vec<(&'static str, String)> {
        self.settings.rows.iter().map(|rows| ("rows", rows.clone())).collect()
    }

    fn accepts_data(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        // Nominal figures of several fits are the same, unless the models or the outliers differ.
        let mut nominal: Vec<Vec<Figure>> = Vec::new();
        for fit in fits {
            let (touches, skipped) = self.touches(fit, data)?;
            findings.remarks.extend(data.iter().find_map(|data| of_the_fit(fit, data)));
            let model = fit.problem.model.as_ref();
            let zero = &model.info().nominal;
            let mut of_nominal = Form::all(&touches, model, zero)?.figures(NOMINAL, model.info().stylus_radius);
            if !nominal.contains(&of_nominal) {
                nominal.push(of_nominal.clone());
                if nominal.len() > 1 {
                    let name = format!("{NOMINAL} of {}", fit.name);
                    of_nominal.iter_mut().for_each(|figure| figure.of = Some(name.clone()));
                }
                findings.figures.extend(of_nominal);
            }
            let values = fit.problem.starting_from(&fit.calibration).machine_values;
            let form = Form::all(&touches, model, &values)?;
            findings.remarks.extend(form.doubted_size(&fit.name, model.info().stylus_radius));
            let mut figures = form.figures(&fit.name, model.info().stylus_radius);
            figures.extend(skipped.map(|skipped| Figure::new(&fit.name, "outliers", skipped as f64, ONE)));
            apply_limits(&self.settings.limits, &mut figures);
            findings.figures.extend(figures);
            if let Some(sensitivity) = &self.settings.sensitivity {
                self.single_errors(fit, sensitivity, &touches, &mut findings).map_err(|mut error| {
                    error.setting.insert(0, PathItem::Key("sensitivity".to_owned()));
                    error
                })?;
            }
        }
        self.check_limits(&findings)?;
        Ok(findings)
    }
}

/// A sentence on rows that went into the fit, which they cannot judge as others do.
fn of_the_fit(fit: &Fit, data: &Dataset) -> Option<String> {
    let rows: Vec<DataRow> = data.row_indices().collect();
    let words = fit.problem.sets.iter().find_map(|set| {
        let layout = &set.info().layout;
        if let Some(file) = data.files.iter().find(|file| layout.data.files.contains(file)) {
            return Some(format!("those of `{}`", file.display()));
        }
        let known: Vec<DataRow> = set.rows.iter().filter_map(|row| layout.rows[*row].data_row).collect();
        pasted_rows([data, &layout.data], [&rows, &known])
    })?;
    Some(format!(
        "`{}` was estimated from rows that it is judged by here, of which nothing is predicted: {words}",
        fit.name
    ))
}

impl Sphericity {
    /// The touches to judge and, for a fit's own rows, the number of outliers that are left out.
    fn touches(&self, fit: &Fit, data: &[&Dataset]) -> Result<(Vec<Touches>, Option<usize>)> {
        let column = self.settings.column.as_deref();
        let model = fit.problem.model.as_ref();
        match (&self.settings.rows, data) {
            (Some(stage), []) => {
                let set = set_of(fit, "rows", stage)?;
                let left_out = outliers(&fit.problem, &fit.calibration);
                let touches = Touches::of_rows(fit, set, |row| left_out.contains(&(set, row)), column)?;
                Ok((touches, Some(left_out.iter().filter(|(of, _)| *of == set).count())))
            }
            (None, [data]) => {
                let reach = self.settings.diameter_mm.map(|diameter| diameter / 2.0 + model.info().stylus_radius);
                Ok((Touches::of_data(data, model, reach, column)?, None))
            }
            (Some(_), _) => {
                Err(Error::usage("either `rows` or data under `from` are judged, not both").setting("rows"))
            }
            (None, data) => {
                let message = format!(
                    "`rows`, an artefact stage, or one ingest stage under `from` was expected, not {}",
                    data.len()
                );
                Err(Error::usage(message))
            }
        }
    }

    /// Adds the table of single errors.
    fn single_errors(
        &self,
        fit: &Fit,
        sensitivity: &Sensitivity,
        touches: &[Touches],
        findings: &mut Findings,
    ) -> Result<()> {
        let model = fit.problem.model.as_ref();
        let programmes = touches.iter().map(|touches| Programme::of(touches, model)).collect::<Result<Vec<_>>>()?;
        let mut worst: Option<(String, f64)> = None;
        for error in sensitivity.errors(model)? {
            let spheres = touches.iter().zip(&programmes).map(|(touches, programme)| {
                Ok(Measured::new(touches, touches.through(&programme.measured_with(&error)?)?))
            });
            let form: Form = spheres.collect::<Result<_>>()?;
            let (range, size) = (form.out_of_sphericity(), form.size_error());
            let figure = |name: &str, value| Figure::new(&fit.name, format!("{name}[{}]", error.name), value, UM);
            findings.figures.extend(size.map(|size| figure("size error", size)));
            findings.figures.push(figure("out of sphericity", range));
            if worst.as_ref().is_none_or(|(_, largest)| range > *largest) {
                worst = Some((error.name.clone(), range));
            }
        }
        findings.remarks.extend(worst.map(|(name, range)| {
            format!("{}: of single errors {name} does most to the sphericity ({range:.2} µm)", fit.name)
        }));
        Ok(())
    }

    /// Refuses a limit of the size where no size is known.
    fn check_limits(&self, findings: &Findings) -> Result<()> {
        let absolute = |figure: &Figure| figure.name == "absolute size error";
        if self.settings.limits.contains_key("absolute_size_error_um") && !findings.figures.iter().any(absolute) {
            let mut error = Error::usage("without `diameter_mm` there is no size error to limit");
            error.setting = ["limits", "absolute_size_error_um"].map(|key| PathItem::Key(key.to_owned())).to_vec();
            return Err(error);
        }
        Ok(())
    }
}

/// A sphere as it is measured.
struct Measured {
    label: String,
    fitted: Fitted<Sphere>,
    /// Fitted less nominal radius, µm; none if that is not known.
    size_error: Option<f64>,
}

/// The spheres as one model has them.
struct Form(Vec<Measured>);

impl Form {
    /// The least squares spheres through the tips by the model with these values.
    fn all(touches: &[Touches], model: &dyn KinematicModel, values: &[f64]) -> Result<Self> {
        touches.iter().map(|touches| Ok(Measured::new(touches, touches.sphere(model, values)?))).collect()
    }

    /// The figures of all spheres together, the worst of them, and of each as details.
    fn figures(&self, of: &str, stylus_radius: f64) -> Vec<Figure> {
        let sample = |value: fn(&Measured) -> f64| Sample(self.0.iter().map(value).collect());
        let new = |name: &str, value, unit| Figure::new(of, name, value, unit);
        let mut figures = vec![
            new("out of sphericity", self.out_of_sphericity(), UM),
            new("max", sample(|sphere| sphere.fitted.max() * 1e3).max(), UM),
            new("min", sample(|sphere| sphere.fitted.min() * 1e3).min(), UM),
            new("standard deviation", sample(|sphere| sphere.fitted.standard_deviation() * 1e3).max(), UM),
        ];
        if let [only] = self.0.as_slice() {
            figures.push(new("diameter", only.diameter(stylus_radius), MM));
        }
        if let Some(size_error) = self.size_error() {
            figures.push(new("size error", size_error, UM));
            figures.push(new("absolute size error", size_error.abs(), UM));
        }
        figures.push(new("points", sample(|sphere| sphere.fitted.residuals.len() as f64).0.iter().sum(), ONE));
        if let [_, _, ..] = self.0.as_slice() {
            figures.extend(self.0.iter().flat_map(|sphere| sphere.details(of, stylus_radius)));
        }
        figures
    }

    /// Largest out of sphericity, µm.
    fn out_of_sphericity(&self) -> f64 {
        Sample(self.0.iter().map(|sphere| sphere.fitted.range() * 1e3).collect()).max()
    }

    /// The size error with the largest absolute value, µm; none if no nominal size is known.
    fn size_error(&self) -> Option<f64> {
        let known = self.0.iter().filter_map(|sphere| sphere.size_error);
        known.max_by(|one, other| one.abs().total_cmp(&other.abs()))
    }
}

/// Size error, mm, that no calibrated machine makes.
const WRONG_SIZE: f64 = 0.5;

/// Part of the diameter that it may be off from twice, or half, of what is stated, to be taken for that.
const ABOUT: f64 = 0.05;

impl Form {
    /// What is to be said of a sphere that is far from its stated size.
    fn doubted_size(&self, of: &str, stylus_radius: f64) -> Option<String> {
        let size = |sphere: &Measured| sphere.size_error.map(|error| (sphere.diameter(stylus_radius), 2e-3 * error));
        let mut wrong = self.0.iter().filter_map(size).filter(|(_, off)| off.abs() > 2.0 * WRONG_SIZE);
        let (diameter, off) = wrong.next()?;
        let stated = diameter - off;
        let is = |times: f64| (diameter / (times * stated) - 1.0).abs() < ABOUT;
        let cause = match (is(2.0), is(0.5)) {
            (true, _) => "is the radius stated as the diameter?",
            (_, true) => "is the diameter stated as the radius?",
            _ => "is the stated diameter, or the radius of the stylus, that of another one?",
        };
        Some(format!("{of}: a sphere of {stated:.3} mm diameter is measured as one of {diameter:.3} mm: {cause}"))
    }
}

impl FromIterator<Measured> for Form {
    fn from_iter<I: IntoIterator<Item = Measured>>(spheres: I) -> Self {
        Self(spheres.into_iter().collect())
    }
}

impl Measured {
    fn new(touches: &Touches, fitted: Fitted<Sphere>) -> Self {
        let size_error = touches.reach.map(|reach| (fitted.shape.radius - reach) * 1e3);
        Self { label: touches.label.clone(), fitted, size_error }
    }

    /// Diameter of the sphere itself, mm.
    fn diameter(&self, stylus_radius: f64) -> f64 {
        2.0 * (self.fitted.shape.radius - stylus_radius)
    }

    /// Its figures where it is one of several.
    fn details(&self, of: &str, stylus_radius: f64) -> Vec<Figure> {
        let new = |name: &str, value, unit| Figure::new(of, format!("{name}[{}]", self.label), value, unit).detail();
        let fitted = &self.fitted;
        let mut figures = vec![
            new("out of sphericity", fitted.range() * 1e3, UM),
            new("max", fitted.max() * 1e3, UM),
            new("min", fitted.min() * 1e3, UM),
            new("standard deviation", fitted.standard_deviation() * 1e3, UM),
            new("diameter", self.diameter(stylus_radius), MM),
        ];
        figures.extend(self.size_error.map(|size_error| new("size error", size_error, UM)));
        figures.push(new("points", fitted.residuals.len() as f64, ONE));
        figures
    }
}

#[cfg(test)]
mod tests;
