//! Reads the answers of a control from a capture of a run, for a control that replays them.

use std::collections::BTreeMap;

/// Length of the status block, registers (docs/line-window.md).
pub const STATUS_REGISTER_COUNT: usize = 45;
/// Register of the chunk's sequence number in the command block.
const CHUNK_SEQUENCE_REGISTER: usize = 1;

/// Bytes of a capture with their direction: `>` to the control, `<` from the control.
fn bytes_with_direction(capture: &str) -> Vec<(char, Vec<u8>)> {
    let lines = capture.lines().filter(|line| !line.starts_with('#'));
    let cut = lines.filter_map(|line| {
        let mut parts = line.splitn(4, ' ').skip(2);
        let mark = parts.next()?.chars().next()?;
        Some((mark, unescape_ascii(parts.next()?)))
    });
    cut.filter(|(mark, _)| *mark != '=').collect()
}

/// The inverse of `u8::escape_ascii`.
fn unescape_ascii(text: &str) -> Vec<u8> {
    let mut rest = text.bytes();
    let mut found = Vec::new();
    while let Some(byte) = rest.next() {
        found.push(match byte {
            b'\\' => match rest.next().expect("an escape") {
                b'n' => b'\n',
                b'r' => b'\r',
                b't' => b'\t',
                b'x' => {
                    let digits = [rest.next().unwrap(), rest.next().unwrap()];
                    u8::from_str_radix(std::str::from_utf8(&digits).unwrap(), 16).unwrap()
                }
                other => other,
            },
            other => other,
        });
    }
    found
}

/// Requests a report with all fields from a grbl control.
pub const FULL_REPORT_REQUEST: u8 = 0x87;

/// A line to a grbl control, the answers to it, and the status reports that `?` and 0x87 request after it.
#[derive(Clone, Default)]
pub struct GrblExchange {
    pub line: Vec<u8>,
    pub replies: Vec<u8>,
    pub report: Vec<u8>,
    pub full_report: Vec<u8>,
}

/// Exchanges with a grbl control. The first has no line: its replies are the control's identification.
pub fn grbl_exchanges(capture: &str) -> Vec<GrblExchange> {
    let mut all = vec![GrblExchange::default()];
    let (mut sent, mut came) = (Vec::new(), Vec::new());
    for (mark, bytes) in bytes_with_direction(capture) {
        if mark == '>' {
            for byte in bytes {
                if matches!(byte, b'?' | FULL_REPORT_REQUEST) && sent.is_empty() {
                    continue;
                }
                sent.push(byte);
                if byte == b'\n' {
                    let line = std::mem::take(&mut sent);
                    let before = all.last().unwrap().clone();
                    all.push(GrblExchange { line, replies: Vec::new(), ..before });
                }
            }
            continue;
        }
        came.extend(bytes);
        while let Some(end) = came.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = came.drain(..=end).collect();
            let exchange = all.last_mut().unwrap();
            if line.starts_with(b"<") {
                if line.windows(4).any(|field| field == b"|FW:") {
                    exchange.full_report.clone_from(&line);
                }
                exchange.report = line;
            } else {
                exchange.replies.extend(line);
            }
        }
    }
    all
}

/// Status block of a Modbus control by the sequence number of the last chunk; 0: before the first chunk.
pub fn modbus_status_by_sequence(capture: &str) -> BTreeMap<u16, Vec<u16>> {
    let (mut sent, mut came) = (Vec::new(), Vec::new());
    let (mut sequence, mut found) = (0, BTreeMap::new());
    for (mark, bytes) in bytes_with_direction(capture) {
        if mark == '>' {
            sent.extend(bytes);
            while let Some(frame) = take_modbus_frame(&mut sent) {
                let values = frame.get(13..).unwrap_or_default();
                if frame[7] == 16 && read_u16_be(&frame, 8) == CHUNK_SEQUENCE_REGISTER as u16 && values.len() == 2 {
                    sequence = read_u16_be(values, 0);
                }
            }
            continue;
        }
        came.extend(bytes);
        while let Some(frame) = take_modbus_frame(&mut came) {
            if frame[7] == 4 && usize::from(frame[8]) == 2 * STATUS_REGISTER_COUNT {
                let words = frame[9..].chunks(2).map(|pair| read_u16_be(pair, 0));
                found.insert(sequence, words.collect());
            }
        }
    }
    found
}

/// Removes a complete Modbus TCP frame from the beginning of `bytes`: a header of six bytes, of which the last two
/// give the number of bytes that follow.
pub fn take_modbus_frame(bytes: &mut Vec<u8>) -> Option<Vec<u8>> {
    let end = 6 + usize::from(u16::from_be_bytes([*bytes.get(4)?, *bytes.get(5)?]));
    (bytes.len() >= end).then(|| bytes.drain(..end).collect())
}

pub fn read_u16_be(bytes: &[u8], at: usize) -> u16 {
    u16::from_be_bytes([bytes[at], bytes[at + 1]])
}
