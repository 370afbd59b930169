//! Checks the text, motion by motion, against the steps in their order.

use std::f64::consts::PI;

use super::refusal::{Reason, Refusal};
use super::scene::{ClearanceRule, Scene};
use super::sweep::Way;
use super::{MARGIN_MM, Request, rules, touch};
use crate::Confirmed;
use crate::gcode::rs274::{Frame, Kind, ReadMotion};
use machine::kinematics::{Chain, Commands};
use machine::record::plan::{Step, StepKind};
use machine::record::proof::{Clearance, Proof};
use machine::{Axis, Position};

/// Progress of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Phase {
    Approach,
    /// On the path of a scan: number of points reached, and time of rest at the last one, s.
    Scanning {
        reached: usize,
        rested: f64,
    },
    /// The touch is finished, and the machine is where contact stopped it.
    Touched,
    /// The machine is back at `from`.
    Back,
    /// The prompt has stopped the program.
    Asked,
}

fn asks(step: &Step) -> bool {
    step.kind == StepKind::Prompt
}

pub struct ProgramCheck<'a> {
    request: &'a Request<'a>,
    motions: Vec<ReadMotion>,
    /// Steps of all stages, each with the number of its stage.
    turns: Vec<(&'a Step, usize)>,
    scenes: Vec<Scene>,
    /// Index of the current turn.
    turn: Option<usize>,
    pub(super) phase: Phase,
    stands: Position,
    /// Current line, from 1.
    line: usize,
    proof: Proof,
    /// Smallest clearance of the current step.
    nearest: Option<Clearance>,
    /// Lines whose path is not known.
    blind: Vec<usize>,
    pub(super) confirmed: Confirmed,
    pub(super) chain: Chain,
}

pub(super) type Checked = Result<(), Reason>;

impl<'a> ProgramCheck<'a> {
    /// Begins the check. `motions`: the motions of the request's programs, as read back.
    pub fn begin(request: &'a Request<'a>, motions: Vec<ReadMotion>) -> Result<Self, Refusal> {
        let at = |line| move |reason| Refusal { step: None, line, reason };
        let mut turns = Vec::new();
        let mut scenes = Vec::new();
        for (stage, staged) in request.stages.iter().enumerate() {
            let artefact = staged.found.unwrap_or(&request.plan.artefact);
            scenes.push(Scene::new(request.plan, artefact).map_err(at(1))?);
            for id in staged.steps {
                let step = request.plan.steps.iter().find(|step| step.id == *id);
                turns.push((step.ok_or(Reason::NoSuchStep(*id)).map_err(at(1))?, stage));
            }
        }
        let stands = request.stands.cloned().unwrap_or_default();
        let chain = Chain::new(&request.plan.machine).map_err(|error| at(1)(error.into()))?;
        Ok(Self {
            request,
            motions,
            turns,
            scenes,
            turn: None,
            phase: Phase::Back,
            stands,
            line: 1,
            proof: Proof::default(),
            nearest: None,
            blind: Vec::new(),
            confirmed: request.confirmed,
            chain,
        })
    }

    /// Checks all motions.
    pub fn through(mut self) -> Result<Proof, Refusal> {
        for motion in std::mem::take(&mut self.motions) {
            self.line = motion.line;
            self.motion(&motion).map_err(|reason| self.refusal(reason))?;
            self.proof.motions += usize::from(motion.kind != Kind::Stop);
        }
        self.end().map_err(|reason| self.refusal(reason))?;
        Ok(self.found())
    }

    fn refusal(&self, reason: Reason) -> Refusal {
        let step = self.step().map(|step| (step.id, step.label.clone()));
        Refusal { step, line: self.line, reason }
    }

