//! One stage: plan all blocks, prove their text, then execute them.

use tokio::sync::oneshot;

use super::priority::{COMPUTATION_NICE, lower_priority};
use super::prompts::first_prompt_text;
use super::remaining_stages::{RehearsedStage, RemainingStages};
use super::{Run, RunError};
use machine::Position;
use machine::record::artefact::Artefact;
use machine::record::event::Event;
use machine::record::motion::{Block, BlockOutcome, Motion};
use machine::record::plan::{Plan, Stage, Step};
use machine::record::proof::Proof;
use machine::record::reading::{Reading, ReadingFlag};
use methods::{Method, NextStage, PositionSource};
use planning::gcode::{Dialect, Transmission};
use planning::proof::{ProvenBlock, StageProofError, StageProofRequest, StageSteps, prove_blocks};
use planning::{
    BlockStart, ConfirmedDirections, SafeHeights, machine_time_s, position_after_motions, split_prompts, step_blocks,
};

/// The blocks of a step with their data: `B` is [`Block`] as planned, [`ProvenBlock`] as proven.
struct StepTask<B> {
    step: Step,
    blocks: Vec<B>,
    /// Machine time from the start of this step to the end of the stage, s.
    remaining_s: f64,
    /// Position of the machine at the end of the step.
    end_position: Position,
}

/// Maximum number of motions in a block. The window of a resident program takes 20 rows at once
/// (docs/resident-program.md).
const MAX_BLOCK_MOTIONS: usize = 16;

/// Dialect of the text, and its transmission to the control.
#[derive(Clone, Copy)]
struct ControlText<'a> {
    dialect: &'a Dialect,
    transmission: &'a Transmission,
}

/// State of the machine at the start of a stage.
#[derive(Clone)]
struct StageStart {
    position: Option<Position>,
    confirmed: ConfirmedDirections,
}

impl Run<'_> {
    /// Runs one stage; `done` holds the stages before it. Returns the position of the machine at the end.
    pub(super) async fn run_stage(
        &mut self,
        done: &[Stage],
        stage: &Stage,
        stands: Option<Position>,
    ) -> Result<Option<Position>, RunError> {
        let stands = self.wait_for_prompts(stage, stands).await?;
        let begin = StageStart { position: stands.clone(), confirmed: self.confirmed };
        let sent = ControlText { dialect: &self.devices.dialect, transmission: &self.transmission };
        let (tasks, proof) = prove_stage(&self.plan, sent, done, stage, begin).await?;
        self.record_event(Event::StageProven { stage: stage.id, proof }).await?;
        let mut stands = stands;
        for task in tasks {
            let StepTask { step, blocks, remaining_s, end_position } = task;
            let (id, repeat) = (step.id, stage.repeat);
            (self.on_event)(&Event::StepStarted {
                step: id,
                repeat,
                label: step.label.clone(),
                remaining_s: remaining_s + self.remaining.machine_s(),
            });
            self.has_moved = true;
            let measured = match &step.scan {
                None => self.run_touch(&step, repeat, blocks).await,
                Some(scan) => self.run_scan(&step, scan, repeat, blocks).await,
            };
            self.store_readings(&step, measured.map_err(|error| error.with_step_label(&step))?).await?;
            self.confirmed = self.confirmed.after_step(&step);
            stands = Some(end_position);
        }
        Ok(stands)
    }

    /// Stores the readings before they are reported.
    async fn store_readings(&mut self, step: &Step, mut readings: Vec<Reading>) -> Result<(), RunError> {
        let temperatures = self.temperatures_c().await?;
        readings.iter_mut().for_each(|reading| reading.temperatures_c = temperatures.clone());
        match (readings.as_slice(), &step.scan) {
            ([touch], None) => {
                self.journal.add_reading(self.id, touch).await?;
                (self.on_event)(&Event::ReadingStored { reading: touch.clone() });
            }
            (samples, _) => {
                self.journal.add_scan(self.id, samples).await?;
                let flagged = samples.iter().filter(|sample| sample.flag != ReadingFlag::None).count();
                let (step, samples) = (step.id, samples.len());
                (self.on_event)(&Event::ScanStored { step, samples, flagged });
            }
        }
        self.readings.extend(readings);
        self.is_probe_confirmed = true;
        Ok(())
    }

    async fn run_touch(
        &mut self,
        step: &Step,
        repeat: u32,
        blocks: Vec<ProvenBlock>,
    ) -> Result<Vec<Reading>, RunError> {
        let mut outcome = BlockOutcome::default();
        for block in blocks {
            outcome = self.devices.controller.execute(block).await?;
        }
        Ok(vec![Reading {
            step: step.id,
            repeat,
            position: outcome.touch.ok_or(RunError::NoContactPosition { step: step.id })?,
            value_mm: None,
            sensor: step.first_sensor().to_owned(),
            t_s: self.timeline.run_time_s(outcome.t_s.unwrap_or_else(|| self.devices.clock.now_s())),
            flag: ReadingFlag::None,
            temperatures_c: Default::default(),
        }])
    }
}

/// Plans and proves a whole run from nominal positions, so that any refusal is known before the first motion.
///
/// # Errors
/// The refusal of the first stage that cannot be measured.
pub async fn rehearse(method: &dyn Method, plan: &Plan, dialect: &Dialect) -> Result<RehearsalResult, RunError> {
    let (remaining, steps) = rehearse_stages(method, plan, dialect).await?;
    Ok(RehearsalResult { machine_s: remaining.machine_s(), has_prompts: first_prompt_text(&steps).is_some() })
}

