//! Driver: samples from registers that are read at a fixed rate.

use std::sync::Arc;

use tokio::time::{Instant, sleep_until};

use super::ModbusSensorConfig;
use super::frozen_value::FrozenValueDetector;
use crate::sensors::counter_tracker::CounterTracker;
use crate::sensors::sample_layout::DecodedSample;
use crate::sensors::{
    OpenSensorFuture, RATE_MEASUREMENT_TIME, Sample, SensorConfig, SensorDriver, SensorError, SensorHandle, SensorInfo,
    SharedPort,
};
use link::modbus::{Framing, ModbusClient, ModbusError};
use link::{Clock, SharedPorts};
use machine::record::reading::ReadingFlag;
use machine::record::sensor;

/// Number of samples after which the measurement of the rate ends early.
const RATE_MEASUREMENT_SAMPLES: usize = 20;

/// Driver that reads the registers of one sensor at a fixed rate.
pub struct ModbusSensorDriver {
    config: ModbusSensorConfig,
    /// Measuring range of the sensor, from the machine file: values beyond it are flagged.
    range_mm: [f64; 2],
    clock: Arc<dyn Clock>,
    client: ModbusClient,
    counter_tracker: CounterTracker,
    /// Detects a value without noise as frozen; `None` if there is a counter, if the noise is unknown or too small,
    /// or for a simulated sensor.
    frozen_detector: Option<FrozenValueDetector>,
    /// Sample rate, Hz, of a simulated sensor whose time advances only at a read; `None`: a real sensor.
    simulated_hz: Option<f64>,
    /// Time before which no read starts.
    next_read_time: Instant,
}

impl ModbusSensorDriver {
    /// Opens the link of `config`. `simulated_hz`: sample rate of a simulated sensor that measures only when it is
    /// read; `None`: a real sensor.
    ///
    /// # Errors
    /// The link cannot be opened.
    pub async fn open(
        config: ModbusSensorConfig,
        sensor: &sensor::Sensor,
        clock: Arc<dyn Clock>,
        simulated_hz: Option<f64>,
    ) -> Result<Self, SensorError> {
        let link = ModbusClient::open(config.device.line.clone(), config.device_settings()).await?;
        Ok(Self::from_link(link, config, sensor, clock, simulated_hz))
    }

    fn from_link(
        link: ModbusClient,
        config: ModbusSensorConfig,
        sensor: &sensor::Sensor,
        clock: Arc<dyn Clock>,
        simulated_hz: Option<f64>,
    ) -> Self {
        Self {
            range_mm: sensor.range_mm,
            clock,
            client: link,
            counter_tracker: CounterTracker::new(config.register_map.sample_layout.counter_modulus()),
            // A sensor that measures when it is read has no unchanged values.
            frozen_detector: match simulated_hz {
                Some(_) => None,
                None => FrozenValueDetector::new_if_detectable(&config.register_map, sensor, config.device.timeout),
            },
            simulated_hz,
            next_read_time: Instant::now(),
            config,
        }
    }

    /// Waits until the next read is due, then reads the registers.
    async fn read_registers(&mut self) -> Result<DecodedSample, SensorError> {
        if self.simulated_hz.is_none() {
            if Instant::now() < self.next_read_time {
                sleep_until(self.next_read_time).await;
            }
            self.next_read_time = Instant::now().max(self.next_read_time + self.config.min_read_interval);
        }
        let span = self.config.register_map.span;
        let words = self.client.read(span.space, span.first, span.last - span.first + 1).await?;
        let read = self.config.register_map.sample_layout.decode(&words);
        read.map_err(|error| SensorError::InvalidData {
            text: format!("registers {} to {}: {error}", span.first, span.last),
            remedy: "compare [sensor.modbus] with the sensor's manual: register, type, order; set `nan` \
                     to the meaning of a number that is not finite"
                .to_owned(),
        })
    }

    /// Reads the registers once; the sample is stale if the counter has not changed or the value is frozen.
    async fn read_sample(&mut self) -> Result<Sample, SensorError> {
        let decoded = self.read_registers().await?.flag_out_of_range(self.range_mm);
        if let (Some(frozen_detector), Ok(mm)) = (&mut self.frozen_detector, decoded.value_mm)
            && frozen_detector.detect_frozen(mm, Instant::now())
        {
            return Ok(Sample::stale(self.clock.now_s()));
        }
        let mut sample = self.counter_tracker.complete_sample(self.clock.now_s(), decoded);
        if !self.config.register_map.counts_missing_samples {
            sample.lost_before_count = 0;
            if sample.flag == ReadingFlag::Gap {
                sample.flag = ReadingFlag::None;
            }
        }
        Ok(sample)
    }

