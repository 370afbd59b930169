//! Driver: executes proven blocks and returns their outcomes.

use std::collections::BTreeMap;
use std::time::Duration;

use super::check;
use super::fault::is_at_rest_after;
use super::message::{Message, Status};
use super::watch::Patience;
use super::wire::Wire;
use crate::controllers::lines::Lines;
use crate::controllers::stamp::{ControlClock, ReportedTime};
use crate::controllers::{
    ControllerError, DeviceInfo, Driver, Halt, Look, Prepared, arrival, lines,
};
use link::Link;
use machine::record::machine::{Homing, Machine};
use machine::record::motion::{Motion, Outcome};
use machine::{Axis, Position};
use planning::proof::{ProvenBlock, ProvenModes};

/// Maximum time that the spindle needs to reach its orientation.
const ORIENT: Duration = Duration::from_secs(30);

/// Driver of one Grbl control.
pub struct Grbl {
    pub(super) wire: Wire,
    pub(super) modes: ProvenModes,
    /// Axes of the machine file, without the spindle.
    pub(super) wanted: Vec<Axis>,
    /// Axes of `wanted` that the control must have homed.
    pub(super) homed_axes: Vec<Axis>,
    /// Largest permitted distance of each axis from its target, mm or rad.
    pub(super) tolerance: BTreeMap<Axis, f64>,
    /// Last position of the machine at a standstill.
    pub(super) stood: Position,
    /// Whether the control is prepared and no fault has occurred since.
    pub(super) ready: bool,
    pub(super) stop: String,
    /// Axes in the order of the control's reports; `None` for an axis letter without a name in `trued`.
    pub(super) axes: Vec<Option<Axis>>,
    pub(super) line_limit: usize,
    pub(super) found: Vec<String>,
    pub(super) spindle: Option<f64>,
    pub(super) clock: ControlClock,
}

impl Grbl {
    /// Creates a driver for `machine` on `link` that sets `modes`, and the halt that holds the machine.
    /// After a halt the link accepts no more lines: a new run opens a new link.
    pub fn new(link: Link, machine: &Machine, modes: ProvenModes) -> (Self, Halt) {
        let (wire, halt) = Wire::new(link);
        let wanted: Vec<Axis> =
            machine.axes.keys().copied().filter(|axis| *axis != Axis::S).collect();
        let has_switch =
            |axis: &Axis| machine.axes.get(axis).is_some_and(|spec| spec.homing == Homing::Switch);
        let homed_axes = wanted.iter().copied().filter(has_switch).collect();
        let tolerance = wanted.iter().map(|axis| {
            let spec = machine.axes.get(axis);
            (*axis, check::tolerance(*axis, spec))
        });
        let grbl = Self {
            wire,
            modes,
            tolerance: tolerance.collect(),
            stood: Position::new(),
            ready: false,
            wanted,
            homed_axes,
            stop: format!("feed hold (!): {}", arrival::braking(machine)),
            axes: Vec::new(),
            line_limit: usize::MAX,
            found: Vec::new(),
            spindle: None,
            clock: ControlClock::default(),
        };
        (grbl, halt)
    }

    /// Replaces the default timeouts.
    pub fn with_patience(mut self, patience: Patience) -> Self {
        self.wire.patience = patience;
        self
    }

    /// Sends the lines of one motion and returns the messages received meanwhile.
    pub(super) async fn send(
        &mut self,
        lines: &Lines<'_>,
    ) -> Result<Vec<Message>, ControllerError> {
        let still = standstill(lines.motion) + lines.clamps_rest;
        let mut said = Vec::new();
        for line in lines.text.lines() {
            said.extend(self.wire.ask_within(line, still).await?);
        }
        Ok(said)
    }

    /// Executes one motion. `seen` is the status after the previous motion, if it was read. Returns the
    /// status after this motion, if it was read.
    async fn act(
        &mut self,
        lines: &Lines<'_>,
        outcome: &mut Outcome,
        seen: Option<Status>,
    ) -> Result<Option<Status>, ControllerError> {
        let step = lines.step;
        match lines.motion {
            Motion::Dwell { .. } => {
                self.send(lines).await?;
                Ok(None)
            }
            Motion::Orient { s } => {
                self.send(lines).await?;
                self.spindle = Some(*s);
                Ok(None)
            }
            Motion::Rapid { to } | Motion::Feed { to, .. } => {
                self.free_move(lines, to).await.map(Some)
            }
            Motion::BackOff { to, .. } => {
                self.send(lines).await?;
                let status = self.arrive(to).await?;
                self.open_probe(step, &status).await?;
                Ok(Some(status))
            }
            Motion::Guarded { to, .. } => {
                if self.probe(lines).await?.hit {
                    return Err(ControllerError::UnexpectedContact { step });
                }
                self.arrive(to).await.map(Some)
            }
            Motion::Probe { .. } => {
                let stands = self.rests(seen).await?;
                self.open_probe(step, &stands).await?;
                self.touch(lines, outcome).await.map(Some)
            }
        }
    }

