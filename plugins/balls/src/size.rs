//! Sizes of features: nominal, or a diameter that a certificate states, that is estimated, or both.

use abbe_core::{
    AboveZero, Context, Equations, Error, KnownInput, Label, Layout, Parameter, ParameterRole, PathItem, Result,
    SettingsError, Unit, positive,
};
use abbe_dcc::CertifiedLength;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The diameter of a feature: the nominal file states it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Diameter {
    /// Label of the feature.
    pub feature: Label,
    /// Standard uncertainty of the diameter in the nominal file, from its certificate.
    #[serde(default)]
    #[schemars(with = "Option<AboveZero>")]
    pub standard_uncertainty_um: Option<f64>,
    /// The digital calibration certificate of the ball or ring: its diameter with its uncertainty, in place of those of the
    /// nominal file and of `standard_uncertainty_um`.
    #[serde(default)]
    pub certificate: Option<CertifiedLength>,
    /// Estimate the diameter, with what the certificate says of it as an observation.
    #[serde(default)]
    pub estimated: bool,
}

/// Checks the settings `diameters`, and finds the files that they name.
pub fn check(diameters: &mut [Diameter], context: &Context) -> Result<(), SettingsError> {
    for index in 0..diameters.len() {
        let (earlier, rest) = diameters.split_at_mut(index);
        let diameter = &mut rest[0];
        let at = |error: SettingsError| error.under([PathItem::Key("diameters".to_owned()), PathItem::Index(index)]);
        if let Some(certificate) = &mut diameter.certificate {
            if diameter.standard_uncertainty_um.is_some() {
                let error = SettingsError::new("standard_uncertainty_um", "the certificate states it");
                return Err(at(error.help("leave it out")));
            }
            certificate.resolve(context).map_err(|error| at(error.under([PathItem::Key("certificate".to_owned())])))?;
        }
        match diameter.standard_uncertainty_um {
            Some(uncertainty) => drop(positive("standard_uncertainty_um", uncertainty).map_err(at)?),
            None if diameter.estimated || diameter.certificate.is_some() => {}
            None => {
                let message = "a diameter that is known without uncertainty is that of the nominal file already";
                let help = "write `standard_uncertainty_um` of its certificate, or `estimated: true`, or leave it out";
                return Err(at(SettingsError::new("", message).help(help)));
            }
        }
        if earlier.iter().any(|other| other.feature == diameter.feature) {
            return Err(at(SettingsError::new("feature", "this diameter stands here a second time")));
        }
    }
    Ok(())
}

/// The size of a feature in equations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Size {
    /// A radius that is known, mm.
    Known(f64),
    /// A nominal radius and its unknown deviation, by the index of the unknown.
    Deviation(f64, usize),
    /// An unknown diameter, by its index.
    Diameter(usize),
    /// A diameter that is an input, by its index.
    Certified(usize),
}

impl Size {
    /// The radius, mm.
    pub fn radius(self, own: &[f64], inputs: &[f64]) -> f64 {
        match self {
            Self::Known(radius) => radius,
            Self::Deviation(radius, unknown) => radius + own[unknown],
            Self::Diameter(unknown) => own[unknown] / 2.0,
            Self::Certified(input) => inputs[input] / 2.0,
        }
    }

    /// Writes the derivatives of the current equation, whose derivative to the radius is `by_radius`.
    pub fn write(self, by_radius: f64, out: &mut Equations) {
        match self {
            Self::Known(_) => {}
            Self::Deviation(_, unknown) => out.own(unknown, by_radius),
            Self::Diameter(unknown) => out.own(unknown, by_radius / 2.0),
            Self::Certified(input) => out.input(input, by_radius / 2.0),
        }
    }
}

/// Whether a certified size can be that of a feature with this nominal size: within 1 %.
fn is_nominal(certified: f64, nominal: f64) -> bool {
    (certified - nominal).abs() <= 0.01 * nominal
}

/// Unknowns and inputs of some observations while they are put together.
#[derive(Debug, Default)]
pub struct Quantities {
    pub unknowns: Vec<Parameter>,
    /// Their start values.
    pub start: Vec<f64>,
    pub inputs: Vec<KnownInput>,
}

