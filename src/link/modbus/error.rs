//! Errors of a Modbus request.

use std::time::Duration;

use crate::LinkError;

#[derive(Debug, thiserror::Error)]
pub enum ModbusError {
    /// The connection could not be opened or reopened: the request was not sent.
    #[error(transparent)]
    OpenFailed(#[from] LinkError),
    #[error("{request}: the device refuses function {function} with exception {code} ({})", exception_name(*code))]
    ExceptionReply { request: String, function: u8, code: u8 },
    /// No reply within `timeout`: the device's time limit, or the shorter limit after a hold over TCP.
    #[error("{request}: no reply within {:.1} s", timeout.as_secs_f64())]
    Timeout { request: String, timeout: Duration },
    #[error("{request}: the reply does not match the request: {why}")]
    UnexpectedReply { request: String, why: String },
    #[error("{request}: the connection was lost: {why}")]
    ConnectionLost { request: String, why: String },
    /// The late replies of earlier requests did not arrive: the request was not sent.
    #[error("{request} was not sent: late replies of earlier requests may still arrive ({why})")]
    LineNotCleared { request: String, why: String },
    /// The access list does not permit the request, or its count is out of range: the request was not sent.
    #[error("{request} is not allowed: {why}")]
    NotAllowed { request: String, why: String },
    /// The device confirmed the write, but the registers hold other values afterwards.
    #[error("{request}: written {written:?}, read back {read:?}")]
    ReadBackDiffers { request: String, written: Vec<u16>, read: Vec<u16> },
    #[error("{request}: the device confirmed the write, but reading back failed: {source}")]
    ReadBackFailed { request: String, source: Box<ModbusError> },
    #[error("{request} was not sent: a hold is active")]
    HoldActive { request: String },
    #[error("the thread of the link to {link} has ended")]
    LinkThreadEnded { link: String },
}

/// Names of the exception codes, from the Modbus application protocol.
fn exception_name(code: u8) -> &'static str {
    match code {
        1 => "illegal function",
        2 => "illegal data address",
        3 => "illegal data value",
        4 => "device failure",
        5 => "acknowledge: the device is still processing the request",
        6 => "device busy",
        8 => "memory parity error",
        10 => "gateway path unavailable",
        11 => "gateway target device failed to respond",
        _ => "a code of the manufacturer",
    }
}

impl ModbusError {
    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        let text = match self {
            Self::OpenFailed(error) => return error.remedy(),
            Self::ReadBackFailed { source, .. } => return source.remedy(),
            Self::ExceptionReply { code: 1, .. } => {
                "the device does not support this function: check in its manual whether it has input or holding registers"
            }
            Self::ExceptionReply { code: 2 | 3, .. } => {
                "compare the register map with the device's manual; many manuals count registers from \
                 1 or from 40001, the machine file counts from 0"
            }
            Self::ExceptionReply { code: 10 | 11, .. } => {
                "check `unit` and the wiring between the gateway and the device"
            }
            Self::ExceptionReply { .. } => "look up the exception code in the device's manual",
            Self::Timeout { .. } => {
                "check that the device is on, then check `unit`, baud rate, parity and the wiring; set a longer \
                 `timeout_s` for a slow device"
            }
            Self::UnexpectedReply { .. } | Self::LineNotCleared { .. } => {
                "a line may have one Modbus client only, and each unit identifier one device: check for another \
                 program or a second device, then check the shield and the terminators"
            }
            ModbusError::ConnectionLost { .. } | ModbusError::LinkThreadEnded { .. } => {
                "the state of the machine is unknown: check the machine, then restore the link"
            }
            Self::NotAllowed { .. } => "compare the register map with the registers of the device",
            Self::ReadBackDiffers { .. } => {
                "another program writes these registers, or the device clears or limits them: see the manual \
                 of the device"
            }
            Self::HoldActive { .. } => "check the machine, then acknowledge the stop",
        };
        text.to_owned()
    }
}
