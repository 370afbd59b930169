//! Output of the simulated control: reports, answers and `$` commands.

use super::fault::Answer;
use super::{FaultKind, Firmware, Lock, PLANNER, RX_BUFFER, settings};
use crate::interpreter::Code;
use machine::Position;

const BUILD: &str = "1.1f.20260817";

impl Firmware {
    pub(super) fn say(&mut self, line: &str) {
        if self.hung {
            return;
        }
        self.out.extend_from_slice(line.as_bytes());
        self.out.extend_from_slice(b"\r\n");
    }

    pub(super) fn say_ok(&mut self) {
        match std::mem::take(&mut self.answer) {
            Answer::Once => self.say("ok"),
            Answer::Twice => {
                self.happens(FaultKind::DoubleOk);
                self.say("ok");
                self.say("ok");
            }
            Answer::Never => self.happens(FaultKind::LostOk),
        }
    }

    pub(super) fn say_error(&mut self, code: Code) {
        self.say(&format!("error:{code}"));
    }

    pub(super) fn say_banner(&mut self) {
        self.say("");
        self.say(match self.options.native {
            true => "GrblHAL 1.1f ['$' or '$HELP' for help]",
            false => "Grbl 1.1f ['$' for help]",
        });
    }

    fn setting(&self, number: u16) -> f64 {
        self.options.settings.get(&number).copied().unwrap_or_default()
    }

    /// Unit of lengths in reports, mm.
    fn unit(&self) -> f64 {
        if self.setting(settings::INCHES) == 0.0 { 1.0 } else { 25.4 }
    }

    /// Axis values as reports print them: lengths in the report's unit, angles in degrees, three decimals.
    pub(super) fn list(&self, position: &Position) -> String {
        let values = self.options.reader.axes().iter().map(|axis| {
            let scale = if axis.is_linear() { self.unit() } else { 1.0 };
            let text = format!("{:.3}", axis.to_edge(position.at(*axis)) / scale);
            if text == "-0.000" { "0.000".to_owned() } else { text }
        });
        values.collect::<Vec<_>>().join(",")
    }

    fn state(&self) -> &'static str {
        match () {
            () if self.alarm.is_some() => "Alarm",
            () if self.door => "Door:1",
            () if self.held => "Hold:0",
            () if self.is_moving() => "Run",
            () => "Idle",
        }
    }

    /// Sends a status report. `full`: with all fields, as in the answer to 0x87.
    pub(super) fn say_status(&mut self, full: bool) {
        let position = match &self.active {
            Some(active) => active.position(self.now),
            None => self.stand(),
        };
        let free = RX_BUFFER - 1 - self.rx.len().min(RX_BUFFER - 1);
        let planned = self.queue.len() + usize::from(self.active.is_some());
        let mut report = format!(
            "<{}|MPos:{}|Bf:{},{free}|FS:0,0",
            self.state(),
            self.list(&position),
            PLANNER.saturating_sub(planned)
        );
        let t_s = self.with_world(|world| world.time_s());
        let shows_pins = self.setting(settings::REPORTS) as u32 & settings::SHOWS_PINS != 0;
        if self.tripped() && shows_pins {
            report += "|Pn:P";
        }
        self.on_probe_state_reported();
        let [feed, rapid] = self.options.overrides;
        let shows_overrides =
            self.setting(settings::REPORTS) as u32 & settings::SHOWS_OVERRIDES != 0;
        if shows_overrides && (full || !self.reported) {
            report += &format!("|Ov:{feed},{rapid},100");
        }
        if full {
            let (pendant, homed) = (u8::from(self.options.has_pendant), u8::from(self.homed));
            let axes = self.homed_axes();
            report += &format!("|MPG:{pendant}|H:{homed},{axes}|T:0|TLR:0|FW:grblHAL");
        } else if !self.reported {
            report += "|A:|TLR:0";
        }
        self.reported = true;
        if self.options.stamps {
            report += &format!("|Time:{t_s}");
        }
        self.say(&(report + ">"));
    }

    /// Executes a `$..` command. A successful command clears the latched error.
    pub(super) fn dollar(&mut self, command: &str) {
        match command.to_ascii_uppercase().as_str() {
            "I" => self.say_build(),
            "G" => self.say(&format!("[{}]", self.options.reader.modes())),
            "#" => self.say_offsets(),
            "$" => self.say_settings(),
            "H" | "X" if self.alarm == Some(Lock::Reset) => return self.say_error(79),
            "H" => (self.alarm, self.homed) = (None, true),
            "X" => self.unlock(),
            other => {
                let number = other.parse().ok();
                let stored = number.and_then(|number| self.options.settings.get_key_value(&number));
                let Some((number, value)) = stored else { return self.say_error(3) };
                self.say(&settings::line(*number, *value));
            }
        }
        self.latched = None;
        self.say_ok();
    }

    fn say_settings(&mut self) {
        for (number, value) in self.options.settings.clone() {
            self.say(&settings::line(number, value));
        }
    }

    fn unlock(&mut self) {
        if self.alarm.take().is_some() {
            self.say("[MSG:Caution: Unlocked]");
        }
    }

    /// Bit mask of the homed axes.
    fn homed_axes(&self) -> u32 {
        if self.homed { (1 << self.options.reader.axes().len()) - 1 } else { 0 }
    }

    fn say_build(&mut self) {
        let letters: String = self.options.reader.axes().iter().map(|axis| axis.letter()).collect();
        let count = letters.len();
        self.say(&format!("[VER:{BUILD}:]"));
        self.say(&format!("[OPT:VNML+,{PLANNER},{RX_BUFFER},{count},0]"));
        self.say(&format!("[AXS:{count}:{letters}]"));
    }

    fn say_offsets(&mut self) {
        for (name, offset) in self.options.reader.offsets() {
            self.say(&format!("[{name}:{}]", self.list(&offset)));
        }
        let home = self.list(&Position::new());
        self.say(&format!("[HOME:{home}:{}]", self.homed_axes()));
        self.say(&format!("[TLO:0.000,0.000,{:.3}]", self.options.tool_length_mm));
        self.say_last();
    }
}
