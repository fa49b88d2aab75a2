//! Exporter `error-table`: the motion errors of every axis over its range, with their standard uncertainties.
//!
//! One CSV file an axis: its position, the direction of approach, and for every motion error two columns, value and
//! standard uncertainty; on request the half width of the band in which the whole curve lies. All other axes stand at zero.

use abbe_core::{
    Calibration, Context, Error, ErrorFunction, Export, ExportedFile, KinematicModel, Quantity, Result, SettingsError,
};
use abbe_volumetric::{Ranges, Steps, check_axes, position_unit};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::sampling::{RANGES, Values, check, fixed, points, status};

abbe_core::register!(
    Export,
    "error-table",
    "motion errors of every axis with standard uncertainties, as CSV",
    Settings,
    example,
    build,
    "../reference/export-error-table.md",
);

/// Settings of the tables.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Distance of points along linear axes.
    #[serde(default = "default_step_mm")]
    step_mm: f64,
    /// Distance of points along rotary axes.
    #[serde(default = "default_step_deg")]
    step_deg: f64,
    /// Ranges by axis, where they are not those of the machine.
    #[serde(default)]
    ranges: Ranges,
    /// Probability of a confidence band: adds the half width of a band in which the whole curve of an error lies.
    #[serde(default)]
    band_probability: Option<f64>,
}

fn default_step_mm() -> f64 {
    50.0
}

fn default_step_deg() -> f64 {
    15.0
}

/// Most points of an axis: what a spreadsheet still opens.
const MOST: usize = 100_000;