/// Facts about a run that its rehearsal gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RehearsalResult {
    /// Machine time of all stages, s.
    pub machine_s: f64,
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
    let mut begin = StageStart { position: None, confirmed: ConfirmedDirections::default() };
    while let NextStage::Stage { stage, new_steps } = method.next_stage(&plan, &done, PositionSource::Nominal)? {
        plan.steps.extend(new_steps);
        if !split_prompts(&plan, &stage.steps)?.0.is_empty() {
            begin.confirmed = ConfirmedDirections::default();
        }
        let sent = ControlText { dialect, transmission: &Transmission::Rows };
        let (tasks, _) = prove_stage(&plan, sent, &done, &stage, begin.clone()).await?;
        let machine_s = tasks.first().map_or(0.0, |task| task.remaining_s);
        stages.push(RehearsedStage { name: stage.name.clone(), machine_s });
        for task in tasks {
            begin.confirmed = begin.confirmed.after_step(&task.step);
            begin.position = Some(task.end_position);
        }
        done.push(stage);
    }
    Ok((RemainingStages::new(stages), plan.steps))
}

/// Plans and proves on a separate thread: a halt must not wait for the proof.
async fn prove_stage(
    plan: &Plan,
    sent: ControlText<'_>,
    done: &[Stage],
    stage: &Stage,
    begin: StageStart,
) -> Result<(Vec<StepTask<ProvenBlock>>, Proof), RunError> {
    let (answer, result) = oneshot::channel();
    let found = done.iter().chain([stage]).rev().find_map(|stage| stage.found.clone());
    let (plan, dialect) = (plan.clone(), sent.dialect.clone());
    let transmission = sent.transmission.clone();
    let (stage, name) = (stage.clone(), stage.name.clone());
    std::thread::spawn(move || {
        lower_priority(COMPUTATION_NICE);
        let sent = ControlText { dialect: &dialect, transmission: &transmission };
        drop(answer.send(prove_stage_blocks(&plan, &stage, found.as_ref(), &begin, sent)));
    });
    result.await.map_err(|_| RunError::ProofAborted { stage: name })?
}

/// The blocks of a stage, and the proof of their text for this control.
fn prove_stage_blocks(
    plan: &Plan,
    stage: &Stage,
    found: Option<&Artefact>,
    begin: &StageStart,
    ControlText { dialect, transmission }: ControlText<'_>,
) -> Result<(Vec<StepTask<ProvenBlock>>, Proof), RunError> {
    let tasks = plan_tasks(plan, stage, found, begin)?;
    let blocks: Vec<Block> = tasks.iter().flat_map(|task| task.blocks.iter().cloned()).collect();
    let (_, moves) = split_prompts(plan, &stage.steps)?;
    let stages = [StageSteps { step_ids: moves, found_artefact: found }];
    let (stages, stands, confirmed) = (&stages, begin.position.as_ref(), begin.confirmed);
    let request =
        StageProofRequest { plan, stages, start_position: stands, confirmed, dialect, transmission, blocks: &blocks };
    let (proof, proven) = prove_blocks(&request).map_err(|unproven| {
        let stage = stage.name.clone();
        match unproven {
            StageProofError::Render(source) => RunError::Unwritable { stage, source },
            StageProofError::Refused(source) => RunError::StageProofError { stage, source: Box::new(source) },
        }
    })?;
    let mut proven = proven.into_iter();
    let of_task = |StepTask { step, blocks, remaining_s, end_position }: StepTask<Block>| {
        let blocks = proven.by_ref().take(blocks.len()).collect();
        StepTask { step, blocks, remaining_s, end_position }
    };
    Ok((tasks.into_iter().map(of_task).collect(), proof))
}

/// Splits a long path into parts, as a control holds a limited number of rows. The last part contains the touch
/// and the motions that belong to it. A scan is not split: samples are taken along it.
fn split_block(step: &Step, mut block: Block) -> Vec<Block> {
    if step.scan.is_some() {
        return vec![block];
    }
    let way = block.motions.len().saturating_sub(MAX_BLOCK_MOTIONS);
    let touch = block.motions.split_off(way);
    let part = |motions: &[Motion]| Block { motions: motions.to_vec(), ..block.clone() };
    block.motions.chunks(MAX_BLOCK_MOTIONS).map(part).chain([part(&touch)]).collect()
}

/// The blocks of a stage. A stage without a path to its start is refused.
fn plan_tasks(
    plan: &Plan,
    stage: &Stage,
    found: Option<&Artefact>,
    begin: &StageStart,
) -> Result<Vec<StepTask<Block>>, RunError> {
    let clearance = SafeHeights::above_known_artefact(plan, found)?;
    let StageStart { position: mut stands, mut confirmed } = begin.clone();
    let mut tasks = Vec::new();
    let step_of = |id: &u32| plan.steps.iter().find(|step| step.id == *id);
    let (_, moves) = split_prompts(plan, &stage.steps)?;
    for step in moves.iter().filter_map(step_of) {
        let start = BlockStart { position: stands.as_ref(), confirmed };
        let blocks = step_blocks(plan, step, stage.repeat, start, &clearance)?;
        let blocks: Vec<Block> = blocks.into_iter().flat_map(|block| split_block(step, block)).collect();
        let (mut end, mut seconds) = (stands.clone().unwrap_or_else(|| step.from.clone()), 0.0);
        for block in &blocks {
            seconds += machine_time_s(block, &end, &plan.machine);
            end = position_after_motions(&block.motions, &end);
        }
        stands = Some(end.clone());
        confirmed = confirmed.after_step(step);
        tasks.push(StepTask { step: step.clone(), blocks, remaining_s: seconds, end_position: end });
    }
    let mut left = 0.0;
    for task in tasks.iter_mut().rev() {
        left += task.remaining_s;
        task.remaining_s = left;
    }
    Ok(tasks)
}
