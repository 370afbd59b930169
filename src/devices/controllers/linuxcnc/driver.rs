//! Driver: writes one program file per block and reads its result from the log.

use std::path::PathBuf;
use std::time::Duration;

use tokio::time::sleep;

use super::fault;
use super::files::SharedFiles;
use super::ini::IniFile;
use super::prepare;
use super::program_runner::WatchedProgram;
use super::result_log::ResultLog;
use super::rsh::RshClient;
use super::tool_centre::{ToolCentreSettings, tool_centre_error};
use super::{SamplerClient, kinematics, path_check, program_runner, state};
use crate::controllers::{
    ControllerDriver, ControllerError, DeviceInfo, HaltHandle, MachineSnapshot, PreparedControl, ReadinessItem,
    WorkOffset, WorkOffsetSlot, arrival, require_prepared,
};
use link::LinkAddress;
use machine::record::axis_track::AxisTrack;
use machine::record::motion::{Motion, MotionBlockOutcome};
use machine::record::tool_centre::ToolCentreReading;
use machine::{Axis, Position};
use planning::gcode::{TransmissionForm, TransmissionUnit};
use planning::proof::{ProvenBlock, ProvenModeText};

/// Maximum time until the link's task has written a line to the connection.
pub(super) const MAX_LINK_WRITE_TIME: Duration = Duration::from_millis(20);
/// Step number in errors of a program that belongs to no block.
const STEP_NUMBER_WITHOUT_BLOCK: u32 = 0;
/// Watched properties of a program that moves nothing.
pub(super) const PROGRAM_WITHOUT_MOTION: WatchedProgram<'_> = WatchedProgram {
    step: STEP_NUMBER_WITHOUT_BLOCK,
    planned_standstill_time: Duration::ZERO,
    feed_turn_end_position: None,
};
/// Lines for linuxcncrsh: take the right to command from the driver's connection, and abort.
const HALT_COMMANDS: &[u8] = b"set enable EMCTOO\nset abort\n";

/// Address and shared directory of the control, and properties of its machine.
#[derive(Debug, Clone)]
pub struct LinuxCncSettings {
    /// Address of linuxcncrsh, by default port 5007.
    pub address: LinkAddress,
    /// Directory that `trued` and LinuxCNC reach under the same absolute path, both with write permission.
    pub shared_directory: PathBuf,
    /// The machine's axes, with the spindle S if the machine file states S.
    pub axes: Vec<Axis>,
    /// INI file that LinuxCNC was started with, if it is known.
    pub ini_path: Option<PathBuf>,
}

/// Driver of one LinuxCNC control, by linuxcncrsh and a shared directory.
pub struct LinuxCncDriver {
    pub(super) settings: LinuxCncSettings,
    mode_text: ProvenModeText,
    /// Connection for commands and queries.
    pub(super) rsh: RshClient,
    /// Connection that carries only halts; kept open for them.
    halt_connection: RshClient,
    pub(super) halt: HaltHandle,
    pub(super) files: SharedFiles,
    /// Task mode before the preparation, which `restore_modes` restores; a program restores all other modal state.
    initial_mode: Option<String>,
    /// Whether the control is prepared and no fault has occurred since.
    pub(super) is_prepared: bool,
    /// Orientation of the spindle, rad, once it was commanded.
    pub(super) spindle_rad: Option<f64>,
    sampler: Option<SamplerClient>,
    /// `None`: the tool centre is not read.
    tool_centre: Option<ToolCentreSettings>,
}

impl LinuxCncDriver {
    /// Connects twice: once to command, once to halt. Nothing is commanded yet.
    ///
    /// # Errors
    /// No linuxcncrsh answers at the address, or the directory is not usable.
    pub async fn open(
        settings: LinuxCncSettings,
        modes: ProvenModeText,
    ) -> Result<(Self, HaltHandle), ControllerError> {
        let files = SharedFiles::open(&settings.shared_directory)?;
        let mut rsh = RshClient::open(&settings.address).await?;
        let halt_connection = RshClient::open(&settings.address).await?;
        let urgent = halt_connection.link.urgent_sender();
        let halt = HaltHandle::new(move || urgent.send(HALT_COMMANDS));
        rsh.halt_handle = Some(halt.clone());
        let driver = Self {
            settings,
            mode_text: modes,
            rsh,
            halt_connection,
            halt: halt.clone(),
            files,
            initial_mode: None,
            is_prepared: false,
            spindle_rad: None,
            sampler: None,
            tool_centre: None,
        };
        Ok((driver, halt))
    }

