//! `trued resume`: resumes a run after a person has checked the machine.

use std::path::Path;

use super::ExitStatus;
use super::args::ResumeArgs;
use super::device_links::DeviceLinks;
use super::failure::CommandFailure;
use super::files::state_folder;
use super::progress::ProgressDisplay;
use super::run::{build_runtime, check_report_folder, open_devices, print_result_and_write_report};
use super::signals::start_signal_halt_thread;
use super::terminal::{enter_key_answer_source, prompt_line};
use crate::run::{
    CycleError, ResumableRun, ResumeQuestion, ResumeRefusal, identify_stored_run, resume_question, store_identification,
};
use crate::store::{Journal, MachineLock, RunId, RunState, StoredRun};
use machine::record::event::RunEvent;

/// `trued resume`: resumes a run after its acknowledgement. If all steps are measured, only the estimate is computed.
pub fn resume_command(args: &ResumeArgs, state: Option<&Path>) -> Result<ExitStatus, CommandFailure> {
    check_report_folder(&args.output)?;
    let folder = state_folder(state)?;
    let (journal, id) = (Journal::open(&folder)?, RunId(args.run));
    let stored = journal.load_run(id)?;
    if stored.summary.state == RunState::NotIdentified {
        return identify_measured_run(args, &journal, state, stored);
    }
    let lock = MachineLock::acquire(&folder, &stored.summary.machine)?;
    journal.mark_running_runs_interrupted(&lock).wait()?;
    let again = ResumableRun::from_stored(journal.load_run(id)?)?;
    check_same_machine_file(args, &again.stored_run)?;
    let (who, acknowledged) = acknowledge_resume(args, &again)?;
    let links = DeviceLinks::from_options(args.output.capture.as_deref(), None)?;
    journal.add_event(id, &acknowledged).wait()?;

    let name = again.stored_run.plan.method.clone();
    let mut progress = ProgressDisplay::start(args.output.json);
    let answers = enter_key_answer_source(who, progress.line_printer());
    let mut tell = |event: &RunEvent| progress.show_event(event);
    tell(&acknowledged);
    let result = build_runtime()?.block_on(async {
        let opening = open_devices(&again.machine_file, args.output.speed, again.earlier_sessions());
        let devices = links.connect(opening).await?;
        start_signal_halt_thread(devices.open_controller.halt_handle())?;
        let result = again.resume_and_identify(&devices, &journal, answers, &mut tell).await;
        result.map_err(|error| CommandFailure::from_cycle_error(&error, &name))
    });
    let (id, estimate) = links.end_capture_and_map_error(result)?;
    print_result_and_write_report(&journal, state, id, estimate, &args.output, links.is_journal_kept())
}

/// Identifies a run that was measured to its end; neither the machine nor an operator is needed.
fn identify_measured_run(
    args: &ResumeArgs,
    journal: &Journal,
    state: Option<&Path>,
    stored: StoredRun,
) -> Result<ExitStatus, CommandFailure> {
    check_same_machine_file(args, &stored)?;
    let (run, method) = (stored.summary.id, stored.plan.method.clone());
    errln!("all steps of run {run} are measured: computing the estimate from {} readings", stored.readings.len());
    let result = identify_stored_run(stored);
    let result = build_runtime()?.block_on(store_identification(journal, run, result));
    let of_cycle = |why| CommandFailure::from_cycle_error(&CycleError::NotIdentified { run, why }, &method);
    print_result_and_write_report(journal, state, run, result.map_err(of_cycle)?, &args.output, true)
}

impl From<ResumeRefusal> for CommandFailure {
    fn from(error: ResumeRefusal) -> Self {
        let what = error.to_string();
        let (question, homed) = match error {
            ResumeRefusal::Setup(error) => return error.into(),
            ResumeRefusal::NotResumable { next_action, .. } => {
                return Self::new(what, next_action.unwrap_or_else(|| "start a new run".to_owned()));
            }
            ResumeRefusal::OperatorNameMissing(question) => {
                let homed = if question.may_have_lost_position { " --homed" } else { "" };
                (question, homed)
            }
            ResumeRefusal::HomingNotConfirmed(question) => (question, " --homed"),
        };
        let ResumeQuestion { run, question_text: confirmation, .. } = question;
        let remedy =
            format!("check the machine ({confirmation}), then `trued resume {run} --acknowledge YOUR_NAME{homed}`");
        Self { exit_status: ExitStatus::UsageError, ..Self::new(what, remedy) }
    }
}

/// Checks that the machine file is the stored one: another machine file requires a new run.
fn check_same_machine_file(args: &ResumeArgs, stored: &StoredRun) -> Result<(), CommandFailure> {
    let Some(file) = &args.machine else { return Ok(()) };
    let text = std::fs::read_to_string(file).map_err(|error| CommandFailure::from_file_error(file, &error))?;
    if text == stored.machine_file_text {
        return Ok(());
    }
    let pairs = text.lines().zip(stored.machine_file_text.lines()).enumerate();
    let differs = pairs.into_iter().find(|(_, (now, then))| now != then);
    let what = differs.map_or("one file is longer".to_owned(), |(i, (now, then))| {
        format!("line {} is `{now}` instead of `{then}`", i + 1)
    });
    Err(CommandFailure::new(
        format!("{} differs from the machine file of run {}: {what}", file.display(), stored.summary.id),
        "resume without --machine to use the stored machine file, or start a new run",
    ))
}

/// Name of the operator, and the acknowledgement that the machine may move.
fn acknowledge_resume(args: &ResumeArgs, resumable_run: &ResumableRun) -> Result<(String, RunEvent), CommandFailure> {
    let who = match &args.acknowledge {
        Some(name) => name.clone(),
        None => prompt_for_operator_name(&resume_question(&resumable_run.stored_run))?,
    };
    // The question on the terminal includes the homing.
    let homed = args.homed || args.acknowledge.is_none();
    let acknowledged = resumable_run.acknowledgement_event(&who, homed)?;
    Ok((who.trim().to_owned(), acknowledged))
}

/// Prompts on the terminal for the name of the operator, which acknowledges the resume; an empty name cancels it.
fn prompt_for_operator_name(
    ResumeQuestion { end_reason, question_text: confirmation, .. }: &ResumeQuestion,
) -> Result<String, CommandFailure> {
    prompt_line(&format!(
        "{end_reason}\nCheck the machine: {confirmation} The machine will move: first Z straight up, then to the \
        references.\nType your name to continue, or press Enter to cancel:"
    ))
    .map_err(CommandFailure::without_remedy)
}
