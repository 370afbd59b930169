//! Lines of a Grbl control, and the meanings of its numbers (grblHAL `alarms.h` and `errors.h`, Grbl 1.1
//! interface).

use crate::finite_numbers::{parse_finite_number, parse_finite_numbers};

/// One line that the control sends.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum GrblMessage {
    Ok,
    Error(u32),
    Alarm(u32),
    Status(GrblStatus),
    /// `[PRB:..:1]`: axis values in the order of the axis words, and whether there was contact.
    ProbeResult {
        values: Vec<f64>,
        has_contact: bool,
    },
    /// `[TIME:..]`, an extension of the simulated control: time of the contact, s.
    ContactTime(f64),
    /// First line after a start or a reset of the control.
    Banner(String),
    /// `[VER:..]`: version of the firmware.
    Version(String),
    /// `[OPT:flags,planner,rx,..]`: maximum length of a line, bytes.
    MaxLineBytes(usize),
    /// `[AXS:n:letters]`: the axis letters.
    AxisLetters(String),
    /// `[G59:..]`, `[G92:..]`, `[TLO:..]`: name of an offset in `$#`, its values, and its rotation (grblHAL with
    /// ROTATION_ENABLE, `report.c`).
    Offset {
        name: String,
        values: Vec<f64>,
    },
    /// `[HOME:..:mask]`: if bit n is set, the axis of the n-th axis word is homed, from 0.
    HomedAxesMask(u32),
    /// `[GC:..]`: the modal words in force.
    ModalWords(Vec<String>),
    /// `$n=..` with a numeric value.
    Setting(u16, f64),
    /// Any other line, also one whose values cannot be read; or noise.
    Unknown(String),
}

/// Status report `<Idle|..>`; the user may mask every field but the state.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct GrblStatus {
    /// State without the substate: `Hold` for `Hold:0`.
    pub state: String,
    pub substate: Option<String>,
    /// Whether `Pn:` contains P; false without `Pn:`.
    pub is_probe_closed: bool,
    /// `Pn:`, the letters of all active inputs.
    pub active_inputs: String,
    /// `MPos:`, machine position in the order of the axis words, mm and degrees.
    pub machine_position: Option<Vec<f64>>,
    /// `Ov:`, percent of the programmed feed and of the rapid speed. Most reports omit the field.
    pub overrides: Option<Overrides>,
    /// `MPG:1`: a pendant controls the machine; the lines of `trued` are not executed as sent.
    pub is_pendant_in_control: bool,
    /// Whether `FW:` is present: only in the answer to 0x87 (grblHAL `report.c`, compatibility level 0 or 1).
    pub has_all_fields: bool,
    /// `Time:`, an extension of the simulated control: time of its clock, s.
    pub control_time_s: Option<f64>,
}

impl GrblStatus {
    /// Whether no axis moves. Every state except `Run`, `Jog`, `Home`, and `Hold` and `Door` while they decelerate or
    /// move, counts as at rest, such as `Alarm`.
    pub(super) fn is_at_rest(&self) -> bool {
        match self.state.as_str() {
            "Hold" => self.substate.as_deref() == Some("0"),
            "Door" => matches!(self.substate.as_deref(), Some("0" | "1")),
            "Run" | "Jog" | "Home" => false,
            _ => true,
        }
    }
}

/// Feed and rapid overrides, percent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Overrides {
    pub feed_percent: f64,
    pub rapid_percent: f64,
}

impl GrblMessage {
    pub(super) fn parse(line: &str) -> Self {
        Self::parse_known(line.trim()).unwrap_or_else(|| Self::Unknown(line.trim().to_owned()))
    }

    fn parse_known(line: &str) -> Option<Self> {
        if line == "ok" {
            return Some(Self::Ok);
        }
        if let Some(code) = line.strip_prefix("error:") {
            return code.parse().ok().map(Self::Error);
        }
        if let Some(code) = line.strip_prefix("ALARM:") {
            return code.parse().ok().map(Self::Alarm);
        }
        if let Some((number, value)) = line.strip_prefix('$').and_then(|rest| rest.split_once('=')) {
            // Some values are text; older controls append the meaning of the number in brackets.
            let value = parse_finite_number(value.split_whitespace().next()?)?;
            return Some(Self::Setting(number.parse().ok()?, value));
        }
        if let Some(report) = line.strip_prefix('<').and_then(|rest| rest.strip_suffix('>')) {
            return parse_status(report).map(Self::Status);
        }
        if line.to_ascii_lowercase().starts_with("grbl") && line.contains("help") {
            return Some(Self::Banner(line.to_owned()));
        }
        let (name, value) = line.strip_prefix('[')?.strip_suffix(']')?.split_once(':')?;
        match name {
            "PRB" => parse_probe_result(value),
            "TIME" => parse_finite_number(value).map(Self::ContactTime),
            "VER" => Some(Self::Version(value.trim_end_matches(':').to_owned())),
            "OPT" => value.split(',').nth(2)?.parse().ok().map(GrblMessage::MaxLineBytes),
            "AXS" => Some(GrblMessage::AxisLetters(value.split_once(':')?.1.to_owned())),
            "G92" | "TLO" => parse_offset(name, value),
            slot if slot.starts_with("G5") => parse_offset(slot, value),
            "HOME" => value.rsplit_once(':')?.1.parse().ok().map(GrblMessage::HomedAxesMask),
            "GC" => Some(GrblMessage::ModalWords(value.split_whitespace().map(str::to_owned).collect())),
            _ => None,
        }
    }
}

