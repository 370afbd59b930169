//! The simulated control alone, register by register.
