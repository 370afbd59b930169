//! Text that sets modes and switches the probe: it holds no motion.

use super::proven::{Unproven, read_programs};
use super::refusal::{Reason, Refusal};
use crate::gcode::{Dialect, ProbeFault, Program};
use machine::Axis;

/// What a driver sends before the first and after the last block, and what the machine file adds to it. The
/// text was read back and moves nothing.
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

    /// A program of its own that sets all modal state and leaves the probe on.
    pub fn switch_on(&self) -> &str {
        &self.switch_on
    }

    /// A program of its own that switches the probe off; `None`: there is no word for it.
    pub fn switch_off(&self) -> Option<&str> {
        self.switch_off.as_deref()
    }

    /// How long after the head what it switches is ready, s; `None`: it switches nothing.
    pub fn settles_s(&self) -> Option<f64> {
        self.settles_s
    }

    pub fn switches_probe_on(&self) -> bool {
        self.switches_probe_on
    }

    /// The inputs that report faults of the probe, and what each reports when it is on.
    pub fn health_inputs(&self) -> impl Iterator<Item = (&str, ProbeFault)> {
        self.health_inputs.iter().map(|(input, fault)| (input.as_str(), *fault))
    }
}

/// `axes`: those of the machine. `log`: the file that takes the results, where the control writes them itself.
///
/// # Errors
/// What cannot be written; text that moves something or cannot be read back.
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
