//! Client of a daemon that holds the machine: the command starts one of the daemon's cycles, as the page would,
//! and waits for its end.

use std::path::Path;
use std::thread::sleep;
use std::time::Duration;

use serde_json::{Value, json};

use super::Exit;
use super::args::RunArgs;
use super::failure::Failure;
use super::progress::Progress;
use super::signals::stop_on_signals;
use super::terminal::{by_enter, typed};
use crate::run::{Asked, PromptAnswers};
use crate::service::{PageAddressFile, address};
use crate::setup::MachineFile;
use crate::store::{Holder, Journal, LockError, RunId, sha256_text};
use devices::controllers::Halt;
use machine::record::estimate::Estimate;
use machine::record::event::Event;

/// Polling period of the daemon's state.
const POLL_PERIOD: Duration = Duration::from_millis(200);
/// Timeout of a request; a daemon that does not answer within it has died or hangs.
const PATIENCE: Duration = Duration::from_secs(10);
/// Environment variable with the token, for a daemon that accepts requests with a token only.
const TOKEN: &str = "TRUED_TOKEN";

/// Connection to the daemon that holds a machine.
#[derive(Clone)]
pub struct Daemon {
    agent: ureq::Agent,
    /// URL of the machine in the daemon's interface.
    address: String,
    token: Option<String>,
    /// SHA-256 of the machine file that the daemon has read.
    machine_file: String,
}

impl Daemon {
    /// The daemon that holds the machine, if the holder of the lock serves a page.
    pub fn that_has_it(error: &LockError, folder: &Path) -> Option<Self> {
        let LockError::Held { holder: Some(Holder { machine, pid, .. }), .. } = error else {
            return None;
        };
        let PageAddressFile { page, machine_files, .. } = PageAddressFile::of(*pid, folder)?;
        let machine_file = machine_files.get(machine)?.clone();
        let agent = ureq::Agent::config_builder()
            .timeout_global(Some(PATIENCE))
            .http_status_as_error(false)
            .proxy(None)
            .build();
        let address = format!("http://{page}/api/v1{}", address(machine));
        let token = std::env::var(TOKEN).ok();
        Some(Self { agent: agent.into(), address, token, machine_file })
    }

    /// Starts the cycle that `args` name and waits for its end. A signal holds the machine.
    pub fn run(
        &self,
        args: &RunArgs,
        machine: &MachineFile,
        journal: &Journal,
    ) -> Result<(RunId, Estimate), Failure> {
        alone_can(args)?;
        self.knows(args, machine)?;
        let standing = self.standing()?;
        let cycles = standing["cycles"].as_array().map_or(&[][..], Vec::as_slice);
        let cycle = cycles.iter().find(|cycle| cycle["method"] == *args.method);
        let cycle = cycle.ok_or_else(|| no_such_cycle(&args.method, cycles))?;
        let who = who(args)?;
        let daemon = self.clone();
        stop_on_signals(Halt::new(move || drop(daemon.post("hold", &json!({})))))?;
        let vouched = json!({
            "cycle": cycle["number"], "who": who, "enable": true, "auto": true, "door": true,
        });
        self.post("start", &vouched)?;
        let mut progress = Progress::start(args.output.json);
        let answers = by_enter(who.clone(), progress.printer());
        let ended = self.watched(&who, &answers, &mut progress)?;
        let run = RunId(ended["run"].as_i64().unwrap_or(0));
        match ended["state"].as_str() {
            Some("waiting") => {}
            Some("held") => {
                let way_on = format!("look at the machine, then `trued resume {run}`");
                return Err(Failure {
                    exit: Exit::Stopped,
                    ..Failure::new(format!("run {run} is held"), way_on)
                });
            }
            _ => return Err(Failure::new("the cycle has failed", "the daemon's log says why")),
        }
        let last = journal.load(run)?.estimates.pop();
        let last = last.ok_or_else(|| {
            let what = format!("run {run} is measured and not identified");
            Failure::new(what, format!("the daemon identifies it: `trued show {run}`"))
        })?;
        Ok((run, last.estimate))
    }

    /// Waits until no run is in progress; reports each stage and passes prompts to `who`.
    fn watched(
        &self,
        who: &str,
        answers: &PromptAnswers,
        progress: &mut Progress,
    ) -> Result<Value, Failure> {
        let (mut stage, mut open) = (Value::Null, None);
        let print = progress.printer();
        loop {
            let standing = self.standing()?;
            if standing["state"] != "running" {
                return Ok(standing);
            }
            let asked = question(&standing["asked"]);
            if asked.is_some() && asked != open {
                print("a person is asked, here at a terminal or at the page:");
            }
            let values = serde_json::from_value(standing["asked"]["live"].clone());
            progress.tell(&Event::Watched { values: values.unwrap_or_default() });
            if let Some(Asked { step, repeat, .. }) =
                asked.as_ref().filter(|asked| answers.look(asked).is_some())
                && let Err(refused) =
                    self.post("answer", &json!({"step": step, "repeat": repeat, "who": who}))
            {
                // Another person has confirmed the prompt on the page first.
                print(&refused.what);
            }
            open = asked;
            if standing["stage"] != stage && standing["stage"] != "" {
                stage = standing["stage"].clone();
                let left = standing["remaining_s"].as_f64();
                let left = left.map(|s| format!(": about {:.0} min left", s / 60.0));
                let stage = stage.as_str().unwrap_or_default();
                print(&format!("{stage}{}", left.unwrap_or_default()));
            }
            sleep(POLL_PERIOD);
        }
    }

