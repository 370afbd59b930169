//! CRC-16/MODBUS of a chunk's text: reflected polynomial 0x8005, initial value all ones.

pub(super) fn crc16_modbus(text: &[u8]) -> u16 {
    text.iter().fold(0xFFFF, |crc, byte| {
        (0..8).fold(crc ^ u16::from(*byte), |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0xA001 } else { crc >> 1 })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_check_value_of_the_catalogue() {
        assert_eq!(crc16_modbus(b"123456789"), 0x4B37);
    }
}
