//! Modbus frames: where they end, and their transaction number, which differs between capture and replay.

use crc::{CRC_16_MODBUS, Crc};

use crate::modbus::Framing;

/// A request or reply without its envelope: the unit, then the PDU.
pub(super) type FrameBody = Vec<u8>;

/// Bytes before the frame body: the MBAP header without the unit identifier.
const TCP_HEADER_BYTES: usize = 6;

impl Framing {
    /// Removes all complete frames at the beginning of `bytes`; returns their bodies and transaction numbers (0 on
    /// RTU). An incomplete frame stays in `bytes`. RTU: pauses separate frames, so `bytes` holds at most one frame.
    pub(super) fn take_complete_frames(self, bytes: &mut Vec<u8>) -> Vec<(u16, FrameBody)> {
        let mut frames = Vec::new();
        match self {
            Self::Rtu => {
                if let [body @ .., _, _] = bytes.as_slice()
                    && MODBUS_CRC.checksum(body).to_le_bytes() == bytes[body.len()..]
                {
                    frames.push((0, body.to_vec()));
                    bytes.clear();
                }
            }
            Self::Tcp => {
                while let [t1, t0, _, _, n1, n0, ..] = *bytes.as_slice() {
                    let end = TCP_HEADER_BYTES + usize::from(u16::from_be_bytes([n1, n0]));
                    if bytes.len() < end {
                        break;
                    }
                    let frame: Vec<u8> = bytes.drain(..end).collect();
                    let body = frame.into_iter().skip(TCP_HEADER_BYTES).collect();
                    frames.push((u16::from_be_bytes([t1, t0]), body));
                }
            }
        }
        frames
    }

    /// Adds the envelope to `body`: the MBAP header, or on RTU the CRC (`transaction` is then ignored).
    pub(super) fn build_frame(self, transaction: u16, body: &[u8]) -> Vec<u8> {
        match self {
            Self::Rtu => [body, &MODBUS_CRC.checksum(body).to_le_bytes()].concat(),
            Self::Tcp => {
                let length = u16::try_from(body.len()).unwrap_or(u16::MAX);
                [&transaction.to_be_bytes(), &[0, 0], &length.to_be_bytes(), body].concat()
            }
        }
    }
}

const MODBUS_CRC: Crc<u16> = Crc::<u16>::new(&CRC_16_MODBUS);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_complete_frames_are_taken() {
        let mut bytes = Framing::Tcp.build_frame(7, &[1, 3, 2, 0, 9]);
        bytes.extend([0, 8, 0]);
        assert_eq!(Framing::Tcp.take_complete_frames(&mut bytes), [(7, vec![1, 3, 2, 0, 9])]);
        assert_eq!(bytes, [0, 8, 0]);
        let mut bytes = Framing::Rtu.build_frame(0, &[1, 3, 2, 0, 9]);
        let last = bytes.pop();
        assert_eq!(Framing::Rtu.take_complete_frames(&mut bytes), []);
        bytes.extend(last);
        assert_eq!(Framing::Rtu.take_complete_frames(&mut bytes), [(0, vec![1, 3, 2, 0, 9])]);
        assert!(bytes.is_empty());
    }
}
