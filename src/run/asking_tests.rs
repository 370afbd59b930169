//! Runs that ask, on the simulated control; what is sent to it is counted on its way.

use std::sync::{Arc, Mutex};

use super::*;
use crate::setup::{self, MachineFile, Pace, Past};
use crate::store::{NewRun, StoredRun};
use devices::controllers::{
    Controller, ControllerError, Driver, Halt, Introduction, Look, Prepared,
};
use machine::record::estimate::Estimate;
use machine::record::motion::Outcome;
use machine::record::plan::{Step, StepKind};
use methods::{IdentifyError, Refused};
use planning::PlanningError;
use planning::proof::ProvenBlock;

type Calls = Arc<Mutex<Vec<&'static str>>>;

/// Counts what is asked of the control behind it.
struct Counted {
    inner: Controller,
    calls: Calls,
}

impl Counted {
    fn count(&self, call: &'static str) -> &Controller {
        self.calls.lock().unwrap().push(call);
        &self.inner
    }
}

impl Driver for Counted {
    async fn prepare(&mut self) -> Result<Prepared, ControllerError> {
        self.count("prepare").prepare().await
    }

    async fn execute(&mut self, block: ProvenBlock) -> Result<Outcome, ControllerError> {
        self.count("execute").execute(block).await
    }

    async fn look(&mut self) -> Result<Look, ControllerError> {
        self.count("look").look().await
    }

    async fn introduce(&mut self) -> Result<Introduction, ControllerError> {
        self.count("introduce").introduce().await
    }

    async fn finish(&mut self) -> Result<(), ControllerError> {
        self.count("finish").finish().await
    }
}

/// As a method that has a person turn the part: its own prompt at the head of the cycle's first stage, or
/// behind the touches of it, where none may stand.
struct Turning {
    inner: Box<dyn Method>,
    late: bool,
}

impl Method for Turning {
    fn settings(&self) -> serde_json::Value {
        self.inner.settings()
    }

    fn next(&self, plan: &Plan, done: &[Stage], readings: Source<'_>) -> Result<Next, Refused> {
        let next = self.inner.next(plan, done, readings)?;
        let Next::Stage { mut stage, mut new_steps } = next else { return Ok(next) };
        if done.len() == 1 {
            let last = new_steps.last().unwrap().clone();
            let prompt = Step {
                id: last.id + 1,
                kind: StepKind::Prompt,
                label: "turn".to_owned(),
                from: Position::new(),
                to: Position::new(),
                text: Some("turn the part".to_owned()),
                mount: None,
                ..last
            };
            let place = if self.late { stage.steps.len() } else { 0 };
            stage.steps.insert(place, prompt.id);
            new_steps.push(prompt);
        }
        Ok(Next::Stage { stage, new_steps })
    }

    fn identify(&self, _: &Plan, _: &[Reading]) -> Result<Estimate, IdentifyError> {
        Err(IdentifyError::Numerical("nobody asks for it".to_owned()))
    }
}

struct Shop {
    folder: tempfile::TempDir,
    journal: Journal,
    file: MachineFile,
    calls: Calls,
}

impl Shop {
    /// `more`: of the machine file.
    fn new(more: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let text = crate::setup::built_in("self-calibration").text;
        let text = format!("{text}\n[method.self-calibration]\npositions = 5\nrepeats = 2\n{more}");
        let file = MachineFile::parse("shop.toml", text).unwrap();
        let journal = Journal::open(folder.path()).unwrap();
        Self { folder, journal, file, calls: Calls::default() }
    }

    fn method(&self) -> (Box<dyn Method>, Plan) {
        setup::header(&self.file, "self-calibration", None).unwrap()
    }

    async fn devices(&self, past: Past<'_>) -> (Devices, Halt) {
        let mut devices = setup::devices(&self.file, Pace::Fast, past).await.unwrap();
        let halt = devices.controller.halt();
        let (halt_too, calls) = (halt.clone(), self.calls.clone());
        let counted = |inner| Controller::spawn(Counted { inner, calls }, halt_too);
        let inner = std::mem::replace(&mut devices.controller, dead());
        devices.controller = counted(inner);
        (devices, halt)
    }

