//! The seam to displacement sensors, and the thermometers beside them. A driver delivers one sample after the other, as they
//! come; its task owns the link, and no future of it is ever dropped half-way.
//!
//! A sample that cannot be trusted is flagged and has no value: nothing is interpolated, and nothing
//! is zero that was not measured as zero.

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

/// A sensor as one of the tables of `[[sensor]]` names it. What stands there is its room's own matter.
pub trait Named: fmt::Debug + Send + Sync {
    /// Where it is reached, in words.
    fn at(&self) -> String;
    /// The port that other sensors may share with it.
    fn port(&self) -> Option<Port> {
        None
    }
    /// After how many counts the rotary encoder's count of a sample begins anew; `None`: its samples carry none.
    fn encoder_round(&self) -> Option<u64> {
        None
    }
    /// Open its link, or share one of `ports`, and start its task. Its samples have the time of `clock`. Call
    /// inside a tokio runtime.
    fn open<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        clock: Arc<dyn Clock>,
        ports: &'a SharedPorts,
    ) -> Opening<'a>;
}

pub type Opening<'a> = Pin<Box<dyn Future<Output = Result<Sensor, SensorError>> + Send + 'a>>;

/// One sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Monotonic time at which it was received, s: the kernel's stamp where there is one.
    pub t_s: f64,
    /// Distance from the sensor's zero point; `None` where `flag` says that it means nothing.
    pub value_mm: Option<f64>,
    /// `Range`: out of range or no echo; `Saturated`; `Stale`: it did not come, or is one that came
    /// before; `Gap`: good, but the sensor's counter says that samples before it are missing.
    pub flag: Flag,
    /// Samples that are missing before this one, as the sensor's counter says.
    pub missing: u32,
    /// Count of the rotary encoder at this sample, where the sensor sends it; less than
    /// [`Named::encoder_round`].
    pub encoder_count: Option<u32>,
}

impl Sample {
    /// No new value.
    pub(crate) fn stale(t_s: f64) -> Self {
        Self { t_s, value_mm: None, flag: Flag::Stale, missing: 0, encoder_count: None }
    }
}

/// What a sensor says of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Prepared {
    /// What is known of it, for the record.
    pub identity: String,
    /// Samples a second, as they came.
    pub rate_hz: f64,
}

/// What each sensor implements. One call at a time, each runs to its end.
pub trait Driver: Send + 'static {
    /// Open, see that it lives and that what it says makes sense.
    fn prepare(&mut self) -> impl Future<Output = Result<Prepared, SensorError>> + Send;
    /// Forget what came before now and was not taken.
    fn forget(&mut self) -> impl Future<Output = Result<(), SensorError>> + Send;
    /// The next sample. Silence is a sample as well: after the sensor's time-out it is `Stale`.
    fn next(&mut self) -> impl Future<Output = Result<Sample, SensorError>> + Send;
    /// It says nothing unless it is asked: there is nothing to watch while the machine moves.
    fn on_demand(&self) -> bool;
    /// So many samples at least came while nobody listened, as its counter says; 0 without one.
    fn passed_over(&self) -> u64 {
        0
    }
}

/// Who says nothing so often in a row says nothing.
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

/// The handle that a run holds: messages to the driver's task.
pub struct Sensor {
    name: String,
    requests: mpsc::Sender<Request>,
}

impl Sensor {
    /// Start the task that owns `driver`. Call inside a tokio runtime.
    pub fn spawn(name: impl Into<String>, driver: impl Driver) -> Self {
        let (requests, inbox) = mpsc::channel(1);
        tokio::spawn(serve(driver, inbox));
        Self { name: name.into(), requests }
    }

    /// A capture in its place. Call inside a tokio runtime.
    pub fn replayed(name: impl Into<String>, talk: Talk) -> Self {
        let (requests, inbox) = mpsc::channel(1);
        tokio::spawn(told::replay(talk, inbox));
        Self { name: name.into(), requests }
    }

    /// From now on what it is asked and says goes into a capture.
    ///
    /// # Errors
    /// Its task has ended.
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

    /// The next `count` samples, none from before this call; fewer of a sensor that falls silent.
    pub async fn take(&self, count: u32) -> Result<Vec<Sample>, SensorError> {
        self.ask(|answer| Request::Take(count, answer)).await
    }

    /// Until [`Sensor::rest`]: the first sample that is not `good` has `act` called, at once and from
    /// the sensor's task. `act` must not block. A sensor that speaks on demand alone is not watched.
    /// Returns when the watch stands: whatever comes from now on is seen.
    pub async fn watch(
        &self,
        good: impl Fn(&Sample) -> bool + Send + 'static,
        act: impl Fn() + Send + 'static,
    ) -> Result<(), SensorError> {
        self.ask(|stands| Request::Watch(Box::new(good), Box::new(act), stands)).await
    }

    /// End the watch; the sample that was not good, if there was one.
    pub async fn rest(&self) -> Result<Option<Sample>, SensorError> {
        self.ask(Request::Rest).await
    }

    /// The next sample, for display only: neither captured nor counted. A replay has none.
    pub async fn current(&self) -> Result<Sample, SensorError> {
        self.ask(Request::Current).await
    }

    /// What came up to now.
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

/// The driver's task: requests one after the other until the handle is dropped.
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

/// From now on; `false`: it says nothing unless it is asked.
async fn listen(driver: &mut impl Driver) -> Result<bool, SensorError> {
    if driver.on_demand() {
        return Ok(false);
    }
    driver.forget().await.map(|()| true)
}

/// Until somebody asks for something else.
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
        // No disk stands between the sample and the hold.
        talk.said(&told::sample(&sample));
        if !good {
            return Ok(Some(sample));
        }
    }
    Ok(None)
}
