//! The kernel's data about its network interfaces.

use std::fs;
use std::path::PathBuf;

/// ARPHRD_CAN of the kernel's `if_arp.h`.
const CAN_DEVICE_TYPE: &str = "280";
/// IFF_UP of the kernel's `if.h`.
const INTERFACE_UP_FLAG: u32 = 1;

/// Text of a file in `/sys/class/net` without surrounding white space; `None`: it cannot be read.
fn read_interface_attribute(interface: &str, attribute: &str) -> Option<String> {
    let path: PathBuf = ["/sys/class/net", interface, attribute].iter().collect();
    Some(fs::read_to_string(path).ok()?.trim().to_owned())
}

/// Names of the CAN interfaces, sorted.
pub(super) fn can_interfaces() -> Vec<String> {
    let entries = fs::read_dir("/sys/class/net").into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let mut names: Vec<String> =
        names.filter(|name| read_interface_attribute(name, "type").as_deref() == Some(CAN_DEVICE_TYPE)).collect();
    names.sort();
    names
}

/// Whether the kernel has a network interface of this name, CAN or not.
pub(super) fn network_interface_exists(interface: &str) -> bool {
    read_interface_attribute(interface, "type").is_some()
}

/// Whether the interface is administratively up; false if it does not exist.
pub(super) fn is_interface_up(interface: &str) -> bool {
    let flags = read_interface_attribute(interface, "flags");
    let flags = flags.and_then(|text| u32::from_str_radix(text.trim_start_matches("0x"), 16).ok());
    flags.is_some_and(|flags| flags & INTERFACE_UP_FLAG != 0)
}
