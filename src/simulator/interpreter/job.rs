//! One job of a simulated control, executed at once or in real time.

use std::time::Duration;

use crate::{LatchedContact, ProbeResult, SimulatedWorld, Speed};
use machine::{Axis, Position};

/// Action that a line requests. Positions are machine coordinates of the axes that move, mm or rad.
#[derive(Debug, Clone, PartialEq)]
pub enum Job {
    /// Straight move without monitoring of the probe. `feed_mm_min`: deg/min if only rotary axes move; `None` for G0.
    Travel {
        to: Position,
        feed_mm_min: Option<f64>,
    },
    /// `alarms_on_miss`: a move without contact raises an alarm (G38.2). `n`: the N word of the line (0: none) or the
    /// plan step of a table; it selects the touch scatter.
    Probe {
        to: Position,
        feed_mm_min: f64,
        alarms_on_miss: bool,
        n: u32,
    },
    /// Orientation of the spindle, rad.
    OrientSpindle {
        s: f64,
    },
    Dwell {
        seconds: f64,
    },
}

/// Simulated error of the probe input.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ProbeInputFault {
    #[default]
    NoFault,
    /// The input reads closed: the controls refuse a probing move with an alarm.
    StuckClosed,
    /// The input reads open; probing moves reach their target without contact.
    StuckOpen,
    /// The next probing move meets an obstacle, and reports a contact, after two fifths of its path.
    ObstacleOnNextProbe,
    /// The stylus will be brushed during the next rapid or rotary move.
    BrushPending,
    /// The stylus is brushed; number of further reports that read closed.
    BrushedForReports(u8),
}

impl ProbeInputFault {
    /// Whether the probe input reads closed.
    pub fn is_probe_closed(self, world: &SimulatedWorld) -> bool {
        match self {
            Self::StuckClosed | ProbeInputFault::BrushedForReports(_) => true,
            Self::StuckOpen => false,
            Self::NoFault | ProbeInputFault::ObstacleOnNextProbe | Self::BrushPending => world.is_probe_closed(),
        }
    }

    /// Fault state after one more report has contained the state of the probe input.
    pub fn after_report(self) -> Self {
        match self {
            ProbeInputFault::BrushedForReports(0..=1) => Self::NoFault,
            ProbeInputFault::BrushedForReports(left) => ProbeInputFault::BrushedForReports(left - 1),
            probe_fault => probe_fault,
        }
    }

    /// Makes the probing move in the world, with the fault of the input.
    fn run_probing_move(self, world: &mut SimulatedWorld, to: &Position, feed_mm_min: f64, n: u32) -> ProbeResult {
        let from = world.displayed_position();
        let at_obstacle = |(axis, end)| (axis, from.get_or_zero(axis) + 0.4 * (end - from.get_or_zero(axis)));
        let end_position: Position = match self {
            Self::NoFault | Self::StuckClosed | Self::BrushPending | ProbeInputFault::BrushedForReports(_) => {
                return world.probe(to, feed_mm_min, n);
            }
            Self::StuckOpen => to.clone(),
            ProbeInputFault::ObstacleOnNextProbe => to.iter().map(at_obstacle).collect(),
        };
        let moved = world.travel(&end_position, Speed::Feed { mm_min: feed_mm_min });
        let contact = LatchedContact { latched_position: world.displayed_position(), latch_time_s: world.time_s() };
        ProbeResult {
            contact: (self == ProbeInputFault::ObstacleOnNextProbe).then_some(contact),
            has_crashed: moved.has_crashed,
            duration_s: moved.duration_s,
        }
    }
}

/// How simulated time relates to host time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SimulationPace {
    /// Moves end at once.
    Immediate,
    /// Moves take their real duration.
    RealTime,
}

/// A running job. Times are host times since a zero that the owner defines.
pub struct ActiveJob {
    pub job: Job,
    /// Displayed position at the start.
    from: Position,
    start_time: Duration,
    /// Time at which the job ends unless a hold stops it before.
    pub end_time: Duration,
    /// Displayed position at the end of the job if no hold stops it before; empty at the pace `Immediate`.
    end_position: Position,
}

impl ActiveJob {
    /// Starts `job` at `now`. The world changes only when the job ends, so that a held move can stop half-way.
    pub fn start(
        job: Job,
        world: &SimulatedWorld,
        probe_fault: ProbeInputFault,
        pace: SimulationPace,
        now: Duration,
    ) -> Self {
        let from = world.displayed_position();
        let (end_position, duration) = match pace {
            SimulationPace::Immediate => (Position::new(), Duration::ZERO),
            SimulationPace::RealTime => {
                let mut copy = world.clone();
                job.run(&mut copy, probe_fault);
                let seconds = (copy.time_s() - world.time_s()).max(0.0);
                (copy.displayed_position(), Duration::from_secs_f64(seconds))
            }
        };
        Self { job, from, start_time: now, end_time: now + duration, end_position }
    }

