//! Errors of a CAN interface, and what the operator should do next.

use std::io;

use super::interfaces;

#[derive(Debug, thiserror::Error)]
pub enum CanError {
    #[error("this computer's kernel has no CAN: {source}")]
    NoKernel { source: io::Error },
    #[error("there is no CAN interface `{interface}`; {}", named(there))]
    NoInterface { interface: String, there: Vec<String> },
    #[error("`{interface}` is no CAN interface; {}", named(there))]
    NotCan { interface: String, there: Vec<String> },
    #[error("the CAN interface `{interface}` is down: {why}")]
    Down { interface: String, why: String },
    #[error("no frame {id} came on `{interface}`, and the bus has errors: {why}")]
    ErrorFrameClass { interface: String, id: String, why: String },
    #[error("the CAN controller of `{interface}` has left the bus ({why}): it hears nothing")]
    Off { interface: String, why: String },
    #[error("no frame {id} came on `{interface}`, but those of others did: {others}")]
    ForeignIdDetector { interface: String, id: String, others: String },
    #[error("the CAN interface `{interface}` could not be opened: {source}")]
    Open { interface: String, source: io::Error },
    #[error("the thread that listened to `{interface}` has ended")]
    Gone { interface: String },
}

fn named(there: &[String]) -> String {
    match there {
        [] => "there is none at all".to_owned(),
        there => format!("there are: {}", there.join(", ")),
    }
}

impl CanError {
    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        match self {
            Self::NoKernel { .. } => "load the modules as root, `modprobe can can_raw` and that of the \
                                      adapter; a kernel that was built without them (often in \
                                      containers and virtual machines) needs another kernel, or a \
                                      sensor on a serial line or Modbus"
                .to_owned(),
            Self::NoInterface { .. } | Self::NotCan { .. } => {
                "plug the adapter in and load its module, then write the name that `ip -brief link \
                 show type can` shows as `interface` of [sensor.can]; a serial adapter becomes one by \
                 `slcand`"
                    .to_owned()
            }
            Self::Down { interface, .. } => format!(
                "set it up as root with the sensor's bit rate: `ip link set {interface} up type can \
                 bitrate 500000` (of vcan: without `type` and what follows)"
            ),
            Self::ErrorFrameClass { interface, .. } => format!(
                "compare the bit rate (`ip -details link show {interface}`) with the sensor's manual; \
                 see that both ends of the bus have 120 ohm and that CAN high and low are not swapped"
            ),
            Self::Off { interface, .. } => format!(
                "compare bit rate, cable and terminators (120 ohm at both ends), then restart it as root: \
                 `ip link set {interface} down`, `ip link set {interface} up`; `restart-ms 100` among its \
                 settings lets it do so by itself"
            ),
            Self::ForeignIdDetector { .. } => "compare `id` (and `extended`: 29 bits) of [sensor.can] with the \
                                    sensor's manual, and the number that is set at the sensor"
                .to_owned(),
            Self::Open { .. } => "check `interface` of [sensor.can]".to_owned(),
            Self::Gone { .. } => "start again; if it happens again, report it".to_owned(),
        }
    }

    /// Finds the reason why `interface` was not opened: the kernel's error alone is too general.
    pub(super) fn of_opening(interface: &str, source: io::Error) -> Self {
        let (interface, there) = (interface.to_owned(), interfaces::all());
        if there.contains(&interface) {
            return Self::Open { interface, source };
        }
        if interfaces::exists(&interface) {
            return Self::NotCan { interface, there };
        }
        Self::NoInterface { interface, there }
    }
}
