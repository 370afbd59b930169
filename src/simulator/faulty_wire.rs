//! A bad wire between two byte streams: delays, drops, doubles, flips, splits, stalls and cuts, drawn from a
//! seed. A test tool that is independent of the device.
//!
//! The faults and their places are a pure function of the seed ([`BadWire::schedule`]). Only the number of
//! bytes that a peer sends between two places depends on the host.

use std::io;
use std::iter::Peekable;
use std::time::Duration;

use rand::RngExt;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::time::{Instant, sleep};

use estimation::random::stream;

/// Last byte of a line at which a fault may begin; in a shorter line the fault is at the line's end.
const MAX_FAULT_BYTE: u64 = 40;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    ToDevice,
    FromDevice,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum WireFault {
    /// Transmission stops for a while; nothing is lost.
    Delay(Duration),
    /// As `Delay`, but short and in the middle of a line.
    Split(Duration),
    DropByte,
    /// All bytes from here to the end of the line are dropped.
    DropLine,
    DoubleByte,
    /// The part of the line from here on is sent twice.
    DoubleLine,
    Flip {
        bit: u8,
    },
    /// Nothing is transmitted any more, though the stream stays open.
    Stall,
    /// Both streams are closed.
    Cut,
}

/// One fault and its place; lines, and bytes in a line, count from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Planned {
    pub direction: Direction,
    pub line: u64,
    pub byte: u64,
    pub harm: WireFault,
}

/// Parameters of a bad wire.
#[derive(Debug, Clone, Copy)]
pub struct BadWire {
    pub seed: u64,
    /// Mean number of lines between two faults in each direction.
    pub spacing: f64,
    pub longest_delay: Duration,
}

impl BadWire {
    /// A few faults in a run of sixty touches; some delays exceed every timeout.
    pub fn to_rehearse(seed: u64) -> Self {
        Self { seed, spacing: 300.0, longest_delay: Duration::from_secs(4) }
    }

    /// All faults of one direction, in order; the iterator is infinite.
    pub fn schedule(&self, direction: Direction) -> impl Iterator<Item = Planned> + use<> {
        let wire = *self;
        let mut line: u64 = 0;
        (0..).map(move |count: u64| {
            let mut draw = stream(wire.seed, &[direction as u64, count]);
            // Exponential gaps: faults are random events, and neighbouring lines may both have one.
            let gap = -(1.0 - draw.random::<f64>()).ln() * wire.spacing;
            line = u64::saturating_add(line, 1).saturating_add(gap as u64);
            let byte = draw.random_range(0..MAX_FAULT_BYTE);
            let pause = wire.longest_delay.mul_f64(draw.random::<f64>());
            let harm = match draw.random_range(0..17) {
                0 | 1 => WireFault::Delay(pause),
                2 | 3 => WireFault::Split(pause / 20),
                4 | 5 => WireFault::DropByte,
                6 | 7 => WireFault::DropLine,
                8 | 9 => WireFault::DoubleByte,
                10 | 11 => WireFault::DoubleLine,
                12..15 => WireFault::Flip { bit: draw.random_range(0..8) },
                15 => WireFault::Stall,
                _ => WireFault::Cut,
            };
            Planned { direction, line, byte, harm }
        })
    }

    /// Joins `near` (the driver's side) to `device` until one of them ends or the wire is cut. `tell` is called
    /// with every fault as it occurs, and the time since the beginning.
    ///
    /// # Errors
    /// One of the streams fails.
    pub async fn join(
        &self,
        near: impl AsyncRead + AsyncWrite,
        device: impl AsyncRead + AsyncWrite,
        tell: &(dyn Fn(Duration, Planned) + Sync),
    ) -> io::Result<()> {
        let begun = Instant::now();
        let tell = &|planned| tell(begun.elapsed(), planned);
        let (near_out, near_in) = tokio::io::split(near);
        let (device_out, device_in) = tokio::io::split(device);
        let to_device = Side::new(self.schedule(Direction::ToDevice), tell);
        let from_device = Side::new(self.schedule(Direction::FromDevice), tell);
        // The end of one direction ends the other: nothing reads what it would still transmit.
        tokio::select! {
            ended = to_device.carry(near_out, device_in) => ended,
            ended = from_device.carry(device_out, near_in) => ended,
        }
    }
}

/// One direction of the wire.
struct Side<'t, P: Iterator<Item = Planned>> {
    planned: Peekable<P>,
    tell: &'t (dyn Fn(Planned) + Sync),
    line: u64,
    byte: u64,
    /// Whether the rest of this line is dropped.
    dropping: bool,
    /// The rest of this line, which is sent twice.
    copy: Option<Vec<u8>>,
}

impl<'t, P: Iterator<Item = Planned>> Side<'t, P> {
    fn new(planned: P, tell: &'t (dyn Fn(Planned) + Sync)) -> Self {
        Self { planned: planned.peekable(), tell, line: 0, byte: 0, dropping: false, copy: None }
    }

