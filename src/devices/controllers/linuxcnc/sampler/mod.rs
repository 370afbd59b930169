//! Client of LinuxCNC's HAL component `sampler`, which records the positions of the axes in each period of
//! the servo thread; `halsampler -t` on that computer writes them to its TCP client. A task reads the
//! positions all the time; they are kept while a block runs that needs them. `docs/linuxcnc-sampler.md`
//! describes the set-up.

mod record;
#[cfg(test)]
mod tests;
mod ticks;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde::Deserialize;
use tokio::time::{Instant, sleep};

use self::record::{Record, TickPositions};
use super::not_ready::not_ready;
use crate::controllers::ControllerError;
use link::Clock;
use link::{Address, ByteStreamHandle, HostPort, StreamRead};
use machine::record::track::Track;
use machine::{Axis, Position};

/// Time for which the stream is observed before anything moves, to check its period.
const LISTEN: Duration = Duration::from_millis(1300);
const GATHERED: Duration = Duration::from_millis(100);
/// Maximum time that a tick may take to arrive: a pipe may hold 4096 bytes, and a network delays by up to a
/// second.
const ON_THE_WAY: Duration = Duration::from_secs(3);
const POLL: Duration = Duration::from_millis(5);
/// Interval at which the task checks whether its handle still exists.
const WANTED: Duration = Duration::from_secs(1);
/// Largest difference between two reports of the same axis position, mm and rad: axes under control are
/// never quite at rest.
const SAME_MM: f64 = 0.01;
const SAME_RAD: f64 = 0.001;
const RECIPE: &str = "docs/linuxcnc-sampler.md has its halcmd lines";

/// Keys of `[controller.sampler]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Config {
    tcp: HostPort,
    period_s: f64,
    axes: Option<Vec<Axis>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    /// Address at which the output of `halsampler -t` can be read.
    tcp: HostPort,
    /// Period of the servo thread, s.
    #[serde(default = "usual_period")]
    period_s: f64,
    /// Axes in the order of the sampler's pins; if absent, the machine's axes in the order X Y Z A B C.
    axes: Option<Vec<Axis>>,
}

fn usual_period() -> f64 {
    0.001
}

impl TryFrom<Keys> for Config {
    type Error = String;

    fn try_from(Keys { tcp, period_s, axes }: Keys) -> Result<Self, String> {
        if !(1e-5..=0.1).contains(&period_s) {
            return Err(format!(
                "`period_s` is {period_s}; it is the servo thread's period, 0.00001 to 0.1 s"
            ));
        }
        let doubled = |axes: &Vec<Axis>| {
            axes.iter().enumerate().any(|(i, axis)| *axis == Axis::S || axes[..i].contains(axis))
        };
        if axes.as_ref().is_some_and(doubled) {
            return Err(
                "`axes` names each axis once, in the order of the sampler's pins; S is none \
                        of them"
                    .to_owned(),
            );
        }
        Ok(Self { tcp, period_s, axes })
    }
}

/// Handle that the driver holds. Its task ends when it is dropped.
pub struct Sampler {
    name: String,
    period_s: f64,
    clock: Arc<dyn Clock>,
    record: Arc<Mutex<Heard>>,
    /// The control's unit of length, mm, once it is known.
    mm: f64,
}

struct Heard {
    record: Record,
    /// Reason why no more positions will come.
    lost: Option<String>,
}

impl Sampler {
    /// Connects to the address of `config`; `axes` are the machine's axes. Call inside a tokio runtime.
    ///
    /// # Errors
    /// Nothing listens at the address.
    pub async fn open(
        config: &Config,
        axes: &[Axis],
        clock: Arc<dyn Clock>,
    ) -> Result<Self, ControllerError> {
        let own = || axes.iter().copied().filter(|axis| *axis != Axis::S).collect();
        let axes = config.axes.clone().unwrap_or_else(own);
        let address = Address::from(&config.tcp);
        let name = format!("the sampler at {address}");
        let flow = link::listen(&address).await.map_err(|error| {
            let state = format!("{name} is not there: {error}");
            not_ready(&state, &format!("start it beside LinuxCNC: {RECIPE}"))
        })?;
        let heard = Heard { record: Record::of(axes, config.period_s), lost: None };
        let record = Arc::new(Mutex::new(heard));
        tokio::spawn(listen(flow, Arc::downgrade(&record), clock.clone()));
        Ok(Self { name, period_s: config.period_s, clock, record, mm: 1.0 })
    }

    /// Describes the sampler in words.
    pub(super) fn says(&self) -> String {
        format!("positions stamped every {} ms by {}", self.period_s * 1e3, self.name)
    }

