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

use tokio::sync::{mpsc, oneshot};

use link::{Clock, SharedPorts, Talk};
use machine::record::reading::Flag;
use machine::record::sensor;

pub mod can;
mod encoder;
mod error;
mod field;
mod follow;
mod layout;
#[cfg(test)]
mod layout_tests;
pub mod modbus;
mod port;
pub mod serial;
mod tally;
#[cfg(test)]
mod tests;
pub mod thermometer;
mod told;

pub use error::SensorError;
pub use port::Port;
pub use tally::Tally;

/// Configuration of a sensor, from one of the tables of `[[sensor]]`. Each kind of sensor defines the keys
/// of its own table.
pub trait Named: fmt::Debug + Send + Sync {
    /// Address of the sensor, in words.
    fn at(&self) -> String;
    /// Port that the sensor may share with other sensors.
    fn port(&self) -> Option<Port> {
        None
    }
    /// Number of counts after which the rotary encoder's count restarts; `None` if the samples have no such
    /// count.
    fn encoder_round(&self) -> Option<u64> {
        None
    }
    /// Opens the sensor's link, or shares one of `ports`, and starts its task. Its samples have the time of
    /// `clock`. Call inside a tokio runtime.
    fn open<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        clock: Arc<dyn Clock>,
        ports: &'a SharedPorts,
    ) -> Opening<'a>;
}

pub type Opening<'a> = Pin<Box<dyn Future<Output = Result<Sensor, SensorError>> + Send + 'a>>;

/// One sample of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Monotonic time of reception, s: the kernel's timestamp if there is one.
    pub t_s: f64,
    /// Distance from the sensor's zero point, mm; `None` if `flag` marks the sample as invalid.
    pub value_mm: Option<f64>,
    /// `Range`: out of range or no echo; `Saturated`; `Stale`: no sample came, or an old one; `Gap`: valid,
    /// but samples before it are missing.
    pub flag: Flag,
    /// Number of samples missing before this one, by the sensor's counter.
    pub missing: u32,
    /// Count of the rotary encoder at this sample, if the sensor sends it; less than
    /// [`Named::encoder_round`].
    pub encoder_count: Option<u32>,
}

impl Sample {
    /// A sample without a new value.
    pub(crate) fn stale(t_s: f64) -> Self {
        Self { t_s, value_mm: None, flag: Flag::Stale, missing: 0, encoder_count: None }
    }
}

/// Properties of a sensor that is ready.
#[derive(Debug, Clone, PartialEq)]
pub struct Prepared {
    /// Description of the sensor, for the record.
    pub identity: String,
    /// Measured rate of the samples, Hz.
    pub rate_hz: f64,
}

/// Interface that each sensor implements. One call at a time; each call runs to its end.
pub trait Driver: Send + 'static {
    /// Opens the link, and checks that the sensor is working and that its data make sense.
    fn prepare(&mut self) -> impl Future<Output = Result<Prepared, SensorError>> + Send;
    /// Discards samples that came before now and were not read.
    fn forget(&mut self) -> impl Future<Output = Result<(), SensorError>> + Send;
    /// Returns the next sample. Silence gives a sample too: after the sensor's timeout it is `Stale`.
    fn next(&mut self) -> impl Future<Output = Result<Sample, SensorError>> + Send;
    /// Whether the sensor sends only on request: then it cannot be watched while the machine moves.
    fn on_demand(&self) -> bool;
    /// Minimum number of samples that came without being requested, by the sensor's counter; 0 without a
    /// counter.
    fn passed_over(&self) -> u64 {
        0
    }
}

/// Number of consecutive silences after which a sensor counts as silent.
const MOST_SILENT: u32 = 3;

type Good = Box<dyn Fn(&Sample) -> bool + Send>;
type Act = Box<dyn Fn() + Send>;

enum Request {
    Captured(Talk),
    Prepare(oneshot::Sender<Result<Prepared, SensorError>>),
    Take(u32, oneshot::Sender<Result<Vec<Sample>, SensorError>>),
    Watch(Good, Act, oneshot::Sender<Result<(), SensorError>>),
    Rest(oneshot::Sender<Result<Option<Sample>, SensorError>>),
    Current(oneshot::Sender<Result<Sample, SensorError>>),
    Tally(oneshot::Sender<Result<Tally, SensorError>>),
}

/// Handle that a run holds: sends messages to the driver's task.
pub struct Sensor {
    name: String,
    requests: mpsc::Sender<Request>,
}

impl Sensor {
    /// Starts the task that owns `driver`. Call inside a tokio runtime.
    pub fn spawn(name: impl Into<String>, driver: impl Driver) -> Self {
        let (requests, inbox) = mpsc::channel(1);
        tokio::spawn(serve(driver, inbox));
        Self { name: name.into(), requests }
    }

    /// Creates a sensor that replays a capture. Call inside a tokio runtime.
    pub fn replayed(name: impl Into<String>, talk: Talk) -> Self {
        let (requests, inbox) = mpsc::channel(1);
        tokio::spawn(told::replay(talk, inbox));
        Self { name: name.into(), requests }
    }

