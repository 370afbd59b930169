//! A serial line between two sides whose speeds differ. A pseudo-terminal carries every byte whatever the
//! speed, but it keeps the speed that its client has set: from both speeds follows what each side would
//! hear on a real line. A tool to test with; it knows no device.

use std::io;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio_serial::{SerialPort, SerialStream};

use super::{LinkError, Pty, pty};

/// Start bit, eight data bits, stop bit.
const BITS: u64 = 10;
const DATA: u64 = 8;
/// What a system makes of a character without its stop bit (termios: neither IGNPAR nor PARMRK).
const UNFRAMED: u8 = 0;

/// What a receiver at `heard` baud makes of `bytes`, sent one right after the other at `sent` baud. It
/// waits for the line to fall and looks at the middle of each of its own bits.
pub fn heard(bytes: &[u8], sent: u32, heard: u32) -> Vec<u8> {
    if sent == heard || sent == 0 || heard == 0 {
        return bytes.to_vec();
    }
    // Time is counted so that half a bit of either side is a whole number.
    let (bit, half) = (2 * u64::from(heard), u64::from(sent));
    let level = |time: u64| level(bytes, time / bit);
    let end = BITS * bytes.len() as u64;
    let mut received = Vec::new();
    let mut place = 0;
    while let Some(fall) = (place..end).find(|place| !self::level(bytes, *place)) {
        let start = fall * bit;
        let sample = |k: u64| level(start + (2 * k + 1) * half);
        let byte = (0..DATA).fold(0, |byte, k| byte | u8::from(sample(k + 1)) << k);
        let framed = sample(DATA + 1);
        let over = start + (2 * (DATA + 1) + 1) * half;
        if sample(0) {
            // A flicker shorter than half a bit is no start.
            place = fall + 1;
            continue;
        }
        received.push(if framed { byte } else { UNFRAMED });
        let rest = over / bit;
        // The next character begins with a fall: the line has to be high before.
        place = (rest..end).find(|place| self::level(bytes, *place)).unwrap_or(end);
    }
    received
}

/// The line during bit `place` of `bytes`; high when nothing is sent.
fn level(bytes: &[u8], place: u64) -> bool {
    let byte = usize::try_from(place / BITS).ok().and_then(|at| bytes.get(at));
    match (byte, place % BITS) {
        (None, _) => true,
        (Some(_), 0) => false,
        (Some(byte), bit) if bit <= DATA => byte >> (bit - 1) & 1 == 1,
        (Some(_), _) => true,
    }
}

/// A pty for a simulated device that speaks at `baud`: who opens it at another speed hears, and is
/// heard, as on a real line. Call inside a tokio runtime.
///
/// # Errors
/// What making it says.
pub fn pty_at(baud: u32) -> Result<Pty, LinkError> {
    let (outer, inner) = (pty()?, pty()?);
    if let (Some(client), Some(device)) = (outer.client_side, inner.client_side) {
        tokio::spawn(carry(outer.device, client, device, baud));
    }
    Ok(Pty { device: inner.device, path: outer.path, client_side: None })
}

/// Until the device or the pty is gone. `client` is asked for the speed that is set.
async fn carry(
    mut outer: SerialStream,
    client: SerialStream,
    mut device: SerialStream,
    baud: u32,
) -> io::Result<()> {
    let (mut out, mut back) = ([0; 256], [0; 256]);
    // What ends is told as nothing read, or as an error.
    loop {
        // `read` is cancel safe: a branch not taken has moved no byte.
        tokio::select! {
            count = outer.read(&mut out) => match count? {
                0 => return Ok(()),
                count => {
                    let speed = client.baud_rate().unwrap_or(baud);
                    device.write_all(&heard(&out[..count], speed, baud)).await?;
                }
            },
            count = device.read(&mut back) => match count? {
                0 => return Ok(()),
                count => {
                    let speed = client.baud_rate().unwrap_or(baud);
                    outer.write_all(&heard(&back[..count], baud, speed)).await?;
                }
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Address, Received, open};
    use tokio::time::{Duration, Instant};

    #[test]
    fn bytes_at_another_speed_are_what_a_receiver_samples() {
        assert_eq!(heard(b"ok\r\n", 9600, 9600), b"ok\r\n");

        // A start bit of half its length is a flicker to the slower one; one of the other level all along
        // never ends for the faster one.
        assert_eq!(heard(&[0xff], 115_200, 57_600), [0; 0]);
        assert_eq!(heard(&[0x00], 9_600, 19_200), [0x00]);
        // The start bit alone is seen as a start bit and three zeros by a receiver four times as fast.
        assert_eq!(heard(&[0xff], 9_600, 38_400), [0xf8]);
        assert_ne!(heard(b"<Idle|MPos:0.000>", 115_200, 57_600), b"<Idle|MPos:0.000>");
    }

    #[tokio::test]
    async fn a_pty_tells_the_speed_that_its_client_has_set() {
        let mut pty = pty_at(38_400).unwrap();
        let mut buffer = [0; 64];
        for (baud, clear) in [(38_400, true), (115_200, false), (38_400, true)] {
            // The last one closes its port on a thread of its own.
            let mut link = open(&Address::Serial { path: pty.path.clone(), baud }).await.unwrap();
            link.send(b"?\n").unwrap();
            let count = pty.device.read(&mut buffer).await.unwrap();
            assert_eq!(&buffer[..count] == b"?\n", clear, "{baud}");
            pty.device.write_all(b"<Idle|MPos:0.000>\n").await.unwrap();
            let said = link.recv_deadline(Instant::now() + Duration::from_secs(5)).await.unwrap();
            let whole = said == Some(Received::Line("<Idle|MPos:0.000>".to_owned()));
            assert_eq!(whole, clear, "{baud}: {said:?}");
        }
    }
}
