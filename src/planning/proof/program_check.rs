//! Checks the text, motion by motion, against the steps in their order.

use std::f64::consts::PI;

use super::collision_scene::{ClearanceRule, CollisionScene};
use super::refusal::{ProofRefusal, RefusalReason};
use super::sweep::JointPath;
use super::{ProofRequest, motion_rules, touch};
use crate::TouchedDirections;
use crate::gcode::rs274::{MotionFrame, MotionKind, ReadMotion};
use machine::kinematics::{AxisCommands, KinematicChain};
use machine::record::plan::{Step, StepKind};
use machine::record::stage_proof::{Clearance, StageProof};
use machine::{Axis, Position};

/// Progress of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum StepPhase {
    /// Before the touch, the first point of the scan, or the stop of the prompt.
    Approach,
    /// On the path of a scan: number of points reached, and time of rest at the last one, s.
    Scanning { reached_count: usize, dwelled_s: f64 },
    /// The touch is finished, and the machine is where contact stopped it.
    Touched,
    /// The machine has moved back to `from` after the touch; guarded moves may follow. Also the state before the
    /// first step.
    BackedOff,
    /// The prompt has stopped the program.
    StoppedForPrompt,
}

fn is_prompt(step: &Step) -> bool {
    step.kind == StepKind::Prompt
}

/// Check of a program, motion by motion. The fields up to `scenes_by_stage` are its inputs.
pub struct ProgramCheck<'a> {
    pub(super) request: &'a ProofRequest<'a>,
    /// All motions of the programs, as read back; empty once the check of the motions has begun.
    read_motions: Vec<ReadMotion>,
    /// Steps of all stages in order, each with the index of its stage.
    steps_with_stage_index: Vec<(&'a Step, usize)>,
    /// Scene of each stage.
    scenes_by_stage: Vec<CollisionScene>,
    /// Index of the current step in the list of all steps; `None` before the first step.
    current_step_index: Option<usize>,
    pub(super) step_phase: StepPhase,
    /// Position after the motions so far, as far as it is known: a touch makes its axes unknown until the back-off,
    /// and a prompt makes all axes unknown.
    pub(super) position: Position,
    /// Current line, from 1.
    current_line: usize,
    /// Result so far: motion count, and the smallest clearance of each completed step.
    proof: StageProof,
    /// Smallest clearance of the current step so far.
    min_clearance_of_step: Option<Clearance>,
    /// Lines whose path was not checked, because the position of an axis is unknown.
    unchecked_lines: Vec<usize>,
    pub(super) touched_directions: TouchedDirections,
    pub(super) chain: KinematicChain,
}

pub(super) type CheckResult = Result<(), RefusalReason>;

impl<'a> ProgramCheck<'a> {
    /// Begins the check. `motions`: the motions of the request's programs, as read back.
    pub fn begin(request: &'a ProofRequest<'a>, motions: Vec<ReadMotion>) -> Result<Self, ProofRefusal> {
        let mut turns = Vec::new();
        let mut scenes = Vec::new();
        for (stage, staged) in request.stages.iter().enumerate() {
            let artefact = staged.found_artefact.unwrap_or(&request.plan.artefact);
            scenes.push(CollisionScene::new(request.plan, artefact).map_err(|reason| reason.at_line(1))?);
            for id in staged.step_ids {
                let step = request.plan.steps.iter().find(|step| step.id == *id);
                turns.push((step.ok_or(RefusalReason::StepNotInPlan(*id).at_line(1))?, stage));
            }
        }
        let position = request.start_position.cloned().unwrap_or_default();
        let chain =
            KinematicChain::new(&request.plan.machine).map_err(|error| RefusalReason::from(error).at_line(1))?;
        Ok(Self {
            request,
            read_motions: motions,
            steps_with_stage_index: turns,
            scenes_by_stage: scenes,
            current_step_index: None,
            step_phase: StepPhase::BackedOff,
            position,
            current_line: 1,
            proof: StageProof::default(),
            min_clearance_of_step: None,
            unchecked_lines: Vec::new(),
            touched_directions: request.touched_directions,
            chain,
        })
    }

    /// Checks each motion against its step and for collisions. `Err`: the first refusal.
    pub fn check_all_motions(mut self) -> Result<StageProof, ProofRefusal> {
        for motion in std::mem::take(&mut self.read_motions) {
            self.current_line = motion.line;
            self.check_motion(&motion).map_err(|reason| self.refusal_at_current_line(reason))?;
            self.proof.motion_count += usize::from(motion.kind != MotionKind::ProgramStop);
        }
        self.check_all_steps_complete().map_err(|reason| self.refusal_at_current_line(reason))?;
        Ok(self.into_proof())
    }

