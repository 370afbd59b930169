//! Lines of a Grbl control, and the meanings of its numbers (grblHAL `alarms.h` and `errors.h`, Grbl 1.1
//! interface).

/// One line that the control sends.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Message {
    Ok,
    Error(u32),
    Alarm(u32),
    Status(Status),
    /// `[PRB:..:1]`: axis values in the order of the axis words, and whether there was contact.
    Touch {
        values: Vec<f64>,
        hit: bool,
    },
    /// `[TIME:..]`, an extension of the simulated control: time of the contact, s.
    Time(f64),
    Banner(String),
    Version(String),
    /// `[OPT:flags,planner,rx,..]`: maximum length of a line, bytes.
    Buffer(usize),
    /// `[AXS:n:letters]`: the axis letters.
    Axes(String),
    /// `[G59:..]`, `[G92:..]`, `[TLO:..]`: name of an offset in `$#` and its values.
    Offset {
        name: String,
        values: Vec<f64>,
    },
    /// `[HOME:..:mask]`: the homed axes, one bit each in the order of the axis words.
    Homed(u32),
    /// `[GC:..]`: the modal words in force.
    Modes(Vec<String>),
    /// `$n=..` with a numeric value.
    Setting(u16, f64),
    Other(String),
}

/// Status report `<Idle|..>`; the user may mask every field but the state.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Status {
    /// State without the substate: `Hold` for `Hold:0`.
    pub state: String,
    pub substate: Option<String>,
    pub probe_closed: bool,
    /// `Pn:`, the letters of all active inputs.
    pub pins: String,
    /// `MPos:`, machine position in the order of the axis words, mm and degrees.
    pub position: Option<Vec<f64>>,
    /// `Ov:`, percent of the programmed feed and of the rapid speed. Most reports omit the field.
    pub overrides: Option<Overrides>,
    /// `MPG:1`: a pendant has the control; the lines of `trued` are not executed as sent.
    pub has_pendant: bool,
    /// `FW:`, present only in the answer to 0x87 (grblHAL `report.c`, compatibility level 0 or 1).
    pub is_full: bool,
    /// `Time:`, an extension of the simulated control, s.
    pub t_s: Option<f64>,
}

/// Feed and rapid overrides, percent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Overrides {
    pub feed: f64,
    pub rapid: f64,
}

impl Message {
    pub(super) fn parse(line: &str) -> Self {
        Self::understood(line.trim()).unwrap_or_else(|| Self::Other(line.trim().to_owned()))
    }

    fn understood(line: &str) -> Option<Self> {
        if line == "ok" {
            return Some(Self::Ok);
        }
        if let Some(code) = line.strip_prefix("error:") {
            return code.parse().ok().map(Self::Error);
        }
        if let Some(code) = line.strip_prefix("ALARM:") {
            return code.parse().ok().map(Self::Alarm);
        }
        if let Some((number, value)) = line.strip_prefix('$').and_then(|rest| rest.split_once('='))
        {
            // Some values are text; older controls append the meaning of the number in brackets.
            let value = value.split_whitespace().next()?;
            let value = value.parse().ok().filter(|value: &f64| value.is_finite())?;
            return Some(Self::Setting(number.parse().ok()?, value));
        }
        if let Some(report) = line.strip_prefix('<').and_then(|rest| rest.strip_suffix('>')) {
            return status(report).map(Self::Status);
        }
        if line.to_ascii_lowercase().starts_with("grbl") && line.contains("help") {
            return Some(Self::Banner(line.to_owned()));
        }
        let (name, value) = line.strip_prefix('[')?.strip_suffix(']')?.split_once(':')?;
        match name {
            "PRB" => touch(value),
            "TIME" => seconds(value).map(Self::Time),
            "VER" => Some(Self::Version(value.trim_end_matches(':').to_owned())),
            "OPT" => value.split(',').nth(2)?.parse().ok().map(Self::Buffer),
            "AXS" => Some(Self::Axes(value.split_once(':')?.1.to_owned())),
            "G92" | "TLO" => offset(name, value),
            slot if slot.starts_with("G5") => offset(slot, value),
            "HOME" => value.rsplit_once(':')?.1.parse().ok().map(Self::Homed),
            "GC" => Some(Self::Modes(value.split_whitespace().map(str::to_owned).collect())),
            _ => None,
        }
    }
}

