//! One stage: plan all of its blocks, prove the text they become, then execute them.

use tokio::sync::oneshot;

use super::asking::first_question;
use super::behind::{COMPUTING, behind};
use super::{Run, RunError};
use machine::record::artefact::Artefact;
use machine::record::event::Event;
use machine::record::motion::{Block, Outcome};
use machine::record::plan::{Plan, Stage, Step};
use machine::record::proof::Proof;
use machine::record::reading::{Flag, Reading};
use machine::{Axis, Position};
use methods::{Method, Next, Source};
use planning::gcode::{Dialect, Program};
use planning::proof::{self, Request, Staged};
use planning::{Clearance, Start, asked_first, end_of, machine_time_s, step_blocks};

/// The blocks of a step with what belongs to them.
struct Task {
    step: Step,
    blocks: Vec<Block>,
    /// Machine time from here to the end of the stage, s.
    remaining_s: f64,
    /// Where the machine stands afterwards.
    ends: Position,
}

/// From where a stage sets out.
#[derive(Clone)]
struct Begin {
    stands: Option<Position>,
    /// It is the first approach since the control was prepared.
    first: bool,
}

impl Run<'_> {
    /// `done`: the stages before; `later_s`: machine time of the stages to come. Returns where the
    /// machine stands at the end.
    pub(super) async fn run_stage(
        &mut self,
        done: &[Stage],
        stage: &Stage,
        stands: Option<Position>,
        later_s: f64,
    ) -> Result<Option<Position>, RunError> {
        let stands = self.ask_first(stage, stands).await?;
        let begin = Begin { stands: stands.clone(), first: !self.approached };
        let (tasks, proof) = prove(&self.plan, &self.devices.dialect, done, stage, begin).await?;
        self.note(Event::StageProven { stage: stage.id, proof }).await?;
        let mut stands = stands;
        for task in tasks {
            let Task { step, blocks, remaining_s, ends } = task;
            let (id, repeat) = (step.id, stage.repeat);
            (self.tell)(&Event::StepStarted {
                step: id,
                repeat,
                label: step.label.clone(),
                remaining_s: remaining_s + later_s,
            });
            self.moved = true;
            self.approached = true;
            let measured = match &step.scan {
                None => self.touch(&step, repeat, blocks).await,
                Some(scan) => self.scan((&step, scan), repeat, blocks).await,
            };
            self.keep_readings(&step, measured.map_err(|error| error.on(&step))?).await?;
            stands = Some(ends);
        }
        Ok(stands)
    }

    /// On disk, before anybody hears of it.
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
        blocks: Vec<Block>,
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
            sensor: step.sensor.clone(),
            t_s: self.timeline.at(outcome.t_s.unwrap_or_else(|| self.devices.clock.now_s())),
            flag: Flag::None,
            temperatures_c: Default::default(),
        }])
    }
}

/// Go through a whole run from nominal positions: what any stage would be refused for is known
/// before the first move.
///
/// # Errors
/// What the first stage that cannot be measured is refused for.
pub async fn rehearse(
    method: &dyn Method,
    plan: &Plan,
    dialect: &Dialect,
) -> Result<Rehearsed, RunError> {
    let (stage_s, steps) = rehearsed(method, plan, dialect).await?;
    Ok(Rehearsed { machine_s: stage_s.iter().sum(), asks: first_question(&steps).is_some() })
}

/// What is known of a run before it begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rehearsed {
    /// Machine time of all stages, s.
    pub machine_s: f64,
    /// A person is asked on the way.
    pub asks: bool,
}