    /// Starts to record all requests and answers in a capture.
    ///
    /// # Errors
    /// The sensor's task has ended.
    pub async fn captured(self, talk: Talk) -> Result<Self, SensorError> {
        self.requests.send(Request::Captured(talk)).await.map_err(|_| SensorError::Gone)?;
        Ok(self)
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    pub async fn prepare(&self) -> Result<Prepared, SensorError> {
        self.ask(Request::Prepare).await
    }

    /// Returns the next `count` samples, none from before this call; fewer if the sensor falls silent.
    pub async fn take(&self, count: u32) -> Result<Vec<Sample>, SensorError> {
        self.ask(|answer| Request::Take(count, answer)).await
    }

    /// Watches the samples until [`Sensor::rest`]: at the first sample that is not `good`, `act` is called,
    /// at once and from the sensor's task. `act` must not block. A sensor that sends only on request is not
    /// watched. Returns when the watch has started: every later sample is checked.
    pub async fn watch(
        &self,
        good: impl Fn(&Sample) -> bool + Send + 'static,
        act: impl Fn() + Send + 'static,
    ) -> Result<(), SensorError> {
        self.ask(|stands| Request::Watch(Box::new(good), Box::new(act), stands)).await
    }

    /// Ends the watch; returns the sample that was not good, if there was one.
    pub async fn rest(&self) -> Result<Option<Sample>, SensorError> {
        self.ask(Request::Rest).await
    }

    /// Returns the next sample, for display only: it is neither captured nor counted. A replay has none.
    pub async fn current(&self) -> Result<Sample, SensorError> {
        self.ask(Request::Current).await
    }

    /// Returns the counts of samples up to now.
    pub async fn tally(&self) -> Result<Tally, SensorError> {
        self.ask(Request::Tally).await
    }

    async fn ask<T>(
        &self,
        request: impl FnOnce(oneshot::Sender<Result<T, SensorError>>) -> Request,
    ) -> Result<T, SensorError> {
        let (answer, result) = oneshot::channel();
        self.requests.send(request(answer)).await.map_err(|_| SensorError::Gone)?;
        result.await.map_err(|_| SensorError::Gone)?
    }
}

/// Task of the driver: handles requests one after the other until the handle is dropped.
async fn serve(mut driver: impl Driver, mut inbox: mpsc::Receiver<Request>) {
    let (mut seen, mut talk, mut tally) = (Ok(None), Talk::plain(), Tally::default());
    while let Some(request) = inbox.recv().await {
        match request {
            Request::Captured(by) => talk = by,
            Request::Prepare(answer) => {
                talk.asked(told::PREPARE);
                let prepared = driver.prepare().await;
                prepared.iter().for_each(|prepared| talk.said(&told::prepared(prepared)));
                drop(answer.send(prepared));
            }
            Request::Take(count, answer) => {
                talk.asked(&told::take(count));
                let samples = take(&mut driver, count).await;
                samples.iter().flatten().for_each(|sample| tally.count(sample));
                samples.iter().flatten().for_each(|sample| talk.said(&told::sample(sample)));
                drop(answer.send(samples));
            }
            Request::Watch(good, act, stands) => {
                talk.asked(told::WATCH);
                let listens = listen(&mut driver).await;
                let watches = matches!(listens, Ok(true));
                drop(stands.send(listens.map(|_| ())));
                if watches {
                    seen = watch(&mut driver, &inbox, (good, act), (&talk, &mut tally)).await;
                }
            }
            Request::Tally(answer) => {
                let passed_over = driver.passed_over();
                drop(answer.send(Ok(Tally { passed_over, ..tally })));
            }
            Request::Rest(answer) => drop(answer.send(std::mem::replace(&mut seen, Ok(None)))),
            Request::Current(answer) => drop(answer.send(current(&mut driver).await)),
        }
    }
}

async fn take(driver: &mut impl Driver, count: u32) -> Result<Vec<Sample>, SensorError> {
    driver.forget().await?;
    let (mut samples, mut silent) = (Vec::new(), 0);
    for _ in 0..count {
        let sample = driver.next().await?;
        silent = if sample.flag == Flag::Stale { silent + 1 } else { 0 };
        samples.push(sample);
        if silent == MOST_SILENT {
            break;
        }
    }
    Ok(samples)
}

async fn current(driver: &mut impl Driver) -> Result<Sample, SensorError> {
    driver.forget().await?;
    driver.next().await
}

/// Discards earlier samples; returns `false` if the sensor sends only on request.
async fn listen(driver: &mut impl Driver) -> Result<bool, SensorError> {
    if driver.on_demand() {
        return Ok(false);
    }
    driver.forget().await.map(|()| true)
}

/// Watches the samples until the next request.
async fn watch(
    driver: &mut impl Driver,
    inbox: &mpsc::Receiver<Request>,
    (good, act): (Good, Act),
    (talk, tally): (&Talk, &mut Tally),
) -> Result<Option<Sample>, SensorError> {
    while inbox.is_empty() && !inbox.is_closed() {
        let sample = driver.next().await.inspect_err(|_| act())?;
        let good = good(&sample);
        if !good {
            act();
        }
        tally.count(&sample);
        // The capture is written after the hold, so that no disk access delays the hold.
        talk.said(&told::sample(&sample));
        if !good {
            return Ok(Some(sample));
        }
    }
    Ok(None)
}
