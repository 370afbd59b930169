//! One stage: plan all blocks, prove their text, then execute them.

use tokio::sync::oneshot;

use super::priority::{COMPUTATION_NICE, lower_priority};
use super::prompts::first_question;
use super::remaining_stages::{Ahead, RehearsedStage};
use super::{Run, RunError};
use machine::Position;
use machine::record::artefact::Artefact;
use machine::record::event::Event;
use machine::record::motion::{Block, Motion, Outcome};
use machine::record::plan::{Plan, Stage, Step};
use machine::record::proof::Proof;
use machine::record::reading::{Flag, Reading};
use methods::{Method, Next, Source};
use planning::gcode::{Dialect, Transmission};
use planning::proof::{ProvenBlock, StageRequest, Staged, Unproven, prove_blocks};
use planning::{Clearance, Confirmed, Start, asked_first, end_of, machine_time_s, step_blocks};

/// The blocks of a step with their data: `B` is [`Block`] as planned, [`ProvenBlock`] as proven.
struct Task<B> {
    step: Step,
    blocks: Vec<B>,
    /// Machine time from the start of this step to the end of the stage, s.
    remaining_s: f64,
    /// Position of the machine at the end of the step.
    ends: Position,
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
    stands: Option<Position>,
    confirmed: Confirmed,
}

impl Run<'_> {
    /// Runs one stage; `done` holds the stages before it. Returns the position of the machine at the end.
    pub(super) async fn run_stage(
        &mut self,
        done: &[Stage],
        stage: &Stage,
        stands: Option<Position>,
    ) -> Result<Option<Position>, RunError> {
        let stands = self.ask_first(stage, stands).await?;
        let begin = StageStart { stands: stands.clone(), confirmed: self.confirmed };
        let sent = ControlText { dialect: &self.devices.dialect, transmission: &self.transmission };
        let (tasks, proof) = prove(&self.plan, sent, done, stage, begin).await?;
        self.note(Event::StageProven { stage: stage.id, proof }).await?;
        let mut stands = stands;
        for task in tasks {
            let Task { step, blocks, remaining_s, ends } = task;
            let (id, repeat) = (step.id, stage.repeat);
            (self.tell)(&Event::StepStarted {
                step: id,
                repeat,
                label: step.label.clone(),
                remaining_s: remaining_s + self.ahead.machine_s(),
            });
            self.moved = true;
            let measured = match &step.scan {
                None => self.touch(&step, repeat, blocks).await,
                Some(scan) => self.scan((&step, scan), repeat, blocks).await,
            };
            self.keep_readings(&step, measured.map_err(|error| error.on(&step))?).await?;
            self.confirmed = self.confirmed.after(&step);
            stands = Some(ends);
        }
        Ok(stands)
    }

    /// Stores the readings before they are reported.
    async fn keep_readings(
        &mut self,
        step: &Step,
        mut readings: Vec<Reading>,
    ) -> Result<(), RunError> {
        let felt = self.temperatures_c().await?;
        readings.iter_mut().for_each(|reading| reading.temperatures_c = felt.clone());
        match (readings.as_slice(), &step.scan) {
            ([touch], None) => {
                self.journal.reading(self.id, touch).await?;
                (self.tell)(&Event::ReadingStored { reading: touch.clone() });
            }
            (samples, _) => {
                self.journal.scan(self.id, samples).await?;
                let flagged = samples.iter().filter(|sample| sample.flag != Flag::None).count();
                let (step, samples) = (step.id, samples.len());
                (self.tell)(&Event::ScanStored { step, samples, flagged });
            }
        }
        self.readings.extend(readings);
        self.probe_lives = true;
        Ok(())
    }

    async fn touch(
        &mut self,
        step: &Step,
        repeat: u32,
        blocks: Vec<ProvenBlock>,
    ) -> Result<Vec<Reading>, RunError> {
        let mut outcome = Outcome::default();
        for block in blocks {
            outcome = self.devices.controller.execute(block).await?;
        }
        Ok(vec![Reading {
            step: step.id,
            repeat,
            position: outcome.touch.ok_or(RunError::NoReading { step: step.id })?,
            value_mm: None,
            sensor: step.sensor().to_owned(),
            t_s: self.timeline.at(outcome.t_s.unwrap_or_else(|| self.devices.clock.now_s())),
            flag: Flag::None,
            temperatures_c: Default::default(),
        }])
    }
}

/// Plans and proves a whole run from nominal positions, so that any refusal is known before the first motion.
///
/// # Errors
/// The refusal of the first stage that cannot be measured.
pub async fn rehearse(
    method: &dyn Method,
    plan: &Plan,
    dialect: &Dialect,
) -> Result<Rehearsed, RunError> {
    let (ahead, steps) = rehearsed(method, plan, dialect).await?;
    Ok(Rehearsed { machine_s: ahead.machine_s(), asks: first_question(&steps).is_some() })
}

/// Facts about a run that its rehearsal gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rehearsed {
    /// Machine time of all stages, s.
    pub machine_s: f64,
    /// Whether the run contains a prompt to the operator.
    pub asks: bool,
}

