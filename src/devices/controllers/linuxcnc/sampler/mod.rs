//! Client of LinuxCNC's HAL component `sampler`, which records the positions of the axes in each period of
//! the servo thread; `halsampler -t` on that computer writes them to its TCP client. A task reads the
//! positions all the time; they are kept while a block runs that needs them. `docs/linuxcnc-sampler.md`
//! describes the set-up.

#[cfg(test)]
mod tests;
mod tick_clock;
mod tick_record;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde::Deserialize;
use tokio::time::{Instant, sleep};

use self::tick_record::{TickPositions, TickRecord};
use crate::controllers::ControllerError;
use link::Clock;
use link::{ByteStreamHandle, HostPort, LinkAddress, StreamRead};
use machine::record::axis_track::AxisTrack;
use machine::{Axis, Position};

/// Time for which the stream is observed before anything moves, to check its period.
const PERIOD_CHECK_TIME: Duration = Duration::from_millis(1300);
/// Time in which the positions arrive that were buffered before the connection.
const BUFFER_DRAIN_TIME: Duration = Duration::from_millis(100);
/// Maximum time that a tick may take to arrive: a pipe may hold 4096 bytes, and a network delays by up to a
/// second.
const MAX_TICK_DELAY: Duration = Duration::from_secs(3);
const POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Interval at which the task checks whether its handle still exists.
const HANDLE_CHECK_INTERVAL: Duration = Duration::from_secs(1);
/// Maximum difference between the positions of a linear axis that sampler and control report, mm: axes under control
/// are never quite at rest.
const MAX_POSITION_DIFFERENCE_MM: f64 = 0.01;
/// As [`MAX_POSITION_DIFFERENCE_MM`], for a rotary axis, rad.
const MAX_POSITION_DIFFERENCE_RAD: f64 = 0.001;
const SETUP_GUIDE: &str = "see the halcmd lines in docs/linuxcnc-sampler.md";

/// Keys of `[controller.sampler]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "SamplerKeys")]
pub struct SamplerConfig {
    tcp: HostPort,
    /// Stated period of the servo thread, s.
    period_s: f64,
    /// In the order of the sampler's pins; `None`: the machine's axes in the order X Y Z A B C.
    axes: Option<Vec<Axis>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SamplerKeys {
    /// Address at which the output of `halsampler -t` can be read.
    tcp: HostPort,
    /// Period of the servo thread, s.
    #[serde(default = "default_period_s")]
    period_s: f64,
    /// Axes in the order of the sampler's pins; if absent, the machine's axes in the order X Y Z A B C.
    axes: Option<Vec<Axis>>,
}

fn default_period_s() -> f64 {
    0.001
}

impl TryFrom<SamplerKeys> for SamplerConfig {
    type Error = String;

    fn try_from(SamplerKeys { tcp, period_s, axes }: SamplerKeys) -> Result<Self, String> {
        if !(1e-5..=0.1).contains(&period_s) {
            return Err(format!("`period_s` is {period_s}; it must be the servo thread's period, 0.00001 to 0.1 s"));
        }
        let is_repeated =
            |axes: &Vec<Axis>| axes.iter().enumerate().any(|(i, axis)| *axis == Axis::S || axes[..i].contains(axis));
        if axes.as_ref().is_some_and(is_repeated) {
            return Err("`axes` must name each axis once, in the order of the sampler's pins, without S".to_owned());
        }
        Ok(Self { tcp, period_s, axes })
    }
}

/// Connection to LinuxCNC's `sampler`. A task reads its stream until this handle is dropped.
pub struct SamplerClient {
    name: String,
    period_s: f64,
    clock: Arc<dyn Clock>,
    shared_state: Arc<Mutex<SamplerState>>,
    /// The control's unit of length, mm, once it is known.
    mm_per_unit: f64,
}

struct SamplerState {
    record: TickRecord,
    /// Reason why no more positions will come.
    connection_lost_reason: Option<String>,
}

impl SamplerClient {
    /// Connects to the address of `config`; `axes` are the machine's axes. Call inside a tokio runtime.
    ///
    /// # Errors
    /// Nothing listens at the address.
    pub async fn open(config: &SamplerConfig, axes: &[Axis], clock: Arc<dyn Clock>) -> Result<Self, ControllerError> {
        let machine_axes = || axes.iter().copied().filter(|axis| *axis != Axis::S).collect();
        let axes = config.axes.clone().unwrap_or_else(machine_axes);
        let address = LinkAddress::from(&config.tcp);
        let name = format!("the sampler at {address}");
        let stream = link::open_byte_stream(&address).await.map_err(|error| {
            let state = format!("{name} is not reachable: {error}");
            ControllerError::not_ready(&state, format!("start the sampler together with LinuxCNC: {SETUP_GUIDE}"))
        })?;
        let state = SamplerState { record: TickRecord::new(axes, config.period_s), connection_lost_reason: None };
        let shared_state = Arc::new(Mutex::new(state));
        tokio::spawn(read_stream(stream, Arc::downgrade(&shared_state), clock.clone()));
        Ok(Self { name, period_s: config.period_s, clock, shared_state, mm_per_unit: 1.0 })
    }

