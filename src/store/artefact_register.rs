//! Register of the calibrated artefacts and check standards: `artefacts.json` in the state directory.
//!
//! It is a file and not a table of the journal: `trued plan` and `trued serve --check` read it without opening a
//! journal, and each run stores the data of its artefact in its plan.

use std::path::Path;

use jiff::civil::Date;
use serde::{Deserialize, Serialize};

use super::state_file::{StateFile, StateFileError};
use machine::record::report_data::ReportData;

/// Number of days before the end of a certificate from which on the calibration is due.
const CALIBRATION_DUE_DAYS: i32 = 30;
/// Maximum length of a name, a kind or a certificate, in characters.
const MAX_TEXT_LENGTH: usize = 200;

/// A calibrated artefact or check standard.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegisteredArtefact {
    /// Name, as in `[report] artefact` of a machine file.
    pub name: String,
    /// Kind, such as `cylinder 90 mm`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kind: Option<String>,
    /// Number of the calibration certificate, and the laboratory.
    pub certificate: String,
    /// Last day on which the certificate is valid.
    pub due: Date,
}

/// Validity of a certificate on a day.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CertificateState {
    /// Valid for more than 30 more days.
    Valid,
    /// Valid, for at most 30 more days.
    #[serde(rename = "due_within_30_days")]
    DueSoon,
    Expired,
}

impl CertificateState {
    pub fn label(self) -> &'static str {
        match self {
            Self::Valid => "valid",
            Self::DueSoon => "due within 30 days",
            Self::Expired => "expired",
        }
    }
}

impl RegisteredArtefact {
    /// Validity of the certificate on `day`.
    pub fn certificate_state(&self, day: Date) -> CertificateState {
        // The difference of two civil dates is in days.
        match (self.due - day).get_days() {
            ..0 => CertificateState::Expired,
            0..=CALIBRATION_DUE_DAYS => CertificateState::DueSoon,
            _ => CertificateState::Valid,
        }
    }

    /// Rejects the first text that is blank, too long or has control characters; `kind` may be absent.
    fn check_texts(&self) -> Result<(), ArtefactRegisterError> {
        let texts =
            [("name", Some(&self.name)), ("kind", self.kind.as_ref()), ("certificate", Some(&self.certificate))];
        for (field, text) in texts {
            let is_valid = |text: &String| {
                !text.trim().is_empty()
                    && text.chars().count() <= MAX_TEXT_LENGTH
                    && !text.chars().any(char::is_control)
            };
            if let Some(text) = text.filter(|text| !is_valid(text)) {
                return Err(ArtefactRegisterError::InvalidText { field, text: text.clone() });
            }
        }
        Ok(())
    }
}

