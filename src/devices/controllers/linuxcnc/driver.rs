//! Driver: writes one program file per block and reads its result from the log.

use std::path::PathBuf;
use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::fault;
use super::files::Files;
use super::ini::Ini;
use super::not_ready::not_ready;
use super::prepare;
use super::result::{Log, Verdict};
use super::rsh::Rsh;
use super::watch::Watched;
use super::{Sampler, kinematics, state, watch, way};
use crate::controllers::{
    ControllerError, DeviceInfo, Driver, Halt, Look, Prepared, ReadinessItem, arrival,
};
use link::Address;
use machine::record::motion::{Motion, Outcome};
use machine::record::track::Track;
use machine::{Axis, Position};
use planning::gcode::{Transmission, Unit};
use planning::proof::{ProvenBlock, ProvenModes};

/// Maximum time until the link's task has written a line.
const ON_THE_WIRE: Duration = Duration::from_millis(20);
/// Maximum time for an axis to settle at its target.
const SETTLES: Duration = Duration::from_millis(500);
const STEP_OF_NO_BLOCK: u32 = 0;
/// Limits for a program that moves nothing.
const WITHOUT_MOTION: Watched<'_> =
    Watched { step: STEP_OF_NO_BLOCK, rests: Duration::ZERO, turns_to: None };
const HALT: &[u8] = b"set enable EMCTOO\nset abort\n";

/// Address and shared directory of the control, and properties of its machine.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Address of linuxcncrsh, by default port 5007.
    pub address: Address,
    /// Directory that `trued` and LinuxCNC see under the same absolute name and can both write.
    pub directory: PathBuf,
    /// The machine's axes.
    pub axes: Vec<Axis>,
    /// INI file that LinuxCNC was started with, if it is known.
    pub ini: Option<PathBuf>,
}

pub struct LinuxCnc {
    pub(super) settings: Settings,
    modes: ProvenModes,
    pub(super) rsh: Rsh,
    /// Connection that carries only halts; kept open for them.
    halting: Rsh,
    halt: Halt,
    files: Files,
    /// Mode of the control, which `finish` restores; each program restores its other modal state itself.
    mode_found: Option<String>,
    ready: bool,
    /// Orientation of the spindle, rad, once it was commanded.
    spindle: Option<f64>,
    sampler: Option<Sampler>,
}

impl LinuxCnc {
    /// Connects twice: once to command, once to halt. Nothing is commanded yet.
    ///
    /// # Errors
    /// No linuxcncrsh at the address; an unusable directory.
    pub async fn open(
        settings: Settings,
        modes: ProvenModes,
    ) -> Result<(Self, Halt), ControllerError> {
        let files = Files::within(&settings.directory)?;
        let mut rsh = Rsh::open(&settings.address).await?;
        let halting = Rsh::open(&settings.address).await?;
        let urgent = halting.link.urgent();
        let halt = Halt::new(move || urgent.send(HALT));
        rsh.halt = Some(halt.clone());
        let driver = Self {
            settings,
            modes,
            rsh,
            halting,
            halt: halt.clone(),
            files,
            mode_found: None,
            ready: false,
            spindle: None,
            sampler: None,
        };
        Ok((driver, halt))
    }

    pub fn transmission(&self) -> Transmission {
        Transmission::Programs { log: self.files.log_name() }
    }

    /// Sets the sampler that timestamps positions during motion.
    pub fn stamped_by(self, sampler: Option<Sampler>) -> Self {
        Self { sampler, ..self }
    }

