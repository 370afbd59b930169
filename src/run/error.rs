//! Errors that end a run early.

use super::counted_turn::CountFault;
use crate::store::StoreError;
use devices::controllers::ControllerError;
use devices::sensors::SensorError;
use machine::record::plan::Step;
use machine::record::reading::Flag;
use methods::Refused;
use methods::decision::references::{Scatter, Shift, in_words};
use planning::PlanningError;
use planning::gcode::RenderError;
use planning::proof::Refusal;

#[derive(Debug, thiserror::Error)]
pub enum RunError {
    #[error(transparent)]
    Refused(#[from] Refused),
    #[error(transparent)]
    Planning(#[from] PlanningError),
    #[error("stage `{stage}` is not proven: {source}")]
    Unproven { stage: String, source: Box<Refusal> },
    #[error("the proof of stage `{stage}` ended without answer")]
    ProofGone { stage: String },
    #[error("stage `{stage}` cannot be written for this control: {source}")]
    Unwritable { stage: String, source: RenderError },
    #[error(transparent)]
    Controller(#[from] ControllerError),
    /// A fault with the label of the step that it names.
    #[error("{label}, {source}")]
    OnStep { label: String, source: Box<RunError> },
    /// Fault of the probe input while a sensor is mounted instead of the probe.
    #[error("{source}; yet `{sensor}` sits in the probe's place")]
    ProbeInput { sensor: String, source: Box<RunError> },
    #[error("a person is asked on the way (`{text}`), and nobody is there to answer")]
    NobodyThere { text: String },
    #[error("the stylus was not {} within {seconds} s", if *closed { "deflected" } else { "let go" })]
    DeadProbe { closed: bool, seconds: u64 },
    #[error("step {step}: the first touch met nothing up to its end")]
    NoFirstContact { step: u32 },
    #[error("sensor `{name}`: {source}")]
    Sensor { name: String, source: SensorError },
    #[error("step {step}: `{sensor}` sees nothing that it can measure ({})", flag.as_str())]
    Blind { step: u32, sensor: String, flag: Flag },
    #[error(
        "step {step}: `{sensor}` reports {value_mm:.3} mm where nothing that the machine file states is \
         within its range"
    )]
    EarlyDistance { step: u32, sensor: String, value_mm: f64 },
    #[error(
        "step {step} is sampled in motion, and this control does not stamp where its axes stand"
    )]
    NotStamped { step: u32 },
    #[error("step {step} was to be sampled in motion: {why}")]
    Unswept { step: u32, why: String },
    #[error("step {step}: the samples of `{sensor}` are not placed: {source}")]
    Miscounted { step: u32, sensor: String, source: CountFault },
    #[error("step {step} ended without the position of its contact")]
    NoReading { step: u32 },
    #[error(
        "not all references were measured before the stop: nobody can say whether the machine stands \
         as it stood"
    )]
    NoReferences,
    #[error("not all references were seen again after the stop: {places}")]
    UnseenAgain { places: String },
    #[error(
        "the machine does not stand as it stood before the stop: {}; {}",
        in_words(shifts), scatter.in_words()
    )]
    Moved { shifts: Vec<Shift>, scatter: Scatter },
    #[error("nothing more is measured, because it could not be kept: {0}")]
    Store(#[from] StoreError),
}

const EARLY_DISTANCE: &str = "retract by hand, the way it came; then look whether the machine stands where its \
     control shows, whether the artefact is where the machine file says, and whether another body is below the sensor";

