//! Errors of a CAN interface, and what the operator should do next.

use std::io;

use super::interfaces;

#[derive(Debug, thiserror::Error)]
pub enum CanError {
    #[error("the kernel of this computer does not support CAN: {source}")]
    NoKernelSupport { source: io::Error },
    #[error("no CAN interface is named `{interface}`; {}", list_interfaces(available))]
    NoSuchInterface { interface: String, available: Vec<String> },
    #[error("`{interface}` is not a CAN interface; {}", list_interfaces(available))]
    NotCanInterface { interface: String, available: Vec<String> },
    #[error("the CAN interface `{interface}` is down: {why}")]
    InterfaceDown { interface: String, why: String },
    #[error("no frame {id} was received on `{interface}`, and the bus has errors: {why}")]
    BusErrors { interface: String, id: String, why: String },
    #[error("the CAN controller of `{interface}` is bus-off ({why}) and receives no frames")]
    BusOff { interface: String, why: String },
    #[error("no frame {id} was received on `{interface}`, only frames with other identifiers: {foreign_ids}")]
    ForeignIds { interface: String, id: String, foreign_ids: String },
    #[error("the CAN interface `{interface}` could not be opened: {source}")]
    OpenFailed { interface: String, source: io::Error },
    #[error("the receiver thread of `{interface}` has ended")]
    ThreadEnded { interface: String },
}

fn list_interfaces(available: &[String]) -> String {
    match available {
        [] => "this computer has no CAN interface".to_owned(),
        available => format!("available: {}", available.join(", ")),
    }
}

impl CanError {
    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        match self {
            Self::NoKernelSupport { .. } => "load the modules as root: `modprobe can can_raw` and the module of \
                                      the adapter; if the kernel was built without CAN (often in \
                                      containers and virtual machines), use another kernel, or a sensor \
                                      on a serial line or Modbus"
                .to_owned(),
            CanError::NoSuchInterface { .. } | CanError::NotCanInterface { .. } => {
                "plug the adapter in and load its module, then set `interface` of [sensor.can] to a name from \
                 `ip -brief link show type can`; start `slcand` first for a serial adapter"
                    .to_owned()
            }
            CanError::InterfaceDown { interface, .. } => format!(
                "set the interface up as root with the sensor's bit rate: `ip link set {interface} up type can \
                 bitrate 500000` (for vcan: `ip link set {interface} up`)"
            ),
            Self::BusErrors { interface, .. } => format!(
                "compare the bit rate (`ip -details link show {interface}`) with the sensor's manual; \
                 check the 120 ohm terminators at both ends of the bus, and that CAN high and low are not swapped"
            ),
            Self::BusOff { interface, .. } => format!(
                "check bit rate, cable and terminators (120 ohm at both ends), then restart the interface as root: \
                 `ip link set {interface} down`, `ip link set {interface} up`; with the setting \
                 `restart-ms 100` the kernel restarts the controller itself"
            ),
            Self::ForeignIds { .. } => "compare `id` (and `extended`: 29 bits) of [sensor.can] with the \
                                    sensor's manual and with the number set at the sensor"
                .to_owned(),
            Self::OpenFailed { .. } => "check `interface` of [sensor.can]".to_owned(),
            Self::ThreadEnded { .. } => "start the program again; if the error returns, report it".to_owned(),
        }
    }

    /// Finds the reason why `interface` was not opened: the kernel's error alone is too general.
    pub(super) fn from_open_error(interface: &str, source: io::Error) -> Self {
        let (interface, available) = (interface.to_owned(), interfaces::can_interfaces());
        if available.contains(&interface) {
            return Self::OpenFailed { interface, source };
        }
        if interfaces::network_interface_exists(&interface) {
            return CanError::NotCanInterface { interface, available };
        }
        CanError::NoSuchInterface { interface, available }
    }
}
