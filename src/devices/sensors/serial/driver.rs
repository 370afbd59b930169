//! Driver: samples from the data of a serial line.

use std::collections::VecDeque;
use std::sync::Arc;

use tokio::time::{Duration, Instant, sleep_until};

use super::SerialConfig;
use super::splitter::{StreamPiece, StreamSplitter};
use super::startup_diagnosis::StartupData;
use crate::sensors::counter_tracker::CounterTracker;
use crate::sensors::sample_layout::DecodedSample;
use crate::sensors::{
    MAX_CONSECUTIVE_STALE_SAMPLES, MAX_RATE_MEASUREMENT_SAMPLES, OpenSensorFuture, RATE_MEASUREMENT_TIME, Sample,
    SensorConfig, SensorDriver, SensorError, SensorHandle, SensorInfo, SharedPort,
};
use link::{ByteStreamHandle, Clock, SharedPorts, StreamRead};
use machine::record::sensor;

/// Result of decoding one piece of the stream.
enum StreamItem {
    /// Decoded sample, with the time of its reception.
    Sample(Instant, DecodedSample),
    /// Bytes that could not be decoded.
    Undecodable,
}

/// Driver that decodes the byte stream of one sensor to samples.
pub struct SerialDriver {
    config: SerialConfig,
    /// Measuring range of the sensor, from the machine file: values beyond it are flagged.
    range_mm: [f64; 2],
    clock: Arc<dyn Clock>,
    /// Ports that other sensors may share.
    ports: SharedPorts,
    /// Stream of the port; `None` if the port is not open.
    stream: Option<ByteStreamHandle>,
    splitter: StreamSplitter,
    counter_tracker: CounterTracker,
    /// Decoded samples, and marks of undecodable bytes, that have not been read yet.
    unread_items: VecDeque<StreamItem>,
    /// Data since the start of `prepare`, for the diagnosis of an unreadable stream.
    startup_data: StartupData,
    /// Sample rate, Hz, of a simulated sensor whose time advances only when it receives a request; `None`: a real
    /// sensor.
    simulated_hz: Option<f64>,
    /// Time before which no request is sent.
    next_request_time: Instant,
}

impl SerialDriver {
    /// Opens the port of `config`, or shares it if it is open.
    ///
    /// # Errors
    /// The port cannot be opened.
    pub async fn open(
        config: SerialConfig,
        sensor: &sensor::Sensor,
        clock: Arc<dyn Clock>,
        ports: SharedPorts,
    ) -> Result<Self, SensorError> {
        let mut serial = Self { ports, ..Self::new(config, sensor, clock) };
        serial.reopen_stream().await?;
        Ok(serial)
    }

    /// Creates a driver on a stream inside this process, for a simulated sensor whose time advances only when it
    /// receives a request. `rate_hz`: its sample rate.
    pub fn from_stream(
        stream: ByteStreamHandle,
        config: SerialConfig,
        sensor: &sensor::Sensor,
        clock: Arc<dyn Clock>,
        rate_hz: f64,
    ) -> Self {
        let serial = Self::new(config, sensor, clock);
        Self { stream: Some(stream), simulated_hz: Some(rate_hz), ..serial }
    }

    fn new(config: SerialConfig, sensor: &sensor::Sensor, clock: Arc<dyn Clock>) -> Self {
        Self {
            range_mm: sensor.range_mm,
            clock,
            ports: SharedPorts::default(),
            stream: None,
            splitter: StreamSplitter::new(config.format.clone()),
            counter_tracker: CounterTracker::new(config.format.counter_modulus()),
            unread_items: VecDeque::new(),
            startup_data: StartupData::default(),
            simulated_hz: None,
            next_request_time: Instant::now(),
            config,
        }
    }

    /// Drops the stream and opens the port again, or shares it if another sensor has it open.
    async fn reopen_stream(&mut self) -> Result<(), SensorError> {
        self.stream = None;
        let address = self.config.link.resolve_address()?;
        self.stream = Some(self.ports.open_byte_stream(&address).await?);
        Ok(())
    }

    /// Stream of the port; the error `TaskEnded` if the port is not open.
    fn stream(&mut self) -> Result<&mut ByteStreamHandle, SensorError> {
        self.stream.as_mut().ok_or(SensorError::TaskEnded)
    }

    async fn discard_received_data(&mut self) -> Result<(), SensorError> {
        self.unread_items.clear();
        self.splitter.discard_buffer(self.config.sample_request.is_none());
        self.stream()?.discard_received().await?;
        Ok(())
    }

