//! Answers of a control, from a capture of a run, for a control that computes nothing.

use std::collections::BTreeMap;

/// Length of the status block, registers; index of the chunk's sequence in the command block (docs/line-window.md).
pub const STATUS: usize = 45;
const SEQUENCE: usize = 1;

/// Bytes with their direction: `>` to the control, `<` from the control.
fn passed(capture: &str) -> Vec<(char, Vec<u8>)> {
    let lines = capture.lines().filter(|line| !line.starts_with('#'));
    let cut = lines.filter_map(|line| {
        let mut parts = line.splitn(4, ' ').skip(2);
        let mark = parts.next()?.chars().next()?;
        Some((mark, bytes(parts.next()?)))
    });
    cut.filter(|(mark, _)| *mark != '=').collect()
}

/// The inverse of `u8::escape_ascii`.
fn bytes(text: &str) -> Vec<u8> {
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
pub const ASK_FULL: u8 = 0x87;

/// A line to a grbl control and the answers to it; then the reports, which `?` and [`ASK_FULL`] request.
#[derive(Clone, Default)]
pub struct Exchange {
    pub line: Vec<u8>,
    pub replies: Vec<u8>,
    pub report: Vec<u8>,
    pub full_report: Vec<u8>,
}

/// The first exchange has no line: it is the control's identification.
pub fn grbl(capture: &str) -> Vec<Exchange> {
    let mut all = vec![Exchange::default()];
    let (mut sent, mut came) = (Vec::new(), Vec::new());
    for (mark, bytes) in passed(capture) {
        if mark == '>' {
            for byte in bytes {
                if matches!(byte, b'?' | ASK_FULL) && sent.is_empty() {
                    continue;
                }
                sent.push(byte);
                if byte == b'\n' {
                    let line = std::mem::take(&mut sent);
                    let before = all.last().unwrap().clone();
                    all.push(Exchange { line, replies: Vec::new(), ..before });
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

/// Status of a Modbus control after each chunk; key 0: before the first chunk.
pub fn modbus(capture: &str) -> BTreeMap<u16, Vec<u16>> {
    let (mut sent, mut came) = (Vec::new(), Vec::new());
    let (mut sequence, mut found) = (0, BTreeMap::new());
    for (mark, bytes) in passed(capture) {
        if mark == '>' {
            sent.extend(bytes);
            while let Some(frame) = frame(&mut sent) {
                let values = frame.get(13..).unwrap_or_default();
                if frame[7] == 16 && word(&frame, 8) == SEQUENCE as u16 && values.len() == 2 {
                    sequence = word(values, 0);
                }
            }
            continue;
        }
        came.extend(bytes);
        while let Some(frame) = frame(&mut came) {
            if frame[7] == 4 && usize::from(frame[8]) == 2 * STATUS {
                let words = frame[9..].chunks(2).map(|pair| word(pair, 0));
                found.insert(sequence, words.collect());
            }
        }
    }
    found
}

/// A complete Modbus TCP frame from the beginning of `bytes`: a header of six bytes, of which the last two give the
/// number of bytes that follow.
pub fn frame(bytes: &mut Vec<u8>) -> Option<Vec<u8>> {
    let end = 6 + usize::from(u16::from_be_bytes([*bytes.get(4)?, *bytes.get(5)?]));
    (bytes.len() >= end).then(|| bytes.drain(..end).collect())
}

pub fn word(bytes: &[u8], at: usize) -> u16 {
    u16::from_be_bytes([bytes[at], bytes[at + 1]])
}
