//! Identifies the device at a port, independent of the machine file, by the identification request of each
//! control. None of these requests moves a machine that understands it.
//!
//! At a wrong baud rate a byte may be received as any other byte. A single `?` is never received as a byte on
//! which Grbl acts, for any two baud rates of [`SPEEDS`] (a test checks each pair); a Modbus device does not
//! answer a request with a wrong checksum.

use std::time::Duration;

use tokio::time::Instant;

use super::{Diagnosis, grbl, linuxcnc, modbus};
use link::modbus::{Allowed, Framing, Line, Modbus, ModbusError, Parity, Range, Settings, Space};
use link::{Address, Named, Received};

/// Usual baud rates, the most usual first.
pub(in crate::controllers) const SPEEDS: [u32; 9] =
    [115_200, 250_000, 57_600, 38_400, 19_200, 9_600, 230_400, 460_800, 921_600];

const ANSWER: Duration = Duration::from_millis(1200);
const AGAIN: Duration = Duration::from_millis(300);
/// Maximum time for a Modbus reply. A reply of a few bytes at 9600 baud takes 10 ms.
const REPLY: Duration = Duration::from_millis(250);
/// Unit number that a Modbus device on TCP answers if there is no gateway.
const TCP_UNIT: u8 = 255;
const RTU_UNIT: u8 = 1;

/// Searches for a control of another kind than `known` at a serial port, at `baud` or another usual rate.
pub(in crate::controllers) async fn on_serial(
    path: &str,
    baud: u32,
    known: &str,
) -> Option<Diagnosis> {
    let speeds =
        || std::iter::once(baud).chain(SPEEDS.into_iter().filter(move |speed| *speed != baud));
    if known != grbl::KIND {
        for baud in speeds() {
            let address = Address::Serial { path: path.to_owned(), baud };
            if let Some(said) = greets_as_grbl(&address).await {
                let keys = format!("serial = \"{path}\" and baud = {baud}");
                return Some(wrong_kind(known, grbl::KIND, &format!("answers `{said}`"), &keys));
            }
        }
    }
    if known != modbus::KIND {
        for baud in speeds() {
            let at = Named::Serial { path: path.into(), baud };
            for line in modbus_lines(&at) {
                if answers_modbus(&line, RTU_UNIT).await {
                    let keys = format!("serial = \"{path}\" and baud = {baud}");
                    return Some(wrong_kind(known, modbus::KIND, "answers as unit 1", &keys));
                }
            }
        }
    }
    None
}

/// Searches for a control of another kind than `known` behind a TCP port.
pub(in crate::controllers) async fn on_tcp(at: &Named, known: &str) -> Option<Diagnosis> {
    let address = at.address().ok()?;
    let keys = format!("tcp = \"{address}\"");
    if known != modbus::KIND {
        for line in modbus_lines(at) {
            if answers_modbus(&line, TCP_UNIT).await {
                return Some(wrong_kind(known, modbus::KIND, "answers there", &keys));
            }
        }
    }
    if known != linuxcnc::KIND
        && let Some(said) = greets_as_rsh(&address).await
    {
        return Some(wrong_kind(known, linuxcnc::KIND, &format!("says `{said}`"), &keys));
    }
    if known != grbl::KIND
        && let Some(said) = greets_as_grbl(&address).await
    {
        return Some(wrong_kind(known, grbl::KIND, &format!("answers `{said}`"), &keys));
    }
    None
}

fn wrong_kind(known: &str, kind: &str, said: &str, keys: &str) -> Diagnosis {
    Diagnosis {
        seen: true,
        vague: false,
        what: format!("wrong kind of control: what answers is of kind `{kind}`, not `{known}`"),
        because: format!("in the language of `{kind}` it {said}"),
        remedy: format!("in the machine file: [controller] kind = \"{kind}\" with {keys}"),
    }
}

/// Suspected cause if no known control answers at `at`.
pub(in crate::controllers) fn no_known_device(at: &str, because: &str) -> Diagnosis {
    Diagnosis {
        seen: false,
        vague: false,
        what: format!("wrong port, or what is at {at} is off, not wired, or no control that is known"),
        because: because.to_owned(),
        remedy: "switch it on, look at the cable; unplug it and see which name goes (`ls \
                 /dev/serial/by-id`); then [controller] serial, serial_id or tcp in the machine file"
            .to_owned(),
    }
}

/// Returns the answer of a Grbl to `?`.
pub(in crate::controllers) async fn greets_as_grbl(address: &Address) -> Option<String> {
    let is_status = |line: &str| line.starts_with('<') && line.ends_with('>') && line.contains('|');
    said(address, b"?", is_status).await
}

/// Returns the answer of linuxcncrsh to a greeting.
pub(in crate::controllers) async fn greets_as_rsh(address: &Address) -> Option<String> {
    said(address, b"hello EMC trued 1.0\n", |line| line.starts_with("HELLO ")).await
}

/// Returns the first line that `fits`; repeats the request while nothing comes.
async fn said(address: &Address, ask: &[u8], fits: impl Fn(&str) -> bool) -> Option<String> {
    let mut link = link::open(address).await.ok()?;
    let deadline = Instant::now() + ANSWER;
    while Instant::now() < deadline {
        link.send(ask).ok()?;
        let again = deadline.min(Instant::now() + AGAIN);
        while let Some(received) = link.recv_deadline(again).await.ok()? {
            match received {
                Received::Line(line) if fits(line.trim()) => return Some(line.trim().to_owned()),
                _ => {}
            }
        }
    }
    None
}

/// Whether a Modbus device answers as `unit`, even if with a refusal.
pub(in crate::controllers) async fn answers_modbus(line: &Line, unit: u8) -> bool {
    let read = vec![Range { space: Space::Input, first: 0, last: 0 }];
    let settings = Settings { unit, timeout: REPLY, allowed: Allowed { read, write: Vec::new() } };
    let Ok(modbus) = Modbus::open(line.clone(), settings).await else { return false };
    let reply = modbus.read(Space::Input, 0, 1).await;
    matches!(reply, Ok(_) | Err(ModbusError::Refused { .. }))
}

/// Lines at `at` on which a Modbus device may answer.
fn modbus_lines(at: &Named) -> Vec<Line> {
    let usual = Line::usual(at.clone());
    match usual.framing {
        Framing::Tcp => vec![usual],
        Framing::Rtu => {
            [Parity::Even, Parity::None].map(|parity| Line { parity, ..usual.clone() }).to_vec()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use link::heard;

    #[test]
    fn a_question_mark_at_a_wrong_speed_commands_nothing() {
        // Grbl's realtime commands that act (grblHAL `grbl.h`: exit, reset, stop; of those from 0x80 on,
        // 0x80 and 0x87 report and 0x9f is none), line ends, and every character that a line may contain.
        let acts = |byte: u8| {
            matches!(byte, b'\n' | b'\r' | 0x03 | 0x18 | 0x19 | 0x81..=0x86 | 0x88..=0x9e | 0xa0..=0xa4)
                || (0x20..0x7f).contains(&byte)
        };
        let mut heard_at_all = 0;
        for (sent, hears) in SPEEDS.iter().flat_map(|a| SPEEDS.map(|b| (*a, b))) {
            let bytes = heard(b"?", sent, hears);
            heard_at_all += bytes.len();
            let acted = bytes.iter().find(|byte| acts(**byte) && sent != hears);
            assert_eq!(acted, None, "{sent} heard at {hears}");
        }
        assert!(heard_at_all > 70);
    }
}