/// As [`rehearse`]: machine time of each stage, s, and the steps that it went through.
pub(super) async fn rehearsed(
    method: &dyn Method,
    plan: &Plan,
    dialect: &Dialect,
) -> Result<(Vec<f64>, Vec<Step>), RunError> {
    let mut plan = plan.clone();
    let (mut done, mut stage_s, mut stands) = (Vec::new(), Vec::new(), None);
    while let Next::Stage { stage, new_steps } = method.next(&plan, &done, Source::Nominal)? {
        plan.steps.extend(new_steps);
        let asks = !asked_first(&plan, &stage.steps)?.0.is_empty();
        let begin = Begin { stands: stands.clone(), first: done.is_empty() || asks };
        let (tasks, _) = prove(&plan, dialect, &done, &stage, begin).await?;
        stage_s.push(tasks.first().map_or(0.0, |task| task.remaining_s));
        stands = tasks.into_iter().next_back().map(|task| task.ends).or(stands);
        done.push(stage);
    }
    Ok((stage_s, plan.steps))
}

/// Plan and prove beside the runtime: a halt must not wait for it.
async fn prove(
    plan: &Plan,
    dialect: &Dialect,
    done: &[Stage],
    stage: &Stage,
    begin: Begin,
) -> Result<(Vec<Task>, Proof), RunError> {
    let (answer, result) = oneshot::channel();
    let found = done.iter().chain([stage]).rev().find_map(|stage| stage.found.clone());
    let (plan, dialect) = (plan.clone(), dialect.clone());
    let (stage, name) = (stage.clone(), stage.name.clone());
    std::thread::spawn(move || {
        behind(COMPUTING);
        drop(answer.send(proven(&plan, &stage, found.as_ref(), &begin, &dialect)));
    });
    result.await.map_err(|_| RunError::ProofGone { stage: name })?
}

/// The blocks of a stage, and the proof of the text that they become for this control.
fn proven(
    plan: &Plan,
    stage: &Stage,
    found: Option<&Artefact>,
    begin: &Begin,
    dialect: &Dialect,
) -> Result<(Vec<Task>, Proof), RunError> {
    let tasks = tasks(plan, stage, found, begin)?;
    let axes: Vec<Axis> = plan.machine.axes.keys().copied().collect();
    let blocks: Vec<Block> = tasks.iter().flat_map(|task| task.blocks.iter().cloned()).collect();
    let program = Program { title: &stage.name, axes: &axes, log: None };
    let text = dialect
        .program(&program, &blocks)
        .map_err(|source| RunError::Unwritable { stage: stage.name.clone(), source })?;
    let (_, moves) = asked_first(plan, &stage.steps)?;
    let stages = [Staged { steps: moves, found }];
    let (stages, stands, first) = (&stages, begin.stands.as_ref(), begin.first);
    let request = Request { plan, stages, stands, first, dialect, text: &text };
    let unproven = |refusal| {
        let (stage, source) = (stage.name.clone(), Box::new(refusal));
        RunError::Unproven { stage, source }
    };
    let proof = proof::prove(&request).map_err(unproven)?;
    Ok((tasks, proof))
}

/// The blocks of a stage; nothing is planned that has no way to its start.
fn tasks(
    plan: &Plan,
    stage: &Stage,
    found: Option<&Artefact>,
    begin: &Begin,
) -> Result<Vec<Task>, RunError> {
    let clearance = Clearance::known(plan, found)?;
    let mut stands = begin.stands.clone();
    let mut tasks = Vec::new();
    let step_of = |id: &u32| plan.steps.iter().find(|step| step.id == *id);
    let (_, moves) = asked_first(plan, &stage.steps)?;
    for step in moves.iter().filter_map(step_of) {
        let first = begin.first && tasks.is_empty();
        let start = Start { stands: stands.as_ref(), first };
        let blocks = step_blocks(plan, step, stage.repeat, start, &clearance)?;
        let (mut ends, mut seconds) = (stands.clone().unwrap_or_else(|| step.from.clone()), 0.0);
        for block in &blocks {
            seconds += machine_time_s(block, &ends, &plan.machine);
            ends = end_of(block, &ends);
        }
        stands = Some(ends.clone());
        tasks.push(Task { step: step.clone(), blocks, remaining_s: seconds, ends });
    }
    let mut left = 0.0;
    for task in tasks.iter_mut().rev() {
        left += task.remaining_s;
        task.remaining_s = left;
    }
    Ok(tasks)
}
