//! One request: its PDU, and the check of its reply.

use std::borrow::Cow;
use std::fmt;

use tokio_modbus::{Request, Response};

use super::Space;

/// Maximum counts per request. A PDU holds 253 bytes; a read reply uses 2 of them, a write request 6.
pub(super) const MOST_READ: u16 = 125;
pub(super) const MOST_WRITTEN: u16 = 123;
pub(super) const MOST_BITS: u16 = 2000;

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Ask {
    Read { space: Space, address: u16, count: u16 },
    Write { address: u16, words: Vec<u16> },
}

/// Everything in an RTU reply that depends on its request. Replies to requests of different shapes cannot be
/// confused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shape {
    pub(super) unit: u8,
    function: u8,
    /// Byte count of a read reply; 0 for a write, although its reply has more.
    bytes: u16,
}

impl Shape {
    /// Whether unit and function agree. An exception reply contains nothing else.
    pub(super) fn has_function_of(self, other: Self) -> bool {
        (self.unit, self.function) == (other.unit, other.function)
    }
}

impl Ask {
    pub(super) fn request(&self) -> Request<'_> {
        match self {
            Self::Read { space, address, count } => {
                let (address, count) = (*address, *count);
                match space {
                    Space::Holding => Request::ReadHoldingRegisters(address, count),
                    Space::Input => Request::ReadInputRegisters(address, count),
                    Space::Coil => Request::ReadCoils(address, count),
                    Space::Discrete => Request::ReadDiscreteInputs(address, count),
                }
            }
            Self::Write { address, words } => {
                Request::WriteMultipleRegisters(*address, Cow::Borrowed(words))
            }
        }
    }

    pub(super) fn shape(&self, unit: u8) -> Shape {
        let function = self.request().function_code().value();
        let bytes = match self {
            Self::Read { space: Space::Coil | Space::Discrete, count, .. } => count.div_ceil(8),
            Self::Read { count, .. } => 2 * count,
            Self::Write { .. } => 0,
        };
        Shape { unit, function, bytes }
    }

    /// Register values of a reply. Checks that the reply has the requested count; for a write, that it echoes
    /// address and count. tokio-modbus compares unit, transaction and function.
    pub(super) fn words(&self, reply: Response) -> Result<Vec<u16>, String> {
        let counted = |came: usize, asked: usize| {
            if came == asked {
                return Ok(());
            }
            Err(format!("{came} registers or bits came, {asked} were to come"))
        };
        match (self, reply) {
            (
                Self::Read { count, .. },
                Response::ReadHoldingRegisters(words) | Response::ReadInputRegisters(words),
            ) => counted(words.len(), usize::from(*count)).map(|()| words),
            (
                Self::Read { count, .. },
                Response::ReadCoils(bits) | Response::ReadDiscreteInputs(bits),
            ) => {
                let count = usize::from(*count);
                // Bits arrive in whole bytes.
                counted(bits.len(), count.next_multiple_of(8))?;
                Ok(bits.into_iter().take(count).map(u16::from).collect())
            }
            (Self::Write { address, words }, Response::WriteMultipleRegisters(at, count)) => {
                if (at, usize::from(count)) == (*address, words.len()) {
                    Ok(Vec::new())
                } else {
                    Err(format!("it confirms {count} registers from {at} on"))
                }
            }
            (_, other) => Err(format!("it answers another function, {}", other.function_code())),
        }
    }
}

impl fmt::Display for Ask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (what, address, count) = match self {
            Self::Read { space, address, count } => {
                let name = match space {
                    Space::Holding => "reading holding register",
                    Space::Input => "reading input register",
                    Space::Coil => "reading coil",
                    Space::Discrete => "reading discrete input",
                };
                (name, *address, usize::from(*count))
            }
            Self::Write { address, words } => ("writing holding register", *address, words.len()),
        };
        match count {
            1 => write!(f, "{what} {address}"),
            _ => write!(f, "{what}s {address} to {}", usize::from(address) + count.max(1) - 1),
        }
    }
}