/// Why the register of artefacts cannot be read or changed, or why a run must not use its artefact.
#[derive(Debug, thiserror::Error)]
pub enum ArtefactRegisterError {
    #[error(transparent)]
    File(#[from] StateFileError),
    /// `field`: `name`, `kind` or `certificate`.
    #[error("`{text}` is not a valid {field} of an artefact")]
    InvalidText { field: &'static str, text: String },
    #[error("there is no artefact `{0}` in the register")]
    UnknownName(String),
    #[error("[report] states `{key}`, but the register contains the certificate of the artefact `{name}`")]
    StatedTwice { name: String, key: &'static str },
    #[error("the certificate `{certificate}` of the artefact `{name}` was valid until {due}")]
    CertificateExpired { name: String, certificate: String, due: Date },
}

impl ArtefactRegisterError {
    /// Remedy for the user.
    pub fn remedy(&self) -> String {
        match self {
            Self::File(error) => error.remedy().to_owned(),
            Self::InvalidText { .. } => {
                format!("use 1 to {MAX_TEXT_LENGTH} characters, on one line")
            }
            Self::UnknownName(_) => "list the artefacts with `trued artefact list`".to_owned(),
            Self::StatedTwice { name, .. } => format!(
                "remove `certificate` and `certificate_due` from [report] of the machine file; or remove the artefact \
                 from the register: `trued artefact remove {}`",
                shell_quote(name)
            ),
            Self::CertificateExpired { name, .. } => format!(
                "calibrate the artefact, then enter its new certificate: `trued artefact add {} --certificate TEXT \
                 --due YYYY-MM-DD`",
                shell_quote(name)
            ),
        }
    }
}

/// Content of `artefacts.json`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RegisterFile {
    /// Version of the file format.
    trued_artefacts: u32,
    artefacts: Vec<RegisteredArtefact>,
}

/// The register in a state directory.
pub struct ArtefactRegister {
    file: StateFile,
}

impl ArtefactRegister {
    pub fn in_folder(state_dir: &Path) -> Self {
        Self { file: StateFile::new(state_dir, "artefacts.json") }
    }

    /// All artefacts in the order of their names; none without a file.
    ///
    /// # Errors
    /// The file exists and cannot be read.
    pub fn read_all(&self) -> Result<Vec<RegisteredArtefact>, ArtefactRegisterError> {
        Ok(self.file.read()?.map_or_else(Vec::new, |content: RegisterFile| content.artefacts))
    }

    /// Adds `artefact`, or replaces and returns the artefact of this name. If `kind` is `None`, the old kind is kept.
    ///
    /// # Errors
    /// A text is blank, too long or has control characters, or the file cannot be read, locked or written.
    pub fn add(&self, mut artefact: RegisteredArtefact) -> Result<Option<RegisteredArtefact>, ArtefactRegisterError> {
        artefact.check_texts()?;
        let _lock = self.file.lock()?;
        let mut artefacts = self.read_all()?;
        let known = artefacts.iter().position(|known| known.name == artefact.name);
        let replaced = known.map(|index| artefacts.remove(index));
        artefact.kind = artefact.kind.or_else(|| replaced.as_ref()?.kind.clone());
        artefacts.push(artefact);
        artefacts.sort_by(|a, b| a.name.cmp(&b.name));
        self.replace(artefacts)?;
        Ok(replaced)
    }

    /// Removes the artefact of this name.
    ///
    /// # Errors
    /// There is no such artefact, or the file cannot be written.
    pub fn remove(&self, name: &str) -> Result<(), ArtefactRegisterError> {
        let _lock = self.file.lock()?;
        let mut artefacts = self.read_all()?;
        let count = artefacts.len();
        artefacts.retain(|artefact| artefact.name != name);
        if artefacts.len() == count {
            return Err(ArtefactRegisterError::UnknownName(name.to_owned()));
        }
        self.replace(artefacts)
    }

    /// Completes `stated`, from a machine file, with the certificate and its due date if the artefact is in the
    /// register; otherwise returns `stated` unchanged.
    ///
    /// # Errors
    /// `stated` contains the certificate of a registered artefact as well, or the register cannot be read.
    pub fn complete_report_data(&self, stated: &ReportData) -> Result<ReportData, ArtefactRegisterError> {
        Ok(self.find_artefact(stated)?.map_or_else(|| stated.clone(), |artefact| with_certificate(stated, &artefact)))
    }

    /// As [`Self::complete_report_data`], for a run that begins on `today`.
    ///
    /// # Errors
    /// The errors of [`Self::complete_report_data`], or the certificate of a registered artefact has expired.
    pub fn report_data_for_run(&self, stated: &ReportData, today: Date) -> Result<ReportData, ArtefactRegisterError> {
        let Some(artefact) = self.find_artefact(stated)? else { return Ok(stated.clone()) };
        match artefact.certificate_state(today) {
            CertificateState::Valid | CertificateState::DueSoon => Ok(with_certificate(stated, &artefact)),
            CertificateState::Expired => {
                let RegisteredArtefact { name, certificate, due, .. } = artefact;
                Err(ArtefactRegisterError::CertificateExpired { name, certificate, due })
            }
        }
    }

    /// The artefact that `stated` names; `None`: `stated` names none, or it is not in the register.
    ///
    /// # Errors
    /// The register cannot be read, or `stated` has a certificate or due date although the artefact is registered.
    fn find_artefact(&self, stated: &ReportData) -> Result<Option<RegisteredArtefact>, ArtefactRegisterError> {
        let Some(name) = &stated.artefact else { return Ok(None) };
        let Some(artefact) = self.read_all()?.into_iter().find(|artefact| artefact.name == *name) else {
            return Ok(None);
        };
        let stated_twice = [("certificate", &stated.certificate), ("certificate_due", &stated.certificate_due)];
        match stated_twice.into_iter().find(|(_, text)| text.is_some()) {
            Some((key, _)) => Err(ArtefactRegisterError::StatedTwice { name: artefact.name, key }),
            None => Ok(Some(artefact)),
        }
    }

    /// Replaces the whole register; call under the lock of the file.
    fn replace(&self, artefacts: Vec<RegisteredArtefact>) -> Result<(), ArtefactRegisterError> {
        Ok(self.file.replace(&RegisterFile { trued_artefacts: 1, artefacts })?)
    }
}

/// `stated` with the certificate of `artefact` and the last day on which it is valid.
fn with_certificate(stated: &ReportData, artefact: &RegisteredArtefact) -> ReportData {
    ReportData {
        certificate: Some(artefact.certificate.clone()),
        certificate_due: Some(artefact.due.to_string()),
        ..stated.clone()
    }
}

/// `text` as one word of a POSIX shell.
fn shell_quote(text: &str) -> String {
    format!("'{}'", text.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;

    use super::*;

    fn cylinder(due: Date) -> RegisteredArtefact {
        RegisteredArtefact { name: "cylinder 7".to_owned(), kind: None, certificate: "K-114".to_owned(), due }
    }

    #[test]
    fn certificate_is_due_in_its_last_30_days_and_valid_on_its_last_day() {
        use CertificateState::{DueSoon, Expired, Valid};
        let leap_day = cylinder(date(2028, 2, 29));
        let states = [
            (date(2027, 2, 28), Valid),
            (date(2028, 1, 29), Valid),
            (date(2028, 1, 30), DueSoon),
            (date(2028, 2, 29), DueSoon),
            (date(2028, 3, 1), Expired),
            (date(2029, 1, 1), Expired),
        ];
        for (day, state) in states {
            assert_eq!(leap_day.certificate_state(day), state, "{day}");
        }
    }

    #[test]
    fn register_completes_report_data_and_refuses_an_expired_certificate() {
        let folder = tempfile::tempdir().unwrap();
        let register = ArtefactRegister::in_folder(&folder.path().join("made"));
        let named = ReportData { artefact: Some("cylinder 7".to_owned()), ..ReportData::default() };
        let today = date(2026, 11, 27);
        assert_eq!(register.report_data_for_run(&named, today).unwrap(), named);
        assert_eq!(register.add(cylinder(today)).unwrap(), None);
        let completed = register.report_data_for_run(&named, today).unwrap();
        assert_eq!(completed.certificate.as_deref(), Some("K-114"));
        assert_eq!(completed.certificate_due.as_deref(), Some("2026-11-27"));
        let tomorrow = date(2026, 11, 28);
        let expired = register.report_data_for_run(&named, tomorrow).unwrap_err();
        assert!(expired.to_string().contains("2026-11-27") && expired.remedy().contains("add 'cylinder 7'"));
        assert_eq!(register.complete_report_data(&named).unwrap(), completed);
        for twice in [
            ReportData { certificate: Some("K-114".to_owned()), ..named.clone() },
            ReportData { certificate_due: Some("2026-11-27".to_owned()), ..named.clone() },
        ] {
            let error = register.complete_report_data(&twice).unwrap_err();
            assert!(matches!(error, ArtefactRegisterError::StatedTwice { .. }), "{error}");
        }
        // Another artefact may state its certificate in the machine file.
        let other = ReportData { artefact: Some("cylinder 8".to_owned()), ..completed };
        assert_eq!(register.report_data_for_run(&other, tomorrow).unwrap(), other);
    }

    #[test]
    fn add_replaces_a_certificate_and_keeps_the_kind() {
        let folder = tempfile::tempdir().unwrap();
        let register = ArtefactRegister::in_folder(folder.path());
        let old = RegisteredArtefact { kind: Some("cylinder 90 mm".to_owned()), ..cylinder(date(2026, 11, 27)) };
        register.add(old.clone()).unwrap();
        register.add(RegisteredArtefact { name: "A ball".to_owned(), ..old.clone() }).unwrap();
        assert_eq!(register.add(cylinder(date(2028, 1, 1))).unwrap(), Some(old));
        let all = register.read_all().unwrap();
        assert_eq!(all.iter().map(|artefact| artefact.name.as_str()).collect::<Vec<_>>(), ["A ball", "cylinder 7"]);
        assert_eq!((all[1].kind.as_deref(), all[1].due), (Some("cylinder 90 mm"), date(2028, 1, 1)));
        register.remove("A ball").unwrap();
        assert!(matches!(register.remove("A ball"), Err(ArtefactRegisterError::UnknownName(_))));
        for name in ["", "  ", "two\nlines", &"n".repeat(201)] {
            let unnamed = RegisteredArtefact { name: name.to_owned(), ..cylinder(date(2028, 1, 1)) };
            assert!(matches!(register.add(unnamed), Err(ArtefactRegisterError::InvalidText { .. })), "{name}");
        }
    }
}
