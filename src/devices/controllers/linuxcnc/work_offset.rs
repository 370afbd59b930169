//! Reads a work offset, and sets it by `G10 L2`, by programs that move nothing.

use super::driver::{LinuxCncDriver, PROGRAM_WITHOUT_MOTION};
use super::result_log::ResultLog;
use super::rsh::RshClient;
use super::{program_runner, state};
use crate::controllers::work_offset::{check_no_other_shift, set_offset_block};
use crate::controllers::{ControllerError, WorkOffset, WorkOffsetSlot};
use machine::Axis;

/// Number of the first parameter of G54.
const FIRST_PARAMETER_OF_G54: usize = 5221;
/// Difference between the numbers of the first parameters of two consecutive slots.
const PARAMETERS_PER_SLOT: usize = 20;
/// Index of the slot's rotation among its parameters, from 0.
const ROTATION_INDEX: usize = 9;
/// Decimals of mm of a number in the log.
const LOG_DECIMALS: i32 = 6;
/// Axes of the first parameters of a slot, in order.
const SLOT_AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];

impl LinuxCncDriver {
    /// Reads the zero of the slot. An active G92 and a rotation of the slot are errors; afterwards the driver must be
    /// prepared again.
    pub(super) async fn read_offset_slot(&mut self, slot: WorkOffsetSlot) -> Result<WorkOffset, ControllerError> {
        let log = self.run_program_at_rest(&offset_query_program(slot, &self.files.result_log_path())).await?;
        work_offset_from_log(slot, &log.state_values, &self.settings.axes)
    }

    /// Sets the zero of the slot on the axes of `zero_mm`, machine coordinates; other axes keep their values.
    pub(super) async fn set_offset_slot(
        &mut self,
        slot: WorkOffsetSlot,
        zero_mm: &[(Axis, f64)],
    ) -> Result<(), ControllerError> {
        let program = offset_write_program(slot, zero_mm, &self.files.result_log_path());
        self.run_program_at_rest(&program).await.map(drop)
    }

    /// Runs a program without motion while the machine is at rest, and restores the mode of the control. An error if
    /// the control's unit of length is not mm. The driver must be prepared again before the next block.
    async fn run_program_at_rest(&mut self, program: &str) -> Result<ResultLog, ControllerError> {
        self.is_prepared = false;
        self.refuse_if_halted()?;
        // Other clients keep the right to command while the machine works.
        state::check_no_program_runs(&mut self.rsh).await?;
        check_at_rest(&mut self.rsh).await?;
        self.rsh.acquire_command_right().await?;
        self.check_machine_ready(None).await?;
        if state::read_length_unit_mm(&mut self.rsh).await? != 1.0 {
            return Err(ControllerError::not_ready(
                "the configuration of LinuxCNC is in inches",
                "values in inches are not supported: enter them by hand",
            ));
        }
        check_at_rest(&mut self.rsh).await?;
        let mode = self.rsh.get("mode").await?;
        self.rsh.read_messages().await?;
        let ended = self.open_and_run_program(program).await;
        let restored = self.rsh.send_task_command(&format!("mode {mode}")).await;
        let log = ended?;
        restored.map(|()| log)
    }

    /// Runs the program in the mode `auto`, which stays selected; an error if the log has no last line.
    async fn open_and_run_program(&mut self, program: &str) -> Result<ResultLog, ControllerError> {
        self.rsh.send_task_command("mode auto").await?;
        self.files.write_program_and_remove_log(program)?;
        self.rsh.send_task_command(&format!("open {}", self.files.program_path())).await?;
        let log = program_runner::run_program(&mut self.rsh, &self.files, &self.halt, PROGRAM_WITHOUT_MOTION).await?;
        if !log.is_complete {
            self.files.require_log()?;
            return Err(self.stop_reason(PROGRAM_WITHOUT_MOTION.step, log).await);
        }
        Ok(log)
    }
}

async fn check_at_rest(rsh: &mut RshClient) -> Result<(), ControllerError> {
    match program_runner::is_at_rest(rsh).await? {
        true => Ok(()),
        false => Err(ControllerError::not_ready("the machine moves", "wait until the machine is at rest")),
    }
}

