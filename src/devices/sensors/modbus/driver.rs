//! Driver: samples from registers that are read at a fixed rate.

use std::sync::Arc;

use tokio::time::{Duration, Instant, sleep_until};

use super::Config;
use super::standing::FrozenValueDetector;
use crate::sensors::follow::CounterTracker;
use crate::sensors::layout::Decoded;
use crate::sensors::{Driver, Named, Opening, Port, Prepared, Sample, Sensor, SensorError};
use link::modbus::{Modbus, ModbusError};
use link::{Clock, SharedPorts};
use machine::record::reading::Flag;
use machine::record::sensor;

/// Time for which the sensor is read before it counts as ready. `ENOUGH`: number of samples that is enough.
const LISTEN: Duration = Duration::from_millis(500);
const ENOUGH: usize = 20;

pub struct Registers {
    config: Config,
    range_mm: [f64; 2],
    clock: Arc<dyn Clock>,
    link: Modbus,
    counting: CounterTracker,
    /// Detects an unchanged value by its noise, if there is no counter.
    standing: Option<FrozenValueDetector>,
    /// Samples a second of a simulated sensor whose time advances only when it is read.
    simulated_hz: Option<f64>,
    next_read: Instant,
}

impl Registers {
    /// Opens the link of `config`. `simulated_hz`: sample rate of a simulated sensor that measures only
    /// when it is read.
    ///
    /// # Errors
    /// The link cannot be opened.
    pub async fn open(
        config: Config,
        sensor: &sensor::Sensor,
        clock: Arc<dyn Clock>,
        simulated_hz: Option<f64>,
    ) -> Result<Self, SensorError> {
        let link = Modbus::open(config.device.line.clone(), config.settings()).await?;
        Ok(Self::over(link, config, sensor, clock, simulated_hz))
    }

    fn over(
        link: Modbus,
        config: Config,
        sensor: &sensor::Sensor,
        clock: Arc<dyn Clock>,
        simulated_hz: Option<f64>,
    ) -> Self {
        Self {
            range_mm: sensor.range_mm,
            clock,
            link,
            counting: CounterTracker::new(config.map.round()),
            // A sensor that measures when it is read has no unchanged values.
            standing: match simulated_hz {
                Some(_) => None,
                None => FrozenValueDetector::of(&config.map, sensor, config.device.timeout),
            },
            simulated_hz,
            next_read: Instant::now(),
            config,
        }
    }

    /// Reads the registers, not before the next read is due.
    async fn read(&mut self) -> Result<Decoded, SensorError> {
        if self.simulated_hz.is_none() {
            if Instant::now() < self.next_read {
                sleep_until(self.next_read).await;
            }
            self.next_read = Instant::now().max(self.next_read + self.config.pace);
        }
        let span = self.config.map.span;
        let words = self.link.read(span.space, span.first, span.last - span.first + 1).await?;
        let read = self.config.map.read(&words);
        read.map_err(|error| SensorError::UnexpectedDevice {
            text: format!("registers {} to {}: {error}", span.first, span.last),
            remedy:
                "compare [sensor.modbus] with the sensor's manual: register, type, order; `nan` \
                     says what it means where there is no number"
                    .to_owned(),
        })
    }

    async fn sample(&mut self) -> Result<Sample, SensorError> {
        let said = self.read().await?.within(self.range_mm);
        if let (Some(standing), Ok(mm)) = (&mut self.standing, said.value)
            && standing.sees(mm, Instant::now())
        {
            return Ok(self.stale());
        }
        let mut sample = self.counting.follow(self.clock.now_s(), said);
        if !self.config.map.gaps {
            sample.missing = 0;
            if sample.flag == Flag::Gap {
                sample.flag = Flag::None;
            }
        }
        Ok(sample)
    }

