//! Address and serial settings of a Modbus line.

use std::fmt;
use std::time::Duration;

use serde::Deserialize;

use super::wire::Wire;
use crate::address::{serial, tcp};
use crate::capture::LinkProtocol;
use crate::wiring::Wired;
use crate::{Address, LinkError, Named};

/// Framing of the requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Framing {
    /// With CRC and silent intervals; also over TCP, where a converter forwards the bytes.
    Rtu,
    /// With transaction numbers.
    Tcp,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Parity {
    #[default]
    None,
    Even,
    Odd,
}

/// Line with eight data bits and one stop bit.
#[derive(Debug, Clone)]
pub struct Line {
    pub at: Named,
    pub framing: Framing,
    pub parity: Parity,
}

/// Silence that ends a frame: 3.5 characters. A character counts as 11 bits, including start, parity and stop bit;
/// above 19200 baud the silence is a fixed 1.75 ms.
const SILENT_BITS: f64 = 3.5 * 11.0;
const SHORTEST_SILENCE: Duration = Duration::from_micros(1750);
/// Silence that ends a frame over a network, where a frame may arrive in parts.
const NETWORK_SILENCE: Duration = Duration::from_millis(20);

impl Line {
    /// Default settings: RTU on a serial port, Modbus TCP over TCP, no parity.
    pub fn usual(at: Named) -> Self {
        let framing = if matches!(at, Named::Tcp(_)) { Framing::Tcp } else { Framing::Rtu };
        Self { at, framing, parity: Parity::default() }
    }

    /// Settings from a file; the default parity of a serial line is even.
    ///
    /// # Errors
    /// Keys that exclude each other; as a message.
    pub fn spoken(
        at: Named,
        framing: Option<Framing>,
        parity: Option<Parity>,
    ) -> Result<Self, String> {
        let usual = Self::usual(at);
        let over_tcp = matches!(usual.at, Named::Tcp(_));
        if over_tcp && parity.is_some() {
            return Err("`parity` belongs to `serial`; a TCP link has none: remove it".to_owned());
        }
        if !over_tcp && framing == Some(Framing::Tcp) {
            return Err(
                "`framing = \"tcp\"` needs a TCP link; on a serial line it is `rtu`".to_owned()
            );
        }
        let framing = framing.unwrap_or(usual.framing);
        let parity = parity.unwrap_or(if over_tcp { Parity::None } else { Parity::Even });
        Ok(Self { framing, parity, ..usual })
    }

    /// Silence that ends a frame.
    pub(super) fn silence(&self) -> Duration {
        match self.at {
            Named::Tcp(_) => NETWORK_SILENCE,
            Named::Serial { baud, .. } | Named::SerialId { baud, .. } if baud > 19_200 => {
                SHORTEST_SILENCE
            }
            Named::Serial { baud, .. } | Named::SerialId { baud, .. } => {
                Duration::from_secs_f64(SILENT_BITS / f64::from(baud.max(1)))
            }
        }
    }

    pub(super) fn speech(&self) -> LinkProtocol {
        match self.framing {
            Framing::Rtu => LinkProtocol::ModbusRtu,
            Framing::Tcp => LinkProtocol::ModbusTcp,
        }
    }

    /// Opens the line on the caller's runtime.
    pub(super) async fn open(&self, wired: &Wired) -> Result<Wire, LinkError> {
        let name = self.to_string();
        let address = match self.at.address() {
            Err(_) if matches!(wired, Wired::Played(_)) => {
                Address::Serial { path: name.clone(), baud: 0 }
            }
            address => address?,
        };
        Ok(Wire::new(match address {
            Address::Serial { path, baud } => {
                let parity = match self.parity {
                    Parity::None => tokio_serial::Parity::None,
                    Parity::Even => tokio_serial::Parity::Even,
                    Parity::Odd => tokio_serial::Parity::Odd,
                };
                wired.open(serial(path, baud, parity)).await?
            }
            Address::Tcp { host, port } => wired.open(tcp(name, host, port)).await?,
        }))
    }
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.at.fmt(f)
    }
}
