//! The driver against the simulated control.
