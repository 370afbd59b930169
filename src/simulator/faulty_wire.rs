//! A bad wire between two byte streams: delays, drops, doubles, flips, splits, stalls and cuts, drawn from a
//! seed. A test tool that is independent of the device.
//!
//! The faults and their places are a pure function of the seed ([`FaultyWire::schedule`]). Only the number of
//! bytes that a peer sends between two places depends on the host.

use std::io;
use std::iter::Peekable;
use std::time::Duration;

use rand::RngExt;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::time::{Instant, sleep};

use estimation::random::seeded_stream;

/// Exclusive upper limit of the byte index at which a fault begins; in a shorter line it begins at the line's end.
const FAULT_BYTE_INDEX_END: u64 = 40;

/// Direction of the bytes: from the driver to the control, or back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WireDirection {
    ToDevice,
    FromDevice,
}

/// Fault of one direction of the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum WireFault {
    /// Transmission stops for a while; nothing is lost.
    Delay(Duration),
    /// As `Delay`, but twenty times shorter.
    Split(Duration),
    /// One byte is dropped.
    DropByte,
    /// All bytes from here to the end of the line are dropped.
    DropLine,
    /// One byte is sent twice.
    DoubleByte,
    /// The part of the line from here on is sent twice.
    DoubleLine,
    Flip {
        /// Bit of one byte that is inverted; 0 is the least significant.
        bit: u8,
    },
    /// Nothing is transmitted any more in this direction, though the stream stays open; the other direction
    /// continues.
    Stall,
    /// Both directions end, and the streams to and from the control are closed.
    Cut,
}

/// One fault and its place; lines, and bytes in a line, count from 0. In a shorter line the fault occurs at the line
/// end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlannedFault {
    pub direction: WireDirection,
    pub line_index: u64,
    pub byte_index: u64,
    pub fault: WireFault,
}

/// Parameters of a bad wire.
#[derive(Debug, Clone, Copy)]
pub struct FaultyWire {
    pub seed: u64,
    /// Mean of the exponential gap, in lines, between two faults of one direction; each gap also gets one whole line.
    pub mean_exponential_gap_lines: f64,
    /// Upper limit of a `Delay`; a `Split` lasts at most a twentieth of it.
    pub max_delay: Duration,
}

impl FaultyWire {
    /// A few faults in a run of sixty touches; some delays exceed every timeout.
    pub fn with_few_faults(seed: u64) -> Self {
        Self { seed, mean_exponential_gap_lines: 300.0, max_delay: Duration::from_secs(4) }
    }

    /// All faults of one direction, in order; the iterator is infinite.
    pub fn schedule(&self, direction: WireDirection) -> impl Iterator<Item = PlannedFault> + use<> {
        let wire = *self;
        let mut line: u64 = 0;
        (0..).map(move |count: u64| {
            let mut draw = seeded_stream(wire.seed, &[direction as u64, count]);
            // Exponential gaps: faults are random events, and neighbouring lines may both have one.
            let gap = -(1.0 - draw.random::<f64>()).ln() * wire.mean_exponential_gap_lines;
            line = u64::saturating_add(line, 1).saturating_add(gap as u64);
            let byte = draw.random_range(0..FAULT_BYTE_INDEX_END);
            let pause = wire.max_delay.mul_f64(draw.random::<f64>());
            let fault = match draw.random_range(0..17) {
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
            PlannedFault { direction, line_index: line, byte_index: byte, fault }
        })
    }

    /// Joins `driver` (the driver's side) to `device` until one of them ends or the wire is cut. `on_fault` is called
    /// with every fault as it occurs, and the time since the beginning.
    ///
    /// # Errors
    /// One of the streams fails.
    pub async fn connect(
        &self,
        driver: impl AsyncRead + AsyncWrite,
        device: impl AsyncRead + AsyncWrite,
        on_fault: &(dyn Fn(Duration, PlannedFault) + Sync),
    ) -> io::Result<()> {
        let start = Instant::now();
        let on_fault = &|planned_fault| on_fault(start.elapsed(), planned_fault);
        let (driver_reader, driver_writer) = tokio::io::split(driver);
        let (device_reader, device_writer) = tokio::io::split(device);
        let to_device = WireHalf::new(self.schedule(WireDirection::ToDevice), on_fault);
        let from_device = WireHalf::new(self.schedule(WireDirection::FromDevice), on_fault);
        // When one direction ends, the other one ends too: no peer would read its output.
        tokio::select! {
            result = to_device.forward(driver_reader, device_writer) => result,
            result = from_device.forward(device_reader, driver_writer) => result,
        }
    }
}

/// One direction of the wire.
struct WireHalf<'t, P: Iterator<Item = PlannedFault>> {
    schedule: Peekable<P>,
    on_fault: &'t (dyn Fn(PlannedFault) + Sync),
    /// Line of the next byte, from 0.
    line_index: u64,
    /// Index of the next byte in its line, from 0.
    byte_index: u64,
    /// Whether the rest of this line is dropped.
    is_dropping_line: bool,
    /// Rest of the line that is being sent twice.
    line_copy: Option<Vec<u8>>,
}

impl<'t, P: Iterator<Item = PlannedFault>> WireHalf<'t, P> {
    fn new(schedule: P, on_fault: &'t (dyn Fn(PlannedFault) + Sync)) -> Self {
        Self {
            schedule: schedule.peekable(),
            on_fault,
            line_index: 0,
            byte_index: 0,
            is_dropping_line: false,
            line_copy: None,
        }
    }

