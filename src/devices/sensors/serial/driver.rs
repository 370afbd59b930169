//! Driver: samples from the data of a serial line.

use std::collections::VecDeque;
use std::sync::Arc;

use tokio::time::{Duration, Instant, sleep_until};

use super::Config;
use super::cut::{Cutter, Piece};
use super::suspect::Heard;
use crate::sensors::follow::CounterTracker;
use crate::sensors::layout::Decoded;
use crate::sensors::{
    Driver, MOST_SILENT, Named, Opening, Port, Prepared, Sample, Sensor, SensorError,
};
use link::{ByteStreamHandle, Clock, SharedPorts, StreamRead};
use machine::record::sensor;

/// Time for which the sensor is read before it counts as ready. `ENOUGH`: number of samples that is enough.
const LISTEN: Duration = Duration::from_millis(500);
const ENOUGH: usize = 50;

/// A decoded piece of the stream, in order.
enum Ready {
    Said(Instant, Decoded),
    /// Bytes that could not be decoded.
    Broken,
}

pub struct Serial {
    config: Config,
    range_mm: [f64; 2],
    clock: Arc<dyn Clock>,
    /// Ports that other sensors may share.
    ports: SharedPorts,
    flow: Option<ByteStreamHandle>,
    cutter: Cutter,
    counting: CounterTracker,
    /// Decoded samples that have not been read yet.
    ready: VecDeque<Ready>,
    heard: Heard,
    /// Samples a second of a simulated sensor whose time advances only when it receives a request.
    simulated_hz: Option<f64>,
    /// Time before which no request is sent.
    next_request: Instant,
}

impl Serial {
    /// Opens the port of `config`, or shares it if it is open.
    ///
    /// # Errors
    /// The port cannot be opened.
    pub async fn open(
        config: Config,
        sensor: &sensor::Sensor,
        clock: Arc<dyn Clock>,
        ports: SharedPorts,
    ) -> Result<Self, SensorError> {
        let mut serial = Self { ports, ..Self::new(config, sensor, clock) };
        serial.reopen().await?;
        Ok(serial)
    }

    /// Creates a driver on a stream inside this process, for a simulated sensor whose time advances only
    /// when it receives a request.
    pub fn over(
        flow: ByteStreamHandle,
        config: Config,
        sensor: &sensor::Sensor,
        clock: Arc<dyn Clock>,
        rate_hz: f64,
    ) -> Self {
        let serial = Self::new(config, sensor, clock);
        Self { flow: Some(flow), simulated_hz: Some(rate_hz), ..serial }
    }

    fn new(config: Config, sensor: &sensor::Sensor, clock: Arc<dyn Clock>) -> Self {
        Self {
            range_mm: sensor.range_mm,
            clock,
            ports: SharedPorts::default(),
            flow: None,
            cutter: Cutter::new(config.form.clone()),
            counting: CounterTracker::new(config.form.round()),
            ready: VecDeque::new(),
            heard: Heard::default(),
            simulated_hz: None,
            next_request: Instant::now(),
            config,
        }
    }

    async fn reopen(&mut self) -> Result<(), SensorError> {
        self.flow = None;
        let address = self.config.at.address()?;
        self.flow = Some(self.ports.listen(&address).await?);
        Ok(())
    }

    fn flow(&mut self) -> Result<&mut ByteStreamHandle, SensorError> {
        self.flow.as_mut().ok_or(SensorError::Gone)
    }

    async fn forget_all(&mut self) -> Result<(), SensorError> {
        self.ready.clear();
        self.cutter.begin(self.config.request.is_none());
        self.flow()?.forget().await?;
        Ok(())
    }

    /// Returns the next piece that can be decoded, after a request if the sensor needs one; `None` if none
    /// comes before `deadline`, by default the sensor's timeout.
    async fn query(
        &mut self,
        deadline: Option<Instant>,
    ) -> Result<Option<(Instant, Decoded)>, SensorError> {
        let timeout = self.config.timeout;
        let Some(request) = self.config.request.clone() else {
            return self.said(deadline.unwrap_or_else(|| Instant::now() + timeout)).await;
        };
        // The shortest wait of a timer is a millisecond.
        if Instant::now() < self.next_request {
            sleep_until(self.next_request).await;
        }
        let mut turn = self.flow()?.request_turn().lock_owned().await;
        if std::mem::take(&mut turn.reply_owed) {
            self.fall_quiet().await?;
        }
        self.request(&request).await?;
        let said = self.said(deadline.unwrap_or_else(|| Instant::now() + timeout)).await?;
        turn.reply_owed = said.is_none();
        Ok(said)
    }

    async fn request(&mut self, request: &[u8]) -> Result<(), SensorError> {
        self.next_request = Instant::now() + self.config.pace;
        self.ready.clear();
        self.cutter.begin(false);
        // Data that came before the request are no answer to it.
        let flow = self.flow()?;
        flow.forget().await?;
        flow.send(request)?;
        Ok(())
    }

