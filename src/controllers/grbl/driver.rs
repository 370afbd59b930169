//! The driver: blocks in, outcomes out.

use std::collections::BTreeMap;
use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::check;
use super::message::{Message, Status};
use super::wire::{Patience, Wire, not_ready};
use crate::base::{Axis, Position};
use crate::controllers::{ControllerError, Driver, Halt, Prepared};
use crate::gcode::{Dialect, Program, RenderError};
use crate::link::Link;
use crate::record::machine::Machine;
use crate::record::motion::{Block, Motion, Outcome};

/// A probe may bounce this long after it came free.
const SETTLE: Duration = Duration::from_millis(300);
/// A spindle may take this long to find its orientation.
const ORIENT: Duration = Duration::from_secs(30);
/// Bits of `$10`: pin state and probe coordinates in reports (grblHAL settings).
const REPORT_PINS: u32 = 1 << 4;
const REPORT_PROBE: u32 = 1 << 7;
/// Modal words that are put back as they were found.
const RESTORED: [&str; 16] = [
    "G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3", "G17", "G18", "G19",
    "G20", "G21", "G90", "G91",
];

/// The driver of one control.
pub struct Grbl {
    wire: Wire,
    dialect: Dialect,
    machine: String,
    /// Axes that the machine file names, without the spindle.
    wanted: Vec<Axis>,
    /// How far from its target each may stand, mm or rad.
    tolerance: BTreeMap<Axis, f64>,
    /// Where the machine last stood still.
    stood: Position,
    /// Prepared, and no fault since.
    ready: bool,
    stop: String,
    /// Axis words in the order of the control's reports; `None` for one that has no name here.
    axes: Vec<Option<Axis>>,
    line_limit: usize,
    found: Vec<String>,
    spindle: Option<f64>,
}

impl Grbl {
    /// A driver for `machine` behind `link` that writes `dialect`, and the halt that holds it.
    /// After a halt the link takes no line any more: a new run opens a new one.
    pub fn new(link: Link, machine: &Machine, dialect: Dialect) -> (Self, Halt) {
        let (wire, halt) = Wire::new(link);
        let wanted: Vec<Axis> =
            machine.axes.keys().copied().filter(|axis| *axis != Axis::S).collect();
        let tolerance = wanted.iter().map(|axis| {
            let spec = machine.axes.get(axis);
            (*axis, check::tolerance(*axis, spec))
        });
        let grbl = Self {
            wire,
            dialect,
            machine: machine.name.clone(),
            tolerance: tolerance.collect(),
            stood: Position::new(),
            ready: false,
            wanted,
            stop: stop_in_words(machine),
            axes: Vec::new(),
            line_limit: usize::MAX,
            found: Vec::new(),
            spindle: None,
        };
        (grbl, halt)
    }

    /// Wait otherwise than by default.
    pub fn with_patience(mut self, patience: Patience) -> Self {
        self.wire.patience = patience;
        self
    }

    /// Who is there; axes and buffer from `$I`.
    async fn identify(&mut self) -> Result<String, ControllerError> {
        let mut version = "unknown version".to_owned();
        // Classic Grbl says nothing of its axes: it has these.
        let mut letters = "XYZ".to_owned();
        for message in self.wire.ask("$I").await? {
            match message {
                Message::Version(text) => version = text,
                Message::Buffer(bytes) => self.line_limit = bytes,
                Message::Axes(text) => letters = text,
                _ => {}
            }
        }
        self.axes = letters.chars().map(|letter| letter.to_string().parse().ok()).collect();
        let missing: Vec<String> = (self.wanted.iter())
            .filter(|axis| !self.axes.contains(&Some(**axis)))
            .map(Axis::to_string)
            .collect();
        if !missing.is_empty() {
            return Err(ControllerError::Unsupported {
                what: format!("it drives {letters}, but not {}", missing.join(", ")),
                remedy: "classic Grbl has three axes and cannot measure rotary ones: use grblHAL \
                         built with the machine's axes, or another control"
                    .to_owned(),
            });
        }
        Ok(format!("Grbl {version}, axes {letters}"))
    }

