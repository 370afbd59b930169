//! Numerical results of the library: no trial runs the program. The submodules are independent.

#![cfg(test)]
#![allow(clippy::too_many_lines, reason = "a trial is one story, and lists of cases are long")]

mod ball_dome;
mod ball_motions;
mod ball_plate;
mod centring;
mod compare;
mod dome_sweep;
mod dome_travel;
mod five_axes;
mod kinematics_g0;
mod known_motions;
mod laser;
mod latch_delay;
mod machine_text;
mod multiprobe;
mod nist_strd;

mod outliers;
mod outside_model;
mod probe_qualification;
mod proof_sabotage;
mod proof_sweep;
mod r_test;
mod round_fits;
mod samba;
mod sources_alone;
mod touch_alone;
mod undeclared;
mod worlds;

#[path = "../support"]
mod support {
    pub mod plan_player;
    pub mod proven_block;
}
