//! The driver: a program file a block, its result from the log.

use std::path::PathBuf;
use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::fault;
use super::files::Files;
use super::prepare::{self, not_ready};
use super::result::{Log, Verdict};
use super::rsh::Rsh;
use crate::base::{Axis, Position};
use crate::controllers::{ControllerError, Driver, Halt, Prepared};
use crate::gcode::{Dialect, Program};
use crate::link::Address;
use crate::record::motion::{Block, Motion, Outcome};

/// LinuxCNC's task runs every 5 ms in its own samples.
const POLL: Duration = Duration::from_millis(4);
/// Idle for so long without the log's end: the program was stopped.
const STOPPED: Duration = Duration::from_millis(60);
/// Running for so long without moving or logging: it hangs (killed parts of LinuxCNC do).
const STALL: Duration = Duration::from_secs(10);
const STEP_OF_NO_BLOCK: u32 = 0;
/// The order of positions in its answers.
const REPORTED: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];
const HALT: &[u8] = b"set enable EMCTOO\nset abort\n";

/// Where it is and what it has.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Of linuxcncrsh, by default port 5007.
    pub address: Address,
    /// A directory that trued and LinuxCNC see under the same absolute name, and may both write.
    pub directory: PathBuf,
    /// The machine's axes.
    pub axes: Vec<Axis>,
}

pub struct LinuxCnc {
    settings: Settings,
    dialect: Dialect,
    rsh: Rsh,
    /// Carries nothing but halts; kept open for them.
    halting: Rsh,
    halt: Halt,
    files: Files,
    /// The mode to go back to.
    mode_found: Option<String>,
    ready: bool,
    /// Orientation of the spindle, rad, once it was given.
    spindle: Option<f64>,
}

impl LinuxCnc {
    /// Connect, twice: once to command, once to halt. Nothing is commanded yet.
    ///
    /// # Errors
    /// No linuxcncrsh at the address; a directory that cannot be used.
    pub async fn open(
        settings: Settings,
        dialect: Dialect,
    ) -> Result<(Self, Halt), ControllerError> {
        let files = Files::within(&settings.directory)?;
        let rsh = Rsh::open(&settings.address).await?;
        let halting = Rsh::open(&settings.address).await?;
        let urgent = halting.link.urgent();
        let halt = Halt::new(move || urgent.send(HALT));
        let driver = Self {
            settings,
            dialect,
            rsh,
            halting,
            halt: halt.clone(),
            files,
            mode_found: None,
            ready: false,
            spindle: None,
        };
        Ok((driver, halt))
    }

    async fn check(&mut self) -> Result<Prepared, ControllerError> {
        self.refuse_if_halted()?;
        self.rsh.enable().await?;
        let estop = self.rsh.get("estop").await?;
        let machine = self.rsh.get("machine").await?;
        let homed = self.rsh.get("joint_homed").await?;
        let joints = self.settings.axes.iter().filter(|axis| **axis != Axis::S).count();
        prepare::judge_switches(&estop, &machine, &homed, joints)?;
        if self.rsh.get("program_status").await? != "IDLE" {
            return Err(not_ready(
                "a program is running",
                "let it end or stop it, then start again",
            ));
        }
        let mode = self.rsh.get("mode").await?;
        self.mode_found.get_or_insert(mode);
        self.rsh.messages().await?;
        self.rsh.set("set_wait received").await?;
        self.rsh.set("mode auto").await?;
        self.files.write(&prepare::program(&self.files.log_name()))?;
        self.rsh.set(&format!("open {}", self.files.program_name())).await?;
        let log = self.run(STEP_OF_NO_BLOCK, STALL).await?;
        if !log.ended {
            self.files.expect_log()?;
            return Err(self.reason(STEP_OF_NO_BLOCK, log).await);
        }
        let version = prepare::judge(&log.state)?;
        Ok(Prepared {
            identity: format!("LinuxCNC {version} ({})", self.rsh.server),
            stop: "a halt aborts: the machine decelerates and stays; the abort acts within 20 ms \
                   (0.1 s at worst), then it travels feed²/(2·acceleration)"
                .to_owned(),
            stands: self.stands().await?,
        })
    }

    /// Where the machine stands; linuxcncrsh gives six numbers, mm and degrees on a metric machine.
    async fn stands(&mut self) -> Result<Position, ControllerError> {
        let at = reported(&self.rsh.get("abs_act_pos").await?)?;
        Ok(at.only(|axis| self.settings.axes.contains(&axis)))
    }

    async fn block(&mut self, block: &Block) -> Result<Outcome, ControllerError> {
        let step = block.step;
        let text = self.render(block)?;
        let leaves_contact = matches!(block.motions.first(), Some(Motion::BackOff { .. }));
        if !leaves_contact && self.rsh.get("probe_value").await? != "0" {
            return Err(ControllerError::StillTripped { step });
        }
        self.files.write(&text)?;
        self.refuse_if_halted()?;
        let log = self.run(step, STALL + dwell(block)).await?;
        if !log.ended {
            return Err(self.reason(step, log).await);
        }
        let backed_off =
            block.motions.iter().any(|motion| matches!(motion, Motion::BackOff { .. }));
        if backed_off && self.rsh.get("probe_value").await? != "0" {
            return Err(ControllerError::StillTripped { step });
        }
        let turned = block.motions.iter().rev().find_map(|motion| match motion {
            Motion::Orient { s } => Some(*s),
            _ => None,
        });
        self.spindle = turned.or(self.spindle);
        let touch = match log.verdict {
            Some(Verdict::Touch(at)) => {
                let mut touch = at.only(|axis| self.settings.axes.contains(&axis));
                if let Some(s) = self.spindle {
                    touch.set(Axis::S, s);
                }
                Some(touch)
            }
            _ => None,
        };
        let touches = |motion: &Motion| matches!(motion, Motion::Probe { .. });
        if touch.is_some() != block.motions.iter().any(touches) {
            return Err(ControllerError::Garbled { text: format!("log of step {step}") });
        }
        Ok(Outcome { touch, t_s: None })
    }