    /// Until it ends: `answers` and `tell` are given the halt.
    async fn runs(
        &self,
        method: &dyn Method,
        answers: impl FnOnce(Halt) -> Answers,
        tell: impl Fn(&Event, &Halt),
    ) -> (Result<(), RunError>, StoredRun) {
        let (_, plan) = self.method();
        let new = NewRun { config: self.file.text().to_owned(), plan: plan.clone() };
        let id = self.journal.begin(&new).await.unwrap();
        let (devices, halt) = self.devices(Past::default()).await;
        let mut tell = |event: &Event| tell(event, &halt);
        let run = Run::new(id, method, &devices, &self.journal, plan, &mut tell);
        let ended = run.asking(answers(halt.clone())).execute().await;
        (ended, self.journal.load(id).unwrap())
    }

    /// A person lets it go on, in another process.
    async fn goes_on(
        &self,
        method: &dyn Method,
        stored: StoredRun,
        tell: impl Fn(&Event, &Halt),
    ) -> (Result<(), RunError>, StoredRun) {
        let id = stored.summary.id;
        let past = Past { readings: &stored.readings, elapsed_s: 60.0, ..Past::default() };
        let (devices, halt) = self.devices(past).await;
        let mut tell = |event: &Event| tell(event, &halt);
        let answered = asking::answered(&stored.events);
        let (stages, readings) = (stored.stages.clone(), stored.readings.clone());
        let run = Run::new(id, method, &devices, &self.journal, stored.plan.clone(), &mut tell);
        let before = Interrupted { stages, readings, answered, elapsed_s: 60.0 };
        let ended = run.asking(ada()).resume(before).await;
        (ended, self.journal.load(id).unwrap())
    }

    fn calls(&self) -> Vec<&'static str> {
        self.calls.lock().unwrap().clone()
    }
}

/// In the place of a control, for a moment.
fn dead() -> Controller {
    struct Nothing;
    impl Driver for Nothing {
        async fn prepare(&mut self) -> Result<Prepared, ControllerError> {
            Err(ControllerError::DriverGone)
        }
        async fn execute(&mut self, _: ProvenBlock) -> Result<Outcome, ControllerError> {
            Err(ControllerError::DriverGone)
        }
        async fn look(&mut self) -> Result<Look, ControllerError> {
            Err(ControllerError::DriverGone)
        }
        async fn introduce(&mut self) -> Result<Introduction, ControllerError> {
            Err(ControllerError::DriverGone)
        }
        async fn finish(&mut self) -> Result<(), ControllerError> {
            Err(ControllerError::DriverGone)
        }
    }
    Controller::spawn(Nothing, Halt::new(|| {}))
}

fn ada() -> Answers {
    Answers::new(|_| Some("Ada".to_owned()))
}

/// What was asked (step, pass) and answered, in order.
fn talk(stored: &StoredRun) -> Vec<(&'static str, u32, u32)> {
    let told = |event: &Event| match event {
        Event::Asked { step, repeat, .. } => Some(("asked", *step, *repeat)),
        Event::Answered { step, repeat, .. } => Some(("answered", *step, *repeat)),
        _ => None,
    };
    stored.events.iter().filter_map(|(_, event)| told(event)).collect()
}

const TWO: &str = "[[prompt]]\ntext = \"the part is clean\"\n[[prompt]]\ntext = \"so is the stylus\"\n\
                   methods = [\"self-calibration\"]\n[[prompt]]\ntext = \"no\"\nmethods = [\"samba\"]\n";

