//! Client of a daemon that holds the machine: the command starts one of the daemon's cycles, as the web page would,
//! and waits for its end.

use std::path::Path;
use std::thread::sleep;
use std::time::Duration;

use serde_json::{Value, json};

use super::ExitStatus;
use super::args::RunArgs;
use super::failure::CommandFailure;
use super::progress::ProgressDisplay;
use super::signals::start_signal_halt_thread;
use super::terminal::{enter_key_answer_source, prompt_line};
use crate::run::{OpenPrompt, PromptAnswerSource};
use crate::service::{PageAddressFile, machine_page_path};
use crate::setup::MachineFile;
use crate::store::{Journal, LockError, LockHolder, RunId, sha256_text};
use devices::controllers::HaltHandle;
use machine::record::estimate::Estimate;
use machine::record::event::RunEvent;

/// Polling period of the daemon's state.
const POLL_PERIOD: Duration = Duration::from_millis(200);
/// Timeout of a request. A daemon that does not answer within this time has ended or hangs.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);
/// Environment variable with the token, for a daemon that requires a token.
const TOKEN_VARIABLE: &str = "TRUED_TOKEN";

/// Connection to the daemon that holds a machine.
#[derive(Clone)]
pub struct DaemonClient {
    agent: ureq::Agent,
    /// URL of the machine in the daemon's interface.
    machine_url: String,
    /// Value of the environment variable `TRUED_TOKEN`, if set.
    token: Option<String>,
    /// SHA-256 of the machine file that the daemon has read.
    machine_file_sha256: String,
}

impl DaemonClient {
    /// Client of the daemon that holds the machine's lock; `None` if the error is another one, or the holder of the
    /// lock serves no page.
    pub fn from_lock_error(error: &LockError, folder: &Path) -> Option<Self> {
        let LockError::MachineInUse { holder: Some(LockHolder { machine, pid, .. }), .. } = error else {
            return None;
        };
        let PageAddressFile { page, machine_file_sha256_by_machine: sha256_by_machine, .. } =
            PageAddressFile::read(*pid, folder)?;
        let machine_file_sha256 = sha256_by_machine.get(machine)?.clone();
        let agent = ureq::Agent::config_builder()
            .timeout_global(Some(REQUEST_TIMEOUT))
            .http_status_as_error(false)
            .proxy(None)
            .build();
        let machine_url = format!("http://{page}/api/v1{}", machine_page_path(machine));
        let token = std::env::var(TOKEN_VARIABLE).ok();
        Some(Self { agent: agent.into(), machine_url, token, machine_file_sha256 })
    }

    /// Starts the first cycle of the daemon with the method of `args`, waits for its end and returns its last
    /// estimate. A signal holds the machine.
    pub fn run_cycle(
        &self,
        args: &RunArgs,
        machine: &MachineFile,
        journal: &Journal,
    ) -> Result<(RunId, Estimate), CommandFailure> {
        refuse_unsupported_options(args)?;
        self.check_same_machine_file(args, machine)?;
        let state = self.machine_state()?;
        let cycles = state["cycles"].as_array().map_or(&[][..], Vec::as_slice);
        let cycle = cycles.iter().find(|cycle| cycle["method"] == *args.method);
        let cycle = cycle.ok_or_else(|| unknown_cycle_error(&args.method, cycles))?;
        let who = operator_name(args)?;
        let daemon = self.clone();
        start_signal_halt_thread(HaltHandle::new(move || drop(daemon.post("hold", &json!({})))))?;
        let request = json!({
            "cycle": cycle["number"], "who": who, "enable": true, "auto": true, "door": true,
        });
        self.post("start", &request)?;
        let mut progress = ProgressDisplay::start(args.output.json);
        let answers = enter_key_answer_source(who.clone(), progress.line_printer());
        let ended = self.wait_for_run_end(&who, &answers, &mut progress)?;
        let run = RunId(ended["run"].as_i64().unwrap_or(0));
        match ended["state"].as_str() {
            Some("waiting") => {}
            Some("held") => {
                let next_action = format!("check the machine, then `trued resume {run}`");
                return Err(CommandFailure {
                    exit_status: ExitStatus::Stopped,
                    ..CommandFailure::new(format!("run {run} is held"), next_action)
                });
            }
            _ => {
                return Err(CommandFailure::new(
                    "the daemon reports that the cycle has failed",
                    "read the reason in the log of the daemon",
                ));
            }
        }
        let last = journal.load_run(run)?.estimates.pop();
        let last = last.ok_or_else(|| {
            let what = format!("run {run} is measured, but has no estimate yet");
            CommandFailure::new(what, format!("the daemon computes the estimate; `trued show {run}` shows it"))
        })?;
        Ok((run, last.estimate))
    }

    /// Waits until the machine is no longer in the state `running` (a hold ends the wait as well) and returns its
    /// state. Reports each stage, and confirms prompts in the name of `who`.
    fn wait_for_run_end(
        &self,
        who: &str,
        answers: &PromptAnswerSource,
        progress: &mut ProgressDisplay,
    ) -> Result<Value, CommandFailure> {
        let (mut stage, mut open) = (Value::Null, None);
        let print = progress.line_printer();
        loop {
            let state = self.machine_state()?;
            if state["state"] != "running" {
                return Ok(state);
            }
            let asked = open_prompt(&state["asked"]);
            if asked.is_some() && asked != open {
                print("the run waits for the operator; confirm the prompt on a terminal or on the page:");
            }
            let values = serde_json::from_value(state["asked"]["live"].clone());
            progress.show_event(&RunEvent::Watched { values: values.unwrap_or_default() });
            if let Some(OpenPrompt { step_id: step, repeat_number: repeat, .. }) =
                asked.as_ref().filter(|asked| answers.poll(asked).is_some())
                && let Err(refused) = self.post("answer", &json!({"step": step, "repeat": repeat, "who": who}))
            {
                // Another person has confirmed the prompt on the web page first.
                print(&refused.message);
            }
            open = asked;
            if state["stage"] != stage && state["stage"] != "" {
                stage = state["stage"].clone();
                let left = state["remaining_s"].as_f64();
                let left = left.map(|s| format!(": about {:.0} min left", s / 60.0));
                let stage = stage.as_str().unwrap_or_default();
                print(&format!("{stage}{}", left.unwrap_or_default()));
            }
            sleep(POLL_PERIOD);
        }
    }

