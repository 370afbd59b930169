//! Interface to displacement sensors, and to the thermometers used with them. A driver delivers samples one
//! after the other, as they arrive. Its task owns the link, and none of its futures is dropped before it
//! completes.
//!
//! A sample that cannot be trusted is flagged and has no value: nothing is interpolated, and a missing
//! value is never reported as zero.

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, oneshot};

use link::{Clock, SensorRequestCapture, SharedPorts};
use machine::record::reading::ReadingFlag;
use machine::record::sensor;

mod bit_field;
pub mod can;
mod capture_format;
mod counter_tracker;
mod encoder_count;
mod error;
mod frame_layout;
#[cfg(test)]
mod frame_layout_tests;
pub mod modbus;
mod sample_counters;
mod sample_layout;
pub mod serial;
mod shared_port;
#[cfg(test)]
mod tests;
pub mod thermometer;

pub use error::SensorError;
pub use sample_counters::SampleCounters;
pub use shared_port::SharedPort;

/// Configuration of a sensor, from one of the tables of `[[sensor]]`. Each kind of sensor defines the keys
/// of its own table.
pub trait SensorConfig: fmt::Debug + Send + Sync {
    /// Describes the address of the sensor for the operator.
    fn describe_address(&self) -> String;
    /// Port that the sensor may share with other sensors; `None` if it shares none.
    fn shared_port(&self) -> Option<SharedPort> {
        None
    }
    /// Number of counts after which the rotary encoder's count restarts; `None` if the samples have no such
    /// count.
    fn encoder_modulus(&self) -> Option<u64> {
        None
    }
    /// Opens the sensor's link, or shares one of `ports`, and starts its task. Its samples have the time of
    /// `clock`. Call inside a tokio runtime.
    fn open_sensor<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        clock: Arc<dyn Clock>,
        ports: &'a SharedPorts,
    ) -> OpenSensorFuture<'a>;
}

/// Result of `SensorConfig::open_sensor`.
pub type OpenSensorFuture<'a> = Pin<Box<dyn Future<Output = Result<SensorHandle, SensorError>> + Send + 'a>>;

/// One sample of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Monotonic time of reception, s: the kernel's timestamp if there is one.
    pub received_s: f64,
    /// Distance from the sensor's zero point, mm; `None` if `flag` marks the sample as invalid.
    pub value_mm: Option<f64>,
    /// `None`: valid; `Range`: out of range or no echo; `Saturated`: too much light; `Stale`: no sample came, or an
    /// old one; `Gap`: the value is valid, but samples before it are missing.
    pub flag: ReadingFlag,
    /// Number of samples lost directly before this one, by the sensor's counter; 0 without a counter, or for a Modbus
    /// sensor without `counter.gaps`.
    pub lost_before_count: u32,
    /// Count of the rotary encoder at this sample, if the sensor sends it; less than
    /// [`SensorConfig::encoder_modulus`].
    pub encoder_count: Option<u32>,
}

impl Sample {
    /// A sample without a new value.
    pub(crate) fn stale(t_s: f64) -> Self {
        Self { received_s: t_s, value_mm: None, flag: ReadingFlag::Stale, lost_before_count: 0, encoder_count: None }
    }
}

/// Properties of a sensor that is ready.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorInfo {
    /// Description of the sensor, for the record.
    pub identity: String,
    /// Measured rate of the samples, Hz; 0 if it could not be measured. For a simulated sensor, the rate of the
    /// simulation.
    pub sample_rate_hz: f64,
}

/// Interface that each sensor implements. One call at a time; each call runs to its end.
pub trait SensorDriver: Send + 'static {
    /// Checks that the sensor works and that its data are valid, and measures its sample rate.
    fn prepare(&mut self) -> impl Future<Output = Result<SensorInfo, SensorError>> + Send;
    /// Discards samples that came before this call and were not read.
    fn discard_old_samples(&mut self) -> impl Future<Output = Result<(), SensorError>> + Send;
    /// Returns the next sample. If none comes within the sensor's timeout, returns one with the flag `Stale`.
    fn next(&mut self) -> impl Future<Output = Result<Sample, SensorError>> + Send;
    /// Whether the sensor is simulated and measures only when it is read: then it cannot be watched while the machine
    /// moves. A real sensor that sends on request is not meant.
    fn is_simulated_on_demand(&self) -> bool;
    /// Minimum number of samples that came without being requested, by the sensor's counter; 0 without a
    /// counter.
    fn unrequested_count(&self) -> u64 {
        0
    }
}

/// Number of consecutive stale samples after which a read ends; they are part of its result.
const MAX_CONSECUTIVE_STALE_SAMPLES: u32 = 3;