    /// Stops the job at its current position; returns the remaining job.
    pub fn hold(self, world: &mut SimulatedWorld, now: Duration) -> Job {
        let (at, fraction) = (self.position_at(now), self.elapsed_fraction(now));
        self.job.run_partially(world, &at, fraction);
        match self.job {
            Job::Dwell { seconds } => Job::Dwell { seconds: seconds * (1.0 - fraction) },
            job => job,
        }
    }

    /// Share of the duration that has passed.
    fn elapsed_fraction(&self, now: Duration) -> f64 {
        let whole = (self.end_time - self.start_time).as_secs_f64();
        if whole > 0.0 { (now.saturating_sub(self.start_time).as_secs_f64() / whole).min(1.0) } else { 1.0 }
    }

    /// Displayed position at `now`, interpolated linearly in time between start and end of the job.
    pub fn position_at(&self, now: Duration) -> Position {
        let fraction = self.elapsed_fraction(now);
        let interpolate = |(axis, from): (_, f64)| {
            let to = self.end_position.get(axis).unwrap_or(from);
            (axis, from + fraction * (to - from))
        };
        self.from.iter().map(interpolate).collect()
    }
}

/// Result of a finished job. `has_crashed`: the stylus was deflected beyond its overtravel. `contact`: `None` if the
/// move reached its target without contact. `alarms_on_miss` is that of the job.
pub enum JobResult {
    Moved { has_crashed: bool },
    Probed { contact: Option<LatchedContact>, has_crashed: bool, alarms_on_miss: bool },
    DwellOrOrientFinished,
}

impl Job {
    /// Whether the job is a rapid or a turn of a rotary axis: no contact is expected, and the control does not
    /// monitor the probe.
    pub fn is_rapid_or_rotary_move(&self) -> bool {
        match self {
            Self::Travel { to, feed_mm_min } => feed_mm_min.is_none() || to.iter().any(|(axis, _)| !axis.is_linear()),
            _ => false,
        }
    }

    /// Target of a move or probing move; `None` for a dwell and a spindle orientation.
    pub fn target(&self) -> Option<&Position> {
        match self {
            Job::Travel { to, .. } | Job::Probe { to, .. } => Some(to),
            Job::OrientSpindle { .. } | Job::Dwell { .. } => None,
        }
    }

    /// Whether the job is acknowledged at its end; only travel is acknowledged when it is planned.
    pub fn is_acknowledged_at_end(&self) -> bool {
        !matches!(self, Job::Travel { .. })
    }

    /// Runs the whole job at once.
    pub(crate) fn run(&self, world: &mut SimulatedWorld, probe_fault: ProbeInputFault) -> JobResult {
        match self {
            Job::Travel { to, feed_mm_min } => {
                let speed = feed_mm_min.map_or(Speed::Rapid, |mm_min| Speed::Feed { mm_min });
                JobResult::Moved { has_crashed: world.travel(to, speed).has_crashed }
            }
            Job::Probe { to, feed_mm_min, alarms_on_miss, n } => {
                let probed = probe_fault.run_probing_move(world, to, *feed_mm_min, *n);
                JobResult::Probed {
                    contact: probed.contact,
                    has_crashed: probed.has_crashed,
                    alarms_on_miss: *alarms_on_miss,
                }
            }
            Job::OrientSpindle { s } => {
                world.orient_spindle(*s);
                JobResult::DwellOrOrientFinished
            }
            Job::Dwell { seconds } => {
                world.dwell(*seconds);
                JobResult::DwellOrOrientFinished
            }
        }
    }

    /// Runs the job up to the share `fraction` of its duration, at which the position is `at`.
    fn run_partially(&self, world: &mut SimulatedWorld, at: &Position, fraction: f64) {
        let part = |to: &Position| at.filter_axes(|axis| to.get(axis).is_some());
        match self {
            Job::Travel { to, feed_mm_min: None } => {
                world.travel(&part(to), Speed::Rapid);
            }
            Job::Travel { to, feed_mm_min: Some(mm_min) } | Job::Probe { to, feed_mm_min: mm_min, .. } => {
                world.travel(&part(to), Speed::Feed { mm_min: *mm_min });
            }
            Job::OrientSpindle { .. } => world.orient_spindle(at.get_or_zero(Axis::S)),
            Job::Dwell { seconds } => world.dwell(seconds * fraction),
        }
    }
}