    /// Checks that the machine file is the same as the one that the daemon read at its start.
    fn check_same_machine_file(&self, args: &RunArgs, machine: &MachineFile) -> Result<(), CommandFailure> {
        if sha256_text(machine.text()) == self.machine_file_sha256 {
            return Ok(());
        }
        let file = args.machine.as_ref().map(|file| file.display().to_string());
        let file = file.unwrap_or_else(|| "the built-in machine file".to_owned());
        Err(CommandFailure::new(
            format!(
                "the machine file {file} differs from the machine file that the running daemon has read at its start"
            ),
            "Use the machine file of the daemon. If this file was changed, restart the daemon",
        ))
    }

    /// State of the machine as the daemon reports it.
    fn machine_state(&self) -> Result<Value, CommandFailure> {
        parse_response(self.with_token(self.agent.get(&self.machine_url)).call())
    }

    fn post(&self, action: &str, body: &Value) -> Result<Value, CommandFailure> {
        let request = self.agent.post(format!("{}/{action}", self.machine_url));
        parse_response(self.with_token(request).send_json(body))
    }

    fn with_token<B>(&self, request: ureq::RequestBuilder<B>) -> ureq::RequestBuilder<B> {
        match &self.token {
            Some(token) => request.header("Authorization", format!("Bearer {token}")),
            None => request,
        }
    }
}

/// The open prompt of the run, from the field `asked` of the machine's state.
fn open_prompt(asked: &Value) -> Option<OpenPrompt> {
    let number = |key: &str| u32::try_from(asked[key].as_u64()?).ok();
    let (step, repeat) = (number("step")?, number("repeat")?);
    Some(OpenPrompt { step_id: step, repeat_number: repeat, text: asked["text"].as_str()?.to_owned() })
}

/// Body of a successful response; an error for a refusal or if there is no response.
fn parse_response(answered: Result<ureq::http::Response<ureq::Body>, ureq::Error>) -> Result<Value, CommandFailure> {
    let lost = |error: ureq::Error| {
        CommandFailure::new(
            format!("no reply from the daemon that controls the machine: {error}"),
            "check the machine and the log of the daemon",
        )
    };
    let mut answered = answered.map_err(lost)?;
    let refused = !answered.status().is_success();
    let said: Value = answered.body_mut().read_json().map_err(lost)?;
    let word = |key: &str| said[key].as_str().unwrap_or_default().to_owned();
    match (refused, word("code").as_str()) {
        (false, _) => Ok(said),
        (true, "no-token") => Err(CommandFailure::new(
            word("message"),
            format!("set the environment variable {TOKEN_VARIABLE} to a valid token"),
        )),
        (true, _) => {
            Err(CommandFailure::new(format!("the daemon refuses the request: {}", word("message")), word("remedy")))
        }
    }
}

/// Refuses options that a cycle of the daemon does not support.
fn refuse_unsupported_options(args: &RunArgs) -> Result<(), CommandFailure> {
    let only = [
        ("--with", !args.with.is_empty()),
        ("--repeat", args.repeat.is_some()),
        ("--capture", args.output.capture.is_some()),
        ("--speed", args.output.speed.is_some()),
    ];
    match only.into_iter().find(|(_, is_asked)| *is_asked) {
        None => Ok(()),
        Some((option, _)) => Err(CommandFailure::new(
            format!("a daemon controls the machine, and the option {option} is not available for its cycles"),
            "omit the option, or stop the daemon first",
        )),
    }
}

fn unknown_cycle_error(method: &str, cycles: &[Value]) -> CommandFailure {
    let known: Vec<&str> = cycles.iter().filter_map(|cycle| cycle["method"].as_str()).collect();
    CommandFailure::new(
        format!("a daemon controls the machine, and none of its cycles has the method {method}"),
        format!("choose one of {}, or add the method to [serve] of the machine file", known.join(", ")),
    )
}

/// Name of the operator who confirms that the machine may move; without `--acknowledge` it is read from the terminal.
fn operator_name(args: &RunArgs) -> Result<String, CommandFailure> {
    const START_CONDITIONS: &str = "the machine may move, the control is in automatic mode, the guards are closed";
    let who = match &args.acknowledge {
        Some(name) => name.trim().to_owned(),
        None => prompt_line(&format!(
            "A daemon controls the machine and will move it. Make sure that: {START_CONDITIONS}.\nType your name to \
            start, or press Enter to cancel:"
        ))
        .map_err(CommandFailure::without_remedy)?,
    };
    match who.is_empty() {
        false => Ok(who),
        true => Err(CommandFailure {
            exit_status: ExitStatus::UsageError,
            ..CommandFailure::new(
                "no operator has confirmed that the machine may move; nothing has moved",
                format!("check the machine ({START_CONDITIONS}), then add `--acknowledge YOUR_NAME`"),
            )
        }),
    }
}
