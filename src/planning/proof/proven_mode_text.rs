//! Proven text without motions: it sets modes and switches the probe.

use super::proven_blocks::{StageProofError, read_back_programs};
use super::refusal::{ProofRefusal, RefusalReason};
use crate::gcode::{Dialect, HeadAndFootValues, ProbeFault};
use machine::Axis;

/// Text that a driver sends before the first and after the last block, including the options of the machine file.
/// The text was read back and moves nothing.
#[derive(Debug, Clone)]
pub struct ProvenModeText {
    /// Lines that set all modal state, before the first block.
    head_lines: Vec<String>,
    /// Lines that restore what the head has changed, after the last block.
    foot_lines: Vec<String>,
    /// Separate program that sets all modal state and leaves the probe on.
    probe_on_program: String,
    /// Separate program that switches the probe off; `None`: no command for that is declared.
    probe_off_program: Option<String>,
    /// Time after the head until the switched devices are ready; `None`: the head switches nothing.
    settling_time_after_head_s: Option<f64>,
    /// Whether a command that switches the probe on is declared.
    has_probe_on_command: bool,
    /// Input, and the fault of the probe that it reports when it is on.
    probe_health_inputs: Vec<(String, ProbeFault)>,
}

impl ProvenModeText {
    /// The lines that set all modal state.
    pub fn head_lines(&self) -> &[String] {
        &self.head_lines
    }

    /// The lines that restore what the head has changed.
    pub fn foot_lines(&self) -> &[String] {
        &self.foot_lines
    }

    /// A separate program that sets all modal state and leaves the probe on.
    pub fn probe_on_program(&self) -> &str {
        &self.probe_on_program
    }

    /// A separate program that switches the probe off; `None` if no command is declared.
    pub fn probe_off_program(&self) -> Option<&str> {
        self.probe_off_program.as_deref()
    }

    /// Time after the head until the switched devices are ready, s; `None` if the head switches nothing.
    pub fn settling_time_after_head_s(&self) -> Option<f64> {
        self.settling_time_after_head_s
    }

    /// Whether a command that switches the probe on is declared.
    pub fn has_probe_on_command(&self) -> bool {
        self.has_probe_on_command
    }

    /// Inputs that report faults of the probe, and the fault that each reports when it is on.
    pub fn probe_health_inputs(&self) -> impl Iterator<Item = (&str, ProbeFault)> {
        self.probe_health_inputs.iter().map(|(input, fault)| (input.as_str(), *fault))
    }
}

/// Renders the head and foot of a program, which set the control's modes, and proves that they move nothing. `axes`:
/// the axes of the machine. `log`: the results file, if the control itself writes the results.
///
/// # Errors
/// The text cannot be rendered, contains a motion, or cannot be read back.
pub fn render_and_prove_mode_text(
    dialect: &Dialect,
    title: &str,
    axes: impl IntoIterator<Item = Axis>,
    log: Option<&str>,
) -> Result<ProvenModeText, StageProofError> {
    let axes: Vec<Axis> = axes.into_iter().filter(|axis| *axis != Axis::S).collect();
    let program = HeadAndFootValues { title, axes: &axes, result_log_path: log };
    let always_on = dialect.without_probe_off_command();
    let switch_on_program = always_on.render_program(&program, &[])?;
    let whole = dialect.render_program(&program, &[])?;
    check_no_motion(dialect, &[switch_on_program.clone(), whole.clone()])?;
    let inputs = dialect.probe_health_inputs();
    Ok(ProvenModeText {
        head_lines: dialect.render_head(&program)?,
        foot_lines: dialect.render_foot(&program)?,
        probe_on_program: switch_on_program,
        probe_off_program: dialect.has_probe_off_command().then_some(whole),
        settling_time_after_head_s: dialect.settling_time_after_head_s(),
        has_probe_on_command: dialect.has_probe_on_command(),
        probe_health_inputs: inputs.map(|(input, fault)| (input.to_owned(), fault)).collect(),
    })
}

fn check_no_motion(dialect: &Dialect, programs: &[String]) -> Result<(), ProofRefusal> {
    match read_back_programs(dialect, programs)?.first() {
        None => Ok(()),
        Some(motion) => Err(RefusalReason::UnassignedMotion.at_line(motion.line)),
    }
}
