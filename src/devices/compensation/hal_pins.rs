//! Pins of LinuxCNC's hardware abstraction layer, through its command `halcmd` (manual page halcmd(1)).

use std::collections::BTreeMap;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use crate::finite_numbers::parse_finite_number;

/// Timeout for one command, also over a network.
const HALCMD_TIMEOUT: Duration = Duration::from_secs(10);
const HALCMD_POLL_PERIOD: Duration = Duration::from_millis(2);

#[derive(Debug, thiserror::Error)]
pub enum HalError {
    #[error("`{command}` cannot be started: {source}")]
    NotStarted { command: String, source: std::io::Error },
    #[error("`{command}` did not end within {} s", HALCMD_TIMEOUT.as_secs())]
    NoAnswer { command: String },
    /// `reply`: text of the command on standard error.
    #[error("`{command}` failed: {reply}")]
    Failed { command: String, reply: String },
    #[error("pin {pin} is `{value}`, which is not a finite number")]
    NotANumber { pin: String, value: String },
    #[error("the control has no pin {pin}")]
    NoSuchPin { pin: String },
    #[error("pin {pin} is connected to the signal {signal}: its value cannot be set")]
    Connected { pin: String, signal: String },
}

impl HalError {
    /// What to do next.
    pub fn remedy(&self) -> String {
        match self {
            Self::NotStarted { .. } => {
                "run trued on the computer of the control, or set halcmd in the section of [compensation], e.g. [\"ssh\", \"-o\", \"BatchMode=yes\", \
                 \"control\", \"halcmd\"]"
                    .to_owned()
            }
            Self::NoAnswer { .. } => {
                "check the connection to the control; `ssh` must not ask for a password (ssh -o BatchMode=yes)".to_owned()
            }
            Self::Failed { .. } | Self::NotANumber { .. } => {
                "check that LinuxCNC is running and that this user may use halcmd".to_owned()
            }
            Self::NoSuchPin { .. } => {
                "check that LinuxCNC runs with the INI file that [controller] ini names".to_owned()
            }
            Self::Connected { signal, .. } => {
                format!("remove the pin from the `net {signal}` line of the HAL file, and restart LinuxCNC")
            }
        }
    }
}

/// Value of a pin, and the signal that sets it.
#[derive(Debug, Clone, PartialEq)]
struct PinState {
    /// Value of the pin; 0 or 1 for a bit pin.
    value: f64,
    /// Signal that sets the pin; `None` if no signal does, also for an output.
    signal: Option<String>,
}

/// The pins of one component, as read at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct ComponentPins {
    component: String,
    /// By names without the component; only float and bit pins.
    pins: BTreeMap<String, PinState>,
}

impl ComponentPins {
    /// Value of the pin `component.name`; a bit is 0 or 1.
    ///
    /// # Errors
    /// The component has no such pin.
    pub fn value(&self, name: &str) -> Result<f64, HalError> {
        self.pin(name).map(|pin| pin.value)
    }

    /// # Errors
    /// The component has no such pin; a signal sets it.
    pub fn check_settable(&self, name: &str) -> Result<(), HalError> {
        match &self.pin(name)?.signal {
            None => Ok(()),
            Some(signal) => Err(HalError::Connected { pin: self.full_name(name), signal: signal.clone() }),
        }
    }

    fn pin(&self, name: &str) -> Result<&PinState, HalError> {
        self.pins.get(name).ok_or_else(|| HalError::NoSuchPin { pin: self.full_name(name) })
    }

    fn full_name(&self, name: &str) -> String {
        format!("{}.{name}", self.component)
    }
}

/// Access to HAL pins through `halcmd`. Each call starts one process and waits for its end.
#[derive(Debug, Clone)]
pub struct HalcmdClient {
    program: String,
    /// Arguments before those of `halcmd`, such as `control halcmd` for `ssh`.
    first_arguments: Vec<String>,
}

impl HalcmdClient {
    /// `command`: program and first arguments, such as `halcmd` or `ssh control halcmd`; empty for `halcmd`.
    pub fn new(command: &[String]) -> Self {
        match command {
            [program, first_arguments @ ..] => {
                Self { program: program.clone(), first_arguments: first_arguments.to_vec() }
            }
            [] => Self { program: "halcmd".to_owned(), first_arguments: Vec::new() },
        }
    }

    /// Program and arguments before those of `halcmd`, in words.
    pub fn describe(&self) -> String {
        [std::slice::from_ref(&self.program), &self.first_arguments].concat().join(" ")
    }

    /// The float and bit pins of `component`; a component that does not exist has no pins.
    ///
    /// # Errors
    /// `halcmd` fails; a value is not a number.
    pub fn read_component(&self, component: &str) -> Result<ComponentPins, HalError> {
        let prefix = format!("{component}.");
        let reply = self.run_halcmd(&["-s", "show", "pin", &prefix])?;
        let pins = reply.lines().filter_map(|line| parse_pin_line(line, &prefix)).collect::<Result<_, _>>()?;
        Ok(ComponentPins { component: component.to_owned(), pins })
    }

