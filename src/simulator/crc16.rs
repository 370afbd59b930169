//! CRC-16/MODBUS, independent of the drivers' implementation.

/// CRC-16/MODBUS of `bytes`, bit by bit.
pub(super) fn crc16_modbus(bytes: &[u8]) -> u16 {
    let mut sum = u16::MAX;
    for byte in bytes {
        sum ^= u16::from(*byte);
        for _ in 0..8 {
            sum = if sum & 1 == 1 { sum >> 1 ^ 0xA001 } else { sum >> 1 };
        }
    }
    sum
}