impl Quantities {
    /// Adds an unknown of a feature, in mm, and returns its index.
    pub fn unknown(&mut self, name: String, start: f64) -> usize {
        self.unknowns.push(Parameter::new(name, Unit::MM).with_role(ParameterRole::Feature));
        self.start.push(start);
        self.unknowns.len() - 1
    }
}

/// What a certificate says of a diameter that is estimated: `D - D_certified = 0`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CertifiedDiameter {
    unknown: usize,
    input: usize,
}

impl CertifiedDiameter {
    /// Writes its equation.
    pub fn write(self, own: &[f64], inputs: &[f64], out: &mut Equations) {
        out.equation(own[self.unknown] - inputs[self.input]);
        out.own(self.unknown, 1.0);
        out.input(self.input, -1.0);
    }
}

/// The sizes of features by the settings `diameters`; adds unknowns, inputs, and a constraint to the layout for every diameter that is
/// both estimated and certified. `features` are labels and nominal diameters, `kind` is how unknowns call a feature: `ball`.
///
/// Fails for a label that no touched feature has.
pub fn sizes(
    diameters: &[Diameter],
    kind: &str,
    features: &[(&str, f64)],
    quantities: &mut Quantities,
    layout: &mut Layout,
) -> Result<(Vec<Size>, Vec<CertifiedDiameter>)> {
    let mut sizes: Vec<Size> = features.iter().map(|(_, diameter)| Size::Known(diameter / 2.0)).collect();
    let mut constraints = Vec::new();
    for (index, diameter) in diameters.iter().enumerate() {
        let label = diameter.feature.0.as_str();
        let at = |mut error: Error, key: &str| {
            let [list, key] = ["diameters", key].map(|name| PathItem::Key(name.to_owned()));
            error.setting = vec![list, PathItem::Index(index), key];
            error
        };
        let Some(place) = features.iter().position(|(own, _)| *own == label) else {
            let error = Error::data(format!("`diameters` names {kind} {label}, which was not touched"))
                .suggest(label, features.iter().map(|(own, _)| *own));
            return Err(at(error, "feature"));
        };
        let certified = diameter.certificate.as_ref().map(CertifiedLength::length).transpose()?;
        let nominal = certified.map_or(features[place].1, |(length, _)| length);
        if !is_nominal(nominal, features[place].1) {
            let message = format!(
                "the certificate states {nominal} mm as diameter of {kind} {label}, whose nominal diameter is {} mm",
                features[place].1
            );
            return Err(at(Error::data(message).help("is it the certificate of another feature?"), "certificate"));
        }
        let unknown = diameter.estimated.then(|| quantities.unknown(format!("{kind}[{label}].diameter"), nominal));
        let name = format!("diameter[{label}]");
        let input = match (&diameter.certificate, diameter.standard_uncertainty_um) {
            (Some(certificate), _) => Some(certificate.input_of(&name)?),
            (None, Some(uncertainty_um)) => {
                let uncertainty = uncertainty_um * 1e-3;
                let content = format!("diameter of {kind} {label}: {nominal:e} mm, u = {uncertainty:e} mm");
                let input = KnownInput::new(Parameter::new(&name, Unit::MM), nominal, uncertainty);
                Some(input.with_certificate(name, content))
            }
            (None, None) => None,
        };
        let input = input.map(|input| {
            let uncertainty = input.standard_uncertainty;
            quantities.inputs.push(input);
            (quantities.inputs.len() - 1, uncertainty)
        });
        sizes[place] = match (unknown, input) {
            (Some(unknown), Some((input, uncertainty))) => {
                layout.push_constraint(&[uncertainty]);
                constraints.push(CertifiedDiameter { unknown, input });
                Size::Diameter(unknown)
            }
            (Some(unknown), None) => Size::Diameter(unknown),
            (None, Some((input, _))) => Size::Certified(input),
            (None, None) => sizes[place],
        };
    }
    Ok((sizes, constraints))
}
