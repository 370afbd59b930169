//! Captures (`trued run --capture`) reduced to the content that is the same in every run.
//!
//! Left out for every link: times; port numbers and names of pseudo-terminals; the order of lines of different
//! links (links follow one another). Then, by the kind of link:
//!
//! - `lines` (grbl): status requests `?` and reports `<...>`, which are polled in wall time. Chunks are joined to
//!   whole lines. The first request may overtake the greeting of a control that was just opened; it is written
//!   after the greeting.
//! - `modbus-tcp`, `modbus-rtu`: of the requests
//!   - transaction numbers (set to 0) and checksums of RTU,
//!   - writes of the heartbeat alone, which follow wall time; its register in other writes is set to 0,
//!   - requests for input registers (the status) except the first one;
//!
//!   of the replies all but the last status before each write of `sequence`. It is written without head, heartbeat
//!   and tail, which count, and with the two times after the other registers.
//! - `samples`: everything.

use std::collections::BTreeMap;

/// Register addresses of docs/line-window.md, identical in docs/resident-program.md.
const SEQUENCE_REGISTER: u16 = 1;
const HEARTBEAT_REGISTER: u16 = 2;
const STATUS_HEAD_REGISTER: usize = 0;
const STATUS_HEARTBEAT_REGISTER: usize = 11;
/// Registers of the two times, four registers each.
const STATUS_TIME_REGISTER: usize = 12;
const STATUS_LATCH_TIME_REGISTER: usize = 16;

const READ_HOLDING_FUNCTION: u8 = 3;
const READ_INPUT_FUNCTION: u8 = 4;
const WRITE_MULTIPLE_FUNCTION: u8 = 16;

pub fn normalise_capture(capture: &str) -> String {
    let mut links: BTreeMap<u32, CapturedLink> = BTreeMap::new();
    for line in capture.lines().filter(|line| !line.starts_with('#')) {
        let mut parts = line.splitn(4, ' ').skip(1);
        let (number, mark, rest) = (parts.next(), parts.next(), parts.next().unwrap_or_default());
        let link = links.entry(number.unwrap().parse().unwrap()).or_default();
        match mark {
            Some("=") => link.open_link(rest),
            Some(">") => link.record_sent(&unescape(rest), rest),
            Some("<") => link.record_received(&unescape(rest), rest),
            _ => panic!("{line}"),
        }
    }
    let text = |(number, mut link): (u32, CapturedLink)| {
        link.move_greeting_before_first_request();
        let lines = link.normalised_lines.into_iter().map(|line| format!("{number} {line}\n"));
        lines.collect::<String>()
    };
    let text: String = links.into_iter().map(text).collect();
    replace_numbers(&replace_numbers(&text, "127.0.0.1:", "PORT"), "/dev/pts/", "N")
}

/// `text` with `name` in place of each number after `prefix`.
fn replace_numbers(text: &str, prefix: &str, name: &str) -> String {
    let mut parts = text.split(prefix);
    let mut result = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let rest = part.trim_start_matches(|letter: char| letter.is_ascii_digit());
        result.extend([prefix, name, rest]);
    }
    result
}

#[derive(Default)]
struct CapturedLink {
    link_kind: String,
    normalised_lines: Vec<String>,
    unparsed_sent_bytes: Vec<u8>,
    unparsed_received_bytes: Vec<u8>,
    /// The newest status, in its written form.
    newest_status_text: Option<String>,
    has_status_request: bool,
}

impl CapturedLink {
    /// Moves the first request directly before its `ok`.
    fn move_greeting_before_first_request(&mut self) {
        let place = |beginning: &str| self.normalised_lines.iter().position(|line| line.starts_with(beginning));
        if let (Some(request), Some(ok)) = (place("> "), place("< ok"))
            && self.link_kind == "lines"
            && request < ok
        {
            self.normalised_lines[request..ok].rotate_left(1);
        }
    }

    fn open_link(&mut self, opening: &str) {
        let (kind, name) = opening.split_once(' ').unwrap();
        self.link_kind = kind.to_owned();
        self.normalised_lines.push(format!("= {kind} {name}"));
    }

    fn record_sent(&mut self, bytes: &[u8], escaped: &str) {
        match &*self.link_kind {
            "lines" if bytes == b"?" => {}
            "lines" => {
                self.unparsed_sent_bytes.extend(bytes);
                self.normalised_lines.extend(take_complete_lines(&mut self.unparsed_sent_bytes, '>'));
            }
            "modbus-tcp" | "modbus-rtu" => {
                self.unparsed_sent_bytes.extend(bytes);
                while let Some(frame) = ModbusFrame::parse_next(&mut self.unparsed_sent_bytes, &self.link_kind, true) {
                    self.record_modbus_request(frame);
                }
            }
            _ => self.normalised_lines.push(format!("> {escaped}")),
        }
    }