    /// Describes the sensor, with the faults that cannot be detected.
    fn identity(&self) -> String {
        let counter = self.config.register_map.sample_layout.counter_and_modulus;
        let limitation = match (counter, &self.frozen_detector, self.simulated_hz) {
            (Some(_), ..) | (_, _, Some(_)) => "",
            (None, Some(_), None) => ", without a counter: a frozen value is detected only by its noise",
            (None, None, None) => {
                ", without a counter: a frozen value cannot be detected (possible with noise_um of four counts \
                 or more)"
            }
        };
        format!("Modbus sensor at {}{limitation}", self.config.describe_address())
    }
}

/// Whether the answer was missing or invalid, so that the sample is stale; the next request may succeed.
fn is_transient(error: &SensorError) -> bool {
    use ModbusError::{LineNotCleared, Timeout, UnexpectedReply};
    matches!(error, SensorError::Modbus(Timeout { .. } | UnexpectedReply { .. } | LineNotCleared { .. }))
}

impl SensorDriver for ModbusSensorDriver {
    async fn prepare(&mut self) -> Result<SensorInfo, SensorError> {
        self.counter_tracker.restart();
        // An error of the first read is reported.
        let first = self.read_registers().await?;
        let mut rate_hz = self.simulated_hz.unwrap_or_default();
        if self.simulated_hz.is_none() {
            self.counter_tracker.complete_sample(self.clock.now_s(), first);
            let start = Instant::now();
            let mut count = 0;
            let is_unchanged = |frozen_detector: &Option<FrozenValueDetector>, count: usize| {
                frozen_detector.as_ref().is_some_and(|detector| detector.equal_value_count as usize >= count)
            };
            while (count < RATE_MEASUREMENT_SAMPLES || is_unchanged(&self.frozen_detector, count))
                && start.elapsed() < RATE_MEASUREMENT_TIME.max(2 * self.config.device.timeout)
            {
                let is_stale = self.next().await?.flag == ReadingFlag::Stale;
                count += usize::from(!is_stale);
            }
            if count == 0 || self.frozen_detector.as_ref().is_some_and(|detector| detector.is_frozen) {
                return Err(SensorError::InvalidData {
                    text: "the registers of the sensor never change: counter or value is constant, or the status \
                           reports an old value"
                        .to_owned(),
                    remedy: "check that the sensor measures; compare `counter` and `status` of \
                             [sensor.modbus] with its manual"
                        .to_owned(),
                });
            }
            rate_hz = count as f64 / start.elapsed().as_secs_f64();
        }
        Ok(SensorInfo { identity: self.identity(), sample_rate_hz: rate_hz })
    }

    async fn discard_old_samples(&mut self) -> Result<(), SensorError> {
        self.counter_tracker.restart();
        if self.simulated_hz.is_some() || self.config.register_map.sample_layout.counter_modulus().is_none() {
            return Ok(());
        }
        // The registers hold an earlier sample; the next one has another count.
        match self.read_registers().await {
            Ok(decoded) => {
                self.counter_tracker.complete_sample(self.clock.now_s(), decoded);
                Ok(())
            }
            Err(error) if is_transient(&error) => Ok(()),
            Err(error) => Err(error),
        }
    }

    async fn next(&mut self) -> Result<Sample, SensorError> {
        let end = Instant::now() + self.config.device.timeout;
        loop {
            match self.read_sample().await {
                Ok(sample) if sample.flag == ReadingFlag::Stale && Instant::now() < end => {}
                Err(error) if is_transient(&error) => return Ok(Sample::stale(self.clock.now_s())),
                result => return result,
            }
        }
    }

    fn is_simulated_on_demand(&self) -> bool {
        self.simulated_hz.is_some()
    }
}

impl SensorConfig for ModbusSensorConfig {
    fn describe_address(&self) -> String {
        self.device.describe()
    }

    /// Returns an RTU line, which units may share; over Modbus TCP each sensor has its own connection.
    fn shared_port(&self) -> Option<SharedPort> {
        let line = &self.device.line;
        let keys = vec![
            ("its table", "[sensor.modbus]".to_owned()),
            ("`baud`", line.link.baud().map_or("none".to_owned(), |baud| baud.to_string())),
            ("`parity`", format!("{:?}", line.parity).to_lowercase()),
        ];
        (line.framing == Framing::Rtu).then(|| SharedPort { name: line.to_string(), keys_required_equal: keys })
    }

    fn encoder_modulus(&self) -> Option<u64> {
        self.register_map.sample_layout.encoder_modulus()
    }

    fn open_sensor<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        clock: Arc<dyn Clock>,
        ports: &'a SharedPorts,
    ) -> OpenSensorFuture<'a> {
        Box::pin(async move {
            let link = ports.open_modbus_client(self.device.line.clone(), self.device_settings()).await?;
            let driver = ModbusSensorDriver::from_link(link, self.clone(), sensor, clock, None);
            Ok(SensorHandle::spawn(sensor.name.as_str(), driver))
        })
    }
}
