//! Polls the thermometers and keeps their last values, so that a reading does not wait for them.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;
use tokio::time::{sleep, timeout};

use super::modbus::{ModbusThermometerConfig, ThermometerReader};
use super::{
    SimulatedTemperatureSource, ThermometerConfig, ThermometerError, ThermometerSource, group_by_device, read_simulated,
};

/// Maximum time to wait for the first values before the first touch: longer than a port may take to be released.
const MAX_FIRST_VALUES_WAIT: Duration = Duration::from_secs(6);
const FIRST_VALUES_CHECK_INTERVAL: Duration = Duration::from_millis(10);
/// Number of polls of a device during the shortest time for which a value of its thermometers is valid;
/// [`POLL_INTERVAL_LIMITS`] bounds the interval.
const POLLS_PER_MAX_AGE: u32 = 4;
/// Shortest and longest pause between two polls of a device.
const POLL_INTERVAL_LIMITS: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(5)];

/// Polls thermometers until the poller is dropped.
pub struct ThermometerPoller {
    thermometers: Vec<PolledThermometer>,
    /// Dropping the senders ends the polling tasks, each after the request that is running.
    _stop_senders: Vec<oneshot::Sender<()>>,
}

/// A thermometer of the poller, polled or simulated.
struct PolledThermometer {
    name: String,
    source: TemperatureSource,
}

/// Where the temperature of a thermometer comes from.
enum TemperatureSource {
    /// Last value, and the age up to which it is valid.
    Polled(Arc<Mutex<LastTemperature>>, Duration),
    /// Simulated temperature, computed at the read: simulated time does not advance meanwhile.
    Simulated(Option<SimulatedTemperatureSource>),
}

/// Last temperature of one thermometer, and its last error.
#[derive(Default)]
struct LastTemperature {
    /// Last temperature, °C, and the time of its read.
    temperature_c_and_read_time: Option<(f64, Instant)>,
    /// Reason why the last request gave no value; `None` if it gave a value.
    last_error: Option<Arc<ThermometerError>>,
}

impl ThermometerPoller {
    /// Starts to poll `entries`; `simulated` returns the source of a simulated thermometer by its name, if there
    /// is one. Call inside a tokio runtime.
    pub fn start(
        entries: &[ThermometerConfig],
        simulated: impl Fn(&str) -> Option<SimulatedTemperatureSource>,
    ) -> Self {
        let (mut thermometers, mut stop_senders) = (Vec::new(), Vec::new());
        for entry in entries.iter().filter(|entry| matches!(entry.source, ThermometerSource::Simulated)) {
            let source = TemperatureSource::Simulated(simulated(&entry.name));
            thermometers.push(PolledThermometer { name: entry.name.clone(), source });
        }
        for device in group_by_device(entries).into_values() {
            let mut channels = Vec::new();
            for (entry, config) in &device {
                let last_value = Arc::new(Mutex::new(LastTemperature::default()));
                channels.push(((*config).clone(), last_value.clone()));
                let source = TemperatureSource::Polled(last_value, entry.max_age);
                thermometers.push(PolledThermometer { name: entry.name.clone(), source });
            }
            let min_age = device.iter().map(|(entry, _)| entry.max_age).min().unwrap_or_default();
            let (stop_sender, stop_receiver) = oneshot::channel();
            stop_senders.push(stop_sender);
            let interval = (min_age / POLLS_PER_MAX_AGE).clamp(POLL_INTERVAL_LIMITS[0], POLL_INTERVAL_LIMITS[1]);
            tokio::spawn(poll_device(channels, interval, stop_receiver));
        }
        Self { thermometers, _stop_senders: stop_senders }
    }

