//! One job of a simulated control: at once, or in the time it takes.

use std::time::Duration;

use crate::{Contact, Probed, Speed, World};
use machine::{Axis, Position};

/// What a line makes a control do. Positions are machine coordinates of the axes that move.
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

/// What the probe's input shows instead of the truth.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Sham {
    #[default]
    No,
    Closed,
    Open,
    /// Something stands in the way of the next probing move.
    Early,
    /// Something brushes the stylus during the next rapid or turn, or does so now: so many more reports
    /// read closed.
    Brush,
    Brushed(u8),
}

impl Job {
    /// A rapid, or a turn of a rotary axis: nothing should meet the stylus, and the control does not look
    /// at the probe.
    pub fn is_free_move(&self) -> bool {
        match self {
            Self::Travel { to, feed_mm_min } => {
                feed_mm_min.is_none() || to.iter().any(|(axis, _)| !axis.is_linear())
            }
            _ => false,
        }
    }
}

impl Sham {
    /// What the probe's input reads.
    pub fn tripped(self, world: &World) -> bool {
        match self {
            Self::Closed | Self::Brushed(_) => true,
            Self::Open => false,
            Self::No | Self::Early | Self::Brush => world.tripped(),
        }
    }

    /// After a report has told how the probe reads.
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
            Sham::No | Sham::Closed | Sham::Brush | Sham::Brushed(_) => {
                return world.probe(to, feed_mm_min, n);
            }
            Sham::Open => to.clone(),
            Sham::Early => way(0.4),
        };
        let moved = world.travel(&end, Speed::Feed { mm_min: feed_mm_min });
        let contact = Contact { position: world.position(), t_s: world.time_s() };
        Probed {
            contact: (self == Sham::Early).then_some(contact),
            crashed: moved.crashed,
            duration_s: moved.duration_s,
        }
    }
}

/// How simulated time passes for whoever waits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// Moves are done at once.
    Fast,
    /// Moves take as long as they would.
    Real,
}

/// A job under way. Times are host time since whatever zero its owner uses.
pub struct Active {
    job: Job,
    from: Position,
    begun: Duration,
    pub ends: Duration,
    /// Where it would end if nobody holds it.
    end: Position,
}

impl Active {
    /// Set out. The world itself is touched when the job ends, so that a held move can stay half-way.
    pub fn begin(job: Job, world: &World, sham: Sham, pace: Pace, now: Duration) -> Self {
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

    /// Come to its end.
    pub fn finish(&self, world: &mut World, sham: Sham) -> Done {
        self.job.run(world, sham)
    }

    /// Stop where it is; returns what is left of it.
    pub fn hold(self, world: &mut World, now: Duration) -> Job {
        let (at, fraction) = (self.position(now), self.fraction(now));
        self.job.run_in_part(world, &at, fraction);
        match self.job {
            Job::Dwell { seconds } => Job::Dwell { seconds: seconds * (1.0 - fraction) },
            job => job,
        }
    }

    /// Travel is acknowledged when it is planned, all else when it is done.
    pub fn is_waited_for(&self) -> bool {
        self.job.is_waited_for()
    }

    /// Share of its time that has passed.
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

/// How a job ended.
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

    /// Travel is acknowledged when it is planned, all else when it is done.
    pub fn is_waited_for(&self) -> bool {
        !matches!(self, Job::Travel { .. })
    }

    fn run(&self, world: &mut World, sham: Sham) -> Done {
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

    /// The same job up to the share `fraction` of its time, when it has come to `at`.
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
