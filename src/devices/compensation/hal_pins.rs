//! Pins of LinuxCNC's hardware abstraction layer, through its command `halcmd` (manual page halcmd(1)).

use std::collections::BTreeMap;
use std::process::{Command, Output};

#[derive(Debug, thiserror::Error)]
pub enum HalError {
    #[error("`{command}` cannot be started: {source}")]
    NotStarted { command: String, source: std::io::Error },
    #[error("`{command}` failed: {reply}")]
    Failed { command: String, reply: String },
    #[error("the control has no pins {module}.*: {reply}")]
    NoSuchModule { module: String, reply: String },
    #[error("pin {pin} is `{value}`, which is not a number")]
    NotANumber { pin: String, value: String },
}

impl HalError {
    /// What to do next.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::NotStarted { .. } => {
                "run trued on the computer of the control, or set halcmd in [compensation], e.g. [\"ssh\", \"control\", \
                 \"halcmd\"]"
            }
            Self::Failed { .. } | Self::NotANumber { .. } => {
                "check that LinuxCNC is running and that this user may use halcmd"
            }
            Self::NoSuchModule { .. } => {
                "set kinematics in [compensation] to the module in [KINS]KINEMATICS of the INI file"
            }
        }
    }
}

/// Access to the pins. Each call starts one process.
#[derive(Debug, Clone)]
pub struct HalPins {
    /// Program and first arguments, such as `halcmd` or `ssh control halcmd`.
    command: Vec<String>,
}

impl HalPins {
    /// `command`: program and first arguments; empty for `halcmd`.
    pub fn new(command: &[String]) -> Self {
        let command = if command.is_empty() { vec!["halcmd".to_owned()] } else { command.to_vec() };
        Self { command }
    }

    /// Values of all float and bit pins of a module, by their name without the module; a bit is 0 or 1.
    ///
    /// # Errors
    /// `halcmd` fails; the control has no such module.
    pub fn read_module(&self, module: &str) -> Result<BTreeMap<String, f64>, HalError> {
        let reply = self.run(&["-s", "show", "pin", &format!("{module}.")])?;
        let prefix = format!("{module}.");
        let own =
            reply.lines().filter_map(|line| parse_pin_line(line, &prefix)).collect::<Result<BTreeMap<_, _>, _>>()?;
        match own.is_empty() {
            true => Err(HalError::NoSuchModule { module: module.to_owned(), reply: reply.trim().to_owned() }),
            false => Ok(own),
        }
    }

    fn run(&self, arguments: &[&str]) -> Result<String, HalError> {
        let [program, first @ ..] = &self.command[..] else { return Ok(String::new()) };
        let words: Vec<&str> = first.iter().map(String::as_str).chain(arguments.iter().copied()).collect();
        let command = format!("{program} {}", words.join(" "));
        let Output { status, stdout, stderr } = Command::new(program)
            .args(&words)
            .output()
            .map_err(|source| HalError::NotStarted { command: command.clone(), source })?;
        match status.success() {
            true => Ok(String::from_utf8_lossy(&stdout).into_owned()),
            false => Err(HalError::Failed { command, reply: String::from_utf8_lossy(&stderr).trim().to_owned() }),
        }
    }
}

/// Name without `prefix` and value of a line `owner type direction value name [arrow signal]`. `None`: another line, or
/// a pin of another type.
fn parse_pin_line(line: &str, prefix: &str) -> Option<Result<(String, f64), HalError>> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let [_, kind, _, value, name, ..] = words[..] else { return None };
    let pin = name.strip_prefix(prefix)?.to_owned();
    match (kind, value) {
        ("float", _) => Some(parse_number(name, value).map(|value| (pin, value))),
        ("bit", "TRUE") => Some(Ok((pin, 1.0))),
        ("bit", _) => Some(Ok((pin, 0.0))),
        _ => None,
    }
}

fn parse_number(pin: &str, value: &str) -> Result<f64, HalError> {
    let number = value.parse().ok().filter(|number: &f64| number.is_finite());
    number.ok_or_else(|| HalError::NotANumber { pin: pin.to_owned(), value: value.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As `halcmd -s show pin xyzbc-trt-kins.` of LinuxCNC 2.9 prints them.
    const PIN_LINES: &str = "    10  float IN            0.05  xyzbc-trt-kins.x-rot-point\n    \
                             10  float IN               7  xyzbc-trt-kins.tool-offset <== tool-offset\n    \
                             10  bit   OUT           TRUE  xyzbc-trt-kins.conventional-directions\n    \
                             10  s32   IN               2  xyzbc-trt-kins.other\n";

    #[test]
    fn pins_of_a_module_are_parsed() {
        let parsed: BTreeMap<String, f64> =
            PIN_LINES.lines().filter_map(|line| parse_pin_line(line, "xyzbc-trt-kins.")).map(Result::unwrap).collect();
        let expected = [("x-rot-point", 0.05), ("tool-offset", 7.0), ("conventional-directions", 1.0)];
        assert_eq!(parsed, expected.map(|(name, value)| (name.to_owned(), value)).into());
        let damaged = PIN_LINES.replace("0.05", "nan");
        let first = damaged.lines().find_map(|line| parse_pin_line(line, "xyzbc-trt-kins.")).unwrap();
        assert!(matches!(first, Err(HalError::NotANumber { .. })));
    }

    #[test]
    fn missing_command_is_named() {
        let refused = HalPins::new(&["/nowhere/halcmd".to_owned()]).read_module("xyzbc-trt-kins").unwrap_err();
        assert!(refused.to_string().starts_with("`/nowhere/halcmd -s show pin xyzbc-trt-kins.` cannot be started"));
        let refused = HalPins::new(&["false".to_owned()]).read_module("xyzbc-trt-kins").unwrap_err();
        assert!(matches!(refused, HalError::Failed { .. }), "{refused}");
        let refused = HalPins::new(&["true".to_owned()]).read_module("xyzbc-trt-kins").unwrap_err();
        assert!(matches!(refused, HalError::NoSuchModule { .. }), "{refused}");
    }
}
