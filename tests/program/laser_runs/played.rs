//! A control with time-stamped positions and a sensor, both without a wire, on a clock that their own actions
//! advance: every event during a pass occurs at the same sample each time. The value of the sensor is the distance
//! of X from the middle of the scan, so that each reading shows where it was taken.

use std::sync::{Arc, Mutex};

use devices::controllers::{self, Controller, ControllerError, DeviceInfo, Halt, MachineSnapshot};
use devices::sensors::{self, Sample, Sensor, SensorError};
use link::LinkError;
use link::{Clock, SharedPorts};
use machine::record::motion::{BlockOutcome, Motion};
use machine::record::reading::ReadingFlag;
use machine::record::sensor;
use machine::record::track::AxisTrack;
use machine::{Axis, Position};
use planning::gcode::Transmission;
use planning::proof::ProvenBlock;

pub const MIDDLE_MM: f64 = 80.0;
/// Z of the scans, and Z above which the surface is out of the sensor's range.
pub const SCAN_Z_MM: f64 = 220.0;
pub const RANGE_ENDS_Z_MM: f64 = 230.0;
pub const PERIOD_S: f64 = 1e-3;
/// Number of stamps that a control loses; time offset of a different clock.
const LOST: usize = 50;
const ELSEWHEN_S: f64 = 1e6;

/// Event during a pass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event {
    /// The sensor reports only this flag from now on.
    Says(ReadingFlag),
    /// This number of samples is lost, and the sensor's counter shows it.
    Loses(u32),
    /// The counter skips this number although no sample is missing.
    CountsAnew(u32),
    SensorGone,
    ControlGone,
    /// The operator requests a hold.
    Hold,
    /// Faults of the control's stamps: none at all; none from here on; none before; some missing; a different clock
    /// from here on; a different clock for all.
    NoTrack,
    TrackEnds,
    TrackBegins,
    TrackGap,
    StampsJump,
    OtherClock,
    /// The sensor sends nothing without a request.
    Mute,
    /// The sensor is this much lower than stated, mm, from the beginning.
    SitsLower(f64),
}

/// Step of a scan in motion, index of the sample, and the event at it.
pub type Plot = Option<(u32, usize, Event)>;

#[derive(Default)]
pub struct Scene {
    t_s: f64,
    pub stands: Position,
    moving: bool,
    /// Whether the sensor has a sample to send.
    due: bool,
    plot: Plot,
    /// Set when the event occurs.
    happens: Option<Event>,
    skipped: u32,
    /// Steps of the blocks that were begun, and the machine position when the event occurred.
    pub begun: Vec<u32>,
    pub stood: Option<Position>,
    /// All values that the sensor has sent.
    pub said: Vec<f64>,
}

pub type Shared = Arc<Mutex<Scene>>;

pub fn shared(stands: Position) -> Shared {
    Arc::new(Mutex::new(Scene { stands, ..Scene::default() }))
}

impl Scene {
    /// Current output of the sensor; none while the machine moves and has not advanced.
    fn sample(&mut self) -> Option<Result<Sample, SensorError>> {
        if self.moving && !std::mem::take(&mut self.due) {
            return None;
        }
        self.t_s += if self.moving { 0.0 } else { PERIOD_S };
        let value = self.stands.get_or_zero(Axis::X) - MIDDLE_MM;
        let (mut flag, mut missing) = (ReadingFlag::None, 0);
        match self.happens {
            Some(Event::SensorGone) => return Some(Err(lost("the sensor").into())),
            Some(Event::Says(bad)) => flag = bad,
            Some(Event::CountsAnew(count)) => {
                (flag, missing, self.happens) = (ReadingFlag::Gap, count, None);
            }
            Some(Event::Loses(count)) if self.skipped < count => {
                self.skipped += 1;
                // No sample comes; the machine continues to move.
                return None;
            }
            Some(Event::Loses(count)) => (flag, missing, self.happens) = (ReadingFlag::Gap, count, None),
            _ => {}
        }
        let lower = match self.plot {
            Some((_, _, Event::SitsLower(by))) => by,
            _ => 0.0,
        };
        if self.stands.get_or_zero(Axis::Z) > RANGE_ENDS_Z_MM + lower {
            flag = ReadingFlag::Range;
        }
        let value_mm = matches!(flag, ReadingFlag::None | ReadingFlag::Gap).then_some(value);
        self.said.extend(value_mm);
        Some(Ok(Sample { t_s: self.t_s, value_mm, flag, missing, encoder_count: None }))
    }

