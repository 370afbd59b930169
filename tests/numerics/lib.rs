//! Numerical results of the library: no trial runs the program. The submodules are independent.

#![cfg(test)]
#![allow(clippy::too_many_lines, reason = "a trial is one story, and lists of cases are long")]

mod ball_dome;
mod ball_motion_planning;
mod ball_plate;
mod dome_collision_check;
mod dome_visit_order;
mod five_axes;
mod kinematics_g0;
mod known_error_motions;
mod laser_r_test;
mod latch_delay;
mod machine_text;
mod multiprobe;
mod multiprobe_centring;
mod nist_strd;
mod run_combinations;
mod run_differences;

mod outliers;
mod outside_model;
mod probe_qualification;
mod proof_sabotage;
mod proof_sweep;
mod r_test;
mod round_fits;
mod samba;
mod source_scatter;
mod touch_without_path;
mod undeclared_errors;
mod world_coverage;

#[path = "../support"]
mod support {
    pub mod plan_player;
    pub mod proven_block;
}
