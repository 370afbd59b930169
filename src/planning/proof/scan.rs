//! Proof of a scan: the text reaches the points of its path one after the other, at its feed. It rests at each
//! point where samples are taken at rest, and nowhere if they are taken during the motion. No part of it touches:
//! all of it keeps [`MARGIN_MM`], except that the ball in a nest of sensors on the table may be as near as their
//! range allows.

use super::MARGIN_MM;
use super::refusal::Reason;
use super::rules;
use super::scene::ClearanceRule;
use super::walk::{Checked, Phase, ProgramCheck};
use crate::careful::{is_in_nest, near_feed, nest_feed};
use crate::gcode::rs274::{Kind, ReadMotion};
use crate::turning;
use machine::record::plan::{Sampling, Scan, Step};
use machine::{Axis, Position};

/// Rounding tolerance of times, which have three decimals, s.
const REST_ROUNDING: f64 = 0.000_501;

impl ProgramCheck<'_> {
    pub(super) fn scan(&mut self, motion: &ReadMotion, step: &Step, scan: &Scan) -> Checked {
        self.begin_in_place(scan)?;
        match (motion.kind, self.phase) {
            (Kind::Dwell { seconds }, Phase::Scanning { reached, rested }) => {
                if matches!(scan.sampling, Sampling::Continuous { .. }) {
                    return Err(Reason::RestInScan);
                }
                self.phase = Phase::Scanning { reached, rested: rested + seconds };
                Ok(())
            }
            (Kind::Dwell { .. }, _) => Ok(()),
            (Kind::Feed, Phase::Scanning { reached, .. }) => {
                self.has_rested(scan)?;
                rules::feed_is("the scan is", motion, step.feed_mm_min)?;
                if self.is_in_nest() && !turns(motion) {
                    rules::feed_at_most("a move between sensors", motion, self.nest_feed())?;
                }
                self.reach(motion, scan, reached)
            }
            (Kind::Feed, _) => {
                let ends = self.stands().updated_by(&motion.target);
                match rules::differs(&ends, &first(scan)?, self.request().dialect) {
                    None => {
                        let most = self.way_feed(motion, scan)?;
                        rules::feed_at_most("the way to a scan", motion, most)?;
                        self.reach(motion, scan, 0)
                    }
                    Some(_) => self.approach(motion),
                }
            }
            (Kind::Stop, _) => Err(Reason::StopsElsewhere),
            (_, Phase::Scanning { .. }) => Err(Reason::OffPath),
            (Kind::Rapid, _) if !self.is_confirmed() => Err(Reason::RapidUnconfirmed),
            (Kind::Rapid, _) => self.go(&motion.target, &ClearanceRule::Apart(MARGIN_MM)),
            (Kind::Orient { s }, _) => self.orient(s),
            (Kind::Probe { .. }, _) => Err(Reason::ProbeInScan),
        }
    }

    /// Maximum feed of the last move to the first point. Until the position is confirmed, a turn has the reduced
    /// feed of such turns; an axis that the scan itself does not turn may turn only with Z at its upper end.
    fn way_feed(&self, motion: &ReadMotion, scan: &Scan) -> Result<f64, Reason> {
        let plan = self.request().plan;
        let in_nest = self.is_in_nest();
        let near = if in_nest { nest_feed(plan) } else { near_feed(plan, self.confirmed) };
        if self.is_confirmed() {
            let turn = self.turn_feed(motion).filter(|_| in_nest);
            return Ok(turn.unwrap_or(near));
        }
        let is_turned =
            |axis: Axis| scan.path.windows(2).any(|way| way[0].at(axis) != way[1].at(axis));
        let mut rotary = motion.target.iter().filter(|(axis, _)| !axis.is_linear());
        if rotary.any(|(axis, _)| !is_turned(axis)) {
            self.is_high(&motion.target)?;
        }
        Ok(self.turn_feed(motion).unwrap_or(near))
    }

    /// Maximum feed of a motion that turns one axis, degrees/min; `None` for any other motion.
    fn turn_feed(&self, motion: &ReadMotion) -> Option<f64> {
        let mut moved = motion.target.iter().map(|(axis, _)| axis);
        let turned = moved.next().filter(|axis| !axis.is_linear() && moved.next().is_none())?;
        let plan = self.request().plan;
        Some(turning::feed_at_most(plan, &self.chain, turned, self.stands()))
    }

    /// Whether the sensors of the current step are on the table.
    fn is_in_nest(&self) -> bool {
        self.step().is_some_and(|step| is_in_nest(self.request().plan, step))
    }

    fn nest_feed(&self) -> f64 {
        nest_feed(self.request().plan)
    }

    /// Required clearance of a feed move of a scan. A move that is too fast for a hold to stop it in time keeps the
    /// margin from the sensors too.
    fn scan_care(&self, motion: &ReadMotion) -> ClearanceRule {
        let is_slow = || rules::feed_at_most("", motion, self.nest_feed()).is_ok();
        match self.is_in_nest() && (turns(motion) || is_slow()) {
            true => ClearanceRule::InNest(MARGIN_MM),
            false => ClearanceRule::Apart(MARGIN_MM),
        }
    }

    /// Begins the scan immediately if a turn has its first point at the position of the machine.
    fn begin_in_place(&mut self, scan: &Scan) -> Checked {
        let is_begun = matches!(self.phase, Phase::Scanning { .. });
        if is_begun || !scan.turns_only() {
            return Ok(());
        }
        if rules::differs(self.stands(), &first(scan)?, self.request().dialect).is_none() {
            self.phase = Phase::Scanning { reached: 1, rested: 0.0 };
        }
        Ok(())
    }

    /// Checks a feed move before the first point.
    fn approach(&mut self, motion: &ReadMotion) -> Checked {
        if !self.is_confirmed() && turns(motion) {
            return self.careful_feed(motion);
        }
        if !self.is_confirmed() {
            self.is_high(&motion.target)?;
        }
        let turn = self.turn_feed(motion).filter(|_| self.is_in_nest());
        let most = turn.unwrap_or(self.request().plan.probe.guarded_feed_mm_min);
        rules::feed_at_most("the way to a scan", motion, most)?;
        self.go(&motion.target, &self.scan_care(motion))
    }

    /// Checks that the move reaches the point `number`, which is the next one.
    fn reach(&mut self, motion: &ReadMotion, scan: &Scan, number: usize) -> Checked {
        let ends = self.stands().updated_by(&motion.target);
        let point = scan.path.get(number).ok_or(Reason::OffPath)?;
        if let Some(off) = rules::differs(&ends, point, self.request().dialect) {
            return Err(off.reason(Reason::NotAtPoint));
        }
        self.go(&motion.target, &self.scan_care(motion))?;
        self.phase = Phase::Scanning { reached: number + 1, rested: 0.0 };
        Ok(())
    }

    /// Checks that the scan has rested long enough at the present point.
    fn has_rested(&self, scan: &Scan) -> Checked {
        match (scan.sampling, self.phase) {
            (Sampling::Dwell { dwell_s, .. }, Phase::Scanning { rested, .. })
                if rested < dwell_s - REST_ROUNDING =>
            {
                Err(Reason::Unfinished("its rest at a point of the scan"))
            }
            _ => Ok(()),
        }
    }

    /// Checks that the scan has reached all of its points.
    pub(super) fn scanned(&self, scan: &Scan) -> Checked {
        self.has_rested(scan)?;
        match self.phase {
            Phase::Scanning { reached, .. } if reached == scan.path.len() => Ok(()),
            _ => Err(Reason::Unfinished("all points of its scan")),
        }
    }
}

fn turns(motion: &ReadMotion) -> bool {
    motion.target.iter().any(|(axis, _)| !axis.is_linear())
}

/// First point of the scan without the spindle, which is oriented separately.
fn first(scan: &Scan) -> Result<Position, Reason> {
    let first = scan.path.first().ok_or(Reason::OffPath)?;
    Ok(first.only(|axis| axis != Axis::S))
}
