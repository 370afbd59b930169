//! The two framings of Modbus requests.

use serde::Deserialize;

/// Framing of the requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Framing {
    /// With CRC and silent intervals; also over TCP, where a converter forwards the bytes.
    Rtu,
    /// With transaction numbers.
    Tcp,
}
