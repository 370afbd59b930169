//! Proven text without motions: it sets modes and switches the probe.

use super::proven::{StageProofError, read_programs};
use super::refusal::{ProofRefusal, RefusalReason};
use crate::gcode::{Dialect, ProbeFault, ProgramHeader};
use machine::Axis;

/// Text that a driver sends before the first and after the last block, including the options of the machine file.
/// It was read back and moves nothing.
#[derive(Debug, Clone)]
pub struct ProvenModeText {
    head: Vec<String>,
    foot: Vec<String>,
    switch_on_program: String,
    switch_off_program: Option<String>,
    settling_time_s: Option<f64>,
    has_probe_on_command: bool,
    health_inputs: Vec<(String, ProbeFault)>,
}

impl ProvenModeText {
    /// The lines that set all modal state.
    pub fn head(&self) -> &[String] {
        &self.head
    }

    /// The lines that restore what the head has changed.
    pub fn foot(&self) -> &[String] {
        &self.foot
    }

    /// A separate program that sets all modal state and leaves the probe on.
    pub fn switch_on_program(&self) -> &str {
        &self.switch_on_program
    }

    /// A separate program that switches the probe off; `None` if no command is declared.
    pub fn switch_off_program(&self) -> Option<&str> {
        self.switch_off_program.as_deref()
    }

    /// Time after the head until the switched devices are ready, s; `None` if the head switches nothing.
    pub fn settling_time_s(&self) -> Option<f64> {
        self.settling_time_s
    }

    pub fn has_probe_on_command(&self) -> bool {
        self.has_probe_on_command
    }

    /// Inputs that report faults of the probe, and the fault that each reports when it is on.
    pub fn health_inputs(&self) -> impl Iterator<Item = (&str, ProbeFault)> {
        self.health_inputs.iter().map(|(input, fault)| (input.as_str(), *fault))
    }
}

/// Renders and proves the text. `axes`: the axes of the machine. `log`: the results file, on a control that writes
/// one itself.
///
/// # Errors
/// The text cannot be rendered, contains a motion, or cannot be read back.
pub fn prove_modes(
    dialect: &Dialect,
    title: &str,
    axes: impl IntoIterator<Item = Axis>,
    log: Option<&str>,
) -> Result<ProvenModeText, StageProofError> {
    let axes: Vec<Axis> = axes.into_iter().filter(|axis| *axis != Axis::S).collect();
    let program = ProgramHeader { title, axes: &axes, log };
    let always_on = dialect.without_probe_off();
    let switch_on_program = always_on.render_program(&program, &[])?;
    let whole = dialect.render_program(&program, &[])?;
    check_no_motion(dialect, &[switch_on_program.clone(), whole.clone()])?;
    let inputs = dialect.health_inputs();
    Ok(ProvenModeText {
        head: dialect.render_head(&program)?,
        foot: dialect.render_foot(&program)?,
        switch_on_program,
        switch_off_program: dialect.has_probe_off_command().then_some(whole),
        settling_time_s: dialect.settling_time_s(),
        has_probe_on_command: dialect.has_probe_on_command(),
        health_inputs: inputs.map(|(input, fault)| (input.to_owned(), fault)).collect(),
    })
}

fn check_no_motion(dialect: &Dialect, programs: &[String]) -> Result<(), ProofRefusal> {
    match read_programs(dialect, programs)?.first() {
        None => Ok(()),
        Some(motion) => Err(RefusalReason::MotionWithoutStep.at_line(motion.line)),
    }
}
