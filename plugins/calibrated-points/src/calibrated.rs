//! The calibrated points: from a table with one standard uncertainty for all, or from a certificate.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use abbe_core::{Context, InputFile, KnownInput, LabelText, Parameter, Quantity, Result, SettingsError, Unit};
use abbe_dcc::{CertificateFile, CertifiedPoint, DigitalCertificate, Errors, ValueIndex};
use nalgebra::Vector3;

use crate::{ERRORS, Settings};

/// Where the points stand.
pub(crate) enum Source {
    /// In a CSV file.
    Table(PathBuf),
    /// In a certificate.
    Certificate(PathBuf, CertificateFile),
}

/// The points of an artefact.
pub(crate) struct Points {
    pub(crate) labels: Vec<String>,
    /// Artefact frame, mm.
    pub(crate) points: Vec<Vector3<f64>>,
    known: Known,
}

/// What is known of their errors.
enum Known {
    /// The standard uncertainty of every coordinate, mm.
    Uncertainty(f64),
    Certificate(DigitalCertificate, Vec<CertifiedPoint>),
}

/// The inputs that make the error of each coordinate of each point, with their derivatives.
pub(crate) type PointErrors = Vec<[Vec<(usize, f64)>; 3]>;

impl Source {
    /// The source that the settings name: one, and not both.
    pub(crate) fn new(settings: &Settings, context: &Context) -> Result<Self, SettingsError> {
        match (&settings.points, &settings.certificate) {
            (Some(points), None) => Ok(Self::Table(context.path(points))),
            (None, Some(certificate)) => {
                let path = certificate.path(context);
                let path = path.map_err(|error| error.under([abbe_core::PathItem::Key("certificate".to_owned())]))?;
                if settings.calibration_standard_uncertainty_um > 0.0 {
                    let message = "the certificate states the uncertainties";
                    return Err(SettingsError::new("calibration_standard_uncertainty_um", message).help("leave it out"));
                }
                Ok(Self::Certificate(path, certificate.clone()))
            }
            (Some(_), Some(_)) => {
                let error = SettingsError::new("certificate", "the points stand in the file of `points` already");
                Err(error.help("leave out one of them"))
            }
            (None, None) => Err(SettingsError::new("points", "the file of the points was expected, or `certificate`")),
        }
    }

    /// The file.
    pub(crate) fn file(&self) -> &Path {
        match self {
            Self::Table(path) | Self::Certificate(path, _) => path,
        }
    }

    pub(crate) fn input(&self) -> InputFile {
        let setting = if matches!(self, Self::Table(_)) { "points" } else { "certificate" };
        InputFile { setting, path: self.file().to_owned() }
    }

    /// Fails if the file cannot be one of points; tells what has to be known of a certificate.
    pub(crate) fn check(&self, label: &str) -> Result<()> {
        let path = match self {
            Self::Table(path) => path,
            Self::Certificate(path, settings) => {
                let certificate = DigitalCertificate::read(path, settings)?;
                certificate.points()?;
                certificate.tell();
                return Ok(());
            }
        };
        let headers = abbe_table::read_headers(path)?;
        let is_plane = !headers.iter().any(|header| header.name == "z");
        let lengths = ["x", "y", "z"].map(|name| (name, Quantity::Length));
        let required = |columns: &[_]| abbe_table::require(&headers, Some(path), columns);
        required(&[(label, Quantity::Label)]).map_err(|error| error.setting("point"))?;
        required(&lengths[..if is_plane { 2 } else { 3 }])
    }

    pub(crate) fn read(&self, settings: &Settings) -> Result<Points> {
        match self {
            Self::Table(path) => table(path, settings),
            Self::Certificate(path, file) => {
                let certificate = DigitalCertificate::read(path, file)?;
                let points = certificate.points()?;
                let value = |value: Option<ValueIndex>| value.map_or(0.0, |index| certificate.value(index));
                Ok(Points {
                    labels: points.iter().map(|point| point.label.clone()).collect(),
                    points: points.iter().map(|point| point.coordinates.map(value).into()).collect(),
                    known: Known::Certificate(certificate, points),
                })
            }
        }
    }
}

fn table(path: &Path, settings: &Settings) -> Result<Points> {
    let table = abbe_table::read(path)?;
    let labels = abbe_table::labels(&table, &settings.point).map_err(|error| error.setting("point"))?;
    abbe_table::unique_labels(&table, &settings.point)?;
    let points = match table.column("z") {
        Some(_) => abbe_table::points(&table, ["x", "y", "z"])?,
        None => {
            let along = |name| abbe_table::numbers(&table, name, Quantity::Length);
            along("x")?.iter().zip(along("y")?).map(|(x, y)| [*x, *y, 0.0]).collect()
        }
    };
    let known = Known::Uncertainty(settings.calibration_standard_uncertainty_um * 1e-3);
    let labels = labels.iter().map(LabelText::to_string).collect();
    Ok(Points { labels, points: points.into_iter().map(Vector3::from).collect(), known })
}

impl Points {
    /// The place of each label.
    pub(crate) fn places(&self) -> BTreeMap<&str, usize> {
        self.labels.iter().enumerate().map(|(index, label)| (label.as_str(), index)).collect()
    }

    /// The errors of the calibration of some points as known inputs.
    pub(crate) fn errors(&self, used: &[usize]) -> (Vec<KnownInput>, PointErrors) {
        match &self.known {
            Known::Uncertainty(uncertainty) => {
                let inputs = used.iter().flat_map(|&point| self.uncertain(point, *uncertainty)).collect();
                let own = |place: usize| std::array::from_fn(|along| vec![(3 * place + along, 1.0)]);
                (inputs, (0..used.len()).map(own).collect())
            }
            Known::Certificate(certificate, points) => {
                let named = used.iter().flat_map(|&point| {
                    let CertifiedPoint { label, coordinates } = &points[point];
                    let coordinates = coordinates.iter().zip(ERRORS);
                    coordinates.filter_map(move |(value, own)| Some(((*value)?, format!("point[{label}].{own}"))))
                });
                let errors = Errors::new(certificate, &named.collect::<Vec<_>>(), 0);
                let of = |value: Option<ValueIndex>| value.map_or_else(Vec::new, |value| errors.of(value).to_vec());
                let used = used.iter().map(|&point| points[point].coordinates.map(of)).collect();
                (errors.inputs, used)
            }
        }
    }

    /// The inputs of a point of a table: added to its coordinates, and zero unless the calibration is off.
    fn uncertain(&self, point: usize, uncertainty: f64) -> impl Iterator<Item = KnownInput> {
        let label = &self.labels[point];
        let [x, y, z] = <[f64; 3]>::from(self.points[point]);
        let content = format!("point {label}: {x:e}, {y:e}, {z:e} mm, u = {uncertainty:e} mm");
        ERRORS[..3].iter().map(move |own| {
            let parameter = Parameter::new(format!("point[{label}].{own}"), Unit::MM);
            let quantity = parameter.name.clone();
            KnownInput::new(parameter, 0.0, uncertainty).with_certificate(quantity, &content)
        })
    }
}