    /// Refuse reports from which the probe cannot be read. Controls without `$10` queries say
    /// nothing here.
    async fn check_reports(&mut self) -> Result<(), ControllerError> {
        let said = match self.wire.ask("$10").await {
            Err(ControllerError::Refused { .. }) => return Ok(()),
            said => said?,
        };
        let masked = |message: &Message| match message {
            Message::ReportMask(mask) => mask & REPORT_PINS == 0 || mask & REPORT_PROBE == 0,
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

    /// Send the dialect's head or foot; the lines.
    async fn send_frame(&mut self, lines: Frame) -> Result<Vec<String>, ControllerError> {
        let program = Program { title: &self.machine, axes: &self.wanted, log: None };
        let lines = lines(&self.dialect, &program)
            .map_err(|error| ControllerError::Render { step: 0, why: error.to_string() })?;
        for line in &lines {
            self.wire.ask(line).await?;
        }
        Ok(lines)
    }

    /// Send the lines of one motion; what was said while they ran.
    async fn send(
        &mut self,
        block: &Block,
        motion: &Motion,
    ) -> Result<Vec<Message>, ControllerError> {
        let unit = Block { motions: vec![motion.clone()], ..*block };
        let why = |why| ControllerError::Render { step: block.step, why };
        let lines = self.dialect.block(&unit).map_err(|error| why(error.to_string()))?;
        let mut said = Vec::new();
        for line in lines {
            if line.len() >= self.line_limit {
                return Err(why(format!("a line is longer than the control's buffer: `{line}`")));
            }
            said.extend(self.wire.ask_within(&line, standstill(motion)).await?);
        }
        Ok(said)
    }

    async fn act(
        &mut self,
        block: &Block,
        motion: &Motion,
        outcome: &mut Outcome,
    ) -> Result<(), ControllerError> {
        let step = block.step;
        match motion {
            Motion::Dwell { .. } => {
                self.send(block, motion).await?;
            }
            Motion::Orient { s } => {
                self.send(block, motion).await?;
                self.spindle = Some(*s);
            }
            Motion::Rapid { to } => {
                self.send(block, motion).await?;
                self.arrive(to).await?;
            }
            Motion::BackOff { to, .. } => {
                self.send(block, motion).await?;
                self.arrive(to).await?;
                self.open_probe(step).await?;
            }
            Motion::Guarded { to, .. } => {
                let said = self.probe(block, motion).await?;
                if said.hit {
                    return Err(ControllerError::UnexpectedContact { step });
                }
                self.arrive(to).await?;
            }
            Motion::Probe { .. } => {
                self.wire.idle().await?;
                self.open_probe(step).await?;
                let said = self.probe(block, motion).await?;
                if !said.hit {
                    return Err(ControllerError::NoContact { step });
                }
                let contact = self.position(&said.values)?;
                self.confirm(step, &said, &contact).await?;
                outcome.touch = Some(contact);
                outcome.t_s = said.t_s;
            }
        }
        Ok(())
    }

    /// Wait until the machine stands, and see that it stands where it was sent.
    async fn arrive(&mut self, target: &Position) -> Result<(), ControllerError> {
        let deadline = Instant::now() + self.wire.patience.aftermath;
        let target = target.only(|axis| axis != Axis::S);
        loop {
            let status = self.wire.idle().await?;
            self.stood = self.stands(status)?;
            match check::astray(&target, &self.stood, |axis| self.tolerance(axis)) {
                None => return Ok(()),
                // The reports may be older than the motion.
                Some(error) if Instant::now() > deadline => return Err(error),
                Some(_) => sleep(self.wire.patience.poll / 10).await,
            }
        }
    }

    fn tolerance(&self, axis: Axis) -> f64 {
        // Axes that the machine file does not name do not matter.
        self.tolerance.get(&axis).copied().unwrap_or(f64::INFINITY)
    }

    /// The control tells a touch again on `$#`: both must be the same to the last digit, and lie on
    /// the way that the machine came.
    async fn confirm(
        &mut self,
        step: u32,
        said: &Touch,
        contact: &Position,
    ) -> Result<(), ControllerError> {
        let from = self.stood.clone();
        let status = self.wire.idle().await?;
        self.stood = self.stands(status)?;
        let again = touch_of(&self.wire.ask("$#").await?)?;
        if again != *said {
            let (first, again) = (format!("{said:?}"), format!("{again:?}"));
            return Err(ControllerError::Doubtful { step, first, again });
        }
        let contact = contact.only(|axis| axis != Axis::S);
        let astray = check::off_the_way(&from, &self.stood, &contact, |axis| self.tolerance(axis));
        astray.map_or(Ok(()), Err)
    }

    /// A probing line: its result stands between the line and its `ok`.
    async fn probe(&mut self, block: &Block, motion: &Motion) -> Result<Touch, ControllerError> {
        let step = block.step;
        let said = self.send(block, motion).await.map_err(|error| match error {
            ControllerError::Alarm { code: 4, .. } => ControllerError::StillTripped { step },
            ControllerError::Alarm { code: 5, .. } => ControllerError::NoContact { step },
            other => other,
        })?;
        touch_of(&said)
    }

    fn stands(&self, status: Status) -> Result<Position, ControllerError> {
        let values = status.position.ok_or_else(|| ControllerError::NotReady {
            state: "its reports hide the machine position".to_owned(),
            remedy: "set $10=511 at the control".to_owned(),
        })?;
        self.position(&values)
    }

    fn position(&self, values: &[f64]) -> Result<Position, ControllerError> {
        if values.len() != self.axes.len() {
            return Err(ControllerError::Garbled { text: format!("[PRB:{values:?}]") });
        }
        let named = self.axes.iter().zip(values);
        let axes =
            named.filter_map(|(axis, value)| axis.map(|axis| (axis, axis.from_edge(*value))));
        let spindle = self.spindle.map(|s| (Axis::S, s));
        Ok(axes.chain(spindle).collect())
    }

    /// The probe reads open, or does so before long.
    async fn open_probe(&mut self, step: u32) -> Result<(), ControllerError> {
        let deadline = Instant::now() + SETTLE;
        loop {
            if !self.wire.status().await?.probe_closed {
                return Ok(());
            }
            if Instant::now() > deadline {
                return Err(ControllerError::StillTripped { step });
            }
            sleep(SETTLE / 10).await;
        }
    }
}

type Frame = fn(&Dialect, &Program) -> Result<Vec<String>, RenderError>;

/// The result of a probing move as the control tells it.
#[derive(Debug, Clone, PartialEq)]
struct Touch {
    /// In the order of the control's reports, mm and degrees.
    values: Vec<f64>,
    hit: bool,
    t_s: Option<f64>,
}

/// The one result among what was said.
fn touch_of(said: &[Message]) -> Result<Touch, ControllerError> {
    let mut found = None;
    let mut t_s = None;
    for message in said {
        match message {
            Message::Touch { values, hit } if found.is_none() => {
                found = Some((values.clone(), *hit));
            }
            Message::Touch { .. } => {
                let text = format!("two results of one probing move: {said:?}");
                return Err(ControllerError::Garbled { text });
            }
            Message::Time(stamp) => t_s = Some(*stamp),
            _ => {}
        }
    }
    let (values, hit) = found.ok_or_else(|| ControllerError::Garbled {
        text: format!("no [PRB:..] before ok, but {said:?}"),
    })?;
    Ok(Touch { values, hit, t_s })
}

impl Grbl {
    async fn set_up(&mut self) -> Result<Prepared, ControllerError> {
        let status = self.wire.wake().await?;
        if status.state != "Idle" {
            return Err(not_ready(&status));
        }
        let identity = self.identify().await?;
        self.check_reports().await?;
        if self.wire.idle().await?.probe_closed {
            return Err(ControllerError::NotReady {
                state: "the probe reads closed".to_owned(),
                remedy: "free the stylus; check the probe's battery, cable and polarity".to_owned(),
            });
        }
        self.remember_modes().await?;
        let head = self.send_frame(Dialect::head).await?;
        let modes = self.wire.ask("$G").await?;
        check::modes(&head, &modes, &self.wire.ask("$#").await?)?;
        let status = self.wire.idle().await?;
        self.stood = self.stands(status)?;
        Ok(Prepared { identity, stop: self.stop.clone(), stands: self.stood.clone() })
    }

    async fn block(&mut self, block: &Block) -> Result<Outcome, ControllerError> {
        let mut outcome = Outcome::default();
        for motion in &block.motions {
            self.act(block, motion, &mut outcome).await?;
        }
        let status = self.wire.idle().await?;
        outcome.t_s = outcome.t_s.or(status.t_s);
        Ok(outcome)
    }

    /// After any fault nothing is sent until `prepare`. Where it is not certain that the machine
    /// stands, it is held; then only a new link takes lines again.
    fn failed(&mut self, error: ControllerError) -> ControllerError {
        self.ready = false;
        if !stands_after(&error) {
            self.wire.hold();
        }
        error
    }
}

impl Driver for Grbl {
    async fn prepare(&mut self) -> Result<Prepared, ControllerError> {
        self.ready = false;
        let prepared = self.set_up().await?;
        self.ready = true;
        Ok(prepared)
    }

    async fn execute(&mut self, block: &Block) -> Result<Outcome, ControllerError> {
        if self.wire.is_halted() {
            return Err(ControllerError::Halted);
        }
        if !self.ready {
            return Err(ControllerError::NotReady {
                state: "it was not prepared since the last fault".to_owned(),
                remedy: "start again".to_owned(),
            });
        }
        let outcome = self.block(block).await;
        outcome.map_err(|error| self.failed(error))
    }

    async fn finish(&mut self) -> Result<(), ControllerError> {
        // A blank line ends a latched error.
        self.wire.ask("").await?;
        self.send_frame(Dialect::foot).await?;
        if !self.found.is_empty() {
            self.wire.ask(&self.found.join(" ")).await?;
        }
        self.wire.idle().await.map(|_| ())
    }
}

/// Faults that the control itself reports at a standstill.
fn stands_after(error: &ControllerError) -> bool {
    use ControllerError as E;
    matches!(
        error,
        E::Halted
            | E::HeldThere { .. }
            | E::Alarm { .. }
            | E::Reset { .. }
            | E::NoContact { .. }
            | E::UnexpectedContact { .. }
            | E::StillTripped { .. }
            | E::Astray { .. }
            | E::Doubtful { .. }
            | E::NotReady { .. }
            | E::Render { .. }
    )
}

/// How long a motion may take while the control reports idle.
fn standstill(motion: &Motion) -> Duration {
    match motion {
        Motion::Dwell { seconds } => Duration::try_from_secs_f64(*seconds).unwrap_or_default(),
        Motion::Orient { .. } => ORIENT,
        _ => Duration::ZERO,
    }
}

/// From the machine file: braking from rapid at the set acceleration, v²/2a, axis by axis.
fn stop_in_words(machine: &Machine) -> String {
    let braking = machine.axes.iter().filter(|(axis, _)| **axis != Axis::S).map(|(axis, spec)| {
        let speed = spec.rapid_per_min / 60.0;
        let unit = if axis.is_linear() { "mm" } else { "deg" };
        format!("{axis} {:.1} {unit}", speed * speed / (2.0 * spec.acceleration_per_s2))
    });
    let braking: Vec<String> = braking.collect();
    format!("feed hold (!): brakes on the path and stays; at most {}", braking.join(", "))
}