    /// Waits until each thermometer was polled once, successfully or not, at most for `MAX_FIRST_VALUES_WAIT`.
    pub async fn wait_for_first_values(&self) {
        let start = Instant::now();
        let was_polled = |thermometer: &PolledThermometer| match &thermometer.source {
            TemperatureSource::Simulated(_) => true,
            TemperatureSource::Polled(last_value, _) => lock_last_value(last_value).was_polled(),
        };
        while !self.thermometers.iter().all(was_polled) && start.elapsed() < MAX_FIRST_VALUES_WAIT {
            sleep(FIRST_VALUES_CHECK_INTERVAL).await;
        }
    }

    /// Returns each name with the last temperature, °C, if it is not older than its maximum age, even after a later
    /// error; otherwise the reason why there is none. The simulated thermometers come first, then the others device by
    /// device.
    pub fn current_temperatures_c(&self) -> Vec<(&str, Result<f64, Arc<ThermometerError>>)> {
        let value = |thermometer: &PolledThermometer| match &thermometer.source {
            TemperatureSource::Simulated(simulated) => read_simulated(simulated.as_ref()).map_err(Arc::new),
            TemperatureSource::Polled(last_value, max_age) => lock_last_value(last_value).value_within(*max_age),
        };
        self.thermometers.iter().map(|thermometer| (thermometer.name.as_str(), value(thermometer))).collect()
    }
}

impl LastTemperature {
    /// Stores the result; an error does not replace the last temperature.
    fn record_poll_result(&mut self, result: Result<f64, ThermometerError>) {
        match result {
            Ok(celsius) => {
                (self.temperature_c_and_read_time, self.last_error) = (Some((celsius, Instant::now())), None)
            }
            Err(error) => self.last_error = Some(Arc::new(error)),
        }
    }

    /// Whether a poll has ended, successfully or not.
    fn was_polled(&self) -> bool {
        self.temperature_c_and_read_time.is_some() || self.last_error.is_some()
    }

    /// Returns the last temperature, °C, if its age is at most `max_age`; otherwise the last error.
    fn value_within(&self, max_age: Duration) -> Result<f64, Arc<ThermometerError>> {
        match self.temperature_c_and_read_time {
            Some((celsius, at)) if at.elapsed() <= max_age => Ok(celsius),
            _ => Err(self.last_error.clone().unwrap_or_else(|| Arc::new(ThermometerError::NoCurrentValue))),
        }
    }
}

fn lock_last_value(last_value: &Mutex<LastTemperature>) -> std::sync::MutexGuard<'_, LastTemperature> {
    last_value.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Polls one device, channel by channel.
async fn poll_device(
    channels: Vec<(ModbusThermometerConfig, Arc<Mutex<LastTemperature>>)>,
    interval: Duration,
    mut stop: oneshot::Receiver<()>,
) {
    let Some(mut reader) = ThermometerReader::for_device(channels.iter().map(|(config, _)| config)) else { return };
    loop {
        for (config, last_value) in &channels {
            let result = reader.read_temperature_c(config).await;
            lock_last_value(last_value).record_poll_result(result);
            if !matches!(stop.try_recv(), Err(oneshot::error::TryRecvError::Empty)) {
                return;
            }
        }
        // A stop interrupts the pause, never a request.
        if timeout(interval, &mut stop).await.is_ok() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A later error does not replace the last value before the value's maximum age.
    #[test]
    fn temperature_is_valid_for_a_limited_time() {
        const HOUR: Duration = Duration::from_secs(3600);
        let mut last_value = LastTemperature::default();
        assert!(last_value.value_within(HOUR).is_err());
        last_value.record_poll_result(Ok(21.5));
        assert_eq!(last_value.value_within(HOUR).unwrap(), 21.5);
        last_value.record_poll_result(Err(ThermometerError::ImplausibleValue { celsius: 850.0 }));
        assert_eq!(last_value.value_within(HOUR).unwrap(), 21.5);
        std::thread::sleep(Duration::from_millis(2));
        let why = last_value.value_within(Duration::from_millis(1)).unwrap_err().to_string();
        assert!(why.contains("850.0 °C"), "{why}");
        last_value.record_poll_result(Ok(22.0));
        assert_eq!(last_value.value_within(HOUR).unwrap(), 22.0);
    }
}
