//! Blocks for a simulated control that do not come from a plan.

use machine::Axis;
use machine::record::motion::MotionBlock;
use planning::gcode::TransmissionForm;
use planning::proof::{ProvenBlock, for_tests};
use trued::setup::{Devices, MachineFile};

/// `block` as it is sent, line by line, without a collision check.
pub fn proven_block_without_collision_check(file: &MachineFile, devices: &Devices, block: &MotionBlock) -> ProvenBlock {
    let axes: Vec<Axis> = file.machine.axes.keys().copied().collect();
    let transmission = TransmissionForm::Lines { max_line_bytes: usize::MAX };
    for_tests::prove_block_text(block, &axes, &devices.dialect, &transmission).expect("its text")
}
