//! Identifies the device at a port, independent of the machine file, by the identification request of each
//! control. None of these requests moves a machine that understands it.
//!
//! At a wrong baud rate a byte may be received as any other byte. A single `?` is never received as a byte on
//! which Grbl acts, for any two baud rates of [`BAUD_RATES`] (a test checks each pair); a Modbus device does not
//! answer a request with a wrong checksum.

use std::time::Duration;

use tokio::time::Instant;

use super::{PossibleCause, grbl, linuxcnc, modbus};
use link::modbus::{
    AccessList, DeviceSettings, Framing, ModbusClient, ModbusError, ModbusLineConfig, Parity, RegisterRange,
    RegisterSpace,
};
use link::{LineEvent, LinkAddress, LinkConfig};

/// Usual baud rates, the most usual first.
pub(in crate::controllers) const BAUD_RATES: [u32; 9] =
    [115_200, 250_000, 57_600, 38_400, 19_200, 9_600, 230_400, 460_800, 921_600];

/// Maximum time for a reply to the request that identifies a control, its repetitions included.
const GREETING_TIMEOUT: Duration = Duration::from_millis(1200);
const GREETING_RETRY_INTERVAL: Duration = Duration::from_millis(300);
/// Maximum time for a Modbus reply. A reply of a few bytes at 9600 baud takes 10 ms.
const MODBUS_REPLY_TIMEOUT: Duration = Duration::from_millis(250);
/// Unit number that a Modbus device on TCP answers if there is no gateway.
const DEFAULT_TCP_UNIT: u8 = 255;
/// Unit number that is tried at a serial port whose configured control is of another kind.
const DEFAULT_RTU_UNIT: u8 = 1;

/// Searches for a control of another kind than `configured_kind` at a serial port, at `baud` or another usual rate.
pub(in crate::controllers) async fn scan_serial(path: &str, baud: u32, configured_kind: &str) -> Option<PossibleCause> {
    for kind in [grbl::CONTROL_KIND, modbus::CONTROL_KIND].into_iter().filter(|kind| *kind != configured_kind) {
        for baud in std::iter::once(baud).chain(BAUD_RATES.into_iter().filter(|rate| *rate != baud)) {
            let at = LinkConfig::Serial { path: path.into(), baud };
            if let Some(reply) = query_control(kind, &at).await {
                let keys = format!("serial = \"{path}\" and baud = {baud}");
                return Some(wrong_kind_diagnosis(configured_kind, kind, &reply, &keys));
            }
        }
    }
    None
}

/// Searches for a control of another kind than `configured_kind` behind a TCP port.
pub(in crate::controllers) async fn scan_tcp(at: &LinkConfig, configured_kind: &str) -> Option<PossibleCause> {
    let keys = format!("tcp = \"{}\"", at.resolve_address().ok()?);
    let kinds = [modbus::CONTROL_KIND, linuxcnc::CONTROL_KIND, grbl::CONTROL_KIND];
    for kind in kinds.into_iter().filter(|kind| *kind != configured_kind) {
        if let Some(reply) = query_control(kind, at).await {
            return Some(wrong_kind_diagnosis(configured_kind, kind, &reply, &keys));
        }
    }
    None
}

/// Sends the identification request of `kind` to `at`; describes the reply, `None` if there is none.
async fn query_control(kind: &str, at: &LinkConfig) -> Option<String> {
    if kind == modbus::CONTROL_KIND {
        let (unit, reply) = match at {
            LinkConfig::Tcp(_) => (DEFAULT_TCP_UNIT, "a reply"),
            _ => (DEFAULT_RTU_UNIT, "a reply from unit 1"),
        };
        for line in modbus_line_candidates(at) {
            if has_modbus_unit(&line, unit).await {
                return Some(reply.to_owned());
            }
        }
        return None;
    }
    let address = at.resolve_address().ok()?;
    let reply = match kind {
        linuxcnc::CONTROL_KIND => query_linuxcncrsh(&address).await,
        _ => query_grbl(&address).await,
    };
    reply.map(|reply| format!("the reply `{reply}`"))
}

fn wrong_kind_diagnosis(configured_kind: &str, kind: &str, reply: &str, keys: &str) -> PossibleCause {
    PossibleCause::observed(
        format!("wrong kind of control: the device is of kind `{kind}`, not `{configured_kind}`"),
        format!("a request in the protocol of `{kind}` got {reply}"),
        format!("in the machine file, set [controller] kind = \"{kind}\" with {keys}"),
    )
}