    /// Waits until nothing has come for the timeout: then no late answer can be taken for the next one.
    async fn fall_quiet(&mut self) -> Result<(), SensorError> {
        let patience = self.config.timeout;
        // A sensor that never falls silent does not answer requests: it sends by itself.
        let end = Instant::now() + 10 * patience;
        while Instant::now() < end {
            if self.flow()?.recv_deadline(Instant::now() + patience).await?.is_none() {
                return Ok(());
            }
        }
        Err(SensorError::UnexpectedDevice {
            text: "it never falls quiet, though it was to speak when asked".to_owned(),
            remedy: "leave `request` out, or set the sensor to send on request alone".to_owned(),
        })
    }

    /// Returns the next piece that can be decoded; `None` if none comes before `deadline`.
    async fn said(&mut self, deadline: Instant) -> Result<Option<(Instant, Decoded)>, SensorError> {
        loop {
            match self.ready.pop_front() {
                Some(Ready::Said(at, said)) => return Ok(Some((at, said))),
                Some(Ready::Broken) => {
                    self.counting.interrupted();
                    continue;
                }
                None => {}
            }
            match self.flow()?.recv_deadline(deadline).await? {
                None => return Ok(None),
                Some(StreamRead::Bytes(at, bytes)) => self.cut(at, &bytes),
                Some(StreamRead::Forgotten) => {
                    self.cutter.begin(true);
                    self.counting.interrupted();
                }
            }
        }
    }

    fn cut(&mut self, at: Instant, bytes: &[u8]) {
        self.heard.came(bytes);
        for piece in self.cutter.push(bytes) {
            match piece {
                Piece::Whole { said, bytes } => {
                    self.heard.good_bytes += bytes;
                    self.ready.push_back(Ready::Said(at, said));
                }
                Piece::Undecodable(bytes) => {
                    self.heard.spoilt(&bytes);
                    // A counter shows the loss more precisely.
                    if self.config.form.round().is_none() {
                        self.ready.push_back(Ready::Broken);
                    }
                }
            }
        }
    }

    fn time_of(&self, at: Instant) -> f64 {
        let ago = if self.on_demand() { Duration::ZERO } else { at.elapsed() };
        self.clock.now_s() - ago.as_secs_f64()
    }

    /// Returns the number of decoded samples, and the time from the first to the last.
    async fn listen(&mut self) -> Result<(usize, Duration), SensorError> {
        self.heard = Heard::default();
        let begun = Instant::now();
        let end = begun + LISTEN.max(self.config.timeout);
        let (mut times, mut stood) = (Vec::new(), 0);
        while times.len() < ENOUGH && Instant::now() < end {
            let Some((at, said)) = self.query(Some(end)).await? else { break };
            self.counting.follow(0.0, said);
            stood += usize::from(self.counting.stands());
            times.push(at);
            if self.on_demand() {
                break;
            }
        }
        if stood >= MOST_SILENT as usize && stood + 1 == times.len() {
            return Err(SensorError::Stands);
        }
        let span = times.first().zip(times.last()).map(|(first, last)| *last - *first);
        Ok((times.len(), span.unwrap_or_default()))
    }
}

impl Driver for Serial {
    async fn prepare(&mut self) -> Result<Prepared, SensorError> {
        let lost = self.forget_all().await.is_err();
        if lost && !self.on_demand() {
            self.reopen().await?;
        }
        self.forget_all().await?;
        self.counting.begin();
        let (count, span) = self.listen().await?;
        if self.heard.bytes == 0 {
            let seconds = LISTEN.max(self.config.timeout).as_secs_f64();
            return Err(SensorError::Silent { seconds });
        }
        if count == 0 || self.heard.is_noise() {
            return Err(self.heard.suspect(&self.config.form, self.config.at.baud()));
        }
        let measured = if span.is_zero() { 0.0 } else { (count - 1) as f64 / span.as_secs_f64() };
        let rate_hz = self.simulated_hz.unwrap_or(measured);
        let identity = match self.simulated_hz {
            Some(_) => "simulated sensor on a serial line".to_owned(),
            None => format!("serial sensor at {}", self.config.at.in_full()),
        };
        Ok(Prepared { identity, rate_hz })
    }

    async fn forget(&mut self) -> Result<(), SensorError> {
        self.counting.pass();
        self.forget_all().await
    }

    fn passed_over(&self) -> u64 {
        self.counting.passed_over()
    }

    async fn next(&mut self) -> Result<Sample, SensorError> {
        match self.query(None).await? {
            Some((at, said)) => {
                let said = said.within(self.range_mm);
                Ok(self.counting.follow(self.time_of(at), said))
            }
            None => Ok(Sample::stale(self.clock.now_s())),
        }
    }

    fn on_demand(&self) -> bool {
        self.simulated_hz.is_some()
    }
}

impl Named for Config {
    fn at(&self) -> String {
        self.at.in_full()
    }

    fn port(&self) -> Option<Port> {
        Some(self.shared_port())
    }

    fn encoder_round(&self) -> Option<u64> {
        self.form.encoder_round()
    }

    fn open<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        clock: Arc<dyn Clock>,
        ports: &'a SharedPorts,
    ) -> Opening<'a> {
        Box::pin(async move {
            let driver = Serial::open(self.clone(), sensor, clock, ports.clone()).await?;
            Ok(Sensor::spawn(sensor.name.as_str(), driver))
        })
    }
}
