//! Proven text without motions: it sets modes and switches the probe.

use super::proven::{Unproven, read_programs};
use super::refusal::{Reason, Refusal};
use crate::gcode::{Dialect, ProbeFault, Program};
use machine::Axis;

/// Text that a driver sends before the first and after the last block, including the options of the machine file.
/// It was read back and moves nothing.
#[derive(Debug, Clone)]
pub struct ProvenModes {
    head: Vec<String>,
    foot: Vec<String>,
    switch_on: String,
    switch_off: Option<String>,
    settles_s: Option<f64>,
    switches_probe_on: bool,
    health_inputs: Vec<(String, ProbeFault)>,
}

impl ProvenModes {
    /// The lines that set all modal state.
    pub fn head(&self) -> &[String] {
        &self.head
    }

    /// The lines that restore what the head has changed.
    pub fn foot(&self) -> &[String] {
        &self.foot
    }

    /// A separate program that sets all modal state and leaves the probe on.
    pub fn switch_on(&self) -> &str {
        &self.switch_on
    }

    /// A separate program that switches the probe off; `None` if no command is declared.
    pub fn switch_off(&self) -> Option<&str> {
        self.switch_off.as_deref()
    }

    /// Time after the head until the switched devices are ready, s; `None` if the head switches nothing.
    pub fn settles_s(&self) -> Option<f64> {
        self.settles_s
    }

    pub fn switches_probe_on(&self) -> bool {
        self.switches_probe_on
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
) -> Result<ProvenModes, Unproven> {
    let axes: Vec<Axis> = axes.into_iter().filter(|axis| *axis != Axis::S).collect();
    let program = Program { title, axes: &axes, log };
    let keeping_on = dialect.keeping_probe_on();
    let switch_on = keeping_on.program(&program, &[])?;
    let whole = dialect.program(&program, &[])?;
    moves_nothing(dialect, &[switch_on.clone(), whole.clone()])?;
    let inputs = dialect.health_inputs();
    Ok(ProvenModes {
        head: dialect.head(&program)?,
        foot: dialect.foot(&program)?,
        switch_on,
        switch_off: dialect.switches_probe_off().then_some(whole),
        settles_s: dialect.wakes_s(),
        switches_probe_on: dialect.switches_probe_on(),
        health_inputs: inputs.map(|(input, fault)| (input.to_owned(), fault)).collect(),
    })
}

fn moves_nothing(dialect: &Dialect, programs: &[String]) -> Result<(), Refusal> {
    match read_programs(dialect, programs)?.first() {
        None => Ok(()),
        Some(motion) => Err(Refusal { step: None, line: motion.line, reason: Reason::NoStep }),
    }
}