    /// Describes the sampler in words.
    pub(super) fn describe(&self) -> String {
        format!("positions with time stamps every {} ms from {}", self.period_s * 1e3, self.name)
    }

    fn lock_state(&self) -> MutexGuard<'_, SamplerState> {
        self.shared_state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Checks that the sampler is running, has the configured period and agrees with the control, whose
    /// axes are at `position`; `mm_per_unit` is the control's unit of length, mm.
    pub(super) async fn check_agreement_with_control(
        &mut self,
        position: &Position,
        axes: &[Axis],
        mm_per_unit: f64,
    ) -> Result<(), ControllerError> {
        self.mm_per_unit = mm_per_unit;
        let required_axes = axes.iter().filter(|axis| **axis != Axis::S);
        if let Some(axis) = required_axes.into_iter().find(|a| !self.lock_state().record.axes().contains(a)) {
            return Err(ControllerError::not_ready(
                format!("{} does not record axis {axis}", self.name),
                "add the axis to [controller.sampler] axes, and connect it to a pin of the sampler",
            ));
        }
        let silent = |name: &str, reason: String| {
            ControllerError::not_ready(
                format!("{name}: {reason}"),
                format!("check that the sampler runs: {SETUP_GUIDE}"),
            )
        };
        // Positions buffered before the connection arrive at once.
        self.wait_for_tick_after(f64::NEG_INFINITY).await.map_err(|reason| silent(&self.name, reason))?;
        sleep(BUFFER_DRAIN_TIME).await;
        let before = self.lock_state().record.newest_positions.as_ref().map(|position| position.tick);
        sleep(PERIOD_CHECK_TIME).await;
        let now_s = self.clock.now_s();
        let newest = self.wait_for_tick_after(now_s).await.map_err(|reason| silent(&self.name, reason))?;
        let period_s = before.and_then(|tick| self.lock_state().record.tick_clock.true_period_s_if_different(tick));
        if let Some(period_s) = period_s {
            return Err(ControllerError::not_ready(
                format!("{} counts one tick every {:.3} ms", self.name, period_s * 1e3),
                "set [controller.sampler] period_s to the servo thread's period (`halcmd show thread`)",
            ));
        }
        let difference = self.describe_position_difference(&newest, position);
        difference.map_or(Ok(()), |difference| Err(ControllerError::not_ready(&difference, pin_remedy())))
    }

    /// Starts to keep the positions that arrive.
    pub(super) fn start_recording(&self) {
        self.lock_state().record.start_recording();
    }

