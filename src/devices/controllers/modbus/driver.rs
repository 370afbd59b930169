//! Driver: executes proven blocks and returns their outcomes.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::Config;
use super::fault::{PROBE_CLOSED, is_at_rest_after, probe_open};
use super::patience::Patience;
use super::program::Program;
use super::status::Status;
use super::window::Window;
use crate::controllers::arrival::moved_by_hand;
use crate::controllers::lines::{self, Lines};
use crate::controllers::stamp::{ControlClock, ReportedTime};
use crate::controllers::{ControllerError, DeviceInfo, Driver, Halt, Look, Prepared, arrival};
use machine::record::machine::Machine;
use machine::record::motion::{Motion, Outcome};
use machine::{Axis, Position};
use planning::proof::{ProvenBlock, ProvenModes};

/// Maximum time that the spindle needs to reach its orientation.
pub(super) const ORIENT: Duration = Duration::from_secs(30);
/// Maximum time that a probe bounces after it has come free.
const SETTLE: Duration = Duration::from_millis(300);

/// Driver of one control behind a Modbus window.
pub struct ModbusControl {
    pub(super) window: Window,
    pub(super) modes: ProvenModes,
    pub(super) machine: Machine,
    /// Address of the control, for the record.
    pub(super) name: String,
    /// Axes of the machine file, without the spindle.
    pub(super) wanted: Vec<Axis>,
    /// Largest permitted distance of each axis from its target, mm or rad.
    tolerance: BTreeMap<Axis, f64>,
    /// Last position of the machine at a standstill.
    pub(super) stood: Position,
    /// Whether the control is prepared and no fault has occurred since.
    ready: bool,
    pub(super) spindle: Option<f64>,
    pub(super) clock: ControlClock,
    /// Resident program that executes the blocks; if `None`, their lines are sent.
    pub(super) program: Option<Arc<Program>>,
}

impl ModbusControl {
    /// Opens the window of `machine`'s control; also returns the halt that holds the machine. Nothing is
    /// commanded yet. After a halt the link writes nothing more: a new run opens a new link.
    ///
    /// # Errors
    /// The link cannot be opened, or the register map lacks an axis.
    pub async fn open(
        config: &Config,
        machine: &Machine,
        modes: ProvenModes,
    ) -> Result<(Self, Halt), ControllerError> {
        let wanted: Vec<Axis> =
            machine.axes.keys().copied().filter(|axis| *axis != Axis::S).collect();
        if let Some(axis) = config.map.missing(&wanted) {
            return Err(ControllerError::Unsupported {
                what: format!("its register map does not tell the axis {axis}"),
                remedy: "name it in [controller.registers.status.position] and .latch".to_owned(),
            });
        }
        let switches = modes.settles_s().is_some() || modes.switch_off().is_some();
        if config.program.is_some() && switches {
            return Err(ControllerError::Unsupported {
                what: "no word for the probe or a clamp reaches a resident program".to_owned(),
                remedy: "let that program switch them, and remove [probe] on, off and every clamp"
                    .to_owned(),
            });
        }
        let (line, map) = (config.device.line.clone(), config.map.clone());
        let name = format!("{line}, unit {}", config.device.unit);
        let (window, halt) =
            Window::open(line, config.device.unit, config.device.timeout, map).await?;
        let tolerance = |axis: &Axis| (*axis, arrival::tolerance(*axis, machine.axes.get(axis)));
        let driver = Self {
            window,
            modes,
            machine: machine.clone(),
            name,
            tolerance: wanted.iter().map(tolerance).collect(),
            wanted,
            stood: Position::new(),
            ready: false,
            spindle: None,
            clock: ControlClock::default(),
            program: config.program.clone(),
        };
        Ok((driver, halt))
    }

    /// Replaces the default timeouts.
    pub fn with_patience(mut self, patience: Patience) -> Self {
        self.window.patience = patience;
        self
    }

    /// Sends the lines of one motion; returns the status after the last line.
    async fn send(&mut self, lines: &Lines<'_>) -> Result<Status, ControllerError> {
        let still = standstill(lines.motion) + lines.clamps_rest;
        let mut status = None;
        for line in lines.text.lines() {
            status = Some(self.window.ask(line, still).await?);
        }
        self.rests(status).await
    }