    /// Sends the request, if the sensor needs one, and returns the next sample that can be decoded. `None` if no sample
    /// comes before `deadline`; without `deadline` the sensor's timeout applies.
    async fn request_or_await_sample(
        &mut self,
        deadline: Option<Instant>,
    ) -> Result<Option<(Instant, DecodedSample)>, SensorError> {
        let timeout = self.config.silence_timeout;
        let Some(request) = self.config.sample_request.clone() else {
            return self.next_decoded_sample(deadline.unwrap_or_else(|| Instant::now() + timeout)).await;
        };
        // A timer waits at least a millisecond: it is not used if the time has already passed.
        if Instant::now() < self.next_request_time {
            sleep_until(self.next_request_time).await;
        }
        let mut turn = self.stream()?.request_turn().lock_owned().await;
        if std::mem::take(&mut turn.is_late_reply_pending) {
            self.wait_until_silent().await?;
        }
        self.send_request(&request).await?;
        let decoded = self.next_decoded_sample(deadline.unwrap_or_else(|| Instant::now() + timeout)).await?;
        turn.is_late_reply_pending = decoded.is_none();
        Ok(decoded)
    }

    /// Discards all data received so far, then sends the request.
    async fn send_request(&mut self, request: &[u8]) -> Result<(), SensorError> {
        self.next_request_time = Instant::now() + self.config.min_request_interval;
        self.unread_items.clear();
        self.splitter.discard_buffer(false);
        // Data that came before the request are no answer to it.
        let stream = self.stream()?;
        stream.discard_received().await?;
        stream.send(request)?;
        Ok(())
    }

    /// Waits until nothing has come for the timeout: then no late answer can be taken for the answer to the next
    /// request. An error if the sensor sends for ten timeouts without such a pause.
    async fn wait_until_silent(&mut self) -> Result<(), SensorError> {
        let silence = self.config.silence_timeout;
        // A sensor that never falls silent does not answer requests: it sends by itself.
        let end = Instant::now() + 10 * silence;
        while Instant::now() < end {
            if self.stream()?.recv_deadline(Instant::now() + silence).await?.is_none() {
                return Ok(());
            }
        }
        Err(SensorError::InvalidData {
            text: "the sensor sends without pause, although `request` is set".to_owned(),
            remedy: "remove `request`, or set the sensor to send only on request".to_owned(),
        })
    }

    /// Returns the next sample that can be decoded, with its time of reception; `None` if none comes before `deadline`.
    async fn next_decoded_sample(
        &mut self,
        deadline: Instant,
    ) -> Result<Option<(Instant, DecodedSample)>, SensorError> {
        loop {
            match self.unread_items.pop_front() {
                Some(StreamItem::Sample(at, decoded)) => return Ok(Some((at, decoded))),
                Some(StreamItem::Undecodable) => {
                    self.counter_tracker.mark_data_lost();
                    continue;
                }
                None => {}
            }
            match self.stream()?.recv_deadline(deadline).await? {
                None => return Ok(None),
                Some(StreamRead::Bytes(at, bytes)) => self.queue_samples_from(at, &bytes),
                Some(StreamRead::Overflow) => {
                    self.splitter.discard_buffer(true);
                    self.counter_tracker.mark_data_lost();
                }
            }
        }
    }

    fn queue_samples_from(&mut self, received_at: Instant, bytes: &[u8]) {
        self.startup_data.record_received(bytes);
        for piece in self.splitter.push(bytes) {
            match piece {
                StreamPiece::Decoded { sample, consumed_byte_count } => {
                    self.startup_data.valid_byte_count += consumed_byte_count;
                    self.unread_items.push_back(StreamItem::Sample(received_at, sample));
                }
                StreamPiece::Undecodable(bytes) => {
                    self.startup_data.record_invalid(&bytes);
                    // A counter shows the loss more precisely.
                    if self.config.format.counter_modulus().is_none() {
                        self.unread_items.push_back(StreamItem::Undecodable);
                    }
                }
            }
        }
    }

    /// Time of reception on the clock, s; for a simulated sensor that measures only when it is read, the present
    /// time.
    fn sample_time_s(&self, received_at: Instant) -> f64 {
        let age = if self.is_simulated_on_demand() { Duration::ZERO } else { received_at.elapsed() };
        self.clock.now_s() - age.as_secs_f64()
    }

