//! The driver: a program file a block, its result from the log.

use std::path::{Path, PathBuf};
use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::prepare::{self, not_ready};
use super::result::{Log, Verdict};
use super::rsh::Rsh;
use crate::base::Axis;
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
/// linuxcncrsh cuts off longer lines.
const LONGEST_LINE: usize = 250;
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
    program: PathBuf,
    log: PathBuf,
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
    pub async fn open(settings: Settings) -> Result<(Self, Halt), ControllerError> {
        let (program, log) =
            (settings.directory.join("trued.ngc"), settings.directory.join("trued.log"));
        let name = program.to_string_lossy();
        if !settings.directory.is_absolute()
            || name.contains(['(', ')', ' '])
            || name.len() > LONGEST_LINE - 20
        {
            return Err(not_ready(
                &format!("LinuxCNC cannot open {name}"),
                "give [controller] a directory with a short absolute name without blanks and brackets",
            ));
        }
        let dialect = Dialect::named("linuxcnc")
            .map_err(|error| ControllerError::Render { step: 0, why: error.to_string() })?;
        std::fs::create_dir_all(&settings.directory)
            .map_err(|e| unwritable(&settings.directory, &e))?;
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
            program,
            log,
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
        self.write(&prepare::program(&self.log.to_string_lossy()))?;
        self.rsh.set(&format!("open {}", self.program.display())).await?;
        let log = self.run(STEP_OF_NO_BLOCK, STALL).await?;
        if !log.ended {
            return Err(match self.log.exists() {
                true => self.reason(STEP_OF_NO_BLOCK, log).await,
                false => unwritable(&self.log, &std::io::ErrorKind::NotFound.into()),
            });
        }
        let version = prepare::judge(&log.state)?;
        Ok(Prepared {
            identity: format!("LinuxCNC {version} ({})", self.rsh.server),
            stop: "a halt aborts: the machine decelerates and stays; the abort acts within 20 ms \
                   (0.1 s at worst), then it travels feed²/(2·acceleration)"
                .to_owned(),
        })
    }

    async fn block(&mut self, block: &Block) -> Result<Outcome, ControllerError> {
        let step = block.step;
        let text = self.render(block)?;
        let leaves_contact = matches!(block.motions.first(), Some(Motion::BackOff { .. }));
        if !leaves_contact && self.rsh.get("probe_value").await? != "0" {
            return Err(ControllerError::StillTripped { step });
        }
        self.write(&text)?;
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
        let log = self.log.to_string_lossy();
        let program = Program { title: &title, axes: &self.settings.axes, log: Some(&log) };
        let blocks = std::slice::from_ref(block);
        let text = self.dialect.program(&program, blocks).map_err(|e| fault(e.to_string()))?;
        self.dialect.proves(&text, blocks).map_err(|e| fault(e.to_string()))?;
        Ok(text)
    }

    /// Replace the program file whole, and take away the last log.
    fn write(&self, text: &str) -> Result<(), ControllerError> {
        let fresh = self.program.with_extension("new");
        std::fs::write(&fresh, text)
            .and_then(|()| std::fs::rename(&fresh, &self.program))
            .map_err(|error| unwritable(&self.program, &error))?;
        match std::fs::remove_file(&self.log) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(unwritable(&self.log, &error))
            }
            _ => Ok(()),
        }
    }

    /// Run the program and wait until it stands still.
    async fn run(&mut self, step: u32, patience: Duration) -> Result<Log, ControllerError> {
        self.rsh.set("run").await?;
        let (mut changed, mut last) = (Instant::now(), (String::new(), 0));
        let mut idle_since = None;
        loop {
            let idle = self.rsh.get("program_status").await? == "IDLE";
            let log = self.read_log(step)?;
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

    fn read_log(&self, step: u32) -> Result<Log, ControllerError> {
        match std::fs::read_to_string(&self.log) {
            Ok(text) => Log::parse(&text, step),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Log::default()),
            Err(error) => Err(unwritable(&self.log, &error)),
        }
    }

    /// Why a program stopped before its end.
    async fn reason(&mut self, step: u32, log: Log) -> ControllerError {
        if self.halt.is_halted() {
            return ControllerError::Halted;
        }
        match log.verdict {
            Some(Verdict::Contact) => return ControllerError::UnexpectedContact { step },
            Some(Verdict::Tripped) => return ControllerError::StillTripped { step },
            Some(Verdict::NoContact) => return ControllerError::NoContact { step },
            Some(Verdict::Offset) => {
                return not_ready(
                    "the work offset slot G59.3 is not zero",
                    "clear it, see `prepare`",
                );
            }
            Some(Verdict::Touch(_)) | None => {}
        }
        match self.told(step).await {
            Ok(reason) | Err(reason) => reason,
        }
    }

    /// What the control says of it: switches first, then messages.
    async fn told(&mut self, step: u32) -> Result<ControllerError, ControllerError> {
        let alarm = |meaning: &str| ControllerError::Alarm { code: 0, meaning: meaning.to_owned() };
        if self.rsh.get("estop").await? != "OFF" {
            return Ok(alarm("the emergency stop is pressed"));
        }
        if self.rsh.get("machine").await? != "ON" {
            return Ok(alarm("the machine has switched off"));
        }
        let said = self.rsh.messages().await?;
        if said.iter().any(|text| text.contains("Probe tripped")) {
            return Ok(ControllerError::UnexpectedContact { step });
        }
        let meaning = if said.is_empty() {
            "it stopped without a message: somebody stopped it at the control"
        } else {
            "it stopped the program"
        };
        Ok(ControllerError::Refused {
            line: format!("the program of step {step}"),
            reply: said.join("; "),
            meaning: meaning.to_owned(),
        })
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

fn dwell(block: &Block) -> Duration {
    let seconds = block.motions.iter().map(|motion| match motion {
        Motion::Dwell { seconds } => seconds.max(0.0),
        // As long as the dialect lets it take.
        Motion::Orient { .. } => 20.0,
        _ => 0.0,
    });
    Duration::try_from_secs_f64(seconds.sum()).unwrap_or(STALL)
}

fn unwritable(path: &Path, error: &std::io::Error) -> ControllerError {
    not_ready(
        &format!("{} cannot be used: {error}", path.display()),
        "give trued and LinuxCNC a directory that both may write ([controller] directory)",
    )
}
