//! Measurements of balls by touches, shared by all methods with master balls: stages of a list of visits, the
//! positions found so far, the measurements to repeat, the conversion of readings to ball centres, and the
//! uncertainty sources of the touches. Imports no method.

mod artefact;
mod effects;
mod found_balls;
mod indexations;
mod interruptions;
mod label;
mod measurements;
mod nominal;
mod observe;
mod order;
mod path_order;
mod rest_check;
mod review;
mod rotary;
mod setup;
mod sources;
mod stages;
mod touch_order;
mod visit_cache;

pub use artefact::{ball_index, require_balls};
pub use effects::{nonzero_columns, nonzero_spans, shift_column};
pub use indexations::{
    ConfiguredPositions, RotaryPositions, is_parallel_to_spindle, is_rotary, is_same_angle, list_indexations,
    tilts_spindle, tilts_table,
};
pub use label::MeasurementPass;
#[cfg(test)]
pub use label::TouchLabel;
pub use measurements::outlier_measurements;
pub use nominal::nominal_readings;
pub use observe::{BallCentre, ObservedBalls, artefact_balls, observe_balls};
pub use order::{order_balls_in_xy, order_visits};
pub use path_order::order_balls_by_path;
pub use rotary::{kinematic_sources, stylus_derivative};
pub use setup::{BallVisit, MeasurementSetup, SearchMode, TouchSettings, describe_position};
pub use sources::{certified_source, touch_sources, whitening_matrices};
pub use stages::{machine_time_s, next_stage};
pub use visit_cache::VisitCache;