    /// Advances the control and the machine by one period.
    fn goes_on(&mut self, to: Position, (step, number): (u32, usize)) {
        self.t_s += PERIOD_S;
        (self.stands, self.moving, self.due) = (to, true, true);
        if let Some((_, _, event)) = self.plot.filter(|plot| (plot.0, plot.1) == (step, number)) {
            self.happens = Some(event);
            self.stood = Some(self.stands.clone());
        }
    }
}

fn lost(who: &str) -> LinkError {
    LinkError::Lost { address: who.to_owned(), why: "it is gone".to_owned() }
}

/// The clock of both.
pub struct Hands(pub Shared);

impl Clock for Hands {
    fn now_s(&self) -> f64 {
        self.0.lock().unwrap().t_s
    }
}

/// The sensor of a machine file.
#[derive(Clone)]
pub struct Eye(pub Shared);

impl std::fmt::Debug for Eye {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Eye")
    }
}

impl sensors::SensorConfig for Eye {
    fn describe_address(&self) -> String {
        "this test".to_owned()
    }

    fn open<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        _: Arc<dyn Clock>,
        _: &'a SharedPorts,
    ) -> sensors::OpenFuture<'a> {
        let eye = self.clone();
        Box::pin(async move { Ok(Sensor::spawn(sensor.name.clone(), eye)) })
    }
}

impl sensors::SensorDriver for Eye {
    async fn prepare(&mut self) -> Result<sensors::SensorInfo, SensorError> {
        Ok(sensors::SensorInfo { identity: "played".to_owned(), rate_hz: 1.0 / PERIOD_S })
    }

    async fn discard_old_samples(&mut self) -> Result<(), SensorError> {
        Ok(())
    }

    async fn next(&mut self) -> Result<Sample, SensorError> {
        loop {
            // Let other tasks advance as well.
            tokio::task::yield_now().await;
            if let Some(sample) = self.0.lock().unwrap().sample() {
                return sample;
            }
        }
    }

    fn is_on_demand(&self) -> bool {
        matches!(self.0.lock().unwrap().plot, Some((_, _, Event::Mute)))
    }
}

struct Control {
    scene: Shared,
    halt: Halt,
}

/// Opens the control of `scene` with the event `plot`.
pub fn control(scene: &Shared, plot: Plot) -> Controller {
    {
        let mut scene = scene.lock().unwrap();
        (scene.plot, scene.happens, scene.skipped, scene.moving) = (plot, None, 0, false);
        scene.stood = None;
        scene.begun.clear();
    }
    let halt = Halt::new(|| {});
    Controller::spawn(Control { scene: scene.clone(), halt: halt.clone() }, halt)
}

/// Target of a motion, and its speed in mm/s.
fn lead(motion: &Motion) -> Option<(&Position, f64)> {
    match motion {
        Motion::Rapid { to } => Some((to, 1000.0)),
        Motion::Feed { to, feed_mm_min } => Some((to, feed_mm_min / 60.0)),
        _ => None,
    }
}

/// All positions from one to the other, one period apart.
fn way(from: &Position, to: &Position, speed: f64) -> Vec<Position> {
    let to = from.updated_by(to);
    let far = from.iter().map(|(axis, at)| (to.get_or_zero(axis) - at).abs()).fold(0.0, f64::max);
    let count = (far / (speed * PERIOD_S)).ceil().max(1.0) as usize;
    let place =
        |part: f64| from.iter().map(|(axis, at)| (axis, at + part * (to.get_or_zero(axis) - at))).collect::<Position>();
    (1..=count).map(|k| place(k as f64 / count as f64)).collect()
}