/// Reads the selected slot (#5220), whether G92 is active (#5210) and its offsets (#5211 to #5219), then the offsets
/// and the rotation of `slot`.
fn offset_query_program(slot: WorkOffsetSlot, log: &str) -> String {
    let first = FIRST_PARAMETER_OF_G54 + (slot.p_number() - 1) * PARAMETERS_PER_SLOT;
    let parameters = (5211..=5219).chain(first..=first + ROTATION_INDEX);
    let parameters: String = parameters.map(|number| format!(" #{number}")).collect();
    format!(
        "%\n(trued reads a work offset; nothing moves)\n(LOGOPEN,{log})\n(LOG,state #5220 #5210{parameters})\n(LOG,END)\n\
         (LOGCLOSE)\n%\n"
    )
}

/// Sets the zero of `slot`; the log shows only that the program has ended. In G91 `G10 L2` would add the values to
/// the present ones; M72 restores G91 and G20.
fn offset_write_program(slot: WorkOffsetSlot, zero_mm: &[(Axis, f64)], log: &str) -> String {
    let block = set_offset_block(slot, zero_mm);
    format!(
        "%\n(trued sets a work offset; nothing moves)\nM70\nG21 G90\n{block}\nM72\n(LOGOPEN,{log})\n(LOG,END)\n(LOGCLOSE)\n%\n"
    )
}

/// Converts the numbers of the log line of [`offset_query_program`], for `axes` only; refuses an active G92 with an
/// offset other than zero, and a rotated slot.
fn work_offset_from_log(slot: WorkOffsetSlot, values: &[f64], axes: &[Axis]) -> Result<WorkOffset, ControllerError> {
    let unreadable = || ControllerError::UnreadableReply { text: format!("state {values:?}") };
    let [selected, is_g92_active, rest @ ..] = values else { return Err(unreadable()) };
    let (g92, offsets) = rest.split_at_checked(9).ok_or_else(unreadable)?;
    let rotation_deg = offsets.get(ROTATION_INDEX).ok_or_else(unreadable)?;
    let has_g92 = *is_g92_active != 0.0 && g92.iter().any(|value| *value != 0.0);
    check_no_other_shift(slot, has_g92, *rotation_deg)?;
    let zero = SLOT_AXES.into_iter().zip(offsets.iter().copied()).filter(|(axis, _)| axes.contains(axis));
    let (zero_mm, rotary_deg) = zero.partition(|(axis, _)| axis.is_linear());
    Ok(WorkOffset { zero_mm, rotary_deg, decimals: LOG_DECIMALS, is_selected: *selected == slot.p_number() as f64 })
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXES: [Axis; 4] = [Axis::X, Axis::Y, Axis::Z, Axis::C];

    /// G55 is selected; G92 is (1, 0, ..), and active if `g92_active` is 1.
    fn values(g92_active: f64, rotation_deg: f64) -> Vec<f64> {
        let g92 = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let offsets = [-149.95, 0.125, 7.0, 0.0, 0.0, 90.0, 0.0, 0.0, 0.0, rotation_deg];
        [&[2.0, g92_active][..], &g92, &offsets].concat()
    }

    #[test]
    fn offset_of_the_slot_is_read() {
        let slot = "G55".parse().unwrap();
        let offset = work_offset_from_log(slot, &values(0.0, 0.0), &AXES).unwrap();
        assert_eq!(offset.zero_mm, [(Axis::X, -149.95), (Axis::Y, 0.125), (Axis::Z, 7.0)]);
        assert!(offset.is_selected);
        assert!(work_offset_from_log(slot, &values(0.0, 0.0)[..20], &AXES).is_err());
        for (values, expected) in [(values(1.0, 0.0), "G92"), (values(0.0, -3.5), "rotated by -3.5°")] {
            let error = work_offset_from_log(slot, &values, &AXES).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn programs_name_the_parameters_of_the_slot() {
        let query = offset_query_program("G59.2".parse().unwrap(), "/tmp/log");
        assert!(query.contains("#5219 #5361 #5362 #5363") && query.contains(" #5370)"), "{query}");
        let write = offset_write_program("G55".parse().unwrap(), &[(Axis::X, 0.1)], "/tmp/log");
        assert!(write.contains("M70\nG21 G90\nG10 L2 P2 X0.1\nM72\n"), "{write}");
    }
}