    /// Executes one motion. `seen` is the status after the previous motion, if it was read. Returns the
    /// status after this motion.
    async fn act(
        &mut self,
        lines: &Lines<'_>,
        outcome: &mut Outcome,
        seen: Option<Status>,
    ) -> Result<Status, ControllerError> {
        let step = lines.step;
        match lines.motion {
            Motion::Dwell { .. } => self.send(lines).await,
            Motion::Orient { s } => {
                let status = self.send(lines).await?;
                self.spindle = Some(*s);
                Ok(status)
            }
            Motion::Rapid { to } | Motion::Feed { to, .. } => {
                // The control does not stop the move on a contact: the status shows the contact, and the
                // driver holds.
                self.window.free = Some(step);
                let sent = self.send(lines).await;
                self.window.free = None;
                self.arrive(sent?, to)
            }
            Motion::BackOff { to, .. } => {
                let status = self.send(lines).await?;
                let status = self.arrive(status, to)?;
                self.open_probe(step, status).await
            }
            Motion::Guarded { to, .. } => {
                let seen = self.rests(seen).await?;
                let (hit, status) = self.probe(lines, &seen).await?;
                if hit {
                    return Err(ControllerError::UnexpectedContact { step });
                }
                self.arrive(status, to)
            }
            Motion::Probe { .. } => {
                let seen = self.rests(seen).await?;
                let seen = self.open_probe(step, seen).await?;
                self.touch(lines, outcome, &seen).await
            }
        }
    }

    /// Status at a standstill; read from the control unless `seen` was read after the last motion.
    async fn rests(&mut self, seen: Option<Status>) -> Result<Status, ControllerError> {
        match seen {
            Some(status) => Ok(status),
            None => self.window.idle().await,
        }
    }

    /// Executes a probing move and returns whether there was a contact. The control counts its contacts;
    /// `seen` has the count before the move.
    async fn probe(
        &mut self,
        lines: &Lines<'_>,
        seen: &Status,
    ) -> Result<(bool, Status), ControllerError> {
        let step = lines.step;
        let before = seen.latches;
        let status = self.send(lines).await.map_err(|error| match error {
            ControllerError::Alarm { code, .. } if code == u32::from(PROBE_CLOSED) => {
                ControllerError::StillTripped { step }
            }
            ControllerError::Alarm { code: 5, .. } => ControllerError::NoContact { step },
            other => other,
        })?;
        match status.latches.wrapping_sub(before) {
            0 => Ok((false, status)),
            1 => Ok((true, status)),
            _ => Err(ControllerError::ContradictoryTouch {
                step,
                first: format!("contact {before}"),
                again: format!("contact {}", status.latches),
            }),
        }
    }

    async fn touch(
        &mut self,
        lines: &Lines<'_>,
        outcome: &mut Outcome,
        seen: &Status,
    ) -> Result<Status, ControllerError> {
        let step = lines.step;
        let (hit, status) = self.probe(lines, seen).await?;
        if !hit {
            return Err(ControllerError::NoContact { step });
        }
        let from = std::mem::replace(&mut self.stood, status.position.clone());
        let contact = self.of_machine(&status.latch);
        let astray =
            arrival::contact_off_path(&from, &self.stood, &contact, |axis| self.tolerance(axis));
        if let Some(error) = astray {
            return Err(error);
        }
        outcome.touch = Some(contact.iter().chain(self.spindle.map(|s| (Axis::S, s))).collect());
        outcome.t_s = status.latch_time_s;
        Ok(status)
    }

    /// Restricts a position to the axes of the machine.
    pub(super) fn of_machine(&self, told: &Position) -> Position {
        told.only(|axis| self.wanted.contains(&axis))
    }

    /// Checks that the machine is at its target, by `status`.
    pub(super) fn arrive(
        &mut self,
        status: Status,
        target: &Position,
    ) -> Result<Status, ControllerError> {
        self.stood = status.position.clone();
        let target = target.only(|axis| axis != Axis::S);
        let astray = arrival::astray(&target, &self.stood, |axis| self.tolerance(axis));
        astray.map_or(Ok(status), Err)
    }

    pub(super) fn tolerance(&self, axis: Axis) -> f64 {
        // Axes that the machine file does not name are not checked.
        self.tolerance.get(&axis).copied().unwrap_or(f64::INFINITY)
    }