    async fn carry(
        mut self,
        mut from: impl AsyncRead + Unpin,
        mut to: impl AsyncWrite + Unpin,
    ) -> io::Result<()> {
        let mut buffer = [0; 256];
        loop {
            let count = from.read(&mut buffer).await?;
            if count == 0 {
                return Ok(());
            }
            let mut out = Vec::new();
            for byte in &buffer[..count] {
                let harm = self.due(*byte);
                match harm {
                    Some(WireFault::Delay(pause) | WireFault::Split(pause)) => {
                        to.write_all(&std::mem::take(&mut out)).await?;
                        sleep(pause).await;
                    }
                    Some(WireFault::Cut) => return to.write_all(&out).await,
                    Some(WireFault::Stall) => {
                        to.write_all(&out).await?;
                        tokio::io::copy(&mut from, &mut tokio::io::sink()).await?;
                        return Ok(());
                    }
                    _ => {}
                }
                self.pass(*byte, harm, &mut out);
            }
            to.write_all(&out).await?;
        }
    }

    /// Fault that occurs at this byte.
    fn due(&mut self, byte: u8) -> Option<WireFault> {
        let ends = byte == b'\n';
        let (line, at) = (self.line, self.byte);
        let is_due = |planned: &Planned| {
            planned.line < line || planned.line == line && (planned.byte <= at || ends)
        };
        let planned = self.planned.next_if(is_due)?;
        (self.tell)(planned);
        Some(planned.harm)
    }

    fn pass(&mut self, byte: u8, harm: Option<WireFault>, out: &mut Vec<u8>) {
        match harm {
            Some(WireFault::DropLine) => self.dropping = true,
            Some(WireFault::DoubleLine) => self.copy = Some(Vec::new()),
            _ => {}
        }
        let passed =
            if let Some(WireFault::Flip { bit }) = harm { byte ^ (1 << bit) } else { byte };
        if harm != Some(WireFault::DropByte) && !self.dropping {
            out.push(passed);
            if harm == Some(WireFault::DoubleByte) {
                out.push(passed);
            }
            if let Some(copy) = &mut self.copy {
                copy.push(passed);
            }
        }
        self.byte += 1;
        if byte == b'\n' {
            (self.line, self.byte, self.dropping) = (self.line + 1, 0, false);
            out.extend(self.copy.take().unwrap_or_default());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wire(seed: u64) -> BadWire {
        BadWire { seed, spacing: 5.0, longest_delay: Duration::from_millis(1) }
    }

    /// `text` after one fault.
    fn harmed(text: &str, line: u64, byte: u64, harm: WireFault) -> String {
        let direction = Direction::ToDevice;
        let told = |_| {};
        let planned = [Planned { direction, line, byte, harm }];
        let side = Side::new(planned.into_iter(), &told);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        let mut out = Vec::new();
        runtime.block_on(side.carry(text.as_bytes(), &mut out)).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn each_harm_does_what_its_name_says() {
        let text = "G0 X1\nG1 Y2\nok\n";
        let at = |harm| harmed(text, 1, 3, harm);
        assert_eq!(at(WireFault::DropByte), "G0 X1\nG1 2\nok\n");
        assert_eq!(at(WireFault::DoubleByte), "G0 X1\nG1 YY2\nok\n");
        assert_eq!(at(WireFault::Flip { bit: 0 }), "G0 X1\nG1 X2\nok\n");
        assert_eq!(at(WireFault::DropLine), "G0 X1\nG1 ok\n");
        assert_eq!(at(WireFault::DoubleLine), "G0 X1\nG1 Y2\nY2\nok\n");
        assert_eq!(at(WireFault::Cut), "G0 X1\nG1 ");
        assert_eq!(at(WireFault::Stall), "G0 X1\nG1 ");
        assert_eq!(at(WireFault::Delay(Duration::ZERO)), text);
        assert_eq!(at(WireFault::Split(Duration::ZERO)), text);
        // In a line that is too short the fault is at its end.
        assert_eq!(harmed(text, 0, 30, WireFault::DropByte), "G0 X1G1 Y2\nok\n");
    }

    #[test]
    fn the_schedule_is_the_seed_s_and_holds_every_harm() {
        let drawn = |seed, direction| wire(seed).schedule(direction).take(2000);
        let to = || drawn(1, Direction::ToDevice);
        assert!(to().eq(drawn(1, Direction::ToDevice)));
        assert!(!to().eq(drawn(2, Direction::ToDevice)));
        assert!(to().is_sorted_by_key(|planned| planned.line));
        // Gaps of 1 + floor(e): 1 + 1/(exp(1/5) - 1) = 5.52 lines on average.
        let last = to().last().unwrap().line as f64 / 2000.0;
        assert!((last - 5.52).abs() < 0.4, "{last}");
        let mut kinds: Vec<String> = to()
            .map(|planned| {
                let name = format!("{:?}", planned.harm);
                name.split(|c: char| !c.is_alphanumeric()).next().unwrap().to_owned()
            })
            .collect();
        kinds.sort();
        kinds.dedup();
        assert_eq!(kinds.len(), 9, "{kinds:?}");
    }
}
