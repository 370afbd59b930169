//! A simulated sensor on CAN. Its frames follow its data sheet, which is implemented here independently of the
//! driver.

use std::sync::{Arc, Weak};
use std::thread;
use std::time::{Duration, Instant};

use super::{OUT_OF_RANGE_STATUS_MASK, SampleSource, distance_mm_and_status_bits};
use crate::SensorOutput;
use link::Clock;
use link::can::{CanError, CanFrame, CanId, CanSender};

/// The data sheet, as keys of `[sensor.can]`.
pub const DATA_SHEET_TOML: &str = r#"
id = 0x181
order = "big"
value = { byte = 2, width = 24, signed = true, scale_mm = 1e-5 }
counter = { byte = 0, width = 16 }
status = [
    { byte = 5, bit = 0, means = "no-echo" },
    { byte = 5, bit = 1, means = "range" },
    { byte = 5, bit = 2, means = "saturated" },
]
length = 6
"#;

const FRAME_ID: u32 = 0x181;
/// Counts per mm: one count is 10 nm.
const COUNTS_PER_MM: f64 = 100_000.0;
/// Largest count of a signed number of 24 bits.
const MAX_DISTANCE_COUNTS: f64 = 8_388_607.0;

/// Counter (2 bytes), distance in 10 nm (3 bytes), status (1 byte); most significant byte first.
fn frame_bytes(count: u16, output: SensorOutput) -> [u8; 6] {
    let (mm, status) = distance_mm_and_status_bits(output);
    let counts = (mm * COUNTS_PER_MM).round();
    let status = if counts.abs() > MAX_DISTANCE_COUNTS { status | OUT_OF_RANGE_STATUS_MASK } else { status };
    let counts = counts.clamp(-MAX_DISTANCE_COUNTS, MAX_DISTANCE_COUNTS) as i32;
    let [high, low] = count.to_be_bytes();
    let [_, first, second, third] = counts.to_be_bytes();
    [high, low, first, second, third, status]
}

/// Returns a generator that gives the next frame at each call.
pub fn frame_generator(
    mut next_sample: SampleSource,
    clock: Arc<dyn Clock>,
) -> impl FnMut() -> Option<CanFrame> + Send {
    let mut count = 0_u16;
    move || {
        let output = next_sample();
        count = count.wrapping_add(1);
        let id = CanId::new(FRAME_ID, false).ok()?;
        Some(CanFrame::new(clock.now_s(), id, &frame_bytes(count, output)))
    }
}

/// Sends `rate_hz` frames per second of wall time on `interface`, as long as the returned value lives. Frames
/// are lost while the interface is down.
///
/// # Errors
/// The interface cannot be opened.
pub fn spawn_frame_sender(
    interface: &str,
    next_sample: SampleSource,
    rate_hz: f64,
    clock: Arc<dyn Clock>,
) -> Result<Arc<()>, CanError> {
    let sender = CanSender::open(interface)?;
    let keep_alive = Arc::new(());
    let weak_keep_alive = Arc::downgrade(&keep_alive);
    let next = frame_generator(next_sample, clock);
    let period = Duration::from_secs_f64(1.0 / rate_hz);
    thread::Builder::new()
        .name("simulated sensor".to_owned())
        .spawn(move || send_frames(&sender, next, period, &weak_keep_alive))
        .map_err(|source| CanError::OpenFailed { interface: interface.to_owned(), source })?;
    Ok(keep_alive)
}

fn send_frames(
    sender: &CanSender,
    mut next: impl FnMut() -> Option<CanFrame>,
    period: Duration,
    weak_keep_alive: &Weak<()>,
) {
    let mut due = Instant::now();
    while weak_keep_alive.strong_count() > 0 {
        due += period;
        thread::sleep(due.saturating_duration_since(Instant::now()));
        let Some(frame) = next() else { return };
        let _ = sender.send(&frame);
    }
}