    pub fn transmission(&self) -> TransmissionForm {
        TransmissionForm::Programs { log: self.files.result_log_path() }
    }

    /// Sets the sampler that timestamps positions during motion.
    pub fn with_sampler(self, sampler: Option<SamplerClient>) -> Self {
        Self { sampler, ..self }
    }

    /// Sets how the tool centre is read.
    pub fn with_tool_centre(self, tool_centre: Option<ToolCentreSettings>) -> Self {
        Self { tool_centre, ..self }
    }

    /// Checks emergency stop, power, homing and program state; changes only how linuxcncrsh answers.
    pub(super) async fn check_machine_ready(&mut self, ini: Option<&IniFile>) -> Result<(), ControllerError> {
        // Both settings apply to all connections. With a timeout linuxcncrsh would acknowledge commands
        // that the task has not accepted.
        self.rsh.set("set_wait received").await?;
        self.rsh.set("timeout 0").await?;
        let estop = self.rsh.get("estop").await?;
        let machine = self.rsh.get("machine").await?;
        let homed = self.rsh.get("joint_homed").await?;
        let joints = ini.and_then(IniFile::joint_count);
        prepare::check_estop_power_and_homing(&estop, &machine, &homed, &self.settings.axes, joints)?;
        // The reported switches may be outdated. A machine that is off refuses this request.
        program_runner::request_sign_of_life(&mut self.rsh).await?;
        state::check_no_program_runs(&mut self.rsh).await
    }

    async fn prepare_control(&mut self) -> Result<PreparedControl, ControllerError> {
        self.refuse_if_halted()?;
        let ini = self.settings.ini_path.as_deref().map(IniFile::read).transpose()?;
        self.rsh.acquire_command_right().await?;
        self.check_machine_ready(ini.as_ref()).await?;
        state::check_feed_override(&mut self.rsh).await?;
        let mode = self.rsh.get("mode").await?;
        self.initial_mode.get_or_insert(mode);
        self.rsh.read_messages().await?;
        self.rsh.send_task_command("mode auto").await?;
        self.files.write_program_and_remove_log(&prepare::state_query_program(&self.files.result_log_path()))?;
        self.rsh.send_task_command(&format!("open {}", self.files.program_path())).await?;
        let log = program_runner::run_program(&mut self.rsh, &self.files, &self.halt, PROGRAM_WITHOUT_MOTION).await?;
        if !log.is_complete {
            self.files.require_log()?;
            return Err(self.stop_reason(STEP_NUMBER_WITHOUT_BLOCK, log).await);
        }
        let axes = &self.settings.axes;
        let state = prepare::check_state_values(&log.state_values, axes)?;
        state::check_identity_kinematics(&mut self.rsh, axes).await?;
        let position = state::read_position(&mut self.rsh, axes).await?;
        kinematics::check_identity_mode(ini.as_ref(), state.kinematics, &position)?;
        if let Some(seconds) = self.mode_text.settling_time_after_head_s() {
            let program = self.mode_text.probe_on_program().to_owned();
            self.run_program_without_motion(&program).await?;
            sleep(Duration::try_from_secs_f64(seconds).unwrap_or_default()).await;
        }
        let axes = &self.settings.axes;
        let mut identity = format!("LinuxCNC {} ({})", state.version, self.rsh.server_identity);
        if let Some(sampler) = &mut self.sampler {
            let mm = state::read_length_unit_mm(&mut self.rsh).await?;
            sampler.check_agreement_with_control(&position, axes, mm).await?;
            identity += &format!("; {}", sampler.describe());
        }
        Ok(PreparedControl {
            identity,
            stop_description: "a halt aborts the program: the abort takes effect within 20 ms (0.1 s at worst), \
                   then the machine decelerates over feed²/(2·acceleration) and stays"
                .to_owned(),
            position,
            transmission: self.transmission(),
            unreadable_items: UNREADABLE_ITEMS.to_vec(),
        })
    }