    /// Describes the sensor, with the faults that cannot be detected.
    fn identity(&self) -> String {
        let unseen = match (self.config.map.round(), &self.standing, self.simulated_hz) {
            (Some(_), ..) | (_, _, Some(_)) => "",
            (None, Some(_), None) => {
                ", without a counter: that it stands is seen by its noise alone"
            }
            (None, None, None) => {
                ", without a counter: should its value stand, nobody sees it (noise_um of four counts or \
                 more would show it)"
            }
        };
        format!("Modbus sensor at {}{unseen}", self.config.at())
    }

    fn stale(&self) -> Sample {
        Sample::stale(self.clock.now_s())
    }
}

/// Whether the error counts as silence: no answer, or an invalid one; a later answer may come.
fn may_pass(error: &SensorError) -> bool {
    use ModbusError::{Late, Misfit, Unclear};
    matches!(error, SensorError::Modbus(Late { .. } | Misfit { .. } | Unclear { .. }))
}

impl Driver for Registers {
    async fn prepare(&mut self) -> Result<Prepared, SensorError> {
        self.counting.begin();
        // An error of the first read is reported.
        let first = self.read().await?;
        let mut rate_hz = self.simulated_hz.unwrap_or_default();
        if self.simulated_hz.is_none() {
            self.counting.follow(self.clock.now_s(), first);
            let begun = Instant::now();
            let mut count = 0;
            let all_the_same = |standing: &Option<FrozenValueDetector>, count: usize| {
                standing.as_ref().is_some_and(|seen| seen.times() as usize >= count)
            };
            while (count < ENOUGH || all_the_same(&self.standing, count))
                && begun.elapsed() < LISTEN.max(2 * self.config.device.timeout)
            {
                let stands = self.next().await?.flag == Flag::Stale;
                count += usize::from(!stands);
            }
            if count == 0 || self.standing.as_ref().is_some_and(FrozenValueDetector::stood) {
                return Err(SensorError::UnexpectedDevice {
                    text: "its registers stand: counter or value is always the same, or the status says \
                           so"
                        .to_owned(),
                    remedy: "see that the sensor measures; compare `counter` and `status` of \
                             [sensor.modbus] with its manual"
                        .to_owned(),
                });
            }
            rate_hz = count as f64 / begun.elapsed().as_secs_f64();
        }
        Ok(Prepared { identity: self.identity(), rate_hz })
    }

    async fn forget(&mut self) -> Result<(), SensorError> {
        self.counting.begin();
        if self.simulated_hz.is_some() || self.config.map.round().is_none() {
            return Ok(());
        }
        // The registers hold an earlier sample; the next one has another count.
        match self.read().await {
            Ok(said) => {
                self.counting.follow(self.clock.now_s(), said);
                Ok(())
            }
            Err(error) if may_pass(&error) => Ok(()),
            Err(error) => Err(error),
        }
    }

    async fn next(&mut self) -> Result<Sample, SensorError> {
        let end = Instant::now() + self.config.device.timeout;
        loop {
            match self.sample().await {
                Ok(sample) if sample.flag == Flag::Stale && Instant::now() < end => {}
                Err(error) if may_pass(&error) => return Ok(self.stale()),
                ended => return ended,
            }
        }
    }

    fn on_demand(&self) -> bool {
        self.simulated_hz.is_some()
    }
}

impl Named for Config {
    fn at(&self) -> String {
        self.device.in_full()
    }

    fn port(&self) -> Option<Port> {
        self.shared_port()
    }

    fn encoder_round(&self) -> Option<u64> {
        self.map.encoder_round()
    }

    fn open<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        clock: Arc<dyn Clock>,
        ports: &'a SharedPorts,
    ) -> Opening<'a> {
        Box::pin(async move {
            let link = ports.modbus(self.device.line.clone(), self.settings()).await?;
            let driver = Registers::over(link, self.clone(), sensor, clock, None);
            Ok(Sensor::spawn(sensor.name.as_str(), driver))
        })
    }
}
