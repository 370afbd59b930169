//! LinuxCNC's kinematics for a tilting rotary table, `xyzac-trt-kins` and `xyzbc-trt-kins`, whose values are HAL pins.
//! The module, its identity mode and the units come from the INI file.

use std::path::{Path, PathBuf};

use machine::Axis;
use machine::record::machine::AxisSense;

use super::hal_pins::{HalError, HalcmdClient};
use super::{are_values_equal, check_unit_is_mm};
use crate::controllers::ControllerError;
use crate::controllers::linuxcnc::{IniFile, identity_switchkins_type};

/// Pin of newer versions of LinuxCNC: 1 for rotary axes whose sense is that of ISO 841.
const ISO_SENSE_PIN: &str = "conventional-directions";
/// HAL component with the pins of the kinematics mode and of the motion state.
const MOTION_COMPONENT: &str = "motion";

#[derive(Debug, thiserror::Error)]
pub enum TrunnionError {
    #[error(transparent)]
    Hal(#[from] HalError),
    #[error(transparent)]
    Ini(#[from] ControllerError),
    #[error("the kinematics of {path} are `{kinematics}`, not xyzac-trt-kins or xyzbc-trt-kins", path = path.display())]
    OtherKinematics { path: PathBuf, kinematics: String },
    #[error("the kinematics apply the values now (motion.switchkins-type is {mode}): a change would move the axes")]
    KinematicsActive { mode: f64 },
    #[error("the machine moves (pin motion.in-position is FALSE)")]
    InMotion,
    #[error("after the write, pin {pin} reads {read_mm} mm instead of {written} mm")]
    ReadBackMismatch { pin: String, written: String, read_mm: f64 },
}

impl TrunnionError {
    /// What to do next.
    pub fn remedy(&self) -> String {
        match self {
            Self::Hal(error) => error.remedy(),
            Self::Ini(error) => error.remedy(),
            Self::OtherKinematics { .. } => "remove [compensation], or correct [controller] ini".to_owned(),
            Self::KinematicsActive { .. } => "switch the kinematics to identity (M429), then try again".to_owned(),
            Self::InMotion => "wait until the machine is at rest, then try again".to_owned(),
            Self::ReadBackMismatch { .. } => {
                "check which other program or signal sets the pin; then restore the values with `trued compensate undo`"
                    .to_owned()
            }
        }
    }
}

/// The pins as read, mm.
#[derive(Debug, Clone, PartialEq)]
pub struct TrunnionState {
    /// A or B.
    pub tilting_axis: Axis,
    /// Sense of both rotary axes; reversed if the control has no pin for it.
    pub sense: AxisSense,
    pub x_rot_point: f64,
    pub y_rot_point: f64,
    pub z_rot_point: f64,
    /// `y-offset` of `xyzac-trt-kins`, `x-offset` of `xyzbc-trt-kins`.
    pub x_or_y_offset: f64,
    pub z_offset: f64,
}

/// A control with the kinematics `xyzac-trt-kins` or `xyzbc-trt-kins`.
#[derive(Debug)]
pub struct TrunnionTarget {
    pins: HalcmdClient,
    ini: PathBuf,
    kinematics_module: &'static str,
    tilting_axis: Axis,
    /// Value of `motion.switchkins-type` in identity mode.
    identity_mode: f64,
}

impl TrunnionTarget {
    /// `ini`: the INI file that LinuxCNC was started with. `halcmd`: as for [`HalcmdClient::new`].
    ///
    /// # Errors
    /// The INI file is not readable, or names other kinematics or units.
    pub fn new(ini: &Path, halcmd: &[String]) -> Result<Self, TrunnionError> {
        let file = IniFile::read(ini)?;
        let other = || TrunnionError::OtherKinematics {
            path: ini.to_owned(),
            kinematics: file.kinematics().unwrap_or_default().to_owned(),
        };
        let (module, tilting_axis) = match file.kinematics_module() {
            Some("xyzac-trt-kins") => ("xyzac-trt-kins", Axis::A),
            Some("xyzbc-trt-kins") => ("xyzbc-trt-kins", Axis::B),
            _ => return Err(other()),
        };
        check_unit_is_mm(&file, ini)?;
        let identity_mode = identity_switchkins_type(&file).ok_or_else(other)?;
        Ok(Self {
            pins: HalcmdClient::new(halcmd),
            ini: ini.to_owned(),
            kinematics_module: module,
            tilting_axis,
            identity_mode,
        })
    }

    /// Kinematics module, INI file and `halcmd` command, in words.
    pub fn describe(&self) -> String {
        format!("{} of {}, by `{}`", self.kinematics_module, self.ini.display(), self.pins.describe())
    }

    fn offset_pin(&self) -> &'static str {
        if self.tilting_axis == Axis::A { "y-offset" } else { "x-offset" }
    }

    /// # Errors
    /// The pins cannot be read.
    pub fn read(&self) -> Result<TrunnionState, TrunnionError> {
        let pins = self.pins.read_component(self.kinematics_module)?;
        let is_iso = pins.value(ISO_SENSE_PIN).is_ok_and(|value| value != 0.0);
        Ok(TrunnionState {
            tilting_axis: self.tilting_axis,
            sense: if is_iso { AxisSense::Iso } else { AxisSense::Reversed },
            x_rot_point: pins.value("x-rot-point")?,
            y_rot_point: pins.value("y-rot-point")?,
            z_rot_point: pins.value("z-rot-point")?,
            x_or_y_offset: pins.value(self.offset_pin())?,
            z_offset: pins.value("z-offset")?,
        })
    }

    /// Sets the pin `name` (with its component) to `text`, mm, and reads it back.
    ///
    /// # Errors
    /// The kinematics are not in identity mode; the machine moves; the pin cannot be set, or reads back another value.
    pub fn write(&self, name: &str, text: &str) -> Result<(), TrunnionError> {
        self.check_writable()?;
        self.pins.set_pin(name, text)?;
        let own_name =
            name.strip_prefix(self.kinematics_module).and_then(|rest| rest.strip_prefix('.')).unwrap_or(name);
        let read_mm = self.pins.read_component(self.kinematics_module)?.value(own_name)?;
        let is_equal = text.parse().is_ok_and(|mm: f64| are_values_equal(read_mm, mm));
        match is_equal {
            true => Ok(()),
            false => Err(TrunnionError::ReadBackMismatch { pin: name.to_owned(), written: text.to_owned(), read_mm }),
        }
    }

    /// # Errors
    /// The kinematics are not in identity mode; the machine moves; a signal sets one of the pins.
    pub fn check_writable(&self) -> Result<(), TrunnionError> {
        let motion = self.pins.read_component(MOTION_COMPONENT)?;
        let mode = motion.value("switchkins-type")?;
        if mode != self.identity_mode {
            return Err(TrunnionError::KinematicsActive { mode });
        }
        if motion.value("in-position")? == 0.0 {
            return Err(TrunnionError::InMotion);
        }
        let pins = self.pins.read_component(self.kinematics_module)?;
        for pin in ["x-rot-point", "y-rot-point", "z-rot-point", self.offset_pin(), "z-offset"] {
            pins.check_settable(pin)?;
        }
        Ok(())
    }
}