    /// Checks the switches and the state; changes only how linuxcncrsh answers.
    async fn look(&mut self, ini: Option<&Ini>) -> Result<(), ControllerError> {
        // Both settings apply to all connections. With a timeout linuxcncrsh would acknowledge commands
        // that the task has not accepted.
        self.rsh.set("set_wait received").await?;
        self.rsh.set("timeout 0").await?;
        let estop = self.rsh.get("estop").await?;
        let machine = self.rsh.get("machine").await?;
        let homed = self.rsh.get("joint_homed").await?;
        let joints = ini.and_then(Ini::joints);
        prepare::judge_switches(&estop, &machine, &homed, &self.settings.axes, joints)?;
        // The reported switches may be outdated. (While the machine is stopped, this would be refused.)
        watch::sign_of_life(&mut self.rsh).await?;
        if self.rsh.get("program_status").await? != "IDLE" {
            return Err(not_ready(
                "a program is running",
                "let it end or stop it, then start again",
            ));
        }
        state::full_speed(&mut self.rsh).await
    }

    async fn check(&mut self) -> Result<Prepared, ControllerError> {
        self.refuse_if_halted()?;
        let ini = self.settings.ini.as_deref().map(Ini::read).transpose()?;
        self.rsh.enable().await?;
        self.look(ini.as_ref()).await?;
        let mode = self.rsh.get("mode").await?;
        self.mode_found.get_or_insert(mode);
        self.rsh.messages().await?;
        self.rsh.command("mode auto").await?;
        self.files.write(&prepare::program(&self.files.log_name()))?;
        self.rsh.command(&format!("open {}", self.files.program_name())).await?;
        let log = watch::run(&mut self.rsh, &self.files, &self.halt, WITHOUT_MOTION).await?;
        if !log.ended {
            self.files.expect_log()?;
            return Err(self.reason(STEP_OF_NO_BLOCK, log).await);
        }
        let axes = &self.settings.axes;
        let state = prepare::judge(&log.state, axes)?;
        state::axes_are_joints(&mut self.rsh, axes).await?;
        let stands = state::stands(&mut self.rsh, axes).await?;
        kinematics::judge(ini.as_ref(), state.kinematics, &stands)?;
        if let Some(seconds) = self.modes.settles_s() {
            let program = self.modes.switch_on().to_owned();
            self.switch(&program).await?;
            sleep(Duration::try_from_secs_f64(seconds).unwrap_or_default()).await;
        }
        let axes = &self.settings.axes;
        let mut identity = format!("LinuxCNC {} ({})", state.version, self.rsh.server);
        if let Some(sampler) = &mut self.sampler {
            let mm = state::unit_mm(&mut self.rsh).await?;
            sampler.agrees(&stands, axes, mm).await?;
            identity += &format!("; {}", sampler.says());
        }
        Ok(Prepared {
            identity,
            stop: "a halt aborts: the machine decelerates and stays; the abort acts within 20 ms \
                   (0.1 s at worst), then it travels feed²/(2·acceleration)"
                .to_owned(),
            stands,
            transmission: self.transmission(),
            not_readable: NOT_READABLE.to_vec(),
        })
    }

    /// Runs one program for each part of the block: after a back-off the probe must read open before
    /// anything else moves.
    async fn block(&mut self, block: &ProvenBlock) -> Result<Outcome, ControllerError> {
        if *block.transmission() != self.transmission() {
            return Err(ControllerError::Transmission { step: block.step() });
        }
        let units = block.units()?;
        self.begins(block).await?;
        let sampler = self.sampler.as_ref().filter(|_| block.motions().any(moves_at_feed));
        sampler.inspect(|sampler| sampler.begin());
        let mut touch = None;
        for proven in units {
            touch = self.part(block.step(), &proven.unit).await?.or(touch);
        }
        Ok(Outcome { touch, t_s: None, track: self.track(block).await? })
    }

    /// Checks that the machine is where the proven block begins.
    async fn begins(&mut self, block: &ProvenBlock) -> Result<(), ControllerError> {
        let axes = &self.settings.axes;
        let begins = block.begins().only(|axis| axis != Axis::S && axes.contains(&axis));
        if begins.is_empty() {
            return Ok(());
        }
        let stands = state::stands(&mut self.rsh, axes).await?;
        let astray = arrival::astray(&begins, &stands, |axis| arrival::tolerance(axis, None));
        astray.map_or(Ok(()), |error| Err(arrival::moved_by_hand(error)))
    }

