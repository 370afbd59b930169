//! Simulated serial line between two sides with different baud rates. A pseudo-terminal transfers every byte
//! whatever the baud rate, but it stores the rate that its client has set. From both rates, this module computes
//! the bytes that each side would receive on a real line. For tests only; contains no device-specific code.

use std::io;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio_serial::{SerialPort, SerialStream};

use super::{LinkError, Pty, create_pty};

/// Bits of one character: start bit, eight data bits, stop bit.
const BITS_PER_CHARACTER: u64 = 10;
const DATA_BITS: u64 = 8;
/// Byte that the operating system returns for a framing error (termios: neither IGNPAR nor PARMRK).
const FRAMING_ERROR_BYTE: u8 = 0;

/// Returns the bytes that a receiver at `receiver_baud` baud decodes from `bytes`, sent without pauses at
/// `sender_baud` baud. The receiver waits for a falling edge and samples the middle of each of its own bits.
pub fn decode_at_baud(bytes: &[u8], sender_baud: u32, receiver_baud: u32) -> Vec<u8> {
    if sender_baud == receiver_baud || sender_baud == 0 || receiver_baud == 0 {
        return bytes.to_vec();
    }
    // The unit of time is chosen such that half a bit of either side is an integer.
    let (bit, half) = (2 * u64::from(receiver_baud), u64::from(sender_baud));
    let level_at = |time: u64| is_line_high(bytes, time / bit);
    let end = BITS_PER_CHARACTER * bytes.len() as u64;
    let mut received = Vec::new();
    let mut bit_index = 0;
    while let Some(start_bit_index) = (bit_index..end).find(|bit_index| !is_line_high(bytes, *bit_index)) {
        let start = start_bit_index * bit;
        let sample = |k: u64| level_at(start + (2 * k + 1) * half);
        let byte = (0..DATA_BITS).fold(0, |byte, k| byte | u8::from(sample(k + 1)) << k);
        let has_stop_bit = sample(DATA_BITS + 1);
        let stop_bit_end = start + (2 * (DATA_BITS + 1) + 1) * half;
        if sample(0) {
            // A low pulse shorter than half a bit is not a start bit.
            bit_index = start_bit_index + 1;
            continue;
        }
        received.push(if has_stop_bit { byte } else { FRAMING_ERROR_BYTE });
        let rest = stop_bit_end / bit;
        // The next character begins with a falling edge, so the line must be high before.
        bit_index = (rest..end).find(|bit_index| is_line_high(bytes, *bit_index)).unwrap_or(end);
    }
    received
}

/// Level of the line during bit `bit_index` of `bytes`; high when nothing is sent.
fn is_line_high(bytes: &[u8], bit_index: u64) -> bool {
    let byte = usize::try_from(bit_index / BITS_PER_CHARACTER).ok().and_then(|at| bytes.get(at));
    match (byte, bit_index % BITS_PER_CHARACTER) {
        (None, _) => true,
        (Some(_), 0) => false,
        (Some(byte), bit) if bit <= DATA_BITS => byte >> (bit - 1) & 1 == 1,
        (Some(_), _) => true,
    }
}

/// Makes a pty for a simulated device at `baud`. With a client at another baud rate, both sides receive the bytes
/// that a real line would give. Call inside a tokio runtime.
///
/// # Errors
/// The pty cannot be made.
pub fn create_pty_at_baud(baud: u32) -> Result<Pty, LinkError> {
    let (outer, inner) = (create_pty()?, create_pty()?);
    if let (Some(client), Some(device)) = (outer.client_side, inner.client_side) {
        tokio::spawn(forward_bytes(outer.device, client, device, baud));
    }
    Ok(Pty { device: inner.device, path: outer.path, client_side: None })
}

/// Forwards bytes between `outer`, the far side of the client's pty, and `device` until one of them is closed. `baud`
/// is the rate of the device; `client` is read only for the client's present baud rate.
async fn forward_bytes(
    mut outer: SerialStream,
    client: SerialStream,
    mut device: SerialStream,
    baud: u32,
) -> io::Result<()> {
    let (mut out, mut back) = ([0; 256], [0; 256]);
    // The end of a stream appears as zero bytes read, or as an error.
    loop {
        // `read` is cancel safe: a branch that is not taken has moved no byte.
        tokio::select! {
            count = outer.read(&mut out) => match count? {
                0 => return Ok(()),
                count => {
                    let client_baud = client.baud_rate().unwrap_or(baud);
                    device.write_all(&decode_at_baud(&out[..count], client_baud, baud)).await?;
                }
            },
            count = device.read(&mut back) => match count? {
                0 => return Ok(()),
                count => {
                    let client_baud = client.baud_rate().unwrap_or(baud);
                    outer.write_all(&decode_at_baud(&back[..count], baud, client_baud)).await?;
                }
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LineEvent, LinkAddress, open_line_link};
    use tokio::time::{Duration, Instant};

    #[test]
    fn bytes_are_sampled_at_the_baud_rate_of_the_receiver() {
        assert_eq!(decode_at_baud(b"ok\r\n", 9600, 9600), b"ok\r\n");

        // For the slower receiver, a start bit of half its length is a short pulse; for the faster receiver, a bit
        // of the other level has no end.
        assert_eq!(decode_at_baud(&[0xff], 115_200, 57_600), [0; 0]);
        assert_eq!(decode_at_baud(&[0x00], 9_600, 19_200), [0x00]);
        // A receiver four times as fast takes the start bit alone for a start bit and three zeros.
        assert_eq!(decode_at_baud(&[0xff], 9_600, 38_400), [0xf8]);
        assert_ne!(decode_at_baud(b"<Idle|MPos:0.000>", 115_200, 57_600), b"<Idle|MPos:0.000>");
    }

    #[tokio::test]
    async fn bytes_through_the_pty_are_garbled_at_another_baud_rate() {
        let mut pty = create_pty_at_baud(38_400).unwrap();
        let mut buffer = [0; 64];
        for (baud, clear) in [(38_400, true), (115_200, false), (38_400, true)] {
            // The previous link closes its port on a thread of its own.
            let mut link = open_line_link(&LinkAddress::Serial { path: pty.path.clone(), baud }).await.unwrap();
            link.send(b"?\n").unwrap();
            let count = pty.device.read(&mut buffer).await.unwrap();
            assert_eq!(&buffer[..count] == b"?\n", clear, "{baud}");
            pty.device.write_all(b"<Idle|MPos:0.000>\n").await.unwrap();
            let received = link.recv_deadline(Instant::now() + Duration::from_secs(5)).await.unwrap();
            let whole = received == Some(LineEvent::Line("<Idle|MPos:0.000>".to_owned()));
            assert_eq!(whole, clear, "{baud}: {received:?}");
        }
    }
}
