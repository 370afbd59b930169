//! One stage: plan all blocks, prove their text, then execute them.

use super::priority::spawn_computation;
use super::prompts::first_prompt_text;
use super::remaining_stages::{RehearsedStage, RemainingStages};
use super::{Run, RunError};
use machine::Position;
use machine::record::artefact::Artefact;
use machine::record::event::RunEvent;
use machine::record::motion::{Motion, MotionBlock, MotionBlockOutcome};
use machine::record::plan::{Plan, Stage, Step};
use machine::record::reading::{Reading, ReadingFlag};
use machine::record::stage_proof::StageProof;
use methods::{Method, NextStage, ObjectPositionSource};
use planning::gcode::{Dialect, TransmissionForm};
use planning::proof::{ProofRequest, ProvenBlock, StageProofError, StageSteps, prove_blocks};
use planning::{
    BlockStart, SafeHeights, TouchedDirections, machine_time_s, position_after_motions, split_prompts, step_blocks,
};

/// The blocks of a step with their data: `B` is [`MotionBlock`] as planned, [`ProvenBlock`] as proven.
struct StepBlocks<B> {
    step: Step,
    /// In the order of execution.
    blocks: Vec<B>,
    /// Machine time from the start of this step to the end of the stage, s.
    time_to_stage_end_s: f64,
    /// Position of the machine at the end of the step.
    end_position: Position,
}

/// Maximum number of motions in a block of a touch. The window of a resident program takes 20 rows at once
/// (docs/resident-program.md).
const MAX_BLOCK_MOTIONS: usize = 16;

/// State of the machine at the start of a stage.
#[derive(Clone)]
struct StageStart {
    /// `None`: unknown.
    position: Option<Position>,
    /// Directions that touches have confirmed since the control was prepared.
    confirmed_directions: TouchedDirections,
}

impl Run<'_> {
    /// Runs one stage; `done` holds the stages before it. Returns the position of the machine at the end.
    pub(super) async fn run_stage(
        &mut self,
        done: &[Stage],
        stage: &Stage,
        machine_position: Option<Position>,
    ) -> Result<Option<Position>, RunError> {
        let mut machine_position = self.wait_for_prompts(stage, machine_position).await?;
        let begin = StageStart { position: machine_position.clone(), confirmed_directions: self.confirmed_directions };
        let (dialect, transmission) = (&self.devices.dialect, &self.transmission);
        let (tasks, proof) = plan_and_prove_on_thread(&self.plan, dialect, transmission, done, stage, begin).await?;
        self.record_event(RunEvent::StageProven { stage: stage.id, proof }).await?;
        let mut tasks = tasks.into_iter().peekable();
        while let Some(task) = tasks.next() {
            let StepBlocks { step, blocks, time_to_stage_end_s: remaining_s, end_position } = task;
            let (id, repeat) = (step.id, stage.repeat);
            (self.on_event)(&RunEvent::StepStarted {
                step: id,
                repeat,
                label: step.label.clone(),
                remaining_s: remaining_s + self.remaining_stages.total_machine_time_s(),
            });
            self.may_have_moved = true;
            let measured = match &step.scan {
                None => self.run_touch(&step, repeat, blocks).await,
                Some(scan) => self.run_scan(&step, scan, repeat, blocks).await,
            };
            self.store_readings(&step, measured.map_err(|error| error.with_step_label(&step))?).await?;
            self.confirmed_directions = self.confirmed_directions.after_step(&step);
            if tasks.peek().is_none_or(|next| is_other_rotary_position(&next.end_position, &end_position)) {
                self.record_tool_centre(id, repeat).await?;
            }
            machine_position = Some(end_position);
        }
        Ok(machine_position)
    }

    /// Stores the readings before they are reported.
    async fn store_readings(&mut self, step: &Step, mut readings: Vec<Reading>) -> Result<(), RunError> {
        let temperatures = self.temperatures_c().await?;
        readings.iter_mut().for_each(|reading| reading.temperatures_c = temperatures.clone());
        match (readings.as_slice(), &step.scan) {
            ([touch], None) => {
                self.journal.add_reading(self.id, touch).await?;
                (self.on_event)(&RunEvent::ReadingStored { reading: touch.clone() });
            }
            (samples, _) => {
                self.journal.add_scan(self.id, samples).await?;
                let flagged = samples.iter().filter(|sample| sample.flag != ReadingFlag::None).count();
                let (step, samples) = (step.id, samples.len());
                (self.on_event)(&RunEvent::ScanStored { step, samples, flagged });
            }
        }
        self.readings.extend(readings);
        self.is_probe_confirmed = true;
        Ok(())
    }

    /// Journals the tool centre as the control computes it, if the machine file states how it is read.
    async fn record_tool_centre(&mut self, step: u32, repeat: u32) -> Result<(), RunError> {
        match self.devices.open_controller.read_tool_centre().await? {
            Some(reading) => self.record_event(RunEvent::ToolCentreRead { step, repeat, reading }).await,
            None => Ok(()),
        }
    }

    /// Executes the blocks of a touch. Returns one reading: the contact in the last block.
    async fn run_touch(
        &mut self,
        step: &Step,
        repeat_number: u32,
        blocks: Vec<ProvenBlock>,
    ) -> Result<Vec<Reading>, RunError> {
        let mut outcome = MotionBlockOutcome::default();
        for block in blocks {
            outcome = self.devices.open_controller.execute(block).await?;
        }
        let control_time_s = outcome.trigger_time_s.unwrap_or_else(|| self.devices.clock.now_s());
        Ok(vec![Reading {
            step: step.id,
            repeat: repeat_number,
            position: outcome.trigger_position.ok_or(RunError::NoContactPosition { step: step.id })?,
            sensor: step.first_sensor().to_owned(),
            t_s: self.timeline.control_to_run_time_s(control_time_s),
            ..Reading::default()
        }])
    }
}

