//! Last values of the thermometers, which a reading takes without waiting.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;
use tokio::time::{sleep, timeout};

use super::modbus::{Bus, Config};
use super::{Entry, Reached, SimulatedTemperature, ThermometerError, by_device, felt};

/// Maximum time for the first values before the first touch: longer than a port may take to be released.
const PATIENCE: Duration = Duration::from_secs(6);
const LOOK: Duration = Duration::from_millis(10);
/// Number of requests while a value is valid; the interval of the requests is between the two of `POLL_INTERVAL_LIMITS`.
const POLLS_PER_VALIDITY: u32 = 4;
const POLL_INTERVAL_LIMITS: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(5)];

/// Thermometers that are polled until this is dropped.
pub struct Watch {
    all: Vec<Watched>,
    /// Ends the polling tasks when it is dropped, after the request that is running.
    _until: Vec<oneshot::Sender<()>>,
}

struct Watched {
    name: String,
    by: By,
}

enum By {
    Polled(Arc<Mutex<LastValue>>, Duration),
    /// Simulated time does not advance during the read.
    Felt(Option<SimulatedTemperature>),
}

/// Values of one thermometer.
#[derive(Default)]
struct LastValue {
    newest: Option<(f64, Instant)>,
    /// Reason why the last request gave no value.
    why: Option<String>,
    asked: bool,
}

impl Watch {
    /// Starts to poll `entries`; `feel` returns the source of a simulated thermometer by its name, if there
    /// is one. Call inside a tokio runtime.
    pub fn of(entries: &[Entry], feel: impl Fn(&str) -> Option<SimulatedTemperature>) -> Self {
        let (mut all, mut until) = (Vec::new(), Vec::new());
        for entry in entries.iter().filter(|entry| matches!(entry.reached, Reached::Simulated)) {
            all.push(Watched { name: entry.name.clone(), by: By::Felt(feel(&entry.name)) });
        }
        for of_device in by_device(entries).into_values() {
            let mut channels = Vec::new();
            for (entry, config) in &of_device {
                let said = Arc::new(Mutex::new(LastValue::default()));
                channels.push(((*config).clone(), said.clone()));
                all.push(Watched { name: entry.name.clone(), by: By::Polled(said, entry.stale) });
            }
            let soonest = of_device.iter().map(|(entry, _)| entry.stale).min().unwrap_or_default();
            let (keep, ended) = oneshot::channel();
            until.push(keep);
            tokio::spawn(poll(
                channels,
                (soonest / POLLS_PER_VALIDITY)
                    .clamp(POLL_INTERVAL_LIMITS[0], POLL_INTERVAL_LIMITS[1]),
                ended,
            ));
        }
        Self { all, _until: until }
    }

    /// Waits until each thermometer was read once, at most for `PATIENCE`.
    pub async fn begun(&self) {
        let begun = Instant::now();
        let asked = |watched: &Watched| match &watched.by {
            By::Felt(_) => true,
            By::Polled(said, _) => locked(said).asked,
        };
        while !self.all.iter().all(asked) && begun.elapsed() < PATIENCE {
            sleep(LOOK).await;
        }
    }

    /// Returns each name with the valid temperature, °C, or the reason why there is none.
    pub fn now(&self) -> Vec<(&str, Result<f64, String>)> {
        let now = |watched: &Watched| match &watched.by {
            By::Felt(feel) => felt(feel.as_ref()).map_err(|error| error.to_string()),
            By::Polled(said, stale) => locked(said).within(*stale),
        };
        self.all.iter().map(|watched| (watched.name.as_str(), now(watched))).collect()
    }
}

impl LastValue {
    fn keep(&mut self, said: Result<f64, ThermometerError>) {
        self.asked = true;
        match said {
            Ok(celsius) => {
                (self.newest, self.why) = (Some((celsius, Instant::now())), None);
            }
            Err(error) => self.why = Some(error.to_string()),
        }
    }

    fn within(&self, stale: Duration) -> Result<f64, String> {
        match self.newest {
            Some((celsius, at)) if at.elapsed() <= stale => Ok(celsius),
            _ => Err(self.why.clone().unwrap_or_else(|| "it has not answered yet".to_owned())),
        }
    }
}

fn locked(said: &Mutex<LastValue>) -> std::sync::MutexGuard<'_, LastValue> {
    said.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Polls one device, channel by channel.
async fn poll(
    channels: Vec<(Config, Arc<Mutex<LastValue>>)>,
    pace: Duration,
    mut until: oneshot::Receiver<()>,
) {
    let mut bus = Bus::of(channels.iter().map(|(config, _)| config));
    loop {
        for (config, said) in &channels {
            let answer = bus.read(config).await;
            locked(said).keep(answer);
            if !matches!(until.try_recv(), Err(oneshot::error::TryRecvError::Empty)) {
                return;
            }
        }
        // The end interrupts the pause, never a request.
        if timeout(pace, &mut until).await.is_ok() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The last value is valid for a while, whatever the thermometer reports then, and never again
    /// afterwards.
    #[test]
    fn what_was_said_is_true_for_a_while() {
        const HOUR: Duration = Duration::from_secs(3600);
        let mut said = LastValue::default();
        assert!(said.within(HOUR).is_err());
        said.keep(Ok(21.5));
        assert_eq!(said.within(HOUR), Ok(21.5));
        said.keep(Err(ThermometerError::Nonsense { celsius: 850.0 }));
        assert_eq!(said.within(HOUR), Ok(21.5));
        std::thread::sleep(Duration::from_millis(2));
        let why = said.within(Duration::from_millis(1)).unwrap_err();
        assert!(why.contains("850.0 °C"), "{why}");
        said.keep(Ok(22.0));
        assert_eq!(said.within(HOUR), Ok(22.0));
    }
}