fn parse_probe_result(value: &str) -> Option<GrblMessage> {
    let (list, has_contact) = value.rsplit_once(':')?;
    let values = parse_number_list(list)?;
    match has_contact {
        "0" => Some(GrblMessage::ProbeResult { values, has_contact: false }),
        "1" => Some(GrblMessage::ProbeResult { values, has_contact: true }),
        _ => None,
    }
}

fn parse_offset(name: &str, value: &str) -> Option<GrblMessage> {
    let values = parse_number_list(&value.replace(':', ","))?;
    Some(GrblMessage::Offset { name: name.to_owned(), values })
}

fn parse_number_list(list: &str) -> Option<Vec<f64>> {
    parse_finite_numbers(list.split(','))
}

fn parse_status(report: &str) -> Option<GrblStatus> {
    let mut fields = report.split('|');
    let full = fields.next()?;
    let (state, substate) = match full.split_once(':') {
        Some((state, substate)) => (state, Some(substate.to_owned())),
        None => (full, None),
    };
    if state.is_empty() || !state.chars().all(|c| c.is_ascii_alphabetic()) {
        return None;
    }
    let mut status = GrblStatus { state: state.to_owned(), substate, ..GrblStatus::default() };
    for (name, value) in fields.filter_map(|field| field.split_once(':')) {
        match name {
            "MPos" => status.machine_position = parse_number_list(value),
            "Pn" => {
                status.is_probe_closed = value.contains('P');
                status.active_inputs = value.to_owned();
            }
            "Ov" => status.overrides = parse_overrides(value),
            "FW" => status.has_all_fields = true,
            "MPG" => status.is_pendant_in_control = value == "1",
            "Time" => status.control_time_s = parse_finite_number(value),
            _ => {}
        }
    }
    Some(status)
}

fn parse_overrides(value: &str) -> Option<Overrides> {
    let [feed_percent, rapid_percent, ..] = parse_number_list(value)?[..] else { return None };
    Some(Overrides { feed_percent, rapid_percent })
}

pub(super) fn alarm_meaning(code: u32) -> &'static str {
    match code {
        1 => "a hard limit was hit; the position is lost",
        2 => "a target is outside the soft limits",
        3 => "reset while moving; the position is lost",
        4 => "the probe read closed before a probing move",
        5 => "a probing move without contact",
        6 => "homing failed: reset during the cycle",
        7 => "homing failed: the door was opened",
        8 => "homing failed: the limit switch did not clear",
        9 => "homing failed: no limit switch was found",
        10 => "emergency stop",
        11 => "homing is required",
        12 => "a limit switch is engaged",
        13 => "the probe protection tripped",
        14 => "the spindle failed",
        17 => "a motor driver reports a fault",
        _ => "unknown code; see the control's manual",
    }
}

pub(super) fn error_meaning(code: u32) -> &'static str {
    match code {
        1 => "a command letter was expected",
        2 => "a number cannot be read",
        3 => "this $ command is unknown",
        7 => "the stored settings could not be read and were replaced by defaults",
        8 => "only possible in the state Idle",
        9 => "locked by an alarm or a jog",
        10 => "soft limits need homing",
        11 => "the line is too long",
        15 => "the target is outside the limits",
        20 => "this control does not know a word of the G-code",
        21 => "two words of the same modal group",
        22 => "no feed is set",
        26 => "no axis words",
        27 => "the line number is out of range",
        28 => "a word has no value",
        29 => "this coordinate system does not exist",
        30 => "G53 is allowed with G0 and G1 only",
        31 => "axis words without a motion",
        33 => "the target is not valid",
        36 => "the line contains unused words",
        45 => "a limit switch is engaged",
        46 => "homing is required",
        50 => "emergency stop",
        56 => "the coordinate system is locked",
        79 => "not allowed until the control is reset",
        _ => "see the control's manual",
    }
}
