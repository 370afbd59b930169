//! One request: its PDU, and the check of its reply.

use std::borrow::Cow;
use std::fmt;

use tokio_modbus::{Request, Response};

use super::{ModbusError, RegisterSpace};

/// Maximum counts per request. A PDU holds 253 bytes; a read reply uses 2 of them, a write request 6.
pub(super) const MAX_READ_REGISTERS: u16 = 125;
pub(super) const MAX_WRITE_REGISTERS: u16 = 123;
pub(super) const MAX_READ_BITS: u16 = 2000;

/// A read, or a write of holding registers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct RegisterAccess {
    pub(super) space: RegisterSpace,
    /// Address of the first register or bit, counted from 0.
    pub(super) address: u16,
    pub(super) register_or_bit_count: u16,
    /// `None` for a read.
    pub(super) written_words: Option<Vec<u16>>,
}

/// Everything in an RTU reply that depends on its request. Replies to requests of different shapes cannot be
/// confused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ReplyShape {
    pub(super) unit: u8,
    function_code: u8,
    /// Byte count of a read reply; 0 for a write, although its reply has more.
    read_byte_count: u16,
}

impl ReplyShape {
    /// Whether unit and function agree. Apart from its exception code, an exception reply contains nothing else.
    pub(super) fn has_same_unit_and_function(self, other: Self) -> bool {
        (self.unit, self.function_code) == (other.unit, other.function_code)
    }
}

impl RegisterAccess {
    pub(super) fn new_read(space: RegisterSpace, address: u16, count: u16) -> Self {
        Self { space, address, register_or_bit_count: count, written_words: None }
    }

    pub(super) fn new_write(address: u16, words: &[u16]) -> Self {
        let register_or_bit_count = u16::try_from(words.len()).unwrap_or(u16::MAX);
        Self { space: RegisterSpace::Holding, address, register_or_bit_count, written_words: Some(words.to_vec()) }
    }

    pub(super) fn is_write(&self) -> bool {
        self.written_words.is_some()
    }

    pub(super) fn to_pdu(&self) -> Request<'_> {
        let Self { space, address, register_or_bit_count: count, .. } = *self;
        match (&self.written_words, space) {
            (Some(words), _) => Request::WriteMultipleRegisters(address, Cow::Borrowed(words)),
            (None, RegisterSpace::Holding) => Request::ReadHoldingRegisters(address, count),
            (None, RegisterSpace::Input) => Request::ReadInputRegisters(address, count),
            (None, RegisterSpace::Coil) => Request::ReadCoils(address, count),
            (None, RegisterSpace::Discrete) => Request::ReadDiscreteInputs(address, count),
        }
    }

    pub(super) fn reply_shape(&self, unit: u8) -> ReplyShape {
        let function = self.to_pdu().function_code().value();
        let byte_count = match (self.is_write(), self.space.has_bits()) {
            (true, _) => 0,
            (false, true) => self.register_or_bit_count.div_ceil(8),
            (false, false) => 2 * self.register_or_bit_count,
        };
        ReplyShape { unit, function_code: function, read_byte_count: byte_count }
    }

    /// Register values of a reply; empty for a write. Checks that the reply has the requested count; for a write, that
    /// it echoes address and count. tokio-modbus compares unit, transaction and function.
    ///
    /// # Errors
    /// [`ModbusError::UnexpectedReply`].
    pub(super) fn decode_reply(&self, reply: Response) -> Result<Vec<u16>, ModbusError> {
        let unexpected = |why| ModbusError::UnexpectedReply { request: self.to_string(), why };
        let check_count = |received: usize, requested: usize| match received == requested {
            true => Ok(()),
            false => Err(unexpected(format!("the reply has {received} registers or bits, the request {requested}"))),
        };
        let count = usize::from(self.register_or_bit_count);
        match (self.is_write(), reply) {
            (false, Response::ReadHoldingRegisters(words) | Response::ReadInputRegisters(words)) => {
                check_count(words.len(), count)?;
                Ok(words)
            }
            (false, Response::ReadCoils(bits) | Response::ReadDiscreteInputs(bits)) => {
                // Bits arrive in whole bytes.
                check_count(bits.len(), count.next_multiple_of(8))?;
                Ok(bits.into_iter().take(count).map(u16::from).collect())
            }
            (true, Response::WriteMultipleRegisters(address, count)) => {
                if (address, count) == (self.address, self.register_or_bit_count) {
                    return Ok(Vec::new());
                }
                Err(unexpected(format!("the reply confirms {count} registers from address {address}")))
            }
            (_, other) => Err(unexpected(format!("the reply has another function code, {}", other.function_code()))),
        }
    }
}

impl fmt::Display for RegisterAccess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let action = match (self.is_write(), self.space) {
            (true, _) => "writing holding register",
            (false, RegisterSpace::Holding) => "reading holding register",
            (false, RegisterSpace::Input) => "reading input register",
            (false, RegisterSpace::Coil) => "reading coil",
            (false, RegisterSpace::Discrete) => "reading discrete input",
        };
        let first = usize::from(self.address);
        match usize::from(self.register_or_bit_count) {
            1 => write!(f, "{action} {first}"),
            count => write!(f, "{action}s {first} to {}", first + count.max(1) - 1),
        }
    }
}