    pub(super) fn step(&self) -> Option<&'a Step> {
        self.turns.get(self.turn?).map(|(step, _)| *step)
    }

    pub(super) fn request(&self) -> &'a Request<'a> {
        self.request
    }

    /// Whether touches have confirmed the position of the machine.
    pub(super) fn is_confirmed(&self) -> bool {
        self.confirmed.is_all()
    }

    pub(super) fn stands(&self) -> &Position {
        &self.stands
    }

    /// Scene of the current stage; before any step, of the first stage.
    fn scene(&self) -> Option<&Scene> {
        let stage = self.turn.and_then(|turn| self.turns.get(turn)).map_or(0, |(_, stage)| *stage);
        self.scenes.get(stage)
    }

    fn motion(&mut self, motion: &ReadMotion) -> Checked {
        self.take_turn(motion.n.ok_or(Reason::NoStep)?)?;
        if let Frame::Work(slot) = &motion.frame {
            return Err(Reason::Frame(slot.clone()));
        }
        let machine = &self.request.plan.machine;
        rules::limits(motion, machine, self.request.dialect)?;
        if self.step().is_some_and(asks) {
            return self.ask(motion.kind);
        }
        if let Some((step, scan)) = self.step().and_then(|step| Some((step, step.scan.as_ref()?))) {
            return self.scan(motion, step, scan);
        }
        match motion.kind {
            Kind::Dwell { .. } => Ok(()),
            Kind::Feed if self.phase == Phase::Approach && !self.is_confirmed() => {
                self.careful_feed(motion)
            }
            Kind::Feed => self.back(motion),
            _ if self.phase == Phase::Touched => Err(Reason::NotBack),
            Kind::Orient { s } => self.orient(s),
            Kind::Rapid if !self.is_confirmed() => Err(Reason::RapidUnconfirmed),
            Kind::Rapid => self.go(&motion.target, &ClearanceRule::Apart(MARGIN_MM)),
            Kind::Probe { must_touch } => self.probe(motion, must_touch),
            Kind::Stop => Err(Reason::StopsElsewhere),
        }
    }

    /// Checks a prompt: it is one stop, and after it the position of the machine is unknown.
    fn ask(&mut self, kind: Kind) -> Checked {
        match (kind, self.phase) {
            (Kind::Stop, Phase::Approach) => {
                (self.stands, self.phase) = (Position::new(), Phase::Asked);
                self.confirmed = Confirmed::default();
                Ok(())
            }
            (Kind::Stop, _) => Err(Reason::StopsElsewhere),
            _ => Err(Reason::MovesInPrompt),
        }
    }

    /// Continues the current step, or completes it and begins the next one.
    fn take_turn(&mut self, n: u32) -> Checked {
        let next = self.turn.map_or(0, |turn| turn + 1);
        let expected = self.turns.get(next).map(|(step, _)| step.id);
        match self.step() {
            Some(step) if step.id == n => return Ok(()),
            _ if expected != Some(n) => return Err(Reason::OutOfTurn { found: n, expected }),
            Some(_) => self.complete()?,
            None => {}
        }
        (self.turn, self.phase) = (Some(next), Phase::Approach);
        Ok(())
    }

    fn complete(&mut self) -> Checked {
        match (self.step().and_then(|step| step.scan.as_ref()), self.phase) {
            (_, Phase::Asked) => return Ok(()),
            (Some(scan), _) => self.scanned(scan)?,
            (None, Phase::Touched) => return Err(Reason::Unfinished("its way back from contact")),
            (None, Phase::Back) => self.go(&Position::new(), &ClearanceRule::Apart(MARGIN_MM))?,
            (None, _) => return Err(Reason::Unfinished("its touch")),
        }
        self.proof.steps.extend(self.nearest.take());
        if let Some(step) = self.step() {
            self.confirmed = self.confirmed.after(step);
        }
        Ok(())
    }

    fn end(&mut self) -> Checked {
        if self.turn.is_some() {
            self.complete()?;
        }
        let next = self.turn.map_or(0, |turn| turn + 1);
        self.turns.get(next).map_or(Ok(()), |(step, _)| Err(Reason::Missing(step.id)))
    }

    /// Checks a probing move: the touch of the current step if it begins at `from` or ends at `to`, otherwise a
    /// guarded move.
    fn probe(&mut self, motion: &ReadMotion, must_touch: bool) -> Checked {
        let step = self.step().ok_or(Reason::NoStep)?;
        let dialect = self.request.dialect;
        let changes = |(axis, value): (Axis, f64)| self.stands.get(axis) != Some(value);
        let turns = motion.target.iter().filter(|(axis, _)| !axis.is_linear()).any(changes);
        let ends = self.stands.updated_by(&motion.target);
        let begins = rules::differs(&self.stands, &step.from, dialect);
        let to = rules::differs(&ends, &step.to.only(Axis::is_linear), dialect);
        if !turns && (begins.is_none() || to.is_none()) {
            match (self.phase, begins, to) {
                (Phase::Approach, None, None) => return self.touch(motion, step),
                (Phase::Approach, None, Some(to)) => return Err(to.reason(Reason::NotTo)),
                (Phase::Approach, Some(begins), _) => return Err(begins.reason(Reason::NotAtFrom)),
                (_, _, None) => return Err(Reason::SecondTouch),
                _ => {}
            }
        }
        if must_touch {
            return Err(Reason::NotATouch);
        }
        let probe = &self.request.plan.probe;
        rules::feed_at_most("a guarded move", motion, probe.guarded_feed_mm_min)?;
        rules::braking(motion, &self.request.plan.machine, probe)?;
        let care = match (turns, self.is_confirmed()) {
            (true, false) => return Err(Reason::TurnsUnconfirmed),
            (true, true) => ClearanceRule::Apart(MARGIN_MM),
            (false, false) => self.careful_guarded(motion)?,
            (false, true) => self.guarded_care(),
        };
        self.go(&motion.target, &care)
    }

    /// Clearance rule of a guarded move. A machine that was stopped at a low position may first move up from it.
    pub(super) fn guarded_care(&self) -> ClearanceRule {
        if self.proof.motions == 0 { ClearanceRule::Leaving } else { ClearanceRule::Guarded }
    }

    fn touch(&mut self, motion: &ReadMotion, step: &Step) -> Checked {
        let plan = self.request.plan;
        rules::feed_is("the touch is", motion, step.feed_mm_min)?;
        let braking = rules::braking(motion, &plan.machine, &plan.probe)?;
        let to = self.stands.updated_by(&motion.target);
        rules::length(&self.stands, &to, plan.probe.overtravel_mm)?;
        let from = self.commands(&self.stands)?;
        let way = Way { from, to: self.commands(&to)? };
        let reach = {
            let scene = self.scene().ok_or(Reason::NoStep)?;
            touch::reach(scene, &way, braking, step.normal)?
        };
        // At its start, the ball is clear of the artefact, wherever the artefact is.
        self.look(&Way { from, to: from }, &ClearanceRule::Guarded)?;
        self.look(&way, &ClearanceRule::Strangers(reach.body))?;
        self.look(&reach.way, &ClearanceRule::Riders(reach.body, reach.across))?;
        self.stands = self.stands.only(|axis| motion.target.get(axis).is_none());
        self.phase = Phase::Touched;
        Ok(())
    }

    /// Checks a G1 move: from contact straight back to `from`, along the path that was proven for the touch.
    fn back(&mut self, motion: &ReadMotion) -> Checked {
        let step = self.step().ok_or(Reason::NoStep)?;
        if self.phase != Phase::Touched {
            return Err(Reason::FeedMove);
        }
        let probe = &self.request.plan.probe;
        rules::feed_at_most("the way back from contact", motion, probe.search_feed_mm_min)?;
        let ends = self.stands.updated_by(&motion.target);
        if let Some(off) = rules::differs(&ends, &step.from, self.request.dialect) {
            return Err(off.reason(Reason::NotBackAt));
        }
        (self.stands, self.phase) = (ends, Phase::Back);
        Ok(())
    }

    /// Checks an orientation of the spindle to `s`; the sense of rotation is unknown.
    pub(super) fn orient(&mut self, s: f64) -> Checked {
        if !self.is_confirmed() {
            self.is_high(&Position::new().with(Axis::S, s))?;
        }
        let turned = |by: f64| self.stands.clone().with(Axis::S, s + by);
        let (from, to) = (self.commands(&turned(-PI)), self.commands(&turned(PI)));
        match (from, to) {
            (Ok(from), Ok(to)) => self.look(&Way { from, to }, &ClearanceRule::Apart(MARGIN_MM))?,
            _ => self.blind.push(self.line),
        }
        self.stands.set(Axis::S, s);
        Ok(())
    }

    /// Checks a straight move to `target`.
    pub(super) fn go(&mut self, target: &Position, care: &ClearanceRule) -> Checked {
        let ends = self.stands.updated_by(target);
        match (self.commands(&self.stands), self.commands(&ends)) {
            (Ok(from), Ok(to)) => self.look(&Way { from, to }, care)?,
            _ => self.blind.push(self.line),
        }
        self.stands = ends;
        Ok(())
    }

    /// Commands of all axes; a spindle that is not oriented counts as zero.
    fn commands(&self, position: &Position) -> Result<Commands, Reason> {
        let axes = self.request.plan.machine.axes.keys();
        let mut unknown = axes.filter(|axis| **axis != Axis::S && position.get(**axis).is_none());
        match unknown.next() {
            Some(axis) => Err(Reason::Unknown(*axis)),
            None => Ok(Axis::ALL.map(|axis| position.at(axis))),
        }
    }

    /// Checks that the path is free, and keeps the smallest clearance.
    fn look(&mut self, way: &Way, care: &ClearanceRule) -> Checked {
        let most = self.nearest.as_ref().map_or(f64::INFINITY, |nearest| nearest.clearance_mm);
        let found = self.scene().map_or(Ok(None), |scene| scene.look(way, care, most))?;
        if let Some((clearance_mm, between)) = found {
            let step = self.step().map_or(0, |step| step.id);
            self.nearest = Some(Clearance { step, line: self.line, clearance_mm, between });
        }
        Ok(())
    }

    fn found(self) -> Proof {
        let mut proof = self.proof;
        let least = |a: &&Clearance, b: &&Clearance| a.clearance_mm.total_cmp(&b.clearance_mm);
        proof.nearest = proof.steps.iter().min_by(least).cloned();
        let scene = self.scenes.into_iter().next();
        proof.not_looked_at = scene.map_or(Vec::new(), |scene| scene.not_looked_at);
        if let (Some(first), Some(last)) = (self.blind.first(), self.blind.last()) {
            proof.not_looked_at.push(format!(
                "the way of lines {first} to {last}, before it is known where all axes stand"
            ));
        }
        proof
    }
}