    /// Status at a standstill; read from the control unless `seen` was read after the last motion.
    async fn rests(&mut self, seen: Option<Status>) -> Result<Status, ControllerError> {
        match seen {
            Some(status) => Ok(status),
            None => self.wire.idle().await,
        }
    }

    /// Executes a move that should touch nothing, at rapid or at feed (a turn before the position is
    /// confirmed). The control does not stop the move on a contact: the status reports show the contact,
    /// and the driver holds.
    async fn free_move(
        &mut self,
        lines: &Lines<'_>,
        to: &Position,
    ) -> Result<Status, ControllerError> {
        self.wire.free = Some(lines.step);
        let arrived = match self.send(lines).await {
            Ok(_) => self.arrive(to).await,
            Err(error) => Err(error),
        };
        self.wire.free = None;
        arrived
    }

    async fn touch(
        &mut self,
        lines: &Lines<'_>,
        outcome: &mut Outcome,
    ) -> Result<Status, ControllerError> {
        let step = lines.step;
        let said = self.probe(lines).await?;
        if !said.hit {
            return Err(ControllerError::NoContact { step });
        }
        let contact = self.position(&said.values)?;
        let stands = self.confirm(step, &said, &contact).await?;
        outcome.touch = Some(contact);
        outcome.t_s = said.t_s;
        Ok(stands)
    }
}

impl Grbl {
    async fn block(&mut self, block: &ProvenBlock) -> Result<Outcome, ControllerError> {
        let lines = lines::of(block)?;
        self.begin(block).await?;
        self.wire.in_block = true;
        let moved = self.motions(&lines).await;
        self.wire.in_block = false;
        let (mut outcome, status) = moved?;
        self.speed_as_planned()?;
        let contact = ReportedTime { name: "TIME", t_s: outcome.t_s };
        let now = ReportedTime { name: "Time", t_s: status.t_s };
        outcome.t_s = self.clock.checked(contact, now)?;
        Ok(outcome)
    }

    /// Executes the motions of a block in order; returns their results and the status at the end.
    async fn motions(&mut self, lines: &[Lines<'_>]) -> Result<(Outcome, Status), ControllerError> {
        let (mut outcome, mut seen) = (Outcome::default(), None);
        for lines in lines {
            seen = self.act(lines, &mut outcome, seen).await?;
        }
        let status = self.rests(seen).await?;
        Ok((outcome, status))
    }

    /// Checks before a block moves: overrides at 100 %, no fault of the probe, probe open, machine at the
    /// start of the block.
    async fn begin(&mut self, block: &ProvenBlock) -> Result<(), ControllerError> {
        let status = self.wire.status().await?;
        self.speed_as_planned()?;
        check::probe_health(&status, &self.modes)?;
        let backs_off = matches!(block.motions().next(), Some(Motion::BackOff { .. }));
        if !backs_off {
            self.open_probe(block.step(), &status).await?;
        }
        let stands = self.stands(&status)?;
        self.unmoved(&stands).await?;
        let begins = block.begins().only(|axis| axis != Axis::S);
        let astray = check::astray(&begins, &self.stood, |axis| self.tolerance(axis));
        astray.map_or(Ok(()), |error| Err(arrival::moved_by_hand(error)))
    }

    /// After any fault nothing is sent until `prepare`. If it is not certain that the machine is at rest,
    /// the driver holds it; after that only a new link accepts lines.
    fn failed(&mut self, error: ControllerError) -> ControllerError {
        self.ready = false;
        if !is_at_rest_after(&error) {
            self.wire.hold();
        }
        error
    }
}

impl Driver for Grbl {
    async fn prepare(&mut self) -> Result<Prepared, ControllerError> {
        self.ready = false;
        let prepared = self.set_up(check::probe_open).await?;
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
        if self.wire.is_halted() {
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
        if self.axes.is_empty() {
            // Before `prepare` the axes of the reported values are unknown.
            self.wire.wake().await?;
            self.identify().await?;
        }
        let status = self.wire.status().await?;
        let probe_closed = status.probe_closed;
        self.stood = self.stands(&status)?;
        Ok(Look { probe_closed, stands: self.stood.clone() })
    }

    async fn introduce(&mut self) -> Result<DeviceInfo, ControllerError> {
        self.report_identity().await
    }

    async fn finish(&mut self) -> Result<(), ControllerError> {
        // A blank line clears a latched error.
        self.wire.ask("").await?;
        let foot = self.modes.foot().to_vec();
        self.set_modes(&foot).await?;
        let found = std::mem::take(&mut self.found);
        if !found.is_empty() {
            self.wire.ask(&found.join(" ")).await?;
        }
        self.wire.idle().await.map(|_| ())
    }
}

/// Maximum time of a motion during which the control reports idle.
fn standstill(motion: &Motion) -> Duration {
    match motion {
        Motion::Dwell { seconds } => Duration::try_from_secs_f64(*seconds).unwrap_or_default(),
        Motion::Orient { .. } => ORIENT,
        _ => Duration::ZERO,
    }
}