impl RunError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> String {
        match self {
            Self::Refused(refused) => refused.instead.clone(),
            Self::Planning(error) => error.remedy(),
            Self::Unproven { source, .. } => source.remedy().to_owned(),
            Self::ProofGone { .. } => "please report this with the plan".to_owned(),
            Self::Unwritable { source, .. } => source.remedy(),
            Self::Controller(error) => error.remedy(),
            Self::OnStep { source, .. } => source.remedy(),
            Self::ProbeInput { .. } => {
                "the control's probe input must read open while a sensor sits in the spindle. Is the probe, \
                 taken out, pressed where it lies, or its receiver in error because it sees none? An input \
                 that is open only while a probe closes the circuit needs a plug that does so. If the \
                 machine was under way, look first whether the sensor has met something"
                    .to_owned()
            }
            Self::NobodyThere { .. } => {
                "start or resume it from the page of `trued serve`, or from a terminal where somebody sits"
                    .to_owned()
            }
            Self::DeadProbe { .. } => {
                "deflect the stylus and watch the probe's input at the control: is the probe on, its \
                 battery fresh, its cable whole?"
                    .to_owned()
            }
            Self::NoFirstContact { .. } => {
                "the probe may be dead: deflect the stylus and watch its input at the control, before \
                 anything moves again; if it lives, is the part where the machine file says \
                 ([artefact] centre_mm, radius_mm)?"
                    .to_owned()
            }
            Self::Sensor { source, .. } => source.remedy(),
            Self::Blind { flag, .. } => unseen(*flag).to_owned(),
            Self::EarlyDistance { .. } => EARLY_DISTANCE.to_owned(),
            Self::NotStamped { .. } => {
                "plan it with dwell points (sampling = \"dwell\"), or, on a LinuxCNC, name its sampler in \
                 the machine file ([controller.sampler]); the turn of one rotary axis can be measured where \
                 each sensor sends the count of its encoder ([encoder])"
                    .to_owned()
            }
            Self::Miscounted { source, .. } => source.remedy(),
            Self::Unswept { .. } => {
                "`trued resume` measures it anew; if it stays so, plan it with dwell points \
                 (sampling = \"dwell\")"
                    .to_owned()
            }
            Self::NoReading { .. } => "please report this with the run's export".to_owned(),
            Self::Store(error) => error.remedy().to_owned(),
            Self::UnseenAgain { .. } => {
                "look why the sensor says nothing there that could be used, then `trued resume` once more"
                    .to_owned()
            }
            Self::NoReferences => {
                "the run is closed, its readings are kept; start a new run".to_owned()
            }
            Self::Moved { .. } => {
                "the run is closed, its readings are kept (`trued identify` with --run tells what they \
                 hold); start a new run: after a long stop a machine may simply have drifted"
                    .to_owned()
            }
        }
    }

    /// The error of a touch before the probe is known to work.
    pub(super) fn of_first_touch(self) -> Self {
        match self {
            Self::Controller(ControllerError::NoContact { step }) => Self::NoFirstContact { step },
            Self::OnStep { label, source } => {
                Self::OnStep { label, source: Box::new(source.of_first_touch()) }
            }
            other => other,
        }
    }

    /// The error of a run that measures with `sensor`: no stylus can be deflected.
    pub(super) fn of_sensor(self, sensor: &str) -> Self {
        use ControllerError::{ProbeClosed, StillTripped, UnexpectedContact};
        let closed = |error: &ControllerError| {
            matches!(error, ProbeClosed | StillTripped { .. } | UnexpectedContact { .. })
        };
        match self.of_control().is_some_and(closed) {
            true => Self::ProbeInput { sensor: sensor.to_owned(), source: Box::new(self) },
            false => self,
        }
    }

    /// Adds the label of the step to an error that names the step by its number: the label tells the operator
    /// which feature was touched, and from which side.
    pub(super) fn on(self, step: &Step) -> Self {
        match &self {
            Self::Controller(error) if error.step() == Some(step.id) => {
                Self::OnStep { label: step.label.clone(), source: Box::new(self) }
            }
            Self::NoReading { step: id }
            | Self::Blind { step: id, .. }
            | Self::EarlyDistance { step: id, .. }
            | Self::Unswept { step: id, .. }
            | Self::Miscounted { step: id, .. }
                if *id == step.id =>
            {
                Self::OnStep { label: step.label.clone(), source: Box::new(self) }
            }
            _ => self,
        }
    }

    /// The control's error, if the control caused this error.
    pub fn of_control(&self) -> Option<&ControllerError> {
        match self {
            Self::Controller(error) => Some(error),
            Self::OnStep { source, .. } | Self::ProbeInput { source, .. } => source.of_control(),
            _ => None,
        }
    }

    /// Whether the run can never be resumed; its readings stay.
    pub fn closes(&self) -> bool {
        matches!(self, Self::NoReferences | Self::Moved { .. })
    }

    /// Whether the axes must be homed before any other motion.
    pub fn position_lost(&self) -> bool {
        self.of_control().is_some_and(ControllerError::position_lost)
    }

    /// Whether the link to the control or to a sensor failed.
    pub fn is_of_link(&self) -> bool {
        use ControllerError::{Link, Modbus, NoAnswer};
        match self {
            Self::Sensor { source, .. } => source.is_of_link(),
            _ => matches!(self.of_control(), Some(Link(_) | Modbus(_) | NoAnswer { .. })),
        }
    }

    /// Whether a person requested the stop.
    pub fn is_stop(&self) -> bool {
        matches!(self, Self::Controller(ControllerError::Halted))
    }
}

/// Remedy for a sample with this flag.
fn unseen(flag: Flag) -> &'static str {
    match flag {
        Flag::Stale => "the sensor has fallen silent: see to its cable, its power and its link",
        Flag::Saturated => {
            "too much light comes back: lower the sensor's exposure or power, or take a duller sphere"
        }
        _ => {
            "see that the sensor measures the artefact: does it stand where the machine file says, is its surface \
             clean, is the sensor mounted as zero_mm and direction say?"
        }
    }
}
