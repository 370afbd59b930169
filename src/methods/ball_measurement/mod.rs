//! Measurements of balls by touches, shared by all methods with master balls: stages of a list of visits, the
//! positions found so far, the measurements to repeat, the conversion of readings to ball centres, and the
//! uncertainty sources of the touches. Imports no method.

mod artefact;
mod found_balls;
mod indexations;
mod interruptions;
mod kinematic_effects;
mod nominal_readings;
mod observation_effects;
mod observe;
mod outlier_check_measurements;
mod path_order;
mod rest_check;
mod setup;
mod sources;
mod stage_review;
mod stages;
mod touch_label;
mod touch_order;
mod visit_cache;
mod visit_order;

pub use artefact::{ball_index, require_balls};
pub use indexations::{
    ConfiguredPositions, RotaryPositions, is_parallel_to_spindle, is_rotary_except_spindle, is_same_angle,
    list_indexations, tilts_spindle, tilts_table,
};
pub use kinematic_effects::{angular_and_rotary_motion_sources, tip_derivative_by_stylus};
pub use nominal_readings::nominal_readings;
pub use observation_effects::{effect_of_nonzero_columns, effect_of_nonzero_spans, shift_column};
pub use observe::{BallCentre, ObservedBalls, artefact_balls, observe_balls};
pub use outlier_check_measurements::measurements_for_outlier_check;
pub use path_order::order_balls_by_path;
pub use setup::{BallVisit, MeasurementSetup, SearchMode, TouchSettings, describe_rotary_axes_in_degrees};
pub use sources::{certified_size_source, touch_sources, whitening_matrices};
pub use stages::{next_stage, visits_machine_time_s};
pub use touch_label::MeasurementPurpose;
#[cfg(test)]
pub use touch_label::TouchLabel;
pub use visit_cache::VisitCache;
pub use visit_order::{order_balls_in_xy, order_visits};