/// Whether a rotary axis or the spindle has another position.
fn is_other_rotary_position(one: &Position, other: &Position) -> bool {
    let rotary = |position: &Position| position.filter_axes(|axis| !axis.is_linear());
    rotary(one) != rotary(other)
}

/// Plans and proves a whole run from nominal positions, so that any refusal is known before the first motion.
///
/// # Errors
/// The refusal of the first stage that cannot be measured.
pub async fn rehearse(method: &dyn Method, plan: &Plan, dialect: &Dialect) -> Result<RehearsalResult, RunError> {
    let (remaining, steps) = rehearse_stages(method, plan, dialect).await?;
    Ok(RehearsalResult {
        machine_time_s: remaining.total_machine_time_s(),
        has_prompts: first_prompt_text(&steps).is_some(),
    })
}

/// Result of the rehearsal of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RehearsalResult {
    /// Machine time of all rehearsed stages, s; without waits for the operator and without repeated measurements.
    pub machine_time_s: f64,
    /// Whether the run contains a prompt to the operator.
    pub has_prompts: bool,
}

/// Rehearses a run as [`rehearse`]; returns all of its stages and steps.
pub(super) async fn rehearse_stages(
    method: &dyn Method,
    plan: &Plan,
    dialect: &Dialect,
) -> Result<(RemainingStages, Vec<Step>), RunError> {
    let mut plan = Plan { steps: Vec::new(), ..plan.clone() };
    let (mut done, mut stages) = (Vec::new(), Vec::new());
    let mut begin = StageStart { position: None, confirmed_directions: TouchedDirections::default() };
    while let NextStage::Stage { stage, new_steps } = method.next_stage(&plan, &done, ObjectPositionSource::Nominal)? {
        plan.steps.extend(new_steps);
        if !split_prompts(&plan, &stage.steps)?.0.is_empty() {
            begin.confirmed_directions = TouchedDirections::default();
        }
        let transmission = &TransmissionForm::TableRows;
        let (tasks, _) = plan_and_prove_on_thread(&plan, dialect, transmission, &done, &stage, begin.clone()).await?;
        let machine_s = tasks.first().map_or(0.0, |task| task.time_to_stage_end_s);
        stages.push(RehearsedStage { name: stage.name.clone(), machine_time_s: machine_s });
        for task in tasks {
            begin.confirmed_directions = begin.confirmed_directions.after_step(&task.step);
            begin.position = Some(task.end_position);
        }
        done.push(stage);
    }
    Ok((RemainingStages::new(stages), plan.steps))
}

/// Plans and proves on a separate thread: a halt must not wait for the proof.
async fn plan_and_prove_on_thread(
    plan: &Plan,
    dialect: &Dialect,
    transmission: &TransmissionForm,
    done: &[Stage],
    stage: &Stage,
    stage_start: StageStart,
) -> Result<(Vec<StepBlocks<ProvenBlock>>, StageProof), RunError> {
    let found = done.iter().chain([stage]).rev().find_map(|stage| stage.found.clone());
    let (plan, dialect, transmission) = (plan.clone(), dialect.clone(), transmission.clone());
    let (stage, name) = (stage.clone(), stage.name.clone());
    let proven = spawn_computation(move || {
        plan_and_prove_blocks(&plan, &dialect, &transmission, &stage, found.as_ref(), &stage_start)
    });
    proven.await.map_err(|_| RunError::ProofAborted { stage: name })?
}