/// Time for which a sensor is read to determine its rate; longer for a serial or Modbus sensor with a long timeout.
const RATE_MEASUREMENT_TIME: Duration = Duration::from_millis(500);
/// Number of samples after which the measurement of the rate of a CAN or serial sensor ends early.
const MAX_RATE_MEASUREMENT_SAMPLES: usize = 50;

/// Whether a sample is good.
type SamplePredicate = Box<dyn Fn(&Sample) -> bool + Send>;
/// Called from the task of the sensor when a watch finds a sample that is not good, or an error.
type RejectionAction = Box<dyn Fn() + Send>;

/// Request to the sensor's task, with the channel for its result.
enum SensorRequest {
    StartCapture(SensorRequestCapture),
    Prepare(oneshot::Sender<Result<SensorInfo, SensorError>>),
    /// Number of samples to read.
    ReadSamples(u32, oneshot::Sender<Result<Vec<Sample>, SensorError>>),
    /// The channel reports that the watch has started; `EndWatch` returns its result.
    Watch(SamplePredicate, RejectionAction, oneshot::Sender<Result<(), SensorError>>),
    /// Returns the sample that was not good, if there was one.
    EndWatch(oneshot::Sender<Result<Option<Sample>, SensorError>>),
    /// The sample is neither captured nor counted.
    SampleForDisplay(oneshot::Sender<Result<Sample, SensorError>>),
    Counters(oneshot::Sender<Result<SampleCounters, SensorError>>),
}

/// Handle to a running sensor: sends requests to the task that owns the driver.
pub struct SensorHandle {
    name: String,
    request_sender: mpsc::Sender<SensorRequest>,
}

impl SensorHandle {
    /// Starts the task that owns `driver`. Call inside a tokio runtime.
    pub fn spawn(name: impl Into<String>, driver: impl SensorDriver) -> Self {
        let (requests, inbox) = mpsc::channel(1);
        tokio::spawn(serve_requests(driver, inbox));
        Self { name: name.into(), request_sender: requests }
    }

    /// Creates a sensor that replays a capture. Call inside a tokio runtime.
    pub fn replaying_capture(name: impl Into<String>, capture: SensorRequestCapture) -> Self {
        let (requests, inbox) = mpsc::channel(1);
        tokio::spawn(capture_format::replay_capture(capture, inbox));
        Self { name: name.into(), request_sender: requests }
    }