    fn record_received(&mut self, bytes: &[u8], escaped: &str) {
        match &*self.link_kind {
            "lines" => {
                self.unparsed_received_bytes.extend(bytes);
                let lines = take_complete_lines(&mut self.unparsed_received_bytes, '<');
                self.normalised_lines.extend(lines.into_iter().filter(|line| !line.starts_with("< <")));
            }
            "modbus-tcp" | "modbus-rtu" => {
                self.unparsed_received_bytes.extend(bytes);
                while let Some(frame) =
                    ModbusFrame::parse_next(&mut self.unparsed_received_bytes, &self.link_kind, false)
                {
                    if frame.function == READ_INPUT_FUNCTION {
                        self.newest_status_text = Some(status_as_text(&frame.body[1..]));
                    }
                }
            }
            _ => self.normalised_lines.push(format!("< {escaped}")),
        }
    }

    fn record_modbus_request(&mut self, ModbusFrame { unit, function, body }: ModbusFrame) {
        let address = u16::from_be_bytes([body[0], body[1]]);
        let count = u16::from_be_bytes([body[2], body[3]]);
        let line = match function {
            WRITE_MULTIPLE_FUNCTION if (address, count) == (HEARTBEAT_REGISTER, 1) => return,
            READ_INPUT_FUNCTION if std::mem::replace(&mut self.has_status_request, true) => return,
            WRITE_MULTIPLE_FUNCTION => {
                if address == SEQUENCE_REGISTER {
                    self.normalised_lines.extend(self.newest_status_text.take());
                }
                let mut content = body[5..].to_vec();
                if address == HEARTBEAT_REGISTER {
                    content[..2].fill(0);
                }
                format!("> {unit} write {address}+{count} {}", content.escape_ascii())
            }
            READ_INPUT_FUNCTION => format!("> {unit} read input {address}+{count}"),
            READ_HOLDING_FUNCTION => format!("> {unit} read holding {address}+{count}"),
            other => format!("> {unit} function {other} {}", body.escape_ascii()),
        };
        self.normalised_lines.push(line);
    }
}

fn take_complete_lines(buffer: &mut Vec<u8>, mark: char) -> Vec<String> {
    let mut lines = Vec::new();
    while let Some(end) = buffer.iter().position(|byte| *byte == b'\n') {
        let line: Vec<u8> = buffer.drain(..=end).collect();
        lines.push(format!("{mark} {}", line.escape_ascii()));
    }
    lines
}

/// Registers as decimal numbers, followed by the two times as the numbers in their registers.
fn status_as_text(body: &[u8]) -> String {
    let registers = body.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]));
    let mut registers: Vec<u16> = registers.collect();
    let time = |at: usize| {
        let words = registers[at..at + 4].iter();
        f64::from_bits(words.fold(0, |bits, word| bits << 16 | u64::from(*word)))
    };
    let (now, latch) = (time(STATUS_TIME_REGISTER), time(STATUS_LATCH_TIME_REGISTER));
    let tail = registers.len() - 1;
    for counting in [STATUS_HEAD_REGISTER, STATUS_HEARTBEAT_REGISTER, tail] {
        registers[counting] = 0;
    }
    registers.drain(STATUS_TIME_REGISTER..STATUS_LATCH_TIME_REGISTER + 4);
    let shown: Vec<String> = registers.iter().map(u16::to_string).collect();
    format!("< status {} time_s {now} latch_time_s {latch}", shown.join(" "))
}

/// A request or a reply without its envelope.
struct ModbusFrame {
    unit: u8,
    function: u8,
    body: Vec<u8>,
}

impl ModbusFrame {
    /// The next complete frame.
    fn parse_next(buffer: &mut Vec<u8>, kind: &str, is_request: bool) -> Option<Self> {
        let (start, end, length) = match kind {
            "modbus-tcp" => {
                let rest = usize::from(u16::from_be_bytes([*buffer.get(4)?, *buffer.get(5)?]));
                (6, 6 + rest, 6 + rest)
            }
            _ => {
                let (function, has_content) = (*buffer.get(1)?, *buffer.get(1)? == WRITE_MULTIPLE_FUNCTION);
                let end = match (is_request, function) {
                    (true, _) if has_content => 7 + usize::from(*buffer.get(6)?),
                    (false, READ_HOLDING_FUNCTION | READ_INPUT_FUNCTION) => 3 + usize::from(*buffer.get(2)?),
                    (false, function) if function > 0x80 => 3,
                    _ => 6,
                };
                (0, end, end + 2)
            }
        };
        if buffer.len() < length {
            return None;
        }
        let frame: Vec<u8> = buffer.drain(..length).collect();
        let (unit, function) = (frame[start], frame[start + 1]);
        Some(Self { unit, function, body: frame[start + 2..end].to_vec() })
    }
}

/// The inverse of `escape_ascii`.
fn unescape(text: &str) -> Vec<u8> {
    let (mut bytes, mut rest) = (Vec::new(), text.bytes());
    while let Some(byte) = rest.next() {
        if byte != b'\\' {
            bytes.push(byte);
            continue;
        }
        bytes.push(match rest.next().unwrap() {
            b'n' => b'\n',
            b'r' => b'\r',
            b't' => b'\t',
            b'x' => {
                let digits = [rest.next().unwrap(), rest.next().unwrap()];
                u8::from_str_radix(std::str::from_utf8(&digits).unwrap(), 16).unwrap()
            }
            other => other,
        });
    }
    bytes
}