    /// Forwards bytes until `from` ends or a cut; after a stall it only reads until `from` ends.
    async fn forward(mut self, mut from: impl AsyncRead + Unpin, mut to: impl AsyncWrite + Unpin) -> io::Result<()> {
        let mut buffer = [0; 256];
        loop {
            let count = from.read(&mut buffer).await?;
            if count == 0 {
                return Ok(());
            }
            let mut out = Vec::new();
            for byte in &buffer[..count] {
                let fault = self.next_due_fault(*byte);
                match fault {
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
                self.forward_byte(*byte, fault, &mut out);
            }
            to.write_all(&out).await?;
        }
    }

    /// Fault that occurs at this byte, at most one; it is reported to `on_fault`.
    fn next_due_fault(&mut self, byte: u8) -> Option<WireFault> {
        let is_line_end = byte == b'\n';
        let (line, byte_index) = (self.line_index, self.byte_index);
        let is_due = |planned_fault: &PlannedFault| {
            planned_fault.line_index < line
                || planned_fault.line_index == line && (planned_fault.byte_index <= byte_index || is_line_end)
        };
        let planned_fault = self.schedule.next_if(is_due)?;
        (self.on_fault)(planned_fault);
        Some(planned_fault.fault)
    }

    fn forward_byte(&mut self, byte: u8, fault: Option<WireFault>, out: &mut Vec<u8>) {
        match fault {
            Some(WireFault::DropLine) => self.is_dropping_line = true,
            Some(WireFault::DoubleLine) => self.line_copy = Some(Vec::new()),
            _ => {}
        }
        let forwarded = if let Some(WireFault::Flip { bit }) = fault { byte ^ (1 << bit) } else { byte };
        if fault != Some(WireFault::DropByte) && !self.is_dropping_line {
            out.push(forwarded);
            if fault == Some(WireFault::DoubleByte) {
                out.push(forwarded);
            }
            if let Some(line_copy) = &mut self.line_copy {
                line_copy.push(forwarded);
            }
        }
        self.byte_index += 1;
        if byte == b'\n' {
            (self.line_index, self.byte_index, self.is_dropping_line) = (self.line_index + 1, 0, false);
            out.extend(self.line_copy.take().unwrap_or_default());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wire(seed: u64) -> FaultyWire {
        FaultyWire { seed, mean_exponential_gap_lines: 5.0, max_delay: Duration::from_millis(1) }
    }

    /// `text` after one fault.
    fn faulty_text(text: &str, line: u64, byte: u64, fault: WireFault) -> String {
        let direction = WireDirection::ToDevice;
        let on_fault = |_| {};
        let planned_fault = [PlannedFault { direction, line_index: line, byte_index: byte, fault }];
        let side = WireHalf::new(planned_fault.into_iter(), &on_fault);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        let mut out = Vec::new();
        runtime.block_on(side.forward(text.as_bytes(), &mut out)).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn each_wire_fault_has_its_effect() {
        let text = "G0 X1\nG1 Y2\nok\n";
        let byte_index = |fault| faulty_text(text, 1, 3, fault);
        assert_eq!(byte_index(WireFault::DropByte), "G0 X1\nG1 2\nok\n");
        assert_eq!(byte_index(WireFault::DoubleByte), "G0 X1\nG1 YY2\nok\n");
        assert_eq!(byte_index(WireFault::Flip { bit: 0 }), "G0 X1\nG1 X2\nok\n");
        assert_eq!(byte_index(WireFault::DropLine), "G0 X1\nG1 ok\n");
        assert_eq!(byte_index(WireFault::DoubleLine), "G0 X1\nG1 Y2\nY2\nok\n");
        assert_eq!(byte_index(WireFault::Cut), "G0 X1\nG1 ");
        assert_eq!(byte_index(WireFault::Stall), "G0 X1\nG1 ");
        assert_eq!(byte_index(WireFault::Delay(Duration::ZERO)), text);
        assert_eq!(byte_index(WireFault::Split(Duration::ZERO)), text);
        // In a line that is too short the fault is at its end.
        assert_eq!(faulty_text(text, 0, 30, WireFault::DropByte), "G0 X1G1 Y2\nok\n");
    }

    #[test]
    fn wire_faults_follow_the_seed_and_include_every_kind() {
        let drawn = |seed, direction| wire(seed).schedule(direction).take(2000);
        let to = || drawn(1, WireDirection::ToDevice);
        assert!(to().eq(drawn(1, WireDirection::ToDevice)));
        assert!(!to().eq(drawn(2, WireDirection::ToDevice)));
        assert!(to().is_sorted_by_key(|planned_fault| planned_fault.line_index));
        // Gaps of 1 + floor(e): 1 + 1/(exp(1/5) - 1) = 5.52 lines on average.
        let last = to().last().unwrap().line_index as f64 / 2000.0;
        assert!((last - 5.52).abs() < 0.4, "{last}");
        let mut kinds: Vec<String> = to()
            .map(|planned_fault| {
                let name = format!("{:?}", planned_fault.fault);
                name.split(|c: char| !c.is_alphanumeric()).next().unwrap().to_owned()
            })
            .collect();
        kinds.sort();
        kinds.dedup();
        assert_eq!(kinds.len(), 9, "{kinds:?}");
    }
}
