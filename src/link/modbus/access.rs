//! One request: its PDU, and the check of its reply.

use std::borrow::Cow;
use std::fmt;

use tokio_modbus::{Request, Response};

use super::RegisterSpace;

/// Maximum counts per request. A PDU holds 253 bytes; a read reply uses 2 of them, a write request 6.
pub(super) const MAX_READ_REGISTERS: u16 = 125;
pub(super) const MAX_WRITE_REGISTERS: u16 = 123;
pub(super) const MAX_READ_BITS: u16 = 2000;

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum RegisterAccess {
    Read { space: RegisterSpace, address: u16, count: u16 },
    Write { address: u16, words: Vec<u16> },
}

/// Everything in an RTU reply that depends on its request. Replies to requests of different shapes cannot be
/// confused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ReplyShape {
    pub(super) unit: u8,
    function: u8,
    /// Byte count of a read reply; 0 for a write, although its reply has more.
    bytes: u16,
}

impl ReplyShape {
    /// Whether unit and function agree. An exception reply contains nothing else.
    pub(super) fn has_same_function(self, other: Self) -> bool {
        (self.unit, self.function) == (other.unit, other.function)
    }
}

impl RegisterAccess {
    pub(super) fn to_pdu(&self) -> Request<'_> {
        match self {
            Self::Read { space, address, count } => {
                let (address, count) = (*address, *count);
                match space {
                    RegisterSpace::Holding => Request::ReadHoldingRegisters(address, count),
                    RegisterSpace::Input => Request::ReadInputRegisters(address, count),
                    RegisterSpace::Coil => Request::ReadCoils(address, count),
                    RegisterSpace::Discrete => Request::ReadDiscreteInputs(address, count),
                }
            }
            Self::Write { address, words } => Request::WriteMultipleRegisters(*address, Cow::Borrowed(words)),
        }
    }

    pub(super) fn reply_shape(&self, unit: u8) -> ReplyShape {
        let function = self.to_pdu().function_code().value();
        let bytes = match self {
            Self::Read { space: RegisterSpace::Coil | RegisterSpace::Discrete, count, .. } => count.div_ceil(8),
            Self::Read { count, .. } => 2 * count,
            Self::Write { .. } => 0,
        };
        ReplyShape { unit, function, bytes }
    }

    /// Register values of a reply. Checks that the reply has the requested count; for a write, that it echoes
    /// address and count. tokio-modbus compares unit, transaction and function.
    pub(super) fn decode_reply(&self, reply: Response) -> Result<Vec<u16>, String> {
        let check_count = |received: usize, asked: usize| {
            if received == asked {
                return Ok(());
            }
            Err(format!("the reply has {received} registers or bits, the request {asked}"))
        };
        match (self, reply) {
            (Self::Read { count, .. }, Response::ReadHoldingRegisters(words) | Response::ReadInputRegisters(words)) => {
                check_count(words.len(), usize::from(*count)).map(|()| words)
            }
            (Self::Read { count, .. }, Response::ReadCoils(bits) | Response::ReadDiscreteInputs(bits)) => {
                let count = usize::from(*count);
                // Bits arrive in whole bytes.
                check_count(bits.len(), count.next_multiple_of(8))?;
                Ok(bits.into_iter().take(count).map(u16::from).collect())
            }
            (Self::Write { address, words }, Response::WriteMultipleRegisters(at, count)) => {
                if (at, usize::from(count)) == (*address, words.len()) {
                    Ok(Vec::new())
                } else {
                    Err(format!("the reply confirms {count} registers from address {at}"))
                }
            }
            (_, other) => Err(format!("the reply has another function code, {}", other.function_code())),
        }
    }
}

impl fmt::Display for RegisterAccess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (action, address, count) = match self {
            Self::Read { space, address, count } => {
                let name = match space {
                    RegisterSpace::Holding => "reading holding register",
                    RegisterSpace::Input => "reading input register",
                    RegisterSpace::Coil => "reading coil",
                    RegisterSpace::Discrete => "reading discrete input",
                };
                (name, *address, usize::from(*count))
            }
            Self::Write { address, words } => ("writing holding register", *address, words.len()),
        };
        match count {
            1 => write!(f, "{action} {address}"),
            _ => write!(f, "{action}s {address} to {}", usize::from(address) + count.max(1) - 1),
        }
    }
}
