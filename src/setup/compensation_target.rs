//! Reads the values that a control holds for the compensation of measured errors.

use std::collections::BTreeMap;

use devices::compensation::hal_pins::{HalError, HalPins};
use machine::Axis;
use machine::kinematics::{KinematicChain, KinematicsError};
use machine::record::machine::{AxisSense, Machine};
use methods::compensation::{TargetValue, trunnion_values};

use super::machine_file::{CompensationConfig, TrunnionModule};

/// Pin of newer versions of LinuxCNC: 1 for rotary axes whose sense is that of ISO 841.
const ISO_SENSE_PIN: &str = "conventional-directions";

#[derive(Debug, thiserror::Error)]
pub enum CompensationTargetError {
    #[error(transparent)]
    Hal(#[from] HalError),
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
    #[error("{module} has no pin {pin}")]
    MissingPin { module: &'static str, pin: &'static str },
    #[error("{module} is for a table that tilts on {tilt} and turns on C; the machine is {topology}")]
    OtherTopology { module: &'static str, tilt: Axis, topology: String },
    #[error("{module} turns {axis} in the other sense than the machine file states")]
    OtherSense { module: &'static str, axis: Axis },
}

impl CompensationTargetError {
    /// What to do next.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Hal(error) => error.remedy(),
            Self::Kinematics(_) => "correct [machine] and [axes] in the machine file",
            Self::MissingPin { .. } => "this version of LinuxCNC is not supported: enter the values by hand (--sheet)",
            Self::OtherTopology { .. } => "correct kinematics in [compensation], or topology in [machine]",
            Self::OtherSense { .. } => {
                "correct `positive` of the axis in the machine file: in LinuxCNC's trt-kins a positive command turns the \
                 table counter-clockwise, seen against the direction of the axis, which is `reversed`"
            }
        }
    }
}

/// Reads the present values from the control.
///
/// # Errors
/// The control cannot be read; its kinematics are not those of the machine file.
pub fn read_target_values(
    config: &CompensationConfig,
    machine: &Machine,
) -> Result<Vec<TargetValue>, CompensationTargetError> {
    match config {
        CompensationConfig::LinuxcncTrunnion { kinematics, halcmd } => {
            let pins = HalPins::new(halcmd).read_module(kinematics.name())?;
            check_same_kinematics(*kinematics, &pins, machine)?;
            let tilt = kinematics.tilting_axis();
            let offset = if tilt == Axis::A { "y-offset" } else { "x-offset" };
            let needed = ["x-rot-point", "y-rot-point", "z-rot-point", offset, "z-offset"];
            if let Some(pin) = needed.into_iter().find(|pin| !pins.contains_key(*pin)) {
                return Err(CompensationTargetError::MissingPin { module: kinematics.name(), pin });
            }
            Ok(trunnion_values(tilt, |pin| pins.get(pin).copied().unwrap_or_default()))
        }
    }
}

/// Checks that the control's kinematics turn the table as the machine file states.
fn check_same_kinematics(
    kinematics: TrunnionModule,
    pins: &BTreeMap<String, f64>,
    machine: &Machine,
) -> Result<(), CompensationTargetError> {
    let (module, tilt) = (kinematics.name(), kinematics.tilting_axis());
    let chain = KinematicChain::new(machine)?;
    let rotary = chain.topology().workpiece_branch().iter().copied().filter(|axis| !axis.is_linear());
    if rotary.collect::<Vec<Axis>>() != [tilt, Axis::C] {
        return Err(CompensationTargetError::OtherTopology { module, tilt, topology: machine.topology.clone() });
    }
    let is_iso = pins.get(ISO_SENSE_PIN).is_some_and(|value| *value != 0.0);
    let sense = if is_iso { AxisSense::Iso } else { AxisSense::Reversed };
    let is_other = |axis: &Axis| machine.axes.get(axis).is_some_and(|stated| stated.positive != sense);
    match [tilt, Axis::C].into_iter().find(is_other) {
        Some(axis) => Err(CompensationTargetError::OtherSense { module, axis }),
        None => Ok(()),
    }
}