/// Rehearses a run as [`rehearse`]; returns all of its stages and steps.
pub(super) async fn rehearsed(
    method: &dyn Method,
    plan: &Plan,
    dialect: &Dialect,
) -> Result<(Ahead, Vec<Step>), RunError> {
    let mut plan = Plan { steps: Vec::new(), ..plan.clone() };
    let (mut done, mut stages) = (Vec::new(), Vec::new());
    let mut begin = StageStart { stands: None, confirmed: Confirmed::default() };
    while let Next::Stage { stage, new_steps } = method.next(&plan, &done, Source::Nominal)? {
        plan.steps.extend(new_steps);
        if !asked_first(&plan, &stage.steps)?.0.is_empty() {
            begin.confirmed = Confirmed::default();
        }
        let sent = ControlText { dialect, transmission: &Transmission::Rows };
        let (tasks, _) = prove(&plan, sent, &done, &stage, begin.clone()).await?;
        let machine_s = tasks.first().map_or(0.0, |task| task.remaining_s);
        stages.push(RehearsedStage { name: stage.name.clone(), machine_s });
        for task in tasks {
            begin.confirmed = begin.confirmed.after(&task.step);
            begin.stands = Some(task.ends);
        }
        done.push(stage);
    }
    Ok((Ahead::new(stages), plan.steps))
}

/// Plans and proves on a separate thread: a halt must not wait for the proof.
async fn prove(
    plan: &Plan,
    sent: ControlText<'_>,
    done: &[Stage],
    stage: &Stage,
    begin: StageStart,
) -> Result<(Vec<Task<ProvenBlock>>, Proof), RunError> {
    let (answer, result) = oneshot::channel();
    let found = done.iter().chain([stage]).rev().find_map(|stage| stage.found.clone());
    let (plan, dialect) = (plan.clone(), sent.dialect.clone());
    let transmission = sent.transmission.clone();
    let (stage, name) = (stage.clone(), stage.name.clone());
    std::thread::spawn(move || {
        lower_priority(COMPUTATION_NICE);
        let sent = ControlText { dialect: &dialect, transmission: &transmission };
        drop(answer.send(proven(&plan, &stage, found.as_ref(), &begin, sent)));
    });
    result.await.map_err(|_| RunError::ProofGone { stage: name })?
}

/// The blocks of a stage, and the proof of their text for this control.
fn proven(
    plan: &Plan,
    stage: &Stage,
    found: Option<&Artefact>,
    begin: &StageStart,
    ControlText { dialect, transmission }: ControlText<'_>,
) -> Result<(Vec<Task<ProvenBlock>>, Proof), RunError> {
    let tasks = tasks(plan, stage, found, begin)?;
    let blocks: Vec<Block> = tasks.iter().flat_map(|task| task.blocks.iter().cloned()).collect();
    let (_, moves) = asked_first(plan, &stage.steps)?;
    let stages = [Staged { steps: moves, found }];
    let (stages, stands, confirmed) = (&stages, begin.stands.as_ref(), begin.confirmed);
    let request =
        StageRequest { plan, stages, stands, confirmed, dialect, transmission, blocks: &blocks };
    let (proof, proven) = prove_blocks(&request).map_err(|unproven| {
        let stage = stage.name.clone();
        match unproven {
            Unproven::Unwritable(source) => RunError::Unwritable { stage, source },
            Unproven::Refused(source) => RunError::Unproven { stage, source: Box::new(source) },
        }
    })?;
    let mut proven = proven.into_iter();
    let of_task = |Task { step, blocks, remaining_s, ends }: Task<Block>| {
        let blocks = proven.by_ref().take(blocks.len()).collect();
        Task { step, blocks, remaining_s, ends }
    };
    Ok((tasks.into_iter().map(of_task).collect(), proof))
}

/// Splits a long path into parts, as a control holds a limited number of rows. The last part contains the touch
/// and the motions that belong to it. A scan is not split: samples are taken along it.
fn parts(step: &Step, mut block: Block) -> Vec<Block> {
    if step.scan.is_some() {
        return vec![block];
    }
    let way = block.motions.len().saturating_sub(MAX_BLOCK_MOTIONS);
    let touch = block.motions.split_off(way);
    let part = |motions: &[Motion]| Block { motions: motions.to_vec(), ..block.clone() };
    block.motions.chunks(MAX_BLOCK_MOTIONS).map(part).chain([part(&touch)]).collect()
}

/// The blocks of a stage. A stage without a path to its start is refused.
fn tasks(
    plan: &Plan,
    stage: &Stage,
    found: Option<&Artefact>,
    begin: &StageStart,
) -> Result<Vec<Task<Block>>, RunError> {
    let clearance = Clearance::known(plan, found)?;
    let StageStart { mut stands, mut confirmed } = begin.clone();
    let mut tasks = Vec::new();
    let step_of = |id: &u32| plan.steps.iter().find(|step| step.id == *id);
    let (_, moves) = asked_first(plan, &stage.steps)?;
    for step in moves.iter().filter_map(step_of) {
        let start = Start { stands: stands.as_ref(), confirmed };
        let blocks = step_blocks(plan, step, stage.repeat, start, &clearance)?;
        let blocks: Vec<Block> = blocks.into_iter().flat_map(|block| parts(step, block)).collect();
        let (mut ends, mut seconds) = (stands.clone().unwrap_or_else(|| step.from.clone()), 0.0);
        for block in &blocks {
            seconds += machine_time_s(block, &ends, &plan.machine);
            ends = end_of(&block.motions, &ends);
        }
        stands = Some(ends.clone());
        confirmed = confirmed.after(step);
        tasks.push(Task { step: step.clone(), blocks, remaining_s: seconds, ends });
    }
    let mut left = 0.0;
    for task in tasks.iter_mut().rev() {
        left += task.remaining_s;
        task.remaining_s = left;
    }
    Ok(tasks)
}