    /// Runs one program for each part of the block: after a back-off the probe must read open before
    /// anything else moves.
    async fn execute_block(&mut self, block: &ProvenBlock) -> Result<MotionBlockOutcome, ControllerError> {
        if *block.transmission() != self.transmission() {
            return Err(ControllerError::WrongTransmission { step: block.step() });
        }
        let units = block.units()?;
        self.check_block_start(block).await?;
        let sampler = self.sampler.as_ref().filter(|_| block.motions().any(is_feed_motion));
        sampler.inspect(|sampler| sampler.start_recording());
        let mut touch = None;
        for proven in units {
            touch = self.run_program_part(block.step(), &proven.unit).await?.or(touch);
        }
        Ok(MotionBlockOutcome { trigger_position: touch, trigger_time_s: None, track: self.read_track(block).await? })
    }

    /// Checks that the machine is where the proven block begins.
    async fn check_block_start(&mut self, block: &ProvenBlock) -> Result<(), ControllerError> {
        let axes = &self.settings.axes;
        let begins = block.start_position().filter_axes(|axis| axis != Axis::S && axes.contains(&axis));
        if begins.is_empty() {
            return Ok(());
        }
        let position = state::read_position(&mut self.rsh, axes).await?;
        arrival::check_position(&begins, &position, |axis| arrival::axis_tolerance(axis, None))
            .map_err(arrival::moved_between_blocks_error)
    }

    /// Positions of the axes during `block`, if the block moves at feed and there is a sampler.
    async fn read_track(&mut self, block: &ProvenBlock) -> Result<Option<AxisTrack>, ControllerError> {
        let active_sampler = self.sampler.as_ref().filter(|_| block.motions().any(is_feed_motion));
        let Some(sampler) = active_sampler else { return Ok(None) };
        let position = state::read_position(&mut self.rsh, &self.settings.axes).await?;
        sampler.finish_recording(block.step(), &position).await.map(Some)
    }

    /// Runs the program of one part of a block and checks its end; returns the position at the trigger of a touch.
    async fn run_program_part(
        &mut self,
        step: u32,
        part: &TransmissionUnit,
    ) -> Result<Option<Position>, ControllerError> {
        if !part.motions.first().is_some_and(is_back_off) {
            self.require_open_probe(step).await?;
        }
        state::check_feed_override(&mut self.rsh).await?;
        state::check_open_program(&mut self.rsh, &self.files.program_path()).await?;
        self.files.write_program_and_remove_log(&part.text)?;
        self.refuse_if_halted()?;
        // A contact while an axis turns must stop the axis (`planning::turning`).
        let ends = path_check::feed_turn_end_position(&part.motions);
        let limits = WatchedProgram {
            step,
            planned_standstill_time: program_runner::planned_program_standstill_time(part),
            feed_turn_end_position: ends.as_ref(),
        };
        let log = match program_runner::run_program(&mut self.rsh, &self.files, &self.halt, limits).await {
            Err(refusal @ ControllerError::LineRefused { .. }) => {
                return Err(fault::refusal_reason(&mut self.rsh, refusal).await);
            }
            ended => ended?,
        };
        if !log.is_complete {
            return Err(self.stop_reason(step, log).await);
        }
        if part.motions.last().is_some_and(is_back_off) {
            self.require_open_probe(step).await?;
        }
        state::check_identity_kinematics(&mut self.rsh, &self.settings.axes).await?;
        if part.motions.iter().any(is_touch) {
            // The feed override may have changed since the part began.
            state::check_feed_override(&mut self.rsh).await?;
        }
        self.check_final_position(step, part).await?;
        self.touch_position(step, part, log.result)
    }

    /// Runs a program that moves nothing, such as one that switches the probe on or off. Returns its log.
    pub(super) async fn run_program_without_motion(&mut self, program: &str) -> Result<ResultLog, ControllerError> {
        state::check_open_program(&mut self.rsh, &self.files.program_path()).await?;
        self.files.write_program_and_remove_log(program)?;
        self.refuse_if_halted()?;
        let log = program_runner::run_program(&mut self.rsh, &self.files, &self.halt, PROGRAM_WITHOUT_MOTION).await?;
        if log.is_complete { Ok(log) } else { Err(self.stop_reason(STEP_NUMBER_WITHOUT_BLOCK, log).await) }
    }

    /// Returns why a program stopped before its end.
    pub(super) async fn stop_reason(&mut self, step: u32, log: ResultLog) -> ControllerError {
        if self.halt.is_halt_requested() {
            return ControllerError::Halted;
        }
        fault::stop_reason(&mut self.rsh, step, log.result.as_ref(), &self.settings.axes).await
    }

    pub(super) fn refuse_if_halted(&self) -> Result<(), ControllerError> {
        if self.halt.is_halt_requested() { Err(ControllerError::Halted) } else { Ok(()) }
    }

