//! The driver: blocks in, outcomes out.

use std::time::Duration;

use tokio::time::{Instant, sleep};

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
        let wanted = machine.axes.keys().copied().filter(|axis| *axis != Axis::S).collect();
        let grbl = Self {
            wire,
            dialect,
            machine: machine.name.clone(),
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

    /// Send the dialect's head or foot.
    async fn send_frame(&mut self, lines: Frame) -> Result<(), ControllerError> {
        let program = Program { title: &self.machine, axes: &self.wanted, log: None };
        let lines = lines(&self.dialect, &program)
            .map_err(|error| ControllerError::Render { step: 0, why: error.to_string() })?;
        for line in lines {
            self.wire.ask(&line).await?;
        }
        Ok(())
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
            Motion::Rapid { .. } | Motion::Dwell { .. } => {
                self.send(block, motion).await?;
            }
            Motion::Orient { s } => {
                self.send(block, motion).await?;
                self.spindle = Some(*s);
            }
            Motion::BackOff { .. } => {
                self.send(block, motion).await?;
                self.wire.idle().await?;
                self.open_probe(step).await?;
            }
            Motion::Guarded { .. } => {
                let said = self.probe(block, motion).await?;
                if said.hit {
                    return Err(ControllerError::UnexpectedContact { step });
                }
            }
            Motion::Probe { .. } => {
                self.wire.idle().await?;
                self.open_probe(step).await?;
                let said = self.probe(block, motion).await?;
                if !said.hit {
                    return Err(ControllerError::NoContact { step });
                }
                outcome.touch = Some(said.position);
                outcome.t_s = said.t_s;
            }
        }
        Ok(())
    }

    /// A probing line: its result stands between the line and its `ok`.
    async fn probe(&mut self, block: &Block, motion: &Motion) -> Result<Touch, ControllerError> {
        let step = block.step;
        let said = self.send(block, motion).await.map_err(|error| match error {
            ControllerError::Alarm { code: 4, .. } => ControllerError::StillTripped { step },
            ControllerError::Alarm { code: 5, .. } => ControllerError::NoContact { step },
            other => other,
        })?;
        let mut found = None;
        let mut t_s = None;
        for message in &said {
            match message {
                Message::Touch { values, hit } => found = Some((self.position(values)?, *hit)),
                Message::Time(stamp) => t_s = Some(*stamp),
                _ => {}
            }
        }
        let (position, hit) = found.ok_or_else(|| ControllerError::Garbled {
            text: format!("no [PRB:..] before ok, but {said:?}"),
        })?;
        Ok(Touch { position, hit, t_s })
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

struct Touch {
    position: Position,
    hit: bool,
    t_s: Option<f64>,
}

impl Driver for Grbl {
    async fn prepare(&mut self) -> Result<Prepared, ControllerError> {
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
        self.send_frame(Dialect::head).await?;
        let status = self.wire.idle().await?;
        let stands = self.stands(status)?;
        Ok(Prepared { identity, stop: self.stop.clone(), stands })
    }

    async fn execute(&mut self, block: &Block) -> Result<Outcome, ControllerError> {
        let mut outcome = Outcome::default();
        for motion in &block.motions {
            self.act(block, motion, &mut outcome).await?;
        }
        let status = self.wire.idle().await?;
        outcome.t_s = outcome.t_s.or(status.t_s);
        Ok(outcome)
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
