//! Checks before the first motion: the identity of the control, whether it can measure, and whether its
//! modes are as set.

use std::time::Duration;

use super::built::FirmwareInfo;
use super::check;
use super::driver::Grbl;
use super::fault::not_ready;
use super::message::{Message, Status};
use super::readiness::{self, refuse};
use crate::controllers::stamp::ControlClock;
use crate::controllers::{ControllerError, Prepared};
use machine::Axis;
use planning::gcode::Transmission;

/// Modal words that are restored after the measurement.
const RESTORED: [&str; 16] = [
    "G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3", "G17", "G18", "G19",
    "G20", "G21", "G90", "G91",
];

impl Grbl {
    /// `judge_probe` decides whether the state of the probe input is acceptable.
    pub(super) async fn set_up(
        &mut self,
        judge_probe: fn(&Status) -> Result<(), ControllerError>,
    ) -> Result<Prepared, ControllerError> {
        let status = self.wire.wake().await?;
        if status.state != "Idle" {
            return Err(not_ready(&status));
        }
        let built = self.identify().await?;
        let (axes, settings) = (built.axes(), self.settings().await?);
        refuse(readiness::of_settings(&built, &settings, &axes, &self.homed_axes))?;
        refuse(self.readiness_of_state(&built).await?)?;
        if !self.modes.switches_probe_on() {
            judge_probe(&self.wire.idle().await?)?;
        }
        // The head writes an offset and switches outputs: a state that prevents a measurement is refused before.
        let (modes, offsets) = (self.wire.ask("$G").await?, self.wire.ask("$#").await?);
        refuse(readiness::of_modes(&modes))?;
        refuse(readiness::homed(&built, &settings, &axes, &self.homed_axes, &offsets))?;
        self.remember_modes(modes);
        let head = self.modes.head().to_vec();
        self.set_modes(&head).await?;
        let modes = self.wire.ask("$G").await?;
        let offsets = self.wire.ask("$#").await?;
        refuse(readiness::tool_length(&offsets))?;
        check::modes(&head, &modes, &offsets)?;
        let status = self.wire.idle().await?;
        judge_probe(&status)?;
        check::probe_health(&status, &self.modes)?;
        self.stood = self.stands(&status)?;
        self.clock = ControlClock::default();
        let transmission = Transmission::Lines { max_line_bytes: self.line_limit };
        let (stop, stands) = (self.stop.clone(), self.stood.clone());
        let identity = built.identity();
        let not_readable = readiness::not_readable(&built);
        Ok(Prepared { identity, stop, stands, transmission, not_readable })
    }

    pub(super) async fn identify(&mut self) -> Result<FirmwareInfo, ControllerError> {
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
        Ok(built)
    }

    /// Stores the modal words as they were before the first preparation.
    fn remember_modes(&mut self, modes: Vec<Message>) {
        if !self.found.is_empty() {
            return;
        }
        for message in modes {
            if let Message::Modes(words) = message {
                self.found = words;
                self.found.retain(|word| RESTORED.contains(&word.as_str()));
            }
        }
    }

    /// Sends the lines of the head or the foot.
    pub(super) async fn set_modes(&mut self, lines: &[String]) -> Result<(), ControllerError> {
        let still = self.modes.settles_s().unwrap_or_default();
        let still = Duration::try_from_secs_f64(still).unwrap_or_default();
        for line in lines {
            self.wire.ask_within(line, still).await?;
        }
        Ok(())
    }
}
