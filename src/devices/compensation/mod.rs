//! Controls whose stored values compensate measured errors: read, write, read back.

pub mod hal_pins;