    /// Starts to record preparations, reads and watches with their replies in a capture. Errors and samples for display
    /// are not recorded.
    ///
    /// # Errors
    /// The sensor's task has ended.
    pub async fn recording_to(self, capture: SensorRequestCapture) -> Result<Self, SensorError> {
        self.request_sender.send(SensorRequest::StartCapture(capture)).await.map_err(|_| SensorError::TaskEnded)?;
        Ok(self)
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    /// Checks that the sensor works, and measures its sample rate.
    pub async fn prepare(&self) -> Result<SensorInfo, SensorError> {
        self.request(SensorRequest::Prepare).await
    }

    /// Returns the next `count` samples, none from before this call. Ends early after three consecutive stale
    /// samples, which are returned too.
    pub async fn read_samples(&self, count: u32) -> Result<Vec<Sample>, SensorError> {
        self.request(|reply| SensorRequest::ReadSamples(count, reply)).await
    }

    /// Watches the samples until [`SensorHandle::end_watch`] or any other request: at the first sample that is not
    /// `is_good`, or at an error, `on_rejection` is called, at once and from the task of the sensor, and the watch
    /// ends. `on_rejection` must not block. A simulated sensor that measures only when it is read is not watched.
    /// Returns when the watch has started: every later sample is checked.
    pub async fn watch(
        &self,
        is_good: impl Fn(&Sample) -> bool + Send + 'static,
        on_rejection: impl Fn() + Send + 'static,
    ) -> Result<(), SensorError> {
        self.request(|started| SensorRequest::Watch(Box::new(is_good), Box::new(on_rejection), started)).await
    }

    /// Ends the watch. Returns the sample that was not good; `None` if all were good, or if the sensor was not
    /// watched. An error of the sensor during the watch is returned here.
    pub async fn end_watch(&self) -> Result<Option<Sample>, SensorError> {
        self.request(SensorRequest::EndWatch).await
    }

    /// Returns the next sample, for display only: the sample is neither captured nor counted. A replayed capture gives
    /// an error.
    pub async fn sample_for_display(&self) -> Result<Sample, SensorError> {
        self.request(SensorRequest::SampleForDisplay).await
    }

    /// Returns the counts of samples up to now.
    pub async fn sample_counters(&self) -> Result<SampleCounters, SensorError> {
        self.request(SensorRequest::Counters).await
    }

    /// Sends the request and waits for its result; an error if the sensor's task has ended.
    async fn request<T>(
        &self,
        request: impl FnOnce(oneshot::Sender<Result<T, SensorError>>) -> SensorRequest,
    ) -> Result<T, SensorError> {
        let (reply, result) = oneshot::channel();
        self.request_sender.send(request(reply)).await.map_err(|_| SensorError::TaskEnded)?;
        result.await.map_err(|_| SensorError::TaskEnded)?
    }
}

/// Task of the driver: handles requests one after the other until the handle is dropped.
async fn serve_requests(mut driver: impl SensorDriver, mut inbox: mpsc::Receiver<SensorRequest>) {
    let (mut rejected, mut capture, mut counters) =
        (Ok(None), SensorRequestCapture::disabled(), SampleCounters::default());
    while let Some(request) = inbox.recv().await {
        match request {
            SensorRequest::StartCapture(recorder) => capture = recorder,
            SensorRequest::Prepare(reply) => {
                capture.record_request(capture_format::PREPARE_REQUEST);
                let info = driver.prepare().await;
                info.iter().for_each(|info| capture.record_reply(&capture_format::info_line(info)));
                drop(reply.send(info));
            }
            SensorRequest::ReadSamples(count, reply) => {
                capture.record_request(&capture_format::read_request_line(count));
                let samples = read_samples(&mut driver, count).await;
                samples.iter().flatten().for_each(|sample| counters.count_sample(sample));
                samples.iter().flatten().for_each(|sample| capture.record_reply(&capture_format::sample_line(sample)));
                drop(reply.send(samples));
            }
            SensorRequest::Watch(is_good, on_rejection, started) => {
                capture.record_request(capture_format::WATCH_REQUEST);
                let watch_ready = prepare_watch_if_supported(&mut driver).await;
                let is_watched = matches!(watch_ready, Ok(true));
                drop(started.send(watch_ready.map(|_| ())));
                if is_watched {
                    rejected = watch_samples(&mut driver, &inbox, is_good, on_rejection, &capture, &mut counters).await;
                }
            }
            SensorRequest::Counters(reply) => {
                let unrequested_count = driver.unrequested_count();
                drop(reply.send(Ok(SampleCounters { unrequested_count, ..counters })));
            }
            SensorRequest::EndWatch(reply) => drop(reply.send(std::mem::replace(&mut rejected, Ok(None)))),
            SensorRequest::SampleForDisplay(reply) => drop(reply.send(read_fresh_sample(&mut driver).await)),
        }
    }
}

/// Returns the next `count` samples, none from before this call; ends early after three consecutive stale samples.
async fn read_samples(driver: &mut impl SensorDriver, count: u32) -> Result<Vec<Sample>, SensorError> {
    driver.discard_old_samples().await?;
    let (mut samples, mut consecutive_silence_count) = (Vec::new(), 0);
    for _ in 0..count {
        let sample = driver.next().await?;
        consecutive_silence_count = if sample.flag == ReadingFlag::Stale { consecutive_silence_count + 1 } else { 0 };
        samples.push(sample);
        if consecutive_silence_count == MAX_CONSECUTIVE_STALE_SAMPLES {
            break;
        }
    }
    Ok(samples)
}

async fn read_fresh_sample(driver: &mut impl SensorDriver) -> Result<Sample, SensorError> {
    driver.discard_old_samples().await?;
    driver.next().await
}

/// Discards earlier samples and returns `true`; returns `false` for a simulated sensor that measures only when it is
/// read.
async fn prepare_watch_if_supported(driver: &mut impl SensorDriver) -> Result<bool, SensorError> {
    if driver.is_simulated_on_demand() {
        return Ok(false);
    }
    driver.discard_old_samples().await.map(|()| true)
}

/// Watches the samples until the next request of any kind, an error, or a sample that is not good; returns that
/// sample.
async fn watch_samples(
    driver: &mut impl SensorDriver,
    inbox: &mpsc::Receiver<SensorRequest>,
    is_good: SamplePredicate,
    on_rejection: RejectionAction,
    capture: &SensorRequestCapture,
    counters: &mut SampleCounters,
) -> Result<Option<Sample>, SensorError> {
    while inbox.is_empty() && !inbox.is_closed() {
        let sample = driver.next().await.inspect_err(|_| on_rejection())?;
        let is_good = is_good(&sample);
        if !is_good {
            on_rejection();
        }
        counters.count_sample(&sample);
        // The capture is written after the hold, so that no disk access delays the hold.
        capture.record_reply(&capture_format::sample_line(&sample));
        if !is_good {
            return Ok(Some(sample));
        }
    }
    Ok(None)
}
