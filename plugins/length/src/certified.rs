//! Lengths that a certificate states.

use std::path::Path;

use abbe_core::{DataRow, Dataset, Error, LabelText, Result, Unit};
use abbe_dcc::{DigitalCertificate, Errors, ValueIndex};

/// The certified length of every row.
pub(crate) struct Certified {
    certificate: DigitalCertificate,
    of_rows: Vec<ValueIndex>,
    /// Their errors.
    pub(crate) errors: Errors,
}

impl Certified {
    /// The lengths of rows by the column `reference`; without it the only one that there is.
    pub(crate) fn new(certificate: DigitalCertificate, data: &Dataset) -> Result<Self> {
        let of_rows = match data.column("reference") {
            Some(_) => {
                let labels = DataRow::enumerate(abbe_table::labels(data, "reference")?);
                let find = |(row, label): (DataRow, &LabelText)| {
                    let file = certificate.file.clone();
                    certificate.find(label, Unit::MM).map_err(|error| in_row(data, row, error, &file))
                };
                labels.map(find).collect::<Result<Vec<_>>>()?
            }
            None => vec![certificate.only(Unit::MM)?; data.rows()],
        };
        let mut used = of_rows.clone();
        used.sort_unstable();
        used.dedup();
        let named = |index: ValueIndex| (index, format!("reference[{}].error", certificate.label(index)));
        let named: Vec<(ValueIndex, String)> = used.into_iter().map(named).collect();
        let errors = Errors::new(&certificate, &named, 0);
        Ok(Self { certificate, of_rows, errors })
    }

    /// The lengths, mm.
    pub(crate) fn lengths(&self) -> Vec<f64> {
        self.of_rows.iter().map(|index| self.certificate.value(*index)).collect()
    }

    /// The inputs that make the error of the length of a row, with their derivatives.
    pub(crate) fn of(&self, row: usize) -> &[(usize, f64)] {
        self.errors.of(self.of_rows[row])
    }
}

/// An error of a label, in the row that has it.
fn in_row(data: &Dataset, row: DataRow, error: Error, certificate: &Path) -> Error {
    let message = format!("{} ({})", error.message, certificate.display());
    let here = data.error_at(row, message);
    match error.help {
        Some(help) => here.help(help),
        None => here,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAUGE: &str = r#"<d:digitalCalibrationCertificate xmlns:d="https://ptb.de/dcc" xmlns:s="https://ptb.de/si" schemaVersion="3.2.1">
<d:administrativeData><d:coreData><d:uniqueIdentifier>G-1</d:uniqueIdentifier></d:coreData><d:items><d:item><d:identifications>
<d:identification><d:value>88</d:value></d:identification></d:identifications></d:item></d:items></d:administrativeData>
<d:measurementResults><d:measurementResult><d:results><d:result><d:data><d:quantity><s:realListXMLList>
<s:labelXMLList>L1 L2</s:labelXMLList><s:valueXMLList>0.1000002 0.2000001</s:valueXMLList><s:unitXMLList>\metre</s:unitXMLList>
<s:expandedUncXMLList><s:uncertaintyXMLList>4e-7 6e-7</s:uncertaintyXMLList><s:coverageFactorXMLList>2</s:coverageFactorXMLList>
</s:expandedUncXMLList></s:realListXMLList></d:quantity></d:data></d:result></d:results></d:measurementResult>
</d:measurementResults></d:digitalCalibrationCertificate>"#;

    fn certified(rows: &str) -> Result<Certified> {
        let item = abbe_core::Label("88".to_owned());
        let settings = abbe_dcc::CertificateFile { path: String::new(), item, quantity: None };
        let certificate = DigitalCertificate::parse(Path::new("gauge.xml"), GAUGE, &settings).expect("a certificate");
        Certified::new(certificate, &abbe_table::parse(Path::new("rows.csv"), rows.as_bytes()).expect("rows"))
    }

    #[test]
    fn rows_have_the_lengths_that_their_labels_name() {
        let found = certified("reference,X1_mm\nL2,0\nL1,0\nL2,1\n").expect("lengths");
        for (length, expected) in found.lengths().into_iter().zip([200.0001, 100.0002, 200.0001]) {
            assert!((length - expected).abs() < 1e-10, "{length}");
        }
        let inputs: Vec<(&str, f64)> =
            found.errors.inputs.iter().map(|it| (it.parameter.name.as_str(), it.standard_uncertainty)).collect();
        assert_eq!(
            inputs.iter().map(|(name, _)| *name).collect::<Vec<_>>(),
            ["reference[L1].error", "reference[L2].error"]
        );
        assert!((inputs[0].1 - 2e-4).abs() < 1e-15 && (inputs[1].1 - 3e-4).abs() < 1e-15, "{inputs:?}");
        assert_eq!((found.of(0), found.of(1)), (&[(1, 1.0)][..], &[(0, 1.0)][..]));
    }

    #[test]
    fn a_label_that_the_certificate_lacks_is_told_with_its_row() {
        let error = certified("reference,X1_mm\nL2,0\nL7,0\n").err().expect("no L7").to_string();
        assert!(
            error.contains("rows.csv:3") && error.contains("no value `L7`") && error.contains("gauge.xml"),
            "{error}"
        );
        let error = certified("X1_mm\n0\n").err().expect("two lengths").to_string();
        assert!(error.contains("several values in mm"), "{error}");
    }
}