/// The blocks of a stage, and the proof of their text for this control.
fn plan_and_prove_blocks(
    plan: &Plan,
    dialect: &Dialect,
    transmission: &TransmissionForm,
    stage: &Stage,
    found_artefact: Option<&Artefact>,
    stage_start: &StageStart,
) -> Result<(Vec<StepBlocks<ProvenBlock>>, StageProof), RunError> {
    let tasks = plan_step_blocks(plan, stage, found_artefact, stage_start)?;
    let blocks: Vec<MotionBlock> = tasks.iter().flat_map(|task| task.blocks.iter().cloned()).collect();
    let (_, moves) = split_prompts(plan, &stage.steps)?;
    let request = ProofRequest {
        plan,
        stages: &[StageSteps { step_ids: moves, found_artefact }],
        start_position: stage_start.position.as_ref(),
        touched_directions: stage_start.confirmed_directions,
        dialect,
    };
    let (proof, proven) = prove_blocks(&request, transmission, &blocks).map_err(|unproven| {
        let stage = stage.name.clone();
        match unproven {
            StageProofError::Render(source) => RunError::ProgramNotWritable { stage, source },
            StageProofError::Refused(source) => RunError::CollisionCheckRefused { stage, source: Box::new(source) },
        }
    })?;
    let mut proven = proven.into_iter();
    let with_proven_blocks = |task: StepBlocks<MotionBlock>| {
        let StepBlocks { step, blocks, time_to_stage_end_s, end_position } = task;
        let blocks = proven.by_ref().take(blocks.len()).collect();
        StepBlocks { step, blocks, time_to_stage_end_s, end_position }
    };
    Ok((tasks.into_iter().map(with_proven_blocks).collect(), proof))
}

/// Splits a long path into parts, as a control holds a limited number of rows. The last part contains the touch
/// and the motions that belong to it. A scan is not split: samples are taken along it.
fn split_block(step: &Step, mut block: MotionBlock) -> Vec<MotionBlock> {
    if step.scan.is_some() {
        return vec![block];
    }
    let way = block.motions.len().saturating_sub(MAX_BLOCK_MOTIONS);
    let touch = block.motions.split_off(way);
    let part = |motions: &[Motion]| MotionBlock { motions: motions.to_vec(), ..block.clone() };
    block.motions.chunks(MAX_BLOCK_MOTIONS).map(part).chain([part(&touch)]).collect()
}

/// The blocks of a stage. A stage without a path to its start is refused.
fn plan_step_blocks(
    plan: &Plan,
    stage: &Stage,
    found_artefact: Option<&Artefact>,
    stage_start: &StageStart,
) -> Result<Vec<StepBlocks<MotionBlock>>, RunError> {
    let clearance = SafeHeights::above_found_or_plan_artefact(plan, found_artefact)?;
    let StageStart { position: mut machine_position, confirmed_directions: mut confirmed } = stage_start.clone();
    let mut tasks = Vec::new();
    let step_of = |id: &u32| plan.steps.iter().find(|step| step.id == *id);
    let (_, moves) = split_prompts(plan, &stage.steps)?;
    for step in moves.iter().filter_map(step_of) {
        let start = BlockStart { position: machine_position.as_ref(), touched_directions: confirmed };
        let blocks = step_blocks(plan, step, stage.repeat, start, &clearance)?;
        let blocks: Vec<MotionBlock> = blocks.into_iter().flat_map(|block| split_block(step, block)).collect();
        let (mut end, mut seconds) = (machine_position.clone().unwrap_or_else(|| step.from.clone()), 0.0);
        for block in &blocks {
            seconds += machine_time_s(block, &end, &plan.machine);
            end = position_after_motions(&block.motions, &end);
        }
        machine_position = Some(end.clone());
        confirmed = confirmed.after_step(step);
        tasks.push(StepBlocks { step: step.clone(), blocks, time_to_stage_end_s: seconds, end_position: end });
    }
    let mut left = 0.0;
    for task in tasks.iter_mut().rev() {
        left += task.time_to_stage_end_s;
        task.time_to_stage_end_s = left;
    }
    Ok(tasks)
}
