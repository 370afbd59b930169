//! Finds pymodbus, the peer of everything that uses Modbus.

use std::path::{Path, PathBuf};

pub fn missing_pymodbus_reason() -> Option<&'static str> {
    python_with_pymodbus().is_none().then_some("pymodbus is missing: tests/peers/pymodbus/install")
}

/// A python that has pymodbus: `TRUED_PYMODBUS`, or the one that `tests/peers/pymodbus/install` created.
pub fn python_with_pymodbus() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("TRUED_PYMODBUS") {
        return Some(named.into());
    }
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent()?;
    let python = target.join("peers/pymodbus-3.8.6/bin/python");
    python.is_file().then_some(python)
}