fn example() -> Value {
    json!({ "step_mm": 50, "step_deg": 15, "ranges": { "X": { "from_mm": -400, "to_mm": 400 } } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    check(&settings.ranges, settings.steps())?;
    if settings.band_probability.is_some_and(|probability| !(probability > 0.0 && probability < 1.0)) {
        return Err(SettingsError::new("band_probability", "a probability between 0 and 1 was expected"));
    }
    Ok(Box::new(ErrorTable { settings }))
}

impl Settings {
    fn steps(&self) -> Steps {
        Steps { mm: self.step_mm, deg: self.step_deg }
    }
}

struct ErrorTable {
    settings: Settings,
}

impl Export for ErrorTable {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        check_axes(&self.settings.ranges, RANGES, model)?;
        let functions = &model.info().error_functions;
        if functions.is_empty() {
            return Err(Error::usage("the model has no motion errors to tabulate")
                .help("list some under `errors` of the model, e.g. `{ polynomial: [E?X], degrees: [1, 2, 3] }`"));
        }
        let values = Values::new(calibration, model);
        let mut files = Vec::new();
        for (index, axis) in model.info().axes.iter().enumerate() {
            let of_axis: Vec<&ErrorFunction> = functions.iter().filter(|function| function.axis == index).collect();
            if of_axis.is_empty() {
                continue;
            }
            let (unit, factor) = position_unit(axis);
            let mut text = format!("{0}_{unit},dir_{0}", axis.name);
            for function in &of_axis {
                let (unit, _) = value_unit(function);
                text.push_str(&format!(",{0}_{unit},{0}_standard_uncertainty_{unit}", function.symbol));
                if self.settings.band_probability.is_some() {
                    text.push_str(&format!(",{}_band_{unit}", function.symbol));
                }
            }
            text.push('\n');
            let points = points(axis, &self.settings.ranges, self.settings.steps(), MOST)?;
            for direction in [1.0, -1.0] {
                for point in &points {
                    text.push_str(&format!("{point},{direction}"));
                    let status = status(model, axis, point / factor, direction);
                    for function in &of_axis {
                        let (_, factor) = value_unit(function);
                        let (value, uncertainty) = values.motion_error(model, function, &status)?;
                        text.push_str(&format!(",{},{}", fixed(value * factor), fixed(uncertainty * factor)));
                        if let Some(probability) = self.settings.band_probability {
                            let band = values.band_factor(model, function, &status, probability)?;
                            let half = band.map(|band| fixed(band * uncertainty * factor));
                            text.push_str(&format!(",{}", half.unwrap_or_default()));
                        }
                    }
                    text.push('\n');
                }
            }
            files.push(ExportedFile { name: format!("error-table-{}.csv", axis.name), content: text.into_bytes() });
        }
        Ok(files)
    }
}

/// The unit in which people read an error, and the factor from the unit in memory.
fn value_unit(function: &ErrorFunction) -> (&'static str, f64) {
    match function.quantity {
        Quantity::Angle => ("urad", 1e6),
        _ => ("um", 1e3),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{built, calibration, chain, key_error};

    #[test]
    fn errors_and_uncertainties_over_the_range() {
        let errors = json!([{ "polynomial": ["EXX", "EAX"], "degrees": [1, 2] }, { "backlash": ["EXX"] }, { "drift": ["dzt"],
            "degrees": [1], "time_s": { "": [0, 1] } }]);
        let model = chain("w b X Y Z t", json!({ "X": { "range_mm": [-100, 100] } }), errors);
        let mut calibration = calibration(
            model.as_ref(),
            &[("EXX[1]", 1e-5), ("EXX[2]", 1e-7), ("EXX[b]", 5e-4), ("EAX[1]", 1e-7), ("dzt[t1]", 1.0)],
        );
        calibration.covariance.order = vec!["EXX[b]".to_owned(), "EXX[1]".to_owned()];
        calibration.covariance.rows = vec![vec![4e-8, -1e-10], vec![-1e-10, 1e-12]];
        let files = built(&json!({ "step_mm": 100 }), build).unwrap();
        let files = files.export(&calibration, model.as_ref()).unwrap();
        assert_eq!(files.len(), 1);
        assert_eq!(files[0].name, "error-table-X.csv");
        // u² = 4e-8 + 2 q dir (-1e-10) + q² 1e-12: at -100 forwards 7e-8 mm², at 100 forwards 3e-8 mm².
        let (far, near, middle) = (fixed(7e-8_f64.sqrt() * 1e3), fixed(3e-8_f64.sqrt() * 1e3), "0.200000");
        let expected = format!(
            "X_mm,dir_X,EXX_um,EXX_standard_uncertainty_um,EAX_urad,EAX_standard_uncertainty_urad\n\
             -100,1,0.500000,{far},-10.000000,0.000000\n\
             0,1,0.500000,{middle},0.000000,0.000000\n\
             100,1,2.500000,{near},10.000000,0.000000\n\
             -100,-1,-0.500000,{near},-10.000000,0.000000\n\
             0,-1,-0.500000,{middle},0.000000,0.000000\n\
             100,-1,1.500000,{far},10.000000,0.000000\n"
        );
        assert_eq!(String::from_utf8(files[0].content.clone()).unwrap(), expected);

        // Two estimated parameters, known without degrees of freedom: sqrt(chi-squared(0.95; 2)) = 2.4477. EAX has none.
        let stage = built(&json!({ "step_mm": 100, "band_probability": 0.95 }), build).unwrap();
        let files = stage.export(&calibration, model.as_ref()).unwrap();
        let text = String::from_utf8(files[0].content.clone()).unwrap();
        let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
        assert_eq!((lines[0][4], lines[0][7]), ("EXX_band_um", "EAX_band_urad"));
        assert_eq!((lines[2][3], lines[2][4], lines[2][7]), ("0.200000", "0.489549", ""));
    }

    #[test]
    fn errors_point_at_the_setting() {
        let cases = [
            (
                json!([]),
                json!({}),
                ": the model has no motion errors to tabulate (list some under `errors` of the model, \
                e.g. `{ polynomial: [E?X], degrees: [1, 2, 3] }`)",
            ),
            (
                json!([{ "polynomial": ["EXX"], "degrees": [1] }]),
                json!({}),
                "ranges: the range of axis X is not known \
                (write `ranges: { X: { from_mm: .., to_mm: .. } }` here, or `range_mm` into the machine description)",
            ),
        ];
        for (errors, settings, expected) in cases {
            let model = chain("w b X Y Z t", json!({}), errors);
            let stage = built(&settings, build).unwrap();
            assert_eq!(key_error(stage.export(&calibration(model.as_ref(), &[]), model.as_ref())), expected);
        }
    }

    #[test]
    fn the_example_builds() {
        assert!(built(&example(), build).is_ok());
    }
}
