//! Errors of a request.

use std::time::Duration;

use crate::LinkError;

#[derive(Debug, thiserror::Error)]
pub enum ModbusError {
    /// The connection could not be opened or reopened: the request was not sent.
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error("{request}: the device refuses function {function} with exception {code} ({})", meaning(*code))]
    Refused { request: String, function: u8, code: u8 },
    #[error("{request}: no answer within {:.1} s", within.as_secs_f64())]
    Late { request: String, within: Duration },
    #[error("{request}: the reply does not fit: {why}")]
    Misfit { request: String, why: String },
    #[error("{request}: the connection was lost: {why}")]
    Lost { request: String, why: String },
    /// The late replies of earlier requests did not arrive: the request was not sent.
    #[error("{request} was not sent: the line could not be cleared of what came late ({why})")]
    Unclear { request: String, why: String },
    #[error("{request} is not allowed: {why}")]
    NotAllowed { request: String, why: String },
    #[error("{request}: the device keeps {read:?} where {written:?} was written")]
    NotAsWritten { request: String, written: Vec<u16>, read: Vec<u16> },
    #[error("{request} arrived, but could not be read back: {source}")]
    NotReadBack { request: String, source: Box<ModbusError> },
    #[error("{request} was not sent: the machine is held")]
    Held { request: String },
    #[error("the link to {link} has ended")]
    Ended { link: String },
}

/// Names of the exception codes, from the Modbus application protocol.
fn meaning(code: u8) -> &'static str {
    match code {
        1 => "illegal function",
        2 => "illegal data address",
        3 => "illegal data value",
        4 => "device failure",
        5 => "acknowledge: it takes its time",
        6 => "device busy",
        8 => "memory parity error",
        10 => "gateway path unavailable",
        11 => "gateway: the device does not respond",
        _ => "a code of its own",
    }
}

impl ModbusError {
    /// Whether a write may have reached the device in spite of the error. The caller must not repeat it before
    /// reading the device's counter.
    pub fn may_have_arrived(&self) -> bool {
        match self {
            Self::Late { .. }
            | Self::Misfit { .. }
            | Self::Lost { .. }
            | Self::NotAsWritten { .. }
            | Self::NotReadBack { .. }
            | Self::Ended { .. } => true,
            Self::Link(_)
            | Self::Refused { .. }
            | Self::Unclear { .. }
            | Self::NotAllowed { .. }
            | Self::Held { .. } => false,
        }
    }

    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        let text = match self {
            Self::Link(error) => return error.remedy(),
            Self::NotReadBack { source, .. } => return source.remedy(),
            Self::Refused { code: 1, .. } => {
                "the device does not know this function: see its manual for input or holding registers"
            }
            Self::Refused { code: 2 | 3, .. } => {
                "compare the register map with the device's manual; many manuals count registers from \
                 1 or from 40001, here they count from 0"
            }
            Self::Refused { code: 10 | 11, .. } => {
                "the gateway does not reach the device: check `unit` and the wires behind the gateway"
            }
            Self::Refused { .. } => "look at the device: its manual says what this code means",
            Self::Late { .. } => {
                "check that the device is on, then `unit`, baud rate, parity and the wires; a slow \
                 device needs a longer `timeout_s`"
            }
            Self::Misfit { .. } | Self::Unclear { .. } => {
                "only one master may speak on a line, and a unit identifier belongs to one device: \
                 look for another program or a second device; then the shield and the terminators"
            }
            Self::Lost { .. } | Self::Ended { .. } => {
                "the state of the machine is unknown: look at it, then mend the link"
            }
            Self::NotAllowed { .. } => "compare the register map with what the device offers",
            Self::NotAsWritten { .. } => {
                "something else writes these registers, or the device clears or limits them: see its \
                 manual"
            }
            Self::Held { .. } => "look at the machine, then acknowledge the stop",
        };
        text.to_owned()
    }
}
