//! The values of a control that state the positions of its rotary axes.

use super::axis_positions::AxisCoordinate;
use machine::Axis;

/// Whether the readings of a run contain the effect of a value that the control held during the run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ValueEffect {
    /// The control applies the value to its axes: the readings show what remains.
    InReadings,
    /// The value moves no machine coordinate: the readings show the whole error.
    NotInReadings,
}

/// One value of a control.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetValue {
    /// Name at the control, e.g. `xyzbc-trt-kins.x-rot-point`.
    pub name: String,
    /// The value is the sum of these positions, each times its factor, minus `offset_mm`.
    pub terms: Vec<(AxisCoordinate, f64)>,
    pub offset_mm: f64,
    /// Smallest step of the value at the control, mm.
    pub resolution_mm: f64,
    /// The value that the control holds now, mm.
    pub present_mm: f64,
    pub effect: ValueEffect,
}

/// Smallest step of a HAL pin as it is written, mm.
const PIN_RESOLUTION_MM: f64 = 1e-4;

/// Values of LinuxCNC's kinematics `xyzac-trt-kins` (`tilt` = A) or `xyzbc-trt-kins` (`tilt` = B), mm. `present_mm`:
/// what the pin of this name holds. C passes through (x-rot-point, y-rot-point); the tilting axis is at x-offset or
/// y-offset from C, and at the sum of z-offset and z-rot-point in Z (LinuxCNC 2.9, `trtfuncs.c`; z-rot-point keeps its
/// value).
pub fn trunnion_values(tilt: Axis, present_mm: impl Fn(&str) -> f64) -> Vec<TargetValue> {
    let at = |axis: Axis, component: Axis| AxisCoordinate { axis, component };
    // The tilting axis is parallel to Y for B, to X for A.
    let (module, across, offset_pin) = match tilt {
        Axis::A => ("xyzac-trt-kins", Axis::Y, "y-offset"),
        _ => ("xyzbc-trt-kins", Axis::X, "x-offset"),
    };
    let value = |pin: &str, terms: Vec<(AxisCoordinate, f64)>, offset_mm: f64| TargetValue {
        name: format!("{module}.{pin}"),
        terms,
        offset_mm,
        resolution_mm: PIN_RESOLUTION_MM,
        present_mm: present_mm(pin),
        effect: ValueEffect::NotInReadings,
    };
    vec![
        value("x-rot-point", vec![(at(Axis::C, Axis::X), 1.0)], 0.0),
        value("y-rot-point", vec![(at(Axis::C, Axis::Y), 1.0)], 0.0),
        value(offset_pin, vec![(at(tilt, across), 1.0), (at(Axis::C, across), -1.0)], 0.0),
        value("z-offset", vec![(at(tilt, Axis::Z), 1.0)], present_mm("z-rot-point")),
    ]
}