    /// Checks that the daemon uses the same machine file; it keeps the one that it read at its start.
    fn knows(&self, args: &RunArgs, machine: &MachineFile) -> Result<(), Failure> {
        if sha256_text(machine.text()) == self.machine_file {
            return Ok(());
        }
        let file = args.machine.as_ref().map(|file| file.display().to_string());
        let file = file.unwrap_or_else(|| "the built-in machine file".to_owned());
        Err(Failure::new(
            format!("a daemon has the machine, and {file} is not what it has read when it began"),
            "give the file that it serves; if that was changed since, let the daemon begin anew",
        ))
    }

    fn standing(&self) -> Result<Value, Failure> {
        answer(self.known(self.agent.get(&self.address)).call())
    }

    fn post(&self, what: &str, words: &Value) -> Result<Value, Failure> {
        let request = self.agent.post(format!("{}/{what}", self.address));
        answer(self.known(request).send_json(words))
    }

    fn known<B>(&self, request: ureq::RequestBuilder<B>) -> ureq::RequestBuilder<B> {
        match &self.token {
            Some(token) => request.header("Authorization", format!("Bearer {token}")),
            None => request,
        }
    }
}

/// The open prompt of the run.
fn question(asked: &Value) -> Option<Asked> {
    let number = |key: &str| u32::try_from(asked[key].as_u64()?).ok();
    let (step, repeat) = (number("step")?, number("repeat")?);
    Some(Asked { step, repeat, text: asked["text"].as_str()?.to_owned() })
}

fn answer(
    answered: Result<ureq::http::Response<ureq::Body>, ureq::Error>,
) -> Result<Value, Failure> {
    let lost = |error: ureq::Error| {
        Failure::new(
            format!("the daemon that has the machine does not answer: {error}"),
            "look at the machine, and at the daemon's log",
        )
    };
    let mut answered = answered.map_err(lost)?;
    let refused = !answered.status().is_success();
    let said: Value = answered.body_mut().read_json().map_err(lost)?;
    let word = |key: &str| said[key].as_str().unwrap_or_default().to_owned();
    match (refused, word("code").as_str()) {
        (false, _) => Ok(said),
        (true, "no-token") => {
            Err(Failure::new(word("message"), format!("put a token into {TOKEN}")))
        }
        (true, _) => Err(Failure::new(format!("the daemon: {}", word("message")), word("remedy"))),
    }
}

/// Refuses options that a cycle of the daemon does not support.
fn alone_can(args: &RunArgs) -> Result<(), Failure> {
    let only = [
        ("--with", !args.with.is_empty()),
        ("--repeat", args.repeat.is_some()),
        ("--capture", args.output.capture.is_some()),
        ("--speed", args.output.speed.is_some()),
    ];
    match only.into_iter().find(|(_, is_asked)| *is_asked) {
        None => Ok(()),
        Some((option, _)) => Err(Failure::new(
            format!("a daemon has the machine, and its cycles know no {option}"),
            "go without it, or end the daemon first",
        )),
    }
}

fn no_such_cycle(method: &str, cycles: &[Value]) -> Failure {
    let known: Vec<&str> = cycles.iter().filter_map(|cycle| cycle["method"].as_str()).collect();
    Failure::new(
        format!("a daemon has the machine, and none of its cycles is {method}"),
        format!("ask for one of {}, or add it to [serve] of the machine file", known.join(", ")),
    )
}

/// Name of the person who confirms the conditions that the page would ask for.
fn who(args: &RunArgs) -> Result<String, Failure> {
    const ASK: &str =
        "is it free to be moved, the control in its automatic mode, are the guards closed?";
    let who = match &args.acknowledge {
        Some(name) => name.trim().to_owned(),
        None => typed(&format!(
            "a daemon has the machine and would move it: {ASK}\ntype your name to start, nothing to leave it:"
        ))
        .map_err(Failure::plain)?,
    };
    match who.is_empty() {
        false => Ok(who),
        true => Err(Failure {
            exit: Exit::Usage,
            ..Failure::new(
                "nobody vouches for the machine; nothing has moved",
                format!("look at the machine ({ASK}), then give `--acknowledge YOUR_NAME`"),
            )
        }),
    }
}
