//! Findings of a check, and the summary for a support request.

use std::fmt;

use serde::Serialize;

/// The parts of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum CheckPart {
    /// Opening of the links to the control; a fault is diagnosed.
    Links,
    /// Samples of each sensor, and temperature of each thermometer.
    Sensors,
    /// Device information, preparation and displayed position of the control.
    Control,
    /// State of the probe input, with the stylus free and deflected; retract out of contact.
    Probe,
    /// Direction and distance of a jog of each axis.
    Axes,
    /// Effect of a hold during a jog.
    Hold,
    /// Latch of the position of a contact by the control.
    Latch,
    /// Data of `[report]` in the machine file, and the certificate of the artefact.
    Report,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CheckVerdict {
    /// In agreement; also a remark of the control that does not prevent a measurement.
    Ok,
    Failed,
    /// Not checked, with the reason.
    #[serde(rename = "not-looked-at")]
    NotChecked,
}

/// Result of one check.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckFinding {
    pub part: CheckPart,
    pub verdict: CheckVerdict,
    /// Result of the check, fault, or reason why it was not checked.
    pub what: String,
    /// Time from the start of the check in this part to the finding, s; about 0 if not checked.
    pub took_s: f64,
    /// Remedy of a failure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
}

impl fmt::Display for CheckFinding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = match self.verdict {
            CheckVerdict::Ok => "ok",
            CheckVerdict::Failed => "FAILED",
            CheckVerdict::NotChecked => "not checked",
        };
        let (part, what) = (format!("{:?}", self.part).to_lowercase(), &self.what);
        write!(f, "{part:<8}{verdict:<14} {what}")?;
        if self.took_s >= 0.1 {
            write!(f, " ({:.1} s)", self.took_s)?;
        } else if self.verdict != CheckVerdict::NotChecked {
            write!(f, " ({:.1} ms)", 1e3 * self.took_s)?;
        }
        match &self.remedy {
            Some(remedy) => write!(f, "\n        → {remedy}"),
            None => Ok(()),
        }
    }
}

/// All findings of a check. The summary contains the machine's name and no other private data.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct CheckSummary {
    pub program_version: String,
    pub machine: String,
    /// Identity of the control, if it reported one.
    pub control: Option<String>,
    pub findings: Vec<CheckFinding>,
    /// Whether a person has stopped the check.
    pub stopped: bool,
    /// Whether the control was held at the end. It stays held until an operator resets it.
    pub held: bool,
}

impl CheckSummary {
    pub(super) fn for_machine(machine: &str) -> Self {
        Self { program_version: env!("CARGO_PKG_VERSION").to_owned(), machine: machine.to_owned(), ..Self::default() }
    }

    pub fn finding_count(&self, verdict: CheckVerdict) -> usize {
        self.findings.iter().filter(|finding| finding.verdict == verdict).count()
    }
}

const HELD_CONTROL_REMEDY: &str = "the control is held: reset the control (a resume would complete the held move), check \
    the machine, and home it if the control requires homing";

impl fmt::Display for CheckSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "trued {} check of `{}`", self.program_version, self.machine)?;
        writeln!(f, "control: {}", self.control.as_deref().unwrap_or("unknown"))?;
        for finding in &self.findings {
            writeln!(f, "{finding}")?;
        }
        let [ok, failed, open] = [CheckVerdict::Ok, CheckVerdict::Failed, CheckVerdict::NotChecked]
            .map(|verdict| self.finding_count(verdict));
        let stopped = if self.stopped { "; stopped by the operator" } else { "" };
        write!(f, "{ok} ok, {failed} failed, {open} not checked{stopped}")?;
        if self.held {
            write!(f, "; {HELD_CONTROL_REMEDY}")?;
        }
        Ok(())
    }
}