impl Control {
    /// Waits until the sensor has sent a sample at the position; a sensor that is not monitored sends none.
    async fn told(&self) -> Result<(), ControllerError> {
        loop {
            {
                let scene = self.scene.lock().unwrap();
                match scene.happens {
                    Some(Event::Hold) => self.halt.trigger(),
                    Some(Event::ControlGone) => return Err(lost("the control").into()),
                    _ => {}
                }
                if self.halt.is_halted() {
                    return Err(ControllerError::Halted);
                }
                if !scene.due || matches!(scene.plot, Some((_, _, Event::Mute))) {
                    return Ok(());
                }
            }
            tokio::task::yield_now().await;
        }
    }

    fn stamp(&self, track: &mut AxisTrack, lost: &mut usize) {
        let scene = self.scene.lock().unwrap();
        let mut t_s = scene.t_s;
        match scene.happens {
            Some(Event::TrackEnds) => return,
            Some(Event::TrackGap) if *lost < LOST => {
                *lost += 1;
                return track.record_gap();
            }
            Some(Event::TrackBegins) if *lost == 0 => {
                *lost = LOST;
                *track = AxisTrack::new(scene.stands.iter().map(|(axis, _)| axis).collect());
            }
            Some(Event::StampsJump) => t_s -= ELSEWHEN_S,
            _ => {}
        }
        if matches!(scene.plot, Some((_, _, Event::OtherClock))) {
            t_s += ELSEWHEN_S;
        }
        track.push(t_s, scene.stands.iter().map(|(_, at)| at));
    }

    async fn go(&self, block: &ProvenBlock) -> Result<AxisTrack, ControllerError> {
        let level = |motion: &Motion| matches!(motion, Motion::Feed { to, .. } if to.get(Axis::Z).is_none());
        let sweeps = block.motions().count() > 1 && block.motions().all(level);
        let mut from = {
            let mut scene = self.scene.lock().unwrap();
            // Samples at rest are complete.
            scene.t_s += PERIOD_S;
            scene.stands.clone()
        };
        let mut track = AxisTrack::new(from.iter().map(|(axis, _)| axis).collect());
        let (mut lost, mut number) = (0, 0);
        self.stamp(&mut track, &mut lost);
        for (to, speed) in block.motions().filter_map(lead) {
            for place in way(&from, to, speed) {
                number += usize::from(sweeps);
                self.scene.lock().unwrap().goes_on(place, (block.step(), number));
                self.stamp(&mut track, &mut lost);
                self.told().await?;
            }
            from = self.scene.lock().unwrap().stands.clone();
        }
        Ok(track)
    }
}

impl controllers::Driver for Control {
    async fn prepare(&mut self) -> Result<controllers::PreparedControl, ControllerError> {
        let stands = self.scene.lock().unwrap().stands.clone();
        Ok(controllers::PreparedControl {
            identity: "played".to_owned(),
            stop_description: "at once".to_owned(),
            position: stands,
            transmission: Transmission::Rows,
            unreadable_items: Vec::new(),
        })
    }

    async fn execute(&mut self, block: ProvenBlock) -> Result<BlockOutcome, ControllerError> {
        self.scene.lock().unwrap().begun.push(block.step());
        if self.halt.is_halted() {
            return Err(ControllerError::Halted);
        }
        let gone = self.go(&block).await;
        let mut scene = self.scene.lock().unwrap();
        scene.moving = false;
        let none = matches!(scene.happens, Some(Event::NoTrack));
        Ok(BlockOutcome { track: Some(gone?).filter(|_| !none), ..BlockOutcome::default() })
    }

    async fn read_snapshot(&mut self) -> Result<MachineSnapshot, ControllerError> {
        let stands = self.scene.lock().unwrap().stands.clone();
        Ok(MachineSnapshot { is_probe_closed: false, position: stands })
    }

    async fn identify_device(&mut self) -> Result<DeviceInfo, ControllerError> {
        Ok(DeviceInfo::default())
    }

    fn can_record_track(&self) -> bool {
        true
    }

    async fn finish(&mut self) -> Result<(), ControllerError> {
        Ok(())
    }
}