    /// Positions of the axes during `block`, if the block moves at feed and there is a sampler.
    async fn track(&mut self, block: &ProvenBlock) -> Result<Option<Track>, ControllerError> {
        let wanted = self.sampler.as_ref().filter(|_| block.motions().any(moves_at_feed));
        let Some(sampler) = wanted else { return Ok(None) };
        let stands = state::stands(&mut self.rsh, &self.settings.axes).await?;
        sampler.end(block.step(), &stands).await.map(Some)
    }

    async fn part(&mut self, step: u32, part: &Unit) -> Result<Option<Position>, ControllerError> {
        if !part.motions.first().is_some_and(backs_off) {
            self.probe_is_open(step).await?;
        }
        state::full_speed(&mut self.rsh).await?;
        state::opened(&mut self.rsh, &self.files.program_name()).await?;
        self.files.write(&part.text)?;
        self.refuse_if_halted()?;
        // A contact while an axis turns must stop the axis (`planning::turning`).
        let ends = way::end_of_turns(&part.motions);
        let watched = Watched { step, rests: watch::rests(part), turns_to: ends.as_ref() };
        let log = match watch::run(&mut self.rsh, &self.files, &self.halt, watched).await {
            Err(refusal @ ControllerError::Refused { .. }) => {
                return Err(fault::refused(&mut self.rsh, refusal).await);
            }
            ended => ended?,
        };
        if !log.ended {
            return Err(self.reason(step, log).await);
        }
        if part.motions.last().is_some_and(backs_off) {
            self.probe_is_open(step).await?;
        }
        state::axes_are_joints(&mut self.rsh, &self.settings.axes).await?;
        if part.motions.iter().any(touches) {
            // The feed override may have changed since the part began.
            state::full_speed(&mut self.rsh).await?;
        }
        self.arrived(step, part).await?;
        self.touched(step, part, log.verdict)
    }

    /// Checks, after the program has ended, that the machine has reached the end of the path. If LinuxCNC's
    /// task is late, its interpreter reads on before a probing move has begun (2.9, issue 3650), and a
    /// contact in that move shows nowhere else.
    async fn arrived(&mut self, step: u32, part: &Unit) -> Result<(), ControllerError> {
        let deadline = Instant::now() + SETTLES;
        loop {
            let stands = state::stands(&mut self.rsh, &self.settings.axes).await?;
            match way::astray(&part.motions, &stands) {
                None => return Ok(()),
                // The position is that of the feedback: an axis may still be settling.
                Some(_) if Instant::now() < deadline => sleep(ON_THE_WIRE).await,
                Some(error) => {
                    self.probe_is_open(step).await?;
                    return Err(error);
                }
            }
        }
    }

    async fn probe_is_open(&mut self, step: u32) -> Result<(), ControllerError> {
        match self.rsh.get("probe_value").await?.as_str() {
            "0" => Ok(()),
            _ => Err(ControllerError::StillTripped { step }),
        }
    }

    /// Returns the position at the trigger, if `part` has a touch.
    fn touched(
        &mut self,
        step: u32,
        part: &Unit,
        verdict: Option<Verdict>,
    ) -> Result<Option<Position>, ControllerError> {
        let turned = part.motions.iter().rev().find_map(|motion| match motion {
            Motion::Orient { s } => Some(*s),
            _ => None,
        });
        self.spindle = turned.or(self.spindle);
        match (part.motions.iter().any(touches), verdict) {
            (true, Some(Verdict::Touch(at))) => {
                if let Some(error) = way::contact_off_path(&part.motions, &at) {
                    return Err(error);
                }
                let at = at.only(|axis| self.settings.axes.contains(&axis));
                Ok(Some(self.spindle.map_or(at.clone(), |s| at.with(Axis::S, s))))
            }
            (false, None) => Ok(None),
            _ => Err(ControllerError::Garbled { text: format!("log of step {step}") }),
        }
    }