fn touch(value: &str) -> Option<Message> {
    let (list, hit) = value.rsplit_once(':')?;
    let values = values(list)?;
    match hit {
        "0" => Some(Message::Touch { values, hit: false }),
        "1" => Some(Message::Touch { values, hit: true }),
        _ => None,
    }
}

fn offset(name: &str, value: &str) -> Option<Message> {
    values(value).map(|values| Message::Offset { name: name.to_owned(), values })
}

fn values(list: &str) -> Option<Vec<f64>> {
    let values: Result<Vec<f64>, _> = list.split(',').map(str::parse).collect();
    values.ok().filter(|values| values.iter().all(|value| value.is_finite()))
}

/// Rejects a timestamp that is not finite: the reading could not be stored.
fn seconds(value: &str) -> Option<f64> {
    value.parse().ok().filter(|seconds: &f64| seconds.is_finite())
}

fn status(report: &str) -> Option<Status> {
    let mut fields = report.split('|');
    let full = fields.next()?;
    let (state, substate) = match full.split_once(':') {
        Some((state, substate)) => (state, Some(substate.to_owned())),
        None => (full, None),
    };
    if state.is_empty() || !state.chars().all(|c| c.is_ascii_alphabetic()) {
        return None;
    }
    let mut status = Status { state: state.to_owned(), substate, ..Status::default() };
    for (name, value) in fields.filter_map(|field| field.split_once(':')) {
        match name {
            "MPos" => status.position = values(value),
            "Pn" => {
                status.probe_closed = value.contains('P');
                status.pins = value.to_owned();
            }
            "Ov" => status.overrides = overrides(value),
            "FW" => status.is_full = true,
            "MPG" => status.has_pendant = value == "1",
            "Time" => status.t_s = seconds(value),
            _ => {}
        }
    }
    Some(status)
}

fn overrides(value: &str) -> Option<Overrides> {
    let [feed, rapid, ..] = values(value)?[..] else { return None };
    Some(Overrides { feed, rapid })
}

pub(super) fn alarm_meaning(code: u32) -> &'static str {
    match code {
        1 => "a hard limit was hit; the position is lost",
        2 => "a target lies outside the soft limits",
        3 => "reset while moving; the position is lost",
        4 => "the probe read closed before a probing move",
        5 => "a probing move met nothing",
        6 => "homing failed: reset during the cycle",
        7 => "homing failed: the door was opened",
        8 => "homing failed: the limit switch did not clear",
        9 => "homing failed: no limit switch was met",
        10 => "emergency stop",
        11 => "homing is required",
        12 => "a limit switch is engaged",
        13 => "the probe protection tripped",
        14 => "the spindle failed",
        17 => "a motor driver reports a fault",
        _ => "unknown to this program; see the control's manual",
    }
}

pub(super) fn error_meaning(code: u32) -> &'static str {
    match code {
        1 => "a command letter was expected",
        2 => "a number cannot be read",
        3 => "this $ command is unknown",
        7 => "the stored settings could not be read and were replaced by defaults",
        8 => "only possible while idle",
        9 => "locked by an alarm or a jog",
        10 => "soft limits need homing",
        11 => "the line is too long",
        15 => "the target lies outside the limits",
        20 => "a word of the dialect is unknown to this control",
        21 => "two words of one modal group",
        22 => "no feed is set",
        26 => "no axis words",
        27 => "the line number is out of range",
        28 => "a word lacks its value",
        29 => "this coordinate system does not exist",
        30 => "G53 goes with G0 and G1 alone",
        31 => "axis words without a motion",
        33 => "the target is not valid",
        36 => "words that nothing uses",
        45 => "a limit switch is engaged",
        46 => "homing is required",
        50 => "emergency stop",
        56 => "the coordinate system is locked",
        79 => "not allowed until the control is reset",
        _ => "see the control's manual",
    }
}
