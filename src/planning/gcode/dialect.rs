//! Dialects: folders in `gcode-templates/`, embedded into the program.

use include_dir::{Dir, include_dir};
use minijinja::Environment;

use super::dialect_file::DialectFile;
use super::dialect_options::{DialectOptions, ProbeFault};
use super::error::DialectError;
use super::template_environment::template_environment;
use machine::record::machine::{Machine, Probe};
use machine::record::motion::Motion;

static DIALECT_FOLDERS: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/../../gcode-templates");

/// Languages that have a G-code reader.
const LANGUAGES_WITH_READER: [&str; 1] = ["rs274"];

/// Time from switching the probe on until it is ready, s. The head templates of dialects whose control receives single
/// lines contain a dwell of this length.
const PROBE_SWITCH_ON_TIME_S: f64 = 1.0;

/// Format of programs for one control: words, decimals and a template for each neutral motion. If a motion has no
/// template, the control cannot execute it.
#[derive(Debug, Clone)]
pub struct Dialect {
    pub(super) dialect_file: DialectFile,
    pub(super) templates: Environment<'static>,
    pub(super) options: DialectOptions,
}

impl Dialect {
    /// Loads the dialect of this name.
    ///
    /// # Errors
    /// The name is unknown (the error lists the known names), or the folder is not complete.
    pub fn from_name(name: &str) -> Result<Self, DialectError> {
        let folder = DIALECT_FOLDERS
            .get_dir(name)
            .ok_or_else(|| DialectError::UnknownDialect { name: name.to_owned(), known: Self::names() })?;
        Self::from_folder(folder)
            .map_err(|reason| DialectError::InvalidFolder { folder: name.to_owned(), reason: reason.to_string() })
    }

    /// The names of all embedded dialects, in alphabetical order.
    pub fn names() -> Vec<&'static str> {
        let mut names: Vec<_> = DIALECT_FOLDERS.dirs().filter_map(|dir| dir.path().to_str()).collect();
        names.sort_unstable();
        names
    }

    fn from_folder(folder: &'static Dir<'static>) -> Result<Self, Box<dyn std::error::Error>> {
        let text =
            |path: &std::path::Path| folder.get_file(path).and_then(|file| file.contents_utf8()).unwrap_or_default();
        let spec: DialectFile = toml::from_str(text(&folder.path().join("dialect.toml")))?;
        if !LANGUAGES_WITH_READER.contains(&spec.language.as_str()) {
            return Err(format!("unknown language `{}`", spec.language).into());
        }
        let mut templates = template_environment();
        for file in folder.files() {
            if file.path().extension().is_some_and(|extension| extension == "j2") {
                let name = file.path().file_stem().unwrap_or_default().to_string_lossy();
                templates.add_template_owned(name.into_owned(), text(file.path()))?;
            }
        }
        Ok(Self { dialect_file: spec, templates, options: DialectOptions::default() })
    }

    pub fn name(&self) -> &str {
        &self.dialect_file.name
    }

    /// Work offset slot that the programs use, e.g. `G59`.
    pub fn work_offset(&self) -> &str {
        &self.dialect_file.work_offset
    }

    /// File extension of programs, without the dot.
    pub fn program_file_extension(&self) -> &str {
        &self.dialect_file.extension
    }

    /// Returns this dialect with the options that `machine` and `probe` declare.
    ///
    /// # Errors
    /// A command is not exactly one M word, already has another meaning, or has two meanings; an input has a name
    /// that this control does not use.
    pub fn with_machine_options(mut self, machine: &Machine, probe: &Probe) -> Result<Self, DialectError> {
        let options = DialectOptions::new(machine, probe)?;
        self.dialect_file.inputs.check_input_name("[probe] error_input", options.probe_error_input.as_deref())?;
        self.dialect_file.inputs.check_input_name("[probe] battery_input", options.probe_battery_input.as_deref())?;
        self.options = options;
        Ok(self)
    }

    /// Returns the same dialect without the probe-off command: for a control that receives one program per block, and
    /// the probe-off command in a separate program.
    pub fn without_probe_off_command(&self) -> Self {
        let mut same = self.clone();
        same.options.probe_off_command = None;
        same
    }

    pub fn has_probe_on_command(&self) -> bool {
        self.options.probe_on_command.is_some()
    }

    pub fn has_probe_off_command(&self) -> bool {
        self.options.probe_off_command.is_some()
    }

    /// Time after the head until the switched devices are ready, s: the longest one. `None` if the head switches
    /// nothing.
    pub fn settling_time_after_head_s(&self) -> Option<f64> {
        let probe = self.options.probe_on_command.iter().map(|_| PROBE_SWITCH_ON_TIME_S);
        let clamps = self.options.clamps.values().map(|clamp| clamp.wait_s);
        probe.chain(clamps).reduce(f64::max)
    }

    /// Total waiting time of the clamps in the lines of `motion`, s: opening and closing for each clamped axis that a
    /// rapid names, 0 for any other motion.
    pub fn clamp_wait_s(&self, motion: &Motion) -> f64 {
        let Motion::Rapid { to } = motion else { return 0.0 };
        let moved = self.options.clamps.iter().filter(|(axis, _)| to.get(**axis).is_some());
        moved.map(|(_, clamp)| 2.0 * clamp.wait_s).sum()
    }

    /// Inputs that report the state of the probe, and the fault that each reports when it is on.
    pub fn probe_health_inputs(&self) -> impl Iterator<Item = (&str, ProbeFault)> {
        let inputs = [
            (&self.options.probe_error_input, ProbeFault::ErrorReported),
            (&self.options.probe_battery_input, ProbeFault::LowBattery),
        ];
        inputs.into_iter().filter_map(|(input, fault)| Some((input.as_deref()?, fault)))
    }
}
