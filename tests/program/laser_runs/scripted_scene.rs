//! A control with time-stamped positions and a sensor, both called without a connection, on a clock that their own
//! actions advance: every event during a pass occurs at the same sample each time. The value of the sensor is the
//! distance of X from the middle of the scan, so that each reading shows where it was taken.

use std::sync::{Arc, Mutex};

use devices::controllers::{self, Controller, ControllerError, DeviceInfo, HaltHandle, MachineSnapshot};
use devices::sensors::{self, Sample, SensorError, SensorHandle};
use link::LinkError;
use link::{Clock, SharedPorts};
use machine::record::axis_track::AxisTrack;
use machine::record::motion::{Motion, MotionBlockOutcome};
use machine::record::reading::ReadingFlag;
use machine::record::sensor;
use machine::{Axis, Position};
use planning::gcode::TransmissionForm;
use planning::proof::ProvenBlock;

pub const SCAN_MIDDLE_X_MM: f64 = 80.0;
/// Z of the scans, and Z above which the surface is out of the sensor's range.
pub const SCAN_Z_MM: f64 = 220.0;
pub const SENSOR_RANGE_UPPER_Z_MM: f64 = 230.0;
pub const SAMPLE_PERIOD_S: f64 = 1e-3;
/// Number of stamps that a control loses.
const LOST_STAMP_COUNT: usize = 50;
/// Time offset of a different clock.
const OTHER_CLOCK_OFFSET_S: f64 = 1e6;

/// Event during a pass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ScriptedEvent {
    /// The sensor reports only this flag from now on.
    FlagAllSamples(ReadingFlag),
    /// This number of samples is lost, and the sensor's counter shows it.
    LostSamples(u32),
    /// The counter skips this number although no sample is missing.
    CounterSkips(u32),
    SensorLinkLost,
    ControlLinkLost,
    /// The operator requests a hold.
    OperatorHold,
    /// The control reports no time-stamped positions.
    NoTrack,
    /// It reports none from here on.
    TrackEndsEarly,
    /// It reports none before the event.
    TrackBeginsLate,
    /// Some stamped positions are missing.
    TrackGap,
    /// The stamps are those of a different clock from here on.
    StampsJump,
    /// All stamps are those of a different clock.
    OtherClock,
    /// The sensor sends nothing without a request.
    OnDemandSensor,
    /// The sensor is this much lower than stated, mm, from the beginning.
    SensorLowerByMm(f64),
}

/// Step of a scan in motion, index of the sample, and the event at it.
pub type StepSampleEvent = Option<(u32, usize, ScriptedEvent)>;

#[derive(Default)]
pub struct SimulatedScene {
    clock_s: f64,
    pub position: Position,
    is_moving: bool,
    /// Whether the sensor has a sample to send.
    is_sample_due: bool,
    scheduled_event: StepSampleEvent,
    /// Set when the event occurs.
    current_event: Option<ScriptedEvent>,
    lost_sample_count: u32,
    /// Steps of the blocks that were begun.
    pub started_steps: Vec<u32>,
    /// Machine position when the event occurred.
    pub position_at_event: Option<Position>,
    /// All values that the sensor has sent.
    pub reported_values_mm: Vec<f64>,
}

pub type SharedScene = Arc<Mutex<SimulatedScene>>;

pub fn new_shared_scene(position: Position) -> SharedScene {
    Arc::new(Mutex::new(SimulatedScene { position, ..SimulatedScene::default() }))
}

impl SimulatedScene {
    /// Current output of the sensor; none while the machine moves and has not advanced.
    fn take_sample(&mut self) -> Option<Result<Sample, SensorError>> {
        if self.is_moving && !std::mem::take(&mut self.is_sample_due) {
            return None;
        }
        self.clock_s += if self.is_moving { 0.0 } else { SAMPLE_PERIOD_S };
        let value = self.position.get_or_zero(Axis::X) - SCAN_MIDDLE_X_MM;
        let (mut flag, mut missing) = (ReadingFlag::None, 0);
        match self.current_event {
            Some(ScriptedEvent::SensorLinkLost) => return Some(Err(link_lost_error("the sensor").into())),
            Some(ScriptedEvent::FlagAllSamples(bad)) => flag = bad,
            Some(ScriptedEvent::CounterSkips(count)) => {
                (flag, missing, self.current_event) = (ReadingFlag::Gap, count, None);
            }
            Some(ScriptedEvent::LostSamples(count)) if self.lost_sample_count < count => {
                self.lost_sample_count += 1;
                // No sample comes; the machine continues to move.
                return None;
            }
            Some(ScriptedEvent::LostSamples(count)) => {
                (flag, missing, self.current_event) = (ReadingFlag::Gap, count, None)
            }
            _ => {}
        }
        let lower = match self.scheduled_event {
            Some((_, _, ScriptedEvent::SensorLowerByMm(by))) => by,
            _ => 0.0,
        };
        if self.position.get_or_zero(Axis::Z) > SENSOR_RANGE_UPPER_Z_MM + lower {
            flag = ReadingFlag::Range;
        }
        let value_mm = matches!(flag, ReadingFlag::None | ReadingFlag::Gap).then_some(value);
        self.reported_values_mm.extend(value_mm);
        Some(Ok(Sample { received_s: self.clock_s, value_mm, flag, lost_before_count: missing, encoder_count: None }))
    }

