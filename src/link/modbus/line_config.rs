//! Address and serial settings of a Modbus line.

use std::fmt;
use std::time::Duration;

use serde::Deserialize;

use super::drainable_stream::DrainableStream;
use super::framing::Framing;
use crate::address::open_stream;
use crate::link_mode::LinkBackend;
use crate::{LinkConfig, LinkError};

/// Parity bit of a serial line. A machine file without the key `parity` means even (`ModbusLineConfig::from_keys`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Parity {
    #[default]
    None,
    Even,
    Odd,
}

/// Settings of a Modbus line. A serial line has eight data bits and one stop bit.
#[derive(Debug, Clone)]
pub struct ModbusLineConfig {
    pub link: LinkConfig,
    pub framing: Framing,
    pub parity: Parity,
}

/// Silence that ends a frame: 3.5 characters. A character counts as 11 bits, including start, parity and stop bit;
/// above 19200 baud the silence is a fixed 1.75 ms.
const FRAME_SILENCE_BITS: f64 = 3.5 * 11.0;
const FRAME_SILENCE_ABOVE_19200_BAUD: Duration = Duration::from_micros(1750);
/// Silence that ends a frame over a network, where a frame may arrive in parts.
const NETWORK_FRAME_SILENCE: Duration = Duration::from_millis(20);

impl ModbusLineConfig {
    /// Default settings: RTU on a serial port, Modbus TCP over TCP; no parity, unlike [`Self::from_keys`].
    pub fn with_defaults(link: LinkConfig) -> Self {
        let framing = if matches!(link, LinkConfig::Tcp(_)) { Framing::Tcp } else { Framing::Rtu };
        Self { link, framing, parity: Parity::default() }
    }

    /// Settings from a file; the default parity of a serial line is even.
    ///
    /// # Errors
    /// A message, if keys exclude each other.
    pub fn from_keys(link: LinkConfig, framing: Option<Framing>, parity: Option<Parity>) -> Result<Self, String> {
        let default_line = Self::with_defaults(link);
        let over_tcp = matches!(default_line.link, LinkConfig::Tcp(_));
        if over_tcp && parity.is_some() {
            return Err("`parity` is only for `serial` and `serial_id`; remove it from a TCP link".to_owned());
        }
        if !over_tcp && framing == Some(Framing::Tcp) {
            return Err("`framing = \"tcp\"` needs a TCP link; set `rtu` on a serial line".to_owned());
        }
        let framing = framing.unwrap_or(default_line.framing);
        let parity = parity.unwrap_or(if over_tcp { Parity::None } else { Parity::Even });
        Ok(Self { framing, parity, ..default_line })
    }

    /// Silence that ends a frame. RTU over TCP has the silence of a network.
    pub(super) fn frame_silence(&self) -> Duration {
        match self.link.baud() {
            None => NETWORK_FRAME_SILENCE,
            Some(baud) if baud > 19_200 => FRAME_SILENCE_ABOVE_19200_BAUD,
            Some(baud) => Duration::from_secs_f64(FRAME_SILENCE_BITS / f64::from(baud.max(1))),
        }
    }

    /// Opens the line on the caller's runtime.
    pub(super) async fn open(&self, backend: &LinkBackend) -> Result<DrainableStream, LinkError> {
        let parity = match self.parity {
            Parity::None => tokio_serial::Parity::None,
            Parity::Even => tokio_serial::Parity::Even,
            Parity::Odd => tokio_serial::Parity::Odd,
        };
        // A replay opens no port, so the address need not exist.
        let opening = async { open_stream(self.link.resolve_address()?, parity).await };
        Ok(DrainableStream::new(backend.open(opening).await?))
    }
}

impl fmt::Display for ModbusLineConfig {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.link.fmt(f)
    }
}
