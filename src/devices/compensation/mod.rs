//! Values of controls that compensate errors of the axes: one folder for each kind of control.

pub mod linuxcnc_trunnion;
