//! `trued check`: compares the machine with its machine file, part by part. Each part checks one aspect,
//! reports its findings, and gives a remedy for each fault. Every motion is proven and needs the operator's
//! permission directly before it; a check that needs an absent operator is reported as not checked.
//!
//! A failed part ends the check if it would not be safe to continue; otherwise the next part follows.

mod axes;
mod control;
mod finding;
mod hold;
mod jog;
mod latch;
mod links;
mod machine_file_comparison;
mod operator_interface;
mod probe;
mod question_text;
mod report_data;
mod retract;
mod sensors;
mod stop;
mod thermometers;

use std::pin::Pin;
use std::time::Instant;

pub use finding::{CheckFinding, CheckPart, CheckSummary, CheckVerdict};
pub use operator_interface::{AnswerFuture, NoOperator, OperatorInterface};
pub use question_text::describe_question;
pub use stop::CheckStop;

use crate::setup::{Devices, MachineFile, ReopenableMachine, SetupError, SimulationPace};
use crate::store::Journal;
use devices::controllers::Controller;
use machine::record::question::{OperatorAnswer, OperatorQuestion};
use machine::{Axis, Position};
use planning::gcode::TransmissionForm;

/// Reason why the remaining parts are not checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CheckEnd {
    /// The fault must be corrected first. The remaining parts are reported as not checked.
    Unsafe,
    /// A person has stopped the check. The remaining parts have no finding.
    Stopped,
}

/// The part to which a finding belongs, and the start of the check that leads to the finding.
#[derive(Clone, Copy)]
struct PartTimer {
    part: CheckPart,
    started: Instant,
}

impl PartTimer {
    fn start(part: CheckPart) -> Self {
        Self { part, started: Instant::now() }
    }
}

type PartCheckFuture<'c> = Pin<Box<dyn Future<Output = Result<(), CheckEnd>> + 'c>>;
type PartCheckFn = for<'c, 'a> fn(&'c mut MachineCheck<'a>) -> PartCheckFuture<'c>;

/// The parts in their order, each with the function that checks it. The part `report` follows, also after an unsafe
/// end.
const CHECK_PARTS: [(CheckPart, PartCheckFn); 7] = [
    (CheckPart::Links, |check| Box::pin(links::check_links(check))),
    (CheckPart::Sensors, |check| Box::pin(sensors::check_sensors(check))),
    (CheckPart::Control, |check| Box::pin(control::check_control(check))),
    (CheckPart::Probe, |check| Box::pin(probe::check_probe(check))),
    (CheckPart::Axes, |check| Box::pin(axes::check_axes(check))),
    (CheckPart::Hold, |check| Box::pin(hold::check_hold(check))),
    (CheckPart::Latch, |check| Box::pin(latch::check_latch(check))),
];

/// State of a check, with its machine and its operator.
pub struct MachineCheck<'a> {
    machine_file: &'a MachineFile,
    reopenable_machine: &'a ReopenableMachine<'a>,
    pace: SimulationPace,
    /// Stores the run that the part `latch` measures.
    journal: &'a Journal,
    operator: &'a mut dyn OperatorInterface,
    /// Called with each finding.
    on_finding: &'a mut dyn FnMut(&CheckFinding),
    stop: CheckStop,
    /// The open devices; `None` before the links are checked, after a fault of the link, and while a hold is
    /// released.
    devices: Option<Devices>,
    /// Last known position of the machine; `None` before the control is prepared, and after a hold until it is
    /// prepared again.
    position: Option<Position>,
    /// How the control receives blocks; known after it was prepared.
    transmission: Option<TransmissionForm>,
    /// Setting that inverts the probe input at the control, in the control's terms.
    probe_polarity_hint: Option<String>,
    /// Whether the probe input was open at rest, closed while the stylus was deflected, and open again.
    is_probe_working: bool,
    /// Whether the check of an axis has failed: it did not move as commanded, is outside its travel, or its jog was
    /// refused.
    has_axis_fault: bool,
    /// Axes whose travel in the machine file exceeds the control's limits: a jog may end in an alarm.
    axes_beyond_limits: Vec<Axis>,
    summary: CheckSummary,
}

impl<'a> MachineCheck<'a> {
    /// A new check. A request of `stop` ends the check, and holds the control during a motion.
    pub fn new(
        file: &'a MachineFile,
        reopenable_machine: &'a ReopenableMachine<'a>,
        pace: SimulationPace,
        journal: &'a Journal,
        operator: &'a mut dyn OperatorInterface,
        stop: CheckStop,
        on_finding: &'a mut dyn FnMut(&CheckFinding),
    ) -> Self {
        Self {
            machine_file: file,
            reopenable_machine,
            pace,
            journal,
            operator,
            on_finding,
            stop,
            devices: None,
            position: None,
            transmission: None,
            probe_polarity_hint: None,
            is_probe_working: false,
            has_axis_fault: false,
            axes_beyond_limits: Vec::new(),
            summary: CheckSummary::for_machine(&file.machine.name),
        }
    }

