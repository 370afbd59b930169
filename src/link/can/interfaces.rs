//! The kernel's data about its network interfaces.

use std::fs;
use std::path::PathBuf;

/// ARPHRD_CAN of the kernel's `if_arp.h`.
const TYPE_OF_CAN: &str = "280";
/// IFF_UP of the kernel's `if.h`.
const UP: u32 = 1;

fn of(interface: &str, attribute: &str) -> Option<String> {
    let at: PathBuf = ["/sys/class/net", interface, attribute].iter().collect();
    Some(fs::read_to_string(at).ok()?.trim().to_owned())
}

/// Names of the CAN interfaces, sorted.
pub(super) fn all() -> Vec<String> {
    let entries = fs::read_dir("/sys/class/net").into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let mut names: Vec<String> =
        names.filter(|name| of(name, "type").as_deref() == Some(TYPE_OF_CAN)).collect();
    names.sort();
    names
}

pub(super) fn exists(interface: &str) -> bool {
    of(interface, "type").is_some()
}

pub(super) fn is_up(interface: &str) -> bool {
    let flags = of(interface, "flags");
    let flags = flags.and_then(|text| u32::from_str_radix(text.trim_start_matches("0x"), 16).ok());
    flags.is_some_and(|flags| flags & UP != 0)
}