#[tokio::test]
async fn nothing_is_sent_between_question_and_answer_and_then_it_is_looked_anew() {
    let shop = Shop::new(TWO);
    let (method, _) = shop.method();
    let (calls, seen) = (shop.calls.clone(), Calls::default());
    let note = {
        let (calls, seen) = (calls.clone(), seen.clone());
        move || seen.lock().unwrap().extend(calls.lock().unwrap().last())
    };
    let looks = Mutex::new(0);
    let answers = |_| {
        let note = note.clone();
        Answers::new(move |_| {
            note();
            let mut looks = looks.lock().unwrap();
            *looks += 1;
            (*looks % 3 == 0).then(|| "Ada".to_owned())
        })
    };
    let told = |event: &Event, _: &Halt| match event {
        Event::Asked { .. } | Event::Answered { .. } => note(),
        _ => {}
    };
    let (ended, stored) = shop.runs(method.as_ref(), answers, told).await;
    ended.unwrap();
    // Asked, looked for three times, answered; twice. Until then the control was prepared, no more.
    assert_eq!(*seen.lock().unwrap(), ["prepare"; 10]);
    // Whoever answered was at the machine: it is prepared again.
    assert_eq!(shop.calls()[..3], ["prepare", "prepare", "execute"]);
    let asked = [("asked", 0, 0), ("answered", 0, 0), ("asked", 1, 0), ("answered", 1, 0)];
    assert_eq!(talk(&stored), asked);
    let ids: Vec<u32> = stored.plan.steps.iter().map(|step| step.id).collect();
    assert_eq!(ids, (0..ids.len() as u32).collect::<Vec<_>>());
    assert_eq!(stored.plan.steps[1].text.as_deref(), Some("so is the stylus"));
    let proven = |(_, event): &(_, Event)| matches!(event, Event::StageProven { .. });
    let before = stored.events.iter().take_while(|event| !proven(event)).count();
    assert!(talk(&StoredRun { events: stored.events[before..].to_vec(), ..stored }).is_empty());
}

#[tokio::test]
async fn a_halt_ends_the_wait_and_without_anybody_nothing_begins() {
    let shop = Shop::new(TWO);
    let (method, _) = shop.method();
    let nobody = |_| Answers::nobody();
    let (refused, stored) = shop.runs(method.as_ref(), nobody, |_, _| {}).await;
    assert!(matches!(refused, Err(RunError::NobodyThere { .. })), "{refused:?}");
    assert_eq!((shop.calls(), stored.summary.state), (vec![], RunState::Failed));

    let stops = |halt: Halt| {
        Answers::new(move |_| {
            halt.now();
            None
        })
    };
    let (held, stored) = shop.runs(method.as_ref(), stops, |_, _| {}).await;
    assert!(held.unwrap_err().is_stop());
    assert_eq!((shop.calls(), stored.summary.state), (vec!["prepare"], RunState::Held));
    assert_eq!(talk(&stored), [("asked", 0, 0)]);
}

#[tokio::test]
async fn a_prompt_behind_a_touch_is_refused_before_anything_moves() {
    let shop = Shop::new("");
    let method = Turning { inner: shop.method().0, late: true };
    let (refused, _) = shop.runs(&method, |_| ada(), |_, _| {}).await;
    let late = matches!(refused, Err(RunError::Planning(PlanningError::LatePrompt { .. })));
    assert!(late && shop.calls().is_empty(), "{refused:?}");
}

/// The cycle's second pass asks again. Stopped while it waits, it is asked once more; stopped after the answer,
/// it is not.
#[tokio::test]
async fn what_was_answered_is_not_asked_again_after_a_stop() {
    let shop = Shop::new("");
    let method = Turning { inner: shop.method().0, late: false };
    let stops = |halt: Halt| {
        Answers::new(move |asked| {
            if asked.repeat == 1 {
                halt.now();
            }
            (asked.repeat == 0).then(|| "Ada".to_owned())
        })
    };
    let (held, stored) = shop.runs(&method, stops, |_, _| {}).await;
    assert!(held.unwrap_err().is_stop());
    let prompt = stored.plan.steps.last().unwrap().id;
    let first = [("asked", prompt, 0), ("answered", prompt, 0), ("asked", prompt, 1)];
    assert_eq!((talk(&stored), stored.summary.state), (first.to_vec(), RunState::Held));

    let after_one = |event: &Event, halt: &Halt| match event {
        Event::ReadingStored { reading } if reading.repeat == 1 => halt.now(),
        _ => {}
    };
    let (held, stored) = shop.goes_on(&method, stored, after_one).await;
    assert!(held.unwrap_err().is_stop());
    let again = [("asked", prompt, 1), ("answered", prompt, 1)];
    assert_eq!(talk(&stored), [&first[..], &again].concat());

    let (ended, finished) = shop.goes_on(&method, stored.clone(), |_, _| {}).await;
    ended.unwrap();
    assert_eq!(talk(&finished), talk(&stored));
    assert_eq!(finished.summary.state, RunState::NotIdentified);
    drop(shop.folder);
}