    fn heard(&self) -> MutexGuard<'_, Heard> {
        self.record.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Checks that the sampler is running, has the configured period and agrees with the control, whose
    /// axes are at `stands`; `mm` is the control's unit of length, mm.
    pub(super) async fn agrees(
        &mut self,
        stands: &Position,
        axes: &[Axis],
        mm: f64,
    ) -> Result<(), ControllerError> {
        self.mm = mm;
        let wanted = axes.iter().filter(|axis| **axis != Axis::S);
        if let Some(axis) = wanted.into_iter().find(|a| !self.heard().record.axes().contains(a)) {
            return Err(not_ready(
                &format!("{} does not take down axis {axis}", self.name),
                "name it in [controller.sampler] axes, and give it a pin of the sampler",
            ));
        }
        let silent = |name: &str, why: String| {
            not_ready(&format!("{name}: {why}"), &format!("see that it runs: {RECIPE}"))
        };
        // Positions buffered before the connection arrive at once.
        self.until(f64::NEG_INFINITY).await.map_err(|why| silent(&self.name, why))?;
        sleep(GATHERED).await;
        let before = self.heard().record.newest.as_ref().map(|stands| stands.tick);
        sleep(LISTEN).await;
        let now_s = self.clock.now_s();
        let newest = self.until(now_s).await.map_err(|why| silent(&self.name, why))?;
        let period_s = before.and_then(|tick| self.heard().record.ticks.wrong_period_s(tick));
        if let Some(period_s) = period_s {
            return Err(not_ready(
                &format!("{} counts every {:.3} ms", self.name, period_s * 1e3),
                "set [controller.sampler] period_s to the servo thread's period (`halcmd show thread`)",
            ));
        }
        let other = self.other(&newest, stands);
        other.map_or(Ok(()), |other| Err(not_ready(&other, &elsewhere())))
    }

    /// Starts to keep positions.
    pub(super) fn begin(&self) {
        self.heard().record.begin();
    }

    /// Returns all positions since [`Self::begin`]; the machine has come to rest at `stands` after `step`.
    pub(super) async fn end(&self, step: u32, stands: &Position) -> Result<Track, ControllerError> {
        let unstamped = |why, remedy| ControllerError::Unstamped { step, why, remedy };
        let newest = self.until(self.clock.now_s()).await.map_err(|why| {
            unstamped(format!("{}: {why}", self.name), format!("see that it runs: {RECIPE}"))
        })?;
        let track = self.heard().record.end(self.mm);
        if let Some(other) = self.other(&newest, stands) {
            return Err(unstamped(other, elsewhere()));
        }
        track.ok_or_else(|| {
            unstamped(
                "the scan took longer than positions are kept".to_owned(),
                "make it shorter or faster: at 1 kHz a quarter of an hour is kept".to_owned(),
            )
        })
    }

    /// Discards the kept positions.
    pub(super) fn give_up(&self) {
        self.heard().record.end(self.mm);
    }

    /// Waits for a tick later than `t_s`; the error is the reason why none comes.
    async fn until(&self, t_s: f64) -> Result<TickPositions, String> {
        let end = Instant::now() + ON_THE_WAY;
        loop {
            {
                let heard = self.heard();
                if let Some(why) = &heard.lost {
                    return Err(format!("it is lost: {why}"));
                }
                let newest = heard.record.newest.as_ref();
                let was = newest.and_then(|newest| heard.record.ticks.time_s(newest.tick));
                if let Some(newest) = newest.filter(|_| was.is_some_and(|was| was > t_s)) {
                    return Ok(newest.clone());
                }
                if Instant::now() > end {
                    return Err(match &heard.record.strange {
                        Some(line) if newest.is_none() => format!(
                            "it says `{line}`, not a number, {} positions and a bit",
                            heard.record.axes().len()
                        ),
                        _ => format!("it says nothing new for {} s", ON_THE_WAY.as_secs()),
                    });
                }
            }
            sleep(POLL).await;
        }
    }

    /// Describes a difference between the positions of the sampler and of the control.
    fn other(&self, newest: &TickPositions, stands: &Position) -> Option<String> {
        let heard = self.heard();
        let said: Vec<f64> = heard.record.inside(&newest.at, self.mm).collect();
        let mut axes = heard.record.axes().iter().zip(said);
        let far = |axis: Axis, said: f64| {
            let same = if axis.is_linear() { SAME_MM } else { SAME_RAD };
            stands.get(axis).is_some_and(|stands| (stands - said).abs() > same)
        };
        let (axis, said) = axes.find(|(axis, said)| far(**axis, *said))?;
        let (at, said) = (axis.to_edge(stands.at(*axis)), axis.to_edge(said));
        Some(format!("{axis} stands at {at:.3}, and {} says {said:.3}", self.name))
    }
}

fn elsewhere() -> String {
    format!(
        "its pins must be joint.N.pos-fb, one for each of [controller.sampler] axes in their order: {RECIPE}"
    )
}

/// Task: reads the stream until the handle is dropped or the stream ends.
async fn listen(
    mut flow: ByteStreamHandle,
    record: std::sync::Weak<Mutex<Heard>>,
    clock: Arc<dyn Clock>,
) {
    loop {
        let came = flow.recv_deadline(Instant::now() + WANTED).await;
        let Some(record) = record.upgrade() else { return };
        let mut heard = record.lock().unwrap_or_else(PoisonError::into_inner);
        match came {
            Ok(None) => {}
            Ok(Some(StreamRead::Bytes(at, bytes))) => {
                let at_s = clock.now_s() - at.elapsed().as_secs_f64();
                heard.record.came(&bytes, at_s);
            }
            Ok(Some(StreamRead::Forgotten)) => heard.record.missed(),
            Err(error) => {
                heard.lost = Some(error.to_string());
                return;
            }
        }
    }
}
