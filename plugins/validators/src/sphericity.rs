//! Validator `sphericity`: the machine as a measuring machine, on a sphere that is fixed on the table and touched at many
//! indexations (Rahman 2016, chapter 6).
//!
//! Perfect tips of a perfect model lie on one sphere. What the least squares sphere leaves over is what the model gets wrong:
//! the nominal model all errors of the machine, a calibrated one those that it does not describe.

use abbe_core::{
    Build, Constructor, Context, Dataset, Error, Figure, Findings, Fit, InputFile, KinematicModel, PathItem, Plugin,
    Result, SettingsError, Validate, inventory, positive,
};
use abbe_geometry::{Fitted, Sphere};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::{Limits, MM, ONE, Sample, UM, check_limits, outliers, set_limits};
use crate::folds::set_of;
use crate::one_at_a_time::{Programme, Sensitivity};
use crate::sphere_touches::Touches;

inventory::submit! {
    Plugin::built_in(
        "sphericity",
        "form and size of a sphere as the machine measures it, by the nominal and by the calibrated model",
        abbe_core::schema_of::<Settings>,
        example,
        Build::Validate(Constructor::Static(build)),
    )
}

/// Settings of the sphericity.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The artefact stage whose touches on spheres are judged; without it the data under `from` are.
    #[serde(default)]
    rows: Option<String>,
    /// Diameter of the spheres of the data under `from`; without it no size error is told.
    #[serde(default)]
    diameter_mm: Option<f64>,
    /// A column for whose labels spheres are fitted separately: programmes of measurement.
    #[serde(default)]
    column: Option<String>,
    /// What single errors of the machine would do to what its nominal model measures.
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

