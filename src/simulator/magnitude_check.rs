//! Rejects a machine, a probe or a truth with physically impossible numbers.

use super::SimulatedWorldError;
use super::sensor_truth::is_finite_and_non_negative;
use super::truth::MachineTruth;
use machine::record::machine::{Machine, Probe};

/// Checks most numbers of machine, probe and truth, but not those of sensors, thermometers and rotary motions: all must
/// be finite, magnitudes not negative, rapids, accelerations and error wavelengths positive. A sag needs a rotary axis.
pub(super) fn check_magnitudes(
    machine: &Machine,
    probe: &Probe,
    truth: &MachineTruth,
) -> Result<(), SimulatedWorldError> {
    let mut magnitudes = vec![
        probe.ball_radius_mm,
        probe.repeatability_um.unwrap_or_default(),
        probe.lobing_um,
        probe.u_stylus_offset_um,
        probe.overtravel_mm,
        machine.drift_um_per_h,
        machine.squareness_urad,
        truth.roughness_um,
        truth.ball_offset_mm,
        truth.ball_diameter_um,
        truth.ball_form_um,
        truth.latch.delay_ms,
        truth.latch.scan_ms,
    ];
    magnitudes.extend(truth.backlash_um.values());
    for (axis, spec) in &machine.axes {
        magnitudes.extend([spec.resolution_um, spec.error_motion_um, spec.backlash_um]);
        if !(spec.rapid_per_min > 0.0 && spec.acceleration_per_s2 > 0.0) {
            return Err(SimulatedWorldError::InvalidDynamics { axis: *axis });
        }
        if spec.error_wavelength_mm <= 0.0 {
            return Err(SimulatedWorldError::InvalidNumber);
        }
    }
    for term in &truth.sag {
        if term.axis.is_linear() || !machine.axes.contains_key(&term.axis) {
            return Err(SimulatedWorldError::NoRotarySagAxis { axis: term.axis });
        }
    }
    let form = truth.form.iter().flat_map(|h| [h.cos_um, h.sin_um]);
    let offsets = truth.centre_offset_mm.into_iter().chain(truth.tool_offset_um);
    let offsets = offsets.chain([truth.radius_offset_mm]);
    let balls = truth
        .ball
        .iter()
        .flat_map(|ball| ball.offset_mm.into_iter().chain([ball.diameter_um, ball.form_um.unwrap_or_default()]));
    let moves = truth.ball_moves.iter().flat_map(|moved| moved.by_mm.into_iter().chain([moved.at_s]));
    let sag = truth.sag.iter().flat_map(|term| term.um.into_iter().chain(term.urad));
    let mut stated = truth.errors.values().copied().chain(form).chain(offsets);
    let mut ball_values = balls.chain(moves).chain(sag).chain([truth.length_error_um_per_m]);
    let is_valid = stated.all(f64::is_finite)
        && ball_values.all(f64::is_finite)
        && magnitudes.into_iter().all(is_finite_and_non_negative);
    if is_valid { Ok(()) } else { Err(SimulatedWorldError::InvalidNumber) }
}