    /// Returns the number of decoded samples, those with an unchanged count included, and the time from the first to
    /// the last. An error if the count never changes.
    async fn count_samples_and_span(&mut self) -> Result<(usize, Duration), SensorError> {
        self.startup_data = StartupData::default();
        let start = Instant::now();
        let end = start + RATE_MEASUREMENT_TIME.max(self.config.silence_timeout);
        let (mut times, mut unchanged_count) = (Vec::new(), 0);
        while times.len() < MAX_RATE_MEASUREMENT_SAMPLES && Instant::now() < end {
            let Some((at, decoded)) = self.request_or_await_sample(Some(end)).await? else { break };
            self.counter_tracker.complete_sample(0.0, decoded);
            unchanged_count += usize::from(self.counter_tracker.is_count_unchanged());
            times.push(at);
            if self.is_simulated_on_demand() {
                break;
            }
        }
        if unchanged_count >= MAX_CONSECUTIVE_STALE_SAMPLES as usize && unchanged_count + 1 == times.len() {
            return Err(SensorError::CounterFrozen);
        }
        let span = times.first().zip(times.last()).map(|(first, last)| *last - *first);
        Ok((times.len(), span.unwrap_or_default()))
    }
}

impl SensorDriver for SerialDriver {
    async fn prepare(&mut self) -> Result<SensorInfo, SensorError> {
        let needs_reopening = self.discard_received_data().await.is_err();
        if needs_reopening && !self.is_simulated_on_demand() {
            self.reopen_stream().await?;
        }
        self.discard_received_data().await?;
        self.counter_tracker.restart();
        let (count, span) = self.count_samples_and_span().await?;
        if self.startup_data.received_byte_count == 0 {
            let seconds = RATE_MEASUREMENT_TIME.max(self.config.silence_timeout).as_secs_f64();
            return Err(SensorError::Silent { seconds });
        }
        if count == 0 || self.startup_data.is_mostly_invalid() {
            return Err(self.startup_data.diagnose(&self.config.format, self.config.link.baud()));
        }
        let measured = if span.is_zero() { 0.0 } else { (count - 1) as f64 / span.as_secs_f64() };
        let rate_hz = self.simulated_hz.unwrap_or(measured);
        let identity = match self.simulated_hz {
            Some(_) => "simulated sensor on a serial line".to_owned(),
            None => format!("serial sensor at {}", self.config.link.describe()),
        };
        Ok(SensorInfo { identity, sample_rate_hz: rate_hz })
    }

    async fn discard_old_samples(&mut self) -> Result<(), SensorError> {
        self.counter_tracker.ignore_next_gap_and_wrap();
        self.discard_received_data().await
    }

    fn unrequested_count(&self) -> u64 {
        self.counter_tracker.unrequested_count()
    }

    async fn next(&mut self) -> Result<Sample, SensorError> {
        match self.request_or_await_sample(None).await? {
            Some((at, decoded)) => {
                let decoded = decoded.flag_out_of_range(self.range_mm);
                Ok(self.counter_tracker.complete_sample(self.sample_time_s(at), decoded))
            }
            None => Ok(Sample::stale(self.clock.now_s())),
        }
    }

    fn is_simulated_on_demand(&self) -> bool {
        self.simulated_hz.is_some()
    }
}

impl SensorConfig for SerialConfig {
    fn describe_address(&self) -> String {
        self.link.describe()
    }

    /// Returns the port with the keys that must be equal for all sensors on it. A sensor that answers
    /// requests reads only its own replies, so its format may differ.
    fn shared_port(&self) -> Option<SharedPort> {
        let request = if self.sample_request.is_some() { "set" } else { "not set" };
        let mut keys = vec![
            ("its table", "[sensor.serial]".to_owned()),
            ("`baud`", self.link.baud().map_or("none".to_owned(), |baud| baud.to_string())),
            ("`timeout_s`", self.silence_timeout.as_secs_f64().to_string()),
            ("`request`", request.to_owned()),
        ];
        if self.sample_request.is_none() {
            keys.extend(self.format.framing_keys());
        }
        Some(SharedPort { name: self.link.to_string(), keys_required_equal: keys })
    }

    fn encoder_modulus(&self) -> Option<u64> {
        self.format.encoder_modulus()
    }

    fn open_sensor<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        clock: Arc<dyn Clock>,
        ports: &'a SharedPorts,
    ) -> OpenSensorFuture<'a> {
        Box::pin(async move {
            let driver = SerialDriver::open(self.clone(), sensor, clock, ports.clone()).await?;
            Ok(SensorHandle::spawn(sensor.name.as_str(), driver))
        })
    }
}