fn build(settings: &Value, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    let settings: Settings = abbe_core::from_settings(settings)?;
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
    fn inputs(&self) -> Vec<InputFile> {
        Vec::new()
    }

    fn observations(&self) -> Vec<(&'static str, String)> {
        self.settings.rows.iter().map(|rows| ("rows", rows.clone())).collect()
    }

    fn validate(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        // Nominal figures of several fits are the same, unless these have other models or other outliers.
        let mut nominal: Vec<Vec<Figure>> = Vec::new();
        for fit in fits {
            let (touches, skipped) = self.touches(fit, data)?;
            let model = fit.problem.model.as_ref();
            let zero = model.nominal();
            let mut of_nominal = Form::all(&touches, model, &zero)?.figures(NOMINAL, model.stylus_radius());
            if !nominal.contains(&of_nominal) {
                nominal.push(of_nominal.clone());
                if nominal.len() > 1 {
                    let name = format!("{NOMINAL} of {}", fit.name);
                    of_nominal.iter_mut().for_each(|figure| figure.of = Some(name.clone()));
                }
                findings.figures.extend(of_nominal);
            }
            let values = fit.problem.starting_from(&fit.calibration).machine;
            let mut figures = Form::all(&touches, model, &values)?.figures(&fit.name, model.stylus_radius());
            figures.extend(skipped.map(|skipped| Figure::new(&fit.name, "outliers", skipped as f64, ONE)));
            set_limits(&self.settings.limits, &mut figures);
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

impl Sphericity {
    /// The touches to judge and, of a fit's own rows, the number of outliers that are not among them.
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
                let reach = self.settings.diameter_mm.map(|diameter| diameter / 2.0 + model.stylus_radius());
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
mod tests {
    use super::*;
    use crate::testing::{check, figure_of, fit_to, judge, validator};
    use abbe_core::path_text;
    use std::path::Path;
    use tempfile::TempDir;

    /// Radius of the balls plus that of the stylus, mm.
    const REACH: f64 = 10.0 + 3.0;
    /// The six touches along the axes.
    const SIX: [[f64; 3]; 6] =
        [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
    /// Too far by 4 um in x, by 1 um in y and by -2 um in z: the radius is 1 um too large.
    const FORM: [f64; 6] = [4.0, 4.0, 1.0, 1.0, -2.0, -2.0];

    fn machine() -> Value {
        json!({
            "chain": "w b X Y Z t", "tool_length_mm": 100, "stylus_radius_mm": 3,
            "errors": [{ "polynomial": ["EXX"], "degrees": [1, 2] }, { "drift": ["dxt"], "degrees": [1], "per": "data-set",
                "time_s": { "": [0, 100] } }],
        })
    }

    /// Rows of a file of touches on ball `label` at (x, 0, 50); the X axis moves too far by the factor 1 + `gain`.
    fn touches(label: &str, group: &str, x: f64, gain: f64, directions: &[[f64; 3]], off: &[f64]) -> String {
        let row = |(direction, off): (&[f64; 3], &f64)| {
            let [x, y, z] = [0, 1, 2].map(|axis| [x, 0.0, 50.0][axis] + (REACH + off * 1e-3) * direction[axis]);
            format!("{label},{group},50,{},{y},{}\n", x / (1.0 + gain), z + 100.0)
        };
        directions.iter().zip(off).map(row).collect()
    }

    const HEADER: &str = "feature,group,time_s,X_mm,Y_mm,Z_mm\n";
    const BALLS: &str = "feature,x_mm,y_mm,z_mm,diameter_mm\n1,0,0,50,20\n2,100,0,50,20\n";

    fn of(rows: &str, robust: bool) -> (TempDir, Fit) {
        fit_to("balls", BALLS, &format!("{HEADER}{rows}"), &machine(), robust)
    }

    #[test]
    fn form_and_size_of_one_ball() {
        let (folder, fit) = of(&touches("1", "a", 0.0, 0.0, &SIX, &FORM), false);
        let settings =
            json!({ "rows": "table", "limits": { "out_of_sphericity_um": 5, "absolute_size_error_um": 0.9 } });
        let found = judge("sphericity", folder.path(), &settings, &fit).unwrap();
        let expected = [
            ("out of sphericity", 6.0),
            ("max", 3.0),
            ("min", -3.0),
            ("standard deviation", 18.0_f64.sqrt()),
            ("diameter", 20.002),
            ("size error", 1.0),
            ("absolute size error", 1.0),
            ("points", 6.0),
        ];
        check(&found, &expected);
        check(&found, &[("outliers", 0.0)]);
        expected.iter().for_each(|(name, value)| assert!((figure_of(&found, NOMINAL, name) - value).abs() < 1e-6));
        // Limits are for the calibrated model.
        let failed: Vec<_> = found.figures.iter().filter(|figure| !figure.passes()).collect();
        let failed: Vec<_> = failed.iter().map(|figure| (figure.of.as_deref(), figure.name.as_str())).collect();
        assert_eq!(failed, [(Some("fit"), "out of sphericity"), (Some("fit"), "absolute size error")]);
        assert!(!found.figures.iter().any(|figure| figure.detail));
    }

    #[test]
    fn several_balls_and_programmes() {
        let off = [1.0; 6];
        let rows = [
            touches("1", "a", 0.0, 0.0, &SIX, &FORM),
            touches("2", "a", 100.0, 0.0, &SIX, &off),
            touches("2", "b", 100.0, 0.0, &SIX, &FORM.map(|off| -off)),
        ];
        let (folder, fit) = of(&rows.concat(), false);
        let found = judge("sphericity", folder.path(), &json!({ "rows": "table" }), &fit).unwrap();
        check(
            &found,
            &[
                ("out of sphericity", 6.0),
                ("out of sphericity[feature=1]", 6.0),
                ("size error[feature=1]", 1.0),
                ("size error[feature=2]", 0.0),
                ("points[feature=2]", 12.0),
                ("points", 18.0),
            ],
        );
        assert!(!found.figures.iter().any(|figure| figure.name == "diameter"));
        let found = judge("sphericity", folder.path(), &json!({ "rows": "table", "column": "group" }), &fit).unwrap();
        check(
            &found,
            &[
                ("out of sphericity[feature=2, group=a]", 0.0),
                ("size error[feature=2, group=b]", -1.0),
                ("diameter[feature=2, group=b]", 19.998),
                ("max", 3.0),
                ("min", -3.0),
                ("absolute size error", 1.0),
            ],
        );
        let few = [rows[0].clone(), touches("2", "b", 100.0, 0.0, &[SIX[0], SIX[2], SIX[4]], &off)];
        let (folder, fit) = of(&few.concat(), false);
        assert_eq!(
            judge("sphericity", folder.path(), &json!({ "rows": "table" }), &fit).unwrap_err(),
            ": feature=2: a sphere needs 4 points or more, and there are 3"
        );
    }

    #[test]
    fn the_model_of_the_fit_and_single_errors() {
        let gain = 1e-3;
        let (folder, mut fit) = of(&touches("1", "a", 0.0, gain, &SIX, &[0.0; 6]), false);
        // A given model: nobody estimates it from these rows.
        fit.calibration.parameters.iter_mut().find(|parameter| parameter.name == "EXX[1]").unwrap().value = gain;
        let settings = json!({
            "rows": "table",
            "sensitivity": { "parameters": ["EXX[1]", "dzt"], "um": 1, "um_per_m": 1000 },
        });
        let found = judge("sphericity", folder.path(), &settings, &fit).unwrap();
        check(&found, &[("out of sphericity", 0.0), ("diameter", 20.0), ("size error", 0.0)]);
        // The two touches along x are short by as much as the axis moves too far.
        let short = 1e3 * REACH * gain / (1.0 + gain);
        assert!((figure_of(&found, NOMINAL, "out of sphericity") - short).abs() < 1e-6);
        assert!((figure_of(&found, NOMINAL, "size error") + short / 3.0).abs() < 1e-6);
        check(
            &found,
            &[
                ("out of sphericity[EXX[1]]", short),
                ("size error[EXX[1]]", -short / 3.0),
                ("out of sphericity[dzt]", 0.0),
            ],
        );
        let table: Vec<&str> =
            found.figures.iter().map(|figure| figure.name.as_str()).filter(|name| name.contains('[')).collect();
        let parameters = ["dzt", "EXX[1]"];
        assert_eq!(
            table,
            parameters.map(|name| [format!("size error[{name}]"), format!("out of sphericity[{name}]")]).concat()
        );
        assert_eq!(found.remarks, ["fit: of single errors EXX[1] does most to the sphericity (12.99 µm)"]);
    }

    #[test]
    fn outliers_are_left_out() {
        let directions: Vec<[f64; 3]> = (0..40)
            .map(|index| {
                let (height, angle) = (f64::from(index) / 20.0 - 0.95, f64::from(index) * 2.4);
                let across = (1.0 - height * height).sqrt();
                [across * angle.cos(), across * angle.sin(), height]
            })
            .collect();
        let mut off: Vec<f64> = (0..40).map(|index| 0.1 * (f64::from(index * index) * 1.7).sin()).collect();
        off[7] = 50.0;
        let (folder, fit) = of(&touches("1", "a", 0.0, 0.0, &directions, &off), true);
        let found =
            judge("sphericity", folder.path(), &json!({ "rows": "table", "limits": { "outliers": 0 } }), &fit).unwrap();
        check(&found, &[("outliers", 1.0), ("points", 39.0)]);
        assert!(figure_of(&found, "fit", "out of sphericity") < 0.3);
        assert_eq!(found.figures.iter().filter(|figure| !figure.passes()).count(), 1);
    }

    /// What is found in other data, by a fit that drifted while its own were taken.
    fn elsewhere(settings: &Value, text: &str) -> std::result::Result<Findings, String> {
        let (folder, mut fit) = of(&touches("1", "a", 0.0, 0.0, &SIX, &FORM), false);
        fit.calibration.parameters.iter_mut().find(|parameter| parameter.name == "dxt[t1]").unwrap().value = 1.0;
        let file = folder.path().join("others.csv");
        std::fs::write(&file, text).unwrap();
        let data = abbe_table::read(&file).unwrap();
        let found = validator("sphericity", folder.path(), settings)?.validate(&[&fit], &[&data]);
        found.map_err(|error| {
            let text = error.to_string().replace(&format!("{}/", folder.path().display()), "");
            format!("{}: {text}", path_text(&error.setting))
        })
    }

    #[test]
    fn other_data() {
        let rows = touches("9", "a", 40.0, 0.0, &SIX, &FORM);
        let mut later = format!("{HEADER}{rows}");
        later = later.replacen(",50,", ",100,", 1);
        let found = elsewhere(&json!({ "diameter_mm": 20 }), &later).unwrap();
        check(&found, &[("out of sphericity", 6.0), ("size error", 1.0), ("diameter", 20.002), ("points", 6.0)]);
        assert!(!found.figures.iter().any(|figure| figure.name == "outliers"));
        let single = json!({ "sensitivity": { "parameters": ["EXX[2]"], "um_per_m2": 1000 } });
        let found = elsewhere(&single, &later).unwrap();
        assert!(!found.figures.iter().any(|figure| figure.name == "size error"));
        // Along x the stretch is 2 e x at x = 40 mm, so less than 0.1 um over the ball.
        assert!((figure_of(&found, "fit", "out of sphericity[EXX[2]]") - 1.04).abs() < 0.01);
        let without: String = later.lines().map(|line| line.split_once(',').unwrap().1.to_owned() + "\n").collect();
        check(&elsewhere(&json!({}), &without).unwrap(), &[("out of sphericity", 6.0), ("diameter", 20.002)]);
    }

    #[test]
    fn settings_and_data_that_make_no_sense_are_refused() {
        let rows = format!("{HEADER}{}", touches("1", "a", 0.0, 0.0, &SIX, &FORM));
        let cases = [
            (json!({ "rows": "table" }), "rows: either `rows` or data under `from` are judged, not both"),
            (
                json!({ "rows": "table", "diameter_mm": 20 }),
                "diameter_mm: the artefact under `rows` says how large its spheres are",
            ),
            (json!({ "diameter_mm": -1 }), "diameter_mm: -1: a positive number was expected"),
            (
                json!({ "limits": { "size_error_um": 1 } }),
                "limits.size_error_um: there is no figure `size_error_um` to limit (possible are: \
                 out_of_sphericity_um, standard_deviation_um, absolute_size_error_um, outliers)",
            ),
            (
                json!({ "limits": { "absolute_size_error_um": 1 } }),
                "limits.absolute_size_error_um: without `diameter_mm` there is no size error to limit",
            ),
            (
                json!({ "column": "day" }),
                "column: others.csv: there is no column `day`; the columns are `feature`, `group`, `time_s`, `X_mm`, `Y_mm`, \
                 `Z_mm`",
            ),
            (json!({ "sensitivity": { "parameters": [] } }), "sensitivity.parameters: at least one name was expected"),
            (
                json!({ "sensitivity": { "parameters": ["dxt"] } }),
                "sensitivity: a value for each unit was expected (e.g. `um: 1, urad: 2.5`)",
            ),
            (
                json!({ "sensitivity": { "parameters": ["dxt"], "um": 0 } }),
                "sensitivity.um: 0: a number other than zero was expected",
            ),
            (
                json!({ "sensitivity": { "parameters": ["dxt", "dxx"], "um": 1 } }),
                "sensitivity.parameters[1]: `dxx` matches no parameter of the model (did you mean `dxt`?)",
            ),
            (
                json!({ "sensitivity": { "parameters": ["EXX[1]"], "um": 1 } }),
                "sensitivity: `EXX[1]` is in µm/m, for which there is no value (e.g. `um_per_m: 1`)",
            ),
            (
                json!({ "sensitivity": { "parameters": ["dxt"], "um": 1, "mm": 1 } }),
                "sensitivity.mm: none of these parameters is in `mm`",
            ),
        ];
        for (settings, expected) in cases {
            assert_eq!(elsewhere(&settings, &rows).unwrap_err(), expected, "{settings}");
        }
        let (folder, fit) = crate::testing::fit(&crate::testing::UPWARDS, &[("a", "1", 0.0, 0.0)], false);
        assert_eq!(
            judge("sphericity", folder.path(), &json!({ "rows": "table" }), &fit).unwrap_err(),
            "rows: the rows of `table` are no touches on spheres"
        );
        assert_eq!(
            judge("sphericity", folder.path(), &json!({}), &fit).unwrap_err(),
            ": `rows`, an artefact stage, or one ingest stage under `from` was expected, not 0"
        );
        assert!(validator("sphericity", Path::new(""), &json!({ "rows": 1 })).is_err());
    }

    #[test]
    fn nominal_figures_of_several_fits() {
        let (_folder, one) = of(&touches("1", "a", 0.0, 0.0, &SIX, &FORM), false);
        let (_other_folder, mut other) = of(&touches("1", "a", 0.0, 0.0, &SIX, &[0.0; 6]), false);
        other.name = "other".to_owned();
        let judge = validator("sphericity", Path::new(""), &json!({ "rows": "table" })).unwrap();
        let names = |fits: &[&Fit]| {
            let mut names: Vec<String> =
                judge.validate(fits, &[]).unwrap().figures.into_iter().filter_map(|figure| figure.of).collect();
            names.dedup();
            names
        };
        assert_eq!(names(&[&one, &one]), ["nominal", "fit"]);
        assert_eq!(names(&[&one, &other]), ["nominal", "fit", "nominal of other", "other"]);
    }
}