/// Suspected cause if no known control answers at `at`.
pub(in crate::controllers) fn no_known_control_diagnosis(at: &str, evidence: &str) -> PossibleCause {
    PossibleCause::suspected(
        format!("wrong port, or the device at {at} is off, not wired, or not a supported control"),
        evidence,
        "switch the device on and check the cable; unplug the device to see which name disappears (`ls \
         /dev/serial/by-id`); then correct [controller] serial, serial_id or tcp in the machine file",
    )
}

/// Returns the answer of a Grbl to `?`.
pub(in crate::controllers) async fn query_grbl(address: &LinkAddress) -> Option<String> {
    let is_status = |line: &str| line.starts_with('<') && line.ends_with('>') && line.contains('|');
    query_matching_line(address, b"?", is_status).await
}

/// Returns the answer of linuxcncrsh to a greeting.
pub(in crate::controllers) async fn query_linuxcncrsh(address: &LinkAddress) -> Option<String> {
    query_matching_line(address, b"hello EMC trued 1.0\n", |line| line.starts_with("HELLO ")).await
}

/// Returns the first line for which `is_match` is true; repeats the request while nothing comes.
async fn query_matching_line(address: &LinkAddress, request: &[u8], is_match: impl Fn(&str) -> bool) -> Option<String> {
    let mut link = link::open_line_link(address).await.ok()?;
    let deadline = Instant::now() + GREETING_TIMEOUT;
    while Instant::now() < deadline {
        link.send(request).ok()?;
        let retry_at = deadline.min(Instant::now() + GREETING_RETRY_INTERVAL);
        while let Some(received) = link.recv_deadline(retry_at).await.ok()? {
            if let LineEvent::Line(line) = received
                && is_match(line.trim())
            {
                return Some(line.trim().to_owned());
            }
        }
    }
    None
}

/// Whether a Modbus device answers as `unit`; an exception reply counts as an answer.
pub(in crate::controllers) async fn has_modbus_unit(line: &ModbusLineConfig, unit: u8) -> bool {
    let read = vec![RegisterRange { space: RegisterSpace::Input, first: 0, last: 0 }];
    let settings = DeviceSettings { unit, timeout: MODBUS_REPLY_TIMEOUT, access_list: AccessList::read_only(read) };
    let Ok(modbus) = ModbusClient::open(line.clone(), settings).await else { return false };
    let reply = modbus.read(RegisterSpace::Input, 0, 1).await;
    matches!(reply, Ok(_) | Err(ModbusError::ExceptionReply { .. }))
}

/// Lines at `at` on which a Modbus device may answer.
fn modbus_line_candidates(at: &LinkConfig) -> Vec<ModbusLineConfig> {
    let default_line = ModbusLineConfig::with_defaults(at.clone());
    match default_line.framing {
        Framing::Tcp => vec![default_line],
        Framing::Rtu => {
            [Parity::Even, Parity::None].map(|parity| ModbusLineConfig { parity, ..default_line.clone() }).to_vec()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use link::decode_at_baud;

    #[test]
    fn status_query_at_a_wrong_baud_rate_is_no_command() {
        // Grbl's realtime commands that act (grblHAL `grbl.h`: exit, reset, stop, and 0x81 to 0xa4 except the report
        // 0x87 and the unused 0x9f), line ends, and every character that a line may contain.
        let acts = |byte: u8| {
            matches!(byte, b'\n' | b'\r' | 0x03 | 0x18 | 0x19 | 0x81..=0x86 | 0x88..=0x9e | 0xa0..=0xa4)
                || (0x20..0x7f).contains(&byte)
        };
        let mut heard_at_all = 0;
        for (sent, hears) in BAUD_RATES.iter().flat_map(|a| BAUD_RATES.map(|b| (*a, b))) {
            let bytes = decode_at_baud(b"?", sent, hears);
            heard_at_all += bytes.len();
            let acted = bytes.iter().find(|byte| acts(**byte) && sent != hears);
            assert_eq!(acted, None, "{sent} heard at {hears}");
        }
        assert!(heard_at_all > 70);
    }
}