    /// Aborts whatever is still running after `error`; nothing runs until the next `prepare`. Returns the error to
    /// report.
    async fn abort_after_fault(&mut self, error: ControllerError) -> ControllerError {
        self.is_prepared = false;
        self.sampler.iter().for_each(SamplerClient::discard_recording);
        if self.halt.is_halt_requested() {
            let Err(error) = program_runner::abort_until_at_rest(&mut self.rsh).await else {
                return ControllerError::Halted;
            };
            self.halt_connection.link.urgent_sender().send(HALT_COMMANDS);
            return error;
        }
        // A connection that gave no answer is not used again. The halt connection may still work, and a frozen task
        // that resumes executes the abort first.
        let is_unresponsive = matches!(
            error,
            ControllerError::ControlFrozen | ControllerError::NoAnswer { .. } | ControllerError::Link(_)
        );
        if is_unresponsive || self.rsh.send_task_command("abort").await.is_err() {
            self.halt_connection.link.urgent_sender().send(HALT_COMMANDS);
            sleep(MAX_LINK_WRITE_TIME).await;
        }
        error
    }
}

/// linuxcncrsh reports no limits (`get ini` is "not implemented"), no rapid override and no other client.
const UNREADABLE_ITEMS: [ReadinessItem; 4] = [
    ReadinessItem::TravelLimits,
    ReadinessItem::RapidOverride,
    ReadinessItem::OtherClients,
    ReadinessItem::ToolInSpindle,
];

impl ControllerDriver for LinuxCncDriver {
    async fn prepare(&mut self) -> Result<PreparedControl, ControllerError> {
        self.is_prepared = false;
        let prepared = self.prepare_control().await?;
        self.is_prepared = true;
        Ok(prepared)
    }

    async fn execute(&mut self, block: ProvenBlock) -> Result<MotionBlockOutcome, ControllerError> {
        require_prepared(self.is_prepared, self.halt.is_halt_requested())?;
        match self.execute_block(&block).await {
            Ok(outcome) => Ok(outcome),
            Err(error) => Err(self.abort_after_fault(error).await),
        }
    }

    async fn read_snapshot(&mut self) -> Result<MachineSnapshot, ControllerError> {
        let is_probe_closed = self.rsh.get("probe_value").await? != "0";
        let position = state::read_position(&mut self.rsh, &self.settings.axes).await?;
        Ok(MachineSnapshot { is_probe_closed, position })
    }

    fn can_record_track(&self) -> bool {
        self.sampler.is_some()
    }

    async fn read_tool_centre(&mut self) -> Result<Option<ToolCentreReading>, ControllerError> {
        let Some(settings) = self.tool_centre.clone() else { return Ok(None) };
        require_prepared(self.is_prepared, self.halt.is_halt_requested())?;
        match self.run_tool_centre_program(&settings).await {
            Ok(reading) => Ok(Some(reading)),
            Err(error) => Err(self.abort_after_fault(tool_centre_error(error)).await),
        }
    }

    async fn identify_device(&mut self) -> Result<DeviceInfo, ControllerError> {
        self.read_device_info().await
    }

    async fn restore_modes(&mut self) -> Result<(), ControllerError> {
        self.refuse_if_halted()?;
        if let Some(program) = self.mode_text.probe_off_program().map(str::to_owned) {
            self.run_program_without_motion(&program).await?;
        }
        match self.initial_mode.take() {
            Some(mode) => self.rsh.send_task_command(&format!("mode {mode}")).await,
            None => Ok(()),
        }
    }

    async fn read_work_offset(&mut self, slot: WorkOffsetSlot) -> Result<WorkOffset, ControllerError> {
        self.read_offset_slot(slot).await
    }

    async fn write_work_offset(
        &mut self,
        slot: WorkOffsetSlot,
        zero_mm: &[(Axis, f64)],
    ) -> Result<(), ControllerError> {
        self.set_offset_slot(slot, zero_mm).await
    }
}

/// Whether the motion is at feed, as along a scan: see [`MotionBlockOutcome::track`].
fn is_feed_motion(motion: &Motion) -> bool {
    matches!(motion, Motion::Feed { .. })
}

pub(super) fn is_touch(motion: &Motion) -> bool {
    matches!(motion, Motion::Probe { .. })
}

fn is_back_off(motion: &Motion) -> bool {
    matches!(motion, Motion::BackOff { .. })
}