    fn refusal_at_current_line(&self, reason: RefusalReason) -> ProofRefusal {
        let step = self.current_step().map(|step| (step.id, step.label.clone()));
        ProofRefusal { step, line: self.current_line, reason }
    }

    pub(super) fn current_step(&self) -> Option<&'a Step> {
        self.steps_with_stage_index.get(self.current_step_index?).map(|(step, _)| *step)
    }

    /// Whether touches or a scan have verified the position of the machine.
    pub(super) fn is_machine_position_verified(&self) -> bool {
        self.touched_directions.has_three_independent_directions()
    }

    /// Scene of the current stage; before any step, of the first stage.
    fn current_scene(&self) -> Option<&CollisionScene> {
        let stage = self
            .current_step_index
            .and_then(|turn| self.steps_with_stage_index.get(turn))
            .map_or(0, |(_, stage)| *stage);
        self.scenes_by_stage.get(stage)
    }

    fn check_motion(&mut self, motion: &ReadMotion) -> CheckResult {
        self.advance_to_step(motion.step_number.ok_or(RefusalReason::UnassignedMotion)?)?;
        if let MotionFrame::Work(slot) = &motion.frame {
            return Err(RefusalReason::MotionInWorkFrame(slot.clone()));
        }
        let machine = &self.request.plan.machine;
        motion_rules::check_axis_limits(motion, machine, self.request.dialect)?;
        if self.current_step().is_some_and(is_prompt) {
            return self.check_motion_in_prompt(motion.kind);
        }
        if let Some((step, scan)) = self.current_step().and_then(|step| Some((step, step.scan.as_ref()?))) {
            return self.check_scan_motion(motion, step, scan);
        }
        match motion.kind {
            MotionKind::Dwell { .. } => Ok(()),
            MotionKind::Feed if self.step_phase == StepPhase::Approach && !self.is_machine_position_verified() => {
                self.check_feed_move_at_unverified_position(motion)
            }
            MotionKind::Feed => self.check_back_off(motion),
            _ if self.step_phase == StepPhase::Touched => Err(RefusalReason::MissingBackOff),
            MotionKind::OrientSpindle { s } => self.check_spindle_orientation(s),
            MotionKind::Rapid if !self.is_machine_position_verified() => {
                Err(RefusalReason::RapidBeforePositionVerified)
            }
            MotionKind::Rapid => self.check_straight_move(&motion.target, &ClearanceRule::UnguardedMove),
            MotionKind::Probe { must_touch } => self.check_probing_move(motion, must_touch),
            MotionKind::ProgramStop => Err(RefusalReason::UnexpectedProgramStop),
        }
    }

    /// Checks a prompt: it is one stop, and after it the position of the machine is unknown.
    fn check_motion_in_prompt(&mut self, kind: MotionKind) -> CheckResult {
        match (kind, self.step_phase) {
            (MotionKind::ProgramStop, StepPhase::Approach) => {
                (self.position, self.step_phase) = (Position::new(), StepPhase::StoppedForPrompt);
                self.touched_directions = TouchedDirections::default();
                Ok(())
            }
            (MotionKind::ProgramStop, _) => Err(RefusalReason::UnexpectedProgramStop),
            _ => Err(RefusalReason::MotionInPrompt),
        }
    }

    /// Continues the current step, or completes it and begins the next one.
    fn advance_to_step(&mut self, n: u32) -> CheckResult {
        let next = self.current_step_index.map_or(0, |turn| turn + 1);
        let expected = self.steps_with_stage_index.get(next).map(|(step, _)| step.id);
        match self.current_step() {
            Some(step) if step.id == n => return Ok(()),
            _ if expected != Some(n) => {
                return Err(RefusalReason::WrongStepOrder { found: n, expected });
            }
            Some(_) => self.complete_step()?,
            None => {}
        }
        (self.current_step_index, self.step_phase) = (Some(next), StepPhase::Approach);
        Ok(())
    }

    /// Checks that the current step is complete, after a touch also the clearance of unguarded moves at the end of
    /// the step. A complete touch or scan counts in `touched_directions`.
    fn complete_step(&mut self) -> CheckResult {
        match (self.current_step().and_then(|step| step.scan.as_ref()), self.step_phase) {
            (_, StepPhase::StoppedForPrompt) => return Ok(()),
            (Some(scan), _) => self.check_scan_complete(scan)?,
            (None, StepPhase::Touched) => {
                return Err(RefusalReason::StepIncomplete("the back-off from contact"));
            }
            (None, StepPhase::BackedOff) => {
                self.check_straight_move(&Position::new(), &ClearanceRule::UnguardedMove)?
            }
            (None, _) => return Err(RefusalReason::StepIncomplete("the touch")),
        }
        self.proof.steps.extend(self.min_clearance_of_step.take());
        if let Some(step) = self.current_step() {
            self.touched_directions = self.touched_directions.after_step(step);
        }
        Ok(())
    }

    fn check_all_steps_complete(&mut self) -> CheckResult {
        if self.current_step_index.is_some() {
            self.complete_step()?;
        }
        let next = self.current_step_index.map_or(0, |turn| turn + 1);
        self.steps_with_stage_index
            .get(next)
            .map_or(Ok(()), |(step, _)| Err(RefusalReason::ProgramEndsBeforeStep(step.id)))
    }

    /// Checks a probing move: the touch of the current step if it begins at `from` or ends at `to`, otherwise a
    /// guarded move.
    fn check_probing_move(&mut self, motion: &ReadMotion, must_touch: bool) -> CheckResult {
        let step = self.current_step().ok_or(RefusalReason::UnassignedMotion)?;
        let dialect = self.request.dialect;
        let changes = |(axis, value): (Axis, f64)| self.position.get(axis) != Some(value);
        let turns = motion.target.iter().filter(|(axis, _)| !axis.is_linear()).any(changes);
        let ends = self.position.updated_by(&motion.target);
        let begins = motion_rules::find_axis_mismatch(&self.position, &step.from, dialect);
        let to = motion_rules::find_axis_mismatch(&ends, &step.to.filter_axes(Axis::is_linear), dialect);
        if !turns && (begins.is_none() || to.is_none()) {
            match (self.step_phase, begins, to) {
                (StepPhase::Approach, None, None) => return self.check_touch(motion, step),
                (StepPhase::Approach, None, Some(to)) => {
                    return Err(to.into_refusal_reason(RefusalReason::WrongTarget));
                }
                (StepPhase::Approach, Some(begins), _) => {
                    return Err(begins.into_refusal_reason(RefusalReason::WrongTouchStart));
                }
                (_, _, None) => return Err(RefusalReason::SecondTouchInStep),
                _ => {}
            }
        }
        if must_touch {
            return Err(RefusalReason::UnexpectedProbingMove);
        }
        let probe = &self.request.plan.probe;
        motion_rules::check_max_feed("the guarded move", motion, probe.guarded_feed_mm_min)?;
        motion_rules::braking_distance_within_overtravel_mm(motion, &self.request.plan.machine, probe)?;
        let rule = match (turns, self.is_machine_position_verified()) {
            (true, false) => return Err(RefusalReason::TurnBeforePositionVerified),
            (true, true) => ClearanceRule::UnguardedMove,
            (false, false) => self.guarded_clearance_rule_at_unverified_position(motion)?,
            (false, true) => self.guarded_move_clearance_rule(),
        };
        self.check_straight_move(&motion.target, &rule)
    }

    /// Clearance rule of a guarded move. A machine that was stopped at a low position may first move up from it.
    pub(super) fn guarded_move_clearance_rule(&self) -> ClearanceRule {
        if self.proof.motion_count == 0 { ClearanceRule::GuardedFirstMove } else { ClearanceRule::GuardedMove }
    }

    /// Checks the touch of the step: feed, length, contact and clearance.
    fn check_touch(&mut self, motion: &ReadMotion, step: &Step) -> CheckResult {
        let plan = self.request.plan;
        motion_rules::check_exact_feed("the touch", motion, step.feed_mm_min)?;
        let braking = motion_rules::braking_distance_within_overtravel_mm(motion, &plan.machine, &plan.probe)?;
        let to = self.position.updated_by(&motion.target);
        motion_rules::check_touch_length(&self.position, &to, plan.probe.overtravel_mm)?;
        let from = self.axis_commands(&self.position)?;
        let joint_path = JointPath { from, to: self.axis_commands(&to)? };
        let reach = {
            let scene = self.current_scene().ok_or(RefusalReason::UnassignedMotion)?;
            touch::find_touch_reach(scene, &joint_path, braking, step.normal)?
        };
        // At the start of the touch, the ball is clear of the artefact, wherever it is within its uncertainty.
        self.check_path_clearance(&JointPath { from, to: from }, &ClearanceRule::GuardedMove)?;
        self.check_path_clearance(&joint_path, &ClearanceRule::TouchOtherBodies(reach.touched_body_number))?;
        self.check_path_clearance(
            &reach.joint_path,
            &ClearanceRule::TouchMovingParts(reach.touched_body_number, reach.lateral_misplacement),
        )?;
        self.position = self.position.filter_axes(|axis| motion.target.get(axis).is_none());
        self.step_phase = StepPhase::Touched;
        Ok(())
    }

    /// Checks a G1 move: from contact straight back to `from`, along the path that was proven for the touch.
    fn check_back_off(&mut self, motion: &ReadMotion) -> CheckResult {
        let step = self.current_step().ok_or(RefusalReason::UnassignedMotion)?;
        if self.step_phase != StepPhase::Touched {
            return Err(RefusalReason::UnexpectedFeedMove);
        }
        let probe = &self.request.plan.probe;
        motion_rules::check_max_feed("the back-off from contact", motion, probe.search_feed_mm_min)?;
        let ends = self.position.updated_by(&motion.target);
        if let Some(off) = motion_rules::find_axis_mismatch(&ends, &step.from, self.request.dialect) {
            return Err(off.into_refusal_reason(RefusalReason::WrongBackOffTarget));
        }
        (self.position, self.step_phase) = (ends, StepPhase::BackedOff);
        Ok(())
    }

    /// Checks an orientation of the spindle to `s`; the sense of rotation is unknown.
    pub(super) fn check_spindle_orientation(&mut self, s: f64) -> CheckResult {
        if !self.is_machine_position_verified() {
            self.check_z_alone_or_at_top(&Position::new().with(Axis::S, s))?;
        }
        let turned = |by: f64| self.position.clone().with(Axis::S, s + by);
        let (from, to) = (self.axis_commands(&turned(-PI)), self.axis_commands(&turned(PI)));
        match (from, to) {
            (Ok(from), Ok(to)) => self.check_path_clearance(&JointPath { from, to }, &ClearanceRule::UnguardedMove)?,
            _ => self.unchecked_lines.push(self.current_line),
        }
        self.position.set(Axis::S, s);
        Ok(())
    }

    /// Checks a straight move to `target`.
    pub(super) fn check_straight_move(&mut self, target: &Position, rule: &ClearanceRule) -> CheckResult {
        let ends = self.position.updated_by(target);
        match (self.axis_commands(&self.position), self.axis_commands(&ends)) {
            (Ok(from), Ok(to)) => self.check_path_clearance(&JointPath { from, to }, rule)?,
            _ => self.unchecked_lines.push(self.current_line),
        }
        self.position = ends;
        Ok(())
    }

    fn axis_commands(&self, position: &Position) -> Result<AxisCommands, RefusalReason> {
        motion_rules::axis_commands(&self.request.plan.machine, position)
    }

    /// Checks that the path is free, and keeps the smallest clearance.
    fn check_path_clearance(&mut self, joint_path: &JointPath, rule: &ClearanceRule) -> CheckResult {
        let most = self.min_clearance_of_step.as_ref().map_or(f64::INFINITY, |nearest| nearest.clearance_mm);
        let nearest_pair = self
            .current_scene()
            .map_or(Ok(None), |scene| scene.check_path_and_find_nearest_pair(joint_path, rule, most))?;
        if let Some((clearance_mm, between)) = nearest_pair {
            let step = self.current_step().map_or(0, |step| step.id);
            self.min_clearance_of_step = Some(Clearance { step, line: self.current_line, clearance_mm, between });
        }
        Ok(())
    }

    /// Result of the whole check. Its unchecked items are those of the first stage, and the lines whose path was not
    /// checked.
    fn into_proof(self) -> StageProof {
        let mut proof = self.proof;
        let least = |a: &&Clearance, b: &&Clearance| a.clearance_mm.total_cmp(&b.clearance_mm);
        proof.nearest = proof.steps.iter().min_by(least).cloned();
        let scene = self.scenes_by_stage.into_iter().next();
        proof.unchecked_items = scene.map_or(Vec::new(), |scene| scene.unchecked_items);
        if let (Some(first), Some(last)) = (self.unchecked_lines.first(), self.unchecked_lines.last()) {
            proof
                .unchecked_items
                .push(format!("the path of lines {first} to {last}, before the positions of all axes are known"));
        }
        proof
    }
}
