//! Test fixtures, also for the tests of the driver: a five-axis machine with a round part, and its world.

#![allow(clippy::unwrap_used, reason = "for tests alone")]

use std::sync::{Arc, Mutex};

use serde_json::json;

use crate::{MachineTruth, SimulatedWorld};
use machine::record::artefact::Artefact;
use machine::record::machine::{Machine, Probe};

/// Machine with X, Y ±400 mm, Z -400 to 0, B ±110°, C ±720°; the stylus-ball centre is the spindle datum.
pub fn five_axis_machine() -> Machine {
    let linear = json!({"min": -400, "max": 400});
    serde_json::from_value(json!({
        "name": "bench", "topology": "w-C-B-X-F-Z-Y-S-t",
        "axes": {"X": linear, "Y": linear, "Z": {"min": -400, "max": 0},
                 "B": {"min": -110, "max": 110}, "C": {"min": -720, "max": 720}}
    }))
    .unwrap()
}

/// A world without errors: a part of radius 25 mm about the C axis, from Z -200 to -100 mm, and a stylus ball of radius
/// 3 mm, so that contact is at 28 mm from the axis. The machine is at zero.
pub fn world_with_round_part() -> Arc<Mutex<SimulatedWorld>> {
    let probe: Probe = serde_json::from_value(json!({"ball_radius_mm": 3})).unwrap();
    let artefact: Artefact = serde_json::from_value(json!({
        "kind": "cylinder", "centre_mm": [0, 0, -200], "axis": [0, 0, 1], "radius_mm": 25
    }))
    .unwrap();
    Arc::new(Mutex::new(
        SimulatedWorld::new(&five_axis_machine(), &probe, &artefact, &MachineTruth::default()).unwrap(),
    ))
}
