//! Exporter `printer-skew`: squareness of X, Y and Z for Klipper, Marlin and RepRapFirmware.

use abbe_core::{
    Calibration, CommandCorrection, Context, Error, Export, ExportedFile, KinematicModel, PathItem, Result,
    SettingsError, positive,
};
use abbe_volumetric::{Ranges, check_ranges};
use nalgebra::Matrix3;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::files::{file, rounded};
use crate::linear::{Multiplied, commands, motion};

abbe_core::register!(
    Export,
    "printer-skew",
    "squareness of X, Y and Z for Klipper, Marlin and RepRapFirmware",
    Settings,
    example,
    build,
    "../reference/export-printer-skew.md",
);

/// Decimals of the factors: 0.01 um on a metre.
const DECIMALS: i32 = 8;

const MARLIN_NOTE: &str = "\
; Firmware built with SKEW_CORRECTION_GCODE, and with SKEW_CORRECTION_FOR_Z for J and K.
; That I, J and K are xy, xz and yz is from no manual: compare with what M852 without letters reports.
";

/// `S` of `M556`, mm: the height at which its deviations are given.
const HEIGHT_MM: f64 = 100.0;

/// Settings of the skew.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Who reads the file.
    firmware: Firmware,
    /// The factors with which the machine was measured. Default: none.
    #[serde(default)]
    existing: Skew,
    /// Largest factor of skew.
    #[serde(default = "ten")]
    largest_skew_mrad: f64,
    /// Ranges by axis, where they are not those of the machine.
    #[serde(default)]
    axes: Ranges,
}

/// Who reads the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Firmware {
    /// Klipper: a profile of `[skew_correction]`.
    Klipper,
    /// Marlin: `M852`.
    Marlin,
    /// RepRapFirmware: `M556`.
    Reprapfirmware,
}

/// Factors of skew as Klipper and Marlin name them: x is reduced by y times `xy` and so on.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Skew {
    /// rad.
    #[serde(default)]
    xy: f64,
    /// rad.
    #[serde(default)]
    xz: f64,
    /// rad.
    #[serde(default)]
    yz: f64,
}

impl Skew {
    fn factors(self) -> [(&'static str, f64); 3] {
        [("xy", self.xy), ("xz", self.xz), ("yz", self.yz)]
    }

    /// Motors' commands from those of the program.
    fn matrix(self) -> Matrix3<f64> {
        let Self { xy, xz, yz } = self;
        Matrix3::new(1.0, -xy, -(xz - xy * yz), 0.0, 1.0, -yz, 0.0, 0.0, 1.0)
    }

    /// The factors of such a matrix.
    fn of(matrix: &Matrix3<f64>) -> Self {
        let (xy, yz) = (-matrix[(0, 1)], -matrix[(1, 2)]);
        Self { xy, xz: xy * yz - matrix[(0, 2)], yz }
    }
}

fn ten() -> f64 {
    10.0
}

fn example() -> Value {
    json!({ "firmware": "klipper", "existing": { "xy": 0.0005, "xz": 0, "yz": 0 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    positive("largest_skew_mrad", settings.largest_skew_mrad)?;
    check_ranges(&settings.axes, "axes")?;
    let is_allowed = |factor: f64| factor.abs() * 1e3 <= settings.largest_skew_mrad;
    if let Some((name, _)) = settings.existing.factors().into_iter().find(|(_, factor)| !is_allowed(*factor)) {
        let message = format!("a factor of at most {} mrad (in rad) was expected", settings.largest_skew_mrad);
        return Err(SettingsError::new(name, message).under([PathItem::Key("existing".to_owned())]));
    }
    Ok(Box::new(PrinterSkew { settings }))
}

struct PrinterSkew {
    settings: Settings,
}

impl PrinterSkew {
    /// The factors, as they are written.
    ///
    /// The motion M = Q R of the machine has axes that are square (Q) once the commands are multiplied by a matrix that makes R
    /// diagonal.
    fn skew(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Skew> {
        let r = motion(calibration, model, &self.settings.axes)?.qr().r();
        let ratio = |row: usize, column: usize| r[(row, column)] / r[(row, row)];
        let change = Skew { xy: ratio(0, 1), xz: ratio(0, 2), yz: ratio(1, 2) };
        let total = Skew::of(&(self.settings.existing.matrix() * change.matrix()));
        let most = self.settings.largest_skew_mrad;
        for (name, factor) in total.factors() {
            if factor.abs() * 1e3 > most {
                let message =
                    format!("the factor {name} would be {:.3} mrad; at most {most} mrad are allowed", factor * 1e3);
                return Err(Error::data(message)
                    .help("is the calibration that of this machine? else allow more")
                    .setting("largest_skew_mrad"));
            }
        }
        let [xy, xz, yz] = total.factors().map(|(_, factor)| rounded(factor, DECIMALS));
        Ok(match self.settings.firmware {
            Firmware::Klipper | Firmware::Marlin => Skew { xy, xz, yz },
            // M556 has no product of its factors: what it does to z is written as the other firmware would have it.
            Firmware::Reprapfirmware => {
                Skew { xy, xz: rounded(total.xz - total.xy * total.yz, DECIMALS) + xy * yz, yz }
            }
        })
    }
}

impl Export for PrinterSkew {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let skew = self.skew(calibration, model)?;
        let Skew { xy, xz, yz } = skew;
        Ok(vec![match self.settings.firmware {
            Firmware::Klipper => file(
                "skew.cfg",
                format!(
                    "# To be loaded with: SKEW_PROFILE LOAD=abbe\n[skew_correction]\n\n[skew_correction abbe]\n\
                     xy_skew = {xy}\nxz_skew = {xz}\nyz_skew = {yz}\n"
                ),
            ),
            Firmware::Marlin => file("skew.gcode", format!("{MARLIN_NOTE}M852 I{xy} J{xz} K{yz}\nM500\n")),
            Firmware::Reprapfirmware => {
                let matrix = skew.matrix();
                let deviation = |row, column| rounded(matrix[(row, column)] * HEIGHT_MM, DECIMALS - 2);
                let [x, y, z] = [deviation(0, 1), deviation(1, 2), deviation(0, 2)];
                file("skew.g", format!("M556 S{HEIGHT_MM} X{x} Y{y} Z{z}\n"))
            }
        }])
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        let new = self.skew(calibration, model)?.matrix();
        let present = self.settings.existing.matrix();
        // The calibrated machine has the present factors in it. A matrix of this shape has an inverse.
        let Some(without) = present.try_inverse() else { return Ok(None) };
        let (columns, width) = (commands(model)?, model.info().status.len());
        Ok(Some(Box::new(Multiplied { columns, width, by: without * new })))
    }
}