    /// Advances the control and the machine by one period.
    fn advance_one_period(&mut self, to: Position, (step, number): (u32, usize)) {
        self.clock_s += SAMPLE_PERIOD_S;
        (self.position, self.is_moving, self.is_sample_due) = (to, true, true);
        if let Some((_, _, event)) = self.scheduled_event.filter(|plot| (plot.0, plot.1) == (step, number)) {
            self.current_event = Some(event);
            self.position_at_event = Some(self.position.clone());
        }
    }
}

fn link_lost_error(who: &str) -> LinkError {
    LinkError::Lost { address: who.to_owned(), why: "it is gone".to_owned() }
}

/// Clock of the scene, for the control and the sensor.
pub struct SceneClock(pub SharedScene);

impl Clock for SceneClock {
    fn now_s(&self) -> f64 {
        self.0.lock().unwrap().clock_s
    }
}

/// The sensor of a scene, in place of the one of a machine file.
#[derive(Clone)]
pub struct SceneSensor(pub SharedScene);

impl std::fmt::Debug for SceneSensor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Eye")
    }
}

impl sensors::SensorConfig for SceneSensor {
    fn describe_address(&self) -> String {
        "this test".to_owned()
    }

    fn open_sensor<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        _: Arc<dyn Clock>,
        _: &'a SharedPorts,
    ) -> sensors::OpenSensorFuture<'a> {
        let eye = self.clone();
        Box::pin(async move { Ok(SensorHandle::spawn(sensor.name.clone(), eye)) })
    }
}

impl sensors::SensorDriver for SceneSensor {
    async fn prepare(&mut self) -> Result<sensors::SensorInfo, SensorError> {
        Ok(sensors::SensorInfo { identity: "played".to_owned(), sample_rate_hz: 1.0 / SAMPLE_PERIOD_S })
    }

    async fn discard_old_samples(&mut self) -> Result<(), SensorError> {
        Ok(())
    }

    async fn next(&mut self) -> Result<Sample, SensorError> {
        loop {
            // Let other tasks advance as well.
            tokio::task::yield_now().await;
            if let Some(sample) = self.0.lock().unwrap().take_sample() {
                return sample;
            }
        }
    }

    fn is_simulated_on_demand(&self) -> bool {
        matches!(self.0.lock().unwrap().scheduled_event, Some((_, _, ScriptedEvent::OnDemandSensor)))
    }
}

struct SceneControl {
    scene: SharedScene,
    halt: HaltHandle,
}

/// Opens the control of `scene` with the event `plot`.
pub fn spawn_scene_controller(scene: &SharedScene, plot: StepSampleEvent) -> Controller {
    {
        let mut scene = scene.lock().unwrap();
        (scene.scheduled_event, scene.current_event, scene.lost_sample_count, scene.is_moving) = (plot, None, 0, false);
        scene.position_at_event = None;
        scene.started_steps.clear();
    }
    let halt = HaltHandle::new(|| {});
    Controller::spawn(SceneControl { scene: scene.clone(), halt: halt.clone() }, halt)
}

/// Target of a motion, and its speed in mm/s.
fn motion_target_and_speed_mm_s(motion: &Motion) -> Option<(&Position, f64)> {
    match motion {
        Motion::Rapid { to } => Some((to, 1000.0)),
        Motion::Feed { to, feed_mm_min } => Some((to, feed_mm_min / 60.0)),
        _ => None,
    }
}

/// All positions from `from` (excluded) to `to`, one sample period apart.
fn positions_per_sample_period(from: &Position, to: &Position, speed: f64) -> Vec<Position> {
    let to = from.updated_by(to);
    let far = from.iter().map(|(axis, at)| (to.get_or_zero(axis) - at).abs()).fold(0.0, f64::max);
    let count = (far / (speed * SAMPLE_PERIOD_S)).ceil().max(1.0) as usize;
    let place =
        |part: f64| from.iter().map(|(axis, at)| (axis, at + part * (to.get_or_zero(axis) - at))).collect::<Position>();
    (1..=count).map(|k| place(k as f64 / count as f64)).collect()
}

