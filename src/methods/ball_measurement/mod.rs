//! Measurements of balls by touches, shared by all methods with master balls: stages of a list of visits, the
//! positions found so far, the measurements to repeat, the conversion of readings to ball centres, and the
//! uncertainty sources of the touches. Imports no method.

mod artefact;
mod effects;
mod indexations;
mod interruptions;
mod known;
mod label;
mod made_visits;
mod measurements;
mod nominal;
mod observe;
mod order;
mod planned_ways;
mod review;
mod rotary;
mod setup;
mod sources;
mod stages;
mod touch_order;
mod watch;

pub use artefact::balls;
pub use effects::{nonzero_columns, nonzero_runs, shifts};
pub use indexations::{
    NamedPositions, RotaryPositions, indexations, is_parallel, is_rotary, is_same, tilts_spindle,
    tilts_table,
};
#[cfg(test)]
pub use label::Label;
pub use label::Pass;
pub use made_visits::MadeVisits;
pub use measurements::measurements;
pub use nominal::nominal_readings;
pub use observe::{BallCentre, Observed, observe, stated_balls};
pub use order::{balls_in_order, in_order};
pub use planned_ways::balls_by_planned_ways;
pub use rotary::{angular_source, rotary_source};
pub use setup::{Find, MeasurementSetup, TouchSettings, Visit, describe_position};
pub use sources::touch_sources;
pub use stages::{machine_time_s, next};