    /// Runs a program that moves nothing.
    async fn switch(&mut self, program: &str) -> Result<(), ControllerError> {
        self.files.write(program)?;
        self.refuse_if_halted()?;
        let log = watch::run(&mut self.rsh, &self.files, &self.halt, WITHOUT_MOTION).await?;
        if log.ended { Ok(()) } else { Err(self.reason(STEP_OF_NO_BLOCK, log).await) }
    }

    /// Returns why a program stopped before its end.
    async fn reason(&mut self, step: u32, log: Log) -> ControllerError {
        if self.halt.is_halted() {
            return ControllerError::Halted;
        }
        fault::reason(&mut self.rsh, step, log.verdict.as_ref(), &self.settings.axes).await
    }

    fn refuse_if_halted(&self) -> Result<(), ControllerError> {
        if self.halt.is_halted() { Err(ControllerError::Halted) } else { Ok(()) }
    }

    /// After any failure: aborts what is still running; nothing runs until `prepare`.
    async fn failed(&mut self, error: ControllerError) -> ControllerError {
        self.ready = false;
        self.sampler.iter().for_each(Sampler::give_up);
        if self.halt.is_halted() {
            let Err(error) = watch::stop(&mut self.rsh).await else {
                return ControllerError::Halted;
            };
            self.halting.link.urgent().send(HALT);
            return error;
        }
        // A connection without an answer is not used again. The other one may still work, and a frozen task
        // that resumes takes the abort first.
        let dumb = matches!(
            error,
            ControllerError::Frozen | ControllerError::NoAnswer { .. } | ControllerError::Link(_)
        );
        if dumb || self.rsh.command("abort").await.is_err() {
            self.halting.link.urgent().send(HALT);
            sleep(ON_THE_WIRE).await;
        }
        error
    }
}

/// linuxcncrsh reports no limits (`get ini` is "not implemented"), no rapid override and no other client.
const NOT_READABLE: [ReadinessItem; 4] = [
    ReadinessItem::TravelLimits,
    ReadinessItem::RapidOverride,
    ReadinessItem::OtherClients,
    ReadinessItem::Tool,
];

impl Driver for LinuxCnc {
    async fn prepare(&mut self) -> Result<Prepared, ControllerError> {
        self.ready = false;
        let prepared = self.check().await?;
        self.ready = true;
        Ok(prepared)
    }

    async fn execute(&mut self, block: ProvenBlock) -> Result<Outcome, ControllerError> {
        self.refuse_if_halted()?;
        if !self.ready {
            return Err(not_ready("it was not prepared since the last fault", "start again"));
        }
        match self.block(&block).await {
            Ok(outcome) => Ok(outcome),
            Err(error) => Err(self.failed(error).await),
        }
    }

    async fn look(&mut self) -> Result<Look, ControllerError> {
        let probe_closed = self.rsh.get("probe_value").await? != "0";
        let stands = state::stands(&mut self.rsh, &self.settings.axes).await?;
        Ok(Look { probe_closed, stands })
    }

    fn stamps(&self) -> bool {
        self.sampler.is_some()
    }

    async fn introduce(&mut self) -> Result<DeviceInfo, ControllerError> {
        self.report_identity().await
    }

    async fn finish(&mut self) -> Result<(), ControllerError> {
        self.refuse_if_halted()?;
        if let Some(program) = self.modes.switch_off().map(str::to_owned) {
            self.switch(&program).await?;
        }
        match self.mode_found.take() {
            Some(mode) => self.rsh.command(&format!("mode {mode}")).await,
            None => Ok(()),
        }
    }
}

/// Whether the motion is at feed, as along a scan: see [`Outcome::track`].
fn moves_at_feed(motion: &Motion) -> bool {
    matches!(motion, Motion::Feed { .. })
}

fn touches(motion: &Motion) -> bool {
    matches!(motion, Motion::Probe { .. })
}

fn backs_off(motion: &Motion) -> bool {
    matches!(motion, Motion::BackOff { .. })
}
