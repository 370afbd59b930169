//! Checks before the first motion: whether a live control is behind the registers, and whether its modes
//! are set.

use std::time::Duration;

use super::driver::ModbusControl;
use super::fault::not_ready;
use super::otherwise;
use super::status::Status;
use crate::controllers::stamp::ControlClock;
use crate::controllers::{ControllerError, Prepared, ReadinessItem, arrival};
use planning::gcode::Transmission;

impl ModbusControl {
    /// `judge_probe` decides whether the state of the probe input is acceptable.
    pub(super) async fn set_up(
        &mut self,
        judge_probe: fn(&Status) -> Result<(), ControllerError>,
    ) -> Result<Prepared, ControllerError> {
        let status = self.window.living().await?;
        if let Some(error) = not_ready(&status) {
            return Err(error);
        }
        // Sequence numbers continue from here; a chunk that was written before the control started is not
        // accepted.
        (self.window.sequence, self.window.ours) = (status.accepted, false);
        self.plausible(&status)?;
        if !self.modes.switches_probe_on() {
            judge_probe(&status)?;
        }
        if self.program.is_some() {
            self.clear_results(&status).await?;
        }
        let head = self.modes.head().to_vec();
        self.set_modes(&head).await?;
        let status = self.window.idle().await?;
        judge_probe(&status)?;
        self.probe_health(&status)?;
        self.stood = self.of_machine(&status.position);
        self.clock = ControlClock::default();
        self.time_s(None, &status)?;
        let stop = format!(
            "hold (a register): acts when the request under way is answered, within {:.1} s at most; \
             then {}",
            self.window.patience.answer.as_secs_f64(),
            arrival::braking(&self.machine)
        );
        let transmission = match self.program {
            Some(_) => Transmission::Rows,
            // A chunk holds one line.
            None => {
                Transmission::Lines { max_line_bytes: self.window.map.command.chunk.bytes() + 1 }
            }
        };
        let (identity, stands) = (self.identity(), self.stood.clone());
        // The window has registers for the position and the probe; the control's program checks all else.
        let not_readable = ReadinessItem::ALL.into_iter();
        let not_readable = not_readable.filter(|item| *item != ReadinessItem::ProbeInput).collect();
        Ok(Prepared { identity, stop, stands, transmission, not_readable })
    }

    /// Describes what is behind the window, and its address.
    pub(super) fn identity(&self) -> String {
        let what = match &self.program {
            Some(program) => format!("resident program {}", program.number),
            None => "a line window".to_owned(),
        };
        format!("{what} over Modbus, {}", self.name)
    }

    /// Refuses implausible positions. Numbers in the wrong word order are far beyond any travel; whole
    /// numbers read as floating point are nearly zero.
    fn plausible(&self, status: &Status) -> Result<(), ControllerError> {
        for (axis, spec) in &self.machine.axes {
            let Some(value) = status.position.get(*axis) else { continue };
            let (stands, span) = (axis.to_edge(value), spec.max - spec.min);
            let tiny = otherwise::is_no_position(stands);
            if tiny || stands < spec.min - span || stands > spec.max + span {
                let stands = if tiny { format!("{stands:e}") } else { stands.to_string() };
                return Err(ControllerError::UnexpectedDevice {
                    state: format!(
                        "it says that {axis} stands at {stands}, which it cannot: its travel goes from {} to {}",
                        spec.min, spec.max
                    ),
                    remedy: "compare `type`, `order` and `scale` of [controller.registers.status] \
                             position with the control's program"
                        .to_owned(),
                });
            }
        }
        Ok(())
    }

    /// Checks the probe's health inputs that the machine file declares: a letter or the number of a bit.
    pub(super) fn probe_health(&self, status: &Status) -> Result<(), ControllerError> {
        let is_on = |input: &str| {
            let letter = input.chars().next().filter(char::is_ascii_uppercase);
            let bit = match letter {
                Some(letter) => Some(u32::from(letter) - u32::from('A')),
                None => input.parse().ok(),
            };
            bit.and_then(|bit| status.inputs.checked_shr(bit)).is_some_and(|bits| bits & 1 == 1)
        };
        match self.modes.health_inputs().find(|(input, _)| is_on(input)) {
            Some((_, fault)) => Err(ControllerError::Probe { fault }),
            None => Ok(()),
        }
    }

    /// Sends the lines of the head or the foot. A resident program sets its modes itself.
    pub(super) async fn set_modes(&mut self, lines: &[String]) -> Result<(), ControllerError> {
        if self.program.is_some() {
            return Ok(());
        }
        let fault = |why: String| ControllerError::Render { step: 0, why };
        let most = self.window.map.command.chunk.bytes();
        let still = self.modes.settles_s().unwrap_or_default();
        let still = Duration::try_from_secs_f64(still).unwrap_or_default();
        // Comments have no effect at the control, and may be longer than the window.
        for line in lines.iter().filter(|line| !line.starts_with('(')) {
            if line.len() > most {
                return Err(fault(format!("a line is longer than the window: `{line}`")));
            }
            self.window.ask(line, still).await?;
        }
        Ok(())
    }
}
