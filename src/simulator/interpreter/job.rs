//! One job of a simulated control, executed at once or in real time.

use std::time::Duration;

use crate::{Contact, Probed, Speed, World};
use machine::{Axis, Position};

/// Action that a line requests. Positions are machine coordinates of the axes that move.
#[derive(Debug, Clone, PartialEq)]
pub enum Job {
    /// `feed_mm_min` is `None` for G0.
    Travel {
        to: Position,
        feed_mm_min: Option<f64>,
    },
    /// `strict`: a miss is an alarm (G38.2). `n`: the line's number.
    Probe {
        to: Position,
        feed_mm_min: f64,
        strict: bool,
        n: u32,
    },
    Orient {
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
    No,
    Closed,
    Open,
    /// An obstacle is in the path of the next probing move.
    Early,
    /// The stylus is brushed during the next rapid or turn (`Brush`), or now (`Brushed`: the number of further
    /// reports that read closed).
    Brush,
    Brushed(u8),
}

impl Job {
    /// Whether the job is a rapid or a turn of a rotary axis: no contact is expected, and the control does not
    /// monitor the probe.
    pub fn is_free_move(&self) -> bool {
        match self {
            Self::Travel { to, feed_mm_min } => {
                feed_mm_min.is_none() || to.iter().any(|(axis, _)| !axis.is_linear())
            }
            _ => false,
        }
    }
}

impl ProbeInputFault {
    /// Whether the probe input reads closed.
    pub fn tripped(self, world: &World) -> bool {
        match self {
            Self::Closed | Self::Brushed(_) => true,
            Self::Open => false,
            Self::No | Self::Early | Self::Brush => world.tripped(),
        }
    }

    /// State after a report has shown the probe input.
    pub fn told(self) -> Self {
        match self {
            Self::Brushed(0..=1) => Self::No,
            Self::Brushed(left) => Self::Brushed(left - 1),
            sham => sham,
        }
    }

    fn probe(self, world: &mut World, to: &Position, feed_mm_min: f64, n: u32) -> Probed {
        let way = |share: f64| {
            let from = world.position();
            to.iter()
                .map(|(axis, end)| (axis, from.at(axis) + share * (end - from.at(axis))))
                .collect()
        };
        let end: Position = match self {
            ProbeInputFault::No
            | ProbeInputFault::Closed
            | ProbeInputFault::Brush
            | ProbeInputFault::Brushed(_) => {
                return world.probe(to, feed_mm_min, n);
            }
            ProbeInputFault::Open => to.clone(),
            ProbeInputFault::Early => way(0.4),
        };
        let moved = world.travel(&end, Speed::Feed { mm_min: feed_mm_min });
        let contact = Contact { position: world.position(), t_s: world.time_s() };
        Probed {
            contact: (self == ProbeInputFault::Early).then_some(contact),
            crashed: moved.crashed,
            duration_s: moved.duration_s,
        }
    }
}

/// How simulated time relates to host time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// Moves end at once.
    Fast,
    /// Moves take their real duration.
    Real,
}

/// A running job. Times are host times since a zero that the owner defines.
pub struct Active {
    job: Job,
    from: Position,
    begun: Duration,
    pub ends: Duration,
    /// Position at the end of the job unless it is held.
    end: Position,
}

impl Active {
    /// Starts the job. The world changes only when the job ends, so that a held move can stop half-way.
    pub fn begin(
        job: Job,
        world: &World,
        sham: ProbeInputFault,
        pace: Pace,
        now: Duration,
    ) -> Self {
        let from = world.position();
        let (end, takes) = match pace {
            Pace::Fast => (Position::new(), Duration::ZERO),
            Pace::Real => {
                let mut copy = world.clone();
                job.run(&mut copy, sham);
                let seconds = (copy.time_s() - world.time_s()).max(0.0);
                (copy.position(), Duration::from_secs_f64(seconds))
            }
        };
        Self { job, from, begun: now, ends: now + takes, end }
    }

    /// Ends the job.
    pub fn finish(&self, world: &mut World, sham: ProbeInputFault) -> Done {
        self.job.run(world, sham)
    }

    /// Stops the job at its current position; returns the remaining job.
    pub fn hold(self, world: &mut World, now: Duration) -> Job {
        let (at, fraction) = (self.position(now), self.fraction(now));
        self.job.run_in_part(world, &at, fraction);
        match self.job {
            Job::Dwell { seconds } => Job::Dwell { seconds: seconds * (1.0 - fraction) },
            job => job,
        }
    }

    /// Whether the job is acknowledged at its end; travel is acknowledged when it is planned.
    pub fn is_waited_for(&self) -> bool {
        self.job.is_waited_for()
    }

    /// Share of the duration that has passed.
    fn fraction(&self, now: Duration) -> f64 {
        let whole = (self.ends - self.begun).as_secs_f64();
        if whole > 0.0 {
            (now.saturating_sub(self.begun).as_secs_f64() / whole).min(1.0)
        } else {
            1.0
        }
    }

    pub fn position(&self, now: Duration) -> Position {
        let fraction = self.fraction(now);
        let between = |(axis, from): (_, f64)| {
            let to = self.end.get(axis).unwrap_or(from);
            (axis, from + fraction * (to - from))
        };
        self.from.iter().map(between).collect()
    }
}

/// Result of a job.
pub enum Done {
    Moved { crashed: bool },
    Probed { contact: Option<Contact>, crashed: bool, strict: bool },
    Waited,
}

impl Job {
    pub fn target(&self) -> Option<&Position> {
        match self {
            Job::Travel { to, .. } | Job::Probe { to, .. } => Some(to),
            Job::Orient { .. } | Job::Dwell { .. } => None,
        }
    }

    /// Whether the job is acknowledged at its end; travel is acknowledged when it is planned.
    pub fn is_waited_for(&self) -> bool {
        !matches!(self, Job::Travel { .. })
    }

    fn run(&self, world: &mut World, sham: ProbeInputFault) -> Done {
        match self {
            Job::Travel { to, feed_mm_min } => {
                let speed = feed_mm_min.map_or(Speed::Rapid, |mm_min| Speed::Feed { mm_min });
                Done::Moved { crashed: world.travel(to, speed).crashed }
            }
            Job::Probe { to, feed_mm_min, strict, n } => {
                let probed = sham.probe(world, to, *feed_mm_min, *n);
                Done::Probed { contact: probed.contact, crashed: probed.crashed, strict: *strict }
            }
            Job::Orient { s } => {
                world.orient(*s);
                Done::Waited
            }
            Job::Dwell { seconds } => {
                world.dwell(*seconds);
                Done::Waited
            }
        }
    }

    /// Runs the job up to the share `fraction` of its duration, at which the position is `at`.
    fn run_in_part(&self, world: &mut World, at: &Position, fraction: f64) {
        let part = |to: &Position| at.only(|axis| to.get(axis).is_some());
        match self {
            Job::Travel { to, feed_mm_min: None } => {
                world.travel(&part(to), Speed::Rapid);
            }
            Job::Travel { to, feed_mm_min: Some(mm_min) }
            | Job::Probe { to, feed_mm_min: mm_min, .. } => {
                world.travel(&part(to), Speed::Feed { mm_min: *mm_min });
            }
            Job::Orient { .. } => world.orient(at.at(Axis::S)),
            Job::Dwell { seconds } => world.dwell(seconds * fraction),
        }
    }
}