    /// Sets the pin with the full name `name`, such as `component.pin`.
    ///
    /// # Errors
    /// `halcmd` fails.
    pub fn set_pin(&self, name: &str, value: &str) -> Result<(), HalError> {
        self.run_halcmd(&["setp", name, value]).map(drop)
    }

    fn run_halcmd(&self, arguments: &[&str]) -> Result<String, HalError> {
        let first_arguments = self.first_arguments.iter().map(String::as_str);
        let arguments: Vec<&str> = first_arguments.chain(arguments.iter().copied()).collect();
        let command = || format!("{} {}", self.program, arguments.join(" "));
        let not_started = |source| HalError::NotStarted { command: command(), source };
        let mut child = Command::new(&self.program)
            .args(&arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(not_started)?;
        let started = Instant::now();
        while child.try_wait().map_err(not_started)?.is_none() {
            if started.elapsed() > HALCMD_TIMEOUT {
                let _ = child.kill();
                let _ = child.wait();
                return Err(HalError::NoAnswer { command: command() });
            }
            thread::sleep(HALCMD_POLL_PERIOD);
        }
        let output = child.wait_with_output().map_err(not_started)?;
        match output.status.success() {
            true => Ok(String::from_utf8_lossy(&output.stdout).into_owned()),
            false => {
                let reply = String::from_utf8_lossy(&output.stderr).trim().to_owned();
                Err(HalError::Failed { command: command(), reply })
            }
        }
    }
}

/// Parses a line `owner type direction value name [arrow signal]`: name of the pin without `prefix`, and its state.
/// `None` for other lines and for pins of other types.
fn parse_pin_line(line: &str, prefix: &str) -> Option<Result<(String, PinState), HalError>> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let [_, kind, _, value, name, ref connection @ ..] = words[..] else { return None };
    let pin = name.strip_prefix(prefix)?.to_owned();
    let value = match (kind, value) {
        ("float", _) => parse_number(name, value),
        ("bit", "TRUE") => Ok(1.0),
        ("bit", _) => Ok(0.0),
        _ => return None,
    };
    let signal = match connection {
        ["<==", signal, ..] => Some((*signal).to_owned()),
        _ => None,
    };
    Some(value.map(|value| (pin, PinState { value, signal })))
}

fn parse_number(pin: &str, value: &str) -> Result<f64, HalError> {
    parse_finite_number(value).ok_or_else(|| HalError::NotANumber { pin: pin.to_owned(), value: value.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As `halcmd -s show pin xyzbc-trt-kins.` of LinuxCNC 2.9 prints them.
    const PIN_LINES: &str = "    10  float IN            0.05  xyzbc-trt-kins.x-rot-point\n    \
                             10  float IN               7  xyzbc-trt-kins.tool-offset <== tool-offset\n    \
                             10  bit   OUT           TRUE  xyzbc-trt-kins.conventional-directions\n    \
                             10  s32   IN               2  xyzbc-trt-kins.other\n";

    fn pins_of(reply: &str) -> Result<ComponentPins, HalError> {
        let program = HalcmdClient::new(&["printf".to_owned(), reply.replace('%', "%%"), "--".to_owned()]);
        program.read_component("xyzbc-trt-kins")
    }

    #[test]
    fn pins_of_a_component_are_read_with_their_signals() {
        let pins = pins_of(PIN_LINES).unwrap();
        assert_eq!(pins.value("x-rot-point").unwrap(), 0.05);
        pins.check_settable("x-rot-point").unwrap();
        assert_eq!(pins.value("conventional-directions").unwrap(), 1.0);
        let connected = pins.check_settable("tool-offset").unwrap_err();
        assert_eq!(
            connected.to_string(),
            "pin xyzbc-trt-kins.tool-offset is connected to the signal tool-offset: its value cannot be set"
        );
        let missing = pins.value("other").unwrap_err();
        assert_eq!(missing.to_string(), "the control has no pin xyzbc-trt-kins.other");
        for damaged in ["nan", "inf", "0.05mm"] {
            let damaged = pins_of(&PIN_LINES.replace("0.05", damaged)).unwrap_err();
            assert!(matches!(damaged, HalError::NotANumber { .. }), "{damaged}");
        }
    }

    #[test]
    fn failing_command_is_named() {
        let error = |program: &str| {
            HalcmdClient::new(&[program.to_owned()]).read_component("xyzbc-trt-kins").map(drop).unwrap_err().to_string()
        };
        assert!(
            error("/nowhere/halcmd").starts_with("`/nowhere/halcmd -s show pin xyzbc-trt-kins.` cannot be started")
        );
        assert_eq!(error("false"), "`false -s show pin xyzbc-trt-kins.` failed: ");
        let set = HalcmdClient::new(&["false".to_owned()]).set_pin("xyzbc-trt-kins.x-offset", "-0.0125").unwrap_err();
        assert_eq!(set.to_string(), "`false setp xyzbc-trt-kins.x-offset -0.0125` failed: ");
    }
}