impl SceneControl {
    /// Waits until the sensor has sent a sample at the position; a sensor that is not monitored sends none.
    async fn wait_for_sample(&self) -> Result<(), ControllerError> {
        loop {
            {
                let scene = self.scene.lock().unwrap();
                match scene.current_event {
                    Some(ScriptedEvent::OperatorHold) => self.halt.trigger(),
                    Some(ScriptedEvent::ControlLinkLost) => return Err(link_lost_error("the control").into()),
                    _ => {}
                }
                if self.halt.is_halt_requested() {
                    return Err(ControllerError::Halted);
                }
                if !scene.is_sample_due || matches!(scene.scheduled_event, Some((_, _, ScriptedEvent::OnDemandSensor)))
                {
                    return Ok(());
                }
            }
            tokio::task::yield_now().await;
        }
    }

    fn push_stamped_position(&self, track: &mut AxisTrack, lost: &mut usize) {
        let scene = self.scene.lock().unwrap();
        let mut t_s = scene.clock_s;
        match scene.current_event {
            Some(ScriptedEvent::TrackEndsEarly) => return,
            Some(ScriptedEvent::TrackGap) if *lost < LOST_STAMP_COUNT => {
                *lost += 1;
                return track.record_gap();
            }
            Some(ScriptedEvent::TrackBeginsLate) if *lost == 0 => {
                *lost = LOST_STAMP_COUNT;
                *track = AxisTrack::new(scene.position.iter().map(|(axis, _)| axis).collect());
            }
            Some(ScriptedEvent::StampsJump) => t_s -= OTHER_CLOCK_OFFSET_S,
            _ => {}
        }
        if matches!(scene.scheduled_event, Some((_, _, ScriptedEvent::OtherClock))) {
            t_s += OTHER_CLOCK_OFFSET_S;
        }
        track.push(t_s, scene.position.iter().map(|(_, at)| at));
    }

    async fn move_and_record_track(&self, block: &ProvenBlock) -> Result<AxisTrack, ControllerError> {
        let level = |motion: &Motion| matches!(motion, Motion::Feed { to, .. } if to.get(Axis::Z).is_none());
        let sweeps = block.motions().count() > 1 && block.motions().all(level);
        let mut from = {
            let mut scene = self.scene.lock().unwrap();
            // Samples at rest are complete.
            scene.clock_s += SAMPLE_PERIOD_S;
            scene.position.clone()
        };
        let mut track = AxisTrack::new(from.iter().map(|(axis, _)| axis).collect());
        let (mut lost, mut number) = (0, 0);
        self.push_stamped_position(&mut track, &mut lost);
        for (to, speed) in block.motions().filter_map(motion_target_and_speed_mm_s) {
            for place in positions_per_sample_period(&from, to, speed) {
                number += usize::from(sweeps);
                self.scene.lock().unwrap().advance_one_period(place, (block.step(), number));
                self.push_stamped_position(&mut track, &mut lost);
                self.wait_for_sample().await?;
            }
            from = self.scene.lock().unwrap().position.clone();
        }
        Ok(track)
    }
}

impl controllers::ControllerDriver for SceneControl {
    async fn prepare(&mut self) -> Result<controllers::PreparedControl, ControllerError> {
        let stands = self.scene.lock().unwrap().position.clone();
        Ok(controllers::PreparedControl {
            identity: "played".to_owned(),
            stop_description: "at once".to_owned(),
            position: stands,
            transmission: TransmissionForm::TableRows,
            unreadable_items: Vec::new(),
        })
    }

    async fn execute(&mut self, block: ProvenBlock) -> Result<MotionBlockOutcome, ControllerError> {
        self.scene.lock().unwrap().started_steps.push(block.step());
        if self.halt.is_halt_requested() {
            return Err(ControllerError::Halted);
        }
        let gone = self.move_and_record_track(&block).await;
        let mut scene = self.scene.lock().unwrap();
        scene.is_moving = false;
        let none = matches!(scene.current_event, Some(ScriptedEvent::NoTrack));
        Ok(MotionBlockOutcome { track: Some(gone?).filter(|_| !none), ..MotionBlockOutcome::default() })
    }

    async fn read_snapshot(&mut self) -> Result<MachineSnapshot, ControllerError> {
        let stands = self.scene.lock().unwrap().position.clone();
        Ok(MachineSnapshot { is_probe_closed: false, position: stands })
    }

    async fn identify_device(&mut self) -> Result<DeviceInfo, ControllerError> {
        Ok(DeviceInfo::default())
    }

    fn can_record_track(&self) -> bool {
        true
    }

    async fn restore_modes(&mut self) -> Result<(), ControllerError> {
        Ok(())
    }
}
