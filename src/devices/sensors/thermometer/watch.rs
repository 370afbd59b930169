//! What thermometers said last, for whoever takes a reading: a look, and no waiting.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;
use tokio::time::{sleep, timeout};

use super::modbus::{Bus, Config};
use super::{Entry, Feel, Reached, ThermometerError, by_device, felt};

/// Before the first touch they have so long to say something: longer than a port may take to be let go of.
const PATIENCE: Duration = Duration::from_secs(6);
const LOOK: Duration = Duration::from_millis(10);
/// It is asked so often while what it said is true, between these two.
const ASKED: u32 = 4;
const PACES: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(5)];

/// Thermometers that are read until this is dropped.
pub struct Watch {
    all: Vec<Watched>,
    /// What polls them ends with it, after the request under way.
    _until: Vec<oneshot::Sender<()>>,
}

struct Watched {
    name: String,
    by: By,
}

enum By {
    Polled(Arc<Mutex<Said>>, Duration),
    /// Simulated time stands still meanwhile.
    Felt(Option<Feel>),
}

/// By one thermometer.
#[derive(Default)]
struct Said {
    newest: Option<(f64, Instant)>,
    /// Why it said nothing when it was asked last.
    why: Option<String>,
    asked: bool,
}

impl Watch {
    /// Read `entries` from now on; `feel` is what a simulated one of a name feels by, if there is anything.
    /// Call inside a tokio runtime.
    pub fn of(entries: &[Entry], feel: impl Fn(&str) -> Option<Feel>) -> Self {
        let (mut all, mut until) = (Vec::new(), Vec::new());
        for entry in entries.iter().filter(|entry| matches!(entry.reached, Reached::Simulated)) {
            all.push(Watched { name: entry.name.clone(), by: By::Felt(feel(&entry.name)) });
        }
        for of_device in by_device(entries).into_values() {
            let mut channels = Vec::new();
            for (entry, config) in &of_device {
                let said = Arc::new(Mutex::new(Said::default()));
                channels.push(((*config).clone(), said.clone()));
                all.push(Watched { name: entry.name.clone(), by: By::Polled(said, entry.stale) });
            }
            let soonest = of_device.iter().map(|(entry, _)| entry.stale).min().unwrap_or_default();
            let (keep, ended) = oneshot::channel();
            until.push(keep);
            tokio::spawn(poll(channels, (soonest / ASKED).clamp(PACES[0], PACES[1]), ended));
        }
        Self { all, _until: until }
    }

    /// Wait until each was asked once; not for long, and for nothing more.
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

    /// Each with what is true of it now, °C, or why nothing is.
    pub fn now(&self) -> Vec<(&str, Result<f64, String>)> {
        let now = |watched: &Watched| match &watched.by {
            By::Felt(feel) => felt(feel.as_ref()).map_err(|error| error.to_string()),
            By::Polled(said, stale) => locked(said).within(*stale),
        };
        self.all.iter().map(|watched| (watched.name.as_str(), now(watched))).collect()
    }
}

impl Said {
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

fn locked(said: &Mutex<Said>) -> std::sync::MutexGuard<'_, Said> {
    said.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One device, channel by channel.
async fn poll(
    channels: Vec<(Config, Arc<Mutex<Said>>)>,
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
        // Its sleep is cut short, never a request.
        if timeout(pace, &mut until).await.is_ok() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What it said last is true for a while, whatever it says then, and never again afterwards.
    #[test]
    fn what_was_said_is_true_for_a_while() {
        const HOUR: Duration = Duration::from_secs(3600);
        let mut said = Said::default();
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
