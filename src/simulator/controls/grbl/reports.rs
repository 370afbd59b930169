//! Output of the simulated control: reports, answers and `$` commands.

use super::fault::AnswerCount;
use super::{AlarmLock, FaultKind, Firmware, PLANNER_BLOCK_COUNT, RX_BUFFER_BYTES, settings};
use crate::interpreter::GrblErrorCode;
use machine::Position;

/// Version that `$I` reports.
const BUILD_VERSION: &str = "1.1f.20260817";

impl Firmware {
    /// Queues a line for the client; a hung control sends nothing.
    pub(super) fn send_line(&mut self, line: &str) {
        if self.is_hung {
            return;
        }
        self.send_buffer.extend_from_slice(line.as_bytes());
        self.send_buffer.extend_from_slice(b"\r\n");
    }

    /// Sends `ok`: not at all or twice if a fault requests it.
    pub(super) fn send_ok(&mut self) {
        match std::mem::take(&mut self.next_answer_count) {
            AnswerCount::Once => self.send_line("ok"),
            AnswerCount::Twice => {
                self.record_fault(FaultKind::DoubleOk);
                self.send_line("ok");
                self.send_line("ok");
            }
            AnswerCount::Never => self.record_fault(FaultKind::LostAnswer),
        }
    }

    pub(super) fn send_error(&mut self, code: GrblErrorCode) {
        self.send_line(&format!("error:{code}"));
    }

    pub(super) fn send_banner(&mut self) {
        self.send_line("");
        self.send_line(match self.options.is_compatibility_level_0 {
            true => "GrblHAL 1.1f ['$' or '$HELP' for help]",
            false => "Grbl 1.1f ['$' for help]",
        });
    }

    /// Value of a `$` setting; 0 if it is not stored.
    fn setting_value(&self, number: u16) -> f64 {
        self.options.settings_by_number.get(&number).copied().unwrap_or_default()
    }

    /// Unit of lengths in reports, mm.
    fn length_unit_mm(&self) -> f64 {
        if self.setting_value(settings::REPORT_INCHES_SETTING) == 0.0 { 1.0 } else { 25.4 }
    }

    /// Axis values as reports print them: lengths in the report's unit, angles in degrees, three decimals.
    pub(super) fn format_axis_values(&self, position: &Position) -> String {
        let values = self.options.interpreter.axes.iter().map(|axis| {
            let scale = if axis.is_linear() { self.length_unit_mm() } else { 1.0 };
            let text = format!("{:.3}", axis.to_mm_or_deg(position.get_or_zero(*axis)) / scale);
            if text == "-0.000" { "0.000".to_owned() } else { text }
        });
        values.collect::<Vec<_>>().join(",")
    }

    /// State in a status report: the first that applies of alarm, door, hold, run and idle.
    fn state_name(&self) -> &'static str {
        match () {
            () if self.alarm_lock.is_some() => "Alarm",
            () if self.is_door_open => "Door:1",
            () if self.is_held => "Hold:0",
            () if self.is_moving() => "Run",
            () => "Idle",
        }
    }

    /// Sends a status report. `has_all_fields`: as in the answer to 0x87.
    pub(super) fn send_status(&mut self, has_all_fields: bool) {
        let position = self.executor.displayed_position_at(self.time_since_start);
        let free = RX_BUFFER_BYTES - 1 - self.receive_buffer.len().min(RX_BUFFER_BYTES - 1);
        let planned = self.job_queue.len() + usize::from(self.executor.active_job.is_some());
        let mut report = format!(
            "<{}|MPos:{}|Bf:{},{free}|FS:0,0",
            self.state_name(),
            self.format_axis_values(&position),
            PLANNER_BLOCK_COUNT.saturating_sub(planned)
        );
        let t_s = self.executor.with_world(|world| world.time_s());
        let shows_pins = self.setting_value(settings::REPORT_MASK_SETTING) as u32 & settings::REPORT_PINS_BIT != 0;
        if self.executor.is_probe_closed() && shows_pins {
            report += "|Pn:P";
        }
        self.executor.on_probe_state_reported();
        let [feed, rapid] = self.options.feed_and_rapid_override_percent;
        let shows_overrides =
            self.setting_value(settings::REPORT_MASK_SETTING) as u32 & settings::REPORT_OVERRIDES_BIT != 0;
        if shows_overrides && (has_all_fields || !self.has_sent_status_report) {
            report += &format!("|Ov:{feed},{rapid},100");
        }
        if has_all_fields {
            let (pendant, homed) = (u8::from(self.options.is_pendant_in_control), u8::from(self.is_homed));
            let axes = self.homed_axes_mask();
            report += &format!("|MPG:{pendant}|H:{homed},{axes}|T:0|TLR:0|FW:grblHAL");
        } else if !self.has_sent_status_report {
            report += "|A:|TLR:0";
        }
        self.has_sent_status_report = true;
        if self.options.has_time_stamps {
            report += &format!("|Time:{t_s}");
        }
        self.send_line(&(report + ">"));
    }

    /// Executes a `$..` command. A successful command clears the latched error.
    pub(super) fn run_dollar_command(&mut self, command: &str) {
        match command.to_ascii_uppercase().as_str() {
            "I" => self.send_build_info(),
            "G" => self.send_line(&format!("[{}]", self.options.interpreter.modal_state.modes_report())),
            "#" => self.send_offsets(),
            "$" => self.send_settings(),
            "H" | "X" if self.alarm_lock == Some(AlarmLock::NeedsReset) => return self.send_error(79),
            "H" => (self.alarm_lock, self.is_homed) = (None, true),
            "X" => self.unlock(),
            other => {
                let number = other.parse().ok();
                let stored = number.and_then(|number| self.options.settings_by_number.get_key_value(&number));
                let Some((number, value)) = stored else { return self.send_error(3) };
                self.send_line(&settings::format_setting(*number, *value));
            }
        }
        self.latched_error = None;
        self.send_ok();
    }

    fn send_settings(&mut self) {
        for (number, value) in self.options.settings_by_number.clone() {
            self.send_line(&settings::format_setting(number, value));
        }
    }

    fn unlock(&mut self) {
        if self.alarm_lock.take().is_some() {
            self.send_line("[MSG:Caution: Unlocked]");
        }
    }

    /// Bit mask of the homed axes, either all or none; bit 0 for the first axis of the reports.
    fn homed_axes_mask(&self) -> u32 {
        if self.is_homed { (1 << self.options.interpreter.axes.len()) - 1 } else { 0 }
    }

    fn send_build_info(&mut self) {
        let letters: String = self.options.interpreter.axes.iter().map(|axis| axis.letter()).collect();
        let count = letters.len();
        self.send_line(&format!("[VER:{BUILD_VERSION}:]"));
        self.send_line(&format!("[OPT:VNML+,{PLANNER_BLOCK_COUNT},{RX_BUFFER_BYTES},{count},0]"));
        self.send_line(&format!("[AXS:{count}:{letters}]"));
    }

    /// Sends the answer to `$#`: work offsets, home position, tool length and the last probing move.
    fn send_offsets(&mut self) {
        for (name, offset) in self.options.interpreter.modal_state.named_offsets() {
            self.send_line(&format!("[{name}:{}]", self.format_axis_values(&offset)));
        }
        let home = self.format_axis_values(&Position::new());
        self.send_line(&format!("[HOME:{home}:{}]", self.homed_axes_mask()));
        self.send_line(&format!("[TLO:0.000,0.000,{:.3}]", self.options.reported_tool_length_mm));
        self.send_last_probe();
    }
}