    /// Ends the recording and returns all positions since [`Self::start_recording`]; the machine has come to rest
    /// at `position` after `step`.
    ///
    /// # Errors
    /// The sampler is silent or disagrees with `position`, or the block was too long for the memory.
    pub(super) async fn finish_recording(&self, step: u32, position: &Position) -> Result<AxisTrack, ControllerError> {
        let unstamped = |reason, remedy| ControllerError::MissingPositionTrack { step, reason, remedy };
        let newest = self.wait_for_tick_after(self.clock.now_s()).await.map_err(|reason| {
            unstamped(format!("{}: {reason}", self.name), format!("check that the sampler runs: {SETUP_GUIDE}"))
        })?;
        let track = self.lock_state().record.finish_recording(self.mm_per_unit);
        if let Some(difference) = self.describe_position_difference(&newest, position) {
            return Err(unstamped(difference, pin_remedy()));
        }
        track.ok_or_else(|| {
            unstamped(
                "the scan was too long for the position memory".to_owned(),
                "make the scan shorter or faster: at 1 kHz the memory holds a quarter of an hour".to_owned(),
            )
        })
    }

    /// Discards the kept positions.
    pub(super) fn discard_recording(&self) {
        self.lock_state().record.finish_recording(self.mm_per_unit);
    }

    /// Waits for a tick later than `t_s` on the host clock; the error is the reason why none comes.
    async fn wait_for_tick_after(&self, t_s: f64) -> Result<TickPositions, String> {
        let end = Instant::now() + MAX_TICK_DELAY;
        loop {
            {
                let state = self.lock_state();
                if let Some(reason) = &state.connection_lost_reason {
                    return Err(format!("the connection is lost: {reason}"));
                }
                let newest = state.record.newest_positions.as_ref();
                let was = newest.and_then(|newest| state.record.tick_clock.time_s(newest.tick));
                if let Some(newest) = newest.filter(|_| was.is_some_and(|was| was > t_s)) {
                    return Ok(newest.clone());
                }
                if Instant::now() > end {
                    return Err(match &state.record.last_invalid_line {
                        Some(line) if newest.is_none() => format!(
                            "received `{line}` instead of a number, {} positions and a bit",
                            state.record.axes().len()
                        ),
                        _ => format!("no new line for {} s", MAX_TICK_DELAY.as_secs()),
                    });
                }
            }
            sleep(POLL_INTERVAL).await;
        }
    }

    /// Describes the first axis whose position differs between sampler and control; `None` if all agree.
    fn describe_position_difference(&self, newest: &TickPositions, position: &Position) -> Option<String> {
        let state = self.lock_state();
        let value: Vec<f64> = state.record.to_internal_units(&newest.positions, self.mm_per_unit).collect();
        let mut axes = state.record.axes().iter().zip(value);
        let is_different = |axis: Axis, value: f64| {
            let tolerance = if axis.is_linear() { MAX_POSITION_DIFFERENCE_MM } else { MAX_POSITION_DIFFERENCE_RAD };
            position.get(axis).is_some_and(|position| (position - value).abs() > tolerance)
        };
        let (axis, value) = axes.find(|(axis, value)| is_different(**axis, *value))?;
        let (at, value) = (axis.to_mm_or_deg(position.get_or_zero(*axis)), axis.to_mm_or_deg(value));
        Some(format!("{axis} is at {at:.3}, but {} reports {value:.3}", self.name))
    }
}

fn pin_remedy() -> String {
    format!(
        "connect the pins of the sampler to joint.N.pos-fb, one for each axis of [controller.sampler] axes, in that \
         order: {SETUP_GUIDE}"
    )
}

/// Task: reads the stream until the handle is dropped or the stream ends.
async fn read_stream(
    mut stream: ByteStreamHandle,
    shared_state: std::sync::Weak<Mutex<SamplerState>>,
    clock: Arc<dyn Clock>,
) {
    loop {
        let read = stream.recv_deadline(Instant::now() + HANDLE_CHECK_INTERVAL).await;
        let Some(shared_state) = shared_state.upgrade() else { return };
        let mut state = shared_state.lock().unwrap_or_else(PoisonError::into_inner);
        match read {
            Ok(None) => {}
            Ok(Some(StreamRead::Bytes(at, bytes))) => {
                let at_s = clock.now_s() - at.elapsed().as_secs_f64();
                state.record.push_bytes(&bytes, at_s);
            }
            Ok(Some(StreamRead::Overflow)) => state.record.discard_partial_line(),
            Err(error) => {
                state.connection_lost_reason = Some(error.to_string());
                return;
            }
        }
    }
}