    /// Runs the parts in their order. After an unsafe end only `report` is checked, and the other parts are
    /// reported as not checked; after a stop no part is checked. Call inside a tokio runtime.
    pub async fn run_all_parts(mut self) -> CheckSummary {
        let mut ended = None;
        for (part, check_part) in CHECK_PARTS {
            match ended {
                None => ended = check_part(&mut self).await.err(),
                Some(CheckEnd::Unsafe) => {
                    self.report_unchecked(part, "a previous part failed; correct that fault first".to_owned())
                }
                Some(CheckEnd::Stopped) => break,
            }
        }
        if ended != Some(CheckEnd::Stopped) {
            self.check_report_data();
        }
        self.summary.stopped = ended == Some(CheckEnd::Stopped) || self.stop.is_requested();
        self.summary.held |= self.stop.has_held_control();
        self.restore_modes_unless_failed().await;
        self.summary
    }

    /// Restores the control's modes. After a fault or a stop nothing more is sent.
    async fn restore_modes_unless_failed(&self) {
        let sound = self.summary.finding_count(CheckVerdict::Failed) == 0 && !self.summary.stopped;
        if let (Ok(controller), Some(_), true) = (self.controller(), &self.position, sound) {
            // An error is ignored: the check is over, and the next one sets the modes again.
            drop(controller.restore_modes().await);
        }
    }

    /// Shows the question to the operator and waits for the answer.
    ///
    /// # Errors
    /// A stop was requested.
    async fn prompt_operator(&mut self, question: OperatorQuestion) -> Result<OperatorAnswer, CheckEnd> {
        self.require_no_stop_request()?;
        let answer = self.operator.wait_for_answer(&question).await;
        self.require_no_stop_request()?;
        Ok(answer)
    }

    /// Returns an error if a stop was requested.
    fn require_no_stop_request(&self) -> Result<(), CheckEnd> {
        if self.stop.is_requested() { Err(CheckEnd::Stopped) } else { Ok(()) }
    }

    /// The open control; an error if no link is open.
    fn controller(&self) -> Result<&Controller, CheckEnd> {
        self.devices.as_ref().map(|devices| &devices.open_controller).ok_or(CheckEnd::Unsafe)
    }

    /// Opens the devices, also again after a hold.
    async fn open_devices(&mut self, pace: SimulationPace) -> Result<(), SetupError> {
        // A port can be open only once.
        self.devices = None;
        let devices = self.reopenable_machine.open(pace).await?;
        self.stop.set_control_halt(devices.open_controller.halt_handle());
        self.devices = Some(devices);
        Ok(())
    }

    fn report_ok(&mut self, timer: PartTimer, what: impl Into<String>) {
        self.add_finding(timer, CheckVerdict::Ok, what.into(), None);
    }

    fn report_failed(&mut self, timer: PartTimer, what: impl Into<String>, remedy: impl Into<String>) {
        self.add_finding(timer, CheckVerdict::Failed, what.into(), Some(remedy.into()));
    }

    /// Reports a fault after which it would not be safe to continue, and returns the end of the check. After a stop
    /// request nothing is reported, and the end is `Stopped`.
    fn end_with_fault<T>(
        &mut self,
        timer: PartTimer,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Result<T, CheckEnd> {
        self.require_no_stop_request()?;
        self.report_failed(timer, what, remedy);
        Err(CheckEnd::Unsafe)
    }

    /// Whether `what` was reported as a failure already.
    fn is_reported_failed(&self, what: &str) -> bool {
        let mut findings = self.summary.findings.iter();
        findings.any(|finding| finding.verdict == CheckVerdict::Failed && finding.what == what)
    }

    fn report_unchecked(&mut self, part: CheckPart, why: impl Into<String>) {
        self.add_finding(PartTimer::start(part), CheckVerdict::NotChecked, why.into(), None);
    }

    fn add_finding(&mut self, timer: PartTimer, verdict: CheckVerdict, what: String, remedy: Option<String>) {
        let took_s = timer.started.elapsed().as_secs_f64();
        let finding = CheckFinding { part: timer.part, what, took_s, verdict, remedy };
        (self.on_finding)(&finding);
        self.summary.findings.push(finding);
    }
}