    /// Waits until the probe reads open, first in the status `seen`; returns the status that shows it. An
    /// error after `SETTLE`.
    pub(super) async fn open_probe(
        &mut self,
        step: u32,
        seen: Status,
    ) -> Result<Status, ControllerError> {
        let deadline = Instant::now() + SETTLE;
        let mut status = seen;
        while status.probe_closed {
            if Instant::now() > deadline {
                return Err(ControllerError::StillTripped { step });
            }
            sleep(SETTLE / 10).await;
            status = self.window.idle().await?;
        }
        Ok(status)
    }

    async fn block(&mut self, block: &ProvenBlock) -> Result<Outcome, ControllerError> {
        if let Some(program) = self.program.clone() {
            return self.call(&program, block).await;
        }
        let mut outcome = Outcome::default();
        let lines = lines::of(block)?;
        self.begin(block).await?;
        let mut seen = None;
        for lines in &lines {
            seen = Some(self.act(lines, &mut outcome, seen).await?);
        }
        let status = self.rests(seen).await?;
        outcome.t_s = self.time_s(outcome.t_s, &status)?;
        Ok(outcome)
    }

    /// Time of a contact, `latch_s`, or else the time of `status`, if the control reports them.
    pub(super) fn time_s(
        &mut self,
        latch_s: Option<f64>,
        status: &Status,
    ) -> Result<Option<f64>, ControllerError> {
        let contact = ReportedTime { name: "latch_time_s", t_s: latch_s };
        self.clock.checked(contact, ReportedTime { name: "time_s", t_s: status.time_s })
    }

    /// Checks before a block moves: no fault of the probe, probe open, machine at the start of the block.
    pub(super) async fn begin(&mut self, block: &ProvenBlock) -> Result<(), ControllerError> {
        let mut status = self.window.idle().await?;
        self.probe_health(&status)?;
        let backs_off = matches!(block.motions().next(), Some(Motion::BackOff { .. }));
        if !backs_off {
            status = self.open_probe(block.step(), status).await?;
        }
        let begins = self.of_machine(block.begins());
        let expected = [&self.stood, &begins].into_iter();
        let mut astray = expected
            .filter_map(|at| arrival::astray(at, &status.position, |axis| self.tolerance(axis)));
        astray.next().map_or(Ok(()), |error| Err(moved_by_hand(error)))
    }

    /// After any fault nothing is sent until `prepare`. If it is not certain that the machine is at rest,
    /// the driver holds it; after that only a new link accepts lines.
    fn failed(&mut self, error: ControllerError) -> ControllerError {
        self.ready = false;
        if !is_at_rest_after(&error) {
            self.window.hold();
        }
        error
    }
}

impl Driver for ModbusControl {
    async fn prepare(&mut self) -> Result<Prepared, ControllerError> {
        self.ready = false;
        let prepared = self.set_up(probe_open).await?;
        self.ready = true;
        Ok(prepared)
    }

    async fn prepare_in_contact(&mut self) -> Result<Prepared, ControllerError> {
        self.ready = false;
        let prepared = self.set_up(|_| Ok(())).await?;
        self.ready = true;
        Ok(prepared)
    }

    async fn execute(&mut self, block: ProvenBlock) -> Result<Outcome, ControllerError> {
        if self.window.is_halted() {
            return Err(ControllerError::Halted);
        }
        if !self.ready {
            return Err(ControllerError::NotReady {
                state: "it was not prepared since the last fault".to_owned(),
                remedy: "start again".to_owned(),
            });
        }
        let outcome = self.block(&block).await;
        outcome.map_err(|error| self.failed(error))
    }

    async fn look(&mut self) -> Result<Look, ControllerError> {
        let status = self.window.status().await?;
        self.stood = self.of_machine(&status.position);
        let stands = self.stood.iter().chain(self.spindle.map(|s| (Axis::S, s))).collect();
        Ok(Look { probe_closed: status.probe_closed, stands })
    }

    async fn introduce(&mut self) -> Result<DeviceInfo, ControllerError> {
        self.report_identity().await
    }

    async fn finish(&mut self) -> Result<(), ControllerError> {
        let foot = self.modes.foot().to_vec();
        self.set_modes(&foot).await?;
        self.window.idle().await.map(|_| ())
    }
}

/// Maximum time of a motion during which the machine is at rest.
fn standstill(motion: &Motion) -> Duration {
    match motion {
        Motion::Dwell { seconds } => Duration::try_from_secs_f64(*seconds).unwrap_or_default(),
        Motion::Orient { .. } => ORIENT,
        _ => Duration::ZERO,
    }
}
