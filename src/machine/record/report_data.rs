//! Data that only the report uses: manufacturer and location of the machine, calibration certificate.

use serde::{Deserialize, Serialize};

/// `[report]` of the machine file. A report prints a missing field as "not stated".
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReportData {
    /// Manufacturer of the machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub make: Option<String>,
    /// Model of the machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Serial number of the machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial_number: Option<String>,
    /// Location of the machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub location: Option<String>,
    /// Probe or sensors, with make, model and serial number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub probe: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stylus: Option<String>,
    /// Artefact with make and serial number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub artefact: Option<String>,
    /// Number of the calibration certificate of the artefact, and the laboratory.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certificate: Option<String>,
    /// Last day on which the certificate is valid, `YYYY-MM-DD`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certificate_due: Option<String>,
}

/// One field with its key in the machine file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReportField<'a> {
    pub key: &'static str,
    /// Title in the report.
    pub title: &'static str,
    /// `None`: the machine file does not state the field.
    pub text: Option<&'a str>,
}

impl ReportData {
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// All fields in the order of the report.
    pub fn fields(&self) -> [ReportField<'_>; 9] {
        fn field<'a>(key: &'static str, title: &'static str, text: Option<&'a String>) -> ReportField<'a> {
            ReportField { key, title, text: text.map(String::as_str) }
        }
        [
            field("make", "Make", self.make.as_ref()),
            field("model", "Model", self.model.as_ref()),
            field("serial_number", "Serial number", self.serial_number.as_ref()),
            field("location", "Location", self.location.as_ref()),
            field("probe", "Probe or sensors", self.probe.as_ref()),
            field("stylus", "Stylus", self.stylus.as_ref()),
            field("artefact", "Artefact", self.artefact.as_ref()),
            field("certificate", "Calibration certificate of the artefact", self.certificate.as_ref()),
            field("certificate_due", "Certificate valid until", self.certificate_due.as_ref()),
        ]
    }

    /// Keys that the machine file does not state.
    pub fn missing_keys(&self) -> Vec<&'static str> {
        self.fields().iter().filter(|field| field.text.is_none()).map(|field| field.key).collect()
    }

    /// Whether the certificate is no longer valid on `day`, `YYYY-MM-DD`; false if no date is stated.
    pub fn is_certificate_expired(&self, day: &str) -> bool {
        // Dates in the form `YYYY-MM-DD` have the same order as their texts.
        self.certificate_due.as_deref().is_some_and(|due| due < day)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn certificate_is_valid_on_its_last_day() {
        let data = ReportData { certificate_due: Some("2026-11-27".to_owned()), ..ReportData::default() };
        assert!(!data.is_certificate_expired("2026-11-27") && data.is_certificate_expired("2026-11-28"));
        assert!(!ReportData::default().is_certificate_expired("2026-11-28"));
        assert_eq!(data.missing_keys().len(), 8);
    }

    #[test]
    fn every_field_is_listed() {
        let fields = ReportData::default().fields().map(|field| (field.key.to_owned(), field.key));
        let table = serde_json::to_value(std::collections::BTreeMap::from(fields)).unwrap();
        let data: ReportData = serde_json::from_value(table).unwrap();
        assert!(data.missing_keys().is_empty());
        assert!(data.fields().iter().all(|field| field.text == Some(field.key)));
    }
}
