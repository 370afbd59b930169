//! True errors of a displacement sensor.

use serde::{Deserialize, Serialize};

use super::SimulatedWorldError;

/// One `[[simulated.sensor]]`. Errors that its `[[sensor]]` declares by magnitude only (noise, linearity, incidence)
/// are drawn from the seed unless given here.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorTruth {
    /// Name of the `[[sensor]]` to which these errors apply.
    pub name: String,
    /// True zero point minus the stated one, frame of the mount.
    pub zero_offset_um: [f64; 3],
    /// Tilt of the beam towards the two axes of the mount's frame across its stated direction: X and Y for a
    /// beam along Z, X and Z along Y, Y and Z along X.
    pub tilt_urad: [f64; 2],
    /// Output per true distance; 1 for an ideal sensor.
    pub gain: f64,
    /// Deviation of the output from a straight line; `None`: drawn from the declared magnitude.
    pub linearity: Option<Vec<LinearityWave>>,
    /// Standard deviation of one sample; `None`: the declared one, or 0.
    pub noise_um: Option<f64>,
    /// Diameter of the light spot; the output is the mean over it.
    pub spot_mm: f64,
    /// Added distance on a surface at 45° to the beam; proportional to the squared tangent of the angle. If this
    /// value and `lean_um` are 0, both are drawn from the declared magnitude.
    pub incidence_um: f64,
    /// Added distance on a surface that is tilted by 45° along each of the two axes of `tilt_urad`. It is
    /// proportional to the tangent of the tilt, and positive where the surface recedes along the axis.
    pub lean_um: [f64; 2],
    /// Angle between beam and surface normal above which no light comes back.
    pub echo_limit_deg: f64,
    /// Angle between beam and surface normal below which the receiver is saturated.
    pub dazzled_deg: f64,
    /// Output limits, mm: distances beyond them are reported as the nearer limit, because the electronics are
    /// saturated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clips_mm: Option<[f64; 2]>,
    /// Rate error of the clock: a second of the sensor's clock lasts this much longer.
    pub clock_slow_ppm: f64,
    /// Standard deviation of the time of one sample about the time of the sensor's clock.
    pub clock_jitter_us: f64,
    /// Latency: the output at a moment belongs to a measurement this much earlier.
    pub clock_late_ms: f64,
}

/// `amplitude·sin(2π·d/period + phase)` over the distance d.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinearityWave {
    pub amplitude_um: f64,
    pub period_mm: f64,
    #[serde(default)]
    pub phase_deg: f64,
}

impl Default for SensorTruth {
    /// No errors, except that `echo_limit_deg` is that of the sensor type in paper 2; errors that the `[[sensor]]`
    /// declares by magnitude are still drawn.
    fn default() -> Self {
        Self {
            name: String::new(),
            zero_offset_um: [0.0; 3],
            tilt_urad: [0.0; 2],
            gain: 1.0,
            linearity: None,
            noise_um: None,
            spot_mm: 0.0,
            incidence_um: 0.0,
            lean_um: [0.0; 2],
            echo_limit_deg: 40.0,
            dazzled_deg: 0.0,
            clips_mm: None,
            clock_slow_ppm: 0.0,
            clock_jitter_us: 0.0,
            clock_late_ms: 0.0,
        }
    }
}

impl SensorTruth {
    /// Rejects values that are impossible for a sensor.
    ///
    /// # Errors
    /// Names the first key whose value is impossible for a sensor.
    pub(super) fn check_values(&self) -> Result<(), SimulatedWorldError> {
        let waves = self.linearity.iter().flatten();
        let curve = waves.clone().flat_map(|w| [w.amplitude_um, w.phase_deg]);
        let rules = [
            ("zero_offset_um", self.zero_offset_um.iter().all(|v| v.is_finite())),
            ("tilt_urad", self.tilt_urad.iter().all(|v| v.abs() < MAX_TILT_URAD)),
            ("gain", self.gain > 0.0 && self.gain.is_finite()),
            ("linearity", waves.clone().all(|w| w.period_mm > 0.0)),
            ("linearity", curve.into_iter().all(f64::is_finite)),
            ("noise_um", is_finite_and_non_negative(self.noise_um.unwrap_or_default())),
            ("spot_mm", is_finite_and_non_negative(self.spot_mm)),
            ("incidence_um", self.incidence_um.is_finite()),
            ("lean_um", self.lean_um.iter().all(|v| v.is_finite())),
            ("echo_limit_deg", self.echo_limit_deg > 0.0 && self.echo_limit_deg < 90.0),
            ("clock_slow_ppm", self.clock_slow_ppm.abs() < MAX_CLOCK_RATE_ERROR_PPM),
            ("clock_jitter_us", is_finite_and_non_negative(self.clock_jitter_us)),
            ("clock_late_ms", (0.0..=MAX_LATENCY_MS).contains(&self.clock_late_ms)),
            ("clips_mm", self.clips_mm.is_none_or(|[low, high]| low < high)),
            ("dazzled_deg", is_finite_and_non_negative(self.dazzled_deg) && self.dazzled_deg < self.echo_limit_deg),
        ];
        match rules.into_iter().find(|(_, holds)| !holds) {
            None => Ok(()),
            Some((key, _)) => Err(SimulatedWorldError::InvalidSensor { name: self.name.clone(), key }),
        }
    }
}

/// Maximum latency, inclusive: one second.
const MAX_LATENCY_MS: f64 = 1000.0;
/// Exclusive limit of the rate error of the clock, in either direction: one quarter.
const MAX_CLOCK_RATE_ERROR_PPM: f64 = 250_000.0;
/// Exclusive limit of each component of the tilt, in either direction: half a radian.
const MAX_TILT_URAD: f64 = 500_000.0;

pub(super) fn is_finite_and_non_negative(value: f64) -> bool {
    value.is_finite() && value >= 0.0
}
