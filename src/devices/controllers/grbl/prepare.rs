//! Before anything moves: who is there, whether it can measure, and that it is set as it should be.

use std::time::Duration;

use super::check;
use super::driver::Grbl;
use super::fault::not_ready;
use super::message::Message;
use crate::controllers::{ControllerError, Prepared};
use machine::Axis;
use planning::gcode::Transmission;

/// Bits of `$10`: machine position, pin state and probe coordinates in reports (grblHAL settings).
const REPORT_POSITION: u32 = 1;
const REPORT_PINS: u32 = 1 << 4;
const REPORT_PROBE: u32 = 1 << 7;
/// Modal words that are put back as they were found.
const RESTORED: [&str; 16] = [
    "G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3", "G17", "G18", "G19",
    "G20", "G21", "G90", "G91",
];

impl Grbl {
    pub(super) async fn set_up(&mut self) -> Result<Prepared, ControllerError> {
        let status = self.wire.wake().await?;
        if status.state != "Idle" {
            return Err(not_ready(&status));
        }
        let identity = self.identify().await?;
        self.check_reports().await?;
        if !self.modes.switches_probe_on() {
            check::probe_open(&self.wire.idle().await?)?;
        }
        self.remember_modes().await?;
        let head = self.modes.head().to_vec();
        self.set_modes(&head).await?;
        let modes = self.wire.ask("$G").await?;
        check::modes(&head, &modes, &self.wire.ask("$#").await?)?;
        let status = self.wire.idle().await?;
        check::probe_open(&status)?;
        check::probe_health(&status, &self.modes)?;
        self.stood = self.stands(&status)?;
        let transmission = Transmission::Lines { max_line_bytes: self.line_limit };
        let (stop, stands) = (self.stop.clone(), self.stood.clone());
        Ok(Prepared { identity, stop, stands, transmission })
    }

    /// Who is there; axes and buffer from `$I`.
    pub(super) async fn built(&mut self) -> Result<Built, ControllerError> {
        // Classic Grbl says nothing of its axes: it has these.
        let mut built = Built {
            classic: true,
            version: "unknown version".to_owned(),
            letters: "XYZ".to_owned(),
        };
        for message in self.wire.ask("$I").await? {
            match message {
                Message::Version(text) => built.version = text,
                Message::Buffer(bytes) => self.line_limit = bytes,
                Message::Axes(text) => (built.letters, built.classic) = (text, false),
                _ => {}
            }
        }
        self.axes = built.letters.chars().map(|letter| letter.to_string().parse().ok()).collect();
        Ok(built)
    }

    pub(super) async fn identify(&mut self) -> Result<String, ControllerError> {
        let built = self.built().await?;
        let missing: Vec<String> = (self.wanted.iter())
            .filter(|axis| !self.axes.contains(&Some(**axis)))
            .map(Axis::to_string)
            .collect();
        if !missing.is_empty() {
            return Err(ControllerError::Unsupported {
                what: format!("it drives {}, but not {}", built.letters, missing.join(", ")),
                remedy: "classic Grbl has three axes and cannot measure rotary ones: use grblHAL \
                         built with the machine's axes, or another control"
                    .to_owned(),
            });
        }
        Ok(built.identity())
    }

    /// Refuse reports from which the probe cannot be read. Controls without `$10` queries say
    /// nothing here.
    async fn check_reports(&mut self) -> Result<(), ControllerError> {
        let said = match self.wire.ask("$10").await {
            Err(ControllerError::Refused { .. }) => return Ok(()),
            said => said?,
        };
        let masked = |message: &Message| match message {
            Message::Setting(10, mask) => hides_the_probe(*mask),
            _ => false,
        };
        if said.iter().any(masked) {
            return Err(ControllerError::NotReady {
                state: "its reports hide the probe".to_owned(),
                remedy: "set $10=511 at the control".to_owned(),
            });
        }
        Ok(())
    }

    async fn remember_modes(&mut self) -> Result<(), ControllerError> {
        for message in self.wire.ask("$G").await? {
            if let Message::Modes(words) = message {
                self.found = words;
                self.found.retain(|word| RESTORED.contains(&word.as_str()));
            }
        }
        Ok(())
    }

    /// Send the lines of the head or the foot.
    pub(super) async fn set_modes(&mut self, lines: &[String]) -> Result<(), ControllerError> {
        let still = self.modes.settles_s().unwrap_or_default();
        let still = Duration::try_from_secs_f64(still).unwrap_or_default();
        for line in lines {
            self.wire.ask_within(line, still).await?;
        }
        Ok(())
    }
}

/// How the control is built.
pub(super) struct Built {
    /// Grbl for three axes, before grblHAL.
    pub classic: bool,
    pub version: String,
    /// Its axis words in the order of its reports.
    pub letters: String,
}

impl Built {
    pub fn identity(&self) -> String {
        format!("Grbl {}, axes {}", self.version, self.letters)
    }
}

/// Whether reports with this `$10` leave out what a touch needs. Of grblHAL; classic Grbl has two bits and
/// always shows its inputs.
pub(super) fn hides_the_probe(mask: f64) -> bool {
    let shown = mask as u32;
    [REPORT_POSITION, REPORT_PINS, REPORT_PROBE].iter().any(|bit| shown & bit == 0)
}