    /// The program, proven to say what the block means.
    fn render(&self, block: &Block) -> Result<String, ControllerError> {
        let fault = |why: String| ControllerError::Render { step: block.step, why };
        let title = format!("step {} repeat {}", block.step, block.repeat);
        let log = self.files.log_name();
        let program = Program { title: &title, axes: &self.settings.axes, log: Some(&log) };
        let blocks = std::slice::from_ref(block);
        let text = self.dialect.program(&program, blocks).map_err(|e| fault(e.to_string()))?;
        self.dialect.proves(&text, blocks).map_err(|e| fault(e.to_string()))?;
        Ok(text)
    }

    /// Run the program and wait until it stands still.
    async fn run(&mut self, step: u32, patience: Duration) -> Result<Log, ControllerError> {
        self.rsh.set("run").await?;
        let (mut changed, mut last) = (Instant::now(), (String::new(), 0));
        let mut idle_since = None;
        loop {
            let idle = self.rsh.get("program_status").await? == "IDLE";
            let log = self.files.log(step)?;
            if idle {
                let since = *idle_since.get_or_insert_with(Instant::now);
                if log.ended || since.elapsed() > STOPPED {
                    return Ok(log);
                }
            } else {
                idle_since = None;
                let now = (self.rsh.get("abs_act_pos").await?, log.lines);
                if now != last {
                    (changed, last) = (Instant::now(), now);
                }
                if changed.elapsed() > patience {
                    let line = format!("the program of step {step}");
                    return Err(ControllerError::NoAnswer {
                        line,
                        seconds: patience.as_secs_f64(),
                    });
                }
            }
            sleep(POLL).await;
        }
    }

    /// Why a program stopped before its end.
    async fn reason(&mut self, step: u32, log: Log) -> ControllerError {
        if self.halt.is_halted() {
            return ControllerError::Halted;
        }
        fault::reason(&mut self.rsh, step, log.verdict.as_ref()).await
    }

    fn refuse_if_halted(&self) -> Result<(), ControllerError> {
        if self.halt.is_halted() { Err(ControllerError::Halted) } else { Ok(()) }
    }

    /// After any failure: whatever still runs is aborted, and nothing runs until `prepare`.
    async fn failed(&mut self, error: ControllerError) -> ControllerError {
        self.ready = false;
        if self.halt.is_halted() {
            return ControllerError::Halted;
        }
        if self.rsh.set("abort").await.is_err() && !self.is_idle().await {
            // The other connection may still live.
            self.halting.link.urgent().send(HALT);
        }
        error
    }

    async fn is_idle(&mut self) -> bool {
        self.rsh.get("program_status").await.is_ok_and(|status| status == "IDLE")
    }
}

impl Driver for LinuxCnc {
    async fn prepare(&mut self) -> Result<Prepared, ControllerError> {
        self.ready = false;
        let prepared = self.check().await?;
        self.ready = true;
        Ok(prepared)
    }

    async fn execute(&mut self, block: &Block) -> Result<Outcome, ControllerError> {
        self.refuse_if_halted()?;
        if !self.ready {
            return Err(not_ready("it was not prepared since the last fault", "start again"));
        }
        match self.block(block).await {
            Ok(outcome) => Ok(outcome),
            Err(error) => Err(self.failed(error).await),
        }
    }

    /// Every program restores the modal state itself; what is left is the mode.
    async fn finish(&mut self) -> Result<(), ControllerError> {
        self.refuse_if_halted()?;
        match self.mode_found.take() {
            Some(mode) => self.rsh.set(&format!("mode {mode}")).await,
            None => Ok(()),
        }
    }
}

/// The position in an answer to `get abs_act_pos`.
pub(super) fn reported(said: &str) -> Result<Position, ControllerError> {
    let numbers: Result<Vec<f64>, _> = said.split_whitespace().map(str::parse).collect();
    let are_six = |numbers: &Vec<f64>| {
        numbers.len() >= REPORTED.len() && numbers.iter().all(|number| number.is_finite())
    };
    let numbers = numbers.ok().filter(are_six);
    let numbers = numbers.ok_or_else(|| ControllerError::Garbled { text: said.to_owned() })?;
    let axes = REPORTED.into_iter().zip(numbers);
    Ok(axes.map(|(axis, at)| (axis, axis.from_edge(at))).collect())
}

fn dwell(block: &Block) -> Duration {
    let seconds = block.motions.iter().map(|motion| match motion {
        Motion::Dwell { seconds } => seconds.max(0.0),
        // As long as the dialect lets it take.
        Motion::Orient { .. } => 20.0,
        _ => 0.0,
    });
    Duration::try_from_secs_f64(seconds.sum()).unwrap_or(STALL)
}
